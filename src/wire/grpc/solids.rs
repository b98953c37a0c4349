//! Scenes of solids as messages: their settings and shapes both ways, solids, and mass properties. The values are those of the JSON.

use std::collections::BTreeMap;

use crate::engine::solids::Body;
use crate::geometry::CubeId;
use crate::service::Shapes;
use crate::wire::convert::{Rounding, StockDocument};
use crate::wire::documents::IdForm;
use crate::wire::kind::SolidSceneProperties;
use crate::wire::problem::{Fault, Faults};
use crate::wire::proto;
use crate::wire::proto::shape::Form;
use crate::wire::solids::{
    BoxDocument, CornersDocument, CutterDocument, ErrorBounds, ExactSolids, FitName, FixedPoint,
    PolygonError, Scale, ShapeDocument, SolidDocument, SolidMeasures, SolidSceneSettings,
    SolidSettingsDocument, default_sides,
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
    if let Some(stock) = &message.stock {
        let corners = corners(stock, "/stock", faults);
        wanted.stock = corners.map(|CornersDocument { min, max }| StockDocument { min, max });
    }
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
    let Some(form) = &message.form else {
        faults.push(Fault::at(pointer.to_owned(), "has no form", None));
        return None;
    };
    let mut cutter = |name: &str, message| cutter(message, &format!("{pointer}/{name}"), faults);
    Some(match form {
        Form::Flat(message) => ShapeDocument::Flat(cutter("flat", message)),
        Form::Ball(message) => ShapeDocument::Ball(cutter("ball", message)),
        Form::Bull(message) => ShapeDocument::Bull(cutter("bull", message)),
        Form::Vee(message) => ShapeDocument::Vee(cutter("vee", message)),
        Form::Drill(message) => ShapeDocument::Drill(cutter("drill", message)),
        Form::Tapered(message) => ShapeDocument::Tapered(cutter("tapered", message)),
        Form::Box(message) => {
            let corners = corners(message, &format!("{pointer}/box"), faults);
            ShapeDocument::Box(BoxDocument::Corners(corners?))
        }
        Form::Hull(message) => {
            let points = message.points.iter();
            ShapeDocument::Hull(points.map(|point| (*point).into()).collect())
        }
        Form::Parts(message) => {
            let parts = message.shapes.iter().enumerate();
            let read = parts.filter_map(|(index, part)| {
                // Refused here, before it is gone into, so that a message cannot nest as deep as it likes.
                if let Some(Form::Parts(_)) = part.form {
                    let detail = "has parts of its own, and is a part itself";
                    faults.push(Fault::at(format!("{pointer}/parts/{index}"), detail, None));
                    return None;
                }
                shape(part, &format!("{pointer}/parts/{index}"), faults)
            });
            ShapeDocument::Parts(read.collect())
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
            stock: settings.stock.map(|stock| proto::Box {
                min: Some(stock.min.into()),
                max: Some(stock.max.into()),
            }),
            shapes: shapes.map(|(name, shape)| (name, shape.into())).collect(),
            polygon_error: errors.map(|(name, error)| (name, error.into())).collect(),
        }
    }
}

impl From<PolygonError> for proto::PolygonError {
    fn from(PolygonError { outside, inside }: PolygonError) -> Self {
        Self { outside, inside }
    }
}

impl From<ShapeDocument> for proto::Shape {
    fn from(shape: ShapeDocument) -> Self {
        let form = match shape {
            ShapeDocument::Flat(cutter) => Form::Flat(cutter.into()),
            ShapeDocument::Ball(cutter) => Form::Ball(cutter.into()),
            ShapeDocument::Bull(cutter) => Form::Bull(cutter.into()),
            ShapeDocument::Vee(cutter) => Form::Vee(cutter.into()),
            ShapeDocument::Drill(cutter) => Form::Drill(cutter.into()),
            ShapeDocument::Tapered(cutter) => Form::Tapered(cutter.into()),
            ShapeDocument::Box(of) => {
                let (min, max) = match of {
                    BoxDocument::Size(size) => ([0.0; 3], size),
                    BoxDocument::Corners(CornersDocument { min, max }) => (min, max),
                };
                Form::Box(proto::Box {
                    min: Some(min.into()),
                    max: Some(max.into()),
                })
            }
            ShapeDocument::Hull(points) => Form::Hull(proto::Points {
                points: points.into_iter().map(Into::into).collect(),
            }),
            ShapeDocument::Parts(parts) => Form::Parts(proto::Shapes {
                shapes: parts.into_iter().map(Into::into).collect(),
            }),
        };
        Self { form: Some(form) }
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
        hull: hull.map(|points| proto::Points {
            points: points.into_iter().map(Into::into).collect(),
        }),
    }
}

/// Solids as a change that inserts them: those of shapes first, then hulls.
pub(super) fn insertion(solids: &[(CubeId, Body)], shapes: &Shapes) -> proto::Change {
    let mut change = proto::Change::default();
    let mut numbers: BTreeMap<&str, u32> = BTreeMap::new();
    let mut hulls = Vec::new();
    for (id, body) in solids {
        if let Some((shape, from, to)) = body.sweep() {
            let name = shapes.of(shape).map_or("", |named| named.name.as_str());
            let number = *numbers.entry(name).or_insert_with(|| {
                change.shapes.push(name.to_owned());
                u32::try_from(change.shapes.len() - 1).expect("a scene has 1,024 shapes at most")
            });
            change.shape.push(number);
            change.insert_id.push(id.0);
            let ([x, y, z], [to_x, to_y, to_z]) = (from.coordinates(), to.coordinates());
            change.x.push(x);
            change.y.push(y);
            change.z.push(z);
            change.to_x.push(to_x);
            change.to_y.push(to_y);
            change.to_z.push(to_z);
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
