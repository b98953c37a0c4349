//! What all parts of the benchmark share: how long, how often, where, and with which cubes.

use std::path::{Path, PathBuf};
use std::time::Duration;

use bytes::Bytes;
use indicatif::ProgressBar;

use super::args::Args;
use super::bodies::{self, Cube, Protocol, Side};
use super::load::on_this_thread;
use super::server::Server;
use crate::failure::Failure;
use crate::random::Random;

/// One call of the benchmark.
pub(super) struct Setup<'run> {
    pub(super) args: &'run Args,
    /// The program whose `serve` is measured.
    pub(super) program: PathBuf,
    /// Where the servers keep their data.
    pub(super) data: &'run Path,
    /// How long a measurement takes.
    pub(super) time: Duration,
    pub(super) bar: ProgressBar,
}

impl Setup<'_> {
    /// Starts a server whose data is in the directory of this name, and waits until it is ready.
    pub(super) fn server(&self, name: &str) -> Result<Server, Failure> {
        on_this_thread(Server::start(&self.program, &self.data.join(name)))
    }

    /// The numbers of the runs, each shown as it begins.
    pub(super) fn runs(&self, what: &str) -> impl Iterator<Item = usize> {
        let (bar, what, runs) = (self.bar.clone(), what.to_owned(), self.args.runs);
        (1..=runs).inspect(move |run| bar.set_message(format!("{what}, run {run} of {runs}")))
    }

    /// Cubes with the ids from 1 on, by changes: enough for one measurement.
    pub(super) fn changes(
        &self,
        protocol: Protocol,
        batch: usize,
        clients: usize,
    ) -> impl Iterator<Item = Vec<Cube>> {
        let whole_seconds = usize::try_from(self.time.as_secs()).unwrap_or(usize::MAX) + 1;
        let cubes = protocol
            .cubes_a_second_max(batch)
            .saturating_mul(whole_seconds);
        // Each client at least one, or it would have nothing to do.
        let count = (cubes / batch).max(clients);
        let mut random = Random::new(self.args.seed);
        (0..count).map(move |number| {
            let first = number as u64 * batch as u64 + 1;
            bodies::cubes(first, batch, Side::OF_A_MILLION, &mut random)
        })
    }

    /// The same as bodies to be posted.
    pub(super) fn protobuf_bodies(&self, batch: usize, clients: usize) -> Vec<Bytes> {
        self.changes(Protocol::Protobuf, batch, clients)
            .map(|cubes| Protocol::Protobuf.insert(&cubes))
            .collect()
    }
}
