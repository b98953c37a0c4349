//! The mass properties of a union of solids, as answers and commands show them.
//!
//! Floats are made last. Moments are moved to the lattice point nearest to the centre of mass in integers first, so that a small part far
//! from the origin loses nothing.

use ethnum::I256;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::scale::Scale;
use crate::engine::solids::{AREA_UNIT, ErrorMax, LENGTH_UNIT, Measures, Totals, VOLUME_UNIT};
use crate::wire::convert::{UserBounds, float, float256};
use crate::wire::vector::Vector;

/// Lengths of the union's edges. An ordinary edge counts once, one along which two solids touch twice. Units: user units.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct SolidEdgeLength {
    /// All edges.
    pub total: f64,
    /// Edges where the union fills less than half of the space around.
    pub convex: f64,
    /// Edges where it fills more.
    pub concave: f64,
    /// Edges along which more than two faces meet.
    pub crossing: f64,
}

/// How far rounding to fixed-point integers can be off, at most, in user units.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ErrorBounds {
    /// Of the volume. Units: user units cubed.
    pub volume: f64,
    /// Of the area. Units: user units squared.
    pub area: f64,
    /// Of each edge length. Units: user units.
    pub edge_length: f64,
    /// Of each coordinate of the centroid; it grows with the distance from the origin. Units: user units.
    pub centroid: f64,
    /// Of each component of the inertia tensor; it grows with the distance from the origin. Units: mass times user units squared.
    pub inertia: f64,
}

/// One measure, or several of a kind, as fixed-point integers: divided by `divisor` they are in lattice steps to their power.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct FixedPoint<T> {
    /// The integers, in decimal.
    pub value: T,
    /// What to divide them by.
    #[schema(example = "96")]
    pub divisor: String,
    /// How far rounding can be off, at most, in the integers' unit.
    #[schema(example = "192")]
    pub error_max: String,
}

/// The exact state: a function of the set of solids alone, whatever the order in which they came. Moments are about the lattice origin.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ExactSolids {
    /// Lattice steps in a user unit.
    pub steps_per_unit: String,
    /// Volume.
    #[schema(inline)]
    pub volume: FixedPoint<String>,
    /// Area.
    #[schema(inline)]
    pub area: FixedPoint<String>,
    /// Edge lengths: convex, concave, crossing.
    #[schema(inline, value_type = FixedPoint<Vec<String>>)]
    pub edge_length: FixedPoint<[String; 3]>,
    /// Integrals of x, y, z.
    #[schema(inline, value_type = FixedPoint<Vec<String>>)]
    pub first_moments: FixedPoint<[String; 3]>,
    /// Integrals of xx, yy, zz, xy, yz, zx.
    #[schema(inline, value_type = FixedPoint<Vec<String>>)]
    pub second_moments: FixedPoint<[String; 6]>,
}

/// What is measured of a union of solids, or of a part of the stock: floats in user units for people, and the exact integers for machines.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct SolidMeasures {
    /// Volume. Units: user units cubed.
    pub volume: f64,
    /// Area. Units: user units squared.
    pub area: f64,
    /// Lengths of the edges.
    pub edge_length: SolidEdgeLength,
    /// Density times volume.
    pub mass: f64,
    /// Centre of mass; null when there is no volume. Units: user units. `[x, y, z]`
    #[schema(min_items = 3, max_items = 3)]
    pub centroid: Option<[f64; 3]>,
    /// Inertia tensor about the centroid. Units: mass times user units squared. Rows `[[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]]`
    #[schema(inline, value_type = Vec<Vector>, min_items = 3, max_items = 3)]
    pub inertia: [[f64; 3]; 3],
    /// How far rounding can be off.
    pub error_max: ErrorBounds,
    /// The exact integers.
    pub exact: ExactSolids,
}

/// The mass properties of a union of solids; of a scene with a stock, of what they remove from it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct SolidProperties {
    /// The scene; null where there is none.
    #[schema(example = "milled")]
    pub scene: Option<String>,
    /// The change they are as of; null where there is none.
    #[schema(example = 5)]
    pub seq: Option<u64>,
    /// Number of solids, two of the same body counted twice.
    pub solids: u64,
    /// Of the union, cut to the stock where there is one.
    #[serde(flatten)]
    pub measures: SolidMeasures,
    /// The box around all solids, wherever the stock is; null when there is none.
    pub bounds: Option<UserBounds>,
}

/// The mass properties of a scene of solids.
#[derive(Serialize, ToSchema)]
pub struct SolidSceneProperties {
    /// Of the union, cut to the stock where there is one.
    #[serde(flatten)]
    pub measured: SolidProperties,
    /// What the solids have in common with the stock: the same measures once more, under the name that they have in a scene of cubes. Left
    /// out where there is no stock.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub removed: Option<SolidMeasures>,
    /// The stock outside the solids; left out where there is no stock.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub remaining: Option<SolidMeasures>,
}

