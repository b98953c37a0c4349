//! The engine of solids: boxes against voxels, general bodies against themselves in any order and through any history.
//!
//! Small worlds with large bodies, so that ties are the common case. Every random test prints its seed when it fails.

#[path = "oracle/random.rs"]
mod random;
#[allow(
    dead_code,
    reason = "of the oracle of cubes only the voxels are used here"
)]
#[path = "oracle/voxels.rs"]
mod voxels;

use std::num::NonZero;
use std::sync::Arc;

use ethnum::I256;
use random::Random;
use union3d::engine::Side;
use union3d::engine::solids::{
    Body, Effect, Engine, ErrorMax, InvalidStock, Measures, Shape, SolidId, Stock, Totals, recount,
    recount_exactly,
};
use union3d::geometry::convex::{Point, Solid};
use union3d::geometry::{self, Bounds, EdgeKind};

/// Scenes of a random test: few in debug, many where they are fast, and fewest where everything is compared with big integers.
fn rounds(release: u64) -> u64 {
    if cfg!(feature = "paranoid") {
        release / 100 + 1
    } else if cfg!(debug_assertions) {
        release / 20 + 1
    } else {
        release
    }
}

fn below(random: &mut Random, bound: i64) -> i64 {
    i64::try_from(random.below(u64::try_from(bound).unwrap())).unwrap()
}

fn point(coordinates: [i64; 3]) -> Point {
    Point::new(coordinates).unwrap()
}

fn hull(points: &[[i64; 3]]) -> Option<Solid> {
    let points: Vec<Point> = points.iter().copied().map(point).collect();
    Solid::hull(&points).ok()
}

fn shuffle<T>(random: &mut Random, items: &mut [T]) {
    for last in (1..items.len()).rev() {
        let other = below(random, i64::try_from(last).unwrap() + 1);
        items.swap(last, usize::try_from(other).unwrap());
    }
}

fn insert(engine: &mut Engine, id: usize, body: &Body) {
    let inserted = vec![(SolidId(id as u64), body.clone())];
    let deleted = Vec::new();
    engine.apply(&Effect { deleted, inserted }).unwrap();
}

fn delete(engine: &mut Engine, id: usize) {
    let id = SolidId(id as u64);
    let deleted = vec![(id, engine.get(id).unwrap().clone())];
    let inserted = Vec::new();
    engine.apply(&Effect { deleted, inserted }).unwrap();
}

/// The measures of cubes in the units of those of solids.
fn in_units(measures: &geometry::Measures) -> Measures {
    let length = |kind| (measures.edge_length_of(kind) * 2) << 20;
    Measures {
        volume6: measures.volume * 6 * 16,
        area2: (measures.area() * 2) << 16,
        // Where solids touch along an edge, each counts it.
        edge_length2: [
            length(EdgeKind::Convex),
            length(EdgeKind::Concave),
            2 * length(EdgeKind::Crossing),
        ],
        first_moments24: measures
            .first_moments2
            .map(|moment| I256::from(moment) * I256::from(12 * 16)),
        second_moments120: {
            let squares = measures
                .second_moments3
                .map(|moment| moment * I256::from(40 * 16));
            let products = measures
                .product_moments4
                .map(|moment| moment * I256::from(30 * 16));
            [squares, products].concat().try_into().unwrap()
        },
    }
}

/// Whether a box holds a voxel.
fn holds(bounds: &Bounds, voxel: [i32; 3]) -> bool {
    (0..3).all(|axis| (bounds.min[axis]..bounds.max[axis]).contains(&voxel[axis]))
}

/// The measures of a union of boxes, voxel by voxel.
fn measures_of_boxes(boxes: &[Bounds]) -> Measures {
    let around = boxes.iter().copied().reduce(|one, other| Bounds {
        min: std::array::from_fn(|axis| one.min[axis].min(other.min[axis])),
        max: std::array::from_fn(|axis| one.max[axis].max(other.max[axis])),
    });
    let Some(around) = around else {
        return Measures::default();
    };
    let is_filled = |voxel| boxes.iter().any(|bounds| holds(bounds, voxel));
    in_units(&voxels::measures(around, &is_filled))
}

fn body_of_box(bounds: &Bounds) -> Body {
    let [min, max] = [bounds.min, bounds.max].map(|corner| point(corner.map(i64::from)));
    Body::cuboid(min, max).unwrap()
}

fn random_box(random: &mut Random, side: i64) -> Bounds {
    let (mut min, mut max) = ([0; 3], [0; 3]);
    for axis in 0..3 {
        let low = below(random, side);
        min[axis] = i32::try_from(low).unwrap();
        max[axis] = i32::try_from(low + 1 + below(random, side - low)).unwrap();
    }
    Bounds { min, max }
}

