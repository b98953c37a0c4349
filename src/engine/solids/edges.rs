//! The exposed edges of a union, one by one: with exact ends, and with the oriented planes that meet there.
//!
//! ```text
//!   bodies ── cut ──> parts in the order of their places ── witnesses ──> live features
//!   for each part    own live edges, crossings with later parts ── the kernel's candidates ──> intervals ── sheets
//! ```
//! Every interval of an edge is handed out once, with all its sheets. So each edge is there as often in one direction as in the other, and
//! in each oriented plane the sheets' edges are closed loops: the surface is closed without a search for what fits together. An interval is cut
//! where another part touches it in a single point, too, so that no vertex lies between the ends of an interval.

use std::ops::ControlFlow;
use std::sync::Arc;

use rustc_hash::{FxBuildHasher, FxHashMap};
use smallvec::SmallVec;
use std::hash::BuildHasher;

use crate::geometry::Bounds;
use crate::geometry::convex::Plane;

use super::bins::{Bins, meet};
use super::body::{Body, SolidId};
use super::clip::{Line, clip, contact};
use super::exact::Homogeneous;
use super::face::{Arithmetic, Face, Vertex, side};
use super::features::Features;
use super::lines::{Member, Scratch, Sink, touch_along};
use super::marginal::Search;
use super::piece::Piece;
use super::sector::{Boundary, Sheet, Touch};
use super::slots::{Part, Slots, State};
use super::stock::{Stock, cut};
use super::witnesses::Placed;
use super::worker::Worker;
use super::{Cursor, Neighbour, cursor};

/// Parts between two questions whether to go on.
const PARTS_AT_ONCE: usize = 1 << 10;

/// Bytes of prepared pieces that are kept.
const PREPARED_BYTES: usize = 64 << 20;

/// Which surface, and of which stock.
#[derive(Clone, Copy, Debug)]
pub enum Surface<'s> {
    /// Of the union of the bodies.
    Union,
    /// Of what they remove from a stock.
    Removed(&'s Stock),
    /// Of what remains of a stock.
    Remaining(&'s Stock),
}

/// A side of an oriented plane at an edge.
#[derive(Clone, Copy, Debug)]
pub struct Side {
    /// The plane, outwards.
    pub plane: Plane,
    /// Whether the surface is to the left of the edge, seen from outside.
    pub is_left: bool,
    /// The body, or one of those, that the plane comes from; none for a plane of the stock alone.
    pub body: Option<SolidId>,
    /// With which part the last edge of this plane comes.
    pub last: u32,
}

/// What is handed out.
#[derive(Clone, Copy, Debug)]
pub enum Listed<'l> {
    /// An edge, from end to end, and the surface there.
    Edge([Homogeneous; 2], &'l [Side]),
    /// All edges of planes whose last part this is, or one before, have been handed out.
    Part(u32),
}

/// Bodies, ready to have their edges listed.
#[derive(Debug)]
pub struct Edges {
    bodies: FxHashMap<Cursor, (SolidId, Body)>,
    slots: Slots,
    bins: Bins,
    /// How many parts have something of the surface's space.
    parts: u32,
    /// By a hash of the plane: the last part that an edge in it can come with.
    last: FxHashMap<u64, u32>,
    /// What the bodies are cut from, for what remains of it.
    material: Option<Arc<Piece>>,
    /// What parts are cut by: planes of the stock, and of the box.
    cuts: Vec<Face>,
    /// Where the surface is open: planes of the box.
    open: Vec<Plane>,
    worker: Worker,
    scratch: Scratch,
}

/// A part of an edge of the union, before it is handed out.
struct Interval<'a> {
    line: Line<'a>,
    ends: [Vertex<'a>; 2],
    rays: SmallVec<[Sheet<'a>; 4]>,
}

/// Keeps what is posted.
#[derive(Default)]
struct Found<'a>(Vec<Interval<'a>>);

impl<'a> Sink<'a> for Found<'a> {
    fn post(
        &mut self,
        line: &Line<'a>,
        ends: &[Vertex<'a>; 2],
        rays: Boundary<'_, 'a>,
        weight: i8,
    ) {
        assert_eq!(weight, 1, "only edges of the whole union are looked for");
        self.0.push(Interval {
            line: *line,
            ends: *ends,
            rays: rays.rays.into(),
        });
    }

    fn exchange(&mut self, _: &Line<'a>, _: &[Vertex<'a>; 2], _: [Boundary<'_, 'a>; 2]) {
        unreachable!("only edges of the whole union are looked for");
    }
}

