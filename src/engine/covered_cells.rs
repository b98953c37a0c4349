//! Covered cells: cells of space known to lie inside the union, so that most covered cubes are found so without a look at other
//! cubes.
//!
//! ```text
//!   cells of an eighth of the edge (rounded down) ── 8 x 8 x 8 of them are one block of 64 bytes
//!   mark      every cell inside a cube that comes: a covered one, or an exposed one where cubes are dense
//!   unmark    every cell that meets what a deletion uncovered
//!   cover     all cells that meet a cube are marked: the union covers it
//! ```
//!
//! A cell that is not marked means nothing: the kernel decides. So the cells cost time and space, never a result.
//! # Source
//! UNION3's covered cells (W. R. Franklin), kept current.

use std::ops::Range;

use crate::geometry::{Edge, Place};

use super::bins::{BinKey, CubeWalk};
use super::grid::Grid;
use super::kernel::Span;

/// Cells along one side of a block.
const SIDE: i32 = 8;

/// Layers of cells by z; in each a byte for every y, and in that a bit for every x.
type Layers = [u64; 8];
const _: () = assert!(SIDE * SIDE == u64::BITS.cast_signed());

/// The cells known to lie inside the union.
#[derive(Debug)]
pub(super) struct CoveredCells {
    edge: i32,
    cell: i32,
    state: State,
    /// How far the cubes that were there before have been marked: the exposed ones, then the covered ones. None when all are.
    behind: Option<[(usize, CubeWalk); 2]>,
    blocks: Blocks,
}

/// Whether the cells are kept.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// Not at all.
    Never,
    /// Not while so few cubes are covered that they would not pay.
    Idle,
    /// Yes.
    Kept,
}

/// Cubes, of those that were there when the cells began to be kept, that a change marks.
const CUBES_A_CHANGE: usize = 4;

/// With fewer covered cubes than this the cells never pay.
const COVERED_MIN: usize = 16;

/// Cells from `first` to before `end`, by axis.
#[derive(Clone, Copy)]
struct Cells {
    first: [i32; 3],
    end: [i32; 3],
}

impl CoveredCells {
    /// No cells yet; never any for cubes too small to have cells.
    pub(super) fn new(edge: Edge) -> Self {
        let cell = edge.steps() / SIDE;
        let state = if cell > 0 { State::Idle } else { State::Never };
        Self {
            edge: edge.steps(),
            cell: cell.max(1),
            state,
            behind: None,
            blocks: Blocks::default(),
        }
    }

    /// No cells, ever.
    pub(super) fn never(edge: Edge) -> Self {
        Self {
            state: State::Never,
            ..Self::new(edge)
        }
    }

    /// Begins to keep the cells when a third of the cubes are covered, and ends when fewer than a ninth are: between the two lie
    /// so many changes that going over all cubes costs little for each. Those that were there before are marked after the
    /// beginning, some for each of the changes since the last review, so that no change waits for all of them. True while there
    /// are more.
    pub(super) fn review(&mut self, exposed: &Grid, covered: &Grid, changes: usize) -> bool {
        match self.state {
            State::Idle if covered.len() >= COVERED_MIN && covered.len() * 2 >= exposed.len() => {
                self.state = State::Kept;
                self.behind = Some(Default::default());
            }
            State::Kept if covered.len() * 8 < exposed.len() || covered.len() == 0 => {
                self.state = State::Idle;
                self.behind = None;
                self.blocks = Blocks::default();
            }
            State::Never | State::Idle | State::Kept => {}
        }
        if let Some(mut behind) = self.behind.take() {
            let mut budget = changes * CUBES_A_CHANGE;
            let [of_exposed, of_covered] = &mut behind;
            budget = exposed.next_corners(of_exposed, budget, |corner| {
                let place = Place::from_checked(corner);
                if exposed.is_dense_at(place) {
                    self.mark(place);
                }
            });
            budget = covered.next_corners(of_covered, budget, |corner| {
                self.mark(Place::from_checked(corner));
            });
            self.behind = (budget == 0).then_some(behind);
        }
        self.behind.is_some()
    }

    /// Whether the cells are kept at the moment.
    pub(super) fn are_kept(&self) -> bool {
        self.state == State::Kept
    }

