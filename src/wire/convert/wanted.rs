//! The settings of a scene as they are sent, answered and stored, and how they are checked.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use utoipa::ToSchema;

use super::numbers::{OFF_LATTICE_MAX, whole};
use super::settings::{Anchor, Rounding, Settings};
use super::units::InvalidCoordinate;
use crate::geometry::{COORDINATE_MAX, Edge, InvalidEdge, Stock};
use crate::wire::objects::{objects_only, written};

/// Largest number of steps in a user unit.
pub const STEPS_PER_UNIT_MAX: u32 = 1_000_000_000;

/// Longest label of a unit, in bytes.
pub const UNIT_BYTES_MAX: usize = 32;

/// Largest density: with it no moment of the largest scene overflows a float.
pub const DENSITY_MAX: f64 = 1e200;

/// What a scene holds, for its life.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = SceneKind)]
pub enum KindName {
    /// Identical axis-aligned cubes.
    #[default]
    Cubes,
    /// Convex solids, and shapes of several of them.
    Solids,
}

/// Settings of a scene of cubes. As they are answered and stored they are complete; a client may leave out all but `edge`.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(remote = "Self", deny_unknown_fields)]
#[schema(as = Settings)]
pub struct SettingsDocument {
    /// What the scene holds: cubes. Not answered.
    #[serde(default, skip_serializing)]
    #[schema(default = "cubes")]
    pub kind: KindName,
    /// Edge of every cube: times `steps_per_unit` a whole number from 1 to 16,777,216. Units: user units.
    #[schema(example = 6.0, exclusive_minimum = 0)]
    pub edge: f64,
    /// Lattice steps in a user unit.
    #[serde(default = "default_steps", serialize_with = "as_whole")]
    #[schema(value_type = u32, default = 1000, example = 1000, minimum = 1, maximum = 1_000_000_000)]
    pub steps_per_unit: f64,
    /// Label of the user unit.
    #[serde(default = "default_unit")]
    #[schema(default = "mm", example = "mm", min_length = 1, max_length = 32)]
    pub unit: String,
    /// Mass of a cubic user unit.
    #[serde(default = "default_density")]
    #[schema(default = 1, example = 1.0, exclusive_minimum = 0, maximum = 1e200)]
    pub density: f64,
    /// What `at` names: the lower corner of a cube or its centre.
    #[serde(default)]
    #[schema(default = "corner")]
    pub anchor: Anchor,
    /// What becomes of a coordinate between two steps: the nearest step (halves away from zero), or refused.
    #[serde(default)]
    #[schema(default = "nearest")]
    pub rounding: Rounding,
    /// The block of material that the cubes are cut from, in user units: then the mass properties say what was removed and what remains.
    /// Left out, or null, when there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stock: Option<StockDocument>,
}

fn default_steps() -> f64 {
    1000.0
}

fn default_unit() -> String {
    "mm".to_owned()
}

fn default_density() -> f64 {
    1.0
}

/// Writes a whole number without a fraction.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "as serde calls it")]
fn as_whole<S: Serializer>(number: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    match whole(*number) {
        Some(integer) => serializer.serialize_i64(integer),
        None => serializer.serialize_f64(*number),
    }
}

impl SettingsDocument {
    /// The defaults, with this edge in user units.
    pub fn with_edge(edge: f64) -> Self {
        Self {
            kind: KindName::Cubes,
            edge,
            steps_per_unit: default_steps(),
            unit: default_unit(),
            density: default_density(),
            anchor: Anchor::default(),
            rounding: Rounding::default(),
            stock: None,
        }
    }
}

/// A block of material, in user units.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(remote = "Self", deny_unknown_fields)]
pub struct StockDocument {
    /// Least corner.
    #[schema(min_items = 3, max_items = 3, example = json!([0.0, 0.0, -10.0]))]
    pub min: [f64; 3],
    /// Greatest corner.
    #[schema(min_items = 3, max_items = 3, example = json!([80.0, 60.0, 0.0]))]
    pub max: [f64; 3],
}

objects_only!(SettingsDocument, StockDocument);
written!(SettingsDocument, StockDocument);

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

impl Settings {
    /// Checks what is wanted.
    /// # Errors
    /// Every field at fault, in the order of the fields.
    pub fn check(wanted: &SettingsDocument) -> Result<Self, Vec<InvalidSetting>> {
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
                    unit: wanted.unit.clone(),
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
        let document = serde_json::from_str(text).ok()?;
        Self::check(&document).ok()
    }

    /// The one text of these settings: equal settings have equal texts.
    pub fn text(&self) -> String {
        serde_json::to_string(&self.document()).expect("numbers, strings and names are JSON")
    }

    /// The settings as they are answered.
    pub fn document(&self) -> SettingsDocument {
        SettingsDocument {
            kind: KindName::Cubes,
            edge: self.user(i64::from(self.edge.steps())),
            steps_per_unit: self.steps_per_unit.into(),
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
