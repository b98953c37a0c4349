//! What the Python side calls. Its own documentation is there.
#![expect(
    clippy::needless_pass_by_value,
    reason = "arguments come from Python by value"
)]

use std::path::PathBuf;
use std::sync::{PoisonError, RwLock};

use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use union3d::engine::Side;
use union3d::wire::memory::{Answered, HistoryWanted};
use union3d::wire::problem::Problem;
use union3d::wire::proto::{Change, Hull};

use crate::backend::Backend;
use crate::columns::{Columns, Positions};
use crate::failure::Failure;
use crate::settings::Units;

/// A scene, wherever it is.
#[pyclass(frozen, module = "union3d._native")]
pub(crate) struct Scene {
    /// None when it was closed. In a box of its own: Python places objects where the engine's alignment is not kept.
    backend: RwLock<Option<Box<Backend>>>,
    units: Units,
    /// What it was when it was opened.
    described: String,
}

/// An array of ids or numbers, one for each row.
type Column<'py, T> = Option<PyReadonlyArray1<'py, T>>;

#[pymethods]
impl Scene {
    /// A scene in memory with these settings, a JSON document; of its newest `changes_max` changes the history is known.
    #[staticmethod]
    fn memory(py: Python<'_>, settings: &str, changes_max: usize) -> Result<Self, Failure> {
        Self::opened(py, Backend::memory(settings, changes_max)?, Some(settings))
    }

    /// A scene of a data directory. Without settings it must be there.
    #[staticmethod]
    fn directory(
        py: Python<'_>,
        data: PathBuf,
        name: &str,
        settings: Option<&str>,
    ) -> Result<Self, Failure> {
        Self::opened(py, Backend::directory(py, &data, name)?, settings)
    }

    /// A scene of a server. Without settings it must be there.
    #[staticmethod]
    fn server(
        py: Python<'_>,
        address: &str,
        settings: Option<&str>,
        key: Option<&str>,
        ca: Option<PathBuf>,
    ) -> Result<Self, Failure> {
        Self::opened(py, Backend::server(address, key, ca.as_deref())?, settings)
    }

    /// What it was when it was opened, a JSON document.
    #[getter]
    fn described(&self) -> &str {
        &self.described
    }

    /// Deletes ids, then inserts cubes, as one change; with `dry_run` says what that would do.
    #[expect(clippy::too_many_arguments, reason = "the Python side names each")]
    fn change_cubes(
        &self,
        py: Python<'_>,
        delete: Column<'_, u64>,
        ids: Column<'_, u64>,
        corners: Option<Positions<'_>>,
        number: Option<u64>,
        duration: Option<f64>,
        dry_run: bool,
    ) -> Result<String, Failure> {
        let settings = self.units.cubes()?;
        let [x, y, z] = match &corners {
            None => Columns::default(),
            Some(corners) => {
                let rows = corners.rows("corners")?;
                py.detach(|| rows.corners(settings))?
            }
        };
        let change = Change {
            delete: column(delete),
            insert_id: column(ids),
            x,
            y,
            z,
            r#move: number,
            duration,
            ..Change::default()
        };
        self.change(py, change, dry_run)
    }

