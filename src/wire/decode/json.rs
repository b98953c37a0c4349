//! JSON to documents: fast when the body is good, and with all its faults when it is not.
//!
//! ```text
//!   body ── serde, stops at the first fault ── document ── checked ── (good input: fast, no waste)
//!      └─── on a fault: again, by `recover` ── 400 or 422            (names the first hundred faults)
//! ```

use std::borrow::Cow;

use serde::de::DeserializeOwned;
use serde_json::value::RawValue;

use super::recover;
use crate::wire::problem::{Code, Faults, Problem};

/// Reads a body that is one document of few elements. `check` notes what is wrong with a document that can be read, or has stand-ins
/// where the faults say so.
/// # Errors
/// [`Code::BadJson`], or [`Code::Invalid`] with every fault.
pub(super) fn read<T: DeserializeOwned>(
    body: &[u8],
    check: impl Fn(&T, &mut Faults),
) -> Result<T, Problem> {
    if let Ok(document) = serde_json::from_slice(body) {
        let mut faults = Faults::default();
        check(&document, &mut faults);
        if faults.is_empty() {
            return Ok(document);
        }
    }
    let body = text(body)?;
    let (document, faults) = examine(parse(&body)?, usize::MAX, check);
    complete(document, faults)
}

/// The same of a body that is one line of many, whose number the caller knows.
/// # Errors
/// As of [`read`], without a line.
pub(super) fn read_line<T: DeserializeOwned>(
    line: &[u8],
    check: impl Fn(&T, &mut Faults),
) -> Result<T, Problem> {
    if let Ok(document) = serde_json::from_slice(line) {
        let mut faults = Faults::default();
        check(&document, &mut faults);
        if faults.is_empty() {
            return Ok(document);
        }
    }
    let text = text(line).map_err(on_one_line)?;
    let raw = parse(&text).map_err(on_one_line)?;
    let (document, faults) = examine(raw, usize::MAX, check);
    complete(document, faults)
}

/// The caller knows which line it is, here there is only one.
pub(super) fn on_one_line(unreadable: Unreadable) -> Problem {
    let Unreadable {
        message, column, ..
    } = unreadable;
    Problem::new(Code::BadJson, format!("column {column}: {message}")).with("column", column)
}

/// Reads a value with all its faults, and shows beside each what was sent there.
pub(super) fn examine<T: DeserializeOwned>(
    raw: &RawValue,
    elements_max: usize,
    check: impl FnOnce(&T, &mut Faults),
) -> (Option<T>, Faults) {
    let (document, mut faults) = recover::read(raw, elements_max);
    if let Some(document) = &document {
        check(document, &mut faults);
    }
    recover::show_values(raw, &mut faults);
    (document, faults)
}

/// The document, if it has no fault.
pub(super) fn complete<T>(document: Option<T>, faults: Faults) -> Result<T, Problem> {
    match document {
        Some(document) if faults.is_empty() => Ok(document),
        _ => Err(faults.into_problem()),
    }
}

/// What is no JSON, and where reading stopped.
pub(super) struct Unreadable {
    pub(super) message: String,
    pub(super) line: usize,
    pub(super) column: usize,
}

impl From<Unreadable> for Problem {
    fn from(unreadable: Unreadable) -> Self {
        let Unreadable {
            message,
            line,
            column,
        } = unreadable;
        let detail = format!("line {line}, column {column}: {message}");
        Problem::new(Code::BadJson, detail)
            .with("line", line)
            .with("column", column)
    }
}

/// A text that can be read as JSON. NaN and infinities, which some writers put out, are made strings: what is wrong with them
/// is that they are no numbers, and that has a place.
pub(super) fn text(body: &[u8]) -> Result<Cow<'_, str>, Unreadable> {
    let text = std::str::from_utf8(body).map_err(|error| {
        let before = &body[..error.valid_up_to()];
        let line_ends = before.iter().filter(|byte| **byte == b'\n');
        let line = before.rsplit(|byte| *byte == b'\n').next();
        Unreadable {
            message: "a byte that is not UTF-8".to_owned(),
            line: line_ends.count() + 1,
            column: line.map_or(0, <[u8]>::len) + 1,
        }
    })?;
    let Err(error) = parse(text) else {
        return Ok(Cow::Borrowed(text));
    };
    let quoted = quote_non_finite(text);
    match parse(&quoted) {
        Ok(_) => Ok(Cow::Owned(quoted)),
        Err(_) => Err(error),
    }
}

/// The whole text as one value, its syntax checked.
pub(super) fn parse(text: &str) -> Result<&RawValue, Unreadable> {
    serde_json::from_str(text).map_err(|error| {
        // Display ends with the place, which is said in front here.
        let message = error.to_string();
        let message = message.split(" at line ").next().unwrap_or_default();
        Unreadable {
            message: message.to_owned(),
            line: error.line(),
            column: error.column(),
        }
    })
}

fn quote_non_finite(text: &str) -> String {
    let mut quoted = String::with_capacity(text.len() + 64);
    let (mut in_string, mut escaped) = (false, false);
    let mut rest = text;
    while let Some(next) = rest.chars().next() {
        let word = ["NaN", "Infinity", "-Infinity"]
            .into_iter()
            .find(|word| !in_string && rest.starts_with(word));
        let taken = word.map_or(next.len_utf8(), str::len);
        if let Some(word) = word {
            quoted.extend(["\"", word, "\""]);
        } else {
            quoted.push(next);
            in_string ^= next == '"' && !escaped;
            escaped = in_string && next == '\\' && !escaped;
        }
        rest = &rest[taken..];
    }
    quoted
}
