//! The kernel in vectors of 16-bit lanes, for edges of up to [`EDGE_MAX`] on processors with AVX2. Its slow twin is the portable
//! one, which also explains the plan.
//!
//! ```text
//!   box         one register: lo x, lo y, lo z, 0, -hi x, -hi y, -hi z, 0
//!               so that the common part of two boxes is the greater of each lane, and "contains" is "no lane greater"
//!   planes      per axis up to 15, in order, equal ones beside each other; cell i lies above left[i]:
//!               left = [base - 1, base, clips' planes .., top, top ..]; between equal planes nothing changes, so
//!               they need not be told apart
//!   layer       16 rows (y) of 16 bits (x): one register
//! ```
//! At the lower and the upper end of the points, `base` and `top` are the cube's own faces or lie just beyond the points.

use std::arch::x86_64::{
    __m128i, __m256i, _mm_blendv_epi8, _mm_cmpgt_epi16, _mm_extract_epi16, _mm_max_epi16,
    _mm_min_epi16, _mm_movemask_epi8, _mm_mullo_epi32, _mm_packs_epi16, _mm_packs_epi32,
    _mm_set1_epi16, _mm_setr_epi16, _mm_setr_epi32, _mm_setzero_si128, _mm_shuffle_epi8,
    _mm_shuffle_epi32, _mm_srli_si128, _mm_sub_epi16, _mm_sub_epi32, _mm_testz_si128,
    _mm_unpackhi_epi32, _mm_unpackhi_epi64, _mm_unpacklo_epi16, _mm_unpacklo_epi32,
    _mm_unpacklo_epi64, _mm256_add_epi16, _mm256_add_epi32, _mm256_add_epi64, _mm256_adds_epi16,
    _mm256_alignr_epi8, _mm256_and_si256, _mm256_andnot_si256, _mm256_blendv_epi8,
    _mm256_broadcastsi128_si256, _mm256_castsi128_si256, _mm256_castsi256_si128,
    _mm256_cmpeq_epi16, _mm256_cmpgt_epi16, _mm256_cvtepi32_epi64, _mm256_extract_epi64,
    _mm256_extracti128_si256, _mm256_max_epi16, _mm256_min_epi16, _mm256_movemask_epi8,
    _mm256_mul_epi32, _mm256_mulhi_epu16, _mm256_mullo_epi32, _mm256_or_si256,
    _mm256_permute2x128_si256, _mm256_permutevar8x32_epi32, _mm256_set_m128i, _mm256_set1_epi16,
    _mm256_setr_epi32, _mm256_setzero_si256, _mm256_shuffle_epi8, _mm256_sll_epi16,
    _mm256_srli_epi16, _mm256_sub_epi16, _mm256_sub_epi32, _mm256_testz_si256,
    _mm256_unpackhi_epi16, _mm256_unpackhi_epi32, _mm256_unpacklo_epi16, _mm256_unpacklo_epi32,
    _mm256_xor_si256, _pext_u64,
};

use super::super::neighbours::{self, Neighbours};
use super::{Span, Sums};
use crate::geometry::{EdgeKind, WEIGHTS};

/// The frame around a cube of this edge still fits 16-bit lanes, upper ends negated too.
pub(super) const EDGE_MAX: i32 = 32_766;
const _: () = assert!(EDGE_MAX + 1 == i16::MAX as i32);
/// In one plane of points the sums are those of areas and their second moments, at most `2 L^4` for a difference.
const _: () = assert!(2 * (EDGE_MAX as i128).pow(4) < 1 << 63);

/// Whether there is a stock near the cube.
pub(super) type Mode = usize;
/// The union alone is looked at.
pub(super) const UNION: Mode = 0;
/// The stock lies all around the cube: what comes to the union is removed from it.
pub(super) const INSIDE: Mode = 1;
/// A face of the stock is near.
pub(super) const ACROSS: Mode = 2;

/// Planes an axis: 16 cells are one row of bits.
const CELLS: usize = 16;
/// Each clip has at most one plane an axis that is none of the cube's own; `base` and `top` are the other two.
const LEAF_CLIPS_MAX: usize = CELLS - 3;
/// The stock may add two.
const fn leaf_clips<const MODE: Mode>() -> usize {
    if MODE == ACROSS {
        LEAF_CLIPS_MAX - 2
    } else {
        LEAF_CLIPS_MAX
    }
}

/// Offsets in a register.
const LANES: usize = 16;
/// An offset that neither reaches nor covers anything, and has no core.
const FAR: i16 = i16::MIN;

/// What of a cube is weighed: the points in its core, or the cells in its clip.
const CORE: usize = 0;
const CLIP: usize = 1;
/// Looking for clips within others ends after as many of the others.
const DROPS_MAX: usize = 8;

/// A list of offsets in the stack. Behind it there is room for a register of [`FAR`].
#[derive(Clone, Copy)]
struct List {
    first: usize,
    len: usize,
}

impl List {
    /// Its part of a column, in whole registers.
    #[inline]
    fn of(self, column: &[i16]) -> &[[i16; LANES]] {
        let end = self.first + self.len.next_multiple_of(LANES);
        column[self.first..end].as_chunks().0
    }

    /// Where the next list can begin.
    fn padded_end(self) -> usize {
        self.first + self.len + LANES
    }
}

/// How to bring the lanes of eight whose bits are set to the front.
static PACKING: [[u8; 16]; 256] = {
    let mut table = [[0; 16]; 256];
    let mut kept = 0;
    while kept < 256 {
        let (mut lane, mut to) = (0_u8, 0);
        while lane < 8 {
            if kept >> lane & 1 == 1 {
                table[kept][2 * to] = 2 * lane;
                table[kept][2 * to + 1] = 2 * lane + 1;
                to += 1;
            }
            lane += 1;
        }
        kept += 1;
    }
    table
};

/// A box in one register.
type Box16 = __m128i;
/// Sixteen rows of sixteen cells.
type Layer = __m256i;

/// The kernel with its working memory.
#[derive(Clone, Debug)]
pub(super) struct FastKernel {
    edge: i32,
    /// The cube in its own coordinates.
    own: Box16,
    /// The stock in the cube's coordinates, drawn in to the frame.
    stock: Box16,
    /// A stack of lists of offsets, a column for each axis: each level of the division adds one.
    offsets: [Vec<i16>; 3],
    /// The clips of a leaf.
    clips: Vec<Box16>,
    /// The sums of a cube that touches nothing, once there was one; for [`UNION`] and [`INSIDE`].
    alone: [Vec<Sums<i128>>; ACROSS],
    /// Boxes that contain everything newly covered; kept only when asked for.
    pub(super) uncovered: Vec<Span>,
    collect: bool,
}

/// The planes of a leaf, an axis each. Shape: `left[i]` is the plane below cell `i`.
struct Planes {
    left: [__m256i; 3],
    /// The same, negated.
    minus: [__m256i; 3],
    /// The plane above cell `i`.
    right: [__m256i; 3],
    /// Cells that can differ: the rest repeats the last.
    cells: usize,
}

/// What the weights of octant masks multiply, in the order of their lanes.
#[derive(Clone, Copy)]
#[repr(C, align(128))]
struct Row {
    /// Edges: along x by kind, along y by kind, two kinds along z.
    edges: [i32; 8],
    /// The third kind along z, then eight times Euler, vertices by kind.
    counts: [i32; 8],
    /// Area by axis of the normal, volume.
    areas: [i32; 4],
}
const _: () = assert!(size_of::<Row>() == 128);

