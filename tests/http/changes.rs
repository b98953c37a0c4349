//! Atomic changes: what they do, and what they leave alone.

use prost::Message;
use serde_json::{Value, json};
use union3d::wire::proto;

use crate::server::{Answer, JSON, PROTOBUF, Server, send};

/// seq, inserted, deleted, unchanged.
#[track_caller]
fn check(answer: &Answer, expected: [u64; 4]) -> Value {
    let answer = answer.ok();
    let names = ["seq", "inserted", "deleted", "unchanged"];
    assert_eq!(names.map(|name| answer[name].as_u64().unwrap()), expected);
    answer
}

/// The table of facts: corners of unit cubes (or of the edge given first), and what must come out.
#[tokio::test]
async fn the_facts_hold() {
    let block: Vec<[i32; 3]> = (0..27)
        .map(|index| [index % 3, index / 3 % 3, index / 9])
        .collect();
    let shell: Vec<_> = block.iter().copied().filter(|at| *at != [1; 3]).collect();
    let ring: Vec<_> = (0..9)
        .map(|index| [index % 3, index / 3, 0])
        .filter(|at| *at != [1, 1, 0])
        .collect();
    let server = Server::start().await;
    for (name, edge, corners, volume, area, lengths, euler) in [
        ("empty", 1, vec![], 0, 0, [0, 0, 0, 0], 0),
        ("one-of-7", 7, vec![[3, -4, 5]], 343, 294, [84, 84, 0, 0], 1),
        ("twice", 1, vec![[0; 3]; 2], 1, 6, [12, 12, 0, 0], 1),
        ("face", 1, vec![[0; 3], [1, 0, 0]], 2, 10, [16, 16, 0, 0], 1),
        ("edge", 1, vec![[0; 3], [1, 1, 0]], 2, 12, [23, 22, 0, 1], 1),
        ("corner", 1, vec![[0; 3], [1; 3]], 2, 12, [24, 24, 0, 0], 1),
        ("apart", 1, vec![[0; 3], [5; 3]], 2, 12, [24, 24, 0, 0], 2),
        ("shell", 1, shell, 26, 60, [48, 36, 12, 0], 2),
        ("ring", 1, ring, 8, 32, [40, 36, 4, 0], 0),
    ] {
        let scene = server.scene(name, edge).await;
        let cubes: Vec<_> = corners.iter().map(|at| json!({"at": at})).collect();
        let body = json!({ "insert": cubes }).to_string();
        let shown = &server.change(&scene, &body).await.ok()["mass_properties"];
        assert_eq!(shown["cubes"], corners.len(), "{name}");
        assert_eq!(shown["volume"], f64::from(volume), "{name}");
        assert_eq!(shown["area"], f64::from(area), "{name}");
        assert_eq!(shown["mass"], f64::from(volume), "{name}");
        assert_eq!(shown["exact"]["volume"], volume.to_string(), "{name}");
        assert_eq!(shown["exact"]["area"], area.to_string(), "{name}");
        assert_eq!(shown["euler_characteristic"], euler, "{name}");
        for (kind, length) in ["total", "convex", "concave", "crossing"]
            .iter()
            .zip(lengths)
        {
            assert_eq!(shown["edge_length"][kind], f64::from(length), "{name}");
            assert_eq!(shown["exact"]["edge_length"][kind], length.to_string());
        }
        assert_eq!(server.totals(&scene).await, *shown, "{name}");
    }
}

