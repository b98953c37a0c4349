//! The kernel on its own: all lanes and widths against each other, and what a leaf enumerates against a look at every point.

use super::*;
use crate::engine::lanes::Lanes;
use crate::geometry::{EDGE_MAX, OctantMask, WEIGHTS};
use crate::random::Random;

fn within(random: &mut Random, min: i32, max: i32) -> i32 {
    i32::try_from(random.within(min.into(), max.into())).unwrap()
}

/// A cube that changes much, little or nothing, and its neighbours: offsets that often agree.
fn neighbours(random: &mut Random, edge: i32) -> Vec<[i32; 3]> {
    let some: Vec<i32> = (0..6).map(|_| within(random, -edge, edge)).collect();
    let ends = [-edge, 1 - edge, -1, 0, 1, edge - 1, edge];
    let free = random.below(4_u64);
    let count = [3, 12, 40, 90][random.below(4_usize)];
    let coordinate = |random: &mut Random| match random.below(4_u64) {
        kind if kind < free => within(random, -edge, edge),
        0 | 1 => some[random.below(some.len())],
        _ => ends[random.below(ends.len())],
    };
    (0..random.below(count))
        .map(|_| [(); 3].map(|()| coordinate(random)))
        .collect()
}

fn pushed(offsets: &[[i32; 3]]) -> Neighbours {
    let mut neighbours = Neighbours::new();
    for offset in offsets {
        neighbours.push(*offset);
    }
    neighbours
}

/// The narrowest integers and the widest, with the processor's best instructions and without: the same differences, and from
/// the same integers the same boxes. What a processor without AVX2 runs is tried nowhere else.
#[test]
fn lanes_and_widths_agree() {
    const ROUNDS: usize = 400;
    for (seed, steps) in [50, 6208, 6209, 20_000, 32_766, 32_767, 1 << 20]
        .into_iter()
        .enumerate()
    {
        let mut random = Random::new(seed as u64);
        let edge = Edge::new(steps.into()).unwrap();
        let widest = EDGE_MAX.cast_signed();
        let mut kernels = [
            Kernel::build(None, steps, steps),
            Kernel::build(avx2(), steps, steps),
            Kernel::build(avx2(), steps, widest),
            Kernel::plain(edge),
        ];
        let mut changed = 0;
        for round in 0..ROUNDS {
            let far = 3 * i64::from(steps);
            let corner = [(); 3].map(|()| random.within(-far, far));
            let place = Place::new(corner, edge).unwrap();
            let stock = [
                None,
                Stock::new([-3 * far; 3], [3 * far; 3]).ok(),
                Stock::new(corner.map(|low| low - 7), corner.map(|low| low + far / 6)).ok(),
            ][round % 3];
            let offsets = neighbours(&mut random, steps);
            let neighbours = pushed(&offsets);
            let found = kernels.each_mut().map(|kernel| {
                kernel.set_stock(stock);
                let mut boxes = Vec::new();
                let uncovers = kernel.uncovered(place, &neighbours, &mut boxes);
                let mut sums = [kernel.nothing(); 2];
                kernel.add_to(&mut sums[0]);
                let changes = kernel.marginal(place, &neighbours);
                kernel.add_to(&mut sums[1]);
                assert_eq!(
                    (changes, sums[1]),
                    (uncovers, sums[0]),
                    "with boxes or without"
                );
                assert_eq!(boxes.is_empty(), !changes);
                (changes, sums[0], kernel.volume(), boxes)
            });
            let [portable, fast, wide, plain] = &found;
            let about = format!("edge {steps}, corner {corner:?}, {stock:?}, {offsets:?}");
            assert_eq!(portable, fast, "{about}");
            assert_eq!(wide, plain, "{about}");
            let sums = |(changes, sums, volume, _): &(_, _, _, _)| (*changes, *sums, *volume);
            let (narrow, wide): ((bool, Difference, i128), _) = (sums(fast), sums(wide));
            assert_eq!(narrow, wide, "{about}");
            changed += usize::from(narrow.0);
        }
        assert!(
            changed > 0 && changed < ROUNDS,
            "of edge {steps}: {changed}"
        );
    }
}

/// A point, and the octants around it that are inside before, inside after, and in the stock.
type Noted = ([i32; 3], [u8; 3]);

/// Notes the points of a leaf instead of summing them.
struct Notes<const STOCK: bool>(Vec<Noted>);

impl<const STOCK: bool, L: Lanes, W: Width> Visitor<L, W> for Notes<STOCK> {
    const STOCK: bool = STOCK;
    type Total = Vec<Noted>;

    fn new(_: L) -> Self {
        Self(Vec::new())
    }

    fn visit(&mut self, _: L, at: [i32; 3], before: u8, after: u8, material: u8) {
        self.0.push((at, [before, after, material]));
    }

