//! Which cubes or solids hold a point.

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::request::{ABOUT_IDS, Parameters, Path};
use super::{App, scenes};
use crate::engine::Side;
use crate::wire::calls;
use crate::wire::documents::{Cube, IdForm};
use crate::wire::kind::Opened;
use crate::wire::problem::{Fault, Problem};
use crate::wire::solids::SolidDocument;

/// Where a point lies.
#[derive(Serialize, ToSchema)]
#[expect(
    clippy::option_option,
    reason = "what is of the other kind of scene is left out; else it is null or there"
)]
pub(crate) struct Containment {
    /// The change that this is as of.
    seq: u64,
    /// Where the point lies.
    side: SideName,
    /// A cube that holds it, its faces included; null when there is none. Of a scene of cubes.
    #[serde(skip_serializing_if = "Option::is_none")]
    cube: Option<Option<Cube>>,
    /// A solid that holds it, its faces included; null when there is none. Of a scene of solids.
    #[serde(skip_serializing_if = "Option::is_none")]
    solid: Option<Option<SolidDocument>>,
    /// The lattice point that was asked about, in user units.
    #[schema(min_items = 3, max_items = 3)]
    point: [f64; 3],
}

/// Where a point lies.
#[derive(Serialize, ToSchema)]
#[schema(as = Side)]
#[serde(rename_all = "lowercase")]
enum SideName {
    /// In the interior of the union.
    Inside,
    /// On its boundary.
    Boundary,
    /// Outside.
    Outside,
}

/// Ask where a point lies
///
/// The point is rounded to the lattice as the scene's settings say. Of a scene of solids with a stock, the union is what they remove from it.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/contains", tag = "mass properties",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("at" = String, Query, pattern = r"^[-+]?[0-9]{1,15}(\.[0-9]{0,15})?(e[-+]?[0-9]{1,2})?(,[-+]?[0-9]{1,15}(\.[0-9]{0,15})?(e[-+]?[0-9]{1,2})?){2}$", description = "`x,y,z` in user units", example = "1.5,2,0"),
        ("ids" = inline(Option<IdForm>), Query, description = ABOUT_IDS, example = "text"),
    ),
    responses((status = 200, description = "Where it lies", body = Containment))
)]
pub(super) async fn get_contains(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
) -> Result<Json<Containment>, Problem> {
    let query = parameters.only(&["at", "ids"])?;
    let ids = query.ids()?;
    let (sent, at) = point(query.text("at"))?;
    Ok(Json(match scenes::open_any(&app, &name)? {
        Opened::Cubes(scene, settings) => {
            let point = calls::point(at, sent, &settings)?;
            let (seq, side, cube) = scene.contains(point).await?;
            Containment {
                seq: seq.0,
                side: side.into(),
                cube: Some(cube.map(|cube| Cube::new(cube, ids, &settings))),
                solid: None,
                point: settings.point_user(point),
            }
        }
        Opened::Solids(scene, settings) => {
            let scale = settings.scale();
            let point = calls::point_among_solids(at, sent, scale)?;
            let (seq, side, solid) = scene.contains(point).await?;
            let shapes = scene.context()?;
            let shown = solid.map(|solid| SolidDocument::of(&solid, ids, &shapes, scale));
            Containment {
                seq: seq.0,
                side: side.into(),
                cube: None,
                solid: Some(shown),
                point: scale.position(point),
            }
        }
    }))
}

impl From<Side> for SideName {
    fn from(side: Side) -> Self {
        match side {
            Side::Inside => Self::Inside,
            Side::Boundary => Self::Boundary,
            Side::Outside => Self::Outside,
        }
    }
}

/// The numbers of `x,y,z`, and what was sent.
fn point(text: Option<&str>) -> Result<(&str, [f64; 3]), Problem> {
    let text = text.unwrap_or_default();
    let numbers = text.split(',').map(|number| number.trim().parse().ok());
    let numbers: Option<Vec<f64>> = numbers.collect();
    match numbers.and_then(|numbers| <[f64; 3]>::try_from(numbers).ok()) {
        Some(at) => Ok((text, at)),
        None => Err(Fault::in_parameter("at", calls::NO_POINT, text).into()),
    }
}
