//! User units to lattice steps and back: the only place below the command line that knows floats.
//!
//! ```text
//!   at ── * steps_per_unit ── - edge/2 when `at` is a centre ── round or refuse ── Place
//!   Totals (exact integers) ── subtract and divide exactly ── one float each ── / steps_per_unit^k ── MassProperties
//! ```
//! Floats are made last: what cancels (the inertia of a small part far from the origin) cancels in integers.

use std::time::Duration;

use ethnum::I256;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::geometry::{
    Bounds, COORDINATE_MAX, Edge, EdgeKind, InvalidCube, InvalidEdge, Measures, Place, Stock,
    Totals, VertexKind,
};

/// How far from a whole number of steps an edge, or under [`Rounding::Reject`] a coordinate, may be. Units: steps.
const OFF_LATTICE_MAX: f64 = 1e-6;

/// Largest number of steps in a user unit.
pub const STEPS_PER_UNIT_MAX: u32 = 1_000_000_000;

/// Longest label of a unit, in bytes.
pub const UNIT_BYTES_MAX: usize = 32;

/// Largest density: with it no moment of the largest scene overflows a float.
pub const DENSITY_MAX: f64 = 1e200;

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

/// Settings as a client wishes them, not checked yet. Only the edge has no default.
#[derive(Clone, PartialEq, Debug)]
pub struct WantedSettings {
    /// Edge of every cube. Units: user units.
    pub edge: f64,
    /// Lattice steps in a user unit.
    pub steps_per_unit: f64,
    /// Label of the user unit.
    pub unit: String,
    /// Mass of a cubic user unit.
    pub density: f64,
    /// What `at` names.
    pub anchor: Anchor,
    /// What becomes of a coordinate between two steps.
    pub rounding: Rounding,
    /// The block of material that is cut, if any.
    pub stock: Option<StockDocument>,
}

impl WantedSettings {
    /// The defaults, with this edge in user units.
    pub fn with_edge(edge: f64) -> Self {
        Self {
            edge,
            steps_per_unit: 1000.0,
            unit: "mm".to_owned(),
            density: 1.0,
            anchor: Anchor::default(),
            rounding: Rounding::default(),
            stock: None,
        }
    }
}

/// A block of material, in user units.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StockDocument {
    /// Least corner.
    #[schema(example = json!([0.0, 0.0, -10.0]))]
    pub min: [f64; 3],
    /// Greatest corner.
    #[schema(example = json!([80.0, 60.0, 0.0]))]
    pub max: [f64; 3],
}

/// Why settings are refused: the field at fault says which.
#[derive(Clone, PartialEq, Debug, thiserror::Error)]
pub enum InvalidSetting {
    /// `edge` is no whole number of steps.
    #[error(
        "edge {edge} is {steps} steps of 1/{steps_per_unit} unit, which is not a whole number; choose another edge or steps_per_unit"
    )]
    EdgeOffLattice {
        /// The edge that was offered, in user units.
        edge: f64,
        /// The same in steps.
        steps: f64,
        /// Steps in a user unit.
        steps_per_unit: u32,
    },
    /// `edge` is too small or too large.
    #[error(transparent)]
    Edge(#[from] InvalidEdge),
    /// `edge` is no finite number.
    #[error("edge is not a finite number")]
    EdgeNotFinite,
    /// `steps_per_unit` is no whole number in range.
    #[error("steps_per_unit is not a whole number from 1 to {STEPS_PER_UNIT_MAX}")]
    StepsPerUnit,
    /// `unit` is too long or not printable.
    #[error("unit is not a label of 1 to {UNIT_BYTES_MAX} printable bytes")]
    Unit,
    /// `density` is no positive number in range.
    #[error("density is not a number above 0 and at most 1e200")]
    Density,
    /// A coordinate of `stock` is no place on the lattice, or not above the lower one.
    #[error("stock.{corner}[{axis}] {what}")]
    Stock {
        /// `min` or `max`.
        corner: &'static str,
        /// 0 for x, 1 for y, 2 for z.
        axis: usize,
        /// What is wrong with it.
        what: String,
    },
}

impl InvalidSetting {
    /// The name of the field at fault.
    pub fn field(&self) -> &'static str {
        match self {
            Self::EdgeOffLattice { .. } | Self::Edge(_) | Self::EdgeNotFinite => "edge",
            Self::StepsPerUnit => "steps_per_unit",
            Self::Unit => "unit",
            Self::Density => "density",
            Self::Stock { .. } => "stock",
        }
    }

    /// The place of the fault in the settings: names and indices with slashes between.
    pub fn place(&self) -> String {
        match self {
            Self::Stock { corner, axis, .. } => format!("stock/{corner}/{axis}"),
            _ => self.field().to_owned(),
        }
    }
}

/// Checked settings of a scene: how user units and lattice steps correspond.
#[derive(Clone, PartialEq, Debug)]
pub struct Settings {
    edge: Edge,
    steps_per_unit: u32,
    unit: String,
    density: f64,
    anchor: Anchor,
    rounding: Rounding,
    stock: Option<Stock>,
}

