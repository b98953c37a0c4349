//! Random programs from a grammar of the language, the same for the same seed.

use std::f64::consts::TAU;
use std::fmt::Write;

use crate::random::Random;

/// Writes programs.
pub(crate) struct Writer {
    random: Random,
    text: String,
    label: u32,
}

/// A program of some paragraphs.
pub(crate) fn program(seed: u64) -> String {
    let mut writer = Writer {
        random: Random::new(seed),
        text: String::new(),
        label: 100,
    };
    writer.line("G17 G21 G90 G40 G49 G80 G94 F100 S500 M3");
    writer.line("G0 X1 Y2 Z10");
    for _ in 0..writer.below(9) + 4 {
        writer.paragraph();
    }
    writer.line("M2");
    writer.text
}

impl Writer {
    fn below(&mut self, count: u64) -> u64 {
        self.random.below(count)
    }

    fn chance(&mut self, one_in: u64) -> bool {
        self.below(one_in) == 0
    }

    fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.below(from.len() as u64) as usize]
    }

    /// A number of at most three decimals.
    fn value(&mut self, low: i64, high: i64) -> f64 {
        let thousandths = (high - low) as u64 * 1000 + 1;
        let value = low as f64 + self.below(thousandths) as f64 / 1000.0;
        let places = [1.0, 10.0, 1000.0];
        let place = self.pick(&places);
        (value * place).round() / place
    }

    /// The same as it may be written.
    fn number(&mut self, value: f64) -> String {
        match self.below(12) {
            0 => format!("[{} + {value}]", 0),
            1 => format!("[{}*2]", value / 2.0),
            2 => format!("-[{}]", -value),
            3 => format!("{value:+.6}"),
            4 => format!("[[{value} - 3] + 3]"),
            5 => {
                let text = format!("{value:.3}");
                text.chars().map(|letter| format!(" {letter}")).collect()
            }
            _ => format!("{value}"),
        }
    }

    fn word(&mut self, letter: char, low: i64, high: i64) -> String {
        let value = self.value(low, high);
        let number = self.number(value);
        let letter = if self.chance(4) {
            letter.to_ascii_lowercase()
        } else {
            letter
        };
        format!("{letter}{number} ")
    }

    fn line(&mut self, text: &str) {
        let comment = match self.below(15) {
            0 => " (a comment)",
            1 => " ; the rest",
            _ => "",
        };
        writeln!(self.text, "{text}{comment}").unwrap();
    }

    /// Some of the words of a target, at least one.
    fn target(&mut self) -> String {
        let mut words: Vec<String> = Vec::new();
        for letter in ['X', 'Y', 'Z'] {
            if !self.chance(3) {
                words.push(self.word(letter, -20, 20));
            }
        }
        if words.is_empty() {
            words.push(self.word('X', -20, 20));
        }
        if self.chance(3) {
            words.reverse();
        }
        words.concat()
    }

    fn paragraph(&mut self) {
        match self.below(19) {
            0 | 1 => self.lines(),
            2 | 3 => self.arcs(),
            4 => self.arc_by_radius(),
            5 => self.arc_absolute(),
            6 => self.units(),
            7 | 8 => self.systems(),
            9 => self.tools(),
            10 | 11 => self.cycles(),
            12 => self.flow(),
            13 | 14 => self.contour(),
            15 => self.polar(),
            16 => self.machine(),
            17 => self.feeds(),
            _ => self.splines(),
        }
    }

    fn lines(&mut self) {
        for _ in 0..self.below(4) + 1 {
            let code = self.pick(&["G0 ", "G1 ", "g01", "G00 ", "G1 F50 ", "G91 G1 ", "G90 G0 "]);
            let target = self.target();
            self.line(&format!("{code}{target}"));
        }
        self.line("G90");
        if self.chance(4) {
            let seconds = self.value(0, 3);
            self.line(&format!("G4 P{seconds}"));
        }
    }

    /// Arcs by their centres, relative, in every plane.
    fn arcs(&mut self) {
        let (plane, axes, centre) = self.pick(&[
            ("G17", ['X', 'Y', 'Z'], ['I', 'J']),
            ("G18", ['Z', 'X', 'Y'], ['K', 'I']),
            ("G19", ['Y', 'Z', 'X'], ['J', 'K']),
        ]);
        self.line(plane);
        for _ in 0..self.below(3) + 1 {
            let angle = self.value(0, 6);
            let turned = self.value(0, 6);
            let radius = self.value(1, 15);
            let code = self.pick(&["G2", "G3"]);
            let sense = if code == "G3" { 1.0 } else { -1.0 };
            let from = [radius * angle.cos(), radius * angle.sin()];
            let end = angle + sense * turned;
            let to = [radius * end.cos(), radius * end.sin()];
            let mut words = format!("G91 {code} ");
            if turned > 0.05 {
                write!(
                    words,
                    "{}{:.7} {}{:.7} ",
                    axes[0],
                    to[0] - from[0],
                    axes[1],
                    to[1] - from[1]
                )
                .unwrap();
            }
            write!(
                words,
                "{}{:.7} {}{:.7} ",
                centre[0], -from[0], centre[1], -from[1]
            )
            .unwrap();
            if self.chance(3) {
                words += &self.word(axes[2], -5, 5);
            }
            if self.chance(4) {
                write!(words, "P{}", self.below(3) + 1).unwrap();
            }
            self.line(&words);
        }
        self.line("G90 G17");
    }

    fn arc_by_radius(&mut self) {
        let chord = self.value(1, 10);
        let angle = self.value(0, 6);
        let radius = chord / 2.0 * (1.0 + self.value(0, 3) / 2.0 + 0.01);
        let radius = if self.chance(3) { -radius } else { radius };
        let code = self.pick(&["G2", "G3"]);
        let (x, y) = (chord * angle.cos(), chord * angle.sin());
        self.line(&format!("G91 {code} X{x:.6} Y{y:.6} R{radius:.6}"));
        self.line("G90");
    }

    fn arc_absolute(&mut self) {
        let (x, y) = (self.value(-5, 5), self.value(-5, 5));
        let radius = self.value(1, 9);
        let turn = self.value(1, 6) / 7.0 * TAU;
        let code = self.pick(&["G2", "G3"]);
        self.line(&format!("G0 X{} Y{y}", x + radius));
        let end = [x + radius * turn.cos(), y + radius * turn.sin()];
        self.line(&format!(
            "G90.1 {code} X{:.6} Y{:.6} I{x} J{y}",
            end[0], end[1]
        ));
        self.line("G91.1");
    }

    fn units(&mut self) {
        self.line("G20 F3");
        let target = self.target();
        self.line(&format!("G1 {target}"));
        if self.chance(2) {
            self.arcs();
        }
        self.line("G21 F100");
    }

    fn systems(&mut self) {
        for _ in 0..self.below(3) + 1 {
            let axes = self.target();
            let system = self.below(10);
            let text = match self.below(10) {
                0 | 1 => self
                    .pick(&["G54", "G55", "G56", "G59", "G59.1", "G59.3"])
                    .to_owned(),
                2 => format!("G10 L2 P{system} {axes}"),
                // With a shift in force the judge loses the place it stands at when a system is turned.
                3 => {
                    let degrees = self.value(-90, 90);
                    format!("G92.1\nG10 L2 P{system} R{degrees}\nG0 X3 Y4")
                }
                4 => format!("G10 L20 P{system} {axes}"),
                5 => format!("G92 {axes}"),
                6 => self.pick(&["G92.1", "G92.2", "G92.3"]).to_owned(),
                7 => format!("G52 {axes}"),
                8 => format!("G92.1\nG10 L2 P{system} R0\nG0 X4 Y3"),
                _ => "G54".to_owned(),
            };
            self.line(&text);
            let target = self.target();
            let code = self.pick(&["G0", "G1", "G91 G0"]);
            self.line(&format!("{code} {target}"));
            self.line("G90");
        }
        if self.chance(2) {
            self.arcs();
        }
    }

    fn tools(&mut self) {
        for _ in 0..self.below(3) + 1 {
            let tool = self.pick(&[1, 2, 3, 7]);
            let z = self.value(-9, 9);
            let text = match self.below(7) {
                0 | 1 => format!("T{tool} M6\nM3"),
                2 => format!("T{tool}"),
                3 => format!("G43 H{tool}"),
                4 => "G49".to_owned(),
                5 => format!("G43.1 Z{z}"),
                _ => format!("G43.2 H{tool}"),
            };
            self.line(&text);
            let target = self.target();
            self.line(&format!("G0 {target}"));
        }
        self.line("G49");
    }

    fn cycles(&mut self) {
        self.line("G0 Z12");
        let plane = self.chance(5);
        if plane {
            self.line("G18");
        }
        let (first, second, normal) = if plane {
            ('Z', 'X', 'Y')
        } else {
            ('X', 'Y', 'Z')
        };
        if self.chance(2) {
            let mode = self.pick(&["G98", "G99"]);
            self.line(mode);
        }
        let relative = self.chance(4);
        for _ in 0..self.below(3) + 1 {
            let code = self.pick(&["G81", "G82", "G83", "G73", "G85", "G86", "G89"]);
            let mut words = format!("{} {code} ", if relative { "G91" } else { "G90" });
            words += &self.word(first, -9, 9);
            words += &self.word(second, -9, 9);
            let (bottom, r) = if relative { (-6, -2) } else { (-5, 3) };
            write!(words, "{normal}{} R{} ", bottom, r).unwrap();
            match code {
                "G82" | "G89" | "G86" => write!(words, "P{}", self.value(0, 2)).unwrap(),
                "G83" | "G73" => write!(words, "Q{}", self.value(1, 4)).unwrap(),
                _ => {}
            }
            if self.chance(4) {
                write!(words, " L{}", self.below(3) + 1).unwrap();
            }
            self.line(&words);
            for _ in 0..self.below(3) {
                let x = self.word(first, -9, 9);
                let more = self.pick(&["", "G98 ", "G99 "]);
                let text = match code {
                    "G82" | "G89" | "G86" => format!("{more}{x}P1"),
                    "G83" | "G73" => format!("{more}{x}Q2"),
                    _ => format!("{more}{x}"),
                };
                self.line(&text);
            }
        }
        self.line("G90 G80 G17");
    }

    fn flow(&mut self) {
        self.label += 10;
        let label = self.label;
        let value = self.value(-5, 5);
        match self.below(6) {
            0 => {
                self.line(&format!("#1=0\no{label} while [#1 lt 4]\nG1 X[#1*2] Y[{value}+#1]\n#1=[#1+1]\no{label} endwhile"));
            }
            1 => {
                let count = self.below(4);
                self.line(&format!(
                    "o{label} repeat [{count}]\nG91 G1 X1.5 Y{value}\nG90\no{label} endrepeat"
                ));
            }
            2 => {
                self.line(&format!(
                    "#<a>={value}\no{label} if [#<a> gt 2]\nG1 X3\no{label} elseif [#<a> lt -2]\nG1 X4\no{label} else\nG1 X[abs[#<a>]]\no{label} endif"
                ));
            }
            3 => {
                self.line(&format!(
                    "o{label} sub\n#3=[#1+#2]\nG1 X#1 Y#2 Z#3\no{label} endsub [#3*2]\no{label} call [{value}] [2.5]\nG1 X#<_value>"
                ));
            }
            4 => {
                self.line(&format!(
                    "#5=0\no{label} do\nG1 X#5\n#5=[#5+1]\no{0} if [#5 eq 3]\no{label} break\no{0} endif\no{label} while [#5 lt 6]",
                    label + 1
                ));
            }
            _ => {
                self.line(&format!(
                    "#<_n>={value}\n#7=[round[#<_n>] mod 3] #8=[2**3 - atan[1]/[2]]\nG1 X#7 Y[#8/10] Z[sqrt[#7*#7+1] + sin[30] * fup[1.2]]\nG0 X[#5420+1] Y[#<_y> - 1]"
                ));
            }
        }
    }

    /// A contour beside which the cutter runs: a star about the origin, with arcs between some of its points.
    fn contour(&mut self) {
        let tool = self.pick(&[1, 2, 3]);
        let side = self.pick(&["G41", "G42"]);
        let sense = if self.chance(2) { 1.0 } else { -1.0 };
        let count = self.below(5) + 4;
        self.line("G40 G0 X45 Y3 Z1");
        self.line(&format!("{side} D{tool}"));
        let mut at = [38.0, 4.0];
        self.line("G1 X38 Y4");
        for corner in 1..count {
            let angle = sense * corner as f64 / count as f64 * TAU;
            let radius = self.value(15, 35);
            let next = [radius * angle.cos(), radius * angle.sin()];
            let next = next.map(|value: f64| (value * 1000.0).round() / 1000.0);
            if self.chance(4) {
                let chord = (next[0] - at[0]).hypot(next[1] - at[1]);
                let radius = chord * (0.55 + self.value(0, 2));
                let code = self.pick(&["G2", "G3"]);
                self.line(&format!("{code} X{} Y{} R{radius:.6}", next[0], next[1]));
            } else {
                self.line(&format!("G1 X{} Y{}", next[0], next[1]));
            }
            at = next;
            if self.chance(6) {
                let z = self.value(-3, 3);
                self.line(&format!("G1 Z{z}"));
            }
        }
        self.line("G40 G1 X50 Y50");
    }

    fn polar(&mut self) {
        let radius = self.value(1, 20);
        let angle = self.value(-180, 180);
        self.line(&format!("G0 @{radius} ^{angle}"));
        self.line(&format!("G1 ^{}", angle + 20.0));
        self.line("G91 G1 @1 ^15 Z-1");
        self.line("G90");
    }

    fn machine(&mut self) {
        let target = self.target();
        let code = self.pick(&[
            "G28 ",
            "G30 ",
            "G53 G0 ",
            "G53 G1 ",
            "G91 G28 ",
            "G28.1 (here) ",
            "M70 G91\nM72\nG0 ",
            "G30.1\nG0 ",
        ]);
        let text = if code.starts_with("G28.1") {
            "G28.1".to_owned()
        } else {
            format!("{code}{target}")
        };
        self.line(&text);
        self.line("G90");
    }

    fn feeds(&mut self) {
        let target = self.target();
        self.line(&format!("G93 G1 {target} F2"));
        self.line("G94 F100");
        let target = self.target();
        self.line(&format!("G95 F0.2 G1 {target}"));
        self.line("G94 F100");
    }

    fn splines(&mut self) {
        self.line("G0 X0 Y0");
        let text = self.pick(&[
            "G5 I0 J3 P0 Q-3 X1 Y1\nG5 P0 Q-3 X2 Y2",
            "G5.1 X5 Y5 I3 J1\nG5.1 X9 Y2 I1 J-2",
            "G5.2 P1 L3\nX0 Y5 P1\nX5 Y6 P2\nX7 Y0 P1\nG5.3",
        ]);
        self.line(text);
        let target = self.target();
        self.line(&format!("G0 {target}"));
    }
}
