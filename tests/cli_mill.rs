//! `union3d mill`: from a program to the mass properties of what the cutter covers, here and on a server.

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::pin::Pin;
use std::process::{Command, Output, Stdio};
use std::sync::{Arc, Mutex};

use axum::body::Bytes;
use axum::extract::{Path as UrlPath, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use axum::routing::{get, post};
use axum::{Json, Router};
use prost::Message;
use serde_json::{Value, json};
use tokio_stream::Stream;
use tonic::transport::server::TcpIncoming;
use tonic::{Request, Response, Status, Streaming};
use union3d::engine::recount;
use union3d::wire::convert::{Settings, SettingsDocument, mass_properties};
use union3d::wire::proto::union_service_server::{UnionService, UnionServiceServer};
use union3d::wire::proto::{
    self, Acknowledged, Change, ChangeBatch, Outcome, Volumes, stream_changes_request as request,
    stream_changes_response as response,
};

#[path = "oracle/program.rs"]
mod program;
#[path = "oracle/serve.rs"]
mod serve;

use program::union3d;
use serve::Server;

/// Mills a program from standard input: the JSON it prints, and its warnings.
#[track_caller]
fn mill(arguments: &[&str], program: &str) -> (Value, String) {
    let output = union3d(&[&["mill", "-", "--json"], arguments].concat(), program);
    let errors = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{errors}");
    (
        serde_json::from_slice(&output.stdout).expect("one JSON object"),
        errors,
    )
}

#[track_caller]
fn check_refused(arguments: &[&str], program: &str, words: &[&str]) {
    let output = union3d(&[&["mill"], arguments].concat(), program);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success(), "{program}");
    assert_eq!(output.stdout, b"", "{program}");
    for word in words {
        assert!(errors.contains(word), "no {word:?} in {errors:?}");
    }
}

#[test]
fn a_straight_cut_is_a_box() {
    let (milled, warnings) = mill(&["--edge", "2"], "G21 G0 X0 Y0 Z0\nG1 X10 F100\n");
    assert_eq!(warnings, "");
    assert_eq!(milled["moves"], 2);
    // The default step is a twentieth of the edge.
    assert_eq!(milled["cubes"], 101);
    assert!(milled["seconds"].as_f64().unwrap() > 0.0);
    let found = &milled["mass_properties"];
    assert_eq!(
        (&found["scene"], &found["seq"]),
        (&Value::Null, &Value::Null)
    );
    assert_eq!(found["exact"]["volume"], "48000000000");
    assert_eq!(
        found["bounds"],
        json!({"min": [-1.0, -1.0, 0.0], "max": [11.0, 1.0, 2.0]})
    );
    assert_eq!(found["edge_length"]["total"], 64.0);

    let program = "G21 G0 X0 Y0 Z0\nG1 X10 F100\n";
    let (milled, _) = mill(&["--edge", "2", "--step", "3"], program);
    assert_eq!(milled["cubes"], 5);
    // A longer cutter is cubes on top of each other, the last ending where it does.
    let (milled, _) = mill(&["--edge", "2", "--step", "3", "--length", "5"], program);
    assert_eq!(milled["cubes"], 15);
    assert_eq!(milled["mass_properties"]["exact"]["volume"], "100000000000");
    assert_eq!(
        milled["mass_properties"]["bounds"]["max"],
        json!([11.0, 1.0, 5.0])
    );
}

#[test]
fn rapids_cut_only_when_asked_to() {
    let program = "G21 G0 X0 Y0 Z0\nG1 X1\nG0 X11\nG1 X12\n";
    let (milled, _) = mill(&["--edge", "2"], program);
    assert_eq!(
        (&milled["moves"], &milled["mass_properties"]["volume"]),
        (&json!(4), &json!(24.0))
    );
    let (milled, _) = mill(&["--edge", "2", "--rapid"], program);
    assert_eq!(
        (&milled["moves"], &milled["mass_properties"]["volume"]),
        (&json!(4), &json!(56.0))
    );
}

/// Machine time is that of every line that takes some, whatever it cuts.
#[test]
fn rapids_and_dwells_take_their_time() {
    let rapid = "G21 G0 X0 Y0 Z0\nG1 X1\nG0 X11\nG1 X12\n";
    let seconds =
        |arguments: &[&str]| mill(arguments, rapid).0["cutting"]["machine_seconds"].take();
    assert_eq!(seconds(&["--edge", "2"]), 0.12);
    assert_eq!(seconds(&["--edge", "2", "--rapid-rate", "600"]), 1.0);
    assert_eq!(
        seconds(&["--edge", "2", "--rapid-rate", "600", "--rapid"]),
        1.0
    );

    let directory = tempfile::tempdir().unwrap();
    let csv = directory.path().join("lines.csv");
    let dwells = "G21 G0 X0 Y0 Z0\nG1 X10 F600\nG4 P1.5\nG4 P0.5 G1 X20\n";
    let (milled, _) = mill(&["--edge", "2", "--csv", csv.to_str().unwrap()], dwells);
    let cutting = &milled["cutting"];
    assert_eq!(
        (&milled["moves"], &cutting["lines"]),
        (&json!(3), &json!(4))
    );
    assert_eq!(cutting["machine_seconds"], 4.0);
    assert_eq!(cutting["air_cuts"]["count"], 0);
    // Of the lines that cut: 88 mm^3 in 1 s and 1.5 s.
    assert_eq!(cutting["removal_rate"]["mean"], 88.0 / 2.5);
    let rows = std::fs::read_to_string(&csv).unwrap();
    let rows: Vec<_> = rows
        .lines()
        .map(|row| row.split(',').take(4).collect::<Vec<_>>().join(","))
        .collect();
    assert_eq!(
        rows[1..],
        [
            "1,rapid,0,0.0",
            "2,feed,101,1.0",
            "3,dwell,0,1.5",
            "4,feed,100,1.5"
        ]
    );

    // A server hears of them, too.
    let state = Shared::default();
    let (_runtime, url) = difficult(&state);
    let program = "G21 G0 X50\nG4 P2\nG1 X60 F600\n";
    mill(
        &["--edge", "2", "--server", &url, "--scene", "my-pocket"],
        program,
    );
    let state = state.lock().unwrap();
    assert_eq!(
        state.moves,
        [
            (Some(1), Some(0.6)),
            (Some(2), Some(2.0)),
            (Some(3), Some(1.0))
        ]
    );
    assert_eq!(state.sizes[..2], [0, 0]);
    check_refused(
        &["-", "--edge", "2"],
        "G21 G1 X10 F0.00000001\n",
        &["line 1", "seconds from 0 to 1e9"],
    );
}

