//! What a user relies on when a program of G-code is read: where the cutter goes, and what is said about the words it cannot
//! follow.
//!
//! Set `UNION3D_GCODE_DIR` to a directory with the real programs of the last tests (they are skipped without).

use std::f64::consts::{PI, SQRT_2, TAU};
use std::fmt::Write;
use std::path::Path;

use proptest::prelude::*;
use union3d::toolpath::{
    Dialect, Event, Interpreter, Motion, Move, Options, RapidPath, Sampler, ToolTable,
};

/// A program from a machine that stands at zero and knows it.
fn interpret(program: impl Into<Vec<u8>>) -> Interpreter {
    Interpreter::new(program, Options::default())
}

/// Runs a program: its events as text, one a line, or the error. That the start and the feed are taken for granted is left out: it
/// has a test of its own.
fn run(program: &str) -> Result<String, String> {
    run_with(program, Options::default())
}

fn run_with(program: &str, options: Options) -> Result<String, String> {
    let mut text = String::new();
    for event in Interpreter::new(program, options) {
        match event.map_err(|error| error.to_string())? {
            Event::Warning(warning) if ["start", "feed"].contains(&warning.code.as_str()) => {
                continue;
            }
            Event::Move(next) => {
                let motion = match next.motion {
                    Motion::Rapid => "rapid",
                    Motion::Feed => "feed",
                    Motion::Arc => "arc",
                };
                let [x, y, z] = next.end.map(tidy);
                write!(text, "{} {motion} {x} {y} {z}", next.line).unwrap();
                if let Some(feed) = next.feed {
                    write!(text, " F{}", tidy(feed)).unwrap();
                }
            }
            Event::Dwell { line, seconds, .. } => write!(text, "{line} dwell {seconds}").unwrap(),
            Event::Warning(warning) => write!(text, "{} ! {}", warning.line, warning.code).unwrap(),
        }
        text.push('\n');
    }
    Ok(text)
}

/// Six decimals, no negative zero.
fn tidy(value: f64) -> f64 {
    (value * 1e6).round() / 1e6 + 0.0
}

/// The events of a program, spaces around lines aside.
#[track_caller]
fn check(program: &str, expected: &str) {
    let tidied: Vec<_> = expected
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty())
        .collect();
    match run(program) {
        Ok(events) => assert_eq!(events.lines().collect::<Vec<_>>(), tidied, "{program}"),
        Err(error) => panic!("{program}: {error}"),
    }
}

/// As [`check`], in millimetres: the warning about a missing unit is not what the case is about.
#[track_caller]
fn check_mm(program: &str, expected: &str) {
    check(&format!("G21 {program}"), expected);
}

#[track_caller]
fn check_refused(program: &str, place: &str, words: &str) {
    match run(program) {
        Ok(events) => panic!("{program:?} was run:\n{events}"),
        Err(error) => {
            assert!(error.starts_with(place), "{program:?}: {error}");
            assert!(error.contains(words), "{program:?}: {error}");
        }
    }
}

fn moves(program: &str) -> Vec<Move> {
    interpret(program)
        .filter_map(
            |event| match event.unwrap_or_else(|error| panic!("{program}: {error}")) {
                Event::Move(next) => Some(next),
                _ => None,
            },
        )
        .collect()
}

/// The last move of a program in millimetres.
fn last(program: &str) -> Move {
    *moves(&format!("G21\n{program}")).last().expect("a move")
}

#[track_caller]
fn assert_near(found: [f64; 3], expected: [f64; 3]) {
    for axis in 0..3 {
        assert!(
            (found[axis] - expected[axis]).abs() < 1e-9,
            "{found:?} is not {expected:?}"
        );
    }
}

#[test]
fn words_are_read_as_machines_read_them() {
    check_mm("G0X1Y2Z3", "1 rapid 1 2 3");
    check_mm("g1 x-1.5 y+.5 z2. f100", "1 feed -1.5 0.5 2 F100");
    check_mm("G 01 X 10 Y - 2", "1 feed 10 -2 0");
    check_mm("G1X1\r\nY2\r\n", "1 feed 1 0 0\n2 feed 1 2 0");
    check_mm("G1\tX1\t( a comment )Y2 ; Y3 G0", "1 feed 1 2 0");
    check_mm("G1 X1 ; a ( b", "1 feed 1 0 0");
    check_mm("G1 X1 (a; b) Y2", "1 feed 1 2 0");
    check_mm("(Fr\u{e4}sen \u{1F600}) G1 X1", "1 feed 1 0 0");
    check(
        "%\nO1234 (name)\nN10 G21\nN20 G1 X1\n%\nG1 X2",
        "2 ! dialect\n4 feed 1 0 0\n6 ! rest",
    );
    check("G21 G1 X1\n%\n% \n\n(end)\n", "1 feed 1 0 0");
    check("\u{feff}G21 G1 X1", "1 feed 1 0 0");
    check("", "");
    check("\n\n( nothing )\n;\n", "");
    check_mm("\n/G1 X5\n/ G1 X6\nG1 X1", "2 ! block-delete\n4 feed 1 0 0");
    // Values are not squeezed through 32 bits.
    assert_eq!(last("G1 X1234.5678901").end[0], 1_234.567_890_1);
}

#[test]
fn comments_of_any_encoding_pass() {
    let mut program = b"G21 (Fr\xe4sen)\nG1 X1\n".to_vec();
    program.extend(b"; \xff\xfe\n");
    let events: Vec<_> = interpret(&program[..]).map(Result::unwrap).collect();
    let moves = events
        .iter()
        .filter(|event| matches!(event, Event::Move(_)));
    assert_eq!(moves.count(), 1);
}

#[test]
fn motion_is_modal() {
    check_mm(
        "G0 X1\nY2\nG1 Z-1 F60\nX3\nX4 Y4 F30\nG2 X6 I1\nX8 I1\nG80\nG1\nX9",
        "1 rapid 1 0 0
         2 rapid 1 2 0
         3 feed 1 2 -1 F60
         4 feed 3 2 -1 F60
         5 feed 4 4 -1 F30
         6 arc 6 4 -1 F30
         7 arc 8 4 -1 F30
         10 feed 9 4 -1 F30",
    );
    check_refused("X1", "line 1, column 1:", "without a motion word");
    check_refused(
        "G21 G1 X1\nG80\n X2",
        "line 3, column 2:",
        "without a motion word",
    );
}

