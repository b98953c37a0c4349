//! The leaf: all vertices among the points of a box at once, bit-parallel.
//!
//! ```text
//!   planes      per axis up to 15, in order, equal ones beside each other; cell i lies above left[i]:
//!               left = [base - 1, base, the clips' planes .., top, top ..]; between equal planes nothing changes, so
//!               they need not be told apart
//!   layer       the cells between two planes across z: 16 rows (y) of 16 bits (x)
//!   points      right[i] is the plane above cell i: point (x, y, z) lies between the cells (x, y, z) and (x + 1, y + 1, z + 1)
//! ```
//! At the lower and the upper end of the points, `base` and `top` are the cube's own faces or lie just beyond the points.
//!
//! Points are *enumerated* here, with the octants around them before and after; what is done with them is a [`Visitor`]'s affair.

use super::plan::{Boxed, Column, Corner, List, Plan};
use super::span::Span;
use super::width::Width;
use crate::engine::lanes::{Columns, Coordinate, LANES, Lanes, Task};

/// Planes of an axis that the network sorts: all but `base - 1`, `base` and the last `top`.
const PLANES: usize = LANES - 3;

/// An array of one value for each axis; the axis is a constant in each of them.
macro_rules! by_axis {
    ($axis:ident => $value:expr) => {
        [
            {
                const $axis: usize = 0;
                $value
            },
            {
                const $axis: usize = 1;
                $value
            },
            {
                const $axis: usize = 2;
                $value
            },
        ]
    };
}

/// The planes of a leaf, by axis.
pub(super) struct Planes<L: Columns<W::Coordinate>, W: Width> {
    /// The plane below each cell.
    left: [Column<L, W>; 3],
    /// The same, negated.
    minus: [Column<L, W>; 3],
    /// The plane above each cell.
    right: [Column<L, W>; 3],
    /// Cells that can differ: the rest repeats the last.
    cells: usize,
}

/// A layer of cells for each plane across z below it, and empty ones, so that what is above any row of them is there.
type Layers = [[u16; LANES]; LAYERS];
const LAYERS: usize = LANES + 2;

/// What is done with the points that a leaf enumerates. One lives as long as the leaf, the total as long as the cube.
pub(super) trait Visitor<L: Lanes, W: Width> {
    /// Whether it looks at the material of the stock: then points are enumerated where that varies, too.
    const STOCK: bool;
    type Total;

    fn new(lanes: L) -> Self;
    /// A point, and which of its octants are inside the union before and after the cube, and inside the stock.
    fn visit(&mut self, lanes: L, at: [i32; 3], before: u8, after: u8, material: u8);
    /// There are no more points of this z.
    fn end_plane(&mut self, z: i32, total: &mut Self::Total);
    /// There are no more points.
    fn end_leaf(self, lanes: L, total: &mut Self::Total);
    /// There are no more leaves.
    fn end(total: &mut Self::Total);
}

/// Looks at a box of points near which there are few cubes.
pub(super) struct Leaf<'a, L: Columns<W::Coordinate>, W: Width, V: Visitor<L, W>> {
    pub(super) plan: &'a mut Plan<L, W>,
    pub(super) list: List,
    pub(super) points: Span,
    pub(super) total: &'a mut V::Total,
}

impl<L: Columns<W::Coordinate>, W: Width, V: Visitor<L, W>> Task for Leaf<'_, L, W, V> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self {
            plan,
            list,
            points,
            total,
        } = self;
        let lanes = plan.lanes;
        plan.clip(list, &points);
        let points = plan.boxed(&points);
        let planes = &plan.planes::<V>(points);
        lanes.run(LeafOf::<L, W, V> {
            plan,
            points,
            planes,
            total,
        });
    }
}

/// Looks at all vertices among the points of a box at once, given its planes and the plan's clips.
pub(super) struct LeafOf<'a, L: Columns<W::Coordinate>, W: Width, V: Visitor<L, W>> {
    pub(super) plan: &'a mut Plan<L, W>,
    pub(super) points: Boxed<L, W>,
    pub(super) planes: &'a Planes<L, W>,
    pub(super) total: &'a mut V::Total,
}

impl<L: Columns<W::Coordinate>, W: Width, V: Visitor<L, W>> Task for LeafOf<'_, L, W, V> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self {
            plan,
            points,
            planes,
            total,
        } = self;
        plan.leaf::<V>(points, planes, total);
    }
}

