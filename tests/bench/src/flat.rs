//! Whether time and memory stay flat: as a set is replaced again and again, and as it grows.

use std::time::Instant;

use indicatif::ProgressBar;
use union3d::engine::EngineSize;
use union3d::geometry::{CubeId, Totals};

use super::failure::Failure;
use super::figures::{Spread, float, median, short};
use super::scenario::Scenario;
use super::sets::{Cube, Online, Set, each};
use super::table::{Cell, Table, figure, text};
use super::workload::Workload;

/// Replaces the whole set so many times, oldest cube first, each by one at the same place with a new id; a row for each tenth.
pub(super) fn turnovers(
    scenario: &Scenario,
    turnovers: usize,
    bar: &ProgressBar,
) -> Result<Table, String> {
    let expected = scenario.totals();
    let count = scenario.cubes.len();
    let cubes_of = |turnover: usize| -> Vec<Cube> {
        let ids = (turnover as u64 * count as u64..).map(CubeId);
        let places = scenario.cubes.iter().map(|(_, place)| *place);
        ids.zip(places).collect()
    };
    let name = &scenario.name;
    let mut table = Table::new(
        format!("{name}: {} cubes replaced {turnovers} times", short(count)),
        "Every cube is deleted, oldest first, and inserted again with a new id. Million operations a second; latencies in microseconds; \
         `fresh` is a new set of the \
         cubes of the last turnover, its memory before and its times in one more turnover. All totals are equal.",
        [
            ("turnovers", "turnovers"),
            ("delete_million_per_second", "delete M/s"),
            ("delete_p99_us", "delete p99"),
            ("delete_p999_us", "delete p99.9"),
            ("insert_million_per_second", "insert M/s"),
            ("insert_p99_us", "insert p99"),
            ("insert_p999_us", "insert p99.9"),
            ("grid_bytes_per_cube", "grid B"),
            ("bytes_per_cube", "all B"),
        ],
    );
    let mut set = Online::new(scenario.edge);
    set.insert_all(&scenario.cubes);
    // A row for each tenth, or for each turnover when there are fewer.
    let rows = turnovers.min(10);
    for row in 0..rows {
        let (first, end) = (row * turnovers / rows, (row + 1) * turnovers / rows);
        let mut times = Times::default();
        for turnover in first..end {
            bar.set_message(format!("{name}: turnover {} of {turnovers}", turnover + 1));
            times.turn_over(&mut set, &cubes_of(turnover), &cubes_of(turnover + 1));
        }
        let label = format!("{} to {end}", first + 1);
        table.push(times.row(label, set.engine.size(), count));
        if set.engine.totals() != expected {
            return Err(format!("{name}: after {end} turnovers the totals differ"));
        }
    }
    bar.set_message(format!("{name}: fresh"));
    let mut fresh = Online::new(scenario.edge);
    let cubes = cubes_of(turnovers);
    fresh.insert_all(&cubes);
    let size = fresh.engine.size();
    if fresh.engine.totals() != expected {
        return Err(format!("{name}: a fresh set has other totals"));
    }
    let mut times = Times::default();
    times.turn_over(&mut fresh, &cubes, &cubes_of(turnovers + 1));
    table.push(times.row("fresh".to_owned(), size, count));
    Ok(table)
}

/// Seconds an operation and latencies, of deletes and of inserts, a block of operations each.
#[derive(Default)]
struct Times {
    paces: [Vec<f64>; 2],
    spreads: [Vec<Spread>; 2],
}

impl Times {
    /// Deletes and inserts alternate in blocks, so that the set stays nearly full and each kind has its own times.
    fn turn_over(&mut self, set: &mut Online, before: &[Cube], after: &[Cube]) {
        let block = (before.len() / 100).max(1);
        for (old, new) in before.chunks(block).zip(after.chunks(block)) {
            let delete = each(old.iter(), |cube| set.delete(*cube));
            let insert = each(new.iter(), |cube| set.insert(*cube));
            for (kind, (latencies, time)) in [delete, insert].into_iter().enumerate() {
                self.paces[kind].push(time.as_secs_f64() / float(latencies.len() as u64));
                self.spreads[kind].push(latencies.spread());
            }
        }
    }

    fn row(self, label: String, size: EngineSize, cubes: usize) -> Vec<Cell> {
        let mut cells = vec![text(label)];
        for (paces, spreads) in self.paces.into_iter().zip(self.spreads) {
            let spread = Spread::median_of(&spreads);
            cells.extend([
                figure(1e-6 / median(paces)),
                figure(spread.p99),
                figure(spread.p999),
            ]);
        }
        let bytes = [size.grid, size.grid + size.ids];
        cells.extend(bytes.map(|bytes| figure(float(bytes as u64) / float(cubes as u64))));
        cells
    }
}

/// Sets of several sizes at the same density.
pub(super) fn sizes(
    workloads: &[Workload],
    sizes: &[usize],
    runs: usize,
    seed: u64,
    bar: &ProgressBar,
) -> Result<Table, Failure> {
    let mut table = Table::new(
        "Over the number of cubes",
        "Nanoseconds an operation, one by one, at the same density, and as a multiple of the first size's. Medians.",
        [
            ("workload", "workload"),
            ("cubes", "cubes"),
            ("insert_ns", "insert ns"),
            ("insert_times_first", "x first"),
            ("delete_ns", "delete oldest ns"),
            ("delete_times_first", "x first"),
            ("grid_bytes_per_cube", "grid B"),
            ("bytes_per_cube", "all B"),
        ],
    );
    for &workload in workloads {
        let mut first = None;
        for &size in sizes {
            let scenario = Scenario::of(workload, size, seed)?;
            let mut paces: [Vec<f64>; 2] = Default::default();
            let mut bytes = [0.0; 2];
            for run in 1..=runs {
                let name = &scenario.name;
                bar.set_message(format!(
                    "{name}: {} cubes, run {run} of {runs}",
                    short(size)
                ));
                let mut set = Online::new(scenario.edge);
                let count = float(scenario.cubes.len() as u64);
                let started = Instant::now();
                set.insert_all(&scenario.cubes);
                paces[0].push(started.elapsed().as_secs_f64() / count);
                let size = set.engine.size();
                bytes = [size.grid, size.grid + size.ids].map(|bytes| float(bytes as u64) / count);
                if run == 1 && set.engine.totals() != scenario.totals() {
                    return Err(format!("{name}: a recount gives other totals").into());
                }
                let started = Instant::now();
                set.delete_all(&scenario.cubes);
                paces[1].push(started.elapsed().as_secs_f64() / count);
                if set.engine.totals() != Totals::default() {
                    return Err(format!("{name}: something is left when all is deleted").into());
                }
            }
            let [insert, delete] = paces.map(median);
            let (first_insert, first_delete) = *first.get_or_insert((insert, delete));
            table.push(vec![
                text(scenario.name.as_str()),
                Cell::Count(scenario.cubes.len() as u64),
                figure(insert * 1e9),
                figure(insert / first_insert),
                figure(delete * 1e9),
                figure(delete / first_delete),
                figure(bytes[0]),
                figure(bytes[1]),
            ]);
        }
    }
    Ok(table)
}
