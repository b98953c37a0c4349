//! The material: the stock as it is written, and an engine in this process in which tools remove what they sweep.

use union3d::engine::solids::{
    AREA_UNIT, Body, Effect, Engine, ErrorMax, Measures, SolidId, Stock, Totals, VOLUME_UNIT,
};
use union3d::geometry::Bounds;
use union3d::geometry::convex::{Deviation, Point};
use union3d::wire::solids::{ReadStock, Scale, SolidStockDocument};

use super::super::super::stock::StockForm;
use super::super::line::Material as State;
use super::bodies::Swept;

/// Units of volume in a step cubed, as the engine's `volume6` counts them.
pub(super) const VOLUME_UNITS: f64 = (6 << -VOLUME_UNIT) as f64;

/// Units of area in a step squared, as the engine's `area2` counts them.
pub(super) const AREA_UNITS: f64 = (2_u32 << -AREA_UNIT) as f64;

/// An id that no solid of a program has.
const NO_SOLID: SolidId = SolidId(u64::MAX);

/// The stock before anything is cut, if there is one: without, what tools sweep is measured. Cheap to clone.
#[derive(Clone)]
pub(super) struct Blank {
    stock: Option<Stock>,
    /// As a server is told of it.
    pub(super) document: Option<SolidStockDocument>,
    /// Box around the stock.
    bounds: Option<Bounds>,
    /// How far the polygon of a round stock is from the circle.
    pub(super) deviation: Deviation,
}

impl Blank {
    /// # Errors
    /// A sentence says what is wrong with the stock.
    pub(super) fn new(form: Option<&StockForm>, scale: Scale) -> Result<Self, String> {
        let read = form.map(|form| form.read(scale)).transpose()?;
        let Some(ReadStock {
            stock,
            document,
            deviation,
        }) = read
        else {
            return Ok(Self {
                stock: None,
                document: None,
                bounds: None,
                deviation: Deviation::default(),
            });
        };
        Ok(Self {
            bounds: Some(stock.solid().bounds()),
            stock: Some(stock),
            document: Some(document),
            deviation,
        })
    }

    /// The height of the stock's top. Units: steps.
    pub(super) fn top(&self) -> Option<i32> {
        self.bounds.map(|bounds| bounds.max[2])
    }

    /// Whether what is swept may have something in common with the stock: by the boxes around both.
    pub(super) fn is_near(&self, swept: &Swept, ends: [Point; 2]) -> bool {
        let Some(stock) = self.bounds else {
            return true;
        };
        let ends = ends.map(Point::wide);
        (0..3).all(|axis| {
            let own = [swept.bounds.min[axis], swept.bounds.max[axis]].map(i64::from);
            let least = own[0] + ends[0][axis].min(ends[1][axis]);
            let most = own[1] + ends[0][axis].max(ends[1][axis]);
            least < i64::from(stock.max[axis]) && most > i64::from(stock.min[axis])
        })
    }
}

/// What is removed from a stock, in this process.
pub(super) struct Material {
    engine: Engine,
    /// Whether the contact of moves is worked out.
    says_contact: bool,
}

impl Material {
    /// The whole stock.
    pub(super) fn new(blank: &Blank) -> Self {
        Self {
            engine: Engine::new().with_stock(blank.stock.clone()),
            says_contact: false,
        }
    }

    /// The same, where the contact of moves is worked out if that is wanted.
    pub(super) fn with_contact(self, says_contact: bool) -> Self {
        Self {
            says_contact,
            ..self
        }
    }

    /// Whether the contact of moves is worked out.
    pub(super) fn says_contact(&self) -> bool {
        self.says_contact
    }

    /// Removes bodies one after the other, and answers what each removes.
    pub(super) fn remove(&mut self, bodies: Vec<(SolidId, Body)>) -> Vec<State> {
        let mut before = self.state();
        let after = self.engine.insert_each(bodies).expect("the ids are new");
        let more = after.iter().map(|totals| {
            let after = state(&totals.measures);
            let before = std::mem::replace(&mut before, after);
            State {
                removed: after.removed - before.removed,
                area: after.area - before.area,
            }
        });
        more.collect()
    }

    /// Removes the bodies of moves, one move after the other, and answers what each removes, and its contact in [`AREA_UNITS`] where that is
    /// known.
    pub(super) fn remove_moves(
        &mut self,
        moves: Vec<Vec<(SolidId, Body)>>,
    ) -> Vec<(State, Option<i128>)> {
        if self.says_contact {
            let added = self.engine.insert_moves(moves).expect("the ids are new");
            let removed = added.iter();
            return removed
                .map(|added| (state(&added.measures), added.contact2))
                .collect();
        }
        let counts: Vec<usize> = moves.iter().map(Vec::len).collect();
        let mut removed = self
            .remove(moves.into_iter().flatten().collect())
            .into_iter();
        let of_moves = counts.into_iter().map(|count| {
            let mut sum = State::default();
            removed.by_ref().take(count).for_each(|more| sum.add(more));
            (sum, None)
        });
        of_moves.collect()
    }

    /// How much of the material is in a body. Units: [`VOLUME_UNITS`].
    pub(super) fn inside(&self, body: Body) -> i128 {
        let effect = Effect {
            deleted: vec![],
            inserted: vec![(NO_SOLID, body)],
        };
        let (totals, _) = self.engine.dry_run(&effect).expect("the id is new");
        totals.measures.volume6 - self.state().removed
    }

    /// What is removed by now.
    pub(super) fn state(&self) -> State {
        state(&self.engine.totals().measures)
    }

    pub(super) fn totals(&self) -> (Totals, ErrorMax) {
        (self.engine.totals(), self.engine.error_max())
    }
}

/// What is removed. Units: [`VOLUME_UNITS`], [`AREA_UNITS`].
fn state(measures: &Measures) -> State {
    State {
        removed: measures.volume6,
        area: measures.area2,
    }
}
