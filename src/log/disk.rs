//! The way to the disk: how SQLite opens its files, and every call on the files that SQLite does not look after.
//!
//! One seam under the log. Knows which calls are made, never what is in the files. A test that opens SQLite through a VFS of its own and
//! watches the other calls sees, refuses or cuts every access of a scene to its disk.

use std::ffi::OsString;
use std::fmt;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rusqlite::{Connection, OpenFlags};

/// A call on a file or directory that SQLite does not look after, before it is made.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum FileCall<'a> {
    /// Opens a file to read it.
    Read(&'a Path),
    /// Opens a file to write it, and creates it when it is not there.
    Open(&'a Path),
    /// Replaces the first bytes of a file that is open.
    Write(&'a Path, &'a [u8]),
    /// Syncs a file that is open.
    Sync(&'a Path),
    /// Writes and syncs a nameless file in a directory and removes it, to see whether the disk takes it.
    Try(&'a Path),
    /// Creates a directory.
    CreateDirectory(&'a Path),
    /// Lists a directory.
    ListDirectory(&'a Path),
    /// Syncs a directory: only then are the names in it durable.
    SyncDirectory(&'a Path),
    /// Removes a directory with all that is in it.
    RemoveDirectory(&'a Path),
    /// Renames a directory.
    Rename {
        /// From this name.
        from: &'a Path,
        /// To this one.
        to: &'a Path,
    },
}

/// Asked before every [`FileCall`]: an error is the call's, which is then not made.
pub type FileWatch = Arc<dyn Fn(FileCall<'_>) -> io::Result<()> + Send + Sync>;

/// How a log reaches its disk. The default is the operating system's files.
#[derive(Clone, Default)]
pub struct Disk {
    /// Name of the registered SQLite VFS through which databases are opened; none for SQLite's own.
    pub sqlite_vfs: Option<Box<str>>,
    /// Sees every call on the other files.
    pub watch: Option<FileWatch>,
}

impl fmt::Debug for Disk {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Disk")
            .field("sqlite_vfs", &self.sqlite_vfs)
            .field("is_watched", &self.watch.is_some())
            .finish()
    }
}

impl Disk {
    pub(super) fn connect(
        &self,
        database: impl AsRef<Path>,
        flags: OpenFlags,
    ) -> rusqlite::Result<Connection> {
        match &self.sqlite_vfs {
            None => Connection::open_with_flags(database, flags),
            Some(vfs) => Connection::open_with_flags_and_vfs(database, flags, &**vfs),
        }
    }

    pub(super) fn read(&self, path: &Path) -> io::Result<File> {
        self.ask(FileCall::Read(path))?;
        File::open(path)
    }

    pub(super) fn open(&self, path: PathBuf) -> io::Result<OpenFile> {
        self.ask(FileCall::Open(&path))?;
        let file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)?;
        Ok(OpenFile {
            disk: self.clone(),
            path,
            file,
        })
    }

    /// Whether `bytes` more can be written in a directory.
    pub(super) fn try_bytes(&self, directory: &Path, bytes: usize) -> io::Result<()> {
        self.ask(FileCall::Try(directory))?;
        let mut file = tempfile::tempfile_in(directory)?;
        file.write_all(&vec![1; bytes])?;
        file.sync_all()
    }

    /// Creates a directory and those above it that are not there. Durably: also the names of those that are there already,
    /// which a server that died may have made and not synced.
    /// # Errors
    /// The file system's; but not that a directory which was there before cannot be synced.
    pub fn create_directories(&self, path: &Path) -> io::Result<()> {
        let above = || path.ancestors().skip(1);
        let missing = above().take_while(|above| !above.exists()).count();
        self.ask(FileCall::CreateDirectory(path))?;
        fs::create_dir_all(path)?;
        for (index, directory) in above().enumerate() {
            match self.sync_directory(or_here(directory)) {
                Err(error) if index <= missing => return Err(error),
                _ => {}
            }
        }
        Ok(())
    }

    pub(super) fn create_directory(&self, path: &Path) -> io::Result<()> {
        self.ask(FileCall::CreateDirectory(path))?;
        fs::create_dir(path)
    }

    /// Names in a directory, in no order.
    /// # Errors
    /// The file system's.
    pub fn list_directory(&self, path: &Path) -> io::Result<Vec<OsString>> {
        self.ask(FileCall::ListDirectory(path))?;
        fs::read_dir(path)?
            .map(|entry| Ok(entry?.file_name()))
            .collect()
    }

    /// Makes the names in a directory durable.
    /// # Errors
    /// The file system's.
    pub fn sync_directory(&self, path: &Path) -> io::Result<()> {
        self.ask(FileCall::SyncDirectory(path))?;
        File::open(path)?.sync_all()
    }

    pub(super) fn remove_directory(&self, path: &Path) -> io::Result<()> {
        self.ask(FileCall::RemoveDirectory(path))?;
        fs::remove_dir_all(path)
    }

    pub(super) fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.ask(FileCall::Rename { from, to })?;
        fs::rename(from, to)
    }

    fn ask(&self, call: FileCall<'_>) -> io::Result<()> {
        self.watch.as_ref().map_or(Ok(()), |watch| watch(call))
    }
}

/// The directory above a name alone is the empty path.
pub(super) fn or_here(path: &Path) -> &Path {
    if path.as_os_str().is_empty() {
        Path::new(".")
    } else {
        path
    }
}

/// A file that is open to be written.
#[derive(Debug)]
pub(super) struct OpenFile {
    disk: Disk,
    path: PathBuf,
    file: File,
}

impl OpenFile {
    /// Replaces the first bytes.
    pub(super) fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.disk.ask(FileCall::Write(&self.path, bytes))?;
        self.file.seek(SeekFrom::Start(0))?;
        self.file.write_all(bytes)
    }

    pub(super) fn sync(&self) -> io::Result<()> {
        self.disk.ask(FileCall::Sync(&self.path))?;
        self.file.sync_all()
    }
}
