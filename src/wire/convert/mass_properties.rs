//! Mass properties, as every answer and every command shows them.
//!
//! ```text
//!   Totals (exact integers) ── subtract and divide exactly ── one float each ── / steps_per_unit^k ── MassProperties
//! ```

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::derived::{centroid, inertia};
use super::numbers::float;
use super::settings::Settings;
use crate::geometry::{Bounds, EdgeKind, Measures, Totals, VertexKind};
use crate::wire::vector::Vector;

/// Lengths of the union's edges, in user units, each edge counted once as a set of points.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct EdgeLength {
    /// All edges.
    pub total: f64,
    /// Edges with one of four octants filled.
    pub convex: f64,
    /// Edges with three filled.
    pub concave: f64,
    /// Edges along which two solids meet.
    pub crossing: f64,
}

/// Lengths of the union's edges as decimal integers, in steps.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ExactEdgeLength {
    /// All edges.
    pub total: String,
    /// Edges with one of four octants filled.
    pub convex: String,
    /// Edges with three filled.
    pub concave: String,
    /// Edges along which two solids meet.
    pub crossing: String,
}

/// The box around all cubes, in user units.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct UserBounds {
    /// Least corner.
    #[schema(min_items = 3, max_items = 3)]
    pub min: [f64; 3],
    /// Greatest corner.
    #[schema(min_items = 3, max_items = 3)]
    pub max: [f64; 3],
}

/// Vertices of the union, by kind.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Vertices {
    /// All.
    pub total: i64,
    /// A cube's own corners.
    pub corner: i64,
    /// Where an edge goes through a face.
    pub edge_face: i64,
    /// Where three faces meet.
    pub three_face: i64,
    /// Where features coincide.
    pub degenerate: i64,
}

/// The exact integers, as decimal strings, in lattice steps. Moments are about the lattice origin.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Exact {
    /// Lattice steps in a user unit.
    #[schema(example = "1000")]
    pub steps_per_unit: String,
    /// Volume, in steps cubed.
    #[schema(example = "216000000000")]
    pub volume: String,
    /// Area, in steps squared.
    pub area: String,
    /// Area of the faces whose normal is along x, y, z.
    #[schema(min_items = 3, max_items = 3)]
    pub area_by_axis: [String; 3],
    /// Edge lengths, in steps.
    pub edge_length: ExactEdgeLength,
    /// Twice the integrals of x, y, z.
    #[schema(min_items = 3, max_items = 3)]
    pub first_moments2: [String; 3],
    /// Three times the integrals of x^2, y^2, z^2.
    #[schema(min_items = 3, max_items = 3)]
    pub second_moments3: [String; 3],
    /// Four times the integrals of xy, yz, zx.
    #[schema(min_items = 3, max_items = 3)]
    pub product_moments4: [String; 3],
}

/// What is measured of a solid, in user units: floats, for people.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct UserMeasures {
    /// Volume. Units: user units cubed.
    pub volume: f64,
    /// Area. Units: user units squared.
    pub area: f64,
    /// Lengths of the edges. Units: user units.
    pub edge_length: EdgeLength,
    /// Density times volume.
    pub mass: f64,
    /// Integral of the mean curvature. Units: user units.
    pub mean_curvature: f64,
    /// Centre of mass; null when there is no volume. Units: user units. `[x, y, z]`
    #[schema(min_items = 3, max_items = 3)]
    pub centroid: Option<[f64; 3]>,
    /// Inertia tensor about the centroid. Units: mass times user units squared. Rows `[[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]]`
    #[schema(inline, value_type = Vec<Vector>, min_items = 3, max_items = 3)]
    pub inertia: [[f64; 3]; 3],
}

/// What is counted of a solid, and its exact measures.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct IntegerMeasures {
    /// Pieces minus tunnels plus cavities of the closed set.
    pub euler_characteristic: i64,
    /// Number of vertices, by kind.
    pub vertices: Vertices,
    /// The exact integers.
    pub exact: Exact,
}

