//! `union3d mill`: G-code to what tools sweep, and what each line removes. Here with the square cutter of `--edge`, which sweeps cubes; `solids` has
//! tools of their own shapes.

mod grpc;
mod http;
mod line;
mod solids;
mod tally;
mod target;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use serde_json::{Value, value::RawValue};

use self::line::LineChange;
use self::tally::{Cutting, Kind, Tally};
use self::target::Target;
use super::client::{Client, SceneWanted};
use super::credentials::CredentialsArgs;
use super::cutter::{self, Cutter, Length, STEPS_PER_EDGE, Unit};
use super::input;
use super::path::{self, RAPID_RATE_MM};
use super::program::ProgramArgs;
use super::stock::{self, StockForm};
use super::{Outcome, progress, report};
use union3d::geometry::Place;
use union3d::toolpath::{Event, Interpreter, Motion, Move, Warning};
use union3d::wire::convert::{self, Anchor, Settings, SettingsDocument, StockDocument};

/// Positions nearer to each other than this many lattice steps make no more places, only more work.
const LATTICE_STEPS_MIN: f64 = 0.01;

/// The exit status when something is hit and --fail-on-collision is given.
const COLLISION: u8 = 3;

/// Lattice steps in a unit when --steps-per-unit is not given: a thousandth of a millimetre, a ten-thousandth of an inch. A square cutter has 1000
/// in any unit.
const STEPS_PER_UNIT: u32 = 1000;
const STEPS_PER_INCH: u32 = 10_000;

/// Lines of one kind that the report for people names; --json has all.
const LINES_MAX: usize = 10;

/// Warnings of one kind that are printed; the rest are counted.
const WARNINGS_MAX: u64 = 10;

/// Turn G-code into what its tools sweep, and measure what they remove
#[expect(clippy::struct_excessive_bools, reason = "each is a switch of its own")]
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Reads G-code, carries tools along it, and measures the union of what they sweep: what is removed.

Tools have shapes: --tool T1=flat:6 (or ball:6, bull:6,corner=1, vee:6,angle=60,tip=0.2, drill:6,angle=118, tapered:6,angle=3,tip=2, \
form:0x0/4x3/4x10 of diameters and heights), with length=22 from the tip to the holder, flutes=15, shank=6 and holder=40x30/50x20; from --tools; or from \
comments of the program as Autodesk's posts write them. Without a number it is the tool of programs that name none. A tool without a shape is refused where it cuts. \
Without --stock the material is a box that comments of the program say as Carbide Create, CutViewer, Vectric and posts of Fusion 360 write it, and the line is told; when they do not say all of it, \
or contradict each other, that is told and there is none. \
Every straight feed is one solid, exactly what the tool sweeps, its ends rounded to the lattice; round tools are polygons of --sides, arcs and splines chords no farther off than \
--tolerance, and the report says how far that is. The flutes cut. With a stock, what the shank or the holder goes through is told, and rapids that hit material.

With --edge the cutter is square and sweeps cubes: as wide as the edge and --length long, its tip on the programmed point, put down at least once every --step along the path. \
A place it is in already is not counted again. A second tool is refused where it cuts, because there is one --edge.

Feed moves cut; with --rapid the rapids (G0) cut, too. With a stock rapids are always swept, and those that remove something are reported. \
The path is right, or the program is refused at its line. What is understood, and what is let pass because it changes nothing of the path, says \
`union3d path --words`; what was taken for granted or not done is reported, once per kind. Where the machine stands is not known before the program has said x, y and z, \
and after it went to its reference point (G28, G30) or to machine coordinates (G53) without --home: a move from there cuts at its end only, a rapid to there hits nothing, \
and a feed before the program has said the coordinate again is refused.

The report says, with --csv for each line: what was removed, how fast, which lines cut nothing, what was hit, and the machine time: length by feed, \
rapids (also those that cut nothing) at --rapid-rate, dwells (G4) as long as they say; with --acceleration also getting going and stopping. Ctrl-C ends it with the \
report of what is done, and status 130.