impl<L: Columns<W::Coordinate>, W: Width> Plan<L, W> {
    /// The planes of the clips, at most as many as a leaf may have.
    #[inline(always)]
    fn planes<V: Visitor<L, W>>(&self, points: Boxed<L, W>) -> Planes<L, W> {
        let lanes = self.lanes;
        let bound = lanes.common_box(self.own, self.grown(points));
        let [_, top] = self.ends(bound);
        let mut planes = [top; LANES];
        for (plane, &clip) in planes[..PLANES].iter_mut().zip(&self.clips) {
            // A clip lies below its only plane or above it, because all cubes have one size.
            let [inner_low, inner_high] = lanes.halves(lanes.box_is_above(clip, bound));
            let [low, high] = self.ends(clip);
            let high = lanes.select_corner(inner_high, high, top);
            *plane = lanes.select_corner(inner_low, low, high);
        }
        self.planes_from::<V>(planes, self.clips.len(), points)
    }

    /// Puts planes in order: `count` of them, the rest equal to the top.
    #[inline(always)]
    pub(super) fn planes_from<V: Visitor<L, W>>(
        &self,
        mut planes: [Corner<L, W>; LANES],
        mut count: usize,
        points: Boxed<L, W>,
    ) -> Planes<L, W> {
        let lanes = self.lanes;
        let bound = lanes.common_box(self.own, self.grown(points));
        let [base, top] = self.ends(bound);
        if V::STOCK {
            // Outside the points they are drawn in to the ends, where there are planes already.
            for end in self.ends(self.stock) {
                planes[count] = lanes.lesser_corner(lanes.greater_corner(end, base), top);
                count += 1;
            }
        }
        sort(lanes, &mut planes, count);
        let mut corners = [top; LANES];
        let one = lanes.every_corner(W::Coordinate::of(1));
        corners[0] = lanes.corner_minus(base, one);
        corners[1] = base;
        corners[2..2 + PLANES].copy_from_slice(&planes[..PLANES]);
        let left = lanes.columns(&corners);
        // Above the last cell there is no plane, and so no point.
        let beyond = lanes.every(W::Coordinate::MAX);
        let zero = lanes.every(W::Coordinate::ZERO);
        Planes {
            left,
            minus: by_axis!(AXIS => lanes.minus(zero, left[AXIS])),
            right: by_axis!(AXIS => lanes.next(left[AXIS], beyond)),
            cells: count + 3,
        }
    }

    #[inline(always)]
    fn leaf<V: Visitor<L, W>>(
        &mut self,
        points: Boxed<L, W>,
        planes: &Planes<L, W>,
        total: &mut V::Total,
    ) {
        let lanes = self.lanes;
        let none = lanes.every_row(0);
        let mut before: Layers = [[0; LANES]; LAYERS];
        // A clip fills the layers from one to another. Where it begins in the first or ends in the last it is enough to note
        // the other end.
        let mut from = before;
        let mut up_to = before;
        for &clip in &self.clips {
            let [x, y, z] = self.cells_of(clip, planes);
            let pattern = lanes.and(lanes.rows_of(y), lanes.every_row(lanes.bits(x)));
            let layers = u32::from(lanes.bits(z));
            let begin = layers.trailing_zeros() as usize;
            let last = layers.ilog2() as usize;
            if begin == 0 {
                fill(lanes, &mut up_to[last], pattern);
            } else if last == LANES - 1 {
                fill(lanes, &mut from[begin], pattern);
            } else {
                for layer in &mut before[begin..=last] {
                    fill(lanes, layer, pattern);
                }
            }
        }
        let cells = planes.cells;
        let mut rising = none;
        for z in 0..cells {
            rising = lanes.or(rising, lanes.rows(from[z]));
            fill(lanes, &mut before[z], rising);
        }
        // What ends in one of the layers that repeat the last does not end.
        let mut falling = none;
        for layer in &up_to[cells..] {
            falling = lanes.or(falling, lanes.rows(*layer));
        }
        for z in (0..cells).rev() {
            falling = lanes.or(falling, lanes.rows(up_to[z]));
            fill(lanes, &mut before[z], falling);
        }
        let own = lanes.common_box(self.own, self.grown(points));
        let [x, y, z] = self.cells_of(own, planes);
        let pattern = lanes.and(lanes.rows_of(y), lanes.every_row(lanes.bits(x)));
        let layers = lanes.bits(z);
        let mut newly = [none; LANES + 1];
        let mut any = none;
        for z in 0..cells {
            if layers >> z & 1 == 1 {
                newly[z] = lanes.without(pattern, lanes.rows(before[z]));
                any = lanes.or(any, newly[z]);
            }
        }
        if lanes.is_empty(any) {
            return;
        }
        if self.collect {
            self.collect_box(planes, &newly, any);
        }
        // What is after takes the place of what is no longer needed.
        let after = &mut from;
        self.enumerate::<V>(points, planes, [&mut before, after], &newly, total);
    }

