//! The times of changes: those of the machine's clock, as long as that goes on.
//!
//! When it is set back, or is behind the newest change of the scene, times go on at half the pace of the monotonic clock, until the
//! machine's clock has caught up: they neither go back nor stand still.

use std::cell::Cell;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// The clock of one scene.
#[derive(Default, Debug)]
pub(super) struct Clock {
    /// The last time at which the machine's clock was right, ms since 1970, and when that was.
    anchor: Cell<Option<(u64, Instant)>>,
}

impl Clock {
    /// Now, ms since 1970; not before `newest_ms`, the time of the newest change.
    pub(super) fn now_ms(&self, newest_ms: u64) -> u64 {
        self.at(now_ms(), Instant::now(), newest_ms)
    }

    fn at(&self, machine_ms: u64, now: Instant, newest_ms: u64) -> u64 {
        let (from_ms, since) = self.anchor.get().unwrap_or((newest_ms, now));
        let passed_ms = now.saturating_duration_since(since).as_millis();
        let slowed_ms = from_ms.saturating_add(u64::try_from(passed_ms).unwrap_or(u64::MAX) / 2);
        let is_right = machine_ms >= slowed_ms;
        let anchor = if is_right {
            (machine_ms, now)
        } else {
            (from_ms, since)
        };
        self.anchor.set(Some(anchor));
        machine_ms.max(slowed_ms).max(newest_ms)
    }
}

/// The machine's time, ms since 1970.
pub(super) fn now_ms() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| {
            u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
        })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// The times of changes a millisecond apart, where the machine's clock is `machine` (of the milliseconds that have passed).
    fn times(newest_ms: u64, length_ms: u64, machine: impl Fn(u64) -> u64) -> Vec<u64> {
        let (start, clock, mut newest) = (Instant::now(), Clock::default(), newest_ms);
        let time = |passed| {
            newest = clock.at(
                machine(passed),
                start + Duration::from_millis(passed),
                newest,
            );
            newest
        };
        (0..length_ms).map(time).collect()
    }

    #[test]
    fn times_are_those_of_the_machine_as_long_as_they_go_on() {
        let times = times(0, 100, |passed| 5_000 + passed);
        assert!(times.iter().copied().eq(5_000..5_100));
    }

    /// Set an hour ahead, and back after 100 ms: times go on, and are right again when the hour has come twice.
    #[test]
    fn times_go_on_when_the_clock_jumps_forth_and_back() {
        let times = times(0, 10_000, |passed| {
            passed
                + if (100..200).contains(&passed) {
                    3_600
                } else {
                    0
                }
        });
        assert!(times.is_sorted());
        // From 200 on there are 3,600 ms to be caught up.
        assert_eq!((times[199], times[200]), (3_799, 3_799));
        assert_eq!(times[2_199], 4_799);
        assert_eq!(times[7_399], 7_399);
        assert!((7_399..10_000).all(|passed| times[passed] == passed as u64));
    }

    /// A scene whose newest change is of the time before the clock was set back, in another process.
    #[test]
    fn times_go_on_from_those_of_the_scene() {
        let times = times(9_000, 1_000, |passed| passed);
        assert!(times.is_sorted());
        assert_eq!((times[0], times[999]), (9_000, 9_499));
    }
}
