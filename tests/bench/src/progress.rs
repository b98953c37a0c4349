//! What is being measured: on standard error, and only when that is a terminal.

use std::time::Duration;

use indicatif::ProgressBar;

/// A spinner for work of unknown length that says what is being done.
pub(crate) fn work() -> ProgressBar {
    let bar = ProgressBar::new_spinner();
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}
