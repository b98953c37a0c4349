//! What a piece adds to the union of its neighbours: the difference of all measures, from the edges of both unions that lie in the closed piece.
//!
//! An edge of a union of convex pieces lies on an edge of one of them, or where facets of two cross. With the new piece P and neighbours Q:
//!
//! ```text
//!   after    edges of P                          before   edges of Q in closed P
//!            crossings of P's facets and Q's              crossings of Q's and Q's in closed P
//! ```
//! Strictly inside P the edges of the union before go; on P's boundary each is weighed with and without P. A crossing needs vertices strictly on
//! both sides, both ways: what lies in a common plane, or touches, is an edge of one of the two.
//!
//! Only live features are candidates. Coplanar facets are grouped: a piece on one side of their plane crosses none of them.

use std::sync::Arc;

use rustc_hash::FxHashMap;
use smallvec::SmallVec;

use crate::geometry::convex::Plane;

use super::certify::{Room, Value};
use super::clip::Line;
use super::exact::cross_wide;
use super::face::{Arithmetic, Face, Position, Vertex, exact_side, side};
use super::features::Features;
#[cfg(feature = "paranoid")]
use super::lanes::Sides;
use super::lanes::{Rooms, separates, sides};
use super::ledger::{Books, Ledger};
use super::lines::{Candidates, Member, NEW, Phase, Scratch, Sink};
use super::measures::{ErrorMax, Measures};
use super::piece::Piece;
use super::sector::Touch;

/// Facets with more vertices are not worth a separate test against all planes of the new piece.
const SMALL_LOOP: usize = 8;
/// Groups with more facets remember which members lie on one side of their plane.
const LARGE_GROUP: usize = 2;

/// Computes marginals, one after the other, in memory that it keeps.
#[derive(Debug)]
pub(super) struct Kernel {
    arithmetic: Arithmetic,
    scratch: Scratch,
    ledger: Ledger,
}

/// What a piece adds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Marginal {
    pub(super) books: Books,
    /// A box around where the union is another one with the piece than without it; none when it is not.
    pub(super) change: Option<Room>,
}

/// A live facet of a neighbour that may meet the new piece.
#[derive(Clone, Copy)]
struct Candidate {
    member: usize,
    facet: u16,
    group: usize,
}

impl Kernel {
    /// Of pieces that all lie in the stock, where there is one.
    pub(super) fn new(arithmetic: Arithmetic, stock: Option<Arc<Piece>>) -> Self {
        Self {
            arithmetic,
            scratch: Scratch::default(),
            ledger: Ledger::new(arithmetic, stock),
        }
    }

    /// Counts the flags that another kernel rounded as its own, and no longer there.
    pub(super) fn take_flags(&mut self, other: &mut Self) {
        self.ledger.take_flags(&mut other.ledger);
    }

    /// How far off all roundings so far can be together.
    pub(super) fn error_max(&self) -> ErrorMax {
        self.ledger.error_max()
    }

    /// Counts the flags that another kernel has rounded so far, instead of its own.
    pub(super) fn count_flags_of(&mut self, other: &Self) {
        self.ledger.count_flags_of(&other.ledger);
    }

    /// The measures of the stock itself, whose flags count for ever.
    pub(super) fn begin(&mut self, piece: &Piece) -> Measures {
        let features = Features::live(piece.edges.len(), piece.faces.len());
        let member = Member {
            piece,
            features: &features,
            slot: 0,
        };
        let measures = self.marginal(&[member]).books.union;
        self.ledger.keep_flags();
        measures
    }

    /// Forgets the flags rounded so far, but for those of the stock: when their sum is 0.
    pub(super) fn forget_flags(&mut self) {
        self.ledger.forget_flags();
    }

    /// What the first member adds to the union of the others, which are all that touch it.
    pub(super) fn marginal(&mut self, members: &[Member]) -> Marginal {
        self.watching(members, std::iter::empty())
    }

    /// The same with contact: what it adds in its own planes.
    pub(super) fn marginal_with_contact(&mut self, members: &[Member]) -> Marginal {
        let faces = members[NEW].piece.faces.iter();
        self.watching(members, faces.map(|face| face.plane))
    }

    fn watching(&mut self, members: &[Member], planes: impl Iterator<Item = Plane>) -> Marginal {
        self.ledger.watch(planes);
        self.search(members);
        let change = self.ledger.room();
        Marginal {
            books: self.ledger.settle(),
            change,
        }
    }

