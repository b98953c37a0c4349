//! Cubes or solids acknowledged a second, by protocol, size of a change and number of clients.

use std::rc::Rc;
use std::time::Duration;

use bytes::Bytes;
use clap::ValueEnum;
use union3d::wire::proto::Change;

use super::bodies::{self, Body, Protocol};
use super::grpc::{self, WINDOW};
use super::load::{self, Done, Summary, Supply, on_this_thread};
use super::scene::{changes, check_and_drop, create};
use super::server::Server;
use super::setup::Setup;
use crate::failure::Failure;
use crate::figures::{median, rate};
use crate::table::{Cell, Table, figure, text};

/// What clients send, made beforehand.
enum Load {
    Http(Protocol, Vec<Bytes>),
    Grpc(Rc<Vec<Change>>),
}

impl Load {
    fn new(protocol: Protocol, changes: impl Iterator<Item = Vec<Body>>) -> Self {
        match protocol {
            Protocol::Grpc => {
                let changes = changes.map(|bodies| bodies::replacing(&[], &bodies));
                Self::Grpc(Rc::new(changes.collect()))
            }
            _ => Self::Http(
                protocol,
                changes.map(|bodies| protocol.insert(&bodies)).collect(),
            ),
        }
    }

    async fn run(&self, server: &Server, clients: usize, time: Duration) -> Result<Done, Failure> {
        match self {
            Self::Http(protocol, bodies) => {
                let kind = protocol.content_type();
                let supply = Supply::posts(changes("bench"), kind, bodies.clone());
                load::run(server.http, clients, supply, time).await
            }
            Self::Grpc(changes) => {
                grpc::run(server.grpc, "bench", clients, Rc::clone(changes), time).await
            }
        }
    }
}

/// A row for each protocol, size of a change and number of clients.
pub(super) fn measure(setup: &Setup<'_>) -> Result<Table, Failure> {
    let kind = setup.kind();
    let (name, a_second) = (kind.plural(), format!("{}/s", kind.plural()));
    let a_change = format!("{name} a change");
    let [fewest, most] = WINDOW;
    let mut table = Table::new(
        format!("Changes of {name}"),
        format!(
            "How many are acknowledged a second (every answer on stable storage), by protocol, {name} in a change and clients, each with one \
             change at a time (gRPC: one stream, {fewest} to {most} changes in flight); how long a change takes, in milliseconds. Medians."
        ),
        [
            ("protocol", "protocol"),
            ("bodies_per_change", a_change.as_str()),
            ("clients", "clients"),
            ("bodies_per_second", a_second.as_str()),
            ("changes_per_second", "changes/s"),
            ("p50_ms", "p50 ms"),
            ("p99_ms", "p99 ms"),
            ("p999_ms", "p99.9 ms"),
            ("max_ms", "max ms"),
        ],
    );
    let protocols = match setup.args.protocol.as_slice() {
        [] => Protocol::value_variants(),
        some => some,
    };
    let server = setup.server("throughput")?;
    for protocol in protocols {
        for &batch in setup.args.batches() {
            let most = setup.args.clients().iter().copied().max().unwrap_or(1);
            let (settings, changes) = setup.changes(*protocol, batch, most)?;
            let mut all = 0;
            let load = Load::new(*protocol, changes.inspect(|bodies| all += bodies.len()));
            for &clients in setup.args.clients() {
                let what = format!("{}: {batch} a change, {clients} clients", protocol.name());
                let (mut runs, mut rates) = (Vec::new(), Vec::new());
                for _ in setup.runs(&what) {
                    let done = on_this_thread(async {
                        create(server.http, "bench", settings.clone()).await?;
                        let done = load.run(&server, clients, setup.time).await?;
                        // The last change may be smaller.
                        let bodies = (done.requests * batch).min(all);
                        check_and_drop(server.http, "bench", kind, bodies).await?;
                        rates.push(rate(bodies, done.time));
                        Ok(done)
                    })?;
                    runs.push(done);
                }
                let done = Summary::of(runs);
                table.push(vec![
                    text(protocol.name()),
                    Cell::Count(batch as u64),
                    Cell::Count(clients as u64),
                    figure(median(rates)),
                    figure(done.requests),
                    figure(done.p50),
                    figure(done.p99),
                    figure(done.p999),
                    figure(done.max),
                ]);
            }
        }
    }
    Ok(table)
}
