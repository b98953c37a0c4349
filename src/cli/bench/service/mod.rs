//! `union3d bench service`: a real server process on a real disk, and clients on the same machine.
//!
//! ```text
//!   bodies made beforehand ──> load: clients on one thread ──link, grpc──> server: this executable as `serve`, durable
//! ```

mod bodies;
mod grpc;
mod link;
mod load;
mod server;

use std::io::Write as _;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::rc::Rc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use clap::ValueEnum;
use hyper::Method;
use indicatif::ProgressBar;
use rusqlite::Connection;
use serde_json::Value;
use union3d::engine::recount;
use union3d::geometry::{Edge, Place};
use union3d::wire::proto::Change;

use self::bodies::{Cube, EDGE, Protocol, STEPS_PER_UNIT, Side};
use self::grpc::WINDOW;
use self::link::Link;
use self::load::{Done, Supply, on_this_thread};
use self::server::Server;
use super::figures::{Latencies, Spread, float, median, parse_count, rate};
use super::machine::file_system;
use super::random::Random;
use super::table::{Cell, Report, Table, figure, text};
use crate::cli::{Outcome, input, progress};

type Failure = Box<dyn std::error::Error>;

/// Cubes in a change, and clients, when nothing else is asked for.
const BATCHES: [usize; 4] = [1, 100, 4_096, 65_536];
const CLIENTS: [usize; 4] = [1, 4, 16, 64];

/// What a writer at full speed sends, and how many at a time.
const FULL_SPEED_BATCH: usize = 4_096;
const FULL_SPEED_CLIENTS: usize = 4;

/// Changes that load a scene.
const LOAD_BATCH: usize = 65_536;
const LOAD_CLIENTS: usize = 2;

/// What a change of many cubes is.
const LARGE_CHANGE: usize = 1_000_000;

/// Appends that the yardstick of the disk is the median of.
const APPENDS: usize = 200;
const APPEND_BYTES: usize = 4_096;

/// Measure a real server process: throughput, latencies, restart, memory
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Starts this executable as `serve` on a temporary data directory, durable as always, and measures it over loopback from this \
process: cubes a second by protocol, cubes in a change and number of clients; queries while a writer is at full speed; small changes \
while another scene takes a million cubes at once; restart after a kill, bytes of a snapshot, memory.

What is sent is random cubes, a million of which cover each point once on average; it is encoded before the clock runs. The scene that \
is restarted is as dense, however large. Every scene is compared with what was acknowledged, and the restarted one with a recount.",
    after_long_help = "Examples:
  union3d bench service --data /var/tmp
  union3d bench service --part throughput --protocol protobuf --batch 4096 --clients 1,4
  union3d bench service --part restart --cubes 20M"
)]
pub(crate) struct Args {
    /// Where the temporary data directory is made: on the disk that is to be measured.
    #[arg(long, value_name = "DIRECTORY", default_value = ".")]
    data: PathBuf,
    /// Only these parts [default: all].
    #[arg(long, value_enum, value_delimiter = ',')]
    part: Vec<Part>,
    /// Only these protocols [default: all].
    #[arg(long, value_enum, value_delimiter = ',')]
    protocol: Vec<Protocol>,
    /// Cubes in a change [default: 1,100,4096,65536].
    #[arg(long, value_name = "COUNTS", value_parser = parse_count, value_delimiter = ',')]
    batch: Vec<usize>,
    /// Clients at a time [default: 1,4,16,64].
    #[arg(long, value_name = "COUNTS", value_parser = parse_count, value_delimiter = ',')]
    clients: Vec<usize>,
    /// How long each measurement takes.
    #[arg(long, value_name = "SECONDS", default_value_t = 2.0, value_parser = seconds)]
    seconds: f64,
    /// How often each measurement is made; the median is printed.
    #[arg(long, value_name = "COUNT", default_value = "3", value_parser = parse_count)]
    runs: usize,
    /// Cubes of the scene that is restarted.
    #[arg(long, value_name = "COUNT", default_value = "1M", value_parser = parse_count)]
    cubes: usize,
    /// Cubes of the change that small ones are measured beside.
    #[arg(long, value_name = "COUNT", default_value_t = LARGE_CHANGE, value_parser = large)]
    large: usize,
    /// Where the random numbers begin.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// What can be measured by itself.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Part {
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

/// Runs `bench service`.
pub(crate) fn run(args: &Args) -> Outcome {
    let mut report = Report::new();
    let data = tempfile::Builder::new()
        .prefix("union3d-bench-")
        .tempdir_in(&args.data)
        .map_err(input::about(&args.data))?;
    report.remark(format!(
        "Data on {}; an append of {APPEND_BYTES} bytes and fdatasync there takes {:.0} us (median of {APPENDS}): no durable change is faster. \
         Server and clients share the machine; the clients are one thread.",
        file_system(data.path()),
        sync_us(data.path())?
    ));
    let bench = Bench {
        time: Duration::from_secs_f64(args.seconds),
        data: data.path(),
        bar: progress::work(),
        args,
    };
    let wanted = |part| args.part.is_empty() || args.part.contains(&part);
    if wanted(Part::Throughput) {
        report.push(bench.throughput()?);
    }
    if wanted(Part::Queries) {
        report.push(bench.queries()?);
    }
    if wanted(Part::Large) {
        report.push(bench.beside_a_large_change()?);
    }
    if wanted(Part::Restart) {
        report.push(bench.restart()?);
    }
    bench.bar.finish_and_clear();
    report.print(args.json)?;
    Ok(ExitCode::SUCCESS)
}

/// Microseconds of an append and its sync: what the disk alone takes.
fn sync_us(directory: &Path) -> std::io::Result<f64> {
    let mut file = tempfile::tempfile_in(directory)?;
    let bytes = [0x5a; APPEND_BYTES];
    let mut times = Vec::new();
    for _ in 0..APPENDS {
        let started = Instant::now();
        file.write_all(&bytes)?;
        file.sync_data()?;
        times.push(started.elapsed().as_secs_f64() * 1e6);
    }
    Ok(median(times))
}

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

/// What all parts need.
struct Bench<'run> {
    args: &'run Args,
    data: &'run Path,
    time: Duration,
    bar: ProgressBar,
}

