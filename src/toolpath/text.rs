//! The text of a program and its lines, whatever wrote it.
//!
//! Lines end with LF, CR LF or CR alone. A byte order mark and the NULs of a tape's leader are left out, and Ctrl-Z ends the text
//! as it did under DOS. Bytes are never decoded: words are ASCII, and comments may be in any encoding.

use std::ops::Range;

/// Longest line. A file without ends of lines is no program. Units: bytes.
const LINE_BYTES_MAX: usize = 65_536;

/// A text cut into lines.
#[derive(Debug, Default)]
pub(super) struct Text {
    bytes: Vec<u8>,
    /// Where each line begins and ends, without its end mark.
    lines: Vec<Range<usize>>,
}

/// A text that is no program, and the line (from 1) where that shows.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct NoText {
    pub(super) line: u64,
    pub(super) what: &'static str,
}

/// Where the lines of a text are.
pub(super) fn lines_of(bytes: &[u8]) -> impl Iterator<Item = Range<usize>> {
    let mark = bytes.strip_prefix(b"\xef\xbb\xbf").map_or(0, |_| 3);
    let end = bytes
        .iter()
        .position(|byte| *byte == 0x1a)
        .unwrap_or(bytes.len());
    let mut start = mark.min(end);
    std::iter::from_fn(move || {
        let rest = bytes.get(start..end).filter(|rest| !rest.is_empty())?;
        let length = rest.iter().position(|byte| matches!(byte, b'\n' | b'\r'));
        let line = start..start + length.unwrap_or(rest.len());
        let pair = bytes.get(line.end..line.end + 2) == Some(b"\r\n");
        start = line.end + if pair { 2 } else { 1 };
        Some(line)
    })
}

impl Text {
    /// # Errors
    /// [`NoText`] for a line of more than 65,536 bytes, and for a file of nothing but NULs.
    pub(super) fn new(bytes: Vec<u8>) -> Result<Self, NoText> {
        if !bytes.is_empty() && bytes.iter().all(|byte| *byte == 0) {
            let what = "nothing but NULs: this is no text";
            return Err(NoText { line: 1, what });
        }
        let mut lines = Vec::with_capacity(bytes.len() / 24);
        for line in lines_of(&bytes) {
            if line.len() > LINE_BYTES_MAX {
                return Err(NoText {
                    line: lines.len() as u64 + 1,
                    what: "a line without end: this is no G-code",
                });
            }
            lines.push(line);
        }
        Ok(Self { bytes, lines })
    }

    /// How many lines there are.
    pub(super) fn count(&self) -> usize {
        self.lines.len()
    }

    /// A line, from 0.
    pub(super) fn line(&self, index: usize) -> &[u8] {
        &self.bytes[self.lines[index].clone()]
    }

    pub(super) fn lines(&self) -> impl Iterator<Item = &[u8]> {
        self.lines.iter().map(|line| &self.bytes[line.clone()])
    }

    /// Bytes before a line (from 0), or of all.
    pub(super) fn bytes_before(&self, index: usize) -> u64 {
        self.lines
            .get(index)
            .map_or(self.bytes.len(), |line| line.start) as u64
    }
}
