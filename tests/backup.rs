//! Copies of scenes, made while changes go on, and bringing them back: `backup`, `restore`, and what is said of files copied by hand.

use std::fs;
use std::path::Path;
use std::process::Output;
use std::sync::atomic::{AtomicBool, Ordering};

use reqwest::StatusCode;
use serde_json::{Value, json};

#[path = "oracle/program.rs"]
mod program;
#[path = "oracle/serve.rs"]
mod serve;

use program::union3d;
use serve::Server;

const CUBES: &str = "cubes";
const SOLIDS: &str = "solids";

/// Asks a server, and checks that it does what it is asked.
async fn ask(method: &str, url: &str, body: Option<&Value>) -> Value {
    let method = reqwest::Method::from_bytes(method.as_bytes()).unwrap();
    let mut request = reqwest::Client::new().request(method, url);
    if let Some(body) = body {
        request = request.json(body);
    }
    let answer = request.send().await.unwrap();
    let (status, text) = (answer.status(), answer.text().await.unwrap());
    assert!(status.is_success(), "{url}: {status}: {text}");
    serde_json::from_str(&text).unwrap_or_default()
}

/// The scenes that are copied here.
async fn create_scenes(server: &Server) {
    let cubes = json!({"edge": 2, "steps_per_unit": 1});
    let solids = json!({"kind": "solids", "steps_per_unit": 10, "shapes": {"t": {"flat": {"diameter": 4, "length": 6, "sides": 8}}}});
    for (name, settings) in [(CUBES, cubes), (SOLIDS, solids)] {
        let url = format!("{}/v1/scenes/{name}", server.url);
        ask("PUT", &url, Some(&settings)).await;
    }
}

/// A change of a scene that moves the body of the id, or inserts it.
fn change(name: &str, id: u64, at: u64) -> Value {
    let at = at % 100;
    if name == CUBES {
        json!({"insert": [{"id": id, "at": [at, at % 7, 0]}], "delete": [id]})
    } else {
        json!({"insert": [{"id": id, "shape": "t", "from": [at, 0, 0], "to": [at + 9, 3, 0]}], "delete": [id]})
    }
}

/// Changes a scene until it is told to stop; how many changes there were.
async fn keep_changing(url: String, name: &'static str, stop: &AtomicBool) -> u64 {
    let mut seq = 0;
    while !stop.load(Ordering::Relaxed) {
        let change = change(name, seq % 5, seq);
        let answer = ask("POST", &format!("{url}/changes"), Some(&change)).await;
        seq = answer["seq"].as_u64().unwrap();
    }
    seq
}

fn words(output: &Output) -> (bool, String) {
    let text = [&output.stdout[..], &output.stderr[..]].concat();
    (
        output.status.success(),
        String::from_utf8_lossy(&text).into_owned(),
    )
}

#[track_caller]
fn run(arguments: &[&str]) -> String {
    let (success, text) = words(&union3d(arguments, b""));
    assert!(success, "{text}");
    text
}