#[test]
fn units_convert_and_feeds_with_them() {
    check(
        "G20 G1 X1 F10\nG21 X50 F100\nG20 Y-.5",
        "1 feed 25.4 0 0 F254\n2 feed 50 0 0 F100\n3 feed 50 -12.7 0 F100",
    );
    // The order of words on a line is of no consequence.
    check("G1 X1 F10 G20", "1 feed 25.4 0 0 F254");
    check("G20 G2 X2 I1", "1 arc 50.8 0 0");
    check("G1 X1\nX2", "1 ! unit\n1 feed 1 0 0\n2 feed 2 0 0");
    check_mm("G1 X1 F0\nX2 F5", "1 feed 1 0 0\n2 feed 2 0 0 F5");
}

#[test]
fn distances_are_absolute_or_relative() {
    check_mm(
        "G91 G1 X1 Y1\nX1\nG90 X1 Z3\nG91 Z1",
        "1 feed 1 1 0\n2 feed 2 1 0\n3 feed 1 1 3\n4 feed 1 1 4",
    );
    check_mm(
        "G91 G0 X10\nG2 X2 I1\nG3 X-2 I-1",
        "1 rapid 10 0 0\n2 arc 12 0 0\n3 arc 10 0 0",
    );
    // Centres: relative to the start unless G90.1, whatever G90 and G91 say.
    check_mm(
        "G0 X10\nG90.1 G2 X12 I11 J0\nG91.1 G2 X14 I1",
        "1 rapid 10 0 0\n2 arc 12 0 0\n3 arc 14 0 0",
    );
    check_refused("G21 G90.1 G2 X2 I1", "line 1,", "J or R is missing");
}

#[test]
fn g92_shifts_the_coordinates() {
    check_mm(
        "G0 X10 Y5\nG92 X0\nG1 X5\nY1\nG92.2\nX1\nG92.3\nX1\nG92.1 X2\nG92.3 X3",
        "1 rapid 10 5 0
         3 feed 15 5 0
         4 feed 15 1 0
         6 feed 1 1 0
         8 feed 11 1 0
         9 feed 2 1 0
         10 feed 3 1 0",
    );
    check(
        "G20 G0 X1\nG92 X0 Y1\nG1 X1 Y1",
        "1 rapid 25.4 0 0\n3 feed 50.8 0 0",
    );
    check_mm(
        "G0 X10\nG92 X0\nG90.1 G2 X2 I1 J0",
        "1 rapid 10 0 0\n3 arc 12 0 0",
    );
    check_refused(
        "G21 G92 G28 X1",
        "line 1, column 9:",
        "both set what its coordinates mean",
    );
}

#[test]
fn stops_dwells_and_ends() {
    check_mm(
        "G4 P1.5\nG1 X1\nG4 X2\nG4 P0",
        "1 dwell 1.5\n2 feed 1 0 0\n3 dwell 2\n4 dwell 0",
    );
    check_mm(
        "M0\nG1 X1 M3 S1000\nM1\nX2 M8\nT1\nX3\nM30\n\nX4\nX5",
        "2 feed 1 0 0\n4 feed 2 0 0\n6 ! tool\n6 feed 3 0 0\n9 ! rest",
    );
    check_mm("G1 X1 M2\n%", "1 feed 1 0 0");
    check_refused("G21\nG4 P-1", "line 2, column 4:", "-1 s");
}

#[test]
fn feeds_by_inverse_time_become_speeds() {
    // Two moves a minute, each 10 mm.
    check_mm(
        "G93 G1 X10 F2\nG1 Y10 F4\nG94 X0\nX1 F7",
        "1 feed 10 0 0 F20\n2 feed 10 10 0 F40\n3 feed 0 10 0\n4 feed 1 10 0 F7",
    );
    check_mm("G95 G1 X1 F0.1", "1 ! G95\n1 feed 1 0 0");
}

#[test]
fn what_changes_nothing_passes_without_a_word() {
    for word in [
        "G40",
        "G49",
        "G50",
        "G61",
        "G61.1",
        "G64 P0.1",
        "G69",
        "G80",
        "G94",
        "G97",
        "G98",
        "G99",
        "G15",
        "M0",
        "M1",
        "M3 S1",
        "M5",
        "M9",
        "M48",
        "S1000",
        "D1",
        "T3 M6",
        "H1",
        "N5",
        "G43 H1",
        "G43.1 Z0",
        "G54",
        "M19 R90",
        "G64 P0.1 Q0.1",
    ] {
        check(&format!("G21\n{word}\nG1 X1"), "3 feed 1 0 0");
    }
}

#[test]
fn what_is_not_done_is_said_once_per_kind() {
    for (word, code) in [
        ("M62 P1", "M62"),
        ("M10", "M10"),
        ("M150", "M150"),
        ("A0", "axis-a"),
    ] {
        check(
            &format!("G21 G0 X1 Y0 Z0\n{word}\n{word}\nG1 X2"),
            &format!("1 rapid 1 0 0\n2 ! {code}\n4 feed 2 0 0"),
        );
    }
    let event = interpret("(a)\nM62 P1").next().unwrap().unwrap();
    let Event::Warning(warning) = event else {
        panic!("{event:?}")
    };
    assert!(
        warning
            .to_string()
            .starts_with("line 2: M62 not done: outputs"),
        "{warning}"
    );
    // With `strict` all of this refuses.
    let strict = Options {
        strict: true,
        ..Options::default()
    };
    let error = run_with("G21 G0 X1 Y1 Z1\nM62 P1\nG1 X2", strict).unwrap_err();
    assert!(
        error.starts_with("line 2, column 1: M62 not done"),
        "{error}"
    );
}

#[test]
fn what_would_make_the_path_wrong_is_refused() {
    for word in [
        "G12", "G16", "G29", "G31", "G33", "G34", "G38.2", "G43.4", "G44", "G51", "G65", "G68",
        "G7", "G70", "G76", "G87", "G88", "G91.2", "G96", "G100", "G90.9", "M198", "M47", "M6.1",
        "M500",
    ] {
        check_refused(
            &format!("G21\n  {word} X1 P1"),
            "line 2, column 3:",
            &format!("{word} is refused"),
        );
    }
    for word in [
        "A1", "B-2", "C0.5", "U1", "V1", "W1", "I1", "R2", "E1", "Q1", "O7",
    ] {
        check_refused(
            &format!("G21\nG1 X1 {word}"),
            "line 2, column 7:",
            &format!("{word} is refused"),
        );
    }
    check_refused("G21\nG1 X1 ,R2", "line 2, column 7:", "corners");
    check_refused("G21\nG53 G1 X1", "line 2,", "machine coordinates");
    check_refused("G21\nG1 X1.5e-05", "line 2, column 4:", "exponent");
    check_refused("G21\nG1 X1 F1e3", "line 2, column 7:", "exponent");
    check_refused("G21\nM99 P100", "line 2, column 1:", "another line");
    check_refused("G21\n#1=1\nIF[#1 EQ 1] GOTO 5", "line 3, column 1:", "IF");
    check_refused("G21\nG1 X1 (open", "line 2, column 7:", "does not end");
    check_refused("G21\n(ABORT, no stock)", "line 2,", "no stock");
}

