//! A copy of a scene's log.

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use headers::{ContentLength, HeaderMapExt};
use tokio_util::io::ReaderStream;

use super::reads::entity_tag;
use super::request::{Parameters, Path};
use super::{App, scenes};
use crate::service::{Copied, SceneKind, SceneOf};
use crate::wire::kind::Opened;
use crate::wire::problem::Problem;

/// Bytes of the file that are read at once.
const PIECE_BYTES: usize = 64 << 10;

/// Copy a scene
///
/// A consistent copy at one seq, which the entity tag names, while changes go on: one file that `union3d restore` makes a scene of again,
/// with its history, its idempotency keys and its incarnation. Until it is sent it takes as much space in the data directory as the scene.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/backup", tag = "operation",
    params(("scene" = String, Path, description = "Name of the scene", example = "pocket")),
    responses((status = 200, description = "The copy", body = Vec<u8>, content_type = "application/vnd.sqlite3"))
)]
pub(super) async fn get_backup(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
) -> Result<Response, Problem> {
    parameters.only(&[])?;
    match scenes::open_any(&app, &name)? {
        Opened::Cubes(scene, _) => Ok(answer(&scene, scene.copy().await?)),
        Opened::Solids(scene, _) => Ok(answer(&scene, scene.copy().await?)),
    }
}

fn answer<K: SceneKind>(scene: &SceneOf<K>, copied: Copied) -> Response {
    let Copied { seq, file, size } = copied;
    let mut headers = HeaderMap::new();
    headers.insert(
        header::CONTENT_TYPE,
        HeaderValue::from_static("application/vnd.sqlite3"),
    );
    let name = format!("attachment; filename=\"{}.union3d\"", scene.name().as_str());
    let name = HeaderValue::from_str(&name).expect("a scene's name is plain");
    headers.insert(header::CONTENT_DISPOSITION, name);
    headers.typed_insert(ContentLength(size));
    headers.typed_insert(entity_tag(scene, seq));
    let file = tokio::fs::File::from_std(file);
    let pieces = ReaderStream::with_capacity(file, PIECE_BYTES);
    (headers, Body::from_stream(pieces)).into_response()
}