/// Boxes are the one family for which every measure is known to the integer.
#[test]
fn boxes_equal_voxels_to_the_integer() {
    for seed in 0..rounds(10_000) {
        let mut random = Random::new(seed);
        let side = 4 + below(&mut random, 6);
        let count = 1 + below(&mut random, 9);
        let mut boxes: Vec<Bounds> = (0..count).map(|_| random_box(&mut random, side)).collect();
        if below(&mut random, 4) == 0 {
            boxes.push(boxes[0]);
        }
        let mut engine = if seed % 8 == 7 {
            Engine::exact()
        } else {
            Engine::new()
        };
        let mut there: Vec<usize> = (0..boxes.len()).collect();
        shuffle(&mut random, &mut there);
        for (number, &id) in there.iter().enumerate() {
            insert(&mut engine, id, &body_of_box(&boxes[id]));
            let inserted: Vec<Bounds> = there[..=number].iter().map(|id| boxes[*id]).collect();
            let expected = measures_of_boxes(&inserted);
            assert_eq!(
                engine.totals().measures,
                expected,
                "seed {seed}: {inserted:?}"
            );
        }
        shuffle(&mut random, &mut there);
        while let Some(id) = there.pop() {
            delete(&mut engine, id);
            let left: Vec<Bounds> = there.iter().map(|id| boxes[*id]).collect();
            let expected = measures_of_boxes(&left);
            assert_eq!(
                engine.totals().measures,
                expected,
                "seed {seed}: {left:?} without {id}"
            );
        }
        assert_eq!(engine.totals(), Totals::default(), "seed {seed}");
    }
}

/// What boxes remove from a box, and what remains of it, voxel by voxel.
fn measures_of_stock(stock: &Bounds, boxes: &[Bounds]) -> [Measures; 2] {
    let is_cut = |voxel| boxes.iter().any(|bounds| holds(bounds, voxel));
    let removed = voxels::measures(*stock, &|voxel| holds(stock, voxel) && is_cut(voxel));
    let remaining = voxels::measures(*stock, &|voxel| holds(stock, voxel) && !is_cut(voxel));
    [removed, remaining].map(|measures| in_units(&measures))
}

fn stock_of_box(bounds: &Bounds) -> Stock {
    let [min, max] = [bounds.min, bounds.max].map(|corner| point(corner.map(i64::from)));
    Stock::new(Solid::cuboid(min, max).unwrap()).unwrap()
}

#[test]
fn boxes_in_a_stock_equal_voxels_to_the_integer() {
    for seed in 0..rounds(10_000) {
        let mut random = Random::new(seed);
        let side = 4 + below(&mut random, 6);
        let stock = random_box(&mut random, side);
        let count = 1 + below(&mut random, 7);
        let mut boxes: Vec<Bounds> = (0..count).map(|_| random_box(&mut random, side)).collect();
        match below(&mut random, 6) {
            0 => boxes.push(stock),
            1 => boxes.push(boxes[0]),
            _ => {}
        }
        let engine = if seed % 8 == 7 {
            Engine::exact()
        } else {
            Engine::new()
        };
        let mut engine = engine.with_stock(Some(stock_of_box(&stock)));
        let [_, whole] = measures_of_stock(&stock, &[]);
        let mut there: Vec<usize> = (0..boxes.len()).collect();
        let check = |engine: &Engine, there: &[usize]| {
            let there: Vec<Bounds> = there.iter().map(|id| boxes[*id]).collect();
            let [removed, remaining] = measures_of_stock(&stock, &there);
            let totals = engine.totals();
            let context = format!("seed {seed}: {there:?} in {stock:?}");
            assert_eq!(totals.measures, removed, "{context}");
            assert_eq!(totals.remaining, Some(remaining), "{context}");
        };
        shuffle(&mut random, &mut there);
        for number in 0..there.len() {
            insert(
                &mut engine,
                there[number],
                &body_of_box(&boxes[there[number]]),
            );
            check(&engine, &there[..=number]);
        }
        shuffle(&mut random, &mut there);
        while let Some(id) = there.pop() {
            delete(&mut engine, id);
            check(&engine, &there);
        }
        let nothing = Totals {
            remaining: Some(whole),
            ..Totals::default()
        };
        assert_eq!(engine.totals(), nothing, "seed {seed}");
    }
}