    /// Keeps one box around what a leaf newly covers.
    #[inline(always)]
    fn collect_box(&mut self, planes: &Planes<L, W>, newly: &[L::Rows; LANES + 1], any: L::Rows) {
        let lanes = self.lanes;
        let rows = lanes.rows_array(any);
        let mut used = [0; 3];
        for index in 0..LANES {
            used[0] |= u32::from(rows[index]);
            used[1] |= u32::from(rows[index] != 0) << index;
            used[2] |= u32::from(!lanes.is_empty(newly[index])) << index;
        }
        let mut span = Span {
            min: [0; 3],
            max: [0; 3],
        };
        for (axis, used) in used.into_iter().enumerate() {
            let left = lanes.column_array(planes.left[axis]);
            let right = lanes.column_array(planes.right[axis]);
            span.min[axis] = left[used.trailing_zeros() as usize].into();
            span.max[axis] = right[used.ilog2() as usize].into();
        }
        self.uncovered.push(span);
    }

    /// Shows the visitor every point at which the octants differ along all three axes, before or after, next to what is newly
    /// covered; plane by plane across z.
    #[inline(always)]
    fn enumerate<V: Visitor<L, W>>(
        &self,
        points: Boxed<L, W>,
        planes: &Planes<L, W>,
        [before, after]: [&mut Layers; 2],
        newly: &[L::Rows; LANES + 1],
        total: &mut V::Total,
    ) {
        let lanes = self.lanes;
        let at = by_axis!(AXIS => lanes.column_array(planes.right[AXIS]));
        let points = self.unboxed(points);
        // Points are planes within the box of points.
        let [valid_x, valid_y, valid_z] = by_axis!(AXIS => {
            let above_last = lanes.every(W::Coordinate::of(points.max[AXIS]));
            let above_first = lanes.every(W::Coordinate::of(points.min[AXIS] - 1));
            let right = planes.right[AXIS];
            lanes.but(lanes.is_above(right, above_first), lanes.is_above(right, above_last))
        });
        let valid_z = lanes.bits(valid_z);
        let valid = lanes.and(lanes.rows_of(valid_y), lanes.every_row(lanes.bits(valid_x)));
        let material = if V::STOCK {
            self.material(planes)
        } else {
            Material::nowhere(lanes)
        };

        let mut visitor = V::new(lanes);
        let mut lower = Layer::new(lanes, before, newly, 0, after);
        for z in 0..planes.cells - 1 {
            let upper = Layer::new(lanes, before, newly, z + 1, after);
            let near = lanes.or(newly[z], newly[z + 1]);
            if lanes.is_empty(near) || valid_z >> z & 1 == 0 {
                lower = upper;
                continue;
            }
            let vertices = Layer::vertices::<V, W>(lanes, &lower, &upper, &material, z);
            let vertices = lanes.and(vertices, lanes.and(dilated(lanes, near), valid));
            lower = upper;
            if lanes.is_empty(vertices) {
                continue;
            }
            let height = at[2][z].into();
            for (number, mut left) in lanes.rows_words(vertices).into_iter().enumerate() {
                while left != 0 {
                    let bit = left.trailing_zeros() as usize;
                    left &= left - 1;
                    let (x, y) = (bit % LANES, 4 * number + bit / LANES);
                    visitor.visit(
                        lanes,
                        [at[0][x].into(), at[1][y].into(), height],
                        octants(before, x, y, z),
                        octants(after, x, y, z),
                        if V::STOCK {
                            material.octants(x, y, z)
                        } else {
                            0
                        },
                    );
                }
            }
            visitor.end_plane(height, total);
        }
        visitor.end_leaf(lanes, total);
    }

