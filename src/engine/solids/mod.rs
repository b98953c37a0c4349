//! The exact online engine of solids: a set of bodies, each a union of a few convex polyhedra, whose totals are current after every change.
//!
//! Knows convex solids, the kernel and the set. Never knows I/O, async, user units, or in which order bodies came.
//!
//! ```text
//!   stock     ── all parts are cut to it, where there is one
//!   judge(ops) ──> Effect ──> apply ──┬─ bodies    by id, in the order of the listing
//!                                     ├─ slots     every convex part: its state and its witnesses; prepared pieces in bounded memory
//!                                     ├─ exposed   bins of the parts whose union is the union
//!                                     ├─ covered   bins of the parts that the exposed ones cover: never neighbours
//!                                     └─ totals    += or -= marginal(part | its exposed neighbours)
//! ```
//!
//! # Claim: totals are a function of the set alone
//! Exact: which points are vertices of the union, which edges and facets meet there, every predicate. Rounded, once and half away from zero: the
//! real number that a flag contributes to a measure. So equal sets have equal totals, to the last unit, whatever the order, the
//! history, the processor or the number of threads; with all bodies deleted everything is 0. Proof: `ledger.rs` (telescoping of rounded
//! flags), `certify.rs` (the filter), `double.rs` (arithmetic). Tests named after it: `tests/solids.rs`.
//!
//! Floats certify signs and roundings, in rooms of their own: `certify`, `vector`, `lanes`, `double`, `ledger`. The feature `paranoid` compares
//! everything that they certify with exact integers. [`Engine::exact`] computes without them.
//!
//! # Source
//! W. R. Franklin, "Analysis of mass properties of the union of millions of polyhedra", 2004: sums over flags, V = -1/6 sum P.T P.N P.B.

#![expect(
    clippy::many_single_char_names,
    clippy::similar_names,
    reason = "points, directions and normals have the letters of the formulas"
)]

mod batch;
mod bins;
mod body;
mod certify;
mod clip;
mod contact;
mod contains;
mod double;
mod edges;
mod exact;
mod excerpt;
mod face;
mod features;
mod judge;
mod lanes;
mod ledger;
mod lines;
mod marginal;
mod measures;
mod piece;
mod recount;
mod sector;
mod slots;
mod stock;
mod vector;
mod witnesses;
mod worker;

use std::collections::BTreeMap;
use std::num::NonZero;
use std::ops::Bound;
use std::sync::Arc;
use std::thread::available_parallelism;

use smallvec::SmallVec;

use crate::geometry::{Bounds, CubeId};

use super::Cursor;
use bins::Bins;
pub use body::{Body, InvalidBody, PARTS_MAX, Shape, SolidId};
use certify::Room;
pub use contact::Added;
pub use contains::Around;
pub use edges::{Edges, Listed, Side, Surface};
pub use exact::Homogeneous;
use face::Arithmetic;
use features::Features;
pub use judge::{Judged, Op, Rejected};
use lines::Member;
use measures::Extents;
pub use measures::{AREA_UNIT, ErrorMax, LENGTH_UNIT, Measures, Totals, VOLUME_UNIT};
use piece::Piece;
pub use recount::{recount, recount_exactly, recount_while};
use slots::{Part, Slots, State};
pub use stock::{InvalidStock, STOCK_VERTICES_MAX, Stock};
use witnesses::Placed;
use worker::Worker;

/// Most bodies of a scene: `2^24`.
pub const SOLIDS_MAX: u64 = 1 << 24;

/// Bytes of prepared pieces that stay between changes, unless [`Engine::with_prepared`] says otherwise: 256 MiB.
pub const PREPARED_BYTES: usize = 256 << 20;

/// The difference between two sets of bodies.
pub type Effect = crate::geometry::Effect<Body>;

/// An effect does not fit the set it is applied to: an inserted id is present, or a deleted one absent or another body.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("the effect on solid {} does not fit the set of solids", id.0)]
pub struct Inconsistent {
    /// The first body at fault.
    pub id: SolidId,
}

/// Bytes that an engine takes, without the allocator's own.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct EngineSize {
    /// Bodies by id, and what is kept for each part.
    pub solids: usize,
    /// Parts by place.
    pub bins: usize,
    /// Prepared pieces: a cache of bounded size.
    pub prepared: usize,
}