/// The parts of a long line removed material all the time, not the first of them in all the time and the others in none.
#[test]
fn parts_of_a_long_line_share_its_time() {
    let state = Shared::default();
    let (_runtime, url) = difficult(&state);
    let arguments = [
        "--edge",
        "2",
        "--step",
        "0.001",
        "--server",
        &url,
        "--scene",
        "my-pocket",
    ];
    let (milled, _) = mill(&arguments, "G21 G0 X0 Y0 Z0\nG1 X150 F1400\n");
    let state = state.lock().unwrap();
    assert_eq!(state.sizes, [0, 65_536, 65_536, 150_001 - 2 * 65_536]);
    let nanoseconds: Vec<u64> = state.moves[1..]
        .iter()
        .map(|(line, duration)| {
            assert_eq!(*line, Some(2));
            (duration.unwrap() * 1e9).round() as u64
        })
        .collect();
    let whole = (150.0 / 1400.0 * 60.0 * 1e9_f64).round() as u64;
    assert_eq!(nanoseconds.iter().sum::<u64>(), whole);
    for (cubes, nanoseconds) in state.sizes[1..].iter().zip(nanoseconds) {
        let share = whole as f64 * *cubes as f64 / 150_001.0;
        assert!((nanoseconds as f64 - share).abs() <= 1.0, "{nanoseconds}");
    }
    assert_eq!(milled["cutting"]["lines"], 2);
    assert_eq!(milled["cutting"]["machine_seconds"], whole as f64 / 1e9);
}

#[test]
fn what_is_removed_is_added_up_exactly() {
    // Ten tenths: as doubles one by one they do not make 2.
    let program = format!("G21 G0 X0 Y0 Z0\nG91 F60\n{}", "G1 X0.1\n".repeat(10));
    let (milled, _) = mill(&["--edge", "1"], &program);
    let cutting = &milled["cutting"];
    assert_eq!(cutting["volume_removed"], 2.0);
    assert_eq!(cutting["machine_seconds"], 1.0);
    assert_eq!(cutting["removal_rate"]["mean"], 2.0);
    // The same of rapids.
    let program = format!(
        "G21 F60 G0 X0 Y0 Z5\nG1 Z-1\nG91\n{}",
        "G0 X0.1\n".repeat(10)
    );
    let (milled, _) = mill(&["--edge", "1", "--stock", "-9,-9,-9:9,9,0"], &program);
    assert_eq!(milled["cutting"]["rapid_cuts"]["volume"], 1.0);
}

#[test]
fn places_that_repeat_are_dropped_and_centres_rounded() {
    // Half a step to either side: corners go away from zero.
    let (milled, _) = mill(
        &["--edge", "1", "--steps-per-unit", "1"],
        "G21 G0 X0 Y0 Z0\nG1 Z1\n",
    );
    assert_eq!(
        milled["mass_properties"]["bounds"],
        json!({"min": [-1.0, -1.0, 0.0], "max": [0.0, 0.0, 2.0]})
    );
    // Twenty positions, two places.
    assert_eq!(milled["cubes"], 2);
    let (milled, _) = mill(&["--edge", "1"], "G21 G0 X0 Y0 Z0\nG1 X1\nX1\nX0\n");
    assert_eq!(milled["cubes"], 41);
}

#[test]
fn inch_programs_and_inch_scenes_meet() {
    let (in_mm, _) = mill(&["--edge", "2"], "G20 G0 X0 Y0 Z0\nG1 X1\n");
    assert_eq!(in_mm["mass_properties"]["volume"], 27.4 * 4.0);
    let (in_inch, _) = mill(
        &["--edge", "2", "--unit", "inch"],
        "G21 G0 X0 Y0 Z0\nG1 X25.4\n",
    );
    assert_eq!(in_inch["mass_properties"]["volume"], 12.0);
    assert_eq!(
        in_inch["mass_properties"]["bounds"]["max"],
        json!([2.0, 1.0, 2.0])
    );
}

