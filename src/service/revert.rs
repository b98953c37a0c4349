//! Reverting: the effect that makes the set of cubes what it was at an earlier seq, or at a later one that was reverted.

use std::collections::HashMap;

use super::judge::Unfit;
use super::{CHANGE_OPERATIONS_MAX, Seq, ServiceError};
use crate::engine::Engine;
use crate::geometry::{CubeId, Effect, Place};
use crate::log::{SceneLog, Step};

/// The changes that tell the states at `to` and at `newest`, which is the engine's, apart undone and redone, and only their net effect kept.
pub(super) fn effect(
    engine: &Engine,
    log: &SceneLog,
    newest: Seq,
    to: Seq,
) -> Result<Effect, Unfit> {
    let oldest = log.oldest_reachable();
    if to > newest {
        return Err(ServiceError::SeqNotReached { seq: to, newest }.into());
    }
    if to < oldest {
        return Err(ServiceError::NotReachable { seq: to, oldest }.into());
    }
    // Where each cube on the way was at last.
    let mut then: HashMap<CubeId, Option<Place>> = HashMap::new();
    log.way_to(to, &mut |step| {
        let (gone, come) = match step {
            Step::Undo(Effect { deleted, inserted }) => (inserted, deleted),
            Step::Redo(Effect { deleted, inserted }) => (deleted, inserted),
        };
        then.extend(gone.iter().map(|&(id, _)| (id, None)));
        then.extend(come.iter().map(|&(id, place)| (id, Some(place))));
    })
    .map_err(Unfit::Unread)?;
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
    let operations = effect.deleted.len() + effect.inserted.len();
    if operations > CHANGE_OPERATIONS_MAX {
        return Err(ServiceError::TooManyOperations { operations }.into());
    }
    Ok(effect)
}
