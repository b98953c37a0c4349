//! Summing what the points of a leaf weigh: the measures of a difference, first in coordinates local to the cube, then in the
//! scene's.
//!
//! What is exact: everything. Sums may wrap on the way, modulo two to their width; the true results fit, by these bounds, where L is
//! the edge and a difference lies inside the cube:
//!
//! ```text
//!   second moments, in the forms kept      L^5            Width::Sum        asserted for each width in `width`
//!   the same over one plane across z       2 L^4          Width::Plane
//!   areas of a leaf, lengths of a leaf     15^2 L^2, ..   64 and 32 bits
//!   second moments in the scene            2^157          Width::Moved      or less where L is small
//! ```

use ethnum::I256;

use super::leaf::Visitor;
use super::width::{Ring, Width};
use crate::engine::lanes::Lanes;
use crate::geometry::{EdgeKind, Measures, WEIGHTS};

/// The sums of the union and of two parts of the stock: what is removed from it, and what remains.
pub(super) type Total<W> = [Sums<W>; 3];

/// Sums up the union alone.
pub(super) struct OfUnion<L: Lanes, W: Width>(LeafSums<L, W>);

impl<L: Lanes, W: Width> Visitor<L, W> for OfUnion<L, W> {
    const STOCK: bool = false;
    type Total = Total<W>;

    #[inline(always)]
    fn new(lanes: L) -> Self {
        Self(LeafSums::new(lanes))
    }

    #[inline(always)]
    fn visit(&mut self, lanes: L, at: [i32; 3], before: u8, after: u8, _: u8) {
        self.0.add(lanes, &Point::new(lanes, at), before, after);
    }

    #[inline(always)]
    fn end_plane(&mut self, z: i32, [union, ..]: &mut Total<W>) {
        self.0.end_plane(z, union);
    }

    #[inline(always)]
    fn end_leaf(self, lanes: L, [union, ..]: &mut Total<W>) {
        self.0.end_leaf(lanes, union);
    }

    #[inline(always)]
    fn end(_: &mut Total<W>) {}
}

/// Sums up the union where the stock lies all around the cube: what comes to the union is removed from the stock, and what
/// remains loses as much; only its Euler characteristic and vertices need a look at the points.
pub(super) struct InsideStock<L: Lanes, W: Width> {
    union: LeafSums<L, W>,
    /// As [`Row::counts`].
    remaining_counts: L::Eight,
}

impl<L: Lanes, W: Width> Visitor<L, W> for InsideStock<L, W> {
    const STOCK: bool = false;
    type Total = Total<W>;

    #[inline(always)]
    fn new(lanes: L) -> Self {
        Self {
            union: LeafSums::new(lanes),
            remaining_counts: lanes.every_eight(0),
        }
    }

    #[inline(always)]
    fn visit(&mut self, lanes: L, at: [i32; 3], before: u8, after: u8, _: u8) {
        self.union.add(lanes, &Point::new(lanes, at), before, after);
        let [before, after] = [!before, !after].map(|mask| &ROWS[usize::from(mask)]);
        let counts = lanes.minus_eight(lanes.eight(&after.counts), lanes.eight(&before.counts));
        self.remaining_counts = lanes.plus_eight(self.remaining_counts, counts);
    }

    #[inline(always)]
    fn end_plane(&mut self, z: i32, [union, ..]: &mut Total<W>) {
        self.union.end_plane(z, union);
    }

    #[inline(always)]
    fn end_leaf(self, lanes: L, [union, _, remaining]: &mut Total<W>) {
        self.union.end_leaf(lanes, union);
        remaining.add_counts(&lanes.eight_array(self.remaining_counts));
    }

    #[inline(always)]
    fn end([union, _, remaining]: &mut Total<W>) {
        let negated = |sum| W::Sum::default().minus(sum);
        [remaining.volume] = [union.volume].map(negated);
        remaining.first2 = union.first2.map(negated);
        remaining.second3 = union.second3.map(negated);
        remaining.product4 = union.product4.map(negated);
        remaining.area = union.area;
        remaining.edge = union.edge;
        let (convex, concave) = (EdgeKind::Convex as usize, EdgeKind::Concave as usize);
        for along in &mut remaining.edge {
            along.swap(convex, concave);
        }
    }
}

/// Sums up the union and both parts of the stock where a face of the stock is near.
pub(super) struct AcrossStock<L: Lanes, W: Width>([LeafSums<L, W>; 3]);

impl<L: Lanes, W: Width> Visitor<L, W> for AcrossStock<L, W> {
    const STOCK: bool = true;
    type Total = Total<W>;

    #[inline(always)]
    fn new(lanes: L) -> Self {
        Self([
            LeafSums::new(lanes),
            LeafSums::new(lanes),
            LeafSums::new(lanes),
        ])
    }

    #[inline(always)]
    fn visit(&mut self, lanes: L, at: [i32; 3], before: u8, after: u8, material: u8) {
        let Self([union, removed, remaining]) = self;
        let point = Point::new(lanes, at);
        union.add(lanes, &point, before, after);
        removed.add(lanes, &point, before & material, after & material);
        remaining.add(lanes, &point, !before & material, !after & material);
    }