With --contact it says the area of contact, too. Of a move of a tool with a shape that is the area of the new surface that it leaves: of the boundary of what its flutes sweep, as far as it lies in the material \
that was there before. Where it lies on a surface that was there, or on that of the stock, it is none; the chords of an arc are one move, of which only what is surface in the end counts. A line of several \
moves, as a cycle, has the sum of theirs. The cell is empty where it is not known: where the shank or the holder comes near the stock on a move of several solids, or a move has more than 1,024.

With --server or --grpc all that goes into a scene of a running `union3d serve`, which is made if it is not there. --grpc streams: changes follow each other without \
waiting for answers. --server sends them over HTTP, many in a request. Each move of tools with shapes is one change, its chords as several solids, with the line's number as its `move` and its machine time as \
its `duration`; the report is the same as without a server. The scene has the same steps, unit and stock, and no solids yet. The solids of line L have the ids from L x 2^20 on. What shanks and holders hit, and with --contact the area of contact, is found in \
this process, which follows what the program removes, because asking the server in between would hold up the stream; when somebody else changes the scene meanwhile, it is not known, and the report \
says so and leaves it out. --replace changes the program in the scene to the one in the file: it lists the scene's solids, deletes those that the file does not have (whoever put them there), inserts those that \
are new, and keeps all others with their ids; the totals are exact at once, and what the history says lines have removed is stale from the first line that differs on: for that, mill anew. \
Each line of a square cutter is one change; one of more than 65,536 cubes becomes several changes, which share its time as they share its cubes.",
    after_long_help = "Examples:
  union3d mill pocket.gcode --tool flat:3.175 --stock 0,0,-10:80,60,0
  union3d mill part.nc --tool T1=flat:10,length=30,holder=40x50 --tool T2=ball:6,length=25,holder=30x50 --stock 0,0,-20:100,80,0 --csv lines.csv --fail-on-collision
  union3d mill part.nc --tools library.json --stock cylinder:0,0,-40:60x40 --acceleration 500
  union3d mill part.nc --tool flat:6 --stock 0,0,-20:100,80,0 --grpc grpc://127.0.0.1:7374 --scene part
  union3d mill part.nc --tool flat:6 --stock 0,0,-20:100,80,0 --grpc grpc://127.0.0.1:7374 --scene part --replace
  union3d mill pocket.gcode --edge 3.175 --stock 0,0,-10:80,60,0 --json
  union3d mill pocket.gcode --edge 3.175 --step 0.05 --out pocket.i32
  union3d measure pocket.i32 --edge 3.175
  union3d mill pocket.gcode --edge 0.125 --unit inch --server http://127.0.0.1:7373 --scene pocket"
)]
pub(crate) struct Args {
    /// The program; - is standard input.
    file: PathBuf,
    /// Edge of a square cutter, in place of tools with shapes, in the scene's unit: a whole number of lattice steps.
    #[arg(long, value_name = "LENGTH")]
    edge: Option<f64>,
    /// Longest way between two positions of the cutter, in the scene's unit [default: a twentieth of the edge].
    #[arg(long, value_name = "LENGTH", value_parser = cutter::positive, requires = "edge")]
    step: Option<f64>,
    /// Send what is swept to this server over HTTP, such as `http://127.0.0.1:7373`, instead of measuring it here.
    #[arg(long, value_name = "URL", conflicts_with = "grpc")]
    server: Option<String>,
    /// Stream it to this server over gRPC, such as `grpc://127.0.0.1:7374`.
    #[arg(long, value_name = "URL")]
    grpc: Option<String>,
    #[command(flatten)]
    credentials: CredentialsArgs,
    /// Scene on the server [default: the file's name].
    #[arg(long, value_name = "NAME")]
    scene: Option<String>,
    /// Change the program that is in the scene to this one: only solids that differ are deleted and inserted.
    #[arg(long, requires = "grpc", conflicts_with_all = ["edge", "csv", "fail_on_collision"])]
    replace: bool,
    /// The material, in the scene's unit: a box from its least to its greatest corner, `x,y,z:x,y,z`; for tools with shapes also an upright
    /// cylinder by the middle of its lower end, `cylinder:x,y,z:DIAMETERxHEIGHT`, or a convex hull, `hull:x,y,z:x,y,z:...`. Left out, it is what
    /// comments of the program say of it (tools with shapes only); `none` is none, whatever they say.
    #[arg(long, value_name = "STOCK", value_parser = stock::parse, allow_hyphen_values = true)]
    stock: Option<StockForm>,
    /// Speed of rapids, in the scene's unit a minute [default: 5000 mm a minute].
    #[arg(long, value_name = "RATE", value_parser = cutter::positive)]
    rapid_rate: Option<f64>,
    /// Write what each line removed to this file, as CSV.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// End with status 3 when a rapid, a shank or a holder hits material.
    #[arg(long, visible_alias = "fail-on-rapid-cut")]
    fail_on_collision: bool,
    /// Volumes up to this are no hit, and a feed line that removes no more cuts air; in the scene's unit cubed.
    #[arg(long, value_name = "VOLUME", value_parser = not_negative, default_value_t = 0.0)]
    least_volume: f64,
    /// Work out the area of contact of each line of tools with shapes, in this process, also beside a server: moves of several solids, such as
    /// arcs, take two to three times as long.
    #[arg(long, conflicts_with_all = ["edge", "replace"])]
    contact: bool,
    /// Sides of the polygon that stands for the circle of a round tool.
    #[arg(
        long,
        value_name = "SIDES",
        default_value_t = 32,
        conflicts_with = "edge"
    )]
    sides: u16,
    /// Acceleration of the machine, in the scene's unit a second squared: then moves take the time that it needs to get going and to stop.
    #[arg(long, value_name = "RATE", value_parser = cutter::positive, conflicts_with = "edge")]
    acceleration: Option<f64>,
    /// How far a corner may be cut for the speed at which it is passed, as Grbl takes it (the path stays as it is); in the scene's unit.
    #[arg(long, value_name = "LENGTH", value_parser = cutter::positive, default_value_t = 0.01, requires = "acceleration")]
    junction_deviation: f64,
    /// Unit of the scene, of --edge and of --step. The program's own unit is what its G20 or G21 says.
    #[arg(long, value_enum, default_value_t = Unit::Mm)]
    unit: Unit,
    /// Lattice steps in a unit: positions are rounded to them [default: 1000; 10000 for tools with shapes in inches].
    #[arg(long, value_name = "STEPS")]
    steps_per_unit: Option<u32>,
    /// Length of the cutter from its tip up, in the scene's unit [default: the edge; with --stock up to its top].
    #[arg(long, value_name = "LENGTH", value_parser = cutter::positive, requires = "edge")]
    length: Option<f64>,
    /// Take the square cutter for every tool of the program.
    #[arg(long, requires = "edge")]
    one_cutter: bool,
    #[command(flatten)]
    program: ProgramArgs,
    /// Let rapids (G0) cut too.
    #[arg(long)]
    rapid: bool,
    /// Write the lower corners of the cubes, in steps, as little-endian 32-bit triplets: a file for `union3d measure`.
    #[arg(long, value_name = "FILE", requires = "edge")]
    out: Option<PathBuf>,
    /// Print one JSON object: `{"moves","moves_without_time","cubes","seconds","cutting","warnings","mass_properties"}`, of tools with shapes with
    /// "solids", "rounding" and "remaining"; with --replace what is "deleted", "inserted" and
    /// "kept", and from which line on the history is stale.
    #[arg(long)]
    json: bool,
}