/// A body in the set.
#[derive(Debug)]
struct Entry {
    id: SolidId,
    body: Body,
    slots: SmallVec<[u32; 2]>,
}

/// A persistent set of bodies whose totals are always current.
#[derive(Debug)]
pub struct Engine {
    bodies: BTreeMap<Cursor, Entry>,
    slots: Slots,
    exposed: Bins,
    covered: Bins,
    measures: Measures,
    extents: Extents,
    stock: Option<Stock>,
    /// Measures of what remains of the stock; meaningless without one.
    rest: Measures,
    arithmetic: Arithmetic,
    worker: Worker,
    threads: usize,
    /// A worker for each thread of a batch, once there was one.
    helpers: Vec<Worker>,
}

/// A part in the neighbourhood of another.
struct Neighbour {
    slot: u32,
    piece: Arc<Piece>,
}

impl Neighbour {
    fn placed(&self) -> Placed<'_> {
        Placed {
            piece: &self.piece,
            slot: self.slot,
        }
    }
}

impl Default for Engine {
    fn default() -> Self {
        Self::new()
    }
}

impl Engine {
    /// An empty scene.
    pub fn new() -> Self {
        Self::build(Arithmetic::Filtered)
    }

    /// An empty scene that computes in big integers alone: the same totals, much slower.
    pub fn exact() -> Self {
        Self::build(Arithmetic::Exact)
    }

    fn build(arithmetic: Arithmetic) -> Self {
        Self {
            bodies: BTreeMap::new(),
            slots: Slots::new(PREPARED_BYTES),
            exposed: Bins::new(),
            covered: Bins::new(),
            measures: Measures::default(),
            extents: Extents::default(),
            stock: None,
            rest: Measures::default(),
            arithmetic,
            worker: Worker::new(arithmetic, None),
            threads: available_parallelism().map_or(1, NonZero::get),
            helpers: Vec::new(),
        }
    }

    /// The same with so many bytes for prepared pieces between changes: the same totals, in another time and space.
    #[must_use]
    pub fn with_prepared(mut self, bytes: usize) -> Self {
        self.slots = Slots::new(bytes);
        self
    }

    /// The same with so many threads for a batch of bodies, instead of as many as there are processors: the same totals.
    #[must_use]
    pub fn with_threads(mut self, threads: NonZero<usize>) -> Self {
        self.threads = threads.get();
        self
    }

    /// The same, cut from a stock: for an engine that has no bodies yet.
    #[must_use]
    pub fn with_stock(mut self, stock: Option<Stock>) -> Self {
        assert!(self.is_empty(), "a stock is there before the first body");
        let piece = stock.as_ref().map(|stock| Arc::clone(stock.piece()));
        self.worker = Worker::new(self.arithmetic, piece.clone());
        self.helpers.clear();
        let kernel = &mut self.worker.kernel;
        self.rest = piece.map_or(Measures::default(), |piece| kernel.begin(&piece));
        self.stock = stock;
        self
    }

    /// The stock, if there is one.
    pub fn stock(&self) -> Option<&Stock> {
        self.stock.as_ref()
    }

    /// Current totals. O(1).
    pub fn totals(&self) -> Totals {
        Totals {
            solids: self.len(),
            measures: self.measures,
            remaining: self.stock.as_ref().map(|_| self.rest),
            bounds: self.extents.bounds(),
        }
    }

    /// How far rounding can be off in the totals' measures, at most. It grows with every change, for nobody counts the flags that go, until
    /// the last body goes; without any it is that of the stock, or 0. O(1).
    pub fn error_max(&self) -> ErrorMax {
        self.worker.kernel.error_max()
    }

    /// Number of bodies. O(1).
    pub fn len(&self) -> u64 {
        self.bodies.len() as u64
    }

    /// Whether there is no body. O(1).
    pub fn is_empty(&self) -> bool {
        self.bodies.is_empty()
    }

    /// How many convex parts are exposed, and how many the others cover. O(1).
    pub fn parts(&self) -> [usize; 2] {
        [self.exposed.len(), self.covered.len()]
    }

    /// Bytes of the set, of the bins and of the prepared pieces. O(bodies).
    pub fn size(&self) -> EngineSize {
        let (records, prepared) = self.slots.size();
        EngineSize {
            solids: records + self.bodies.len() * size_of::<(Cursor, Entry)>(),
            bins: self.exposed.size() + self.covered.size(),
            prepared,
        }
    }

