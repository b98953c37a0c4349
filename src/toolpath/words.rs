//! One line of text to its words, by the `gcode` crate.
//!
//! The crate finds the words; three things are added here. It reads values as `f32`, too coarse for a lattice, so values are
//! read again as `f64` from the span it reports. It lets `(` run on over lines, and it overflows on a code of ten digits; both
//! are refused before it sees the line.

use gcode::core::{
    BlockVisitor, CommandVisitor, ControlFlow, Diagnostics, Number, ProgramVisitor, Span,
    TokenType, Value,
};

/// A letter and its number, such as `X-1.5`.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Word {
    /// Upper case.
    pub(super) letter: char,
    pub(super) value: f64,
    /// From 1, in characters.
    pub(super) column: usize,
}

/// A G or M word. `G91.1` is 911 tenths.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Code {
    /// `G` or `M`.
    pub(super) letter: char,
    pub(super) tenths: u32,
    /// From 1, in characters.
    pub(super) column: usize,
}

impl std::fmt::Display for Code {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{}{}", self.letter, self.tenths / 10)?;
        match self.tenths % 10 {
            0 => Ok(()),
            tenth => write!(formatter, ".{tenth}"),
        }
    }
}

/// The words of one line; line numbers, program numbers, tool numbers and comments are left out.
#[derive(Clone, PartialEq, Debug, Default)]
pub(super) struct Block {
    pub(super) codes: Vec<Code>,
    pub(super) words: Vec<Word>,
    /// Whether there is a `%`, the mark around a program.
    pub(super) percent: bool,
    /// Whether the line begins with `/`: it is left out, as on a machine whose block delete switch is on.
    pub(super) deleted: bool,
}

impl Block {
    pub(super) fn is_empty(&self) -> bool {
        self.codes.is_empty() && self.words.is_empty()
    }
}

/// What cannot be read in a line, and where.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Unreadable {
    /// From 1, in characters.
    pub(super) column: usize,
    pub(super) what: String,
}

/// Reads one line (without its end).
///
/// # Errors
/// [`Unreadable`] names the first thing that is no word.
pub(super) fn read(line: &str) -> Result<Block, Unreadable> {
    if line.trim_start().starts_with('/') {
        return Ok(Block {
            deleted: true,
            ..Block::default()
        });
    }
    check_comments_and_digits(line)?;
    let mut collector = Collector {
        line,
        block: Block::default(),
        open_code: None,
        problem: None,
    };
    gcode::core::parse(line, &mut collector);
    match collector.problem {
        Some(problem) => Err(problem),
        None => Ok(collector.block),
    }
}

/// More digits before the decimal point than any code or coordinate has; ten of them overflow the crate's `u32`.
const WHOLE_DIGITS_MAX: usize = 8;

fn check_comments_and_digits(line: &str) -> Result<(), Unreadable> {
    let mut depth = 0_usize;
    let mut opened = 0;
    let mut digits = 0;
    let mut fraction = false;
    for (index, letter) in line.chars().enumerate() {
        match letter {
            ';' if depth == 0 => break,
            '(' => {
                if depth == 0 {
                    opened = index + 1;
                }
                depth += 1;
            }
            ')' => depth = depth.saturating_sub(1),
            _ => {}
        }
        let digit = letter.is_ascii_digit() && depth == 0;
        fraction = letter == '.' || (fraction && digit);
        digits = if digit && !fraction { digits + 1 } else { 0 };
        if digits > WHOLE_DIGITS_MAX {
            return Err(Unreadable {
                column: index + 1,
                what: format!(
                    "a number has more than {WHOLE_DIGITS_MAX} digits before its decimal point"
                ),
            });
        }
    }
    if depth > 0 {
        return Err(Unreadable {
            column: opened,
            what: "a comment begins with '(' and does not end with ')' on the same line".into(),
        });
    }
    Ok(())
}

/// The crate uses this error in its trait but does not export its name.
type ParseNumberError = <Number as std::str::FromStr>::Err;