/// A volume on the command line.
fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if value >= 0.0 && f64::is_finite(value) => Ok(value),
        Ok(_) => Err("it must not be less than 0".to_owned()),
        Err(_) => Err("it is not a number".to_owned()),
    }
}

impl Args {
    /// The name of the scene.
    fn scene_name(&self) -> String {
        let given = self.scene.clone();
        given.unwrap_or_else(|| scene_name(&self.file))
    }

    /// Refuses what is only for a server where there is none.
    fn check_scene(&self) -> Result<(), &'static str> {
        let CredentialsArgs { key_file, ca } = &self.credentials;
        match (&self.scene, key_file, ca) {
            (Some(_), ..) => Err("--scene names a scene of a server: give --server or --grpc, too"),
            (None, Some(_), _) => {
                Err("--key-file has the key for a server: give --server or --grpc, too")
            }
            (None, None, Some(_)) => {
                Err("--ca says which server to trust: give --server or --grpc, too")
            }
            (None, None, None) => Ok(()),
        }
    }

    /// Refuses to fail on collisions where nothing can be hit.
    fn check_collision(&self) -> Result<(), &'static str> {
        match (self.fail_on_collision, &self.stock) {
            (true, None) => Err("--fail-on-collision needs material that can be hit: give --stock"),
            _ => Ok(()),
        }
    }

    /// Lattice steps in a unit.
    fn steps_per_unit(&self) -> u32 {
        self.steps_per_unit.unwrap_or(match (self.edge, self.unit) {
            (None, Unit::Inch) => STEPS_PER_INCH,
            _ => STEPS_PER_UNIT,
        })
    }
}

