//! `union3d measure`: the files it reads, what it answers, and what it says about files it cannot read.

use std::path::Path;
use std::process::Output;

use serde_json::Value;

#[path = "oracle/program.rs"]
mod program;

use program::union3d;

fn measure(arguments: &[&str], input: &[u8]) -> Output {
    union3d(&[&["measure"], arguments].concat(), input)
}

/// The `mass_properties` of the input given on standard input.
#[track_caller]
fn properties(arguments: &[&str], input: &[u8]) -> Value {
    let output = measure(&[&["-", "--json"], arguments].concat(), input);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    assert_eq!(errors, "");
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

/// Cubes, volume, area and total edge length, in user units, of cubes of edge 1 on standard input.
#[track_caller]
fn check(input: impl AsRef<[u8]>, expected: [f64; 4]) {
    let found = properties(&["--edge", "1"], input.as_ref());
    let found = [
        &found["cubes"],
        &found["volume"],
        &found["area"],
        &found["edge_length"]["total"],
    ]
    .map(|value| value.as_f64().expect("a number"));
    assert_eq!(
        found,
        expected,
        "{}",
        String::from_utf8_lossy(input.as_ref())
    );
}

/// The input is refused with a message that has all these words.
#[track_caller]
fn check_refused(arguments: &[&str], input: impl AsRef<[u8]>, words: &[&str]) {
    let output = measure(arguments, input.as_ref());
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(
        !output.status.success(),
        "{}",
        String::from_utf8_lossy(input.as_ref())
    );
    assert_eq!(output.stdout, b"");
    for word in words {
        assert!(errors.contains(word), "no {word:?} in {errors:?}");
    }
}

const NOTHING: [f64; 4] = [0.0, 0.0, 0.0, 0.0];
const ONE: [f64; 4] = [1.0, 1.0, 6.0, 12.0];
const TWO_SHARING_A_FACE: [f64; 4] = [2.0, 2.0, 10.0, 16.0];

fn triplets(corners: &[[i32; 3]]) -> Vec<u8> {
    corners
        .iter()
        .flatten()
        .flat_map(|coordinate| coordinate.to_le_bytes())
        .collect()
}

#[test]
fn csv_is_read_with_and_without_ids_and_names() {
    check("0,0,0\n1,0,0\n", TWO_SHARING_A_FACE);
    check("0,0,0\r\n1,0,0", TWO_SHARING_A_FACE);
    check("x,y,z\n0,0,0\n1,0,0\n", TWO_SHARING_A_FACE);
    check("id,x,y,z\n7,0,0,0\n8,1,0,0\n", TWO_SHARING_A_FACE);
    check("7,0,0,0\n8,1,0,0\n", TWO_SHARING_A_FACE);
    check("Z, Y ,X,ID\n0,0,0,1\n0,0,1,2\n", TWO_SHARING_A_FACE);
    check("\u{feff}x,y,z\n0,0,0\n", ONE);
    check(
        "# a remark\n\n 0 , 0 , 0 \n\n1.0,0e0,-0\n",
        TWO_SHARING_A_FACE,
    );
    check("", NOTHING);
    check("x,y,z\n", NOTHING);
    // An id at the same place again is the same cube; two cubes at one place are two.
    check("5,0,0,0\n5,0,0,0\n", ONE);
    check("0,0,0\n0,0,0\n", [2.0, 1.0, 6.0, 12.0]);
    check("18446744073709551615,0,0,0\n0,1,0,0\n", TWO_SHARING_A_FACE);
}

#[test]
fn ndjson_is_read_bare_and_as_the_listing_prints_it() {
    check(
        "{\"id\":1,\"at\":[0,0,0]}\n{\"id\":2,\"at\":[1,0,0]}\n",
        TWO_SHARING_A_FACE,
    );
    check(
        "\n{\"at\":[0,0,0]}\n\n  {\"at\":[1,0,0]}",
        TWO_SHARING_A_FACE,
    );
    check(
        "{\"insert\":{\"id\":1,\"at\":[0,0,0]}}\n{\"insert\":{\"id\":2,\"at\":[1,0,0]}}\n",
        TWO_SHARING_A_FACE,
    );
    check(
        "{\"insert\":{\"id\":1,\"at\":[0,0,0]}}\n{\"insert\":{\"id\":2,\"at\":[9,0,0]}}\n{\"delete\":2}\n{\"delete\":3}\n",
        ONE,
    );
    check(
        "{\"insert\":{\"id\":1,\"at\":[0,0,0]}}\n{\"delete\":1}\n{\"insert\":{\"id\":1,\"at\":[5,0,0]}}\n",
        ONE,
    );
}

#[test]
fn triplets_are_steps() {
    check(triplets(&[[0, 0, 0], [1000, 0, 0]]), TWO_SHARING_A_FACE);
    check(triplets(&[[-1, -1, -1]]), ONE);
    // Printable bytes only: the name of the file decides.
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("cubes.i32");
    std::fs::write(&file, "0000000000001111111111112222").unwrap();
    check_refused(
        &[file.to_str().unwrap(), "--edge", "1"],
        "",
        &["cubes.i32: it ends 4 bytes into cube 3", "multiple of 12"],
    );
    std::fs::write(&file, "000000000000").unwrap();
    let output = measure(&[file.to_str().unwrap(), "--edge", "1", "--json"], b"");
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["exact"]["volume"], "1000000000");
    assert_eq!(found["bounds"]["min"][0], 808_464.432);
}

