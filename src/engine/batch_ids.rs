//! The table of ids in a change so large that whole shards of it are made anew.
//!
//! ```text
//!   cubes ──> by shard, in their order ──> some shards at a time:   made beside what they were, on every thread (a look)
//!                                                                 put in place of what they were (a step)
//! ```
//!
//! A shard fits a processor's cache where the table does not, so that this pays on one thread too.

use crate::geometry::{CUBES_MAX, CubeId, Effect, Place};

use super::Engine;
use super::access::Access;
use super::batch::Helper;
use super::ids::{IdTable, SHARDS};
use super::parallel::in_parallel;
use super::prefetch::{AHEAD, prefetch};

/// Changes a shard, on average, from which on it pays to start threads.
const CHANGES_MIN: usize = 1024;

/// How many cubes of the table may be copied for each one that is changed.
const COPIES_MAX: usize = 4;

/// Shards that are there twice at one time.
const SHARDS_AT_ONCE: usize = 8;

/// Cubes of a change, and which of them belong to each shard, in their order: a list for each thread that put them in order.
struct ByShard<'a> {
    cubes: &'a [(CubeId, Place)],
    indices: Vec<Vec<Vec<u32>>>,
}

impl ByShard<'_> {
    fn of<'a>(cubes: &'a [(CubeId, Place)], helpers: &mut [Helper]) -> ByShard<'a> {
        let size = cubes.len().div_ceil(helpers.len()).max(1);
        let indices = in_parallel(helpers, |number, _| {
            // Shards do not fill alike: a sixteenth more is enough, nearly always.
            let room = size / SHARDS + size / SHARDS / 16;
            let mut indices: Vec<_> = (0..SHARDS).map(|_| Vec::with_capacity(room)).collect();
            for (index, (id, _)) in (0..).zip(cubes).skip(number * size).take(size) {
                indices[IdTable::shard_of(*id)].push(index);
            }
            indices
        });
        ByShard { cubes, indices }
    }

    /// The cubes of a shard.
    fn shard(&self, shard: usize) -> Vec<(CubeId, Place)> {
        let lists = || self.indices.iter().map(|indices| &indices[shard]);
        let mut cubes = Vec::with_capacity(lists().map(Vec::len).sum());
        for indices in lists() {
            for (at, index) in indices.iter().enumerate() {
                if let Some(ahead) = indices.get(at + AHEAD) {
                    prefetch(self.cubes, *ahead as usize);
                }
                cubes.push(self.cubes[*index as usize]);
            }
        }
        cubes
    }
}

impl Engine {
    /// Whether an effect is so large that [`change_ids`] pays, and certain not to bring more cubes than there may be.
    pub(super) fn changes_whole_shards(&self, effect: &Effect) -> bool {
        let changes = effect.deleted.len() + effect.inserted.len();
        let is_large = changes >= SHARDS * CHANGES_MIN && changes >= self.ids.len() / COPIES_MAX;
        is_large && (self.ids.len() + effect.inserted.len()) as u64 <= CUBES_MAX
    }
}

/// Brings the table of ids up to date with an effect; false, and nothing done, when it does not fit.
pub(super) fn change_ids(access: &impl Access, effect: &Effect) -> bool {
    let count = effect.deleted.len() + effect.inserted.len();
    let mut helpers = access.step(|engine| engine.take_helpers(count));
    let size = access.look(|engine| engine.cubes_a_thread(count));
    let helping = &mut helpers[..count.div_ceil(size)];
    let [deleted, inserted] =
        [&effect.deleted, &effect.inserted].map(|cubes| ByShard::of(cubes, helping));
    let shards: Vec<usize> = (0..SHARDS).collect();
    let mut done = 0;
    for some in shards.chunks(SHARDS_AT_ONCE) {
        if !change_shards(access, helping, some, &deleted, &inserted) {
            break;
        }
        done += some.len();
    }
    let fits = done == SHARDS;
    if !fits {
        for some in shards[..done].chunks(SHARDS_AT_ONCE) {
            let undone = change_shards(access, helping, some, &inserted, &deleted);
            assert!(undone, "it was the other way a moment ago");
        }
    }
    access.step(|engine| engine.helpers = helpers);
    fits
}

