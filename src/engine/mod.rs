//! The exact online engine: a set of identical cubes whose totals are current after every change.
//!
//! Knows cubes, the grid and the kernel. Never knows I/O, floats, async, or in which order cubes came: the totals are a
//! function of the set alone.
//!
//! ```text
//!   judge(ops) ──> Effect ──> apply ──┬─ ids      cubes by id
//!                                     ├─ exposed  grid of the cubes whose union is the union
//!                                     ├─ covered  grid of the cubes that the exposed ones cover: never gathered
//!                                     ├─ covered_cells   cells inside the union, while many cubes are covered
//!                                     └─ totals   += or -= marginal(cube | its exposed neighbours)
//! ```
//!
//! Invariants: every cube of `ids` is in exactly one grid; the union of the exposed cubes is the union of all; `totals`
//! are those of [`recount`].

mod access;
mod audit;
mod bare;
mod batch;
mod batch_ids;
mod bins;
mod covered_cells;
mod extents;
pub mod faces;
mod grid;
mod ids;
mod judge;
mod kernel;
mod lanes;
mod neighbours;
mod parallel;
mod prefetch;
mod scan;
pub mod solids;

use std::cell::RefCell;
use std::num::NonZero;
use std::ops::ControlFlow;
use std::thread::available_parallelism;

use crate::geometry::{CUBES_MAX, CubeId, Edge, Effect, Place, Stock, Totals};

pub use access::Access;
pub use audit::{recount, recount_while};
pub use bare::Bare;
use batch::{BATCH_MIN, Helper, delete_batch, insert_batch};
use batch_ids::change_ids;
use covered_cells::CoveredCells;
use grid::{CUBES_A_STEP, Grid};
pub use ids::{Cursor, IdTable};
use kernel::{Kernel, Span};
use neighbours::Neighbours;
use prefetch::AHEAD;

/// One operation on a scene's set of bodies (cubes, known by their places).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Op<Body = Place> {
    /// Delete the body of this id; nothing happens when there is none.
    Delete(CubeId),
    /// Insert a body; nothing happens when this id has the same body already.
    Insert(CubeId, Body),
}

/// How many operations did what.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Counts {
    /// Operations that inserted a body.
    pub inserted: u64,
    /// Operations that deleted a body.
    pub deleted: u64,
    /// Operations that changed nothing.
    pub unchanged: u64,
}

/// The judgement of a sequence of operations that can be applied.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Judged<Body = Place> {
    /// What to apply.
    pub effect: Effect<Body>,
    /// Counts of the operations one after the other, as a stream reports them.
    pub in_order: Counts,
    /// Counts by net effect, as an atomic change reports them.
    pub net: Counts,
}

/// Why a sequence of operations is refused as a whole.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
pub enum Rejected {
    /// An inserted id is already at another place.
    #[error("cube {} is already at {:?}, so it cannot be inserted at {:?} (operation {index})", id.0, there.corner(), asked.corner())]
    IdConflict {
        /// Which operation, from 0.
        index: usize,
        /// The id.
        id: CubeId,
        /// Where the cube is.
        there: Place,
        /// Where it was to be inserted.
        asked: Place,
    },
    /// The scene would hold too many cubes.
    #[error("the scene would hold {cubes} cubes; the most is {cubes_max}")]
    TooManyCubes {
        /// How many it would hold.
        cubes: u64,
        /// How many it may hold.
        cubes_max: u64,
    },
}

/// An effect does not fit the set it is applied to: an inserted id is present, or a deleted one absent or elsewhere.
/// Happens only in the replay of a damaged log.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("the effect on cube {} does not fit the set of cubes", id.0)]
pub struct Inconsistent {
    /// The first cube at fault.
    pub id: CubeId,
}

/// Where a point lies.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Side {
    /// In the interior of the union.
    Inside,
    /// On its (regularised) boundary.
    Boundary,
    /// Outside.
    Outside,
}

/// A persistent set of identical cubes whose totals are always current.
#[derive(Debug)]
pub struct Engine {
    edge: Edge,
    stock: Option<Stock>,
    ids: IdTable,
    exposed: Grid,
    covered: Grid,
    kernel: Kernel,
    covered_cells: CoveredCells,
    totals: Totals,
    work: Work,
    threads: usize,
    helpers: Vec<Helper>,
}

