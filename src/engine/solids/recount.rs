//! The recount: totals from the bodies alone, to be compared with the ones kept.

use super::{Body, Effect, Engine, SolidId, Stock, Totals};

/// Bodies between two questions whether to go on.
const BODIES_AT_ONCE: usize = 1 << 12;

/// Recounts the totals from the stock and the bodies alone, sharing no state with any engine. O(bodies), each in its neighbourhood.
///
/// They come one after the other into an empty scene, without deletions, and so through other neighbourhoods and other witnesses.
pub fn recount(stock: Option<Stock>, bodies: impl Iterator<Item = Body>) -> Totals {
    recount_while(stock, bodies, &|| true).expect("it goes on")
}

/// The same, as long as `goes_on`, which is asked every 2^12 bodies, says yes; none when it says no.
pub fn recount_while(
    stock: Option<Stock>,
    bodies: impl Iterator<Item = Body>,
    goes_on: &dyn Fn() -> bool,
) -> Option<Totals> {
    recount_in(Engine::new().with_stock(stock), bodies, goes_on)
}

/// The same as [`recount`] in big integers alone, without a filter. Much slower.
pub fn recount_exactly(stock: Option<Stock>, bodies: impl Iterator<Item = Body>) -> Totals {
    recount_in(Engine::exact().with_stock(stock), bodies, &|| true).expect("it goes on")
}

fn recount_in(
    mut engine: Engine,
    bodies: impl Iterator<Item = Body>,
    goes_on: &dyn Fn() -> bool,
) -> Option<Totals> {
    let mut numbered = (0..).map(SolidId).zip(bodies);
    loop {
        if !goes_on() {
            return None;
        }
        let inserted: Vec<_> = numbered.by_ref().take(BODIES_AT_ONCE).collect();
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
