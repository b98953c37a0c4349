//! `union3d mill` with tools of their own shapes: volumes against closed formulas, what is hit, and where tools come from.

use std::f64::consts::PI;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::Value;

#[path = "oracle/program.rs"]
mod program;

use program::union3d;

fn run(arguments: &[&str], program: &str) -> Output {
    union3d(&[&["mill", "-"], arguments].concat(), program)
}

/// What `--json` says of a program.
#[track_caller]
fn mill(arguments: &[&str], program: &str) -> Value {
    let output = run(&[arguments, &["--json"]].concat(), program);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{program}: {errors}");
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

#[track_caller]
fn check_refused(arguments: &[&str], program: &str, words: &[&str]) {
    let output = run(arguments, program);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{program}: {errors}");
    assert_eq!(output.stdout, b"", "{program}");
    for word in words {
        assert!(errors.contains(word), "no {word:?} in {errors:?}");
    }
}

fn removed(milled: &Value) -> f64 {
    milled["cutting"]["volume_removed"].as_f64().unwrap()
}

/// Lines that cut air.
fn air(milled: &Value) -> Vec<u64> {
    let lines = milled["cutting"]["air_cuts"]["lines"].as_array().unwrap();
    lines.iter().map(|line| line.as_u64().unwrap()).collect()
}

/// Lines of a list of hits, with their volumes.
fn hits(milled: &Value, list: &str) -> Vec<(u64, f64)> {
    let lines = milled["cutting"][list]["lines"].as_array().unwrap();
    let hit = |hit: &Value| {
        (
            hit["line"].as_u64().unwrap(),
            hit["volume"].as_f64().unwrap(),
        )
    };
    lines.iter().map(hit).collect()
}

const STOCK: &str = "--stock=-20,-20,-10:40,40,0";

/// 3 mm deep into the stock, without moving sideways.
const PLUNGE: &str = "G21 G90\nG0 X0 Y0 Z5\nG1 Z-3 F100\nG0 Z5\nM2\n";

#[track_caller]
fn check_plunge(tool: &str, expected: f64) {
    // Fine polygons: with 256 sides and 1 / 100,000 mm, what is left is that of the 8 rings of round ends.
    let fine = ["--sides", "256", "--steps-per-unit", "10000"];
    let milled = mill(&[&["--tool", tool, STOCK], &fine[..]].concat(), PLUNGE);
    let found = removed(&milled);
    let rounding = milled["rounding"]["outside"].as_f64().unwrap();
    let inside = milled["rounding"]["inside"].as_f64().unwrap();
    // The surface within the stock is at most that of the cylinder around it, 4 pi 3 + 4 pi; each is off by no more than the rounding.
    let most = (4.0 * PI * 3.0 + 4.0 * PI) * rounding.max(inside);
    assert!(
        (found - expected).abs() <= most && most < 0.6,
        "{tool}: {found} instead of {expected}, at most {most} off"
    );
}

#[test]
fn every_kind_of_tool_removes_its_own_volume() {
    check_plunge("flat:4", 12.0 * PI);
    // Half a sphere and a cylinder 1 high.
    check_plunge("ball:4", 2.0 / 3.0 * PI * 8.0 + 4.0 * PI);
    // A cylinder less the ring outside of its corner: by Pappus, for R = 2, r = 1 (area 1 - pi/4 at 1 + (1/2 + 1/6...)).
    let (inner, corner) = (1.0, 1.0);
    let rounded = PI * inner * inner * corner
        + PI * PI / 2.0 * inner * corner * corner
        + 2.0 / 3.0 * PI * corner * corner * corner;
    check_plunge("bull:4,corner=1", rounded + 4.0 * PI * 2.0);
    // A whole angle of 90 degrees: as high as its radius.
    check_plunge("vee:4,angle=90", PI * 8.0 / 3.0 + 4.0 * PI);
    check_plunge(
        "vee:4,angle=90,tip=2",
        PI / 3.0 * (4.0 + 2.0 + 1.0) + 4.0 * PI * 2.0,
    );
    let point = 2.0 / 59.0_f64.to_radians().tan();
    check_plunge("drill:4", PI * 4.0 * point / 3.0 + 4.0 * PI * (3.0 - point));
    let side = 0.5 / 10.0_f64.to_radians().tan();
    check_plunge(
        "tapered:4,angle=10,tip=3",
        PI * side / 3.0 * (4.0 + 3.0 + 2.25) + 4.0 * PI * (3.0 - side),
    );
    // A cone, a step, and a disc.
    check_plunge("form:0x0/2x1/4x1/4x5", PI / 3.0 + 4.0 * PI * 2.0);
}

#[test]
fn what_is_cut_twice_is_removed_once() {
    // Along a slanted line and back over places in between, at the feed and fast.
    let program =
        "G21 G90\nG0 X0 Y0 Z5\nG1 Z-1 F100\nX30 Y17\nX9.63 Y5.457\nX0 Y0\nG0 X30 Y17\nG0 Z5\nM2\n";
    let milled = mill(&["--tool", "flat:2", STOCK], program);
    // Within half a step of the line, the way back over (9.63, 5.457) may leave it: by less than that times its length.
    assert!(air(&milled).iter().all(|line| [5, 6].contains(line)));
    assert!(
        hits(&milled, "rapid_cuts")
            .iter()
            .all(|(_, volume)| *volume < 0.0005 * 35.0)
    );
    let exact = mill(
        &["--tool", "flat:2", STOCK],
        "G21 G90\nG0 X0 Y0 Z5\nG1 Z-1 F100\nX30 Y18\nX10 Y6\nX0 Y0\nG0 X30 Y18\nG0 Z5\nM2\n",
    );
    assert_eq!(air(&exact), [5, 6]);
    assert_eq!(hits(&exact, "rapid_cuts"), []);
    // A ball the same, down a ramp and up again.
    let ramp = mill(
        &["--tool", "ball:4", STOCK],
        "G21 G90\nG0 X0 Y0 Z0\nG1 X20 Y10 Z-5 F100\nX0 Y0 Z0\nM2\n",
    );
    assert_eq!(air(&ramp), [4]);
}

#[test]
fn an_arc_on_another_cuts_air() {
    let program = "G21 G90\nG0 X10 Y0 Z5\nG1 Z-1 F100\nG2 X10 Y0 I-10 J0\nG2 X0 Y-10 I-10\nG3 X10 Y0 J10\nG3 X-10 Y0 I-10\nG0 Z5\nM2\n";
    let milled = mill(&["--tool", "flat:2", STOCK], program);
    assert_eq!(air(&milled), [5, 6, 7]);
    let ring = PI * (121.0 - 81.0);
    assert!((removed(&milled) - ring).abs() < ring * 0.01, "{milled}");
    // Helices too: one round down, and up the same way.
    let helix = mill(
        &["--tool", "ball:2", STOCK],
        "G21 G90\nG0 X10 Y0 Z0\nG2 X10 Y0 Z-4 I-10 F100\nG3 X10 Y0 Z0 I-10\nM2\n",
    );
    assert_eq!(air(&helix), [4]);
}

#[test]
fn a_slot_is_a_slot() {
    // 20 long and 2 deep, with a half circle at both ends. The polygon of 32 sides is a little narrower than the circle.
    let program = "G21 G90\nG0 X0 Y0 Z5\nG1 Z-2 F120\nX20\nG0 Z5\nM2\n";
    let milled = mill(&["--tool", "flat:6,length=20", STOCK], program);
    let exact = 2.0 * (20.0 * 6.0 + 9.0 * PI);
    let inside = milled["rounding"]["inside"].as_f64().unwrap();
    assert!(
        (removed(&milled) - exact).abs() < 2.0 * 60.0 * inside,
        "{milled}"
    );
    // The same deep in the stock and not out of it: the flutes end 4 mm above the tip, in material that is only there at the sides.
    let buried = mill(
        &["--tool", "flat:6,flutes=4,length=20,shank=5", STOCK],
        "G21 G90\nG0 X0 Y0 Z5\nG1 Z-8 F120\nX20\nG0 Z5\nM2\n",
    );
    let long = mill(
        &["--tool", "flat:6,length=20", STOCK],
        "G21 G90\nG0 X0 Y0 Z5\nG1 Z-8 F120\nX20\nG0 Z5\nM2\n",
    );
    let (short, long) = (removed(&buried), removed(&long));
    // The plunge and the rapid back up clear whole holes; between them the slot is 4 high, and the shank hits what is above it.
    let above = 4.0 * (120.0 - 9.0 * PI);
    assert!((long - short - above).abs() < 3.0, "{long} {short} {above}");
    let shank = hits(&buried, "shank_or_holder");
    assert_eq!(shank.len(), 1, "{shank:?}");
    assert_eq!(shank[0].0, 4);
}

#[test]
fn holders_and_rapids_that_hit_are_collisions() {
    let deep = "G21 G90\nG0 X0 Y0 Z25\nG1 Z-8 F100\nX10\nG0 Z25\nM2\n";
    // 10 mm out of a holder that is 20 wide: at Z-8 the holder is 2 above the stock.
    let free = mill(&["--tool", "flat:4,length=10,holder=20x30", STOCK], deep);
    assert_eq!(hits(&free, "shank_or_holder"), []);
    // 7 mm: it is 1 deep in the stock, a disc that grows to a slot, less what the flutes have removed.
    let arguments = ["--tool", "flat:4,length=7,holder=20x30", STOCK];
    let hit = mill(&arguments, deep);
    let found = hits(&hit, "shank_or_holder");
    assert_eq!(found.iter().map(|hit| hit.0).collect::<Vec<_>>(), [3, 4, 5]);
    let disc = PI * (100.0 - 4.0);
    assert!((found[0].1 - disc).abs() < 2.0, "{found:?}");
    // The holder removes nothing.
    let bare = mill(&["--tool", "flat:4,length=7", STOCK], deep);
    assert_eq!(removed(&bare).to_bits(), removed(&hit).to_bits());
    let failing = [&arguments[..], &["--fail-on-collision"]].concat();
    assert_eq!(run(&failing, deep).status.code(), Some(3));
    let least = [&failing[..], &["--least-volume", "10000"]].concat();
    assert_eq!(run(&least, deep).status.code(), Some(0));

    let plough = "G21 G90\nG0 X0 Y0 Z5\nG1 Z-2 F100\nG0 X20\nG0 Z5\nM2\n";
    let milled = mill(&["--tool", "flat:4", STOCK], plough);
    let found = hits(&milled, "rapid_cuts");
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].0, 4);
    assert!((found[0].1 - 160.0).abs() < 1.0, "{found:?}");
    let failing = ["--tool", "flat:4", STOCK, "--fail-on-collision"];
    assert_eq!(run(&failing, plough).status.code(), Some(3));
}

