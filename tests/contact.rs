//! Area of contact: boxes against unit faces, prisms against polygons cut by hand, and what parts and orders do not matter for.

#[path = "oracle/random.rs"]
mod random;

use std::num::NonZero;
use std::sync::Arc;

use random::Random;
use union3d::engine::solids::{Body, Engine, Shape, SolidId, Stock};
use union3d::geometry::Bounds;
use union3d::geometry::convex::{Point, Solid};

/// Worlds of a random test.
fn rounds(release: u64) -> u64 {
    if cfg!(debug_assertions) {
        release / 10 + 1
    } else {
        release
    }
}

fn below(random: &mut Random, bound: i64) -> i64 {
    i64::try_from(random.below(u64::try_from(bound).unwrap())).unwrap()
}

fn hull(points: &[[i64; 3]]) -> Option<Solid> {
    let points: Vec<Point> = points.iter().map(|at| Point::new(*at).unwrap()).collect();
    Solid::hull(&points).ok()
}

/// The hull of the corners of a box.
fn cuboid(bounds: &Bounds) -> Solid {
    let corners = (0..8).map(|corner| {
        [0, 1, 2].map(|axis| {
            let end = [bounds.min[axis], bounds.max[axis]][corner >> axis & 1];
            i64::from(end)
        })
    });
    hull(&corners.collect::<Vec<_>>()).unwrap()
}

fn random_box(random: &mut Random, side: i64) -> Bounds {
    let mut bounds = Bounds {
        min: [0; 3],
        max: [0; 3],
    };
    for axis in 0..3 {
        let from = below(random, side);
        let to = from + 1 + below(random, side - from);
        (bounds.min[axis], bounds.max[axis]) =
            (i32::try_from(from).unwrap(), i32::try_from(to).unwrap());
    }
    bounds
}

/// Voxels of a small world: what is stock, and what is removed.
#[derive(Clone)]
struct Voxels {
    side: i32,
    removed: Vec<bool>,
    stock: Option<Bounds>,
}

impl Voxels {
    fn is_in(bounds: &Bounds, at: [i32; 3]) -> bool {
        (0..3).all(|axis| (bounds.min[axis]..bounds.max[axis]).contains(&at[axis]))
    }

    fn is_stock(&self, at: [i32; 3]) -> bool {
        self.stock
            .as_ref()
            .is_none_or(|stock| Self::is_in(stock, at))
    }

    fn index(&self, at: [i32; 3]) -> Option<usize> {
        let is_inside = at.iter().all(|along| (0..self.side).contains(along));
        let index = (at[0] * self.side + at[1]) * self.side + at[2];
        is_inside.then(|| usize::try_from(index).unwrap())
    }

    fn is_removed(&self, at: [i32; 3]) -> bool {
        self.index(at).is_some_and(|index| self.removed[index])
    }

    fn all(&self) -> impl Iterator<Item = [i32; 3]> + use<> {
        let side = self.side;
        (0..side).flat_map(move |x| (0..side).flat_map(move |y| (0..side).map(move |z| [x, y, z])))
    }

    /// Unit faces between what boxes remove now and material that stays.
    fn contact(&mut self, boxes: &[Bounds]) -> i128 {
        let before = self.clone();
        for at in self.all() {
            if self.is_stock(at) && boxes.iter().any(|one| Self::is_in(one, at)) {
                let index = self.index(at).unwrap();
                self.removed[index] = true;
            }
        }
        let mut faces = 0;
        for at in self.all() {
            if self.is_removed(at) && !before.is_removed(at) {
                for (axis, step) in (0..3).flat_map(|axis| [(axis, -1), (axis, 1)]) {
                    let mut beside = at;
                    beside[axis] += step;
                    faces += i128::from(self.is_stock(beside) && !self.is_removed(beside));
                }
            }
        }
        faces
    }
}

/// Twice an area in units of the engine.
fn units(faces: i128) -> Option<i128> {
    Some((2 * faces) << 16)
}

