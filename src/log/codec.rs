//! The bytes of records: bodies as packed columns.
//!
//! Knows layouts only, never a file or a CRC. What it reads may be anything: every malformed input is an error, none a panic, and memory
//! stays in proportion to what a valid input of that length could mean.
//!
//! ```text
//! groups   version  encoding  count...  [raw length]  body
//!          1 byte   1 byte    varints   varint        raw, or a zstd frame when that is shorter
//! body     per group: ids, then what its kind has (cubes: x  y  z)    each the difference to the one before, folded to unsigned
//! ```
//! Bytes of equal weight lie together, so a column is as narrow as its largest difference without a bit of code per value, and
//! the high bytes, which hardly vary, cost nearly nothing once compressed.

use std::io::Read;

use super::bytes::{Malformed, Reader, count, put_varint};
use super::columns::{ColumnReader, ColumnWriter};
use super::kind::{Cubes, Kind, Named};
use crate::geometry::CubeId;

/// Most bodies in one record, a hull counted by its vertices, too. A hundred thousand times what a client sends, and still a blob that
/// SQLite takes (1e9 bytes).
pub const RECORD_CUBES_MAX: usize = 1 << 24;

const ID_BYTES_MAX: usize = 8;
/// Most columns of a group: each has a byte that says how wide it is.
const COLUMNS_MAX: usize = 16;
const _: () = assert!(RECORD_CUBES_MAX * (ID_BYTES_MAX + Cubes::BODY_BYTES_MAX) < 1_000_000_000);

const BODIES_VERSION: u8 = 1;
const RAW: u8 = 0;
const ZSTD: u8 = 1;
/// Below this a zstd frame does not pay for its header and its time.
const COMPRESSED_BYTES_MIN: usize = 1024;
const COMPRESSION_LEVEL: i32 = 1;
/// 8 MiB: more than level 1 uses, and the most memory a forged frame can ask for.
const WINDOW_LOG_MAX: u32 = 23;

/// Packs bodies; holds the buffers that packing needs, so that a change of one cube allocates nothing.
pub(super) struct Encoder {
    column: Vec<u64>,
    body: Vec<u8>,
    compressor: zstd::bulk::Compressor<'static>,
}

impl Encoder {
    pub(super) fn new() -> Self {
        Self {
            column: Vec::new(),
            body: Vec::new(),
            compressor: zstd::bulk::Compressor::new(COMPRESSION_LEVEL)
                .expect("level 1 exists, and memory for its context"),
        }
    }

    /// Appends `groups` of bodies to `to`, in their order. O(bodies).
    pub(super) fn encode<K: Kind, const N: usize>(
        &mut self,
        groups: [&[Named<K>]; N],
        context: &K::Context,
        to: &mut Vec<u8>,
    ) {
        self.body.clear();
        for group in groups {
            if !group.is_empty() {
                let mut columns = ColumnWriter::new(&mut self.column, &mut self.body);
                columns.put_differences(group.iter().map(|(id, _)| id.0.cast_signed()));
                K::put_bodies(group, context, &mut columns);
            }
        }
        let compressed = if self.body.len() < COMPRESSED_BYTES_MIN {
            None
        } else {
            // A failure to compress is no failure to store.
            let compressed = self.compressor.compress(&self.body).ok();
            compressed.filter(|compressed| compressed.len() < self.body.len())
        };
        to.extend([
            BODIES_VERSION,
            if compressed.is_some() { ZSTD } else { RAW },
        ]);
        for group in groups {
            put_varint(to, count(group.len()));
        }
        if let Some(compressed) = compressed {
            put_varint(to, count(self.body.len()));
            to.extend_from_slice(&compressed);
        } else {
            to.extend_from_slice(&self.body);
        }
    }
}

