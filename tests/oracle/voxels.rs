//! The slow twin of the geometry: every measure from its definition, voxel by voxel.

use ethnum::I256;
use union3d::geometry::{Bounds, Edge, EdgeKind, Measures, Place, Totals, VertexKind};

/// The totals of a few cubes in a small world, counted voxel by voxel, face by face, edge by edge.
pub(crate) fn totals(edge: Edge, places: &[Place]) -> Totals {
    let bounds = places.iter().fold(None::<Bounds>, |bounds, place| {
        let min = place.corner();
        let max = min.map(|low| low + edge.steps());
        Some(bounds.map_or(Bounds { min, max }, |bounds| Bounds {
            min: std::array::from_fn(|axis| bounds.min[axis].min(min[axis])),
            max: std::array::from_fn(|axis| bounds.max[axis].max(max[axis])),
        }))
    });
    let measures = bounds.map_or_else(Measures::default, |bounds| {
        World::new(edge, places, bounds).measures()
    });
    Totals {
        cubes: places.len() as u64,
        measures,
        bounds,
        stock: None,
    }
}

/// Voxels of the bounding box with an empty layer around it.
struct World {
    origin: [i32; 3],
    size: [usize; 3],
    filled: Vec<bool>,
}

impl World {
    fn new(edge: Edge, places: &[Place], bounds: Bounds) -> Self {
        let origin = bounds.min.map(|low| low - 1);
        let size = std::array::from_fn(|axis| (bounds.max[axis] - bounds.min[axis] + 2) as usize);
        let mut world = Self {
            origin,
            size,
            filled: vec![false; size.iter().product()],
        };
        let side = edge.steps();
        for place in places {
            for index in 0..side.pow(3) {
                let step = [index % side, index / side % side, index / side / side];
                let at = std::array::from_fn(|axis| {
                    (place.corner()[axis] + step[axis] - origin[axis]) as usize
                });
                let index = world.index(at);
                world.filled[index] = true;
            }
        }
        world
    }

    fn index(&self, at: [usize; 3]) -> usize {
        (at[2] * self.size[1] + at[1]) * self.size[0] + at[0]
    }

    /// Whether the voxel `back` before `at` on the axes is filled.
    fn filled(&self, at: [usize; 3], back: [usize; 3]) -> bool {
        self.filled[self.index(std::array::from_fn(|axis| at[axis] - back[axis]))]
    }

    fn measures(&self) -> Measures {
        let mut sums = Measures::default();
        // A voxel, and its lower faces, edges and point; the empty layer holds all that is left.
        for z in 1..self.size[2] {
            for y in 1..self.size[1] {
                for x in 1..self.size[0] {
                    self.add([x, y, z], &mut sums);
                }
            }
        }
        sums
    }

    fn add(&self, at: [usize; 3], sums: &mut Measures) {
        if self.filled(at, [0; 3]) {
            let low: [i128; 3] =
                std::array::from_fn(|axis| i128::from(self.origin[axis]) + at[axis] as i128);
            sums.volume += 1;
            for axis in 0..3 {
                let (this, next) = (low[axis], low[(axis + 1) % 3]);
                sums.first_moments2[axis] += 2 * this + 1;
                sums.second_moments3[axis] += I256::from(3 * this * this + 3 * this + 1);
                sums.product_moments4[axis] += I256::from((2 * this + 1) * (2 * next + 1));
            }
            sums.euler8 -= 8;
        }
        for axis in 0..3 {
            let unit = |of: usize| std::array::from_fn(|axis| usize::from(axis == of));
            let (along, one, two) = (unit(axis), unit((axis + 1) % 3), unit((axis + 2) % 3));
            let both = std::array::from_fn(|axis| one[axis] + two[axis]);
            let (here, there) = (self.filled(at, [0; 3]), self.filled(at, along));
            if here != there {
                sums.area_by_axis[axis] += 1;
            }
            if here || there {
                sums.euler8 += 8;
            }
            // The lattice edge along `axis` from `at`, and the four voxels around it in a circle.
            let around = [[0; 3], one, both, two].map(|back| self.filled(at, back));
            let kind = match around.map(u8::from).iter().sum() {
                1 => Some(EdgeKind::Convex),
                3 => Some(EdgeKind::Concave),
                2 if around[0] == around[2] => Some(EdgeKind::Crossing),
                _ => None,
            };
            if let Some(kind) = kind {
                sums.edge_length[axis][kind as usize] += 1;
            }
            if around.contains(&true) {
                sums.euler8 -= 8;
            }
        }
        self.add_point(at, sums);
    }

    fn add_point(&self, at: [usize; 3], sums: &mut Measures) {
        let octant =
            |bits: usize| self.filled(at, std::array::from_fn(|axis| 1 - (bits >> axis & 1)));
        let octants: Vec<bool> = (0..8).map(octant).collect();
        let count = octants.iter().filter(|filled| **filled).count();
        if count > 0 {
            sums.euler8 += 8;
        }
        let varies = |axis: usize| (0..8).any(|bits| octants[bits] != octants[bits ^ 1 << axis]);
        if !(varies(0) && varies(1) && varies(2)) {
            return;
        }
        let full_side = (0..3).any(|axis| {
            (0..2).any(|side| (0..8).all(|bits| bits >> axis & 1 != side || octants[bits]))
        });
        let kind = match count {
            1 => VertexKind::Corner,
            5 if full_side => VertexKind::EdgeFace,
            7 => VertexKind::ThreeFace,
            _ => VertexKind::Degenerate,
        };
        sums.vertices[kind as usize] += 1;
    }
}
