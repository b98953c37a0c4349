//! The calls: read the message, ask the service, answer with a message.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;

use futures_util::Stream;
use tokio_util::sync::CancellationToken;
use tonic::{Request, Response, Status, Streaming, async_trait};

use super::admission::{Whole, permitted, ticket};
use super::messages::{self, Detail, MessageKind};
use super::{idempotency_key, room, solids, status, stream};
use crate::geometry::CubeId;
use crate::service::{AnyScene, Reading, SceneOf, Seq, Service, ServiceError};
use crate::wire::access::{Effect, Ticket};
use crate::wire::atomic::{Atomic, Run, Sent};
use crate::wire::calls::{self, HistoryRows, within};
use crate::wire::decode;
use crate::wire::http::Limits;
use crate::wire::kind::Opened;
use crate::wire::problem::{Fault, Faults, Problem};
use crate::wire::proto::union_service_server::UnionService;
use crate::wire::proto::{
    ApplyChangeRequest, ApplyChangeResponse, AuditSceneRequest, AuditSceneResponse,
    ContainsRequest, ContainsResponse, CreateSceneRequest, CreateSceneResponse, DefineShapeRequest,
    DefineShapeResponse, DeleteSceneRequest, DeleteSceneResponse, GetCubeRequest, GetCubeResponse,
    GetHistoryRequest, GetHistoryResponse, GetMassPropertiesRequest, GetMassPropertiesResponse,
    GetSceneRequest, GetSceneResponse, GetSolidRequest, GetSolidResponse, ListCubesRequest,
    ListCubesResponse, ListScenesRequest, ListScenesResponse, ListSolidsRequest,
    ListSolidsResponse, Outcome, RevertSceneRequest, RevertSceneResponse, SolidSceneSettings,
    StreamChangesRequest, StreamChangesResponse, WatchMassPropertiesRequest,
    WatchMassPropertiesResponse,
};
use crate::wire::solids::NewSolids;

/// Cubes of one message of a listing.
const LISTED_CUBES: usize = 4_096;

/// Solids of one message of a listing.
const LISTED_SOLIDS: usize = 1_024;

/// What the calls know.
pub(super) struct Calls {
    pub(super) service: Service,
    pub(super) limits: Limits,
    /// Ends the streams that have no end of their own.
    pub(super) draining: CancellationToken,
}

type Streamed<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// Answers in bounded time; a failure becomes a status, its faults placed in the field `body`.
async fn bounded<T>(
    limits: &Limits,
    body: &str,
    work: impl Future<Output = Result<T, Problem>>,
) -> tonic::Result<Response<T>> {
    let time = limits.request_timeout * 2 + limits.wait_max;
    answered(body, within(time, work).await)
}

fn answered<T>(body: &str, answer: Result<T, Problem>) -> tonic::Result<Response<T>> {
    match answer {
        Ok(answer) => {
            let mut response = Response::new(answer);
            response.extensions_mut().insert(Whole);
            Ok(response)
        }
        Err(problem) => Err(status::status(&problem, body)),
    }
}

/// Reads the settings of a scene of solids; shapes take their time.
async fn solid_settings(wanted: SolidSceneSettings) -> Result<NewSolids, Problem> {
    off_thread(move || {
        let mut faults = Faults::default();
        let document = solids::wanted(&wanted, &mut faults);
        decode::solid_settings_document(&document, faults)
    })
    .await
}

/// Runs long work where it does not hold up other requests.
async fn off_thread<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    match tokio::task::spawn_blocking(work).await {
        Ok(done) => done,
        Err(error) => std::panic::resume_unwind(error.into_panic()),
    }
}

/// Applies a change that was sent, with its idempotency key, or says what it would do.
async fn apply<K: MessageKind>(
    limits: &Limits,
    (scene, settings): (Arc<SceneOf<K>>, Arc<K::Settings>),
    sent: Sent,
    (run, key): (Run, Option<Box<str>>),
    detail: Detail,
    ticket: &Ticket,
) -> Result<Outcome, Problem> {
    let change = Atomic::new(scene, settings, sent, limits.change_cubes_max);
    let applied = within(limits.request_timeout, change.apply(run, key)).await?;
    let (scene, settings) = (&change.scene, &change.settings);
    let mut outcome = messages::outcome(detail, scene, settings, &applied);
    ticket.did(Effect::of(&applied));
    if run == Run::Dry {
        ticket.did(Effect::of(&applied).dry());
        // What would be has no seq.
        if let Some(shown) = &mut outcome.mass_properties {
            shown.seq = 0;
        }
        if let Some(shown) = &mut outcome.solid_mass_properties {
            shown.seq = 0;
        }
    }
    Ok(outcome)
}

