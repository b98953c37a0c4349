//! The shape of one move, and the positions along it.

/// The plane of arcs and cycles.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Plane {
    /// G17.
    Xy,
    /// G18.
    Zx,
    /// G19.
    Yz,
}

impl Plane {
    /// First and second axis (0 is x): counterclockwise turns the first into the second.
    pub fn axes(self) -> [usize; 2] {
        match self {
            Self::Xy => [0, 1],
            Self::Zx => [2, 0],
            Self::Yz => [1, 2],
        }
    }

    /// The axis that stands on it.
    pub fn normal(self) -> usize {
        match self {
            Self::Xy => 2,
            Self::Zx => 1,
            Self::Yz => 0,
        }
    }

    /// `xy`, `zx` or `yz`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Xy => "xy",
            Self::Zx => "zx",
            Self::Yz => "yz",
        }
    }
}

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
    /// Number of the tool in the spindle; 0 before the first is loaded.
    pub tool: u32,
    /// Whether the program has said where the move begins. Before the first word of an axis, and after a return to a reference
    /// point that is not known, `start` is only what was last said.
    pub start_known: bool,
    /// Which of the coordinates of `end` the program has said.
    pub end_known: [bool; 3],
    pub(super) arc: Option<Arc>,
}

/// An arc about an axis, turning evenly while its radius (by a little) and its height change evenly.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Arc {
    pub(super) plane: Plane,
    /// Centre, on those two axes.
    pub(super) centre: [f64; 2],
    /// Distance from the centre at the start and at the end.
    pub(super) radius: [f64; 2],
    /// Angle of the start, and the angle turned through (counterclockwise positive). Units: radians.
    pub(super) angle: f64,
    pub(super) sweep: f64,
}

impl Move {
    /// A straight move between known points.
    pub(super) fn straight(line: u64, motion: Motion, [start, end]: [[f64; 3]; 2]) -> Self {
        Self {
            line,
            motion,
            start,
            end,
            length: distance(start, end),
            feed: None,
            tool: 0,
            start_known: true,
            end_known: [true; 3],
            arc: None,
        }
    }

    /// An arc between known points.
    pub(super) fn arc(line: u64, ends: [[f64; 3]; 2], arc: Arc) -> Self {
        let mut this = Self {
            motion: Motion::Arc,
            length: 0.0,
            arc: Some(arc),
            ..Self::straight(line, Motion::Arc, ends)
        };
        this.length = if arc.radius[0].to_bits() == arc.radius[1].to_bits() {
            this.speed(arc, 0.0)
        } else {
            let speed = |part| this.speed(arc, part);
            let pairs = GAUSS.iter().map(|&(offset, weight)| {
                weight * (speed(0.5 - offset / 2.0) + speed(0.5 + offset / 2.0))
            });
            pairs.sum()
        };
        this
    }

    /// The centre of an arc, level with its start along the normal of its plane. Units: mm.
    pub fn center(&self) -> Option<[f64; 3]> {
        self.arc.map(|arc| {
            let [first, second] = arc.plane.axes();
            let mut center = self.start;
            (center[first], center[second]) = (arc.centre[0], arc.centre[1]);
            center
        })
    }

    /// The plane of an arc.
    pub fn plane(&self) -> Option<Plane> {
        self.arc.map(|arc| arc.plane)
    }

    /// Turns that an arc begins, counterclockwise positive: 1 up to a full circle, 2 up to two.
    #[expect(clippy::cast_possible_truncation, reason = "a million at most")]
    pub fn turns(&self) -> Option<i32> {
        // A full circle must not begin a second turn for the last bit of its angle.
        let begun = |sweep: f64| (sweep.abs() / std::f64::consts::TAU - 1e-9).ceil().max(1.0);
        self.arc
            .map(|arc| begun(arc.sweep).copysign(arc.sweep) as i32)
    }

    /// The end of it alone, without a length.
    #[must_use]
    pub fn end_only(&self) -> Self {
        Self {
            start: self.end,
            length: 0.0,
            arc: None,
            ..*self
        }
    }

