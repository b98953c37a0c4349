//! One SQLite connection, and the transactions of the writer.
//!
//! Knows how SQLite must be set up so that a commit is durable, and that every transaction moves the superblock. Never knows
//! what a row means.

use rusqlite::config::DbConfig;
use rusqlite::{Connection, OpenFlags, Transaction, TransactionBehavior};

use super::bytes::count;
use super::files::{APPLICATION_ID, CommitMarker, CommitMarkerFile, Site};
use super::kind::Kind;
use super::tables::{Definitions, Meta, Seal, Superblock, tables};
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
}

impl Database {
    /// Fills an empty directory with the database of a scene without changes, and closes it.
    pub(super) fn create<K: Kind>(
        site: &Site,
        meta: &Meta<K>,
        definitions: &[Box<[u8]>],
    ) -> Result<(), LogError> {
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE
            | OpenFlags::SQLITE_OPEN_CREATE
            | OpenFlags::SQLITE_OPEN_NO_MUTEX;
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
        // Closing moves everything into the database file and syncs it.
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
    pub(super) fn open<K: Kind>(site: Site) -> Result<(Self, Meta<K>), LogError> {
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
        // SQLite has made its write-ahead file by now, and does not mind when the file's name cannot be synced.
        site.sync_names().map_err(|error| site.io(&error))?;
        let commit_marker = CommitMarkerFile::open(&site).map_err(|error| site.io(&error))?;
        let database = Self {
            site,
            connection,
            seal,
            superblock,
            commit_marker,
        };
        Ok((database, meta))
    }

    /// Runs `work` in a transaction that also moves the superblock to what `work` made of it. Durable when it returns `Ok`; nothing
    /// has happened when it does not.
    pub(super) fn transact(
        &mut self,
        work: impl FnOnce(&Connection, Seal, &mut Superblock) -> rusqlite::Result<()>,
    ) -> Result<(), LogError> {
        let mut superblock = self.superblock;
        superblock.generation += 1;
        let commit = || {
            // Rolls back when it is dropped, also after a commit that failed.
            let transaction =
                Transaction::new_unchecked(&self.connection, TransactionBehavior::Immediate)?;
            work(&transaction, self.seal, &mut superblock)?;
            superblock.write(&transaction, self.seal)?;
            transaction.commit()
        };
        commit().map_err(self.site.sqlite(self.superblock.seq))?;
        self.superblock = superblock;
        self.mark();
        Ok(())
    }

    /// Notes outside the database how far it has come.
    pub(super) fn mark(&mut self) {
        // A marker that stays behind only says less; the change itself is on stable storage.
        drop(self.commit_marker.write(marker(&self.superblock)));
    }

    /// Moves the write-ahead file into the database, once its rows are known to be right, and from now on whenever the log is closed.
    ///
    /// After it all that the log stands on is durable, and known to be. Before it that need not be so: a sync that failed may have left
    /// frames in memory that can be read and are not on the disk, and no later sync of that file writes them. What is appended
    /// behind such a hole would be lost with it.
    pub(super) fn checkpoint(&mut self) -> Result<(), LogError> {
        let checkpoint = || {
            self.connection
                .set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, false)?;
            self.connection
                .query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |row| {
                    row.get::<_, bool>(0)
                })
        };
        let busy = checkpoint().map_err(self.site.sqlite(self.superblock.seq))?;
        if busy {
            return Err(self
                .site
                .failed("SQLite's write-ahead file is still being read"));
        }
        self.mark();
        Ok(())
    }

    /// A connection that only reads.
    pub(super) fn reader(&self) -> Result<Connection, LogError> {
        let open = || {
            let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
            let connection = Connection::open_with_flags(&self.site.database, flags)?;
            configure(&connection)?;
            Ok(connection)
        };
        open().map_err(self.site.sqlite(self.superblock.seq))
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
