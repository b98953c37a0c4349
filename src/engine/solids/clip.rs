//! The part of a segment that lies in a convex piece.
//!
//! Knows one line and one piece at a time. Signs come from the filter or, where it is unsure, from exact integers; positions are only rough.

use smallvec::SmallVec;

use super::certify::{Near, Value, Way};
use super::exact;
#[cfg(feature = "paranoid")]
use super::face::exact_side;
use super::face::{Arithmetic, Face, Place, Vertex, side};
use super::lanes::{Verdict, separate};
use super::piece::Piece;

/// A directed line, held by two planes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line<'a> {
    pub(super) faces: [&'a Face; 2],
    /// Along it, of any length.
    pub(super) direction: [i128; 3],
    way: Way,
}

impl<'a> Line<'a> {
    pub(super) fn new(faces: [&'a Face; 2], direction: [i128; 3]) -> Self {
        Self {
            faces,
            direction,
            way: Way::of(direction),
        }
    }

    /// The line in which two facets of a piece meet, with the first to its left.
    pub(super) fn along(faces: [&'a Face; 2]) -> Self {
        let [left, right] = faces.map(|face| face.plane.normal());
        Self::new(faces, exact::cross_wide(left, right))
    }

    /// On which side of `face` the ray of `of` lies that is to the left of the line, seen from outside `of`: the sign of
    /// `face.n . (of.n x direction)`. Both planes hold the line.
    pub(super) fn turn(&self, arithmetic: Arithmetic, face: &Face, of: &Face) -> i32 {
        if face.parallel(of) {
            return 0;
        }
        if arithmetic == Arithmetic::Filtered
            && let Some(sign) = face.rough.turn(&of.rough, &self.way)
        {
            #[cfg(feature = "paranoid")]
            assert_eq!(
                sign,
                exact::turn(&face.plane, &of.plane, self.direction),
                "the filter's bound holds"
            );
            return sign;
        }
        exact::turn(&face.plane, &of.plane, self.direction)
    }

    /// The point between two of the line where it crosses a face; `values` are rough ones at the two.
    #[inline]
    pub(super) fn cut(
        &self,
        face: &'a Face,
        ends: [&Vertex<'a>; 2],
        values: [Value; 2],
    ) -> Vertex<'a> {
        Vertex {
            near: Near::crossing([&ends[0].near, &ends[1].near], &face.rough, values),
            place: Place::Meeting([self.faces[0], self.faces[1], face]),
        }
    }
}

/// The part of a segment in a closed piece, where it is more than a point.
pub(super) struct Inside<'a> {
    /// Where the part begins, unless the segment begins inside.
    pub(super) enters: Option<Vertex<'a>>,
    /// Where the part ends, unless the segment ends inside.
    pub(super) leaves: Option<Vertex<'a>>,
    /// Facets of the piece that hold the line: none inside, one in a facet, two along an edge.
    pub(super) facets: SmallVec<[u16; 2]>,
}

/// Clips a segment to a piece; none when they have at most a point in common. `first` is the block of planes to begin with,
/// and becomes one that separated. O(facets).
pub(super) fn clip<'a>(
    arithmetic: Arithmetic,
    piece: &'a Piece,
    line: &Line<'a>,
    ends: [&Vertex<'a>; 2],
    first: &mut u16,
    near: &mut Vec<u16>,
) -> Option<Inside<'a>> {
    list_near(arithmetic, piece, ends, first, near)?;
    let [mut tail, mut head] = [*ends[0], *ends[1]];
    let (mut enters, mut leaves) = (None, None);
    let mut facets = SmallVec::new();
    for &facet in near.iter() {
        let face = piece.face(facet);
        let (at_tail, tail_value) = side(arithmetic, face, &tail);
        let (at_head, head_value) = side(arithmetic, face, &head);
        let values = [tail_value, head_value];
        if at_tail >= 0 && at_head >= 0 {
            if at_tail == 0 && at_head == 0 {
                facets.push(facet);
            } else {
                return None;
            }
        } else if at_tail > 0 {
            tail = line.cut(face, [&tail, &head], values);
            enters = Some(tail);
        } else if at_head > 0 {
            head = line.cut(face, [&tail, &head], values);
            leaves = Some(head);
        }
    }
    assert!(
        facets.len() <= 2,
        "at most two facets of a convex piece hold a line"
    );
    Some(Inside {
        enters,
        leaves,
        facets,
    })
}

