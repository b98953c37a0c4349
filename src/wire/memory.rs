//! A scene in the memory of the program that holds it, asked and answered in the words of the HTTP API: the same settings and
//! messages in, the same documents and problems out.
//!
//! For programs that call the engine directly, and may go over to a server without being written anew.

use serde::Serialize;

use super::atomic::{ChangedKind, Run, Sent};
use super::calls::audited;
use super::convert::Settings;
use super::decode;
use super::documents::{IdForm, LineOperation};
use super::http::{
    AuditDocument, Return, Wanted, change_answer, csv_header, csv_line, csv_lines, entry,
};
use super::kind::ShownKind;
use super::problem::Problem;
use super::proto;
use super::solids::{DefinedShape, SolidDocument, SolidSettings};
use crate::engine::Side;
use crate::geometry::convex::Point;
use crate::geometry::{CubeId, Place};
use crate::service::{
    self, CHANGE_OPERATIONS_MAX, Counting, Cubes, HistoryRow, Motion, NamedShape, Operations, Seq,
    Solids, Submission,
};

/// A scene of either kind in memory.
#[derive(Debug)]
pub enum MemoryScene {
    /// Of cubes.
    Cubes(MemoryCubes),
    /// Of solids.
    Solids(MemorySolids),
}

/// A scene of cubes in memory.
#[derive(Debug)]
pub struct MemoryCubes(Box<Memory<Cubes>>);

/// A scene of solids in memory.
#[derive(Debug)]
pub struct MemorySolids(Box<Memory<Solids>>);

/// A scene of one kind in memory, with what it was created with.
#[derive(Debug)]
struct Memory<K: ShownKind> {
    scene: service::MemoryScene<K>,
    settings: K::Settings,
}

/// Which rows of a history are wanted; what is left out has no bound.
#[derive(Clone, Copy, Debug, Default)]
pub struct HistoryWanted {
    /// First seq.
    pub from: Option<u64>,
    /// Last seq.
    pub to: Option<u64>,
    /// Least number of a move; then changes without one are left out.
    pub move_from: Option<u64>,
    /// Greatest number of a move; then changes without one are left out.
    pub move_to: Option<u64>,
    /// Most rows.
    pub limit: Option<u64>,
}

/// What is wanted of the answer to a change.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Answered {
    /// What it did.
    Change,
    /// Also the totals after it.
    Totals,
}

impl MemoryScene {
    /// A scene with these settings, a JSON document as `PUT /v1/scenes/{scene}` takes it. Of its newest `changes_max` changes the history is
    /// known, and they can be gone back.
    /// # Errors
    /// As over HTTP.
    pub fn create(settings: &[u8], changes_max: usize) -> Result<Self, Problem> {
        if !decode::is_of_solids(settings) {
            let settings = decode::settings(settings)?;
            let (edge, stock) = (settings.edge(), settings.stock());
            let scene = service::MemoryScene::of_cubes(edge, stock, changes_max);
            let cubes = Memory { scene, settings };
            return Ok(Self::Cubes(MemoryCubes(cubes.into())));
        }
        let new = decode::solid_settings(settings)?;
        let solids = Memory {
            scene: service::MemoryScene::of_solids(new.stock, changes_max),
            settings: new.settings,
        };
        let mut solids = MemorySolids(solids.into());
        for shape in &new.shapes {
            solids.put(shape)?;
        }
        Ok(Self::Solids(solids))
    }

    /// Its settings as they are answered, a JSON object.
    pub fn settings(&self) -> String {
        match self {
            Self::Cubes(MemoryCubes(cubes)) => json(&cubes.settings.document()),
            Self::Solids(MemorySolids(solids)) => {
                json(&solids.settings.shown(Some(solids.scene.context())))
            }
        }
    }

    /// Applies a change: the answer of `POST .../changes`.
    /// # Errors
    /// As over HTTP; nothing has changed then.
    pub fn change(
        &mut self,
        change: Box<proto::Change>,
        answered: Answered,
    ) -> Result<String, Problem> {
        match self {
            Self::Cubes(MemoryCubes(cubes)) => cubes.change(change, answered, Run::Real),
            Self::Solids(MemorySolids(solids)) => solids.change(change, answered, Run::Real),
        }
    }

