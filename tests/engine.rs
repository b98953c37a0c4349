//! The engine against voxels, in small worlds with large cubes, so that ties are the common case.

#[path = "oracle/random.rs"]
mod random;
#[path = "oracle/voxels.rs"]
mod voxels;

use std::collections::BTreeMap;
use std::num::NonZero;

use random::Random;
use union3d::engine::{Cursor, Engine, Inconsistent, Op, Rejected, Side, recount, recount_while};
use union3d::geometry::{CUBES_MAX, CubeId, Edge, EdgeKind, Effect, Place, Stock, Totals};

/// An engine, and the plain map it must agree with.
struct Compared {
    edge: Edge,
    stock: Option<Stock>,
    engines: Vec<Engine>,
    map: BTreeMap<CubeId, Place>,
}

impl Compared {
    /// One engine with bins of its own choice, one with fixed bins, one without special instructions and with wide sums.
    fn new(edge: i64, stock: Option<Stock>, bin_shift: u32) -> Self {
        let edge = Edge::new(edge).unwrap();
        let engines = [
            Engine::new(edge),
            Engine::with_bins(edge, bin_shift),
            Engine::plain(edge),
        ];
        Self {
            edge,
            stock,
            engines: engines.map(|engine| engine.with_stock(stock)).into(),
            map: BTreeMap::new(),
        }
    }

    fn apply(&mut self, ops: &[Op]) {
        for engine in &mut self.engines {
            let judged = engine.judge(ops, CUBES_MAX).unwrap();
            engine.apply(&judged.effect).unwrap();
        }
        for op in ops {
            match *op {
                Op::Delete(id) => drop(self.map.remove(&id)),
                Op::Insert(id, place) => drop(self.map.insert(id, place)),
            }
        }
    }

    fn places(&self) -> Vec<Place> {
        self.map.values().copied().collect()
    }

    #[track_caller]
    fn check(&self, context: impl Fn() -> String) {
        let expected = voxels::totals(self.edge, self.stock, &self.places());
        for (number, engine) in self.engines.iter().enumerate() {
            assert_eq!(engine.totals(), expected, "engine {number}: {}", context());
        }
    }
}

/// A box whose faces cut cubes of a world of that reach, and are often flush with theirs.
fn random_stock(random: &mut Random, reach: i64) -> Stock {
    let min = [0; 3].map(|_: i64| random.within(-reach, reach));
    let max = min.map(|low| low + random.within(1, reach + 4));
    Stock::new(min, max).unwrap()
}

/// 1,500 histories; every measure after every change.
#[test]
fn random_histories_agree_with_voxels_after_every_change() {
    for seed in 0..1500 {
        let mut random = Random::new(seed);
        let edge = random.within(1, 5);
        let world = edge + random.within(0, 6);
        let stock = (seed % 2 == 0).then(|| random_stock(&mut random, world / 2));
        let mut compared = Compared::new(edge, stock, random.within(0, 4) as u32);
        for change in 0..random.within(8, 24) {
            let mut ops = Vec::new();
            for _ in 0..random.within(1, 3) {
                let id = CubeId(random.below(12));
                let known = ops
                    .iter()
                    .any(|op| matches!(op, Op::Insert(other, _) if *other == id));
                let present = compared.map.contains_key(&id);
                if !known && (present || random.below(4) == 0) {
                    ops.push(Op::Delete(id));
                }
                if !known && (!present || random.below(2) == 0) {
                    let corner = [0; 3].map(|_: i32| random.within(-world / 2, world / 2));
                    ops.push(Op::Insert(id, Place::new(corner, compared.edge).unwrap()));
                }
            }
            compared.apply(&ops);
            compared.check(|| {
                format!(
                    "seed {seed}, change {change}, edge {edge}, stock {stock:?}, world {world}: {ops:?}"
                )
            });
        }
        let everything: Vec<Op> = compared.map.keys().map(|id| Op::Delete(*id)).collect();
        compared.apply(&everything);
        for engine in &compared.engines {
            assert_eq!(
                engine.totals(),
                Totals::of_nothing(stock),
                "seed {seed}: deleting everything leaves nothing"
            );
        }
    }
}

/// Dense worlds, where most cubes are covered when they come and uncovered again when others go.
#[test]
fn dense_histories_agree_with_voxels() {
    for seed in 0..60 {
        let mut random = Random::new(1_000_000 + seed);
        let edge = random.within(4, 9);
        let world = random.within(3, 9);
        let stock = (seed % 2 == 0).then(|| random_stock(&mut random, world));
        let mut compared = Compared::new(edge, stock, 3);
        for change in 0..120u64 {
            let delete = compared.map.len() as u64 > 40
                || (!compared.map.is_empty() && random.below(3) == 0);
            let op = if delete {
                let index = random.below(compared.map.len() as u64) as usize;
                Op::Delete(*compared.map.keys().nth(index).unwrap())
            } else {
                let corner = [0; 3].map(|_: i32| random.within(0, world));
                Op::Insert(CubeId(change), Place::new(corner, compared.edge).unwrap())
            };
            compared.apply(&[op]);
            compared.check(|| format!("seed {seed}, change {change}, {op:?}"));
        }
    }
}

