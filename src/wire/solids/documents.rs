//! The JSON of shapes and solids.

use std::fmt;

use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Deserializer, Error, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Serialize, Serializer};
use utoipa::ToSchema;

use crate::wire::documents::Id;
use crate::wire::objects::{
    CHOICE_AND_TOP, LIST_OR_OBJECT, ObjectOnly, TOP, not_null, objects_only, written,
};
use crate::wire::vector::Vector;

/// What solids of a scene share. Lengths are in user units; the origin is the shape's anchor, which is carried along the path of a solid.
#[derive(Clone, PartialEq, Debug, Serialize, ToSchema)]
#[schema(as = Shape)]
pub struct ShapeDocument {
    /// What it is.
    #[serde(flatten)]
    pub form: FormDocument,
    /// The height, in the scene, that its top reaches up to wherever it is carried: then the shanks of cutters that stand out of a stock end in
    /// one plane, and what they sweep has fewer edges. Its own top is a horizontal facet with upright ones around it, and no solid of it
    /// may stand higher. Units: user units.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub top: Option<f64>,
}

impl From<FormDocument> for ShapeDocument {
    fn from(form: FormDocument) -> Self {
        Self { form, top: None }
    }
}

impl<'de> Deserialize<'de> for ShapeDocument {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Read;
        impl<'de> Visitor<'de> for Read {
            type Value = ShapeDocument;
            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("a shape")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<ShapeDocument, A::Error> {
                let (mut form, mut top) = (None, None);
                while let Some(member) = map.next_key()? {
                    let read = match member {
                        Member::Top if top.is_some() => {
                            return Err(A::Error::duplicate_field(TOP));
                        }
                        Member::Top => {
                            top = Some(map.next_value()?);
                            continue;
                        }
                        Member::Flat => FormDocument::Flat(map.next_value()?),
                        Member::Ball => FormDocument::Ball(map.next_value()?),
                        Member::Bull => FormDocument::Bull(map.next_value()?),
                        Member::Vee => FormDocument::Vee(map.next_value()?),
                        Member::Drill => FormDocument::Drill(map.next_value()?),
                        Member::Tapered => FormDocument::Tapered(map.next_value()?),
                        Member::Box => FormDocument::Box(map.next_value()?),
                        Member::Hull => FormDocument::Hull(map.next_value()?),
                        Member::Parts => FormDocument::Parts(map.next_value()?),
                    };
                    if form.replace(read).is_some() {
                        return Err(A::Error::custom("a shape has one form"));
                    }
                }
                let form = form.ok_or_else(|| A::Error::custom("a shape has a form"))?;
                Ok(ShapeDocument { form, top })
            }
        }
        deserializer.deserialize_struct(CHOICE_AND_TOP, MEMBERS, ObjectOnly(Read))
    }
}

/// The names of the members of a shape, as [`Member`] has them.
const MEMBERS: &[&str] = &[
    "flat", "ball", "bull", "vee", "drill", "tapered", "box", "hull", "parts", TOP,
];

/// The forms and what may stand beside them.
#[derive(Deserialize)]
#[serde(field_identifier, rename_all = "snake_case")]
enum Member {
    Flat,
    Ball,
    Bull,
    Vee,
    Drill,
    Tapered,
    Box,
    Hull,
    Parts,
    Top,
}

/// The form of a shape, or of one of its parts: one of these.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Form)]
pub enum FormDocument {
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
    #[schema(value_type = Vec<Vector>)]
    Hull(Vec<[f64; 3]>),
    /// Several convex shapes that move together, such as a cutter and its holder; none of them has parts of its own.
    #[schema(no_recursion)]
    Parts(Vec<FormDocument>),
}

