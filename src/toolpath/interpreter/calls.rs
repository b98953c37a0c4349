//! Subprograms by their numbers: M98, M97 and M99, and what every call has in common.

use super::super::expression::Reader;
use super::super::flow::{Keyword, Label};
use super::{Callee, Frame, Interpreter, InvalidLine, Position};

/// How deep calls may stand in each other.
const CALLS_MAX: usize = 64;

impl Interpreter {
    /// M98: a program of this file by its number.
    pub(super) fn call_program(
        &mut self,
        at: Position,
        number: u64,
        times: u64,
    ) -> Result<(), InvalidLine> {
        let wanted = Label::Number(number);
        let found = self.sources[at.source]
            .controls
            .iter()
            .find(|control| control.keyword == Keyword::Header && control.label == wanted);
        let Some(line) = found.map(|control| control.line + 1) else {
            return Err(self.fault(at, 0, format!("there is no program O{number} in this file")));
        };
        self.enter_program(at, Position { line, ..at }, times)
    }

    /// M97: the lines from a number on.
    pub(super) fn call_line(
        &mut self,
        at: Position,
        number: u64,
        times: u64,
    ) -> Result<(), InvalidLine> {
        let text = &self.sources[at.source].text;
        let numbered = |line: &[u8]| {
            let mut reader = Reader::new(line);
            reader.take(b'N')
                && reader
                    .literal()
                    .is_ok_and(|(found, _)| found.to_bits() == number_of(number).to_bits())
        };
        let Some(line) = text.lines().position(numbered) else {
            return Err(self.fault(at, 0, format!("there is no line N{number}")));
        };
        self.enter_program(at, Position { line, ..at }, times)
    }

    fn enter_program(
        &mut self,
        at: Position,
        start: Position,
        times: u64,
    ) -> Result<(), InvalidLine> {
        if times == 0 {
            return Ok(());
        }
        self.enter(
            at,
            Callee::Program {
                start,
                left: times - 1,
            },
            start,
        )
    }

    pub(super) fn enter(
        &mut self,
        at: Position,
        callee: Callee,
        start: Position,
    ) -> Result<(), InvalidLine> {
        if self.frames.len() > CALLS_MAX {
            let what = format!("more than {CALLS_MAX} calls in each other");
            return Err(self.fault(at, 0, what));
        }
        self.frames.push(Frame {
            callee,
            back: Position {
                line: at.line + 1,
                ..at
            },
            loops: Vec::new(),
            modes: None,
        });
        self.at = start;
        Ok(())
    }

    /// M99.
    pub(super) fn return_from_program(&mut self, at: Position) -> Result<(), InvalidLine> {
        match &mut self.frame().callee {
            Callee::Program {
                start,
                left: left @ 1..,
            } => {
                *left -= 1;
                let start = *start;
                self.at = start;
                Ok(())
            }
            Callee::Program { .. } => {
                self.leave();
                Ok(())
            }
            Callee::Sub { label, .. } => {
                let what = format!("M99 in {label} sub: endsub or return ends it");
                Err(self.fault(at, 0, what))
            }
            Callee::Main => {
                let number = self.line().saturating_sub(1);
                self.machine.report(
                    number,
                    "M99",
                    "in the main program would run it again and again; it ends here",
                    &mut self.waiting,
                );
                self.end()
            }
        }
    }

    pub(super) fn leave(&mut self) {
        let frame = self.frames.pop().expect("a call is open");
        if let Callee::Sub { kept, .. } = &frame.callee {
            self.parameters.leave(kept);
        }
        if let Some(modes) = frame.modes {
            self.machine.restore(modes);
        }
        self.at = frame.back;
    }
}

#[expect(clippy::cast_precision_loss, reason = "at most eight digits")]
fn number_of(number: u64) -> f64 {
    number as f64
}
