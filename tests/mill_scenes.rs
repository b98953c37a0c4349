//! `union3d mill` with tools of their own shapes into a scene of a server: the same report whichever way it goes, and `--replace`.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use std::process::Output;

use serde_json::{Value, json};

#[path = "oracle/program.rs"]
mod program;
#[path = "oracle/serve.rs"]
mod serve;

use program::union3d;
use serve::Server;

const STOCK: &str = "--stock=0,0,-10:60,40,0";

fn run(arguments: &[&str], program: &str) -> Output {
    union3d(&[&["mill", "-"], arguments].concat(), program)
}

/// What `--json` says of a program.
#[track_caller]
fn mill(arguments: &[&str], program: &str) -> Value {
    let output = run(&[arguments, &["--json"]].concat(), program);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

#[track_caller]
fn check_refused(arguments: &[&str], program: &str, words: &[&str]) {
    let output = run(arguments, program);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{errors}");
    for word in words {
        assert!(errors.contains(word), "no {word:?} in {errors:?}");
    }
}

/// What the server answers to a request.
fn get(url: &str) -> Value {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let text = runtime.block_on(async { reqwest::get(url).await.unwrap().text().await.unwrap() });
    serde_json::from_str(&text).unwrap()
}

fn put(url: &str, body: &Value) {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let put = reqwest::Client::new().put(url).json(body);
    let answer = runtime.block_on(put.send()).unwrap();
    assert!(answer.status().is_success(), "{answer:?}");
}

/// The solids of a scene by their ids.
fn solids(server: &Server, scene: &str) -> BTreeMap<u64, Value> {
    let listed = get(&format!(
        "{}/v1/scenes/{scene}/solids?limit=10000",
        server.url
    ));
    let listed = listed["solids"].as_array().unwrap().iter();
    listed
        .map(|solid| (solid["id"].as_u64().unwrap(), solid.clone()))
        .collect()
}

/// Two tools, arcs of several chords, a plunge below the flutes, a holder that hits, a rapid that ploughs, a dwell, a line that cuts air, and
/// a loop, so that lines come again.
const PROGRAM: &str = "G21 G90 G17
T1 M6
G0 X10 Y10 Z30
G1 Z-2 F300
X40 Y12
G2 X40 Y30 I0 J9
G4 P0.5
G1 X10 Y30 Z-3
X10 Y30
G0 X12 Y25
G0 Z30
T2 M6
G0 X30 Y20
G1 Z-9 F100
G0 Z30
T3 M6
#1=0
O1 while [#1 LT 3]
G0 X[5+#1*3] Y5 Z30
G1 Z-1 F200
X[6+#1*3] Y35
#1=[#1+1]
O1 endwhile
G0 Z30
M2
";

const TOOLS: [&str; 6] = [
    "--tool",
    "T1=ball:6,flutes=12,length=22,holder=20x10",
    "--tool",
    "T2=drill:4,length=7,holder=12x20",
    "--tool",
    "T3=form:0x0/2x1/3x1/3x6,length=20",
];

/// What a run says, without what tells the scene and the clock.
fn report(way: &[&str], name: &str, directory: &Path, own: &[&str]) -> (Value, String) {
    let csv = directory.join(format!("{name}.csv"));
    let arguments = [&TOOLS[..], own, way, &["--csv", csv.to_str().unwrap()]].concat();
    let mut milled = mill(&arguments, PROGRAM);
    milled["seconds"].take();
    for properties in ["mass_properties", "remaining"] {
        if milled.get(properties).is_some() {
            milled[properties]["scene"].take();
            milled[properties]["seq"].take();
        }
    }
    (milled, std::fs::read_to_string(csv).unwrap())
}

/// In this process, over HTTP and over gRPC: number for number the same report.
#[test]
fn every_way_to_a_scene_reports_the_same() {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start(&directory.path().join("data"));
    let bare = ["--steps-per-unit", "100"];
    let round = ["--stock=cylinder:30,20,-10:45.0004x10", "--unit", "mm"];
    for (index, own) in [&[STOCK, "--contact"][..], &round, &bare]
        .into_iter()
        .enumerate()
    {
        let run = |way: &str, address: &str| {
            let scene = format!("{}{index}", &way[2..]);
            report(
                &[way, address, "--scene", &scene],
                &scene,
                directory.path(),
                own,
            )
        };
        let here = report(&[], "here", directory.path(), own);
        assert!(here.0["cutting"]["volume_removed"].as_f64().unwrap() > 0.0);
        let hits = here.0["cutting"]["shank_or_holder"]["count"].as_u64();
        let rapids = here.0["cutting"]["rapid_cuts"]["count"].as_u64().unwrap();
        assert_eq!(hits > Some(0), index < 2, "{}", here.0);
        assert_eq!(rapids > 0, index < 2, "{}", here.0);
        let contact = here.0["cutting"]["contact_area"]["peak"].as_f64();
        assert_eq!(contact > Some(0.0), index == 0, "{}", here.0);
        assert_eq!(run("--server", &server.url), here);
        assert_eq!(run("--grpc", &server.grpc), here);
    }
    // A change a step, and in the history what each line removed.
    let history = |scene: &str| {
        let history = get(&format!(
            "{}/v1/scenes/{scene}/history?limit=1000",
            server.url
        ));
        let rows = history["changes"].as_array().unwrap().clone();
        let told = rows.into_iter().map(|row| {
            ["move", "duration", "inserted", "volume_removed_exact"].map(|name| row[name].clone())
        });
        told.collect::<Vec<_>>()
    };
    let told = history("grpc0");
    assert_eq!(told, history("server0"));
    let lines: Vec<_> = told.iter().map(|row| row[0].as_u64().unwrap()).collect();
    assert_eq!(lines[..9], [3, 4, 5, 6, 7, 8, 9, 10, 11]);
    // The solids of a line are numbered from line * 2^20 on, however often it runs: three times, for line 21.
    let ids: Vec<u64> = solids(&server, "grpc0").into_keys().collect();
    let of_line = |line: u64| ids.iter().filter(move |id| *id >> 20 == line).copied();
    assert!(of_line(21).eq((21 << 20)..(21 << 20) + 3), "{ids:?}");
    assert!(
        of_line(6).count() > 10 && of_line(9).count() == 1,
        "{ids:?}"
    );
    // The scene has the tools as they are, and says how far their polygons are from circles.
    let settings = &get(&format!("{}/v1/scenes/grpc0", server.url));
    let shapes = settings["shapes"].as_object().unwrap();
    let balls: Vec<_> = shapes
        .values()
        .filter(|shape| shape.get("ball").is_some())
        .collect();
    assert!(
        balls.iter().any(|ball| ball["top"].as_f64() > Some(0.0)),
        "{shapes:?}"
    );
    assert!(!settings["polygon_error"].as_object().unwrap().is_empty());
    let people = run_people(&server);
    assert!(
        people.contains("scene                 people, after change"),
        "{people}"
    );
}

fn run_people(server: &Server) -> String {
    let arguments = [
        &TOOLS[..],
        &[STOCK, "--grpc", &server.grpc, "--scene", "people"],
    ]
    .concat();
    String::from_utf8(run(&arguments, PROGRAM).stdout).unwrap()
}

/// A scene is used that is there already, if it is right and empty; else it is said why not.
#[test]
fn a_scene_must_fit_the_program() {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start(&directory.path().join("data"));
    let scene = |name: &str| format!("{}/v1/scenes/{name}", server.url);
    let stock = json!({"min": [0, 0, -10], "max": [60, 40, 0]});
    let solids = |steps: u32, stock: &Value| json!({"kind": "solids", "steps_per_unit": steps, "stock": stock, "density": 7.9});
    put(&scene("empty"), &solids(1000, &stock));
    put(&scene("fine"), &solids(10_000, &stock));
    put(
        &scene("hull"),
        &solids(
            1000,
            &json!({"hull": [[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]]}),
        ),
    );
    put(&scene("cubes"), &json!({"edge": 3}));
    for way in [["--grpc", &server.grpc], ["--server", &server.url]] {
        let to = |scene| [&TOOLS[..], &[STOCK], &way, &["--scene", scene]].concat();
        for (scene, word) in [
            ("fine", "steps_per_unit"),
            ("hull", "stock"),
            ("cubes", "kind"),
        ] {
            let words = [
                &format!("scene {scene:?} exists with {word}"),
                "choose another --scene",
            ];
            check_refused(&to(scene), PROGRAM, &words);
        }
    }
    let arguments = [
        &TOOLS[..],
        &[STOCK, "--grpc", &server.grpc, "--scene", "empty"],
    ]
    .concat();
    let milled = mill(&arguments, PROGRAM);
    let properties = &milled["mass_properties"];
    let mass = properties["mass"].as_f64().unwrap() / properties["volume"].as_f64().unwrap();
    assert!((mass - 7.9).abs() < 1e-9, "{mass}");
    for way in [["--grpc", &server.grpc], ["--server", &server.url]] {
        let arguments = [&TOOLS[..], &[STOCK, way[0], way[1], "--scene", "empty"]].concat();
        check_refused(
            &arguments,
            PROGRAM,
            &["\"empty\" has", "solids already", "--replace"],
        );
    }
    check_refused(&[STOCK, "--scene", "x"], PROGRAM, &["--server or --grpc"]);
}

/// What was cut before a holder came near the stock for the first time counts, too, from the first solid on, a ramp of which no later one
/// covers the middle: in there a thin holder goes through nothing.
#[test]
fn holders_know_all_that_was_cut_before() {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start(&directory.path().join("data"));
    let program = "G21 G90\nT1 M6\nG0 X5 Y10 Z5\nG1 X35 Z-10 F300\nG0 Z30\nX50 Y30\nG1 Z-5\nG0 Z30\nT2 M6\nX22 Y10\nG1 Z-5\nG0 Z30\nX50 Y30\nG1 Z-5\nG0 Z30\nY10\nG1 Z-5\nM2\n";
    let tools = [
        "--tool",
        "T1=flat:6",
        "--tool",
        "T2=flat:2,length=4,holder=4x30",
        STOCK,
    ];
    for way in [
        &[][..],
        &["--server", &server.url, "--scene", "http"],
        &["--grpc", &server.grpc, "--scene", "grpc"],
    ] {
        let milled = mill(&[&tools[..], way].concat(), program);
        let hits = milled["cutting"]["shank_or_holder"]["lines"]
            .as_array()
            .unwrap();
        let lines: Vec<_> = hits.iter().map(|hit| hit["line"].as_u64()).collect();
        assert_eq!(lines, [Some(17)], "{way:?}");
    }
}

/// What a server refuses is a line of the program for who sent it.
#[test]
fn a_refusal_names_the_line() {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start(&directory.path().join("data"));
    let program = "G21 G90\nG0 X0 Y0 Z0\nG1 X10 F600\nX3000\nX10\nM2\n";
    let tool = ["--tool", "flat:2,length=10"];
    for way in [
        &[][..],
        &["--server", &server.url, "--scene", "http"],
        &["--grpc", &server.grpc, "--scene", "grpc"],
    ] {
        check_refused(
            &[&tool[..], way].concat(),
            program,
            &["line 4: ", "steps long"],
        );
    }
}

/// Lines to and fro, one a row; `edited` is the row that goes elsewhere.
fn rows(edited: Option<usize>) -> String {
    let mut program = String::from("G21 G90\nT1 M6\nG0 X5 Y2 Z5\nG1 Z-1 F500\n");
    for row in 0..30 {
        let x = if row % 2 == 0 { 55 } else { 5 };
        let y = if edited == Some(row) {
            37.5
        } else {
            2.0 + f64::from(u32::try_from(row).unwrap())
        };
        writeln!(program, "G1 X{x} Y{y}").unwrap();
    }
    program + "G0 Z5\nM2\n"
}

/// What is measured, without what depends on the way there.
fn measured(milled: &Value) -> Vec<Value> {
    let of = |properties: &Value| properties["exact"].as_object().unwrap().clone();
    let values = |exact: serde_json::Map<String, Value>| {
        exact
            .into_iter()
            .map(|(name, measure)| json!([name, measure.get("value")]))
            .collect::<Vec<_>>()
    };
    let solids = milled["mass_properties"]["solids"].clone();
    let both = ["mass_properties", "remaining"].map(|name| values(of(&milled[name])));
    both.concat().into_iter().chain([solids]).collect()
}

/// One line changed in the middle: its solid and the one that begins where it ended are exchanged, and the totals are those of the new program
/// milled anew.
#[test]
fn replacing_sends_what_differs() {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start(&directory.path().join("data"));
    let tool = ["--tool", "T1=flat:3"];
    let into = |scene| {
        [
            &tool[..],
            &[STOCK, "--grpc", &server.grpc, "--scene", scene],
        ]
        .concat()
    };
    let replacing = |scene| [&into(scene)[..], &["--replace"]].concat();
    check_refused(
        &replacing("part"),
        &rows(None),
        &["no scene \"part\"", "without --replace"],
    );
    mill(&into("part"), &rows(None));
    let before = solids(&server, "part");
    let counts = |replaced: &Value| {
        ["deleted", "inserted", "kept", "stale_from_line"].map(|name| replaced[name].as_u64())
    };

    let same = mill(&replacing("part"), &rows(None));
    assert_eq!(counts(&same), [Some(0), Some(0), Some(32), None]);

    // Row 12 is line 17; line 18 begins elsewhere.
    let replaced = mill(&replacing("part"), &rows(Some(12)));
    assert_eq!(counts(&replaced), [Some(2), Some(2), Some(30), Some(17)]);
    let anew = mill(&into("anew"), &rows(Some(12)));
    assert_eq!(measured(&replaced), measured(&anew));
    let history = get(&format!("{}/v1/scenes/part/history?limit=1000", server.url));
    let last = history["changes"]
        .as_array()
        .unwrap()
        .last()
        .unwrap()
        .clone();
    assert_eq!(
        (&last["deleted"], &last["inserted"]),
        (&json!(2), &json!(2))
    );
    let after = solids(&server, "part");
    let differing = after
        .iter()
        .filter(|(id, solid)| before.get(id) != Some(solid));
    assert_eq!(
        differing.map(|(id, _)| id >> 20).collect::<Vec<_>>(),
        [17, 18]
    );

    // A line more, on the way of the one after it: all later lines shift, and three solids go.
    let longer = rows(Some(12)).replacen("G1 X5 Y7\n", "G1 X30 Y7.5\nG1 X5 Y7\n", 1);
    assert_ne!(longer, rows(Some(12)));
    let replaced = mill(&replacing("part"), &longer);
    assert_eq!(counts(&replaced), [Some(1), Some(2), Some(31), Some(10)]);
    let anew = mill(&into("longer"), &longer);
    assert_eq!(measured(&replaced), measured(&anew));

    // Another tool: everything goes. What is no program's goes, too. And back to where it began.
    let body = r#"{"insert":[{"id":3,"hull":[[0,0,-9],[5,0,-9],[0,5,-9],[0,0,-1]]}]}"#;
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let url = format!("{}/v1/scenes/part/changes", server.url);
    let post = reqwest::Client::new()
        .post(url)
        .header("content-type", "application/json");
    assert!(
        runtime
            .block_on(post.body(body).send())
            .unwrap()
            .status()
            .is_success()
    );
    let wider = [
        "--tool",
        "T1=flat:4",
        STOCK,
        "--grpc",
        &server.grpc,
        "--scene",
        "part",
        "--replace",
    ];
    let replaced = mill(&wider, &longer);
    assert_eq!(counts(&replaced), [Some(34), Some(33), Some(0), Some(4)]);
    let people = run(&replacing("part"), &rows(None));
    let people = String::from_utf8(people.stdout).unwrap();
    for words in [
        "33 solids deleted, 32 inserted, 0 kept",
        "stale from line 4 on",
        "milling anew",
    ] {
        assert!(people.contains(words), "{people}");
    }
    assert_eq!(solids(&server, "part"), before);

    // To the other side and back in between: nothing goes, and what comes gets ids of its lines that are free.
    let back = rows(None).replacen("G1 X5 Y7\n", "G1 X5 Y7\nG1 X55 Y7\nG1 X5 Y7\n", 1);
    let replaced = mill(&replacing("part"), &back);
    assert_eq!(counts(&replaced), [Some(0), Some(2), Some(32), Some(11)]);
    let after = solids(&server, "part");
    let new = after.keys().filter(|id| !before.contains_key(id));
    assert!(new.copied().eq([11 << 20 | 1, 12 << 20 | 1]), "{after:?}");

    let csv = [&replacing("part")[..], &["--csv", "x.csv"]].concat();
    let refused = run(&csv, "");
    assert_eq!(refused.status.code(), Some(2));
}

/// Twice the signed volume under the triangles of a binary STL, times three.
fn volume6(stl: &[u8]) -> f64 {
    let number = |bytes: &[u8]| f64::from(f32::from_le_bytes(bytes.try_into().unwrap()));
    let triangles = stl[84..].as_chunks::<50>().0;
    let count = u32::from_le_bytes(stl[80..84].try_into().unwrap());
    assert_eq!(triangles.len(), count as usize);
    assert_eq!(stl.len(), 84 + 50 * triangles.len());
    let volumes = triangles.iter().map(|triangle| {
        let [a, b, c] = [12, 24, 36].map(|corner| {
            [0, 4, 8].map(|axis| number(&triangle[corner + axis..corner + axis + 4]))
        });
        let cross = [1, 2, 0].map(|axis| {
            let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
            (axis, b[next] * c[last] - b[last] * c[next])
        });
        cross
            .iter()
            .map(|(axis, value)| a[*axis] * value)
            .sum::<f64>()
    });
    volumes.sum()
}

/// What remains of the stock, as a file that is whole or not there.
#[test]
fn a_scene_is_exported_as_a_mesh() {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start(&directory.path().join("data"));
    let arguments = [
        &TOOLS[..],
        &[STOCK, "--server", &server.url, "--scene", "part"],
    ]
    .concat();
    let milled = mill(&arguments, PROGRAM);
    let out = directory.path().join("part.stl");
    let export = |scene: &str, out: &Path, more: &[&str]| {
        let arguments = ["export", scene, "--server", &server.url, "--out"];
        union3d(
            &[&arguments[..], &[out.to_str().unwrap()], more].concat(),
            "",
        )
    };
    let output = export("part", &out, &[]);
    assert!(output.status.success(), "{output:?}");
    let expected = milled["remaining"]["volume"].as_f64().unwrap();
    let found = volume6(&std::fs::read(&out).unwrap()) / 6.0;
    assert!(
        (found / expected - 1.0).abs() < 1e-5,
        "{found}, not {expected}"
    );
    for (scene, name, more, words) in [
        (
            "part",
            "part.dxf",
            &[][..],
            "none of stl, ply, obj, 3mf, glb",
        ),
        ("none", "none.stl", &[], "no scene"),
        (
            "part",
            "few.ply",
            &["--at-most", "7"],
            "more than 7 triangles",
        ),
        ("part", "box.obj", &["--box", "0,0,0"], "six numbers"),
    ] {
        let out = directory.path().join(name);
        let output = export(scene, &out, more);
        let errors = String::from_utf8(output.stderr).unwrap();
        assert!(
            !output.status.success() && errors.contains(words),
            "{name}: {errors}"
        );
        assert!(!out.exists());
    }
    // Nothing half-made is left, either.
    let mut left: Vec<_> = std::fs::read_dir(directory.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    left.sort();
    assert_eq!(left, ["data", "part.stl"]);
}
