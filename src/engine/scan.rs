//! Looking through the cubes of one bin, eight at a time.
//!
//! Every function has a portable path, which is also the reference that the tests compare the fast one with.

use super::neighbours::{LANES, Neighbours};

/// Proof that the processor has AVX2 and counts bits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Avx2(());

impl Avx2 {
    #[cfg(target_arch = "x86_64")]
    pub(super) fn detect() -> Option<Self> {
        (is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt")).then_some(Self(()))
    }

    #[cfg(not(target_arch = "x86_64"))]
    pub(super) fn detect() -> Option<Self> {
        None
    }
}

/// The lower corners of the cubes of one bin: a column for each axis.
///
/// At least [`LANES`] - 1 elements follow the last one of each column, so that whole registers may be read.
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
    #[cfg(target_arch = "x86_64")]
    #[inline]
    fn registers(&self, axis: usize, count: usize) -> &[[i32; LANES]] {
        let column = &self.words[axis * self.capacity..];
        column[..count.next_multiple_of(LANES)].as_chunks().0
    }

    #[inline]
    fn lanes(&self, axis: usize, first: usize) -> &[i32; LANES] {
        let lanes = self.words[axis * self.capacity + first..].first_chunk();
        lanes.expect("enough elements follow the last one of a column")
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
    #[cfg(target_arch = "x86_64")]
    if avx2.is_some() {
        #[expect(unsafe_code, reason = "instructions that were detected")]
        // SAFETY: the proof that the processor has them is at hand.
        return unsafe { x86::collect(corners, count, corner, edge, neighbours) };
    }
    collect_plain(corners, count, corner, edge, neighbours);
}

fn collect_plain(
    corners: Corners,
    count: usize,
    corner: [i32; 3],
    edge: i32,
    neighbours: &mut Neighbours,
) {
    let near = |offset: &i32| offset.unsigned_abs() <= edge.cast_unsigned();
    for index in 0..count {
        let other = corners.at(index);
        let offset = [0, 1, 2].map(|axis| other[axis].wrapping_sub(corner[axis]));
        if offset.iter().all(near) {
            neighbours.push(offset);
        }
    }
}

/// Bits of those of the eight corners from `first` on that lie within `reach` above `min` on every axis.
#[inline]
pub(super) fn within(
    avx2: Option<Avx2>,
    corners: Corners,
    first: usize,
    min: [i32; 3],
    reach: [u32; 3],
) -> u32 {
    #[cfg(target_arch = "x86_64")]
    if avx2.is_some() {
        #[expect(unsafe_code, reason = "instructions that were detected")]
        // SAFETY: the proof that the processor has them is at hand.
        return unsafe { x86::within(corners, first, min, reach) };
    }
    within_plain(corners, first, min, reach)
}

fn within_plain(corners: Corners, first: usize, min: [i32; 3], reach: [u32; 3]) -> u32 {
    let [x, y, z] = [0, 1, 2].map(|axis| corners.lanes(axis, first));
    let mut kept = [0u32; LANES];
    for lane in 0..LANES {
        let beyond = |axis: usize, coordinate: i32| {
            coordinate.wrapping_sub(min[axis]).cast_unsigned() > reach[axis]
        };
        let out = beyond(0, x[lane]) | beyond(1, y[lane]) | beyond(2, z[lane]);
        kept[lane] = u32::from(!out) << lane;
    }
    kept.iter().fold(0, |bits, bit| bits | bit)
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{
        __m256i, _mm_loadl_epi64, _mm256_abs_epi32, _mm256_and_si256, _mm256_castsi256_ps,
        _mm256_cmpeq_epi32, _mm256_cvtepu8_epi32, _mm256_loadu_si256, _mm256_max_epu32,
        _mm256_min_epu32, _mm256_movemask_ps, _mm256_permutevar8x32_epi32, _mm256_set1_epi32,
        _mm256_storeu_si256, _mm256_sub_epi32,
    };

    use super::{Corners, LANES, Neighbours};

    /// For each set of lanes their numbers, packed to the left.
    static PACKED: [[u8; LANES]; 256] = {
        let mut table = [[0; LANES]; 256];
        let mut set = 0;
        while set < 256 {
            let (mut lane, mut next) = (0, 0);
            while lane < 8 {
                if set >> lane & 1 == 1 {
                    table[set][next] = lane;
                    next += 1;
                }
                lane += 1;
            }
            set += 1;
        }
        table
    };

    #[target_feature(enable = "avx2,popcnt")]
    pub(super) fn collect(
        corners: Corners,
        count: usize,
        corner: [i32; 3],
        edge: i32,
        neighbours: &mut Neighbours,
    ) {
        let (x0, y0, z0) = (
            _mm256_set1_epi32(corner[0]),
            _mm256_set1_epi32(corner[1]),
            _mm256_set1_epi32(corner[2]),
        );
        let edge = _mm256_set1_epi32(edge);
        let Neighbours { x, y, z, len } = neighbours;
        let xs = corners.registers(0, count);
        let ys = corners.registers(1, count);
        let zs = corners.registers(2, count);
        let mut left = count;
        for ((xs, ys), zs) in xs.iter().zip(ys).zip(zs) {
            let dx = _mm256_sub_epi32(load(xs), x0);
            let dy = _mm256_sub_epi32(load(ys), y0);
            let dz = _mm256_sub_epi32(load(zs), z0);
            // Unsigned, so that the one difference whose absolute value wraps counts as far.
            let farthest = _mm256_max_epu32(
                _mm256_max_epu32(_mm256_abs_epi32(dx), _mm256_abs_epi32(dy)),
                _mm256_abs_epi32(dz),
            );
            let near = _mm256_cmpeq_epi32(_mm256_min_epu32(farthest, edge), farthest);
            let lanes = _mm256_movemask_ps(_mm256_castsi256_ps(near)).cast_unsigned() as usize;
            let lanes = lanes & (0xff >> LANES.saturating_sub(left));
            left = left.saturating_sub(LANES);
            let packed = packed(lanes);
            let to = *len..*len + LANES;
            store(&mut x[to.clone()], _mm256_permutevar8x32_epi32(dx, packed));
            store(&mut y[to.clone()], _mm256_permutevar8x32_epi32(dy, packed));
            store(&mut z[to], _mm256_permutevar8x32_epi32(dz, packed));
            *len += lanes.count_ones() as usize;
        }
    }

    #[target_feature(enable = "avx2")]
    pub(super) fn within(corners: Corners, first: usize, min: [i32; 3], reach: [u32; 3]) -> u32 {
        let inside = |axis: usize| {
            let above = _mm256_sub_epi32(
                load(corners.lanes(axis, first)),
                _mm256_set1_epi32(min[axis]),
            );
            let reach = _mm256_set1_epi32(reach[axis].cast_signed());
            _mm256_cmpeq_epi32(_mm256_min_epu32(above, reach), above)
        };
        let all = _mm256_and_si256(_mm256_and_si256(inside(0), inside(1)), inside(2));
        _mm256_movemask_ps(_mm256_castsi256_ps(all)).cast_unsigned()
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn load(lanes: &[i32; LANES]) -> __m256i {
        #[expect(unsafe_code, reason = "a whole register is read")]
        // SAFETY: the array is as long as the register, and no alignment is asked for.
        unsafe {
            _mm256_loadu_si256(lanes.as_ptr().cast())
        }
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn store(to: &mut [i32], lanes: __m256i) {
        let to: &mut [i32; LANES] = to.try_into().expect("it is as long as a register");
        #[expect(unsafe_code, reason = "a whole register is written")]
        // SAFETY: the array is as long as the register, and no alignment is asked for.
        unsafe {
            _mm256_storeu_si256(to.as_mut_ptr().cast(), lanes);
        }
    }

    /// The numbers of a set of lanes, as a register.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn packed(lanes: usize) -> __m256i {
        let numbers: &[u8; LANES] = &PACKED[lanes];
        #[expect(unsafe_code, reason = "half a register is read")]
        // SAFETY: the array has the eight bytes that are read.
        let numbers = unsafe { _mm_loadl_epi64(numbers.as_ptr().cast()) };
        _mm256_cvtepu8_epi32(numbers)
    }
}

#[cfg(test)]
mod tests {
    use super::{Avx2, Corners, Neighbours, collect, within};

    /// Both paths, on corners near and as far apart as there are, with every number of them in use.
    #[test]
    fn fast_and_plain_agree() {
        let mut state = 1u64;
        let mut next = |bound: u64| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            i32::try_from(state % bound).unwrap()
        };
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
            for (avx2, found) in [None, Avx2::detect()].into_iter().zip(&mut found) {
                // Twice, so that appending is tried too.
                collect(avx2, corners, count, own, edge, found);
                collect(avx2, corners, count, own, edge, found);
            }
            let [plain, fast] = found.map(|found| found.iter().collect::<Vec<_>>());
            assert_eq!(plain, fast, "round {round}");
            let reach = [0; 3].map(|_: u32| edge.cast_unsigned());
            for first in 0..capacity {
                let [plain, fast] =
                    [None, Avx2::detect()].map(|avx2| within(avx2, corners, first, own, reach));
                assert_eq!(plain, fast, "round {round}");
            }
        }
    }
}
