//! What the answers about scenes of different kinds have of their own.

use std::sync::Arc;

use serde::Serialize;
use utoipa::ToSchema;

use super::convert::{self, MassProperties, Settings};
use super::solids::{SolidSceneProperties, SolidSettings, solid_scene_properties, solid_volume};
use crate::geometry;
use crate::service::{Cubes, Scene, SceneKind, SolidScene, SolidTotals, Solids};

/// A kind of scene, as it is shown.
pub(super) trait ShownKind: SceneKind {
    /// What is fixed when a scene is created, in user units.
    type Settings: Send + Sync + 'static;
    /// What is measured.
    type Properties: HistoryTotals;

    /// Settings as they were stored; none when they are in a form that is not known.
    fn settings(text: &str) -> Option<Self::Settings>;

    /// What totals come to in user units.
    fn properties(
        scene: Option<&str>,
        seq: Option<u64>,
        totals: &Self::Totals,
        settings: &Self::Settings,
    ) -> Self::Properties;

    /// The same as it stands in the answers that both kinds share.
    fn shown(properties: Self::Properties) -> Properties;

    /// A line of the history.
    fn entry(change: HistoryChange, totals: Self::Properties) -> HistoryEntry;

    /// A volume of the totals' unit in user units cubed.
    fn volume_user(volume: i128, settings: &Self::Settings) -> f64;
}

/// What the lines of a history show of totals.
pub(super) trait HistoryTotals: Sized + Serialize + ToSchema + Send + 'static {
    /// What the bodies are called.
    const BODIES: &'static str;

    /// The cells of a line of CSV.
    const CELLS: &'static [Cell<Self>];
}

/// A cell of CSV: the name of its column, and its text.
pub(super) type Cell<T> = (&'static str, fn(&T) -> String);

/// The mass properties of a scene of either kind.
#[derive(Serialize, ToSchema)]
#[serde(untagged)]
pub(super) enum Properties {
    /// Of cubes.
    Cubes(Box<MassProperties>),
    /// Of solids.
    Solids(Box<SolidSceneProperties>),
}

/// A change of the past.
#[derive(Serialize, ToSchema)]
pub(super) struct HistoryChange {
    /// When it was accepted: RFC 3339, UTC.
    #[schema(format = DateTime, example = "2026-03-01T12:00:00.000Z")]
    pub(super) time: String,
    /// The sender's number of the move it belongs to; null when none was given.
    #[schema(example = 120)]
    pub(super) r#move: Option<u64>,
    /// Machine time, in seconds; null when none was given.
    #[schema(example = 0.25)]
    pub(super) duration: Option<f64>,
    /// Cubes or solids that it inserted.
    pub(super) inserted: u64,
    /// Cubes or solids that it deleted.
    pub(super) deleted: u64,
    /// Volume that it removed from the stock, or added to the union where there is no stock, in user units cubed. Negative when it
    /// gave some back.
    pub(super) volume_removed: f64,
    /// The same in steps cubed, exact; of a scene of solids in 96ths of them.
    #[schema(example = "216000000000")]
    pub(super) volume_removed_exact: String,
    /// Volume removed in a second of machine time; null without a duration above 0.
    pub(super) removal_rate: Option<f64>,
}

/// A change of the past, with the totals after it and its seq.
#[derive(Serialize, ToSchema)]
#[serde(untagged)]
pub(super) enum HistoryEntry {
    /// Of a scene of cubes.
    Cubes(Box<CubesEntry>),
    /// Of a scene of solids.
    Solids(Box<SolidsEntry>),
}

/// A change of a scene of cubes.
#[derive(Serialize, ToSchema)]
pub(super) struct CubesEntry {
    #[serde(flatten)]
    change: HistoryChange,
    #[serde(flatten)]
    totals: MassProperties,
}

/// A change of a scene of solids.
#[derive(Serialize, ToSchema)]
pub(super) struct SolidsEntry {
    #[serde(flatten)]
    change: HistoryChange,
    #[serde(flatten)]
    totals: SolidSceneProperties,
}

/// A scene of either kind with its settings.
pub(super) enum Opened {
    /// Of cubes.
    Cubes(Arc<Scene>, Arc<Settings>),
    /// Of solids.
    Solids(Arc<SolidScene>, Arc<SolidSettings>),
}

/// A cell that may be empty. Of a float the shortest text that reads back as the same number.
pub(super) fn maybe(value: Option<impl ToString>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
}

impl ShownKind for Cubes {
    type Settings = Settings;
    type Properties = MassProperties;

    fn settings(text: &str) -> Option<Settings> {
        Settings::from_text(text)
    }

    fn properties(
        scene: Option<&str>,
        seq: Option<u64>,
        totals: &geometry::Totals,
        settings: &Settings,
    ) -> MassProperties {
        convert::mass_properties(scene, seq, totals, settings)
    }

    fn shown(properties: MassProperties) -> Properties {
        Properties::Cubes(Box::new(properties))
    }

    fn entry(change: HistoryChange, totals: MassProperties) -> HistoryEntry {
        HistoryEntry::Cubes(Box::new(CubesEntry { change, totals }))
    }

    fn volume_user(volume: i128, settings: &Settings) -> f64 {
        settings.volume_user(volume)
    }
}

impl HistoryTotals for MassProperties {
    const BODIES: &'static str = "cubes";

    const CELLS: &'static [Cell<Self>] = &[
        ("seq", |totals| maybe(totals.seq)),
        (Self::BODIES, |totals| totals.cubes.to_string()),
        ("volume", |totals| totals.user.volume.to_string()),
        ("area", |totals| totals.user.area.to_string()),
        ("edge_length", |totals| {
            totals.user.edge_length.total.to_string()
        }),
        ("euler_characteristic", |totals| {
            totals.integers.euler_characteristic.to_string()
        }),
        ("removed", |totals| {
            maybe(totals.removed.as_ref().map(|part| part.user.volume))
        }),
        ("remaining", |totals| {
            maybe(totals.remaining.as_ref().map(|part| part.user.volume))
        }),
        ("volume_exact", |totals| {
            totals.integers.exact.volume.clone()
        }),
    ];
}

