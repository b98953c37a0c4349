//! Many bodies at once, on several threads: the same totals.
//!
//! What a set of parts adds is the sum of what each adds to those before it, in any order of ranks. So a slice of the batch is put among
//! the exposed parts as a whole, and every *fresh* part is then evaluated against the settled ones and the fresh ones of lower
//! rank, by whichever thread is free:
//!
//! ```text
//!   gather      for each fresh part, what touches it
//!   witnesses   for each fresh part and each settled one beside some: who dominates its features, the lowest rank first
//!   marginals   for each fresh part: what it adds to those before it
//! ```
//! A witness counts only where it is there: a feature is live for the fresh part of rank `r` when its witness is a fresh one
//! of rank `r` or above. So one look for witnesses serves all ranks.
//!
//! Parts that add nothing become covered after their slice. That leaves the union as it is: each is covered by parts before it, those of them that
//! go too are covered by parts before them, and so on. Deletions are the same backwards: the parts that go are the fresh ones, evaluated
//! as if they had come last.

use std::ops::Range;
use std::sync::Arc;

use rustc_hash::{FxHashMap, FxHashSet};

use super::super::parallel::map_in_parallel;
use super::certify::Room;
use super::features::Features;
use super::ledger::Books;
use super::lines::Member;
use super::measures::Measures;
use super::piece::Piece;
use super::slots::{Part, State};
use super::witnesses::Placed;
use super::worker::Worker;
use super::{Added, Body, Engine, Entry, Neighbour, SolidId, cursor, prepare};

/// From so many bodies on, waking other threads pays: some milliseconds of work.
pub(super) const BATCH_MIN: usize = 16;

/// Bodies whose parts are put among the exposed ones at once: it bounds the memory for what is prepared.
const SLICE: usize = 1024;

/// Parts that a thread takes at a time: those of a path come one after the other, and look at the same neighbours.
const PARTS_AT_ONCE: usize = 8;

/// Fresh parts, by rank, and what is around them.
pub(super) struct Batch {
    pub(super) fresh: Vec<Fresh>,
    ranks: FxHashMap<u32, usize>,
    /// Settled parts that touch a fresh one.
    beside: Vec<Beside>,
}

pub(super) struct Fresh {
    slot: u32,
    pub(super) piece: Arc<Piece>,
    /// What touches it, nearest first.
    pub(super) around: Vec<Neighbour>,
}

struct Beside {
    slot: u32,
    piece: Arc<Piece>,
    /// Ranks of the fresh parts that touch it, the lowest first.
    ranks: Vec<usize>,
}

/// What a fresh part changes, and what it has of the contact of its move.
struct Settled {
    books: Books,
    contact2: Option<i128>,
}

/// What evaluating a fresh part found.
pub(super) struct Found {
    pub(super) books: Books,
    pub(super) change: Option<Room>,
    /// A part that covers it alone, when nothing changes.
    holder: Option<u32>,
}

impl Batch {
    pub(super) fn rank(&self, slot: u32) -> Option<usize> {
        self.ranks.get(&slot).copied()
    }

    /// How many parts have features to look at: the fresh ones, then those beside them.
    fn targets(&self) -> usize {
        self.fresh.len() + self.beside.len()
    }

    fn target(&self, index: usize) -> Placed<'_> {
        let (slot, piece) = if let Some(fresh) = self.fresh.get(index) {
            (fresh.slot, &fresh.piece)
        } else {
            let beside = &self.beside[index - self.fresh.len()];
            (beside.slot, &beside.piece)
        };
        Placed { piece, slot }
    }

    fn placed(&self, rank: usize) -> Placed<'_> {
        self.target(rank)
    }

    /// The fresh parts from a rank on that touch a target, the lowest first.
    fn ranks_around(&self, target: usize, from: usize) -> Vec<usize> {
        let mut ranks = match self.fresh.get(target) {
            Some(fresh) => {
                let ranks = fresh.around.iter();
                ranks.filter_map(|other| self.rank(other.slot)).collect()
            }
            None => self.beside[target - self.fresh.len()].ranks.clone(),
        };
        ranks.retain(|rank| *rank >= from);
        ranks.sort_unstable();
        ranks
    }
}

impl Engine {
    /// Inserts bodies whose ids are free; what each changes, after those before it, is told in their order.
    pub(super) fn insert_batch(
        &mut self,
        bodies: &[(SolidId, Body)],
        mut each: impl FnMut(&Body, Books),
    ) {
        for slice in bodies.chunks(SLICE) {
            let (owners, slots): (Vec<usize>, Vec<u32>) = self.enter(slice).into_iter().unzip();
            let mut changes = vec![Books::default(); slice.len()];
            for (owner, part) in owners.into_iter().zip(self.settle(&slots, &[])) {
                changes[owner].add(&part.books);
            }
            for ((_, body), change) in slice.iter().zip(changes) {
                each(body, change);
            }
            self.slots.tidy();
        }
    }