#[test]
fn each_tool_cuts_with_its_own_shape() {
    let program = "G21 G90\nM6 T1\nG0 X0 Y0 Z5\nG1 Z-2 F100\nX20\nG0 Z5\nM6 T2\nG0 X0 Y20\nG1 Z-2\nX20\nG0 Z5\nM2\n";
    let milled = mill(
        &["--tool", "T1=flat:4", "--tool", "T2=flat:2", STOCK],
        program,
    );
    let tools = milled["cutting"]["tools"].as_array().unwrap();
    // Before the first change there is tool 0, which does nothing here.
    let volume = |tool: u64| {
        let found = tools.iter().find(|found| found["tool"] == tool).unwrap();
        found["volume_removed"].as_f64().unwrap()
    };
    assert!((volume(1) - 2.0 * (80.0 + 4.0 * PI)).abs() < 1.0);
    assert!((volume(2) - 2.0 * (40.0 + PI)).abs() < 0.5);
    assert!((volume(1) + volume(2) - removed(&milled)).abs() < 1e-9);
    check_refused(
        &["--tool", "T1=flat:4", STOCK],
        program,
        &["line 9", "tool 2 cuts here", "--tool T2="],
    );
    check_refused(&[STOCK], PLUNGE, &["line 3", "tool 0", "--tool flat:6"]);
    // Without a stock what the flutes sweep is measured, so they must have a length.
    check_refused(&["--tool", "flat:4"], PLUNGE, &["line 3", "length"]);
    let swept = mill(&["--tool", "flat:4,length=10"], PLUNGE);
    assert!((removed(&swept) - 4.0 * PI * 18.0).abs() < 0.5, "{swept}");
}

