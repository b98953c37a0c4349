//! What the scenes of different kinds have of their own: the engine, and how a set of bodies is kept while it is ahead of the disk.
//!
//! ```text
//!   scene, inbox, writer, judge, set, before, copying, replay, revert     the same for every kind
//!     └─ SceneKind ── Cubes:  engine::Engine          bodies are places
//!                  └─ Solids: engine::solids::Engine  bodies are swept shapes and hulls (`solids`)
//! ```

use super::places::Places;
use super::table::Table;
use super::{ServiceConfig, ServiceError};
use crate::engine::{self, Access, Cursor, Engine, IdTable, Judged, Op};
use crate::geometry::{CubeId, Edge, Effect, Place, Totals};
use crate::log::{Cubes, Header, Kind};

/// A kind of scene, as the service knows it.
pub trait SceneKind: Kind {
    /// The set of bodies whose totals are current.
    type Engine: Send + Sync + 'static;
    /// Bodies by id, in the order of the engine's listing.
    type Table: Table<Self::Body>;
    /// Bodies of a few changes by where they are.
    type Near: Default + Send + Sync + 'static;

    /// What a recount takes of memory for each body, in bytes.
    const RECOUNT_BYTES: u64;

    /// Bodies that a replay takes together at most, when it need not compare after every change.
    const REPLAYED_TOGETHER_MAX: usize;

    /// An engine without bodies.
    /// # Errors
    /// What the header says that no scene of this kind has, in words.
    fn engine(header: &Header<Self>) -> Result<Self::Engine, String>;

    /// Current totals.
    fn totals(engine: &Self::Engine) -> Self::Totals;

    /// The body of this id.
    fn get(engine: &Self::Engine, id: CubeId) -> Option<Self::Body>;

    /// The bodies that stand after the cursor in the listing, in its order, which is fixed by the ids alone.
    fn bodies_after(
        engine: &Self::Engine,
        after: Option<Cursor>,
    ) -> impl Iterator<Item = (CubeId, Self::Body)> + '_;

    /// Makes room for about so many bodies.
    fn reserve(engine: &mut Self::Engine, bodies: u64);

    /// Judges operations in their order against the set, changing nothing.
    /// # Errors
    /// The first operation at fault, or too many bodies.
    fn judge(
        engine: &Self::Engine,
        ops: &[Op<Self::Body>],
        config: &ServiceConfig,
    ) -> Result<Judged<Self::Body>, ServiceError>;

    /// Applies an effect, whole or not at all; false, and nothing done, when it does not fit.
    fn apply(engine: &mut Self::Engine, effect: &Effect<Self::Body>) -> bool;

    /// How many bodies of successive changes that only insert are put in together, at most; 0 where that is no faster. Judged one by one they
    /// are not too many for the scene either.
    fn together_max(engine: &Self::Engine) -> usize;

    /// Inserts bodies one after the other: the totals after each. None, and nothing is sure, when one does not fit.
    fn insert_each(
        engine: &mut Self::Engine,
        bodies: Vec<(CubeId, Self::Body)>,
    ) -> Option<Vec<Self::Totals>>;

    /// Whether applying an effect takes so short that readers can wait.
    fn applies_at_once(effect: &Effect<Self::Body>) -> bool;

    /// Applies an effect that was noted in short steps, between which others read; false when it does not fit.
    fn apply_in_steps(access: &impl Access<Self::Engine>, effect: &Effect<Self::Body>) -> bool;

    /// Totals after an effect, without applying it; none where that takes applying it, and then its inverse.
    fn dry_run(engine: &Self::Engine, effect: &Effect<Self::Body>) -> Option<Self::Totals>;

    /// Notes where a body is that a change deletes.
    fn note_near(near: &mut Self::Near, id: CubeId, body: &Self::Body);

    /// Forgets what was noted.
    fn clear_near(near: &mut Self::Near);

    /// How many bodies totals count.
    fn count(totals: &Self::Totals) -> u64;

    /// Volume that is gone: from the stock, or into the union where there is no stock. Units: the totals' own.
    fn removed(totals: &Self::Totals) -> i128;

    /// Whether two totals are those of one set of bodies, as far as can be told.
    fn agree(one: &Self::Totals, other: &Self::Totals) -> bool;

    /// Totals from the bodies alone; none when `goes_on`, which is asked now and then, says no.
    fn recount(
        header: &Header<Self>,
        bodies: Vec<Self::Body>,
        goes_on: &dyn Fn() -> bool,
    ) -> Option<Self::Totals>;
}

impl SceneKind for Cubes {
    type Engine = Engine;
    type Table = IdTable;
    type Near = Places;

    /// Its place twice, on its way, and some 80 in an engine.
    const RECOUNT_BYTES: u64 = 128;

    const REPLAYED_TOGETHER_MAX: usize = 1 << 22;

    fn engine(header: &Header) -> Result<Engine, String> {
        let edge = edge_of(header).map_err(|invalid| invalid.to_string())?;
        Ok(Engine::new(edge).with_stock(header.stock))
    }

    fn totals(engine: &Engine) -> Totals {
        engine.totals()
    }

    fn get(engine: &Engine, id: CubeId) -> Option<Place> {
        engine.get(id)
    }

    fn bodies_after(
        engine: &Engine,
        after: Option<Cursor>,
    ) -> impl Iterator<Item = (CubeId, Place)> + '_ {
        engine.cubes_after(after)
    }

    fn reserve(engine: &mut Engine, cubes: u64) {
        engine.reserve(cubes);
    }

    fn judge(engine: &Engine, ops: &[Op], config: &ServiceConfig) -> Result<Judged, ServiceError> {
        Ok(engine.judge(ops, config.scene_cubes_max)?)
    }

    fn apply(engine: &mut Engine, effect: &Effect) -> bool {
        engine.apply(effect).is_ok()
    }

    fn together_max(_: &Engine) -> usize {
        0
    }

    fn insert_each(engine: &mut Engine, cubes: Vec<(CubeId, Place)>) -> Option<Vec<Totals>> {
        let one_by_one = cubes.into_iter().map(|cube| {
            let effect = Effect {
                deleted: Vec::new(),
                inserted: vec![cube],
            };
            engine.apply(&effect).ok().map(|()| engine.totals())
        });
        one_by_one.collect()
    }

    fn applies_at_once(effect: &Effect) -> bool {
        Engine::applies_at_once(effect)
    }

    fn apply_in_steps(access: &impl Access, effect: &Effect) -> bool {
        Engine::apply_through(access, effect).is_ok()
    }

    fn dry_run(_: &Engine, _: &Effect) -> Option<Totals> {
        None
    }

    fn note_near(near: &mut Places, id: CubeId, place: &Place) {
        near.insert(id, *place);
    }

    fn clear_near(near: &mut Places) {
        near.clear();
    }

    fn count(totals: &Totals) -> u64 {
        totals.cubes
    }

    fn removed(totals: &Totals) -> i128 {
        match &totals.stock {
            Some(stock) => stock.removed.volume,
            None => totals.measures.volume,
        }
    }

    fn agree(one: &Totals, other: &Totals) -> bool {
        one == other
    }

    fn recount(header: &Header, places: Vec<Place>, goes_on: &dyn Fn() -> bool) -> Option<Totals> {
        let edge = edge_of(header).expect("an edge is checked before its header is kept");
        engine::recount_while(edge, header.stock, places.into_iter(), goes_on)
    }
}

fn edge_of(header: &Header) -> Result<Edge, crate::geometry::InvalidEdge> {
    Edge::new(i64::from(header.edge_steps))
}