static ROWS: [Row; 256] = {
    let mut rows = [Row {
        edges: [0; 8],
        counts: [0; 8],
        areas: [0; 4],
    }; 256];
    let mut mask = 0;
    while mask < 256 {
        let weights = &WEIGHTS[mask];
        let row = &mut rows[mask];
        let mut lane = 0;
        while lane < 9 {
            let weight = weights.edge[lane / 3][lane % 3] as i32;
            if lane < 8 {
                row.edges[lane] = weight;
            } else {
                row.counts[0] = weight;
            }
            lane += 1;
        }
        row.counts[1] = weights.euler8 as i32;
        if let Some(vertex) = weights.vertex {
            row.counts[2 + vertex as usize] = 1;
        }
        row.areas = [
            weights.area[0] as i32,
            weights.area[1] as i32,
            weights.area[2] as i32,
            weights.volume as i32,
        ];
        mask += 1;
    }
    rows
};

/// Sums over the points of a leaf, of one part.
#[derive(Clone, Copy)]
struct LeafSums {
    /// As [`Row::edges`] and [`Row::counts`], times the coordinate along the edge. Modulo 2^32: the true values fit.
    edges: __m256i,
    counts: __m256i,
    /// As [`Row::areas`], times two coordinates.
    areas: __m256i,
}

/// Sums of volume weights over the points of one plane across z: times xy, x^2 y, x y^2, x^3 y, x y^3, x^2 y^2.
#[derive(Clone, Copy, Default)]
struct PlaneSums {
    xy: i64,
    xxy: i64,
    xyy: i64,
    xxxy: i64,
    xyyy: i64,
    xxyy: i64,
}

impl FastKernel {
    pub(super) fn new(edge: i32) -> Self {
        Self {
            edge,
            own: four([0; 4]),
            stock: four([0; 4]),
            offsets: Default::default(),
            clips: Vec::new(),
            alone: Default::default(),
            uncovered: Vec::new(),
            collect: false,
        }
    }

