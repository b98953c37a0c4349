//! Where pieces are: boxes by place and size, for all that may touch a box.
//!
//! ```text
//!   level k    pieces whose box is at most 2^k long, and longer than 2^(k-1)
//!   bin        a cube of side 2^k; a piece is in the bin of the lower corner of its box
//! ```
//! So a box of about that size looks into 27 bins at most, and one path with one tool into one or two levels.

use std::collections::HashMap;

use crate::geometry::Bounds;

/// Bounds' extents are at most `2^31`.
const LEVELS: usize = 33;

/// A piece in a bin.
#[derive(Clone, Copy, Debug)]
struct Entry {
    bounds: Bounds,
    slot: u32,
}

/// Boxes of pieces by level and place.
#[derive(Debug)]
pub(super) struct Bins {
    levels: Vec<HashMap<[i32; 3], Vec<Entry>>>,
    len: usize,
}

impl Bins {
    pub(super) fn new() -> Self {
        Self {
            levels: (0..LEVELS).map(|_| HashMap::new()).collect(),
            len: 0,
        }
    }

    /// How many pieces there are.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    pub(super) fn insert(&mut self, slot: u32, bounds: Bounds) {
        let level = level_of(&bounds);
        let bin = self.levels[level]
            .entry(bin_of(bounds.min, level))
            .or_default();
        bin.push(Entry { bounds, slot });
        self.len += 1;
    }

    /// Removes a piece; false when it is not there.
    pub(super) fn remove(&mut self, slot: u32, bounds: Bounds) -> bool {
        let level = level_of(&bounds);
        let key = bin_of(bounds.min, level);
        let Some(bin) = self.levels[level].get_mut(&key) else {
            return false;
        };
        let Some(index) = bin.iter().position(|entry| entry.slot == slot) else {
            return false;
        };
        bin.swap_remove(index);
        if bin.is_empty() {
            self.levels[level].remove(&key);
        }
        self.len -= 1;
        true
    }

    /// Calls `visit` with every piece whose closed box meets a closed box. O(levels in use, bins and pieces around).
    pub(super) fn visit(&self, bounds: &Bounds, mut visit: impl FnMut(u32, &Bounds)) {
        for (level, bins) in self.levels.iter().enumerate() {
            if bins.is_empty() {
                continue;
            }
            let mut look = |bin: &Vec<Entry>| {
                for entry in bin.iter().filter(|entry| meet(&entry.bounds, bounds)) {
                    visit(entry.slot, &entry.bounds);
                }
            };
            let low = bin_of(bounds.min, level).map(|index| index - 1);
            let high = bin_of(bounds.max, level);
            let count = |axis: usize| i64::from(high[axis]) - i64::from(low[axis]) + 1;
            let around = count(0).saturating_mul(count(1)).saturating_mul(count(2));
            if usize::try_from(around).is_ok_and(|around| around > bins.len()) {
                bins.values().for_each(look);
                continue;
            }
            for x in low[0]..=high[0] {
                for y in low[1]..=high[1] {
                    for z in low[2]..=high[2] {
                        if let Some(bin) = bins.get(&[x, y, z]) {
                            look(bin);
                        }
                    }
                }
            }
        }
    }

    /// The other pieces whose boxes meet that of a piece, nearest first.
    pub(super) fn nearest(&self, bounds: &Bounds, except: u32) -> Vec<u32> {
        let mut around = Vec::new();
        self.visit(bounds, |slot, other| {
            if slot != except {
                let middle = |bounds: &Bounds, axis: usize| {
                    i64::from(bounds.min[axis]) + i64::from(bounds.max[axis])
                };
                let distance = |axis| middle(bounds, axis).abs_diff(middle(other, axis));
                around.push((distance(0) + distance(1) + distance(2), slot));
            }
        });
        around.sort_unstable();
        around.into_iter().map(|(_, slot)| slot).collect()
    }

    /// Bytes that it takes, without the allocator's own.
    pub(super) fn size(&self) -> usize {
        let bin = |bin: &Vec<Entry>| bin.capacity() * size_of::<Entry>();
        let level = |bins: &HashMap<[i32; 3], Vec<Entry>>| {
            let slots = bins.capacity() * (size_of::<([i32; 3], Vec<Entry>)>() + 1);
            slots + bins.values().map(bin).sum::<usize>()
        };
        self.levels.iter().map(level).sum()
    }
}

/// Whether two closed boxes have a point in common.
pub(super) fn meet(a: &Bounds, b: &Bounds) -> bool {
    (0..3).all(|axis| a.min[axis] <= b.max[axis] && b.min[axis] <= a.max[axis])
}

/// The least `k` with every extent at most `2^k`.
fn level_of(bounds: &Bounds) -> usize {
    let extent = |axis: usize| bounds.max[axis].abs_diff(bounds.min[axis]);
    let longest = extent(0).max(extent(1)).max(extent(2)).max(1);
    (u32::BITS - (longest - 1).leading_zeros()) as usize
}

fn bin_of(corner: [i32; 3], level: usize) -> [i32; 3] {
    corner.map(|coordinate| coordinate >> level.min(31))
}
