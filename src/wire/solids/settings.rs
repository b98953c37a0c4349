//! The settings of a scene of solids, as they are sent, answered and stored.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fmt;
use std::sync::Arc;

use serde::de::{Deserializer, Error, MapAccess, Visitor};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::documents::ShapeDocument;
use super::polygon_error::PolygonError;
use super::scale::Scale;
use super::shape::shape;
use super::stock::SolidStockDocument;
use crate::engine::solids::Stock;
use crate::geometry::convex::Deviation;
use crate::service::{NamedShape, SHAPES_MAX, Shapes};
use crate::wire::convert::{
    DENSITY_MAX, KindName, Rounding, STEPS_PER_UNIT_MAX, UNIT_BYTES_MAX, whole,
};
use crate::wire::objects::objects_only;
use crate::wire::problem::{Fault, Faults};

/// Longest name of a shape, in bytes.
const NAME_BYTES_MAX: usize = 63;

/// Settings of a scene of solids. A client may leave out all but `kind`.
#[derive(Clone, PartialEq, Debug, Deserialize, ToSchema)]
#[serde(remote = "Self", deny_unknown_fields)]
#[schema(as = SolidSettings)]
pub struct SolidSettingsDocument {
    /// What the scene holds.
    pub kind: KindName,
    /// Lattice steps in a user unit.
    #[serde(default = "default_steps")]
    #[schema(value_type = u32, default = 10_000, example = 10_000, minimum = 1, maximum = 1_000_000_000)]
    pub steps_per_unit: f64,
    /// Label of the user unit.
    #[serde(default = "default_unit")]
    #[schema(default = "mm", example = "mm", min_length = 1, max_length = 32)]
    pub unit: String,
    /// Mass of a cubic user unit.
    #[serde(default = "default_density")]
    #[schema(default = 1, example = 1.0, exclusive_minimum = 0, maximum = 1e200)]
    pub density: f64,
    /// What becomes of a coordinate between two steps: the nearest step (halves away from zero), or refused. Lengths of cutters must be whole
    /// numbers of steps anyway.
    #[serde(default)]
    #[schema(default = "nearest")]
    pub rounding: Rounding,
    /// The block of material that the solids are cut from, in user units: then the mass properties are those of what is removed, and say
    /// what remains.
    #[serde(default)]
    pub stock: Option<SolidStockDocument>,
    /// Shapes by their names, to begin with; at most 1,024.
    #[serde(default, deserialize_with = "each_name_once")]
    #[schema(example = json!({"t1": {"flat": {"diameter": 6, "length": 25}}}))]
    pub shapes: BTreeMap<String, ShapeDocument>,
}

/// Reads shapes by their names, and refuses a name that stands twice.
fn each_name_once<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<BTreeMap<String, ShapeDocument>, D::Error> {
    struct Read;
    impl<'de> Visitor<'de> for Read {
        type Value = BTreeMap<String, ShapeDocument>;
        fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
            formatter.write_str("shapes by their names")
        }
        fn visit_map<A: MapAccess<'de>>(self, mut named: A) -> Result<Self::Value, A::Error> {
            let mut shapes = BTreeMap::new();
            while let Some(name) = named.next_key()? {
                match shapes.entry(name) {
                    Entry::Vacant(vacant) => vacant.insert(named.next_value()?),
                    Entry::Occupied(_) => return Err(A::Error::custom("a name stands twice")),
                };
            }
            Ok(shapes)
        }
    }
    deserializer.deserialize_map(Read)
}

fn default_steps() -> f64 {
    10_000.0
}

fn default_unit() -> String {
    "mm".to_owned()
}

fn default_density() -> f64 {
    1.0
}

objects_only!(SolidSettingsDocument);

/// What is fixed when a scene of solids is created, as it is stored.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct SolidSettings {
    kind: KindName,
    steps_per_unit: u32,
    unit: String,
    density: f64,
    rounding: Rounding,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    stock: Option<SolidStockDocument>,
}

