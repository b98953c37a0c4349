//! Which bodies a measurement sends, in which scene, and what they come to.

use bytes::Bytes;
use serde_json::{Value, json};
use union3d::engine::recount;
use union3d::engine::solids::{Effect, Engine, SolidId, Stock};
use union3d::geometry::convex::{Point, Solid};
use union3d::geometry::{Bounds, Edge, Place};

use super::args::Args;
use super::bodies::{self, Body, EDGE, Kind, SHAPE, Side};
use crate::failure::Failure;
use crate::milling::{STEPS_PER_MM, Sweep, Tool, block, program, raster, swept};
use crate::random::Random;

/// How long the moves of the raster are. Units: mm.
const RASTER_MOVE: f64 = 0.5;

/// How far the tool of a program reaches above the block. Units: mm.
const ABOVE: f64 = 2.0;

/// What is sent.
pub(super) enum Work {
    Cubes,
    /// A square, as large as it takes.
    Raster(Tool),
    /// A program, milled from a block with a tool of this diameter in mm.
    Program(f64, Vec<Sweep>),
}

/// Bodies in the order in which they come, with ids from 1 on, and the scene that they come to.
pub(super) struct ToolPath {
    tool: Tool,
    stock: Option<Bounds>,
    sweeps: Vec<Sweep>,
}

impl Work {
    pub(super) fn new(args: &Args) -> Result<Self, Failure> {
        match (&args.program, args.kind) {
            (Some(path), _) => Ok(Self::Program(args.diameter, program(path)?)),
            (None, Kind::Solids) => Ok(Self::Raster(Tool::BALL)),
            (None, Kind::Cubes) => Ok(Self::Cubes),
        }
    }

    /// What is sent when it is solids, so many at most. A program is sent once.
    pub(super) fn path(&self, solids_max: usize) -> Result<Option<ToolPath>, Failure> {
        match self {
            Self::Cubes => Ok(None),
            Self::Raster(tool) => Ok(Some(ToolPath {
                tool: *tool,
                stock: None,
                sweeps: raster(solids_max, tool.diameter, RASTER_MOVE)?,
            })),
            Self::Program(diameter, sweeps) => {
                ToolPath::of_program(*diameter, sweeps.clone()).map(Some)
            }
        }
    }

    /// So many solids: a program is repeated below itself until there are as many.
    pub(super) fn long_path(&self, solids: usize) -> Result<Option<ToolPath>, Failure> {
        let Self::Program(diameter, sweeps) = self else {
            return self.path(solids);
        };
        let depth = i64::from(block(sweeps, *diameter)?.min[2]);
        let copies = (0..).flat_map(|copy| {
            let by = [0, 0, copy * depth];
            sweeps
                .iter()
                .map(move |sweep| sweep.map(|end| end.displaced(by)))
        });
        let below = |[from, to]: [Result<Point, _>; 2]| Ok([from?, to?]);
        let sweeps: Result<_, Failure> = copies.take(solids).map(below).collect();
        ToolPath::of_program(*diameter, sweeps?).map(Some)
    }
}

impl ToolPath {
    /// A program with its block and a tool that reaches out of it.
    fn of_program(diameter: f64, sweeps: Vec<Sweep>) -> Result<Self, Failure> {
        let stock = block(&sweeps, diameter)?;
        let depth = f64::from(-stock.min[2]) / f64::from(STEPS_PER_MM);
        Ok(Self {
            tool: Tool {
                diameter,
                length: depth + ABOVE,
                ..Tool::FLAT
            },
            stock: Some(stock),
            sweeps,
        })
    }

    /// The settings of the scene.
    pub(super) fn settings(&self) -> Bytes {
        let mm = |at: [i32; 3]| at.map(|steps| f64::from(steps) / f64::from(STEPS_PER_MM));
        let mut settings = json!({
            "kind": "solids", "steps_per_unit": STEPS_PER_MM, "shapes": {SHAPE: self.tool.document()},
        });
        if let Some(Bounds { min, max }) = self.stock {
            settings["stock"] = json!({"min": mm(min), "max": mm(max)});
        }
        settings.to_string().into()
    }

    pub(super) fn bodies(&self) -> Vec<Body> {
        let numbered = (1..).zip(&self.sweeps);
        let body = |(id, [from, to]): (u64, &Sweep)| Body {
            id,
            at: from.coordinates(),
            to: Some(to.coordinates()),
        };
        numbered.map(body).collect()
    }

    /// What a server must say of them all: here they are one batch in this process.
    pub(super) fn expected(&self) -> Result<Expected, Failure> {
        let mut engine = Engine::new();
        if let Some(Bounds { min, max }) = self.stock {
            let [min, max] = [min, max].map(|corner| Point::new(corner.map(i64::from)));
            engine = engine.with_stock(Some(Stock::new(Solid::cuboid(min?, max?)?)?));
        }
        let bodies = swept(&self.tool.shape()?, &self.sweeps)?;
        engine.apply(&Effect {
            deleted: Vec::new(),
            inserted: (1..).map(SolidId).zip(bodies).collect(),
        })?;
        let totals = engine.totals();
        let [convex, concave, crossing] = totals
            .measures
            .edge_length2
            .map(|length| length.to_string());
        let exact = [
            ("/volume/value", json!(totals.measures.volume6.to_string())),
            ("/area/value", json!(totals.measures.area2.to_string())),
            ("/edge_length/value", json!([convex, concave, crossing])),
        ];
        Ok(Expected {
            kind: Kind::Solids,
            count: totals.solids,
            exact: exact.into(),
        })
    }
}

/// The settings of every scene of cubes.
pub(super) fn settings_of_cubes() -> Bytes {
    let steps_per_unit = Kind::Cubes.steps_per_unit();
    json!({"edge": EDGE, "steps_per_unit": steps_per_unit})
        .to_string()
        .into()
}

/// What the mass properties of a scene must be.
pub(super) struct Expected {
    kind: Kind,
    count: u64,
    /// Where in the exact measures which value is.
    exact: Vec<(&'static str, Value)>,
}

impl Expected {
    /// Of cubes: recounted.
    pub(super) fn of_cubes(cubes: &[Body]) -> Result<Self, Failure> {
        let edge = i64::from(EDGE) * i64::from(Kind::Cubes.steps_per_unit());
        let edge = Edge::new(edge)?;
        let place = |cube: &Body| Place::new(cube.at.map(i64::from), edge);
        let places: Vec<Place> = cubes.iter().map(place).collect::<Result<_, _>>()?;
        let totals = recount(edge, None, places.into_iter());
        let exact = [
            ("/volume", json!(totals.measures.volume.to_string())),
            ("/area", json!(totals.measures.area().to_string())),
        ];
        Ok(Self {
            kind: Kind::Cubes,
            count: totals.cubes,
            exact: exact.into(),
        })
    }

    /// Whether these are they.
    pub(super) fn is(&self, mass_properties: &Value) -> bool {
        let exact = &mass_properties["exact"];
        let mut values = self.exact.iter();
        mass_properties[self.kind.plural()] == self.count
            && values.all(|(pointer, value)| exact.pointer(pointer) == Some(value))
    }
}

/// Random cubes by changes, without end.
pub(super) fn random_cubes(batch: usize, seed: u64) -> impl Iterator<Item = Vec<Body>> {
    let mut random = Random::new(seed);
    (0..).map(move |number: u64| {
        let first = number * batch as u64 + 1;
        bodies::cubes(first, batch, Side::OF_A_MILLION, &mut random)
    })
}
