//! The slow reference for the geometry: every measure from its definition, voxel by voxel.

use ethnum::I256;
use union3d::geometry::{
    Bounds, Edge, EdgeKind, Measures, Place, Stock, StockMeasures, Totals, VertexKind,
};

/// The totals of a few cubes in a small world, counted voxel by voxel, face by face, edge by edge.
pub(crate) fn totals(edge: Edge, stock: Option<Stock>, places: &[Place]) -> Totals {
    let boxes: Vec<Bounds> = places
        .iter()
        .map(|place| Bounds {
            min: place.corner(),
            max: place.corner().map(|low| low + edge.steps()),
        })
        .collect();
    let bounds = around(boxes.iter().copied());
    let union = |voxel: [i32; 3]| boxes.iter().any(|cube| holds(cube, voxel));
    Totals {
        cubes: places.len() as u64,
        measures: bounds.map_or(Measures::default(), |bounds| measures(bounds, &union)),
        bounds,
        stock: stock.map(|stock| {
            let material = stock.bounds();
            StockMeasures {
                removed: measures(material, &|voxel| holds(&material, voxel) && union(voxel)),
                remaining: measures(material, &|voxel| holds(&material, voxel) && !union(voxel)),
            }
        }),
    }
}

/// The measures of a set of voxels within a box.
pub(crate) fn measures(bounds: Bounds, solid: &dyn Fn([i32; 3]) -> bool) -> Measures {
    World::new(bounds, solid).measures()
}

/// The box around boxes; none around none.
fn around(boxes: impl Iterator<Item = Bounds>) -> Option<Bounds> {
    boxes.reduce(|one, other| Bounds {
        min: std::array::from_fn(|axis| one.min[axis].min(other.min[axis])),
        max: std::array::from_fn(|axis| one.max[axis].max(other.max[axis])),
    })
}

/// Whether a box holds the voxel whose lower corner this is.
fn holds(bounds: &Bounds, voxel: [i32; 3]) -> bool {
    (0..3).all(|axis| (bounds.min[axis]..bounds.max[axis]).contains(&voxel[axis]))
}

/// Voxels of the bounding box with an empty layer around it.
struct World {
    origin: [i32; 3],
    size: [usize; 3],
    filled: Vec<bool>,
}

impl World {
    fn new(bounds: Bounds, solid: &dyn Fn([i32; 3]) -> bool) -> Self {
        let origin = bounds.min.map(|low| low - 1);
        let size: [usize; 3] =
            std::array::from_fn(|axis| (bounds.max[axis] - bounds.min[axis] + 2) as usize);
        let voxel = |index: usize| {
            let at = [
                index % size[0],
                index / size[0] % size[1],
                index / size[0] / size[1],
            ];
            std::array::from_fn(|axis| origin[axis] + at[axis] as i32)
        };
        Self {
            origin,
            size,
            filled: (0..size.iter().product())
                .map(|index| solid(voxel(index)))
                .collect(),
        }
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