    /// The body of this id. O(log bodies).
    pub fn get(&self, id: SolidId) -> Option<&Body> {
        self.bodies.get(&cursor(id)).map(|entry| &entry.body)
    }

    /// All bodies with their ids, in the order of the listing. O(bodies).
    pub fn solids(&self) -> impl Iterator<Item = (SolidId, &Body)> + '_ {
        self.solids_after(None)
    }

    /// The bodies that stand after the cursor in the listing, in its order; all of them without a cursor. The order is fixed by the
    /// ids alone.
    pub fn solids_after(
        &self,
        after: Option<Cursor>,
    ) -> impl Iterator<Item = (SolidId, &Body)> + '_ {
        let from = after.map_or(Bound::Unbounded, Bound::Excluded);
        let range = self.bodies.range((from, Bound::Unbounded));
        range.map(|(_, entry)| (entry.id, &entry.body))
    }

    /// Applies an effect, whole or not at all: deletions first; many bodies on several threads. The only door through which state changes.
    /// O(bodies named), each in its neighbourhood.
    /// # Errors
    /// [`Inconsistent`] when the effect does not fit; then nothing has changed.
    pub fn apply(&mut self, effect: &Effect) -> Result<(), Inconsistent> {
        self.check(effect)?;
        let empties = self.len() == effect.deleted.len() as u64;
        self.replace(effect, empties);
        Ok(())
    }

    /// Inserts bodies one after the other, whole or not at all, and says what the totals are after each. Many of them go on several
    /// threads: the answers are the same. O(bodies named), each in its neighbourhood.
    /// # Errors
    /// [`Inconsistent`] when an id is not free; then nothing has changed.
    pub fn insert_each(
        &mut self,
        bodies: Vec<(SolidId, Body)>,
    ) -> Result<Vec<Totals>, Inconsistent> {
        let effect = Effect {
            deleted: Vec::new(),
            inserted: bodies,
        };
        self.check(&effect)?;
        let mut after = Vec::with_capacity(effect.inserted.len());
        if self.is_batch(&effect.inserted) {
            let mut totals = self.totals();
            self.insert_batch(&effect.inserted, |body, change| {
                totals = totals.with(&body.bounds(), &change.union, &change.rest);
                after.push(totals);
            });
        } else {
            for (id, body) in &effect.inserted {
                self.insert(*id, body);
                after.push(self.totals());
            }
        }
        Ok(after)
    }

    /// The same of moves of one or several bodies each, with their areas of contact: for moves of several convex parts that takes two to three times as
    /// long.
    /// # Errors
    /// [`Inconsistent`] when an id is not free; then nothing has changed.
    pub fn insert_moves(
        &mut self,
        moves: Vec<Vec<(SolidId, Body)>>,
    ) -> Result<Vec<Added>, Inconsistent> {
        let counts: Vec<usize> = moves.iter().map(Vec::len).collect();
        let effect = Effect {
            deleted: Vec::new(),
            inserted: moves.into_iter().flatten().collect(),
        };
        self.check(&effect)?;
        let mut added = Vec::with_capacity(counts.len());
        self.insert_batch_of_moves(&effect.inserted, &counts, |one| added.push(one));
        Ok(added)
    }

    /// Whether so many bodies are worth several threads.
    fn is_batch(&self, bodies: &[(SolidId, Body)]) -> bool {
        self.threads > 1 && bodies.len() >= batch::BATCH_MIN
    }

    /// Applies an effect that fits; `empties` when between its deletions and its insertions there is no body.
    fn replace(&mut self, effect: &Effect, empties: bool) {
        if self.is_batch(&effect.deleted) {
            self.delete_batch(&effect.deleted);
        } else {
            for (id, _) in &effect.deleted {
                self.delete(*id);
            }
        }
        if empties {
            // All measures are those of nothing again, to the last unit.
            self.worker.kernel.forget_flags();
        }
        if self.is_batch(&effect.inserted) {
            self.insert_batch(&effect.inserted, |_, _| ());
        } else {
            for (id, body) in &effect.inserted {
                self.insert(*id, body);
            }
        }
    }

    /// Whether an effect fits.
    fn check(&self, effect: &Effect) -> Result<(), Inconsistent> {
        let mut ids: BTreeMap<SolidId, bool> = BTreeMap::new();
        for (id, body) in &effect.deleted {
            if self.get(*id) != Some(body) || ids.insert(*id, false).is_some() {
                return Err(Inconsistent { id: *id });
            }
        }
        for (id, _) in &effect.inserted {
            // An id that comes is absent, or goes first, and comes once.
            let is_free = match ids.insert(*id, true) {
                None => self.get(*id).is_none(),
                Some(came_before) => !came_before,
            };
            if !is_free {
                return Err(Inconsistent { id: *id });
            }
        }
        let inserted = effect.inserted.len() as u64;
        match effect.inserted.last() {
            Some((id, _)) if self.len() + inserted > SOLIDS_MAX + effect.deleted.len() as u64 => {
                Err(Inconsistent { id: *id })
            }
            _ => Ok(()),
        }
    }

    fn insert(&mut self, id: SolidId, body: &Body) {
        let key = cursor(id);
        let mut slots = SmallVec::new();
        for index in 0..body.len() {
            self.extents.insert(body.part_bounds(index));
            let piece = prepare(body, index, self.stock.as_ref(), self.arithmetic).map(Arc::new);
            let index = u32::try_from(index).expect("a body has few parts");
            let part = Part { body: key, index };
            slots.push(self.slots.insert(part, piece));
        }
        let entry = Entry {
            id,
            body: body.clone(),
            slots: slots.clone(),
        };
        self.bodies.insert(key, entry);
        for slot in slots {
            if self.slots.kept(slot).is_some() {
                self.place(slot);
            }
        }
        self.slots.tidy();
    }

    fn delete(&mut self, id: SolidId) {
        let Entry { body, slots, .. } = &self.bodies[&cursor(id)];
        let (body, slots) = (body.clone(), slots.clone());
        for (index, slot) in slots.into_iter().enumerate() {
            self.extents.remove(body.part_bounds(index));
            self.displace(slot);
            self.slots.remove(slot);
        }
        // Until now it may have been needed to prepare its parts.
        self.bodies.remove(&cursor(id));
        self.slots.tidy();
    }

    /// The prepared piece of a slot.
    fn piece(&mut self, slot: u32) -> Arc<Piece> {
        if let Some(piece) = self.slots.kept(slot) {
            let piece = Arc::clone(piece);
            return self.slots.piece(slot, |_| piece);
        }
        let piece = Arc::new(self.prepare_part(self.slots.part(slot)));
        self.slots.piece(slot, |_| piece)
    }

    /// Prepares a part that is not outside of the stock.
    fn prepare_part(&self, part: Part) -> Piece {
        let index = usize::try_from(part.index).expect("a body has few parts");
        let body = &self.bodies[&part.body].body;
        prepare(body, index, self.stock.as_ref(), self.arithmetic).expect("it was not outside")
    }

    /// The exposed parts whose boxes meet that of a piece, nearest first.
    fn near(&self, piece: &Piece, except: u32) -> Vec<u32> {
        self.exposed.nearest(&piece.bounds(), except)
    }

    /// The exposed parts that may touch a piece, nearest first.
    fn gather(&mut self, piece: &Piece, except: u32) -> Vec<Neighbour> {
        let around = self.near(piece, except);
        let mut neighbours = Vec::with_capacity(around.len());
        for slot in around {
            let other = self.piece(slot);
            if !piece.is_apart(&other) {
                neighbours.push(Neighbour { slot, piece: other });
            }
        }
        neighbours
    }

    /// Puts a part that is in no bin among the exposed or the covered ones, and adds what it adds.
    fn place(&mut self, slot: u32) {
        let piece = self.piece(slot);
        let neighbours = self.gather(&piece, slot);
        let own = Placed {
            piece: &piece,
            slot,
        };
        let mut features = Features::live(piece.edges.len(), piece.faces.len());
        let others = neighbours.iter().map(Neighbour::placed);
        self.worker.testify_all(own, &mut features, others);
        let marginal = self.marginal(own, &features, &neighbours);
        if marginal.change.is_none() {
            let alone = neighbours
                .iter()
                .find(|other| other.piece.holds(&piece, self.arithmetic));
            self.slots
                .set_state(slot, State::Covered(alone.map(|other| other.slot)));
            self.covered.insert(slot, piece.bounds());
            return;
        }
        self.measures.add(&marginal.books.union);
        self.rest.add(&marginal.books.rest);
        for other in &neighbours {
            let mut features = std::mem::take(self.slots.features_mut(other.slot));
            self.worker.testify(other.placed(), &mut features, own);
            *self.slots.features_mut(other.slot) = features;
        }
        self.slots.set_state(slot, State::Exposed(features));
        self.exposed.insert(slot, piece.bounds());
    }

    /// Takes a part out of its bin, retracts what it adds, and exposes covered parts that are bare without it.
    fn displace(&mut self, slot: u32) {
        if matches!(self.slots.state(slot), State::Outside) {
            return;
        }
        let piece = &self.piece(slot);
        let bounds = piece.bounds();
        if matches!(self.slots.state(slot), State::Covered(_)) {
            assert!(
                self.covered.remove(slot, bounds),
                "a part is in one of the bins"
            );
            return;
        }
        assert!(
            self.exposed.remove(slot, bounds),
            "a part is in one of the bins"
        );
        let neighbours = self.gather(piece, slot);
        for (index, other) in neighbours.iter().enumerate() {
            self.replace_witness(index, other, &neighbours, slot);
        }
        let features = std::mem::take(self.slots.features_mut(slot));
        let own = Placed { piece, slot };
        let marginal = self.marginal(own, &features, &neighbours);
        self.measures.retract(&marginal.books.union);
        self.rest.retract(&marginal.books.rest);
        self.expose(slot, &bounds, marginal.change);
    }

    /// Finds other witnesses for what a part stood witness for, of one of its neighbours.
    fn replace_witness(
        &mut self,
        index: usize,
        of: &Neighbour,
        neighbours: &[Neighbour],
        slot: u32,
    ) {
        let mut features = std::mem::take(self.slots.features_mut(of.slot));
        if self.worker.lose(&mut features, [slot]) {
            let others = neighbours.iter().enumerate();
            for (_, other) in others.filter(|(at, _)| *at != index) {
                let (own, other) = (of.placed(), other.placed());
                if !self.worker.testify_again(own, &mut features, other) {
                    break;
                }
            }
        }
        *self.slots.features_mut(of.slot) = features;
    }

    /// Makes exposed those covered parts that an exposed one, which is gone, helped to cover: where the union is another one without it.
    fn expose(&mut self, gone: u32, bounds: &Bounds, change: Option<Room>) {
        let (mut bare, mut unheld) = (Vec::new(), Vec::new());
        let slots = &self.slots;
        self.covered.visit(bounds, |slot, other| {
            let holder = match slots.state(slot) {
                State::Covered(holder) => *holder,
                _ => unreachable!("it is in the bins of the covered ones"),
            };
            let is_held = holder.is_some_and(|holder| holder != gone);
            if !is_held && change.is_some_and(|change| change.meets(&Room::of(other))) {
                bare.push((slot, *other));
            } else if holder == Some(gone) {
                unheld.push(slot);
            }
        });
        for slot in unheld {
            self.slots.set_state(slot, State::Covered(None));
        }
        bare.sort_unstable_by_key(|(slot, _)| *slot);
        for (slot, bounds) in bare {
            assert!(
                self.covered.remove(slot, bounds),
                "a covered part is in its bin"
            );
            self.place(slot);
        }
    }

    /// What a piece adds to the union of its neighbours.
    fn marginal(
        &mut self,
        own: Placed,
        features: &Features,
        neighbours: &[Neighbour],
    ) -> marginal::Marginal {
        let mut members = Vec::with_capacity(neighbours.len() + 1);
        members.push(Member {
            piece: own.piece,
            features,
            slot: own.slot,
        });
        members.extend(neighbours.iter().map(|other| Member {
            piece: &other.piece,
            features: self.slots.features(other.slot),
            slot: other.slot,
        }));
        self.worker.marginal(&members)
    }
}

/// A part of a body, as far as it lies in the stock; none when nothing of it does.
fn prepare(
    body: &Body,
    part: usize,
    stock: Option<&Stock>,
    arithmetic: Arithmetic,
) -> Option<Piece> {
    let solid = body.part(part);
    match stock {
        Some(stock) => stock.cut(&solid, arithmetic),
        None => Some(Piece::of(&solid)),
    }
}

/// Where a body stands in the listing.
fn cursor(id: SolidId) -> Cursor {
    Cursor::of(CubeId(id.0))
}
