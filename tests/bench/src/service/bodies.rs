//! What is sent: changes of cubes or of solids, encoded before any clock runs.

use std::fmt::Write;

use bytes::Bytes;
use clap::ValueEnum;
use prost::Message;
use union3d::wire::proto::Change;

use crate::milling::STEPS_PER_MM;
use crate::random::Random;

/// Edge of the cubes of every scene.
pub(super) const EDGE: u32 = 1;

/// The shape of all solids.
pub(super) const SHAPE: &str = "tool";

/// Scenes that are measured.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub(super) enum Kind {
    /// Equal cubes
    Cubes,
    /// Solids: what a tool sweeps
    Solids,
}

impl Kind {
    /// What bodies are called; the server, too, counts them under this name.
    pub(super) fn plural(self) -> &'static str {
        match self {
            Self::Cubes => "cubes",
            Self::Solids => "solids",
        }
    }

    /// Lattice steps in a unit.
    pub(super) const fn steps_per_unit(self) -> i32 {
        match self {
            Self::Cubes => 1_000,
            Self::Solids => STEPS_PER_MM,
        }
    }
}

/// Side of the box of random cubes. Units: edges.
#[derive(Clone, Copy, Debug)]
pub(super) struct Side(i32);

/// So that every step of it fits the lattice.
const SIDE_MAX: i32 = (1 << 30) / Kind::Cubes.steps_per_unit();

impl Side {
    /// A million cubes cover each point once on average.
    pub(super) const OF_A_MILLION: Self = Self(100);

    /// So many cubes cover each point once on average, or about that.
    pub(super) fn of(cubes: usize) -> Self {
        let holds = |side: i32| i64::from(side).pow(3) >= i64::try_from(cubes).unwrap_or(i64::MAX);
        Self((1..SIDE_MAX).find(|&side| holds(side)).unwrap_or(SIDE_MAX))
    }
}

/// How changes are written.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub(super) enum Protocol {
    /// JSON, a change a request
    Json,
    /// NDJSON, a line a body
    Ndjson,
    /// Protobuf over HTTP, a change a request
    Protobuf,
    /// gRPC, a stream of changes a client
    Grpc,
}

impl Protocol {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Json => "JSON",
            Self::Ndjson => "NDJSON",
            Self::Protobuf => "protobuf",
            Self::Grpc => "gRPC",
        }
    }

    pub(super) fn content_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Ndjson => "application/x-ndjson",
            Self::Protobuf | Self::Grpc => "application/x-protobuf",
        }
    }

    /// More bodies a second than any server takes in changes of so many: what is made beforehand for a second.
    pub(super) fn bodies_a_second_max(self, kind: Kind, batch: usize) -> usize {
        let limit = match (kind, self) {
            (Kind::Cubes, Self::Json | Self::Ndjson) => 1_000_000,
            (Kind::Cubes, Self::Protobuf | Self::Grpc) => 2_000_000,
            (Kind::Solids, _) => 30_000,
        };
        limit.min(batch * 15_000)
    }

    /// A change that inserts these bodies.
    pub(super) fn insert(self, bodies: &[Body]) -> Bytes {
        let text = |take: fn(&mut String, usize, &Body) -> std::fmt::Result| {
            let mut text = String::new();
            for (number, body) in bodies.iter().enumerate() {
                take(&mut text, number, body).expect("a string takes everything");
            }
            text
        };
        match self {
            Self::Protobuf | Self::Grpc => replacing(&[], bodies).encode_to_vec().into(),
            Self::Json => {
                let bodies = text(|text, number, body| {
                    let comma = if number == 0 { "" } else { "," };
                    write!(text, "{comma}{}", body.document())
                });
                format!("{{\"insert\":[{bodies}]}}").into()
            }
            Self::Ndjson => {
                text(|text, _, body| writeln!(text, "{{\"insert\":{}}}", body.document())).into()
            }
        }
    }
}

/// Steps as a decimal number of units.
fn units(steps: i32, kind: Kind) -> String {
    let steps_per_unit = kind.steps_per_unit().unsigned_abs();
    let digits = steps_per_unit.ilog10() as usize;
    let sign = if steps < 0 { "-" } else { "" };
    let (whole, part) = (
        steps.unsigned_abs() / steps_per_unit,
        steps.unsigned_abs() % steps_per_unit,
    );
    format!("{sign}{whole}.{part:0digits$}")
}

