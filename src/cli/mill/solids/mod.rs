//! `union3d mill` with tools of their own shapes: one solid for each straight feed, in an engine in this process or in a scene of a server.
//!
//! ```text
//!   program ── read whole ──> steps ── schedule ──> times
//!                               └── shop: chords, bodies ──> strokes ─┬─> target: here, HTTP, gRPC ──> tally ──> report
//!                                                                     └─> replace: what differs from a scene
//! ```
//! The program is read whole before anything is cut, so that a refused one is refused at once, and how much there is to do is known.

mod bodies;
mod material;
mod replace;
mod scene;
mod schedule;
mod shop;
mod target;

use std::io::Write;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use indicatif::ProgressBar;

use self::material::{AREA_UNITS, Blank, VOLUME_UNITS};
use self::scene::Wanted;
use self::schedule::Machine;
use self::shop::Shop;
use self::target::{Measured, Target};
use super::super::stock::{self, StockForm};
use super::super::{Outcome, progress, report};
use super::tally::{self, Cutting, Tally};
use super::{
    Args, COLLISION, Count, Warnings, about_csv, book, created, nothing_cut, path, rapid_rate,
    report_cutting,
};
use union3d::toolpath::{Event, Interpreter, Move, ToolTable, Warning};
use union3d::wire::solids::{Scale, SolidProperties};

/// The exit status after Ctrl-C, as of a program that the signal ends.
const INTERRUPTED: u8 = 130;

type Failure = Box<dyn std::error::Error>;

/// What the program does.
enum Step {
    Move(Move),
    Dwell { line: u64, tool: u32, seconds: f64 },
}

/// What `mill --json` prints of tools with shapes.
#[derive(serde::Serialize)]
struct Milled<'answer> {
    moves: u64,
    moves_without_time: u64,
    /// Solids put into the scene.
    solids: u64,
    seconds: f64,
    /// The last line that was milled, when Ctrl-C ended it before its end.
    #[serde(skip_serializing_if = "Option::is_none")]
    stopped_after_line: Option<u64>,
    cutting: Cutting,
    rounding: Rounding,
    warnings: &'answer [Warning],
    /// Of what is removed.
    mass_properties: SolidProperties,
    /// Of what is left of the stock.
    #[serde(skip_serializing_if = "Option::is_none")]
    remaining: Option<SolidProperties>,
}

/// What `mill --replace --json` prints.
#[derive(serde::Serialize)]
struct Replaced<'answer> {
    moves: u64,
    /// Solids taken out of the scene, put into it, and left in it.
    deleted: u64,
    inserted: u64,
    kept: u64,
    seconds: f64,
    /// From this line on the scene's history is of another program; null when nothing differs.
    stale_from_line: Option<u64>,
    rounding: Rounding,
    warnings: &'answer [Warning],
    /// Of what is removed.
    mass_properties: SolidProperties,
    /// Of what is left of the stock.
    #[serde(skip_serializing_if = "Option::is_none")]
    remaining: Option<SolidProperties>,
}

/// How far what is milled is from what the program says. Units: user units.
#[derive(Clone, Copy, Debug, serde::Serialize)]
struct Rounding {
    /// How far polygons reach out of the circles that they stand for, at most.
    outside: f64,
    /// How far circles reach out of their polygons.
    inside: f64,
    /// How far chords are from their arcs.
    chords: f64,
    /// How far ends of moves are displaced to the lattice, along each axis.
    lattice: f64,
}

/// Runs `mill` with tools that have shapes.
pub(super) fn run(mut args: Args) -> Outcome {
    let started = Instant::now();
    let interrupted = stop_on_interrupt()?;
    let opened = args.program.open(&args.file, args.unit)?;
    let mut warnings = Warnings::default();
    args.stock = match args.stock.take() {
        Some(StockForm::Nothing) => None,
        None => {
            let (stock, told) = stock::from_comment(opened.stock, args.unit);
            if let Some(told) = told {
                if args.program.is_strict() {
                    return Err(told.to_string().into());
                }
                warnings.add(told, &ProgressBar::hidden());
            }
            stock
        }
        given => given,
    };
    args.check_collision()?;
    let runtime = tokio::runtime::Runtime::new()?;
    let milled = mill(
        &args,
        started,
        opened.program,
        opened.size,
        warnings,
        &interrupted,
    );
    runtime.block_on(milled)
}

