//! Time against the side of the grid's bins, as Table 2 of UNION3's paper has it: a wide range of sides does as well as the best.

use std::path::Path;
use std::time::Instant;

use indicatif::ProgressBar;
use union3d::engine::Engine;
use union3d::geometry::Totals;

use super::failure::{Failure, about};
use super::figures::{float, median};
use super::plot::{Line, Plot};
use super::scenario::Scenario;
use super::sets::{Online, Set};
use super::table::{Cell, Table, figure, text};
use super::workload::Workload;

/// What is measured when nothing is named.
pub(super) const WORKLOADS: [Workload; 4] = [
    Workload::Rho03,
    Workload::Rho1,
    Workload::Rho10,
    Workload::Raster,
];

/// Sides of the bins, as powers of two: from a third of an edge of 6,000 steps to 44 edges.
const SHIFTS: std::ops::RangeInclusive<u32> = 11..=18;

/// Measures and plots.
pub(super) fn measure(
    workloads: &[Workload],
    cubes: usize,
    runs: usize,
    seed: u64,
    plot: &Path,
    bar: &ProgressBar,
) -> Result<Table, Failure> {
    let mut table = Table::new(
        "Time against the side of the bins",
        "Microseconds to insert a cube and delete it again (everything inserted, then everything deleted, oldest first), by the side of the \
         grid's bins in edges; `own` is the engine's own choice, which follows the data. Medians.",
        [
            ("workload", "workload"),
            ("cubes", "cubes"),
            ("bin_side_in_edges", "bin side"),
            ("insert_and_delete_us", "insert and delete us"),
            ("times_own_choice", "x own"),
        ],
    );
    let mut lines = Vec::new();
    for &workload in workloads {
        let scenario = Scenario::of(workload, cubes, seed)?;
        let expected = scenario.totals();
        let settings: Vec<Option<u32>> = [None].into_iter().chain(SHIFTS.map(Some)).collect();
        let mut paces = vec![Vec::new(); settings.len()];
        // One after the other in each run, so that a machine that slows down meanwhile slows all of them.
        for run in 1..=runs {
            for (shift, paces) in settings.iter().zip(&mut paces) {
                let name = &scenario.name;
                let bins =
                    shift.map_or("own bins".to_owned(), |shift| format!("bins of 2^{shift}"));
                bar.set_message(format!("{name}: {bins}, run {run} of {runs}"));
                let mut set = Online::with(match shift {
                    Some(shift) => Engine::with_bins(scenario.edge, *shift),
                    None => Engine::new(scenario.edge),
                });
                let started = Instant::now();
                set.insert_all(&scenario.cubes);
                let inserted = started.elapsed();
                let found = set.engine.totals();
                let started = Instant::now();
                set.delete_all(&scenario.cubes);
                let time = inserted + started.elapsed();
                if found != expected || set.engine.totals() != Totals::default() {
                    return Err(format!("{name}: {bins} give other totals").into());
                }
                paces.push(time.as_secs_f64() * 1e6 / float(scenario.cubes.len() as u64));
            }
        }
        let mut paces = paces.into_iter().map(median);
        let own = paces.next().expect("its own bins come first");
        let mut push = |side: Cell, pace: f64| {
            table.push(vec![
                text(scenario.name.as_str()),
                Cell::Count(scenario.cubes.len() as u64),
                side,
                figure(pace),
                figure(pace / own),
            ]);
        };
        push(text("own"), own);
        let mut points = Vec::new();
        for (shift, pace) in SHIFTS.zip(paces) {
            let side = f64::from(1_u32 << shift) / f64::from(scenario.edge.steps());
            push(text(format!("{side:.2}")), pace);
            points.push([side, pace]);
        }
        lines.push(Line {
            name: scenario.name.clone(),
            points,
            level: own,
        });
    }
    let drawn = Plot {
        title: "Time against the side of the bins (dashed: the engine's own choice)".to_owned(),
        x: "side of a bin, in edges of a cube",
        y: "microseconds to insert a cube and delete it",
        lines,
    };
    std::fs::write(plot, drawn.svg()?).map_err(about(plot))?;
    Ok(table)
}
