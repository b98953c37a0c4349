//! Where planes cut scenes: slices, stacks of them, and two of them over each other.

use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use headers::HeaderMapExt;
use serde::Serialize;
use tokio::sync::mpsc;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use utoipa::ToSchema;

use super::reads::entity_tag;
use super::request::{BodyType, Known, Parameters, Path};
use super::{App, scenes};
use crate::boundary::Region;
use crate::boundary::slice::{Overlaid, Slice, TooFar};
use crate::service::{SceneOf, Seq};
use crate::wire::access::Ticket;
use crate::wire::drawing::{self, PolygonDocument};
use crate::wire::kind::Opened;
use crate::wire::problem::{Code, Fault, Problem};
use crate::wire::slices::{SlicedKind, Stack, level};

/// Most slices of a stack.
const SLICES_MAX: f64 = 100_000.0;

/// Slices of a stack that may wait for the client.
const WAITING_MAX: usize = 2;

/// An axis.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
enum Axis {
    /// Slices have y and z.
    X,
    /// Slices have z and x.
    Y,
    /// Slices have x and y.
    Z,
}

/// What is cut.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
enum Part {
    /// The union of all cubes or solids, also outside the stock.
    Union,
    /// What they have in common with the stock.
    Removed,
    /// The stock outside them.
    Remaining,
}

/// In which form slices are answered.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ToSchema)]
#[schema(rename_all = "lowercase")]
enum Format {
    Json,
    Svg,
    Dxf,
}

/// Where a plane cuts a scene.
#[derive(Serialize, ToSchema)]
#[schema(as = Slice)]
struct SliceDocument {
    /// The change that it is as of.
    seq: u64,
    /// The axis that the plane is at right angles to.
    axis: Axis,
    /// Where it meets the axis, in user units.
    at: f64,
    /// What is cut.
    part: Part,
    /// Area, in user units squared.
    area: f64,
    /// Length of all rings, in user units.
    perimeter: f64,
    /// Polygons that have no area in common, in user units.
    polygons: Vec<PolygonDocument>,
}

/// One of two that lie over each other.
#[derive(Serialize, ToSchema)]
struct OverlaidPart {
    /// Name of the scene.
    scene: String,
    /// What of it.
    part: Part,
    /// The change that it is as of.
    seq: u64,
}

/// Two slices over each other.
#[derive(Serialize, ToSchema)]
pub(super) struct Overlay {
    /// The first.
    a: OverlaidPart,
    /// The second.
    b: OverlaidPart,
    /// The axis that the plane is at right angles to.
    axis: Axis,
    /// Where it meets the axis, in user units.
    at: f64,
    /// What only the first has, what only the second has, and what both have, as far as there is any.
    regions: Vec<OverlayRegion>,
}

/// What lies in one of two, or in both.
#[derive(Serialize, ToSchema)]
struct OverlayRegion {
    /// In which of the two it lies: `a`, `b` or both.
    r#in: Vec<&'static str>,
    /// Area, in user units squared.
    area: f64,
    /// Length of all rings, in user units.
    perimeter: f64,
    /// Polygons that have no area in common, in user units.
    polygons: Vec<PolygonDocument>,
}

impl Axis {
    fn of(query: &Known) -> Result<Self, Problem> {
        match query.text("axis") {
            None | Some("z") => Ok(Self::Z),
            Some("x") => Ok(Self::X),
            Some("y") => Ok(Self::Y),
            Some(other) => Err(Fault::in_parameter("axis", "is none of x, y and z", other).into()),
        }
    }
}

impl Part {
    fn of(parameter: &'static str, text: Option<&str>) -> Result<Self, Problem> {
        match text {
            None | Some("union") => Ok(Self::Union),
            Some("removed") => Ok(Self::Removed),
            Some("remaining") => Ok(Self::Remaining),
            Some(other) => {
                let detail = "names none of the parts union, removed and remaining";
                Err(Fault::in_parameter(parameter, detail, other).into())
            }
        }
    }

