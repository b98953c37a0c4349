//! The kernel: what one cube adds to the measures of a union, from the cubes that touch it.
//!
//! Works in coordinates local to the cube `c`, which is the box from 0 to L. A *clip* is another cube cut to the cells next to some
//! points. Only lattice points of closed `c` can change their octant mask, and only next to what `c` newly covers.
//!
//! ```text
//!   divide    takes the points apart, until few cubes are near
//!   leaf      enumerates those that count: point, octants before, octants after
//!   sums      weighs them: measures in local coordinates, then in the scene's
//!   plan      the working memory of all three, and its registers
//!   width     how wide the integers are
//!   span      boxes
//! ```
//!
//! One algorithm for all instructions (see `lanes`) and for three widths of integers (see `width`).
//! # Source
//! The local formulas are UNION3's (W. R. Franklin); evaluated once a cube instead of once a grid cell.

#![expect(
    clippy::inline_always,
    reason = "what is inlined into a task is compiled for the task's instructions; left as a call it would not be"
)]

mod divide;
mod leaf;
mod plan;
mod span;
mod sums;
mod width;

use std::fmt::Debug;

use crate::geometry::{Bounds, Edge, Measures, Place, Stock, StockMeasures, Totals};

use super::lanes::{Avx2, Columns, OnLanes, avx2, run_on};
use super::neighbours::Neighbours;
use divide::Start;
use leaf::Visitor;
use plan::Plan;
pub(super) use span::Span;
use sums::{AcrossStock, InsideStock, OfUnion, Sums, Total};
use width::{Middle, Narrow, Wide, Width};

/// Measures of a union, and of the two parts of the stock if there is one.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) struct Difference {
    pub(super) union: Measures,
    pub(super) stock: Option<StockMeasures>,
}

impl Difference {
    /// Adds it to totals, as the insertion of its cubes does.
    pub(super) fn insert_into(&self, totals: &mut Totals) {
        totals.measures.add(&self.union);
        for (total, part) in totals.stock.iter_mut().zip(&self.stock) {
            total.add(part);
        }
    }

    /// Retracts it from totals, as the deletion of its cubes does.
    pub(super) fn delete_from(&self, totals: &mut Totals) {
        totals.measures.retract(&self.union);
        for (total, part) in totals.stock.iter_mut().zip(&self.stock) {
            total.retract(part);
        }
    }
}

/// The kernel with its working memory.
#[derive(Debug)]
pub(super) struct Kernel {
    stock: Option<Bounds>,
    /// Where the last cube was that changed anything.
    corner: [i32; 3],
    marginal: Box<dyn Marginal>,
}

impl Kernel {
    /// A kernel for the processor and the edge.
    pub(super) fn new(edge: Edge) -> Self {
        Self::build(avx2(), edge.steps(), edge.steps())
    }

    /// A kernel that takes the portable path and the widest integers whatever the edge: the reference of the fast ones.
    pub(super) fn plain(edge: Edge) -> Self {
        Self::build(None, edge.steps(), Wide::STEPS_MAX)
    }

    fn build(avx2: Option<Avx2>, edge: i32, widest: i32) -> Self {
        Self {
            stock: None,
            corner: [0; 3],
            marginal: run_on(avx2, Build { edge, widest }),
        }
    }

    /// The stock that cubes are cut from.
    pub(super) fn set_stock(&mut self, stock: Option<Stock>) {
        self.stock = stock.map(|stock| stock.bounds());
    }

    /// F(S + c) - F(S) for the cube at `place`, where S is given by those of its cubes that touch c: see [`Self::add_to`].
    /// False when c changes nothing: it is covered.
    pub(super) fn marginal(&mut self, place: Place, neighbours: &Neighbours) -> bool {
        let stock = self.begin(place);
        self.marginal.difference(neighbours, stock.as_ref())
    }

    /// The same, with closed boxes, in scene coordinates, that together contain c minus S: none when c is covered.
    pub(super) fn uncovered(
        &mut self,
        place: Place,
        neighbours: &Neighbours,
        boxes: &mut Vec<Span>,
    ) -> bool {
        let stock = self.begin(place);
        let (changes, uncovered) = self.marginal.uncovered(neighbours, stock.as_ref());
        let corner = place.corner();
        boxes.clear();
        boxes.extend(uncovered.iter().map(|span| span.moved(corner)));
        changes
    }

