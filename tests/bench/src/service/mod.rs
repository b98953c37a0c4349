//! `union3d-bench service`: a real server process on a real disk, and clients on the same machine.
//!
//! ```text
//!   bodies made beforehand ──> load: clients on one thread ──link, grpc──> server: `union3d serve`, durable
//!          └── throughput, queries, large, restart: a table each ──┘
//! ```

mod args;
mod bodies;
mod disk;
mod grpc;
mod large;
mod link;
mod load;
mod queries;
mod restart;
mod scene;
mod server;
mod setup;
mod throughput;
mod work;

use std::time::Duration;

pub(crate) use self::args::Args;
use self::args::Part;
use self::disk::{APPEND_BYTES, APPENDS, sync_us};
use self::setup::Setup;
use self::work::Work;
use super::failure::{Failure, about};
use super::machine::file_system;
use super::progress;
use super::table::Report;

/// Runs `union3d-bench service`.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    args.check()?;
    let work = Work::new(args)?;
    let mut report = Report::new();
    let data = tempfile::Builder::new()
        .prefix("union3d-bench-")
        .tempdir_in(&args.data)
        .map_err(about(&args.data))?;
    report.remark(format!(
        "Data on {}; an append of {APPEND_BYTES} bytes and fdatasync there takes {:.0} us (median of {APPENDS}): no durable change is faster. \
         Server and clients share the machine; the clients are one thread.",
        file_system(data.path()),
        sync_us(data.path())?
    ));
    let setup = Setup {
        time: match work {
            Work::Program(..) => Duration::MAX,
            Work::Cubes | Work::Raster(_) => Duration::from_secs_f64(args.seconds),
        },
        work,
        data: data.path(),
        bar: progress::work(),
        args,
        program: match &args.server {
            Some(program) => program.clone(),
            None => server::beside_this()?,
        },
    };
    if args.wants(Part::Throughput) {
        report.push(throughput::measure(&setup)?);
    }
    if args.wants(Part::Queries) {
        report.push(queries::measure(&setup)?);
    }
    if args.wants(Part::Large) {
        report.push(large::measure(&setup)?);
    }
    if args.wants(Part::Restart) {
        report.push(restart::measure(&setup)?);
    }
    setup.bar.finish_and_clear();
    report.print(args.json)?;
    Ok(())
}
