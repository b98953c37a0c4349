//! Shapes, which solids of a scene share, and bodies: what one solid of a scene fills.

use std::sync::Arc;

use super::point::Point;
use super::solid::Solid;
use super::sweep::InvalidSweep;

/// One convex part of a [`Shape`].
#[derive(Clone, Debug)]
pub struct Part {
    /// The part when the shape's anchor is at the origin.
    pub solid: Solid,
    /// The height up to which the part reaches wherever the shape is, in steps ([`Solid::swept_to_top`]); none when it moves as it is.
    pub top: Option<i32>,
}

impl Part {
    /// What the part sweeps when the anchor is carried from `from` to `to`.
    fn swept(&self, from: Point, to: Point) -> Result<Solid, InvalidSweep> {
        match self.top {
            None => Ok(self.solid.swept(from, to)?),
            Some(top) => self.solid.swept_to_top(from, to, top),
        }
    }
}

/// One convex solid or several that move together, such as a cutter and its holder.
#[derive(Clone, Debug)]
pub struct Shape {
    parts: Vec<Part>,
}

/// Most parts of a shape.
pub const PARTS_MAX: usize = 64;

/// Why parts do not make a [`Shape`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("a shape of {count} parts; it has from 1 to {PARTS_MAX}")]
pub struct InvalidShape {
    /// How many parts were offered.
    pub count: usize,
}

impl Shape {
    /// The shape of these parts, which may overlap.
    /// # Errors
    /// [`InvalidShape`] when there are none or too many.
    pub fn new(parts: Vec<Part>) -> Result<Self, InvalidShape> {
        match parts.len() {
            1..=PARTS_MAX => Ok(Self { parts }),
            count => Err(InvalidShape { count }),
        }
    }

    /// Its parts; one at least.
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }
}

/// What one solid of a scene fills: a shape carried along a segment, or a convex solid of its own.
///
/// Small, and checked: the solids that it stands for are built when they are asked for ([`Body::solids`]).
#[derive(Clone, Debug)]
pub struct Body(Kind);

#[derive(Clone, Debug)]
enum Kind {
    Swept {
        shape: Arc<Shape>,
        from: Point,
        to: Point,
    },
    Own(Arc<Solid>),
}

/// Why a shape cannot be carried along a segment.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("part {part} of the shape: {fault}")]
pub struct InvalidBody {
    /// Which part, from 0.
    pub part: usize,
    /// What is wrong.
    pub fault: InvalidSweep,
}

impl Body {
    /// What a shape sweeps when its anchor is carried straight from `from` to `to`; the shape at one place when they are the same.
    /// # Errors
    /// [`InvalidBody`] names the first part that leaves the limits.
    pub fn swept(shape: Arc<Shape>, from: Point, to: Point) -> Result<Self, InvalidBody> {
        for (part, its) in shape.parts.iter().enumerate() {
            its.swept(from, to)
                .map_err(|fault| InvalidBody { part, fault })?;
        }
        Ok(Self(Kind::Swept { shape, from, to }))
    }

    /// A solid of its own.
    pub fn own(solid: Solid) -> Self {
        Self(Kind::Own(Arc::new(solid)))
    }

    /// The convex solids that it fills, one at least. Builds them: O(size log size).
    pub fn solids(&self) -> impl Iterator<Item = Solid> {
        let (swept, own) = match &self.0 {
            Kind::Swept { shape, from, to } => (Some((shape, *from, *to)), None),
            Kind::Own(solid) => (None, Some(Solid::clone(solid))),
        };
        let swept = swept.into_iter().flat_map(|(shape, from, to)| {
            let checked = move |part: &Part| part.swept(from, to).expect("checked when made");
            shape.parts.iter().map(checked)
        });
        swept.chain(own)
    }

    /// The shape and the positions of its anchor, unless the body is a solid of its own.
    pub fn sweep(&self) -> Option<(&Arc<Shape>, Point, Point)> {
        match &self.0 {
            Kind::Swept { shape, from, to } => Some((shape, *from, *to)),
            Kind::Own(_) => None,
        }
    }

    /// The solid of its own, unless the body is a shape carried along a segment.
    pub fn own_solid(&self) -> Option<&Arc<Solid>> {
        match &self.0 {
            Kind::Swept { .. } => None,
            Kind::Own(solid) => Some(solid),
        }
    }
}

/// Whether they are the same shape carried the same way, or solids of the same vertices. A shape is the same only as itself: two
/// shapes that happen to be equal are two.
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
            ) => Arc::ptr_eq(shape, other_shape) && (from, to) == (other_from, other_to),
            (Kind::Own(solid), Kind::Own(other)) => solid.same_points(other),
            _ => false,
        }
    }
}

impl Eq for Body {}
