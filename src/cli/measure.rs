//! `union3d measure`: mass properties of a file of cubes.
//!
//! ```text
//!   file ──> a thread that reads: bytes to cubes, batch by batch ──> this thread: the engine, on all threads
//! ```

mod batches;

use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::ValueEnum;

use self::batches::{Batches, union_of};
use super::stock::{self, StockForm};
use super::{Outcome, input, progress, report, solids};
use union3d::engine::Op;
use union3d::geometry::{InvalidCube, Place};
use union3d::wire::convert::{self, Anchor, Settings, SettingsDocument, StockDocument};
use union3d::wire::decode;
use union3d::wire::documents::{LineOperation, NewCube};
use union3d::wire::problem::Problem;

/// How much of the input is looked at to tell what it is.
const DETECTION_BYTES: usize = 8_192;

/// Longest line of text.
const LINE_BYTES_MAX: u64 = 65_536;

/// Measure the union of the cubes or solids in files, without a server
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Measures the union of the cubes in a file, or of the solids in several, without a server.

A file of cubes is one of:
  .csv     x,y,z or id,x,y,z in user units, a line each; the first line may name the columns
  .ndjson  {\"id\":1,\"at\":[0,0,2.5]} a line each, or the lines of a scene's listing and of a stream of changes, \
{\"insert\":{\"id\":1,\"at\":[0,0,2.5]}} and {\"delete\":1}, which act in their order
  .i32     lower corners in lattice steps, as little-endian 32-bit triplets (`union3d mill --out` writes them)
Any other name, and standard input, is told by its content. Positions are lower corners unless --anchor center; they are rounded to the \
lattice, halves away from zero. An id may be repeated at the same place, and counts once; without ids every line is a cube.

A file of solids (--kind solids) is one of:
  .stl     the closed surface of one convex body, text or binary
  .ndjson  shapes and solids, a JSON object a line:
             {\"shapes\":{\"t1\":{\"flat\":{\"diameter\":6,\"length\":25}}}}         a line before the first that uses them
             {\"id\":1,\"shape\":\"t1\",\"from\":[0,0,-2],\"to\":[40,0,-2]}         what a shape sweeps
             {\"id\":2,\"shape\":\"t1\",\"at\":[40,0,-2]}                          a shape at one place
             {\"id\":3,\"hull\":[[0,0,0],[1,0,0],[0,1,0],[0,0,1]]}            the convex hull of points
             {\"insert\":{\"id\":..}}, {\"delete\":1}                            the same as changes, in their order
           A shape is a cutter with its tip at the anchor, flat, ball (rings), bull (corner_radius, rings), vee (angle, tip), drill \
(angle) or tapered (tip, angle), each with diameter, length, and if wanted sides (32), polygon (equal_area, inscribed or circumscribed) and \
at; or {\"box\":[x,y,z]}, {\"box\":{\"min\":..,\"max\":..}}, {\"hull\":[..]}, or {\"parts\":[shapes]} that move together.",
    after_long_help = "Examples:
  union3d measure cubes.csv --edge 0.01
  printf '0,0,0\\n1,0,0\\n' | union3d measure - --edge 1
  curl -H 'accept: application/x-ndjson' http://127.0.0.1:7373/v1/scenes/pocket/cubes |
    union3d measure - --edge 3.175 --json
  union3d measure left.stl right.stl
  union3d measure sweeps.ndjson --kind solids --steps-per-unit 10000 --stock 0,0,-10:80,60,0"
)]
pub(crate) struct Args {
    /// The cubes, in one file, or the solids; - is standard input.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// What the files hold; solids unless said when all are STL files, else cubes.
    #[arg(long, value_enum)]
    kind: Option<Kind>,
    /// Edge of every cube, in user units: a whole number of lattice steps. Cubes need it.
    #[arg(long, value_name = "LENGTH")]
    edge: Option<f64>,
    /// Lattice steps in a user unit: positions are rounded to them.
    #[arg(long, value_name = "STEPS", default_value_t = 1000)]
    steps_per_unit: u32,
    /// Measures what they remove from a block of material, too, and what remains of it: a box, MIN:MAX; for solids also
    /// cylinder:BASE:DIAMETERxHEIGHT or hull:POINT:POINT:.., in user units.
    #[arg(long, value_name = "STOCK", value_parser = stock::parse, allow_hyphen_values = true)]
    stock: Option<StockForm>,
    /// What the positions of cubes in CSV and NDJSON are.
    #[arg(long, value_enum, default_value_t = At::Corner)]
    anchor: At,
    /// What the file is, whatever its name and content.
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Print the API's `mass_properties` object alone.
    #[arg(long)]
    json: bool,
}

/// What is measured.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Kind {
    /// Identical cubes
    Cubes,
    /// Convex polyhedra: swept cutters, boxes, hulls
    Solids,
}

/// What a position is.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum At {
    /// The lower corner of a cube.
    Corner,
    /// The centre of a cube.
    Center,
}

/// What a file is.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Format {
    /// x,y,z or id,x,y,z
    Csv,
    /// A JSON object a line
    Ndjson,
    /// Little-endian 32-bit triplets
    I32,
    /// The surface of one convex body
    Stl,
}

type Failure = Box<dyn std::error::Error>;

/// Runs `measure`.
pub(crate) fn run(args: Args) -> Outcome {
    let format_of = |file: &Path| args.format.or_else(|| named(file));
    let is_stl = |file: &PathBuf| format_of(file) == Some(Format::Stl);
    let all_stl = args.files.iter().all(is_stl);
    match args.kind {
        Some(Kind::Solids) => measure_solids(&args),
        None if all_stl => measure_solids(&args),
        Some(Kind::Cubes) | None => measure_cubes(args),
    }
}

fn measure_solids(args: &Args) -> Outcome {
    if args.edge.is_some() || args.anchor != At::Corner {
        return Err("--edge and --anchor are for cubes; solids have their own sizes".into());
    }
    let format = |file: &PathBuf| match args.format.or_else(|| named(file)) {
        Some(Format::Stl) => Ok(solids::Format::Stl),
        Some(Format::Ndjson) | None => Ok(solids::Format::Ndjson),
        Some(Format::Csv | Format::I32) => Err(format!(
            "{}: solids are in STL or NDJSON files, or say --kind cubes",
            file.display()
        )),
    };
    let files = args.files.iter();
    let files: Result<_, String> = files
        .map(|file| Ok((file.clone(), format(file)?)))
        .collect();
    solids::measure(&solids::Request {
        files: files?,
        steps_per_unit: args.steps_per_unit,
        stock: args
            .stock
            .as_ref()
            .filter(|form| **form != StockForm::Nothing),
        json: args.json,
    })
}

fn measure_cubes(args: Args) -> Outcome {
    let Args {
        files,
        edge,
        steps_per_unit,
        stock,
        anchor,
        format,
        json,
        kind: _,
    } = args;
    let [file] = <[PathBuf; 1]>::try_from(files)
        .map_err(|_| "cubes are measured one file at a time; --kind solids takes several")?;
    let edge = edge.ok_or("--edge is missing: cubes have one; --kind solids measures solids")?;
    let stock = stock.filter(|form| *form != StockForm::Nothing);
    let stock = stock.as_ref().map(StockForm::corners).transpose()?;
    let wanted = SettingsDocument {
        stock: stock.map(|[min, max]| StockDocument { min, max }),
        steps_per_unit: steps_per_unit.into(),
        anchor: match anchor {
            At::Corner => Anchor::Corner,
            At::Center => Anchor::Center,
        },
        ..SettingsDocument::with_edge(edge)
    };
    let settings = Settings::check(&wanted).map_err(|faults| input::faults(&faults))?;
    let (source, size) = input::open(&file)?;
    let bar = progress::bytes(size);
    let mut source = BufReader::with_capacity(DETECTION_BYTES.max(1 << 16), bar.wrap_read(source));
    let format = match format.or_else(|| named(&file)) {
        Some(format) => format,
        None => detect(&mut source)?,
    };
    let union = union_of(&settings, |cubes| match format {
        Format::Csv => read_csv(source, cubes),
        Format::Ndjson => read_ndjson(source, cubes),
        Format::I32 => read_i32(source, cubes),
        Format::Stl => Err("an STL file is a solid; say --kind solids".into()),
    });
    bar.finish_and_clear();
    let totals = union.map_err(|failure| format!("{}: {failure}", file.display()))?;
    let properties = convert::mass_properties(None, None, &totals, &settings);
    let mut output = std::io::stdout().lock();
    if json {
        writeln!(output, "{}", serde_json::to_string(&properties)?)?;
    } else {
        let properties = serde_json::to_value(&properties)?;
        let table = report::table(&properties, "unit");
        write!(output, "{table}{}", report::parts(&properties, "unit"))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn named(path: &Path) -> Option<Format> {
    match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "csv" => Some(Format::Csv),
        "ndjson" | "jsonl" => Some(Format::Ndjson),
        "i32" => Some(Format::I32),
        "stl" => Some(Format::Stl),
        _ => None,
    }
}

/// Text has no zero bytes and no control letters but white space; triplets of ordinary coordinates have them everywhere.
fn detect(source: &mut impl BufRead) -> std::io::Result<Format> {
    let start = source.fill_buf()?;
    let start = &start[..start.len().min(DETECTION_BYTES)];
    let binary = |byte: &u8| *byte == 0x7f || (*byte < 0x20 && !byte.is_ascii_whitespace());
    Ok(
        if start.iter().any(binary)
            || std::str::from_utf8(start).is_err_and(|error| error.error_len().is_some())
        {
            Format::I32
        } else if start.trim_ascii_start().first() == Some(&b'{') {
            Format::Ndjson
        } else {
            Format::Csv
        },
    )
}

/// Where a file of CSV has its columns.
#[derive(Clone, Copy)]
struct Columns {
    id: Option<usize>,
    at: [usize; 3],
}

fn read_csv(source: impl Read, cubes: &mut Batches<'_>) -> Result<(), Failure> {
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .comment(Some(b'#'))
        .trim(csv::Trim::All)
        .terminator(csv::Terminator::Any(b'\n'))
        .from_reader(source.chain(&b"\n"[..]));
    let mut record = csv::StringRecord::new();
    let mut columns = None;
    while reader.read_record(&mut record)? {
        // The record's own position is that of the blank lines and comments before it. With its end at `\n` alone (a `\r` is
        // trimmed), and an end after the last one, the reader always stands at the beginning of the next line.
        let line = reader.position().line() - 1;
        if record.len() == 1 && record[0].is_empty() {
            continue;
        }
        if columns.is_none() {
            let (found, header) =
                find_columns(&record).map_err(|what| format!("line {line}: {what}"))?;
            columns = Some((found, record.len()));
            if header {
                continue;
            }
        }
        let (columns, width) = columns.expect("the first line has set them");
        if record.len() != width {
            return Err(format!(
                "line {line}: {} values, where the first line has {width}",
                record.len()
            )
            .into());
        }
        let id = match columns.id.map(|column| &record[column]) {
            None => None,
            Some(text) => Some(text.parse::<u64>().map_err(|_| {
                format!(
                    "line {line}: id = {text:?} is no whole number from 0 to {}",
                    u64::MAX
                )
            })?),
        };
        let mut at = [0.0; 3];
        for (axis, column) in columns.at.into_iter().enumerate() {
            let text = &record[column];
            at[axis] = text.parse().map_err(|_| {
                format!(
                    "line {line}: {} = {text:?} is not a number",
                    ["x", "y", "z"][axis]
                )
            })?;
        }
        cubes.insert_at(line, id, at)?;
    }
    Ok(())
}

/// The columns by the first line, and whether it only names them.
fn find_columns(first: &csv::StringRecord) -> Result<(Columns, bool), String> {
    let names: Vec<_> = first
        .iter()
        .map(|name| name.trim_start_matches('\u{feff}').to_ascii_lowercase())
        .collect();
    let find = |wanted: &str| names.iter().position(|name| name == wanted);
    let width = names.len();
    if let (Some(x), Some(y), Some(z)) = (find("x"), find("y"), find("z")) {
        let id = find("id");
        if width == 3 + usize::from(id.is_some()) {
            return Ok((Columns { id, at: [x, y, z] }, true));
        }
    } else if names.iter().any(|name| name.parse::<f64>().is_ok()) {
        match width {
            3 => {
                return Ok((
                    Columns {
                        id: None,
                        at: [0, 1, 2],
                    },
                    false,
                ));
            }
            4 => {
                return Ok((
                    Columns {
                        id: Some(0),
                        at: [1, 2, 3],
                    },
                    false,
                ));
            }
            _ => {}
        }
    }
    Err(format!(
        "{:?} is neither x,y,z nor id,x,y,z (as names or numbers, with commas between them)",
        first
            .iter()
            .collect::<Vec<_>>()
            .join(",")
            .chars()
            .take(80)
            .collect::<String>()
    ))
}

fn read_ndjson(source: impl BufRead, cubes: &mut Batches<'_>) -> Result<(), Failure> {
    input::each_line(source, LINE_BYTES_MAX, |line, json| {
        let wrong = |problem: Problem| {
            let (what, text) = (problem.detail(), input::excerpt(json));
            format!("line {line}: {what} (a line is like {{\"id\":1,\"at\":[0,0,2.5]}}): {text}")
        };
        match decode::file_line(json).map_err(wrong)? {
            LineOperation::Insert(NewCube { id, at }) => {
                cubes.insert_at(line, id.map(|id| id.id.0), at)
            }
            LineOperation::Delete(id) => cubes.push(line, Op::Delete(id.id)),
        }
    })
}

fn read_i32(mut source: impl Read, cubes: &mut Batches<'_>) -> Result<(), Failure> {
    let mut triplet = [0; 12];
    for number in 1.. {
        let size = fill(&mut source, &mut triplet)?;
        if size == 0 {
            break;
        }
        if size < triplet.len() {
            return Err(format!(
                "it ends {size} bytes into cube {number}: the size of such a file is a multiple of 12 bytes"
            )
            .into());
        }
        let mut corner = [0; 3];
        for (to, bytes) in corner.iter_mut().zip(triplet.as_chunks().0) {
            *to = i64::from(i32::from_le_bytes(*bytes));
        }
        let place = Place::new(corner, cubes.edge())
            .map_err(|invalid: InvalidCube| format!("cube {number}: {invalid}"))?;
        cubes.insert(place)?;
    }
    Ok(())
}

/// Reads until the buffer is full or the input ends.
fn fill(source: &mut impl Read, buffer: &mut [u8]) -> std::io::Result<usize> {
    let mut size = 0;
    while size < buffer.len() {
        match source.read(&mut buffer[size..]) {
            Ok(0) => break,
            Ok(more) => size += more,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(size)
}
