//! A sorted map to which single entries and whole runs are added, each key once: the first entry of a key stays.
//!
//! ```text
//!   few   a tree, for entries that come one by one
//!   many  a sorted list, into which a run is merged        no key is in both
//! ```
//! A tree alone would take several times as long for runs of thousands; a list alone would move thousands for one.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::ops::Bound;

/// Entries in the order of their keys, each key once.
pub(super) type Run<K, V> = Vec<(K, V)>;

/// A sorted map in two tiers.
#[derive(Debug)]
pub(super) struct Tiered<K, V> {
    few: BTreeMap<K, V>,
    many: Run<K, V>,
}

impl<K, V> Default for Tiered<K, V> {
    fn default() -> Self {
        Self {
            few: BTreeMap::new(),
            many: Vec::new(),
        }
    }
}

impl<K: Ord + Copy, V: Copy> Tiered<K, V> {
    pub(super) fn is_empty(&self) -> bool {
        self.few.is_empty() && self.many.is_empty()
    }

    pub(super) fn get(&self, key: K) -> Option<V> {
        self.few.get(&key).copied().or_else(|| self.listed(key))
    }

    /// Adds an entry; false, and nothing done, when there is one of this key.
    pub(super) fn insert(&mut self, key: K, value: V) -> bool {
        if self.listed(key).is_some() {
            return false;
        }
        match self.few.entry(key) {
            Entry::Vacant(vacant) => {
                vacant.insert(value);
                true
            }
            Entry::Occupied(_) => false,
        }
    }

    /// What [`Self::replace_many`] is to be given so that a run is added, and the entries of the run that are new. The run is sorted and
    /// has each key once. O(entries).
    pub(super) fn merged(&self, run: Run<K, V>) -> (Run<K, V>, Run<K, V>) {
        debug_assert!(run.is_sorted_by(|(one, _), (next, _)| one < next));
        let mut fresh = run;
        if !self.is_empty() {
            let mut known = self.from(Bound::Unbounded).map(|(key, _)| key).peekable();
            fresh.retain(|(key, _)| {
                while known.next_if(|known| known < key).is_some() {}
                known.peek() != Some(key)
            });
        }
        let mut merged = Vec::with_capacity(self.many.len() + fresh.len());
        merged.extend(merge(self.many.iter().copied(), fresh.iter().copied()));
        (merged, fresh)
    }

    /// Takes a list that [`Self::merged`] made, and gives back the one it was made from.
    pub(super) fn replace_many(&mut self, many: Run<K, V>) -> Run<K, V> {
        std::mem::replace(&mut self.many, many)
    }

    /// The entries from a bound on, in order.
    pub(super) fn from(&self, start: Bound<K>) -> impl Iterator<Item = (K, V)> + '_ {
        let first = self.many.partition_point(|(key, _)| match start {
            Bound::Included(start) => *key < start,
            Bound::Excluded(start) => *key <= start,
            Bound::Unbounded => false,
        });
        let few = self.few.range((start, Bound::Unbounded));
        merge(
            self.many[first..].iter().copied(),
            few.map(|(key, value)| (*key, *value)),
        )
    }

    fn listed(&self, key: K) -> Option<V> {
        let found = self.many.binary_search_by_key(&key, |(key, _)| *key);
        found.ok().map(|at| self.many[at].1)
    }
}

/// Two sorted sequences without a common key as one.
fn merge<K: Ord + Copy, V>(
    one: impl Iterator<Item = (K, V)>,
    other: impl Iterator<Item = (K, V)>,
) -> impl Iterator<Item = (K, V)> {
    let (mut one, mut other) = (one.peekable(), other.peekable());
    std::iter::from_fn(move || match (one.peek(), other.peek()) {
        (Some((left, _)), Some((right, _))) if right < left => other.next(),
        (Some(_), _) => one.next(),
        (None, _) => other.next(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// Against a plain map: single entries and runs in any order, small keys so that most come again.
    #[test]
    fn the_first_entry_of_a_key_stays() {
        let mut random = Random::new(1);
        let mut below = |bound| random.below(bound);
        for round in 0..200 {
            let mut tiered = Tiered::default();
            let mut plain = BTreeMap::new();
            for value in 0..20 {
                if below(2) == 0 {
                    let key = below(30);
                    let is_new = !plain.contains_key(&key);
                    assert_eq!(tiered.insert(key, value), is_new, "round {round}");
                    plain.entry(key).or_insert(value);
                } else {
                    let mut run: Vec<(u64, u64)> = (0..below(9))
                        .map(|extra| (below(30), value * 100 + extra))
                        .collect();
                    run.sort_by_key(|(key, _)| *key);
                    run.dedup_by_key(|(key, _)| *key);
                    let (merged, fresh) = tiered.merged(run.clone());
                    tiered.replace_many(merged);
                    let mut expected = Vec::new();
                    for (key, value) in run {
                        plain.entry(key).or_insert_with(|| {
                            expected.push((key, value));
                            value
                        });
                    }
                    assert_eq!(fresh, expected, "round {round}");
                }
            }
            let starts = (0..30).flat_map(|key| [Bound::Included(key), Bound::Excluded(key)]);
            for start in starts.chain([Bound::Unbounded]) {
                let expected = plain.range((start, Bound::Unbounded));
                let found = tiered.from(start);
                assert!(
                    found.eq(expected.map(|(key, value)| (*key, *value))),
                    "round {round} from {start:?}"
                );
            }
            for key in 0..30 {
                assert_eq!(tiered.get(key), plain.get(&key).copied());
            }
        }
    }
}
