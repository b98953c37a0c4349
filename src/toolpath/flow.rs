//! O-words: where a line says how the program goes on.

use super::expression::{Reader, Unreadable};
use super::text::Text;

/// What an O-word says.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Keyword {
    /// Nothing: the number of a program.
    Header,
    Sub,
    EndSub,
    Call,
    Return,
    If,
    ElseIf,
    Else,
    EndIf,
    While,
    EndWhile,
    Do,
    Repeat,
    EndRepeat,
    Break,
    Continue,
}

/// Longer words before those they begin with.
const KEYWORDS: [(&str, Keyword); 15] = [
    ("ENDSUB", Keyword::EndSub),
    ("ENDIF", Keyword::EndIf),
    ("ENDWHILE", Keyword::EndWhile),
    ("ENDREPEAT", Keyword::EndRepeat),
    ("ELSEIF", Keyword::ElseIf),
    ("ELSE", Keyword::Else),
    ("SUB", Keyword::Sub),
    ("CALL", Keyword::Call),
    ("RETURN", Keyword::Return),
    ("IF", Keyword::If),
    ("WHILE", Keyword::While),
    ("DO", Keyword::Do),
    ("REPEAT", Keyword::Repeat),
    ("BREAK", Keyword::Break),
    ("CONTINUE", Keyword::Continue),
];

/// What tells one O-word from another: a number or a name.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub(super) enum Label {
    Number(u64),
    Name(String),
    /// Worked out when the line is run.
    Computed,
}

impl std::fmt::Display for Label {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(number) => write!(formatter, "o{number}"),
            Self::Name(name) => write!(formatter, "o<{name}>"),
            Self::Computed => formatter.write_str("an o-word with a computed number"),
        }
    }
}

/// An O-word and the line (from 0) it stands on.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Control {
    pub(super) line: usize,
    pub(super) label: Label,
    pub(super) keyword: Keyword,
}

/// Whether a line begins with an O-word, after a line number if it has one: the reader stands at the `O` then.
pub(super) fn begins(reader: &mut Reader<'_>) -> bool {
    let start = reader.at;
    if reader.peek() == b'N' {
        reader.at += 1;
        while reader.peek().is_ascii_digit() {
            reader.at += 1;
        }
    }
    let found = matches!(reader.peek(), b'O' | b':');
    if !found {
        reader.at = start;
    }
    found
}

/// Reads an O-word up to its keyword. A computed label is left for the caller: the reader stands before it, and no keyword is read.
///
/// # Errors
/// [`Unreadable`], when it is none.
pub(super) fn read(reader: &mut Reader<'_>) -> Result<(Label, Keyword), Unreadable> {
    reader.at += 1;
    let label = match reader.peek() {
        b'<' => {
            reader.at += 1;
            Label::Name(reader.name()?)
        }
        b'0'..=b'9' => Label::Number(digits(reader)?),
        b'#' | b'[' => return Ok((Label::Computed, Keyword::Header)),
        _ => return reader.fail("an o-word has a number or a <name>"),
    };
    Ok((label, keyword(reader)?))
}

/// Reads what stands behind the label.
///
/// # Errors
/// [`Unreadable`], when it is no keyword.
pub(super) fn keyword(reader: &mut Reader<'_>) -> Result<Keyword, Unreadable> {
    let found = KEYWORDS
        .into_iter()
        .find(|(word, _)| reader.take_word(word));
    if let Some((_, keyword)) = found {
        return Ok(keyword);
    }
    match reader.peek() {
        0 | b'(' | b';' => Ok(Keyword::Header),
        _ => reader.fail("no word that may follow an o-word"),
    }
}

fn digits(reader: &mut Reader<'_>) -> Result<u64, Unreadable> {
    let mut number = 0_u64;
    while let digit @ b'0'..=b'9' = reader.peek() {
        number = number * 10 + u64::from(digit - b'0');
        if number > 999_999_999 {
            return reader.fail("the number of an o-word has more than 9 digits");
        }
        reader.at += 1;
    }
    Ok(number)
}

/// All O-words of a text with labels that stand there. Lines that cannot be read are left for when they are run.
pub(super) fn controls(text: &Text) -> Vec<Control> {
    let mut controls = Vec::new();
    for (line, bytes) in text.lines().enumerate() {
        let mut reader = Reader::new(bytes);
        if begins(&mut reader)
            && let Ok((label, keyword)) = read(&mut reader)
        {
            controls.push(Control {
                line,
                label,
                keyword,
            });
        }
    }
    controls
}
