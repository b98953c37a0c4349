//! A candidate of the union's edges: a segment of a line, cut by every neighbour to the intervals that are edges.
//!
//! ```text
//!   segment ── clip by each neighbour ──> inside one: dropped
//!                                         touching one: an interval of its own, and one more piece around it
//!           ──> intervals, each with the pieces around it ── sector ──> sheets ── sink
//! ```
//! Every interval is found by several candidates; the sector names the one that posts it.

use smallvec::SmallVec;

use crate::geometry::EdgeKind;

use super::certify::{Near, Room};
use super::clip::{Inside, Line, clip};
use super::face::{Arithmetic, Vertex, exact_side};
use super::features::Features;
use super::lanes::{Rooms, Verdict, next_meeting, separate};
use super::piece::Piece;
use super::sector::{Boundary, Rays, Sector, Sheet, Touch};

/// A piece of the neighbourhood. The first one is the piece whose marginal is sought.
#[derive(Clone, Copy)]
pub(super) struct Member<'a> {
    pub(super) piece: &'a Piece,
    pub(super) features: &'a Features,
    /// Its slot in the engine, unique.
    pub(super) slot: u32,
}

/// The piece whose marginal is sought.
pub(super) const NEW: usize = 0;

/// Which union a candidate is an edge of.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Phase {
    /// The union with the new piece, on the new piece's boundary.
    After,
    /// The union without it, within the closed new piece: what goes, or stays on the boundary.
    Before,
}

/// Memory that one line after the other uses.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Boxes of the members.
    pub(super) rooms: Vec<Rooms>,
    /// For each member the block of planes that separated last.
    pub(super) hints: Vec<u16>,
    near: Vec<u16>,
}

/// A part of a segment, and what is known of it after the members before `next`.
struct Interval<'a> {
    ends: [Vertex<'a>; 2],
    touches: SmallVec<[Touch<'a>; 4]>,
    /// The member to look at.
    next: usize,
    /// Whether it lies in the interior of the new piece.
    is_in_new: bool,
}

/// Takes what is found along an interval.
pub(super) trait Sink<'a> {
    /// The boundary around an edge of the union, so many times.
    fn post(&mut self, line: &Line<'a>, ends: &[Vertex<'a>; 2], rays: Boundary<'_, 'a>, weight: i8);

    /// The boundary around an interval before and after.
    fn exchange(&mut self, line: &Line<'a>, ends: &[Vertex<'a>; 2], around: [Boundary<'_, 'a>; 2]);
}

/// Looks at candidates, one after the other.
pub(super) struct Candidates<'a, 'w, S> {
    pub(super) arithmetic: Arithmetic,
    pub(super) members: &'a [Member<'a>],
    pub(super) scratch: &'w mut Scratch,
    pub(super) sink: &'w mut S,
}

impl<'a, S: Sink<'a>> Candidates<'a, '_, S> {
    /// Which of two equal pieces around a line stays: the one with a live feature there, then the one of lower slot.
    fn order(&self, touch: &Touch<'a>) -> u64 {
        let Member {
            piece,
            features,
            slot,
        } = self.members[touch.member()];
        let is_live = match *touch.facets() {
            [facet] => features.is_facet_live(facet),
            [a, b] => piece
                .edge_between(a, b)
                .is_some_and(|edge| features.is_edge_live(edge)),
            _ => unreachable!("one or two facets hold a line"),
        };
        u64::from(!is_live) << 32 | u64::from(slot)
    }

    /// Whether a segment certainly does not reach into the closed new piece: then it is no candidate of [`Phase::Before`].
    pub(super) fn misses_new(&mut self, ends: [&Near; 2]) -> bool {
        let new = self.members[NEW].piece;
        if !Room::around(ends[0], ends[1]).meets(&new.room) {
            return true;
        }
        if self.arithmetic == Arithmetic::Exact {
            return false;
        }
        let Scratch { hints, near, .. } = &mut *self.scratch;
        let verdict = separate(&new.blocks, ends, usize::from(hints[NEW]), near);
        if let Verdict::Apart(block) = verdict {
            hints[NEW] = u16::try_from(block).expect("a piece has fewer than 2^16 facets");
        }
        verdict != Verdict::Undecided
    }

