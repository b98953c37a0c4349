//! Batches: several changes in one request.

use prost::Message;
use serde_json::{Value, json};
use union3d::wire::proto;

use crate::random::Random;
use crate::server::{Answer, JSON, PROTOBUF, Server, send};

async fn batch(server: &Server, scene: &str, body: &Value) -> Answer {
    let path = format!("{scene}/changes/batch");
    server.send("POST", &path, JSON, &body.to_string()).await
}

fn cube(id: u64, at: [i32; 3]) -> Value {
    json!({"change": {"insert": [{"id": id, "at": at}]}})
}

/// One after the other in a batch, and one by one, changes are answered the same.
#[tokio::test]
async fn a_batch_does_what_its_changes_do_one_by_one() {
    let mut random = Random::new(71);
    let server = Server::start().await;
    let together = server.scene("together", 2).await;
    let one_by_one = server.scene("apart", 2).await;
    for _ in 0..20 {
        let changes: Vec<Value> = (0..random.below(6_u64))
            .map(|number| {
                let insert: Vec<Value> = (0..random.below(3_u64))
                    .map(|_| {
                        let at: [u64; 3] = [0; 3].map(|_| random.below(4));
                        json!({"id": at[0] * 16 + at[1] * 4 + at[2], "at": at})
                    })
                    .collect();
                let delete: Vec<u64> = (0..random.below(3_u64))
                    .map(|_| random.below(64_u64))
                    .collect();
                json!({"insert": insert, "delete": delete, "move": number})
            })
            .collect();
        let keyed: Vec<Value> = changes
            .iter()
            .map(|change| json!({"change": change}))
            .collect();
        let answer = batch(&server, &together, &json!({ "changes": keyed }))
            .await
            .ok();
        let mut expected = Vec::new();
        for change in &changes {
            let mut answer = server.change(&one_by_one, &change.to_string()).await.ok();
            answer["mass_properties"]["scene"] = "together".into();
            expected.push(answer);
        }
        assert_eq!(answer, json!({ "outcomes": expected }), "{changes:?}");
    }
}

#[tokio::test]
async fn after_a_refused_change_nothing_is_applied() {
    let server = Server::start().await;
    let scene = server.scene("pocket", 1).await;
    let conflict = json!({"changes": [cube(1, [0, 0, 0]), cube(1, [5, 0, 0]), cube(2, [9, 0, 0])]});
    let answer = batch(&server, &scene, &conflict).await;
    let problem = answer.problem(409, "id-conflict");
    assert_eq!(problem["change"], 1);
    assert_eq!(problem["id"], 1);
    assert_eq!(
        problem["errors"][0]["pointer"],
        "/changes/1/change/insert/0"
    );
    let outcomes = problem["outcomes"].as_array().unwrap();
    assert_eq!(outcomes.len(), 1);
    assert_eq!(outcomes[0]["seq"], 1);
    assert_eq!(outcomes[0]["mass_properties"]["cubes"], 1);
    assert_eq!(server.totals(&scene).await["cubes"], 1);

    // One that cannot be read stops it, too; what comes before is done.
    let unread = json!({"changes": [cube(2, [2, 0, 0]), {"change": {"insert": [{"id": 3, "at": [0, "x", 0]}]}}, cube(4, [4, 0, 0])]});
    let problem = batch(&server, &scene, &unread).await;
    let problem = problem.problem(422, "invalid");
    assert_eq!(problem["change"], 1);
    assert_eq!(
        problem["errors"][0]["pointer"],
        "/changes/1/change/insert/0/at/1"
    );
    assert_eq!(problem["errors"][0]["value"], "x");
    assert_eq!(problem["outcomes"].as_array().unwrap().len(), 1);
    assert_eq!(server.totals(&scene).await["cubes"], 2);
}

