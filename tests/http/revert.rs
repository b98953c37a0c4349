//! Reverts over HTTP.

use serde_json::{Value, json};

use union3d::service::ServiceConfig;
use union3d::wire::http::Limits;

use crate::random::Random;
use crate::server::{JSON, Server, send};

#[tokio::test]
async fn a_scene_goes_back_and_forward_again() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    for id in 1..=3 {
        let change = json!({"insert": [{"id": id, "at": [id, 0, 0]}]});
        server.change(&scene, &change.to_string()).await.ok();
    }
    let revert = |query: &'static str, body: &'static str| {
        let (server, path) = (&server, format!("{scene}/revert{query}"));
        async move { server.send("POST", &path, JSON, body).await }
    };
    let before = server.totals(&scene).await;
    let back = revert("", r#"{"to": 1}"#).await.ok();
    assert_eq!(
        [&back["seq"], &back["inserted"], &back["deleted"]],
        [4, 0, 2]
    );
    assert_eq!(back["mass_properties"]["volume"], 8.0);
    let forward = revert("?return=minimal", r#"{"to": 3}"#).await.ok();
    assert_eq!([&forward["seq"], &forward["inserted"]], [5, 2]);
    assert_eq!(forward["mass_properties"], Value::Null);
    assert_eq!(server.totals(&scene).await["exact"], before["exact"]);
    // The past is as it was.
    let third = server.get(&format!("{scene}/mass-properties?at=3")).await;
    assert_eq!(third.ok()["exact"], before["exact"]);
}

/// A key stands for the revert that it came with first.
#[tokio::test]
async fn a_retry_with_the_same_key_goes_back_once() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    server
        .change(&scene, r#"{"insert": [{"at": [0, 0, 0]}]}"#)
        .await
        .ok();
    let revert = |body: &'static str| {
        let request = server.request("POST", &format!("{scene}/revert"));
        let request = request
            .header("content-type", JSON)
            .header("Idempotency-Key", "back");
        send(request.body(body))
    };
    let first = revert(r#"{"to": 0}"#).await.ok();
    assert_eq!([&first["seq"], &first["deleted"]], [2, 1]);
    let again = revert(r#"{"to": 0}"#).await;
    assert_eq!(again.headers["Idempotency-Replayed"], "true");
    assert_eq!(again.ok()["seq"], 2);
    revert(r#"{"to": 1}"#)
        .await
        .problem(422, "idempotency-key-reused");
    assert_eq!(server.totals(&scene).await["seq"], 2);
}

/// Behind a snapshot only as many operations are kept as the setting says.
#[tokio::test]
async fn what_is_no_longer_kept_is_gone_with_the_oldest_that_is() {
    let server = Server::with(
        Limits::default(),
        |config| ServiceConfig {
            revert_changes_max: 3,
            ..config
        },
        None,
    )
    .await;
    let scene = server.scene("s", 2).await;
    let path = format!("{scene}/revert");
    // Every cube moves with every change, so that the log is soon longer than what it leads to.
    let mut random = Random::new(1);
    let refused = loop {
        let mut change = json!({"delete": [], "insert": []});
        for id in 0..10_000 {
            let at = [(); 3].map(|()| random.below(1 << 28));
            change["delete"].as_array_mut().unwrap().push(json!(id));
            change["insert"]
                .as_array_mut()
                .unwrap()
                .push(json!({"id": id, "at": at}));
        }
        let newest = server.change(&scene, &change.to_string()).await.ok()["seq"].clone();
        assert!(
            newest.as_u64().unwrap() < 1_000,
            "operations were never dropped"
        );
        let answer = server.send("POST", &path, JSON, r#"{"to": 0}"#).await;
        if answer.status != 200 {
            break answer.problem(410, "seq-not-reachable");
        }
        // Nothing was dropped yet: revert the revert.
        let body = json!({"to": newest}).to_string();
        server.send("POST", &path, JSON, &body).await.ok();
    };
    let oldest = refused["oldest"].as_u64().unwrap();
    assert!(oldest > 0);
}

#[tokio::test]
async fn what_cannot_be_gone_back_to_is_a_problem() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let revert = |body: &'static str| {
        let (server, path) = (&server, format!("{scene}/revert"));
        async move { server.send("POST", &path, JSON, body).await }
    };
    let future = revert(r#"{"to": 1}"#).await.problem(404, "seq-not-reached");
    assert_eq!(future["newest"], 0);
    revert("{").await.problem(400, "bad-json");
    for (body, place) in [
        ("{}", "/to"),
        (r#"{"to": -1}"#, "/to"),
        (r#"{"to": "x"}"#, "/to"),
        // 2^64: a seq is less.
        (r#"{"to": 18446744073709551616}"#, "/to"),
        (r#"{"to": 0, "from": 3}"#, "/from"),
    ] {
        assert_eq!(revert(body).await.places(), [place], "{body}");
    }
}
