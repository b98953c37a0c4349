//! Reading totals, the past, cubes and points.

use std::time::Duration;

use futures_util::StreamExt;
use prost::Message;
use serde_json::{Value, json};
use tokio::time::timeout;
use union3d::wire::http::Limits;
use union3d::wire::proto;

use crate::random::Random;
use crate::server::{JSON, NDJSON, PATIENCE, PROTOBUF, Server, eventually, send};

/// Inserts a cube at `x` = `id`.
async fn insert(server: &Server, scene: &str, id: u64) -> Value {
    let body = json!({"insert": [{"id": id, "at": [id, 0, 0]}]});
    server.change(scene, &body.to_string()).await.ok()
}

#[tokio::test]
async fn a_known_state_is_not_sent_again() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let path = format!("{scene}/mass-properties");
    let tag = server.get(&path).await.header("etag").to_owned();
    let incarnation = server.get(&scene).await.ok()["incarnation"].clone();
    assert_eq!(tag, format!("W/\"{}-0\"", incarnation.as_str().unwrap()));
    let ask = async |tag: &str| {
        let request = server.request("GET", &path).header("if-none-match", tag);
        let answer = send(request).await;
        assert_eq!(answer.text.is_empty(), answer.status == 304);
        answer.status
    };
    let strong = tag.trim_start_matches("W/");
    assert_eq!(ask(&tag).await, 304);
    assert_eq!(ask(strong).await, 304);
    assert_eq!(ask("*").await, 304);
    assert_eq!(ask(&format!("\"other\", {tag}")).await, 304);
    assert_eq!(ask("\"other\"").await, 200);
    insert(&server, &scene, 1).await;
    assert_eq!(ask(&tag).await, 200);
    let past = server.request("GET", &format!("{path}?at=0"));
    assert_eq!(send(past.header("if-none-match", &tag)).await.status, 304);
}

#[tokio::test]
async fn the_past_can_be_read() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let mut states = vec![server.totals(&scene).await];
    for id in 1..=5 {
        states.push(insert(&server, &scene, id).await["mass_properties"].clone());
    }
    for (seq, state) in states.iter().enumerate() {
        let at = server
            .get(&format!("{scene}/mass-properties?at={seq}"))
            .await;
        assert_eq!(at.ok(), *state);
    }
    let future = server.get(&format!("{scene}/mass-properties?at=6")).await;
    assert_eq!(future.problem(404, "seq-not-reached")["newest"], 5);

    let history = server.get(&format!("{scene}/history")).await.ok();
    let changes = history["changes"].as_array().unwrap();
    assert_eq!(changes.len(), 5);
    assert_eq!(history["next"], Value::Null);
    for (change, state) in changes.iter().zip(&states[1..]) {
        assert_eq!(
            (&change["inserted"], &change["deleted"]),
            (&json!(1), &json!(0))
        );
        let time = change["time"].as_str().unwrap();
        assert!(
            time.len() == 24 && time.starts_with("20") && time.ends_with('Z'),
            "{time}"
        );
        for (name, value) in state.as_object().unwrap() {
            assert_eq!(change[name], *value, "{name}");
        }
    }
    // Pages follow one another to the end.
    let mut seqs = vec![];
    let mut next = Some(format!("{scene}/history?from=2&limit=2"));
    while let Some(path) = next {
        let page = server.get(&path).await.ok();
        let changes = page["changes"].as_array().unwrap().iter();
        seqs.extend(changes.map(|change| change["seq"].as_u64().unwrap()));
        next = page["next"].as_str().map(str::to_owned);
    }
    assert_eq!(seqs, [2, 3, 4, 5]);
    let none = server
        .get(&format!("{scene}/history?from=4&to=3"))
        .await
        .ok();
    assert_eq!(none, json!({"changes": [], "next": null}));
}