#[test]
fn names_and_options_decide_what_a_file_is() {
    let directory = tempfile::tempdir().unwrap();
    for (name, content) in [
        ("a.csv", "0,0,0\n1,0,0\n"),
        ("a.NDJSON", "{\"at\":[0,0,0]}\n{\"at\":[1,0,0]}\n"),
        ("a.jsonl", "{\"at\":[0,0,0]}\n{\"at\":[1,0,0]}\n"),
        ("a.txt", "0,0,0\n1,0,0\n"),
        ("a", "{\"at\":[0,0,0]}\n{\"at\":[1,0,0]}\n"),
    ] {
        let file = directory.path().join(name);
        std::fs::write(&file, content).unwrap();
        let output = measure(&[file.to_str().unwrap(), "--edge", "1", "--json"], b"");
        let found: Value = serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(found["volume"], 2.0, "{name}");
    }
    check_refused(
        &["-", "--edge", "1", "--format", "ndjson"],
        "0,0,0\n",
        &["line 1"],
    );
}

#[test]
fn coordinates_are_rounded_to_the_lattice_given() {
    let found = properties(
        &["--edge", "2", "--steps-per-unit", "10"],
        b"0.04,0.05,-0.05\n",
    );
    assert_eq!(found["bounds"]["min"], serde_json::json!([0.0, 0.1, -0.1]));
    assert_eq!(found["exact"]["volume"], "8000");
    let found = properties(&["--edge", "2", "--anchor", "center"], b"0,0,1\n");
    assert_eq!(found["bounds"]["min"], serde_json::json!([-1.0, -1.0, 0.0]));
}

#[test]
fn answers_are_for_machines_or_for_people() {
    let found = properties(&["--edge", "1"], b"0,0,0\n");
    assert_eq!(
        (&found["scene"], &found["seq"]),
        (&Value::Null, &Value::Null)
    );
    assert_eq!(found["exact"]["area"], "6000000");
    assert_eq!(found["euler_characteristic"], 1);
    let empty = properties(&["--edge", "1"], b"");
    assert_eq!(
        (&empty["centroid"], &empty["bounds"]),
        (&Value::Null, &Value::Null)
    );

    let output = measure(&["-", "--edge", "10"], b"0,0,0\n10,0,0\n");
    let table = String::from_utf8(output.stdout).unwrap();
    for words in [
        "cubes                 2\n",
        "2,000 unit^3",
        "1,000 unit^2",
        "160 unit (convex 160,",
        "0, 0, 0 to 20, 10, 10 unit",
    ] {
        assert!(table.contains(words), "no {words:?} in\n{table}");
    }
}