#[test]
fn tools_are_in_the_unit_of_the_scene_unless_said() {
    let inch = ["--unit", "inch", "--stock=-1,-1,-1:1,1,0"];
    let program = "G20 G90\nG0 X0 Y0 Z0.5\nG1 Z-0.25 F10\nM2\n";
    let volume = |options: &[&str]| removed(&mill(&[&inch, options].concat(), program));
    let inches = volume(&["--tool", "flat:0.5"]);
    assert!((inches - PI / 64.0).abs() < 1e-4, "{inches}");
    let mm = volume(&["--tool", "flat:12.7", "--tools-unit", "mm"]);
    assert_eq!(mm.to_bits(), inches.to_bits());
}

#[test]
fn the_stock_may_be_round_or_a_hull() {
    for (stock, volume) in [
        ("cylinder:0,0,-10:20x10", 1000.0 * PI),
        ("hull:-10,-10,0:10,-10,0:0,20,0:0,0,-30", 3000.0),
        ("-10,-10,-10:10,10,0", 4000.0),
    ] {
        let milled = mill(&["--tool", "flat:4", &format!("--stock={stock}")], PLUNGE);
        let remaining = milled["remaining"]["volume"].as_f64().unwrap();
        let whole = removed(&milled) + remaining;
        assert!((whole - volume).abs() < 0.01 * volume, "{stock}: {whole}");
        assert!((removed(&milled) - 12.0 * PI).abs() < 0.1, "{stock}");
    }
    check_refused(
        &["--tool", "flat:4", "--stock=0,0,0:1,1,0"],
        PLUNGE,
        &["--stock", "/max/2 = 0 is not above"],
    );
    check_refused(
        &["--edge", "4", "--stock", "cylinder:0,0,-10:20x10"],
        PLUNGE,
        &["--stock", "box"],
    );
}

