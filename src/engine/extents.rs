//! The least and greatest coordinate of the cubes along each axis: exact after every deletion, and free of charge for
//! changes that touch neither.
//!
//! Only when the outermost cube goes is there something to do. Then the bins at that end are looked at: the *front*, a
//! sorted part of all bins beyond a certain layer, and the *rim*, the outermost coordinates within its first layer. Both
//! are kept from then on, so that cubes may go one after the other from the outside in.

use std::collections::{BTreeMap, BTreeSet};

use super::bins::{BinKey, Bins, Change};

/// The ends along three axes.
#[derive(Debug)]
pub(super) struct Extents {
    ends: [End; 6],
    /// Closed box of corners, when all ends are known.
    known: Option<Box3>,
    /// Closed box of layers that are in no front.
    quiet: Box3,
}

type Box3 = [[i32; 3]; 2];
const EVERYWHERE: Box3 = [[i32::MIN; 3], [i32::MAX; 3]];

/// One end along one axis. Coordinates and layers are negated at the greater end, so that always the least counts.
#[derive(Debug)]
struct End {
    axis: usize,
    greatest: bool,
    /// The least coordinate, once it is known again.
    least: Option<i32>,
    front: Option<Front>,
}

/// The bins nearest to one end, and the coordinates in the outermost layer of them.
#[derive(Debug)]
struct Front {
    /// All bins up to layer `until`, rotated so that the layer comes first.
    bins: BTreeSet<[i32; 3]>,
    /// One that has grown outwards to more than this is cut to size: by another look at all bins.
    bins_max: usize,
    until: i32,
    /// Which layer was looked through.
    layer: i32,
    /// Cubes by coordinate in this layer: all of them up to `rim_until`.
    rim: BTreeMap<i32, u32>,
    rim_until: i32,
}

/// A front is looked for anew when it has been used up: among so many times its bins.
const FRONT_SHARE: usize = 64;
const FRONT_MIN: usize = 64;
/// The same for the rim among the cubes of its layer.
const RIM_SHARE: usize = 64;
const RIM_MIN: usize = 256;

impl Extents {
    pub(super) fn new() -> Self {
        let end = |number: usize| End {
            axis: number / 2,
            greatest: number % 2 == 1,
            least: None,
            front: None,
        };
        Self {
            ends: [0, 1, 2, 3, 4, 5].map(end),
            known: None,
            quiet: EVERYWHERE,
        }
    }

    /// A cube has come; `alone` when it is the only one.
    #[inline]
    pub(super) fn insert(&mut self, corner: [i32; 3], key: BinKey, change: Change, alone: bool) {
        let covered = self.known.is_some_and(|known| holds(&known, corner));
        if !(covered && holds(&self.quiet, key.0)) || alone {
            self.insert_outermost(corner, key, change, alone);
        }
    }

    fn insert_outermost(&mut self, corner: [i32; 3], key: BinKey, change: Change, alone: bool) {
        for end in &mut self.ends {
            let coordinate = end.signed(corner[end.axis]);
            if alone {
                end.least = Some(coordinate);
            } else if let Some(least) = &mut end.least {
                *least = coordinate.min(*least);
            }
            end.insert_near(coordinate, key, change);
        }
        self.review();
    }

    /// A cube has gone.
    #[inline]
    pub(super) fn remove(&mut self, corner: [i32; 3], key: BinKey, change: Change) {
        let inside = self.known.is_some_and(|[least, greatest]| {
            (0..3).all(|axis| least[axis] < corner[axis] && corner[axis] < greatest[axis])
        });
        if !(inside && holds(&self.quiet, key.0)) {
            self.remove_outermost(corner, key, change);
        }
    }

    fn remove_outermost(&mut self, corner: [i32; 3], key: BinKey, change: Change) {
        for end in &mut self.ends {
            let coordinate = end.signed(corner[end.axis]);
            if end.least == Some(coordinate) {
                end.least = None;
            }
            end.remove_near(coordinate, key, change);
        }
        self.review();
    }

    fn review(&mut self) {
        let end = |number: usize| {
            let end = &self.ends[number];
            Some(end.signed(end.least?))
        };
        let known = || Some([[end(0)?, end(2)?, end(4)?], [end(1)?, end(3)?, end(5)?]]);
        self.known = known();
    }

    /// The bins have other keys now.
    pub(super) fn forget_bins(&mut self) {
        self.quiet = EVERYWHERE;
        for end in &mut self.ends {
            end.front = None;
        }
    }