/// Moves of one box or several, in a stock or without one, that share planes all the time.
#[test]
fn contact_of_boxes_is_that_of_unit_faces() {
    let mut several = 0;
    for seed in 0..rounds(3_000) {
        let mut random = Random::new(seed);
        let side = 3 + below(&mut random, 4);
        let stock = (below(&mut random, 3) > 0).then(|| random_box(&mut random, side));
        let mut voxels = Voxels {
            side: i32::try_from(side).unwrap(),
            removed: vec![false; usize::try_from(side.pow(3)).unwrap()],
            stock,
        };
        let moves: Vec<Vec<Bounds>> = (0..2 + below(&mut random, 10))
            .map(|_| {
                let count = 1 + below(&mut random, 2) * below(&mut random, 4);
                (0..count).map(|_| random_box(&mut random, side)).collect()
            })
            .collect();
        several += u32::from(moves.iter().any(|boxes| boxes.len() > 1));
        let expected: Vec<Option<i128>> = moves
            .iter()
            .map(|boxes| units(voxels.contact(boxes)))
            .collect();
        // Solids of one box each, or one of several parts; one after the other or all together, on one thread or two.
        for way in 0..4 {
            let mut id = 0;
            let mut next = |body| {
                id += 1;
                (SolidId(id), body)
            };
            let moves: Vec<Vec<(SolidId, Body)>> = moves
                .iter()
                .map(|boxes| {
                    let solids = boxes.iter().map(cuboid);
                    if way % 2 == 0 {
                        return solids.map(|solid| next(Body::solid(solid))).collect();
                    }
                    let shape = Arc::new(Shape::new(solids.collect()).unwrap());
                    let origin = Point::new([0; 3]).unwrap();
                    vec![next(Body::swept(&shape, origin, origin).unwrap())]
                })
                .collect();
            let stock = stock.map(|stock| Stock::new(cuboid(&stock)).unwrap());
            let threads = NonZero::new(1 + way / 2).unwrap();
            let mut engine = Engine::new().with_stock(stock).with_threads(threads);
            let added = if way < 2 {
                let one = |one: Vec<_>| engine.insert_moves(vec![one]).unwrap().remove(0);
                moves.into_iter().map(one).collect()
            } else {
                engine.insert_moves(moves).unwrap()
            };
            let found: Vec<Option<i128>> = added.iter().map(|added| added.contact2).collect();
            assert_eq!(found, expected, "seed {seed}, way {way}");
        }
    }
    assert!(several > 0);
}

type Polygon = Vec<[f64; 3]>;

/// A plane: normal and offset, positive outside.
type Side = ([f64; 3], f64);

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| a[axis] * b[axis]).sum()
}

/// What of a polygon lies in all these half-spaces.
fn clipped(polygon: &Polygon, sides: &[Side]) -> Polygon {
    let mut polygon = polygon.clone();
    for (normal, offset) in sides {
        let at = |point: [f64; 3]| {
            let value = dot(*normal, point) + offset;
            if value.abs() < 1e-7 { 0.0 } else { value }
        };
        let mut kept = Vec::new();
        for index in 0..polygon.len() {
            let (from, to) = (polygon[index], polygon[(index + 1) % polygon.len()]);
            let (here, there) = (at(from), at(to));
            if here <= 0.0 {
                kept.push(from);
            }
            if here * there < 0.0 {
                let part = here / (here - there);
                kept.push([0, 1, 2].map(|axis| from[axis] + part * (to[axis] - from[axis])));
            }
        }
        polygon = kept;
    }
    polygon
}

fn area(polygon: &Polygon) -> f64 {
    let mut sum = [0.0; 3];
    for index in 1..polygon.len().saturating_sub(1) {
        let [a, b] = [polygon[index], polygon[index + 1]]
            .map(|point| [0, 1, 2].map(|axis: usize| point[axis] - polygon[0][axis]));
        for (axis, along) in sum.iter_mut().enumerate() {
            let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
            *along += a[next] * b[last] - a[last] * b[next];
        }
    }
    dot(sum, sum).sqrt() / 2.0
}

#[expect(clippy::cast_precision_loss, reason = "of small worlds")]
fn sides_of(solid: &Solid) -> Vec<Side> {
    let planes = solid.planes().iter();
    planes
        .map(|plane| {
            (
                plane.normal().map(|along| along as f64),
                plane.offset() as f64,
            )
        })
        .collect()
}

/// The area of a polygon that lies in none of these closed solids: by inclusion and exclusion.
fn area_outside(polygon: &Polygon, solids: &[Vec<Side>]) -> f64 {
    match solids.split_first() {
        _ if polygon.len() < 3 => 0.0,
        None => area(polygon),
        Some((first, others)) => {
            area_outside(polygon, others) - area_outside(&clipped(polygon, first), others)
        }
    }
}

/// The contact of a solid, as far as it is in a stock, with what others have left.
fn expected_contact(solid: &Solid, stock: &Solid, others: &[Solid]) -> f64 {
    let others: Vec<Vec<Side>> = others.iter().map(sides_of).collect();
    let in_stock = sides_of(stock);
    let facets = solid.facets().zip(solid.planes());
    let contacts = facets.map(|(facet, plane)| {
        // Where the stock ends there is no material on one of the two sides.
        if [*plane, plane.opposite()]
            .iter()
            .any(|one| stock.planes().contains(one))
        {
            return 0.0;
        }
        let points = facet.vertices.iter();
        let polygon = points.map(|vertex| {
            let at = solid.vertices()[usize::from(*vertex)].coordinates();
            at.map(f64::from)
        });
        area_outside(&clipped(&polygon.collect(), &in_stock), &others)
    });
    contacts.sum()
}

