//! The faces of scenes of cubes, and the triangles of all faces: closed, and with the measures of the union that voxels have.
//!
//! Small worlds with large cubes, so that ties are the common case. Every random test prints its seed when it fails.

#[path = "oracle/random.rs"]
mod random;
#[path = "oracle/voxels.rs"]
mod voxels;

use std::collections::BTreeMap;
use std::ops::ControlFlow;

use random::Random;
use union3d::boundary::mesh::{Triangle, Triangulator};
use union3d::boundary::{Face, NoStock, Region, cubes};
use union3d::geometry::{Bounds, CubeId, Edge, Measures, Place, Stock};

const REGIONS: [Region; 3] = [Region::Union, Region::Removed, Region::Remaining];

/// Scenes of a random test: few in debug, many where they are fast.
fn rounds(release: u64) -> u64 {
    if cfg!(debug_assertions) {
        release / 10 + 1
    } else {
        release
    }
}

#[derive(Debug)]
struct Scene {
    edge: Edge,
    cubes: Vec<(CubeId, Place)>,
    stock: Stock,
}

impl Scene {
    fn random(random: &mut Random) -> Self {
        let steps = random.within(1, 4);
        let edge = Edge::new(steps).unwrap();
        let world = random.within(1, 7);
        // Sometimes in one layer, where many faces are coplanar.
        let flat = random.below(3) == 0;
        let most = [6, 40, 150][random.below(3_usize)];
        let count = random.below(most);
        let cubes = (0..count).map(|_| {
            let mut corner = [0; 3].map(|_: i32| random.within(-world, world));
            if flat {
                corner[2] = random.within(0, 1);
            }
            (
                CubeId(random.below(1000)),
                Place::new(corner, edge).unwrap(),
            )
        });
        let cubes = cubes.collect();
        let min = [0; 3].map(|_: i32| random.within(-world, world));
        let max = min.map(|low| low + random.within(1, 2 * world));
        let stock = Stock::new(min, max).unwrap();
        Self { edge, cubes, stock }
    }

    fn faces(&self, region: Region, within: Option<Bounds>) -> Vec<Face> {
        let mut found = Vec::new();
        let listed = cubes::faces(
            self.cubes.iter().copied(),
            self.edge,
            Some(self.stock),
            region,
            within,
            &|| true,
            &mut |face| {
                found.push(face.clone());
                ControlFlow::Continue(())
            },
        );
        assert_eq!(listed, Ok(ControlFlow::Continue(())));
        found
    }

    /// As voxels have them.
    fn measures(&self, region: Region) -> Measures {
        let places: Vec<Place> = self.cubes.iter().map(|(_, place)| *place).collect();
        let totals = voxels::totals(self.edge, Some(self.stock), &places);
        let stock = totals.stock.unwrap();
        match region {
            Region::Union => totals.measures,
            Region::Removed => stock.removed,
            Region::Remaining => stock.remaining,
        }
    }
}

fn triangles(faces: &[Face]) -> Vec<([f64; 3], Triangle)> {
    let mut triangulator = Triangulator::default();
    let mut found = Vec::new();
    for face in faces {
        triangulator.each(face, &mut |triangle| found.push((face.normal, triangle)));
    }
    found
}

/// A vertex in half steps, which are whole numbers.
fn whole(vertex: [f64; 3]) -> [i64; 3] {
    vertex.map(|steps| {
        let half_steps = 2.0 * steps;
        assert_eq!(half_steps, half_steps.round(), "{vertex:?}");
        #[expect(clippy::cast_possible_truncation, reason = "the worlds are small")]
        let whole = half_steps as i64;
        whole
    })
}

type Edges = BTreeMap<[[i64; 3]; 2], i64>;

/// How often each edge is used in the direction from the lesser end, less how often in the other.
fn balance(edges: impl Iterator<Item = [[i64; 3]; 2]>) -> Edges {
    let mut balance = Edges::new();
    for [tail, head] in edges {
        assert_ne!(tail, head, "an edge has two ends");
        if tail < head {
            *balance.entry([tail, head]).or_default() += 1;
        } else {
            *balance.entry([head, tail]).or_default() -= 1;
        }
    }
    balance.retain(|_, count| *count != 0);
    balance
}

/// Checks that edges pair up, except on the sides of a box and half a step around it.
#[track_caller]
fn check_closed(edges: impl Iterator<Item = [[i64; 3]; 2]>, within: Option<Bounds>, context: &str) {
    let is_cut = |ends: &[[i64; 3]; 2]| {
        within.is_some_and(|within| {
            (0..3).any(|axis| {
                let [low, high] =
                    [2 * within.min[axis] - 1, 2 * within.max[axis] + 1].map(i64::from);
                ends[0][axis] == ends[1][axis] && [low, high].contains(&ends[0][axis])
            })
        })
    };
    for (ends, count) in balance(edges) {
        assert!(
            is_cut(&ends),
            "{context}: the edge {ends:?} is open ({count})"
        );
    }
}

fn face_edges(faces: &[Face]) -> impl Iterator<Item = [[i64; 3]; 2]> {
    let edges = faces.iter().flat_map(|face| face.edges.iter());
    edges.map(|ends| ends.map(whole))
}

fn triangle_edges(triangles: &[([f64; 3], Triangle)]) -> impl Iterator<Item = [[i64; 3]; 2]> {
    triangles.iter().flat_map(|(_, triangle)| {
        let [a, b, c] = triangle.map(whole);
        [[a, b], [b, c], [c, a]]
    })
}

