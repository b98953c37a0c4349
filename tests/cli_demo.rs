//! `union3d demo`: it serves, mills its plate through the API, and ends when asked to.

use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Output};

fn union3d(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_union3d"))
        .args(arguments)
        .output()
        .expect("the binary runs")
}

#[track_caller]
fn demo(arguments: &[&str]) -> String {
    let output = union3d(&[&["demo", "--once"], arguments].concat());
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    errors.into_owned() + &String::from_utf8(output.stdout).unwrap()
}

/// The rows of a table of mass properties that say how much is removed.
fn rows(text: &str) -> Vec<&str> {
    let wanted = ["cubes ", "volume ", "area ", "edge length "];
    let is_wanted = |line: &&str| wanted.iter().any(|name| line.starts_with(name));
    text.lines().filter(is_wanted).collect()
}

#[test]
fn it_mills_what_mill_mills() {
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/cli/demo.gcode");
    let milled = union3d(&[
        "mill",
        program.to_str().unwrap(),
        "--edge",
        "3",
        "--step",
        "0.05",
    ]);
    let milled = String::from_utf8(milled.stdout).unwrap();
    assert_eq!(rows(&milled).len(), 4, "{milled}");

    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().join("kept");
    let shown = demo(&["--http", "127.0.0.1:0", "--data", data.to_str().unwrap()]);
    assert_eq!(rows(&shown), rows(&milled));
    assert!(shown.contains("serving http://127.0.0.1:"), "{shown}");
    assert!(shown.contains(" grpc://127.0.0.1:"), "{shown}");
    assert!(shown.contains("curl http://127.0.0.1:"), "{shown}");
    assert!(shown.contains("/v1/scenes/demo/mass-properties"), "{shown}");
    // The page is the last that is said.
    let last = shown.trim_end().lines().last().unwrap();
    assert!(last.starts_with("See it: http://127.0.0.1:"), "{shown}");
    assert!(last.ends_with("/scenes/demo"), "{shown}");
    // On the kept data the same plate again is no change.
    let again = demo(&["--http", "127.0.0.1:0", "--data", data.to_str().unwrap()]);
    assert_eq!(rows(&again), rows(&milled));
}

#[test]
fn an_address_that_was_asked_for_and_is_taken_is_refused() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let output = union3d(&["demo", "--once", "--http", &address]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success());
    assert!(
        errors.contains(&address) && errors.contains("--http"),
        "{errors}"
    );
}
