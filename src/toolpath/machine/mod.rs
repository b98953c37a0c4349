//! The machine's modal state: what each line makes the cutter do.
//!
//! Words act in the order of RS274 whatever their order on the line: feed, speed and tool first, then modes, a dwell, settings of
//! coordinates, and the move at last.

mod coordinates;
mod curves;
mod holes;
mod motions;
mod targets;
mod values;
mod words;

use std::collections::{BTreeSet, VecDeque};

use super::arc::{self, Centre, RADIUS_DIFFERENCE_REPORTED};
use super::block::{AXES, Block};
use super::codes::{Action, Code, Codes, Cycle, Length, MotionWord, Side, Treatment};
use super::compensation::{Compensator, Piece, Shape, Step};
use super::cycle::{self, Depths, Stroke};
use super::dialect::Dialect;
use super::event::{Event, Warning};
use super::frames::{Frames, SYSTEMS, System};
use super::options::{Options, RapidPath};
use super::path::{Motion, Move, Plane};
use super::spline::{self, Control};
use super::tools::ToolTable;

/// Repeats of one line.
const REPEATS_MAX: u32 = 100_000;

/// Dwells as long as this many seconds are questioned when their unit is. Units: seconds.
const DWELL_QUESTIONED: f64 = 60.0;

/// An offset in bytes and what is wrong there.
pub(super) type At = (usize, String);

/// What comes after a line.
#[derive(Clone, Copy, Debug)]
pub(super) enum After {
    Next,
    End,
    /// A program by its number, or the lines from a number on, so often.
    Call {
        number: u64,
        times: u64,
    },
    CallLine {
        number: u64,
        times: u64,
    },
    Return,
    /// The modes come back when the subprogram ends.
    SaveUntilReturn(Modes),
}

/// What the program has said about a coordinate.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Known {
    Said,
    /// Nothing yet: it is where the machine happens to stand.
    Unsaid,
    /// It was said for a tool of another length.
    Shifted,
    /// It moved to a point of the machine's whose place is not known.
    Lost,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum FeedMode {
    PerMinute,
    /// F is moves per minute, so the speed differs with the length of each.
    InverseTime,
    /// F is millimetres a turn of the spindle.
    PerTurn,
}

/// What M70 saves and M72 brings back.
#[expect(clippy::struct_excessive_bools, reason = "each is a mode of its own")]
#[derive(Clone, Copy, Debug)]
pub(super) struct Modes {
    mm_per_unit: f64,
    absolute: bool,
    centres_absolute: bool,
    plane: Plane,
    system: usize,
    feed_mode: FeedMode,
    /// A speed in mm a minute, moves a minute, or mm a turn.
    feed: Option<f64>,
    retract_to_r: bool,
    turning: bool,
    /// Turns a minute.
    speed: f64,
}

/// Words of a cycle that last until it ends.
#[derive(Clone, Copy, Debug, Default)]
struct Sticky {
    r: Option<f64>,
    bottom: Option<f64>,
    step: Option<f64>,
    dwell: Option<f64>,
    /// Where the normal axis stood when the run of cycles began.
    initial: Option<f64>,
}

/// A NURBS being read.
#[derive(Clone, Debug)]
struct Nurbs {
    controls: Vec<Control>,
    order: usize,
    start: [f64; 3],
}

/// Everything that lasts from line to line.
#[derive(Debug)]
pub(super) struct Machine {
    dialect: Dialect,
    codes: Codes,
    tolerance: f64,
    rapid_path: RapidPath,
    pub(super) tools: ToolTable,
    modes: Modes,
    saved: Option<Modes>,
    motion: Option<MotionWord>,
    frames: Frames,
    /// Where the program is, without compensation, in the machine's coordinates. Units: mm.
    position: [f64; 3],
    known: [Known; 3],
    /// The same where the last move ended.
    start_known: [Known; 3],
    /// Where it ended, as it came out.
    said_last: [Option<f64>; 3],
    /// The origin of the first system that was moved in.
    base: Option<[f64; 3]>,
    /// Reference points in the machine's coordinates.
    homes: [[f64; 3]; 2],
    tool: u32,
    selected: u32,
    has_changed: bool,
    has_turned: bool,
    unit_given: bool,
    compensator: Option<Compensator>,
    sticky: Sticky,
    nurbs: Option<Nurbs>,
    /// The direction in which the last cubic spline ended, as the next may begin.
    spline_end: Option<[f64; 2]>,
    reported: BTreeSet<String>,
    steps: Vec<Step>,
}

