//! The cubes of a scene behind a lock: one writer, and readers who see the last durable state whatever the writer does.
//!
//! The engine runs ahead of what is durable, and while a change is applied it is between two states. Readers come in
//! between the short steps of a change all the same: what the changes on their way do is kept until they are durable,
//! and whoever reads undoes it.
//!
//! ```text
//!   engine   durable ── change 1 ── change 2 ── half of change 3
//!   reader   durable <───────────── undoes 3, 2 and 1, each as a whole: undoing what is not done does nothing
//! ```

use std::collections::HashMap;
use std::sync::OnceLock;

use parking_lot::{RwLock, RwLockReadGuard, RwLockWriteGuard};

use super::{Published, Seq};
use crate::engine::{Access, Cursor, Engine, Held, Side, page};
use crate::geometry::{CubeId, Effect, Place};

/// The cubes of a scene.
pub(super) struct CubeSet(RwLock<State>);

struct State {
    engine: Engine,
    /// The last durable state.
    durable: Published,
    /// What the changes since do, the oldest first.
    ahead: Vec<Effect>,
    /// Made when it is first needed.
    undo: OnceLock<Undo>,
    /// False in the middle of a step; a reader finds it so only when the step has panicked.
    is_whole: bool,
}

/// How to come back from the engine's cubes to the durable ones.
struct Undo {
    /// Where the cubes that have been touched were.
    before: HashMap<CubeId, Option<Place>>,
    /// Those that were somewhere, in the order of the listing.
    back: Vec<(Cursor, (CubeId, Place))>,
}

/// The last durable state, held while it is read.
pub(super) struct View<'a>(RwLockReadGuard<'a, State>);

impl CubeSet {
    pub(super) fn new(engine: Engine, durable: &Published) -> Self {
        Self(RwLock::new(State {
            engine,
            durable: *durable,
            ahead: Vec::new(),
            undo: OnceLock::new(),
            is_whole: true,
        }))
    }

    /// The durable state, once a step that is being taken is over; none when a step has failed.
    pub(super) fn view(&self) -> Option<View<'_>> {
        View::of(self.0.read())
    }

    /// The same without waiting; none also while a step is being taken.
    pub(super) fn try_view(&self) -> Option<View<'_>> {
        self.0.try_read().and_then(View::of)
    }

    /// Applies an effect that was judged against the engine: the engine is ahead then.
    pub(super) fn apply(&self, effect: &Effect) {
        self.write(|state| state.ahead.push(effect.clone()));
        Engine::apply_through(self, effect)
            .expect("an effect fits the set that it was judged against");
    }

    /// What the engine is ahead of is durable now; `show` tells those who do not look here, before anybody looks here.
    pub(super) fn advance(&self, durable: &Published, show: impl FnOnce()) {
        self.write(|state| {
            state.durable = *durable;
            state.ahead.clear();
            show();
        });
    }

    fn write<T>(&self, write: impl FnOnce(&mut State) -> T) -> T {
        let mut state = self.0.write();
        state.undo.take();
        let result = write(&mut state);
        // To those who wait, before the next step.
        RwLockWriteGuard::unlock_fair(state);
        result
    }
}

impl Access for CubeSet {
    fn look<T>(&self, look: impl FnOnce(&Engine) -> T) -> T {
        look(&self.0.read().engine)
    }

    fn step<T>(&self, step: impl FnOnce(&mut Engine) -> T) -> T {
        let mut state = self.0.write();
        state.is_whole = false;
        let result = step(&mut state.engine);
        state.is_whole = true;
        RwLockWriteGuard::unlock_fair(state);
        result
    }
}

impl<'a> View<'a> {
    fn of(state: RwLockReadGuard<'a, State>) -> Option<Self> {
        state.is_whole.then_some(Self(state))
    }

    pub(super) fn published(&self) -> Published {
        self.0.durable
    }

    pub(super) fn seq(&self) -> Seq {
        self.0.durable.seq
    }

