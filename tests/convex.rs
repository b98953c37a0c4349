//! Convex solids: hulls, sweeps and cutters against definitions tried out point by point.

use std::collections::BTreeSet;
use std::f64::consts::PI;

use union3d::geometry::convex::{
    Cutter, Deviation, EXTENT_MAX, End, Fit, InvalidCutter, InvalidSolid, InvalidSweep, Plane,
    Point, STRAIGHT_ANGLE, Solid, VERTICES_MAX,
};

#[path = "oracle/random.rs"]
mod random;
use random::Random;

trait Points {
    fn point(&mut self, low: i64, high: i64) -> Point;
}

impl Points for Random {
    fn point(&mut self, low: i64, high: i64) -> Point {
        point([0; 3].map(|_: i32| self.within(low, high)))
    }
}

fn point(coordinates: [i64; 3]) -> Point {
    Point::new(coordinates).unwrap()
}

fn points<const N: usize>(coordinates: [[i64; 3]; N]) -> Vec<Point> {
    coordinates.map(point).to_vec()
}

/// What a solid is, whatever the order of its lists: each plane with the vertices of its loop, the least first.
fn description(solid: &Solid) -> BTreeSet<(Plane, Vec<Point>)> {
    let of_facet = |facet: union3d::geometry::convex::Facet<'_>| {
        let mut corners: Vec<_> = facet
            .vertices
            .iter()
            .map(|&vertex| solid.vertices()[usize::from(vertex)])
            .collect();
        let least = (0..corners.len())
            .min_by_key(|&place| corners[place])
            .unwrap();
        corners.rotate_left(least);
        (*facet.plane, corners)
    };
    solid.facets().map(of_facet).collect()
}

/// Everything that a solid promises, from its definition.
#[track_caller]
fn check_solid(solid: &Solid) {
    let (vertices, planes) = (solid.vertices(), solid.planes());
    assert_eq!(
        vertices.len() + planes.len(),
        solid.edges().len() + 2,
        "Euler's formula"
    );
    assert_eq!(
        vertices.iter().collect::<BTreeSet<_>>().len(),
        vertices.len()
    );
    assert_eq!(planes.iter().collect::<BTreeSet<_>>().len(), planes.len());
    let mut facets_at = vec![0; vertices.len()];
    for (index, facet) in solid.facets().enumerate() {
        // Convex: every vertex is on or below every plane, and on it exactly when it is in the loop.
        let on: BTreeSet<u16> = (0..vertices.len() as u16)
            .filter(|&vertex| facet.plane.at(vertices[usize::from(vertex)]) == 0)
            .collect();
        assert!(vertices.iter().all(|&vertex| facet.plane.at(vertex) <= 0));
        assert_eq!(on, facet.vertices.iter().copied().collect());
        assert_eq!(facet.vertices.len(), on.len());
        assert!(facet.vertices.len() >= 3);
        for place in 0..facet.vertices.len() {
            let corner = |ahead: usize| {
                let vertex = facet.vertices[(place + ahead) % facet.vertices.len()];
                vertices[usize::from(vertex)]
            };
            // Counterclockwise, with a turn at every vertex.
            assert_eq!(
                Plane::through(corner(0), corner(1), corner(2)),
                Some(*facet.plane)
            );
            facets_at[usize::from(facet.vertices[place])] += 1;
            let tail = facet.vertices[place];
            let head = facet.vertices[(place + 1) % facet.vertices.len()];
            let forwards = |edge: &&union3d::geometry::convex::Edge| {
                (edge.tail, edge.head, edge.left) == (tail, head, index as u16)
                    && edge.right == facet.across[place]
            };
            let backwards = |edge: &&union3d::geometry::convex::Edge| {
                (edge.head, edge.tail, edge.right) == (tail, head, index as u16)
                    && edge.left == facet.across[place]
            };
            let sides = solid.edges().iter().filter(forwards).count()
                + solid.edges().iter().filter(backwards).count();
            assert_eq!(sides, 1, "each side of a facet is one side of one edge");
        }
    }
    assert!(facets_at.iter().all(|&count| count >= 3));
    for axis in 0..3 {
        let along = || vertices.iter().map(|vertex| vertex.coordinates()[axis]);
        assert_eq!(along().min(), Some(solid.bounds().min[axis]));
        assert_eq!(along().max(), Some(solid.bounds().max[axis]));
    }
    assert!(solid.volume6() > 0);
}