    /// Marks the cells inside a cube of the set. Of the exposed ones only those where cubes are dense are to be marked: elsewhere
    /// none is covered, and the cells would take more memory than the cubes.
    pub(super) fn mark(&mut self, place: Place) {
        if self.state != State::Kept {
            return;
        }
        let cells = self.inside(&Span::cube(place.corner(), self.edge));
        cells.each_block(|part| {
            let layers = self.blocks.entry(part.block);
            for layer in &mut layers[part.z] {
                *layer |= part.cells;
            }
            true
        });
    }

    /// Unmarks the cells that meet a box.
    pub(super) fn unmark(&mut self, uncovered: &Span) {
        if self.state != State::Kept {
            return;
        }
        self.meeting(uncovered).each_block(|part| {
            if let Some(layers) = self.blocks.get_mut(part.block) {
                for layer in &mut layers[part.z] {
                    *layer &= !part.cells;
                }
                if *layers == [0; 8] {
                    self.blocks.remove(part.block);
                }
            }
            true
        });
    }

    /// Whether the union is known to cover the cube at `place`.
    pub(super) fn cover(&self, place: Place) -> bool {
        if self.state != State::Kept {
            return false;
        }
        let cells = self.meeting(&Span::cube(place.corner(), self.edge));
        cells.each_block(|part| {
            let layers = self.blocks.get(part.block);
            layers.is_some_and(|layers| {
                let all = layers[part.z]
                    .iter()
                    .fold(u64::MAX, |all, layer| all & layer);
                all & part.cells == part.cells
            })
        })
    }

    /// Bytes of the blocks.
    pub(super) fn size(&self) -> usize {
        self.blocks.size()
    }

    fn inside(&self, span: &Span) -> Cells {
        Cells {
            first: span.min.map(|low| self.up(low)),
            end: span.max.map(|high| self.down(high)),
        }
    }

    fn meeting(&self, span: &Span) -> Cells {
        Cells {
            first: span.min.map(|low| self.down(low)),
            end: span.max.map(|high| self.up(high)),
        }
    }

    /// The last border of cells at or below a coordinate.
    fn down(&self, coordinate: i32) -> i32 {
        coordinate.div_euclid(self.cell)
    }

    /// The first border of cells at or above a coordinate.
    fn up(&self, coordinate: i32) -> i32 {
        (coordinate + self.cell - 1).div_euclid(self.cell)
    }
}

/// Those of some cells that lie in one block.
struct InBlock {
    block: BinKey,
    /// The same in each layer.
    cells: u64,
    z: Range<usize>,
}

impl Cells {
    /// Calls `visit` with the cells by block, while it answers true; true at the end.
    #[inline]
    fn each_block(&self, mut visit: impl FnMut(InBlock) -> bool) -> bool {
        let blocks =
            |axis: usize| self.first[axis].div_euclid(SIDE)..=(self.end[axis] - 1).div_euclid(SIDE);
        let within = |axis: usize, block: i32| {
            let clamp = |cell: i32| {
                let cell = (cell - block * SIDE).clamp(0, SIDE);
                cell.cast_unsigned()
            };
            clamp(self.first[axis])..clamp(self.end[axis])
        };
        for z in blocks(2) {
            let layers = within(2, z);
            for y in blocks(1) {
                // The lowest bit of each row.
                let rows = every(8, within(1, y)) & 0x0101_0101_0101_0101;
                for x in blocks(0) {
                    let part = InBlock {
                        block: BinKey([x, y, z]),
                        cells: rows * (every(1, within(0, x)) & 0xff),
                        z: layers.start as usize..layers.end as usize,
                    };
                    if !visit(part) {
                        return false;
                    }
                }
            }
        }
        true
    }
}

/// The bits of a range of groups of `width` bits.
#[inline]
fn every(width: u32, groups: Range<u32>) -> u64 {
    let below = |group: u32| !u64::MAX.checked_shl(group * width).unwrap_or(0);
    below(groups.end) & !below(groups.start)
}

/// Blocks by where they are: side by side, and a table of where.
///
/// The table is open addressing by hand because it takes 5.3 to 8 bytes a block (4 bytes a slot, half to three quarters full). In
/// hashbrown's `HashTable` the same numbers take 5.7 to 11.4 (5 bytes a slot, 7/16 to 7/8 full, since it only doubles), and the
/// blocks themselves, kept in it instead of side by side, 88 to 176 for 77 used.
#[derive(Debug, Default)]
struct Blocks {
    /// In no particular order, that of `layers`.
    keys: Vec<BinKey>,
    layers: Vec<Layers>,
    /// Open addressing with linear probing: the number of a block plus one, or 0.
    slots: Box<[u32]>,
}

