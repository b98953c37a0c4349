//! Streams of lines: any length, any cut, and the exact place of a failure.

use std::fmt::Write;
use std::sync::Arc;
use std::time::Duration;

use futures_util::future::{Either, join, join3, select};
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use union3d::service::FailPoint;
use union3d::wire::http::Limits;

use crate::server::{NDJSON, Server, eventually, send};
use crate::stop::Stop;

fn insert(id: u64, x: i64) -> String {
    format!("{{\"insert\":{{\"id\":{id},\"at\":[{x},0,0]}}}}\n")
}

#[tokio::test]
async fn a_long_stream_in_odd_pieces_is_one_answer() {
    const LINES: u64 = 200_000;
    let server = Server::start().await;
    let scene = server.scene("s", 1).await;
    let mut text = String::new();
    for id in 0..LINES {
        text += &insert(id, i64::try_from(id).unwrap());
    }
    // The body limit is for atomic changes; pieces end anywhere, and some come late.
    let pieces = async_stream::stream! {
        let (mut from, mut size) = (0, 1);
        while from < text.len() {
            let to = text.len().min(from + size);
            yield Ok::<_, std::io::Error>(text[from..to].to_owned());
            from = to;
            size = size * 7 % 65_521;
            if size % 10 == 0 {
                tokio::time::sleep(Duration::from_millis(7)).await;
            }
        }
    };
    let request = server.request("POST", &format!("{scene}/changes"));
    let request = request.header("content-type", NDJSON);
    let answer = send(request.body(reqwest::Body::wrap_stream(pieces)))
        .await
        .ok();
    assert_eq!(answer["inserted"], LINES);
    assert_eq!(
        (&answer["deleted"], &answer["unchanged"]),
        (&json!(0), &json!(0))
    );
    assert_eq!(
        answer["mass_properties"]["exact"]["volume"],
        LINES.to_string()
    );
    assert_eq!(server.totals(&scene).await, answer["mass_properties"]);
    // All of it again changes nothing; then all goes.
    let mut text = String::new();
    for id in 0..LINES {
        text += &insert(id, i64::try_from(id).unwrap());
    }
    let again = server.lines(&scene, &text).await.ok();
    assert_eq!(
        (&again["unchanged"], &again["seq"]),
        (&json!(LINES), &answer["seq"])
    );
    text.clear();
    for id in 0..LINES {
        writeln!(text, "{{\"delete\":{id}}}").unwrap();
    }
    let emptied = server.lines(&scene, &text).await.ok();
    assert_eq!(emptied["deleted"], LINES);
    assert_eq!(emptied["mass_properties"]["exact"]["volume"], "0");
}

#[tokio::test]
async fn lines_act_in_their_order() {
    let server = Server::start().await;
    let scene = server.scene("s", 1).await;
    let text = [
        &insert(1, 0),
        "{\"delete\":1}\r\n",
        "\n   \n",
        &insert(1, 5),
        &insert(1, 5),
        "{\"delete\":2}\n",
        insert(3, 7).trim_end(),
    ]
    .concat();
    let answer = server.lines(&scene, &text).await.ok();
    assert_eq!(answer["inserted"], 3);
    assert_eq!(
        (&answer["deleted"], &answer["unchanged"]),
        (&json!(1), &json!(2))
    );
    assert_eq!(answer["mass_properties"]["cubes"], 2);
    let empty = server.lines(&scene, "").await.ok();
    assert_eq!(
        (&empty["seq"], &empty["inserted"]),
        (&answer["seq"], &json!(0))
    );
    assert_eq!(empty["mass_properties"], answer["mass_properties"]);
}

/// A stream of `before` good lines, a bad one, and one more: exactly the good ones before it are committed.
#[tokio::test]
async fn a_stream_stops_exactly_at_the_bad_line() {
    let server = Server::limited(Limits::default()).await;
    let long = format!("{{\"delete\":{}1}}\n", " ".repeat(70_000));
    let number = &insert(900_000, 1).replace("[1,", "[\"1\",");
    for (name, status, code, bad) in [
        ("syntax", 400, "bad-json", "{\"delete\":}\n"),
        ("fault", 422, "invalid", number),
        ("no-id", 422, "invalid", "{\"insert\":{\"at\":[0,0,0]}}\n"),
        (
            "conflict",
            409,
            "id-conflict",
            "{\"insert\":{\"id\":0,\"at\":[0,0,1]}}\n",
        ),
        ("long", 413, "too-large", &long),
    ] {
        for before in [0_u64, 1, 4_095, 4_096, 4_097, 20_000] {
            if name == "conflict" && before == 0 {
                continue;
            }
            let scene = server.scene(&format!("{name}-{before}"), 1).await;
            let mut text = String::new();
            for id in 0..before {
                text += &insert(id, i64::try_from(id).unwrap());
            }
            text += bad;
            text += &insert(1_000_000, -9);
            let answer = server.lines(&scene, &text).await;
            let problem = answer.problem(status, code);
            let line = problem["line"].as_u64().unwrap();
            assert_eq!(line, before + 1, "{name} {before}");
            assert_eq!(problem["committed_lines"], before, "{name} {before}");
            let totals = server.totals(&scene).await;
            assert_eq!(totals["cubes"], before, "{name} {before}");
            assert_eq!(totals["seq"], problem["seq"], "{name} {before}");
        }
    }
}