async fn revert<K: MessageKind>(
    scene: &SceneOf<K>,
    settings: &K::Settings,
    to: Seq,
    key: Option<Box<str>>,
    detail: Detail,
    ticket: &Ticket,
) -> Result<Outcome, Problem> {
    // The body that says the same over HTTP, so that a key stands for the same.
    let body = format!("{{\"to\":{}}}", to.0);
    let applied = calls::revert(scene, to, key, body.as_bytes()).await?;
    ticket.did(Effect::of(&applied));
    Ok(messages::outcome(detail, scene, settings, &applied))
}

/// The totals at once, and then whenever they have changed.
fn watch<K: MessageKind>(
    scene: Arc<SceneOf<K>>,
    settings: Arc<K::Settings>,
    draining: CancellationToken,
) -> Streamed<WatchMassPropertiesResponse> {
    let ended = |error: ServiceError| Err(status::status(&error.into(), ""));
    // One value is kept, the newest: this runs only when the client has read what came before.
    Box::pin(async_stream::stream! {
        loop {
            let mut newest = match scene.subscribe() {
                Ok(newest) => newest,
                Err(error) => {
                    yield ended(error);
                    return;
                }
            };
            loop {
                let published = *newest.borrow_and_update();
                let shown = messages::mass_properties(&scene, &settings, &published);
                yield Ok(WatchMassPropertiesResponse {
                    mass_properties: shown.cubes,
                    solid_mass_properties: shown.solids,
                });
                tokio::select! {
                    changed = newest.changed() => if changed.is_err() {
                        // The scene stopped, and may be back already.
                        break;
                    },
                    () = draining.cancelled() => {
                        yield ended(ServiceError::ShuttingDown);
                        return;
                    }
                }
            }
        }
    })
}

/// The changes of the past that are asked for.
/// All bodies, so many in a message; one message also when there are none.
fn listed<K: MessageKind, T: Send + 'static>(
    mut reading: Reading<K>,
    bodies_at_once: usize,
    message: impl Fn(&[(CubeId, K::Body)]) -> T + Send + 'static,
) -> Streamed<T> {
    Box::pin(async_stream::stream! {
        let mut is_first = true;
        loop {
            let bodies = reading.next(bodies_at_once).await;
            let bodies = bodies.map_err(|error| status::status(&error.into(), ""))?;
            if bodies.is_empty() && !is_first {
                break;
            }
            is_first = false;
            yield Ok(message(&bodies));
        }
    })
}

fn history<K: MessageKind>(
    scene: Arc<SceneOf<K>>,
    settings: Arc<K::Settings>,
    request: &GetHistoryRequest,
    detail: Detail,
) -> Result<Streamed<GetHistoryResponse>, Problem> {
    let limit = request.limit.unwrap_or(u64::MAX);
    let range = [request.from, request.to];
    let moves = [request.move_from, request.move_to];
    let mut rows = HistoryRows::new(scene.clone(), range, moves, limit)?;
    Ok(Box::pin(async_stream::stream! {
        loop {
            match rows.page().await {
                Ok(Some(page)) => for row in page {
                    yield Ok(messages::history_row(detail, &scene, &settings, &row));
                },
                Ok(None) => return,
                Err(error) => {
                    yield Err(status::status(&error.into(), ""));
                    return;
                }
            }
        }
    }))
}