    /// What the cube adds to the union and, when there is a stock, to its parts: removed and remaining. None when it is covered.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) fn difference<const MODE: Mode>(
        &mut self,
        neighbours: &Neighbours,
        stock: &Span,
        collect: bool,
        sums: &mut [Sums<i128>; 3],
    ) -> bool {
        self.collect = collect;
        self.uncovered.clear();
        let cube = Span::cube([0; 3], self.edge);
        let parts = if MODE == UNION { 1 } else { 3 };
        let sums_of_parts = &mut sums[..parts];
        let is_alone = MODE != ACROSS && neighbours.len == 0;
        if is_alone && !self.alone[MODE].is_empty() {
            sums_of_parts.clone_from_slice(&self.alone[MODE]);
            if collect {
                self.uncovered.push(cube);
            }
            return true;
        }
        self.own = boxed(&cube);
        if MODE == ACROSS {
            self.stock = boxed(&stock.clamped(&cube.grown()));
        }
        let Some(list) = self.list(neighbours) else {
            return false;
        };
        sums_of_parts.fill(Sums::default());
        self.divide::<MODE>(list, &cube, sums);
        if MODE == INSIDE {
            let [union, _, remaining] = sums;
            complement(union, remaining);
        }
        if is_alone {
            self.alone[MODE] = sums[..parts].to_vec();
        }
        sums[0].volume != 0
    }

    /// The first list of the stack; none when a neighbour is at the very same place.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn list(&mut self, neighbours: &Neighbours) -> Option<List> {
        const HALF: usize = LANES / 2;
        const _: () = assert!(HALF == neighbours::LANES);
        let list = List {
            first: 0,
            len: neighbours.len,
        };
        self.make_room(list.padded_end());
        let columns = [&neighbours.x, &neighbours.y, &neighbours.z];
        for (column, to) in columns.into_iter().zip(&mut self.offsets) {
            for index in (0..list.len).step_by(HALF) {
                let from: &[i32; HALF] = column[index..].first_chunk().expect("it is padded");
                let from = eight(*from);
                let (low, high) = halves(from);
                let narrow = narrow(_mm_packs_epi32(low, high));
                to[index..index + HALF].copy_from_slice(&narrow);
            }
            to[list.len..list.len + LANES].fill(FAR);
        }
        let zero = _mm256_setzero_si256();
        let mut same = zero;
        let [x, y, z] = &self.offsets;
        let (x, y, z) = (list.of(x), list.of(y), list.of(z));
        for index in 0..x.len() {
            let any = _mm256_or_si256(chunk(x[index]), chunk(y[index]));
            let any = _mm256_or_si256(any, chunk(z[index]));
            same = _mm256_or_si256(same, _mm256_cmpeq_epi16(any, zero));
        }
        (_mm256_testz_si256(same, same) == 1).then_some(list)
    }

    fn make_room(&mut self, end: usize) {
        if self.offsets[0].len() < end {
            for column in &mut self.offsets {
                column.resize(end.next_power_of_two(), FAR);
            }
        }
    }

    /// See the portable kernel.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn divide<const MODE: Mode>(&mut self, list: List, points: &Span, sums: &mut [Sums<i128>; 3]) {
        if list.len <= const { leaf_clips::<MODE>() } {
            self.clip(list, points);
            let points = boxed(points);
            let planes = self.planes::<MODE>(points);
            return self.leaf::<MODE>(points, &planes, sums);
        }
        let Some(core) = self.largest_core(list, points) else {
            return self.divide_thin::<MODE>(list, points, sums);
        };
        let mut rest = *points;
        for axis in 0..3 {
            if rest.min[axis] < core.min[axis] {
                let mut slab = rest;
                slab.max[axis] = core.min[axis] - 1;
                self.descend::<MODE>(list, &slab, sums);
                rest.min[axis] = core.min[axis];
            }
            if core.max[axis] < rest.max[axis] {
                let mut slab = rest;
                slab.min[axis] = core.max[axis] + 1;
                self.descend::<MODE>(list, &slab, sums);
                rest.max[axis] = core.max[axis];
            }
        }
    }

    /// Goes on with a part of the points and the cubes that reach it, unless one of them covers all that is there.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn descend<const MODE: Mode>(&mut self, list: List, points: &Span, sums: &mut [Sums<i128>; 3]) {
        let first = list.padded_end();
        self.make_room(first + list.len + 2 * LANES);
        let own = Span::cube([0; 3], self.edge).clamped(&points.grown());
        // A cube reaches the points when its offset is above the first and not above the second; likewise, it covers.
        let every = |from: [i32; 3]| from.map(|coordinate| _mm256_set1_epi16(lane(coordinate)));
        let beyond = |low: i32| low - self.edge - 1;
        let reach = [every(points.min.map(beyond)), every(points.max)];
        let cover = [every(own.max.map(beyond)), every(own.min)];
        let [x, y, z] = &mut self.offsets;
        let ((x, to_x), (y, to_y), (z, to_z)) = (
            x.split_at_mut(first),
            y.split_at_mut(first),
            z.split_at_mut(first),
        );
        let (x, y, z) = (list.of(x), list.of(y), list.of(z));
        let mut len = 0;
        for index in 0..x.len() {
            let offsets = [chunk(x[index]), chunk(y[index]), chunk(z[index])];
            let covers = between(&offsets, &cover);
            if _mm256_testz_si256(covers, covers) == 0 {
                return;
            }
            let kept = between(&offsets, &reach);
            let (low, high) = halves(kept);
            let [low, high, ..] = _mm_movemask_epi8(_mm_packs_epi16(low, high)).to_le_bytes();
            let middle = low.count_ones() as usize;
            let [low_packing, high_packing] =
                [low, high].map(|kept| sixteen(PACKING[usize::from(kept)]));
            pack(
                &mut to_x[len..],
                offsets[0],
                low_packing,
                middle,
                high_packing,
            );
            pack(
                &mut to_y[len..],
                offsets[1],
                low_packing,
                middle,
                high_packing,
            );
            pack(
                &mut to_z[len..],
                offsets[2],
                low_packing,
                middle,
                high_packing,
            );
            len += middle + high.count_ones() as usize;
        }
        let kept = List { first, len };
        self.pad(kept);
        self.divide::<MODE>(kept, points, sums);
    }

    /// The points around which a cube already fills all of this one, for the cube that has most of them, or nearly so.
    /// None when all have few.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn largest_core(&self, list: List, points: &Span) -> Option<Span> {
        let index = self.largest::<CORE>(list, points)?;
        let mut core = *points;
        for (axis, column) in self.offsets.iter().enumerate() {
            // Inside a cube's ends, or on this cube's own face where the other ends there or beyond.
            let offset = i32::from(column[index]);
            let low = if offset > 0 { offset + 1 } else { 0 };
            let high = self.edge + if offset < 0 { offset - 1 } else { 0 };
            core.min[axis] = core.min[axis].max(low);
            core.max[axis] = core.max[axis].min(high);
        }
        Some(core)
    }

    /// The cube of a list that has most of a box, or nearly so: of points in its core; or of cells in its clip, where the sum of the
    /// shares along the axes counts. None when all have hardly any.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn largest<const WHAT: usize>(&self, list: List, of: &Span) -> Option<usize> {
        let zero = _mm256_setzero_si256();
        let one = _mm256_set1_epi16(1);
        let edge = _mm256_set1_epi16(lane(self.edge));
        let low = of.min.map(|low| _mm256_set1_epi16(lane(low)));
        let high = of.max.map(|high| _mm256_set1_epi16(lane(high)));
        // As many along an axis as there are fill the 16 bits of a lane, so that products of high halves compare.
        let shift = [0, 1, 2].map(|axis| {
            let count = of.max[axis] - of.min[axis] + i32::from(WHAT == CORE);
            _mm_setr_epi32(count.leading_zeros().cast_signed() - 16, 0, 0, 0)
        });
        let mut best = zero;
        let mut best_chunk = zero;
        let mut number = zero;
        let [x, y, z] = &self.offsets;
        let (x, y, z) = (list.of(x), list.of(y), list.of(z));
        for index in 0..x.len() {
            let offsets = [chunk(x[index]), chunk(y[index]), chunk(z[index])];
            let count = |axis: usize| {
                let offset = offsets[axis];
                let count = if WHAT == CORE {
                    let from = _mm256_sub_epi16(offset, _mm256_cmpgt_epi16(offset, zero));
                    let from = _mm256_max_epi16(_mm256_max_epi16(from, zero), low[axis]);
                    let up_to = _mm256_adds_epi16(offset, _mm256_cmpgt_epi16(zero, offset));
                    let up_to = _mm256_add_epi16(_mm256_min_epi16(up_to, zero), edge);
                    let up_to = _mm256_min_epi16(up_to, high[axis]);
                    _mm256_add_epi16(_mm256_sub_epi16(up_to, from), one)
                } else {
                    let end = _mm256_min_epi16(_mm256_adds_epi16(offset, edge), high[axis]);
                    _mm256_sub_epi16(end, _mm256_max_epi16(offset, low[axis]))
                };
                _mm256_sll_epi16(_mm256_max_epi16(count, zero), shift[axis])
            };
            let share = if WHAT == CORE {
                let share = _mm256_mulhi_epu16(_mm256_mulhi_epu16(count(0), count(1)), count(2));
                _mm256_srli_epi16::<1>(share)
            } else {
                // A product would be lost in rounding for what is thin along two axes; and what contains a clip has a greater
                // sum, too.
                let quarter = |axis: usize| _mm256_srli_epi16::<3>(count(axis));
                _mm256_add_epi16(_mm256_add_epi16(quarter(0), quarter(1)), quarter(2))
            };
            let better = _mm256_cmpgt_epi16(share, best);
            best = _mm256_max_epi16(best, share);
            best_chunk = _mm256_blendv_epi8(best_chunk, number, better);
            number = _mm256_add_epi16(number, one);
        }
        let (shares, chunks) = (rows_of(best), rows_of(best_chunk));
        let lane = (0..LANES).max_by_key(|&lane| shares[lane])?;
        let index = list.first + LANES * usize::from(chunks[lane]) + lane;
        (shares[lane] > 0).then_some(index)
    }

    /// Drops cubes whose clips are within that of another, the largest first, until few are left or it does not pay.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn drop_covered(&mut self, mut list: List, points: &Span, few: usize) -> List {
        let cells = points.grown();
        let mut largest = Vec::new();
        while list.len + largest.len() > few && largest.len() < DROPS_MAX {
            let Some(index) = self.largest::<CLIP>(list, &cells) else {
                break;
            };
            let offset = [0, 1, 2].map(|axis| self.offsets[axis][index]);
            let mut bounds = [[_mm256_setzero_si256(); 3]; 2];
            for axis in 0..3 {
                // Beyond the cells it does not matter how far a cube goes.
                let (min, max) = (i32::from(offset[axis]), i32::from(offset[axis]) + self.edge);
                let above = if min <= cells.min[axis] {
                    FAR
                } else {
                    lane(min - 1)
                };
                let up_to = if max >= cells.max[axis] {
                    i16::MAX
                } else {
                    lane(max - self.edge)
                };
                bounds[0][axis] = _mm256_set1_epi16(above);
                bounds[1][axis] = _mm256_set1_epi16(up_to);
            }
            let far = _mm256_set1_epi16(FAR);
            let before = list.len;
            let chunks = list.len.div_ceil(LANES);
            list.len = 0;
            for number in 0..chunks {
                let first = list.first + LANES * number;
                let offsets = [0, 1, 2].map(|axis| {
                    chunk(
                        *self.offsets[axis][first..]
                            .first_chunk()
                            .expect("a list is padded"),
                    )
                });
                let there = _mm256_cmpgt_epi16(offsets[0], far);
                let kept = _mm256_andnot_si256(between(&offsets, &bounds), there);
                let (low, high) = halves(kept);
                let [low, high, ..] = _mm_movemask_epi8(_mm_packs_epi16(low, high)).to_le_bytes();
                let middle = low.count_ones() as usize;
                let [low_packing, high_packing] =
                    [low, high].map(|kept| sixteen(PACKING[usize::from(kept)]));
                // What is written here has been read: it is never more than that.
                for (column, lanes) in self.offsets.iter_mut().zip(offsets) {
                    let to = &mut column[list.first + list.len..];
                    pack(to, lanes, low_packing, middle, high_packing);
                }
                list.len += middle + high.count_ones() as usize;
            }
            largest.push(offset);
            self.pad(list);
            if before - list.len < 2 {
                break;
            }
        }
        self.make_room(list.padded_end() + largest.len());
        for offset in largest {
            for (column, offset) in self.offsets.iter_mut().zip(offset) {
                column[list.first + list.len] = offset;
            }
            list.len += 1;
        }
        self.pad(list);
        list
    }

    fn pad(&mut self, list: List) {
        let end = list.first + list.len;
        for column in &mut self.offsets {
            column[end..end + LANES].fill(FAR);
        }
    }

    /// No cube has much of a core: drop clips within others, then use the planes as they are, or halve the points at the
    /// median plane.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn divide_thin<const MODE: Mode>(
        &mut self,
        list: List,
        points: &Span,
        sums: &mut [Sums<i128>; 3],
    ) {
        let list = self.drop_covered(list, points, const { leaf_clips::<MODE>() });
        self.clip(list, points);
        let list = self.drop_dominated(list);
        let box16 = boxed(points);
        if list.len <= const { leaf_clips::<MODE>() } {
            let planes = self.planes::<MODE>(box16);
            return self.leaf::<MODE>(box16, &planes, sums);
        }
        let bound = unboxed(_mm_max_epi16(self.own, grown(box16)));
        let planes: [Vec<i32>; 3] = std::array::from_fn(|axis| {
            let ends = self.clips.iter().flat_map(|&clip| {
                let clip = unboxed(clip);
                [clip.min[axis], clip.max[axis]]
            });
            let mut planes: Vec<i32> = ends
                .filter(|plane| (bound.min[axis] + 1..bound.max[axis]).contains(plane))
                .collect();
            planes.sort_unstable();
            planes.dedup();
            planes
        });
        let most = (0..3)
            .max_by_key(|&axis| planes[axis].len())
            .expect("there are three axes");
        let count = planes[most].len();
        if count <= const { leaf_clips::<MODE>() } {
            let plane = |index: usize, axis: usize| {
                let plane: Option<&i32> = planes[axis].get(index);
                lane(plane.copied().unwrap_or(bound.max[axis]))
            };
            let planes = std::array::from_fn(|index| {
                let [x, y, z] = [0, 1, 2].map(|axis| plane(index, axis));
                _mm_setr_epi16(x, y, z, 0, 0, 0, 0, 0)
            });
            let planes = self.planes_from::<MODE>(planes, count, box16);
            return self.leaf::<MODE>(box16, &planes, sums);
        }
        let median = planes[most][count / 2];
        let (mut below, mut above) = (*points, *points);
        below.max[most] = median - 1;
        above.min[most] = median;
        self.descend::<MODE>(list, &below, sums);
        self.descend::<MODE>(list, &above, sums);
    }

    /// Cuts the cubes of a list to the cells next to the points.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn clip(&mut self, list: List, points: &Span) {
        let cells = grown(boxed(points));
        let edge = _mm_setr_epi32(-self.edge, -self.edge, -self.edge, 0);
        self.clips.clear();
        let range = list.first..list.first + list.len;
        let (x, y, z) = (
            &self.offsets[0][range.clone()],
            &self.offsets[1][range.clone()],
            &self.offsets[2][range],
        );
        // A plain loop: what is called from an iterator is not compiled for these instructions.
        for index in 0..list.len {
            let (x, y, z) = (x[index].into(), y[index].into(), z[index].into());
            let low = _mm_setr_epi32(x, y, z, 0);
            let clip = _mm_packs_epi32(low, _mm_sub_epi32(edge, low));
            self.clips.push(_mm_max_epi16(clip, cells));
        }
    }

    /// Drops clips within others, and their cubes from the list.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn drop_dominated(&mut self, list: List) -> List {
        // What is kept is never within another, so there are few to compare with.
        let mut kept = 0;
        for index in 0..list.len {
            let clip = self.clips[index];
            if self.is_within(kept, clip) {
                continue;
            }
            let mut stays = 0;
            for earlier in 0..kept {
                if !contains(clip, self.clips[earlier]) {
                    self.keep(list, earlier, stays);
                    stays += 1;
                }
            }
            self.keep(list, index, stays);
            kept = stays + 1;
        }
        self.clips.truncate(kept);
        let list = List {
            first: list.first,
            len: kept,
        };
        self.pad(list);
        list
    }

    /// Whether a clip is within one of the first `kept`.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn is_within(&self, kept: usize, clip: Box16) -> bool {
        for &other in &self.clips[..kept] {
            if contains(other, clip) {
                return true;
            }
        }
        false
    }

    fn keep(&mut self, list: List, index: usize, to: usize) {
        self.clips[to] = self.clips[index];
        for column in &mut self.offsets {
            column[list.first + to] = column[list.first + index];
        }
    }

    /// The planes of the clips, at most [`leaf_clips`] of them.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn planes<const MODE: Mode>(&self, points: Box16) -> Planes {
        let bound = _mm_max_epi16(self.own, grown(points));
        let (_, top) = ends(bound);
        let mut planes = [top; CELLS];
        for (plane, &clip) in planes.iter_mut().zip(&self.clips) {
            // A clip lies below its only plane or above it, because all cubes have one size.
            let inner = _mm_cmpgt_epi16(clip, bound);
            let (low, high) = ends(clip);
            let high = _mm_blendv_epi8(top, high, _mm_srli_si128::<8>(inner));
            *plane = _mm_blendv_epi8(high, low, inner);
        }
        self.planes_from::<MODE>(planes, self.clips.len(), points)
    }

    /// Puts planes in order: `count` of them, the rest equal to the top.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn planes_from<const MODE: Mode>(
        &self,
        mut planes: [__m128i; CELLS],
        mut count: usize,
        points: Box16,
    ) -> Planes {
        let bound = _mm_max_epi16(self.own, grown(points));
        let (base, top) = ends(bound);
        if MODE == ACROSS {
            let (low, high) = ends(self.stock);
            // Outside the points they are drawn in to the ends, where there are planes already.
            planes[count] = _mm_min_epi16(_mm_max_epi16(low, base), top);
            planes[count + 1] = _mm_min_epi16(_mm_max_epi16(high, base), top);
            count += 2;
        }
        sort(&mut planes, count);
        // [base - 1, base, 13 planes, top]
        let mut columns = [top; CELLS];
        columns[0] = _mm_sub_epi16(base, _mm_set1_epi16(1));
        columns[1] = base;
        columns[2..15].copy_from_slice(&planes[..13]);
        let left = transposed(&columns);
        // Above the last cell there is no plane, and so no point.
        let beyond = _mm256_set1_epi16(i16::MAX);
        let right = [0, 1, 2].map(|axis| next_row_from(left[axis], beyond));
        let minus = left.map(|left| _mm256_sub_epi16(_mm256_setzero_si256(), left));
        Planes {
            left,
            minus,
            right,
            cells: count + 3,
        }
    }

    /// Looks at all vertices among the points at once.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn leaf<const MODE: Mode>(
        &mut self,
        points: Box16,
        planes: &Planes,
        sums: &mut [Sums<i128>; 3],
    ) {
        let zero = _mm256_setzero_si256();
        let mut before = [zero; CELLS + 1];
        let mut from = [zero; CELLS + 1];
        let mut up_to = [zero; CELLS + 1];
        for &clip in &self.clips {
            let [x, y, z] = cells_of(clip, &planes.left, &planes.minus);
            let pattern = _mm256_and_si256(y, _mm256_set1_epi16(bits(x).cast_signed()));
            let layers = _mm256_movemask_epi8(z).cast_unsigned();
            let begin = (layers.trailing_zeros() / 2) as usize;
            let last = (layers.ilog2() / 2) as usize;
            if begin == 0 {
                up_to[last] = _mm256_or_si256(up_to[last], pattern);
            } else if last == CELLS - 1 {
                from[begin] = _mm256_or_si256(from[begin], pattern);
            } else {
                for layer in &mut before[begin..=last] {
                    *layer = _mm256_or_si256(*layer, pattern);
                }
            }
        }
        let cells = planes.cells;
        let mut rising = zero;
        for z in 0..cells {
            rising = _mm256_or_si256(rising, from[z]);
            before[z] = _mm256_or_si256(before[z], rising);
        }
        // What ends in one of the layers that repeat the last does not end.
        let mut falling = up_to[cells..]
            .iter()
            .fold(zero, |all, &layer| _mm256_or_si256(all, layer));
        for z in (0..cells).rev() {
            falling = _mm256_or_si256(falling, up_to[z]);
            before[z] = _mm256_or_si256(before[z], falling);
        }
        let own = _mm_max_epi16(self.own, grown(points));
        let [x, y, z] = cells_of(own, &planes.left, &planes.minus);
        let pattern = _mm256_and_si256(y, _mm256_set1_epi16(bits(x).cast_signed()));
        let layers = _mm256_movemask_epi8(z).cast_unsigned();
        let mut newly = [zero; CELLS + 1];
        let mut any = zero;
        for z in 0..cells {
            if layers >> (2 * z) & 1 == 1 {
                newly[z] = _mm256_andnot_si256(before[z], pattern);
                any = _mm256_or_si256(any, newly[z]);
            }
        }
        if _mm256_testz_si256(any, any) == 1 {
            return;
        }
        if self.collect {
            self.collect_box(planes, &newly, any);
        }
        self.add_points::<MODE>(points, planes, &before, &newly, sums);
    }

    /// Keeps one box around what a leaf newly covers.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn collect_box(&mut self, planes: &Planes, newly: &[Layer; CELLS + 1], any: Layer) {
        let rows = rows_of(any);
        let columns = rows.iter().fold(0, |columns, row| columns | row);
        let mut used = [u32::from(columns), 0, 0];
        for index in 0..CELLS {
            used[1] |= u32::from(rows[index] != 0) << index;
            let layer = newly[index];
            used[2] |= u32::from(_mm256_testz_si256(layer, layer) == 0) << index;
        }
        let mut span = Span {
            min: [0; 3],
            max: [0; 3],
        };
        for (axis, used) in used.into_iter().enumerate() {
            let (left, right) = (rows_of(planes.left[axis]), rows_of(planes.right[axis]));
            let (begin, last) = (used.trailing_zeros() as usize, used.ilog2() as usize);
            span.min[axis] = i32::from(left[begin].cast_signed());
            span.max[axis] = i32::from(right[last].cast_signed());
        }
        self.uncovered.push(span);
    }

    /// Adds the differences at the vertices among the points.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn add_points<const MODE: Mode>(
        &self,
        points: Box16,
        planes: &Planes,
        before: &[Layer; CELLS + 1],
        newly: &[Layer; CELLS + 1],
        sums: &mut [Sums<i128>; 3],
    ) {
        let at = [
            signed_rows_of(planes.right[0]),
            signed_rows_of(planes.right[1]),
            signed_rows_of(planes.right[2]),
        ];
        let points = unboxed(points);
        // Points are planes within the box of points.
        let [x, y, z] = [
            within(planes.right[0], points.min[0], points.max[0]),
            within(planes.right[1], points.min[1], points.max[1]),
            within(planes.right[2], points.min[2], points.max[2]),
        ];
        let valid_z = _mm256_movemask_epi8(z).cast_unsigned();
        let valid = _mm256_and_si256(y, _mm256_set1_epi16(bits(x).cast_signed()));
        let material = if MODE == ACROSS {
            Material::new(self.stock, &planes.left, &planes.minus)
        } else {
            Material::nowhere()
        };

        let mut leaf = [LeafSums::none(); 3];
        let mut lower = Shape::new(before[0], newly[0]);
        for z in 0..planes.cells - 1 {
            let upper = Shape::new(before[z + 1], newly[z + 1]);
            let near = _mm256_or_si256(lower.newly, upper.newly);
            if _mm256_testz_si256(near, near) == 1 || valid_z >> (2 * z) & 1 == 0 {
                lower = upper;
                continue;
            }
            let mut candidates = Shape::vertices::<MODE>(&lower, &upper, &material, z);
            candidates = _mm256_and_si256(candidates, _mm256_and_si256(dilated(near), valid));
            if _mm256_testz_si256(candidates, candidates) == 0 {
                let before = around(lower.before, upper.before);
                let after = around(lower.after, upper.after);
                let mut plane = [PlaneSums::default(); 3];
                let height = i32::from(at[2][z]);
                let candidates: [u64; 4] = [
                    _mm256_extract_epi64::<0>(candidates).cast_unsigned(),
                    _mm256_extract_epi64::<1>(candidates).cast_unsigned(),
                    _mm256_extract_epi64::<2>(candidates).cast_unsigned(),
                    _mm256_extract_epi64::<3>(candidates).cast_unsigned(),
                ];
                for (four, mut left) in candidates.into_iter().enumerate() {
                    while left != 0 {
                        let index = left.trailing_zeros();
                        left &= left - 1;
                        let column = index % 16;
                        let row = 4 * four + (index / 16) as usize;
                        let before = mask_at(&before, row, column);
                        let after = mask_at(&after, row, column);
                        let point = Point::new(
                            i32::from(at[0][column as usize]),
                            i32::from(at[1][row]),
                            height,
                        );
                        point.add(before, after, &mut leaf[0], &mut plane[0]);
                        if MODE == INSIDE {
                            leaf[2].add_counts(!before, !after);
                        }
                        if MODE == ACROSS {
                            let material = material.octants(column as usize, row, z);
                            point.add(
                                before & material,
                                after & material,
                                &mut leaf[1],
                                &mut plane[1],
                            );
                            point.add(
                                !before & material,
                                !after & material,
                                &mut leaf[2],
                                &mut plane[2],
                            );
                        }
                    }
                }
                for part in 0..if MODE == ACROSS { 3 } else { 1 } {
                    plane[part].add_to(&mut sums[part], height);
                }
            }
            lower = upper;
        }
        for part in 0..3 {
            if part == 0 || MODE == ACROSS || MODE == INSIDE && part == 2 {
                leaf[part].add_to(&mut sums[part]);
            }
        }
    }
}

