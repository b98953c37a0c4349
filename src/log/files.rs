//! The files of a scene's directory, as far as SQLite does not look after them.
//!
//! Knows names, directories, the first bytes of a database file and the one file of our own. Never knows a record.
//!
//! ```text
//! DIRECTORY/scene.sqlite        everything
//!           scene.sqlite-wal    SQLite's write-ahead file: newest changes, until they are moved into the database
//!           scene.sqlite-shm    SQLite's index of that; rebuilt whenever it opens
//!           acknowledged        the newest generation that was answered for
//!           identity            which file the database is, by its inode: a copy is another
//! ```
//! A directory is built under a name that starts with [`TEMPORARY_PREFIX`] and renamed, and removed the other way round, so a crash leaves a
//! whole scene, or none and some rubbish that [`remove_leftovers`] knows by its name.

use std::fs::{self, DirBuilder, File, OpenOptions, Permissions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use super::kind::Kind;
use super::{LogError, Seq};

/// Names of directories that are being made or removed start with this; no scene's name does.
pub const TEMPORARY_PREFIX: &str = ".union3d-temporary-";

/// Written into the header of every database file: "un3d".
pub(super) const APPLICATION_ID: i32 = 0x756e_3364;

/// What nobody but the owner may do is taken from all others: what is in a scene is its owner's.
const OTHERS: u32 = 0o077;
const DIRECTORY_MODE: u32 = 0o700;

/// The mode of new files. SQLite gives its write-ahead file and the index of that the mode of the database file.
pub const FILE_MODE: u32 = 0o600;

/// Bytes that show whether there is room at all.
const TRIAL_BYTES_MIN: u64 = 1 << 16;

const MAGIC: &[u8; 16] = b"SQLite format 3\0";
const HEADER_SIZE: usize = 100;

/// What every refusal of a damaged scene ends with.
const ADVICE: &str =
    "restore the scene's directory from a backup, or delete the scene; nothing was guessed";

/// The same of one whose files are a copy.
const COPIED: &str = "the files are a copy, and files that a server writes to cannot be copied one by one: take a copy with union3d backup, or while no \
                      server runs; nothing was guessed";

/// Where a scene's files are, to find them and to name them in errors.
#[derive(Clone, Debug)]
pub(super) struct Site {
    directory: PathBuf,
    pub(super) database: PathBuf,
}

impl Site {
    pub(super) fn new(directory: &Path) -> Self {
        Self {
            directory: directory.to_owned(),
            database: directory.join("scene.sqlite"),
        }
    }

    /// A database file by itself, to name it in errors.
    pub(super) fn new_file(file: &Path) -> Self {
        Self {
            directory: parent(file).to_owned(),
            database: file.to_owned(),
        }
    }

    pub(super) fn write_ahead(&self) -> PathBuf {
        self.directory.join("scene.sqlite-wal")
    }

    fn acknowledged(&self) -> PathBuf {
        self.directory.join("acknowledged")
    }

    /// Which file the database was when it was last found right.
    fn identity(&self) -> PathBuf {
        self.directory.join("identity")
    }

    /// Notes which file the database is, to tell a copy later. Of no use for anything else, so nothing is said when it fails.
    pub(super) fn note_identity(&self) {
        let Ok(metadata) = fs::metadata(&self.database) else {
            return;
        };
        let inode = metadata.ino().to_string();
        let noted = fs::read_to_string(self.identity());
        if noted.ok().as_deref() != Some(&*inode) {
            let file = OpenOptions::new()
                .write(true)
                .create(true)
                .truncate(true)
                .mode(FILE_MODE)
                .open(self.identity());
            drop(file.and_then(|mut file| file.write_all(inode.as_bytes())));
        }
    }

    /// Whether the files are a copy of what was written, as far as it is known.
    fn is_copied(&self) -> bool {
        let noted = fs::read_to_string(self.identity());
        let inode = fs::metadata(&self.database).map(|metadata| metadata.ino().to_string());
        matches!((noted, inode), (Ok(noted), Ok(inode)) if noted != inode)
    }

    /// Makes the names of the files durable, and that of their directory.
    pub(super) fn sync_names(&self) -> io::Result<()> {
        sync_directory(&self.directory)?;
        sync_directory(parent(&self.directory))
    }

    /// Makes the write-ahead file durable as it is, its length with it.
    pub(super) fn sync_write_ahead(&self) -> io::Result<()> {
        OpenOptions::new()
            .write(true)
            .open(self.write_ahead())?
            .sync_all()
    }

    /// Makes the database file, empty. SQLite would let others read it.
    pub(super) fn create_database(&self) -> io::Result<()> {
        let mut options = OpenOptions::new();
        options.write(true).create_new(true).mode(FILE_MODE);
        options.open(&self.database).map(drop)
    }

    /// Bytes of all files.
    pub(super) fn size_bytes(&self) -> u64 {
        let Ok(files) = fs::read_dir(&self.directory) else {
            return 0;
        };
        files
            .filter_map(|file| file.ok()?.metadata().ok())
            .map(|metadata| metadata.len())
            .sum()
    }

    pub(super) fn damaged(&self, seq: Seq, what: impl std::fmt::Display) -> LogError {
        let advice = if self.is_copied() { COPIED } else { ADVICE };
        LogError::Damaged {
            path: self.database.clone(),
            seq,
            detail: format!("{what}; {advice}"),
        }
    }

    pub(super) fn foreign(&self, detail: String) -> LogError {
        LogError::Foreign {
            path: self.database.clone(),
            detail,
        }
    }

    pub(super) fn failed(&self, cause: impl std::fmt::Display) -> LogError {
        LogError::Failed {
            path: self.database.clone(),
            cause: cause.to_string(),
        }
    }

    /// What an error of SQLite means. `seq` is the best known, for damage.
    pub(super) fn sqlite(&self, seq: Seq) -> impl Fn(rusqlite::Error) -> LogError {
        use rusqlite::{Error, ErrorCode};
        move |error| match error.sqlite_error_code() {
            Some(ErrorCode::DiskFull) => self.full(),
            // The file ends before what must be in it.
            Some(ErrorCode::SystemIoFailure) if is_short_read(&error) => self.damaged(seq, &error),
            // A full disk shows in other ways too: no room for the shared index, a quota, a sync that allocates late.
            Some(ErrorCode::SystemIoFailure | ErrorCode::CannotOpen) if self.is_full() => {
                self.full()
            }
            // Not a type we wrote, a number out of range, text that is not UTF-8.
            None if !matches!(error, Error::InvalidPath(_)) => self.damaged(seq, &error),
            // Statements are fixed and the schema was compared, so an SQL error is the database's, as is a row in the way.
            Some(
                ErrorCode::DatabaseCorrupt
                | ErrorCode::NotADatabase
                | ErrorCode::SchemaChanged
                | ErrorCode::TooBig
                | ErrorCode::ConstraintViolation
                | ErrorCode::TypeMismatch
                | ErrorCode::Unknown,
            ) => self.damaged(seq, &error),
            _ => self.failed(&error),
        }
    }

    pub(super) fn io(&self, error: &io::Error) -> LogError {
        match error.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => self.full(),
            _ => self.failed(error),
        }
    }

    fn full(&self) -> LogError {
        LogError::Full {
            path: self.database.clone(),
        }
    }

    /// Whether a new file finds no room: SQLite does not say what its I/O errors were.
    fn is_full(&self) -> bool {
        let tried = self.try_to_write(TRIAL_BYTES_MIN);
        tried.is_err_and(|error| matches!(self.io(&error), LogError::Full { .. }))
    }

    /// Writes as many bytes beside the database as moving the write-ahead file into it may take, and syncs them.
    pub(super) fn probe(&self) -> io::Result<()> {
        let unmoved = match fs::metadata(self.write_ahead()) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => 0,
            metadata => metadata?.len(),
        };
        self.try_to_write(unmoved.max(TRIAL_BYTES_MIN))
    }

    /// Writes and syncs a nameless file beside the database.
    fn try_to_write(&self, size: u64) -> io::Result<()> {
        let mut file = tempfile::tempfile_in(&self.directory)?;
        io::copy(&mut io::repeat(1).take(size), &mut file)?;
        file.sync_all()
    }

    /// Checks the start of the database file before SQLite sees it: SQLite would take an empty file for a new database and
    /// delete its write-ahead file. Answers the size of a page.
    pub(super) fn check_database_header<K: Kind>(&self) -> Result<usize, LogError> {
        let mut bytes = Vec::new();
        File::open(&self.database)
            .and_then(|file| {
                file.take(u64::try_from(HEADER_SIZE).expect("a hundred fits"))
                    .read_to_end(&mut bytes)
            })
            .map_err(|error| match error.kind() {
                io::ErrorKind::NotFound => self.damaged(self.marked_seq(), "the file is missing"),
                _ => self.io(&error),
            })?;
        let Some(header) = bytes.first_chunk::<HEADER_SIZE>() else {
            return Err(self.damaged(self.marked_seq(), "its header is cut off"));
        };
        let number = |at: usize| {
            i32::from_be_bytes(
                *header[at..]
                    .first_chunk()
                    .expect("the header is longer than its last number"),
            )
        };
        if !header.starts_with(MAGIC) || number(68) != APPLICATION_ID {
            return Err(self.foreign(
                "not the log of a union3d scene, or damaged in its first bytes".to_owned(),
            ));
        }
        if number(60) > *K::FORMATS.end() {
            return Err(LogError::Newer {
                path: self.database.clone(),
                format: number(60),
                known: *K::FORMATS.end(),
            });
        }
        if !K::FORMATS.contains(&number(60)) {
            let known: Vec<String> = K::FORMATS.map(|format| format.to_string()).collect();
            return Err(self.foreign(format!(
                "the log is of format {}, this program knows {}",
                number(60),
                known.join(" and ")
            )));
        }
        // 2 and 2: read and written with a write-ahead file.
        if header[18..20] != [2, 2] {
            return Err(self.damaged(self.marked_seq(), "its header is damaged"));
        }
        match u16::from_be_bytes([header[16], header[17]]) {
            1 => Ok(1 << 16),
            size if size >= 512 && size.is_power_of_two() => Ok(usize::from(size)),
            _ => Err(self.damaged(self.marked_seq(), "its page size is damaged")),
        }
    }

    /// What is known to have been answered for, if it can be read.
    pub(super) fn commit_marker(&self) -> Option<CommitMarker> {
        let mut bytes = Vec::new();
        let mut file = File::open(self.acknowledged()).ok()?;
        file.read_to_end(&mut bytes).ok()?;
        CommitMarkerFile::parse(&bytes)
    }

    /// The same, to name a seq where the database cannot be asked.
    pub(super) fn marked_seq(&self) -> Seq {
        self.commit_marker().unwrap_or_default().seq
    }
}

