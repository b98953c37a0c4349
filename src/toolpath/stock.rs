//! The stock as posts write it into comments. It is a box, in the coordinates of the first work system.
//!
//! ```text
//!   (stockMin:0.00mm, 0.00mm, -12.00mm) (stockMax:80.00mm, 60.00mm, 0.00mm)        two corners: Carbide Create
//!   (STOCK/BLOCK, 80.0, 60.0, 12.0, 0.0, 0.0, 12.0)        size, and how far the program's zero is from the least corner: CutViewer
//!   (Workpiece: 0. <= X <= 80. | 0. <= Y <= 60. | -12. <= Z <= 0.)                 ranges: posts of Fusion 360
//!   ( Material Size) ( X= 80.0, Y= 60.0, Z= 12.0)                                  size: Vectric
//!   ( Z Origin for Material = Material Surface) ( XY Origin for Material = Bottom Left Corner)       and where it lies
//! ```
//! A program may say it several times, in several ways, and all of them have to agree. What is not enough, or contradicts, is told and
//! not taken. The bounds of the path, which posts write, too, are none of a stock.

use super::comment::{comments, mm_per_unit};

/// How far two statements of one stock may differ: posts write two or three decimals, and add them up. Units: mm.
const DIFFERENCE_MAX: f64 = 0.03;

/// What the comments of a program say of its stock.
#[derive(Clone, PartialEq, Debug)]
pub enum StockComment {
    /// Nothing.
    Nothing,
    /// A box from its least to its greatest corner. Units: mm.
    Box {
        /// Least and greatest corner.
        corners: [[f64; 3]; 2],
        /// The line that says so first.
        line: u64,
    },
    /// Something, but not what is needed.
    Unclear {
        /// The line in question.
        line: u64,
        /// What is wrong with it: a sentence that begins with "this comment".
        why: String,
    },
}

impl StockComment {
    /// Reads the comments of a program, which count in its unit where they do not say another one.
    pub fn of(program: &[u8]) -> Self {
        let mut statements = Statements::default();
        let mut unit = None;
        for (line, comment) in comments(program) {
            let text = comment.trim_start_matches(|letter: char| !letter.is_alphanumeric());
            let is_about = statements.is_in_list || text.starts_with("xy origin");
            if is_about || SUBJECTS.iter().any(|subject| text.starts_with(subject)) {
                let unit = *unit.get_or_insert_with(|| mm_per_unit(program));
                if let Err(why) = statements.take(line, text, unit) {
                    statements.wrong.get_or_insert((line, why));
                }
            }
        }
        statements.conclude()
    }
}

/// What a comment about a stock begins with.
const SUBJECTS: [&str; 5] = ["stock", "workpiece", "material", "blank", "z origin"];

/// A statement and its line. Units: mm.
type On<T> = Option<(u64, T)>;

/// All that is said of the stock.
#[derive(Debug, Default)]
struct Statements {
    boxes: Vec<(u64, [[f64; 3]; 2])>,
    /// The least and the greatest corner.
    corners: [On<[f64; 3]>; 2],
    size: On<[f64; 3]>,
    /// Where the zero of a stock of which the size is said lies in it, along each axis from 0, its least corner, to 1.
    zero: [Option<f64>; 3],
    /// Whether the last comment was a heading, below which coordinates stand.
    is_in_list: bool,
    /// The first statement that is wrong.
    wrong: On<String>,
}

impl Statements {
    /// Takes what a comment says; what says nothing of a stock's size or place is let pass.
    fn take(&mut self, line: u64, text: &str, unit: f64) -> Result<(), String> {
        let is_in_list = std::mem::take(&mut self.is_in_list);
        if let Some(form) = text.strip_prefix("stock").map(str::trim_start)
            && let Some(form) = form.strip_prefix('/')
        {
            return self.take_form(line, form.trim_start(), unit);
        }
        if let Some(place) = text.strip_prefix("z origin") {
            self.zero[2] = self.zero[2].or(height_of_zero(place));
            return Ok(());
        }
        if let Some(place) = text.strip_prefix("xy origin") {
            return self.take_zero(place, unit);
        }
        let subject = SUBJECTS
            .iter()
            .find_map(|subject| text.strip_prefix(subject));
        let rest = match subject {
            Some(rest) => rest,
            None if is_in_list => text,
            None => return Ok(()),
        };
        if rest.contains("<=") {
            let corners = ranges(rest, unit).ok_or("has ranges that are not of x, y and z")?;
            self.boxes.push((line, corners));
            return Ok(());
        }
        let place = |names: [&str; 2]| names.into_iter().filter_map(|name| rest.find(name)).min();
        match [place(["min", "lower"]), place(["max", "upper"])] {
            [Some(least), Some(greatest)] if least < greatest => {
                let (least, greatest) = rest.split_at(greatest);
                if let (Some(least), Some(greatest)) =
                    (coordinates(least, unit), coordinates(greatest, unit))
                {
                    self.boxes.push((line, [least, greatest]));
                }
                return Ok(());
            }
            [Some(_), None] => return self.take_corner(line, 0, coordinates(rest, unit)),
            [None, Some(_)] => return self.take_corner(line, 1, coordinates(rest, unit)),
            _ => {}
        }
        let is_size = ["size", "dimension"].iter().any(|word| rest.contains(word));
        let is_named = rest.trim_start().starts_with([':', '=']);
        if is_size && !rest.contains(|digit: char| digit.is_ascii_digit()) {
            self.is_in_list = true;
        } else if is_size || is_named || is_in_list {
            if numbers(rest, unit).len() == 6 {
                return Err("has six numbers and does not say which they are".into());
            }
            if let Some(size) = coordinates(rest, unit) {
                return agree(&mut self.size, line, size);
            }
        }
        Ok(())
    }

