//! Cutter compensation: the path of the cutter's centre beside the programmed contour.
//!
//! ```text
//!   outside corner                inside corner
//!        ___________                 |  cutter
//!       /   arc                      |____________ new end of the move before, new start of the next
//!      |  _________                  . ___________
//!      | |  contour                  .|   contour
//! ```
//!
//! Outside corners are rounded by an arc about the corner, inside corners cut where the two paths cross. So a move is known only
//! when the next has come: one is always held back, with what followed it without moving sideways. The first move, a straight one,
//! ends square beside its programmed end; after G40 the next move starts where the cutter is. That is `LinuxCNC`'s way; other
//! controllers may join outside corners by straight lines, which takes away no more of the contour.

use super::codes::Side;
use super::path::Motion;

/// Angles smaller than this turn no corner: the cutter goes on from where it is. Units: radians.
///
/// # Source
/// `LinuxCNC`. Within the corner the cutter strays by less than a thousandth of its radius.
const STRAIGHT_ON: f64 = 0.05;

/// Angles nearer to half a turn than this turn back: the cutter goes around the end of the move. Units: radians.
///
/// `LinuxCNC` takes what turns back up to [`STRAIGHT_ON`] for an outside corner between straight moves; an inside corner among them would
/// be cut away.
const TURNS_BACK: f64 = 1e-6;

/// Points nearer to each other than this are one. Units: mm.
const SAME_POINT: f64 = 1e-9;

/// A move of the program in the XY plane, between points in mm.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Piece {
    pub(super) line: u64,
    pub(super) motion: Motion,
    pub(super) start: [f64; 3],
    pub(super) end: [f64; 3],
    pub(super) shape: Shape,
    /// As the program says it: a speed, or moves a minute.
    pub(super) feed: Option<f64>,
}

/// The shape of a move.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum Shape {
    Line,
    Arc {
        centre: [f64; 2],
        radius: f64,
        counterclockwise: bool,
        /// Full turns more than one.
        turns: f64,
    },
}

/// What comes out, in order.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum Step {
    Move(Piece),
    Dwell { line: u64, seconds: f64 },
}

/// A compensation in force.
#[derive(Clone, Debug)]
pub(super) struct Compensator {
    side: Side,
    radius: f64,
    /// Where the cutter is once all that came out is done.
    actual: [f64; 3],
    held: Option<Held>,
    /// What follows the move held back.
    tail: Vec<Step>,
}

/// A move whose end is not known yet.
#[derive(Clone, Copy, Debug)]
struct Held {
    piece: Piece,
    /// Where it starts and, without a corner, ends beside the contour.
    from: [f64; 2],
    to: [f64; 2],
}

impl Compensator {
    /// Of a cutter that stands at `actual`. A negative radius is on the other side.
    pub(super) fn new(side: Side, radius: f64, actual: [f64; 3]) -> Self {
        let side = match side {
            side if radius >= 0.0 => side,
            Side::Left => Side::Right,
            Side::Right => Side::Left,
        };
        Self {
            side,
            radius: radius.abs(),
            actual,
            held: None,
            tail: Vec::new(),
        }
    }

    /// Where the cutter is once everything that has come in is done, when nothing more comes.
    pub(super) fn end(self, out: &mut Vec<Step>) -> [f64; 3] {
        let mut this = self;
        if let Some(held) = this.held.take() {
            this.release(held, held.to, out);
        }
        this.actual
    }

    pub(super) fn dwell(&mut self, line: u64, seconds: f64, out: &mut Vec<Step>) {
        self.put(Step::Dwell { line, seconds }, out);
    }

