//! The disk that the data is on: what it takes alone, and how much of it is used.

use std::io::Write;
use std::path::Path;
use std::time::Instant;

use crate::figures::median;

/// Appends that the yardstick of the disk is the median of.
pub(super) const APPENDS: usize = 200;
pub(super) const APPEND_BYTES: usize = 4_096;

/// Microseconds of an append and its sync: what the disk alone takes.
pub(super) fn sync_us(directory: &Path) -> std::io::Result<f64> {
    let mut file = tempfile::tempfile_in(directory)?;
    let bytes = [0x5a; APPEND_BYTES];
    let mut times = Vec::new();
    for _ in 0..APPENDS {
        let started = Instant::now();
        file.write_all(&bytes)?;
        file.sync_data()?;
        times.push(started.elapsed().as_secs_f64() * 1e6);
    }
    Ok(median(times))
}

/// Bytes of all files under a directory.
pub(super) fn size_of(directory: &Path) -> std::io::Result<u64> {
    let mut size = 0;
    for entry in std::fs::read_dir(directory)? {
        let entry = entry?;
        let metadata = entry.metadata()?;
        size += if metadata.is_dir() {
            size_of(&entry.path())?
        } else {
            metadata.len()
        };
    }
    Ok(size)
}
