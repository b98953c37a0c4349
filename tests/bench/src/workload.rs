//! The sets of cubes that are measured: spread at random, along tool paths, and as uneven as cubes can lie.
//!
//! Knows how to place them, from a seed; never what is done with them.

use clap::ValueEnum;
use union3d::geometry::{Edge, InvalidCube, Place};

use crate::random::Random;

/// Edge of every cube: a 6 mm cutter at 1000 steps to the millimetre. Units: steps.
pub(crate) const EDGE_STEPS: i64 = 6_000;

/// How cubes lie. `rho` is how many cubes cover a point on average.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub(crate) enum Workload {
    /// Uniformly in a box, rho 0.015 (that of UNION3's table)
    #[value(name = "rho-0.015")]
    Rho0015,
    /// Uniformly in a box, rho 0.3
    #[value(name = "rho-0.3")]
    Rho03,
    /// Uniformly in a box, rho 1
    #[value(name = "rho-1")]
    Rho1,
    /// Uniformly in a box, rho 10
    #[value(name = "rho-10")]
    Rho10,
    /// Uniformly in a box, rho 100
    #[value(name = "rho-100")]
    Rho100,
    /// Uniformly in a box, rho 1000
    #[value(name = "rho-1000")]
    Rho1000,
    /// An undulating raster path: a cube every 1/50 edge, rows half an edge apart
    Raster,
    /// A long slanted line, a cube every 1/100 edge
    Line,
    /// A square spiral at constant z, a cube every 1/50 edge, turns half an edge apart: massive coplanarity
    Pocket,
    /// Rho 1 on the whole, but half of the cubes in a thousandth of the volume
    Cluster,
    /// At random on an undulating surface, each point of it covered three times
    Surface,
    /// At random in one plane, each point of it covered ten times
    Plane,
    /// All in one bin of the grid: a box of half an edge
    Bin,
}

impl Workload {
    /// Its name on the command line.
    pub(crate) fn name(self) -> String {
        let value = self.to_possible_value();
        value.expect("none is skipped").get_name().to_owned()
    }

    /// `count` places of cubes of `edge`, in the order they come.
    /// # Errors
    /// [`InvalidCube`] when so many do not fit the lattice.
    pub(crate) fn places(
        self,
        edge: Edge,
        count: usize,
        seed: u64,
    ) -> Result<Vec<Place>, InvalidCube> {
        let random = Random::new(seed);
        match self {
            Self::Rho0015 => uniform(edge, count, side(edge, count, 0.015), random),
            Self::Rho03 => uniform(edge, count, side(edge, count, 0.3), random),
            Self::Rho1 => uniform(edge, count, side(edge, count, 1.0), random),
            Self::Rho10 => uniform(edge, count, side(edge, count, 10.0), random),
            Self::Rho100 => uniform(edge, count, side(edge, count, 100.0), random),
            Self::Rho1000 => uniform(edge, count, side(edge, count, 1000.0), random),
            Self::Bin => uniform(edge, count, i64::from(edge.steps()) / 2, random),
            Self::Raster => raster(edge, count),
            Self::Line => line(edge, count),
            Self::Pocket => pocket(edge, count),
            Self::Cluster => cluster(edge, count, random),
            Self::Surface => surface(edge, count, random),
            Self::Plane => plane(edge, count, random),
        }
    }
}

/// Side of the box in which `count` cubes cover each point `rho` times. Units: steps.
pub(crate) fn side(edge: Edge, count: usize, rho: f64) -> i64 {
    steps(f64::from(edge.steps()) * (float(count) / rho).cbrt())
}

fn uniform(
    edge: Edge,
    count: usize,
    side: i64,
    mut random: Random,
) -> Result<Vec<Place>, InvalidCube> {
    // About the origin, where there is most room.
    let (min, max) = (-side / 2, side - side / 2 - 1);
    let mut corner = || [0; 3].map(|_: i64| random.within(min, max.max(min)));
    (0..count).map(|_| Place::new(corner(), edge)).collect()
}

fn cluster(edge: Edge, count: usize, mut random: Random) -> Result<Vec<Place>, InvalidCube> {
    let side = side(edge, count, 1.0);
    let sides = [side, (side / 10).max(1)];
    let corner = |number: usize| {
        let reach = sides[number % 2];
        [0; 3].map(|_: i64| random.within(-reach / 2, (reach - reach / 2 - 1).max(-reach / 2)))
    };
    let corners = (0..count).map(corner);
    corners.map(|corner| Place::new(corner, edge)).collect()
}

