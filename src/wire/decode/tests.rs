//! What is read, what is refused, and with which places.

use super::*;
use crate::engine::Op;
use crate::geometry::CubeId;
use crate::random::Random;
use crate::service::Operations;
use crate::wire::convert::Rounding;
use crate::wire::proto;
use axum::response::IntoResponse;
use http_body_util::BodyExt;
use prost::Message;
use serde_json::{Value, json};

fn settings(rounding: Rounding) -> Settings {
    Settings::check(&SettingsDocument {
        rounding,
        ..SettingsDocument::with_edge(6.0)
    })
    .expect("these settings are good")
}

/// The problem document.
fn document(problem: Problem) -> Value {
    let response = problem.into_response();
    let read = response.into_body().collect();
    let runtime = tokio::runtime::Builder::new_current_thread().build();
    let body = runtime.unwrap().block_on(read).unwrap().to_bytes();
    serde_json::from_slice(&body).unwrap()
}

/// `ok`, or the status and the places at fault.
fn outcome(result: Result<Decoded, Problem>) -> String {
    let problem = match result {
        Ok(_) => return "ok".to_owned(),
        Err(problem) => document(problem),
    };
    let mut text = problem["status"].to_string();
    for error in problem["errors"].as_array().into_iter().flatten() {
        text += &format!(" {}", error["pointer"].as_str().unwrap());
        if let Some(value) = error.get("value") {
            text += &format!("={value}");
        }
    }
    text
}

#[track_caller]
fn check(body: &str, expected: &str) {
    let settings = settings(Rounding::Reject);
    let result = change(body.as_bytes(), &settings, 5);
    assert_eq!(outcome(result), expected, "{body}");
}

