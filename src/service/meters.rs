//! What the service counts, for whoever installs an exporter. No label by scene: their number is the
//! clients' choice. Scenes and cubes are counted by who renders the metrics, from [`super::Service::scenes`].

use std::time::Duration;

use metrics::{
    Unit, counter, describe_counter, describe_gauge, describe_histogram, gauge, histogram,
};

use crate::engine::Counts;

const CHANGES: &str = "union3d_changes_total";
const INSERTED: &str = "union3d_cubes_inserted_total";
const DELETED: &str = "union3d_cubes_deleted_total";
const REFUSED: &str = "union3d_changes_refused_total";
const QUEUE_FULL: &str = "union3d_queue_full_total";
const COMMITS: &str = "union3d_commits_total";
const COMMIT: &str = "union3d_commit_seconds";
const WAITING: &str = "union3d_queue_changes";
const STOPS: &str = "union3d_scene_stops_total";
const RECOVERIES: &str = "union3d_recoveries_total";
const RECOVERY: &str = "union3d_recovery_seconds";
const SNAPSHOTS: &str = "union3d_snapshots_total";
const CHECKPOINT_FAILURES: &str = "union3d_checkpoint_failures_total";

/// Describes the metrics to the recorder that is installed. Call it once, after installing.
pub fn describe_metrics() {
    describe_counter!(CHANGES, "Changes made durable");
    describe_counter!(INSERTED, "Cubes and solids inserted");
    describe_counter!(DELETED, "Cubes and solids deleted");
    describe_counter!(
        REFUSED,
        "Changes refused because they do not fit their scene"
    );
    describe_counter!(QUEUE_FULL, "Changes refused because too many were waiting");
    describe_counter!(COMMITS, "Commits: changes that wait at once share one");
    describe_histogram!(
        COMMIT,
        Unit::Seconds,
        "Time of one commit, its sync included"
    );
    describe_gauge!(WAITING, "Changes waiting in the queues of all scenes");
    describe_counter!(STOPS, "Times a scene stopped because its disk failed");
    describe_counter!(
        RECOVERIES,
        "Scenes brought to their last durable state by replay"
    );
    describe_histogram!(RECOVERY, Unit::Seconds, "Time of one replay");
    describe_counter!(SNAPSHOTS, "Snapshots written");
    describe_counter!(
        CHECKPOINT_FAILURES,
        "Times a scene stopped because its write-ahead file could not be moved into its database"
    );
}

/// A count as a gauge takes it: a queue is never as long as that.
fn narrow(count: usize) -> u32 {
    count.try_into().unwrap_or(u32::MAX)
}

pub(super) fn queued(changes: usize) {
    gauge!(WAITING).increment(narrow(changes));
}

pub(super) fn dequeued(changes: usize) {
    gauge!(WAITING).decrement(narrow(changes));
}

pub(super) fn queue_full() {
    counter!(QUEUE_FULL).increment(1);
}

pub(super) fn refused() {
    counter!(REFUSED).increment(1);
}

pub(super) fn changed(net: &Counts) {
    counter!(CHANGES).increment(1);
    counter!(INSERTED).increment(net.inserted);
    counter!(DELETED).increment(net.deleted);
}

pub(super) fn committed(time: Duration) {
    counter!(COMMITS).increment(1);
    histogram!(COMMIT).record(time);
}

pub(super) fn scene_stopped() {
    counter!(STOPS).increment(1);
}

pub(super) fn recovered(time: Duration) {
    counter!(RECOVERIES).increment(1);
    histogram!(RECOVERY).record(time);
}

pub(super) fn checkpoint_failed() {
    counter!(CHECKPOINT_FAILURES).increment(1);
}

pub(super) fn snapshot_written() {
    counter!(SNAPSHOTS).increment(1);
}
