//! `union3d measure --kind solids`: mass properties of files of solids.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::stock::StockForm;
use super::{Outcome, input, progress, report};
use union3d::engine::solids::{Body, Engine, Op, Rejected, SolidId};
use union3d::geometry::convex::Deviation;
use union3d::wire::solids::{
    self, ReadStock, Scale, ShapeDocument, Shapes, SolidDocument, SolidFault,
    solid_scene_properties, stl_body,
};

/// Operations judged and applied together.
const BATCH_OPERATIONS: usize = 4_096;

/// Longest line of text: a hull of 4,096 points takes about 250,000 bytes.
const LINE_BYTES_MAX: u64 = 4 << 20;

/// Largest STL file: a convex body of 4,096 vertices takes 410,000 bytes in binary and about 2,500,000 as a text.
const STL_BYTES_MAX: u64 = 256 << 20;

type Failure = Box<dyn std::error::Error>;

/// What is asked for.
pub(crate) struct Request<'a> {
    /// The files; each is STL or NDJSON.
    pub(crate) files: Vec<(PathBuf, Format)>,
    pub(crate) steps_per_unit: u32,
    /// The material that they are cut to.
    pub(crate) stock: Option<&'a StockForm>,
    /// Print the object of mass properties alone.
    pub(crate) json: bool,
}

/// What a file of solids is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Format {
    /// One convex body.
    Stl,
    /// A JSON object a line.
    Ndjson,
}

