//! A run of the program, for all tests of its commands.

use std::io::Write;
use std::process::{Command, Output, Stdio};

/// Runs `union3d` with these arguments and this standard input, to its end.
pub(crate) fn union3d(arguments: &[&str], input: impl AsRef<[u8]>) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_union3d"))
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary runs");
    let mut stdin = child.stdin.take().expect("piped");
    // A command that refuses its arguments does not read its input: then this write fails, and that is no matter.
    let _ = stdin.write_all(input.as_ref());
    drop(stdin);
    child.wait_with_output().expect("it ends")
}