    /// Takes the next move; what is known by that comes out.
    ///
    /// # Errors
    /// A sentence when the cutter does not fit.
    pub(super) fn take(&mut self, piece: Piece, out: &mut Vec<Step>) -> Result<(), String> {
        let sideways =
            distance(flat(piece.start), flat(piece.end)) > SAME_POINT || piece.shape != Shape::Line;
        if !sideways {
            self.put(Step::Move(piece), out);
            return Ok(());
        }
        let start = self.beside(&piece, flat(piece.start));
        let to = self.beside(&piece, flat(piece.end));
        if self.radius_beside(piece.shape) <= 0.0 {
            return Err(format!(
                "the cutter (radius {:.4} mm) does not fit into the arc",
                self.radius
            ));
        }
        let Some(held) = self.held.take() else {
            if piece.shape != Shape::Line {
                return Err(
                    "cutter compensation must begin with a straight move, not with an arc".into(),
                );
            }
            if distance(flat(piece.start), flat(piece.end)) < self.radius - SAME_POINT {
                return Err(format!(
                    "the first move with cutter compensation is shorter than the cutter's radius of {:.4} mm",
                    self.radius
                ));
            }
            let from = flat(self.actual);
            self.held = Some(Held { piece, from, to });
            return Ok(());
        };
        let corner = flat(piece.start);
        let before = tangent(&held.piece, corner);
        let after = tangent(&piece, corner);
        let sine = before[0] * after[1] - before[1] * after[0];
        let cosine = before[0] * after[0] + before[1] * after[1];
        let corner_angle = sine.atan2(cosine) * self.sign();
        let mut from = start;
        if corner_angle.abs() < STRAIGHT_ON {
            from = held.to;
            self.release(held, held.to, out);
        } else if corner_angle > 0.0 && corner_angle < std::f64::consts::PI - TURNS_BACK {
            from = self.crossing(&held, &piece, to)?;
            self.release(held, from, out);
        } else {
            self.release(held, held.to, out);
            let arc = Shape::Arc {
                centre: corner,
                radius: self.radius,
                counterclockwise: self.side == Side::Right,
                turns: 0.0,
            };
            let around = Piece {
                motion: Motion::Arc,
                start: self.actual,
                end: [start[0], start[1], self.actual[2]],
                shape: arc,
                ..piece
            };
            self.actual = around.end;
            out.push(Step::Move(around));
        }
        self.held = Some(Held { piece, from, to });
        Ok(())
    }

    /// Lets something through that does not move sideways: at once, or after the move held back.
    fn put(&mut self, step: Step, out: &mut Vec<Step>) {
        if self.held.is_some() {
            self.tail.push(step);
        } else {
            self.pass(step, out);
        }
    }

    fn pass(&mut self, step: Step, out: &mut Vec<Step>) {
        if let Step::Move(mut piece) = step {
            piece.start = self.actual;
            piece.end = [self.actual[0], self.actual[1], piece.end[2]];
            self.actual = piece.end;
            out.push(Step::Move(piece));
        } else {
            out.push(step);
        }
    }

    /// Lets the move held back end at a point, and what follows it.
    fn release(&mut self, held: Held, end: [f64; 2], out: &mut Vec<Step>) {
        let mut piece = held.piece;
        piece.start = [held.from[0], held.from[1], self.actual[2]];
        piece.end = [end[0], end[1], held.piece.end[2]];
        self.actual = piece.end;
        out.push(Step::Move(piece));
        for step in std::mem::take(&mut self.tail) {
            self.pass(step, out);
        }
    }

    /// Where the paths beside two moves cross, nearest to their inside corner.
    fn crossing(&self, held: &Held, next: &Piece, to: [f64; 2]) -> Result<[f64; 2], String> {
        let corner = flat(next.start);
        let found = crossings(self.path(&held.piece), self.path(next));
        let nearest = found
            .into_iter()
            .flatten()
            .min_by(|one, other| distance(*one, corner).total_cmp(&distance(*other, corner)));
        let fits = |point: &[f64; 2]| {
            let before = held.piece.shape;
            let is_ahead = match before {
                Shape::Line => dot(minus(*point, held.from), minus(held.to, held.from)) > 0.0,
                Shape::Arc { .. } => {
                    turned(before, held.from, *point) <= turned(before, held.from, held.to) + 1e-9
                }
            };
            let start = self.beside(next, corner);
            let is_left = match next.shape {
                Shape::Line => dot(minus(to, *point), minus(to, start)) > 0.0,
                Shape::Arc { .. } => {
                    turned(next.shape, *point, to) <= turned(next.shape, start, to) + 1e-9
                }
            };
            is_ahead && is_left
        };
        nearest.filter(fits).ok_or_else(|| {
            format!(
                "the cutter (radius {:.4} mm) does not fit into the inside corner at X{:.4} Y{:.4} mm",
                self.radius, corner[0], corner[1]
            )
        })
    }

    fn sign(&self) -> f64 {
        match self.side {
            Side::Left => 1.0,
            Side::Right => -1.0,
        }
    }

    /// The point beside a point of a move.
    fn beside(&self, piece: &Piece, at: [f64; 2]) -> [f64; 2] {
        let [x, y] = tangent(piece, at);
        let aside = self.sign() * self.radius;
        [at[0] - y * aside, at[1] + x * aside]
    }

    /// The line or circle beside a move.
    fn path(&self, piece: &Piece) -> Path {
        match piece.shape {
            Shape::Line => Path::Line {
                through: self.beside(piece, flat(piece.end)),
                along: tangent(piece, flat(piece.end)),
            },
            Shape::Arc { centre, .. } => Path::Circle {
                centre,
                radius: self.radius_beside(piece.shape),
            },
        }
    }