// Divisors of the integers in steps to their power.
const VOLUME_DIVISOR: i128 = 6 << -VOLUME_UNIT;
const AREA_DIVISOR: i128 = 2 << -AREA_UNIT;
const LENGTH_DIVISOR: i128 = 2 << -LENGTH_UNIT;
const FIRST_DIVISOR: i128 = 24 << -VOLUME_UNIT;
const SECOND_DIVISOR: i128 = 120 << -VOLUME_UNIT;

/// A volume in the unit of [`Measures::volume6`] in user units cubed.
pub fn solid_volume(volume6: i128, scale: Scale) -> f64 {
    float(volume6) / (float(VOLUME_DIVISOR) * scale.power(3))
}

/// An area in the unit of [`Measures::area2`] in user units squared.
pub fn solid_area(area2: i128, scale: Scale) -> f64 {
    float(area2) / (float(AREA_DIVISOR) * scale.power(2))
}

/// The mass properties of totals.
pub fn solid_properties(
    scene: Option<&str>,
    seq: Option<u64>,
    (totals, error_max): (&Totals, &ErrorMax),
    scale: Scale,
    density: f64,
) -> SolidProperties {
    let corner = |steps: [i32; 3]| steps.map(|steps| scale.user(steps.into()));
    SolidProperties {
        scene: scene.map(str::to_owned),
        seq,
        solids: totals.solids,
        measures: solid_measures((&totals.measures, error_max), scale, density),
        bounds: totals.bounds.map(|bounds| UserBounds {
            min: corner(bounds.min),
            max: corner(bounds.max),
        }),
    }
}

/// The mass properties of totals, with the parts of the stock where there is one.
pub fn solid_scene_properties(
    scene: Option<&str>,
    seq: Option<u64>,
    (totals, error_max): (&Totals, &ErrorMax),
    scale: Scale,
    density: f64,
) -> SolidSceneProperties {
    let measured = solid_properties(scene, seq, (totals, error_max), scale, density);
    let part = |measures| solid_measures((measures, error_max), scale, density);
    let remaining = totals.remaining.as_ref().map(part);
    SolidSceneProperties {
        removed: remaining.is_some().then(|| measured.measures.clone()),
        measured,
        remaining,
    }
}

/// Measures in user units.
fn solid_measures(
    (measures, error_max): (&Measures, &ErrorMax),
    scale: Scale,
    density: f64,
) -> SolidMeasures {
    let user = |integer: i128, divisor: i128, power: usize| {
        float(integer) / (float(divisor) * scale.power(power))
    };
    let error = |integer: u128, divisor: i128, power: usize| {
        user(i128::try_from(integer).unwrap_or(i128::MAX), divisor, power)
    };
    let volume = solid_volume(measures.volume6, scale);
    let length = |integer: i128| user(integer, LENGTH_DIVISOR, 1);
    let [convex, concave, crossing] = measures.edge_length2;
    let central = Central::of(measures);
    let central_error = central
        .as_ref()
        .map(|central| central.error_max(measures, error_max));
    let (centroid_error, inertia_error) = central_error.unwrap_or_default();
    let position = |steps: f64| steps / scale.power(1);
    // The density comes last: a tiny one would leave nothing of the rest.
    let moment = |steps5: f64| steps5 / scale.power(5) * density;
    SolidMeasures {
        volume,
        area: solid_area(measures.area2, scale),
        edge_length: SolidEdgeLength {
            total: length(measures.edge_length2_total()),
            convex: length(convex),
            concave: length(concave),
            crossing: length(crossing),
        },
        mass: density * volume,
        centroid: central
            .as_ref()
            .map(|central| central.centroid.map(position)),
        inertia: central.map_or([[0.0; 3]; 3], |central| {
            central.inertia.map(|row| row.map(moment))
        }),
        error_max: ErrorBounds {
            volume: error(error_max.volume6, VOLUME_DIVISOR, 3),
            area: error(error_max.area2, AREA_DIVISOR, 2),
            edge_length: error(error_max.edge_length2, LENGTH_DIVISOR, 1),
            centroid: position(centroid_error),
            inertia: moment(inertia_error),
        },
        exact: exact(measures, error_max, scale),
    }
}

