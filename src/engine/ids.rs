//! The cubes of a scene by id: an ordered hash table without a word for what is not there.
//!
//! Entries stand in the order of a *bijective* mix of their ids, each at or after the slot its mix points to, without a
//! gap in between (linear probing, kept sorted). So the order of a listing depends on the ids alone (not on history,
//! size or restarts), and a cursor is just the mix of the last id listed.
//!
//! ```text
//!   slot   0    1    2    3    4    5    6   ...
//!   mix   .03  .04  .21   -   .40  .41  .44        home(mix) = mix * capacity / 2^64, in one of 64 shards
//! ```

use crate::geometry::{CubeId, Place};

use super::prefetch::{AHEAD, prefetch};

/// Position in the listing of a scene's cubes; the order is fixed by the ids alone, whatever the history.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Cursor(pub u64);

impl Cursor {
    /// Where a cube stands in the listing.
    pub fn of(id: CubeId) -> Self {
        Self(mix(id))
    }
}

/// One cube: 20 bytes, so that a table at 53 to 80 % load takes 25 to 38 bytes a cube.
#[derive(Clone, Copy, Debug)]
struct Entry {
    /// Low and high half of the id; split so that an entry needs no padding.
    id: [u32; 2],
    /// None in an empty slot (a `Place` has a niche of its own only by luck, so the sentinel is explicit).
    corner: [i32; 3],
}

/// No place has this coordinate: see `COORDINATE_MAX`.
const NOWHERE: i32 = i32::MIN;
const EMPTY: Entry = Entry {
    id: [0; 2],
    corner: [NOWHERE; 3],
};
const _: () = assert!(size_of::<Entry>() == 20);

/// Slots behind the last home, so that a run at the end of a shard need not wrap around.
const TAIL_MAX: usize = 64;
const CAPACITY_MIN: usize = 4;

/// Shards of the table. Each grows and shrinks alone, so that a pause is a sixty-fourth of what it would be.
pub(super) const SHARDS: usize = 64;

/// So far from its home a cube is looked for slot by slot: most are nearer.
const STEPS_OF_ONE: usize = 16;

/// Cubes by id, in the order of the listing.
#[derive(Debug)]
pub struct IdTable {
    /// By the first bits of the mix, so that the order goes on from one to the next.
    shards: Box<[Shard]>,
    len: usize,
}

/// The ids whose mix begins alike.
#[derive(Clone, Debug, Default)]
pub(super) struct Shard {
    /// `capacity` homes and a tail; nothing at all when there are no cubes.
    slots: Vec<Entry>,
    capacity: usize,
    len: usize,
}

impl Default for IdTable {
    fn default() -> Self {
        Self::new()
    }
}

impl IdTable {
    /// A table without cubes.
    pub fn new() -> Self {
        Self {
            shards: vec![Shard::default(); SHARDS].into_boxed_slice(),
            len: 0,
        }
    }

    /// Number of cubes. O(1).
    pub fn len(&self) -> usize {
        self.len
    }

    /// Removes all cubes. Keeps the room for about as many, and gives back what is more than four times that.
    pub fn clear(&mut self) {
        for shard in &mut self.shards {
            shard.clear();
        }
        self.len = 0;
    }

    /// Whether there is no cube. O(1).
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Where the cube of this id is. O(1).
    pub fn get(&self, id: CubeId) -> Option<Place> {
        let mixed = mix(id);
        let shard = &self.shards[shard_of(mixed)];
        shard.find(mixed).ok().map(|slot| shard.slots[slot].place())
    }

    /// Prefetches the slot where the search for an id begins.
    #[inline]
    pub(super) fn prefetch(&self, id: CubeId) {
        let mixed = mix(id);
        let shard = &self.shards[shard_of(mixed)];
        prefetch(&shard.slots, shard.home(mixed));
    }

