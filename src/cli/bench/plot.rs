//! A plot with logarithmic axes, as SVG: enough for a README, readable on a light and on a dark page.

use std::fmt::Write;

/// Lines over two logarithmic axes.
pub(super) struct Plot {
    pub(super) title: String,
    pub(super) x: Axis,
    pub(super) y: Axis,
    pub(super) lines: Vec<Line>,
}

/// What is along an axis.
pub(super) struct Axis {
    label: String,
}

impl Axis {
    pub(super) fn of(label: &str) -> Self {
        Self {
            label: label.to_owned(),
        }
    }
}

/// A line through points (x, y, both positive), and a level to compare it with, dashed.
pub(super) struct Line {
    pub(super) name: String,
    pub(super) points: Vec<[f64; 2]>,
    pub(super) level: f64,
}

const WIDTH: f64 = 720.0;
const HEIGHT: f64 = 420.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 130.0;
const TOP: f64 = 40.0;
const BOTTOM: f64 = 50.0;
/// Between names, one below the other.
const LINE_HEIGHT: f64 = 14.0;

/// Told apart with any kind of colour vision.
/// # Source
/// M. Okabe, K. Ito, "Color universal design", 2008.
const COLOURS: [&str; 7] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#888888",
];

impl Plot {
    /// The whole file.
    pub(super) fn svg(&self) -> String {
        let values = |axis: usize| {
            let points = self.lines.iter().flat_map(|line| &line.points);
            points.map(move |point| point[axis])
        };
        let levels = self.lines.iter().map(|line| line.level);
        let x = Scale::new(values(0), [LEFT, WIDTH - RIGHT]);
        let y = Scale::new(values(1).chain(levels), [HEIGHT - BOTTOM, TOP]);
        let mut svg = String::new();
        let mut put = |element: String| {
            writeln!(svg, "{element}").expect("a string takes everything");
        };
        put(format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" font-size=\"12\">"
        ));
        put("<rect width=\"100%\" height=\"100%\" fill=\"white\"/>".to_owned());
        put(label(WIDTH / 2.0, 20.0, "middle", &self.title));
        put(label(
            f64::midpoint(LEFT, WIDTH - RIGHT),
            HEIGHT - 10.0,
            "middle",
            &self.x.label,
        ));
        let middle = f64::midpoint(TOP, HEIGHT - BOTTOM);
        put(format!(
            "<text x=\"16\" y=\"{middle}\" text-anchor=\"middle\" transform=\"rotate(-90 16 {middle})\">{}</text>",
            escaped(&self.y.label)
        ));
        for tick in x.ticks() {
            let at = x.at(tick);
            put(rule([at, TOP], [at, HEIGHT - BOTTOM]));
            put(label(
                at,
                HEIGHT - BOTTOM + 16.0,
                "middle",
                &tick.to_string(),
            ));
        }
        for tick in y.ticks() {
            let at = y.at(tick);
            put(rule([LEFT, at], [WIDTH - RIGHT, at]));
            put(label(LEFT - 6.0, at + 4.0, "end", &tick.to_string()));
        }
        for (number, line) in self.lines.iter().enumerate() {
            let colour = COLOURS[number % COLOURS.len()];
            let points = line
                .points
                .iter()
                .map(|[side, pace]| format!("{:.1},{:.1}", x.at(*side), y.at(*pace)));
            let points: Vec<String> = points.collect();
            let path = points.join(" ");
            put(format!(
                "<polyline points=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>"
            ));
            let level = y.at(line.level);
            put(format!(
                "<line x1=\"{LEFT}\" y1=\"{level:.1}\" x2=\"{}\" y2=\"{level:.1}\" stroke=\"{colour}\" stroke-dasharray=\"5 4\"/>",
                WIDTH - RIGHT
            ));
        }
        let ends = self.lines.iter().enumerate().filter_map(|(number, line)| {
            let [_, last] = line.points.last()?;
            Some((y.at(*last) + 4.0, COLOURS[number % COLOURS.len()], line))
        });
        let mut ends: Vec<_> = ends.collect();
        ends.sort_by(|(one, ..), (other, ..)| one.total_cmp(other));
        let mut free = 0.0;
        for (end, colour, line) in ends {
            let at = f64::max(end, free);
            free = at + LINE_HEIGHT;
            put(format!(
                "<text x=\"{}\" y=\"{at:.1}\" fill=\"{colour}\">{}</text>",
                WIDTH - RIGHT + 8.0,
                escaped(&line.name)
            ));
        }
        put("</svg>".to_owned());
        svg
    }
}

/// From values to places on the page.
struct Scale {
    logarithms: [f64; 2],
    page: [f64; 2],
}

impl Scale {
    /// Room for all values, with a little beside them.
    fn new(values: impl Iterator<Item = f64>, page: [f64; 2]) -> Self {
        let none = [f64::INFINITY, f64::NEG_INFINITY];
        let [least, greatest] = values
            .map(f64::log10)
            .fold(none, |[least, greatest], value| {
                [least.min(value), greatest.max(value)]
            });
        Self {
            logarithms: [least - 0.05, greatest + 0.05],
            page,
        }
    }

    fn at(&self, value: f64) -> f64 {
        let [least, greatest] = self.logarithms;
        let part = (value.log10() - least) / (greatest - least);
        self.page[0] + part * (self.page[1] - self.page[0])
    }

    /// One, two and five of every decade within.
    fn ticks(&self) -> impl Iterator<Item = f64> {
        let [least, greatest] = self.logarithms;
        let all = (-6..=9).flat_map(|decade| {
            [1_i32, 2, 5].map(|digit| {
                // By way of text, so that 0.2 is 0.2.
                let text = format!("{digit}e{decade}");
                text.parse::<f64>().expect("digits and an exponent")
            })
        });
        all.filter(move |tick| (least..=greatest).contains(&tick.log10()))
    }
}

fn rule(from: [f64; 2], to: [f64; 2]) -> String {
    format!(
        "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"#dddddd\"/>",
        from[0], from[1], to[0], to[1]
    )
}

fn label(x: f64, y: f64, anchor: &str, text: &str) -> String {
    format!(
        "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{}</text>",
        escaped(text)
    )
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}
