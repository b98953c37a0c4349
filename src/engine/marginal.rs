//! The kernel: what one cube adds to the measures of a union, from the cubes that touch it.
//!
//! Works in coordinates local to the cube `c`, which is the box from 0 to L. A *clip* is another cube cut to the frame
//! from -1 to L+1: the cells that touch `c`. Only lattice points of closed `c` can change their octant mask, and only
//! next to what `c` newly covers. The points are taken apart until few clips are left, then looked at bit-parallel:
//!
//! ```text
//!   divide(points, clips):   take the clip K with the most points in its core; the core changes nothing
//!        +--------------+    and the rest is at most three slabs, because cubes of one size overlap
//!        |  K   :       |    in a corner, an edge or a face; clamp and filter the clips for each slab,
//!        |......: slab  |    stop where one clip covers it, go on.
//!        |  slab        |
//!        +--------------+
//!   leaf(points, clips):     at most 15 planes an axis cut the points into at most 16 cells; occupancy
//!                            is 16 rows of 16 bits a layer, before and after in one pass.
//! ```
//!
//! # Source
//! The local formulas are UNION3's (W. R. Franklin); evaluated once a cube instead of once a grid cell.

#![expect(
    clippy::inline_always,
    reason = "what is inlined into a leaf is compiled for the leaf's instructions; left as a call it would not be"
)]

#[cfg(target_arch = "x86_64")]
mod avx2;

use ethnum::I256;

use crate::geometry::{Bounds, Edge, Measures, Place, Stock, StockMeasures, WEIGHTS};

use super::neighbours::Neighbours;

/// What one cube adds: to the union, and to the two parts of the stock if there is one.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) struct Difference {
    pub(super) union: Measures,
    pub(super) stock: Option<StockMeasures>,
}

/// A box of lattice points, both ends included; or of space, as a closed box. Local steps.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Span {
    pub(super) min: [i32; 3],
    pub(super) max: [i32; 3],
}

/// What nothing adds to the parts of a stock.
fn no_parts() -> StockMeasures {
    StockMeasures {
        removed: Measures::default(),
        remaining: Measures::default(),
    }
}

/// Few enough clips for a leaf: two planes each on one axis and the cube's own two stay below [`PLANES_MAX`].
const LEAF_CLIPS: usize = 10;
/// Planes an axis in a leaf: 16 cells are one row of bits.
const PLANES_MAX: usize = 15;
const CELLS_MAX: usize = PLANES_MAX + 1;
const _: () = assert!(LEAF_CLIPS + 2 <= PLANES_MAX && CELLS_MAX == u16::BITS as usize);

/// Up to this edge the measures of one cube's difference fit 64 bits: the greatest is a second moment, at most `L^5`.
const NARROW_EDGE_MAX: i32 = 6208;
const _: () = assert!((NARROW_EDGE_MAX as u128).pow(5) < 1 << 63);
/// Wider ones fit 128 bits, up to the widest there is.
const _: () = assert!(5 * crate::geometry::EDGE_MAX.ilog2() < 127);

/// The kernel with its working memory.
#[derive(Clone, Debug)]
pub(super) struct Kernel {
    edge: i32,
    stock: Option<Bounds>,
    /// The box that is looked at: the cube, or what of it lies inside the stock. Its own cells are the ones that may be
    /// newly covered.
    own: Span,
    /// The cells that hold material, cut to the frame of `own`: all of them where no face of the stock is near.
    material: Span,
    wide: bool,
    /// The same in vectors, when the processor has them and the edge fits their lanes.
    #[cfg(target_arch = "x86_64")]
    fast: Option<avx2::FastKernel>,
    /// Whether the processor has what `leaf_avx2` was compiled for.
    avx2: bool,
    /// A stack of clips: each level of the division works on the end of it.
    clips: Vec<Span>,
    /// Boxes that contain everything the last cube newly covered; kept only when asked for.
    uncovered: Vec<Span>,
    collect: bool,
    /// Sums of the fast kernel, and what came of them.
    sums: [Sums<i128>; 3],
    found: Difference,
}

impl Kernel {
    pub(super) fn new(edge: Edge) -> Self {
        let edge = edge.steps();
        let nowhere = Span::cube([0; 3], edge);
        Self {
            edge,
            stock: None,
            own: nowhere,
            material: nowhere,
            wide: edge > NARROW_EDGE_MAX,
            #[cfg(target_arch = "x86_64")]
            fast: (avx2() && edge <= avx2::EDGE_MAX).then(|| avx2::FastKernel::new(edge)),
            avx2: avx2(),
            clips: Vec::new(),
            uncovered: Vec::new(),
            collect: false,
            sums: Default::default(),
            found: Difference::default(),
        }
    }

