//! Changes of a group that only insert, accepted and not yet applied: put in together they take less time than one by one, on
//! several threads, and each still gets the totals after it.
//!
//! ```text
//!   queue    + │ + │ + │ - │ + │ +
//!   applied  └───────┘   │   └───┘      what deletes, moves, or names an id that waits, comes after those before it
//! ```

use std::collections::HashSet;

use super::judge::Accepted;
use super::kind::SceneKind;
use super::next_id::NextId;
use super::{Key, Motion, Operations, Submission};
use crate::engine::Op;
use crate::geometry::CubeId;

/// An accepted change that waits.
pub(super) struct Waiting<K: SceneKind> {
    pub(super) accepted: Accepted<K>,
    pub(super) motion: Motion,
    pub(super) key: Option<Key>,
}

/// Accepted changes that wait, in their order.
pub(super) struct Together<K: SceneKind> {
    changes: Vec<Waiting<K>>,
    /// What they insert.
    ids: HashSet<CubeId>,
}

impl<K: SceneKind> Default for Together<K> {
    fn default() -> Self {
        Self {
            changes: Vec::new(),
            ids: HashSet::new(),
        }
    }
}

impl<K: SceneKind> Together<K> {
    /// Whether a change can be judged against a set without the bodies that wait, and join them if it inserts: it names none of them, nor
    /// one of their keys, and so many bodies may wait.
    pub(super) fn admits(
        &self,
        submission: &Submission<K>,
        bodies_max: usize,
        next_id: NextId,
    ) -> bool {
        let room = bodies_max.saturating_sub(self.ids.len());
        let joins = match &submission.operations {
            Operations::Named(ops) => {
                let joins =
                    |op: &Op<K::Body>| matches!(op, Op::Insert(id, _) if !self.ids.contains(id));
                ops.len() <= room && ops.iter().all(joins)
            }
            Operations::Numbered { delete, insert } => {
                // Where it must be looked which ids are free, those that wait are not seen.
                let numbers = next_id.is_past_all() || self.ids.is_empty();
                numbers && insert.len() <= room && delete.is_empty()
            }
            Operations::Revert(_) | Operations::Define(_) | Operations::DryRun(_) => false,
        };
        let has_met = |(key, _): &Key| {
            let mut keys = self.changes.iter().filter_map(|change| change.key.as_ref());
            keys.any(|(other, _)| other == key)
        };
        joins && !submission.key.as_ref().is_some_and(has_met)
    }

    /// Lets an admitted change wait.
    pub(super) fn join(&mut self, change: Waiting<K>) {
        let inserted = &change.accepted.effect.inserted;
        self.ids.extend(inserted.iter().map(|(id, _)| *id));
        self.changes.push(change);
    }

    /// Takes all that wait.
    pub(super) fn take(&mut self) -> Vec<Waiting<K>> {
        self.ids.clear();
        std::mem::take(&mut self.changes)
    }
}
