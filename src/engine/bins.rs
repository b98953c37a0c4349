//! The bins of a grid: a hash table from where a bin is to the cubes in it.
//!
//! ```text
//!   hash of (x, y, z) ──> one of 64 tables ──> slot, linear probing ──> Bin { key, len, words }
//!   words   x x x x . .   y y y y . .   z z z z . .   fresh   ids: low halves, high halves
//!           none in a bin that is divided: its cubes are in the eight bins of the next level
//! ```
//!
//! The corners of a bin lie side by side, apart from the ids: a query reads nothing else. A table grows and shrinks alone,
//! so a pause is a sixty-fourth of what it would be. Nothing is left behind where a bin was: the table after any history
//! is that of a fresh one.

use crate::geometry::CubeId;

use super::lanes::{Avx2, WORDS};
use super::prefetch::prefetch;
use super::scan::{Corners, first_bits, within};

/// Which bin: the coordinates of its cubes, shifted.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) struct BinKey(pub(super) [i32; 3]);

impl BinKey {
    /// Mixes the three coordinates. No secret: who could choose colliding bins could as well fill one.
    #[inline]
    pub(super) fn hash(self) -> u64 {
        let [x, y, z] = self.0.map(|layer| u64::from(layer.cast_unsigned()));
        let sum = x
            .wrapping_mul(0x9e37_79b9_7f4a_7c15)
            .wrapping_add(y.wrapping_mul(0xc2b2_ae3d_27d4_eb4f))
            .wrapping_add(z.wrapping_mul(0x1656_67b1_9e37_79f9));
        (sum ^ (sum >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93)
    }
}

/// The cubes of one bin. Half a cache line, so that looking for a bin mostly reads one line.
#[derive(Clone, Debug)]
#[repr(align(32))]
pub(super) struct Bin {
    key: BinKey,
    /// Cubes, those of the bins it is divided into included; 0 in a slot without a bin.
    len: u32,
    /// Five columns of `capacity` elements, and the number of fresh cubes behind the third. Empty when divided.
    words: Box<[i32]>,
}

const _: () = assert!(size_of::<Bin>() == 32);

/// Least cubes for which a bin has room. What follows a column of corners must fill a register: see [`Corners`].
const CAPACITY_MIN: usize = 4;
const _: () = assert!(2 * CAPACITY_MIN + 1 >= WORDS - 1);

impl Bin {
    fn vacant() -> Self {
        Self {
            key: BinKey([0; 3]),
            len: 0,
            words: Box::default(),
        }
    }

    pub(super) fn key(&self) -> BinKey {
        self.key
    }

    #[inline]
    pub(super) fn len(&self) -> usize {
        self.len as usize
    }

    #[inline]
    pub(super) fn is_divided(&self) -> bool {
        self.words.is_empty()
    }

    #[inline]
    fn capacity(&self) -> usize {
        self.words.len() / 5
    }

    #[inline]
    pub(super) fn corners(&self) -> Corners<'_> {
        Corners {
            words: &self.words,
            capacity: self.capacity(),
        }
    }

    pub(super) fn corner(&self, index: usize) -> [i32; 3] {
        self.corners().at(index)
    }

    /// The coordinates of all cubes along one axis.
    pub(super) fn column(&self, axis: usize) -> &[i32] {
        let first = axis * self.capacity();
        &self.words[first..first + self.len()]
    }

    pub(super) fn id(&self, index: usize) -> CubeId {
        let capacity = self.capacity();
        let [low, high] = [3, 4]
            .map(|column| u64::from(self.words[column * capacity + 1 + index].cast_unsigned()));
        CubeId(high << 32 | low)
    }

    pub(super) fn set_id(&mut self, index: usize, id: CubeId) {
        let capacity = self.capacity();
        for (column, shift) in [(3, 0), (4, 32)] {
            let half = u32::try_from(id.0 >> shift & u64::from(u32::MAX));
            self.words[column * capacity + 1 + index] =
                half.expect("32 bits were kept").cast_signed();
        }
    }

    /// Cubes, the last ones, that take part in the batch that is under way; 0 otherwise.
    #[inline]
    pub(super) fn fresh(&self) -> usize {
        self.words[3 * self.capacity()].cast_unsigned() as usize
    }

    pub(super) fn set_fresh(&mut self, fresh: usize) {
        let at = 3 * self.capacity();
        self.words[at] = i32::try_from(fresh).expect("there are at most 2^31 cubes");
    }

