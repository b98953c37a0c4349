//! The exposed edges of a union, one by one: with exact ends, and with the oriented planes that meet there.
//!
//! ```text
//!   bodies ── cut ──> parts in the order of their places ── witnesses ──> live features
//!   for each part    own live edges, crossings with later parts ── the kernel's candidates ──> intervals ── sheets
//! ```
//! Every interval of an edge is handed out once, with all its sheets. So each edge is there as often in one direction as in the other, and
//! in each oriented plane the sheets' edges are closed loops: the surface is closed without a search for what fits together. An interval is cut
//! where another part touches it in a single point, too, so that no vertex lies between the ends of an interval.

use std::hash::BuildHasher;
use std::num::NonZero;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::thread::available_parallelism;

use rustc_hash::{FxBuildHasher, FxHashMap};
use smallvec::SmallVec;

use crate::geometry::Bounds;
use crate::geometry::convex::Plane;

use super::super::parallel::map_in_parallel;
use super::bins::{Bins, meet};
use super::body::{Body, SolidId};
use super::certify::Room;
use super::clip::{Line, clip, contact};
use super::exact::Homogeneous;
use super::face::{Arithmetic, Face, Vertex, side};
use super::features::Features;
use super::lanes::{Rooms, next_meeting};
use super::lines::{Member, Scratch, Sink, touch_along};
use super::marginal::Search;
use super::piece::Piece;
use super::sector::{Boundary, Sheet, Touch, rest_rays};
use super::slots::{Part, Slots, State};
use super::stock::{Stock, cut};
use super::worker::Worker;
use super::{Cursor, Neighbour, cursor};

/// Parts that are looked at together, on several threads; between two questions whether to go on.
const BATCH: usize = 1 << 8;

/// The same, by the bytes of their pieces.
const BATCH_BYTES: usize = 2 << 20;

/// Parts that a thread takes at a time.
const PARTS_AT_ONCE: usize = 8;

const ARITHMETIC: Arithmetic = Arithmetic::Filtered;

/// Bytes of prepared pieces that are kept.
const PREPARED_BYTES: usize = 32 << 20;

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
    Edge(&'l [Homogeneous; 2], &'l [Side]),
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
    /// One for each thread.
    finders: Vec<Finder>,
}

/// What one thread needs.
#[derive(Debug)]
struct Finder {
    worker: Worker,
    scratch: Scratch,
    near: Vec<u16>,
}

impl Finder {
    fn new() -> Self {
        Self {
            worker: Worker::new(ARITHMETIC, None),
            scratch: Scratch::default(),
            near: Vec::new(),
        }
    }
}

/// A part, and those whose boxes meet its own, nearest first.
struct Group {
    own: Neighbour,
    around: Vec<Neighbour>,
}

impl Group {
    /// Those that may touch the part.
    fn neighbours(&self) -> impl Iterator<Item = &Neighbour> {
        let touches = |other: &&Neighbour| !self.own.piece.is_apart(&other.piece);
        self.around.iter().filter(touches)
    }
}

