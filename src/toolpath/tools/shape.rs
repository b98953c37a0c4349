//! The shape of a tool: a stack of discs and cones around its axis, from the tip up.
//!
//! ```text
//!        |         |    holder: cones, from `length` up
//!      __|____ ____|__
//!           |   |       shank, from `flutes` to `length`: it must touch nothing
//!           |___|
//!          |     |      flutes: what cuts
//!           \_o_/       end; o is the tip
//! ```

/// The point angle of a drill where it is not said. Units: degrees.
pub(super) const DRILL_ANGLE: f64 = 118.0;

/// Most cones of a form, and of a holder.
const CONES_MAX: usize = 30;

/// The end of a tool.
#[derive(Clone, PartialEq, Debug)]
pub enum ToolEnd {
    /// A flat end mill.
    Flat,
    /// A ball end mill.
    Ball,
    /// A bull-nose end mill.
    Bull {
        /// Radius of its corner. Units: mm.
        corner: f64,
    },
    /// An engraver or a chamfer mill.
    Vee {
        /// The whole angle between its sides. Units: degrees.
        angle: f64,
        /// Diameter of its flat tip. Units: mm.
        tip: f64,
    },
    /// A drill.
    Drill {
        /// The whole angle of its point. Units: degrees.
        angle: f64,
    },
    /// A tapered end mill.
    Tapered {
        /// Between its axis and its side. Units: degrees.
        angle: f64,
        /// Diameter of its flat tip. Units: mm.
        tip: f64,
    },
    /// Any outline, turned about the axis: cones on each other.
    Form(Vec<Cone>),
}

/// A piece of a tool between two heights. Units: mm.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Cone {
    /// Diameter at its lower end.
    pub lower: f64,
    /// Diameter at its upper end.
    pub upper: f64,
    /// From its lower to its upper end.
    pub height: f64,
}

/// A tool. Units: mm.
#[derive(Clone, PartialEq, Debug)]
pub struct ToolShape {
    /// What it is like at the tip.
    pub end: ToolEnd,
    /// Its greatest diameter where it cuts.
    pub diameter: f64,
    /// How far up from the tip it cuts; up to the holder where it is not said.
    pub flutes: Option<f64>,
    /// Diameter above the flutes; as that of the flutes where it is not said.
    pub shank: Option<f64>,
    /// From the tip to the holder; where it is not said, the tool is as long as need be and has no holder.
    pub length: Option<f64>,
    /// From the lower end up.
    pub holder: Vec<Cone>,
}

impl ToolShape {
    /// A tool of which only the end and the diameter are known.
    pub(super) fn of(end: ToolEnd, diameter: f64) -> Self {
        Self {
            end,
            diameter,
            flutes: None,
            shank: None,
            length: None,
            holder: Vec::new(),
        }
    }

    /// The same shape, if there can be such a tool.
    ///
    /// # Errors
    /// A sentence says what is wrong with it.
    pub(super) fn checked(mut self) -> Result<Self, String> {
        let positive = |name: &str, value: f64| {
            if value > 0.0 && value.is_finite() {
                Ok(())
            } else {
                Err(format!("{name} {value} is not more than 0"))
            }
        };
        if let ToolEnd::Form(cones) = &self.end {
            check_cones("the form", cones)?;
            let height: f64 = cones.iter().map(|cone| cone.height).sum();
            self.flutes.get_or_insert(height);
        }
        positive("the diameter", self.diameter)?;
        for (name, value) in [
            ("the length of the flutes,", self.flutes),
            ("the length,", self.length),
            ("the diameter of the shank,", self.shank),
        ] {
            value.map_or(Ok(()), |value| positive(name, value))?;
        }
        let tip_fits = |tip: f64| {
            if tip >= 0.0 && tip < self.diameter {
                return Ok(());
            }
            let most = self.diameter;
            Err(format!(
                "the diameter of the tip, {tip}, is not from 0 to below {most}"
            ))
        };
        let angle_fits = |angle: f64, below: f64| {
            if angle > 0.0 && angle < below {
                return Ok(());
            }
            Err(format!("an angle of {angle} is not between 0 and {below}"))
        };
        match self.end {
            ToolEnd::Bull { corner } if !(corner > 0.0 && 2.0 * corner <= self.diameter) => {
                return Err(format!(
                    "the radius of the corner, {corner}, is not above 0 and at most half the diameter"
                ));
            }
            ToolEnd::Vee { angle, tip } => {
                angle_fits(angle, 180.0)?;
                tip_fits(tip)?;
            }
            ToolEnd::Drill { angle } => angle_fits(angle, 180.0)?,
            ToolEnd::Tapered { angle, tip } => {
                angle_fits(angle, 90.0)?;
                tip_fits(tip)?;
            }
            _ => {}
        }
        if let (Some(flutes), Some(length)) = (self.flutes, self.length)
            && flutes > length
        {
            return Err(format!(
                "flutes of {flutes} are longer than the tool out of its holder, {length}"
            ));
        }
        let needs_length = !self.holder.is_empty() || self.shank.is_some();
        if needs_length && self.length.is_none() {
            return Err("where the shank ends and the holder begins needs a length".into());
        }
        if !self.holder.is_empty() {
            check_cones("the holder", &self.holder)?;
        }
        Ok(self)
    }
}

fn check_cones(name: &str, cones: &[Cone]) -> Result<(), String> {
    if cones.is_empty() || cones.len() > CONES_MAX {
        return Err(format!(
            "{name} has {} cones; it must be 1 to {CONES_MAX}",
            cones.len()
        ));
    }
    let is_right = |cone: &Cone| {
        let sizes = [cone.lower, cone.upper, cone.height];
        sizes.iter().all(|size| size.is_finite() && *size >= 0.0)
            && cone.height > 0.0
            && cone.lower + cone.upper > 0.0
    };
    if cones.iter().all(is_right) {
        return Ok(());
    }
    Err(format!(
        "{name} has a cone without height, without width, or with a size below 0"
    ))
}