/// Memory that one operation after the other uses.
#[derive(Debug)]
struct Work {
    neighbours: Neighbours,
    uncovered: Vec<Span>,
    /// Covered cubes that meet what is uncovered.
    candidates: Vec<(CubeId, Span)>,
}

impl Work {
    /// Removes the candidate that meets most of the boxes, so that few cubes become exposed; and those that meet none.
    fn next_candidate(&mut self) -> Option<(CubeId, Span)> {
        let Self {
            uncovered,
            candidates,
            ..
        } = self;
        let mut best = (0, None);
        let mut count = 0;
        candidates.retain(|(_, cube)| {
            let overlap = uncovered.iter().map(|span| span.overlap(cube)).max();
            let overlap = overlap.unwrap_or(0);
            if overlap > best.0 {
                best = (overlap, Some(count));
            }
            count += usize::from(overlap > 0);
            overlap > 0
        });
        let (_, index) = best;
        Some(candidates.swap_remove(index?))
    }
}

impl Engine {
    /// An empty scene of cubes of `edge`, with bins that follow the data.
    pub fn new(edge: Edge) -> Self {
        Self::build(
            edge,
            Grid::for_neighbours(edge),
            Grid::for_small_boxes(edge),
            Kernel::new(edge),
            CoveredCells::new(edge),
        )
    }

    /// An empty scene whose bins stay `2^bin_shift` steps wide: the same totals, in another time and space.
    pub fn with_bins(edge: Edge, bin_shift: u32) -> Self {
        let bins = || Grid::with_bins(edge, bin_shift);
        Self::build(
            edge,
            bins(),
            bins(),
            Kernel::new(edge),
            CoveredCells::new(edge),
        )
    }

    /// An empty scene that computes without special instructions, in the widest integers and without covered cells,
    /// whatever the processor and the edge: the same totals, slower.
    pub fn plain(edge: Edge) -> Self {
        Self::build(
            edge,
            Grid::for_neighbours(edge).plain(),
            Grid::for_small_boxes(edge).plain(),
            Kernel::plain(edge),
            CoveredCells::never(edge),
        )
    }

    fn build(
        edge: Edge,
        exposed: Grid,
        covered: Grid,
        kernel: Kernel,
        covered_cells: CoveredCells,
    ) -> Self {
        Self {
            edge,
            stock: None,
            ids: IdTable::new(),
            exposed,
            covered,
            kernel,
            covered_cells,
            totals: Totals::default(),
            work: Work {
                neighbours: Neighbours::new(),
                uncovered: Vec::new(),
                candidates: Vec::new(),
            },
            threads: available_parallelism().map_or(1, NonZero::get),
            helpers: Vec::new(),
        }
    }

    /// The same with so many threads for a large batch, instead of as many as there are processors: the same totals.
    #[must_use]
    pub fn with_threads(mut self, threads: NonZero<usize>) -> Self {
        self.threads = threads.get();
        self
    }

    /// The same, cut from a stock: for an engine that has no cubes yet.
    #[must_use]
    pub fn with_stock(mut self, stock: Option<Stock>) -> Self {
        assert!(self.is_empty(), "a stock is there before the first cube");
        self.stock = stock;
        self.kernel.set_stock(stock);
        self.totals = Totals::of_nothing(stock);
        self
    }

    /// The stock, if there is one.
    pub fn stock(&self) -> Option<Stock> {
        self.stock
    }

    /// The edge of every cube.
    pub fn edge(&self) -> Edge {
        self.edge
    }

    /// Current totals. O(1).
    pub fn totals(&self) -> Totals {
        self.totals
    }

    /// Number of cubes. O(1).
    pub fn len(&self) -> u64 {
        self.ids.len() as u64
    }

    /// Whether there is no cube. O(1).
    pub fn is_empty(&self) -> bool {
        self.ids.len() == 0
    }

    /// Bytes of the cubes by id and of the grids.
    pub fn size(&self) -> EngineSize {
        EngineSize {
            ids: self.ids.size(),
            grid: self.exposed.size() + self.covered.size() + self.covered_cells.size(),
        }
    }

    /// Where the cube of this id is. O(1).
    pub fn get(&self, id: CubeId) -> Option<Place> {
        self.ids.get(id)
    }

