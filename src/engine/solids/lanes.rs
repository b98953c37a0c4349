//! Four planes or four boxes at once, in floats: the filter's inner loops.
//!
//! One of the rooms that hold floats. The same code is compiled twice, for every processor and for those with AVX2 and FMA; both answer the
//! same signs, because only certain ones count (`certify.rs` has the proof) and the exact ones do not depend on it.

#![expect(
    clippy::float_arithmetic,
    reason = "floats certify signs and are never a result"
)]
#![expect(
    clippy::inline_always,
    reason = "a body is compiled into each of its two callers, with their instructions"
)]

use super::certify::{GRAIN, Near, Room, Rough};
use super::face::{Corner, Face};
pub(super) use super::vector::LANES;
use super::vector::{Lanes, Vector};

/// Four planes side by side. Places without a plane hold one that contains everything.
#[derive(Clone, Copy, Debug)]
#[repr(align(32))]
pub(super) struct Block {
    normal: [Lanes; 3],
    offset: Lanes,
    length: Lanes,
}

impl Block {
    pub(super) fn of_faces(faces: &[Face]) -> Vec<Self> {
        let block = |faces: &[Face]| {
            let mut block = Self {
                normal: [[0.0; LANES]; 3],
                offset: [-1.0; LANES],
                length: [0.0; LANES],
            };
            for (lane, face) in faces.iter().enumerate() {
                for axis in 0..3 {
                    block.normal[axis][lane] = face.rough.normal[axis];
                }
                block.offset[lane] = face.rough.offset;
                block.length[lane] = face.rough.length;
            }
            block
        };
        faces.chunks(LANES).map(block).collect()
    }

    #[inline(always)]
    fn values<V: Vector>(&self, at: [V; 3]) -> V {
        let z = V::of(&self.normal[2])
            .times(at[2])
            .plus(V::of(&self.offset));
        let y = V::of(&self.normal[1]).times(at[1]).plus(z);
        V::of(&self.normal[0]).times(at[0]).plus(y)
    }
}

#[inline(always)]
fn splat<V: Vector>(at: &[f64; 3]) -> [V; 3] {
    [V::splat(at[0]), V::splat(at[1]), V::splat(at[2])]
}

/// Declares a function twice, over plain lanes for any processor and over wide ones, chosen at run time.
macro_rules! twice {
    ($(#[$doc:meta])* $visible:vis $name:ident, $wide:ident, $body:ident, ($($argument:ident: $type:ty),*) -> $result:ty) => {
        $(#[$doc])*
        #[inline]
        $visible fn $name($($argument: $type),*) -> $result {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,fma")]
                fn $wide($($argument: $type),*) -> $result {
                    $body::<$crate::engine::solids::vector::Wide>($($argument),*)
                }
                if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                    // SAFETY: the processor has the instructions.
                    #[expect(unsafe_code, reason = "the features were detected")]
                    return unsafe { $wide($($argument),*) };
                }
            }
            $body::<$crate::engine::solids::vector::Plain>($($argument),*)
        }
    };
}
pub(super) use twice;

/// What the planes of a piece certainly do to a segment.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Verdict {
    /// A plane of this block has it outside.
    Apart(usize),
    /// None is known to; the planes that do not certainly have all of it inside are in the list.
    Undecided,
}

twice! {
    /// Finds a plane that certainly has both points outside, beginning at block `first`. Without one, `near` holds the indices of those that do
    /// not certainly have both inside.
    pub(super) separate, separate_wide, separate_body, (blocks: &[Block], points: [&Near; 2], first: usize, near: &mut Vec<u16>) -> Verdict
}

#[inline(always)]
fn separate_body<V: Vector>(
    blocks: &[Block],
    points: [&Near; 2],
    first: usize,
    near: &mut Vec<u16>,
) -> Verdict {
    let slack = points[0].slack.max(points[1].slack);
    let ends = [splat::<V>(&points[0].at), splat::<V>(&points[1].at)];
    separate_all(blocks, ends, slack, first, near)
}

twice! {
    /// The same for one point.
    pub(super) separate_one, separate_one_wide, separate_one_body, (blocks: &[Block], point: &Near, first: usize, near: &mut Vec<u16>) -> Verdict
}

#[inline(always)]
fn separate_one_body<V: Vector>(
    blocks: &[Block],
    point: &Near,
    first: usize,
    near: &mut Vec<u16>,
) -> Verdict {
    separate_all(blocks, [splat::<V>(&point.at)], point.slack, first, near)
}