/// A recount that nobody waits for ends at the next question.
#[test]
fn a_recount_ends_when_it_is_to() {
    let edge = Edge::new(3).unwrap();
    let places = || (0..500_000).map(move |x| Place::new([x, 0, 0], edge).unwrap());
    for questions in [0, 1] {
        let asked = std::cell::Cell::new(0);
        let goes_on = || {
            asked.set(asked.get() + 1);
            asked.get() <= questions
        };
        assert_eq!(recount_while(edge, None, places(), &goes_on), None);
        assert_eq!(asked.get(), questions + 1);
    }
    let whole = recount_while(edge, None, places(), &|| true);
    assert_eq!(whole.unwrap().measures.volume, 9 * 500_002);
}

/// Enough neighbours for the division of points, thin slabs included: larger cubes, compared with a recount in another
/// order and drained to zero.
#[test]
fn crowded_histories_agree_with_a_recount() {
    for seed in 0..40 {
        let mut random = Random::new(2_000_000 + seed);
        let edge = Edge::new(random.within(20, 2000)).unwrap();
        let reach = i64::from(edge.steps()) / random.within(1, 4) + 1;
        // Flat worlds make massive coplanarity.
        let flat = random.below(4) as usize;
        // Faces of the stock go through the crowd, or lie around it.
        let stock_reach = reach * random.within(1, 3);
        let stock = random_stock(&mut random, stock_reach);
        let volume = Totals::of_nothing(Some(stock))
            .stock
            .unwrap()
            .remaining
            .volume;
        let stock = (seed % 2 == 0).then_some(stock);
        let parts_add_up = |engine: &Engine| {
            if let Some(parts) = engine.totals().stock {
                assert_eq!(
                    parts.removed.volume + parts.remaining.volume,
                    volume,
                    "seed {seed}"
                );
            }
        };
        let mut engine = Engine::new(edge).with_stock(stock);
        let mut places = Vec::new();
        for id in 0..300 {
            let mut corner = [0; 3].map(|_: i32| random.within(-reach, reach));
            if flat < 3 {
                corner[flat] = 0;
            }
            let place = Place::new(corner, edge).unwrap();
            places.push(place);
            engine
                .apply(&Effect {
                    deleted: vec![],
                    inserted: vec![(CubeId(id), place)],
                })
                .unwrap();
            parts_add_up(&engine);
        }
        assert_eq!(
            engine.totals(),
            recount(edge, stock, places.iter().rev().copied()),
            "seed {seed}"
        );
        let mut left: Vec<u64> = (0..300).collect();
        while !left.is_empty() {
            let id = left.swap_remove(random.below(left.len() as u64) as usize);
            let deleted = vec![(CubeId(id), places[id as usize])];
            engine
                .apply(&Effect {
                    deleted,
                    inserted: vec![],
                })
                .unwrap();
            parts_add_up(&engine);
            if left.len().is_multiple_of(50) {
                let rest = left.iter().map(|id| places[*id as usize]);
                assert_eq!(
                    engine.totals(),
                    recount(edge, stock, rest),
                    "seed {seed}, {} left",
                    left.len()
                );
            }
        }
        assert_eq!(engine.totals(), Totals::of_nothing(stock), "seed {seed}");
    }
}

/// Crowds in which most cubes are covered come and go for long: covered cells are marked, unmarked, given up and begun again.
/// The plain engine keeps none.
#[test]
fn churning_crowds_agree_with_a_plain_engine() {
    for seed in 0..30 {
        let mut random = Random::new(4_000_000 + seed);
        let edge = Edge::new(random.within(8, 40)).unwrap();
        let reach = i64::from(edge.steps()) * random.within(1, 3);
        let stock = (seed % 2 == 0).then(|| random_stock(&mut random, reach));
        let mut fast = Engine::new(edge).with_stock(stock);
        let mut plain = Engine::plain(edge).with_stock(stock);
        let mut present: Vec<(CubeId, Place)> = Vec::new();
        for change in 0..1500 {
            // Fill, churn, drain, churn.
            let target = [300, 200, 5, 60][change / 375];
            let mut effect = Effect::default();
            if random.below(2 * target) < present.len() as u64 {
                let index = random.below(present.len() as u64) as usize;
                effect.deleted.push(present.swap_remove(index));
            } else {
                let corner = [0; 3].map(|_: i32| random.within(-reach, reach));
                let cube = (CubeId(change as u64), Place::new(corner, edge).unwrap());
                effect.inserted.push(cube);
                present.push(cube);
            }
            fast.apply(&effect).unwrap();
            plain.apply(&effect).unwrap();
            assert_eq!(
                fast.totals(),
                plain.totals(),
                "seed {seed}, change {change}: {effect:?}"
            );
        }
        let rest = present.iter().map(|(_, place)| *place);
        assert_eq!(fast.totals(), recount(edge, stock, rest), "seed {seed}");
    }
}