    /// A kernel that takes the portable path and the widest sums whatever the edge: the slow twin of the fast ones.
    pub(super) fn plain(edge: Edge) -> Self {
        Self {
            wide: true,
            #[cfg(target_arch = "x86_64")]
            fast: None,
            avx2: false,
            ..Self::new(edge)
        }
    }

    /// The stock that cubes are cut from.
    pub(super) fn set_stock(&mut self, stock: Option<Stock>) {
        self.stock = stock.map(|stock| stock.bounds());
        self.found.stock = stock.map(|_| no_parts());
    }

    /// F(S + c) - F(S) for the cube at `place`, where S is given by those of its cubes that touch c: see [`Self::found`].
    /// False when c changes nothing: it is covered.
    pub(super) fn marginal(&mut self, place: Place, neighbours: &Neighbours) -> bool {
        self.collect = false;
        self.difference(place, neighbours)
    }

    /// The same, with closed boxes, in scene coordinates, that together contain c minus S. None when c is covered.
    pub(super) fn uncovered(
        &mut self,
        place: Place,
        neighbours: &Neighbours,
        boxes: &mut Vec<Span>,
    ) -> bool {
        self.collect = true;
        let changes = self.difference(place, neighbours);
        let corner = place.corner();
        boxes.clear();
        boxes.extend(self.uncovered.iter().map(|span| span.moved(corner)));
        changes
    }

    /// What the last cube changed, if it changed anything. It stays here, for it is large.
    pub(super) fn found(&self) -> &Difference {
        &self.found
    }

    fn difference(&mut self, place: Place, neighbours: &Neighbours) -> bool {
        #[cfg(target_arch = "x86_64")]
        if self.fast.is_some() {
            return self.fast_difference(place, neighbours);
        }
        self.uncovered.clear();
        if neighbours.iter().any(|offset| offset == [0; 3]) {
            return false;
        }
        let found = self.plain_difference(place, neighbours);
        if let Some(found) = found {
            self.found = found;
        }
        found.is_some()
    }

    fn plain_difference(&mut self, place: Place, neighbours: &Neighbours) -> Option<Difference> {
        let cube = Span::cube([0; 3], self.edge);
        let frame = cube.grown();
        let Some(stock) = self.stock else {
            let [union] = self.sums(place, neighbours, cube, frame)?;
            return Some(Difference { union, stock: None });
        };
        let stock = local(&stock, place);
        if stock.contains(&frame) {
            // No face of the stock is near: what comes to the union comes to what is removed.
            let [union, remaining] = self.sums(place, neighbours, cube, frame)?;
            let removed = union;
            let stock = Some(StockMeasures { removed, remaining });
            return Some(Difference { union, stock });
        }
        let [union] = self.sums(place, neighbours, cube, frame)?;
        self.collect = false;
        let inside = cube.clamped(&stock);
        let parts = if inside.is_solid() {
            let material = inside.grown().clamped(&stock);
            self.sums(place, neighbours, inside, material)
        } else {
            None
        };
        let [removed, remaining] = parts.unwrap_or_default();
        let stock = Some(StockMeasures { removed, remaining });
        Some(Difference { union, stock })
    }

