//! The faces of a scene of solids, from the exact edges of its union.
//!
//! Edges come part by part, in an order in which neighbours are near each other; each goes to the faces of its planes, and a face is handed
//! out with the last part that can have an edge of it. So memory holds the faces at the front of that order, and those that reach far.

use std::collections::BTreeMap;
use std::ops::ControlFlow;

use ethnum::{I256, U256};
use rustc_hash::FxHashMap;

use crate::engine::solids::{Body, Edges, Homogeneous, Listed, Side, SolidId, Stock, Surface};
use crate::geometry::Bounds;
use crate::geometry::convex::Plane;

use super::face::{Face, FaceSink, NoStock, Region};

/// Lists the exposed faces of a region, each oriented plane once, in an order that the set of bodies alone decides. O(bodies), each in its
/// neighbourhood.
///
/// `within` keeps what lies in a closed box of lattice points and half a step around it, exactly cut there: no facet of a lattice solid is
/// half-way between lattice points, so that neighbouring boxes, such as 0 to 9 and 10 to 19, share out every face. The surface is open there.
/// `goes_on` is asked now and then; a listing that it or the sink ends is a break.
/// # Errors
/// [`NoStock`] for a region of the stock where there is none.
pub fn faces(
    bodies: impl Iterator<Item = (SolidId, Body)>,
    stock: Option<&Stock>,
    region: Region,
    within: Option<Bounds>,
    goes_on: &dyn Fn() -> bool,
    sink: &mut FaceSink,
) -> Result<ControlFlow<()>, NoStock> {
    let surface = match region {
        Region::Union => Surface::Union,
        Region::Removed => Surface::Removed(stock.ok_or(NoStock)?),
        Region::Remaining => Surface::Remaining(stock.ok_or(NoStock)?),
    };
    let Some(mut edges) = Edges::of(surface, within, bodies, goes_on) else {
        return Ok(ControlFlow::Break(()));
    };
    let mut open = Open::default();
    Ok(edges.each(&mut |listed| match listed {
        Listed::Edge(ends, sides) => {
            open.add([rounded(&ends[0]), rounded(&ends[1])], sides);
            ControlFlow::Continue(())
        }
        Listed::Part(_) if !goes_on() => ControlFlow::Break(()),
        Listed::Part(part) => open.hand_out(part, sink),
    }))
}

/// Faces that are not complete.
#[derive(Default)]
struct Open {
    faces: FxHashMap<Plane, Face>,
    /// By the part with which they are complete, in the order in which they came.
    due: BTreeMap<u32, Vec<Plane>>,
}

impl Open {
    /// Adds an edge to the faces that meet there.
    fn add(&mut self, [tail, head]: [[f64; 3]; 2], sides: &[Side]) {
        // So short an edge that it has no floats between its ends.
        if tail.map(f64::to_bits) == head.map(f64::to_bits) {
            return;
        }
        for side in sides {
            let face = self.faces.entry(side.plane).or_insert_with(|| {
                self.due.entry(side.last).or_default().push(side.plane);
                Face {
                    body: side.body,
                    normal: unit(side.plane.normal()),
                    edges: Vec::new(),
                }
            });
            face.body = match (face.body, side.body) {
                (Some(one), Some(other)) => Some(one.min(other)),
                (one, other) => one.or(other),
            };
            let edge = if side.is_left {
                [tail, head]
            } else {
                [head, tail]
            };
            face.edges.push(edge);
        }
    }

    /// Hands out the faces that are complete with a part.
    fn hand_out(&mut self, part: u32, sink: &mut FaceSink) -> ControlFlow<()> {
        while let Some(due) = self.due.first_entry()
            && *due.key() <= part
        {
            for plane in due.remove() {
                let face = self.faces.remove(&plane);
                sink(&face.expect("a plane that is due has a face"))?;
            }
        }
        ControlFlow::Continue(())
    }
}

/// A vector of length 1 along another.
#[expect(
    clippy::cast_precision_loss,
    reason = "components of a normal are below 2^45"
)]
fn unit(normal: [i64; 3]) -> [f64; 3] {
    let normal = normal.map(|component| component as f64);
    let length = normal.iter().map(|part| part * part).sum::<f64>().sqrt();
    normal.map(|part| part / length)
}