/// A target by its distance from the origin and its angle. Units: the program's, degrees.
#[derive(Clone, Copy)]
struct Polar {
    radius: Option<f64>,
    angle: Option<f64>,
}

impl Polar {
    /// The target of a cutter that stands at a point of the program, in mm. Relative ones add to where it is.
    fn from(self, now: [f64; 3], modes: &Modes) -> (f64, f64) {
        let unit = modes.mm_per_unit;
        let (distance, heading) = (now[0].hypot(now[1]), now[1].atan2(now[0]));
        let (radius, angle) = if modes.absolute {
            (
                self.radius.map_or(distance, |radius| radius * unit),
                self.angle.map_or(heading, f64::to_radians),
            )
        } else {
            (
                distance + self.radius.unwrap_or(0.0) * unit,
                heading + self.angle.unwrap_or(0.0).to_radians(),
            )
        };
        (radius * angle.cos(), radius * angle.sin())
    }
}

/// One line being run.
struct Run<'run> {
    line: u64,
    machine: &'run mut Machine,
    events: &'run mut VecDeque<Event>,
}

/// What the words of a line ask for, before anything is done.
#[expect(
    clippy::struct_excessive_bools,
    reason = "each is a word that is there or not"
)]
#[derive(Default)]
struct Wanted {
    motion: Option<MotionWord>,
    no_motion: bool,
    nurbs_end: bool,
    dwell: bool,
    /// What else uses the coordinates of the line.
    special: Option<(Code, Action)>,
    machine_coordinates: bool,
    compensation: Option<(Code, Option<Side>, bool)>,
    length: Option<(Code, Length)>,
    system: Option<usize>,
    change: bool,
    after: Option<(Code, Action)>,
    /// What M70 and M73 save.
    modes_before: Option<Modes>,
    miscellaneous: bool,
}

impl Machine {
    pub(super) fn new(dialect: Dialect, options: &Options) -> Self {
        let mut frames = Frames::default();
        for (system, origin) in frames.systems.iter_mut().zip(options.origins) {
            if let Some(origin) = origin {
                (system.origin, system.known) = (origin, true);
                frames.machine_known = true;
            }
        }
        if let Some(home) = options.home {
            // Seen from the first work system the machine's zero is there.
            let first = &mut frames.systems[0];
            if !first.known {
                first.origin = home.map(|at| -at);
                first.known = true;
            }
            frames.machine_known = true;
        }
        Self {
            dialect,
            codes: Codes::of(dialect),
            tolerance: options.tolerance,
            rapid_path: options.rapid_path,
            tools: options.tools.clone(),
            modes: Modes {
                mm_per_unit: 1.0,
                absolute: true,
                centres_absolute: false,
                plane: Plane::Xy,
                system: 0,
                feed_mode: FeedMode::PerMinute,
                feed: None,
                retract_to_r: dialect == Dialect::LinuxCnc,
                turning: false,
                speed: 0.0,
            },
            saved: None,
            motion: None,
            frames,
            position: [0.0; 3],
            known: [Known::Unsaid; 3],
            start_known: [Known::Unsaid; 3],
            said_last: [None; 3],
            base: None,
            homes: [[0.0; 3]; 2],
            tool: 0,
            selected: 0,
            has_changed: false,
            has_turned: false,
            unit_given: false,
            compensator: None,
            sticky: Sticky::default(),
            nurbs: None,
            spline_end: None,
            reported: BTreeSet::new(),
            steps: Vec::new(),
        }
    }

    /// Runs a line.
    ///
    /// # Errors
    /// [`At`] says where and why the line cannot be run.
    pub(super) fn run(
        &mut self,
        block: &mut Block,
        line: u64,
        events: &mut VecDeque<Event>,
    ) -> Result<After, At> {
        let mut run = Run {
            line,
            machine: self,
            events,
        };
        run.block(block)
    }

    /// Lets out what compensation holds back.
    ///
    /// # Errors
    /// [`At`], when what is held back cannot be run, or a NURBS is not ended.
    pub(super) fn finish(&mut self, line: u64, events: &mut VecDeque<Event>) -> Result<(), At> {
        let unfinished = self.nurbs.is_some();
        let mut run = Run {
            line,
            machine: self,
            events,
        };
        if unfinished {
            return Err((0, "the program ends in a NURBS: G5.3 is missing".into()));
        }
        run.end_compensation(0)
    }

