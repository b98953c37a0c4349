//! Scenes of solids as messages: their settings and shapes both ways, solids, and mass properties. The values are those of the JSON.

use std::collections::BTreeMap;

use super::mass_properties::Missing;
use crate::engine::solids::Body;
use crate::geometry::CubeId;
use crate::geometry::convex::Point;
use crate::service::Shapes;
use crate::wire::convert::Rounding;
use crate::wire::documents::IdForm;
use crate::wire::problem::{Fault, Faults};
use crate::wire::proto;
use crate::wire::proto::shape::Form;
use crate::wire::proto::solid_scene_settings::StockForm;
use crate::wire::solids::SolidSceneProperties;
use crate::wire::solids::{
    BoxDocument, CornersDocument, CutterDocument, ErrorBounds, ExactSolids, FitName, FixedPoint,
    FormDocument, PolygonError, Scale, ShapeDocument, SolidDocument, SolidEdgeLength,
    SolidMeasures, SolidProperties, SolidSceneSettings, SolidSettingsDocument, SolidStockDocument,
    default_sides,
};

/// The settings that a message asks for; what it cannot mean is noted.
pub(super) fn wanted(
    message: &proto::SolidSceneSettings,
    faults: &mut Faults,
) -> SolidSettingsDocument {
    let mut wanted = SolidSettingsDocument::default();
    if let Some(steps) = message.steps_per_unit {
        wanted.steps_per_unit = steps.into();
    }
    wanted.unit = message.unit.clone().unwrap_or(wanted.unit);
    wanted.density = message.density.unwrap_or(wanted.density);
    match proto::Rounding::try_from(message.rounding) {
        Ok(proto::Rounding::Unspecified | proto::Rounding::Nearest) => {}
        Ok(proto::Rounding::Reject) => wanted.rounding = Rounding::Reject,
        Err(_) => unknown("/rounding", message.rounding, faults),
    }
    wanted.stock = message.stock_form.as_ref().and_then(|form| match form {
        StockForm::Stock(message) => {
            let corners = corners(message, "/stock", faults);
            corners.map(|CornersDocument { min, max }| SolidStockDocument::cuboid(min, max))
        }
        StockForm::StockHull(message) => Some(SolidStockDocument {
            hull: Some(points(message)),
            ..SolidStockDocument::default()
        }),
        StockForm::StockCylinder(message) => Some(SolidStockDocument {
            cylinder: Some(cutter(message, "/stock/cylinder", faults)),
            ..SolidStockDocument::default()
        }),
    });
    let mut shapes = BTreeMap::new();
    for (name, message) in &message.shapes {
        let read = shape(message, &format!("/shapes/{name}"), faults);
        shapes.extend(read.map(|shape| (name.clone(), shape)));
    }
    wanted.shapes = shapes;
    wanted
}

/// A shape that a message describes; what it cannot mean is noted. `pointer` is its place.
pub(super) fn shape(
    message: &proto::Shape,
    pointer: &str,
    faults: &mut Faults,
) -> Option<ShapeDocument> {
    let form = form(message, pointer, faults)?;
    let top = message.top;
    Some(ShapeDocument { form, top })
}

