//! The neighbourhood of a change as an engine of its own: what the change would do, without doing it.
//!
//! What a part adds depends on the exposed parts that touch it. A deletion looks besides at the covered parts that touch the deleted one,
//! which may become exposed, and so at what touches those. Nothing else is ever looked at, so that the totals' difference is that of the excerpt.
//!
//! Slots are numbered anew in their order: of two equal features that of the lower slot counts, and witnesses rely on it.

use std::collections::BTreeSet;
use std::sync::Arc;

use rustc_hash::FxHashMap;

use super::slots::State;
use super::{Effect, Engine, ErrorMax, Inconsistent, Totals, cursor};

/// The slot of a witness, or of a part that covers another, outside of the excerpt: nobody has it, and nobody will.
const ELSEWHERE: u32 = u32::MAX - 1;

impl Engine {
    /// What the totals would be after an effect, and how far rounding could be off in them. Nothing changes, not even what is prepared. It takes as long as applying the effect, and
    /// copying what is known of the parts around it.
    /// # Errors
    /// As of [`Engine::apply`].
    pub fn dry_run(&self, effect: &Effect) -> Result<(Totals, ErrorMax), Inconsistent> {
        self.check(effect)?;
        let mut excerpt = self.excerpt(effect);
        let empties = self.len() == effect.deleted.len() as u64;
        excerpt.replace(effect, empties);
        let deleted = effect.deleted.iter().map(|(_, body)| body);
        let inserted = effect.inserted.iter().map(|(_, body)| body);
        let totals = Totals {
            solids: self.len() - effect.deleted.len() as u64 + effect.inserted.len() as u64,
            bounds: self.extents.bounds_after(
                deleted.flat_map(|body| (0..body.len()).map(|part| body.part_bounds(part))),
                inserted.flat_map(|body| (0..body.len()).map(|part| body.part_bounds(part))),
            ),
            ..excerpt.totals()
        };
        Ok((totals, excerpt.error_max()))
    }

    /// The deleted bodies, and all parts that an effect can look at.
    fn excerpt(&self, effect: &Effect) -> Self {
        let slots = self.slots_around(effect);
        let mut numbers: FxHashMap<u32, u32> = FxHashMap::default();
        numbers.extend(slots.iter().copied().zip(0..));
        let number = |slot: u32| numbers.get(&slot).copied().unwrap_or(ELSEWHERE);
        // What is prepared stays so: there are no bodies to prepare the others from.
        let mut excerpt = Self::build(self.arithmetic)
            .with_stock(self.stock.clone())
            .with_prepared(usize::MAX);
        for &slot in &slots {
            let (part, state) = (self.slots.part(slot), self.slots.state(slot));
            let piece = match state {
                State::Outside => None,
                _ => Some(self.prepared(slot)),
            };
            let bounds = piece.as_ref().map(|piece| piece.bounds());
            let copy = excerpt.slots.insert(part, piece);
            let state = match (state, bounds) {
                (State::Exposed(features), Some(bounds)) => {
                    excerpt.exposed.insert(copy, bounds);
                    State::Exposed(features.renumbered(number))
                }
                (State::Covered(holder), Some(bounds)) => {
                    excerpt.covered.insert(copy, bounds);
                    State::Covered(holder.map(number))
                }
                _ => State::Outside,
            };
            excerpt.slots.set_state(copy, state);
        }
        for (id, body) in &effect.deleted {
            for part in 0..body.len() {
                excerpt.extents.insert(body.part_bounds(part));
            }
            let entry = &self.bodies[&cursor(*id)];
            let entry = super::Entry {
                id: *id,
                body: body.clone(),
                slots: entry.slots.iter().map(|slot| number(*slot)).collect(),
            };
            excerpt.bodies.insert(cursor(*id), entry);
        }
        let kernel = &mut excerpt.worker.kernel;
        kernel.count_flags_of(&self.worker.kernel);
        excerpt.measures = self.measures;
        excerpt.rest = self.rest;
        excerpt
    }

    /// The slots of the deleted bodies and of all parts that an effect can look at, in their order.
    fn slots_around(&self, effect: &Effect) -> BTreeSet<u32> {
        let mut slots = BTreeSet::new();
        let mut uncovered = Vec::new();
        for (id, body) in &effect.deleted {
            slots.extend(&self.bodies[&cursor(*id)].slots);
            for part in 0..body.len() {
                let bounds = body.part_bounds(part);
                self.covered.visit(&bounds, |slot, other| {
                    if slots.insert(slot) {
                        uncovered.push(*other);
                    }
                });
                uncovered.push(bounds);
            }
        }
        for (_, body) in &effect.inserted {
            uncovered.extend((0..body.len()).map(|part| body.part_bounds(part)));
        }
        for bounds in &uncovered {
            self.exposed.visit(bounds, |slot, _| {
                slots.insert(slot);
            });
        }
        slots
    }

    /// The prepared piece of a slot, kept or made for this once.
    pub(super) fn prepared(&self, slot: u32) -> Arc<super::Piece> {
        match self.slots.kept(slot) {
            Some(piece) => Arc::clone(piece),
            None => Arc::new(self.prepare_part(self.slots.part(slot))),
        }
    }
}
