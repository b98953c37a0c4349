//! Scenes: create, list, one, drop.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::Serialize;
use utoipa::ToSchema;

use super::request::{self, BodyType, Parameters, Path, Room, body_type};
use super::{App, Limits};
use crate::service::{AnyScene, Scene, SceneState, SolidScene};
use crate::wire::access::Ticket;
use crate::wire::calls::{self, incarnation};
use crate::wire::convert::{Settings, SettingsDocument};
use crate::wire::decode;
use crate::wire::kind::Opened;
use crate::wire::problem::Problem;
use crate::wire::solids::{SolidSceneSettings, SolidSettings, SolidSettingsDocument};

/// Largest body that settings can fill sensibly, some shapes among them.
const SETTINGS_BYTES_MAX: usize = 1 << 20;

/// A scene.
#[derive(Serialize, ToSchema)]
#[expect(
    clippy::option_option,
    reason = "a count is left out, null or a number"
)]
pub(crate) struct SceneDocument {
    /// Its name.
    #[schema(example = "pocket")]
    name: String,
    /// Its settings, of a scene of cubes; left out when its files do not tell.
    #[serde(flatten)]
    settings: Option<SettingsDocument>,
    /// Its settings, of a scene of solids; left out when its files do not tell.
    #[serde(flatten)]
    solid_settings: Option<SolidSceneSettings>,
    /// Number of cubes, of a scene of cubes; null while it does not answer.
    #[serde(skip_serializing_if = "Option::is_none")]
    cubes: Option<Option<u64>>,
    /// Number of solids, of a scene of solids; null while it does not answer.
    #[serde(skip_serializing_if = "Option::is_none")]
    solids: Option<Option<u64>>,
    /// Newest durable change; null while it does not answer.
    seq: Option<u64>,
    /// Name of this life of the scene: another one after it was dropped and created again.
    #[schema(example = "6f1d3c0a9b2e4d57")]
    incarnation: String,
    /// How it is.
    state: State_,
    /// How far its replay is, 0 to 100.
    #[serde(skip_serializing_if = "Option::is_none")]
    percent: Option<u8>,
    /// Why it does not answer.
    #[serde(skip_serializing_if = "Option::is_none")]
    cause: Option<String>,
}

/// How a scene is.
#[derive(Serialize, ToSchema)]
#[schema(as = SceneState)]
#[serde(rename_all = "lowercase")]
enum State_ {
    /// Answers.
    Running,
    /// Is being replayed.
    Recovering,
    /// A write failed; it comes back by itself.
    Stopped,
    /// Its files are damaged; it does not come back by itself.
    Damaged,
    /// A newer version of this program made its files; this one leaves them alone.
    Newer,
}

/// All scenes.
#[derive(Serialize, ToSchema)]
pub(crate) struct SceneList {
    /// By name.
    scenes: Vec<SceneDocument>,
}

fn document(scene: &AnyScene) -> SceneDocument {
    let newest = scene.newest();
    let (state, percent, cause) = match scene.state() {
        SceneState::Running => (State_::Running, None, None),
        SceneState::Recovering { percent } => (State_::Recovering, Some(percent), None),
        SceneState::Stopped { cause, .. } => (State_::Stopped, None, Some(cause)),
        SceneState::Damaged { cause } => (State_::Damaged, None, Some(cause)),
        SceneState::Newer { cause } => (State_::Newer, None, Some(cause)),
    };
    let count = newest.map(|(_, count)| count);
    let (settings, solid_settings, cubes, solids) = match scene {
        AnyScene::Cubes(scene) => {
            let settings = calls::settings(scene).map(|settings| settings.document());
            (settings, None, Some(count), None)
        }
        AnyScene::Solids(scene) => {
            let shapes = scene.context().ok();
            let settings = calls::settings(scene);
            let shown = settings.map(|settings| settings.shown(shapes.as_deref()));
            (None, shown, None, Some(count))
        }
    };
    SceneDocument {
        name: scene.name().as_str().to_owned(),
        settings,
        solid_settings,
        cubes,
        solids,
        seq: newest.map(|(seq, _)| seq.0),
        incarnation: incarnation(scene.incarnation()),
        state,
        percent,
        cause,
    }
}

/// A scene with the settings that this module gave it.
pub(super) fn open(app: &App, name: &str) -> Result<(Arc<Scene>, Arc<Settings>), Problem> {
    calls::open(&app.service, name)
}

