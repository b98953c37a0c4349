//! Division: the points of a cube are taken apart until so few cubes are near that a leaf can look at what is left.
//!
//! ```text
//!   divide(points, cubes):   take the cube K with the most points in its core; the core changes nothing
//!        +--------------+    and the rest is at most three slabs, because cubes of one size overlap
//!        |  K   :       |    in a corner, an edge or a face; keep the cubes that reach each slab,
//!        |......: slab  |    stop where one of them covers it, go on.
//!        |  slab        |
//!        +--------------+
//!   where no cube has much of a core, the points are thin: drop the cubes within others, then use the planes as they are if they
//!   are few, else halve the points at the median plane.
//! ```

use super::leaf::{Leaf, LeafOf, Visitor};
use super::plan::{Column, List, Plan};
use super::span::Span;
use super::width::Width;
use crate::engine::lanes::{Columns, Coordinate, LANES, Lanes, Task};
use crate::engine::neighbours::Neighbours;

/// What of a cube is weighed: the points in its core, or the cells in its clip.
const CORE: usize = 0;
const CLIP: usize = 1;
/// Thin points: at most so many of the largest clips are compared with all others, to drop those within them.
const DROPS_MAX: usize = 8;
/// Registers of a list that are weighed: their number fits a lane of any width.
const WEIGHED_MAX: usize = i16::MAX as usize;

/// Looks at all points of a cube; false, and nothing seen, when a neighbour is at the very same place.
pub(super) struct Start<'a, L: Columns<W::Coordinate>, W: Width, V: Visitor<L, W>> {
    pub(super) plan: &'a mut Plan<L, W>,
    pub(super) neighbours: &'a Neighbours,
    pub(super) total: &'a mut V::Total,
}

impl<L: Columns<W::Coordinate>, W: Width, V: Visitor<L, W>> Task for Start<'_, L, W, V> {
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        let Self {
            plan,
            neighbours,
            total,
        } = self;
        let Some(list) = plan.list(neighbours) else {
            return false;
        };
        let (lanes, points) = (plan.lanes, Span::cube([0; 3], plan.edge));
        lanes.run(Divide(Region::<L, W, V> {
            plan,
            list,
            points,
            total: &mut *total,
        }));
        V::end(total);
        true
    }
}

/// A box of the points, and the cubes that are to be looked at for it.
struct Region<'a, L: Columns<W::Coordinate>, W: Width, V: Visitor<L, W>> {
    plan: &'a mut Plan<L, W>,
    list: List,
    points: Span,
    total: &'a mut V::Total,
}

/// Looks at a region all of whose cubes reach a cell next to its points.
struct Divide<'a, L: Columns<W::Coordinate>, W: Width, V: Visitor<L, W>>(Region<'a, L, W, V>);

/// Looks at a region within another, given all cubes of the other.
struct Descend<'a, L: Columns<W::Coordinate>, W: Width, V: Visitor<L, W>>(Region<'a, L, W, V>);

/// Looks at a region where no cube has much of a core.
struct Thin<'a, L: Columns<W::Coordinate>, W: Width, V: Visitor<L, W>>(Region<'a, L, W, V>);

impl<L: Columns<W::Coordinate>, W: Width, V: Visitor<L, W>> Task for Divide<'_, L, W, V> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.0.divide();
    }
}

impl<L: Columns<W::Coordinate>, W: Width, V: Visitor<L, W>> Task for Descend<'_, L, W, V> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        let region = &mut self.0;
        // Where one of the cubes covers all of this one nothing changes.
        if let Some(reaching) = region.plan.reaching(region.list, &region.points) {
            region.list = reaching;
            region.plan.lanes.run(Divide(self.0));
        }
    }
}

impl<L: Columns<W::Coordinate>, W: Width, V: Visitor<L, W>> Task for Thin<'_, L, W, V> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.0.divide_thin();
    }
}

