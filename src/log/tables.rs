//! The tables of a scene's database: their columns, and the CRC that each row carries.
//!
//! Knows rows, one at a time; which rows there must be is known by `scene` and `replay`. Every row is sealed with its
//! table's name and the scene's incarnation, so that no row passes for one of another table or scene. All rows but the superblock are never
//! changed once written, so a row that is there and sealed is right.
//!
//! ```text
//! head        1 row, part of every transaction: which rows there must be
//! meta        1 row: what was fixed when the scene was created
//! changes     seq -> time, counts, totals         kept as long as the history is
//! operations  seq -> cubes deleted and inserted   kept for replay, and to revert by; and, with a CRC of its own because
//!                    the cubes need not be read then, which seq it reverts to
//! snapshots   number -> seq, time, totals, ...    one, or none yet
//! chunks      number << 16 | index -> up to 65,536 cubes
//! keys        number -> idempotency key and its answer
//! definitions number -> what bodies stand on, in scenes whose kind defines something: their shapes
//! ```

use rusqlite::types::ValueRef;
use rusqlite::{Connection, Row, params, params_from_iter};

use super::bytes::{self, Malformed, Reader};
use super::codec;
use super::kind::Kind;
use super::totals;
use super::{Header, HistoryRow, KeyRecord, Motion, RecordedOutcome, Seq};
use crate::geometry::CubeId;

/// Every table and index, as the schema has it word for word. The superblock is first and its one page low, so that a checkpoint, which writes pages
/// in their order, moves it before any row.
pub(super) fn tables(defines: bool) -> impl Iterator<Item = (&'static str, &'static str)> {
    let own: &[_] = if defines { &TABLES_OF_DEFINITIONS } else { &[] };
    let tables = TABLES.into_iter().filter(move |(name, _)| {
        let mut replaced = own.iter();
        !replaced.any(|(own, _)| own == name)
    });
    own.iter().copied().chain(tables)
}

/// Where there are definitions: their table, and the superblock with their number.
const TABLES_OF_DEFINITIONS: [(&str, &str); 2] = [
    (
        "head",
        "CREATE TABLE head(one INTEGER PRIMARY KEY, generation INTEGER NOT NULL, seq INTEGER NOT NULL, \
         changes_first INTEGER NOT NULL, operations_first INTEGER NOT NULL, operations_bytes INTEGER NOT NULL, \
         dropped_bytes INTEGER NOT NULL, operations_cubes INTEGER NOT NULL, snapshot INTEGER NOT NULL, snapshots_begun INTEGER NOT NULL, \
         keys_first INTEGER NOT NULL, keys_next INTEGER NOT NULL, definitions INTEGER NOT NULL, crc INTEGER NOT NULL) STRICT",
    ),
    (
        "definitions",
        "CREATE TABLE definitions(number INTEGER PRIMARY KEY, definition BLOB NOT NULL, crc INTEGER NOT NULL) STRICT",
    ),
];