    /// The cells of a box, by axis: a mask of lanes.
    #[inline(always)]
    fn cells_of(&self, boxed: Boxed<L, W>, planes: &Planes<L, W>) -> [Column<L, W>; 3] {
        let lanes = self.lanes;
        by_axis!(AXIS => {
            let below = lanes.is_above(lanes.spread::<AXIS>(boxed), planes.left[AXIS]);
            let inside = lanes.is_above(planes.minus[AXIS], lanes.spread::<{ 4 + AXIS }>(boxed));
            lanes.but(inside, below)
        })
    }

    #[inline(always)]
    fn material(&self, planes: &Planes<L, W>) -> Material<L> {
        let lanes = self.lanes;
        let [x, y, z] = self.cells_of(self.stock, planes);
        let cells = [lanes.bits(x), lanes.bits(y), lanes.bits(z)];
        let rows = lanes.rows_of(y);
        Material {
            cells,
            varies_x: lanes.every_row(cells[0] ^ cells[0] >> 1),
            varies_y: lanes.xor(rows, lanes.next_row(rows)),
            varies_z: cells[2] ^ cells[2] >> 1,
        }
    }
}

/// A layer of cells before and after: where the neighbour along an axis differs in one of the two.
struct Layer<L: Lanes> {
    before: L::Rows,
    after: L::Rows,
    varies_x: L::Rows,
    varies_y: L::Rows,
}

impl<L: Lanes> Layer<L> {
    /// The layer at `z`; what it is after is noted.
    #[inline(always)]
    fn new(
        lanes: L,
        before: &Layers,
        newly: &[L::Rows; LANES + 1],
        z: usize,
        noted: &mut Layers,
    ) -> Self {
        let before = lanes.rows(before[z]);
        let after = lanes.or(before, newly[z]);
        noted[z] = lanes.rows_array(after);
        let varies_x = lanes.or(
            lanes.xor(before, lanes.next_column(before)),
            lanes.xor(after, lanes.next_column(after)),
        );
        let varies_y = lanes.or(
            lanes.xor(before, lanes.next_row(before)),
            lanes.xor(after, lanes.next_row(after)),
        );
        Self {
            before,
            after,
            varies_x,
            varies_y,
        }
    }

    /// Points above plane `z` at which the octants may vary along all three axes, before or after.
    #[inline(always)]
    fn vertices<V: Visitor<L, W>, W: Width>(
        lanes: L,
        lower: &Self,
        upper: &Self,
        material: &Material<L>,
        z: usize,
    ) -> L::Rows {
        let varies_x = lanes.or(lower.varies_x, upper.varies_x);
        let varies_y = lanes.or(lower.varies_y, upper.varies_y);
        let varies_z = lanes.or(
            lanes.xor(lower.before, upper.before),
            lanes.xor(lower.after, upper.after),
        );
        let mut along_x = lanes.or(varies_x, lanes.next_row(varies_x));
        let mut along_y = lanes.or(varies_y, lanes.next_column(varies_y));
        let mut along_z = dilated(lanes, varies_z);
        if V::STOCK {
            along_x = lanes.or(along_x, material.varies_x);
            along_y = lanes.or(along_y, material.varies_y);
            if material.varies_z >> z & 1 == 1 {
                along_z = lanes.every_row(u16::MAX);
            }
        }
        lanes.and(lanes.and(along_x, along_y), along_z)
    }
}

/// Which cells hold material of the stock: by axis, a bit for each.
struct Material<L: Lanes> {
    cells: [u16; 3],
    varies_x: L::Rows,
    varies_y: L::Rows,
    /// By plane: all points or none.
    varies_z: u16,
}

impl<L: Lanes> Material<L> {
    /// There is no stock.
    #[inline(always)]
    fn nowhere(lanes: L) -> Self {
        Self {
            cells: [0; 3],
            varies_x: lanes.every_row(0),
            varies_y: lanes.every_row(0),
            varies_z: 0,
        }
    }