#[tokio::test]
async fn what_is_no_longer_kept_is_gone() {
    let server = Server::with(
        Limits::default(),
        |mut config| {
            config.history_changes_max = 3;
            config
        },
        None,
    )
    .await;
    let scene = server.scene("s", 2).await;
    let path = format!("{scene}/mass-properties?at=1");
    let changes = format!("{scene}/changes?return=minimal");
    // Old totals go when a snapshot makes their operations superfluous, which takes a long log: ids that do not compress.
    const CUBES: i32 = 50_000;
    let mut random = Random::new(1);
    for round in 0.. {
        let ids: Vec<_> = (0..CUBES).map(|_| random.next()).collect();
        let come = proto::Change {
            insert_id: ids.clone(),
            x: (0..CUBES).map(|id| 3 * id).collect(),
            y: vec![0; ids.len()],
            z: vec![0; ids.len()],
            ..proto::Change::default()
        };
        let go = proto::Change {
            delete: ids,
            ..proto::Change::default()
        };
        for change in [come, go] {
            let request = server.request("POST", &changes);
            let request = request.header("content-type", PROTOBUF);
            send(request.body(change.encode_to_vec())).await.ok();
        }
        let answer = server.get(&path).await;
        if answer.status != 200 {
            let oldest = answer.problem(410, "seq-not-kept")["oldest"].clone();
            assert!(oldest.as_u64().unwrap() > 1);
            // What is left begins there.
            let history = server.get(&format!("{scene}/history")).await.ok();
            assert!(history["changes"][0]["seq"].as_u64() >= oldest.as_u64());
            break;
        }
        assert!(round < 100, "nothing is ever trimmed");
    }
}

#[tokio::test]
async fn a_seq_can_be_waited_for() {
    let limits = Limits {
        wait_max: Duration::from_millis(200),
        ..Limits::default()
    };
    let server = Server::limited(limits).await;
    let scene = server.scene("s", 2).await;
    let path = format!("{scene}/mass-properties?wait=1");
    let late = server.get(&path).await.problem(408, "wait-timeout");
    assert_eq!(late["newest"], 0);
    insert(&server, &scene, 1).await;
    assert_eq!(server.get(&path).await.ok()["seq"], 1);

    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let waits = server.get(&path);
    let (waited, _) = futures_util::future::join(waits, insert(&server, &scene, 1)).await;
    assert_eq!(waited.ok()["cubes"], 1);
}

/// The next event's id and data, comments skipped.
async fn next_event(
    events: &mut (impl StreamExt<Item = reqwest::Result<bytes::Bytes>> + Unpin),
    buffer: &mut String,
) -> Option<(u64, Value)> {
    loop {
        if let Some((event, rest)) = buffer.split_once("\n\n") {
            let field = |name: &str| event.lines().find_map(|line| line.strip_prefix(name));
            let found = field("id: ").zip(field("data: "));
            let found =
                found.map(|(id, data)| (id.parse().unwrap(), serde_json::from_str(data).unwrap()));
            *buffer = rest.to_owned();
            if found.is_some() {
                return found;
            }
            continue;
        }
        let piece = timeout(PATIENCE, events.next()).await.unwrap()?.unwrap();
        *buffer += std::str::from_utf8(&piece).unwrap();
    }
}

#[tokio::test]
async fn totals_can_be_watched_until_the_scene_is_dropped() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    insert(&server, &scene, 1).await;
    let request = server.request("GET", &format!("{scene}/mass-properties/stream"));
    let response = request
        .header("last-event-id", "0")
        .header("accept-encoding", "gzip")
        .send()
        .await
        .unwrap();
    assert_eq!(response.headers()["content-type"], "text/event-stream");
    assert!(!response.headers().contains_key("content-encoding"));
    let (mut events, mut buffer) = (response.bytes_stream(), String::new());
    let first = next_event(&mut events, &mut buffer).await.unwrap();
    assert_eq!(first, (1, server.totals(&scene).await));
    insert(&server, &scene, 2).await;
    let second = next_event(&mut events, &mut buffer).await.unwrap();
    assert_eq!(second, (2, server.totals(&scene).await));
    // However many changes a slow reader misses, it comes to the newest, in order.
    for id in 3..50 {
        insert(&server, &scene, id).await;
    }
    let mut seq = 2;
    while seq < 49 {
        let (id, data) = next_event(&mut events, &mut buffer).await.unwrap();
        assert!(id > seq && data["seq"] == id);
        seq = id;
    }
    server.send("DELETE", &scene, JSON, "").await;
    assert_eq!(next_event(&mut events, &mut buffer).await, None);
}