const TABLES: [(&str, &str); 8] = [
    (
        "head",
        "CREATE TABLE head(one INTEGER PRIMARY KEY, generation INTEGER NOT NULL, seq INTEGER NOT NULL, \
         changes_first INTEGER NOT NULL, operations_first INTEGER NOT NULL, operations_bytes INTEGER NOT NULL, \
         dropped_bytes INTEGER NOT NULL, operations_cubes INTEGER NOT NULL, snapshot INTEGER NOT NULL, snapshots_begun INTEGER NOT NULL, \
         keys_first INTEGER NOT NULL, keys_next INTEGER NOT NULL, crc INTEGER NOT NULL) STRICT",
    ),
    (
        "meta",
        "CREATE TABLE meta(one INTEGER PRIMARY KEY, incarnation INTEGER NOT NULL, edge_steps INTEGER NOT NULL, \
         stock BLOB NOT NULL, settings TEXT NOT NULL, created_ms INTEGER NOT NULL, crc INTEGER NOT NULL) STRICT",
    ),
    (
        "changes",
        "CREATE TABLE changes(seq INTEGER PRIMARY KEY, at_ms INTEGER NOT NULL, inserted INTEGER NOT NULL, \
         deleted INTEGER NOT NULL, move INTEGER, duration_ns INTEGER, removed BLOB NOT NULL, totals BLOB NOT NULL, crc INTEGER NOT NULL) STRICT",
    ),
    (
        "changes_by_move",
        "CREATE INDEX changes_by_move ON changes(move) WHERE move IS NOT NULL",
    ),
    (
        "operations",
        "CREATE TABLE operations(seq INTEGER PRIMARY KEY, back_to INTEGER, back_crc INTEGER NOT NULL, cubes BLOB NOT NULL, \
         crc INTEGER NOT NULL) STRICT",
    ),
    (
        "snapshots",
        "CREATE TABLE snapshots(number INTEGER PRIMARY KEY, seq INTEGER NOT NULL, at_ms INTEGER NOT NULL, \
         totals BLOB NOT NULL, next_id INTEGER NOT NULL, cubes INTEGER NOT NULL, chunks INTEGER NOT NULL, \
         operations_bytes INTEGER NOT NULL, operations_cubes INTEGER NOT NULL, crc INTEGER NOT NULL) STRICT",
    ),
    (
        "chunks",
        "CREATE TABLE chunks(id INTEGER PRIMARY KEY, count INTEGER NOT NULL, cubes BLOB NOT NULL, crc INTEGER NOT NULL) STRICT",
    ),
    (
        "keys",
        "CREATE TABLE keys(number INTEGER PRIMARY KEY, key TEXT NOT NULL, body BLOB NOT NULL, answer BLOB NOT NULL, \
         crc INTEGER NOT NULL) STRICT",
    ),
];

/// What makes this scene's CRCs its own.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seal {
    pub(super) incarnation: u64,
}

impl Seal {
    /// Begins the CRC of a row of `table`.
    fn row(self, table: &str) -> Crc {
        let mut crc = Crc(crc32fast::Hasher::new());
        crc.number(self.incarnation).bytes(table.as_bytes());
        crc
    }
}

/// Everything is preceded by its length or has a fixed one, so that no two rows give the same bytes.
struct Crc(crc32fast::Hasher);

impl Crc {
    fn number(&mut self, number: u64) -> &mut Self {
        self.0.update(&number.to_le_bytes());
        self
    }

    fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.number(u64::try_from(bytes.len()).expect("a length fits 64 bits"));
        self.0.update(bytes);
        self
    }

    fn finish(&self) -> u32 {
        self.0.clone().finalize()
    }

    fn check(&self, found: u64) -> Result<(), Malformed> {
        if u64::from(self.finish()) == found {
            Ok(())
        } else {
            Err(Malformed("its CRC is wrong"))
        }
    }
}

/// The columns of a row that may be damaged.
struct Columns<'a>(&'a Row<'a>);

impl<'a> Columns<'a> {
    fn value(&self, index: usize) -> Result<ValueRef<'a>, Malformed> {
        self.0
            .get_ref(index)
            .map_err(|_| Malformed("a column is missing"))
    }

    /// SQLite's integers are signed; ours are the same 64 bits unsigned.
    fn number(&self, index: usize) -> Result<u64, Malformed> {
        match self.value(index)? {
            ValueRef::Integer(number) => Ok(number.cast_unsigned()),
            _ => Err(Malformed("a column is not a number")),
        }
    }

    /// What [`ordered`] wrote, or none.
    fn ordered(&self, index: usize) -> Result<Option<u64>, Malformed> {
        match self.value(index)? {
            ValueRef::Null => Ok(None),
            ValueRef::Integer(number) => Ok(Some(number.cast_unsigned() ^ 1 << 63)),
            _ => Err(Malformed("a column is not a number")),
        }
    }

    fn blob(&self, index: usize) -> Result<&'a [u8], Malformed> {
        match self.value(index)? {
            ValueRef::Blob(bytes) => Ok(bytes),
            _ => Err(Malformed("a column is not a blob")),
        }
    }

    fn text(&self, index: usize) -> Result<&'a str, Malformed> {
        match self.value(index)? {
            ValueRef::Text(bytes) => {
                std::str::from_utf8(bytes).map_err(|_| Malformed("a text is not UTF-8"))
            }
            _ => Err(Malformed("a column is not text")),
        }
    }
}

