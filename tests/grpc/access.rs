//! Who may do what over gRPC: keys and their rights, and the name that is asked for.

use std::collections::BTreeSet;

use prost::Message;
use tonic::codegen::http::uri::PathAndQuery;
use tonic::transport::Endpoint;
use tonic::{Code, Request, Response, Status};
use tonic_prost::ProstCodec;
use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
use tonic_reflection::pb::v1::{
    ServerReflectionRequest, server_reflection_request::MessageRequest,
};
use union3d::wire::access::keys::Right;
use union3d::wire::access::{CALLS, Need};
use union3d::wire::proto::{
    CreateSceneRequest, FILE_DESCRIPTOR_SET, GetSceneRequest, ListScenesRequest, SceneSettings,
    StreamChangesRequest, StreamOpening, WatchMassPropertiesRequest,
    stream_changes_request as sent,
};

use crate::keys::KeyFile;
use crate::server::{Server, channel, refused, row};

/// A request with a key.
fn with<T>(message: T, key: &str) -> Request<T> {
    let mut request = Request::new(message);
    let value = format!("Bearer {key}").parse().unwrap();
    request.metadata_mut().insert("authorization", value);
    request
}

/// All methods, by name.
fn methods() -> Vec<String> {
    let files = prost_types::FileDescriptorSet::decode(FILE_DESCRIPTOR_SET).unwrap();
    let services = files.file.iter().flat_map(|file| &file.service);
    let methods = services.flat_map(|service| &service.method);
    methods.map(|method| method.name().to_owned()).collect()
}

/// Calls a method with a message that names a scene, which is the first field of all of them.
async fn call(
    server: &Server,
    method: &str,
    scene: &str,
    key: Option<&str>,
) -> Result<Response<()>, Status> {
    let mut client = tonic::client::Grpc::new(channel(&server.grpc).await);
    client.ready().await.unwrap();
    let path = format!("/union3d.v1.UnionService/{method}")
        .parse::<PathAndQuery>()
        .unwrap();
    let scene = scene.to_owned();
    if method == "StreamChanges" {
        let opening = StreamOpening {
            scene,
            ..StreamOpening::default()
        };
        let opening = StreamChangesRequest {
            message: Some(sent::Message::Opening(opening)),
        };
        let request = key.map_or_else(
            || Request::new(opening.clone()),
            |key| with(opening.clone(), key),
        );
        return client
            .unary(
                request,
                path,
                ProstCodec::<StreamChangesRequest, ()>::default(),
            )
            .await;
    }
    let named = GetSceneRequest { scene };
    let request = key.map_or_else(
        || Request::new(named.clone()),
        |key| with(named.clone(), key),
    );
    client
        .unary(request, path, ProstCodec::<GetSceneRequest, ()>::default())
        .await
}

#[test]
fn every_method_stands_in_the_table_of_what_calls_need() {
    let listed = CALLS
        .iter()
        .filter(|call| call.grpc)
        .map(|call| call.name.to_owned());
    let (listed, there) = (listed.collect::<Vec<_>>(), methods());
    assert_eq!(listed.len(), there.len());
    assert_eq!(
        listed.into_iter().collect::<BTreeSet<_>>(),
        there.into_iter().collect()
    );
}

#[tokio::test]
async fn every_method_is_refused_to_who_has_not_the_right() {
    let (file, [other, read, write]) = KeyFile::new([
        ("other", Right::Admin, "other"),
        ("read", Right::Read, "part"),
        ("write", Right::Write, "part"),
    ]);
    let server = Server::guarded(file.access()).await;
    for method in methods() {
        let without = call(&server, &method, "part", None).await.unwrap_err();
        refused(&without, Code::Unauthenticated, "unauthenticated");
        let unknown = call(&server, &method, "part", Some("u3d_unknown"))
            .await
            .unwrap_err();
        refused(&unknown, Code::Unauthenticated, "unauthenticated");
        let need = CALLS.iter().find(|call| call.name == method).unwrap().need;
        let too_little: &[&String] = match need {
            Need::Nothing | Need::AnyKey | Need::All(_) => &[],
            Need::Scene(Right::Read) => &[&other],
            Need::Scene(Right::Write) => &[&other, &read],
            Need::Scene(Right::Admin) => &[&other, &read, &write],
        };
        for key in too_little {
            let status = call(&server, &method, "part", Some(key))
                .await
                .expect_err(&method);
            refused(&status, Code::PermissionDenied, "forbidden");
        }
    }
    assert_eq!(server.service.scenes().len(), 0);
}

