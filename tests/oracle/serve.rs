//! A server of the program, for tests of the commands that send to one.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// A server of its own, ended with the test.
pub(crate) struct Server {
    pub(crate) child: Child,
    /// Its address over HTTP.
    pub(crate) url: String,
    /// And over gRPC.
    #[allow(dead_code, reason = "not every test program asks over gRPC")]
    pub(crate) grpc: String,
}

impl Server {
    pub(crate) fn start(data: &Path) -> Self {
        Self::start_at(data, "127.0.0.1:0")
    }

    /// With gRPC at an address.
    pub(crate) fn start_at(data: &Path, grpc: &str) -> Self {
        union3d::wire::trust::install_provider();
        let mut child = Command::new(env!("CARGO_BIN_EXE_union3d"))
            .args([
                "serve",
                "--http",
                "127.0.0.1:0",
                "--grpc",
                grpc,
                "--log-filter",
                "error",
                "--data",
            ])
            .arg(data)
            .stdout(Stdio::piped())
            .spawn()
            .expect("the binary runs");
        let mut line = String::new();
        BufReader::new(child.stdout.take().expect("piped"))
            .read_line(&mut line)
            .unwrap();
        let mut words = line.split_whitespace();
        let url = words.nth(1).expect("the address").to_owned();
        let grpc = words.next().expect("the other address").to_owned();
        Self { child, url, grpc }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.child.kill().expect("it is ours");
        self.child.wait().expect("it ends");
    }
}