    #[cfg(target_arch = "x86_64")]
    fn fast_difference(&mut self, place: Place, neighbours: &Neighbours) -> bool {
        use avx2::{ACROSS, INSIDE, UNION};
        let fast = self.fast.as_mut().expect("it was looked for");
        let cube = Span::cube([0; 3], self.edge);
        let stock = self.stock.map(|stock| local(&stock, place));
        let near = stock.unwrap_or(cube);
        let inside = stock.is_some() && near.contains(&cube.grown());
        let across = stock.is_some() && !inside && cube.clamped(&near).is_solid();
        let (sums, collect) = (&mut self.sums, self.collect);
        #[expect(
            unsafe_code,
            reason = "compiled for instructions that were detected when `fast` was made"
        )]
        // SAFETY: `fast` is there only when the processor was found to have every feature these functions enable.
        let changes = unsafe {
            if inside {
                fast.difference::<INSIDE>(neighbours, &near, collect, sums)
            } else if across {
                fast.difference::<ACROSS>(neighbours, &near, collect, sums)
            } else {
                fast.difference::<UNION>(neighbours, &near, collect, sums)
            }
        };
        std::mem::swap(&mut self.uncovered, &mut fast.uncovered);
        if !changes {
            return false;
        }
        let corner = place.corner();
        let [union, removed, remaining] = &self.sums;
        union.translate::<i128>(corner, &mut self.found.union);
        let parts = self.found.stock.as_mut();
        match (parts, inside, across) {
            (Some(parts), true, _) => {
                parts.removed = self.found.union;
                remaining.translate::<i128>(corner, &mut parts.remaining);
            }
            (Some(parts), false, true) => {
                removed.translate::<i128>(corner, &mut parts.removed);
                remaining.translate::<i128>(corner, &mut parts.remaining);
            }
            (Some(parts), false, false) => *parts = no_parts(),
            (None, ..) => {}
        }
        true
    }

    /// What the box `own` of the cube at `place` adds to the measures of the union inside `material` and, when two are
    /// asked for, of the material outside the union. None when nothing of it is newly covered.
    fn sums<const PARTS: usize>(
        &mut self,
        place: Place,
        neighbours: &Neighbours,
        own: Span,
        material: Span,
    ) -> Option<[Measures; PARTS]> {
        (self.own, self.material) = (own, material);
        self.clips.clear();
        let within = own.grown().clamped(&material);
        let clips = neighbours
            .iter()
            .map(|offset| Span::cube(offset, self.edge).clamped(&within))
            .filter(|clip| clip.is_solid() && clip.reaches(&own));
        self.clips.extend(clips);
        let corner = place.corner();
        if self.wide {
            let mut sums = std::array::from_fn(|_| Sums::<i128>::default());
            self.divide(0, own, &mut sums);
            (sums[0].volume != 0).then(|| sums.map(|sums| sums.translated::<I256>(corner)))
        } else {
            let mut sums = std::array::from_fn(|_| Sums::<i64>::default());
            self.divide(0, own, &mut sums);
            (sums[0].volume != 0).then(|| sums.map(|sums| sums.translated::<i128>(corner)))
        }
    }

    /// Adds the difference at `points` for the clips from `first` on, all of which reach a cell next to the points.
    fn divide<T: Ring, const PARTS: usize>(
        &mut self,
        first: usize,
        points: Span,
        sums: &mut [Sums<T>; PARTS],
    ) {
        if self.clips.len() - first <= LEAF_CLIPS {
            return self.leaf(first, points, sums);
        }
        let Some(core) = self.largest_core(first, points) else {
            return self.divide_thin(first, points, sums);
        };
        let mut rest = points;
        for axis in 0..3 {
            if rest.min[axis] < core.min[axis] {
                let mut slab = rest;
                slab.max[axis] = core.min[axis] - 1;
                self.descend(first, slab, sums);
                rest.min[axis] = core.min[axis];
            }
            if core.max[axis] < rest.max[axis] {
                let mut slab = rest;
                slab.min[axis] = core.max[axis] + 1;
                self.descend(first, slab, sums);
                rest.max[axis] = core.max[axis];
            }
        }
    }

    /// Goes on with a part of the points and the clips that reach it, unless one of them covers all that `c` has there.
    fn descend<T: Ring, const PARTS: usize>(
        &mut self,
        first: usize,
        points: Span,
        sums: &mut [Sums<T>; PARTS],
    ) {
        let end = self.clips.len();
        let cells = points.grown();
        let own = self.own_cells(points);
        for index in first..end {
            let clip = self.clips[index];
            if !clip.reaches(&points) {
                continue;
            }
            if clip.contains(&own) {
                self.clips.truncate(end);
                return;
            }
            self.clips.push(clip.clamped(&cells));
        }
        self.divide(end, points, sums);
        self.clips.truncate(end);
    }

    /// The cells of `c` next to the points.
    #[inline(always)]
    fn own_cells(&self, points: Span) -> Span {
        self.own.clamped(&points.grown())
    }

    /// The points around which a clip already fills all of `c`, for the clip that has most of them.
    fn largest_core(&self, first: usize, points: Span) -> Option<Span> {
        let mut best = (0, points);
        for clip in &self.clips[first..] {
            let mut core = points;
            let mut count: u128 = 1;
            for axis in 0..3 {
                // On the box's own face the octants beyond it do not change, so a clip that ends there counts too.
                let own = [self.own.min[axis], self.own.max[axis]];
                let low = if clip.min[axis] <= own[0] {
                    own[0]
                } else {
                    clip.min[axis] + 1
                };
                let high = if clip.max[axis] >= own[1] {
                    own[1]
                } else {
                    clip.max[axis] - 1
                };
                core.min[axis] = low.max(points.min[axis]);
                core.max[axis] = high.min(points.max[axis]);
                count *= u128::try_from(core.max[axis] - core.min[axis] + 1).unwrap_or(0);
            }
            if count > best.0 {
                best = (count, core);
            }
        }
        (best.0 > 0).then_some(best.1)
    }

    /// No clip has a core (the points are thin): drop clips within others, then halve the points at the median plane.
    #[cold]
    fn divide_thin<T: Ring, const PARTS: usize>(
        &mut self,
        first: usize,
        points: Span,
        sums: &mut [Sums<T>; PARTS],
    ) {
        let mut kept = first;
        for index in first..self.clips.len() {
            let clip = self.clips[index];
            let within = |other: &Span| other.contains(&clip);
            // Of equal clips the first stays.
            let dominated = self.clips[first..kept].iter().any(within)
                || self.clips[index + 1..]
                    .iter()
                    .any(|other| *other != clip && within(other));
            if !dominated {
                self.clips[kept] = clip;
                kept += 1;
            }
        }
        self.clips.truncate(kept);
        let planes: [Vec<i32>; 3] = std::array::from_fn(|axis| {
            let ends = self.clips[first..]
                .iter()
                .flat_map(|clip| [clip.min[axis], clip.max[axis]]);
            let mut planes: Vec<i32> = ends
                .chain([self.own.min[axis], self.own.max[axis]])
                .filter(|plane| (points.min[axis]..=points.max[axis]).contains(plane))
                .collect();
            planes.sort_unstable();
            planes.dedup();
            planes
        });
        let most = (0..3)
            .max_by_key(|&axis| planes[axis].len())
            .expect("there are three axes");
        if planes[most].len() <= PLANES_MAX {
            return self.leaf(first, points, sums);
        }
        let median = planes[most][planes[most].len() / 2];
        let (mut below, mut above) = (points, points);
        below.max[most] = median - 1;
        above.min[most] = median;
        self.descend(first, below, sums);
        self.descend(first, above, sums);
    }

    /// Looks at all vertices among the points at once, with the widest registers there are.
    fn leaf<T: Ring, const PARTS: usize>(
        &mut self,
        first: usize,
        points: Span,
        sums: &mut [Sums<T>; PARTS],
    ) {
        #[cfg(target_arch = "x86_64")]
        if self.avx2 {
            #[expect(
                unsafe_code,
                reason = "the same code, compiled for instructions that were detected"
            )]
            // SAFETY: `avx2` is set only when the processor was found to have every feature that `leaf_avx2` enables.
            return unsafe { self.leaf_avx2(first, points, sums) };
        }
        self.leaf_inlined(first, points, sums);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn leaf_avx2<T: Ring, const PARTS: usize>(
        &mut self,
        first: usize,
        points: Span,
        sums: &mut [Sums<T>; PARTS],
    ) {
        self.leaf_inlined(first, points, sums);
    }

    #[inline(always)]
    fn leaf_inlined<T: Ring, const PARTS: usize>(
        &mut self,
        first: usize,
        points: Span,
        sums: &mut [Sums<T>; PARTS],
    ) {
        let mut planes = [Planes::NONE; 3];
        for axis in 0..3 {
            let planes = &mut planes[axis];
            let within = points.min[axis]..=points.max[axis];
            for plane in [self.own.min[axis], self.own.max[axis]] {
                if within.contains(&plane) {
                    planes.insert(plane);
                }
            }
            for clip in &self.clips[first..] {
                for plane in [clip.min[axis], clip.max[axis]] {
                    if within.contains(&plane) {
                        planes.insert(plane);
                    }
                }
            }
        }
        let vertices_possible = planes.iter().all(|planes| planes.count > 0);
        if !vertices_possible && !self.collect {
            return;
        }

        // A layer more than there can be, so that a plane's upper layer always exists.
        let mut before = [Layer::default(); CELLS_MAX];
        let mut newly = [Layer::default(); CELLS_MAX];
        let cells_z = planes[2].count + 1;
        for clip in &self.clips[first..] {
            let cells = Planes::cells_of(&planes, clip, &points);
            let pattern = Layer::product(cells[0], cells[1]);
            let mut layers = cells[2];
            while layers != 0 {
                let z = layers.trailing_zeros() as usize;
                layers &= layers - 1;
                before[z] = before[z].or(pattern);
            }
        }
        let own = Planes::cells_of(&planes, &self.own_cells(points), &points);
        let pattern = Layer::product(own[0], own[1]);
        let mut any = Layer::default();
        for z in 0..cells_z {
            if own[2] >> z & 1 == 1 {
                newly[z] = pattern.and_not(before[z]);
                any = any.or(newly[z]);
            }
        }
        if any.is_empty() {
            return;
        }
        if self.collect {
            self.collect_box(points, &planes, &newly, any);
        }
        if !vertices_possible {
            return;
        }
        self.add_points(points, &planes, &before, &newly, sums);
    }

    /// Adds the differences at the vertices among the points.
    #[inline(always)]
    fn add_points<T: Ring, const PARTS: usize>(
        &self,
        points: Span,
        planes: &[Planes; 3],
        before: &[Layer; CELLS_MAX],
        newly: &[Layer; CELLS_MAX],
        sums: &mut [Sums<T>; PARTS],
    ) {
        // The material outside the union, when it is asked for.
        let mut left = [[Layer::default(); CELLS_MAX]; 2];
        if PARTS == 2 {
            let cells = Planes::cells_of(planes, &self.material, &points);
            let pattern = Layer::product(cells[0], cells[1]);
            for z in (0..CELLS_MAX).filter(|z| cells[2] >> z & 1 == 1) {
                left[0][z] = pattern.and_not(before[z]);
                left[1][z] = left[0][z].and_not(newly[z]);
            }
        }
        let points_of =
            |axis: usize| low_bits(u32::try_from(planes[axis].count).expect("at most fifteen"));
        let within = Layer::product(points_of(0), points_of(1));
        for z in 0..planes[2].count {
            let near = newly[z].or(newly[z + 1]);
            if near.is_empty() {
                continue;
            }
            // Of each part the layers below and above the points, before and after.
            let parts: [[[Layer; 2]; 2]; PARTS] = std::array::from_fn(|part| {
                if part == 0 {
                    let after = |z: usize| before[z].or(newly[z]);
                    [[before[z], before[z + 1]], [after(z), after(z + 1)]]
                } else {
                    left.map(|left| [left[z], left[z + 1]])
                }
            });
            let vertices = parts
                .iter()
                .flatten()
                .map(|[lower, upper]| Layer::vertices(*lower, *upper))
                .fold(Layer::default(), Layer::or);
            let candidates = vertices.and(near.dilated()).and(within);
            for y in 0..planes[1].count {
                let row = candidates.row(y);
                if row == 0 {
                    continue;
                }
                for ([before, after], sums) in parts.iter().zip(&mut *sums) {
                    let before = rows_around(&before[0], &before[1], y);
                    let after = rows_around(&after[0], &after[1], y);
                    let mut line = Line::<T>::default();
                    let mut row = row;
                    while row != 0 {
                        let x = row.trailing_zeros();
                        row &= row - 1;
                        line.add(
                            planes[0].at[x as usize],
                            mask_at(before, x),
                            mask_at(after, x),
                        );
                    }
                    sums.add(&line, planes[1].at[y], planes[2].at[z]);
                }
            }
        }
    }

    /// Keeps one box around what a leaf newly covers.
    #[inline(always)]
    fn collect_box(
        &mut self,
        points: Span,
        planes: &[Planes; 3],
        newly: &[Layer; CELLS_MAX],
        any: Layer,
    ) {
        let columns = (0..CELLS_MAX).fold(0, |bits, y| bits | any.row(y));
        let mut used = [u32::from(columns), 0, 0];
        for (index, layer) in newly.iter().enumerate() {
            used[1] |= u32::from(any.row(index) != 0) << index;
            used[2] |= u32::from(!layer.is_empty()) << index;
        }
        let cells = points.grown();
        let mut span = cells;
        for axis in 0..3 {
            let planes = &planes[axis];
            let (first, last) = (
                used[axis].trailing_zeros() as usize,
                used[axis].ilog2() as usize,
            );
            if first > 0 {
                span.min[axis] = planes.at[first - 1];
            }
            if last < planes.count {
                span.max[axis] = planes.at[last];
            }
        }
        self.uncovered.push(span);
    }
}

