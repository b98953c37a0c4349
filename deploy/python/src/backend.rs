//! Where a scene is, and how it is asked there: answers are the texts of the HTTP API.

use std::path::Path;
use std::sync::{RwLock, RwLockReadGuard, RwLockWriteGuard};

use pyo3::prelude::*;
use union3d::engine::{Op, Side};
use union3d::geometry::Place;
use union3d::wire::convert::Settings;
use union3d::wire::decode;
use union3d::wire::memory::{Answered, HistoryWanted, MemoryCubes, MemoryScene};
use union3d::wire::problem::{Code, Fault, Problem};
use union3d::wire::proto::Change;

use crate::directory::Directory;
use crate::failure::Failure;
use crate::requests::RequestedScene;
use crate::server::Server;
use crate::settings::other_kind;

/// Where a scene is.
pub(crate) enum Backend {
    /// In the memory of this process.
    Memory(RwLock<MemoryScene>),
    /// Where requests of the HTTP API reach it.
    Requested(RequestedScene),
}

impl Backend {
    /// A scene in memory with these settings, a JSON document.
    pub(crate) fn memory(settings: &str, changes_max: usize) -> Result<Self, Failure> {
        let scene = MemoryScene::create(settings.as_bytes(), changes_max)?;
        Ok(Self::Memory(RwLock::new(scene)))
    }

    /// A scene in a directory.
    pub(crate) fn directory(py: Python<'_>, data: &Path, name: &str) -> Result<Self, Failure> {
        let directory = py.detach(|| Directory::open(data))?;
        Ok(Self::Requested(RequestedScene::of_directory(
            directory, name,
        )))
    }

    /// A scene of a server, by its address.
    pub(crate) fn server(
        address: &str,
        key: Option<&str>,
        ca: Option<&Path>,
    ) -> Result<Self, Failure> {
        let (server, name) = Server::of_scene(address, key, ca)?;
        Ok(Self::Requested(RequestedScene::of_server(server, &name)))
    }

    /// Creates it where it is not there yet, and says what it is: its settings as they are answered.
    pub(crate) fn open(&self, py: Python<'_>, settings: Option<&str>) -> Result<String, Failure> {
        match (self, settings) {
            (Self::Memory(scene), _) => Ok(reading(scene)?.settings()),
            (Self::Requested(scene), Some(settings)) => scene.create(py, settings),
            (Self::Requested(scene), None) => scene.describe(py),
        }
    }

    /// Applies a change, or with `dry_run` says what it would do.
    pub(crate) fn change(
        &self,
        py: Python<'_>,
        change: Box<Change>,
        answered: Answered,
        dry_run: bool,
    ) -> Result<String, Failure> {
        match self {
            Self::Memory(scene) => py.detach(|| {
                let mut scene = writing(scene)?;
                Ok(if dry_run {
                    scene.dry_run(change, answered)?
                } else {
                    scene.change(change, answered)?
                })
            }),
            Self::Requested(scene) => scene.change(py, &change, answered, dry_run),
        }
    }

    /// Goes back to what was at a seq.
    pub(crate) fn revert(&self, py: Python<'_>, to: u64) -> Result<String, Failure> {
        match self {
            Self::Memory(scene) => py.detach(|| Ok(writing(scene)?.revert(to)?)),
            Self::Requested(scene) => scene.revert(py, to),
        }
    }

    /// The mass properties now, or after a past change.
    pub(crate) fn mass_properties(
        &self,
        py: Python<'_>,
        at: Option<u64>,
    ) -> Result<String, Failure> {
        match self {
            Self::Memory(scene) => py.detach(|| Ok(reading(scene)?.mass_properties(at)?)),
            Self::Requested(scene) => scene.mass_properties(py, at),
        }
    }

    /// The history as CSV.
    pub(crate) fn history(
        &self,
        py: Python<'_>,
        wanted: HistoryWanted,
    ) -> Result<Vec<u8>, Failure> {
        match self {
            Self::Memory(scene) => py.detach(|| Ok(reading(scene)?.history(wanted))),
            Self::Requested(scene) => scene.history(py, wanted),
        }
    }

    /// Recounts everything from the bodies alone.
    pub(crate) fn audit(&self, py: Python<'_>) -> Result<String, Failure> {
        match self {
            Self::Memory(scene) => py.detach(|| Ok(reading(scene)?.audit()?)),
            Self::Requested(scene) => scene.audit(py),
        }
    }

