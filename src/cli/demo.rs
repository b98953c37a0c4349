//! `union3d demo`: the server, a client of it, and something to look at.

use std::io::{ErrorKind, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use serde_json::Value;
use tokio::net::TcpListener;
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

use super::client::{Client, SceneWanted};
use super::credentials::Credentials;
use super::cutter::{Cutter, Length, Unit};
use super::{Outcome, report};
use union3d::config::{ListenAddress, ServeConfig};
use union3d::geometry::Place;
use union3d::service::{Readiness, Service};
use union3d::toolpath::{Event, Interpreter, Motion, Options};
use union3d::wire::access::Access;
use union3d::wire::convert::{Anchor, Settings, SettingsDocument};
use union3d::wire::door::Door;
use union3d::wire::http::Limits;
use union3d::wire::{grpc, http};

/// The program that is milled.
const PROGRAM: &str = include_str!("demo.gcode");

/// Edge of the cutter the program is made for, and the way between two positions. Units: mm.
const EDGE: f64 = 3.0;
const STEP: f64 = 0.05;

/// How many times the totals are shown.
const LINES: usize = 24;

const SCENE: &str = "demo";

/// Run a server and stream a bundled tool path into it
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Starts a server, streams a bundled tool path (a small plate with pockets, bores and an outline) into it through the \
public HTTP API, prints the totals as they change, then the mass properties and requests to try, and serves on until Ctrl-C.

The data goes to a temporary directory, gone afterwards, unless --data says where to keep it."
)]
pub(crate) struct Args {
    /// Address that HTTP listens on; port 0 picks a free one [default: 127.0.0.1:7373, or a free port when that is taken]
    #[arg(long, value_name = "ADDRESS")]
    http: Option<ListenAddress>,
    /// Address that gRPC listens on; port 0 picks a free one [default: 127.0.0.1:7374, or a free port when that is taken]
    #[arg(long, value_name = "ADDRESS")]
    grpc: Option<ListenAddress>,
    /// Data directory, kept afterwards [default: a temporary one]
    #[arg(long, value_name = "DIRECTORY")]
    data: Option<PathBuf>,
    /// End when the tool path is done
    #[arg(long)]
    once: bool,
}

/// Runs `demo`.
pub(crate) fn run(args: Args) -> Outcome {
    // Named, so that it is there until the service has closed its files.
    let temporary = match args.data {
        None => Some(tempfile::tempdir()?),
        Some(_) => None,
    };
    let config = ServeConfig {
        data: match (&args.data, &temporary) {
            (Some(data), _) => data.clone(),
            (None, Some(directory)) => directory.path().to_owned(),
            (None, None) => unreachable!("without --data there is a temporary directory"),
        },
        ..ServeConfig::default()
    };
    let runtime = tokio::runtime::Runtime::new()?;
    runtime.block_on(demo(args, &config))?;
    Ok(ExitCode::SUCCESS)
}

