//! The bodies of a scene behind a lock: one writer, and readers who see the last durable state whatever the writer does.
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
use std::ops::RangeInclusive;

use parking_lot::{Mutex, RwLock, RwLockReadGuard, RwLockWriteGuard};

use super::before::{Before, Listed};
use super::kind::SceneKind;
use super::solids::Solids;
use super::{Published, Seq};
use crate::engine::solids::{Around, Body};
use crate::engine::{Access, Cursor, Held, Side};
use crate::geometry::convex::Point;
use crate::geometry::{CubeId, Effect, Place};
use crate::log::Cubes;

/// The bodies of a scene.
pub(super) struct BodySet<K: SceneKind> {
    state: RwLock<State<K>>,
    /// Empty, with the room that the last changes took: used in turn with the one in the state, so that a busy scene does not ask for
    /// memory again and again.
    spare: Mutex<Ahead<K>>,
    /// How many steps the writer has taken.
    #[cfg(test)]
    steps: std::sync::atomic::AtomicUsize,
}

struct State<K: SceneKind> {
    engine: K::Engine,
    /// The last durable state.
    durable: Published<K>,
    /// What the changes since have done, or are about to do.
    ahead: Ahead<K>,
    /// False in the middle of a step; a reader finds it so only when the step has panicked.
    is_whole: bool,
}

/// How to come back from the engine's bodies to the durable ones. Looking something up takes no longer for many changes than for few.
struct Ahead<K: SceneKind> {
    before: Before<K>,
    /// Those that `before` knows to have been somewhere, by where.
    near: K::Near,
}

impl<K: SceneKind> Default for Ahead<K> {
    fn default() -> Self {
        Self {
            before: Before::default(),
            near: K::Near::default(),
        }
    }
}

/// Bodies of an effect that one step notes.
const NOTED_A_STEP: usize = 256;

/// From so many inserted bodies on, consecutive ids are noted as a range.
const RANGE_MIN: usize = if cfg!(test) { 64 } else { 1 << 16 };

/// Bodies on their way that a page passes over before it ends early.
const PASSED_OVER_MAX: usize = if cfg!(test) { 64 } else { 4096 };

/// The last durable state, held while it is read.
pub(super) struct View<'a, K: SceneKind>(RwLockReadGuard<'a, State<K>>);

impl<K: SceneKind> BodySet<K> {
    pub(super) fn new(engine: K::Engine, durable: &Published<K>) -> Self {
        Self {
            state: RwLock::new(State {
                engine,
                durable: *durable,
                ahead: Ahead::default(),
                is_whole: true,
            }),
            spare: Mutex::default(),
            #[cfg(test)]
            steps: std::sync::atomic::AtomicUsize::new(0),
        }
    }