impl Edges {
    /// Of these bodies, as far as they lie in a closed box of lattice points and half a step around it, where there is one. The surface is open
    /// there: no facet of a lattice solid lies in such a plane. O(bodies), each in its neighbourhood. None when `goes_on`, which is asked now and then, says no.
    pub fn of(
        surface: Surface,
        within: Option<Bounds>,
        bodies: impl Iterator<Item = (SolidId, Body)>,
        goes_on: &dyn Fn() -> bool,
    ) -> Option<Self> {
        let arithmetic = Arithmetic::Filtered;
        let of_box = within.iter().flat_map(planes_around);
        let of_box: Vec<Face> = of_box.map(|plane| Face::of(&plane)).collect();
        let stock = match surface {
            Surface::Union => None,
            Surface::Removed(stock) | Surface::Remaining(stock) => Some(stock),
        };
        let material = match surface {
            Surface::Remaining(stock) => cut(stock.solid(), &of_box, arithmetic).map(Arc::new),
            _ => None,
        };
        let of_stock = stock.iter().flat_map(|stock| &stock.piece().faces);
        let mut edges = Self {
            bodies: FxHashMap::default(),
            slots: Slots::new(PREPARED_BYTES),
            bins: Bins::new(),
            parts: 0,
            last: FxHashMap::default(),
            material,
            cuts: of_stock.chain(&of_box).copied().collect(),
            open: of_box.iter().map(|face| face.plane).collect(),
            worker: Worker::new(arithmetic, None),
            scratch: Scratch::default(),
        };
        edges.enter(within, bodies, goes_on)?;
        edges.testify(goes_on)?;
        for face in edges.material.iter().flat_map(|piece| &piece.faces) {
            edges.last.insert(hash(&face.plane), u32::MAX);
        }
        Some(edges)
    }

    /// Enters all parts, neighbours near each other.
    fn enter(
        &mut self,
        within: Option<Bounds>,
        bodies: impl Iterator<Item = (SolidId, Body)>,
        goes_on: &dyn Fn() -> bool,
    ) -> Option<()> {
        let mut places = Vec::new();
        for (id, body) in bodies {
            let mut is_near = false;
            for index in 0..body.len() {
                let bounds = body.part_bounds(index);
                if within.is_none_or(|within| meet(&within, &bounds)) {
                    let index = u32::try_from(index).expect("a body has few parts");
                    places.push((place(&bounds), id, index));
                    is_near = true;
                }
            }
            if is_near {
                self.bodies.insert(cursor(id), (id, body));
            }
        }
        places.sort_unstable();
        for (number, (_, id, index)) in places.into_iter().enumerate() {
            if number % PARTS_AT_ONCE == 0 && !goes_on() {
                return None;
            }
            let part = Part {
                body: cursor(id),
                index,
            };
            if let Some(piece) = prepare(&self.bodies, &self.cuts, part) {
                let bounds = piece.bounds();
                let slot = self.slots.insert(part, Some(Arc::new(piece)));
                self.bins.insert(slot, bounds);
                self.parts = slot + 1;
                self.slots.tidy();
            }
        }
        Some(())
    }