/// A layer of cells before and after, and where the neighbour along x or y differs in one of the two.
struct Shape {
    before: Layer,
    after: Layer,
    newly: Layer,
    varies_x: Layer,
    varies_y: Layer,
}

impl Shape {
    #[target_feature(enable = "avx2")]
    #[inline]
    fn new(before: Layer, newly: Layer) -> Self {
        let after = _mm256_or_si256(before, newly);
        let varies_x = _mm256_or_si256(
            _mm256_xor_si256(before, next_column(before)),
            _mm256_xor_si256(after, next_column(after)),
        );
        let varies_y = _mm256_or_si256(
            _mm256_xor_si256(before, next_row(before)),
            _mm256_xor_si256(after, next_row(after)),
        );
        Self {
            before,
            after,
            newly,
            varies_x,
            varies_y,
        }
    }
}

impl Shape {
    /// Points above plane `z` at which the mask may vary along all three axes, before or after.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn vertices<const MODE: Mode>(
        lower: &Self,
        upper: &Self,
        material: &Material,
        z: usize,
    ) -> Layer {
        let varies_x = _mm256_or_si256(lower.varies_x, upper.varies_x);
        let varies_y = _mm256_or_si256(lower.varies_y, upper.varies_y);
        let varies_z = _mm256_or_si256(
            _mm256_xor_si256(lower.before, upper.before),
            _mm256_xor_si256(lower.after, upper.after),
        );
        let mut along_x = _mm256_or_si256(varies_x, next_row(varies_x));
        let mut along_y = _mm256_or_si256(varies_y, next_column(varies_y));
        let mut along_z = dilated(varies_z);
        if MODE == ACROSS {
            along_x = _mm256_or_si256(along_x, material.varies_x);
            along_y = _mm256_or_si256(along_y, material.varies_y);
            along_z = _mm256_or_si256(along_z, material.varies_z[z]);
        }
        _mm256_and_si256(_mm256_and_si256(along_x, along_y), along_z)
    }
}

