//! One SQLite connection, and the transactions of the writer.
//!
//! Knows how SQLite must be set up so that a commit is durable, and that every transaction moves the superblock. Never knows
//! what a row means.
//!
//! Bytes pass through two places before they are where they stay, and each has its sync:
//!
//! ```text
//!   commit ──> write-ahead file ──sync──> answer ──checkpoint──> database file ──sync──> the write-ahead file is begun anew
//! ```
//! A sync that fails is not made good by another one: the kernel then holds bytes for written that can be read and are not on the disk.
//! So closing after an error moves nothing into the database, and closes all connections. Whoever opens it next takes nothing for
//! durable that was only read: [`Database::settle`] writes the whole write-ahead file again and syncs it, and only then lets SQLite move
//! it, from its first page on. (A transaction that failed lies behind what is durable, and the next one is written over it.)

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use parking_lot::{MappedMutexGuard, Mutex, MutexGuard};
use rusqlite::config::DbConfig;
use rusqlite::{Connection, OpenFlags, Transaction, TransactionBehavior};

use super::bytes::count;
use super::files::{APPLICATION_ID, CommitMarker, CommitMarkerFile, Site};
use super::kind::Kind;
use super::tables::{Definitions, Meta, Seal, Superblock, tables};
use super::wal;
use super::{LogError, Seq};

/// SQLite cuts its write-ahead file down to this when it begins it anew.
const JOURNAL_SIZE_LIMIT: i64 = 64 << 20;
/// `synchronous=FULL`: in WAL mode the write-ahead file is synced by every commit.
const SYNCHRONOUS_FULL: i64 = 2;

/// The writer's connection, and the superblock as of its last commit.
pub(super) struct Database {
    pub(super) site: Site,
    pub(super) connection: Connection,
    pub(super) seal: Seal,
    pub(super) superblock: Superblock,
    commit_marker: CommitMarkerFile,
    page_size: usize,
    /// Whether all that was found at opening is durable.
    settled: bool,
    /// Pages of the write-ahead file that are not in the database yet, as of the last commit; 0 from a checkpoint to the next commit.
    unmoved_pages: u64,
    /// How long SQLite took for the last commit: it writes the pages to the write-ahead file, and syncs it.
    commit_time: Duration,
    readers: Arc<Readers>,
}

/// The connections of a database that only read.
#[derive(Default)]
struct Readers {
    /// Whether the writer's connection goes, and waits for them.
    closing: AtomicBool,
    open: Mutex<Vec<Weak<Mutex<Option<Connection>>>>>,
}

/// A connection that only reads. It is closed with the writer's: as long as one is open SQLite goes by what it noted of the
/// write-ahead file before an error, instead of looking at the file anew.
pub(super) struct Reader {
    connection: Arc<Mutex<Option<Connection>>>,
    /// It and its like.
    all: Arc<Readers>,
}

impl Database {
    /// Fills an empty directory with the database of a scene without changes, and closes it.
    pub(super) fn create<K: Kind>(
        site: &Site,
        meta: &Meta<K>,
        definitions: &[Box<[u8]>],
    ) -> Result<(), LogError> {
        site.create_database().map_err(|error| site.io(&error))?;
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(&site.database, flags);
        let connection = connection.map_err(site.sqlite(Seq(0)))?;
        let superblock = Superblock {
            definitions: K::DEFINES.then_some(count(definitions.len())),
            ..Superblock::NEW
        };
        let build = || {
            // Both can only be chosen for an empty file; incremental so that `trim` can give pages back.
            connection.pragma_update(None, "auto_vacuum", "INCREMENTAL")?;
            connection.pragma_update(None, "application_id", APPLICATION_ID)?;
            connection.pragma_update(
                None,
                "user_version",
                K::format(meta.header.stock.as_ref()),
            )?;
            configure_writer(&connection)?;
            let transaction = connection.unchecked_transaction()?;
            for (_, table) in tables(K::DEFINES) {
                transaction.execute(table, [])?;
            }
            meta.insert(&transaction)?;
            for (number, definition) in (0..).zip(definitions) {
                Definitions::insert(&transaction, meta.seal(), number, definition)?;
            }
            superblock.write(&transaction, meta.seal())?;
            transaction.commit()
        };
        build().map_err(site.sqlite(Seq(0)))?;
        check_settings(site, &connection, Seq(0))?;
        // Closing moves everything into the database file and syncs it; where that fails, it is durable in the write-ahead file.
        connection
            .close()
            .map_err(|(_, error)| site.sqlite(Seq(0))(error))?;
        let mut commit_marker = CommitMarkerFile::open(site).map_err(|error| site.io(&error))?;
        commit_marker
            .write(marker(&superblock))
            .and_then(|()| commit_marker.sync())
            .map_err(|error| site.io(&error))
    }