/// What `mill --json` prints.
#[derive(serde::Serialize)]
struct Milled<'answer> {
    moves: u64,
    moves_without_time: u64,
    cubes: u64,
    seconds: f64,
    cutting: Cutting,
    warnings: &'answer [Warning],
    mass_properties: &'answer RawValue,
}

/// Runs `mill`.
pub(crate) fn run(mut args: Args) -> Outcome {
    let Some(edge) = args.edge else {
        return solids::run(args);
    };
    args.stock = args.stock.filter(|form| *form != StockForm::Nothing);
    args.check_collision()?;
    let settings = settings(&args, edge)?;
    let opened = args.program.open(&args.file, args.unit)?;
    let runtime = tokio::runtime::Runtime::new()?;
    runtime.block_on(mill(args, &settings, opened.program, opened.size))
}

async fn mill(args: Args, settings: &Settings, mut program: Interpreter, size: u64) -> Outcome {
    let started = Instant::now();
    let step = args
        .step
        .unwrap_or(settings.document().edge / STEPS_PER_EDGE);
    if step * f64::from(args.steps_per_unit()) < LATTICE_STEPS_MIN {
        return Err(format!(
            "--step {step:?} is less than {LATTICE_STEPS_MIN} lattice steps, to which positions are rounded: take a longer one, or more --steps-per-unit"
        )
        .into());
    }
    let mut target = target(&args, settings).await?;
    let mut out = created(args.out.as_deref())?;
    let csv = created(args.csv.as_deref())?.map(|file| Box::new(file) as Box<dyn Write>);
    let scale = tally::Scale::of_cubes(args.steps_per_unit(), args.least_volume);
    let mut tally = Tally::of_cubes(scale, csv).map_err(about_csv(&args))?;
    let bar = progress::bytes(Some(size));
    let mut warnings = Warnings::default();
    let mut cutter = Cutter::new(settings, args.unit, step, length(&args, settings)?);
    let mut count = Count::default();
    let mut cutting_tool = None;
    let mut open: Option<LineChange> = None;
    while let Some(event) = program.next() {
        let (line, kind, time, next) = match event? {
            Event::Move(next) => {
                let seconds = path::seconds(&next, rapid_rate(&args));
                count.note(&next, seconds);
                (next.line, kind(&next), seconds, Some(next))
            }
            Event::Dwell { line, seconds, .. } => (line, Kind::Dwell, Some(seconds), None),
            Event::Warning(warning) => {
                warnings.add(warning, &bar);
                continue;
            }
        };
        if let Some(complete) = open.take_if(|open| !open.takes(line, kind)) {
            send(complete, &mut target, &mut tally, &args).await?;
            bar.set_position(program.bytes());
            bar.set_message(format!("{} cubes", report::figure(&count.cubes.into())));
        }
        let open = open.get_or_insert_with(|| LineChange::new(line, kind));
        open.join(kind, time.map(|time| duration(line, time)).transpose()?);
        let cuts = kind == Kind::Feed || args.rapid || args.stock.is_some();
        let Some(swept) = next.filter(|_| cuts).and_then(|next| swept(&next)) else {
            continue;
        };
        if kind == Kind::Feed && !args.one_cutter {
            check_tool(&mut cutting_tool, &swept)?;
        }
        for place in cutter.places(&swept) {
            let place = place?;
            if let Some(out) = &mut out {
                write(out, place)
                    .map_err(input::about(args.out.as_deref().unwrap_or(Path::new(""))))?;
            }
            open.places.push(place);
            count.cubes += 1;
        }
    }
    if let Some(complete) = open {
        send(complete, &mut target, &mut tally, &args).await?;
    }
    if let (Some(out), Some(path)) = (&mut out, &args.out) {
        out.flush().map_err(input::about(path))?;
    }
    let (cuts, mass_properties) = target.finish(settings).await?;
    book(&mut tally, &args, cuts)?;
    if count.feeds == 0 {
        warnings.add(nothing_cut(&args)?, &bar);
    }
    let cutting = tally.finish(&warnings.all).map_err(about_csv(&args))?;
    let seconds = started.elapsed().as_secs_f64();
    bar.finish_and_clear();
    warnings.close(&bar);
    let rapids_cut = cutting.rapid_cuts.count > 0;
    let milled = Milled {
        moves: count.moves,
        moves_without_time: count.moves_without_time,
        cubes: count.cubes,
        seconds,
        cutting,
        warnings: &warnings.all,
        mass_properties: &mass_properties,
    };
    print(&args, &milled)?;
    Ok(if rapids_cut && args.fail_on_collision {
        ExitCode::from(COLLISION)
    } else {
        ExitCode::SUCCESS
    })
}