    fn region(self) -> Region {
        match self {
            Self::Union => Region::Union,
            Self::Removed => Region::Removed,
            Self::Remaining => Region::Remaining,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Union => "union",
            Self::Removed => "removed",
            Self::Remaining => "remaining",
        }
    }
}

/// A finite number, if it is given.
fn number(query: &Known, name: &'static str) -> Result<Option<f64>, Problem> {
    let Some(text) = query.text(name) else {
        return Ok(None);
    };
    match text.parse() {
        Ok(number) if f64::is_finite(number) => Ok(Some(number)),
        _ => Err(Fault::in_parameter(name, "is not a finite number", text).into()),
    }
}

/// A finite number that must be given.
fn needed(query: &Known, name: &'static str) -> Result<f64, Problem> {
    let missing = || Fault::in_parameter(name, "is missing: a number in user units", "").into();
    number(query, name)?.ok_or_else(missing)
}

/// At which coordinates a scene is cut.
#[derive(Clone, Copy, Debug)]
enum Places {
    One(f64),
    /// From the first on, so many, so far apart.
    Several {
        from: f64,
        step: f64,
        count: u32,
    },
}

impl Places {
    fn of(query: &Known) -> Result<Self, Problem> {
        if query.text("at").is_some() {
            let mut with = ["from", "to", "step"].into_iter();
            if let Some(name) = with.find(|name| query.text(name).is_some()) {
                let detail = "cannot stand together with at";
                let sent = query.text(name).unwrap_or_default();
                return Err(Fault::in_parameter(name, detail, sent).into());
            }
            return Ok(Self::One(needed(query, "at")?));
        }
        if ["from", "to", "step"]
            .iter()
            .all(|name| query.text(name).is_none())
        {
            let detail = "is missing: where to cut, in user units; or from, to and step";
            return Err(Fault::in_parameter("at", detail, "").into());
        }
        let (from, to, step) = (
            needed(query, "from")?,
            needed(query, "to")?,
            needed(query, "step")?,
        );
        let shown = |name| query.text(name).unwrap_or_default();
        if step <= 0.0 {
            return Err(Fault::in_parameter("step", "is not above 0", shown("step")).into());
        }
        if to < from {
            return Err(Fault::in_parameter("to", "is below from", shown("to")).into());
        }
        // The last is there when it is as near as reading decimals can have moved it.
        let count = ((to - from) / step + 1e-9).floor() + 1.0;
        if count > SLICES_MAX {
            let detail = format!("makes more than {SLICES_MAX} slices");
            return Err(Fault::in_parameter("step", detail, shown("step")).into());
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a whole number from 1 to 100,000"
        )]
        let count = count as u32;
        Ok(Self::Several { from, step, count })
    }

    fn all(self) -> impl Iterator<Item = f64> {
        let (from, step, count) = match self {
            Self::One(at) => (at, 0.0, 1),
            Self::Several { from, step, count } => (from, step, count),
        };
        (0..count).map(move |index| from + f64::from(index) * step)
    }
}

/// What is asked of a scene.
#[derive(Clone, Copy, Debug)]
struct Question {
    axis: Axis,
    places: Places,
    part: Part,
    format: Format,
}

