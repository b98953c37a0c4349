//! What waits in one scene, for those who watch it.

use std::time::Duration;

/// What waits in a scene: for its writer, and for its database.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Load {
    /// Changes that wait for the writer.
    pub queue_changes: u64,
    /// Operations in them.
    pub queue_operations: u64,
    /// Size of SQLite's write-ahead file.
    pub write_ahead_bytes: u64,
    /// Pages of that file which were not in the database at the last commit; 0 since the last checkpoint that left none.
    pub unmoved_pages: u64,
    /// How long there have been so many of them that they should be moved; zero while there are fewer.
    pub checkpoint_due: Duration,
    /// Those who are told of each new state.
    pub subscriptions: u64,
}