    /// Index of a cube at `corner`, of this id if one is given.
    pub(super) fn position(
        &self,
        avx2: Option<Avx2>,
        corner: [i32; 3],
        id: Option<CubeId>,
    ) -> Option<usize> {
        let mut found = None;
        self.visit(avx2, corner, [0; 3], |index| {
            let fits = id.is_none_or(|id| id == self.id(index));
            found = fits.then_some(index);
            fits
        });
        found
    }

    /// Calls `visit` with the index of every cube whose lower corner lies within `reach` above `min`, until it answers true.
    #[inline]
    pub(super) fn visit(
        &self,
        avx2: Option<Avx2>,
        min: [i32; 3],
        reach: [u32; 3],
        mut visit: impl FnMut(usize) -> bool,
    ) {
        let corners = self.corners();
        for first in (0..self.len()).step_by(WORDS) {
            let mut kept =
                within(avx2, corners, first, min, reach) & first_bits(self.len() - first);
            while kept != 0 {
                if visit(first + kept.trailing_zeros() as usize) {
                    return;
                }
                kept &= kept - 1;
            }
        }
    }

    /// Prefetches the corners; a divided bin has none, however many cubes it counts.
    #[inline]
    pub(super) fn prefetch(&self) {
        const LINE: usize = 16;
        let capacity = self.capacity();
        let used = self.len().min(capacity);
        for axis in 0..3 {
            for line in (0..used).step_by(LINE) {
                prefetch(&self.words, axis * capacity + line);
            }
        }
    }

    /// Prefetches where the next cube is put.
    #[inline]
    pub(super) fn prefetch_end(&self) {
        let capacity = self.capacity();
        for column in 0..5 {
            prefetch(&self.words, column * capacity + self.len());
        }
    }

    fn push(&mut self, corner: [i32; 3], id: CubeId) {
        let index = self.len();
        let capacity = self.capacity();
        if index == capacity {
            // A quarter more than there is: doubling would cost more bytes than the cubes.
            self.resize((capacity + capacity / 4 + CAPACITY_MIN) / CAPACITY_MIN * CAPACITY_MIN);
        }
        self.len += 1;
        self.set(index, corner, id);
    }

    fn set(&mut self, index: usize, corner: [i32; 3], id: CubeId) {
        let capacity = self.capacity();
        for (axis, coordinate) in corner.into_iter().enumerate() {
            self.words[axis * capacity + index] = coordinate;
        }
        self.set_id(index, id);
    }

    /// The last cube takes the place of the removed one.
    fn swap_remove(&mut self, index: usize) {
        let last = self.len() - 1;
        self.set(index, self.corner(last), self.id(last));
        self.len -= 1;
        let capacity = self.capacity();
        if last > 0 && last + 3 * CAPACITY_MIN < capacity - capacity / 4 {
            self.resize(capacity - capacity / 4);
        }
    }

    pub(super) fn swap(&mut self, one: usize, other: usize) {
        let (corner, id) = (self.corner(one), self.id(one));
        self.set(one, self.corner(other), self.id(other));
        self.set(other, corner, id);
    }

    fn resize(&mut self, capacity: usize) {
        let old = self.capacity();
        let mut words = vec![0; 5 * capacity + 1].into_boxed_slice();
        for column in 0..5 {
            let skip = usize::from(column >= 3);
            let (from, to) = (column * old + skip, column * capacity + skip);
            if old > 0 {
                words[to..to + self.len()].copy_from_slice(&self.words[from..from + self.len()]);
            }
        }
        words[3 * capacity] = self.words.get(3 * old).copied().unwrap_or(0);
        self.words = words;
    }
}

/// The bins of one level of a grid.
#[derive(Debug)]
pub(super) struct Bins {
    tables: Box<[Table]>,
    /// Bins that there are.
    len: usize,
    /// Those of them that are divided.
    divided: usize,
    /// Words of all bins.
    words: usize,
}

/// Tables of a level: a power of two.
const TABLES: usize = 64;
/// Least slots of a table that has any.
const SLOTS_MIN: usize = 4;

/// A part of the bins: those whose hash begins alike.
#[derive(Clone, Debug, Default)]
struct Table {
    slots: Box<[Bin]>,
    /// Slots that hold a bin: at most three quarters of all.
    used: usize,
}

/// What some tables have grown by.
#[derive(Clone, Copy, Default)]
pub(super) struct Growth {
    bins: usize,
    words: usize,
}

/// Some of the tables of a level.
pub(super) struct Share<'a> {
    first: usize,
    tables: &'a mut [Table],
    growth: Growth,
}