    /// Makes room for so many more cubes by id: for those that come in the order of a listing, chunk by chunk, which would
    /// fill only the front of a table that grows.
    pub fn reserve(&mut self, cubes: u64) {
        let more = usize::try_from(cubes.min(CUBES_MAX));
        self.ids.reserve(more.expect("it is at most 2^31"));
    }

    /// Applies an effect, whole or not at all: deletions first. The only door through which state changes.
    /// O(cubes named), each in its neighbourhood.
    /// # Errors
    /// [`Inconsistent`] when the effect does not fit; then nothing has changed.
    pub fn apply(&mut self, effect: &Effect) -> Result<(), Inconsistent> {
        if Self::applies_at_once(effect) {
            self.apply_few(effect)
        } else {
            Self::apply_through(&RefCell::new(self), effect)
        }
    }

    /// Whether an effect is so small that applying it is one short step.
    pub fn applies_at_once(effect: &Effect) -> bool {
        effect.deleted.len() < BATCH_MIN && effect.inserted.len() < BATCH_MIN
    }

    /// The same in many steps, to an engine that others read meanwhile, and nobody else changes: for an effect that is not small.
    /// Until it returns they find in [`Self::get`], [`Self::cubes_after`] and [`Self::each_at`] every cube that the effect does not
    /// name, and some of those that it does; totals are not current.
    /// # Errors
    /// As of [`Self::apply`].
    pub fn apply_through(access: &impl Access, effect: &Effect) -> Result<(), Inconsistent> {
        let Effect { deleted, inserted } = effect;
        let by_shards = access.look(|engine| engine.changes_whole_shards(effect));
        // When the effect does not fit, one cube after the other finds out where.
        if !(by_shards && change_ids(access, effect)) {
            apply_ids(access, effect)?;
        }
        if deleted.len() < BATCH_MIN {
            access.step(|engine| engine.delete_each(deleted));
        } else {
            delete_batch(access, deleted);
        }
        if inserted.len() < BATCH_MIN {
            access.step(|engine| engine.insert_each(inserted));
        } else {
            insert_batch(access, inserted);
        }
        access.step(Self::complete_totals);
        Ok(())
    }

    /// Applies an effect in one step.
    fn apply_few(&mut self, effect: &Effect) -> Result<(), Inconsistent> {
        // While the table of ids is waited for, the bins are on their way too.
        let firsts = [effect.deleted.first(), effect.inserted.first()];
        for (id, place) in firsts.into_iter().flatten() {
            self.ids.prefetch(*id);
            self.prefetch_around(*place);
        }
        if let Err(deleted) = self.remove_ids(&effect.deleted) {
            return Err(self.undo_ids(effect, deleted, 0));
        }
        if let Err(inserted) = self.insert_ids(&effect.inserted) {
            return Err(self.undo_ids(effect, effect.deleted.len(), inserted));
        }
        self.delete_each(&effect.deleted);
        self.insert_each(&effect.inserted);
        self.complete_totals();
        Ok(())
    }

    /// Prefetches where the search for a cube and those around it begins.
    #[inline]
    fn prefetch_around(&self, place: Place) {
        if self.covered.len() > 0 {
            self.covered.prefetch_levels(place);
        }
        // Where covered cells are kept, most changes end there and look at no exposed cube.
        if !self.covered_cells.are_kept() {
            self.exposed.prefetch_around(place);
        }
    }

    fn delete_each(&mut self, cubes: &[(CubeId, Place)]) {
        for (at, &(id, place)) in cubes.iter().enumerate() {
            if let Some((_, next)) = cubes.get(at + 1) {
                self.prefetch_around(*next);
            }
            self.delete(id, place);
        }
    }

    fn insert_each(&mut self, cubes: &[(CubeId, Place)]) {
        for (at, &(id, place)) in cubes.iter().enumerate() {
            if let Some((_, next)) = cubes.get(at + 1) {
                self.prefetch_around(*next);
            }
            self.insert(id, place);
        }
    }

    /// Brings up to date what is no sum of differences.
    fn complete_totals(&mut self) {
        self.totals.cubes = self.len();
        self.totals.bounds = self.exposed.bounds();
    }

    /// Removes cubes from the table of ids; the error is how many were removed before one did not fit.
    fn remove_ids(&mut self, cubes: &[(CubeId, Place)]) -> Result<(), usize> {
        for (done, (id, place)) in cubes.iter().enumerate() {
            if let Some((ahead, _)) = cubes.get(done + AHEAD) {
                self.ids.prefetch(*ahead);
            }
            if self.ids.get(*id) != Some(*place) {
                return Err(done);
            }
            self.ids.remove(*id);
        }
        Ok(())
    }

