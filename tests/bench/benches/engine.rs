//! The engine's operations through its public face, for `cargo bench --workspace`: small sets, compared with the run before.
//!
//! `union3d-bench engine` prints the figures that are quoted; this is for a look at one change of the code.

#[path = "../../oracle/random.rs"]
mod random;
#[path = "../src/workload.rs"]
mod workload;

use criterion::{BatchSize, BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use union3d::engine::{Bare, Engine, Op, recount};
use union3d::geometry::{CUBES_MAX, CubeId, Edge, Effect, Place};
use workload::{EDGE_STEPS, Workload};

const CUBES: usize = 100_000;

const WORKLOADS: [Workload; 5] = [
    Workload::Rho0015,
    Workload::Rho1,
    Workload::Rho10,
    Workload::Rho1000,
    Workload::Raster,
];

type Cube = (CubeId, Place);

fn edge() -> Edge {
    Edge::new(EDGE_STEPS).unwrap()
}

fn cubes(workload: Workload) -> Vec<Cube> {
    let places = workload.places(edge(), CUBES, 1).unwrap();
    (0..).map(CubeId).zip(places).collect()
}

fn inserting(cubes: &[Cube]) -> Effect {
    Effect {
        deleted: vec![],
        inserted: cubes.to_vec(),
    }
}

fn deleting(cubes: &[Cube]) -> Effect {
    Effect {
        deleted: cubes.to_vec(),
        inserted: vec![],
    }
}

/// One change a cube.
fn one_by_one(engine: &mut Engine, cubes: &[Cube], change: impl Fn(&[Cube]) -> Effect) {
    for cube in cubes.chunks(1) {
        engine.apply(&change(cube)).unwrap();
    }
}

fn full(cubes: &[Cube]) -> Engine {
    let mut engine = Engine::new(edge());
    engine.apply(&inserting(cubes)).unwrap();
    engine
}

fn engine(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("engine");
    group
        .sample_size(10)
        .throughput(Throughput::Elements(CUBES as u64));
    for workload in WORKLOADS {
        let cubes = cubes(workload);
        let places = cubes.iter().map(|(_, place)| *place);
        assert_eq!(full(&cubes).totals(), recount(edge(), None, places));
        let id = |operation| BenchmarkId::new(operation, workload.name());
        group.bench_function(id("insert"), |bencher| {
            bencher.iter_batched(
                || Engine::new(edge()),
                |mut engine| {
                    one_by_one(&mut engine, &cubes, inserting);
                    engine
                },
                BatchSize::PerIteration,
            );
        });
        group.bench_function(id("insert in a batch"), |bencher| {
            bencher.iter_batched(
                || (Engine::new(edge()), inserting(&cubes)),
                |(mut engine, effect)| {
                    engine.apply(&effect).unwrap();
                    engine
                },
                BatchSize::PerIteration,
            );
        });
        group.bench_function(id("delete oldest"), |bencher| {
            bencher.iter_batched(
                || full(&cubes),
                |mut engine| {
                    one_by_one(&mut engine, &cubes, deleting);
                    engine
                },
                BatchSize::PerIteration,
            );
        });
    }
    group.finish();
}

fn yardstick(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("bare");
    group
        .sample_size(10)
        .throughput(Throughput::Elements(CUBES as u64));
    for workload in WORKLOADS {
        let cubes = cubes(workload);
        group.bench_function(BenchmarkId::new("insert", workload.name()), |bencher| {
            bencher.iter_batched(
                || Bare::new(edge()),
                |mut bare| {
                    for &(id, place) in &cubes {
                        assert!(bare.insert(id, place));
                    }
                    bare
                },
                BatchSize::PerIteration,
            );
        });
    }
    group.finish();
}

/// Judging a change of new cubes and of cubes that go, and answering where a point lies.
fn reads(criterion: &mut Criterion) {
    const OPS: usize = 4_096;
    let cubes = cubes(Workload::Rho1);
    let (there, new) = cubes.split_at(CUBES - OPS / 2);
    let engine = full(there);
    let deletes = there.iter().step_by(there.len() / (OPS / 2));
    let ops: Vec<Op> = deletes
        .take(OPS / 2)
        .map(|(id, _)| Op::Delete(*id))
        .chain(new.iter().map(|(id, place)| Op::Insert(*id, *place)))
        .collect();
    let mut group = criterion.benchmark_group("reads");
    group.throughput(Throughput::Elements(OPS as u64));
    group.bench_function("judge", |bencher| {
        bencher.iter(|| engine.judge(&ops, CUBES_MAX).unwrap());
    });
    group.bench_function("contains", |bencher| {
        bencher.iter(|| {
            let points = new.iter().chain(there).take(OPS);
            points
                .filter(|(_, place)| engine.contains(place.corner()).1.is_some())
                .count()
        });
    });
    group.finish();
}

criterion_group!(benches, engine, yardstick, reads);
criterion_main!(benches);
