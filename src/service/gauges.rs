//! What there is now, for those who watch the service: of each scene, and of all of them together.
//!
//! Sums and maxima only: how many scenes there are is the clients' choice, and a series for each would be, too.
//!
//! ```text
//!   writer ──> Pulse ─┐
//!   inbox ────────────┼─> Load (a scene) ──> Gauges (all of them) ──> whoever asks, now and then
//!   files ────────────┘
//! ```

use std::path::Path;
use std::time::{Duration, Instant};

use parking_lot::Mutex;

use super::any::AnyScene;
use super::machine::{Disk, disk};
use super::{Readiness, SceneState};

/// The same in all scenes: together, and where it is most.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Spread {
    /// All scenes together.
    pub sum: u64,
    /// The scene that has most.
    pub max: u64,
}

/// The scenes of one state together.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct StateGauges {
    /// How many there are.
    pub scenes: u64,
    /// Sizes of their write-ahead files.
    pub write_ahead_bytes: u64,
}

/// What there is now.
#[derive(Clone, Debug, Default)]
pub struct Gauges {
    /// Scenes by state, as [`SceneState::NAMES`] has them.
    pub states: [StateGauges; SceneState::NAMES.len()],
    /// Cubes of all scenes that answer.
    pub cubes: u64,
    /// Solids of all scenes that answer.
    pub solids: u64,
    /// Changes that wait for their writers.
    pub queue_changes: Spread,
    /// Operations in them.
    pub queue_operations: Spread,
    /// Size of the largest write-ahead file.
    pub write_ahead_bytes_max: u64,
    /// Pages that are not in their databases.
    pub unmoved_pages: Spread,
    /// The longest time that a checkpoint has been due.
    pub checkpoint_due_max: Duration,
    /// Those who are told of each new state of a scene.
    pub subscriptions: u64,
    /// How far the replay that began at start has come, in percent: 100 when it is done.
    pub replay_percent: u8,
    /// The disk of the data directory; none when it cannot be asked.
    pub disk: Option<Disk>,
}

impl Spread {
    fn add(&mut self, one: u64) {
        self.sum += one;
        self.max = self.max.max(one);
    }
}

impl Gauges {
    pub(super) fn new(scenes: &[AnyScene], readiness: &Readiness, data: &Path) -> Self {
        let mut gauges = Self {
            replay_percent: match readiness {
                Readiness::Ready { .. } => 100,
                Readiness::Recovering { percent } => *percent,
            },
            disk: disk(data).ok(),
            ..Self::default()
        };
        for scene in scenes {
            gauges.add(scene);
        }
        gauges
    }

    fn add(&mut self, scene: &AnyScene) {
        let load = scene.load();
        let state = &mut self.states[scene.state().index()];
        state.scenes += 1;
        state.write_ahead_bytes += load.write_ahead_bytes;
        let bodies = match scene {
            AnyScene::Cubes(_) => &mut self.cubes,
            AnyScene::Solids(_) => &mut self.solids,
        };
        *bodies += scene.newest().map_or(0, |(_, count)| count);
        self.queue_changes.add(load.queue_changes);
        self.queue_operations.add(load.queue_operations);
        self.write_ahead_bytes_max = self.write_ahead_bytes_max.max(load.write_ahead_bytes);
        self.unmoved_pages.add(load.unmoved_pages);
        self.checkpoint_due_max = self.checkpoint_due_max.max(load.checkpoint_due);
        self.subscriptions += load.subscriptions;
    }
}

/// What the writer of a scene shows of its log.
#[derive(Default)]
pub(super) struct Pulse(Mutex<Unmoved>);

#[derive(Default)]
struct Unmoved {
    pages: u64,
    due_since: Option<Instant>,
}

impl Pulse {
    /// A writer begins.
    pub(super) fn begin(&self, pages: u64) {
        *self.0.lock() = Unmoved {
            pages,
            due_since: None,
        };
    }

    /// After a commit, with the pages that are not in the database and whether they are so many that they should be.
    pub(super) fn committed(&self, pages: u64, is_due: bool) {
        let mut unmoved = self.0.lock();
        let since = unmoved.due_since;
        unmoved.pages = pages;
        unmoved.due_since = is_due.then(|| since.unwrap_or_else(Instant::now));
    }

    /// After a checkpoint. One that has left pages has not made the write-ahead file shorter: it stays due.
    pub(super) fn checkpointed(&self, left: u64) {
        let mut unmoved = self.0.lock();
        unmoved.pages = left;
        if left == 0 {
            unmoved.due_since = None;
        }
    }

    /// The pages, and how long they should have been moved.
    fn read_at(&self, now: Instant) -> (u64, Duration) {
        let unmoved = self.0.lock();
        let due = unmoved.due_since.map(|since| now.duration_since(since));
        (unmoved.pages, due.unwrap_or_default())
    }

    /// The pages, and how long they should have been moved.
    pub(super) fn read(&self) -> (u64, Duration) {
        self.read_at(Instant::now())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A checkpoint is due from the commit that made it so until one has left nothing behind, however many commits come in between.
    #[test]
    fn a_checkpoint_is_due_until_it_has_moved_everything() {
        let pulse = Pulse::default();
        let later = || Instant::now() + Duration::from_secs(60);
        let is_due = |pulse: &Pulse| pulse.read_at(later()).1 >= Duration::from_secs(60);
        pulse.begin(3);
        pulse.committed(10, false);
        assert_eq!(pulse.read_at(later()), (10, Duration::ZERO));
        pulse.committed(1000, true);
        assert!(is_due(&pulse));
        let (_, before) = pulse.read_at(later());
        pulse.checkpointed(400);
        pulse.committed(1100, true);
        let (pages, after) = pulse.read_at(later());
        assert_eq!(pages, 1100);
        assert!(after >= before, "it was due all the time");
        pulse.checkpointed(0);
        assert_eq!(pulse.read_at(later()), (0, Duration::ZERO));
    }

    #[test]
    fn a_spread_has_the_sum_and_the_most() {
        let mut spread = Spread::default();
        [3, 7, 2].into_iter().for_each(|one| spread.add(one));
        assert_eq!(spread, Spread { sum: 12, max: 7 });
    }
}
