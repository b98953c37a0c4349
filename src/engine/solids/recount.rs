//! The recount: totals from the bodies alone, to be compared with the ones kept.

use super::{Body, Effect, Engine, SolidId, Stock, Totals};

/// Recounts the totals from the stock and the bodies alone, sharing no state with any engine. O(bodies), each in its neighbourhood.
///
/// They come one after the other into an empty scene, without deletions, and so through other neighbourhoods and other witnesses.
pub fn recount(stock: Option<Stock>, bodies: impl Iterator<Item = Body>) -> Totals {
    recount_in(Engine::new().with_stock(stock), bodies)
}

/// The same in big integers alone, without a filter. Much slower.
pub fn recount_exactly(stock: Option<Stock>, bodies: impl Iterator<Item = Body>) -> Totals {
    recount_in(Engine::exact().with_stock(stock), bodies)
}

fn recount_in(mut engine: Engine, bodies: impl Iterator<Item = Body>) -> Totals {
    let inserted = (0..).map(SolidId).zip(bodies).collect();
    let effect = Effect {
        deleted: Vec::new(),
        inserted,
    };
    engine
        .apply(&effect)
        .expect("consecutive ids in an empty engine fit");
    engine.totals()
}
