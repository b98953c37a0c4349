//! The least and greatest coordinate of the cubes along each axis: exact after every deletion, and nearly free of charge for
//! changes that touch neither.
//!
//! ```text
//!   layers   how many cubes there are in each of some hundred slices across an axis
//!   rim      the cubes nearest to one end, one by one, within its outermost layer; looked for when the end has gone,
//!            and kept from then on, so that cubes may go one after the other from the outside in
//! ```

use std::collections::BTreeMap;

use crate::geometry::{CubeId, Place};

/// The ends along three axes.
#[derive(Debug)]
pub(super) struct Extents {
    axes: [Axis; 3],
    /// Least and greatest corner, when all ends are known.
    known: Option<[[i32; 3]; 2]>,
}

/// One axis of the ends.
pub(super) struct Along<'a> {
    number: usize,
    axis: &'a mut Axis,
    /// Least and greatest coordinate, when they are known.
    known: Option<[&'a mut i32; 2]>,
}

/// The cubes along one axis.
#[derive(Debug)]
struct Axis {
    /// A layer is `2^shift` steps thick.
    shift: u32,
    /// Which layer is counted first.
    first: i32,
    counts: Vec<u32>,
    /// No cube is in a layer before the first of these or behind the second.
    used: [i32; 2],
    ends: [End; 2],
}

/// One end. Coordinates and layers are negated at the greater one, so that always the least counts.
#[derive(Debug)]
struct End {
    greatest: bool,
    /// The least coordinate, unless it has gone.
    least: Option<i32>,
    rim: Option<Rim>,
}

/// The cubes nearest to one end.
#[derive(Debug)]
struct Rim {
    /// Within which layer.
    layer: i32,
    /// How many at which coordinate: all up to `until`.
    cubes: BTreeMap<i32, u32>,
    until: i32,
}

/// Most layers of an axis: thicker ones replace them when cubes lie farther apart.
const LAYERS_MAX: usize = 1024;
/// A rim that has been used up is looked for anew: among so many times its cubes.
const RIM_SHARE: usize = 64;
const RIM_MIN: usize = 256;

impl Extents {
    pub(super) fn new() -> Self {
        let end = |greatest| End {
            greatest,
            least: None,
            rim: None,
        };
        let axis = || Axis {
            shift: 0,
            first: 0,
            counts: Vec::new(),
            used: [i32::MAX, i32::MIN],
            ends: [end(false), end(true)],
        };
        Self {
            axes: std::array::from_fn(|_| axis()),
            known: None,
        }
    }

    /// A cube has come; `alone` when it is the only one.
    #[inline]
    pub(super) fn insert(&mut self, corner: [i32; 3], alone: bool) {
        if alone {
            *self = Self::new();
        }
        for (axis, coordinate) in self.axes.iter_mut().zip(corner) {
            axis.insert(coordinate, alone);
        }
        match &mut self.known {
            Some([least, greatest]) => {
                for axis in 0..3 {
                    least[axis] = least[axis].min(corner[axis]);
                    greatest[axis] = greatest[axis].max(corner[axis]);
                }
            }
            None if alone => self.known = Some([corner; 2]),
            None => {}
        }
    }

    /// The axes, each to be told, on any thread, of the same cubes that have come to others.
    pub(super) fn axes(&mut self) -> impl Iterator<Item = Along<'_>> {
        let mut ends = self
            .known
            .iter_mut()
            .flat_map(|[least, greatest]| least.iter_mut().zip(greatest));
        let axes = self.axes.iter_mut().enumerate();
        axes.map(move |(number, axis)| Along {
            number,
            axis,
            known: ends.next().map(|(least, greatest)| [least, greatest]),
        })
    }

    /// A cube has gone.
    #[inline]
    pub(super) fn remove(&mut self, corner: [i32; 3]) {
        for (axis, coordinate) in self.axes.iter_mut().zip(corner) {
            axis.remove(coordinate);
        }
        let inside = self.known.is_some_and(|[least, greatest]| {
            (0..3).all(|axis| least[axis] < corner[axis] && corner[axis] < greatest[axis])
        });
        if !inside {
            self.known = None;
        }
    }

    /// Least and greatest corner. `within` lists the coordinates along an axis of all cubes that may lie between two.
    #[inline]
    pub(super) fn ends<I: Iterator<Item = i32>>(
        &mut self,
        within: impl Fn(usize, [i32; 2]) -> I,
    ) -> [[i32; 3]; 2] {
        if let Some(known) = self.known {
            return known;
        }
        let mut known = [[0; 3]; 2];
        for (axis, layers) in self.axes.iter_mut().enumerate() {
            for (side, known) in known.iter_mut().enumerate() {
                known[axis] = layers.end(side, |between| within(axis, between));
            }
        }
        self.known = Some(known);
        known
    }
}

impl Along<'_> {
    /// Cubes have come.
    pub(super) fn insert_all(&mut self, cubes: &[(CubeId, Place)]) {
        let mut ends = [i32::MAX, i32::MIN];
        for (_, place) in cubes {
            let coordinate = place.corner()[self.number];
            self.axis.insert(coordinate, false);
            ends = [ends[0].min(coordinate), ends[1].max(coordinate)];
        }
        if let Some([least, greatest]) = &mut self.known {
            **least = ends[0].min(**least);
            **greatest = ends[1].max(**greatest);
        }
    }
}

