//! Numbers, parameters, expressions and functions, read and worked out in one go.
//!
//! Spaces have no meaning anywhere, letters may be of either case. Operators bind in this order, from the tightest: `**`; `*`,
//! `/`, `MOD`; `+`, `-`; `EQ`, `NE`, `GT`, `GE`, `LT`, `LE`; `AND`, `OR`, `XOR`; those that bind alike from left to right.
//! Angles are in degrees.

/// What is wrong and where: an offset in bytes from the start of the line.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Unreadable {
    pub(super) offset: usize,
    pub(super) what: String,
}

/// Where parameters have their values.
pub(super) trait Values {
    /// # Errors
    /// A sentence when it has no value.
    fn number(&self, number: u16) -> Result<f64, String>;
    /// The name is in lower case without spaces.
    ///
    /// # Errors
    /// A sentence when it has no value.
    fn named(&self, name: &str) -> Result<f64, String>;
}

/// Two values nearer to each other than this are equal for `EQ`, `NE` and for whole numbers.
const EQUAL: f64 = 0.0001;

/// How deep brackets may stand in each other.
const DEPTH_MAX: usize = 64;

/// What a `#` names.
#[derive(Clone, PartialEq, Debug)]
pub(super) enum Name {
    Number(u16),
    Named(String),
}

/// Reads along one line.
pub(super) struct Reader<'line> {
    line: &'line [u8],
    pub(super) at: usize,
    depth: usize,
}

impl<'line> Reader<'line> {
    pub(super) fn new(line: &'line [u8]) -> Self {
        Self {
            line,
            at: 0,
            depth: 0,
        }
    }

    /// The next byte that is no space, in upper case; 0 at the end.
    pub(super) fn peek(&mut self) -> u8 {
        while let Some(byte) = self.line.get(self.at) {
            // NULs are blank tape.
            if !matches!(byte, b' ' | b'\t' | 0 | 0x0b | 0x0c) {
                return byte.to_ascii_uppercase();
            }
            self.at += 1;
        }
        0
    }

    /// Takes the next byte if it is this one.
    pub(super) fn take(&mut self, byte: u8) -> bool {
        let there = self.peek() == byte;
        self.at += usize::from(there);
        there
    }

    /// Takes a word of letters if it stands here.
    pub(super) fn take_word(&mut self, word: &str) -> bool {
        let before = self.at;
        for letter in word.bytes() {
            if !self.take(letter) {
                self.at = before;
                return false;
            }
        }
        true
    }

