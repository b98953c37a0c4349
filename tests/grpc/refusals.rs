//! What is refused has the codes of HTTP, and nothing of it is applied.

use std::time::Duration;

use serde_json::json;
use tonic::codegen::http::uri::PathAndQuery;
use tonic::{Code, Request, Status};
use tonic_types::StatusExt;
use union3d::wire::http::Limits;
use union3d::wire::proto::{
    ApplyChangeRequest, ApplyChangeResponse, Change, CreateSceneRequest, GetMassPropertiesRequest,
    ListCubesResponse, SceneSettings,
};

use crate::server::{Server, channel, refused, row};

#[tokio::test]
async fn settings_are_refused_field_by_field() {
    let server = Server::start().await;
    let create = async |scene: &str, settings| {
        let request = CreateSceneRequest {
            scene: scene.to_owned(),
            settings: Some(settings),
            solids: None,
        };
        server.client().create_scene(request).await.unwrap_err()
    };
    let wrong = SceneSettings {
        edge: f64::NAN,
        steps_per_unit: Some(0),
        unit: Some(String::new()),
        density: Some(-1.0),
        anchor: 9,
        rounding: 9,
        stock: None,
    };
    let mut fields = refused(&create("a", wrong).await, Code::InvalidArgument, "invalid");
    fields.sort();
    let expected = [
        "anchor",
        "density",
        "edge",
        "rounding",
        "steps_per_unit",
        "unit",
    ];
    assert_eq!(fields, expected.map(|field| format!("settings.{field}")));
    let missing = create("a", SceneSettings::default()).await;
    assert_eq!(
        refused(&missing, Code::InvalidArgument, "invalid"),
        ["settings.edge"]
    );
    let settings = SceneSettings {
        edge: 1.0,
        ..SceneSettings::default()
    };
    let name = create("../a", settings).await;
    assert_eq!(refused(&name, Code::InvalidArgument, "invalid"), ["scene"]);
}

#[tokio::test]
async fn changes_are_refused_whole_with_their_places() {
    let server = Server::start().await;
    server.scene("part", 6).await;
    server.change("part", row(1..2)).await.unwrap();
    let mut change = row(5..8);
    change.y.pop();
    let uneven = server.change("part", change.clone()).await.unwrap_err();
    assert_eq!(
        refused(&uneven, Code::InvalidArgument, "invalid"),
        ["change.y"]
    );
    change.y = vec![0, i32::MAX, 0];
    let far = server.change("part", change.clone()).await.unwrap_err();
    assert_eq!(
        refused(&far, Code::InvalidArgument, "invalid"),
        ["change.y[1]"]
    );
    // An id at two places of the change, and one that is elsewhere in the scene, as HTTP tells them apart.
    change.y = vec![0; 3];
    change.insert_id = vec![5, 6, 5];
    let twice = server.change("part", change.clone()).await.unwrap_err();
    assert_eq!(
        refused(&twice, Code::InvalidArgument, "invalid"),
        ["change.insert_id[2]"]
    );
    change.insert_id = vec![5, 1, 6];
    let conflict = server.change("part", change.clone()).await.unwrap_err();
    assert_eq!(
        refused(&conflict, Code::AlreadyExists, "id-conflict"),
        ["change.insert_id[1]"]
    );
    let details = conflict.get_error_details();
    assert_eq!(details.error_info().unwrap().metadata["id"], "1");
    let body = json!({"insert": [{"id": 5, "at": [5, 0, 0]}, {"id": 1, "at": [6, 0, 0]}]});
    let (status, problem) = server.post("/v1/scenes/part/changes", &body).await;
    assert_eq!(
        (status, &problem["type"]),
        (409, &json!("/problems/id-conflict"))
    );
    assert_eq!(problem["detail"], conflict.message());

    let nowhere = server.change("nowhere", row(1..2)).await.unwrap_err();
    refused(&nowhere, Code::NotFound, "no-such-scene");
    let mut request = ApplyChangeRequest {
        scene: "part".to_owned(),
        change: Some(row(5..6)),
        idempotency_key: Some("two words".to_owned()),
        ..ApplyChangeRequest::default()
    };
    let key = server
        .client()
        .apply_change(request.clone())
        .await
        .unwrap_err();
    assert_eq!(
        refused(&key, Code::InvalidArgument, "invalid"),
        ["idempotency_key"]
    );
    request.idempotency_key = None;
    request.detail = 77;
    let detail = server.client().apply_change(request).await.unwrap_err();
    assert_eq!(
        refused(&detail, Code::InvalidArgument, "invalid"),
        ["detail"]
    );
    let totals = server.totals("part").await;
    assert_eq!((totals.seq, totals.cubes), (1, 1));
}

#[tokio::test]
async fn limits_are_those_of_http() {
    let limits = Limits {
        body_bytes_max: 4_000,
        change_cubes_max: 10,
        wait_max: Duration::from_millis(50),
        ..Limits::default()
    };
    let server = Server::with(limits, |config| config, None).await;
    server.scene("part", 6).await;
    let cubes = server.change("part", row(1..12)).await.unwrap_err();
    refused(&cubes, Code::ResourceExhausted, "too-large");
    let bytes = server.change("part", row(1..2_000)).await.unwrap_err();
    refused(&bytes, Code::ResourceExhausted, "too-large");
    server.change("part", row(1..11)).await.unwrap();
    let get = |at, wait| GetMassPropertiesRequest {
        scene: "part".to_owned(),
        at,
        wait,
    };
    let mut client = server.client();
    let ask = async |request| client.get_mass_properties(request).await.unwrap_err();
    let mut ask = ask;
    refused(
        &ask(get(None, Some(2))).await,
        Code::DeadlineExceeded,
        "wait-timeout",
    );
    refused(
        &ask(get(Some(2), None)).await,
        Code::OutOfRange,
        "seq-not-reached",
    );
    let both = ask(get(Some(1), Some(1))).await;
    assert_eq!(refused(&both, Code::InvalidArgument, "invalid"), ["wait"]);
}

/// Sends a message to a path as it is.
async fn raw<M: prost::Message + 'static>(
    server: &Server,
    path: &'static str,
    message: M,
) -> Status {
    let mut grpc = tonic::client::Grpc::new(channel(&server.grpc).await);
    grpc.ready().await.unwrap();
    let codec = tonic_prost::ProstCodec::<M, ApplyChangeResponse>::default();
    let path = PathAndQuery::from_static(path);
    grpc.unary(Request::new(message), path, codec)
        .await
        .unwrap_err()
}

#[tokio::test]
async fn what_the_library_refuses_has_a_reason_too() {
    let server = Server::start().await;
    let other = ListCubesResponse {
        seq: 1,
        cubes: Some(Change::default()),
    };
    let path = "/union3d.v1.UnionService/ApplyChange";
    let bad = raw(&server, path, other.clone()).await;
    refused(&bad, Code::InvalidArgument, "bad-protobuf");
    let none = raw(&server, "/union3d.v1.UnionService/Nothing", other).await;
    refused(&none, Code::Unimplemented, "no-such-path");
}