/// Many cubes in one change, with ties and duplicates, come and go in small worlds: voxels agree, with every number of threads
/// and every width of bins.
#[test]
fn batches_agree_with_voxels() {
    for seed in 0..150 {
        let mut random = Random::new(6_000_000 + seed);
        let edge = Edge::new(random.within(1, 9)).unwrap();
        let world = random.within(3, 20);
        let mut engines: Vec<Engine> = (0..5)
            .map(|shift| {
                Engine::with_bins(edge, shift).with_threads(threads(seed as usize % 3 + 1))
            })
            .collect();
        engines.push(Engine::new(edge));
        engines.push(Engine::plain(edge));
        let mut present: Vec<(CubeId, Place)> = Vec::new();
        for change in 0..8 {
            let mut effect = Effect::default();
            for _ in 0..random.within(0, 100).min(present.len() as i64) {
                let index = random.below(present.len() as u64) as usize;
                effect.deleted.push(present.swap_remove(index));
            }
            for id in 0..random.within(0, 100) {
                let corner = [0; 3].map(|_: i32| random.within(0, world));
                let place = Place::new(corner, edge).unwrap();
                effect
                    .inserted
                    .push((CubeId(change * 1000 + id as u64), place));
            }
            present.extend(&effect.inserted);
            let places: Vec<Place> = present.iter().map(|(_, place)| *place).collect();
            let expected = voxels::totals(edge, None, &places);
            for (number, engine) in engines.iter_mut().enumerate() {
                engine.apply(&effect).unwrap();
                assert_eq!(
                    engine.totals(),
                    expected,
                    "seed {seed}, change {change}, {number}"
                );
            }
        }
    }
}

/// Batches large enough for several slices and several threads give the totals of the same cubes one by one, from sparse to
/// crowded, in planes and in one spot, and leave nothing behind.
#[test]
fn large_batches_agree_with_single_changes() {
    for seed in 0..12 {
        let mut random = Random::new(7_000_000 + seed);
        let edge = Edge::new(random.within(10, 60)).unwrap();
        let reach = i64::from(edge.steps()) * [20, 8, 3, 1][seed as usize % 4];
        let flat = seed as usize % 5;
        let stock = (seed % 3 == 0).then(|| Stock::new([-reach / 2; 3], [reach; 3]).unwrap());
        let mut engines: Vec<Engine> = (1..=3)
            .map(|count| {
                Engine::new(edge)
                    .with_stock(stock)
                    .with_threads(threads(count))
            })
            .collect();
        let mut single = Engine::new(edge).with_stock(stock);
        let mut present: Vec<(CubeId, Place)> = Vec::new();
        for (change, count) in [9000, 3000, 6000, 0, 100].into_iter().enumerate() {
            let mut effect = Effect::default();
            let going = if count == 0 { 0 } else { present.len() / 3 };
            for _ in 0..going {
                let index = random.below(present.len() as u64) as usize;
                effect.deleted.push(present.swap_remove(index));
            }
            for id in 0..count {
                let mut corner = [0; 3].map(|_: i32| random.within(-reach, reach));
                if flat < 3 {
                    corner[flat] = 0;
                }
                let place = Place::new(corner, edge).unwrap();
                effect
                    .inserted
                    .push((CubeId(change as u64 * 10_000 + id), place));
            }
            if count == 0 {
                effect.deleted = std::mem::take(&mut present);
            }
            present.extend(&effect.inserted);
            for cube in &effect.deleted {
                let deleted = vec![*cube];
                let inserted = vec![];
                single.apply(&Effect { deleted, inserted }).unwrap();
            }
            for cube in &effect.inserted {
                let (deleted, inserted) = (vec![], vec![*cube]);
                single.apply(&Effect { deleted, inserted }).unwrap();
            }
            for engine in &mut engines {
                engine.apply(&effect).unwrap();
                assert_eq!(
                    engine.totals(),
                    single.totals(),
                    "seed {seed}, change {change}"
                );
            }
        }
    }
}

