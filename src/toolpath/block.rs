//! One line of a program to its words.

use super::codes::Code;
use super::expression::{Name, Reader, Unreadable, Values};

/// The words of one line: at most one of each letter but G and M, and the parameters it sets.
#[derive(Debug, Default)]
pub(super) struct Block {
    values: [f64; 26],
    offsets: [u32; 26],
    /// A bit for each letter that stands on the line, for each used up, and for each whose number has a decimal point.
    given: u32,
    used: u32,
    pointed: u32,
    pub(super) codes: Vec<Code>,
    /// Radius (`@`) and angle (`^`) of a target, and where the first of them stands.
    pub(super) polar: [Option<f64>; 2],
    pub(super) polar_offset: usize,
    /// What is set once the line is read.
    pub(super) assignments: Vec<(Name, f64)>,
    /// The line asks for the program to be given up (a comment `(ABORT, ..)`), and why.
    pub(super) abort: Option<String>,
    /// A part of the line was left out because of a `/`.
    pub(super) deleted: bool,
    /// The rest of the line follows a `/`, and it was run.
    pub(super) kept: bool,
}

/// How a line is read.
#[derive(Clone, Copy, Debug)]
pub(super) struct Manner {
    /// Whether what follows a `/` is left out.
    pub(super) delete: bool,
    /// Whether `E` may follow a number without a space, as printers write it.
    pub(super) extruder: bool,
}

const fn bit(letter: char) -> u32 {
    1 << place(letter)
}

const fn place(letter: char) -> usize {
    letter as usize - 'A' as usize
}

/// Letters of the words that say where a move ends.
pub(super) const AXES: [char; 3] = ['X', 'Y', 'Z'];
pub(super) const AXIS_BITS: u32 = bit('X') | bit('Y') | bit('Z');

impl Block {
    /// Whether there is nothing to do.
    pub(super) fn is_empty(&self) -> bool {
        self.given == 0 && self.codes.is_empty() && self.polar == [None; 2]
    }

    pub(super) fn has(&self, letter: char) -> bool {
        self.given & !self.used & bit(letter) != 0
    }

    /// Whether a word of X, Y or Z is left.
    pub(super) fn has_axes(&self) -> bool {
        self.given & !self.used & AXIS_BITS != 0 || self.polar != [None; 2]
    }

    /// Whether a word of X, Y or Z is on the line and used up.
    pub(super) fn has_used_axes(&self) -> bool {
        self.given & self.used & AXIS_BITS != 0
    }

    /// The value of a word that nothing has used yet.
    pub(super) fn get(&self, letter: char) -> Option<f64> {
        self.has(letter).then(|| self.values[place(letter)])
    }

    /// The same, used up.
    pub(super) fn take(&mut self, letter: char) -> Option<f64> {
        let value = self.get(letter);
        self.used |= bit(letter);
        value
    }

    /// Whether the number of a word has a decimal point.
    pub(super) fn has_point(&self, letter: char) -> bool {
        self.pointed & bit(letter) != 0
    }

    /// Where a word stands: an offset in bytes; the start of the line if it is not there.
    pub(super) fn offset(&self, letter: char) -> usize {
        if self.given & bit(letter) == 0 {
            return 0;
        }
        self.offsets[place(letter)] as usize
    }

    /// Letters that nothing has used.
    pub(super) fn left(&self) -> impl Iterator<Item = (char, f64)> + use<> {
        let (left, values) = (self.given & !self.used, self.values);
        ('A'..='Z')
            .filter(move |letter| left & bit(*letter) != 0)
            .map(move |letter| (letter, values[place(letter)]))
    }

    /// Reads the rest of a line from `at` on.
    ///
    /// # Errors
    /// [`Unreadable`] names the first thing that is no word.
    pub(super) fn read(
        &mut self,
        reader: &mut Reader<'_>,
        manner: Manner,
        values: &impl Values,
    ) -> Result<(), Unreadable> {
        self.clear();
        loop {
            let start = reader.at;
            match reader.peek() {
                0 | b';' => return Ok(()),
                b'(' => self.comment(reader)?,
                b'/' if reader.rest_is_comment() => return Ok(()),
                b'/' if manner.delete => {
                    self.deleted = true;
                    return Ok(());
                }
                b'/' => {
                    self.kept = true;
                    reader.at += 1;
                }
                b'*' => return reader.check_sum(),
                b'#' => self.assignment(reader, values)?,
                mark @ (b'@' | b'^') => {
                    let offset = reader.at;
                    reader.at += 1;
                    let (value, _) = reader.value(values)?;
                    let place = usize::from(mark == b'^');
                    if self.polar == [None; 2] {
                        self.polar_offset = offset;
                    }
                    if self.polar[place].replace(value).is_some() {
                        let what = format!("{} stands twice on one line", char::from(mark));
                        return reader.fail_at(offset, what);
                    }
                }
                letter @ b'A'..=b'Z' => self.word(letter, reader, manner, values)?,
                digit @ (b'0'..=b'9' | b'.' | b'+' | b'-') => {
                    let what = format!(
                        "the number at {} has no letter before it",
                        char::from(digit)
                    );
                    return reader.fail(what);
                }
                b',' => {
                    return reader.fail("corners cut or rounded by ,C or ,R are not supported");
                }
                _ => {
                    let what = format!("{:?} is no word of G-code", reader.character());
                    return reader.fail_at(start.max(reader.at), what);
                }
            }
        }
    }