async fn mill(
    args: &Args,
    started: Instant,
    program: Interpreter,
    size: u64,
    mut warnings: Warnings,
    interrupted: &AtomicBool,
) -> Outcome {
    let mut count = Count::default();
    let bar = progress::bytes(Some(size));
    let read = read(program, args, &mut warnings, &mut count, &bar);
    bar.finish_and_clear();
    let (steps, tools) = read?;
    if count.feeds == 0 {
        warnings.add(nothing_cut(args)?, &bar);
    }
    let seconds = times(&steps, args);
    let steps_per_unit = args.steps_per_unit();
    let scale =
        Scale::new(steps_per_unit).map_err(|invalid| format!("--steps-per-unit: {invalid}"))?;
    let blank = Blank::new(args.stock.as_ref(), scale)?;
    let run = Run {
        args,
        started,
        count,
        steps: steps.iter().zip(seconds).collect(),
        wanted: Wanted {
            name: args.scene_name(),
            steps_per_unit,
            unit: args.unit.label(),
            stock: blank.document.clone(),
        },
    };
    let shop = Shop::new(args, scale, blank, tools)?;
    match &args.grpc {
        Some(server) if args.replace => run.replace(server, shop, warnings).await,
        _ => run.mill(shop, warnings, interrupted).await,
    }
}

/// A program that has been read.
struct Run<'run> {
    args: &'run Args,
    started: Instant,
    count: Count,
    /// What it does, and how long that takes.
    steps: Vec<(&'run Step, Option<f64>)>,
    /// The scene on a server, where one is asked.
    wanted: Wanted,
}