impl Blocks {
    fn get(&self, key: BinKey) -> Option<&Layers> {
        let (_, block) = self.find(key)?;
        Some(&self.layers[block])
    }

    fn get_mut(&mut self, key: BinKey) -> Option<&mut Layers> {
        let (_, block) = self.find(key)?;
        Some(&mut self.layers[block])
    }

    /// The block at a key, an empty one if there was none.
    fn entry(&mut self, key: BinKey) -> &mut Layers {
        let block = match self.find(key) {
            Some((_, block)) => block,
            None => self.insert(key),
        };
        &mut self.layers[block]
    }

    #[cold]
    fn insert(&mut self, key: BinKey) -> usize {
        let block = self.keys.len();
        if (block + 1) * 4 > self.slots.len() * 3 {
            self.resize((self.slots.len() * 3 / 2).max(16));
        }
        // An eighth more than there is: doubling would cost more bytes than the cubes.
        if block == self.keys.capacity() {
            self.keys.reserve_exact(block / 8 + 8);
            self.layers.reserve_exact(block / 8 + 8);
        }
        self.keys.push(key);
        self.layers.push([0; 8]);
        let slot = self.vacant(key);
        self.slots[slot] = number(block);
        block
    }

    fn remove(&mut self, key: BinKey) {
        let (slot, block) = self.find(key).expect("the block was found a moment ago");
        self.unlink(slot);
        self.keys.swap_remove(block);
        self.layers.swap_remove(block);
        // The last block has moved to where the removed one was.
        if let Some(moved) = self.keys.get(block) {
            let last = number(self.keys.len());
            let mut slot = self.home(*moved);
            while self.slots[slot] != last {
                slot = self.after(slot);
            }
            self.slots[slot] = number(block);
        }
        if self.keys.len() * 2 < self.keys.capacity() {
            self.keys.shrink_to(self.keys.len() * 5 / 4);
            self.layers.shrink_to(self.keys.len() * 5 / 4);
        }
        if self.keys.len() * 4 < self.slots.len() && self.slots.len() > 16 {
            self.resize(self.slots.len() / 2);
        }
    }

    /// Empties a slot. Entries behind it that would rather be here move up.
    fn unlink(&mut self, slot: usize) {
        let count = self.slots.len();
        let (mut gap, mut next) = (slot, self.after(slot));
        while let Some(block) = block_of(self.slots[next]) {
            let home = self.home(self.keys[block]);
            let from_home = |at: usize| {
                if at >= home {
                    at - home
                } else {
                    at + count - home
                }
            };
            if from_home(gap) < from_home(next) {
                self.slots[gap] = self.slots[next];
                gap = next;
            }
            next = self.after(next);
        }
        self.slots[gap] = 0;
    }

    fn resize(&mut self, count: usize) {
        self.slots = vec![0; count].into_boxed_slice();
        for block in 0..self.keys.len() {
            let slot = self.vacant(self.keys[block]);
            self.slots[slot] = number(block);
        }
    }

    /// The slot and the number of the block at a key.
    #[inline]
    fn find(&self, key: BinKey) -> Option<(usize, usize)> {
        let mut slot = self.home(key);
        while let Some(block) = block_of(*self.slots.get(slot)?) {
            if self.keys[block] == key {
                return Some((slot, block));
            }
            slot = self.after(slot);
        }
        None
    }

    fn vacant(&self, key: BinKey) -> usize {
        let mut slot = self.home(key);
        while self.slots[slot] != 0 {
            slot = self.after(slot);
        }
        slot
    }

    #[inline]
    fn home(&self, key: BinKey) -> usize {
        let home = (u128::from(key.hash()) * self.slots.len() as u128) >> 64;
        usize::try_from(home).expect("it is less than the number of slots")
    }

    #[inline]
    fn after(&self, slot: usize) -> usize {
        if slot + 1 == self.slots.len() {
            0
        } else {
            slot + 1
        }
    }

    fn size(&self) -> usize {
        self.keys.capacity() * size_of::<BinKey>()
            + self.layers.capacity() * size_of::<Layers>()
            + self.slots.len() * size_of::<u32>()
    }
}

/// A block as a slot names it.
fn number(block: usize) -> u32 {
    u32::try_from(block + 1).expect("there are fewer blocks than cubes")
}

fn block_of(slot: u32) -> Option<usize> {
    slot.checked_sub(1).map(|block| block as usize)
}
