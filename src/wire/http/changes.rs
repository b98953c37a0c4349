//! Changes: atomic ones (JSON, protobuf) here, streams in `ndjson`.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::Serialize;
use utoipa::ToSchema;

use super::ndjson::StreamedKind;
use super::request::{
    self, ABOUT_ID, ABOUT_IDS, BodyType, Parameters, Path, Return, Room, body_type, idempotency_key,
};
use super::{App, ndjson, scenes};
use crate::engine::Op;
use crate::geometry::CubeId;
use crate::service::{Applied, Counting, Motion, Operations, SceneOf, Submission};
use crate::wire::access::{Effect, Ticket};
use crate::wire::atomic::{Atomic, Run, Sent};
use crate::wire::calls;
use crate::wire::decode;
use crate::wire::documents::{Change, Cube, Id, IdForm, LineOperation, Revert};
use crate::wire::kind::{Opened, Properties, ShownKind};
use crate::wire::problem::{Fault, Problem};
use crate::wire::solids::{SolidChange, SolidDocument};

/// What a change did.
#[derive(Serialize, ToSchema)]
pub(in crate::wire) struct ChangeAnswer {
    /// The scene's newest change: this one, unless it changed nothing.
    #[schema(example = 5)]
    seq: u64,
    /// Always true: nothing was done, and the rest says what the change would do if it came next. Left out of what was done.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    dry_run: Option<bool>,
    /// Always true: this is the recorded answer to an earlier change with the same key. In the answer to a batch; elsewhere the header
    /// `Idempotency-Replayed` says it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    replayed: Option<bool>,
    /// Cubes or solids inserted.
    #[schema(example = 1)]
    inserted: u64,
    /// Cubes or solids deleted.
    #[schema(example = 1)]
    deleted: u64,
    /// Operations that changed nothing.
    #[schema(example = 0)]
    unchanged: u64,
    /// The ids that the server gave, in the order of `insert`; left out when it gave none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    assigned: Option<AssignedIds>,
    /// Volume that it removed from the stock, or added to the union where there is no stock, in user units cubed.
    #[schema(example = 82.41919)]
    volume_removed: f64,
    /// The same as a decimal integer, in lattice steps cubed; of a scene of solids in 96ths of them.
    #[schema(example = "82419190000")]
    volume_removed_exact: String,
    /// The totals after it; left out with `return=minimal`. Of a dry run their `seq` is null.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    mass_properties: Option<Properties>,
}

/// Consecutive ids.
#[derive(Serialize, ToSchema)]
pub(in crate::wire) struct AssignedIds {
    /// The first.
    first: Id,
    /// The last.
    last: Id,
}

/// What of the answer is wanted, and how.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(in crate::wire) struct Wanted {
    returned: Return,
    ids: IdForm,
    run: Run,
}

impl ChangeAnswer {
    /// In the answer to a batch.
    pub(super) fn replayed(self, replayed: bool) -> Self {
        Self {
            replayed: replayed.then_some(true),
            ..self
        }
    }
}

impl Wanted {
    pub(in crate::wire) fn new(returned: Return, run: Run) -> Self {
        Self {
            returned,
            ids: IdForm::default(),
            run,
        }
    }

    pub(super) fn read(parameters: Parameters) -> Result<Self, Problem> {
        let query = parameters.only(&["return", "ids"])?;
        Ok(Self {
            returned: query.returned()?,
            ids: query.ids()?,
            run: Run::Real,
        })
    }

    /// The same of a change, which may be a dry run.
    fn read_of_change(parameters: Parameters) -> Result<Self, Problem> {
        let query = parameters.only(&["return", "ids", "dry_run"])?;
        let run = if query.flag("dry_run")? {
            Run::Dry
        } else {
            Run::Real
        };
        Ok(Self {
            returned: query.returned()?,
            ids: query.ids()?,
            run,
        })
    }