/// Which rows there must be. Changed by every transaction.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Superblock {
    /// Transactions so far.
    pub(super) generation: u64,
    /// Newest change.
    pub(super) seq: Seq,
    /// `changes` holds exactly this to `seq`.
    pub(super) changes_first: u64,
    /// `operations` holds exactly this to `seq`.
    pub(super) operations_first: u64,
    /// Bytes of all operations since the scene was created, dropped ones too.
    pub(super) operations_bytes: u64,
    /// Those of the dropped ones.
    pub(super) dropped_bytes: u64,
    /// Cubes of all operations since the scene was created.
    pub(super) operations_cubes: u64,
    /// The snapshot to replay from; 0 for none.
    pub(super) snapshot: u64,
    /// Number of the last snapshot begun.
    pub(super) snapshots_begun: u64,
    /// `keys` holds exactly this ...
    pub(super) keys_first: u64,
    /// ... to the one before this.
    pub(super) keys_next: u64,
    /// `definitions` holds exactly 0 to the one before this; none where there is no such table.
    pub(super) definitions: Option<u64>,
}

impl Superblock {
    pub(super) const NEW: Self = Self {
        generation: 0,
        seq: Seq(0),
        changes_first: 1,
        operations_first: 1,
        operations_bytes: 0,
        dropped_bytes: 0,
        operations_cubes: 0,
        snapshot: 0,
        snapshots_begun: 0,
        keys_first: 0,
        keys_next: 0,
        definitions: None,
    };

    fn numbers(&self) -> impl Iterator<Item = u64> {
        let everywhere = [
            self.generation,
            self.seq.0,
            self.changes_first,
            self.operations_first,
            self.operations_bytes,
            self.dropped_bytes,
            self.operations_cubes,
            self.snapshot,
            self.snapshots_begun,
            self.keys_first,
            self.keys_next,
        ];
        everywhere.into_iter().chain(self.definitions)
    }

    fn crc(&self, seal: Seal) -> Crc {
        let mut crc = seal.row("head");
        for number in self.numbers() {
            crc.number(number);
        }
        crc
    }

    pub(super) fn write(&self, connection: &Connection, seal: Seal) -> rusqlite::Result<()> {
        let crc = self.crc(seal).finish();
        let sql = match self.definitions {
            None => "REPLACE INTO head VALUES(1, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            Some(_) => "REPLACE INTO head VALUES(1, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        };
        let numbers = self.numbers().map(u64::cast_signed);
        connection
            .prepare_cached(sql)?
            .execute(params_from_iter(numbers.chain([i64::from(crc)])))?;
        Ok(())
    }

    pub(super) fn read(
        connection: &Connection,
        seal: Seal,
    ) -> rusqlite::Result<Result<Self, Malformed>> {
        connection
            .prepare_cached("SELECT * FROM head WHERE one = 1")?
            .query_row([], |row| Ok(Self::parse(row, seal)))
    }

    fn parse(row: &Row<'_>, seal: Seal) -> Result<Self, Malformed> {
        let columns = Columns(row);
        // The schema, which was compared, says whether there is one column more.
        let defines = row.as_ref().column_count() == 14;
        let superblock = Self {
            generation: columns.number(1)?,
            seq: Seq(columns.number(2)?),
            changes_first: columns.number(3)?,
            operations_first: columns.number(4)?,
            operations_bytes: columns.number(5)?,
            dropped_bytes: columns.number(6)?,
            operations_cubes: columns.number(7)?,
            snapshot: columns.number(8)?,
            snapshots_begun: columns.number(9)?,
            keys_first: columns.number(10)?,
            keys_next: columns.number(11)?,
            definitions: defines.then(|| columns.number(12)).transpose()?,
        };
        superblock
            .crc(seal)
            .check(columns.number(12 + usize::from(defines))?)?;
        Ok(superblock)
    }
}

/// What was fixed at creation, and when that was.
#[derive(Clone, Debug)]
pub(super) struct Meta<K: Kind> {
    pub(super) header: Header<K>,
    pub(super) created_ms: u64,
}

impl<K: Kind> Meta<K> {
    pub(super) fn seal(&self) -> Seal {
        Seal {
            incarnation: self.header.incarnation,
        }
    }

