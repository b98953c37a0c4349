//! Shapes and random bodies for all tests of scenes of solids.

use std::sync::Arc;

use union3d::engine::solids::{Body, Shape};
use union3d::geometry::convex::{Point, Solid};
use union3d::service::NamedShape;

use super::random::Random;

pub(crate) fn point(at: [i64; 3]) -> Point {
    Point::new(at).unwrap()
}

pub(crate) fn cuboid(min: [i64; 3], max: [i64; 3]) -> Solid {
    Solid::cuboid(point(min), point(max)).unwrap()
}

pub(crate) fn named(name: &str, parts: Vec<Solid>) -> NamedShape {
    NamedShape {
        name: name.to_owned(),
        document: format!("{{\"of\":\"{name}\"}}"),
        shape: Arc::new(Shape::new(parts).unwrap()),
    }
}

/// A box, a tetrahedron, and two parts that move together.
pub(crate) fn shapes() -> Vec<NamedShape> {
    let corners = [[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4]].map(point);
    vec![
        named("box", vec![cuboid([0; 3], [2; 3])]),
        named("tip", vec![Solid::hull(&corners).unwrap()]),
        named(
            "two",
            vec![cuboid([0; 3], [1, 1, 4]), cuboid([-1, -1, 4], [2, 2, 6])],
        ),
    ]
}

/// A shape carried along a short segment, or a hull of its own, in a world so small that bodies meet in every way.
pub(crate) fn random_body(random: &mut Random, shapes: &[Arc<Shape>]) -> Body {
    loop {
        let mut at = || point([(); 3].map(|()| random.within(0, 6)));
        let (from, to, more) = (at(), at(), [at(), at(), at()]);
        match random.below(5) {
            0 => {
                let hull = Solid::hull(&[from, to, more[0], more[1], more[2]]);
                if let Ok(solid) = hull {
                    return Body::solid(solid);
                }
            }
            kind => {
                let shape = &shapes[random.below(shapes.len())];
                let to = if kind == 1 { from } else { to };
                return Body::swept(shape, from, to).unwrap();
            }
        }
    }
}
