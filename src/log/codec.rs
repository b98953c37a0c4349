//! The bytes of records: bodies as packed columns, totals as short integers.
//!
//! Knows layouts only, never a file or a CRC. What it reads may be anything: every malformed input is an error, none a panic, and memory
//! stays in proportion to what a valid input of that length could mean.
//!
//! ```text
//! groups   version  encoding  count...  [raw length]  body
//!          1 byte   1 byte    varints   varint        raw, or a zstd frame when that is shorter
//! body     per group: ids, then what its kind has (cubes: x  y  z)    each the difference to the one before, folded to unsigned
//! column   width  all lowest bytes  all second bytes  ...   `width` of them
//! ```
//! Bytes of equal weight lie together, so a column is as narrow as its largest difference without a bit of code per value, and
//! the high bytes, which hardly vary, cost nearly nothing once compressed.

use std::io::Read;

use ethnum::I256;

use super::kind::{Cubes, Kind, Named};
use crate::geometry::{Bounds, CubeId, Measures, Stock, StockMeasures, Totals};

/// Most bodies in one record, a hull counted by its vertices, too. A hundred thousand times what a client sends, and still a blob that
/// SQLite takes (1e9 bytes).
pub const RECORD_CUBES_MAX: usize = 1 << 24;

const ID_BYTES_MAX: usize = 8;
/// Most columns of a group: each has a byte that says how wide it is.
const COLUMNS_MAX: usize = 16;
const _: () = assert!(RECORD_CUBES_MAX * (ID_BYTES_MAX + Cubes::BODY_BYTES_MAX) < 1_000_000_000);

const BODIES_VERSION: u8 = 1;
const TOTALS_VERSION: u8 = 1;
const RAW: u8 = 0;
const ZSTD: u8 = 1;
/// Below this a zstd frame does not pay for its header and its time.
const COMPRESSED_BYTES_MIN: usize = 1024;
const COMPRESSION_LEVEL: i32 = 1;
/// 8 MiB: more than level 1 uses, and the most memory a forged frame can ask for.
const WINDOW_LOG_MAX: u32 = 23;

/// Bytes that are not what they should be.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{0}")]
pub struct Malformed(pub &'static str);

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
                let mut columns = ColumnWriter {
                    column: &mut self.column,
                    to: &mut self.body,
                };
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

/// Appends columns of numbers.
pub struct ColumnWriter<'a> {
    /// Empty between two columns.
    column: &'a mut Vec<u64>,
    to: &'a mut Vec<u8>,
}

impl ColumnWriter<'_> {
    /// Appends a column of small numbers.
    pub fn put(&mut self, values: impl Iterator<Item = u64>) {
        self.column.clear();
        self.column.extend(values);
        put_column(self.to, self.column);
    }

    /// Appends a column of numbers that differ little from the one before.
    pub fn put_differences(&mut self, values: impl Iterator<Item = i64>) {
        let mut last = 0_i64;
        self.put(values.map(|value| {
            let difference = value.wrapping_sub(last);
            last = value;
            fold(difference)
        }));
    }
}

/// Takes columns of numbers from the front of bytes.
pub struct ColumnReader<'a, 'b> {
    reader: &'a mut Reader<'b>,
    column: Vec<u64>,
}

impl ColumnReader<'_, '_> {
    /// The next column: `count` numbers of at most `width_max` bytes.
    /// # Errors
    /// Whatever is no such column.
    pub fn read(
        &mut self,
        count: usize,
        width_max: usize,
    ) -> Result<impl Iterator<Item = u64> + '_, Malformed> {
        // Every column has at least one byte a body: a count that the bytes cannot back never becomes memory.
        if count > self.reader.0.len() {
            return Err(Malformed("fewer bytes than bodies"));
        }
        self.column.resize(count, 0);
        read_column(self.reader, width_max, &mut self.column)?;
        Ok(self.column.iter().copied())
    }

    /// The next column, of numbers as [`ColumnWriter::put_differences`] wrote them.
    /// # Errors
    /// Whatever is no such column.
    pub fn read_differences(
        &mut self,
        count: usize,
        width_max: usize,
    ) -> Result<impl Iterator<Item = i64> + '_, Malformed> {
        let mut value = 0_i64;
        Ok(self.read(count, width_max)?.map(move |folded| {
            value = value.wrapping_add(unfold(folded));
            value
        }))
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
    let mut columns = ColumnReader {
        reader: &mut body,
        column: Vec::new(),
    };
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

fn put_column(to: &mut Vec<u8>, values: &[u64]) {
    let all = values.iter().fold(0, |all, value| all | value);
    // At least one byte, even for zeros: see `decode_group`.
    let width = u8::try_from(all.checked_ilog2().unwrap_or(0) / 8 + 1).expect("at most 8");
    to.push(width);
    for shift in (0..width).map(|plane| 8 * u32::from(plane)) {
        to.extend(values.iter().map(|value| (value >> shift).to_le_bytes()[0]));
    }
}

