//! Copies of scenes: of one that is served, while changes go on, and of those of a data directory that no service uses; and bringing one
//! back.
//!
//! A copy is one file (`log::restore` says what is in it). What is brought back is checked as `audit` checks a directory, before the
//! scene has its name.

use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::kind::SceneKind;
use super::offline::{Offline, OfflineAudit, audit_of_any, keep_all};
use super::reading::Cancelling;
use super::scene::{SceneOf, blocking};
use super::solids::Solids;
use super::{SceneName, Seq, ServiceError, StartError};
use crate::log::{Cubes, Log, LogError, TEMPORARY_PREFIX, is_of, restore};

/// A copy of a scene's log, in a file without a name: its space is given back when it is closed.
#[derive(Debug)]
pub struct Copied {
    /// The seq that it is as of.
    pub seq: Seq,
    /// It, from its beginning.
    pub file: File,
    /// Size in bytes.
    pub size: u64,
}

impl<K: SceneKind> SceneOf<K> {
    /// Copies the scene's log as of its newest seq, while changes go on. Takes as much space beside the scenes as the scene, until the
    /// file is closed. One copy of a scene at a time is made: others wait. When the future is dropped it breaks off soon.
    pub async fn copy(self: &Arc<Self>) -> Result<Copied, ServiceError> {
        let _turn = self.copies.acquire().await.expect("it is never closed");
        let feed = self.feed()?;
        let cancelled = Arc::new(AtomicBool::new(false));
        let _cancelling = Cancelling(cancelled.clone());
        let scenes = self
            .directory
            .parent()
            .unwrap_or(&self.directory)
            .to_owned();
        let copy = move || {
            // Where space is looked for and a crash is cleaned up after.
            let directory = tempfile::Builder::new()
                .prefix(&format!("{TEMPORARY_PREFIX}copy-"))
                .tempdir_in(scenes);
            let failed = |error: io::Error| storage(&error);
            let directory = directory.map_err(failed)?;
            let path = directory.path().join("copy");
            let goes_on = || !cancelled.load(Ordering::Relaxed);
            let seq = feed.history.copy_into(&path, &goes_on)?;
            let file = File::open(&path).map_err(failed)?;
            let size = file.metadata().map_err(failed)?.len();
            Ok(Copied { seq, file, size })
        };
        blocking(copy).await?
    }
}

fn storage(error: &io::Error) -> ServiceError {
    ServiceError::Storage {
        cause: error.to_string(),
        full: matches!(
            error.kind(),
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded
        ),
    }
}

impl ServiceError {
    /// A file beside the scenes cannot be written.
    pub fn of_storage(error: &io::Error) -> Self {
        storage(error)
    }
}

impl<K: SceneKind> SceneOf<K> {
    /// Whether a file beside the scenes may grow: what is only read leaves as much of the disk free as changes do.
    /// # Errors
    /// [`io::ErrorKind::StorageFull`] below the floor of free space.
    pub fn check_space(&self) -> io::Result<()> {
        self.setup.check_disk().map_err(|refusal| {
            let cause = match refusal {
                ServiceError::Storage { cause, .. } => cause,
                other => other.to_string(),
            };
            io::Error::new(io::ErrorKind::StorageFull, cause)
        })
    }

    /// An empty file without a name, where the scenes are: its space is given back when it is closed.
    /// # Errors
    /// The disk's, or [`Self::check_space`]'s.
    pub fn scratch(&self) -> io::Result<File> {
        self.check_space()?;
        tempfile::tempfile_in(self.directory.parent().unwrap_or(&self.directory))
    }
}

impl Offline {
    /// Copies a scene's log into a file that is not there yet, once every checksum of it was compared: the seq that the copy is as of.
    /// # Errors
    /// What the log says of its files; the disk's.
    /// # Panics
    /// With a name that is not one of [`Offline::scenes`].
    pub fn copy(&self, name: &SceneName, file: &Path) -> Result<Seq, LogError> {
        let directory = self.directory(name);
        if is_of::<Solids>(directory)? {
            copy_of::<Solids>(directory, file)
        } else {
            copy_of::<Cubes>(directory, file)
        }
    }

    /// Brings a scene back from a copy, checked like [`Offline::audit`] checks it before it appears. Its seq, its history and its
    /// incarnation are those of the copy. `progress` gets parts per thousand.
    /// # Errors
    /// A scene of this name is there; the file is no copy of a scene, or not right.
    pub fn restore(
        &self,
        name: &SceneName,
        file: &Path,
        progress: &mut dyn FnMut(u32),
    ) -> Result<OfflineAudit, StartError> {
        let failed = |error: &dyn std::fmt::Display| {
            StartError(format!("cannot restore {}: {error}", file.display()))
        };
        if self.scenes().any(|own| own == name) {
            let name = name.as_str();
            return Err(failed(&format_args!("a scene {name} is there already")));
        }
        let mut audited = None;
        let restored = restore(
            file,
            &self.scenes_directory().join(name.as_str()),
            |directory| {
                let found = audit_of_any(directory, progress)?;
                if !found.audit.is_equal() {
                    let detail = "its totals differ from a recount".to_owned();
                    let path = file.to_owned();
                    return Err(LogError::Foreign { path, detail });
                }
                audited = Some(found);
                adopt(directory)
            },
        );
        restored.map_err(|error| failed(&error))?;
        Ok(audited.expect("it was checked"))
    }
}

fn copy_of<K: SceneKind>(directory: &Path, file: &Path) -> Result<Seq, LogError> {
    let (mut log, _) = Log::<K>::open(directory, keep_all())?;
    log.verify(&mut |_| ())?;
    log.history()?.copy_into(file, &|| true)
}

fn adopt(directory: &Path) -> Result<(), LogError> {
    if is_of::<Solids>(directory)? {
        Log::<Solids>::open(directory, keep_all())?.0.adopt()
    } else {
        Log::<Cubes>::open(directory, keep_all())?.0.adopt()
    }
}
