//! The persistent uniform grid: cubes by where they are, sparse, and as fine as they are dense.
//!
//! ```text
//!   level 0   bins of side 2^shift           [  ][  ][##][  ]        most cubes are here
//!   level 1   half as wide, where a bin               [][#]          of level 0 is divided, because it was overfull
//! ```
//!
//! Each cube is stored once, in the one undivided bin that holds its lower corner. Bins are at least as wide as an edge
//! (where queries reach an edge to both sides) and wider where cubes are sparse; an empty bin does not exist. The bins
//! decide time and space, never a result.
//!
//! When most bins of level 0 are divided, it is given up; when there are few cubes in a bin, a wider level is put before
//! it. Either is an incremental rehash, a few bins with every change, so that no change waits for all of them.

use std::cmp::Ordering;
use std::ops::{ControlFlow, Range};

use crate::geometry::{Bounds, CubeId, Edge, Place};

use super::bins::{Bin, BinKey, Bins, CubeWalk, Share, Walk};
use super::extents::{Along, Extents};
use super::lanes::{Avx2, avx2};
use super::neighbours::Neighbours;
use super::parallel::in_parallel;
use super::scan::collect;

/// Cubes by where they are.
#[derive(Debug)]
pub(super) struct Grid {
    edge: i32,
    /// The widest bins first, each level half as wide as the one before; at least one.
    levels: Vec<Bins>,
    /// Width of the bins of level 0: `2^shift` steps.
    shift: u32,
    /// The least shift that overfull bins may bring; none when the bins are fixed.
    narrowest: Option<u32>,
    rehash: Rehash,
    avx2: Option<Avx2>,
    len: usize,
    /// Numbers of cubes below and above which the bins are looked at again.
    review: [usize; 2],
    extents: Extents,
}

/// The incremental rehash of level 0 that is under way.
#[derive(Clone, Copy, Debug)]
enum Rehash {
    /// Nothing.
    Idle,
    /// It is being divided, to be given up.
    Narrow(Walk),
    /// It is new, and so many bins of level 1 are not below any of its bins yet.
    Widen(Walk, usize),
}

/// Where an undivided bin is.
#[derive(Clone, Copy, Debug)]
pub(super) struct BinAddress {
    level: usize,
    key: BinKey,
}

/// What is due at the end of a batch: first to divide the overfull bins, then to unite the sparse ones, then to continue the rehash
/// for each cube.
#[derive(Default)]
pub(super) struct Due {
    pub(super) overfull: Vec<BinAddress>,
    pub(super) corners: Vec<[i32; 3]>,
    /// How many cubes of the batch stayed.
    pub(super) cubes: usize,
}

/// What came of cubes put into a share of a level.
#[derive(Default)]
struct Filled {
    /// Bins that have fresh cubes for the first time.
    touched: Vec<BinKey>,
    /// Cubes whose bins are divided, to be put into the next level.
    divided: Vec<Range<usize>>,
}

/// Cubes beside each other in a list, all of one bin.
struct Run {
    key: BinKey,
    hash: u64,
    range: Range<usize>,
}

/// Cubes that one step puts into a grid or removes from it.
pub(super) const CUBES_A_STEP: usize = 256;

/// Runs that are prefetched together.
const RUNS_AT_ONCE: usize = 128;

/// More cubes in a bin than this, and it is divided.
const BIN_MAX: usize = 160;
/// So few cubes in a divided bin, and it is one again; when a level is widened, twice as many.
const BIN_MIN: usize = 40;
/// Fewer cubes a bin than this (on average), and the bins become wider.
const MEAN_MIN: usize = 6;
/// Too few cubes to bother.
const REVIEW_MIN: usize = 1024;
/// Few enough to look at all of them: some milliseconds.
const FEW: usize = 8192;
/// Widest bins: the whole lattice is eight of them.
const SHIFT_MAX: u32 = 30;

/// Bins start at four to eight edges: a query for touching cubes meets at most eight of them.
const SHIFT_ABOVE_EDGE: u32 = 2;

/// Bins that a query looks for at the same time.
const BINS_AT_ONCE: usize = 8;

/// Bins that one change rehashes.
const BINS_A_CHANGE: usize = 2;

impl Grid {
    /// A grid for queries that reach an edge to both sides. Overfull bins become as narrow as one or two edges: a query
    /// then meets at most 64.
    pub(super) fn for_neighbours(edge: Edge) -> Self {
        Self::adaptive(edge, 0)
    }

