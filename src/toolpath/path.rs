//! The shape of one move, and the positions along it.

/// What makes the cutter move.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Motion {
    /// G0: positioning, as fast as the machine can.
    Rapid,
    /// G1: a straight line at the feed.
    Feed,
    /// G2 or G3: an arc or a helix at the feed.
    Arc,
}

/// One move of the cutter. Units: millimetres, minutes.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Move {
    /// Line of the program it stands on, from 1.
    pub line: u64,
    /// What makes the cutter move.
    pub motion: Motion,
    /// Where it begins: x, y, z.
    pub start: [f64; 3],
    /// Where it ends.
    pub end: [f64; 3],
    /// Length of the path between them, along the arc if it is one.
    pub length: f64,
    /// Feed in mm per minute; none for rapids, and where the program gives none.
    pub feed: Option<f64>,
    pub(super) arc: Option<Arc>,
}

/// An arc about an axis, turning evenly while its radius (by a little) and its height change evenly.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Arc {
    /// First and second axis of the plane: counterclockwise turns the first into the second.
    pub(super) plane: [usize; 2],
    /// Centre, on those two axes.
    pub(super) centre: [f64; 2],
    /// Distance from the centre at the start and at the end.
    pub(super) radius: [f64; 2],
    /// Angle of the start, and the angle turned through (counterclockwise positive). Units: radians.
    pub(super) angle: f64,
    pub(super) sweep: f64,
}

impl Move {
    pub(super) fn straight(
        line: u64,
        motion: Motion,
        [start, end]: [[f64; 3]; 2],
        feed: Option<f64>,
    ) -> Self {
        Self {
            line,
            motion,
            start,
            end,
            length: distance(start, end),
            feed,
            arc: None,
        }
    }

    pub(super) fn arc(line: u64, [start, end]: [[f64; 3]; 2], arc: Arc, feed: Option<f64>) -> Self {
        let mut this = Self {
            line,
            motion: Motion::Arc,
            start,
            end,
            length: 0.0,
            feed,
            arc: Some(arc),
        };
        this.length = GAUSS
            .iter()
            .map(|&(offset, weight)| {
                weight * (this.speed(arc, 0.5 - offset / 2.0) + this.speed(arc, 0.5 + offset / 2.0))
            })
            .sum();
        this
    }

    /// The position when `part` (0 to 1) of the move is done. Exact at both ends; even in length but for an arc whose radius
    /// changes.
    pub fn at(&self, part: f64) -> [f64; 3] {
        if part <= 0.0 {
            return self.start;
        }
        if part >= 1.0 {
            return self.end;
        }
        let mut position = [0, 1, 2].map(|axis| mix(self.start[axis], self.end[axis], part));
        if let Some(arc) = self.arc {
            let radius = mix(arc.radius[0], arc.radius[1], part);
            let (sine, cosine) = (arc.angle + arc.sweep * part).sin_cos();
            position[arc.plane[0]] = arc.centre[0] + radius * cosine;
            position[arc.plane[1]] = arc.centre[1] + radius * sine;
        }
        position
    }

    /// How many equal parts the move is cut into so that none is longer than `step`; 0 when it has no length.
    pub fn parts(&self, step: f64) -> f64 {
        // Along an arc whose radius changes the outermost part is the longest, and the speed is greatest at one of the ends.
        let longest = match self.arc {
            Some(arc) => self.speed(arc, 0.0).max(self.speed(arc, 1.0)),
            None => self.length,
        };
        // A length of exactly n steps must not become n + 1 parts for the last bit of a division.
        (longest / step * (1.0 - 1e-12)).ceil()
    }

    /// Positions at the end of each of [`Self::parts`], so without the start. A move without length has none.
    pub fn positions(&self, step: f64) -> impl Iterator<Item = [f64; 3]> + use<> {
        let this = *self;
        let parts = this.parts(step);
        let mut done = 0.0;
        std::iter::from_fn(move || {
            if done >= parts {
                return None;
            }
            done += 1.0;
            Some(this.at(done / parts))
        })
    }

    /// Length travelled for each unit of `part`.
    fn speed(&self, arc: Arc, part: f64) -> f64 {
        let around = arc.sweep * mix(arc.radius[0], arc.radius[1], part);
        let outwards = arc.radius[1] - arc.radius[0];
        let normal = 3 - arc.plane[0] - arc.plane[1];
        let along = self.end[normal] - self.start[normal];
        (around * around + outwards * outwards + along * along).sqrt()
    }
}

/// Positive offsets from the middle and weights (halved: they add up to one half) of Gauss's quadrature with six points. The
/// speed along an arc is constant but for small changes of radius, so six points are exact to the last digits.
const GAUSS: [(f64, f64); 3] = [
    (0.238_619_186_083_196_9, 0.233_956_967_286_345_52),
    (0.661_209_386_466_264_5, 0.180_380_786_524_069_3),
    (0.932_469_514_203_152, 0.085_662_246_189_585_18),
];

/// Strings the positions of successive moves together: every position once, both ends of every move, none of a gap.
#[derive(Clone, Debug)]
pub struct Sampler {
    step: f64,
    last: Option<[f64; 3]>,
}

impl Sampler {
    /// Positions at most `step` apart along the path. Units: mm. Must be more than 0.
    pub fn new(step: f64) -> Self {
        assert!(step > 0.0, "a path is not sampled with a step of {step}");
        Self { step, last: None }
    }

    /// The positions of the next move: its start unless that was the last position, then the rest up to its end.
    pub fn positions(&mut self, next: &Move) -> impl Iterator<Item = [f64; 3]> + use<> {
        let start = (self.last != Some(next.start)).then_some(next.start);
        self.last = Some(next.end);
        start.into_iter().chain(next.positions(self.step))
    }
}

fn mix(from: f64, to: f64, part: f64) -> f64 {
    from + (to - from) * part
}

fn distance(from: [f64; 3], to: [f64; 3]) -> f64 {
    (to[0] - from[0])
        .hypot(to[1] - from[1])
        .hypot(to[2] - from[2])
}
