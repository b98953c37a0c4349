//! What simulators of machines ask for: a stock, what each move removed, and the history of it as lines.

use prost::Message;
use serde_json::{Value, json};
use union3d::geometry::{CubeId, Edge, Place, Stock};
use union3d::service::{Counting, Motion, Operations, Submission};
use union3d::wire::proto::Change;

use crate::server::{JSON, PROTOBUF, Server, send};

const SETTINGS: &str = r#"{"edge":2,"steps_per_unit":10,"stock":{"min":[0,0,0],"max":[10,4,1.5]}}"#;

#[tokio::test]
async fn a_stock_is_cut() {
    let server = Server::start().await;
    let scene = server.scene_with("s", SETTINGS).await;
    let whole = server.totals(&scene).await;
    assert_eq!(whole["removed"]["volume"], 0.0);
    assert_eq!(whole["remaining"]["volume"], 60.0);
    assert_eq!(whole["remaining"]["centroid"], json!([5.0, 2.0, 0.75]));
    // Half of it sticks out of the stock, in x and above.
    let change = r#"{"insert":[{"id":1,"at":[-1,0,0]},{"id":2,"at":[20,0,0]}]}"#;
    let properties = server.change(&scene, change).await.ok()["mass_properties"].take();
    assert_eq!(properties["volume"], 16.0);
    assert_eq!(properties["removed"]["volume"], 3.0);
    assert_eq!(properties["remaining"]["volume"], 57.0);
    assert_eq!(properties["removed"]["area"], 2.0 * (2.0 + 3.0 + 1.5));
    assert_eq!(properties["removed"].get("bounds"), None);
    let names =
        |value: &Value| -> Vec<String> { value.as_object().unwrap().keys().cloned().collect() };
    let union = names(&properties);
    for part in ["removed", "remaining"] {
        let missing: Vec<_> = union
            .iter()
            .filter(|name| properties[part].get(name.as_str()).is_none())
            .collect();
        let expected = ["bounds", "cubes", "remaining", "removed", "scene", "seq"];
        assert_eq!(missing, expected, "{part}");
    }
    // They are what a recount of the cubes gives.
    let audit = server
        .send("POST", &format!("{scene}/audit"), JSON, "")
        .await
        .ok();
    assert_eq!(audit["equal"], true);
    let settings = server.get(&scene).await.ok();
    assert_eq!(
        settings["stock"],
        json!({"min": [0.0, 0.0, 0.0], "max": [10.0, 4.0, 1.5]})
    );
    // Past totals have it, too, that of the scene without cubes included.
    let first = server
        .get(&format!("{scene}/mass-properties?at=0"))
        .await
        .ok();
    assert_eq!(first["remaining"]["exact"], whole["remaining"]["exact"]);
    // The same settings are the same scene; another stock is not.
    let again = server.send("PUT", &scene, JSON, SETTINGS).await;
    assert_eq!(again.status, 200, "{}", again.text);
    let other = SETTINGS.replace("1.5", "1.6");
    let answer = server.send("PUT", &scene, JSON, &other).await;
    answer.problem(409, "scene-exists");
}