/// Cut a scene with a plane
///
/// The cross-section with a plane at right angles to an axis: polygons with holes, as of one seq. In the plane of faces it is the limit from
/// the greater side: what lies above the plane counts, what ends at it does not. Rings are closed, outlines counterclockwise as seen from
/// the greater side, holes clockwise; points are `[y, z]` for `x`, `[z, x]` for `y`, `[x, y]` for `z`. Corners are exact to `2^-30` of a lattice step, and
/// those of cubes and boxes exact. With `from`, `to` and `step` in the place of `at` a stack of slices is answered, a line each, upwards.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/slice", tag = "pictures",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("axis" = inline(Option<Axis>), Query, description = "The axis that the plane is at right angles to; `z` if left out"),
        ("at" = Option<f64>, Query, description = "Where the plane meets the axis, in user units", example = 1.5),
        ("from" = Option<f64>, Query, description = "Where the first plane of a stack is"),
        ("to" = Option<f64>, Query, description = "Where the last may be"),
        ("step" = Option<f64>, Query, description = "How far they are apart: above 0, and at most 100,000 slices"),
        ("part" = inline(Option<Part>), Query, description = "What is cut; `union` if left out. `removed` and `remaining` need a stock"),
        ("format" = inline(Option<Format>), Query, description = "`json` if left out; a stack has no other"),
    ),
    responses((status = 200, description = "The slice, or a line for each of a stack", content(
        (SliceDocument = "application/json"),
        (SliceDocument = "application/x-ndjson"),
        (String = "image/svg+xml"),
        (String = "image/vnd.dxf"),
    )))
)]
pub(super) async fn get_slice(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
) -> Result<Response, Problem> {
    let query = parameters.only(&["axis", "at", "from", "to", "step", "part", "format"])?;
    let places = Places::of(&query)?;
    let format = match (query.text("format"), places) {
        (None | Some("json"), _) => Format::Json,
        (Some("svg"), Places::One(_)) => Format::Svg,
        (Some("dxf"), Places::One(_)) => Format::Dxf,
        (Some(other @ ("svg" | "dxf")), _) => {
            let detail = "is for one slice: a stack is answered as lines of JSON";
            return Err(Fault::in_parameter("format", detail, other).into());
        }
        (Some(other), _) => {
            return Err(
                Fault::in_parameter("format", "is none of json, svg and dxf", other).into(),
            );
        }
    };
    let question = Question {
        axis: Axis::of(&query)?,
        places,
        part: Part::of("part", query.text("part"))?,
        format,
    };
    match scenes::open_any(&app, &name)? {
        Opened::Cubes(scene, settings) => slices(&scene, settings, question).await,
        Opened::Solids(scene, settings) => slices(&scene, settings, question).await,
    }
}

