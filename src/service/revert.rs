//! Reverting: the effect that makes the set of cubes what it was at an earlier seq, or at a later one that was reverted.

use std::collections::HashMap;

use super::Seq;
use crate::engine::Engine;
use crate::geometry::{CubeId, Effect, Place};
use crate::log::{LogError, SceneLog, Step};

/// The changes that tell the states at `to` and at the engine's seq, the newest, apart undone and redone, and only their net effect
/// kept. The log still has all of them.
/// # Errors
/// The log's.
pub(super) fn effect(engine: &Engine, log: &SceneLog, to: Seq) -> Result<Effect, LogError> {
    // Where each cube on the way was at last.
    let mut then: HashMap<CubeId, Option<Place>> = HashMap::new();
    log.way_to(to, &mut |step| {
        let (gone, come) = match step {
            Step::Undo(Effect { deleted, inserted }) => (inserted, deleted),
            Step::Redo(Effect { deleted, inserted }) => (deleted, inserted),
        };
        then.extend(gone.iter().map(|&(id, _)| (id, None)));
        then.extend(come.iter().map(|&(id, place)| (id, Some(place))));
    })?;
    let mut then: Vec<(CubeId, Option<Place>)> = then.into_iter().collect();
    then.sort_unstable_by_key(|(id, _)| *id);
    let mut effect = Effect::default();
    for (id, then) in then {
        let now = engine.get(id);
        if now != then {
            effect.deleted.extend(now.map(|place| (id, place)));
            effect.inserted.extend(then.map(|place| (id, place)));
        }
    }
    Ok(effect)
}
