//! How the commands that read G-code are told to read it.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::ValueEnum;

use super::cutter::Unit;
use super::input;
use union3d::toolpath::{
    Dialect, Interpreter, Options, RapidPath, StockComment, ToolTable, bit, bits,
};

type Failure = Box<dyn std::error::Error>;

/// How a program is read.
#[derive(Debug, clap::Args)]
pub(crate) struct ProgramArgs {
    /// The controller the program is written for [default: guessed from the text].
    #[arg(long, value_name = "NAME", value_parser = dialect)]
    dialect: Option<Dialect>,
    /// Whether what follows a / on a line is left out [default: on; off for grbl and marlin].
    #[arg(long, value_name = "SWITCH", value_enum)]
    block_delete: Option<Switch>,
    /// A tool, such as `T1=flat:6,length=22,holder=40x30`. Repeat it for each.
    #[arg(long, value_name = "TOOL")]
    tool: Vec<String>,
    /// A file of tools: a tool.tbl of `LinuxCNC`, a library of Fusion 360 (JSON), a library of `FreeCAD` (.fctl), or one of its bits as
    /// `T1=FILE.fctb`. Repeat it for each.
    #[arg(long, value_name = "FILE")]
    tools: Vec<String>,
    /// Unit of --tool, and of a tool.tbl [default: that of the scene, mm where there is none].
    #[arg(long, value_enum)]
    tools_unit: Option<Unit>,
    /// Where a work system begins, in mm, such as `G55=0,20,0`: needed where a program uses several. Repeat it for each.
    #[arg(long, value_name = "SYSTEM=X,Y,Z", value_parser = origin, allow_hyphen_values = true)]
    origin: Vec<(usize, [f64; 3])>,
    /// Where the machine's zero and its reference points are, seen from the first work system, in mm: then G28, G30 and G53 are run.
    /// Without it their axes are unknown until the program says them again.
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    home: Option<[f64; 3]>,
    /// How rapids go: straight, or each axis at its own speed (the default of Fanuc and Haas).
    #[arg(long, value_name = "PATH", value_enum, default_value_t = Rapids::Straight)]
    rapid_path: Rapids,
    /// Arcs of round cutters and splines are cut into chords no farther from them than this, in mm.
    #[arg(long, value_name = "LENGTH", value_parser = super::cutter::positive, default_value_t = 0.01)]
    pub(crate) tolerance: f64,
    /// Refuse the program where it would only be warned about.
    #[arg(long)]
    strict: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Switch {
    On,
    Off,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Rapids {
    Straight,
    Dogleg,
}

/// A program about to be run.
pub(crate) struct Opened {
    pub(crate) program: Interpreter,
    /// Bytes of its text.
    pub(crate) size: u64,
    /// What its comments say of the stock.
    pub(crate) stock: StockComment,
}

impl ProgramArgs {
    /// A program about to be run. `unit` is that of its tools where nothing else is said.
    ///
    /// # Errors
    /// When a file cannot be read, or its text is no table of tools.
    pub(crate) fn open(&self, path: &Path, unit: Unit) -> Result<Opened, Failure> {
        let (mut source, _) = input::open(path)?;
        let mut text = Vec::new();
        source.read_to_end(&mut text).map_err(input::about(path))?;
        let size = text.len() as u64;
        let stock = StockComment::of(&text);
        let mut options = self.options(self.tools_unit.unwrap_or(unit).mm())?;
        options.tools.take_comments(&text);
        let directory = path.parent().map(Path::to_owned);
        options.directory = directory.filter(|_| path != Path::new("-"));
        Ok(Opened {
            program: Interpreter::new(text, options),
            size,
            stock,
        })
    }

    /// Whether warnings refuse.
    pub(crate) fn is_strict(&self) -> bool {
        self.strict
    }

    fn options(&self, mm_per_unit: f64) -> Result<Options, Failure> {
        let mut options = Options {
            dialect: self.dialect,
            block_delete: self.block_delete.map(|switch| switch == Switch::On),
            home: self.home,
            rapid_path: match self.rapid_path {
                Rapids::Straight => RapidPath::Straight,
                Rapids::Dogleg => RapidPath::Dogleg,
            },
            tolerance: self.tolerance,
            strict: self.strict,
            ..Options::default()
        };
        for (system, origin) in &self.origin {
            if options.origins[*system].replace(*origin).is_some() {
                return Err(format!("--origin gives work system {} twice", system + 1).into());
            }
        }
        if self.home.is_some() && !self.origin.is_empty() {
            return Err("--home goes without --origin: both say where the work systems are".into());
        }
        for file in &self.tools {
            read_tools(file, mm_per_unit, &mut options.tools)?;
        }
        let mut numbers = BTreeSet::new();
        for tool in &self.tool {
            let defined = options.tools.define(tool, mm_per_unit);
            let number = defined.map_err(|wrong| format!("--tool {tool}: {wrong}"))?;
            if !numbers.insert(number) {
                return Err(format!("--tool gives T{number} twice").into());
            }
        }
        Ok(options)
    }
}

/// Reads a file of tools, whatever it is.
fn read_tools(file: &str, mm_per_unit: f64, tools: &mut ToolTable) -> Result<(), Failure> {
    let (number, path) = match file.split_once('=') {
        Some((number, path)) if number.starts_with(['T', 't']) => {
            let parsed = number[1..].parse::<u32>();
            let number = parsed.map_err(|_| format!("--tools: {number} is no number of a tool"))?;
            (Some(number), Path::new(path))
        }
        _ => (None, Path::new(file)),
    };
    let about = |wrong: String| format!("{}: {wrong}", path.display());
    let text = read(path)?;
    if let Some(number) = number {
        return Ok(tools.add_bit(number, bit(&text).map_err(about)?)?);
    }
    if path.extension().is_some_and(|ending| ending == "fctb") {
        return Err(about("a bit has no number: give it as T1=FILE".into()).into());
    }
    let Some(bits) = bits(&text) else {
        return Ok(tools.add(&text, mm_per_unit).map_err(about)?);
    };
    for (number, name) in bits {
        let found = bit_beside(path, &name)
            .ok_or_else(|| about(format!("there is no {name}, the bit of T{number}")))?;
        let bit = bit(&read(&found)?).map_err(|wrong| format!("{}: {wrong}", found.display()))?;
        tools.add_bit(number, bit).map_err(about)?;
    }
    Ok(())
}

fn read(path: &Path) -> Result<String, String> {
    std::fs::read_to_string(path).map_err(input::about(path))
}

/// The file of a bit that a library names: beside the library, or in the directory `Bit` beside the library's own, as `FreeCAD` has them.
fn bit_beside(library: &Path, name: &str) -> Option<PathBuf> {
    let directory = library.parent()?;
    [directory.join(name), directory.join("../Bit").join(name)]
        .into_iter()
        .find(|path| path.is_file())
}

fn dialect(text: &str) -> Result<Dialect, String> {
    Dialect::ALL
        .into_iter()
        .find(|dialect| dialect.name() == text)
        .ok_or_else(|| {
            let names = Dialect::ALL.map(Dialect::name);
            format!("it is none of {}", names.join(", "))
        })
}

/// Three numbers, such as `0,0,-10`.
pub(crate) fn point(text: &str) -> Result<[f64; 3], String> {
    let numbers: Result<Vec<f64>, _> = text
        .split(',')
        .map(|number| number.trim().parse())
        .collect();
    numbers
        .ok()
        .filter(|numbers| numbers.iter().all(|number| number.is_finite()))
        .and_then(|numbers| numbers.try_into().ok())
        .ok_or_else(|| "it is not three numbers, such as 0,0,-10".to_owned())
}

/// A work system and its origin, such as `G55=0,20,0`.
fn origin(text: &str) -> Result<(usize, [f64; 3]), String> {
    const NAMES: [&str; 9] = [
        "G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3",
    ];
    let (name, at) = text
        .split_once('=')
        .ok_or("it is not a work system and its origin, such as G55=0,20,0")?;
    let system = NAMES
        .iter()
        .position(|known| known.eq_ignore_ascii_case(name))
        .ok_or_else(|| format!("{name} is none of {}", NAMES.join(", ")))?;
    Ok((system, point(at)?))
}