    /// The durable state, once a step that is being taken is over; none when a step has failed.
    pub(super) fn view(&self) -> Option<View<'_, K>> {
        View::of(self.state.read())
    }

    /// The same without waiting; none also while a step is being taken.
    pub(super) fn try_view(&self) -> Option<View<'_, K>> {
        self.state.try_read().and_then(View::of)
    }

    /// Applies an effect that was judged against the engine: the engine is ahead then.
    pub(super) fn apply(&self, effect: &Effect<K::Body>) {
        let fits = if K::applies_at_once(effect) {
            self.write(|state| {
                state.is_whole = false;
                state.note(&effect.deleted, &effect.inserted);
                let fits = K::apply(&mut state.engine, effect);
                state.is_whole = true;
                fits
            })
        } else {
            self.note(effect);
            K::apply_in_steps(self, effect)
        };
        assert!(fits, "an effect fits the set that it was judged against");
    }

    /// Inserts bodies that were judged against the engine, one after the other, in one step: the totals after each.
    pub(super) fn insert_each(&self, bodies: Vec<(CubeId, K::Body)>) -> Vec<K::Totals> {
        let after = self.write(|state| {
            state.is_whole = false;
            state.note(&[], &bodies);
            let after = K::insert_each(&mut state.engine, bodies);
            state.is_whole = true;
            after
        });
        after.expect("bodies fit the set that they were judged against")
    }

    /// What the engine is ahead of is durable now; `show` tells those who do not look here, before anybody looks here.
    pub(super) fn advance(&self, durable: &Published<K>, show: impl FnOnce()) {
        let mut spare = self.spare.lock();
        self.write(|state| {
            state.durable = *durable;
            std::mem::swap(&mut state.ahead, &mut spare);
            show();
        });
        // While others read already.
        spare.before.clear();
        K::clear_near(&mut spare.near);
    }

    /// Notes a large effect before it is applied, in short steps. What is noted of a body is true as long as nothing is applied, so
    /// readers may come in between.
    fn note(&self, effect: &Effect<K::Body>) {
        for some in effect.deleted.chunks(NOTED_A_STEP) {
            self.write(|state| state.note(some, &[]));
        }
        if effect.inserted.len() >= RANGE_MIN
            && let Some(ids) = consecutive(&effect.inserted)
        {
            self.write(|state| state.ahead.before.note_inserted_range(ids));
            return;
        }
        for some in effect.inserted.chunks(NOTED_A_STEP) {
            self.write(|state| state.note(&[], some));
        }
    }

    /// Reads the engine while it is at the durable state, as it is between two groups.
    pub(super) fn look_durable<T>(&self, look: impl FnOnce(&K::Engine) -> T) -> T {
        let state = self.state.read();
        assert!(
            state.ahead.before.is_empty(),
            "no change is on its way between two groups"
        );
        look(&state.engine)
    }

    /// Number of bodies in the engine.
    pub(super) fn len(&self) -> u64 {
        self.look(|engine| K::count(&K::totals(engine)))
    }

    fn write<T>(&self, write: impl FnOnce(&mut State<K>) -> T) -> T {
        #[cfg(test)]
        self.steps
            .fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        let mut state = self.state.write();
        let result = write(&mut state);
        // To those who wait, before the next step.
        RwLockWriteGuard::unlock_fair(state);
        result
    }
}

impl<K: SceneKind> Access<K::Engine> for BodySet<K> {
    /// Reads the engine, which may be ahead of the durable state.
    fn look<T>(&self, look: impl FnOnce(&K::Engine) -> T) -> T {
        look(&self.state.read().engine)
    }

    /// Takes a step of a change that was noted, while nobody reads.
    fn step<T>(&self, step: impl FnOnce(&mut K::Engine) -> T) -> T {
        self.write(|state| {
            state.is_whole = false;
            let result = step(&mut state.engine);
            state.is_whole = true;
            result
        })
    }
}

impl<K: SceneKind> State<K> {
    fn note(&mut self, deleted: &[(CubeId, K::Body)], inserted: &[(CubeId, K::Body)]) {
        let Ahead { before, near } = &mut self.ahead;
        for (id, body) in deleted {
            if before.note_deleted(*id, body.clone()) {
                K::note_near(near, *id, body);
            }
        }
        for (id, body) in inserted {
            before.note_inserted(*id, body.clone());
        }
    }
}

/// The ids of some bodies, if each is the one after that before it.
fn consecutive<Body>(bodies: &[(CubeId, Body)]) -> Option<RangeInclusive<CubeId>> {
    let ([(first, _), ..], [.., (last, _)]) = (bodies, bodies) else {
        return None;
    };
    let mut pairs = bodies.windows(2);
    let is_next = |pair: &[(CubeId, Body)]| pair[0].0.0.checked_add(1) == Some(pair[1].0.0);
    pairs.all(is_next).then_some(*first..=*last)
}

impl<'a, K: SceneKind> View<'a, K> {
    fn of(state: RwLockReadGuard<'a, State<K>>) -> Option<Self> {
        state.is_whole.then_some(Self(state))
    }

    pub(super) fn published(&self) -> Published<K> {
        self.0.durable
    }

    pub(super) fn seq(&self) -> Seq {
        self.0.durable.seq
    }

