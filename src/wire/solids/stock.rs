//! The material that solids are cut from: its JSON, and the convex solid that it is.

use serde::de::Deserializer;
use serde::{Deserialize, Serialize, Serializer};
use utoipa::ToSchema;

use super::SolidFault;
use super::documents::CutterDocument;
use super::polygon_error::PolygonError;
use super::scale::Scale;
use super::shape::{cylinder, hull};
use crate::engine::solids::Stock;
use crate::geometry::convex::{Deviation, Point, Solid};
use crate::wire::objects::{not_null, objects_only, written};
use crate::wire::vector::Vector;

/// A block of material, in user units: a box (`min` and `max`), a convex hull (`hull`) or an upright cylinder (`cylinder`).
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(remote = "Self", deny_unknown_fields)]
#[schema(as = SolidStock)]
pub struct SolidStockDocument {
    /// Least corner of a box.
    #[serde(
        default,
        deserialize_with = "not_null",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(nullable = false, min_items = 3, max_items = 3, example = json!([0.0, 0.0, -10.0]))]
    pub min: Option<[f64; 3]>,
    /// Greatest corner of a box.
    #[serde(
        default,
        deserialize_with = "not_null",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(nullable = false, min_items = 3, max_items = 3, example = json!([80.0, 60.0, 0.0]))]
    pub max: Option<[f64; 3]>,
    /// The points whose convex hull it is, of which at most 1,024 are vertices. `[[x, y, z], ...]`
    #[serde(
        default,
        deserialize_with = "not_null",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(inline, value_type = Option<Vec<Vector>>, nullable = false)]
    pub hull: Option<Vec<[f64; 3]>>,
    /// A round bar along z: a polygon of so many sides, `at` the middle of its lower end. Of a cutter it has nothing else.
    #[serde(
        default,
        deserialize_with = "not_null",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(nullable = false)]
    pub cylinder: Option<CutterDocument>,
}

objects_only!(SolidStockDocument);
written!(SolidStockDocument);

/// A stock as it was read.
#[derive(Clone, Debug)]
pub struct ReadStock {
    /// The stock.
    pub stock: Stock,
    /// As it is answered: a box and a hull by the places on the lattice that they were found at.
    pub document: SolidStockDocument,
    /// How far the polygon of a cylinder is from its circle, at most; 0 of anything else.
    pub deviation: Deviation,
}

impl SolidStockDocument {
    /// A box.
    pub fn cuboid(min: [f64; 3], max: [f64; 3]) -> Self {
        Self {
            min: Some(min),
            max: Some(max),
            ..Self::default()
        }
    }

    /// Reads a stock.
    /// # Errors
    /// The first fault, with its place in the document.
    pub fn read(&self, scale: Scale) -> Result<ReadStock, SolidFault> {
        let user = |point: &Point| scale.position(*point);
        let mut deviation = Deviation::default();
        let (place, solid, document) = match self {
            Self {
                min: None,
                max: None,
                hull: Some(points),
                cylinder: None,
            } => {
                let (solid, points) = hull(points, scale, "/hull")?;
                let hull = Some(points.iter().map(user).collect());
                let document = Self {
                    hull,
                    ..Self::default()
                };
                ("/hull", solid, document)
            }
            Self {
                min: None,
                max: None,
                hull: None,
                cylinder: Some(bar),
            } => {
                let solid;
                (solid, deviation) = cylinder(bar, scale)?;
                ("/cylinder", solid, self.clone())
            }
            Self {
                min,
                max,
                hull: None,
                cylinder: None,
            } => {
                let missing = |name: &str| SolidFault::new(format!("/{name}"), "is missing");
                let min = min.ok_or_else(|| missing("min"))?;
                let max = max.ok_or_else(|| missing("max"))?;
                let corners = [scale.point(min, "/min")?, scale.point(max, "/max")?];
                let [least, greatest] = corners.map(Point::wide);
                if let Some(axis) = (0..3).find(|&axis| least[axis] >= greatest[axis]) {
                    let what = format!("= {} is not above the least corner's", max[axis]);
                    return Err(SolidFault::new(format!("/max/{axis}"), what));
                }
                let solid = Solid::cuboid(corners[0], corners[1])
                    .map_err(|invalid| SolidFault::new("", format!("is wrong: {invalid}")))?;
                let [min, max] = corners.map(|corner| scale.position(corner));
                ("", solid, Self::cuboid(min, max))
            }
            _ => {
                let what = "is several of a box (min, max), a hull and a cylinder; a stock is one";
                return Err(SolidFault::new("", what));
            }
        };
        let stock = Stock::new(solid)
            .map_err(|invalid| SolidFault::new(place, format!("is wrong: {invalid}")))?;
        Ok(ReadStock {
            stock,
            document,
            deviation,
        })
    }

    /// How far the polygon of a cylinder is from its circle; none of anything else.
    pub(super) fn polygon_error(&self, scale: Scale) -> Option<PolygonError> {
        let (_, deviation) = cylinder(self.cylinder.as_ref()?, scale).ok()?;
        (deviation != Deviation::default()).then(|| PolygonError::of(deviation, scale))
    }
}