#[tokio::test]
async fn shutting_down_ends_watching_and_refuses_changes() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let request = server.request("GET", &format!("{scene}/mass-properties/stream"));
    let response = request.send().await.unwrap();
    let (mut events, mut buffer) = (response.bytes_stream(), String::new());
    assert!(next_event(&mut events, &mut buffer).await.is_some());
    server.service.shutdown().await;
    assert_eq!(next_event(&mut events, &mut buffer).await, None);
    let body = r#"{"delete":[1]}"#;
    let refused = server.change(&scene, body).await;
    refused.problem(503, "shutting-down");
    assert_eq!(refused.header("retry-after"), "5");
    let line = server.lines(&scene, "{\"delete\":1}\n").await;
    let problem = line.problem(503, "shutting-down");
    assert_eq!(
        (&problem["line"], &problem["committed_lines"]),
        (&json!(1), &json!(0))
    );
}

#[tokio::test]
async fn cubes_are_listed_page_by_page() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let cubes: Vec<_> = (0..2_500_u64)
        .map(|id| json!({"id": id * 7, "at": [id, 0, -1]}))
        .collect();
    let body = json!({ "insert": cubes }).to_string();
    server.change(&scene, &body).await.ok();
    let (mut listed, mut pages) = (vec![], 0);
    let mut path = format!("{scene}/cubes?limit=999");
    loop {
        let page = server.get(&path).await.ok();
        pages += 1;
        listed.extend(page["cubes"].as_array().unwrap().clone());
        let Some(next) = page["next"].as_str() else {
            break;
        };
        path = format!("{scene}/cubes?limit=999&after={next}");
    }
    assert_eq!((listed.len(), pages), (2_500, 3));
    listed.sort_by_key(|cube| cube["id"].as_u64());
    for (cube, expected) in listed.iter().zip(&cubes) {
        assert_eq!(cube["id"], expected["id"]);
        assert_eq!(cube["at"][0].as_f64(), expected["at"][0].as_f64());
    }
    let default = server.get(&format!("{scene}/cubes")).await.ok();
    assert_eq!(default["cubes"].as_array().unwrap().len(), 1_000);
}

#[tokio::test]
async fn listed_lines_make_the_same_scene() {
    let server = Server::start().await;
    for anchor in ["corner", "center"] {
        let settings = json!({"edge": 3.175, "anchor": anchor, "rounding": "reject"}).to_string();
        let from = server
            .scene_with(&format!("{anchor}-from"), &settings)
            .await;
        let to = server.scene_with(&format!("{anchor}-to"), &settings).await;
        let half = if anchor == "center" { 1.5875 } else { 0.0 };
        let cubes: Vec<_> = (0..3_000_u64)
            .map(|id| {
                let x = f64::from(u32::try_from(id * id % 7_919).unwrap()) / 1000.0;
                json!({"id": id, "at": [x + half, 1_000_000.001 + half, half - x]})
            })
            .collect();
        let body = json!({ "insert": cubes }).to_string();
        server.change(&from, &body).await.ok();
        let request = server.request("GET", &format!("{from}/cubes"));
        let lines = send(request.header("accept", NDJSON)).await;
        assert_eq!((lines.status, lines.header("content-type")), (200, NDJSON));
        assert_eq!(lines.text.lines().count(), 3_000);
        assert_eq!(server.lines(&to, &lines.text).await.ok()["inserted"], 3_000);
        let (from, to) = (server.totals(&from).await, server.totals(&to).await);
        assert_eq!(from["exact"], to["exact"]);
    }
}

#[tokio::test]
async fn points_are_placed() {
    let server = Server::start().await;
    let scene = server.scene_with("s", r#"{"edge":6}"#).await;
    insert(&server, &scene, 1).await;
    let null = json!(null);
    let cube = json!({"id": 1, "at": [1.0, 0.0, 0.0]});
    for (at, side, holder) in [
        ("3,3,3", "inside", &cube),
        ("1,3,3", "boundary", &cube),
        ("7,6,0", "boundary", &cube),
        ("7.001,3,3", "outside", &null),
        ("0.9996,3,3", "boundary", &cube),
        ("1e12,-1e300,0", "outside", &null),
        ("%203,%203,%203", "inside", &cube),
    ] {
        let answer = server.get(&format!("{scene}/contains?at={at}")).await.ok();
        assert_eq!(answer["side"], side, "{at}");
        assert_eq!(answer["cube"], *holder, "{at}");
        assert_eq!(answer["seq"], 1);
    }
    for query in [
        "",
        "?at=",
        "?at=1,2",
        "?at=1,2,3,4",
        "?at=1,x,3",
        "?at=1,nan,3",
        "?at=,,",
    ] {
        let answer = server.get(&format!("{scene}/contains{query}")).await;
        assert_eq!(answer.places(), ["at"], "{query}");
    }
    let strict = r#"{"edge":6,"rounding":"reject"}"#;
    let strict = server.scene_with("strict", strict).await;
    let answer = server
        .get(&format!("{strict}/contains?at=0.0001,0,0"))
        .await;
    assert_eq!(answer.places(), ["at"]);
}

#[tokio::test]
async fn a_recount_agrees() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    for id in 0..5 {
        insert(&server, &scene, id).await;
    }
    let audit = server
        .send("POST", &format!("{scene}/audit"), JSON, "")
        .await;
    assert_eq!(audit.ok(), json!({"seq": 5, "cubes": 5, "equal": true}));
}

