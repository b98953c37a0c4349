//! The comments of a program, in which posts write what is no word of G-code, and the unit in which they count.

use super::text::lines_of;

/// The comments by their lines, from 1: one a line, in lower case, from its first bracket or semicolon on.
pub(super) fn comments(program: &[u8]) -> impl Iterator<Item = (u64, String)> {
    let lines = lines_of(program).map(|line| &program[line]);
    (1..).zip(lines).filter_map(|(number, line)| {
        let start = line.iter().position(|byte| matches!(byte, b'(' | b';'))?;
        let comment = String::from_utf8_lossy(&line[start + 1..]).to_ascii_lowercase();
        let comment = comment.trim().trim_end_matches(')').trim_end();
        Some((number, comment.to_owned()))
    })
}

/// Millimetres in the program's unit: that of its first G20 or G21, millimetres without one.
pub(super) fn mm_per_unit(program: &[u8]) -> f64 {
    let units = lines_of(program).find_map(|line| unit_of(&program[line]));
    units.unwrap_or(1.0)
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