    /// `BLOCK, 80.0, 60.0, 12.0, 0.0, 0.0, 12.0`.
    fn take_form(&mut self, line: u64, form: &str, unit: f64) -> Result<(), String> {
        let (name, sizes) = form.split_once(',').unwrap_or((form, ""));
        if name.trim() != "block" {
            return Err(format!(
                "has a STOCK/{}: only a BLOCK is read",
                name.trim().to_uppercase()
            ));
        }
        let numbers: Vec<f64> = numbers(sizes, unit)
            .iter()
            .map(|number| number.mm)
            .collect();
        let [x, y, z, zero_x, zero_y, zero_z] = numbers[..] else {
            return Err(format!(
                "has {} numbers, not the six of a STOCK/BLOCK",
                numbers.len()
            ));
        };
        let corners = [
            [-zero_x, -zero_y, -zero_z],
            [x - zero_x, y - zero_y, z - zero_z],
        ];
        self.boxes.push((line, corners));
        Ok(())
    }

    fn take_corner(&mut self, line: u64, end: usize, at: Option<[f64; 3]>) -> Result<(), String> {
        let Some(at) = at else {
            return Ok(());
        };
        self.is_in_list = true;
        agree(&mut self.corners[end], line, at)
    }

    /// `for Material = Bottom Left Corner`, or `Position = X:0.0, Y:0.0`.
    fn take_zero(&mut self, place: &str, unit: f64) -> Result<(), String> {
        if numbers(place, unit).iter().any(|number| number.mm != 0.0) {
            return Err(
                "moves the zero away from where it was said to be, which is not read".into(),
            );
        }
        if ["center", "centre", "middle"]
            .iter()
            .any(|word| place.contains(word))
        {
            self.zero[0] = self.zero[0].or(Some(0.5));
            self.zero[1] = self.zero[1].or(Some(0.5));
        }
        for (axis, end, names) in [
            (0, 0.0, &["left"][..]),
            (0, 1.0, &["right"]),
            (1, 0.0, &["bottom", "lower", "front"]),
            (1, 1.0, &["top", "upper", "back"]),
        ] {
            if names.iter().any(|name| place.contains(name)) {
                self.zero[axis] = self.zero[axis].or(Some(end));
            }
        }
        Ok(())
    }

    /// The stock, when all statements agree on one.
    fn conclude(mut self) -> StockComment {
        let unclear = |line: u64, why: &str| StockComment::Unclear {
            line,
            why: format!("this comment {why}"),
        };
        if let Some((line, why)) = &self.wrong {
            return unclear(*line, why);
        }
        match self.corners {
            [Some((line, least)), Some((other, greatest))] => {
                self.boxes.push((line.min(other), [least, greatest]));
            }
            [Some((line, _)), None] | [None, Some((line, _))] => {
                return unclear(
                    line,
                    "says one corner of the stock, and none says the other",
                );
            }
            [None, None] => {}
        }
        if let Some((line, size)) = self.size {
            match self.zero {
                [Some(x), Some(y), Some(z)] => {
                    let zero = [x, y, z];
                    let corner = |end: f64| [0, 1, 2].map(|axis| size[axis] * (end - zero[axis]));
                    self.boxes.push((line, [corner(0.0), corner(1.0)]));
                }
                _ if self.boxes.is_empty() => {
                    return unclear(
                        line,
                        "says how large the stock is, and none says where it lies",
                    );
                }
                // It lies where another one says, and is as large.
                _ => {
                    let [least, _] = self.boxes[0].1;
                    let greatest = [0, 1, 2].map(|axis| least[axis] + size[axis]);
                    self.boxes.push((line, [least, greatest]));
                }
            }
        }
        self.boxes.sort_by_key(|(line, _)| *line);
        let Some(&(line, corners)) = self.boxes.first() else {
            return StockComment::Nothing;
        };
        let [least, greatest] = corners;
        if (0..3).any(|axis| least[axis] >= greatest[axis]) {
            return unclear(
                line,
                "says a stock whose least corner is not below its greatest",
            );
        }
        let differs = |(_, [least, greatest]): &&(u64, [[f64; 3]; 2])| {
            !is_near(*least, corners[0]) || !is_near(*greatest, corners[1])
        };
        if let Some((other, _)) = self.boxes.iter().find(differs) {
            return unclear(
                *other,
                &format!("says another stock than that on line {line}"),
            );
        }
        StockComment::Box { corners, line }
    }
}