    fn end_plane(&mut self, z: i32, _: &mut Vec<Noted>) {
        assert!(self.0.last().is_some_and(|(at, _)| at[2] == z));
    }

    fn end_leaf(self, _: L, total: &mut Vec<Noted>) {
        total.extend(self.0);
    }

    fn end(_: &mut Vec<Noted>) {}
}

/// The points of a cube that are enumerated.
struct Enumerate<'a, const STOCK: bool> {
    edge: i32,
    neighbours: &'a Neighbours,
    stock: Span,
}

impl<const STOCK: bool> OnLanes for Enumerate<'_, STOCK> {
    type Output = Vec<Noted>;

    #[inline(always)]
    fn run_on<L: Columns<i16> + Columns<i32>>(self, lanes: L) -> Vec<Noted> {
        let mut plan = Plan::<L, Narrow>::new(lanes, self.edge);
        plan.stock = plan.boxed(&self.stock);
        let mut total = Vec::new();
        lanes.run(Start::<L, Narrow, Notes<STOCK>> {
            plan: &mut plan,
            neighbours: self.neighbours,
            total: &mut total,
        });
        total
    }
}

/// The octants around a point in which a predicate of cells holds.
fn octants(point: [i32; 3], holds: impl Fn([i32; 3]) -> bool) -> u8 {
    (0..8).fold(0, |mask, octant| {
        let cell = [0, 1, 2].map(|axis| point[axis] - 1 + (octant >> axis & 1));
        mask | u8::from(holds(cell)) << octant
    })
}

/// Each point at which the octants change and vary along all axes, before or after, is enumerated once, with its octants; no other
/// without a stock, and with one none that cannot count.
#[test]
fn a_leaf_enumerates_what_a_look_at_every_point_finds() {
    let mut random = Random::new(77);
    for round in 0..1500 {
        let edge = within(&mut random, 1, 9);
        let offsets = neighbours(&mut random, edge);
        let neighbours = pushed(&offsets);
        let cube = Span::cube([0; 3], edge);
        let stock = Span {
            min: [(); 3].map(|()| within(&mut random, -2, edge)),
            max: [(); 3].map(|()| within(&mut random, 0, edge + 2)),
        };
        let stock = stock.clamped(&cube.grown());
        let is_in = |span: &Span, cell: [i32; 3]| {
            (0..3).all(|axis| span.min[axis] <= cell[axis] && cell[axis] < span.max[axis])
        };
        let cubes: Vec<Span> = offsets.iter().map(|low| Span::cube(*low, edge)).collect();
        let before = |cell: [i32; 3]| cubes.iter().any(|cube| is_in(cube, cell));
        let along = || 0..=edge;
        let points =
            along().flat_map(|x| along().flat_map(move |y| along().map(move |z| [x, y, z])));
        let mut all = Vec::new();
        for point in points {
            all.push((
                point,
                [
                    octants(point, before),
                    octants(point, |cell| before(cell) || is_in(&cube, cell)),
                    octants(point, |cell| is_in(&stock, cell)),
                ],
            ));
        }
        let counts = |masks: &[u8]| {
            let axis = |axis| {
                masks
                    .iter()
                    .any(|mask| OctantMask(*mask).varies_along(axis))
            };
            masks[0] != masks[1] && axis(0) && axis(1) && axis(2)
        };
        for avx2 in [None, avx2()] {
            let about = format!("round {round}, edge {edge}, {offsets:?}, {stock:?}");
            let mut alone = run_on(
                avx2,
                Enumerate::<false> {
                    edge,
                    neighbours: &neighbours,
                    stock,
                },
            );
            alone.sort_unstable();
            let expected = all.iter().filter(|(_, masks)| counts(&masks[..2]));
            let expected: Vec<Noted> = expected
                .map(|(point, [before, after, _])| (*point, [*before, *after, 0]))
                .collect();
            assert_eq!(alone, expected, "{about}");
            if !stock.is_solid() {
                continue;
            }
            let mut stocked = run_on(
                avx2,
                Enumerate::<true> {
                    edge,
                    neighbours: &neighbours,
                    stock,
                },
            );
            stocked.sort_unstable();
            assert!(
                stocked.is_sorted_by(|one, other| one.0 < other.0),
                "{about}"
            );
            for found in &stocked {
                assert!(all.contains(found), "{found:?} {about}");
            }
            for point in all.iter().filter(|(_, masks)| counts(masks)) {
                assert!(stocked.contains(point), "{point:?} {about}");
            }
        }
    }
    // What is not enumerated weighs nothing in a volume: the weights of masks that do not vary along some axis are none.
    for mask in 0..=u8::MAX {
        let flat = (0..3).any(|axis| !OctantMask(mask).varies_along(axis));
        assert!(
            !flat || WEIGHTS[usize::from(mask)].volume == 0,
            "{mask:08b}"
        );
    }
}
