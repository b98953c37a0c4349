//! The file of keys, read again whenever it has changed.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use arc_swap::ArcSwap;
use parking_lot::Mutex;

use super::keys::Keys;

/// How often it is looked whether the file has changed.
const PAUSE: Duration = Duration::from_secs(1);

/// A file of keys, and what is taken from it.
#[derive(Debug)]
pub(super) struct KeyFile {
    path: PathBuf,
    keys: ArcSwap<Keys>,
    /// What it held when it was last read; none when it could not be read.
    seen: Mutex<Option<String>>,
    /// Whether the keys are those of an earlier file.
    is_broken: AtomicBool,
}

/// Why there are no keys.
#[derive(Debug, thiserror::Error)]
#[error("keys: {}: {cause} (`union3d key new` makes a key and its line for the file)", path.display())]
pub struct KeysUnusable {
    path: PathBuf,
    cause: String,
}

impl KeyFile {
    pub(super) fn open(path: &Path) -> Result<Self, KeysUnusable> {
        let unusable = |cause: String| KeysUnusable {
            path: path.to_owned(),
            cause,
        };
        let text = std::fs::read_to_string(path).map_err(|error| unusable(error.to_string()))?;
        let keys = Keys::parse(&text).map_err(|error| unusable(error.to_string()))?;
        Ok(Self {
            path: path.to_owned(),
            keys: ArcSwap::from_pointee(keys),
            seen: Mutex::new(Some(text)),
            is_broken: AtomicBool::new(false),
        })
    }

    pub(super) fn keys(&self) -> Arc<Keys> {
        self.keys.load_full()
    }

    /// Whether the file cannot be taken as it is now.
    pub(super) fn is_broken(&self) -> bool {
        self.is_broken.load(Ordering::Relaxed)
    }

    /// Reads the file again. A file that cannot be taken leaves the keys as they are: it may be half written.
    pub(super) fn reload(&self) {
        let read = std::fs::read_to_string(&self.path);
        let now = read.as_ref().ok().cloned();
        let mut seen = self.seen.lock();
        if *seen == now && (now.is_some() || self.is_broken()) {
            return;
        }
        *seen = now;
        let path = self.path.display();
        let parsed = match read {
            Ok(text) => Keys::parse(&text).map_err(|error| error.to_string()),
            Err(error) => Err(error.to_string()),
        };
        match parsed {
            Ok(keys) => {
                tracing::info!(
                    keys = keys.len(),
                    "the keys are those of {path} as it is now"
                );
                self.keys.store(Arc::new(keys));
                self.is_broken.store(false, Ordering::Relaxed);
            }
            Err(error) => {
                tracing::warn!("{path} cannot be taken, the keys are those from before: {error}");
                self.is_broken.store(true, Ordering::Relaxed);
            }
        }
    }

    /// Reads the file again whenever it has changed, for ever.
    pub(super) async fn watch(self: Arc<Self>) {
        loop {
            tokio::time::sleep(PAUSE).await;
            let file = self.clone();
            // A file system that hangs must not hold up who asks.
            let _ = tokio::task::spawn_blocking(move || file.reload()).await;
        }
    }
}
