//! The path against `rs274`, the interpreter of `LinuxCNC` itself, motion by motion: on the programs that come with it and on
//! random ones. Needs Debian's package linuxcnc-uspace, which `tests/run` installs; without it these tests say so and pass.
//!
//! Both sides have the same tools and start with all work systems at the machine's zero. Where one of them stops, what came before
//! must agree; why they part company stands in [`DIFFERENCES`], and a difference that is not there is a fault.

mod grammar;
mod judge;
mod motions;
#[path = "../oracle/random.rs"]
mod random;

use std::fs;
use std::path::{Path, PathBuf};

use judge::Judge;

const PROGRAMS: &str = "/usr/share/linuxcnc/ncfiles";

/// How many random programs are compared.
const RANDOM_PROGRAMS: u64 = 400;

/// Where the two differ: words of the refusal (`ours:` or `judge:`) or the program, and why.
const DIFFERENCES: [(&str, &str); 23] = [
    (
        "program: mmount.ngc",
        "after T, M6 and G43 on one line the stand-alone judge takes the tip to be as high as before",
    ),
    (
        "program: skeleton.ngc",
        "after T, M6 and G43 on one line the stand-alone judge takes the tip to be as high as before",
    ),
    (
        "program: random 262",
        "an outside corner between a line and an arc that nearly turns back is taken for an inside one there",
    ),
    (
        "ours: only the axes X, Y and Z",
        "rotary axes are refused here, followed there",
    ),
    (
        "ours: probing is not supported",
        "there a probe touches at once, at a place nobody knows",
    ),
    ("ours: threading in step with the spindle", "for lathes"),
    ("ours: a cycle of lathes", "for lathes"),
    ("ours: threading (lathes)", "for lathes"),
    ("ours: a word of lathes", "for lathes"),
    (
        "ours: cutter compensation is supported in the plane XY only",
        "in the plane ZX it is for lathes",
    ),
    (
        "ours: cutter compensation must begin with a straight move",
        "there an arc may begin it, and becomes a spiral",
    ),
    (
        "ours: arcs in turned coordinates go in the plane XY only",
        "there the arc is run in the plane as if it were not turned, and ends elsewhere",
    ),
    (
        "ours: is kept by the machine",
        "there parameters of the machine may be overwritten",
    ),
    (
        "ours: is not known here: it comes from the machine",
        "what a probe or an input says",
    ),
    (
        "ours: the diameter of tool",
        "there a tool that is not in the table has diameter 0",
    ),
    (
        "ours: this word is not known",
        "words of a remapped machine",
    ),
    (
        "ours: nothing on the line uses it",
        "there words of arcs may stand on straight moves",
    ),
    (
        "judge: no percent sign or program end",
        "a file may end without M2 here",
    ),
    (
        "judge: not found in the tool table",
        "a tool without a length or a diameter may be loaded here",
    ),
    (
        "judge: Unknown m code used",
        "M100 to M199 run programs of the machine there, and are reported here",
    ),
    (
        "judge: Named parameter",
        "a parameter nobody set: refused here where it is read",
    ),
    (
        "judge: Unable to open file",
        "a subprogram of another directory",
    ),
    (
        "judge: Spindle not turning",
        "cycles that stop the spindle may be run with it stopped here",
    ),
];

/// What a comparison says.
enum Outcome {
    /// Both came to the end with the same motions, so many.
    Same(usize),
    /// One or both stopped, for a reason that stands in the list, and agree until then.
    Explained(&'static str),
    /// Neither.
    Differs(String),
}

fn compare(judge: &Judge, path: &Path, name: &str) -> Outcome {
    let verdict = judge.run(path);
    let (ours, fault) = motions::ours(path);
    let reasons = [
        fault.as_ref().map(|fault| format!("ours: {fault}")),
        verdict
            .error
            .as_ref()
            .map(|error| format!("judge: {error}")),
        Some(format!("program: {name}.")),
    ];
    let explained = DIFFERENCES.iter().find(|(words, _)| {
        let (side, words) = words.split_once(": ").unwrap();
        reasons.iter().flatten().any(|reason| {
            reason
                .strip_prefix(side)
                .is_some_and(|reason| reason.contains(words))
        })
    });
    // What came before the earlier stop; compensation holds back one move more or less then.
    let stopped = fault.is_some() || verdict.error.is_some();
    let difference = motions::difference(&verdict.motions, &ours, stopped);
    match (difference, explained) {
        (None, _) if !stopped => Outcome::Same(verdict.motions.len()),
        (None, _) if fault.is_some() && verdict.error.is_some() => {
            Outcome::Explained("both refuse it")
        }
        (None, Some((_, why))) => Outcome::Explained(why),
        (Some(_), Some((words, why))) if words.starts_with("program") => Outcome::Explained(why),
        (difference, _) => Outcome::Differs(format!(
            "{name}: judge stopped: {:?}\n          we stopped: {fault:?}\n          {}",
            verdict.error,
            difference.unwrap_or_default()
        )),
    }
}

/// The judge, or none when it is not installed.
fn judge() -> Option<Judge> {
    let judge = Judge::new();
    if judge.is_none() {
        eprintln!("not compared: there is no rs274 here (Debian's package linuxcnc-uspace)");
    }
    judge
}

/// Compares all, prints what it found, and fails on what is not explained.
fn check(judge: &Judge, programs: impl Iterator<Item = (PathBuf, String)>) {
    let (mut same, mut moving, mut motions, mut explained) = (0, 0, 0, 0);
    let mut differences = Vec::new();
    for (path, name) in programs {
        match compare(judge, &path, &name) {
            Outcome::Same(count) => {
                same += 1;
                moving += usize::from(count > 0);
                motions += count;
            }
            Outcome::Explained(why) => {
                explained += 1;
                println!("{name}: {why}");
            }
            Outcome::Differs(difference) => differences.push(difference),
        }
    }
    println!(
        "{same} programs agree to their end ({moving} of them move: {motions} motions), {explained} differ for a stated reason"
    );
    assert!(
        differences.is_empty(),
        "{} differ:\n{}",
        differences.len(),
        differences.join("\n")
    );
}

#[test]
fn the_programs_of_linuxcnc_move_alike() {
    let Some(judge) = judge() else {
        return;
    };
    let mut open = vec![PathBuf::from(PROGRAMS)];
    let mut files = Vec::new();
    while let Some(directory) = open.pop() {
        for entry in fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|extension| extension == "ngc") {
                files.push(path);
            }
        }
    }
    files.sort();
    assert!(files.len() > 50, "{}", files.len());
    check(
        &judge,
        files.into_iter().map(|path| {
            let name = path.strip_prefix(PROGRAMS).unwrap().display().to_string();
            (path, name)
        }),
    );
}

#[test]
fn random_programs_move_alike() {
    let Some(judge) = judge() else {
        return;
    };
    let directory = tempfile::tempdir().unwrap();
    check(
        &judge,
        (1..=RANDOM_PROGRAMS).map(|seed| {
            let path = directory.path().join(format!("{seed}.ngc"));
            fs::write(&path, grammar::program(seed)).unwrap();
            (path, format!("random {seed}"))
        }),
    );
}
