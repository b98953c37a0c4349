//! What each line of a program did: volume, time, and what a machinist wants to hear of.

use std::io::Write;
use std::time::Duration;

use serde::Serialize;

use union3d::toolpath::Warning;

/// What the cutter does on a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Kind {
    Feed,
    Rapid,
    /// It stays where it is.
    Dwell,
}

/// One line of the program, or a part of it. Units: steps cubed, steps squared.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Cut {
    /// Line of the program.
    pub(super) line: u64,
    /// What the cutter does on it.
    pub(super) kind: Kind,
    /// Machine time; none when the program gives no feed.
    pub(super) duration: Option<Duration>,
    /// Cubes it put down.
    pub(super) cubes: u64,
    /// Volume it removed.
    pub(super) removed: i128,
    /// Volume removed since the scene was empty.
    pub(super) total_removed: i128,
    /// Area of the union.
    pub(super) area: i128,
}

/// Adds lines up, and writes them to a file if one is wanted.
pub(super) struct Tally<'file> {
    steps_per_unit: f64,
    csv: Option<csv::Writer<Box<dyn Write + 'file>>>,
    /// The line that is not complete yet.
    open: Option<Cut>,
    cutting: Cutting,
    sums: Sums,
}

/// What is added up in integers, and becomes user units once. Units: steps cubed.
#[derive(Default)]
struct Sums {
    removed: i128,
    removed_by_rapids: i128,
    /// What feed moves of known duration removed.
    removed_timed: i128,
    timed: Duration,
    machine_time: Duration,
}

/// What `mill --json` says under `cutting`. Units: user units, seconds.
#[derive(Debug, Default, Serialize)]
pub(super) struct Cutting {
    /// Lines of the program that take machine time: moves and dwells.
    pub(super) lines: u64,
    /// Machine time of the moves whose time is known.
    pub(super) machine_seconds: f64,
    /// Volume removed by all of them.
    pub(super) volume_removed: f64,
    /// Volume a second of feed moves: mean, and the most a line has, and which.
    pub(super) removal_rate: RemovalRate,
    /// Feed moves that removed nothing.
    pub(super) air_cuts: AirCuts,
    /// Rapids that removed something.
    pub(super) rapid_cuts: RapidCuts,
}

#[derive(Debug, Default, Serialize)]
pub(super) struct RemovalRate {
    pub(super) mean: Option<f64>,
    pub(super) peak: Option<f64>,
    pub(super) peak_line: Option<u64>,
}

#[derive(Debug, Default, Serialize)]
pub(super) struct AirCuts {
    pub(super) count: u64,
    pub(super) lines: Vec<u64>,
}

#[derive(Debug, Default, Serialize)]
pub(super) struct RapidCuts {
    pub(super) count: u64,
    pub(super) volume: f64,
    pub(super) lines: Vec<RapidCut>,
}

#[derive(Debug, Serialize)]
pub(super) struct RapidCut {
    pub(super) line: u64,
    pub(super) volume: f64,
}

/// A row of `--csv`: a line of the program, or after them all a warning. Units: user units, seconds.
#[derive(Debug, Default, Serialize)]
struct Row {
    line: u64,
    motion: &'static str,
    cubes: Option<u64>,
    duration: Option<f64>,
    volume_removed: Option<f64>,
    removal_rate: Option<f64>,
    total_removed: Option<f64>,
    area: Option<f64>,
    warning: Option<String>,
}

impl<'file> Tally<'file> {
    /// A tally in units of so many steps, which also writes each line to `csv`.
    pub(super) fn new(steps_per_unit: u32, csv: Option<Box<dyn Write + 'file>>) -> Self {
        Self {
            steps_per_unit: steps_per_unit.into(),
            csv: csv.map(csv::Writer::from_writer),
            open: None,
            cutting: Cutting::default(),
            sums: Sums::default(),
        }
    }