#[test]
fn bad_lines_are_named_with_their_place() {
    for (line, column, words) in [
        ("G1 X", 5, "a number was expected"),
        ("G1 XY1", 5, "a number was expected"),
        ("G1 X--1", 6, "a number was expected"),
        ("G1 X#", 6, "a parameter has a number or a <name>"),
        ("G1 X#<a>", 5, "#<a> has no value"),
        ("G1 X#0", 6, "no parameter #0"),
        ("G1 X[1+2", 5, "a [ has no ]"),
        ("G1 X[1+2)]", 9, "an operator or ] was expected"),
        ("G1 X[1/0]", 7, "a division by zero"),
        ("G1 X[SQRT[-1]]", 6, "is no number"),
        ("#5221=1", 1, "is kept by the machine"),
        ("#1", 3, "must be set by ="),
        ("G", 2, "a number was expected"),
        ("G1 X.", 6, "a number was expected"),
        ("G-1", 1, "not the number of a code"),
        ("G1 X1.2.3", 8, "no letter before it"),
        ("G1.25 X1", 1, "not the number of a code"),
        ("G4294967297 X1", 1, "not the number of a code"),
        ("G1 X1234567890123456", 20, "digits"),
        ("G1 X1 \u{2014} Y2", 7, "no word of G-code"),
        ("(\u{e4}) G1 $", 8, "no word of G-code"),
        ("G1 X1*71", 6, "the checksum is 71, but the line has 63"),
        ("G1 G0 X1", 4, "G1 and G0 on one line both set the motion"),
        ("G20 G21", 5, "both set the unit"),
        ("G17 G18", 5, "both set the plane"),
        ("G90 G91", 5, "both set the distance mode"),
        ("G1 X1 X2", 7, "X stands twice"),
        ("G1 X1 F-5", 7, "a feed of -5"),
    ] {
        check_refused(
            &format!("G21\n{line}"),
            &format!("line 2, column {column}:"),
            words,
        );
    }
    // The text of the line is there, but not all of a long one.
    let error = run(&format!("G1 X {}", "Q".repeat(500))).unwrap_err();
    assert!(error.contains("QQQ") && error.len() < 250, "{error}");
    // A file that is no text at all.
    assert!(run(&"\0".repeat(200_000)).is_err());
    assert!(
        run(&" ".repeat(200_000))
            .unwrap_err()
            .contains("without end")
    );
    // Nothing comes after an error.
    let mut events = interpret("G21\nG1 X1\n{\nG1 X2");
    assert_eq!(events.by_ref().filter(Result::is_ok).count(), 3);
    assert!(events.next().is_none());
}

/// Options with work systems and the machine's zero known.
fn placed(origins: &[(usize, [f64; 3])]) -> Options {
    let mut options = Options::default();
    for (system, origin) in origins {
        options.origins[*system] = Some(*origin);
    }
    options
}

#[track_caller]
fn check_with(options: Options, program: &str, expected: &str) {
    let found = run_with(program, options).unwrap_or_else(|error| panic!("{program}: {error}"));
    let expected: Vec<_> = expected.lines().map(str::trim).collect();
    assert_eq!(found.lines().collect::<Vec<_>>(), expected, "{program}");
}

#[test]
fn what_is_taken_for_granted_is_said() {
    let codes = |program: &str| -> Vec<String> {
        interpret(program)
            .filter_map(|event| match event.unwrap() {
                Event::Warning(warning) => Some(format!("{} {}", warning.line, warning.code)),
                _ => None,
            })
            .collect()
    };
    assert_eq!(codes("G21 G0 X0 Y0\nZ1\nG1 X1 F5"), Vec::<String>::new());
    assert_eq!(codes("G21 G0 X0 Y0\nG1 X1"), ["2 start", "2 feed"]);
    assert_eq!(codes("G0 X0 Y0 Z0\nG1 X1 F1"), ["1 unit"]);
    assert_eq!(
        codes("G21 G0 X0 Y0 Z0\nM3 S1\nG1 X1 F1\nM5\nG1 X2\nM3\nX3"),
        ["5 spindle"]
    );
    assert_eq!(codes("G21 T1\nG0 X0 Y0 Z0\nG1 X1 F1\nT2\nX2"), ["3 tool"]);
    assert_eq!(codes("G21 G4 P120"), ["1 dwell"]);
    assert_eq!(codes("G21\nG4 P2000"), ["2 dialect"]);
}

#[test]
fn a_reference_point_is_known_or_its_axes_are_lost() {
    let known = |program: &str, options: Options| -> Vec<(bool, [bool; 3])> {
        Interpreter::new(program, options)
            .filter_map(|event| match event.unwrap() {
                Event::Move(next) => Some((next.start_known, next.end_known)),
                _ => None,
            })
            .collect()
    };
    let program = "G21 G0 X0 Y0\nZ5\nG1 Z-1 F9\nG91 G28 Z0\nG90 G0 X9 Y9\nZ3\nX1";
    let (all, no_height) = ([true; 3], [true, true, false]);
    assert_eq!(
        known(program, Options::default()),
        [
            (false, no_height),
            (false, all),
            (true, all),
            // Over the point named, then away.
            (true, all),
            (true, no_height),
            (false, no_height),
            (false, all),
            (true, all),
        ]
    );
    // With the place of the reference point the moves are run.
    let home = Options {
        home: Some([0.0, 0.0, 100.0]),
        ..Options::default()
    };
    check_with(
        home.clone(),
        "G21 G0 X0 Y0 Z5\nG91 G28 Z0\nG90 G53 G0 X1 Z-2\nG53 G1 Y3\nG30",
        "1 rapid 0 0 5\n2 rapid 0 0 5\n2 rapid 0 0 100\n3 rapid 1 0 98\n4 feed 1 3 98\n5 rapid 0 0 100",
    );
    // A feed must not begin there; a rapid that says the height ends it.
    let lost = "G21 G0 X0 Y0 Z5\nG91 G28 Z0\nG90\n";
    check_refused(
        &format!("{lost}G1 X1"),
        "line 4, column 4:",
        "Z is not known here",
    );
    check_refused(
        &format!("{lost}G91 G1 Z-1"),
        "line 4,",
        "Z is not known here",
    );
    check_mm(
        &format!("{lost}G1 Z1"),
        "1 rapid 0 0 5\n2 rapid 0 0 5\n2 rapid 0 0 5\n4 feed 0 0 1",
    );
    check_refused(
        "G21 G0 X0 Y0 Z5\nG53 G0 Z0\nG1 X1",
        "line 3, column 4:",
        "Z is not known here",
    );
}

