//! What cutters sweep, against closed formulas: exactly for the polygonised cutter, and in the limit for the round one.

#[path = "oracle/random.rs"]
mod random;

use std::f64::consts::PI;
use std::sync::Arc;

use random::Random;
use union3d::engine::solids::{Body, Engine, Op, Shape, SolidId, Stock, Totals};
use union3d::geometry::convex::{Cutter, End, Fit, Point, Solid, cross, dot};

fn point(coordinates: [i64; 3]) -> Point {
    Point::new(coordinates).unwrap()
}

fn cutter(end: End, sides: u16, fit: Fit) -> Solid {
    let cutter = Cutter {
        end,
        diameter: 60_000,
        length: 100_000,
        sides,
        fit,
    };
    cutter.solid().unwrap().0
}

fn round(rings: u16) -> End {
    End::Round {
        corner_diameter: 60_000,
        rings,
    }
}

/// Twice the area of a facet times its outward unit normal: a vector of integers.
fn area_vector2(solid: &Solid, facet: usize) -> [i64; 3] {
    let at = |vertex: u16| solid.vertices()[usize::from(vertex)].wide();
    let vertices = solid.facet(facet).vertices;
    let apex = at(vertices[0]);
    let from_apex = |vertex: u16| {
        let at = at(vertex);
        [0, 1, 2].map(|axis| at[axis] - apex[axis])
    };
    let mut sum = [0; 3];
    for pair in vertices[1..].windows(2) {
        let part = cross(from_apex(pair[0]), from_apex(pair[1]));
        sum = [0, 1, 2].map(|axis| sum[axis] + part[axis]);
    }
    sum
}

/// The union of what a cutter sweeps along a path, and of two paths.
fn milled(cutter: &Solid, paths: &[&[[i64; 3]]]) -> (Totals, f64) {
    milled_from(None, cutter, paths)
}

/// The same, cut from a stock.
fn milled_from(stock: Option<Stock>, cutter: &Solid, paths: &[&[[i64; 3]]]) -> (Totals, f64) {
    let shape = Arc::new(Shape::new(vec![cutter.clone()]).unwrap());
    let moves = paths.iter().flat_map(|path| path.windows(2));
    let ops: Vec<Op> = (0..)
        .map(SolidId)
        .zip(moves)
        .map(|(id, ends)| {
            let body = Body::swept(&shape, point(ends[0]), point(ends[1])).unwrap();
            Op::Insert(id, body)
        })
        .collect();
    let mut engine = Engine::new().with_stock(stock);
    let judged = engine.judge(&ops).unwrap();
    engine.apply(&judged.effect).unwrap();
    (engine.totals(), engine.error_max().volume6 as f64 / 96.0)
}

/// The union's volume is this many steps cubed, to what the engine says of its rounding.
#[track_caller]
fn check_volume(cutter: &Solid, paths: &[&[[i64; 3]]], expected6: i128) {
    let (totals, error) = milled(cutter, paths);
    let found = totals.measures.volume6 as f64 / 96.0;
    let expected = expected6 as f64 / 6.0;
    // The floats themselves are off by a part in 2^52.
    assert!(
        (found - expected).abs() <= error + expected * 1e-15,
        "{found} is not {expected}"
    );
}

/// The volume that a convex body adds when it is carried along a segment is the body's shadow along it times its length.
#[test]
fn a_sweep_adds_its_shadow() {
    let mut random = Random::new(1);
    for fit in [Fit::EqualArea, Fit::Inscribed, Fit::Circumscribed] {
        for (end, sides) in [
            (End::Flat, 32),
            (End::Flat, 7),
            (round(8), 16),
            (
                End::Round {
                    corner_diameter: 10_000,
                    rings: 4,
                },
                24,
            ),
            (
                End::Cone {
                    tip_diameter: 2_000,
                    angle: 60_000_000,
                },
                32,
            ),
            (
                End::Cone {
                    tip_diameter: 0,
                    angle: 118_000_000,
                },
                12,
            ),
        ] {
            let cutter = cutter(end, sides, fit);
            for _ in 0..20 {
                // Along axes, in planes and in general: straight slots, plunges and ramps.
                let limits = [0; 3].map(|_: i32| [0, 40, 400_000][random.below(3) as usize]);
                let along = limits.map(|limit| random.within(-limit, limit));
                let swept = cutter.swept(Point::ORIGIN, point(along)).unwrap();
                let shadow: i128 = (0..cutter.planes().len())
                    .map(|facet| dot(area_vector2(&cutter, facet), along).max(0))
                    .sum();
                assert_eq!(swept.volume6(), cutter.volume6() + 3 * shadow, "{along:?}");
            }
        }
    }
}

