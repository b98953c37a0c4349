//! The exposed faces of a union of cubes, plane by plane: exact polygons in integers, closed and conforming.
//!
//! ```text
//!   cubes sorted along an axis ── plane by plane ──> faces that lie in it, cubes that cross it near them
//!     └─ each line of the plane that carries edges of squares ── sweep ──> what fills the four quadrants around it, by intervals
//!          └─ an interval of one pattern ──> an edge, or none, of what is exposed upward, and of what is exposed downward
//! ```
//! Edges of the union lie on such lines only, and a vertex that lies on an edge changes the pattern of the four quadrants around it. So the
//! two planes that meet in a line cut it at the same points, each for itself, and the faces of all planes together are closed. Edges between
//! coplanar pieces are none: both quadrants on one side are full, and both on the other empty.

use std::ops::{ControlFlow, Range};

use crate::geometry::{Bounds, CubeId, Edge, Place, Stock};

/// How many planes are listed between two questions whether to go on.
const PLANES_AT_ONCE: usize = 256;

/// Most buckets of the squares that cross a plane.
const BUCKETS_MAX: usize = 1 << 18;

/// Below this many squares in a plane all are looked at for each line.
const FEW_SQUARES: usize = 24;

/// Which points are material.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Material {
    /// Those of the union.
    Union,
    /// Those of the union inside a stock.
    Removed(Stock),
    /// Those of a stock outside the union.
    Remaining(Stock),
}

/// What is exposed in one oriented plane.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct PlaneFace<'a> {
    /// The axis that the plane is normal to: 0 for x, 1 for y, 2 for z.
    pub axis: usize,
    /// Whether the outward normal points along the axis, or against it.
    pub is_upward: bool,
    /// Where the plane cuts the axis. Units: steps.
    pub at: i32,
    /// The cube of least id among those that are known to have some of it; none on a side of the stock.
    pub body: Option<CubeId>,
    /// Edges from the first to the second end, the face to their left as seen from outside; each end on the two axes that follow. Units:
    /// half steps.
    pub edges: &'a [[[i64; 2]; 2]],
}

/// Takes faces one by one, and may end the listing.
pub type PlaneSink<'a> = dyn FnMut(&PlaneFace<'_>) -> ControlFlow<()> + 'a;

/// Lists the faces of a material that cubes of one edge make, each oriented plane once. O(cubes, each in its neighbourhood).
///
/// `within` keeps what lies in a closed box of lattice points and half a step around it, exactly cut there: no face is half-way between
/// lattice points. The surface is open there. `goes_on` is asked now and then; a listing that it or the sink ends is a break.
pub fn faces(
    cubes: impl Iterator<Item = (CubeId, Place)>,
    edge: Edge,
    material: Material,
    within: Option<Bounds>,
    goes_on: &dyn Fn() -> bool,
    sink: &mut PlaneSink,
) -> ControlFlow<()> {
    let steps = edge.steps();
    let (stock, is_complement) = match material {
        Material::Union => (None, false),
        Material::Removed(stock) => (Some(stock.bounds()), false),
        Material::Remaining(stock) => (Some(stock.bounds()), true),
    };
    let touches = |corner: &[i32; 3], bounds: &Bounds| {
        (0..3).all(|axis| {
            corner[axis] <= bounds.max[axis] && corner[axis] + steps >= bounds.min[axis]
        })
    };
    let boxes = [stock, within];
    let mut near: Vec<([i32; 3], CubeId)> = cubes
        .map(|(id, place)| (place.corner(), id))
        .filter(|(corner, _)| boxes.iter().flatten().all(|bounds| touches(corner, bounds)))
        .collect();
    near.sort_unstable();
    near.dedup_by_key(|(corner, _)| *corner);
    let mut work = Work::default();
    for axis in 0..3 {
        near.sort_unstable_by_key(|(corner, _)| corner[axis]);
        let sweep = Sweep {
            axis,
            edge: steps,
            stock,
            is_complement,
            within,
        };
        sweep.run(&near, &mut work, goes_on, sink)?;
    }
    ControlFlow::Continue(())
}

