//! Cubes acknowledged a second, by protocol, size of a change and number of clients.

use std::rc::Rc;
use std::time::Duration;

use bytes::Bytes;
use clap::ValueEnum;
use union3d::wire::proto::Change;

use super::bodies::{self, Cube, Protocol};
use super::grpc::{self, WINDOW};
use super::load::{self, Done, Supply, on_this_thread, summary};
use super::scene::{changes, check_and_drop, create};
use super::server::Server;
use super::setup::Setup;
use crate::failure::Failure;
use crate::figures::float;
use crate::table::{Cell, Table, figure, text};

/// What clients send, made beforehand.
enum Load {
    Http(Protocol, Vec<Bytes>),
    Grpc(Rc<Vec<Change>>),
}

impl Load {
    fn new(protocol: Protocol, changes: impl Iterator<Item = Vec<Cube>>) -> Self {
        match protocol {
            Protocol::Grpc => {
                let changes = changes.map(|cubes| bodies::replacing(&[], &cubes));
                Self::Grpc(Rc::new(changes.collect()))
            }
            _ => Self::Http(
                protocol,
                changes.map(|cubes| protocol.insert(&cubes)).collect(),
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
    let mut table = Table::new(
        "Changes",
        format!(
            "Cubes acknowledged a second (every answer on stable storage), by protocol, cubes in a change and clients, each with one \
             change at a time (gRPC: one stream, {WINDOW} changes in flight); how long a change takes, in milliseconds. Medians."
        ),
        [
            ("protocol", "protocol"),
            ("cubes_per_change", "cubes a change"),
            ("clients", "clients"),
            ("cubes_per_second", "cubes/s"),
            ("changes_per_second", "changes/s"),
            ("p50_ms", "p50 ms"),
            ("p99_ms", "p99 ms"),
            ("max_ms", "max ms"),
        ],
    );
    let protocols = match setup.args.protocol.as_slice() {
        [] => Protocol::value_variants(),
        some => some,
    };
    let server = setup.server("throughput")?;
    for protocol in protocols {
        for &batch in &setup.args.batch {
            let most = setup.args.clients.iter().copied().max().unwrap_or(1);
            let load = Load::new(*protocol, setup.changes(*protocol, batch, most));
            for &clients in &setup.args.clients {
                let what = format!("{}: {batch} a change, {clients} clients", protocol.name());
                let mut runs = Vec::new();
                for _ in setup.runs(&what) {
                    let done = on_this_thread(async {
                        create(server.http, "bench").await?;
                        let done = load.run(&server, clients, setup.time).await?;
                        check_and_drop(server.http, "bench", done.requests * batch).await?;
                        Ok(done)
                    })?;
                    runs.push(done);
                }
                let [requests, p50, p99, max] = summary(runs);
                table.push(vec![
                    text(protocol.name()),
                    Cell::Count(batch as u64),
                    Cell::Count(clients as u64),
                    figure(requests * float(batch as u64)),
                    figure(requests),
                    figure(p50),
                    figure(p99),
                    figure(max),
                ]);
            }
        }
    }
    Ok(table)
}