#[tokio::test]
async fn blank_lines_count_as_lines() {
    let server = Server::start().await;
    let scene = server.scene("s", 1).await;
    let text = ["\n\n", &insert(1, 0), "\n", "{}\n"].concat();
    let problem = server.lines(&scene, &text).await.problem(422, "invalid");
    assert_eq!(
        (&problem["line"], &problem["committed_lines"]),
        (&json!(5), &json!(4))
    );
}

/// Lines are durable and visible while the stream goes on: nobody has to end it to be measured.
#[tokio::test]
async fn a_paused_stream_is_visible_and_then_given_up() {
    let limits = Limits {
        request_timeout: Duration::from_millis(500),
        ..Limits::default()
    };
    let server = Server::limited(limits).await;
    let scene = server.scene("s", 1).await;
    let mut socket = TcpStream::connect(&server.address).await.unwrap();
    let line = insert(1, 0);
    let request = format!(
        "POST {scene}/changes HTTP/1.1\r\nhost: localhost\r\ncontent-type: {NDJSON}\r\ntransfer-encoding: chunked\r\n\r\n{:x}\r\n{line}\r\n4\r\n{{\"de\r\n",
        line.len()
    );
    socket.write_all(request.as_bytes()).await.unwrap();
    eventually("the first line is visible", || async {
        server.totals(&scene).await["cubes"] == 1
    })
    .await;
    let mut answer = vec![0; 1 << 16];
    let count = socket.read(&mut answer).await.unwrap();
    let answer = String::from_utf8_lossy(&answer[..count]).into_owned();
    assert!(answer.starts_with("HTTP/1.1 408 "), "{answer}");
    assert!(answer.contains("/problems/request-timeout"), "{answer}");
    assert!(answer.contains("\"committed_lines\":1"), "{answer}");
}

/// A queue that is full makes a stream wait, where a single change is refused.
#[tokio::test]
async fn a_full_queue_delays_a_stream_and_refuses_a_change() {
    let stop = Arc::new(Stop::default());
    let server = Server::with(
        Limits::default(),
        |mut config| {
            config.queue_changes_max = 1;
            config
        },
        Some(stop.hook(FailPoint::Append)),
    )
    .await;
    let scene = &server.scene("s", 1).await;
    let closed = stop.close();
    let post = async |id: u64| {
        let body = json!({"insert": [{"id": id, "at": [id, 0, 0]}]}).to_string();
        server.change(scene, &body).await
    };
    let rest = async {
        eventually("the writer is held", || async { stop.held() == 1 }).await;
        // Of two more changes one fills the queue, and the other is refused at once.
        let (refused, filling) = match select(Box::pin(post(2)), Box::pin(post(3))).await {
            Either::Left((first, other)) | Either::Right((first, other)) => (first, other),
        };
        refused.problem(429, "queue-full");
        assert_eq!(refused.header("retry-after"), "1");
        let release = async {
            // The stream comes meanwhile, and waits; whoever else comes is refused as before.
            for id in 20..60 {
                post(id).await.problem(429, "queue-full");
            }
            drop(closed);
        };
        let lines = [insert(10, 10), insert(11, 11)].concat();
        let (filled, streamed, ()) = join3(filling, server.lines(scene, &lines), release).await;
        filled.ok();
        assert_eq!(streamed.ok()["inserted"], 2);
    };
    join(post(1), rest).await.0.ok();
    assert_eq!(server.totals(scene).await["cubes"], 4);
}

/// A name alone is no operation: it must not stand for one with zeros in it.
#[tokio::test]
async fn the_name_of_an_operation_alone_is_refused() {
    let server = Server::start().await;
    let scene = server.scene("s", 1).await;
    for line in [r#""insert""#, r#""delete""#] {
        let refused = server.lines(&scene, line).await;
        assert_eq!(refused.places(), [""], "{}", refused.text);
        assert!(refused.text.contains("is no object with the member"));
    }
    assert_eq!(server.totals(&scene).await["seq"], 0);
}