/// The planes of a hull by its definition: through three points, with no point outside. None when the points are flat.
fn planes_by_definition(points: &[Point]) -> Option<BTreeSet<Plane>> {
    let mut planes = BTreeSet::new();
    for &a in points {
        for &b in points {
            for &c in points {
                if let Some(plane) = Plane::through(a, b, c)
                    && points.iter().all(|&other| plane.at(other) <= 0)
                {
                    planes.insert(plane);
                }
            }
        }
    }
    let flat = planes
        .iter()
        .any(|plane| points.iter().all(|&p| plane.at(p) == 0));
    (!flat && !planes.is_empty()).then_some(planes)
}

#[track_caller]
fn check_hull(points: &[Point]) {
    match (Solid::hull(points), planes_by_definition(points)) {
        (Ok(solid), Some(planes)) => {
            check_solid(&solid);
            assert_eq!(
                solid.planes().iter().copied().collect::<BTreeSet<_>>(),
                planes
            );
            assert!(
                solid
                    .vertices()
                    .iter()
                    .all(|vertex| points.contains(vertex))
            );
        }
        (Err(InvalidSolid::Flat), None) => {}
        (found, expected) => {
            panic!("{found:?}, where the definition says {expected:?}: {points:?}")
        }
    }
}

#[test]
fn hulls_are_what_the_definition_says() {
    // Worlds of two to five steps: most points are repeated, in line or coplanar with others.
    for seed in 0..3000 {
        println!("seed {seed}");
        let mut random = Random::new(seed);
        let size = random.within(1, 4);
        let count = random.within(1, 14);
        let cloud: Vec<Point> = (0..count).map(|_| random.point(0, size)).collect();
        check_hull(&cloud);
    }
}

#[test]
fn hulls_of_everything_in_the_smallest_world() {
    // Every set of corners of a cube.
    for set in 0_u32..256 {
        let cloud: Vec<Point> = (0..8_i64)
            .filter(|corner| set >> corner & 1 == 1)
            .map(|corner| point([corner & 1, corner >> 1 & 1, corner >> 2]))
            .collect();
        if cloud.is_empty() {
            assert_eq!(Solid::hull(&cloud).unwrap_err(), InvalidSolid::Empty);
        } else {
            check_hull(&cloud);
        }
    }
    // A full block leaves its eight corners.
    let block: Vec<Point> = (0..1000)
        .map(|number| point([number % 10, number / 10 % 10, number / 100]))
        .collect();
    let solid = Solid::hull(&block).unwrap();
    check_solid(&solid);
    assert_eq!((solid.vertices().len(), solid.planes().len()), (8, 6));
    assert_eq!(solid.volume6(), 6 * 9 * 9 * 9);
}

/// Lattice points near a sphere, spread evenly.
fn sphere(count: usize, radius: f64) -> Vec<Point> {
    let golden = PI * (3.0 - 5.0_f64.sqrt());
    let at = |number: usize| {
        let z = 1.0 - (2.0 * number as f64 + 1.0) / count as f64;
        let (sine, cosine) = (golden * number as f64).sin_cos();
        let ring = (1.0 - z * z).sqrt();
        point([ring * cosine, ring * sine, z].map(|part| (radius * part).round() as i64))
    };
    (0..count).map(at).collect()
}

#[test]
fn large_hulls() {
    for (count, radius) in [(300, 1000.0), (VERTICES_MAX, 1_000_000.0)] {
        let solid = Solid::hull(&sphere(count, radius)).unwrap();
        assert_eq!(solid.vertices().len(), count);
        let volume = solid.volume6() as f64 / 6.0;
        let ball = 4.0 / 3.0 * PI * radius.powi(3);
        assert!(volume < ball * 1.001 && volume > ball * 0.97);
        if count < 1000 {
            check_solid(&solid);
        }
    }
    let refused = Solid::hull(&sphere(VERTICES_MAX + 1, 1_000_000.0)).unwrap_err();
    assert_eq!(
        refused,
        InvalidSolid::TooManyVertices {
            count: VERTICES_MAX + 1
        }
    );
    // Many points are no fault when few of them are vertices.
    let ball = sphere(VERTICES_MAX, 1_000.0);
    let half: Vec<Point> = ball
        .iter()
        .map(|at| point(at.wide().map(|part| part / 2)))
        .collect();
    let corner = 2000;
    let frame =
        (0..8).map(|n: i64| point([n & 1, n >> 1 & 1, n >> 2].map(|bit| (2 * bit - 1) * corner)));
    let all: Vec<Point> = ball.iter().copied().chain(half).chain(frame).collect();
    assert_eq!(Solid::hull(&all).unwrap().vertices().len(), 8);
}

