//! The cubes that touch one cube: what the grid hands to the kernel.

use super::lanes::WORDS;

/// Offsets from the lower corner of one cube to those of the cubes that touch it (closed boxes, so no coordinate is
/// beyond an edge on either side), in no particular order: a column for each axis.
///
/// A column is longer than `len` by at least [`WORDS`] elements of no meaning, so that whole registers may be read and
/// written from any element before `len` and right behind the last one.
#[derive(Clone, Debug)]
pub(super) struct Neighbours {
    pub(super) x: Vec<i32>,
    pub(super) y: Vec<i32>,
    pub(super) z: Vec<i32>,
    pub(super) len: usize,
}

impl Neighbours {
    pub(super) fn new() -> Self {
        let column = || vec![0; WORDS];
        Self {
            x: column(),
            y: column(),
            z: column(),
            len: 0,
        }
    }

    pub(super) fn clear(&mut self) {
        self.len = 0;
    }

    /// Makes room for `more` offsets and the elements behind them.
    #[inline]
    pub(super) fn reserve(&mut self, more: usize) {
        let needed = self.len + more + WORDS;
        if self.x.len() < needed {
            self.grow(needed);
        }
    }

    #[cold]
    fn grow(&mut self, needed: usize) {
        for column in [&mut self.x, &mut self.y, &mut self.z] {
            column.resize(needed.next_power_of_two(), 0);
        }
    }

    /// Appends an offset.
    pub(super) fn push(&mut self, [x, y, z]: [i32; 3]) {
        self.reserve(1);
        self.x[self.len] = x;
        self.y[self.len] = y;
        self.z[self.len] = z;
        self.len += 1;
    }

    /// Removes the last offset.
    pub(super) fn pop(&mut self) {
        self.len -= 1;
    }

    /// The offsets one by one.
    #[cfg(test)]
    pub(super) fn iter(&self) -> impl Iterator<Item = [i32; 3]> + '_ {
        let columns = self.x[..self.len].iter().zip(&self.y).zip(&self.z);
        columns.map(|((x, y), z)| [*x, *y, *z])
    }
}