/// Height of the undulating ground: an edge up and down, a wave every eight edges. Units: steps.
fn ground(edge: f64, x: f64, y: f64) -> f64 {
    let phase = std::f64::consts::TAU / (8.0 * edge);
    edge * (x * phase).sin() * (y * phase).cos()
}

fn raster(edge: Edge, count: usize) -> Result<Vec<Place>, InvalidCube> {
    let length = f64::from(edge.steps());
    // A square of `rows` rows half an edge apart has 25 times as many cubes a row, a fiftieth of an edge apart.
    let row_cubes = whole((float(count) / 25.0).sqrt() * 25.0).max(1);
    let place = |number: usize| {
        let (row, along) = (number / row_cubes, number % row_cubes);
        // There and back.
        let along = if row.is_multiple_of(2) {
            along
        } else {
            row_cubes - 1 - along
        };
        let (x, y) = (float(along) * length / 50.0, float(row) * length / 2.0);
        let at = [x, y, ground(length, x, y)];
        Place::new(at.map(steps), edge)
    };
    (0..count).map(place).collect()
}

fn line(edge: Edge, count: usize) -> Result<Vec<Place>, InvalidCube> {
    let step = f64::from(edge.steps()) / 100.0;
    // A unit vector that no plane of the lattice holds.
    let direction: [f64; 3] = [0.779, 0.514, 0.358];
    let middle = float(count) / 2.0;
    let place = |number: usize| {
        let way = (float(number) - middle) * step;
        Place::new(direction.map(|part| steps(part * way)), edge)
    };
    (0..count).map(place).collect()
}

/// ```text
///   7 8 9      the turns of the spiral: 1, 1, 2, 2, 3, 3, .. pieces of 25 cubes
///   6 1 2
///   5 4 3
/// ```
fn pocket(edge: Edge, count: usize) -> Result<Vec<Place>, InvalidCube> {
    const CUBES_A_PIECE: usize = 25;
    let step = f64::from(edge.steps()) / 50.0;
    let (mut at, mut heading) = ([0.0, 0.0], [1.0, 0.0]);
    let mut places = Vec::with_capacity(count);
    for leg in 0.. {
        for _ in 0..(leg / 2 + 1) * CUBES_A_PIECE {
            if places.len() == count {
                return Ok(places);
            }
            places.push(Place::new([steps(at[0]), steps(at[1]), 0], edge)?);
            at = [at[0] + heading[0] * step, at[1] + heading[1] * step];
        }
        heading = [heading[1], -heading[0]];
    }
    unreachable!("the spiral has no end")
}

fn surface(edge: Edge, count: usize, mut random: Random) -> Result<Vec<Place>, InvalidCube> {
    let length = f64::from(edge.steps());
    let side = steps(length * (float(count) / 3.0).sqrt()).max(1);
    let mut place = || {
        let [x, y] = [0; 2].map(|_: i64| random.within(-side / 2, side / 2));
        let [wide_x, wide_y] = [x, y].map(float_of_steps);
        Place::new([x, y, steps(ground(length, wide_x, wide_y))], edge)
    };
    (0..count).map(|_| place()).collect()
}

fn plane(edge: Edge, count: usize, mut random: Random) -> Result<Vec<Place>, InvalidCube> {
    let side = steps(f64::from(edge.steps()) * (float(count) / 10.0).sqrt()).max(1);
    let mut place = || {
        let [x, y] = [0; 2].map(|_: i64| random.within(-side / 2, side / 2));
        Place::new([x, y, 0], edge)
    };
    (0..count).map(|_| place()).collect()
}

#[expect(
    clippy::cast_precision_loss,
    reason = "counts of cubes are far below 2^53"
)]
fn float(count: usize) -> f64 {
    count as f64
}

#[expect(clippy::cast_precision_loss, reason = "coordinates are far below 2^53")]
fn float_of_steps(coordinate: i64) -> f64 {
    coordinate as f64
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "`Place::new` refuses what is out of range"
)]
fn steps(length: f64) -> i64 {
    length.round() as i64
}

fn whole(count: f64) -> usize {
    usize::try_from(steps(count)).unwrap_or(0)
}
