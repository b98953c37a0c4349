//! The faces of scenes of solids: closed, and with the measures of the union that the engine keeps.
//!
//! Small worlds with large bodies, so that ties are the common case. Every random test prints its seed when it fails.

#[path = "oracle/random.rs"]
mod random;

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::sync::Arc;

use random::Random;
use union3d::boundary::{Face, NoStock, Region, solids};
use union3d::engine::solids::{
    AREA_UNIT, Body, Effect, Engine, ErrorMax, LENGTH_UNIT, Measures, Shape, SolidId, Stock,
    VOLUME_UNIT,
};
use union3d::geometry::Bounds;
use union3d::geometry::convex::{Cutter, End, Fit, Point, Solid};

/// Scenes of a random test: few in debug, many where they are fast.
fn rounds(release: u64) -> u64 {
    if cfg!(feature = "paranoid") {
        release / 100 + 1
    } else if cfg!(debug_assertions) {
        release / 10 + 1
    } else {
        release
    }
}

fn point(coordinates: [i64; 3]) -> Point {
    Point::new(coordinates).unwrap()
}

fn random_point(random: &mut Random, side: i64) -> [i64; 3] {
    [(); 3].map(|()| random.within(0, side))
}

fn random_box(random: &mut Random, side: i64) -> Bounds {
    let (mut min, mut max) = ([0; 3], [0; 3]);
    for axis in 0..3 {
        let low = random.below(side);
        min[axis] = i32::try_from(low).unwrap();
        max[axis] = i32::try_from(low + 1 + random.below(side - low)).unwrap();
    }
    Bounds { min, max }
}

fn solid_of_box(bounds: &Bounds) -> Solid {
    let [min, max] = [bounds.min, bounds.max].map(|corner| point(corner.map(i64::from)));
    Solid::cuboid(min, max).unwrap()
}

fn random_hull(random: &mut Random, side: i64) -> Solid {
    loop {
        let count = 4 + random.below(6);
        let points: Vec<Point> = (0..count)
            .map(|_| point(random_point(random, side)))
            .collect();
        if let Ok(hull) = Solid::hull(&points) {
            return hull;
        }
    }
}

/// A box, a hull, or a shape carried along a segment.
fn random_body(random: &mut Random, side: i64, shapes: &[Arc<Shape>]) -> Body {
    match random.below(4) {
        0 => Body::solid(solid_of_box(&random_box(random, side))),
        1 => Body::solid(random_hull(random, side)),
        kind => {
            let shape = &shapes[random.below(shapes.len())];
            let from = point(random_point(random, side));
            let to = if kind == 2 {
                from
            } else {
                point(random_point(random, side))
            };
            Body::swept(shape, from, to).unwrap()
        }
    }
}

fn shapes() -> Vec<Arc<Shape>> {
    let cuboid = |min, max| Solid::cuboid(point(min), point(max)).unwrap();
    let tip = [[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2]].map(point);
    let octahedron = [
        [1, 0, 0],
        [-1, 0, 0],
        [0, 1, 0],
        [0, -1, 0],
        [0, 0, 1],
        [0, 0, -1],
    ];
    let parts = [
        vec![cuboid([0; 3], [1; 3])],
        vec![Solid::hull(&tip).unwrap()],
        vec![Solid::hull(&octahedron.map(point)).unwrap()],
        vec![cuboid([0; 3], [1, 1, 2]), cuboid([-1, -1, 2], [2, 2, 3])],
    ];
    let shapes = parts
        .into_iter()
        .map(|parts| Arc::new(Shape::new(parts).unwrap()));
    shapes.collect()
}

/// A scene with many ties.
struct Scene {
    bodies: Vec<(SolidId, Body)>,
    stock: Option<Stock>,
}

impl Scene {
    fn random(random: &mut Random, with_stock: bool) -> Self {
        let side = random.within(2, 6);
        let shapes = shapes();
        let count = random.within(1, 9);
        let mut bodies: Vec<Body> = (0..count)
            .map(|_| random_body(random, side, &shapes))
            .collect();
        if random.below(4) == 0 {
            bodies.push(bodies[0].clone());
        }
        let stock = with_stock.then(|| {
            let solid = match random.below(3) {
                0 => random_hull(random, side),
                _ => solid_of_box(&random_box(random, side)),
            };
            Stock::new(solid).unwrap()
        });
        Self {
            bodies: (0..).map(SolidId).zip(bodies).collect(),
            stock,
        }
    }

