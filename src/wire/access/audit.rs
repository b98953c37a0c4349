//! The audit log: a line for each call that changes something or was to, under the target `audit`.
//!
//! It says the name of the key, never the key. The line is written when the last who knows of the call lets go of it, so that
//! there is one whatever became of the call; also when the client went away, and nobody waited for the outcome.

use std::sync::{Arc, OnceLock};

use parking_lot::Mutex;

use super::keys::Key;
use crate::engine::Counts;
use crate::service::{Applied, Kind};

/// What a call did.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::wire) struct Effect {
    /// The scene's newest change after it.
    seq: Option<u64>,
    /// Changes of a stream that were acknowledged.
    changes: Option<u64>,
    counts: Counts,
    /// What is said of it when it went well.
    outcome: &'static str,
}

impl Default for Effect {
    fn default() -> Self {
        Self {
            seq: None,
            changes: None,
            counts: Counts::default(),
            outcome: "done",
        }
    }
}

impl Effect {
    /// Of a change that was applied, or answered once more.
    pub(in crate::wire) fn of<K: Kind>(applied: &Applied<K>) -> Self {
        Self {
            seq: Some(applied.published.seq.0),
            counts: applied.counts,
            outcome: if applied.replayed { "replayed" } else { "done" },
            ..Self::default()
        }
    }

    /// The same of one that was only asked what it would do.
    pub(in crate::wire) fn dry(self) -> Self {
        Self {
            outcome: "dry-run",
            ..self
        }
    }

    /// Adds a change of a stream.
    pub(in crate::wire) fn add<K: Kind>(&mut self, applied: &Applied<K>) {
        self.seq = Some(applied.published.seq.0);
        *self.changes.get_or_insert(0) += 1;
        self.counts.inserted += applied.counts.inserted;
        self.counts.deleted += applied.counts.deleted;
        self.counts.unchanged += applied.counts.unchanged;
    }
}

/// A call on its way to its line.
#[derive(Debug)]
pub(super) struct Entry {
    call: &'static str,
    key: Option<Arc<Key>>,
    scene: OnceLock<String>,
    end: Mutex<(Effect, Option<String>)>,
    /// With the request's id.
    span: tracing::Span,
}

impl Entry {
    pub(super) fn new(call: &'static str, key: Option<Arc<Key>>) -> Self {
        Self {
            call,
            key,
            scene: OnceLock::new(),
            end: Mutex::default(),
            span: tracing::Span::current(),
        }
    }

    pub(super) fn concerns(&self, scene: &str) {
        // A stream that is opened twice is refused.
        let _ = self.scene.set(scene.to_owned());
    }

    pub(super) fn did(&self, effect: Effect) {
        self.end.lock().0 = effect;
    }

    /// It went well, unless it has ended otherwise before.
    pub(super) fn done(&self) {
        let (effect, outcome) = &mut *self.end.lock();
        outcome.get_or_insert_with(|| effect.outcome.to_owned());
    }

    /// It failed with this, unless it has ended otherwise before.
    pub(super) fn failed(&self, why: &str) {
        self.end.lock().1.get_or_insert_with(|| why.to_owned());
    }
}

impl Drop for Entry {
    fn drop(&mut self) {
        let (effect, outcome) = self.end.get_mut();
        let Effect {
            seq,
            changes,
            counts,
            ..
        } = *effect;
        let _entered = self.span.enter();
        tracing::info!(
            target: "audit",
            key = self.key.as_ref().map(|key| key.name()),
            call = self.call,
            scene = self.scene.get().map(String::as_str),
            seq,
            changes,
            inserted = counts.inserted,
            deleted = counts.deleted,
            unchanged = counts.unchanged,
            outcome = outcome.as_deref().unwrap_or("unknown"),
        );
    }
}