#[track_caller]
fn check_refused(arguments: &[&str], expected: &str) {
    let (success, text) = words(&union3d(arguments, b""));
    assert!(!success && text.contains(expected), "{text}");
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A copy that is made while a scene changes is of one of its seqs, and is that scene when it is brought back: totals, history and bodies.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_copy_of_a_busy_scene_is_of_one_seq() {
    let home = tempfile::tempdir().unwrap();
    let server = Server::start(&home.path().join("data"));
    create_scenes(&server).await;
    let stop: &'static AtomicBool = Box::leak(Box::new(AtomicBool::new(false)));
    let changing = [CUBES, SOLIDS].map(|name| {
        let url = format!("{}/v1/scenes/{name}", server.url);
        tokio::spawn(keep_changing(url, name, stop))
    });
    for name in [CUBES, SOLIDS] {
        let url = format!("{}/v1/scenes/{name}/mass-properties?wait=20", server.url);
        ask("GET", &url, None).await;
    }
    let copies = home.path().join("copies");
    for _ in 0..5 {
        let (url, copies) = (server.url.clone(), copies.clone());
        let backup = move || run(&["backup", "--server", &url, "--to", text(&copies)]);
        let told = tokio::task::spawn_blocking(backup).await.unwrap();
        assert_eq!(told.lines().count(), 2, "{told}");
    }
    stop.store(true, Ordering::Relaxed);
    for task in changing {
        assert!(task.await.unwrap() > 20);
    }
    let restored = home.path().join("restored");
    let files = [CUBES, SOLIDS].map(|name| copies.join(format!("{name}.union3d")));
    run(&["restore", text(&restored), text(&files[0]), text(&files[1])]);
    let twin = Server::start(&restored);
    // Until every scene is replayed.
    while !reqwest::get(format!("{}/readyz", twin.url))
        .await
        .unwrap()
        .status()
        .is_success()
    {}
    for name in [CUBES, SOLIDS] {
        let scene = format!("/v1/scenes/{name}");
        let there = ask(
            "GET",
            &format!("{}{scene}/mass-properties?wait=1", twin.url),
            None,
        )
        .await;
        let seq = there["seq"].as_u64().unwrap();
        assert!(seq >= 20, "{there}");
        let past = format!("{}{scene}/mass-properties?at={seq}", server.url);
        assert_eq!(there, ask("GET", &past, None).await);
        let history = |url: &str| format!("{url}{scene}/history?to={seq}");
        let [here, there] = [history(&server.url), history(&twin.url)];
        assert_eq!(
            ask("GET", &there, None).await,
            ask("GET", &here, None).await
        );
        // It goes on.
        let changes = format!("{}{scene}/changes", twin.url);
        let answer = ask("POST", &changes, Some(&change(name, 77, 3))).await;
        assert_eq!(answer["seq"], seq + 1);
        let none = format!("{}/v1/scenes/none/backup", server.url);
        let status = reqwest::get(none).await.unwrap().status();
        assert_eq!(status, StatusCode::NOT_FOUND);
    }
}

/// What is not right to the last byte is refused, and nothing of it appears; a scene that is there is never replaced.
#[tokio::test]
async fn what_is_brought_back_is_right_or_refused() {
    let home = tempfile::tempdir().unwrap();
    let (data, copies) = (home.path().join("data"), home.path().join("copies"));
    {
        let server = Server::start(&data);
        create_scenes(&server).await;
        for seq in 0..30 {
            for name in [CUBES, SOLIDS] {
                let url = format!("{}/v1/scenes/{name}/changes", server.url);
                ask("POST", &url, Some(&change(name, seq % 4, seq))).await;
            }
        }
        check_refused(
            &["backup", text(&data), "--to", text(&copies)],
            "another union3d",
        );
    }
    check_refused(
        &[
            "backup",
            text(&data),
            "--to",
            text(&copies),
            "--scene",
            "none",
        ],
        "has no scene \"none\"",
    );
    run(&["backup", text(&data), "--to", text(&copies)]);
    let copy = copies.join("cubes.union3d");
    let again = home.path().join("again");
    run(&["restore", text(&again), text(&copy)]);
    check_refused(&["restore", text(&again), text(&copy)], "is there already");
    run(&["restore", text(&again), text(&copy), "--name", "second"]);
    assert!(run(&["audit", text(&again)]).contains("2 of 2 scenes are well"));

    let whole = fs::read(&copy).unwrap();
    let bad = home.path().join("bad.union3d");
    // Every page is somebody's: the settings, the changes, their operations, the keys, the lists of pages.
    for at in (100..whole.len()).step_by(997) {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x10;
        fs::write(&bad, bytes).unwrap();
        let (success, told) = words(&union3d(&["restore", text(&again), text(&bad)], b""));
        if success {
            // A byte that nothing stands in; what was brought back is right.
            assert!(told.contains("seq 30"), "{at}: {told}");
            fs::remove_dir_all(again.join("scenes/bad")).unwrap();
        } else {
            assert!(told.contains("cannot restore"), "{at}: {told}");
        }
    }
    let cut = [
        &whole[..whole.len() / 2],
        &whole[..50],
        b"",
        b"no copy at all, but some text",
    ];
    for bytes in cut {
        fs::write(&bad, bytes).unwrap();
        check_refused(&["restore", text(&again), text(&bad)], "cannot restore");
    }
    check_refused(
        &["restore", text(&again), text(&bad), "--name", "../up"],
        "no name of a scene",
    );
    check_refused(
        &["restore", text(&again), "/none/such.union3d"],
        "cannot restore",
    );
    let scenes = fs::read_dir(again.join("scenes")).unwrap();
    let mut names: Vec<_> = scenes.map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["cubes", "second"]);
}

/// Files that were copied by hand, and are not right, are told from files that are damaged where they were written.
#[tokio::test]
async fn a_directory_copied_by_hand_is_told_from_a_damaged_one() {
    let home = tempfile::tempdir().unwrap();
    let data = home.path().join("data");
    {
        let server = Server::start(&data);
        create_scenes(&server).await;
        let url = format!("{}/v1/scenes/{CUBES}/changes", server.url);
        for seq in 0..30 {
            ask("POST", &url, Some(&change(CUBES, seq, seq))).await;
        }
    }
    run(&["audit", text(&data)]);
    let (scene, copied) = (data.join("scenes/cubes"), home.path().join("copied"));
    fs::create_dir_all(copied.join("scenes/cubes")).unwrap();
    for entry in fs::read_dir(&scene).unwrap() {
        let entry = entry.unwrap();
        fs::copy(
            entry.path(),
            copied.join("scenes/cubes").join(entry.file_name()),
        )
        .unwrap();
    }
    for (data, expected) in [
        (&data, "restore the scene's directory"),
        (&copied, "the files are a copy"),
    ] {
        let file = data.join("scenes/cubes/scene.sqlite");
        let bytes = fs::read(&file).unwrap();
        fs::write(&file, &bytes[..bytes.len() - 4096]).unwrap();
        check_refused(&["audit", text(data)], expected);
        // One that is whole is a scene like any other.
        fs::write(&file, bytes).unwrap();
        run(&["audit", text(data)]);
    }
}
