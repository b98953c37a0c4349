//! Tool libraries of Fusion 360 in JSON.

use serde_json::Value;

use super::{Cone, Shaped, ToolEnd, ToolShape, ToolTable};

impl ToolTable {
    /// Adds the tools of a library, by the numbers that its post processor gives them. Those whose shape is not supported are kept as
    /// such: a program that does not cut with them may still be milled.
    ///
    /// # Errors
    /// A sentence says what is wrong, with the place of the tool.
    pub(super) fn add_fusion(&mut self, library: &Value) -> Result<(), String> {
        let tools = library["data"]
            .as_array()
            .ok_or("data is no list of tools")?;
        for (index, tool) in tools.iter().enumerate() {
            let kind = tool["type"].as_str().unwrap_or_default();
            if kind == "holder" {
                continue;
            }
            let number = tool["post-process"]["number"]
                .as_u64()
                .and_then(|number| u32::try_from(number).ok())
                .ok_or_else(|| format!("/data/{index}: post-process has no number"))?;
            if self.is_shaped(number) {
                return Err(format!("/data/{index}: T{number} stands twice"));
            }
            match shape_of(tool, kind) {
                Ok(shape) => self.give(number, shape),
                Err(why) => {
                    self.entry(number).shape =
                        Shaped::Unsupported(format!("it is a {kind} in the library: {why}"));
                }
            }
        }
        Ok(())
    }
}

fn shape_of(tool: &Value, kind: &str) -> Result<ToolShape, String> {
    let mm_per_unit = unit(&tool["unit"])?;
    let geometry = &tool["geometry"];
    let number = |name: &str| geometry[name].as_f64();
    let length = |name: &str| number(name).map(|length| length * mm_per_unit);
    let needed = |name: &str, value: Option<f64>| value.ok_or(format!("it has no {name}"));
    let mut diameter = needed("DC", length("DC"))?;
    let corner = length("RE").unwrap_or(0.0);
    let flutes = length("LCF");
    let rounded = if corner > 0.0 {
        ToolEnd::Bull { corner }
    } else {
        ToolEnd::Flat
    };
    let is_straight = number("TA").unwrap_or(0.0) == 0.0;
    let end = match kind {
        "flat end mill" | "reamer" | "boring bar" | "counter bore" => ToolEnd::Flat,
        "bull nose end mill" => ToolEnd::Bull { corner },
        "ball end mill" => ToolEnd::Ball,
        "face mill" | "slot mill" if is_straight => rounded,
        "drill" | "spot drill" => ToolEnd::Drill {
            angle: needed("SIG", number("SIG"))?,
        },
        "counter sink" => ToolEnd::Vee {
            angle: needed("SIG", number("SIG"))?,
            tip: length("tip-diameter").unwrap_or(0.0),
        },
        "chamfer mill" if corner == 0.0 => ToolEnd::Vee {
            angle: 2.0 * needed("TA", number("TA"))?,
            tip: length("tip-diameter").unwrap_or(0.0),
        },
        "tapered mill" if corner == 0.0 => {
            // Its diameter is that of the tip; the flutes widen up to their end.
            let (angle, tip) = (needed("TA", number("TA"))?, diameter);
            let flutes = needed("LCF", flutes)?;
            diameter = tip + 2.0 * flutes * angle.to_radians().tan();
            ToolEnd::Form(vec![Cone {
                lower: tip,
                upper: diameter,
                height: flutes,
            }])
        }
        _ => return Err("no shape for that is known here".into()),
    };
    let body = length("LB");
    let holder = cones(
        &tool["holder"]["segments"],
        unit(&tool["holder"]["unit"]).unwrap_or(mm_per_unit),
    )?;
    let shank = match (kind, length("shoulder-diameter"), length("SFDM")) {
        ("slot mill" | "face mill", Some(neck), _) if neck > 0.0 => Some(neck),
        (.., shaft) => shaft.filter(|shaft| *shaft > 0.0),
    };
    ToolShape {
        flutes: flutes.map(|flutes| body.map_or(flutes, |body| flutes.min(body))),
        shank: shank.filter(|_| body.is_some()),
        length: body,
        holder: if body.is_some() { holder } else { Vec::new() },
        ..ToolShape::of(end, diameter)
    }
    .checked()
}

fn unit(value: &Value) -> Result<f64, String> {
    match value.as_str() {
        Some("millimeters") => Ok(1.0),
        Some("inches") => Ok(25.4),
        _ => Err(format!("{value} is neither millimeters nor inches")),
    }
}

/// The pieces of a holder, from the lower end up.
fn cones(segments: &Value, mm_per_unit: f64) -> Result<Vec<Cone>, String> {
    let Some(segments) = segments.as_array() else {
        return Ok(Vec::new());
    };
    let cone = |segment: &Value| {
        let length = |name: &str| {
            segment[name]
                .as_f64()
                .map(|length| length * mm_per_unit)
                .ok_or_else(|| format!("a piece of its holder has no {name}"))
        };
        Ok(Cone {
            lower: length("lower-diameter")?,
            upper: length("upper-diameter")?,
            height: length("height")?,
        })
    };
    let cones: Result<Vec<Cone>, String> = segments.iter().map(cone).collect();
    // A piece without height is a step, which the diameters beside it say, too.
    Ok(cones?
        .into_iter()
        .filter(|cone| cone.height > 0.0)
        .collect())
}