fn read_column(
    reader: &mut Reader<'_>,
    width_max: usize,
    values: &mut [u64],
) -> Result<(), Malformed> {
    let width = reader.byte()?;
    if width == 0 || usize::from(width) > width_max {
        return Err(Malformed("a column of impossible width"));
    }
    values.fill(0);
    for shift in (0..width).map(|plane| 8 * u32::from(plane)) {
        let plane = reader.bytes(values.len())?;
        for (value, &byte) in values.iter_mut().zip(plane) {
            *value |= u64::from(byte) << shift;
        }
    }
    Ok(())
}

/// Small differences of either sign become small numbers: 0, -1, 1, -2, ...
fn fold(difference: i64) -> u64 {
    (difference << 1 ^ difference >> 63).cast_unsigned()
}

fn unfold(folded: u64) -> i64 {
    (folded >> 1).cast_signed() ^ -(folded & 1).cast_signed()
}

/// Appends totals. Layout: version, then every number as its length and that many little-endian bytes.
/// A number takes as many bytes as it needs: of 31 numbers up to 256 bits wide, most are short.
pub(super) fn put_totals(to: &mut Vec<u8>, totals: &Totals) {
    to.push(TOTALS_VERSION);
    put_i128(to, i128::from(totals.cubes));
    put_measures(to, &totals.measures);
    if let Some(bounds) = &totals.bounds {
        to.push(1);
        put_bounds(to, bounds);
    } else {
        to.push(0);
    }
    if let Some(stock) = &totals.stock {
        to.push(1);
        put_measures(to, &stock.removed);
        put_measures(to, &stock.remaining);
    } else {
        to.push(0);
    }
}

fn put_measures(to: &mut Vec<u8>, measures: &Measures) {
    put_i128(to, measures.volume);
    for &moment in &measures.first_moments2 {
        put_i128(to, moment);
    }
    for moment in measures
        .second_moments3
        .iter()
        .chain(&measures.product_moments4)
    {
        put_signed(to, &moment.to_le_bytes());
    }
    for &area in &measures.area_by_axis {
        put_i128(to, area);
    }
    for &length in measures.edge_length.as_flattened() {
        put_i128(to, length);
    }
    put_i128(to, i128::from(measures.euler8));
    for &count in &measures.vertices {
        put_i128(to, i128::from(count));
    }
}

pub(crate) fn put_bounds(to: &mut Vec<u8>, bounds: &Bounds) {
    for coordinate in bounds.min.iter().chain(&bounds.max) {
        to.extend(coordinate.to_le_bytes());
    }
}

pub(crate) fn read_bounds(reader: &mut Reader<'_>) -> Result<Bounds, Malformed> {
    let mut corners = [[0; 3]; 2];
    for coordinate in corners.as_flattened_mut() {
        *coordinate = i32::from_le_bytes(reader.array()?);
    }
    let [min, max] = corners;
    Ok(Bounds { min, max })
}

/// The bytes of a stock: none when there is none.
pub(super) fn stock_bytes(stock: Option<Stock>) -> Vec<u8> {
    let mut bytes = Vec::new();
    if let Some(stock) = stock {
        put_bounds(&mut bytes, &stock.bounds());
    }
    bytes
}

/// The stock that [`stock_bytes`] wrote.
/// # Errors
/// Whatever is not that.
pub(super) fn stock(bytes: &[u8]) -> Result<Option<Stock>, Malformed> {
    if bytes.is_empty() {
        return Ok(None);
    }
    let mut reader = Reader(bytes);
    let Bounds { min, max } = read_bounds(&mut reader)?;
    reader.finish()?;
    match Stock::new(min.map(i64::from), max.map(i64::from)) {
        Ok(stock) => Ok(Some(stock)),
        Err(_) => Err(Malformed("a stock that is no box")),
    }
}

/// Appends a volume.
pub(crate) fn put_volume(to: &mut Vec<u8>, volume: i128) {
    put_i128(to, volume);
}

/// The volume that [`put_volume`] wrote, and nothing after it.
/// # Errors
/// Whatever is not that.
pub(super) fn volume(bytes: &[u8]) -> Result<i128, Malformed> {
    let mut reader = Reader(bytes);
    let volume = read_volume(&mut reader)?;
    reader.finish()?;
    Ok(volume)
}

