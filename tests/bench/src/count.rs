//! `union3d-bench count`: a fixed piece of work for a counter of instructions.

use clap::ValueEnum;
use union3d::geometry::{Edge, Totals};

use super::cubes::numbered;
use super::failure::Failure;
use super::figures::parse_count;
use super::sets::{Online, Set};
use super::workload::{EDGE_STEPS, Workload};

/// Do a fixed piece of work, for a counter of instructions
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Makes the cubes of a workload, inserts them one by one, and deletes them, oldest first; ends at --until. The instructions of \
an insert or a delete are the difference between two runs, divided by the number of cubes: tests/bench/instructions does so."
)]
pub(crate) struct Args {
    /// How the cubes lie.
    #[arg(long, value_enum, value_name = "NAME")]
    workload: Workload,
    /// How many.
    #[arg(long, value_name = "COUNT", default_value = "10k", value_parser = parse_count)]
    cubes: usize,
    /// Where to end.
    #[arg(long, value_enum)]
    until: Until,
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, ValueEnum)]
enum Until {
    /// The cubes are made, and a set is.
    Made,
    /// They are in the set.
    Inserted,
    /// They have been deleted.
    Deleted,
}

/// Runs `union3d-bench count`.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let edge = Edge::new(EDGE_STEPS)?;
    let cubes = numbered(args.workload.places(edge, args.cubes, 1)?);
    let mut set = Online::new(edge);
    if args.until >= Until::Inserted {
        set.insert_all(&cubes);
    }
    if args.until >= Until::Deleted {
        set.delete_all(&cubes);
        if set.engine.totals() != Totals::default() {
            return Err("something is left when all is deleted".into());
        }
    }
    println!("{}", set.len());
    // Dropping the set is no part of the work.
    std::mem::forget(set);
    Ok(())
}