#[tokio::test]
async fn each_right_does_what_it_is_for_and_lists_what_it_may_read() {
    let (file, [admin, read]) = KeyFile::new([
        ("admin", Right::Admin, "*"),
        ("read", Right::Read, "part-*"),
    ]);
    let access = file.access();
    let server = Server::guarded(access.clone()).await;
    let mut client = server.client();
    for name in ["part-1", "jig"] {
        let create = CreateSceneRequest {
            scene: name.to_owned(),
            settings: Some(SceneSettings {
                edge: 2.0,
                ..SceneSettings::default()
            }),
            solids: None,
        };
        client.create_scene(with(create, &admin)).await.unwrap();
    }
    for (key, names) in [(&admin, vec!["jig", "part-1"]), (&read, vec!["part-1"])] {
        let listed = client
            .list_scenes(with(ListScenesRequest {}, key))
            .await
            .unwrap();
        let found: Vec<_> = listed
            .get_ref()
            .scenes
            .iter()
            .map(|scene| &*scene.name)
            .collect();
        assert_eq!(found, names);
    }
    let status = client
        .get_scene(with(
            GetSceneRequest {
                scene: "jig".to_owned(),
            },
            &read,
        ))
        .await
        .unwrap_err();
    refused(&status, Code::PermissionDenied, "forbidden");

    // A stream ends with the key that opened it: what happens after that is not told.
    let watch = WatchMassPropertiesRequest {
        scene: "part-1".to_owned(),
    };
    let mut watched = client
        .watch_mass_properties(with(watch, &read))
        .await
        .unwrap()
        .into_inner();
    watched.message().await.unwrap().unwrap();
    let text = std::fs::read_to_string(&file.path).unwrap();
    let kept = text
        .lines()
        .filter(|line| !line.starts_with("read"))
        .collect::<String>();
    std::fs::write(&file.path, kept).unwrap();
    access.reload();
    let change = union3d::wire::proto::ApplyChangeRequest {
        scene: "part-1".to_owned(),
        change: Some(row(1..3)),
        ..Default::default()
    };
    client.apply_change(with(change, &admin)).await.unwrap();
    let ended = watched.message().await.unwrap_err();
    refused(&ended, Code::Unauthenticated, "unauthenticated");
}

/// Health and the description are for everybody, as they are over HTTP.
#[tokio::test]
async fn health_and_reflection_need_no_key() {
    let (file, []) = KeyFile::new([]);
    let server = Server::guarded(file.access()).await;
    let mut health =
        tonic_health::pb::health_client::HealthClient::new(channel(&server.grpc).await);
    let request = tonic_health::pb::HealthCheckRequest {
        service: String::new(),
    };
    health.check(request).await.unwrap();
    let mut reflection = ServerReflectionClient::new(channel(&server.grpc).await);
    let list = ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::ListServices(String::new())),
    };
    let answers = reflection
        .server_reflection_info(tokio_stream::iter([list]))
        .await
        .unwrap();
    assert!(answers.into_inner().message().await.unwrap().is_some());
}

/// What is asked for is checked as over HTTP; a page of another origin has no business here.
#[tokio::test]
async fn a_strangers_authority_is_refused() {
    let server = Server::start().await;
    let ask = async |authority: &str| {
        let endpoint = Endpoint::from_shared(server.grpc.clone()).unwrap();
        let endpoint = endpoint.origin(authority.parse().unwrap());
        let channel = endpoint.connect().await.unwrap();
        let mut client =
            union3d::wire::proto::union_service_client::UnionServiceClient::new(channel);
        client.list_scenes(ListScenesRequest {}).await
    };
    ask("http://localhost:1").await.unwrap();
    let status = ask("http://evil.example:7374").await.unwrap_err();
    refused(&status, Code::PermissionDenied, "host-not-allowed");
    let mut page = Request::new(ListScenesRequest {});
    page.metadata_mut()
        .insert("origin", "http://evil.example".parse().unwrap());
    let status = server.client().list_scenes(page).await.unwrap_err();
    refused(&status, Code::PermissionDenied, "origin-not-allowed");
}