    /// Inserts cubes into the table of ids; the error is how many were inserted before one did not fit.
    fn insert_ids(&mut self, cubes: &[(CubeId, Place)]) -> Result<(), usize> {
        for (done, (id, place)) in cubes.iter().enumerate() {
            if let Some((ahead, _)) = cubes.get(done + AHEAD) {
                self.ids.prefetch(*ahead);
            }
            if self.ids.len() as u64 == CUBES_MAX || !self.ids.insert(*id, *place) {
                return Err(done);
            }
        }
        Ok(())
    }

    /// Takes back the first `deleted` removals and `inserted` insertions of ids of an effect, after which one did not fit.
    fn undo_ids(&mut self, effect: &Effect, deleted: usize, inserted: usize) -> Inconsistent {
        for (id, _) in effect.inserted[..inserted].iter().rev() {
            let removed = self.ids.remove(*id);
            assert!(removed.is_some(), "it was inserted a moment ago");
        }
        for (id, place) in effect.deleted[..deleted].iter().rev() {
            let inserted = self.ids.insert(*id, *place);
            assert!(inserted, "it was removed a moment ago");
        }
        let at_fault = effect.deleted.get(deleted);
        let at_fault = at_fault.or_else(|| effect.inserted.get(inserted));
        let (id, _) = *at_fault.expect("one of them did not fit");
        Inconsistent { id }
    }

    fn insert(&mut self, id: CubeId, place: Place) {
        if self.covered_cells.are_kept() {
            self.covered.prefetch_end(place);
        }
        if self.covered_cells.cover(place) {
            self.covered.insert(place, id);
        } else if self.marginal(place) {
            self.kernel.insert_into(&mut self.totals);
            self.expose(id, place);
        } else {
            self.covered_cells.mark(place);
            self.covered.insert(place, id);
        }
        self.covered_cells.review(&self.exposed, &self.covered, 1);
    }

    /// Puts a cube among the exposed ones.
    fn expose(&mut self, id: CubeId, place: Place) {
        self.exposed.insert(place, id);
        if self.covered_cells.are_kept() && self.exposed.is_dense_at(place) {
            self.covered_cells.mark(place);
        }
    }

    fn delete(&mut self, id: CubeId, place: Place) {
        if self.covered.remove(place, id) {
            return;
        }
        if self.replace_by_duplicate(id, place) {
            return;
        }
        assert!(
            self.exposed.remove(place, id),
            "a cube is in one of the grids"
        );
        if self.uncovered(place) && !self.cover_again(place) {
            self.kernel.delete_from(&mut self.totals);
            for uncovered in &self.work.uncovered {
                self.covered_cells.unmark(uncovered);
            }
        }
        self.covered_cells.review(&self.exposed, &self.covered, 1);
    }

    /// A duplicate of a cube that goes, if there is one, becomes exposed instead of it: the union stays.
    fn replace_by_duplicate(&mut self, id: CubeId, place: Place) -> bool {
        if self.covered.len() == 0 {
            return false;
        }
        let Some(duplicate) = self.covered.at(place) else {
            return false;
        };
        assert!(
            self.covered.remove(place, duplicate),
            "a duplicate was found there"
        );
        assert!(
            self.exposed.rename(place, id, duplicate),
            "a cube is in one of the grids"
        );
        true
    }

    /// Makes covered cubes exposed until they cover what the cube at `place`, which goes, would uncover, as far as they can; true when
    /// they cover all of it. What is left is in `work` and `kernel`, as [`Self::uncovered`] finds it.
    ///
    /// The union already holds these cubes, so exposing them changes nothing: the kernel looks at the cube that goes alone.
    fn cover_again(&mut self, place: Place) -> bool {
        if let Some((id, covering)) = self.find_candidates() {
            self.move_to_exposed(id, covering);
            return true;
        }
        let corner = place.corner();
        let mut left = self.kernel.volume();
        while let Some((id, candidate)) = self.work.next_candidate() {
            let offset = [0, 1, 2].map(|axis| candidate.min[axis] - corner[axis]);
            self.work.neighbours.push(offset);
            let (neighbours, boxes) = (&self.work.neighbours, &mut self.work.uncovered);
            let is_left = self.kernel.uncovered(place, neighbours, boxes);
            if is_left && self.kernel.volume() == left {
                // The boxes are wide: the candidate meets them, but nothing that is uncovered.
                self.work.neighbours.pop();
                continue;
            }
            self.move_to_exposed(id, Place::from_checked(candidate.min));
            if !is_left {
                return true;
            }
            left = self.kernel.volume();
        }
        false
    }

