//! Looking through the cubes of one bin, eight at a time.

#![expect(
    clippy::inline_always,
    reason = "what is inlined into a task is compiled for the task's instructions"
)]

use super::lanes::{Avx2, Columns, OnLanes, WORDS, run_on};
use super::neighbours::Neighbours;

/// The lower corners of the cubes of one bin: a column for each axis.
///
/// At least [`WORDS`] - 1 elements follow the last one of each column, so that whole registers may be read.
#[derive(Clone, Copy)]
pub(super) struct Corners<'a> {
    /// The three columns one after the other, and what follows them.
    pub(super) words: &'a [i32],
    /// Elements of one column, used or not.
    pub(super) capacity: usize,
}

impl Corners<'_> {
    pub(super) fn at(&self, index: usize) -> [i32; 3] {
        [0, 1, 2].map(|axis| self.words[axis * self.capacity + index])
    }

    /// The first `count` elements of a column by registers, the last of which may be filled up with others.
    #[inline(always)]
    fn registers(&self, axis: usize, count: usize) -> &[[i32; WORDS]] {
        let column = &self.words[axis * self.capacity..];
        column[..count.next_multiple_of(WORDS)].as_chunks().0
    }

    #[inline(always)]
    fn register(&self, axis: usize, first: usize) -> &[i32; WORDS] {
        let register = self.words[axis * self.capacity + first..].first_chunk();
        register.expect("enough elements follow the last one of a column")
    }
}

/// Appends the offset from `corner` to each of the first `count` corners that is at most `edge` away on every axis.
#[inline]
pub(super) fn collect(
    avx2: Option<Avx2>,
    corners: Corners,
    count: usize,
    corner: [i32; 3],
    edge: i32,
    neighbours: &mut Neighbours,
) {
    neighbours.reserve(count);
    let task = Collect {
        corners,
        count,
        corner,
        edge,
        neighbours,
    };
    run_on(avx2, task);
}

/// Bits of those of the eight corners from `first` on that lie within `reach` above `min` on every axis.
#[inline]
pub(super) fn within(
    avx2: Option<Avx2>,
    corners: Corners,
    first: usize,
    min: [i32; 3],
    reach: [u32; 3],
) -> u8 {
    let task = Within {
        corners,
        first,
        min,
        reach,
    };
    run_on(avx2, task)
}

/// See [`collect`].
struct Collect<'a> {
    corners: Corners<'a>,
    count: usize,
    corner: [i32; 3],
    edge: i32,
    neighbours: &'a mut Neighbours,
}

impl OnLanes for Collect<'_> {
    type Output = ();

    #[inline(always)]
    fn run_on<L: Columns<i16> + Columns<i32>>(self, lanes: L) {
        // A cube is near when no coordinate is below the least, which would read as a very large unsigned one, nor more than
        // twice the edge above it.
        let [x, y, z] = self.corner;
        let least = [
            lanes.every_eight(x - self.edge),
            lanes.every_eight(y - self.edge),
            lanes.every_eight(z - self.edge),
        ];
        let edge = lanes.every_eight(self.edge);
        let reach = [lanes.every_eight(2 * self.edge); 3];
        let xs = self.corners.registers(0, self.count);
        let ys = self.corners.registers(1, self.count);
        let zs = self.corners.registers(2, self.count);
        let Neighbours { x, y, z, len } = self.neighbours;
        let mut left = self.count;
        for ((xs, ys), zs) in xs.iter().zip(ys).zip(zs) {
            let above = [
                lanes.minus_eight(lanes.eight(xs), least[0]),
                lanes.minus_eight(lanes.eight(ys), least[1]),
                lanes.minus_eight(lanes.eight(zs), least[2]),
            ];
            let near = lanes.at_most(above, reach) & first_bits(left);
            left = left.saturating_sub(WORDS);
            // Where cubes are sparse, most registers hold none that is near.
            if near == 0 {
                continue;
            }
            for (column, above) in [&mut *x, &mut *y, &mut *z].into_iter().zip(above) {
                let to = column[*len..].first_chunk_mut();
                let to = to.expect("room was made for whole registers");
                lanes.compress_eight(to, lanes.minus_eight(above, edge), near);
            }
            *len += near.count_ones() as usize;
        }
    }
}

/// See [`within`].
struct Within<'a> {
    corners: Corners<'a>,
    first: usize,
    min: [i32; 3],
    reach: [u32; 3],
}

impl OnLanes for Within<'_> {
    type Output = u8;

    #[inline(always)]
    fn run_on<L: Columns<i16> + Columns<i32>>(self, lanes: L) -> u8 {
        let mut above = [lanes.every_eight(0); 3];
        let mut reach = above;
        for axis in 0..3 {
            let register = lanes.eight(self.corners.register(axis, self.first));
            above[axis] = lanes.minus_eight(register, lanes.every_eight(self.min[axis]));
            reach[axis] = lanes.every_eight(self.reach[axis].cast_signed());
        }
        lanes.at_most(above, reach)
    }
}

/// Bits of the first so many of eight lanes.
#[inline(always)]
pub(super) fn first_bits(count: usize) -> u8 {
    u8::MAX >> WORDS.saturating_sub(count)
}

#[cfg(test)]
mod tests {
    use super::{Corners, Neighbours, collect, within};
    use crate::engine::lanes::avx2;
    use crate::random::Random;

    /// Both paths, on corners near and as far apart as there are, with every number of them in use.
    #[test]
    fn fast_and_plain_agree() {
        let mut random = Random::new(1);
        let mut next = |bound: u64| i32::try_from(random.below(bound)).unwrap();
        for round in 0..2000 {
            let capacity = 32;
            let spread = [20, 1000, 1 << 31][round % 3];
            let half = i32::try_from(spread / 2).unwrap();
            let mut words: Vec<i32> = (0..5 * capacity).map(|_| next(spread) - half).collect();
            words[3] = 1 << 30;
            words[4] = -1 << 30;
            let corners = Corners {
                words: &words,
                capacity,
            };
            let own = [0; 3].map(|_: i32| [next(spread) - half, 1 << 30, -1 << 30][round / 3 % 3]);
            let (count, edge) = (round % 33, 1 + next(1 << (round % 25)));
            let mut found = [Neighbours::new(), Neighbours::new()];
            for (avx2, found) in [None, avx2()].into_iter().zip(&mut found) {
                // Twice, so that appending is tried too.
                collect(avx2, corners, count, own, edge, found);
                collect(avx2, corners, count, own, edge, found);
            }
            let [plain, fast] = found.map(|found| found.iter().collect::<Vec<_>>());
            assert_eq!(plain, fast, "round {round}");
            let reach = [0; 3].map(|_: u32| edge.cast_unsigned());
            for first in 0..capacity {
                let [plain, fast] =
                    [None, avx2()].map(|avx2| within(avx2, corners, first, own, reach));
                assert_eq!(plain, fast, "round {round}");
            }
        }
    }
}
