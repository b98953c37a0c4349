//! Many cubes at once: the same totals, with the work in an order that suits memory, and on several threads.
//!
//! What a set of cubes adds is the sum of what each adds to those *before* it, in any order of ranks. So a slice of the
//! batch is put into the exposed grid as a whole, and every cube is then evaluated against the grid alone, which nobody
//! changes meanwhile. The rank of a cube is its bin and its place in the bin, so it needs no memory:
//!
//! ```text
//!   bins in the order of their keys     A            B            C          evaluating cube 5 of bin B:
//!   kept cubes, as before           0 1 2        0 1 2 3      0 1          all of A, 0 to 4 of B,
//!   fresh cubes, of this slice        3 4 5 6      4 5 6        2 3          0 and 1 of C
//! ```
//!
//! Deletions are the same backwards: the cubes that go are made the last ones of their bins, evaluated, and removed.
//! Cubes that add nothing move to the covered grid after their slice. That leaves the union as it is: each is covered by
//! cubes before it, those of them that move too are covered by cubes before them, and so on.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::geometry::{CubeId, Place};

use super::Engine;
use super::access::Access;
use super::grid::{BinAddress, CUBES_A_STEP, Due, Grid};
use super::kernel::{Difference, Kernel, Span};
use super::neighbours::Neighbours;
use super::parallel::in_parallel;
use super::prefetch::{AHEAD, prefetch};

/// From so many cubes on, ordering them pays.
pub(super) const BATCH_MIN: usize = 32;

/// From so many cubes on, waking other threads pays: some milliseconds of work.
const PARALLEL_MIN: usize = 1024;

/// A slice has as many cubes as are exposed already, so that where they are dense most of them are found covered without
/// evaluation; but within these bounds. The greatest is what an index in the order can name.
const SLICE_MIN: usize = 4096;
const SLICE_MAX: usize = 1 << INDEX_BITS;
const INDEX_BITS: u32 = 22;

/// Exposed cubes that are deleted at once where many are covered.
const DENSE_SLICE: usize = 128;

/// Bits of an axis in the order of bins.
const AXIS_BITS: u32 = 14;
const _: () = assert!(3 * AXIS_BITS + INDEX_BITS <= u64::BITS);

/// Bins that a thread takes at a time.
const BINS_AT_ONCE: usize = 16;

/// What one thread needs to evaluate cubes; apart from that of another in memory, too.
#[derive(Debug)]
#[repr(align(128))]
pub(super) struct Helper {
    kernel: Kernel,
    neighbours: Neighbours,
    uncovered: Vec<Span>,
}

/// A slice in order.
#[derive(Default)]
struct Order {
    /// The cubes by bins that lie near each other, each with its index in the slice: see [`Codes`].
    codes: Vec<u64>,
    /// Indices of cubes known to be covered.
    covered: Vec<usize>,
}

/// What evaluating some of the fresh cubes found.
#[derive(Default)]
struct Found {
    /// The sum of the differences.
    sum: Option<Difference>,
    /// Fresh cubes that change nothing; those of one bin one after the other, in the order of their index.
    covered: Vec<(BinAddress, usize)>,
    /// Cubes that go and uncover something, with the number of boxes around that.
    uncovering: Vec<(Place, usize)>,
    boxes: Vec<Span>,
}

/// From so many cubes on, several threads put them into the grid.
const FILL_MIN: usize = 1 << 16;

/// So many of them at a time are first brought together in order.
const CUBES_AT_ONCE: usize = 1 << 18;

/// So many of these are put in by one step of several threads, which takes a millisecond or two.
const CUBES_A_LONG_STEP: usize = 1 << 14;

/// Bins whose fresh cubes one step makes like all others.
const BINS_A_STEP: usize = 256;

/// Changes for which one step reviews the covered cells.
const REVIEWS_A_STEP: usize = 64;

/// Bins that one step divides, unites, marks or empties of fresh cubes, and cubes for which it continues a rehash: each of these may
/// touch a hundred cubes.
const HUNDREDS_A_STEP: usize = 16;

/// Inserts cubes whose ids are in the table already.
pub(super) fn insert_batch(access: &impl Access, cubes: &[(CubeId, Place)]) {
    let mut rest = cubes;
    while !rest.is_empty() {
        let exposed = access.look(|engine| engine.exposed.len());
        let size = exposed.clamp(SLICE_MIN, SLICE_MAX);
        let (slice, after) = rest.split_at(size.min(rest.len()));
        insert_slice(access, slice);
        review_covered_cells(access, slice.len());
        rest = after;
    }
}