    /// Finds the live features of all parts, and with which part each plane is complete.
    fn testify(&mut self, goes_on: &dyn Fn() -> bool) -> Option<()> {
        for slot in 0..self.parts {
            if slot as usize % PARTS_AT_ONCE == 0 && !goes_on() {
                return None;
            }
            let piece = self.piece(slot);
            let neighbours = self.gather(&piece, slot);
            let mut features = Features::live(piece.edges.len(), piece.faces.len());
            let own = Placed {
                piece: &piece,
                slot,
            };
            let others = neighbours.iter().map(Neighbour::placed);
            self.worker.testify_all(own, &mut features, others);
            // What has an edge in a plane of this part touches the part.
            let last = neighbours.iter().map(|other| other.slot).max();
            let last = last.map_or(slot, |last| last.max(slot));
            for facet in features.live_facets() {
                let key = hash(&piece.face(facet).plane);
                let known = self.last.entry(key).or_insert(last);
                *known = last.max(*known);
            }
            self.slots.set_state(slot, State::Exposed(features));
            self.slots.tidy();
        }
        Some(())
    }

    /// The prepared piece of a part.
    fn piece(&mut self, slot: u32) -> Arc<Piece> {
        let (bodies, cuts) = (&self.bodies, &self.cuts);
        self.slots.piece(slot, |part| {
            Arc::new(prepare(bodies, cuts, part).expect("it was there when it was entered"))
        })
    }

    /// The parts that may touch a piece, nearest first.
    fn gather(&mut self, piece: &Piece, except: u32) -> Vec<Neighbour> {
        let around = self.bins.nearest(&piece.bounds(), except);
        let mut neighbours = Vec::with_capacity(around.len());
        for slot in around {
            let other = self.piece(slot);
            if !piece.is_apart(&other) {
                neighbours.push(Neighbour { slot, piece: other });
            }
        }
        neighbours
    }

    /// Hands out all edges, until the sink breaks. O(parts), each in its neighbourhood.
    pub fn each(&mut self, sink: &mut dyn FnMut(Listed) -> ControlFlow<()>) -> ControlFlow<()> {
        for slot in 0..self.parts {
            let features = self.slots.features(slot);
            let is_idle =
                features.live_edges().next().is_none() && features.live_facets().next().is_none();
            if !is_idle {
                self.each_of(slot, sink)?;
                self.slots.tidy();
            }
            sink(Listed::Part(slot))?;
        }
        self.each_bare(sink)?;
        sink(Listed::Part(u32::MAX))
    }

    /// Hands out the edges that a part is to find.
    fn each_of(
        &mut self,
        slot: u32,
        sink: &mut dyn FnMut(Listed) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        let piece = self.piece(slot);
        let neighbours = self.gather(&piece, slot);
        let own = Neighbour { slot, piece };
        let members: Vec<Member> = std::iter::once(&own)
            .chain(&neighbours)
            .map(|one| Member {
                piece: &one.piece,
                features: self.slots.features(one.slot),
                slot: one.slot,
            })
            .collect();
        let arithmetic = self.worker.arithmetic;
        let mut found = Found::default();
        let mut search = Search::new(arithmetic, &members, &mut self.scratch, &mut found);
        search.own_edges();
        search.crossings_with_later();
        let body_of = |member: u32| {
            let slot = members[member as usize].slot;
            self.bodies[&self.slots.part(slot).body].0
        };
        let mut near = Vec::new();
        for interval in &found.0 {
            let sides = self.sides(interval, &body_of, &mut near);
            if sides.is_empty() {
                continue;
            }
            let pieces = members.iter().map(|member| member.piece);
            let points = split(
                arithmetic,
                &interval.line,
                &interval.ends,
                pieces,
                &mut near,
            );
            hand_out(&points, &sides, sink)?;
        }
        ControlFlow::Continue(())
    }

