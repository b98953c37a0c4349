//! What goes wrong, on its way to an exception.

use pyo3::prelude::*;
use union3d::wire::problem::Problem;

/// Why a call fails.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The problem document that says why.
    Problem(String),
    /// What Python has raised: an interruption.
    Raised(PyErr),
}

impl From<Problem> for Failure {
    fn from(problem: Problem) -> Self {
        Self::Problem(problem.json())
    }
}

impl From<PyErr> for Failure {
    fn from(raised: PyErr) -> Self {
        Self::Raised(raised)
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::Raised(raised) => raised,
            Failure::Problem(document) => Python::attach(|py| {
                // The class depends on the document: the Python side knows which one says what.
                let made = py
                    .import("union3d._errors")
                    .and_then(|errors| errors.call_method1("from_problem", (document,)));
                made.map_or_else(|error| error, PyErr::from_value)
            }),
        }
    }
}
