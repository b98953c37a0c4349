//! Checked settings of a scene.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::geometry::{Edge, Stock};

/// What `at` names.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Anchor {
    /// The lower corner of a cube.
    #[default]
    Corner,
    /// The centre of a cube.
    Center,
}

/// What becomes of a coordinate between two steps.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Rounding {
    /// The nearest step, halves away from zero.
    #[default]
    Nearest,
    /// It is refused when it is more than a millionth of a step off.
    Reject,
}

/// Checked settings of a scene: how user units and lattice steps correspond.
#[derive(Clone, PartialEq, Debug)]
pub struct Settings {
    pub(super) edge: Edge,
    pub(super) steps_per_unit: u32,
    pub(super) unit: String,
    pub(super) density: f64,
    pub(super) anchor: Anchor,
    pub(super) rounding: Rounding,
    pub(super) stock: Option<Stock>,
}

impl Settings {
    /// Edge of every cube.
    pub fn edge(&self) -> Edge {
        self.edge
    }

    /// The block of material that is cut, if any.
    pub fn stock(&self) -> Option<Stock> {
        self.stock
    }

    /// Lattice steps in a user unit.
    pub fn steps_per_unit(&self) -> u32 {
        self.steps_per_unit
    }

    /// Label of the user unit.
    pub fn unit(&self) -> &str {
        &self.unit
    }
}
