//! Words that change what coordinates mean, and where they lead to the machine's own places.

use super::{
    AXES, Action, At, Block, Code, Compensator, Dialect, Known, Length, Motion, MotionWord, Move,
    Plane, Run, SYSTEMS, Side, System, Wanted, first_axis, system_name, whole,
};

impl Run<'_> {
    /// Compensation, the tool's length and the work system.
    pub(super) fn coordinates(&mut self, block: &mut Block, wanted: &Wanted) -> Result<(), At> {
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

    pub(super) fn no_compensation(&self, block: &Block, what: &str) -> Result<(), At> {
        if self.machine.compensator.is_none() {
            return Ok(());
        }
        let offset = block.codes.first().map_or(0, |code| code.column as usize);
        Err((
            offset,
            format!("{what} must not change during cutter compensation"),
        ))
    }

    pub(super) fn compensation(
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

    pub(super) fn end_compensation(&mut self, offset: usize) -> Result<(), At> {
        let Some(compensator) = self.machine.compensator.take() else {
            return Ok(());
        };
        let mut steps = std::mem::take(&mut self.machine.steps);
        self.machine.position = compensator.end(&mut steps);
        self.push_steps(steps, offset)
    }

    pub(super) fn length(
        &mut self,
        block: &mut Block,
        code: Code,
        length: Length,
    ) -> Result<(), At> {
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
                    for (after, offset) in after.iter_mut().zip(tool.offset) {
                        *after += offset;
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

    /// Words that use the coordinates of the line for something else than a target.
    pub(super) fn special(&mut self, block: &mut Block, wanted: &Wanted) -> Result<(), At> {
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
    pub(super) fn set(&mut self, block: &mut Block, code: Code) -> Result<(), At> {
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

    pub(super) fn set_system(&mut self, block: &mut Block, index: usize, from_position: bool) {
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
            for (origin, value) in system.origin.iter_mut().zip(values) {
                *origin = value.unwrap_or(*origin);
            }
            if self.machine.base.is_none() {
                frames.machine_known = true;
            }
            system.known = frames.machine_known;
        }
        frames.systems[index] = system;
    }

    /// G28 and G30: over the point that is named to the reference point, on the axes that are named or on all.
    pub(super) fn home(&mut self, block: &mut Block, second: bool) -> Result<(), At> {
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
    pub(super) fn lose(&mut self, axes: [bool; 3]) {
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
    pub(super) fn unknow(&mut self, axis: usize, known: Known) {
        self.machine.known[axis] = known;
        self.machine.start_known[axis] = known;
    }

    /// Before anything moves: the first system moved in is where the path is seen from, and others must have a known place.
    pub(super) fn place(&mut self, offset: usize) -> Result<(), At> {
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
}
