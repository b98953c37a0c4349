//! The machine's modal state: what each line makes the cutter do.
//!
//! Words act in the order of RS-274 whatever their order on the line: modes first, then dwell and shifts of the coordinates,
//! then the move. A word that cannot be followed is *ignored* (the path is still as written, or only rapids are missing; a
//! [`Warning`] says so, once per kind) or *refused* (the path would be wrong; the program ends with a [`Fault`]).

use std::collections::{BTreeSet, VecDeque};
use std::io::{BufRead, Read};

use super::arc::{self, Centre, RADIUS_DIFFERENCE_REPORTED};
use super::path::{Motion, Move};
use super::words::{self, Block, Code, Word};

const MM_PER_INCH: f64 = 25.4;

/// Longest line. A file without ends of lines is no program.
const LINE_BYTES_MAX: u64 = 65_536;

/// What a line does.
#[derive(Clone, PartialEq, Debug)]
pub enum Event {
    /// The cutter moves.
    Move(Move),
    /// The cutter stays where it is.
    Dwell {
        /// Line of the program, from 1.
        line: u64,
        /// For how long (the P of G4 is in seconds).
        seconds: f64,
    },
    /// Something was not done as written.
    Warning(Warning),
}

/// Something that was not done as written. An ignored word is reported where it first stands, an uneven arc wherever it stands.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("line {line}: {subject} {message}")]
pub struct Warning {
    /// Line of the program, from 1.
    pub line: u64,
    /// What it is about, such as `G42`; the same for all warnings of a kind.
    pub subject: String,
    /// What was done instead.
    pub message: String,
}

/// A line that cannot be run. The program ends there.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("line {line}, column {column}: {what}: {text:?}")]
pub struct Fault {
    /// Line of the program, from 1.
    pub line: u64,
    /// Column of the word at fault, from 1, in characters.
    pub column: usize,
    /// The line, cut after 80 characters.
    pub text: String,
    /// What is wrong with it.
    pub what: String,
}

/// Why a program cannot be run to its end.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// A line cannot be run.
    #[error(transparent)]
    Fault(#[from] Fault),
    /// The text cannot be read.
    #[error("cannot read the program: {0}")]
    Io(#[from] std::io::Error),
}

/// Runs a program line by line as it is asked for the next event. After an error there is nothing more.
#[derive(Debug)]
pub struct Moves<R> {
    source: R,
    line: u64,
    bytes: u64,
    buffer: Vec<u8>,
    waiting: VecDeque<Event>,
    machine: Machine,
    done: bool,
}

impl<R: BufRead> Moves<R> {
    /// A program about to be run.
    pub fn new(source: R) -> Self {
        Self {
            source,
            line: 0,
            bytes: 0,
            buffer: Vec::new(),
            waiting: VecDeque::new(),
            machine: Machine::default(),
            done: false,
        }
    }

    /// How much of the text has been read. Units: bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    fn read_line(&mut self) -> Result<Option<String>, ReadError> {
        self.buffer.clear();
        let size = Read::take(&mut self.source, LINE_BYTES_MAX)
            .read_until(b'\n', &mut self.buffer)? as u64;
        if size == 0 {
            return Ok(None);
        }
        self.line += 1;
        self.bytes += size;
        // Comments come in any encoding; in words only ASCII has a meaning, and anything else is refused there.
        let text = String::from_utf8_lossy(&self.buffer);
        let text = text.trim_end_matches(['\n', '\r']);
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        if size == LINE_BYTES_MAX && self.buffer.last() != Some(&b'\n') {
            let what = "a line without end: this is no G-code".into();
            return Err(fault(self.line, text, (1, what)).into());
        }
        Ok(Some(text.to_owned()))
    }

    fn advance(&mut self) -> Result<(), ReadError> {
        let Some(text) = self.read_line()? else {
            self.done = true;
            return Ok(());
        };
        if self.machine.phase == Phase::Ended {
            if !matches!(text.trim().chars().next(), None | Some('%' | '(' | ';')) {
                self.done = true;
                self.waiting.push_back(Event::Warning(Warning {
                    line: self.line,
                    subject: "the rest of the file".into(),
                    message: "ignored: it follows the end of the program".into(),
                }));
            }
            return Ok(());
        }
        let block = words::read(&text)
            .map_err(|unreadable| fault(self.line, &text, (unreadable.column, unreadable.what)))?;
        let mut step = Step {
            line: self.line,
            machine: &mut self.machine,
            events: &mut self.waiting,
        };
        step.run(&block).map_err(|at| fault(self.line, &text, at))?;
        Ok(())
    }
}

