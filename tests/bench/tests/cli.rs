//! Every benchmark in a tiny size gives its table and verifies itself; wrong arguments are refused.

use std::process::{Command, Output};

use serde_json::{Value, json};

fn bench(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_union3d-bench"))
        .args(arguments)
        .output()
        .expect("the binary runs")
}

#[track_caller]
fn success(arguments: &[&str]) -> String {
    let output = bench(arguments);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {errors}");
    String::from_utf8(output.stdout).unwrap()
}

/// The tables of a benchmark.
#[track_caller]
fn tables(arguments: &[&str]) -> Vec<Value> {
    let report: Value = serde_json::from_str(&success(&[arguments, &["--json"]].concat())).unwrap();
    assert!(report["machine"]["cores"].as_u64() > Some(0), "{report}");
    let command = report["machine"]["command"].as_str().unwrap();
    assert!(command.starts_with("union3d-bench "), "{command}");
    report["tables"].as_array().unwrap().clone()
}

fn rows(table: &Value) -> &[Value] {
    table["rows"].as_array().unwrap()
}

/// Every figure under these keys is there and above zero.
#[track_caller]
fn check_figures(table: &Value, keys: &[&str]) {
    assert!(!rows(table).is_empty(), "{table}");
    for row in rows(table) {
        for key in keys {
            assert!(row[key].as_f64() > Some(0.0), "{key} of {row}");
        }
    }
}

#[track_caller]
fn check_refused(arguments: &[&str], words: &[&str]) {
    let output = bench(arguments);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success(), "{arguments:?}");
    for word in words {
        assert!(errors.contains(word), "no {word:?} in: {errors}");
    }
    assert_eq!(String::from_utf8_lossy(&output.stdout), "");
}

#[test]
fn the_engine_is_measured_on_every_workload() {
    let found = tables(&["engine", "--cubes", "300", "--runs", "1"]);
    let [single, batched] = found.as_slice() else {
        panic!("two tables, not {found:?}");
    };
    let latencies = ["p50_us", "p99_us", "p999_us", "max_us"];
    check_figures(single, &latencies);
    check_figures(
        single,
        &["million_per_second", "times_bare", "times_hash_map"],
    );
    check_figures(
        batched,
        &[
            "insert_1_million_per_second",
            "delete_1000000_million_per_second",
        ],
    );
    for name in [
        "rho-0.015",
        "rho-1000",
        "raster",
        "line",
        "pocket",
        "cluster",
        "plane",
        "bin",
    ] {
        let of = |table: &Value| {
            rows(table)
                .iter()
                .filter(|row| row["workload"] == name)
                .count()
        };
        assert_eq!(of(single), 4, "operations on {name}");
        assert_eq!(of(batched), 2, "numbers of threads on {name}");
    }
}

#[test]
fn the_same_figures_are_a_table_for_people() {
    let text = success(&[
        "engine",
        "--cubes",
        "200",
        "--runs",
        "1",
        "--workload",
        "rho-1",
    ]);
    let cells = |line: &str| -> Vec<String> {
        let cells = line.trim_matches('|').split('|');
        cells.map(|cell| cell.trim().to_owned()).collect()
    };
    let found: Vec<Vec<String>> = text.lines().map(cells).collect();
    let starts = |wanted: &[&str]| {
        found.iter().any(|cells| {
            cells.starts_with(
                &wanted
                    .iter()
                    .map(|&cell| cell.to_owned())
                    .collect::<Vec<_>>(),
            )
        })
    };
    assert!(starts(&["workload", "cubes", "operation", "M/s"]), "{text}");
    assert!(starts(&["rho-1", "200", "delete oldest"]), "{text}");
    assert!(text.contains("union3d-bench engine --cubes 200"), "{text}");
}

/// A row of cubes that overlap, as `union3d mill --out` writes them.
fn row(cubes: i32) -> Vec<u8> {
    let corners = (0..cubes).flat_map(|number| [number, 0, 0]);
    corners.flat_map(i32::to_le_bytes).collect()
}