/// The settings of a scene of solids as they are answered, with its shapes.
#[derive(Serialize, ToSchema)]
pub(in crate::wire) struct SolidSceneSettings {
    /// What the scene holds.
    pub(in crate::wire) kind: KindName,
    /// Lattice steps in a user unit.
    pub(in crate::wire) steps_per_unit: u32,
    /// Label of the user unit.
    pub(in crate::wire) unit: String,
    /// Mass of a cubic user unit.
    pub(in crate::wire) density: f64,
    /// What becomes of a coordinate between two steps.
    pub(in crate::wire) rounding: Rounding,
    /// The block of material that the solids are cut from; left out when there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub(in crate::wire) stock: Option<SolidStockDocument>,
    /// How far the polygon of a cylindrical stock is from its circle; left out of any other.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub(in crate::wire) stock_polygon_error: Option<PolygonError>,
    /// The shapes by their names, as they can be sent again; left out while the scene does not answer.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub(in crate::wire) shapes: Option<BTreeMap<String, ShapeDocument>>,
    /// Of each shape with round cutters, how far these are from their polygons.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub(in crate::wire) polygon_error: Option<BTreeMap<String, PolygonError>>,
}

/// What a scene of solids is created with.
#[derive(Debug)]
pub(in crate::wire) struct NewSolids {
    pub(in crate::wire) settings: SolidSettings,
    pub(in crate::wire) stock: Option<Stock>,
    pub(in crate::wire) shapes: Vec<NamedShape>,
}

/// A shape as it is stored with the scene and answered.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub(in crate::wire) struct DefinedShape {
    /// As it can be sent again.
    pub(in crate::wire) shape: ShapeDocument,
    /// How far its round cutters are from their polygons; left out without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub(in crate::wire) polygon_error: Option<PolygonError>,
}

impl Default for SolidSettingsDocument {
    fn default() -> Self {
        Self {
            kind: KindName::Solids,
            steps_per_unit: default_steps(),
            unit: default_unit(),
            density: default_density(),
            rounding: Rounding::default(),
            stock: None,
            shapes: BTreeMap::new(),
        }
    }
}

impl SolidSettings {
    /// Reads settings back from the text that [`SolidSettings::text`] made; none when it is not such a text.
    pub fn from_text(text: &str) -> Option<Self> {
        let settings: Self = serde_json::from_str(text).ok()?;
        Scale::new(settings.steps_per_unit)
            .is_ok()
            .then_some(settings)
    }

    /// The one text of these settings: equal settings have equal texts.
    pub fn text(&self) -> String {
        serde_json::to_string(self).expect("numbers, strings and names are JSON")
    }

    /// How user units and steps correspond.
    pub fn scale(&self) -> Scale {
        let scale = Scale::new(self.steps_per_unit).expect("it was checked");
        scale.with_rounding(self.rounding)
    }

    /// Label of the user unit.
    pub fn unit(&self) -> &str {
        &self.unit
    }

    /// Mass of a cubic user unit.
    pub fn density(&self) -> f64 {
        self.density
    }

    /// The settings as they are answered, with the scene's shapes where they are known.
    pub(in crate::wire) fn shown(&self, shapes: Option<&Shapes>) -> SolidSceneSettings {
        let (mut documents, mut errors) = (BTreeMap::new(), BTreeMap::new());
        for named in shapes.into_iter().flat_map(Shapes::iter) {
            if let Some(defined) = DefinedShape::of(named) {
                documents.insert(named.name.clone(), defined.shape);
                errors.extend(
                    defined
                        .polygon_error
                        .map(|error| (named.name.clone(), error)),
                );
            }
        }
        let stock = self.stock.as_ref();
        SolidSceneSettings {
            kind: self.kind,
            steps_per_unit: self.steps_per_unit,
            unit: self.unit.clone(),
            density: self.density,
            rounding: self.rounding,
            stock: self.stock.clone(),
            stock_polygon_error: stock.and_then(|stock| stock.polygon_error(self.scale())),
            polygon_error: shapes.map(|_| errors),
            shapes: shapes.map(|_| documents),
        }
    }
}

impl DefinedShape {
    /// A shape as it is answered; none when its text was not written here.
    pub(in crate::wire) fn of(named: &NamedShape) -> Option<Self> {
        serde_json::from_str(&named.document).ok()
    }
}