async fn demo(args: Args, config: &ServeConfig) -> Result<(), Box<dyn std::error::Error>> {
    let listener = listen(args.http.as_ref(), &config.http, "--http").await?;
    let grpc_listener = listen(args.grpc.as_ref(), &config.grpc, "--grpc").await?;
    let url = format!("http://{}", listener.local_addr()?);
    let grpc_address = grpc_listener.local_addr()?;
    let service = Service::start(config.service())?;
    let stop = CancellationToken::new();
    let server = tokio::spawn({
        let (service, stop) = (service.clone(), stop.clone());
        async move {
            let (door, limits, access) = (Door::default(), Limits::default(), Access::default());
            let http = http::serve(
                door.clone(),
                listener,
                service.clone(),
                limits,
                access.clone(),
                stop.clone(),
            );
            let grpc = grpc::serve(door, grpc_listener, service, limits, access, stop);
            tokio::join!(http, grpc)
        }
    });
    writeln!(
        std::io::stdout(),
        "serving {url} grpc://{grpc_address} (data in {})",
        config.data.display()
    )?;
    while let Readiness::Recovering { .. } = service.readiness() {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let work = async {
        show(&url).await?;
        if !args.once {
            writeln!(std::io::stdout(), "Ctrl-C ends the demo.")?;
            std::future::pending::<()>().await;
        }
        Ok(())
    };
    let outcome = tokio::select! {
        outcome = work => outcome,
        signalled = signalled() => signalled.map_err(Into::into),
    };
    stop.cancel();
    // Somebody may be listening to a stream that has no end; the changes that were taken are durable anyway.
    let _ = tokio::time::timeout(Duration::from_secs(2), server).await;
    service.shutdown().await;
    outcome
}

/// Waits until the process is asked to end, so that its temporary directory goes with it.
async fn signalled() -> std::io::Result<()> {
    let mut terminate = signal(SignalKind::terminate())?;
    tokio::select! {
        interrupted = tokio::signal::ctrl_c() => interrupted,
        _ = terminate.recv() => Ok(()),
    }
}

/// The address that was asked for, or the usual one, or when somebody has that, a free one.
async fn listen(
    asked: Option<&ListenAddress>,
    usual: &ListenAddress,
    flag: &str,
) -> Result<TcpListener, String> {
    let address = asked.unwrap_or(usual);
    let cannot = |error: std::io::Error| {
        format!("cannot listen on {address}: {error} ({flag} takes another address)")
    };
    let mut sockets = address.resolve().await.map_err(cannot)?;
    // It has no keys.
    if let Some(open) = sockets.iter().find(|socket| !socket.ip().is_loopback()) {
        return Err(format!(
            "{flag}: {open} is reached from elsewhere, and a demo lets everybody in; `union3d serve` can be asked from elsewhere"
        ));
    }
    match TcpListener::bind(&*sockets).await {
        Err(error) if error.kind() == ErrorKind::AddrInUse && asked.is_none() => {
            eprintln!("{usual} is taken (another union3d?), so this demo takes a free port.");
            for socket in &mut sockets {
                socket.set_port(0);
            }
            TcpListener::bind(&*sockets).await.map_err(cannot)
        }
        bound => bound.map_err(cannot),
    }
}

/// Streams the tool path as any client would, and prints what the answers say.
async fn show(url: &str) -> Result<(), Box<dyn std::error::Error>> {
    let mut output = std::io::stdout();
    let places = places()?;
    writeln!(
        output,
        "A cubic cutter of {EDGE} mm follows {} lines of G-code; its {} places go into scene {SCENE:?}.\n",
        PROGRAM.lines().count(),
        report::figure(&places.len().into()),
    )?;
    let wanted = SceneWanted {
        name: SCENE.to_owned(),
        edge: EDGE,
        steps_per_unit: 1000,
        unit: Unit::Mm.label().to_owned(),
        stock: None,
    };
    // The ids always begin at 1: on a directory with the plate of an earlier demo this changes nothing.
    let (client, _) = Client::open(url, &Credentials::default(), &wanted).await?;
    writeln!(
        output,
        "{:>10}{:>18}{:>18}{:>18}",
        "cubes", "volume mm^3", "area mm^2", "edges mm"
    )?;
    let mut first_id = 1;
    for batch in places.chunks(places.len().div_ceil(LINES)) {
        let found = client.insert_and_measure(first_id, batch).await?;
        first_id += batch.len() as u64;
        writeln!(
            output,
            "{:>10}{:>18}{:>18}{:>18}",
            report::figure(&found["cubes"]),
            report::column(&found["volume"]),
            report::column(&found["area"]),
            report::column(&found["edge_length"]["total"]),
        )?;
    }
    let found: Value = serde_json::from_str(client.mass_properties().await?.get())?;
    writeln!(output, "\n{}", report::table(&found, Unit::Mm.label()))?;
    let scene = client.url();
    writeln!(
        output,
        "Try:
  curl {scene}/mass-properties
  curl -N {scene}/mass-properties/stream
  curl -X POST {scene}/changes -H 'content-type: application/json' -d '{{\"insert\":[{{\"id\":1000001,\"at\":[60,0,0]}}]}}'
  curl -X DELETE {scene}/cubes/1000001
  curl '{scene}/contains?at=0,0,-1'
  curl '{scene}/history?limit=3'
  curl -X POST {scene}/audit -H 'content-type: application/json'
or read {url}/docs

See it: {url}/scenes/{SCENE}"
    )?;
    Ok(())
}

/// The places of the cutter along the bundled program.
fn places() -> Result<Vec<Place>, Box<dyn std::error::Error>> {
    let wanted = SettingsDocument {
        anchor: Anchor::Center,
        ..SettingsDocument::with_edge(EDGE)
    };
    let settings = Settings::check(&wanted).map_err(|faults| super::input::faults(&faults))?;
    let mut cutter = Cutter::new(&settings, Unit::Mm, STEP, Length::Given(EDGE));
    let mut places = Vec::new();
    for event in Interpreter::new(PROGRAM, Options::default()) {
        if let Event::Move(next) = event?
            && next.motion != Motion::Rapid
        {
            for place in cutter.places(&next) {
                places.push(place?);
            }
        }
    }
    Ok(places)
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use super::*;

    /// Somebody has the usual address: without an address of its own the demo takes a free one, with one it does not start.
    #[tokio::test]
    async fn it_takes_another_port_when_the_usual_one_is_taken() {
        let any = SocketAddr::from(([127, 0, 0, 1], 0));
        let taken = TcpListener::bind(any).await.unwrap();
        let usual = taken.local_addr().unwrap();
        let free = listen(None, &usual.into(), "--http").await.unwrap();
        let free = free.local_addr().unwrap();
        assert_eq!(free.ip(), usual.ip());
        assert_ne!(free.port(), usual.port());
        let refused = listen(Some(&usual.into()), &any.into(), "--http").await;
        let refused = refused.unwrap_err();
        assert!(refused.contains("--http"), "{refused}");
    }

    #[tokio::test]
    async fn it_is_not_reached_from_elsewhere() {
        let all: ListenAddress = ":0".parse().unwrap();
        let refused = listen(Some(&all), &all, "--grpc").await.unwrap_err();
        assert!(refused.starts_with("--grpc: "), "{refused}");
    }
}