    /// The bytes of the stock: none when there is none.
    fn stock_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        if let Some(stock) = &self.header.stock {
            K::put_stock(&mut bytes, stock);
        }
        bytes
    }

    fn crc(&self) -> Crc {
        let mut crc = self.seal().row("meta");
        crc.number(u64::from(self.header.edge_steps))
            .bytes(&self.stock_bytes())
            .bytes(self.header.settings.as_bytes())
            .number(self.created_ms);
        crc
    }

    pub(super) fn insert(&self, connection: &Connection) -> rusqlite::Result<()> {
        connection.execute(
            "INSERT INTO meta VALUES(1, ?, ?, ?, ?, ?, ?)",
            params![
                self.header.incarnation.cast_signed(),
                self.header.edge_steps,
                self.stock_bytes(),
                self.header.settings,
                self.created_ms.cast_signed(),
                self.crc().finish()
            ],
        )?;
        Ok(())
    }

    pub(super) fn read(connection: &Connection) -> rusqlite::Result<Result<Self, Malformed>> {
        connection.query_row("SELECT * FROM meta WHERE one = 1", [], |row| {
            Ok(Self::parse(row))
        })
    }

    fn parse(row: &Row<'_>) -> Result<Self, Malformed> {
        let columns = Columns(row);
        let meta = Self {
            header: Header {
                incarnation: columns.number(1)?,
                edge_steps: u32::try_from(columns.number(2)?)
                    .map_err(|_| Malformed("its edge is out of range"))?,
                stock: stock::<K>(columns.blob(3)?)?,
                settings: columns.text(4)?.to_owned(),
            },
            created_ms: columns.number(5)?,
        };
        meta.crc().check(columns.number(6)?)?;
        Ok(meta)
    }
}

fn stock<K: Kind>(bytes: &[u8]) -> Result<Option<K::Stock>, Malformed> {
    match bytes {
        [] => Ok(None),
        _ => K::read_stock(bytes).map(Some),
    }
}

/// Rows of `changes` are [`HistoryRow`]s.
pub(super) struct Changes;

/// Moves and durations are unsigned; their order is that of SQLite's signed integers when the highest bit is turned.
pub(super) fn ordered(number: u64) -> i64 {
    (number ^ 1 << 63).cast_signed()
}

impl Changes {
    /// Columns that [`Self::parse`] reads first in a row.
    pub(super) const COLUMNS: &str = "changes.seq, changes.at_ms, changes.inserted, changes.deleted, changes.move, \
         changes.duration_ns, changes.removed, changes.totals, changes.crc";
    pub(super) const COLUMN_COUNT: usize = 9;

    /// `numbers` are the seq, the time and the counts.
    fn crc(seal: Seal, numbers: [u64; 4], motion: Motion, removed: &[u8], totals: &[u8]) -> Crc {
        let mut crc = seal.row("changes");
        for number in numbers {
            crc.number(number);
        }
        for said in [motion.number, motion.duration_ns] {
            crc.number(u64::from(said.is_some()))
                .number(said.unwrap_or(0));
        }
        crc.bytes(removed).bytes(totals);
        crc
    }

