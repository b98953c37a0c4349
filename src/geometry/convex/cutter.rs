//! Round cutters as convex solids with lattice vertices. The anchor of a cutter, its origin, is the centre of its tip; it points down.
//!
//! A cutter is a stack of rings: polygons that stand for circles, each at a height.
//!
//! ```text
//!     |     |  shank                    length  |     |
//!     |     |                                   |     |
//!      \   /   rings on an arc (ball, bull)      \   /   a cone (vee, drill, tapered)
//!       ‾o‾    the lowest ring at the tip         \o/    the tip, flat or a point
//! ```
//!
//! Where it costs no more accuracy than the polygons do, all rings are integer multiples of one polygon: the facets between two rings are
//! then plane trapezoids, each one facet and not two.

use super::fixed::cosine_and_sine;
use super::limits::EXTENT_MAX;
use super::point::Point;
use super::polygon::{Deviation, Fit, LENGTH_BITS, Length, Polygon, root_up};
use super::solid::{InvalidSolid, Solid};

/// A round cutter. Units: steps.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Cutter {
    /// What its end is like.
    pub end: End,
    /// Diameter of its shank.
    pub diameter: u32,
    /// Height of the top of its shank above the tip.
    pub length: u32,
    /// Greatest number of sides of the polygons that stand for its circles. Range: 3 to [`SIDES_MAX`].
    pub sides: u16,
    /// Which polygons they are.
    pub fit: Fit,
}

/// The lower end of a [`Cutter`].
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum End {
    /// Flat: the cutter is a cylinder.
    Flat,
    /// A flat with a rounded corner; a ball when the corner's radius is half the diameter.
    Round {
        /// Twice the radius of the corner, in steps: at most the diameter.
        corner_diameter: u32,
        /// Rings from the tip to the shank, both included. Range: 2 to [`RINGS_MAX`].
        rings: u16,
    },
    /// A cone from the tip to the shank.
    Cone {
        /// Diameter of the flat tip, in steps; 0 for a point.
        tip_diameter: u32,
        /// The whole angle between opposite sides of the cone, in millionths of a degree. Range: above 0, below 180 degrees.
        angle: u32,
    },
}

/// Most sides of a polygon that stands for a circle.
pub const SIDES_MAX: u16 = 1024;

/// Most rings of a round end.
pub const RINGS_MAX: u16 = 64;

/// Half a turn in the units of [`End::Cone`]'s angle.
pub const STRAIGHT_ANGLE: u32 = 180_000_000;

/// Why there is no such cutter.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
pub enum InvalidCutter {
    /// The number of sides is out of range.
    #[error("sides = {sides} is outside 3 to {SIDES_MAX}")]
    Sides {
        /// The number that was offered.
        sides: u16,
    },
    /// The number of rings is out of range.
    #[error("rings = {rings} is outside 2 to {RINGS_MAX}")]
    Rings {
        /// The number that was offered.
        rings: u16,
    },
    /// The diameter is out of range.
    #[error("the diameter of {steps} steps is outside 1 to {EXTENT_MAX}")]
    Diameter {
        /// The number that was offered.
        steps: u32,
    },
    /// The corner does not fit the cutter.
    #[error(
        "the diameter of the corner, {corner_diameter} steps, is outside 1 to the cutter's {diameter}"
    )]
    Corner {
        /// Twice the corner's radius.
        corner_diameter: u32,
        /// The cutter's diameter.
        diameter: u32,
    },
    /// The tip is not narrower than the shank.
    #[error("the diameter of the tip, {tip_diameter} steps, is not below the cutter's {diameter}")]
    Tip {
        /// The tip's diameter.
        tip_diameter: u32,
        /// The cutter's diameter.
        diameter: u32,
    },
    /// The angle is out of range.
    #[error("the angle of {angle} millionths of a degree is not between 0 and {STRAIGHT_ANGLE}")]
    Angle {
        /// The angle that was offered.
        angle: u32,
    },
    /// The end is longer than the cutter.
    #[error(
        "the length of {length} steps leaves no shank above the end, which is {end} steps high"
    )]
    TooShort {
        /// The cutter's length.
        length: u32,
        /// The height of its end.
        end: i128,
    },
    /// What it makes is no solid.
    #[error(transparent)]
    Solid(#[from] InvalidSolid),
}