/// The bodies that planes meet.
async fn stack<K: SlicedKind>(
    scene: &Arc<SceneOf<K>>,
    settings: Arc<K::Settings>,
    (parameter, axis, part): (&'static str, Axis, Part),
    levels: &[i64],
) -> Result<(Seq, Stack<K>), Problem> {
    let (Some(&first), Some(&last)) = (levels.first(), levels.last()) else {
        unreachable!("there is one place at least");
    };
    let axis = axis as usize;
    let wanted = |body: &K::Body| {
        let bounds = K::bounds(body, &settings);
        let [min, max] = [bounds.min, bounds.max]
            .map(|corner| i64::from(corner[axis]) << crate::boundary::section::GRID_BITS);
        (min <= last && first < max).then(|| K::bytes(body))
    };
    let selected = scene.select(wanted).await?;
    if part != Part::Union && selected.stock.is_none() {
        let detail = "is of a stock, and the scene has none";
        return Err(Fault::in_parameter(parameter, detail, part.name()).into());
    }
    Ok((selected.seq, Stack::new(settings, selected, axis)))
}

async fn slices<K: SlicedKind>(
    scene: &Arc<SceneOf<K>>,
    settings: Arc<K::Settings>,
    question: Question,
) -> Result<Response, Problem> {
    let Question {
        axis,
        places,
        part,
        format,
    } = question;
    let scale = K::steps_per_unit(&settings);
    let levels: Vec<i64> = places.all().map(|at| level(at, scale)).collect();
    let (seq, mut stack) = stack(scene, settings, ("part", axis, part), &levels).await?;
    let document = move |at: f64, slice: &Slice| {
        let (area, perimeter) = measured(slice, scale);
        SliceDocument {
            seq: seq.0,
            axis,
            at,
            part,
            area,
            perimeter,
            polygons: PolygonDocument::all(slice, scale),
        }
    };
    let mut headers = HeaderMap::new();
    headers.typed_insert(entity_tag(scene, seq));
    if let Places::One(at) = places {
        let region = part.region();
        let cut = move |goes_on: &dyn Fn() -> bool| {
            let slice = stack.slice(levels[0], region, goes_on)?;
            Some(document(at, &slice))
        };
        let slice = cancellable(cut).await;
        let (kind, text) = match format {
            Format::Json => return Ok((headers, Json(slice)).into_response()),
            Format::Svg => ("image/svg+xml", drawing::svg(&slice.polygons)),
            Format::Dxf => ("image/vnd.dxf", drawing::dxf(&slice.polygons)),
        };
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
        return Ok((headers, text).into_response());
    }
    let (lines, receiver) = mpsc::channel(WAITING_MAX);
    let cut = move || {
        for (at, level) in places.all().zip(levels) {
            let goes_on = || !lines.is_closed();
            let Some(slice) = stack.slice(level, part.region(), &goes_on) else {
                return;
            };
            let mut text =
                serde_json::to_vec(&document(at, &slice)).expect("numbers and strings are JSON");
            text.push(b'\n');
            if lines.blocking_send(Bytes::from(text)).is_err() {
                return;
            }
        }
    };
    let cutting = tokio::task::spawn_blocking(cut);
    headers.insert(header::CONTENT_TYPE, BodyType::Ndjson.value());
    let lines = ReceiverStream::new(receiver).map(Ok);
    // A stack that failed breaks off, so that nobody takes a part of it for all of it.
    let end = futures_util::stream::once(async {
        match cutting.await {
            Ok(()) => Ok(Bytes::new()),
            Err(error) => Err(std::io::Error::other(error)),
        }
    });
    let body = Body::from_stream(lines.chain(end));
    Ok((headers, body).into_response())
}

/// Area and perimeter in user units.
fn measured(slice: &Slice, steps_per_unit: u32) -> (f64, f64) {
    let scale = f64::from(steps_per_unit);
    (slice.area() / (scale * scale), slice.perimeter() / scale)
}

/// Sets a flag when it goes: nobody waits any more.
struct Cancelling(Arc<AtomicBool>);

impl Drop for Cancelling {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Does work on another thread, which is told when nobody waits for it any more: only then it may make nothing.
async fn cancellable<T: Send + 'static>(
    work: impl FnOnce(&dyn Fn() -> bool) -> Option<T> + Send + 'static,
) -> T {
    let cancelled = Arc::new(AtomicBool::new(false));
    let _cancelling = Cancelling(cancelled.clone());
    let work = move || work(&|| !cancelled.load(Ordering::Relaxed));
    match tokio::task::spawn_blocking(work).await {
        Ok(made) => made.expect("it is cancelled only when nobody waits"),
        Err(error) => resume_unwind(error.into_panic()),
    }
}

/// Lay two slices over each other
///
/// The slices of two scenes, or of two parts of scenes, by one plane: what only the first has, what only the second has, and what both
/// have. Both are read, one after the other, as of the newest seq of each. The scenes have the same unit; the user units of both are taken to be at the same place. Needs the
/// right read on both scenes.
#[utoipa::path(
    get, path = "/v1/overlay", tag = "pictures",
    params(
        ("a" = String, Query, pattern = r"^[a-z0-9][a-z0-9._-]{0,62}(:(union|removed|remaining))?$", description = "`SCENE` or `SCENE:part`", example = "pocket"),
        ("b" = String, Query, pattern = r"^[a-z0-9][a-z0-9._-]{0,62}(:(union|removed|remaining))?$", description = "`SCENE` or `SCENE:part`", example = "pocket:remaining"),
        ("axis" = inline(Option<Axis>), Query, description = "The axis that the plane is at right angles to; `z` if left out"),
        ("at" = f64, Query, description = "Where the plane meets the axis, in user units", example = 1.5),
    ),
    responses((status = 200, description = "The regions", body = Overlay))
)]
pub(super) async fn get_overlay(
    State(app): State<App>,
    Extension(ticket): Extension<Ticket>,
    parameters: Parameters,
) -> Result<Json<Overlay>, Problem> {
    let query = parameters.only(&["a", "b", "axis", "at"])?;
    let axis = Axis::of(&query)?;
    let at = needed(&query, "at")?;
    let [(a, a_part), (b, b_part)] = [named(&query, "a")?, named(&query, "b")?];
    for scene in [a, b] {
        if !ticket.may_read(scene) {
            let detail = format!("the key has not the right read on scene {scene:?}");
            return Err(Problem::new(Code::Forbidden, detail));
        }
    }
    let first = layer(&app, ("a", a), (axis, a_part), at).await?;
    let second = layer(&app, ("b", b), (axis, b_part), at).await?;
    if first.unit != second.unit {
        let detail = format!(
            "its user unit is {:?}, that of {a:?} is {:?}",
            second.unit, first.unit
        );
        return Err(Fault::in_parameter("b", detail, b).into());
    }
    // In the finer of the two scales.
    let scale = first.scale.max(second.scale);
    let over = move |_: &dyn Fn() -> bool| {
        let in_scale = |layer: &Layer| layer.slice.scaled(scale, layer.scale);
        let over = || Ok(in_scale(&first)?.over(&in_scale(&second)?));
        Some((over(), [first.seq, second.seq]))
    };
    let (overlaid, [a_seq, b_seq]) = cancellable(over).await;
    let overlaid = overlaid
        .map_err(|error: TooFar| Problem::from(Fault::in_parameter("b", error.to_string(), b)))?;
    let Overlaid {
        first,
        second,
        both,
    } = overlaid;
    let regions = [
        (vec!["a"], first),
        (vec!["b"], second),
        (vec!["a", "b"], both),
    ];
    let regions = regions
        .into_iter()
        .filter(|(_, slice)| !slice.shapes.is_empty());
    let regions = regions.map(|(names, slice)| {
        let (area, perimeter) = measured(&slice, scale);
        OverlayRegion {
            r#in: names,
            area,
            perimeter,
            polygons: PolygonDocument::all(&slice, scale),
        }
    });
    let part = |scene: &str, part, seq: Seq| OverlaidPart {
        scene: scene.to_owned(),
        part,
        seq: seq.0,
    };
    Ok(Json(Overlay {
        a: part(a, a_part, a_seq),
        b: part(b, b_part, b_seq),
        axis,
        at,
        regions: regions.collect(),
    }))
}

