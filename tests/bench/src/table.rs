//! Tables of figures: Markdown for a README, JSON for programs, from the same cells.

use std::io::Write as _;

use comfy_table::presets::ASCII_MARKDOWN;
use comfy_table::{CellAlignment, Table as Drawn};
use indicatif::{HumanCount, HumanFloatCount};
use serde_json::{Map, Value, json};

use super::machine::Machine;

/// A table that grows by rows.
#[derive(Clone, Debug)]
pub(crate) struct Table {
    title: String,
    /// What the columns mean, where their headings do not say it.
    note: String,
    columns: Vec<Column>,
    rows: Vec<Vec<Cell>>,
}

#[derive(Clone, Debug)]
struct Column {
    key: String,
    heading: String,
}

/// What stands in a column of a row.
#[derive(Clone, Debug)]
pub(crate) enum Cell {
    Text(String),
    Count(u64),
    /// A figure, and how many significant digits of it are for the eye.
    Figure(f64, usize),
    Nothing,
}

/// A figure of three digits: more would be noise.
pub(crate) fn figure(value: f64) -> Cell {
    Cell::Figure(value, 3)
}

/// Text.
pub(crate) fn text(text: impl Into<String>) -> Cell {
    Cell::Text(text.into())
}

/// A whole number with its thousands apart, for titles.
pub(crate) fn grouped(count: usize) -> HumanCount {
    HumanCount(count as u64)
}

impl Table {
    /// An empty table of columns, each a key for JSON and a heading.
    pub(crate) fn new<'column>(
        title: impl Into<String>,
        note: impl Into<String>,
        columns: impl IntoIterator<Item = (&'column str, &'column str)>,
    ) -> Self {
        let columns = columns.into_iter().map(|(key, heading)| Column {
            key: key.to_owned(),
            heading: heading.to_owned(),
        });
        Self {
            title: title.into(),
            note: note.into(),
            columns: columns.collect(),
            rows: Vec::new(),
        }
    }

    pub(crate) fn push(&mut self, row: Vec<Cell>) {
        assert_eq!(row.len(), self.columns.len(), "a cell for every column");
        self.rows.push(row);
    }

    fn markdown(&self) -> String {
        // Names to the left, figures to the right.
        let is_text = |column: usize| {
            let mut cells = self.rows.iter().map(|row| &row[column]);
            cells.any(|cell| matches!(cell, Cell::Text(_)))
        };
        let mut drawn = Drawn::new();
        drawn.load_style(ASCII_MARKDOWN);
        drawn.set_header(self.columns.iter().map(|column| column.heading.as_str()));
        drawn.add_rows(self.rows.iter().map(|row| row.iter().map(Cell::markdown)));
        for (number, column) in drawn.column_iter_mut().enumerate() {
            if !is_text(number) {
                column.set_cell_alignment(CellAlignment::Right);
            }
        }
        let mut lines: Vec<String> = drawn.lines().collect();
        // The style draws the rule below the headings without Markdown's marks of alignment.
        lines[1] = lines[1]
            .split('|')
            .enumerate()
            .map(|(part, dashes)| match dashes.strip_suffix('-') {
                Some(dashes) if !is_text(part - 1) => format!("{dashes}:"),
                _ => dashes.to_owned(),
            })
            .collect::<Vec<_>>()
            .join("|");
        let note = if self.note.is_empty() { "" } else { "\n\n" };
        format!(
            "### {}{note}{}\n\n{}\n",
            self.title,
            self.note,
            lines.join("\n")
        )
    }

    fn json(&self) -> Value {
        let row = |row: &Vec<Cell>| {
            let keys = self.columns.iter().map(|column| column.key.clone());
            Value::Object(keys.zip(row.iter().map(Cell::json)).collect::<Map<_, _>>())
        };
        json!({
            "title": self.title,
            "note": self.note,
            "rows": self.rows.iter().map(row).collect::<Vec<_>>(),
        })
    }
}

impl Cell {
    fn markdown(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Count(count) => HumanCount(*count).to_string(),
            Self::Figure(value, digits) => significant(*value, *digits),
            Self::Nothing => String::new(),
        }
    }

    fn json(&self) -> Value {
        match self {
            Self::Text(text) => json!(text),
            Self::Count(count) => json!(count),
            Self::Figure(value, _) => json!(value),
            Self::Nothing => Value::Null,
        }
    }
}

/// A number with so many significant digits, never fewer than its whole part has.
fn significant(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return "-".to_owned();
    }
    // `{:e}` rounds first, so 9.996 with three digits is 1.00e1.
    let scientific = format!("{value:.*e}", digits.saturating_sub(1));
    let exponent = scientific
        .split_once('e')
        .and_then(|(_, exponent)| exponent.parse::<i32>().ok())
        .unwrap_or(0);
    if value != 0.0 && exponent < -4 {
        return scientific;
    }
    let shown = i32::try_from(digits).unwrap_or(i32::MAX) - 1 - exponent;
    let text = format!("{value:.*}", usize::try_from(shown).unwrap_or(0));
    let (whole, fraction) = text.split_at(text.find('.').unwrap_or(text.len()));
    let whole: f64 = whole.parse().expect("digits are a number");
    format!("{:.0}{fraction}", HumanFloatCount(whole))
}

/// What a benchmark prints: the machine, then its tables.
#[derive(Clone, Debug)]
pub(crate) struct Report {
    machine: Machine,
    /// What else there is to know about all of it.
    remarks: Vec<String>,
    tables: Vec<Table>,
}

impl Report {
    /// A report on this machine as it is now: to be made before the work.
    pub(crate) fn new() -> Self {
        Self {
            machine: Machine::new(),
            remarks: Vec::new(),
            tables: Vec::new(),
        }
    }

    pub(crate) fn remark(&mut self, remark: impl Into<String>) {
        self.remarks.push(remark.into());
    }

    pub(crate) fn push(&mut self, table: Table) {
        self.tables.push(table);
    }

    /// Prints it on standard output.
    pub(crate) fn print(&self, as_json: bool) -> std::io::Result<()> {
        let mut output = std::io::stdout().lock();
        if as_json {
            let tables: Vec<Value> = self.tables.iter().map(Table::json).collect();
            let report = json!({
                "machine": self.machine,
                "remarks": self.remarks,
                "tables": tables,
            });
            return writeln!(output, "{report}");
        }
        writeln!(output, "{}", self.machine.markdown())?;
        for remark in &self.remarks {
            writeln!(output, "{remark}\n")?;
        }
        for table in &self.tables {
            writeln!(output, "{}", table.markdown())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_the_digits_that_count() {
        for (value, expected) in [
            (0.0, "0.00"),
            (1.0, "1.00"),
            (9.996, "10.0"),
            (0.012_345, "0.0123"),
            (123.4, "123"),
            (1_234_567.0, "1,234,567"),
            (0.000_001_234, "1.23e-6"),
            (f64::NAN, "-"),
        ] {
            assert_eq!(significant(value, 3), expected);
        }
    }
}