/// Which octants around a point hold material of the stock: what holds for each of its coordinates.
struct Material {
    octants: [[u16; CELLS]; 3],
    varies_x: Layer,
    varies_y: Layer,
    /// By plane: all points or none.
    varies_z: [Layer; CELLS],
}

/// Octants below and above, by axis.
const SIDES: [[i16; 2]; 3] = [[0x55, 0xaa], [0x33, 0xcc], [0x0f, 0xf0]];

impl Material {
    /// There is no stock.
    #[target_feature(enable = "avx2")]
    fn nowhere() -> Self {
        Self {
            octants: [[0; CELLS]; 3],
            varies_x: _mm256_setzero_si256(),
            varies_y: _mm256_setzero_si256(),
            varies_z: [_mm256_setzero_si256(); CELLS],
        }
    }

    #[target_feature(enable = "avx2")]
    fn new(stock: Box16, left: &[__m256i; 3], minus: &[__m256i; 3]) -> Self {
        let cells = cells_of(stock, left, minus);
        let above = cells.map(|cells| next_row(cells));
        let octants = [0, 1, 2].map(|axis| {
            let [side_below, side_above] = SIDES[axis].map(|side| _mm256_set1_epi16(side));
            rows_of(_mm256_or_si256(
                _mm256_and_si256(cells[axis], side_below),
                _mm256_and_si256(above[axis], side_above),
            ))
        });
        let [x, y, z] = [0, 1, 2].map(|axis| _mm256_xor_si256(cells[axis], above[axis]));
        Self {
            octants,
            varies_x: _mm256_set1_epi16(bits(x).cast_signed()),
            varies_y: y,
            varies_z: rows_of(z).map(|all| _mm256_set1_epi16(all.cast_signed())),
        }
    }

