//! Tools as Autodesk's posts write them into comments: `(T1 D=6. CR=0. - ZMIN=-3. - flat end mill)`.

use super::super::comment::{comments, mm_per_unit};
use super::{Shaped, ToolEnd, ToolShape, ToolTable};

impl ToolTable {
    /// Takes the shapes of tools from the comments of a program, where the table has none. They are in the program's unit.
    pub fn take_comments(&mut self, program: &[u8]) {
        let mut unit = None;
        for (number, comment) in comments(program) {
            let Some((tool, text)) = tool_of(&comment) else {
                continue;
            };
            let unit = *unit.get_or_insert_with(|| mm_per_unit(program));
            let shaped = match shape_of(text, unit) {
                Ok(shape) => Shaped::Comment(shape, number),
                Err(why) => Shaped::Unsupported(format!("the comment on line {number} {why}")),
            };
            let tool = self.entry(tool);
            if matches!(tool.shape, Shaped::Unknown | Shaped::Unsupported(_)) {
                tool.shape = shaped;
            }
        }
    }
}

/// The number of a tool and what a comment says of it.
fn tool_of(comment: &str) -> Option<(u32, &str)> {
    let rest = comment.strip_prefix('t')?;
    let digits = rest.len()
        - rest
            .trim_start_matches(|digit: char| digit.is_ascii_digit())
            .len();
    let (number, rest) = rest.split_at(digits);
    let is_tool = rest.starts_with(char::is_whitespace) && rest.contains(" d=");
    Some((number.parse().ok().filter(|_| is_tool)?, rest))
}

fn shape_of(text: &str, mm_per_unit: f64) -> Result<ToolShape, String> {
    let value = |name: &str| {
        let at = text.find(&format!(" {name}="))? + name.len() + 2;
        let digits: String = text[at..]
            .chars()
            .take_while(|letter| letter.is_ascii_digit() || matches!(letter, '.' | '-'))
            .collect();
        digits.parse::<f64>().ok()
    };
    let diameter = value("d").ok_or("has no diameter")? * mm_per_unit;
    let corner = value("cr").map(|corner| corner * mm_per_unit);
    let kind = text.rsplit(" - ").next().unwrap_or_default().trim();
    let rounded = match corner {
        Some(corner) if corner > 0.0 => ToolEnd::Bull { corner },
        _ => ToolEnd::Flat,
    };
    let end = match kind {
        "flat end mill" | "bull nose end mill" | "face mill" => rounded,
        "ball end mill" => ToolEnd::Ball,
        "drill" | "spot drill" => ToolEnd::Drill {
            angle: value("taper").ok_or("does not say the angle of the drill's point")?,
        },
        _ => return Err(format!("does not say all of the shape of a {kind:?}")),
    };
    ToolShape::of(end, diameter)
        .checked()
        .map_err(|wrong| format!("is wrong: {wrong}"))
}