    #[inline(always)]
    fn end_plane(&mut self, z: i32, total: &mut Total<W>) {
        for (part, sums) in self.0.iter_mut().zip(total) {
            part.end_plane(z, sums);
        }
    }

    #[inline(always)]
    fn end_leaf(self, lanes: L, total: &mut Total<W>) {
        for (part, sums) in self.0.into_iter().zip(total) {
            part.end_leaf(lanes, sums);
        }
    }

    #[inline(always)]
    fn end(_: &mut Total<W>) {}
}

/// What the weights of an octant mask multiply, in the order of their lanes.
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

/// Where a point lies: the monomials that its weights are multiplied with.
struct Point<L: Lanes> {
    x: i64,
    y: i64,
    /// As [`Row::edges`].
    edges: L::Eight,
    /// As [`Row::counts`].
    counts: L::Eight,
    /// As [`Row::areas`], in two factors: yz, xz, xy, xy.
    areas: [L::Four; 2],
}

impl<L: Lanes> Point<L> {
    #[inline(always)]
    fn new(lanes: L, [x, y, z]: [i32; 3]) -> Self {
        let (xs, ys, zs) = (
            lanes.every_eight(x),
            lanes.every_eight(y),
            lanes.every_eight(z),
        );
        let (four_x, four_y, four_z) = (
            lanes.every_four(x),
            lanes.every_four(y),
            lanes.every_four(z),
        );
        Self {
            x: x.into(),
            y: y.into(),
            edges: lanes.mix_eight::<0b1100_0000>(lanes.mix_eight::<0b0011_1000>(xs, ys), zs),
            counts: lanes.mix_eight::<0b0000_0001>(lanes.every_eight(1), zs),
            areas: [
                lanes.mix_four::<0b0001>(four_x, four_y),
                lanes.mix_four::<0b1100>(four_z, four_y),
            ],
        }
    }
}

/// Sums over the points of a leaf, for the union or for a part of the stock.
struct LeafSums<L: Lanes, W: Width> {
    /// As [`Row::edges`] and [`Row::counts`], times the coordinate along the edge.
    edges: L::Eight,
    counts: L::Eight,
    /// As [`Row::areas`], times two coordinates.
    areas: L::Long,
    plane: PlaneSums<W::Plane>,
}

/// Sums of volume weights over the points of one plane across z: times xy, x^2 y, x y^2, x^3 y, x y^3, x^2 y^2.
#[derive(Clone, Copy, Default)]
struct PlaneSums<T> {
    xy: T,
    xxy: T,
    xyy: T,
    xxxy: T,
    xyyy: T,
    xxyy: T,
}

impl<L: Lanes, W: Width> LeafSums<L, W> {
    #[inline(always)]
    fn new(lanes: L) -> Self {
        Self {
            edges: lanes.every_eight(0),
            counts: lanes.every_eight(0),
            areas: lanes.no_long(),
            plane: PlaneSums::default(),
        }
    }

    /// Adds the difference of the weights at a point.
    #[inline(always)]
    fn add(&mut self, lanes: L, point: &Point<L>, before: u8, after: u8) {
        let (before, after) = (&ROWS[usize::from(before)], &ROWS[usize::from(after)]);
        let edges = lanes.minus_eight(lanes.eight(&after.edges), lanes.eight(&before.edges));
        let counts = lanes.minus_eight(lanes.eight(&after.counts), lanes.eight(&before.counts));
        let areas = lanes.minus_four(lanes.four(&after.areas), lanes.four(&before.areas));
        let [one, other] = point.areas;
        let areas = lanes.times_long(lanes.times_four(areas, one), other);
        self.edges = lanes.plus_eight(self.edges, lanes.times_eight(edges, point.edges));
        self.counts = lanes.plus_eight(self.counts, lanes.times_eight(counts, point.counts));
        self.areas = lanes.plus_long(self.areas, areas);
        let [.., xy] = lanes.long_array(areas);
        self.plane.add(xy.into(), point.x.into(), point.y.into());
    }

    #[inline(always)]
    fn end_plane(&mut self, z: i32, sums: &mut Sums<W>) {
        let z = i64::from(z);
        let PlaneSums {
            xy,
            xxy,
            xyy,
            xxxy,
            xyyy,
            xxyy,
        } = std::mem::take(&mut self.plane);
        let (z1, z2) = (W::Sum::from(z), W::Sum::from(z * z));
        let add = |sum: &mut W::Sum, of_plane: W::Plane, monomial: W::Sum| {
            *sum = sum.plus(W::Sum::from(of_plane).times(monomial));
        };
        add(&mut sums.volume, xy, z1);
        add(&mut sums.first2[0], xxy, z1);
        add(&mut sums.first2[1], xyy, z1);
        add(&mut sums.first2[2], xy, z2);
        add(&mut sums.second3[0], xxxy, z1);
        add(&mut sums.second3[1], xyyy, z1);
        add(&mut sums.second3[2], xy, z2.times(z1));
        add(&mut sums.product4[0], xxyy, z1);
        add(&mut sums.product4[1], xyy, z2);
        add(&mut sums.product4[2], xxy, z2);
    }

