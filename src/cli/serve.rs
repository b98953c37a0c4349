//! `union3d serve`: the server, from its settings to its end.

use std::io::{IsTerminal, Write};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use axum::serve::ListenerExt;
use indicatif::{ProgressBar, ProgressStyle};
use tokio::net::TcpListener;
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;
use tracing_subscriber::EnvFilter;
use union3d::config::{LogFormat, ServeConfig, ServeFlags};
use union3d::service::{Readiness, Service};
use union3d::wire::grpc;
use union3d::wire::http::{Limits, install_metrics, keep_metrics, router};

use super::Outcome;

/// How long requests may go on after the signal before changes are refused and streams are ended.
const GRACE: Duration = Duration::from_secs(1);

/// How long connections may take to close after that.
const CLOSE: Duration = Duration::from_secs(5);

/// Run the server
///
/// Prints one line, `listening http://ADDRESS grpc://ADDRESS`, on standard output once it listens, and logs to standard error. Scenes that are
/// there already are replayed in the background: GET /readyz is 503 until that is done. Ctrl-C (SIGINT) or SIGTERM drains what
/// waits and stops; a second one stops at once, which loses nothing that was acknowledged.
///
/// Every setting has one name: `--queue-changes-max` here, `queue_changes_max` in the TOML file, `UNION3D_QUEUE_CHANGES_MAX` in the
/// environment. Flags win over the environment, which wins over the file.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// TOML file with settings
    #[arg(long, value_name = "FILE", env = "UNION3D_CONFIG")]
    config: Option<PathBuf>,
    #[command(flatten)]
    flags: ServeFlags,
}

/// Runs `serve`.
pub(crate) fn run(args: Args) -> Outcome {
    let Args { config, flags } = args;
    let config = ServeConfig::load(config.as_deref(), &flags)?;
    start_log(&config)?;
    let runtime = tokio::runtime::Runtime::new()?;
    runtime.block_on(serve(&config, |http, grpc| {
        let mut out = std::io::stdout();
        let told =
            writeln!(out, "listening http://{http} grpc://{grpc}").and_then(|()| out.flush());
        if let Err(error) = told {
            // Who started it does not read; it serves all the same.
            tracing::warn!("cannot print the addresses: {error}");
        }
    }))
}

/// Serves until a signal; `ready` is called with the addresses of HTTP and gRPC once the sockets accept.
pub(crate) async fn serve(
    config: &ServeConfig,
    ready: impl FnOnce(SocketAddr, SocketAddr),
) -> Outcome {
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let mut stop = async || {
        tokio::select! {
            _ = interrupt.recv() => "SIGINT",
            _ = terminate.recv() => "SIGTERM",
        }
    };
    let listener = listen(config.http, "--http").await?;
    let grpc_listener = listen(config.grpc, "--grpc").await?;
    let (address, grpc_address) = (listener.local_addr()?, grpc_listener.local_addr()?);
    // First, so that what the start counts is counted.
    tokio::spawn(keep_metrics(install_metrics()));
    let service = Service::start(config.service())?;
    let limits = Limits {
        body_bytes_max: config.body_bytes_max.get(),
        change_cubes_max: config.change_cubes_max.get(),
        request_timeout: Duration::from_secs(config.request_timeout_seconds.get()),
        wait_max: Duration::from_secs(config.wait_seconds_max.get()),
    };
    // Answers are small and somebody waits for each.
    let listener = listener.tap_io(|stream| {
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!("cannot set TCP_NODELAY: {error}");
        }
    });
    let draining = CancellationToken::new();
    let http = axum::serve(listener, router(service.clone(), limits))
        .with_graceful_shutdown(draining.clone().cancelled_owned());
    let grpc = grpc::serve(grpc_listener, service.clone(), limits, draining.clone());
    // Both or none: half a server would hide that the other half is gone.
    let mut server = tokio::spawn(async {
        let http = async { http.await.map_err(|error| format!("HTTP: {error}")) };
        let grpc = async { grpc.await.map_err(|error| format!("gRPC: {error}")) };
        tokio::try_join!(http, grpc)
    });
    ready(address, grpc_address);
    let watcher = tokio::spawn(show_recovery(service.clone()));

    let cause = tokio::select! {
        cause = stop() => cause,
        ended = &mut server => return Err(format!("the server ended: {ended:?}").into()),
    };
    tracing::info!("{cause}: draining; once more to stop at once");
    watcher.abort();
    draining.cancel();
    let end = async {
        // What is under way may finish; then changes are refused, which ends the streams, and what waits is done.
        let over = tokio::time::timeout(GRACE, &mut server).await.is_ok();
        service.shutdown().await;
        if !over && tokio::time::timeout(CLOSE, &mut server).await.is_err() {
            tracing::warn!("some connections did not close; leaving them");
        }
    };
    tokio::select! {
        () = end => tracing::info!("stopped"),
        cause = stop() => {
            tracing::warn!("{cause}: stopping at once");
            // Not by return: that would wait for the writers after all.
            std::process::exit(1);
        }
    }
    Ok(ExitCode::SUCCESS)
}

async fn listen(address: SocketAddr, flag: &str) -> Result<TcpListener, String> {
    TcpListener::bind(address).await.map_err(|error| {
        format!("cannot listen on {address}: {error}; choose another address with {flag}")
    })
}

/// Logs to standard error, as configured.
fn start_log(config: &ServeConfig) -> Result<(), Box<dyn std::error::Error>> {
    let filter = EnvFilter::try_new(&config.log_filter)
        .map_err(|error| format!("configuration: log_filter {:?}: {error}", config.log_filter))?;
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr);
    match config.log_format {
        LogFormat::Text => builder.init(),
        LogFormat::Json => builder.json().init(),
    }
    Ok(())
}

/// Draws a bar on a terminal while scenes are replayed, and says when that is done.
async fn show_recovery(service: Service) {
    let style = ProgressStyle::with_template("replaying {wide_bar} {percent} %")
        .expect("the template is well-formed");
    let bar = ProgressBar::new(100).with_style(style);
    let mut tick = tokio::time::interval(Duration::from_millis(100));
    loop {
        tick.tick().await;
        match service.readiness() {
            Readiness::Recovering { percent } => bar.set_position(percent.into()),
            Readiness::Ready { troubled } => {
                bar.finish_and_clear();
                for (scene, cause) in &troubled {
                    tracing::warn!(scene = scene.as_str(), "does not answer: {cause}");
                }
                let scenes = service.scenes().len();
                tracing::info!(scenes, troubled = troubled.len(), "ready");
                return;
            }
        }
    }
}
