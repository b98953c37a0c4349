//! The stock: the convex block that bodies are cut from, and how a part is cut to it.
//!
//! ```text
//!    part      stock       piece             a vertex of the piece: a vertex of the part or of the stock,
//!    ____                                    or where three facets' planes meet
//!   |   _|______     ->     _
//!   |__| |      |          |_|               its facets lie in planes of both, so that all predicates
//!      |_|______|                            stay those of planes of lattice solids
//! ```
//! The part is cut by the planes of the stock one after the other. What lies in a plane is decided exactly; a vertex that lies at a lattice
//! point is one there, however it was found, so that equal vertices of two pieces are recognised.

use std::sync::Arc;

use ethnum::I256;
use rustc_hash::FxHashMap;

use crate::geometry::Bounds;
use crate::geometry::convex::{Plane, Solid, VERTICES_MAX, edges_of};

use super::body::sorted;
use super::certify::{Near, Room, Value};
use super::exact::{Homogeneous, cross_wide, dot_wide};
use super::face::{Arithmetic, Corner, Face, Place, Position, Vertex, side};
use super::piece::{Parts, Piece};

/// Most vertices of a stock: 1,024.
pub const STOCK_VERTICES_MAX: usize = 1 << 10;

// The facets of a part, of the stock and of a box together have few enough half-edges for an index of 16 bits: 6 f - 12.
const _: () = assert!(6 * (2 * VERTICES_MAX + 2 * STOCK_VERTICES_MAX + 6) < u16::MAX as usize);

/// A convex block of material, of which bodies remove what they have in common with it.
#[derive(Clone, Debug)]
pub struct Stock {
    solid: Arc<Solid>,
    piece: Arc<Piece>,
}

/// The same vertices, in whatever order.
impl PartialEq for Stock {
    fn eq(&self, other: &Self) -> bool {
        sorted(&self.solid) == sorted(&other.solid)
    }
}

impl Eq for Stock {}

/// A solid has too many vertices for a stock.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("the stock has {count} vertices; the most is {STOCK_VERTICES_MAX}")]
pub struct InvalidStock {
    /// How many there are.
    pub count: usize,
}

impl Stock {
    /// The stock of this form, which may be a box or any other convex solid.
    /// # Errors
    /// [`InvalidStock`] beyond [`STOCK_VERTICES_MAX`].
    pub fn new(solid: Solid) -> Result<Self, InvalidStock> {
        let count = solid.vertices().len();
        if count > STOCK_VERTICES_MAX {
            return Err(InvalidStock { count });
        }
        let piece = Arc::new(Piece::of(&solid));
        let solid = Arc::new(solid);
        Ok(Self { solid, piece })
    }

    /// Its form.
    pub fn solid(&self) -> &Solid {
        &self.solid
    }

    pub(super) fn piece(&self) -> &Arc<Piece> {
        &self.piece
    }

    /// What a part has in common with the stock, prepared; none when that has no volume. O(vertices of the part for each plane of the stock that
    /// meets its box).
    pub(super) fn cut(&self, part: &Solid, arithmetic: Arithmetic) -> Option<Piece> {
        cut(part, &self.piece.faces, arithmetic)
    }
}

/// What is left of a part on the inner sides of some planes, prepared; none when that has no volume.
pub(super) fn cut(part: &Solid, faces: &[Face], arithmetic: Arithmetic) -> Option<Piece> {
    let mut near = Vec::new();
    for (index, face) in (0..).zip(faces) {
        let [least, most] = extremes(&face.plane, &part.bounds());
        if least >= 0 {
            return None;
        }
        if most > 0 {
            near.push(index);
        }
    }
    if near.is_empty() {
        return Some(Piece::of(part));
    }
    let mut cutting = Cutting::of(part, faces, arithmetic);
    for index in near {
        if !cutting.cut_off(part.planes().len() + index) {
            return None;
        }
    }
    Some(cutting.piece())
}

/// The least and the greatest value of a plane in a box.
fn extremes(plane: &Plane, bounds: &Bounds) -> [i128; 2] {
    let mut ends = [plane.offset(); 2];
    for (axis, along) in plane.normal().into_iter().enumerate() {
        let at =
            [bounds.min[axis], bounds.max[axis]].map(|end| i128::from(along) * i128::from(end));
        ends[0] += at[0].min(at[1]);
        ends[1] += at[0].max(at[1]);
    }
    ends
}

/// A solid while it is being cut.
struct Cutting {
    arithmetic: Arithmetic,
    /// Those of the part, then those of the stock.
    faces: Vec<Face>,
    /// Vertices that are, or were, there; `Meeting` names three of the faces.
    corners: Vec<WideCorner>,
    facets: Vec<Facet>,
}

