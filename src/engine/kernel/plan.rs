//! The plan: the working memory of the kernel and its registers, from the cubes around one cube to the points that count.

use super::span::Span;
use super::width::Width;
use crate::engine::lanes::{Columns, Coordinate, LANES, WORDS};
use crate::engine::neighbours::Neighbours;

pub(super) type Column<L, W> = <L as Columns<<W as Width>::Coordinate>>::Column;
pub(super) type Boxed<L, W> = <L as Columns<<W as Width>::Coordinate>>::Boxed;
pub(super) type Corner<L, W> = <L as Columns<<W as Width>::Coordinate>>::Corner;

/// A list of offsets in the stack. Behind it there is room for a register of [`Coordinate::FAR`].
#[derive(Clone, Copy)]
pub(super) struct List {
    pub(super) first: usize,
    pub(super) len: usize,
}

impl List {
    /// Its part of a column, in whole registers.
    #[inline(always)]
    pub(super) fn of<C>(self, column: &[C]) -> &[[C; LANES]] {
        let end = self.first + self.len.next_multiple_of(LANES);
        column[self.first..end].as_chunks().0
    }

    /// Where the next list can begin.
    #[inline(always)]
    pub(super) fn padded_end(self) -> usize {
        self.first + self.len + LANES
    }
}

/// The plan with its working memory: from the cubes around one cube to the points that count.
#[derive(Clone, Debug)]
pub(super) struct Plan<L: Columns<W::Coordinate>, W: Width> {
    pub(super) lanes: L,
    pub(super) edge: i32,
    /// The cube in its own coordinates.
    pub(super) own: Boxed<L, W>,
    /// The stock in the cube's coordinates, drawn in to the frame.
    pub(super) stock: Boxed<L, W>,
    /// A stack of lists of offsets, a column for each axis: each level of the division adds one.
    pub(super) offsets: [Vec<W::Coordinate>; 3],
    /// The clips of a leaf.
    pub(super) clips: Vec<Boxed<L, W>>,
    /// Boxes that contain everything newly covered; kept only when `collect` says so.
    pub(super) uncovered: Vec<Span>,
    pub(super) collect: bool,
}

impl<L: Columns<W::Coordinate>, W: Width> Plan<L, W> {
    pub(super) fn new(lanes: L, edge: i32) -> Self {
        assert!(edge <= W::STEPS_MAX, "the width suits the edge");
        let nowhere = lanes.boxed(&[W::Coordinate::ZERO; 8]);
        let mut plan = Self {
            lanes,
            edge,
            own: nowhere,
            stock: nowhere,
            offsets: Default::default(),
            clips: Vec::new(),
            uncovered: Vec::new(),
            collect: false,
        };
        plan.own = plan.boxed(&Span::cube([0; 3], edge));
        plan
    }

    /// The first list of the stack; none when a neighbour is at the very same place.
    #[inline(always)]
    pub(super) fn list(&mut self, neighbours: &Neighbours) -> Option<List> {
        let list = List {
            first: 0,
            len: neighbours.len,
        };
        self.make_room(list.padded_end());
        let columns = [&neighbours.x, &neighbours.y, &neighbours.z];
        for (column, to) in columns.into_iter().zip(&mut self.offsets) {
            let (from, _) = column[..list.len.next_multiple_of(WORDS)].as_chunks::<WORDS>();
            let (to_whole, _) = to.as_chunks_mut::<WORDS>();
            for (from, to) in from.iter().zip(to_whole) {
                for lane in 0..WORDS {
                    to[lane] = W::Coordinate::of_low_bits(from[lane]);
                }
            }
            to[list.len..list.len + LANES].fill(W::Coordinate::FAR);
        }
        let lanes = self.lanes;
        let zero = lanes.every(W::Coordinate::ZERO);
        let ones = lanes.every(W::Coordinate::ONES);
        let mut same = zero;
        let [x, y, z] = &self.offsets;
        let (x, y, z) = (list.of(x), list.of(y), list.of(z));
        for index in 0..x.len() {
            let mut here = ones;
            for column in [&x[index], &y[index], &z[index]] {
                let offset = lanes.column(column);
                let apart = lanes.select(
                    lanes.is_above(offset, zero),
                    ones,
                    lanes.is_above(zero, offset),
                );
                here = lanes.but(here, apart);
            }
            same = lanes.select(here, ones, same);
        }
        (!lanes.is_any(same)).then_some(list)
    }

