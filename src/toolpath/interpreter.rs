//! Runs a program line by line: which line comes next, what is called, and what each line is worth.

use std::collections::VecDeque;
use std::path::PathBuf;

use super::block::{Block, Manner};
use super::dialect::{self, Dialect};
use super::event::{Event, Fault, Warning};
use super::expression::{Name, Reader, Unreadable, Values};
use super::flow::{self, Control, Keyword, Label};
use super::frames::SYSTEMS;
use super::machine::{After, Machine, Modes};
use super::parameters::{Kept, Parameters, SYSTEM};
use super::text::Text;
use super::tools::ToolTable;

/// How deep calls may stand in each other.
const CALLS_MAX: usize = 64;

/// Lines run without a move or a dwell before a loop is taken to be endless.
const IDLE_LINES_MAX: u64 = 1_000_000;

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
    unreadable: Option<Fault>,
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
                let fault = Fault {
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

    fn fault(&self, at: Position, offset: usize, what: impl Into<String>) -> Fault {
        let source = &self.sources[at.source];
        let line = if at.line < source.text.count() {
            source.text.line(at.line)
        } else {
            b""
        };
        let before = String::from_utf8_lossy(&line[..offset.min(line.len())]);
        let text = String::from_utf8_lossy(line);
        Fault {
            file: source.name.clone(),
            line: at.line as u64 + 1,
            column: before.chars().count() + 1,
            text: text.trim().chars().take(80).collect(),
            what: what.into(),
        }
    }

    /// Runs the next line.
    fn advance(&mut self) -> Result<(), Fault> {
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
    fn mark(&mut self) -> Result<(), Fault> {
        if std::mem::replace(&mut self.started, true) {
            return self.end();
        }
        self.at.line += 1;
        Ok(())
    }

    /// A line of words.
    fn words(&mut self, at: Position) -> Result<(), Fault> {
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

    fn unreadable(&self, at: Position, wrong: Unreadable) -> Fault {
        self.fault(at, wrong.offset, wrong.what)
    }

    fn set(&mut self, at: Position, name: Name, value: f64) -> Result<(), Fault> {
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
    fn end_of_text(&mut self) -> Result<(), Fault> {
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
    fn end(&mut self) -> Result<(), Fault> {
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
                b'N' if self.called_from(line) => break,
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

    /// Whether M97 may have called a line: programs that use it have their subprograms after the end.
    fn called_from(&self, _line: usize) -> bool {
        self.dialect == Dialect::Haas
    }

    /// M98: a program of this file by its number.
    fn call_program(&mut self, at: Position, number: u64, times: u64) -> Result<(), Fault> {
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
    fn call_line(&mut self, at: Position, number: u64, times: u64) -> Result<(), Fault> {
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

    fn enter_program(&mut self, at: Position, start: Position, times: u64) -> Result<(), Fault> {
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

    fn enter(&mut self, at: Position, callee: Callee, start: Position) -> Result<(), Fault> {
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
    fn return_from_program(&mut self, at: Position) -> Result<(), Fault> {
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

    fn leave(&mut self) {
        let frame = self.frames.pop().expect("a call is open");
        if let Callee::Sub { kept, .. } = &frame.callee {
            self.parameters.leave(kept);
        }
        if let Some(modes) = frame.modes {
            self.machine.restore(modes);
        }
        self.at = frame.back;
    }

    /// A line with an O-word, which stands at `offset`.
    fn control(&mut self, at: Position, offset: usize) -> Result<(), Fault> {
        let bytes = self.sources[at.source].text.line(at.line).to_vec();
        let mut reader = Reader::new(&bytes);
        reader.at = offset;
        let (mut label, mut keyword) =
            flow::read(&mut reader).map_err(|wrong| self.unreadable(at, wrong))?;
        if label == Label::Computed {
            let number = self.value(&mut reader, at)?.round();
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "floats saturate; no label is that large"
            )]
            let number = number as u64;
            label = Label::Number(number);
            keyword = flow::keyword(&mut reader).map_err(|wrong| self.unreadable(at, wrong))?;
            if keyword != Keyword::Call {
                let what = "only a call may have a computed number";
                return Err(self.fault(at, offset, what));
            }
        }
        self.at.line += 1;
        match keyword {
            Keyword::Header => return self.header(at),
            Keyword::Sub => self.jump_behind(at, &label, &[Keyword::EndSub])?,
            Keyword::Call => return self.call(at, &label, &mut reader),
            // A return may have any label, such as that of the branch it stands in.
            Keyword::Return => return self.return_from_sub(at, None, &mut reader),
            Keyword::EndSub => return self.return_from_sub(at, Some(&label), &mut reader),
            Keyword::If => {
                if self.bracket(&mut reader, at)? == 0.0 {
                    self.next_branch(at, &label)?;
                }
            }
            // A branch was run: the others are not.
            Keyword::ElseIf | Keyword::Else => self.jump_behind(at, &label, &[Keyword::EndIf])?,
            Keyword::EndIf => {}
            Keyword::While => self.while_(at, &label, &mut reader)?,
            Keyword::EndWhile => {
                let open = self.innermost(at, &label, "endwhile")?;
                self.at.line = open.line;
            }
            Keyword::Do => self.frame().loops.push(Loop {
                label,
                line: at.line,
                kind: LoopKind::Do,
            }),
            Keyword::Repeat => self.repeat(at, label, &mut reader)?,
            Keyword::EndRepeat => self.end_repeat(at, &label)?,
            Keyword::Break => {
                let open = self.loop_of(at, &label, "break")?;
                self.frame().loops.pop();
                self.at.line = self.line_of_end(at, &open)? + 1;
            }
            Keyword::Continue => {
                let open = self.loop_of(at, &label, "continue")?;
                self.at.line = match open.kind {
                    LoopKind::While => open.line,
                    _ => self.line_of_end(at, &open)?,
                };
            }
        }
        self.rest(&mut reader, at)
    }

    fn repeat(&mut self, at: Position, label: Label, reader: &mut Reader<'_>) -> Result<(), Fault> {
        let rounds = self.bracket(reader, at)?.round();
        if rounds < 1.0 {
            return self.jump_behind(at, &label, &[Keyword::EndRepeat]);
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "floats saturate, and so many rounds never end"
        )]
        let kind = LoopKind::Repeat(rounds as u64);
        self.frame().loops.push(Loop {
            label,
            line: at.line,
            kind,
        });
        Ok(())
    }

    fn end_repeat(&mut self, at: Position, label: &Label) -> Result<(), Fault> {
        let open = self.innermost(at, label, "endrepeat")?;
        let loops = &mut self.frame().loops;
        match (open.kind, loops.last_mut()) {
            (LoopKind::Repeat(left @ 2..), Some(last)) => {
                last.kind = LoopKind::Repeat(left - 1);
                self.at.line = open.line + 1;
            }
            _ => {
                loops.pop();
            }
        }
        Ok(())
    }

    /// The line where a loop ends.
    fn line_of_end(&self, at: Position, open: &Loop) -> Result<usize, Fault> {
        let end = match open.kind {
            LoopKind::While => Keyword::EndWhile,
            LoopKind::Do => Keyword::While,
            LoopKind::Repeat(_) => Keyword::EndRepeat,
        };
        let line = open.line;
        let begin = Position { line, ..at };
        Ok(self.next_control(begin, &open.label, &[end])?.line)
    }

    /// Nothing but a comment may follow.
    fn rest(&self, reader: &mut Reader<'_>, at: Position) -> Result<(), Fault> {
        while reader.peek() == b'(' {
            reader
                .comment()
                .map_err(|wrong| self.unreadable(at, wrong))?;
        }
        match reader.peek() {
            // A bracket is the condition of a branch that is not looked at.
            0 | b';' | b'[' => Ok(()),
            _ => Err(self.fault(at, reader.at, "nothing may follow an o-word but its values")),
        }
    }

    fn value(&self, reader: &mut Reader<'_>, at: Position) -> Result<f64, Fault> {
        let scope = self.scope(at);
        let value = reader.value(&scope);
        value
            .map(|(value, _)| value)
            .map_err(|wrong| self.unreadable(at, wrong))
    }

    fn bracket(&self, reader: &mut Reader<'_>, at: Position) -> Result<f64, Fault> {
        let value = reader.bracket(&self.scope(at));
        value.map_err(|wrong| self.unreadable(at, wrong))
    }

    fn scope(&self, at: Position) -> Scope<'_> {
        Scope {
            parameters: &self.parameters,
            machine: &self.machine,
            call_level: self.frames.len() - 1,
            line: at.line,
            vacant: self.dialect.is_fanuc_like(),
        }
    }

    /// The number of a program: the first begins it, another ends what came before.
    fn header(&mut self, at: Position) -> Result<(), Fault> {
        let first = self.sources[at.source]
            .controls
            .iter()
            .find(|control| control.keyword == Keyword::Header);
        if first.is_some_and(|first| first.line == at.line) && self.idle <= at.line as u64 + 1 {
            return Ok(());
        }
        let what = "another program begins here before the one before has ended (M30, M2 or M99)";
        Err(self.fault(at, 0, what))
    }

    /// The next O-word with a label and one of the keywords, after a line.
    fn next_control(
        &self,
        at: Position,
        label: &Label,
        keywords: &[Keyword],
    ) -> Result<&Control, Fault> {
        let controls = &self.sources[at.source].controls;
        let from = controls.partition_point(|control| control.line <= at.line);
        controls[from..]
            .iter()
            .find(|control| control.label == *label && keywords.contains(&control.keyword))
            .ok_or_else(|| {
                let what = format!(
                    "{label} is not closed: {:?} is missing",
                    keywords[keywords.len() - 1]
                );
                self.fault(at, 0, what.to_lowercase())
            })
    }

    fn jump_behind(
        &mut self,
        at: Position,
        label: &Label,
        keywords: &[Keyword],
    ) -> Result<(), Fault> {
        self.at.line = self.next_control(at, label, keywords)?.line + 1;
        Ok(())
    }

    /// Goes on at the branch whose condition holds, or behind the last.
    fn next_branch(&mut self, at: Position, label: &Label) -> Result<(), Fault> {
        let mut from = at;
        loop {
            let branches = [Keyword::ElseIf, Keyword::Else, Keyword::EndIf];
            let next = self.next_control(from, label, &branches)?;
            let (line, keyword) = (next.line, next.keyword);
            from.line = line;
            self.at.line = line + 1;
            if keyword != Keyword::ElseIf {
                return Ok(());
            }
            let bytes = self.sources[from.source].text.line(line).to_vec();
            let mut reader = Reader::new(&bytes);
            flow::begins(&mut reader);
            flow::read(&mut reader).map_err(|wrong| self.unreadable(from, wrong))?;
            if self.bracket(&mut reader, from)? != 0.0 {
                return Ok(());
            }
        }
    }

    /// Begins or goes on with a while loop, or ends a do loop.
    fn while_(
        &mut self,
        at: Position,
        label: &Label,
        reader: &mut Reader<'_>,
    ) -> Result<(), Fault> {
        let holds = self.bracket(reader, at)? != 0.0;
        let open = self
            .frame()
            .loops
            .last()
            .filter(|open| open.label == *label)
            .cloned();
        match open {
            Some(Loop {
                kind: LoopKind::Do,
                line,
                ..
            }) => {
                if holds {
                    self.at.line = line + 1;
                } else {
                    self.frame().loops.pop();
                }
            }
            Some(Loop {
                kind: LoopKind::While,
                line,
                ..
            }) if line == at.line => {
                if !holds {
                    self.frame().loops.pop();
                    self.jump_behind(at, label, &[Keyword::EndWhile])?;
                }
            }
            _ if holds => self.frame().loops.push(Loop {
                label: label.clone(),
                line: at.line,
                kind: LoopKind::While,
            }),
            _ => self.jump_behind(at, label, &[Keyword::EndWhile])?,
        }
        Ok(())
    }

    /// The innermost loop, which must have the label.
    fn innermost(&mut self, at: Position, label: &Label, word: &str) -> Result<Loop, Fault> {
        let open = self
            .frame()
            .loops
            .last()
            .filter(|open| open.label == *label)
            .cloned();
        open.ok_or_else(|| self.fault(at, 0, format!("{label} {word} closes no open loop")))
    }

    /// The open loop with the label; those in it are given up.
    fn loop_of(&mut self, at: Position, label: &Label, word: &str) -> Result<Loop, Fault> {
        let loops = &mut self.frame().loops;
        let Some(place) = loops.iter().rposition(|open| open.label == *label) else {
            return Err(self.fault(at, 0, format!("{label} {word} stands in no such loop")));
        };
        loops.truncate(place + 1);
        Ok(loops[place].clone())
    }

    fn call(&mut self, at: Position, label: &Label, reader: &mut Reader<'_>) -> Result<(), Fault> {
        let mut arguments = Vec::new();
        while reader.peek() == b'[' {
            arguments.push(self.bracket(reader, at)?);
        }
        if arguments.len() > super::parameters::ARGUMENTS {
            return Err(self.fault(at, reader.at, "a call has at most 30 values"));
        }
        self.rest(reader, at)?;
        let start = self.find_sub(at, label)?;
        let kept = self.parameters.enter(&arguments);
        let callee = Callee::Sub {
            label: label.clone(),
            kept: Box::new(kept),
        };
        self.enter(at, callee, start)
    }

    /// Where a subprogram begins: in this file, in those read so far, or in a file of its name.
    fn find_sub(&mut self, at: Position, label: &Label) -> Result<Position, Fault> {
        let order = std::iter::once(at.source).chain(0..self.sources.len());
        for source in order {
            if let Some(line) = self.sources[source].sub(label) {
                return Ok(Position {
                    source,
                    line: line + 1,
                });
            }
        }
        let name = match label {
            Label::Number(number) => number.to_string(),
            Label::Name(name) => name.clone(),
            Label::Computed => unreachable!("it is worked out before"),
        };
        let is_plain = !name.contains(['/', '\\']) && !name.starts_with('.');
        let file = self.options.directory.as_ref().filter(|_| is_plain);
        let Some(path) = file.map(|directory| directory.join(format!("{name}.ngc"))) else {
            return Err(self.fault(at, 0, format!("there is no {label} sub in this file")));
        };
        let bytes = std::fs::read(&path).map_err(|error| {
            let what = format!(
                "there is no {label} sub in this file, and {}: {error}",
                path.display()
            );
            self.fault(at, 0, what)
        })?;
        let text = Text::new(bytes)
            .map_err(|wrong| self.fault(at, 0, format!("{}: {}", path.display(), wrong.what)))?;
        self.sources
            .push(Source::new(Some(format!("{name}.ngc")), text));
        let source = self.sources.len() - 1;
        match self.sources[source].sub(label) {
            Some(line) => Ok(Position {
                source,
                line: line + 1,
            }),
            None => Err(self.fault(at, 0, format!("{} has no {label} sub", path.display()))),
        }
    }

    /// Ends a call; an endsub must have its label.
    fn return_from_sub(
        &mut self,
        at: Position,
        label: Option<&Label>,
        reader: &mut Reader<'_>,
    ) -> Result<(), Fault> {
        let value = match reader.peek() {
            b'[' => Some(self.bracket(reader, at)?),
            _ => None,
        };
        self.rest(reader, at)?;
        match &self.frame().callee {
            Callee::Sub { label: open, .. } if label.is_none_or(|label| label == open) => {}
            _ => return Err(self.fault(at, 0, "a return from no open call")),
        }
        self.leave();
        let returned = f64::from(u8::from(value.is_some()));
        self.parameters
            .set_named("_value".into(), value.unwrap_or(0.0));
        self.parameters
            .set_named("_value_returned".into(), returned);
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

#[expect(clippy::cast_precision_loss, reason = "at most eight digits")]
fn number_of(number: u64) -> f64 {
    number as f64
}

impl Iterator for Interpreter {
    type Item = Result<Event, Fault>;

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
