//! `union3d-bench engine`: operations a second, latencies and memory of the engine alone.

use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use indicatif::ProgressBar;
use union3d::engine::{Bare, EngineSize, recount};
use union3d::geometry::{Edge, Totals};

use super::cubes::shuffled;
use super::failure::Failure;
use super::figures::{Latencies, Spread, float, median, parse_count, rate, short};
use super::scenario::Scenario;
use super::sets::{Cube, Online, Plain, Set, each};
use super::table::{Cell, Report, Table, figure, text};
use super::workload::Workload;
use super::{bins, flat, progress};

/// Cubes in one change.
const BATCHES: [usize; 4] = [1, 100, 10_000, 1_000_000];

const THREADS: [NonZero<usize>; 2] = [
    NonZero::<usize>::MIN,
    NonZero::<usize>::MIN.saturating_add(1),
];

/// Measure the engine in this process: inserts, deletes, replacements, one by one and in batches
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Measures the engine alone, in this process: no server, no disk.

Inserts, deletes oldest first, deletes at random and replacements (the oldest by a new one, in one change) of cubes one by one, with \
the latency of each; inserts and deletes in batches on one and two threads. Two yardsticks do the same: `bare`, the engine's own \
table and grid with nothing computed, and a plain hash map. Every way to a set of cubes must give the same totals, and deleting \
everything none; otherwise the command fails.",
    after_long_help = "Examples:
  union3d-bench engine
  union3d-bench engine --workload rho-1 --workload raster --cubes 200k --runs 5
  union3d mill part.gcode --edge 3.175 --out part.i32 && union3d-bench engine --file part.i32 --edge 3175
  union3d-bench engine --workload rho-1 --turnovers 100
  union3d-bench engine --workload rho-1 --sizes 1M,20M
  union3d-bench engine --cubes 100k --bins tests/bench/bins.svg"
)]
pub(crate) struct Args {
    /// Cubes in the set.
    #[arg(long, value_name = "COUNT", default_value = "1M", value_parser = parse_count)]
    cubes: usize,
    /// Only these workloads [default: all of them, or the file alone].
    #[arg(long, value_enum, value_name = "NAME", value_delimiter = ',')]
    workload: Vec<Workload>,
    /// A file of cubes, as `union3d mill --out` writes it: all of them, whatever --cubes says.
    #[arg(long, value_name = "FILE", requires = "edge")]
    file: Option<PathBuf>,
    /// Edge of the cubes of the file, in steps.
    #[arg(long, value_name = "STEPS", requires = "file")]
    edge: Option<i64>,
    /// How often each measurement is made; the median is printed.
    #[arg(long, value_name = "COUNT", default_value = "3", value_parser = parse_count)]
    runs: usize,
    /// Where the random numbers begin.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Instead: replace the whole set so many times, oldest cube first, and compare each tenth with a fresh set.
    #[arg(long, value_name = "COUNT", value_parser = parse_count, conflicts_with_all = ["sizes", "bins", "runs"])]
    turnovers: Option<usize>,
    /// Instead: sets of these sizes, compared by time per operation.
    #[arg(long, value_name = "COUNTS", value_parser = parse_count, value_delimiter = ',', conflicts_with_all = ["cubes", "file", "bins"])]
    sizes: Vec<usize>,
    /// Instead: time against the side of the grid's bins over two decades, and its plot to this file, as SVG.
    #[arg(long, value_name = "FILE", conflicts_with = "file")]
    bins: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Runs `union3d-bench engine`.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let mut report = Report::new();
    let named = |default: &[Workload]| match args.workload.as_slice() {
        [] => default.to_vec(),
        some => some.to_vec(),
    };
    let bar = progress::work();
    if let Some(plot) = &args.bins {
        let workloads = named(&bins::WORKLOADS);
        report.push(bins::measure(
            &workloads, args.cubes, args.runs, args.seed, plot, &bar,
        )?);
    } else if !args.sizes.is_empty() {
        let workloads = named(&[Workload::Rho0015, Workload::Rho1]);
        report.push(flat::sizes(
            &workloads,
            &args.sizes,
            args.runs,
            args.seed,
            &bar,
        )?);
    } else {
        let workloads = match (&args.file, args.turnovers) {
            (Some(_), _) => args.workload.clone(),
            (None, Some(_)) => named(&[Workload::Rho1]),
            (None, None) => named(Workload::value_variants()),
        };
        let mut sources: Vec<Source> = workloads.into_iter().map(Source::Workload).collect();
        if let (Some(path), Some(edge)) = (&args.file, args.edge) {
            sources.push(Source::File(path, Edge::new(edge)?));
        }
        if let Some(turnovers) = args.turnovers {
            for source in sources {
                let scenario = source.scenario(args)?;
                report.push(flat::turnovers(&scenario, turnovers, &bar)?);
            }
        } else {
            tables(&mut report, &sources, args, &bar)?;
        }
    }
    bar.finish_and_clear();
    report.print(args.json)?;
    Ok(())
}

