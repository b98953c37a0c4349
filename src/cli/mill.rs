//! `union3d mill`: G-code to the cubes that a cubic cutter sweeps.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use indicatif::ProgressBar;
use serde_json::{Value, value::RawValue};

use super::client::{BATCH_CUBES, Client, SceneWanted, Stream};
use super::cutter::{Cutter, STEPS_PER_EDGE, Unit};
use super::input::{self, Input};
use super::{Outcome, progress, report};
use union3d::engine::Engine;
use union3d::geometry::{CubeId, Effect, Place};
use union3d::toolpath::{Event, Motion, Moves, Warning};
use union3d::wire::convert::{self, Anchor, Settings, WantedSettings};

/// Positions nearer to each other than this many lattice steps make no more places, only more work.
const LATTICE_STEPS_MIN: f64 = 0.01;

/// Warnings of one kind that are printed; the rest are counted.
const WARNINGS_MAX: u64 = 10;

/// Turn G-code into the cubes that a cubic cutter sweeps, and measure their union
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Reads G-code, moves a cubic cutter along it, and measures the union of all cubes it covers: what it removes.

The cutter is an axis-aligned cube of the given edge, centred on the path. It is put down at least once every --step along \
straight lines and arcs, at both ends of every move, rounded to the lattice (halves away from zero); a place it is in already \
is not counted again. Feed moves cut; --rapid counts the rapids (G0) too.

Understood: G0 G1 G2 G3 (I J K or R, helices, full circles), G4, G17 G18 G19, G20 G21, G90 G91, G90.1 G91.1, G92, G93 G94, \
modal words, line numbers, comments, M0 M1 M2 M30. What else stands in the program is reported by line, once per kind: ignored \
when the path is still the one that is written, refused (nothing is measured) when it would be wrong. The cutter starts at the origin.

Without --server the cubes go into an engine in this process. With --server they are streamed into a scene of a running \
`union3d serve`, which is made if it is not there; its mass properties are those of everything in it.",
    after_long_help = "Examples:
  union3d mill pocket.gcode --edge 3.175
  union3d mill pocket.gcode --edge 3.175 --step 0.05 --out pocket.i32
  union3d measure pocket.i32 --edge 3.175
  union3d mill pocket.gcode --edge 0.125 --unit inch
  union3d mill pocket.gcode --edge 3.175 --server http://127.0.0.1:7373 --scene pocket
  cat pocket.gcode | union3d mill - --edge 3.175 --json"
)]
pub(crate) struct Args {
    /// The program; - is standard input.
    file: PathBuf,
    /// Edge of the cubic cutter, in the scene's unit: a whole number of lattice steps.
    #[arg(long, value_name = "LENGTH")]
    edge: f64,
    /// Longest way between two positions of the cutter, in the scene's unit [default: a twentieth of the edge].
    #[arg(long, value_name = "LENGTH", value_parser = positive)]
    step: Option<f64>,
    /// Stream the cubes to this server, such as `http://127.0.0.1:7373`, instead of measuring them here.
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    /// Scene on the server [default: the file's name].
    #[arg(long, value_name = "NAME", requires = "server")]
    scene: Option<String>,
    /// Unit of the scene, of --edge and of --step. The program's own unit is what its G20 or G21 says.
    #[arg(long, value_enum, default_value_t = Unit::Mm)]
    unit: Unit,
    /// Lattice steps in a unit: positions are rounded to them.
    #[arg(long, value_name = "STEPS", default_value_t = 1000)]
    steps_per_unit: u32,
    /// Let rapids (G0) cut too.
    #[arg(long)]
    rapid: bool,
    /// Write the lower corners of the cubes, in steps, as little-endian 32-bit triplets: a file for `union3d measure`.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print one JSON object: `{"moves","cubes","seconds","mass_properties"}`.
    #[arg(long)]
    json: bool,
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if value > 0.0 && f64::is_finite(value) => Ok(value),
        Ok(_) => Err("it must be more than 0".to_owned()),
        Err(_) => Err("it is not a number".to_owned()),
    }
}