    /// The radius of the path beside an arc, less than zero when the cutter does not fit.
    fn radius_beside(&self, shape: Shape) -> f64 {
        match shape {
            Shape::Line => f64::INFINITY,
            Shape::Arc {
                radius,
                counterclockwise,
                ..
            } => {
                let inside = counterclockwise == (self.side == Side::Left);
                radius + if inside { -self.radius } else { self.radius }
            }
        }
    }
}

/// What runs beside a move, without ends.
#[derive(Clone, Copy)]
enum Path {
    Line { through: [f64; 2], along: [f64; 2] },
    Circle { centre: [f64; 2], radius: f64 },
}

/// Where two paths cross.
fn crossings(one: Path, other: Path) -> [Option<[f64; 2]>; 2] {
    match (one, other) {
        (
            Path::Line { through, along },
            Path::Line {
                through: second,
                along: direction,
            },
        ) => {
            let across = along[0] * direction[1] - along[1] * direction[0];
            let between = minus(second, through);
            let part = (between[0] * direction[1] - between[1] * direction[0]) / across;
            [
                (across.abs() > f64::EPSILON).then(|| plus(through, along, part)),
                None,
            ]
        }
        (Path::Line { through, along }, Path::Circle { centre, radius })
        | (Path::Circle { centre, radius }, Path::Line { through, along }) => {
            let foot = plus(through, along, dot(minus(centre, through), along));
            let height = distance(foot, centre);
            half_chord(radius, height).map_or([None; 2], |half| {
                [half, -half].map(|part| Some(plus(foot, along, part)))
            })
        }
        (
            Path::Circle { centre, radius },
            Path::Circle {
                centre: second,
                radius: second_radius,
            },
        ) => {
            let apart = distance(centre, second);
            if apart < SAME_POINT {
                return [None; 2];
            }
            let along = minus(second, centre).map(|part| part / apart);
            let to_chord =
                (apart * apart + radius * radius - second_radius * second_radius) / (2.0 * apart);
            let foot = plus(centre, along, to_chord);
            let aside = [-along[1], along[0]];
            half_chord(radius, to_chord.abs()).map_or([None; 2], |half| {
                [half, -half].map(|part| Some(plus(foot, aside, part)))
            })
        }
    }
}

/// Half of the chord of a circle at a distance from its centre; a hair outside counts as touching.
fn half_chord(radius: f64, height: f64) -> Option<f64> {
    let square = radius * radius - height * height;
    (square > -1e-9 * radius.max(1.0)).then(|| square.max(0.0).sqrt())
}

/// The direction in which a move passes a point of it.
fn tangent(piece: &Piece, at: [f64; 2]) -> [f64; 2] {
    let direction = match piece.shape {
        Shape::Line => minus(flat(piece.end), flat(piece.start)),
        Shape::Arc {
            centre,
            counterclockwise,
            ..
        } => {
            let [x, y] = minus(at, centre);
            if counterclockwise { [-y, x] } else { [y, -x] }
        }
    };
    let length = direction[0].hypot(direction[1]);
    direction.map(|part| part / length)
}

/// The angle an arc turns through from one point to another. Units: radians, from 0 to a full turn.
fn turned(shape: Shape, from: [f64; 2], to: [f64; 2]) -> f64 {
    let Shape::Arc {
        centre,
        counterclockwise,
        ..
    } = shape
    else {
        return 0.0;
    };
    let angle = |point: [f64; 2]| {
        let [x, y] = minus(point, centre);
        y.atan2(x)
    };
    let turned = angle(to) - angle(from);
    let turned = if counterclockwise { turned } else { -turned };
    let around = turned.rem_euclid(std::f64::consts::TAU);
    // Ends that are one point are a full circle, and the last bit of an angle is no turn.
    if around < 1e-9 {
        std::f64::consts::TAU
    } else {
        around
    }
}

fn flat(point: [f64; 3]) -> [f64; 2] {
    [point[0], point[1]]
}

fn minus(one: [f64; 2], other: [f64; 2]) -> [f64; 2] {
    [one[0] - other[0], one[1] - other[1]]
}

fn plus(point: [f64; 2], along: [f64; 2], part: f64) -> [f64; 2] {
    [point[0] + along[0] * part, point[1] + along[1] * part]
}

fn dot(one: [f64; 2], other: [f64; 2]) -> f64 {
    one[0] * other[0] + one[1] * other[1]
}

fn distance(one: [f64; 2], other: [f64; 2]) -> f64 {
    (one[0] - other[0]).hypot(one[1] - other[1])
}
