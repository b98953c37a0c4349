//! Which controller a program is written for, and what its own text says about that.

/// A controller whose reading of the words is followed where controllers differ.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Dialect {
    /// RS274/NGC as `LinuxCNC` documents it.
    LinuxCnc,
    /// Fanuc and what follows it.
    Fanuc,
    /// Haas mills.
    Haas,
    /// Grbl, grblHAL, `FluidNC`.
    Grbl,
    /// Mach3 and Mach4.
    Mach3,
    /// Marlin and its relatives on printers that mill.
    Marlin,
}

impl Dialect {
    /// All of them, in the order of the table of words.
    pub const ALL: [Self; 6] = [
        Self::LinuxCnc,
        Self::Fanuc,
        Self::Haas,
        Self::Grbl,
        Self::Mach3,
        Self::Marlin,
    ];

    /// As it is written on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::LinuxCnc => "linuxcnc",
            Self::Fanuc => "fanuc",
            Self::Haas => "haas",
            Self::Grbl => "grbl",
            Self::Mach3 => "mach3",
            Self::Marlin => "marlin",
        }
    }

    /// Its bit in a set of dialects.
    pub(super) const fn bit(self) -> u8 {
        1 << self as u8
    }

    /// Whether lines that begin with `/` are left out when nobody says so: Grbl and Marlin have no such switch.
    pub(super) fn deletes_blocks(self) -> bool {
        !matches!(self, Self::Grbl | Self::Marlin)
    }

    /// Whether Fanuc's ways hold: `M98` with its repeats before the number, variables without a value, `G10 L10` to `L13`.
    pub(super) fn is_fanuc_like(self) -> bool {
        matches!(self, Self::Fanuc | Self::Haas)
    }

    /// Seconds in a unit of the P of G4, which Haas takes in seconds when it has a decimal point.
    pub(super) fn dwell_unit(self, has_point: bool) -> f64 {
        match self {
            Self::Fanuc | Self::Marlin => 0.001,
            Self::Haas if !has_point => 0.001,
            Self::LinuxCnc | Self::Haas | Self::Grbl | Self::Mach3 => 1.0,
        }
    }
}

/// A dwell of so many seconds is taken for one of so many milliseconds, when it is a whole number and nothing else says what controller it is for.
const DWELL_IN_MILLISECONDS: u32 = 250;

/// How many lines are read to guess the dialect.
const GUESS_LINES: usize = 2_000;

/// What gives a dialect away, looked for in text in upper case without spaces; the first that is found decides.
const SIGNS: [(&str, Where, Dialect); 24] = [
    ("HAAS", Where::Comment, Dialect::Haas),
    ("MACH3", Where::Comment, Dialect::Mach3),
    ("MACH4", Where::Comment, Dialect::Mach3),
    ("GRBL", Where::Comment, Dialect::Grbl),
    ("LINUXCNC", Where::Comment, Dialect::LinuxCnc),
    ("FANUC", Where::Comment, Dialect::Fanuc),
    ("MARLIN", Where::Comment, Dialect::Marlin),
    ("#<", Where::Code, Dialect::LinuxCnc),
    ("O<", Where::Code, Dialect::LinuxCnc),
    ("SUB", Where::Code, Dialect::LinuxCnc),
    ("CALL", Where::Code, Dialect::LinuxCnc),
    ("ENDIF", Where::Code, Dialect::LinuxCnc),
    ("ENDWHILE", Where::Code, Dialect::LinuxCnc),
    ("$", Where::Start, Dialect::Grbl),
    ("M104", Where::Code, Dialect::Marlin),
    ("M109", Where::Code, Dialect::Marlin),
    ("M140", Where::Code, Dialect::Marlin),
    ("M190", Where::Code, Dialect::Marlin),
    ("M82", Where::Start, Dialect::Marlin),
    ("G187", Where::Code, Dialect::Haas),
    ("G154", Where::Code, Dialect::Haas),
    ("M97", Where::Code, Dialect::Haas),
    ("M98", Where::Code, Dialect::Fanuc),
    ("G5.1Q", Where::Code, Dialect::Fanuc),
];

#[derive(Clone, Copy, PartialEq, Eq)]
enum Where {
    Comment,
    Code,
    Start,
}

/// What the text says about its dialect: the dialect, the line (from 1) and the sign that gave it away; none when nothing does.
pub(super) fn guess<'text>(
    lines: impl Iterator<Item = &'text [u8]>,
) -> Option<(Dialect, u64, &'static str)> {
    let (mut header, mut dwell) = (None, None);
    for (number, line) in (1..).zip(lines.take(GUESS_LINES)) {
        let mut code = Vec::with_capacity(line.len());
        let mut comment = Vec::new();
        let mut open = false;
        for &byte in line {
            match byte {
                b'(' | b';' => open = true,
                b')' => open = false,
                _ if byte.is_ascii_whitespace() => {}
                _ if open => comment.push(byte.to_ascii_uppercase()),
                _ => code.push(byte.to_ascii_uppercase()),
            }
        }
        if header.is_none() && is_program_number(&code) {
            header = Some((Dialect::Fanuc, number, "a program number"));
        }
        if dwell.is_none() && whole_dwell(&code).is_some_and(|time| time >= DWELL_IN_MILLISECONDS) {
            let sign = "a dwell whose P is too many seconds and a whole number";
            dwell = Some((Dialect::Fanuc, number, sign));
        }
        for (sign, place, dialect) in SIGNS {
            let found = match place {
                Where::Comment => contains(&comment, sign),
                Where::Code => contains(&code, sign),
                Where::Start => code.starts_with(sign.as_bytes()),
            };
            if found {
                return Some((dialect, number, sign));
            }
        }
    }
    header.or(dwell)
}

/// The P of a dwell that has no decimal point.
fn whole_dwell(code: &[u8]) -> Option<u32> {
    let code = std::str::from_utf8(code).ok()?;
    let (_, time) = code.split_once("G4P").or_else(|| code.split_once("G04P"))?;
    let (time, rest) = time.split_at(
        time.len()
            - time
                .trim_start_matches(|digit: char| digit.is_ascii_digit())
                .len(),
    );
    time.parse().ok().filter(|_| !rest.starts_with('.'))
}

/// `O1234` or `:1234` alone on a line.
fn is_program_number(code: &[u8]) -> bool {
    match code {
        [b'O' | b':', number @ ..] => !number.is_empty() && number.iter().all(u8::is_ascii_digit),
        _ => false,
    }
}

/// Whether a word stands in the text and does not go on with a digit.
fn contains(text: &[u8], word: &str) -> bool {
    text.windows(word.len()).enumerate().any(|(at, window)| {
        window == word.as_bytes()
            && !(word.ends_with(|letter: char| letter.is_ascii_digit())
                && text.get(at + word.len()).is_some_and(u8::is_ascii_digit))
    })
}
