//! Progress bars of long work: on standard error, and only when that is a terminal.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

/// A bar over `size` bytes of input, or a spinner that counts bytes when the size is not known.
pub(crate) fn bytes(size: Option<u64>) -> ProgressBar {
    let (bar, template) = match size {
        Some(size) => (
            ProgressBar::new(size),
            "{bar:30} {percent:>3} % of {total_bytes}, {eta} to go  {msg}",
        ),
        None => (ProgressBar::new_spinner(), "{spinner} {bytes} read  {msg}"),
    };
    let style = ProgressStyle::with_template(template).expect("the templates above are right");
    bar.set_style(style);
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

/// A bar over so many moves of a program.
pub(crate) fn moves(count: u64) -> ProgressBar {
    let bar = ProgressBar::new(count);
    let style = ProgressStyle::with_template(
        "{bar:30} {percent:>3} % of {human_len} moves, {eta} to go  {msg}",
    );
    bar.set_style(style.expect("the template above is right"));
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

/// Writes a line to standard error without tearing the bar.
pub(crate) fn line(bar: &ProgressBar, text: &str) {
    bar.suspend(|| eprintln!("{text}"));
}
