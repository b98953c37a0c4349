//! Canned cycles.

use super::{
    AXES, At, Block, Cycle, Depths, Motion, Plane, REPEATS_MAX, Run, Sticky, Stroke, cycle,
    first_axis, whole,
};

impl Run<'_> {
    pub(super) fn cycle(&mut self, block: &mut Block, cycle: Cycle) -> Result<(), At> {
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
        let now = self.machine.program_position();
        let (sticky, initial) = self.levels(block, now[normal], normal)?;
        let (Some(r), Some(bottom)) = (sticky.r, sticky.bottom) else {
            let what = format!(
                "a cycle needs R, the level down to which it goes fast, and {}, the bottom of the hole",
                AXES[normal]
            );
            return Err((offset, what));
        };
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
        let mut tip = now;
        if tip[normal] < r {
            tip[normal] = r;
            self.stroke(tip, Motion::Rapid, offset)?;
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
            tip[normal] = clear;
        }
        for _ in 0..repeats {
            for (axis, value) in [first, second].into_iter().zip(holes) {
                if let Some(value) = value {
                    tip[axis] = if modes.absolute {
                        value
                    } else {
                        tip[axis] + value
                    };
                }
            }
            if let Some(polar) = polar {
                (tip[0], tip[1]) = polar.from(tip, &modes);
            }
            self.stroke(tip, Motion::Rapid, offset)?;
            tip[normal] = r;
            self.stroke(tip, Motion::Rapid, offset)?;
            for stroke in &strokes {
                let (level, motion) = match *stroke {
                    Stroke::Rapid(level) => (level, Motion::Rapid),
                    Stroke::Feed(level) => (level, Motion::Feed),
                    Stroke::Dwell(seconds) => {
                        self.push_dwell(seconds)?;
                        continue;
                    }
                };
                tip[normal] = level;
                self.stroke(tip, motion, offset)?;
            }
        }
        Ok(())
    }

    /// The levels of a cycle, from its line or from those before, and where the run of cycles began.
    fn levels(&self, block: &mut Block, now: f64, normal: usize) -> Result<(Sticky, f64), At> {
        let modes = self.machine.modes;
        let unit = modes.mm_per_unit;
        let mut sticky = self.machine.sticky;
        let r = block.take('R').map(|value| value * unit);
        let bottom = block.take(AXES[normal]).map(|value| value * unit);
        // Relative levels count from where the run of cycles began, and G98 returns to it.
        let initial = *sticky.initial.get_or_insert(now);
        let origin = if modes.absolute { 0.0 } else { initial };
        sticky.r = r.map(|r| origin + r).or(sticky.r);
        let origin = match sticky.r {
            Some(r) if !modes.absolute => r,
            _ => 0.0,
        };
        sticky.bottom = bottom.map(|bottom| origin + bottom).or(sticky.bottom);
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
        Ok((sticky, initial))
    }

    /// One stroke of a cycle. Those that lead nowhere are left out.
    pub(super) fn stroke(
        &mut self,
        place: [f64; 3],
        motion: Motion,
        offset: usize,
    ) -> Result<(), At> {
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
    pub(super) fn repeats(&self, block: &mut Block, plane: Plane) -> Result<u64, At> {
        let letter = if self.machine.dialect.is_fanuc_like() && plane == Plane::Xy && block.has('K')
        {
            'K'
        } else {
            'L'
        };
        Ok(whole(block, letter, REPEATS_MAX)?.unwrap_or(1))
    }
}
