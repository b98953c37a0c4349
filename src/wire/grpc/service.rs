//! The calls: read the message, ask the service, answer with a message.

use std::future::Future;
use std::pin::Pin;

use futures_util::Stream;
use tokio_util::sync::CancellationToken;
use tonic::{Request, Response, Status, Streaming, async_trait};

use super::messages::{self, Detail};
use super::{idempotency_key, status, stream};
use crate::geometry::CubeId;
use crate::service::{AnyScene, Seq, Service, ServiceError};
use crate::wire::atomic::{Atomic, Run, Sent};
use crate::wire::calls::{self, HistoryRows, within};
use crate::wire::decode;
use crate::wire::http::Limits;
use crate::wire::problem::{Fault, Problem};
use crate::wire::proto::union_service_server::UnionService;
use crate::wire::proto::{
    ApplyChangeRequest, ApplyChangeResponse, AuditSceneRequest, AuditSceneResponse,
    ContainsRequest, ContainsResponse, CreateSceneRequest, CreateSceneResponse, DeleteSceneRequest,
    DeleteSceneResponse, GetCubeRequest, GetCubeResponse, GetHistoryRequest, GetHistoryResponse,
    GetMassPropertiesRequest, GetMassPropertiesResponse, GetSceneRequest, GetSceneResponse,
    ListCubesRequest, ListCubesResponse, ListScenesRequest, ListScenesResponse, RevertSceneRequest,
    RevertSceneResponse, StreamChangesRequest, StreamChangesResponse, WatchMassPropertiesRequest,
    WatchMassPropertiesResponse,
};

/// Cubes of one message of a listing.
const LISTED_CUBES: usize = 4_096;

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
        Ok(answer) => Ok(Response::new(answer)),
        Err(problem) => Err(status::status(&problem, body)),
    }
}

#[async_trait]
impl UnionService for Calls {
    async fn create_scene(
        &self,
        request: Request<CreateSceneRequest>,
    ) -> tonic::Result<Response<CreateSceneResponse>> {
        let CreateSceneRequest { scene, settings } = request.into_inner();
        bounded(&self.limits, "settings", async {
            let name = calls::scene_name(&scene)?;
            let settings = decode::settings_message(&settings.unwrap_or_default())?;
            let (scene, created) = calls::create(&self.service, &name, &settings).await?;
            let scene = Some(messages::scene(&AnyScene::Cubes(scene)));
            Ok(CreateSceneResponse { scene, created })
        })
        .await
    }

    async fn get_scene(
        &self,
        request: Request<GetSceneRequest>,
    ) -> tonic::Result<Response<GetSceneResponse>> {
        let found = self.service.any_scene(&request.get_ref().scene);
        let found = found.map(|scene| GetSceneResponse {
            scene: Some(messages::scene(&scene)),
        });
        answered("", found.map_err(Problem::from))
    }

    async fn list_scenes(
        &self,
        _: Request<ListScenesRequest>,
    ) -> tonic::Result<Response<ListScenesResponse>> {
        let scenes = self.service.scenes();
        Ok(Response::new(ListScenesResponse {
            scenes: scenes.iter().map(messages::scene).collect(),
        }))
    }

    async fn delete_scene(
        &self,
        request: Request<DeleteSceneRequest>,
    ) -> tonic::Result<Response<DeleteSceneResponse>> {
        bounded(&self.limits, "", async {
            calls::remove(&self.service, &request.get_ref().scene).await?;
            Ok(DeleteSceneResponse {})
        })
        .await
    }

