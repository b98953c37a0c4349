//! The boundary of a scene as a mesh.

use std::io;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use headers::{ContentLength, HeaderMapExt, IfNoneMatch};
use tokio::sync::Semaphore;
use tokio_util::io::ReaderStream;

use super::reads::{NO_CACHE, entity_tag};
use super::request::{Known, Parameters, Path, Room};
use super::{App, scenes};
use crate::boundary::mesh_file::{Format, MeshError, MeshWriter};
use crate::boundary::{FaceSink, NoStock, Region, cubes, solids};
use crate::geometry::{Bounds, COORDINATE_MAX, CubeId, Place};
use crate::service::{SceneKind, SceneOf, ServiceError};
use crate::wire::kind::Opened;
use crate::wire::problem::{Fault, Problem};

/// Bytes of the file that are read at once.
const PIECE_BYTES: usize = 64 << 10;

/// Bodies that are read between two changes.
const BODIES_AT_ONCE: usize = 4_096;

/// Meshes that are made at a time, each on a thread of its own; others wait.
static MAKING: Semaphore = Semaphore::const_new(4);

/// Faces that are written between two looks at how much of the disk is free.
const FACES_BETWEEN_LOOKS: u64 = 1_024;

/// What a body takes of memory while a mesh is made, in bytes.
const BODY_BYTES: u64 = 128;

/// What is said of `part`.
const ABOUT_PART: &str = "`union`, or of a scene with a stock `removed` or `remaining`, which is meant there when it is left out";

/// What is said of `box`.
const ABOUT_BOX: &str = "`x0,y0,z0,x1,y1,z1` in user units, rounded to the lattice: what lies in it, and up to half a step outside, exactly cut there and \
    open. Boxes from 0 to 9 steps and from 10 to 19 share out every face";

/// Get a mesh
///
/// The boundary as triangles, counterclockwise as seen from outside, exact as far as the format's numbers are: 64 bits in PLY, text in OBJ
/// and 3MF, 32 bits in STL and GLB. Every edge is used as often in one direction as in the other: twice, or four times and more where the
/// union touches itself. In user units, as of one seq, which the entity tag names, while changes go on. Until it is sent it takes its
/// size in the data directory.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/mesh", tag = "mass properties",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("part" = Option<String>, Query, pattern = "^(union|removed|remaining)$", description = ABOUT_PART, example = "union"),
        ("box" = Option<String>, Query, pattern = r"^-?[0-9]{1,9}(\.[0-9]{1,9})?(,-?[0-9]{1,9}(\.[0-9]{1,9})?){5}$", description = ABOUT_BOX, example = "0,0,0,10,10,10"),
        ("at-most" = Option<u64>, Query, description = "A mesh of more triangles is refused", example = 1_000_000),
        ("If-None-Match" = Option<String>, Header, description = "A tag of an earlier answer: nothing is made while nothing has changed"),
        ("format" = Option<String>, Query, pattern = "^(stl|ply|obj|3mf|glb)$", description = "`stl` if left out", example = "ply"),
    ),
    responses(
        (status = 200, description = "The mesh", content(
            (Vec<u8> = "model/stl"), (Vec<u8> = "application/ply"), (String = "model/obj"), (Vec<u8> = "model/3mf"), (Vec<u8> = "model/gltf-binary"),
        )),
        (status = 304, description = "It is that of `If-None-Match`"),
    )
)]
pub(super) async fn get_mesh(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
    headers: HeaderMap,
    room: Room,
) -> Result<Response, Problem> {
    let query = parameters.only(&["part", "box", "at-most", "format"])?;
    let wanted = Wanted::of(&query)?;
    match scenes::open_any(&app, &name)? {
        Opened::Cubes(scene, settings) => {
            let (edge, stock) = (settings.edge(), settings.stock());
            let region = wanted.region(stock.is_some())?;
            let within = wanted.within(|at| {
                settings
                    .point(at)
                    .map_err(|(axis, invalid)| format!("{}: {invalid}", ["x", "y", "z"][axis]))
            })?;
            let units = (settings.steps_per_unit(), settings.unit().to_owned());
            let is_near = move |bounds: &Bounds, place: &Place| {
                let low = place.corner();
                let high = low.map(|low| low + edge.steps());
                overlaps(
                    bounds,
                    &Bounds {
                        min: low,
                        max: high,
                    },
                )
            };
            let list = move |bodies: Vec<_>, goes_on: &dyn Fn() -> bool, sink: &mut FaceSink| {
                let bodies = bodies.into_iter();
                cubes::faces(bodies, edge, stock, region, within, goes_on, sink)
            };
            let work = Work {
                units,
                within,
                is_near,
                list,
            };
            answer(scene, wanted, (&headers, room), work).await
        }
        Opened::Solids(scene, settings) => {
            let stock = scene.stock();
            let region = wanted.region(stock.is_some())?;
            let scale = settings.scale();
            // No solid is farther out.
            let farthest = f64::from(COORDINATE_MAX) / f64::from(scale.steps_per_unit());
            let within = wanted.within(|at| {
                let at = at.map(|coordinate| coordinate.clamp(-farthest, farthest));
                let point = scale.point(at, "").map_err(|fault| fault.to_string())?;
                Ok(point.coordinates())
            })?;
            let units = (scale.steps_per_unit(), settings.unit().to_owned());
            let is_near = |bounds: &Bounds, body: &crate::engine::solids::Body| {
                overlaps(bounds, &body.bounds())
            };
            let list = move |bodies: Vec<_>, goes_on: &dyn Fn() -> bool, sink: &mut FaceSink| {
                let (bodies, stock) = (bodies.into_iter(), stock.as_ref());
                solids::faces(bodies, stock, region, within, goes_on, sink)
            };
            let work = Work {
                units,
                within,
                is_near,
                list,
            };
            answer(scene, wanted, (&headers, room), work).await
        }
    }
}

