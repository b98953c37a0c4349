//! The bytes of the totals of cubes, of a box of material and of volumes.

use ethnum::I256;

use super::bytes::{Malformed, Reader, put_i128, put_signed};
use crate::geometry::{Bounds, Measures, Stock, StockMeasures, Totals};

const TOTALS_VERSION: u8 = 1;

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

/// The stock of these bounds, as [`put_bounds`] wrote them.
/// # Errors
/// Whatever is not that.
pub(super) fn stock(bytes: &[u8]) -> Result<Stock, Malformed> {
    let mut reader = Reader(bytes);
    let Bounds { min, max } = read_bounds(&mut reader)?;
    reader.finish()?;
    Stock::new(min.map(i64::from), max.map(i64::from))
        .map_err(|_| Malformed("a stock that is no box"))
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