#[test]
fn solids_at_the_limits() {
    let far = 1 << 30;
    let near = far - EXTENT_MAX;
    for (low, high) in [(near, far), (-far, -near)] {
        // The greatest box, a needle along its diagonal, a plate of one step, and the largest normals.
        let corners = Solid::cuboid(point([low; 3]), point([high; 3])).unwrap();
        check_solid(&corners);
        assert_eq!(corners.volume6(), 6 << 63);
        for cloud in [
            points([
                [low; 3],
                [low + 1, low, low],
                [low, low + 1, low],
                [high; 3],
            ]),
            points([
                [low, low, low],
                [high, low, low],
                [low, high, low],
                [high, high, low + 1],
                [high - 1, high, low + 1],
            ]),
            points([
                [low, high, low + 1],
                [high, low, low],
                [low + 1, low, high],
                [high, high, high - 1],
            ]),
        ] {
            check_hull(&cloud);
        }
    }
    for axis in 0..3 {
        let mut end = [1; 3];
        end[axis] = EXTENT_MAX + 1;
        let refused = Solid::cuboid(Point::ORIGIN, point(end)).unwrap_err();
        assert_eq!(
            refused,
            InvalidSolid::TooLong {
                axis,
                steps: EXTENT_MAX + 1
            }
        );
        let mut start = [0; 3];
        start[axis] = -far;
        let outside = Solid::cuboid(Point::ORIGIN, point([1; 3]))
            .unwrap()
            .displaced(start.map(|part| part * 2));
        assert!(
            matches!(outside.unwrap_err(), InvalidSolid::OutOfRange(fault) if fault.axis == axis)
        );
    }
    let bad = Point::new([0, far + 1, 0]).unwrap_err();
    assert_eq!(
        bad.to_string(),
        "y = 1073741825 steps is outside -1073741824 to 1073741824"
    );
}

#[test]
fn flat_hulls_are_refused() {
    for cloud in [
        points([[5, 5, 5]]),
        points([[5, 5, 5]; 9]),
        points([[0, 0, 0], [1, 2, 3], [2, 4, 6], [-3, -6, -9]]),
        points([[0, 0, 0], [3, 0, 1], [0, 3, 1], [3, 3, 2], [6, 3, 3]]),
    ] {
        assert_eq!(Solid::hull(&cloud).unwrap_err(), InvalidSolid::Flat);
    }
}

#[test]
fn displaced_solids_are_hulls_of_displaced_points() {
    for seed in 0..200 {
        println!("seed {seed}");
        let mut random = Random::new(seed);
        let cloud: Vec<Point> = (0..12).map(|_| random.point(-5, 5)).collect();
        let Ok(solid) = Solid::hull(&cloud) else {
            continue;
        };
        let by = random.point(-1_000_000, 1_000_000).wide();
        let moved: Vec<Point> = cloud.iter().map(|at| at.displaced(by).unwrap()).collect();
        let displaced = solid.displaced(by).unwrap();
        check_solid(&displaced);
        assert_eq!(
            description(&displaced),
            description(&Solid::hull(&moved).unwrap())
        );
    }
}

/// Both positions of a solid's vertices.
fn both_positions(solid: &Solid, from: Point, to: Point) -> Vec<Point> {
    [from, to]
        .iter()
        .flat_map(|end| {
            solid
                .vertices()
                .iter()
                .map(|vertex| vertex.displaced(end.wide()).unwrap())
        })
        .collect()
}

#[test]
fn sweeps_are_hulls_of_both_positions() {
    for seed in 0..4000 {
        println!("seed {seed}");
        let mut random = Random::new(seed);
        let size = random.within(1, 5);
        let count = random.within(4, 20);
        let cloud: Vec<Point> = (0..count).map(|_| random.point(0, size)).collect();
        let Ok(solid) = Solid::hull(&cloud) else {
            continue;
        };
        // Short ways along axes, facets and edges are the common case.
        let (from, to) = (random.point(-2, 2), random.point(-2, 2));
        let swept = solid.swept(from, to).unwrap();
        check_solid(&swept);
        let hull = Solid::hull(&both_positions(&solid, from, to)).unwrap();
        assert_eq!(description(&swept), description(&hull));
    }
}