fn exact(measures: &Measures, error_max: &ErrorMax, scale: Scale) -> ExactSolids {
    fn fixed<T>(value: T, divisor: i128, error_max: u128) -> FixedPoint<T> {
        FixedPoint {
            value,
            divisor: divisor.to_string(),
            error_max: error_max.to_string(),
        }
    }
    let text = |integer: I256| integer.to_string();
    ExactSolids {
        steps_per_unit: scale.steps_per_unit().to_string(),
        volume: fixed(
            measures.volume6.to_string(),
            VOLUME_DIVISOR,
            error_max.volume6,
        ),
        area: fixed(measures.area2.to_string(), AREA_DIVISOR, error_max.area2),
        edge_length: fixed(
            measures.edge_length2.map(|length| length.to_string()),
            LENGTH_DIVISOR,
            error_max.edge_length2,
        ),
        first_moments: fixed(
            measures.first_moments24.map(text),
            FIRST_DIVISOR,
            error_max.first_moments24,
        ),
        second_moments: fixed(
            measures.second_moments120.map(text),
            SECOND_DIVISOR,
            error_max.second_moments120,
        ),
    }
}

/// Centre of mass and moments about it. Units: steps.
struct Central {
    centroid: [f64; 3],
    /// For a density of 1.
    inertia: [[f64; 3]; 3],
}

impl Central {
    /// How far rounding of the integers can put off a coordinate of the centroid and a component of the inertia, at most.
    ///
    /// With bounds v, f and s of the integers' errors, and all coordinates of the centre below C in size: F' is off by
    /// (f + 4 C v) / 384, and a second moment about the centre by (s + 10 C f + 20 C C v) / 1920 and, because the centre is within one step of
    /// c, by that of F' again. A component of the inertia is a sum of two of them.
    fn error_max(&self, measures: &Measures, error_max: &ErrorMax) -> (f64, f64) {
        let wide = |integer: u128| float(i128::try_from(integer).unwrap_or(i128::MAX));
        let [v, f, s] = [
            error_max.volume6,
            error_max.first_moments24,
            error_max.second_moments120,
        ]
        .map(wide);
        let far = self
            .centroid
            .iter()
            .fold(1.0, |far: f64, at| far.max(at.abs() + 1.0));
        let volume = float(measures.volume6) / float(VOLUME_DIVISOR);
        let first = (f + 4.0 * far * v) / float(FIRST_DIVISOR);
        let second = (s + 10.0 * far * f + 20.0 * far * far * v) / float(SECOND_DIVISOR);
        (first / volume, 2.0 * (second + first))
    }

    /// None when there is no volume.
    ///
    /// With v, f and s the integers of volume, first and second moments, in steps V = v / 96, F = f / 384 and S = s / 1920. About a lattice point c:
    /// F' = F - c V and S' = S - c F - F c + c c V, that is f' = f - 4 c v and s' = s - 5 (c f + f c) + 20 c c v, exact.
    fn of(measures: &Measures) -> Option<Self> {
        let volume = I256::from(measures.volume6);
        if volume <= I256::ZERO {
            return None;
        }
        let first = measures.first_moments24;
        let near = first.map(|moment| rounded(moment, 4 * volume));
        let rest = [0, 1, 2].map(|axis| first[axis] - 4 * near[axis] * volume);
        // Both are small: the quotient is below one step.
        let offset = rest.map(|moment| float256(moment) / float256(4 * volume));
        let centroid = [0, 1, 2].map(|axis| float256(near[axis]) + offset[axis]);
        // The integrals of xx, yy, zz, xy, yz, zx about the centre of mass.
        let pairs = [[0, 0], [1, 1], [2, 2], [0, 1], [1, 2], [2, 0]];
        let mut second = [0.0; 6];
        for (index, [a, b]) in pairs.into_iter().enumerate() {
            let about_near = measures.second_moments120[index]
                - 5 * (near[a] * first[b] + near[b] * first[a])
                + 20 * near[a] * near[b] * volume;
            second[index] = float256(about_near) / float(SECOND_DIVISOR)
                - offset[a] * offset[b] * float256(volume) / float(VOLUME_DIVISOR);
        }
        let [xx, yy, zz, xy, yz, zx] = second;
        // No -0.0.
        let product = |moment: f64| 0.0 - moment;
        Some(Self {
            centroid,
            inertia: [
                [yy + zz, product(xy), product(zx)],
                [product(xy), zz + xx, product(yz)],
                [product(zx), product(yz), xx + yy],
            ],
        })
    }
}

// The derivation above is for these units.
const _: () = assert!(VOLUME_DIVISOR == 96 && FIRST_DIVISOR == 384 && SECOND_DIVISOR == 1920);

/// The whole number nearest to a quotient. The divisor is positive.
fn rounded(dividend: I256, divisor: I256) -> I256 {
    (2 * dividend + divisor).div_euclid(2 * divisor)
}