/// What is wrong with settings, or what they mean. Those at fault already are passed over.
pub(in crate::wire) fn check(
    wanted: &SolidSettingsDocument,
    faults: &mut Faults,
) -> Option<NewSolids> {
    let steps_per_unit = whole(wanted.steps_per_unit).and_then(|steps| u32::try_from(steps).ok());
    let scale = steps_per_unit.and_then(|steps| Scale::new(steps).ok());
    let scale = scale.map(|scale| scale.with_rounding(wanted.rounding));
    let mut note = |pointer: String, detail: String| {
        if !faults.cover(&pointer) {
            faults.push(Fault::at(pointer, detail, None));
        }
    };
    if scale.is_none() {
        let detail = format!("is not a whole number from 1 to {STEPS_PER_UNIT_MAX}");
        note("/steps_per_unit".to_owned(), detail);
    }
    let unit = &wanted.unit;
    if !(1..=UNIT_BYTES_MAX).contains(&unit.len()) || unit.chars().any(char::is_control) {
        let detail =
            format!("is not a text of 1 to {UNIT_BYTES_MAX} bytes without control characters");
        note("/unit".to_owned(), detail);
    }
    if !(wanted.density > 0.0 && wanted.density <= DENSITY_MAX) {
        let detail = format!("is not above 0 and at most {DENSITY_MAX:e}");
        note("/density".to_owned(), detail);
    }
    let scale = scale?;
    let mut stock = None;
    if let Some(document) = &wanted.stock {
        match document.read(scale) {
            Ok(read) => stock = Some(read),
            Err(fault) => note(format!("/stock{}", fault.pointer), fault.what),
        }
    }
    let mut shapes = Vec::new();
    if wanted.shapes.len() > SHAPES_MAX {
        let detail = format!(
            "has {} shapes; the most is {SHAPES_MAX}",
            wanted.shapes.len()
        );
        note("/shapes".to_owned(), detail);
    }
    for (name, document) in &wanted.shapes {
        match named_shape(name, document, scale) {
            Ok(shape) => shapes.push(shape),
            Err((pointer, detail)) => note(format!("/shapes/{}{pointer}", escaped(name)), detail),
        }
    }
    let (stock, document) = stock.map(|read| (read.stock, read.document)).unzip();
    faults.is_empty().then(|| NewSolids {
        settings: SolidSettings {
            kind: wanted.kind,
            steps_per_unit: scale.steps_per_unit(),
            unit: unit.clone(),
            density: wanted.density,
            rounding: wanted.rounding,
            stock: document,
        },
        stock,
        shapes,
    })
}

/// A shape with its name.
/// # Errors
/// Where in the shape's document, and what is wrong.
pub(in crate::wire) fn named_shape(
    name: &str,
    document: &ShapeDocument,
    scale: Scale,
) -> Result<NamedShape, (String, String)> {
    let plain = |byte: u8| byte.is_ascii_alphanumeric();
    let fits = (1..=NAME_BYTES_MAX).contains(&name.len())
        && name.bytes().next().is_some_and(plain)
        && name
            .bytes()
            .all(|byte| plain(byte) || b"._-".contains(&byte));
    if !fits {
        let detail = format!(
            "has a name that is not 1 to {NAME_BYTES_MAX} letters (a-z, A-Z), digits, '.', '_' and '-', the first a letter or digit"
        );
        return Err((String::new(), detail));
    }
    let read = shape(document, scale).map_err(|fault| (fault.pointer, fault.what))?;
    let defined = DefinedShape {
        shape: document.clone(),
        polygon_error: (read.deviation != Deviation::default())
            .then(|| PolygonError::of(read.deviation, scale)),
    };
    Ok(NamedShape {
        name: name.to_owned(),
        document: serde_json::to_string(&defined).expect("numbers and strings are JSON"),
        shape: Arc::new(read.shape),
    })
}

/// A step of a JSON pointer.
fn escaped(step: &str) -> String {
    step.replace('~', "~0").replace('/', "~1")
}