#[test]
fn sweeps_to_a_common_top_are_hulls_of_raised_positions() {
    for seed in 0..2000 {
        println!("seed {seed}");
        let mut random = Random::new(seed);
        // A prism with a pointed lower end.
        let size = random.within(1, 4);
        let height = random.within(1, 3);
        let mut cloud = Vec::new();
        for _ in 0..random.within(3, 9) {
            let [x, y, _] = random.point(0, size).wide();
            cloud.push(point([x, y, height]));
            cloud.push(point([x, y, random.within(0, height - 1)]));
        }
        let Ok(solid) = Solid::hull(&cloud) else {
            continue;
        };
        let (from, to) = (random.point(-2, 2), random.point(-2, 2));
        let highest = height + from.wide()[2].max(to.wide()[2]);
        let top = highest + random.within(0, 2);
        match solid.swept_to_top(from, to, top as i32) {
            Ok(swept) => {
                assert!(solid.has_top());
                check_solid(&swept);
                let raised: Vec<Point> = solid
                    .vertices()
                    .iter()
                    .filter(|vertex| vertex.wide()[2] == height)
                    .flat_map(|vertex| {
                        [from, to].map(|end| {
                            let [x, y, _] = vertex.displaced(end.wide()).unwrap().wide();
                            point([x, y, top])
                        })
                    })
                    .collect();
                let all = [both_positions(&solid, from, to), raised].concat();
                assert_eq!(
                    description(&swept),
                    description(&Solid::hull(&all).unwrap())
                );
                let refused = solid
                    .swept_to_top(from, to, (highest - 1) as i32)
                    .unwrap_err();
                let top = (highest - 1) as i32;
                assert_eq!(
                    refused,
                    InvalidSweep::AboveTop {
                        reached: highest,
                        top
                    }
                );
            }
            Err(refused) => {
                assert_eq!(refused, InvalidSweep::NoTop);
                assert!(!solid.has_top());
            }
        }
    }
}

#[test]
fn sweeps_beyond_the_limits_are_refused() {
    let solid = Solid::cuboid(Point::ORIGIN, point([10, 10, 10])).unwrap();
    let end = point([0, EXTENT_MAX - 10, 0]);
    check_solid(&solid.swept(Point::ORIGIN, end).unwrap());
    let end = point([0, EXTENT_MAX - 9, 0]);
    let refused = solid.swept(Point::ORIGIN, end).unwrap_err();
    assert_eq!(
        refused,
        InvalidSolid::TooLong {
            axis: 1,
            steps: EXTENT_MAX + 1
        }
    );
    let edge = point([0, 0, (1 << 30) - 9]);
    let refused = solid.swept(edge, edge).unwrap_err();
    assert!(matches!(refused, InvalidSolid::OutOfRange(fault) if fault.axis == 2));
    // Of 4,096 vertices nearly all stay at one end or the other, and those of the silhouette at both.
    let ball = Solid::hull(&sphere(VERTICES_MAX, 1_000_000.0)).unwrap();
    let refused = ball.swept(Point::ORIGIN, point([10, 0, 0])).unwrap_err();
    assert!(matches!(refused, InvalidSolid::TooManyVertices { count } if count > VERTICES_MAX));
}

const FITS: [Fit; 3] = [Fit::EqualArea, Fit::Inscribed, Fit::Circumscribed];

fn flat(diameter: u32, sides: u16, fit: Fit) -> Cutter {
    Cutter {
        end: End::Flat,
        diameter,
        length: 10,
        sides,
        fit,
    }
}