/// A cube's cross-section. Units: half steps.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
struct Square {
    /// Least corner, on the axes that follow the plane's.
    corner: [i64; 2],
    id: CubeId,
    /// Whether the cube is there just below the plane, and just above.
    is_there: [bool; 2],
}

impl Square {
    /// Whether the cube has a face in the plane.
    fn is_face(&self) -> bool {
        self.is_there[0] != self.is_there[1]
    }
}

/// Memory that one plane after the other uses.
#[derive(Default)]
struct Work {
    squares: Vec<Square>,
    lines: Lines,
    /// What is exposed downward, and upward.
    exposed: [Exposed; 2],
}

/// Edges of one face.
#[derive(Default)]
struct Exposed {
    edges: Vec<[[i64; 2]; 2]>,
    body: Option<CubeId>,
}

/// One axis.
struct Sweep {
    axis: usize,
    edge: i32,
    stock: Option<Bounds>,
    is_complement: bool,
    within: Option<Bounds>,
}

/// One plane, and what is fixed in it. Units: half steps.
struct Plane {
    edge: i64,
    is_complement: bool,
    /// Whether there can be material just below it, and just above.
    is_open: [bool; 2],
    /// Whether it is a side of the stock.
    is_side: bool,
    /// The stock's rectangle, or everything.
    stock: [Range<i64>; 2],
    /// What is listed.
    within: [Range<i64>; 2],
}

/// Everything, with room to add an edge.
const ALL: Range<i64> = -(1 << 40)..1 << 40;

impl Sweep {
    fn run(
        &self,
        cubes: &[([i32; 3], CubeId)],
        work: &mut Work,
        goes_on: &dyn Fn() -> bool,
        sink: &mut PlaneSink,
    ) -> ControlFlow<()> {
        let axis = self.axis;
        let mut crossing = Crossing::new(self.edge, cubes.len());
        let mut sides: Vec<i32> = Vec::new();
        if let Some(bounds) = &self.stock {
            sides.extend([bounds.max[axis], bounds.min[axis]]);
        }
        let listed = self.within.map_or(i32::MIN..=i32::MAX, |within| {
            within.min[axis]..=within.max[axis]
        });
        // Cubes before `ended` lie below the plane, those from `begun` on above it.
        let (mut ended, mut begun) = (0, 0);
        for count in 0_usize.. {
            if count % PLANES_AT_ONCE == 0 && !goes_on() {
                return ControlFlow::Break(());
            }
            let ends = cubes.get(ended).map(|(corner, _)| corner[axis] + self.edge);
            let begins = cubes.get(begun).map(|(corner, _)| corner[axis]);
            let candidates = [ends, begins, sides.last().copied()];
            let Some(at) = candidates.into_iter().flatten().min() else {
                break;
            };
            let is_side = sides.last() == Some(&at);
            if is_side {
                sides.pop();
            }
            let end = |from: usize, is_at: &dyn Fn(i32) -> bool| {
                let rest = cubes[from..].iter();
                from + rest.take_while(|(corner, _)| is_at(corner[axis])).count()
            };
            let high = ended..end(ended, &|low| low + self.edge == at);
            let low = begun..end(begun, &|low| low == at);
            for cube in &cubes[high.clone()] {
                crossing.remove(self.square(cube, [true, true]));
            }
            let is_in_stock = self
                .stock
                .is_none_or(|stock| (stock.min[axis]..=stock.max[axis]).contains(&at));
            if is_in_stock && listed.contains(&at) {
                let squares = &mut work.squares;
                squares.clear();
                let high = cubes[high.clone()].iter();
                squares.extend(high.map(|cube| self.square(cube, [true, false])));
                let low = cubes[low.clone()].iter();
                squares.extend(low.map(|cube| self.square(cube, [false, true])));
                if is_side {
                    crossing.all(squares);
                } else {
                    crossing.near_faces(squares);
                }
                self.plane(at, is_side).list(work);
                self.hand_out(at, &mut work.exposed, sink)?;
            }
            for cube in &cubes[low.clone()] {
                crossing.add(self.square(cube, [true, true]));
            }
            (ended, begun) = (high.end, low.end);
        }
        ControlFlow::Continue(())
    }

    fn square(&self, &(corner, id): &([i32; 3], CubeId), is_there: [bool; 2]) -> Square {
        let across = [1, 2].map(|next| 2 * i64::from(corner[(self.axis + next) % 3]));
        Square {
            corner: across,
            id,
            is_there,
        }
    }