/// The groups of bodies that [`Encoder::encode`] packed.
/// # Errors
/// Whatever is not such a packing of bodies that stand on `context`.
pub(super) fn decode<K: Kind, const N: usize>(
    bytes: &[u8],
    context: &K::Context,
) -> Result<[Vec<Named<K>>; N], Malformed> {
    let mut reader = Reader(bytes);
    if reader.byte()? != BODIES_VERSION {
        return Err(Malformed("bodies of an unknown version"));
    }
    let encoding = reader.byte()?;
    let mut counts = [0; N];
    let mut total = 0_usize;
    for count in &mut counts {
        *count = usize::try_from(reader.varint()?).map_err(|_| Malformed("too many bodies"))?;
        total = total.saturating_add(*count);
    }
    if total > RECORD_CUBES_MAX {
        return Err(Malformed("too many bodies"));
    }
    let decompressed;
    let mut body = match encoding {
        RAW => reader,
        ZSTD => {
            let size_max = N * COLUMNS_MAX + total * (ID_BYTES_MAX + K::BODY_BYTES_MAX);
            decompressed = decompress(&mut reader, size_max)?;
            Reader(&decompressed)
        }
        _ => return Err(Malformed("bodies in an unknown encoding")),
    };
    let mut groups = [const { Vec::new() }; N];
    let mut columns = ColumnReader::new(&mut body);
    for (group, count) in groups.iter_mut().zip(counts) {
        if count > 0 {
            let ids = columns.read_differences(count, ID_BYTES_MAX)?;
            let ids = ids.map(|id| CubeId(id.cast_unsigned())).collect();
            *group = K::read_bodies(ids, context, &mut columns)?;
        }
    }
    body.finish()?;
    Ok(groups)
}

fn decompress(reader: &mut Reader<'_>, size_max: usize) -> Result<Vec<u8>, Malformed> {
    let malformed = |_| Malformed("a zstd frame that cannot be read");
    let size = usize::try_from(reader.varint()?).map_err(|_| Malformed("too long"))?;
    if size > size_max {
        return Err(Malformed("more bytes than its bodies can take"));
    }
    let mut decoder = zstd::stream::read::Decoder::with_buffer(reader.0).map_err(malformed)?;
    decoder.window_log_max(WINDOW_LOG_MAX).map_err(malformed)?;
    // Grows with what really comes out, not with what is claimed.
    let mut body = Vec::new();
    let read = decoder
        .take(count(size) + 1)
        .read_to_end(&mut body)
        .map_err(malformed)?;
    if read != size {
        return Err(Malformed("another length than it says"));
    }
    Ok(body)
}

/// The totals that a kind wrote, and nothing after them.
/// # Errors
/// Whatever is not that.
pub(super) fn totals<K: Kind>(bytes: &[u8]) -> Result<K::Totals, Malformed> {
    let mut reader = Reader(bytes);
    let totals = K::read_totals(&mut reader)?;
    reader.finish()?;
    Ok(totals)
}

#[cfg(test)]
mod tests {
    use ethnum::I256;

    use super::super::totals::put_totals;
    use super::*;
    use crate::geometry::{Bounds, Edge, Place, Totals};
    use crate::random::Random;

    type Cube = (CubeId, Place);

    fn edge() -> Edge {
        Edge::new(7).unwrap()
    }

    fn cube(id: u64, corner: [i64; 3]) -> Cube {
        (CubeId(id), Place::new(corner, edge()).unwrap())
    }

    fn encoded<const N: usize>(groups: [&[Cube]; N]) -> Vec<u8> {
        let mut bytes = Vec::new();
        Encoder::new().encode::<Cubes, N>(groups, &edge(), &mut bytes);
        bytes
    }

    fn scattered(count: usize, seed: u64) -> Vec<Cube> {
        let mut random = Random::new(seed);
        let mut coordinate = || random.within(-1 << 30, (1 << 30) - 1);
        (0..count)
            .map(|_| {
                let corner = [coordinate(), coordinate(), coordinate()];
                let id = u64::try_from(corner[0] + (1 << 30)).unwrap() << 33;
                let corner = corner.map(|c| c.min((1 << 30) - 7));
                cube(id, corner)
            })
            .collect()
    }

    fn extreme_totals() -> Totals {
        let mut totals = Totals {
            cubes: u64::MAX,
            bounds: Some(Bounds {
                min: [i32::MIN, -1, 0],
                max: [1, 255, i32::MAX],
            }),
            ..Totals::default()
        };
        let measures = &mut totals.measures;
        measures.volume = i128::MIN;
        measures.first_moments2 = [i128::MAX, -1, 1];
        measures.second_moments3 = [I256::MIN, I256::MAX, I256::from(-129)];
        measures.product_moments4 = [I256::from(127), I256::from(128), I256::from(-128)];
        measures.area_by_axis = [255, 256, -256];
        measures.edge_length = [[0, 1, -1], [32767, 32768, -32768], [-32769, 65535, 65536]];
        measures.euler8 = i64::MIN;
        measures.vertices = [i64::MAX, 0, -1, 1 << 40];
        totals
    }