/// The outline of the round cutter as pairs of a radius and a height, dense where it is curved.
fn outline(cutter: &Cutter) -> Vec<[f64; 2]> {
    let radius = f64::from(cutter.diameter) / 2.0;
    let length = f64::from(cutter.length);
    let mut outline = match cutter.end {
        End::Flat => vec![[0.0, 0.0], [radius, 0.0]],
        End::Round {
            corner_diameter, ..
        } => {
            let corner = f64::from(corner_diameter) / 2.0;
            let on_arc = |part: i32| {
                let (sine, cosine) = (f64::from(part) / 400.0 * PI / 2.0).sin_cos();
                [radius - corner + corner * sine, corner - corner * cosine]
            };
            (0..=400).map(on_arc).collect()
        }
        End::Cone {
            tip_diameter,
            angle,
        } => {
            let tip = f64::from(tip_diameter) / 2.0;
            let half_angle = f64::from(angle) / 2e6 * PI / 180.0;
            let height = (radius - tip) / half_angle.tan();
            vec![[0.0, 0.0], [tip, 0.0], [radius, height]]
        }
    };
    outline.push([radius, length]);
    outline
}

/// The volume of the round cutter.
fn volume(cutter: &Cutter) -> f64 {
    let frustum = |pair: &[[f64; 2]]| {
        let [[r, z], [s, top]] = [pair[0], pair[1]];
        PI / 3.0 * (top - z) * (r * r + r * s + s * s)
    };
    outline(cutter).windows(2).map(frustum).sum()
}

/// The cutters that the tests below look at.
fn some_cutters() -> Vec<Cutter> {
    let mut cutters = Vec::new();
    for fit in FITS {
        for (diameter, length, sides) in [
            (60_000, 250_000, 32),
            (601, 2000, 12),
            (9_999, 20_000, 7),
            (31, 90, 24),
        ] {
            let round = |corner_diameter, rings| End::Round {
                corner_diameter,
                rings,
            };
            let cone = |tip_diameter, angle| End::Cone {
                tip_diameter,
                angle,
            };
            for end in [
                End::Flat,
                round(diameter, 8),
                round(diameter, 2),
                round(diameter / 3, 4),
                round(diameter / 20, 4),
                cone(0, 118_000_000),
                cone(diameter / 30, 60_000_000),
                cone(diameter / 7 * 5, 20_000_000),
                cone(diameter - 1, 179_000_000),
            ] {
                cutters.push(Cutter {
                    end,
                    diameter,
                    length,
                    sides,
                    fit,
                });
            }
        }
    }
    cutters
}

#[test]
fn cutters_are_as_far_from_round_ones_as_they_say() {
    for cutter in some_cutters() {
        println!("{cutter:?}");
        let (solid, deviation) = cutter.solid().unwrap();
        check_solid(&solid);
        assert!(solid.has_top());
        let steps = |units: u64| units as f64 / Deviation::STEP as f64;
        let outline = outline(&cutter);
        // Vertices outside the round cutter: their distance from the outline, when they are on the outer side of it.
        let mut outside: f64 = 0.0;
        for vertex in solid.vertices() {
            let [x, y, z] = vertex.wide().map(|part| part as f64);
            let r = x.hypot(y);
            let mut nearest = f64::MAX;
            let mut inside = true;
            for pair in outline.windows(2) {
                let ([r0, z0], [r1, z1]) = (pair[0], pair[1]);
                let (dr, dz) = (r1 - r0, z1 - z0);
                let length = dr.hypot(dz);
                if length == 0.0 {
                    continue;
                }
                inside &= dr * (z - z0) - dz * (r - r0) > -1e-9 * length;
                let along = (((r - r0) * dr + (z - z0) * dz) / length / length).clamp(0.0, 1.0);
                nearest = nearest.min((r - r0 - along * dr).hypot(z - z0 - along * dz));
            }
            if !inside {
                outside = outside.max(nearest);
            }
        }
        assert!(
            outside <= steps(deviation.outside) + 1e-3,
            "{outside} {deviation:?}"
        );
        // Points of the round cutter outside the solid.
        let mut inside: f64 = 0.0;
        for plane in solid.planes() {
            let [nx, ny, nz] = plane.normal().map(|part| part as f64);
            let length = (nx * nx + ny * ny + nz * nz).sqrt();
            let across = nx.hypot(ny);
            for &[r, z] in &outline {
                let out = (across * r + nz * z + plane.offset() as f64) / length;
                inside = inside.max(out);
            }
        }
        assert!(
            inside <= steps(deviation.inside) + 1e-3,
            "{inside} {deviation:?}"
        );
        // The claim is a claim: it is not far from the truth, nor the solid far from the round one.
        let radius = f64::from(cutter.diameter) / 2.0;
        let of_polygon = radius / (PI / f64::from(cutter.sides)).cos() - radius;
        assert!(
            steps(deviation.outside.max(deviation.inside))
                <= 4.0 * (of_polygon + radius * 0.1) + 3.0
        );
        match (cutter.end, cutter.fit) {
            (End::Flat, Fit::Inscribed) => assert_eq!(deviation.outside, 0),
            (End::Flat, Fit::Circumscribed) => assert_eq!(deviation.inside, 0),
            _ => {}
        }
    }
}

