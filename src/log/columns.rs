//! Columns of numbers: bytes of equal weight lie together.
//!
//! ```text
//! column   width  all lowest bytes  all second bytes  ...   `width` of them
//! ```

use super::bytes::{Malformed, Reader};

/// Appends columns of numbers.
pub struct ColumnWriter<'a> {
    /// Empty between two columns.
    column: &'a mut Vec<u64>,
    to: &'a mut Vec<u8>,
}

impl<'a> ColumnWriter<'a> {
    /// Appends to `to`, with the memory of `column`, which holds nothing that counts.
    pub(super) fn new(column: &'a mut Vec<u64>, to: &'a mut Vec<u8>) -> Self {
        Self { column, to }
    }

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

impl<'a, 'b> ColumnReader<'a, 'b> {
    /// Takes from what a reader has left.
    pub(super) fn new(reader: &'a mut Reader<'b>) -> Self {
        Self {
            reader,
            column: Vec::new(),
        }
    }

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

fn put_column(to: &mut Vec<u8>, values: &[u64]) {
    let all = values.iter().fold(0, |all, value| all | value);
    // At least one byte, even for zeros: see [`ColumnReader::read`].
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