/// One --edge is one cutter: another tool must not cut.
fn check_tool(first: &mut Option<u32>, swept: &Move) -> Result<(), String> {
    if *first.get_or_insert(swept.tool) == swept.tool {
        return Ok(());
    }
    Err(format!(
        "line {}: tool {} cuts here, but --edge is one cutter for all tools; --one-cutter takes it for each of them",
        swept.line, swept.tool
    ))
}

/// An empty program looks like a perfect one, so it is said.
fn nothing_cut(args: &Args) -> Result<Warning, String> {
    let nothing = Warning {
        line: 0,
        code: "no-feed-moves".into(),
        text: "in the whole program: nothing is cut".into(),
    };
    if args.program.is_strict() {
        return Err(format!("{} {}", nothing.code, nothing.text));
    }
    Ok(nothing)
}

/// What has come by.
#[derive(Debug, Default)]
struct Count {
    moves: u64,
    feeds: u64,
    /// Feed moves before any F.
    moves_without_time: u64,
    cubes: u64,
}

impl Count {
    fn note(&mut self, next: &Move, seconds: Option<f64>) {
        self.moves += 1;
        self.feeds += u64::from(next.motion != Motion::Rapid);
        self.moves_without_time += u64::from(seconds.is_none());
    }
}

/// What of a move is swept. Where the machine stands before the program has said so, or after it went to a reference point whose place
/// is not known, nobody knows: a move from there cuts at its end only, and a rapid that leads there is no collision.
fn swept(next: &Move) -> Option<Move> {
    match (next.start_known, next.end_known == [true; 3]) {
        (true, true) => Some(*next),
        (false, true) => Some(next.end_only()),
        (_, false) => None,
    }
}