#[test]
fn bad_input_is_named_with_its_line_and_value() {
    for (input, words) in [
        (
            "0,0,0\n0,oops,0\n",
            &["line 2", "y = \"oops\" is not a number"][..],
        ),
        (
            "0,0,0\n\n0,0\n",
            &["line 3", "2 values, where the first line has 3"],
        ),
        ("0,0\n", &["line 1", "\"0,0\"", "x,y,z"]),
        ("a,b,c\n0,0,0\n", &["line 1", "\"a,b,c\""]),
        ("x,y,z,w\n0,0,0,0\n", &["line 1", "x,y,z,w"]),
        ("0 0 0\n", &["line 1", "commas"]),
        ("id,x,y,z\n-1,0,0,0\n", &["line 2", "id = \"-1\""]),
        ("id,x,y,z\n1.5,0,0,0\n", &["line 2", "id = \"1.5\""]),
        ("0,0,0\nNaN,0,0\n", &["line 2", "x = NaN"]),
        ("0,0,0\n0,0,inf\n", &["line 2", "z = inf"]),
        ("0,0,0\n0,2e6,0\n", &["line 2", "y = 2000000"]),
        (
            "1,0,0,0\n2,0,0,0\n1,5,0,0\n",
            &["line 3", "id 1 ", "another place"],
        ),
        (
            "{\"id\":1,\"at\":[0,0,0]}\n{\"id\":1,\"at\":[0,0,1]}\n",
            &["line 2", "id 1 "],
        ),
        (
            "{\"id\":1,\"at\":[0,0,0]}\n{\"at\":[0,0,1]}\n",
            &["line 2", "either every cube has an id, or none"],
        ),
        (
            "{\"id\":1,\"at\":[0,0]}\n",
            &["line 1", "{\"id\":1,\"at\":[0,0]}"],
        ),
        ("{\"id\":-1,\"at\":[0,0,0]}\n", &["line 1", "-1"]),
        (
            "{\"id\":1,\"at\":[0,0,0],\"edge\":3}\n",
            &["line 1", "edge"],
        ),
        ("{\"id\":1}\n", &["line 1", "at"]),
        ("{\"move\":1}\n", &["line 1", "move"]),
        ("{\"id\":1,\"at\":[0,0,0]\n", &["line 1"]),
        (
            "{\"at\":[0,0,0]}\n{\"at\":[1e300,0,0]}\n",
            &["line 2", "x = "],
        ),
    ] {
        check_refused(&["-", "--edge", "1"], input, words);
    }
    let far = [(1 << 30) - 999, 0, 0];
    check_refused(
        &["-", "--edge", "1"],
        triplets(&[[0, 0, 0], far]),
        &["cube 2", "x = 1073740825"],
    );
    check_refused(
        &["-", "--edge", "1"],
        &triplets(&[[0, 0, 0]])[..7],
        &["it ends 7 bytes into cube 1"],
    );
}

/// However long the file: cubes go to the engine many at a time, and are read beside.
#[test]
fn what_is_wrong_first_in_a_file_is_named() {
    let row = |id: u64| format!("{id},{id},0,0\n");
    let good: String = (0..200_000).map(row).collect();
    let conflict = "7,0,0,0\n";
    let faulty = "id\n";
    for (input, words) in [
        // The reader is done with the end before the engine looks at the conflict.
        (
            [&good, conflict, faulty].concat(),
            &["line 200001", "id 7 "],
        ),
        (
            [&good, faulty, conflict].concat(),
            &["line 200001", "1 values"],
        ),
        // The engine has refused a cube long before the reader is done.
        (
            [&row(7), conflict, &good, faulty].concat(),
            &["line 2:", "id 7 "],
        ),
    ] {
        check_refused(&["-", "--edge", "1"], input, words);
    }
}

