//! What cutters sweep, against closed formulas: exactly for the polygonised cutter, and in the limit for the round one.

#[path = "oracle/random.rs"]
mod random;

use std::f64::consts::PI;
use std::sync::Arc;

use random::Random;
use union3d::engine::solids::{Body, Engine, Op, Shape, SolidId, Totals};
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
    let mut engine = Engine::new();
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