    /// The same move seen from a frame whose origin is at `origin`.
    pub(super) fn seen_from(mut self, origin: [f64; 3]) -> Self {
        self.start = [0, 1, 2].map(|axis| self.start[axis] - origin[axis]);
        self.end = [0, 1, 2].map(|axis| self.end[axis] - origin[axis]);
        if let Some(arc) = &mut self.arc {
            for (centre, axis) in arc.centre.iter_mut().zip(arc.plane.axes()) {
                *centre -= origin[axis];
            }
        }
        self
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
            let [first, second] = arc.plane.axes();
            position[first] = arc.centre[0] + radius * cosine;
            position[second] = arc.centre[1] + radius * sine;
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

    /// The ends of chords no farther from the move than `tolerance`, without its start, the last exactly at its end: one for a straight move.
    ///
    /// Where an arc is cut depends on its centre and radius alone, not on where it begins: so one that lies on another has the same chords, and
    /// what the first has removed is not removed again between the chords of the second.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "at most a million turns of a million chords"
    )]
    pub fn chord_ends(&self, tolerance: f64) -> impl Iterator<Item = [f64; 3]> + use<> {
        let this = *self;
        let (from, to) = this.arc.map_or((0, 0), |arc| {
            let step = chord_angle(arc, tolerance);
            // Multiples of the step strictly between the ends: one that is an end but for the last bits of an angle is none.
            let ends = [arc.angle, arc.angle + arc.sweep].map(|angle| angle / step);
            let (least, most) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
            (
                (least + 1e-6).floor() as i64 + 1,
                (most - 1e-6).ceil() as i64,
            )
        });
        let between = (from..to).map(move |index| match this.arc {
            Some(arc) => {
                let index = if arc.sweep < 0.0 {
                    from + to - 1 - index
                } else {
                    index
                };
                let angle = chord_angle(arc, tolerance) * exact(index);
                this.at((angle - arc.angle) / arc.sweep)
            }
            None => this.end,
        });
        between.chain(std::iter::once(this.end))
    }

    /// The lesser radius of an arc, where it begins or ends. Units: mm.
    pub fn radius(&self) -> Option<f64> {
        self.arc.map(|arc| arc.radius[0].min(arc.radius[1]))
    }

    /// Directions in which the move begins and ends, of length 1; none without a length.
    pub fn directions(&self) -> Option<[[f64; 3]; 2]> {
        let unit = |vector: [f64; 3]| {
            let length = distance([0.0; 3], vector);
            (length > 0.0).then(|| vector.map(|part| part / length))
        };
        let along = [0, 1, 2].map(|axis| self.end[axis] - self.start[axis]);
        let Some(arc) = self.arc else {
            let direction = unit(along)?;
            return Some([direction, direction]);
        };
        let at = |end: usize, angle: f64| {
            let [first, second] = arc.plane.axes();
            let (sine, cosine) = angle.sin_cos();
            let outwards = arc.radius[1] - arc.radius[0];
            let around = arc.sweep * arc.radius[end];
            let mut vector = along;
            vector[first] = outwards * cosine - around * sine;
            vector[second] = outwards * sine + around * cosine;
            unit(vector)
        };
        Some([at(0, arc.angle)?, at(1, arc.angle + arc.sweep)?])
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
        let normal = arc.plane.normal();
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

/// The angle of chords, a whole part of a quarter turn.
fn chord_angle(arc: Arc, tolerance: f64) -> f64 {
    let radius = arc.radius[0].max(arc.radius[1]);
    // The chord of an angle is radius * (1 - cos(angle / 2)) from its arc. At least four a turn, whatever the tolerance.
    let half = (1.0 - tolerance / radius).max(0.5).acos();
    let quarter = std::f64::consts::FRAC_PI_2;
    quarter / (quarter / (2.0 * half)).ceil().clamp(1.0, 250_000.0)
}

#[expect(clippy::cast_precision_loss, reason = "far below 2^52")]
fn exact(index: i64) -> f64 {
    index as f64
}

fn mix(from: f64, to: f64, part: f64) -> f64 {
    from + (to - from) * part
}

fn distance(from: [f64; 3], to: [f64; 3]) -> f64 {
    (to[0] - from[0])
        .hypot(to[1] - from[1])
        .hypot(to[2] - from[2])
}
