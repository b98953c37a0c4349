//! Runs a program line by line: which line comes next, what is called, and what each line is worth.

mod calls;
mod control;

use std::collections::VecDeque;

use super::block::{Block, Manner};
use super::dialect::{self, Dialect};
use super::event::{Event, InvalidLine, Warning};
use super::expression::{Name, Reader, Unreadable, Values};
use super::flow::{self, Control, Keyword, Label};
use super::machine::{After, Machine, Modes};
use super::options::Options;
use super::parameters::{Kept, Parameters, SYSTEM};
use super::text::Text;
use super::tools::ToolTable;

/// Lines run without a move or a dwell before a loop is taken to be endless.
const IDLE_LINES_MAX: u64 = 1_000_000;

/// A program being run: an iterator of what it does. After an error there is nothing more.
#[derive(Debug)]
pub struct Interpreter {
    options: Options,
    dialect: Dialect,
    manner: Manner,
    /// The program, and files it has called.
    sources: Vec<Source>,
    /// The source and line (from 0) that come next.
    at: Position,
    frames: Vec<Frame>,
    parameters: Parameters,
    machine: Machine,
    block: Block,
    waiting: VecDeque<Event>,
    /// A fault found before the first line.
    unreadable: Option<InvalidLine>,
    started: bool,
    done: bool,
    idle: u64,
}

#[derive(Debug)]
struct Source {
    /// None for the program itself.
    name: Option<String>,
    text: Text,
    controls: Vec<Control>,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Position {
    source: usize,
    line: usize,
}

/// A call, or the main program.
#[derive(Debug)]
struct Frame {
    callee: Callee,
    /// The line after the call.
    back: Position,
    loops: Vec<Loop>,
    /// What M73 brings back at the end.
    modes: Option<Modes>,
}

#[derive(Debug)]
enum Callee {
    Main,
    /// By an O-word.
    Sub {
        label: Label,
        kept: Box<Kept>,
    },
    /// By M98 or M97: where it begins and how often it is still to be run.
    Program {
        start: Position,
        left: u64,
    },
}

#[derive(Clone, PartialEq, Eq, Debug)]
struct Loop {
    label: Label,
    /// The line of its first O-word.
    line: usize,
    kind: LoopKind,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum LoopKind {
    While,
    Do,
    /// With the rounds that are left, this one included.
    Repeat(u64),
}

/// Values as a line sees them.
struct Scope<'run> {
    parameters: &'run Parameters,
    machine: &'run Machine,
    call_level: usize,
    line: usize,
    /// Whether a parameter without a value is no zero.
    vacant: bool,
}

impl Values for Scope<'_> {
    fn number(&self, number: u16) -> Result<f64, String> {
        if SYSTEM.contains(&number) {
            return self.machine.parameter(number).ok_or_else(|| {
                format!("parameter #{number} is not known here: it comes from the machine")
            });
        }
        match self.parameters.number(number) {
            None if self.vacant => Err(format!("parameter #{number} has no value")),
            value => Ok(value.unwrap_or(0.0)),
        }
    }

    fn named(&self, name: &str) -> Result<f64, String> {
        let small = |number: usize| f64::from(u32::try_from(number).expect("few"));
        let value = match name {
            "_call_level" => Some(small(self.call_level)),
            "_line" => Some(small(self.line + 1)),
            _ => self
                .machine
                .named(name)
                .or_else(|| self.parameters.named(name)),
        };
        value.ok_or_else(|| format!("parameter #<{name}> has no value"))
    }
}

impl Interpreter {
    /// A program about to be run.
    pub fn new(program: impl Into<Vec<u8>>, options: Options) -> Self {
        let (text, unreadable) = match Text::new(program.into()) {
            Ok(text) => (text, None),
            Err(no_text) => {
                let fault = InvalidLine {
                    file: None,
                    line: no_text.line,
                    column: 1,
                    text: String::new(),
                    what: no_text.what.into(),
                };
                (Text::default(), Some(fault))
            }
        };
        let guess = match options.dialect {
            None => dialect::guess(text.lines()),
            Some(_) => None,
        };
        let guessed = guess.map_or(Dialect::LinuxCnc, |(dialect, ..)| dialect);
        let dialect = options.dialect.unwrap_or(guessed);
        let mut waiting = VecDeque::new();
        if let Some((_, line, sign)) = guess.filter(|_| dialect != Dialect::LinuxCnc) {
            waiting.push_back(Event::Warning(Warning {
                line,
                code: "dialect".into(),
                text: format!(
                    "taken to be {} because of {sign}; --dialect says otherwise",
                    dialect.name()
                ),
            }));
        }
        let manner = Manner {
            delete: options
                .block_delete
                .unwrap_or_else(|| dialect.deletes_blocks()),
            extruder: dialect == Dialect::Marlin,
        };
        let main = Frame {
            callee: Callee::Main,
            back: Position { source: 0, line: 0 },
            loops: Vec::new(),
            modes: None,
        };
        Self {
            machine: Machine::new(dialect, &options),
            options,
            dialect,
            manner,
            sources: vec![Source::new(None, text)],
            at: Position { source: 0, line: 0 },
            frames: vec![main],
            parameters: Parameters::default(),
            block: Block::default(),
            waiting,
            unreadable,
            started: false,
            done: false,
            idle: 0,
        }
    }