#[test]
fn good_changes_are_read() {
    check("{}", "ok");
    check(r#" {"insert":[],"delete":[]} "#, "ok");
    check(r#"{"insert":[{"at":[0,0,0]},{"at":[0,0,0]}]}"#, "ok");
    check(
        r#"{"delete":[18446744073709551615],"insert":[{"id":0,"at":[0.001,-1e3,2.5]}]}"#,
        "ok",
    );
    check(
        r#"{"insert":[{"id":1,"at":[1,1,1]},{"id":1,"at":[1,1,1.0]}]}"#,
        "ok",
    );
}

#[test]
fn deletions_come_first() {
    let body = br#"{"insert":[{"id":1,"at":[1,2,3]}],"delete":[1]}"#;
    let decoded = change(body, &settings(Rounding::Nearest), 10).unwrap();
    let Operations::Named(operations) = decoded.operations else {
        panic!("the id is named");
    };
    assert_eq!(decoded.deletions, 1);
    assert_eq!(operations[0], Op::Delete(CubeId(1)));
    assert!(
        matches!(operations[1], Op::Insert(CubeId(1), place) if place.corner() == [1000, 2000, 3000])
    );
}

#[test]
fn what_is_no_json_is_400() {
    check("", "400");
    check("{\"delete\":[1,]}", "400");
    check("{\"delete\":[01]}", "400");
    check("{} {}", "400");
    check("{\"delete\":[nan]}", "400");
    let problem = change(b"{\n \"delete\": [1 2]}", &settings(Rounding::Nearest), 5);
    let problem = document(problem.unwrap_err());
    assert_eq!(
        (&problem["line"], &problem["column"]),
        (&json!(2), &json!(15))
    );
    assert_eq!(problem["type"], "/problems/bad-json");
    let problem = change(b"{\n\"\xff", &settings(Rounding::Nearest), 5);
    let problem = document(problem.unwrap_err());
    assert_eq!(
        (&problem["line"], &problem["column"]),
        (&json!(2), &json!(2))
    );
}

#[test]
fn wrong_shapes_are_422_with_their_places() {
    check("[1]", r#"422 ="[1]""#);
    check("null", "422 =null");
    check(
        r#"{"insert":{},"delete":3}"#,
        r#"422 /insert="{}" /delete=3"#,
    );
    check(r#"{"a/b~":1}"#, "422 /a~1b~0=1");
    check(r#"{"delete":[1],"delete":[2]}"#, r#"422 /delete="[2]""#);
    check(r#"{"insert":[3]}"#, "422 /insert/0=3");
    check(r#"{"insert":[{"id":1}]}"#, "422 /insert/0/at");
    check(
        r#"{"insert":[{"id":1,"at":[0,0]}]}"#,
        r#"422 /insert/0/at="[0,0]""#,
    );
    check(
        r#"{"insert":[{"id":1,"at":[0,0,0,0]}]}"#,
        r#"422 /insert/0/at="[0,0,0,0]""#,
    );
    check(r#"{"insert":[{"id":1,"at":0}]}"#, "422 /insert/0/at=0");
    check(
        r#"{"insert":[{"id":1,"at":[0,null,"1"]}]}"#,
        r#"422 /insert/0/at/1=null /insert/0/at/2="1""#,
    );
    check(
        r#"{"insert":[{"id":1,"at":[0,0,0],"edge":3}]}"#,
        "422 /insert/0/edge=3",
    );
}

#[test]
fn wrong_ids_are_422_with_their_places() {
    check(
        r#"{"delete":[-1,1.5,18446744073709551616,"x",null]}"#,
        r#"422 /delete/0=-1 /delete/1=1.5 /delete/2="18446744073709551616" /delete/3="x" /delete/4=null"#,
    );
    // A decimal string has one form, as a number has.
    check(
        r#"{"delete":["01","+1",""," 1","18446744073709551616"]}"#,
        r#"422 /delete/0="01" /delete/1="+1" /delete/2="" /delete/3=" 1" /delete/4="18446744073709551616""#,
    );
    check(
        r#"{"insert":[{"id":null,"at":[0,0,0]}]}"#,
        "422 /insert/0/id=null",
    );
    check(
        r#"{"insert":[{"id":1,"at":[0,0,0]},{"at":[0,0,0]},{"id":1,"at":[0,0,1]}]}"#,
        r#"422 /insert/1="{\"at\":[0,0,0]}" /insert/2/id=1"#,
    );
}

#[test]
fn ids_are_numbers_or_decimal_strings() {
    let settings = settings(Rounding::Nearest);
    let read = |body: &str| format!("{:?}", change(body.as_bytes(), &settings, 10).unwrap());
    assert_eq!(
        read(r#"{"delete":["0",17],"insert":[{"id":"18446744073709551615","at":[0,0,0]}]}"#),
        read(r#"{"delete":[0,"17"],"insert":[{"id":18446744073709551615,"at":[0,0,0]}]}"#),
    );
    let line = |text: &str| format!("{:?}", line(text.as_bytes(), &settings).unwrap());
    assert_eq!(
        line(r#"{"delete":"9007199254740993"}"#),
        "Delete(CubeId(9007199254740993))"
    );
    // The same id twice, in both forms.
    check(
        r#"{"insert":[{"id":1,"at":[0,0,0]},{"id":"1","at":[0,0,1]}]}"#,
        "ok",
    );
    let body = br#"{"insert":[{"id":1,"at":[0,0,0]},{"id":"1","at":[0,0,1]}]}"#;
    assert_eq!(
        outcome(change_faults(body, &settings, 5)),
        r#"422 /insert/1/id="1""#
    );
}

/// What bounds the memory of a body that names too many cubes sends no good change to the slow reader.
#[test]
fn a_good_change_is_read_at_once() {
    let full = br#"{"insert":[{"id":1,"at":[0,0,0]},{"at":[0,0,0],"id":2}],"delete":[3],"move":4,"duration":5}"#;
    assert!(change::commas_fit(full, 3));
    assert!(!change::commas_fit(&b",".repeat(16), 3));
    let body = format!("{{\"delete\":[{}]}}", vec!["1"; 100_000].join(","));
    let refused = change(body.as_bytes(), &settings(Rounding::Nearest), 3).unwrap_err();
    assert_eq!(refused.code(), Code::TooLarge);
}

/// Serde reads a struct from the list of its members' values, too.
#[test]
fn lists_are_no_objects() {
    check(r#"[[1],[]]"#, r#"422 ="[[1],[]]""#);
    check(
        r#"{"insert":[[1,[0,0,0]]]}"#,
        r#"422 /insert/0="[1,[0,0,0]]""#,
    );
    let of = |text: &str| line(text.as_bytes(), &settings(Rounding::Nearest)).unwrap_err();
    let problem = document(of(r#"{"insert":[1,[0,0,0]]}"#));
    assert_eq!(problem["errors"][0]["pointer"], "/insert");
    assert!(super::settings(b"[6]").is_err());
    assert!(super::settings(br#"{"edge":6,"stock":[[0,0,0],[1,1,1]]}"#).is_err());
    assert!(revert(b"[3]").is_err());
}

#[test]
fn wrong_coordinates_are_422_with_their_places() {
    check(
        r#"{"insert":[{"id":1,"at":[1e999,0,-1e999]}]}"#,
        r#"422 /insert/0/at/0="1e999" /insert/0/at/2="-1e999""#,
    );
    check(
        r#"{"insert":[{"id":1,"at":[NaN,Infinity,-Infinity]}]}"#,
        r#"422 /insert/0/at/0="NaN" /insert/0/at/1="Infinity" /insert/0/at/2="-Infinity""#,
    );
    check(
        r#"{"insert":[{"id":1,"at":[0.0005,0,0]}]}"#,
        "422 /insert/0/at/0=0.0005",
    );
    check(
        r#"{"insert":[{"id":1,"at":[0,1073741.824,-1073741.824]}]}"#,
        "422 /insert/0/at/1=1073741.824",
    );
    check(
        r#"{"insert":[{"id":1,"at":[0,1e300,-1e15]}]}"#,
        "422 /insert/0/at/1=1e+300 /insert/0/at/2=-1000000000000000.0",
    );
}

#[test]
fn too_many_cubes_are_413() {
    check(r#"{"delete":[1,2,3,4,5]}"#, "ok");
    check(
        r#"{"delete":[1,2,3,4],"insert":[{"at":[0,0,0]},{"at":[0,0,0]}]}"#,
        "413",
    );
    check(r#"{"delete":["x",2,3,4,5,6]}"#, "413");
}

#[test]
fn a_hundred_faults_are_named() {
    let body = format!("{{\"delete\":[{}]}}", vec!["-1"; 1000].join(","));
    let problem = change(body.as_bytes(), &settings(Rounding::Nearest), 5000).unwrap_err();
    assert_eq!(document(problem)["errors"].as_array().unwrap().len(), 100);
}

#[test]
fn lines_are_read_one_by_one() {
    let settings = settings(Rounding::Reject);
    let read = |text: &str| match line(text.as_bytes(), &settings) {
        Ok(operation) => format!("{operation:?}"),
        Err(problem) => {
            let problem = document(problem);
            format!("{} {}", problem["status"], problem["errors"][0]["pointer"])
        }
    };
    assert_eq!(read(r#"{"delete":7}"#), "Delete(CubeId(7))");
    assert_eq!(
        read(r#" {"insert":{"at":[1,2,3],"id":7}} "#),
        "Insert(CubeId(7), Place([1000, 2000, 3000]))"
    );
    assert_eq!(read(r#"{"insert":{"at":[1,2,3]}}"#), r#"422 "/insert/id""#);
    assert_eq!(read(r#"{"insert":{"id":7}}"#), r#"422 "/insert/at""#);
    assert_eq!(
        read(r#"{"insert":{"id":7,"at":[0,0,1e-4]}}"#),
        r#"422 "/insert/at/2""#
    );
    assert_eq!(
        read(r#"{"delete":7,"insert":{"at":[1,2,3],"id":7}}"#),
        r#"422 """#
    );
    assert_eq!(read(r#"{"move":7}"#), r#"422 "/move""#);
    assert_eq!(read("{}"), r#"422 """#);
    assert_eq!(read("{"), "400 null");
}

#[test]
fn messages_are_checked_like_json() {
    let settings = settings(Rounding::Nearest);
    let read =
        |message: &proto::Change| outcome(message_change(&message.encode_to_vec(), &settings));
    fn message_change(body: &[u8], settings: &Settings) -> Result<Decoded, Problem> {
        message(body, settings, 5)
    }
    let mut message = proto::Change {
        delete: vec![1],
        insert_id: vec![2, 3],
        x: vec![0, 1],
        y: vec![0, 1],
        z: vec![0, 1],
        ..proto::Change::default()
    };
    assert_eq!(read(&message), "ok");
    message.x[1] = i32::MAX;
    message.z[0] = i32::MIN;
    assert_eq!(read(&message), "422 /z/0=-2147483648 /x/1=2147483647");
    message.y.pop();
    message.insert_id.pop();
    assert_eq!(read(&message), "422 /y /insert_id");
    message.delete = vec![1; 4];
    assert_eq!(read(&message), "413");
    assert_eq!(outcome(message_change(b"\xff\xff", &settings)), "400");
    message.insert_id = vec![7, 7, 7];
    (message.x, message.y, message.z) = (vec![0, 0, 1], vec![0; 3], vec![0; 3]);
    let problem = change_message_duplicates(&message).unwrap_err();
    assert_eq!(document(problem)["errors"][0]["pointer"], "/insert_id/2");
}

/// Bodies one byte away from good ones are where two readers would differ.
#[test]
fn both_readers_accept_the_same_changes() {
    let settings = settings(Rounding::Reject);
    let good =
        br#"{"delete":[1,23],"insert":[{"id":4,"at":[0,-1.5,2e1]},{"at":[7.25,0.001,6],"id":5}]}"#;
    let mut random = Random::new(1);
    let mut random = |bound: usize| random.below(bound);
    let bytes = b"0123456789-+.eE,:[]{}\"\\ nullinsertdeleteidat\xff";
    let mut accepted = 0;
    for round in 0..100_000 {
        let mut body = good.to_vec();
        for _ in 0..=random(2) {
            let (at, byte) = (random(body.len()), bytes[random(bytes.len())]);
            match random(3) {
                0 => body[at] = byte,
                1 => body.insert(at, byte),
                _ => drop(body.remove(at)),
            }
        }
        let text = String::from_utf8_lossy(&body).into_owned();
        let quick = serde_json::from_slice(&body).ok();
        let quick = quick.and_then(|change| change::decoded(&change, &settings));
        let slow = change_faults(&body, &settings, 10);
        accepted += usize::from(quick.is_some());
        match (quick, slow) {
            (None, Err(problem)) => assert_ne!(problem.code(), Code::Internal, "{text}"),
            (Some(quick), Ok(slow)) => {
                assert_eq!(format!("{quick:?}"), format!("{slow:?}"), "{text}");
            }
            // An id at two places is left to the engine by the quick reader.
            (Some(_), Err(problem)) => {
                let problem = document(problem).to_string();
                assert!(
                    problem.contains("also at another place"),
                    "{round}: {text}: {problem}"
                );
            }
            (None, Ok(_)) => panic!("{round}: only the slow reader takes {text}"),
        }
    }
    assert!(accepted > 5_000, "only {accepted} of 100,000 were good");
}