#[test]
fn a_ramp_from_above_cuts_from_where_it_enters() {
    // From 10 above to 10 below over 20: the tip enters in the middle. The slot's depth grows from 0 to 10 over the second half.
    let milled = mill(
        &["--tool", "flat:2", STOCK],
        "G21 G90\nG0 X0 Y0 Z10\nG1 X20 Z-10 F100\nM2\n",
    );
    let wedge = 2.0 * 10.0 * 10.0 / 2.0;
    // Where the tool is c wide to both sides along the way, it is as deep as its front, and full depth goes on by 2 c: 20 c more.
    let round = 20.0 * PI / 2.0;
    assert!((removed(&milled) - wedge - round).abs() < 0.5, "{milled}");
}

#[test]
fn rows_add_up_and_warnings_follow() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("lines.csv");
    let program = "(T1 D=4. CR=0. - ZMIN=-2. - flat end mill)\nG21 G90\nT1 M6\nG0 X0 Y0 Z5\nG81 X0 Y0 Z-4 R2 F120\nX10\nG80\nG4 P2\nM2\n";
    let milled = mill(&[STOCK, "--csv", file.to_str().unwrap()], program);
    let warnings = milled["warnings"].as_array().unwrap();
    assert_eq!(warnings[0]["code"], "tool-comment");
    assert_eq!(warnings[0]["line"], 1);
    let text = std::fs::read_to_string(file).unwrap();
    let rows: Vec<Vec<&str>> = text.lines().map(|row| row.split(',').collect()).collect();
    assert_eq!(
        rows[0],
        [
            "line",
            "motion",
            "solids",
            "duration",
            "volume_removed",
            "removal_rate",
            "total_removed",
            "area",
            "warning",
            "tool",
            "shank_or_holder",
            "contact_area"
        ]
    );
    let sum: f64 = rows[1..]
        .iter()
        .filter_map(|row| row[4].parse::<f64>().ok())
        .sum();
    assert!((sum - removed(&milled)).abs() < 1e-9, "{text}");
    assert!((sum - 2.0 * 16.0 * PI).abs() < 0.3, "{text}");
    let motions: Vec<&str> = rows[1..].iter().map(|row| row[1]).collect();
    assert_eq!(motions.last(), Some(&"warning"), "{text}");
    assert!(motions.contains(&"dwell"), "{text}");
    check_refused(&[STOCK, "--strict"], program, &["tool-comment"]);
}