    /// The sides of the surface along an interval.
    fn sides(
        &self,
        interval: &Interval,
        body_of: &dyn Fn(u32) -> SolidId,
        near: &mut Vec<u16>,
    ) -> SmallVec<[Side; 4]> {
        let Interval { line, ends, rays } = interval;
        let of_union = |ray: &Sheet| (ray.face.plane, ray.side, Some(body_of(ray.member)));
        let turned = |ray: &Sheet| {
            let (plane, side, body) = of_union(ray);
            (plane.opposite(), -side, body)
        };
        let arithmetic = self.worker.arithmetic;
        let around = self.material.as_ref().map(|material| {
            let touch = touch_along(arithmetic, material, ends, near);
            touch.map(|touch| touch.rays(arithmetic, line))
        });
        match around {
            None => self.exposed(rays.iter().map(of_union)),
            Some(None) => self.exposed(rays.iter().map(turned)),
            Some(Some(own)) => {
                let rays = Boundary {
                    rays,
                    kind: crate::geometry::EdgeKind::Convex,
                };
                let rest = rays.rest_rays(&own);
                self.exposed(rest.iter().map(|(ray, way)| match way {
                    1 => (ray.face.plane, ray.side, None),
                    _ => turned(ray),
                }))
            }
        }
    }

    /// Those of some rays that are no flat ones, and not where the surface is open.
    fn exposed(
        &self,
        rays: impl Iterator<Item = (Plane, i32, Option<SolidId>)>,
    ) -> SmallVec<[Side; 4]> {
        let rays: SmallVec<[(Plane, i32, Option<SolidId>); 8]> = rays.collect();
        let is_flat = |(plane, side, _): &(Plane, i32, _)| {
            let goes_on = |other: &(Plane, i32, _)| other.0 == *plane && other.1 == -side;
            rays.iter().any(goes_on)
        };
        let is_open =
            |plane: &Plane| self.open.contains(plane) || self.open.contains(&plane.opposite());
        let rays = rays.iter().filter(|ray| !is_flat(ray) && !is_open(&ray.0));
        rays.map(|&(plane, side, body)| Side {
            plane,
            is_left: side > 0,
            body,
            last: self.last.get(&hash(&plane)).copied().unwrap_or(u32::MAX),
        })
        .collect()
    }

    /// Hands out the edges of the material, where it is bare.
    fn each_bare(&mut self, sink: &mut dyn FnMut(Listed) -> ControlFlow<()>) -> ControlFlow<()> {
        let Some(material) = self.material.clone() else {
            return ControlFlow::Continue(());
        };
        let arithmetic = self.worker.arithmetic;
        let mut near = Vec::new();
        for edge in &material.edges {
            let faces = [material.face(edge.left), material.face(edge.right)];
            let ends = [edge.tail, edge.head].map(|vertex| material.vertex(vertex));
            let line = Line::along(faces);
            let mut room = super::certify::Room::empty();
            ends.iter().for_each(|end| room.include(&end.near));
            let mut pieces = Vec::new();
            for slot in self.bins.nearest(&room.bounds(), u32::MAX) {
                let piece = self.piece(slot);
                let both = [&ends[0], &ends[1]];
                let is_in = clip(arithmetic, &piece, &line, both, &mut 0, &mut near).is_some();
                if is_in || contact(arithmetic, &piece, &line, both, &mut near).is_some() {
                    pieces.push(piece);
                }
                self.slots.tidy();
            }
            let touch = Touch::edge(0, [edge.left, edge.right], faces);
            let rays = touch.rays(arithmetic, &line);
            let sides = self.exposed(rays.iter().map(|ray| (ray.face.plane, ray.side, None)));
            if sides.is_empty() {
                continue;
            }
            for ends in bare(arithmetic, &line, ends, &pieces, &mut near) {
                let pieces = pieces.iter().map(|piece| &**piece);
                let points = split(arithmetic, &line, &ends, pieces, &mut near);
                hand_out(&points, &sides, sink)?;
            }
        }
        ControlFlow::Continue(())
    }
}