    fn octants(&self, x: usize, y: usize, z: usize) -> u8 {
        let octants = self.octants[0][x] & self.octants[1][y] & self.octants[2][z];
        octants.to_le_bytes()[0]
    }
}

/// Where a point lies: the monomials that its weights are multiplied with.
struct Point {
    x: i64,
    y: i64,
    /// As [`Row::edges`].
    edges: __m256i,
    /// As [`Row::counts`].
    counts: __m256i,
    /// As [`Row::areas`]: yz, xz, xy, xy.
    areas: __m256i,
}

impl Point {
    #[target_feature(enable = "avx2")]
    #[inline]
    fn new(x: i32, y: i32, z: i32) -> Self {
        let at = _mm_setr_epi32(x, y, z, 1);
        let both = _mm256_castsi128_si256(at);
        let edges = _mm256_setr_epi32(0, 0, 0, 1, 1, 1, 2, 2);
        let counts = _mm256_setr_epi32(2, 3, 3, 3, 3, 3, 3, 3);
        // Lanes of `at` by two bits each, the last first: x x x y, then y y z z.
        let one = _mm_shuffle_epi32::<0b00_00_00_01>(at);
        let other = _mm_shuffle_epi32::<0b01_01_10_10>(at);
        Self {
            x: x.into(),
            y: y.into(),
            edges: _mm256_permutevar8x32_epi32(both, edges),
            counts: _mm256_permutevar8x32_epi32(both, counts),
            areas: _mm256_cvtepi32_epi64(_mm_mullo_epi32(one, other)),
        }
    }

    /// Adds the difference of weights at this point.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn add(&self, before: u8, after: u8, leaf: &mut LeafSums, plane: &mut PlaneSums) {
        let (before, after) = (&ROWS[usize::from(before)], &ROWS[usize::from(after)]);
        let edges = _mm256_sub_epi32(eight(after.edges), eight(before.edges));
        let counts = _mm256_sub_epi32(eight(after.counts), eight(before.counts));
        let areas = _mm_sub_epi32(four(after.areas), four(before.areas));
        let areas = _mm256_mul_epi32(_mm256_cvtepi32_epi64(areas), self.areas);
        leaf.edges = _mm256_add_epi32(leaf.edges, _mm256_mullo_epi32(edges, self.edges));
        leaf.counts = _mm256_add_epi32(leaf.counts, _mm256_mullo_epi32(counts, self.counts));
        leaf.areas = _mm256_add_epi64(leaf.areas, areas);
        plane.add(_mm256_extract_epi64::<3>(areas), self.x, self.y);
    }
}

impl LeafSums {
    #[target_feature(enable = "avx2")]
    #[inline]
    fn none() -> Self {
        let zero = _mm256_setzero_si256();
        Self {
            edges: zero,
            counts: zero,
            areas: zero,
        }
    }

    /// Adds the counts alone: what no rule about complements gives.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn add_counts(&mut self, before: u8, after: u8) {
        let (before, after) = (&ROWS[usize::from(before)], &ROWS[usize::from(after)]);
        let counts = _mm256_sub_epi32(eight(after.counts), eight(before.counts));
        self.counts = _mm256_add_epi32(self.counts, counts);
    }

    #[target_feature(enable = "avx2")]
    fn add_to(&self, sums: &mut Sums<i128>) {
        let (edges, counts) = (lanes32(self.edges), lanes32(self.counts));
        let along = edges.into_iter().chain([counts[0]]);
        for (sum, length) in sums.edge.as_flattened_mut().iter_mut().zip(along) {
            *sum += i128::from(length);
        }
        let areas = [
            _mm256_extract_epi64::<0>(self.areas),
            _mm256_extract_epi64::<1>(self.areas),
            _mm256_extract_epi64::<2>(self.areas),
        ];
        for (sum, area) in sums.area.iter_mut().zip(areas) {
            *sum += i128::from(area);
        }
        for (sum, count) in sums.counts.iter_mut().zip(&counts[1..]) {
            *sum += i64::from(*count);
        }
    }
}

impl PlaneSums {
    #[inline]
    fn add(&mut self, xy: i64, x: i64, y: i64) {
        let (xxy, xyy) = (xy.wrapping_mul(x), xy.wrapping_mul(y));
        self.xy = self.xy.wrapping_add(xy);
        self.xxy = self.xxy.wrapping_add(xxy);
        self.xyy = self.xyy.wrapping_add(xyy);
        self.xxxy = self.xxxy.wrapping_add(xxy.wrapping_mul(x));
        self.xyyy = self.xyyy.wrapping_add(xyy.wrapping_mul(y));
        self.xxyy = self.xxyy.wrapping_add(xxy.wrapping_mul(y));
    }