/// A position in a walk over all bins that goes on while they change: some may be met twice or not at all.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Walk {
    table: usize,
    slot: usize,
}

/// A position in a walk over the cubes of all bins, as a [`Walk`].
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CubeWalk {
    bins: Walk,
    index: usize,
}

impl Bins {
    pub(super) fn new() -> Self {
        Self {
            tables: vec![Table::default(); TABLES].into_boxed_slice(),
            len: 0,
            divided: 0,
            words: 0,
        }
    }

    /// How many bins there are.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    #[inline]
    pub(super) fn get(&self, key: BinKey) -> Option<&Bin> {
        self.get_hashed(key, key.hash())
    }

    /// The same for a key whose hash is known.
    #[inline]
    pub(super) fn get_hashed(&self, key: BinKey, hash: u64) -> Option<&Bin> {
        let table = &self.tables[table_of(hash)];
        let slot = table.find(key, hash).ok()?;
        Some(&table.slots[slot])
    }

    /// Changes a bin without changing the number of its cubes.
    pub(super) fn get_mut(&mut self, key: BinKey) -> Option<&mut Bin> {
        let hash = key.hash();
        let table = &mut self.tables[table_of(hash)];
        let slot = table.find(key, hash).ok()?;
        Some(&mut table.slots[slot])
    }

    /// Prefetches the slot where the search for the bin of this hash begins.
    #[inline]
    pub(super) fn prefetch(&self, hash: u64) {
        let table = &self.tables[table_of(hash)];
        prefetch(&table.slots, table.home(hash));
    }

    /// How many of them are divided.
    pub(super) fn divided(&self) -> usize {
        self.divided
    }

    /// Counts a cube that comes to the bins below a divided one. False when the bin is none.
    #[inline]
    pub(super) fn count_in(&mut self, key: BinKey) -> bool {
        let hash = key.hash();
        self.tables[table_of(hash)].count_in(key, hash, 1)
    }

    /// Counts a cube that goes from the bins below a divided one, which goes with the last of them.
    pub(super) fn count_out(&mut self, key: BinKey) {
        let bin = self
            .get_mut(key)
            .expect("a divided bin is above the others");
        debug_assert!(bin.is_divided(), "cubes are in one bin each");
        if bin.len == 1 {
            self.remove(key);
        } else {
            bin.len -= 1;
        }
    }

    /// Puts a cube into a bin that is not divided; says how many are in it now.
    pub(super) fn push(&mut self, key: BinKey, corner: [i32; 3], id: CubeId) -> usize {
        let bin = self.entry(key);
        let words = bin.words.len();
        bin.push(corner, id);
        let (len, words) = (bin.len(), bin.words.len() - words);
        self.words += words;
        len
    }

    /// The same for some, at least one, that take part in a batch; says whether they are the first such there.
    pub(super) fn push_fresh(
        &mut self,
        key: BinKey,
        cubes: impl Iterator<Item = ([i32; 3], CubeId)>,
    ) -> bool {
        let hash = key.hash();
        let (is_first, growth) = self.tables[table_of(hash)].push_fresh(key, hash, cubes);
        self.grow(growth);
        is_first
    }

