//! What is answered, as messages. The values are those of the JSON: they are made in `convert` alone.

use std::sync::Arc;

use crate::engine::Side;
use crate::geometry::{self, CubeId, Place};
use crate::service::{
    AnyScene, Applied, Cubes, HistoryRow, Published, Scene, SceneOf, SceneState, SolidScene,
    SolidTotals, Solids,
};
use crate::wire::atomic::ChangedKind;
use crate::wire::calls;
use crate::wire::convert::{self, Anchor, MassProperties, Rounding, Settings};
use crate::wire::kind::ShownKind;
use crate::wire::problem::{Fault, Problem};
use crate::wire::proto;
use crate::wire::solids::SolidSceneProperties;
use crate::wire::solids::{SolidSettings, solid_area};

/// A kind of scene, as messages show it.
pub(super) trait MessageKind: ChangedKind {
    /// A scene of this kind as one of any.
    fn any(scene: Arc<SceneOf<Self>>) -> AnyScene;

    /// Volumes and area of totals.
    fn volumes(totals: &Self::Totals, settings: &Self::Settings) -> proto::Volumes;

    /// Mass properties, in the field that they have in answers.
    fn message(properties: Self::Properties) -> Shown;
}

/// The mass properties of a scene of either kind, each in its field.
#[derive(Default)]
pub(super) struct Shown {
    pub(super) cubes: Option<proto::MassProperties>,
    pub(super) solids: Option<proto::SolidMassProperties>,
}

impl MessageKind for Cubes {
    fn any(scene: Arc<Scene>) -> AnyScene {
        AnyScene::Cubes(scene)
    }

    fn volumes(totals: &geometry::Totals, settings: &Settings) -> proto::Volumes {
        let stock = totals.stock.as_ref();
        let (union, area) = (totals.measures.volume, totals.measures.area());
        let [removed, remaining] = [
            stock.map(|stock| stock.removed.volume),
            stock.map(|stock| stock.remaining.volume),
        ];
        let user = |steps3: i128| settings.volume_user(steps3);
        proto::Volumes {
            union: user(union),
            removed: removed.map(user),
            remaining: remaining.map(user),
            area: settings.area_user(area),
            exact_union: union.to_string(),
            exact_removed: removed.map(|steps3| steps3.to_string()),
            exact_remaining: remaining.map(|steps3| steps3.to_string()),
            exact_area: area.to_string(),
        }
    }

    fn message(properties: MassProperties) -> Shown {
        Shown {
            cubes: Some(properties.into()),
            solids: None,
        }
    }
}

impl MessageKind for Solids {
    fn any(scene: Arc<SolidScene>) -> AnyScene {
        AnyScene::Solids(scene)
    }

    /// With a stock all of the union is removed from it.
    fn volumes(totals: &SolidTotals, settings: &SolidSettings) -> proto::Volumes {
        let union = &totals.union.measures;
        let remaining = totals.union.remaining.map(|rest| rest.volume6);
        let removed = remaining.map(|_| union.volume6);
        let user = |volume: i128| Self::volume_user(volume, settings);
        proto::Volumes {
            union: user(union.volume6),
            removed: removed.map(user),
            remaining: remaining.map(user),
            area: solid_area(union.area2, settings.scale()),
            exact_union: union.volume6.to_string(),
            exact_removed: removed.map(|volume| volume.to_string()),
            exact_remaining: remaining.map(|volume| volume.to_string()),
            exact_area: union.area2.to_string(),
        }
    }

    fn message(properties: SolidSceneProperties) -> Shown {
        Shown {
            cubes: None,
            solids: Some(properties.into()),
        }
    }
}

/// How much is answered of the totals.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Detail {
    None,
    Volume,
    Full,
}

impl Detail {
    pub(super) fn of(sent: i32) -> Result<Self, Problem> {
        match proto::Detail::try_from(sent) {
            Ok(proto::Detail::Unspecified | proto::Detail::Full) => Ok(Self::Full),
            Ok(proto::Detail::Volume) => Ok(Self::Volume),
            Ok(proto::Detail::None) => Ok(Self::None),
            Err(_) => Err(unknown("detail", sent)),
        }
    }
}

/// The problem of a value that no enumeration has.
pub(super) fn unknown(field: &'static str, sent: i32) -> Problem {
    Fault::in_parameter(
        field,
        "is not a value that is known here",
        &sent.to_string(),
    )
    .into()
}

pub(super) fn scene(scene: &AnyScene) -> proto::Scene {
    let newest = scene.newest();
    let bodies = newest.map(|(_, bodies)| bodies);
    let holds_solids = matches!(scene, AnyScene::Solids(_));
    let (state, percent, cause) = match scene.state() {
        SceneState::Running => (proto::SceneState::Running, None, None),
        SceneState::Recovering { percent } => {
            (proto::SceneState::Recovering, Some(percent.into()), None)
        }
        SceneState::Stopped { cause, .. } => (proto::SceneState::Stopped, None, Some(cause)),
        SceneState::Damaged { cause } => (proto::SceneState::Damaged, None, Some(cause)),
        SceneState::Newer { cause } => (proto::SceneState::Newer, None, Some(cause)),
    };
    proto::Scene {
        name: scene.name().as_str().to_owned(),
        settings: match scene {
            AnyScene::Cubes(scene) => calls::settings(scene).map(|known| settings(&known)),
            AnyScene::Solids(_) => None,
        },
        solid_settings: match scene {
            AnyScene::Cubes(_) => None,
            AnyScene::Solids(scene) => calls::settings(scene).map(|known| {
                let shapes = scene.context().ok();
                known.shown(shapes.as_deref()).into()
            }),
        },
        cubes: bodies.filter(|_| !holds_solids),
        solids: bodies.filter(|_| holds_solids),
        seq: newest.map(|(seq, _)| seq.0),
        incarnation: calls::incarnation(scene.incarnation()),
        state: state.into(),
        percent,
        cause,
    }
}