    pub(super) fn line(&self) -> &'line [u8] {
        self.line
    }

    pub(super) fn fail<T>(&self, what: impl Into<String>) -> Result<T, Unreadable> {
        self.fail_at(self.at, what)
    }

    #[expect(clippy::unused_self, reason = "the pair of fail")]
    pub(super) fn fail_at<T>(
        &self,
        offset: usize,
        what: impl Into<String>,
    ) -> Result<T, Unreadable> {
        Err(Unreadable {
            offset,
            what: what.into(),
        })
    }

    /// A number as it is written, without a parameter: its value and whether it has a decimal point.
    pub(super) fn literal(&mut self) -> Result<(f64, bool), Unreadable> {
        let negative = self.take(b'-');
        if !negative {
            self.take(b'+');
        }
        let (mut whole, mut digits, mut decimals) = (0_u64, 0_u32, 0_usize);
        let (mut point, mut any) = (false, false);
        loop {
            match self.peek() {
                digit @ b'0'..=b'9' => {
                    any = true;
                    if digits < DIGITS_MAX && decimals + 1 < POWERS.len() {
                        whole = whole * 10 + u64::from(digit - b'0');
                        digits += u32::from(whole > 0);
                        decimals += usize::from(point);
                    } else if !point {
                        return self.fail(format!("a number has more than {DIGITS_MAX} digits"));
                    }
                }
                b'.' if !point => point = true,
                _ => break,
            }
            self.at += 1;
        }
        if !any {
            return self.fail("a number was expected here");
        }
        // Both are exact below 2^53, so their quotient is the nearest double to the first digits.
        #[expect(clippy::cast_precision_loss, reason = "at most 15 digits")]
        let value = whole as f64 / POWERS[decimals];
        Ok((if negative { -value } else { value }, point))
    }

    /// A value: a number, a parameter, a bracket or a function, with any sign; and whether it is a number with a decimal point.
    pub(super) fn value(&mut self, values: &impl Values) -> Result<(f64, bool), Unreadable> {
        match self.peek() {
            b'0'..=b'9' | b'.' => self.literal(),
            sign @ (b'-' | b'+') => {
                let before = self.at;
                self.at += 1;
                if matches!(self.peek(), b'0'..=b'9' | b'.') {
                    self.at = before;
                    return self.literal();
                }
                if matches!(self.peek(), b'-' | b'+') {
                    return self.fail("a number was expected here");
                }
                let (value, _) = self.value(values)?;
                Ok((if sign == b'-' { -value } else { value }, true))
            }
            b'[' => Ok((self.bracket(values)?, true)),
            b'#' => {
                let start = self.at;
                self.at += 1;
                let name = self.parameter_name(values)?;
                Ok((self.parameter(&name, start, values)?, true))
            }
            b'A'..=b'Z' => Ok((self.function(values)?, true)),
            _ => self.fail("a number was expected here"),
        }
    }

    /// The name after a `#`.
    pub(super) fn parameter_name(&mut self, values: &impl Values) -> Result<Name, Unreadable> {
        if self.take(b'<') {
            return Ok(Name::Named(self.name()?));
        }
        let start = self.at;
        let (number, _) = match self.peek() {
            b'0'..=b'9' | b'#' | b'[' => self.value(values)?,
            _ => return self.fail("a parameter has a number or a <name>"),
        };
        let whole = number.round();
        if (number - whole).abs() > EQUAL
            || !(1.0..=f64::from(super::parameters::NUMBER_MAX)).contains(&whole)
        {
            return self.fail_at(start, format!("there is no parameter #{number}"));
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "whole and in range"
        )]
        Ok(Name::Number(whole as u16))
    }

    /// A name up to its `>`, in lower case without spaces.
    pub(super) fn name(&mut self) -> Result<String, Unreadable> {
        let start = self.at;
        let mut name = String::new();
        loop {
            match self.peek() {
                0 => return self.fail_at(start, "a name begins with < and does not end with >"),
                b'>' => break,
                byte => name.push(char::from(byte.to_ascii_lowercase())),
            }
            self.at += 1;
        }
        self.at += 1;
        if name.is_empty() {
            return self.fail_at(start, "a name is empty");
        }
        Ok(name)
    }

    fn parameter(
        &self,
        name: &Name,
        start: usize,
        values: &impl Values,
    ) -> Result<f64, Unreadable> {
        let found = match name {
            Name::Number(number) => values.number(*number),
            Name::Named(name) => values.named(name),
        };
        found.or_else(|what| self.fail_at(start, what))
    }

    /// A bracket with an expression.
    pub(super) fn bracket(&mut self, values: &impl Values) -> Result<f64, Unreadable> {
        let start = self.at;
        if !self.take(b'[') {
            return self.fail("a [ was expected here");
        }
        self.depth += 1;
        if self.depth > DEPTH_MAX {
            return self.fail(format!("more than {DEPTH_MAX} brackets in each other"));
        }
        let value = self.operation(values, 1)?;
        self.depth -= 1;
        if !self.take(b']') {
            return if self.peek() == 0 {
                self.fail_at(start, "a [ has no ]")
            } else {
                self.fail("an operator or ] was expected here")
            };
        }
        if value.is_finite() {
            Ok(value)
        } else {
            self.fail_at(start, "the result is no number")
        }
    }

    /// Values joined by operators that bind at least so tightly.
    fn operation(&mut self, values: &impl Values, tightness: u8) -> Result<f64, Unreadable> {
        let (mut left, _) = self.value(values)?;
        loop {
            let before = self.at;
            let Some(operator) = self.operator() else {
                return Ok(left);
            };
            if operator.tightness() < tightness {
                self.at = before;
                return Ok(left);
            }
            let right = self.operation(values, operator.tightness() + 1)?;
            left = match operator.of(left, right) {
                Ok(value) => value,
                Err(what) => return self.fail_at(before, what),
            };
        }
    }

    fn operator(&mut self) -> Option<Operator> {
        use Operator as O;
        let words = [
            ("**", O::Power),
            ("*", O::Times),
            ("/", O::Over),
            ("MOD", O::Modulo),
            ("+", O::Plus),
            ("-", O::Minus),
            ("EQ", O::Equal),
            ("NE", O::Unequal),
            ("GT", O::Greater),
            ("GE", O::GreaterEqual),
            ("LT", O::Less),
            ("LE", O::LessEqual),
            ("AND", O::And),
            ("OR", O::Or),
            ("XOR", O::Xor),
        ];
        let found = words.into_iter().find(|(word, _)| self.take_word(word));
        found.map(|(_, operator)| operator)
    }

    fn function(&mut self, values: &impl Values) -> Result<f64, Unreadable> {
        type Function = fn(f64) -> f64;
        let functions: [(&str, Function); 13] = [
            ("ABS", f64::abs),
            ("ACOS", |value| value.acos().to_degrees()),
            ("ASIN", |value| value.asin().to_degrees()),
            ("COS", |value| value.to_radians().cos()),
            ("EXP", f64::exp),
            ("FIX", f64::floor),
            ("FUP", f64::ceil),
            ("LN", f64::ln),
            ("ROUND", f64::round),
            ("SIN", |value| value.to_radians().sin()),
            ("SQRT", f64::sqrt),
            ("TAN", |value| value.to_radians().tan()),
            ("INT", f64::trunc),
        ];
        let start = self.at;
        if self.take_word("ATAN") {
            let above = self.bracket(values)?;
            if !self.take(b'/') {
                return self.fail("ATAN has two values: ATAN[y]/[x]");
            }
            return Ok(above.atan2(self.bracket(values)?).to_degrees());
        }
        if self.take_word("EXISTS") {
            let named = self.take(b'[') && self.take(b'#') && self.take(b'<');
            if !named {
                return self.fail("EXISTS asks for a named parameter: EXISTS[#<name>]");
            }
            let name = self.name()?;
            if !self.take(b']') {
                return self.fail("a ] was expected here");
            }
            return Ok(f64::from(u8::from(values.named(&name).is_ok())));
        }
        let found = functions.into_iter().find(|(word, _)| self.take_word(word));
        let Some((word, function)) = found else {
            return self.fail("a number was expected here");
        };
        let value = self.bracket(values)?;
        let result = function(value);
        if result.is_finite() {
            Ok(result)
        } else {
            self.fail_at(start, format!("{word}[{value}] is no number"))
        }
    }
}

