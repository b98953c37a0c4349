//! `union3d-bench union3`: Table 1 of UNION3's paper, twenty million random cubes.

use std::num::NonZero;
use std::process::Command;
use std::time::Instant;

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use union3d::engine::{EngineSize, recount};
use union3d::geometry::{CubeId, Edge, Effect, Measures, Place, VertexKind};

use super::expected::{self, Rows};
use super::failure::Failure;
use super::figures::{float, float_of_wide, median, parse_count};
use super::machine::{Resident, resident};
use super::progress;
use super::random::Random;
use super::sets::{Online, Set};
use super::table::{Cell, Report, Table, figure, text};
use super::workload::side;

/// The paper's cubes, their edge and the side of their box. Units: the edge is 30 of the side's 32,768.
const PAPER_CUBES: usize = 20_000_000;
const PAPER_EDGE: f64 = 30.0 / 32_768.0;

/// How many lattice steps make one of the paper's: so many that features hardly ever coincide, as in a continuous box; and the edge
/// still fits the engine's fast path.
const STEPS_PER_PAPER_STEP: i64 = 1_000;
const EDGE_STEPS: i64 = 30 * STEPS_PER_PAPER_STEP;

/// What the paper printed, in the unit of the box's side.
/// # Source
/// W. R. Franklin, "Analysis of mass properties of the union of millions of polyhedra", 2004, Table 1.
const PRINTED: Rows = Rows {
    volume: 0.009,
    area: 99.053,
    edge_length: 219_708.0,
    corners: 157_561_445.0,
    edge_face: 7_259_255.0,
    three_face: 37_170.0,
};

/// The part of a row that the paper may be off without being called wrong: it summed floats. Edge lengths hardly vary from set to set (what a pair of
/// cubes hides of each other's edges is as long as what their faces make), so there standard errors alone would be too strict.
const PRINTED_PRECISION: f64 = 1e-4;

/// CPU seconds that the paper's program took.
const PAPER_SECONDS: f64 = 8_300.0;

/// Boxes from which standard errors are estimated, and how much smaller they are.
const SAMPLES: u64 = 48;
const SAMPLE_PART: usize = 1_000;
const SAMPLE_CUBES_MIN: usize = 500;

/// More standard errors than this, and a row disagrees.
const ERRORS_MAX: f64 = 5.0;

/// Measure Table 1 of UNION3's paper: 20,000,000 random cubes
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Inserts 20,000,000 random cubes, the edge 30/32768 of the side of their box, as in Table 1 of W. R. Franklin, \"Analysis of \
mass properties of the union of millions of polyhedra\", 2004: in one batch on one thread, on two, and one by one, each in a process \
of its own. All three must give the same exact totals.

Prints every row of the table beside what the paper printed, the paper's formula, and the expectation for a box with borders, from which \
the result must not be off by more than five standard errors (estimated from smaller boxes at the same density). With another number of \
cubes the density stays the same, and there is nothing printed to compare with."
)]
pub(crate) struct Args {
    /// Cubes.
    #[arg(long, value_name = "COUNT", default_value = "20M", value_parser = parse_count)]
    cubes: usize,
    /// How often each way is measured; the median is printed.
    #[arg(long, value_name = "COUNT", default_value = "1", value_parser = parse_count)]
    runs: usize,
    /// Where the random numbers begin.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print JSON.
    #[arg(long)]
    json: bool,
    /// Measure one way in this process: what the command starts for each.
    #[arg(long, value_enum, hide = true)]
    way: Option<Way>,
}

/// How the cubes go in.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Way {
    Batch1,
    Batch2,
    OneByOne,
}

/// What one way gives: printed by one process and read by the other.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Measured {
    seconds: f64,
    ids_bytes: usize,
    grid_bytes: usize,
    resident: Resident,
    /// Everything that is exact, as text: it only has to be equal.
    totals: String,
    rows: [f64; 6],
    degenerate: i64,
}

