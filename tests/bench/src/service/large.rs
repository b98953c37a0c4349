//! Small changes of one scene while another takes a million cubes at once.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use bytes::Bytes;
use hyper::Method;

use super::bodies::{self, Kind, Protocol, Side};
use super::link::Link;
use super::load::{self, Done, Summary, Supply, on_this_thread};
use super::scene::{changes, check_and_drop, create};
use super::server::Server;
use super::setup::Setup;
use super::work::settings_of_cubes;
use crate::failure::Failure;
use crate::figures::{Latencies, median};
use crate::random::Random;
use crate::table::{Cell, Table, figure, grouped, text};

/// A row for nothing beside, and for each kind of large change.
pub(super) fn measure(setup: &Setup<'_>) -> Result<Table, Failure> {
    let mut table = Table::new(
        "Small changes beside a large one on another scene",
        format!(
            "One client inserts one cube after the other into one scene, as protobuf, while another scene takes changes of {} cubes one \
             after the other; milliseconds. Medians.",
            grouped(setup.args.large)
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
    let server = setup.server("large")?;
    let small = setup.protobuf_bodies(1, 1)?;
    let cubes = bodies::cubes(
        1,
        setup.args.large,
        Side::OF_A_MILLION,
        &mut Random::new(setup.args.seed),
    );
    let (all, none) = (bodies::replace(&[], &cubes), bodies::replace(&cubes, &[]));
    for other in ["nothing", "inserting them", "deleting them"] {
        let (mut runs, mut large) = (Vec::new(), Vec::new());
        for _ in setup.runs(&format!("small changes beside {other}")) {
            let bodies = match other {
                "nothing" => None,
                "inserting them" => Some([&all, &none]),
                _ => Some([&none, &all]),
            };
            let (done, seconds) = beside(setup, &server, &small, bodies, &all)?;
            runs.push(done);
            large.extend(seconds);
        }
        let done = Summary::of(runs);
        table.push(vec![
            text(other),
            if large.is_empty() {
                Cell::Nothing
            } else {
                figure(median(large))
            },
            figure(done.requests),
            figure(done.p50),
            figure(done.p99),
            figure(done.max),
        ]);
    }
    Ok(table)
}

/// Small changes on one scene while the first of two large changes is made to another, again and again (the second undoes it, and is
/// not measured). Seconds of each large change.
fn beside(
    setup: &Setup<'_>,
    server: &Server,
    small: &[Bytes],
    large: Option<[&Bytes; 2]>,
    full: &Bytes,
) -> Result<(Done, Vec<f64>), Failure> {
    let (http, kind) = (server.http, Protocol::Protobuf.content_type());
    let deleting = large.is_some_and(|[measured, _]| measured != full);
    on_this_thread(async {
        create(http, "small", settings_of_cubes()).await?;
        create(http, "large", settings_of_cubes()).await?;
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
        let (time, path) = (setup.time, changes("large"));
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
        if done.time >= setup.time || rest.is_empty() {
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
        check_and_drop(http, "small", Kind::Cubes, done.requests).await?;
        let there = match large {
            Some(_) if !deleting => setup.args.large,
            _ => 0,
        };
        check_and_drop(http, "large", Kind::Cubes, there).await
    })?;
    Ok((done, seconds))
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