/// Batches so large that the table of ids and the bins are filled by all threads: the same totals and listing as in parts; and
/// one that does not fit changes nothing.
#[test]
fn very_large_batches_agree_with_smaller_ones() {
    let edge = Edge::new(50).unwrap();
    for (seed, reach) in [(1, 4_000), (2, 900)] {
        let mut random = Random::new(seed);
        let mut cubes = |ids: std::ops::Range<u64>| -> Vec<(CubeId, Place)> {
            let mut place = |_| Place::new([0; 3].map(|_: i32| random.within(-reach, reach)), edge);
            ids.map(|id| (CubeId(id * 3), place(id).unwrap())).collect()
        };
        let (first, second) = (cubes(0..240_000), cubes(300_000..390_000));
        let replaced = Effect {
            deleted: first[..120_000].to_vec(),
            inserted: second.clone(),
        };
        let mut in_parts = Engine::new(edge);
        for some in first.chunks(20_000) {
            in_parts.apply(&inserting(some)).unwrap();
        }
        for count in 2..=3 {
            let mut engine = Engine::new(edge).with_threads(threads(count));
            engine.apply(&inserting(&first)).unwrap();
            assert_eq!(
                engine.totals(),
                in_parts.totals(),
                "seed {seed}, {count} threads"
            );
            let mut misfit = replaced.clone();
            misfit.inserted.push(first[150_000]);
            misfit.inserted.push(first[140_000]);
            let id = first[150_000].0;
            assert_eq!(engine.apply(&misfit), Err(Inconsistent { id }));
            assert_eq!(engine.totals(), in_parts.totals());
            assert!(engine.cubes().eq(in_parts.cubes()));
            engine.apply(&replaced).unwrap();
            let rest = engine.cubes().map(|(_, place)| place);
            assert_eq!(
                engine.totals(),
                recount(edge, None, rest),
                "seed {seed}, {count} threads"
            );
            let deleted = engine.cubes().collect();
            engine
                .apply(&Effect {
                    deleted,
                    inserted: vec![],
                })
                .unwrap();
            assert_eq!(engine.totals(), Engine::new(edge).totals());
        }
    }
}

fn inserting(cubes: &[(CubeId, Place)]) -> Effect {
    Effect {
        deleted: vec![],
        inserted: cubes.to_vec(),
    }
}

fn threads(count: usize) -> NonZero<usize> {
    NonZero::new(count).unwrap()
}

/// Every width of the kernel's sums and lanes, up to the widest edge and far from the origin, against the plain one.
#[test]
fn every_edge_agrees_with_a_plain_engine() {
    for (seed, steps) in [
        1,
        2,
        3,
        6_208,
        6_209,
        20_000,
        32_766,
        32_767,
        1 << 20,
        1 << 24,
    ]
    .into_iter()
    .enumerate()
    {
        let mut random = Random::new(5_000_000 + seed as u64);
        let edge = Edge::new(steps).unwrap();
        for far in [0, (1 << 30) - 3 * steps, -(1 << 30) + 2 * steps] {
            let mut corner = || [0; 3].map(|_: i32| far + random.within(-2 * steps, 2 * steps));
            let [min, max] = [corner(), corner()];
            let order =
                |pick: fn(i64, i64) -> i64| [0, 1, 2].map(|axis| pick(min[axis], max[axis]));
            let stock = Stock::new(order(i64::min), order(i64::max).map(|high| high + 1)).ok();
            let mut fast = Engine::new(edge).with_stock(stock);
            let mut plain = Engine::plain(edge).with_stock(stock);
            let mut cubes = Vec::new();
            for id in 0..120 {
                let place = Place::new(corner(), edge).unwrap();
                cubes.push((CubeId(id), place));
                for engine in [&mut fast, &mut plain] {
                    let effect = Effect {
                        deleted: vec![],
                        inserted: vec![(CubeId(id), place)],
                    };
                    engine.apply(&effect).unwrap();
                }
                assert_eq!(
                    fast.totals(),
                    plain.totals(),
                    "edge {steps}, far {far}, cube {id}"
                );
            }
            while !cubes.is_empty() {
                let cube = cubes.swap_remove(random.below(cubes.len() as u64) as usize);
                for engine in [&mut fast, &mut plain] {
                    let effect = Effect {
                        deleted: vec![cube],
                        inserted: vec![],
                    };
                    engine.apply(&effect).unwrap();
                }
                let left = cubes.len();
                assert_eq!(
                    fast.totals(),
                    plain.totals(),
                    "edge {steps}, far {far}, {left} left"
                );
            }
            assert_eq!(fast.totals(), Totals::of_nothing(stock));
        }
    }
}

