//! `union3d measure` of solids: the files it reads, what it answers, and what it says about files it cannot read.

use std::process::Output;

use serde_json::{Value, json};

#[path = "oracle/program.rs"]
mod program;

use program::union3d;

fn measure(arguments: &[&str], input: &[u8]) -> Output {
    union3d(&[&["measure"], arguments].concat(), input)
}

/// The mass properties of lines of solids.
#[track_caller]
fn properties(lines: &str) -> Value {
    let output = measure(&["-", "--kind", "solids", "--json"], lines.as_bytes());
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    assert_eq!(errors, "");
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

/// Solids, volume, area and total edge length.
#[track_caller]
fn check(lines: &str, expected: [f64; 4]) {
    let found = properties(lines);
    let found = [
        &found["solids"],
        &found["volume"],
        &found["area"],
        &found["edge_length"]["total"],
    ]
    .map(|value| value.as_f64().expect("a number"));
    for (found, expected) in found.into_iter().zip(expected) {
        assert!(
            (found - expected).abs() < 1e-7,
            "{found} is not {expected}: {lines}"
        );
    }
}

/// The input is refused with a message that has these words.
#[track_caller]
fn check_refused(arguments: &[&str], input: &str, words: &str) {
    let output = measure(arguments, input.as_bytes());
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success(), "{input}");
    assert_eq!(output.stdout, b"");
    assert!(errors.contains(words), "no {words:?} in {errors:?}");
}

/// A cutter whose circle is the square around it: 2 wide, 10 long.
const SQUARE: &str = r#"{"shapes":{"t":{"flat":{"diameter":2,"length":10,"sides":4,"polygon":"circumscribed"}},"b":{"box":[1,1,1]}}}"#;

