//! `union3d path`: the motions a program makes, one a row.

use std::io::{BufWriter, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::ValueEnum;
use serde::Serialize;

use super::Outcome;
use super::cutter::Unit;
use super::program::ProgramArgs;
use union3d::toolpath::{Event, Motion, Move, words_table};

/// Speed of rapids when --rapid-rate is not given. Units: mm a minute.
pub(crate) const RAPID_RATE_MM: f64 = 5000.0;

/// Print the motions of a G-code program
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Reads G-code and prints what the tip of the tool does, one motion a row: where it goes, how, with which tool, and how long that takes.

Columns: line (of the program; of the call while a file it calls is run), tool (the number in the spindle, 0 before the first), \
motion (rapid, feed, arc or dwell), to (x, y, z), and of arcs center (x, y, z, level with the start), normal (the plane: xy, zx or yz) \
and turns (1 up to a full circle, 2 up to two; clockwise negative), feed in mm a minute, seconds. Lengths are millimetres in the frame of the first work \
system used. A coordinate the program has not said, or that a return to an unknown reference point made unknown, is null (empty in CSV). \
CSV has three columns each for to and center.

The path is right, or the program is refused at its line, and the status is 1. What was taken for granted or not done is said on \
standard error. `union3d path --words` prints which words are understood, harmless, reported or refused, by dialect.",
    after_long_help = "Examples:
  union3d path part.ngc
  union3d path part.ngc --tools tool.tbl --format csv
  union3d path part.nc --dialect fanuc --home 0,0,300
  union3d path --words"
)]
pub(crate) struct Args {
    /// The program; - is standard input.
    #[arg(required_unless_present = "words")]
    file: Option<PathBuf>,
    /// How rows are written.
    #[arg(long, value_name = "FORMAT", value_enum, default_value_t = Format::Ndjson)]
    format: Format,
    /// Speed of rapids, in mm a minute.
    #[arg(long, value_name = "RATE", value_parser = super::cutter::positive, default_value_t = RAPID_RATE_MM)]
    rapid_rate: f64,
    /// Print the table of words by dialect, as Markdown.
    #[arg(long, exclusive = true)]
    words: bool,
    #[command(flatten)]
    program: ProgramArgs,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Format {
    Csv,
    Ndjson,
}

/// A motion. What does not apply is left out of JSON and empty in CSV.
#[derive(Debug, Serialize)]
struct Row {
    line: u64,
    tool: u32,
    motion: &'static str,
    to: [Option<f64>; 3],
    #[serde(flatten)]
    arc: Option<ArcColumns>,
    #[serde(skip_serializing_if = "Option::is_none")]
    feed: Option<f64>,
    seconds: Option<f64>,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct ArcColumns {
    center: [f64; 3],
    normal: &'static str,
    turns: i32,
}

const HEADER: [&str; 13] = [
    "line", "tool", "motion", "x", "y", "z", "center_x", "center_y", "center_z", "normal", "turns",
    "feed", "seconds",
];

impl Row {
    fn of(next: &Move, rapid_rate: f64) -> Self {
        let arc = || {
            Some(ArcColumns {
                center: next.center()?.map(tidy),
                normal: next.plane()?.name(),
                turns: next.turns()?,
            })
        };
        let to = [0, 1, 2].map(|axis| next.end_known[axis].then(|| tidy(next.end[axis])));
        Self {
            line: next.line,
            tool: next.tool,
            motion: match next.motion {
                Motion::Rapid => "rapid",
                Motion::Feed => "feed",
                Motion::Arc => "arc",
            },
            to,
            arc: arc(),
            feed: next.feed.map(tidy),
            seconds: seconds(next, rapid_rate).map(tidy),
        }
    }

    /// In the order of [`HEADER`].
    fn cells(&self) -> impl Serialize {
        let center = self.arc.map(|arc| arc.center);
        (
            (self.line, self.tool, self.motion, self.to),
            [0, 1, 2].map(|axis| center.map(|center| center[axis])),
            self.arc.map(|arc| arc.normal),
            self.arc.map(|arc| arc.turns),
            self.feed,
            self.seconds,
        )
    }
}

/// Billionths of a millimetre are noise of the arithmetic.
fn tidy(value: f64) -> f64 {
    (value * 1e9).round() / 1e9 + 0.0
}

/// Machine time of a move; none when the program gives no feed.
pub(crate) fn seconds(next: &Move, rapid_rate: f64) -> Option<f64> {
    let rate = match next.motion {
        Motion::Rapid => Some(rapid_rate),
        Motion::Feed | Motion::Arc => next.feed,
    };
    rate.filter(|rate| *rate > 0.0)
        .map(|rate| next.length / rate * 60.0)
}

/// Where rows go.
enum Rows<W: Write> {
    Csv(Box<csv::Writer<W>>),
    Ndjson(W),
}

impl<W: Write> Rows<W> {
    fn write(&mut self, row: &Row) -> Result<(), Box<dyn std::error::Error>> {
        match self {
            Self::Csv(csv) => csv.serialize(row.cells())?,
            Self::Ndjson(output) => {
                serde_json::to_writer(&mut *output, row)?;
                output.write_all(b"\n")?;
            }
        }
        Ok(())
    }

    fn finish(self) -> std::io::Result<()> {
        match self {
            Self::Csv(mut csv) => csv.flush(),
            Self::Ndjson(mut output) => output.flush(),
        }
    }
}

/// Runs `path`.
pub(crate) fn run(args: Args) -> Outcome {
    let output = BufWriter::new(std::io::stdout().lock());
    let Some(file) = args.file else {
        let mut output = output;
        output.write_all(words_table().as_bytes())?;
        output.flush()?;
        return Ok(ExitCode::SUCCESS);
    };
    let program = args.program.open(&file, Unit::Mm)?.program;
    let mut rows = match args.format {
        Format::Csv => {
            let mut csv = csv::WriterBuilder::new()
                .has_headers(false)
                .from_writer(output);
            csv.write_record(HEADER)?;
            Rows::Csv(Box::new(csv))
        }
        Format::Ndjson => Rows::Ndjson(output),
    };
    for event in program {
        match event {
            Ok(Event::Move(next)) => rows.write(&Row::of(&next, args.rapid_rate))?,
            Ok(Event::Dwell {
                line,
                tool,
                seconds,
                at,
            }) => rows.write(&Row {
                line,
                tool,
                motion: "dwell",
                to: at,
                arc: None,
                feed: None,
                seconds: Some(seconds),
            })?,
            Ok(Event::Warning(warning)) => eprintln!("warning: {warning}"),
            // What came before the refusal stands, and the status says that it is not all.
            Err(fault) => {
                rows.finish()?;
                return Err(fault.into());
            }
        }
    }
    rows.finish()?;
    Ok(ExitCode::SUCCESS)
}