    /// Reports a kind of thing where it first stands.
    pub(super) fn report(
        &mut self,
        line: u64,
        code: &str,
        text: impl Into<String>,
        events: &mut VecDeque<Event>,
    ) {
        if !self.reported.contains(code) {
            self.reported.insert(code.to_owned());
            events.push_back(Event::Warning(Warning {
                line,
                code: code.to_owned(),
                text: text.into(),
            }));
        }
    }

    pub(super) fn restore(&mut self, modes: Modes) {
        self.modes = modes;
    }

    fn program_position(&self) -> [f64; 3] {
        self.frames.to_program(self.modes.system, self.position)
    }
}

impl Run<'_> {
    fn block(&mut self, block: &mut Block) -> Result<After, At> {
        let wanted = self.wanted(block)?;
        self.speeds_and_tool(block, &wanted)?;
        self.coordinates(block, &wanted)?;
        if wanted.dwell {
            self.dwell(block)?;
        }
        self.special(block, &wanted)?;
        self.motion(block, &wanted)?;
        let after = self.after(block, &wanted)?;
        self.leftovers(block, &wanted)?;
        Ok(after)
    }

    fn report(&mut self, code: &str, text: impl Into<String>) {
        self.machine.report(self.line, code, text, self.events);
    }
}

const CENTRES: [char; 3] = ['I', 'J', 'K'];

/// The groups of modes of which a line can set one each.
const GROUPS: usize = 10;

fn group(action: Action) -> Option<(usize, &'static str)> {
    Some(match action {
        Action::Motion(_) | Action::NurbsEnd => (0, "the motion"),
        Action::Plane(_) => (1, "the plane"),
        Action::Unit(_) => (2, "the unit"),
        Action::Absolute(_) => (3, "the distance mode"),
        Action::CentresAbsolute(_) => (4, "the mode of arc centres"),
        Action::FeedPerMinute | Action::FeedInverseTime | Action::FeedPerTurn => {
            (5, "the feed mode")
        }
        Action::Compensation { .. } => (6, "cutter compensation"),
        Action::Length(_) => (7, "the tool's length"),
        Action::System(_) => (8, "the work system"),
        Action::Set
        | Action::Home { .. }
        | Action::HomeHere { .. }
        | Action::Shift
        | Action::ShiftDirectly
        | Action::ShiftEnd { .. }
        | Action::ShiftResume
        | Action::Machine => (9, "what its coordinates mean"),
        _ => return None,
    })
}

/// Whether a line without axis words moves: an arc by its centre, a NURBS that begins.
fn moves_without_axes(word: MotionWord, block: &Block, wanted: &Wanted) -> bool {
    match word {
        MotionWord::Arc { .. } => CENTRES.into_iter().any(|letter| block.has(letter)),
        MotionWord::Nurbs => wanted.motion.is_some(),
        _ => false,
    }
}

/// Where the first word of a target stands.
fn first_axis(block: &Block) -> usize {
    let first = AXES
        .into_iter()
        .chain(CENTRES)
        .filter(|letter| block.has(*letter))
        .map(|letter| block.offset(letter));
    let polar = (block.polar != [None; 2]).then_some(block.polar_offset);
    first
        .chain(polar)
        .min()
        .or_else(|| block.codes.first().map(|code| code.column as usize))
        .unwrap_or(0)
}

/// The value of a word that must be whole and at most `most`.
fn whole(block: &mut Block, letter: char, most: u32) -> Result<Option<u64>, At> {
    let Some(value) = block.take(letter) else {
        return Ok(None);
    };
    let rounded = value.round();
    if (value - rounded).abs() > 1e-4 || !(0.0..=f64::from(most)).contains(&rounded) {
        let what = format!("{letter}{value} is no whole number from 0 to {most}");
        return Err((block.offset(letter), what));
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "whole and in range"
    )]
    Ok(Some(rounded as u64))
}

/// `G54` for 0.
pub(super) fn system_name(system: usize) -> String {
    match system {
        0..=5 => format!("G{}", 54 + system),
        _ => format!("G59.{}", system - 5),
    }
}