/// What `mill --json` prints.
#[derive(serde::Serialize)]
struct Milled<'answer> {
    moves: u64,
    cubes: u64,
    seconds: f64,
    mass_properties: &'answer RawValue,
}

/// Runs `mill`.
pub(crate) fn run(args: Args) -> Outcome {
    let settings = settings(&args)?;
    let source = input::open(&args.file)?;
    let runtime = tokio::runtime::Runtime::new()?;
    runtime.block_on(mill(args, &settings, source))?;
    Ok(ExitCode::SUCCESS)
}

async fn mill(
    args: Args,
    settings: &Settings,
    (source, size): Input,
) -> Result<(), Box<dyn std::error::Error>> {
    let started = Instant::now();
    let step = args.step.unwrap_or(args.edge / STEPS_PER_EDGE);
    if step * f64::from(args.steps_per_unit) < LATTICE_STEPS_MIN {
        return Err(format!(
            "--step {step:?} is less than {LATTICE_STEPS_MIN} lattice steps, to which positions are rounded: take a longer one, or more --steps-per-unit"
        )
        .into());
    }
    let mut target = target(&args, settings).await?;
    let mut out = match &args.out {
        Some(path) => Some(BufWriter::new(
            File::create(path).map_err(input::about(path))?,
        )),
        None => None,
    };
    let bar = progress::bytes(size);
    let mut warnings = Warnings::default();
    let mut cutter = Cutter::new(settings, args.unit, step);
    let mut program = Moves::new(BufReader::new(source));
    let (mut moves, mut cubes) = (0, 0_u64);
    let mut batch = Vec::with_capacity(BATCH_CUBES);
    while let Some(event) = program.next() {
        let next = match event? {
            Event::Move(next) => next,
            Event::Dwell { .. } => continue,
            Event::Warning(warning) => {
                warnings.take(&warning, &bar);
                continue;
            }
        };
        if next.motion == Motion::Rapid && !args.rapid {
            continue;
        }
        moves += 1;
        for place in cutter.places(&next) {
            let place = place?;
            if let Some(out) = &mut out {
                write(out, place)
                    .map_err(input::about(args.out.as_deref().unwrap_or(Path::new(""))))?;
            }
            batch.push(place);
            cubes += 1;
            if batch.len() == BATCH_CUBES {
                target
                    .insert(std::mem::replace(
                        &mut batch,
                        Vec::with_capacity(BATCH_CUBES),
                    ))
                    .await?;
                bar.set_position(program.bytes());
                bar.set_message(format!("{} cubes", report::figure(&cubes.into())));
            }
        }
    }
    if !batch.is_empty() {
        target.insert(batch).await?;
    }
    if let (Some(out), Some(path)) = (&mut out, &args.out) {
        out.flush().map_err(input::about(path))?;
    }
    let mass_properties = target.finish(settings).await?;
    let seconds = started.elapsed().as_secs_f64();
    bar.finish_and_clear();
    warnings.close(&bar);
    let milled = Milled {
        moves,
        cubes,
        seconds,
        mass_properties: &mass_properties,
    };
    print(&args, &milled)
}

fn print(args: &Args, milled: &Milled<'_>) -> Result<(), Box<dyn std::error::Error>> {
    let mut output = std::io::stdout().lock();
    if args.json {
        writeln!(output, "{}", serde_json::to_string(milled)?)?;
        return Ok(());
    }
    let properties: Value = serde_json::from_str(milled.mass_properties.get())?;
    let rate = f64::from(u32::try_from(milled.cubes)?) / milled.seconds;
    writeln!(
        output,
        "{} moves, {} cubes in {:.2} s: {} cubes/s\n",
        report::figure(&milled.moves.into()),
        report::figure(&milled.cubes.into()),
        milled.seconds,
        report::figure(&rate.round().into()),
    )?;
    if let Some(scene) = properties["scene"].as_str() {
        writeln!(
            output,
            "{:<22}{scene}, after change {}",
            "scene", properties["seq"]
        )?;
    }
    write!(output, "{}", report::table(&properties, args.unit.label()))?;
    Ok(())
}