    /// Says what a change would do, and does nothing: the answer of `POST .../changes?dry_run=true`.
    /// # Errors
    /// As over HTTP.
    pub fn dry_run(
        &mut self,
        change: Box<proto::Change>,
        answered: Answered,
    ) -> Result<String, Problem> {
        match self {
            Self::Cubes(MemoryCubes(cubes)) => cubes.change(change, answered, Run::Dry),
            Self::Solids(MemorySolids(solids)) => solids.change(change, answered, Run::Dry),
        }
    }

    /// Goes back to what was at a seq: the answer of `POST .../revert`.
    /// # Errors
    /// As over HTTP.
    pub fn revert(&mut self, to: u64) -> Result<String, Problem> {
        match self {
            Self::Cubes(MemoryCubes(cubes)) => cubes.revert(to),
            Self::Solids(MemorySolids(solids)) => solids.revert(to),
        }
    }

    /// The mass properties now, or after a past change: the answer of `GET .../mass-properties`.
    /// # Errors
    /// As over HTTP.
    pub fn mass_properties(&self, at: Option<u64>) -> Result<String, Problem> {
        match self {
            Self::Cubes(MemoryCubes(cubes)) => cubes.mass_properties(at),
            Self::Solids(MemorySolids(solids)) => solids.mass_properties(at),
        }
    }

    /// The history as CSV: the answer of `GET .../history`.
    pub fn history(&self, wanted: HistoryWanted) -> Vec<u8> {
        match self {
            Self::Cubes(MemoryCubes(cubes)) => cubes.history(wanted),
            Self::Solids(MemorySolids(solids)) => solids.history(wanted),
        }
    }

    /// Recounts everything from the bodies alone: the answer of `POST .../audit`.
    /// # Errors
    /// As over HTTP.
    pub fn audit(&self) -> Result<String, Problem> {
        const NAME: &str = "in memory";
        Ok(json(&match self {
            Self::Cubes(MemoryCubes(cubes)) => {
                let Memory { scene, settings } = &**cubes;
                AuditDocument::of_cubes(audited(NAME, &scene.audit(), settings)?)
            }
            Self::Solids(MemorySolids(solids)) => {
                let Memory { scene, settings } = &**solids;
                AuditDocument::of_solids(audited(NAME, &scene.audit(), settings)?)
            }
        }))
    }
}

impl MemoryCubes {
    /// What it was created with.
    pub fn settings(&self) -> &Settings {
        &self.0.settings
    }

    /// Where a point lies, and the cube of least id that holds it (closed cubes).
    pub fn contains(&self, point: [i32; 3]) -> (Side, Option<CubeId>) {
        let (side, holder) = self.0.scene.contains(point);
        (side, holder.map(|(id, _)| id))
    }

    /// All cubes, in an order that is fixed by their ids alone.
    pub fn cubes(&self) -> impl Iterator<Item = (CubeId, Place)> {
        self.0.scene.bodies()
    }
}

impl MemorySolids {
    /// What it was created with.
    pub fn settings(&self) -> &SolidSettings {
        &self.0.settings
    }

    /// Where a point lies in the union, cut to the stock where there is one, and the solid of least id that holds it there (closed solids).
    pub fn contains(&self, point: Point) -> (Side, Option<CubeId>) {
        let (side, holder) = self.0.scene.contains(point);
        (side, holder.map(|(id, _)| id))
    }

    /// All solids, a line of JSON each: the answer of `GET .../solids` as `application/x-ndjson`.
    pub fn solids(&self) -> Vec<u8> {
        let (shapes, scale) = (self.0.scene.context(), self.0.settings.scale());
        let mut lines = Vec::new();
        for solid in self.0.scene.bodies() {
            let shown = SolidDocument::of(&solid, IdForm::Number, shapes, scale);
            lines.extend_from_slice(json(&LineOperation::Insert(shown)).as_bytes());
            lines.push(b'\n');
        }
        lines
    }