impl Run<'_> {
    /// Cuts all of it, and reports what each line has removed.
    async fn mill(
        self,
        mut shop: Shop<'_>,
        mut warnings: Warnings,
        interrupted: &AtomicBool,
    ) -> Outcome {
        let args = self.args;
        let mut target = self.target(&shop.blank).await?;
        let csv = created(args.csv.as_deref())?.map(|file| Box::new(file) as Box<dyn Write>);
        let per_unit = f64::from(self.wanted.steps_per_unit);
        let units = tally::Scale {
            volume: per_unit.powi(3) * VOLUME_UNITS,
            area: per_unit.powi(2) * AREA_UNITS,
            least_volume: args.least_volume,
        };
        let mut tally = Tally::of_solids(units, csv).map_err(about_csv(args))?;
        let bar = progress::moves(self.steps.len() as u64);
        let mut stopped_after_line = None;
        for (step, seconds) in &self.steps {
            if interrupted.load(Ordering::Relaxed) {
                stopped_after_line = Some(step.line().saturating_sub(1));
                break;
            }
            let stroke = shop.stroke(step, *seconds, &mut warnings, &bar)?;
            book(&mut tally, args, target.send(stroke).await?)?;
            bar.inc(1);
        }
        let (cuts, Measured { removed, remaining }) = target.finish(shop.scale()).await?;
        book(&mut tally, args, cuts)?;
        bar.finish_and_clear();
        let knows_hits = tally.knows_hits();
        if !knows_hits {
            warnings.add(hits_unknown(), &bar);
        }
        let cutting = tally.finish(&warnings.all).map_err(about_csv(args))?;
        warnings.close(&bar);
        let is_hit = [Some(&cutting.rapid_cuts), cutting.shank_or_holder.as_ref()]
            .into_iter()
            .flatten()
            .any(|hits| hits.count > 0);
        let milled = Milled {
            moves: self.count.moves,
            moves_without_time: self.count.moves_without_time,
            solids: shop.solids(),
            seconds: self.started.elapsed().as_secs_f64(),
            stopped_after_line,
            cutting,
            rounding: shop.rounding(),
            warnings: &warnings.all,
            mass_properties: removed,
            remaining,
        };
        print(args, &milled)?;
        if stopped_after_line.is_some() {
            Ok(ExitCode::from(INTERRUPTED))
        } else if is_hit && args.fail_on_collision {
            Ok(ExitCode::from(COLLISION))
        } else if !knows_hits && args.fail_on_collision {
            Err(format!("--fail-on-collision: {}", hits_unknown().text).into())
        } else {
            Ok(ExitCode::SUCCESS)
        }
    }

    async fn target(&self, blank: &Blank) -> Result<Target, Failure> {
        let credentials = self.args.credentials.read()?;
        let blank = (blank, self.args.contact);
        match (&self.args.server, &self.args.grpc) {
            (Some(server), _) => Target::http(server, &credentials, &self.wanted, blank).await,
            (None, Some(server)) => Target::grpc(server, &credentials, &self.wanted, blank).await,
            (None, None) => {
                self.args.check_scene()?;
                Ok(Target::here(blank))
            }
        }
    }

    /// Changes the program in a scene to this one.
    async fn replace(self, server: &str, mut shop: Shop<'_>, mut warnings: Warnings) -> Outcome {
        let credentials = self.args.credentials.read()?;
        let bar = progress::moves(self.steps.len() as u64);
        let mut strokes = Vec::new();
        for (step, seconds) in &self.steps {
            strokes.push(shop.stroke(step, *seconds, &mut warnings, &bar)?);
            bar.inc(1);
        }
        bar.finish_and_clear();
        let replaced = replace::replace(server, &credentials, &self.wanted, &strokes).await?;
        warnings.close(&bar);
        let Measured { removed, remaining } = replaced.measured;
        let replaced = Replaced {
            moves: self.count.moves,
            deleted: replaced.deleted,
            inserted: replaced.inserted,
            kept: replaced.kept,
            seconds: self.started.elapsed().as_secs_f64(),
            stale_from_line: replaced.stale_from_line,
            rounding: shop.rounding(),
            warnings: &warnings.all,
            mass_properties: removed,
            remaining,
        };
        print_replaced(self.args, &replaced)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// What is said when hits of shanks and holders are not known.
fn hits_unknown() -> Warning {
    Warning {
        line: 0,
        code: "hits-unknown".into(),
        text: "somebody else changed the scene meanwhile: what shanks and holders hit is left out"
            .into(),
    }
}

/// Set by Ctrl-C; by the second the process ends at once.
fn stop_on_interrupt() -> std::io::Result<Arc<AtomicBool>> {
    let interrupted = Arc::new(AtomicBool::new(false));
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .build()?;
    let asked = Arc::clone(&interrupted);
    std::thread::spawn(move || {
        runtime.block_on(async {
            while tokio::signal::ctrl_c().await.is_ok() {
                if asked.swap(true, Ordering::Relaxed) {
                    std::process::exit(INTERRUPTED.into());
                }
            }
        });
    });
    Ok(interrupted)
}

/// Reads the whole program.
fn read(
    mut program: Interpreter,
    args: &Args,
    warnings: &mut Warnings,
    count: &mut Count,
    bar: &ProgressBar,
) -> Result<(Vec<Step>, ToolTable), Failure> {
    let mut steps = Vec::new();
    while let Some(event) = program.next() {
        match event? {
            Event::Move(next) => {
                count.note(&next, path::seconds(&next, rapid_rate(args)));
                steps.push(Step::Move(next));
            }
            Event::Dwell {
                line,
                tool,
                seconds,
                ..
            } => steps.push(Step::Dwell {
                line,
                tool,
                seconds,
            }),
            Event::Warning(warning) => warnings.add(warning, bar),
        }
        if steps.len() % 4096 == 0 {
            bar.set_position(program.bytes());
        }
    }
    Ok((steps, program.tools().clone()))
}

impl Step {
    fn line(&self) -> u64 {
        match self {
            Self::Move(next) => next.line,
            Self::Dwell { line, .. } => *line,
        }
    }
}

/// Machine time of each step, in seconds; none where the program gives no feed.
fn times(steps: &[Step], args: &Args) -> Vec<Option<f64>> {
    let mut seconds: Vec<Option<f64>> = steps
        .iter()
        .map(|step| match step {
            Step::Move(next) => path::seconds(next, rapid_rate(args)),
            Step::Dwell { seconds, .. } => Some(*seconds),
        })
        .collect();
    if let Some(acceleration) = args.acceleration {
        let moves: Vec<Option<&Move>> = steps
            .iter()
            .map(|step| match step {
                Step::Move(next) => Some(next),
                Step::Dwell { .. } => None,
            })
            .collect();
        let machine = Machine {
            acceleration: acceleration * args.unit.mm(),
            junction_deviation: args.junction_deviation * args.unit.mm(),
        };
        schedule::accelerate(&moves, &mut seconds, machine);
    }
    seconds
}

fn print(args: &Args, milled: &Milled<'_>) -> Result<(), Failure> {
    let mut output = std::io::stdout().lock();
    if let Some(line) = milled.stopped_after_line {
        eprintln!("union3d: stopped by Ctrl-C: all up to line {line} is milled");
    }
    if args.json {
        writeln!(output, "{}", serde_json::to_string(milled)?)?;
        return Ok(());
    }
    writeln!(
        output,
        "{} moves, {} solids in {:.2} s\n",
        report::figure(&milled.moves.into()),
        report::figure(&milled.solids.into()),
        milled.seconds,
    )?;
    let Milled {
        mass_properties,
        remaining,
        ..
    } = milled;
    write!(
        output,
        "{}",
        table(args, mass_properties, remaining.as_ref())?
    )?;
    write!(output, "\n{}", report_cutting(&milled.cutting, args))?;
    write!(output, "{}", rounding_row(args, &milled.rounding))?;
    Ok(())
}

fn print_replaced(args: &Args, replaced: &Replaced<'_>) -> Result<(), Failure> {
    let mut output = std::io::stdout().lock();
    if args.json {
        writeln!(output, "{}", serde_json::to_string(replaced)?)?;
        return Ok(());
    }
    writeln!(
        output,
        "{} moves: {} solids deleted, {} inserted, {} kept in {:.2} s\n",
        report::figure(&replaced.moves.into()),
        report::figure(&replaced.deleted.into()),
        report::figure(&replaced.inserted.into()),
        report::figure(&replaced.kept.into()),
        replaced.seconds,
    )?;
    let Replaced {
        mass_properties,
        remaining,
        ..
    } = replaced;
    write!(
        output,
        "{}",
        table(args, mass_properties, remaining.as_ref())?
    )?;
    if let Some(line) = replaced.stale_from_line {
        writeln!(
            output,
            "{:<22}what the history says lines have removed is stale from line {line} on: recompute by milling anew",
            "history",
        )?;
    }
    write!(output, "{}", rounding_row(args, &replaced.rounding))?;
    Ok(())
}

/// What is measured, for people.
fn table(
    args: &Args,
    removed: &SolidProperties,
    remaining: Option<&SolidProperties>,
) -> Result<String, Failure> {
    let unit = args.unit.label();
    let scene = removed.scene.as_ref().zip(removed.seq);
    let scene = scene.map(|(scene, seq)| format!("{:<22}{scene}, after change {seq}\n", "scene"));
    let measured = report::table(&serde_json::to_value(removed)?, unit);
    let remaining = remaining.map(|remaining| {
        let volume = report::figure(&remaining.measures.volume.into());
        format!("{:<22}{volume} {unit}^3\n", "remaining")
    });
    let rows = [scene, Some(measured), remaining];
    Ok(rows.into_iter().flatten().collect())
}

/// How far what is milled is from what the program says, for people.
fn rounding_row(args: &Args, rounding: &Rounding) -> String {
    let unit = args.unit.label();
    let number = |value: f64| report::figure(&value.into());
    format!(
        "{:<22}polygons reach at most {} {unit} out of circles and circles {} {unit} out of polygons; chords of arcs at most {} {unit} off; ends of moves {} {unit}\n",
        "rounding",
        number(rounding.outside),
        number(rounding.inside),
        number(rounding.chords),
        number(rounding.lattice),
    )
}
