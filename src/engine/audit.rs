//! The recount: totals from the cubes alone, to be compared with the ones kept.

use crate::geometry::{CubeId, Edge, Effect, Place, Stock, Totals};

use super::Engine;

/// Recounts the totals from the places of the cubes alone, sharing no state with any engine. O(cubes).
///
/// Cubes come to it in another order, without deletions, and so through other neighbourhoods and other covered cubes. It shares
/// the kernel, whose own reference are the voxels of the tests.
pub fn recount(edge: Edge, stock: Option<Stock>, cubes: impl Iterator<Item = Place>) -> Totals {
    let mut engine = Engine::new(edge).with_stock(stock);
    let inserted = cubes
        .zip(0..)
        .map(|(place, id)| (CubeId(id), place))
        .collect();
    let effect = Effect {
        deleted: Vec::new(),
        inserted,
    };
    engine
        .apply(&effect)
        .expect("consecutive ids in an empty engine fit");
    engine.totals()
}