/// Whether two closed boxes have a point in common, or nearly so.
fn overlaps(one: &Bounds, other: &Bounds) -> bool {
    (0..3).all(|axis| {
        one.min[axis] <= other.max[axis].saturating_add(1)
            && other.min[axis] <= one.max[axis].saturating_add(1)
    })
}

/// What the query asks for.
struct Wanted<'q> {
    region: Option<(Region, &'q str)>,
    /// Its numbers, and the text that they stand in.
    within: Option<([f64; 6], &'q str)>,
    triangles_max: Option<u64>,
    format: Format,
}

impl<'q> Wanted<'q> {
    fn of(query: &'q Known) -> Result<Self, Problem> {
        let refuse = |name: &'static str, detail: &'static str, text: &str| {
            Problem::from(Fault::in_parameter(name, detail, text))
        };
        let region = match query.text("part") {
            None => None,
            Some(text @ "union") => Some((Region::Union, text)),
            Some(text @ "removed") => Some((Region::Removed, text)),
            Some(text @ "remaining") => Some((Region::Remaining, text)),
            Some(other) => {
                let detail = "is none of \"union\", \"removed\" and \"remaining\"";
                return Err(refuse("part", detail, other));
            }
        };
        let within = query.text("box").map(|text| {
            let numbers = text.split(',').map(|number| number.trim().parse().ok());
            let numbers: Option<Vec<f64>> = numbers.collect();
            let numbers = numbers.and_then(|numbers| <[f64; 6]>::try_from(numbers).ok());
            let numbers = numbers.filter(|numbers| numbers.iter().all(|number| number.is_finite()));
            let detail = "is not x0,y0,z0,x1,y1,z1: six numbers";
            numbers
                .map(|numbers| (numbers, text))
                .ok_or_else(|| refuse("box", detail, text))
        });
        let format = query.text("format").unwrap_or(Format::Stl.name());
        let detail = "is none of \"stl\", \"ply\", \"obj\", \"3mf\" and \"glb\"";
        Ok(Self {
            region,
            within: within.transpose()?,
            triangles_max: query.number("at-most")?,
            format: Format::named(format).ok_or_else(|| refuse("format", detail, format))?,
        })
    }

    /// What of the scene is meant.
    fn region(&self, has_stock: bool) -> Result<Region, Problem> {
        match self.region {
            None if has_stock => Ok(Region::Remaining),
            None => Ok(Region::Union),
            Some((Region::Removed | Region::Remaining, text)) if !has_stock => {
                Err(Fault::in_parameter("part", NoStock.to_string(), text).into())
            }
            Some((region, _)) => Ok(region),
        }
    }

    /// The box in steps, its corners rounded by `corner`.
    fn within(
        &self,
        corner: impl Fn([f64; 3]) -> Result<[i32; 3], String>,
    ) -> Result<Option<Bounds>, Problem> {
        let Some(([x0, y0, z0, x1, y1, z1], text)) = self.within else {
            return Ok(None);
        };
        let corner = |at| {
            corner(at).map_err(|detail| Problem::from(Fault::in_parameter("box", detail, text)))
        };
        let (min, max) = (corner([x0, y0, z0])?, corner([x1, y1, z1])?);
        if (0..3).any(|axis| min[axis] > max[axis]) {
            let detail = "ends before it begins: the first three numbers are its least corner";
            return Err(Fault::in_parameter("box", detail, text).into());
        }
        Ok(Some(Bounds { min, max }))
    }
}

/// What is done with the bodies of a kind.
struct Work<N, L> {
    /// Steps in a user unit, and its label.
    units: (u32, String),
    within: Option<Bounds>,
    /// Whether a body is near a box.
    is_near: N,
    /// Lists the faces.
    list: L,
}

/// Set when nobody waits any more.
struct Cancelling(Arc<AtomicBool>);

impl Drop for Cancelling {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

async fn answer<K, N, L>(
    scene: Arc<SceneOf<K>>,
    wanted: Wanted<'_>,
    (headers, mut room): (&HeaderMap, Room),
    work: Work<N, L>,
) -> Result<Response, Problem>
where
    K: SceneKind,
    N: Fn(&Bounds, &K::Body) -> bool,
    L: FnOnce(
            Vec<(CubeId, K::Body)>,
            &dyn Fn() -> bool,
            &mut FaceSink,
        ) -> Result<ControlFlow<()>, NoStock>
        + Send
        + 'static,
{
    let Work {
        units,
        within,
        is_near,
        list,
    } = work;
    let Wanted {
        triangles_max,
        format,
        ..
    } = wanted;
    let turn = MAKING.acquire().await.expect("it is never closed");
    let mut reading = scene.read_all().await?;
    let tag = entity_tag(&scene, reading.seq());
    let known: Option<IfNoneMatch> = headers.typed_get();
    let mut headers = HeaderMap::new();
    headers.typed_insert(tag.clone());
    headers.insert(header::CACHE_CONTROL, NO_CACHE);
    if known.is_some_and(|known| !known.precondition_passes(&tag)) {
        return Ok((StatusCode::NOT_MODIFIED, headers).into_response());
    }
    let mut bodies = Vec::new();
    loop {
        let mut next = reading.next(BODIES_AT_ONCE).await?;
        if next.is_empty() {
            break;
        }
        if let Some(within) = &within {
            next.retain(|(_, body)| is_near(within, body));
        }
        room.take(next.len() as u64 * BODY_BYTES)?;
        bodies.append(&mut next);
    }
    drop(reading);
    let cancelled = Arc::new(AtomicBool::new(false));
    let _cancelling = Cancelling(cancelled.clone());
    let place = scene.clone();
    let writing = move || {
        let goes_on = || !cancelled.load(Ordering::Relaxed);
        let scratch = || place.scratch();
        let scale = (f64::from(units.0), units.1.as_str());
        let mut writer = MeshWriter::new(format, scale, triangles_max, &scratch)?;
        let (mut written, mut faces) = (Ok(()), 0_u64);
        let listed = list(bodies, &goes_on, &mut |face| {
            written = writer.write(face);
            faces += 1;
            if written.is_ok() && faces.is_multiple_of(FACES_BETWEEN_LOOKS) {
                written = place.check_space().map_err(MeshError::from);
            }
            match written {
                Ok(()) if goes_on() => ControlFlow::Continue(()),
                _ => ControlFlow::Break(()),
            }
        });
        let flow = listed.expect("the stock is there, or none is asked for");
        written?;
        match flow {
            ControlFlow::Continue(()) => writer.finish(),
            ControlFlow::Break(()) => Err(io::Error::from(io::ErrorKind::Interrupted).into()),
        }
    };
    let made = tokio::task::spawn_blocking(move || {
        let written = writing();
        drop((room, turn));
        written
    });
    let (file, size, _) = match made.await {
        Ok(Ok(made)) => made,
        Ok(Err(MeshError::TooMany { triangles_max })) => {
            let detail = format!(
                "is fewer than the mesh has, which is more than {triangles_max} triangles; ask for a smaller box"
            );
            let value = wanted.triangles_max.unwrap_or(triangles_max).to_string();
            return Err(Fault::in_parameter("at-most", detail, &value).into());
        }
        Ok(Err(MeshError::Io(error))) => return Err(ServiceError::of_storage(&error).into()),
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(_) => return Err(Problem::from(ServiceError::ShuttingDown)),
        },
    };
    headers.insert(
        header::CONTENT_TYPE,
        HeaderValue::from_static(format.media_type()),
    );
    let name = scene.name().as_str();
    let name = format!("attachment; filename=\"{name}.{}\"", format.name());
    let name = HeaderValue::from_str(&name).expect("a scene's name is plain");
    headers.insert(header::CONTENT_DISPOSITION, name);
    headers.typed_insert(ContentLength(size));
    let file = tokio::fs::File::from_std(file);
    let pieces = ReaderStream::with_capacity(file, PIECE_BYTES);
    Ok((headers, Body::from_stream(pieces)).into_response())
}