/// A round cutter that points down. Lengths are whole numbers of lattice steps.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(remote = "Self", deny_unknown_fields)]
#[schema(as = Cutter)]
pub struct CutterDocument {
    /// Diameter of the shank. Units: user units.
    #[schema(exclusive_minimum = 0, example = 6.0)]
    pub diameter: f64,
    /// Height of the shank's top above the tip. Units: user units.
    #[schema(exclusive_minimum = 0, example = 25.0)]
    pub length: f64,
    /// Radius of the rounded corner; of a bull-nose end mill only. Units: user units.
    #[serde(
        default,
        deserialize_with = "not_null",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(nullable = false)]
    pub corner_radius: Option<f64>,
    /// Diameter of the flat tip; of a vee (0 unless said) and a tapered end mill only. Units: user units.
    #[serde(
        default,
        deserialize_with = "not_null",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(nullable = false)]
    pub tip: Option<f64>,
    /// Of a vee, a drill and a tapered end mill only. Units: degrees.
    #[serde(
        default,
        deserialize_with = "not_null",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(nullable = false)]
    pub angle: Option<f64>,
    /// Rings of the round end of a ball or bull-nose end mill. Range: 2 to 64.
    #[serde(
        default,
        deserialize_with = "not_null",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(nullable = false, minimum = 2, maximum = 64)]
    pub rings: Option<u16>,
    /// Sides of the polygon that stands for a circle. Range: 3 to 1024.
    #[serde(default = "default_sides")]
    #[schema(default = 32, minimum = 3, maximum = 1024)]
    pub sides: u16,
    /// Which polygon it is.
    #[serde(default)]
    #[schema(default = "equal_area")]
    pub polygon: FitName,
    /// Where the centre of its tip is, seen from the shape's anchor. Units: user units. `[x, y, z]`
    #[serde(default)]
    #[schema(min_items = 3, max_items = 3, default = json!([0.0, 0.0, 0.0]))]
    pub at: [f64; 3],
}

/// Sides of a polygon unless said.
pub(in crate::wire) fn default_sides() -> u16 {
    32
}

/// Which polygon stands for a circle.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = Polygon)]
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
#[derive(Clone, Copy, PartialEq, Debug, Serialize, ToSchema)]
#[serde(untagged)]
#[schema(as = Box)]
pub enum BoxDocument {
    /// Its size along x, y and z; its least corner is the anchor.
    #[schema(value_type = Vector)]
    Size([f64; 3]),
    /// Its corners.
    Corners(CornersDocument),
}

/// The corners of a box. Units: user units.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(remote = "Self", deny_unknown_fields)]
#[schema(as = Corners)]
pub struct CornersDocument {
    /// Least corner.
    #[schema(min_items = 3, max_items = 3)]
    pub min: [f64; 3],
    /// Greatest corner.
    #[schema(min_items = 3, max_items = 3)]
    pub max: [f64; 3],
}

impl<'de> Deserialize<'de> for BoxDocument {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Read;
        impl<'de> Visitor<'de> for Read {
            type Value = BoxDocument;
            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("[x, y, z] or {\"min\":[..],\"max\":[..]}")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, size: A) -> Result<BoxDocument, A::Error> {
                let size = SeqAccessDeserializer::new(size);
                Deserialize::deserialize(size).map(BoxDocument::Size)
            }
            fn visit_map<A: MapAccess<'de>>(self, corners: A) -> Result<BoxDocument, A::Error> {
                let corners = MapAccessDeserializer::new(corners);
                CornersDocument::deserialize(corners).map(BoxDocument::Corners)
            }
        }
        deserializer.deserialize_struct(LIST_OR_OBJECT, &["min", "max"], Read)
    }
}

/// A solid: a shape at one place (`at`), a shape carried along a segment (`from`, `to`), or a convex hull of its own (`hull`).
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(remote = "Self", deny_unknown_fields)]
#[schema(as = Solid)]
pub struct SolidDocument {
    /// Its id, unique in the scene. All solids of a change have one, or none has: then the server numbers them.
    #[serde(
        default,
        deserialize_with = "not_null",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(nullable = false)]
    pub id: Option<Id>,
    /// The name of its shape; left out of a hull.
    #[serde(
        default,
        deserialize_with = "not_null",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(nullable = false, example = "t1")]
    pub shape: Option<String>,
    /// Where the shape's anchor is. Units: user units. `[x, y, z]`
    #[serde(
        default,
        deserialize_with = "not_null",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(nullable = false, min_items = 3, max_items = 3)]
    pub at: Option<[f64; 3]>,
    /// Where the shape's anchor is carried from. Units: user units. `[x, y, z]`
    #[serde(
        default,
        deserialize_with = "not_null",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(nullable = false, min_items = 3, max_items = 3, example = json!([0.0, 0.0, -2.0]))]
    pub from: Option<[f64; 3]>,
    /// Where the shape's anchor is carried to. Units: user units. `[x, y, z]`
    #[serde(
        default,
        deserialize_with = "not_null",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(nullable = false, min_items = 3, max_items = 3, example = json!([40.0, 0.0, -2.0]))]
    pub to: Option<[f64; 3]>,
    /// The points whose convex hull it is; as it is answered, the hull's vertices. Units: user units. `[[x, y, z], ...]`
    #[serde(
        default,
        deserialize_with = "not_null",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(inline, value_type = Option<Vec<Vector>>, nullable = false)]
    pub hull: Option<Vec<[f64; 3]>>,
}

objects_only!(CutterDocument, CornersDocument, SolidDocument);
written!(CutterDocument, CornersDocument, SolidDocument);