    #[test]
    fn cubes_come_back_in_their_order() {
        let extremes = [
            cube(u64::MAX, [-(1 << 30), (1 << 30) - 7, 0]),
            cube(0, [(1 << 30) - 7, -(1 << 30), -1]),
            cube(1 << 63, [0; 3]),
        ];
        let path: Vec<_> = (0..5000)
            .map(|step| cube(step, [i64::try_from(step).unwrap() * 3, -4, 5]))
            .collect();
        let wild = scattered(3000, 1);
        for [deleted, inserted] in [
            [&[][..], &[]],
            [&[], &extremes],
            [&extremes[..1], &[]],
            [&path, &wild],
        ] {
            let bytes = encoded([deleted, inserted]);
            assert_eq!(
                decode::<Cubes, 2>(&bytes, &edge()),
                Ok([deleted.to_vec(), inserted.to_vec()])
            );
        }
        assert!(
            encoded([&path]).len() < 300,
            "a straight path is all pattern"
        );
        assert!(
            encoded([&wild]).len() < 20 * wild.len(),
            "20 bytes suffice for any cube"
        );
    }

    #[test]
    fn totals_come_back() {
        for expected in [Totals::default(), extreme_totals()] {
            let mut bytes = Vec::new();
            put_totals(&mut bytes, &expected);
            assert_eq!(totals::<Cubes>(&bytes), Ok(expected));
        }
    }

    /// Changing the bytes of either format needs a new version.
    #[test]
    fn formats_stay() {
        let hash = |bytes: &[u8]| (bytes.len(), crc32fast::hash(bytes));
        assert_eq!(
            encoded([&[cube(17, [1, -2, 300])], &[]]),
            [1, 0, 1, 0, 1, 34, 1, 2, 1, 3, 2, 0x58, 0x02]
        );
        let mut bytes = Vec::new();
        put_totals(&mut bytes, &extreme_totals());
        assert_eq!(hash(&bytes), TOTALS_GOLDEN);
    }

    const TOTALS_GOLDEN: (usize, u32) = (215, 3_937_642_181);

    #[test]
    fn malformed_bytes_are_errors() {
        let cubes = scattered(40, 2);
        let compressed = scattered(400, 3);
        let mut random = Random::new(4);
        for good in [
            encoded([&cubes, &cubes[..3]]),
            encoded([&compressed, &cubes]),
        ] {
            for length in 0..good.len() {
                assert!(
                    decode::<Cubes, 2>(&good[..length], &edge()).is_err(),
                    "cut at {length}"
                );
            }
            assert!(decode::<Cubes, 2>(&[&good[..], &[0]].concat(), &edge()).is_err());
            for _ in 0..20_000 {
                let mut bad = good.clone();
                let at = random.below(bad.len().min(64));
                bad[at] ^= random.next().to_le_bytes()[0];
                // Without a CRC a flipped byte may well be another valid packing; it must only not panic.
                drop(decode::<Cubes, 2>(&bad, &edge()));
            }
        }
        let mut forged = vec![BODIES_VERSION, RAW];
        put_varint(&mut forged, count(RECORD_CUBES_MAX));
        assert!(decode::<Cubes, 1>(&forged, &edge()).is_err());
        put_varint(&mut forged, u64::MAX);
        assert!(decode::<Cubes, 2>(&forged, &edge()).is_err());
        let mut good = Vec::new();
        put_totals(&mut good, &extreme_totals());
        for length in 0..good.len() {
            assert!(totals::<Cubes>(&good[..length]).is_err());
        }
        for _ in 0..20_000 {
            let mut bad = good.clone();
            let at = random.below(bad.len());
            bad[at] = random.next().to_le_bytes()[0];
            let _ = totals::<Cubes>(&bad);
        }
    }
}