/// Notes a statement, which has to agree with those before it.
fn agree(before: &mut On<[f64; 3]>, line: u64, now: [f64; 3]) -> Result<(), String> {
    match before {
        Some((other, said)) if !is_near(*said, now) => {
            Err(format!("says another stock than that on line {other}"))
        }
        Some(_) => Ok(()),
        None => {
            *before = Some((line, now));
            Ok(())
        }
    }
}

fn is_near(one: [f64; 3], other: [f64; 3]) -> bool {
    (0..3).all(|axis| (one[axis] - other[axis]).abs() <= DIFFERENCE_MAX)
}

/// Where the zero is along z, from 0, the lower end of the material, to 1: `for Material = Material Surface`, or `Table Surface`.
fn height_of_zero(place: &str) -> Option<f64> {
    let (_, place) = place.split_once(['=', ':'])?;
    let has = |names: &[&str]| names.iter().any(|name| place.contains(name));
    match [
        has(&["table", "bed", "bottom"]),
        has(&["material", "part", "stock", "top"]),
    ] {
        [true, false] => Some(0.0),
        [false, true] => Some(1.0),
        _ => None,
    }
}

/// `0. <= X <= 80. | 0. <= Y <= 60. | -12. <= Z <= 0.`
fn ranges(text: &str, unit: f64) -> Option<[[f64; 3]; 2]> {
    let mut corners = [[None; 3]; 2];
    for range in text.split('|') {
        let parts: Vec<&str> = range.split("<=").collect();
        let [least, axis, greatest] = parts[..] else {
            return None;
        };
        let axis = ["x", "y", "z"]
            .iter()
            .position(|name| axis.trim() == *name)?;
        for (end, text) in [least, greatest].into_iter().enumerate() {
            let [number] = numbers(text, unit)[..] else {
                return None;
            };
            if corners[end][axis].replace(number.mm).is_some() {
                return None;
            }
        }
    }
    let [least, greatest] = corners.map(|[x, y, z]| Some([x?, y?, z?]));
    Some([least?, greatest?])
}

/// Three numbers in their order, or by their names x, y and z.
fn coordinates(text: &str, unit: f64) -> Option<[f64; 3]> {
    let numbers = numbers(text, unit);
    let [a, b, c] = numbers[..] else {
        return None;
    };
    if [a, b, c].iter().all(|number| number.name.is_none()) {
        return Some([a.mm, b.mm, c.mm]);
    }
    let named = |name: char| numbers.iter().find(|number| number.name == Some(name));
    Some([named('x')?.mm, named('y')?.mm, named('z')?.mm])
}

/// A number in a text.
#[derive(Clone, Copy, Debug)]
struct Number {
    /// `x`, `y` or `z`, when it stands before.
    name: Option<char>,
    mm: f64,
}

/// The numbers of a text, each with the unit behind it, or in the program's.
fn numbers(text: &str, unit: f64) -> Vec<Number> {
    let mut found = Vec::new();
    let mut name = None;
    let mut rest = text;
    let mut last = ' ';
    while let Some(letter) = rest.chars().next() {
        let digits = number_at(rest);
        if digits > 0 && !(last.is_alphanumeric() && rest.starts_with(['+', '-'])) {
            let (digits, behind) = rest.split_at(digits);
            let (own, behind) = unit_at(behind);
            found.extend(digits.parse().ok().map(|value: f64| Number {
                name: name.take(),
                mm: value * own.unwrap_or(unit),
            }));
            (rest, last) = (behind, '0');
            continue;
        }
        if letter.is_alphabetic() {
            let word = rest.trim_start_matches(char::is_alphabetic);
            let length = rest.len() - word.len();
            if matches!(&rest[..length], "x" | "y" | "z") && !last.is_alphanumeric() {
                name = Some(letter);
                (rest, last) = (word, ' ');
            } else if &rest[..length] == "x" {
                // 80x60x12
                (rest, last) = (word, ' ');
            } else {
                // A word, and the digits in it, as in 6061-T6.
                rest =
                    word.trim_start_matches(|digit: char| digit.is_alphanumeric() || digit == '.');
                last = 'a';
            }
            continue;
        }
        (rest, last) = (&rest[letter.len_utf8()..], letter);
    }
    found
}