    /// The type of a change's body, one of `taken`, and its key; a key belongs to an atomic change that is done.
    fn kind_and_key(
        self,
        headers: &HeaderMap,
        taken: &[BodyType],
    ) -> Result<(BodyType, Option<Box<str>>), Problem> {
        let key = idempotency_key(headers)?;
        let kind = body_type(headers, taken)?;
        let detail = match (self.run, kind) {
            (Run::Dry, BodyType::Ndjson) => {
                let detail = "is not taken with a stream, which is several changes";
                return Err(Fault::in_parameter("dry_run", detail, "true").into());
            }
            (Run::Dry, _) => "is not taken with a dry run, of which nothing is kept",
            (Run::Real, BodyType::Ndjson) => {
                "is not taken with a stream: its lines name their ids, which makes a retry safe"
            }
            _ => return Ok((kind, key)),
        };
        match key {
            Some(key) => Err(Fault::in_parameter("Idempotency-Key", detail, &key).into()),
            None => Ok((kind, None)),
        }
    }

    /// How ids are written.
    pub(super) fn ids(self) -> IdForm {
        self.ids
    }

    fn id(self, id: CubeId) -> Id {
        Id { id, form: self.ids }
    }
}

/// An answer, and what the audit log says of it.
pub(super) type Answered = (Extension<Effect>, Json<ChangeAnswer>);

pub(super) fn answer<K: ShownKind>(
    scene: &SceneOf<K>,
    settings: &K::Settings,
    wanted: Wanted,
    applied: &Applied<K>,
) -> Answered {
    let effect = Effect::of(applied);
    let effect = match wanted.run {
        Run::Dry => effect.dry(),
        Run::Real => effect,
    };
    let name = Some(scene.name().as_str());
    let document = change_answer(name, settings, wanted, applied);
    (Extension(effect), Json(document))
}

/// What is answered to a change.
pub(in crate::wire) fn change_answer<K: ShownKind>(
    scene: Option<&str>,
    settings: &K::Settings,
    wanted: Wanted,
    applied: &Applied<K>,
) -> ChangeAnswer {
    let Applied {
        published,
        counts,
        assigned,
        volume_removed,
        ..
    } = applied;
    let seq = published.seq.0;
    let is_dry = wanted.run == Run::Dry;
    // What would be has no seq.
    let as_of = (!is_dry).then_some(seq);
    ChangeAnswer {
        seq,
        dry_run: is_dry.then_some(true),
        replayed: None,
        inserted: counts.inserted,
        deleted: counts.deleted,
        unchanged: counts.unchanged,
        assigned: assigned.map(|(first, last)| AssignedIds {
            first: wanted.id(first),
            last: wanted.id(last),
        }),
        volume_removed: K::volume_user(*volume_removed, settings),
        volume_removed_exact: volume_removed.to_string(),
        mass_properties: (wanted.returned == Return::Representation)
            .then(|| K::shown(K::properties(scene, as_of, &published.totals, settings))),
    }
}

fn applied_answer<K: ShownKind>(
    scene: &SceneOf<K>,
    settings: &K::Settings,
    wanted: Wanted,
    applied: &Applied<K>,
) -> Response {
    let mut response = answer(scene, settings, wanted, applied).into_response();
    if applied.replayed {
        response.headers_mut().insert(
            HeaderName::from_static("idempotency-replayed"),
            HeaderValue::from_static("true"),
        );
    }
    response
}

