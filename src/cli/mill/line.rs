//! What a line of the program changes in a scene, and what a scene says about its material.

use std::time::Duration;

use serde_json::Value;

use super::tally::{Cut, Kind};
use union3d::geometry::{Place, Totals};

/// Cubes of one change: a longer line becomes several, all with its number.
const CHANGE_CUBES_MAX: usize = 65_536;

/// The change that a line of the program makes, or one of several when the line is long.
#[derive(Debug)]
pub(super) struct LineChange {
    pub(super) line: u64,
    pub(super) kind: Kind,
    /// Machine time; none when the program gives no feed.
    pub(super) duration: Option<Duration>,
    pub(super) places: Vec<Place>,
}

/// What a scene's totals say about material, or by how much they grow. Units: steps.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Material {
    /// Volume removed from the stock, or of the union where there is none.
    pub(super) removed: i128,
    /// Area of the union.
    pub(super) area: i128,
}

impl Material {
    pub(super) fn add(&mut self, more: Self) {
        self.removed += more.removed;
        self.area += more.area;
    }

    /// From the API's mass properties; none when they are not that.
    pub(super) fn read(properties: &Value) -> Option<Self> {
        let exact = |value: &Value| value["exact"]["volume"].as_str()?.parse().ok();
        Some(Self {
            removed: match &properties["removed"] {
                Value::Null => exact(properties)?,
                removed => exact(removed)?,
            },
            area: properties["exact"]["area"].as_str()?.parse().ok()?,
        })
    }

    pub(super) fn of(totals: &Totals) -> Self {
        Self {
            removed: match &totals.stock {
                Some(stock) => stock.removed.volume,
                None => totals.measures.volume,
            },
            area: totals.measures.area(),
        }
    }
}

impl LineChange {
    pub(super) fn new(line: u64, kind: Kind) -> Self {
        Self {
            line,
            kind,
            duration: None,
            places: Vec::new(),
        }
    }

    /// Whether what comes next belongs to it. A dwell belongs to the move that its line has, too.
    pub(super) fn takes(&self, line: u64, kind: Kind) -> bool {
        self.line == line && (self.kind == kind || [self.kind, kind].contains(&Kind::Dwell))
    }

    /// Makes what comes next part of it.
    pub(super) fn join(&mut self, kind: Kind, time: Option<Duration>) {
        if self.kind == Kind::Dwell {
            self.kind = kind;
        }
        if let Some(time) = time {
            self.duration = Some(self.duration.unwrap_or_default() + time);
        }
    }

    /// The changes that a line becomes once it is whole: before, how many cubes share its time is not known. Each has the share of
    /// the machine time that it has of the cubes, in nanoseconds that add up to the whole.
    pub(super) fn changes(self) -> Vec<Self> {
        if self.places.len() <= CHANGE_CUBES_MAX {
            return vec![self];
        }
        let whole = self.places.len() as u128;
        // Nanoseconds of the first so many cubes.
        let due = |cubes: u128| Some(self.duration?.as_nanos() * cubes / whole);
        let mut before = 0;
        let changes = self.places.chunks(CHANGE_CUBES_MAX).map(|places| {
            let after = before + places.len() as u128;
            let share = due(after).zip(due(before)).map(|(to, from)| to - from);
            let duration = share.map(Duration::from_nanos_u128);
            before = after;
            Self {
                line: self.line,
                kind: self.kind,
                duration,
                places: places.to_vec(),
            }
        });
        changes.collect()
    }

    /// Machine time in seconds, as a change has it.
    pub(super) fn seconds(&self) -> Option<f64> {
        self.duration.map(|duration| duration.as_secs_f64())
    }

    /// What it did: what it removed itself (others may change the scene too), and the state after it.
    pub(super) fn cut(&self, removed: i128, after: Material) -> Cut {
        Cut {
            line: self.line,
            kind: self.kind,
            duration: self.duration,
            bodies: self.places.len() as u64,
            removed,
            total_removed: after.removed,
            area: after.area,
            tool: None,
        }
    }
}
