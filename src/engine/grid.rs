//! The persistent uniform grid: cubes by where they are, sparse, in blocks of eight.
//!
//! ```text
//!   bins: hash of (x, y, z) >> shift ──> Bin { blocks: [Block { x[8] y[8] z[8] id[8] }, ..], len }
//! ```
//!
//! Each cube is stored once, in the bin of its lower corner. Bins are cubes of side `2^shift`, at least three edges and
//! wider where cubes are sparse; an empty bin does not exist. The bins decide time and space, never a result.

use std::collections::{BTreeMap, HashMap};
use std::hash::{BuildHasherDefault, Hash, Hasher};
use std::ops::ControlFlow;

use crate::geometry::{Bounds, CubeId, Edge, Place};

use super::neighbours::{LANES, Neighbours};

/// Coordinate of an unused lane: farther than any query reaches, even when the difference wraps.
const FAR: i32 = i32::MIN;

/// Eight cubes by coordinate, so that one comparison serves all of them.
#[derive(Clone, Copy, Debug)]
struct Block {
    corner: [[i32; LANES]; 3],
    id: [u64; LANES],
}

const EMPTY_BLOCK: Block = Block {
    corner: [[FAR; LANES]; 3],
    id: [0; LANES],
};

/// Cubes of one bin: all blocks but the last are full.
#[derive(Debug, Default)]
struct Bin {
    blocks: Vec<Block>,
    len: usize,
}

/// Cubes by where they are.
#[derive(Debug)]
pub(super) struct Grid {
    edge: i32,
    shift: u32,
    /// The least shift that crowds may bring; none when the bins are fixed.
    narrowest: Option<u32>,
    bins: HashMap<BinKey, Bin, BuildHasherDefault<BinHasher>>,
    len: usize,
    /// Numbers of cubes below and above which the bins are looked at again.
    review: [usize; 2],
    extents: [Extent; 3],
}

/// Fewer cubes a bin than this (on average), and bins double their side.
const CROWD_MIN: usize = 6;
/// More cubes a bin than this, and bins that are wider than they need be halve their side.
const CROWD_MAX: usize = 96;
/// Too few cubes to bother.
const REVIEW_MIN: usize = 1024;
/// Widest bins: the whole lattice is eight of them.
const SHIFT_MAX: u32 = 30;

/// Bins start at four to eight edges: a query for touching cubes meets at most eight of them.
const SHIFT_ABOVE_EDGE: u32 = 2;

impl Grid {
    /// A grid for queries that reach an edge to both sides. Crowded bins become as narrow as one or two edges: a query
    /// then meets at most 64.
    pub(super) fn for_neighbours(edge: Edge) -> Self {
        Self::adaptive(edge, 0)
    }

    /// A grid for queries that reach an edge to one side; crowded bins become as narrow as a quarter of an edge.
    pub(super) fn for_small_boxes(edge: Edge) -> Self {
        Self::adaptive(edge, 2)
    }

    fn adaptive(edge: Edge, below_edge: u32) -> Self {
        let shift = edge.steps().cast_unsigned().next_power_of_two().ilog2();
        Self::build(
            edge,
            shift + SHIFT_ABOVE_EDGE,
            Some(shift.saturating_sub(below_edge)),
        )
    }

    /// A grid whose bins stay `2^shift` steps wide.
    pub(super) fn with_bins(edge: Edge, shift: u32) -> Self {
        Self::build(edge, shift.min(SHIFT_MAX), None)
    }

