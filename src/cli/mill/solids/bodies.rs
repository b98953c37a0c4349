//! Tools on the lattice: what cuts, and what must touch nothing.

use std::sync::Arc;

use union3d::engine::solids::Shape;
use union3d::geometry::Bounds;
use union3d::geometry::convex::{Cutter, Deviation, End, Fit, Solid, cone};
use union3d::toolpath::{Cone, ToolEnd, ToolShape};

/// Rings of a round end.
const RINGS: u16 = 8;

/// Height of the shank that is put on an end before it is raised to the common top. Units: steps.
const STUB: i64 = 2;

/// How many steps a millimetre has, and how round circles are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fineness {
    pub(super) steps_per_mm: f64,
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
}

/// A shape to be swept, and the box around it at its anchor.
#[derive(Clone, Debug)]
pub(super) struct Swept {
    pub(super) shape: Arc<Shape>,
    pub(super) bounds: Bounds,
}

impl Swept {
    fn new(parts: Vec<Solid>, top: Option<i32>) -> Result<Self, String> {
        let mut bounds = parts[0].bounds();
        for part in &parts[1..] {
            let other = part.bounds();
            for axis in 0..3 {
                bounds.min[axis] = bounds.min[axis].min(other.min[axis]);
                bounds.max[axis] = bounds.max[axis].max(other.max[axis]);
            }
        }
        let shape = Shape::new(parts).map_err(|invalid| invalid.to_string())?;
        let shape = match top {
            Some(top) => shape.with_top(top),
            None => shape,
        };
        Ok(Self {
            shape: Arc::new(shape),
            bounds,
        })
    }
}

/// A tool on the lattice.
#[derive(Clone, Debug)]
pub(super) struct Body {
    /// Its flutes, reaching up to the common top: where they stick out of the stock, how far does not matter, and with all of them in one
    /// plane there are fewer edges.
    pub(super) raised: Option<Swept>,
    /// Its flutes as they are; none where their length is not known.
    pub(super) flutes: Option<Swept>,
    /// The height of the flutes above the tip; none where they are as long as need be. Units: steps.
    pub(super) height: Option<i64>,
    /// Its shank above the flutes, and its holder.
    pub(super) blunt: Option<Swept>,
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
    /// The tool of a shape; `top` is the common top, where there is one. Units: steps.
    ///
    /// # Errors
    /// A sentence says what is wrong with it.
    pub(super) fn new(
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
            Some(Swept::new(parts, None)?)
        } else {
            let mut of_length = |length: i64, top: Option<i32>| {
                let cutter = cutter(shape, fineness, length)?;
                let (solid, own) = cutter.solid().map_err(|invalid| invalid.to_string())?;
                deviation = deviation.max(own);
                Swept::new(vec![solid], top)
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
            raised,
            flutes,
            height,
            blunt: blunt(shape, fineness, &mut deviation)?,
            deviation,
        })
    }
}

fn cutter(shape: &ToolShape, fineness: Fineness, length: i64) -> Result<Cutter, String> {
    let diameter = fineness.size(shape.diameter)?;
    let end = match shape.end {
        ToolEnd::Flat => End::Flat,
        ToolEnd::Ball => End::Round {
            corner_diameter: diameter,
            rings: RINGS,
        },
        ToolEnd::Bull { corner } => End::Round {
            corner_diameter: fineness.size(2.0 * corner)?,
            rings: RINGS,
        },
        ToolEnd::Vee { angle, tip } => End::Cone {
            tip_diameter: fineness.size(tip)?,
            angle: millionths(angle),
        },
        ToolEnd::Drill { angle } => End::Cone {
            tip_diameter: 0,
            angle: millionths(angle),
        },
        ToolEnd::Tapered { angle, tip } => End::Cone {
            tip_diameter: fineness.size(tip)?,
            angle: millionths(2.0 * angle),
        },
        ToolEnd::Form(_) => unreachable!("a form is made of cones"),
    };
    Ok(Cutter {
        end,
        diameter,
        length: u32::try_from(length).map_err(|_| "it is too long".to_owned())?,
        sides: fineness.sides,
        fit: Fit::EqualArea,
    })
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "an angle between 0 and 180 degrees"
)]
fn millionths(degrees: f64) -> u32 {
    (degrees * 1e6).round() as u32
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
    Swept::new(parts, None).map(Some)
}