/// Settings as they are answered and stored. Two settings are the same when these texts are.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SettingsDocument {
    /// Edge of every cube, in user units: a whole number of steps.
    #[schema(example = 6.0)]
    pub edge: f64,
    /// Lattice steps in a user unit.
    #[schema(example = 1000, minimum = 1, maximum = 1_000_000_000)]
    pub steps_per_unit: u32,
    /// Label of the user unit.
    #[schema(example = "mm", max_length = 32)]
    pub unit: String,
    /// Mass of a cubic user unit.
    #[schema(example = 1.0)]
    pub density: f64,
    /// What `at` names: the lower corner of a cube or its centre.
    pub anchor: Anchor,
    /// What becomes of a coordinate between two steps: the nearest step (halves away from zero), or refused.
    pub rounding: Rounding,
    /// The block of material that is cut, in user units; left out when there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stock: Option<StockDocument>,
}

/// Why a coordinate of `at` is refused.
#[derive(Clone, Copy, PartialEq, Debug, thiserror::Error)]
pub enum InvalidCoordinate {
    /// NaN or infinite.
    #[error("is not a finite number")]
    NotFinite,
    /// Between two steps, under [`Rounding::Reject`].
    #[error("puts the lower corner at {steps} steps, which is off the lattice")]
    OffLattice {
        /// Where the lower corner would be, in steps.
        steps: f64,
    },
    /// A corner of the cube would lie too far out.
    #[error("puts a corner of the cube outside -{limit} to {limit}")]
    OutOfRange {
        /// The farthest coordinate, in user units.
        limit: f64,
    },
}

impl Settings {
    /// Checks what is wanted.
    /// # Errors
    /// Every field at fault, in the order of the fields.
    pub fn check(wanted: WantedSettings) -> Result<Self, Vec<InvalidSetting>> {
        let mut faults = vec![];
        let steps_per_unit = whole(wanted.steps_per_unit)
            .and_then(|steps| u32::try_from(steps).ok())
            .filter(|steps| (1..=STEPS_PER_UNIT_MAX).contains(steps));
        // Without a scale nothing can be said about an edge, except that it is no number.
        let edge = match steps_per_unit {
            _ if !wanted.edge.is_finite() => Err(InvalidSetting::EdgeNotFinite),
            None => Err(InvalidSetting::StepsPerUnit),
            Some(steps_per_unit) => edge_steps(wanted.edge, steps_per_unit),
        };
        let edge = edge.map_err(|fault| faults.push(fault));
        if steps_per_unit.is_none() && !faults.contains(&InvalidSetting::StepsPerUnit) {
            faults.push(InvalidSetting::StepsPerUnit);
        }
        if !(1..=UNIT_BYTES_MAX).contains(&wanted.unit.len())
            || wanted.unit.chars().any(char::is_control)
        {
            faults.push(InvalidSetting::Unit);
        }
        if !(wanted.density > 0.0 && wanted.density <= DENSITY_MAX) {
            faults.push(InvalidSetting::Density);
        }
        match (edge, steps_per_unit) {
            (Ok(edge), Some(steps_per_unit)) if faults.is_empty() => {
                let mut settings = Self {
                    edge,
                    steps_per_unit,
                    unit: wanted.unit,
                    density: wanted.density,
                    anchor: wanted.anchor,
                    rounding: wanted.rounding,
                    stock: None,
                };
                settings.stock = wanted
                    .stock
                    .map(|stock| settings.stock_steps(&stock))
                    .transpose()?;
                Ok(settings)
            }
            _ => Err(faults),
        }
    }

    /// The lattice box of a stock in user units.
    fn stock_steps(&self, stock: &StockDocument) -> Result<Stock, Vec<InvalidSetting>> {
        let mut faults = Vec::new();
        let mut corner = |name: &'static str, from: [f64; 3]| {
            let mut steps = [0; 3];
            for axis in 0..3 {
                let product = from[axis] * f64::from(self.steps_per_unit);
                let fits = |steps: &i64| steps.abs() <= i64::from(COORDINATE_MAX);
                let what = match self.round(product, product) {
                    Ok(whole) if fits(&whole) => {
                        steps[axis] = whole;
                        continue;
                    }
                    Err(InvalidCoordinate::OffLattice { steps }) => {
                        format!("is {steps} steps, which is off the lattice")
                    }
                    Err(InvalidCoordinate::NotFinite) if !product.is_finite() => {
                        "is not a finite number".to_owned()
                    }
                    Ok(_) | Err(_) => {
                        let limit = self.user(i64::from(COORDINATE_MAX));
                        format!("is outside -{limit} to {limit}")
                    }
                };
                faults.push(InvalidSetting::Stock {
                    corner: name,
                    axis,
                    what,
                });
            }
            steps
        };
        let (min, max) = (corner("min", stock.min), corner("max", stock.max));
        if faults.is_empty() {
            for axis in (0..3).filter(|&axis| min[axis] >= max[axis]) {
                faults.push(InvalidSetting::Stock {
                    corner: "max",
                    axis,
                    what: "is not above the least corner's".to_owned(),
                });
            }
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        Ok(Stock::new(min, max).expect("both corners were checked"))
    }

    /// Reads settings back from the text that [`Settings::text`] made; none when it is not such a text.
    pub fn from_text(text: &str) -> Option<Self> {
        let document: SettingsDocument = serde_json::from_str(text).ok()?;
        Self::check(WantedSettings {
            edge: document.edge,
            steps_per_unit: f64::from(document.steps_per_unit),
            unit: document.unit,
            density: document.density,
            anchor: document.anchor,
            rounding: document.rounding,
            stock: document.stock,
        })
        .ok()
    }

    /// The one text of these settings: equal settings have equal texts.
    pub fn text(&self) -> String {
        serde_json::to_string(&self.document()).expect("numbers, strings and names are JSON")
    }

