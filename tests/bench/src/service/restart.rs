//! A large scene: loading, memory, disk, and how long a server that was killed takes to be ready again.

use std::rc::Rc;
use std::time::Duration;

use bytes::Bytes;
use hyper::Method;

use super::bodies::{self, Body, Protocol, Side};
use super::disk::size_of;
use super::grpc;
use super::link::Link;
use super::load::{self, Done, Supply, on_this_thread};
use super::scene::{changes, create, mass_properties};
use super::server::Server;
use super::setup::Setup;
use super::work::{Expected, ToolPath, settings_of_cubes};
use crate::failure::Failure;
use crate::figures::{float, median};
use crate::random::Random;
use crate::table::{Table, figure, grouped, text};

/// The data directory, and the scene in it.
const NAME: &str = "restart";
const SCENE: &str = "bench";

/// Changes that load a scene of cubes.
const LOAD_BATCH: usize = 65_536;
const LOAD_CLIENTS: usize = 2;

/// Loads a scene, kills the server, starts it again; a row for each figure.
pub(super) fn measure(setup: &Setup<'_>) -> Result<Table, Failure> {
    let count = setup.args.restarted();
    let path = setup.work.long_path(count)?;
    let how = if path.is_some() {
        "Loaded through one gRPC stream, a change for each, killed, started again. Totals equal those of the same solids as one batch in \
         this process. Medians of the restarts."
            .to_owned()
    } else {
        format!(
            "Loaded as protobuf in changes of {LOAD_BATCH} cubes, killed, started again; then cubes are moved until the server has \
             written a snapshot, and it is killed and started again. Totals equal a recount each time. Medians of the restarts."
        )
    };
    let name = setup.kind().plural();
    let mut measured = Measured {
        setup,
        bodies: float(count as u64),
        table: Table::new(
            format!("A scene of {} {name}", grouped(count)),
            how,
            [("figure", "figure"), ("value", "value"), ("unit", "unit")],
        ),
    };
    let server = setup.server(NAME)?;
    match path {
        Some(path) => of_solids(&mut measured, server, &path)?,
        None => of_cubes(&mut measured, server, count)?,
    }
    Ok(measured.table)
}

fn of_solids(measured: &mut Measured<'_>, server: Server, path: &ToolPath) -> Result<(), Failure> {
    let changes = path.bodies().into_iter();
    let changes = changes
        .map(|body| bodies::replacing(&[], &[body]))
        .collect();
    let server = measured.loading(server, path.settings(), async |server| {
        grpc::run(server.grpc, SCENE, 1, Rc::new(changes), Duration::MAX).await
    })?;
    measured.setup.bar.set_message("what it must come to");
    let expected = path.expected()?;
    let server = measured.log_replayed(server, &expected)?;
    Ok(server.kill()?)
}

fn of_cubes(measured: &mut Measured<'_>, server: Server, count: usize) -> Result<(), Failure> {
    let setup = measured.setup;
    let mut random = Random::new(setup.args.seed);
    let side = Side::of(count);
    let mut cubes = bodies::cubes(1, count, side, &mut random);
    let insert = |cubes: &[Body]| Protocol::Protobuf.insert(cubes);
    let bodies = cubes.chunks(LOAD_BATCH).map(insert).collect();
    let supply = Supply::posts(changes(SCENE), Protocol::Protobuf.content_type(), bodies);
    let server = measured.loading(server, settings_of_cubes(), async |server| {
        load::run(server.http, LOAD_CLIENTS, supply, Duration::MAX).await
    })?;
    let server = measured.log_replayed(server, &Expected::of_cubes(&cubes)?)?;

    setup
        .bar
        .set_message("moving cubes until there is a snapshot");
    on_this_thread(move_until_snapshot(&server, &mut cubes, || {
        bodies::cubes(0, LOAD_BATCH / 2, side, &mut random)
    }))?;
    let expected = Expected::of_cubes(&cubes)?;
    let (seconds, server) = measured.restarts(server, &expected)?;
    measured.put("ready after a kill, snapshot and log", seconds, "s");
    server.kill()?;
    measured.put_disk("disk with snapshot and log")
}