    fn add_to(&self, sums: &mut Sums<i128>, z: i32) {
        let wide = i128::from;
        let z = i64::from(z);
        let (z1, z2, z3) = (wide(z), wide(z * z), wide(z * z * z));
        sums.volume += wide(self.xy) * z1;
        sums.first2[0] += wide(self.xxy) * z1;
        sums.first2[1] += wide(self.xyy) * z1;
        sums.first2[2] += wide(self.xy) * z2;
        sums.second3[0] += wide(self.xxxy) * z1;
        sums.second3[1] += wide(self.xyyy) * z1;
        sums.second3[2] += wide(self.xy) * z3;
        sums.product4[0] += wide(self.xxyy) * z1;
        sums.product4[1] += wide(self.xyy) * z2;
        sums.product4[2] += wide(self.xxy) * z2;
    }
}

/// What the material around loses to a union that grows inside it; its counts are there already.
fn complement(union: &Sums<i128>, remaining: &mut Sums<i128>) {
    remaining.volume = -union.volume;
    remaining.first2 = union.first2.map(|moment| -moment);
    remaining.second3 = union.second3.map(|moment| -moment);
    remaining.product4 = union.product4.map(|moment| -moment);
    remaining.area = union.area;
    let (convex, concave) = (EdgeKind::Convex as usize, EdgeKind::Concave as usize);
    remaining.edge = union.edge.map(|mut along| {
        along.swap(convex, concave);
        along
    });
}

/// For each row the four rows around its points: this and the next of the lower layer, then of the upper.
#[target_feature(enable = "avx2")]
#[inline]
fn around(lower: Layer, upper: Layer) -> [[u64; 4]; 4] {
    let (lower_next, upper_next) = (next_row(lower), next_row(upper));
    let low = [
        _mm256_unpacklo_epi16(lower, lower_next),
        _mm256_unpackhi_epi16(lower, lower_next),
    ];
    let high = [
        _mm256_unpacklo_epi16(upper, upper_next),
        _mm256_unpackhi_epi16(upper, upper_next),
    ];
    [
        words(_mm256_unpacklo_epi32(low[0], high[0])),
        words(_mm256_unpackhi_epi32(low[0], high[0])),
        words(_mm256_unpacklo_epi32(low[1], high[1])),
        words(_mm256_unpackhi_epi32(low[1], high[1])),
    ]
}

/// The octant mask at the point above cell (row, column), from the rows [`around`].
#[target_feature(enable = "bmi2")]
#[inline]
fn mask_at(around: &[[u64; 4]; 4], row: usize, column: u32) -> u8 {
    // Interleaving works on each half of a register, so rows 0, 1, 8, 9 come first, then 2, 3, 10, 11, and so on.
    let word = around[row / 2 % 4][row / 8 % 2 * 2 + row % 2];
    _pext_u64(word >> column, 0x0003_0003_0003_0003).to_le_bytes()[0]
}

/// The box in a register; it fits [`Box16`] because every box is inside the frame.
#[target_feature(enable = "avx2")]
#[inline]
fn boxed(span: &Span) -> Box16 {
    let (low, high) = (span.min.map(lane), span.max.map(|high| lane(-high)));
    _mm_setr_epi16(low[0], low[1], low[2], 0, high[0], high[1], high[2], 0)
}

#[inline]
fn lane(coordinate: i32) -> i16 {
    i16::try_from(coordinate).expect("everything near a cube of a small edge is small")
}

#[target_feature(enable = "avx2")]
#[inline]
fn unboxed(box16: Box16) -> Span {
    let lane = |lane: i32| i32::from(u16::try_from(lane).expect("16 bits").cast_signed());
    Span {
        min: [
            lane(_mm_extract_epi16::<0>(box16)),
            lane(_mm_extract_epi16::<1>(box16)),
            lane(_mm_extract_epi16::<2>(box16)),
        ],
        max: [
            -lane(_mm_extract_epi16::<4>(box16)),
            -lane(_mm_extract_epi16::<5>(box16)),
            -lane(_mm_extract_epi16::<6>(box16)),
        ],
    }
}

/// The lower ends and the upper ends, in the first three lanes each.
#[target_feature(enable = "avx2")]
#[inline]
fn ends(box16: Box16) -> (__m128i, __m128i) {
    let high = _mm_sub_epi16(_mm_setzero_si128(), _mm_srli_si128::<8>(box16));
    (box16, high)
}

#[target_feature(enable = "avx2")]
#[inline]
fn contains(outer: Box16, inner: Box16) -> bool {
    let beyond = _mm_cmpgt_epi16(outer, inner);
    _mm_testz_si128(beyond, beyond) == 1
}

/// The cells next to a box of points.
#[target_feature(enable = "avx2")]
#[inline]
fn grown(points: Box16) -> Box16 {
    _mm_sub_epi16(points, _mm_setr_epi16(1, 1, 1, 0, 1, 1, 1, 0))
}

/// The cells of a box, as a lane each, by axis.
#[target_feature(enable = "avx2")]
#[inline]
fn cells_of(clip: Box16, left: &[__m256i; 3], minus: &[__m256i; 3]) -> [__m256i; 3] {
    // Each 16-bit lane in turn, in all lanes.
    const fn every(lane: u8) -> [u8; 16] {
        let mut bytes = [0; 16];
        let mut index = 0;
        while index < 16 {
            bytes[index] = 2 * lane;
            bytes[index + 1] = 2 * lane + 1;
            index += 2;
        }
        bytes
    }
    const LOW: [[u8; 16]; 3] = [every(0), every(1), every(2)];
    const HIGH: [[u8; 16]; 3] = [every(4), every(5), every(6)];
    let clip = _mm256_broadcastsi128_si256(clip);
    let spread =
        |lanes: [u8; 16]| _mm256_shuffle_epi8(clip, _mm256_broadcastsi128_si256(sixteen(lanes)));
    let cells = |axis: usize| {
        _mm256_andnot_si256(
            _mm256_cmpgt_epi16(spread(LOW[axis]), left[axis]),
            _mm256_cmpgt_epi16(minus[axis], spread(HIGH[axis])),
        )
    };
    [cells(0), cells(1), cells(2)]
}

/// Lanes above the first bound and not above the second, on all axes.
#[target_feature(enable = "avx2")]
#[inline]
fn between(offsets: &[__m256i; 3], bounds: &[[__m256i; 3]; 2]) -> __m256i {
    let mut inside = _mm256_andnot_si256(
        _mm256_cmpgt_epi16(offsets[0], bounds[1][0]),
        _mm256_cmpgt_epi16(offsets[0], bounds[0][0]),
    );
    for axis in 1..3 {
        inside = _mm256_and_si256(inside, _mm256_cmpgt_epi16(offsets[axis], bounds[0][axis]));
        inside = _mm256_andnot_si256(_mm256_cmpgt_epi16(offsets[axis], bounds[1][axis]), inside);
    }
    inside
}

/// Writes the packed lanes of the lower half, and from `middle` on those of the upper half.
#[target_feature(enable = "avx2")]
#[inline]
fn pack(to: &mut [i16], lanes: __m256i, low: __m128i, middle: usize, high: __m128i) {
    const HALF: usize = LANES / 2;
    let (first, second) = halves(lanes);
    to[..HALF].copy_from_slice(&narrow(_mm_shuffle_epi8(first, low)));
    to[middle..middle + HALF].copy_from_slice(&narrow(_mm_shuffle_epi8(second, high)));
}