    /// Makes room for about so many more cubes at once, instead of step by step.
    pub(super) fn reserve(&mut self, more: usize) {
        // Shards do not fill alike: by a sixteenth more or less at most, nearly always, from so many cubes on.
        if more >= SHARDS * 1024 {
            for shard in &mut self.shards {
                shard.reserve(more / SHARDS + more / SHARDS / 16);
            }
        }
    }

    /// Inserts a cube; false, and nothing done, when the id is there.
    pub fn insert(&mut self, id: CubeId, place: Place) -> bool {
        let mixed = mix(id);
        let inserted = self.shards[shard_of(mixed)].insert(mixed, Entry::new(id, place));
        self.len += usize::from(inserted);
        inserted
    }

    /// Removes a cube and says where it was.
    pub(super) fn remove(&mut self, id: CubeId) -> Option<Place> {
        let mixed = mix(id);
        let place = self.shards[shard_of(mixed)].remove(mixed)?;
        self.len -= 1;
        Some(place)
    }

    /// The shard in which an id is.
    #[inline]
    pub(super) fn shard_of(id: CubeId) -> usize {
        shard_of(mix(id))
    }

    /// A shard as it is without some cubes of its own and with others; none when one of them does not fit.
    pub(super) fn changed(
        &self,
        shard: usize,
        deleted: &[(CubeId, Place)],
        inserted: &[(CubeId, Place)],
    ) -> Option<Shard> {
        let mut changed = self.shards[shard].clone();
        changed.delete_each(deleted)?;
        changed.insert_each(inserted)?;
        Some(changed)
    }

    /// Puts a shard in place of what it was, and what it was in place of it.
    pub(super) fn swap_shard(&mut self, number: usize, shard: &mut Shard) {
        let here = &mut self.shards[number];
        self.len = self.len - here.len + shard.len;
        std::mem::swap(here, shard);
    }

    /// See [`Engine::cubes_after`](super::Engine::cubes_after).
    pub fn cubes_after(&self, after: Option<Cursor>) -> impl Iterator<Item = (CubeId, Place)> + '_ {
        let (first, start) = match after {
            None => (0, 0),
            Some(Cursor(last)) => {
                let first = shard_of(last);
                let slot = self.shards[first].find(last);
                (first, slot.map_or_else(|next| next, |found| found + 1))
            }
        };
        let later = self.shards[first + 1..].iter();
        let later = later.flat_map(|shard| shard.cubes_from(0));
        self.shards[first].cubes_from(start).chain(later)
    }

    /// Bytes of the table.
    pub(super) fn size(&self) -> usize {
        let slots: usize = self.shards.iter().map(|shard| shard.slots.capacity()).sum();
        slots * size_of::<Entry>() + SHARDS * size_of::<Shard>()
    }
}

const SHARD_BITS: u32 = SHARDS.ilog2();

#[inline]
fn shard_of(mixed: u64) -> usize {
    usize::try_from(mixed >> (u64::BITS - SHARD_BITS)).expect("it is less than 64")
}

impl Shard {
    fn clear(&mut self) {
        if self.len * 4 < self.capacity {
            *self = Self::default();
        } else {
            self.slots.fill(EMPTY);
            self.len = 0;
        }
    }

    /// None when a cube is not there.
    fn delete_each(&mut self, cubes: &[(CubeId, Place)]) -> Option<()> {
        for (at, (id, place)) in cubes.iter().enumerate() {
            self.prefetch(cubes.get(at + AHEAD));
            if self.remove(mix(*id)) != Some(*place) {
                return None;
            }
        }
        Some(())
    }

    /// None when an id is there.
    fn insert_each(&mut self, cubes: &[(CubeId, Place)]) -> Option<()> {
        self.reserve(cubes.len());
        for (at, (id, place)) in cubes.iter().enumerate() {
            self.prefetch(cubes.get(at + AHEAD));
            if !self.insert(mix(*id), Entry::new(*id, *place)) {
                return None;
            }
        }
        Some(())
    }

    #[inline]
    fn prefetch(&self, cube: Option<&(CubeId, Place)>) {
        if let Some((id, _)) = cube {
            prefetch(&self.slots, self.home(mix(*id)));
        }
    }