    /// The settings as they are answered.
    pub fn document(&self) -> SettingsDocument {
        SettingsDocument {
            edge: self.user(i64::from(self.edge.steps())),
            steps_per_unit: self.steps_per_unit,
            unit: self.unit.clone(),
            density: self.density,
            anchor: self.anchor,
            rounding: self.rounding,
            stock: self.stock.map(|stock| StockDocument {
                min: self.point_user(stock.bounds().min),
                max: self.point_user(stock.bounds().max),
            }),
        }
    }

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

    /// A volume in user units. Units of `steps3`: steps cubed.
    pub fn volume_user(&self, steps3: i128) -> f64 {
        float(steps3) / self.scale(3)
    }

    /// An area in user units. Units of `steps2`: steps squared.
    pub fn area_user(&self, steps2: i128) -> f64 {
        float(steps2) / self.scale(2)
    }

    /// Label of the user unit.
    pub fn unit(&self) -> &str {
        &self.unit
    }

    /// The place of the cube that a client puts `at`, in user units.
    /// # Errors
    /// The first axis at fault, with what is wrong.
    pub fn place(&self, at: [f64; 3]) -> Result<Place, (usize, InvalidCoordinate)> {
        let mut corner = [0; 3];
        for axis in 0..3 {
            corner[axis] = self
                .corner_steps(at[axis])
                .map_err(|invalid| (axis, invalid))?;
        }
        Place::new(corner, self.edge)
            .map_err(|InvalidCube { axis, .. }| (axis, self.out_of_range()))
    }

    /// What is wrong with one coordinate of an `at`, if anything.
    pub fn coordinate_fault(&self, at: f64) -> Option<InvalidCoordinate> {
        match self.corner_steps(at) {
            Ok(steps) => match Place::new([steps, 0, 0], self.edge) {
                Ok(_) => None,
                Err(InvalidCube { .. }) => Some(self.out_of_range()),
            },
            Err(invalid) => Some(invalid),
        }
    }

    /// Where a client is told that a cube is. Units: user units.
    pub fn at(&self, place: Place) -> [f64; 3] {
        place.corner().map(|corner| match self.anchor {
            Anchor::Corner => self.user(i64::from(corner)),
            // Twice the centre is a whole number of steps, half of it may not be.
            Anchor::Center => self.user(2 * i64::from(corner) + i64::from(self.edge.steps())) / 2.0,
        })
    }

    /// The lattice point of a point in user units. Points beyond every cube are drawn in to just outside their range.
    /// # Errors
    /// The first axis at fault, with what is wrong.
    pub fn point(&self, at: [f64; 3]) -> Result<[i32; 3], (usize, InvalidCoordinate)> {
        let mut point = [0; 3];
        for axis in 0..3 {
            let far = f64::from(COORDINATE_MAX) + 1.0;
            let steps = (at[axis] * f64::from(self.steps_per_unit)).clamp(-far, far);
            let steps = self
                .round(steps, steps)
                .map_err(|invalid| (axis, invalid))?;
            point[axis] = i32::try_from(steps).expect("2^30 + 1 fits");
        }
        Ok(point)
    }

    /// A lattice point in user units.
    pub fn point_user(&self, point: [i32; 3]) -> [f64; 3] {
        point.map(|steps| self.user(i64::from(steps)))
    }

    /// The lower corner's coordinate for one coordinate of `at`. Units: steps. Its range is not checked yet.
    fn corner_steps(&self, at: f64) -> Result<i64, InvalidCoordinate> {
        let product = at * f64::from(self.steps_per_unit);
        let corner = match self.anchor {
            Anchor::Corner => product,
            Anchor::Center => product - f64::from(self.edge.steps()) / 2.0,
        };
        if product.is_finite() && corner.abs() > 4.0 * f64::from(COORDINATE_MAX) {
            return Err(self.out_of_range());
        }
        self.round(corner, product)
    }

    /// The whole number of steps for `steps`, which was computed from `product`.
    fn round(&self, steps: f64, product: f64) -> Result<i64, InvalidCoordinate> {
        // The decimal 0.0145 times 1000 is a half in the client's eyes, though not in floats: what reading and multiplying can have
        // lost is given back, so that halves go away from zero as promised. At 2^30 steps that is below a millionth of a step.
        let lost = product.abs() * 4.0 * f64::EPSILON;
        let rounded = (steps.abs() + lost).round().copysign(steps);
        match self.rounding {
            Rounding::Reject if (steps - rounded).abs() > OFF_LATTICE_MAX => {
                Err(InvalidCoordinate::OffLattice { steps })
            }
            _ => whole(rounded).ok_or(InvalidCoordinate::NotFinite),
        }
    }

    fn out_of_range(&self) -> InvalidCoordinate {
        InvalidCoordinate::OutOfRange {
            limit: self.user(i64::from(COORDINATE_MAX)),
        }
    }

    /// A length in user units.
    fn user(&self, steps: i64) -> f64 {
        float(i128::from(steps)) / f64::from(self.steps_per_unit)
    }

    /// `steps_per_unit` to a power: exact up to 2^53, else within a few units in the last place.
    fn scale(&self, power: usize) -> f64 {
        std::iter::repeat_n(f64::from(self.steps_per_unit), power).product()
    }
}

