//! Arcs and splines.

use super::{
    At, Block, CENTRES, Centre, Control, Event, Motion, MotionWord, Nurbs, Plane,
    RADIUS_DIFFERENCE_REPORTED, Run, Shape, Warning, arc, first_axis, spline, whole,
};

impl Run<'_> {
    pub(super) fn arc(&mut self, block: &mut Block, counterclockwise: bool) -> Result<(), At> {
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

    pub(super) fn centre(&self, block: &mut Block, code: usize) -> Result<Centre, At> {
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
    pub(super) fn spline(&mut self, block: &mut Block, word: MotionWord) -> Result<(), At> {
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

    pub(super) fn check_spline(&mut self, block: &Block, offset: usize) -> Result<(), At> {
        if self.machine.modes.plane != Plane::Xy || block.has('Z') {
            return Err((offset, "splines go in the plane XY only".into()));
        }
        self.no_compensation(block, "straight moves and arcs")
    }

    pub(super) fn chords(
        &mut self,
        chords: &[[f64; 2]],
        target: [f64; 3],
        offset: usize,
    ) -> Result<(), At> {
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
    pub(super) fn nurbs(&mut self, block: &mut Block) -> Result<(), At> {
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

    pub(super) fn end_nurbs(&mut self, block: &Block) -> Result<(), At> {
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
}