#[test]
fn slots_have_the_volume_of_their_plan() {
    // A polygon that is the same seen along x and along y, so that its greatest extents are those of the slots.
    for sides in [4, 8, 32] {
        let cutter = cutter(End::Flat, sides, Fit::EqualArea);
        let bounds = cutter.bounds();
        let (half, height) = (i128::from(bounds.max[0]), i128::from(bounds.max[2]));
        assert_eq!(
            (bounds.max[0], bounds.min[0]),
            (bounds.max[1], -bounds.max[1])
        );
        let polygon2 = cutter.volume6() / (3 * height);
        let length = 400_000;
        let slot2 = polygon2 + 4 * half * i128::from(length);
        let volume6 = |plan2: i128| 3 * plan2 * height;
        let along_x = [[0, 0, 0], [length, 0, 0]];
        check_volume(&cutter, &[&along_x], volume6(slot2));
        // In many moves, and there and back: the same slot, to the last unit.
        let (whole, _) = milled(&cutter, &[&along_x]);
        let steps: Vec<[i64; 3]> = (0..=40).map(|step| [step * length / 40, 0, 0]).collect();
        let back: Vec<_> = steps.iter().rev().copied().collect();
        for paths in [
            &[&steps[..]][..],
            &[&steps, &back],
            &[&along_x, &back[3..20]],
        ] {
            assert_eq!(milled(&cutter, paths).0.measures, whole.measures);
        }
        // A cross: the two slots have a square in common.
        let across = [[length / 2, -length / 2, 0], [length / 2, length / 2, 0]];
        check_volume(
            &cutter,
            &[&along_x, &across],
            volume6(2 * slot2 - 8 * half * half),
        );
        // An L: in common are three quarters of the polygon, and in the fourth quarter a square.
        let corner = [[length, 0, 0], [0, 0, 0], [0, length, 0]];
        let common2 = polygon2 * 3 / 4 + 2 * half * half;
        check_volume(&cutter, &[&corner], volume6(2 * slot2 - common2));
        // A plunge, and a slot from its bottom: they have the cutter at the bottom in common.
        let plunge = [[0, 0, 50_000], [0, 0, 0], [length, 0, 0]];
        let plunged2 = volume6(slot2) + 3 * polygon2 * 50_000;
        check_volume(&cutter, &[&plunge], plunged2);
    }
}

#[test]
fn a_way_cut_before_removes_nothing() {
    let mut random = Random::new(2);
    for _ in 0..20 {
        let cutter = cutter(round(4), 12, Fit::EqualArea);
        let mut at = [0; 3];
        let path: Vec<[i64; 3]> = (0..6)
            .map(|_| {
                at = at.map(|part| part + random.within(-50_000, 50_000));
                at
            })
            .collect();
        let back: Vec<_> = path.iter().rev().copied().collect();
        let (once, _) = milled(&cutter, &[&path]);
        let (twice, _) = milled(&cutter, &[&path, &back, &path[2..4]]);
        assert_eq!(once.measures, twice.measures);
        assert_eq!(twice.solids, 11);
    }
}