    /// Makes covered cubes exposed until they cover again what the deleted cube at `place` uncovered, as far as they can, and adds
    /// what they bring. That lies within the boxes of `work`.
    fn promote(&mut self, place: Place) {
        if let Some((id, covering)) = self.find_candidates() {
            self.promote_one(id, covering);
            return;
        }
        while let Some((id, candidate)) = self.work.next_candidate() {
            if !self.promote_one(id, Place::from_checked(candidate.min)) {
                continue;
            }
            let Work {
                uncovered,
                candidates,
                ..
            } = &mut self.work;
            uncovered.retain(|uncovered| !candidate.contains(uncovered));
            // The boxes are wide. Only when another cube might be needed is it worth finding out what is still uncovered.
            let needed =
                |(_, other): &(CubeId, Span)| uncovered.iter().any(|span| span.overlap(other) > 0);
            if !candidates.iter().any(needed) || !self.uncovered(place) {
                return;
            }
        }
    }

    /// Finds the covered cubes that meet the boxes of `work`, as its candidates; or one of them that covers all of the boxes.
    fn find_candidates(&mut self) -> Option<(CubeId, Place)> {
        let Work {
            uncovered,
            candidates,
            ..
        } = &mut self.work;
        candidates.clear();
        if self.covered.len() == 0 {
            return None;
        }
        let boxes = uncovered.iter().copied();
        let uncovered = boxes.reduce(|one, other| one.joined(&other))?;
        let edge = self.edge.steps();
        let reach = uncovered.min.map(|low| low - edge);
        // Where cubes are dense one often covers all of it; the first one found will do.
        let covering = self.covered.visit(reach, uncovered.max, |corner, id| {
            let cube = Span::cube(corner, edge);
            if cube.contains(&uncovered) {
                return ControlFlow::Break((id, Place::from_checked(corner)));
            }
            candidates.push((id, cube));
            ControlFlow::Continue(())
        });
        covering.break_value()
    }

    /// Makes a covered cube exposed.
    fn move_to_exposed(&mut self, id: CubeId, place: Place) {
        assert!(self.covered.remove(place, id), "a candidate is covered");
        self.expose(id, place);
    }

    /// Makes a covered cube exposed, unless the exposed cubes cover it.
    fn promote_one(&mut self, id: CubeId, place: Place) -> bool {
        if !self.marginal(place) {
            return false;
        }
        self.kernel.insert_into(&mut self.totals);
        self.move_to_exposed(id, place);
        true
    }

    /// Finds what the cube at `place` adds to the union of the exposed cubes; false when they cover it.
    fn marginal(&mut self, place: Place) -> bool {
        self.exposed
            .gather(place.corner(), &mut self.work.neighbours);
        self.kernel.marginal(place, &self.work.neighbours)
    }

    /// The same, and boxes around what the exposed cubes do not cover of it.
    fn uncovered(&mut self, place: Place) -> bool {
        self.exposed
            .gather(place.corner(), &mut self.work.neighbours);
        self.kernel
            .uncovered(place, &self.work.neighbours, &mut self.work.uncovered)
    }

    /// All cubes with their ids, in the order of the listing. O(cubes).
    pub fn cubes(&self) -> impl Iterator<Item = (CubeId, Place)> + '_ {
        self.cubes_after(None)
    }

    /// The cubes that stand after the cursor in the listing, in its order; all of them without a cursor. A cube that is there
    /// during a whole listing made in several parts is listed exactly once, whatever changes meanwhile.
    pub fn cubes_after(&self, after: Option<Cursor>) -> impl Iterator<Item = (CubeId, Place)> + '_ {
        self.ids.cubes_after(after)
    }

    /// Where a lattice point lies, and the cube of least id that holds it (closed cubes). O(cubes around the point).
    pub fn contains(&self, point: [i32; 3]) -> (Side, Option<(CubeId, Place)>) {
        let mut held = Held::new(self.edge, point);
        self.each_at(point, |id, place| held.by(id, place));
        held.answer()
    }

    /// Calls `visit` with every cube that holds a point (closed cubes). O(cubes around the point).
    pub fn each_at(&self, point: [i32; 3], mut visit: impl FnMut(CubeId, Place)) {
        let Some(min) = lower_corner_of_reach(point, self.edge.steps()) else {
            return;
        };
        for grid in [&self.exposed, &self.covered] {
            let all = grid.visit(min, point, |corner, id| {
                visit(id, Place::from_checked(corner));
                ControlFlow::<()>::Continue(())
            });
            debug_assert!(
                all.is_continue(),
                "every cube around the point is looked at"
            );
        }
    }
}