    /// Least and greatest coordinates by axis, for bins that are not empty.
    #[inline]
    pub(super) fn ends(&mut self, bins: &Bins) -> [[i32; 3]; 2] {
        match self.known {
            Some(known) => known,
            None => self.find(bins),
        }
    }

    fn find(&mut self, bins: &Bins) -> [[i32; 3]; 2] {
        for end in &mut self.ends {
            if end.least.is_none() {
                end.find(bins);
            }
            if let Some(front) = &end.front {
                // The first layer that is not in the front.
                let side = usize::from(end.greatest);
                self.quiet[side][end.axis] = end.signed(front.until.saturating_add(1));
            }
        }
        self.review();
        self.known.expect("all ends have just been found")
    }
}

fn holds(space: &Box3, point: [i32; 3]) -> bool {
    (0..3).all(|axis| space[0][axis] <= point[axis] && point[axis] <= space[1][axis])
}

impl End {
    /// A coordinate or a layer as this end counts it, and back.
    #[inline]
    fn signed(&self, number: i32) -> i32 {
        if self.greatest { -number } else { number }
    }

    fn rotated(&self, key: BinKey) -> [i32; 3] {
        let [layer, next, last] = [0, 1, 2].map(|shift| key.0[(self.axis + shift) % 3]);
        [self.signed(layer), next, last]
    }

    fn key(&self, rotated: [i32; 3]) -> BinKey {
        let rotated = [self.signed(rotated[0]), rotated[1], rotated[2]];
        BinKey([0, 1, 2].map(|axis| rotated[(axis + 3 - self.axis) % 3]))
    }

    fn insert_near(&mut self, coordinate: i32, key: BinKey, change: Change) {
        let rotated = self.rotated(key);
        let Some(front) = &mut self.front else { return };
        if change == Change::Bin && rotated[0] <= front.until {
            front.bins.insert(rotated);
        }
        if rotated[0] == front.layer && coordinate <= front.rim_until {
            *front.rim.entry(coordinate).or_default() += 1;
        }
    }

    fn remove_near(&mut self, coordinate: i32, key: BinKey, change: Change) {
        let rotated = self.rotated(key);
        let Some(front) = &mut self.front else { return };
        if change == Change::Bin && rotated[0] <= front.until {
            front.bins.remove(&rotated);
        }
        if rotated[0] == front.layer && coordinate <= front.rim_until {
            let count = front.rim.get_mut(&coordinate);
            let count = count.expect("what goes was counted when it came");
            *count -= 1;
            if *count == 0 {
                front.rim.remove(&coordinate);
            }
        }
    }

    /// Finds the least coordinate.
    fn find(&mut self, bins: &Bins) {
        let size = (bins.len() / FRONT_SHARE).max(FRONT_MIN);
        let front = self.front.take();
        let usable = front.filter(|front| (1..=front.bins_max).contains(&front.bins.len()));
        let mut front = usable.unwrap_or_else(|| self.look_at_all(bins, size));
        let layer = front.bins.first().expect("there are bins")[0];
        if layer != front.layer || front.rim.is_empty() {
            self.look_through(&mut front, layer, bins);
        }
        self.least = front.rim.keys().next().copied();
        self.front = Some(front);
    }

    /// The front among all bins: so many of them and the rest of the last one's layer.
    fn look_at_all(&self, bins: &Bins, size: usize) -> Front {
        let mut all: Vec<[i32; 3]> = bins.iter().map(|bin| self.rotated(bin.key())).collect();
        let size = size.min(all.len() - 1);
        let until = all.select_nth_unstable(size).1[0];
        all.retain(|bin| bin[0] <= until);
        Front {
            bins_max: 8 * all.len(),
            bins: all.into_iter().collect(),
            until,
            layer: 0,
            rim: BTreeMap::new(),
            rim_until: i32::MIN,
        }
    }

    /// The rim of a front's layer.
    fn look_through(&self, front: &mut Front, layer: i32, bins: &Bins) {
        let mut coordinates: Vec<i32> = front
            .bins
            .range([layer, i32::MIN, i32::MIN]..=[layer, i32::MAX, i32::MAX])
            .filter_map(|bin| bins.get(self.key(*bin)))
            .flat_map(|bin| (0..bin.len()).map(|index| self.signed(bin.corner(index)[self.axis])))
            .collect();
        let size = (coordinates.len() / RIM_SHARE).max(RIM_MIN);
        let size = size.min(coordinates.len() - 1);
        front.layer = layer;
        front.rim_until = *coordinates.select_nth_unstable(size).1;
        front.rim.clear();
        for coordinate in coordinates {
            if coordinate <= front.rim_until {
                *front.rim.entry(coordinate).or_default() += 1;
            }
        }
    }
}