/// Whether the log in a directory is of a scene of this kind, by its format. False when its file is missing or cut off.
/// # Errors
/// Its file cannot be read.
pub fn is_of<K: Kind>(directory: &Path) -> Result<bool, LogError> {
    let site = Site::new(directory);
    let mut header = [0; HEADER_SIZE];
    let read = File::open(&site.database).and_then(|mut file| file.read_exact(&mut header));
    match read {
        Ok(()) => {
            let format = header[60..].first_chunk().copied().map(i32::from_be_bytes);
            Ok(format.is_some_and(|format| K::FORMATS.contains(&format)))
        }
        Err(error) => match error.kind() {
            io::ErrorKind::NotFound | io::ErrorKind::UnexpectedEof => Ok(false),
            _ => Err(site.io(&error)),
        },
    }
}

/// Bytes of SQLite's write-ahead file in the directory of a scene; 0 when there is none, or it cannot be looked at.
pub fn write_ahead_bytes(directory: &Path) -> u64 {
    fs::metadata(Site::new(directory).write_ahead()).map_or(0, |file| file.len())
}

/// How far the log had come when something was last answered for.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) struct CommitMarker {
    /// Transactions since the scene was created.
    pub(super) generation: u64,
    /// Newest change.
    pub(super) seq: Seq,
}

