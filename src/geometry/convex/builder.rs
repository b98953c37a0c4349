//! From facets to a solid: which facets meet along which edge.

use super::super::lattice::Bounds;
use super::limits::{EXTENT_MAX, VERTICES_MAX};
use super::plane::Plane;
use super::point::Point;
use super::solid::{Edge, InvalidSolid, Solid};

/// The facets of a closed convex surface, added one by one over a pool of points; not every point need be used.
#[derive(Debug)]
pub(super) struct Builder {
    points: Vec<Point>,
    bounds: Bounds,
    planes: Vec<Plane>,
    starts: Vec<usize>,
    loops: Vec<usize>,
    /// Memory of `add_hull`.
    flat: Vec<FlatPoint>,
    chain: Vec<FlatPoint>,
}

/// A point of a facet without the coordinate in which the facet is flattest.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
struct FlatPoint {
    at: [i64; 2],
    index: usize,
}

impl Builder {
    /// No facets yet. All points must be in the hull of the facets to come.
    /// # Errors
    /// [`InvalidSolid::Empty`], [`InvalidSolid::TooLong`]. Points that pass keep all products within the bounds of `limits.rs`.
    pub(super) fn new(points: Vec<Point>) -> Result<Self, InvalidSolid> {
        let bounds = bounds_of(&points)?;
        for axis in 0..3 {
            let steps = i64::from(bounds.max[axis]) - i64::from(bounds.min[axis]);
            if steps > EXTENT_MAX {
                return Err(InvalidSolid::TooLong { axis, steps });
            }
        }
        Ok(Self {
            points,
            bounds,
            planes: Vec::new(),
            starts: vec![0],
            loops: Vec::new(),
            flat: Vec::new(),
            chain: Vec::new(),
        })
    }

    /// The box around the points.
    pub(super) const fn bounds(&self) -> Bounds {
        self.bounds
    }

    pub(super) fn points(&self) -> &[Point] {
        &self.points
    }

    /// A facet whose vertices are given in order: counterclockwise seen from outside, and none between others.
    pub(super) fn add_loop(&mut self, plane: Plane, vertices: impl Iterator<Item = usize>) {
        self.loops.extend(vertices);
        self.close(plane);
    }

    /// A facet that is the convex hull of points of its plane, in any order.
    pub(super) fn add_hull(&mut self, plane: Plane, points: impl Iterator<Item = usize>) {
        let normal = plane.normal();
        let dropped = if normal[0].abs() >= normal[1].abs().max(normal[2].abs()) {
            0
        } else if normal[1].abs() >= normal[2].abs() {
            1
        } else {
            2
        };
        // The order of the two axes that stay keeps "counterclockwise".
        let (mut first, mut second) = ((dropped + 1) % 3, (dropped + 2) % 3);
        if normal[dropped] < 0 {
            (first, second) = (second, first);
        }
        let (pool, flat, chain) = (&self.points, &mut self.flat, &mut self.chain);
        flat.clear();
        flat.extend(points.map(|index| {
            let at = pool[index].wide();
            FlatPoint {
                at: [at[first], at[second]],
                index,
            }
        }));
        flat.sort_unstable();
        flat.dedup_by_key(|point| point.at);
        chain.clear();
        extend_chain(chain, 0, flat.iter());
        let turn = chain.len() - 1;
        extend_chain(chain, turn, flat.iter().rev().skip(1));
        chain.pop();
        self.loops.extend(chain.iter().map(|point| point.index));
        self.close(plane);
    }

    fn close(&mut self, plane: Plane) {
        debug_assert!(self.loops.len() >= self.starts[self.starts.len() - 1] + 3);
        self.starts.push(self.loops.len());
        self.planes.push(plane);
    }

    /// The solid, over those points that are vertices of facets.
    /// # Errors
    /// [`InvalidSolid::TooManyVertices`].
    pub(super) fn finish(self) -> Result<Solid, InvalidSolid> {
        let Self {
            points,
            bounds,
            planes,
            starts,
            loops,
            ..
        } = self;
        let (vertices, loops) = used(&points, &loops)?;
        let small = |number: usize| u16::try_from(number).expect("checked by const assertion");
        let (edges, across) = edges_of(&starts, &loops);
        // Euler's formula: a surface that is closed and in one piece.
        assert_eq!(vertices.len() + planes.len(), edges.len() + 2);
        Ok(Solid {
            vertices,
            planes,
            starts: starts.into_iter().map(small).collect(),
            loops,
            across,
            edges,
            bounds,
        })
    }
}

