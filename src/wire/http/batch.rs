//! Several changes in one request: each atomic by itself and answered by itself, one sync for many of them.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::{Extension, Json};
use serde::Serialize;
use utoipa::ToSchema;

use super::changes::{AnyChange, ChangeAnswer, Wanted, change_answer};
use super::request::{
    self, ABOUT_IDS, BodyType, Parameters, Path, Return, Room, body_type, idempotency_key,
};
use super::{App, scenes};
use crate::service::{Chain, SceneOf};
use crate::wire::access::{Effect, Ticket};
use crate::wire::atomic::{Atomic, ChangedKind, Sent};
use crate::wire::calls;
use crate::wire::decode::{self, Keyed};
use crate::wire::documents::IdForm;
use crate::wire::kind::Opened;
use crate::wire::problem::{Fault, Problem};

/// Most changes of a batch: the answer has as many mass properties.
const BATCH_CHANGES_MAX: usize = 1_024;

/// What the changes of a batch did.
#[derive(Serialize, ToSchema)]
pub(super) struct BatchAnswer {
    /// One answer for each change, in their order.
    outcomes: Vec<ChangeAnswer>,
}

/// Apply several changes
///
/// One after the other, each atomic by itself, and all durable when the answer comes: one round trip and a few syncs for as many as
/// 1,024. A change may have a key, as `Idempotency-Key` is for one alone; so a batch can be sent again.
///
/// Where a change is refused, nothing after it is applied. The problem's `change` is its index in the batch, from 0, and `outcomes` are the
/// answers to those before it, which are durable.
///
/// `application/x-protobuf` is the message `union3d.v1.ChangeBatch`.
#[utoipa::path(
    post, path = "/v1/scenes/{scene}/changes/batch", tag = "changes",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("return" = inline(Option<Return>), Query, description = "`minimal` leaves `mass_properties` out", example = "minimal"),
        ("ids" = inline(Option<IdForm>), Query, description = ABOUT_IDS, example = "text"),
    ),
    request_body(content(
        (ChangeBatch = "application/json", example = json!({"changes": [
            {"change": {"insert": [{"id": 31, "at": [0, 0, 2.5]}], "move": 12}, "idempotency_key": "run-7-12"},
            {"change": {"insert": [{"id": 32, "at": [0, 1, 2.5]}], "move": 13}, "idempotency_key": "run-7-13"},
        ]})),
        (Vec<u8> = "application/x-protobuf"),
    )),
    responses((status = 200, description = "Durable", body = BatchAnswer))
)]
pub(super) async fn post_batch(
    State(app): State<App>,
    Extension(ticket): Extension<Ticket>,
    Path(name): Path<String>,
    parameters: Parameters,
    headers: HeaderMap,
    room: Room,
    body: Body,
) -> Result<Json<BatchAnswer>, Problem> {
    let wanted = Wanted::read(parameters)?;
    if let Some(key) = idempotency_key(&headers)? {
        let detail = "is not taken with a batch: its changes have their own, idempotency_key";
        return Err(Fault::in_parameter("Idempotency-Key", detail, &key).into());
    }
    let kind = body_type(&headers, &[BodyType::Json, BodyType::Protobuf])?;
    let opened = scenes::open_any(&app, &name)?;
    // The memory that it takes is given back when it is answered.
    let body = request::read(&headers, body, &app.limits, room).await?;
    let changes: Vec<Keyed<Sent>> = if kind == BodyType::Protobuf {
        let changes = decode::batch_message(&body.bytes, BATCH_CHANGES_MAX)?.into_iter();
        let sent = |change| Sent::Message(Box::new(change));
        changes.map(|(change, key)| (sent(change), key)).collect()
    } else {
        let changes = decode::batch(&body.bytes, BATCH_CHANGES_MAX)?.into_iter();
        let sent = |(change, key)| (Sent::Json(change), key);
        changes.map(sent).collect()
    };
    let answered = match opened {
        Opened::Cubes(scene, settings) => {
            apply(&app, &ticket, (scene, settings), wanted, changes).await
        }
        Opened::Solids(scene, settings) => {
            apply(&app, &ticket, (scene, settings), wanted, changes).await
        }
    };
    answered.map(|outcomes| Json(BatchAnswer { outcomes }))
}

/// Queues the changes one after the other, and answers when all are durable.
/// # Errors
/// What is wrong with the first that is refused, with the answers to those before it.
async fn apply<K: ChangedKind>(
    app: &App,
    ticket: &Ticket,
    (scene, settings): (Arc<SceneOf<K>>, Arc<K::Settings>),
    wanted: Wanted,
    changes: Vec<Keyed<Sent>>,
) -> Result<Vec<ChangeAnswer>, Problem> {
    let (time, operations_max) = (app.limits.request_timeout, app.limits.change_cubes_max);
    let chain = Chain::default();
    let mut queued = Vec::with_capacity(changes.len());
    let mut refused = None;
    for (index, (sent, key)) in changes.into_iter().enumerate() {
        let atomic = Atomic::new(scene.clone(), settings.clone(), sent, operations_max);
        match calls::within(time, atomic.queued(key, Some(chain.clone()))).await {
            Ok(judged) => queued.push(judged),
            Err(problem) => {
                // It never came into the chain, so it does not break it: what was queued before it stands.
                refused = Some((index, problem));
                break;
            }
        }
    }
    let mut effect = Effect::default();
    let mut outcomes = Vec::with_capacity(queued.len());
    for (index, judged) in queued.into_iter().enumerate() {
        let applied = match calls::within(time, judged).await {
            Ok(applied) => applied,
            Err(problem) => {
                refused = Some((index, problem));
                break;
            }
        };
        effect.add(&applied);
        ticket.did(effect);
        let name = Some(scene.name().as_str());
        let answer = change_answer(name, &*settings, wanted, &applied);
        outcomes.push(answer.replayed(applied.replayed));
    }
    let Some((index, problem)) = refused else {
        return Ok(outcomes);
    };
    let outcomes = serde_json::to_value(outcomes).expect("numbers and strings are JSON");
    let place = format!("/changes/{index}/change");
    let problem = problem.with_ids(wanted.ids()).below(&place);
    Err(problem.with("change", index).with("outcomes", outcomes))
}

/// Changes of a scene, one after the other.
#[derive(ToSchema)]
#[expect(dead_code, reason = "it stands in the description")]
struct ChangeBatch {
    /// At most 1,024.
    changes: Vec<KeyedChange>,
}

/// A change with its key.
#[derive(ToSchema)]
#[expect(dead_code, reason = "it stands in the description")]
struct KeyedChange {
    change: AnyChange,
    /// 1 to 64 visible ASCII characters. The answer to the first change with this key is repeated, with `replayed`.
    #[schema(min_length = 1, max_length = 64, pattern = "^[!-~]+$")]
    idempotency_key: Option<String>,
}