/// As many digits as a double holds; those after them change nothing.
const DIGITS_MAX: u32 = 15;

const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
    1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
];

#[derive(Clone, Copy)]
enum Operator {
    Power,
    Times,
    Over,
    Modulo,
    Plus,
    Minus,
    Equal,
    Unequal,
    Greater,
    GreaterEqual,
    Less,
    LessEqual,
    And,
    Or,
    Xor,
}

impl Operator {
    fn tightness(self) -> u8 {
        match self {
            Self::Power => 5,
            Self::Times | Self::Over | Self::Modulo => 4,
            Self::Plus | Self::Minus => 3,
            Self::Equal
            | Self::Unequal
            | Self::Greater
            | Self::GreaterEqual
            | Self::Less
            | Self::LessEqual => 2,
            Self::And | Self::Or | Self::Xor => 1,
        }
    }

    fn of(self, left: f64, right: f64) -> Result<f64, &'static str> {
        let truth = |held: bool| if held { 1.0 } else { 0.0 };
        let (is_left, is_right) = (left != 0.0, right != 0.0);
        Ok(match self {
            Self::Power if left < 0.0 && right.fract() != 0.0 => {
                return Err("a negative number has no broken power");
            }
            Self::Power => left.powf(right),
            Self::Times => left * right,
            Self::Over | Self::Modulo if right == 0.0 => return Err("a division by zero"),
            Self::Over => left / right,
            Self::Modulo => {
                let rest = left % right;
                if rest < 0.0 { rest + right.abs() } else { rest }
            }
            Self::Plus => left + right,
            Self::Minus => left - right,
            Self::Equal => truth((left - right).abs() < EQUAL),
            Self::Unequal => truth((left - right).abs() >= EQUAL),
            Self::Greater => truth(left > right),
            Self::GreaterEqual => truth(left >= right),
            Self::Less => truth(left < right),
            Self::LessEqual => truth(left <= right),
            Self::And => truth(is_left && is_right),
            Self::Or => truth(is_left || is_right),
            Self::Xor => truth(is_left != is_right),
        })
    }
}