    /// Twice the area that the first member adds to the union of the others in these planes.
    pub(super) fn contact(&mut self, members: &[Member], planes: Vec<Plane>) -> i128 {
        self.ledger.watch(planes.into_iter());
        self.search(members);
        self.ledger.settle_contact()
    }

    /// Posts what the first member changes.
    fn search(&mut self, members: &[Member]) {
        let mut search = Search::new(
            self.arithmetic,
            members,
            &mut self.scratch,
            &mut self.ledger,
        );
        search.own_edges();
        search.edges_in_new();
        search.crossings();
    }
}

/// Looks for all candidates among some members.
pub(super) struct Search<'a, 'w, S> {
    candidates: Candidates<'a, 'w, S>,
    members: &'a [Member<'a>],
}

impl<'a, 'w, S: Sink<'a>> Search<'a, 'w, S> {
    pub(super) fn new(
        arithmetic: Arithmetic,
        members: &'a [Member<'a>],
        scratch: &'w mut Scratch,
        sink: &'w mut S,
    ) -> Self {
        scratch.hints.clear();
        scratch.hints.resize(members.len(), 0);
        Rooms::of(
            members.iter().map(|member| member.piece.room),
            &mut scratch.rooms,
        );
        Self {
            candidates: Candidates {
                arithmetic,
                members,
                scratch,
                sink,
            },
            members,
        }
    }

    /// Edges of the new piece.
    pub(super) fn own_edges(&mut self) {
        let new = self.members[NEW];
        for edge in new.features.live_edges() {
            self.edge(NEW, edge, Phase::After);
        }
    }

    /// Edges of the others in the new piece.
    fn edges_in_new(&mut self) {
        for index in 1..self.members.len() {
            for edge in self.members[index].features.live_edges() {
                self.edge(index, edge, Phase::Before);
            }
        }
    }

    fn edge(&mut self, member: usize, edge: u16, phase: Phase) {
        let piece = self.members[member].piece;
        let edge = piece.edge(edge);
        if phase == Phase::Before {
            let ends = [edge.tail, edge.head].map(|end| &piece.corners[usize::from(end)].near);
            if self.candidates.misses_new(ends) {
                return;
            }
        }
        let faces = [piece.face(edge.left), piece.face(edge.right)];
        let ends = [edge.tail, edge.head].map(|vertex| piece.vertex(vertex));
        let direction = match [edge.tail, edge.head]
            .map(|vertex| piece.corners[usize::from(vertex)].position)
        {
            [Position::Lattice(tail), Position::Lattice(head)] => {
                [0, 1, 2].map(|axis: usize| i128::from(head[axis]) - i128::from(tail[axis]))
            }
            // To the left of a directed edge is the left facet, seen from outside: the direction is its normal times the right one's.
            _ => cross_wide(faces[0].plane.normal(), faces[1].plane.normal()),
        };
        let line = Line::new(faces, direction);
        let finder = Touch::edge(member, [edge.left, edge.right], faces);
        self.candidates.look(&line, ends, &[finder], phase);
    }

    /// Crossings of the new piece's facets with the others', and of the others' among themselves in it.
    fn crossings(&mut self) {
        let (mut facets, groups) = self.live_facets(0);
        self.own_crossings(&facets, &groups);
        self.pairs(&mut facets, &groups);
    }

    /// Crossings of the new piece's facets with those of members of higher slot.
    pub(super) fn crossings_with_later(&mut self) {
        let (facets, groups) = self.live_facets(self.members[NEW].slot + 1);
        self.own_crossings(&facets, &groups);
    }

    /// Crossings of the new piece's facets with others.
    fn own_crossings(&mut self, facets: &[Candidate], groups: &[Vec<usize>]) {
        let new = self.members[NEW];
        let own: SmallVec<[u16; 32]> = new.features.live_facets().collect();
        for group in groups {
            let first = facets[group[0]];
            if self.is_on_one_side(self.face(first), new.piece) {
                continue;
            }
            for &index in group {
                let Candidate { member, facet, .. } = facets[index];
                for &own in &own {
                    self.crossing([NEW, member], [own, facet], Phase::After);
                }
            }
        }
    }

    fn face(&self, candidate: Candidate) -> &'a Face {
        self.members[candidate.member].piece.face(candidate.facet)
    }

    /// The live facets of the others, from a slot on, that may meet the new piece, and their groups by plane.
    fn live_facets(&self, from: u32) -> (Vec<Candidate>, Vec<Vec<usize>>) {
        let new = self.members[NEW].piece;
        let mut facets = Vec::new();
        let mut groups: Vec<Vec<usize>> = Vec::new();
        let mut by_plane: FxHashMap<Plane, usize> = FxHashMap::default();
        for (
            member,
            Member {
                piece,
                features,
                slot,
            },
        ) in self.members.iter().enumerate().skip(1)
        {
            if *slot < from {
                continue;
            }
            for facet in features.live_facets() {
                if !piece.rooms[usize::from(facet)].meets(&new.room) {
                    continue;
                }
                let points = piece.loop_of(facet);
                if self.candidates.arithmetic == Arithmetic::Filtered
                    && points.len() <= SMALL_LOOP
                    && separates(&new.blocks, &piece.corners, points)
                {
                    continue;
                }
                let plane = piece.face(facet).plane;
                let plane = plane.min(plane.opposite());
                let group = *by_plane.entry(plane).or_insert_with(|| {
                    groups.push(Vec::new());
                    groups.len() - 1
                });
                groups[group].push(facets.len());
                facets.push(Candidate {
                    member,
                    facet,
                    group,
                });
            }
        }
        (facets, groups)
    }

    /// Crossings of the others' facets among themselves: every pair of groups once, the larger one first.
    fn pairs(&mut self, facets: &mut [Candidate], groups: &[Vec<usize>]) {
        let is_large = |group: usize| groups[group].len() > LARGE_GROUP;
        let mut sides: Vec<Option<bool>> = vec![None; self.members.len()];
        for (number, group) in groups.iter().enumerate() {
            let face = self.face(facets[group[0]]);
            if is_large(number) {
                sides.fill(None);
            }
            for &other in facets.iter() {
                // Each pair of groups belongs to its large one, or else, or when both are, to the first.
                let is_ours = match (is_large(number), is_large(other.group)) {
                    (true, false) => true,
                    (false, true) => false,
                    _ => number < other.group,
                };
                if !is_ours {
                    continue;
                }
                if is_large(number) {
                    let piece = self.members[other.member].piece;
                    let known = sides[other.member];
                    let is_aside = known.unwrap_or_else(|| self.is_on_one_side(face, piece));
                    sides[other.member] = Some(is_aside);
                    if is_aside {
                        continue;
                    }
                }
                for &index in group {
                    let one = facets[index];
                    if one.member != other.member {
                        self.crossing(
                            [one.member, other.member],
                            [one.facet, other.facet],
                            Phase::Before,
                        );
                    }
                }
            }
        }
    }

    /// Whether a piece lies in one closed half-space of a plane.
    fn is_on_one_side(&self, face: &'a Face, piece: &'a Piece) -> bool {
        let arithmetic = self.candidates.arithmetic;
        if arithmetic == Arithmetic::Filtered {
            let found = sides(&piece.points, &face.rough);
            #[cfg(feature = "paranoid")]
            check_sides(face, piece, found);
            if found.above && found.below {
                return false;
            }
            // A facet's own plane is the usual one that some vertices are on.
            let bounds = |own: &Face| own.same(face) || own.opposite(face);
            if !found.unsure || piece.faces.iter().any(bounds) {
                return true;
            }
        }
        let (mut above, mut below) = (false, false);
        for (vertex, corner) in (0..).zip(&piece.corners) {
            let sign = match face.rough.side(&corner.near) {
                Some(sign) if arithmetic == Arithmetic::Filtered => sign,
                _ => exact_side(face, &piece.vertex(vertex)),
            };
            above |= sign > 0;
            below |= sign < 0;
            if above && below {
                return false;
            }
        }
        true
    }

    /// The segment in which facets of two members cross properly, if they do.
    fn crossing(&mut self, members: [usize; 2], facets: [u16; 2], phase: Phase) {
        let arithmetic = self.candidates.arithmetic;
        let [a, b] = members.map(|member| self.members[member].piece);
        let [f, g] = facets;
        if !a.rooms[usize::from(f)].meets(&b.rooms[usize::from(g)]) {
            return;
        }
        let faces = [a.face(f), b.face(g)];
        if !has_both_sides(
            b.loop_of(g)
                .iter()
                .map(|&vertex| side(arithmetic, faces[0], &b.vertex(vertex)).0),
        ) {
            return;
        }
        let points = a.loop_of(f);
        let sides: SmallVec<[(i32, Value); 32]> = points
            .iter()
            .map(|&vertex| side(arithmetic, faces[1], &a.vertex(vertex)))
            .collect();
        if !has_both_sides(sides.iter().map(|(side, _)| *side)) {
            return;
        }
        let line = Line::new(
            faces,
            cross_wide(faces[0].plane.normal(), faces[1].plane.normal()),
        );
        let Some(mut ends) = ends_in_facet(a, f, &line, &sides) else {
            unreachable!(
                "a convex facet with vertices on both sides of a plane is cut in a segment"
            );
        };
        for &across in b.across(g) {
            let face = b.face(across);
            let at = [0, 1].map(|end: usize| side(arithmetic, face, &ends[end]));
            let values = at.map(|(_, value)| value);
            match at.map(|(side, _)| side) {
                [0 | 1, 0 | 1] => return,
                [1, _] => ends[0] = line.cut(face, [&ends[0], &ends[1]], values),
                [_, 1] => ends[1] = line.cut(face, [&ends[0], &ends[1]], values),
                _ => {}
            }
        }
        if phase == Phase::Before && self.candidates.misses_new([&ends[0].near, &ends[1].near]) {
            return;
        }
        let finders = [
            Touch::facet(members[0], f, faces[0]),
            Touch::facet(members[1], g, faces[1]),
        ];
        self.candidates.look(&line, ends, &finders, phase);
    }
}