    /// Where a cube is. O(cubes on their way).
    pub(super) fn cube(&self, id: CubeId) -> Option<Place> {
        let named = |cubes: &[(CubeId, Place)]| {
            let cube = cubes.iter().find(|(named, _)| *named == id);
            cube.map(|(_, place)| *place)
        };
        // The oldest change that names it knows where it was.
        for effect in &self.0.ahead {
            if let Some(place) = named(&effect.deleted) {
                return Some(place);
            }
            if named(&effect.inserted).is_some() {
                return None;
            }
        }
        self.0.engine.get(id)
    }

    /// Up to `limit` cubes after the cursor (from the beginning without one), and the cursor of the last when more follow.
    pub(super) fn page(
        &self,
        after: Option<Cursor>,
        limit: usize,
    ) -> (Vec<(CubeId, Place)>, Option<Cursor>) {
        page(self.cubes_after(after), limit)
    }

    /// All cubes, in the order of the listing.
    pub(super) fn cubes(&self) -> impl Iterator<Item = (CubeId, Place)> + '_ {
        self.cubes_after(None)
    }

    /// Where a point lies, and the cube of least id that holds it. O(cubes around it and cubes on their way).
    pub(super) fn contains(&self, point: [i32; 3]) -> (Side, Option<(CubeId, Place)>) {
        let State { engine, ahead, .. } = &*self.0;
        if ahead.is_empty() {
            return engine.contains(point);
        }
        let mut holders: HashMap<CubeId, Place> = HashMap::new();
        engine.each_at(point, |id, place| {
            holders.insert(id, place);
        });
        let edge = engine.edge().steps();
        let holds = |(_, place): &&(CubeId, Place)| {
            let sides = place.corner().into_iter().zip(point);
            // As a difference of 64 bits: a point may be anywhere.
            sides.fold(true, |holds, (low, at)| {
                holds & (0..=i64::from(edge)).contains(&(i64::from(at) - i64::from(low)))
            })
        };
        for effect in ahead.iter().rev() {
            for (id, _) in effect.inserted.iter().filter(holds) {
                holders.remove(id);
            }
            holders.extend(effect.deleted.iter().filter(holds).copied());
        }
        let mut held = Held::new(engine.edge(), point);
        for (id, place) in holders {
            held.by(id, place);
        }
        held.answer()
    }

    fn cubes_after(&self, after: Option<Cursor>) -> impl Iterator<Item = (CubeId, Place)> + '_ {
        let undo = self.0.undo.get_or_init(|| Undo::of(&self.0.ahead));
        let first = undo.back.partition_point(|(at, _)| Some(*at) <= after);
        let mut back = undo.back[first..].iter().peekable();
        let untouched = self.0.engine.cubes_after(after);
        let mut untouched = untouched
            .filter(|(id, _)| !undo.before.contains_key(id))
            .peekable();
        std::iter::from_fn(move || match (untouched.peek(), back.peek()) {
            (Some((id, _)), Some((at, _))) if Cursor::of(*id) < *at => untouched.next(),
            (_, Some(_)) => back.next().map(|(_, cube)| *cube),
            (_, None) => untouched.next(),
        })
    }
}

impl Undo {
    fn of(ahead: &[Effect]) -> Self {
        let mut before: HashMap<CubeId, Option<Place>> = HashMap::new();
        // The oldest change that names a cube has the last word, and in it that it was deleted.
        for effect in ahead.iter().rev() {
            before.extend(effect.inserted.iter().map(|(id, _)| (*id, None)));
            before.extend(effect.deleted.iter().map(|(id, place)| (*id, Some(*place))));
        }
        let there = before.iter();
        let there = there.filter_map(|(id, place)| Some((Cursor::of(*id), (*id, (*place)?))));
        let mut back: Vec<_> = there.collect();
        back.sort_unstable_by_key(|(at, _)| *at);
        Self { before, back }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::engine::Op;
    use crate::geometry::{CUBES_MAX, Edge, Totals};

    const EDGE: i32 = 24;
    const SIDE: u64 = 120;

    struct Random(u64);

    impl Random {
        fn below(&mut self, end: u64) -> u64 {
            self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            mixed ^= mixed >> 27;
            mixed % end
        }

        fn point(&mut self) -> [i32; 3] {
            [(); 3].map(|()| i32::try_from(self.below(SIDE)).unwrap())
        }

        fn place(&mut self, edge: Edge) -> Place {
            Place::new(self.point().map(i64::from), edge).unwrap()
        }
    }

    /// A reader who comes after every step and look, and knows what it must find.
    struct Reader<'a> {
        set: &'a CubeSet,
        durable: &'a BTreeMap<CubeId, Place>,
        points: &'a [[i32; 3]],
        ids: &'a [CubeId],
    }