/// A facet in the plane of one of the faces.
struct Facet {
    face: usize,
    /// Counterclockwise from outside.
    sides: Vec<HalfEdge>,
}

#[derive(Clone, Copy)]
struct HalfEdge {
    /// Where it starts.
    tail: usize,
    /// The face across it.
    across: usize,
}

/// As [`Corner`], of more faces than a piece has facets.
#[derive(Clone, Copy)]
struct WideCorner {
    near: Near,
    place: WidePlace,
}

#[derive(Clone, Copy)]
enum WidePlace {
    Lattice([i32; 3]),
    Meeting([usize; 3]),
}

impl Cutting {
    fn of(part: &Solid, stock: &[Face], arithmetic: Arithmetic) -> Self {
        let faces = part.planes().iter().map(Face::of);
        let corners = part.vertices().iter().map(|vertex| {
            let point = vertex.coordinates();
            WideCorner {
                near: Near::lattice(point),
                place: WidePlace::Lattice(point),
            }
        });
        let facets = part.facets().enumerate().map(|(face, facet)| {
            let sides = facet.vertices.iter().zip(facet.across);
            let sides = sides.map(|(tail, across)| HalfEdge {
                tail: usize::from(*tail),
                across: usize::from(*across),
            });
            Facet {
                face,
                sides: sides.collect(),
            }
        });
        Self {
            arithmetic,
            faces: faces.chain(stock.iter().copied()).collect(),
            corners: corners.collect(),
            facets: facets.collect(),
        }
    }

