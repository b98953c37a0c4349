//! `union3d-bench solids`: latencies, batches and memory of the engine of solids alone.

use std::num::NonZero;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::ValueEnum;
use indicatif::ProgressBar;
use union3d::engine::solids::{Body, Effect, Engine, Shape, SolidId, Stock, Totals};
use union3d::geometry::Bounds;
use union3d::geometry::convex::{Point, Solid};

use super::failure::Failure;
use super::figures::{Latencies, float, parse_count};
use super::machine::resident;
use super::milling::{self, Tool, swept};
use super::progress;
use super::random::Random;
use super::solid_sets::SolidSet;
use super::table::{Cell, Report, Table, figure, text};

/// Above the stock, which ends at 0: the common top of all sweeps. Units: steps.
const TOP: i32 = 20_000;

/// Measure the engine of solids in this process: inserts, deletions, batches, memory
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Measures the engine of solids alone, in this process: no server, no disk.

Inserts one by one, with the latency of each and all totals current after it; deletions from the full scene, each of which is taken back; the whole \
set as one batch on one and two threads; and memory. Lattice steps of a ten-thousandth of a millimetre. Every way to a set of solids must give the \
same totals, and deleting everything none; otherwise the command fails.",
    after_long_help = "Examples:
  union3d-bench solids
  union3d-bench solids --set dome --solids 5k
  union3d-bench solids --program part.nc --diameter 3.175"
)]
pub(crate) struct Args {
    /// Solids in a set.
    #[arg(long, value_name = "COUNT", default_value = "10k", value_parser = parse_count)]
    solids: usize,
    /// Only these sets [default: all].
    #[arg(long, value_enum, value_delimiter = ',', conflicts_with = "program")]
    set: Vec<SolidSet>,
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
        let tool = Tool {
            diameter: args.diameter,
            length: 1.0,
            ..Tool::FLAT
        };
        let sweeps = milling::program(path)?;
        let shape = Shape::new(vec![tool.solid()?])?.with_top(TOP);
        let bodies = swept(&Arc::new(shape), &sweeps)?;
        let Bounds { min, max } = milling::block(&sweeps, args.diameter)?;
        let [min, max] = [min, max].map(|corner| Point::new(corner.map(i64::from)));
        let stock = Stock::new(Solid::cuboid(min?, max?)?)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let of = |name: String, stock: Option<Stock>| Work {
            name,
            bodies: bodies.clone(),
            stock,
        };
        return Ok(vec![
            of(name.to_string(), None),
            of(format!("{name}, from a stock"), Some(stock)),
        ]);
    }
    let sets = match args.set.as_slice() {
        [] => SolidSet::value_variants(),
        some => some,
    };
    let work = |set: &SolidSet| {
        Ok(Work {
            name: set.name().to_owned(),
            bodies: set.bodies(args.solids, args.seed)?,
            stock: None,
        })
    };
    sets.iter().map(work).collect()
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
