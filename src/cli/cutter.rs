//! The cubic cutter: from moves in millimetres to places on a scene's lattice.

use clap::ValueEnum;

use union3d::geometry::Place;
use union3d::toolpath::{Move, Sampler};
use union3d::wire::convert::Settings;

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

/// Turns moves into the places of a cutter centred on them.
#[derive(Debug)]
pub(crate) struct Cutter<'settings> {
    settings: &'settings Settings,
    unit: Unit,
    sampler: Sampler,
    last: Option<Place>,
}

impl<'settings> Cutter<'settings> {
    /// A cutter for a scene whose `at` is the centre. Units of `step`: the scene's.
    pub(crate) fn new(settings: &'settings Settings, unit: Unit, step: f64) -> Self {
        Self {
            settings,
            unit,
            sampler: Sampler::new(step * unit.mm()),
            last: None,
        }
    }

    /// The places of the next move that is cut, without those that repeat the one before.
    pub(crate) fn places(&mut self, next: &Move) -> impl Iterator<Item = Result<Place, String>> {
        let (line, unit, settings) = (next.line, self.unit, self.settings);
        let last = &mut self.last;
        self.sampler.positions(next).filter_map(move |position| {
            let at = position.map(|mm| mm / unit.mm());
            match settings.place(at) {
                Ok(place) if *last == Some(place) => None,
                Ok(place) => {
                    *last = Some(place);
                    Some(Ok(place))
                }
                Err((axis, invalid)) => Some(Err(format!(
                    "line {line}: the cutter cannot be at {} = {} {}: {invalid}",
                    ["x", "y", "z"][axis],
                    at[axis],
                    unit.label(),
                ))),
            }
        })
    }
}
