//! Around a line: which half-planes the boundary of a union consists of.
//!
//! Near an inner point of an interval every touching piece is a half-space (a facet holds the line) or a wedge (an edge lies on it), and
//! all of them hold the line. So the union is known from its section: a set of angles.
//!
//! ```text
//!            \  a / covered ray: the outer side of b's face is in a
//!          a  \ /____ b
//!   ___________*______          sheets: boundary rays that no other piece covers
//!        flat: opposite rays of one oriented plane are no edge
//! ```

use smallvec::SmallVec;

use crate::geometry::EdgeKind;

use super::clip::Line;
use super::face::{Arithmetic, Face};

/// A piece that holds an interval of a line in its boundary.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch<'a> {
    /// Which member of the neighbourhood.
    member: u32,
    facets: [u16; 2],
    faces: [&'a Face; 2],
    count: u8,
}

/// One side of a face at a line: a half-plane that begins there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sheet<'a> {
    pub(super) face: &'a Face,
    /// 1: to the left of the line, along the face's normal times the line's direction; -1: to the right.
    pub(super) side: i32,
    /// Which member of the neighbourhood has the face, or one of those that have it.
    pub(super) member: u32,
}

impl Sheet<'_> {
    pub(super) fn same(&self, other: &Sheet) -> bool {
        self.side == other.side && self.same_face(other)
    }

    fn same_face(&self, other: &Sheet) -> bool {
        self.face.same(other.face)
    }
}

/// The boundary around a line: all its rays, each once, the flat ones too.
#[derive(Clone, Debug)]
pub(super) struct Rays<'a> {
    pub(super) rays: SmallVec<[Sheet<'a>; 4]>,
    pub(super) kind: EdgeKind,
}

impl<'a> Rays<'a> {
    pub(super) fn view(&self) -> Boundary<'_, 'a> {
        Boundary {
            rays: &self.rays,
            kind: self.kind,
        }
    }
}

/// Borrowed [`Rays`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Boundary<'r, 'a> {
    pub(super) rays: &'r [Sheet<'a>],
    pub(super) kind: EdgeKind,
}

impl<'r, 'a> Boundary<'r, 'a> {
    /// The rays that are sheets of an edge: opposite rays of one oriented plane are flat, and none.
    pub(super) fn sheets(self) -> impl Iterator<Item = Sheet<'a>> + use<'r, 'a> {
        let goes_on = |ray: &Sheet, other: &Sheet| other.side == -ray.side && other.same_face(ray);
        let is_flat = move |ray: &Sheet| self.rays.iter().any(|other| goes_on(ray, other));
        self.rays.iter().copied().filter(move |ray| !is_flat(ray))
    }

    /// The boundary of what a convex piece leaves beside this union, which lies in it: `own` are the piece's rays at the line.
    ///
    /// A ray of both is none of the rest: on the piece's boundary the union has the piece's own plane. The others have the union on
    /// their outer side now, so that the planes of its rays count as turned about; the sheets' flags of length and area are the same.
    pub(super) fn rest(
        self,
        arithmetic: Arithmetic,
        line: &Line<'a>,
        own: &[Sheet<'a>],
    ) -> Rays<'a> {
        let rays = self.rest_rays(own);
        let kind = match rays[..] {
            [(a, way), (b, _)] => kind_of_two(way * b.side * line.turn(arithmetic, a.face, b.face)),
            _ => EdgeKind::Crossing,
        };
        let rays = rays.into_iter().map(|(ray, _)| ray).collect();
        Rays { rays, kind }
    }

    /// The rays of that rest, each with 1, or with -1 where its plane counts as turned about.
    pub(super) fn rest_rays(self, own: &[Sheet<'a>]) -> SmallVec<[(Sheet<'a>, i32); 8]> {
        let is_in = |ray: &Sheet<'a>, rays: &[Sheet<'a>]| rays.iter().any(|other| other.same(ray));
        let turned = self.rays.iter().filter(|ray| !is_in(ray, own));
        let turned = turned.map(|ray| (*ray, -1));
        let kept = own.iter().filter(|ray| !is_in(ray, self.rays));
        turned.chain(kept.map(|ray| (*ray, 1))).collect()
    }
}

/// Of an edge with two sheets, one of which lies on this side of the other's plane: -1 inside. A convex one has it there.
fn kind_of_two(side: i32) -> EdgeKind {
    if side < 0 {
        EdgeKind::Convex
    } else {
        EdgeKind::Concave
    }
}

impl<'a> Touch<'a> {
    /// A piece that touches with one facet: locally a half-space.
    pub(super) fn facet(member: usize, facet: u16, face: &'a Face) -> Self {
        Self {
            member: small(member),
            facets: [facet; 2],
            faces: [face; 2],
            count: 1,
        }
    }