impl ShownKind for Solids {
    type Settings = SolidSettings;
    type Properties = SolidSceneProperties;

    fn settings(text: &str) -> Option<SolidSettings> {
        SolidSettings::from_text(text)
    }

    fn properties(
        scene: Option<&str>,
        seq: Option<u64>,
        totals: &SolidTotals,
        settings: &SolidSettings,
    ) -> SolidSceneProperties {
        let SolidTotals { union, error_max } = totals;
        let (scale, density) = (settings.scale(), settings.density());
        solid_scene_properties(scene, seq, (union, error_max), scale, density)
    }

    fn shown(properties: SolidSceneProperties) -> Properties {
        Properties::Solids(Box::new(properties))
    }

    fn entry(change: HistoryChange, totals: SolidSceneProperties) -> HistoryEntry {
        HistoryEntry::Solids(Box::new(SolidsEntry { change, totals }))
    }

    fn volume_user(volume: i128, settings: &SolidSettings) -> f64 {
        solid_volume(volume, settings.scale())
    }
}

impl HistoryTotals for SolidSceneProperties {
    const BODIES: &'static str = "solids";

    const CELLS: &'static [Cell<Self>] = &[
        ("seq", |totals| maybe(totals.measured.seq)),
        (Self::BODIES, |totals| totals.measured.solids.to_string()),
        ("volume", |totals| {
            totals.measured.measures.volume.to_string()
        }),
        ("area", |totals| totals.measured.measures.area.to_string()),
        ("edge_length", |totals| {
            totals.measured.measures.edge_length.total.to_string()
        }),
        ("removed", |totals| {
            maybe(totals.removed.as_ref().map(|part| part.volume))
        }),
        ("remaining", |totals| {
            maybe(totals.remaining.as_ref().map(|part| part.volume))
        }),
        ("volume_exact", |totals| {
            totals.measured.measures.exact.volume.value.clone()
        }),
    ];
}