/// The same, and what comes after it is left.
/// # Errors
/// Whatever is not that.
pub(super) fn read_volume(reader: &mut Reader<'_>) -> Result<i128, Malformed> {
    reader.i128()
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

/// The totals at the start of `reader`.
pub(super) fn read_totals(reader: &mut Reader<'_>) -> Result<Totals, Malformed> {
    if reader.byte()? != TOTALS_VERSION {
        return Err(Malformed("totals of an unknown version"));
    }
    let cubes = u64::try_from(reader.i128()?).map_err(|_| Malformed("a negative count"))?;
    let measures = read_measures(reader)?;
    let bounds = match reader.byte()? {
        0 => None,
        1 => Some(read_bounds(reader)?),
        _ => return Err(Malformed("bounds that are neither there nor not")),
    };
    let stock = match reader.byte()? {
        0 => None,
        1 => Some(StockMeasures {
            removed: read_measures(reader)?,
            remaining: read_measures(reader)?,
        }),
        _ => return Err(Malformed("a stock that is neither there nor not")),
    };
    Ok(Totals {
        cubes,
        measures,
        bounds,
        stock,
    })
}

fn read_measures(reader: &mut Reader<'_>) -> Result<Measures, Malformed> {
    let mut measures = Measures {
        volume: reader.i128()?,
        ..Measures::default()
    };
    for moment in &mut measures.first_moments2 {
        *moment = reader.i128()?;
    }
    for moment in measures
        .second_moments3
        .iter_mut()
        .chain(&mut measures.product_moments4)
    {
        *moment = I256::from_le_bytes(reader.signed()?);
    }
    for area in &mut measures.area_by_axis {
        *area = reader.i128()?;
    }
    for length in measures.edge_length.as_flattened_mut() {
        *length = reader.i128()?;
    }
    measures.euler8 = reader.i64()?;
    for count in &mut measures.vertices {
        *count = reader.i64()?;
    }
    Ok(measures)
}

fn put_i128(to: &mut Vec<u8>, number: i128) {
    put_signed(to, &number.to_le_bytes());
}

/// Two's complement without the high bytes that only repeat the sign.
pub(crate) fn put_signed(to: &mut Vec<u8>, bytes: &[u8]) {
    let negative = bytes.last().is_some_and(|&highest| highest >= 0x80);
    let filler = if negative { 0xFF } else { 0 };
    let mut length = bytes.len();
    while length > 0
        && bytes[length - 1] == filler
        && (length == 1 && !negative || length > 1 && (bytes[length - 2] >= 0x80) == negative)
    {
        length -= 1;
    }
    to.push(u8::try_from(length).expect("at most 32 bytes"));
    to.extend_from_slice(&bytes[..length]);
}

/// Appends an unsigned number, seven bits a byte, lowest first.
pub(crate) fn put_varint(to: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        to.push(number.to_le_bytes()[0] | 0x80);
        number >>= 7;
    }
    to.push(number.to_le_bytes()[0]);
}

pub(crate) fn count(count: usize) -> u64 {
    u64::try_from(count).expect("a count fits 64 bits")
}

/// Takes bytes from the front of a slice.
pub struct Reader<'a>(pub(crate) &'a [u8]);

impl<'a> Reader<'a> {
    pub(crate) fn bytes(&mut self, count: usize) -> Result<&'a [u8], Malformed> {
        let (taken, rest) = self
            .0
            .split_at_checked(count)
            .ok_or(Malformed("it ends too early"))?;
        self.0 = rest;
        Ok(taken)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        Ok(*self
            .bytes(N)?
            .first_chunk()
            .expect("exactly N bytes were taken"))
    }

    pub(crate) fn byte(&mut self) -> Result<u8, Malformed> {
        self.array().map(|[byte]| byte)
    }

    pub(crate) fn varint(&mut self) -> Result<u64, Malformed> {
        let mut number = 0;
        for shift in (0..u64::BITS).step_by(7) {
            let byte = self.byte()?;
            let bits = u64::from(byte & 0x7F);
            if bits << shift >> shift != bits {
                break;
            }
            number |= bits << shift;
            if byte < 0x80 {
                return Ok(number);
            }
        }
        Err(Malformed("a number of more than 64 bits"))
    }

    pub(crate) fn signed<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        let length = usize::from(self.byte()?);
        if length > N {
            return Err(Malformed("a number that is too wide"));
        }
        let bytes = self.bytes(length)?;
        let negative = bytes.last().is_some_and(|&highest| highest >= 0x80);
        let mut number = [if negative { 0xFF } else { 0 }; N];
        number[..length].copy_from_slice(bytes);
        Ok(number)
    }

    pub(crate) fn i128(&mut self) -> Result<i128, Malformed> {
        self.signed().map(i128::from_le_bytes)
    }

    pub(crate) fn i64(&mut self) -> Result<i64, Malformed> {
        self.signed().map(i64::from_le_bytes)
    }

    pub(crate) fn finish(self) -> Result<(), Malformed> {
        if self.0.is_empty() {
            Ok(())
        } else {
            Err(Malformed("bytes behind its end"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Edge, Place};

    type Cube = (CubeId, Place);
    use crate::random::Random;

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
