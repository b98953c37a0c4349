//! `union3d mill` with tools of their own shapes: one solid for each straight feed, in an engine in this process.
//!
//! ```text
//!   program ── read whole ──> steps ── schedule ──> times
//!                               └── chords ── bodies ──> material ──> tally ──> report
//! ```
//! The program is read whole before anything is cut, so that a refused one is refused at once, and how much there is to do is known.

mod bodies;
mod material;
mod schedule;

use std::collections::BTreeMap;
use std::io::Write;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use indicatif::ProgressBar;

use self::bodies::{Body, Fineness, Swept, end_height};
use self::material::{AREA_UNITS, Material, VOLUME_UNITS};
use self::schedule::Machine;
use super::super::{Outcome, progress, report};
use super::tally::{self, Cut, Cutting, Kind, Tally, ToolCut};
use super::{
    Args, COLLISION, Count, Warnings, about_csv, created, duration, kind, nothing_cut, path,
    rapid_rate, report_cutting, swept,
};
use union3d::engine::solids::{self, Totals};
use union3d::geometry::convex::{Deviation, Point};
use union3d::toolpath::{Event, Interpreter, Move, Shaped, ToolTable, Warning};
use union3d::wire::solids::{Scale, SolidProperties, solid_properties};

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
pub(super) fn run(args: &Args) -> Outcome {
    let started = Instant::now();
    let interrupted = stop_on_interrupt()?;
    let (program, size) = args.program.open(&args.file, args.unit)?;
    let mut warnings = Warnings::default();
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
    let fineness = Fineness {
        steps_per_mm: f64::from(steps_per_unit) / args.unit.mm(),
        sides: args.sides,
    };
    let material = Material::new(args.stock.as_ref(), scale)?;
    let top = common_top(&material, &tools, fineness)?;
    let mut shop = Shop {
        args,
        fineness,
        scale,
        material,
        top,
        tools,
        bodies: BTreeMap::new(),
        deviation: Deviation::default(),
        solids: 0,
    };
    let csv = created(args.csv.as_deref())?.map(|file| Box::new(file) as Box<dyn Write>);
    let per_unit = f64::from(steps_per_unit);
    let units = tally::Scale {
        volume: per_unit.powi(3) * VOLUME_UNITS,
        area: per_unit.powi(2) * AREA_UNITS,
        least_volume: args.least_volume,
    };
    let mut tally = Tally::of_solids(units, csv).map_err(about_csv(args))?;
    let bar = progress::moves(steps.len() as u64);
    let mut stopped_after_line = None;
    for (step, seconds) in steps.iter().zip(seconds) {
        if interrupted.load(Ordering::Relaxed) {
            stopped_after_line = Some(step.line().saturating_sub(1));
            break;
        }
        tally
            .add(shop.step(step, seconds, &mut warnings, &bar)?)
            .map_err(about_csv(args))?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    let cutting = tally.finish(&warnings.all).map_err(about_csv(args))?;
    warnings.close(&bar);
    let is_hit = [Some(&cutting.rapid_cuts), cutting.shank_or_holder.as_ref()]
        .into_iter()
        .flatten()
        .any(|hits| hits.count > 0);
    let (mass_properties, remaining) = shop.properties();
    let milled = Milled {
        moves: count.moves,
        moves_without_time: count.moves_without_time,
        solids: shop.solids,
        seconds: started.elapsed().as_secs_f64(),
        stopped_after_line,
        cutting,
        rounding: shop.rounding(),
        warnings: &warnings.all,
        mass_properties,
        remaining,
    };
    print(args, &milled)?;
    Ok(if stopped_after_line.is_some() {
        ExitCode::from(INTERRUPTED)
    } else if is_hit && args.fail_on_collision {
        ExitCode::from(COLLISION)
    } else {
        ExitCode::SUCCESS
    })
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

/// Up to where tools are raised: above the stock by the highest of their ends. Units: steps.
fn common_top(
    material: &Material,
    tools: &ToolTable,
    fineness: Fineness,
) -> Result<Option<i32>, String> {
    let Some(top) = material.top() else {
        return Ok(None);
    };
    let shapes = tools.tools().filter_map(|(_, tool)| match &tool.shape {
        Shaped::Given(shape) | Shaped::Comment(shape, _) => Some(shape),
        Shaped::Unknown | Shaped::Unsupported(_) => None,
    });
    let heights = shapes.map(|shape| end_height(shape, fineness));
    let highest = i64::from(top).saturating_add(heights.max().unwrap_or(0));
    i32::try_from(highest)
        .map(Some)
        .map_err(|_| "a tool is too high for the lattice: take fewer --steps-per-unit".into())
}

/// Everything that cuts, and what is cut.
struct Shop<'run> {
    args: &'run Args,
    fineness: Fineness,
    scale: Scale,
    material: Material,
    top: Option<i32>,
    tools: ToolTable,
    /// Those that have cut.
    bodies: BTreeMap<u32, Arc<Body>>,
    deviation: Deviation,
    solids: u64,
}

impl Shop<'_> {
    /// Does a step, and answers what it did.
    fn step(
        &mut self,
        step: &Step,
        seconds: Option<f64>,
        warnings: &mut Warnings,
        bar: &ProgressBar,
    ) -> Result<Cut, Failure> {
        let line = step.line();
        let time = seconds.map(|seconds| duration(line, seconds)).transpose()?;
        let (kind, tool, swept) = match step {
            Step::Move(next) => (kind(next), next.tool, swept(next)),
            Step::Dwell { tool, .. } => (Kind::Dwell, *tool, None),
        };
        let cuts = match kind {
            Kind::Feed => true,
            Kind::Rapid => self.args.rapid || self.args.stock.is_some(),
            Kind::Dwell => false,
        };
        let before = self.solids;
        let (mut removed, mut hit) = (0, 0);
        if let Some(swept) = swept.filter(|_| cuts)
            && let Some(body) = self.body(tool, line, kind, warnings, bar)?
        {
            (removed, hit) = self.cut(&body, &swept)?;
        }
        Ok(Cut {
            line,
            kind,
            duration: time,
            bodies: self.solids - before,
            removed,
            total_removed: self.material.removed(),
            area: self.material.area(),
            tool: Some(ToolCut { number: tool, hit }),
        })
    }

    /// A tool on the lattice. A rapid of one that is not defined hits nothing.
    fn body(
        &mut self,
        number: u32,
        line: u64,
        kind: Kind,
        warnings: &mut Warnings,
        bar: &ProgressBar,
    ) -> Result<Option<Arc<Body>>, String> {
        if let Some(body) = self.bodies.get(&number) {
            return Ok(Some(Arc::clone(body)));
        }
        let known = self.tools.get(number).map(|tool| tool.shape.clone());
        let shape = match known.unwrap_or_default() {
            Shaped::Given(shape) => shape,
            Shaped::Comment(shape, at) => {
                let warning = Warning {
                    line: at,
                    code: "tool-comment".into(),
                    text: format!("the shape of tool {number} is taken from this comment"),
                };
                if self.args.program.is_strict() {
                    return Err(warning.to_string());
                }
                warnings.add(warning, bar);
                shape
            }
            Shaped::Unknown | Shaped::Unsupported(_) if kind == Kind::Rapid => return Ok(None),
            Shaped::Unsupported(why) => {
                return Err(format!(
                    "line {line}: tool {number} cuts here without a shape: {why}; give it by --tool {}flat:6 or the like",
                    numbered(number)
                ));
            }
            Shaped::Unknown => {
                return Err(format!(
                    "line {line}: tool {number} cuts here and is not defined: give it by --tool {}flat:6 or the like, or by --tools; --edge is a square cutter",
                    numbered(number)
                ));
            }
        };
        if self.top.is_none() && shape.flutes.or(shape.length).is_none() {
            return Err(format!(
                "line {line}: how far up tool {number} cuts is not known, and there is no --stock: give it a length, such as --tool {}flat:6,length=22",
                numbered(number)
            ));
        }
        let body = Body::new(&shape, self.fineness, self.top)
            .map_err(|wrong| format!("tool {number}: {wrong}"))?;
        self.deviation = self.deviation.max(body.deviation);
        let body = Arc::new(body);
        self.bodies.insert(number, Arc::clone(&body));
        Ok(Some(body))
    }

    /// Carries a tool along a move: the volume it removes, and that its shank and holder go through.
    fn cut(&mut self, body: &Body, next: &Move) -> Result<(i128, i128), String> {
        let about = |wrong: String| format!("line {}: {wrong}", next.line);
        let mut from = self.point(next.start).map_err(about)?;
        let (mut removed, mut hit) = (0, 0);
        let mut has_moved = false;
        let mut ends = next.chord_ends(self.args.program.tolerance).peekable();
        while let Some(to) = ends.next() {
            let to = self.point(to).map_err(about)?;
            // Several chords may be shorter than a step of the lattice; a tool that stands still has cut where it stands.
            let stands = ends.peek().is_none() && !has_moved;
            if from != to || stands {
                removed += self.remove(body, [from, to]).map_err(about)?;
                hit += self.hit(body, [from, to]).map_err(about)?;
                has_moved = true;
            }
            from = to;
        }
        Ok((removed, hit))
    }

    /// The lattice point nearest to a place in mm.
    fn point(&self, place: [f64; 3]) -> Result<Point, String> {
        let user = place.map(|mm| mm / self.args.unit.mm());
        self.scale
            .point(user, "")
            .map_err(|fault| format!("the tool cannot be there: {fault}"))
    }

    /// Removes what the flutes sweep.
    fn remove(&mut self, body: &Body, ends: [Point; 2]) -> Result<i128, String> {
        let Some((swept, ends)) = self.flutes(body, ends)? else {
            return Ok(0);
        };
        if !self.material.is_near(swept, ends) {
            return Ok(0);
        }
        let swept = sweep(swept, ends)?;
        self.solids += 1;
        Ok(self.material.remove(swept))
    }

    /// The form of the flutes that is right along a segment, and the part of the segment where they may cut.
    fn flutes<'body>(
        &self,
        body: &'body Body,
        ends: [Point; 2],
    ) -> Result<Option<(&'body Swept, [Point; 2])>, String> {
        let lowest = ends.map(|end| end.wide()[2]).into_iter().min();
        let lowest = lowest.expect("there are two");
        if let (Some(top), Some(raised)) = (self.material.top(), &body.raised)
            && body
                .height
                .is_none_or(|height| lowest + height >= i64::from(top))
        {
            return Ok(below(ends, top).map(|ends| (raised, ends)));
        }
        let flutes = body
            .flutes
            .as_ref()
            .ok_or("its flutes are shorter than the tool must be here")?;
        Ok(Some((flutes, ends)))
    }

    /// What the shank and the holder go through.
    fn hit(&mut self, body: &Body, ends: [Point; 2]) -> Result<i128, String> {
        match &body.blunt {
            Some(blunt) if self.top.is_some() && self.material.is_near(blunt, ends) => {
                Ok(self.material.inside(sweep(blunt, ends)?))
            }
            _ => Ok(0),
        }
    }

    /// Of what is removed, and of what remains.
    fn properties(&self) -> (SolidProperties, Option<SolidProperties>) {
        let totals = self.material.totals();
        let error_max = self.material.error_max();
        let of =
            |totals: &Totals| solid_properties(None, None, (totals, &error_max), self.scale, 1.0);
        let remaining = totals
            .remaining
            .map(|measures| of(&Totals { measures, ..totals }));
        (of(&totals), remaining)
    }

    fn rounding(&self) -> Rounding {
        let deviation = self.deviation.max(self.material.deviation);
        Rounding {
            outside: self.scale.deviation(deviation.outside),
            inside: self.scale.deviation(deviation.inside),
            chords: self.args.program.tolerance / self.args.unit.mm(),
            lattice: 0.5 / f64::from(self.scale.steps_per_unit()),
        }
    }
}