/// Compares what the filter says of a piece's vertices with exact signs.
#[cfg(feature = "paranoid")]
fn check_sides(face: &Face, piece: &Piece, found: Sides) {
    let corners = u16::try_from(piece.corners.len()).expect("fewer than 2^16 vertices");
    let exact: Vec<i32> = (0..corners)
        .map(|vertex| exact_side(face, &piece.vertex(vertex)))
        .collect();
    assert!(!found.above || exact.contains(&1), "one is outside");
    assert!(!found.below || exact.contains(&-1), "one is inside");
    let is_sure = !found.unsure && !(found.above && found.below);
    assert!(
        !is_sure
            || exact
                .iter()
                .all(|side| [-i32::from(found.below), i32::from(found.above)].contains(side)),
        "all are on the side that is found"
    );
}

fn has_both_sides(sides: impl Iterator<Item = i32>) -> bool {
    let (mut above, mut below) = (false, false);
    for side in sides {
        above |= side > 0;
        below |= side < 0;
        if above && below {
            return true;
        }
    }
    false
}

/// Where a line in the plane of a facet enters and leaves it; `sides` are those of the other plane at the facet's vertices.
fn ends_in_facet<'a>(
    piece: &'a Piece,
    facet: u16,
    line: &Line<'a>,
    sides: &[(i32, Value)],
) -> Option<[Vertex<'a>; 2]> {
    let (points, across) = (piece.loop_of(facet), piece.across(facet));
    let (mut tail, mut head) = (None, None);
    for (index, &(here, value)) in sides.iter().enumerate() {
        let next = if index + 1 == sides.len() {
            0
        } else {
            index + 1
        };
        let (there, next_value) = sides[next];
        // The line is normal of the facet x normal of the other: walking counterclockwise, the facet is entered by the line where the walk
        // comes up through the other plane.
        if here * there < 0 {
            let ends = [points[index], points[next]].map(|vertex| piece.vertex(vertex));
            let edge = Line::new([line.faces[0], piece.face(across[index])], line.direction);
            let cut = edge.cut(line.faces[1], [&ends[0], &ends[1]], [value, next_value]);
            if here < 0 {
                tail = Some(cut);
            } else {
                head = Some(cut);
            }
        } else if here == 0 {
            let (last, _) = sides[index.checked_sub(1).unwrap_or(sides.len() - 1)];
            let vertex = piece.vertex(points[index]);
            if last < 0 || there > 0 {
                tail = Some(vertex);
            } else {
                head = Some(vertex);
            }
        }
    }
    Some([tail?, head?])
}