/// A box in coordinates local to the cube at `place`; saturated far away, since only what is near the cube matters.
fn local(bounds: &Bounds, place: Place) -> Span {
    let corner = place.corner();
    let local = |from: [i32; 3]| [0, 1, 2].map(|axis| from[axis].saturating_sub(corner[axis]));
    Span {
        min: local(bounds.min),
        max: local(bounds.max),
    }
}

#[cfg(target_arch = "x86_64")]
fn avx2() -> bool {
    is_x86_feature_detected!("avx2")
        && is_x86_feature_detected!("bmi1")
        && is_x86_feature_detected!("bmi2")
        && is_x86_feature_detected!("lzcnt")
        && is_x86_feature_detected!("popcnt")
}

#[cfg(not(target_arch = "x86_64"))]
fn avx2() -> bool {
    false
}

impl Span {
    /// As closed boxes with a common cell: the clip has a cell next to some point.
    fn reaches(&self, points: &Self) -> bool {
        (0..3).all(|axis| self.min[axis] <= points.max[axis] && points.min[axis] <= self.max[axis])
    }

    /// The closed cube at a corner.
    pub(super) fn cube(corner: [i32; 3], edge: i32) -> Self {
        Self {
            min: corner,
            max: corner.map(|low| low + edge),
        }
    }

