//! The material in an engine of solids: what is removed, and what would be.

use union3d::engine::solids::{
    AREA_UNIT, Body, Effect, Engine, SolidId, Stock, Totals, VOLUME_UNIT,
};
use union3d::geometry::Bounds;
use union3d::geometry::convex::{Deviation, Fit, Point, Solid, cone};
use union3d::wire::solids::Scale;

use super::super::stock::StockForm;
use super::bodies::Swept;

/// Units of volume in a step cubed, as the engine's `volume6` counts them.
pub(super) const VOLUME_UNITS: f64 = (6 << -VOLUME_UNIT) as f64;

/// Units of area in a step squared, as the engine's `area2` counts them.
pub(super) const AREA_UNITS: f64 = (2_u32 << -AREA_UNIT) as f64;

/// Sides of the polygon that stands for a round stock.
const STOCK_SIDES: u16 = 128;

/// The material: a stock from which tools remove what they sweep, or without one just what they sweep.
pub(super) struct Material {
    engine: Engine,
    next_id: u64,
    /// Box around the stock.
    bounds: Option<Bounds>,
    /// How far the polygon of a round stock is from the circle.
    pub(super) deviation: Deviation,
}

impl Material {
    /// # Errors
    /// A sentence says what is wrong with the stock.
    pub(super) fn new(stock: Option<&StockForm>, scale: Scale) -> Result<Self, String> {
        let mut deviation = Deviation::default();
        let stock = match stock {
            Some(form) => {
                let solid = solid(form, scale, &mut deviation)
                    .map_err(|wrong| format!("--stock {wrong}"))?;
                Some(Stock::new(solid).map_err(|invalid| format!("--stock: {invalid}"))?)
            }
            None => None,
        };
        Ok(Self {
            bounds: stock.as_ref().map(|stock| stock.solid().bounds()),
            engine: Engine::new().with_stock(stock),
            next_id: 1,
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

    /// Removes what is swept, and answers how much that is. Units: [`VOLUME_UNITS`].
    pub(super) fn remove(&mut self, body: Body) -> i128 {
        let before = self.removed();
        let effect = self.effect(body);
        self.next_id += 1;
        self.engine.apply(&effect).expect("the id is new");
        self.removed() - before
    }

    /// How much of the material is in a body. Units: [`VOLUME_UNITS`].
    pub(super) fn inside(&mut self, body: Body) -> i128 {
        let effect = self.effect(body);
        let (totals, _) = self.engine.dry_run(&effect).expect("the id is new");
        totals.measures.volume6 - self.removed()
    }

    fn effect(&self, body: Body) -> Effect {
        Effect {
            deleted: vec![],
            inserted: vec![(SolidId(self.next_id), body)],
        }
    }

    /// All that is removed. Units: [`VOLUME_UNITS`].
    pub(super) fn removed(&self) -> i128 {
        self.engine.totals().measures.volume6
    }

    /// The area around what is removed. Units: [`AREA_UNITS`].
    pub(super) fn area(&self) -> i128 {
        self.engine.totals().measures.area2
    }

    pub(super) fn totals(&self) -> Totals {
        self.engine.totals()
    }

    pub(super) fn error_max(&self) -> union3d::engine::solids::ErrorMax {
        self.engine.error_max()
    }
}

fn solid(form: &StockForm, scale: Scale, deviation: &mut Deviation) -> Result<Solid, String> {
    let at = |at: [f64; 3]| scale.point(at, "").map_err(|fault| fault.to_string());
    match form {
        StockForm::Box([min, max]) => {
            let corners = [at(*min)?, at(*max)?];
            let [min, max] = corners.map(Point::coordinates);
            if (0..3).any(|axis| min[axis] >= max[axis]) {
                return Err("leaves no volume: its greatest corner is not above its least".into());
            }
            Solid::cuboid(corners[0], corners[1]).map_err(|invalid| invalid.to_string())
        }
        StockForm::Cylinder {
            base,
            diameter,
            height,
        } => {
            let size = at([*diameter, 0.0, *height])?.coordinates();
            let diameter = u32::try_from(size[0]).map_err(|_| "is too wide".to_owned())?;
            let ends = [(diameter, 0), (diameter, i64::from(size[2]))];
            let (solid, own) =
                cone(ends, STOCK_SIDES, Fit::EqualArea).map_err(|invalid| invalid.to_string())?;
            *deviation = own;
            solid
                .displaced(at(*base)?.wide())
                .map_err(|invalid| invalid.to_string())
        }
        StockForm::Hull(points) => {
            let points: Result<Vec<Point>, String> =
                points.iter().map(|point| at(*point)).collect();
            Solid::hull(&points?).map_err(|invalid| invalid.to_string())
        }
    }
}