    /// How much of the program itself is done. Units: bytes.
    pub fn bytes(&self) -> u64 {
        let line = self.frames.get(1).map_or(self.at, |call| call.back).line;
        self.sources[0].text.bytes_before(line)
    }

    /// The controller it is read for.
    pub fn dialect(&self) -> Dialect {
        self.dialect
    }

    /// The tools, as the program has left them.
    pub fn tools(&self) -> &ToolTable {
        &self.machine.tools
    }

    /// The line of the program itself (from 1) that is run: that of the call, while a file it called is run.
    fn line(&self) -> u64 {
        if self.at.source == 0 {
            return self.at.line as u64 + 1;
        }
        let outside = self
            .frames
            .iter()
            .find(|frame| frame.back.source == 0 && !matches!(frame.callee, Callee::Main));
        outside.map_or(0, |frame| frame.back.line as u64)
    }

    fn fault(&self, at: Position, offset: usize, what: impl Into<String>) -> InvalidLine {
        let source = &self.sources[at.source];
        let line = if at.line < source.text.count() {
            source.text.line(at.line)
        } else {
            b""
        };
        let before = String::from_utf8_lossy(&line[..offset.min(line.len())]);
        let text = String::from_utf8_lossy(line);
        InvalidLine {
            file: source.name.clone(),
            line: at.line as u64 + 1,
            column: before.chars().count() + 1,
            text: text.trim().chars().take(80).collect(),
            what: what.into(),
        }
    }

    /// Runs the next line.
    fn advance(&mut self) -> Result<(), InvalidLine> {
        let at = self.at;
        if at.line >= self.sources[at.source].text.count() {
            return self.end_of_text();
        }
        self.idle += 1;
        if self.idle > IDLE_LINES_MAX {
            return Err(self.fault(at, 0, "the program runs on and on here without a move"));
        }
        let line = self.sources[at.source].text.line(at.line);
        let mut reader = Reader::new(line);
        match reader.peek() {
            b'%' => self.mark(),
            b'$' | b'!' | b'?' | b'~' => {
                let number = self.line();
                self.machine.report(
                    number,
                    "sender",
                    "ignored: a line for the sender or the controller, not for the path",
                    &mut self.waiting,
                );
                self.at.line += 1;
                Ok(())
            }
            b'N' | b'O' | b':' if flow::begins(&mut reader) => {
                let offset = reader.at;
                self.started = true;
                self.control(at, offset)
            }
            0 => {
                self.at.line += 1;
                Ok(())
            }
            _ => self.words(at),
        }
    }

    /// `%`: the first before any words opens the program, with a name perhaps; the next ends it.
    fn mark(&mut self) -> Result<(), InvalidLine> {
        if std::mem::replace(&mut self.started, true) {
            return self.end();
        }
        self.at.line += 1;
        Ok(())
    }

    /// A line of words.
    fn words(&mut self, at: Position) -> Result<(), InvalidLine> {
        let number = self.line();
        let line = self.sources[at.source].text.line(at.line);
        let mut reader = Reader::new(line);
        let scope = Scope {
            parameters: &self.parameters,
            machine: &self.machine,
            call_level: self.frames.len() - 1,
            line: at.line,
            vacant: self.dialect.is_fanuc_like(),
        };
        let read = self.block.read(&mut reader, self.manner, &scope);
        read.map_err(|wrong| self.unreadable(at, wrong))?;
        if self.block.deleted {
            self.machine.report(
                number,
                "block-delete",
                "on: what follows a / is left out; --block-delete off runs it",
                &mut self.waiting,
            );
        }
        if self.block.kept {
            self.machine.report(
                number,
                "block-delete",
                "off: what follows a / is run; --block-delete on leaves it out",
                &mut self.waiting,
            );
        }
        if let Some(message) = self.block.abort.take() {
            return Err(self.fault(at, 0, format!("the program gives up here: {message}")));
        }
        self.at.line += 1;
        let after = if self.block.is_empty() {
            After::Next
        } else {
            self.started = true;
            let before = self.waiting.len();
            let after = self
                .machine
                .run(&mut self.block, number, &mut self.waiting)
                .map_err(|(offset, what)| self.fault(at, offset, what))?;
            if self.waiting.len() > before {
                self.idle = 0;
            }
            after
        };
        for (name, value) in std::mem::take(&mut self.block.assignments) {
            self.set(at, name, value)?;
        }
        match after {
            After::Next => Ok(()),
            After::End => self.end(),
            After::Call { number, times } => self.call_program(at, number, times),
            After::CallLine { number, times } => self.call_line(at, number, times),
            After::Return => self.return_from_program(at),
            After::SaveUntilReturn(modes) => {
                self.frame().modes = Some(modes);
                Ok(())
            }
        }
    }