/// A point of a small world.
fn random_point(random: &mut Random, side: i64) -> [i64; 3] {
    [0; 3].map(|_| below(random, side))
}

/// Hulls of a few points of a small world, in a box or another hull: against facets cut by the others.
#[test]
fn contact_of_hulls_is_that_of_facets_cut_by_the_others() {
    let mut greatest: f64 = 0.0;
    for seed in 0..rounds(2_000) {
        let mut random = Random::new(seed + 1_000_000);
        let side = 4 + below(&mut random, 6);
        let solid = |random: &mut Random| {
            loop {
                let points: Vec<_> = (0..4 + below(random, 5))
                    .map(|_| random_point(random, side))
                    .collect();
                if let Some(solid) = hull(&points) {
                    return solid;
                }
            }
        };
        let stock = solid(&mut random);
        let solids: Vec<Solid> = (0..6).map(|_| solid(&mut random)).collect();
        let mut engine = Engine::new().with_stock(Some(Stock::new(stock.clone()).unwrap()));
        for (index, one) in solids.iter().enumerate() {
            let id = SolidId(index as u64);
            let body = Body::solid(one.clone());
            let added = engine
                .insert_moves(vec![vec![(id, body)]])
                .unwrap()
                .remove(0);
            #[expect(clippy::cast_precision_loss, reason = "of small worlds")]
            let found = added.contact2.unwrap() as f64 / f64::from(2 << 16);
            let expected = expected_contact(one, &stock, &solids[..index]);
            greatest = greatest.max(found);
            assert!(
                (found - expected).abs() < 0.01,
                "seed {seed}, solid {index}: {found} instead of {expected}"
            );
        }
    }
    assert!(greatest > 10.0);
}

/// The chords of a path, cut as one move: neither their order nor a way there and back, nor another cut of a straight one, changes its contact.
#[test]
fn contact_is_that_of_the_move_whatever_its_parts() {
    for seed in 0..rounds(400) {
        let mut random = Random::new(seed + 2_000_000);
        let tool: Vec<[i64; 3]> = [
            [2, 1],
            [1, 2],
            [-1, 2],
            [-2, 1],
            [-2, -1],
            [-1, -2],
            [1, -2],
            [2, -1],
        ]
        .iter()
        .flat_map(|[x, y]| [[*x, *y, 0], [*x, *y, 9]])
        .collect();
        let shape = Arc::new(Shape::new(vec![hull(&tool).unwrap()]).unwrap());
        let stock = Stock::new(cuboid(&Bounds {
            min: [0; 3],
            max: [12, 12, 6],
        }))
        .unwrap();
        let place = |random: &mut Random| {
            [
                below(random, 13),
                below(random, 13),
                2 + 2 * below(random, 2),
            ]
        };
        let swept = |from: [i64; 3], to: [i64; 3]| {
            Body::swept(&shape, Point::new(from).unwrap(), Point::new(to).unwrap()).unwrap()
        };
        let before: Vec<Body> = (0..3)
            .map(|_| swept(place(&mut random), place(&mut random)))
            .collect();
        let corners: Vec<[i64; 3]> = (0..2 + below(&mut random, 4))
            .map(|_| place(&mut random))
            .collect();
        let mut chords: Vec<Body> = corners
            .windows(2)
            .map(|ends| swept(ends[0], ends[1]))
            .collect();
        let contact = |chords: &[Body]| {
            let threads = NonZero::new(2).unwrap();
            let mut engine = Engine::new()
                .with_stock(Some(stock.clone()))
                .with_threads(threads);
            let solids = |from: u64, bodies: &[Body]| {
                (from..).map(SolidId).zip(bodies.iter().cloned()).collect()
            };
            engine.insert_moves(vec![solids(0, &before)]).unwrap();
            let area = |engine: &Engine| engine.totals().remaining.unwrap().area2;
            let old = area(&engine);
            let added = engine
                .insert_moves(vec![solids(100, chords)])
                .unwrap()
                .remove(0);
            // New surface is a part of what the remaining has now, and the rest of that was there before; but for the rounding of flags.
            let contact2 = added.contact2.unwrap();
            let now = area(&engine);
            let slack = 1 << 12;
            let is_between =
                -slack < contact2 && contact2 < now + slack && now < old + contact2 + slack;
            assert!(is_between, "seed {seed}: {contact2} of {now}, {old} before");
            contact2
        };
        let expected = contact(&chords);
        chords.reverse();
        assert_eq!(contact(&chords), expected, "seed {seed}: backwards");
        chords.extend(corners.windows(2).map(|ends| swept(ends[1], ends[0])));
        chords.push(swept(corners[0], corners[0]));
        assert_eq!(contact(&chords), expected, "seed {seed}: there and back");
    }
}