#[test]
fn arcs_sweep_a_ring() {
    // A circle of radius 20: the cutter's shadow is between those of the circles inscribed and circumscribed in it.
    let (milled, _) = mill(
        &["--edge", "2", "--step", "0.01"],
        "G21 G0 X20 Y0 Z0\nG3 I-20\n",
    );
    let volume = milled["mass_properties"]["volume"].as_f64().unwrap();
    let ring =
        |width: f64| std::f64::consts::PI * ((20.0 + width).powi(2) - (20.0 - width).powi(2)) * 2.0;
    assert!(volume > ring(1.0) && volume < ring(1.5), "{volume}");
    assert_eq!(milled["mass_properties"]["euler_characteristic"], 0);
}

#[test]
fn warnings_come_with_their_lines_and_not_a_thousand_times() {
    let program = format!(
        "G21 F9 G0 X0 Y0 Z0\nM62 P1\n{}",
        "G91 G2 X2.1 I1\n".repeat(14)
    );
    let directory = tempfile::tempdir().unwrap();
    let csv = directory.path().join("lines.csv");
    let arguments = ["--edge", "1", "--csv", csv.to_str().unwrap()];
    let (milled, warnings) = mill(&arguments, &program);
    assert_eq!(milled["moves"], 15);
    assert!(
        warnings.contains("warning: line 2: M62 not done: outputs"),
        "{warnings}"
    );
    assert_eq!(warnings.matches("uneven-arc").count(), 11, "{warnings}");
    assert!(warnings.contains("4 more lines: uneven-arc"), "{warnings}");
    // Programs that read the answer see all of them, by line, code and text.
    let told = milled["warnings"].as_array().unwrap();
    assert_eq!(told.len(), 15);
    assert_eq!(
        (&told[0]["line"], &told[0]["code"]),
        (&json!(2), &json!("M62"))
    );
    assert!(
        told[14]["text"].as_str().unwrap().contains("1.1000 mm"),
        "{told:?}"
    );
    let rows = std::fs::read_to_string(&csv).unwrap();
    assert_eq!(rows.matches(",warning,").count(), 15, "{rows}");
    assert!(
        rows.contains("\n16,warning,,,,,,,uneven-arc is run"),
        "{rows}"
    );
    // And --strict refuses them.
    check_refused(
        &["-", "--edge", "1", "--strict"],
        &program,
        &["line 2, column 1: M62 not done", "--strict"],
    );
    // No bar where there is no terminal.
    assert!(
        !warnings.contains('\u{1b}') && !warnings.contains('\r'),
        "{warnings:?}"
    );
}

#[test]
fn refused_programs_measure_nothing() {
    for (program, words) in [
        (
            "G21\nG76 X1 Z-1 R1\n",
            &["line 2, column 1", "G76 is refused", "fine boring"][..],
        ),
        ("G21\nG1 X1 A90\n", &["line 2, column 7", "A90 is refused"]),
        ("G21\nG1 X#<a>\n", &["line 2, column 5"]),
        ("G21\nG2 X10 R1\n", &["line 2", "too small", "10.0000"]),
        (
            "G21\n G1 X99999999\n",
            &["line 2", "the cutter cannot be at x ="],
        ),
    ] {
        check_refused(&["-", "--edge", "3", "--step", "1"], program, words);
    }
    check_refused(&["-"], "G21 G1 X1\n", &["tool 0", "--tool", "--edge"]);
    check_refused(&["-", "--step", "1"], "", &["--edge"]);
    check_refused(&["-", "--edge", "1.00005"], "G21 G1 X1\n", &["--edge"]);
    check_refused(
        &["-", "--edge", "1", "--step", "0"],
        "",
        &["--step", "more than 0"],
    );
    check_refused(
        &["-", "--edge", "1", "--step", "1e-300"],
        "G21 G1 X1\n",
        &["--step 1e-300", "--steps-per-unit"],
    );
    check_refused(&["-", "--edge", "1", "--scene", "a"], "", &["--server"]);
    check_refused(&["no/such.gcode", "--edge", "1"], "", &["no/such.gcode"]);
    check_refused(
        &["-", "--edge", "1", "--out", "no/such/out.i32"],
        "G21 G1 X1\n",
        &["no/such/out.i32"],
    );
}

#[test]
fn the_cubes_kept_measure_the_same() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("cubes.i32");
    let out = out.to_str().unwrap();
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/cli/demo.gcode");
    let program = std::fs::read_to_string(program).unwrap();
    let (milled, _) = mill(&["--edge", "3", "--out", out], &program);
    assert_eq!(
        milled["cubes"].as_u64().unwrap() * 12,
        std::fs::metadata(out).unwrap().len()
    );
    let measured = union3d(&["measure", out, "--edge", "3", "--json"], "");
    let measured: Value = serde_json::from_slice(&measured.stdout).unwrap();
    assert_eq!(measured, milled["mass_properties"]);
}

#[test]
fn people_get_a_table() {
    let output = union3d(&["mill", "-", "--edge", "2"], "G21 G0 X0 Y0 Z0\nG1 X10\n");
    let table = String::from_utf8(output.stdout).unwrap();
    for words in [
        "2 moves, 101 cubes in ",
        " cubes/s\n",
        "volume                48 mm^3\n",
        "64 mm (convex 64,",
    ] {
        assert!(table.contains(words), "no {words:?} in\n{table}");
    }
}

/// A server that answers like union3d's and is difficult about it: every batch has to be sent twice.
#[derive(Default)]
struct Difficult {
    settings: Option<Value>,
    cubes: BTreeMap<u64, [i32; 3]>,
    batches: u64,
    /// Sizes of the changes taken.
    sizes: Vec<usize>,
    /// What they said of the machine.
    moves: Vec<(Option<u64>, Option<f64>)>,
    refuse_all: bool,
}