fn settings(settings: &Settings) -> proto::SceneSettings {
    let document = settings.document();
    let anchor = match document.anchor {
        Anchor::Corner => proto::Anchor::Corner,
        Anchor::Center => proto::Anchor::Center,
    };
    let rounding = match document.rounding {
        Rounding::Nearest => proto::Rounding::Nearest,
        Rounding::Reject => proto::Rounding::Reject,
    };
    proto::SceneSettings {
        edge: document.edge,
        steps_per_unit: Some(settings.steps_per_unit()),
        unit: Some(document.unit),
        density: Some(document.density),
        anchor: anchor.into(),
        rounding: rounding.into(),
        stock: document.stock.map(|stock| proto::Box {
            min: Some(stock.min.into()),
            max: Some(stock.max.into()),
        }),
    }
}

/// The totals, as much as is wanted of them.
pub(super) fn totals<K: MessageKind>(
    wanted: Detail,
    scene: &SceneOf<K>,
    settings: &K::Settings,
    published: &Published<K>,
) -> (Option<proto::Volumes>, Shown) {
    match wanted {
        Detail::None => (None, Shown::default()),
        Detail::Volume => {
            let volumes = K::volumes(&published.totals, settings);
            (Some(volumes), Shown::default())
        }
        Detail::Full => (None, mass_properties(scene, settings, published)),
    }
}

pub(super) fn outcome<K: MessageKind>(
    wanted: Detail,
    scene: &SceneOf<K>,
    settings: &K::Settings,
    applied: &Applied<K>,
) -> proto::Outcome {
    let (volumes, shown) = totals(wanted, scene, settings, &applied.published);
    proto::Outcome {
        seq: applied.published.seq.0,
        inserted: applied.counts.inserted,
        deleted: applied.counts.deleted,
        unchanged: applied.counts.unchanged,
        assigned: applied.assigned.map(|(first, last)| proto::AssignedIds {
            first: first.0,
            last: last.0,
        }),
        replayed: applied.replayed,
        volume_removed: K::volume_user(applied.volume_removed, settings),
        volume_removed_exact: applied.volume_removed.to_string(),
        volumes,
        mass_properties: shown.cubes,
        solid_mass_properties: shown.solids,
    }
}

pub(super) fn mass_properties<K: MessageKind>(
    scene: &SceneOf<K>,
    settings: &K::Settings,
    published: &Published<K>,
) -> Shown {
    let name = Some(scene.name().as_str());
    let seq = Some(published.seq.0);
    K::message(K::properties(name, seq, &published.totals, settings))
}

pub(super) fn cube((id, place): (CubeId, Place), settings: &Settings) -> proto::Cube {
    let [x, y, z] = place.corner();
    proto::Cube {
        id: id.0,
        at: Some(settings.at(place).into()),
        x,
        y,
        z,
    }
}

pub(super) fn history_row<K: MessageKind>(
    wanted: Detail,
    scene: &SceneOf<K>,
    settings: &K::Settings,
    row: &HistoryRow<K>,
) -> proto::GetHistoryResponse {
    let published = Published {
        seq: row.seq,
        at_ms: row.at_ms,
        totals: row.totals,
    };
    let (volumes, shown) = totals(wanted, scene, settings, &published);
    let duration = row.motion.duration_ns.map(convert::duration_user);
    let volume_removed = K::volume_user(row.volume_removed, settings);
    proto::GetHistoryResponse {
        seq: row.seq.0,
        time: Some(timestamp(row.at_ms)),
        inserted: row.inserted,
        deleted: row.deleted,
        volumes,
        mass_properties: shown.cubes,
        r#move: row.motion.number,
        duration,
        volume_removed,
        volume_removed_exact: row.volume_removed.to_string(),
        removal_rate: convert::removal_rate(volume_removed, duration),
        solid_mass_properties: shown.solids,
    }
}

/// Cubes as a change that inserts them.
pub(super) fn insertion(cubes: &[(CubeId, Place)]) -> proto::Change {
    let column = |axis: usize| cubes.iter().map(move |(_, place)| place.corner()[axis]);
    proto::Change {
        insert_id: cubes.iter().map(|(id, _)| id.0).collect(),
        x: column(0).collect(),
        y: column(1).collect(),
        z: column(2).collect(),
        ..proto::Change::default()
    }
}

pub(super) fn side(side: Side) -> proto::Side {
    match side {
        Side::Inside => proto::Side::Inside,
        Side::Boundary => proto::Side::Boundary,
        Side::Outside => proto::Side::Outside,
    }
}

/// A time in ms since 1970.
fn timestamp(at_ms: u64) -> prost_types::Timestamp {
    let seconds = i64::try_from(at_ms / 1000).unwrap_or(i64::MAX);
    let nanos = i32::try_from(at_ms % 1000 * 1_000_000).expect("below a second");
    prost_types::Timestamp { seconds, nanos }
}