/// Cubes as solids, and as cubes, cut from the same stock.
#[test]
fn both_kinds_of_scenes_say_the_same_of_cubes_in_a_stock() {
    for seed in 0..rounds(2_000) {
        let mut random = Random::new(seed);
        let edge = 1 + below(&mut random, 4);
        let stock = random_box(&mut random, 10);
        let corners = [stock.min, stock.max].map(|corner| corner.map(i64::from));
        let of_cubes = geometry::Stock::new(corners[0], corners[1]).unwrap();
        let edge_of_cubes = geometry::Edge::new(edge).unwrap();
        let mut cubes = union3d::engine::Engine::new(edge_of_cubes).with_stock(Some(of_cubes));
        let mut solids = Engine::new().with_stock(Some(stock_of_box(&stock)));
        for id in 0..12 {
            let corner = [0; 3].map(|_: i64| below(&mut random, 12) - 2);
            let place = geometry::Place::new(corner, edge_of_cubes).unwrap();
            let effect = geometry::Effect {
                deleted: Vec::new(),
                inserted: vec![(geometry::CubeId(id), place)],
            };
            cubes.apply(&effect).unwrap();
            let far = corner.map(|coordinate| coordinate + edge);
            let body = Body::cuboid(point(corner), point(far)).unwrap();
            insert(&mut solids, usize::try_from(id).unwrap(), &body);
            let totals = solids.totals();
            let of_cubes = cubes.totals().stock.unwrap();
            assert_eq!(totals.measures, in_units(&of_cubes.removed), "seed {seed}");
            let remaining = Some(in_units(&of_cubes.remaining));
            assert_eq!(totals.remaining, remaining, "seed {seed}");
            assert_eq!(totals.bounds, cubes.totals().bounds, "seed {seed}");
        }
    }
}

/// A half-space as far as a small world goes: a tetrahedron on one side of the plane through three points.
fn half_space(points: [[i64; 3]; 3], side: i64) -> Option<Solid> {
    let [a, b, c] = points;
    let from_a = |at: [i64; 3]| [0, 1, 2].map(|axis: usize| at[axis] - a[axis]);
    let (u, v) = (from_a(b), from_a(c));
    let normal = [(1, 2), (2, 0), (0, 1)].map(|(i, j): (usize, usize)| u[i] * v[j] - u[j] * v[i]);
    let at = |along_u: i64, along_v: i64, along_normal: i64| {
        [0, 1, 2].map(|axis: usize| {
            a[axis] + along_u * u[axis] + along_v * v[axis] + along_normal * normal[axis]
        })
    };
    hull(&[
        at(2_000, 0, 0),
        at(0, 2_000, 0),
        at(-2_000, -2_000, 0),
        at(0, 0, 1_000 * side),
    ])
}

/// A plane divides the stock: what is removed on one side is what remains when the other is removed.
#[test]
fn what_remains_is_what_the_other_side_would_remove() {
    let mut divided = 0;
    for seed in 0..rounds(4_000) {
        let mut random = Random::new(seed);
        let points = 4 + below(&mut random, 8);
        let stock = Stock::new(random_hull(&mut random, points, 6, 2)).unwrap();
        let plane = [0; 3].map(|_: i64| [0; 3].map(|_: i64| below(&mut random, 9)));
        let (Some(one), Some(other)) = (half_space(plane, 1), half_space(plane, -1)) else {
            continue;
        };
        let totals = |solid: Solid| {
            let mut engine = Engine::new().with_stock(Some(stock.clone()));
            insert(&mut engine, 1, &Body::solid(solid));
            (engine.totals(), engine.error_max())
        };
        let ((one, error), (other, _)) = (totals(one), totals(other));
        let remaining = one.remaining.unwrap();
        assert_eq!(remaining.area2, other.measures.area2, "seed {seed}");
        assert_eq!(
            remaining.edge_length2, other.measures.edge_length2,
            "seed {seed}"
        );
        assert_eq!(
            other.remaining.unwrap().area2,
            one.measures.area2,
            "seed {seed}"
        );
        // The other side's volume is rounded of its own flags.
        let difference = remaining.volume6.abs_diff(other.measures.volume6);
        assert!(difference <= 2 * error.volume6, "seed {seed}: {difference}");
        divided += u64::from(one.measures.volume6 != 0 && remaining.volume6 != 0);
    }
    assert!(
        divided > rounds(4_000) / 2,
        "{divided} of them divide the stock"
    );
}

/// The claim of the engine's documentation, in a stock; and its parts add up to it.
#[test]
fn totals_in_a_stock_are_a_function_of_the_set_alone() {
    for number in 0..FAMILIES {
        for seed in 0..rounds(60) {
            let mut random = Random::new(seed * 100 + number as u64 + 1_000_000);
            let bodies = family(number, &mut random);
            // Of the size and in the place of one of the bodies, so that it cuts them anyhow.
            let body = &bodies[usize::try_from(below(&mut random, 2)).unwrap()];
            let solid = if below(&mut random, 2) == 0 {
                body.part(0)
            } else {
                let Bounds { min, max } = body.bounds();
                let [min, max] = [min, max].map(|corner| point(corner.map(i64::from)));
                Solid::cuboid(min, max).unwrap()
            };
            let stock = Stock::new(solid).unwrap();
            let context = format!("family {number}, seed {seed}, in a stock");
            check_history(&mut random, Some(&stock), &bodies, &context);
        }
    }
}