/// Runs `union3d-bench union3`.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    if let Some(way) = args.way {
        let outcome = measure(way, args.cubes, args.seed)?;
        println!("{}", serde_json::to_string(&outcome)?);
        return Ok(());
    }
    let mut report = Report::new();
    let bar = progress::work();
    let mut times = Table::new(
        format!(
            "{} random cubes at the density of UNION3's Table 1",
            super::table::grouped(args.cubes)
        ),
        "Each way in a process of its own. `peak` is the greatest resident memory of that process, the list of cubes of the one batch \
         (24 bytes each) included. Medians.",
        [
            ("way", "way"),
            ("seconds", "seconds"),
            ("million_per_second", "M/s"),
            ("times_faster_than_paper", "x the paper's 8,300 CPU s"),
            ("grid_bytes_per_cube", "grid B"),
            ("bytes_per_cube", "all B"),
            ("peak_bytes_per_cube", "peak B"),
            ("peak_gib", "peak GiB"),
        ],
    );
    let mut first: Option<Measured> = None;
    for (way, name) in [
        (Way::Batch1, "one batch, one thread"),
        (Way::Batch2, "one batch, two threads"),
        (Way::OneByOne, "one by one"),
    ] {
        let mut runs = Vec::new();
        for number in 1..=args.runs {
            bar.set_message(format!("{name}, run {number} of {}", args.runs));
            let outcome = in_a_process(way, args)?;
            let equal = first.get_or_insert_with(|| outcome.clone());
            if equal.totals != outcome.totals {
                return Err(format!("{name}: totals differ from those of one batch").into());
            }
            runs.push(outcome);
        }
        let seconds = median(runs.iter().map(|run| run.seconds));
        let peak = median(runs.iter().map(|run| float(run.resident.peak)));
        let (run, cubes) = (&runs[0], float(args.cubes as u64));
        let all = run.grid_bytes + run.ids_bytes;
        times.push(vec![
            text(name),
            figure(seconds),
            figure(cubes / seconds / 1e6),
            if args.cubes == PAPER_CUBES {
                figure(PAPER_SECONDS / seconds)
            } else {
                Cell::Nothing
            },
            figure(float(run.grid_bytes as u64) / cubes),
            figure(float(all as u64) / cubes),
            figure(peak / cubes),
            figure(peak / 1_073_741_824.0),
        ]);
    }
    bar.set_message("standard errors");
    let found = first.expect("there are three ways");
    let errors = standard_errors(args.cubes, args.seed)?;
    let (table, agree) = compare(args, &found, errors)?;
    bar.finish_and_clear();
    report.remark(format!(
        "Random places from seed {}; {} features coincide on the lattice ({EDGE_STEPS} steps an edge).",
        args.seed, found.degenerate
    ));
    report.push(times);
    report.push(table);
    report.print(args.json)?;
    if agree {
        Ok(())
    } else {
        Err("a row of the table is not what is expected".into())
    }
}

/// Every row beside the paper's and the formulas; and whether all are as expected.
fn compare(args: &Args, found: &Measured, errors: [f64; 6]) -> Result<(Table, bool), Failure> {
    let mut table = Table::new(
        "Table 1",
        "Lengths in sides of the box. `formula` is the paper's, without borders; `expected` is for a box with borders; `off` in standard \
         errors from that. The volume that the paper printed contradicts its own formula (and its 0.00916 for the edge is 30/32768 = 0.000916): \
         a misprint. A printed \
         value agrees when it is within five standard errors or a ten-thousandth of the formula.",
        [
            ("measure", "measure"),
            ("printed", "paper printed"),
            ("formula", "formula"),
            ("expected", "expected"),
            ("found", "found"),
            ("standard_error", "standard error"),
            ("off_standard_errors", "off"),
            ("verdict", "verdict"),
        ],
    );
    let names = [
        "union volume",
        "union area",
        "edge length",
        "corners",
        "edge-face vertices",
        "three-face vertices",
    ];
    let cubes = float(args.cubes as u64);
    let edge = float(u64::try_from(EDGE_STEPS)?) / float(u64::try_from(box_side(args.cubes)?)?);
    let formula = expected::without_borders(cubes, edge).values();
    let expected = expected::with_borders(cubes, edge).values();
    let mut agree = true;
    for (row, name) in names.into_iter().enumerate() {
        let off = (found.rows[row] - expected[row]) / errors[row];
        agree &= off.abs() <= ERRORS_MAX;
        let printed_off = (PRINTED.values()[row] - formula[row]).abs();
        let paper_agrees =
            printed_off <= (ERRORS_MAX * errors[row]).max(PRINTED_PRECISION * formula[row].abs());
        let verdict = match (off.abs() <= ERRORS_MAX, args.cubes == PAPER_CUBES) {
            (false, _) => "NOT as expected",
            (true, false) => "as expected",
            (true, true) if paper_agrees => "as expected, paper agrees",
            (true, true) => "as expected, paper misprinted",
        };
        let wide = |value: f64| Cell::Figure(value, 6);
        table.push(vec![
            text(name),
            if args.cubes == PAPER_CUBES {
                wide(PRINTED.values()[row])
            } else {
                Cell::Nothing
            },
            wide(formula[row]),
            wide(expected[row]),
            wide(found.rows[row]),
            figure(errors[row]),
            figure(off),
            text(verdict),
        ]);
    }
    Ok((table, agree))
}

fn in_a_process(way: Way, args: &Args) -> Result<Measured, Failure> {
    let value = way.to_possible_value().expect("no way is skipped");
    let (cubes, seed) = (args.cubes.to_string(), args.seed.to_string());
    let output = Command::new(std::env::current_exe()?)
        .args(["union3", "--way", value.get_name()])
        .args(["--cubes", &cubes, "--seed", &seed])
        .output()?;
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into_owned().into());
    }
    Ok(serde_json::from_slice(&output.stdout)?)
}

