//! What a program does, and what is wrong with it.

use super::path::Move;

/// What a line does.
#[derive(Clone, PartialEq, Debug)]
pub enum Event {
    /// The cutter moves.
    Move(Move),
    /// The cutter stays where it is.
    Dwell {
        /// Line of the program, from 1.
        line: u64,
        /// Number of the tool in the spindle.
        tool: u32,
        /// For how long.
        seconds: f64,
        /// Where it is: what the program has said of x, y and z.
        at: [Option<f64>; 3],
    },
    /// Something was not done as written, or taken for granted.
    Warning(Warning),
}

/// Something that was not done as written, or taken for granted. Said where it first stands; an uneven arc wherever it stands.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error, serde::Serialize)]
#[error("line {line}: {code} {text}")]
pub struct Warning {
    /// Line of the program, from 1.
    pub line: u64,
    /// What it is about, such as `M62` or `uneven-arc`; the same for all warnings of a kind.
    pub code: String,
    /// What was done, or taken for granted.
    pub text: String,
}

/// A line that cannot be run. The program ends there.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{}line {line}, column {column}: {what}: {text:?}", named(.file.as_deref()))]
pub struct InvalidLine {
    /// The file it stands in, when that is not the program itself.
    pub file: Option<String>,
    /// Line of the file, from 1.
    pub line: u64,
    /// Column of the word at fault, from 1, in characters.
    pub column: usize,
    /// The line, cut after 80 characters.
    pub text: String,
    /// What is wrong with it.
    pub what: String,
}

fn named(file: Option<&str>) -> String {
    file.map_or_else(String::new, |file| format!("{file}, "))
}