/// How long the number is that a text begins with; 0 when it begins with none.
fn number_at(text: &str) -> usize {
    let bytes = text.as_bytes();
    let sign = usize::from(text.starts_with(['+', '-']));
    let digits = |from: usize| {
        let rest = &bytes[from..];
        rest.iter().take_while(|byte| byte.is_ascii_digit()).count()
    };
    let whole = digits(sign);
    let mut end = sign + whole;
    let mut fraction = 0;
    if bytes.get(end) == Some(&b'.') {
        fraction = digits(end + 1);
        end += 1 + fraction;
    }
    if whole + fraction == 0 {
        return 0;
    }
    if bytes.get(end) == Some(&b'e') {
        let sign = usize::from(matches!(bytes.get(end + 1), Some(b'+' | b'-')));
        match digits((end + 1 + sign).min(bytes.len())) {
            0 => {}
            exponent => end += 1 + sign + exponent,
        }
    }
    end
}

/// Millimetres in the unit that a text begins with, if it does, and what follows.
fn unit_at(text: &str) -> (Option<f64>, &str) {
    let trimmed = text.trim_start();
    for (name, mm) in [("mm", 1.0), ("inch", 25.4), ("in", 25.4), ("\"", 25.4)] {
        if let Some(behind) = trimmed.strip_prefix(name)
            && !behind.starts_with(char::is_alphanumeric)
        {
            return (Some(mm), behind);
        }
    }
    (None, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOX: [[f64; 3]; 2] = [[0.0, 0.0, -12.0], [80.0, 60.0, 0.0]];

    #[track_caller]
    fn check(program: &str, corners: [[f64; 3]; 2], on: u64) {
        let StockComment::Box {
            corners: found,
            line,
        } = StockComment::of(program.as_bytes())
        else {
            panic!("{program}: {:?}", StockComment::of(program.as_bytes()));
        };
        let near = (0..2).all(|end| is_near(found[end], corners[end]));
        assert!(near && line == on, "{program}: {found:?} on {line}");
    }

    #[track_caller]
    fn check_unclear(program: &str, on: u64, words: &str) {
        match StockComment::of(program.as_bytes()) {
            StockComment::Unclear { line, why } => {
                assert!(line == on && why.contains(words), "{program}: {line} {why}");
            }
            other => panic!("{program}: {other:?}"),
        }
    }

    /// Every post's way to say it, in millimetres and inches, with every end of line.
    #[test]
    fn posts_say_it_in_several_ways() {
        check(
            "(stockMin:0.00mm, 0.00mm, -12.00mm)\r\n(stockMax:80.00mm, 60.00mm, 0.00mm)\r\n",
            BOX,
            1,
        );
        check(
            "G21\n(STOCK/BLOCK, 80.0, 60.0, 12.0, 0.0, 0.0, 12.0)\n",
            BOX,
            2,
        );
        check(
            "%\rO1\r(STOCK/BLOCK,80,60,12,40,30,0)\r",
            [[-40.0, -30.0, 0.0], [40.0, 30.0, 12.0]],
            3,
        );
        check(
            "(Workpiece:   0.000 <= X <= 80.000 | 0.000 <= Y <= 60.000 | -12.000 <= Z <= 0.000)\n",
            BOX,
            1,
        );
        check(
            "; Stock: -12. <= Z <= 0. | 0 <= X <= 80 | 0 <= Y <= 60\n",
            BOX,
            1,
        );
        check(
            "( Material Size)\n( X= 80.000, Y= 60.000, Z= 12.000)\n( Z Origin for Material  = Material Surface)\n( XY Origin for Material = Bottom Left Corner)\n(      XY Origin Position  = X:0.0, Y:0.0)\n",
            BOX,
            2,
        );
        check(
            "( Material Size: X= 80.000, Y= 60.000, Z= 12.000)\n( Z Origin for Material  = Table Surface)\n( XY Origin for Material = Center)\n",
            [[-40.0, -30.0, 0.0], [40.0, 30.0, 12.0]],
            1,
        );
        check(
            "; !Workpiece dimensions:!\n; !min:     X: 0.; Y: 0.; Z: -12.!\n; !max:     X: 80.; Y: 60.; Z: 0.!\n",
            BOX,
            2,
        );
        check("(STOCK MIN X0. Y0. Z-12. MAX X80. Y60. Z0.)\n", BOX, 1);
        check(
            "(stock lower: Z-12 Y0 X0)\n(stock upper: Z0 Y60 X80)\n",
            BOX,
            1,
        );
        let inches = [[0.0, 0.0, -25.4], [50.8, 50.8, 0.0]];
        check("(STOCK/BLOCK, 2, 2, 1, 0, 0, 1)\nG20\n", inches, 1);
        check(
            "(stockMin:0.000in, 0.000in, -1.000in)\n(stockMax:2.000in, 2.000in, 0.000in)\nG21\n",
            inches,
            1,
        );
    }

    #[test]
    fn several_statements_have_to_agree() {
        let both = "(stockMin:0.00mm, 0.00mm, -12.00mm)\n(stockMax:80.00mm, 60.00mm, 0.00mm)\n(STOCK/BLOCK,80.00, 60.00, 12.00,0.00, 0.00, 12.00)\n";
        check(both, BOX, 1);
        check_unclear(
            &both.replace(", 12.00)", ", 11.90)"),
            3,
            "than that on line 1",
        );
        check_unclear(
            &format!("{both}(stockMin:1.00mm, 0.00mm, -12.00mm)\n"),
            4,
            "line 1",
        );
        // A size beside a box is that of the box.
        let sized = "(STOCK/BLOCK,80,60,12,0,0,12)\n(Stock : XxYxZ : 80x60x1.2e+1)\n";
        check(sized, BOX, 1);
        check_unclear(&sized.replace("x60x", "x70x"), 2, "line 1");
    }

    #[test]
    fn what_is_not_enough_is_not_guessed() {
        check_unclear(
            "( Material Size)\n( X= 80.000, Y= 60.000, Z= 12.000)\n",
            2,
            "none says where it lies",
        );
        check_unclear(
            "(Stock : XxYxZ : 1.0e+2x60x12)\n",
            1,
            "none says where it lies",
        );
        check_unclear(
            "( Material Size: X= 8, Y= 6, Z= 1)\n( Z Origin for Material = Material Surface)\n",
            1,
            "where it lies",
        );
        check_unclear("(stockMin:0.00mm, 0.00mm, -12.00mm)\n", 1, "one corner");
        check_unclear("(STOCK/CYLINDER, 20, 40, 0, 0, 0)\n", 1, "only a BLOCK");
        check_unclear("(STOCK/BLOCK, 20, 40)\n", 1, "2 numbers");
        check_unclear("(STOCK/BLOCK, 20, 40, 0, 0, 0, 0)\n", 1, "not below");
        check_unclear("(Stock: 0 0 -12 80 60 0)\n", 1, "six numbers");
        check_unclear(
            "(Workpiece: 0 <= X <= 80 | 0 <= X <= 60 | -12 <= Z <= 0)\n",
            1,
            "ranges",
        );
        let moved = "( Material Size: X= 8, Y= 6, Z= 1)\n( Z Origin for Material = Material Surface)\n( XY Origin for Material = Center)\n( XY Origin Position = X:1.0, Y:0.0)\n";
        check_unclear(moved, 4, "moves the zero");
    }

    /// Comments that name the material, the path's bounds or what is left on walls say nothing of a stock's size.
    #[test]
    fn other_comments_are_let_pass() {
        for program in [
            "G21\nG1 X5\n",
            "(MATERIAL - ALUMINUM MM - 2024)\n",
            "(Material: 6061-T6)\n",
            "(STOCK TO LEAVE = 0.5)\n(Stock allowance: 0.2 max 0.3)\n",
            "(Tool travel: 0. <= X <= 80. | 0. <= Y <= 60. | -12. <= Z <= 0.)\n",
            "( Min Program Extents: X= 0.0, Y= 0.0, Z= -1.0)\n( Home Position: X =0.0 Y =0.0 Z =5.0)\n",
            "; X: Min=0 Max=80 Size=80\n",
            "( Z Origin for Material = Material Surface)\n",
            "( Material Size)\n(Toolpaths used in this file:)\n(X= 1, Y= 2, Z= 3)\n",
        ] {
            assert_eq!(
                StockComment::of(program.as_bytes()),
                StockComment::Nothing,
                "{program}"
            );
        }
    }
}
