//! A real server: `union3d serve` in a process of its own, on a data directory on disk.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use super::link::Link;
use crate::failure::{Failure, about};
use crate::machine::{Resident, resident};

/// How long a server may take to replay what there is.
const PATIENCE: Duration = Duration::from_mins(10);

/// The program whose server is measured when none is named: the union3d that was built beside this executable.
/// # Errors
/// There is none.
pub(super) fn beside_this() -> Result<PathBuf, Failure> {
    let name = format!("union3d{}", std::env::consts::EXE_SUFFIX);
    let program = std::env::current_exe()?.with_file_name(name);
    if program.is_file() {
        return Ok(program);
    }
    Err(format!(
        "{} is not there: build both with `cargo build --release --workspace`, or name one with --server",
        program.display()
    )
    .into())
}

/// A server process; it ends when this is dropped.
#[derive(Debug)]
pub(super) struct Server {
    process: Child,
    pub(super) http: SocketAddr,
    pub(super) grpc: SocketAddr,
    /// From the start of the process until it was ready.
    pub(super) start: Duration,
}

impl Server {
    /// Starts a server on a data directory and waits until it is ready.
    pub(super) async fn start(program: &Path, data: &Path) -> Result<Self, Failure> {
        let started = Instant::now();
        let mut command = Command::new(program);
        command
            .args(["serve", "--http", "127.0.0.1:0", "--grpc", "127.0.0.1:0"])
            .args(["--log-filter", "warn,tower_http=off"])
            .arg("--data")
            .arg(data)
            .stdin(Stdio::null())
            .stdout(Stdio::piped());
        let mut process = command.spawn().map_err(about(program))?;
        let output = process.stdout.take().expect("it is piped");
        let mut greeting = String::new();
        BufReader::new(output).read_line(&mut greeting)?;
        let address = |kind: &str| {
            let mut words = greeting.split_whitespace();
            words.find_map(|word| word.strip_prefix(kind)?.parse().ok())
        };
        let (Some(http), Some(grpc)) = (address("http://"), address("grpc://")) else {
            process.kill()?;
            let status = process.wait()?;
            return Err(format!("the server did not start ({status}): {greeting:?}").into());
        };
        let mut server = Self {
            process,
            http,
            grpc,
            start: Duration::ZERO,
        };
        let mut link = Link::open(server.http).await?;
        while !link.get("/readyz").await?.0.is_success() {
            if started.elapsed() > PATIENCE {
                return Err("the server is not ready after ten minutes".into());
            }
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
        server.start = started.elapsed();
        Ok(server)
    }

    /// Its resident memory.
    pub(super) fn resident(&self) -> Resident {
        resident(self.process.id())
    }

    /// Ends it without notice, as a crash does.
    pub(super) fn kill(mut self) -> std::io::Result<()> {
        self.process.kill()?;
        self.process.wait()?;
        Ok(())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It may have ended already; there is nobody to tell otherwise.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