    /// Whether it has a volume.
    fn is_solid(&self) -> bool {
        (0..3).all(|axis| self.min[axis] < self.max[axis])
    }

    pub(super) fn contains(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.min[axis] <= other.min[axis] && other.max[axis] <= self.max[axis])
    }

    fn clamped(&self, to: &Self) -> Self {
        Self {
            min: std::array::from_fn(|axis| self.min[axis].max(to.min[axis])),
            max: std::array::from_fn(|axis| self.max[axis].min(to.max[axis])),
        }
    }

    /// The cells next to a box of points.
    fn grown(&self) -> Self {
        Self {
            min: self.min.map(|low| low - 1),
            max: self.max.map(|high| high + 1),
        }
    }

    fn moved(&self, by: [i32; 3]) -> Self {
        Self {
            min: std::array::from_fn(|axis| self.min[axis] + by[axis]),
            max: std::array::from_fn(|axis| self.max[axis] + by[axis]),
        }
    }

    /// The box around two boxes.
    pub(super) fn joined(&self, other: &Self) -> Self {
        Self {
            min: std::array::from_fn(|axis| self.min[axis].min(other.min[axis])),
            max: std::array::from_fn(|axis| self.max[axis].max(other.max[axis])),
        }
    }

    /// Volume of the common part of two boxes.
    pub(super) fn overlap(&self, other: &Self) -> u128 {
        let common = self.clamped(other);
        (0..3)
            .map(|axis| u128::try_from(common.max[axis] - common.min[axis]).unwrap_or(0))
            .product()
    }
}

