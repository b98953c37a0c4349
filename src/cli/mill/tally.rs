//! What each line of a program did: volume, time, and what a machinist wants to hear of.

use std::collections::BTreeMap;
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

/// One line of the program, or a part of it. Volumes and areas are in the units of [`Scale`].
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Cut {
    /// Line of the program.
    pub(super) line: u64,
    /// What the cutter does on it.
    pub(super) kind: Kind,
    /// Machine time; none when the program gives no feed.
    pub(super) duration: Option<Duration>,
    /// Cubes or solids it put down.
    pub(super) bodies: u64,
    /// Volume it removed.
    pub(super) removed: i128,
    /// Volume removed since the scene was empty.
    pub(super) total_removed: i128,
    /// Area of the union.
    pub(super) area: i128,
    /// What is known where tools have shapes.
    pub(super) tool: Option<ToolCut>,
}

/// What a tool with a shape did on a line.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct ToolCut {
    /// Its number.
    pub(super) number: u32,
    /// Volume of the material that its shank or its holder went through; none where that is not known.
    pub(super) hit: Option<i128>,
    /// Its area of contact: of the surface that its flutes leave where they remove material; none where that is not known.
    pub(super) contact: Option<i128>,
}

/// What makes user units of a scene's integers, and what is too little to be said.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scale {
    /// Units of volume in a user unit cubed.
    pub(super) volume: f64,
    /// Units of area in a user unit squared.
    pub(super) area: f64,
    /// Volumes up to this are no hit, and feed lines that remove no more cut air. Units: user units cubed.
    pub(super) least_volume: f64,
}

impl Scale {
    /// Of a scene of cubes.
    pub(super) fn of_cubes(steps_per_unit: u32, least_volume: f64) -> Self {
        let steps = f64::from(steps_per_unit);
        Self {
            volume: steps.powi(3),
            area: steps.powi(2),
            least_volume,
        }
    }

    fn volume(&self, units: i128) -> f64 {
        float(units) / self.volume
    }

    fn area(&self, units: i128) -> f64 {
        float(units) / self.area
    }

    /// Whether a volume is worth a word.
    fn counts(&self, units: i128) -> bool {
        units > 0 && self.volume(units) > self.least_volume
    }
}

/// Adds lines up, and writes them to a file if one is wanted.
pub(super) struct Tally<'file> {
    scale: Scale,
    csv: Option<csv::Writer<Box<dyn Write + 'file>>>,
    /// The line that is not complete yet.
    open: Option<Cut>,
    cutting: Cutting,
    sums: Sums,
    tools: BTreeMap<u32, ToolSums>,
    /// Whether all hits of shanks and holders are known.
    knows_hits: bool,
}

/// What one tool did.
#[derive(Default)]
struct ToolSums {
    lines: u64,
    removed: i128,
    time: Duration,
}

/// What is added up in integers, and becomes user units once.
#[derive(Default)]
struct Sums {
    removed: i128,
    removed_by_rapids: i128,
    hit: i128,
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
    /// The most area of contact that a feed line has of which it is known, and which; left out where it is known of none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) contact_area: Option<ContactArea>,
    /// Feed moves that removed nothing.
    pub(super) air_cuts: AirCuts,
    /// Rapids that removed something.
    pub(super) rapid_cuts: RapidCuts,
    /// Lines on which the shank or the holder of a tool goes through material; left out where that is not known of all lines.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) shank_or_holder: Option<RapidCuts>,
    /// Totals by tool, where tools have shapes.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) tools: Vec<ToolTotals>,
}

#[derive(Debug, Serialize)]
pub(super) struct ToolTotals {
    pub(super) tool: u32,
    /// Lines that take machine time.
    pub(super) lines: u64,
    pub(super) machine_seconds: f64,
    pub(super) volume_removed: f64,
}

#[derive(Debug, Default, Serialize)]
pub(super) struct RemovalRate {
    pub(super) mean: Option<f64>,
    pub(super) peak: Option<f64>,
    pub(super) peak_line: Option<u64>,
}