fn changes(scene: &str) -> String {
    format!("/v1/scenes/{scene}/changes?return=minimal")
}

/// Makes a scene.
async fn create(server: SocketAddr, scene: &str) -> Result<(), Failure> {
    let path = format!("/v1/scenes/{scene}");
    let mut link = Link::open(server).await?;
    let kind = Some("application/json");
    link.expect(Method::PUT, &path, kind, bodies::scene())
        .await?;
    Ok(())
}

/// Checks that a scene has as many cubes as were acknowledged, and drops it.
async fn check_and_drop(server: SocketAddr, scene: &str, cubes: usize) -> Result<(), Failure> {
    let mut link = Link::open(server).await?;
    let found = mass_properties(&mut link, scene).await?["cubes"].as_u64();
    if found != Some(cubes as u64) {
        return Err(format!("{cubes} cubes were acknowledged, and {found:?} are there").into());
    }
    let path = format!("/v1/scenes/{scene}");
    link.expect(Method::DELETE, &path, None, Bytes::new())
        .await?;
    Ok(())
}

async fn mass_properties(link: &mut Link, scene: &str) -> Result<Value, Failure> {
    let path = format!("/v1/scenes/{scene}/mass-properties");
    let text = link.expect(Method::GET, &path, None, Bytes::new()).await?;
    Ok(serde_json::from_slice(&text)?)
}