/// The point of floats nearest to a point.
fn rounded(point: &Homogeneous) -> [f64; 3] {
    point.x.map(|over| nearest(over, point.w))
}

/// The float nearest to a quotient, the even one of two. Range: the quotient below `2^32`, the denominator below `2^138`.
#[expect(
    clippy::cast_precision_loss,
    reason = "this is the one rounding: to the nearest float, with all that is below it in the last bit"
)]
fn nearest(over: I256, under: I256) -> f64 {
    let is_negative = (over < 0) != (under < 0);
    let (over, under) = (over.unsigned_abs(), under.unsigned_abs());
    if over == U256::ZERO {
        return 0.0;
    }
    // A quotient of 64 or 65 bits: more than two below those of a float.
    let shift = 64 + over.leading_zeros() - under.leading_zeros();
    let over = over << shift;
    let (quotient, rest) = (over / under, over % under);
    let quotient = quotient.as_u128() | u128::from(rest != U256::ZERO);
    let scale = f64::from_bits(u64::from(1023 - shift) << 52);
    let size = quotient as f64 * scale;
    if is_negative { -size } else { size }
}

#[cfg(test)]
mod tests {
    use num_bigint::{BigInt, Sign};

    use super::*;
    use crate::random::Random;

    fn big(value: I256) -> BigInt {
        BigInt::from_signed_bytes_le(&value.to_le_bytes())
    }

    /// How far `over / under` is from a float, times a positive number that depends on `under` alone.
    fn distance(over: I256, under: I256, float: f64) -> BigInt {
        const BITS: u32 = 400;
        let scaled = |float: f64| {
            let bits = float.to_bits();
            let exponent = u32::try_from(bits >> 52 & 0x7ff).unwrap();
            let fraction = BigInt::from(bits & ((1 << 52) - 1) | 1 << 52);
            let size = fraction << (exponent + BITS - 1075);
            if float < 0.0 { -size } else { size }
        };
        let off = (big(over) << BITS) - scaled(float) * big(under);
        BigInt::from_biguint(Sign::Plus, off.into_parts().1)
    }

    #[test]
    fn the_nearest_float_is_found() {
        let mut random = Random::new(1);
        let mut wide = |bits: u32| {
            let mut value = I256::ONE;
            for _ in 0..bits {
                value = value << 1 | I256::from(random.next() >> 63);
            }
            value
        };
        let mut lengths = Random::new(2);
        let (mut ties, mut negative) = (0, 0);
        for _ in 0..20_000 {
            // Quotients half-way between floats, whole ones, and close to these, among any others.
            let under = wide(lengths.below(100_u32));
            let (over, under) = match lengths.below(4) {
                0 => (wide(lengths.below(130)), under),
                1 => {
                    let half_way = under * wide(53) + I256::from(lengths.within(-1, 1));
                    (half_way, under << lengths.within(22, 37))
                }
                kind => {
                    let whole = (under * wide(lengths.below(20))) << kind;
                    (whole + I256::from(lengths.within(-1, 1)), under)
                }
            };
            if (over / under) >> 32_u32 != I256::ZERO {
                continue;
            }
            let (over, under) = match lengths.below(4) {
                0 => (-over, under),
                1 => (over, -under),
                2 => (-over, -under),
                _ => (over, under),
            };
            let float = nearest(over, under);
            if over == I256::ZERO {
                assert_eq!(float, 0.0);
                continue;
            }
            negative += u32::from(float < 0.0);
            let at = distance(over, under, float);
            for other in [float.next_up(), float.next_down()] {
                let there = distance(over, under, other);
                assert!(at <= there, "{over} / {under}: {float}, {other} is nearer");
                if at == there {
                    ties += 1;
                    assert_eq!(
                        float.to_bits() & 1,
                        0,
                        "{over} / {under}: {float} is the odd one"
                    );
                }
            }
        }
        assert!(ties > 100 && negative > 1_000, "{ties} {negative}");
    }
}
