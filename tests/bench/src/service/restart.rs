//! A large scene: loading, memory, disk, and how long a server that was killed takes to be ready again.

use std::time::Duration;

use bytes::Bytes;
use hyper::Method;
use union3d::engine::recount;
use union3d::geometry::{Edge, Place};

use super::bodies::{self, Cube, EDGE, Protocol, STEPS_PER_UNIT, Side};
use super::disk::size_of;
use super::link::Link;
use super::load::{self, Supply, on_this_thread};
use super::scene::{changes, create, mass_properties};
use super::server::Server;
use super::setup::Setup;
use crate::failure::Failure;
use crate::figures::{float, median, rate};
use crate::random::Random;
use crate::table::{Table, figure, grouped, text};

/// The data directory, and the scene in it.
const NAME: &str = "restart";
const SCENE: &str = "bench";

/// Changes that load a scene.
const LOAD_BATCH: usize = 65_536;
const LOAD_CLIENTS: usize = 2;

/// Loads a scene, kills the server, starts it again, with a log alone and with a snapshot; a row for each figure.
pub(super) fn measure(setup: &Setup<'_>) -> Result<Table, Failure> {
    let mut table = Table::new(
        format!("A scene of {} cubes", grouped(setup.args.cubes)),
        format!(
            "Loaded as protobuf in changes of {LOAD_BATCH} cubes, killed, started again; then cubes are moved until the server has \
             written a snapshot, and it is killed and started again. Totals equal a recount each time. Medians of the restarts."
        ),
        [("figure", "figure"), ("value", "value"), ("unit", "unit")],
    );
    let mut random = Random::new(setup.args.seed);
    let side = Side::of(setup.args.cubes);
    let mut cubes = bodies::cubes(1, setup.args.cubes, side, &mut random);
    let count = float(cubes.len() as u64);
    let mut put = |name: &str, value: f64, unit: &str| {
        table.push(vec![text(name), figure(value), text(unit)]);
    };
    let server = setup.server(NAME)?;
    let empty = server.resident().now;
    setup.bar.set_message("loading");
    on_this_thread(create(server.http, SCENE))?;
    let insert = |cubes: &[Cube]| Protocol::Protobuf.insert(cubes);
    let bodies = cubes.chunks(LOAD_BATCH).map(insert).collect();
    let supply = Supply::posts(changes(SCENE), Protocol::Protobuf.content_type(), bodies);
    let loaded = on_this_thread(load::run(server.http, LOAD_CLIENTS, supply, Duration::MAX))?;
    put("loading", rate(cubes.len(), loaded.time), "cubes/s");
    let disk = || -> Result<f64, Failure> {
        let bytes = size_of(&setup.data.join(NAME))?;
        Ok(float(bytes) / count)
    };
    let resident = server.resident();
    put("memory when loaded", gib(resident.now), "GiB");
    put("greatest memory", gib(resident.peak), "GiB");
    let grown = resident.now.saturating_sub(empty);
    put("memory grown by", float(grown) / count, "bytes a cube");
    put("disk when loaded", disk()?, "bytes a cube");

    setup.bar.set_message("restarts");
    let (seconds, server) = restarts(setup, server, &cubes)?;
    put("ready after a kill, log replayed", seconds, "s");
    let resident = server.resident();
    put("memory when replayed", gib(resident.now), "GiB");
    put("greatest memory of the replay", gib(resident.peak), "GiB");

    setup
        .bar
        .set_message("moving cubes until there is a snapshot");
    on_this_thread(move_until_snapshot(&server, &mut cubes, || {
        bodies::cubes(0, LOAD_BATCH / 2, side, &mut random)
    }))?;
    let (seconds, server) = restarts(setup, server, &cubes)?;
    put("ready after a kill, snapshot and log", seconds, "s");
    server.kill()?;
    put("disk with snapshot and log", disk()?, "bytes a cube");
    Ok(table)
}

/// Kills and starts the server as often as there are runs; median seconds until ready, and the last one.
fn restarts(
    setup: &Setup<'_>,
    mut server: Server,
    cubes: &[Cube],
) -> Result<(f64, Server), Failure> {
    let mut times = Vec::new();
    for _ in 0..setup.args.runs {
        server.kill()?;
        server = setup.server(NAME)?;
        times.push(server.start.as_secs_f64());
    }
    let found = on_this_thread(async {
        let mut link = Link::open(server.http).await?;
        mass_properties(&mut link, SCENE).await
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

/// Moves cubes, oldest first, to new places until the server has written a snapshot of them.
async fn move_until_snapshot(
    server: &Server,
    cubes: &mut [Cube],
    mut places: impl FnMut() -> Vec<Cube>,
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

fn gib(bytes: u64) -> f64 {
    float(bytes) / 1_073_741_824.0
}