/// Changes some shards; false, and nothing done, when a cube does not fit.
fn change_shards(
    access: &impl Access,
    helpers: &mut [Helper],
    shards: &[usize],
    deleted: &ByShard<'_>,
    inserted: &ByShard<'_>,
) -> bool {
    let threads = helpers.len();
    let changed = access.look(|engine| {
        in_parallel(helpers, |number, _| {
            let own = shards.iter().skip(number).step_by(threads);
            let changed = own.map(|&shard| {
                let (deleted, inserted) = (deleted.shard(shard), inserted.shard(shard));
                Some((shard, engine.ids.changed(shard, &deleted, &inserted)?))
            });
            changed.collect::<Option<Vec<_>>>()
        })
    });
    let Some(mut changed) = changed.into_iter().collect::<Option<Vec<_>>>() else {
        return false;
    };
    access.step(|engine| {
        for (number, shard) in changed.iter_mut().flatten() {
            engine.ids.swap_shard(*number, shard);
        }
    });
    true
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;
    use std::collections::BTreeMap;
    use std::num::NonZero;

    use super::*;
    use crate::engine::apply_ids;
    use crate::geometry::Edge;

    fn place(number: u64) -> Place {
        let part = |shift: u32| i32::try_from(number >> shift & 0xff).unwrap();
        Place::from_checked([part(0), part(8), part(16)])
    }

    /// Shard by shard or one by one, on any number of threads, the table is that of a plain map; an effect that does not fit
    /// changes nothing.
    #[test]
    fn parts_agree_with_single_ids() {
        for threads in 1..=3 {
            let edge = Edge::new(5).unwrap();
            let threads = NonZero::new(threads).unwrap();
            let mut by_shards = Engine::new(edge).with_threads(threads);
            let mut one_by_one = Engine::new(edge);
            let mut map = BTreeMap::new();
            // Thousands, so that every thread has some; fewer and fewer; none.
            for (change, (going, coming)) in [(0, 5000), (2000, 3000), (5500, 10), (510, 0)]
                .into_iter()
                .enumerate()
            {
                let deleted: Vec<_> = map.iter().map(|(id, place)| (*id, *place)).collect();
                let deleted = deleted.into_iter().take(going).collect();
                let first = change as u64 * 1_000_003;
                let inserted = (first..first + coming).map(|id| (CubeId(id), place(id)));
                let effect = Effect {
                    deleted,
                    inserted: inserted.collect(),
                };
                for misfit in misfits(&effect, &map) {
                    let before = listed(&by_shards);
                    assert!(!change_ids(&RefCell::new(&mut by_shards), &misfit));
                    assert_eq!(listed(&by_shards), before, "change {change}");
                    assert_eq!(by_shards.ids.len(), map.len());
                }
                assert!(change_ids(&RefCell::new(&mut by_shards), &effect));
                apply_ids(&RefCell::new(&mut one_by_one), &effect).unwrap();
                for (id, _) in &effect.deleted {
                    map.remove(id);
                }
                map.extend(effect.inserted.iter().copied());
                assert_eq!(listed(&by_shards), listed(&one_by_one), "change {change}");
                assert_eq!(by_shards.ids.len(), map.len());
                assert!(
                    map.iter()
                        .all(|(id, place)| by_shards.get(*id) == Some(*place))
                );
            }
            assert_eq!(
                by_shards.ids.size(),
                one_by_one.ids.size(),
                "nothing is left"
            );
        }
    }

    fn listed(engine: &Engine) -> Vec<(CubeId, Place)> {
        engine.cubes().collect()
    }

    /// The same effect with a cube too many: one that is not there, is elsewhere, is there already, or comes twice.
    fn misfits(effect: &Effect, there: &BTreeMap<CubeId, Place>) -> Vec<Effect> {
        let with = |deleted: Option<(CubeId, Place)>, inserted: Option<(CubeId, Place)>| {
            let mut effect = effect.clone();
            effect.deleted.extend(deleted);
            effect.inserted.extend(inserted);
            effect
        };
        let mut misfits = vec![
            with(Some((CubeId(u64::MAX), place(1))), None),
            with(None, effect.inserted.last().copied()),
        ];
        // The last one stays, unless all go.
        if let Some((id, at)) = there
            .last_key_value()
            .filter(|_| effect.deleted.len() < there.len())
        {
            let elsewhere = Place::from_checked(at.corner().map(|part| part + 1));
            misfits.push(with(Some((*id, elsewhere)), None));
            misfits.push(with(None, Some((*id, *at))));
        }
        if effect.inserted.is_empty() {
            misfits.remove(1);
        }
        misfits
    }
}