/// The intervals of a segment that are in no piece, but for single points.
fn bare<'a>(
    arithmetic: Arithmetic,
    line: &Line<'a>,
    ends: [Vertex<'a>; 2],
    pieces: &'a [Arc<Piece>],
    near: &mut Vec<u16>,
) -> Vec<[Vertex<'a>; 2]> {
    let mut open = vec![ends];
    for piece in pieces {
        let mut left = Vec::with_capacity(open.len() + 1);
        for ends in open {
            let both = [&ends[0], &ends[1]];
            match clip(arithmetic, piece, line, both, &mut 0, near) {
                None => left.push(ends),
                Some(inside) => {
                    left.extend(inside.enters.map(|enters| [ends[0], enters]));
                    left.extend(inside.leaves.map(|leaves| [leaves, ends[1]]));
                }
            }
        }
        open = left;
    }
    open
}

/// The ends of an interval, and in order between them the points where pieces touch it.
fn split<'a>(
    arithmetic: Arithmetic,
    line: &Line<'a>,
    ends: &[Vertex<'a>; 2],
    pieces: impl Iterator<Item = &'a Piece>,
    near: &mut Vec<u16>,
) -> SmallVec<[Vertex<'a>; 4]> {
    let room = super::certify::Room::around(&ends[0].near, &ends[1].near);
    let mut points: SmallVec<[Vertex<'a>; 4]> = SmallVec::new();
    points.push(ends[0]);
    for piece in pieces.filter(|piece| piece.room.meets(&room)) {
        let Some(point) = contact(arithmetic, piece, line, [&ends[0], &ends[1]], near) else {
            continue;
        };
        // A plane through the new point tells the others' places along the line.
        let face = point.crossing_face();
        let way = side(arithmetic, face, &ends[1]).0;
        let places = points
            .iter()
            .map(|other| way * side(arithmetic, face, other).0);
        let places: SmallVec<[i32; 4]> = places.collect();
        if !places.contains(&0) {
            let before = places.iter().filter(|place| **place < 0).count();
            points.insert(before, point);
        }
    }
    points.push(ends[1]);
    points
}

fn hand_out(
    points: &[Vertex],
    sides: &[Side],
    sink: &mut dyn FnMut(Listed) -> ControlFlow<()>,
) -> ControlFlow<()> {
    for ends in points.windows(2) {
        let ends = [ends[0].homogeneous(), ends[1].homogeneous()];
        sink(Listed::Edge(ends, sides))?;
    }
    ControlFlow::Continue(())
}

/// A part, as far as it lies on the inner side of all cuts.
fn prepare(
    bodies: &FxHashMap<Cursor, (SolidId, Body)>,
    cuts: &[Face],
    part: Part,
) -> Option<Piece> {
    let index = usize::try_from(part.index).expect("a body has few parts");
    let solid = bodies[&part.body].1.part(index);
    cut(&solid, cuts, Arithmetic::Filtered)
}

/// The planes half a step around a box.
fn planes_around(bounds: &Bounds) -> [Plane; 6] {
    let Bounds { min, max } = *bounds;
    std::array::from_fn(|index| {
        let axis = index / 2;
        match index % 2 {
            0 => Plane::half_step_beyond(axis, min[axis], -1),
            _ => Plane::half_step_beyond(axis, max[axis], 1),
        }
    })
}

/// The same for a plane and its opposite.
fn hash(plane: &Plane) -> u64 {
    FxBuildHasher.hash_one(plane.min(&plane.opposite()))
}

/// Where a box is in an order in which neighbours are near each other: the bits of its middle's coordinates in turn.
fn place(bounds: &Bounds) -> u128 {
    let middle = |axis: usize| {
        let sum = i64::from(bounds.min[axis]) + i64::from(bounds.max[axis]);
        (sum - 2 * i64::from(i32::MIN)).cast_unsigned() / 2
    };
    let middle = [middle(0), middle(1), middle(2)];
    let mut place = 0;
    for bit in (0..32).rev() {
        for coordinate in middle {
            place = place << 1 | u128::from(coordinate >> bit & 1);
        }
    }
    place
}
