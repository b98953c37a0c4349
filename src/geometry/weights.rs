//! The weight of every octant mask in every measure: one table of 256 rows, derived from the definitions.

use super::octants::{EdgeKind, OctantMask, VertexKind};

/// What one lattice point contributes to each measure, up to a monomial of its coordinates.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Weights {
    /// Volume, times `x*y*z`; with more powers of the coordinates, the moments. Range: -4 to 4.
    pub volume: i8,
    /// Area by axis of the normal, times the product of the other two coordinates. Range: -4 to 4.
    pub area: [i8; 3],
    /// Edge length by direction and [`EdgeKind`], times the coordinate along it. Range: -1 to 1.
    pub edge: [[i8; 3]; 3],
    /// Eight times the Euler characteristic. Range: -8 to 8 (proved below).
    pub euler8: i8,
    /// The vertex, when the mask varies along all three axes.
    pub vertex: Option<VertexKind>,
}

/// Weights by octant mask. Shape: `[Weights; 256]`, indexed by [`OctantMask`]'s bits.
/// # Source
/// UNION3's "s generalised for every possible local vertex geometry"; checked against voxels in `tests/geometry.rs`.
pub const WEIGHTS: [Weights; 256] = {
    let mut table = [weights_of(OctantMask(0)); 256];
    let mut bits: u8 = 0;
    loop {
        table[bits as usize] = weights_of(OctantMask(bits));
        if bits == u8::MAX {
            break table;
        }
        bits += 1;
    }
};

/// +1 below, -1 above.
const fn sign(side: usize) -> i8 {
    if side == 0 { 1 } else { -1 }
}

const fn weights_of(mask: OctantMask) -> Weights {
    let mut weights = Weights {
        volume: 0,
        area: [0; 3],
        edge: [[0; 3]; 3],
        euler8: 0,
        vertex: None,
    };
    let (mut half_edges, mut quarter_faces, mut octants) = (0, 0, 0);
    let mut octant = 0;
    while octant < 8 {
        let side = [octant & 1, octant >> 1 & 1, octant >> 2];
        if mask.filled(side) {
            octants += 1;
            weights.volume += sign(side[0]) * sign(side[1]) * sign(side[2]);
        }
        octant += 1;
    }
    let mut axis = 0;
    while axis < 3 {
        let (first, second) = ((axis + 1) % 3, (axis + 2) % 3);
        // The four quarters of the plane across `axis`: where the two sides differ there is a face.
        let mut quarter = 0;
        while quarter < 4 {
            let mut below = [0; 3];
            below[first] = quarter & 1;
            below[second] = quarter >> 1;
            let mut above = below;
            above[axis] = 1;
            let (below, above) = (mask.filled(below), mask.filled(above));
            if below != above {
                weights.area[axis] += sign(quarter & 1) * sign(quarter >> 1);
            }
            if below || above {
                quarter_faces += 1;
            }
            quarter += 1;
        }
        // The two half-edges along `axis`, each with four octants around it.
        let mut end = 0;
        while end < 2 {
            let mut around = [false; 4];
            let mut quarter = 0;
            while quarter < 4 {
                let mut side = [0; 3];
                side[axis] = end;
                side[first] = quarter & 1;
                side[second] = quarter >> 1;
                around[quarter] = mask.filled(side);
                quarter += 1;
            }
            let count = around[0] as u8 + around[1] as u8 + around[2] as u8 + around[3] as u8;
            if count > 0 {
                half_edges += 1;
            }
            let kind = match count {
                1 => Some(EdgeKind::Convex),
                3 => Some(EdgeKind::Concave),
                2 if around[0] == around[3] => Some(EdgeKind::Crossing),
                _ => None,
            };
            if let Some(kind) = kind {
                weights.edge[axis][kind as usize] += sign(end);
            }
            end += 1;
        }
        axis += 1;
    }
    let point = if mask.0 == 0 { 0 } else { 8 };
    weights.euler8 = point - 4 * half_edges + 2 * quarter_faces - octants;
    weights.vertex = vertex_of(mask);
    weights
}

/// The six half-spaces, as masks.
const HALF_SPACES: [u8; 6] = [
    0b0101_0101,
    0b1010_1010,
    0b0011_0011,
    0b1100_1100,
    0b0000_1111,
    0b1111_0000,
];

const fn vertex_of(mask: OctantMask) -> Option<VertexKind> {
    if !(mask.varies_along(0) && mask.varies_along(1) && mask.varies_along(2)) {
        return None;
    }
    Some(match mask.0.count_ones() {
        1 => VertexKind::Corner,
        // A cube's edge comes out of a face: a filled half-space and one octant on its other side.
        5 if fills_a_half_space(mask) => VertexKind::EdgeFace,
        7 => VertexKind::ThreeFace,
        _ => VertexKind::Degenerate,
    })
}

const fn fills_a_half_space(mask: OctantMask) -> bool {
    let mut index = 0;
    while index < HALF_SPACES.len() {
        if mask.0 & HALF_SPACES[index] == HALF_SPACES[index] {
            return true;
        }
        index += 1;
    }
    false
}

// A mask that does not change along some axis is no vertex and weighs nothing: only vertices of the union count.
const _: () = {
    let mut bits = 0;
    while bits < 256 {
        let weights = &WEIGHTS[bits];
        if weights.vertex.is_none() {
            assert!(weights.volume == 0 && weights.euler8 == 0);
            let mut axis = 0;
            while axis < 3 {
                assert!(weights.area[axis] == 0);
                assert!(
                    weights.edge[axis][0] == 0
                        && weights.edge[axis][1] == 0
                        && weights.edge[axis][2] == 0
                );
                axis += 1;
            }
        }
        assert!(-4 <= weights.volume && weights.volume <= 4);
        bits += 1;
    }
};
