//! What a scene of solids is made of: bodies, each of one or several convex parts.

use std::sync::Arc;

use crate::geometry::Bounds;
use crate::geometry::convex::{InvalidSolid, InvalidSweep, Point, Solid};

/// Most convex parts of a shape: 64.
pub const PARTS_MAX: usize = 64;

pub use crate::geometry::CubeId as SolidId;

/// One or several convex solids around an anchor at the origin, to be carried about.
#[derive(Clone, Debug)]
pub struct Shape {
    parts: Vec<Solid>,
    top: Option<i32>,
}

/// Why solids do not make a [`Shape`], or a shape not a [`Body`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
pub enum InvalidBody {
    /// A shape has no parts, or too many.
    #[error("a shape has {count} parts; it must be 1 to {PARTS_MAX}")]
    Parts {
        /// How many there were.
        count: usize,
    },
    /// A part cannot be where it is to be.
    #[error("part {part}: {why}")]
    Part {
        /// Which part, from 0.
        part: usize,
        /// What is wrong with it.
        why: InvalidSweep,
    },
}

impl Shape {
    /// A shape of convex parts.
    /// # Errors
    /// [`InvalidBody::Parts`] without a part, or with more than [`PARTS_MAX`].
    pub fn new(parts: Vec<Solid>) -> Result<Self, InvalidBody> {
        let count = parts.len();
        if !(1..=PARTS_MAX).contains(&count) {
            return Err(InvalidBody::Parts { count });
        }
        Ok(Self { parts, top: None })
    }

    /// The same, whose top reaches up to this height wherever the shape is carried, as in [`Solid::swept_to_top`].
    #[must_use]
    pub fn with_top(mut self, top: i32) -> Self {
        self.top = Some(top);
        self
    }

    /// The height that its top reaches up to wherever it is carried, if any.
    pub fn top(&self) -> Option<i32> {
        self.top
    }

    /// The convex parts around the anchor.
    pub fn parts(&self) -> &[Solid] {
        &self.parts
    }

    /// A part carried along a segment.
    fn carried(&self, part: usize, from: Point, to: Point) -> Result<Solid, InvalidBody> {
        let solid = &self.parts[part];
        let carried = match self.top {
            Some(top) => solid.swept_to_top(from, to, top),
            None => solid.swept(from, to).map_err(InvalidSweep::from),
        };
        carried.map_err(|why| InvalidBody::Part { part, why })
    }
}

/// One solid of a scene: the union of a few convex parts. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Body(Kind);

#[derive(Clone, Debug)]
enum Kind {
    /// A shape carried along a segment.
    Swept {
        shape: Arc<Shape>,
        from: Point,
        to: Point,
    },
    /// A solid where it is.
    Solid(Arc<Solid>),
}

impl Body {
    /// What a shape sweeps when its anchor is carried along a segment, or stands in one point.
    /// # Errors
    /// [`InvalidBody::Part`] names the first part that gets too long, too far out or above its top.
    pub fn swept(shape: &Arc<Shape>, from: Point, to: Point) -> Result<Self, InvalidBody> {
        for (part, solid) in shape.parts.iter().enumerate() {
            if !solid.is_surely_swept(from, to, shape.top) {
                shape.carried(part, from, to)?;
            }
        }
        let shape = Arc::clone(shape);
        Ok(Self(Kind::Swept { shape, from, to }))
    }

    /// A convex solid.
    pub fn solid(solid: Solid) -> Self {
        Self(Kind::Solid(Arc::new(solid)))
    }

    /// The box between two corners.
    /// # Errors
    /// [`InvalidSolid`] when it has no volume, or is too long.
    pub fn cuboid(a: Point, b: Point) -> Result<Self, InvalidSolid> {
        Solid::cuboid(a, b).map(Self::solid)
    }

    /// How many convex parts it has.
    pub fn len(&self) -> usize {
        match &self.0 {
            Kind::Swept { shape, .. } => shape.parts.len(),
            Kind::Solid(_) => 1,
        }
    }

    /// Never: a body has a part.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// A convex part, where it is. O(size of the part), and a logarithm for a swept one.
    pub fn part(&self, part: usize) -> Solid {
        match &self.0 {
            Kind::Swept { shape, from, to } => shape
                .carried(part, *from, *to)
                .expect("it was carried there when the body was made"),
            Kind::Solid(solid) => Solid::clone(solid),
        }
    }

    /// Where the anchor of a swept shape goes from and to, and the shape; none for a solid that was given where it is.
    pub fn sweep(&self) -> Option<(&Arc<Shape>, Point, Point)> {
        match &self.0 {
            Kind::Swept { shape, from, to } => Some((shape, *from, *to)),
            Kind::Solid(_) => None,
        }
    }

    /// The solid that was given where it is; none for a swept shape.
    pub fn hull(&self) -> Option<&Solid> {
        match &self.0 {
            Kind::Swept { .. } => None,
            Kind::Solid(solid) => Some(solid),
        }
    }

    /// The box around it.
    pub fn bounds(&self) -> Bounds {
        let boxes = (0..self.len()).map(|part| self.part_bounds(part));
        let around = boxes.reduce(|a, b| a.union(&b));
        around.expect("a body has a part")
    }

    /// The box around a part. O(1).
    pub(super) fn part_bounds(&self, part: usize) -> Bounds {
        match &self.0 {
            Kind::Swept { shape, from, to } => {
                let Bounds { min, mut max } = shape.parts[part].bounds();
                let (from, to) = (from.coordinates(), to.coordinates());
                let least = |axis: usize| min[axis] + from[axis].min(to[axis]);
                let min = [least(0), least(1), least(2)];
                for axis in 0..3 {
                    max[axis] += from[axis].max(to[axis]);
                }
                max[2] = shape.top.unwrap_or(max[2]);
                Bounds { min, max }
            }
            Kind::Solid(solid) => solid.bounds(),
        }
    }
}

/// The same shape carried along the same segment, or the same vertices.
impl PartialEq for Body {
    fn eq(&self, other: &Self) -> bool {
        match (&self.0, &other.0) {
            (
                Kind::Swept { shape, from, to },
                Kind::Swept {
                    shape: other_shape,
                    from: other_from,
                    to: other_to,
                },
            ) => from == other_from && to == other_to && shape == other_shape,
            (Kind::Solid(a), Kind::Solid(b)) => Arc::ptr_eq(a, b) || sorted(a) == sorted(b),
            _ => false,
        }
    }
}

/// What makes a solid: its vertices, in an order of their own.
pub(super) fn sorted(solid: &Solid) -> Vec<Point> {
    let mut vertices = solid.vertices().to_vec();
    vertices.sort_unstable();
    vertices
}

/// The same parts in the same order, and the same top. `Arc`s of shapes compare by their addresses first.
impl PartialEq for Shape {
    fn eq(&self, other: &Self) -> bool {
        let parts = self.parts.iter().map(sorted);
        self.top == other.top && parts.eq(other.parts.iter().map(sorted))
    }
}

impl Eq for Shape {}

impl Eq for Body {}