#[test]
fn a_stock_with_too_many_vertices_is_refused() {
    // The points of a paraboloid are the vertices of their hull.
    let side = 0..33_i64;
    let points = side
        .clone()
        .flat_map(|x| side.clone().map(move |y| [x, y, x * x + y * y]));
    let solid = hull(&points.collect::<Vec<_>>()).unwrap();
    assert_eq!(Stock::new(solid).unwrap_err(), InvalidStock { count: 1089 });
}

/// Inserts bodies in several orders, deletes half and all of them, and compares with recounts.
fn check_history(random: &mut Random, stock: Option<&Stock>, bodies: &[Body], context: &str) {
    let nothing = Engine::new().with_stock(stock.cloned()).totals();
    let mut order: Vec<usize> = (0..bodies.len()).collect();
    let mut whole = None;
    for repetition in 0..3 {
        let mut engine = Engine::new().with_stock(stock.cloned());
        for (id, &index) in order.iter().enumerate() {
            // Ids by body or by order: which of two equal ones counts must not matter.
            insert(
                &mut engine,
                if repetition == 0 { index } else { id },
                &bodies[index],
            );
        }
        let totals = engine.totals();
        if let Some(remaining) = totals.remaining {
            let mut sum = remaining;
            sum.add(&totals.measures);
            let whole = nothing.remaining.unwrap();
            assert_eq!(sum.volume6, whole.volume6, "{context}");
            assert_eq!(sum.first_moments24, whole.first_moments24, "{context}");
            assert_eq!(sum.second_moments120, whole.second_moments120, "{context}");
            assert!(remaining.area2 >= 0, "{context}");
        }
        assert_eq!(
            *whole.get_or_insert(totals),
            totals,
            "{context}: order {order:?}"
        );
        let mut left: Vec<(usize, usize)> = order.iter().copied().enumerate().collect();
        if repetition == 0 {
            left = order.iter().map(|index| (*index, *index)).collect();
        }
        shuffle(random, &mut left);
        for _ in 0..left.len() / 2 {
            let (id, _) = left.pop().unwrap();
            delete(&mut engine, id);
        }
        let rest = || left.iter().map(|(_, index)| bodies[*index].clone());
        assert_eq!(
            engine.totals(),
            recount(stock.cloned(), rest()),
            "{context}: after deletions"
        );
        if repetition == 0 {
            assert_eq!(
                engine.totals(),
                recount_exactly(stock.cloned(), rest()),
                "{context}: in integers alone"
            );
        }
        for (id, _) in left {
            delete(&mut engine, id);
        }
        assert_eq!(engine.totals(), nothing, "{context}: all deleted");
        shuffle(random, &mut order);
    }
}

fn random_hull(random: &mut Random, count: i64, size: i64, spread: i64) -> Solid {
    loop {
        let origin = [0; 3].map(|_: i64| below(random, spread + 1));
        let points: Vec<[i64; 3]> = (0..count)
            .map(|_| origin.map(|low| low + below(random, size + 1)))
            .collect();
        if let Some(solid) = hull(&points) {
            return solid;
        }
    }
}

/// A prism over a polygon given in quarters of a turn, so that it is symmetric.
fn prism(quarter: &[[i64; 2]], low: i64, high: i64) -> Solid {
    let mut points = Vec::new();
    for &[x, y] in quarter {
        for [x, y] in [[x, y], [-y, x], [-x, -y], [y, -x]] {
            points.extend([[x, y, low], [x, y, high]]);
        }
    }
    hull(&points).unwrap()
}

fn swept(shape: &Arc<Shape>, from: [i64; 3], to: [i64; 3]) -> Body {
    Body::swept(shape, point(from), point(to)).unwrap()
}

fn shape(solid: Solid) -> Arc<Shape> {
    Arc::new(Shape::new(vec![solid]).unwrap())
}

/// A ball-nosed cutter: rings that are multiples of one octagon.
fn ball(size: i64, height: i64) -> Solid {
    let mut points = Vec::new();
    for (multiple, z) in [(2, 0), (5, 1), (7, 3), (8, 6)] {
        for [x, y] in [[3, 1], [1, 3]] {
            for [x, y] in [[x, y], [-y, x], [-x, -y], [y, -x]] {
                let ring = [x * multiple * size, y * multiple * size, z * 3 * size];
                points.push(ring);
                if multiple == 8 {
                    points.push([ring[0], ring[1], height * size]);
                }
            }
        }
    }
    hull(&points).unwrap()
}

/// A vee with a tip.
fn vee(size: i64) -> Solid {
    let mut points = vec![[0, 0, 0]];
    for [x, y] in [[1, 1], [-1, 1], [-1, -1], [1, -1]] {
        points.extend([[x * size, y * size, size], [x * size, y * size, 2 * size]]);
    }
    hull(&points).unwrap()
}

