//! The sets of solids that are measured, from a seed; never what is done with them.

use clap::ValueEnum;
use union3d::engine::solids::Body;
use union3d::geometry::convex::{Point, Solid};

use super::failure::Failure;
use super::figures::float;
use super::milling::{Tool, raster, swept};
use super::random::Random;

/// Solids that lie in one way.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub(crate) enum SolidSet {
    /// Boxes with a side of 2 mm, at random, as many in a volume as fill it once
    Boxes,
    /// A square milled with a flat tool of 6 mm and 24 sides in moves of 2 mm, a tenth of the diameter apart
    Flat,
    /// The same with a ball of 3.175 mm and 16 sides in moves of 0.5 mm
    Ball,
    /// Capsules (a ball of 12 sides carried along a segment) all over a dome, each of which meets a few others
    Dome,
}

impl SolidSet {
    /// What it is called in tables.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Boxes => "boxes, rho 1",
            Self::Flat => "flat, step-over 10 %, 2 mm",
            Self::Ball => "ball, step-over 10 %, 0.5 mm",
            Self::Dome => "dome of capsules",
        }
    }

    /// So many solids, in the order in which they come.
    /// # Errors
    /// They do not fit the lattice.
    pub(crate) fn bodies(self, count: usize, seed: u64) -> Result<Vec<Body>, Failure> {
        match self {
            Self::Boxes => boxes(count, seed),
            Self::Flat => milled(Tool::FLAT, count, 2.0),
            Self::Ball => milled(Tool::BALL, count, 0.5),
            Self::Dome => dome(count, seed),
        }
    }
}

fn milled(tool: Tool, count: usize, length: f64) -> Result<Vec<Body>, Failure> {
    swept(&tool.shape()?, &raster(count, tool.diameter, length)?)
}

fn boxes(count: usize, seed: u64) -> Result<Vec<Body>, Failure> {
    const SIDE: i64 = 20_000;
    let mut random = Random::new(seed);
    let room = whole(float(count as u64).cbrt() * 20_000.0).max(1);
    let corner = |random: &mut Random| [0; 3].map(|_: i64| random.below(room));
    (0..count)
        .map(|_| {
            let low = corner(&mut random);
            let (a, b) = (Point::new(low)?, Point::new(low.map(|at| at + SIDE))?);
            Ok(Body::cuboid(a, b)?)
        })
        .collect()
}

/// Capsules whose middles lie evenly on a hemisphere, along the spiral of the golden angle, in random directions.
fn dome(count: usize, seed: u64) -> Result<Vec<Body>, Failure> {
    const RADIUS: f64 = 1e6;
    let golden_angle = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    // So wide that they overlap whatever their number.
    let wide = 1.1 * RADIUS * (2.0 / float(count as u64)).sqrt();
    let ball = ball(12, 9, wide)?;
    let mut random = Random::new(seed);
    (0..count as u64)
        .map(|number| {
            let height = (float(number) + 0.5) / float(count as u64);
            let (around, out) = (float(number) * golden_angle, (1.0 - height * height).sqrt());
            let middle = [out * around.cos(), out * around.sin(), height].map(|at| at * RADIUS);
            let mut way = [0; 3].map(|_: i64| 0.0_f64);
            while way.iter().map(|part| part * part).sum::<f64>() < 0.1 {
                way = way.map(|_| float(random.below(2_001)) / 1_000.0 - 1.0);
            }
            let length = way.iter().map(|part| part * part).sum::<f64>().sqrt();
            let end = |sign: f64| {
                let at = |axis: usize| middle[axis] + sign * 0.8 * wide * way[axis] / length;
                Point::new([0, 1, 2].map(|axis: usize| whole(at(axis))))
            };
            Ok(Body::solid(ball.swept(end(-1.0)?, end(1.0)?)?))
        })
        .collect()
}

/// A ball of rings that are multiples of one polygon, so that the facets between two rings are plane.
fn ball(sides: u32, rings: u32, radius: f64) -> Result<Solid, Failure> {
    let unit = radius.sqrt();
    let polygon = (0..sides).map(|side| {
        let angle = std::f64::consts::TAU * f64::from(side) / f64::from(sides);
        [unit * angle.cos(), unit * angle.sin()].map(whole)
    });
    let polygon: Vec<[i64; 2]> = polygon.collect();
    let mut points = Vec::new();
    for ring in 0..rings {
        // The outermost rings are small, and there are no poles.
        let angle = std::f64::consts::PI * (f64::from(ring) + 0.3) / (f64::from(rings) - 0.4);
        let (multiple, height) = (whole(unit * angle.sin()), whole(radius * angle.cos()));
        for [x, y] in &polygon {
            points.push(Point::new([x * multiple, y * multiple, height])?);
        }
    }
    Ok(Solid::hull(&points)?)
}

/// Rounded.
fn whole(number: f64) -> i64 {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "it saturates, and points are checked"
    )]
    let whole = number.round() as i64;
    whole
}