/// Andrew's monotone chain: keeps left turns only, above the first `base` points.
fn extend_chain<'point>(
    chain: &mut Vec<FlatPoint>,
    base: usize,
    points: impl Iterator<Item = &'point FlatPoint>,
) {
    for &point in points {
        while chain.len() >= base + 2 {
            let [a, b] = [chain[chain.len() - 2].at, chain[chain.len() - 1].at];
            let turn = (b[0] - a[0]) * (point.at[1] - a[1]) - (b[1] - a[1]) * (point.at[0] - a[0]);
            if turn > 0 {
                break;
            }
            chain.pop();
        }
        chain.push(point);
    }
}

/// The points that occur in the loops, and the loops by their new numbers.
fn used(points: &[Point], loops: &[usize]) -> Result<(Vec<Point>, Vec<u16>), InvalidSolid> {
    const UNUSED: u16 = u16::MAX;
    let mut numbers = vec![UNUSED; points.len()];
    let mut vertices = Vec::with_capacity(points.len());
    let mut renumbered = Vec::with_capacity(loops.len());
    for &index in loops {
        if numbers[index] == UNUSED {
            numbers[index] = u16::try_from(vertices.len())
                .ok()
                .filter(|&number| number < UNUSED)
                .ok_or(InvalidSolid::TooManyVertices {
                    count: points.len(),
                })?;
            vertices.push(points[index]);
        }
        renumbered.push(numbers[index]);
    }
    if vertices.len() > VERTICES_MAX {
        return Err(InvalidSolid::TooManyVertices {
            count: vertices.len(),
        });
    }
    Ok((vertices, renumbered))
}

/// The bits of a side that say where it is in the loops.
const PLACE_MASK: u64 = (1 << 31) - 1;

/// The edges of a closed surface, and the facet across each place of the loops; `starts` says where in `loops` each facet's begins, and the
/// end of the last.
pub(crate) fn edges_of(starts: &[usize], loops: &[u16]) -> (Vec<Edge>, Vec<u16>) {
    // One key for each place: the ends of its edge, the lesser first, then the place itself. The two sides of an edge become neighbours.
    let mut sides = Vec::with_capacity(loops.len());
    let mut facet_of = Vec::with_capacity(loops.len());
    for (facet, range) in (0_u16..).zip(starts.windows(2)) {
        for place in range[0]..range[1] {
            let next = if place + 1 == range[1] {
                range[0]
            } else {
                place + 1
            };
            let (tail, head) = (loops[place], loops[next]);
            let ends = u64::from(tail.min(head)) << 16 | u64::from(tail.max(head));
            let backwards = u64::from(tail > head);
            sides.push(ends << 32 | backwards << 31 | place as u64);
            facet_of.push(facet);
        }
    }
    sides.sort_unstable();
    let mut across = vec![0; loops.len()];
    let mut edges = Vec::with_capacity(loops.len() / 2);
    let place = |side: u64| usize::try_from(side & PLACE_MASK).expect("31 bits");
    let (pairs, rest) = sides.as_chunks::<2>();
    assert!(rest.is_empty(), "the surface is closed");
    for &[forwards, backwards] in pairs {
        assert_eq!(
            forwards >> 31,
            (backwards >> 31) - 1,
            "an edge has two sides"
        );
        let (here, there) = (place(forwards), place(backwards));
        across[here] = facet_of[there];
        across[there] = facet_of[here];
        edges.push(Edge {
            tail: loops[here],
            head: loops[there],
            left: facet_of[here],
            right: facet_of[there],
        });
    }
    (edges, across)
}

/// The box around points.
fn bounds_of(points: &[Point]) -> Result<Bounds, InvalidSolid> {
    let (first, others) = points.split_first().ok_or(InvalidSolid::Empty)?;
    let (mut min, mut max) = (first.coordinates(), first.coordinates());
    for point in others {
        let at = point.coordinates();
        for axis in 0..3 {
            min[axis] = min[axis].min(at[axis]);
            max[axis] = max[axis].max(at[axis]);
        }
    }
    Ok(Bounds { min, max })
}
