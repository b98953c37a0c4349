//! The machine's modal state: what each line makes the cutter do.
//!
//! Words act in the order of RS274 whatever their order on the line: feed, speed and tool first, then modes, a dwell, settings of
//! coordinates, and the move at last.

use std::collections::{BTreeSet, VecDeque};

use super::arc::{self, Centre, RADIUS_DIFFERENCE_REPORTED};
use super::block::{AXES, Block};
use super::codes::{Action, Code, Codes, Cycle, Length, MotionWord, Side, Treatment};
use super::compensation::{Compensator, Piece, Shape, Step};
use super::cycle::{self, Depths, Stroke};
use super::dialect::Dialect;
use super::event::{Event, Warning};
use super::frames::{Frames, SYSTEMS, System};
use super::interpreter::{Options, RapidPath};
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

    /// A parameter that the machine itself keeps, in the program's unit; none for those it does not.
    pub(super) fn parameter(&self, number: u16) -> Option<f64> {
        let unit = self.modes.mm_per_unit;
        let axis = |values: [f64; 3], first: u16| match usize::from(number - first) {
            place @ 0..3 => values[place] / unit,
            _ => 0.0,
        };
        Some(match number {
            5161..=5169 => axis(self.homes[0], 5161),
            5181..=5189 => axis(self.homes[1], 5181),
            5210 => f64::from(u8::from(self.frames.shift != [0.0; 3])),
            5211..=5219 => axis(self.frames.shift, 5211),
            5220 => f64::from(u8::try_from(self.modes.system + 1).ok()?),
            5221..=5400 if number < 5400 && (number - 5221) % 20 < 10 => {
                let system = &self.frames.systems[usize::from((number - 5221) / 20)];
                match (number - 5221) % 20 {
                    9 => system.degrees,
                    _ => axis(system.origin, number - (number - 5221) % 20),
                }
            }
            5400 => f64::from(self.tool),
            5401..=5409 => axis(self.frames.length, 5401),
            5410 => self.tools.get(self.tool)?.diameter? / unit,
            5420..=5428 => axis(self.program_position(), 5420),
            _ => return None,
        })
    }

    /// A named parameter that the machine itself keeps, in the program's unit.
    pub(super) fn named(&self, name: &str) -> Option<f64> {
        let truth = |held: bool| if held { 1.0 } else { 0.0 };
        let unit = self.modes.mm_per_unit;
        let position = self.program_position();
        let motion = |word| match word {
            MotionWord::Rapid => 0.0,
            MotionWord::Straight => 10.0,
            MotionWord::Arc { counterclockwise } => 20.0 + 10.0 * truth(counterclockwise),
            MotionWord::Cubic => 50.0,
            MotionWord::Quadratic => 51.0,
            MotionWord::Nurbs => 52.0,
            MotionWord::Cycle(_) => 810.0,
        };
        Some(match name {
            "_x" => position[0] / unit,
            "_y" => position[1] / unit,
            "_z" => position[2] / unit,
            "_a" | "_b" | "_c" | "_u" | "_v" | "_w" => 0.0,
            "_abs_x" => self.position[0] / unit,
            "_abs_y" => self.position[1] / unit,
            "_abs_z" => self.position[2] / unit,
            "_metric" => truth(unit == 1.0),
            "_imperial" => truth(unit != 1.0),
            "_absolute" => truth(self.modes.absolute),
            "_incremental" => truth(!self.modes.absolute),
            "_inverse_time" => truth(self.modes.feed_mode == FeedMode::InverseTime),
            "_units_per_minute" => truth(self.modes.feed_mode == FeedMode::PerMinute),
            "_units_per_rev" => truth(self.modes.feed_mode == FeedMode::PerTurn),
            "_coord_system" => f64::from(u8::try_from(self.modes.system).ok()?) * 10.0 + 540.0,
            "_plane" => match self.modes.plane {
                Plane::Xy => 170.0,
                Plane::Zx => 180.0,
                Plane::Yz => 190.0,
            },
            "_current_tool" => f64::from(self.tool),
            "_selected_tool" => f64::from(self.selected),
            "_tool_offset" => truth(self.frames.length != [0.0; 3]),
            "_cutter_comp" => truth(self.compensator.is_some()),
            "_spindle_on" => truth(self.modes.turning),
            "_rpm" => self.modes.speed,
            "_feed" => match self.modes.feed_mode {
                FeedMode::InverseTime => self.modes.feed.unwrap_or(0.0),
                _ => self.modes.feed.unwrap_or(0.0) / unit,
            },
            "_motion_mode" => self.motion.map_or(800.0, motion),
            "_vmajor" => 2.9,
            "_vminor" | "_task" => 0.0,
            _ => return None,
        })
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

    /// Looks every code up. Modes that nothing else on the line depends on are set at once.
    fn wanted(&mut self, block: &Block) -> Result<Wanted, At> {
        let mut wanted = Wanted {
            modes_before: Some(self.machine.modes),
            ..Wanted::default()
        };
        let mut groups: [Option<Code>; GROUPS] = [None; GROUPS];
        for &code in &block.codes {
            let treatment = self.machine.codes.treatment(code);
            let action = match treatment {
                Treatment::Understood(action) => action,
                Treatment::Harmless => Action::Nothing,
                Treatment::Reported(what) => {
                    self.report(&code.to_string(), what);
                    Action::Nothing
                }
                Treatment::Refused(why) => {
                    return Err((code.column as usize, format!("{code} is refused: {why}")));
                }
            };
            if let Some((group, what)) = group(action) {
                if let Some(rival) = groups[group].filter(|rival| rival.tenths != code.tenths) {
                    let what = format!("{rival} and {code} on one line both set {what}");
                    return Err((code.column as usize, what));
                }
                groups[group] = Some(code);
            }
            if action == Action::Restore {
                self.restore(block, code)?;
                wanted.modes_before = Some(self.machine.modes);
            }
            self.want(code, action, &mut wanted);
        }
        Ok(wanted)
    }

    /// M72: before anything else of the line.
    fn restore(&mut self, block: &Block, code: Code) -> Result<(), At> {
        if block.codes[0] != code {
            return Err((
                code.column as usize,
                "M72 must be the first code of its line".into(),
            ));
        }
        self.no_compensation(block, "saved modes")?;
        self.machine.modes = self.machine.saved.ok_or_else(|| {
            (
                code.column as usize,
                "M72 without M70: no modes were saved".to_owned(),
            )
        })?;
        Ok(())
    }

    fn want(&mut self, code: Code, action: Action, wanted: &mut Wanted) {
        let modes = &mut self.machine.modes;
        match action {
            Action::Nothing => wanted.miscellaneous = true,
            Action::Motion(word) => wanted.motion = Some(word),
            Action::NoMotion => wanted.no_motion = true,
            Action::NurbsEnd => wanted.nurbs_end = true,
            Action::Dwell => wanted.dwell = true,
            Action::Machine => wanted.machine_coordinates = true,
            Action::Plane(plane) => modes.plane = plane,
            Action::Unit(mm_per_unit) => {
                modes.mm_per_unit = mm_per_unit;
                self.machine.unit_given = true;
            }
            Action::Absolute(absolute) => modes.absolute = absolute,
            Action::CentresAbsolute(absolute) => modes.centres_absolute = absolute,
            Action::RetractToR(to_r) => modes.retract_to_r = to_r,
            Action::FeedPerMinute => self.feed_mode(FeedMode::PerMinute),
            Action::FeedInverseTime => self.feed_mode(FeedMode::InverseTime),
            Action::FeedPerTurn => self.feed_mode(FeedMode::PerTurn),
            Action::Compensation { side, given } => {
                wanted.compensation = Some((code, side, given));
            }
            Action::Length(length) => wanted.length = Some((code, length)),
            Action::System(system) => wanted.system = Some(system),
            Action::Spindle(turning) => {
                modes.turning = turning;
                self.machine.has_turned |= turning;
            }
            Action::Change => wanted.change = true,
            Action::Set
            | Action::Home { .. }
            | Action::HomeHere { .. }
            | Action::Shift
            | Action::ShiftDirectly
            | Action::ShiftEnd { .. }
            | Action::ShiftResume => wanted.special = Some((code, action)),
            Action::ToolIs
            | Action::End
            | Action::Save
            | Action::SaveUntilReturn
            | Action::Restore
            | Action::Forget
            | Action::Call
            | Action::CallLine
            | Action::Return => wanted.after = Some((code, action)),
        }
    }

    fn feed_mode(&mut self, mode: FeedMode) {
        let modes = &mut self.machine.modes;
        if modes.feed_mode != mode {
            modes.feed = None;
        }
        modes.feed_mode = mode;
    }

    /// F, S, T and the change of tools.
    fn speeds_and_tool(&mut self, block: &mut Block, wanted: &Wanted) -> Result<(), At> {
        let dwells_by_f = wanted.dwell && block.get('P').is_none() && block.get('X').is_none();
        if self.machine.modes.feed_mode == FeedMode::InverseTime {
            self.machine.modes.feed = None;
        }
        if !dwells_by_f && let Some(feed) = block.take('F') {
            if feed < 0.0 {
                return Err((block.offset('F'), format!("a feed of {feed} is refused")));
            }
            let unit = match self.machine.modes.feed_mode {
                FeedMode::InverseTime => 1.0,
                FeedMode::PerMinute | FeedMode::PerTurn => self.machine.modes.mm_per_unit,
            };
            self.machine.modes.feed = (feed > 0.0).then_some(feed * unit);
        }
        let dwells_by_s = dwells_by_f && !block.has('F');
        if !dwells_by_s && let Some(speed) = block.take('S') {
            if speed < 0.0 {
                return Err((block.offset('S'), format!("a speed of {speed} is refused")));
            }
            self.machine.modes.speed = speed;
        }
        if block.has('T') {
            let tool = whole(block, 'T', 9_999_999)?.unwrap_or(0);
            self.machine.selected = u32::try_from(tool).expect("in range");
        }
        if wanted.change {
            self.machine.tool = self.machine.selected;
            self.machine.has_changed = true;
            self.machine.modes.turning = false;
            if self.machine.dialect.is_fanuc_like() {
                // These go up to their change position first.
                self.unknow(2, Known::Lost);
            }
        }
        Ok(())
    }

    /// Compensation, the tool's length and the work system.
    fn coordinates(&mut self, block: &mut Block, wanted: &Wanted) -> Result<(), At> {
        if let Some((code, side, given)) = wanted.compensation {
            self.compensation(block, code, side, given)?;
        }
        if let Some((code, length)) = wanted.length {
            self.length(block, code, length)?;
        }
        if let Some(system) = wanted.system {
            if system != self.machine.modes.system {
                self.no_compensation(block, "the work system")?;
            }
            self.machine.modes.system = system;
        }
        Ok(())
    }

    fn no_compensation(&self, block: &Block, what: &str) -> Result<(), At> {
        if self.machine.compensator.is_none() {
            return Ok(());
        }
        let offset = block.codes.first().map_or(0, |code| code.column as usize);
        Err((
            offset,
            format!("{what} must not change during cutter compensation"),
        ))
    }

    fn compensation(
        &mut self,
        block: &mut Block,
        code: Code,
        side: Option<Side>,
        given: bool,
    ) -> Result<(), At> {
        let offset = code.column as usize;
        let Some(side) = side else {
            block.take('D');
            return self.end_compensation(offset);
        };
        if self.machine.compensator.is_some() {
            return Err((
                offset,
                format!("{code} while cutter compensation is on already: G40 ends it first"),
            ));
        }
        if self.machine.modes.plane != Plane::Xy {
            return Err((
                offset,
                format!("{code} is refused: cutter compensation is supported in the plane XY only"),
            ));
        }
        let diameter = if given {
            block.take('L');
            let unit = self.machine.modes.mm_per_unit;
            block
                .take('D')
                .map(|diameter| diameter * unit)
                .ok_or_else(|| (offset, format!("{code} needs a diameter: D is missing")))?
        } else {
            let number = match whole(block, 'D', 9_999_999)? {
                Some(number) => u32::try_from(number).expect("in range"),
                None => self.machine.tool,
            };
            let tool = self.machine.tools.get(number);
            tool.and_then(|tool| tool.diameter).ok_or_else(|| {
                let what = format!("{code} is refused: the diameter of tool {number} is not known; give it by --tool or --tools");
                (offset, what)
            })?
        };
        self.machine.compensator = Some(Compensator::new(
            side,
            diameter / 2.0,
            self.machine.position,
        ));
        Ok(())
    }

    fn end_compensation(&mut self, offset: usize) -> Result<(), At> {
        let Some(compensator) = self.machine.compensator.take() else {
            return Ok(());
        };
        let mut steps = std::mem::take(&mut self.machine.steps);
        self.machine.position = compensator.end(&mut steps);
        self.push_steps(steps, offset)
    }

    fn length(&mut self, block: &mut Block, code: Code, length: Length) -> Result<(), At> {
        self.no_compensation(block, "the tool's length")?;
        let before = self.machine.frames.length;
        let mut after = match length {
            Length::None | Length::Table => [0.0; 3],
            Length::Given | Length::Added => before,
        };
        match length {
            Length::None => {
                block.take('H');
            }
            Length::Table | Length::Added => {
                let number = match whole(block, 'H', 9_999_999)? {
                    Some(number) => u32::try_from(number).expect("in range"),
                    None if length == Length::Added && !block.has_axes() => {
                        return Err((code.column as usize, format!("{code} needs H")));
                    }
                    None => self.machine.tool,
                };
                // Without a table the length is not known, and what is programmed is the tip all the same.
                if let Some(tool) = self.machine.tools.get(number) {
                    for axis in 0..3 {
                        after[axis] += tool.offset[axis];
                    }
                }
            }
            Length::Given => {
                let unit = self.machine.modes.mm_per_unit;
                for (axis, letter) in AXES.into_iter().enumerate() {
                    if let Some(value) = block.take(letter) {
                        after[axis] = value * unit;
                    }
                }
            }
        }
        self.machine.frames.length = after;
        for axis in 0..3 {
            let shift = before[axis] - after[axis];
            self.machine.position[axis] += shift;
            // The machine stands still, but how high the program takes the tip to be has changed.
            if (shift != 0.0 || axis == 2) && self.machine.known[axis] == Known::Said {
                self.unknow(axis, Known::Shifted);
            }
        }
        Ok(())
    }

    fn dwell(&mut self, block: &mut Block) -> Result<(), At> {
        let dialect = self.machine.dialect;
        let (letter, unit) = if block.has('P') {
            ('P', dialect.dwell_unit(block.has_point('P')))
        } else {
            let letter = ['X', 'U', 'F', 'S']
                .into_iter()
                .find(|letter| block.has(*letter));
            (letter.unwrap_or('P'), 1.0)
        };
        let Some(time) = block.take(letter) else {
            return Ok(());
        };
        let seconds = time * unit;
        if letter == 'P' && dialect == Dialect::Marlin {
            block.take('S');
        }
        if seconds < 0.0 {
            return Err((
                block.offset(letter),
                format!("a dwell of {seconds} s is refused"),
            ));
        }
        let whole = !block.has_point(letter);
        if letter == 'P' && unit == 1.0 && whole && seconds >= DWELL_QUESTIONED {
            self.report(
                "dwell",
                format!("of {seconds} s: if its P is in milliseconds, choose --dialect fanuc, haas or marlin"),
            );
        }
        self.push_dwell(seconds)
    }

    fn push_dwell(&mut self, seconds: f64) -> Result<(), At> {
        let line = self.line;
        let mut steps = std::mem::take(&mut self.machine.steps);
        match &mut self.machine.compensator {
            Some(compensator) => compensator.dwell(line, seconds, &mut steps),
            None => steps.push(Step::Dwell { line, seconds }),
        }
        self.push_steps(steps, 0)
    }

    /// Words that use the coordinates of the line for something else than a target.
    fn special(&mut self, block: &mut Block, wanted: &Wanted) -> Result<(), At> {
        let Some((code, action)) = wanted.special else {
            return Ok(());
        };
        if let Some(word) = wanted
            .motion
            .filter(|word| *word != MotionWord::Rapid && block.has_axes())
        {
            let what =
                format!("{code} and a motion ({word:?}) of the line both claim its coordinates");
            return Err((code.column as usize, what.to_lowercase()));
        }
        if !matches!(action, Action::HomeHere { .. }) {
            self.no_compensation(block, "coordinates")?;
        }
        let system = self.machine.modes.system;
        let unit = self.machine.modes.mm_per_unit;
        match action {
            Action::Set => self.set(block, code)?,
            Action::Home { second } => self.home(block, second)?,
            Action::HomeHere { second } => {
                let length = self.machine.frames.length;
                self.machine.homes[usize::from(second)] =
                    [0, 1, 2].map(|axis| self.machine.position[axis] + length[axis]);
            }
            Action::Shift => {
                let program = self
                    .machine
                    .frames
                    .to_program(system, self.machine.position);
                for (axis, letter) in AXES.into_iter().enumerate() {
                    if let Some(value) = block.take(letter) {
                        self.machine.frames.shift[axis] += program[axis] - value * unit;
                    }
                }
                block.take('E');
                self.machine.frames.shift_kept = self.machine.frames.shift;
            }
            Action::ShiftDirectly => {
                for (axis, letter) in AXES.into_iter().enumerate() {
                    if let Some(value) = block.take(letter) {
                        self.machine.frames.shift[axis] = value * unit;
                    }
                }
                self.machine.frames.shift_kept = self.machine.frames.shift;
            }
            Action::ShiftEnd { keep } => {
                self.machine.frames.shift = [0.0; 3];
                if !keep {
                    self.machine.frames.shift_kept = [0.0; 3];
                }
            }
            Action::ShiftResume => self.machine.frames.shift = self.machine.frames.shift_kept,
            _ => {}
        }
        Ok(())
    }

    /// G10.
    fn set(&mut self, block: &mut Block, code: Code) -> Result<(), At> {
        let offset = code.column as usize;
        let list = whole(block, 'L', 99)?
            .ok_or_else(|| (offset, "G10 needs L: what it sets".to_owned()))?;
        let number = whole(block, 'P', 9_999_999)?;
        let unit = self.machine.modes.mm_per_unit;
        let fanuc = self.machine.dialect.is_fanuc_like();
        match list {
            2 | 20 => {
                let system = match number {
                    None | Some(0) => self.machine.modes.system,
                    Some(number) => usize::try_from(number - 1)
                        .ok()
                        .filter(|system| *system < SYSTEMS)
                        .ok_or_else(|| {
                            (
                                block.offset('P'),
                                format!("there is no work system P{number}"),
                            )
                        })?,
                };
                if fanuc && list == 2 && !self.machine.modes.absolute {
                    return Err((
                        offset,
                        "G10 L2 in G91 is refused: it adds to what is not known".into(),
                    ));
                }
                self.set_system(block, system, list == 20);
            }
            1 | 10 | 11 if !fanuc => {
                let number = number.ok_or_else(|| (offset, "G10 needs P: the tool".to_owned()))?;
                let number = u32::try_from(number).expect("in range");
                let position = self.machine.program_position();
                let length = self.machine.frames.length;
                let tool = self.machine.tools.entry(number);
                if let Some(radius) = block.take('R') {
                    tool.diameter = Some(radius * unit * 2.0);
                }
                for (axis, letter) in AXES.into_iter().enumerate() {
                    let Some(value) = block.take(letter) else {
                        continue;
                    };
                    tool.offset[axis] = match list {
                        1 => value * unit,
                        // So that the position becomes this value once the length is in force.
                        _ => position[axis] + length[axis] - value * unit,
                    };
                }
                if list == 11 {
                    return Err((
                        offset,
                        "G10 L11 is refused: the system of fixtures (G59.3) is not kept apart"
                            .into(),
                    ));
                }
            }
            10..=13 if fanuc => {
                let number =
                    number.ok_or_else(|| (offset, "G10 needs P: the offset".to_owned()))?;
                let number = u32::try_from(number).expect("in range");
                let value = block.take('R').unwrap_or(0.0) * unit;
                let tool = self.machine.tools.entry(number);
                match list {
                    10 => tool.offset[2] = value,
                    12 => tool.diameter = Some(value * 2.0),
                    _ => {}
                }
            }
            _ => {
                return Err((
                    block.offset('L'),
                    format!("G10 L{list} is refused: it is not known"),
                ));
            }
        }
        Ok(())
    }

    fn set_system(&mut self, block: &mut Block, index: usize, from_position: bool) {
        let unit = self.machine.modes.mm_per_unit;
        let frames = &mut self.machine.frames;
        let mut system: System = frames.systems[index];
        if let Some(degrees) = block.take('R') {
            system.degrees = degrees;
        }
        let has_axes = block.has_axes();
        // Where the origin would have to be for the cutter to be at zero.
        let mut at_zero = frames.clone();
        at_zero.systems[index] = System {
            origin: [0.0; 3],
            ..system
        };
        let values = AXES.map(|letter| block.take(letter).map(|value| value * unit));
        if from_position {
            // Only what is named is set, so a turned system takes the rest from where it is now.
            let now = frames.to_program(index, self.machine.position);
            let wanted = [0, 1, 2].map(|axis| values[axis].unwrap_or(now[axis]));
            let reached = at_zero.to_machine(index, wanted);
            for axis in 0..3 {
                if values[axis].is_some() || system.degrees != 0.0 {
                    system.origin[axis] = self.machine.position[axis] - reached[axis];
                }
            }
            system.known = true;
        } else if has_axes {
            for axis in 0..3 {
                system.origin[axis] = values[axis].unwrap_or(system.origin[axis]);
            }
            if self.machine.base.is_none() {
                frames.machine_known = true;
            }
            system.known = frames.machine_known;
        }
        frames.systems[index] = system;
    }

    /// G28 and G30: over the point that is named to the reference point, on the axes that are named or on all.
    fn home(&mut self, block: &mut Block, second: bool) -> Result<(), At> {
        let named = AXES.map(|letter| block.has(letter));
        let direct = self.machine.dialect == Dialect::Marlin;
        if direct {
            for letter in AXES {
                block.take(letter);
            }
        } else if block.has_axes() {
            let offset = first_axis(block);
            self.place(offset)?;
            let target = self.target(block)?;
            self.rapid(target, offset)?;
        }
        let all = named == [false; 3];
        let mut target = self.machine.position;
        let length = self.machine.frames.length;
        for axis in 0..3 {
            if all || named[axis] {
                target[axis] = self.machine.homes[usize::from(second)][axis] - length[axis];
            }
        }
        if self.machine.frames.machine_known && !direct {
            let said = [0, 1, 2].map(|axis| all || named[axis]);
            self.say(said);
            return self.rapid(target, first_axis(block));
        }
        self.lose([0, 1, 2].map(|axis| all || named[axis]));
        Ok(())
    }

    /// A rapid to a point of the machine's whose place is not known.
    fn lose(&mut self, axes: [bool; 3]) {
        for (axis, lost) in axes.into_iter().enumerate() {
            if lost {
                self.machine.known[axis] = Known::Lost;
            }
        }
        let position = self.machine.position;
        self.push(Move::straight(
            self.line,
            Motion::Rapid,
            [position, position],
        ));
    }

    /// What was known of a coordinate holds no longer, though nothing moves in the program.
    fn unknow(&mut self, axis: usize, known: Known) {
        self.machine.known[axis] = known;
        self.machine.start_known[axis] = known;
    }

    /// Where the axis words lead.
    fn target(&mut self, block: &mut Block) -> Result<[f64; 3], At> {
        let modes = self.machine.modes;
        let (unit, system) = (modes.mm_per_unit, modes.system);
        let position = self.machine.position;
        if block.polar == [None; 2] && !self.machine.frames.is_turned(system) {
            let mut target = position;
            for (axis, letter) in AXES.into_iter().enumerate() {
                if let Some(value) = block.take(letter) {
                    let origin = if modes.absolute {
                        self.machine.frames.offset(system, axis)
                    } else {
                        position[axis]
                    };
                    target[axis] = origin + value * unit;
                    self.said(axis);
                }
            }
            return Ok(target);
        }
        let mut program = self.machine.program_position();
        if let Some(polar) = self.polar(block)? {
            (program[0], program[1]) = polar.from(program, &modes);
        }
        for (axis, letter) in AXES.into_iter().enumerate() {
            if let Some(value) = block.take(letter) {
                let origin = if modes.absolute { 0.0 } else { program[axis] };
                program[axis] = origin + value * unit;
                self.said(axis);
            }
        }
        Ok(self.machine.frames.to_machine(system, program))
    }

    /// The polar coordinates of a line.
    fn polar(&mut self, block: &mut Block) -> Result<Option<Polar>, At> {
        if block.polar == [None; 2] {
            return Ok(None);
        }
        if block.has('X') || block.has('Y') || self.machine.modes.plane != Plane::Xy {
            return Err((
                block.polar_offset,
                "polar coordinates go without X and Y, and in the plane XY only".into(),
            ));
        }
        self.said(0);
        self.said(1);
        let [radius, angle] = std::mem::take(&mut block.polar);
        Ok(Some(Polar { radius, angle }))
    }

    /// The program says a coordinate. A relative one says as much as was known.
    fn said(&mut self, axis: usize) {
        let known = &mut self.machine.known[axis];
        if self.machine.modes.absolute {
            *known = Known::Said;
        }
    }

    /// Before anything moves: the first system moved in is where the path is seen from, and others must have a known place.
    fn place(&mut self, offset: usize) -> Result<(), At> {
        let index = self.machine.modes.system;
        let machine = &mut *self.machine;
        if machine.base.is_none() {
            let system = &mut machine.frames.systems[index];
            if !system.known {
                if machine.frames.machine_known {
                    let what = format!(
                        "{} has no known origin: give it by --origin",
                        system_name(index)
                    );
                    return Err((offset, what));
                }
                system.known = true;
            }
            machine.base = Some(system.origin);
            if !machine.unit_given {
                self.report("unit", "not given: neither G20 (inch) nor G21 (mm) before the first move, millimetres are assumed");
            }
        } else if !machine.frames.systems[index].known {
            let what = format!(
                "the place of {} relative to the work system moved in before is not known: give both by --origin",
                system_name(index)
            );
            return Err((offset, what));
        }
        Ok(())
    }

    /// The move of the line, if there is one.
    fn motion(&mut self, block: &mut Block, wanted: &Wanted) -> Result<(), At> {
        if wanted.nurbs_end {
            self.end_nurbs(block)?;
        }
        if wanted.motion.is_some() || wanted.no_motion {
            if self.machine.nurbs.is_some() && wanted.motion != Some(MotionWord::Nurbs) {
                let offset = block.codes.first().map_or(0, |code| code.column as usize);
                return Err((offset, "a NURBS is not ended by G5.3".into()));
            }
            // G80 beside a motion ends cycles only.
            let was = self.machine.motion;
            if wanted.motion != Some(MotionWord::Cubic) {
                self.machine.spline_end = None;
            }
            self.machine.motion = wanted.motion;
            let is_cycle = |word: Option<MotionWord>| matches!(word, Some(MotionWord::Cycle(_)));
            let sticky = self.machine.sticky;
            if wanted.motion != was {
                // Another cycle at the same holes keeps its levels, not its steps and dwells.
                self.machine.sticky = if is_cycle(was) && is_cycle(wanted.motion) {
                    Sticky {
                        step: None,
                        dwell: None,
                        ..sticky
                    }
                } else {
                    Sticky::default()
                };
            }
        }
        let Some(word) = self.machine.motion else {
            if block.has_axes() {
                let offset = first_axis(block);
                return Err((
                    offset,
                    "coordinates without a motion word: no G0, G1, G2 or G3 is in force".into(),
                ));
            }
            return Ok(());
        };
        if !block.has_axes() && !moves_without_axes(word, block, wanted) {
            return Ok(());
        }
        let offset = first_axis(block);
        if wanted.machine_coordinates {
            return self.machine_target(block, word);
        }
        self.place(offset)?;
        match word {
            MotionWord::Rapid => {
                let target = self.target(block)?;
                self.rapid(target, offset)
            }
            MotionWord::Straight => {
                let target = self.target(block)?;
                self.check_feed(offset)?;
                self.straight(target, Motion::Feed, offset)
            }
            MotionWord::Arc { counterclockwise } => self.arc(block, counterclockwise),
            MotionWord::Cubic | MotionWord::Quadratic => self.spline(block, word),
            MotionWord::Nurbs => self.nurbs(block),
            MotionWord::Cycle(cycle) => self.cycle(block, cycle),
        }
    }

    /// A move in the machine's coordinates.
    fn machine_target(&mut self, block: &mut Block, word: MotionWord) -> Result<(), At> {
        let offset = first_axis(block);
        self.no_compensation(block, "coordinates")?;
        let unit = self.machine.modes.mm_per_unit;
        let words = AXES.map(|letter| block.take(letter));
        let said = words.map(|word| word.is_some());
        let known = self.machine.frames.machine_known;
        match word {
            MotionWord::Rapid if !known => {
                self.lose(said);
                return Ok(());
            }
            MotionWord::Rapid | MotionWord::Straight if known => {}
            MotionWord::Straight => {
                let what = "a feed move in machine coordinates is refused: where they begin is not known; give --home";
                return Err((offset, what.into()));
            }
            _ => return Err((offset, "G53 goes with G0 and G1 only".into())),
        }
        self.place(offset)?;
        let mut target = self.machine.position;
        for axis in 0..3 {
            if let Some(value) = words[axis] {
                target[axis] = value * unit - self.machine.frames.length[axis];
            }
        }
        if word == MotionWord::Rapid {
            self.say(said);
            return self.rapid(target, offset);
        }
        self.say(said);
        self.check_feed(offset)?;
        self.straight(target, Motion::Feed, offset)
    }

    fn say(&mut self, said: [bool; 3]) {
        for (known, said) in self.machine.known.iter_mut().zip(said) {
            if said {
                *known = Known::Said;
            }
        }
    }

    /// A rapid, or the rapids of a machine whose axes do not wait for each other.
    fn rapid(&mut self, target: [f64; 3], offset: usize) -> Result<(), At> {
        self.place(offset)?;
        let start = self.machine.position;
        let known = self.machine.known.contains(&Known::Lost);
        if self.machine.rapid_path == RapidPath::Straight
            || known
            || self.machine.compensator.is_some()
        {
            return self.straight(target, Motion::Rapid, offset);
        }
        let way = [0, 1, 2].map(|axis| target[axis] - start[axis]);
        let mut ends = way.map(f64::abs);
        ends.sort_by(f64::total_cmp);
        for done in ends {
            if done > 0.0 {
                // An axis that has come to its end stays there.
                let at = |axis: usize| {
                    if way[axis].abs() <= done {
                        target[axis]
                    } else {
                        start[axis] + done.copysign(way[axis])
                    }
                };
                self.straight([at(0), at(1), at(2)], Motion::Rapid, offset)?;
            }
        }
        if ends[2] == 0.0 {
            self.straight(target, Motion::Rapid, offset)?;
        }
        Ok(())
    }

    fn straight(&mut self, target: [f64; 3], motion: Motion, offset: usize) -> Result<(), At> {
        self.piece(target, Shape::Line, motion, offset)
    }

    /// Before a feed: the program must have said where it leads, and the machine must be able to follow.
    fn check_feed(&mut self, offset: usize) -> Result<(), At> {
        for (axis, letter) in AXES.into_iter().enumerate() {
            match self.machine.known[axis] {
                Known::Said => {}
                Known::Shifted => self.machine.known[axis] = Known::Said,
                Known::Unsaid => {
                    self.report(
                        "start",
                        format!("not given: {letter} is not said before the first feed move; the machine is taken to stand at zero"),
                    );
                    self.machine.known[axis] = Known::Said;
                }
                Known::Lost => {
                    let what = format!(
                        "{letter} is not known here: the machine went to a place of its own (reference point, machine coordinates or tool change), and no {letter} followed; give --home"
                    );
                    return Err((offset, what));
                }
            }
        }
        let modes = self.machine.modes;
        if modes.feed.is_none() {
            if modes.feed_mode == FeedMode::InverseTime {
                return Err((
                    offset,
                    "a feed move in inverse time (G93) needs F on its line".into(),
                ));
            }
            self.report(
                "feed",
                "not given: there is no F before this feed move, so it takes no time",
            );
        }
        if modes.feed_mode == FeedMode::PerTurn && modes.speed == 0.0 {
            self.report(
                "G95",
                "feeds are per turn and no speed S is given, so these moves take no time",
            );
        }
        if self.machine.has_turned && !modes.turning {
            self.report(
                "spindle",
                "stopped: the cutter is fed, and taken to cut all the same",
            );
        }
        if self.machine.selected != self.machine.tool && !self.machine.has_changed {
            let what = format!(
                "T{} is selected and never loaded by M6; the tool in the spindle is taken to cut",
                self.machine.selected
            );
            self.report("tool", what);
        }
        Ok(())
    }

    /// A move, beside the path if compensation is on.
    fn piece(
        &mut self,
        target: [f64; 3],
        shape: Shape,
        motion: Motion,
        offset: usize,
    ) -> Result<(), At> {
        let piece = Piece {
            line: self.line,
            motion,
            start: self.machine.position,
            end: target,
            shape,
            feed: self.machine.modes.feed.filter(|_| motion != Motion::Rapid),
        };
        self.machine.position = target;
        match &mut self.machine.compensator {
            None => self.push_piece(&piece).map_err(|what| (offset, what)),
            Some(compensator) => {
                let mut steps = std::mem::take(&mut self.machine.steps);
                compensator
                    .take(piece, &mut steps)
                    .map_err(|what| (offset, what))?;
                self.push_steps(steps, offset)
            }
        }
    }

    fn push_steps(&mut self, mut steps: Vec<Step>, offset: usize) -> Result<(), At> {
        let tool = self.machine.tool;
        for step in steps.drain(..) {
            match step {
                Step::Move(piece) => self.push_piece(&piece).map_err(|what| (offset, what))?,
                Step::Dwell { line, seconds } => self.events.push_back(Event::Dwell {
                    line,
                    tool,
                    seconds,
                    at: self.machine.said_last,
                }),
            }
        }
        self.machine.steps = steps;
        Ok(())
    }

    fn push_piece(&mut self, piece: &Piece) -> Result<(), String> {
        let ends = [piece.start, piece.end];
        let mut next = match piece.shape {
            Shape::Line => Move::straight(piece.line, piece.motion, ends),
            Shape::Arc {
                centre,
                counterclockwise,
                turns,
                ..
            } => {
                let plane = self.machine.modes.plane;
                let flat = ends.map(|point| plane.axes().map(|axis| point[axis]));
                let arc = arc::arc(plane, flat, Centre::At(centre), counterclockwise, turns)?;
                Move::arc(piece.line, ends, arc)
            }
        };
        next.feed = match self.machine.modes.feed_mode {
            _ if piece.motion == Motion::Rapid => None,
            FeedMode::PerMinute => piece.feed,
            FeedMode::InverseTime => piece.feed.map(|moves| moves * next.length),
            FeedMode::PerTurn => {
                let speed = self.machine.modes.speed;
                piece
                    .feed
                    .map(|feed| feed * speed)
                    .filter(|feed| *feed > 0.0)
            }
        };
        self.push(next);
        Ok(())
    }

    fn push(&mut self, mut next: Move) {
        let machine = &mut *self.machine;
        next.tool = machine.tool;
        next.start_known = machine.start_known == [Known::Said; 3];
        next.end_known = machine.known.map(|known| known == Known::Said);
        machine.start_known = machine.known;
        let seen = next.seen_from(machine.base.unwrap_or_default());
        machine.said_last = [0, 1, 2].map(|axis| seen.end_known[axis].then_some(seen.end[axis]));
        self.events.push_back(Event::Move(seen));
    }

    fn arc(&mut self, block: &mut Block, counterclockwise: bool) -> Result<(), At> {
        let offset = first_axis(block);
        let code = block
            .codes
            .first()
            .map_or(offset, |code| code.column as usize);
        let (plane, system) = (self.machine.modes.plane, self.machine.modes.system);
        if self.machine.frames.is_turned(system) && plane != Plane::Xy {
            return Err((
                code,
                "arcs in turned coordinates go in the plane XY only".into(),
            ));
        }
        let start = self.machine.position;
        let centre = self.centre(block, code)?;
        let target = self.target(block)?;
        self.check_feed(offset)?;
        let turns = match whole(block, 'P', 1_000_000)? {
            None => 0.0,
            Some(0) => {
                return Err((block.offset('P'), "an arc of P0 turns is refused".into()));
            }
            Some(turns) => f64::from(u32::try_from(turns - 1).expect("in range")),
        };
        let flat = [start, target].map(|point| plane.axes().map(|axis| point[axis]));
        let arc =
            arc::arc(plane, flat, centre, counterclockwise, turns).map_err(|what| (code, what))?;
        let difference = (arc.radius[0] - arc.radius[1]).abs();
        if difference > RADIUS_DIFFERENCE_REPORTED {
            let text = format!(
                "is run with a radius that changes evenly: its start is {:.4} mm and its end {:.4} mm from its centre",
                arc.radius[0], arc.radius[1]
            );
            if self.machine.compensator.is_some() {
                return Err((
                    code,
                    format!("an arc beside which the cutter cannot run evenly {text}"),
                ));
            }
            self.events.push_back(Event::Warning(Warning {
                line: self.line,
                code: "uneven-arc".into(),
                text,
            }));
        }
        let shape = Shape::Arc {
            centre: arc.centre,
            radius: arc.radius[0],
            counterclockwise,
            turns,
        };
        self.piece(target, shape, Motion::Arc, code)
    }

    fn centre(&self, block: &mut Block, code: usize) -> Result<Centre, At> {
        let modes = self.machine.modes;
        let (unit, system) = (modes.mm_per_unit, modes.system);
        let axes = modes.plane.axes();
        let letters = axes.map(|axis| CENTRES[axis]);
        let words = letters.map(|letter| block.take(letter).map(|value| value * unit));
        if let Some(radius) = block.take('R') {
            let offset = block.offset('R');
            return match words {
                [None, None] if radius != 0.0 => Ok(Centre::Radius(radius * unit)),
                [None, None] => Err((offset, "a radius R of 0 is refused".into())),
                _ => Err((
                    offset,
                    format!(
                        "an arc has either R or {} and {}, not both",
                        letters[0], letters[1]
                    ),
                )),
            };
        }
        let missing = words.iter().position(Option::is_none);
        if let Some(missing) = missing.filter(|_| modes.centres_absolute || words == [None, None]) {
            let what = format!(
                "the arc has no centre: {} or R is missing",
                letters[missing]
            );
            return Err((code, what));
        }
        let frames = &self.machine.frames;
        let mut point = [0.0; 3];
        for (axis, word) in axes.into_iter().zip(words) {
            point[axis] = word.unwrap_or(0.0);
        }
        let centre = if modes.centres_absolute {
            frames.to_machine(system, point)
        } else {
            let aside = frames.direction(system, point);
            [0, 1, 2].map(|axis| self.machine.position[axis] + aside[axis])
        };
        Ok(Centre::At(axes.map(|axis| centre[axis])))
    }

    /// G5 and G5.1.
    fn spline(&mut self, block: &mut Block, word: MotionWord) -> Result<(), At> {
        let offset = first_axis(block);
        let words = ['I', 'J', 'P', 'Q'].map(|letter| block.take(letter));
        self.check_spline(block, offset)?;
        let start = self.machine.position;
        let target = self.target(block)?;
        let unit = self.machine.modes.mm_per_unit;
        let system = self.machine.modes.system;
        let pair = |first: Option<f64>, second: Option<f64>| {
            let vector = [
                first.unwrap_or(0.0) * unit,
                second.unwrap_or(0.0) * unit,
                0.0,
            ];
            let [x, y, _] = self.machine.frames.direction(system, vector);
            [x, y]
        };
        let from = pair(words[0], words[1]);
        let first = |aside: [f64; 2]| [start[0] + aside[0], start[1] + aside[1]];
        let ends = [[start[0], start[1]], [target[0], target[1]]];
        let chords = if word == MotionWord::Cubic {
            let (Some(_), Some(_)) = (words[2], words[3]) else {
                return Err((offset, "a cubic spline (G5) needs P and Q".into()));
            };
            let back = pair(words[2], words[3]);
            let aside = match (words[0], words[1], self.machine.spline_end) {
                (None, None, Some(before)) => before,
                (Some(_), Some(_), _) => from,
                _ => return Err((offset, "a cubic spline (G5) needs I and J".into())),
            };
            self.machine.spline_end = Some(back.map(|part| -part));
            let second = [target[0] + back[0], target[1] + back[1]];
            spline::chords(
                spline::bezier([ends[0], first(aside), second, ends[1]]),
                4,
                self.machine.tolerance,
            )
        } else {
            if words[0].is_none() && words[1].is_none() {
                return Err((offset, "a quadratic spline (G5.1) needs I or J".into()));
            }
            spline::chords(
                spline::bezier([ends[0], first(from), ends[1]]),
                2,
                self.machine.tolerance,
            )
        };
        self.chords(&chords, target, offset)
    }

    fn check_spline(&mut self, block: &Block, offset: usize) -> Result<(), At> {
        if self.machine.modes.plane != Plane::Xy || block.has('Z') {
            return Err((offset, "splines go in the plane XY only".into()));
        }
        self.no_compensation(block, "straight moves and arcs")
    }

    fn chords(&mut self, chords: &[[f64; 2]], target: [f64; 3], offset: usize) -> Result<(), At> {
        self.check_feed(offset)?;
        let Some((_, before)) = chords.split_last() else {
            return Ok(());
        };
        for [x, y] in before {
            self.straight([*x, *y, target[2]], Motion::Feed, offset)?;
        }
        self.straight(target, Motion::Feed, offset)
    }

    /// G5.2 and the lines after it: control points.
    fn nurbs(&mut self, block: &mut Block) -> Result<(), At> {
        let offset = first_axis(block);
        let order = whole(block, 'L', 32)?;
        let weight = block.take('P');
        let weight_offset = block.offset('P');
        if weight.is_some_and(|weight| weight <= 0.0) {
            return Err((
                weight_offset,
                "the weight P of a control point must be more than 0".into(),
            ));
        }
        self.check_spline(block, offset)?;
        let has_axes = block.has_axes();
        let start = self.machine.position;
        if self.machine.nurbs.is_none() {
            let order = usize::try_from(order.unwrap_or(3)).expect("in range");
            if order < 2 {
                return Err((
                    block.offset('L'),
                    "the order L of a NURBS must be at least 2".into(),
                ));
            }
            let first = Control {
                at: [start[0], start[1]],
                weight: weight.unwrap_or(1.0),
            };
            self.machine.nurbs = Some(Nurbs {
                controls: vec![first],
                order,
                start,
            });
        } else if order.is_some() {
            return Err((
                block.offset('L'),
                "the order L stands with the first G5.2".into(),
            ));
        }
        if has_axes {
            let target = self.target(block)?;
            // Relative words count from the control point before.
            self.machine.position = target;
            let control = Control {
                at: [target[0], target[1]],
                weight: weight.unwrap_or(1.0),
            };
            if let Some(nurbs) = &mut self.machine.nurbs {
                nurbs.controls.push(control);
            }
        }
        Ok(())
    }

    fn end_nurbs(&mut self, block: &Block) -> Result<(), At> {
        let offset = block.codes.first().map_or(0, |code| code.column as usize);
        let Some(nurbs) = self.machine.nurbs.take() else {
            return Err((
                offset,
                "G5.3 ends no NURBS: there is no G5.2 before it".into(),
            ));
        };
        if nurbs.controls.len() < nurbs.order {
            let what = format!(
                "a NURBS of order {} needs as many control points and has {}",
                nurbs.order,
                nurbs.controls.len()
            );
            return Err((offset, what));
        }
        let end = std::mem::replace(&mut self.machine.position, nurbs.start);
        let pieces = u32::try_from(nurbs.controls.len()).expect("fewer lines than that") * 2;
        let curve = spline::nurbs(&nurbs.controls, nurbs.order);
        let chords = spline::chords(curve, pieces, self.machine.tolerance);
        self.machine.motion = None;
        self.chords(&chords, end, offset)
    }

    fn cycle(&mut self, block: &mut Block, cycle: Cycle) -> Result<(), At> {
        let offset = first_axis(block);
        self.no_compensation(block, "the motion to a cycle")?;
        let modes = self.machine.modes;
        let (unit, system, plane) = (modes.mm_per_unit, modes.system, modes.plane);
        if self.machine.frames.is_turned(system) && plane != Plane::Xy {
            return Err((
                offset,
                "cycles in turned coordinates go in the plane XY only".into(),
            ));
        }
        let ([first, second], normal) = (plane.axes(), plane.normal());
        let mut sticky = self.machine.sticky;
        let now = self.machine.program_position();
        let r = block.take('R').map(|value| value * unit);
        let bottom = block.take(AXES[normal]).map(|value| value * unit);
        // Where the run of cycles began: relative levels count from there, and G98 returns to it.
        let initial = *sticky.initial.get_or_insert(now[normal]);
        let origin = if modes.absolute { 0.0 } else { initial };
        sticky.r = r.map(|r| origin + r).or(sticky.r);
        let r = sticky.r.ok_or_else(|| {
            (
                offset,
                "a cycle needs R: the level down to which it goes fast".to_owned(),
            )
        })?;
        let origin = if modes.absolute { 0.0 } else { r };
        sticky.bottom = bottom.map(|bottom| origin + bottom).or(sticky.bottom);
        let letter = AXES[normal];
        let bottom = sticky.bottom.ok_or_else(|| {
            (
                offset,
                format!("a cycle needs {letter}: the bottom of the hole"),
            )
        })?;
        if let Some(step) = block.take('Q') {
            if step <= 0.0 {
                return Err((
                    block.offset('Q'),
                    "the step Q of a cycle must be more than 0".into(),
                ));
            }
            sticky.step = Some(step * unit);
        }
        if let Some(dwell) = block.get('P') {
            if dwell < 0.0 {
                return Err((
                    block.offset('P'),
                    "a dwell P of less than 0 is refused".into(),
                ));
            }
            let seconds = self.machine.dialect.dwell_unit(block.has_point('P'));
            sticky.dwell = Some(dwell * seconds);
            block.take('P');
        }
        let repeats = self.repeats(block, plane)?;
        let polar = self.polar(block)?;
        let holes = [first, second].map(|axis| block.take(AXES[axis]).map(|value| value * unit));
        let said = [first, second].map(|axis| (axis, holes[usize::from(axis == second)].is_some()));
        for (axis, given) in said {
            if given {
                self.said(axis);
            }
        }
        self.said(normal);
        self.check_feed(offset)?;
        let mut place = now;
        if place[normal] < r {
            place[normal] = r;
            self.stroke(place, Motion::Rapid, offset)?;
        }
        let clear = if modes.retract_to_r {
            r
        } else {
            initial.max(r)
        };
        let depths = Depths {
            r,
            bottom,
            clear,
            step: sticky.step,
            dwell: sticky.dwell,
        };
        self.machine.sticky = sticky;
        let strokes = cycle::strokes(cycle, depths).map_err(|what| (offset, what))?;
        if !modes.retract_to_r {
            place[normal] = clear;
        }
        for _ in 0..repeats {
            for (axis, value) in [first, second].into_iter().zip(holes) {
                if let Some(value) = value {
                    place[axis] = if modes.absolute {
                        value
                    } else {
                        place[axis] + value
                    };
                }
            }
            if let Some(polar) = polar {
                (place[0], place[1]) = polar.from(place, &modes);
            }
            self.stroke(place, Motion::Rapid, offset)?;
            place[normal] = r;
            self.stroke(place, Motion::Rapid, offset)?;
            for stroke in &strokes {
                match *stroke {
                    Stroke::Rapid(level) => {
                        place[normal] = level;
                        self.stroke(place, Motion::Rapid, offset)?;
                    }
                    Stroke::Feed(level) => {
                        place[normal] = level;
                        self.stroke(place, Motion::Feed, offset)?;
                    }
                    Stroke::Dwell(seconds) => self.push_dwell(seconds)?,
                }
            }
        }
        Ok(())
    }

    /// One stroke of a cycle. Those that lead nowhere are left out.
    fn stroke(&mut self, place: [f64; 3], motion: Motion, offset: usize) -> Result<(), At> {
        let frames = &self.machine.frames;
        let target = frames.to_machine(self.machine.modes.system, place);
        let moves = (0..3).any(|axis| (target[axis] - self.machine.position[axis]).abs() > 1e-9);
        match (moves, motion) {
            (false, _) => Ok(()),
            (true, Motion::Rapid) => self.rapid(target, offset),
            (true, _) => self.straight(target, motion, offset),
        }
    }

    /// How often a cycle is done: L, or K where Fanuc is followed.
    fn repeats(&self, block: &mut Block, plane: Plane) -> Result<u64, At> {
        let letter = if self.machine.dialect.is_fanuc_like() && plane == Plane::Xy && block.has('K')
        {
            'K'
        } else {
            'L'
        };
        Ok(whole(block, letter, REPEATS_MAX)?.unwrap_or(1))
    }

    /// Ends, calls and saved modes.
    fn after(&mut self, block: &mut Block, wanted: &Wanted) -> Result<After, At> {
        let Some((code, action)) = wanted.after else {
            return Ok(After::Next);
        };
        let offset = code.column as usize;
        match action {
            Action::End => return Ok(After::End),
            Action::Return => {
                if block.has('P') {
                    return Err((
                        offset,
                        "M99 P is refused: a return to another line is not supported".into(),
                    ));
                }
                block.take('L');
                return Ok(After::Return);
            }
            Action::Call | Action::CallLine => {
                let mut number = whole(block, 'P', 99_999_999)?
                    .ok_or_else(|| (offset, format!("{code} needs P: what it calls")))?;
                let mut times = whole(block, 'L', REPEATS_MAX)?;
                if action == Action::Call
                    && times.is_none()
                    && number > 9_999
                    && self.machine.dialect == Dialect::Fanuc
                {
                    // The old way: repeats, then four digits of the number.
                    (times, number) = (Some(number / 10_000), number % 10_000);
                }
                let times = times.unwrap_or(1);
                return Ok(if action == Action::Call {
                    After::Call { number, times }
                } else {
                    After::CallLine { number, times }
                });
            }
            Action::ToolIs => {
                let tool = whole(block, 'Q', 9_999_999)?
                    .ok_or_else(|| (offset, "M61 needs Q: the tool".to_owned()))?;
                self.machine.tool = u32::try_from(tool).expect("in range");
                self.machine.selected = self.machine.tool;
                self.machine.has_changed = true;
            }
            Action::Save => self.machine.saved = wanted.modes_before,
            Action::SaveUntilReturn => {
                let before = wanted.modes_before.unwrap_or(self.machine.modes);
                return Ok(After::SaveUntilReturn(before));
            }
            Action::Forget => self.machine.saved = None,
            _ => {}
        }
        Ok(After::Next)
    }

    /// Words that nothing on the line has used.
    fn leftovers(&mut self, block: &Block, wanted: &Wanted) -> Result<(), At> {
        let moved = wanted.motion.is_some() || block.has_used_axes();
        for (letter, value) in block.left() {
            match letter {
                'A' | 'B' | 'C' | 'U' | 'V' | 'W' if value == 0.0 => self.report(
                    &format!("axis-{}", letter.to_ascii_lowercase()),
                    "ignored: it stays at 0 here; only X, Y and Z are supported",
                ),
                'A' | 'B' | 'C' | 'U' | 'V' | 'W' => {
                    let what = format!(
                        "{letter}{value} is refused: only the axes X, Y and Z are supported"
                    );
                    return Err((block.offset(letter), what));
                }
                'E' if self.machine.dialect == Dialect::Marlin => self.report(
                    "extruder",
                    "ignored: a printer's program; its nozzle is taken for a cutter",
                ),
                'N' | 'D' | 'H' => {}
                'P' | 'Q' | 'L' | 'E' | 'S' if wanted.miscellaneous => {}
                'R' | 'I' | 'J' | 'K' if wanted.miscellaneous && !moved => {}
                _ => {
                    let what = format!("{letter}{value} is refused: nothing on the line uses it");
                    return Err((block.offset(letter), what));
                }
            }
        }
        Ok(())
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
