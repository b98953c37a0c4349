//! Going back over HTTP.

use serde_json::{Value, json};

use crate::server::{JSON, Server};

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
        (r#"{"to": 0, "from": 3}"#, "/from"),
    ] {
        assert_eq!(revert(body).await.places(), [place], "{body}");
    }
}