/// The file of the commit marker, outside the database: a write-ahead file that is cut off between two changes looks like one
/// that never had more.
///
/// The marker is written after each commit and never synced, which costs a microsecond. So it may lag behind after a power
/// failure, but it is never ahead of what was on stable storage; after the death of the process alone it is exact.
#[derive(Debug)]
pub(super) struct CommitMarkerFile(File);

impl CommitMarkerFile {
    const SIZE: usize = 20;

    pub(super) fn open(site: &Site) -> io::Result<Self> {
        OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .mode(FILE_MODE)
            .open(site.acknowledged())
            .map(Self)
    }

    fn parse(bytes: &[u8]) -> Option<CommitMarker> {
        let bytes: &[u8; Self::SIZE] = bytes.try_into().ok()?;
        let (body, crc) = bytes.split_last_chunk::<4>()?;
        let (generation, seq) = body.split_first_chunk::<8>()?;
        (crc32fast::hash(body) == u32::from_le_bytes(*crc)).then_some(CommitMarker {
            generation: u64::from_le_bytes(*generation),
            seq: Seq(u64::from_le_bytes(*seq.first_chunk()?)),
        })
    }

    pub(super) fn write(&mut self, marker: CommitMarker) -> io::Result<()> {
        let mut bytes = [0; Self::SIZE];
        bytes[..8].copy_from_slice(&marker.generation.to_le_bytes());
        bytes[8..16].copy_from_slice(&marker.seq.0.to_le_bytes());
        let crc = crc32fast::hash(&bytes[..16]);
        bytes[16..].copy_from_slice(&crc.to_le_bytes());
        self.0.seek(SeekFrom::Start(0))?;
        self.0.write_all(&bytes)
    }