fn cross(one: [i64; 3], other: [i64; 3]) -> [i64; 3] {
    [0, 1, 2].map(|axis| {
        let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
        one[next] * other[last] - one[last] * other[next]
    })
}

fn minus(one: [i64; 3], other: [i64; 3]) -> [i64; 3] {
    [0, 1, 2].map(|axis| one[axis] - other[axis])
}

/// Six times the volume in half steps cubed, and twice the area in half steps squared: every triangle as its normal says, none flat.
#[track_caller]
fn volume_and_area(triangles: &[([f64; 3], Triangle)], context: &str) -> [i64; 2] {
    let (mut volume, mut area) = (0, 0);
    for (normal, triangle) in triangles {
        let [a, b, c] = triangle.map(whole);
        let doubled = cross(minus(b, a), minus(c, a));
        let along: i64 = (0..3)
            .map(|axis| doubled[axis] * whole(*normal)[axis] / 2)
            .sum();
        assert!(
            along > 0,
            "{context}: {triangle:?} is flat or turned, its normal is {normal:?}"
        );
        area += along;
        let bc = cross(b, c);
        volume += (0..3).map(|axis| a[axis] * bc[axis]).sum::<i64>();
    }
    [volume, area]
}

#[test]
fn meshes_are_closed_and_have_the_measures_of_voxels() {
    for seed in 0..rounds(4_000) {
        let scene = Scene::random(&mut Random::new(seed));
        for region in REGIONS {
            let context = format!("seed {seed}, {region:?}");
            let faces = scene.faces(region, None);
            check_closed(face_edges(&faces), None, &context);
            let triangles = triangles(&faces);
            check_closed(triangle_edges(&triangles), None, &context);
            let measures = scene.measures(region);
            let [volume, area] = volume_and_area(&triangles, &context);
            assert_eq!(i128::from(volume), measures.volume * 48, "{context}");
            let expected: i128 = measures.area_by_axis.iter().sum();
            assert_eq!(i128::from(area), expected * 8, "{context}");
            let length: i64 = face_edges(&faces)
                .map(|[one, other]| minus(one, other).map(i64::abs).iter().sum::<i64>())
                .sum();
            // An edge is one of two faces, or of four where two parts touch along it.
            let of_kinds = measures.edge_length.iter();
            let expected: i128 = of_kinds
                .map(|[convex, concave, touching]| convex + concave + 2 * touching)
                .sum();
            assert_eq!(i128::from(length), 4 * expected, "{context}");
            for face in &faces {
                check_body(&scene, region, face, &context);
            }
        }
    }
}

/// Checks that the body of a face has a face in its plane; a side of the stock has none.
#[track_caller]
fn check_body(scene: &Scene, region: Region, face: &Face, context: &str) {
    let axis = (0..3).find(|axis| face.normal[*axis] != 0.0).unwrap();
    let at = whole(face.edges[0][0])[axis];
    let Some(body) = face.body else {
        let stock = scene.stock.bounds();
        let sides = [stock.min[axis], stock.max[axis]].map(|side| 2 * i64::from(side));
        assert!(
            region != Region::Union && sides.contains(&at),
            "{context}: {face:?}"
        );
        return;
    };
    let is_low = (face.normal[axis] > 0.0) == (region == Region::Remaining);
    let has_it = scene.cubes.iter().any(|(id, place)| {
        let low = place.corner()[axis];
        let side = if is_low {
            low
        } else {
            low + scene.edge.steps()
        };
        *id == body && 2 * i64::from(side) == at
    });
    assert!(has_it, "{context}: {face:?}");
}

#[test]
fn neighbouring_boxes_share_out_every_face() {
    for seed in 0..rounds(2_000) {
        let mut random = Random::new(seed);
        let scene = Scene::random(&mut random);
        let cuts = [0; 3].map(|_: i32| random.within(-4, 4));
        for region in REGIONS {
            let context = format!("seed {seed}, {region:?}, cut at {cuts:?}");
            let whole = volume_and_area(&triangles(&scene.faces(region, None)), &context);
            let (mut found, mut cut_edges) = ([0; 2], Vec::new());
            for octant in 0..8 {
                let mut within = Bounds {
                    min: [-100; 3],
                    max: [100; 3],
                };
                for (axis, cut) in cuts.into_iter().enumerate() {
                    if octant >> axis & 1 == 0 {
                        within.max[axis] = i32::try_from(cut - 1).unwrap();
                    } else {
                        within.min[axis] = i32::try_from(cut).unwrap();
                    }
                }
                let faces = scene.faces(region, Some(within));
                check_closed(face_edges(&faces), Some(within), &context);
                let part = triangles(&faces);
                check_closed(triangle_edges(&part), Some(within), &context);
                let [volume, area] = volume_and_area(&part, &context);
                found = [found[0] + volume, found[1] + area];
                cut_edges.extend(triangle_edges(&part));
            }
            assert_eq!(found, whole, "{context}");
            // Both sides of a cut have the same edges there.
            check_closed(cut_edges.into_iter(), None, &context);
        }
    }
}

#[test]
fn without_a_stock_nothing_is_removed_and_nothing_remains() {
    let (edge, go) = (Edge::new(1).unwrap(), &|| true);
    for region in [Region::Removed, Region::Remaining] {
        let none = std::iter::empty();
        let listed = cubes::faces(none, edge, None, region, None, go, &mut |_| {
            ControlFlow::Continue(())
        });
        assert_eq!(listed, Err(NoStock));
    }
}