#[tokio::test]
async fn the_answer_has_every_member_of_the_specification() {
    let server = Server::start().await;
    let scene = server.scene_with("pocket", r#"{"edge":6}"#).await;
    let answer = server
        .change(&scene, r#"{"insert":[{"id":18,"at":[0,0,2.5]}]}"#)
        .await;
    let answer = check(&answer, [1, 1, 0, 0]);
    let expected = json!({
        "scene": "pocket", "seq": 1, "cubes": 1, "volume": 216.0, "area": 216.0,
        "edge_length": {"total": 72.0, "convex": 72.0, "concave": 0.0, "crossing": 0.0},
        "mass": 216.0, "mean_curvature": std::f64::consts::FRAC_PI_4 * 72.0,
        "centroid": [3.0, 3.0, 5.5],
        "inertia": [[1296.0, 0.0, 0.0], [0.0, 1296.0, 0.0], [0.0, 0.0, 1296.0]],
        "bounds": {"min": [0.0, 0.0, 2.5], "max": [6.0, 6.0, 8.5]},
        "euler_characteristic": 1,
        "vertices": {"total": 8, "corner": 8, "edge_face": 0, "three_face": 0, "degenerate": 0},
        "exact": {
            "steps_per_unit": "1000", "volume": "216000000000", "area": "216000000",
            "area_by_axis": ["72000000", "72000000", "72000000"],
            "edge_length": {"total": "72000", "convex": "72000", "concave": "0", "crossing": "0"},
            // 2 * 6^3 * 3 and 2 * 6^3 * 5.5; 6^2 * 6^3 and 36 * (8.5^3 - 2.5^3); 4 * 6^3 * 9 and 4 * 6^3 * 16.5: times 1000^4, ^5.
            "first_moments2": ["1296000000000000", "1296000000000000", "2376000000000000"],
            "second_moments3": ["7776000000000000000", "7776000000000000000", "21546000000000000000"],
            "product_moments4": ["7776000000000000000", "14256000000000000000", "14256000000000000000"],
        },
    });
    assert_eq!(answer["mass_properties"], expected);
    let null = json!(null);
    let emptied = server.change(&scene, r#"{"delete":[18]}"#).await.ok();
    let empty = &emptied["mass_properties"];
    assert_eq!((&empty["centroid"], &empty["bounds"]), (&null, &null));
}

#[tokio::test]
async fn operations_that_change_nothing_are_counted() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let insert = r#"{"insert":[{"id":1,"at":[0,0,0]},{"id":2,"at":[1,0,0]}]}"#;
    check(&server.change(&scene, insert).await, [1, 2, 0, 0]);
    // A retry is safe, and takes no seq.
    check(&server.change(&scene, insert).await, [1, 0, 0, 2]);
    check(&server.change(&scene, "{}").await, [1, 0, 0, 0]);
    check(
        &server.change(&scene, r#"{"delete":[9]}"#).await,
        [1, 0, 0, 1],
    );
    // An id moves when it is deleted and inserted in one change.
    let moved = r#"{"insert":[{"id":1,"at":[5,0,0]}],"delete":[1]}"#;
    check(&server.change(&scene, moved).await, [2, 1, 1, 0]);
    let cube = server.get(&format!("{scene}/cubes/1")).await.ok();
    assert_eq!(cube, json!({"id": 1, "at": [5.0, 0.0, 0.0]}));
    let path = format!("{scene}/cubes/1");
    let deleted = server.send("DELETE", &path, JSON, "").await;
    check(&deleted, [3, 0, 1, 0]);
    let deleted = server.send("DELETE", &path, JSON, "").await;
    check(&deleted, [3, 0, 0, 1]);
    server.get(&path).await.problem(404, "no-such-cube");
}

#[tokio::test]
async fn a_conflict_refuses_the_whole_change() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let insert = r#"{"insert":[{"id":7,"at":[0,0,0]}]}"#;
    let before = server.change(&scene, insert).await.ok();
    let conflict = r#"{"delete":[8],"insert":[{"id":8,"at":[4,0,0]},{"id":7,"at":[1,0,0]}]}"#;
    let problem = server.change(&scene, conflict).await;
    let problem = problem.problem(409, "id-conflict");
    assert_eq!(problem["id"], 7);
    assert_eq!(problem["errors"][0]["pointer"], "/insert/1");
    // The same id at two places is the change's own fault, whether the scene knows the id or not.
    for id in [7, 9] {
        let body = json!({"insert": [{"id": id, "at": [0, 0, 0]}, {"id": id, "at": [0, 0, 1]}]});
        let answer = server.change(&scene, &body.to_string()).await;
        assert_eq!(answer.places(), ["/insert/1/id"]);
    }
    assert_eq!(server.totals(&scene).await, before["mass_properties"]);
}

#[tokio::test]
async fn the_server_numbers_cubes_without_ids() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let answer = server
        .change(
            &scene,
            r#"{"insert":[{"at":[0,0,0]},{"at":[0,0,0]},{"at":[9,0,0]}]}"#,
        )
        .await;
    let answer = check(&answer, [1, 3, 0, 0]);
    let (first, last) = (&answer["assigned"]["first"], &answer["assigned"]["last"]);
    assert_eq!(last.as_u64().unwrap() - first.as_u64().unwrap(), 2);
    let third = server.get(&format!("{scene}/cubes/{last}")).await.ok();
    assert_eq!(third["at"], json!([9.0, 0.0, 0.0]));
    let named = server
        .change(&scene, r#"{"insert":[{"id":1000,"at":[0,0,0]}]}"#)
        .await;
    assert_eq!(named.ok().get("assigned"), None);
}

#[tokio::test]
async fn the_answer_can_be_short() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let path = format!("{scene}/changes?return=minimal");
    let body = r#"{"insert":[{"id":1,"at":[0,0,0]}]}"#;
    let answer = server.send("POST", &path, JSON, body).await.ok();
    assert_eq!(
        answer,
        json!({
            "seq": 1, "inserted": 1, "deleted": 0, "unchanged": 0,
            "volume_removed": 8.0, "volume_removed_exact": "8",
        })
    );
}

#[tokio::test]
async fn an_idempotency_key_replays_the_answer() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let post = |key: &'static str, kind: &'static str, body: &'static str| {
        let request = server.request("POST", &format!("{scene}/changes"));
        let request = request.header("idempotency-key", key);
        send(request.header("content-type", kind).body(body))
    };
    let body = r#"{"insert":[{"at":[0,0,0]}]}"#;
    let first = post("k-1", JSON, body).await;
    let expected = check(&first, [1, 1, 0, 0]);
    assert_eq!(first.header("idempotency-replayed"), "");
    server
        .change(&scene, r#"{"insert":[{"id":99,"at":[9,0,0]}]}"#)
        .await
        .ok();
    let again = post("k-1", JSON, body).await;
    assert_eq!(again.ok(), expected);
    assert_eq!(again.header("idempotency-replayed"), "true");
    let other = post("k-1", JSON, r#"{"insert":[{"at":[0,0,1]}]}"#).await;
    other.problem(422, "idempotency-key-reused");
    assert_eq!(server.totals(&scene).await["cubes"], 2);
    check(&post("k-2", JSON, body).await, [3, 1, 0, 0]);

    let long: &'static str = Box::leak("k".repeat(65).into());
    for key in ["", "a b", "\u{e4}", long] {
        assert_eq!(post(key, JSON, body).await.places(), ["Idempotency-Key"]);
    }
    let stream = post("k-3", crate::server::NDJSON, "{\"delete\":1}\n").await;
    assert_eq!(stream.places(), ["Idempotency-Key"]);
}

#[tokio::test]
async fn a_protobuf_message_is_a_change() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let post = |message: &proto::Change| {
        let request = server.request("POST", &format!("{scene}/changes"));
        let request = request.header("content-type", PROTOBUF);
        send(request.body(message.encode_to_vec()))
    };
    let mut message = proto::Change {
        delete: vec![5],
        insert_id: vec![1, 2],
        x: vec![0, -2],
        y: vec![0, 0],
        z: vec![0, 0],
        ..proto::Change::default()
    };
    let answer = check(&post(&message).await, [1, 2, 0, 1]);
    assert_eq!(answer["mass_properties"]["exact"]["volume"], "16");
    message.x[1] = 7;
    let conflict = post(&message).await.problem(409, "id-conflict");
    assert_eq!(conflict["errors"][0]["pointer"], "/insert_id/1");
    message.insert_id[1] = 1;
    assert_eq!(post(&message).await.places(), ["/insert_id/1"]);
    message.insert_id.clear();
    let answer = check(&post(&message).await, [2, 2, 0, 1]);
    assert!(answer["assigned"]["first"].is_u64());
    message.y.pop();
    message.x[0] = i32::MAX;
    assert_eq!(post(&message).await.places(), ["/y"]);
    message.y.push(0);
    assert_eq!(post(&message).await.places(), ["/x/0"]);
    let answer = server
        .send("POST", &format!("{scene}/changes"), PROTOBUF, "\u{7f}")
        .await;
    answer.problem(400, "bad-protobuf");
}

#[tokio::test]
async fn places_are_read_as_the_settings_say() {
    let server = Server::start().await;
    let settings = r#"{"edge":3,"steps_per_unit":1,"anchor":"center"}"#;
    let scene = server.scene_with("centre", settings).await;
    // The lower corner, at - 1.5, is rounded: -0.5 to -1, 0.5 to 1, 0 stays.
    let body = r#"{"insert":[{"id":1,"at":[1,2,1.5]}]}"#;
    let shown = &server.change(&scene, body).await.ok()["mass_properties"];
    assert_eq!(shown["bounds"]["min"], json!([-1.0, 1.0, 0.0]));
    let cube = server.get(&format!("{scene}/cubes/1")).await.ok();
    assert_eq!(cube["at"], json!([0.5, 2.5, 1.5]));

    let settings = r#"{"edge":6,"rounding":"reject"}"#;
    let scene = server.scene_with("strict", settings).await;
    let body = r#"{"insert":[{"id":1,"at":[0.1,0.2,0.3]},{"id":2,"at":[0.1,0.0005,0.3]}]}"#;
    assert_eq!(
        server.change(&scene, body).await.places(),
        ["/insert/1/at/1"]
    );
    assert_eq!(server.totals(&scene).await["cubes"], 0);
}