    fn build(edge: Edge, shift: u32, narrowest: Option<u32>) -> Self {
        Self {
            edge: edge.steps(),
            shift,
            narrowest,
            bins: HashMap::default(),
            len: 0,
            review: [0, REVIEW_MIN],
            extents: Default::default(),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.len
    }

    pub(super) fn insert(&mut self, place: Place, id: CubeId) {
        self.put(place, id);
        if self.len > self.review[1] {
            self.review_bins();
        }
    }

    fn put(&mut self, place: Place, id: CubeId) {
        let corner = place.corner();
        let key = self.key(corner);
        let bin = self.bins.entry(key).or_default();
        let lane = bin.len % LANES;
        if lane == 0 {
            // A quarter more than there is: doubling would cost more bytes than the cubes.
            if bin.blocks.len() == bin.blocks.capacity() {
                bin.blocks.reserve_exact(bin.blocks.len() / 4 + 1);
            }
            bin.blocks.push(EMPTY_BLOCK);
        }
        let block = bin
            .blocks
            .last_mut()
            .expect("a block was there or has just been pushed");
        for (axis, coordinate) in corner.into_iter().enumerate() {
            block.corner[axis][lane] = coordinate;
            self.extents[axis].insert(key.0[axis], coordinate);
        }
        block.id[lane] = id.0;
        bin.len += 1;
        self.len += 1;
    }

    /// Removes a cube; false when it is not here.
    pub(super) fn remove(&mut self, place: Place, id: CubeId) -> bool {
        let corner = place.corner();
        let key = self.key(corner);
        let Some(bin) = self.bins.get_mut(&key) else {
            return false;
        };
        let Some(index) = bin.position(corner, Some(id)) else {
            return false;
        };
        bin.swap_remove(index);
        if bin.len == 0 {
            self.bins.remove(&key);
            if self.bins.len() * 8 < self.bins.capacity() {
                self.bins.shrink_to(self.bins.len() * 2);
            }
        }
        for (axis, coordinate) in corner.into_iter().enumerate() {
            self.extents[axis].remove(key.0[axis], coordinate);
        }
        self.len -= 1;
        if self.len < self.review[0] {
            self.review_bins();
        }
        true
    }

    /// Id of some cube at exactly this place.
    pub(super) fn at(&self, place: Place) -> Option<CubeId> {
        let corner = place.corner();
        let bin = self.bins.get(&self.key(corner))?;
        let index = bin.position(corner, None)?;
        Some(CubeId(bin.blocks[index / LANES].id[index % LANES]))
    }

    /// Gives the cube `from` at `place` another id; false when it is not here.
    pub(super) fn rename(&mut self, place: Place, from: CubeId, to: CubeId) -> bool {
        let corner = place.corner();
        let key = self.key(corner);
        let Some(bin) = self.bins.get_mut(&key) else {
            return false;
        };
        let Some(index) = bin.position(corner, Some(from)) else {
            return false;
        };
        bin.blocks[index / LANES].id[index % LANES] = to.0;
        true
    }

    /// Calls `visit` for every cube whose lower corner lies in the closed box from `min` to `max`, until it breaks.
    pub(super) fn visit<B>(
        &self,
        min: [i32; 3],
        max: [i32; 3],
        mut visit: impl FnMut([i32; 3], CubeId) -> ControlFlow<B>,
    ) -> ControlFlow<B> {
        self.visit_blocks(min, max, |block, lane| {
            let corner = block.corner.map(|lanes| lanes[lane]);
            visit(corner, CubeId(block.id[lane]))
        })
    }

    /// Finds every cube that touches the cube at `corner` (closed boxes), cubes at the very same place included.
    pub(super) fn gather(&self, corner: [i32; 3], neighbours: &mut Neighbours) {
        let min = corner.map(|coordinate| coordinate - self.edge);
        let max = corner.map(|coordinate| coordinate + self.edge);
        neighbours.clear();
        let all: ControlFlow<()> = self.visit_blocks(min, max, |block, lane| {
            neighbours.reserve(1);
            neighbours.push([
                block.corner[0][lane] - corner[0],
                block.corner[1][lane] - corner[1],
                block.corner[2][lane] - corner[2],
            ]);
            ControlFlow::Continue(())
        });
        debug_assert!(all.is_continue(), "gathering never stops early");
    }

    #[inline]
    fn visit_blocks<B>(
        &self,
        min: [i32; 3],
        max: [i32; 3],
        mut visit: impl FnMut(&Block, usize) -> ControlFlow<B>,
    ) -> ControlFlow<B> {
        let (first, last) = (self.key(min), self.key(max));
        // How far each coordinate may be above `min`; unsigned, so that one comparison checks both ends.
        let reach: [u32; 3] =
            std::array::from_fn(|axis| max[axis].wrapping_sub(min[axis]).cast_unsigned());
        for z in first.0[2]..=last.0[2] {
            for y in first.0[1]..=last.0[1] {
                for x in first.0[0]..=last.0[0] {
                    let Some(bin) = self.bins.get(&BinKey([x, y, z])) else {
                        continue;
                    };
                    for block in &bin.blocks {
                        let mut kept = block.lanes_within(min, reach);
                        while kept != 0 {
                            visit(block, kept.trailing_zeros() as usize)?;
                            kept &= kept - 1;
                        }
                    }
                }
            }
        }
        ControlFlow::Continue(())
    }

    /// The box around all cubes.
    pub(super) fn bounds(&mut self) -> Option<Bounds> {
        if self.len == 0 {
            return None;
        }
        let mut bounds = Bounds {
            min: [0; 3],
            max: [0; 3],
        };
        for axis in 0..3 {
            let bins = &self.bins;
            let layer = |layer: i32| {
                bins.iter()
                    .filter(move |(key, _)| key.0[axis] == layer)
                    .flat_map(move |(_, bin)| bin.corners().map(move |corner| corner[axis]))
            };
            let [min, max] = self.extents[axis].ends(layer);
            bounds.min[axis] = min;
            bounds.max[axis] = max + self.edge;
        }
        Some(bounds)
    }

    /// The lower corners of all cubes.
    pub(super) fn corners(&self) -> impl Iterator<Item = [i32; 3]> + '_ {
        self.bins.values().flat_map(Bin::corners)
    }

