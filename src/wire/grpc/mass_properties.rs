//! Mass properties as messages, both ways. The values are those of the JSON: they are made in `convert` alone.

use crate::wire::convert::{
    EdgeLength, Exact, ExactEdgeLength, IntegerMeasures, MassProperties, PartProperties,
    UserBounds, UserMeasures, Vertices,
};
use crate::wire::proto;

/// A message that should be part of another and is not: its name.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{0} is missing")]
pub struct Missing(pub &'static str);

impl From<[f64; 3]> for proto::Vector {
    fn from([x, y, z]: [f64; 3]) -> Self {
        Self { x, y, z }
    }
}

impl From<proto::Vector> for [f64; 3] {
    fn from(vector: proto::Vector) -> Self {
        [vector.x, vector.y, vector.z]
    }
}

impl From<[[f64; 3]; 3]> for proto::InertiaTensor {
    fn from([[xx, xy, zx], [_, yy, yz], [_, _, zz]]: [[f64; 3]; 3]) -> Self {
        Self {
            xx,
            yy,
            zz,
            xy,
            yz,
            zx,
        }
    }
}

impl From<proto::InertiaTensor> for [[f64; 3]; 3] {
    fn from(tensor: proto::InertiaTensor) -> Self {
        let proto::InertiaTensor {
            xx,
            yy,
            zz,
            xy,
            yz,
            zx,
        } = tensor;
        [[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]]
    }
}

impl TryFrom<proto::Box> for UserBounds {
    type Error = Missing;

    fn try_from(bounds: proto::Box) -> Result<Self, Missing> {
        Ok(Self {
            min: bounds.min.ok_or(Missing("bounds.min"))?.into(),
            max: bounds.max.ok_or(Missing("bounds.max"))?.into(),
        })
    }
}

impl From<UserBounds> for proto::Box {
    fn from(UserBounds { min, max }: UserBounds) -> Self {
        Self {
            min: Some(min.into()),
            max: Some(max.into()),
        }
    }
}

impl From<MassProperties> for proto::MassProperties {
    fn from(properties: MassProperties) -> Self {
        let MassProperties {
            scene,
            seq,
            cubes,
            user,
            bounds,
            integers,
            removed,
            remaining,
        } = properties;
        let union = proto::PartProperties::from(PartProperties { user, integers });
        Self {
            scene: scene.unwrap_or_default(),
            seq: seq.unwrap_or_default(),
            cubes,
            volume: union.volume,
            area: union.area,
            edge_length: union.edge_length,
            mass: union.mass,
            mean_curvature: union.mean_curvature,
            centroid: union.centroid,
            inertia: union.inertia,
            bounds: bounds.map(Into::into),
            euler_characteristic: union.euler_characteristic,
            vertices: union.vertices,
            exact: union.exact,
            removed: removed.map(Into::into),
            remaining: remaining.map(Into::into),
        }
    }
}

impl TryFrom<proto::MassProperties> for MassProperties {
    type Error = Missing;

    fn try_from(message: proto::MassProperties) -> Result<Self, Missing> {
        let union = proto::PartProperties {
            volume: message.volume,
            area: message.area,
            edge_length: message.edge_length,
            mass: message.mass,
            mean_curvature: message.mean_curvature,
            centroid: message.centroid,
            inertia: message.inertia,
            euler_characteristic: message.euler_characteristic,
            vertices: message.vertices,
            exact: message.exact,
        };
        let PartProperties { user, integers } = union.try_into()?;
        Ok(Self {
            scene: Some(message.scene),
            seq: Some(message.seq),
            cubes: message.cubes,
            user,
            bounds: message.bounds.map(TryInto::try_into).transpose()?,
            integers,
            removed: message.removed.map(TryInto::try_into).transpose()?,
            remaining: message.remaining.map(TryInto::try_into).transpose()?,
        })
    }
}

impl From<PartProperties> for proto::PartProperties {
    fn from(part: PartProperties) -> Self {
        let PartProperties { user, integers } = part;
        let EdgeLength {
            total,
            convex,
            concave,
            crossing,
        } = user.edge_length;
        let vertices = integers.vertices;
        Self {
            volume: user.volume,
            area: user.area,
            edge_length: Some(proto::EdgeLength {
                total,
                convex,
                concave,
                crossing,
            }),
            mass: user.mass,
            mean_curvature: user.mean_curvature,
            centroid: user.centroid.map(Into::into),
            inertia: Some(user.inertia.into()),
            euler_characteristic: integers.euler_characteristic,
            vertices: Some(proto::Vertices {
                total: vertices.total,
                corner: vertices.corner,
                edge_face: vertices.edge_face,
                three_face: vertices.three_face,
                degenerate: vertices.degenerate,
            }),
            exact: Some(integers.exact.into()),
        }
    }
}

impl TryFrom<proto::PartProperties> for PartProperties {
    type Error = Missing;

    fn try_from(message: proto::PartProperties) -> Result<Self, Missing> {
        let edges = message.edge_length.ok_or(Missing("edge_length"))?;
        let vertices = message.vertices.ok_or(Missing("vertices"))?;
        Ok(Self {
            user: UserMeasures {
                volume: message.volume,
                area: message.area,
                edge_length: EdgeLength {
                    total: edges.total,
                    convex: edges.convex,
                    concave: edges.concave,
                    crossing: edges.crossing,
                },
                mass: message.mass,
                mean_curvature: message.mean_curvature,
                centroid: message.centroid.map(Into::into),
                inertia: message.inertia.ok_or(Missing("inertia"))?.into(),
            },
            integers: IntegerMeasures {
                euler_characteristic: message.euler_characteristic,
                vertices: Vertices {
                    total: vertices.total,
                    corner: vertices.corner,
                    edge_face: vertices.edge_face,
                    three_face: vertices.three_face,
                    degenerate: vertices.degenerate,
                },
                exact: message.exact.ok_or(Missing("exact"))?.try_into()?,
            },
        })
    }
}

impl From<Exact> for proto::ExactMeasures {
    fn from(exact: Exact) -> Self {
        let vector = |[x, y, z]: [String; 3]| Some(proto::ExactVector { x, y, z });
        let [xy, yz, zx] = exact.product_moments4;
        Self {
            steps_per_unit: exact.steps_per_unit,
            volume: exact.volume,
            area: exact.area,
            area_by_axis: vector(exact.area_by_axis),
            edge_length: Some(proto::ExactEdgeLength {
                total: exact.edge_length.total,
                convex: exact.edge_length.convex,
                concave: exact.edge_length.concave,
                crossing: exact.edge_length.crossing,
            }),
            first_moments2: vector(exact.first_moments2),
            second_moments3: vector(exact.second_moments3),
            product_moments4: Some(proto::ExactProducts { xy, yz, zx }),
        }
    }
}

impl TryFrom<proto::ExactMeasures> for Exact {
    type Error = Missing;

    fn try_from(message: proto::ExactMeasures) -> Result<Self, Missing> {
        let vector = |vector: Option<proto::ExactVector>, name| {
            let proto::ExactVector { x, y, z } = vector.ok_or(Missing(name))?;
            Ok([x, y, z])
        };
        let edges = message.edge_length.ok_or(Missing("exact.edge_length"))?;
        let products = message.product_moments4;
        let products = products.ok_or(Missing("exact.product_moments4"))?;
        Ok(Self {
            steps_per_unit: message.steps_per_unit,
            volume: message.volume,
            area: message.area,
            area_by_axis: vector(message.area_by_axis, "exact.area_by_axis")?,
            edge_length: ExactEdgeLength {
                total: edges.total,
                convex: edges.convex,
                concave: edges.concave,
                crossing: edges.crossing,
            },
            first_moments2: vector(message.first_moments2, "exact.first_moments2")?,
            second_moments3: vector(message.second_moments3, "exact.second_moments3")?,
            product_moments4: [products.xy, products.yz, products.zx],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::recount;
    use crate::geometry::Place;
    use crate::wire::convert::{Settings, SettingsDocument, StockDocument, mass_properties};

    #[test]
    fn mass_properties_come_back_as_they_went() {
        let stock = StockDocument {
            min: [0.0; 3],
            max: [4.0, 5.0, 6.0],
        };
        for stock in [None, Some(stock)] {
            let settings = Settings::check(&SettingsDocument {
                stock,
                ..SettingsDocument::with_edge(3.0)
            });
            let settings = settings.expect("these settings are good");
            for corners in [&[][..], &[[0, 0, 1], [1000, 2500, -7], [9000, 9000, 9000]]] {
                let places = corners.iter().map(|corner| {
                    Place::new(*corner, settings.edge()).expect("these places are on the lattice")
                });
                let totals = recount(settings.edge(), settings.stock(), places);
                let shown = mass_properties(Some("s"), Some(7), &totals, &settings);
                let message = proto::MassProperties::from(shown.clone());
                assert_eq!(MassProperties::try_from(message.clone()), Ok(shown));
                let broken = proto::MassProperties {
                    inertia: None,
                    ..message
                };
                let refused = MassProperties::try_from(broken);
                assert_eq!(refused, Err(Missing("inertia")));
            }
        }
    }
}
