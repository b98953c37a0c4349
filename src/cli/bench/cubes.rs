//! Where the cubes of a benchmark come from: a workload, a G-code file, or a file of places.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use union3d::geometry::{CubeId, Edge, Place};
use union3d::toolpath::{Event, Motion, Moves};
use union3d::wire::convert::{Anchor, Settings, WantedSettings};

use super::random::Random;
use super::sets::Cube;
use crate::cli::cutter::{Cutter, STEPS_PER_EDGE, Unit};
use crate::cli::input;

type Failure = Box<dyn std::error::Error>;

/// Cubes numbered from 0 in the order they come.
pub(crate) fn numbered(places: impl IntoIterator<Item = Place>) -> Vec<Cube> {
    (0..).map(CubeId).zip(places).collect()
}

/// The same in a random order.
pub(crate) fn shuffled(cubes: &[Cube], seed: u64) -> Vec<Cube> {
    let mut random = Random::new(seed);
    let mut cubes = cubes.to_vec();
    for last in (1..cubes.len()).rev() {
        let other = random.below(last as u64 + 1);
        cubes.swap(last, usize::try_from(other).expect("it was a usize"));
    }
    cubes
}

/// The settings of a scene in millimetres, for cubes of this edge.
pub(crate) fn settings(edge: f64, steps_per_unit: u32) -> Result<Settings, Failure> {
    let wanted = WantedSettings {
        steps_per_unit: steps_per_unit.into(),
        anchor: Anchor::Center,
        ..WantedSettings::with_edge(edge)
    };
    Ok(Settings::check(wanted).map_err(|faults| input::faults(&faults))?)
}

/// The places of a cubic cutter along the feed moves of a program, as `union3d mill` has them.
pub(crate) fn milled(path: &Path, edge: f64) -> Result<(Edge, Vec<Place>), Failure> {
    let settings = settings(edge, 1000)?;
    let mut cutter = Cutter::new(&settings, Unit::Mm, edge / STEPS_PER_EDGE);
    let file = File::open(path).map_err(input::about(path))?;
    let mut places = Vec::new();
    for event in Moves::new(BufReader::new(file)) {
        let event = event.map_err(|error| format!("{}: {error}", path.display()))?;
        if let Event::Move(next) = event
            && next.motion != Motion::Rapid
        {
            for place in cutter.places(&next) {
                places.push(place?);
            }
        }
    }
    if places.is_empty() {
        return Err(format!("{}: nothing is cut in it", path.display()).into());
    }
    Ok((settings.edge(), places))
}

/// The lower corners of a file of little-endian 32-bit triplets.
pub(crate) fn read(path: &Path, edge: Edge) -> Result<Vec<Place>, Failure> {
    let bytes = std::fs::read(path).map_err(input::about(path))?;
    let (coordinates, rest) = bytes.as_chunks::<4>();
    let (triplets, incomplete) = coordinates.as_chunks::<3>();
    if !rest.is_empty() || !incomplete.is_empty() || triplets.is_empty() {
        return Err(format!(
            "{}: {} bytes are no list of cubes, 12 bytes each",
            path.display(),
            bytes.len()
        )
        .into());
    }
    let place = |triplet: &[[u8; 4]; 3]| {
        Place::new(
            triplet.map(|bytes| i64::from(i32::from_le_bytes(bytes))),
            edge,
        )
    };
    let places: Result<Vec<Place>, _> = triplets.iter().map(place).collect();
    Ok(places.map_err(|invalid| format!("{}: {invalid}", path.display()))?)
}