#[test]
fn a_file_of_cubes_is_measured_by_name() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("path.i32");
    std::fs::write(&file, row(100)).unwrap();
    let name = file.to_str().unwrap();
    let found = tables(&["engine", "--file", name, "--edge", "30", "--runs", "1"]);
    check_figures(&found[0], &["million_per_second"]);
    assert_eq!(rows(&found[0])[0]["workload"], "path.i32");
    // The last fifth follows.
    assert_eq!(rows(&found[0])[0]["cubes"], 80);
}

#[test]
fn flatness_is_a_table_of_its_own() {
    let found = tables(&["engine", "--cubes", "200", "--turnovers", "20"]);
    check_figures(&found[0], &["delete_million_per_second", "bytes_per_cube"]);
    let turnovers: Vec<&str> = rows(&found[0])
        .iter()
        .map(|row| row["turnovers"].as_str().unwrap())
        .collect();
    assert_eq!(turnovers.len(), 11);
    assert_eq!(
        [turnovers[0], turnovers[9], turnovers[10]],
        ["1 to 2", "19 to 20", "fresh"]
    );

    let found = tables(&[
        "engine",
        "--sizes",
        "100,1k",
        "--runs",
        "1",
        "--workload",
        "rho-1",
    ]);
    check_figures(&found[0], &["insert_ns", "delete_times_first"]);
    let sizes: Vec<u64> = rows(&found[0])
        .iter()
        .map(|row| row["cubes"].as_u64().unwrap())
        .collect();
    assert_eq!(sizes, [100, 1000]);
}

#[test]
fn bins_are_plotted() {
    let directory = tempfile::tempdir().unwrap();
    let plot = directory.path().join("bins.svg");
    let plot_name = plot.to_str().unwrap();
    let found = tables(&[
        "engine",
        "--cubes",
        "200",
        "--runs",
        "1",
        "--workload",
        "rho-1",
        "--bins",
        plot_name,
    ]);
    check_figures(&found[0], &["insert_and_delete_us", "times_own_choice"]);
    let svg = std::fs::read_to_string(plot).unwrap();
    assert!(svg.starts_with("<svg "), "{svg}");
    assert!(svg.trim_end().ends_with("</svg>"), "{svg}");
    assert!(svg.contains("rho-1"), "{svg}");
}

#[test]
fn the_papers_table_agrees_with_its_expectation() {
    let found = tables(&["union3", "--cubes", "100k"]);
    let [times, table] = found.as_slice() else {
        panic!("two tables, not {found:?}");
    };
    check_figures(times, &["seconds", "bytes_per_cube", "peak_gib"]);
    assert_eq!(rows(times).len(), 3);
    check_figures(table, &["formula", "expected", "found", "standard_error"]);
    assert_eq!(rows(table).len(), 6);
    for row in rows(table) {
        assert_eq!(row["verdict"], "as expected", "{row}");
        assert_eq!(
            row["printed"],
            Value::Null,
            "printed for 20,000,000 cubes only"
        );
    }
}

#[test]
fn a_real_server_is_measured() {
    // It is the program beside this one: `cargo test --workspace` builds both.
    let data = tempfile::tempdir().unwrap();
    let found = tables(&[
        "service",
        "--data",
        data.path().to_str().unwrap(),
        "--seconds",
        "0.05",
        "--runs",
        "1",
        "--batch",
        "1,50",
        "--clients",
        "1,3",
        "--cubes",
        "500",
        "--large",
        "500",
    ]);
    let [changes, queries, large, restart] = found.as_slice() else {
        panic!("four tables, not {found:?}");
    };
    check_figures(changes, &["bodies_per_second", "p50_ms", "max_ms"]);
    assert_eq!(rows(changes).len(), 4 * 2 * 2);
    check_figures(queries, &["queries_per_second", "p99_ms"]);
    check_figures(large, &["changes_per_second", "p99_ms"]);
    assert_eq!(rows(large).len(), 3);
    check_figures(restart, &["value"]);
    let nothing_left = std::fs::read_dir(data.path()).unwrap().count();
    assert_eq!(nothing_left, 0, "the data directory is gone");
}

