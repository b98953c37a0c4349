//! What the service counts, for whoever installs an exporter. No label by scene: their number is the
//! clients' choice. What there is at the moment, such as scenes and cubes, is read by who renders the metrics, from
//! [`super::Service::gauges`].

use std::time::Duration;

use metrics::{counter, describe_counter, describe_gauge, describe_histogram, gauge, histogram};

use crate::engine::Counts;

const CHANGES: &str = "union3d_changes_total";
const INSERTED: &str = "union3d_cubes_inserted_total";
const DELETED: &str = "union3d_cubes_deleted_total";
const REFUSED: &str = "union3d_changes_refused_total";
const QUEUE_FULL: &str = "union3d_queue_full_total";
const COMMITS: &str = "union3d_commits_total";
const COMMIT: &str = "union3d_commit_seconds";
const COMMIT_CHANGES: &str = "union3d_commit_changes";
const SYNC: &str = "union3d_sync_seconds";
const STOPS: &str = "union3d_scene_stops_total";
const RECOVERIES: &str = "union3d_recoveries_total";
const RECOVERY: &str = "union3d_recovery_seconds";
const SNAPSHOTS: &str = "union3d_snapshots_total";
const CHECKPOINT: &str = "union3d_checkpoint_seconds";
const CHECKPOINT_FAILURES: &str = "union3d_checkpoint_failures_total";
const AUDIT_DIFFERENCES: &str = "union3d_audit_differences_total";

/// What the service counts.
const METERS: &[Meter] = &[
    Meter::counter(CHANGES, "Changes made durable"),
    Meter::counter(INSERTED, "Cubes and solids inserted"),
    Meter::counter(DELETED, "Cubes and solids deleted"),
    Meter::counter(
        REFUSED,
        "Changes refused because they do not fit their scene",
    ),
    Meter::counter(QUEUE_FULL, "Changes refused because too many were waiting"),
    Meter::counter(COMMITS, "Commits: changes that wait at once share one"),
    Meter::histogram(COMMIT, "Time of one commit, its sync included"),
    Meter::histogram(COMMIT_CHANGES, "Changes that shared one commit"),
    Meter::histogram(
        SYNC,
        "Time of one commit that the disk took: writing the write-ahead file, and its sync",
    ),
    Meter::counter(STOPS, "Times a scene stopped because its disk failed"),
    Meter::counter(
        RECOVERIES,
        "Scenes brought to their last durable state by replay",
    ),
    Meter::histogram(RECOVERY, "Time of one replay"),
    Meter::counter(SNAPSHOTS, "Snapshots written"),
    Meter::histogram(
        CHECKPOINT,
        "Time of moving a write-ahead file into its database",
    ),
    Meter::counter(
        CHECKPOINT_FAILURES,
        "Times a scene stopped because its write-ahead file could not be moved into its database",
    ),
    Meter::counter(
        AUDIT_DIFFERENCES,
        "Audits whose recount differed from the totals that are kept",
    ),
];

/// A metric: its name, and what it says.
#[derive(Clone, Copy, Debug)]
pub struct Meter {
    name: &'static str,
    shape: Shape,
    help: &'static str,
    /// A label and the values that are known before anything is counted; none when its series come as they come.
    label: Option<(&'static str, &'static [&'static str])>,
}

#[derive(Clone, Copy, Debug)]
enum Shape {
    Counter,
    Gauge,
    Histogram,
}

impl Meter {
    /// What only grows.
    pub const fn counter(name: &'static str, help: &'static str) -> Self {
        Self::new(name, Shape::Counter, help)
    }

    /// What there is at the moment.
    pub const fn gauge(name: &'static str, help: &'static str) -> Self {
        Self::new(name, Shape::Gauge, help)
    }

    /// How often it was how much.
    pub const fn histogram(name: &'static str, help: &'static str) -> Self {
        Self::new(name, Shape::Histogram, help)
    }

    const fn new(name: &'static str, shape: Shape, help: &'static str) -> Self {
        Self {
            name,
            shape,
            help,
            label: None,
        }
    }

    /// The same with a series for each value of a label. Without values it has series that are not known beforehand.
    #[must_use]
    pub const fn by(self, label: &'static str, values: &'static [&'static str]) -> Self {
        Self {
            label: Some((label, values)),
            ..self
        }
    }

    /// Describes it to the recorder that is installed and shows its series, so that the first thing that is counted is a step from
    /// zero: who asks how much a counter has grown does not see the step of a series that is new.
    pub fn describe(&self) {
        let Self { name, help, .. } = *self;
        match self.shape {
            Shape::Counter => describe_counter!(name, help),
            Shape::Gauge => describe_gauge!(name, help),
            Shape::Histogram => describe_histogram!(name, help),
        }
        match self.label {
            None => self.begin(Vec::new()),
            Some((label, values)) => values
                .iter()
                .for_each(|value| self.begin(vec![metrics::Label::new(label, *value)])),
        }
    }

    fn begin(&self, labels: Vec<metrics::Label>) {
        match self.shape {
            Shape::Counter => counter!(self.name, labels).increment(0),
            Shape::Gauge => gauge!(self.name, labels).increment(0),
            // It is there as soon as it has been asked for.
            Shape::Histogram => drop(histogram!(self.name, labels)),
        }
    }
}

/// Describes the metrics to the recorder that is installed. Call it once, after installing.
pub fn describe_metrics() {
    METERS.iter().for_each(Meter::describe);
}

/// A count as a histogram takes it: a commit never has that many changes.
fn narrow(count: usize) -> u32 {
    count.try_into().unwrap_or(u32::MAX)
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

/// A commit of so many changes: how long it took in all, and of that the disk.
pub(super) fn committed(changes: usize, time: Duration, sync: Duration) {
    counter!(COMMITS).increment(1);
    histogram!(COMMIT).record(time);
    histogram!(COMMIT_CHANGES).record(narrow(changes));
    histogram!(SYNC).record(sync);
}

pub(super) fn scene_stopped() {
    counter!(STOPS).increment(1);
}

pub(super) fn recovered(time: Duration) {
    counter!(RECOVERIES).increment(1);
    histogram!(RECOVERY).record(time);
}

pub(super) fn checkpointed(time: Duration) {
    histogram!(CHECKPOINT).record(time);
}

pub(super) fn checkpoint_failed() {
    counter!(CHECKPOINT_FAILURES).increment(1);
}

pub(super) fn snapshot_written() {
    counter!(SNAPSHOTS).increment(1);
}

pub(super) fn audit_differed() {
    counter!(AUDIT_DIFFERENCES).increment(1);
}
