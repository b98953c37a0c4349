//! Shapes, solids and STL files as clients write them: what becomes of them on the lattice, and what is said about those that are wrong.

use std::sync::Arc;

use serde_json::{Value, json};
use union3d::engine::solids::{Body, Engine, Op, Shape, SolidId};
use union3d::geometry::convex::{Point, Solid};
use union3d::wire::solids::{
    Scale, ShapeDocument, Shapes, SolidProperties, body, shape, solid_properties, stl_body,
};

fn scale() -> Scale {
    Scale::new(1000).unwrap()
}

/// The shapes of a document, each of which must be right.
fn shapes(document: Value) -> Shapes {
    let named = document.as_object().unwrap().iter();
    let read = |(name, document): (&String, &Value)| {
        let document = serde_json::from_value(document.clone()).unwrap();
        (
            name.clone(),
            Arc::new(shape(&document, scale()).unwrap().shape),
        )
    };
    named.map(read).collect()
}

/// Lower and upper corners of the box around a shape, in steps, and how many facets it has.
#[track_caller]
fn check_shape(document: Value, min: [i32; 3], max: [i32; 3], facets: usize) {
    let read = shape(&serde_json::from_value(document).unwrap(), scale()).unwrap();
    let parts = read.shape.parts();
    let least = |axis| {
        parts
            .iter()
            .map(|part| part.bounds().min[axis])
            .min()
            .unwrap()
    };
    let greatest = |axis| {
        parts
            .iter()
            .map(|part| part.bounds().max[axis])
            .max()
            .unwrap()
    };
    for axis in 0..3 {
        // The rings of a ball are multiples of one polygon, whose rounding is multiplied.
        let [low, high] = [
            least(axis).abs_diff(min[axis]),
            greatest(axis).abs_diff(max[axis]),
        ];
        assert!(
            low <= 12 && high <= 12,
            "axis {axis}: {low} and {high} steps off"
        );
    }
    assert_eq!(
        parts.iter().map(|part| part.planes().len()).sum::<usize>(),
        facets
    );
}

#[test]
fn shapes_are_what_they_say() {
    let square = json!({"diameter": 2, "length": 10, "sides": 4, "polygon": "circumscribed"});
    let with = |members: Value| {
        let mut cutter = square.clone();
        for (name, value) in members.as_object().unwrap() {
            cutter[name] = value.clone();
        }
        cutter
    };
    let (min, max) = ([-1000, -1000, 0], [1000, 1000, 10_000]);
    check_shape(json!({"flat": square}), min, max, 6);
    check_shape(json!({"ball": with(json!({"rings": 3}))}), min, max, 14);
    check_shape(
        json!({"bull": with(json!({"rings": 3, "corner_radius": 0.25}))}),
        min,
        max,
        14,
    );
    check_shape(
        json!({"vee": with(json!({"angle": 90, "tip": 0.5}))}),
        min,
        max,
        10,
    );
    check_shape(json!({"vee": with(json!({"angle": 90}))}), min, max, 9);
    check_shape(json!({"drill": square}), min, max, 9);
    check_shape(
        json!({"tapered": with(json!({"angle": 10, "tip": 1}))}),
        min,
        max,
        10,
    );
    let moved = with(json!({"at": [1, 0, 5]}));
    check_shape(
        json!({"flat": moved}),
        [0, -1000, 5000],
        [2000, 1000, 15_000],
        6,
    );
    check_shape(json!({"box": [1, 2, 3]}), [0, 0, 0], [1000, 2000, 3000], 6);
    let corners = json!({"min": [-1, 0, 0], "max": [1, 0.5, 0.0005]});
    check_shape(json!({"box": corners}), [-1000, 0, 0], [1000, 500, 1], 6);
    let hull = json!([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.2, 0.2, 0.2]]);
    check_shape(json!({"hull": hull}), [0, 0, 0], [1000, 1000, 1000], 4);
    let parts = json!([{"flat": square}, {"box": {"min": [-3, -3, 10], "max": [3, 3, 20]}}]);
    check_shape(
        json!({"parts": parts}),
        [-3000, -3000, 0],
        [3000, 3000, 20_000],
        12,
    );
}