    /// Inserts moves of so many bodies each, whose ids are free; what each move adds to those before it is told in their order.
    pub(super) fn insert_batch_of_moves(
        &mut self,
        bodies: &[(SolidId, Body)],
        counts: &[usize],
        mut each: impl FnMut(Added),
    ) {
        let (mut bodies, mut counts) = (bodies, counts);
        while let Some(&first) = counts.first() {
            let mut slice = 0;
            let fits = |count: &&usize| {
                slice += **count;
                slice <= SLICE
            };
            let moves = counts.iter().take_while(fits).count();
            if moves == 0 {
                let before = self.measures;
                self.insert_batch(&bodies[..first], |_, _| ());
                let mut measures = self.measures;
                measures.retract(&before);
                each(Added {
                    measures,
                    contact2: None,
                });
                (bodies, counts) = (&bodies[first..], &counts[1..]);
                continue;
            }
            let (of_moves, others) = counts.split_at(moves);
            let (slice, rest) = bodies.split_at(of_moves.iter().sum());
            self.insert_slice(slice, of_moves)
                .into_iter()
                .for_each(&mut each);
            (bodies, counts) = (rest, others);
        }
    }

    /// Inserts moves that are not too many bodies together.
    fn insert_slice(&mut self, bodies: &[(SolidId, Body)], counts: &[usize]) -> Vec<Added> {
        let owners = (0..counts.len()).flat_map(|owner| std::iter::repeat_n(owner, counts[owner]));
        let owners: Vec<usize> = owners.collect();
        let (owners, slots): (Vec<usize>, Vec<u32>) = self
            .enter(bodies)
            .into_iter()
            .map(|(body, slot)| (owners[body], slot))
            .unzip();
        let of_move = owners.chunk_by(|one, other| one == other);
        let mut from = 0;
        let moves = of_move.flat_map(|owners| {
            let ranks = from..from + owners.len();
            from = ranks.end;
            std::iter::repeat_n(ranks, owners.len())
        });
        let moves: Vec<Range<usize>> = moves.collect();
        let nothing = Added {
            measures: Measures::default(),
            contact2: Some(0),
        };
        let mut added = vec![nothing; counts.len()];
        for (owner, part) in owners.into_iter().zip(self.settle(&slots, &moves)) {
            let added = &mut added[owner];
            added.measures.add(&part.books.union);
            added.contact2 = added
                .contact2
                .zip(part.contact2)
                .map(|(one, other)| one + other);
        }
        self.slots.tidy();
        added
    }

    /// Enters bodies, and puts their parts that have something in common with the stock among the exposed ones, as they are. For each of
    /// these parts: which body it is of, and its slot.
    fn enter(&mut self, bodies: &[(SolidId, Body)]) -> Vec<(usize, u32)> {
        let parts: Vec<(usize, usize)> = (0..)
            .zip(bodies)
            .flat_map(|(number, (_, body))| (0..body.len()).map(move |part| (number, part)))
            .collect();
        let pieces = self.in_parallel(parts.len(), |engine, worker, index| {
            let (number, part) = parts[index];
            let (_, body) = &bodies[number];
            prepare(body, part, engine.stock.as_ref(), worker.arithmetic).map(Arc::new)
        });
        let mut slots = Vec::with_capacity(parts.len());
        let mut pieces = pieces.into_iter();
        for (owner, (id, body)) in bodies.iter().enumerate() {
            let mut entry = Entry {
                id: *id,
                body: body.clone(),
                slots: smallvec::SmallVec::new(),
            };
            for index in 0..body.len() {
                self.extents.insert(body.part_bounds(index));
                let piece = pieces.next().expect("there is one for each part");
                let bounds = piece.as_ref().map(|piece| piece.bounds());
                let index = u32::try_from(index).expect("a body has few parts");
                let body = cursor(*id);
                let slot = self.slots.insert(Part { body, index }, piece);
                entry.slots.push(slot);
                if let Some(bounds) = bounds {
                    self.exposed.insert(slot, bounds);
                    slots.push((owner, slot));
                }
            }
            self.bodies.insert(cursor(*id), entry);
        }
        slots
    }