#[test]
fn a_second_work_system_needs_its_place() {
    let program = "G21 G54 G0 X1 Y0 Z0\nG55 X1";
    check_refused(
        program,
        "line 2, column 5:",
        "G55 relative to the work system moved in before is not known",
    );
    check_with(
        placed(&[(0, [10.0, 0.0, 0.0]), (1, [10.0, 20.0, 3.0])]),
        "G21 G54 G0 X1 Y0 Z0\nG55 X1 Y0 Z0\nG56",
        "1 rapid 1 0 0\n2 rapid 1 20 3",
    );
    // The program may say where they are, before or relative to where it stands.
    check_mm(
        "G10 L2 P1 X5\nG10 L2 P2 X7 Y1\nG0 X0 Y0 Z0\nG55 X0 Y0",
        "3 rapid 0 0 0\n4 rapid 2 1 0",
    );
    check_mm(
        "G0 X5 Y5 Z5\nG10 L20 P2 X0 Y0 Z0\nG55 X1",
        "1 rapid 5 5 5\n3 rapid 6 5 5",
    );
    check_mm("G55 G0 X1 Y2 Z3\nX2", "1 rapid 1 2 3\n2 rapid 2 2 3");
    check_refused(
        "G21 G0 X0 Y0 Z0\nG10 L2 P1 X9\nG0 X1",
        "line 3,",
        "G54 relative",
    );
}

#[test]
fn programs_call_and_repeat() {
    // Fanuc's way, with repeats, and the old one with both in one number.
    check(
        "O1\nG21 G0 X0 Y0 Z6\nM98 P23 L2\nM98 P20023\nM30\nO23\nG91 G1 Z-2 F100\nG90\nM99",
        "3 ! dialect\n2 rapid 0 0 6\n7 feed 0 0 4 F100\n7 feed 0 0 2 F100\n7 feed 0 0 0 F100\n7 feed 0 0 -2 F100",
    );
    check_refused("G21\nM98 P5\nM30", "line 2, column 1:", "no program O5");
    // Haas' local call.
    check(
        "G21 G0 X0 Y0 Z6\nM97 P100 L2\nM30\nN100 G91 G1 X1 F9\nM99",
        "2 ! dialect\n1 rapid 0 0 6\n4 feed 1 0 6 F9\n4 feed 2 0 6 F9",
    );
    check(
        "G21\no100 sub\nG1 X#1 Y[#2*2] F5\no100 endsub\no100 call [3] [4]\nM2",
        "3 feed 3 8 0 F5",
    );
    check(
        "G21\no<deep> sub\n#<n>=[#1-1]\nG1 X#1\no<i> if [#<n> gt 0]\no<deep> call [#<n>]\no<i> endif\nG1 Y#1\n\
         o<deep> endsub\no<deep> call [2]",
        "4 feed 2 0 0\n4 feed 1 0 0\n8 feed 1 1 0\n8 feed 1 2 0",
    );
    check_refused("o1 call", "line 1, column 1:", "no o1 sub");
    check_refused("o1 while [1]\no1 endwhile", "line", "on and on");
    check_refused("o1 if [0]\nG0 X1", "line 1, column 1:", "endif is missing");
    check_refused("o1 endrepeat", "line 1, column 1:", "closes no open loop");
    check_refused(
        "o1 sub\nG1 X1\no1 call\no1 endsub\no1 call",
        "line 3,",
        "64 calls",
    );
    check_mm("G1 X1\nM99", "1 feed 1 0 0\n2 ! M99");
    check_refused(
        "O1\nG21 G1 X1\nO2\nG1 X2",
        "line 3, column 1:",
        "another program begins here",
    );
}

/// Files with subprograms stand beside the program; what they do is counted to the line of the call.
#[test]
fn subprograms_are_found_beside_the_program() {
    let directory = tempfile::tempdir().unwrap();
    std::fs::write(
        directory.path().join("step.ngc"),
        "o<step> sub\nG1 X#1\no<step> endsub\nM2\n",
    )
    .unwrap();
    std::fs::write(directory.path().join("bad.ngc"), "o<bad> sub\nG1 X?\n").unwrap();
    let beside = || Options {
        directory: Some(directory.path().to_owned()),
        ..Options::default()
    };
    check_with(beside(), "G21\n\no<step> call [7]", "3 feed 7 0 0");
    let error = run_with("G21\no<bad> call", beside()).unwrap_err();
    assert!(error.starts_with("bad.ngc, line 2, column 5:"), "{error}");
    let error = run_with("G21\no<../step> call", beside()).unwrap_err();
    assert!(
        error.starts_with("line 2, column 1: there is no"),
        "{error}"
    );
}