    impl Reader<'_> {
        fn read(&self) {
            let view = self.set.view().unwrap();
            for id in self.ids {
                assert_eq!(view.cube(*id), self.durable.get(id).copied());
            }
            let mut twin = self.durable.iter().map(|(id, place)| (*id, *place));
            let mut listed: Vec<_> = view.cubes().collect();
            assert!(listed.is_sorted_by_key(|(id, _)| Cursor::of(*id)));
            listed.sort_unstable_by_key(|(id, _)| *id);
            assert!(listed.into_iter().eq(twin.by_ref()));
            let mut paged = Vec::new();
            let mut after = None;
            loop {
                let (cubes, next) = view.page(after, 37);
                paged.extend(cubes);
                after = next;
                if after.is_none() {
                    break;
                }
            }
            assert!(paged.into_iter().eq(view.cubes()));
            for point in self.points {
                let mut alone = Held::new(Edge::new(EDGE.into()).unwrap(), *point);
                for (id, place) in self.durable {
                    let sides = place.corner().into_iter().zip(point);
                    if sides.fold(true, |holds, (low, at)| {
                        holds && low <= *at && *at <= low + EDGE
                    }) {
                        alone.by(*id, *place);
                    }
                }
                assert_eq!(view.contains(*point), alone.answer(), "at {point:?}");
            }
        }
    }

    impl Access for Reader<'_> {
        fn look<T>(&self, look: impl FnOnce(&Engine) -> T) -> T {
            let result = self.set.look(look);
            self.read();
            result
        }

        fn step<T>(&self, step: impl FnOnce(&mut Engine) -> T) -> T {
            let result = self.set.step(step);
            self.read();
            result
        }
    }

    /// Changes of all sizes, one or two of them on their way at a time, cubes that move and come again among them.
    #[test]
    fn readers_find_the_durable_state_after_every_step() {
        let edge = Edge::new(EDGE.into()).unwrap();
        for seed in 0..6 {
            println!("seed {seed}");
            let mut random = Random(seed);
            let empty = Published {
                seq: Seq(0),
                at_ms: 0,
                totals: Totals::default(),
            };
            let set = CubeSet::new(Engine::new(edge), &empty);
            let mut durable: BTreeMap<CubeId, Place> = BTreeMap::new();
            for change in 0..30 {
                let mut later = durable.clone();
                for _ in 0..=random.below(2) {
                    let size = [3, 40, 500][usize::try_from(random.below(3)).unwrap()];
                    let mut ops: Vec<Op> = Vec::new();
                    for _ in 0..random.below(size) {
                        let id = CubeId(random.below(600));
                        ops.push(Op::Delete(id));
                        if random.below(4) < if change < 20 { 3 } else { 1 } {
                            ops.push(Op::Insert(id, random.place(edge)));
                        }
                    }
                    let effect = set
                        .look(|engine| engine.judge(&ops, CUBES_MAX))
                        .unwrap()
                        .effect;
                    let points = [(); 5].map(|()| random.point());
                    let mut ids = [(); 5].map(|()| CubeId(random.below(600)));
                    if let Some((id, _)) = effect.deleted.first() {
                        ids[0] = *id;
                    }
                    let reader = Reader {
                        set: &set,
                        durable: &durable,
                        points: &points,
                        ids: &ids,
                    };
                    set.write(|state| state.ahead.push(effect.clone()));
                    Engine::apply_through(&reader, &effect).unwrap();
                    for (id, _) in effect.deleted {
                        later.remove(&id);
                    }
                    later.extend(effect.inserted);
                }
                let totals = set.look(Engine::totals);
                set.advance(&Published { totals, ..empty }, || {});
                durable = later;
                assert_eq!(totals.cubes, durable.len() as u64);
            }
        }
    }
}