    pub(super) fn insert<K: Kind>(
        connection: &Connection,
        seal: Seal,
        row: &HistoryRow<K>,
        totals: &[u8],
    ) -> rusqlite::Result<()> {
        let mut removed = Vec::new();
        totals::put_volume(&mut removed, row.volume_removed);
        let numbers = [row.seq.0, row.at_ms, row.inserted, row.deleted];
        let crc = Self::crc(seal, numbers, row.motion, &removed, totals).finish();
        let [seq, at_ms, inserted, deleted] = numbers.map(u64::cast_signed);
        let [number, duration] =
            [row.motion.number, row.motion.duration_ns].map(|said| said.map(ordered));
        connection
            .prepare_cached("INSERT INTO changes VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?)")?
            .execute(params![
                seq, at_ms, inserted, deleted, number, duration, removed, totals, crc
            ])?;
        Ok(())
    }

    pub(super) fn parse<K: Kind>(row: &Row<'_>, seal: Seal) -> Result<HistoryRow<K>, Malformed> {
        let columns = Columns(row);
        let (removed, totals) = (columns.blob(6)?, columns.blob(7)?);
        let mut numbers = [0; 4];
        for (index, number) in numbers.iter_mut().enumerate() {
            *number = columns.number(index)?;
        }
        let motion = Motion {
            number: columns.ordered(4)?,
            duration_ns: columns.ordered(5)?,
        };
        Self::crc(seal, numbers, motion, removed, totals).check(columns.number(8)?)?;
        let [seq, at_ms, inserted, deleted] = numbers;
        Ok(HistoryRow {
            seq: Seq(seq),
            at_ms,
            inserted,
            deleted,
            motion,
            volume_removed: totals::volume(removed)?,
            totals: codec::totals::<K>(totals)?,
        })
    }
}

/// Rows of a number and packed cubes: `operations` and `chunks`.
pub(super) struct Packed<'a> {
    pub(super) number: u64,
    pub(super) cubes: &'a [u8],
}

impl<'a> Packed<'a> {
    fn crc(&self, seal: Seal, table: &str) -> Crc {
        let mut crc = seal.row(table);
        crc.number(self.number).bytes(self.cubes);
        crc
    }

    pub(super) fn insert_operations(
        &self,
        connection: &Connection,
        seal: Seal,
        reverts_to: Option<Seq>,
    ) -> rusqlite::Result<()> {
        let crc = self.crc(seal, "operations").finish();
        let reverts_crc = Self::reverts_crc(seal, self.number, reverts_to).finish();
        connection
            .prepare_cached("INSERT INTO operations VALUES(?, ?, ?, ?, ?)")?
            .execute(params![
                self.number.cast_signed(),
                reverts_to.map(|seq| seq.0.cast_signed()),
                reverts_crc,
                self.cubes,
                crc
            ])?;
        Ok(())
    }

    fn reverts_crc(seal: Seal, number: u64, reverts_to: Option<Seq>) -> Crc {
        let mut crc = seal.row("operations back");
        crc.number(number)
            .number(u64::from(reverts_to.is_some()))
            .number(reverts_to.map_or(0, |seq| seq.0));
        crc
    }

    /// The columns `seq`, `back_to` and `back_crc` of `operations` from `first` on: which seq a change reverts to.
    pub(super) fn reverts_to(
        row: &Row<'_>,
        first: usize,
        seal: Seal,
    ) -> Result<Option<Seq>, Malformed> {
        let columns = Columns(row);
        let number = columns.number(first)?;
        let reverts_to = match columns.value(first + 1)? {
            ValueRef::Null => None,
            ValueRef::Integer(seq) => Some(Seq(seq.cast_unsigned())),
            _ => return Err(Malformed("a column is not a number")),
        };
        Self::reverts_crc(seal, number, reverts_to).check(columns.number(first + 2)?)?;
        Ok(reverts_to)
    }

    /// A whole row of `operations`, from the column `first` on; but for what [`Self::reverts_to`] reads.
    pub(super) fn operations(
        row: &'a Row<'a>,
        first: usize,
        seal: Seal,
    ) -> Result<Self, Malformed> {
        let columns = Columns(row);
        let packed = Self {
            number: columns.number(first)?,
            cubes: columns.blob(first + 3)?,
        };
        packed
            .crc(seal, "operations")
            .check(columns.number(first + 4)?)?;
        Ok(packed)
    }