    /// Adds the next line, or the next part of the same.
    pub(super) fn add(&mut self, cut: Cut) -> csv::Result<()> {
        if let Some(open) = &mut self.open
            && (open.line, open.kind) == (cut.line, cut.kind)
        {
            open.cubes += cut.cubes;
            open.removed += cut.removed;
            open.duration = match (open.duration, cut.duration) {
                (Some(one), Some(other)) => Some(one + other),
                (one, other) => one.or(other),
            };
            (open.total_removed, open.area) = (cut.total_removed, cut.area);
            return Ok(());
        }
        match self.open.replace(cut) {
            Some(complete) => self.close(&complete),
            None => Ok(()),
        }
    }

    /// What all lines did.
    pub(super) fn finish(mut self, warnings: &[Warning]) -> csv::Result<Cutting> {
        if let Some(complete) = self.open.take() {
            self.close(&complete)?;
        }
        if let Some(csv) = &mut self.csv {
            for warning in warnings {
                csv.serialize(Row {
                    line: warning.line,
                    motion: "warning",
                    warning: Some(format!("{} {}", warning.code, warning.text)),
                    ..Row::default()
                })?;
            }
            csv.flush()?;
        }
        let volume = |steps3| self.volume(steps3);
        let (removed, by_rapids) = (
            volume(self.sums.removed),
            volume(self.sums.removed_by_rapids),
        );
        let timed = self.sums.timed.as_secs_f64();
        let mean = (timed > 0.0).then(|| volume(self.sums.removed_timed) / timed);
        let mut cutting = self.cutting;
        cutting.machine_seconds = self.sums.machine_time.as_secs_f64();
        cutting.volume_removed = removed;
        cutting.rapid_cuts.volume = by_rapids;
        cutting.removal_rate.mean = mean;
        Ok(cutting)
    }

    fn close(&mut self, cut: &Cut) -> csv::Result<()> {
        let removed = self.volume(cut.removed);
        let duration = cut.duration.unwrap_or_default();
        let rate = (!duration.is_zero()).then(|| removed / duration.as_secs_f64());
        let (cutting, sums) = (&mut self.cutting, &mut self.sums);
        cutting.lines += 1;
        sums.machine_time += duration;
        sums.removed += cut.removed;
        match cut.kind {
            Kind::Rapid if cut.removed > 0 => {
                cutting.rapid_cuts.count += 1;
                sums.removed_by_rapids += cut.removed;
                cutting.rapid_cuts.lines.push(RapidCut {
                    line: cut.line,
                    volume: removed,
                });
            }
            Kind::Feed => {
                if cut.removed == 0 {
                    cutting.air_cuts.count += 1;
                    cutting.air_cuts.lines.push(cut.line);
                }
                if let Some(rate) = rate {
                    sums.removed_timed += cut.removed;
                    sums.timed += duration;
                    let most = &mut cutting.removal_rate;
                    if most.peak.is_none_or(|peak| rate > peak) {
                        (most.peak, most.peak_line) = (Some(rate), Some(cut.line));
                    }
                }
            }
            Kind::Rapid | Kind::Dwell => {}
        }
        let row = Row {
            line: cut.line,
            motion: match cut.kind {
                Kind::Feed => "feed",
                Kind::Rapid => "rapid",
                Kind::Dwell => "dwell",
            },
            cubes: Some(cut.cubes),
            duration: cut.duration.map(|duration| duration.as_secs_f64()),
            volume_removed: Some(removed),
            removal_rate: rate,
            total_removed: Some(self.volume(cut.total_removed)),
            area: Some(float(cut.area) / self.steps_per_unit.powi(2)),
            warning: None,
        };
        match &mut self.csv {
            Some(csv) => csv.serialize(row),
            None => Ok(()),
        }
    }

    fn volume(&self, steps3: i128) -> f64 {
        float(steps3) / self.steps_per_unit.powi(3)
    }
}

#[expect(
    clippy::cast_precision_loss,
    reason = "for people; the exact numbers are in the mass properties"
)]
fn float(integer: i128) -> f64 {
    integer as f64
}
