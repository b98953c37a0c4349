//! `union3d-bench peers`: our side of a comparison with another program on the same cubes.

use std::path::PathBuf;
use std::time::Instant;

use serde::Serialize;
use union3d::geometry::{CubeId, Edge};

use super::cubes::{numbered, read};
use super::failure::Failure;
use super::figures::{float_of_wide, median, parse_count};
use super::sets::{Online, Set, each};

/// Cubes that are inserted once more, one after the other, each into the same set.
const SINGLE_INSERTS: usize = 1_000;

/// Measure a file of cubes for a comparison with other programs, as JSON
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Measures the cubes of a file and prints one JSON object, for a script that gives the same file to another program: \
tests/bench/peers does so with Manifold.

`batch_seconds`: all cubes but the last, in one change. `insert_seconds`: the last one more, then deleted again, 1,000 times. Medians; no \
start of a process and no reading is in them. `volume` and `area` (in steps) are those of all cubes."
)]
pub(crate) struct Args {
    /// Lower corners in steps, as little-endian 32-bit triplets; at least two.
    #[arg(long, value_name = "FILE")]
    cubes: PathBuf,
    /// Edge of every cube, in steps.
    #[arg(long, value_name = "STEPS")]
    edge: i64,
    /// How often the batch is measured.
    #[arg(long, value_name = "COUNT", default_value = "5", value_parser = parse_count)]
    runs: usize,
}

#[derive(Serialize)]
struct Answer {
    cubes: usize,
    batch_seconds: f64,
    insert_seconds: f64,
    volume: f64,
    area: f64,
}

/// Runs `union3d-bench peers`.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let edge = Edge::new(args.edge)?;
    let cubes = numbered(read(&args.cubes, edge)?);
    let Some((last, batch)) = cubes.split_last().filter(|(_, batch)| !batch.is_empty()) else {
        return Err(format!("{}: one cube is too few", args.cubes.display()).into());
    };
    let mut set = Online::new(edge);
    let mut batches = Vec::new();
    for _ in 0..args.runs {
        set = Online::new(edge);
        let started = Instant::now();
        set.change(&[], batch);
        batches.push(started.elapsed().as_secs_f64());
    }
    let before = set.engine.totals();
    let (mut inserts, first_id) = (Vec::new(), last.0.0);
    for id in (first_id..).map(CubeId).take(SINGLE_INSERTS) {
        let cube = (id, last.1);
        let (_, time) = each([cube].into_iter(), |cube| set.insert(cube));
        inserts.push(time.as_secs_f64());
        set.delete(cube);
    }
    if set.engine.totals() != before {
        return Err("inserting and deleting a cube has changed the totals".into());
    }
    set.insert(*last);
    let measures = set.engine.totals().measures;
    let answer = Answer {
        cubes: cubes.len(),
        batch_seconds: median(batches),
        insert_seconds: median(inserts),
        volume: float_of_wide(measures.volume),
        area: float_of_wide(measures.area()),
    };
    println!("{}", serde_json::to_string(&answer)?);
    Ok(())
}