/// The error falls with the square of the number of sides.
#[test]
fn volumes_converge_to_those_of_the_round_cutter() {
    let (radius, height, length) = (30_000.0, 100_000.0, 400_000.0);
    let corner = [[400_000, 0, 0], [0, 0, 0], [0, 400_000, 0]];
    let disc = PI * radius * radius;
    let slot = disc + 2.0 * radius * length;
    let flat_true = (2.0 * slot - 0.75 * disc - radius * radius) * height;
    // A ball's groove: its own volume, and half a disc and a rectangle along the way.
    let groove = [[0, 0, 0], [400_000, 0, 0]];
    let shank = height - radius;
    let ball = 2.0 / 3.0 * disc * radius + disc * shank;
    let ball_true = ball + (disc / 2.0 + 2.0 * radius * shank) * length;
    println!("| sides | rings | flat, inscribed | equal area | circumscribed | ball, equal area |");
    for (sides, rings) in [(8, 4), (16, 8), (32, 16), (64, 32)] {
        let error = |end, fit, path: &[[i64; 3]], truth: f64| {
            let (totals, _) = milled(&cutter(end, sides, fit), &[path]);
            totals.measures.volume6 as f64 / 96.0 / truth - 1.0
        };
        let errors = [
            error(End::Flat, Fit::Inscribed, &corner, flat_true),
            error(End::Flat, Fit::EqualArea, &corner, flat_true),
            error(End::Flat, Fit::Circumscribed, &corner, flat_true),
            error(round(rings), Fit::EqualArea, &groove, ball_true),
        ];
        println!(
            "| {sides} | {rings} | {} |",
            errors.map(|error| format!("{error:+.1e}")).join(" | ")
        );
        assert!(errors[0] < 0.0 && errors[2] > 0.0);
        // Of the regular polygon inside a circle the width is short by (pi / sides)^2 / 2 = 4.9 / sides^2.
        let bound = 5.5 / f64::from(sides).powi(2);
        assert!(
            errors.iter().all(|error| error.abs() < bound),
            "{sides} sides"
        );
    }
}

fn block(min: [i64; 3], max: [i64; 3]) -> Stock {
    Stock::new(Solid::cuboid(point(min), point(max)).unwrap()).unwrap()
}

/// Slots through and into a block: all measures of both parts, from the plan of the polygonised cutter.
#[test]
fn a_slot_in_a_stock_leaves_the_rest_of_it() {
    for sides in [4, 8, 32] {
        let cutter = cutter(End::Flat, sides, Fit::EqualArea);
        let half = i64::from(cutter.bounds().max[0]);
        let (width, depth) = (200_000, 40_000);
        let stock = || block([0, -width, -width], [width, width, 0]);
        // Of a box with these sides, in the units of the measures.
        let volume = |[x, y, z]: [i64; 3]| 96 * i128::from(x) * i128::from(y) * i128::from(z);
        let area = |[x, y, z]: [i64; 3]| i128::from(x * y + y * z + z * x) << 18;
        let length = |[x, y, z]: [i64; 3]| i128::from(x + y + z) << 23;
        // All along x: a block is removed, and the rest is a block with a notch.
        let through = [[-100_000, 0, -depth], [300_000, 0, -depth]];
        let (totals, _) = milled_from(Some(stock()), &cutter, &[&through]);
        let removed = [width, 2 * half, depth];
        assert_eq!(totals.measures.volume6, volume(removed));
        assert_eq!(totals.measures.area2, area(removed));
        assert_eq!(totals.measures.edge_length2, [length(removed), 0, 0]);
        let rest = totals.remaining.unwrap();
        let whole = [width, 2 * width, width];
        assert_eq!(rest.volume6, volume(whole) - volume(removed));
        // The walls come, and the profile goes at both ends; the floor stands for what is open.
        let more = i128::from(2 * width * depth - 2 * 2 * half * depth) << 17;
        assert_eq!(rest.area2, area(whole) + more);
        // Two edges more on top, of which each end of the slot takes a part away and adds three sides; two along the floor are concave.
        let convex = 2 * width - 2 * 2 * half + 2 * (2 * depth + 2 * half);
        let [of_convex, of_concave, of_crossing] = rest.edge_length2;
        assert_eq!(of_convex, length(whole) + (i128::from(convex) << 21));
        assert_eq!(of_concave, i128::from(2 * width) << 21);
        assert_eq!(of_crossing, 0);
        // The whole width of it at several depths, there and back: the upper part is gone.
        let mut rows = Vec::new();
        for z in [-10_000, -25_000, -depth] {
            for row in -8..=8 {
                let ends = [[-100_000, row * half, z], [300_000, row * half, z]];
                rows.push(ends);
                rows.push([ends[1], ends[0]]);
            }
        }
        let rows: Vec<&[[i64; 3]]> = rows.iter().map(|row| &row[..]).collect();
        let (totals, _) = milled_from(Some(stock()), &cutter, &rows);
        let left = [width, 2 * width, width - depth];
        let rest = totals.remaining.unwrap();
        assert_eq!(rest.volume6, volume(left));
        assert_eq!(rest.area2, area(left));
        assert_eq!(rest.edge_length2, [length(left), 0, 0]);
    }
}

