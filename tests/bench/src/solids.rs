//! `union3d-bench solids`: latencies, batches and memory of the engine of solids alone.

use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use union3d::engine::solids::{Body, Effect, Engine, Shape, SolidId, Stock, Totals};
use union3d::geometry::Bounds;
use union3d::geometry::convex::{Cutter, End, Fit, Point, Solid};
use union3d::toolpath::{Event, Interpreter, Move, Options, Plane};

use super::failure::{Failure, about};
use super::figures::{Latencies, float, parse_count};
use super::machine::resident;
use super::progress;
use super::random::Random;
use super::table::{Cell, Report, Table, figure, text};

/// Lattice steps in a millimetre.
const STEPS_PER_MM: f64 = 10_000.0;

/// Above the stock, which ends at 0: the common top of all sweeps. Units: steps.
const TOP: i32 = 20_000;

/// Arcs are cut into chords no farther from them than this. Units: mm.
const CHORD_HEIGHT: f64 = 0.02;

/// Measure the engine of solids in this process: inserts, deletions, batches, memory
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Measures the engine of solids alone, in this process: no server, no disk.

Inserts one by one, with the latency of each and all totals current after it; deletions from the full scene, each of which is taken back; the whole \
set as one batch on one and two threads; and memory. Lattice steps of a ten-thousandth of a millimetre. Every way to a set of solids must give the \
same totals, and deleting everything none; otherwise the command fails.",
    after_long_help = "Examples:
  union3d-bench solids
  union3d-bench solids --solids 20k --program part.nc --diameter 3.175"
)]
pub(crate) struct Args {
    /// Solids in a set of a random workload or of a raster.
    #[arg(long, value_name = "COUNT", default_value = "10k", value_parser = parse_count)]
    solids: usize,
    /// A program in G-code instead, milled with a flat cutter of 24 sides: what it sweeps below z = 0.
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// Diameter of the cutter of the program, in mm.
    #[arg(long, value_name = "MM", default_value_t = 3.175)]
    diameter: f64,
    /// Solids that are deleted and inserted again.
    #[arg(long, value_name = "COUNT", default_value = "1k", value_parser = parse_count)]
    deletions: usize,
    /// Where the random numbers begin.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Bodies in the order in which they come, perhaps cut from a stock.
struct Work {
    name: String,
    bodies: Vec<Body>,
    stock: Option<Stock>,
}

/// Runs `union3d-bench solids`.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let mut table = Table::new(
        "The engine of solids",
        "Insert and delete: microseconds, p50 / p99 / p99.9. Batch: all solids as one change, seconds. Bytes: what is kept for each solid, \
         without what is prepared; resident: the same as the system counts it, with the allocator's own.",
        [
            ("workload", "workload"),
            ("solids", "solids"),
            ("covered", "parts covered"),
            ("insert_p50_us", "insert"),
            ("insert_p99_us", "p99"),
            ("insert_p999_us", "p99.9"),
            ("delete_p50_us", "delete"),
            ("delete_p99_us", "p99"),
            ("delete_p999_us", "p99.9"),
            ("whole_s", "whole, s"),
            ("batch_1_s", "batch, 1 thread"),
            ("batch_2_s", "2 threads"),
            ("bytes", "bytes a solid"),
            ("resident", "resident"),
        ],
    );
    let bar = progress::work();
    for work in works(args)? {
        bar.set_message(work.name.clone());
        table.push(measure(&work, args, &bar)?);
    }
    bar.finish_and_clear();
    let mut report = Report::new();
    report.push(table);
    report.print(args.json)?;
    Ok(())
}

fn works(args: &Args) -> Result<Vec<Work>, Failure> {
    if let Some(path) = &args.program {
        let bodies = milled(path, args.diameter)?;
        let around = bodies.iter().map(Body::bounds).reduce(|one, other| Bounds {
            min: std::array::from_fn(|axis| one.min[axis].min(other.min[axis])),
            max: std::array::from_fn(|axis| one.max[axis].max(other.max[axis])),
        });
        let around = around.ok_or("the program sweeps nothing below z = 0")?;
        // The outermost cuts reach out of it.
        let inset = steps(args.diameter / 4.0);
        let corner = |ends: [i32; 3], inwards: i64| {
            let [x, y, z] = ends.map(i64::from);
            Point::new([x + inwards, y + inwards, z])
        };
        let min = corner([around.min[0], around.min[1], around.min[2] - 1], inset)?;
        let max = corner([around.max[0], around.max[1], 0], -inset)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let of = |name: String, stock: Option<Stock>| Work {
            name,
            bodies: bodies.clone(),
            stock,
        };
        let stock = Stock::new(Solid::cuboid(min, max)?)?;
        return Ok(vec![
            of(name.to_string(), None),
            of(format!("{name}, from a stock"), Some(stock)),
        ]);
    }
    let of = |name: &str, bodies: Vec<Body>| Work {
        name: name.to_owned(),
        bodies,
        stock: None,
    };
    let ball = End::Round {
        corner_diameter: length_steps(3.175),
        rings: 4,
    };
    Ok(vec![
        of("boxes, rho 1", boxes(args.solids, args.seed)?),
        of(
            "flat, step-over 10 %, 2 mm",
            raster(args.solids, End::Flat, 6.0, 24, 2.0)?,
        ),
        of(
            "ball, step-over 10 %, 0.5 mm",
            raster(args.solids, ball, 3.175, 16, 0.5)?,
        ),
    ])
}

