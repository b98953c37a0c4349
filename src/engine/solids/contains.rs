//! Where a point lies: decided exactly, in integers alone.
//!
//! Around a point a convex part looks like a cone: what is on the inner side of the planes of the part that go through the point. The point is in the
//! interior of the union exactly when the cones cover all directions. The directions that are not covered yet are kept as open convex cones,
//! octants at first, and each part cuts its own out of them:
//!
//! ```text
//!     ____n1___                 n1 > 0     a cone of three planes leaves three pieces:
//!    |    /\                               outside of the first; inside of the first and outside of the second; and so on
//!    | c /  \  n2 > 0
//! ```
//! What has no interior is dropped, as the union is regularised: with closed cones an uncovered direction has uncovered ones around it.

use super::super::Side;
use super::exact::{cross_wide, dot_wide, sign};
use super::{Body, Engine, SolidId, Stock};
use crate::geometry::Bounds;
use crate::geometry::convex::{Plane, Point};

impl Engine {
    /// Where a point lies in the union, cut to the stock where there is one, and the body of least id that holds it there. O(parts around it, and
    /// what they leave of the directions).
    pub fn contains(&self, point: Point) -> (Side, Option<SolidId>) {
        let mut around = Around::new(point, self.stock());
        self.each_near(point, |id, body| around.add(id, body));
        around.answer()
    }

    /// Shows `visit` every body one of whose parts, cut to the stock, has the point in the box around it; some of them several times.
    pub fn each_near(&self, point: Point, mut visit: impl FnMut(SolidId, &Body)) {
        let at = point.coordinates();
        let bounds = Bounds { min: at, max: at };
        for bins in [&self.exposed, &self.covered] {
            bins.visit(&bounds, |slot, _| {
                let entry = &self.bodies[&self.slots.part(slot).body];
                visit(entry.id, &entry.body);
            });
        }
    }
}

/// Bodies around a point, one after the other.
#[derive(Clone, Debug)]
pub struct Around {
    point: Point,
    /// Normals of the stock's planes through the point; none when the point is outside of the stock.
    stock: Option<Vec<[i64; 3]>>,
    bodies: std::collections::BTreeMap<SolidId, Vec<Vec<[i64; 3]>>>,
}

impl Around {
    /// A point, and no body yet.
    pub fn new(point: Point, stock: Option<&Stock>) -> Self {
        let stock = match stock {
            None => Some(Vec::new()),
            Some(stock) => normals(stock.solid().planes(), point),
        };
        Self {
            point,
            stock,
            bodies: std::collections::BTreeMap::new(),
        }
    }

    /// Adds a body, unless it is there.
    pub fn add(&mut self, id: SolidId, body: &Body) {
        let Some(stock) = &self.stock else {
            return;
        };
        if self.bodies.contains_key(&id) {
            return;
        }
        let at = self.point.coordinates();
        let is_near = |bounds: Bounds| {
            (0..3).all(|axis| bounds.min[axis] <= at[axis] && at[axis] <= bounds.max[axis])
        };
        let mut cones = Vec::new();
        for part in (0..body.len()).filter(|part| is_near(body.part_bounds(*part))) {
            if let Some(mut cone) = normals(body.part(part).planes(), self.point) {
                cone.extend(stock);
                // Within the stock nothing may be left of it.
                if Cone::octants()
                    .into_iter()
                    .any(|octant| octant.meets(&cone))
                {
                    cones.push(cone);
                }
            }
        }
        if !cones.is_empty() {
            self.bodies.insert(id, cones);
        }
    }

    /// Where the point lies in the union of them, and the one of least id that holds it.
    pub fn answer(&self) -> (Side, Option<SolidId>) {
        let Some((holder, _)) = self.bodies.first_key_value() else {
            return (Side::Outside, None);
        };
        let mut open = Cone::octants();
        for cone in self.bodies.values().flatten() {
            open = open.iter().flat_map(|rest| rest.without(cone)).collect();
        }
        let side = if open.is_empty() {
            Side::Inside
        } else {
            Side::Boundary
        };
        (side, Some(*holder))
    }
}

/// The outward normals of the planes that go through a point; none when it is outside of one.
fn normals(planes: &[Plane], point: Point) -> Option<Vec<[i64; 3]>> {
    let mut through = Vec::new();
    for plane in planes {
        match plane.at(point) {
            0 => through.push(plane.normal()),
            1.. => return None,
            _ => {}
        }
    }
    Some(through)
}

/// A pointed convex cone of directions with an interior, by the inward normals of its facets in cyclic order: where two neighbours meet is a ray,
/// along their cross product.
#[derive(Clone, Debug)]
struct Cone(Vec<[i64; 3]>);

impl Cone {
    fn octants() -> Vec<Self> {
        let octant = |number: i64| {
            let [x, y, z] = [0, 1, 2].map(|axis| 1 - 2 * (number >> axis & 1));
            let mut normals = vec![[x, 0, 0], [0, y, 0], [0, 0, z]];
            // The rays are along the axes only when the normals turn the right way.
            if x * y * z < 0 {
                normals.swap(0, 1);
            }
            Self(normals)
        };
        (0..8).map(octant).collect()
    }

    /// What is on the positive side of a plane; none without an interior.
    fn cut(&self, normal: [i64; 3]) -> Option<Self> {
        let facets = &self.0;
        let next = |index: usize| (index + 1) % facets.len();
        // Of the ray between a facet and the next one.
        let sides: Vec<i32> = (0..facets.len())
            .map(|index| {
                sign(dot_wide(
                    cross_wide(facets[index], facets[next(index)]),
                    normal,
                ))
            })
            .collect();
        if sides.iter().all(|side| *side >= 0) {
            return Some(self.clone());
        }
        // The first facet that goes on from the positive side to the others: after it comes the new one.
        let last = (0..facets.len()).find(|&index| {
            let before = sides[(index + facets.len() - 1) % facets.len()];
            before > 0 && sides[index] <= 0
        })?;
        let mut kept = vec![facets[last], normal];
        let mut index = next(last);
        // Facets that have no ray on the positive side.
        while sides[index] <= 0 {
            index = next(index);
        }
        while index != last {
            kept.push(facets[index]);
            index = next(index);
        }
        Some(Self(kept))
    }

    /// Whether something with an interior is on the inner side of planes with these outward normals.
    fn meets(&self, outward: &[[i64; 3]]) -> bool {
        let mut rest = Some(self.clone());
        for normal in outward {
            rest = rest.and_then(|rest| rest.cut(inward(*normal)));
        }
        rest.is_some()
    }

    /// What is left without the inner side of planes with these outward normals: pieces with an interior.
    fn without(&self, outward: &[[i64; 3]]) -> Vec<Self> {
        let mut pieces = Vec::new();
        let mut rest = Some(self.clone());
        for normal in outward {
            let Some(whole) = rest else {
                break;
            };
            pieces.extend(whole.cut(*normal));
            rest = whole.cut(inward(*normal));
        }
        pieces
    }
}

fn inward(outward: [i64; 3]) -> [i64; 3] {
    outward.map(|component| -component)
}