/// Insert and delete cubes or solids
///
/// Solids are shapes of the scene, at one place or carried along a segment, and hulls.
///
/// `application/json` and `application/x-protobuf` (the message `union3d.v1.Change`) are one atomic change: deletions first, all or
/// nothing. Inserting an id that is there at the same place, or deleting one that is not there, changes nothing and counts as
/// `unchanged`, so a retry is safe. Ids may be left out of all cubes: then the server numbers them, and an `Idempotency-Key`
/// makes a retry safe. `move` and `duration` say which movement of a machine the change belongs to and how many seconds it took: they
/// stand in the history, and a change that has one takes a seq even when it has no cubes (nothing was cut, but time passed); not when it is
/// sent again, and its cubes are there already.
///
/// `application/x-ndjson` is a stream of any length, a line an operation. Lines act in their order and are committed as they
/// arrive; the answer comes at the end and adds them up. At a bad line it stops: all lines before it are committed.
#[utoipa::path(
    post, path = "/v1/scenes/{scene}/changes", tag = "changes",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("return" = inline(Option<Return>), Query, description = "`minimal` leaves `mass_properties` out", example = "minimal"),
        ("ids" = inline(Option<IdForm>), Query, description = ABOUT_IDS, example = "text"),
        ("dry_run" = Option<bool>, Query, description = "`true`: the answer says what the change would do, and nothing is done. Not for streams, and without a key"),
        ("Idempotency-Key" = Option<String>, Header, description = "1 to 64 visible ASCII characters. The answer to the first change with this key is repeated, with `Idempotency-Replayed: true`. Not for streams"),
    ),
    request_body(content(
        (AnyChange = "application/json",
            example = json!({"delete": [17], "insert": [{"id": 18, "at": [0, 0, 2.5]}]})),
        (inline(LineOperation<AnyBody>) = "application/x-ndjson",
            example = json!({"insert": {"id": 1, "at": [0, 0, 2.5]}})),
        (Vec<u8> = "application/x-protobuf"),
    )),
    responses((status = 200, description = "Durable", body = ChangeAnswer,
        headers(("Idempotency-Replayed" = String, description = "`true` when this is the recorded answer to an earlier request"))))
)]
pub(super) async fn post_changes(
    State(app): State<App>,
    Extension(ticket): Extension<Ticket>,
    Path(name): Path<String>,
    parameters: Parameters,
    headers: HeaderMap,
    room: Room,
    body: Body,
) -> Result<Response, Problem> {
    let wanted = Wanted::read_of_change(parameters)?;
    match scenes::open_any(&app, &name)? {
        Opened::Cubes(scene, settings) => {
            change(
                &app,
                &ticket,
                (scene, settings),
                wanted,
                (&headers, room, body),
            )
            .await
        }
        Opened::Solids(scene, settings) => {
            change(
                &app,
                &ticket,
                (scene, settings),
                wanted,
                (&headers, room, body),
            )
            .await
        }
    }
}

/// A change of a scene of either kind, or a stream of them.
async fn change<K: StreamedKind>(
    app: &App,
    ticket: &Ticket,
    (scene, settings): (Arc<SceneOf<K>>, Arc<K::Settings>),
    wanted: Wanted,
    (headers, room, body): (&HeaderMap, Room, Body),
) -> Result<Response, Problem> {
    let taken = [BodyType::Json, BodyType::Ndjson, BodyType::Protobuf];
    let (kind, key) = wanted.kind_and_key(headers, &taken)?;
    if kind == BodyType::Ndjson {
        let idle_max = app.limits.request_timeout;
        let applied = ndjson::apply(&scene, &settings, body, idle_max, ticket).await;
        let applied = applied.map_err(|problem| problem.with_ids(wanted.ids))?;
        return Ok(answer(&scene, &settings, wanted, &applied).into_response());
    }
    // The memory that it takes is given back when it is answered.
    let body = request::read(headers, body, &app.limits, room).await?;
    let bytes = body.bytes.clone();
    let sent = match kind {
        BodyType::Protobuf => Sent::Protobuf(bytes),
        _ => Sent::Json(bytes),
    };
    let (time, most) = (app.limits.request_timeout, app.limits.change_cubes_max);
    let change = Atomic::new(scene, settings, sent, most);
    let applied = calls::within(time, change.apply(wanted.run, key)).await;
    let applied = applied.map_err(|problem| problem.with_ids(wanted.ids))?;
    Ok(applied_answer(
        &change.scene,
        &change.settings,
        wanted,
        &applied,
    ))
}