impl Bench<'_> {
    fn runs(&self, what: &str) -> impl Iterator<Item = usize> {
        let (bar, what, runs) = (self.bar.clone(), what.to_owned(), self.args.runs);
        (1..=runs).inspect(move |run| bar.set_message(format!("{what}, run {run} of {runs}")))
    }

    /// Cubes with the ids from 1 on, by changes: enough for one measurement.
    fn changes(
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

    fn protobuf_bodies(&self, batch: usize, clients: usize) -> Vec<Bytes> {
        self.changes(Protocol::Protobuf, batch, clients)
            .map(|cubes| Protocol::Protobuf.insert(&cubes))
            .collect()
    }

    fn throughput(&self) -> Result<Table, Failure> {
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
        let or = |asked: &[usize], usual: [usize; 4]| match asked {
            [] => usual.to_vec(),
            some => some.to_vec(),
        };
        let protocols = match self.args.protocol.as_slice() {
            [] => Protocol::value_variants(),
            some => some,
        };
        let data = self.data.join("throughput");
        let server = on_this_thread(Server::start(&data))?;
        for protocol in protocols {
            for &batch in &or(&self.args.batch, BATCHES) {
                let clients = or(&self.args.clients, CLIENTS);
                let most = clients.iter().copied().max().unwrap_or(1);
                let load = Load::new(*protocol, self.changes(*protocol, batch, most));
                for clients in clients {
                    let what = format!("{}: {batch} a change, {clients} clients", protocol.name());
                    let mut runs = Vec::new();
                    for _ in self.runs(&what) {
                        let done = on_this_thread(async {
                            create(server.http, "bench").await?;
                            let done = load.run(&server, clients, self.time).await?;
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

    fn queries(&self) -> Result<Table, Failure> {
        let mut table = Table::new(
            "Queries while a writer is at full speed",
            format!(
                "One client asks, one question after the other; milliseconds. The writer sends changes of {FULL_SPEED_BATCH} cubes from \
                 {FULL_SPEED_CLIENTS} connections, as protobuf, to the same scene. Medians."
            ),
            [
                ("query", "query"),
                ("writer_cubes_per_second", "writer cubes/s"),
                ("queries_per_second", "queries/s"),
                ("p50_ms", "p50 ms"),
                ("p99_ms", "p99 ms"),
                ("max_ms", "max ms"),
            ],
        );
        let data = self.data.join("queries");
        let server = on_this_thread(Server::start(&data))?;
        let bodies = self.protobuf_bodies(FULL_SPEED_BATCH, FULL_SPEED_CLIENTS);
        for query in [
            "mass-properties",
            "contains?at=50,50,50",
            "cubes/1",
            "cubes?limit=100",
            "history?limit=10",
        ] {
            for writing in [false, true] {
                let what = format!("{query}{}", if writing { " while writing" } else { "" });
                let (mut runs, mut written) = (Vec::new(), Vec::new());
                for _ in self.runs(&what) {
                    let (read, write) = self.query(&server, query, &bodies, writing)?;
                    runs.push(read);
                    written.extend(write);
                }
                let [queries, p50, p99, max] = summary(runs);
                table.push(vec![
                    text(query),
                    if writing {
                        figure(median(written))
                    } else {
                        text("none")
                    },
                    figure(queries),
                    figure(p50),
                    figure(p99),
                    figure(max),
                ]);
            }
        }
        Ok(table)
    }

    /// One client asks; the writer, if there is one, is on a thread of its own. What it wrote a second.
    fn query(
        &self,
        server: &Server,
        query: &str,
        bodies: &[Bytes],
        writing: bool,
    ) -> Result<(Done, Option<f64>), Failure> {
        let (http, kind) = (server.http, Protocol::Protobuf.content_type());
        // The first change is there in any case, so that there is something to ask for.
        let (first, rest) = bodies.split_at(1);
        on_this_thread(async {
            create(http, "bench").await?;
            let mut link = Link::open(http).await?;
            let body = first[0].clone();
            link.expect(Method::POST, &changes("bench"), Some(kind), body)
                .await
        })?;
        let time = self.time;
        let asking = Supply::gets(format!("/v1/scenes/bench/{query}"));
        let (read, write) = std::thread::scope(|scope| {
            let writer = writing.then(|| {
                scope.spawn(move || {
                    let supply = Supply::posts(changes("bench"), kind, rest.to_vec());
                    let work = load::run(http, FULL_SPEED_CLIENTS, supply, time);
                    on_this_thread(work).map_err(|error| error.to_string())
                })
            });
            let read = on_this_thread(load::run(http, 1, asking, time));
            let write = writer.map(|writer| writer.join().expect("the writer does not panic"));
            (read, write)
        });
        let (read, write) = (read?, write.transpose()?);
        let changes = write.as_ref().map_or(0, |write| write.requests);
        let cubes = (changes + 1) * FULL_SPEED_BATCH;
        on_this_thread(check_and_drop(http, "bench", cubes))?;
        let speed = write.map(|write| rate(write.requests * FULL_SPEED_BATCH, write.time));
        Ok((read, speed))
    }

    fn beside_a_large_change(&self) -> Result<Table, Failure> {
        let mut table = Table::new(
            "Small changes beside a large one on another scene",
            format!(
                "One client inserts one cube after the other into one scene, as protobuf, while another scene takes changes of {} cubes one \
                 after the other; milliseconds. Medians.",
                super::table::grouped(self.args.large)
            ),
            [
                ("beside", "beside"),
                ("large_change_seconds", "large change s"),
                ("changes_per_second", "small changes/s"),
                ("p50_ms", "p50 ms"),
                ("p99_ms", "p99 ms"),
                ("max_ms", "max ms"),
            ],
        );
        let data = self.data.join("large");
        let server = on_this_thread(Server::start(&data))?;
        let small = self.protobuf_bodies(1, 1);
        let cubes = bodies::cubes(
            1,
            self.args.large,
            Side::OF_A_MILLION,
            &mut Random::new(self.args.seed),
        );
        let (all, none) = (bodies::replace(&[], &cubes), bodies::replace(&cubes, &[]));
        for beside in ["nothing", "inserting them", "deleting them"] {
            let (mut runs, mut large) = (Vec::new(), Vec::new());
            for _ in self.runs(&format!("small changes beside {beside}")) {
                let bodies = match beside {
                    "nothing" => None,
                    "inserting them" => Some([&all, &none]),
                    _ => Some([&none, &all]),
                };
                let (done, seconds) = self.beside(&server, &small, bodies, &all)?;
                runs.push(done);
                large.extend(seconds);
            }
            let [changes, p50, p99, max] = summary(runs);
            table.push(vec![
                text(beside),
                if large.is_empty() {
                    Cell::Nothing
                } else {
                    figure(median(large))
                },
                figure(changes),
                figure(p50),
                figure(p99),
                figure(max),
            ]);
        }
        Ok(table)
    }

    /// Small changes on one scene while the first of two large changes is made to another, again and again (the second undoes it, and is
    /// not measured). Seconds of each large change.
    fn beside(
        &self,
        server: &Server,
        small: &[Bytes],
        large: Option<[&Bytes; 2]>,
        full: &Bytes,
    ) -> Result<(Done, Vec<f64>), Failure> {
        let (http, kind) = (server.http, Protocol::Protobuf.content_type());
        let deleting = large.is_some_and(|[measured, _]| measured != full);
        on_this_thread(async {
            create(http, "small").await?;
            create(http, "large").await?;
            if deleting {
                let mut link = Link::open(http).await?;
                let (path, body) = (changes("large"), full.clone());
                link.expect(Method::POST, &path, Some(kind), body).await?;
            }
            Ok(())
        })?;
        let (mut done, mut seconds, mut rest) = (Done::default(), Vec::new(), small.to_vec());
        loop {
            // As long as the large change takes, or as long as was asked for.
            let (time, path) = (self.time, changes("large"));
            let (batch, measured) = std::thread::scope(|scope| {
                let writer = large.map(|[measured, _]| {
                    scope.spawn(move || {
                        let supply = Supply::posts(path, kind, vec![measured.clone()]);
                        let work = load::run(http, 1, supply, time);
                        on_this_thread(work).map_err(|error| error.to_string())
                    })
                });
                let over = |elapsed| match &writer {
                    Some(writer) => writer.is_finished(),
                    None => elapsed >= time,
                };
                let batch = on_this_thread(one_by_one(http, kind, &mut rest, over));
                let measured = writer.map(|writer| writer.join().expect("it does not panic"));
                (batch, measured)
            });
            let batch = batch?;
            done.requests += batch.requests;
            done.time += batch.time;
            done.latencies.extend(&batch.latencies);
            let Some(measured) = measured.transpose()? else {
                break;
            };
            seconds.push(measured.time.as_secs_f64());
            if done.time >= self.time || rest.is_empty() {
                break;
            }
            if let Some([_, undoing]) = large {
                on_this_thread(async {
                    let mut link = Link::open(http).await?;
                    let (path, body) = (changes("large"), undoing.clone());
                    link.expect(Method::POST, &path, Some(kind), body).await
                })?;
            }
        }
        on_this_thread(async {
            check_and_drop(http, "small", done.requests).await?;
            let there = match large {
                Some(_) if !deleting => self.args.large,
                _ => 0,
            };
            check_and_drop(http, "large", there).await
        })?;
        Ok((done, seconds))
    }

    fn restart(&self) -> Result<Table, Failure> {
        let mut table = Table::new(
            format!(
                "A scene of {} cubes",
                super::table::grouped(self.args.cubes)
            ),
            format!(
                "Loaded as protobuf in changes of {LOAD_BATCH} cubes, killed, started again; then cubes are moved until the server has \
                 written a snapshot, and it is killed and started again. Totals equal a recount each time. Medians of the restarts."
            ),
            [("figure", "figure"), ("value", "value"), ("unit", "unit")],
        );
        let mut random = Random::new(self.args.seed);
        let side = Side::of(self.args.cubes);
        let mut cubes = bodies::cubes(1, self.args.cubes, side, &mut random);
        let count = float(cubes.len() as u64);
        let mut put = |name: &str, value: f64, unit: &str| {
            table.push(vec![text(name), figure(value), text(unit)]);
        };
        let data = self.data.join("restart");
        let scene = "bench";
        let server = on_this_thread(Server::start(&data))?;
        let empty = server.resident().now;
        self.bar.set_message("loading");
        on_this_thread(create(server.http, scene))?;
        let insert = |cubes: &[Cube]| Protocol::Protobuf.insert(cubes);
        let bodies = cubes.chunks(LOAD_BATCH).map(insert).collect();
        let supply = Supply::posts(changes(scene), Protocol::Protobuf.content_type(), bodies);
        let loaded = on_this_thread(load::run(server.http, LOAD_CLIENTS, supply, Duration::MAX))?;
        put("loading", rate(cubes.len(), loaded.time), "cubes/s");
        let (resident, disk) = (server.resident(), size_of(&data)?);
        put("memory when loaded", gib(resident.now), "GiB");
        put("greatest memory", gib(resident.peak), "GiB");
        let grown = resident.now.saturating_sub(empty);
        put("memory grown by", float(grown) / count, "bytes a cube");
        put("disk when loaded", float(disk) / count, "bytes a cube");

        self.bar.set_message("restarts");
        let (seconds, server) = self.restarts(server, &data, &cubes)?;
        put("ready after a kill, log replayed", seconds, "s");
        let resident = server.resident();
        put("memory when replayed", gib(resident.now), "GiB");
        put("greatest memory of the replay", gib(resident.peak), "GiB");

        self.bar
            .set_message("moving cubes until there is a snapshot");
        on_this_thread(move_until_snapshot(&server, scene, &mut cubes, || {
            bodies::cubes(0, LOAD_BATCH / 2, side, &mut random)
        }))?;
        let (seconds, server) = self.restarts(server, &data, &cubes)?;
        put("ready after a kill, snapshot and log", seconds, "s");
        server.kill()?;
        let written = Written::read(&data.join("scenes").join(scene).join("scene.sqlite"))?;
        put(
            "of which moved while it was written",
            float(written.changes_since * (LOAD_BATCH as u64 / 2)),
            "cubes",
        );
        put("snapshot", written.bytes / written.cubes, "bytes a cube");
        Ok(table)
    }

    /// Kills and starts the server as often as there are runs; median seconds until ready, and the last one.
    fn restarts(
        &self,
        mut server: Server,
        data: &Path,
        cubes: &[Cube],
    ) -> Result<(f64, Server), Failure> {
        let mut times = Vec::new();
        for _ in 0..self.args.runs {
            server.kill()?;
            server = on_this_thread(Server::start(data))?;
            times.push(server.start.as_secs_f64());
        }
        let found = on_this_thread(async {
            let mut link = Link::open(server.http).await?;
            mass_properties(&mut link, "bench").await
        })?;
        let edge = Edge::new(i64::from(EDGE) * i64::from(STEPS_PER_UNIT))?;
        let place = |cube: &Cube| Place::new(cube.corner.map(i64::from), edge);
        let places: Vec<Place> = cubes.iter().map(place).collect::<Result<_, _>>()?;
        let expected = recount(edge, None, places.into_iter());
        let exact = [
            ("volume", expected.measures.volume),
            ("area", expected.measures.area()),
        ];
        let equal = |(name, value): (&str, i128)| found["exact"][name] == value.to_string();
        if found["cubes"] != expected.cubes || !exact.into_iter().all(equal) {
            return Err("the restarted scene measures something else than a recount".into());
        }
        Ok((median(times), server))
    }
}

/// Sends small changes one after the other until it is over, as told from the time since the first.
async fn one_by_one(
    server: SocketAddr,
    kind: &'static str,
    bodies: &mut Vec<Bytes>,
    over: impl Fn(Duration) -> bool,
) -> Result<Done, Failure> {
    let (mut link, path) = (Link::open(server).await?, changes("small"));
    let mut latencies = Latencies::default();
    let started = Instant::now();
    while !over(started.elapsed()) {
        let Some(body) = bodies.pop() else { break };
        let sent = Instant::now();
        link.expect(Method::POST, &path, Some(kind), body).await?;
        latencies.push(sent.elapsed());
    }
    Ok(Done {
        requests: latencies.len(),
        time: started.elapsed(),
        latencies,
    })
}

/// Answers a second, and p50, p99 and maximum in milliseconds: medians over runs.
fn summary(runs: Vec<Done>) -> [f64; 4] {
    let rates = runs.iter().map(|done| rate(done.requests, done.time));
    let requests = median(rates);
    let spreads = runs.into_iter().map(|done| done.latencies.spread());
    let spread = Spread::median_of(&spreads.collect::<Vec<_>>());
    [
        requests,
        spread.p50 / 1e3,
        spread.p99 / 1e3,
        spread.max / 1e3,
    ]
}

/// Moves cubes, oldest first, to new places until the server has written a snapshot of them.
async fn move_until_snapshot(
    server: &Server,
    scene: &str,
    cubes: &mut [Cube],
    mut places: impl FnMut() -> Vec<Cube>,
) -> Result<(), Failure> {
    let mut link = Link::open(server.http).await?;
    let (path, kind) = (changes(scene), Protocol::Protobuf.content_type());
    let written = async |link: &mut Link| -> Result<bool, Failure> {
        let text = link
            .expect(Method::GET, "/metrics", None, Bytes::new())
            .await?;
        let text = String::from_utf8_lossy(&text);
        let mut lines = text.lines();
        let snapshots = lines.find_map(|line| line.strip_prefix("union3d_snapshots_total "));
        Ok(snapshots.is_some_and(|snapshots| snapshots != "0"))
    };
    // Far more than makes a log longer than what it says.
    let (mut next, moves_max) = (0, 64 * cubes.len().max(1 << 16));
    let mut moves = 0;
    while !written(&mut link).await? {
        if moves > moves_max {
            return Err("the server writes no snapshot".into());
        }
        let end = (next + LOAD_BATCH / 2).min(cubes.len());
        let part = &mut cubes[next..end];
        let new_cubes: Vec<Cube> = places()
            .into_iter()
            .zip(&*part)
            .map(|(new, old)| Cube { id: old.id, ..new })
            .collect();
        let body = bodies::replace(part, &new_cubes);
        link.expect(Method::POST, &path, Some(kind), body).await?;
        part.copy_from_slice(&new_cubes);
        moves += part.len();
        next = end % cubes.len();
    }
    Ok(())
}

/// The newest snapshot in a scene's database.
struct Written {
    bytes: f64,
    cubes: f64,
    /// Changes that came after it, or while it was written.
    changes_since: u64,
}

impl Written {
    fn read(database: &Path) -> Result<Self, Failure> {
        let connection = Connection::open(database)?;
        let query = "SELECT sum(length(cubes)), sum(count), (SELECT max(seq) FROM changes) - (SELECT max(seq) FROM snapshots) \
                     FROM chunks WHERE id >> 16 = (SELECT max(number) FROM snapshots)";
        Ok(connection.query_row(query, [], |row| {
            let [bytes, cubes, changes] = [row.get::<_, i64>(0)?, row.get(1)?, row.get(2)?];
            Ok(Self {
                bytes: float(bytes.unsigned_abs()),
                cubes: float(cubes.unsigned_abs()),
                changes_since: changes.unsigned_abs(),
            })
        })?)
    }
}

/// Bytes of all files under a directory.
fn size_of(directory: &Path) -> std::io::Result<u64> {
    let mut size = 0;
    for entry in std::fs::read_dir(directory)? {
        let entry = entry?;
        let metadata = entry.metadata()?;
        size += if metadata.is_dir() {
            size_of(&entry.path())?
        } else {
            metadata.len()
        };
    }
    Ok(size)
}

fn gib(bytes: u64) -> f64 {
    float(bytes) / 1_073_741_824.0
}