    /// A piece that touches with an edge between two facets: locally a wedge.
    pub(super) fn edge(member: usize, facets: [u16; 2], faces: [&'a Face; 2]) -> Self {
        Self {
            member: small(member),
            facets,
            faces,
            count: 2,
        }
    }

    /// Which member of the neighbourhood.
    #[inline]
    pub(super) fn member(&self) -> usize {
        self.member as usize
    }

    /// The faces that hold the line: one or two.
    #[inline]
    pub(super) fn faces(&self) -> &[&'a Face] {
        &self.faces[..usize::from(self.count)]
    }

    /// The facets that hold the line.
    #[inline]
    pub(super) fn facets(&self) -> &[u16] {
        &self.facets[..usize::from(self.count)]
    }

    #[inline]
    pub(super) fn is_edge(&self) -> bool {
        self.count == 2
    }

    /// A ray of one of its faces.
    pub(super) fn sheet(&self, face: &'a Face, side: i32) -> Sheet<'a> {
        let member = self.member;
        Sheet { face, side, member }
    }

    /// The two rays that bound it.
    pub(super) fn rays(&self, arithmetic: Arithmetic, line: &Line<'a>) -> [Sheet<'a>; 2] {
        let [a, b] = self.faces;
        if !self.is_edge() {
            return [self.sheet(a, 1), self.sheet(a, -1)];
        }
        // The ray of one face lies on the inner side of the other.
        let of = |face, other| self.sheet(face, -line.turn(arithmetic, other, face));
        [of(a, b), of(b, a)]
    }

    /// Whether the two are the same set of points near the line.
    pub(super) fn equal(&self, other: &Self) -> bool {
        self.count == other.count
            && self
                .faces()
                .iter()
                .all(|face| other.faces().iter().any(|one| one.same(face)))
    }

    /// Whether it lies in another; `rays` are its own.
    pub(super) fn within(
        &self,
        arithmetic: Arithmetic,
        line: &Line<'a>,
        rays: &[Sheet<'a>; 2],
        other: &Self,
    ) -> bool {
        other.faces().iter().all(|face| {
            if self.is_edge() {
                rays.iter()
                    .all(|ray| ray.side * line.turn(arithmetic, face, ray.face) <= 0)
            } else {
                face.same(self.faces[0])
            }
        })
    }
}

#[inline]
fn small(member: usize) -> u32 {
    u32::try_from(member).expect("fewer than 2^32 pieces")
}

/// Pieces around an interval, without those that lie in another.
pub(super) struct Sector<'a> {
    arithmetic: Arithmetic,
    line: Line<'a>,
    members: SmallVec<[(Touch<'a>, [Sheet<'a>; 2]); 6]>,
}

impl<'a> Sector<'a> {
    /// Of the touching pieces; `order` says which of two equal ones stays.
    pub(super) fn of(
        arithmetic: Arithmetic,
        line: &Line<'a>,
        touches: impl Iterator<Item = Touch<'a>>,
        order: impl Fn(&Touch<'a>) -> u64,
    ) -> Self {
        let mut members: SmallVec<[(Touch<'a>, [Sheet<'a>; 2]); 6]> = SmallVec::new();
        for touch in touches {
            members.push((touch, touch.rays(arithmetic, line)));
        }
        let mut index = 0;
        while index < members.len() {
            let (touch, rays) = members[index];
            let superfluous = members.iter().enumerate().any(|(at, (other, _))| {
                at != index
                    && touch.within(arithmetic, line, &rays, other)
                    && (!touch.equal(other) || order(other) < order(&touch))
            });
            if superfluous {
                members.swap_remove(index);
            } else {
                index += 1;
            }
        }
        Self {
            arithmetic,
            line: *line,
            members,
        }
    }

    /// The member or the two members that must find this interval, so that exactly one candidate does: the first edge by `order`, or else
    /// the first two facets that are not parallel.
    pub(super) fn finders(&self, order: impl Fn(&Touch<'a>) -> u64) -> Option<[usize; 2]> {
        let first = |fits: &dyn Fn(&Touch<'a>) -> bool| {
            let fitting = self.members.iter().map(|(touch, _)| touch);
            fitting
                .filter(|touch| fits(touch))
                .min_by_key(|touch| order(touch))
        };
        if let Some(edge) = first(&Touch::is_edge) {
            return Some([edge.member(); 2]);
        }
        let one = first(&|_| true)?;
        let two = first(&|touch| !touch.faces[0].parallel(one.faces[0]))?;
        Some([one.member(), two.member()])
    }

    /// The boundary of the union.
    pub(super) fn rays(&self) -> Rays<'a> {
        let mut rays: SmallVec<[Sheet<'a>; 4]> = SmallVec::new();
        for (index, (_, own)) in self.members.iter().enumerate() {
            for ray in own {
                if !self.is_covered(index, ray) && !rays.iter().any(|other| other.same(ray)) {
                    rays.push(*ray);
                }
            }
        }
        let kind = match &rays[..] {
            [a, b] => kind_of_two(b.side * self.line.turn(self.arithmetic, a.face, b.face)),
            _ => EdgeKind::Crossing,
        };
        Rays { rays, kind }
    }

    /// Whether another member holds the outer side of a member's ray.
    fn is_covered(&self, index: usize, ray: &Sheet<'a>) -> bool {
        let others = self.members.iter().enumerate();
        others
            .filter(|(at, _)| *at != index)
            .any(|(_, (other, _))| {
                other.faces().iter().all(|face| {
                    let turn = ray.side * self.line.turn(self.arithmetic, face, ray.face);
                    turn < 0 || (turn == 0 && face.opposite(ray.face))
                })
            })
    }
}
