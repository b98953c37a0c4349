//! From the JSON of a shape to convex solids around its anchor.

use crate::engine::solids::Shape;
use crate::geometry::convex::{
    Cutter, Deviation, End, Fit, InvalidCutter, InvalidSweep, Point, Solid, VERTICES_MAX,
};

use super::SolidFault;
use super::documents::{
    BoxDocument, CornersDocument, CutterDocument, FitName, FormDocument, ShapeDocument,
};
use super::scale::{Scale, angle};
use crate::wire::objects::TOP;

/// Most points of a hull, whether or not they become vertices: a hull of many more could take minutes.
const HULL_POINTS_MAX: usize = 4 * VERTICES_MAX;

/// Rings of a round end unless said.
const RINGS: u16 = 8;

/// The point angle of a drill unless said, in degrees.
const DRILL_ANGLE: f64 = 118.0;

/// A shape as it was read.
#[derive(Clone, Debug)]
pub struct ReadShape {
    /// The shape.
    pub shape: Shape,
    /// How far its polygonal cutters are from round ones, at most; 0 without cutters.
    pub deviation: Deviation,
}

/// Reads a shape.
/// # Errors
/// The first fault, with its place in the document.
pub fn shape(document: &ShapeDocument, scale: Scale) -> Result<ReadShape, SolidFault> {
    let mut deviation = Deviation::default();
    let form = &document.form;
    let parts = match form {
        FormDocument::Parts(parts) => {
            let part = |(index, part): (usize, &FormDocument)| {
                convex(part, scale, &mut deviation)
                    .map_err(|fault| fault.within(&format!("/parts/{index}")))
            };
            parts
                .iter()
                .enumerate()
                .map(part)
                .collect::<Result<_, _>>()?
        }
        _ => vec![convex(form, scale, &mut deviation)?],
    };
    let shape =
        Shape::new(parts).map_err(|invalid| SolidFault::new("/parts", invalid.to_string()))?;
    let shape = match document.top {
        Some(height) => with_top(shape, height, scale)?,
        None => shape,
    };
    Ok(ReadShape { shape, deviation })
}

/// The same shape, which reaches up to a height in user units wherever it is carried.
fn with_top(shape: Shape, height: f64, scale: Scale) -> Result<Shape, SolidFault> {
    let fault = |what: String| SolidFault::new(format!("/{TOP}"), what);
    let top = scale.point([0.0, 0.0, height], "");
    let [_, _, top] = top.map_err(|wrong| fault(wrong.what))?.coordinates();
    if shape.parts().iter().all(Solid::has_top) {
        Ok(shape.with_top(top))
    } else {
        Err(fault(format!(
            "cannot be: of the shape or one of its parts, {}",
            InvalidSweep::NoTop
        )))
    }
}

/// Reads a shape of one part; `deviation` becomes the greater of its own and the part's.
fn convex(
    form: &FormDocument,
    scale: Scale,
    deviation: &mut Deviation,
) -> Result<Solid, SolidFault> {
    match form {
        FormDocument::Flat(cutter) => Kind::Flat.solid(cutter, scale, deviation),
        FormDocument::Ball(cutter) => Kind::Ball.solid(cutter, scale, deviation),
        FormDocument::Bull(cutter) => Kind::Bull.solid(cutter, scale, deviation),
        FormDocument::Vee(cutter) => Kind::Vee.solid(cutter, scale, deviation),
        FormDocument::Drill(cutter) => Kind::Drill.solid(cutter, scale, deviation),
        FormDocument::Tapered(cutter) => Kind::Tapered.solid(cutter, scale, deviation),
        FormDocument::Box(BoxDocument::Size(size)) => {
            cuboid(Point::ORIGIN, scale.point(*size, "/box")?, "/box")
        }
        FormDocument::Box(BoxDocument::Corners(CornersDocument { min, max })) => {
            let least = scale.point(*min, "/box/min")?;
            cuboid(least, scale.point(*max, "/box/max")?, "/box/max")
        }
        FormDocument::Hull(points) => Ok(hull(points, scale, "/hull")?.0),
        FormDocument::Parts(_) => Err(SolidFault::new("/parts", "is inside the parts of a shape")),
    }
}

/// The box between two corners, the first of which is the least; the second is at `pointer`.
fn cuboid(least: Point, greatest: Point, pointer: &str) -> Result<Solid, SolidFault> {
    let (min, max) = (least.coordinates(), greatest.coordinates());
    if let Some(axis) = (0..3).find(|&axis| min[axis] >= max[axis]) {
        let what = "leaves no volume: the greatest corner is not above the least";
        return Err(SolidFault::new(format!("{pointer}/{axis}"), what));
    }
    Solid::cuboid(least, greatest)
        .map_err(|invalid| SolidFault::new(pointer, format!("is wrong: {invalid}")))
}

/// An upright cylinder, and how far it is from a round one.
pub(super) fn cylinder(
    document: &CutterDocument,
    scale: Scale,
) -> Result<(Solid, Deviation), SolidFault> {
    let mut deviation = Deviation::default();
    let solid = Kind::Cylinder.solid(document, scale, &mut deviation)?;
    Ok((solid, deviation))
}