    /// The body of this id.
    pub(super) fn body(&self, id: CubeId) -> Option<K::Body> {
        self.0.ahead.before.body(&self.0.engine, id)
    }

    /// Up to `limit` bodies after the cursor (from the beginning without one), and the cursor to go on after when more may follow. A page
    /// that meets very many bodies on their way ends before it is full. O(limit).
    pub(super) fn page(
        &self,
        after: Option<Cursor>,
        limit: usize,
    ) -> (Vec<(CubeId, K::Body)>, Option<Cursor>) {
        let (mut page, mut last) = (Vec::new(), after);
        let looked_at_max = limit.saturating_add(PASSED_OVER_MAX);
        for (looked_at, (cursor, body)) in self.listing(after).enumerate() {
            if (body.is_some() && page.len() == limit) || looked_at == looked_at_max {
                return (page, last);
            }
            last = Some(cursor);
            page.extend(body);
        }
        (page, None)
    }

    /// All bodies after the cursor, in the order of the listing.
    pub(super) fn listing(&self, after: Option<Cursor>) -> impl Iterator<Item = Listed<K>> + '_ {
        let State { engine, ahead, .. } = &*self.0;
        let now = K::bodies_after(engine, after);
        let now = now.map(|(id, body)| (Cursor::of(id), Some((id, body))));
        ahead.before.listing(now, after)
    }
}

impl View<'_, Cubes> {
    /// Where a point lies, and the cube of least id that holds it. O(cubes around it).
    pub(super) fn contains(&self, point: [i32; 3]) -> (Side, Option<(CubeId, Place)>) {
        let State { engine, ahead, .. } = &*self.0;
        if ahead.before.is_empty() {
            return engine.contains(point);
        }
        let mut holders: HashMap<CubeId, Place> = HashMap::new();
        engine.each_at(point, |id, place| {
            if !ahead.before.names(id) {
                holders.insert(id, place);
            }
        });
        holders.extend(ahead.near.holding(point, engine.edge()));
        let mut held = Held::new(engine.edge(), point);
        for (id, place) in holders {
            held.by(id, place);
        }
        held.answer()
    }
}