impl<L: Columns<W::Coordinate>, W: Width, V: Visitor<L, W>> Region<'_, L, W, V> {
    #[inline(always)]
    fn divide(mut self) {
        let lanes = self.plan.lanes;
        if self.list.len <= const { leaf_clips::<L, W, V>() } {
            return self.leaf();
        }
        let Some(core) = self.plan.largest_core(self.list, &self.points) else {
            return lanes.run(Thin(self));
        };
        let mut rest = self.points;
        for axis in 0..3 {
            if rest.min[axis] < core.min[axis] {
                let mut slab = rest;
                slab.max[axis] = core.min[axis] - 1;
                self.descend(slab);
                rest.min[axis] = core.min[axis];
            }
            if core.max[axis] < rest.max[axis] {
                let mut slab = rest;
                slab.min[axis] = core.max[axis] + 1;
                self.descend(slab);
                rest.max[axis] = core.max[axis];
            }
        }
    }

    #[inline(always)]
    fn descend(&mut self, points: Span) {
        let Self {
            plan, list, total, ..
        } = self;
        let (lanes, list) = (plan.lanes, *list);
        lanes.run(Descend(Region::<L, W, V> {
            plan,
            list,
            points,
            total,
        }));
    }

    #[inline(always)]
    fn leaf(self) {
        let Self {
            plan,
            list,
            points,
            total,
        } = self;
        plan.lanes.run(Leaf::<L, W, V> {
            plan,
            list,
            points,
            total,
        });
    }

    /// Drops clips within others, then uses the planes as they are, or halves the points at the median plane.
    #[inline(always)]
    fn divide_thin(mut self) {
        let few = const { leaf_clips::<L, W, V>() };
        let Self {
            plan, list, points, ..
        } = &mut self;
        let lanes = plan.lanes;
        *list = plan.drop_covered(*list, points, few);
        plan.clip(*list, points);
        *list = plan.drop_dominated(*list);
        if list.len <= few {
            return self.leaf();
        }
        let boxed = plan.boxed(points);
        let bound = plan.unboxed(lanes.common_box(plan.own, plan.grown(boxed)));
        let mut planes = [const { Vec::new() }; 3];
        for &clip in &plan.clips {
            let clip = plan.unboxed(clip);
            for (axis, planes) in planes.iter_mut().enumerate() {
                let inner = bound.min[axis] + 1..bound.max[axis];
                let ends = [clip.min[axis], clip.max[axis]];
                planes.extend(ends.into_iter().filter(|plane| inner.contains(plane)));
            }
        }
        for planes in &mut planes {
            planes.sort_unstable();
            planes.dedup();
        }
        let most = (0..3)
            .max_by_key(|&axis| planes[axis].len())
            .expect("there are three axes");
        let count = planes[most].len();
        if count <= few {
            let mut corners = [lanes.every_corner(W::Coordinate::ZERO); LANES];
            for (index, corner) in corners.iter_mut().enumerate() {
                let mut coordinates = [W::Coordinate::ZERO; 8];
                for axis in 0..3 {
                    let plane = planes[axis].get(index).copied();
                    coordinates[axis] = W::Coordinate::of(plane.unwrap_or(bound.max[axis]));
                }
                [*corner, _] = lanes.halves(lanes.boxed(&coordinates));
            }
            let planes = plan.planes_from::<V>(corners, count, boxed);
            return lanes.run(LeafOf::<L, W, V> {
                plan: self.plan,
                points: boxed,
                planes: &planes,
                total: self.total,
            });
        }
        let median = planes[most][count / 2];
        let (mut below, mut above) = (self.points, self.points);
        below.max[most] = median - 1;
        above.min[most] = median;
        self.descend(below);
        self.descend(above);
    }
}

/// Few enough clips for a leaf; the stock may add two planes.
const fn leaf_clips<L: Lanes, W: Width, V: Visitor<L, W>>() -> usize {
    if V::STOCK {
        W::LEAF_CLIPS - 2
    } else {
        W::LEAF_CLIPS
    }
}