/// The convex hull of points in user units, which are at `pointer`, and the points on the lattice.
pub(super) fn hull(
    points: &[[f64; 3]],
    scale: Scale,
    pointer: &str,
) -> Result<(Solid, Vec<Point>), SolidFault> {
    if points.len() > HULL_POINTS_MAX {
        let what = format!("has {} points; the most is {HULL_POINTS_MAX}", points.len());
        return Err(SolidFault::new(pointer, what));
    }
    let point = |(index, at): (usize, &[f64; 3])| scale.point(*at, &format!("{pointer}/{index}"));
    let points: Vec<Point> = points
        .iter()
        .enumerate()
        .map(point)
        .collect::<Result<_, _>>()?;
    let solid = Solid::hull(&points)
        .map_err(|invalid| SolidFault::new(pointer, format!("is no solid: {invalid}")))?;
    Ok((solid, points))
}

/// The kinds of cutters, by what they are told.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Kind {
    Flat,
    Ball,
    Bull,
    Vee,
    Drill,
    Tapered,
    /// A round bar, which no cutter is.
    Cylinder,
}

impl Kind {
    const fn name(self) -> &'static str {
        match self {
            Self::Flat => "flat",
            Self::Ball => "ball",
            Self::Bull => "bull",
            Self::Vee => "vee",
            Self::Drill => "drill",
            Self::Tapered => "tapered",
            Self::Cylinder => "cylinder",
        }
    }

    /// The cutter's solid, its tip where the document says.
    fn solid(
        self,
        document: &CutterDocument,
        scale: Scale,
        deviation: &mut Deviation,
    ) -> Result<Solid, SolidFault> {
        let place = |fault: SolidFault| fault.within(&format!("/{}", self.name()));
        let (solid, own) = self
            .cutter(document, scale)
            .and_then(|cutter| {
                cutter.solid().map_err(|invalid| {
                    SolidFault::new(field(&invalid), format!("is wrong: {invalid}"))
                })
            })
            .map_err(place)?;
        *deviation = deviation.max(own);
        let at = scale.point(document.at, "/at").map_err(place)?;
        solid
            .displaced(at.wide())
            .map_err(|invalid| place(SolidFault::new("/at", format!("is wrong: {invalid}"))))
    }

    /// The cutter on the lattice.
    fn cutter(self, document: &CutterDocument, scale: Scale) -> Result<Cutter, SolidFault> {
        self.check_members(document)?;
        let length = |name: &str, value: f64| {
            let named = |what| SolidFault::new(format!("/{name}"), what);
            scale.length(value).map_err(named)
        };
        let degrees = |value: f64, below: f64| {
            angle(value, below).map_err(|what| SolidFault::new("/angle", what))
        };
        let required = |name: &str, value: Option<f64>| {
            value.ok_or_else(|| {
                SolidFault::new("", format!("has no {name}, which a {} needs", self.name()))
            })
        };
        let tip = |value: f64| match value {
            0.0 => Ok(0),
            _ => length("tip", value),
        };
        let diameter = length("diameter", document.diameter)?;
        let rings = document.rings.unwrap_or(RINGS);
        let end = match self {
            Self::Flat | Self::Cylinder => End::Flat,
            Self::Ball => End::Round {
                corner_diameter: diameter,
                rings,
            },
            Self::Bull => {
                let radius = required("corner_radius", document.corner_radius)?;
                // A radius may end between two steps, as half of a diameter does.
                End::Round {
                    corner_diameter: length("corner_radius", 2.0 * radius)?,
                    rings,
                }
            }
            Self::Vee => End::Cone {
                tip_diameter: tip(document.tip.unwrap_or(0.0))?,
                angle: degrees(required("angle", document.angle)?, 180.0)?,
            },
            Self::Drill => End::Cone {
                tip_diameter: 0,
                angle: degrees(document.angle.unwrap_or(DRILL_ANGLE), 180.0)?,
            },
            Self::Tapered => End::Cone {
                tip_diameter: tip(required("tip", document.tip)?)?,
                angle: 2 * degrees(required("angle", document.angle)?, 90.0)?,
            },
        };
        Ok(Cutter {
            end,
            diameter,
            length: length("length", document.length)?,
            sides: document.sides,
            fit: match document.polygon {
                FitName::EqualArea => Fit::EqualArea,
                FitName::Inscribed => Fit::Inscribed,
                FitName::Circumscribed => Fit::Circumscribed,
            },
        })
    }

    /// Refuses what does not belong to this kind.
    fn check_members(self, document: &CutterDocument) -> Result<(), SolidFault> {
        for (name, is_there, kinds) in [
            (
                "corner_radius",
                document.corner_radius.is_some(),
                &[Self::Bull][..],
            ),
            ("tip", document.tip.is_some(), &[Self::Vee, Self::Tapered]),
            (
                "angle",
                document.angle.is_some(),
                &[Self::Vee, Self::Drill, Self::Tapered],
            ),
            ("rings", document.rings.is_some(), &[Self::Ball, Self::Bull]),
        ] {
            if is_there && !kinds.contains(&self) {
                let what = format!("does not belong to a {}", self.name());
                return Err(SolidFault::new(format!("/{name}"), what));
            }
        }
        Ok(())
    }
}

/// The member of a cutter at fault.
fn field(invalid: &InvalidCutter) -> &'static str {
    match invalid {
        InvalidCutter::Sides { .. } => "/sides",
        InvalidCutter::Rings { .. } => "/rings",
        InvalidCutter::Diameter { .. } => "/diameter",
        InvalidCutter::Corner { .. } => "/corner_radius",
        InvalidCutter::Tip { .. } => "/tip",
        InvalidCutter::Angle { .. } => "/angle",
        InvalidCutter::TooShort { .. } => "/length",
        InvalidCutter::Solid(_) => "",
    }
}