    fn reserve(&mut self, more: usize) {
        let needed = self.len + more;
        if needed * 5 > self.capacity * 4 {
            self.resize((needed * 4 / 3).max(self.capacity * 3 / 2));
        }
    }

    fn insert(&mut self, mixed: u64, entry: Entry) -> bool {
        if (self.len + 1) * 5 > self.capacity * 4 {
            self.resize((self.capacity * 3 / 2).max(CAPACITY_MIN));
        }
        let Err(slot) = self.find(mixed) else {
            return false;
        };
        let Some(run) = self.slots[slot..].iter().position(Entry::is_empty) else {
            // The tail is full: a long run at the very end. A larger table spreads it.
            self.resize(self.capacity * 3 / 2);
            return self.insert(mixed, entry);
        };
        self.slots.copy_within(slot..slot + run, slot + 1);
        self.slots[slot] = entry;
        self.len += 1;
        true
    }

    fn remove(&mut self, mixed: u64) -> Option<Place> {
        let slot = self.find(mixed).ok()?;
        let place = self.slots[slot].place();
        // Everything behind it that is not in its own home moves one back.
        let run = self.slots[slot + 1..]
            .iter()
            .zip(slot + 1..)
            .position(|(entry, at)| entry.is_empty() || self.home(mix(entry.id())) == at)
            .unwrap_or(self.slots.len() - slot - 1);
        self.slots.copy_within(slot + 1..=slot + run, slot);
        self.slots[slot + run] = EMPTY;
        self.len -= 1;
        if self.len == 0 {
            *self = Self::default();
        } else if self.len * 4 < self.capacity && self.capacity > CAPACITY_MIN {
            self.resize((self.capacity / 2).max(CAPACITY_MIN));
        }
        Some(place)
    }

    fn cubes_from(&self, slot: usize) -> impl Iterator<Item = (CubeId, Place)> + '_ {
        self.slots[slot..]
            .iter()
            .filter(|entry| !entry.is_empty())
            .map(|entry| (entry.id(), entry.place()))
    }

    /// From the bits that do not choose the shard.
    #[inline]
    fn home(&self, mixed: u64) -> usize {
        let home = (u128::from(mixed << SHARD_BITS) * self.capacity as u128) >> 64;
        usize::try_from(home).expect("a home is less than the capacity")
    }

    /// The slot of this mix, or the slot where it belongs.
    ///
    /// Usually a few slots from its home. But cubes that come in the order of a listing (from a snapshot, or from another scene)
    /// fill the front of the table before the rest, in one run as long as what has come: there steps that double, then a
    /// search by halves, keep it O(log run).
    fn find(&self, mixed: u64) -> Result<usize, usize> {
        // Between home and the place of the mix there is no gap, so this is true up to that place and false from there on.
        let is_before = |slot: usize| {
            #[cfg(test)]
            tests::PROBES.set(tests::PROBES.get() + 1);
            let entry = self.slots.get(slot);
            entry.is_some_and(|entry| !entry.is_empty() && mix(entry.id()) < mixed)
        };
        let mut low = self.home(mixed);
        let near = low + STEPS_OF_ONE;
        while low < near && is_before(low) {
            low += 1;
        }
        if low == near {
            let (mut high, mut step) = (low, 1);
            while is_before(high) {
                low = high + 1;
                high += step;
                step *= 2;
            }
            while low < high {
                let middle = usize::midpoint(low, high);
                if is_before(middle) {
                    low = middle + 1;
                } else {
                    high = middle;
                }
            }
        }
        match self.slots.get(low) {
            Some(entry) if !entry.is_empty() && mix(entry.id()) == mixed => Ok(low),
            _ => Err(low),
        }
    }

    /// Moves everything to slots of another capacity: one pass in order, since the order does not change.
    fn resize(&mut self, capacity: usize) {
        let mut larger = Self {
            slots: vec![EMPTY; capacity + capacity.min(TAIL_MAX)],
            capacity,
            len: self.len,
        };
        let mut next = 0;
        for entry in self.slots.iter().filter(|entry| !entry.is_empty()) {
            let slot = larger.home(mix(entry.id())).max(next);
            if slot == larger.slots.len() {
                return self.resize(capacity * 3 / 2);
            }
            larger.slots[slot] = *entry;
            next = slot + 1;
        }
        *self = larger;
    }
}