impl Axis {
    #[inline]
    fn insert(&mut self, coordinate: i32, alone: bool) {
        let layer = coordinate >> self.shift;
        let index = usize::try_from(i64::from(layer) - i64::from(self.first));
        match index.ok().and_then(|index| self.counts.get_mut(index)) {
            Some(count) => *count += 1,
            None => self.reach(coordinate),
        }
        let layer = coordinate >> self.shift;
        let [from, to] = self.used;
        self.used = [from.min(layer), to.max(layer)];
        for end in &mut self.ends {
            let signed = end.signed(coordinate);
            match &mut end.least {
                Some(least) => *least = signed.min(*least),
                None if alone => end.least = Some(signed),
                None => {}
            }
            if let Some(rim) = &mut end.rim
                && rim.layer == layer
                && signed <= rim.until
            {
                *rim.cubes.entry(signed).or_default() += 1;
            }
        }
    }

    #[inline]
    fn remove(&mut self, coordinate: i32) {
        let layer = coordinate >> self.shift;
        let index = usize::try_from(i64::from(layer) - i64::from(self.first));
        self.counts[index.expect("what goes was counted when it came")] -= 1;
        for end in &mut self.ends {
            let signed = end.signed(coordinate);
            if end.least == Some(signed) {
                end.least = None;
            }
            if let Some(rim) = &mut end.rim
                && rim.layer == layer
                && signed <= rim.until
            {
                let count = rim.cubes.get_mut(&signed);
                let count = count.expect("what goes was counted when it came");
                *count -= 1;
                if *count == 0 {
                    rim.cubes.remove(&signed);
                }
            }
        }
    }

    /// Whether there are no cubes in a layer that is counted.
    #[inline]
    fn is_empty(&self, layer: i32) -> bool {
        let index = usize::try_from(i64::from(layer) - i64::from(self.first));
        self.counts[index.expect("there are cubes, and layers of them")] == 0
    }

    /// Counts a cube in a layer beyond those there are.
    #[cold]
    fn reach(&mut self, coordinate: i32) {
        loop {
            let layer = coordinate >> self.shift;
            if self.counts.is_empty() {
                self.first = layer;
            }
            let count = i32::try_from(self.counts.len()).expect("there are few layers");
            let first = self.first.min(layer);
            let end = (self.first + count).max(layer + 1);
            let needed = usize::try_from(i64::from(end) - i64::from(first));
            let needed = needed.expect("the end is not before the first");
            if needed <= LAYERS_MAX {
                let before = usize::try_from(self.first - first).expect("it is not below");
                self.counts.splice(0..0, std::iter::repeat_n(0, before));
                self.counts.resize(needed, 0);
                self.first = first;
                let index = usize::try_from(layer - first).expect("it is not below the first");
                self.counts[index] += 1;
                return;
            }
            self.thicken();
        }
    }

    /// Makes one layer of two.
    fn thicken(&mut self) {
        let mut counts = Vec::with_capacity(self.counts.len() / 2 + 1);
        for (layer, count) in (self.first..).zip(&self.counts) {
            if layer == self.first || layer % 2 == 0 {
                counts.push(0);
            }
            *counts.last_mut().expect("the first layer has one") += count;
        }
        self.counts = counts;
        self.first >>= 1;
        self.shift += 1;
        self.used = self.used.map(|layer| layer >> 1);
        for end in &mut self.ends {
            end.rim = None;
        }
    }

    /// The coordinate of one end.
    fn end<I: Iterator<Item = i32>>(&mut self, side: usize, within: impl Fn([i32; 2]) -> I) -> i32 {
        if let Some(least) = self.ends[side].least {
            return self.ends[side].signed(least);
        }
        while self.is_empty(self.used[side]) {
            self.used[side] += if side == 0 { 1 } else { -1 };
        }
        let layer = self.used[side];
        let end = &mut self.ends[side];
        let usable = end.rim.take();
        let usable = usable.filter(|rim| rim.layer == layer && !rim.cubes.is_empty());
        let rim = usable.unwrap_or_else(|| {
            let lowest = layer << self.shift;
            let between = [lowest, lowest + ((1 << self.shift) - 1)];
            let there = within(between).filter(|coordinate| coordinate >> self.shift == layer);
            End::rim_of(
                layer,
                there.map(|coordinate| end.signed(coordinate)).collect(),
            )
        });
        let least = *rim.cubes.keys().next().expect("a counted layer has cubes");
        end.rim = Some(rim);
        end.least = Some(least);
        end.signed(least)
    }
}

impl End {
    /// A coordinate as this end counts it, and back.
    #[inline]
    fn signed(&self, coordinate: i32) -> i32 {
        if self.greatest {
            -coordinate
        } else {
            coordinate
        }
    }

    /// The outermost of the coordinates in a layer.
    fn rim_of(layer: i32, mut coordinates: Vec<i32>) -> Rim {
        let size = (coordinates.len() / RIM_SHARE).max(RIM_MIN);
        let size = size.min(coordinates.len()) - 1;
        let until = *coordinates.select_nth_unstable(size).1;
        let mut cubes = BTreeMap::new();
        for coordinate in coordinates {
            if coordinate <= until {
                *cubes.entry(coordinate).or_default() += 1;
            }
        }
        Rim {
            layer,
            cubes,
            until,
        }
    }
}