#[test]
fn lines_are_shapes_solids_and_changes() {
    let with = |lines: &str| format!("{SQUARE}\n{lines}");
    check(&with(""), [0.0; 4]);
    check(
        &with(r#"{"shape":"b","at":[5,5,5]}"#),
        [1.0, 1.0, 6.0, 12.0],
    );
    // A slot 10 long: 12 by 2 by 10.
    let slot = r#"{"id":1,"shape":"t","from":[0,0,0],"to":[10,0,0]}"#;
    check(&with(slot), [1.0, 240.0, 328.0, 96.0]);
    // The way back, and half of it again, remove nothing.
    let back = r#"
{"id":2,"shape":"t","from":[10,0,0],"to":[0,0,0]}
{"id":3,"shape":"t","from":[2,0,0],"to":[7,0,0]}"#;
    check(&with(&format!("{slot}{back}")), [3.0, 240.0, 328.0, 96.0]);
    // A crossing slot: five squares of 2 by 2 in the plane, but the arms are 5 long.
    let crossing = r#"{"id":4,"shape":"t","from":[5,-5,0],"to":[5,5,0]}"#;
    let plan_area = 12.0 * 2.0 + 12.0 * 2.0 - 4.0;
    let plan_outline = 4.0 * 15.0 - 4.0 * 2.0 - 4.0;
    check(
        &with(&format!("{slot}\n{crossing}")),
        [
            2.0,
            plan_area * 10.0,
            2.0 * plan_area + plan_outline * 10.0,
            2.0 * plan_outline + 120.0,
        ],
    );
    let hull = r#"{"hull":[[0,0,0],[1,0,0],[0,1,0],[0,0,1],[0,0,0.5]]}"#;
    check(
        hull,
        [
            1.0,
            1.0 / 6.0,
            1.5 + 3.0_f64.sqrt() / 2.0,
            3.0 + 3.0 * 2.0_f64.sqrt(),
        ],
    );
    let changes = r#"
{"insert":{"id":1,"shape":"b","at":[0,0,0]}}
{"insert":{"id":1,"shape":"b","at":[0,0,0]}}
{"insert":{"id":2,"shape":"t","at":[0,0,0]}}
{"delete":2}
{"delete":3}

{"insert":{"id":2,"shape":"b","at":[1,0,0]}}"#;
    check(&with(changes), [2.0, 2.0, 10.0, 16.0]);
}

#[test]
fn more_solids_than_one_batch_come_to_their_union() {
    // A row of 5,000 unit boxes, each twice.
    let mut lines = format!("{SQUARE}\n");
    for _ in 0..2 {
        for x in 0..5000 {
            lines += &format!("{{\"shape\":\"b\",\"at\":[{}.{},0,0]}}\n", x / 10, x % 10);
        }
    }
    check(
        &lines,
        [10_000.0, 500.9, 2.0 + 4.0 * 500.9, 8.0 + 4.0 * 500.9],
    );
}

#[test]
fn lines_that_are_wrong_say_where() {
    let refused = |lines: &str, words: &str| {
        check_refused(&["-", "--kind", "solids"], lines, words);
    };
    refused("{}", "line 1: it is neither a shape with at");
    refused("\n\n{\"id\":1", "line 3: EOF while parsing");
    refused("0,0,0", "line 1: trailing characters");
    refused(
        r#"{"shape":"b","at":[0,0,0]}"#,
        "line 1: /shape = \"b\": there is no such shape",
    );
    refused(
        &format!("{SQUARE}\n{{\"shape\":\"b\",\"at\":[0,0,1e12]}}"),
        "line 2: /at/2 = 1000000000000 is outside",
    );
    refused(
        &format!("{SQUARE}\n{{\"shape\":\"b\",\"at\":[0,\"1\",0]}}"),
        "line 2: at[1]: invalid type: string \"1\", expected f64",
    );
    refused(
        &format!("{SQUARE}\n{{\"shape\":\"b\",\"at\":[0,0]}}"),
        "line 2: at: invalid length 2, expected an array of length 3",
    );
    refused(
        &format!("{SQUARE}\n{{\"shape\":\"b\",\"at\":[0,0,0],\"color\":1}}"),
        "line 2: color: unknown field `color`",
    );
    refused(
        r#"{"shapes":{"x":{"cube":[1,1,1]}}}"#,
        "line 1: shapes.x.cube: unknown field `cube`, expected one of `flat`, `ball`",
    );
    refused(
        r#"{"shapes":{"x":{"flat":{"diameter":6.00001,"length":9}}}}"#,
        "line 1: /shapes/x/flat/diameter = 6.00001 is",
    );
    refused(
        &format!("{SQUARE}\n{SQUARE}"),
        "line 2: /shapes/b is there already, and a shape never changes",
    );
    refused(
        r#"{"hull":[[0,0,0],[1,0,0],[0,1,0]]}"#,
        "line 1: /hull is no solid: the points lie in one plane",
    );
    refused(
        &format!(
            "{SQUARE}\n{{\"id\":1,\"shape\":\"b\",\"at\":[0,0,0]}}\n{{\"shape\":\"b\",\"at\":[0,0,0]}}"
        ),
        "line 3: either every solid has an id, or none",
    );
    refused(
        &format!(
            "{SQUARE}\n{{\"id\":1,\"shape\":\"b\",\"at\":[0,0,0]}}\n{{\"id\":1,\"shape\":\"b\",\"at\":[1,0,0]}}"
        ),
        "line 3: id 1 is there already, with another body",
    );
}

/// The text of an STL file of the tetrahedron between the origin and three points on the axes.
fn tetrahedron(size: f64, closed: bool) -> String {
    let corners = [
        [0.0, 0.0, 0.0],
        [size, 0.0, 0.0],
        [0.0, size, 0.0],
        [0.0, 0.0, size],
    ];
    let mut text = "solid t\n".to_owned();
    for triangle in &[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]][..if closed { 4 } else { 3 }] {
        text += "facet normal 0 0 0\nouter loop\n";
        for [x, y, z] in triangle.map(|corner: usize| corners[corner]) {
            text += &format!("vertex {x} {y} {z}\n");
        }
        text += "endloop\nendfacet\n";
    }
    text + "endsolid t\n"
}