/// Where a scenario comes from; each is made when its turn comes, since all together take much memory.
enum Source<'args> {
    Workload(Workload),
    File(&'args Path, Edge),
}

impl Source<'_> {
    fn scenario(&self, args: &Args) -> Result<Scenario, Failure> {
        match *self {
            Self::Workload(workload) => Scenario::of(workload, args.cubes, args.seed),
            Self::File(path, edge) => Scenario::of_file(path, edge),
        }
    }
}

fn tables(
    report: &mut Report,
    sources: &[Source<'_>],
    args: &Args,
    bar: &ProgressBar,
) -> Result<(), Failure> {
    let mut single = Table::new(
        "One by one",
        "Million operations a second on one thread, and how long single ones take, in microseconds. `x bare` and `x hash map`: the time \
         as a multiple of that of the yardsticks. Bytes a cube: in the grid, and with its id. Medians.",
        [
            ("workload", "workload"),
            ("cubes", "cubes"),
            ("operation", "operation"),
            ("million_per_second", "M/s"),
            ("p50_us", "p50"),
            ("p99_us", "p99"),
            ("p999_us", "p99.9"),
            ("max_us", "max"),
            ("times_bare", "x bare"),
            ("times_hash_map", "x hash map"),
            ("grid_bytes_per_cube", "grid B"),
            ("bytes_per_cube", "all B"),
        ],
    );
    let batch_keys: Vec<[String; 2]> = BATCHES
        .iter()
        .flat_map(|batch| {
            ["insert", "delete"].map(|operation| {
                [
                    format!("{operation}_{batch}_million_per_second"),
                    format!("{operation} {}", short(*batch)),
                ]
            })
        })
        .collect();
    let mut batched = Table::new(
        "In batches",
        "Million cubes a second, by operation and cubes in a change (deletes oldest first). Medians.",
        [
            ("workload", "workload"),
            ("cubes", "cubes"),
            ("threads", "threads"),
        ]
        .into_iter()
        .chain(
            batch_keys
                .iter()
                .map(|[key, heading]| (key.as_str(), heading.as_str())),
        ),
    );
    for source in sources {
        let scenario = source.scenario(args)?;
        one_by_one(&scenario, args, &mut single, bar)?;
        in_batches(&scenario, args, &mut batched, bar)?;
    }
    report.push(single);
    report.push(batched);
    Ok(())
}

/// What is done to a set, in this order.
const OPERATIONS: [&str; 4] = ["insert", "delete oldest", "delete random", "replace"];

/// One run of the operations on one kind of set.
struct Run {
    latencies: [Latencies; 4],
    times: [Duration; 4],
}

impl Run {
    /// Seconds an operation.
    fn pace(&self, operation: usize) -> f64 {
        self.times[operation].as_secs_f64() / float(self.latencies[operation].len() as u64)
    }
}

/// Does all operations. `full` looks at the set when all cubes have been inserted, `moved` at the end.
fn operate<S: Set>(
    scenario: &Scenario,
    random_order: &[Cube],
    mut set: S,
    full: impl FnOnce(&S),
    moved: impl FnOnce(&S),
) -> Run {
    let cubes = &scenario.cubes;
    let insert = each(cubes.iter(), |cube| set.insert(*cube));
    full(&set);
    let oldest = each(cubes.iter(), |cube| set.delete(*cube));
    assert_eq!(set.len(), 0, "everything has been deleted");
    set.insert_all(cubes);
    let random = each(random_order.iter(), |cube| set.delete(*cube));
    assert_eq!(set.len(), 0, "everything has been deleted");
    set.insert_all(cubes);
    let replace = each(cubes.iter().zip(&scenario.following), |(oldest, newest)| {
        set.replace(*oldest, *newest);
    });
    moved(&set);
    let all = [insert, oldest, random, replace];
    Run {
        times: [0, 1, 2, 3].map(|operation: usize| all[operation].1),
        latencies: all.map(|(latencies, _)| latencies),
    }
}

fn one_by_one(
    scenario: &Scenario,
    args: &Args,
    table: &mut Table,
    bar: &ProgressBar,
) -> Result<(), String> {
    let expected = scenario.totals();
    let left = scenario.following.len();
    let at_end = scenario.cubes[left..].iter().chain(&scenario.following);
    let expected_at_end = recount(scenario.edge, None, at_end.map(|(_, place)| *place));
    let random_order = shuffled(&scenario.cubes, args.seed);
    let mut runs: [Vec<Run>; 3] = Default::default();
    let mut size = EngineSize { ids: 0, grid: 0 };
    for number in 1..=args.runs {
        bar.set_message(format!(
            "{}: one by one, run {number} of {}",
            scenario.name, args.runs
        ));
        let (mut found, mut found_at_end) = (Totals::default(), Totals::default());
        runs[0].push(operate(
            scenario,
            &random_order,
            Online::new(scenario.edge),
            |set| {
                found = set.engine.totals();
                size = set.engine.size();
            },
            |set| found_at_end = set.engine.totals(),
        ));
        if found != expected || found_at_end != expected_at_end {
            return Err(format!(
                "{}: cubes inserted one by one measure something else than those of a recount",
                scenario.name
            ));
        }
        let bare = Bare::new(scenario.edge);
        runs[1].push(operate(scenario, &random_order, bare, |_| (), |_| ()));
        let map = Plain::new();
        runs[2].push(operate(scenario, &random_order, map, |_| (), |_| ()));
    }
    let cubes = scenario.cubes.len();
    for (number, operation) in OPERATIONS.into_iter().enumerate() {
        let [engine, bare, map] =
            [0, 1, 2].map(|set: usize| median(runs[set].iter().map(|run: &Run| run.pace(number))));
        let spreads: Vec<Spread> = runs[0]
            .iter()
            .map(|run| run.latencies[number].clone().spread())
            .collect();
        let spread = Spread::median_of(&spreads);
        let per_cube = |bytes: usize| match number {
            0 => figure(float(bytes as u64) / float(cubes as u64)),
            _ => Cell::Nothing,
        };
        table.push(vec![
            text(scenario.name.as_str()),
            Cell::Count(cubes as u64),
            text(operation),
            figure(1e-6 / engine),
            figure(spread.p50),
            figure(spread.p99),
            figure(spread.p999),
            figure(spread.max),
            figure(engine / bare),
            figure(engine / map),
            per_cube(size.grid),
            per_cube(size.grid + size.ids),
        ]);
    }
    Ok(())
}

fn in_batches(
    scenario: &Scenario,
    args: &Args,
    table: &mut Table,
    bar: &ProgressBar,
) -> Result<(), Failure> {
    let expected = scenario.totals();
    for threads in THREADS {
        let mut cells = vec![
            text(scenario.name.as_str()),
            Cell::Count(scenario.cubes.len() as u64),
            Cell::Count(threads.get() as u64),
        ];
        for batch in BATCHES {
            let mut rates: [Vec<f64>; 2] = Default::default();
            for number in 1..=args.runs {
                bar.set_message(format!(
                    "{}: in batches of {batch}, threads {threads}, run {number} of {}",
                    scenario.name, args.runs
                ));
                let mut set = Online::threaded(scenario.edge, threads);
                let inserted = in_changes(&scenario.cubes, batch, |cubes| set.change(&[], cubes));
                let found = set.engine.totals();
                let deleted = in_changes(&scenario.cubes, batch, |cubes| set.change(cubes, &[]));
                if found != expected || set.engine.totals() != Totals::default() {
                    return Err(format!(
                        "{}: batches of {batch} on {threads} threads measure something else than single changes",
                        scenario.name
                    )
                    .into());
                }
                let cubes = scenario.cubes.len();
                rates[0].push(rate(cubes, inserted) / 1e6);
                rates[1].push(rate(cubes, deleted) / 1e6);
            }
            cells.extend(rates.map(|rates| figure(median(rates))));
        }
        table.push(cells);
    }
    Ok(())
}

/// Time for all cubes in changes of so many.
fn in_changes(cubes: &[Cube], batch: usize, mut change: impl FnMut(&[Cube])) -> Duration {
    let started = Instant::now();
    cubes.chunks(batch).for_each(&mut change);
    started.elapsed()
}