#[derive(Debug, Serialize)]
pub(super) struct ContactArea {
    pub(super) peak: f64,
    pub(super) peak_line: u64,
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

/// The columns of `--csv`, of cubes and of solids.
const COLUMNS: [&str; 9] = [
    "line",
    "motion",
    "cubes",
    "duration",
    "volume_removed",
    "removal_rate",
    "total_removed",
    "area",
    "warning",
];
const COLUMNS_OF_SOLIDS: [&str; 12] = [
    "line",
    "motion",
    "solids",
    "duration",
    "volume_removed",
    "removal_rate",
    "total_removed",
    "area",
    "warning",
    "tool",
    "shank_or_holder",
    "contact_area",
];

/// A row of `--csv`: a line of the program, or after them all a warning. Units: user units, seconds.
#[derive(Debug, Default, Serialize)]
struct Row {
    line: u64,
    motion: &'static str,
    bodies: Option<u64>,
    duration: Option<f64>,
    volume_removed: Option<f64>,
    removal_rate: Option<f64>,
    total_removed: Option<f64>,
    area: Option<f64>,
    warning: Option<String>,
    /// Of solids only: the tool, the volume that its shank or its holder hits, and its area of contact.
    #[serde(skip_serializing_if = "Option::is_none")]
    tool: Option<(Option<u32>, Option<f64>, Option<f64>)>,
}

impl<'file> Tally<'file> {
    /// A tally of cubes, which also writes each line to `csv`.
    pub(super) fn of_cubes(scale: Scale, csv: Option<Box<dyn Write + 'file>>) -> csv::Result<Self> {
        Self::new(scale, csv, &COLUMNS)
    }

    /// A tally of solids.
    pub(super) fn of_solids(
        scale: Scale,
        csv: Option<Box<dyn Write + 'file>>,
    ) -> csv::Result<Self> {
        let mut this = Self::new(scale, csv, &COLUMNS_OF_SOLIDS)?;
        this.cutting.shank_or_holder = Some(RapidCuts::default());
        Ok(this)
    }

    fn new(
        scale: Scale,
        csv: Option<Box<dyn Write + 'file>>,
        columns: &[&str],
    ) -> csv::Result<Self> {
        let csv = match csv {
            Some(file) => {
                let mut csv = csv::WriterBuilder::new()
                    .has_headers(false)
                    .from_writer(file);
                csv.write_record(columns)?;
                Some(csv)
            }
            None => None,
        };
        Ok(Self {
            scale,
            csv,
            open: None,
            cutting: Cutting::default(),
            sums: Sums::default(),
            tools: BTreeMap::new(),
            knows_hits: true,
        })
    }

    /// Whether this is one of solids.
    fn is_of_solids(&self) -> bool {
        self.cutting.shank_or_holder.is_some()
    }

    /// Whether it is known of all lines what shanks and holders have hit.
    pub(super) fn knows_hits(&self) -> bool {
        self.knows_hits
    }