#[test]
fn deviations_are_the_distances_of_the_polygon() {
    // A square of equal area, by hand: its vertices are at (+-886, +-886), sqrt(pi)/2 = 0.886.
    let (solid, deviation) = flat(2000, 4, Fit::EqualArea).solid().unwrap();
    assert_eq!(solid.bounds().max, [886, 886, 10]);
    let step = Deviation::STEP as f64;
    assert_eq!(
        deviation.outside,
        ((886.0 * 2.0_f64.sqrt() - 1000.0) * step).ceil() as u64
    );
    assert_eq!(deviation.inside, 114 * Deviation::STEP);
    let (solid, deviation) = flat(2000, 4, Fit::Circumscribed).solid().unwrap();
    assert_eq!(solid.bounds().max, [1000, 1000, 10]);
    assert_eq!(deviation.inside, 0);
    let (solid, deviation) = flat(2000, 4, Fit::Inscribed).solid().unwrap();
    assert_eq!(solid.bounds().max, [707, 707, 10]);
    assert_eq!(
        (deviation.outside, deviation.inside),
        (0, 293 * Deviation::STEP)
    );
}

#[test]
fn polygons_fit_their_circles_exactly() {
    for diameter in (1..60).chain([1001, 65_537, 1 << 20]) {
        for sides in [3, 4, 5, 8, 16, 31, 64, 1024] {
            for fit in FITS {
                let Ok((solid, _)) = flat(diameter, sides, fit).solid() else {
                    // So small that its vertices are in one line.
                    assert!(
                        diameter < 4 && fit != Fit::Circumscribed,
                        "{diameter} {sides} {fit:?}"
                    );
                    continue;
                };
                // Twice the vertices and the diameter, so that all are whole numbers.
                let squared = i128::from(diameter) * i128::from(diameter);
                let facet = solid
                    .facets()
                    .find(|facet| facet.plane.normal()[2] < 0)
                    .unwrap();
                for place in 0..facet.vertices.len() {
                    let next = (place + 1) % facet.vertices.len();
                    let [[ax, ay, _], [bx, by, _]] = [place, next].map(|place| {
                        let vertex = solid.vertices()[usize::from(facet.vertices[place])];
                        vertex.wide().map(|part| 2 * i128::from(part))
                    });
                    let (cross, dx, dy) = (ax * by - ay * bx, bx - ax, by - ay);
                    match fit {
                        Fit::Inscribed => assert!(ax * ax + ay * ay <= squared),
                        Fit::Circumscribed => {
                            assert!(cross * cross >= squared * (dx * dx + dy * dy))
                        }
                        Fit::EqualArea => {}
                    }
                }
            }
        }
    }
}

#[test]
fn volumes_converge_to_those_of_round_cutters() {
    let mut last = f64::MAX;
    for (sides, rings) in [(8, 4), (16, 8), (32, 16), (64, 32)] {
        let mut worst: f64 = 0.0;
        for end in [
            End::Flat,
            End::Round {
                corner_diameter: 1 << 19,
                rings,
            },
            End::Round {
                corner_diameter: 1 << 18,
                rings,
            },
            End::Cone {
                tip_diameter: 1 << 15,
                angle: 90_000_000,
            },
        ] {
            let cutter = Cutter {
                end,
                diameter: 1 << 19,
                length: 1 << 20,
                sides,
                fit: Fit::EqualArea,
            };
            let (solid, _) = cutter.solid().unwrap();
            let found = solid.volume6() as f64 / 6.0;
            worst = worst.max((found / volume(&cutter) - 1.0).abs());
        }
        println!("{sides} sides, {rings} rings: {worst:e}");
        assert!(worst < last / 2.5);
        last = worst;
    }
    assert!(last < 1e-3);
}

