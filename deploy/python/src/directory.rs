//! Data directories that this process has opened: one service each, however many scenes of it are open.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;

use axum::Router;
use union3d::service::{CHANGE_OPERATIONS_MAX, Service, ServiceConfig};
use union3d::wire::access::Access;
use union3d::wire::http::{Limits, router};
use union3d::wire::problem::{Code, Problem};

use crate::waiting::runtime;

/// The directories that are open.
static OPENED: Mutex<Option<HashMap<PathBuf, Weak<Directory>>>> = Mutex::new(None);

/// A data directory, locked until the last who holds it lets go.
#[derive(Debug)]
pub(crate) struct Directory {
    path: PathBuf,
    service: Service,
    api: Router,
}

impl Directory {
    /// Opens a data directory, or shares it when this process has opened it.
    /// # Errors
    /// It cannot be used, or another process uses it.
    pub(crate) fn open(path: &Path) -> Result<Arc<Self>, Problem> {
        let unusable = |error: &dyn std::fmt::Display| {
            Problem::new(Code::StorageFailed, format!("{}: {error}", path.display()))
        };
        std::fs::create_dir_all(path).map_err(|error| unusable(&error))?;
        let path = path.canonicalize().map_err(|error| unusable(&error))?;
        let mut opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
        let opened = opened.get_or_insert_default();
        if let Some(directory) = opened.get(&path).and_then(Weak::upgrade) {
            return Ok(directory);
        }
        let _inside = runtime().enter();
        let config = ServiceConfig {
            memory_bytes_max: 1 << 40,
            ..ServiceConfig::new(&path)
        };
        let service = Service::start(config)
            .map_err(|error| Problem::new(Code::StorageFailed, error.to_string()))?;
        // Requests come from this process alone, and are as large and as slow as it wants them.
        let limits = Limits {
            body_bytes_max: 1 << 30,
            change_cubes_max: CHANGE_OPERATIONS_MAX,
            request_timeout: Duration::from_hours(24),
            wait_max: Duration::from_hours(24),
        };
        let directory = Arc::new(Self {
            path: path.clone(),
            api: router(service.clone(), limits, Access::default()),
            service,
        });
        opened.insert(path, Arc::downgrade(&directory));
        Ok(directory)
    }

    /// The HTTP API of its service.
    pub(crate) fn api(&self) -> Router {
        self.api.clone()
    }
}

impl Drop for Directory {
    /// Who opens it meanwhile waits until the lock is free.
    fn drop(&mut self) {
        let mut opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
        runtime().block_on(self.service.shutdown());
        if let Some(opened) = opened.as_mut()
            && opened
                .get(&self.path)
                .is_some_and(|one| one.strong_count() == 0)
        {
            opened.remove(&self.path);
        }
    }
}