#[tokio::test]
async fn wrong_parameters_are_named() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    for (path, places) in [
        ("mass-properties?at=x", vec!["at"]),
        ("mass-properties?at=-1", vec!["at"]),
        ("mass-properties?wait=1.5", vec!["wait"]),
        ("mass-properties?wait=%2B1", vec!["wait"]),
        ("mass-properties?at=1&wait=1", vec!["wait"]),
        ("mass-properties?at=1&at=1", vec!["at"]),
        ("mass-properties?wiat=1&ta=2", vec!["wiat", "ta"]),
        ("mass-properties/stream?x", vec!["x"]),
        ("history?from=18446744073709551616", vec!["from"]),
        ("history?to=18446744073709551616", vec!["to"]),
        ("history?limit=0", vec!["limit"]),
        ("history?limit=-1", vec!["limit"]),
        ("cubes?limit=100001", vec!["limit"]),
        ("cubes?after=7", vec!["after"]),
        ("cubes/x", vec!["id"]),
        ("cubes/-1", vec!["id"]),
        ("cubes/1?x=1", vec!["x"]),
    ] {
        let answer = server.get(&format!("{scene}/{path}")).await;
        assert_eq!(answer.places(), places, "{path}");
    }
    let path = format!("{scene}/changes?return=all");
    let answer = server.send("POST", &path, JSON, "{}").await;
    assert_eq!(answer.places(), ["return"]);
}

#[tokio::test]
async fn answers_are_compressed_when_asked() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let request = server.request("GET", &format!("{scene}/mass-properties"));
    let response = request
        .header("accept-encoding", "gzip")
        .send()
        .await
        .unwrap();
    assert_eq!(response.headers()["content-encoding"], "gzip");
    let vary = response.headers().get_all("vary").iter();
    let vary: Vec<_> = vary.map(|value| value.to_str().unwrap()).collect();
    assert!(vary.join(",").contains("accept-encoding"), "{vary:?}");
    assert_eq!(response.bytes().await.unwrap()[..2], [0x1f, 0x8b]);
    eventually("without asking it is plain", || async {
        server.totals(&scene).await["cubes"] == 0
    })
    .await;
}

/// The type that the client likes best, by its `q`; JSON when it takes all or none of them.
#[tokio::test]
async fn the_accepted_type_is_answered() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    insert(&server, &scene, 1).await;
    const CSV: &str = "text/csv; charset=utf-8";
    for (accept, history, cubes) in [
        ("*/*", JSON, JSON),
        ("text/html", JSON, JSON),
        ("text/csv", CSV, JSON),
        ("Text/CSV;q=0.5", CSV, JSON),
        ("text/csv;q=0.5, application/json", JSON, JSON),
        ("application/json;q=0.1, text/csv;q=0.5", CSV, JSON),
        ("application/x-ndjson, text/csv;q=0.9", NDJSON, NDJSON),
        ("text/csv;q=0, application/x-ndjson;q=0.1", NDJSON, NDJSON),
        ("text/*, application/json;q=0.9", CSV, JSON),
    ] {
        for (call, expected) in [("history", history), ("cubes", cubes)] {
            let request = server.request("GET", &format!("{scene}/{call}"));
            let answer = send(request.header("accept", accept)).await;
            assert_eq!(
                answer.header("content-type"),
                expected,
                "{call} for {accept}"
            );
            assert_eq!(answer.header("vary").split(',').next(), Some("accept"));
        }
    }
}
