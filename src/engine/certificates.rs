//! Certificates: cells of space known to lie inside the union, so that a covered cube is hidden without a look at others.
//!
//! ```text
//!   cells of an eighth of the edge (rounded down) ── 8 x 8 x 8 of them are one block of 64 bytes
//!   certify   every cell inside a cube that became visible
//!   revoke    every cell that meets what a deletion laid bare
//!   covers    all cells that meet a cube are certified: the union covers it
//! ```
//!
//! A cell that is not certified means nothing: the kernel decides. So certificates cost time and space, never a result.
//! # Source
//! The covered cells of UNION3 (W. R. Franklin), kept current.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hash, Hasher};

use crate::geometry::{Edge, Place};

use super::bins::BinKey;
use super::grid::Grid;
use super::marginal::Span;

/// Cells along one side of a block; one row of a block is a byte.
const SIDE: i32 = 8;

/// Rows of cells by (z, y), a bit for each x.
type Block = [u8; 64];
const _: () = assert!(SIDE.cast_unsigned() == u8::BITS && size_of::<Block>() == 8 * 8);

/// The certified cells.
#[derive(Debug)]
pub(super) struct Certificates {
    edge: i32,
    cell: i32,
    state: State,
    blocks: HashMap<BinKey, Block, BuildHasherDefault<BinHasher>>,
}

/// Whether certificates are kept.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum State {
    /// Not at all.
    Never,
    /// Not while so few cubes are hidden that they would not pay.
    Idle,
    /// Yes.
    Kept,
}

/// Fewer hidden cubes than this never pay.
const HIDDEN_MIN: usize = 16;

/// Cells from `first` to before `end`, by axis.
#[derive(Clone, Copy)]
struct Cells {
    first: [i32; 3],
    end: [i32; 3],
}

impl Certificates {
    /// No certificates yet; never any for cubes too small to have cells.
    pub(super) fn new(edge: Edge) -> Self {
        let cell = edge.steps() / SIDE;
        let state = if cell > 0 { State::Idle } else { State::Never };
        Self {
            edge: edge.steps(),
            cell: cell.max(1),
            state,
            blocks: HashMap::default(),
        }
    }

    /// No certificates, ever.
    pub(super) fn never(edge: Edge) -> Self {
        Self {
            state: State::Never,
            ..Self::new(edge)
        }
    }

    /// Begins to keep certificates when a third of the cubes are hidden, and ends when fewer than a ninth are: between
    /// the two lie so many changes that going over all visible cubes costs little for each.
    pub(super) fn review(&mut self, visible: &Grid, hidden: &Grid) {
        match self.state {
            State::Idle if hidden.len() >= HIDDEN_MIN && hidden.len() * 2 >= visible.len() => {
                self.state = State::Kept;
                for corner in visible.corners() {
                    self.certify(Place::from_checked(corner));
                }
            }
            State::Kept if hidden.len() * 8 < visible.len() || hidden.len() == 0 => {
                self.state = State::Idle;
                self.blocks = HashMap::default();
            }
            State::Never | State::Idle | State::Kept => {}
        }
    }

    /// Certifies the cells inside a cube that is visible.
    pub(super) fn certify(&mut self, place: Place) {
        if self.state != State::Kept {
            return;
        }
        let cells = self.inside(&Span::cube(place.corner(), self.edge));
        for key in cells.blocks() {
            let block = self.blocks.entry(key).or_insert([0; 64]);
            cells.rows_in(key, |row, bits| {
                block[row] |= bits;
                true
            });
        }
    }

    /// Withdraws the certificates of the cells that meet a box.
    pub(super) fn revoke(&mut self, bare: &Span) {
        if self.state != State::Kept {
            return;
        }
        let cells = self.meeting(bare);
        for key in cells.blocks() {
            if let Some(block) = self.blocks.get_mut(&key) {
                cells.rows_in(key, |row, bits| {
                    block[row] &= !bits;
                    true
                });
                if *block == [0; 64] {
                    self.blocks.remove(&key);
                }
            }
        }
    }

    /// Whether the union is known to cover the cube at `place`.
    pub(super) fn covers(&self, place: Place) -> bool {
        if self.state != State::Kept {
            return false;
        }
        let cells = self.meeting(&Span::cube(place.corner(), self.edge));
        cells.blocks().all(|key| {
            let block = self.blocks.get(&key);
            block.is_some_and(|block| cells.rows_in(key, |row, bits| block[row] & bits == bits))
        })
    }

    /// Bytes of the blocks.
    pub(super) fn size(&self) -> usize {
        self.blocks.capacity() * (size_of::<(BinKey, Block)>() + 1) * 8 / 7
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

impl Cells {
    /// The blocks that hold them.
    fn blocks(&self) -> impl Iterator<Item = BinKey> + use<> {
        let [x, y, z] = [0, 1, 2]
            .map(|axis| self.first[axis].div_euclid(SIDE)..=(self.end[axis] - 1).div_euclid(SIDE));
        z.flat_map(move |z| {
            let x = x.clone();
            y.clone()
                .flat_map(move |y| x.clone().map(move |x| BinKey([x, y, z])))
        })
    }

    /// Calls `visit` with each row of a block and the bits of these cells in it, while it answers true; true at the end.
    fn rows_in(&self, key: BinKey, mut visit: impl FnMut(usize, u8) -> bool) -> bool {
        let [x, y, z] = [0, 1, 2].map(|axis| {
            let origin = key.0[axis] * SIDE;
            let clamp = |cell: i32| {
                usize::try_from((cell - origin).clamp(0, SIDE)).expect("it is from 0 to 8")
            };
            clamp(self.first[axis])..clamp(self.end[axis])
        });
        let bits = (0xff_u8
            .checked_shl(u32::try_from(x.start).expect("at most 8"))
            .unwrap_or(0))
            & !(0xff_u8
                .checked_shl(u32::try_from(x.end).expect("at most 8"))
                .unwrap_or(0));
        z.into_iter()
            .all(|z| y.clone().all(|y| visit(z * 8 + y, bits)))
    }
}

impl Hash for BinKey {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        hasher.write_u64(BinKey::hash(*self));
    }
}

/// Takes the hash of a bin as it is.
#[derive(Default)]
struct BinHasher(u64);

impl Hasher for BinHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, _: &[u8]) {
        unreachable!("a bin is hashed by itself");
    }

    fn write_u64(&mut self, hash: u64) {
        self.0 = hash;
    }
}