    /// Bytes of bins and blocks, without the allocator's own.
    pub(super) fn size(&self) -> usize {
        let blocks: usize = self.bins.values().map(|bin| bin.blocks.capacity()).sum();
        blocks * size_of::<Block>()
            + self.bins.capacity() * (size_of::<(BinKey, Bin)>() + 1) * 8 / 7
    }

    fn key(&self, corner: [i32; 3]) -> BinKey {
        BinKey(corner.map(|coordinate| coordinate >> self.shift))
    }

    /// Looks whether the bins still suit the cubes, and builds the index anew when they do not: O(cubes), and only when
    /// their number has doubled or halved since.
    #[cold]
    fn review_bins(&mut self) {
        self.review = [self.len / 2, (self.len * 2).max(REVIEW_MIN)];
        let Some(narrowest) = self.narrowest else {
            return;
        };
        if self.len < REVIEW_MIN {
            return;
        }
        while self.len < CROWD_MIN * self.bins.len() && self.shift < SHIFT_MAX {
            self.rebuild(self.shift + 1);
        }
        while self.len > CROWD_MAX * self.bins.len() && self.shift > narrowest {
            self.rebuild(self.shift - 1);
        }
    }

    fn rebuild(&mut self, shift: u32) {
        let bins = std::mem::take(&mut self.bins);
        self.shift = shift;
        self.len = 0;
        self.extents = Default::default();
        for bin in bins.into_values() {
            for index in 0..bin.len {
                let block = &bin.blocks[index / LANES];
                let corner = block.corner.map(|lanes| lanes[index % LANES]);
                self.put(Place::from_checked(corner), CubeId(block.id[index % LANES]));
            }
        }
    }
}

impl Bin {
    fn position(&self, corner: [i32; 3], id: Option<CubeId>) -> Option<usize> {
        self.blocks.iter().enumerate().find_map(|(number, block)| {
            let mut kept = block.lanes_within(corner, [0; 3]);
            while kept != 0 {
                let lane = kept.trailing_zeros() as usize;
                if id.is_none_or(|id| id.0 == block.id[lane]) {
                    return Some(number * LANES + lane);
                }
                kept &= kept - 1;
            }
            None
        })
    }

    /// The last cube takes the place of the removed one.
    fn swap_remove(&mut self, index: usize) {
        self.len -= 1;
        let (from, last) = (self.len % LANES, self.blocks[self.len / LANES]);
        let to = &mut self.blocks[index / LANES];
        for axis in 0..3 {
            to.corner[axis][index % LANES] = last.corner[axis][from];
        }
        to.id[index % LANES] = last.id[from];
        let vacated = &mut self.blocks[self.len / LANES];
        for axis in 0..3 {
            vacated.corner[axis][from] = FAR;
        }
        if from == 0 {
            self.blocks.pop();
            if self.blocks.len() * 2 < self.blocks.capacity() {
                self.blocks.shrink_to(self.blocks.len() * 5 / 4);
            }
        }
    }

    fn corners(&self) -> impl Iterator<Item = [i32; 3]> + '_ {
        (0..self.len).map(|index| {
            self.blocks[index / LANES]
                .corner
                .map(|lanes| lanes[index % LANES])
        })
    }
}