#[async_trait]
impl UnionService for Calls {
    async fn create_scene(
        &self,
        request: Request<CreateSceneRequest>,
    ) -> tonic::Result<Response<CreateSceneResponse>> {
        let CreateSceneRequest {
            scene,
            settings,
            solids,
        } = permitted(request)?;
        let body = if solids.is_some() {
            "solids"
        } else {
            "settings"
        };
        bounded(&self.limits, body, async {
            let name = calls::scene_name(&scene)?;
            let (scene, created) = match (settings, solids) {
                (settings, None) => {
                    let settings = decode::settings_message(&settings.unwrap_or_default())?;
                    let (scene, created) = calls::create(&self.service, &name, &settings).await?;
                    (AnyScene::Cubes(scene), created)
                }
                (None, Some(wanted)) => {
                    let wanted = solid_settings(wanted).await?;
                    let (scene, created) =
                        calls::create_solids(&self.service, &name, &wanted).await?;
                    (AnyScene::Solids(scene), created)
                }
                (Some(_), Some(_)) => {
                    let detail = "is sent beside settings: a scene is one of cubes or of solids";
                    return Err(Fault::in_parameter("solids", detail, "").into());
                }
            };
            let scene = Some(messages::scene(&scene));
            Ok(CreateSceneResponse { scene, created })
        })
        .await
    }

    async fn get_scene(
        &self,
        request: Request<GetSceneRequest>,
    ) -> tonic::Result<Response<GetSceneResponse>> {
        let request = permitted(request)?;
        let found = self.service.any_scene(&request.scene);
        let found = found.map(|scene| GetSceneResponse {
            scene: Some(messages::scene(&scene)),
        });
        answered("", found.map_err(Problem::from))
    }

    async fn list_scenes(
        &self,
        request: Request<ListScenesRequest>,
    ) -> tonic::Result<Response<ListScenesResponse>> {
        let (ticket, scenes) = (ticket(&request), self.service.scenes());
        let readable = scenes
            .iter()
            .filter(|scene| ticket.may_read(scene.name().as_str()));
        Ok(Response::new(ListScenesResponse {
            scenes: readable.map(messages::scene).collect(),
        }))
    }

    async fn delete_scene(
        &self,
        request: Request<DeleteSceneRequest>,
    ) -> tonic::Result<Response<DeleteSceneResponse>> {
        let request = permitted(request)?;
        bounded(&self.limits, "", async {
            calls::remove(&self.service, &request.scene).await?;
            Ok(DeleteSceneResponse {})
        })
        .await
    }

    async fn define_shape(
        &self,
        request: Request<DefineShapeRequest>,
    ) -> tonic::Result<Response<DefineShapeResponse>> {
        let DefineShapeRequest { scene, name, shape } = permitted(request)?;
        bounded(&self.limits, "shape", async {
            let (scene, settings) = calls::open_solids(&self.service, &scene)?;
            let scale = settings.scale();
            let read = move || {
                let mut faults = Faults::default();
                let document = solids::shape(&shape.unwrap_or_default(), "", &mut faults);
                decode::shape_document(document.as_ref(), &name, scale, faults)
            };
            let defined = calls::define(&scene, off_thread(read).await?).await?;
            Ok(DefineShapeResponse {
                shape: Some(defined.shape.into()),
                polygon_error: defined.polygon_error.map(Into::into),
            })
        })
        .await
    }

    async fn apply_change(
        &self,
        request: Request<ApplyChangeRequest>,
    ) -> tonic::Result<Response<ApplyChangeResponse>> {
        let ticket = ticket(&request);
        let request = permitted(request)?;
        let work = async {
            let detail = Detail::of(request.detail)?;
            let key = idempotency_key(request.idempotency_key.as_deref())?;
            let run = if request.dry_run { Run::Dry } else { Run::Real };
            if let (Run::Dry, Some(key)) = (run, &key) {
                let detail = "is not taken with a dry run, of which nothing is kept";
                return Err(Fault::in_parameter("idempotency_key", detail, key).into());
            }
            let sent = Sent::Message(Box::new(request.change.unwrap_or_default()));
            let outcome = match calls::open_any(&self.service, &request.scene)? {
                Opened::Cubes(scene, settings) => {
                    apply(
                        &self.limits,
                        (scene, settings),
                        sent,
                        (run, key),
                        detail,
                        &ticket,
                    )
                    .await?
                }
                Opened::Solids(scene, settings) => {
                    apply(
                        &self.limits,
                        (scene, settings),
                        sent,
                        (run, key),
                        detail,
                        &ticket,
                    )
                    .await?
                }
            };
            Ok(ApplyChangeResponse {
                outcome: Some(outcome),
            })
        };
        answered("change", work.await)
    }