/// Sent again, as after a lost answer, each change is answered as it was.
#[tokio::test]
async fn a_batch_with_keys_can_be_sent_again() {
    let server = Server::start().await;
    let scene = server.scene("pocket", 1).await;
    let change = |key: &str, at: i32| json!({"idempotency_key": key, "change": {"insert": [{"at": [at, 0, 0]}]}});
    let body = json!({"changes": [change("a", 0), change("b", 5)]});
    let first = batch(&server, &scene, &body).await.ok();
    assert_eq!(first["outcomes"][0].get("replayed"), None);
    let again = batch(&server, &scene, &body).await.ok();
    for (index, outcome) in again["outcomes"].as_array().unwrap().iter().enumerate() {
        let mut expected = first["outcomes"][index].clone();
        expected["replayed"] = true.into();
        assert_eq!(*outcome, expected);
    }
    assert_eq!(server.totals(&scene).await["cubes"], 2);
    // A key that came with another change is refused in its place.
    let other = json!({"changes": [change("c", 7), change("a", 8)]});
    let problem = batch(&server, &scene, &other).await;
    let problem = problem.problem(422, "idempotency-key-reused");
    assert_eq!(problem["change"], 1);
    assert_eq!(server.totals(&scene).await["cubes"], 3);
}

#[tokio::test]
async fn a_batch_can_be_a_message() {
    let server = Server::start().await;
    let scene = server.scene("pocket", 1).await;
    let change = |id: u64, x: i32| proto::KeyedChange {
        change: Some(proto::Change {
            insert_id: vec![id],
            x: vec![x],
            y: vec![0],
            z: vec![0],
            ..proto::Change::default()
        }),
        idempotency_key: None,
    };
    let post = |changes: Vec<proto::KeyedChange>| {
        let path = format!("{scene}/changes/batch?return=minimal");
        let body = proto::ChangeBatch { changes }.encode_to_vec();
        let request = server.request("POST", &path);
        send(request.header("content-type", PROTOBUF).body(body))
    };
    let answer = post(vec![change(1, 0), change(2, 4)]).await.ok();
    assert_eq!(answer["outcomes"][1]["seq"], 2);
    assert_eq!(answer["outcomes"][1].get("mass_properties"), None);
    let answer = post(vec![change(3, 9), change(2, 5)]).await;
    let problem = answer.problem(409, "id-conflict");
    assert_eq!(
        problem["errors"][0]["pointer"],
        "/changes/1/change/insert_id/0"
    );
}

#[tokio::test]
async fn what_is_wrong_outside_of_the_changes_has_its_place() {
    let server = Server::start().await;
    let scene = server.scene("pocket", 1).await;
    for (body, status, code, pointer) in [
        ("{\"changes\":[{]}", 400, "bad-json", None),
        ("{}", 422, "invalid", Some("/changes")),
        (
            "{\"changes\":[{}]}",
            422,
            "invalid",
            Some("/changes/0/change"),
        ),
        (
            "{\"changes\":[{\"change\":{},\"key\":\"a\"}]}",
            422,
            "invalid",
            Some("/changes/0/key"),
        ),
        (
            "{\"changes\":[{\"change\":{}},{\"change\":{},\"idempotency_key\":\"a b\"}]}",
            422,
            "invalid",
            Some("/changes/1/idempotency_key"),
        ),
        (
            "{\"changes\":[{\"change\":{\"insert\":[{\"id\":1,\"at\":[0,NaN,0]}]}}]}",
            422,
            "invalid",
            Some("/changes/0/change/insert/0/at/1"),
        ),
    ] {
        let path = format!("{scene}/changes/batch");
        let answer = server.send("POST", &path, JSON, body).await;
        let problem = answer.problem(status, code);
        let found = problem["errors"][0]["pointer"].as_str();
        assert_eq!(found, pointer, "{body}: {problem}");
    }
    let many: Vec<Value> = (0..1_025).map(|_| json!({"change": {}})).collect();
    let answer = batch(&server, &scene, &json!({ "changes": many })).await;
    answer.problem(413, "too-large");
    let none = batch(&server, &scene, &json!({"changes": []})).await.ok();
    assert_eq!(none, json!({"outcomes": []}));
    let keyed = server.request("POST", &format!("{scene}/changes/batch"));
    let keyed = keyed
        .header("content-type", JSON)
        .header("idempotency-key", "a");
    send(keyed.body("{\"changes\":[]}"))
        .await
        .problem(422, "invalid");
    assert_eq!(server.totals(&scene).await["seq"], 0);
}
