//! What is milled where solids are measured: round tools, and the moves along which they are carried.
//!
//! Lattice steps of a ten-thousandth of a millimetre.

use std::path::Path;
use std::sync::Arc;

use serde_json::{Value, json};
use union3d::engine::solids::{Body, Shape};
use union3d::geometry::Bounds;
use union3d::geometry::convex::{Cutter, End, Fit, Point, Solid};
use union3d::toolpath::{Event, Interpreter, Move, Options, Plane};

use super::failure::{Failure, about};
use super::figures::float;

/// Lattice steps in a millimetre.
pub(crate) const STEPS_PER_MM: i32 = 10_000;

/// Arcs are cut into chords no farther from them than this. Units: mm.
const CHORD_HEIGHT: f64 = 0.02;

/// A round tool. Units: mm.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tool {
    pub(crate) diameter: f64,
    pub(crate) length: f64,
    pub(crate) sides: u16,
    /// Rings of the ball that it ends in; it is flat without.
    pub(crate) rings: Option<u16>,
}

impl Tool {
    /// For rough work.
    pub(crate) const FLAT: Self = Self {
        diameter: 6.0,
        length: 20.0,
        sides: 24,
        rings: None,
    };

    /// For surfaces.
    pub(crate) const BALL: Self = Self {
        diameter: 3.175,
        length: 20.0,
        sides: 16,
        rings: Some(4),
    };

    pub(crate) fn solid(&self) -> Result<Solid, Failure> {
        let diameter = length_steps(self.diameter);
        let cutter = Cutter {
            end: match self.rings {
                None => End::Flat,
                Some(rings) => End::Round {
                    corner_diameter: diameter,
                    rings,
                },
            },
            diameter,
            length: length_steps(self.length),
            sides: self.sides,
            fit: Fit::EqualArea,
        };
        Ok(cutter.solid()?.0)
    }

    pub(crate) fn shape(&self) -> Result<Arc<Shape>, Failure> {
        Ok(Arc::new(Shape::new(vec![self.solid()?])?))
    }

    /// The same shape, as a server reads it.
    pub(crate) fn document(&self) -> Value {
        let Self {
            diameter,
            length,
            sides,
            rings,
        } = *self;
        match rings {
            None => json!({"flat": {"diameter": diameter, "length": length, "sides": sides}}),
            Some(rings) => {
                json!({"ball": {"diameter": diameter, "length": length, "sides": sides, "rings": rings}})
            }
        }
    }
}

/// Where the tip of a tool is carried from and to.
pub(crate) type Sweep = [Point; 2];

/// What a shape sweeps.
pub(crate) fn swept(shape: &Arc<Shape>, sweeps: &[Sweep]) -> Result<Vec<Body>, Failure> {
    let body = |[from, to]: &Sweep| Ok(Body::swept(shape, *from, *to)?);
    sweeps.iter().map(body).collect()
}

/// A square milled back and forth in moves of this length, a tenth of the diameter from line to line.
pub(crate) fn raster(count: usize, diameter: f64, length: f64) -> Result<Vec<Sweep>, Failure> {
    let over = diameter / 10.0;
    let width = (float(count as u64) * length * over).sqrt();
    let moves = (width / length).ceil().max(1.0);
    let mut at = [0.0; 3];
    let mut sweeps = Vec::with_capacity(count);
    let mut way = length;
    while sweeps.len() < count {
        let next = [at[0] + way, at[1], 0.0];
        sweeps.push([point(at)?, point(next)?]);
        at = next;
        let is_end = at[0] > (moves - 0.5) * length || at[0] < 0.5 * length;
        if is_end && sweeps.len() < count {
            let next = [at[0], at[1] + over, 0.0];
            sweeps.push([point(at)?, point(next)?]);
            at = next;
            way = -way;
        }
    }
    Ok(sweeps)
}

/// The moves of a program in G-code below z = 0.
/// # Errors
/// It cannot be read or run, or there are none.
pub(crate) fn program(path: &Path) -> Result<Vec<Sweep>, Failure> {
    let program = std::fs::read(path).map_err(about(path))?;
    let mut sweeps = Vec::new();
    for event in Interpreter::new(program, Options::default()) {
        let Event::Move(next) = event? else { continue };
        let mut from = next.start;
        for to in ends(&next) {
            if from[2].min(to[2]) < 0.0 {
                let sweep = [point(below(from, to))?, point(below(to, from))?];
                if sweep[0] != sweep[1] {
                    sweeps.push(sweep);
                }
            }
            from = to;
        }
    }
    if sweeps.is_empty() {
        return Err(format!("{}: nothing is milled below z = 0", path.display()).into());
    }
    Ok(sweeps)
}

/// A block of material that moves below z = 0 cut; the outermost of them reach out of it. Units: steps.
pub(crate) fn block(sweeps: &[Sweep], diameter: f64) -> Result<Bounds, Failure> {
    let reach = steps(diameter / 4.0);
    let ends = || sweeps.iter().flatten().map(|point| point.wide());
    let of = |axis: usize| ends().map(move |at| at[axis]);
    let min = |axis| of(axis).min().ok_or("nothing is milled");
    let max = |axis| of(axis).max().ok_or("nothing is milled");
    let corner = |at: [i64; 3]| Point::new(at).map(Point::coordinates);
    Ok(Bounds {
        min: corner([min(0)? - reach, min(1)? - reach, min(2)? - 1])?,
        max: corner([max(0)? + reach, max(1)? + reach, 0])?,
    })
}

/// Where the chords of a move end.
fn ends(next: &Move) -> Vec<[f64; 3]> {
    let Some(center) = next.center() else {
        return vec![next.end];
    };
    let axes = next.plane().map_or([0, 1], Plane::axes);
    let [a, b] = axes.map(|axis| next.start[axis] - center[axis]);
    let radius = a.hypot(b);
    let angle = 2.0 * (1.0 - (CHORD_HEIGHT / radius).min(1.0)).acos();
    next.positions((radius * angle).max(CHORD_HEIGHT)).collect()
}

/// A point, or where the way to another one crosses z = 0 if the point is above.
fn below(at: [f64; 3], other: [f64; 3]) -> [f64; 3] {
    if at[2] <= 0.0 {
        return at;
    }
    let part = other[2] / (other[2] - at[2]);
    let mix = |axis: usize| other[axis] + (at[axis] - other[axis]) * part;
    [mix(0), mix(1), 0.0]
}

fn point(at: [f64; 3]) -> Result<Point, Failure> {
    Ok(Point::new(at.map(steps))?)
}

/// Millimetres in steps, rounded.
pub(crate) fn steps(mm: f64) -> i64 {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "it saturates, and points are checked"
    )]
    let steps = (mm * f64::from(STEPS_PER_MM)).round() as i64;
    steps
}

/// A length in steps; one that is none is refused as a diameter of 0 is.
fn length_steps(mm: f64) -> u32 {
    u32::try_from(steps(mm)).unwrap_or(0)
}
