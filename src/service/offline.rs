//! Checking a data directory that no service uses.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use super::kind::SceneKind;
use super::registry::lock_data;
use super::replay::{Compare, rebuild};
use super::solids::Solids;
use super::{Audit, Published, SceneName, Seq, StartError};
use crate::log::{Cubes, Keep, Log, LogError, create_directories, is_of};

/// A data directory, locked: no service can use it meanwhile.
#[derive(Debug)]
pub struct Offline {
    directory: PathBuf,
    scenes: Vec<(SceneName, PathBuf)>,
    _lock: File,
}

/// What a scene's files hold.
#[derive(Clone, Debug)]
pub struct OfflineAudit {
    /// Totals kept, and recounted.
    pub audit: AnyAudit,
    /// Records whose checksums were compared.
    pub records: u64,
    /// What was found and mended in opening.
    pub notices: Vec<String>,
}

/// The audit of a scene of whichever kind.
#[derive(Clone, Debug)]
pub enum AnyAudit {
    /// Of cubes.
    Cubes(Box<Audit>),
    /// Of solids.
    Solids(Box<Audit<Solids>>),
}

impl AnyAudit {
    /// Seq it is as of.
    pub fn seq(&self) -> Seq {
        match self {
            Self::Cubes(audit) => audit.seq,
            Self::Solids(audit) => audit.seq,
        }
    }

    /// How many bodies there are.
    pub fn bodies(&self) -> u64 {
        match self {
            Self::Cubes(audit) => audit.kept.cubes,
            Self::Solids(audit) => audit.kept.union.solids,
        }
    }

    /// Whether the totals kept are those recounted.
    pub fn is_equal(&self) -> bool {
        match self {
            Self::Cubes(audit) => audit.is_equal(),
            Self::Solids(audit) => audit.is_equal(),
        }
    }

    /// The totals kept and those recounted, for those who look for the difference.
    pub fn shown(&self) -> [String; 2] {
        match self {
            Self::Cubes(audit) => [audit.kept, audit.recounted].map(|totals| format!("{totals:?}")),
            Self::Solids(audit) => {
                [audit.kept, audit.recounted].map(|totals| format!("{:?}", totals.union))
            }
        }
    }
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
            directory,
            scenes,
            _lock: lock,
        })
    }

    /// As [`Offline::open`]; a directory that is not there is made.
    /// # Errors
    /// It cannot be made, or a service uses it.
    pub fn open_or_create(data: &Path) -> Result<Self, StartError> {
        let scenes = data.join("scenes");
        for directory in [data, &scenes] {
            create_directories(directory)
                .map_err(|error| StartError(format!("{}: {error}", directory.display())))?;
        }
        Self::open(data)
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
        audit_of_any(self.directory(name), progress)
    }

    /// The directory of a scene.
    pub(super) fn directory(&self, name: &SceneName) -> &Path {
        let found = self.scenes.iter().find(|(own, _)| own == name);
        &found.expect("the name is one of scenes()").1
    }

    /// Where the directories of scenes are.
    pub(super) fn scenes_directory(&self) -> &Path {
        &self.directory
    }
}

/// Limits under which nothing is trimmed: the log keeps what it has.
pub(super) fn keep_all() -> Keep {
    Keep {
        history_changes_max: u64::MAX,
        idempotency_keys_max: u64::MAX,
        revert_changes_max: u64::MAX,
        revert_bytes_max: u64::MAX,
        snapshot_log_bytes_min: u64::MAX,
        write_ahead_pages_max: u64::MAX,
    }
}

/// Audits the scene in a directory, of whichever kind.
pub(super) fn audit_of_any(
    directory: &Path,
    progress: &mut dyn FnMut(u32),
) -> Result<OfflineAudit, LogError> {
    if is_of::<Solids>(directory)? {
        audit_of::<Solids>(directory, AnyAudit::Solids, progress)
    } else {
        audit_of::<Cubes>(directory, AnyAudit::Cubes, progress)
    }
}

fn audit_of<K: SceneKind>(
    directory: &Path,
    any: impl FnOnce(Box<Audit<K>>) -> AnyAudit,
    progress: &mut dyn FnMut(u32),
) -> Result<OfflineAudit, LogError> {
    let (mut log, notices) = Log::<K>::open(directory, keep_all())?;
    let records = log.verify(&mut |permille| progress(permille / 2))?;
    let rebuilt = rebuild(
        &mut log,
        directory,
        Compare::Every,
        |permille| progress(500 + permille / 2),
        || false,
    )?;
    let rebuilt = rebuilt.expect("nobody ends it");
    let Published { seq, totals, .. } = rebuilt.published();
    let bodies = K::bodies_after(&rebuilt.engine, None).map(|(_, body)| body);
    let recounted = K::recount(log.header(), bodies.collect(), &|| true);
    Ok(OfflineAudit {
        audit: any(Box::new(Audit {
            seq,
            kept: totals,
            recounted: recounted.expect("nobody ends it"),
        })),
        records,
        notices,
    })
}
