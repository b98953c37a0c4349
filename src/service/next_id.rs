//! The ids that the server gives.

use crate::geometry::CubeId;

/// First and last of consecutive ids.
pub(super) type IdRange = (CubeId, CubeId);

/// Where the ids that the server may give begin: after the greatest that was ever inserted, as long as there are any; once a
/// client has used up the greatest of all, from the beginning again, wherever enough of them are free.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct NextId {
    /// At least 1.
    next: u64,
    /// Whether no id from `next` on is taken.
    is_past_all: bool,
}

impl NextId {
    /// Of a scene without changes.
    pub(super) const FIRST: Self = Self {
        next: 1,
        is_past_all: true,
    };

    /// As [`Self::recorded`] gave it, of a set of which `self` has passed every id. An earlier version recorded 0 when there was none left.
    pub(super) fn of_record(self, number: u64) -> Self {
        let is_past_all = self.is_past_all && number >= self.next;
        Self {
            next: number.max(1),
            is_past_all,
        }
    }

    /// As a snapshot keeps it.
    pub(super) fn recorded(self) -> u64 {
        self.next
    }

    /// Whether the ids that it gives are free without looking.
    pub(super) fn is_past_all(self) -> bool {
        self.is_past_all
    }

    /// Takes note of an inserted cube.
    pub(super) fn pass(&mut self, inserted: CubeId) {
        if inserted.0 < self.next {
            return;
        }
        match inserted.0.checked_add(1) {
            Some(next) => self.next = next,
            None => {
                *self = Self {
                    next: 1,
                    is_past_all: false,
                }
            }
        }
    }

    /// So many consecutive ids, at least one. O(1) as long as none was taken at the end of all ids; then O(ids that are passed over).
    pub(super) fn range(self, count: u64, is_taken: impl Fn(CubeId) -> bool) -> IdRange {
        if self.is_past_all
            && let Some(last) = self.next.checked_add(count - 1)
        {
            return (CubeId(self.next), CubeId(last));
        }
        let found = free(self.next, count, &is_taken).or_else(|| free(1, count, &is_taken));
        found.expect("2^31 ids do not part 2^64 into pieces shorter than 2^24")
    }
}

/// The first free run of so many ids from one on.
fn free(from: u64, count: u64, is_taken: &impl Fn(CubeId) -> bool) -> Option<IdRange> {
    let (mut first, mut id) = (from, from);
    loop {
        if is_taken(CubeId(id)) {
            first = id.checked_add(1)?;
            id = first;
        } else if id - first == count - 1 {
            return Some((CubeId(first), CubeId(id)));
        } else {
            id = id.checked_add(1)?;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn passed(ids: &[u64]) -> (NextId, BTreeSet<u64>) {
        let mut next = NextId::FIRST;
        ids.iter().for_each(|id| next.pass(CubeId(*id)));
        (next, ids.iter().copied().collect())
    }

    #[track_caller]
    fn check(ids: &[u64], count: u64, first: u64) {
        let (next, taken) = passed(ids);
        let range = next.range(count, |id| taken.contains(&id.0));
        assert_eq!(
            range,
            (CubeId(first), CubeId(first + (count - 1))),
            "{ids:?}"
        );
        // A snapshot of the set tells the same.
        let (set, _) = passed(&taken.iter().copied().collect::<Vec<_>>());
        let restored = set.of_record(next.recorded());
        assert_eq!(restored.range(count, |id| taken.contains(&id.0)), range);
        assert!(next.is_past_all() || !restored.is_past_all());
    }

    #[test]
    fn numbers_go_on_after_the_greatest_and_once_that_is_taken_where_there_is_room() {
        const END: u64 = u64::MAX;
        check(&[], 3, 1);
        check(&[0], 1, 1);
        check(&[7, 2], 2, 8);
        check(&[END - 2], 2, END - 1);
        check(&[END - 2], 3, 1);
        check(&[END], 2, 1);
        check(&[1, 2, 4, 5, END], 1, 3);
        check(&[1, 2, 4, 5, END], 2, 6);
        check(&[END, 4], 2, 5);
        check(&[END, END - 1], 1, 1);
        // Recorded by a version that gave up.
        let (set, taken) = passed(&[1, END]);
        let range = set.of_record(0).range(1, |id| taken.contains(&id.0));
        assert_eq!(range, (CubeId(2), CubeId(2)));
    }
}
