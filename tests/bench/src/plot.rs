//! A plot with logarithmic axes, as SVG: enough for a page of documentation, readable on a light and on a dark one.

use std::ops::Range;

use plotters::prelude::*;

use super::failure::Failure;

/// Lines over two logarithmic axes.
pub(crate) struct Plot {
    pub(crate) title: String,
    /// What is along the axes.
    pub(crate) x: &'static str,
    pub(crate) y: &'static str,
    pub(crate) lines: Vec<Line>,
}

/// A line through points (x, y, both positive), and a level to compare it with, dashed.
pub(crate) struct Line {
    pub(crate) name: String,
    pub(crate) points: Vec<[f64; 2]>,
    pub(crate) level: f64,
}

/// Width and height. Units: pixels at the usual scale.
const SIZE: (u32, u32) = (760, 440);

/// Told apart with any kind of colour vision.
/// # Source
/// M. Okabe, K. Ito, "Color universal design", 2008.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xcc, 0x79, 0xa7),
    RGBColor(0xe6, 0x9f, 0x00),
    RGBColor(0x56, 0xb4, 0xe9),
    RGBColor(0x88, 0x88, 0x88),
];

impl Plot {
    /// The whole file.
    /// # Errors
    /// It cannot be drawn: there is no point in it.
    pub(crate) fn svg(&self) -> Result<String, Failure> {
        let values = |axis: usize| {
            let points = self.lines.iter().flat_map(|line| &line.points);
            points.map(move |point| point[axis])
        };
        let levels = self.lines.iter().map(|line| line.level);
        let x = around(values(0))?;
        let y = around(values(1).chain(levels))?;
        let mut svg = String::new();
        let page = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        page.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&page)
            .margin(12)
            .caption(&self.title, ("sans-serif", 15))
            .x_label_area_size(42)
            .y_label_area_size(58)
            .build_cartesian_2d(
                x.clone().log_scale().with_key_points(ticks(&x)),
                y.clone().log_scale().with_key_points(ticks(&y)),
            )?;
        chart
            .configure_mesh()
            .x_desc(self.x)
            .y_desc(self.y)
            .x_label_formatter(&f64::to_string)
            .y_label_formatter(&f64::to_string)
            .bold_line_style(RGBColor(0xdd, 0xdd, 0xdd))
            .light_line_style(TRANSPARENT)
            .label_style(("sans-serif", 12))
            .draw()?;
        for (line, colour) in self.lines.iter().zip(COLOURS.into_iter().cycle()) {
            let style = colour.stroke_width(2);
            let points = line.points.iter().map(|&[x, y]| (x, y));
            chart
                .draw_series(LineSeries::new(points, style))?
                .label(&line.name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
            let level = [(x.start, line.level), (x.end, line.level)];
            chart.draw_series(DashedLineSeries::new(level, 5, 4, colour.into()))?;
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .label_font(("sans-serif", 12))
            .background_style(WHITE)
            .border_style(RGBColor(0xdd, 0xdd, 0xdd))
            .draw()?;
        page.present()?;
        // The chart and the page borrow the text that they write.
        drop((chart, page));
        Ok(svg)
    }
}

/// Room for all values, with a little beside them.
fn around(values: impl Iterator<Item = f64>) -> Result<Range<f64>, Failure> {
    const BESIDE: f64 = 1.12;
    let none = [f64::INFINITY, 0.0];
    let [least, greatest] = values.fold(none, |[least, greatest], value| {
        [least.min(value), greatest.max(value)]
    });
    if least.is_finite() && 0.0 < least && greatest.is_finite() {
        Ok(least / BESIDE..greatest * BESIDE)
    } else {
        Err(
            format!("nothing can be plotted from {least} to {greatest} on a logarithmic axis")
                .into(),
        )
    }
}

/// One, two and five of every decade within.
fn ticks(range: &Range<f64>) -> Vec<f64> {
    let decades = (-6..=9).flat_map(|decade| {
        [1, 2, 5].map(|digit| {
            // By way of text, so that 0.2 is 0.2.
            let text = format!("{digit}e{decade}");
            text.parse::<f64>().expect("digits and an exponent")
        })
    });
    decades.filter(|tick| range.contains(tick)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_is_drawn_with_its_level_and_name() {
        let line = |name: &str, level| Line {
            name: name.to_owned(),
            points: vec![[0.5, 1.0], [1.0, 2.0], [8.0, 9.0]],
            level,
        };
        let plot = Plot {
            title: "one < two".to_owned(),
            x: "side",
            y: "time",
            lines: vec![line("rho-1", 1.5), line("raster", 3.0)],
        };
        let svg = plot.svg().unwrap();
        for text in ["one &lt; two", "side", "time", "rho-1", "raster"] {
            assert!(svg.contains(text), "{text}: {svg}");
        }
        assert!(!svg.contains("NaN"), "{svg}");
        let drawn = |colour: &str| svg.matches(colour).count();
        // The line, what stands for it in the legend, and the dashes.
        assert!(drawn("#0072B2") >= 3, "{svg}");
        assert!(drawn("#D55E00") >= 3, "{svg}");
    }

    #[test]
    fn what_has_no_logarithm_is_refused() {
        let plot = Plot {
            title: String::new(),
            x: "",
            y: "",
            lines: vec![],
        };
        assert!(plot.svg().is_err());
    }

    #[test]
    fn ticks_are_round() {
        assert_eq!(ticks(&(0.15..21.0)), [0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0]);
    }
}
