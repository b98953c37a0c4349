//! `union3d-bench peers`: our side of a comparison with another program on the same cubes or solids.

use std::path::PathBuf;
use std::time::Instant;

use serde::Serialize;
use union3d::engine;
use union3d::engine::solids::{self, AREA_UNIT, Body, VOLUME_UNIT};
use union3d::geometry::{self, CubeId, Edge, Effect, Place};

use super::cubes;
use super::failure::Failure;
use super::figures::{float_of_wide, median, parse_count};
use super::hulls;
use super::sets::each;

/// Bodies that are inserted once more, one after the other, each into the same set.
const SINGLE_INSERTS: usize = 1_000;

/// Measure a file of cubes or solids for a comparison with other programs, as JSON
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Measures the cubes or solids of a file and prints one JSON object, for a script that gives the same file to another program: \
tests/bench/peers does so with Manifold.

`batch_seconds`: all but the last, in one change. `insert_seconds`: the last one more, then deleted again, 1,000 times. `inserts_seconds`: all, \
one after the other; `deletes_seconds`: all of them deleted again so, in the same order. Medians; no start of a process and no reading is in \
them. `volume` and `area` (in steps) are those of all."
)]
#[command(group = clap::ArgGroup::new("file").required(true))]
pub(crate) struct Args {
    /// Lower corners of cubes in steps, as little-endian 32-bit triplets; at least two.
    #[arg(long, value_name = "FILE", group = "file", requires = "edge")]
    cubes: Option<PathBuf>,
    /// Edge of every cube, in steps.
    #[arg(long, value_name = "STEPS", conflicts_with = "solids")]
    edge: Option<i64>,
    /// Solids as `union3d-bench hulls` prints them; at least two.
    #[arg(long, value_name = "FILE", group = "file")]
    solids: Option<PathBuf>,
    /// How often the batch is measured, and all of them one after the other.
    #[arg(long, value_name = "COUNT", default_value = "5", value_parser = parse_count)]
    runs: usize,
}

#[derive(Serialize)]
struct Answer {
    bodies: usize,
    batch_seconds: f64,
    insert_seconds: f64,
    inserts_seconds: f64,
    deletes_seconds: f64,
    volume: f64,
    area: f64,
}

/// An engine of cubes or of solids.
trait Engine {
    type Body: Clone;
    type Totals: PartialEq;
    /// False when what is deleted is not there, or what is inserted is.
    fn apply(&mut self, effect: &Effect<Self::Body>) -> bool;
    fn totals(&self) -> Self::Totals;
    /// Volume and area, in steps.
    fn measures(totals: &Self::Totals) -> [f64; 2];
}

impl Engine for engine::Engine {
    type Body = Place;
    type Totals = geometry::Totals;

    fn apply(&mut self, effect: &Effect) -> bool {
        Self::apply(self, effect).is_ok()
    }

    fn totals(&self) -> geometry::Totals {
        Self::totals(self)
    }

    fn measures(totals: &geometry::Totals) -> [f64; 2] {
        let measures = totals.measures;
        [measures.volume, measures.area()].map(float_of_wide)
    }
}

impl Engine for solids::Engine {
    type Body = Body;
    type Totals = solids::Totals;

    fn apply(&mut self, effect: &Effect<Body>) -> bool {
        Self::apply(self, effect).is_ok()
    }

    fn totals(&self) -> solids::Totals {
        Self::totals(self)
    }

    fn measures(totals: &solids::Totals) -> [f64; 2] {
        let measures = totals.measures;
        [
            float_of_wide(measures.volume6) / 6.0 * f64::from(VOLUME_UNIT).exp2(),
            float_of_wide(measures.area2) / 2.0 * f64::from(AREA_UNIT).exp2(),
        ]
    }
}

/// Runs `union3d-bench peers`.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let answer = match (&args.cubes, args.edge, &args.solids) {
        (Some(path), Some(edge), _) => {
            let edge = Edge::new(edge)?;
            measure(
                || engine::Engine::new(edge),
                cubes::read(path, edge)?,
                args.runs,
            )?
        }
        (_, _, Some(path)) => measure(solids::Engine::new, hulls::read(path)?, args.runs)?,
        _ => return Err("no file is given".into()),
    };
    println!("{}", serde_json::to_string(&answer)?);
    Ok(())
}

fn measure<E: Engine>(
    new: impl Fn() -> E,
    bodies: Vec<E::Body>,
    runs: usize,
) -> Result<Answer, Failure> {
    let apply = |engine: &mut E, effect: &Effect<E::Body>| {
        let fits = engine.apply(effect);
        assert!(
            fits,
            "what is deleted is there, and what is inserted is not"
        );
    };
    let all: Vec<_> = (0..).map(CubeId).zip(bodies).collect();
    let Some((last, batch)) = all.split_last().filter(|(_, batch)| !batch.is_empty()) else {
        return Err("one body is too few".into());
    };
    let inserting = |inserted: &[(CubeId, E::Body)]| Effect {
        deleted: Vec::new(),
        inserted: inserted.to_vec(),
    };
    let deleting = |deleted: &[(CubeId, E::Body)]| Effect {
        deleted: deleted.to_vec(),
        inserted: Vec::new(),
    };

    let (mut engine, effect) = (new(), inserting(batch));
    let mut batches = Vec::new();
    for _ in 0..runs {
        engine = new();
        let started = Instant::now();
        apply(&mut engine, &effect);
        batches.push(started.elapsed().as_secs_f64());
    }
    let before = engine.totals();
    let mut inserts = Vec::new();
    for id in (last.0.0..).map(CubeId).take(SINGLE_INSERTS) {
        let one = [(id, last.1.clone())];
        let (insert, delete) = (inserting(&one), deleting(&one));
        let (_, time) = each([&insert].into_iter(), |insert| apply(&mut engine, insert));
        inserts.push(time.as_secs_f64());
        apply(&mut engine, &delete);
    }
    if engine.totals() != before {
        return Err("inserting and deleting a body has changed the totals".into());
    }
    apply(&mut engine, &inserting(std::slice::from_ref(last)));
    let totals = engine.totals();

    let each_of_them = all.chunks(1);
    let insertions: Vec<_> = each_of_them.clone().map(inserting).collect();
    let deletions: Vec<_> = each_of_them.map(deleting).collect();
    let (mut all_inserts, mut all_deletes) = (Vec::new(), Vec::new());
    for _ in 0..runs {
        let mut engine = new();
        let nothing = engine.totals();
        let (_, time) = each(insertions.iter(), |effect| apply(&mut engine, effect));
        all_inserts.push(time.as_secs_f64());
        if engine.totals() != totals {
            return Err("a batch and its bodies one by one have different totals".into());
        }
        let (_, time) = each(deletions.iter(), |effect| apply(&mut engine, effect));
        all_deletes.push(time.as_secs_f64());
        if engine.totals() != nothing {
            return Err("something is left when all is deleted".into());
        }
    }
    let [volume, area] = E::measures(&totals);
    Ok(Answer {
        bodies: all.len(),
        batch_seconds: median(batches),
        insert_seconds: median(inserts),
        inserts_seconds: median(all_inserts),
        deletes_seconds: median(all_deletes),
        volume,
        area,
    })
}