#[tokio::test]
async fn a_stock_that_is_no_box_is_refused() {
    let server = Server::start().await;
    for (stock, places) in [
        (r#"{"min":[0,0,0]}"#, &["/stock/max"][..]),
        (r#"{"min":[0,0],"max":[1,1,1]}"#, &["/stock/min"]),
        (r#"{"min":[0,0,0],"max":[1,0,1]}"#, &["/stock/max/1"]),
        (
            r#"{"min":[0,3,0],"max":[1,1,-1]}"#,
            &["/stock/max/1", "/stock/max/2"],
        ),
        (r#"{"min":[0,0,-1e12],"max":[1,1,1]}"#, &["/stock/min/2"]),
        (r#"{"min":[0,0,0.01],"max":[1,1,1]}"#, &["/stock/min/2"]),
        (r#"{"min":[0,0,0],"max":[1,1,1],"x":0}"#, &["/stock/x"]),
        ("[]", &["/stock"]),
    ] {
        let settings =
            format!(r#"{{"edge":2,"steps_per_unit":10,"rounding":"reject","stock":{stock}}}"#);
        let answer = server.send("PUT", "/v1/scenes/s", JSON, &settings).await;
        assert_eq!(answer.places(), places, "{stock}");
    }
}

#[tokio::test]
async fn a_change_says_which_move_it_is_and_the_history_what_it_removed() {
    let server = Server::start().await;
    let scene = server.scene_with("s", SETTINGS).await;
    let post = |body: &'static str| {
        let (server, scene) = (&server, &scene);
        async move { server.change(scene, body).await.ok()["seq"].clone() }
    };
    assert_eq!(
        post(r#"{"move":10,"duration":2,"insert":[{"id":1,"at":[0,0,0]}]}"#).await,
        1
    );
    // An air cut: nothing is removed, but time passes.
    assert_eq!(post(r#"{"move":11,"duration":0.5}"#).await, 2);
    assert_eq!(
        post(r#"{"move":12,"duration":1,"insert":[{"id":2,"at":[50,0,0]}]}"#).await,
        3
    );
    // Nothing said and nothing done: no change.
    assert_eq!(post("{}").await, 3);
    assert_eq!(post(r#"{"insert":[{"id":3,"at":[1,0,0]}]}"#).await, 4);
    let message = Change {
        delete: vec![1],
        r#move: Some(13),
        duration: Some(0.25),
        ..Change::default()
    };
    let request = server.request("POST", &format!("{scene}/changes"));
    let request = request
        .header("content-type", PROTOBUF)
        .body(message.encode_to_vec());
    assert_eq!(send(request).await.ok()["seq"], 5);
    let history = server.get(&format!("{scene}/history")).await.ok();
    let rows: Vec<Value> = history["changes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| {
            json!([
                row["seq"],
                row["move"],
                row["duration"],
                row["volume_removed"],
                row["volume_removed_exact"],
                row["removal_rate"]
            ])
        })
        .collect();
    assert_eq!(
        json!(rows),
        json!([
            [1, 10, 2.0, 6.0, "6000", 3.0],
            [2, 11, 0.5, 0.0, "0", 0.0],
            [3, 12, 1.0, 0.0, "0", 0.0],
            [4, null, null, 3.0, "3000", null],
            [5, 13, 0.25, -3.0, "-3000", -12.0],
        ])
    );
    let seqs = |query: &'static str| {
        let (server, path) = (&server, format!("{scene}/history{query}"));
        async move {
            let history = server.get(&path).await.ok();
            let rows = history["changes"].as_array().unwrap().clone();
            let seqs: Vec<u64> = rows
                .iter()
                .map(|row| row["seq"].as_u64().unwrap())
                .collect();
            (seqs, history["next"].clone())
        }
    };
    assert_eq!(seqs("?move_from=11").await, (vec![2, 3, 5], Value::Null));
    assert_eq!(seqs("?move_to=11").await, (vec![1, 2], Value::Null));
    assert_eq!(
        seqs("?move_from=11&move_to=12&from=3").await,
        (vec![3], Value::Null)
    );
    let (first, next) = seqs("?move_from=11&limit=2").await;
    assert_eq!(first, [2, 3]);
    let rest = server.get(next.as_str().unwrap()).await.ok();
    assert_eq!(rest["changes"][0]["seq"], 5);
    for (body, places) in [
        (r#"{"move":-1}"#, &["/move"][..]),
        (r#"{"move":1.5,"duration":"x"}"#, &["/move", "/duration"]),
        (r#"{"duration":-0.1}"#, &["/duration"]),
        (r#"{"duration":2e9}"#, &["/duration"]),
        (r#"{"duration":NaN}"#, &["/duration"]),
    ] {
        assert_eq!(server.change(&scene, body).await.places(), places, "{body}");
    }
}

/// More changes than any page holds come as lines, all of them, whatever their number.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_long_history_streams() {
    const CHANGES: u64 = 100_500;
    let server = Server::start().await;
    let path = server.scene_with("s", SETTINGS).await;
    let scene = server.service.scene("s").unwrap();
    let edge = Edge::new(20).unwrap();
    let place = |number: u64| Place::new([number as i64 % 50, 0, 0], edge).unwrap();
    let submission = |number: u64| Submission {
        operations: Operations::Named(vec![
            union3d::engine::Op::Delete(CubeId(1)),
            union3d::engine::Op::Insert(CubeId(1), place(number)),
        ]),
        counting: Counting::Net,
        motion: Motion {
            number: Some(number / 3),
            duration_ns: Some(1_000_000),
        },
        key: None,
    };
    // As many at once as the queue takes, so that they share commits.
    let mut number = 0;
    while number < CHANGES {
        let end = CHANGES.min(number + 1000);
        let group = (number..end).map(|number| scene.change(submission(number)));
        for answer in futures_util::future::join_all(group).await {
            answer.unwrap();
        }
        number = end;
    }
    let lines = |accept: &'static str, query: &'static str| {
        let request = server.request("GET", &format!("{path}/history{query}"));
        async move { send(request.header("accept", accept)).await }
    };
    let csv = lines("text/csv", "").await;
    assert_eq!(csv.header("content-type"), "text/csv; charset=utf-8");
    let mut reader = csv::Reader::from_reader(csv.text.as_bytes());
    let headers = reader.headers().unwrap().clone();
    let column = |name: &str| headers.iter().position(|header| header == name).unwrap();
    let (seq, number, rate, removed) = (
        column("seq"),
        column("move"),
        column("removal_rate"),
        column("volume_removed"),
    );
    let mut rows = 0;
    for row in reader.records() {
        let row = row.unwrap();
        rows += 1;
        assert_eq!(row[seq], rows.to_string());
        assert_eq!(row[number], ((rows - 1) / 3).to_string());
        let (rate, removed): (f64, f64) =
            (row[rate].parse().unwrap(), row[removed].parse().unwrap());
        assert!((rate - removed * 1000.0).abs() < 1e-9, "{rate} {removed}");
    }
    assert_eq!(rows, CHANGES);
    let ndjson = lines("application/x-ndjson", "?move_from=10000&move_to=32999").await;
    let mut expected = 30_001;
    for line in ndjson.text.lines() {
        let row: Value = serde_json::from_str(line).unwrap();
        assert_eq!(row["seq"], expected);
        expected += 1;
    }
    assert_eq!(expected, 99_001);
    let few = lines("text/csv", "?from=100400&limit=20").await;
    assert_eq!(few.text.lines().count(), 21);
}

#[test]
fn a_stock_is_a_box_of_the_lattice() {
    assert!(Stock::new([0; 3], [1; 3]).is_ok());
    for (min, max) in [
        ([0; 3], [1, 0, 1]),
        ([0; 3], [1, 1, 1 << 31]),
        ([0, -(1 << 31), 0], [1; 3]),
    ] {
        assert!(Stock::new(min, max).is_err(), "{min:?} {max:?}");
    }
}
