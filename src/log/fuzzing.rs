//! What fuzzers look at inside the log: readers of bytes that may be anything. No part of the log's interface.

use std::io::Read;

use super::codec::{self, Encoder};
use super::kind::{Cubes, Kind};
use super::totals;
use super::wal::{self, WriteAhead};
use crate::geometry::Edge;

/// Packed cubes and numbers. The first byte says which: operations, a chunk, totals, a stock, or a volume. What can be read comes
/// back when it is written and read again.
/// # Panics
/// When it does not.
pub fn codec(bytes: &[u8]) {
    let Some((kind, body)) = bytes.split_first() else {
        return;
    };
    let mut again = Vec::new();
    match kind {
        b'o' => groups::<2>(body),
        b'k' => groups::<1>(body),
        b't' => {
            if let Ok(totals) = codec::totals::<Cubes>(body) {
                totals::put_totals(&mut again, &totals);
                assert_eq!(codec::totals::<Cubes>(&again), Ok(totals));
            }
        }
        b's' => {
            if let Ok(stock) = Cubes::read_stock(body) {
                Cubes::put_stock(&mut again, &stock);
                assert_eq!(Cubes::read_stock(&again), Ok(stock));
            }
        }
        _ => {
            if let Ok(volume) = totals::volume(body) {
                totals::put_volume(&mut again, volume);
                assert_eq!(totals::volume(&again), Ok(volume));
            }
        }
    }
}

fn groups<const N: usize>(body: &[u8]) {
    let edge = Edge::new(3).expect("an edge");
    if let Ok(groups) = codec::decode::<Cubes, N>(body, &edge) {
        let mut again = Vec::new();
        let cubes = std::array::from_fn(|index| &*groups[index]);
        Encoder::new().encode::<Cubes, N>(cubes, &edge, &mut again);
        assert_eq!(codec::decode::<Cubes, N>(&again, &edge), Ok(groups));
    }
}

/// A write-ahead file, with the size of pages that it says: what is found lies inside it.
/// # Panics
/// When it does not.
pub fn wal(bytes: &[u8]) {
    let size = bytes.get(8..12).and_then(|size| size.try_into().ok());
    let size = size.map_or(0, u32::from_be_bytes);
    let size = usize::try_from(size).unwrap_or(0).clamp(512, 1 << 16);
    let found = wal::inspect_bytes(&mut bytes.take(u64::MAX), size).expect("memory can be read");
    let frames = bytes.len().div_ceil(24 + size);
    let within = |count: u64, end: usize| usize::try_from(count).is_ok_and(|count| count <= end);
    match found {
        WriteAhead::Empty | WriteAhead::Whole | WriteAhead::Broken { frame: None, .. } => {}
        WriteAhead::Torn {
            frames: torn,
            bytes: size,
        } => assert!(within(torn, frames) && within(size, bytes.len())),
        WriteAhead::Broken {
            frame: Some(frame), ..
        } => assert!(within(frame, frames)),
    }
}