impl<L: Columns<W::Coordinate>, W: Width> Plan<L, W> {
    /// A new list of the cubes that reach a part of the points; none when one of them covers all of the cube that is there.
    #[inline(always)]
    fn reaching(&mut self, list: List, points: &Span) -> Option<List> {
        let lanes = self.lanes;
        let first = list.padded_end();
        self.make_room(first + list.len + 2 * LANES);
        let own = Span::cube([0; 3], self.edge).clamped(&points.grown());
        // A cube reaches the points when its offset is above the first bound and not above the second; likewise, it covers.
        let mut reach = [[lanes.every(W::Coordinate::ZERO); 3]; 2];
        let mut cover = reach;
        for axis in 0..3 {
            let beyond = self.edge + 1;
            reach[0][axis] = self.every(points.min[axis] - beyond);
            reach[1][axis] = self.every(points.max[axis]);
            cover[0][axis] = self.every(own.max[axis] - beyond);
            cover[1][axis] = self.every(own.min[axis]);
        }
        let [x, y, z] = &mut self.offsets;
        let ((x, to_x), (y, to_y), (z, to_z)) = (
            x.split_at_mut(first),
            y.split_at_mut(first),
            z.split_at_mut(first),
        );
        let (x, y, z) = (list.of(x), list.of(y), list.of(z));
        let mut len = 0;
        for index in 0..x.len() {
            let offsets = [
                lanes.column(&x[index]),
                lanes.column(&y[index]),
                lanes.column(&z[index]),
            ];
            if lanes.is_any(between::<L, W>(lanes, &offsets, &cover)) {
                return None;
            }
            let kept = lanes.bits(between::<L, W>(lanes, &offsets, &reach));
            let [x, y, z] = offsets;
            lanes.compress(&mut to_x[len..], x, kept);
            lanes.compress(&mut to_y[len..], y, kept);
            len += lanes.compress(&mut to_z[len..], z, kept);
        }
        let kept = List { first, len };
        self.pad(kept);
        Some(kept)
    }

    /// The points around which a cube already fills all of this one, for the cube that has most of them, or nearly so.
    /// None when all have few.
    #[inline(always)]
    fn largest_core(&self, list: List, points: &Span) -> Option<Span> {
        let index = self.largest::<CORE>(list, points)?;
        let mut core = *points;
        for (axis, column) in self.offsets.iter().enumerate() {
            // Inside a cube's ends, or on this cube's own face where the other ends there or beyond.
            let offset: i32 = column[index].into();
            let low = if offset > 0 { offset + 1 } else { 0 };
            let high = self.edge + if offset < 0 { offset - 1 } else { 0 };
            core.min[axis] = core.min[axis].max(low);
            core.max[axis] = core.max[axis].min(high);
        }
        Some(core)
    }

    /// The cube of a list that has most of a box, or nearly so: of points in its core; or of cells in its clip, where the sum of the
    /// shares along the axes counts. None when all have hardly any.
    #[inline(always)]
    fn largest<const WHAT: usize>(&self, list: List, of: &Span) -> Option<usize> {
        let lanes = self.lanes;
        let zero = lanes.every(W::Coordinate::ZERO);
        let one = self.every(1);
        let edge = self.every(self.edge);
        let mut low = [zero; 3];
        let mut high = [zero; 3];
        // As many as there are along an axis.
        let mut whole = [0; 3];
        for axis in 0..3 {
            low[axis] = self.every(of.min[axis]);
            high[axis] = self.every(of.max[axis]);
            let count = of.max[axis] - of.min[axis] + i32::from(WHAT == CORE);
            whole[axis] = count.cast_unsigned();
        }
        let mut best = zero;
        let mut best_register = zero;
        let mut number = zero;
        let [x, y, z] = &self.offsets;
        let (x, y, z) = (list.of(x), list.of(y), list.of(z));
        for index in 0..x.len().min(WEIGHED_MAX) {
            let offsets = [
                lanes.column(&x[index]),
                lanes.column(&y[index]),
                lanes.column(&z[index]),
            ];
            let mut shares = [zero; 3];
            for axis in 0..3 {
                let offset = offsets[axis];
                // A mask is one less than nothing.
                let count = if WHAT == CORE {
                    let from = lanes.minus(offset, lanes.is_above(offset, zero));
                    let from = lanes.greater(lanes.greater(from, zero), low[axis]);
                    let up_to = lanes.plus(offset, lanes.is_above(zero, offset));
                    let up_to = lanes.plus(lanes.lesser(up_to, zero), edge);
                    let up_to = lanes.lesser(up_to, high[axis]);
                    lanes.plus(lanes.minus(up_to, from), one)
                } else {
                    let up_to =
                        lanes.plus(lanes.lesser(offset, lanes.minus(high[axis], edge)), edge);
                    lanes.minus(up_to, lanes.greater(offset, low[axis]))
                };
                shares[axis] = lanes.fractions(lanes.greater(count, zero), whole[axis]);
            }
            let [x, y, z] = shares;
            let share = if WHAT == CORE {
                let share = lanes.times_fractions(lanes.times_fractions(x, y), z);
                lanes.shift_fractions::<1>(share)
            } else {
                // A product would be lost in rounding for what is thin along two axes; and what contains a clip has a greater
                // sum, too.
                let x = lanes.shift_fractions::<3>(x);
                let y = lanes.shift_fractions::<3>(y);
                lanes.plus(lanes.plus(x, y), lanes.shift_fractions::<3>(z))
            };
            let better = lanes.is_above(share, best);
            best = lanes.greater(best, share);
            best_register = lanes.select(better, number, best_register);
            number = lanes.plus(number, one);
        }
        let (shares, registers) = (lanes.column_array(best), lanes.column_array(best_register));
        let mut lane = 0;
        for other in 1..LANES {
            if shares[other] > shares[lane] {
                lane = other;
            }
        }
        let register: i32 = registers[lane].into();
        let index = list.first + LANES * usize::try_from(register).expect("it is a count") + lane;
        (shares[lane] > W::Coordinate::ZERO).then_some(index)
    }