#[test]
fn dialects_differ_where_controllers_do() {
    let in_dialect = |dialect: Dialect, program: &str, expected: &str| {
        let options = Options {
            dialect: Some(dialect),
            ..Options::default()
        };
        check_with(
            options,
            &format!("G21 G0 X0 Y0 Z0\n{program}"),
            &format!("1 rapid 0 0 0\n{expected}"),
        );
    };
    for (dialect, seconds) in [
        (Dialect::LinuxCnc, "2"),
        (Dialect::Grbl, "2"),
        (Dialect::Fanuc, "0.002"),
        (Dialect::Haas, "0.002"),
        (Dialect::Marlin, "0.002"),
    ] {
        in_dialect(dialect, "G4 P2", &format!("2 dwell {seconds}"));
    }
    in_dialect(Dialect::Haas, "G4 P2.", "2 dwell 2");
    in_dialect(Dialect::Fanuc, "G4 X2", "2 dwell 2");
    in_dialect(Dialect::Marlin, "G4 S2", "2 dwell 2");
    // Nobody waits for half an hour: without another sign, so many are milliseconds; with one, or a point, they are what they are there.
    let times = [
        ("G4 P2000", "dwell 2"),
        ("N10 G04 P 250", "dwell 0.25"),
        ("G4 P2000.", "dwell 2000"),
        ("G4 P120", "dwell 120"),
        ("(GRBL)\nG4 P2000", "dwell 2000"),
        ("$X\nG4 P2000", "dwell 2000"),
    ];
    for (program, expected) in times {
        let found = run(program).unwrap();
        let is_there = found.lines().any(|line| line.ends_with(expected));
        assert!(is_there, "{program}: {found}");
    }
    // A dwell by F leaves the feed alone.
    in_dialect(
        Dialect::Mach3,
        "G1 X1 F600\nG4 F2\nX2",
        "2 feed 1 0 0 F600\n3 dwell 2\n4 feed 2 0 0 F600",
    );
    // What a / leaves out.
    in_dialect(
        Dialect::Grbl,
        "/G1 X1\nN10 G1 X2 / Y5",
        "2 ! block-delete\n2 feed 1 0 0\n3 feed 2 5 0",
    );
    in_dialect(
        Dialect::Fanuc,
        "/G1 X1\nN10 G1 X2 / Y5\n// a note",
        "2 ! block-delete\n3 feed 2 0 0",
    );
    // Cycles return to where they began, or to R as LinuxCNC begins.
    in_dialect(
        Dialect::Fanuc,
        "G0 Z9\nG81 X1 Z-1 R2",
        "2 rapid 0 0 9\n3 rapid 1 0 9\n3 rapid 1 0 2\n3 feed 1 0 -1\n3 rapid 1 0 9",
    );
    in_dialect(
        Dialect::LinuxCnc,
        "G0 Z9\nG81 X1 Z-1 R2",
        "2 rapid 0 0 9\n3 rapid 1 0 9\n3 rapid 1 0 2\n3 feed 1 0 -1\n3 rapid 1 0 2",
    );
    // G80 beside a motion ends cycles only.
    in_dialect(
        Dialect::Fanuc,
        "G0 G17 G40 G49 G80 G90\nX1",
        "3 rapid 1 0 0",
    );
    in_dialect(Dialect::Marlin, "G1 X1E0.5", "2 feed 1 0 0\n2 ! extruder");
    // A variable nobody set is no zero there.
    let fanuc = Options {
        dialect: Some(Dialect::Fanuc),
        ..Options::default()
    };
    assert!(
        run_with("G21\nG1 X#5", fanuc)
            .unwrap_err()
            .contains("#5 has no value")
    );
    for (program, dialect) in [
        ("G1 X1", Dialect::LinuxCnc),
        ("(post: Haas)\nG1 X1", Dialect::Haas),
        ("$H\nG1 X1", Dialect::Grbl),
        ("M104 S200", Dialect::Marlin),
        ("%\nO0001\nG1 X1", Dialect::Fanuc),
        ("O100 sub\nO100 endsub", Dialect::LinuxCnc),
        ("M98 P1", Dialect::Fanuc),
        ("G1 X1 (was M98)", Dialect::LinuxCnc),
    ] {
        assert_eq!(interpret(program).dialect(), dialect, "{program}");
    }
}

#[test]
fn marks_of_tapes_and_senders_are_no_faults() {
    for program in [
        ":1001\nG21 G90\nG1 X5",
        "%_N_PART_MPF\nG21 G90\nG1 X5",
        "\0\0\0%\nG21\nG1 X5\n%",
        "G21 G90\n\nG1 X5\n\u{1a}G1 X6",
        "G21\rG90\rG1 X5\r",
        "G21\r\n\nG1 X5",
    ] {
        let moves = moves(program);
        assert_eq!(moves.len(), 1, "{program:?}");
        assert_eq!((moves[0].line, moves[0].end[0]), (3, 5.0), "{program:?}");
    }
    check("$H\nG21\nG1 X5", "1 ! dialect\n1 ! sender\n3 feed 5 0 0");
    // The checksums of senders are looked at.
    check_mm("\nN3 G1 X5*102", "2 feed 5 0 0");
}

#[test]
fn cutter_compensation_leaves_the_part_whole() {
    let mut tools = ToolTable::default();
    tools.entry(4).diameter = Some(4.0);
    let options = || Options {
        tools: tools.clone(),
        ..Options::default()
    };
    // Around a square of 20 mm, clockwise, cutter on its left: outside corners are rounded.
    check_with(
        options(),
        "G21 G0 X-10 Y-10 Z-2\nG41 D4 G1 X0 Y-10 F100\nY20\nX20\nY0\nX-10\nG40 X-10 Y-10",
        "1 rapid -10 -10 -2
         2 feed -2 -8 -2 F100
         3 feed -2 20 -2 F100
         4 arc 0 22 -2 F100
         4 feed 20 22 -2 F100
         5 arc 22 20 -2 F100
         5 feed 22 0 -2 F100
         6 arc 20 -2 -2 F100
         6 feed -10 -2 -2 F100
         7 feed -10 -10 -2 F100",
    );
    // An inside corner that nearly turns back ends where the cutter touches both sides, and not around its point.
    check_with(
        options(),
        "G21 G0 X-10 Y0 Z-2\nG41 D4 G1 X0 Y0 F100\nX200\nX0 Y8\nG40 X0 Y30",
        "1 rapid -10 0 -2
         2 feed 0 2 -2 F100
         3 feed 99.960016 2 -2 F100
         4 feed -0.079936 6.001598 -2 F100
         5 feed 0 30 -2 F100",
    );
    for (program, words) in [
        ("G41 D5 G1 X1", "diameter of tool 5 is not known"),
        ("G41 D4 G1 X1", "shorter than the cutter's radius"),
        ("G41 D4 G3 X10 Y0 R5", "must begin with a straight move"),
        ("G18 G41 D4", "plane XY only"),
        (
            "G41 D4 G1 X9\nX20\nG3 X21 Y1 R1",
            "does not fit into the arc",
        ),
        (
            "G41 D4 G1 X9\nX20\nY1\nX0",
            "does not fit into the inside corner",
        ),
        ("G41 D4 G1 X9\nG55", "must not change during"),
        ("G41 D4 G1 X9\nG81 X1 Z-1 R1", "must not change during"),
    ] {
        let error = run_with(&format!("G21 G0 X0 Y0 Z0\n{program}"), options()).unwrap_err();
        assert!(error.contains(words), "{program}: {error}");
    }
}