fn measure(work: &Work, args: &Args, bar: &ProgressBar) -> Result<Vec<Cell>, Failure> {
    let bodies = &work.bodies;
    let engine = || Engine::new().with_stock(work.stock.clone());
    let before = resident(std::process::id()).now;
    let mut online = engine();
    let mut inserts = Latencies::with_capacity(bodies.len());
    for (id, body) in (0..).map(SolidId).zip(bodies) {
        let effect = change([], [(id, body.clone())]);
        let begin = Instant::now();
        online.apply(&effect)?;
        inserts.push(begin.elapsed());
        bar.tick();
    }
    let after = resident(std::process::id()).now;
    let size = online.size();
    let totals = online.totals();
    let [_, covered] = online.parts();
    let kept = float((size.solids + size.bins) as u64) / float(bodies.len() as u64);
    let grown = after.saturating_sub(before);
    let grown = float(grown.saturating_sub(size.prepared as u64)) / float(bodies.len() as u64);
    let deletes = deletions(&mut online, bodies, args)?;
    equal(&online.totals(), &totals)?;
    drop(online);
    let mut batches = Vec::new();
    for threads in [1, 2] {
        let threads = NonZero::new(threads).ok_or("no threads")?;
        let (time, found) = batch(engine().with_threads(threads), bodies)?;
        equal(&found, &totals)?;
        batches.push(time);
    }
    let (inserts, whole) = (inserts.clone().spread(), inserts.sum());
    let deletes = deletes.spread();
    Ok(vec![
        text(work.name.clone()),
        Cell::Count(bodies.len() as u64),
        Cell::Count(covered as u64),
        figure(inserts.p50),
        figure(inserts.p99),
        figure(inserts.p999),
        figure(deletes.p50),
        figure(deletes.p99),
        figure(deletes.p999),
        figure(whole.as_secs_f64()),
        figure(batches[0].as_secs_f64()),
        figure(batches[1].as_secs_f64()),
        figure(kept),
        figure(grown),
    ])
}

/// Deletes some of the bodies, each from the full scene, and inserts it again.
fn deletions(online: &mut Engine, bodies: &[Body], args: &Args) -> Result<Latencies, Failure> {
    let mut random = Random::new(args.seed);
    let mut deletes = Latencies::with_capacity(args.deletions);
    for _ in 0..args.deletions {
        let index = usize::try_from(random.below(bodies.len() as u64))?;
        let one = || (SolidId(index as u64), bodies[index].clone());
        let (delete, insert) = (change([one()], []), change([], [one()]));
        let begin = Instant::now();
        online.apply(&delete)?;
        deletes.push(begin.elapsed());
        online.apply(&insert)?;
    }
    Ok(deletes)
}

/// Inserts all as one change, and deletes them as another.
fn batch(mut engine: Engine, bodies: &[Body]) -> Result<(Duration, Totals), Failure> {
    let nothing = engine.totals();
    let all: Vec<_> = (0..).map(SolidId).zip(bodies.iter().cloned()).collect();
    let effect = change([], all.clone());
    let begin = Instant::now();
    engine.apply(&effect)?;
    let time = begin.elapsed();
    let totals = engine.totals();
    engine.apply(&change(all, []))?;
    equal(&engine.totals(), &nothing)?;
    Ok((time, totals))
}

fn change(
    deleted: impl IntoIterator<Item = (SolidId, Body)>,
    inserted: impl IntoIterator<Item = (SolidId, Body)>,
) -> Effect {
    Effect {
        deleted: deleted.into_iter().collect(),
        inserted: inserted.into_iter().collect(),
    }
}

fn equal(found: &Totals, expected: &Totals) -> Result<(), Failure> {
    if found == expected {
        Ok(())
    } else {
        Err("one set of solids has two totals".into())
    }
}

