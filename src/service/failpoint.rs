//! Where a test makes a scene's writer fail or wait.

use std::sync::Arc;

use crate::log::LogError;

/// A place at which a test can make the writer of a scene fail.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum FailPoint {
    /// Before a log is opened.
    Open,
    /// Before a group is appended: the disk keeps nothing of it.
    Append,
    /// After a group was appended: the disk keeps it, but the writer does not know.
    Appended,
}

/// Asked at every [`FailPoint`]: the error to fail with, if any. For tests only.
pub type FailHook = Arc<dyn Fn(FailPoint) -> Option<LogError> + Send + Sync>;

/// Fails where a test wants it.
pub(super) fn pass(hook: Option<&FailHook>, point: FailPoint) -> Result<(), LogError> {
    hook.and_then(|hook| hook(point)).map_or(Ok(()), Err)
}
