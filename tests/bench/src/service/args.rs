//! What can be asked of the benchmark of a server.

use std::path::PathBuf;

use clap::ValueEnum;

use super::bodies::Protocol;
use crate::figures::parse_count;

/// What a change of many cubes is.
const LARGE_CHANGE: usize = 1_000_000;

/// Measure a real server process: throughput, latencies, restart, memory
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Starts `union3d serve` on a temporary data directory, durable as always, and measures it over loopback from this \
process: cubes a second by protocol, cubes in a change and number of clients; queries while a writer is at full speed; small changes \
while another scene takes a million cubes at once; restart after a kill, memory, disk.

What is sent is random cubes, a million of which cover each point once on average; it is encoded before the clock runs. The scene that \
is restarted is as dense, however large. Every scene is compared with what was acknowledged, and the restarted one with a recount.",
    after_long_help = "Examples:
  union3d-bench service --data /var/tmp
  union3d-bench service --part throughput --protocol protobuf --batch 4096 --clients 1,4
  union3d-bench service --part restart --cubes 20M"
)]
pub(crate) struct Args {
    /// Where the temporary data directory is made: on the disk that is to be measured.
    #[arg(long, value_name = "DIRECTORY", default_value = ".")]
    pub(super) data: PathBuf,
    /// The program whose server is measured [default: the union3d beside this executable].
    #[arg(long, value_name = "FILE")]
    pub(super) program: Option<PathBuf>,
    /// Only these parts [default: all].
    #[arg(long, value_enum, value_delimiter = ',')]
    pub(super) part: Vec<Part>,
    /// Only these protocols [default: all].
    #[arg(long, value_enum, value_delimiter = ',')]
    pub(super) protocol: Vec<Protocol>,
    /// Cubes in a change.
    #[arg(long, value_name = "COUNTS", default_value = "1,100,4096,65536", value_parser = parse_count, value_delimiter = ',')]
    pub(super) batch: Vec<usize>,
    /// Clients at a time.
    #[arg(long, value_name = "COUNTS", default_value = "1,4,16,64", value_parser = parse_count, value_delimiter = ',')]
    pub(super) clients: Vec<usize>,
    /// How long each measurement takes.
    #[arg(long, value_name = "SECONDS", default_value_t = 2.0, value_parser = seconds)]
    pub(super) seconds: f64,
    /// How often each measurement is made; the median is printed.
    #[arg(long, value_name = "COUNT", default_value = "3", value_parser = parse_count)]
    pub(super) runs: usize,
    /// Cubes of the scene that is restarted.
    #[arg(long, value_name = "COUNT", default_value = "1M", value_parser = parse_count)]
    pub(super) cubes: usize,
    /// Cubes of the change that small ones are measured beside.
    #[arg(long, value_name = "COUNT", default_value_t = LARGE_CHANGE, value_parser = large)]
    pub(super) large: usize,
    /// Where the random numbers begin.
    #[arg(long, default_value_t = 1)]
    pub(super) seed: u64,
    /// Print JSON.
    #[arg(long)]
    pub(super) json: bool,
}

/// What can be measured by itself.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub(super) enum Part {
    /// Cubes a second and latencies of changes
    Throughput,
    /// Queries with and without a writer at full speed
    Queries,
    /// Small changes with and without a large one on another scene
    Large,
    /// Restart, snapshot, memory
    Restart,
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (0.001..=600.0).contains(&seconds) => Ok(seconds),
        Ok(_) => Err("it must be from 0.001 to 600".to_owned()),
        Err(_) => Err("it is not a number".to_owned()),
    }
}

fn large(text: &str) -> Result<usize, String> {
    match parse_count(text)? {
        count @ ..=LARGE_CHANGE => Ok(count),
        _ => Err(format!("the server takes {LARGE_CHANGE} cubes in a change")),
    }
}
