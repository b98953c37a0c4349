//! Tools as they are written on the command line, such as `T1=flat:6,length=22,holder=40x30`.

use super::{Cone, ToolEnd, ToolShape, ToolTable};

impl ToolTable {
    /// Adds the tool of a definition, in place of what the table says of its shape, and answers its number. Lengths are so many millimetres each.
    ///
    /// Without a number it is tool 0, that of programs which name none.
    ///
    /// ```text
    /// T1=flat:6   ball:6   bull:6,corner=1   vee:6,angle=60[,tip=0.2]   drill:6[,angle=118]   tapered:6,angle=3,tip=2
    ///    form:0x0/4x3/4x10               (diameter x height, from the tip up)
    ///    ...[,length=22][,flutes=15][,shank=6][,holder=40x30/50x20]   (diameter x height of cylinders, from the lower end up)
    /// ```
    ///
    /// # Errors
    /// A sentence says what is wrong.
    pub fn define(&mut self, text: &str, mm_per_unit: f64) -> Result<u32, String> {
        let (number, shape) = match text.strip_prefix(['T', 't']) {
            Some(numbered) if numbered.starts_with(|first: char| first.is_ascii_digit()) => {
                let (number, shape) = numbered
                    .split_once('=')
                    .ok_or("its number is followed by =, such as T1=flat:6")?;
                let parsed = number.parse();
                let number = parsed.map_err(|_| format!("T{number} is no number of a tool"))?;
                (number, shape)
            }
            _ => (0, text),
        };
        let shape = shape_of(shape, mm_per_unit)?;
        self.give(number, shape);
        Ok(number)
    }
}

fn shape_of(text: &str, mm_per_unit: f64) -> Result<ToolShape, String> {
    let mut words = text.split(',');
    let first = words.next().unwrap_or_default();
    let (kind, size) = first
        .split_once(':')
        .ok_or_else(|| format!("{first:?} is no kind and diameter, such as flat:6"))?;
    let mut given = Given::default();
    for word in words {
        given.take(word, mm_per_unit)?;
    }
    let end = match kind {
        "flat" => ToolEnd::Flat,
        "ball" => ToolEnd::Ball,
        "bull" => ToolEnd::Bull {
            corner: given.needed("corner", kind)?,
        },
        "vee" => ToolEnd::Vee {
            angle: given.needed("angle", kind)?,
            tip: given.number("tip").unwrap_or(0.0),
        },
        "drill" => ToolEnd::Drill {
            angle: given.number("angle").unwrap_or(super::shape::DRILL_ANGLE),
        },
        "tapered" => ToolEnd::Tapered {
            angle: given.needed("angle", kind)?,
            tip: given.needed("tip", kind)?,
        },
        "form" => ToolEnd::Form(outline(size, mm_per_unit)?),
        _ => {
            return Err(format!(
                "{kind:?} is none of flat, ball, bull, vee, drill, tapered, form"
            ));
        }
    };
    let diameter = match &end {
        ToolEnd::Form(cones) => cones
            .iter()
            .map(|cone| cone.lower.max(cone.upper))
            .fold(0.0, f64::max),
        _ => number(size)? * mm_per_unit,
    };
    let shape = ToolShape {
        flutes: given.number("flutes"),
        shank: given.number("shank"),
        length: given.number("length"),
        holder: std::mem::take(&mut given.holder),
        ..ToolShape::of(end, diameter)
    };
    if let Some((name, _)) = given.numbers.first() {
        return Err(format!("{name} does not belong to a {kind}"));
    }
    shape.checked()
}

/// What follows the kind.
#[derive(Default)]
struct Given {
    numbers: Vec<(&'static str, f64)>,
    holder: Vec<Cone>,
}

impl Given {
    fn take(&mut self, word: &str, mm_per_unit: f64) -> Result<(), String> {
        const NAMES: [&str; 6] = ["length", "flutes", "shank", "corner", "tip", "angle"];
        let (name, value) = word
            .split_once('=')
            .ok_or_else(|| format!("{word:?} is no name and value, such as length=22"))?;
        if name == "holder" {
            let cylinders = pairs(value, mm_per_unit)?;
            self.holder = cylinders
                .into_iter()
                .map(|[diameter, height]| Cone {
                    lower: diameter,
                    upper: diameter,
                    height,
                })
                .collect();
            return Ok(());
        }
        let name = *NAMES
            .iter()
            .find(|known| **known == name)
            .ok_or_else(|| format!("{name:?} is none of {}, holder", NAMES.join(", ")))?;
        if self.numbers.iter().any(|(known, _)| *known == name) {
            return Err(format!("{name} is given twice"));
        }
        let unit = if name == "angle" { 1.0 } else { mm_per_unit };
        self.numbers.push((name, number(value)? * unit));
        Ok(())
    }

    fn number(&mut self, name: &str) -> Option<f64> {
        let place = self.numbers.iter().position(|(known, _)| *known == name)?;
        Some(self.numbers.remove(place).1)
    }

    fn needed(&mut self, name: &str, kind: &str) -> Result<f64, String> {
        self.number(name)
            .ok_or_else(|| format!("a {kind} needs {name}="))
    }
}

/// The cones between points of an outline.
fn outline(text: &str, mm_per_unit: f64) -> Result<Vec<Cone>, String> {
    let points = pairs(text, mm_per_unit)?;
    if points.first().is_none_or(|[_, height]| *height != 0.0) {
        return Err("a form begins at the tip, at height 0".into());
    }
    let mut cones = Vec::new();
    for ends in points.windows(2) {
        let [[lower, from], [upper, to]] = [ends[0], ends[1]];
        if to < from {
            return Err(format!("a form goes up: {to} comes after {from}"));
        }
        // Two points at one height are a step.
        if to > from {
            cones.push(Cone {
                lower,
                upper,
                height: to - from,
            });
        }
    }
    Ok(cones)
}

/// Diameters and heights, such as `40x30/50x20`.
fn pairs(text: &str, mm_per_unit: f64) -> Result<Vec<[f64; 2]>, String> {
    let pair = |pair: &str| {
        let (diameter, height) = pair
            .split_once('x')
            .ok_or_else(|| format!("{pair:?} is no diameter and height, such as 40x30"))?;
        Ok([
            number(diameter)? * mm_per_unit,
            number(height)? * mm_per_unit,
        ])
    };
    text.split('/').map(pair).collect()
}

fn number(text: &str) -> Result<f64, String> {
    text.trim()
        .parse()
        .ok()
        .filter(|number: &f64| number.is_finite())
        .ok_or_else(|| format!("{text:?} is not a number"))
}
