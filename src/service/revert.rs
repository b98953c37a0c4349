//! Reverting: the effect that makes the set of bodies what it was at an earlier seq, or at a later one that was reverted.

use std::collections::HashMap;

use super::Seq;
use super::kind::SceneKind;
use crate::geometry::{CubeId, Effect};
use crate::log::{Log, LogError, Step};

/// Where the changes of the past are.
pub(super) trait Past<K: SceneKind> {
    /// Oldest seq whose bodies can be gone back to.
    fn oldest_reachable(&self) -> Seq;

    /// Shows what leads from the newest state to that at `to`, which is reachable, in order.
    /// # Errors
    /// When the past cannot be read.
    fn way_to(&self, to: Seq, visit: &mut dyn FnMut(Step<'_, K>)) -> Result<(), LogError>;
}

impl<K: SceneKind> Past<K> for Log<K> {
    fn oldest_reachable(&self) -> Seq {
        self.oldest_reachable()
    }

    fn way_to(&self, to: Seq, visit: &mut dyn FnMut(Step<'_, K>)) -> Result<(), LogError> {
        self.way_to(to, visit)
    }
}

/// The changes that tell the states at `to` and at the engine's seq, the newest, apart undone and redone, and only their net effect
/// kept. The past still has all of them.
/// # Errors
/// The past's.
pub(super) fn effect<K: SceneKind>(
    engine: &K::Engine,
    past: &impl Past<K>,
    to: Seq,
) -> Result<Effect<K::Body>, LogError> {
    // What each body on the way was at last.
    let mut then: HashMap<CubeId, Option<K::Body>> = HashMap::new();
    past.way_to(to, &mut |step| {
        let (gone, come) = match step {
            Step::Undo(Effect { deleted, inserted }) => (inserted, deleted),
            Step::Redo(Effect { deleted, inserted }) => (deleted, inserted),
        };
        then.extend(gone.iter().map(|(id, _)| (*id, None)));
        then.extend(come.iter().map(|(id, body)| (*id, Some(body.clone()))));
    })?;
    let mut then: Vec<(CubeId, Option<K::Body>)> = then.into_iter().collect();
    then.sort_unstable_by_key(|(id, _)| *id);
    let mut effect = Effect::default();
    for (id, then) in then {
        let now = K::get(engine, id);
        if now != then {
            effect.deleted.extend(now.map(|body| (id, body)));
            effect.inserted.extend(then.map(|body| (id, body)));
        }
    }
    Ok(effect)
}