    pub(super) fn insert_chunk(
        &self,
        connection: &Connection,
        seal: Seal,
        count: u64,
    ) -> rusqlite::Result<()> {
        let crc = self.crc(seal, "chunks").number(count).finish();
        connection
            .prepare_cached("INSERT INTO chunks VALUES(?, ?, ?, ?)")?
            .execute(params![
                self.number.cast_signed(),
                count.cast_signed(),
                self.cubes,
                crc
            ])?;
        Ok(())
    }

    /// A whole row of `chunks`, and how many cubes it says it has.
    pub(super) fn chunk(row: &'a Row<'a>, seal: Seal) -> Result<(Self, u64), Malformed> {
        let columns = Columns(row);
        let packed = Self {
            number: columns.number(0)?,
            cubes: columns.blob(2)?,
        };
        let count = columns.number(1)?;
        packed
            .crc(seal, "chunks")
            .number(count)
            .check(columns.number(3)?)?;
        Ok((packed, count))
    }
}

/// A row of `snapshots`: there only once all its chunks are.
#[derive(Clone, Debug)]
pub(super) struct Snapshot<K: Kind> {
    pub(super) number: u64,
    pub(super) seq: Seq,
    pub(super) at_ms: u64,
    pub(super) totals: K::Totals,
    pub(super) next_id: u64,
    pub(super) cubes: u64,
    pub(super) chunks: u64,
    /// [`Superblock::operations_bytes`] when it was begun.
    pub(super) operations_bytes: u64,
    /// [`Superblock::operations_cubes`] when it was begun.
    pub(super) operations_cubes: u64,
}

/// How many chunks a snapshot can have: more than 2^31 cubes fill.
pub(super) const CHUNKS_MAX: u64 = 1 << 16;

/// Number of the chunk at `index` of a snapshot.
pub(super) fn chunk_number(snapshot: u64, index: u64) -> u64 {
    snapshot * CHUNKS_MAX + index
}

impl<K: Kind> Snapshot<K> {
    fn numbers(&self) -> [u64; 8] {
        [
            self.number,
            self.seq.0,
            self.at_ms,
            self.next_id,
            self.cubes,
            self.chunks,
            self.operations_bytes,
            self.operations_cubes,
        ]
    }

    fn crc(&self, seal: Seal, totals: &[u8]) -> Crc {
        let mut crc = seal.row("snapshots");
        for number in self.numbers() {
            crc.number(number);
        }
        crc.bytes(totals);
        crc
    }

    pub(super) fn insert(&self, connection: &Connection, seal: Seal) -> rusqlite::Result<()> {
        let mut totals = Vec::new();
        K::put_totals(&mut totals, &self.totals);
        let crc = self.crc(seal, &totals).finish();
        let [
            number,
            seq,
            at_ms,
            next_id,
            cubes,
            chunks,
            bytes,
            operations,
        ] = self.numbers().map(u64::cast_signed);
        connection.execute(
            "INSERT INTO snapshots VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            params![
                number, seq, at_ms, totals, next_id, cubes, chunks, bytes, operations, crc
            ],
        )?;
        Ok(())
    }

    pub(super) fn parse(row: &Row<'_>, seal: Seal) -> Result<Self, Malformed> {
        let columns = Columns(row);
        let totals = columns.blob(3)?;
        let snapshot = Self {
            number: columns.number(0)?,
            seq: Seq(columns.number(1)?),
            at_ms: columns.number(2)?,
            totals: codec::totals::<K>(totals)?,
            next_id: columns.number(4)?,
            cubes: columns.number(5)?,
            chunks: columns.number(6)?,
            operations_bytes: columns.number(7)?,
            operations_cubes: columns.number(8)?,
        };
        snapshot.crc(seal, totals).check(columns.number(9)?)?;
        Ok(snapshot)
    }
}

/// Rows of `keys` are [`KeyRecord`]s with a number.
pub(super) struct Keys;

impl Keys {
    fn crc(seal: Seal, number: u64, key: &str, body: &[u8], answer: &[u8]) -> Crc {
        let mut crc = seal.row("keys");
        crc.number(number)
            .bytes(key.as_bytes())
            .bytes(body)
            .bytes(answer);
        crc
    }