fn settings(args: &Args) -> Result<Settings, Box<dyn std::error::Error>> {
    let wanted = WantedSettings {
        steps_per_unit: args.steps_per_unit.into(),
        unit: args.unit.label().to_owned(),
        anchor: Anchor::Center,
        ..WantedSettings::with_edge(args.edge)
    };
    Ok(Settings::check(wanted).map_err(|faults| input::faults(&faults))?)
}

fn write(out: &mut impl Write, place: Place) -> std::io::Result<()> {
    place
        .corner()
        .into_iter()
        .try_for_each(|coordinate| out.write_all(&coordinate.to_le_bytes()))
}

/// The name of a scene for a file: its own, in the letters that names may have.
fn scene_name(path: &Path) -> String {
    let stem = path
        .file_stem()
        .map(|stem| stem.to_string_lossy().to_lowercase());
    let name: String = stem
        .unwrap_or_default()
        .chars()
        .map(|letter| match letter {
            'a'..='z' | '0'..='9' | '.' | '_' | '-' => letter,
            _ => '-',
        })
        .skip_while(|letter| !letter.is_ascii_alphanumeric())
        .take(63)
        .collect();
    if name.is_empty() {
        "mill".to_owned()
    } else {
        name
    }
}

/// Where the cubes go.
enum Target {
    Engine { engine: Box<Engine>, next_id: u64 },
    Server(Stream),
}

async fn target(args: &Args, settings: &Settings) -> Result<Target, Box<dyn std::error::Error>> {
    let Some(server) = &args.server else {
        return Ok(Target::Engine {
            engine: Box::new(Engine::new(settings.edge())),
            next_id: 1,
        });
    };
    let wanted = SceneWanted {
        name: args.scene.clone().unwrap_or_else(|| scene_name(&args.file)),
        edge: settings.document().edge,
        steps_per_unit: args.steps_per_unit,
        unit: args.unit.label().to_owned(),
    };
    let (client, largest_id) = Client::open(server, &wanted).await?;
    Ok(Target::Server(Stream::new(client, largest_id)))
}

impl Target {
    async fn insert(&mut self, places: Vec<Place>) -> Result<(), Box<dyn std::error::Error>> {
        match self {
            Self::Engine { engine, next_id } => {
                let ids = (*next_id..).map(CubeId);
                *next_id += places.len() as u64;
                let effect = Effect {
                    deleted: vec![],
                    inserted: ids.zip(places).collect(),
                };
                engine.apply(&effect)?;
            }
            Self::Server(stream) => stream.send(places).await?,
        }
        Ok(())
    }

    async fn finish(
        self,
        settings: &Settings,
    ) -> Result<Box<RawValue>, Box<dyn std::error::Error>> {
        Ok(match self {
            Self::Engine { engine, .. } => {
                let totals = engine.totals();
                serde_json::value::to_raw_value(&convert::mass_properties(
                    None, None, &totals, settings,
                ))?
            }
            Self::Server(stream) => stream.finish().await?,
        })
    }
}

/// Prints warnings as they come, but only so many of a kind.
#[derive(Debug, Default)]
pub(crate) struct Warnings {
    counts: BTreeMap<String, u64>,
}

impl Warnings {
    /// Prints a warning, or counts it.
    pub(crate) fn take(&mut self, warning: &Warning, bar: &ProgressBar) {
        let count = self.counts.entry(warning.subject.clone()).or_default();
        *count += 1;
        if *count <= WARNINGS_MAX {
            progress::line(bar, &format!("warning: {warning}"));
        }
    }

    /// Says how many were not printed.
    pub(crate) fn close(&self, bar: &ProgressBar) {
        for (subject, count) in &self.counts {
            if let Some(more @ 1..) = count.checked_sub(WARNINGS_MAX) {
                progress::line(bar, &format!("warning: {more} more lines: {subject}"));
            }
        }
    }
}