    /// The tables in so many shares, or fewer, each for a thread of its own. What each grows by is to be told to [`Self::grow`].
    pub(super) fn shares(&mut self, count: usize) -> impl Iterator<Item = Share<'_>> {
        let size = TABLES.div_ceil(count);
        let tables = self.tables.chunks_mut(size);
        tables.enumerate().map(move |(number, tables)| Share {
            first: number * size,
            tables,
            growth: Growth::default(),
        })
    }

    pub(super) fn grow(&mut self, growth: Growth) {
        self.len += growth.bins;
        self.words += growth.words;
    }

    fn entry(&mut self, key: BinKey) -> &mut Bin {
        let hash = key.hash();
        let (bin, is_new) = self.tables[table_of(hash)].entry(key, hash);
        self.len += usize::from(is_new);
        bin
    }

    /// Makes a divided bin with so many cubes below it.
    pub(super) fn divide(&mut self, key: BinKey, below: usize) {
        let len = u32::try_from(below).expect("there are at most 2^31 cubes");
        let bin = self.entry(key);
        debug_assert!(
            bin.len == 0 && bin.words.is_empty(),
            "there was no such bin"
        );
        bin.len = len;
        self.divided += 1;
    }

    /// Removes a bin.
    pub(super) fn remove(&mut self, key: BinKey) -> Option<Bin> {
        let hash = key.hash();
        let table = &mut self.tables[table_of(hash)];
        let slot = table.find(key, hash).ok()?;
        let bin = table.remove(slot);
        self.len -= 1;
        self.divided -= usize::from(bin.is_divided());
        self.words -= bin.words.len();
        Some(bin)
    }

    /// Removes the cube at `index` of a bin; says how many are left.
    pub(super) fn swap_remove(&mut self, key: BinKey, index: usize) -> usize {
        let hash = key.hash();
        let table = &mut self.tables[table_of(hash)];
        let slot = table
            .find(key, hash)
            .expect("the cube was found in the bin");
        let bin = &mut table.slots[slot];
        if bin.len == 1 {
            self.remove(key);
            return 0;
        }
        let words = bin.words.len();
        bin.swap_remove(index);
        self.words -= words - bin.words.len();
        bin.len()
    }

    /// The next bin of a walk among some slots; none and false when it has come to the end.
    pub(super) fn next(&self, walk: &mut Walk) -> (Option<&Bin>, bool) {
        const SLOTS_AT_ONCE: usize = 16;
        for _ in 0..SLOTS_AT_ONCE {
            let Some(table) = self.tables.get(walk.table) else {
                return (None, false);
            };
            match table.slots.get(walk.slot) {
                None => {
                    *walk = Walk {
                        table: walk.table + 1,
                        slot: 0,
                    }
                }
                Some(bin) => {
                    walk.slot += 1;
                    if bin.len > 0 {
                        return (Some(bin), true);
                    }
                }
            }
        }
        (None, true)
    }

    /// Shows the next corners of a walk, until the work is as much as that of `budget` of them; what is left of the budget once the
    /// walk has come to its end.
    pub(super) fn next_corners(
        &self,
        walk: &mut CubeWalk,
        budget: usize,
        visit: &mut impl FnMut([i32; 3]),
    ) -> usize {
        for left in (0..budget).rev() {
            let CubeWalk { bins, index } = walk;
            let Some(table) = self.tables.get(bins.table) else {
                return left + 1;
            };
            match table.slots.get(bins.slot) {
                None => {
                    *bins = Walk {
                        table: bins.table + 1,
                        slot: 0,
                    }
                }
                Some(bin) if !bin.is_divided() && *index < bin.len() => {
                    visit(bin.corner(*index));
                    *index += 1;
                }
                Some(_) => {
                    bins.slot += 1;
                    *index = 0;
                }
            }
        }
        0
    }

    /// The bins that are not divided.
    pub(super) fn iter(&self) -> impl Iterator<Item = &Bin> {
        let slots = self.tables.iter().flat_map(|table| &table.slots);
        slots.filter(|bin| bin.len > 0 && !bin.is_divided())
    }

    /// Bytes of the tables and of what the bins hold, without the allocator's own. O(1).
    pub(super) fn size(&self) -> usize {
        let slots: usize = self.tables.iter().map(|table| table.slots.len()).sum();
        slots * size_of::<Bin>() + TABLES * size_of::<Table>() + self.words * size_of::<i32>()
    }
}

impl Share<'_> {
    /// Whether the bin of this hash belongs here; the other calls are for such.
    #[inline]
    pub(super) fn has(&self, hash: u64) -> bool {
        table_of(hash)
            .checked_sub(self.first)
            .is_some_and(|table| table < self.tables.len())
    }

    #[inline]
    pub(super) fn prefetch(&self, hash: u64) {
        let table = &self.tables[table_of(hash) - self.first];
        prefetch(&table.slots, table.home(hash));
    }

    /// Prefetches where the next cube of a bin is put.
    #[inline]
    pub(super) fn prefetch_end(&self, key: BinKey, hash: u64) {
        let table = &self.tables[table_of(hash) - self.first];
        if let Ok(slot) = table.find(key, hash) {
            table.slots[slot].prefetch_end();
        }
    }

    /// Counts cubes that come to the bins below a divided one. False when the bin is none.
    #[inline]
    pub(super) fn count_in(&mut self, key: BinKey, hash: u64, cubes: usize) -> bool {
        self.tables[table_of(hash) - self.first].count_in(key, hash, cubes)
    }

    /// See [`Bins::push_fresh`].
    pub(super) fn push_fresh(
        &mut self,
        key: BinKey,
        hash: u64,
        cubes: impl Iterator<Item = ([i32; 3], CubeId)>,
    ) -> bool {
        let table = &mut self.tables[table_of(hash) - self.first];
        let (is_first, growth) = table.push_fresh(key, hash, cubes);
        self.growth.bins += growth.bins;
        self.growth.words += growth.words;
        is_first
    }

    pub(super) fn growth(&self) -> Growth {
        self.growth
    }
}

