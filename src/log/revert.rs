//! Reading operations backwards: what the cubes were at an earlier seq.
//!
//! Knows which operations are kept; what becomes of the difference is the service's.

use super::scene::SceneLog;
use super::{LogError, Seq};
use crate::geometry::Effect;

impl SceneLog {
    /// Oldest seq that can be gone back to: the operations of every later change are kept.
    pub fn oldest_reachable(&self) -> Seq {
        Seq(self.database.head.operations_first - 1)
    }

    /// Shows what every change after `to` did, newest first. `to` is reachable. O(operations since).
    /// # Errors
    /// [`LogError::Damaged`] when a record is not what was written.
    pub fn read_back(&self, to: Seq, visit: &mut dyn FnMut(&Effect)) -> Result<(), LogError> {
        assert!(
            self.oldest_reachable() <= to,
            "operations that were dropped are not asked for"
        );
        let site = &self.database.site;
        let mut expected = self.seq();
        self.each(
            "SELECT * FROM operations WHERE seq > ? ORDER BY seq DESC",
            [to.0.cast_signed()],
            |row| {
                let effect = self.operations(row, 0, expected)?;
                expected = Seq(expected.0 - 1);
                visit(&effect);
                Ok(())
            },
        )?;
        if expected == to.min(self.seq()) {
            Ok(())
        } else {
            Err(site.damaged(expected, "the change is missing"))
        }
    }
}