/// The one point that a segment and a piece have in common, where it is a single one between the segment's ends. O(facets).
pub(super) fn contact<'a>(
    arithmetic: Arithmetic,
    piece: &'a Piece,
    line: &Line<'a>,
    ends: [&Vertex<'a>; 2],
    near: &mut Vec<u16>,
) -> Option<Vertex<'a>> {
    list_near(arithmetic, piece, ends, &mut 0, near)?;
    let [mut tail, mut head] = [*ends[0], *ends[1]];
    let (mut enters, mut leaves) = (false, false);
    for &facet in near.iter() {
        let face = piece.face(facet);
        let (at_tail, tail_value) = side(arithmetic, face, &tail);
        let (at_head, head_value) = side(arithmetic, face, &head);
        let values = [tail_value, head_value];
        let (point, is_between) = match (at_tail, at_head) {
            (1, 1) => return None,
            (0, 1) => (tail, enters),
            (1, 0) => (head, leaves),
            (1, _) => {
                tail = line.cut(face, [&tail, &head], values);
                enters = true;
                continue;
            }
            (_, 1) => {
                head = line.cut(face, [&tail, &head], values);
                leaves = true;
                continue;
            }
            _ => continue,
        };
        let mut others = near.iter().map(|other| piece.face(*other));
        let holds = |face: &Face| side(arithmetic, face, &point).0 <= 0;
        return (is_between && others.all(holds)).then_some(point);
    }
    None
}

/// Lists the facets of a piece that may have an end of a segment not inside; none when both are outside of one. `first` is the block of
/// planes to begin with, and becomes one that separated.
fn list_near(
    arithmetic: Arithmetic,
    piece: &Piece,
    ends: [&Vertex; 2],
    first: &mut u16,
    near: &mut Vec<u16>,
) -> Option<()> {
    if arithmetic == Arithmetic::Exact {
        near.clear();
        near.extend(
            (0..piece.faces.len())
                .map(|facet| u16::try_from(facet).expect("fewer than 2^16 facets")),
        );
        return Some(());
    }
    let points = [&ends[0].near, &ends[1].near];
    let verdict = separate(&piece.blocks, points, usize::from(*first), near);
    #[cfg(feature = "paranoid")]
    check_verdict(piece, ends, verdict, near);
    if let Verdict::Apart(block) = verdict {
        *first = u16::try_from(block).expect("a piece has fewer than 2^16 facets");
        return None;
    }
    Some(())
}

/// Compares what the filter says with exact signs.
#[cfg(feature = "paranoid")]
fn check_verdict(piece: &Piece, ends: [&Vertex; 2], verdict: Verdict, near: &[u16]) {
    let sides = |facet: &Face| ends.map(|end| exact_side(facet, end));
    match verdict {
        Verdict::Apart(block) => {
            let planes = piece.faces.chunks(super::lanes::LANES).nth(block);
            let planes = planes.expect("it is one of the blocks");
            assert!(
                planes.iter().any(|face| sides(face) == [1, 1]),
                "a plane separates"
            );
        }
        Verdict::Undecided => {
            for (facet, face) in piece.faces.iter().enumerate() {
                let listed = near.iter().any(|one| usize::from(*one) == facet);
                assert!(
                    listed || sides(face) == [-1, -1],
                    "what is not listed has both inside"
                );
            }
        }
    }
}