    type StreamChangesStream = Streamed<StreamChangesResponse>;

    async fn stream_changes(
        &self,
        request: Request<Streaming<StreamChangesRequest>>,
    ) -> tonic::Result<Response<Self::StreamChangesStream>> {
        let (limits, draining) = (self.limits, self.draining.clone());
        let (ticket, room) = (ticket(&request), room::of(&request));
        let inbound = stream::Inbound::new(request.into_inner(), room);
        let answers = stream::open(&self.service, limits, draining, ticket, inbound).await?;
        Ok(Response::new(Box::pin(answers)))
    }

    async fn revert_scene(
        &self,
        request: Request<RevertSceneRequest>,
    ) -> tonic::Result<Response<RevertSceneResponse>> {
        let ticket = ticket(&request);
        let request = permitted(request)?;
        let work = async {
            let detail = Detail::of(request.detail)?;
            let key = idempotency_key(request.idempotency_key.as_deref())?;
            let to = Seq(request.to);
            let outcome = match calls::open_any(&self.service, &request.scene)? {
                Opened::Cubes(scene, settings) => {
                    revert(&scene, &settings, to, key, detail, &ticket).await?
                }
                Opened::Solids(scene, settings) => {
                    revert(&scene, &settings, to, key, detail, &ticket).await?
                }
            };
            Ok(RevertSceneResponse {
                outcome: Some(outcome),
            })
        };
        answered("", work.await)
    }

    async fn get_mass_properties(
        &self,
        request: Request<GetMassPropertiesRequest>,
    ) -> tonic::Result<Response<GetMassPropertiesResponse>> {
        let GetMassPropertiesRequest { scene, at, wait } = permitted(request)?;
        bounded(&self.limits, "", async {
            let wait_max = self.limits.wait_max;
            let shown = match calls::open_any(&self.service, &scene)? {
                Opened::Cubes(scene, settings) => {
                    let published = calls::published(&scene, at, wait, wait_max).await?;
                    messages::mass_properties(&scene, &settings, &published)
                }
                Opened::Solids(scene, settings) => {
                    let published = calls::published(&scene, at, wait, wait_max).await?;
                    messages::mass_properties(&scene, &settings, &published)
                }
            };
            Ok(GetMassPropertiesResponse {
                mass_properties: shown.cubes,
                solid_mass_properties: shown.solids,
            })
        })
        .await
    }

    type WatchMassPropertiesStream = Streamed<WatchMassPropertiesResponse>;

    async fn watch_mass_properties(
        &self,
        request: Request<WatchMassPropertiesRequest>,
    ) -> tonic::Result<Response<Self::WatchMassPropertiesStream>> {
        let request = permitted(request)?;
        let opened = calls::open_any(&self.service, &request.scene);
        let draining = self.draining.clone();
        Ok(Response::new(match answered("", opened)?.into_inner() {
            Opened::Cubes(scene, settings) => watch(scene, settings, draining),
            Opened::Solids(scene, settings) => watch(scene, settings, draining),
        }))
    }

    type GetHistoryStream = Streamed<GetHistoryResponse>;

    async fn get_history(
        &self,
        request: Request<GetHistoryRequest>,
    ) -> tonic::Result<Response<Self::GetHistoryStream>> {
        let request = permitted(request)?;
        let read = || {
            let detail = Detail::of(request.detail)?;
            match calls::open_any(&self.service, &request.scene)? {
                Opened::Cubes(scene, settings) => history(scene, settings, &request, detail),
                Opened::Solids(scene, settings) => history(scene, settings, &request, detail),
            }
        };
        answered("", read())
    }

    type ListCubesStream = Streamed<ListCubesResponse>;

    async fn list_cubes(
        &self,
        request: Request<ListCubesRequest>,
    ) -> tonic::Result<Response<Self::ListCubesStream>> {
        let request = permitted(request)?;
        let work = async {
            let (scene, _) = calls::open(&self.service, &request.scene)?;
            Ok(scene.read_all().await?)
        };
        let reading = bounded(&self.limits, "", work).await?.into_inner();
        let seq = reading.seq().0;
        Ok(Response::new(listed(reading, LISTED_CUBES, move |cubes| {
            let cubes = Some(messages::insertion(cubes));
            ListCubesResponse { seq, cubes }
        })))
    }