fn edge_steps(edge: f64, steps_per_unit: u32) -> Result<Edge, InvalidSetting> {
    let steps = edge * f64::from(steps_per_unit);
    // Beyond this no fraction survives in a float, and no edge is valid: say "too large", not "off the lattice".
    let near = steps.clamp(-1e15, 1e15).round();
    if steps.abs() < 1e15 && (steps - near).abs() > OFF_LATTICE_MAX {
        return Err(InvalidSetting::EdgeOffLattice {
            edge,
            steps,
            steps_per_unit,
        });
    }
    Ok(Edge::new(whole(near).unwrap_or(i64::MAX))?)
}

/// The whole number that a float is; none for fractions, NaN, and beyond 2^53.
fn whole(number: f64) -> Option<i64> {
    const EXACT_MAX: f64 = 9_007_199_254_740_992.0;
    if !(number.abs() <= EXACT_MAX && number.fract() == 0.0) {
        return None;
    }
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a whole number of at most 2^53"
    )]
    let integer = number as i64;
    Some(integer)
}

/// The float nearest to an integer.
#[expect(
    clippy::cast_precision_loss,
    reason = "floats are for people; `exact` has the integers"
)]
fn float(integer: i128) -> f64 {
    integer as f64
}

/// The float nearest to an integer of 256 bits.
fn float256(integer: I256) -> f64 {
    const KEPT_BITS: u32 = 100;
    if let Ok(narrow) = i128::try_from(integer) {
        return float(narrow);
    }
    let magnitude = integer.unsigned_abs();
    let shift = 256 - magnitude.leading_zeros() - KEPT_BITS;
    let kept = magnitude >> shift;
    // A lost bit only matters for a tie, 47 bits further up: it is enough to know whether there was one.
    let lost = i128::from(kept << shift != magnitude);
    let kept = i128::try_from(kept).expect("100 bits fit") | lost;
    let size = float(kept) * 2f64.powi(shift.cast_signed());
    if integer < I256::ZERO { -size } else { size }
}

/// A quotient of integers as a float, right to the last place or two however large both are. The divisor is positive.
fn ratio(dividend: I256, divisor: I256) -> f64 {
    float256(dividend / divisor) + float256(dividend % divisor) / float256(divisor)
}

/// Lengths of the union's edges, in user units, each edge counted once as a set of points.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, ToSchema)]
pub struct EdgeLength {
    /// All edges.
    pub total: f64,
    /// Edges with one of four octants filled.
    pub convex: f64,
    /// Edges with three filled.
    pub concave: f64,
    /// Edges along which two solids meet.
    pub crossing: f64,
}

/// Lengths of the union's edges as decimal integers, in steps.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, ToSchema)]
pub struct ExactEdgeLength {
    /// All edges.
    pub total: String,
    /// Edges with one of four octants filled.
    pub convex: String,
    /// Edges with three filled.
    pub concave: String,
    /// Edges along which two solids meet.
    pub crossing: String,
}

/// The box around all cubes, in user units.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, ToSchema)]
pub struct UserBounds {
    /// Least corner.
    pub min: [f64; 3],
    /// Greatest corner.
    pub max: [f64; 3],
}

/// Vertices of the union, by kind.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, ToSchema)]
pub struct Vertices {
    /// All.
    pub total: i64,
    /// A cube's own corners.
    pub corner: i64,
    /// Where an edge goes through a face.
    pub edge_face: i64,
    /// Where three faces meet.
    pub three_face: i64,
    /// Where features coincide.
    pub degenerate: i64,
}

/// The exact integers, as decimal strings, in lattice steps. Moments are about the lattice origin.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, ToSchema)]
pub struct Exact {
    /// Lattice steps in a user unit.
    #[schema(example = "1000")]
    pub steps_per_unit: String,
    /// Volume, in steps cubed.
    #[schema(example = "216000000000")]
    pub volume: String,
    /// Area, in steps squared.
    pub area: String,
    /// Area of the faces whose normal is along x, y, z.
    pub area_by_axis: [String; 3],
    /// Edge lengths, in steps.
    pub edge_length: ExactEdgeLength,
    /// Twice the integrals of x, y, z.
    pub first_moments2: [String; 3],
    /// Three times the integrals of x^2, y^2, z^2.
    pub second_moments3: [String; 3],
    /// Four times the integrals of xy, yz, zx.
    pub product_moments4: [String; 3],
}

/// The mass properties of a union of cubes: floats in user units for people, and the exact integers for machines.
#[derive(Clone, PartialEq, Debug, Serialize, ToSchema)]
pub struct MassProperties {
    /// The scene; null where there is none.
    #[schema(example = "pocket")]
    pub scene: Option<String>,
    /// The change they are as of; null where there is none.
    #[schema(example = 5)]
    pub seq: Option<u64>,
    /// Number of cubes, two at one place counted twice.
    pub cubes: u64,
    /// Volume, in user units cubed.
    pub volume: f64,
    /// Area, in user units squared.
    pub area: f64,
    /// Lengths of the edges, in user units.
    pub edge_length: EdgeLength,
    /// Density times volume.
    pub mass: f64,
    /// Integral of the mean curvature, in user units.
    pub mean_curvature: f64,
    /// Centre of mass, in user units; null when there is no cube.
    pub centroid: Option<[f64; 3]>,
    /// Inertia tensor about the centroid, in mass times user units squared.
    pub inertia: [[f64; 3]; 3],
    /// The box around all cubes; null when there is no cube.
    pub bounds: Option<UserBounds>,
    /// Pieces minus tunnels plus cavities of the closed set.
    pub euler_characteristic: i64,
    /// Number of vertices, by kind.
    pub vertices: Vertices,
    /// The exact integers.
    pub exact: Exact,
    /// The union inside the stock; left out where there is no stock.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub removed: Option<PartProperties>,
    /// The stock outside the union; left out where there is no stock.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub remaining: Option<PartProperties>,
}