/// The mass properties of a union of cubes: floats in user units for people, and the exact integers for machines.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct MassProperties {
    /// The scene; null where there is none.
    #[schema(example = "pocket")]
    pub scene: Option<String>,
    /// The change they are as of; null where there is none.
    #[schema(example = 5)]
    pub seq: Option<u64>,
    /// Number of cubes, two at one place counted twice.
    pub cubes: u64,
    /// Of the union, in user units.
    #[serde(flatten)]
    pub user: UserMeasures,
    /// The box around all cubes; null when there is no cube.
    pub bounds: Option<UserBounds>,
    /// Of the union, exact.
    #[serde(flatten)]
    pub integers: IntegerMeasures,
    /// The union inside the stock; left out where there is no stock.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub removed: Option<PartProperties>,
    /// The stock outside the union; left out where there is no stock.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub remaining: Option<PartProperties>,
}

/// The mass properties of a part of the stock.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PartProperties {
    /// In user units.
    #[serde(flatten)]
    pub user: UserMeasures,
    /// Exact.
    #[serde(flatten)]
    pub integers: IntegerMeasures,
}

/// The mass properties as every answer and every command shows them.
pub fn mass_properties(
    scene: Option<&str>,
    seq: Option<u64>,
    totals: &Totals,
    settings: &Settings,
) -> MassProperties {
    let PartProperties { user, integers } = part_properties(&totals.measures, settings);
    let stock = totals.stock.as_ref();
    MassProperties {
        scene: scene.map(str::to_owned),
        seq,
        cubes: totals.cubes,
        user,
        bounds: totals.bounds.map(|Bounds { min, max }| UserBounds {
            min: settings.point_user(min),
            max: settings.point_user(max),
        }),
        integers,
        removed: stock.map(|stock| part_properties(&stock.removed, settings)),
        remaining: stock.map(|stock| part_properties(&stock.remaining, settings)),
    }
}

fn part_properties(measures: &Measures, settings: &Settings) -> PartProperties {
    let volume = settings.volume_user(measures.volume);
    let length = |steps: i128| float(steps) / settings.scale(1);
    let [convex, concave, crossing] = [EdgeKind::Convex, EdgeKind::Concave, EdgeKind::Crossing]
        .map(|kind| measures.edge_length_of(kind));
    let user = UserMeasures {
        volume,
        area: settings.area_user(measures.area()),
        edge_length: EdgeLength {
            total: length(measures.edge_length_total()),
            convex: length(convex),
            concave: length(concave),
            crossing: length(crossing),
        },
        mass: settings.density * volume,
        mean_curvature: std::f64::consts::FRAC_PI_4 * length(convex - concave - 2 * crossing),
        centroid: (measures.volume > 0).then(|| centroid(measures, settings)),
        inertia: inertia(measures, settings),
    };
    let integers = IntegerMeasures {
        euler_characteristic: measures.euler_characteristic(),
        vertices: Vertices {
            total: measures.vertices_total(),
            corner: measures.vertices_of(VertexKind::Corner),
            edge_face: measures.vertices_of(VertexKind::EdgeFace),
            three_face: measures.vertices_of(VertexKind::ThreeFace),
            degenerate: measures.vertices_of(VertexKind::Degenerate),
        },
        exact: Exact {
            steps_per_unit: settings.steps_per_unit.to_string(),
            volume: measures.volume.to_string(),
            area: measures.area().to_string(),
            area_by_axis: measures.area_by_axis.map(|area| area.to_string()),
            edge_length: ExactEdgeLength {
                total: measures.edge_length_total().to_string(),
                convex: convex.to_string(),
                concave: concave.to_string(),
                crossing: crossing.to_string(),
            },
            first_moments2: measures.first_moments2.map(|moment| moment.to_string()),
            second_moments3: measures.second_moments3.map(|moment| moment.to_string()),
            product_moments4: measures.product_moments4.map(|moment| moment.to_string()),
        },
    };
    PartProperties { user, integers }
}