    fn faces(&self, region: Region, within: Option<Bounds>) -> Vec<Face> {
        let mut faces = Vec::new();
        let all = solids::faces(
            self.bodies.iter().cloned(),
            self.stock.as_ref(),
            region,
            within,
            &|| true,
            &mut |face| {
                faces.push(face.clone());
                ControlFlow::Continue(())
            },
        );
        assert_eq!(all, Ok(ControlFlow::Continue(())));
        faces
    }

    /// The measures that the engine keeps, and how far rounding can be off.
    fn measures(&self, region: Region) -> (Measures, ErrorMax) {
        let stock = match region {
            Region::Union => None,
            _ => self.stock.clone(),
        };
        let mut engine = Engine::new().with_stock(stock);
        let effect = Effect {
            deleted: Vec::new(),
            inserted: self.bodies.clone(),
        };
        engine.apply(&effect).unwrap();
        let totals = engine.totals();
        let measures = match region {
            Region::Remaining => totals.remaining.unwrap(),
            _ => totals.measures,
        };
        (measures, engine.error_max())
    }
}

type Vector = [f64; 3];

fn minus(a: Vector, b: Vector) -> Vector {
    [0, 1, 2].map(|axis| a[axis] - b[axis])
}

fn dot(a: Vector, b: Vector) -> f64 {
    (0..3).map(|axis| a[axis] * b[axis]).sum()
}

fn cross(a: Vector, b: Vector) -> Vector {
    [(1, 2), (2, 0), (0, 1)].map(|(i, j)| a[i] * b[j] - a[j] * b[i])
}

fn length(a: Vector) -> f64 {
    dot(a, a).sqrt()
}

/// A point as an ordered key: equal points have equal bits.
fn key(point: Vector) -> [u64; 3] {
    point.map(|coordinate| (coordinate + 0.0).to_bits())
}

fn area(face: &Face) -> f64 {
    let [from, _] = face.edges[0];
    let twice =
        |[tail, head]: [Vector; 2]| dot(cross(minus(tail, from), minus(head, from)), face.normal);
    face.edges.iter().copied().map(twice).sum::<f64>() / 2.0
}

fn area_of(faces: &[Face]) -> f64 {
    faces.iter().map(area).sum()
}

/// Six times the volume that faces enclose, and the length of all their edges.
fn volume6_and_length(faces: &[Face]) -> [f64; 2] {
    let volume6 = |face: &Face| 2.0 * area(face) * dot(face.normal, face.edges[0][0]);
    let edges = faces.iter().flat_map(|face| &face.edges);
    [
        faces.iter().map(volume6).sum(),
        edges.map(|[tail, head]| length(minus(*head, *tail))).sum(),
    ]
}

