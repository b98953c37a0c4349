//! What each line of a program did: volume, time, and what a machinist wants to hear of.

use std::io::Write;

use serde::Serialize;

/// Most lines of one kind that a report names; the rest are counted.
const LINES_MAX: usize = 100;

/// One line of the program, or a part of it. Units: steps cubed, steps squared, seconds.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Cut {
    /// Line of the program.
    pub(super) line: u64,
    /// Whether it is a rapid.
    pub(super) rapid: bool,
    /// Machine time; none when the program gives no feed.
    pub(super) duration: Option<f64>,
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
    /// Volume that feed moves of known duration removed.
    timed_removed: f64,
    timed_seconds: f64,
}

/// What `mill --json` says under `cutting`. Units: user units, seconds.
#[derive(Debug, Default, Serialize)]
pub(super) struct Cutting {
    /// Lines of the program that move the cutter.
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

/// A row of `--csv`. Units: user units, seconds.
#[derive(Debug, Serialize)]
struct Row {
    line: u64,
    motion: &'static str,
    cubes: u64,
    duration: Option<f64>,
    volume_removed: f64,
    removal_rate: Option<f64>,
    total_removed: f64,
    area: f64,
}

impl<'file> Tally<'file> {
    /// A tally in units of so many steps, which also writes each line to `csv`.
    pub(super) fn new(steps_per_unit: u32, csv: Option<Box<dyn Write + 'file>>) -> Self {
        Self {
            steps_per_unit: steps_per_unit.into(),
            csv: csv.map(csv::Writer::from_writer),
            open: None,
            cutting: Cutting::default(),
            timed_removed: 0.0,
            timed_seconds: 0.0,
        }
    }

    /// Takes the next line, or the next part of the same.
    pub(super) fn take(&mut self, cut: Cut) -> csv::Result<()> {
        if let Some(open) = &mut self.open
            && (open.line, open.rapid) == (cut.line, cut.rapid)
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
    pub(super) fn finish(mut self) -> csv::Result<Cutting> {
        if let Some(complete) = self.open.take() {
            self.close(&complete)?;
        }
        if let Some(csv) = &mut self.csv {
            csv.flush()?;
        }
        if self.timed_seconds > 0.0 {
            self.cutting.removal_rate.mean = Some(self.timed_removed / self.timed_seconds);
        }
        Ok(self.cutting)
    }

    fn close(&mut self, cut: &Cut) -> csv::Result<()> {
        let removed = self.volume(cut.removed);
        let rate = cut
            .duration
            .filter(|seconds| *seconds > 0.0)
            .map(|seconds| removed / seconds);
        let cutting = &mut self.cutting;
        cutting.lines += 1;
        cutting.machine_seconds += cut.duration.unwrap_or(0.0);
        cutting.volume_removed += removed;
        if cut.rapid {
            if cut.removed > 0 {
                let RapidCuts {
                    count,
                    volume,
                    lines,
                } = &mut cutting.rapid_cuts;
                *count += 1;
                *volume += removed;
                if lines.len() < LINES_MAX {
                    lines.push(RapidCut {
                        line: cut.line,
                        volume: removed,
                    });
                }
            }
        } else {
            if cut.removed == 0 {
                let AirCuts { count, lines } = &mut cutting.air_cuts;
                *count += 1;
                if lines.len() < LINES_MAX {
                    lines.push(cut.line);
                }
            }
            let most = &mut cutting.removal_rate;
            if let Some(rate) = rate {
                self.timed_removed += removed;
                self.timed_seconds += cut.duration.unwrap_or(0.0);
                if most.peak.is_none_or(|peak| rate > peak) {
                    (most.peak, most.peak_line) = (Some(rate), Some(cut.line));
                }
            }
        }
        let row = Row {
            line: cut.line,
            motion: if cut.rapid { "rapid" } else { "feed" },
            cubes: cut.cubes,
            duration: cut.duration,
            volume_removed: removed,
            removal_rate: rate,
            total_removed: self.volume(cut.total_removed),
            area: float(cut.area) / self.steps_per_unit.powi(2),
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
