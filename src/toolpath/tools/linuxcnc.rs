//! `LinuxCNC`'s tool table: a line a tool, such as `T1 P1 Z-1.5 D6.0 ;end mill`.

use std::collections::BTreeSet;

use super::{Shaped, ToolTable};

impl ToolTable {
    /// Adds the tools of a file: a library of Fusion 360 in JSON, or `LinuxCNC`'s table, whose lengths are so many millimetres each.
    ///
    /// # Errors
    /// A sentence with the line or the place at fault.
    pub fn add(&mut self, text: &str, mm_per_unit: f64) -> Result<(), String> {
        if !text.trim_start().starts_with('{') {
            return self.add_linuxcnc(text, mm_per_unit);
        }
        let value = serde_json::from_str(text).map_err(|error| error.to_string())?;
        self.add_fusion(&value)
    }

    fn add_linuxcnc(&mut self, text: &str, mm_per_unit: f64) -> Result<(), String> {
        let mut numbers = BTreeSet::new();
        for (line, row) in (1..).zip(text.lines()) {
            let row = row.split(';').next().unwrap_or_default();
            let mut number = None;
            let mut words = Vec::new();
            for word in row.split_ascii_whitespace() {
                let mut letters = word.chars();
                let letter = letters.next().unwrap_or(' ').to_ascii_uppercase();
                let value: f64 = letters
                    .as_str()
                    .parse()
                    .map_err(|_| format!("line {line}: {word:?} is no word of a tool table"))?;
                if letter == 'T' {
                    let parsed = letters.as_str().parse();
                    number =
                        Some(parsed.map_err(|_| {
                            format!("line {line}: {word:?} is no number of a tool")
                        })?);
                } else {
                    words.push((letter, value * mm_per_unit));
                }
            }
            let Some(number) = number else {
                if words.is_empty() {
                    continue;
                }
                return Err(format!("line {line}: there is no T"));
            };
            if !numbers.insert(number) {
                return Err(format!("line {line}: T{number} stands twice"));
            }
            let tool = self.entry(number);
            if tool.shape == Shaped::Unknown {
                let why = "a tool table says how long and how wide it is, not its shape";
                tool.shape = Shaped::Unsupported(why.into());
            }
            for (letter, value) in words {
                match letter {
                    'X' => tool.offset[0] = value,
                    'Y' => tool.offset[1] = value,
                    'Z' => tool.offset[2] = value,
                    'D' => tool.diameter = Some(value),
                    // The pocket, other axes, and what lathes need.
                    'P' | 'A' | 'B' | 'C' | 'U' | 'V' | 'W' | 'I' | 'J' | 'Q' => {}
                    _ => return Err(format!("line {line}: {letter} is no word of a tool table")),
                }
            }
        }
        Ok(())
    }
}
