//! The ids that the server gives.

use crate::geometry::CubeId;

/// First and last of consecutive ids.
pub(super) type IdRange = (CubeId, CubeId);

/// The next id the server may give: the one after the greatest that was ever inserted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct NextId(
    /// 0 when there is none left.
    u64,
);

impl NextId {
    /// Of a scene without changes.
    pub(super) const FIRST: Self = Self(1);

    /// As [`Self::recorded`] gave it.
    pub(super) fn of_record(number: u64) -> Self {
        Self(number)
    }

    /// As a snapshot keeps it: 0 when there is none left.
    pub(super) fn recorded(self) -> u64 {
        self.0
    }

    /// Takes note of an inserted cube.
    pub(super) fn pass(&mut self, inserted: CubeId) {
        if self.0 != 0 {
            self.0 = inserted.0.checked_add(1).map_or(0, |next| next.max(self.0));
        }
    }

    /// So many consecutive ids, at least one; none when there are not so many left.
    pub(super) fn range(self, count: u64) -> Option<IdRange> {
        let last = self.0.checked_add(count - 1)?;
        (self.0 != 0).then_some((CubeId(self.0), CubeId(last)))
    }
}
