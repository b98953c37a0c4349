//! How far the polygons that stand for circles are from them, as it is answered and stored.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::scale::Scale;
use crate::geometry::convex::Deviation;

/// How far, at most, the polygons that stand for circles are from them, in user units.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub(in crate::wire) struct PolygonError {
    /// How far they reach outside of the circles.
    pub(in crate::wire) outside: f64,
    /// How far they stay inside of them.
    pub(in crate::wire) inside: f64,
}

impl PolygonError {
    pub(super) fn of(Deviation { outside, inside }: Deviation, scale: Scale) -> Self {
        Self {
            outside: scale.deviation(outside),
            inside: scale.deviation(inside),
        }
    }
}