    #[inline(always)]
    pub(super) fn make_room(&mut self, end: usize) {
        if self.offsets[0].len() < end {
            self.grow(end);
        }
    }

    #[cold]
    fn grow(&mut self, end: usize) {
        for column in &mut self.offsets {
            column.resize(end.next_power_of_two(), W::Coordinate::FAR);
        }
    }

    #[inline(always)]
    pub(super) fn pad(&mut self, list: List) {
        let end = list.first + list.len;
        for column in &mut self.offsets {
            column[end..end + LANES].fill(W::Coordinate::FAR);
        }
    }

    /// Cuts the cubes of a list to the cells next to the points.
    #[inline(always)]
    pub(super) fn clip(&mut self, list: List, points: &Span) {
        let lanes = self.lanes;
        let cells = self.grown(self.boxed(points));
        // A cube's upper end may not fit; then it lies beyond all cells.
        let minus_edge = lanes.every_corner(W::Coordinate::of(-self.edge));
        self.clips.clear();
        self.clips.reserve(list.len);
        let [x, y, z] = &self.offsets;
        let (x, y, z) = (list.of(x), list.of(y), list.of(z));
        let mut left = list.len;
        for index in 0..x.len() {
            let corners = lanes.corners([
                lanes.column(&x[index]),
                lanes.column(&y[index]),
                lanes.column(&z[index]),
            ]);
            for &low in &corners[..left.min(LANES)] {
                let clip = lanes.joined([low, lanes.corner_minus(minus_edge, low)]);
                self.clips.push(lanes.common_box(clip, cells));
            }
            left = left.saturating_sub(LANES);
        }
    }

    #[inline(always)]
    pub(super) fn every(&self, coordinate: i32) -> Column<L, W> {
        self.lanes.every(W::Coordinate::of(coordinate))
    }

    /// A box of the frame in a register.
    #[inline(always)]
    pub(super) fn boxed(&self, span: &Span) -> Boxed<L, W> {
        let mut lanes = [W::Coordinate::ZERO; 8];
        for axis in 0..3 {
            lanes[axis] = W::Coordinate::of(span.min[axis]);
            lanes[4 + axis] = W::Coordinate::of(-span.max[axis]);
        }
        self.lanes.boxed(&lanes)
    }

    #[inline(always)]
    pub(super) fn unboxed(&self, boxed: Boxed<L, W>) -> Span {
        let lanes = self.lanes.box_array(boxed);
        let mut span = Span {
            min: [0; 3],
            max: [0; 3],
        };
        for axis in 0..3 {
            span.min[axis] = lanes[axis].into();
            let minus_max: i32 = lanes[4 + axis].into();
            span.max[axis] = -minus_max;
        }
        span
    }

    /// The lower ends and the upper ends of a box.
    #[inline(always)]
    pub(super) fn ends(&self, boxed: Boxed<L, W>) -> [Corner<L, W>; 2] {
        let [low, minus_high] = self.lanes.halves(boxed);
        let zero = self.lanes.every_corner(W::Coordinate::ZERO);
        [low, self.lanes.corner_minus(zero, minus_high)]
    }

    /// The cells next to a box of points.
    #[inline(always)]
    pub(super) fn grown(&self, points: Boxed<L, W>) -> Boxed<L, W> {
        let (one, zero) = (W::Coordinate::of(1), W::Coordinate::ZERO);
        let by = self
            .lanes
            .boxed(&[one, one, one, zero, one, one, one, zero]);
        self.lanes.box_minus(points, by)
    }
}