impl Cutter {
    /// The cutter as a solid, and how far it is from the round one: a bound of the distance of the two surfaces, shank's top apart.
    /// # Errors
    /// [`InvalidCutter`] by variant.
    pub fn solid(&self) -> Result<(Solid, Deviation), InvalidCutter> {
        let profile = self.profile()?;
        let rings = self.rings(&profile);
        let mut points = Vec::new();
        let mut deviation = Deviation::default();
        for ring in &rings {
            deviation = deviation.max(ring.polygon.deviation(ring.multiple, ring.radius));
            points.extend(ring.points(ring.height)?);
        }
        let shank = rings.last().expect("there is one at least");
        points.extend(shank.points(self.length.into())?);
        Ok((Solid::hull(&points)?, profile.deviation(deviation, &rings)))
    }

    /// Checks everything but the solid itself.
    fn profile(&self) -> Result<Profile, InvalidCutter> {
        let Self {
            diameter,
            length,
            sides,
            ..
        } = *self;
        if !(3..=SIDES_MAX).contains(&sides) {
            return Err(InvalidCutter::Sides { sides });
        }
        if !(1..=EXTENT_MAX).contains(&diameter.into()) {
            return Err(InvalidCutter::Diameter { steps: diameter });
        }
        let shank = half(diameter);
        let profile = match self.end {
            End::Flat => Profile {
                radii: vec![shank],
                form: Form::Flat,
            },
            End::Round {
                corner_diameter,
                rings,
            } => {
                if !(1..=diameter).contains(&corner_diameter) {
                    return Err(InvalidCutter::Corner {
                        corner_diameter,
                        diameter,
                    });
                }
                if !(2..=RINGS_MAX).contains(&rings) {
                    return Err(InvalidCutter::Rings { rings });
                }
                let corner = half(corner_diameter);
                // Equal angles; the lowest ring is 7/20 of one away from the axis of the arc, so that the flat that it makes at the tip
                // reaches out of the arc about half as far as the arc reaches out of the facets.
                let radius = |ring: u16| {
                    let part = 20 * u64::from(ring) + 7;
                    let [_, sine] = cosine_and_sine(part, 4 * (20 * u64::from(rings) - 13));
                    shank - corner + scaled(corner, sine)
                };
                Profile {
                    radii: (0..rings).map(radius).collect(),
                    form: Form::Arc { corner },
                }
            }
            End::Cone {
                tip_diameter,
                angle,
            } => {
                if tip_diameter >= diameter {
                    return Err(InvalidCutter::Tip {
                        tip_diameter,
                        diameter,
                    });
                }
                if !(1..STRAIGHT_ANGLE).contains(&angle) {
                    return Err(InvalidCutter::Angle { angle });
                }
                let tip = half(tip_diameter);
                let [cosine, sine] = cosine_and_sine(angle.into(), 4 * u64::from(STRAIGHT_ANGLE));
                Profile {
                    radii: vec![tip, shank],
                    form: Form::Cone {
                        height: i128::from(shank - tip) * cosine / sine,
                    },
                }
            }
        };
        let end = match profile.form {
            Form::Flat => 0,
            Form::Arc { corner } => corner.into(),
            Form::Cone { height } => height,
        };
        let end = (end + HALF_STEP) >> LENGTH_BITS;
        if end >= i128::from(length) {
            return Err(InvalidCutter::TooShort { length, end });
        }
        Ok(profile)
    }