#[test]
fn deletions_act_among_many_cubes_without_ids() {
    // The server's numbers begin at 1, and so do a file's.
    let mut input: String = (0..70_000)
        .map(|x| format!("{{\"at\":[{},0,0]}}\n", 2 * x))
        .collect();
    input += "{\"delete\":1}\n{\"at\":[-8,0,0]}\n{\"delete\":70000}\n{\"delete\":70001}\n{\"at\":[-4,0,0]}\n";
    check(input, [69_999.0, 69_999.0, 6.0 * 69_999.0, 12.0 * 69_999.0]);
}

/// A corner of the first cube reaches into the block, and half of the second.
#[test]
fn a_stock_is_measured_as_what_is_removed_and_what_remains() {
    let arguments = ["--edge", "2", "--stock", "1,1,1:5,5,5"];
    let cubes = "0,0,0\n4,2,2\n";
    let found = properties(&arguments, cubes.as_bytes());
    assert_eq!(found["volume"], 16.0);
    assert_eq!(found["removed"]["volume"], 5.0);
    assert_eq!(found["remaining"]["volume"], 59.0);
    assert_eq!(found["removed"]["area"], 6.0 + 16.0);
    let output = measure(&[&["-"], &arguments[..]].concat(), cubes.as_bytes());
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(
        table.contains("remaining             59 unit^3, area "),
        "{table}"
    );
    // The same bodies as solids.
    let solids = r#"{"hull":[[0,0,0],[2,0,0],[0,2,0],[2,2,0],[0,0,2],[2,0,2],[0,2,2],[2,2,2]]}
{"hull":[[4,2,2],[6,2,2],[4,4,2],[6,4,2],[4,2,4],[6,2,4],[4,4,4],[6,4,4]]}"#;
    let arguments = ["--kind", "solids", "--stock", "1,1,1:5,5,5"];
    let same = properties(&arguments, solids.as_bytes());
    for part in ["removed", "remaining"] {
        for measure in ["volume", "area", "mass", "centroid"] {
            assert_eq!(
                same[part][measure], found[part][measure],
                "{part} {measure}"
            );
        }
        assert_eq!(
            same[part]["edge_length"]["total"],
            found[part]["edge_length"]["total"]
        );
    }
    // Of a round bar: 128 sides, of the area of the circle.
    let bar = ["--kind", "solids", "--stock", "cylinder:0,0,0:10x4"];
    let found = properties(&bar, b"");
    let volume = found["remaining"]["volume"].as_f64().unwrap();
    assert!((volume / (25.0 * std::f64::consts::PI * 4.0) - 1.0).abs() < 1e-4);
    for (stock, words) in [
        ("0,0,0:1,1", "two corners"),
        ("0,0,0:1,0,1", "--stock"),
        ("cylinder:0,0,0:10x4", "a box only"),
    ] {
        check_refused(&["-", "--edge", "2", "--stock", stock], cubes, &[words]);
    }
}

#[test]
fn bad_arguments_are_named() {
    check_refused(&["-"], "", &["--edge"]);
    check_refused(&["-", "--edge", "0.0005"], "0,0,0\n", &["--edge", "0.0005"]);
    check_refused(&["-", "--edge", "0"], "0,0,0\n", &["--edge"]);
    check_refused(
        &["-", "--edge", "1", "--steps-per-unit", "0"],
        "0,0,0\n",
        &["--steps-per-unit"],
    );
    check_refused(
        &["no/such/file.csv", "--edge", "1"],
        "",
        &["no/such/file.csv"],
    );
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests");
    check_refused(
        &[directory.to_str().unwrap(), "--edge", "1"],
        "",
        &["is a directory"],
    );
}

#[test]
fn many_cubes_agree_with_a_formula() {
    // A staircase longer than one batch: each cube overlaps the next by half an edge.
    let count = 200_000_i32;
    let corners: Vec<_> = (0..count).map(|index| [index * 500, 0, 0]).collect();
    let found = properties(&["--edge", "1"], &triplets(&corners));
    assert_eq!(found["cubes"], count);
    assert_eq!(
        found["exact"]["volume"],
        ((i64::from(count) + 1) * 500 * 1_000_000).to_string()
    );
}