#[test]
fn splines_stay_within_the_tolerance() {
    // A quadratic with its control point above the middle: y = 4 t (1 - t) over x = 10 t.
    for tolerance in [0.1, 0.01, 0.001] {
        let options = Options {
            tolerance,
            ..Options::default()
        };
        let program = "G21 G0 X0 Y0 Z1\nG5.1 X10 Y0 I5 J2 F100";
        let chords: Vec<Move> = Interpreter::new(program, options)
            .filter_map(|event| match event.unwrap() {
                Event::Move(next) if next.line == 2 => Some(next),
                _ => None,
            })
            .collect();
        let curve = |x: f64| 4.0 * (x / 10.0) * (1.0 - x / 10.0);
        let mut farthest: f64 = 0.0;
        for chord in &chords {
            for part in [0.0, 0.25, 0.5, 0.75, 1.0] {
                let [x, y, z] = chord.at(part);
                farthest = farthest.max((y - curve(x)).abs());
                assert_eq!(z, 1.0);
            }
        }
        assert!(
            farthest <= tolerance * 1.1 && farthest > tolerance / 50.0,
            "{tolerance}: {farthest}"
        );
        assert_eq!(chords.last().unwrap().end, [10.0, 0.0, 1.0]);
    }
    // A quarter of a circle is a NURBS of order 3.
    let quarter = format!(
        "G21 G0 X1 Y0 Z0\nG5.2 P1 L3\nX1 Y1 P{}\nX0 Y1 P1\nG5.3",
        SQRT_2 / 2.0
    );
    let chords = &moves(&quarter)[1..];
    assert!(chords.len() >= 6);
    for chord in chords {
        assert!(
            (chord.end[0].hypot(chord.end[1]) - 1.0).abs() < 1e-9,
            "{chord:?}"
        );
    }
    assert_near(chords.last().unwrap().end, [0.0, 1.0, 0.0]);
    check_refused(
        "G21 G5.2 P1 L3\nX1 Y0\nG5.3",
        "line 3, column 1:",
        "as many control points and has 2",
    );
    check_refused(
        "G21 G5.2 P1 L3\nX1 Y0\nG0 X1",
        "line 3, column 1:",
        "not ended by G5.3",
    );
    check_refused(
        "G21 G5.2 P1 L3\nX1 Y0\n",
        "line 2, column 1:",
        "G5.3 is missing",
    );
}

#[test]
fn rapids_may_go_each_axis_for_itself() {
    let options = Options {
        rapid_path: RapidPath::Dogleg,
        ..Options::default()
    };
    check_with(
        options,
        "G21 G0 X0 Y0 Z0\nX10 Y4 Z-6\nG1 X0 Y0",
        "1 rapid 0 0 0\n2 rapid 4 4 -4\n2 rapid 6 4 -6\n2 rapid 10 4 -6\n3 feed 0 0 -6",
    );
}

#[test]
fn tool_lengths_and_axis_words_of_other_codes_move_nothing() {
    let mut tools = ToolTable::default();
    tools.entry(1).offset[2] = 10.0;
    let options = Options {
        tools,
        ..Options::default()
    };
    check_with(
        options,
        "G21 T1 M6\nG0 X0 Y0 Z6\nG43.1 Z-8\nG0 Z6\nG43\nX1\nG49\nZ6",
        "2 rapid 0 0 6\n4 rapid 0 0 6\n6 rapid 1 0 -12\n8 rapid 1 0 6",
    );
    check_refused(
        "G21 G1 G43.1 Z1\nG92 G1 X1",
        "line 2, column 1:",
        "both claim",
    );
}

#[test]
fn the_table_of_words_is_the_one_that_is_followed() {
    let table = union3d::toolpath::words_table();
    assert!(table.lines().count() > 100, "{table}");
    let readme = Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md");
    let readme = std::fs::read_to_string(readme).unwrap();
    assert!(
        readme.contains(&format!("\n\n{table}\n")),
        "put what `union3d path --words` prints into README.md"
    );
    let treatment = |words: &str, dialect: usize| {
        let row = table
            .lines()
            .find(|row| row.starts_with(&format!("| {words} |")))
            .unwrap();
        row.split('|').nth(3 + dialect).unwrap().trim().to_owned()
    };
    assert_eq!(treatment("G1", 0), "done");
    assert_eq!(treatment("G8", 0), "harmless");
    assert_eq!(treatment("G16", 0), "refused");
    assert_eq!(treatment("M62 to M68", 1), "reported");
    // Every word that is said to be refused is, and no other.
    for row in table.lines().skip(2) {
        let cells: Vec<_> = row.split('|').map(str::trim).collect();
        let word = cells[1].split(' ').next().unwrap();
        for (dialect, cell) in Dialect::ALL.into_iter().zip(&cells[3..]) {
            if cell.is_empty() {
                continue;
            }
            let options = Options {
                dialect: Some(dialect),
                ..Options::default()
            };
            let error = run_with(&format!("G21 {word}"), options).err();
            let refused = error.is_some_and(|error| {
                error.contains(&format!("{word} is refused: ")) && !error.contains("diameter")
            });
            assert_eq!(refused, *cell == "refused", "{word} {dialect:?}");
        }
    }
}

#[test]
fn nothing_that_is_typed_makes_the_reader_panic() {
    let pieces = [
        "G",
        "g1",
        "G2",
        "G3",
        "X",
        "Y1",
        "Z-2",
        "I",
        "J1",
        "K-1",
        "R2",
        "R-2",
        "R0",
        ".",
        "-",
        "+",
        "0",
        "9",
        "99999999",
        "%",
        "/",
        "(",
        ")",
        ";",
        "\n",
        "\n",
        " ",
        "#",
        "[",
        "]",
        "=",
        "*",
        "M30",
        "M",
        "T",
        "T9",
        "N",
        "O",
        "P2",
        "F1",
        "G18",
        "G19",
        "G91",
        "G92",
        "G20",
        "E",
        "\u{e4}",
        "\u{1F600}",
        "\0",
        "G4",
        "G53",
        "G28",
        "G41.1 D2",
        "G41.1 D.1 X3",
        "G40",
        "G5 I1 J1 P1 Q1 X3",
        "G5.2 P1 L3",
        "G5.3",
        "G81 Z-1 R1",
        "G83 Z-3 R1 Q1",
        "G10 L2 P1 R30",
        "G10 L20 P2 X1",
        "G55",
        "G43.1 Z1",
        "G52 X1",
        "@1",
        "^30",
        "#1=2",
        "#1",
        "#<a>=1",
        "[1+#1]",
        "sin[30]",
        "**",
        "mod",
        "o1 sub\n",
        "o1 endsub\n",
        "o1 call\n",
        "o2 if [#1]\n",
        "o2 else\n",
        "o2 endif\n",
        "o3 repeat [2]\n",
        "o3 endrepeat\n",
        "o3 break\n",
        "o4 do\n",
        "o4 while [0]\n",
        "M98 P1",
        "M99",
        "O1\n",
        "M70",
        "M72",
        "M73",
    ];
    proptest!(|(picks in prop::collection::vec(0..pieces.len(), 0..40))| {
        let program: String = picks.into_iter().map(|pick| pieces[pick]).collect();
        for event in interpret(program).flatten() {
            if let Event::Move(next) = event {
                prop_assert!(next.length.is_finite(), "{:?}", next);
                prop_assert!(next.end.iter().all(|at| at.is_finite()));
            }
        }
    });
}

