//! Lists of cubes: numbered, shuffled, and read from a file of places.

use std::path::Path;

use union3d::geometry::{CubeId, Edge, Place};

use super::failure::{Failure, about};
use super::random::Random;
use super::sets::Cube;

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

/// The lower corners of a file of little-endian 32-bit triplets, in steps: what `union3d mill --out` writes.
/// # Errors
/// The file cannot be read, is no list of triplets, or a cube is outside the lattice.
pub(crate) fn read(path: &Path, edge: Edge) -> Result<Vec<Place>, Failure> {
    let bytes = std::fs::read(path).map_err(about(path))?;
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
