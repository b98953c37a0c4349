//! `LinuxCNC`'s tool table: a line a tool, such as `T1 P1 Z-1.5 D6.0 ;end mill`.

use super::ToolTable;

impl ToolTable {
    /// Reads a table whose lengths are so many millimetres each.
    ///
    /// # Errors
    /// A sentence with the line at fault.
    pub fn read(text: &str, mm_per_unit: f64) -> Result<Self, String> {
        let mut table = Self::default();
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
            if table.get(number).is_some() {
                return Err(format!("line {line}: T{number} stands twice"));
            }
            let tool = table.entry(number);
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
        Ok(table)
    }
}