    /// Makes a cube the last one; the stock, seen from it.
    fn begin(&mut self, place: Place) -> Option<Span> {
        self.corner = place.corner();
        self.stock.map(|stock| Span::local(&stock, place))
    }

    /// The sum of no cubes.
    pub(super) fn nothing(&self) -> Difference {
        Difference {
            union: Measures::default(),
            stock: self.stock.map(|_| StockMeasures {
                removed: Measures::default(),
                remaining: Measures::default(),
            }),
        }
    }

    /// The volume that the last cube adds.
    pub(super) fn volume(&self) -> i128 {
        self.marginal.volume()
    }

    /// Adds what the last cube changes to a sum.
    pub(super) fn add_to(&self, sum: &mut Difference) {
        self.marginal
            .add_to(self.corner, &mut sum.union, sum.stock.as_mut());
    }

    /// Adds what the last cube changes, as its insertion does.
    pub(super) fn insert_into(&self, totals: &mut Totals) {
        self.marginal
            .add_to(self.corner, &mut totals.measures, totals.stock.as_mut());
    }

    /// Retracts what the last cube changes, as its deletion does.
    pub(super) fn delete_from(&self, totals: &mut Totals) {
        self.marginal
            .retract_from(self.corner, &mut totals.measures, totals.stock.as_mut());
    }
}

impl Clone for Kernel {
    fn clone(&self) -> Self {
        Self {
            stock: self.stock,
            corner: self.corner,
            marginal: self.marginal.boxed(),
        }
    }
}

/// A kernel of some width, on some lanes.
trait Marginal: Debug + Send + Sync {
    /// Finds what a cube changes, given its neighbours and the stock in its coordinates; false when nothing.
    fn difference(&mut self, neighbours: &Neighbours, stock: Option<&Span>) -> bool;
    /// The same, with boxes around what the cube newly covers.
    fn uncovered(&mut self, neighbours: &Neighbours, stock: Option<&Span>) -> (bool, &[Span]);
    /// The volume that the last cube adds to the union.
    fn volume(&self) -> i128;
    fn add_to(&self, corner: [i32; 3], union: &mut Measures, stock: Option<&mut StockMeasures>);
    fn retract_from(
        &self,
        corner: [i32; 3],
        union: &mut Measures,
        stock: Option<&mut StockMeasures>,
    );
    fn boxed(&self) -> Box<dyn Marginal>;
}

/// Makes a kernel for an edge, its integers wide enough for edges up to the widest.
struct Build {
    edge: i32,
    widest: i32,
}

impl OnLanes for Build {
    type Output = Box<dyn Marginal>;

    #[inline(always)]
    fn run_on<L: Columns<i16> + Columns<i32>>(self, lanes: L) -> Box<dyn Marginal> {
        if self.widest <= Narrow::STEPS_MAX {
            Box::new(Evaluation::<L, Narrow>::new(lanes, self.edge))
        } else if self.widest <= Middle::STEPS_MAX {
            Box::new(Evaluation::<L, Middle>::new(lanes, self.edge))
        } else {
            Box::new(Evaluation::<L, Wide>::new(lanes, self.edge))
        }
    }
}

/// Where the stock is, seen from a cube.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Stocked {
    /// There is none near the cube.
    Nowhere,
    /// All around the cube.
    Around,
    /// A face of it is near.
    Across,
}

/// The plan, and what it finds.
#[derive(Clone, Debug)]
struct Evaluation<L: Columns<W::Coordinate>, W: Width> {
    plan: Plan<L, W>,
    stocked: Stocked,
    sums: Total<W>,
    /// The sums of a cube that touches nothing, once there was one: with no stock near, and with the stock all around.
    alone: [Option<Box<Total<W>>>; 2],
}

impl<L: Columns<W::Coordinate>, W: Width> Evaluation<L, W> {
    fn new(lanes: L, edge: i32) -> Self {
        Self {
            plan: Plan::new(lanes, edge),
            stocked: Stocked::Nowhere,
            sums: Total::default(),
            alone: [None, None],
        }
    }