    async fn apply_change(
        &self,
        request: Request<ApplyChangeRequest>,
    ) -> tonic::Result<Response<ApplyChangeResponse>> {
        let request = request.into_inner();
        let work = async {
            let detail = Detail::of(request.detail)?;
            let key = idempotency_key(request.idempotency_key.as_deref())?;
            let (scene, settings) = calls::open(&self.service, &request.scene)?;
            let sent = Sent::Message(request.change.unwrap_or_default());
            let change = Atomic::new(scene, settings, sent, self.limits.change_cubes_max);
            let applied = within(self.limits.request_timeout, change.apply(Run::Real, key)).await?;
            let outcome = messages::outcome(detail, &change.scene, &change.settings, &applied);
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
        let answers = stream::open(&self.service, limits, draining, request.into_inner()).await?;
        Ok(Response::new(Box::pin(answers)))
    }

    async fn revert_scene(
        &self,
        request: Request<RevertSceneRequest>,
    ) -> tonic::Result<Response<RevertSceneResponse>> {
        let request = request.into_inner();
        let work = async {
            let detail = Detail::of(request.detail)?;
            let key = idempotency_key(request.idempotency_key.as_deref())?;
            let (scene, settings) = calls::open(&self.service, &request.scene)?;
            // The body that says the same over HTTP, so that a key stands for the same.
            let body = format!("{{\"to\":{}}}", request.to);
            let applied = calls::revert(&scene, Seq(request.to), key, body.as_bytes()).await?;
            let outcome = messages::outcome(detail, &scene, &settings, &applied);
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
        let GetMassPropertiesRequest { scene, at, wait } = request.into_inner();
        bounded(&self.limits, "", async {
            let (scene, settings) = calls::open(&self.service, &scene)?;
            let published = calls::published(&scene, at, wait, self.limits.wait_max).await?;
            let shown = messages::mass_properties(&scene, &settings, &published);
            Ok(GetMassPropertiesResponse {
                mass_properties: Some(shown),
            })
        })
        .await
    }

    type WatchMassPropertiesStream = Streamed<WatchMassPropertiesResponse>;

    async fn watch_mass_properties(
        &self,
        request: Request<WatchMassPropertiesRequest>,
    ) -> tonic::Result<Response<Self::WatchMassPropertiesStream>> {
        let opened = calls::open(&self.service, &request.get_ref().scene);
        let (scene, settings) = answered("", opened)?.into_inner();
        let draining = self.draining.clone();
        let ended = |error: ServiceError| Err(status::status(&error.into(), ""));
        // One value is kept, the newest: this runs only when the client has read what came before.
        Ok(Response::new(Box::pin(async_stream::stream! {
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
                    yield Ok(WatchMassPropertiesResponse { mass_properties: Some(shown) });
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
        })))
    }

    type GetHistoryStream = Streamed<GetHistoryResponse>;

    async fn get_history(
        &self,
        request: Request<GetHistoryRequest>,
    ) -> tonic::Result<Response<Self::GetHistoryStream>> {
        let GetHistoryRequest {
            scene,
            from,
            to,
            move_from,
            move_to,
            detail,
            limit,
        } = request.into_inner();
        let read = || {
            let detail = Detail::of(detail)?;
            let (scene, settings) = calls::open(&self.service, &scene)?;
            let limit = limit.unwrap_or(u64::MAX);
            let rows = HistoryRows::new(scene.clone(), [from, to], [move_from, move_to], limit)?;
            Ok((detail, scene, settings, rows))
        };
        let (detail, scene, settings, mut rows) = answered("", read())?.into_inner();
        Ok(Response::new(Box::pin(async_stream::stream! {
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
        })))
    }

    type ListCubesStream = Streamed<ListCubesResponse>;

    async fn list_cubes(
        &self,
        request: Request<ListCubesRequest>,
    ) -> tonic::Result<Response<Self::ListCubesStream>> {
        let work = async {
            let (scene, _) = calls::open(&self.service, &request.get_ref().scene)?;
            Ok(scene.cubes().await?)
        };
        let (Seq(seq), cubes) = bounded(&self.limits, "", work).await?.into_inner();
        Ok(Response::new(Box::pin(async_stream::stream! {
            if cubes.is_empty() {
                let cubes = Some(messages::insertion(&[]));
                yield Ok(ListCubesResponse { seq, cubes });
            }
            for cubes in cubes.chunks(LISTED_CUBES) {
                let cubes = Some(messages::insertion(cubes));
                yield Ok(ListCubesResponse { seq, cubes });
            }
        })))
    }

    async fn get_cube(
        &self,
        request: Request<GetCubeRequest>,
    ) -> tonic::Result<Response<GetCubeResponse>> {
        let GetCubeRequest { scene, id } = request.into_inner();
        bounded(&self.limits, "", async {
            let (scene, settings) = calls::open(&self.service, &scene)?;
            let place = calls::cube(&scene, CubeId(id)).await?;
            let cube = Some(messages::cube((CubeId(id), place), &settings));
            Ok(GetCubeResponse { cube })
        })
        .await
    }

    async fn contains(
        &self,
        request: Request<ContainsRequest>,
    ) -> tonic::Result<Response<ContainsResponse>> {
        let ContainsRequest { scene, at } = request.into_inner();
        bounded(&self.limits, "", async {
            let (scene, settings) = calls::open(&self.service, &scene)?;
            let Some(at) = at else {
                return Err(Fault::in_parameter("at", calls::NO_POINT, "").into());
            };
            let sent = format!("{},{},{}", at.x, at.y, at.z);
            let point = calls::point([at.x, at.y, at.z], &sent, &settings)?;
            let (Seq(seq), side, cube) = scene.contains(point).await?;
            Ok(ContainsResponse {
                seq,
                side: messages::side(side).into(),
                cube: cube.map(|cube| messages::cube(cube, &settings)),
                point: Some(settings.point_user(point).into()),
            })
        })
        .await
    }

    async fn audit_scene(
        &self,
        request: Request<AuditSceneRequest>,
    ) -> tonic::Result<Response<AuditSceneResponse>> {
        let work = async {
            let (scene, settings) = calls::open(&self.service, &request.get_ref().scene)?;
            let (Seq(seq), cubes) = calls::audit(&scene, &settings).await?;
            Ok(AuditSceneResponse { seq, cubes })
        };
        answered("", work.await)
    }
}