/// Every family of bodies in which something coincides, and two in which nothing does.
const FAMILIES: usize = 13;

fn family(number: usize, random: &mut Random) -> Vec<Body> {
    let count = 2 + below(random, 8);
    let solid = Body::solid;
    match number {
        // Hulls on a tiny lattice: mostly degenerate.
        0 => (0..count)
            .map(|_| {
                let points = 5 + below(random, 8);
                solid(random_hull(random, points, 4, 4))
            })
            .collect(),
        // Hulls in general position.
        1 => (0..count)
            .map(|_| {
                let points = 6 + below(random, 10);
                solid(random_hull(random, points, 60_000, 60_000))
            })
            .collect(),
        // Passes of a flat mill that continue, cross, turn back and lie in one another.
        2 => {
            let tool = shape(prism(&[[3, 1], [1, 3]], 0, 4));
            path(random, &tool, count + 3, 3)
        }
        // Passes of a ball, some ramped.
        3 => {
            let tool = shape(ball(4, 40));
            path(random, &tool, count, 17)
        }
        // Copies of one body by lattice shifts, touching and coincident.
        4 => {
            let body = random_hull(random, 8, 6, 0);
            (0..count)
                .map(|_| {
                    let by = [
                        below(random, 4) * 2,
                        below(random, 4) * 2,
                        below(random, 3) * 2,
                    ];
                    solid(body.displaced(by).unwrap())
                })
                .collect()
        }
        // General position near the end of the coordinates.
        5 => (0..count)
            .map(|_| {
                let points = 6 + below(random, 8);
                let far = [1_000_000_007, -1_000_000_009, 1_000_003_000];
                solid(
                    random_hull(random, points, 2_000_000, 1_500_000)
                        .displaced(far)
                        .unwrap(),
                )
            })
            .collect(),
        // Cubes turned by integer frames, sharing corners.
        6 => {
            let frames = [
                [[2, 1, 2], [-2, 2, 1], [1, 2, -2]],
                [[3, 0, 0], [0, 3, 0], [0, 0, 3]],
                [[1, 2, 2], [2, 1, -2], [2, -2, 1]],
            ];
            (0..count)
                .map(|_| {
                    let frame: [[i64; 3]; 3] = frames[usize::try_from(below(random, 3)).unwrap()];
                    let origin = [0; 3].map(|_: i64| below(random, 4));
                    let corner = |number: i64| {
                        let mut at = origin;
                        for (axis, side) in frame.iter().enumerate() {
                            for (to, along) in at.iter_mut().zip(side) {
                                *to += along * (number >> axis & 1);
                            }
                        }
                        at
                    };
                    solid(hull(&(0..8).map(corner).collect::<Vec<_>>()).unwrap())
                })
                .collect()
        }
        // Prisms that share an edge, tetrahedra that share a vertex.
        7 | 8 => fan(random, number == 7, count + 2),
        // The largest bodies in a corner of the scene, needles and plates among them.
        9 => (0..count)
            .map(|_| {
                loop {
                    let reach = 1 << 20;
                    let far = 1 << 30;
                    let middle = [far - reach, reach - far, far - reach];
                    let thin = below(random, 3);
                    let points: Vec<[i64; 3]> = (0..5 + below(random, 7))
                        .map(|_| {
                            let mut at = [0; 3].map(|_: i64| below(random, 2 * reach + 1) - reach);
                            if thin == 1 {
                                at[2] = at[0] / 2 + below(random, 5) - 2;
                            }
                            if thin == 2 {
                                at[1] = below(random, 3);
                                at[2] = below(random, 3);
                            }
                            [0, 1, 2].map(|axis| at[axis] + middle[axis])
                        })
                        .collect();
                    if let Some(body) = hull(&points) {
                        break solid(body);
                    }
                }
            })
            .collect(),
        // Boxes, in a world that is small for them.
        10 => (0..count)
            .map(|_| body_of_box(&random_box(random, 6)))
            .collect(),
        // Different tools on one path.
        11 => {
            let tools = [
                shape(prism(&[[3, 1], [1, 3]], 0, 6)),
                shape(vee(3)),
                shape(Solid::cuboid(point([-3, -3, 0]), point([3, 3, 6])).unwrap()),
                shape(ball(1, 30)),
            ];
            (0..count)
                .flat_map(|_| {
                    let tool = &tools[usize::try_from(below(random, 4)).unwrap()];
                    path(random, tool, 1, 3)
                })
                .collect()
        }
        // Bodies of two parts that touch or overlap.
        _ => {
            let tool = Arc::new(
                Shape::new(vec![
                    prism(&[[2, 2]], 0, 3),
                    prism(&[[3, 0]], below(random, 5), 5),
                ])
                .unwrap(),
            );
            path(random, &tool, count, 2)
        }
    }
}

