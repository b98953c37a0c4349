//! Checking a data directory that no service uses.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use super::registry::lock_data;
use super::replay::{Compare, rebuild};
use super::{Audit, SceneName, StartError};
use crate::engine::recount;
use crate::log::{Keep, LogError, SceneLog};

/// A data directory, locked: no service can use it meanwhile.
#[derive(Debug)]
pub struct Offline {
    scenes: Vec<(SceneName, PathBuf)>,
    _lock: File,
}

/// What a scene's files hold.
#[derive(Clone, Debug)]
pub struct OfflineAudit {
    /// Totals kept, and recounted.
    pub audit: Audit,
    /// Records whose checksums were compared.
    pub records: u64,
    /// What was found and mended in opening.
    pub notices: Vec<String>,
}

impl Offline {
    /// Locks a data directory.
    /// # Errors
    /// It is none, or a service uses it.
    pub fn open(data: &Path) -> Result<Self, StartError> {
        let directory = data.join("scenes");
        let no_data = |error: std::io::Error| {
            StartError(format!(
                "{} is no data directory of union3d: {}: {error}",
                data.display(),
                directory.display()
            ))
        };
        // Before the lock, which would leave a file in a directory that is none of ours.
        let entries = fs::read_dir(&directory).map_err(no_data)?;
        let lock = lock_data(data)?;
        let mut scenes = Vec::new();
        for entry in entries {
            let path = entry.map_err(no_data)?.path();
            let text = path.file_name().unwrap_or_default().to_string_lossy();
            if let Ok(name) = SceneName::new(&text) {
                scenes.push((name, path));
            }
        }
        scenes.sort();
        Ok(Self {
            scenes,
            _lock: lock,
        })
    }

    /// The scenes, by name.
    pub fn scenes(&self) -> impl Iterator<Item = &SceneName> {
        self.scenes.iter().map(|(name, _)| name)
    }

    /// Checks every checksum of a scene, replays it, and recounts its totals from its cubes alone. `progress` gets parts per
    /// thousand.
    /// # Errors
    /// What the log says of its files. A recount that differs is no error: compare the two in the result.
    /// # Panics
    /// With a name that is not one of [`Offline::scenes`].
    pub fn audit(
        &self,
        name: &SceneName,
        progress: &mut dyn FnMut(u32),
    ) -> Result<OfflineAudit, LogError> {
        let (_, directory) = self
            .scenes
            .iter()
            .find(|(own, _)| own == name)
            .expect("the name is one of scenes()");
        // Nothing is trimmed here: the log keeps what it has.
        let keep = Keep {
            history_changes_max: u64::MAX,
            idempotency_keys_max: u64::MAX,
            revert_changes_max: u64::MAX,
            revert_bytes_max: u64::MAX,
            snapshot_log_bytes_min: u64::MAX,
        };
        let (mut log, notices) = SceneLog::open(directory, keep)?;
        let records = log.verify(&mut |permille| progress(permille / 2))?;
        let rebuilt = rebuild(
            &mut log,
            directory,
            Compare::Every,
            |permille| progress(500 + permille / 2),
            || false,
        )?;
        let rebuilt = rebuilt.expect("nobody ends it");
        let published = rebuilt.published();
        let places = rebuilt.engine.cubes().map(|(_, place)| place);
        Ok(OfflineAudit {
            audit: Audit {
                seq: published.seq,
                kept: published.totals,
                recounted: recount(rebuilt.engine.edge(), rebuilt.engine.stock(), places),
            },
            records,
            notices,
        })
    }
}
