//! What a program does not say, and whoever runs it does.

use std::path::PathBuf;

use super::dialect::Dialect;
use super::frames::SYSTEMS;
use super::tools::ToolTable;

/// How rapids go.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum RapidPath {
    /// Straight.
    #[default]
    Straight,
    /// Each axis at its own (the same) speed, as Fanuc and Haas do when nothing else is set: an axis with less to go stops earlier.
    Dogleg,
}

/// How a program is read.
#[derive(Clone, Debug)]
pub struct Options {
    /// The controller it is written for; guessed from the text when none is given.
    pub dialect: Option<Dialect>,
    /// Whether what follows a `/` is left out; by the dialect when not given.
    pub block_delete: Option<bool>,
    /// Lengths and diameters of the tools.
    pub tools: ToolTable,
    /// Where G54 to G59.3 begin, in one frame for all. Units: mm.
    pub origins: [Option<[f64; 3]>; SYSTEMS],
    /// Where the machine's zero and reference points are, seen from the first work system. Units: mm.
    pub home: Option<[f64; 3]>,
    /// How rapids go.
    pub rapid_path: RapidPath,
    /// Splines are cut into chords no farther from them than this. Units: mm.
    pub tolerance: f64,
    /// Where files with subprograms are.
    pub directory: Option<PathBuf>,
    /// Whether a warning refuses the program.
    pub strict: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            dialect: None,
            block_delete: None,
            tools: ToolTable::default(),
            origins: [None; SYSTEMS],
            home: None,
            rapid_path: RapidPath::Straight,
            tolerance: 0.01,
            directory: None,
            strict: false,
        }
    }
}