/// The stock that comments say is the one that `--stock` would be, and the line is told; what is not all of it, or contradicts, is told and not taken.
#[test]
fn the_stock_is_found_in_comments() {
    let slot = "G21 G90\nG0 X0 Y0 Z5\nG1 Z-3 F100\nX20\nG0 X0\nG0 Z5\nM2\n";
    let said = format!(
        "(Design File: slot.c2d)\n(stockMin:-20.00mm, -20.00mm, -10.00mm)\n(stockMax:40.00mm, 40.00mm, 0.00mm)\n{slot}"
    );
    let tool = ["--tool", "flat:4"];
    let found = mill(&tool, &said);
    let given = mill(&[&tool[..], &[STOCK]].concat(), slot);
    assert_eq!(found["remaining"], given["remaining"]);
    assert!(
        found["remaining"]["volume"]
            .as_f64()
            .is_some_and(|volume| volume > 30_000.0)
    );
    let warnings = |milled: &Value| {
        let warnings = milled["warnings"].as_array().unwrap().iter();
        let stock = warnings.filter(|warning| warning["code"] == "stock-comment");
        stock
            .map(|warning| {
                (
                    warning["line"].as_u64().unwrap(),
                    warning["text"].as_str().unwrap().to_owned(),
                )
            })
            .collect::<Vec<_>>()
    };
    let told = warnings(&found);
    assert_eq!(told.len(), 1, "{told:?}");
    assert_eq!(told[0].0, 2);
    assert!(
        told[0]
            .1
            .contains("--stock -20.0,-20.0,-10.0:40.0,40.0,0.0"),
        "{told:?}"
    );
    check_refused(
        &[&tool[..], &["--strict"]].concat(),
        &said,
        &["stock-comment", "line 2"],
    );
    // In inches, of a program in millimetres.
    let inches = ["--tool", "flat:0.157", "--unit", "inch"];
    let bounds = mill(
        &inches,
        &said.replace("40.00mm, 40.00mm", "50.80mm, 50.80mm"),
    );
    assert!(warnings(&bounds)[0].1.contains(":2.0,2.0,0.0"), "{bounds}");
    // The other way round, without the digits that a product of floats has.
    let half =
        "(STOCK/BLOCK, 3, 3, 0.4, 1.5, 1.5, 0.4)\nG20 G90\nG0 X0 Y0 Z1\nG1 Z-0.1 F5\nG0 Z1\nM2\n";
    let told = warnings(&mill(&tool, half));
    assert!(
        told[0]
            .1
            .contains("--stock -38.1,-38.1,-10.16:38.1,38.1,0.0"),
        "{told:?}"
    );
    // What is given goes before what is said, and none is none.
    let small = mill(
        &[&tool[..], &["--stock=-20,-20,-10:10,40,0"]].concat(),
        &said,
    );
    assert!(removed(&small) < 0.7 * removed(&found), "{small}");
    assert_eq!(warnings(&small), []);
    let none = mill(&["--tool", "flat:4,length=20", "--stock", "none"], &said);
    assert!(
        none["remaining"].is_null() && warnings(&none).is_empty(),
        "{none}"
    );
    // Two that contradict each other are none.
    let contradicting = format!("(STOCK/BLOCK, 60, 60, 9, 20, 20, 9)\n{said}");
    let unknown = mill(&["--tool", "flat:4,length=20"], &contradicting);
    assert!(unknown["remaining"].is_null(), "{unknown}");
    assert!(
        warnings(&unknown)[0].1.contains("another stock"),
        "{unknown}"
    );
    check_refused(
        &["--tool", "flat:4,length=20", "--fail-on-collision"],
        &contradicting,
        &["--fail-on-collision", "--stock"],
    );
    assert_eq!(
        run(&[&tool[..], &["--fail-on-collision"]].concat(), &said)
            .status
            .code(),
        Some(0)
    );
}

/// A carriage return before the line feed is no line of its own.
#[test]
fn comments_stand_on_the_lines_that_editors_count() {
    let program = "G21 G90\r\n(T1 D=4. CR=0. - flat end mill)\r\nT1 M6\r\nG0 X0 Y0 Z5\r\nG1 Z-3 F100\r\nG0 Z5\r\nM2\r\n";
    let milled = mill(&[STOCK], program);
    assert_eq!(milled["warnings"][0]["line"], 2, "{milled}");
}