#[test]
fn a_real_server_is_measured_with_solids() {
    let data = tempfile::tempdir().unwrap();
    let directory = data.path().join("data");
    std::fs::create_dir(&directory).unwrap();
    let arguments = |more: &[&'static str]| -> Vec<String> {
        let common = [
            "service", "--kind", "solids", "--runs", "1", "--solids", "40",
        ];
        let place = ["--data", directory.to_str().unwrap()];
        let all = [&common[..], &place, more].concat();
        all.into_iter().map(str::to_owned).collect()
    };
    let measured =
        |arguments: &[String]| tables(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    let found = measured(&arguments(&[
        "--seconds",
        "0.05",
        "--batch",
        "1,7",
        "--clients",
        "1,2",
    ]));
    let [changes, restart] = found.as_slice() else {
        panic!("two tables, not {found:?}");
    };
    check_figures(changes, &["bodies_per_second", "p50_ms", "p999_ms"]);
    assert_eq!(rows(changes).len(), 4 * 2 * 2);
    check_figures(restart, &["value"]);

    // A program is sent whole, as often as it takes; here into a depth of 1 mm, and an arc.
    let program = data.path().join("part.nc");
    std::fs::write(
        &program,
        "G21 G90 F100\nG0 X0 Y0 Z1\nG1 Z-1\nG1 X9\nG2 X13 Y4 I0 J4\nG0 Z1\n",
    )
    .unwrap();
    let mut arguments = arguments(&[
        "--protocol",
        "ndjson,grpc",
        "--batch",
        "5",
        "--clients",
        "1",
    ]);
    arguments.extend(["--program".to_owned(), program.to_str().unwrap().to_owned()]);
    let found = measured(&arguments);
    check_figures(&found[0], &["bodies_per_second"]);
    assert_eq!(rows(&found[0]).len(), 2);
    let unit = |row: &Value| row["unit"] == "solids/s";
    assert!(rows(&found[1]).iter().any(unit), "{found:?}");
    let nothing_left = std::fs::read_dir(&directory).unwrap().count();
    assert_eq!(nothing_left, 0, "the data directory is gone");
}

#[test]
fn solids_are_measured_set_by_set() {
    let found = tables(&["solids", "--solids", "30", "--deletions", "5"]);
    check_figures(&found[0], &["insert_p50_us", "delete_p99_us", "batch_2_s"]);
    assert_eq!(rows(&found[0]).len(), 4);
    let found = tables(&[
        "solids",
        "--set",
        "dome",
        "--solids",
        "20",
        "--deletions",
        "5",
    ]);
    assert_eq!(rows(&found[0])[0]["workload"], "dome of capsules");
}

#[test]
fn peers_get_figures_and_measures_of_solids() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("solids.ndjson");
    let name = file.to_str().unwrap();
    // Two cubes of edge 2 that overlap by half, and one apart.
    let cube = |x: i64| {
        let corner = |number: i64| [x + 2 * (number & 1), number & 2, (number & 4) / 2];
        json!({"hull": (0..8).map(corner).collect::<Vec<_>>()})
    };
    std::fs::write(&file, format!("{}\n{}\n{}\n", cube(0), cube(1), cube(10))).unwrap();
    let measured = || -> Value {
        serde_json::from_str(&success(&["peers", "--solids", name, "--runs", "1"])).unwrap()
    };
    let answer = measured();
    assert_eq!(answer["bodies"], 3);
    assert_eq!(answer["volume"], 20.0);
    assert_eq!(answer["area"], 56.0);
    for key in ["batch", "insert", "inserts", "deletes"] {
        assert!(
            answer[format!("{key}_seconds")].as_f64() > Some(0.0),
            "{answer}"
        );
    }
    // A set that is printed is read again; 20 boxes of 8 mm^3 cover each point once on average.
    for set in ["boxes", "flat", "ball", "dome"] {
        let printed = success(&["hulls", "--set", set, "--solids", "20"]);
        std::fs::write(&file, printed).unwrap();
        let answer = measured();
        assert_eq!(answer["bodies"], 20, "{set}");
        assert!(answer["volume"].as_f64() > Some(1e12), "{set}: {answer}");
    }
    std::fs::write(&file, "{\"hull\":[[0,0,0]]}\n").unwrap();
    check_refused(&["peers", "--solids", name], &["solids.ndjson:1"]);
}

