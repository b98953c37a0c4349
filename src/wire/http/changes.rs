//! Changes: atomic ones (JSON, protobuf) here, streams in `ndjson`.

use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use sha2::{Digest, Sha256};
use utoipa::ToSchema;

use super::request::{self, BodyType, Parameters, Path, Whole, body_type, idempotency_key, within};
use super::{App, ndjson, scenes};
use crate::engine::{Counts, Op, Rejected};
use crate::geometry::CubeId;
use crate::service::{Applied, Counting, Operations, Published, Scene, ServiceError, Submission};
use crate::wire::convert::{MassProperties, Settings, mass_properties};
use crate::wire::decode::{self, Decoded};
use crate::wire::problem::{Code, Fault, Problem};

/// Bodies above this are decoded on a thread that may take its time.
const DECODED_INLINE_BYTES_MAX: usize = 64 << 10;

/// What a change did.
#[derive(Serialize, ToSchema)]
pub(crate) struct Answer {
    /// The scene's newest change: this one, unless it changed nothing.
    #[schema(example = 5)]
    seq: u64,
    /// Cubes inserted.
    #[schema(example = 1)]
    inserted: u64,
    /// Cubes deleted.
    #[schema(example = 1)]
    deleted: u64,
    /// Operations that changed nothing.
    #[schema(example = 0)]
    unchanged: u64,
    /// The ids that the server gave, in the order of `insert`; left out when it gave none.
    #[serde(skip_serializing_if = "Option::is_none")]
    assigned: Option<Assigned>,
    /// The totals after it; left out with `return=minimal`.
    #[serde(skip_serializing_if = "Option::is_none")]
    mass_properties: Option<MassProperties>,
}

/// Consecutive ids.
#[derive(Serialize, ToSchema)]
pub(crate) struct Assigned {
    /// The first.
    first: u64,
    /// The last.
    last: u64,
}

/// How much of the answer is wanted.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Return {
    Minimal,
    Representation,
}

pub(super) fn answer(
    scene: &Scene,
    settings: &Settings,
    wanted: Return,
    published: &Published,
    counts: Counts,
    assigned: Option<(CubeId, CubeId)>,
) -> Json<Answer> {
    let name = Some(scene.name().as_str());
    let seq = published.seq.0;
    Json(Answer {
        seq,
        inserted: counts.inserted,
        deleted: counts.deleted,
        unchanged: counts.unchanged,
        assigned: assigned.map(|(first, last)| Assigned {
            first: first.0,
            last: last.0,
        }),
        mass_properties: (wanted == Return::Representation)
            .then(|| mass_properties(name, Some(seq), &published.totals, settings)),
    })
}

fn applied_answer(
    scene: &Scene,
    settings: &Settings,
    wanted: Return,
    applied: &Applied,
) -> Response {
    let Applied {
        published,
        counts,
        assigned,
        replayed,
    } = applied;
    let mut response =
        answer(scene, settings, wanted, published, *counts, *assigned).into_response();
    if *replayed {
        response.headers_mut().insert(
            HeaderName::from_static("idempotency-replayed"),
            HeaderValue::from_static("true"),
        );
    }
    response
}