    /// Where points in user units lie, and the id of a body that holds each.
    pub(crate) fn contains(
        &self,
        py: Python<'_>,
        points: Vec<[f64; 3]>,
    ) -> Result<Vec<(Side, Option<u64>)>, Failure> {
        match self {
            Self::Memory(scene) => py.detach(|| {
                let scene = reading(scene)?;
                let points = points.into_iter().enumerate();
                Ok(points
                    .map(|(index, at)| contained(&scene, index, at))
                    .collect::<Result<_, Problem>>()?)
            }),
            Self::Requested(scene) => scene.contains(py, points),
        }
    }

    /// Defines a shape of a scene of solids.
    pub(crate) fn define(
        &self,
        py: Python<'_>,
        name: &str,
        shape: &str,
    ) -> Result<String, Failure> {
        match self {
            Self::Memory(scene) => py.detach(|| match &mut *writing(scene)? {
                MemoryScene::Solids(solids) => Ok(solids.define(name, shape.as_bytes())?),
                MemoryScene::Cubes(_) => Err(other_kind("the scene is of cubes").into()),
            }),
            Self::Requested(scene) => scene.define(py, name, shape),
        }
    }

    /// All solids of a scene of solids, a line of JSON each.
    pub(crate) fn solids(&self, py: Python<'_>) -> Result<Vec<u8>, Failure> {
        match self {
            Self::Memory(scene) => py.detach(|| match &*reading(scene)? {
                MemoryScene::Solids(solids) => Ok(solids.solids()),
                MemoryScene::Cubes(_) => Err(other_kind("the scene is of cubes").into()),
            }),
            Self::Requested(scene) => Ok(scene.bodies(py, "solids")?.into()),
        }
    }

    /// All cubes of a scene of cubes by their ids.
    pub(crate) fn cubes(
        &self,
        py: Python<'_>,
        settings: &Settings,
    ) -> Result<Vec<(u64, Place)>, Failure> {
        let mut cubes: Vec<(u64, Place)> = match self {
            Self::Memory(scene) => py.detach(|| {
                let listed =
                    |cubes: &MemoryCubes| cubes.cubes().map(|(id, at)| (id.0, at)).collect();
                match &*reading(scene)? {
                    MemoryScene::Cubes(cubes) => Ok::<_, Failure>(listed(cubes)),
                    MemoryScene::Solids(_) => Err(other_kind("the scene is of solids").into()),
                }
            })?,
            Self::Requested(scene) => {
                let lines = scene.bodies(py, "cubes")?;
                py.detach(|| listed(&lines, settings))?
            }
        };
        py.detach(|| cubes.sort_unstable_by_key(|(id, _)| *id));
        Ok(cubes)
    }
}

fn contained(
    scene: &MemoryScene,
    index: usize,
    at: [f64; 3],
) -> Result<(Side, Option<u64>), Problem> {
    let fault = |axis: usize, detail: String| {
        Problem::from(Fault::at(format!("/points/{index}/{axis}"), detail, None))
    };
    if let Some(axis) = at.iter().position(|coordinate| !coordinate.is_finite()) {
        return Err(fault(axis, "is not a finite number".to_owned()));
    }
    let (side, holder) = match scene {
        MemoryScene::Cubes(cubes) => {
            let point = cubes.settings().point(at);
            cubes.contains(point.map_err(|(axis, invalid)| fault(axis, invalid.to_string()))?)
        }
        MemoryScene::Solids(solids) => {
            let pointer = format!("/points/{index}");
            let point = solids.settings().scale().point(at, &pointer);
            solids.contains(point.map_err(|fault| Fault::at(fault.pointer, fault.what, None))?)
        }
    };
    Ok((side, holder.map(|id| id.0)))
}

/// The cubes of a listing, a line each.
fn listed(lines: &[u8], settings: &Settings) -> Result<Vec<(u64, Place)>, Problem> {
    let lines = lines.split(|byte| *byte == b'\n');
    let cubes =
        lines
            .filter(|line| !line.is_empty())
            .map(|line| match decode::line(line, settings)? {
                Op::Insert(id, place) => Ok((id.0, place)),
                Op::Delete(_) => Err(Problem::new(Code::Internal, "the listing deletes a cube")),
            });
    cubes.collect()
}

fn reading(scene: &RwLock<MemoryScene>) -> Result<RwLockReadGuard<'_, MemoryScene>, Problem> {
    scene.read().map_err(|_| broken())
}

fn writing(scene: &RwLock<MemoryScene>) -> Result<RwLockWriteGuard<'_, MemoryScene>, Problem> {
    scene.write().map_err(|_| broken())
}

/// Nobody can say what a change has left behind that ended in the middle.
fn broken() -> Problem {
    let detail = "a change failed in the middle, so that the scene cannot be used any more";
    Problem::new(Code::Internal, detail)
}