    pub(super) fn insert<K: Kind>(
        connection: &Connection,
        seal: Seal,
        number: u64,
        record: &KeyRecord<K>,
    ) -> rusqlite::Result<()> {
        let mut answer = Vec::new();
        put_answer(&mut answer, &record.answer);
        let crc = Self::crc(seal, number, &record.key, &record.body, &answer).finish();
        connection
            .prepare_cached("INSERT INTO keys VALUES(?, ?, ?, ?, ?)")?
            .execute(params![
                number.cast_signed(),
                &*record.key,
                record.body,
                answer,
                crc
            ])?;
        Ok(())
    }

    pub(super) fn parse<K: Kind>(
        row: &Row<'_>,
        seal: Seal,
    ) -> Result<(u64, KeyRecord<K>), Malformed> {
        let columns = Columns(row);
        let number = columns.number(0)?;
        let (key, body, answer) = (columns.text(1)?, columns.blob(2)?, columns.blob(3)?);
        Self::crc(seal, number, key, body, answer).check(columns.number(4)?)?;
        let record = KeyRecord {
            key: key.into(),
            body: body
                .try_into()
                .map_err(|_| Malformed("its hash has another length"))?,
            answer: read_answer(answer)?,
        };
        Ok((number, record))
    }
}

/// Rows of `definitions`: bytes with a number.
pub(super) struct Definitions;

impl Definitions {
    fn crc(seal: Seal, number: u64, definition: &[u8]) -> Crc {
        let mut crc = seal.row("definitions");
        crc.number(number).bytes(definition);
        crc
    }

    pub(super) fn insert(
        connection: &Connection,
        seal: Seal,
        number: u64,
        definition: &[u8],
    ) -> rusqlite::Result<()> {
        let crc = Self::crc(seal, number, definition).finish();
        connection.execute(
            "INSERT INTO definitions VALUES(?, ?, ?)",
            params![number.cast_signed(), definition, crc],
        )?;
        Ok(())
    }

    pub(super) fn parse<'a>(row: &'a Row<'a>, seal: Seal) -> Result<(u64, &'a [u8]), Malformed> {
        let columns = Columns(row);
        let (number, definition) = (columns.number(0)?, columns.blob(1)?);
        Self::crc(seal, number, definition).check(columns.number(2)?)?;
        Ok((number, definition))
    }
}

const ANSWER_VERSION: u8 = 2;

fn put_answer<K: Kind>(to: &mut Vec<u8>, answer: &RecordedOutcome<K>) {
    to.push(ANSWER_VERSION);
    for number in [
        answer.seq.0,
        answer.at_ms,
        answer.inserted,
        answer.deleted,
        answer.unchanged,
    ] {
        bytes::put_varint(to, number);
    }
    if let Some((first, last)) = answer.assigned {
        to.push(1);
        bytes::put_varint(to, first.0);
        bytes::put_varint(to, last.0);
    } else {
        to.push(0);
    }
    totals::put_volume(to, answer.volume_removed);
    K::put_totals(to, &answer.totals);
}

fn read_answer<K: Kind>(bytes: &[u8]) -> Result<RecordedOutcome<K>, Malformed> {
    let mut reader = Reader(bytes);
    if reader.byte()? != ANSWER_VERSION {
        return Err(Malformed("an answer of an unknown version"));
    }
    let answer = RecordedOutcome {
        seq: Seq(reader.varint()?),
        at_ms: reader.varint()?,
        inserted: reader.varint()?,
        deleted: reader.varint()?,
        unchanged: reader.varint()?,
        assigned: match reader.byte()? {
            0 => None,
            1 => Some((CubeId(reader.varint()?), CubeId(reader.varint()?))),
            _ => return Err(Malformed("ids that are neither given nor not")),
        },
        volume_removed: totals::read_volume(&mut reader)?,
        totals: K::read_totals(&mut reader)?,
    };
    reader.finish()?;
    Ok(answer)
}
