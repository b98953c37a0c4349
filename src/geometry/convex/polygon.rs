//! Polygons with lattice vertices that stand for circles.

use super::fixed::{ONE, PI, cosine_and_sine, product, root};
use super::limits::EXTENT_MAX;

/// Which polygon stands for a circle.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub enum Fit {
    /// The regular polygon of the circle's area, its vertices rounded to the lattice.
    #[default]
    EqualArea,
    /// A polygon inside the circle, its vertices at most a step and a half away from it.
    Inscribed,
    /// A polygon around the circle, its sides at most a step and a half away from it.
    Circumscribed,
}

/// How far a polygonal body is from the round one, at most. Units: `2^-20` steps, rounded up.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Deviation {
    /// How far it reaches out of the round one.
    pub outside: u64,
    /// How far the round one reaches out of it.
    pub inside: u64,
}

impl Deviation {
    /// How many units a step has.
    pub const STEP: u64 = 1 << LENGTH_BITS;

    /// The greater of each.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self {
            outside: self.outside.max(other.outside),
            inside: self.inside.max(other.inside),
        }
    }
}

/// Bits after the point of a length.
pub(super) const LENGTH_BITS: u32 = 20;

/// A length in units of `2^-20` steps. Range: from 0 to below `2^42`.
pub(super) type Length = i64;

const _: () = assert!(EXTENT_MAX.ilog2() + LENGTH_BITS < 42);

/// A strictly convex polygon around the origin, counterclockwise. Units: steps.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Polygon(Vec<[i64; 2]>);

impl Polygon {
    /// The polygon with at most `sides` sides that stands for the circle of this radius, with a side across the positive x axis.
    /// A small circle has fewer, because lattice points in line with others are left out.
    /// Range: from 3 sides; a radius below `2^41`.
    pub(super) fn of_circle(radius: Length, sides: u16, fit: Fit) -> Self {
        let sides = u64::from(sides);
        let [cosine, sine] = cosine_and_sine(1, 2 * sides);
        let stretch = match fit {
            // The circle's area is pi r^2, the regular polygon's (sides / 2) sin(2 pi / sides) r^2.
            Fit::EqualArea => root(PI * ONE / (i128::from(sides) * product(cosine, sine))),
            Fit::Inscribed => ONE,
            Fit::Circumscribed => ONE * ONE / cosine,
        };
        // Rounding displaces a vertex by less than 3/4 of a step, so a few attempts a quarter apart settle it.
        let quarter = 1 << (LENGTH_BITS - 2);
        (0..)
            .find_map(|attempt| {
                let corrected = match fit {
                    Fit::EqualArea => radius,
                    Fit::Inscribed => (radius - attempt * quarter).max(0),
                    Fit::Circumscribed => radius + attempt * quarter,
                };
                let polygon = Self::regular(i128::from(corrected), stretch, sides);
                let deviation = polygon.deviation(1, radius);
                let fits = match fit {
                    Fit::EqualArea => true,
                    Fit::Inscribed => deviation.outside == 0,
                    Fit::Circumscribed => deviation.inside == 0,
                };
                fits.then_some(polygon)
            })
            .expect("the attempts end")
    }

    /// The regular polygon with vertices at `radius * stretch`, rounded.
    fn regular(radius: i128, stretch: i128, sides: u64) -> Self {
        let rounded = |part: i128| {
            // Half away from zero. `part` has 60 bits after the point and the radius 20.
            let scaled = product(part.abs(), stretch) * radius;
            let steps = (scaled + (1 << 79)) >> 80;
            i64::try_from(steps * part.signum()).expect("below the greatest extent")
        };
        let vertices = (0..sides)
            .map(|number| cosine_and_sine(2 * number + 1, 2 * sides).map(rounded))
            .collect();
        Self(strictly_convex(vertices))
    }

    pub(super) fn vertices(&self) -> &[[i64; 2]] {
        &self.0
    }

    /// How far the polygon, `multiple` times as large, is from the circle of a radius.
    pub(super) fn deviation(&self, multiple: i64, radius: Length) -> Deviation {
        let mut deviation = Deviation::default();
        let radius = i128::from(radius);
        let squared = |number: i64| i128::from(number) * i128::from(number);
        for (index, &[x, y]) in self.0.iter().enumerate() {
            let next = self.0[(index + 1) % self.0.len()];
            let (dx, dy) = (next[0] - x, next[1] - y);
            let to_vertex = (squared(multiple) * (squared(x) + squared(y))) << (2 * LENGTH_BITS);
            let doubled_area = multiple * (x * next[1] - y * next[0]);
            let to_side = if doubled_area > 0 {
                (squared(doubled_area) << (2 * LENGTH_BITS)) / (squared(dx) + squared(dy))
            } else {
                0
            };
            let outside = root_up(to_vertex) - radius;
            let inside = radius - to_side.isqrt();
            deviation = deviation.max(Deviation {
                outside: u64::try_from(outside).unwrap_or(0),
                inside: u64::try_from(inside).unwrap_or(0),
            });
        }
        deviation
    }
}

/// The square root, rounded up.
pub(super) fn root_up(number: i128) -> i128 {
    let root = number.isqrt();
    root + i128::from(root * root < number)
}

/// The vertices of the convex hull of points in counterclockwise order around the origin, some perhaps in line or repeated.
fn strictly_convex(mut points: Vec<[i64; 2]>) -> Vec<[i64; 2]> {
    points.dedup();
    // Points that are not outside the line through their neighbours go until none is left.
    loop {
        let count = points.len();
        let stays = |index: usize| {
            let [before, here, after] =
                [count - 1, 0, 1].map(|step| points[(index + step) % count]);
            let (a, b) = (
                [here[0] - before[0], here[1] - before[1]],
                [after[0] - here[0], after[1] - here[1]],
            );
            a[0] * b[1] - a[1] * b[0] > 0
        };
        match (0..count).find(|&index| count > 2 && !stays(index)) {
            Some(index) => {
                points.remove(index);
            }
            None => return points,
        }
    }
}