/// Which cubes hold a point, looked at one after the other.
#[derive(Debug)]
pub struct Held {
    edge: i32,
    point: [i32; 3],
    mask: u8,
    least: Option<(CubeId, Place)>,
}

impl Held {
    /// No cube yet.
    pub fn new(edge: Edge, point: [i32; 3]) -> Self {
        Self {
            edge: edge.steps(),
            point,
            mask: 0,
            least: None,
        }
    }

    /// Adds a cube that holds the point.
    pub fn by(&mut self, id: CubeId, place: Place) {
        self.mask |= octants_filled(place.corner(), self.point, self.edge);
        if self.least.is_none_or(|(least, _)| id < least) {
            self.least = Some((id, place));
        }
    }

    /// Where the point lies in the union of the cubes added, and the one of least id.
    pub fn answer(&self) -> (Side, Option<(CubeId, Place)>) {
        let side = match self.mask {
            0 => Side::Outside,
            u8::MAX => Side::Inside,
            _ => Side::Boundary,
        };
        (side, self.least)
    }
}

/// The part of an effect that can fail. Undone to the last cube when it does.
fn apply_ids(access: &impl Access, effect: &Effect) -> Result<(), Inconsistent> {
    let misfit = in_steps(access, &effect.deleted, Engine::remove_ids)
        .err()
        .map(|done| (done, 0));
    let misfit = misfit.or_else(|| {
        access.step(|engine| engine.ids.reserve(effect.inserted.len()));
        let misfit = in_steps(access, &effect.inserted, Engine::insert_ids).err();
        misfit.map(|done| (effect.deleted.len(), done))
    });
    let Some((deleted, inserted)) = misfit else {
        return Ok(());
    };
    Err(access.step(|engine| engine.undo_ids(effect, deleted, inserted)))
}

/// Takes cubes to `task`, so many a step, until it fails; the error is how many were done before.
fn in_steps(
    access: &impl Access,
    cubes: &[(CubeId, Place)],
    task: impl Fn(&mut Engine, &[(CubeId, Place)]) -> Result<(), usize>,
) -> Result<(), usize> {
    for (some, number) in cubes.chunks(CUBES_A_STEP).zip(0..) {
        let done = access.step(|engine| task(engine, some));
        done.map_err(|done| number * CUBES_A_STEP + done)?;
    }
    Ok(())
}

/// Least lower corner of a cube that can hold the point; none when no cube can lie there.
fn lower_corner_of_reach(point: [i32; 3], edge: i32) -> Option<[i32; 3]> {
    let mut min = [0; 3];
    for axis in 0..3 {
        min[axis] = point[axis].checked_sub(edge)?;
    }
    Some(min)
}

/// The octants around `point` that the cube at `corner` fills; the closed cube holds the point.
fn octants_filled(corner: [i32; 3], point: [i32; 3], edge: i32) -> u8 {
    // Per axis the octants below and above: see `OctantMask` for the order of the bits.
    const SIDES: [[u8; 2]; 3] = [
        [0b0101_0101, 0b1010_1010],
        [0b0011_0011, 0b1100_1100],
        [0b0000_1111, 0b1111_0000],
    ];
    let mut mask = u8::MAX;
    for axis in 0..3 {
        let [below, above] = SIDES[axis];
        if point[axis] == corner[axis] {
            mask &= above;
        } else if point[axis] == corner[axis] + edge {
            mask &= below;
        }
    }
    mask
}

/// Bytes that an engine takes, without the allocator's own.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct EngineSize {
    /// Cubes by id.
    pub ids: usize,
    /// Cubes by place.
    pub grid: usize,
}