/// The same of a scene of solids.
pub(super) fn open_solids(
    app: &App,
    name: &str,
) -> Result<(Arc<SolidScene>, Arc<SolidSettings>), Problem> {
    calls::open_solids(&app.service, name)
}

/// The same of a scene of either kind.
pub(super) fn open_any(app: &App, name: &str) -> Result<Opened, Problem> {
    calls::open_any(&app.service, name)
}

/// Settings of a scene of either kind.
#[derive(ToSchema)]
#[serde(untagged)]
#[expect(
    dead_code,
    reason = "it stands in the description; each is read by what its kind is"
)]
pub(crate) enum AnySettings {
    /// Of cubes.
    Cubes(SettingsDocument),
    /// Of solids.
    Solids(SolidSettingsDocument),
}

/// Create a scene
///
/// Of cubes, where only `edge` has no default; or of solids, with `kind`, which holds for the scene's life. A scene that exists with the same
/// settings, and has the shapes, is left as it is.
#[utoipa::path(
    put, path = "/v1/scenes/{scene}", tag = "scenes",
    params(("scene" = String, Path, description = "Name: `[a-z0-9][a-z0-9._-]{0,62}`", example = "pocket")),
    request_body(content = AnySettings, content_type = "application/json",
        example = json!({"edge": 6, "steps_per_unit": 1000, "unit": "mm", "density": 1, "anchor": "corner", "rounding": "nearest"})),
    responses(
        (status = 201, description = "Created", body = SceneDocument),
        (status = 200, description = "Exists with the same settings", body = SceneDocument),
    )
)]
pub(super) async fn put_scene(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
    headers: HeaderMap,
    room: Room,
    body: Body,
) -> Result<Response, Problem> {
    parameters.only(&[])?;
    let name = calls::scene_name(&name)?;
    body_type(&headers, &[BodyType::Json])?;
    let limits = Limits {
        body_bytes_max: app.limits.body_bytes_max.min(SETTINGS_BYTES_MAX),
        ..app.limits
    };
    let body = request::read(&headers, body, &limits, room).await?;
    let (scene, new) = if decode::is_of_solids(&body.bytes) {
        let wanted = decode::solid_settings(&body.bytes)?;
        let (scene, new) = calls::create_solids(&app.service, &name, &wanted).await?;
        (AnyScene::Solids(scene), new)
    } else {
        let settings = decode::settings(&body.bytes)?;
        let (scene, new) = calls::create(&app.service, &name, &settings).await?;
        (AnyScene::Cubes(scene), new)
    };
    let status = if new {
        StatusCode::CREATED
    } else {
        StatusCode::OK
    };
    Ok((status, Json(document(&scene))).into_response())
}

/// List the scenes
///
/// Those that the key may read.
#[utoipa::path(
    get, path = "/v1/scenes", tag = "scenes",
    responses((status = 200, description = "All scenes", body = SceneList))
)]
pub(super) async fn get_scenes(
    State(app): State<App>,
    Extension(ticket): Extension<Ticket>,
    parameters: Parameters,
) -> Result<Json<SceneList>, Problem> {
    parameters.only(&[])?;
    let scenes = app.service.scenes();
    let readable = scenes
        .iter()
        .filter(|scene| ticket.may_read(scene.name().as_str()));
    Ok(Json(SceneList {
        scenes: readable.map(document).collect(),
    }))
}

/// Get a scene
///
/// Its settings, how many cubes it has and how it is; also while it does not answer.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}", tag = "scenes",
    params(("scene" = String, Path, description = "Name of the scene", example = "pocket")),
    responses((status = 200, description = "The scene", body = SceneDocument))
)]
pub(super) async fn get_scene(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
) -> Result<Json<SceneDocument>, Problem> {
    parameters.only(&[])?;
    Ok(Json(document(&app.service.any_scene(&name)?)))
}

/// Drop a scene with its data
#[utoipa::path(
    delete, path = "/v1/scenes/{scene}", tag = "scenes",
    params(("scene" = String, Path, description = "Name of the scene", example = "pocket")),
    responses((status = 204, description = "Dropped"))
)]
pub(super) async fn delete_scene(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
) -> Result<StatusCode, Problem> {
    parameters.only(&[])?;
    calls::remove(&app.service, &name).await?;
    Ok(StatusCode::NO_CONTENT)
}