    /// The rings from the tip to the lower end of the shank.
    fn rings(&self, profile: &Profile) -> Vec<Ring> {
        let polygon = |radius: Length| Polygon::of_circle(radius, self.sides, self.fit);
        let shank = half(self.diameter);
        let [cosine, _] = cosine_and_sine(1, 2 * u64::from(self.sides));
        let of_polygon = shank - scaled(shank, cosine);
        let independent = profile.error(&profile.radii) + HALF_LENGTH;
        let best = (1..=MULTIPLE_MAX)
            .filter_map(|greatest| {
                let multiples = profile.multiples(greatest)?;
                let radii = radii_of(&multiples, shank);
                // Rounding displaces the polygon's vertices by about half a step, and the greatest ring's by so many times as much.
                let error = profile.error(&radii) + greatest * HALF_LENGTH;
                Some((error, multiples))
            })
            .min();
        let multiples = best
            .filter(|(error, _)| *error <= independent + of_polygon)
            .map(|(_, multiples)| multiples);
        let radii = match (&profile.form, &multiples) {
            // The ends of a cone are where they are; on an arc a ring is right at any radius that its height goes with.
            (Form::Arc { .. }, Some(multiples)) => radii_of(multiples, shank),
            _ => profile.radii.clone(),
        };
        let heights = profile.heights(&radii);
        let shared = multiples.map(|multiples| {
            let greatest = multiples[multiples.len() - 1];
            (polygon(shank / greatest), multiples)
        });
        let ring = |(index, (&radius, height)): (usize, (&Length, i64))| {
            let (polygon, multiple) = match &shared {
                Some((polygon, multiples)) => (polygon.clone(), multiples[index]),
                None => (polygon(radius), 1),
            };
            Ring {
                polygon,
                multiple,
                radius,
                height,
            }
        };
        radii.iter().zip(heights).enumerate().map(ring).collect()
    }
}

/// A disc or a truncated cone around the z axis, between two polygons that stand for circles: a piece of a tool. Each end has a diameter and
/// a height, in steps; one of the diameters may be 0.
/// # Errors
/// [`InvalidCutter`] by variant; [`InvalidCutter::Solid`] when there is no volume between the ends.
pub fn cone(
    ends: [(u32, i64); 2],
    sides: u16,
    fit: Fit,
) -> Result<(Solid, Deviation), InvalidCutter> {
    if !(3..=SIDES_MAX).contains(&sides) {
        return Err(InvalidCutter::Sides { sides });
    }
    let mut points = Vec::new();
    let mut deviation = Deviation::default();
    for (diameter, height) in ends {
        if i64::from(diameter) > EXTENT_MAX {
            return Err(InvalidCutter::Diameter { steps: diameter });
        }
        if diameter == 0 {
            points.push(Point::new([0, 0, height]).map_err(InvalidSolid::from)?);
            continue;
        }
        let radius = half(diameter);
        let ring = Ring {
            polygon: Polygon::of_circle(radius, sides, fit),
            multiple: 1,
            radius,
            height,
        };
        deviation = deviation.max(ring.polygon.deviation(1, radius));
        points.extend(ring.points(height)?);
    }
    Ok((Solid::hull(&points)?, deviation))
}

/// Half a step as a length.
const HALF_LENGTH: Length = 1 << (LENGTH_BITS - 1);
const HALF_STEP: i128 = 1 << (LENGTH_BITS - 1);

/// Greatest multiple of a polygon that is tried. Beyond it the polygon's own rounding is worse than facets that are not plane.
const MULTIPLE_MAX: i64 = 256;

/// Half a number of steps.
fn half(steps: u32) -> Length {
    i64::from(steps) << (LENGTH_BITS - 1)
}

/// A length times a sine or cosine.
fn scaled(length: Length, factor: i128) -> Length {
    i64::try_from((i128::from(length) * factor) >> 60).expect("not longer than the length")
}

/// The radii of rings that are multiples of one polygon, of which the greatest has the shank's radius.
fn radii_of(multiples: &[i64], shank: Length) -> Vec<Length> {
    let greatest = multiples[multiples.len() - 1];
    multiples
        .iter()
        .map(|multiple| shank * multiple / greatest)
        .collect()
}

/// A polygon at a height.
#[derive(Debug)]
struct Ring {
    polygon: Polygon,
    multiple: i64,
    /// The radius of the round cutter there.
    radius: Length,
    /// In steps above the tip.
    height: i64,
}

impl Ring {
    /// Its vertices at a height.
    fn points(&self, height: i64) -> Result<Vec<Point>, InvalidSolid> {
        let vertices = self.polygon.vertices().iter();
        let point =
            |&[x, y]: &[i64; 2]| Ok(Point::new([x * self.multiple, y * self.multiple, height])?);
        vertices.map(point).collect()
    }
}