/// Sweeps one after the other.
fn path(random: &mut Random, tool: &Arc<Shape>, count: i64, step: i64) -> Vec<Body> {
    let mut at = [0; 3].map(|_: i64| below(random, 3) * step);
    (0..count)
        .map(|_| {
            let mut to = at;
            match below(random, 7) {
                0 => to[1] += step,
                1 => to[1] -= step,
                2 => to[2] = -below(random, 3) * step,
                3 => to[0] -= step,
                4 => {
                    to = [
                        to[0] + step,
                        to[1] + step * (below(random, 3) - 1),
                        to[2] + below(random, 3) - 1,
                    ]
                }
                _ => to[0] += step * (1 + below(random, 2)),
            }
            let body = swept(tool, at, to);
            at = to;
            body
        })
        .collect()
}

fn fan(random: &mut Random, is_around_edge: bool, count: i64) -> Vec<Body> {
    let directions: [[i64; 2]; 16] = [
        [4, 0],
        [4, 2],
        [3, 3],
        [2, 4],
        [0, 4],
        [-2, 4],
        [-3, 3],
        [-4, 2],
        [-4, 0],
        [-4, -2],
        [-3, -3],
        [-2, -4],
        [0, -4],
        [2, -4],
        [3, -3],
        [4, -2],
    ];
    let mut pick = |bound: i64| usize::try_from(below(random, bound)).unwrap();
    let mut solids = Vec::new();
    while solids.len() < usize::try_from(count).unwrap() {
        let first = pick(16);
        let (a, b) = (directions[first], directions[(first + 1 + pick(7)) % 16]);
        let low = i64::try_from(pick(3)).unwrap() - 1;
        let high = low + 1 + i64::try_from(pick(2)).unwrap();
        let [s, t] = [0, 0].map(|_: i64| 1 + i64::try_from(pick(2)).unwrap());
        let points = if is_around_edge {
            let at = |z: i64| {
                [
                    [0, 0, 3 * z],
                    [a[0] * s, a[1] * s, 3 * z],
                    [b[0] * t, b[1] * t, 3 * z],
                ]
            };
            [at(low), at(high)].concat()
        } else {
            let c = directions[pick(16)];
            vec![
                [0, 0, 0],
                [a[0] * s, a[1] * s, 2 * low],
                [b[0] * t, b[1] * t, 2 * high],
                [c[0], c[1], 2 * (i64::try_from(pick(5)).unwrap() - 2)],
            ]
        };
        solids.extend(hull(&points).map(Body::solid));
    }
    solids
}

/// The claim of the engine's documentation.
#[test]
fn totals_are_a_function_of_the_set_alone() {
    for number in 0..FAMILIES {
        for seed in 0..rounds(200) {
            let mut random = Random::new(seed * 100 + number as u64);
            let mut bodies = family(number, &mut random);
            if below(&mut random, 5) == 0 {
                bodies.push(bodies[0].clone());
            }
            let context = format!("family {number}, seed {seed}");
            check_history(&mut random, None, &bodies, &context);
        }
    }
}

/// Deletes and inserts some of the bodies, which have their places for ids.
fn random_effect(random: &mut Random, engine: &Engine, bodies: &[Body], share: i64) -> Effect {
    let mut effect = Effect::default();
    for (id, body) in (0..).map(SolidId).zip(bodies) {
        if below(random, 100) >= share {
            continue;
        }
        match engine.get(id) {
            Some(there) => effect.deleted.push((id, there.clone())),
            None => effect.inserted.push((id, body.clone())),
        }
    }
    shuffle(random, &mut effect.inserted);
    shuffle(random, &mut effect.deleted);
    effect
}

fn random_stock(random: &mut Random, bodies: &[Body]) -> Option<Stock> {
    let body = &bodies[usize::try_from(below(random, 2)).unwrap()];
    (below(random, 2) == 0).then(|| Stock::new(body.part(0)).unwrap())
}

#[test]
fn a_dry_run_says_what_a_change_would_do_and_changes_nothing() {
    for number in 0..FAMILIES {
        for seed in 0..rounds(60) {
            let mut random = Random::new(seed * 100 + number as u64 + 2_000_000);
            let mut bodies = family(number, &mut random);
            bodies.push(bodies[0].clone());
            let stock = random_stock(&mut random, &bodies);
            // What is prepared is dropped at once, so that the dry run must make it anew.
            let bytes = if seed % 3 == 0 { 0 } else { 1 << 20 };
            let mut engine = Engine::new().with_stock(stock).with_prepared(bytes);
            for _ in 0..6 {
                let effect = random_effect(&mut random, &engine, &bodies, 40);
                let state = |engine: &Engine| format!("{engine:?}");
                let before = state(&engine);
                let (expected, error_max) = engine.dry_run(&effect).unwrap();
                // What was rounded before counts on, unless all of it goes.
                let rounded = match engine.len() == effect.deleted.len() as u64 {
                    true => 0,
                    false => engine.error_max().volume6,
                };
                assert!(error_max.volume6 >= rounded, "family {number}, seed {seed}");
                assert!(state(&engine) == before, "family {number}, seed {seed}");
                engine.apply(&effect).unwrap();
                assert_eq!(expected, engine.totals(), "family {number}, seed {seed}");
            }
            let absent = SolidId(1_000);
            let effect = Effect {
                deleted: vec![(absent, bodies[0].clone())],
                inserted: Vec::new(),
            };
            assert_eq!(engine.dry_run(&effect).unwrap_err().id, absent);
        }
    }
}