// Loops and no closures: those are functions of their own, without the instructions.
#[inline(always)]
fn separate_all<V: Vector, const POINTS: usize>(
    blocks: &[Block],
    points: [[V; 3]; POINTS],
    slack: f64,
    first: usize,
    near: &mut Vec<u16>,
) -> Verdict {
    near.clear();
    let slack = V::splat(slack + GRAIN);
    let mut at = if first < blocks.len() { first } else { 0 };
    for _ in 0..blocks.len() {
        let block = &blocks[at];
        let bound = V::of(&block.length).times(slack);
        let mut least = block.values(points[0]);
        let mut most = least;
        for point in &points[1..] {
            let value = block.values(*point);
            (least, most) = (least.least(value), most.most(value));
        }
        if least.greater(bound) != 0 {
            return Verdict::Apart(at);
        }
        let mut unsure = !bound.negative().greater(most) & 0b1111;
        while unsure != 0 {
            let facet = at * LANES + unsure.trailing_zeros() as usize;
            near.push(u16::try_from(facet).expect("a piece has fewer than 2^16 facets"));
            unsure &= unsure - 1;
        }
        at += 1;
        if at == blocks.len() {
            at = 0;
        }
    }
    Verdict::Undecided
}

/// Four points side by side. Places without a point hold one that is outside of everything.
#[derive(Clone, Copy, Debug)]
#[repr(align(32))]
pub(super) struct Points {
    at: [Lanes; 3],
    slack: Lanes,
    /// Bits of the places that have a point.
    used: u8,
}

impl Points {
    pub(super) fn of_corners(corners: &[Corner]) -> Vec<Self> {
        let block = |corners: &[Corner]| {
            let mut block = Self {
                at: [[f64::INFINITY; LANES]; 3],
                slack: [0.0; LANES],
                used: 0,
            };
            for (lane, Corner { near, .. }) in corners.iter().enumerate() {
                for axis in 0..3 {
                    block.at[axis][lane] = near.at[axis];
                }
                block.slack[lane] = near.slack;
                block.used |= 1 << lane;
            }
            block
        };
        corners.chunks(LANES).map(block).collect()
    }
}

twice! {
    /// Lists for every four points, in bits, which of them are certainly outside of a box.
    pub(super) excluded, excluded_wide, excluded_body, (points: &[Points], room: &Room, bits: &mut Vec<u8>) -> ()
}

#[inline(always)]
fn excluded_body<V: Vector>(points: &[Points], room: &Room, bits: &mut Vec<u8>) {
    bits.clear();
    let (min, max) = (splat::<V>(&room.min), splat::<V>(&room.max));
    bits.resize(points.len(), 0);
    for (block, bits) in points.iter().zip(bits) {
        let slack = V::of(&block.slack);
        let mut outside = 0;
        for axis in 0..3 {
            let at = V::of(&block.at[axis]);
            outside |= min[axis].greater(at.plus(slack));
            outside |= at.minus(slack).greater(max[axis]);
        }
        *bits = outside;
    }
}

/// On which sides of a plane points are.
#[derive(Clone, Copy, Default, Debug)]
pub(super) struct Sides {
    /// One is certainly outside.
    pub(super) above: bool,
    /// One is certainly inside.
    pub(super) below: bool,
    /// One may be on it.
    pub(super) unsure: bool,
}

twice! {
    /// On which sides of a plane points are; not all of them are looked at once there are some on both.
    pub(super) sides, sides_wide, sides_body, (points: &[Points], plane: &Rough) -> Sides
}

#[inline(always)]
fn sides_body<V: Vector>(points: &[Points], plane: &Rough) -> Sides {
    let normal = splat::<V>(&plane.normal);
    let (offset, length) = (V::splat(plane.offset), V::splat(plane.length));
    let grain = V::splat(GRAIN);
    let mut found = Sides::default();
    for block in points {
        let z = normal[2].times(V::of(&block.at[2])).plus(offset);
        let y = normal[1].times(V::of(&block.at[1])).plus(z);
        let value = normal[0].times(V::of(&block.at[0])).plus(y);
        let bound = length.times(V::of(&block.slack).plus(grain));
        let used = block.used;
        let above = value.greater(bound) & used;
        let below = bound.negative().greater(value) & used;
        found.above |= above != 0;
        found.below |= below != 0;
        found.unsure |= above | below != used;
        if found.above && found.below {
            break;
        }
    }
    found
}

