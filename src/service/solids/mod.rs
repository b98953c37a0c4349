//! Scenes of solids: bodies are shapes swept along segments, and hulls.
//!
//! ```text
//!   shapes ── definitions of the log: a name, the document they were read from, convex parts ── never changed, never dropped
//!   bodies ── a shape's number, from, to │ the vertices of a hull
//!   totals ── fixed-point integers of the engine, and how far rounding can be off
//! ```
//! A shape never changes, also while no solid uses it: a revert may bring back one that does.

mod codec;
mod shapes;

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use super::kind::SceneKind;
use super::{ServiceConfig, ServiceError};
use crate::engine::solids::{self, Body, Effect, Engine, ErrorMax, Judged, Op, SOLIDS_MAX, Stock};
use crate::engine::{Access, Cursor, solids::recount_while};
use crate::geometry::CubeId;
use crate::log::{ColumnReader, ColumnWriter, Header, Kind, Malformed, Reader};

pub use shapes::{NamedShape, SHAPES_MAX, Shapes};

/// Scenes of solids.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Solids;

/// The totals of a scene of solids.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct SolidTotals {
    /// A function of the set of bodies alone.
    pub union: solids::Totals,
    /// How far rounding can be off in them, at most: true, but not the same after another history.
    pub error_max: ErrorMax,
}

/// Bodies that are put in or taken out in one step: some tens of milliseconds.
const STEP_BODIES: usize = 64;

/// The layout of scenes whose stock is a box, if they have one.
const FORMAT_OF_BOXES: i32 = 4;
/// The same with any convex stock.
const FORMAT_OF_HULLS: i32 = 5;

impl Kind for Solids {
    type Body = Body;
    type Totals = SolidTotals;
    type Context = Shapes;
    type Stock = Stock;

    const FORMATS: RangeInclusive<i32> = FORMAT_OF_BOXES..=FORMAT_OF_HULLS;
    const DEFINES: bool = true;
    const BODY_BYTES_MAX: usize = codec::BODY_BYTES_MAX;
    const CHUNK_BODIES: usize = 1 << 12;

    fn format(stock: Option<&Stock>) -> i32 {
        match stock {
            Some(stock) if !codec::is_box(stock.solid()) => FORMAT_OF_HULLS,
            _ => FORMAT_OF_BOXES,
        }
    }

    fn put_stock(to: &mut Vec<u8>, stock: &Stock) {
        codec::put_stock(to, stock);
    }

    fn read_stock(bytes: &[u8]) -> Result<Stock, Malformed> {
        codec::read_stock(bytes)
    }

    fn context(header: &Header<Self>) -> Result<Shapes, String> {
        match header.edge_steps {
            0 => Ok(Shapes::default()),
            _ => Err("a scene of solids has no edge".to_owned()),
        }
    }

    fn define(shapes: &mut Shapes, definition: &[u8]) -> Result<(), Malformed> {
        shapes.push(NamedShape::read(definition)?)
    }

    fn is_defined(shapes: &Shapes, definition: &[u8]) -> bool {
        NamedShape::read(definition).is_ok_and(|shape| shapes.has(&shape))
    }

    fn weight(body: &Body) -> usize {
        codec::weight(body)
    }

    fn put_bodies(bodies: &[(CubeId, Body)], shapes: &Shapes, columns: &mut ColumnWriter<'_>) {
        codec::put_bodies(bodies, shapes, columns);
    }

    fn read_bodies(
        ids: Vec<CubeId>,
        shapes: &Shapes,
        columns: &mut ColumnReader<'_, '_>,
    ) -> Result<Vec<(CubeId, Body)>, Malformed> {
        codec::read_bodies(ids, shapes, columns)
    }

    fn put_totals(to: &mut Vec<u8>, totals: &SolidTotals) {
        codec::put_totals(to, totals);
    }

    fn read_totals(reader: &mut Reader<'_>) -> Result<SolidTotals, Malformed> {
        codec::read_totals(reader)
    }

