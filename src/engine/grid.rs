//! The persistent uniform grid: cubes by where they are, sparse.
//!
//! Each cube is stored once, in the bin of its lower corner. Bins are cubes of side `2^shift`, at least as wide as an
//! edge (where queries reach an edge to both sides) and wider where cubes are sparse; an empty bin does not exist. The
//! bins decide time and space, never a result.

use std::cmp::Ordering;
use std::ops::ControlFlow;

use crate::geometry::{Bounds, CubeId, Edge, Place};

use super::bins::{Bin, BinKey, Bins};
use super::extents::Extents;
use super::neighbours::Neighbours;
use super::scan::{Avx2, collect};

/// Cubes by where they are.
#[derive(Debug)]
pub(super) struct Grid {
    edge: i32,
    shift: u32,
    /// The least shift that crowds may bring; none when the bins are fixed.
    narrowest: Option<u32>,
    avx2: Option<Avx2>,
    bins: Bins,
    len: usize,
    /// Numbers of cubes below and above which the bins are looked at again.
    review: [usize; 2],
    extents: Extents,
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

/// Bins that a query looks for at the same time.
const BINS_AT_ONCE: usize = 8;

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
            avx2: Avx2::detect(),
            bins: Bins::new(),
            len: 0,
            review: [0, REVIEW_MIN],
            extents: Extents::new(),
        }
    }

    /// The same, without special instructions.
    pub(super) fn plain(mut self) -> Self {
        self.avx2 = None;
        self
    }

    pub(super) fn len(&self) -> usize {
        self.len
    }

    pub(super) fn insert(&mut self, place: Place, id: CubeId) {
        let corner = place.corner();
        let key = self.key(corner);
        let (change, _) = self.bins.push(key, corner, id, 0);
        self.len += 1;
        self.extents.insert(corner, key, change, self.len == 1);
        self.review();
    }

    /// Removes a cube; false when it is not here.
    pub(super) fn remove(&mut self, place: Place, id: CubeId) -> bool {
        let corner = place.corner();
        let key = self.key(corner);
        let Some(bin) = self.bins.get(key) else {
            return false;
        };
        let Some(index) = bin.position(self.avx2, corner, Some(id)) else {
            return false;
        };
        let change = self.bins.swap_remove(key, index);
        self.len -= 1;
        self.extents.remove(corner, key, change);
        self.review();
        true
    }

    /// Id of some cube at exactly this place.
    pub(super) fn at(&self, place: Place) -> Option<CubeId> {
        let corner = place.corner();
        let bin = self.bins.get(self.key(corner))?;
        let index = bin.position(self.avx2, corner, None)?;
        Some(bin.id(index))
    }

    /// Gives the cube `from` at `place` another id; false when it is not here.
    pub(super) fn rename(&mut self, place: Place, from: CubeId, to: CubeId) -> bool {
        let corner = place.corner();
        let avx2 = self.avx2;
        let Some(bin) = self.bins.get_mut(self.key(corner)) else {
            return false;
        };
        let Some(index) = bin.position(avx2, corner, Some(from)) else {
            return false;
        };
        bin.set_id(index, to);
        true
    }

    /// Calls `visit` for every cube whose lower corner lies in the closed box from `min` to `max`, until it breaks.
    pub(super) fn visit<B>(
        &self,
        min: [i32; 3],
        max: [i32; 3],
        mut visit: impl FnMut([i32; 3], CubeId) -> ControlFlow<B>,
    ) -> ControlFlow<B> {
        // How far each coordinate may be above `min`; unsigned, so that one comparison checks both ends.
        let reach: [u32; 3] =
            std::array::from_fn(|axis| max[axis].wrapping_sub(min[axis]).cast_unsigned());
        let mut flow = ControlFlow::Continue(());
        self.visit_bins(min, max, |bin| {
            bin.visit(self.avx2, min, reach, |index| {
                flow = visit(bin.corner(index), bin.id(index));
                flow.is_break()
            });
            flow.is_break()
        });
        flow
    }

    /// Finds every cube that touches the cube at `corner` (closed boxes), cubes at the very same place included.
    pub(super) fn gather(&self, corner: [i32; 3], neighbours: &mut Neighbours) {
        neighbours.clear();
        let min = corner.map(|coordinate| coordinate - self.edge);
        let max = corner.map(|coordinate| coordinate + self.edge);
        self.visit_bins(min, max, |bin| {
            collect(
                self.avx2,
                bin.corners(),
                bin.len(),
                corner,
                self.edge,
                neighbours,
            );
            false
        });
    }

    /// Calls `visit` with every bin that has a part in the box, until it answers true. Many bins at a time are looked for
    /// and their memory asked for before the first of them is visited, so that waiting for it overlaps.
    #[inline]
    fn visit_bins<'a>(
        &'a self,
        min: [i32; 3],
        max: [i32; 3],
        mut visit: impl FnMut(&'a Bin) -> bool,
    ) {
        let (BinKey(first), BinKey(last)) = (self.key(min), self.key(max));
        let mut next = first;
        let mut more = true;
        while more {
            let mut keys = [(BinKey([0; 3]), 0); BINS_AT_ONCE];
            let mut count = 0;
            while more && count < BINS_AT_ONCE {
                let key = BinKey(next);
                let hash = key.hash();
                self.bins.prefetch(hash);
                keys[count] = (key, hash);
                count += 1;
                more = advance(&mut next, first, last);
            }
            let mut found = [None; BINS_AT_ONCE];
            let mut bins = 0;
            for (key, hash) in &keys[..count] {
                if let Some(bin) = self.bins.get_hashed(*key, *hash) {
                    bin.prefetch();
                    found[bins] = Some(bin);
                    bins += 1;
                }
            }
            for bin in found[..bins].iter().flatten() {
                if visit(bin) {
                    return;
                }
            }
        }
    }

    /// The same without the cubes that come after the cube at `index` of a bin, nor that cube itself: see `batch`.
    pub(super) fn gather_before(
        &self,
        key: BinKey,
        index: usize,
        corner: [i32; 3],
        neighbours: &mut Neighbours,
    ) {
        neighbours.clear();
        let min = corner.map(|coordinate| coordinate - self.edge);
        let max = corner.map(|coordinate| coordinate + self.edge);
        self.visit_bins(min, max, |bin| {
            let count = match bin.key().cmp(&key) {
                Ordering::Less => bin.len(),
                Ordering::Equal => index,
                Ordering::Greater => bin.len() - bin.fresh(),
            };
            collect(
                self.avx2,
                bin.corners(),
                count,
                corner,
                self.edge,
                neighbours,
            );
            false
        });
    }

    /// A bin that there may be.
    pub(super) fn bin(&self, key: BinKey) -> Option<&Bin> {
        self.bins.get(key)
    }

    /// Inserts a cube of a batch; the bin when it is the first one there. The bins are not reviewed meanwhile.
    pub(super) fn insert_fresh(&mut self, place: Place, id: CubeId) -> Option<BinKey> {
        let corner = place.corner();
        let key = self.key(corner);
        let (change, fresh) = self.bins.push(key, corner, id, 1);
        self.len += 1;
        self.extents.insert(corner, key, change, self.len == 1);
        (fresh == 1).then_some(key)
    }

    /// Moves a cube behind those of its bin that stay; the bin when it is the first one there.
    pub(super) fn make_fresh(&mut self, place: Place, id: CubeId) -> Option<BinKey> {
        let key = self.key(place.corner());
        let avx2 = self.avx2;
        let bin = self.bins.get_mut(key);
        let bin = bin.expect("a cube that is not hidden is visible");
        let index = bin.position(avx2, place.corner(), Some(id));
        let fresh = bin.fresh() + 1;
        bin.swap(
            index.expect("a cube that is not hidden is visible"),
            bin.len() - fresh,
        );
        bin.set_fresh(fresh);
        (fresh == 1).then_some(key)
    }

    /// Removes one of the fresh cubes of a bin.
    pub(super) fn remove_fresh(&mut self, key: BinKey, index: usize) -> (Place, CubeId) {
        let bin = self.bins.get_mut(key).expect("it has fresh cubes");
        let (corner, id) = (bin.corner(index), bin.id(index));
        bin.set_fresh(bin.fresh() - 1);
        let change = self.bins.swap_remove(key, index);
        self.len -= 1;
        self.extents.remove(corner, key, change);
        (Place::from_checked(corner), id)
    }

    pub(super) fn remove_all_fresh(&mut self, key: BinKey) {
        while let Some(bin) = self.bins.get(key).filter(|bin| bin.fresh() > 0) {
            self.remove_fresh(key, bin.len() - 1);
        }
    }

    /// Makes the fresh cubes of a bin ordinary ones.
    pub(super) fn settle(&mut self, key: BinKey) {
        if let Some(bin) = self.bins.get_mut(key) {
            bin.set_fresh(0);
        }
    }

    /// Asks for the memory in which the bin of a cube is looked for.
    pub(super) fn prefetch(&self, place: Place) {
        self.bins.prefetch(self.key(place.corner()).hash());
    }

    pub(super) fn shift(&self) -> u32 {
        self.shift
    }

    /// The box around all cubes.
    pub(super) fn bounds(&mut self) -> Option<Bounds> {
        if self.len == 0 {
            return None;
        }
        let [min, max] = self.extents.ends(&self.bins);
        Some(Bounds {
            min,
            max: max.map(|greatest| greatest + self.edge),
        })
    }

    /// The lower corners of all cubes.
    pub(super) fn corners(&self) -> impl Iterator<Item = [i32; 3]> + '_ {
        let bins = self.bins.iter();
        bins.flat_map(|bin| (0..bin.len()).map(|index| bin.corner(index)))
    }

    /// Bytes of bins and tables, without the allocator's own. O(1).
    pub(super) fn size(&self) -> usize {
        self.bins.size()
    }

    fn key(&self, corner: [i32; 3]) -> BinKey {
        BinKey(corner.map(|coordinate| coordinate >> self.shift))
    }

    /// Looks after the bins when the number of cubes has changed much.
    #[inline]
    pub(super) fn review(&mut self) {
        if !(self.review[0]..=self.review[1]).contains(&self.len) {
            self.review_bins();
        }
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
        self.shift = shift;
        self.extents.forget_bins();
        for bin in std::mem::replace(&mut self.bins, Bins::new()).into_bins() {
            for index in 0..bin.len() {
                let corner = bin.corner(index);
                self.bins.push(self.key(corner), corner, bin.id(index), 0);
            }
        }
    }
}

/// The next key of a box, x first; false behind the last one.
#[inline]
fn advance(next: &mut [i32; 3], first: [i32; 3], last: [i32; 3]) -> bool {
    for axis in 0..3 {
        if next[axis] < last[axis] {
            next[axis] += 1;
            return true;
        }
        next[axis] = first[axis];
    }
    false
}
