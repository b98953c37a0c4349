//! What is sent: changes of random cubes, encoded before any clock runs.

use std::fmt::Write;

use bytes::Bytes;
use clap::ValueEnum;
use prost::Message;
use union3d::wire::proto::Change;

use crate::random::Random;

/// Edge of the cubes of every scene, and lattice steps in it.
pub(super) const EDGE: u32 = 1;
pub(super) const STEPS_PER_UNIT: i32 = 1_000;

/// Side of the box of random cubes. Units: edges.
#[derive(Clone, Copy, Debug)]
pub(super) struct Side(i32);

/// So that every step of it fits the lattice.
const SIDE_MAX: i32 = (1 << 30) / STEPS_PER_UNIT;

impl Side {
    /// A million cubes cover each point once on average.
    pub(super) const OF_A_MILLION: Self = Self(100);

    /// So many cubes cover each point once on average, or about that.
    pub(super) fn of(cubes: usize) -> Self {
        let holds = |side: i32| i64::from(side).pow(3) >= i64::try_from(cubes).unwrap_or(i64::MAX);
        Self((1..SIDE_MAX).find(|&side| holds(side)).unwrap_or(SIDE_MAX))
    }
}

/// The settings of every scene.
pub(super) fn scene() -> Bytes {
    format!("{{\"edge\":{EDGE},\"steps_per_unit\":{STEPS_PER_UNIT}}}").into()
}

/// How changes are written.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub(super) enum Protocol {
    /// JSON, a change a request
    Json,
    /// NDJSON, a line a cube
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

    /// More cubes a second than any server takes in changes of so many: what is made beforehand for a second.
    pub(super) fn cubes_a_second_max(self, batch: usize) -> usize {
        let limit = match self {
            Self::Json | Self::Ndjson => 1_000_000,
            Self::Protobuf | Self::Grpc => 2_000_000,
        };
        limit.min(batch * 15_000)
    }

    /// A change that inserts these cubes.
    pub(super) fn insert(self, cubes: &[Cube]) -> Bytes {
        let at = |cube: &Cube| cube.corner.map(units);
        match self {
            Self::Protobuf | Self::Grpc => replacing(&[], cubes).encode_to_vec().into(),
            Self::Json => {
                let mut text = String::from("{\"insert\":[");
                for (number, cube) in cubes.iter().enumerate() {
                    let comma = if number == 0 { "" } else { "," };
                    let [x, y, z] = at(cube);
                    write!(text, "{comma}{{\"id\":{},\"at\":[{x},{y},{z}]}}", cube.id)
                        .expect("a string takes everything");
                }
                text.push_str("]}");
                text.into()
            }
            Self::Ndjson => {
                let mut text = String::new();
                for cube in cubes {
                    let [x, y, z] = at(cube);
                    writeln!(
                        text,
                        "{{\"insert\":{{\"id\":{},\"at\":[{x},{y},{z}]}}}}",
                        cube.id
                    )
                    .expect("a string takes everything");
                }
                text.into()
            }
        }
    }
}

/// Steps as a decimal number of units.
fn units(steps: i32) -> String {
    format!("{}.{:03}", steps / STEPS_PER_UNIT, steps % STEPS_PER_UNIT)
}

/// A change that deletes cubes, and inserts others.
pub(super) fn replacing(deleted: &[Cube], inserted: &[Cube]) -> Change {
    let column = |axis: usize| inserted.iter().map(|cube| cube.corner[axis]).collect();
    Change {
        delete: deleted.iter().map(|cube| cube.id).collect(),
        insert_id: inserted.iter().map(|cube| cube.id).collect(),
        x: column(0),
        y: column(1),
        z: column(2),
        ..Change::default()
    }
}

/// The same as a body.
pub(super) fn replace(deleted: &[Cube], inserted: &[Cube]) -> Bytes {
    replacing(deleted, inserted).encode_to_vec().into()
}

/// A cube as clients name it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Cube {
    pub(super) id: u64,
    /// Units: steps, none negative.
    pub(super) corner: [i32; 3],
}

/// Random cubes in a box, with the ids from `first` on.
pub(super) fn cubes(first: u64, count: usize, side: Side, random: &mut Random) -> Vec<Cube> {
    let side = i64::from(side.0 * STEPS_PER_UNIT);
    let mut coordinate =
        || i32::try_from(random.within(0, side - 1)).expect("a side of the box fits 32 bits");
    let ids = (first..).take(count);
    ids.map(|id| Cube {
        id,
        corner: [coordinate(), coordinate(), coordinate()],
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_protocol_says_the_same() {
        let cubes = [Cube {
            id: 7,
            corner: [1_002, 30, 99_999],
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
    }
}