/// `T1=`, or nothing for the tool of programs that name none.
fn numbered(number: u32) -> String {
    match number {
        0 => String::new(),
        _ => format!("T{number}="),
    }
}

fn sweep(swept: &Swept, [from, to]: [Point; 2]) -> Result<solids::Body, String> {
    solids::Body::swept(&swept.shape, from, to).map_err(|invalid| invalid.to_string())
}

/// The part of a segment that is not above a height; none when nothing of it is below. Where it crosses the height it is rounded to the lattice, the
/// same in both directions.
fn below(ends: [Point; 2], height: i32) -> Option<[Point; 2]> {
    let height = i64::from(height);
    let is_above = ends.map(|end| end.wide()[2] >= height);
    match is_above {
        [true, true] => None,
        [false, false] => Some(ends),
        [true, false] => Some([crossing(ends[1], ends[0], height), ends[1]]),
        [false, true] => Some([ends[0], crossing(ends[0], ends[1], height)]),
    }
}

/// Where the way up from one point to another crosses a height, rounded to the lattice (halves upwards).
fn crossing(lower: Point, upper: Point, height: i64) -> Point {
    let (from, to) = (lower.wide().map(i128::from), upper.wide().map(i128::from));
    let (part, whole) = (i128::from(height) - from[2], to[2] - from[2]);
    let at = [0, 1, 2].map(|axis| {
        let moved = (2 * (to[axis] - from[axis]) * part + whole).div_euclid(2 * whole);
        i64::try_from(from[axis] + moved).expect("it is between the two")
    });
    Point::new(at).expect("it is between two points")
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
    let unit = args.unit.label();
    let number = |value: f64| report::figure(&value.into());
    writeln!(
        output,
        "{} moves, {} solids in {:.2} s\n",
        report::figure(&milled.moves.into()),
        report::figure(&milled.solids.into()),
        milled.seconds,
    )?;
    let table = |properties: &SolidProperties| -> Result<String, Failure> {
        Ok(report::table(&serde_json::to_value(properties)?, unit))
    };
    write!(output, "{}", table(&milled.mass_properties)?)?;
    if let Some(remaining) = &milled.remaining {
        writeln!(
            output,
            "{:<22}{} {unit}^3",
            "remaining",
            number(remaining.measures.volume)
        )?;
    }
    write!(output, "\n{}", report_cutting(&milled.cutting, args))?;
    let rounding = &milled.rounding;
    writeln!(
        output,
        "{:<22}polygons reach at most {} {unit} out of circles and circles {} {unit} out of polygons; chords of arcs at most {} {unit} off; ends of moves {} {unit}",
        "rounding",
        number(rounding.outside),
        number(rounding.inside),
        number(rounding.chords),
        number(rounding.lattice),
    )?;
    Ok(())
}
