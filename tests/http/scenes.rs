//! The life of scenes.

use serde_json::json;

use crate::server::{JSON, Server};

#[tokio::test]
async fn a_scene_is_created_found_and_dropped() {
    let server = Server::start().await;
    let settings = json!({"edge": 6, "steps_per_unit": 1000, "unit": "mm", "density": 1, "anchor": "corner", "rounding": "nearest"});
    let put = |body: String| server.send("PUT", "/v1/scenes/pocket", JSON, Box::leak(body.into()));

    assert_eq!(put(settings.to_string()).await.status, 201);
    // All but the edge are the defaults; and the same settings may be written in another way.
    assert_eq!(put(json!({"edge": 6.0}).to_string()).await.status, 200);
    let other = put(json!({"edge": 6, "density": 2}).to_string()).await;
    let problem = other.problem(409, "scene-exists");
    assert_eq!(problem["settings"]["density"], 1.0);

    let scene = server.get("/v1/scenes/pocket").await.ok();
    for (name, value) in [
        ("name", json!("pocket")),
        ("edge", json!(6.0)),
        ("steps_per_unit", json!(1000)),
        ("unit", json!("mm")),
        ("density", json!(1.0)),
        ("anchor", json!("corner")),
        ("rounding", json!("nearest")),
        ("cubes", json!(0)),
        ("seq", json!(0)),
        ("state", json!("running")),
    ] {
        assert_eq!(scene[name], value, "{name}");
    }
    server.scene("a.second_one-1", 2).await;
    let list = server.get("/v1/scenes").await.ok();
    assert_eq!(list["scenes"][0]["name"], "a.second_one-1");
    assert_eq!(list["scenes"][1], scene);

    let dropped = server.send("DELETE", "/v1/scenes/pocket", JSON, "").await;
    assert_eq!((dropped.status, dropped.text.as_str()), (204, ""));
    let gone = server.get("/v1/scenes/pocket").await;
    gone.problem(404, "no-such-scene");
    let gone = server.send("DELETE", "/v1/scenes/pocket", JSON, "").await;
    gone.problem(404, "no-such-scene");

    // A new life under the old name is told from the old one.
    server.scene("pocket", 6).await;
    let again = server.get("/v1/scenes/pocket").await.ok();
    assert_ne!(again["incarnation"], scene["incarnation"]);
}

#[tokio::test]
async fn wrong_settings_are_named() {
    let server = Server::start().await;
    for (body, places) in [
        ("{}", vec!["/edge"]),
        (r#"{"edge":"6"}"#, vec!["/edge"]),
        (r#"{"edge":0.0005}"#, vec!["/edge"]),
        (r#"{"edge":20000}"#, vec!["/edge"]),
        (r#"{"edge":1e999}"#, vec!["/edge"]),
        (
            r#"{"edge":6,"density":-1,"colour":"red"}"#,
            vec!["/colour", "/density"],
        ),
        (
            r#"{"edge":6,"steps_per_unit":0.5,"unit":7,"anchor":"middle","rounding":null}"#,
            vec!["/unit", "/anchor", "/rounding", "/steps_per_unit"],
        ),
        ("[6]", vec![""]),
    ] {
        let answer = server.send("PUT", "/v1/scenes/x", JSON, body).await;
        assert_eq!(answer.places(), places, "{body}");
    }
    let answer = server.send("PUT", "/v1/scenes/x", JSON, "{\"edge\":").await;
    answer.problem(400, "bad-json");
    for name in ["Pocket", "-x", "a%20b", &"x".repeat(64), "%C3%A4"] {
        let path = format!("/v1/scenes/{name}");
        let answer = server.send("PUT", &path, JSON, "{\"edge\":6}").await;
        assert_eq!(answer.places(), ["scene"], "{name}");
    }
    assert_eq!(server.get("/v1/scenes").await.ok()["scenes"], json!([]));
}

/// What the API makes of a scene's settings is made once, not for every request.
#[tokio::test]
async fn settings_are_read_once_a_scene() {
    let server = Server::start().await;
    let name = union3d::service::SceneName::new("s").unwrap();
    let edge = union3d::geometry::Edge::new(2).unwrap();
    let (scene, _) = server
        .service
        .create(&name, edge, None, "text")
        .await
        .unwrap();
    let mut readings = 0;
    for _ in 0..3 {
        let made = scene.settings_as(|text| {
            readings += 1;
            (readings > 1).then_some(text.len())
        });
        assert_eq!(made.as_deref(), (readings > 1).then_some(&4));
    }
    // Nothing was made of them at first, and that was not kept.
    assert_eq!(readings, 2);
}

/// Who writes every member writes null for what is not there.
#[tokio::test]
async fn a_stock_of_null_is_none() {
    let server = Server::start().await;
    for (name, settings) in [
        ("cubes", json!({"edge": 6})),
        ("solids", json!({"kind": "solids"})),
    ] {
        let path = format!("/v1/scenes/{name}");
        let mut with_null = settings.clone();
        with_null["stock"] = json!(null);
        let created = server
            .send("PUT", &path, JSON, &with_null.to_string())
            .await;
        assert_eq!(created.status, 201, "{}", created.text);
        assert!(created.json().get("stock").is_none());
        let again = server.send("PUT", &path, JSON, &settings.to_string()).await;
        assert_eq!(again.status, 200, "{}", again.text);
    }
}

/// The lightest of materials on the finest of lattices: what its inertia is can be written as a number, and is.
#[tokio::test]
async fn inertia_does_not_vanish_at_tiny_densities() {
    const DENSITY: f64 = 1e-300;
    let server = Server::start().await;
    let settings = json!({"edge": 1, "steps_per_unit": 1_000_000, "density": DENSITY});
    let cubes = server.scene_with("cubes", &settings.to_string()).await;
    let settings = json!({"kind": "solids", "steps_per_unit": 1_000_000, "density": DENSITY, "shapes": {"box": {"box": [1, 1, 1]}}});
    let solids = server.scene_with("solids", &settings.to_string()).await;
    server
        .change(&cubes, r#"{"insert":[{"id":1,"at":[5,5,5]}]}"#)
        .await
        .ok();
    server
        .change(
            &solids,
            r#"{"insert":[{"id":1,"shape":"box","at":[5,5,5]}]}"#,
        )
        .await
        .ok();
    for scene in [cubes, solids] {
        let totals = server.totals(&scene).await;
        let expected = DENSITY / 6.0;
        let inertia = totals["inertia"][1][1].as_f64().unwrap();
        assert!(
            (inertia / expected - 1.0).abs() < 1e-9,
            "{scene}: {inertia}"
        );
    }
}