    /// Opens the database of a scene and checks everything but its rows.
    pub(super) fn open<K: Kind>(site: Site, page_size: usize) -> Result<(Self, Meta<K>), LogError> {
        let seq = site.marked_seq();
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(&site.database, flags);
        let connection = connection.map_err(site.sqlite(seq))?;
        // Until replay has found everything in order, closing must not touch the files.
        connection
            .set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)
            .and_then(|_| configure_writer(&connection))
            .map_err(site.sqlite(seq))?;
        check_settings(&site, &connection, seq)?;
        check_schema::<K>(&site, &connection, seq)?;
        let meta = Meta::<K>::read(&connection)
            .map_err(site.sqlite(seq))?
            .map_err(|error| site.damaged(seq, format_args!("its settings: {error}")))?;
        let seal = meta.seal();
        let superblock = read_superblock(&site, &connection, seal, seq)?;
        // SQLite has made its write-ahead file by now, and does not mind when the file's name cannot be synced. A scene whose
        // removal failed has its own name back, and nobody has synced that.
        site.sync_names().map_err(|error| site.io(&error))?;
        let commit_marker = CommitMarkerFile::open(&site).map_err(|error| site.io(&error))?;
        let database = Self {
            site,
            connection,
            seal,
            superblock,
            commit_marker,
            page_size,
            settled: false,
            unmoved_pages: 0,
            commit_time: Duration::ZERO,
            readers: Arc::default(),
        };
        Ok((database, meta))
    }

    /// Runs `work` in a transaction that also moves the superblock to what `work` made of it. Durable when it returns `Ok`; nothing
    /// has happened when it does not.
    pub(super) fn transact(
        &mut self,
        work: impl FnOnce(&Connection, Seal, &mut Superblock) -> rusqlite::Result<()>,
    ) -> Result<(), LogError> {
        assert!(
            self.settled,
            "nothing is written on what may not be durable"
        );
        let mut superblock = self.superblock;
        superblock.generation += 1;
        let commit = || {
            // Rolls back when it is dropped, also after a commit that failed.
            let transaction =
                Transaction::new_unchecked(&self.connection, TransactionBehavior::Immediate)?;
            work(&transaction, self.seal, &mut superblock)?;
            superblock.write(&transaction, self.seal)?;
            let begun = Instant::now();
            transaction.commit()?;
            Ok(begun.elapsed())
        };
        let committed = commit();
        self.commit_time = self.outcome(committed)?;
        self.superblock = superblock;
        self.mark();
        // When SQLite does not say, the next commit asks again.
        if let Ok((pages, moved)) = self.pages() {
            self.unmoved_pages = pages - moved;
        }
        Ok(())
    }

    /// Notes outside the database how far it has come.
    fn mark(&mut self) {
        // A marker that stays behind only says less; the change itself is on stable storage.
        drop(self.commit_marker.write(marker(&self.superblock)));
    }

    /// Makes all that can be read durable, and known to be, once its rows are known to be right. Before it that need not be so, and what is
    /// appended behind bytes that are not on the disk would be lost with them; so it comes before the first transaction.
    pub(super) fn settle(&mut self) -> Result<(), LogError> {
        if self.settled {
            return Ok(());
        }
        let site = self.site.clone();
        let sqlite = site.sqlite(self.superblock.seq);
        let io = |error: io::Error| site.io(&error);
        let still_read = || site.failed("SQLite's write-ahead file is still being read");
        // Before SQLite moves any of it: a page that reached the database would be newer than a write-ahead file with a hole.
        let rewritten = wal::rewrite(&site.write_ahead(), self.page_size).map_err(io)?;
        if self.pages().map_err(&sqlite)? != (rewritten, 0) {
            // SQLite goes by what it noted before, on behalf of a connection that is still open.
            return Err(still_read());
        }
        let is_busy = self
            .connection
            .query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |row| row.get(0));
        if is_busy.map_err(&sqlite)? {
            return Err(still_read());
        }
        // SQLite does not sync that it has emptied the file, and what was in it must not come back.
        site.sync_write_ahead().map_err(io)?;
        self.connection
            .set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, false)
            .map_err(&sqlite)?;
        self.settled = true;
        self.mark();
        self.site.note_identity();
        Ok(())
    }

    /// Moves pages from the write-ahead file into the database, as far as nobody reads them there: when that is all of them, the next
    /// transaction begins the file anew. SQLite does so by itself, too, unless told otherwise, and does not say when it fails.
    /// Answers how many pages were left.
    pub(super) fn checkpoint(&mut self) -> Result<u64, LogError> {
        let moved = self
            .connection
            .query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |row| {
                // Minus one when SQLite does not know.
                let pages = [row.get::<_, i64>(1)?, row.get(2)?];
                Ok(u64::try_from(pages[0] - pages[1]).unwrap_or(0))
            });
        let left = self.outcome(moved).map_err(|error| match error {
            LogError::Failed { path, cause } => LogError::Failed {
                path,
                cause: format!("SQLite's write-ahead file cannot be moved into it: {cause}"),
            },
            error => error,
        })?;
        self.unmoved_pages = 0;
        Ok(left)
    }

    /// How long SQLite took for the last commit, its sync included.
    pub(super) fn commit_time(&self) -> Duration {
        self.commit_time
    }

    /// Pages of the write-ahead file that were not in the database at the last commit; 0 since the last checkpoint.
    pub(super) fn unmoved_pages(&self) -> u64 {
        self.unmoved_pages
    }

    /// Pages of whole transactions that the write-ahead file holds, and how many of them are in the database as well.
    fn pages(&self) -> rusqlite::Result<(u64, u64)> {
        self.connection
            .prepare_cached("PRAGMA wal_checkpoint(NOOP)")?
            .query_row([], |row| {
                let pages = [row.get::<_, u32>(1)?, row.get(2)?];
                Ok((pages[0].into(), pages[1].into()))
            })
    }

    /// What a write has come to. After an error closing must not touch the files.
    fn outcome<T>(&self, outcome: rusqlite::Result<T>) -> Result<T, LogError> {
        outcome.map_err(|error| {
            self.connection
                .set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)
                .expect("a switch in memory");
            self.site.sqlite(self.superblock.seq)(error)
        })
    }

    /// A connection that only reads, until this one is dropped.
    pub(super) fn reader(&self) -> Result<Reader, LogError> {
        let reader = Readers::open(&self.readers, &self.site)?;
        Ok(reader.expect("this one is there"))
    }
}