#[test]
fn trapezoids_of_a_ball_are_single_facets() {
    let ball = End::Round {
        corner_diameter: 60_000,
        rings: 8,
    };
    let cutter = Cutter {
        end: ball,
        diameter: 60_000,
        length: 250_000,
        sides: 32,
        fit: Fit::EqualArea,
    };
    let (solid, _) = cutter.solid().unwrap();
    // The tip, seven belts of trapezoids, the shank and its top.
    assert_eq!(solid.planes().len(), 1 + 7 * 32 + 32 + 1);
    assert_eq!(solid.bounds().min[2], 0);
    assert_eq!(solid.bounds().max[2], 250_000);
}

#[test]
fn the_same_cutter_has_the_same_vertices_everywhere() {
    // A digest of all vertices (FNV-1a), which no processor and no optimisation may change.
    let mut digest: u64 = 0xcbf2_9ce4_8422_2325;
    for cutter in some_cutters() {
        for vertex in cutter.solid().unwrap().0.vertices() {
            for byte in vertex
                .coordinates()
                .iter()
                .flat_map(|part| part.to_le_bytes())
            {
                digest = (digest ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
            }
        }
    }
    assert_eq!(format!("{digest:016x}"), "3da6140c61af34ad");
}

#[test]
fn cutters_that_do_not_exist_are_refused() {
    let good = Cutter {
        end: End::Flat,
        diameter: 100,
        length: 100,
        sides: 16,
        fit: Fit::EqualArea,
    };
    let round = |corner_diameter, rings| End::Round {
        corner_diameter,
        rings,
    };
    let cone = |tip_diameter, angle| End::Cone {
        tip_diameter,
        angle,
    };
    for (cutter, message) in [
        (
            Cutter { sides: 2, ..good },
            "sides = 2 is outside 3 to 1024",
        ),
        (
            Cutter {
                sides: 1025,
                ..good
            },
            "sides = 1025 is outside 3 to 1024",
        ),
        (
            Cutter {
                diameter: 0,
                ..good
            },
            "the diameter of 0 steps is outside 1 to 2097152",
        ),
        (
            Cutter {
                diameter: 1 << 22,
                ..good
            },
            "the diameter of 4194304 steps is outside 1 to 2097152",
        ),
        (
            Cutter { length: 0, ..good },
            "the length of 0 steps leaves no shank above the end, which is 0 steps high",
        ),
        (
            Cutter {
                end: round(101, 4),
                ..good
            },
            "the diameter of the corner, 101 steps, is outside 1 to the cutter's 100",
        ),
        (
            Cutter {
                end: round(0, 4),
                ..good
            },
            "the diameter of the corner, 0 steps, is outside 1 to the cutter's 100",
        ),
        (
            Cutter {
                end: round(100, 1),
                ..good
            },
            "rings = 1 is outside 2 to 64",
        ),
        (
            Cutter {
                end: round(100, 8),
                length: 50,
                ..good
            },
            "the length of 50 steps leaves no shank above the end, which is 50 steps high",
        ),
        (
            Cutter {
                end: cone(100, 60_000_000),
                ..good
            },
            "the diameter of the tip, 100 steps, is not below the cutter's 100",
        ),
        (
            Cutter {
                end: cone(0, 0),
                ..good
            },
            "the angle of 0 millionths of a degree is not between 0 and 180000000",
        ),
        (
            Cutter {
                end: cone(0, STRAIGHT_ANGLE),
                ..good
            },
            "the angle of 180000000 millionths of a degree is not between 0 and 180000000",
        ),
        (
            Cutter {
                end: cone(0, 60_000_000),
                length: 87,
                ..good
            },
            "the length of 87 steps leaves no shank above the end, which is 87 steps high",
        ),
        (
            Cutter {
                diameter: 1,
                ..good
            },
            "the points lie in one plane, so there is no volume between them",
        ),
        (
            Cutter {
                length: 1 << 22,
                ..good
            },
            "it is 4194304 steps long along z; the most is 2097152",
        ),
    ] {
        assert_eq!(
            cutter.solid().unwrap_err().to_string(),
            message,
            "{cutter:?}"
        );
    }
    let many = Cutter {
        end: round(1 << 20, 64),
        diameter: 1 << 20,
        length: 1 << 20,
        sides: 1024,
        ..good
    };
    let refused = many.solid().unwrap_err();
    assert!(matches!(
        refused,
        InvalidCutter::Solid(InvalidSolid::TooManyVertices { .. })
    ));
}