/// Measures the union of all solids of all files.
pub(crate) fn measure(request: &Request<'_>) -> Outcome {
    let scale = Scale::new(request.steps_per_unit)
        .map_err(|invalid| format!("--steps-per-unit: {invalid}"))?;
    let stock = request.stock.map(|form| form.read(scale)).transpose()?;
    let mut scene = Scene::new(scale, stock);
    for (file, format) in &request.files {
        let (source, size) = input::open(file)?;
        let bar = progress::bytes(size);
        let source = BufReader::new(bar.wrap_read(source));
        let read = match format {
            Format::Stl => read_stl(source, &mut scene),
            Format::Ndjson => read_ndjson(source, &mut scene),
        };
        let read = read.and_then(|()| scene.apply());
        bar.finish_and_clear();
        read.map_err(|failure| about(file, &*failure))?;
    }
    let totals = (&scene.engine.totals(), &scene.engine.error_max());
    let properties = solid_scene_properties(None, None, totals, scale, 1.0);
    let mut output = std::io::stdout().lock();
    if request.json {
        writeln!(output, "{}", serde_json::to_string(&properties)?)?;
    } else {
        let properties = serde_json::to_value(&properties)?;
        let table = report::table(&properties, "unit");
        write!(output, "{table}{}", report::parts(&properties, "unit"))?;
        if scene.deviation != Deviation::default() {
            let [outside, inside] = [scene.deviation.outside, scene.deviation.inside]
                .map(|length| report::figure(&scale.deviation(length).into()));
            writeln!(
                output,
                "{:<22}their polygons reach at most {outside} unit out of round cutters, which reach at most {inside} unit out of them",
                "cutters"
            )?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn about(file: &Path, failure: &dyn std::error::Error) -> String {
    format!("{}: {failure}", file.display())
}

/// The solids read so far, and the operations not applied yet.
struct Scene {
    scale: Scale,
    shapes: Shapes,
    /// The greatest of the stock and all shapes.
    deviation: Deviation,
    engine: Engine,
    waiting: Vec<Op>,
    /// The line of each waiting operation, for errors; 1 for an STL file.
    lines: Vec<u64>,
    /// Whether the first solid had an id; all must do the same.
    ids: Option<bool>,
    next_id: u64,
}

impl Scene {
    fn new(scale: Scale, stock: Option<ReadStock>) -> Self {
        let deviation = stock.as_ref().map(|read| read.deviation);
        let engine = Engine::new().with_stock(stock.map(|read| read.stock));
        Self {
            scale,
            shapes: Shapes::new(),
            deviation: deviation.unwrap_or_default(),
            engine,
            waiting: Vec::new(),
            lines: Vec::new(),
            ids: None,
            next_id: 1,
        }
    }

    fn add_shape(&mut self, name: String, document: &ShapeDocument) -> Result<(), String> {
        let place = |fault: SolidFault| fault.within(&format!("/shapes/{name}")).to_string();
        let read = solids::shape(document, self.scale).map_err(place)?;
        if self.shapes.contains_key(&name) {
            return Err(format!(
                "/shapes/{name} is there already, and a shape never changes"
            ));
        }
        self.deviation = self.deviation.max(read.deviation);
        self.shapes.insert(name, read.shape.into());
        Ok(())
    }

    /// The insertion of a body; without ids every body is a solid.
    fn insertion(&mut self, id: Option<u64>, body: Body) -> Result<Op, String> {
        if *self.ids.get_or_insert(id.is_some()) != id.is_some() {
            let here = if id.is_some() { "one" } else { "none" };
            return Err(format!(
                "either every solid has an id, or none; there is {here} here, and the body of an STL file has none"
            ));
        }
        let id = SolidId(id.unwrap_or(self.next_id));
        self.next_id += 1;
        Ok(Op::Insert(id, body))
    }

    fn push(&mut self, line: u64, op: Op) -> Result<(), Failure> {
        self.waiting.push(op);
        self.lines.push(line);
        if self.waiting.len() == BATCH_OPERATIONS {
            self.apply()?;
        }
        Ok(())
    }

    fn apply(&mut self) -> Result<(), Failure> {
        let judged = self.engine.judge(&self.waiting).map_err(|rejected| match rejected {
            Rejected::IdConflict { index, id } => format!(
                "line {}: id {} is there already, with another body: give every solid an id of its own",
                self.lines[index], id.0
            ),
            Rejected::TooManySolids { .. } => rejected.to_string(),
        })?;
        self.engine.apply(&judged.effect)?;
        self.waiting.clear();
        self.lines.clear();
        Ok(())
    }
}

fn read_stl(source: impl Read, scene: &mut Scene) -> Result<(), Failure> {
    let mut file = Vec::new();
    source.take(STL_BYTES_MAX + 1).read_to_end(&mut file)?;
    if file.len() as u64 > STL_BYTES_MAX {
        return Err(format!("it is longer than {STL_BYTES_MAX} bytes").into());
    }
    let body = stl_body(file, scene.scale)?;
    let insertion = scene.insertion(None, body)?;
    scene.push(1, insertion)
}

/// Shapes by their names.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ShapesLine {
    shapes: std::collections::BTreeMap<String, ShapeDocument>,
}

/// A line of a stream of changes.
#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum Change {
    Insert(SolidDocument),
    Delete(u64),
}

fn read_ndjson(source: impl BufRead, scene: &mut Scene) -> Result<(), Failure> {
    input::each_line(source, LINE_BYTES_MAX, |line, json| {
        let op = read_line(json, scene)
            .map_err(|failure| format!("line {line}: {failure}: {}", input::excerpt(json)))?;
        op.map_or(Ok(()), |op| scene.push(line, op))
    })
}

/// Takes the shapes of a line, or says what its operation is.
fn read_line(json: &[u8], scene: &mut Scene) -> Result<Option<Op>, Failure> {
    let value: Value = serde_json::from_slice(json)?;
    if value.get("shapes").is_some() {
        let ShapesLine { shapes } = document(value)?;
        for (name, shape) in shapes {
            scene.add_shape(name, &shape)?;
        }
        return Ok(None);
    }
    let change = if value.get("insert").is_some() || value.get("delete").is_some() {
        document(value)?
    } else {
        Change::Insert(document(value)?)
    };
    Ok(Some(match change {
        Change::Insert(solid) => {
            let body = solids::body(&solid, &scene.shapes, scene.scale)?;
            scene.insertion(solid.id.map(|id| id.id.0), body)?
        }
        Change::Delete(id) => Op::Delete(SolidId(id)),
    }))
}

/// A document, or what is wrong with it and where.
fn document<T: DeserializeOwned>(value: Value) -> Result<T, String> {
    serde_path_to_error::deserialize(value).map_err(|error| {
        let place = error.path().to_string();
        match place.as_str() {
            "." => error.into_inner().to_string(),
            _ => format!("{place}: {}", error.into_inner()),
        }
    })
}