/// The area of contact of each line that has one, by its row of --csv; empty cells are none.
fn contacts(arguments: &[&str], program: &str) -> (Value, Vec<(u64, Option<f64>)>) {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("lines.csv");
    let own = ["--contact", "--csv", file.to_str().unwrap()];
    let milled = mill(&[arguments, &own].concat(), program);
    let text = std::fs::read_to_string(file).unwrap();
    let rows = text.lines().skip(1).map(|row| {
        let cells: Vec<&str> = row.split(',').collect();
        (cells[0].parse().unwrap(), cells[11].parse().ok())
    });
    (milled, rows.collect())
}

/// A plunge, a slot, the way back, a deeper slot of which the upper half is air, an arc of many chords, and a hole in pecks.
#[test]
fn contact_is_the_new_surface_that_a_line_leaves() {
    let program = "G21 G90\nG0 X0 Y0 Z5\nG1 Z-3 F100\nX20\nX0\nX5 Z-4\nX0 Z-3\nG0 Z5\nX0 Y30\nG1 Z-3\nG3 X-10 Y20 I0 J-10\nG0 Z5\nG83 X30 Y20 Z-8 R1 Q3 F50\nG80\nM2\n";
    let fine = [
        "--tool",
        "flat:4",
        STOCK,
        "--sides",
        "256",
        "--steps-per-unit",
        "10000",
        "--tolerance",
        "0.001",
    ];
    let (milled, found) = contacts(&fine, program);
    let plunge = |depth: f64| 4.0 * PI + depth * 4.0 * PI;
    let expected = [
        (3, plunge(3.0)),
        // Floor and both sides, and the half round at the end: at the start it lies on that of the plunge.
        (4, 20.0 * 4.0 + 2.0 * 20.0 * 3.0 + 3.0 * 2.0 * PI),
        (5, 0.0),
        (10, plunge(3.0)),
        // A quarter of a ring 4 wide around a circle of 10, outside and inside, and the half round at its end.
        (
            11,
            PI / 4.0 * (144.0 - 64.0) + PI / 2.0 * (12.0 + 8.0) * 3.0 + 3.0 * 2.0 * PI,
        ),
        // Three pecks: the floor of each is new again.
        (13, plunge(8.0) + 2.0 * 4.0 * PI),
    ];
    let at = |found: &[(u64, Option<f64>)], line: u64| -> f64 {
        let rows = found.iter().filter(|(other, _)| *other == line);
        rows.map(|(_, contact)| contact.unwrap_or(f64::NAN)).sum()
    };
    for (line, expected) in expected {
        let contact = at(&found, line);
        // Of a facet along the way, half belongs to the end and half to the side: 3 x 0.025 each.
        assert!(
            (contact - expected).abs() < 0.2,
            "line {line}: {contact} instead of {expected}"
        );
    }
    // Down the ramp there is new surface; up on the same way there is none.
    let ramp = [6, 7].map(|line| at(&found, line));
    assert!(ramp[0] > 10.0 && ramp[1].to_bits() == 0, "{ramp:?}");
    let most = &milled["cutting"]["contact_area"];
    assert_eq!(most["peak_line"], 4, "{most}");
    assert!(
        (most["peak"].as_f64().unwrap() - 218.85).abs() < 0.2,
        "{most}"
    );
    // A coarser path has about the same: the ends of chords inside the arc are no surface that stays.
    let (_, coarse) = contacts(&["--tool", "flat:4", STOCK, "--tolerance", "0.1"], program);
    let arcs = [&found, &coarse].map(|rows| at(rows, 11));
    assert!((arcs[0] - arcs[1]).abs() < 3.0, "{arcs:?}");
}

/// When a holder is asked for between the chords of a move, the contact of that line is not known; of a move of one solid it is.
#[test]
fn contact_is_left_out_where_it_is_not_known() {
    let program = "G21 G90\nG0 X0 Y0 Z5\nG1 Z-9 F100\nG2 X10 Y10 I10 J0\nG1 X20\nM2\n";
    let (_, found) = contacts(&["--tool", "flat:4,length=8,holder=10x30", STOCK], program);
    let known: Vec<(u64, bool)> = found
        .iter()
        .map(|(line, contact)| (*line, contact.is_some()))
        .collect();
    assert_eq!(known, [(2, true), (3, true), (4, false), (5, true)]);
}