fn insert_slice(access: &impl Access, cubes: &[(CubeId, Place)]) {
    let mut helpers = access.step(|engine| engine.take_helpers(cubes.len()));
    let order = access.look(|engine| engine.order_without_covered(&mut helpers, cubes));
    let threads = access.look(|engine| engine.threads);
    let touched = if threads > 1 && order.codes.len() >= FILL_MIN {
        fill_in_parallel(access, &order, cubes, threads)
    } else {
        fill(access, &order, cubes)
    };
    let found = access.look(|engine| engine.evaluate(&mut helpers, &touched, cubes.len()));
    for found in found {
        if let Some(sum) = &found.sum {
            access.step(|engine| sum.insert_into(&mut engine.totals));
        }
        // From the last one back: what takes the place of a removed one has been looked at.
        for some in found.covered.rchunks(CUBES_A_STEP) {
            access.step(|engine| {
                for &(address, index) in some.iter().rev() {
                    let (place, id) = engine.exposed.remove_fresh(address, index);
                    engine.covered_cells.mark(place);
                    engine.covered.insert(place, id);
                }
            });
        }
    }
    if access.look(|engine| engine.covered_cells.are_kept()) {
        for some in touched.chunks(HUNDREDS_A_STEP) {
            access.step(|engine| engine.mark_fresh(some));
        }
    }
    end_batch(access, &touched);
    for some in order.covered.chunks(CUBES_A_STEP) {
        access.step(|engine| {
            for &index in some {
                let (id, place) = cubes[index];
                engine.covered.insert(place, id);
            }
        });
    }
    access.step(|engine| engine.helpers = helpers);
}

/// Puts the cubes of a slice into the exposed grid; the bins in which they are.
fn fill(access: &impl Access, order: &Order, cubes: &[(CubeId, Place)]) -> Vec<BinAddress> {
    let mut touched = Vec::new();
    let mut some = Vec::with_capacity(CUBES_A_STEP);
    for first in (0..order.codes.len()).step_by(CUBES_A_STEP) {
        order.cubes_of_step(first, cubes, &mut some);
        access.step(|engine| engine.exposed.insert_fresh(&some, &mut touched));
    }
    touched
}

/// The same on several threads, in fewer and longer steps.
fn fill_in_parallel(
    access: &impl Access,
    order: &Order,
    cubes: &[(CubeId, Place)],
    threads: usize,
) -> Vec<BinAddress> {
    let mut touched = Vec::new();
    for some in order.codes.chunks(CUBES_AT_ONCE) {
        let mut shares: Vec<_> = some.chunks(some.len().div_ceil(threads)).collect();
        let ordered = in_parallel(&mut shares, |_, share| in_order(share, cubes));
        for some in ordered
            .iter()
            .flat_map(|share| share.chunks(CUBES_A_LONG_STEP))
        {
            access.step(|engine| engine.exposed.insert_fresh_on(threads, some, &mut touched));
        }
    }
    touched
}

/// Deletes cubes whose ids are no longer in the table.
pub(super) fn delete_batch(access: &impl Access, cubes: &[(CubeId, Place)]) {
    for slice in cubes.chunks(SLICE_MAX) {
        if access.look(|engine| engine.covered.len() == 0) {
            delete_slice(access, slice);
        } else {
            let mut exposed = Vec::with_capacity(slice.len());
            for some in slice.chunks(CUBES_A_STEP) {
                access.step(|engine| {
                    let covered = &mut engine.covered;
                    let rest = some
                        .iter()
                        .filter(|(id, place)| !covered.remove(*place, *id));
                    exposed.extend(rest.copied());
                });
            }
            // Where cubes are dense the first ones promoted cover what the next deletions would uncover: with many deletions at
            // once each would look through all that is covered around it.
            let is_dense = access.look(|engine| engine.covered.len() * 8 > engine.exposed.len());
            let size = if is_dense { DENSE_SLICE } else { SLICE_MAX };
            for slice in exposed.chunks(size) {
                delete_slice(access, slice);
            }
        }
        review_covered_cells(access, slice.len());
    }
}

