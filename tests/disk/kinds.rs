//! What the kinds of scenes have of their own here: how one is made, and which bodies come. All else that is tried is the same.

use std::sync::Arc;

use union3d::engine::solids;
use union3d::geometry::convex::Solid;
use union3d::geometry::{Edge, Place, Stock};
use union3d::log::{Header, Kind};
use union3d::service::{
    AnyAudit, Audit, Cubes, NamedShape, SceneKind, SceneName, SceneOf, Service, ServiceError,
    Shapes, Solids,
};

use super::Random;
use super::bodies::{cuboid, named, point, random_body, shapes};

/// A scene that was created, and whether it is new.
pub(crate) type Created<K> = Result<(Arc<SceneOf<K>>, bool), ServiceError>;

/// A kind of scene that is tried on a disk.
pub(crate) trait Tried: SceneKind {
    /// Edge of its bodies, if they have one.
    const EDGE_STEPS: u32;
    /// Definitions that a scene has from the start.
    const DEFINED_FIRST: usize;

    /// The definition of this number in every scene, from 0; none where nothing is defined.
    fn definition(number: usize) -> Option<Box<[u8]>>;

    /// How many definitions there are.
    fn defined(context: &Self::Context) -> usize;

    /// A body that so many definitions allow, in a small world.
    fn body(random: &mut Random, definitions: usize) -> Self::Body;

    /// Something to be cut.
    fn stock() -> Self::Stock;

    async fn create(
        service: &Service,
        name: &SceneName,
        stock: Option<Self::Stock>,
    ) -> Created<Self>;

    fn scene(service: &Service, name: &str) -> Result<Arc<SceneOf<Self>>, ServiceError>;

    /// The audit, when it is of this kind.
    fn audited(audit: AnyAudit) -> Option<Audit<Self>>;

    fn header() -> Header<Self> {
        Header {
            incarnation: 1,
            edge_steps: Self::EDGE_STEPS,
            stock: None,
            settings: String::new(),
        }
    }

    fn first_definitions() -> Vec<Box<[u8]>> {
        let first = (0..Self::DEFINED_FIRST).map(Self::definition);
        first.collect::<Option<_>>().unwrap()
    }
}

pub(crate) fn edge() -> Edge {
    Edge::new(i64::from(Cubes::EDGE_STEPS)).unwrap()
}

impl Tried for Cubes {
    const EDGE_STEPS: u32 = 3;
    const DEFINED_FIRST: usize = 0;

    fn definition(_: usize) -> Option<Box<[u8]>> {
        None
    }

    fn defined(_: &Edge) -> usize {
        0
    }

    fn body(random: &mut Random, _: usize) -> Place {
        let corner = [0; 3].map(|_: i64| random.within(0, 6));
        Place::new(corner, edge()).unwrap()
    }

    fn stock() -> Stock {
        Stock::new([0, 0, 0], [9, 9, 5]).unwrap()
    }

    async fn create(service: &Service, name: &SceneName, stock: Option<Stock>) -> Created<Self> {
        service.create(name, edge(), stock, "{}").await
    }

    fn scene(service: &Service, name: &str) -> Result<Arc<SceneOf<Self>>, ServiceError> {
        service.scene(name)
    }

    fn audited(audit: AnyAudit) -> Option<Audit<Self>> {
        match audit {
            AnyAudit::Cubes(audit) => Some(*audit),
            AnyAudit::Solids(_) => None,
        }
    }
}

/// The shape of this number: after the first ones longer and longer bars.
fn shape(number: usize) -> NamedShape {
    let bar = || {
        let length = i64::try_from(number).unwrap();
        named(
            &format!("bar-{number}"),
            vec![cuboid([0; 3], [length, 1, 2])],
        )
    };
    shapes().into_iter().nth(number).unwrap_or_else(bar)
}

impl Tried for Solids {
    const EDGE_STEPS: u32 = 0;
    const DEFINED_FIRST: usize = 3;

    fn definition(number: usize) -> Option<Box<[u8]>> {
        Some(shape(number).definition())
    }

    fn defined(shapes: &Shapes) -> usize {
        shapes.len()
    }

    fn body(random: &mut Random, definitions: usize) -> <Self as Kind>::Body {
        // The newest as often as all others together: a body of a shape that is lost tells.
        let shapes = (0..definitions).chain([definitions - 1; 3]);
        let shapes: Vec<_> = shapes.map(|number| shape(number).shape).collect();
        random_body(random, &shapes)
    }

    fn stock() -> solids::Stock {
        let corners = [
            [0, 0, 0],
            [9, 0, 0],
            [0, 9, 0],
            [9, 9, 0],
            [0, 0, 5],
            [9, 0, 5],
        ];
        solids::Stock::new(Solid::hull(&corners.map(point)).unwrap()).unwrap()
    }

    async fn create(
        service: &Service,
        name: &SceneName,
        stock: Option<solids::Stock>,
    ) -> Created<Self> {
        let first: Vec<_> = (0..Self::DEFINED_FIRST).map(shape).collect();
        service.create_solids(name, stock, &first, "{}").await
    }

    fn scene(service: &Service, name: &str) -> Result<Arc<SceneOf<Self>>, ServiceError> {
        service.solid_scene(name)
    }

    fn audited(audit: AnyAudit) -> Option<Audit<Self>> {
        match audit {
            AnyAudit::Solids(audit) => Some(*audit),
            AnyAudit::Cubes(_) => None,
        }
    }
}