    /// Looks at a segment that is an edge of one member, or a proper crossing of facets of two: `finders`. Posts what of it is an edge of the
    /// union that `phase` names. One of [`Phase::Before`] does not miss the new piece.
    pub(super) fn look(
        &mut self,
        line: &Line<'a>,
        ends: [Vertex<'a>; 2],
        finders: &[Touch<'a>],
        phase: Phase,
    ) {
        let arithmetic = self.arithmetic;
        let except = [finders[0].member(), finders[finders.len() - 1].member()];
        let rays: SmallVec<[[Sheet<'a>; 2]; 2]> = finders
            .iter()
            .map(|finder| finder.rays(arithmetic, line))
            .collect();
        let mut open: SmallVec<[Interval<'a>; 4]> = SmallVec::new();
        open.push(Interval {
            ends,
            touches: finders.into(),
            next: 0,
            is_in_new: false,
        });
        'intervals: while let Some(mut interval) = open.pop() {
            let mut room = Room::around(&interval.ends[0].near, &interval.ends[1].near);
            while let Some(index) = next_meeting(&self.scratch.rooms, &room, interval.next) {
                interval.next = index + 1;
                if except.contains(&index) {
                    continue;
                }
                let piece = self.members[index].piece;
                let parts = clip(
                    arithmetic,
                    piece,
                    line,
                    [&interval.ends[0], &interval.ends[1]],
                    &mut self.scratch.hints[index],
                    &mut self.scratch.near,
                );
                let is_new = index == NEW;
                let Some(inside) = parts else {
                    if is_new {
                        continue 'intervals;
                    }
                    continue;
                };
                let touch = touch_of(index, piece, &inside);
                if let Some(touch) = touch
                    && !is_new
                {
                    // What lies in a finder adds nothing: no cut, and no piece more.
                    let own = touch.rays(arithmetic, line);
                    let is_idle = finders.iter().any(|finder| {
                        touch.within(arithmetic, line, &own, finder)
                            && (!touch.equal(finder) || self.order(&touch) > self.order(finder))
                    });
                    if is_idle {
                        continue;
                    }
                }
                let Inside { enters, leaves, .. } = inside;
                if !is_new {
                    let outside = [
                        enters.map(|enters| [interval.ends[0], enters]),
                        leaves.map(|leaves| [leaves, interval.ends[1]]),
                    ];
                    for ends in outside.into_iter().flatten() {
                        open.push(Interval {
                            ends,
                            touches: interval.touches.clone(),
                            next: interval.next,
                            is_in_new: interval.is_in_new,
                        });
                    }
                    let Some(touch) = touch else {
                        continue 'intervals;
                    };
                    let mut overruled = finders.iter().zip(&rays).map(|(finder, rays)| {
                        finder.within(arithmetic, line, rays, &touch)
                            && (!touch.equal(finder) || self.order(&touch) < self.order(finder))
                    });
                    if overruled.any(|overruled| overruled) {
                        continue 'intervals;
                    }
                }
                if enters.is_some() || leaves.is_some() {
                    let [tail, head] = interval.ends;
                    interval.ends = [enters.unwrap_or(tail), leaves.unwrap_or(head)];
                    room = Room::around(&interval.ends[0].near, &interval.ends[1].near);
                }
                match touch {
                    Some(touch) => interval.touches.push(touch),
                    None => interval.is_in_new = true,
                }
            }
            self.judge(line, &interval, finders, &rays, phase);
        }
    }

    /// Posts an interval, if it is an edge and these finders are the ones to post it.
    fn judge(
        &mut self,
        line: &Line<'a>,
        interval: &Interval<'a>,
        finders: &[Touch<'a>],
        rays: &[[Sheet<'a>; 2]],
        phase: Phase,
    ) {
        let ends = &interval.ends;
        if interval.touches.len() == finders.len() {
            // Nothing else is around.
            let rays = self.alone(line, finders, rays);
            match phase {
                Phase::After => self.sink.post(line, ends, rays.view(), 1),
                Phase::Before => self.sink.post(line, ends, rays.view(), -1),
            }
            return;
        }
        match phase {
            Phase::After => {
                if let Some(rays) = self.around(line, interval, finders, true) {
                    self.sink.post(line, ends, rays.view(), 1);
                }
            }
            Phase::Before => {
                let before = self.around(line, interval, finders, false);
                // On the boundary of the new piece an edge may stay, or become another.
                let after = (!interval.is_in_new)
                    .then(|| self.around(line, interval, finders, true))
                    .flatten();
                match (before, after) {
                    (Some(before), Some(after)) => {
                        self.sink
                            .exchange(line, ends, [before.view(), after.view()]);
                    }
                    (Some(before), None) => self.sink.post(line, ends, before.view(), -1),
                    (None, Some(after)) => self.sink.post(line, ends, after.view(), 1),
                    (None, None) => {}
                }
            }
        }
    }

    /// The rays of the finders alone: a convex edge, or the concave one where two facets cross.
    fn alone(&self, line: &Line<'a>, finders: &[Touch<'a>], rays: &[[Sheet<'a>; 2]]) -> Rays<'a> {
        let [f, g] = finders else {
            return Rays {
                rays: rays[0].as_slice().into(),
                kind: EdgeKind::Convex,
            };
        };
        let outside = |of: &Touch<'a>, other: &Touch<'a>| {
            let (face, other) = (of.faces()[0], other.faces()[0]);
            of.sheet(face, line.turn(self.arithmetic, other, face))
        };
        Rays {
            rays: SmallVec::from_slice(&[outside(f, g), outside(g, f)]),
            kind: EdgeKind::Concave,
        }
    }

    /// The rays around an interval, with or without the new piece, if these finders are the ones to post it.
    fn around(
        &self,
        line: &Line<'a>,
        interval: &Interval<'a>,
        finders: &[Touch<'a>],
        with_new: bool,
    ) -> Option<Rays<'a>> {
        let touches = interval.touches.iter().copied();
        let touches = touches.filter(|touch| with_new || touch.member() != NEW);
        let order = |touch: &Touch<'a>| self.order(touch);
        let sector = Sector::of(self.arithmetic, line, touches, order);
        let [a, b] = sector.finders(order)?;
        let (f, g) = (finders[0], finders[finders.len() - 1]);
        // An edge is found by one member, a crossing by two.
        let are_these =
            (a == f.member() && b == g.member()) || (a == g.member() && b == f.member());
        are_these.then(|| sector.rays())
    }
}

/// How a piece touches the part of a line that lies in it; none when the part is in its interior.
fn touch_of<'a>(member: usize, piece: &'a Piece, inside: &Inside<'a>) -> Option<Touch<'a>> {
    match *inside.facets.as_slice() {
        [] => None,
        [facet] => Some(Touch::facet(member, facet, piece.face(facet))),
        [a, b] => Some(Touch::edge(member, [a, b], [piece.face(a), piece.face(b)])),
        _ => unreachable!("at most two facets hold a line"),
    }
}

/// How the boundary of a piece goes along an interval that lies in it; none inside.
pub(super) fn touch_along<'a>(
    arithmetic: Arithmetic,
    piece: &'a Piece,
    ends: &[Vertex; 2],
    near: &mut Vec<u16>,
) -> Option<Touch<'a>> {
    if arithmetic == Arithmetic::Filtered {
        let points = [&ends[0].near, &ends[1].near];
        let verdict = separate(&piece.blocks, points, 0, near);
        assert_eq!(verdict, Verdict::Undecided, "the interval lies in it");
    } else {
        let facets = u16::try_from(piece.faces.len()).expect("fewer than 2^16 facets");
        near.clear();
        near.extend(0..facets);
    }
    let holds = |facet: &u16| {
        let face = piece.face(*facet);
        ends.iter().all(|end| exact_side(face, end) == 0)
    };
    near.retain(holds);
    match near[..] {
        [] => None,
        [facet] => Some(Touch::facet(0, facet, piece.face(facet))),
        [a, b] => Some(Touch::edge(0, [a, b], [piece.face(a), piece.face(b)])),
        _ => unreachable!("at most two facets of a convex piece hold a line"),
    }
}