#[test]
fn a_polygon_says_how_far_it_is_from_the_circle() {
    let read = |polygon: &str| {
        let document = json!({"flat": {"diameter": 6, "length": 25, "polygon": polygon}});
        let read = shape(&serde_json::from_value(document).unwrap(), scale()).unwrap();
        [read.deviation.outside, read.deviation.inside].map(|length| scale().deviation(length))
    };
    // A regular polygon of 32 sides around or in a circle of radius 3 is 3 (1 - cos(pi / 32)) = 0.01444 away from it.
    let [outside, inside] = read("circumscribed");
    assert!(
        (0.0144..0.017).contains(&outside) && inside == 0.0,
        "{outside} {inside}"
    );
    let [outside, inside] = read("inscribed");
    assert!(
        outside == 0.0 && (0.0144..0.017).contains(&inside),
        "{outside} {inside}"
    );
    let [outside, inside] = read("equal_area");
    assert!((0.0085..0.011).contains(&outside), "{outside}");
    assert!((0.004..0.0065).contains(&inside), "{inside}");
}

#[test]
fn a_top_is_that_of_the_engine() {
    for (document, top) in [(json!(4.5), 4500), (json!(-3.0004), -3000)] {
        let document = json!({"box": [1, 2, 3], "top": document});
        let read = shape(&serde_json::from_value(document.clone()).unwrap(), scale()).unwrap();
        let corner = Point::new([1000, 2000, 3000]).unwrap();
        let cuboid = Solid::cuboid(Point::ORIGIN, corner).unwrap();
        let shape = Shape::new(vec![cuboid]).unwrap().with_top(top);
        assert_eq!(read.shape, shape, "{document}");
    }
    for wrong in [
        json!({"top": 3}),
        json!({"box": [1, 1, 1], "hull": []}),
        json!({"box": [1, 1, 1], "top": 1, "bottom": 2}),
    ] {
        serde_json::from_value::<ShapeDocument>(wrong.clone()).expect_err(&wrong.to_string());
    }
}

#[test]
fn shapes_that_are_wrong_say_where() {
    for (document, message) in [
        (
            json!({"flat": {"diameter": 6.0001, "length": 25}}),
            "/flat/diameter = 6.0001 is 6000.099999999999 steps of 1/1000 unit, which is not a whole number",
        ),
        (
            json!({"flat": {"diameter": -6, "length": 25}}),
            "/flat/diameter = -6 is not above 0 and at most 2097.152",
        ),
        (
            json!({"flat": {"diameter": 6, "length": 3000}}),
            "/flat/length = 3000 is not above 0 and at most 2097.152",
        ),
        (
            json!({"flat": {"diameter": 6, "length": 25, "sides": 2}}),
            "/flat/sides is wrong: sides = 2 is outside 3 to 1024",
        ),
        (
            json!({"flat": {"diameter": 6, "length": 25, "tip": 1}}),
            "/flat/tip does not belong to a flat",
        ),
        (
            json!({"ball": {"diameter": 6, "length": 25, "corner_radius": 1}}),
            "/ball/corner_radius does not belong to a ball",
        ),
        (
            json!({"drill": {"diameter": 6, "length": 25, "rings": 3}}),
            "/drill/rings does not belong to a drill",
        ),
        (
            json!({"ball": {"diameter": 6, "length": 25, "angle": 3}}),
            "/ball/angle does not belong to a ball",
        ),
        (
            json!({"bull": {"diameter": 6, "length": 25}}),
            "/bull has no corner_radius, which a bull needs",
        ),
        (
            json!({"bull": {"diameter": 6, "length": 25, "corner_radius": 4}}),
            "/bull/corner_radius is wrong: the diameter of the corner, 8000 steps, is outside 1 to the cutter's 6000",
        ),
        (
            json!({"vee": {"diameter": 6, "length": 25, "angle": 180}}),
            "/vee/angle = 180 degrees is not above 0 and below 180",
        ),
        (
            json!({"tapered": {"diameter": 6, "length": 25, "angle": 90, "tip": 0}}),
            "/tapered/angle = 90 degrees is not above 0 and below 90",
        ),
        (
            json!({"vee": {"diameter": 6, "length": 5, "angle": 60}}),
            "/vee/length is wrong: the length of 5000 steps leaves no shank above the end, which is 5196 steps high",
        ),
        (
            json!({"box": [1, 0, 3]}),
            "/box/1 leaves no volume: the greatest corner is not above the least",
        ),
        (
            json!({"box": {"min": [0, 0, 0], "max": [1, 1, -1]}}),
            "/box/max/2 leaves no volume: the greatest corner is not above the least",
        ),
        (
            json!({"box": [1, 2e6, 3]}),
            "/box/1 = 2000000 is outside -1073741.824 to 1073741.824",
        ),
        (
            json!({"box": [1, 3000, 3]}),
            "/box is wrong: it is 3000000 steps long along y; the most is 2097152",
        ),
        (
            json!({"hull": [[0, 0, 0], [1, 0, 0], [0, 1, 0]]}),
            "/hull is no solid: the points lie in one plane, so there is no volume between them",
        ),
        (
            json!({"hull": []}),
            "/hull is no solid: there are no points",
        ),
        (
            json!({"hull": [[0, 0, 0], [1, 0, 2e9]]}),
            "/hull/1/2 = 2000000000 is outside -1073741.824 to 1073741.824",
        ),
        (
            json!({"parts": []}),
            "/parts a shape has 0 parts; it must be 1 to 64",
        ),
        (
            json!({"parts": [{"box": [1, 1, 1]}, {"parts": []}]}),
            "/parts/1/parts is inside the parts of a shape",
        ),
        (
            json!({"parts": [{"box": [1, 1, 1]}, {"box": [1, 1, 0]}]}),
            "/parts/1/box/2 leaves no volume: the greatest corner is not above the least",
        ),
        (
            json!({"flat": {"diameter": 6, "length": 25, "at": [0, 1e9, 0]}}),
            "/flat/at/1 = 1000000000 is outside -1073741.824 to 1073741.824",
        ),
        (
            json!({"flat": {"diameter": 6, "length": 25, "at": [0, 1073741, 0]}}),
            "/flat/at is wrong: y = 1073743995 steps is outside -1073741824 to 1073741824",
        ),
    ] {
        let read = serde_json::from_value(document.clone()).unwrap();
        let fault = shape(&read, scale()).unwrap_err();
        assert_eq!(fault.to_string(), message, "{document}");
    }
}