/// The outline of a cutter's end, from the tip to the shank.
#[derive(Debug)]
struct Profile {
    /// Where its rings should be: their radii, increasing.
    radii: Vec<Length>,
    form: Form,
}

/// What the outline is between the tip and the shank.
#[derive(Debug)]
enum Form {
    Flat,
    Arc { corner: Length },
    Cone { height: i128 },
}

impl Profile {
    /// The radii as multiples of a part of the greatest, rounded; none when two would be the same.
    fn multiples(&self, greatest: i64) -> Option<Vec<i64>> {
        let shank = self.radii[self.radii.len() - 1];
        let rounded = |&radius: &Length| (2 * radius * greatest + shank) / (2 * shank);
        let multiples: Vec<_> = self.radii.iter().map(rounded).collect();
        let vanishes = multiples[0] == 0 && self.radii[0] != 0;
        let increase = multiples.is_sorted_by(|a, b| a < b);
        (increase && !vanishes).then_some(multiples)
    }

    /// How far the outline through rings of these radii is from the true one.
    fn error(&self, radii: &[Length]) -> Length {
        match self.form {
            Form::Flat => 0,
            Form::Cone { .. } => (radii[0] - self.radii[0]).abs(),
            Form::Arc { corner } => self.sagitta(corner, radii),
        }
    }

    /// The height of each ring in steps; the lowest is at the tip.
    fn heights(&self, radii: &[Length]) -> Vec<i64> {
        let height = |(index, &radius): (usize, &Length)| match self.form {
            _ if index == 0 => 0,
            Form::Flat => 0,
            Form::Cone { height } => height,
            Form::Arc { corner } => self.rise(corner, radius),
        };
        let steps = |height: i128| {
            i64::try_from((height + HALF_STEP) >> LENGTH_BITS).expect("below the cutter's length")
        };
        radii.iter().enumerate().map(height).map(steps).collect()
    }

    /// How high the arc is at a radius.
    fn rise(&self, corner: Length, radius: Length) -> i128 {
        let corner = i128::from(corner);
        let beside = self.beside_centre(corner, radius);
        corner - (corner * corner - beside * beside).isqrt()
    }

    /// The distance of a radius from the centre of the arc.
    fn beside_centre(&self, corner: i128, radius: Length) -> i128 {
        let shank = self.radii[self.radii.len() - 1];
        (i128::from(radius - shank) + corner).clamp(0, corner)
    }

    /// How far the arc bulges out of the chords between rings, at most.
    fn sagitta(&self, corner: Length, radii: &[Length]) -> Length {
        let mut greatest = 0;
        for pair in radii.windows(2) {
            let across = i128::from(pair[1] - pair[0]);
            let up = self.rise(corner, pair[1]) - self.rise(corner, pair[0]);
            let corner = i128::from(corner);
            let squared = corner * corner - (across * across + up * up) / 4;
            greatest = greatest.max(corner - squared.max(0).isqrt());
        }
        i64::try_from(greatest).expect("at most the corner's radius")
    }

    /// The deviation of the whole from that of its rings in their planes.
    fn deviation(&self, of_rings: Deviation, rings: &[Ring]) -> Deviation {
        let radii: Vec<_> = rings.iter().map(|ring| ring.radius).collect();
        let (outside, inside) = match self.form {
            Form::Flat => return of_rings,
            Form::Cone { .. } => (0, 0),
            Form::Arc { corner } => {
                // The flat at the tip reaches out of the arc most at its rim.
                let wide = i128::from(corner);
                let across = self.beside_centre(wide, radii[0]);
                let rim = root_up(wide * wide + across * across);
                (rim - wide, i128::from(self.sagitta(corner, &radii)))
            }
        };
        // The heights are rounded to the lattice.
        let whole = |ring: u64, outline: i128| {
            ring + u64::try_from(outline + HALF_STEP).expect("not negative")
        };
        Deviation {
            outside: whole(of_rings.outside, outside),
            inside: whole(of_rings.inside, inside),
        }
    }
}