/// Boxes under a linear map of the lattice onto itself, which moves no point into or out of anything: where a point lies is told by the eight
/// octants around it.
#[test]
fn where_a_point_lies_is_what_the_octants_around_it_say() {
    for seed in 0..rounds(400) {
        let mut random = Random::new(seed + 4_000_000);
        let shear = [(); 3].map(|()| below(&mut random, 5) - 2);
        let map = |[x, y, z]: [i64; 3]| {
            let y = y + shear[0] * x;
            [x, y, z + shear[1] * x + shear[2] * y]
        };
        let random_box = |random: &mut Random| {
            let ends = [(); 3].map(|()| {
                let low = below(random, 5);
                [low, low + 1 + below(random, 4)]
            });
            Bounds {
                min: ends.map(|[low, _]| low as i32),
                max: ends.map(|[_, high]| high as i32),
            }
        };
        let solid = |bounds: &Bounds| {
            let corner = |number: usize| {
                let ends = [bounds.min, bounds.max];
                map([0, 1, 2].map(|axis| i64::from(ends[number >> axis & 1][axis])))
            };
            hull(&[0, 1, 2, 3, 4, 5, 6, 7].map(corner)).unwrap()
        };
        let stock = (below(&mut random, 2) == 0).then(|| random_box(&mut random));
        let made = stock
            .as_ref()
            .map(|bounds| Stock::new(solid(bounds)).unwrap());
        let mut engine = Engine::new().with_stock(made);
        let boxes: Vec<Bounds> = (0..1 + below(&mut random, 12))
            .map(|_| random_box(&mut random))
            .collect();
        for (id, bounds) in boxes.iter().enumerate() {
            insert(&mut engine, id, &Body::solid(solid(bounds)));
        }
        let in_stock = |voxel| stock.is_none_or(|stock| holds(&stock, voxel));
        for number in 0..10 * 10 * 10 {
            let at = [number / 100 - 1, number / 10 % 10 - 1, number % 10 - 1];
            let voxels = (0..8).map(|octant| [0, 1, 2].map(|axis| at[axis] - (octant >> axis & 1)));
            let voxels: Vec<[i32; 3]> = voxels.collect();
            let is_filled = |bounds: &Bounds| {
                let filled = |voxel: &&[i32; 3]| holds(bounds, **voxel) && in_stock(**voxel);
                voxels.iter().filter(filled).count() > 0
            };
            let filled = voxels.iter().filter(|voxel| {
                in_stock(**voxel) && boxes.iter().any(|bounds| holds(bounds, **voxel))
            });
            let side = match filled.count() {
                0 => Side::Outside,
                8 => Side::Inside,
                _ => Side::Boundary,
            };
            let holder = boxes.iter().position(is_filled);
            let expected = (side, holder.map(|id| SolidId(id as u64)));
            let found = engine.contains(point(map(at.map(i64::from))));
            assert_eq!(found, expected, "seed {seed}, at {at:?}");
        }
    }
}

/// Wedges that fill the space around an edge and a vertex, but for one.
#[test]
fn a_point_is_inside_when_fans_close_around_it() {
    let around = |tip: [i64; 3], ring: &[[i64; 3]]| -> Vec<Body> {
        let next = |index: usize| ring[(index + 1) % ring.len()];
        let wedges = ring.iter().enumerate();
        let apexes = [[0, 0, 50], [0, 0, -50]];
        wedges
            .flat_map(|(index, one)| {
                apexes.map(|apex| Body::solid(hull(&[tip, *one, next(index), apex]).unwrap()))
            })
            .collect()
    };
    let ring = [
        [60, 7, 3],
        [11, 53, -5],
        [-47, 29, 2],
        [-31, -41, 9],
        [23, -59, -4],
    ];
    let wedges = around([0, 0, 0], &ring);
    let origin = point([0, 0, 0]);
    let mut engine = Engine::new();
    for (id, wedge) in wedges.iter().enumerate() {
        assert_ne!(engine.contains(origin).0, Side::Inside, "{id} wedges");
        insert(&mut engine, id, wedge);
    }
    assert_eq!(engine.contains(origin), (Side::Inside, Some(SolidId(0))));
    // On the edge that all upper wedges share.
    let above = point([0, 0, 20]);
    assert_eq!(engine.contains(above), (Side::Inside, Some(SolidId(0))));
    for (id, body) in wedges.iter().enumerate() {
        delete(&mut engine, id);
        let least = SolidId(u64::from(id == 0));
        assert_eq!(engine.contains(origin), (Side::Boundary, Some(least)));
        insert(&mut engine, id, body);
    }
}