#[test]
fn solids_are_shapes_at_a_place_or_carried_or_hulls() {
    let shapes = shapes(json!({"b": {"box": [1, 2, 3]}, "long": {"box": [2000, 1, 1]}}));
    let read = |document: Value| body(&serde_json::from_value(document).unwrap(), &shapes, scale());
    let cuboid = |min: [i64; 3], max: [i64; 3]| {
        Solid::cuboid(Point::new(min).unwrap(), Point::new(max).unwrap()).unwrap()
    };
    let vertices = |solid: &Solid| {
        let mut vertices = solid.vertices().to_vec();
        vertices.sort_unstable();
        vertices
    };
    for (document, expected) in [
        (
            json!({"id": 7, "shape": "b", "at": [0, 0, 1]}),
            cuboid([0, 0, 1000], [1000, 2000, 4000]),
        ),
        (
            json!({"shape": "b", "from": [0, 0, 1], "to": [-1, 0, 1]}),
            cuboid([-1000, 0, 1000], [1000, 2000, 4000]),
        ),
        (
            json!({"hull": [[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1], [1, 0, 0], [1, 0, 1], [1, 1, 0], [1, 1, 1]]}),
            cuboid([0, 0, 0], [1000, 1000, 1000]),
        ),
    ] {
        let body = read(document).unwrap();
        assert_eq!(body.len(), 1);
        assert_eq!(vertices(&body.part(0)), vertices(&expected));
    }
    let neither = "neither a shape with at, nor a shape with from and to, nor a hull";
    for (document, message) in [
        (json!({"id": 1}), format!("it is {neither}")),
        (json!({"shape": "b"}), format!("it is {neither}")),
        (
            json!({"shape": "b", "from": [0, 0, 0]}),
            format!("it is {neither}"),
        ),
        (json!({"at": [0, 0, 0]}), format!("it is {neither}")),
        (
            json!({"shape": "b", "at": [0, 0, 0], "to": [0, 0, 0]}),
            format!("it is {neither}"),
        ),
        (
            json!({"shape": "b", "hull": []}),
            format!("it is {neither}"),
        ),
        (
            json!({"shape": "c", "at": [0, 0, 0]}),
            "/shape = \"c\": there is no such shape".to_owned(),
        ),
        (
            json!({"shape": "b", "from": [0, 0, 0], "to": [0, 0, 1e10]}),
            "/to/2 = 10000000000 is outside -1073741.824 to 1073741.824".to_owned(),
        ),
        (
            json!({"shape": "long", "from": [0, 0, 0], "to": [98, 0, 0]}),
            "/to is not possible: part 0: it is 2098000 steps long along x; the most is 2097152"
                .to_owned(),
        ),
        (
            json!({"hull": [[0, 0, 0], [0, 0, 0]]}),
            "/hull is no solid: the points lie in one plane, so there is no volume between them"
                .to_owned(),
        ),
    ] {
        assert_eq!(
            read(document.clone()).unwrap_err().to_string(),
            message,
            "{document}"
        );
    }
}

