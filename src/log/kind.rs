//! What the logs of different kinds of scenes have of their own: how bodies and totals become bytes, and what bodies stand on.
//!
//! Everything else (which rows there are, their CRCs, replay, snapshots, history, keys) is the same, and knows a kind by this trait alone.

use std::fmt;
use std::ops::RangeInclusive;

use super::Header;
use super::bytes::{Malformed, Reader};
use super::columns::{ColumnReader, ColumnWriter};
use super::totals;
use crate::geometry::{CubeId, Edge, Place, Stock, Totals};

/// A kind of scene, as its log knows it.
pub trait Kind: Copy + Eq + fmt::Debug + Send + Sync + 'static {
    /// What an id stands for.
    type Body: Clone + Eq + fmt::Debug + Send + Sync + 'static;
    /// What is known of the set of bodies at one moment.
    type Totals: Copy + Eq + fmt::Debug + Send + Sync + 'static;
    /// What it takes to read bodies.
    type Context: Clone + fmt::Debug + Send + Sync + 'static;
    /// A block of material that bodies are cut from.
    type Stock: Clone + Eq + fmt::Debug + Send + Sync + 'static;

    /// Versions of the layout of its files. What an older program would misread needs a new one.
    const FORMATS: RangeInclusive<i32>;
    /// Whether its context grows by definitions, which are rows of a table of their own.
    const DEFINES: bool;
    /// Most bytes that a body takes in a record, its id apart.
    const BODY_BYTES_MAX: usize;
    /// Bodies of a full chunk: what replay holds in memory at a time.
    const CHUNK_BODIES: usize;

    /// The oldest version that holds a scene with this stock: a program that does not know it refuses the scene as newer than itself, and
    /// those that do go on opening all others.
    fn format(stock: Option<&Self::Stock>) -> i32;

    /// Appends a stock, which takes at least a byte.
    fn put_stock(to: &mut Vec<u8>, stock: &Self::Stock);

    /// The stock that [`Kind::put_stock`] wrote.
    /// # Errors
    /// Whatever is not that.
    fn read_stock(bytes: &[u8]) -> Result<Self::Stock, Malformed>;

    /// What bodies stand on before anything is defined.
    /// # Errors
    /// What the header says that no scene of this kind has, in words.
    fn context(header: &Header<Self>) -> Result<Self::Context, String>;

    /// Adds a definition to what bodies stand on.
    /// # Errors
    /// Whatever is no definition that can come next.
    fn define(context: &mut Self::Context, definition: &[u8]) -> Result<(), Malformed>;

    /// Whether exactly this has been defined.
    fn is_defined(context: &Self::Context, definition: &[u8]) -> bool;

    /// How many operations a body counts as, so that a record is never larger than what the database takes.
    fn weight(body: &Self::Body) -> usize;

    /// Appends columns of bodies, whose ids are there already.
    fn put_bodies(
        bodies: &[(CubeId, Self::Body)],
        context: &Self::Context,
        columns: &mut ColumnWriter<'_>,
    );

    /// The bodies of these ids, from the columns that [`Kind::put_bodies`] wrote.
    /// # Errors
    /// Whatever is not that.
    fn read_bodies(
        ids: Vec<CubeId>,
        context: &Self::Context,
        columns: &mut ColumnReader<'_, '_>,
    ) -> Result<Vec<(CubeId, Self::Body)>, Malformed>;

    /// Appends totals.
    fn put_totals(to: &mut Vec<u8>, totals: &Self::Totals);

    /// The totals at the start of `reader`, as [`Kind::put_totals`] wrote them.
    /// # Errors
    /// Whatever is not that.
    fn read_totals(reader: &mut Reader<'_>) -> Result<Self::Totals, Malformed>;

    /// The totals of a scene without bodies.
    fn nothing(header: &Header<Self>) -> Self::Totals;
}

/// A body with its id.
pub(super) type Named<K> = (CubeId, <K as Kind>::Body);

/// Scenes of identical cubes: a body is a place.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Cubes;

/// A difference of two coordinates, folded, takes 33 bits.
pub(crate) const COORDINATE_BYTES_MAX: usize = 5;

impl Kind for Cubes {
    type Body = Place;
    type Totals = Totals;
    type Context = Edge;
    type Stock = Stock;

    const FORMATS: RangeInclusive<i32> = 3..=3;
    const DEFINES: bool = false;
    const BODY_BYTES_MAX: usize = 3 * COORDINATE_BYTES_MAX;
    const CHUNK_BODIES: usize = 1 << 16;

    fn format(_: Option<&Stock>) -> i32 {
        3
    }

    fn put_stock(to: &mut Vec<u8>, stock: &Stock) {
        totals::put_bounds(to, &stock.bounds());
    }

    fn read_stock(bytes: &[u8]) -> Result<Stock, Malformed> {
        totals::stock(bytes)
    }

    fn context(header: &Header) -> Result<Edge, String> {
        Edge::new(i64::from(header.edge_steps)).map_err(|invalid| invalid.to_string())
    }

    fn define(_: &mut Edge, _: &[u8]) -> Result<(), Malformed> {
        Err(Malformed("a definition in a scene of cubes"))
    }

    fn is_defined(_: &Edge, _: &[u8]) -> bool {
        false
    }

    fn weight(_: &Place) -> usize {
        1
    }

    fn put_bodies(cubes: &[(CubeId, Place)], _: &Edge, columns: &mut ColumnWriter<'_>) {
        for axis in 0..3 {
            columns.put_differences(
                cubes
                    .iter()
                    .map(|(_, place)| i64::from(place.corner()[axis])),
            );
        }
    }

    fn read_bodies(
        ids: Vec<CubeId>,
        edge: &Edge,
        columns: &mut ColumnReader<'_, '_>,
    ) -> Result<Vec<(CubeId, Place)>, Malformed> {
        let mut corners = vec![[0_i64; 3]; ids.len()];
        for axis in 0..3 {
            let coordinates = columns.read_differences(ids.len(), COORDINATE_BYTES_MAX)?;
            for (corner, coordinate) in corners.iter_mut().zip(coordinates) {
                corner[axis] = coordinate;
            }
        }
        ids.into_iter()
            .zip(corners)
            .map(|(id, corner)| match Place::new(corner, *edge) {
                Ok(place) => Ok((id, place)),
                Err(_) => Err(Malformed("a cube outside the lattice")),
            })
            .collect()
    }

    fn put_totals(to: &mut Vec<u8>, totals: &Totals) {
        totals::put_totals(to, totals);
    }

    fn read_totals(reader: &mut Reader<'_>) -> Result<Totals, Malformed> {
        totals::read_totals(reader)
    }

    fn nothing(header: &Header) -> Totals {
        Totals::of_nothing(header.stock)
    }
}