#[test]
fn stl_files_are_solids_and_join_lines() {
    let directory = tempfile::tempdir().unwrap();
    let write = |name: &str, content: &str| {
        let file = directory.path().join(name);
        std::fs::write(&file, content).unwrap();
        file.to_str().unwrap().to_owned()
    };
    let one = write("one.stl", &tetrahedron(6.0, true));
    let two = write("two.STL", &tetrahedron(3.0, true));
    let open = write("open.stl", &tetrahedron(6.0, false));
    let lines = write(
        "box.ndjson",
        r#"{"hull":[[-1,0,0],[0,0,0],[-1,1,0],[-1,0,1]]}"#,
    );
    let volume = |arguments: &[&str]| {
        let output = measure(&[arguments, &["--json"]].concat(), b"");
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        let found: Value = serde_json::from_slice(&output.stdout).unwrap();
        [
            found["solids"].as_f64().unwrap(),
            found["volume"].as_f64().unwrap(),
        ]
    };
    assert_eq!(volume(&[&one]), [1.0, 36.0]);
    // The smaller one lies inside.
    assert_eq!(volume(&[&one, &two]), [2.0, 36.0]);
    let [solids, joined] = volume(&[&one, &lines, "--kind", "solids"]);
    assert!(solids == 2.0 && (joined - 36.0 - 1.0 / 6.0).abs() < 1e-9);
    let output = measure(
        &["-", "--format", "stl", "--json"],
        tetrahedron(3.0, true).as_bytes(),
    );
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["volume"], 4.5);
    check_refused(
        &[&open],
        "",
        "open.stl: triangle 1: one of its edges has no triangle on its other side",
    );
    check_refused(
        &[&lines, "--format", "stl"],
        "",
        "neither a text nor a binary STL file",
    );
    check_refused(
        &[&one, "--kind", "cubes", "--edge", "1"],
        "",
        "an STL file is a solid; say --kind solids",
    );
    check_refused(
        &[&one, "--edge", "1"],
        "",
        "--edge and --anchor are for cubes",
    );
    check_refused(&[&one, &lines], "", "cubes are measured one file at a time");
    check_refused(
        &[&lines],
        "",
        "--edge is missing: cubes have one; --kind solids measures solids",
    );
    check_refused(
        &["-", "--kind", "solids", "--format", "csv"],
        "",
        "-: solids are in STL or NDJSON files",
    );
    check_refused(
        &["-", "--kind", "solids", "--steps-per-unit", "0"],
        "",
        "--steps-per-unit",
    );
}

#[test]
fn answers_are_for_machines_or_for_people() {
    let lines = format!("{SQUARE}\n{{\"shape\":\"t\",\"from\":[0,0,0],\"to\":[10,0,0]}}");
    let found = properties(&lines);
    assert_eq!(
        (&found["scene"], &found["seq"]),
        (&Value::Null, &Value::Null)
    );
    assert_eq!(
        found["bounds"],
        json!({"min": [-1.0, -1.0, 0.0], "max": [11.0, 1.0, 10.0]})
    );
    assert_eq!(found["centroid"], json!([5.0, 0.0, 5.0]));
    assert_eq!(
        found["exact"]["volume"]["value"],
        (240_000_000_000_i64 * 96).to_string()
    );
    assert_eq!(found["exact"]["steps_per_unit"], "1000");
    let output = measure(&["-", "--kind", "solids"], lines.as_bytes());
    let table = String::from_utf8(output.stdout).unwrap();
    for words in [
        "solids                1\n",
        "volume                240 unit^3\n",
        "area                  328 unit^2\n",
        "edge length           96 unit (convex 96, concave 0, crossing 0)\n",
        "centroid              5, 0, 5 unit\n",
        "rounded by at most    volume ",
        "cutters               their polygons reach at most 0.4",
    ] {
        assert!(table.contains(words), "no {words:?} in {table}");
    }
    for words in ["cubes", "vertices", "Euler"] {
        assert!(!table.contains(words), "{table}");
    }
}