/// The figures of a scene.
struct Measured<'run> {
    setup: &'run Setup<'run>,
    /// How many it has.
    bodies: f64,
    table: Table,
}

impl Measured<'_> {
    fn put(&mut self, name: &str, value: f64, unit: &str) {
        self.table.push(vec![text(name), figure(value), text(unit)]);
    }

    /// A figure for each body.
    fn put_of_each(&mut self, name: &str, bytes: u64) {
        let kind = self.setup.kind().plural();
        let a_body = format!("bytes a {}", kind.trim_end_matches('s'));
        self.put(name, float(bytes) / self.bodies, &a_body);
    }

    fn put_disk(&mut self, name: &str) -> Result<(), Failure> {
        let bytes = size_of(&self.setup.data.join(NAME))?;
        self.put_of_each(name, bytes);
        Ok(())
    }

    /// Makes a scene and loads it.
    fn loading(
        &mut self,
        server: Server,
        settings: Bytes,
        load: impl AsyncFnOnce(&Server) -> Result<Done, Failure>,
    ) -> Result<Server, Failure> {
        let empty = server.resident().now;
        self.setup.bar.set_message("loading");
        on_this_thread(create(server.http, SCENE, settings))?;
        let loaded = on_this_thread(load(&server))?;
        let a_second = format!("{}/s", self.setup.kind().plural());
        self.put(
            "loading",
            self.bodies / loaded.time.as_secs_f64(),
            &a_second,
        );
        let resident = server.resident();
        self.put("memory when loaded", gib(resident.now), "GiB");
        self.put("greatest memory", gib(resident.peak), "GiB");
        self.put_of_each("memory grown by", resident.now.saturating_sub(empty));
        self.put_disk("disk when loaded")?;
        Ok(server)
    }

    /// Restarts it from its log alone.
    fn log_replayed(&mut self, server: Server, expected: &Expected) -> Result<Server, Failure> {
        self.setup.bar.set_message("restarts");
        let (seconds, server) = self.restarts(server, expected)?;
        self.put("ready after a kill, log replayed", seconds, "s");
        let resident = server.resident();
        self.put("memory when replayed", gib(resident.now), "GiB");
        self.put("greatest memory of the replay", gib(resident.peak), "GiB");
        Ok(server)
    }

    /// Kills and starts the server as often as there are runs; median seconds until ready, and the last one.
    fn restarts(&self, mut server: Server, expected: &Expected) -> Result<(f64, Server), Failure> {
        let mut times = Vec::new();
        for _ in 0..self.setup.args.runs {
            server.kill()?;
            server = self.setup.server(NAME)?;
            times.push(server.start.as_secs_f64());
        }
        let found = on_this_thread(async {
            let mut link = Link::open(server.http).await?;
            mass_properties(&mut link, SCENE).await
        })?;
        if !expected.is(&found) {
            return Err("the restarted scene measures something else than a recount".into());
        }
        Ok((median(times), server))
    }
}

/// Moves cubes, oldest first, to new places until the server has written a snapshot of them.
async fn move_until_snapshot(
    server: &Server,
    cubes: &mut [Body],
    mut places: impl FnMut() -> Vec<Body>,
) -> Result<(), Failure> {
    let mut link = Link::open(server.http).await?;
    let (path, kind) = (changes(SCENE), Protocol::Protobuf.content_type());
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
        let new_cubes: Vec<Body> = places()
            .into_iter()
            .zip(&*part)
            .map(|(new, old)| Body { id: old.id, ..new })
            .collect();
        let body = bodies::replace(part, &new_cubes);
        link.expect(Method::POST, &path, Some(kind), body).await?;
        part.copy_from_slice(&new_cubes);
        moves += part.len();
        next = end % cubes.len();
    }
    Ok(())
}

fn gib(bytes: u64) -> f64 {
    float(bytes) / 1_073_741_824.0
}
