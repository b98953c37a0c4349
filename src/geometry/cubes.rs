//! Sets of cubes or other bodies: the difference between two of them; and the totals of one.

use super::lattice::{Bounds, CubeId, Place, Stock};
use super::measures::Measures;

/// The difference between two sets of bodies (cubes, known by their places): an id that has the same body in both is in neither
/// list. A moved one is in both. Order: by id's first appearance.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Effect<Body = Place> {
    /// Bodies that go, each as it was.
    pub deleted: Vec<(CubeId, Body)>,
    /// Bodies that come.
    pub inserted: Vec<(CubeId, Body)>,
}

impl<Body> Default for Effect<Body> {
    fn default() -> Self {
        Self {
            deleted: Vec::new(),
            inserted: Vec::new(),
        }
    }
}

/// The state of a scene's measures at one moment: a pure function of its set of cubes.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Totals {
    /// How many cubes, two at one place counted twice.
    pub cubes: u64,
    /// The measures of their union.
    pub measures: Measures,
    /// The box around them; none when there are none.
    pub bounds: Option<Bounds>,
    /// What the cubes do to the scene's stock; none when the scene has none.
    pub stock: Option<StockMeasures>,
}

/// A stock from which the union of the cubes is cut. Both parts are regularised; their volumes add up to the stock's.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct StockMeasures {
    /// The union inside the stock.
    pub removed: Measures,
    /// The stock outside the union.
    pub remaining: Measures,
}

impl StockMeasures {
    /// Adds a difference, as an insertion does.
    pub fn add(&mut self, difference: &Self) {
        self.removed.add(&difference.removed);
        self.remaining.add(&difference.remaining);
    }

    /// Retracts a difference, as a deletion does.
    pub fn retract(&mut self, difference: &Self) {
        self.removed.retract(&difference.removed);
        self.remaining.retract(&difference.remaining);
    }
}

impl Totals {
    /// The totals of a scene without cubes.
    pub fn of_nothing(stock: Option<Stock>) -> Self {
        Self {
            stock: stock.map(|stock| StockMeasures {
                removed: Measures::default(),
                remaining: Measures::of_box(stock.bounds()),
            }),
            ..Self::default()
        }
    }
}
