//! What the union of random cubes measures on average: the paper's formulas, and the same with borders.
//!
//! `N` lower corners lie uniformly in a box of side `U`. A point at the depth `t` from the borders (per axis the share, up to 1, of
//! the lower corners that could cover it along that axis) stays bare with probability `exp(-rho t_x t_y t_z)`. Every measure is
//! then a sum over kinds of features of `N^cubes` times the product of three measures of `t`, one an axis. Far from the borders (all
//! `t` = 1) these are the formulas of UNION3's paper.

/// The rows of the paper's table.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Rows {
    pub(super) volume: f64,
    pub(super) area: f64,
    pub(super) edge_length: f64,
    pub(super) corners: f64,
    pub(super) edge_face: f64,
    pub(super) three_face: f64,
}

impl Rows {
    pub(super) fn values(&self) -> [f64; 6] {
        [
            self.volume,
            self.area,
            self.edge_length,
            self.corners,
            self.edge_face,
            self.three_face,
        ]
    }
}

/// In a unit torus, or a large box with the borders left out of account. `edge` is a part of the side.
/// # Source
/// W. R. Franklin, "Analysis of mass properties of the union of millions of polyhedra", 2004.
pub(super) fn without_borders(cubes: f64, edge: f64) -> Rows {
    let bare = (-cubes * edge.powi(3)).exp();
    Rows {
        volume: 1.0 - bare,
        area: 6.0 * cubes * edge.powi(2) * bare,
        edge_length: (12.0 * cubes * edge + 12.0 * cubes.powi(2) * edge.powi(4)) * bare,
        corners: 8.0 * cubes * bare,
        edge_face: 24.0 * cubes.powi(2) * edge.powi(3) * bare,
        three_face: 8.0 * cubes.powi(3) * edge.powi(6) * bare,
    }
}

/// In a unit box that the lower corners lie in. `edge` is a part of the side.
pub(super) fn with_borders(cubes: f64, edge: f64) -> Rows {
    let rho = cubes * edge.powi(3);
    let bare = |t: f64| (-rho * t).exp();
    // All of space; a coordinate that `k` given cubes cover; a face of a cube at which `k` other cubes cover.
    let space = Depths::new(1.0 - edge, |_| 2.0 * edge);
    let covered = |k: i32| {
        Depths::new((1.0 - edge) * edge.powi(k), |t| {
            2.0 * edge * (t * edge).powi(k)
        })
    };
    let face = |k: i32| {
        Depths::new(2.0 * (1.0 - edge) * edge.powi(k), |t| {
            2.0 * edge * (t * edge).powi(k)
        })
    };
    let (face0, face1, face2) = (face(0), face(1), face(2));
    let (covered1, covered2) = (covered(1), covered(2));
    let convex = 3.0 * cubes * integral([&covered1, &face0, &face0], bare);
    let concave = 3.0 * cubes.powi(2) * integral([&covered2, &face1, &face1], bare);
    Rows {
        volume: integral([&space, &space, &space], |t| 1.0 - bare(t)),
        area: 3.0 * cubes * integral([&face0, &covered1, &covered1], bare),
        edge_length: convex + concave,
        corners: cubes * integral([&face0, &face0, &face0], bare),
        edge_face: 3.0 * cubes.powi(2) * integral([&face1, &face1, &face1], bare),
        three_face: cubes.powi(3) * integral([&face2, &face2, &face2], bare),
    }
}

/// How much of an axis lies at which depth `t`: points of quadrature and their weights.
struct Depths(Vec<[f64; 2]>);

impl Depths {
    /// Simpson's rule over the border, where `t` goes from 0 to 1, and all the rest at `t` = 1.
    fn new(rest: f64, density: impl Fn(f64) -> f64) -> Self {
        const STEPS: u32 = 64;
        let border = (0..=STEPS).map(|step| {
            let t = f64::from(step) / f64::from(STEPS);
            let weight = if step == 0 || step == STEPS {
                1.0
            } else {
                f64::from(2 + 2 * (step % 2))
            };
            [t, weight / (3.0 * f64::from(STEPS)) * density(t)]
        });
        Self(border.chain([[1.0, rest]]).collect())
    }
}

fn integral(axes: [&Depths; 3], function: impl Fn(f64) -> f64) -> f64 {
    let mut sum = 0.0;
    for [x, weight_x] in &axes[0].0 {
        for [y, weight_y] in &axes[1].0 {
            for [z, weight_z] in &axes[2].0 {
                sum += weight_x * weight_y * weight_z * function(x * y * z);
            }
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn borders_matter_less_in_a_larger_box() {
        let off = |cubes: f64, edge: f64| {
            let (without, with) = (without_borders(cubes, edge), with_borders(cubes, edge));
            let pairs = without.values().into_iter().zip(with.values());
            pairs
                .map(|(without, with)| (with / without - 1.0).abs())
                .fold(0.0, f64::max)
        };
        assert!(off(1e3, 0.1) < 0.5);
        assert!(off(1e9, 1e-3) < 0.01);
        assert!(off(1e12, 1e-4) < 1e-3);
    }
}
