//! How user units and lattice steps correspond in a scene, from what is said of it.

use serde_json::{Map, Value};
use union3d::wire::convert::{Rounding, Settings, SettingsDocument};
use union3d::wire::problem::{Code, Problem};
use union3d::wire::solids::Scale;

/// The units of a scene.
#[derive(Debug)]
pub(crate) enum Units {
    /// Of a scene of cubes.
    Cubes(Box<Settings>),
    /// Of a scene of solids.
    Solids(Scale),
}

impl Units {
    /// Of a scene that is described so, as over HTTP.
    pub(crate) fn of(described: &str) -> Result<Self, Problem> {
        let scene: Map<String, Value> = serde_json::from_str(described).map_err(|_| unknown())?;
        if scene.get("kind").is_some_and(|kind| kind == "solids") {
            return solids(&scene).map(Self::Solids).ok_or_else(unknown);
        }
        cubes(scene)
            .map(Box::new)
            .map(Self::Cubes)
            .ok_or_else(unknown)
    }

    /// Lattice steps in a user unit.
    pub(crate) fn steps_per_unit(&self) -> u32 {
        match self {
            Self::Cubes(settings) => settings.steps_per_unit(),
            Self::Solids(scale) => scale.steps_per_unit(),
        }
    }

    /// Those of cubes.
    /// # Errors
    /// The scene is of solids.
    pub(crate) fn cubes(&self) -> Result<&Settings, Problem> {
        match self {
            Self::Cubes(settings) => Ok(settings),
            Self::Solids(_) => Err(other_kind("the scene is of solids; this call is for cubes")),
        }
    }

    /// Those of solids.
    /// # Errors
    /// The scene is of cubes.
    pub(crate) fn solids(&self) -> Result<Scale, Problem> {
        match self {
            Self::Cubes(_) => Err(other_kind("the scene is of cubes; this call is for solids")),
            Self::Solids(scale) => Ok(*scale),
        }
    }
}

pub(crate) fn other_kind(detail: &str) -> Problem {
    Problem::new(Code::OtherKind, detail)
}

fn cubes(mut scene: Map<String, Value>) -> Option<Settings> {
    const MEMBERS: [&str; 7] = [
        "edge",
        "steps_per_unit",
        "unit",
        "density",
        "anchor",
        "rounding",
        "stock",
    ];
    scene.retain(|name, _| MEMBERS.contains(&name.as_str()));
    let document: SettingsDocument = serde_json::from_value(scene.into()).ok()?;
    Settings::check(&document).ok()
}

fn solids(scene: &Map<String, Value>) -> Option<Scale> {
    let steps = scene.get("steps_per_unit")?.as_u64()?;
    let rounding: Rounding = serde_json::from_value(scene.get("rounding")?.clone()).ok()?;
    let scale = Scale::new(u32::try_from(steps).ok()?).ok()?;
    Some(scale.with_rounding(rounding))
}

fn unknown() -> Problem {
    let detail = "the scene's settings are in a form that this version does not know";
    Problem::new(Code::Internal, detail)
}