/// A change that deletes bodies, and inserts others, all of one kind.
pub(super) fn replacing(deleted: &[Body], inserted: &[Body]) -> Change {
    let column = |axis: usize| inserted.iter().map(|body| body.at[axis]).collect();
    let to = |axis: usize| {
        inserted
            .iter()
            .filter_map(|body| Some(body.to?[axis]))
            .collect()
    };
    let of_shapes = inserted.iter().any(|body| body.to.is_some());
    Change {
        delete: deleted.iter().map(|body| body.id).collect(),
        insert_id: inserted.iter().map(|body| body.id).collect(),
        x: column(0),
        y: column(1),
        z: column(2),
        shapes: of_shapes.then(|| SHAPE.to_owned()).into_iter().collect(),
        to_x: to(0),
        to_y: to(1),
        to_z: to(2),
        ..Change::default()
    }
}

/// The same as a body of a request.
pub(super) fn replace(deleted: &[Body], inserted: &[Body]) -> Bytes {
    replacing(deleted, inserted).encode_to_vec().into()
}

/// A cube or a solid as clients name it. Units: steps.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Body {
    pub(super) id: u64,
    /// The corner of a cube, or where the tool of a solid comes from.
    pub(super) at: [i32; 3],
    /// Where it goes; a cube goes nowhere.
    pub(super) to: Option<[i32; 3]>,
}

impl Body {
    /// As JSON.
    fn document(&self) -> String {
        let point = |at: [i32; 3], kind| at.map(|steps| units(steps, kind)).join(",");
        let Self { id, at, to } = *self;
        match to {
            None => format!("{{\"id\":{id},\"at\":[{}]}}", point(at, Kind::Cubes)),
            Some(to) => format!(
                "{{\"id\":{id},\"shape\":\"{SHAPE}\",\"from\":[{}],\"to\":[{}]}}",
                point(at, Kind::Solids),
                point(to, Kind::Solids)
            ),
        }
    }
}

/// Random cubes in a box, with the ids from `first` on.
pub(super) fn cubes(first: u64, count: usize, side: Side, random: &mut Random) -> Vec<Body> {
    let side = i64::from(side.0 * Kind::Cubes.steps_per_unit());
    let mut coordinate =
        || i32::try_from(random.within(0, side - 1)).expect("a side of the box fits 32 bits");
    let ids = (first..).take(count);
    ids.map(|id| Body {
        id,
        at: [coordinate(), coordinate(), coordinate()],
        to: None,
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_protocol_says_the_same_of_cubes() {
        let cubes = [Body {
            id: 7,
            at: [1_002, 30, 99_999],
            to: None,
        }];
        assert_eq!(
            Protocol::Json.insert(&cubes),
            "{\"insert\":[{\"id\":7,\"at\":[1.002,0.030,99.999]}]}"
        );
        assert_eq!(
            Protocol::Ndjson.insert(&cubes),
            "{\"insert\":{\"id\":7,\"at\":[1.002,0.030,99.999]}}\n"
        );
        let change = Change::decode(Protocol::Protobuf.insert(&cubes)).unwrap();
        assert_eq!((change.insert_id, change.x), (vec![7], vec![1_002]));
        assert_eq!((change.y, change.z), (vec![30], vec![99_999]));
        assert!(change.shapes.is_empty() && change.to_x.is_empty());
    }

    #[test]
    fn every_protocol_says_the_same_of_solids() {
        let solid = |id| Body {
            id,
            at: [-10_020, 3, 0],
            to: Some([70_000, -5, -1]),
        };
        let one =
            "\"shape\":\"tool\",\"from\":[-1.0020,0.0003,0.0000],\"to\":[7.0000,-0.0005,-0.0001]}";
        assert_eq!(
            Protocol::Json.insert(&[solid(7), solid(8)]),
            format!("{{\"insert\":[{{\"id\":7,{one},{{\"id\":8,{one}]}}")
        );
        assert_eq!(
            Protocol::Ndjson.insert(&[solid(7)]),
            format!("{{\"insert\":{{\"id\":7,{one}}}\n")
        );
        let change = Change::decode(Protocol::Protobuf.insert(&[solid(7)])).unwrap();
        assert_eq!(
            (change.shapes, change.shape),
            (vec!["tool".to_owned()], vec![])
        );
        assert_eq!(
            [change.x, change.y, change.z],
            [vec![-10_020], vec![3], vec![0]]
        );
        assert_eq!(
            [change.to_x, change.to_y, change.to_z],
            [vec![70_000], vec![-5], vec![-1]]
        );
    }
}