#[test]
fn peers_get_figures_and_measures_of_a_file() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("cubes.i32");
    // Two cubes of edge 2 that overlap by half, and one apart.
    let corners: [i32; 9] = [0, 0, 0, 1, 0, 0, 10, 10, 10];
    let bytes: Vec<u8> = corners
        .iter()
        .flat_map(|number| number.to_le_bytes())
        .collect();
    std::fs::write(&file, bytes).unwrap();
    let name = file.to_str().unwrap();
    let answer: Value =
        serde_json::from_str(&success(&["peers", "--cubes", name, "--edge", "2"])).unwrap();
    assert_eq!(answer["bodies"], 3);
    assert_eq!(answer["volume"], 20.0);
    assert_eq!(answer["area"], 56.0);
    assert!(answer["batch_seconds"].as_f64() > Some(0.0));
    assert!(answer["insert_seconds"].as_f64() > Some(0.0));
    std::fs::write(&file, [0; 13]).unwrap();
    check_refused(
        &["peers", "--cubes", name, "--edge", "2"],
        &["13 bytes", "cubes.i32"],
    );
}

#[test]
fn a_fixed_piece_of_work_ends_where_it_is_told() {
    for (until, left) in [("made", "0"), ("inserted", "100"), ("deleted", "0")] {
        let work = [
            "count",
            "--workload",
            "raster",
            "--cubes",
            "100",
            "--until",
            until,
        ];
        assert_eq!(success(&work).trim(), left, "{until}");
    }
}

#[test]
fn wrong_arguments_are_refused() {
    check_refused(&["engine", "--cubes", "0"], &["--cubes", "more than 0"]);
    check_refused(&["engine", "--cubes", "1.5M"], &["--cubes", "whole number"]);
    check_refused(&["engine", "--workload", "rho-2"], &["rho-2", "rho-0.015"]);
    check_refused(&["engine", "--file", "part.i32"], &["--edge"]);
    check_refused(
        &["engine", "--file", "no-such-file.i32", "--edge", "3"],
        &["no-such-file.i32"],
    );
    check_refused(
        &["engine", "--turnovers", "2", "--sizes", "1k"],
        &["--turnovers", "--sizes"],
    );
    check_refused(&["union3", "--runs", "0"], &["--runs"]);
    check_refused(&["service", "--seconds", "0"], &["--seconds", "0.001"]);
    check_refused(&["service", "--large", "2M"], &["--large", "1000000"]);
    check_refused(
        &["service", "--data", "no/such/directory"],
        &["no/such/directory"],
    );
    let data = tempfile::tempdir().unwrap();
    let data = data.path().to_str().unwrap();
    let program = "no/such/program";
    check_refused(
        &["service", "--data", data, "--server", program],
        &[program],
    );
    for (kind, other) in [
        ("cubes", ["--program", "part.nc"]),
        ("cubes", ["--solids", "9"]),
        ("solids", ["--cubes", "9"]),
        ("solids", ["--part", "large"]),
    ] {
        let arguments = [&["service", "--kind", kind], &other[..]].concat();
        check_refused(&arguments, &[other[0], kind]);
    }
    check_refused(&["peers"], &["--cubes", "--solids"]);
}
