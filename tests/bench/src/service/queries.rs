//! Queries with and without a writer at full speed.

use bytes::Bytes;
use hyper::Method;

use super::bodies::{Kind, Protocol};
use super::link::Link;
use super::load::{self, Done, Summary, Supply, on_this_thread};
use super::scene::{changes, check_and_drop, create};
use super::server::Server;
use super::setup::Setup;
use super::work::settings_of_cubes;
use crate::failure::Failure;
use crate::figures::{median, rate};
use crate::table::{Table, figure, text};

/// What a writer at full speed sends, and how many at a time.
const FULL_SPEED_BATCH: usize = 4_096;
const FULL_SPEED_CLIENTS: usize = 4;

/// A row for each query, with and without a writer.
pub(super) fn measure(setup: &Setup<'_>) -> Result<Table, Failure> {
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
    let server = setup.server("queries")?;
    let bodies = setup.protobuf_bodies(FULL_SPEED_BATCH, FULL_SPEED_CLIENTS)?;
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
            for _ in setup.runs(&what) {
                let (read, write) = ask(setup, &server, query, &bodies, writing)?;
                runs.push(read);
                written.extend(write);
            }
            let done = Summary::of(runs);
            table.push(vec![
                text(query),
                if writing {
                    figure(median(written))
                } else {
                    text("none")
                },
                figure(done.requests),
                figure(done.p50),
                figure(done.p99),
                figure(done.max),
            ]);
        }
    }
    Ok(table)
}

/// One client asks; the writer, if there is one, is on a thread of its own. What it wrote a second.
fn ask(
    setup: &Setup<'_>,
    server: &Server,
    query: &str,
    bodies: &[Bytes],
    writing: bool,
) -> Result<(Done, Option<f64>), Failure> {
    let (http, kind) = (server.http, Protocol::Protobuf.content_type());
    // The first change is there in any case, so that there is something to ask for.
    let (first, rest) = bodies.split_at(1);
    on_this_thread(async {
        create(http, "bench", settings_of_cubes()).await?;
        let mut link = Link::open(http).await?;
        let body = first[0].clone();
        link.expect(Method::POST, &changes("bench"), Some(kind), body)
            .await
    })?;
    let time = setup.time;
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
    on_this_thread(check_and_drop(http, "bench", Kind::Cubes, cubes))?;
    let speed = write.map(|write| rate(write.requests * FULL_SPEED_BATCH, write.time));
    Ok((read, speed))
}