impl View<'_, Solids> {
    /// Where a point lies, and the body of least id that holds it. O(bodies around it, and on their way).
    pub(super) fn contains(&self, point: Point) -> (Side, Option<(CubeId, Body)>) {
        let State { engine, ahead, .. } = &*self.0;
        let (side, holder) = if ahead.before.is_empty() {
            engine.contains(point)
        } else {
            let mut around = Around::new(point, engine.stock());
            engine.each_near(point, |id, body| {
                if !ahead.before.names(id) {
                    around.add(id, body);
                }
            });
            for (id, body) in ahead.before.there() {
                around.add(id, &body);
            }
            around.answer()
        };
        let body = |id| Some((id, self.body(id)?));
        (side, holder.and_then(body))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::sync::atomic::Ordering;

    use super::*;
    use crate::engine::solids::{self, Stock};
    use crate::engine::{Engine, Op};
    use crate::geometry::convex::Solid;
    use crate::geometry::{CUBES_MAX, Edge, Totals};
    use crate::random::Random;

    const EDGE: i32 = 24;
    const SIDE: i64 = 120;

    fn point(random: &mut Random) -> [i32; 3] {
        [(); 3].map(|()| i32::try_from(random.within(0, SIDE - 1)).unwrap())
    }

    fn place(random: &mut Random, edge: Edge) -> Place {
        Place::new(point(random).map(i64::from), edge).unwrap()
    }

    /// A reader who comes after every step and look, and knows what it must find.
    struct Reader<'a> {
        set: &'a BodySet<Cubes>,
        durable: &'a BTreeMap<CubeId, Place>,
        points: &'a [[i32; 3]],
        ids: &'a [CubeId],
    }

    impl Reader<'_> {
        fn read(&self) {
            let view = self.set.view().unwrap();
            for id in self.ids {
                assert_eq!(view.body(*id), self.durable.get(id).copied());
            }
            let mut expected = self.durable.iter().map(|(id, place)| (*id, *place));
            let bodies = || view.listing(None).filter_map(|(_, body)| body);
            let mut listed: Vec<_> = bodies().collect();
            assert!(listed.is_sorted_by_key(|(id, _)| Cursor::of(*id)));
            listed.sort_unstable_by_key(|(id, _)| *id);
            assert!(listed.into_iter().eq(expected.by_ref()));
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
            assert!(paged.into_iter().eq(bodies()));
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

    /// Who is told of a new state at once finds it here too: nobody looks here between the two.
    #[test]
    fn a_durable_state_is_shown_while_nobody_can_look() {
        let state = |seq| Published {
            seq: Seq(seq),
            at_ms: 0,
            totals: Totals::default(),
        };
        let set = BodySet::<Cubes>::new(Engine::new(Edge::new(1).unwrap()), &state(0));
        assert!(set.try_view().is_some());
        set.advance(&state(1), || assert!(set.try_view().is_none()));
        assert_eq!(set.view().unwrap().published(), state(1));
    }

    /// The lock is taken once for a change that is applied at once, and many times for a large one: readers come in between.
    #[test]
    fn a_small_change_is_one_step() {
        let edge = Edge::new(EDGE.into()).unwrap();
        let empty = Published {
            seq: Seq(0),
            at_ms: 0,
            totals: Totals::default(),
        };
        let set = BodySet::<Cubes>::new(Engine::new(edge), &empty);
        let mut random = Random::new(3);
        let mut steps_of = |ids: std::ops::Range<u64>| {
            let inserted: Vec<_> = ids
                .map(|id| (CubeId(id), place(&mut random, edge)))
                .collect();
            let effect = Effect {
                deleted: vec![],
                inserted,
            };
            let before = set.steps.load(Ordering::Relaxed);
            set.apply(&effect);
            (
                Engine::applies_at_once(&effect),
                set.steps.load(Ordering::Relaxed) - before,
            )
        };
        assert_eq!(steps_of(0..1), (true, 1));
        assert_eq!(steps_of(1..30), (true, 1));
        let (at_once, steps) = steps_of(100..5_100);
        assert!(!at_once && steps > 5_000 / NOTED_A_STEP, "{steps} steps");
    }

    /// Changes of all sizes, one or two of them on their way at a time, cubes that move and come again among them.
    #[test]
    fn readers_find_the_durable_state_after_every_step() {
        let edge = Edge::new(EDGE.into()).unwrap();
        for seed in 0..6 {
            let mut random = Random::new(seed);
            let empty = Published {
                seq: Seq(0),
                at_ms: 0,
                totals: Totals::default(),
            };
            let set = BodySet::<Cubes>::new(Engine::new(edge), &empty);
            let mut durable: BTreeMap<CubeId, Place> = BTreeMap::new();
            for change in 0..30 {
                let mut later = durable.clone();
                for _ in 0..=random.below(2) {
                    let mut size = [3, 40, 500][usize::try_from(random.below(3)).unwrap()];
                    let mut ops: Vec<Op> = Vec::new();
                    if random.below(3) == 0 {
                        size = [1, size][usize::try_from(random.below(2)).unwrap()];
                        let first = random.below(500);
                        for id in (first..first + random.below(100)).map(CubeId) {
                            ops.push(Op::Delete(id));
                            ops.push(Op::Insert(id, place(&mut random, edge)));
                        }
                    }
                    for _ in 0..random.below(size) {
                        let id = CubeId(random.below(600));
                        ops.push(Op::Delete(id));
                        if random.below(4) < if change < 20 { 3 } else { 1 } {
                            ops.push(Op::Insert(id, place(&mut random, edge)));
                        }
                    }
                    let effect = set
                        .look(|engine| engine.judge(&ops, CUBES_MAX))
                        .unwrap()
                        .effect;
                    let points = [(); 5].map(|()| point(&mut random));
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
                    if Engine::applies_at_once(&effect) {
                        set.apply(&effect);
                        reader.read();
                    } else {
                        set.note(&effect);
                        reader.read();
                        Engine::apply_through(&reader, &effect).unwrap();
                    }
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

    /// A box or a tetrahedron on a small lattice, so that many touch.
    fn solid(random: &mut Random) -> Body {
        loop {
            let mut at = || Point::new([(); 3].map(|()| random.within(0, 6))).unwrap();
            let corners = [at(), at(), at(), at()];
            let body = match random.below(2) {
                0 => Body::cuboid(corners[0], corners[1]),
                _ => Solid::hull(&corners).map(Body::solid),
            };
            if let Ok(body) = body {
                return body;
            }
        }
    }

    /// Solids come and go, one or two changes of them on their way at a time; an engine that has the durable ones alone says the same.
    #[test]
    fn where_a_point_lies_among_solids_is_as_of_the_durable_state() {
        for seed in 0..6 {
            let mut random = Random::new(seed);
            let stock = (seed % 2 == 0).then(|| Stock::new(solid(&mut random).part(0)).unwrap());
            let engine = || solids::Engine::new().with_stock(stock.clone());
            let nothing = Published {
                seq: Seq(0),
                at_ms: 0,
                totals: Solids::totals(&engine()),
            };
            let set = BodySet::<Solids>::new(engine(), &nothing);
            let mut durable: BTreeMap<CubeId, Body> = BTreeMap::new();
            for _ in 0..20 {
                let mut alone = engine();
                let inserted = durable.iter().map(|(id, body)| (*id, body.clone()));
                let all = Effect {
                    deleted: vec![],
                    inserted: inserted.collect(),
                };
                alone.apply(&all).unwrap();
                let mut later = durable.clone();
                for _ in 0..=random.below(2) {
                    let mut effect = Effect::default();
                    for id in (0..10).map(CubeId) {
                        if random.below(2) == 0 {
                            continue;
                        }
                        effect
                            .deleted
                            .extend(later.remove(&id).map(|body| (id, body)));
                        if random.below(2) == 0 {
                            let body = solid(&mut random);
                            later.insert(id, body.clone());
                            effect.inserted.push((id, body));
                        }
                    }
                    set.apply(&effect);
                    let view = set.view().unwrap();
                    for _ in 0..50 {
                        let at = Point::new([(); 3].map(|()| random.within(-1, 7))).unwrap();
                        let (side, holder) = alone.contains(at);
                        let holder = holder.map(|id| (id, durable[&id].clone()));
                        assert_eq!(view.contains(at), (side, holder), "at {at:?}");
                    }
                }
                set.advance(&nothing, || {});
                durable = later;
            }
        }
    }

    /// A page looks at so many cubes and no more, however many are on their way, and who goes on finds them all once they are durable.
    #[test]
    fn a_page_passes_over_a_bounded_number_of_cubes() {
        let edge = Edge::new(EDGE.into()).unwrap();
        let empty = Published {
            seq: Seq(0),
            at_ms: 0,
            totals: Totals::default(),
        };
        let set = BodySet::<Cubes>::new(Engine::new(edge), &empty);
        let mut random = Random::new(1);
        let inserted: Vec<_> = (0..1000)
            .map(|id| (CubeId(id), place(&mut random, edge)))
            .collect();
        let mut order: Vec<Cursor> = inserted.iter().map(|(id, _)| Cursor::of(*id)).collect();
        order.sort_unstable();
        set.apply(&Effect {
            deleted: vec![],
            inserted,
        });
        let (page, next) = set.view().unwrap().page(None, 10);
        assert_eq!(
            (page, next),
            (vec![], Some(order[10 + PASSED_OVER_MAX - 1]))
        );
        let (page, next) = set.view().unwrap().page(Some(order[990]), 10);
        assert_eq!((page, next), (vec![], None));
        set.advance(&empty, || {});
        let (page, next) = set.view().unwrap().page(Some(order[988]), 10);
        assert_eq!(page.len(), 10);
        assert_eq!(next, Some(order[998]));
        let (page, next) = set.view().unwrap().page(next, 10);
        assert_eq!((page.len(), next), (1, None));
    }
}
