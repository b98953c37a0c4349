//! Machine time, and what a change removed in it.

use std::time::Duration;

/// Longest machine time of a change. Units: seconds.
pub const DURATION_SECONDS_MAX: f64 = 1e9;

/// Machine time in whole nanoseconds.
/// # Errors
/// What is wrong with it.
pub fn duration_ns(seconds: f64) -> Result<u64, &'static str> {
    Some(seconds)
        .filter(|seconds| (0.0..=DURATION_SECONDS_MAX).contains(seconds))
        .and_then(|seconds| Duration::try_from_secs_f64(seconds).ok())
        .and_then(|duration| u64::try_from(duration.as_nanos()).ok())
        .ok_or("is not a number of seconds from 0 to 1e9")
}

/// Volume removed in a second; none without a duration above 0.
pub fn removal_rate(volume_removed: f64, duration: Option<f64>) -> Option<f64> {
    duration
        .filter(|seconds| *seconds > 0.0)
        .map(|seconds| volume_removed / seconds)
}

/// Seconds of so many nanoseconds.
pub fn duration_user(nanoseconds: u64) -> f64 {
    Duration::from_nanos(nanoseconds).as_secs_f64()
}