/// Whether a surface is closed, but for its edges in the planes half a step around a box.
#[track_caller]
fn check_closed(faces: &[Face], within: Option<Bounds>) {
    let is_open = |[tail, head]: &[Vector; 2]| {
        within.is_some_and(|within| {
            (0..3).any(|axis| {
                let planes = [
                    f64::from(within.min[axis]) - 0.5,
                    f64::from(within.max[axis]) + 0.5,
                ];
                let in_plane = |plane: f64| [tail[axis], head[axis]] == [plane; 2];
                planes.into_iter().any(in_plane)
            })
        })
    };
    let mut planes = BTreeSet::new();
    let mut balance: BTreeMap<[[u64; 3]; 2], i64> = BTreeMap::new();
    let mut vertices = BTreeMap::new();
    for face in faces {
        assert!((length(face.normal) - 1.0).abs() < 1e-15);
        let mut at: BTreeMap<[u64; 3], i64> = BTreeMap::new();
        let offset = dot(face.normal, face.edges[0][0]);
        for [tail, head] in &face.edges {
            for end in [tail, head] {
                let off = (dot(face.normal, *end) - offset).abs();
                assert!(off < 1e-12 * (1.0 + length(*end)), "it is plane: {off}");
                vertices.insert(key(*end), *end);
            }
            assert_ne!(tail, head);
            *at.entry(key(*tail)).or_default() += 1;
            *at.entry(key(*head)).or_default() -= 1;
            if !is_open(&[*tail, *head]) {
                let ends = [key(*tail), key(*head)];
                let way = if ends[0] < ends[1] { 1 } else { -1 };
                let ends = [ends[0].min(ends[1]), ends[0].max(ends[1])];
                *balance.entry(ends).or_default() += way;
            }
        }
        assert!(
            at.values().all(|balance| *balance == 0),
            "its edges are loops: {face:?}"
        );
        let plane = (key(face.normal), (offset * 1e6).round() as i64);
        assert!(planes.insert(plane), "a plane has one face");
    }
    assert!(
        balance.values().all(|balance| *balance == 0),
        "every edge is there both ways"
    );
    for [tail, head] in faces.iter().flat_map(|face| &face.edges) {
        for vertex in vertices.values() {
            let (way, there) = (minus(*head, *tail), minus(*vertex, *tail));
            let along = dot(way, there) / dot(way, way);
            let off = length(cross(way, there)) / length(way);
            let is_between = off < 1e-9 && along > 1e-9 && along < 1.0 - 1e-9;
            assert!(!is_between, "{vertex:?} is between {tail:?} and {head:?}");
        }
    }
}

#[track_caller]
fn check_measures(faces: &[Face], (measures, error): &(Measures, ErrorMax), context: &str) {
    let [volume6, length] = volume6_and_length(faces);
    let close = |found: f64, expected: i128, unit: i32, error: u128, what: &str| {
        let unit = f64::exp2(f64::from(unit));
        let (expected, error) = (expected as f64 * unit, error as f64 * unit);
        let off = (found - expected).abs();
        assert!(
            off <= error + 1e-9 * (1.0 + expected.abs()),
            "{context}: {what} {found}, {expected} to {error}"
        );
    };
    close(
        volume6,
        measures.volume6,
        VOLUME_UNIT,
        error.volume6,
        "six times the volume",
    );
    close(
        2.0 * area_of(faces),
        measures.area2,
        AREA_UNIT,
        error.area2,
        "twice the area",
    );
    let (expected, error) = (measures.edge_length2_total(), error.edge_length2);
    close(
        length,
        expected,
        LENGTH_UNIT,
        error,
        "twice the edge length",
    );
}

#[test]
fn the_surface_is_closed_and_has_the_measures_of_the_union() {
    for seed in 0..rounds(4_000) {
        let scene = Scene::random(&mut Random::new(seed), false);
        let faces = scene.faces(Region::Union, None);
        check_closed(&faces, None);
        check_measures(
            &faces,
            &scene.measures(Region::Union),
            &format!("seed {seed}"),
        );
        assert!(faces.iter().all(|face| face.body.is_some()));
    }
}

#[test]
fn in_a_stock_so_have_what_is_removed_and_what_remains() {
    for seed in 0..rounds(2_000) {
        let scene = Scene::random(&mut Random::new(seed), true);
        for region in [Region::Removed, Region::Remaining, Region::Union] {
            let faces = scene.faces(region, None);
            check_closed(&faces, None);
            let context = format!("seed {seed}, {region:?}");
            check_measures(&faces, &scene.measures(region), &context);
        }
    }
}

#[test]
fn neighbouring_boxes_share_out_every_face() {
    for seed in 0..rounds(1_000) {
        let mut random = Random::new(seed);
        let scene = Scene::random(&mut random, true);
        let cuts = random_point(&mut random, 6).map(|cut| i32::try_from(cut).unwrap());
        for region in [Region::Union, Region::Removed, Region::Remaining] {
            let whole = scene.faces(region, None);
            let mut found = [0.0; 2];
            for octant in 0..8 {
                let mut within = Bounds {
                    min: [-100; 3],
                    max: [100; 3],
                };
                for (axis, cut) in cuts.into_iter().enumerate() {
                    if octant >> axis & 1 == 0 {
                        within.max[axis] = cut - 1;
                    } else {
                        within.min[axis] = cut;
                    }
                }
                let part = scene.faces(region, Some(within));
                check_closed(&part, Some(within));
                found[0] += area_of(&part);
                found[1] += volume6_and_length(&part)[0];
            }
            let whole = [area_of(&whole), volume6_and_length(&whole)[0]];
            for (found, whole) in found.into_iter().zip(whole) {
                assert!(
                    (found - whole).abs() < 1e-9 * (1.0 + whole.abs()),
                    "seed {seed}, {region:?}: {found} {whole}"
                );
            }
        }
    }
}