impl<R: BufRead> Iterator for Moves<R> {
    type Item = Result<Event, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(event) = self.waiting.pop_front() {
                return Some(Ok(event));
            }
            if self.done {
                return None;
            }
            if let Err(error) = self.advance() {
                self.done = true;
                self.waiting.clear();
                return Some(Err(error));
            }
        }
    }
}

impl<R: BufRead> std::iter::FusedIterator for Moves<R> {}

/// A column and what is wrong there.
type At = (usize, String);

fn fault(line: u64, text: &str, (column, what): At) -> Fault {
    Fault {
        line,
        column,
        text: text.trim().chars().take(80).collect(),
        what,
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum FeedMode {
    PerMinute,
    /// F is moves per minute, so it differs with the length of each.
    InverseTime,
    /// Its speed depends on the spindle, which is not followed.
    PerTurn,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum MotionWord {
    Rapid,
    Straight,
    Arc { counterclockwise: bool },
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Phase {
    /// Neither a word nor a `%` has come.
    Waiting,
    Running,
    Ended,
}

/// Everything that lasts from line to line.
#[derive(Clone, Debug)]
struct Machine {
    /// Where the cutter is. Units: mm.
    position: [f64; 3],
    /// What G92 adds to a coordinate of the program, and what G92.3 restores.
    shift: [f64; 3],
    shift_kept: [f64; 3],
    mm_per_unit: f64,
    unit_given: bool,
    absolute: bool,
    centres_absolute: bool,
    /// First and second axis: counterclockwise turns the first into the second.
    plane: [usize; 2],
    motion: Option<MotionWord>,
    feed_mode: FeedMode,
    /// Units: mm per minute.
    feed: Option<f64>,
    phase: Phase,
    reported: BTreeSet<String>,
}

impl Default for Machine {
    fn default() -> Self {
        Self {
            position: [0.0; 3],
            shift: [0.0; 3],
            shift_kept: [0.0; 3],
            mm_per_unit: 1.0,
            unit_given: false,
            absolute: true,
            centres_absolute: false,
            plane: [0, 1],
            motion: None,
            feed_mode: FeedMode::PerMinute,
            feed: None,
            phase: Phase::Waiting,
            reported: BTreeSet::new(),
        }
    }
}

/// What is done about a G word.
enum Meaning {
    Motion(MotionWord),
    NoMotion,
    Plane([usize; 2]),
    Unit(f64),
    Absolute(bool),
    CentresAbsolute(bool),
    Feed(FeedMode),
    Dwell,
    Machine,
    Home,
    Shift,
    ShiftEnd,
    ShiftPause,
    ShiftResume,
    Harmless,
    Ignored(&'static str),
    Refused(&'static str),
}

/// By RS-274/NGC and what Grbl and its likes make of it. `tenths` is 911 for G91.1.
fn meaning(tenths: u32) -> Meaning {
    match tenths {
        0 => Meaning::Motion(MotionWord::Rapid),
        10 => Meaning::Motion(MotionWord::Straight),
        20 | 30 => Meaning::Motion(MotionWord::Arc {
            counterclockwise: tenths == 30,
        }),
        40 => Meaning::Dwell,
        50..=59 => {
            Meaning::Refused("splines are not supported; have them written as lines or arcs")
        }
        80 | 90 | 150 | 400 | 490 | 500 | 640 | 610 | 611 | 690 | 960 | 970 | 980 | 990 | 281
        | 301 => Meaning::Harmless,
        100 | 520 => Meaning::Refused("setting coordinate systems is not supported; G92 is"),
        160 => Meaning::Refused("polar coordinates are not supported"),
        170 => Meaning::Plane([0, 1]),
        180 => Meaning::Plane([2, 0]),
        190 => Meaning::Plane([1, 2]),
        200 => Meaning::Unit(MM_PER_INCH),
        210 => Meaning::Unit(1.0),
        280 | 300 => Meaning::Home,
        330..=339 => Meaning::Refused("threading in step with the spindle is not supported"),
        380..=389 => Meaning::Refused("probing is not supported: where it ends is not known"),
        410..=429 => Meaning::Ignored(
            "ignored: cutter compensation is not applied, the cutter is centred on the path as it is written",
        ),
        430..=432 | 440 => Meaning::Ignored(
            "ignored: tool lengths are not applied, the path is taken as it is written",
        ),
        433..=439 => Meaning::Refused("tool centre point control is not supported"),
        510 => Meaning::Refused("scaling is not supported"),
        530 => Meaning::Machine,
        540..=599 => Meaning::Ignored(
            "ignored: coordinates are taken as they are written, whatever the coordinate system",
        ),
        680 | 681 => Meaning::Refused("rotated coordinates are not supported"),
        730..=799 | 810..=899 => {
            Meaning::Refused("canned cycles are not supported; have them written as G0 and G1")
        }
        800 => Meaning::NoMotion,
        900 => Meaning::Absolute(true),
        910 => Meaning::Absolute(false),
        901 => Meaning::CentresAbsolute(true),
        911 => Meaning::CentresAbsolute(false),
        920 => Meaning::Shift,
        921 => Meaning::ShiftEnd,
        922 => Meaning::ShiftPause,
        923 => Meaning::ShiftResume,
        930 => Meaning::Feed(FeedMode::InverseTime),
        940 => Meaning::Feed(FeedMode::PerMinute),
        950 => Meaning::Feed(FeedMode::PerTurn),
        _ => Meaning::Refused("this word is not known"),
    }
}

/// Two different words of one group on a line contradict each other.
fn group(tenths: u32) -> Option<&'static str> {
    Some(match tenths {
        0..=30 | 50..=59 | 330..=339 | 380..=389 | 730..=899 => "the motion",
        170 | 180 | 190 => "the plane",
        200 | 210 => "the unit",
        900 | 910 => "the distance mode",
        901 | 911 => "the mode of arc centres",
        930..=959 => "the feed mode",
        _ => return None,
    })
}

const AXES: [char; 3] = ['X', 'Y', 'Z'];
const CENTRES: [char; 3] = ['I', 'J', 'K'];

/// What the axis words of the line say.
#[derive(Clone, Copy, PartialEq, Eq)]
enum AxisWords {
    Target,
    MachineTarget,
    Home,
    Shift,
    DwellTime,
}

/// One line being run.
struct Step<'run> {
    line: u64,
    machine: &'run mut Machine,
    events: &'run mut VecDeque<Event>,
}

impl Step<'_> {
    fn run(&mut self, block: &Block) -> Result<(), At> {
        if block.deleted {
            self.ignore(
                "block delete",
                "ignored: lines that begin with / are left out",
            );
            return Ok(());
        }
        if block.percent {
            // The first mark opens a program, unless it comes after the first words: then it was left out.
            self.machine.phase = match self.machine.phase {
                Phase::Waiting => Phase::Running,
                Phase::Running | Phase::Ended => Phase::Ended,
            };
        }
        if block.is_empty() || self.machine.phase == Phase::Ended {
            return Ok(());
        }
        self.machine.phase = Phase::Running;
        let mut line = Line::new(block)?;
        for code in &block.codes {
            if is(*code, 'M', 970) || is(*code, 'M', 980) {
                let what = format!("{code} is refused: subprograms are not supported");
                return Err((code.column, what));
            }
        }
        let axis_words = self.modes(block, &mut line)?;
        self.rate(&mut line)?;
        if block.codes.iter().any(|code| is(*code, 'G', 40)) {
            self.dwell(&mut line, axis_words)?;
        }
        match axis_words {
            AxisWords::Target => self.motion(block, &mut line)?,
            AxisWords::MachineTarget if !line.has_axes() => {}
            AxisWords::MachineTarget => {
                if self.machine.motion != Some(MotionWord::Rapid) {
                    return Err((
                        line.column(),
                        "a feed move in machine coordinates is refused: where they begin is not known".into(),
                    ));
                }
                line.take_axes();
                self.ignore(
                    "G53",
                    "ignored: this rapid in machine coordinates is not made, the cutter stays where it is",
                );
            }
            AxisWords::Home => {
                line.take_axes();
                self.ignore(
                    "G28/G30",
                    "ignored: the machine's own positions are not known, the cutter stays where it is",
                );
            }
            AxisWords::Shift => self.shift(&mut line),
            AxisWords::DwellTime => {}
        }
        self.leftovers(block, &line)?;
        self.miscellaneous(block);
        Ok(())
    }

    /// Sets the modes the line asks for.
    fn modes(&mut self, block: &Block, line: &mut Line<'_>) -> Result<AxisWords, At> {
        let mut axis_words = AxisWords::Target;
        let mut claim = |code: Code, claimed: AxisWords| {
            if axis_words != AxisWords::Target && axis_words != claimed {
                let what =
                    format!("{code} and another word of the line both claim its coordinates");
                return Err((code.column, what));
            }
            axis_words = claimed;
            Ok(())
        };
        for &code in block.codes.iter().filter(|code| code.letter == 'G') {
            match meaning(code.tenths) {
                Meaning::Motion(motion) => self.machine.motion = Some(motion),
                Meaning::NoMotion => self.machine.motion = None,
                Meaning::Plane(plane) => self.machine.plane = plane,
                Meaning::Unit(mm_per_unit) => {
                    self.machine.mm_per_unit = mm_per_unit;
                    self.machine.unit_given = true;
                }
                Meaning::Absolute(absolute) => self.machine.absolute = absolute,
                Meaning::CentresAbsolute(absolute) => self.machine.centres_absolute = absolute,
                Meaning::Feed(mode) => {
                    if mode != self.machine.feed_mode {
                        self.machine.feed = None;
                    }
                    self.machine.feed_mode = mode;
                    if mode == FeedMode::PerTurn {
                        self.ignore(
                            "G95",
                            "ignored: feeds per turn are not converted, these moves carry no feed",
                        );
                    }
                }
                Meaning::Dwell => {
                    if line.get('P').is_none() && line.get('X').is_some() {
                        claim(code, AxisWords::DwellTime)?;
                    }
                }
                Meaning::Machine => claim(code, AxisWords::MachineTarget)?,
                Meaning::Home => claim(code, AxisWords::Home)?,
                Meaning::Shift => claim(code, AxisWords::Shift)?,
                Meaning::ShiftEnd => {
                    self.machine.shift = [0.0; 3];
                    self.machine.shift_kept = [0.0; 3];
                }
                Meaning::ShiftPause => self.machine.shift = [0.0; 3],
                Meaning::ShiftResume => self.machine.shift = self.machine.shift_kept,
                Meaning::Harmless => {}
                Meaning::Ignored(message) => self.ignore(&code.to_string(), message),
                Meaning::Refused(message) => {
                    return Err((code.column, format!("{code} is refused: {message}")));
                }
            }
        }
        Ok(axis_words)
    }

    /// Sets the feed.
    fn rate(&mut self, line: &mut Line<'_>) -> Result<(), At> {
        if self.machine.feed_mode != FeedMode::PerMinute {
            self.machine.feed = None;
        }
        let Some(word) = line.take('F') else {
            return Ok(());
        };
        if word.value < 0.0 {
            return Err((word.column, format!("a feed of {} is refused", word.value)));
        }
        self.machine.feed = match self.machine.feed_mode {
            _ if word.value == 0.0 => None,
            FeedMode::PerMinute => Some(word.value * self.machine.mm_per_unit),
            FeedMode::InverseTime => Some(word.value),
            FeedMode::PerTurn => None,
        };
        Ok(())
    }

    fn dwell(&mut self, line: &mut Line<'_>, axis_words: AxisWords) -> Result<(), At> {
        let word = if axis_words == AxisWords::DwellTime {
            line.take('X')
        } else {
            line.take('P')
        };
        let Some(word) = word else {
            return Ok(());
        };
        if word.value < 0.0 {
            return Err((
                word.column,
                format!("a dwell of {} s is refused", word.value),
            ));
        }
        self.events.push_back(Event::Dwell {
            line: self.line,
            seconds: word.value,
        });
        Ok(())
    }

    /// G92: from now on the cutter is at the coordinates given.
    fn shift(&mut self, line: &mut Line<'_>) {
        for (axis, letter) in AXES.into_iter().enumerate() {
            if let Some(word) = line.take(letter) {
                self.machine.shift[axis] =
                    self.machine.position[axis] - word.value * self.machine.mm_per_unit;
            }
        }
        self.machine.shift_kept = self.machine.shift;
    }

    /// The move, if there is one.
    fn motion(&mut self, block: &Block, line: &mut Line<'_>) -> Result<(), At> {
        let arc = matches!(self.machine.motion, Some(MotionWord::Arc { .. }));
        let centred = CENTRES.into_iter().any(|letter| line.get(letter).is_some());
        if !(line.has_axes() || arc && centred) {
            return Ok(());
        }
        let Some(motion) = self.machine.motion else {
            return Err((
                line.column(),
                "coordinates without a motion word: no G0, G1, G2 or G3 is in force".into(),
            ));
        };
        if !self.machine.unit_given {
            self.ignore("unit", "not given: neither G20 (inch) nor G21 (mm) before the first move, millimetres are assumed");
        }
        let start = self.machine.position;
        let mut end = start;
        for (axis, letter) in AXES.into_iter().enumerate() {
            if let Some(word) = line.take(letter) {
                let origin = if self.machine.absolute {
                    self.machine.shift[axis]
                } else {
                    start[axis]
                };
                end[axis] = origin + word.value * self.machine.mm_per_unit;
            }
        }
        let ends = [start, end];
        let mut next = match motion {
            MotionWord::Rapid => Move::straight(self.line, Motion::Rapid, ends, None),
            MotionWord::Straight => {
                Move::straight(self.line, Motion::Feed, ends, self.machine.feed)
            }
            MotionWord::Arc { counterclockwise } => {
                self.arc(block, line, ends, counterclockwise)?
            }
        };
        if self.machine.feed_mode == FeedMode::InverseTime {
            next.feed = next.feed.map(|per_minute| per_minute * next.length);
        }
        self.machine.position = end;
        self.events.push_back(Event::Move(next));
        Ok(())
    }

    fn arc(
        &mut self,
        block: &Block,
        line: &mut Line<'_>,
        ends: [[f64; 3]; 2],
        counterclockwise: bool,
    ) -> Result<Move, At> {
        let plane = self.machine.plane;
        let column = block
            .codes
            .first()
            .map_or(line.column(), |code| code.column);
        let [start, end] = ends.map(|point| plane.map(|axis| point[axis]));
        let centre = self.centre(line, start, column)?;
        let turns = match line.take('P') {
            None => 0.0,
            Some(word) if word.value >= 1.0 && word.value.fract() == 0.0 => word.value - 1.0,
            Some(word) => {
                let what = format!("P{} is no number of turns", word.value);
                return Err((word.column, what));
            }
        };
        let arc = arc::arc(plane, [start, end], centre, counterclockwise, turns)
            .map_err(|what| (column, what))?;
        let difference = (arc.radius[0] - arc.radius[1]).abs();
        if difference > RADIUS_DIFFERENCE_REPORTED {
            self.warn(
                "uneven arc",
                format!(
                    "is run with a radius that changes evenly: its start is {:.4} mm and its end {:.4} mm from its centre",
                    arc.radius[0], arc.radius[1]
                ),
            );
        }
        Ok(Move::arc(self.line, ends, arc, self.machine.feed))
    }

    fn centre(&self, line: &mut Line<'_>, start: [f64; 2], column: usize) -> Result<Centre, At> {
        let letters = self.machine.plane.map(|axis| CENTRES[axis]);
        let words = letters.map(|letter| line.take(letter));
        let unit = self.machine.mm_per_unit;
        if let Some(word) = line.take('R') {
            return match words {
                [None, None] if word.value != 0.0 => Ok(Centre::Radius(word.value * unit)),
                [None, None] => Err((word.column, "a radius R of 0 is refused".into())),
                _ => Err((
                    word.column,
                    format!(
                        "an arc has either R or {} and {}, not both",
                        letters[0], letters[1]
                    ),
                )),
            };
        }
        let mut centre = start;
        for (index, word) in words.into_iter().enumerate() {
            let Some(word) = word else {
                if self.machine.centres_absolute || words == [None, None] {
                    return Err((
                        column,
                        format!("the arc has no centre: {} or R is missing", letters[index]),
                    ));
                }
                continue;
            };
            let origin = if self.machine.centres_absolute {
                self.machine.shift[self.machine.plane[index]]
            } else {
                start[index]
            };
            centre[index] = origin + word.value * unit;
        }
        Ok(Centre::At(centre))
    }

    /// Words that nothing on the line has used.
    fn leftovers(&mut self, block: &Block, line: &Line<'_>) -> Result<(), At> {
        for word in line.left() {
            match word.letter {
                'A' | 'B' | 'C' | 'U' | 'V' | 'W' if word.value == 0.0 => self.ignore(
                    &format!("axis {}", word.letter),
                    "ignored: it stays at 0 here; only X, Y and Z are supported",
                ),
                'A' | 'B' | 'C' | 'U' | 'V' | 'W' => {
                    let what = format!(
                        "{}{} is refused: only the axes X, Y and Z are supported",
                        word.letter, word.value
                    );
                    return Err((word.column, what));
                }
                'S' | 'T' | 'D' | 'H' => {}
                'P' | 'Q' | 'L' | 'R' if block.codes.iter().any(|code| !moves(*code)) => {}
                letter => self.ignore(
                    &format!("word {letter}"),
                    "ignored: nothing on the line uses it",
                ),
            }
        }
        Ok(())
    }

    fn miscellaneous(&mut self, block: &Block) {
        for &code in block.codes.iter().filter(|code| code.letter == 'M') {
            match code.tenths {
                20 | 300 | 990 => self.machine.phase = Phase::Ended,
                60 => self.ignore("M6", "ignored: the same cutter is used for every tool"),
                // Stops, spindle, coolant, overrides, motors, extruder modes.
                0 | 10 | 30..=50 | 70..=90 | 170 | 180 | 480..=530 | 600 | 820 | 830 | 840 => {}
                _ => self.ignore(
                    &code.to_string(),
                    "ignored: it is taken not to move the cutter",
                ),
            }
        }
    }

    /// Reports a kind of thing where it first stands.
    fn ignore(&mut self, subject: &str, message: &str) {
        if self.machine.reported.insert(subject.to_owned()) {
            self.warn(subject, message.to_owned());
        }
    }

    fn warn(&mut self, subject: &str, message: String) {
        self.events.push_back(Event::Warning(Warning {
            line: self.line,
            subject: subject.to_owned(),
            message,
        }));
    }
}

fn is(code: Code, letter: char, tenths: u32) -> bool {
    code.letter == letter && code.tenths == tenths
}

fn moves(code: Code) -> bool {
    code.letter == 'G' && code.tenths <= 30
}

/// The words of a line, each used at most once.
struct Line<'block> {
    words: Vec<&'block Word>,
    first_column: usize,
}

impl<'block> Line<'block> {
    /// Refuses words that contradict each other.
    fn new(block: &'block Block) -> Result<Self, At> {
        for (index, code) in block.codes.iter().enumerate() {
            let Some(what) = group(code.tenths).filter(|_| code.letter == 'G') else {
                continue;
            };
            let rival = block.codes[..index].iter().find(|other| {
                other.letter == 'G'
                    && *other != code
                    && group(other.tenths) == Some(what)
                    && other.tenths != code.tenths
            });
            if let Some(rival) = rival {
                let what = format!("{rival} and {code} on one line both set {what}");
                return Err((code.column, what));
            }
        }
        for (index, word) in block.words.iter().enumerate() {
            if block.words[..index]
                .iter()
                .any(|other| other.letter == word.letter)
            {
                let what = format!("{} stands twice on one line", word.letter);
                return Err((word.column, what));
            }
        }
        Ok(Self {
            words: block.words.iter().collect(),
            first_column: block.words.first().map_or(1, |word| word.column),
        })
    }

    fn get(&self, letter: char) -> Option<Word> {
        self.words
            .iter()
            .find(|word| word.letter == letter)
            .map(|word| **word)
    }

    fn take(&mut self, letter: char) -> Option<Word> {
        let index = self.words.iter().position(|word| word.letter == letter)?;
        Some(*self.words.remove(index))
    }

    fn has_axes(&self) -> bool {
        AXES.into_iter().any(|letter| self.get(letter).is_some())
    }

    fn take_axes(&mut self) {
        for letter in AXES {
            self.take(letter);
        }
    }

    fn left(&self) -> impl Iterator<Item = &Word> {
        self.words.iter().copied()
    }

    /// Where the first word stands.
    fn column(&self) -> usize {
        self.first_column
    }
}