/// The mass properties of a part of the stock.
#[derive(Clone, PartialEq, Debug, Serialize, ToSchema)]
pub struct PartProperties {
    /// Volume, in user units cubed.
    pub volume: f64,
    /// Area, in user units squared.
    pub area: f64,
    /// Lengths of the edges, in user units.
    pub edge_length: EdgeLength,
    /// Density times volume.
    pub mass: f64,
    /// Integral of the mean curvature, in user units.
    pub mean_curvature: f64,
    /// Centre of mass, in user units; null when the part is empty.
    pub centroid: Option<[f64; 3]>,
    /// Inertia tensor about the centroid, in mass times user units squared.
    pub inertia: [[f64; 3]; 3],
    /// Pieces minus tunnels plus cavities of the closed set.
    pub euler_characteristic: i64,
    /// Number of vertices, by kind.
    pub vertices: Vertices,
    /// The exact integers.
    pub exact: Exact,
}

/// The mass properties as every answer and every command shows them.
pub fn mass_properties(
    scene: Option<&str>,
    seq: Option<u64>,
    totals: &Totals,
    settings: &Settings,
) -> MassProperties {
    let PartProperties {
        volume,
        area,
        edge_length,
        mass,
        mean_curvature,
        centroid,
        inertia,
        euler_characteristic,
        vertices,
        exact,
    } = part_properties(&totals.measures, settings);
    let stock = totals.stock.as_ref();
    MassProperties {
        scene: scene.map(str::to_owned),
        seq,
        cubes: totals.cubes,
        volume,
        area,
        edge_length,
        mass,
        mean_curvature,
        centroid,
        inertia,
        bounds: totals.bounds.map(|Bounds { min, max }| UserBounds {
            min: settings.point_user(min),
            max: settings.point_user(max),
        }),
        euler_characteristic,
        vertices,
        exact,
        removed: stock.map(|stock| part_properties(&stock.removed, settings)),
        remaining: stock.map(|stock| part_properties(&stock.remaining, settings)),
    }
}

fn part_properties(measures: &Measures, settings: &Settings) -> PartProperties {
    let volume = settings.volume_user(measures.volume);
    let length = |steps: i128| float(steps) / settings.scale(1);
    let [convex, concave, crossing] = [EdgeKind::Convex, EdgeKind::Concave, EdgeKind::Crossing]
        .map(|kind| measures.edge_length_of(kind));
    PartProperties {
        volume,
        area: settings.area_user(measures.area()),
        edge_length: EdgeLength {
            total: length(measures.edge_length_total()),
            convex: length(convex),
            concave: length(concave),
            crossing: length(crossing),
        },
        mass: settings.density * volume,
        mean_curvature: std::f64::consts::FRAC_PI_4 * length(convex - concave - 2 * crossing),
        centroid: (measures.volume > 0).then(|| centroid(measures, settings)),
        inertia: inertia(measures, settings),
        euler_characteristic: measures.euler_characteristic(),
        vertices: Vertices {
            total: measures.vertices_total(),
            corner: measures.vertices_of(VertexKind::Corner),
            edge_face: measures.vertices_of(VertexKind::EdgeFace),
            three_face: measures.vertices_of(VertexKind::ThreeFace),
            degenerate: measures.vertices_of(VertexKind::Degenerate),
        },
        exact: Exact {
            steps_per_unit: settings.steps_per_unit.to_string(),
            volume: measures.volume.to_string(),
            area: measures.area().to_string(),
            area_by_axis: measures.area_by_axis.map(|area| area.to_string()),
            edge_length: ExactEdgeLength {
                total: measures.edge_length_total().to_string(),
                convex: convex.to_string(),
                concave: concave.to_string(),
                crossing: crossing.to_string(),
            },
            first_moments2: measures.first_moments2.map(|moment| moment.to_string()),
            second_moments3: measures.second_moments3.map(|moment| moment.to_string()),
            product_moments4: measures.product_moments4.map(|moment| moment.to_string()),
        },
    }
}

/// Longest machine time of a change. Units: seconds.
pub const DURATION_SECONDS_MAX: f64 = 1e9;

/// Machine time in whole nanoseconds.
/// # Errors
/// What is wrong with it.
pub fn duration_ns(seconds: f64) -> Result<u64, &'static str> {
    Some(seconds)
        .filter(|seconds| (0.0..=DURATION_SECONDS_MAX).contains(seconds))
        .and_then(|seconds| Duration::try_from_secs_f64(seconds).ok())
        .and_then(|duration| u64::try_from(duration.as_nanos()).ok())
        .ok_or("is not a number of seconds from 0 to 1e9")
}

/// Volume removed in a second; none without a duration above 0.
pub fn removal_rate(volume_removed: f64, duration: Option<f64>) -> Option<f64> {
    duration
        .filter(|seconds| *seconds > 0.0)
        .map(|seconds| volume_removed / seconds)
}

/// Seconds of so many nanoseconds.
pub fn duration_user(nanoseconds: u64) -> f64 {
    Duration::from_nanos(nanoseconds).as_secs_f64()
}

