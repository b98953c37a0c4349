//! Arrays of positions to columns of lattice steps, every fault with its place.

use numpy::ndarray::ArrayView2;
use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use union3d::geometry::convex::Point;
use union3d::geometry::{COORDINATE_MAX, Place};
use union3d::wire::convert::Settings;
use union3d::wire::problem::{Fault, Faults, Problem};
use union3d::wire::solids::Scale;

/// Columns of x, y and z. Units: lattice steps.
pub(crate) type Columns = [Vec<i32>; 3];

/// Positions as they come from Python, a row each. `[[x, y, z], ..]`
#[derive(FromPyObject)]
pub(crate) enum Positions<'py> {
    /// In user units.
    #[pyo3(transparent)]
    User(PyReadonlyArray2<'py, f64>),
    /// In lattice steps.
    #[pyo3(transparent)]
    Steps(PyReadonlyArray2<'py, i64>),
}

/// The same to read from while other Python threads run.
pub(crate) enum Rows<'a> {
    /// In user units.
    User(ArrayView2<'a, f64>),
    /// In lattice steps.
    Steps(ArrayView2<'a, i64>),
}

impl Positions<'_> {
    /// Its rows.
    /// # Errors
    /// A row has not three coordinates. `name` is the array's.
    pub(crate) fn rows(&self, name: &str) -> Result<Rows<'_>, Problem> {
        let width = match self {
            Self::User(array) => array.shape()[1],
            Self::Steps(array) => array.shape()[1],
        };
        if width != 3 {
            let detail = format!("has {width} coordinates a row, not 3");
            return Err(Fault::at(format!("/{name}"), detail, None).into());
        }
        Ok(match self {
            Self::User(array) => Rows::User(array.as_array()),
            Self::Steps(array) => Rows::Steps(array.as_array()),
        })
    }
}

impl Rows<'_> {
    /// Lower corners of cubes.
    /// # Errors
    /// Every coordinate at fault, as `/corners/ROW/AXIS`.
    pub(crate) fn corners(&self, settings: &Settings) -> Result<Columns, Problem> {
        match self {
            Self::User(rows) => columns(
                rows,
                "corners",
                |at| settings.place(at).map(Place::corner).ok(),
                |coordinate| {
                    settings
                        .coordinate_fault(coordinate)
                        .map(|fault| fault.to_string())
                },
            ),
            Self::Steps(rows) => columns(
                rows,
                "corners",
                |at| Place::new(at, settings.edge()).map(Place::corner).ok(),
                |coordinate| {
                    let place = Place::new([coordinate, 0, 0], settings.edge());
                    place.err().map(|fault| fault.to_string())
                },
            ),
        }
    }

    /// Points of a scene of solids.
    /// # Errors
    /// Every coordinate at fault, as `/NAME/ROW/AXIS`.
    pub(crate) fn points(&self, scale: Scale, name: &str) -> Result<Columns, Problem> {
        match self {
            Self::User(rows) => columns(
                rows,
                name,
                |at| scale.point(at, "").map(Point::coordinates).ok(),
                |coordinate| {
                    scale
                        .point([coordinate, 0.0, 0.0], "")
                        .err()
                        .map(|fault| fault.what)
                },
            ),
            Self::Steps(rows) => columns(
                rows,
                name,
                |at| Point::new(at).map(Point::coordinates).ok(),
                |coordinate| {
                    let point = Point::new([coordinate, 0, 0]);
                    point
                        .err()
                        .map(|_| format!("is outside -{COORDINATE_MAX} to {COORDINATE_MAX} steps"))
                },
            ),
        }
    }

    /// The points, in user units.
    pub(crate) fn user(&self, steps_per_unit: u32) -> Vec<[f64; 3]> {
        match self {
            Self::User(rows) => rows
                .rows()
                .into_iter()
                .map(|row| [row[0], row[1], row[2]])
                .collect(),
            Self::Steps(rows) => {
                #[expect(
                    clippy::cast_precision_loss,
                    reason = "points beyond 2^53 steps are beyond every scene"
                )]
                let user = |steps: i64| steps as f64 / f64::from(steps_per_unit);
                let rows = rows.rows().into_iter();
                rows.map(|row| [user(row[0]), user(row[1]), user(row[2])])
                    .collect()
            }
        }
    }
}

/// The rows as columns; where one does not fit, what is wrong with each of its coordinates.
fn columns<T: Copy + ToString + Into<serde_json::Value>>(
    rows: &ArrayView2<'_, T>,
    name: &str,
    read: impl Fn([T; 3]) -> Option<[i32; 3]>,
    fault: impl Fn(T) -> Option<String>,
) -> Result<Columns, Problem> {
    let mut columns = [(); 3].map(|()| Vec::with_capacity(rows.nrows()));
    let mut faults = Faults::default();
    for (index, row) in rows.rows().into_iter().enumerate() {
        let at = [row[0], row[1], row[2]];
        if let Some(corner) = read(at) {
            for (column, steps) in columns.iter_mut().zip(corner) {
                column.push(steps);
            }
            continue;
        }
        for (axis, coordinate) in at.into_iter().enumerate() {
            if let Some(detail) = fault(coordinate) {
                faults.push(Fault {
                    value: Some(shown(coordinate)),
                    ..Fault::at(format!("/{name}/{index}/{axis}"), detail, None)
                });
            }
        }
        if faults.is_full() {
            break;
        }
    }
    if faults.is_empty() {
        return Ok(columns);
    }
    Err(faults.into_problem())
}

/// A coordinate as it is shown; JSON has no number for some floats.
fn shown<T: Copy + ToString + Into<serde_json::Value>>(coordinate: T) -> serde_json::Value {
    match coordinate.into() {
        serde_json::Value::Null => coordinate.to_string().into(),
        number => number,
    }
}
