//! Tools on the lattice: what cuts, and what must touch nothing.

use std::sync::Arc;

use union3d::engine::solids::Shape;
use union3d::geometry::Bounds;
use union3d::geometry::convex::{Deviation, Fit, Solid, cone};
use union3d::toolpath::{Cone, ToolEnd, ToolShape};
use union3d::wire::solids::{self, CutterDocument, FitName, FormDocument, Scale, ShapeDocument};

/// Rings of a round end.
const RINGS: u16 = 8;

/// Height of the shank that is put on an end before it is raised to the common top. Units: steps.
const STUB: i64 = 2;

/// How many steps a millimetre has, and how round circles are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fineness {
    pub(super) steps_per_mm: f64,
    pub(super) scale: Scale,
    pub(super) sides: u16,
}

impl Fineness {
    /// The nearest number of steps to a length in mm.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "lengths beyond the lattice are refused where a solid is made of them"
    )]
    pub(super) fn steps(self, length: f64) -> i64 {
        (length * self.steps_per_mm).round() as i64
    }

    fn size(self, length: f64) -> Result<u32, String> {
        u32::try_from(self.steps(length)).map_err(|_| format!("{length} mm is too large"))
    }

    /// The length of so many steps in user units.
    fn user(self, steps: u32) -> f64 {
        f64::from(steps) / f64::from(self.scale.steps_per_unit())
    }
}

/// A shape to be swept, and the box around it at its anchor.
#[derive(Clone, Debug)]
pub(super) struct Swept {
    pub(super) shape: Arc<Shape>,
    pub(super) bounds: Bounds,
    /// What it is made from, as a server is told of it.
    pub(super) document: ShapeDocument,
    /// Its name in a scene, where a shape never changes: the tool's number, and what it is.
    pub(super) name: String,
}

impl Swept {
    /// The shape of a document, and how far its polygons are from circles.
    fn new(tool: u32, document: ShapeDocument, scale: Scale) -> Result<(Self, Deviation), String> {
        let text = serde_json::to_vec(&document).map_err(|error| error.to_string())?;
        let read = solids::shape(&document, scale).map_err(|fault| fault.to_string())?;
        let boxes = read.shape.parts().iter().map(Solid::bounds);
        let around = boxes.reduce(|a, b| Bounds {
            min: [0, 1, 2].map(|axis: usize| a.min[axis].min(b.min[axis])),
            max: [0, 1, 2].map(|axis: usize| a.max[axis].max(b.max[axis])),
        });
        let swept = Self {
            shape: Arc::new(read.shape),
            bounds: around.expect("a shape has a part"),
            document,
            name: format!("t{tool}-{:08x}", crc32fast::hash(&text)),
        };
        Ok((swept, read.deviation))
    }

    /// Convex solids that move together, by their vertices.
    fn of_parts(tool: u32, parts: &[Solid], scale: Scale) -> Result<Self, String> {
        let hull = |part: &Solid| {
            let vertices = part.vertices().iter();
            FormDocument::Hull(vertices.map(|vertex| scale.position(*vertex)).collect())
        };
        let form = match parts {
            [part] => hull(part),
            _ => FormDocument::Parts(parts.iter().map(hull).collect()),
        };
        Ok(Self::new(tool, form.into(), scale)?.0)
    }
}

/// A tool on the lattice.
#[derive(Clone, Debug)]
pub(super) struct Body {
    /// Its flutes, reaching up to the common top: where they stick out of the stock, how far does not matter, and with all of them in one
    /// plane there are fewer edges.
    pub(super) raised: Option<Arc<Swept>>,
    /// Its flutes as they are; none where their length is not known.
    pub(super) flutes: Option<Arc<Swept>>,
    /// The height of the flutes above the tip; none where they are as long as need be. Units: steps.
    pub(super) height: Option<i64>,
    /// Its shank above the flutes, and its holder.
    pub(super) blunt: Option<Arc<Swept>>,
    /// How far its polygons are from circles.
    pub(super) deviation: Deviation,
}

/// How high the end of a tool is. Units: steps, rounded up.
pub(super) fn end_height(shape: &ToolShape, fineness: Fineness) -> i64 {
    let height = match &shape.end {
        ToolEnd::Flat | ToolEnd::Form(_) => 0.0,
        ToolEnd::Ball => shape.diameter / 2.0,
        ToolEnd::Bull { corner } => *corner,
        ToolEnd::Vee { angle, tip } => cone_height(shape.diameter - tip, angle / 2.0),
        ToolEnd::Drill { angle } => cone_height(shape.diameter, angle / 2.0),
        ToolEnd::Tapered { angle, tip } => cone_height(shape.diameter - tip, *angle),
    };
    fineness.steps(height) + STUB
}

/// Of a cone that widens by so much, its side at an angle to its axis.
fn cone_height(widening: f64, degrees: f64) -> f64 {
    widening / 2.0 / degrees.to_radians().tan()
}