/// Insert and delete cubes
///
/// `application/json` and `application/x-protobuf` (the message `union3d.v1.Change`) are one atomic change: deletions first, all or
/// nothing. Inserting an id that is there at the same place, or deleting one that is not there, changes nothing and counts as
/// `unchanged`, so a retry is safe. Ids may be left out of all cubes: then the server numbers them, and an `Idempotency-Key`
/// makes a retry safe.
///
/// `application/x-ndjson` is a stream of any length, a line an operation. Lines act in their order and are committed as they
/// arrive; the answer comes at the end and adds them up. At a bad line it stops: all lines before it are committed.
#[utoipa::path(
    post, path = "/v1/scenes/{scene}/changes", tag = "changes",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("return" = Option<String>, Query, description = "`minimal` leaves `mass_properties` out", example = "minimal"),
        ("Idempotency-Key" = Option<String>, Header, description = "1 to 64 visible ASCII characters. The answer to the first change with this key is repeated, with `Idempotency-Replayed: true`. Not for streams"),
    ),
    request_body(content(
        (inline(crate::wire::openapi::ChangeWanted) = "application/json",
            example = json!({"delete": [17], "insert": [{"id": 18, "at": [0, 0, 2.5]}]})),
        (inline(crate::wire::openapi::LineWanted) = "application/x-ndjson",
            example = json!({"insert": {"id": 1, "at": [0, 0, 2.5]}})),
        (Vec<u8> = "application/x-protobuf"),
    )),
    responses((status = 200, description = "Durable", body = Answer,
        headers(("Idempotency-Replayed" = String, description = "`true` when this is the recorded answer to an earlier request"))))
)]
pub(super) async fn post_changes(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let wanted = returned(parameters.only(&["return"])?.minimal()?);
    let (scene, settings) = scenes::open(&app, &name)?;
    let key = idempotency_key(&headers)?;
    let kind = body_type(
        &headers,
        &[BodyType::Json, BodyType::Ndjson, BodyType::Protobuf],
    )?;
    if kind == BodyType::Ndjson {
        if let Some(key) = key {
            let detail =
                "is not taken with a stream: its lines name their ids, which makes a retry safe";
            return Err(Fault::in_parameter("Idempotency-Key", detail, &key).into());
        }
        let (published, counts) =
            ndjson::apply(&scene, &settings, body, app.limits.request_timeout).await?;
        return Ok(answer(&scene, &settings, wanted, &published, counts, None).into_response());
    }
    let body = request::read(&headers, body, &app.limits, &app.room).await?;
    let time = app.limits.request_timeout;
    let change = Atomic {
        cubes_max: app.limits.change_cubes_max,
        scene,
        settings,
        kind,
        body,
        wanted,
    };
    within(time, Arc::new(change).apply(key)).await
}

/// Go back
///
/// Makes the scene's set of cubes what it was at an earlier seq, as one new change: the history stays as it is, and going forward
/// again is going back to a later seq. Takes time in proportion to the operations since. The limit of cubes of a change does not
/// apply. Nothing happens, and no seq is taken, when the cubes are those of that seq already.
#[utoipa::path(
    post, path = "/v1/scenes/{scene}/revert", tag = "changes",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("return" = Option<String>, Query, description = "`minimal` leaves `mass_properties` out", example = "minimal"),
        ("Idempotency-Key" = Option<String>, Header, description = "As of a change"),
    ),
    request_body(content((inline(crate::wire::openapi::RevertWanted) = "application/json", example = json!({"to": 3})))),
    responses((status = 200, description = "Durable", body = Answer,
        headers(("Idempotency-Replayed" = String, description = "`true` when this is the recorded answer to an earlier request"))))
)]
pub(super) async fn post_revert(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let wanted = returned(parameters.only(&["return"])?.minimal()?);
    let (scene, settings) = scenes::open(&app, &name)?;
    let key = idempotency_key(&headers)?;
    body_type(&headers, &[BodyType::Json])?;
    let body = request::read(&headers, body, &app.limits, &app.room).await?;
    let to = decode::revert(&body.bytes)?;
    let digest = || {
        Sha256::new()
            .chain_update(b"revert")
            .chain_update([0])
            .chain_update(&body.bytes)
            .finalize()
            .into()
    };
    let submission = Submission {
        operations: Operations::Revert(to),
        counting: Counting::Net,
        key: key.map(|key| (key, digest())),
    };
    let applied = scene.change(submission).await?;
    Ok(applied_answer(&scene, &settings, wanted, &applied))
}

/// Delete one cube
///
/// Counts as `unchanged` when there is no such cube, so a retry is safe.
#[utoipa::path(
    delete, path = "/v1/scenes/{scene}/cubes/{id}", tag = "changes",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("id" = u64, Path, description = "The cube's id", example = 17),
        ("return" = Option<String>, Query, description = "`minimal` leaves `mass_properties` out", example = "minimal"),
    ),
    responses((status = 200, description = "Durable", body = Answer))
)]
pub(super) async fn delete_cube(
    State(app): State<App>,
    Path((name, id)): Path<(String, String)>,
    parameters: Parameters,
) -> Result<Json<Answer>, Problem> {
    let wanted = returned(parameters.only(&["return"])?.minimal()?);
    let id = CubeId(request::whole("id", &id)?);
    let (scene, settings) = scenes::open(&app, &name)?;
    let submission = Submission {
        operations: Operations::Named(vec![Op::Delete(id)]),
        counting: Counting::Net,
        key: None,
    };
    let Applied {
        published, counts, ..
    } = scene.change(submission).await?;
    Ok(answer(&scene, &settings, wanted, &published, counts, None))
}