    fn vertex(&self, corner: usize) -> Vertex<'_> {
        let WideCorner { near, place } = self.corners[corner];
        let place = match place {
            WidePlace::Lattice(point) => Place::Lattice(point),
            WidePlace::Meeting(faces) => Place::Meeting(faces.map(|face| &self.faces[face])),
        };
        Vertex { near, place }
    }

    /// Cuts off what is outside of a face; false when nothing with a volume is left.
    fn cut_off(&mut self, face: usize) -> bool {
        let mut sides: Vec<Option<(i32, Value)>> = vec![None; self.corners.len()];
        let (mut above, mut below) = (false, false);
        for half_edge in self.facets.iter().flat_map(|facet| &facet.sides) {
            if sides[half_edge.tail].is_none() {
                let vertex = self.vertex(half_edge.tail);
                let found = side(self.arithmetic, &self.faces[face], &vertex);
                above |= found.0 > 0;
                below |= found.0 < 0;
                sides[half_edge.tail] = Some(found);
            }
        }
        if !(above && below) {
            return below;
        }
        let side_of = |corner: usize| sides[corner].expect("it is a vertex of a facet");
        let mut cuts: FxHashMap<[usize; 2], usize> = FxHashMap::default();
        // By where it starts: the rest of the new facet, whose loop runs against those of the others.
        let mut seam: FxHashMap<usize, HalfEdge> = FxHashMap::default();
        for mut facet in std::mem::take(&mut self.facets) {
            if facet.sides.iter().all(|one| side_of(one.tail).0 >= 0) {
                continue;
            }
            let old = std::mem::take(&mut facet.sides);
            for (index, &HalfEdge { tail, across }) in old.iter().enumerate() {
                let head = old[(index + 1) % old.len()].tail;
                let [(here, value), (there, next_value)] = [side_of(tail), side_of(head)];
                let cut = (here * there < 0).then(|| {
                    // The same from both facets of the edge.
                    let key = [tail.min(head), tail.max(head)];
                    *cuts.entry(key).or_insert_with(|| {
                        let corner = self.meeting(
                            [tail, head],
                            [value, next_value],
                            [facet.face, across, face],
                        );
                        self.corners.push(corner);
                        self.corners.len() - 1
                    })
                });
                let sides = &mut facet.sides;
                match (here, there) {
                    (-1, 1) => {
                        let across = [across, face];
                        let tails = [tail, cut.expect("it crosses")];
                        sides.extend(
                            tails
                                .into_iter()
                                .zip(across)
                                .map(|(tail, across)| HalfEdge { tail, across }),
                        );
                    }
                    (-1, _) | (0, -1) => sides.push(HalfEdge { tail, across }),
                    // Of an edge in the plane the facet beyond is outside, or there is no edge: it is cut off.
                    (0, _) => sides.push(HalfEdge { tail, across: face }),
                    (_, -1) => {
                        let tail = cut.expect("it crosses");
                        sides.push(HalfEdge { tail, across });
                    }
                    _ => {}
                }
            }
            for (index, one) in facet.sides.iter().enumerate() {
                if one.across == face {
                    let next = facet.sides[(index + 1) % facet.sides.len()].tail;
                    let back = HalfEdge {
                        tail: one.tail,
                        across: facet.face,
                    };
                    let twice = seam.insert(next, back);
                    assert!(twice.is_none(), "a vertex of a facet is left once");
                }
            }
            self.facets.push(facet);
        }
        let first = *seam.keys().min().expect("something is cut off");
        let mut sides = Vec::with_capacity(seam.len());
        let mut tail = first;
        loop {
            let HalfEdge { tail: head, across } = seam[&tail];
            sides.push(HalfEdge { tail, across });
            tail = head;
            if tail == first {
                break;
            }
        }
        assert_eq!(sides.len(), seam.len(), "the seam is one loop");
        self.facets.push(Facet { face, sides });
        true
    }

    /// The vertex where an edge between two corners meets a face; the other two faces hold the edge.
    fn meeting(&self, ends: [usize; 2], values: [Value; 2], faces: [usize; 3]) -> WideCorner {
        let [tail, head] = ends.map(|end| &self.corners[end].near);
        let near = Near::crossing([tail, head], &self.faces[faces[2]].rough, values);
        let place = || Homogeneous::meeting(faces.map(|face| &self.faces[face].plane));
        let lattice = match near.nearest_lattice() {
            Ok(nearest) => nearest.filter(|point| place().is_lattice(*point)),
            Err(_) => place().lattice_point(),
        };
        match lattice {
            Some(point) => WideCorner {
                near: Near::lattice(point),
                place: WidePlace::Lattice(point),
            },
            None => WideCorner {
                near,
                place: WidePlace::Meeting(faces),
            },
        }
    }

    /// What is left, prepared.
    fn piece(self) -> Piece {
        let mut facet_of = vec![None; self.faces.len()];
        for (index, facet) in (0_u16..).zip(&self.facets) {
            facet_of[facet.face] = Some(index);
        }
        let mut numbers: Vec<Option<u16>> = vec![None; self.corners.len()];
        let (mut starts, mut loops, mut corners) = (vec![0], Vec::new(), Vec::new());
        for facet in &self.facets {
            for one in &facet.sides {
                let number = *numbers[one.tail].get_or_insert_with(|| {
                    corners.push(self.corner(one.tail, &facet_of));
                    u16::try_from(corners.len() - 1).expect("checked by const assertion")
                });
                loops.push(number);
            }
            starts.push(loops.len());
        }
        let (edges, across) = edges_of(&starts, &loops);
        // Euler's formula: a surface that is closed and in one piece.
        assert_eq!(corners.len() + self.facets.len(), edges.len() + 2);
        let mut room = Room::empty();
        for corner in &corners {
            room.include(&corner.near);
        }
        let small = |number: usize| u16::try_from(number).expect("checked by const assertion");
        Piece::from_parts(Parts {
            corners,
            planes: self
                .facets
                .iter()
                .map(|facet| self.faces[facet.face].plane)
                .collect(),
            edges,
            starts: starts.into_iter().map(small).collect(),
            loops,
            across,
            bounds: room.bounds(),
        })
    }

    /// A corner among the facets that are left.
    fn corner(&self, corner: usize, facet_of: &[Option<u16>]) -> Corner {
        let WideCorner { near, place } = self.corners[corner];
        let position = match place {
            WidePlace::Lattice(point) => Position::Lattice(point),
            WidePlace::Meeting(faces) => match faces.map(|face| facet_of[face]) {
                [Some(a), Some(b), Some(c)] => Position::Meeting([a, b, c]),
                // A facet was cut off, and just this corner is left of it: others meet there.
                _ => Position::Meeting(self.facets_at(corner)),
            },
        };
        Corner { near, position }
    }

    /// Three facets around a corner whose planes meet there only.
    fn facets_at(&self, corner: usize) -> [u16; 3] {
        let facets = (0_u16..).zip(&self.facets);
        let around = facets.filter(|(_, facet)| facet.sides.iter().any(|one| one.tail == corner));
        let around: Vec<(u16, [i64; 3])> = around
            .map(|(index, facet)| (index, self.faces[facet.face].plane.normal()))
            .collect();
        // Any two facets at a vertex have planes that are not parallel, and not all planes hold the line of the first two.
        let [(a, first), (b, second), others @ ..] = &around[..] else {
            unreachable!("at a vertex three facets meet");
        };
        let along = cross_wide(*first, *second);
        let third = others
            .iter()
            .find(|(_, normal)| dot_wide(along, *normal) != I256::ZERO);
        let (c, _) = third.expect("at a vertex three planes meet in a point");
        [*a, *b, *c]
    }
}