/// Boxes with a side of 2 mm, as many in a volume as fill it once.
fn boxes(count: usize, seed: u64) -> Result<Vec<Body>, Failure> {
    const SIDE: i64 = 20_000;
    let mut random = Random::new(seed);
    let room = steps(float(count as u64).cbrt() * 2.0)
        .max(1)
        .cast_unsigned();
    let corner = |random: &mut Random| [0; 3].map(|_: i64| random.below(room).cast_signed());
    (0..count)
        .map(|_| {
            let low = corner(&mut random);
            let (a, b) = (Point::new(low)?, Point::new(low.map(|at| at + SIDE))?);
            Ok(Body::cuboid(a, b)?)
        })
        .collect()
}

/// A square milled back and forth in moves of this length, a tenth of the diameter from line to line.
fn raster(
    count: usize,
    end: End,
    diameter: f64,
    sides: u16,
    length: f64,
) -> Result<Vec<Body>, Failure> {
    let shape = cutter(end, diameter, sides, 20.0)?;
    let shape = Arc::new(Shape::new(vec![shape])?);
    let over = diameter / 10.0;
    let width = (float(count as u64) * length * over).sqrt();
    let moves = (width / length).ceil().max(1.0);
    let mut at = [0.0; 3];
    let mut bodies = Vec::with_capacity(count);
    let mut way = length;
    while bodies.len() < count {
        let next = [at[0] + way, at[1], 0.0];
        bodies.push(Body::swept(&shape, point(at)?, point(next)?)?);
        at = next;
        let is_end = at[0] > (moves - 0.5) * length || at[0] < 0.5 * length;
        if is_end && bodies.len() < count {
            let next = [at[0], at[1] + over, 0.0];
            bodies.push(Body::swept(&shape, point(at)?, point(next)?)?);
            at = next;
            way = -way;
        }
    }
    Ok(bodies)
}

/// What a program sweeps below z = 0, whose cutter reaches up to a common top.
fn milled(path: &Path, diameter: f64) -> Result<Vec<Body>, Failure> {
    let program = std::fs::read(path).map_err(about(path))?;
    let flat = cutter(End::Flat, diameter, 24, 1.0)?;
    let shape = Arc::new(Shape::new(vec![flat])?.with_top(TOP));
    let mut bodies = Vec::new();
    for event in Interpreter::new(program, Options::default()) {
        let Event::Move(next) = event? else { continue };
        let mut from = next.start;
        for to in ends(&next) {
            if from[2].min(to[2]) < 0.0 {
                let (from, to) = (point(below(from, to))?, point(below(to, from))?);
                if from != to {
                    bodies.push(Body::swept(&shape, from, to)?);
                }
            }
            from = to;
        }
    }
    Ok(bodies)
}

/// Where the chords of a move end.
fn ends(next: &Move) -> Vec<[f64; 3]> {
    let Some(center) = next.center() else {
        return vec![next.end];
    };
    let axes = next.plane().map_or([0, 1], Plane::axes);
    let [a, b] = axes.map(|axis| next.start[axis] - center[axis]);
    let radius = a.hypot(b);
    let angle = 2.0 * (1.0 - (CHORD_HEIGHT / radius).min(1.0)).acos();
    next.positions((radius * angle).max(CHORD_HEIGHT)).collect()
}

/// A point, or where the way to another one crosses z = 0 if the point is above.
fn below(at: [f64; 3], other: [f64; 3]) -> [f64; 3] {
    if at[2] <= 0.0 {
        return at;
    }
    let part = other[2] / (other[2] - at[2]);
    let mix = |axis: usize| other[axis] + (at[axis] - other[axis]) * part;
    [mix(0), mix(1), 0.0]
}

fn cutter(end: End, diameter: f64, sides: u16, length: f64) -> Result<Solid, Failure> {
    let cutter = Cutter {
        end,
        diameter: length_steps(diameter),
        length: length_steps(length),
        sides,
        fit: Fit::EqualArea,
    };
    Ok(cutter.solid()?.0)
}

fn point(at: [f64; 3]) -> Result<Point, Failure> {
    Ok(Point::new(at.map(steps))?)
}

/// Millimetres in steps, rounded.
fn steps(mm: f64) -> i64 {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "it saturates, and points are checked"
    )]
    let steps = (mm * STEPS_PER_MM).round() as i64;
    steps
}

/// A length in steps; one that is none is refused as a diameter of 0 is.
fn length_steps(mm: f64) -> u32 {
    u32::try_from(steps(mm)).unwrap_or(0)
}