#[test]
fn acceleration_takes_time() {
    let program = "G21 G90\nG0 X0 Y0 Z0\nG1 X10 F600\nM2\n";
    let seconds = |options: &[&str]| {
        let all = [&["--tool", "flat:4,length=10"], options].concat();
        mill(&all, program)["cutting"]["machine_seconds"]
            .as_f64()
            .unwrap()
    };
    assert!((seconds(&[]) - 1.0).abs() < 1e-9);
    // 0.1 s to get going and as much to stop, in which 1 mm is done.
    assert!((seconds(&["--acceleration", "100"]) - 1.1).abs() < 1e-9);
}

fn write(directory: &Path, name: &str, text: &str) -> String {
    let path = directory.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

const WITH_TOOL: &str = "G21 G90\nT7 M6\nG0 X0 Y0 Z5\nG1 Z-3 F100\nG0 Z5\nM2\n";

#[test]
fn tools_come_from_libraries() {
    let directory = tempfile::tempdir().unwrap();
    let fusion = write(
        directory.path(),
        "library.json",
        r#"{"version": 2, "data": [
            {"type": "holder", "unit": "millimeters", "segments": []},
            {"type": "thread mill", "unit": "millimeters", "geometry": {"DC": 4}, "post-process": {"number": 1}},
            {"type": "flat end mill", "unit": "inches", "geometry": {"DC": 0.25, "LCF": 0.5, "LB": 0.75, "SFDM": 0.25},
             "holder": {"unit": "inches", "segments": [{"height": 1, "lower-diameter": 1, "upper-diameter": 1.5}]},
             "post-process": {"number": 7}},
            {"type": "ball end mill", "unit": "millimeters", "geometry": {"DC": 4}, "post-process": {"number": 8}}]}"#,
    );
    let milled = mill(&["--tools", &fusion, STOCK], WITH_TOOL);
    assert!(
        (removed(&milled) - 3.0 * PI * 3.175 * 3.175).abs() < 0.2,
        "{milled}"
    );
    // 19.05 mm out of its holder, 20 deep: it hits.
    let deep = WITH_TOOL.replace("Z-3", "Z-20");
    let stock = "--stock=-20,-20,-30:20,20,0";
    let found = hits(
        &mill(&["--tools", &fusion, stock], &deep),
        "shank_or_holder",
    );
    assert_eq!(found.len(), 2, "{found:?}");
    check_refused(
        &["--tools", &fusion, STOCK],
        &WITH_TOOL.replace("T7", "T1"),
        &["line 4", "tool 1", "thread mill"],
    );

    write(
        directory.path(),
        "Bit/six.fctb",
        r#"{"version": 2, "name": "six", "shape": "endmill.fcstd",
            "parameter": {"CuttingEdgeHeight": "20.0000 mm", "Diameter": "6.0000 mm", "Length": "50.0000 mm", "ShankDiameter": "6.0000 mm"}}"#,
    );
    let library = write(
        directory.path(),
        "Library/all.fctl",
        r#"{"version": 1, "tools": [{"nr": 7, "path": "six.fctb"}]}"#,
    );
    let milled = mill(&["--tools", &library, STOCK], WITH_TOOL);
    assert!((removed(&milled) - 27.0 * PI).abs() < 0.2, "{milled}");
    let bit = format!("T7={}", directory.path().join("Bit/six.fctb").display());
    assert_eq!(
        removed(&mill(&["--tools", &bit, STOCK], WITH_TOOL)).to_bits(),
        removed(&milled).to_bits()
    );
    let torus = write(
        directory.path(),
        "torus.fctb",
        r#"{"shape": "torus.fcstd", "parameter": {"Diameter": "4 mm", "FlatRadius": "1 mm"}}"#,
    );
    let milled = mill(&["--tools", &format!("T7={torus}"), STOCK], WITH_TOOL);
    let bull = mill(&["--tool", "T7=bull:4,corner=1", STOCK], WITH_TOOL);
    assert_eq!(removed(&milled).to_bits(), removed(&bull).to_bits());

    // A table says how long and how wide, not which shape; that may be given beside it.
    let table = write(directory.path(), "tool.tbl", "T7 P7 Z-20 D4 ;end mill\n");
    check_refused(
        &["--tools", &table, STOCK],
        WITH_TOOL,
        &["line 4", "not its shape"],
    );
    let both = mill(
        &["--tools", &table, "--tool", "T7=flat:4", STOCK],
        WITH_TOOL,
    );
    assert!((removed(&both) - 12.0 * PI).abs() < 0.1, "{both}");
}