    pub(super) fn sync(&self) -> io::Result<()> {
        self.0.sync_all()
    }
}

/// Makes `directory` appear whole: `build` fills a directory of another name beside it.
/// Nobody else creates the same one at the same time.
pub(super) fn create_whole(
    directory: &Path,
    build: impl FnOnce(&Path) -> Result<(), LogError>,
) -> Result<(), LogError> {
    let site = Site::new(directory);
    let io = |error: io::Error| site.io(&error);
    if directory.exists() {
        return Err(site.failed("the directory is there already"));
    }
    let temporary = temporary_sibling(directory, "create").map_err(io)?;
    let created = DirBuilder::new().mode(DIRECTORY_MODE).create(&temporary);
    created.map_err(io)?;
    let outcome = build(&temporary)
        .and_then(|()| sync_directory(&temporary).map_err(io))
        .and_then(|()| fs::rename(&temporary, directory).map_err(io))
        .and_then(|()| sync_directory(parent(directory)).map_err(io));
    if outcome.is_err() {
        // What cannot be removed now has a name by which it is removed later.
        drop(fs::remove_dir_all(&temporary));
    }
    outcome
}

/// Removes the directory of a scene, so that a crash leaves it whole or gone. Answers what kept its space from being given
/// back, if anything did: [`remove_leftovers`] does that later.
/// # Errors
/// The file system's; the scene is then still there, and durably so once its log has been opened again.
pub fn remove_scene(directory: &Path) -> io::Result<Option<io::Error>> {
    let temporary = temporary_sibling(directory, "remove")?;
    match fs::rename(directory, &temporary) {
        // An earlier removal failed in the middle, and could not be taken back.
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return sync_directory(parent(directory)).map(|()| None);
        }
        renamed => renamed?,
    }
    if let Err(error) = sync_directory(parent(directory)) {
        // After a power failure the scene would be back, so it is not gone now either.
        fs::rename(&temporary, directory)?;
        return Err(error);
    }
    Ok(fs::remove_dir_all(&temporary).err())
}

/// A free name beside `directory`.
fn temporary_sibling(directory: &Path, purpose: &str) -> io::Result<PathBuf> {
    let mut name = std::ffi::OsString::from(format!("{TEMPORARY_PREFIX}{purpose}-"));
    name.push(directory.file_name().unwrap_or_default());
    let temporary = parent(directory).join(name);
    match fs::remove_dir_all(&temporary) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(temporary),
    }
}