fn form(message: &proto::Shape, pointer: &str, faults: &mut Faults) -> Option<FormDocument> {
    let Some(form) = &message.form else {
        faults.push(Fault::at(pointer.to_owned(), "has no form", None));
        return None;
    };
    let mut cutter = |name: &str, message| cutter(message, &format!("{pointer}/{name}"), faults);
    Some(match form {
        Form::Flat(message) => FormDocument::Flat(cutter("flat", message)),
        Form::Ball(message) => FormDocument::Ball(cutter("ball", message)),
        Form::Bull(message) => FormDocument::Bull(cutter("bull", message)),
        Form::Vee(message) => FormDocument::Vee(cutter("vee", message)),
        Form::Drill(message) => FormDocument::Drill(cutter("drill", message)),
        Form::Tapered(message) => FormDocument::Tapered(cutter("tapered", message)),
        Form::Box(message) => {
            let corners = corners(message, &format!("{pointer}/box"), faults);
            FormDocument::Box(BoxDocument::Corners(corners?))
        }
        Form::Hull(message) => FormDocument::Hull(points(message)),
        Form::Parts(message) => {
            let parts = message.shapes.iter().enumerate();
            let read = parts.filter_map(|(index, part)| {
                let pointer = format!("{pointer}/parts/{index}");
                // Refused here, before it is gone into, so that a message cannot nest as deep as it likes.
                if let Some(Form::Parts(_)) = part.form {
                    let detail = "has parts of its own, and is a part itself";
                    faults.push(Fault::at(pointer, detail, None));
                    return None;
                }
                if part.top.is_some() {
                    let detail = "is of a part; the shape as a whole has one";
                    faults.push(Fault::at(format!("{pointer}/top"), detail, None));
                }
                self::form(part, &pointer, faults)
            });
            FormDocument::Parts(read.collect())
        }
    })
}

fn cutter(message: &proto::Cutter, pointer: &str, faults: &mut Faults) -> CutterDocument {
    let mut small = |name: &str, sent: Option<u32>| {
        sent.and_then(|sent| {
            let fits = u16::try_from(sent).ok();
            if fits.is_none() {
                faults.push(Fault {
                    value: Some(sent.into()),
                    ..Fault::at(format!("{pointer}/{name}"), "is too large", None)
                });
            }
            fits
        })
    };
    let (rings, sides) = (small("rings", message.rings), small("sides", message.sides));
    let polygon = match proto::Polygon::try_from(message.polygon) {
        Ok(proto::Polygon::Unspecified | proto::Polygon::EqualArea) => FitName::EqualArea,
        Ok(proto::Polygon::Inscribed) => FitName::Inscribed,
        Ok(proto::Polygon::Circumscribed) => FitName::Circumscribed,
        Err(_) => {
            unknown(&format!("{pointer}/polygon"), message.polygon, faults);
            FitName::EqualArea
        }
    };
    CutterDocument {
        diameter: message.diameter,
        length: message.length,
        corner_radius: message.corner_radius,
        tip: message.tip,
        angle: message.angle,
        rings,
        sides: sides.unwrap_or_else(default_sides),
        polygon,
        at: message.at.map_or([0.0; 3], Into::into),
    }
}

fn corners(message: &proto::Box, pointer: &str, faults: &mut Faults) -> Option<CornersDocument> {
    let mut corner = |name: &str, corner: Option<proto::Vector>| {
        if corner.is_none() {
            faults.push(Fault::at(format!("{pointer}/{name}"), "is missing", None));
        }
        corner.map(Into::into)
    };
    let (min, max) = (corner("min", message.min), corner("max", message.max));
    let (min, max) = min.zip(max)?;
    Some(CornersDocument { min, max })
}

fn points(message: &proto::Points) -> Vec<[f64; 3]> {
    let points = message.points.iter();
    points.map(|point| (*point).into()).collect()
}

fn unknown(pointer: &str, sent: i32, faults: &mut Faults) {
    let detail = "is not a value that is known here";
    faults.push(Fault {
        value: Some(sent.into()),
        ..Fault::at(pointer.to_owned(), detail, None)
    });
}

impl From<SolidSceneSettings> for proto::SolidSceneSettings {
    fn from(settings: SolidSceneSettings) -> Self {
        let rounding = match settings.rounding {
            Rounding::Nearest => proto::Rounding::Nearest,
            Rounding::Reject => proto::Rounding::Reject,
        };
        let shapes = settings.shapes.into_iter().flatten();
        let errors = settings.polygon_error.into_iter().flatten();
        Self {
            steps_per_unit: Some(settings.steps_per_unit),
            unit: Some(settings.unit),
            density: Some(settings.density),
            rounding: rounding.into(),
            stock_form: settings.stock.map(Into::into),
            stock_polygon_error: settings.stock_polygon_error.map(Into::into),
            shapes: shapes.map(|(name, shape)| (name, shape.into())).collect(),
            polygon_error: errors.map(|(name, error)| (name, error.into())).collect(),
        }
    }
}