    /// Evaluates parts that are among the exposed ones as they are, in this order; adds what they add, and puts those that add nothing among
    /// the covered ones. Returns what each changes, after those before it; of contact, where the ranks of the move of each are given, its part of
    /// that of its move.
    fn settle(&mut self, slots: &[u32], moves: &[Range<usize>]) -> Vec<Settled> {
        for &slot in slots {
            self.slots
                .set_state(slot, State::Exposed(Features::default()));
        }
        let batch = self.gather_all(slots);
        let features = self.in_parallel(batch.targets(), |engine, worker, target| {
            engine.witnesses_of(&batch, worker, target)
        });
        self.keep_features(&batch, features);
        let says_contact = !moves.is_empty();
        let found = self.in_parallel(batch.fresh.len(), |engine, worker, rank| {
            engine.evaluate(&batch, worker, rank, says_contact)
        });
        let contacts = self.in_parallel(moves.len(), |engine, worker, rank| {
            engine.contact(&batch, worker, (rank, &found[rank]), &moves[rank])
        });
        let is_idle = |rank: usize| found[rank].change.is_none();
        let idle: FxHashSet<u32> = (0..found.len())
            .filter(|rank| is_idle(*rank))
            .map(|rank| batch.fresh[rank].slot)
            .collect();
        if !idle.is_empty() {
            // Nobody covered is a witness.
            let features = self.in_parallel(batch.targets(), |engine, worker, target| {
                engine.witnesses_without(&batch, worker, target, &idle)
            });
            self.keep_features(&batch, features);
        }
        for (fresh, found) in batch.fresh.iter().zip(&found) {
            self.measures.add(&found.books.union);
            self.rest.add(&found.books.rest);
            if found.change.is_none() {
                let bounds = fresh.piece.bounds();
                let was_there = self.exposed.remove(fresh.slot, bounds);
                assert!(was_there, "it was put there for the batch");
                self.covered.insert(fresh.slot, bounds);
                let holder = found.holder.filter(|holder| !idle.contains(holder));
                self.slots.set_state(fresh.slot, State::Covered(holder));
            }
        }
        let settled = found.iter().enumerate().map(|(rank, found)| Settled {
            books: found.books,
            contact2: contacts.get(rank).copied(),
        });
        settled.collect()
    }

    /// Deletes bodies that are there.
    pub(super) fn delete_batch(&mut self, bodies: &[(SolidId, Body)]) {
        for slice in bodies.chunks(SLICE) {
            let (mut all, mut going) = (Vec::new(), Vec::new());
            for (id, body) in slice {
                let slots = self.bodies[&cursor(*id)].slots.clone();
                for (index, slot) in slots.into_iter().enumerate() {
                    self.extents.remove(body.part_bounds(index));
                    all.push(slot);
                    match self.slots.state(slot) {
                        State::Outside => {}
                        State::Exposed(_) => going.push(slot),
                        State::Covered(_) => {
                            let bounds = self.piece(slot).bounds();
                            let was_there = self.covered.remove(slot, bounds);
                            assert!(was_there, "a part is in one of the bins");
                        }
                    }
                }
            }
            let bare = self.retract(&going);
            for slot in all {
                self.slots.remove(slot);
            }
            for (id, _) in slice {
                self.bodies.remove(&cursor(*id));
            }
            for &slot in &bare {
                let bounds = self.piece(slot).bounds();
                let was_there = self.covered.remove(slot, bounds);
                assert!(was_there, "a covered part is in its bin");
                self.exposed.insert(slot, bounds);
            }
            self.settle(&bare, &[]);
            self.slots.tidy();
        }
    }

    /// Takes exposed parts out of their bins and retracts what they add. Returns the covered parts that may be bare without them.
    fn retract(&mut self, going: &[u32]) -> Vec<u32> {
        let batch = self.gather_all(going);
        let features = self.in_parallel(batch.targets(), |engine, worker, target| {
            engine.witnesses_before(&batch, worker, target)
        });
        self.keep_features(&batch, features);
        let found = self.in_parallel(batch.fresh.len(), |engine, worker, rank| {
            engine.evaluate(&batch, worker, rank, false)
        });
        for (gone, found) in batch.fresh.iter().zip(&found) {
            self.measures.retract(&found.books.union);
            self.rest.retract(&found.books.rest);
            let was_there = self.exposed.remove(gone.slot, gone.piece.bounds());
            assert!(was_there, "a part is in one of the bins");
        }
        for beside in &batch.beside {
            let features = self.slots.features_mut(beside.slot);
            let gone = beside.ranks.iter().map(|rank| batch.fresh[*rank].slot);
            self.worker.lose(features, gone);
        }
        let (mut bare, mut unheld) = (FxHashSet::default(), Vec::new());
        for (gone, found) in batch.fresh.iter().zip(&found) {
            self.covered.visit(&gone.piece.bounds(), |slot, other| {
                let State::Covered(holder) = self.slots.state(slot) else {
                    unreachable!("it is in the bins of the covered ones");
                };
                let is_held = holder.is_some_and(|holder| batch.rank(holder).is_none());
                let room = Room::of(other);
                if !is_held && found.change.is_some_and(|change| change.meets(&room)) {
                    bare.insert(slot);
                } else if *holder == Some(gone.slot) {
                    unheld.push(slot);
                }
            });
        }
        for slot in unheld {
            self.slots.set_state(slot, State::Covered(None));
        }
        let mut bare: Vec<u32> = bare.into_iter().collect();
        bare.sort_unstable();
        bare
    }

