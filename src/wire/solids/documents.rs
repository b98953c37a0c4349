//! The JSON of shapes and solids.

use serde::{Deserialize, Serialize};

/// What solids of a scene share: one of these forms. Lengths are in user units; the origin is the shape's anchor, which is carried along
/// the path of a solid.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ShapeDocument {
    /// A flat end mill.
    Flat(CutterDocument),
    /// A ball end mill.
    Ball(CutterDocument),
    /// A bull-nose end mill: flat with a rounded corner, `corner_radius`.
    Bull(CutterDocument),
    /// A V-shaped cutter with the whole `angle` between its sides; its flat `tip` has this diameter (0: it ends in a point).
    Vee(CutterDocument),
    /// A drill with the whole point `angle` (118 degrees unless said).
    Drill(CutterDocument),
    /// A tapered end mill: `tip` is the diameter of its flat tip, `angle` the angle between its axis and its side.
    Tapered(CutterDocument),
    /// A box: its size, with its least corner at the anchor; or its corners.
    Box(BoxDocument),
    /// The convex hull of points. `[[x, y, z], ...]`
    Hull(Vec<[f64; 3]>),
    /// Several convex shapes that move together, such as a cutter and its holder.
    Parts(Vec<ShapeDocument>),
}

/// A round cutter that points down. Lengths are whole numbers of lattice steps.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CutterDocument {
    /// Diameter of the shank. Units: user units.
    pub diameter: f64,
    /// Height of the shank's top above the tip. Units: user units.
    pub length: f64,
    /// Radius of the rounded corner; of a bull-nose end mill only. Units: user units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corner_radius: Option<f64>,
    /// Diameter of the flat tip; of a vee (0 unless said) and a tapered end mill only. Units: user units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tip: Option<f64>,
    /// Of a vee, a drill and a tapered end mill only. Units: degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub angle: Option<f64>,
    /// Rings of the round end of a ball or bull-nose end mill. Range: 2 to 64.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rings: Option<u16>,
    /// Sides of the polygon that stands for a circle. Range: 3 to 1024.
    #[serde(default = "default_sides")]
    pub sides: u16,
    /// Which polygon it is.
    #[serde(default)]
    pub polygon: FitName,
    /// Where the centre of its tip is, seen from the shape's anchor. Units: user units. `[x, y, z]`
    #[serde(default)]
    pub at: [f64; 3],
}

fn default_sides() -> u16 {
    32
}

/// Which polygon stands for a circle.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FitName {
    /// The regular polygon of the circle's area.
    #[default]
    EqualArea,
    /// A polygon inside the circle.
    Inscribed,
    /// A polygon around the circle.
    Circumscribed,
}

/// A box.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
#[serde(untagged)]
pub enum BoxDocument {
    /// Its size along x, y and z; its least corner is the anchor.
    Size([f64; 3]),
    /// Its corners.
    Corners {
        /// Least corner.
        min: [f64; 3],
        /// Greatest corner.
        max: [f64; 3],
    },
}

/// A solid to insert: a shape at one place (`at`), a shape carried along a segment (`from`, `to`), or a convex hull of its own.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SolidDocument {
    /// Its id, unique in the scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<u64>,
    /// The name of its shape.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shape: Option<String>,
    /// Where the shape's anchor is. Units: user units. `[x, y, z]`
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at: Option<[f64; 3]>,
    /// Where the shape's anchor is carried from. Units: user units. `[x, y, z]`
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<[f64; 3]>,
    /// Where the shape's anchor is carried to. Units: user units. `[x, y, z]`
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to: Option<[f64; 3]>,
    /// The points whose convex hull it is. Units: user units. `[[x, y, z], ...]`
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hull: Option<Vec<[f64; 3]>>,
}
