//! What all parts of the benchmark share: how long, how often, where, and with which bodies.

use std::path::{Path, PathBuf};
use std::time::Duration;

use bytes::Bytes;
use indicatif::ProgressBar;

use super::args::Args;
use super::bodies::{Body, Kind, Protocol};
use super::load::on_this_thread;
use super::server::Server;
use super::work::{Work, random_cubes, settings_of_cubes};
use crate::failure::Failure;

/// One call of the benchmark.
pub(super) struct Setup<'run> {
    pub(super) args: &'run Args,
    /// The program whose `serve` is measured.
    pub(super) program: PathBuf,
    /// Where the servers keep their data.
    pub(super) data: &'run Path,
    /// What is sent.
    pub(super) work: Work,
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

    pub(super) fn kind(&self) -> Kind {
        self.args.kind
    }

    /// Bodies with the ids from 1 on, by changes: enough for one measurement; and the settings of their scene.
    pub(super) fn changes(
        &self,
        protocol: Protocol,
        batch: usize,
        clients: usize,
    ) -> Result<(Bytes, Changes), Failure> {
        let seconds = usize::try_from(self.time.as_secs()).unwrap_or(usize::MAX);
        let bodies = protocol
            .bodies_a_second_max(self.kind(), batch)
            .saturating_mul(seconds.saturating_add(1));
        // Each client at least one, or it would have nothing to do.
        let count = (bodies / batch).max(clients);
        Ok(match self.work.path(count.saturating_mul(batch))? {
            None => {
                let changes = random_cubes(batch, self.args.seed).take(count);
                (settings_of_cubes(), Box::new(changes))
            }
            Some(path) => {
                let bodies = path.bodies();
                let changes: Vec<_> = bodies.chunks(batch).map(<[Body]>::to_vec).collect();
                (path.settings(), Box::new(changes.into_iter()))
            }
        })
    }

    /// Changes of cubes as bodies to be posted.
    pub(super) fn protobuf_bodies(
        &self,
        batch: usize,
        clients: usize,
    ) -> Result<Vec<Bytes>, Failure> {
        let (_, changes) = self.changes(Protocol::Protobuf, batch, clients)?;
        Ok(changes
            .map(|cubes| Protocol::Protobuf.insert(&cubes))
            .collect())
    }
}

/// The bodies that changes insert.
pub(super) type Changes = Box<dyn Iterator<Item = Vec<Body>>>;