/// What a change took away, and how fast.
#[derive(Clone, PartialEq, Debug)]
pub struct Removal {
    /// Machine time, in seconds; none when none was given.
    pub duration: Option<f64>,
    /// Volume removed from the stock, or added to the union where there is no stock, in user units cubed.
    pub volume: f64,
    /// The same in steps cubed, exact.
    pub exact: String,
    /// Volume removed in a second of machine time; none without a duration above 0.
    pub rate: Option<f64>,
}

/// What a change took away, in `duration_ns` of machine time and steps cubed.
pub fn removal(duration_ns: Option<u64>, steps3: i128, settings: &Settings) -> Removal {
    let duration = duration_ns.map(duration_user);
    let volume = settings.volume_user(steps3);
    Removal {
        duration,
        volume,
        exact: steps3.to_string(),
        rate: removal_rate(volume, duration),
    }
}

/// Centre of mass of a set that is not empty, in user units.
fn centroid(measures: &Measures, settings: &Settings) -> [f64; 3] {
    let volume2 = I256::from(2 * measures.volume);
    measures
        .first_moments2
        .map(|moment| ratio(I256::from(moment), volume2) / settings.scale(1))
}

// The proof that the integers of `inertia` fit I256: with |x| <= 2^30 and V <= 2^93, a second moment times three is at most
// 3 * 2^153 and twice a first moment at most 2^124, so that 4 V (B + B) and 3 (A A + A A) are each at most 24 * 2^246.
const _: () = assert!(COORDINATE_MAX.ilog2() == 30 && 246 + 24u32.ilog2() + 1 < 255);

/// Inertia tensor about the centroid, in mass times user units squared.
///
/// With V the volume, A twice the first, B three times the second and P four times the product moments, the central moments are
/// (4 V B - 3 A A) / 12 V and (V P - A A') / 4 V. The numerators are exact, so that a scene far from the origin loses nothing.
fn inertia(measures: &Measures, settings: &Settings) -> [[f64; 3]; 3] {
    if measures.volume == 0 {
        return [[0.0; 3]; 3];
    }
    let volume = I256::from(measures.volume);
    let first = measures.first_moments2.map(I256::from);
    let second = measures.second_moments3;
    let unit = settings.density / settings.scale(5);
    let mut tensor = [[0.0; 3]; 3];
    for axis in 0..3 {
        let (one, two) = ((axis + 1) % 3, (axis + 2) % 3);
        let around = 4 * volume * (second[one] + second[two])
            - 3 * (first[one] * first[one] + first[two] * first[two]);
        tensor[axis][axis] = ratio(around, 12 * volume) * unit;
        // Products are kept in the order xy, yz, zx: that of `axis` and the next one. The sign is turned in integers: no -0.0.
        let product = first[axis] * first[one] - volume * measures.product_moments4[axis];
        let product = ratio(product, 4 * volume) * unit;
        tensor[axis][one] = product;
        tensor[one][axis] = product;
    }
    tensor
}

