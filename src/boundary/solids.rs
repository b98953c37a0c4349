//! The faces of a scene of solids, from the exact edges of its union.

use std::ops::ControlFlow;

use crate::engine::solids::{Body, SolidId, Stock};
use crate::geometry::Bounds;

use super::face::{FaceSink, NoStock, Region};

/// Lists the exposed faces of a region, plane by plane.
///
/// `within` keeps what lies in a closed box of lattice points and half a step around it, exactly cut there: no plane of a lattice solid is
/// half-way between lattice points, so that neighbouring boxes, such as 0 to 9 and 10 to 19, share out every face. The surface is open there.
/// `goes_on` is asked now and then; a listing that it or the sink ends is a break.
/// # Errors
/// [`NoStock`] for a region of the stock where there is none.
pub fn faces(
    _bodies: impl Iterator<Item = (SolidId, Body)>,
    stock: Option<&Stock>,
    region: Region,
    _within: Option<Bounds>,
    _goes_on: &dyn Fn() -> bool,
    _sink: &mut FaceSink,
) -> Result<ControlFlow<()>, NoStock> {
    if region != Region::Union && stock.is_none() {
        return Err(NoStock);
    }
    todo!("the enumeration of edges")
}