    /// A grid for queries that reach an edge to one side; overfull bins become as narrow as a quarter of an edge.
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
            levels: vec![Bins::new()],
            shift,
            narrowest,
            rehash: Rehash::Idle,
            avx2: avx2(),
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
        let address = self.address_for(corner);
        let count = self.levels[address.level].push(address.key, corner, id);
        self.len += 1;
        self.extents.insert(corner, self.len == 1);
        if count > BIN_MAX {
            self.divide_overfull(address);
        }
        self.continue_rehash();
    }

    /// Removes a cube; false when it is not here.
    pub(super) fn remove(&mut self, place: Place, id: CubeId) -> bool {
        let corner = place.corner();
        self.rehash_key(self.key(0, corner));
        let Some((address, index)) = self.find(corner, Some(id)) else {
            return false;
        };
        self.remove_at(address, index);
        self.unite_sparse(corner);
        self.continue_rehash();
        true
    }

    /// Id of some cube at exactly this place.
    pub(super) fn at(&self, place: Place) -> Option<CubeId> {
        let (address, index) = self.find(place.corner(), None)?;
        Some(self.bin(address)?.id(index))
    }

    /// Gives the cube `from` at `place` another id; false when it is not here.
    pub(super) fn rename(&mut self, place: Place, from: CubeId, to: CubeId) -> bool {
        let Some((address, index)) = self.find(place.corner(), Some(from)) else {
            return false;
        };
        self.bin_mut(address).set_id(index, to);
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
        self.visit_bins(min, max, &mut |_, bin| {
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
        self.gather_of(corner, neighbours, |_, bin| bin.len());
    }

    /// The same without the cubes that come after the cube at `index` of a bin, nor that cube itself: see `batch`.
    pub(super) fn gather_before(
        &self,
        address: BinAddress,
        index: usize,
        corner: [i32; 3],
        neighbours: &mut Neighbours,
    ) {
        let own = self.corner_of(address);
        self.gather_of(corner, neighbours, |address, bin| {
            match self.corner_of(address).cmp(&own) {
                Ordering::Less => bin.len(),
                Ordering::Equal => index,
                Ordering::Greater => bin.len() - bin.fresh(),
            }
        });
    }

    /// The first so many cubes of each bin.
    #[inline]
    fn gather_of(
        &self,
        corner: [i32; 3],
        neighbours: &mut Neighbours,
        count: impl Fn(BinAddress, &Bin) -> usize,
    ) {
        neighbours.clear();
        let min = corner.map(|coordinate| coordinate - self.edge);
        let max = corner.map(|coordinate| coordinate + self.edge);
        self.visit_bins(min, max, &mut |address, bin| {
            let count = count(address, bin);
            let corners = bin.corners();
            collect(self.avx2, corners, count, corner, self.edge, neighbours);
            false
        });
    }

    /// The box around all cubes.
    pub(super) fn bounds(&mut self) -> Option<Bounds> {
        if self.len == 0 {
            return None;
        }
        let (levels, base) = (&self.levels, self.shift);
        let [min, max] = self.extents.ends(|axis, [from, to]| {
            let bins = levels.iter().enumerate().flat_map(move |(level, bins)| {
                let shift = shift_of(base, level);
                let near = (from >> shift)..=(to >> shift);
                bins.iter()
                    .filter(move |bin| near.contains(&bin.key().0[axis]))
            });
            bins.flat_map(move |bin| bin.column(axis).iter().copied())
        });
        Some(Bounds {
            min,
            max: max.map(|greatest| greatest + self.edge),
        })
    }

    /// Shows the next corners of a walk over all cubes, until the work is as much as that of `budget` of them; what is left of the
    /// budget once the walk has come to its end. It goes on while cubes and levels come and go: some cubes may be met twice or
    /// not at all.
    pub(super) fn next_corners(
        &self,
        (level, walk): &mut (usize, CubeWalk),
        budget: usize,
        mut visit: impl FnMut([i32; 3]),
    ) -> usize {
        let mut left = budget;
        while left > 0 && *level < self.levels.len() {
            left = self.levels[*level].next_corners(walk, left, &mut visit);
            if left > 0 {
                (*level, *walk) = (*level + 1, CubeWalk::default());
            }
        }
        left
    }

    /// Bytes of bins and tables, without the allocator's own. O(1).
    pub(super) fn size(&self) -> usize {
        self.levels.iter().map(Bins::size).sum()
    }

    /// Width of the bins of the first level: `2^shift` steps.
    pub(super) fn shift(&self) -> u32 {
        self.shift
    }

    /// Prefetches where the search for the bin of a cube begins.
    #[inline]
    pub(super) fn prefetch(&self, place: Place) {
        self.levels[0].prefetch(self.key(0, place.corner()).hash());
    }

    /// Prefetches where the search for the bin of a cube begins, on all levels.
    #[inline]
    pub(super) fn prefetch_levels(&self, place: Place) {
        for (level, bins) in self.levels.iter().enumerate() {
            bins.prefetch(self.key(level, place.corner()).hash());
        }
    }

    /// Prefetches where a cube is put.
    #[inline]
    pub(super) fn prefetch_end(&self, place: Place) {
        for (level, bins) in self.levels.iter().enumerate() {
            match bins.get(self.key(level, place.corner())) {
                Some(bin) if !bin.is_divided() => return bin.prefetch_end(),
                None if !self.may_be_below(level) => return,
                Some(_) | None => {}
            }
        }
    }

    /// Prefetches where the search for the bins around a cube begins, on the level that has most of them, where these are few.
    #[inline]
    pub(super) fn prefetch_around(&self, place: Place) {
        let levels = self.levels.iter().enumerate();
        let Some((level, bins)) = levels.max_by_key(|(_, bins)| bins.len()) else {
            return;
        };
        let corner = place.corner();
        let first = self.key(level, corner.map(|coordinate| coordinate - self.edge));
        let last = self.key(level, corner.map(|coordinate| coordinate + self.edge));
        let near = |axis: usize| last.0[axis] - first.0[axis] <= 1;
        if !(near(0) && near(1) && near(2)) {
            return;
        }
        let mut next = first.0;
        loop {
            bins.prefetch(BinKey(next).hash());
            if !advance(&mut next, first.0, last.0) {
                return;
            }
        }
    }

    /// Inserts cubes of a batch, best those of one bin one after the other, and notes the bins in which they are the first.
    pub(super) fn insert_fresh(
        &mut self,
        cubes: &[(CubeId, Place)],
        touched: &mut Vec<BinAddress>,
    ) {
        self.prefetch_all(cubes);
        let mut cubes = cubes.iter().peekable();
        while let Some((_, place)) = cubes.peek() {
            let address = self.address_for(place.corner());
            let shift = shift_of(self.shift, address.level);
            // Each cube is counted in the divided bins above it.
            let mut most = if address.level == 0 { usize::MAX } else { 1 };
            let Self {
                levels,
                extents,
                len,
                ..
            } = self;
            let run = std::iter::from_fn(|| {
                most = most.checked_sub(1)?;
                let is_here =
                    |place: &Place| place.corner().map(|part| part >> shift) == address.key.0;
                let (id, place) = cubes.next_if(|(_, place)| is_here(place))?;
                *len += 1;
                extents.insert(place.corner(), *len == 1);
                Some((place.corner(), *id))
            });
            if levels[address.level].push_fresh(address.key, run) {
                touched.push(address);
            }
        }
    }

    /// The same on several threads, for more cubes at a time: each has some of the tables to itself.
    pub(super) fn insert_fresh_on(
        &mut self,
        threads: usize,
        cubes: &[(CubeId, Place)],
        touched: &mut Vec<BinAddress>,
    ) {
        if self.len == 0 || matches!(self.rehash, Rehash::Widen(..)) {
            for some in cubes.chunks(CUBES_A_STEP) {
                self.insert_fresh(some, touched);
            }
            return;
        }
        self.len += cubes.len();
        let mut axes: Vec<Vec<Along<'_>>> = (0..threads).map(|_| Vec::new()).collect();
        for (number, axis) in self.extents.axes().enumerate() {
            axes[number % threads].push(axis);
        }
        let whole = 0..cubes.len();
        let mut ranges = vec![whole];
        for (level, bins) in self.levels.iter_mut().enumerate() {
            let shift = shift_of(self.shift, level);
            let mut tasks: Vec<_> = bins.shares(threads).zip(&mut axes).collect();
            let filled = in_parallel(&mut tasks, |_, (share, axes)| {
                for mut axis in std::mem::take(*axes) {
                    axis.insert_all(cubes);
                }
                Filled::of(share, shift, cubes, &ranges)
            });
            let growths: Vec<_> = tasks.iter().map(|(share, _)| share.growth()).collect();
            for growth in growths {
                bins.grow(growth);
            }
            ranges.clear();
            for filled in filled {
                let addresses = filled
                    .touched
                    .into_iter()
                    .map(|key| BinAddress { level, key });
                touched.extend(addresses);
                ranges.extend(filled.divided);
            }
            if ranges.is_empty() {
                return;
            }
        }
        debug_assert!(ranges.is_empty(), "the last level has no divided bins");
    }

    /// Prefetches where the search for the bins of cubes begins, then where the next cubes of these bins are put: so the waits
    /// overlap.
    fn prefetch_all(&self, cubes: &[(CubeId, Place)]) {
        let bins = &self.levels[0];
        let keys = cubes.iter().map(|(_, place)| self.key(0, place.corner()));
        let runs = || {
            let mut last = None;
            keys.clone()
                .filter(move |key| last.replace(*key) != Some(*key))
        };
        for key in runs() {
            bins.prefetch(key.hash());
        }
        for bin in runs().filter_map(|key| bins.get(key)) {
            bin.prefetch_end();
        }
    }

    /// Moves a cube behind those of its bin that stay; the bin when it is the first one there.
    pub(super) fn make_fresh(&mut self, place: Place, id: CubeId) -> Option<BinAddress> {
        let corner = place.corner();
        self.rehash_key(self.key(0, corner));
        let found = self.find(corner, Some(id));
        let (address, index) = found.expect("a cube that is not covered is exposed");
        let bin = self.bin_mut(address);
        let fresh = bin.fresh() + 1;
        bin.swap(index, bin.len() - fresh);
        bin.set_fresh(fresh);
        (fresh == 1).then_some(address)
    }

    /// Removes one of the fresh cubes of a bin.
    pub(super) fn remove_fresh(&mut self, address: BinAddress, index: usize) -> (Place, CubeId) {
        let bin = self.bin_mut(address);
        let (corner, id) = (bin.corner(index), bin.id(index));
        bin.set_fresh(bin.fresh() - 1);
        self.remove_at(address, index);
        (Place::from_checked(corner), id)
    }

    /// Removes all fresh cubes of a bin.
    pub(super) fn remove_all_fresh(&mut self, address: BinAddress) {
        while let Some(bin) = self.bin(address).filter(|bin| bin.fresh() > 0) {
            self.remove_fresh(address, bin.len() - 1);
        }
    }

    /// Makes the fresh cubes of some bins like all others, and notes what is due then.
    pub(super) fn keep_fresh(&mut self, addresses: &[BinAddress], due: &mut Due) {
        for address in addresses {
            due.corners.push(self.corner_of(*address));
            if self.bin(*address).is_some() {
                let bin = self.bin_mut(*address);
                due.cubes += bin.fresh();
                bin.set_fresh(0);
                if bin.len() > BIN_MAX {
                    due.overfull.push(*address);
                }
            }
        }
    }

    /// Whether there are so many cubes around a place that others may be covered by them: as many as would fill the bin
    /// side by side.
    pub(super) fn is_dense_at(&self, place: Place) -> bool {
        let mut level = 0;
        loop {
            let key = self.key(level, place.corner());
            match self.levels[level].get(key) {
                Some(bin) if !bin.is_divided() => return self.is_dense(BinAddress { level, key }),
                None if !self.may_be_below(level) => return false,
                Some(_) | None => level += 1,
            }
        }
    }

    /// The same for a bin.
    pub(super) fn is_dense(&self, address: BinAddress) -> bool {
        let cubes = self.bin(address).map_or(0, Bin::len) as u128;
        let edge = u128::from(self.edge.unsigned_abs());
        let side = 1 << shift_of(self.shift, address.level);
        cubes * edge.pow(3) >= u128::pow(side, 3)
    }

    /// An undivided bin, if it is there.
    pub(super) fn bin(&self, address: BinAddress) -> Option<&Bin> {
        self.levels[address.level].get(address.key)
    }

    fn bin_mut(&mut self, address: BinAddress) -> &mut Bin {
        let bin = self.levels[address.level].get_mut(address.key);
        bin.expect("the bin has been found")
    }

    /// The least corner of a bin: bins that hold cubes do not overlap, so it tells them apart and puts them in order.
    #[inline]
    fn corner_of(&self, address: BinAddress) -> [i32; 3] {
        let shift = shift_of(self.shift, address.level);
        address.key.0.map(|layer| layer << shift)
    }

    #[inline]
    fn key(&self, level: usize, corner: [i32; 3]) -> BinKey {
        key_of(corner, shift_of(self.shift, level))
    }

    /// The undivided bin for a cube that comes, which is counted in the divided ones above it.
    #[inline]
    fn address_for(&mut self, corner: [i32; 3]) -> BinAddress {
        let mut level = 0;
        let mut key = self.key(level, corner);
        self.rehash_key(key);
        while self.levels[level].count_in(key) {
            level += 1;
            key = self.key(level, corner);
        }
        BinAddress { level, key }
    }

    /// The bin and the index in it of a cube at `corner`, of this id if one is given.
    fn find(&self, corner: [i32; 3], id: Option<CubeId>) -> Option<(BinAddress, usize)> {
        let mut level = 0;
        loop {
            let key = self.key(level, corner);
            match self.levels[level].get(key) {
                Some(bin) if !bin.is_divided() => {
                    let index = bin.position(self.avx2, corner, id)?;
                    return Some((BinAddress { level, key }, index));
                }
                None if !self.may_be_below(level) => return None,
                Some(_) | None => level += 1,
            }
        }
    }

    /// Whether cubes may be in the next level although this one has no bin for them.
    #[inline]
    fn may_be_below(&self, level: usize) -> bool {
        level == 0 && matches!(self.rehash, Rehash::Widen(..))
    }

    fn remove_at(&mut self, address: BinAddress, index: usize) {
        let corner = self.bin_mut(address).corner(index);
        self.levels[address.level].swap_remove(address.key, index);
        for level in 0..address.level {
            let key = self.key(level, corner);
            self.levels[level].count_out(key);
        }
        self.len -= 1;
        self.extents.remove(corner);
    }

    /// Calls `visit` with every bin that has a part in the box, until it answers true; true then. Several bins at a time are
    /// looked for and prefetched before the first of them is visited, so that the waits overlap.
    #[inline]
    fn visit_bins<'a>(
        &'a self,
        min: [i32; 3],
        max: [i32; 3],
        visit: &mut impl FnMut(BinAddress, &'a Bin) -> bool,
    ) -> bool {
        let (first, last) = (self.key(0, min), self.key(0, max));
        self.visit_level(0, [first, last], [min, max], visit)
    }

    #[inline]
    fn visit_level<'a>(
        &'a self,
        level: usize,
        [first, last]: [BinKey; 2],
        within: [[i32; 3]; 2],
        visit: &mut impl FnMut(BinAddress, &'a Bin) -> bool,
    ) -> bool {
        let bins = &self.levels[level];
        let mut next = first.0;
        let mut more = true;
        while more {
            let mut keys = [(BinKey([0; 3]), 0); BINS_AT_ONCE];
            let mut count = 0;
            while more && count < BINS_AT_ONCE {
                let key = BinKey(next);
                let hash = key.hash();
                bins.prefetch(hash);
                keys[count] = (key, hash);
                count += 1;
                more = advance(&mut next, first.0, last.0);
            }
            let mut found = [None; BINS_AT_ONCE];
            for ((key, hash), found) in keys[..count].iter().zip(&mut found) {
                *found = bins.get_hashed(*key, *hash);
                if let Some(bin) = found {
                    bin.prefetch();
                }
            }
            for ((key, _), found) in keys[..count].iter().zip(found) {
                let stop = match found {
                    Some(bin) if !bin.is_divided() => visit(BinAddress { level, key: *key }, bin),
                    None if !self.may_be_below(level) => false,
                    Some(_) | None => self.visit_below(level + 1, *key, within, visit),
                };
                if stop {
                    return true;
                }
            }
        }
        false
    }

    /// The part of a box that lies in the bin above.
    #[inline(never)]
    fn visit_below<'a>(
        &'a self,
        level: usize,
        above: BinKey,
        [min, max]: [[i32; 3]; 2],
        visit: &mut impl FnMut(BinAddress, &'a Bin) -> bool,
    ) -> bool {
        let (mut first, mut last) = (self.key(level, min), self.key(level, max));
        for axis in 0..3 {
            let half = above.0[axis] * 2;
            first.0[axis] = first.0[axis].max(half);
            last.0[axis] = last.0[axis].min(half + 1);
        }
        self.visit_level(level, [first, last], [min, max], visit)
    }

    /// Divides a bin, and those it is divided into as long as they are overfull, unless bins must not be so narrow.
    #[cold]
    pub(super) fn divide_overfull(&mut self, address: BinAddress) {
        let shift = shift_of(self.shift, address.level);
        if self.narrowest.is_none_or(|narrowest| shift <= narrowest) {
            return;
        }
        for address in self.divide(address) {
            self.divide_overfull(address);
        }
    }

    /// Divides a bin; those it is divided into that are overfull.
    fn divide(&mut self, address: BinAddress) -> Vec<BinAddress> {
        let bins = &mut self.levels[address.level];
        let bin = bins.remove(address.key).expect("the bin has been found");
        bins.divide(address.key, bin.len());
        let level = address.level + 1;
        if level == self.levels.len() {
            self.levels.push(Bins::new());
        }
        let mut overfull = Vec::new();
        for index in 0..bin.len() {
            let key = self.key(level, bin.corner(index));
            let count = self.levels[level].push(key, bin.corner(index), bin.id(index));
            if count == BIN_MAX + 1 {
                overfull.push(BinAddress { level, key });
            }
        }
        overfull
    }

    /// Makes one of the divided bins at `corner` undivided when there are few cubes in it.
    #[inline]
    pub(super) fn unite_sparse(&mut self, corner: [i32; 3]) {
        for level in 0..self.levels.len() {
            let key = self.key(level, corner);
            match self.levels[level].get(key) {
                Some(bin) if !bin.is_divided() => return,
                None if !self.may_be_below(level) => return,
                Some(bin) if bin.len() <= BIN_MIN => return self.unite(level, key),
                Some(_) | None => {}
            }
        }
    }

    /// Makes a divided bin undivided.
    #[cold]
    fn unite(&mut self, level: usize, key: BinKey) {
        let bin = self.levels[level].remove(key);
        debug_assert!(
            bin.is_some_and(|bin| bin.is_divided()),
            "the bin has been found"
        );
        self.move_below(level, key, level, key);
    }

    /// Moves all cubes below a bin to another one.
    fn move_below(&mut self, level: usize, key: BinKey, to_level: usize, to: BinKey) {
        for below in halves(key) {
            let Some(bin) = self.levels[level + 1].remove(below) else {
                continue;
            };
            if bin.is_divided() {
                self.move_below(level + 1, below, to_level, to);
                continue;
            }
            for index in 0..bin.len() {
                self.levels[to_level].push(to, bin.corner(index), bin.id(index));
            }
        }
    }

    /// While level 0 is new: makes its bin of this key, if bins of level 1 belong below it.
    #[inline]
    fn rehash_key(&mut self, key: BinKey) {
        if let Rehash::Widen(..) = self.rehash
            && self.levels[0].get(key).is_none()
        {
            self.rehash_key_now(key);
        }
    }

    #[cold]
    fn rehash_key_now(&mut self, key: BinKey) {
        let below = halves(key).map(|below| self.levels[1].get(below).map_or(0, Bin::len));
        let Rehash::Widen(_, unmoved) = &mut self.rehash else {
            return;
        };
        *unmoved -= below.iter().filter(|count| **count > 0).count();
        let cubes: usize = below.iter().sum();
        if cubes > 2 * BIN_MIN {
            self.levels[0].divide(key, cubes);
        } else if cubes > 0 {
            self.move_below(0, key, 0, key);
        }
    }

    /// Continues the rehash that is under way; begins one when the number of cubes has changed much.
    #[inline]
    pub(super) fn continue_rehash(&mut self) {
        if !matches!(self.rehash, Rehash::Idle) {
            self.rehash_bins();
            // A small set is rehashed at once, so that the bins suit even one that comes in a single change.
            while self.len <= FEW && !matches!(self.rehash, Rehash::Idle) {
                self.rehash_bins();
            }
            return;
        }
        if self.is_mostly_divided() {
            self.rehash = Rehash::Narrow(Walk::default());
        } else if !(self.review[0]..=self.review[1]).contains(&self.len) {
            self.review_levels();
        }
    }

    /// Whether nearly all bins of level 0 are divided, so that it is only in the way.
    #[inline]
    fn is_mostly_divided(&self) -> bool {
        let base = &self.levels[0];
        base.divided() * 8 > base.len() * 7
    }

    /// Begins a wider level when there are few cubes in a bin. Looked at only when their number has doubled or halved (and
    /// again when that level is complete), so that what a cluster among sparse cubes makes narrow again costs little.
    #[cold]
    fn review_levels(&mut self) {
        self.review = [self.len / 2, (self.len * 2).max(REVIEW_MIN)];
        while self.levels.len() > 1 && self.levels.last().is_some_and(|last| last.len() == 0) {
            self.levels.pop();
        }
        let undivided = self.levels.iter().map(|bins| bins.len() - bins.divided());
        let sparse = self.len < MEAN_MIN * undivided.sum::<usize>();
        let may = self.narrowest.is_some() && self.len >= REVIEW_MIN && self.shift < SHIFT_MAX;
        if sparse && may && !self.is_mostly_divided() {
            self.rehash = Rehash::Widen(Walk::default(), self.levels[0].len());
            self.levels.insert(0, Bins::new());
            self.shift += 1;
        }
    }

    #[cold]
    fn rehash_bins(&mut self) {
        for _ in 0..BINS_A_CHANGE {
            match self.rehash {
                Rehash::Idle => return,
                Rehash::Narrow(mut walk) => {
                    let (bin, more) = self.levels[0].next(&mut walk);
                    self.rehash = Rehash::Narrow(if more { walk } else { Walk::default() });
                    if let Some(bin) = bin.filter(|bin| !bin.is_divided()) {
                        let (level, key) = (0, bin.key());
                        for overfull in self.divide(BinAddress { level, key }) {
                            self.divide_overfull(overfull);
                        }
                    }
                    if self.levels[0].len() == self.levels[0].divided() {
                        if self.levels.len() > 1 {
                            self.levels.remove(0);
                            self.shift -= 1;
                        }
                        self.rehash = Rehash::Idle;
                    }
                }
                Rehash::Widen(mut walk, _) => {
                    let (bin, more) = self.levels[1].next(&mut walk);
                    let unmoved = bin.map(|bin| BinKey(bin.key().0.map(|half| half >> 1)));
                    let to = if more { walk } else { Walk::default() };
                    if let Rehash::Widen(walk, _) = &mut self.rehash {
                        *walk = to;
                    }
                    if let Some(key) = unmoved {
                        self.rehash_key(key);
                    }
                    if let Rehash::Widen(_, 0) = self.rehash {
                        self.rehash = Rehash::Idle;
                        self.review_levels();
                    }
                }
            }
        }
    }
}

impl Filled {
    /// Puts those of the cubes in `ranges` into a share whose bins are there.
    fn of(
        share: &mut Share<'_>,
        shift: u32,
        cubes: &[(CubeId, Place)],
        ranges: &[Range<usize>],
    ) -> Self {
        let mut filled = Self::default();
        let mut runs = Vec::with_capacity(RUNS_AT_ONCE);
        for range in ranges {
            let mut rest = range.clone();
            while !rest.is_empty() {
                let key = key_of(cubes[rest.start].1.corner(), shift);
                let is_here = |(_, place): &&(CubeId, Place)| key_of(place.corner(), shift) == key;
                let count = cubes[rest.clone()].iter().take_while(is_here).count();
                let hash = key.hash();
                if share.has(hash) {
                    share.prefetch(hash);
                    let range = rest.start..rest.start + count;
                    runs.push(Run { key, hash, range });
                    if runs.len() == RUNS_AT_ONCE {
                        filled.put(share, cubes, &mut runs);
                    }
                }
                rest.start += count;
            }
        }
        filled.put(share, cubes, &mut runs);
        filled
    }

    fn put(&mut self, share: &mut Share<'_>, cubes: &[(CubeId, Place)], runs: &mut Vec<Run>) {
        for run in &*runs {
            share.prefetch_end(run.key, run.hash);
        }
        for Run { key, hash, range } in runs.drain(..) {
            if share.count_in(key, hash, range.len()) {
                self.divided.push(range);
                continue;
            }
            let run = cubes[range].iter().map(|(id, place)| (place.corner(), *id));
            if share.push_fresh(key, hash, run) {
                self.touched.push(key);
            }
        }
    }
}

#[inline]
fn key_of(corner: [i32; 3], shift: u32) -> BinKey {
    BinKey(corner.map(|coordinate| coordinate >> shift))
}

/// Width of the bins of a level.
#[inline]
fn shift_of(base: u32, level: usize) -> u32 {
    base - u32::try_from(level).expect("there are few levels")
}

/// The eight bins of the next level that a bin is divided into.
fn halves(BinKey(key): BinKey) -> [BinKey; 8] {
    std::array::from_fn(|half| {
        let side = |axis: usize| i32::from(half >> axis & 1 == 1);
        BinKey([0, 1, 2].map(|axis| key[axis] * 2 + side(axis)))
    })
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::random::Random;

    /// A coordinate from `-half` to `half`.
    fn coordinate(random: &mut Random, half: i32) -> i32 {
        let half = i64::from(half);
        i32::try_from(random.within(-half, half)).unwrap()
    }

    fn check(grid: &mut Grid, cubes: &BTreeMap<u64, [i32; 3]>, random: &mut Random) {
        assert_eq!(grid.len(), cubes.len());
        let least = |axis: usize| cubes.values().map(|corner| corner[axis]).min();
        let greatest = |axis: usize| cubes.values().map(|corner| corner[axis]).max();
        let expected = least(0).map(|_| Bounds {
            min: [0, 1, 2].map(|axis| least(axis).unwrap()),
            max: [0, 1, 2].map(|axis| greatest(axis).unwrap() + grid.edge),
        });
        assert_eq!(grid.bounds(), expected);
        let (mut corners, mut walk) = (Vec::new(), Default::default());
        while grid.next_corners(&mut walk, 7, |corner| corners.push(corner)) == 0 {}
        let mut kept: Vec<_> = cubes.values().copied().collect();
        corners.sort_unstable();
        kept.sort_unstable();
        assert_eq!(corners, kept);
        for _ in 0..5 {
            let some = random.below(1_usize << 29);
            let Some(own) = cubes.values().nth(some % cubes.len().max(1)) else {
                return;
            };
            let mut neighbours = Neighbours::new();
            grid.gather(*own, &mut neighbours);
            let mut found: Vec<_> = neighbours.iter().collect();
            let offsets = cubes
                .values()
                .map(|corner| [0, 1, 2].map(|axis| corner[axis] - own[axis]));
            let near = |offset: &[i32; 3]| offset.iter().all(|part| part.abs() <= grid.edge);
            let mut expected: Vec<_> = offsets.filter(near).collect();
            found.sort_unstable();
            expected.sort_unstable();
            assert_eq!(found, expected);
        }
    }

    /// A batch put in by one thread or by several: the same cubes in the same bins, whatever levels there are, and the same
    /// bins known to have fresh ones.
    #[test]
    fn threads_fill_the_same_bins() {
        let edge = Edge::new(100).unwrap();
        for threads in 1..=3 {
            let mut random = Random::new(threads as u64);
            let [mut one, mut several] = [(); 2].map(|()| Grid::for_neighbours(edge));
            let mut cubes = BTreeMap::new();
            let mut levels = 0;
            // Sparse, then clusters in some bins, then nearly all in clusters.
            for (change, (half, count)) in [
                (30_000, 9_000),
                (600, 3_000),
                (30_000, 9_000),
                (300, 20_000),
            ]
            .into_iter()
            .enumerate()
            {
                let first = change as u64 * 100_000;
                let mut batch: Vec<_> = (first..first + count)
                    .map(|id| {
                        let corner = [0; 3].map(|_: i32| coordinate(&mut random, half));
                        (CubeId(id), Place::from_checked(corner))
                    })
                    .collect();
                batch.sort_by_key(|(_, place)| one.key(0, place.corner()));
                let mut touched = [Vec::new(), Vec::new()];
                one.insert_fresh(&batch, &mut touched[0]);
                several.insert_fresh_on(threads, &batch, &mut touched[1]);
                cubes.extend(batch.iter().map(|(id, place)| (id.0, place.corner())));
                let [expected, found] = touched.each_ref().map(|addresses| {
                    let mut bins: Vec<_> = addresses
                        .iter()
                        .map(|address| (address.level, address.key))
                        .collect();
                    bins.sort_unstable();
                    bins
                });
                assert_eq!(found, expected, "change {change}");
                assert_eq!(several.size(), one.size(), "change {change}");
                for (grid, touched) in [(&mut one, &touched[0]), (&mut several, &touched[1])] {
                    let mut due = Due::default();
                    grid.keep_fresh(touched, &mut due);
                    assert_eq!(due.cubes as u64, count);
                    for address in &due.overfull {
                        grid.divide_overfull(*address);
                    }
                    check(grid, &cubes, &mut random);
                    levels = levels.max(grid.levels.len());
                }
                let divided =
                    |grid: &Grid| -> usize { grid.levels.iter().map(Bins::divided).sum() };
                assert_eq!(divided(&several), divided(&one));
            }
            assert!(levels > 2, "clusters have divided bins: {levels}");
        }
    }

    /// Sparse cubes, then a cluster among them, then sparse ones again, and none: more than are looked at at once, so that
    /// levels come and go a few bins at a time.
    #[test]
    fn levels_come_and_go() {
        let edge = Edge::new(100).unwrap();
        for bins in [Grid::for_neighbours(edge), Grid::for_small_boxes(edge)] {
            let (mut grid, mut random) = (bins, Random::new(1));
            let mut cubes = BTreeMap::new();
            let mut next = 0;
            for (phase, (half, count)) in [
                (20_000_000, 12_000),
                (300, 6_000),
                (4_000, 30_000),
                (900_000_000, 20_000),
            ]
            .into_iter()
            .enumerate()
            {
                for _ in 0..count {
                    let corner = [0; 3].map(|_: i32| coordinate(&mut random, half));
                    grid.insert(Place::from_checked(corner), CubeId(next));
                    cubes.insert(next, corner);
                    next += 1;
                    if next % 2003 == 0 {
                        check(&mut grid, &cubes, &mut random);
                    }
                }
                // The oldest go; after the last phase all of them.
                let stay = [9_000, 9_000, 20_000, 0][phase];
                while cubes.len() > stay {
                    let (id, corner) = cubes.pop_first().unwrap();
                    let place = Place::from_checked(corner);
                    assert!(!grid.remove(place, CubeId(u64::MAX)), "another id");
                    assert!(grid.remove(place, CubeId(id)));
                    assert!(!grid.remove(place, CubeId(id)), "it has gone");
                    if id % 2003 == 0 {
                        check(&mut grid, &cubes, &mut random);
                    }
                }
            }
            assert_eq!(grid.bounds(), None);
            assert!(
                grid.size() < 5_000,
                "nothing is left behind: {}",
                grid.size()
            );
        }
    }
}