/// Round tools on paths that cross, and go along the stock's own faces.
#[test]
fn what_is_milled_has_a_closed_surface() {
    for seed in 0..rounds(60) {
        let mut random = Random::new(seed);
        let diameter = 1_000 * u32::try_from(random.within(1, 4)).unwrap();
        let cutter = Cutter {
            end: match random.below(2) {
                0 => End::Flat,
                _ => End::Round {
                    corner_diameter: diameter,
                    rings: 3,
                },
            },
            diameter,
            length: 10_000,
            sides: 8,
            fit: Fit::EqualArea,
        };
        let tool = Arc::new(Shape::new(vec![cutter.solid().unwrap().0]).unwrap());
        let mut at = [0; 3];
        let bodies = (0..random.within(5, 40)).map(|_| {
            let from = point(at);
            match random.below(4) {
                0 => at[0] = 500 * random.within(-4, 4),
                1 => at[1] = 500 * random.within(-4, 4),
                2 => at[2] = -500 * random.within(0, 3),
                _ => at = [(); 3].map(|()| random.within(-2_000, 2_000)),
            }
            Body::swept(&tool, from, point(at)).unwrap()
        });
        let scene = Scene {
            bodies: (0..).map(SolidId).zip(bodies).collect(),
            stock: Some(
                Stock::new(solid_of_box(&Bounds {
                    min: [-2_000, -2_500, -1_500],
                    max: [2_000, 2_500, 1_000],
                }))
                .unwrap(),
            ),
        };
        for region in [Region::Removed, Region::Remaining, Region::Union] {
            let faces = scene.faces(region, None);
            check_closed(&faces, None);
            let context = format!("seed {seed}, {region:?}");
            check_measures(&faces, &scene.measures(region), &context);
        }
    }
}

/// Boxes as voxels: which are filled, in a world of this side.
struct Voxels<'v> {
    side: i32,
    is_filled: &'v dyn Fn([i32; 3]) -> bool,
}

impl Voxels<'_> {
    /// Whether a half of a voxel's face, by the middle of the face's quarter in quarters of a step, is exposed to this side of its plane.
    fn is_exposed(&self, axis: usize, outward: i32, quarters: [i32; 3]) -> bool {
        let mut inside = quarters.map(|quarter| quarter.div_euclid(4));
        let mut outside = inside;
        inside[axis] = quarters[axis] / 4 - i32::from(outward > 0);
        outside[axis] = inside[axis] + outward;
        (self.is_filled)(inside) && !(self.is_filled)(outside)
    }

    /// Compares all quarters of all faces, as far as they are within a box of voxels and half a step around it.
    #[track_caller]
    fn check(&self, faces: &[Face], within: Option<Bounds>, context: &str) {
        let mut left: Vec<&Face> = faces.iter().collect();
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            for (level, outward) in (0..=self.side).flat_map(|level| [(level, -1), (level, 1)]) {
                let is_here = |face: &&Face| {
                    face.normal[axis] == f64::from(outward)
                        && face.edges[0][0][axis] == f64::from(level)
                };
                let here = left.iter().position(is_here);
                let face = here.map(|index| left.swap_remove(index));
                let quarters = || (0..2 * self.side).map(|half| 2 * half + 1);
                for (a, b) in quarters().flat_map(|a| quarters().map(move |b| (a, b))) {
                    let mut at = [4 * level; 3];
                    (at[u], at[v]) = (a, b);
                    let is_within = within.is_none_or(|within| {
                        (0..3).all(|axis| {
                            let span = 4 * within.min[axis] - 2..=4 * within.max[axis] + 2;
                            span.contains(&at[axis])
                        })
                    });
                    let expected = i32::from(is_within && self.is_exposed(axis, outward, at));
                    let found = face.map_or(0, |face| winding(face, [u, v], outward, at));
                    assert_eq!(
                        found, expected,
                        "{context}: at {at:?} quarters, {axis} {outward}"
                    );
                }
            }
        }
        assert!(
            left.is_empty(),
            "{context}: all faces are those of voxels: {left:?}"
        );
    }
}