/// An edge and the surface there, before it is handed out.
struct Edge {
    ends: [Homogeneous; 2],
    sides: SmallVec<[Side; 2]>,
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
    /// there: no facet of a lattice solid lies in such a plane. O(bodies), each in its neighbourhood, on several threads. None when `goes_on`,
    /// which is asked now and then, says no.
    pub fn of(
        surface: Surface,
        within: Option<Bounds>,
        bodies: impl Iterator<Item = (SolidId, Body)>,
        goes_on: &dyn Fn() -> bool,
    ) -> Option<Self> {
        let of_box = within.iter().flat_map(planes_around);
        let of_box: Vec<Face> = of_box.map(|plane| Face::of(&plane)).collect();
        let stock = match surface {
            Surface::Union => None,
            Surface::Removed(stock) | Surface::Remaining(stock) => Some(stock),
        };
        let material = match surface {
            Surface::Remaining(stock) => cut(stock.solid(), &of_box, ARITHMETIC).map(Arc::new),
            _ => None,
        };
        let threads = available_parallelism().map_or(1, NonZero::get);
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
            finders: (0..threads).map(|_| Finder::new()).collect(),
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
        let parts = places.into_iter().map(|(_, id, index)| Part {
            body: cursor(id),
            index,
        });
        let parts: Vec<Part> = parts.collect();
        for parts in parts.chunks(BATCH) {
            if !goes_on() {
                return None;
            }
            let pieces = self.in_parallel(parts.len(), |edges, _, number| {
                prepare(&edges.bodies, &edges.cuts, parts[number])
            });
            for (part, piece) in parts.iter().zip(pieces) {
                let Some(piece) = piece else { continue };
                let bounds = piece.bounds();
                let slot = self.slots.insert(*part, Some(Arc::new(piece)));
                self.bins.insert(slot, bounds);
                self.parts = slot + 1;
            }
            self.slots.tidy();
        }
        Some(())
    }

    /// Finds the live features of all parts, and with which part each plane is complete.
    fn testify(&mut self, goes_on: &dyn Fn() -> bool) -> Option<()> {
        let mut next = 0;
        while next < self.parts {
            if !goes_on() {
                return None;
            }
            let groups = self.batch(&mut next, |_| true);
            let found = self.in_parallel(groups.len(), |_, finder, number| {
                let group = &groups[number];
                let Neighbour { slot, piece } = &group.own;
                let mut features = Features::live(piece.edges.len(), piece.faces.len());
                let neighbours: Vec<&Neighbour> = group.neighbours().collect();
                let others = neighbours.iter().map(|other| other.placed());
                let own = group.own.placed();
                finder.worker.testify_all(own, &mut features, others);
                // What has an edge in a plane of this part touches the part.
                let last = neighbours.iter().map(|other| other.slot).max();
                (features, last.map_or(*slot, |last| last.max(*slot)))
            });
            for (Group { own, .. }, (features, last)) in groups.iter().zip(found) {
                for facet in features.live_facets() {
                    let key = hash(&own.piece.face(facet).plane);
                    let known = self.last.entry(key).or_insert(last);
                    *known = last.max(*known);
                }
                self.slots.set_state(own.slot, State::Exposed(features));
            }
            self.slots.tidy();
        }
        Some(())
    }

    /// Parts from one on that are to be looked at, and what is around each; the next one is that after them.
    fn batch(&mut self, next: &mut u32, is_wanted: impl Fn(&Features) -> bool) -> Vec<Group> {
        let mut groups = Vec::with_capacity(BATCH);
        let mut bytes = 0;
        while *next < self.parts && groups.len() < BATCH && bytes < BATCH_BYTES {
            let slot = *next;
            *next += 1;
            if matches!(self.slots.state(slot), State::Exposed(features) if !is_wanted(features)) {
                continue;
            }
            let piece = self.piece(slot);
            bytes += piece.size();
            let around = self.bins.nearest(&piece.bounds(), slot).into_iter();
            let around = around.map(|slot| Neighbour {
                slot,
                piece: self.piece(slot),
            });
            groups.push(Group {
                around: around.collect(),
                own: Neighbour { slot, piece },
            });
        }
        groups
    }

    /// Runs a task for so many numbers, on several threads; the results in their order.
    fn in_parallel<T: Send>(
        &mut self,
        count: usize,
        task: impl Fn(&Self, &mut Finder, usize) -> T + Sync,
    ) -> Vec<T> {
        let mut finders = std::mem::take(&mut self.finders);
        let results = map_in_parallel(&mut finders, count, PARTS_AT_ONCE, |finder, number| {
            task(self, finder, number)
        });
        self.finders = finders;
        results
    }

    /// The prepared piece of a part.
    fn piece(&mut self, slot: u32) -> Arc<Piece> {
        let (bodies, cuts) = (&self.bodies, &self.cuts);
        self.slots.piece(slot, |part| {
            Arc::new(prepare(bodies, cuts, part).expect("it was there when it was entered"))
        })
    }