    fn plane(&self, at: i32, is_side: bool) -> Plane {
        let axis = self.axis;
        let ranges = |bounds: Option<Bounds>, beyond: i64| {
            [1, 2].map(|next| {
                let axis = (axis + next) % 3;
                bounds.map_or(ALL, |bounds| {
                    let [min, max] = [bounds.min, bounds.max].map(|end| 2 * i64::from(end[axis]));
                    min - beyond..max + beyond
                })
            })
        };
        Plane {
            edge: 2 * i64::from(self.edge),
            is_complement: self.is_complement,
            is_open: [
                self.stock.is_none_or(|stock| at > stock.min[axis]),
                self.stock.is_none_or(|stock| at < stock.max[axis]),
            ],
            is_side,
            stock: ranges(self.stock, 0),
            within: ranges(self.within, 1),
        }
    }

    fn hand_out(
        &self,
        at: i32,
        exposed: &mut [Exposed; 2],
        sink: &mut PlaneSink,
    ) -> ControlFlow<()> {
        for (is_upward, exposed) in [false, true].into_iter().zip(exposed) {
            let body = exposed.body.take();
            if !exposed.edges.is_empty() {
                sink(&PlaneFace {
                    axis: self.axis,
                    is_upward,
                    at,
                    body,
                    edges: &exposed.edges,
                })?;
                exposed.edges.clear();
            }
        }
        ControlFlow::Continue(())
    }
}

/// The squares of the cubes that cross a plane, by cells as wide as a cube.
struct Crossing {
    edge: i64,
    buckets: Vec<Vec<Square>>,
}

impl Crossing {
    fn new(edge: i32, cubes: usize) -> Self {
        let buckets = cubes.next_power_of_two().min(BUCKETS_MAX);
        Self {
            edge: 2 * i64::from(edge),
            buckets: vec![Vec::new(); buckets],
        }
    }

    fn cell(&self, square: &Square) -> [i64; 2] {
        square.corner.map(|low| low.div_euclid(self.edge))
    }

    fn bucket(&self, [one, other]: [i64; 2]) -> usize {
        let mixed = one
            .wrapping_mul(0x9e37_79b9)
            .wrapping_add(other)
            .wrapping_mul(0x5851_f42d_4c95_7f2d);
        let mixed = usize::try_from(mixed.cast_unsigned() >> 40);
        mixed.expect("24 bits fit") & (self.buckets.len() - 1)
    }

    fn add(&mut self, square: Square) {
        let bucket = self.bucket(self.cell(&square));
        self.buckets[bucket].push(square);
    }

    fn remove(&mut self, square: Square) {
        let bucket = self.bucket(self.cell(&square));
        let bucket = &mut self.buckets[bucket];
        let found = bucket.iter().position(|other| *other == square);
        bucket.swap_remove(found.expect("it was added when its cube began"));
    }

    /// Adds all squares.
    fn all(&self, squares: &mut Vec<Square>) {
        squares.extend(self.buckets.iter().flatten());
    }

    /// Adds the squares that touch some that are there.
    fn near_faces(&self, squares: &mut Vec<Square>) {
        let faces = squares.len();
        for index in 0..faces {
            let face = squares[index];
            let [one, other] = self.cell(&face);
            for one in one - 1..=one + 1 {
                for other in other - 1..=other + 1 {
                    let bucket = &self.buckets[self.bucket([one, other])];
                    let touching = bucket.iter().filter(|square| {
                        let off = [0, 1].map(|axis| square.corner[axis] - face.corner[axis]);
                        off.iter().all(|off| off.abs() <= self.edge)
                            && self.cell(square) == [one, other]
                    });
                    squares.extend(touching);
                }
            }
        }
        if faces > 1 {
            squares[faces..].sort_unstable();
            let mut kept = faces;
            for index in faces..squares.len() {
                if kept == faces || squares[kept - 1] != squares[index] {
                    squares[kept] = squares[index];
                    kept += 1;
                }
            }
            squares.truncate(kept);
        }
    }
}

