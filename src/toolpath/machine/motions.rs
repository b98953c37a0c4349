//! The moves of a line, and how they come out.

use super::{
    AXES, At, Block, Centre, DWELL_QUESTIONED, Dialect, Event, FeedMode, Known, Motion, MotionWord,
    Move, Piece, RapidPath, Run, Shape, Step, Sticky, Wanted, arc, first_axis, moves_without_axes,
};

impl Run<'_> {
    /// The move of the line, if there is one.
    pub(super) fn motion(&mut self, block: &mut Block, wanted: &Wanted) -> Result<(), At> {
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
    pub(super) fn machine_target(&mut self, block: &mut Block, word: MotionWord) -> Result<(), At> {
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

    /// A rapid, or the rapids of a machine whose axes do not wait for each other.
    pub(super) fn rapid(&mut self, target: [f64; 3], offset: usize) -> Result<(), At> {
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

    pub(super) fn straight(
        &mut self,
        target: [f64; 3],
        motion: Motion,
        offset: usize,
    ) -> Result<(), At> {
        self.piece(target, Shape::Line, motion, offset)
    }

    /// Before a feed: the program must have said where it leads, and the machine must be able to follow.
    pub(super) fn check_feed(&mut self, offset: usize) -> Result<(), At> {
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
    pub(super) fn piece(
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

    pub(super) fn push_steps(&mut self, mut steps: Vec<Step>, offset: usize) -> Result<(), At> {
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

    pub(super) fn push_piece(&mut self, piece: &Piece) -> Result<(), String> {
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

    pub(super) fn push(&mut self, mut next: Move) {
        let machine = &mut *self.machine;
        next.tool = machine.tool;
        next.start_known = machine.start_known == [Known::Said; 3];
        next.end_known = machine.known.map(|known| known == Known::Said);
        machine.start_known = machine.known;
        let seen = next.seen_from(machine.base.unwrap_or_default());
        machine.said_last = [0, 1, 2].map(|axis| seen.end_known[axis].then_some(seen.end[axis]));
        self.events.push_back(Event::Move(seen));
    }

    pub(super) fn dwell(&mut self, block: &mut Block) -> Result<(), At> {
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
        if letter == 'P' && unit > 0.5 && whole && seconds >= DWELL_QUESTIONED {
            self.report(
                "dwell",
                format!("of {seconds} s: if its P is in milliseconds, choose --dialect fanuc, haas or marlin"),
            );
        }
        self.push_dwell(seconds)
    }

    pub(super) fn push_dwell(&mut self, seconds: f64) -> Result<(), At> {
        let line = self.line;
        let mut steps = std::mem::take(&mut self.machine.steps);
        match &mut self.machine.compensator {
            Some(compensator) => compensator.dwell(line, seconds, &mut steps),
            None => steps.push(Step::Dwell { line, seconds }),
        }
        self.push_steps(steps, 0)
    }
}
