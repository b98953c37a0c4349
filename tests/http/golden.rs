//! Answers byte for byte: a script of requests, and the file of what is answered to them.
//!
//! Where an answer is meant to change, `UNION3D_GOLDEN=write cargo test --test http golden` writes the file anew; what then
//! differs from the version before is what clients will see.

use std::fmt::Write;
use std::path::Path;

use prost::Message;
use union3d::wire::proto::Change;

use crate::server::{JSON, NDJSON, PROTOBUF, Server, send};

/// `METHOD PATH [| TYPE] [| BODY]`, a request a line. `@` in a type begins an `Accept` instead.
const SCRIPT: &str = include_str!("golden.requests");

/// What is another at every run: times and the names of scenes' lives.
fn masked(text: &str) -> String {
    let mut masked = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(next) = rest.chars().next() {
        let hexadecimal = rest.bytes().take_while(u8::is_ascii_hexdigit).count();
        let time = rest.len() >= 24
            && rest.is_char_boundary(24)
            && rest.as_bytes()[10] == b'T'
            && rest.as_bytes()[23] == b'Z';
        let taken = if time {
            masked += "(time)";
            24
        } else if hexadecimal == 16 && rest[..16].contains(|digit: char| digit.is_ascii_lowercase())
        {
            masked += "(incarnation)";
            16
        } else if hexadecimal > 0 {
            masked += &rest[..hexadecimal];
            hexadecimal
        } else {
            masked.push(next);
            next.len_utf8()
        };
        rest = &rest[taken..];
    }
    masked
}

/// Messages that the script names.
fn message(name: &str) -> Vec<u8> {
    let change = Change {
        delete: vec![17],
        insert_id: vec![31, 32],
        x: vec![60_000, 61_000],
        y: vec![0, 1],
        z: vec![0, -1],
        ..Change::default()
    };
    let change = match name {
        "good" => Change {
            r#move: Some(5),
            duration: Some(0.25),
            ..change
        },
        "uneven" => Change {
            y: vec![0],
            insert_id: vec![1],
            ..change
        },
        "far" => Change {
            x: vec![i32::MAX, i32::MIN],
            duration: Some(-1.0),
            ..change
        },
        "conflict" => Change {
            x: vec![60_000, 61_001],
            ..change
        },
        "twice" => Change {
            insert_id: vec![31, 31],
            ..change
        },
        "broken" => return vec![0xff, 0xff],
        other => panic!("there is no message {other}"),
    };
    change.encode_to_vec()
}

#[tokio::test]
async fn answers_are_those_of_the_golden_file() {
    let server = Server::start().await;
    let mut transcript = String::new();
    for line in SCRIPT.lines() {
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let mut parts = line.splitn(3, " | ");
        let (method, path) = parts.next().unwrap().split_once(' ').unwrap();
        let mut request = server.request(method, path);
        let (kind, body) = (parts.next(), parts.next().unwrap_or_default());
        match kind {
            None => {}
            Some("json") => request = request.header("content-type", JSON).body(body.to_owned()),
            Some("ndjson") => {
                let body = body.replace("\\n", "\n");
                request = request.header("content-type", NDJSON).body(body);
            }
            Some("protobuf") => {
                request = request.header("content-type", PROTOBUF).body(message(body));
            }
            Some(header) => {
                let (name, value) = header.split_once(": ").unwrap();
                request = request.header(name, value);
            }
        }
        let answer = send(request).await;
        writeln!(transcript, "{line}\n{}", answer.status).unwrap();
        for name in [
            "content-type",
            "etag",
            "retry-after",
            "vary",
            "idempotency-replayed",
        ] {
            if !answer.header(name).is_empty() {
                writeln!(transcript, "{name}: {}", masked(answer.header(name))).unwrap();
            }
        }
        writeln!(transcript, "{}\n", masked(answer.text.trim_end())).unwrap();
    }
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/http/golden.answers");
    if std::env::var_os("UNION3D_GOLDEN").is_some_and(|wish| wish == "write") {
        std::fs::write(&file, &transcript).unwrap();
    }
    let golden = std::fs::read_to_string(&file).unwrap();
    let mut request = "";
    for (number, (here, there)) in transcript.lines().zip(golden.lines()).enumerate() {
        if transcript.lines().nth(number.wrapping_sub(1)) == Some("") {
            request = here;
        }
        assert_eq!(here, there, "line {}, the answer to {request}", number + 1);
    }
    assert_eq!(transcript.lines().count(), golden.lines().count());
}