/// Removes what a crash left of scenes being created or removed under `data`. Only for the one who has locked it.
/// # Errors
/// The file system's.
pub fn remove_leftovers(data: &Path) -> io::Result<()> {
    for entry in fs::read_dir(data)? {
        let name = entry?.file_name();
        if name
            .as_encoded_bytes()
            .starts_with(TEMPORARY_PREFIX.as_bytes())
        {
            fs::remove_dir_all(data.join(&name))?;
        }
    }
    Ok(())
}

/// Creates a directory and those above it that are not there, for their owner alone. Durably: also the names of those that are there already,
/// which a server may have made that died or failed before it had synced them.
/// # Errors
/// The file system's; but not that a directory which was there before is none that can be synced at all.
pub fn create_directories(path: &Path) -> io::Result<()> {
    let above = || path.ancestors().skip(1);
    let missing = above().take_while(|above| !above.exists()).count();
    DirBuilder::new()
        .recursive(true)
        .mode(DIRECTORY_MODE)
        .create(path)?;
    for (index, directory) in above().enumerate() {
        match sync_directory(or_here(directory)) {
            Err(error) if index > missing && is_never_synced(&error) => {}
            synced => synced?,
        }
    }
    Ok(())
}

/// Whether others than its owner may do anything with a file or directory.
/// # Errors
/// The file system's.
pub fn is_open_to_others(path: &Path) -> io::Result<bool> {
    Ok(fs::symlink_metadata(path)?.permissions().mode() & OTHERS != 0)
}

/// Takes from others what they may do with a directory and with what lies in it, without what lies deeper.
/// # Errors
/// The file system's: they may belong to somebody else.
pub fn close_to_others(directory: &Path) -> io::Result<()> {
    let close = |path: &Path| {
        let metadata = fs::symlink_metadata(path)?;
        let mode = metadata.permissions().mode();
        if metadata.is_symlink() || mode & OTHERS == 0 {
            return Ok(());
        }
        fs::set_permissions(path, Permissions::from_mode(mode & !OTHERS))
    };
    close(directory)?;
    for entry in fs::read_dir(directory)? {
        close(&entry?.path())?;
    }
    Ok(())
}

/// Whether a directory cannot be synced whatever its disk does, so that no name in it is ours: it is somebody else's, or its file
/// system knows no syncs.
fn is_never_synced(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::PermissionDenied
            | io::ErrorKind::ReadOnlyFilesystem
            | io::ErrorKind::InvalidInput
            | io::ErrorKind::Unsupported
    )
}

/// Makes the files in a directory durable.
pub(super) fn sync_all(directory: &Path) -> io::Result<()> {
    for entry in fs::read_dir(directory)? {
        File::open(entry?.path())?.sync_all()?;
    }
    Ok(())
}

/// Makes the names in a directory durable.
fn sync_directory(path: &Path) -> io::Result<()> {
    File::open(path)?.sync_all()
}

fn parent(directory: &Path) -> &Path {
    or_here(directory.parent().unwrap_or(directory))
}

/// The directory above a name alone is the empty path.
fn or_here(path: &Path) -> &Path {
    if path.as_os_str().is_empty() {
        Path::new(".")
    } else {
        path
    }
}

fn is_short_read(error: &rusqlite::Error) -> bool {
    error
        .sqlite_error()
        .is_some_and(|error| error.extended_code == rusqlite::ffi::SQLITE_IOERR_SHORT_READ)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A scene on a full disk heals by itself when there is room again, and says so.
    #[test]
    fn a_full_disk_is_told_from_one_that_fails() {
        let site = Site::new(Path::new("scene"));
        for full in [io::ErrorKind::StorageFull, io::ErrorKind::QuotaExceeded] {
            let error = site.io(&full.into());
            assert!(matches!(error, LogError::Full { .. }), "{error:?}");
        }
        let error = site.io(&io::ErrorKind::PermissionDenied.into());
        assert!(matches!(error, LogError::Failed { .. }), "{error:?}");
    }
}
