//! Parameters that the machine itself keeps.

use super::{FeedMode, Machine, MotionWord, Plane};

impl Machine {
    /// A parameter that the machine itself keeps, in the program's unit; none for those it does not.
    pub(in super::super) fn parameter(&self, number: u16) -> Option<f64> {
        let unit = self.modes.mm_per_unit;
        let axis = |values: [f64; 3], first: u16| match usize::from(number - first) {
            place @ 0..3 => values[place] / unit,
            _ => 0.0,
        };
        Some(match number {
            5161..=5169 => axis(self.homes[0], 5161),
            5181..=5189 => axis(self.homes[1], 5181),
            5210 => f64::from(u8::from(
                self.frames.shift.iter().any(|part| part.abs() > 0.0),
            )),
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
    pub(in super::super) fn named(&self, name: &str) -> Option<f64> {
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
            "_abs_x" => self.position[0] / unit,
            "_abs_y" => self.position[1] / unit,
            "_abs_z" => self.position[2] / unit,
            "_metric" => truth(unit < 2.0),
            "_imperial" => truth(unit > 2.0),
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
            "_tool_offset" => truth(self.frames.length.iter().any(|part| part.abs() > 0.0)),
            "_cutter_comp" => truth(self.compensator.is_some()),
            "_spindle_on" => truth(self.modes.turning),
            "_rpm" => self.modes.speed,
            "_feed" => match self.modes.feed_mode {
                FeedMode::InverseTime => self.modes.feed.unwrap_or(0.0),
                _ => self.modes.feed.unwrap_or(0.0) / unit,
            },
            "_motion_mode" => self.motion.map_or(800.0, motion),
            "_vmajor" => 2.9,
            "_a" | "_b" | "_c" | "_u" | "_v" | "_w" | "_vminor" | "_task" => 0.0,
            _ => return None,
        })
    }
}