    /// Finds what a cube changes.
    #[inline]
    fn find(&mut self, neighbours: &Neighbours, stock: Option<&Span>) -> bool {
        self.plan.uncovered.clear();
        let cube = Span::cube([0; 3], self.plan.edge);
        self.stocked = match stock {
            Some(stock) if stock.contains(&cube.grown()) => Stocked::Around,
            Some(stock) if cube.clamped(stock).is_solid() => Stocked::Across,
            Some(_) | None => Stocked::Nowhere,
        };
        let is_alone = neighbours.len == 0;
        match (self.stocked, stock) {
            (Stocked::Across, Some(stock)) => {
                self.plan.stock = self.plan.boxed(&stock.clamped(&cube.grown()));
                self.evaluate::<AcrossStock<L, W>>(neighbours)
            }
            (Stocked::Around, _) if is_alone => {
                self.evaluate_alone::<InsideStock<L, W>>(neighbours, 1)
            }
            (Stocked::Around, _) => self.evaluate::<InsideStock<L, W>>(neighbours),
            _ if is_alone => self.evaluate_alone::<OfUnion<L, W>>(neighbours, 0),
            _ => self.evaluate::<OfUnion<L, W>>(neighbours),
        }
    }

    fn evaluate<V: Visitor<L, W, Total = Total<W>>>(&mut self, neighbours: &Neighbours) -> bool {
        for sums in &mut self.sums {
            *sums = Sums::default();
        }
        let start = Start::<L, W, V> {
            plan: &mut self.plan,
            neighbours,
            total: &mut self.sums,
        };
        let lanes = start.plan.lanes;
        lanes.run(start) && !self.sums[0].is_nothing()
    }

    /// The sums of a cube without neighbours, which are always the same.
    fn evaluate_alone<V: Visitor<L, W, Total = Total<W>>>(
        &mut self,
        neighbours: &Neighbours,
        number: usize,
    ) -> bool {
        if let Some(alone) = &self.alone[number] {
            self.sums.clone_from(alone);
            if self.plan.collect {
                self.plan.uncovered.push(Span::cube([0; 3], self.plan.edge));
            }
            return true;
        }
        let changes = self.evaluate::<V>(neighbours);
        self.alone[number] = Some(Box::new(self.sums.clone()));
        changes
    }

    fn combine<const RETRACT: bool>(
        &self,
        corner: [i32; 3],
        to: &mut Measures,
        stock: Option<&mut StockMeasures>,
    ) {
        let [union, removed, remaining] = &self.sums;
        union.combine::<RETRACT>(corner, to);
        let Some(stock) = stock else { return };
        match self.stocked {
            Stocked::Nowhere => {}
            Stocked::Around => {
                union.combine::<RETRACT>(corner, &mut stock.removed);
                remaining.combine::<RETRACT>(corner, &mut stock.remaining);
            }
            Stocked::Across => {
                removed.combine::<RETRACT>(corner, &mut stock.removed);
                remaining.combine::<RETRACT>(corner, &mut stock.remaining);
            }
        }
    }
}

impl<L: Columns<W::Coordinate>, W: Width> Marginal for Evaluation<L, W> {
    fn difference(&mut self, neighbours: &Neighbours, stock: Option<&Span>) -> bool {
        self.plan.collect = false;
        self.find(neighbours, stock)
    }

    fn uncovered(&mut self, neighbours: &Neighbours, stock: Option<&Span>) -> (bool, &[Span]) {
        self.plan.collect = true;
        let changes = self.find(neighbours, stock);
        (changes, &self.plan.uncovered)
    }

    fn volume(&self) -> i128 {
        self.sums[0].volume()
    }

    fn add_to(&self, corner: [i32; 3], union: &mut Measures, stock: Option<&mut StockMeasures>) {
        self.combine::<false>(corner, union, stock);
    }

    fn retract_from(
        &self,
        corner: [i32; 3],
        union: &mut Measures,
        stock: Option<&mut StockMeasures>,
    ) {
        self.combine::<true>(corner, union, stock);
    }

    fn boxed(&self) -> Box<dyn Marginal> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests;