/// Reviews the covered cells after so many changes.
fn review_covered_cells(access: &impl Access, changes: usize) {
    for first in (0..changes).step_by(REVIEWS_A_STEP) {
        let some = REVIEWS_A_STEP.min(changes - first);
        let more = access.step(|engine| {
            let (exposed, covered) = (&engine.exposed, &engine.covered);
            engine.covered_cells.review(exposed, covered, some)
        });
        if !more {
            return;
        }
    }
}

/// Deletes exposed cubes.
fn delete_slice(access: &impl Access, cubes: &[(CubeId, Place)]) {
    let mut helpers = access.step(|engine| engine.take_helpers(cubes.len()));
    let order = access.look(|engine| engine.order(&mut helpers, cubes));
    let mut touched = Vec::new();
    let mut count = 0;
    for first in (0..order.codes.len()).step_by(CUBES_A_STEP) {
        access.step(|engine| {
            for at in order.step(first) {
                order.prefetch(at, cubes, &engine.exposed);
                let (id, place) = cubes[index_of(order.codes[at])];
                if !engine.replace_by_duplicate(id, place) {
                    touched.extend(engine.exposed.make_fresh(place, id));
                    count += 1;
                }
            }
        });
    }
    let found = access.look(|engine| {
        if engine.covered.len() > 0 {
            engine.evaluate_with_boxes(&mut helpers, &touched, count)
        } else {
            engine.evaluate(&mut helpers, &touched, count)
        }
    });
    for some in touched.chunks(HUNDREDS_A_STEP) {
        access.step(|engine| {
            for address in some {
                engine.exposed.remove_all_fresh(*address);
            }
        });
    }
    end_batch(access, &touched);
    for found in &found {
        if let Some(sum) = &found.sum {
            access.step(|engine| sum.delete_from(&mut engine.totals));
        }
        for some in found.boxes.chunks(CUBES_A_STEP) {
            access.step(|engine| {
                for uncovered in some {
                    engine.covered_cells.unmark(uncovered);
                }
            });
        }
    }
    for found in found {
        let mut boxes = found.boxes.as_slice();
        for (place, count) in found.uncovering {
            let (uncovered, after) = boxes.split_at(count);
            access.step(|engine| {
                engine.work.uncovered.clear();
                engine.work.uncovered.extend_from_slice(uncovered);
                engine.promote(place);
            });
            boxes = after;
        }
    }
    access.step(|engine| engine.helpers = helpers);
}

/// Ends the part of the fresh cubes of some bins in the batch, and divides or unites these bins where that is due. The addresses
/// are not valid afterwards.
fn end_batch(access: &impl Access, touched: &[BinAddress]) {
    let mut due = Due::default();
    for some in touched.chunks(BINS_A_STEP) {
        access.step(|engine| engine.exposed.keep_fresh(some, &mut due));
    }
    for some in due.overfull.chunks(HUNDREDS_A_STEP) {
        access.step(|engine| {
            for address in some {
                engine.exposed.divide_overfull(*address);
            }
        });
    }
    for some in due.corners.chunks(HUNDREDS_A_STEP) {
        access.step(|engine| {
            for corner in some {
                engine.exposed.unite_sparse(*corner);
            }
        });
    }
    for first in (0..=due.cubes).step_by(HUNDREDS_A_STEP) {
        access.step(|engine| {
            for _ in first..(first + HUNDREDS_A_STEP).min(due.cubes + 1) {
                engine.exposed.continue_rehash();
            }
        });
    }
}

impl Order {
    /// Puts each helper's part of the cubes in order, and then all of them.
    fn of_parts(helpers: &mut [Helper], part: impl Fn(usize) -> Self + Sync) -> Self {
        let parts = in_parallel(helpers, |number, _| part(number));
        let is_one = parts.len() <= 1;
        let mut order = parts.into_iter().reduce(|mut order, mut part| {
            order.codes.append(&mut part.codes);
            order.covered.append(&mut part.covered);
            order
        });
        if let Some(order) = order.as_mut().filter(|_| !is_one) {
            #[expect(
                clippy::stable_sort_primitive,
                reason = "it finds what is in order already, and merges it in one pass"
            )]
            order.codes.sort();
        }
        order.unwrap_or_default()
    }

    /// The places in the order that a step from `first` on takes.
    fn step(&self, first: usize) -> Range<usize> {
        first..self.codes.len().min(first + CUBES_A_STEP)
    }

    /// The cubes of the step from `first` on, in order. Prefetches those of the next step.
    fn cubes_of_step(
        &self,
        first: usize,
        cubes: &[(CubeId, Place)],
        some: &mut Vec<(CubeId, Place)>,
    ) {
        let step = self.step(first);
        for code in &self.codes[self.step(step.end)] {
            prefetch(cubes, index_of(*code));
        }
        some.clear();
        some.extend(self.codes[step].iter().map(|code| cubes[index_of(*code)]));
    }

    /// Prefetches what cubes some places later need.
    #[inline]
    fn prefetch(&self, at: usize, cubes: &[(CubeId, Place)], exposed: &Grid) {
        if let Some(code) = self.codes.get(at + 2 * AHEAD) {
            prefetch(cubes, index_of(*code));
        }
        if let Some(code) = self.codes.get(at + AHEAD) {
            exposed.prefetch(cubes[index_of(*code)].1);
        }
    }
}