#[test]
fn batches_on_several_threads_have_the_totals_of_one_by_one() {
    for number in 0..FAMILIES {
        for seed in 0..rounds(20) {
            let mut random = Random::new(seed * 100 + number as u64 + 3_000_000);
            let mut bodies = Vec::new();
            while bodies.len() < 30 {
                bodies.extend(family(number, &mut random));
            }
            bodies.push(bodies[0].clone());
            let stock = random_stock(&mut random, &bodies);
            let threads = NonZero::new(2 + seed as usize % 2).unwrap();
            let one = NonZero::new(1).unwrap();
            let engine = || Engine::new().with_stock(stock.clone());
            let (mut batches, mut single) =
                (engine().with_threads(threads), engine().with_threads(one));
            if seed % 3 == 0 {
                batches = batches.with_prepared(0);
            }
            let context = format!("family {number}, seed {seed}");
            // Most come, many go and some come again, some more go: batches as long as they are, singly for the rest.
            for share in [90, 80, 60, 10] {
                let effect = random_effect(&mut random, &batches, &bodies, share);
                batches.apply(&effect).unwrap();
                single.apply(&effect).unwrap();
                assert_eq!(batches.totals(), single.totals(), "{context}, {share} %");
            }
            let deleted = batches.solids().map(|(id, body)| (id, body.clone()));
            let effect = Effect {
                deleted: deleted.collect(),
                inserted: Vec::new(),
            };
            batches.apply(&effect).unwrap();
            let nothing = engine();
            assert_eq!(batches.totals(), nothing.totals(), "{context}");
            assert_eq!(batches.error_max(), nothing.error_max(), "{context}");
            assert_eq!(batches.parts(), [0, 0], "{context}");
        }
    }
}

/// One by one and on several threads, bodies of several parts and some that are there twice among them.
#[test]
fn totals_after_each_body_are_those_of_single_insertions() {
    let mut batches = 0;
    for number in 0..FAMILIES {
        for seed in 0..rounds(20) {
            let mut random = Random::new(seed * 100 + number as u64 + 4_000_000);
            let mut bodies = Vec::new();
            while bodies.len() < 20 {
                bodies.extend(family(number, &mut random));
            }
            bodies.push(bodies[0].clone());
            let stock = random_stock(&mut random, &bodies);
            shuffle(&mut random, &mut bodies);
            let bodies: Vec<_> = (0..).map(SolidId).zip(bodies).collect();
            let mut single = Engine::new().with_stock(stock.clone());
            let mut expected = Vec::new();
            for (id, body) in &bodies {
                insert(&mut single, usize::try_from(id.0).unwrap(), body);
                expected.push(single.totals());
            }
            let threads = NonZero::new(1 + (seed as usize + number) % 3).unwrap();
            let mut engine = Engine::new().with_stock(stock).with_threads(threads);
            // Some are there already, and others come in two calls.
            let (first, rest) = bodies.split_at(usize::try_from(below(&mut random, 4)).unwrap());
            batches += u32::from(threads.get() > 1);
            let mut found = engine.insert_each(first.to_vec()).unwrap();
            found.extend(engine.insert_each(rest.to_vec()).unwrap());
            let context = format!("family {number}, seed {seed}");
            assert_eq!(found, expected, "{context}");
            assert_eq!(engine.totals(), single.totals(), "{context}");
            // All or none.
            let again = vec![(SolidId(1_000), bodies[0].1.clone()), bodies[1].clone()];
            assert_eq!(engine.insert_each(again).unwrap_err().id, bodies[1].0);
            assert_eq!(engine.totals(), single.totals(), "{context}");
        }
    }
    assert!(batches > 0);
}

#[test]
fn without_bodies_only_the_rounding_of_the_stock_is_left() {
    let mut random = Random::new(1);
    let bodies = family(3, &mut random);
    let stock = Stock::new(bodies[0].part(0)).unwrap();
    for stock in [None, Some(stock)] {
        let mut engine = Engine::new().with_stock(stock.clone());
        let nothing = engine.error_max();
        assert_eq!(nothing == ErrorMax::default(), stock.is_none());
        insert(&mut engine, 1, &bodies[1]);
        assert!(engine.error_max().volume6 > nothing.volume6);
        delete(&mut engine, 1);
        assert_eq!(engine.error_max(), nothing);
    }
}