impl Body {
    /// The tool of a number and a shape; `top` is the common top, where there is one. Units: steps.
    ///
    /// # Errors
    /// A sentence says what is wrong with it.
    pub(super) fn new(
        tool: u32,
        shape: &ToolShape,
        fineness: Fineness,
        top: Option<i32>,
    ) -> Result<Self, String> {
        let height = shape.flutes.or(shape.length);
        let height = height.map(|height| fineness.steps(height));
        let mut deviation = Deviation::default();
        let mut raised = None;
        let flutes = if let ToolEnd::Form(cones) = &shape.end {
            let parts = stacked(cones, 0, fineness, &mut deviation)?;
            Some(Swept::of_parts(tool, &parts, fineness.scale)?)
        } else {
            let mut of_length = |length: i64, top: Option<i32>| {
                let form = cutter(shape, fineness, length)?;
                let top =
                    top.map(|top| f64::from(top) / f64::from(fineness.scale.steps_per_unit()));
                let (swept, own) = Swept::new(tool, ShapeDocument { form, top }, fineness.scale)?;
                deviation = deviation.max(own);
                Ok::<_, String>(swept)
            };
            if top.is_some() {
                raised = Some(of_length(end_height(shape, fineness), top)?);
            }
            match height {
                Some(height) => Some(of_length(height, None)?),
                None => None,
            }
        };
        Ok(Self {
            raised: raised.map(Arc::new),
            flutes: flutes.map(Arc::new),
            height,
            blunt: blunt(tool, shape, fineness, &mut deviation)?.map(Arc::new),
            deviation,
        })
    }
}

/// The cutter of a tool that is no form.
fn cutter(shape: &ToolShape, fineness: Fineness, length: i64) -> Result<FormDocument, String> {
    let length = u32::try_from(length).map_err(|_| "it is too long".to_owned())?;
    let round = CutterDocument {
        diameter: fineness.user(fineness.size(shape.diameter)?),
        length: fineness.user(length),
        corner_radius: None,
        tip: None,
        angle: None,
        rings: None,
        sides: fineness.sides,
        polygon: FitName::EqualArea,
        at: [0.0; 3],
    };
    let pointed = |tip: f64, angle: f64| -> Result<CutterDocument, String> {
        Ok(CutterDocument {
            tip: Some(fineness.user(fineness.size(tip)?)),
            angle: Some(angle),
            ..round.clone()
        })
    };
    Ok(match shape.end {
        ToolEnd::Flat => FormDocument::Flat(round),
        ToolEnd::Ball => FormDocument::Ball(CutterDocument {
            rings: Some(RINGS),
            ..round
        }),
        ToolEnd::Bull { corner } => FormDocument::Bull(CutterDocument {
            corner_radius: Some(fineness.user(fineness.size(2.0 * corner)?) / 2.0),
            rings: Some(RINGS),
            ..round
        }),
        ToolEnd::Vee { angle, tip } => FormDocument::Vee(pointed(tip, angle)?),
        ToolEnd::Drill { angle } => FormDocument::Vee(pointed(0.0, angle)?),
        // By its whole angle: a half may lie between two millionths of a degree.
        ToolEnd::Tapered { angle, tip } => FormDocument::Vee(pointed(tip, 2.0 * angle)?),
        ToolEnd::Form(_) => unreachable!("a form is made of cones"),
    })
}

/// Cones on each other from a height on. Units of `from`: steps.
fn stacked(
    cones: &[Cone],
    from: i64,
    fineness: Fineness,
    deviation: &mut Deviation,
) -> Result<Vec<Solid>, String> {
    let mut parts = Vec::with_capacity(cones.len());
    let (mut lower, mut height) = (from, 0.0);
    for piece in cones {
        height += piece.height;
        let upper = from + fineness.steps(height);
        let ends = [
            (fineness.size(piece.lower)?, lower),
            (fineness.size(piece.upper)?, upper),
        ];
        let (solid, own) =
            cone(ends, fineness.sides, Fit::EqualArea).map_err(|invalid| invalid.to_string())?;
        *deviation = deviation.max(own);
        parts.push(solid);
        lower = upper;
    }
    Ok(parts)
}

/// What of a tool does not cut.
fn blunt(
    tool: u32,
    shape: &ToolShape,
    fineness: Fineness,
    deviation: &mut Deviation,
) -> Result<Option<Swept>, String> {
    let Some(length) = shape.length else {
        return Ok(None);
    };
    let flutes = shape.flutes.unwrap_or(length);
    let mut parts = Vec::new();
    if fineness.steps(flutes) < fineness.steps(length) {
        let diameter = shape.shank.unwrap_or(shape.diameter);
        let shank = Cone {
            lower: diameter,
            upper: diameter,
            height: length - flutes,
        };
        parts = stacked(&[shank], fineness.steps(flutes), fineness, deviation)?;
    }
    parts.extend(stacked(
        &shape.holder,
        fineness.steps(length),
        fineness,
        deviation,
    )?);
    if parts.is_empty() {
        return Ok(None);
    }
    Swept::of_parts(tool, &parts, fineness.scale).map(Some)
}