/// Every width of the kernel's integers in few steps, one by one and in batches, with a stock near and without, against an engine
/// that takes the widest ones on portable lanes: short enough for valgrind, which watches what the lanes read (`tests/memcheck`).
#[test]
fn short_histories_of_every_width_agree_with_a_plain_engine() {
    for (seed, steps) in [50, 20_000, 1 << 20].into_iter().enumerate() {
        let edge = Edge::new(steps).unwrap();
        for stock in [None, Stock::new([-steps; 3], [steps / 2; 3]).ok()] {
            let mut random = Random::new(8_000_000 + seed as u64);
            let mut cubes = |ids: std::ops::Range<u64>| -> Vec<(CubeId, Place)> {
                ids.map(|id| {
                    let corner = [0; 3].map(|_: i32| random.within(-steps, steps));
                    (CubeId(id), Place::new(corner, edge).unwrap())
                })
                .collect()
            };
            let (single, batch) = (cubes(0..50), cubes(50..90));
            let mut changes: Vec<Effect> = single.chunks(1).map(inserting).collect();
            changes.push(Effect {
                deleted: single[..40].to_vec(),
                inserted: batch.clone(),
            });
            changes.extend(batch.chunks(1).map(|cube| Effect {
                deleted: cube.to_vec(),
                inserted: vec![],
            }));
            let mut fast = Engine::new(edge).with_stock(stock);
            let mut plain = Engine::plain(edge).with_stock(stock);
            for (number, change) in changes.iter().enumerate() {
                fast.apply(change).unwrap();
                plain.apply(change).unwrap();
                assert_eq!(
                    fast.totals(),
                    plain.totals(),
                    "edge {steps}, stock {stock:?}, change {number}"
                );
            }
        }
    }
}

/// Small voxel worlds with so many cubes that leaves are reached by division, not only at once.
#[test]
fn many_cubes_in_a_small_world_agree_with_voxels() {
    for seed in 0..200 {
        let mut random = Random::new(3_000_000 + seed);
        let edge = Edge::new(random.within(8, 14)).unwrap();
        let reach = i64::from(edge.steps()) - 1;
        let corner = |random: &mut Random| [0; 3].map(|_: i32| random.within(-reach, reach));
        // Cubes around the last one, each leaving room in the middle, so that few are covered.
        let mut places: Vec<Place> = (0..60)
            .map(|_| Place::new(corner(&mut random), edge).unwrap())
            .collect();
        let mut engine = Engine::new(edge);
        for (id, place) in places.iter().enumerate() {
            engine
                .apply(&Effect {
                    deleted: vec![],
                    inserted: vec![(CubeId(id as u64), *place)],
                })
                .unwrap();
        }
        assert_eq!(
            engine.totals(),
            voxels::totals(edge, None, &places),
            "seed {seed}"
        );
        for (id, place) in places.drain(..40).enumerate() {
            let deleted = vec![(CubeId(id as u64), place)];
            let effect = Effect {
                deleted,
                inserted: vec![],
            };
            engine.apply(&effect).unwrap();
        }
        assert_eq!(
            engine.totals(),
            voxels::totals(edge, None, &places),
            "seed {seed}, after deletions"
        );
    }
}

#[test]
fn the_order_of_cubes_is_irrelevant() {
    let mut random = Random::new(7);
    let edge = Edge::new(6).unwrap();
    let mut places: Vec<Place> = (0..200)
        .map(|_| Place::new([0; 3].map(|_: i32| random.within(0, 20)), edge).unwrap())
        .collect();
    let expected = voxels::totals(edge, None, &places);
    for _ in 0..20 {
        for index in (1..places.len()).rev() {
            places.swap(index, random.below(index as u64 + 1) as usize);
        }
        assert_eq!(recount(edge, None, places.iter().copied()), expected);
    }
}