type Shared = Arc<Mutex<Difficult>>;

fn difficult(state: &Shared) -> (tokio::runtime::Runtime, String) {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let listener = runtime
        .block_on(tokio::net::TcpListener::bind("127.0.0.1:0"))
        .unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let router = Router::new()
        .route("/v1/scenes/{scene}", get(describe).put(create))
        .route("/v1/scenes/{scene}/cubes", get(list))
        .route("/v1/scenes/{scene}/changes/batch", post(batch))
        .route("/v1/scenes/{scene}/mass-properties", get(totals))
        .with_state(Arc::clone(state));
    runtime.spawn(async move { axum::serve(listener, router).await });
    (runtime, url)
}

async fn describe(
    State(state): State<Shared>,
    UrlPath(scene): UrlPath<String>,
) -> impl IntoResponse {
    let state = state.lock().unwrap();
    match &state.settings {
        None => (
            StatusCode::NOT_FOUND,
            Json(json!({"title": "no such scene", "status": 404})),
        ),
        Some(settings) => {
            let mut answer = settings.clone();
            answer["scene"] = scene.into();
            answer["cubes"] = state.cubes.len().into();
            (StatusCode::OK, Json(answer))
        }
    }
}

async fn create(State(state): State<Shared>, Json(settings): Json<Value>) -> impl IntoResponse {
    state.lock().unwrap().settings = Some(settings);
    StatusCode::CREATED
}

async fn list(State(state): State<Shared>, headers: HeaderMap) -> String {
    assert_eq!(headers["accept"], "application/x-ndjson");
    let state = state.lock().unwrap();
    state
        .cubes
        .iter()
        .map(|(id, at)| format!("{}\n", json!({"insert": {"id": id, "at": at}})))
        .collect()
}