struct Collector<'line> {
    line: &'line str,
    block: Block,
    /// The code whose column is not known yet: the crate tells it when the code's own words are over.
    open_code: Option<usize>,
    problem: Option<Unreadable>,
}

impl Collector<'_> {
    fn column(&self, span: Span) -> usize {
        self.line[..span.start].chars().count() + 1
    }

    fn refuse(&mut self, span: Span, what: String) {
        if self.problem.is_none() {
            let column = self.column(span);
            self.problem = Some(Unreadable { column, what });
        }
    }

    fn word(&mut self, letter: char, span: Span) {
        let text: String = self.line[span.start..span.end()]
            .chars()
            .skip(1)
            .filter(|letter| !letter.is_whitespace())
            .collect();
        match text.parse() {
            Ok(value) => self.block.words.push(Word {
                letter: letter.to_ascii_uppercase(),
                value,
                column: self.column(span),
            }),
            Err(_) => self.refuse(span, format!("{letter}{text} is not a number")),
        }
    }

    fn code(&mut self, letter: char, number: Number) {
        self.open_code = Some(self.block.codes.len());
        let tenth = number.minor().map_or(0, std::num::NonZeroU32::get);
        self.block.codes.push(Code {
            letter,
            tenths: number.major() * 10 + tenth,
            column: 1,
        });
    }
}

impl Diagnostics for &mut Collector<'_> {
    fn emit_unknown_content(&mut self, text: &str, span: Span) {
        self.refuse(span, unknown(text));
    }

    fn emit_unexpected(&mut self, actual: &str, expected: &[TokenType], span: Span) {
        let what = if actual.starts_with(|letter: char| letter.is_ascii_digit() || letter == '.') {
            format!("the number {actual} has no letter before it")
        } else if expected.contains(&TokenType::Number) || expected.contains(&TokenType::Eof) {
            format!(
                "{actual:?} where a number was expected (parameters and expressions are not supported)"
            )
        } else {
            unknown(actual)
        };
        self.refuse(span, what);
    }

    fn emit_parse_number_error(&mut self, value: &str, _error: ParseNumberError, span: Span) {
        self.refuse(span, format!("{value:?} is not the number of a code"));
    }

    fn emit_parse_int_error(&mut self, value: &str, _error: std::num::ParseIntError, span: Span) {
        self.refuse(span, format!("{value:?} is not a whole number"));
    }
}

fn unknown(text: &str) -> String {
    format!("{text:?} is no word of G-code")
}

impl ProgramVisitor for Collector<'_> {
    fn start_block(&mut self) -> ControlFlow<impl BlockVisitor + '_> {
        ControlFlow::Continue(self)
    }
}

impl Diagnostics for Collector<'_> {}

impl BlockVisitor for &mut Collector<'_> {
    fn program_delimiter(&mut self, _span: Span) {
        self.block.percent = true;
    }

    fn word_address(&mut self, letter: char, _value: Value<'_>, span: Span) {
        self.word(letter, span);
    }

    fn start_general_code(&mut self, number: Number) -> ControlFlow<impl CommandVisitor + '_> {
        self.code('G', number);
        ControlFlow::Continue(&mut **self)
    }

    fn start_miscellaneous_code(
        &mut self,
        number: Number,
    ) -> ControlFlow<impl CommandVisitor + '_> {
        self.code('M', number);
        ControlFlow::Continue(&mut **self)
    }

    fn start_tool_change_code(&mut self, _number: Number) -> ControlFlow<impl CommandVisitor + '_> {
        self.open_code = None;
        ControlFlow::Continue(&mut **self)
    }
}

impl CommandVisitor for &mut Collector<'_> {
    fn argument(&mut self, letter: char, _value: Value<'_>, span: Span) {
        self.word(letter, span);
    }

    fn end_command(self, span: Span) {
        if let Some(index) = self.open_code.take() {
            self.block.codes[index].column = self.column(span);
        }
    }
}