fn measure(way: Way, cubes: usize, seed: u64) -> Result<Measured, Failure> {
    let edge = Edge::new(EDGE_STEPS)?;
    let mut places = places(edge, cubes, box_side(cubes)?, seed);
    let threads = NonZero::new(if way == Way::Batch2 { 2 } else { 1 });
    let mut set = Online::threaded(edge, threads.expect("it is not zero"));
    let seconds = match way {
        Way::OneByOne => {
            // The places are made on the way, so that memory is the engine's alone; that takes some nanoseconds each.
            let started = Instant::now();
            for id in (0..cubes as u64).map(CubeId) {
                set.insert((id, places()));
            }
            started.elapsed()
        }
        Way::Batch1 | Way::Batch2 => {
            let ids = (0..cubes as u64).map(CubeId);
            let effect = Effect {
                deleted: Vec::new(),
                inserted: ids.map(|id| (id, places())).collect(),
            };
            let started = Instant::now();
            set.engine.apply(&effect)?;
            started.elapsed()
        }
    };
    let resident = resident(std::process::id());
    let EngineSize { ids, grid } = set.engine.size();
    let totals = set.engine.totals();
    let outcome = Measured {
        seconds: seconds.as_secs_f64(),
        ids_bytes: ids,
        grid_bytes: grid,
        resident,
        totals: format!("{totals:?}"),
        rows: rows(&totals.measures, cubes)?,
        degenerate: totals.measures.vertices_of(VertexKind::Degenerate),
    };
    // Tearing down so many cubes takes a while and proves nothing.
    std::mem::forget(set);
    Ok(outcome)
}

/// Side of the box at the paper's density; of the paper's number of cubes it is the paper's side. Units: steps.
fn box_side(cubes: usize) -> Result<i64, union3d::geometry::InvalidEdge> {
    let rho = float(PAPER_CUBES as u64) * PAPER_EDGE.powi(3);
    Ok(side(Edge::new(EDGE_STEPS)?, cubes, rho))
}

/// Places one after the other.
fn places(edge: Edge, cubes: usize, side: i64, seed: u64) -> impl FnMut() -> Place {
    let mut random = Random::new(seed);
    let min = -side / 2;
    assert!(cubes > 0 && side > 0, "there is a box");
    move || {
        let corner = [0; 3].map(|_: i64| random.within(min, min + side - 1));
        Place::new(corner, edge)
            .expect("the box of 2^31 cubes at this density is within the lattice")
    }
}

/// The rows of the table, in sides of the box.
fn rows(measures: &Measures, cubes: usize) -> Result<[f64; 6], Failure> {
    let side = float(u64::try_from(box_side(cubes)?)?);
    let vertices = |kind| float_of_wide(measures.vertices_of(kind).into());
    Ok(Rows {
        volume: float_of_wide(measures.volume) / side.powi(3),
        area: float_of_wide(measures.area()) / side.powi(2),
        edge_length: float_of_wide(measures.edge_length_total()) / side,
        corners: vertices(VertexKind::Corner),
        edge_face: vertices(VertexKind::EdgeFace),
        three_face: vertices(VertexKind::ThreeFace),
    }
    .values())
}

/// How far a row is usually off: from the variance in smaller boxes at the same density, which grows with the number of cubes.
fn standard_errors(cubes: usize, seed: u64) -> Result<[f64; 6], Failure> {
    let edge = Edge::new(EDGE_STEPS)?;
    let sample_cubes = (cubes / SAMPLE_PART).max(SAMPLE_CUBES_MIN);
    let sample_side = box_side(sample_cubes)?;
    let scale = float(u64::try_from(sample_side)?) / float(u64::try_from(box_side(cubes)?)?);
    let mut samples = Vec::new();
    for sample in 0..SAMPLES {
        // Far from the seeds that somebody would choose.
        let seed = seed ^ (0xa5a5 << 32) ^ sample;
        let mut places = places(edge, sample_cubes, sample_side, seed);
        let totals = recount(edge, None, (0..sample_cubes).map(|_| places()));
        samples.push(rows(&totals.measures, sample_cubes)?);
    }
    let ratio = float(cubes as u64) / float(sample_cubes as u64);
    // Sides of the small box to sides of the large one.
    let scales = [scale.powi(3), scale.powi(2), scale, 1.0, 1.0, 1.0];
    let mut errors = [0.0; 6];
    for (row, error) in errors.iter_mut().enumerate() {
        let mean = samples.iter().map(|sample| sample[row]).sum::<f64>() / float(SAMPLES);
        let squares = samples.iter().map(|sample| (sample[row] - mean).powi(2));
        let variance = squares.sum::<f64>() / float(SAMPLES - 1);
        // Where no vertex of a kind was ever found, one is as likely as none.
        let least = if row < 3 { 0.0 } else { 1.0 };
        *error = (variance.sqrt() * scales[row] * ratio.sqrt()).max(least);
    }
    Ok(errors)
}
