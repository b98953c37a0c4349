//! Where the axis words of a line lead.

use super::{AXES, At, Block, Known, Plane, Polar, Run};

impl Run<'_> {
    /// Where the axis words lead.
    pub(super) fn target(&mut self, block: &mut Block) -> Result<[f64; 3], At> {
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
    pub(super) fn polar(&mut self, block: &mut Block) -> Result<Option<Polar>, At> {
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
    pub(super) fn said(&mut self, axis: usize) {
        let known = &mut self.machine.known[axis];
        if self.machine.modes.absolute {
            *known = Known::Said;
        }
    }

    pub(super) fn say(&mut self, said: [bool; 3]) {
        for (known, said) in self.machine.known.iter_mut().zip(said) {
            if said {
                *known = Known::Said;
            }
        }
    }
}