/// A move of the program passes through the points given for 0, 1/4, 1/2, 3/4 and 1 of it.
#[track_caller]
fn check_arc(program: &str, length: f64, points: [[f64; 3]; 5]) {
    let arc = last(program);
    assert_eq!(arc.motion, Motion::Arc);
    assert!(
        (arc.length - length).abs() < 1e-9,
        "{program}: length {} is not {length}",
        arc.length
    );
    for (part, point) in [0.0, 0.25, 0.5, 0.75, 1.0].into_iter().zip(points) {
        assert_near(arc.at(part), point);
    }
}

#[test]
fn arcs_pass_through_their_points() {
    let r = SQRT_2 / 2.0;
    // A quarter about the origin, both ways, in each plane: counterclockwise turns X to Y, Z to X and Y to Z.
    check_arc("G0 X2\nG17 G3 X0 Y2 I-2 J0", PI, quarter([0, 1], 1.0));
    check_arc("G0 X2\nG17 G2 X0 Y-2 I-2 J0", PI, quarter([0, 1], -1.0));
    check_arc("G0 Z2\nG18 G3 X2 Z0 K-2", PI, quarter([2, 0], 1.0));
    check_arc("G0 Z2\nG18 G2 X-2 Z0 K-2 I0", PI, quarter([2, 0], -1.0));
    check_arc("G0 Y2\nG19 G3 Y0 Z2 J-2 K0", PI, quarter([1, 2], 1.0));
    check_arc("G0 Y2\nG19 G2 Y0 Z-2 J-2", PI, quarter([1, 2], -1.0));
    // By R: the shorter arc, and the longer one for a negative R.
    check_arc("G0 X2\nG3 X0 Y2 R2", PI, quarter([0, 1], 1.0));
    check_arc("G0 X2\nG2 X0 Y-2 R2", PI, quarter([0, 1], -1.0));
    check_arc("G0 Z2\nG18 G3 X2 Z0 R2", PI, quarter([2, 0], 1.0));
    let far = [0.375_f64, 0.75, 1.125]
        .map(|turn| [2.0 * (turn * PI).cos(), 2.0 * (turn * PI).sin(), 0.0]);
    check_arc(
        "G0 X2\nG3 X0 Y-2 R-2",
        3.0 * PI,
        [[2.0, 0.0, 0.0], far[0], far[1], far[2], [0.0, -2.0, 0.0]],
    );
    // A half circle by R, and one whose R is a hair too small.
    check_arc(
        "G2 X2 R1",
        PI,
        [
            [0.0; 3],
            [1.0 - r, r, 0.0],
            [1.0, 1.0, 0.0],
            [1.0 + r, r, 0.0],
            [2.0, 0.0, 0.0],
        ],
    );
    check_arc(
        "G2 X2 R0.999",
        PI,
        [
            [0.0; 3],
            [1.0 - r, r, 0.0],
            [1.0, 1.0, 0.0],
            [1.0 + r, r, 0.0],
            [2.0, 0.0, 0.0],
        ],
    );
    // A full circle, a helix, and a helix of three turns.
    check_arc(
        "G3 X0 Y0 I1",
        TAU,
        [
            [0.0; 3],
            [1.0, -1.0, 0.0],
            [2.0, 0.0, 0.0],
            [1.0, 1.0, 0.0],
            [0.0; 3],
        ],
    );
    check_arc(
        "G2 I1",
        TAU,
        [
            [0.0; 3],
            [1.0, 1.0, 0.0],
            [2.0, 0.0, 0.0],
            [1.0, -1.0, 0.0],
            [0.0; 3],
        ],
    );
    check_arc(
        "G2 I1 Z-4",
        TAU.hypot(4.0),
        [
            [0.0; 3],
            [1.0, 1.0, -1.0],
            [2.0, 0.0, -2.0],
            [1.0, -1.0, -3.0],
            [0.0, 0.0, -4.0],
        ],
    );
    check_arc(
        "G2 I1 Z-4 P3",
        (3.0 * TAU).hypot(4.0),
        [
            [0.0; 3],
            [1.0, -1.0, -1.0],
            [2.0, 0.0, -2.0],
            [1.0, 1.0, -3.0],
            [0.0, 0.0, -4.0],
        ],
    );
    check_arc(
        "G91 G20 G3 X-1 Y1 I-1",
        12.7 * PI,
        quarter([0, 1], 1.0).map(|p| [(p[0] / 2.0 - 1.0) * 25.4, p[1] / 2.0 * 25.4, 0.0]),
    );
}

/// Points of a quarter turn of radius 2 about the origin, from the first axis towards the second (or away from it).
fn quarter([first, second]: [usize; 2], sense: f64) -> [[f64; 3]; 5] {
    [0.0, 0.125, 0.25, 0.375, 0.5].map(|turn: f64| {
        let mut point = [0.0; 3];
        point[first] = 2.0 * (turn * PI).cos();
        point[second] = sense * 2.0 * (turn * PI).sin();
        point
    })
}

