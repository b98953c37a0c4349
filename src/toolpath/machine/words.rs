//! What the words of a line ask for: modes, speeds, tools, calls, and words that nothing uses.

use super::{
    Action, After, At, Block, Code, Dialect, FeedMode, GROUPS, Known, REPEATS_MAX, Run, Treatment,
    Wanted, group, whole,
};

impl Run<'_> {
    /// Looks every code up. Modes that nothing else on the line depends on are set at once.
    pub(super) fn wanted(&mut self, block: &Block) -> Result<Wanted, At> {
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

    pub(super) fn want(&mut self, code: Code, action: Action, wanted: &mut Wanted) {
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

    /// M72: before anything else of the line.
    pub(super) fn restore(&mut self, block: &Block, code: Code) -> Result<(), At> {
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

    pub(super) fn feed_mode(&mut self, mode: FeedMode) {
        let modes = &mut self.machine.modes;
        if modes.feed_mode != mode {
            modes.feed = None;
        }
        modes.feed_mode = mode;
    }

    /// F, S, T and the change of tools.
    pub(super) fn speeds_and_tool(&mut self, block: &mut Block, wanted: &Wanted) -> Result<(), At> {
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

    /// Ends, calls and saved modes.
    pub(super) fn after(&mut self, block: &mut Block, wanted: &Wanted) -> Result<After, At> {
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
    pub(super) fn leftovers(&mut self, block: &Block, wanted: &Wanted) -> Result<(), At> {
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
}