fn returned(minimal: bool) -> Return {
    if minimal {
        Return::Minimal
    } else {
        Return::Representation
    }
}

/// An atomic change on its way.
struct Atomic {
    cubes_max: usize,
    scene: Arc<Scene>,
    settings: Settings,
    kind: BodyType,
    body: Whole,
    wanted: Return,
}

impl Atomic {
    async fn apply(self: Arc<Self>, key: Option<Box<str>>) -> Result<Response, Problem> {
        let (decoded, key) = self
            .off_thread(move |this| {
                let decoded = this.decode()?;
                Ok((decoded, key.map(|key| (key, this.digest()))))
            })
            .await?;
        let deletions = decoded.deletions;
        let submission = Submission {
            operations: decoded.operations,
            counting: Counting::Net,
            key,
        };
        match self.scene.change(submission).await {
            Ok(applied) => Ok(applied_answer(
                &self.scene,
                &self.settings,
                self.wanted,
                &applied,
            )),
            Err(ServiceError::Rejected(rejected @ Rejected::IdConflict { .. })) => {
                // Either the scene has the id elsewhere, or the change itself names two places. The engine cannot tell them apart.
                self.off_thread(Self::duplicates).await?;
                Err(conflict(rejected, &self.settings, |index| {
                    self.pointer(index, deletions)
                }))
            }
            Err(error) => Err(error.into()),
        }
    }

    fn decode(&self) -> Result<Decoded, Problem> {
        let read = if self.kind == BodyType::Protobuf {
            decode::message
        } else {
            decode::change
        };
        read(&self.body.bytes, &self.settings, self.cubes_max)
    }

    /// An error when the body puts an id at two places.
    fn duplicates(&self) -> Result<(), Problem> {
        let body = &self.body.bytes;
        if self.kind == BodyType::Protobuf {
            decode::message_duplicates(body)
        } else {
            decode::change_faults(body, &self.settings, self.cubes_max).map(|_| ())
        }
    }

    /// What the idempotency key stands for: the body and how it is read.
    fn digest(&self) -> [u8; 32] {
        Sha256::new()
            .chain_update(self.kind.name())
            .chain_update([0])
            .chain_update(&self.body.bytes)
            .finalize()
            .into()
    }

    /// Where in the body an operation is.
    fn pointer(&self, index: usize, deletions: usize) -> String {
        let list = if self.kind == BodyType::Protobuf {
            "insert_id"
        } else {
            "insert"
        };
        format!("/{list}/{}", index.saturating_sub(deletions))
    }

    /// Runs long work where it does not hold up other requests.
    async fn off_thread<T: Send + 'static>(
        self: &Arc<Self>,
        work: impl FnOnce(&Self) -> Result<T, Problem> + Send + 'static,
    ) -> Result<T, Problem> {
        if self.body.bytes.len() <= DECODED_INLINE_BYTES_MAX {
            return work(self);
        }
        let this = Arc::clone(self);
        match tokio::task::spawn_blocking(move || work(&this)).await {
            Ok(done) => done,
            Err(error) => std::panic::resume_unwind(error.into_panic()),
        }
    }
}

/// The problem of an id that is at another place, said in user units. `pointer` gives the place of an operation in the body.
pub(super) fn conflict(
    rejected: Rejected,
    settings: &Settings,
    pointer: impl Fn(usize) -> String,
) -> Problem {
    let Rejected::IdConflict {
        index,
        id,
        there,
        asked,
    } = rejected
    else {
        return ServiceError::Rejected(rejected).into();
    };
    let (there, asked) = (settings.at(there), settings.at(asked));
    let detail = format!(
        "cube {id} is at {there:?}, so it cannot be inserted at {asked:?}",
        id = id.0
    );
    let fault = Fault {
        value: Some(serde_json::json!({"id": id.0, "at": asked})),
        ..Fault::at(pointer(index), format!("is at {there:?} already"), None)
    };
    Problem::new(Code::IdConflict, detail)
        .with("id", id.0)
        .with_fault(fault)
}