#[test]
fn definitions_that_make_no_tool_are_refused() {
    for (tool, words) in [
        ("T1", &["="][..]),
        ("T1=disc:4", &["none of flat"]),
        ("T1=flat:0", &["more than 0"]),
        ("T1=flat:four", &["not a number"]),
        ("T1=bull:4", &["corner="]),
        ("T1=bull:4,corner=3", &["half the diameter"]),
        ("T1=flat:4,corner=1", &["does not belong"]),
        ("T1=vee:4,angle=180", &["angle"]),
        ("T1=flat:4,flutes=5,length=4", &["longer"]),
        ("T1=flat:4,holder=20x30", &["length"]),
        ("T1=flat:4,length=4,length=5", &["twice"]),
        ("T1=form:1x2/4x5", &["height 0"]),
        ("T1=form:1x0/4x5/4x2", &["goes up"]),
    ] {
        check_refused(&["--tool", tool, STOCK], PLUNGE, words);
    }
    check_refused(
        &["--tool", "T1=flat:4", "--tool", "T1=flat:5"],
        PLUNGE,
        &["T1 twice"],
    );
    // A ball needs at least half of itself.
    check_refused(
        &["--tool", "ball:8,length=3"],
        PLUNGE,
        &["tool 0", "length"],
    );
}

#[test]
fn compensation_takes_the_diameter_of_the_tool() {
    // Around a square 20 wide, the tool left of the path: the square stays whole.
    let program = "G21 G90 G17\nT4 M6\nG0 X-10 Y-10 Z5\nG1 Z-2 F100\nG41 D4 X0 Y-5\nY20\nX20\nY0\nX-5\nG40 X-10 Y-10\nG0 Z5\nM2\n";
    let milled = mill(&["--tool", "T4=flat:4", "--stock=0,0,-2:20,20,0"], program);
    let inside = removed(&milled);
    assert!(inside < 0.2, "{milled}");
}

#[cfg(unix)]
#[test]
fn ctrl_c_says_how_far_it_got() {
    let directory = tempfile::tempdir().unwrap();
    let mut program = String::from("G21 G90\nG0 X0 Y0 Z1\nG1 Z-1 F1000\n");
    for line in 0..100_000 {
        use std::fmt::Write;
        writeln!(program, "X{}.{} Y{}", line % 37, line % 10, line % 29).unwrap();
    }
    let file = write(directory.path(), "long.nc", &program);
    let csv = directory.path().join("lines.csv");
    let child = Command::new(env!("CARGO_BIN_EXE_union3d"))
        .args(["mill", &file, "--tool", "ball:6", STOCK, "--json", "--csv"])
        .arg(&csv)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The file of lines is made when cutting begins.
    while !csv.exists() {
        std::thread::yield_now();
    }
    let id = i32::try_from(child.id()).unwrap();
    // SAFETY: a signal to a child of our own that has not been waited for.
    #[expect(unsafe_code, reason = "there is no safe call for a signal")]
    unsafe {
        libc::kill(id, libc::SIGINT);
    }
    let output = child.wait_with_output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{errors}");
    assert!(errors.contains("stopped by Ctrl-C"), "{errors}");
    let milled: Value = serde_json::from_slice(&output.stdout).unwrap();
    let line = milled["stopped_after_line"].as_u64().unwrap();
    assert!((1..100_000).contains(&line), "{line}");
    let rows = std::fs::read_to_string(&csv).unwrap();
    assert_eq!(
        rows.lines().count() as u64,
        1 + milled["cutting"]["lines"].as_u64().unwrap()
    );
}