    fn clear(&mut self) {
        self.given = 0;
        self.used = 0;
        self.pointed = 0;
        self.codes.clear();
        self.polar = [None; 2];
        self.assignments.clear();
        self.abort = None;
        self.deleted = false;
        self.kept = false;
    }

    fn word(
        &mut self,
        letter: u8,
        reader: &mut Reader<'_>,
        manner: Manner,
        values: &impl Values,
    ) -> Result<(), Unreadable> {
        let offset = reader.at;
        for (statement, what) in STATEMENTS {
            if letter == statement.as_bytes()[0] && reader.take_word(statement) {
                return reader.fail_at(offset, what);
            }
        }
        reader.at += 1;
        let (value, has_point) = reader.value(values)?;
        if letter == b'G' || letter == b'M' {
            return self.code(letter, value, offset, reader);
        }
        let name = char::from(letter);
        if !manner.extruder && reader.exponent_follows() {
            return reader.fail_at(
                offset,
                format!("{name} has a number with an exponent, which G-code does not know"),
            );
        }
        if self.given & bit(name) != 0 {
            return reader.fail_at(offset, format!("{name} stands twice on one line"));
        }
        self.given |= bit(name);
        if has_point {
            self.pointed |= bit(name);
        }
        self.values[place(name)] = value;
        self.offsets[place(name)] = u32::try_from(offset).expect("lines are shorter");
        Ok(())
    }

    fn code(
        &mut self,
        letter: u8,
        value: f64,
        offset: usize,
        reader: &Reader<'_>,
    ) -> Result<(), Unreadable> {
        let tenths = (value * 10.0).round();
        if (value * 10.0 - tenths).abs() > 1e-3 || !(0.0..10_000.0).contains(&tenths) {
            let what = format!("{value} is not the number of a code");
            return reader.fail_at(offset, what);
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "whole and in range"
        )]
        let tenths = tenths as u16;
        self.codes.push(Code {
            letter: char::from(letter),
            tenths,
            column: u32::try_from(offset).expect("lines are shorter"),
        });
        Ok(())
    }

    fn assignment(
        &mut self,
        reader: &mut Reader<'_>,
        values: &impl Values,
    ) -> Result<(), Unreadable> {
        reader.at += 1;
        let name = reader.parameter_name(values)?;
        if !reader.take(b'=') {
            return reader.fail("a parameter that stands alone must be set by =");
        }
        let (value, _) = reader.value(values)?;
        self.assignments.push((name, value));
        Ok(())
    }

    fn comment(&mut self, reader: &mut Reader<'_>) -> Result<(), Unreadable> {
        let text = reader.comment()?;
        let mut parts = text.splitn(2, |byte| *byte == b',');
        let active = parts.next().unwrap_or_default().trim_ascii();
        if active.eq_ignore_ascii_case(b"abort") {
            let message = parts.next().unwrap_or_default().trim_ascii();
            self.abort = Some(String::from_utf8_lossy(message).into_owned());
        }
        Ok(())
    }
}

/// Statements of other languages that begin with letters of G-code.
const STATEMENTS: [(&str, &str); 6] = [
    ("IF[", "IF of Fanuc's macro language is not supported"),
    ("GOTO", "GOTO of Fanuc's macro language is not supported"),
    ("WHILE[", "WHILE of Fanuc's macro language is not supported"),
    ("END", "END of Fanuc's macro language is not supported"),
    ("SETVN", "SETVN of Fanuc's macro language is not supported"),
    ("POPEN", "printing is not supported"),
];

impl<'line> Reader<'line> {
    /// A comment in brackets, read to its end: what stands in it.
    pub(super) fn comment(&mut self) -> Result<&'line [u8], Unreadable> {
        let start = self.at;
        let mut depth = 0_usize;
        for (length, byte) in self.line()[start..].iter().enumerate() {
            match byte {
                b'(' => depth += 1,
                b')' => depth -= 1,
                _ => {}
            }
            if depth == 0 {
                self.at = start + length + 1;
                return Ok(&self.line()[start + 1..start + length]);
            }
        }
        self.fail("a comment begins with '(' and does not end with ')' on the same line")
    }

    /// `//` begins a comment of some editors.
    fn rest_is_comment(&self) -> bool {
        self.line()[self.at..].starts_with(b"//")
    }

    /// Whether an exponent stands right behind the number just read.
    fn exponent_follows(&self) -> bool {
        let (before, rest) = self.line().split_at(self.at);
        let after_digit = before
            .last()
            .is_some_and(|byte| byte.is_ascii_digit() || *byte == b'.');
        match rest {
            [b'e' | b'E', b'+' | b'-', digit, ..] | [b'e' | b'E', digit, ..] => {
                after_digit && digit.is_ascii_digit()
            }
            _ => false,
        }
    }

    /// The checksum of senders: `*` and the exclusive or of all bytes before it.
    fn check_sum(&mut self) -> Result<(), Unreadable> {
        let star = self.at;
        let sum = self.line()[..star].iter().fold(0, |sum, byte| sum ^ byte);
        self.at += 1;
        let (said, _) = self.literal()?;
        if self.peek() != 0 && self.peek() != b';' {
            return self.fail("nothing may follow a checksum");
        }
        if said.to_bits() == f64::from(sum).to_bits() {
            return Ok(());
        }
        self.fail_at(
            star,
            format!("the checksum is {said}, but the line has {sum}"),
        )
    }

    /// The character that stands here.
    fn character(&self) -> char {
        let rest = &self.line()[self.at..];
        let text = String::from_utf8_lossy(&rest[..rest.len().min(4)]);
        text.chars().next().unwrap_or(' ')
    }
}