impl Entry {
    fn new(id: CubeId, place: Place) -> Self {
        let half =
            |bits: u64| u32::try_from(bits & u64::from(u32::MAX)).expect("32 bits were kept");
        Self {
            id: [half(id.0), half(id.0 >> 32)],
            corner: place.corner(),
        }
    }

    fn is_empty(&self) -> bool {
        self.corner[0] == NOWHERE
    }

    fn id(&self) -> CubeId {
        CubeId(u64::from(self.id[1]) << 32 | u64::from(self.id[0]))
    }

    fn place(&self) -> Place {
        Place::from_checked(self.corner)
    }
}

/// A bijection of u64 that spreads neighbouring ids evenly.
/// # Source
/// The finaliser of splitmix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators", 2014).
fn mix(CubeId(id): CubeId) -> u64 {
    let mut mixed = id.wrapping_add(0x9e37_79b9_7f4a_7c15);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    thread_local! {
        /// Slots that were looked at to find where ids belong.
        pub(super) static PROBES: Cell<u64> = const { Cell::new(0) };
    }

    /// A table of ids, and the slots that were looked at to fill it.
    fn filled(ids: &[CubeId]) -> (u64, IdTable) {
        let mut table = IdTable::new();
        PROBES.set(0);
        for id in ids {
            assert!(table.insert(*id, Place::from_checked([1, 2, 3])));
        }
        (PROBES.get(), table)
    }

    /// Replay of a snapshot took time in the square of the number of cubes: each was looked for slot by slot through all
    /// that had come before.
    #[test]
    fn the_order_of_a_listing_takes_few_probes_too() {
        let ids: Vec<CubeId> = (0..200_000).map(CubeId).collect();
        let (probes, table) = filled(&ids);
        let listed: Vec<CubeId> = table.cubes_after(None).map(|(id, _)| id).collect();
        assert_ne!(listed, ids);
        let (listed_probes, again) = filled(&listed);
        assert!(again.cubes_after(None).map(|(id, _)| id).eq(listed));
        assert!(ids.iter().all(|id| again.get(*id).is_some()));
        assert!(again.get(CubeId(200_000)).is_none());
        // Slot by slot it is hundreds for each.
        let each = |probes: u64| probes / ids.len() as u64;
        assert!(each(probes) < 10, "{probes} in any order");
        assert!(
            each(listed_probes) < 50,
            "{listed_probes} in that of the listing"
        );
    }

    /// Chunks of a listing, each in the order of its ids, fill only the front of a table that grows with them: all of it is one run, and each
    /// moves half of it.
    #[test]
    fn a_table_with_room_for_them_does_not_grow() {
        let ids: Vec<CubeId> = (0..200_000).map(CubeId).collect();
        let (_, table) = filled(&ids);
        let mut chunks: Vec<CubeId> = table.cubes_after(None).map(|(id, _)| id).collect();
        for chunk in chunks.chunks_mut(1 << 16) {
            chunk.sort_unstable_by_key(|id| id.0);
        }
        let mut again = IdTable::new();
        again.reserve(chunks.len());
        let size = again.size();
        let capacities = again.shards.iter().map(|shard| shard.capacity);
        let capacities: Vec<usize> = capacities.collect();
        for id in chunks {
            assert!(again.insert(id, Place::from_checked([1, 2, 3])));
        }
        assert!(again.cubes_after(None).eq(table.cubes_after(None)));
        assert_eq!(again.size(), size);
        assert!(
            again
                .shards
                .iter()
                .map(|shard| shard.capacity)
                .eq(capacities)
        );
    }
}