/// The text of an STL file.
fn text(triangles: &[[[f32; 3]; 3]]) -> Vec<u8> {
    let mut text = "solid test\n".to_owned();
    for corners in triangles {
        text += "facet normal 0 0 0\nouter loop\n";
        for [x, y, z] in corners {
            text += &format!("vertex {x} {y} {z}\n");
        }
        text += "endloop\nendfacet\n";
    }
    (text + "endsolid test\n").into_bytes()
}

/// A binary STL file, whose header begins as a text does.
fn binary(triangles: &[[[f32; 3]; 3]]) -> Vec<u8> {
    let mut file = vec![b' '; 80];
    file[..6].copy_from_slice(b"solid ");
    file.extend((triangles.len() as u32).to_le_bytes());
    for corners in triangles {
        file.extend([0; 12]);
        for coordinate in corners.as_flattened() {
            file.extend(coordinate.to_le_bytes());
        }
        file.extend([0; 2]);
    }
    file
}

/// The triangles of a solid, in user units.
fn triangles(solid: &Solid) -> Vec<[[f32; 3]; 3]> {
    let at = |vertex: u16| {
        let steps = solid.vertices()[usize::from(vertex)].coordinates();
        steps.map(|steps| steps as f32 / 1000.0)
    };
    let fan = |facet: union3d::geometry::convex::Facet<'_>| {
        let corners = facet.vertices.to_vec();
        (1..corners.len() - 1)
            .map(move |place| [corners[0], corners[place], corners[place + 1]].map(at))
            .collect::<Vec<_>>()
    };
    solid.facets().flat_map(fan).collect()
}

#[test]
fn stl_files_are_convex_bodies() {
    let document = json!({"ball": {"diameter": 6, "length": 25, "at": [1, 2, 3]}});
    let read = shape(&serde_json::from_value(document).unwrap(), scale()).unwrap();
    let ball = &read.shape.parts()[0];
    let surface = triangles(ball);
    for file in [text(&surface), binary(&surface)] {
        let body = stl_body(file, scale()).unwrap();
        assert_eq!(body, Body::solid(ball.clone()));
    }
    // Turned inside out it is the same set of points. Rounding makes plane facets bend a little, and slivers vanish: no harm.
    let turned: Vec<_> = surface.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
    assert_eq!(
        stl_body(text(&turned), scale()).unwrap(),
        Body::solid(ball.clone())
    );
    let coarse = Scale::new(7).unwrap();
    stl_body(text(&surface), coarse).unwrap();
}

#[test]
fn stl_files_that_are_no_convex_body_are_refused() {
    let cube = |low: [i64; 3], size: i64| {
        let high = low.map(|low| low + size);
        triangles(&Solid::cuboid(Point::new(low).unwrap(), Point::new(high).unwrap()).unwrap())
    };
    let whole = cube([0, 0, 0], 1000);
    let open = &whole[1..];
    // A cube whose top is folded in: a point 0.1 below the middle of the top.
    let mut folded: Vec<_> = whole
        .iter()
        .filter(|corners| !corners.iter().all(|corner| corner[2] == 1.0))
        .copied()
        .collect();
    let rim = [
        [0.0, 0.0, 1.0],
        [1.0, 0.0, 1.0],
        [1.0, 1.0, 1.0],
        [0.0, 1.0, 1.0_f32],
    ];
    folded.extend((0..4).map(|side| [rim[side], rim[(side + 1) % 4], [0.5, 0.5, 0.9_f32]]));
    let two = [cube([0, 0, 0], 1000), cube([5000, 0, 0], 1000)].concat();
    // Half of the surface, once from outside and once from inside.
    let doubled: Vec<_> = whole[..6]
        .iter()
        .flat_map(|&[a, b, c]| [[a, b, c], [a, c, b]])
        .collect();
    let far = vec![[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1e9, 0.0_f32]]];
    let flat = vec![
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0_f32]],
        [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0_f32]],
    ];
    for (triangles, words) in [
        (open.to_vec(), "the surface is not closed"),
        (
            folded,
            "triangle 11: its middle is 33.3 steps inside the convex hull",
        ),
        (two, "so the body is not convex; cut it into convex ones"),
        (doubled, "less than half of their convex hull"),
        (far, "triangle 1: its vertex /1 = 1000000000 is outside"),
        (flat, "the points lie in one plane"),
        (vec![], "there are no points"),
    ] {
        for file in [text(&triangles), binary(&triangles)] {
            let refused = stl_body(file, scale()).unwrap_err().to_string();
            assert!(refused.contains(words), "no {words:?} in {refused:?}");
        }
    }
    let mut cut = binary(&whole);
    cut.truncate(300);
    for file in [
        cut,
        b"solid x\nfacet normal 0 0\n".to_vec(),
        vec![],
        b"hello".to_vec(),
    ] {
        let refused = stl_body(file, scale()).unwrap_err().to_string();
        assert!(
            refused.contains("neither a text nor a binary STL file"),
            "{refused}"
        );
    }
}