impl Engine {
    /// Marks the cells inside the fresh cubes of some bins as covered.
    fn mark_fresh(&mut self, bins: &[BinAddress]) {
        let dense = bins
            .iter()
            .filter(|address| self.exposed.is_dense(**address));
        for bin in dense.filter_map(|address| self.exposed.bin(*address)) {
            for index in bin.len() - bin.fresh()..bin.len() {
                let place = Place::from_checked(bin.corner(index));
                self.covered_cells.mark(place);
            }
        }
    }

    /// The order of cubes, without those in covered cells.
    fn order_without_covered(&self, helpers: &mut [Helper], cubes: &[(CubeId, Place)]) -> Order {
        if !self.covered_cells.are_kept() {
            return self.order(helpers, cubes);
        }
        let (codes, size) = (
            Codes::of(&self.exposed, cubes),
            self.cubes_a_thread(cubes.len()),
        );
        Order::of_parts(&mut helpers[..cubes.len().div_ceil(size)], |number| {
            let first = number * size;
            let mut order = Order::default();
            for (index, (_, place)) in cubes.iter().enumerate().skip(first).take(size) {
                if self.covered_cells.cover(*place) {
                    order.covered.push(index);
                } else {
                    order.codes.push(codes.code(*place, index));
                }
            }
            order.codes.sort_unstable();
            order
        })
    }

    /// The order of cubes.
    fn order(&self, helpers: &mut [Helper], cubes: &[(CubeId, Place)]) -> Order {
        let (codes, size) = (
            Codes::of(&self.exposed, cubes),
            self.cubes_a_thread(cubes.len()),
        );
        Order::of_parts(&mut helpers[..cubes.len().div_ceil(size)], |number| {
            let part = cubes.iter().enumerate().skip(number * size).take(size);
            let codes = part.map(|(index, (_, place))| codes.code(*place, index));
            let mut codes: Vec<u64> = codes.collect();
            codes.sort_unstable();
            Order {
                codes,
                covered: Vec::new(),
            }
        })
    }

    /// How many of so many cubes each thread takes.
    pub(super) fn cubes_a_thread(&self, count: usize) -> usize {
        let threads = if count < PARALLEL_MIN {
            1
        } else {
            self.threads
        };
        count.div_ceil(threads).max(1)
    }

    /// As many helpers as so many cubes need, or more; to be given back.
    pub(super) fn take_helpers(&mut self, count: usize) -> Vec<Helper> {
        let needed = count.div_ceil(self.cubes_a_thread(count));
        while self.helpers.len() < needed {
            self.helpers.push(Helper {
                kernel: self.kernel.clone(),
                neighbours: Neighbours::new(),
                uncovered: Vec::new(),
            });
        }
        std::mem::take(&mut self.helpers)
    }

    /// Evaluates the fresh cubes, `count` in all, of the bins that have any.
    fn evaluate(&self, helpers: &mut [Helper], touched: &[BinAddress], count: usize) -> Vec<Found> {
        self.evaluate_each(helpers, touched, count, Found::add)
    }

    /// The same, with boxes around what the deletion of each uncovers.
    fn evaluate_with_boxes(
        &self,
        helpers: &mut [Helper],
        touched: &[BinAddress],
        count: usize,
    ) -> Vec<Found> {
        self.evaluate_each(helpers, touched, count, Found::add_with_boxes)
    }

