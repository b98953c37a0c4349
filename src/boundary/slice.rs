//! What a plane cuts of a union: polygons with holes, from the sections of the bodies.
//!
//! The union in the plane is that of the crate `i_overlay`, over integers of 64 bits: where two edges cross, the crossing is rounded to the grid of
//! [`super::section`], `2^-30` of a lattice step. Edges along the axes cross in lattice points, so that the slice of boxes whose corners are
//! lattice points is exact, and so are its area and perimeter until they become floats.
//!
//! Rings so thin that rounding alone can make them, four grid steps or less, are left out: between solids that share an oblique facet in
//! different pieces there is no crack.

use i_overlay::core::fill_rule::FillRule;
use i_overlay::core::overlay::{IntOverlayOptions, Overlay, ShapeType};
use i_overlay::core::overlay_rule::OverlayRule;
use i_overlay::core::solver::Solver;

use super::Region;
use super::section::{GRID_BITS, GridPoint, Polygon};

/// Mean width of a ring that rounding alone may have made. Units: grid steps.
const THIN_MAX: f64 = 4.0;

/// Greatest coordinate of what is laid over each other, in grid steps.
const OVERLAID_MAX: i128 = 1 << 61;

/// A polygon with holes.
#[derive(Clone, PartialEq, Debug)]
pub struct Shape {
    /// Its outline, counterclockwise.
    pub outer: Polygon,
    /// Its holes, clockwise.
    pub holes: Vec<Polygon>,
}

/// A set of polygons that have no area in common.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Slice {
    /// The polygons.
    pub shapes: Vec<Shape>,
}

/// Two slices over each other, every point in one of the three.
#[derive(Clone, PartialEq, Debug)]
pub struct Overlaid {
    /// What is in the first alone.
    pub first: Slice,
    /// What is in the second alone.
    pub second: Slice,
    /// What is in both.
    pub both: Slice,
}

/// A coordinate would be farther out than 61 bits of the grid.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("the two scales are too far apart for where the polygons are")]
pub struct TooFar;

fn options() -> IntOverlayOptions<u128> {
    IntOverlayOptions {
        // Rings touch themselves nowhere, as other tools want it.
        ogc: true,
        ..IntOverlayOptions::default()
    }
}

impl Slice {
    /// The slice of a region, from the sections of all bodies that have one, counterclockwise, and that of the stock, if any: without one
    /// nothing is removed, and nothing remains. O(n log n) for n corners and crossings.
    pub fn of(sections: &[Polygon], stock: Option<&Polygon>, region: Region) -> Self {
        let corners = sections.iter().chain(stock).map(Vec::len).sum();
        let mut overlay = Overlay::new_custom(corners, options(), Solver::default());
        for section in sections {
            overlay.add_contour(section, ShapeType::Subject);
        }
        if let Some(section) = stock {
            overlay.add_contour(section, ShapeType::Clip);
        }
        let rule = match region {
            Region::Union => OverlayRule::Subject,
            Region::Removed => OverlayRule::Intersect,
            Region::Remaining => OverlayRule::InverseDifference,
        };
        Self::from_shapes(overlay.overlay(rule, FillRule::NonZero))
    }

    fn from_shapes(shapes: Vec<Vec<Polygon>>) -> Self {
        let shapes = shapes.into_iter().filter_map(|rings| {
            let mut rings = rings.into_iter();
            let outer = rings.next().filter(|ring| !is_thin(ring))?;
            let holes = rings.filter(|ring| !is_thin(ring));
            Some(Shape {
                outer: turned(outer, true),
                holes: holes.map(|hole| turned(hole, false)).collect(),
            })
        });
        Self {
            shapes: shapes.collect(),
        }
    }

    /// Its rings, outlines and holes.
    pub fn rings(&self) -> impl Iterator<Item = &Polygon> {
        self.shapes
            .iter()
            .flat_map(|shape| std::iter::once(&shape.outer).chain(&shape.holes))
    }

    /// Twice its area. Units: grid steps squared. Exact.
    pub fn area2(&self) -> i128 {
        self.rings().map(|ring| area2(ring)).sum()
    }

    /// Its area. Units: lattice steps squared. The float nearest to the exact one.
    pub fn area(&self) -> f64 {
        float(self.area2()) * grid_power(-2) / 2.0
    }

    /// The length of its rings. Units: lattice steps. Of edges along the axes exact before it becomes a float; of others a sum of rounded ones.
    pub fn perimeter(&self) -> f64 {
        let (mut straight, mut oblique) = (0_i128, 0.0);
        for ring in self.rings() {
            for [dx, dy] in sides(ring) {
                if dx == 0 || dy == 0 {
                    straight += (dx + dy).abs();
                } else {
                    oblique += float(dx).hypot(float(dy));
                }
            }
        }
        (float(straight) + oblique) * grid_power(-1)
    }