/// How often the edges of a face across axes u and v go around a point that is on none of them, given in quarters of a step.
fn winding(face: &Face, [u, v]: [usize; 2], outward: i32, quarters: [i32; 3]) -> i32 {
    let [at_u, at_v] = [u, v].map(|axis| f64::from(quarters[axis]) / 4.0);
    let mut winding = 0;
    for [tail, head] in &face.edges {
        // Edges along v to the right of the point.
        if tail[u] == head[u] && tail[u] > at_u {
            winding += i32::from(tail[v] < at_v && head[v] > at_v);
            winding -= i32::from(tail[v] > at_v && head[v] < at_v);
        }
    }
    winding * outward
}

#[test]
fn faces_of_boxes_are_those_of_voxels() {
    for seed in 0..rounds(1_000) {
        let mut random = Random::new(seed);
        let side = random.within(2, 6);
        let boxes: Vec<Bounds> = (0..random.within(1, 9))
            .map(|_| random_box(&mut random, side))
            .collect();
        let stock = random_box(&mut random, side);
        let within = (random.below(2) == 0).then(|| random_box(&mut random, side));
        let bodies = boxes.iter().map(|one| Body::solid(solid_of_box(one)));
        let scene = Scene {
            bodies: (0..).map(SolidId).zip(bodies).collect(),
            stock: Some(Stock::new(solid_of_box(&stock)).unwrap()),
        };
        let holds = |bounds: &Bounds, voxel: [i32; 3]| {
            (0..3).all(|axis| (bounds.min[axis]..bounds.max[axis]).contains(&voxel[axis]))
        };
        let is_in_union = |voxel| boxes.iter().any(|one| holds(one, voxel));
        for region in [Region::Union, Region::Removed, Region::Remaining] {
            let faces = scene.faces(region, within);
            let voxels = Voxels {
                side: i32::try_from(side).unwrap(),
                is_filled: &|voxel| match region {
                    Region::Union => is_in_union(voxel),
                    Region::Removed => is_in_union(voxel) && holds(&stock, voxel),
                    Region::Remaining => !is_in_union(voxel) && holds(&stock, voxel),
                },
            };
            let context = format!("seed {seed}, {region:?} within {within:?}");
            voxels.check(&faces, within, &context);
            check_closed(&faces, within);
        }
    }
}

#[test]
fn without_a_stock_nothing_is_removed_and_nothing_remains() {
    let go = &|| true;
    for region in [Region::Removed, Region::Remaining] {
        let listed = solids::faces(std::iter::empty(), None, region, None, go, &mut |_| {
            ControlFlow::Continue(())
        });
        assert_eq!(listed, Err(NoStock));
    }
}

#[test]
fn a_listing_is_a_function_of_the_set_alone() {
    for seed in 0..rounds(200) {
        let mut scene = Scene::random(&mut Random::new(seed), true);
        let faces = scene.faces(Region::Remaining, None);
        scene.bodies.reverse();
        assert_eq!(scene.faces(Region::Remaining, None), faces, "seed {seed}");
    }
}

#[test]
fn a_listing_ends_when_it_is_told_to() {
    let scene = Scene::random(&mut Random::new(1), false);
    let list = |goes_on: bool, count: usize| {
        let mut listed = 0;
        let flow = solids::faces(
            scene.bodies.iter().cloned(),
            None,
            Region::Union,
            None,
            &|| goes_on,
            &mut |_| {
                listed += 1;
                if listed < count {
                    ControlFlow::Continue(())
                } else {
                    ControlFlow::Break(())
                }
            },
        );
        assert_eq!(flow, Ok(ControlFlow::Break(())));
        listed
    };
    assert_eq!(list(true, 2), 2);
    assert_eq!(list(false, 2), 0);
}
