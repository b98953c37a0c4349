//! Health, reflection, metrics and the end.

use std::sync::Arc;

use tokio_stream::StreamExt;
use tonic::Code;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;
use tonic_reflection::pb::v1::{ListServiceResponse, ServerReflectionRequest};
use union3d::service::{FailPoint, ServiceConfig};
use union3d::wire::http::Limits;
use union3d::wire::proto::WatchMassPropertiesRequest;

use crate::server::{PATIENCE, Server, channel, refused, row};
use crate::stop::Stop;

/// What a newer version of the program has made is told as that, and left as it is.
#[tokio::test]
async fn a_newer_scene_is_not_called_damaged() {
    let server = Server::start().await;
    server.scene("part", 6).await;
    server.change("part", row(1..10)).await.unwrap();
    let data = server.stop().await;
    let file = data.path().join("scenes/part/scene.sqlite");
    let mut bytes = std::fs::read(&file).unwrap();
    // The number of the format, in the header of the database.
    bytes[60..64].copy_from_slice(&99_i32.to_be_bytes());
    std::fs::write(&file, &bytes).unwrap();

    let config = ServiceConfig::new(data.path());
    let server = Server::on(data, Limits::default(), config, None, true).await;
    let status = server.change("part", row(10..11)).await.unwrap_err();
    refused(&status, Code::FailedPrecondition, "scene-newer");
    for path in ["/v1/scenes/part", "/v1/scenes/part/mass-properties"] {
        let (status, problem) = server.get(path).await;
        let expected = (503, &"/problems/scene-newer".into());
        assert_eq!((status, &problem["type"]), expected, "{problem}");
        let cause = problem["cause"].as_str().unwrap();
        assert!(cause.contains("of format 99"), "{cause}");
    }
    let data = server.stop().await;
    let left = std::fs::read(data.path().join("scenes/part/scene.sqlite")).unwrap();
    assert!(left == bytes, "it was changed");
}

#[tokio::test]
async fn it_serves_only_when_every_scene_is_replayed() {
    let server = Server::start().await;
    server.scene("part", 6).await;
    server.change("part", row(1..10)).await.unwrap();
    let data = server.stop().await;

    let stop = Arc::new(Stop::default());
    let closed = stop.close();
    let config = ServiceConfig::new(data.path());
    let server = Server::on(
        data,
        Limits::default(),
        config,
        Some(stop.hook(FailPoint::Open)),
        false,
    )
    .await;
    let mut health = HealthClient::new(channel(&server.grpc).await);
    for name in ["", "union3d.v1.UnionService"] {
        let request = HealthCheckRequest {
            service: name.to_owned(),
        };
        let answer = health.check(request).await.unwrap().into_inner();
        assert_eq!(answer.status(), ServingStatus::NotServing, "{name:?}");
    }
    let replayed = server.change("part", row(1..2)).await.unwrap_err();
    refused(&replayed, Code::Unavailable, "recovering");
    let request = HealthCheckRequest {
        service: String::new(),
    };
    let mut watch = health.watch(request).await.unwrap().into_inner();
    drop(closed);
    let shown = async {
        while watch.next().await.unwrap().unwrap().status() != ServingStatus::Serving {}
        assert_eq!(server.totals("part").await.cubes, 9);
        server.draining.cancel();
        while watch.next().await.unwrap().unwrap().status() != ServingStatus::NotServing {}
    };
    tokio::time::timeout(PATIENCE, shown).await.unwrap();
}

#[tokio::test]
async fn it_describes_itself() {
    let server = Server::start().await;
    let mut client = ServerReflectionClient::new(channel(&server.grpc).await);
    let mut ask = async |question| {
        let request = ServerReflectionRequest {
            host: String::new(),
            message_request: Some(question),
        };
        let mut answers = client
            .server_reflection_info(tokio_stream::once(request))
            .await
            .unwrap()
            .into_inner();
        answers
            .next()
            .await
            .unwrap()
            .unwrap()
            .message_response
            .unwrap()
    };
    let listed = ask(MessageRequest::ListServices(String::new())).await;
    let MessageResponse::ListServicesResponse(ListServiceResponse { service }) = listed else {
        panic!("{listed:?}");
    };
    let names: Vec<_> = service.iter().map(|service| &*service.name).collect();
    assert!(names.contains(&"union3d.v1.UnionService"), "{names:?}");
    assert!(names.contains(&"grpc.health.v1.Health"), "{names:?}");
    // What is called, and what the details of a status are made of.
    for symbol in [
        "union3d.v1.UnionService.StreamChanges",
        "google.rpc.ErrorInfo",
        "google.rpc.BadRequest",
        "google.rpc.RetryInfo",
    ] {
        let found = ask(MessageRequest::FileContainingSymbol(symbol.to_owned())).await;
        assert!(
            matches!(found, MessageResponse::FileDescriptorResponse(_)),
            "{symbol}: {found:?}"
        );
    }
}

#[tokio::test]
async fn calls_are_counted_by_name_and_status() {
    let server = Server::start().await;
    server.scene("counted", 6).await;
    server.change("counted", row(1..2)).await.unwrap();
    server.change("nowhere", row(1..2)).await.unwrap_err();
    let text = reqwest::get(format!("{}/metrics", server.http))
        .await
        .unwrap();
    let text = text.text().await.unwrap();
    for series in [
        r#"union3d_grpc_requests_total{method="ApplyChange",code="Ok"}"#,
        r#"union3d_grpc_requests_total{method="ApplyChange",code="NotFound"}"#,
        r#"union3d_grpc_request_duration_seconds_count{method="CreateScene"}"#,
    ] {
        assert!(text.contains(series), "{series} is not in {text}");
    }
}

#[tokio::test]
async fn draining_ends_the_streams_and_then_the_server() {
    let server = Server::start().await;
    server.scene("part", 6).await;
    let watch = WatchMassPropertiesRequest {
        scene: "part".to_owned(),
    };
    let mut watch = server
        .client()
        .watch_mass_properties(watch)
        .await
        .unwrap()
        .into_inner();
    watch.next().await.unwrap().unwrap();
    server.draining.cancel();
    let end = loop {
        match watch.next().await.unwrap() {
            Ok(_) => {}
            Err(end) => break end,
        }
    };
    refused(&end, Code::Unavailable, "shutting-down");
    tokio::time::timeout(PATIENCE, server.serving)
        .await
        .unwrap()
        .unwrap();
}