/// Go back
///
/// Makes the scene's set of cubes or solids what it was at an earlier seq, as one new change: the history stays as it is, and going forward
/// again is going back to a later seq. Takes time in proportion to the operations that tell the two states apart. The limit of
/// cubes of a change does not apply, but that of a record does: 2^24 operations. Nothing happens, and no seq is taken, when the cubes are those of that seq already.
#[utoipa::path(
    post, path = "/v1/scenes/{scene}/revert", tag = "changes",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("return" = inline(Option<Return>), Query, description = "`minimal` leaves `mass_properties` out", example = "minimal"),
        ("ids" = inline(Option<IdForm>), Query, description = ABOUT_IDS, example = "text"),
        ("Idempotency-Key" = Option<String>, Header, description = "As of a change"),
    ),
    request_body(content((Revert = "application/json", example = json!({"to": 3})))),
    responses((status = 200, description = "Durable", body = ChangeAnswer,
        headers(("Idempotency-Replayed" = String, description = "`true` when this is the recorded answer to an earlier request"))))
)]
pub(super) async fn post_revert(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
    headers: HeaderMap,
    room: Room,
    body: Body,
) -> Result<Response, Problem> {
    let wanted = Wanted::read(parameters)?;
    let opened = scenes::open_any(&app, &name)?;
    let key = idempotency_key(&headers)?;
    body_type(&headers, &[BodyType::Json])?;
    let body = request::read(&headers, body, &app.limits, room).await?;
    let to = decode::revert(&body.bytes)?;
    Ok(match opened {
        Opened::Cubes(scene, settings) => {
            let applied = calls::revert(&scene, to, key, &body.bytes).await?;
            applied_answer(&scene, &settings, wanted, &applied)
        }
        Opened::Solids(scene, settings) => {
            let applied = calls::revert(&scene, to, key, &body.bytes).await?;
            applied_answer(&scene, &settings, wanted, &applied)
        }
    })
}

/// Delete one cube
///
/// Counts as `unchanged` when there is no such cube, so a retry is safe.
#[utoipa::path(
    delete, path = "/v1/scenes/{scene}/cubes/{id}", tag = "changes",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("id" = u64, Path, description = ABOUT_ID, example = 17),
        ("return" = inline(Option<Return>), Query, description = "`minimal` leaves `mass_properties` out", example = "minimal"),
        ("ids" = inline(Option<IdForm>), Query, description = ABOUT_IDS, example = "text"),
    ),
    responses((status = 200, description = "Durable", body = ChangeAnswer))
)]
pub(super) async fn delete_cube(
    State(app): State<App>,
    Path((name, id)): Path<(String, String)>,
    parameters: Parameters,
) -> Result<Answered, Problem> {
    let (scene, settings) = scenes::open(&app, &name)?;
    delete(&scene, &settings, &id, parameters).await
}

/// Deletes one body of a scene of either kind.
pub(super) async fn delete<K: ShownKind>(
    scene: &SceneOf<K>,
    settings: &K::Settings,
    id: &str,
    parameters: Parameters,
) -> Result<Answered, Problem> {
    let wanted = Wanted::read(parameters)?;
    let id = CubeId(request::whole("id", id)?);
    let submission = Submission {
        operations: Operations::Named(vec![Op::Delete(id)]),
        counting: Counting::Net,
        motion: Motion::default(),
        key: None,
    };
    let applied = scene.change(submission).await?;
    Ok(answer(scene, settings, wanted, &applied))
}

/// What a line inserts into a scene of either kind.
#[derive(ToSchema)]
#[serde(untagged)]
#[expect(
    dead_code,
    reason = "it stands in the description; each is read by what the scene is"
)]
enum AnyBody {
    /// A cube.
    Cube(Cube),
    /// A solid, with its id.
    Solid(SolidDocument),
}

/// A change of a scene of either kind.
#[derive(ToSchema)]
#[serde(untagged)]
#[expect(
    dead_code,
    reason = "it stands in the description; each is read by what the scene is"
)]
pub(super) enum AnyChange {
    /// Of cubes.
    Cubes(Change),
    /// Of solids.
    Solids(SolidChange),
}