/// The distinct planes across one axis, in order. Cell `i` lies below plane `i`; the last cell above all of them.
#[derive(Clone, Copy)]
struct Planes {
    /// Beyond `count` planes that are above everything, so that a rank needs no count.
    at: [i32; CELLS_MAX],
    count: usize,
}

impl Planes {
    const NONE: Self = Self {
        at: [i32::MAX; CELLS_MAX],
        count: 0,
    };

    #[inline(always)]
    fn insert(&mut self, plane: i32) {
        let rank = self.rank(plane) as usize;
        if rank > 0 && self.at[rank - 1] == plane {
            return;
        }
        assert!(self.count < PLANES_MAX, "a leaf has few planes");
        for index in (rank..self.count).rev() {
            self.at[index + 1] = self.at[index];
        }
        self.at[rank] = plane;
        self.count += 1;
    }

    /// How many planes lie at or below a coordinate.
    #[inline(always)]
    fn rank(&self, coordinate: i32) -> u32 {
        let mut rank = 0;
        for plane in self.at {
            rank += u32::from(plane <= coordinate);
        }
        rank
    }

    /// The cells, by axis, of a box whose ends are planes or lie beyond the points.
    #[inline(always)]
    fn cells_of(planes: &[Self; 3], span: &Span, points: &Span) -> [u16; 3] {
        let mut cells = [0; 3];
        for (axis, planes) in planes.iter().enumerate() {
            // Beyond the points there is one cell more.
            let beyond = u32::from(span.max[axis] > points.max[axis]);
            let (first, end) = (
                planes.rank(span.min[axis]),
                planes.rank(span.max[axis]) + beyond,
            );
            // Of sixteen bits, those from `first` to `end`; a shift by sixteen leaves none of them.
            cells[axis] = low_bits(end) & !low_bits(first);
        }
        cells
    }
}

/// As many of the lowest bits as asked for, at most sixteen.
#[inline(always)]
fn low_bits(count: u32) -> u16 {
    debug_assert!(count <= u16::BITS, "a row has sixteen cells");
    !u16::MAX.checked_shl(count).unwrap_or(0)
}

/// The rows around the points of row `y` between two layers: (y, z) below and above.
#[inline(always)]
fn rows_around(lower: &Layer, upper: &Layer, y: usize) -> [u32; 4] {
    [
        lower.0[y].into(),
        lower.0[y + 1].into(),
        upper.0[y].into(),
        upper.0[y + 1].into(),
    ]
}

/// One layer of cells: a row of bits along x for each y, together one register of 256 bits.
///
/// The operations are loops over sixteen lanes, which the compiler turns into vector instructions.
#[derive(Clone, Copy, Default)]
struct Layer([u16; CELLS_MAX]);

/// The bit of each row in a set of rows.
const ROW_BITS: [u16; CELLS_MAX] = {
    let mut bits = [1; CELLS_MAX];
    let mut y = 1;
    while y < CELLS_MAX {
        bits[y] = bits[y - 1] << 1;
        y += 1;
    }
    bits
};

impl Layer {
    /// Cells whose x is in one set of bits and whose y is in another.
    #[inline(always)]
    fn product(x: u16, y: u16) -> Self {
        Self(ROW_BITS).zip(Self::default(), |bit, _| if y & bit == 0 { 0 } else { x })
    }

    #[inline(always)]
    fn zip(self, other: Self, operation: impl Fn(u16, u16) -> u16) -> Self {
        let mut result = Self::default();
        for y in 0..CELLS_MAX {
            result.0[y] = operation(self.0[y], other.0[y]);
        }
        result
    }

    #[inline(always)]
    fn row(self, y: usize) -> u16 {
        self.0[y]
    }