/// Memory that one line after the other uses.
#[derive(Default)]
struct Lines {
    /// Squares as they lie along the lines, sorted by row and along it: row, coordinates along and across, which.
    sorted: Vec<(i64, [i64; 2], usize)>,
    /// Stretches of lines that may carry edges: the line across, from, to.
    runs: Vec<(i64, i64, i64)>,
    touching: Vec<usize>,
    /// Where squares begin and end, and how many are there on either side and level from there on.
    events: Vec<(i64, [i32; 4])>,
}

impl Plane {
    /// Lists the edges of what is exposed.
    fn list(&self, work: &mut Work) {
        for along in [0, 1] {
            self.list_along(along, work);
        }
    }

    /// Lists the edges along one axis.
    fn list_along(&self, along: usize, work: &mut Work) {
        let Work {
            squares,
            lines,
            exposed,
        } = work;
        lines.sort(squares, along, self.edge);
        self.find_runs(squares, along, &mut lines.runs);
        let mut index = 0;
        while let Some(&(line, from, mut to)) = lines.runs.get(index) {
            index += 1;
            while let Some(&(next, begin, end)) = lines.runs.get(index)
                && next == line
                && begin <= to
            {
                to = to.max(end);
                index += 1;
            }
            lines.find_touching(squares, along, self.edge, (line, from, to));
            self.follow(squares, along, (line, from, to), lines, exposed);
        }
    }

    /// Stretches of lines that may carry edges, sorted.
    fn find_runs(&self, squares: &[Square], along: usize, runs: &mut Vec<(i64, i64, i64)>) {
        let across = 1 - along;
        let (stock, within) = (&self.stock[across], &self.within[across]);
        let is_listed =
            |line: i64| line >= stock.start.max(within.start) && line <= stock.end.min(within.end);
        runs.clear();
        for square in squares {
            let (from, low) = (square.corner[along], square.corner[across]);
            let high = low + self.edge;
            let mut push = |line: i64| runs.push((line, from, from + self.edge));
            for line in [low, high] {
                if is_listed(line) {
                    push(line);
                }
            }
            for line in [stock.start, stock.end, within.start, within.end] {
                if is_listed(line) && (low..=high).contains(&line) {
                    push(line);
                }
            }
        }
        if self.is_side {
            let whole = &self.stock[along];
            for line in [stock.start, stock.end, within.start, within.end] {
                if is_listed(line) {
                    runs.push((line, whole.start, whole.end));
                }
            }
        }
        runs.sort_unstable();
    }

