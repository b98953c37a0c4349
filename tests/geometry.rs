//! The weights against voxels, and the facts every union must satisfy.

#[path = "oracle/voxels.rs"]
mod voxels;

use union3d::engine::{Engine, recount};
use union3d::geometry::{CubeId, Edge, EdgeKind, Effect, Measures, Place, VertexKind, WEIGHTS};

/// The cubes named by lower corners, one a line of text: `x y z`.
fn places(edge: Edge, text: &str) -> Vec<Place> {
    let place = |line: &str| {
        let corner: Vec<i64> = line
            .split_whitespace()
            .map(|word| word.parse().unwrap())
            .collect();
        Place::new(corner.try_into().unwrap(), edge).unwrap()
    };
    text.split(',')
        .map(str::trim)
        .filter(|line| !line.is_empty())
        .map(place)
        .collect()
}

/// Checks volume, area, edge length (total, convex, concave, crossing) and Euler characteristic of unit cubes, by the
/// engine and by voxels.
#[track_caller]
fn check(cubes: &str, [volume, area, total, convex, concave, crossing, euler]: [i128; 7]) {
    let edge = Edge::new(1).unwrap();
    let places = places(edge, cubes);
    for totals in [
        recount(edge, None, places.iter().copied()),
        voxels::totals(edge, None, &places),
    ] {
        let Measures { volume: v, .. } = totals.measures;
        let measures = totals.measures;
        let found = [
            v,
            measures.area(),
            measures.edge_length_total(),
            measures.edge_length_of(EdgeKind::Convex),
            measures.edge_length_of(EdgeKind::Concave),
            measures.edge_length_of(EdgeKind::Crossing),
            measures.euler_characteristic().into(),
        ];
        assert_eq!(
            found,
            [volume, area, total, convex, concave, crossing, euler],
            "{cubes:?}"
        );
    }
}

#[test]
fn facts_of_unit_cubes() {
    check("", [0, 0, 0, 0, 0, 0, 0]);
    check("0 0 0", [1, 6, 12, 12, 0, 0, 1]);
    check("0 0 0, 0 0 0", [1, 6, 12, 12, 0, 0, 1]);
    check("0 0 0, 1 0 0", [2, 10, 16, 16, 0, 0, 1]);
    check("0 0 0, 1 1 0", [2, 12, 23, 22, 0, 1, 1]);
    check("0 0 0, 1 1 1", [2, 12, 24, 24, 0, 0, 1]);
    check("0 0 0, 5 5 5", [2, 12, 24, 24, 0, 0, 2]);
    let block = |keep: fn(i32, i32, i32) -> bool| {
        let all = (0..27).map(|index| (index % 3, index / 3 % 3, index / 9));
        all.filter(|&(x, y, z)| keep(x, y, z))
            .map(|(x, y, z)| format!("{x} {y} {z},"))
            .collect::<String>()
    };
    check(
        &block(|x, y, z| (x, y, z) != (1, 1, 1)),
        [26, 60, 48, 36, 12, 0, 2],
    );
    check(
        &block(|x, y, z| z == 0 && (x, y) != (1, 1)),
        [8, 32, 40, 36, 4, 0, 0],
    );
}

#[test]
fn one_cube_of_any_edge() {
    for steps in [1, 2, 7, 6208, 6209, 32_768, 1 << 24] {
        let edge = Edge::new(steps).unwrap();
        let length = i128::from(steps);
        let totals = recount(edge, None, places(edge, "-3 0 5").into_iter());
        assert_eq!(totals.measures.volume, length.pow(3));
        assert_eq!(totals.measures.area_by_axis, [2 * length.pow(2); 3]);
        assert_eq!(totals.measures.edge_length, [[4 * length, 0, 0]; 3]);
        assert_eq!(totals.measures.vertices, [8, 0, 0, 0]);
        assert_eq!(totals.measures.euler_characteristic(), 1);
        let twice_x = 2 * length.pow(3) * -3 + length.pow(4);
        assert_eq!(totals.measures.first_moments2[0], twice_x);
    }
}

/// Every octant mask as a set of voxels around a point: the measures of the whole set are the table's sums at its points.
#[test]
fn all_256_neighbourhoods() {
    let edge = Edge::new(1).unwrap();
    for mask in 0u8..=255 {
        let octants = (0..8).filter(|bit| mask >> bit & 1 == 1);
        let cubes: Vec<Place> = octants
            .map(|bit| {
                Place::new([0, 1, 2].map(|axis| i64::from(bit >> axis & 1) - 1), edge).unwrap()
            })
            .collect();
        let expected = voxels::totals(edge, None, &cubes);
        assert_eq!(
            recount(edge, None, cubes.iter().copied()),
            expected,
            "mask {mask:#010b}"
        );
        let kind = WEIGHTS[usize::from(mask)].vertex;
        if mask == 0b0000_0001 {
            assert_eq!(kind, Some(VertexKind::Corner));
        }
    }
}

#[test]
fn what_is_out_of_range_is_refused_with_the_value() {
    assert_eq!(
        Edge::new(0).unwrap_err().to_string(),
        "edge of 0 steps is outside 1 to 16777216"
    );
    assert!(Edge::new((1 << 24) + 1).is_err());
    let edge = Edge::new(10).unwrap();
    let most = 1 << 30;
    assert!(Place::new([-most, most - 10, 0], edge).is_ok());
    let error = Place::new([0, most - 9, 0], edge).unwrap_err();
    assert_eq!((error.axis, error.coordinate), (1, most - 9));
    assert!(Place::new([0, 0, -most - 1], edge).is_err());
    assert!(Place::new([i64::MAX, 0, 0], edge).is_err());
}

/// The largest edge at the farthest corners of the lattice: every measure drains to exactly zero, and the narrow sums of
/// a small edge agree with the wide ones there.
#[test]
fn far_away_and_large_drain_to_zero() {
    for steps in [6208, 6209, 1 << 24] {
        let edge = Edge::new(steps).unwrap();
        let (low, high) = (-(1 << 30), (1 << 30) - steps);
        let mut narrow = Engine::new(edge);
        let mut wide = Engine::plain(edge);
        let mut effect = Effect::default();
        for corner in 0..8 {
            for inwards in 0..4 {
                let corner = [0, 1, 2].map(|axis| match corner >> axis & 1 {
                    0 => low + inwards * (steps / 3 + axis),
                    _ => high - inwards * (steps / 5 + 1),
                });
                let id = CubeId(effect.inserted.len() as u64);
                effect
                    .inserted
                    .push((id, Place::new(corner, edge).unwrap()));
            }
        }
        for engine in [&mut narrow, &mut wide] {
            engine.apply(&effect).unwrap();
        }
        assert_eq!(narrow.totals(), wide.totals());
        assert!(narrow.totals().measures.volume > 8 * i128::from(steps).pow(3));
        let back = Effect {
            deleted: effect.inserted,
            inserted: vec![],
        };
        for engine in [&mut narrow, &mut wide] {
            engine.apply(&back).unwrap();
            assert_eq!(engine.totals(), union3d::geometry::Totals::default());
        }
    }
}