    async fn get_cube(
        &self,
        request: Request<GetCubeRequest>,
    ) -> tonic::Result<Response<GetCubeResponse>> {
        let GetCubeRequest { scene, id } = permitted(request)?;
        bounded(&self.limits, "", async {
            let (scene, settings) = calls::open(&self.service, &scene)?;
            let place = calls::cube(&scene, CubeId(id)).await?;
            let cube = Some(messages::cube((CubeId(id), place), &settings));
            Ok(GetCubeResponse { cube })
        })
        .await
    }

    type ListSolidsStream = Streamed<ListSolidsResponse>;

    async fn list_solids(
        &self,
        request: Request<ListSolidsRequest>,
    ) -> tonic::Result<Response<Self::ListSolidsStream>> {
        let request = permitted(request)?;
        let work = async {
            let (scene, _) = calls::open_solids(&self.service, &request.scene)?;
            Ok((scene.read_all().await?, scene.context()?))
        };
        let (reading, shapes) = bounded(&self.limits, "", work).await?.into_inner();
        let seq = reading.seq().0;
        Ok(Response::new(listed(
            reading,
            LISTED_SOLIDS,
            move |bodies| {
                let solids = Some(solids::insertion(bodies, &shapes));
                ListSolidsResponse { seq, solids }
            },
        )))
    }

    async fn get_solid(
        &self,
        request: Request<GetSolidRequest>,
    ) -> tonic::Result<Response<GetSolidResponse>> {
        let GetSolidRequest { scene, id } = permitted(request)?;
        bounded(&self.limits, "", async {
            let (scene, settings) = calls::open_solids(&self.service, &scene)?;
            let body = calls::solid(&scene, CubeId(id)).await?;
            let shapes = scene.context()?;
            let solid = solids::solid(&(CubeId(id), body), &shapes, settings.scale());
            Ok(GetSolidResponse { solid: Some(solid) })
        })
        .await
    }

    async fn contains(
        &self,
        request: Request<ContainsRequest>,
    ) -> tonic::Result<Response<ContainsResponse>> {
        let ContainsRequest { scene, at } = permitted(request)?;
        bounded(&self.limits, "", async {
            let Some(at) = at else {
                return Err(Fault::in_parameter("at", calls::NO_POINT, "").into());
            };
            let sent = format!("{},{},{}", at.x, at.y, at.z);
            let at = at.into();
            Ok(match calls::open_any(&self.service, &scene)? {
                Opened::Cubes(scene, settings) => {
                    let point = calls::point(at, &sent, &settings)?;
                    let (Seq(seq), side, cube) = scene.contains(point).await?;
                    ContainsResponse {
                        seq,
                        side: messages::side(side).into(),
                        cube: cube.map(|cube| messages::cube(cube, &settings)),
                        point: Some(settings.point_user(point).into()),
                        solid: None,
                    }
                }
                Opened::Solids(scene, settings) => {
                    let scale = settings.scale();
                    let point = calls::point_among_solids(at, &sent, scale)?;
                    let (Seq(seq), side, solid) = scene.contains(point).await?;
                    let shapes = scene.context()?;
                    ContainsResponse {
                        seq,
                        side: messages::side(side).into(),
                        cube: None,
                        point: Some(scale.position(point).into()),
                        solid: solid.map(|solid| solids::solid(&solid, &shapes, scale)),
                    }
                }
            })
        })
        .await
    }

    async fn audit_scene(
        &self,
        request: Request<AuditSceneRequest>,
    ) -> tonic::Result<Response<AuditSceneResponse>> {
        let request = permitted(request)?;
        let work = async {
            let (Seq(seq), cubes) = match calls::open_any(&self.service, &request.scene)? {
                Opened::Cubes(scene, settings) => calls::audit(&scene, &settings).await?,
                Opened::Solids(scene, settings) => calls::audit(&scene, &settings).await?,
            };
            Ok(AuditSceneResponse { seq, cubes })
        };
        answered("", work.await)
    }
}