/// The scene and the part that a parameter names.
fn named<'a>(query: &'a Known, parameter: &'static str) -> Result<(&'a str, Part), Problem> {
    let Some(text) = query.text(parameter) else {
        let detail = "is missing: SCENE, or SCENE:part";
        return Err(Fault::in_parameter(parameter, detail, "").into());
    };
    match text.split_once(':') {
        None => Ok((text, Part::Union)),
        Some((scene, part)) => Ok((scene, Part::of(parameter, Some(part))?)),
    }
}

/// One of two slices that are laid over each other.
struct Layer {
    slice: Slice,
    seq: Seq,
    scale: u32,
    unit: String,
}

async fn layer(
    app: &App,
    (parameter, scene): (&'static str, &str),
    (axis, part): (Axis, Part),
    at: f64,
) -> Result<Layer, Problem> {
    let what = (parameter, axis, part);
    match scenes::open_any(app, scene)? {
        Opened::Cubes(scene, settings) => layer_of(&scene, settings, what, at).await,
        Opened::Solids(scene, settings) => layer_of(&scene, settings, what, at).await,
    }
}

async fn layer_of<K: SlicedKind>(
    scene: &Arc<SceneOf<K>>,
    settings: Arc<K::Settings>,
    what: (&'static str, Axis, Part),
    at: f64,
) -> Result<Layer, Problem> {
    let (scale, unit) = (K::steps_per_unit(&settings), K::unit(&settings).to_owned());
    let level = level(at, scale);
    let (seq, mut stack) = stack(scene, settings, what, &[level]).await?;
    let region = what.2.region();
    let slice =
        cancellable(move |goes_on: &dyn Fn() -> bool| stack.slice(level, region, goes_on)).await;
    Ok(Layer {
        slice,
        seq,
        scale,
        unit,
    })
}