/// The mass properties of boxes in user units.
fn properties(boxes: &[[[f64; 3]; 2]]) -> SolidProperties {
    let mut engine = Engine::new();
    let ops: Vec<Op> = boxes
        .iter()
        .zip(1..)
        .map(|([min, max], id)| {
            let [a, b] = [min, max].map(|corner| scale().point(*corner, "").unwrap());
            Op::Insert(SolidId(id), Body::cuboid(a, b).unwrap())
        })
        .collect();
    let judged = engine.judge(&ops).unwrap();
    engine.apply(&judged.effect).unwrap();
    let totals = (&engine.totals(), &engine.error_max());
    solid_properties(None, None, totals, scale(), 2.0)
}

#[test]
fn properties_are_those_of_the_textbook() {
    let shown = properties(&[[[0.0, 0.0, 2.5], [6.0, 6.0, 8.5]]]);
    assert_eq!(
        (shown.solids, shown.measures.volume, shown.measures.area),
        (1, 216.0, 216.0)
    );
    assert_eq!(
        (
            shown.measures.edge_length.total,
            shown.measures.edge_length.convex
        ),
        (72.0, 72.0)
    );
    assert_eq!(shown.measures.mass, 432.0);
    assert_eq!(shown.measures.centroid, Some([3.0, 3.0, 5.5]));
    for (axis, row) in shown.measures.inertia.iter().enumerate() {
        for (other, value) in row.iter().enumerate() {
            let expected = if axis == other { 2592.0 } else { 0.0 };
            assert!((value - expected).abs() < 1e-9, "{value}");
        }
    }
    let bounds = shown.bounds.unwrap();
    assert_eq!((bounds.min, bounds.max), ([0.0, 0.0, 2.5], [6.0, 6.0, 8.5]));
    assert_eq!(
        shown.measures.exact.volume.value,
        (216_000_000_000_i64 * 96).to_string()
    );
    assert_eq!(shown.measures.exact.volume.divisor, "96");
    assert!(shown.measures.error_max.volume > 0.0 && shown.measures.error_max.volume < 1e-6);
    let none = properties(&[]);
    assert_eq!(
        (none.solids, none.measures.volume, none.measures.centroid),
        (0, 0.0, None)
    );
    assert_eq!(none.measures.inertia, [[0.0; 3]; 3]);
    let text = serde_json::to_string(&shown).unwrap();
    assert!(!text.contains("-0.0"), "{text}");
}

#[test]
fn inertia_is_as_far_off_as_it_says_wherever_the_part_is() {
    let part = [
        [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]],
        [[1.0, 0.0, 0.0], [4.0, 0.5, 0.25]],
        [[0.0, -3.0, 2.0], [0.5, 1.0, 7.0]],
    ];
    let near = properties(&part);
    // A box of 1 x 2 x 3 against the closed formulas, products of inertia by symmetry.
    let alone = properties(&part[..1]);
    let mass = 12.0;
    let expected = [mass * 13.0 / 12.0, mass * 10.0 / 12.0, mass * 5.0 / 12.0];
    for (axis, expected) in expected.into_iter().enumerate() {
        assert!((alone.measures.inertia[axis][axis] / expected - 1.0).abs() < 1e-12);
    }
    for far in [
        [3000.0, 0.0, 0.0],
        [1_000_000.0, 0.0, 0.0],
        [900_000.0, -1_000_000.0, 1_073_000.0],
    ] {
        let moved = part
            .map(|corners| corners.map(|corner| [0, 1, 2].map(|axis| corner[axis] + far[axis])));
        let far_away = properties(&moved);
        for (axis, away) in far.into_iter().enumerate() {
            let [here, there] =
                [&near, &far_away].map(|shown| shown.measures.centroid.unwrap()[axis]);
            assert!((there - away - here).abs() <= far_away.measures.error_max.centroid + 1e-9);
            for other in 0..3 {
                let [here, there] =
                    [&near, &far_away].map(|shown| shown.measures.inertia[axis][other]);
                assert!(
                    (there - here).abs() <= far_away.measures.error_max.inertia + 1e-9 * here.abs()
                );
            }
        }
    }
    assert!(near.measures.error_max.centroid < 1e-9 && near.measures.error_max.inertia < 1e-6);
}