/// A helix to the bottom and a round there make a round hole, as exactly as the polygons are round.
#[test]
fn a_helix_bores_a_round_hole() {
    let (radius, around, depth) = (30_000.0, 20_000.0, 40_000_i64);
    let truth = PI * (radius + around) * (radius + around) * depth as f64;
    println!("| sides | chords a turn | hole |");
    let mut last = f64::INFINITY;
    for sides in [8_u16, 16, 32] {
        let cutter = cutter(End::Flat, sides, Fit::EqualArea);
        // Four turns down and one round at the bottom, in as many chords a turn as the cutter has sides.
        let chords = i64::from(sides);
        let at = |step: i64| {
            let angle = 2.0 * PI * step as f64 / chords as f64;
            let down = depth * step / (4 * chords);
            let [x, y] = [angle.cos(), angle.sin()].map(|part| (around * part).round() as i64);
            [x, y, -down.min(depth)]
        };
        let path: Vec<[i64; 3]> = (0..=5 * chords).map(at).collect();
        let stock = block([-100_000, -100_000, -60_000], [100_000, 100_000, 0]);
        let (totals, _) = milled_from(Some(stock), &cutter, &[&path]);
        let found = totals.measures.volume6 as f64 / 96.0;
        let error = found / truth - 1.0;
        println!("| {sides} | {chords} | {error:+.1e} |");
        assert!(
            error.abs() < 7.0 / f64::from(sides).powi(2),
            "{sides} sides"
        );
        assert!(error.abs() < last, "more sides are closer");
        last = error.abs();
        // The way back removes nothing.
        let back: Vec<[i64; 3]> = path.iter().rev().copied().collect();
        let stock = block([-100_000, -100_000, -60_000], [100_000, 100_000, 0]);
        let (again, _) = milled_from(Some(stock), &cutter, &[&path, &back]);
        assert_eq!(again.measures, totals.measures);
        assert_eq!(again.remaining, totals.remaining);
    }
}

/// A body is made exactly where its parts can be carried, at the limits, too, and refused with the same words.
#[test]
fn a_body_is_refused_where_its_sweep_is() {
    const LIMIT: i64 = 1 << 30;
    const LONGEST: i64 = 1 << 21;
    let cutter = cutter(End::Flat, 8, Fit::EqualArea);
    let ball = self::cutter(round(2), 8, Fit::EqualArea);
    let mut random = Random::new(7);
    let mut refused = 0;
    for round in 0..4_000 {
        let solid = if round % 4 == 0 { &ball } else { &cutter };
        let plain = Shape::new(vec![solid.clone()]).unwrap();
        let bounds = solid.bounds();
        let width = i64::from(bounds.max[0]) - i64::from(bounds.min[0]);
        // Ends at and next to where what is swept gets too long, or too far out.
        let near = |random: &mut Random, at: i64| at + random.below(3) as i64 - 1;
        let reach = i64::from(bounds.max[0]);
        let start = match random.below(4) {
            0 => near(&mut random, LIMIT - reach),
            1 => near(&mut random, reach - LIMIT),
            _ => random.below(1000) as i64,
        };
        let way = match random.below(3) {
            0 => near(&mut random, LONGEST - width),
            _ => random.below(3) as i64,
        };
        let end = if start > 1000 {
            start - way
        } else {
            start + way
        };
        let axis = random.below(3) as usize;
        let mut ends = [[0; 3]; 2];
        (ends[0][axis], ends[1][axis]) = (start, end);
        let ends = ends.map(Point::new);
        let [Ok(from), Ok(to)] = ends else { continue };
        let height = i64::from(bounds.max[2]) + from.wide()[2].max(to.wide()[2]);
        let top = near(&mut random, height).clamp(-LIMIT - 1, LIMIT + 1) as i32;
        let (shape, expected) = if random.below(2) == 0 {
            let expected = solid.swept(from, to).map_err(|why| why.to_string());
            (plain, expected)
        } else {
            let expected = solid.swept_to_top(from, to, top);
            (plain.with_top(top), expected.map_err(|why| why.to_string()))
        };
        let body = Body::swept(&Arc::new(shape), from, to).map_err(|why| why.to_string());
        match (body, expected) {
            (Ok(body), Ok(expected)) => assert_eq!(body.bounds(), expected.bounds()),
            (Err(found), Err(why)) => {
                refused += 1;
                assert_eq!(found, format!("part 0: {why}"));
            }
            (body, expected) => panic!("{from:?} to {to:?}: {body:?} and {expected:?}"),
        }
    }
    assert!(refused > 1_000, "{refused}");
}