    /// The same where a lattice step has `over / under` as many grid steps: each coordinate is the nearest one, half-way up.
    /// # Errors
    /// [`TooFar`] beyond `2^61`.
    pub fn scaled(&self, over: u32, under: u32) -> Result<Self, TooFar> {
        let (over, under) = (i128::from(over), i128::from(under));
        let coordinate = |from: i64| {
            let scaled = (2 * i128::from(from) * over + under).div_euclid(2 * under);
            let near = scaled.abs() <= OVERLAID_MAX;
            let scaled = i64::try_from(scaled).ok().filter(|_| near);
            scaled.ok_or(TooFar)
        };
        let ring = |ring: &Polygon| {
            let points = ring.iter();
            let point =
                |point: &GridPoint| Ok(GridPoint::new(coordinate(point.x)?, coordinate(point.y)?));
            points.map(point).collect::<Result<Polygon, TooFar>>()
        };
        let shape = |shape: &Shape| {
            Ok(Shape {
                outer: ring(&shape.outer)?,
                holes: shape.holes.iter().map(ring).collect::<Result<_, _>>()?,
            })
        };
        Ok(Self {
            shapes: self.shapes.iter().map(shape).collect::<Result<_, _>>()?,
        })
    }

    /// This slice and another over each other: what only one of them has, and what both have. O(n log n) for n corners and crossings.
    pub fn over(&self, other: &Self) -> Overlaid {
        let corners = self.rings().chain(other.rings()).map(Vec::len).sum();
        let mut overlay = Overlay::new_custom(corners, options(), Solver::default());
        for ring in self.rings() {
            overlay.add_contour(ring, ShapeType::Subject);
        }
        for ring in other.rings() {
            overlay.add_contour(ring, ShapeType::Clip);
        }
        let mut buffer = overlay.boolean_buffer.take().unwrap_or_default();
        let Some(graph) = overlay.build_graph_view(FillRule::NonZero) else {
            return Overlaid {
                first: Self::default(),
                second: Self::default(),
                both: Self::default(),
            };
        };
        let mut of = |rule| Self::from_shapes(graph.extract_shapes(rule, &mut buffer));
        Overlaid {
            first: of(OverlayRule::Difference),
            second: of(OverlayRule::InverseDifference),
            both: of(OverlayRule::Intersect),
        }
    }
}

/// The ring in the direction that it should have.
fn turned(mut ring: Polygon, counterclockwise: bool) -> Polygon {
    if (area2(&ring) > 0) != counterclockwise {
        ring.reverse();
    }
    ring
}

/// From each corner to the next.
fn sides(ring: &[GridPoint]) -> impl Iterator<Item = [i128; 2]> {
    let next = ring.iter().cycle().skip(1);
    ring.iter().zip(next).map(|(from, to)| {
        [
            i128::from(to.x) - i128::from(from.x),
            i128::from(to.y) - i128::from(from.y),
        ]
    })
}

/// Twice the area of a ring, positive when it is counterclockwise. Below `2^125`; sums on the way may be beyond what fits and come back.
fn area2(ring: &[GridPoint]) -> i128 {
    let Some(first) = ring.first() else {
        return 0;
    };
    let from_first = |point: &GridPoint| {
        [
            i128::from(point.x) - i128::from(first.x),
            i128::from(point.y) - i128::from(first.y),
        ]
    };
    ring.windows(2).fold(0_i128, |sum, pair| {
        let ([ax, ay], [bx, by]) = (from_first(&pair[0]), from_first(&pair[1]));
        sum.wrapping_add((ax * by).wrapping_sub(ay * bx))
    })
}

/// Whether rounding alone can have made a ring.
fn is_thin(ring: &[GridPoint]) -> bool {
    let around: f64 = sides(ring).map(|[dx, dy]| float(dx).hypot(float(dy))).sum();
    // A long thin ring is as wide as its area over half of its length.
    float(area2(ring).abs()) <= THIN_MAX * around
}

/// A power of the grid steps in a lattice step.
fn grid_power(power: i32) -> f64 {
    f64::from(1_u32 << GRID_BITS).powi(power)
}

/// The float nearest to an integer.
#[expect(
    clippy::cast_precision_loss,
    reason = "this is the one rounding: of a sum that was exact"
)]
fn float(integer: i128) -> f64 {
    integer as f64
}