    fn nothing(header: &Header<Self>) -> SolidTotals {
        Self::totals(&Engine::new().with_stock(header.stock.clone()))
    }
}

impl SceneKind for Solids {
    type Engine = Engine;
    type Table = BTreeMap<Cursor, (CubeId, Body)>;
    type Near = ();

    /// Some 1,000 in an engine, and as many for what is prepared of it.
    const RECOUNT_BYTES: u64 = 2048;

    const REPLAYED_TOGETHER_MAX: usize = 1 << 14;

    fn engine(header: &Header<Self>) -> Result<Engine, String> {
        Ok(Engine::new().with_stock(header.stock.clone()))
    }

    fn totals(engine: &Engine) -> SolidTotals {
        SolidTotals {
            union: engine.totals(),
            error_max: engine.error_max(),
        }
    }

    fn get(engine: &Engine, id: CubeId) -> Option<Body> {
        engine.get(id).cloned()
    }

    fn bodies_after(
        engine: &Engine,
        after: Option<Cursor>,
    ) -> impl Iterator<Item = (CubeId, Body)> + '_ {
        let bodies = engine.solids_after(after);
        bodies.map(|(id, body)| (id, body.clone()))
    }

    fn reserve(_: &mut Engine, _: u64) {}

    fn judge(engine: &Engine, ops: &[Op], _: &ServiceConfig) -> Result<Judged, ServiceError> {
        Ok(engine.judge(ops)?)
    }

    fn apply(engine: &mut Engine, effect: &Effect) -> bool {
        engine.apply(effect).is_ok()
    }

    fn together_max(engine: &Engine) -> usize {
        let room = SOLIDS_MAX - engine.len();
        usize::try_from(room).map_or(STEP_BODIES, |room| room.min(STEP_BODIES))
    }

    fn insert_each(engine: &mut Engine, bodies: Vec<(CubeId, Body)>) -> Option<Vec<SolidTotals>> {
        let after = engine.insert_each(bodies).ok()?;
        let error_max = engine.error_max();
        let of = |union| SolidTotals { union, error_max };
        Some(after.into_iter().map(of).collect())
    }

    fn applies_at_once(effect: &Effect) -> bool {
        effect.deleted.len() + effect.inserted.len() <= STEP_BODIES
    }

    fn apply_in_steps(access: &impl Access<Engine>, effect: &Effect) -> bool {
        let deletions = effect.deleted.chunks(STEP_BODIES).map(|some| Effect {
            deleted: some.to_vec(),
            inserted: Vec::new(),
        });
        let insertions = effect.inserted.chunks(STEP_BODIES).map(|some| Effect {
            deleted: Vec::new(),
            inserted: some.to_vec(),
        });
        let mut steps = deletions.chain(insertions);
        steps.all(|step| access.step(|engine| engine.apply(&step).is_ok()))
    }

    fn dry_run(engine: &Engine, effect: &Effect) -> Option<SolidTotals> {
        let (union, error_max) = engine
            .dry_run(effect)
            .expect("an effect fits the set that it was judged against");
        Some(SolidTotals { union, error_max })
    }

    fn note_near((): &mut (), _: CubeId, _: &Body) {}

    fn clear_near((): &mut ()) {}

    fn count(totals: &SolidTotals) -> u64 {
        totals.union.solids
    }

    fn removed(totals: &SolidTotals) -> i128 {
        totals.union.measures.volume6
    }

    fn agree(one: &SolidTotals, other: &SolidTotals) -> bool {
        one.union == other.union
    }

    fn recount(
        header: &Header<Self>,
        bodies: Vec<Body>,
        goes_on: &dyn Fn() -> bool,
    ) -> Option<SolidTotals> {
        let union = recount_while(header.stock.clone(), bodies.into_iter(), goes_on)?;
        Some(SolidTotals {
            union,
            error_max: ErrorMax::default(),
        })
    }
}
