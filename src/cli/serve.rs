//! `union3d serve`: the server, from its settings to its end.

use std::ffi::OsStr;
use std::io::{IsTerminal, Write};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use tokio::net::TcpListener;
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;
use tracing_subscriber::EnvFilter;
use union3d::config::{ListenAddress, LogFormat, ServeConfig, ServeFlags};
use union3d::service::{Readiness, Service};
use union3d::wire::access::{Access, Hosts};
use union3d::wire::door::{Door, Tls};
use union3d::wire::http::{Limits, install_metrics, keep_metrics};
use union3d::wire::{grpc, http};

use super::Outcome;

/// How long requests may go on after the signal before changes are refused and streams are ended.
const GRACE: Duration = Duration::from_secs(1);

/// How long connections may take to close after that.
const CLOSE: Duration = Duration::from_secs(5);

/// Run the server
///
/// Prints one line, `listening http://ADDRESS grpc://ADDRESS` (with TLS, https and grpcs), on standard output once it listens, and logs to
/// standard error. Scenes that are
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
    let secure = if config.tls_certificate.is_some() {
        "s"
    } else {
        ""
    };
    let runtime = tokio::runtime::Runtime::new()?;
    runtime.block_on(serve(&config, |http, grpc| {
        let mut out = std::io::stdout();
        let told = writeln!(out, "listening http{secure}://{http} grpc{secure}://{grpc}");
        let told = told.and_then(|()| out.flush());
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
    let tls = config
        .certificates()
        .map(Tls::load)
        .transpose()?
        .map(Arc::new);
    let door = Door::new(config.door(), tls.clone());
    let listener = listen(&config.http, "--http").await?;
    let grpc_listener = listen(&config.grpc, "--grpc").await?;
    let (address, grpc_address) = (listener.local_addr()?, grpc_listener.local_addr()?);
    let access = access(config, [address, grpc_address])?;
    // First, so that what the start counts is counted.
    tokio::spawn(keep_metrics(install_metrics()));
    let service = Service::start(config.service())?;
    let limits = Limits {
        body_bytes_max: config.body_bytes_max.get(),
        change_cubes_max: config.change_cubes_max.get(),
        request_timeout: Duration::from_secs(config.request_timeout_seconds.get()),
        wait_max: Duration::from_secs(config.wait_seconds_max.get()),
    };
    let draining = CancellationToken::new();
    tokio::spawn(
        draining
            .clone()
            .run_until_cancelled_owned(access.clone().watch()),
    );
    // Both or none: half a server would hide that the other half is gone.
    let mut server = tokio::spawn({
        let (service, draining) = (service.clone(), draining.clone());
        async move {
            let http = http::serve(
                door.clone(),
                listener,
                service.clone(),
                limits,
                access.clone(),
                draining.clone(),
            );
            let grpc = grpc::serve(door, grpc_listener, service, limits, access, draining);
            tokio::join!(http, grpc)
        }
    });
    ready(address, grpc_address);
    let watcher = tokio::spawn(show_recovery(service.clone()));
    let renewing = tls.map(|tls| {
        let pause = Duration::from_secs(config.tls_renewal_seconds.get());
        tokio::spawn(tls.keep_renewed(pause))
    });

    let cause = tokio::select! {
        cause = stop() => cause,
        ended = &mut server => return Err(format!("the server ended: {ended:?}").into()),
    };
    tracing::info!("{cause}: draining; once more to stop at once");
    watcher.abort();
    if let Some(renewing) = renewing {
        renewing.abort();
    }
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

async fn listen(address: &ListenAddress, flag: &str) -> Result<TcpListener, String> {
    let bound = async { TcpListener::bind(&*address.resolve().await?).await };
    bound.await.map_err(|error| {
        format!("cannot listen on {address}: {error}; choose another address with {flag}")
    })
}

/// Who may do what on a server that listens here.
fn access(
    config: &ServeConfig,
    listening: [SocketAddr; 2],
) -> Result<Access, Box<dyn std::error::Error>> {
    let hosts = Hosts::new(
        listening.map(|address| address.ip()).to_vec(),
        config.allowed_host.clone(),
        config.allow_origin.clone(),
    );
    let access = Access::new(hosts, config.keys.as_deref())?;
    let Some(why) = exposure(
        listening,
        access.has_keys(),
        config.tls_certificate.is_some(),
    ) else {
        return Ok(access);
    };
    if config.insecure {
        tracing::warn!("insecure: {why}");
        Ok(access.insecure(format!("insecure: {why}")))
    } else {
        Err(format!(
            "{why}: give what is missing, or listen on 127.0.0.1; --insecure lets it be where something else keeps strangers out"
        )
        .into())
    }
}

/// Why a server that listens here is open to more than it should be, if it is.
fn exposure(listening: [SocketAddr; 2], has_keys: bool, has_tls: bool) -> Option<String> {
    let mut reached = listening
        .iter()
        .filter(|address| !address.ip().is_loopback());
    let address = reached.next()?;
    let missing = match (has_keys, has_tls) {
        (true, true) => return None,
        (false, true) => "there are no keys (--keys)",
        (true, false) => "there is no TLS (--tls-certificate)",
        (false, false) => "there are no keys (--keys) and no TLS (--tls-certificate)",
    };
    Some(format!(
        "{address} is reached from elsewhere, and {missing}"
    ))
}

/// Logs to standard error, as configured.
fn start_log(config: &ServeConfig) -> Result<(), Box<dyn std::error::Error>> {
    let filter = EnvFilter::try_new(&config.log_filter)
        .map_err(|error| format!("configuration: log_filter {:?}: {error}", config.log_filter))?;
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(has_colours(
            std::io::stderr().is_terminal(),
            std::env::var_os("NO_COLOR").as_deref(),
        ))
        .with_writer(std::io::stderr);
    match config.log_format {
        LogFormat::Text => builder.init(),
        LogFormat::Json => builder.json().init(),
    }
    Ok(())
}

/// Whether log lines have colours: on a terminal, unless somebody wants none there (<https://no-color.org>).
fn has_colours(is_terminal: bool, no_color: Option<&OsStr>) -> bool {
    is_terminal && no_color.is_none_or(OsStr::is_empty)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_who_is_reached_from_elsewhere_needs_keys_and_tls() {
        let [loopback, loopback6, other, all] =
            ["127.0.0.1:1", "[::1]:1", "192.168.0.9:1", "[::]:1"]
                .map(|address| address.parse::<SocketAddr>().unwrap());
        assert_eq!(exposure([loopback, loopback6], false, false), None);
        for reached in [[loopback, other], [all, loopback], [other, all]] {
            assert_eq!(exposure(reached, true, true), None);
            for (has_keys, has_tls) in [(false, false), (true, false), (false, true)] {
                let why = exposure(reached, has_keys, has_tls).unwrap();
                assert_eq!(why.contains("--keys"), !has_keys, "{why}");
                assert_eq!(why.contains("TLS"), !has_tls, "{why}");
            }
        }
    }

    #[test]
    fn colours_are_for_terminals_of_those_who_want_them() {
        for (is_terminal, no_color, expected) in [
            (true, None, true),
            (true, Some(""), true),
            (true, Some("1"), false),
            (false, None, false),
        ] {
            assert_eq!(has_colours(is_terminal, no_color.map(OsStr::new)), expected);
        }
    }
}