/// A time in ms since 1970 as RFC 3339 writes it, in UTC.
pub fn rfc3339(at_ms: u64) -> String {
    let (seconds, ms) = (at_ms / 1000, at_ms % 1000);
    let (minutes, second) = (seconds / 60, seconds % 60);
    let (hours, minute) = (minutes / 60, minutes % 60);
    let (days, hour) = (hours / 24, hours % 24);
    // Years that begin in March end with the leap day. Days are counted from 0000-03-01, 719,468 days before 1970-01-01.
    let days = days + 719_468;
    let (era, day) = (days / 146_097, days % 146_097);
    let year = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let (month, carry) = if month < 10 {
        (month + 3, 0)
    } else {
        (month - 9, 1)
    };
    let year = 400 * era + year + carry;
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{ms:03}Z")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::recount;

    fn settings(edge: f64, steps_per_unit: u32) -> Settings {
        Settings::check(WantedSettings {
            steps_per_unit: f64::from(steps_per_unit),
            ..WantedSettings::with_edge(edge)
        })
        .expect("these settings are good")
    }

    fn properties(settings: &Settings, corners: &[[i64; 3]]) -> MassProperties {
        let places = corners
            .iter()
            .map(|corner| Place::new(*corner, settings.edge()).unwrap());
        mass_properties(
            None,
            None,
            &recount(settings.edge(), None, places),
            settings,
        )
    }

    #[track_caller]
    fn check_rounding(settings: &Settings, at: f64, corner: i32) {
        let place = settings.place([at, 0.0, 0.0]).unwrap();
        assert_eq!(place.corner()[0], corner, "{at}");
    }

    #[test]
    fn halves_go_away_from_zero() {
        let settings = settings(6.0, 1000);
        for (at, corner) in [
            (0.0, 0),
            (0.0004, 0),
            (0.0005, 1),
            (-0.0005, -1),
            (0.0015, 2),
            (0.0025, 3),
            (-0.0025, -3),
            (0.000_499_999, 0),
            (1.0005, 1001),
            (0.0145, 15),
            (1.0245, 1025),
            (1_000_000.000_5, 1_000_000_001),
            (1_000_000.000_499, 1_000_000_000),
        ] {
            check_rounding(&settings, at, corner);
        }
        // Every half that a decimal of four places can say, near the origin and far away.
        for steps in (0..20_000).chain(1_000_000_000..1_000_001_000) {
            let decimal = format!("{}.{:03}5", steps / 1000, steps % 1000);
            check_rounding(&settings, decimal.parse().unwrap(), steps + 1);
            check_rounding(&settings, -decimal.parse::<f64>().unwrap(), -steps - 1);
        }
    }

    #[test]
    fn of_a_centre_the_lower_corner_is_rounded() {
        let settings = Settings::check(WantedSettings {
            anchor: Anchor::Center,
            steps_per_unit: 1.0,
            ..WantedSettings::with_edge(3.0)
        })
        .unwrap();
        for (at, corner) in [
            (1.5, 0),
            (0.0, -2),
            (2.0, 1),
            (1.4, 0),
            (-1.0, -3),
            (3.0, 2),
        ] {
            check_rounding(&settings, at, corner);
        }
    }

    #[test]
    fn places_come_back_as_they_went() {
        let corners = [0, 1, -1, 7, 333_333, -999_999_999, 1_000_000_001, 1 << 29];
        for steps_per_unit in [1, 3, 7, 10, 1000, 25_400, STEPS_PER_UNIT_MAX] {
            for anchor in [Anchor::Corner, Anchor::Center] {
                for edge in [1, 2, 4001] {
                    let settings = Settings::check(WantedSettings {
                        steps_per_unit: f64::from(steps_per_unit),
                        anchor,
                        rounding: Rounding::Reject,
                        ..WantedSettings::with_edge(f64::from(edge) / f64::from(steps_per_unit))
                    })
                    .unwrap();
                    assert_eq!(settings.edge().steps(), edge);
                    for corner in corners {
                        let place = Place::new([corner; 3], settings.edge()).unwrap();
                        assert_eq!(
                            settings.place(settings.at(place)),
                            Ok(place),
                            "{settings:?}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn off_the_lattice_is_refused_when_asked() {
        let settings = Settings::check(WantedSettings {
            rounding: Rounding::Reject,
            ..WantedSettings::with_edge(6.0)
        })
        .unwrap();
        assert!(settings.place([0.1, 0.2, 0.3]).is_ok());
        assert!(settings.place([0.000_000_000_5, 0.0, 0.0]).is_ok());
        let refused = settings.place([0.0, 0.0, 0.000_1]).unwrap_err();
        assert_eq!(refused, (2, InvalidCoordinate::OffLattice { steps: 0.1 }));
        let refused = settings.place([0.0, f64::NAN, 0.0]).unwrap_err();
        assert_eq!(refused, (1, InvalidCoordinate::NotFinite));
        for far in [1_073_741.0, -1_073_741.825, 1e12, -1e300] {
            let (axis, fault) = settings.place([far, 0.0, 0.0]).unwrap_err();
            let fault = fault.to_string();
            assert_eq!(axis, 0);
            assert_eq!(
                fault,
                "puts a corner of the cube outside -1073741.824 to 1073741.824"
            );
        }
    }

    #[test]
    fn settings_are_checked_field_by_field() {
        let faults = |wanted: WantedSettings| match Settings::check(wanted) {
            Ok(_) => vec![],
            Err(faults) => faults.iter().map(InvalidSetting::field).collect(),
        };
        let wanted = |edge, steps_per_unit| WantedSettings {
            steps_per_unit,
            ..WantedSettings::with_edge(edge)
        };
        assert_eq!(faults(wanted(3.175, 1000.0)), [""; 0]);
        assert_eq!(faults(wanted(0.1, 3.0)), ["edge"]);
        assert_eq!(faults(wanted(1.0 / 3.0, 3.0)), [""; 0]);
        assert_eq!(faults(wanted(0.0, 1000.0)), ["edge"]);
        assert_eq!(faults(wanted(-6.0, 1000.0)), ["edge"]);
        assert_eq!(faults(wanted(16_777.216, 1000.0)), [""; 0]);
        assert_eq!(faults(wanted(16_777.217, 1000.0)), ["edge"]);
        assert_eq!(faults(wanted(1e300, 1000.0)), ["edge"]);
        assert_eq!(faults(wanted(f64::INFINITY, 1000.0)), ["edge"]);
        assert_eq!(faults(wanted(1.0, 0.0)), ["steps_per_unit"]);
        assert_eq!(faults(wanted(1.0, 1.5)), ["steps_per_unit"]);
        assert_eq!(faults(wanted(1.0, 1e10)), ["steps_per_unit"]);
        let all = WantedSettings {
            unit: String::new(),
            density: 0.0,
            ..wanted(f64::NAN, -1.0)
        };
        assert_eq!(faults(all), ["edge", "steps_per_unit", "unit", "density"]);
    }

    #[test]
    fn settings_have_one_text() {
        let text = settings(3.175, 1000).text();
        let expected = r#"{"edge":3.175,"steps_per_unit":1000,"unit":"mm","density":1.0,"anchor":"corner","rounding":"nearest"}"#;
        assert_eq!(text, expected);
        assert_eq!(Settings::from_text(&text), Some(settings(3.175, 1000)));
        // What rounds to the same steps is the same edge.
        assert_eq!(settings(3.175_000_000_000_1, 1000).text(), text);
    }

    #[test]
    fn one_cube_has_the_properties_of_the_textbook() {
        let shown = properties(&settings(6.0, 1000), &[[0, 0, 2500]]);
        assert_eq!(shown.volume, 216.0);
        assert_eq!(shown.area, 216.0);
        assert_eq!(shown.edge_length.total, 72.0);
        assert_eq!(shown.mass, 216.0);
        assert_eq!(shown.mean_curvature, std::f64::consts::FRAC_PI_4 * 72.0);
        assert_eq!(shown.centroid, Some([3.0, 3.0, 5.5]));
        assert_eq!(
            shown.inertia,
            [[1296.0, 0.0, 0.0], [0.0, 1296.0, 0.0], [0.0, 0.0, 1296.0]]
        );
        let bounds = shown.bounds.unwrap();
        assert_eq!((bounds.min, bounds.max), ([0.0, 0.0, 2.5], [6.0, 6.0, 8.5]));
        assert_eq!(shown.vertices.corner, 8);
        assert_eq!(shown.exact.volume, "216000000000");
        assert_eq!(
            shown.exact.area_by_axis,
            ["72000000", "72000000", "72000000"]
        );
        assert_eq!(shown.exact.edge_length.total, "72000");
        let text = serde_json::to_string(&shown).unwrap();
        assert!(!text.contains("-0.0"), "{text}");
    }

    #[test]
    fn nothing_has_neither_centre_nor_bounds() {
        let shown = serde_json::to_value(properties(&settings(6.0, 1000), &[])).unwrap();
        assert_eq!(shown["centroid"], serde_json::Value::Null);
        assert_eq!(shown["bounds"], serde_json::Value::Null);
        assert_eq!(
            shown["inertia"],
            serde_json::json!([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        );
        assert_eq!(shown["volume"], 0.0);
        assert_eq!(
            shown["exact"]["second_moments3"],
            serde_json::json!(["0", "0", "0"])
        );
    }

    /// In floats the inertia of this far cube would be lost altogether: 10^18 steps squared against 10^0.
    #[test]
    fn inertia_does_not_depend_on_where_the_part_is() {
        let settings = settings(0.003, 1000);
        let part = [[0, 0, 0], [2, 1, 0], [1, 5, 9], [40, -7, 2]];
        let near = properties(&settings, &part);
        for far in [
            [1_000_000_000, 0, 0],
            [1_000_000_000, -1_000_000_000, 999_999_937],
            [-1_073_741_000, 1_073_741_000, -1_073_741_000],
        ] {
            let moved = part.map(|[x, y, z]| [x + far[0], y + far[1], z + far[2]]);
            let far = properties(&settings, &moved);
            for (far, near) in far
                .inertia
                .iter()
                .flatten()
                .zip(near.inertia.iter().flatten())
            {
                assert!((far / near - 1.0).abs() < 1e-12, "{far} {near}");
            }
        }
        let one = properties(&settings, &[[1_000_000_000; 3]]);
        let expected = 0.003f64.powi(5) / 6.0;
        for (axis, row) in one.inertia.iter().enumerate() {
            for (other, value) in row.iter().enumerate() {
                if axis == other {
                    assert!((value / expected - 1.0).abs() < 1e-12, "{value}");
                } else {
                    assert_eq!(*value, 0.0);
                }
            }
        }
    }

    /// Products of inertia against an independent sum over small cubes.
    #[test]
    fn products_of_inertia_have_their_places_and_signs() {
        let settings = settings(1.0, 1);
        // Two cubes apart: m = 1 each, at offsets +-(1, 2, 4.5) from the common centre.
        let shown = properties(&settings, &[[0, 0, 0], [2, 4, 9]]);
        let (x, y, z) = (1.0, 2.0, 4.5);
        let own = 2.0 / 6.0;
        let expected = [
            [own + 2.0 * (y * y + z * z), -2.0 * x * y, -2.0 * z * x],
            [-2.0 * x * y, own + 2.0 * (z * z + x * x), -2.0 * y * z],
            [-2.0 * z * x, -2.0 * y * z, own + 2.0 * (x * x + y * y)],
        ];
        for (value, expected) in shown
            .inertia
            .iter()
            .flatten()
            .zip(expected.iter().flatten())
        {
            assert!((value - expected).abs() < 1e-12, "{:?}", shown.inertia);
        }
    }

    #[test]
    fn wide_integers_become_the_nearest_float() {
        let two = |power: u32| I256::new(1) << power;
        assert_eq!(float256(two(200)), 2f64.powi(200));
        assert_eq!(float256(-two(254)), -2f64.powi(254));
        // A tie goes to even; a single lost bit far below decides it the other way.
        let tie = two(200) + two(147);
        assert_eq!(float256(tie), 2f64.powi(200));
        assert_eq!(float256(tie + 1), 2f64.powi(200) + 2f64.powi(148));
        assert_eq!(float256(I256::new(i128::MIN)), -2f64.powi(127));
        assert_eq!(ratio(I256::new(-7), I256::new(2)), -3.5);
        assert_eq!(ratio(3 * two(200) + 1, two(201)), 1.5);
    }

    #[test]
    fn times_are_written_as_rfc_3339() {
        for (at_ms, text) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_399_999, "2000-02-28T23:59:59.999Z"),
            (951_782_400_000, "2000-02-29T00:00:00.000Z"),
            (951_868_800_000, "2000-03-01T00:00:00.000Z"),
            (1_735_689_599_000, "2024-12-31T23:59:59.000Z"),
            (4_102_444_800_007, "2100-01-01T00:00:00.007Z"),
            (4_107_542_400_000, "2100-03-01T00:00:00.000Z"),
        ] {
            assert_eq!(rfc3339(at_ms), text);
        }
    }
}
