//! The square cutter: from moves in millimetres to places on a scene's lattice.

use clap::ValueEnum;

use union3d::geometry::Place;
use union3d::toolpath::{Move, Sampler};
use union3d::wire::convert::{InvalidCoordinate, Settings};

/// Positions along the path are this part of the edge apart when --step is not given: enough that the cutter's corners leave
/// steps of at most a twentieth of it on a slanted wall.
pub(crate) const STEPS_PER_EDGE: f64 = 20.0;

/// Unit of a scene.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
pub(crate) enum Unit {
    /// Millimetres.
    Mm,
    /// Inches.
    Inch,
}

impl Unit {
    /// The label of the scene's unit.
    pub(crate) fn label(self) -> &'static str {
        match self {
            Self::Mm => "mm",
            Self::Inch => "inch",
        }
    }

    /// Millimetres in it.
    pub(crate) fn mm(self) -> f64 {
        match self {
            Self::Mm => 1.0,
            Self::Inch => 25.4,
        }
    }
}

/// A length or a rate on the command line.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if value > 0.0 && f64::is_finite(value) => Ok(value),
        Ok(_) => Err("it must be more than 0".to_owned()),
        Err(_) => Err("it is not a number".to_owned()),
    }
}

/// How long a square cutter is.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) enum Length {
    /// From the tip up, in the scene's unit: at least the edge.
    Given(f64),
    /// From the tip up to this height, and at least the edge.
    UpTo(f64),
}

/// Turns moves into the places of a square cutter that stands with its tip on them: cubes on top of each other.
///
/// ```text
///     |___|   the last cube ends where the cutter does
///     |   |
///     |___|
///     |   |
///     |_._|   tip: the programmed point, in the middle of the lowest face
/// ```
#[derive(Debug)]
pub(crate) struct Cutter<'settings> {
    settings: &'settings Settings,
    unit: Unit,
    edge: f64,
    length: Length,
    sampler: Sampler,
    last: Option<Place>,
}

impl<'settings> Cutter<'settings> {
    /// A cutter for a scene whose `at` is the centre of a cube. Units of `step`: the scene's.
    pub(crate) fn new(
        settings: &'settings Settings,
        unit: Unit,
        step: f64,
        length: Length,
    ) -> Self {
        Self {
            settings,
            unit,
            edge: settings.document().edge,
            length,
            sampler: Sampler::new(step * unit.mm()),
            last: None,
        }
    }

    /// The places of the next move that is cut, without those of a cutter that has not moved.
    pub(crate) fn places(&mut self, next: &Move) -> impl Iterator<Item = Result<Place, String>> {
        let (line, unit) = (next.line, self.unit);
        let positions = self.sampler.positions(next);
        positions.flat_map(move |position| {
            let tip = position.map(|mm| mm / unit.mm());
            let column = self.column(tip).map_err(|(axis, invalid)| {
                format!(
                    "line {line}: the cutter cannot be at {} = {} {}: {invalid}",
                    ["x", "y", "z"][axis],
                    tip[axis],
                    unit.label(),
                )
            });
            let (column, fault) = match column {
                Ok(column) => (column, None),
                Err(fault) => (Vec::new(), Some(Err(fault))),
            };
            column.into_iter().map(Ok).chain(fault)
        })
    }

    /// The cubes of a cutter at a tip; none when it stands there already.
    fn column(&mut self, tip: [f64; 3]) -> Result<Vec<Place>, (usize, InvalidCoordinate)> {
        let top = match self.length {
            Length::Given(length) => tip[2] + length,
            Length::UpTo(top) => top,
        };
        let middle = |lower: f64| [tip[0], tip[1], lower + self.edge / 2.0];
        let lowest = self.settings.place(middle(tip[2]))?;
        if self.last == Some(lowest) {
            return Ok(Vec::new());
        }
        self.last = Some(lowest);
        let mut column = vec![lowest];
        let mut lower = tip[2];
        while lower + self.edge < top {
            // The last cube ends with the cutter, so it may overlap the one below.
            lower = (lower + self.edge).min(top - self.edge);
            column.push(self.settings.place(middle(lower))?);
        }
        Ok(column)
    }
}