#[test]
fn uneven_arcs_are_run_and_reported_and_impossible_ones_refused() {
    // Within 0.02 mm nobody is told.
    check_mm("G2 X2.01 I1", "1 arc 2.01 0 0");
    check_mm(
        "G2 X2.1 I1\nX4.2 I1",
        "1 ! uneven-arc\n1 arc 2.1 0 0\n2 ! uneven-arc\n2 arc 4.2 0 0",
    );
    let spiral = last("G2 X2.1 I1");
    assert_near(spiral.at(0.5), [1.0, 1.05, 0.0]);
    assert_near(spiral.at(1.0), [2.1, 0.0, 0.0]);
    // Against the closed form of the length of an Archimedean spiral.
    let (a, b) = (0.1 / PI, 1.0);
    let along = |r: f64| 0.5 * (r * r.hypot(a) / a + a * (r + r.hypot(a)).ln());
    assert!((spiral.length - (along(b + 0.1) - along(b))).abs() < 1e-9);

    check_refused(
        "G21\nG2 X2 R0.9",
        "line 2, column 1:",
        "0.9000 mm is too small: start and end are 2.0000 mm apart, so it must be at least 1.0000",
    );
    check_refused(
        "G21\n G2 X30 I10",
        "line 2, column 2:",
        "its start is 10.0000 mm and its end 20.0000 mm from its centre",
    );
    check_refused("G21\nG2 X0.1 I0.5", "line 2, column 1:", "no such arc");
    check_refused(
        "G21\nG2 X2",
        "line 2, column 1:",
        "no centre: I or R is missing",
    );
    check_refused(
        "G21\nG18 G2 X2",
        "line 2, column 1:",
        "no centre: K or R is missing",
    );
    check_refused(
        "G21\nG2 X0 Y0 R5",
        "line 2, column 1:",
        "full circle needs I, J or K",
    );
    check_refused("G21\nG2 X1 R0", "line 2, column 7:", "R of 0");
    check_refused("G21\nG2 X1 R5 I1", "line 2, column 7:", "not both");
    check_refused("G21\nG2 X1 I0 J0", "line 2, column 1:", "no radius");
    check_refused("G21\nG2 I1 P0.5", "line 2, column 7:", "no whole number");
}

#[test]
fn positions_are_a_step_apart_and_never_twice() {
    let positions = |program: &str, step: f64| {
        let mut sampler = Sampler::new(step);
        moves(program)
            .iter()
            .flat_map(|next| sampler.positions(next))
            .collect::<Vec<_>>()
    };
    let row = |xs: &[f64]| xs.iter().map(|&x| [x, 0.0, 0.0]).collect::<Vec<_>>();
    assert_eq!(positions("G21 G1 X3", 1.0), row(&[0.0, 1.0, 2.0, 3.0]));
    assert_eq!(positions("G21 G1 X3", 1.2), row(&[0.0, 1.0, 2.0, 3.0]));
    assert_eq!(positions("G21 G1 X1\nX1\nX2", 5.0), row(&[0.0, 1.0, 2.0]));
    assert_eq!(positions("G21 G1 X0\nX0", 5.0), row(&[0.0]));
    assert_eq!(positions("", 5.0), row(&[]));
    // Tenths: no part more for the rounding of a division.
    assert_eq!(positions("G21 G1 X0.3", 0.1).len(), 4);
    assert_eq!(positions("G21 G1 X10000", 0.1).len(), 100_001);
    // A gap (a rapid left out) is not filled, and the move after it begins with its start.
    let mut sampler = Sampler::new(10.0);
    let path: Vec<_> = moves("G21 G1 X1\nG0 X5\nG1 X6")
        .iter()
        .filter(|next| next.motion != Motion::Rapid)
        .flat_map(|next| sampler.positions(next))
        .collect();
    assert_eq!(path, row(&[0.0, 1.0, 5.0, 6.0]));
}

proptest! {
    /// An arc made of a centre, a radius, two angles and a plane comes back from its words, by I, J, K as by R.
    #[test]
    fn arcs_survive_being_written_and_read(
        plane in 0_usize..3, centre in prop::array::uniform3(-50.0..50.0_f64), radius in 0.5..40.0_f64, from in 0.0..TAU,
        turned in 0.05..TAU - 0.05, counterclockwise: bool, rise in -5.0..5.0_f64, step in 0.05..2.0_f64,
    ) {
        let [first, second, normal] = [[0, 1, 2], [2, 0, 1], [1, 2, 0]][plane];
        let sense = if counterclockwise { 1.0 } else { -1.0 };
        let point = |part: f64| {
            let mut point = centre;
            point[first] += radius * (from + sense * turned * part).cos();
            point[second] += radius * (from + sense * turned * part).sin();
            point[normal] += rise * part;
            point
        };
        let (start, end) = (point(0.0), point(1.0));
        let offset = [0, 1, 2].map(|axis| centre[axis] - start[axis]);
        let letters = [first, second].map(|axis| format!("{}{:.9}", ["I", "J", "K"][axis], offset[axis]));
        let signed = if turned > PI { -radius } else { radius };
        let ends = format!(
            "{} G0 X{:.9} Y{:.9} Z{:.9}\n{} X{:.9} Y{:.9} Z{:.9}",
            ["G17", "G18", "G19"][plane], start[0], start[1], start[2],
            if counterclockwise { "G3" } else { "G2" }, end[0], end[1], end[2],
        );
        for centre_words in [format!("{} {}", letters[0], letters[1]), format!("R{signed:.9}")] {
            let arc = last(&format!("{ends} {centre_words}"));
            // R is badly conditioned near a half circle: there a billionth of a millimetre moves the centre a thousand times more.
            let tolerance = if centre_words.starts_with('R') { 1e-3 } else { 1e-6 };
            prop_assert!((arc.length - (radius * turned).hypot(rise)).abs() < tolerance);
            let samples: Vec<_> = Sampler::new(step).positions(&arc).collect();
            prop_assert_eq!(samples[0], arc.start);
            prop_assert_eq!(*samples.last().unwrap(), arc.end);
            let count = samples.len() - 1;
            for (index, sample) in samples.iter().enumerate() {
                let expected = point(f64::from(u32::try_from(index).unwrap()) / f64::from(u32::try_from(count).unwrap()));
                for axis in 0..3 {
                    prop_assert!((sample[axis] - expected[axis]).abs() < tolerance, "{:?} {:?}", sample, expected);
                }
            }
            let chords: f64 = samples.windows(2).map(|pair| {
                (0..3).map(|axis| (pair[1][axis] - pair[0][axis]).powi(2)).sum::<f64>().sqrt()
            }).inspect(|chord| assert!(*chord <= step * (1.0 + 1e-9))).sum();
            prop_assert!(chords <= arc.length + 1e-9 && chords > arc.length * 0.6);
        }
    }
}