    /// Hands out all edges, until the sink breaks; some parts at a time on several threads. O(parts), each in its neighbourhood.
    pub fn each(&mut self, sink: &mut dyn FnMut(Listed) -> ControlFlow<()>) -> ControlFlow<()> {
        let is_live = |features: &Features| {
            features.live_edges().next().is_some() || features.live_facets().next().is_some()
        };
        let mut next = 0;
        while next < self.parts {
            let groups = self.batch(&mut next, is_live);
            let found = self.in_parallel(groups.len(), |edges, finder, number| {
                edges.found_by(&groups[number], finder)
            });
            for (group, found) in groups.iter().zip(found) {
                for Edge { ends, sides } in &found {
                    sink(Listed::Edge(ends, sides))?;
                }
                sink(Listed::Part(group.own.slot))?;
            }
            self.slots.tidy();
            sink(Listed::Part(next - 1))?;
        }
        self.each_bare(sink)?;
        sink(Listed::Part(u32::MAX))
    }

    /// The edges that a part is to find.
    fn found_by(&self, group: &Group, finder: &mut Finder) -> Vec<Edge> {
        let members: Vec<Member> = std::iter::once(&group.own)
            .chain(group.neighbours())
            .map(|one| Member {
                piece: &one.piece,
                features: self.slots.features(one.slot),
                slot: one.slot,
            })
            .collect();
        let mut found = Found::default();
        let mut search = Search::new(ARITHMETIC, &members, &mut finder.scratch, &mut found);
        search.own_edges();
        search.crossings_with_later();
        let body_of = |member: u32| {
            let slot = members[member as usize].slot;
            self.bodies[&self.slots.part(slot).body].0
        };
        let pieces = members.iter().map(|member| member.piece);
        let mut around = Around::new(pieces, &finder.scratch.rooms);
        let near = &mut finder.near;
        let mut edges = Vec::with_capacity(found.0.len());
        for interval in &found.0 {
            let sides = self.sides(interval, &body_of, near);
            if !sides.is_empty() {
                let Interval { line, ends, .. } = interval;
                let points = split(line, ends, &mut around, near);
                enter(&points, &sides, &mut edges);
            }
        }
        edges
    }

