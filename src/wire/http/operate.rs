//! Calls for those who run the service: health, readiness, and what the types of problems mean.

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::Serialize;
use utoipa::ToSchema;

use super::App;
use super::page::get_page;
use super::request::{BodyType, Path, VARY, preferred};
use crate::service::Readiness;
use crate::wire::access::Ticket;
use crate::wire::problem::{Code, KINDS, Kind, Problem};

/// That the process runs.
#[derive(Serialize, ToSchema)]
pub(crate) struct Health {
    /// Always `ok`.
    #[schema(example = "ok")]
    status: &'static str,
}

/// Whether the process runs
#[utoipa::path(get, path = "/healthz", tag = "operation",
    responses((status = 200, description = "It runs", body = Health)))]
pub(super) async fn get_healthz() -> Json<Health> {
    Json(Health { status: "ok" })
}

/// That the service answers.
#[derive(Serialize, ToSchema)]
pub(crate) struct Answering {
    /// Always true: otherwise the answer is a problem.
    ready: bool,
    /// Scenes that are stopped or damaged, of those that the key may read; without a key none, where there are keys.
    troubled: Vec<Troubled>,
    /// What those who run the server should know: that it is open to more than it should be, that the file of keys is broken.
    warnings: Vec<String>,
}

/// A scene that does not answer.
#[derive(Serialize, ToSchema)]
pub(crate) struct Troubled {
    /// Its name.
    scene: String,
    /// Why.
    cause: String,
}

/// Whether all scenes are replayed
#[utoipa::path(get, path = "/readyz", tag = "operation",
    responses((status = 200, description = "They are", body = Answering)))]
pub(super) async fn get_readyz(
    State(app): State<App>,
    Extension(ticket): Extension<Ticket>,
) -> Result<Json<Answering>, Problem> {
    match app.service.readiness() {
        Readiness::Ready { mut troubled } => {
            troubled.retain(|(scene, _)| ticket.may_read(scene.as_str()));
            let troubled = troubled.into_iter().map(|(scene, cause)| Troubled {
                scene: scene.as_str().to_owned(),
                cause,
            });
            Ok(Json(Answering {
                ready: true,
                troubled: troubled.collect(),
                warnings: app.access.warnings(),
            }))
        }
        Readiness::Recovering { percent } => {
            let detail = format!("the scenes are being replayed: {percent} %");
            Err(Problem::new(Code::Recovering, detail).with("percent", percent))
        }
    }
}

/// What the types of problems mean.
#[derive(Serialize, ToSchema)]
pub(crate) struct Kinds {
    /// All of them.
    problems: &'static [Kind],
}

/// List the types of problems
///
/// As a page when `text/html` is preferred, as browsers do.
#[utoipa::path(get, path = "/problems", tag = "operation",
    responses((status = 200, description = "All types", body = Kinds)))]
pub(super) async fn get_problems(headers: HeaderMap) -> Response {
    if prefers_page(&headers) {
        return get_page(headers).await;
    }
    (VARY, Json(Kinds { problems: KINDS })).into_response()
}

/// What a type of problem means
///
/// The `type` of every problem is the path of this call. As a page when `text/html` is preferred, as browsers do.
#[utoipa::path(get, path = "/problems/{code}", tag = "operation",
    params(("code" = String, Path, description = "Last part of the type", example = "id-conflict")),
    responses((status = 200, description = "The type", body = Kind)))]
pub(super) async fn get_problem(
    Path(code): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let found = KINDS.iter().find(|kind| kind.code == code);
    let Some(kind) = found else {
        return Err(super::no_such_path(&format!("/problems/{code}")));
    };
    if prefers_page(&headers) {
        return Ok(get_page(headers).await);
    }
    Ok((VARY, Json(*kind)).into_response())
}

fn prefers_page(headers: &HeaderMap) -> bool {
    preferred(headers, &[BodyType::Json, BodyType::Html]) == BodyType::Html
}