    /// Defines a shape from its JSON document: the answer of `PUT .../shapes/{shape}`.
    /// # Errors
    /// As over HTTP.
    pub fn define(&mut self, name: &str, shape: &[u8]) -> Result<String, Problem> {
        let shape = decode::shape(shape, name, self.0.settings.scale())?;
        self.put(&shape)?;
        let defined = self.0.scene.context().get(name).and_then(DefinedShape::of);
        Ok(json(&defined))
    }

    fn put(&mut self, shape: &NamedShape) -> Result<(), Problem> {
        let submission = Submission {
            operations: Operations::Define(shape.definition()),
            counting: Counting::Net,
            motion: Motion::default(),
            key: None,
        };
        self.0.scene.change(submission)?;
        Ok(())
    }
}

impl<K: ChangedKind> Memory<K> {
    fn change(
        &mut self,
        change: Box<proto::Change>,
        answered: Answered,
        run: Run,
    ) -> Result<String, Problem> {
        let (sent, most) = (Sent::Message(change), CHANGE_OPERATIONS_MAX);
        let decoded = K::decode(&sent, self.scene.context(), &self.settings, most)?;
        let submission = Submission {
            operations: run.of(decoded.operations),
            counting: Counting::Net,
            motion: decoded.motion,
            key: None,
        };
        match self.scene.change(submission) {
            Ok(applied) => {
                let returned = match answered {
                    Answered::Change => Return::Minimal,
                    Answered::Totals => Return::Representation,
                };
                let wanted = Wanted::new(returned, run);
                Ok(json(&change_answer(None, &self.settings, wanted, &applied)))
            }
            Err(error) => {
                let pointer = |index| sent.pointer(index, decoded.deletions);
                let (_, conflict) = K::conflict(error, &self.settings, pointer)?;
                K::recheck(&sent, &self.settings, most)?;
                Err(conflict)
            }
        }
    }

    fn revert(&mut self, to: u64) -> Result<String, Problem> {
        let applied = self.scene.change(Submission {
            operations: Operations::Revert(Seq(to)),
            counting: Counting::Net,
            motion: Motion::default(),
            key: None,
        })?;
        let wanted = Wanted::new(Return::Minimal, Run::Real);
        Ok(json(&change_answer(None, &self.settings, wanted, &applied)))
    }

    fn mass_properties(&self, at: Option<u64>) -> Result<String, Problem> {
        let published = match at {
            None => self.scene.published(),
            Some(seq) => self.scene.at(Seq(seq))?,
        };
        let seq = Some(published.seq.0);
        let properties = K::properties(None, seq, &published.totals, &self.settings);
        Ok(json(&properties))
    }

    fn history(&self, wanted: HistoryWanted) -> Vec<u8> {
        let limit = wanted.limit.and_then(|limit| usize::try_from(limit).ok());
        let rows = self.scene.history().filter(|row| wanted.has(row));
        let rows = rows.take(limit.unwrap_or(usize::MAX));
        let lines = rows.map(|row| csv_line::<K>(&entry("", row, &self.settings)));
        csv_lines(std::iter::once(csv_header::<K>()).chain(lines)).into()
    }
}

impl HistoryWanted {
    fn has<K: ShownKind>(&self, row: &HistoryRow<K>) -> bool {
        let within = |number: u64, from: Option<u64>, to: Option<u64>| {
            (from.unwrap_or(0)..=to.unwrap_or(u64::MAX)).contains(&number)
        };
        let of_moves = self.move_from.is_some() || self.move_to.is_some();
        let number = row.motion.number;
        let move_fits = number.is_some_and(|number| within(number, self.move_from, self.move_to));
        within(row.seq.0, self.from, self.to) && (!of_moves || move_fits)
    }
}

fn json(document: &impl Serialize) -> String {
    serde_json::to_string(document).expect("numbers and strings are JSON")
}