    /// What is around exposed parts, whose ranks are their places in the list.
    fn gather_all(&mut self, slots: &[u32]) -> Batch {
        let mut fresh: Vec<Fresh> = Vec::with_capacity(slots.len());
        for &slot in slots {
            let piece = self.piece(slot);
            let around = Vec::new();
            fresh.push(Fresh {
                slot,
                piece,
                around,
            });
        }
        let near = self.in_parallel(fresh.len(), |engine, _, rank| {
            engine.near(&fresh[rank].piece, fresh[rank].slot)
        });
        let mut missing: Vec<u32> = near
            .iter()
            .flatten()
            .copied()
            .filter(|slot| self.slots.kept(*slot).is_none())
            .collect();
        missing.sort_unstable();
        missing.dedup();
        let pieces = self.in_parallel(missing.len(), |engine, _, index| {
            engine.prepared(missing[index])
        });
        for (slot, piece) in missing.into_iter().zip(pieces) {
            self.slots.piece(slot, |_| piece);
        }
        let around = self.in_parallel(fresh.len(), |engine, _, rank| {
            let touching = near[rank].iter().filter_map(|&slot| {
                let piece = engine.prepared(slot);
                let touches = !fresh[rank].piece.is_apart(&piece);
                touches.then_some(Neighbour { slot, piece })
            });
            touching.collect::<Vec<_>>()
        });
        let ranks: FxHashMap<u32, usize> = slots.iter().copied().zip(0..).collect();
        let mut places: FxHashMap<u32, usize> = FxHashMap::default();
        let mut beside: Vec<Beside> = Vec::new();
        for (rank, (fresh, around)) in fresh.iter_mut().zip(around).enumerate() {
            for other in around
                .iter()
                .filter(|other| !ranks.contains_key(&other.slot))
            {
                let place = *places.entry(other.slot).or_insert_with(|| {
                    beside.push(Beside {
                        slot: other.slot,
                        piece: Arc::clone(&other.piece),
                        ranks: Vec::new(),
                    });
                    beside.len() - 1
                });
                beside[place].ranks.push(rank);
            }
            fresh.around = around;
        }
        for beside in &beside {
            // It was asked for.
            self.piece(beside.slot);
        }
        Batch {
            fresh,
            ranks,
            beside,
        }
    }

    /// The features of a target when fresh parts have come: first those before it, then the others, the lowest rank first.
    fn witnesses_of(&self, batch: &Batch, worker: &mut Worker, target: usize) -> Features {
        let own = batch.target(target);
        let Some(fresh) = batch.fresh.get(target) else {
            let mut features = self.slots.features(own.slot).clone();
            for rank in batch.ranks_around(target, 0) {
                worker.testify(own, &mut features, batch.placed(rank));
            }
            return features;
        };
        let mut features = Features::live(own.piece.edges.len(), own.piece.faces.len());
        let is_before =
            |other: &&Neighbour| batch.rank(other.slot).is_none_or(|rank| rank < target);
        let before = fresh.around.iter().filter(is_before).map(Neighbour::placed);
        let after = batch.ranks_around(target, target).into_iter();
        let others = before.chain(after.map(|rank| batch.placed(rank)));
        worker.testify_all(own, &mut features, others);
        features
    }

    /// The features of a target without some fresh parts as witnesses.
    fn witnesses_without(
        &self,
        batch: &Batch,
        worker: &mut Worker,
        target: usize,
        without: &FxHashSet<u32>,
    ) -> Features {
        let own = batch.target(target);
        let mut features = self.slots.features(own.slot).clone();
        let lost: Vec<u32> = features
            .witnesses()
            .filter(|slot| without.contains(slot))
            .collect();
        if !worker.lose(&mut features, lost) {
            return features;
        }
        // Of a settled part the settled ones were asked before.
        let others: Vec<Placed> = if let Some(fresh) = batch.fresh.get(target) {
            fresh.around.iter().map(Neighbour::placed).collect()
        } else {
            let ranks = batch.ranks_around(target, 0).into_iter();
            ranks.map(|rank| batch.placed(rank)).collect()
        };
        for other in others {
            if !without.contains(&other.slot) && !worker.testify_again(own, &mut features, other) {
                break;
            }
        }
        features
    }

