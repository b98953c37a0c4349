//! Tool bits of `FreeCAD` (`.fctb`), and the libraries that number them (`.fctl`).

use serde_json::Value;

use super::{Shaped, ToolEnd, ToolShape, ToolTable};

/// A tool bit as it was read: its shape, or why it has none here.
pub type Bit = Result<ToolShape, String>;

/// Reads a tool bit.
///
/// # Errors
/// A sentence when the text is no tool bit at all.
pub fn bit(text: &str) -> Result<Bit, String> {
    let value: Value = serde_json::from_str(text).map_err(|error| error.to_string())?;
    let (Some(shape), true) = (value["shape"].as_str(), value["parameter"].is_object()) else {
        return Err("it has no shape and parameter: it is no tool bit".into());
    };
    let shape = shape.rsplit(['/', '\\']).next().unwrap_or_default();
    let kind = shape
        .split('.')
        .next()
        .unwrap_or_default()
        .to_ascii_lowercase();
    Ok(shape_of(&value["parameter"], &kind))
}

/// The numbers of a library and the files of their bits, as they are written there; none when the text is no library.
pub fn bits(text: &str) -> Option<Vec<(u32, String)>> {
    let value: Value = serde_json::from_str(text).ok()?;
    let tools = value["tools"].as_array()?;
    let tool = |tool: &Value| {
        let number = u32::try_from(tool["nr"].as_u64()?).ok()?;
        Some((number, tool["path"].as_str()?.to_owned()))
    };
    tools.iter().map(tool).collect()
}

impl ToolTable {
    /// Adds a tool bit under a number.
    ///
    /// # Errors
    /// When the number has a shape already.
    pub fn add_bit(&mut self, number: u32, bit: Bit) -> Result<(), String> {
        if self.is_shaped(number) {
            return Err(format!("T{number} is given twice"));
        }
        match bit {
            Ok(shape) => self.give(number, shape),
            Err(why) => self.entry(number).shape = Shaped::Unsupported(why),
        }
        Ok(())
    }
}

fn shape_of(parameters: &Value, kind: &str) -> Bit {
    let quantity = |name: &str| match &parameters[name] {
        Value::Null => Ok(None),
        Value::Number(number) => Ok(number.as_f64()),
        Value::String(text) => {
            let read = quantity(text);
            read.map(Some)
                .ok_or_else(|| format!("its {name}, {text:?}, is no length or angle"))
        }
        other => Err(format!("its {name} is {other}")),
    };
    let needed =
        |name: &str| quantity(name)?.ok_or_else(|| format!("the bit of a {kind} has no {name}"));
    let diameter = needed("Diameter")?;
    let end = match kind {
        "endmill" | "reamer" | "slittingsaw" => ToolEnd::Flat,
        "ballend" => ToolEnd::Ball,
        "bullnose" | "torus" => ToolEnd::Bull {
            corner: match quantity("CornerRadius")? {
                Some(corner) => corner,
                None => diameter / 2.0 - needed("FlatRadius")?,
            },
        },
        "v-bit" | "vbit" | "chamfer" => ToolEnd::Vee {
            angle: needed("CuttingEdgeAngle")?,
            tip: quantity("TipDiameter")?.unwrap_or(0.0),
        },
        "drill" => ToolEnd::Drill {
            angle: needed("TipAngle")?,
        },
        _ => {
            return Err(format!(
                "it is a {kind} in FreeCAD, which has no shape here"
            ));
        }
    };
    // What FreeCAD calls the length is the whole tool, of which the holder takes a part that it does not say, unless it says how far it sticks out.
    let length = quantity("Stickout")?;
    ToolShape {
        flutes: match (kind, quantity("BladeThickness")?) {
            ("slittingsaw", Some(thickness)) => Some(thickness),
            _ => quantity("CuttingEdgeHeight")?,
        },
        shank: quantity("ShankDiameter")?.filter(|_| length.is_some()),
        length,
        ..ToolShape::of(end, diameter)
    }
    .checked()
}

/// A number with its unit, such as `5.0000 mm` or `0.125 in`, in millimetres or degrees.
fn quantity(text: &str) -> Option<f64> {
    let text = text.trim();
    let end = text
        .find(|letter: char| !(letter.is_ascii_digit() || matches!(letter, '.' | ',' | '-' | '+')))
        .unwrap_or(text.len());
    let number: f64 = text[..end].replace(',', ".").parse().ok()?;
    let unit = match text[end..].trim() {
        "" | "mm" | "\u{b0}" | "deg" => 1.0,
        "in" | "\"" => 25.4,
        "cm" => 10.0,
        "m" => 1000.0,
        "um" | "\u{b5}m" => 0.001,
        _ => return None,
    };
    Some(number * unit)
}