    /// Drops cubes whose clips are within that of another, the largest first, until few are left or it does not pay.
    #[inline(always)]
    fn drop_covered(&mut self, mut list: List, points: &Span, few: usize) -> List {
        let lanes = self.lanes;
        let cells = points.grown();
        let far = lanes.every(W::Coordinate::FAR);
        let mut largest = Vec::new();
        while list.len + largest.len() > few && largest.len() < DROPS_MAX {
            let Some(index) = self.largest::<CLIP>(list, &cells) else {
                break;
            };
            let mut offset = [W::Coordinate::ZERO; 3];
            let mut bounds = [[far; 3]; 2];
            for axis in 0..3 {
                offset[axis] = self.offsets[axis][index];
                // Beyond the cells it does not matter how far a cube goes.
                let min: i32 = offset[axis].into();
                let max = min + self.edge;
                if min > cells.min[axis] {
                    bounds[0][axis] = self.every(min - 1);
                }
                bounds[1][axis] = if max >= cells.max[axis] {
                    lanes.every(W::Coordinate::MAX)
                } else {
                    self.every(max - self.edge)
                };
            }
            let before = list.len;
            let registers = list.len.div_ceil(LANES);
            list.len = 0;
            for number in 0..registers {
                let first = list.first + LANES * number;
                let mut offsets = [far; 3];
                for (offsets, column) in offsets.iter_mut().zip(&self.offsets) {
                    let register = column[first..].first_chunk();
                    *offsets = lanes.column(register.expect("a list is padded"));
                }
                let there = lanes.is_above(offsets[0], far);
                let kept = lanes.but(there, between::<L, W>(lanes, &offsets, &bounds));
                let kept = lanes.bits(kept);
                // What is written here has been read: it is never more than that.
                for (column, offsets) in self.offsets.iter_mut().zip(offsets) {
                    let to = &mut column[list.first + list.len..];
                    lanes.compress(to, offsets, kept);
                }
                list.len += kept.count_ones() as usize;
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

    /// Drops clips within others, and their cubes from the list.
    #[inline(always)]
    fn drop_dominated(&mut self, list: List) -> List {
        // What is kept is never within another, so there are few to compare with.
        let lanes = self.lanes;
        let mut kept = 0;
        for index in 0..list.len {
            let clip = self.clips[index];
            let mut is_within = false;
            for &other in &self.clips[..kept] {
                if lanes.contains(other, clip) {
                    is_within = true;
                    break;
                }
            }
            if is_within {
                continue;
            }
            let mut stays = 0;
            for earlier in 0..kept {
                if !lanes.contains(clip, self.clips[earlier]) {
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

    #[inline(always)]
    fn keep(&mut self, list: List, index: usize, to: usize) {
        self.clips[to] = self.clips[index];
        for column in &mut self.offsets {
            column[list.first + to] = column[list.first + index];
        }
    }
}

/// Lanes above the first bound and not above the second, on all axes: a mask.
#[inline(always)]
fn between<L: Columns<W::Coordinate>, W: Width>(
    lanes: L,
    offsets: &[Column<L, W>; 3],
    bounds: &[[Column<L, W>; 3]; 2],
) -> Column<L, W> {
    let mut inside = lanes.but(
        lanes.is_above(offsets[0], bounds[0][0]),
        lanes.is_above(offsets[0], bounds[1][0]),
    );
    for axis in 1..3 {
        inside = lanes.both(inside, lanes.is_above(offsets[axis], bounds[0][axis]));
        inside = lanes.but(inside, lanes.is_above(offsets[axis], bounds[1][axis]));
    }
    inside
}
