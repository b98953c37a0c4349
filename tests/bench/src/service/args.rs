//! What can be asked of the benchmark of a server.

use std::path::PathBuf;

use clap::ValueEnum;

use super::bodies::{Kind, Protocol};
use crate::failure::Failure;
use crate::figures::parse_count;

/// What a change of many cubes is.
const LARGE_CHANGE: usize = 1_000_000;

/// Bodies of the scene that is restarted, unless said.
const RESTARTED_CUBES: usize = 1_000_000;
const RESTARTED_SOLIDS: usize = 100_000;

/// Measure a real server process: throughput, latencies, restart, memory
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Starts `union3d serve` on a temporary data directory, durable as always, and measures it over loopback from this \
process: cubes a second by protocol, cubes in a change and number of clients; queries while a writer is at full speed; small changes \
while another scene takes a million cubes at once; restart after a kill, memory, disk.

What is sent is random cubes, a million of which cover each point once on average; it is encoded before the clock runs. The scene that \
is restarted is as dense, however large. Every scene is compared with what was acknowledged, and the restarted one with a recount.

With --kind solids it is what a tool sweeps, a solid for each move: a square milled with a ball of 3.175 mm in moves of 0.5 mm, lines a tenth \
of the diameter apart; or a program, milled from a block with a flat tool. Throughput and restart are measured of them.",
    after_long_help = "Examples:
  union3d-bench service --data /var/tmp
  union3d-bench service --part throughput --protocol protobuf --batch 4096 --clients 1,4
  union3d-bench service --part restart --cubes 20M
  union3d-bench service --kind solids --protocol grpc --batch 1,100 --clients 1
  union3d-bench service --kind solids --program part.nc --diameter 3.175"
)]
pub(crate) struct Args {
    /// What the scenes are made of.
    #[arg(long, value_enum, default_value = "cubes")]
    pub(super) kind: Kind,
    /// A program in G-code instead, of solids: what a flat tool of 24 sides sweeps below z = 0, all of it in each measurement.
    #[arg(long, value_name = "FILE", conflicts_with = "seconds")]
    pub(super) program: Option<PathBuf>,
    /// Diameter of the tool of the program, in mm.
    #[arg(long, value_name = "MM", default_value_t = 3.175, requires = "program")]
    pub(super) diameter: f64,
    /// Where the temporary data directory is made: on the disk that is to be measured.
    #[arg(long, value_name = "DIRECTORY", default_value = ".")]
    pub(super) data: PathBuf,
    /// The union3d whose server is measured [default: the one beside this executable].
    #[arg(long, value_name = "FILE")]
    pub(super) server: Option<PathBuf>,
    /// Only these parts [default: all that there are of the kind].
    #[arg(long, value_enum, value_delimiter = ',')]
    pub(super) part: Vec<Part>,
    /// Only these protocols [default: all].
    #[arg(long, value_enum, value_delimiter = ',')]
    pub(super) protocol: Vec<Protocol>,
    /// Cubes or solids in a change [default: 1,100,4096,65536 cubes or 1,100 solids].
    #[arg(long, value_name = "COUNTS", value_parser = parse_count, value_delimiter = ',')]
    batch: Vec<usize>,
    /// Clients at a time [default: 1,4,16,64; of solids 1,16].
    #[arg(long, value_name = "COUNTS", value_parser = parse_count, value_delimiter = ',')]
    clients: Vec<usize>,
    /// How long each measurement takes.
    #[arg(long, value_name = "SECONDS", default_value_t = 2.0, value_parser = seconds)]
    pub(super) seconds: f64,
    /// How often each measurement is made; the median is printed.
    #[arg(long, value_name = "COUNT", default_value = "3", value_parser = parse_count)]
    pub(super) runs: usize,
    /// Cubes of the scene that is restarted [default: 1M].
    #[arg(long, value_name = "COUNT", value_parser = parse_count)]
    cubes: Option<usize>,
    /// Solids of the scene that is restarted [default: 100k].
    #[arg(long, value_name = "COUNT", value_parser = parse_count)]
    solids: Option<usize>,
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
    /// Cubes or solids a second and latencies of changes
    Throughput,
    /// Queries with and without a writer at full speed; of cubes alone
    Queries,
    /// Small changes with and without a large one on another scene; of cubes alone
    Large,
    /// Restart, memory; of cubes with a snapshot, too
    Restart,
}

impl Args {
    /// Refuses what is said of another kind than is measured.
    pub(super) fn check(&self) -> Result<(), Failure> {
        let of_cubes = self.kind == Kind::Cubes;
        let other = [
            ("--program", self.program.is_some() && of_cubes),
            ("--solids", self.solids.is_some() && of_cubes),
            ("--cubes", self.cubes.is_some() && !of_cubes),
            ("--part queries", self.asks(Part::Queries) && !of_cubes),
            ("--part large", self.asks(Part::Large) && !of_cubes),
        ];
        match other.into_iter().find(|(_, is_said)| *is_said) {
            None => Ok(()),
            Some((what, _)) => {
                Err(format!("{what} is not for --kind {}", self.kind.plural()).into())
            }
        }
    }

    fn asks(&self, part: Part) -> bool {
        self.part.contains(&part)
    }

    /// Whether a part is to be measured.
    pub(super) fn wants(&self, part: Part) -> bool {
        let all_kinds = matches!(part, Part::Throughput | Part::Restart);
        match self.part.as_slice() {
            [] => all_kinds || self.kind == Kind::Cubes,
            _ => self.asks(part),
        }
    }

    /// Bodies in a change.
    pub(super) fn batches(&self) -> &[usize] {
        match (self.batch.as_slice(), self.kind) {
            ([], Kind::Cubes) => &[1, 100, 4_096, 65_536],
            ([], Kind::Solids) => &[1, 100],
            (some, _) => some,
        }
    }

    /// Clients at a time.
    pub(super) fn clients(&self) -> &[usize] {
        match (self.clients.as_slice(), self.kind) {
            ([], Kind::Cubes) => &[1, 4, 16, 64],
            ([], Kind::Solids) => &[1, 16],
            (some, _) => some,
        }
    }

    /// Bodies of the scene that is restarted.
    pub(super) fn restarted(&self) -> usize {
        match self.kind {
            Kind::Cubes => self.cubes.unwrap_or(RESTARTED_CUBES),
            Kind::Solids => self.solids.unwrap_or(RESTARTED_SOLIDS),
        }
    }
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