    /// Deletes ids, then inserts shapes carried from `start` to `end` and hulls, as one change; with `dry_run` says what that would do.
    /// `shape` says for each row which of `shapes` it is.
    #[expect(clippy::too_many_arguments, reason = "the Python side names each")]
    fn change_solids(
        &self,
        py: Python<'_>,
        delete: Column<'_, u64>,
        ids: Column<'_, u64>,
        shapes: Vec<String>,
        shape: Column<'_, u32>,
        start: Option<Positions<'_>>,
        end: Option<Positions<'_>>,
        hulls: Vec<Positions<'_>>,
        number: Option<u64>,
        duration: Option<f64>,
        dry_run: bool,
    ) -> Result<String, Failure> {
        let scale = self.units.solids()?;
        let columns = |positions: &Option<Positions<'_>>, name: &str| match positions {
            None => Ok(Columns::default()),
            Some(positions) => {
                let rows = positions.rows(name)?;
                py.detach(|| rows.points(scale, name))
            }
        };
        let [x, y, z] = columns(&start, "start")?;
        let [to_x, to_y, to_z] = columns(&end, "end")?;
        let hulls = hulls.iter().enumerate().map(|(index, points)| {
            let name = format!("hulls/{index}");
            let [x, y, z] = points.rows(&name)?.points(scale, &name)?;
            Ok(Hull { x, y, z })
        });
        let change = Change {
            delete: column(delete),
            insert_id: column(ids),
            shapes,
            shape: column(shape),
            x,
            y,
            z,
            to_x,
            to_y,
            to_z,
            hulls: hulls.collect::<Result<_, Problem>>()?,
            r#move: number,
            duration,
        };
        self.change(py, change, dry_run)
    }

    /// Defines a shape from its JSON document.
    fn define(&self, py: Python<'_>, name: &str, shape: &str) -> Result<String, Failure> {
        self.units.solids()?;
        self.with(|backend| backend.define(py, name, shape))
    }

    /// All solids, a line of JSON each.
    fn solids(&self, py: Python<'_>) -> Result<String, Failure> {
        self.units.solids()?;
        let lines = self.with(|backend| backend.solids(py))?;
        Ok(String::from_utf8(lines).map_err(|error| PyValueError::new_err(error.to_string()))?)
    }

    /// Goes back to what was at a seq.
    fn revert(&self, py: Python<'_>, to: u64) -> Result<String, Failure> {
        self.with(|backend| backend.revert(py, to))
    }

    /// The mass properties now, or after a past change.
    fn mass_properties(&self, py: Python<'_>, at: Option<u64>) -> Result<String, Failure> {
        self.with(|backend| backend.mass_properties(py, at))
    }

    /// The history as CSV.
    fn history(
        &self,
        py: Python<'_>,
        seqs: (Option<u64>, Option<u64>),
        moves: (Option<u64>, Option<u64>),
        limit: Option<u64>,
    ) -> Result<String, Failure> {
        let wanted = HistoryWanted {
            from: seqs.0,
            to: seqs.1,
            move_from: moves.0,
            move_to: moves.1,
            limit,
        };
        let csv = self.with(|backend| backend.history(py, wanted))?;
        Ok(String::from_utf8(csv).map_err(|error| PyValueError::new_err(error.to_string()))?)
    }

    /// Recounts everything from the bodies alone.
    fn audit(&self, py: Python<'_>) -> Result<String, Failure> {
        self.with(|backend| backend.audit(py))
    }

    /// Where points lie (0 outside, 1 on the boundary, 2 inside), whether a body holds each, and the id of one that does.
    #[expect(clippy::type_complexity, reason = "three arrays")]
    fn contains<'py>(
        &self,
        py: Python<'py>,
        points: Positions<'py>,
    ) -> Result<
        (
            Bound<'py, PyArray1<u8>>,
            Bound<'py, PyArray1<bool>>,
            Bound<'py, PyArray1<u64>>,
        ),
        Failure,
    > {
        let points = points.rows("points")?.user(self.units.steps_per_unit());
        let found = self.with(|backend| backend.contains(py, points))?;
        let side = |side| match side {
            Side::Outside => 0,
            Side::Boundary => 1,
            Side::Inside => 2,
        };
        let sides: Vec<u8> = found.iter().map(|(found, _)| side(*found)).collect();
        let held: Vec<bool> = found.iter().map(|(_, holder)| holder.is_some()).collect();
        let holders: Vec<u64> = found.iter().map(|(_, id)| id.unwrap_or(0)).collect();
        Ok((
            sides.into_pyarray(py),
            held.into_pyarray(py),
            holders.into_pyarray(py),
        ))
    }

    /// All cubes by their ids: lower corners in lattice steps.
    #[expect(clippy::type_complexity, reason = "two arrays")]
    fn cubes<'py>(
        &self,
        py: Python<'py>,
    ) -> Result<(Bound<'py, PyArray1<u64>>, Bound<'py, PyArray2<i32>>), Failure> {
        let settings = self.units.cubes()?;
        let cubes = self.with(|backend| backend.cubes(py, settings))?;
        let ids: Vec<u64> = cubes.iter().map(|(id, _)| *id).collect();
        let corners = cubes.iter().flat_map(|(_, place)| place.corner());
        let corners = Array2::from_shape_vec((cubes.len(), 3), corners.collect());
        let corners = corners.expect("there are three coordinates a cube");
        Ok((ids.into_pyarray(py), corners.into_pyarray(py)))
    }

    /// Lets go of it; a directory is unlocked with its last scene. Calls after that are refused.
    fn close(&self, py: Python<'_>) {
        py.detach(|| {
            let mut backend = self.backend.write().unwrap_or_else(PoisonError::into_inner);
            drop(backend.take());
        });
    }
}

impl Scene {
    fn opened(py: Python<'_>, backend: Backend, settings: Option<&str>) -> Result<Self, Failure> {
        let described = backend.open(py, settings)?;
        let units = Units::of(&described)?;
        Ok(Self {
            backend: RwLock::new(Some(Box::new(backend))),
            units,
            described,
        })
    }

    /// Applies a change; a dry run also says what is measured after it.
    fn change(&self, py: Python<'_>, change: Change, dry_run: bool) -> Result<String, Failure> {
        let answered = if dry_run {
            Answered::Totals
        } else {
            Answered::Change
        };
        self.with(|backend| backend.change(py, Box::new(change), answered, dry_run))
    }

    /// Asks where it is. While it is asked nobody closes it.
    fn with<T>(&self, ask: impl FnOnce(&Backend) -> Result<T, Failure>) -> Result<T, Failure> {
        let backend = self.backend.read().unwrap_or_else(PoisonError::into_inner);
        match &*backend {
            Some(backend) => ask(backend),
            None => Err(PyValueError::new_err("the scene is closed").into()),
        }
    }
}

/// The numbers of an array; of none, none.
fn column<T: numpy::Element + Copy>(array: Column<'_, T>) -> Vec<T> {
    array.map_or_else(Vec::new, |array| array.as_array().iter().copied().collect())
}