    #[inline(always)]
    fn or(self, other: Self) -> Self {
        self.zip(other, |one, two| one | two)
    }

    #[inline(always)]
    fn and(self, other: Self) -> Self {
        self.zip(other, |one, two| one & two)
    }

    #[inline(always)]
    fn xor(self, other: Self) -> Self {
        self.zip(other, |one, two| one ^ two)
    }

    #[inline(always)]
    fn and_not(self, other: Self) -> Self {
        self.zip(other, |one, two| one & !two)
    }

    #[inline(always)]
    fn is_empty(self) -> bool {
        self.0.iter().fold(0, |all, row| all | row) == 0
    }

    /// The neighbour above along x, for every cell.
    #[inline(always)]
    fn next_x(self) -> Self {
        self.zip(self, |row, _| row >> 1)
    }

    /// The neighbour above along y, for every cell.
    #[inline(always)]
    fn next_y(self) -> Self {
        let mut above = Self::default();
        above.0[..CELLS_MAX - 1].copy_from_slice(&self.0[1..]);
        above
    }

    /// Bit (x, y) of the result is the point above cell (x, y): set when any of the four cells around it is.
    #[inline(always)]
    fn dilated(self) -> Self {
        let both = self.or(self.next_x());
        both.or(both.next_y())
    }

    /// Points between two layers at which the mask varies along all three axes.
    #[inline(always)]
    fn vertices(lower: Self, upper: Self) -> Self {
        let x = lower.xor(lower.next_x()).or(upper.xor(upper.next_x()));
        let y = lower.xor(lower.next_y()).or(upper.xor(upper.next_y()));
        let z = lower.xor(upper);
        x.or(x.next_y()).and(y.or(y.next_x())).and(z.dilated())
    }
}

/// The octant mask at point `x` of four rows: (y, z) below and above.
#[inline(always)]
fn mask_at(rows: [u32; 4], x: u32) -> usize {
    let pair = |row: u32| row >> x & 0b11;
    (pair(rows[0]) | pair(rows[1]) << 2 | pair(rows[2]) << 4 | pair(rows[3]) << 6) as usize
}

/// A ring of integers modulo a power of two: sums may wrap on the way, the result is right when it fits.
pub(super) trait Ring: Copy + Default + PartialEq {
    fn of(value: i32) -> Self;
    fn plus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
}

macro_rules! ring {
    ($($integer:ty),*) => {$(
        impl Ring for $integer {
            fn of(value: i32) -> Self {
                value.into()
            }
            fn plus(self, other: Self) -> Self {
                self.wrapping_add(other)
            }
            fn times(self, other: Self) -> Self {
                self.wrapping_mul(other)
            }
        }
    )*};
}

ring!(i64, i128, I256);

/// The table of weights as the kernel reads it: lanes of one vector.
/// Order: volume, area y, area z, edge x (3), area x, edge y (3), edge z (3), euler, vertices (4); filled up with zeros
/// to whole registers.
type Lanes = [i16; 32];
/// The first lanes are multiplied by x.
const LANES_X: usize = 6;
const AREA_X: usize = 6;
const EDGE_Y: usize = 7;
const EDGE_Z: usize = 10;
const EULER: usize = 13;
const VERTICES: usize = 14;
const COUNTS_END: usize = 18;

static KERNEL_WEIGHTS: [Lanes; 256] = {
    let mut table = [[0; 32]; 256];
    let mut mask = 0;
    while mask < 256 {
        let weights = &WEIGHTS[mask];
        let mut lanes = [0; 32];
        lanes[0] = weights.volume as i16;
        lanes[1] = weights.area[1] as i16;
        lanes[2] = weights.area[2] as i16;
        lanes[AREA_X] = weights.area[0] as i16;
        let mut kind = 0;
        while kind < 3 {
            lanes[3 + kind] = weights.edge[0][kind] as i16;
            lanes[EDGE_Y + kind] = weights.edge[1][kind] as i16;
            lanes[EDGE_Z + kind] = weights.edge[2][kind] as i16;
            kind += 1;
        }
        lanes[EULER] = weights.euler8 as i16;
        if let Some(vertex) = weights.vertex {
            lanes[VERTICES + vertex as usize] = 1;
        }
        table[mask] = lanes;
        mask += 1;
    }
    table
};

/// Sums along one line of points parallel to x.
#[derive(Clone, Copy, Default)]
struct Line<T> {
    /// Differences of weights. At most 15 points of at most 16 each: no lane overflows.
    plain: Lanes,
    /// The first lanes, times x.
    times_x: [T; LANES_X],
    /// Volume weights times x^2 and x^3.
    volume_x2: T,
    volume_x3: T,
}

