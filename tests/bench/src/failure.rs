//! What ends a benchmark early: a measurement that is wrong, or something outside that cannot be had.

use std::path::Path;

/// Its text is for people, and names the place.
pub(crate) type Failure = Box<dyn std::error::Error>;

/// Names the file in an error.
pub(crate) fn about(path: &Path) -> impl Fn(std::io::Error) -> String {
    move |error| format!("{}: {error}", path.display())
}