/// Units: mm a minute.
fn rapid_rate(args: &Args) -> f64 {
    args.rapid_rate
        .map_or(RAPID_RATE_MM, |rate| rate * args.unit.mm())
}

/// How long the cutter is.
fn length(args: &Args, settings: &Settings) -> Result<Length, String> {
    let SettingsDocument { edge, stock, .. } = &settings.document();
    match (args.length, stock) {
        (Some(length), _) if length < *edge => Err(format!(
            "--length {length} is less than --edge {edge}: cubes are as high as they are wide",
        )),
        (Some(length), _) => Ok(Length::Given(length)),
        (None, Some(stock)) => Ok(Length::UpTo(stock.max[2])),
        (None, None) => Ok(Length::Given(*edge)),
    }
}

fn kind(next: &Move) -> Kind {
    match next.motion {
        Motion::Rapid => Kind::Rapid,
        Motion::Feed | Motion::Arc => Kind::Feed,
    }
}

/// Machine time in whole nanoseconds, as a server keeps it.
fn duration(line: u64, seconds: f64) -> Result<Duration, String> {
    convert::duration_ns(seconds)
        .map(Duration::from_nanos)
        .map_err(|wrong| format!("line {line}: its machine time, {seconds:e} s, {wrong}"))
}

/// Sends a whole line.
async fn send(
    line: LineChange,
    target: &mut Target,
    tally: &mut Tally<'_>,
    args: &Args,
) -> Result<(), Box<dyn std::error::Error>> {
    for change in line.changes() {
        book(tally, args, target.send(change).await?)?;
    }
    Ok(())
}

fn book(
    tally: &mut Tally<'_>,
    args: &Args,
    cuts: Vec<tally::Cut>,
) -> Result<(), Box<dyn std::error::Error>> {
    for cut in cuts {
        tally.add(cut).map_err(about_csv(args))?;
    }
    Ok(())
}

fn about_csv(args: &Args) -> impl Fn(csv::Error) -> Box<dyn std::error::Error> {
    let path = args.csv.clone().unwrap_or_default();
    move |error| format!("{}: {error}", path.display()).into()
}

fn created(path: Option<&Path>) -> Result<Option<BufWriter<File>>, Box<dyn std::error::Error>> {
    Ok(match path {
        Some(path) => Some(BufWriter::new(
            File::create(path).map_err(input::about(path))?,
        )),
        None => None,
    })
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
    write!(output, "\n{}", report_cutting(&milled.cutting, args))?;
    Ok(())
}

/// What was removed and how, for people.
fn report_cutting(cutting: &Cutting, args: &Args) -> String {
    let unit = args.unit.label();
    let number = |value: f64| report::figure(&value.into());
    let mut text = String::new();
    let mut row = |name: &str, value: String| {
        use std::fmt::Write;
        writeln!(text, "{name:<22}{value}").expect("a string takes everything");
    };
    row(
        "removed",
        format!("{} {unit}^3", number(cutting.volume_removed)),
    );
    row(
        "machine time",
        format!(
            "{} s in {} lines",
            number(cutting.machine_seconds),
            cutting.lines
        ),
    );
    if let (Some(mean), Some(peak), Some(line)) = (
        cutting.removal_rate.mean,
        cutting.removal_rate.peak,
        cutting.removal_rate.peak_line,
    ) {
        row(
            "removal rate",
            format!(
                "mean {} {unit}^3/s, peak {} {unit}^3/s on line {line}",
                number(mean),
                number(peak)
            ),
        );
    }
    if let Some(contact) = &cutting.contact_area {
        let (peak, line) = (number(contact.peak), contact.peak_line);
        row(
            "contact area",
            format!("peak {peak} {unit}^2 on line {line}"),
        );
    }
    let air: Vec<String> = cutting.air_cuts.lines.iter().map(u64::to_string).collect();
    row("air cuts", listed(&air));
    if args.stock.is_some() {
        let rapids = &cutting.rapid_cuts;
        let volume = |volume| format!("{} {unit}^3", number(volume));
        let cuts: Vec<String> = rapids
            .lines
            .iter()
            .map(|cut| format!("{} ({})", cut.line, volume(cut.volume)))
            .collect();
        let mut said = listed(&cuts);
        if cuts.len() > 1 {
            said = format!("{said}; {} in all", volume(rapids.volume));
        }
        row("rapids that cut", said);
    }
    if let Some(hits) = cutting
        .shank_or_holder
        .as_ref()
        .filter(|_| args.stock.is_some())
    {
        let lines: Vec<String> = hits
            .lines
            .iter()
            .map(|hit| format!("{} ({} {unit}^3)", hit.line, number(hit.volume)))
            .collect();
        row("shank or holder hits", listed(&lines));
    }
    for tool in &cutting.tools {
        row(
            &format!("tool {}", tool.tool),
            format!(
                "{} {unit}^3 in {} s, {} lines",
                number(tool.volume_removed),
                number(tool.machine_seconds),
                tool.lines
            ),
        );
    }
    text
}