/// A million random cubes, in ten boxes, agree with the expected measures within five standard errors.
///
/// `N` lower corners lie uniformly in a box of side `U`. A point at the depth `t` from the borders (per axis the share, up
/// to 1, of the lower corners that could cover it along that axis) stays bare with probability `exp(-rho t_x t_y t_z)`.
/// Every measure is then a sum over kinds of features of `N^cubes` times the product of three measures of `t`, one an axis.
/// Far from the borders (all `t` = 1) these are the formulas of UNION3's paper.
#[test]
fn a_million_random_cubes_agree_with_their_expectation() {
    let (boxes, count, side, length) = (10, 100_000u32, 100_000_000i64, 2_000_000i64);
    let edge = Edge::new(length).unwrap();
    let (n, l, u) = (f64::from(count), length as f64, side as f64);
    let rho = n * (l / u).powi(3);
    let ratio = l / u;

    // Simpson's rule over the border, where t goes from 0 to 1, and an atom at t = 1.
    let measure = |atom: f64, density: &dyn Fn(f64) -> f64| -> Vec<(f64, f64)> {
        let steps = 64;
        let mut points: Vec<(f64, f64)> = (0..=steps)
            .map(|step| {
                let t = f64::from(step) / f64::from(steps);
                let weight = if step == 0 || step == steps {
                    1.0
                } else {
                    f64::from(2 + 2 * (step % 2))
                };
                (t, weight / (3.0 * f64::from(steps)) * density(t))
            })
            .collect();
        points.push((1.0, atom));
        points
    };
    // All of space; a coordinate that `k` given cubes cover; a face of a cube at which `k` other cubes cover.
    let space = measure(u - l, &|_| 2.0 * l);
    let covered = |k: i32| measure((u - l) * ratio.powi(k), &|t| 2.0 * l * (t * ratio).powi(k));
    let face = |k: i32| {
        measure(2.0 * (1.0 - ratio) * ratio.powi(k), &|t| {
            2.0 * ratio * (t * ratio).powi(k)
        })
    };
    let integral = |axes: [&Vec<(f64, f64)>; 3], bare: &dyn Fn(f64) -> f64| -> f64 {
        let mut sum = 0.0;
        for (x, weight_x) in axes[0] {
            for (y, weight_y) in axes[1] {
                sum += axes[2]
                    .iter()
                    .map(|(z, weight)| weight * bare(x * y * z))
                    .sum::<f64>()
                    * weight_x
                    * weight_y;
            }
        }
        sum
    };
    let bare = |t: f64| (-rho * t).exp();
    let expected = [
        integral([&space; 3], &|t| 1.0 - bare(t)),
        3.0 * n * integral([&face(0), &covered(1), &covered(1)], &bare),
        3.0 * n * integral([&covered(1), &face(0), &face(0)], &bare),
        3.0 * n * n * integral([&covered(2), &face(1), &face(1)], &bare),
        n * integral([&face(0), &face(0), &face(0)], &bare),
        3.0 * n * n * integral([&face(1), &face(1), &face(1)], &bare),
        n * n * n * integral([&face(2), &face(2), &face(2)], &bare),
    ];

    let mut found = Vec::new();
    for seed in 0..boxes {
        let mut random = Random::new(9_000_000 + seed);
        let place = |random: &mut Random| {
            Place::new([0; 3].map(|_: i32| random.within(0, side - 1)), edge).unwrap()
        };
        let inserted = (0..count)
            .map(|id| (CubeId(id.into()), place(&mut random)))
            .collect();
        let mut engine = Engine::new(edge);
        engine
            .apply(&Effect {
                deleted: vec![],
                inserted,
            })
            .unwrap();
        let measures = engine.totals().measures;
        let [corner, edge_face, three_face, _] = measures.vertices.map(|count| count as f64);
        found.push([
            measures.volume as f64,
            measures.area() as f64,
            measures.edge_length_of(EdgeKind::Convex) as f64,
            measures.edge_length_of(EdgeKind::Concave) as f64,
            corner,
            edge_face,
            three_face,
        ]);
    }
    let names = [
        "volume",
        "area",
        "convex edges",
        "concave edges",
        "corners",
        "edge-face",
        "three-face",
    ];
    for (index, (name, expected)) in names.into_iter().zip(expected).enumerate() {
        let runs = found.len() as f64;
        let mean = found.iter().map(|run| run[index]).sum::<f64>() / runs;
        let variance = found
            .iter()
            .map(|run| (run[index] - mean).powi(2))
            .sum::<f64>()
            / (runs - 1.0);
        let (error, off) = ((variance / runs).sqrt(), mean - expected);
        assert!(
            off.abs() < 5.0 * error,
            "{name}: {mean:e} found, {expected:e} expected, standard error {error:e}"
        );
        assert!(
            error < 0.005 * expected,
            "{name}: a standard error of {error:e} in {mean:e} would prove nothing"
        );
    }
}

/// One fixed long history gives one hash, in debug and release, on every machine.
#[test]
fn golden_hash_of_a_long_history() {
    let mut random = Random::new(20_260_101);
    let edge = Edge::new(40).unwrap();
    let mut engine = Engine::new(edge);
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    for change in 0..20_000u64 {
        let id = CubeId(random.below(2_000));
        let corner = [0; 3].map(|_: i32| random.within(-150, 150));
        let ops = match random.below(3) {
            0 => vec![Op::Delete(id)],
            _ => vec![
                Op::Delete(id),
                Op::Insert(id, Place::new(corner, edge).unwrap()),
            ],
        };
        let judged = engine.judge(&ops, CUBES_MAX).unwrap();
        engine.apply(&judged.effect).unwrap();
        if change % 100 == 99 {
            // FNV-1a of the text: the order of the fields is this one, the numbers are exact.
            let Totals {
                cubes,
                measures,
                bounds,
                ..
            } = engine.totals();
            let text = format!(
                "Totals {{ cubes: {cubes:?}, measures: {measures:?}, bounds: {bounds:?} }}"
            );
            for byte in text.bytes() {
                hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
            }
        }
    }
    let rest = engine.cubes().map(|(_, place)| place);
    assert_eq!(engine.totals(), recount(edge, None, rest));
    assert_eq!(format!("{hash:016x}"), "9bf268efc3d71ff4");
}