    /// Sweeps along a stretch of a line.
    #[allow(
        clippy::too_many_lines,
        reason = "one sweep, whose parts share all that it knows"
    )]
    fn follow(
        &self,
        squares: &[Square],
        along: usize,
        (line, from, to): (i64, i64, i64),
        lines: &mut Lines,
        exposed: &mut [Exposed; 2],
    ) {
        let Lines {
            touching, events, ..
        } = lines;
        if !self.is_side && !touching.iter().any(|&which| squares[which].is_face()) {
            return;
        }
        let across = 1 - along;
        let (stock, within) = (&self.stock, &self.within);
        let from = from.max(stock[along].start).max(within[along].start);
        let to = to.min(stock[along].end).min(within[along].end);
        events.clear();
        for &which in touching.iter() {
            let square = &squares[which];
            let low = square.corner[across];
            let sides = [low < line, line < low + self.edge];
            let mut change = [0; 4];
            for quadrant in 0..4 {
                let is_there = sides[quadrant >> 1] && square.is_there[quadrant & 1];
                change[quadrant] = i32::from(is_there);
            }
            let begin = square.corner[along];
            events.push((begin, change));
            events.push((begin + self.edge, change.map(|there| -there)));
        }
        events.sort_unstable_by_key(|(at, _)| *at);
        let is_in = |range: &Range<i64>| [range.start < line, line < range.end];
        let is_before_end = |range: &Range<i64>| [line <= range.end, line >= range.start];
        let in_range = |range: &Range<i64>| {
            let (inside, limit) = (is_in(range), is_before_end(range));
            [inside[0] && limit[0], inside[1] && limit[1]]
        };
        let (in_stock, in_within) = (in_range(&stock[across]), in_range(&within[across]));
        let pattern_of = |count: &[i32; 4]| {
            let mut pattern = [false; 4];
            for quadrant in 0..4 {
                let is_possible = in_stock[quadrant >> 1] && self.is_open[quadrant & 1];
                pattern[quadrant] = is_possible && (count[quadrant] > 0) != self.is_complement;
            }
            pattern
        };
        let mut flush = |begin: i64, end: i64, pattern: [bool; 4]| {
            if begin >= end {
                return;
            }
            for upward in [0, 1] {
                let shows = |side: usize| {
                    let (inner, outer) = (2 * side + 1 - upward, 2 * side + upward);
                    in_within[side] && pattern[inner] && !pattern[outer]
                };
                let sides = [shows(0), shows(1)];
                if sides[0] == sides[1] {
                    continue;
                }
                let point = |at: i64| if along == 0 { [at, line] } else { [line, at] };
                // Looking down the axis, what is above a line that runs along the first of the two lies to its left.
                let is_forward = sides[1] == (along == 0) && upward == 1
                    || sides[1] != (along == 0) && upward == 0;
                let edge = [point(begin), point(end)];
                let face = &mut exposed[upward];
                let [one, other] = edge;
                face.edges
                    .push(if is_forward { edge } else { [other, one] });
                if !self.is_side {
                    let left = usize::from(sides[1]);
                    let level = if self.is_complement {
                        upward
                    } else {
                        1 - upward
                    };
                    let owners = touching.iter().map(|&which| &squares[which]);
                    let owners = owners.filter(|square| {
                        let low = square.corner[across];
                        let is_beside = [low < line, line < low + self.edge][left];
                        let first = square.corner[along];
                        let covers = first < end && begin < first + self.edge;
                        is_beside && covers && square.is_face() && square.is_there[level]
                    });
                    let least = owners.map(|square| square.id).chain(face.body).min();
                    face.body = least;
                }
            }
        };
        let mut count = [0; 4];
        let mut current = (from, None);
        let mut index = 0;
        // From one place where something changes to the next.
        let mut at = from;
        while at < to {
            while let Some((_, change)) = events.get(index).filter(|(event, _)| *event <= at) {
                for quadrant in 0..4 {
                    count[quadrant] += change[quadrant];
                }
                index += 1;
            }
            let pattern = pattern_of(&count);
            if current.1 != Some(pattern) {
                if let Some(before) = current.1 {
                    flush(current.0, at, before);
                }
                current = (at, Some(pattern));
            }
            at = events.get(index).map_or(to, |(event, _)| (*event).min(to));
        }
        if let (begin, Some(pattern)) = current {
            flush(begin, to, pattern);
        }
    }
}

impl Lines {
    fn sort(&mut self, squares: &[Square], along: usize, edge: i64) {
        self.sorted.clear();
        if squares.len() < FEW_SQUARES {
            return;
        }
        let sorted = squares.iter().enumerate().map(|(which, square)| {
            let (at, across) = (square.corner[along], square.corner[1 - along]);
            (across.div_euclid(edge), [at, across], which)
        });
        self.sorted.extend(sorted);
        self.sorted.sort_unstable();
    }

    /// Finds the squares that touch a stretch of a line.
    fn find_touching(
        &mut self,
        squares: &[Square],
        along: usize,
        edge: i64,
        (line, from, to): (i64, i64, i64),
    ) {
        let touches = |at: i64, across: i64| {
            at <= to && at + edge >= from && across <= line && across + edge >= line
        };
        self.touching.clear();
        if squares.len() < FEW_SQUARES {
            let all = squares.iter().enumerate();
            let touching =
                all.filter(|(_, square)| touches(square.corner[along], square.corner[1 - along]));
            self.touching.extend(touching.map(|(which, _)| which));
            return;
        }
        let row = line.div_euclid(edge);
        for row in row - 1..=row {
            let first = self
                .sorted
                .partition_point(|(other, [at, _], _)| (*other, *at) < (row, from - edge));
            let rest = self.sorted[first..].iter();
            let near = rest.take_while(|(other, [at, _], _)| *other == row && *at <= to);
            let touching = near.filter(|(_, [at, across], _)| touches(*at, *across));
            self.touching.extend(touching.map(|(_, _, which)| *which));
        }
    }
}