    /// The features of a target when fresh parts are to go: witnesses that stay, and where there are none, those of the lowest rank.
    fn witnesses_before(&self, batch: &Batch, worker: &mut Worker, target: usize) -> Features {
        let own = batch.target(target);
        let mut features = self.slots.features(own.slot).clone();
        let going = |features: &Features| -> Vec<usize> {
            let ranks = features.witnesses().filter_map(|slot| batch.rank(slot));
            ranks.collect()
        };
        let mut open = Vec::new();
        for rank in going(&features) {
            let Fresh { slot, around, .. } = &batch.fresh[rank];
            worker.lose(&mut features, [*slot]);
            // What dominates a feature in the part that goes touches that part.
            let others = around
                .iter()
                .filter(|other| batch.rank(other.slot).is_none());
            for other in others.filter(|other| other.slot != own.slot) {
                if !worker.testify_again(own, &mut features, other.placed()) {
                    break;
                }
            }
            open.push(worker.take_lost());
        }
        worker.set_lost(open);
        for rank in batch.ranks_around(target, 0) {
            if !worker.testify_again(own, &mut features, batch.placed(rank)) {
                break;
            }
        }
        features
    }

    /// What a fresh part adds to the settled ones and the fresh ones of lower rank.
    fn evaluate(
        &self,
        batch: &Batch,
        worker: &mut Worker,
        rank: usize,
        says_contact: bool,
    ) -> Found {
        let fresh = &batch.fresh[rank];
        let is_before = |slot: u32| batch.rank(slot).is_none_or(|other| other < rank);
        let marginal = self.among(batch, rank, is_before, |members| {
            if says_contact {
                worker.kernel.marginal_with_contact(members)
            } else {
                worker.kernel.marginal(members)
            }
        });
        let holder = || {
            let before = fresh.around.iter().filter(|other| is_before(other.slot));
            let mut holders =
                before.filter(|other| other.piece.holds(&fresh.piece, worker.arithmetic));
            holders.next().map(|other| other.slot)
        };
        Found {
            books: marginal.books,
            change: marginal.change,
            holder: marginal.change.is_none().then(holder).flatten(),
        }
    }

    /// Does something with a fresh part and those around it that count, its features and theirs being live where no other that counts
    /// dominates them.
    pub(super) fn among<T>(
        &self,
        batch: &Batch,
        rank: usize,
        counts: impl Fn(u32) -> bool,
        task: impl FnOnce(&[Member]) -> T,
    ) -> T {
        let others = batch.fresh[rank].around.iter();
        let others = others.filter(|other| counts(other.slot));
        let placed: Vec<Placed> = std::iter::once(batch.placed(rank))
            .chain(others.map(Neighbour::placed))
            .collect();
        let features = placed.iter().map(|one| {
            let features = self.slots.features(one.slot);
            (features, features.without_witnesses(|slot| !counts(slot)))
        });
        let features: Vec<(&Features, Option<Features>)> = features.collect();
        let members: Vec<Member> = placed
            .iter()
            .zip(&features)
            .map(|(one, (all, some))| Member {
                piece: one.piece,
                features: some.as_ref().unwrap_or(all),
                slot: one.slot,
            })
            .collect();
        task(&members)
    }

    fn keep_features(&mut self, batch: &Batch, features: Vec<Features>) {
        for (target, features) in features.into_iter().enumerate() {
            *self.slots.features_mut(batch.target(target).slot) = features;
        }
    }

    /// Runs a task for each of so many parts, on several threads.
    fn in_parallel<T: Send>(
        &mut self,
        count: usize,
        task: impl Fn(&Self, &mut Worker, usize) -> T + Sync,
    ) -> Vec<T> {
        let mut helpers = std::mem::take(&mut self.helpers);
        while helpers.len() < self.threads {
            let stock = self.stock.as_ref().map(|stock| Arc::clone(stock.piece()));
            helpers.push(Worker::new(self.arithmetic, stock));
        }
        let results = map_in_parallel(&mut helpers, count, PARTS_AT_ONCE, |worker, index| {
            task(self, worker, index)
        });
        for helper in &mut helpers {
            self.worker.kernel.take_flags(&mut helper.kernel);
        }
        self.helpers = helpers;
        results
    }
}