#[target_feature(enable = "avx2")]
#[inline]
fn halves(lanes: __m256i) -> (__m128i, __m128i) {
    (
        _mm256_castsi256_si128(lanes),
        _mm256_extracti128_si256::<1>(lanes),
    )
}

/// Lanes from one bound to another, both included.
#[target_feature(enable = "avx2")]
#[inline]
fn within(lanes: __m256i, min: i32, max: i32) -> __m256i {
    _mm256_andnot_si256(
        _mm256_cmpgt_epi16(lanes, _mm256_set1_epi16(lane(max))),
        _mm256_cmpgt_epi16(lanes, _mm256_set1_epi16(lane(min - 1))),
    )
}

/// A bit for each lane that is set.
#[target_feature(enable = "avx2")]
#[inline]
fn bits(lanes: __m256i) -> u16 {
    let (low, high) = halves(lanes);
    let bits = _mm_movemask_epi8(_mm_packs_epi16(low, high));
    u16::try_from(bits).expect("sixteen lanes")
}

/// Each row takes the one above it; the last is empty.
#[target_feature(enable = "avx2")]
#[inline]
fn next_row(layer: Layer) -> Layer {
    let above = _mm256_permute2x128_si256::<0x81>(layer, layer);
    _mm256_alignr_epi8::<2>(above, layer)
}

/// The same with another last row.
#[target_feature(enable = "avx2")]
#[inline]
fn next_row_from(layer: Layer, last: Layer) -> Layer {
    let above = _mm256_permute2x128_si256::<0x21>(layer, last);
    _mm256_alignr_epi8::<2>(above, layer)
}

#[target_feature(enable = "avx2")]
#[inline]
fn next_column(layer: Layer) -> Layer {
    _mm256_srli_epi16::<1>(layer)
}

/// The point above each cell: set when any of the four cells around it is.
#[target_feature(enable = "avx2")]
#[inline]
fn dilated(layer: Layer) -> Layer {
    let both = _mm256_or_si256(layer, next_column(layer));
    _mm256_or_si256(both, next_row(both))
}

/// Sixteen registers of (x, y, z, ..) to three of sixteen lanes.
#[target_feature(enable = "avx2")]
#[inline]
fn transposed(columns: &[__m128i; CELLS]) -> [__m256i; 3] {
    let two = |index: usize| _mm_unpacklo_epi16(columns[2 * index], columns[2 * index + 1]);
    // x x x x y y y y, and z z z z
    let four = |index: usize| {
        let (one, other) = (two(2 * index), two(2 * index + 1));
        (
            _mm_unpacklo_epi32(one, other),
            _mm_unpackhi_epi32(one, other),
        )
    };
    let eight = |index: usize| {
        let ((one, one_z), (other, other_z)) = (four(2 * index), four(2 * index + 1));
        [
            _mm_unpacklo_epi64(one, other),
            _mm_unpackhi_epi64(one, other),
            _mm_unpacklo_epi64(one_z, other_z),
        ]
    };
    let (low, high) = (eight(0), eight(1));
    [0, 1, 2].map(|axis| _mm256_set_m128i(high[axis], low[axis]))
}

/// Sorts each lane of the first `count` registers by itself; those behind are not less than any of them.
/// # Source
/// The networks with the fewest comparators known (D. E. Knuth, TAOCP 3, 5.3.4; B. Dobbelaere's list for 13 inputs).
#[target_feature(enable = "avx2")]
#[inline]
fn sort(planes: &mut [__m128i; CELLS], count: usize) {
    macro_rules! network {
        ($(($low:literal, $high:literal))*) => {{
            $(
                let (low, high) = (planes[$low], planes[$high]);
                planes[$low] = _mm_min_epi16(low, high);
                planes[$high] = _mm_max_epi16(low, high);
            )*
        }};
    }
    match count {
        0 | 1 => {}
        2..=4 => network!((0, 2)(1, 3)(0, 1)(2, 3)(1, 2)),
        5..=8 => network!(
            (0, 2)(1, 3)(4, 6)(5, 7)(0, 4)(1, 5)(2, 6)(3, 7)(0, 1)(2, 3)(4, 5)(6, 7)(2, 4)(3, 5)(
                1, 4
            )(3, 6)(1, 2)(3, 4)(5, 6)
        ),
        _ => network!((0, 12)(1, 10)(2, 9)(3, 7)(5, 11)(6, 8)(1, 6)(2, 3)(4, 11)(
            7, 9
        )(8, 10)(0, 4)(1, 2)(3, 6)(7, 8)(9, 10)(11, 12)(4, 6)(
            5, 9
        )(8, 11)(10, 12)(0, 5)(3, 8)(4, 7)(6, 11)(9, 10)(
            0, 1
        )(2, 5)(6, 9)(7, 8)(10, 11)(1, 3)(2, 4)(5, 6)(9, 10)(
            1, 2
        )(3, 4)(5, 7)(6, 8)(2, 3)(4, 5)(6, 7)(8, 9)(3, 4)(
            5, 6
        )),
    }
}

/// Arrays to registers and back.
macro_rules! recast {
    ($($name:ident: $from:ty => $to:ty;)*) => {$(
        #[expect(unsafe_code, reason = "registers have no safe way in or out")]
        #[inline]
        fn $name(lanes: $from) -> $to {
            // SAFETY: plain integers of the same size; every bit pattern is valid on both sides.
            unsafe { std::mem::transmute::<$from, $to>(lanes) }
        }
    )*};
}

recast! {
    rows_of: __m256i => [u16; 16];
    signed_rows_of: __m256i => [i16; 16];
    lanes32: __m256i => [i32; 8];
    words: __m256i => [u64; 4];
    chunk: [i16; 16] => __m256i;
    narrow: __m128i => [i16; 8];
    eight: [i32; 8] => __m256i;
    four: [i32; 4] => __m128i;
    sixteen: [u8; 16] => __m128i;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A network that sorts all inputs of zeros and ones sorts everything (Knuth's zero-one principle).
    #[test]
    fn networks_sort() {
        if !is_x86_feature_detected!("avx2") {
            return;
        }
        for count in 0..=LEAF_CLIPS_MAX {
            for input in 0..1_u32 << count {
                let bit = |index: usize| index >= count || input >> index & 1 == 1;
                #[expect(unsafe_code, reason = "the feature was detected")]
                // SAFETY: AVX2 was detected above.
                let sorted = unsafe { sorted(bit, count) };
                let ones = count - input.count_ones() as usize;
                let expected: Vec<i16> = (0..LEAF_CLIPS_MAX)
                    .map(|at| i16::from(at >= ones))
                    .collect();
                assert_eq!(sorted, expected, "{count} inputs: {input:b}");
            }
        }
    }

    #[target_feature(enable = "avx2")]
    fn sorted(bit: impl Fn(usize) -> bool, count: usize) -> Vec<i16> {
        let mut planes: [__m128i; CELLS] =
            std::array::from_fn(|index| _mm_set1_epi16(i16::from(bit(index))));
        sort(&mut planes, count);
        let lane = |plane: &__m128i| i16::try_from(_mm_extract_epi16::<1>(*plane)).unwrap();
        planes[..LEAF_CLIPS_MAX].iter().map(lane).collect()
    }
}
