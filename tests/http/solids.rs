//! Scenes of solids over HTTP.

use serde_json::{Value, json};

use crate::server::{Answer, JSON, NDJSON, Server};

const SETTINGS: &str = r#"{"kind":"solids","steps_per_unit":1000,
    "shapes":{"b":{"box":[2,3,4]},"t1":{"flat":{"diameter":6,"length":25,"sides":8}}}}"#;

async fn changed(server: &Server, body: &Value) -> Answer {
    server.change("/v1/scenes/part", &body.to_string()).await
}

async fn created() -> Server {
    let server = Server::start().await;
    server.scene_with("part", SETTINGS).await;
    server
}

/// Boxes whose measures everybody can compute, from the first change to the revert.
#[tokio::test]
async fn solids_are_measured_listed_and_reverted() {
    let server = created().await;
    let first = json!({"insert": [
        {"id": 1, "shape": "b", "at": [0, 0, 0]},
        {"id": "2", "shape": "b", "from": [0, 0, 0], "to": [10, 0, 0]},
    ], "move": 7, "duration": 0.5});
    let answer = changed(&server, &first).await.ok();
    assert_eq!(
        (&answer["seq"], &answer["inserted"]),
        (&json!(1), &json!(2))
    );
    // The box carried 10 to the side: 12 x 3 x 4; the other lies in it.
    let totals = &answer["mass_properties"];
    assert_eq!(
        (&totals["solids"], &totals["volume"]),
        (&json!(2), &json!(144.0))
    );
    assert_eq!(totals["area"], 2.0 * (36.0 + 48.0 + 12.0));
    assert_eq!(totals["centroid"], json!([6.0, 1.5, 2.0]));
    assert_eq!(
        totals["exact"]["volume"]["value"],
        (144_i64 * 96).to_string() + "000000000"
    );
    assert_eq!(
        answer["volume_removed_exact"],
        totals["exact"]["volume"]["value"]
    );

    let hull =
        json!({"insert": [{"id": 3, "hull": [[0, 0, 10], [6, 0, 10], [0, 6, 10], [0, 0, 16]]}]});
    let answer = changed(&server, &hull).await.ok();
    assert_eq!(answer["volume_removed"], 36.0);

    let listed = server.get("/v1/scenes/part/solids").await.ok();
    let mut solids = listed["solids"].as_array().unwrap().clone();
    solids.sort_by_key(|solid| solid["id"].as_u64());
    assert_eq!(
        solids[0],
        json!({"id": 1, "shape": "b", "at": [0.0, 0.0, 0.0]})
    );
    assert_eq!(solids[1]["to"], json!([10.0, 0.0, 0.0]));
    assert_eq!(solids[2]["hull"].as_array().unwrap().len(), 4);
    assert_eq!(server.get("/v1/scenes/part/solids/2").await.ok(), solids[1]);
    server
        .get("/v1/scenes/part/solids/9")
        .await
        .problem(404, "no-such-cube");
    // What is listed can be inserted again.
    let again = changed(&server, &json!({ "insert": solids })).await.ok();
    assert_eq!((&again["seq"], &again["unchanged"]), (&json!(2), &json!(3)));
    let lines = server
        .request("GET", "/v1/scenes/part/solids")
        .header("accept", NDJSON);
    let lines = crate::server::send(lines).await;
    assert_eq!(lines.text.lines().count(), 3);

    let gone = server
        .send("DELETE", "/v1/scenes/part/solids/2", JSON, "")
        .await
        .ok();
    assert_eq!(
        (&gone["deleted"], &gone["mass_properties"]["volume"]),
        (&json!(1), &json!(60.0))
    );
    let past = server
        .get("/v1/scenes/part/mass-properties?at=1")
        .await
        .ok();
    assert_eq!(past["volume"], 144.0);
    let back = server
        .send("POST", "/v1/scenes/part/revert", JSON, r#"{"to":2}"#)
        .await
        .ok();
    assert_eq!(
        (&back["seq"], &back["mass_properties"]["volume"]),
        (&json!(4), &json!(180.0))
    );
    let history = server.get("/v1/scenes/part/history").await.ok();
    let removed: Vec<_> = history["changes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|change| change["volume_removed"].as_f64().unwrap())
        .collect();
    assert_eq!(removed, [144.0, 36.0, -120.0, 120.0]);
    assert_eq!(history["changes"][0]["removal_rate"], 288.0);
    let csv = server
        .request("GET", "/v1/scenes/part/history")
        .header("accept", "text/csv");
    let csv = crate::server::send(csv).await.text;
    assert!(
        csv.starts_with("seq,time,move,duration,inserted,deleted,solids,volume_removed,"),
        "{csv}"
    );
    assert_eq!(csv.lines().count(), 5);
    let audit = server
        .send("POST", "/v1/scenes/part/audit", JSON, "")
        .await
        .ok();
    assert_eq!(audit, json!({"seq": 4, "solids": 3, "equal": true}));
}

/// A block of material: what is removed and what remains add up.
#[tokio::test]
async fn a_stock_is_cut() {
    let server = Server::start().await;
    let settings = r#"{"kind":"solids","steps_per_unit":100,"stock":{"min":[0,0,-10],"max":[20,20,0]},
        "shapes":{"b":{"box":[2,3,4]}}}"#;
    server.scene_with("part", settings).await;
    let cut = json!({"insert": [{"shape": "b", "from": [-5, 0, -2], "to": [30, 0, -2]}]});
    let answer = changed(&server, &cut).await.ok();
    assert_eq!(answer["assigned"], json!({"first": 1, "last": 1}));
    let totals = &answer["mass_properties"];
    assert_eq!(
        (&totals["volume"], &totals["remaining"]["volume"]),
        (&json!(120.0), &json!(3880.0))
    );
    // 20 x 3 x 2 along an edge of the block.
    let removed = &totals["removed"];
    assert_eq!(
        (&removed["volume"], &removed["area"], &totals["area"]),
        (&json!(120.0), &json!(212.0), &json!(212.0))
    );
    assert_eq!(
        totals["remaining"]["area"],
        2.0 * 400.0 + 4.0 * 200.0 - 2.0 * 6.0
    );
    let [whole, part] = ["removed", "remaining"].map(|part| {
        let value = totals[part]["exact"]["volume"]["value"].as_str().unwrap();
        value.parse::<i128>().unwrap()
    });
    assert_eq!(whole + part, 4000 * 96 * 1_000_000);
    assert!(totals["error_max"]["volume"].as_f64().unwrap() < 1e-6);
    let csv = server
        .request("GET", "/v1/scenes/part/history")
        .header("accept", "text/csv");
    let csv = crate::server::send(csv).await.text;
    let [header, row] = csv.lines().collect::<Vec<_>>()[..] else {
        panic!("{csv}");
    };
    assert_eq!(header.split(',').count(), row.split(',').count());
    assert!(row.contains(",120,3880,"), "{csv}");
}

/// Lines act in their order; at a bad one the stream stops, and what came before is there.
#[tokio::test]
async fn a_stream_of_solids_is_applied_line_by_line() {
    let server = created().await;
    let scene = "/v1/scenes/part";
    let lines = [
        r#"{"insert":{"id":1,"shape":"b","at":[0,0,0]}}"#,
        r#"{"insert":{"id":2,"shape":"b","from":[0,0,0],"to":[10,0,0]}}"#,
        r#"{"insert":{"id":"3","hull":[[0,0,10],[6,0,10],[0,6,10],[0,0,16]]}}"#,
        r#"{"delete":1}"#,
        r#"{"insert":{"id":1,"shape":"b","at":[20,0,0]}}"#,
    ];
    let answer = server.lines(scene, &lines.join("\n")).await.ok();
    assert_eq!(
        (&answer["inserted"], &answer["deleted"]),
        (&json!(4), &json!(1))
    );
    let totals = server.totals(scene).await;
    assert_eq!(answer["mass_properties"], totals);
    assert_eq!(
        (&totals["solids"], &totals["volume"]),
        (&json!(3), &json!(144.0 + 36.0 + 24.0))
    );
    // What is listed can be streamed back.
    let listing = server
        .request("GET", &format!("{scene}/solids"))
        .header("accept", NDJSON);
    let listing = crate::server::send(listing).await.text;
    let again = server.lines(scene, &listing).await.ok();
    assert_eq!(
        (&again["unchanged"], &again["seq"]),
        (&json!(3), &totals["seq"])
    );
    for (bad, status, code, words) in [
        (
            r#"{"insert":{"id":1,"shape":"b","at":[0,0,0]}}"#,
            409,
            "id-conflict",
            "another body",
        ),
        (
            r#"{"insert":{"shape":"b","at":[0,0,0]}}"#,
            422,
            "invalid",
            "/insert/id is missing",
        ),
        (
            r#"{"insert":{"id":9,"shape":"none","at":[0,0,0]}}"#,
            422,
            "invalid",
            "/insert/shape",
        ),
        (
            r#"{"insert":{"id":9,"hull":[[0,0,0],[1,0,0],[0,1,0]]}}"#,
            422,
            "invalid",
            "/insert/hull",
        ),
        (
            r#"{"insert":{"id":9,"shape":"b","at":[0,"x",0]}}"#,
            422,
            "invalid",
            "/insert/at/1",
        ),
        (r#"{"insert":"#, 400, "bad-json", "column"),
    ] {
        let before = server.totals(scene).await;
        let id = 100 + before["seq"].as_u64().unwrap();
        let good = format!(r#"{{"insert":{{"id":{id},"shape":"b","at":[0,{id},0]}}}}"#);
        let stream = [&good, "", bad, &good.replace("\"id\":1", "\"id\":2")].join("\n");
        let stopped = server.lines(scene, &stream).await.problem(status, code);
        assert_eq!(
            (&stopped["line"], &stopped["committed_lines"]),
            (&json!(3), &json!(2)),
            "{stopped}"
        );
        assert!(
            stopped["detail"].as_str().unwrap().contains(words),
            "{stopped}"
        );
        let after = server.totals(scene).await;
        assert_eq!(stopped["seq"], after["seq"]);
        assert_eq!(
            after["solids"].as_u64(),
            before["solids"].as_u64().map(|solids| solids + 1)
        );
    }
    // Many swept solids are one answer, in several chunks.
    let many: String = (0..6000)
        .map(|id| {
            let x = id % 100;
            format!(
                "{{\"insert\":{{\"id\":{},\"shape\":\"b\",\"at\":[{},{},50]}}}}\n",
                1000 + id,
                10 * x,
                id / 100 * 10
            )
        })
        .collect();
    let answer = server.lines(scene, &many).await.ok();
    assert_eq!(answer["inserted"], 6000);
    assert_eq!(answer["volume_removed"], 6000.0 * 24.0);
}

/// A dry run answers as the change itself would, and does nothing.
#[tokio::test]
async fn a_dry_run_tells_what_a_change_would_do() {
    let server = Server::start().await;
    let solids = r#"{"kind":"solids","steps_per_unit":100,"stock":{"min":[0,0,-10],"max":[20,20,0]},"shapes":{"b":{"box":[2,3,4]}}}"#;
    let cubes = r#"{"edge":2,"steps_per_unit":100,"stock":{"min":[0,0,-10],"max":[20,20,0]}}"#;
    let placed = |id: u64, x: f64, of: &str| match of {
        "solids" => json!({"id": id, "shape": "b", "at": [x, 1, -2]}),
        _ => json!({"id": id, "at": [x, 1, -2]}),
    };
    for (name, settings) in [("solids", solids), ("cubes", cubes)] {
        let scene = server.scene_with(name, settings).await;
        let first = json!({"insert": [placed(1, 0.0, name), placed(2, 10.0, name)]});
        server.change(&scene, &first.to_string()).await.ok();
        let before = server.totals(&scene).await;
        let change = json!({"delete": [1], "insert": [placed(3, 9.0, name), placed(4, 30.0, name)], "move": 7}).to_string();
        let dry = format!("{scene}/changes?dry_run=true");
        let foreseen = server.send("POST", &dry, JSON, &change).await.ok();
        assert_eq!(foreseen["dry_run"], true);
        assert_eq!(
            (&foreseen["seq"], &foreseen["mass_properties"]["seq"]),
            (&json!(1), &Value::Null)
        );
        assert_eq!(server.totals(&scene).await, before, "nothing was done");
        let history = server.get(&format!("{scene}/history")).await.ok();
        assert_eq!(history["changes"].as_array().unwrap().len(), 1);
        let done = server.change(&scene, &change).await.ok();
        assert!(done.get("dry_run").is_none());
        for member in ["inserted", "deleted", "unchanged", "volume_removed_exact"] {
            assert_eq!(foreseen[member], done[member], "{name} {member}");
        }
        let mut totals = done["mass_properties"].clone();
        totals["seq"] = Value::Null;
        assert_eq!(foreseen["mass_properties"], totals, "{name}");
        // Ids that the server would give are given to the next change.
        let mut unnamed = placed(0, 5.0, name);
        unnamed.as_object_mut().unwrap().remove("id");
        let unnamed = json!({"insert": [unnamed]}).to_string();
        for path in [&dry, &format!("{scene}/changes")] {
            let answer = server.send("POST", path, JSON, &unnamed).await.ok();
            assert_eq!(answer["assigned"], json!({"first": 5, "last": 5}));
        }
        // What a change is refused for, a dry run is, too.
        let conflict = json!({"insert": [placed(2, 11.0, name)]}).to_string();
        let refused = server.send("POST", &dry, JSON, &conflict).await;
        refused.problem(409, "id-conflict");
        let request = server.request("POST", &dry).header("content-type", JSON);
        let request = request.header("idempotency-key", "k").body(unnamed.clone());
        assert_eq!(
            crate::server::send(request).await.places(),
            ["Idempotency-Key"]
        );
        let stream = server.send("POST", &dry, NDJSON, "").await;
        assert_eq!(stream.places(), ["dry_run"]);
        let maybe = format!("{scene}/changes?dry_run=maybe");
        let maybe = server.send("POST", &maybe, JSON, &unnamed).await;
        assert_eq!(maybe.places(), ["dry_run"]);
        let audit = server
            .send("POST", &format!("{scene}/audit"), JSON, "")
            .await
            .ok();
        assert_eq!(audit["equal"], true);
    }
}

/// Where a point lies: in the union of the solids, as far as it is in the stock.
#[tokio::test]
async fn a_point_is_inside_on_the_boundary_or_outside() {
    let server = created().await;
    let boxes = json!({"insert": [
        {"id": 7, "shape": "b", "at": [0, 0, 0]},
        {"id": 5, "shape": "b", "at": [2, 0, 0]},
        {"id": 6, "shape": "b", "at": [50, 0, 0]},
    ]});
    changed(&server, &boxes).await.ok();
    for (at, side, solid) in [
        ("1,1,1", "inside", Some(7)),
        ("2,1,1", "inside", Some(5)),
        ("2,1,4", "boundary", Some(5)),
        ("0,0,0", "boundary", Some(7)),
        ("-0.001,0,0", "outside", None),
        ("51,1,1", "inside", Some(6)),
    ] {
        let path = format!("/v1/scenes/part/contains?at={at}");
        let answer = server.get(&path).await.ok();
        assert_eq!(answer["side"], side, "{at}");
        assert_eq!(answer["solid"]["id"].as_u64(), solid, "{at}");
        assert!(answer.get("cube").is_none());
    }
    let far = server.get("/v1/scenes/part/contains?at=0,2e6,0").await;
    assert_eq!(far.places(), ["at"]);
    let settings = r#"{"kind":"solids","stock":{"min":[0,0,0],"max":[10,10,10]}}"#;
    let scene = server.scene_with("block", settings).await;
    let change = r#"{"insert":[{"id":1,"hull":[[-5,-5,-5],[5,-5,-5],[-5,5,-5],[-5,-5,5],[5,5,5]]},
        {"id":2,"hull":[[-5,0,0],[0,0,0],[0,5,0],[0,0,5]]}]}"#;
    server.change(&scene, change).await.ok();
    for (at, side, solid) in [
        ("1,1,1", "inside", Some(1)),
        ("0,1,1", "boundary", Some(1)),
        ("-1,-1,-1", "outside", None),
    ] {
        let answer = server.get(&format!("{scene}/contains?at={at}")).await.ok();
        assert_eq!(
            (&answer["side"], answer["solid"]["id"].as_u64()),
            (&json!(side), solid),
            "{at}"
        );
    }
}

/// Shapes come later, too, and never change; settings are answered with them.
#[tokio::test]
async fn shapes_are_defined_once() {
    let server = created().await;
    let path = "/v1/scenes/part/shapes/t2";
    let ball = r#"{"ball":{"diameter":4,"length":20,"sides":8,"rings":3}}"#;
    for _ in 0..2 {
        let shape = server.send("PUT", path, JSON, ball).await.ok();
        assert_eq!(shape["shape"]["ball"]["diameter"], 4.0);
        assert!(shape["polygon_error"]["inside"].as_f64().unwrap() > 0.0);
    }
    let other = server.send("PUT", path, JSON, r#"{"box":[1,1,1]}"#).await;
    other.problem(409, "shape-exists");
    let scene = server.get("/v1/scenes/part").await.ok();
    assert_eq!(
        (&scene["kind"], &scene["solids"]),
        (&json!("solids"), &json!(0))
    );
    assert!(scene.get("cubes").is_none() && scene.get("edge").is_none());
    let names: Vec<_> = scene["shapes"].as_object().unwrap().keys().collect();
    assert_eq!(names, ["b", "t1", "t2"]);
    let same = server.send("PUT", "/v1/scenes/part", JSON, SETTINGS).await;
    assert_eq!(same.status, 200, "{}", same.text);
    let other = server
        .send(
            "PUT",
            "/v1/scenes/part",
            JSON,
            r#"{"kind":"solids","density":2}"#,
        )
        .await;
    other.problem(409, "scene-exists");
    server
        .send("PUT", "/v1/scenes/part", JSON, r#"{"edge":6}"#)
        .await
        .problem(409, "other-kind");
}

/// Refusals name the place.
#[tokio::test]
async fn what_is_wrong_is_named_with_its_place() {
    let server = created().await;
    let wrong = json!({"insert": [
        {"id": 1, "shape": "b", "at": [0, 0, 0]},
        {"id": 2, "shape": "none", "at": [0, 0, 0]},
        {"id": 3, "hull": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]},
        {"id": 4, "hull": []},
        {"id": 5, "shape": "b", "at": [0, 1e9, 0]},
        {"id": 6, "shape": "b", "from": [0, 0, 0], "to": [9000, 0, 0]},
        {"id": 7},
        {"shape": "b", "at": [0, 0, 0]},
        {"id": 1, "shape": "b", "at": [1, 0, 0]},
    ]});
    let places = changed(&server, &wrong).await.places();
    assert_eq!(
        places,
        [
            "/insert/1/shape",
            "/insert/2/hull",
            "/insert/3/hull",
            "/insert/4/at/1",
            "/insert/5/to",
            "/insert/6",
            "/insert/7",
            "/insert/8/id",
        ]
    );
    let one = |at: i64| json!({"insert": [{"id": 1, "shape": "b", "at": [at, 0, 0]}]});
    changed(&server, &one(0)).await.ok();
    let conflict = changed(&server, &one(1)).await.problem(409, "id-conflict");
    assert_eq!(conflict["id"], 1);
    // A hull whose points are all vertices.
    let paraboloid = |side: i32| -> Value {
        let grid = (0..side).flat_map(|x| (0..side).map(move |y| [x, y, x * x + y * y]));
        grid.map(|steps| steps.map(|steps| f64::from(steps) / 1000.0))
            .map(|point| json!(point))
            .collect()
    };
    let hull = |points: Value| json!({"insert": [{"hull": points}]});
    for (change, place, words) in [
        (
            hull(paraboloid(65)),
            "/insert/0/hull",
            "4225 vertices; the most is 4096",
        ),
        (
            hull(paraboloid(129)),
            "/insert/0/hull",
            "16641 points; the most is 16384",
        ),
        (
            hull(json!([[0, 0, 0], [3000, 0, 0], [0, 1, 0], [0, 0, 1]])),
            "/insert/0/hull",
            "3000000 steps long along x; the most is 2097152",
        ),
        (
            json!({"insert": [{"shape": "b", "from": [0, 0, 0], "to": [0, -3000, 0]}]}),
            "/insert/0/to",
            "3003000 steps long along y; the most is 2097152",
        ),
        (
            json!({"insert": [{"shape": "b", "at": [0, 0, 0]}], "duration": -1}),
            "/duration",
            "is not a number of seconds from 0 to 1e9",
        ),
    ] {
        let refused = changed(&server, &change).await;
        assert_eq!(refused.places(), [place]);
        assert!(refused.text.contains(words), "{}", refused.text);
    }
    assert_eq!(server.totals("/v1/scenes/part").await["seq"], 1);
    // What there is for cubes alone says so.
    server
        .get("/v1/scenes/part/cubes")
        .await
        .problem(409, "other-kind");
}

/// A stock may be any convex solid: a hull, or a round bar. What is answered of it can be sent again.
#[tokio::test]
async fn any_convex_stock_is_cut() {
    let server = Server::start().await;
    let prism = json!({"hull": [[0, 0, -10], [20, 0, -10], [0, 20, -10], [0, 0, 0], [20, 0, 0], [0, 20, 0]]});
    let settings = |stock: &Value| json!({"kind": "solids", "steps_per_unit": 100, "stock": stock, "shapes": {"b": {"box": [2, 3, 4]}}});
    server
        .scene_with("part", &settings(&prism).to_string())
        .await;
    let shown = server.get("/v1/scenes/part").await.ok();
    let points = shown["stock"]["hull"].as_array().unwrap();
    assert_eq!((points.len(), &points[1]), (6, &json!([20.0, 0.0, -10.0])));
    let again = settings(&shown["stock"]).to_string();
    let again = server.send("PUT", "/v1/scenes/part", JSON, &again).await;
    assert_eq!(again.status, 200);
    let cut = json!({"insert": [{"shape": "b", "from": [-5, 0, -2], "to": [30, 0, -2]}]});
    let answer = changed(&server, &cut).await.ok();
    // 2 deep, and along y as long as the slanted side lets it be: the integral of 20 - y from 0 to 3.
    let totals = &answer["mass_properties"];
    assert_eq!(
        (&totals["volume"], &totals["remaining"]["volume"]),
        (&json!(111.0), &json!(1889.0))
    );
    assert_eq!(answer["volume_removed"], 111.0);
    for (at, side) in [
        ("1,1,-1", "inside"),
        ("19,2,-1", "outside"),
        ("20,0,-1", "boundary"),
    ] {
        let found = server
            .get(&format!("/v1/scenes/part/contains?at={at}"))
            .await
            .ok();
        assert_eq!(found["side"], side, "{at}");
    }
    let back = server.send("POST", "/v1/scenes/part/revert", JSON, r#"{"to":0}"#);
    assert_eq!(
        back.await.ok()["mass_properties"]["remaining"]["volume"],
        2000.0
    );
    let past = server
        .get("/v1/scenes/part/mass-properties?at=1")
        .await
        .ok();
    assert_eq!(past["remaining"]["volume"], 1889.0);
    let audit = server.send("POST", "/v1/scenes/part/audit", JSON, "");
    assert_eq!(audit.await.ok()["equal"], true);

    // A box by its corners and as a hull: the same measures.
    let corners: Vec<_> = (0..8)
        .map(|corner| {
            json!([
                20 * (corner & 1),
                20 * (corner >> 1 & 1),
                -10 * (corner >> 2)
            ])
        })
        .collect();
    let mut measured = vec![];
    for (name, stock) in [
        ("box", json!({"min": [0, 0, -10], "max": [20, 20, 0]})),
        ("hull", json!({"hull": corners})),
    ] {
        let path = server.scene_with(name, &settings(&stock).to_string()).await;
        let answer = server.change(&path, &cut.to_string()).await.ok();
        let mut totals = answer["mass_properties"].clone();
        totals["scene"].take();
        measured.push(totals);
    }
    assert_eq!(measured[0], measured[1]);

    // A round bar with sides of its own: an octagon around the circle of diameter 10.
    let bar = json!({"cylinder": {"diameter": 10, "length": 20, "sides": 8, "polygon": "circumscribed", "at": [5, 5, -20]}});
    let path = server.scene_with("bar", &settings(&bar).to_string()).await;
    let shown = server.get(&path).await.ok();
    assert_eq!(shown["stock"]["cylinder"]["sides"], 8);
    let error = shown["stock_polygon_error"]["outside"].as_f64().unwrap();
    assert!((0.41..0.43).contains(&error), "{error}");
    let nothing = server.get(&format!("{path}/mass-properties")).await.ok();
    let volume = nothing["remaining"]["volume"].as_f64().unwrap();
    let octagon = 8.0 * 25.0 * (std::f64::consts::PI / 8.0).tan() * 20.0;
    // Its vertices are rounded to the lattice: by less than a step of 0.01, along all of its surface.
    let most = 0.01 * octagon * 4.0 / 10.0;
    assert!(
        (0.0..most).contains(&(volume - octagon)),
        "{volume} {octagon}"
    );
    assert_eq!(nothing["remaining"]["centroid"], json!([5.0, 5.0, -10.0]));
    let other = bar.to_string().replace("\"sides\":8", "\"sides\":16");
    let other = settings(&serde_json::from_str(&other).unwrap()).to_string();
    server
        .send("PUT", &path, JSON, &other)
        .await
        .problem(409, "scene-exists");
}

/// Settings that cannot be: each fault has its place, also among the shapes.
#[tokio::test]
async fn wrong_settings_are_named_with_their_places() {
    let server = Server::start().await;
    for (settings, places) in [
        (
            r#"{"kind":"solids","steps_per_unit":0.5,"density":-1}"#,
            vec!["/steps_per_unit", "/density"],
        ),
        (r#"{"kind":"balls","edge":6}"#, vec!["/kind"]),
        (
            r#"{"kind":"solids","edge":6,"rounding":"up"}"#,
            vec!["/edge", "/rounding"],
        ),
        (
            r#"{"kind":"solids","stock":{"min":[0,0,0],"max":[1,0,1]},"shapes":{"a/b":{"box":[1,1,1]}}}"#,
            vec!["/stock/max/1", "/shapes/a~1b"],
        ),
        (
            r#"{"kind":"solids","stock":{"min":[0,0,0]}}"#,
            vec!["/stock/max"],
        ),
        (r#"{"kind":"solids","stock":{}}"#, vec!["/stock/min"]),
        (
            r#"{"kind":"solids","stock":{"min":[0,0,0],"max":[1,1,1],"hull":[]}}"#,
            vec!["/stock"],
        ),
        (
            r#"{"kind":"solids","stock":{"hull":[[0,0,0],[1,0,0],[0,1,0],[1,1,0]]}}"#,
            vec!["/stock/hull"],
        ),
        (
            r#"{"kind":"solids","rounding":"reject","stock":{"hull":[[0,0,0],[1,0,0],[0,1,0],[0,0.00005,1]]}}"#,
            vec!["/stock/hull/3/1"],
        ),
        (
            r#"{"kind":"solids","stock":{"hull":[[0,0,0],[1,0,0],[0,1,0],[0,1]]}}"#,
            vec!["/stock/hull/3"],
        ),
        (
            r#"{"kind":"solids","stock":{"cylinder":{"diameter":10,"length":20,"sides":1024}}}"#,
            vec!["/stock/cylinder"],
        ),
        (
            r#"{"kind":"solids","stock":{"cylinder":{"diameter":10,"length":20,"tip":3}}}"#,
            vec!["/stock/cylinder/tip"],
        ),
        (r#"{"kind":"solids","shapes":[]}"#, vec!["/shapes"]),
        (
            r#"{"kind":"solids","shapes":{"a":{"box":[1,1,1]},"a":{"box":[1,1,2]}}}"#,
            vec!["/shapes/a"],
        ),
        (
            r#"{"kind":"solids","shapes":{"a":{"flat":{"diameter":"6"}},"b":{"flat":{"diameter":6,"length":20,"sides":70000,"point":1}},
                "c":{"box":[1,2]},"d":{"box":{"min":[0,0,0],"max":[1,null,1]}},"e":{"box":7},"f":{"ball":{"diameter":6,"length":20},"box":[1,1,1]},
                "g":"flat","h":{"hull":[[0,0,0],[1,0]]},"i":{"parts":[{"box":[1,1,1]},{"vee":{"diameter":6,"length":20,"rings":3}}]}}}"#,
            vec![
                "/shapes/a/flat/length",
                "/shapes/a/flat/diameter",
                "/shapes/b/flat/point",
                "/shapes/b/flat/sides",
                "/shapes/c/box",
                "/shapes/d/box/max/1",
                "/shapes/e/box",
                "/shapes/f",
                "/shapes/g",
                "/shapes/h/hull/1",
                "/shapes/i/parts/1/vee/rings",
            ],
        ),
        (
            r#"{"kind":"solids","shapes":{"a":{"flat":{"diameter":-6,"length":20}},"b":{"flat":{"diameter":0.00001,"length":20}},
                "c":{"hull":[[0,0,0],[1,0,0],[0,1,0],[1,1,0]]},"d":{"box":[1,0,1]},"e":{"parts":[]},"f":{"flat":{"diameter":6,"length":20,"sides":2}}}}"#,
            vec![
                "/shapes/a/flat/diameter",
                "/shapes/b/flat/diameter",
                "/shapes/c/hull",
                "/shapes/d/box/1",
                "/shapes/e/parts",
                "/shapes/f/flat/sides",
            ],
        ),
    ] {
        let answer = server.send("PUT", "/v1/scenes/x", JSON, settings).await;
        assert_eq!(answer.places(), places, "{}", answer.text);
    }
    server
        .get("/v1/scenes/x")
        .await
        .problem(404, "no-such-scene");
}

/// A shape with a top reaches up to it wherever it is carried, and no higher.
#[tokio::test]
async fn a_top_is_reached_wherever_a_shape_is_carried() {
    let server = Server::start().await;
    let bit =
        |length: i64| json!({"ball": {"diameter": 4, "length": length, "sides": 8, "rings": 3}});
    let mut topped = bit(5);
    topped["top"] = json!(4);
    let settings = |shapes: Value| {
        json!({"kind": "solids", "steps_per_unit": 1000, "shapes": shapes}).to_string()
    };
    let short = server
        .scene_with("short", &settings(json!({"t": topped})))
        .await;
    let long = json!({"t6": bit(6), "t7": bit(7)});
    let long = server.scene_with("long", &settings(long)).await;
    // At z = -2 the top is 6 above the tip, at -3 it is 7.
    let sweeps = |shapes: [&str; 2]| {
        json!({"insert": [
            {"id": 1, "shape": shapes[0], "from": [0, 0, -2], "to": [9, 2, -2]},
            {"id": 2, "shape": shapes[1], "from": [9, 2, -3], "to": [9, 2, -3]},
        ]})
        .to_string()
    };
    let mut measured = vec![];
    for (scene, shapes) in [(&short, ["t", "t"]), (&long, ["t6", "t7"])] {
        let answer = server.change(scene, &sweeps(shapes)).await.ok();
        measured.push(answer["mass_properties"]["exact"].clone());
    }
    for measure in [
        "volume",
        "area",
        "edge_length",
        "first_moments",
        "second_moments",
    ] {
        let [one, other] = [0, 1].map(|scene: usize| &measured[scene][measure]["value"]);
        assert_eq!(one, other, "{measure}");
    }
    assert_eq!(server.get(&short).await.ok()["shapes"]["t"], {
        let mut shown = topped.clone();
        for (member, value) in [
            ("polygon", json!("equal_area")),
            ("at", json!([0.0, 0.0, 0.0])),
            ("diameter", json!(4.0)),
            ("length", json!(5.0)),
        ] {
            shown["ball"][member] = value;
        }
        shown["top"] = json!(4.0);
        shown
    });
    let above = json!({"insert": [{"shape": "t", "from": [0, 0, -2], "to": [0, 0, -0.999]}]});
    let refused = server.change(&short, &above.to_string()).await;
    assert_eq!(refused.places(), ["/insert/0/to"]);
    assert!(
        refused.text.contains("above the common top at 4000"),
        "{}",
        refused.text
    );
    for (shape, places) in [
        (
            json!({"hull": [[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4]], "top": 9}),
            vec!["/top"],
        ),
        (json!({"box": [1, 1, 1], "top": 1e9}), vec!["/top"]),
        (json!({"box": [1, 1, 1], "top": null}), vec!["/top"]),
        (json!({"box": [1, 1, 1], "bottom": 1}), vec!["/bottom"]),
        (json!({"top": 1}), vec![""]),
        (
            json!({"parts": [{"box": [1, 1, 1], "top": 2}]}),
            vec!["/parts/0/top"],
        ),
    ] {
        let answer = server
            .send(
                "PUT",
                &format!("{short}/shapes/s"),
                JSON,
                &shape.to_string(),
            )
            .await;
        assert_eq!(answer.places(), places, "{shape}: {}", answer.text);
    }
}

/// Where coordinates between two steps are rejected, vertices are on the lattice or refused; elsewhere they are rounded.
#[tokio::test]
async fn what_is_off_the_lattice_is_rounded_or_refused() {
    let server = Server::start().await;
    for (name, rounding) in [("near", "nearest"), ("strict", "reject")] {
        let settings = json!({"kind": "solids", "steps_per_unit": 10, "rounding": rounding});
        server.scene_with(name, &settings.to_string()).await;
    }
    let hull = r#"{"insert":[{"hull":[[0,0,0],[1,0,0],[0,1.04,0],[0,0,1]]}]}"#;
    let rounded = server.change("/v1/scenes/near", hull).await.ok();
    assert_eq!(
        rounded["mass_properties"]["bounds"]["max"],
        json!([1.0, 1.0, 1.0])
    );
    let refused = server.change("/v1/scenes/strict", hull).await;
    assert_eq!(refused.places(), ["/insert/0/hull/2/1"]);
    assert!(
        refused
            .text
            .contains("1.04 is 10.4 steps, which is off the lattice"),
        "{}",
        refused.text
    );
    let exact = hull.replace("1.04", "1.1");
    server.change("/v1/scenes/strict", &exact).await.ok();
}

/// `kind` may be said of a scene of cubes, too.
#[tokio::test]
async fn scenes_of_cubes_may_say_so() {
    let server = Server::start().await;
    let path = server
        .scene_with("pocket", r#"{"kind":"cubes","edge":6}"#)
        .await;
    let same = server.send("PUT", &path, JSON, r#"{"edge":6}"#).await.ok();
    assert!(
        same.get("kind").is_none(),
        "nothing else is answered: {same}"
    );
    let shape = format!("{path}/shapes/b");
    let shape = server.send("PUT", &shape, JSON, r#"{"box":[1,1,1]}"#).await;
    shape.problem(409, "other-kind");
}

/// A key is answered again.
#[tokio::test]
async fn a_key_is_answered_again() {
    let server = created().await;
    let send = || {
        let request = server.request("POST", "/v1/scenes/part/changes?return=minimal");
        let request = request
            .header("content-type", JSON)
            .header("idempotency-key", "k1");
        crate::server::send(request.body(r#"{"insert":[{"shape":"b","at":[0,0,0]}]}"#))
    };
    let first = send().await;
    let again = send().await;
    assert_eq!(again.header("idempotency-replayed"), "true");
    assert_eq!(first.ok(), again.ok());
}