    /// The sides of the surface along an interval.
    fn sides(
        &self,
        interval: &Interval,
        body_of: &dyn Fn(u32) -> SolidId,
        near: &mut Vec<u16>,
    ) -> SmallVec<[Side; 2]> {
        let Interval { line, ends, rays } = interval;
        let of_union = |ray: &Sheet| (ray.face.plane, ray.side, Some(body_of(ray.member)));
        let turned = |ray: &Sheet| {
            let (plane, side, body) = of_union(ray);
            (plane.opposite(), -side, body)
        };
        let around = self.material.as_ref().map(|material| {
            let touch = touch_along(ARITHMETIC, material, ends, near);
            touch.map(|touch| touch.rays(ARITHMETIC, line))
        });
        match around {
            None => self.exposed(rays.iter().map(of_union)),
            Some(None) => self.exposed(rays.iter().map(turned)),
            Some(Some(own)) => {
                let rest = rest_rays(rays, &own);
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
    ) -> SmallVec<[Side; 2]> {
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
        let mut near = Vec::new();
        for edge in &material.edges {
            let faces = [material.face(edge.left), material.face(edge.right)];
            let ends = [edge.tail, edge.head].map(|vertex| material.vertex(vertex));
            let line = Line::along(faces);
            let room = Room::around(&ends[0].near, &ends[1].near);
            let mut pieces = Vec::new();
            for slot in self.bins.nearest(&room.bounds(), u32::MAX) {
                let piece = self.piece(slot);
                let both = [&ends[0], &ends[1]];
                let is_in = clip(ARITHMETIC, &piece, &line, both, &mut 0, &mut near).is_some();
                if is_in || contact(ARITHMETIC, &piece, &line, both, &mut 0, &mut near).is_some() {
                    pieces.push(piece);
                }
                self.slots.tidy();
            }
            let touch = Touch::edge(0, [edge.left, edge.right], faces);
            let rays = touch.rays(ARITHMETIC, &line);
            let sides = self.exposed(rays.iter().map(|ray| (ray.face.plane, ray.side, None)));
            if sides.is_empty() {
                continue;
            }
            let mut rooms = Vec::new();
            Rooms::of(pieces.iter().map(|piece| piece.room), &mut rooms);
            let mut around = Around::new(pieces.iter().map(|piece| &**piece), &rooms);
            let mut edges = Vec::new();
            for ends in bare(&line, ends, &pieces, &mut near) {
                let points = split(&line, &ends, &mut around, &mut near);
                enter(&points, &sides, &mut edges);
            }
            for Edge { ends, sides } in &edges {
                sink(Listed::Edge(ends, sides))?;
            }
        }
        ControlFlow::Continue(())
    }
}

/// The intervals of a segment that are in no piece, but for single points.
fn bare<'a>(
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
            match clip(ARITHMETIC, piece, line, both, &mut 0, near) {
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

/// Pieces that may touch an interval.
struct Around<'a, 'w> {
    pieces: Vec<&'a Piece>,
    rooms: &'w [Rooms],
    /// For each piece the block of planes that separated last.
    firsts: Vec<u16>,
}

impl<'a, 'w> Around<'a, 'w> {
    fn new(pieces: impl Iterator<Item = &'a Piece>, rooms: &'w [Rooms]) -> Self {
        let pieces: Vec<&Piece> = pieces.collect();
        Self {
            firsts: vec![0; pieces.len()],
            pieces,
            rooms,
        }
    }
}

/// The ends of an interval, and in order between them the points where pieces touch it.
fn split<'a>(
    line: &Line<'a>,
    ends: &[Vertex<'a>; 2],
    around: &mut Around<'a, '_>,
    near: &mut Vec<u16>,
) -> SmallVec<[Vertex<'a>; 4]> {
    let room = Room::around(&ends[0].near, &ends[1].near);
    let mut points: SmallVec<[Vertex<'a>; 4]> = SmallVec::new();
    points.push(ends[0]);
    let mut next = 0;
    while let Some(index) = next_meeting(around.rooms, &room, next) {
        next = index + 1;
        let (piece, first) = (around.pieces[index], &mut around.firsts[index]);
        let both = [&ends[0], &ends[1]];
        let Some(point) = contact(ARITHMETIC, piece, line, both, first, near) else {
            continue;
        };
        // A plane through the new point tells the others' places along the line.
        let face = point.crossing_face();
        let way = side(ARITHMETIC, face, &ends[1]).0;
        let places = points
            .iter()
            .map(|other| way * side(ARITHMETIC, face, other).0);
        let places: SmallVec<[i32; 4]> = places.collect();
        if !places.contains(&0) {
            let before = places.iter().filter(|place| **place < 0).count();
            points.insert(before, point);
        }
    }
    points.push(ends[1]);
    points
}

/// Enters the parts of an interval.
fn enter(points: &[Vertex], sides: &SmallVec<[Side; 2]>, edges: &mut Vec<Edge>) {
    edges.extend(points.windows(2).map(|ends| Edge {
        ends: [ends[0].homogeneous(), ends[1].homogeneous()],
        sides: sides.clone(),
    }));
}

/// A part, as far as it lies on the inner side of all cuts.
fn prepare(
    bodies: &FxHashMap<Cursor, (SolidId, Body)>,
    cuts: &[Face],
    part: Part,
) -> Option<Piece> {
    let index = usize::try_from(part.index).expect("a body has few parts");
    let solid = bodies[&part.body].1.part(index);
    cut(&solid, cuts, ARITHMETIC)
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