    /// Adds the next line, or the next part of the same.
    pub(super) fn add(&mut self, cut: Cut) -> csv::Result<()> {
        self.knows_hits &= cut.tool.is_none_or(|tool| tool.hit.is_some());
        if let Some(open) = &mut self.open
            && open.line == cut.line
            && (open.kind == cut.kind || [open.kind, cut.kind].contains(&Kind::Dwell))
            && open.tool.map(|tool| tool.number) == cut.tool.map(|tool| tool.number)
        {
            // A dwell belongs to the move that its line has, too.
            if open.kind == Kind::Dwell {
                open.kind = cut.kind;
            }
            open.bodies += cut.bodies;
            if let (Some(open), Some(tool)) = (&mut open.tool, cut.tool) {
                let sum = |(one, other)| one + other;
                open.hit = open.hit.zip(tool.hit).map(sum);
                open.contact = open.contact.zip(tool.contact).map(sum);
            }
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
        let no_tool = self.is_of_solids().then_some((None, None, None));
        if let Some(csv) = &mut self.csv {
            for warning in warnings {
                csv.serialize(Row {
                    line: warning.line,
                    motion: "warning",
                    warning: Some(format!("{} {}", warning.code, warning.text)),
                    tool: no_tool,
                    ..Row::default()
                })?;
            }
            csv.flush()?;
        }
        let volume = |units| self.scale.volume(units);
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
        // Half of them would read as all of them.
        cutting.shank_or_holder = cutting.shank_or_holder.filter(|_| self.knows_hits);
        if let Some(hits) = &mut cutting.shank_or_holder {
            hits.volume = volume(self.sums.hit);
        }
        let totals = |(&tool, sums): (&u32, &ToolSums)| ToolTotals {
            tool,
            lines: sums.lines,
            machine_seconds: sums.time.as_secs_f64(),
            volume_removed: volume(sums.removed),
        };
        cutting.tools = self.tools.iter().map(totals).collect();
        Ok(cutting)
    }

    fn close(&mut self, cut: &Cut) -> csv::Result<()> {
        let scale = self.scale;
        let removed = scale.volume(cut.removed);
        let duration = cut.duration.unwrap_or_default();
        let rate = (!duration.is_zero()).then(|| removed / duration.as_secs_f64());
        let (cutting, sums) = (&mut self.cutting, &mut self.sums);
        cutting.lines += 1;
        sums.machine_time += duration;
        sums.removed += cut.removed;
        match cut.kind {
            Kind::Rapid if scale.counts(cut.removed) => {
                cutting.rapid_cuts.count += 1;
                sums.removed_by_rapids += cut.removed;
                cutting.rapid_cuts.lines.push(RapidCut {
                    line: cut.line,
                    volume: removed,
                });
            }
            Kind::Feed => {
                if !scale.counts(cut.removed) {
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
        if let Some(tool) = cut.tool {
            if let Some(contact) = tool.contact.filter(|_| cut.kind == Kind::Feed) {
                let area = scale.area(contact);
                let most = &mut cutting.contact_area;
                if most.as_ref().is_none_or(|most| area > most.peak) {
                    *most = Some(ContactArea {
                        peak: area,
                        peak_line: cut.line,
                    });
                }
            }
            let own = self.tools.entry(tool.number).or_default();
            own.lines += 1;
            own.removed += cut.removed;
            own.time += duration;
            if let Some(hits) = &mut cutting.shank_or_holder
                && let Some(hit) = tool.hit.filter(|hit| scale.counts(*hit))
            {
                hits.count += 1;
                sums.hit += hit;
                hits.lines.push(RapidCut {
                    line: cut.line,
                    volume: scale.volume(hit),
                });
            }
        }
        let row = Row {
            line: cut.line,
            motion: match cut.kind {
                Kind::Feed => "feed",
                Kind::Rapid => "rapid",
                Kind::Dwell => "dwell",
            },
            bodies: Some(cut.bodies),
            duration: cut.duration.map(|duration| duration.as_secs_f64()),
            volume_removed: Some(removed),
            removal_rate: rate,
            total_removed: Some(scale.volume(cut.total_removed)),
            area: Some(scale.area(cut.area)),
            warning: None,
            tool: cut.tool.map(|tool| {
                (
                    Some(tool.number),
                    tool.hit.map(|hit| scale.volume(hit)),
                    tool.contact.map(|contact| scale.area(contact)),
                )
            }),
        };
        match &mut self.csv {
            Some(csv) => csv.serialize(row),
            None => Ok(()),
        }
    }
}

#[expect(
    clippy::cast_precision_loss,
    reason = "for people; the exact numbers are in the mass properties"
)]
fn float(integer: i128) -> f64 {
    integer as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where it is not known of a line what the shank and the holder hit, its cell is empty, and there is no list of hits that would look whole.
    #[test]
    fn hits_that_are_not_known_are_left_out() {
        for last in [Some(96), None] {
            let mut rows = Vec::new();
            let scale = Scale {
                volume: 96.0,
                area: 2.0,
                least_volume: 0.0,
            };
            let mut tally = Tally::of_solids(scale, Some(Box::new(&mut rows))).unwrap();
            for (line, hit) in [(1, Some(192)), (2, last)] {
                let tool = Some(ToolCut {
                    number: 1,
                    hit,
                    contact: None,
                });
                let cut = Cut {
                    line,
                    kind: Kind::Feed,
                    duration: None,
                    bodies: 1,
                    removed: 96,
                    total_removed: 96,
                    area: 2,
                    tool,
                };
                tally.add(cut).unwrap();
            }
            assert_eq!(tally.knows_hits(), last.is_some());
            let cutting = tally.finish(&[]).unwrap();
            let volume = cutting.shank_or_holder.map(|hits| hits.volume);
            assert_eq!(volume, last.map(|_| 3.0));
            let rows = String::from_utf8(rows).unwrap();
            let cell = if last.is_some() { "1,1.0," } else { "1,," };
            assert!(rows.lines().nth(1).unwrap().ends_with(",1,2.0,"), "{rows}");
            assert!(rows.lines().nth(2).unwrap().ends_with(cell), "{rows}");
        }
    }
}