#[inline]
fn table_of(hash: u64) -> usize {
    const SHIFT: u32 = u64::BITS - TABLES.ilog2();
    usize::try_from(hash >> SHIFT).expect("it is less than 64")
}

impl Table {
    /// Where a bin of this hash would best be: from bits that do not choose the table.
    #[inline]
    fn home(&self, hash: u64) -> usize {
        let home = ((hash & u64::from(u32::MAX)) * self.slots.len() as u64) >> 32;
        usize::try_from(home).expect("it is less than the number of slots")
    }

    /// The slot of a bin, or the vacant one where it belongs.
    #[inline]
    fn find(&self, key: BinKey, hash: u64) -> Result<usize, usize> {
        let mut slot = self.home(hash);
        loop {
            match self.slots.get(slot) {
                None if slot == 0 => return Err(0),
                None => slot = 0,
                Some(bin) if bin.len == 0 => return Err(slot),
                Some(bin) if bin.key == key => return Ok(slot),
                Some(_) => slot += 1,
            }
        }
    }

    /// The bin of a key, and whether it is new.
    fn entry(&mut self, key: BinKey, hash: u64) -> (&mut Bin, bool) {
        let (slot, is_new) = match self.find(key, hash) {
            Ok(slot) => (slot, false),
            Err(slot) => (self.vacate(slot, key, hash), true),
        };
        (&mut self.slots[slot], is_new)
    }

    /// See [`Bins::count_in`].
    #[inline]
    fn count_in(&mut self, key: BinKey, hash: u64, cubes: usize) -> bool {
        let Ok(slot) = self.find(key, hash) else {
            return false;
        };
        let bin = &mut self.slots[slot];
        let divided = bin.is_divided();
        if divided {
            bin.len += u32::try_from(cubes).expect("there are at most 2^31 cubes");
        }
        divided
    }

    /// See [`Bins::push_fresh`].
    fn push_fresh(
        &mut self,
        key: BinKey,
        hash: u64,
        cubes: impl Iterator<Item = ([i32; 3], CubeId)>,
    ) -> (bool, Growth) {
        let (bin, is_new) = self.entry(key, hash);
        let (words, len) = (bin.words.len(), bin.len());
        let fresh = if is_new { 0 } else { bin.fresh() };
        for (corner, id) in cubes {
            bin.push(corner, id);
        }
        bin.set_fresh(fresh + bin.len() - len);
        let growth = Growth {
            bins: usize::from(is_new),
            words: bin.words.len() - words,
        };
        (fresh == 0, growth)
    }

    /// Gives a vacant slot to a new bin.
    fn vacate(&mut self, slot: usize, key: BinKey, hash: u64) -> usize {
        let mut slot = slot;
        if (self.used + 1) * 4 > self.slots.len() * 3 {
            self.resize((self.slots.len() * 3 / 2).max(SLOTS_MIN));
            slot = self.find(key, hash).expect_err("the bin is new");
        }
        self.used += 1;
        self.slots[slot].key = key;
        slot
    }

    /// Removes a bin. Those behind it whose home is not behind the gap move up, so that no trace of it is left.
    fn remove(&mut self, slot: usize) -> Bin {
        let count = self.slots.len();
        let mut gap = slot;
        let mut next = slot;
        loop {
            next = if next + 1 == count { 0 } else { next + 1 };
            let bin = &self.slots[next];
            if bin.len == 0 {
                break;
            }
            let home = self.home(bin.key.hash());
            // Around the ring, the gap lies between the home of the bin and the bin.
            let from_home = |at: usize| {
                if at >= home {
                    at - home
                } else {
                    at + count - home
                }
            };
            if from_home(gap) < from_home(next) {
                self.slots.swap(gap, next);
                gap = next;
            }
        }
        let removed = std::mem::replace(&mut self.slots[gap], Bin::vacant());
        self.used -= 1;
        if self.used * 4 < count {
            let fewer = if self.used == 0 {
                0
            } else {
                (count / 2).max(SLOTS_MIN)
            };
            if fewer < count {
                self.resize(fewer);
            }
        }
        removed
    }

    fn resize(&mut self, count: usize) {
        let slots = vec![Bin::vacant(); count].into_boxed_slice();
        for bin in std::mem::replace(&mut self.slots, slots) {
            if bin.len > 0 {
                let slot = self.find(bin.key, bin.key.hash());
                self.slots[slot.expect_err("it has not been moved yet")] = bin;
            }
        }
    }
}