async fn batch(State(state): State<Shared>, headers: HeaderMap, body: Bytes) -> impl IntoResponse {
    assert_eq!(headers["content-type"], "application/x-protobuf");
    let mut state = state.lock().unwrap();
    state.batches += 1;
    if state.refuse_all {
        let problem = json!({"title": "unprocessable", "status": 422, "detail": "nothing is good enough", "change": 0});
        return (
            StatusCode::UNPROCESSABLE_ENTITY,
            HeaderMap::new(),
            Json(problem),
        );
    }
    if !state.batches.is_multiple_of(2) {
        let retry = HeaderMap::from_iter([("retry-after".parse().unwrap(), "0".parse().unwrap())]);
        return (
            StatusCode::TOO_MANY_REQUESTS,
            retry,
            Json(json!({"title": "busy", "status": 429})),
        );
    }
    let batch = ChangeBatch::decode(body).unwrap();
    let outcomes = batch.changes.into_iter().map(|keyed| {
        assert!(keyed.idempotency_key().len() > 32, "a retry acts once");
        let change = keyed.change.unwrap();
        state.sizes.push(change.x.len());
        state.moves.push((change.r#move, change.duration));
        for (index, id) in change.insert_id.iter().enumerate() {
            let at = [change.x[index], change.y[index], change.z[index]];
            assert_eq!(state.cubes.insert(*id, at), None, "id {id} came twice");
        }
        json!({
            "seq": state.sizes.len(),
            "volume_removed_exact": change.insert_id.len().to_string(),
            "mass_properties": properties("my-pocket", &state),
        })
    });
    (
        StatusCode::OK,
        HeaderMap::new(),
        Json(json!({ "outcomes": outcomes.collect::<Vec<Value>>() })),
    )
}

async fn totals(State(state): State<Shared>, UrlPath(scene): UrlPath<String>) -> Json<Value> {
    Json(properties(&scene, &state.lock().unwrap()))
}

/// Every cube counts one step cubed.
fn properties(scene: &str, state: &Difficult) -> Value {
    let cubes = state.cubes.len();
    json!({"scene": scene, "seq": 1, "cubes": cubes, "exact": {"volume": cubes.to_string(), "area": "0"}})
}

#[test]
fn each_line_is_a_change_and_a_busy_server_is_waited_for() {
    let state = Shared::default();
    let (_runtime, url) = difficult(&state);
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("My Pocket.gcode");
    std::fs::write(&file, "G21 G0 X0 Y0 Z0\nG1 X10 F100\nX20 F200\n").unwrap();
    let out = directory.path().join("cubes.i32");
    let arguments = [
        "mill",
        file.to_str().unwrap(),
        "--edge",
        "2",
        "--step",
        "0.001",
        "--server",
        &url,
        "--out",
        out.to_str().unwrap(),
        "--json",
    ];
    let output = union3d(&arguments, "");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let milled: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(milled["cubes"], 20_001);
    assert_eq!(
        milled["mass_properties"],
        json!({"scene": "my-pocket", "seq": 1, "cubes": 20_001, "exact": {"volume": "20001", "area": "0"}})
    );
    assert_eq!(milled["cutting"]["lines"], 3);
    assert_eq!(milled["cutting"]["machine_seconds"], 9.0);
    assert_eq!(milled["cutting"]["removal_rate"]["peak_line"], 3);
    {
        let state = state.lock().unwrap();
        assert_eq!(
            state.settings,
            Some(json!({
                "edge": 2.0, "steps_per_unit": 1000, "unit": "mm",
                "density": 1.0, "anchor": "corner", "rounding": "nearest",
            }))
        );
        // A change a line, in their order, with its machine time.
        assert_eq!(state.sizes, [0, 10_001, 10_000]);
        assert_eq!(
            state.moves,
            [
                (Some(1), Some(0.0)),
                (Some(2), Some(6.0)),
                (Some(3), Some(3.0))
            ]
        );
        // Ids count from 1 along the path, and the file has the same cubes.
        assert_eq!(
            (state.cubes[&1], state.cubes[&20_001]),
            ([-1000, -1000, 0], [19_000, -1000, 0])
        );
        let kept: Vec<u8> = state
            .cubes
            .values()
            .flatten()
            .flat_map(|coordinate| coordinate.to_le_bytes())
            .collect();
        assert_eq!(kept, std::fs::read(&out).unwrap());
    }
    // Into the same scene again: after the ids that are there.
    let output = union3d(&arguments, "");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert_eq!(state.lock().unwrap().cubes.len(), 40_002);
}

#[test]
fn what_a_server_refuses_is_said() {
    let state = Shared::default();
    let (runtime, url) = difficult(&state);
    let to_server = |server: &str, words: &[&str]| {
        check_refused(
            &["-", "--edge", "2", "--server", server, "--scene", "a"],
            "G21 G1 X1\n",
            words,
        );
    };
    state.lock().unwrap().refuse_all = true;
    to_server(
        &url,
        &[
            "line 1: ",
            "422",
            "nothing is good enough",
            "/v1/scenes/a/changes/batch",
        ],
    );
    state.lock().unwrap().settings = Some(json!({"edge": 3, "steps_per_unit": 1000, "unit": "mm"}));
    to_server(
        &url,
        &["scene \"a\" exists with edge 3", "need 2.0", "--scene"],
    );
    state.lock().unwrap().settings =
        Some(json!({"edge": 2, "steps_per_unit": 1000, "unit": "inch"}));
    to_server(&url, &["unit \"inch\""]);
    drop(runtime);
    to_server(&url, &["cannot reach", &url, "union3d serve"]);
    to_server("localhost:7373", &["http://127.0.0.1:7373"]);
    to_server("ftp://127.0.0.1:7373", &["http://"]);
    to_server("7373", &["http://127.0.0.1:7373"]);
}

#[test]
fn a_server_measures_what_is_measured_here() {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start(&directory.path().join("data"));
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/cli/demo.gcode");
    let program = std::fs::read_to_string(program).unwrap();
    let (here, _) = mill(&["--edge", "3"], &program);
    let (mut there, _) = mill(
        &["--edge", "3", "--server", &server.url, "--scene", "plate"],
        &program,
    );
    assert_eq!(there["cubes"], here["cubes"]);
    let properties = &mut there["mass_properties"];
    assert_eq!(properties["scene"].take(), "plate");
    assert!(properties["seq"].take().as_u64().unwrap() > 1);
    assert_eq!(*properties, here["mass_properties"]);

    // What the server lists measures the same again.
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let listing = runtime.block_on(async {
        let url = format!("{}/v1/scenes/plate/cubes", server.url);
        let request = reqwest::Client::new()
            .get(url)
            .header("accept", "application/x-ndjson");
        request.send().await.unwrap().text().await.unwrap()
    });
    let measured = union3d(&["measure", "-", "--edge", "3", "--json"], &listing);
    let measured: Value = serde_json::from_slice(&measured.stdout).unwrap();
    assert_eq!(measured, here["mass_properties"]);

    // Again into the same scene: twice the cubes, one union.
    let (twice, _) = mill(
        &["--edge", "3", "--server", &server.url, "--scene", "plate"],
        &program,
    );
    assert_eq!(
        twice["mass_properties"]["exact"],
        here["mass_properties"]["exact"]
    );
    assert_eq!(
        twice["mass_properties"]["cubes"],
        2 * here["cubes"].as_u64().unwrap()
    );
    check_refused(
        &[
            "-",
            "--edge",
            "2",
            "--server",
            &server.url,
            "--scene",
            "plate",
        ],
        "G21 G1 X1\n",
        &[
            "scene \"plate\" exists with edge 3",
            "choose another --scene",
        ],
    );
    check_refused(
        &[
            "-",
            "--edge",
            "2",
            "--server",
            &server.url,
            "--scene",
            "Not A Name",
        ],
        "G21 G1 X1\n",
        &["Not A Name"],
    );
}

/// A plunge, a slot, the way back through it, and a rapid that ploughs on.
const SLOT: &str = "G21 F600\nG0 Z5\nG0 X0 Y0\nG1 Z-2\nG1 X10\nG1 X0\nG0 X20\n";
const SLOT_ARGUMENTS: [&str; 6] = [
    "--edge",
    "2",
    "--step",
    "0.1",
    "--stock",
    "-5,-5,-10:30,5,0",
];

#[test]
fn each_line_removes_what_a_calculator_says() {
    let directory = tempfile::tempdir().unwrap();
    let csv = directory.path().join("lines.csv");
    let arguments = [&SLOT_ARGUMENTS[..], &["--csv", csv.to_str().unwrap()]].concat();
    let (milled, _) = mill(&arguments, SLOT);
    let cutting = &milled["cutting"];
    assert_eq!(cutting["lines"], 6);
    assert_eq!(cutting["volume_removed"], 88.0);
    assert_eq!(cutting["air_cuts"], json!({"count": 1, "lines": [6]}));
    assert_eq!(
        cutting["rapid_cuts"],
        json!({"count": 1, "volume": 40.0, "lines": [{"line": 7, "volume": 40.0}]})
    );
    let rate = &cutting["removal_rate"];
    assert_eq!(
        [&rate["peak"], &rate["peak_line"]],
        [&json!(40.0), &json!(5)]
    );
    let mean = rate["mean"].as_f64().unwrap();
    assert!((mean - 48.0 / 2.7).abs() < 1e-9, "{mean}");
    // Rapids at 5 m a minute: 5 and 20 mm of them; line 3 goes nowhere.
    let seconds = cutting["machine_seconds"].as_f64().unwrap();
    assert!(
        (seconds - (2.7 + 25.0 / 5000.0 * 60.0)).abs() < 1e-9,
        "{seconds}"
    );
    let properties = &milled["mass_properties"];
    assert_eq!(properties["removed"]["volume"], 88.0);
    assert_eq!(properties["remaining"]["volume"], 35.0 * 10.0 * 10.0 - 88.0);
    let mut reader = csv::Reader::from_path(&csv).unwrap();
    let columns = reader.headers().unwrap().clone();
    let rows: Vec<_> = reader.records().map(Result::unwrap).collect();
    let cell = |row: usize, name: &str| {
        let column = columns.iter().position(|column| column == name).unwrap();
        rows[row][column].to_owned()
    };
    let lines: Vec<_> = (0..rows.len()).map(|row| cell(row, "line")).collect();
    assert_eq!(lines, ["2", "3", "4", "5", "6", "7"]);
    let removed: Vec<_> = (0..rows.len())
        .map(|row| cell(row, "volume_removed"))
        .collect();
    assert_eq!(removed, ["0.0", "0.0", "8.0", "40.0", "0.0", "40.0"]);
    assert_eq!([cell(3, "motion"), cell(5, "motion")], ["feed", "rapid"]);
    assert_eq!(cell(5, "total_removed"), "88.0");
}

#[test]
fn a_rapid_that_cuts_can_fail_the_run() {
    let arguments = [&["mill", "-", "--fail-on-rapid-cut"], &SLOT_ARGUMENTS[..]].concat();
    let failed = union3d(&arguments, SLOT);
    assert_eq!(failed.status.code(), Some(3));
    let report = String::from_utf8(failed.stdout).unwrap();
    assert!(report.contains("1 line: 7 (40 mm^3)\n"), "{report}");
    assert!(report.contains("on line 5"), "{report}");
    let well = union3d(&arguments, SLOT.replace("G0 X20", "G0 Z9"));
    assert_eq!(well.status.code(), Some(0));
    check_refused(
        &["-", "--edge", "2", "--stock", "0,0:1,1,1"],
        "",
        &["two corners"],
    );
    check_refused(
        &["-", "--edge", "2", "--stock", "0,0,0:1,0,1"],
        "",
        &["stock.max[1]"],
    );
    check_refused(
        &["-", "--edge", "2", "--fail-on-rapid-cut"],
        "",
        &["--stock"],
    );
    check_refused(
        &["-", "--edge", "2", "--scene", "a"],
        "G1 X1\n",
        &["--server or --grpc"],
    );
}

#[test]
fn each_rapid_that_cuts_has_its_volume() {
    let program = format!("{SLOT}G0 Y3\n{}", "G1 X19\nG1 X20\n".repeat(75));
    let output = union3d(&[&["mill", "-"], &SLOT_ARGUMENTS[..]].concat(), &program);
    let report = String::from_utf8(output.stdout).unwrap();
    let words = "2 lines: 7 (40 mm^3), 8 (12 mm^3); 52 mm^3 in all\n";
    assert!(report.contains(words), "{report}");
    // People see the first lines that cut air, programs all of them.
    let words = "150 lines: 6, 10, 11, 12, 13, 14, 15, 16, 17, 18, ...\n";
    assert!(report.contains(words), "{report}");
    let (milled, _) = mill(&SLOT_ARGUMENTS, &program);
    let air = &milled["cutting"]["air_cuts"];
    assert_eq!(air["count"], 150);
    assert_eq!(air["lines"].as_array().unwrap().len(), 150);
}

/// Over HTTP, over gRPC and in the process itself a program removes the same, line by line.
#[test]
fn every_way_to_a_scene_removes_the_same() {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start(&directory.path().join("data"));
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/cli/demo.gcode");
    let program = std::fs::read_to_string(program).unwrap();
    let run = |name: &str, way: &[&str]| {
        let csv = directory.path().join(format!("{name}.csv"));
        let csv = csv.to_str().unwrap();
        let own = ["--edge", "3", "--stock", "-10,-10,-8:90,70,0", "--csv", csv];
        let (mut milled, _) = mill(&[&own, way].concat(), &program);
        milled["seconds"].take();
        milled["mass_properties"]["scene"].take();
        milled["mass_properties"]["seq"].take();
        (milled, std::fs::read_to_string(csv).unwrap())
    };
    let here = run("here", &[]);
    assert!(here.0["cutting"]["volume_removed"].as_f64().unwrap() > 0.0);
    assert_eq!(
        run("http", &["--server", &server.url, "--scene", "http"]),
        here
    );
    assert_eq!(
        run("grpc", &["--grpc", &server.grpc, "--scene", "grpc"]),
        here
    );
    // The history has what each line removed.
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let history = |scene: &str| {
        let url = format!("{}/v1/scenes/{scene}/history?limit=10000", server.url);
        let text =
            runtime.block_on(async { reqwest::get(url).await.unwrap().text().await.unwrap() });
        let history: Value = serde_json::from_str(&text).unwrap();
        let rows = history["changes"].as_array().unwrap().clone();
        let told: Vec<_> = rows
            .iter()
            .map(|row| {
                [
                    row["move"].clone(),
                    row["duration"].clone(),
                    row["volume_removed_exact"].clone(),
                ]
            })
            .collect();
        told
    };
    let told = history("http");
    assert!(told.len() > 50, "{}", told.len());
    assert_eq!(told, history("grpc"));
}

/// How a stream of [`Breaking`] ends once it has taken a change, which it does not acknowledge.
#[derive(Clone, Copy)]
enum End {
    Well,
    Unavailable,
    Internal,
    /// The change is refused for now, nothing of it applied.
    Busy,
}

/// A server over gRPC whose first streams end early.
#[derive(Default)]
struct Breaking {
    ends: VecDeque<End>,
    streams: usize,
    /// By key, as the server keeps them.
    applied: BTreeMap<String, Change>,
    moves: Vec<u64>,
    cubes: BTreeMap<u64, [i32; 3]>,
}

impl Breaking {
    /// Applies a change unless it came before; then it must be the same. The volume is a step cubed for each cube.
    fn apply(&mut self, key: String, change: Change) {
        if let Some(before) = self.applied.get(&key) {
            assert_eq!(*before, change, "{key} came with another change");
            return;
        }
        self.moves.push(change.r#move.unwrap());
        for (index, id) in change.insert_id.iter().enumerate() {
            let at = [change.x[index], change.y[index], change.z[index]];
            assert_eq!(self.cubes.insert(*id, at), None, "id {id} came twice");
        }
        self.applied.insert(key, change);
    }

    fn volume(&self) -> String {
        self.cubes.len().to_string()
    }
}

struct Served(Arc<Mutex<Breaking>>);

type Streamed<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// The calls that `mill` does not make, and those that are served.
macro_rules! serve {
    ({$($name:ident($request:ident) -> $answer:ty;)*} $($served:tt)*) => {
        #[tonic::async_trait]
        impl UnionService for Served {
            type StreamChangesStream = Streamed<proto::StreamChangesResponse>;
            type WatchMassPropertiesStream = Streamed<proto::WatchMassPropertiesResponse>;
            type GetHistoryStream = Streamed<proto::GetHistoryResponse>;
            type ListCubesStream = Streamed<proto::ListCubesResponse>;
            type ListSolidsStream = Streamed<proto::ListSolidsResponse>;
            $($served)*
            $(async fn $name(&self, _: Request<proto::$request>) -> Result<Response<$answer>, Status> {
                Err(Status::unimplemented(stringify!($name)))
            })*
        }
    };
}

serve! {
    {
        get_scene(GetSceneRequest) -> proto::GetSceneResponse;
        list_scenes(ListScenesRequest) -> proto::ListScenesResponse;
        delete_scene(DeleteSceneRequest) -> proto::DeleteSceneResponse;
        apply_change(ApplyChangeRequest) -> proto::ApplyChangeResponse;
        revert_scene(RevertSceneRequest) -> proto::RevertSceneResponse;
        watch_mass_properties(WatchMassPropertiesRequest) -> Self::WatchMassPropertiesStream;
        get_history(GetHistoryRequest) -> Self::GetHistoryStream;
        list_cubes(ListCubesRequest) -> Self::ListCubesStream;
        get_cube(GetCubeRequest) -> proto::GetCubeResponse;
        define_shape(DefineShapeRequest) -> proto::DefineShapeResponse;
        list_solids(ListSolidsRequest) -> Self::ListSolidsStream;
        get_solid(GetSolidRequest) -> proto::GetSolidResponse;
        contains(ContainsRequest) -> proto::ContainsResponse;
        audit_scene(AuditSceneRequest) -> proto::AuditSceneResponse;
    }

    async fn create_scene(
        &self,
        _: Request<proto::CreateSceneRequest>,
    ) -> Result<Response<proto::CreateSceneResponse>, Status> {
        Ok(Response::new(proto::CreateSceneResponse::default()))
    }

    async fn get_mass_properties(
        &self,
        request: Request<proto::GetMassPropertiesRequest>,
    ) -> Result<Response<proto::GetMassPropertiesResponse>, Status> {
        let breaking = self.0.lock().unwrap();
        let settings = Settings::check(&SettingsDocument::with_edge(2.0)).unwrap();
        let nothing = recount(settings.edge(), None, std::iter::empty());
        let properties = mass_properties(Some(&request.get_ref().scene), None, &nothing, &settings);
        let mut properties = proto::MassProperties::from(properties);
        properties.cubes = breaking.cubes.len() as u64;
        properties.exact.as_mut().unwrap().volume = breaking.volume();
        Ok(Response::new(proto::GetMassPropertiesResponse {
            mass_properties: Some(properties),
            solid_mass_properties: None,
        }))
    }

    async fn stream_changes(
        &self,
        request: Request<Streaming<proto::StreamChangesRequest>>,
    ) -> Result<Response<Self::StreamChangesStream>, Status> {
        let mut inbound = request.into_inner();
        let state = Arc::clone(&self.0);
        let end = {
            let mut state = state.lock().unwrap();
            state.streams += 1;
            state.ends.pop_front()
        };
        let answer = |message| Ok(proto::StreamChangesResponse { message: Some(message) });
        Ok(Response::new(Box::pin(async_stream::stream! {
            yield answer(response::Message::Opened(proto::Opened::default()));
            while let Ok(Some(message)) = inbound.message().await {
                let Some(request::Message::Change(sent)) = message.message else {
                    continue;
                };
                if let Some(End::Busy) = end {
                    let problem = proto::Problem {
                        retry_after_seconds: Some(1),
                        ..proto::Problem::default()
                    };
                    let refused = proto::Refused { tag: sent.tag, problem: Some(problem) };
                    yield answer(response::Message::Refused(refused));
                    yield Err(Status::unavailable("busy"));
                    return;
                }
                let change = sent.change.unwrap();
                // As recorded with the key, also when it is sent again.
                let removed = change.insert_id.len().to_string();
                let volume = {
                    let mut state = state.lock().unwrap();
                    state.apply(sent.idempotency_key.unwrap(), change);
                    state.volume()
                };
                match end {
                    Some(End::Well) => return,
                    Some(End::Unavailable) => {
                        yield Err(Status::unavailable("the disk failed"));
                        return;
                    }
                    Some(End::Internal) => {
                        yield Err(Status::internal("a fault of the server"));
                        return;
                    }
                    Some(End::Busy) | None => {}
                }
                let volumes = Volumes {
                    exact_union: volume,
                    exact_area: "0".to_owned(),
                    ..Volumes::default()
                };
                let outcome = Outcome {
                    volumes: Some(volumes),
                    volume_removed_exact: removed,
                    ..Outcome::default()
                };
                let acknowledged = Acknowledged { tag: sent.tag, outcome: Some(outcome) };
                yield answer(response::Message::Acknowledged(acknowledged));
            }
        })))
    }
}

/// Mills three lines into a server whose first streams end so.
fn mill_while_it_breaks(ends: &[End]) -> (Output, Breaking) {
    let state = Arc::new(Mutex::new(Breaking {
        ends: ends.iter().copied().collect(),
        ..Breaking::default()
    }));
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let listener = runtime
        .block_on(tokio::net::TcpListener::bind("127.0.0.1:0"))
        .unwrap();
    let address = format!("grpc://{}", listener.local_addr().unwrap());
    let served = UnionServiceServer::new(Served(Arc::clone(&state)));
    runtime.spawn(
        tonic::transport::Server::builder()
            .add_service(served)
            .serve_with_incoming(TcpIncoming::from(listener)),
    );
    let output = union3d(
        &[
            "mill", "-", "--json", "--edge", "2", "--grpc", &address, "--scene", "a",
        ],
        "G21 G1 X10 F600\nX20\nX30\n",
    );
    let state = std::mem::take(&mut *state.lock().unwrap());
    (output, state)
}

/// What was applied without an acknowledgement is sent again as it was.
#[test]
fn a_stream_that_breaks_is_opened_again() {
    use End::{Busy, Unavailable, Well};
    let ends = [Unavailable, Well, Busy, Well, Well, Well];
    let (output, state) = mill_while_it_breaks(&ends);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    assert_eq!(state.streams, ends.len() + 1);
    assert_eq!((state.moves, state.cubes.len()), (vec![1, 2, 3], 201));
    let milled: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(milled["cutting"]["lines"], 3);
    assert_eq!(milled["mass_properties"]["exact"]["volume"], "201");
}

#[test]
fn a_fault_of_the_server_ends_the_stream() {
    let (output, state) = mill_while_it_breaks(&[End::Internal; 100]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success());
    assert!(errors.contains("a fault of the server"), "{errors}");
    assert_eq!(state.streams, 1);
}

/// A server that is killed in the middle of a program and comes back makes no difference.
#[test]
fn a_server_killed_in_the_middle_is_waited_for() {
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().join("data");
    let server = Server::start(&data);
    let address = server.grpc.clone();
    let lines: String = (0..20_000)
        .map(|line| format!("G1 X{} Y{}\n", line % 7, line % 5))
        .collect();
    let program = format!("G21 F600 G0 X0 Y0 Z0\n{lines}");
    let file = directory.path().join("program.nc");
    std::fs::write(&file, &program).unwrap();
    let (here, _) = mill(&["--edge", "3", "--step", "1"], &program);
    let mut child = Command::new(env!("CARGO_BIN_EXE_union3d"))
        .arg("mill")
        .arg(&file)
        .args(["--json", "--edge", "3", "--step", "1"])
        .args(["--grpc", &address, "--scene", "a"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary runs");
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let url = format!("{}/v1/scenes/a", server.url);
    let changes = loop {
        let text = runtime.block_on(async { reqwest::get(&url).await?.text().await });
        let scene: Value = serde_json::from_str(&text.unwrap()).unwrap();
        if let Some(changes @ 101..) = scene["seq"].as_u64() {
            break changes;
        }
        assert!(child.try_wait().unwrap().is_none(), "mill ended");
    };
    drop(server);
    assert!(
        changes < 20_000,
        "the program was over before the server was killed"
    );
    let server = Server::start_at(&data, address.trim_start_matches("grpc://"));
    assert_eq!(server.grpc, address);
    let output = child.wait_with_output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    let there: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(there["cutting"], here["cutting"]);
    assert_eq!(
        there["mass_properties"]["exact"],
        here["mass_properties"]["exact"]
    );
    assert_eq!(there["mass_properties"]["cubes"], here["cubes"]);
}