#[test]
fn an_effect_that_does_not_fit_changes_nothing() {
    let edge = Edge::new(3).unwrap();
    let place = |x| Place::new([x, 0, 0], edge).unwrap();
    let mut engine = Engine::new(edge);
    let first: Vec<_> = (0..5).map(|id| (CubeId(id), place(id as i64))).collect();
    engine
        .apply(&Effect {
            deleted: vec![],
            inserted: first.clone(),
        })
        .unwrap();
    let (totals, cubes) = (engine.totals(), engine.cubes().collect::<Vec<_>>());
    let misfits = [
        (
            Effect {
                deleted: vec![first[0], (CubeId(9), place(0))],
                inserted: vec![],
            },
            9,
        ),
        (
            Effect {
                deleted: vec![first[0], (CubeId(1), place(7))],
                inserted: vec![],
            },
            1,
        ),
        (
            Effect {
                deleted: vec![first[0]],
                inserted: vec![(CubeId(7), place(1)), first[2]],
            },
            2,
        ),
        (
            Effect {
                deleted: vec![],
                inserted: vec![(CubeId(7), place(1)), (CubeId(7), place(2))],
            },
            7,
        ),
    ];
    for (effect, id) in misfits {
        assert_eq!(engine.apply(&effect), Err(Inconsistent { id: CubeId(id) }));
        assert_eq!(engine.totals(), totals);
        assert_eq!(engine.cubes().collect::<Vec<_>>(), cubes);
    }
}

#[test]
fn operations_are_judged_in_order_and_counted_both_ways() {
    let edge = Edge::new(2).unwrap();
    let at = |x| Place::new([x, 0, 0], edge).unwrap();
    let mut engine = Engine::new(edge);
    engine
        .apply(&Effect {
            deleted: vec![],
            inserted: vec![(CubeId(1), at(0)), (CubeId(2), at(5))],
        })
        .unwrap();
    let (one, two, three) = (CubeId(1), CubeId(2), CubeId(3));
    let check = |ops: &[Op], in_order: [u64; 3], net: [u64; 3], effect: (usize, usize)| {
        let judged = engine.judge(ops, CUBES_MAX).unwrap();
        let counts =
            |counts: union3d::engine::Counts| [counts.inserted, counts.deleted, counts.unchanged];
        assert_eq!(counts(judged.in_order), in_order, "{ops:?}");
        assert_eq!(counts(judged.net), net, "{ops:?}");
        assert_eq!(
            (judged.effect.inserted.len(), judged.effect.deleted.len()),
            effect,
            "{ops:?}"
        );
    };
    check(&[], [0, 0, 0], [0, 0, 0], (0, 0));
    check(
        &[Op::Insert(one, at(0)), Op::Delete(three)],
        [0, 0, 2],
        [0, 0, 2],
        (0, 0),
    );
    check(
        &[Op::Delete(one), Op::Insert(one, at(9))],
        [1, 1, 0],
        [1, 1, 0],
        (1, 1),
    );
    check(
        &[Op::Delete(one), Op::Insert(one, at(0))],
        [1, 1, 0],
        [0, 0, 2],
        (0, 0),
    );
    check(
        &[Op::Insert(three, at(1)), Op::Delete(three)],
        [1, 1, 0],
        [0, 0, 2],
        (0, 0),
    );
    check(
        &[Op::Delete(one), Op::Delete(one), Op::Delete(two)],
        [0, 2, 1],
        [0, 2, 1],
        (0, 2),
    );
    let conflict = engine
        .judge(&[Op::Delete(two), Op::Insert(one, at(3))], CUBES_MAX)
        .unwrap_err();
    let expected = Rejected::IdConflict {
        index: 1,
        id: one,
        there: at(0),
        asked: at(3),
    };
    assert_eq!(conflict, expected);
}