impl Block {
    /// Bits of the lanes whose corner lies within `reach` above `min` on every axis. Written for the vectoriser.
    #[inline]
    fn lanes_within(&self, min: [i32; 3], reach: [u32; 3]) -> u32 {
        let mut kept = 0;
        for lane in 0..LANES {
            let within = |axis: usize| {
                self.corner[axis][lane]
                    .wrapping_sub(min[axis])
                    .cast_unsigned()
                    <= reach[axis]
            };
            kept |= u32::from(within(0) & within(1) & within(2)) << lane;
        }
        kept
    }
}

/// The least and greatest coordinate along one axis, counted: exact after every deletion.
///
/// Cubes are counted by layer of bins; coordinates are counted one by one only in outermost layers, which are looked
/// through when they become outermost.
#[derive(Debug, Default)]
struct Extent {
    layers: BTreeMap<i32, u32>,
    /// Cubes by coordinate in the layers looked through last, oldest first.
    details: Vec<(i32, BTreeMap<i32, u32>)>,
}

/// Enough for both ends and for one more each, so that a cube that comes and goes beyond the others costs nothing.
const DETAILS_MAX: usize = 4;

impl Extent {
    fn insert(&mut self, layer: i32, coordinate: i32) {
        *self.layers.entry(layer).or_default() += 1;
        if let Some(detail) = self.detail(layer) {
            *detail.entry(coordinate).or_default() += 1;
        }
    }

    fn remove(&mut self, layer: i32, coordinate: i32) {
        decrement(&mut self.layers, layer);
        if let Some(detail) = self.detail(layer) {
            decrement(detail, coordinate);
        }
        if !self.layers.contains_key(&layer) {
            self.details.retain(|(of, _)| *of != layer);
        }
    }

    fn detail(&mut self, layer: i32) -> Option<&mut BTreeMap<i32, u32>> {
        self.details
            .iter_mut()
            .find(|(of, _)| *of == layer)
            .map(|(_, detail)| detail)
    }

    /// Least and greatest coordinate; `coordinates` lists those of a layer.
    fn ends<I: Iterator<Item = i32>>(&mut self, coordinates: impl Fn(i32) -> I) -> [i32; 2] {
        let ends = [self.layers.first_key_value(), self.layers.last_key_value()];
        let layers = ends.map(|end| *end.expect("a grid with cubes has layers").0);
        for layer in layers {
            if self.detail(layer).is_none() {
                let mut detail = BTreeMap::new();
                for coordinate in coordinates(layer) {
                    *detail.entry(coordinate).or_default() += 1;
                }
                if self.details.len() == DETAILS_MAX {
                    let oldest = self.details.iter().position(|(of, _)| !layers.contains(of));
                    self.details
                        .remove(oldest.expect("two of four layers are not outermost"));
                }
                self.details.push((layer, detail));
            }
        }
        let [first, last] = layers.map(|layer| {
            let detail = self.details.iter().find(|(of, _)| *of == layer);
            &detail.expect("both were looked through above").1
        });
        let min = first
            .first_key_value()
            .expect("an outermost layer has cubes")
            .0;
        let max = last
            .last_key_value()
            .expect("an outermost layer has cubes")
            .0;
        [*min, *max]
    }
}

fn decrement(counts: &mut BTreeMap<i32, u32>, key: i32) {
    let count = counts
        .get_mut(&key)
        .expect("what is removed was counted when it was inserted");
    *count -= 1;
    if *count == 0 {
        counts.remove(&key);
    }
}

/// Which bin: the coordinates of its cubes, shifted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct BinKey(pub(super) [i32; 3]);

impl Hash for BinKey {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        for coordinate in self.0 {
            hasher.write_i32(coordinate);
        }
    }
}

/// Mixes the three coordinates of a bin. No secret: who could choose colliding bins could as well choose crowded ones.
#[derive(Default)]
pub(super) struct BinHasher(u64);

impl Hasher for BinHasher {
    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 32)
    }

    fn write(&mut self, _: &[u8]) {
        unreachable!("a bin is hashed coordinate by coordinate");
    }

    fn write_i32(&mut self, coordinate: i32) {
        let mixed = self.0.rotate_left(23) ^ u64::from(coordinate.cast_unsigned());
        self.0 = mixed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
}
