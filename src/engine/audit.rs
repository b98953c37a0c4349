//! The recount: totals from the cubes alone, to be compared with the ones kept.

use crate::geometry::{CubeId, Edge, Effect, Place, Stock, Totals};

use super::Engine;

/// Cubes between two questions whether to go on.
const CUBES_AT_ONCE: usize = 1 << 18;

/// Recounts the totals from the places of the cubes alone, sharing no state with any engine. O(cubes).
///
/// Cubes come to it in another order, without deletions, and so through other neighbourhoods and other covered cubes. It shares
/// the kernel, whose own reference are the voxels of the tests.
pub fn recount(edge: Edge, stock: Option<Stock>, cubes: impl Iterator<Item = Place>) -> Totals {
    recount_while(edge, stock, cubes, &|| true).expect("it goes on")
}

/// The same, as long as `goes_on`, which is asked every 2^18 cubes, says yes; none when it says no.
pub fn recount_while(
    edge: Edge,
    stock: Option<Stock>,
    cubes: impl Iterator<Item = Place>,
    goes_on: &dyn Fn() -> bool,
) -> Option<Totals> {
    let mut engine = Engine::new(edge).with_stock(stock);
    let mut numbered = (0..).map(CubeId).zip(cubes);
    loop {
        if !goes_on() {
            return None;
        }
        let inserted: Vec<_> = numbered.by_ref().take(CUBES_AT_ONCE).collect();
        if inserted.is_empty() {
            return Some(engine.totals());
        }
        let effect = Effect {
            deleted: Vec::new(),
            inserted,
        };
        engine
            .apply(&effect)
            .expect("consecutive ids in an empty engine fit");
    }
}