    fn unreadable(&self, at: Position, wrong: Unreadable) -> InvalidLine {
        self.fault(at, wrong.offset, wrong.what)
    }

    fn set(&mut self, at: Position, name: Name, value: f64) -> Result<(), InvalidLine> {
        match name {
            Name::Number(number) if SYSTEM.contains(&number) => {
                let what =
                    format!("parameter #{number} is kept by the machine and is not set this way");
                return Err(self.fault(at, 0, what));
            }
            Name::Number(number) => self.parameters.set_number(number, value),
            Name::Named(name) => {
                if self.machine.named(&name).is_some() {
                    let what = format!("parameter #<{name}> is kept by the machine and is not set");
                    return Err(self.fault(at, 0, what));
                }
                self.parameters.set_named(name, value);
            }
        }
        Ok(())
    }

    fn frame(&mut self) -> &mut Frame {
        self.frames.last_mut().expect("the main program is there")
    }

    /// The text is over without M2, M30 or M99.
    fn end_of_text(&mut self) -> Result<(), InvalidLine> {
        if self.frames.len() == 1 {
            return self.end();
        }
        let at = self.at;
        let what = match &self.frame().callee {
            Callee::Program { .. } => "the file ends in a subprogram: M99 is missing".to_owned(),
            Callee::Sub { label, .. } => format!("the file ends in {label} sub: endsub is missing"),
            Callee::Main => unreachable!("it is the first frame"),
        };
        Err(self.fault(at, 0, what))
    }

    /// The program ends.
    fn end(&mut self) -> Result<(), InvalidLine> {
        self.done = true;
        let at = self.at;
        let last = Position {
            line: at.line.saturating_sub(1),
            ..at
        };
        let number = self.line().saturating_sub(1);
        self.machine
            .finish(number, &mut self.waiting)
            .map_err(|(offset, what)| self.fault(last, offset, what))?;
        if at.source != 0 || self.frames.len() > 1 {
            return Ok(());
        }
        let text = &self.sources[0].text;
        for line in at.line..text.count() {
            let mut reader = Reader::new(text.line(line));
            match reader.peek() {
                0 | b'%' | b'(' | b';' => {}
                // Subprograms follow.
                b'O' | b':' => break,
                // Haas calls lines by M97, which stand there, too.
                b'N' if self.dialect == Dialect::Haas => break,
                _ => {
                    self.machine.report(
                        line as u64 + 1,
                        "rest",
                        "of the file ignored: it follows the end of the program",
                        &mut self.waiting,
                    );
                    break;
                }
            }
        }
        Ok(())
    }
}

impl Source {
    fn new(name: Option<String>, text: Text) -> Self {
        let controls = flow::controls(&text);
        Self {
            name,
            text,
            controls,
        }
    }

    /// The line where a subprogram is defined.
    fn sub(&self, label: &Label) -> Option<usize> {
        self.controls
            .iter()
            .find(|control| control.keyword == Keyword::Sub && control.label == *label)
            .map(|control| control.line)
    }
}

impl Iterator for Interpreter {
    type Item = Result<Event, InvalidLine>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(fault) = self.unreadable.take() {
            self.done = true;
            return Some(Err(fault));
        }
        loop {
            match self.waiting.pop_front() {
                Some(Event::Warning(warning)) if self.options.strict => {
                    let line = usize::try_from(warning.line.saturating_sub(1)).unwrap_or(0);
                    let what = format!("{} {} (refused by --strict)", warning.code, warning.text);
                    let fault = self.fault(Position { source: 0, line }, 0, what);
                    self.done = true;
                    self.waiting.clear();
                    return Some(Err(fault));
                }
                Some(event) => return Some(Ok(event)),
                None if self.done => return None,
                None => {}
            }
            if let Err(fault) = self.advance() {
                self.done = true;
                self.waiting.clear();
                return Some(Err(fault));
            }
        }
    }
}

impl std::iter::FusedIterator for Interpreter {}