impl Drop for Database {
    fn drop(&mut self) {
        // Waits for those who are reading. The writer's own connection comes last: only the last one moves the write-ahead file.
        let mut open = self.readers.open.lock();
        self.readers.closing.store(true, Ordering::Relaxed);
        for reader in open.drain(..).filter_map(|reader| reader.upgrade()) {
            reader.lock().take();
        }
    }
}

impl Readers {
    /// Opens one more; none when the writer's connection is gone.
    fn open(all: &Arc<Self>, site: &Site) -> Result<Option<Reader>, LogError> {
        let mut open = all.open.lock();
        if all.closing.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let connect = || {
            let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
            let connection = Connection::open_with_flags(&site.database, flags)?;
            configure(&connection)?;
            Ok(connection)
        };
        let connection = connect().map_err(site.sqlite(Seq(0)))?;
        let connection = Arc::new(Mutex::new(Some(connection)));
        open.retain(|reader| reader.strong_count() > 0);
        open.push(Arc::downgrade(&connection));
        Ok(Some(Reader {
            connection,
            all: all.clone(),
        }))
    }
}

impl Reader {
    /// The connection, for one at a time; none once it is closed.
    pub(super) fn connection(&self) -> Option<MappedMutexGuard<'_, Connection>> {
        MutexGuard::try_map(self.connection.lock(), Option::as_mut).ok()
    }

    /// Another one of the same database; none when the writer's connection is gone.
    pub(super) fn another(&self, site: &Site) -> Result<Option<Self>, LogError> {
        Readers::open(&self.all, site)
    }

    /// Whether the writer's connection goes, and waits for this one.
    pub(super) fn is_closing(&self) -> bool {
        self.all.closing.load(Ordering::Relaxed)
    }
}