/// Extents along ten diagonals of the axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slabs {
    min: [f64; DIAGONALS],
    max: [f64; DIAGONALS],
}

const DIAGONALS: usize = 10;

impl Slabs {
    pub(super) fn around(corners: &[Corner]) -> Self {
        let mut slabs = Self {
            min: [f64::INFINITY; DIAGONALS],
            max: [f64::NEG_INFINITY; DIAGONALS],
        };
        for Corner { near, .. } in corners {
            let [x, y, z] = near.at;
            let along = [
                x + y,
                x - y,
                x + z,
                x - z,
                y + z,
                y - z,
                x + y + z,
                x + y - z,
                x - y + z,
                x - y - z,
            ];
            // Sums of lattice points are exact; others have their slack, and some rounding within a grain.
            let widen = 3.0 * near.slack;
            for (diagonal, value) in along.into_iter().enumerate() {
                slabs.min[diagonal] = slabs.min[diagonal].min(value - widen);
                slabs.max[diagonal] = slabs.max[diagonal].max(value + widen);
            }
        }
        slabs
    }

    /// Whether the extents have a gap between them along some diagonal.
    #[inline]
    pub(super) fn is_apart(&self, other: &Self) -> bool {
        let gap = |diagonal: usize| {
            self.min[diagonal] > other.max[diagonal] || other.min[diagonal] > self.max[diagonal]
        };
        (0..DIAGONALS).fold(false, |apart, diagonal| apart | gap(diagonal))
    }
}

/// Four boxes side by side. Places without a box hold one that meets nothing.
#[derive(Clone, Copy, Debug)]
#[repr(align(32))]
pub(super) struct Rooms {
    min: [Lanes; 3],
    max: [Lanes; 3],
}

impl Rooms {
    /// Boxes in blocks of four.
    pub(super) fn of(rooms: impl Iterator<Item = Room>, blocks: &mut Vec<Self>) {
        blocks.clear();
        for (index, room) in rooms.enumerate() {
            let lane = index % LANES;
            if lane == 0 {
                blocks.push(Self {
                    min: [[f64::INFINITY; LANES]; 3],
                    max: [[f64::NEG_INFINITY; LANES]; 3],
                });
            }
            let block = blocks.last_mut().expect("one was begun for this lane");
            for axis in 0..3 {
                block.min[axis][lane] = room.min[axis];
                block.max[axis][lane] = room.max[axis];
            }
        }
    }
}

twice! {
    /// The first box from `from` on that meets `room`.
    pub(super) next_meeting, next_meeting_wide, next_meeting_body, (blocks: &[Rooms], room: &Room, from: usize) -> Option<usize>
}

#[inline(always)]
fn next_meeting_body<V: Vector>(blocks: &[Rooms], room: &Room, from: usize) -> Option<usize> {
    let (min, max) = (splat::<V>(&room.min), splat::<V>(&room.max));
    let mut wanted = 0b1111 << (from % LANES);
    for (number, block) in blocks.iter().enumerate().skip(from / LANES) {
        let mut apart = 0;
        for axis in 0..3 {
            apart |= V::of(&block.min[axis]).greater(max[axis]);
            apart |= min[axis].greater(V::of(&block.max[axis]));
        }
        let meet = !apart & 0b1111 & wanted;
        if meet != 0 {
            return Some(number * LANES + meet.trailing_zeros() as usize);
        }
        wanted = 0b1111;
    }
    None
}

twice! {
    /// Whether a plane of the blocks certainly has all the points outside.
    pub(super) separates, separates_wide, separates_body, (blocks: &[Block], corners: &[Corner], points: &[u16]) -> bool
}

#[inline(always)]
fn separates_body<V: Vector>(blocks: &[Block], corners: &[Corner], points: &[u16]) -> bool {
    for block in blocks {
        let mut outside = 0b1111;
        for &point in points {
            let near = &corners[usize::from(point)].near;
            let bound = V::of(&block.length).times(V::splat(near.slack + GRAIN));
            outside &= block.values(splat::<V>(&near.at)).greater(bound);
            if outside == 0 {
                break;
            }
        }
        if outside != 0 {
            return true;
        }
    }
    false
}