/// How many lines, and the first of them.
fn listed(lines: &[String]) -> String {
    let shown = &lines[..lines.len().min(LINES_MAX)];
    let more = if shown.len() < lines.len() {
        ", ..."
    } else {
        ""
    };
    match lines.len() {
        0 => "none".to_owned(),
        1 => format!("1 line: {}", lines[0]),
        count => format!("{count} lines: {}{more}", shown.join(", ")),
    }
}

fn settings(args: &Args, edge: f64) -> Result<Settings, Box<dyn std::error::Error>> {
    let stock = args.stock.as_ref().map(StockForm::corners).transpose()?;
    let wanted = SettingsDocument {
        steps_per_unit: args.steps_per_unit().into(),
        unit: args.unit.label().to_owned(),
        anchor: Anchor::Center,
        stock: stock.map(|[min, max]| StockDocument { min, max }),
        ..SettingsDocument::with_edge(edge)
    };
    Ok(Settings::check(&wanted).map_err(|faults| input::faults(&faults))?)
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

async fn target(args: &Args, settings: &Settings) -> Result<Target, Box<dyn std::error::Error>> {
    let wanted = SceneWanted {
        name: args.scene_name(),
        edge: settings.document().edge,
        steps_per_unit: args.steps_per_unit(),
        unit: args.unit.label().to_owned(),
        stock: settings.document().stock,
    };
    let credentials = args.credentials.read()?;
    match (&args.server, &args.grpc) {
        (Some(server), _) => {
            let (client, largest_id) = Client::open(server, &credentials, &wanted).await?;
            Ok(Target::http(client, largest_id))
        }
        (None, Some(server)) => Target::grpc(server, &credentials, &wanted).await,
        (None, None) => {
            args.check_scene()?;
            Ok(Target::engine(settings))
        }
    }
}

/// Prints warnings as they come, but only so many of a kind.
#[derive(Debug, Default)]
pub(crate) struct Warnings {
    counts: BTreeMap<String, u64>,
    all: Vec<Warning>,
}

impl Warnings {
    /// Prints a warning, or counts it.
    pub(crate) fn add(&mut self, warning: Warning, bar: &ProgressBar) {
        let count = self.counts.entry(warning.code.clone()).or_default();
        *count += 1;
        if *count <= WARNINGS_MAX {
            progress::line(bar, &format!("warning: {warning}"));
        }
        self.all.push(warning);
    }

    /// Says how many were not printed.
    pub(crate) fn close(&self, bar: &ProgressBar) {
        for (code, count) in &self.counts {
            if let Some(more @ 1..) = count.checked_sub(WARNINGS_MAX) {
                progress::line(bar, &format!("warning: {more} more lines: {code}"));
            }
        }
    }
}