fn marker(superblock: &Superblock) -> CommitMarker {
    CommitMarker {
        generation: superblock.generation,
        seq: superblock.seq,
    }
}

pub(super) fn read_superblock(
    site: &Site,
    connection: &Connection,
    seal: Seal,
    seq: Seq,
) -> Result<Superblock, LogError> {
    Superblock::read(connection, seal)
        .map_err(site.sqlite(seq))?
        .map_err(|error| site.damaged(seq, format_args!("its superblock: {error}")))
}

fn configure(connection: &Connection) -> rusqlite::Result<()> {
    connection.set_prepared_statement_cache_capacity(32);
    connection.pragma_update(None, "trusted_schema", false)?;
    connection.pragma_update(None, "cell_size_check", true)?;
    connection.pragma_update(None, "temp_store", "MEMORY")?;
    connection.pragma_update(None, "mmap_size", 0)
}

fn configure_writer(connection: &Connection) -> rusqlite::Result<()> {
    configure(connection)?;
    connection.pragma_update(None, "synchronous", SYNCHRONOUS_FULL)?;
    // Where a sync alone does not reach the platters (macOS).
    connection.pragma_update(None, "fullfsync", true)?;
    connection.pragma_update(None, "checkpoint_fullfsync", true)?;
    connection.pragma_update(None, "journal_mode", "WAL")?;
    // SQLite would drop the error of a checkpoint of its own.
    connection.pragma_update(None, "wal_autocheckpoint", 0)?;
    connection.pragma_update(None, "journal_size_limit", JOURNAL_SIZE_LIMIT)
}

/// A setting that did not take is not reported by SQLite.
fn check_settings(site: &Site, connection: &Connection, seq: Seq) -> Result<(), LogError> {
    let read = || {
        let mode: String = connection.pragma_query_value(None, "journal_mode", |row| row.get(0))?;
        let synchronous: i64 =
            connection.pragma_query_value(None, "synchronous", |row| row.get(0))?;
        Ok((mode, synchronous))
    };
    let (mode, synchronous) = read().map_err(site.sqlite(seq))?;
    if mode != "wal" {
        return Err(site.failed(format_args!(
            "SQLite's journal mode is {mode} instead of wal; does the file system have shared memory?"
        )));
    }
    if synchronous != SYNCHRONOUS_FULL {
        return Err(site.failed("SQLite does not sync fully"));
    }
    Ok(())
}

/// Compares the schema word for word: a table that reads differently could still answer, and wrongly.
fn check_schema<K: Kind>(site: &Site, connection: &Connection, seq: Seq) -> Result<(), LogError> {
    let read = || {
        connection
            .prepare("SELECT name, sql FROM sqlite_schema ORDER BY rowid")?
            .query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?
            .collect::<rusqlite::Result<Vec<(String, String)>>>()
    };
    let found = read().map_err(site.sqlite(seq))?;
    let expected = tables(K::DEFINES).map(|(name, sql)| (name.to_owned(), sql.to_owned()));
    if found.into_iter().eq(expected) {
        Ok(())
    } else {
        Err(site.damaged(seq, "its schema"))
    }
}

/// The generation that the database file alone has come to, without its write-ahead file; none when it cannot be told, which
/// is no fault: after a crash the file alone need not make sense.
pub(super) fn generation_without_write_ahead(site: &Site, seal: Seal) -> Option<u64> {
    let path = std::path::absolute(&site.database).ok()?;
    let escaped = path
        .to_str()?
        .replace('%', "%25")
        .replace('?', "%3f")
        .replace('#', "%23");
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
        | OpenFlags::SQLITE_OPEN_URI
        | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let uri = format!("file:{escaped}?immutable=1");
    let connection = Connection::open_with_flags(uri, flags).ok()?;
    let superblock = Superblock::read(&connection, seal).ok()?.ok()?;
    Some(superblock.generation)
}