    #[inline(always)]
    fn octants(&self, x: usize, y: usize, z: usize) -> u8 {
        /// Octants by axis, for no cell at the point, the one below, the one above, and both.
        const SIDES: [[u8; 4]; 3] = [
            [0, 0x55, 0xaa, 0xff],
            [0, 0x33, 0xcc, 0xff],
            [0, 0x0f, 0xf0, 0xff],
        ];
        let [of_x, of_y, of_z] = SIDES;
        let at = |cells: u16, index: usize| usize::from(cells >> index & 0b11);
        of_x[at(self.cells[0], x)] & of_y[at(self.cells[1], y)] & of_z[at(self.cells[2], z)]
    }
}

/// Adds cells to a layer.
#[inline(always)]
fn fill<L: Lanes>(lanes: L, layer: &mut [u16; LANES], cells: L::Rows) {
    *layer = lanes.rows_array(lanes.or(lanes.rows(*layer), cells));
}

/// The octants at a point: see [`crate::geometry::OctantMask`].
#[inline(always)]
fn octants(layers: &Layers, x: usize, y: usize, z: usize) -> u8 {
    // Two bits of each row are brought together in the highest byte by one multiplication: no two products overlap.
    const TWO_OF_EACH: u64 = 0x0003_0003_0003_0003;
    const TO_HIGHEST: u64 = 1 << 14 | 1 << 28 | 1 << 42 | 1 << 56;
    let rows: &[u16; LANES * LAYERS] = layers.as_flattened().try_into().expect("it is as long");
    // A byte, as the compiler can see: then it checks no index.
    let first = (LANES * z + y) % 256;
    let pair = |first: usize| u32::from(rows[first]) | u32::from(rows[first + 1]) << 16;
    let word = u64::from(pair(first)) | u64::from(pair(first + LANES)) << 32;
    let [.., octants] = ((word >> x & TWO_OF_EACH).wrapping_mul(TO_HIGHEST)).to_le_bytes();
    octants
}

/// The point above each cell: set when any of the four cells around it is.
#[inline(always)]
fn dilated<L: Lanes>(lanes: L, rows: L::Rows) -> L::Rows {
    let both = lanes.or(rows, lanes.next_column(rows));
    lanes.or(both, lanes.next_row(both))
}

/// Sorts each lane of the first `count` corners by itself; those behind are not less than any of them.
/// # Source
/// The networks with the fewest comparators known (D. E. Knuth, TAOCP 3, 5.3.4; B. Dobbelaere's list for 13 inputs).
#[inline(always)]
fn sort<L: Columns<C>, C: Coordinate>(lanes: L, planes: &mut [L::Corner; LANES], count: usize) {
    macro_rules! network {
        ($(($low:literal, $high:literal))*) => {{
            $(
                let (low, high) = (planes[$low], planes[$high]);
                planes[$low] = lanes.lesser_corner(low, high);
                planes[$high] = lanes.greater_corner(low, high);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::lanes::{OnLanes, avx2, run_on};

    /// A network that sorts all inputs of zeros and ones sorts everything (Knuth's zero-one principle).
    #[test]
    fn networks_sort() {
        for lanes in [None, avx2()] {
            for count in 0..=PLANES {
                for input in 0..1_u32 << count {
                    let sorted = run_on(lanes, Sorted { count, input });
                    let ones = count - input.count_ones() as usize;
                    let expected: Vec<i16> = (0..PLANES).map(|at| i16::from(at >= ones)).collect();
                    assert_eq!(sorted, expected, "{count} inputs: {input:b}");
                }
            }
        }
    }

    /// The bits of an input behind which all are ones.
    struct Sorted {
        count: usize,
        input: u32,
    }

    impl OnLanes for Sorted {
        type Output = Vec<i16>;

        #[inline(always)]
        fn run_on<L: Columns<i16> + Columns<i32>>(self, lanes: L) -> Vec<i16> {
            let bit = |index: usize| index >= self.count || self.input >> index & 1 == 1;
            let mut corners: [<L as Columns<i16>>::Corner; LANES] =
                std::array::from_fn(|index| lanes.every_corner(i16::from(bit(index))));
            sort::<L, i16>(lanes, &mut corners, self.count);
            let [_, y, _] = Columns::<i16>::columns(lanes, &corners);
            Columns::<i16>::column_array(lanes, y)[..PLANES].to_vec()
        }
    }
}