impl<T: Ring> Line<T> {
    #[inline(always)]
    fn add(&mut self, x: i32, before: usize, after: usize) {
        let (before, after) = (&KERNEL_WEIGHTS[before], &KERNEL_WEIGHTS[after]);
        let mut lanes = [0; 32];
        for lane in 0..32 {
            lanes[lane] = after[lane] - before[lane];
            self.plain[lane] += lanes[lane];
        }
        let x = T::of(x);
        for (sum, lane) in self.times_x.iter_mut().zip(lanes) {
            *sum = sum.plus(T::of(lane.into()).times(x));
        }
        let x2 = x.times(x).times(T::of(lanes[0].into()));
        self.volume_x2 = self.volume_x2.plus(x2);
        self.volume_x3 = self.volume_x3.plus(x2.times(x));
    }
}

/// The difference of the measures in coordinates local to the cube.
#[derive(Clone, Debug, Default)]
struct Sums<T> {
    volume: T,
    first2: [T; 3],
    second3: [T; 3],
    product4: [T; 3],
    area: [T; 3],
    edge: [[T; 3]; 3],
    /// Euler times eight and vertices by kind: no coordinate, so they always fit.
    counts: [i64; 5],
}

impl<T: Ring> Sums<T> {
    #[inline(always)]
    fn add(&mut self, line: &Line<T>, y: i32, z: i32) {
        let plain = |lane: usize| T::of(line.plain[lane].into());
        let (y, z) = (T::of(y), T::of(z));
        let yz = y.times(z);
        let [volume_x, area_y, area_z, ..] = line.times_x;
        let (volume, volume_x2) = (volume_x.times(yz), line.volume_x2.times(yz));
        let add = |sum: &mut T, term: T| *sum = sum.plus(term);
        add(&mut self.volume, volume);
        add(&mut self.first2[0], volume_x2);
        add(&mut self.first2[1], volume.times(y));
        add(&mut self.first2[2], volume.times(z));
        add(&mut self.second3[0], line.volume_x3.times(yz));
        add(&mut self.second3[1], volume.times(y).times(y));
        add(&mut self.second3[2], volume.times(z).times(z));
        add(&mut self.product4[0], volume_x2.times(y));
        add(&mut self.product4[1], volume.times(yz));
        add(&mut self.product4[2], volume_x2.times(z));
        add(&mut self.area[0], plain(AREA_X).times(yz));
        add(&mut self.area[1], area_y.times(z));
        add(&mut self.area[2], area_z.times(y));
        for kind in 0..3 {
            add(&mut self.edge[0][kind], line.times_x[3 + kind]);
            add(&mut self.edge[1][kind], plain(EDGE_Y + kind).times(y));
            add(&mut self.edge[2][kind], plain(EDGE_Z + kind).times(z));
        }
        for (sum, lane) in self.counts.iter_mut().zip(&line.plain[EULER..COUNTS_END]) {
            *sum += i64::from(*lane);
        }
    }

    /// The same in scene coordinates, where `corner` is the origin of the local ones. Lengths, areas and counts are
    /// differences of one cube, so they do not change; moments do, and need the wider ring `U`.
    fn translate<U: Ring + From<T> + Into<I256>>(&self, corner: [i32; 3], to: &mut Measures)
    where
        T: Into<i128>,
    {
        let twice = |value: U| value.plus(value);
        let volume = U::from(self.volume);
        let first2 = self.first2.map(U::from);
        let by = corner.map(U::of);
        // Twice the integral of (x + a) is that of x and twice a times the volume.
        let half: [U; 3] = std::array::from_fn(|axis| volume.times(by[axis]));
        let moved2: [U; 3] = std::array::from_fn(|axis| first2[axis].plus(twice(half[axis])));
        for axis in 0..3 {
            to.first_moments2[axis] = moved2[axis].into().as_i128();
            // Three times the integral of (x + a)^2.
            let three = by[axis].plus(twice(by[axis]));
            let square = three.times(first2[axis].plus(half[axis]));
            to.second_moments3[axis] = U::from(self.second3[axis]).plus(square).into();
            // Four times the integral of (x + a)(y + b).
            let other = (axis + 1) % 3;
            let product2 = moved2[axis]
                .times(by[other])
                .plus(first2[other].times(by[axis]));
            to.product_moments4[axis] = U::from(self.product4[axis]).plus(twice(product2)).into();
        }
        let [euler8, vertices @ ..] = self.counts;
        to.volume = self.volume.into();
        to.area_by_axis = self.area.map(T::into);
        to.edge_length = self.edge.map(|axis| axis.map(T::into));
        (to.euler8, to.vertices) = (euler8, vertices);
    }

    fn translated<U: Ring + From<T> + Into<I256>>(&self, corner: [i32; 3]) -> Measures
    where
        T: Into<i128>,
    {
        let mut measures = Measures::default();
        self.translate::<U>(corner, &mut measures);
        measures
    }
}
