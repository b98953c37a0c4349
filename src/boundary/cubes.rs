//! The faces of a scene of cubes, in floats: exact, since halves of lattice coordinates are.

use std::ops::ControlFlow;

use crate::engine::faces::{self, Material, PlaneFace};
use crate::geometry::{Bounds, CubeId, Edge, Place, Stock};

use super::face::{Face, FaceSink, NoStock, Region};

/// Lists the exposed faces of a region, each oriented plane once, in an order that the set of cubes alone decides. O(cubes), each in its
/// neighbourhood.
///
/// `within` keeps what lies in a closed box of lattice points and half a step around it, exactly cut there: neighbouring boxes, such as 0 to 9
/// and 10 to 19, share out every face. The surface is open there. `goes_on` is asked now and then; a listing that it or the sink ends is a
/// break.
/// # Errors
/// [`NoStock`] for a region of the stock where there is none.
pub fn faces(
    cubes: impl Iterator<Item = (CubeId, Place)>,
    edge: Edge,
    stock: Option<Stock>,
    region: Region,
    within: Option<Bounds>,
    goes_on: &dyn Fn() -> bool,
    sink: &mut FaceSink,
) -> Result<ControlFlow<()>, NoStock> {
    let material = match region {
        Region::Union => Material::Union,
        Region::Removed => Material::Removed(stock.ok_or(NoStock)?),
        Region::Remaining => Material::Remaining(stock.ok_or(NoStock)?),
    };
    let mut face = Face {
        body: None,
        normal: [0.0; 3],
        edges: Vec::new(),
    };
    let mut hand_out = |listed: &PlaneFace<'_>| {
        face.body = listed.body;
        face.normal = [0.0; 3];
        face.normal[listed.axis] = if listed.is_upward { 1.0 } else { -1.0 };
        let point = |ends: [i64; 2]| {
            let mut point = [f64::from(listed.at); 3];
            for (next, end) in ends.into_iter().enumerate() {
                point[(listed.axis + next + 1) % 3] = halved(end);
            }
            point
        };
        face.edges.clear();
        let edges = listed.edges.iter().map(|ends| ends.map(point));
        face.edges.extend(edges);
        sink(&face)
    };
    Ok(faces::faces(
        cubes,
        edge,
        material,
        within,
        goes_on,
        &mut hand_out,
    ))
}

/// Half steps in steps. Exact.
#[expect(
    clippy::cast_precision_loss,
    reason = "lattice coordinates are below 2^31, twice as many half steps"
)]
fn halved(half_steps: i64) -> f64 {
    half_steps as f64 / 2.0
}