/// Every point of a small world, against the voxels around it.
#[test]
fn points_are_inside_on_or_outside() {
    for seed in 0..60 {
        let mut random = Random::new(5_000_000 + seed);
        let edge = Edge::new(random.within(1, 4)).unwrap();
        let mut engine = Engine::with_bins(edge, random.within(0, 4) as u32);
        let mut cubes = Vec::new();
        for id in 0..random.within(0, 12) {
            let place = Place::new([0; 3].map(|_: i32| random.within(0, 5)), edge).unwrap();
            cubes.push((CubeId(100 - id as u64), place));
        }
        engine
            .apply(&Effect {
                deleted: vec![],
                inserted: cubes.clone(),
            })
            .unwrap();
        let fills = |voxel: [i32; 3]| {
            cubes.iter().any(|(_, place)| {
                (0..3).all(|axis| (0..edge.steps()).contains(&(voxel[axis] - place.corner()[axis])))
            })
        };
        for index in 0..1331 {
            let point = [index % 11 - 1, index / 11 % 11 - 1, index / 121 - 1];
            let octants =
                (0..8).map(|bits| fills([0, 1, 2].map(|axis| point[axis] - (bits >> axis & 1))));
            let side = match octants.filter(|filled| *filled).count() {
                0 => Side::Outside,
                8 => Side::Inside,
                _ => Side::Boundary,
            };
            let holds = |place: &Place| {
                (0..3)
                    .all(|axis| (0..=edge.steps()).contains(&(point[axis] - place.corner()[axis])))
            };
            let holder = cubes
                .iter()
                .copied()
                .filter(|(_, place)| holds(place))
                .min();
            assert_eq!(
                engine.contains(point),
                (side, holder),
                "seed {seed}, point {point:?}, {cubes:?}"
            );
        }
    }
}

/// The first `limit` cubes of a listing, and the cursor of the last of them when more follow.
fn page(
    mut cubes: impl Iterator<Item = (CubeId, Place)>,
    limit: usize,
) -> (Vec<(CubeId, Place)>, Option<Cursor>) {
    let page: Vec<_> = cubes.by_ref().take(limit).collect();
    let cursor = cubes.next().and(page.last());
    let cursor = cursor.map(|(id, _)| Cursor::of(*id));
    (page, cursor)
}

/// A listing in pages meets every cube that stays exactly once, whatever comes and goes meanwhile; the order is the ids'.
#[test]
fn pages_list_every_cube_once() {
    let mut random = Random::new(11);
    let edge = Edge::new(2).unwrap();
    let place = |random: &mut Random| {
        Place::new([0; 3].map(|_: i32| random.within(0, 1000)), edge).unwrap()
    };
    let mut engine = Engine::new(edge);
    let mut stay = BTreeMap::new();
    for id in 0..3000 {
        let id = if id % 2 == 0 {
            CubeId(id)
        } else {
            CubeId(random.next())
        };
        stay.insert(id, place(&mut random));
    }
    let effect = Effect {
        deleted: vec![],
        inserted: stay.iter().map(|(id, place)| (*id, *place)).collect(),
    };
    engine.apply(&effect).unwrap();
    let order: Vec<_> = engine.cubes().collect();
    let (mut listed, mut cursor, mut guests) = (Vec::new(), None::<Cursor>, Vec::new());
    loop {
        let (cubes, next) = page(engine.cubes_after(cursor), 70);
        listed.extend(cubes.into_iter().filter(|(id, _)| stay.contains_key(id)));
        cursor = next;
        if cursor.is_none() {
            break;
        }
        let arriving: Vec<_> = (0..500)
            .map(|_| (CubeId(random.next()), place(&mut random)))
            .collect();
        engine
            .apply(&Effect {
                deleted: std::mem::take(&mut guests),
                inserted: arriving.clone(),
            })
            .unwrap();
        guests = arriving;
    }
    assert_eq!(listed, order);
    engine
        .apply(&Effect {
            deleted: guests,
            inserted: vec![],
        })
        .unwrap();
    assert_eq!(
        engine.cubes().collect::<Vec<_>>(),
        order,
        "insert then delete restores the same listing"
    );
    assert_eq!(
        page(engine.cubes(), 3000).1,
        None,
        "a full last page has no cursor"
    );
}

/// Sparse, dense and sparse again: bins are rebuilt on the way, the memory stays in proportion.
#[test]
fn memory_is_in_proportion_to_the_cubes() {
    let edge = Edge::new(100).unwrap();
    for (spread, seed) in [(200_000, 1), (2_000, 2), (400_000_000, 3)] {
        let mut random = Random::new(seed);
        let cubes: Vec<_> = (0..200_000)
            .map(|id| {
                (
                    CubeId(id),
                    Place::new([0; 3].map(|_: i32| random.within(-spread, spread)), edge).unwrap(),
                )
            })
            .collect();
        let mut engine = Engine::new(edge);
        engine
            .apply(&Effect {
                deleted: vec![],
                inserted: cubes.clone(),
            })
            .unwrap();
        let size = engine.size();
        let per_cube = (size.ids + size.grid) as f64 / cubes.len() as f64;
        assert!(
            per_cube < 100.0,
            "{per_cube} bytes a cube at spread {spread} ({size:?})"
        );
        engine
            .apply(&Effect {
                deleted: cubes,
                inserted: vec![],
            })
            .unwrap();
        let size = engine.size();
        assert!(
            size.ids + size.grid < 10_000,
            "an empty scene is small again: {size:?}"
        );
    }
}
