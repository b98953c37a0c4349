//! Coordinate systems: from what a program says to where the tip of the cutter is, and back.
//!
//! ```text
//!   program ── + shift (G92, G52) ── turned by R ── + origin (G54..) ── tip, in the machine's coordinates
//! ```
//!
//! The tip stands where the machine is, less the tool's length in force (G43), so a program's coordinates are those of the tip
//! whether lengths are used or not. Where no origin is known, the first work system that something moves in is taken to begin at
//! zero, and systems whose place relative to it is not known cannot be moved in.

/// How many work systems there are: G54 to G59.3.
pub(super) const SYSTEMS: usize = 9;

/// One work system.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub(super) struct System {
    /// In the machine's coordinates. Units: mm.
    pub(super) origin: [f64; 3],
    /// About Z, counterclockwise. Units: degrees.
    pub(super) degrees: f64,
    /// Whether its place relative to the system moved in is known.
    pub(super) known: bool,
}

/// All of them, and what shifts them.
#[derive(Clone, Debug, Default)]
pub(super) struct Frames {
    pub(super) systems: [System; SYSTEMS],
    /// Of G92 and G52.
    pub(super) shift: [f64; 3],
    /// What G92.3 brings back.
    pub(super) shift_kept: [f64; 3],
    /// Of the tool in use, by G43.
    pub(super) length: [f64; 3],
    /// Whether zero of all this is the machine's own.
    pub(super) machine_known: bool,
}

impl Frames {
    /// The place of a system, turned if it is.
    pub(super) fn is_turned(&self, system: usize) -> bool {
        self.systems[system].degrees != 0.0
    }

    /// What is added to a coordinate in a system that is not turned.
    pub(super) fn offset(&self, system: usize, axis: usize) -> f64 {
        self.shift[axis] + self.systems[system].origin[axis]
    }

    /// Where a point of the program is.
    pub(super) fn to_machine(&self, system: usize, point: [f64; 3]) -> [f64; 3] {
        let shifted = [0, 1, 2].map(|axis| point[axis] + self.shift[axis]);
        let turned = turn(shifted, self.systems[system].degrees);
        [0, 1, 2].map(|axis| turned[axis] + self.systems[system].origin[axis])
    }

    /// The program's coordinates of a place.
    pub(super) fn to_program(&self, system: usize, place: [f64; 3]) -> [f64; 3] {
        let moved = [0, 1, 2].map(|axis| place[axis] - self.systems[system].origin[axis]);
        let turned = turn(moved, -self.systems[system].degrees);
        [0, 1, 2].map(|axis| turned[axis] - self.shift[axis])
    }

    /// A direction of the program, turned as the system is.
    pub(super) fn direction(&self, system: usize, vector: [f64; 3]) -> [f64; 3] {
        turn(vector, self.systems[system].degrees)
    }
}

fn turn(point: [f64; 3], degrees: f64) -> [f64; 3] {
    if degrees == 0.0 {
        return point;
    }
    let (sine, cosine) = degrees.to_radians().sin_cos();
    [
        point[0] * cosine - point[1] * sine,
        point[0] * sine + point[1] * cosine,
        point[2],
    ]
}
