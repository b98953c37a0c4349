//! Copies of a log, made while it is written, and bringing one back.
//!
//! A copy is SQLite's own, of one moment, in one file: the scene's database with nothing left in a write-ahead file. It has the
//! seals of all rows, so that what is brought back is checked like any other log.

use std::fs::{self, File};
use std::path::Path;

use rusqlite::backup::{Backup, StepResult};
use rusqlite::{Connection, OpenFlags};

use super::files::{self, CommitMarkerFile, Site, create_whole};
use super::history::HistoryReader;
use super::kind::Kind;
use super::scene::Log;
use super::{LogError, Seq};

/// Pages that are copied between two questions whether to go on: a megabyte.
const PAGES_AT_ONCE: i32 = 256;

impl<K: Kind> HistoryReader<K> {
    /// Copies the log as of its newest seq, which it answers, into an empty file, on a connection of its own; changes go on meanwhile.
    /// `goes_on` is asked now and then.
    /// # Errors
    /// The disk's; [`LogError::Failed`] when the log was closed meanwhile, or when `goes_on` says no.
    pub fn copy_into(&self, file: &Path, goes_on: &dyn Fn() -> bool) -> Result<Seq, LogError> {
        let copied = Site::new_file(file);
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE
            | OpenFlags::SQLITE_OPEN_CREATE
            | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let opened = Connection::open_with_flags(file, flags);
        let mut to = opened.map_err(copied.sqlite(Seq(0)))?;
        let reader = self.another()?;
        let from = reader.connection()?;
        // What is read is of this moment, whatever is written.
        let (moment, superblock) = reader.moment(&from)?;
        let sqlite = |error| copied.sqlite(superblock.seq)(error);
        // What breaks off is thrown away, so it need not be durable before it is whole.
        to.pragma_update(None, "synchronous", false)
            .map_err(sqlite)?;
        {
            let backup = Backup::new(&moment, &mut to).map_err(sqlite)?;
            loop {
                if reader.is_closing() || !goes_on() {
                    return Err(copied.failed("the copy was broken off"));
                }
                match backup.step(PAGES_AT_ONCE).map_err(sqlite)? {
                    StepResult::Done => break,
                    StepResult::More => {}
                    _ => return Err(copied.failed("SQLite's file is in use by others")),
                }
            }
        }
        to.close().map_err(|(_, error)| sqlite(error))?;
        let synced = File::open(file).and_then(|file| file.sync_all());
        synced.map_err(|error| copied.io(&error))?;
        Ok(superblock.seq)
    }
}

/// Makes the directory of a scene from a copy of its log. `check` gets the directory before it has its name: what it refuses never
/// appears. The copy stays as it is.
/// # Errors
/// [`LogError::Failed`] when the directory is there already; those of `check`, and the disk's.
pub fn restore(
    file: &Path,
    directory: &Path,
    check: impl FnOnce(&Path) -> Result<(), LogError>,
) -> Result<(), LogError> {
    create_whole(directory, |temporary| {
        let site = Site::new(temporary);
        let io = |error: std::io::Error| site.io(&error);
        fs::copy(file, &site.database).map_err(|error| Site::new_file(file).io(&error))?;
        File::open(&site.database)
            .and_then(|file| file.sync_all())
            .map_err(io)?;
        check(temporary)?;
        files::sync_all(temporary).map_err(io)
    })
}

impl<K: Kind> Log<K> {
    /// Makes a log that was brought back from a copy, and found right, one that the scene goes on from.
    /// # Errors
    /// The disk's.
    pub fn adopt(mut self) -> Result<(), LogError> {
        self.database.settle()?;
        let site = &self.database.site;
        CommitMarkerFile::open(site)
            .and_then(|marker| marker.sync())
            .map_err(|error| site.io(&error))
    }
}