    #[inline(always)]
    fn end_leaf(self, lanes: L, sums: &mut Sums<W>) {
        let (edges, counts) = (
            lanes.eight_array(self.edges),
            lanes.eight_array(self.counts),
        );
        let lengths = sums.edge.as_flattened_mut();
        for (lane, sum) in lengths.iter_mut().enumerate() {
            let length = if lane < 8 { edges[lane] } else { counts[0] };
            *sum = sum.plus(i64::from(length).into());
        }
        let areas = lanes.long_array(self.areas);
        for (axis, sum) in sums.area.iter_mut().enumerate() {
            *sum = sum.plus(areas[axis].into());
        }
        sums.add_counts(&counts);
    }
}

impl<T: Ring> PlaneSums<T> {
    #[inline(always)]
    fn add(&mut self, xy: T, x: T, y: T) {
        let (xxy, xyy) = (xy.times(x), xy.times(y));
        self.xy = self.xy.plus(xy);
        self.xxy = self.xxy.plus(xxy);
        self.xyy = self.xyy.plus(xyy);
        self.xxxy = self.xxxy.plus(xxy.times(x));
        self.xyyy = self.xyyy.plus(xyy.times(y));
        self.xxyy = self.xxyy.plus(xxy.times(y));
    }
}

/// The difference of the measures in coordinates local to the cube: see [`Measures`].
#[derive(Clone, Debug, Default)]
pub(super) struct Sums<W: Width> {
    volume: W::Sum,
    first2: [W::Sum; 3],
    second3: [W::Sum; 3],
    product4: [W::Sum; 3],
    area: [W::Sum; 3],
    edge: [[W::Sum; 3]; 3],
    /// Euler times eight and vertices by kind.
    counts: [i64; 5],
}

impl<W: Width> Sums<W> {
    /// Whether there is anything: every difference that is not empty has a volume.
    pub(super) fn is_nothing(&self) -> bool {
        self.volume == W::Sum::default()
    }

    pub(super) fn volume(&self) -> i128 {
        self.volume.into()
    }

    /// Adds what of [`Row::counts`] are counts.
    #[inline(always)]
    fn add_counts(&mut self, counts: &[i32; 8]) {
        for (index, sum) in self.counts.iter_mut().enumerate() {
            *sum += i64::from(counts[1 + index]);
        }
    }

    /// Adds them to measures in scene coordinates, where the origin of the local ones is `corner`, or retracts them. Lengths, areas
    /// and counts are those of a difference, so they do not change with the origin; moments do.
    #[inline]
    pub(super) fn combine<const RETRACT: bool>(&self, corner: [i32; 3], to: &mut Measures) {
        fn combined<const RETRACT: bool, T: Ring>(to: T, with: T) -> T {
            if RETRACT {
                to.minus(with)
            } else {
                to.plus(with)
            }
        }
        let moved = |sum: W::Sum| W::Moved::from(sum);
        let times = |sum: W::Sum, factor: i64| moved(sum).times(factor.into());
        let by = corner.map(i64::from);
        let volume = self.volume;
        to.volume = combined::<RETRACT, _>(to.volume, volume.into());
        for axis in 0..3 {
            let other = (axis + 1) % 3;
            let (a, b) = (by[axis], by[other]);
            let (first, first_other) = (self.first2[axis], self.first2[other]);
            // Twice the integral of x + a.
            let first2: W::Moved = moved(first).plus(times(volume, 2 * a));
            // Three times that of (x + a)^2.
            let second3 = moved(self.second3[axis])
                .plus(times(first, 3 * a))
                .plus(times(volume, 3 * a * a));
            // Four times that of (x + a)(y + b).
            let product4 = moved(self.product4[axis])
                .plus(times(first, 2 * b))
                .plus(times(first_other, 2 * a))
                .plus(times(volume, 4 * a * b));
            let first2: I256 = first2.into();
            let to_first2 = &mut to.first_moments2[axis];
            *to_first2 = combined::<RETRACT, _>(*to_first2, first2.as_i128());
            let to_second3 = &mut to.second_moments3[axis];
            *to_second3 = combined::<RETRACT, _>(*to_second3, second3.into());
            let to_product4 = &mut to.product_moments4[axis];
            *to_product4 = combined::<RETRACT, _>(*to_product4, product4.into());
            let to_area = &mut to.area_by_axis[axis];
            *to_area = combined::<RETRACT, _>(*to_area, self.area[axis].into());
            for kind in 0..3 {
                let to_length = &mut to.edge_length[axis][kind];
                *to_length = combined::<RETRACT, _>(*to_length, self.edge[axis][kind].into());
            }
        }
        let [euler8, vertices @ ..] = self.counts;
        to.euler8 = combined::<RETRACT, _>(to.euler8, euler8);
        for (to, count) in to.vertices.iter_mut().zip(vertices) {
            *to = combined::<RETRACT, _>(*to, count);
        }
    }
}
