//! Tools as Autodesk's posts write them into comments: `(T1 D=6. CR=0. - ZMIN=-3. - flat end mill)`.

use super::{Shaped, ToolEnd, ToolShape, ToolTable};

impl ToolTable {
    /// Takes the shapes of tools from the comments of a program, where the table has none. They are in the program's unit, which is that
    /// of its first G20 or G21, millimetres without one.
    pub fn take_comments(&mut self, program: &[u8]) {
        let lines = || program.split(|byte| matches!(byte, b'\n' | b'\r'));
        let mut mm_per_unit = None;
        for (number, line) in (1..).zip(lines()) {
            let Some((tool, text)) = tool_of(line) else {
                continue;
            };
            let unit = *mm_per_unit.get_or_insert_with(|| lines().find_map(unit_of).unwrap_or(1.0));
            let shaped = match shape_of(&text, unit) {
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

/// Millimetres in the unit that a line sets, if it does.
fn unit_of(line: &[u8]) -> Option<f64> {
    let code = line
        .split(|byte| matches!(byte, b'(' | b';'))
        .next()
        .unwrap_or_default()
        .to_ascii_uppercase();
    let has = |word: &[u8; 3]| {
        code.windows(3).enumerate().any(|(at, window)| {
            window == word
                && !code
                    .get(at + 3)
                    .is_some_and(|next| next.is_ascii_digit() || *next == b'.')
        })
    };
    match (has(b"G20"), has(b"G21")) {
        (true, _) => Some(25.4),
        (_, true) => Some(1.0),
        _ => None,
    }
}

/// The number of a tool and what a comment says of it, in lower case.
fn tool_of(line: &[u8]) -> Option<(u32, String)> {
    let start = line.iter().position(|byte| matches!(byte, b'(' | b';'))?;
    let comment = String::from_utf8_lossy(&line[start + 1..]).to_ascii_lowercase();
    let comment = comment.trim_start();
    let digits: String = comment
        .strip_prefix('t')?
        .chars()
        .take_while(char::is_ascii_digit)
        .collect();
    let rest = &comment[1 + digits.len()..];
    let is_tool = rest.starts_with(char::is_whitespace) && rest.contains(" d=");
    let number = digits.parse().ok().filter(|_| is_tool)?;
    Some((number, rest.trim_end().trim_end_matches(')').to_owned()))
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