impl From<SolidStockDocument> for StockForm {
    fn from(stock: SolidStockDocument) -> Self {
        let SolidStockDocument {
            min,
            max,
            hull,
            cylinder,
        } = stock;
        match (hull, cylinder) {
            (Some(points), _) => Self::StockHull(points.into()),
            (None, Some(cylinder)) => Self::StockCylinder(cylinder.into()),
            (None, None) => Self::Stock(proto::Box {
                min: min.map(Into::into),
                max: max.map(Into::into),
            }),
        }
    }
}

impl From<Vec<[f64; 3]>> for proto::Points {
    fn from(points: Vec<[f64; 3]>) -> Self {
        Self {
            points: points.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<PolygonError> for proto::PolygonError {
    fn from(PolygonError { outside, inside }: PolygonError) -> Self {
        Self { outside, inside }
    }
}

impl From<ShapeDocument> for proto::Shape {
    fn from(ShapeDocument { form, top }: ShapeDocument) -> Self {
        Self { top, ..form.into() }
    }
}

impl From<FormDocument> for proto::Shape {
    fn from(form: FormDocument) -> Self {
        let form = match form {
            FormDocument::Flat(cutter) => Form::Flat(cutter.into()),
            FormDocument::Ball(cutter) => Form::Ball(cutter.into()),
            FormDocument::Bull(cutter) => Form::Bull(cutter.into()),
            FormDocument::Vee(cutter) => Form::Vee(cutter.into()),
            FormDocument::Drill(cutter) => Form::Drill(cutter.into()),
            FormDocument::Tapered(cutter) => Form::Tapered(cutter.into()),
            FormDocument::Box(of) => {
                let (min, max) = match of {
                    BoxDocument::Size(size) => ([0.0; 3], size),
                    BoxDocument::Corners(CornersDocument { min, max }) => (min, max),
                };
                Form::Box(proto::Box {
                    min: Some(min.into()),
                    max: Some(max.into()),
                })
            }
            FormDocument::Hull(points) => Form::Hull(points.into()),
            FormDocument::Parts(parts) => Form::Parts(proto::Shapes {
                shapes: parts.into_iter().map(Into::into).collect(),
            }),
        };
        Self {
            form: Some(form),
            top: None,
        }
    }
}

impl From<CutterDocument> for proto::Cutter {
    fn from(cutter: CutterDocument) -> Self {
        let polygon = match cutter.polygon {
            FitName::EqualArea => proto::Polygon::EqualArea,
            FitName::Inscribed => proto::Polygon::Inscribed,
            FitName::Circumscribed => proto::Polygon::Circumscribed,
        };
        Self {
            diameter: cutter.diameter,
            length: cutter.length,
            corner_radius: cutter.corner_radius,
            tip: cutter.tip,
            angle: cutter.angle,
            rings: cutter.rings.map(Into::into),
            sides: Some(cutter.sides.into()),
            polygon: polygon.into(),
            at: Some(cutter.at.into()),
        }
    }
}

/// A solid of a scene.
pub(super) fn solid(solid: &(CubeId, Body), shapes: &Shapes, scale: Scale) -> proto::Solid {
    let SolidDocument {
        id: _,
        shape,
        at,
        from,
        to,
        hull,
    } = SolidDocument::of(solid, IdForm::default(), shapes, scale);
    proto::Solid {
        id: solid.0.0,
        shape,
        from: from.or(at).map(Into::into),
        to: to.or(at).map(Into::into),
        hull: hull.map(Into::into),
    }
}

impl proto::Change {
    /// Adds the insertion of a shape carried from one point to another; hulls come after all of these. Units: steps. O(shapes named so far).
    pub fn insert_sweep(&mut self, id: CubeId, shape: &str, ends: [Point; 2]) {
        let named = self.shapes.iter().position(|named| named == shape);
        let number = named.unwrap_or_else(|| {
            self.shapes.push(shape.to_owned());
            self.shapes.len() - 1
        });
        let number = u32::try_from(number).expect("a scene has 1,024 shapes at most");
        self.shape.push(number);
        self.insert_id.push(id.0);
        let [[x, y, z], [to_x, to_y, to_z]] = ends.map(Point::coordinates);
        self.x.push(x);
        self.y.push(y);
        self.z.push(z);
        self.to_x.push(to_x);
        self.to_y.push(to_y);
        self.to_z.push(to_z);
    }
}

/// Solids as a change that inserts them: those of shapes first, then hulls.
pub(super) fn insertion(solids: &[(CubeId, Body)], shapes: &Shapes) -> proto::Change {
    let mut change = proto::Change::default();
    let mut hulls = Vec::new();
    for (id, body) in solids {
        if let Some((shape, from, to)) = body.sweep() {
            let name = shapes.of(shape).map_or("", |named| named.name.as_str());
            change.insert_sweep(*id, name, [from, to]);
        } else if let Some(solid) = body.hull() {
            let column = |axis: usize| {
                let vertices = solid.vertices().iter();
                vertices.map(move |vertex| vertex.coordinates()[axis])
            };
            change.hulls.push(proto::Hull {
                x: column(0).collect(),
                y: column(1).collect(),
                z: column(2).collect(),
            });
            hulls.push(id.0);
        }
    }
    change.insert_id.extend(hulls);
    change
}

impl From<SolidSceneProperties> for proto::SolidMassProperties {
    /// What is removed from a stock is measured once here.
    fn from(properties: SolidSceneProperties) -> Self {
        let SolidSceneProperties {
            measured,
            removed: _,
            remaining,
        } = properties;
        Self {
            scene: measured.scene.unwrap_or_default(),
            seq: measured.seq.unwrap_or_default(),
            solids: measured.solids,
            measures: Some(measured.measures.into()),
            bounds: measured.bounds.map(Into::into),
            remaining: remaining.map(Into::into),
        }
    }
}

impl From<SolidMeasures> for proto::SolidMeasures {
    fn from(measures: SolidMeasures) -> Self {
        let edges = measures.edge_length;
        let ErrorBounds {
            volume,
            area,
            edge_length,
            centroid,
            inertia,
        } = measures.error_max;
        Self {
            volume: measures.volume,
            area: measures.area,
            edge_length: Some(proto::EdgeLength {
                total: edges.total,
                convex: edges.convex,
                concave: edges.concave,
                crossing: edges.crossing,
            }),
            mass: measures.mass,
            centroid: measures.centroid.map(Into::into),
            inertia: Some(measures.inertia.into()),
            error_max: Some(proto::SolidErrorMax {
                volume,
                area,
                edge_length,
                centroid,
                inertia,
            }),
            exact: Some(measures.exact.into()),
        }
    }
}

impl From<ExactSolids> for proto::ExactSolids {
    fn from(exact: ExactSolids) -> Self {
        let one = |FixedPoint {
                       value,
                       divisor,
                       error_max,
                   }: FixedPoint<String>| proto::FixedPoint {
            values: vec![value],
            divisor,
            error_max,
        };
        Self {
            steps_per_unit: exact.steps_per_unit,
            volume: Some(one(exact.volume)),
            area: Some(one(exact.area)),
            edge_length: Some(exact.edge_length.into()),
            first_moments: Some(exact.first_moments.into()),
            second_moments: Some(exact.second_moments.into()),
        }
    }
}

impl<const N: usize> From<FixedPoint<[String; N]>> for proto::FixedPoint {
    fn from(several: FixedPoint<[String; N]>) -> Self {
        Self {
            values: several.value.into(),
            divisor: several.divisor,
            error_max: several.error_max,
        }
    }
}

impl TryFrom<proto::SolidMassProperties> for SolidProperties {
    type Error = Missing;

    fn try_from(message: proto::SolidMassProperties) -> Result<Self, Missing> {
        Ok(Self {
            scene: Some(message.scene),
            seq: Some(message.seq),
            solids: message.solids,
            measures: message.measures.ok_or(Missing("measures"))?.try_into()?,
            bounds: message.bounds.map(TryInto::try_into).transpose()?,
        })
    }
}

impl TryFrom<proto::SolidMeasures> for SolidMeasures {
    type Error = Missing;

    fn try_from(message: proto::SolidMeasures) -> Result<Self, Missing> {
        let edges = message.edge_length.ok_or(Missing("edge_length"))?;
        let error_max = message.error_max.ok_or(Missing("error_max"))?;
        let exact = message.exact.ok_or(Missing("exact"))?;
        Ok(Self {
            volume: message.volume,
            area: message.area,
            edge_length: SolidEdgeLength {
                total: edges.total,
                convex: edges.convex,
                concave: edges.concave,
                crossing: edges.crossing,
            },
            mass: message.mass,
            centroid: message.centroid.map(Into::into),
            inertia: message.inertia.ok_or(Missing("inertia"))?.into(),
            error_max: ErrorBounds {
                volume: error_max.volume,
                area: error_max.area,
                edge_length: error_max.edge_length,
                centroid: error_max.centroid,
                inertia: error_max.inertia,
            },
            exact: ExactSolids {
                steps_per_unit: exact.steps_per_unit,
                volume: single(exact.volume, "exact.volume")?,
                area: single(exact.area, "exact.area")?,
                edge_length: several(exact.edge_length, "exact.edge_length")?,
                first_moments: several(exact.first_moments, "exact.first_moments")?,
                second_moments: several(exact.second_moments, "exact.second_moments")?,
            },
        })
    }
}

/// The one integer of a measure.
fn single(
    message: Option<proto::FixedPoint>,
    name: &'static str,
) -> Result<FixedPoint<String>, Missing> {
    let FixedPoint {
        value: [value],
        divisor,
        error_max,
    } = several(message, name)?;
    Ok(FixedPoint {
        value,
        divisor,
        error_max,
    })
}

/// The integers of measures of a kind.
fn several<const N: usize>(
    message: Option<proto::FixedPoint>,
    name: &'static str,
) -> Result<FixedPoint<[String; N]>, Missing> {
    let message = message.ok_or(Missing(name))?;
    Ok(FixedPoint {
        value: message.values.try_into().map_err(|_| Missing(name))?,
        divisor: message.divisor,
        error_max: message.error_max,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::solids::{ErrorMax, Totals};
    use crate::wire::solids::solid_properties;

    /// What is made a message of comes back, and a message that lacks a part is refused by its name.
    #[test]
    fn solids_come_back() {
        let mut totals = Totals::default();
        totals.measures.volume6 = 6 << 44;
        totals.measures.area2 = 77;
        totals.measures.edge_length2 = [1, 2, 3];
        let error_max = ErrorMax::default();
        let scale = Scale::new(10).unwrap();
        let shown = solid_properties(Some("part"), Some(7), (&totals, &error_max), scale, 2.0);
        let message = proto::SolidMassProperties::from(SolidSceneProperties {
            measured: shown.clone(),
            removed: None,
            remaining: Some(shown.measures.clone()),
        });
        assert_eq!(
            SolidProperties::try_from(message.clone()),
            Ok(shown.clone())
        );
        let remaining = message.remaining.clone().unwrap();
        assert_eq!(SolidMeasures::try_from(remaining), Ok(shown.measures));
        let mut broken = message;
        let exact = broken.measures.as_mut().unwrap().exact.as_mut().unwrap();
        exact.edge_length.as_mut().unwrap().values.pop();
        let refused = SolidProperties::try_from(broken);
        assert_eq!(refused, Err(Missing("exact.edge_length")));
    }
}