    /// Calls `evaluate` with each fresh cube, for which a helper has the neighbours; false when it changes nothing.
    fn evaluate_each(
        &self,
        helpers: &mut [Helper],
        touched: &[BinAddress],
        count: usize,
        evaluate: impl Fn(&mut Found, &mut Helper, Place) -> bool + Sync,
    ) -> Vec<Found> {
        let size = self.cubes_a_thread(count);
        let exposed = &self.exposed;
        let next = AtomicUsize::new(0);
        in_parallel(&mut helpers[..count.div_ceil(size)], |_, helper| {
            let mut found = Found::default();
            loop {
                let first = next.fetch_add(BINS_AT_ONCE, Ordering::Relaxed);
                let Some(rest) = touched.get(first..).filter(|rest| !rest.is_empty()) else {
                    return found;
                };
                for address in rest.iter().take(BINS_AT_ONCE) {
                    let bin = exposed.bin(*address);
                    let bin = bin.expect("a touched bin has fresh cubes");
                    for index in bin.len() - bin.fresh()..bin.len() {
                        let corner = bin.corner(index);
                        exposed.gather_before(*address, index, corner, &mut helper.neighbours);
                        if !evaluate(&mut found, helper, Place::from_checked(corner)) {
                            found.covered.push((*address, index));
                        }
                    }
                }
            }
        })
    }
}

impl Found {
    fn add(&mut self, helper: &mut Helper, place: Place) -> bool {
        let changes = helper.kernel.marginal(place, &helper.neighbours);
        if changes {
            self.add_sum(&helper.kernel);
        }
        changes
    }

    fn add_with_boxes(&mut self, helper: &mut Helper, place: Place) -> bool {
        let (neighbours, uncovered) = (&helper.neighbours, &mut helper.uncovered);
        let changes = helper.kernel.uncovered(place, neighbours, uncovered);
        if changes {
            self.add_sum(&helper.kernel);
            self.uncovering.push((place, uncovered.len()));
            self.boxes.extend_from_slice(uncovered);
        }
        changes
    }

    fn add_sum(&mut self, kernel: &Kernel) {
        let sum = self.sum.get_or_insert_with(|| kernel.nothing());
        kernel.add_to(sum);
    }
}

/// Numbers that put cubes in the order of a curve through the bins (Morton's), so that neighbours come near each other.
struct Codes {
    shift: u32,
    least: [i32; 3],
}

impl Codes {
    fn of(grid: &Grid, cubes: &[(CubeId, Place)]) -> Self {
        let (mut least, mut greatest) = ([i32::MAX; 3], [i32::MIN; 3]);
        for (_, place) in cubes {
            for axis in 0..3 {
                least[axis] = least[axis].min(place.corner()[axis]);
                greatest[axis] = greatest[axis].max(place.corner()[axis]);
            }
        }
        let mut shift = grid.shift();
        let layers = |shift: u32| {
            (0..3).map(move |axis| (greatest[axis] >> shift).abs_diff(least[axis] >> shift))
        };
        while !cubes.is_empty() && layers(shift).any(|layers| layers >> AXIS_BITS > 0) {
            shift += 1;
        }
        Self {
            shift,
            least: least.map(|least| least >> shift),
        }
    }

    fn code(&self, place: Place, index: usize) -> u64 {
        let mut code = 0;
        for (axis, coordinate) in place.corner().into_iter().enumerate() {
            let layer = (coordinate >> self.shift).abs_diff(self.least[axis]);
            code |= spread(layer.into()) << axis;
        }
        code << INDEX_BITS | index as u64
    }
}

/// Cubes in an order.
fn in_order(order: &[u64], cubes: &[(CubeId, Place)]) -> Vec<(CubeId, Place)> {
    let cube = |(at, code): (usize, &u64)| {
        if let Some(ahead) = order.get(at + 2 * AHEAD) {
            prefetch(cubes, index_of(*ahead));
        }
        cubes[index_of(*code)]
    };
    order.iter().enumerate().map(cube).collect()
}

fn index_of(code: u64) -> usize {
    let index = code & ((1 << INDEX_BITS) - 1);
    usize::try_from(index).expect("it has few bits")
}

/// Two zeros between one bit and the next, for 21 bits.
fn spread(bits: u64) -> u64 {
    let bits = (bits | bits << 32) & 0x001f_0000_0000_ffff;
    let bits = (bits | bits << 16) & 0x001f_0000_ff00_00ff;
    let bits = (bits | bits << 8) & 0x100f_00f0_0f00_f00f;
    let bits = (bits | bits << 4) & 0x10c3_0c30_c30c_30c3;
    (bits | bits << 2) & 0x1249_2492_4924_9249
}
