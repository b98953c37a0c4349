//! From the reader of a file to the engine: cubes in batches, read on one thread while another has the engine take them.
//!
//! A batch is as large as all before it together, so that a small file is one batch and of a large one the engine, which takes
//! many cubes at once faster than few, gets many at once. Memory for what is on its way is bounded: one batch is filled while
//! another is applied. What is wrong first in the file is what is reported, however the file is cut into batches.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use union3d::engine::{Engine, Op, Rejected};
use union3d::geometry::{CUBES_MAX, CubeId, Edge, Effect, Place, Totals};
use union3d::wire::convert::Settings;

type Failure = Box<dyn std::error::Error>;

/// The first batch, and the largest: 24 bytes a cube, 32 with an id.
const BATCH_MIN: usize = 1 << 16;
const BATCH_MAX: usize = 1 << 22;

/// What goes to the engine at once.
enum Batch {
    /// Cubes numbered here: none of them is there already, and nothing needs to be judged.
    New(Vec<(CubeId, Place)>),
    /// Operations on cubes that the file names, and the line of each.
    Named { ops: Vec<Op>, lines: Vec<u64> },
}

impl Batch {
    fn len(&self) -> usize {
        match self {
            Self::New(cubes) => cubes.len(),
            Self::Named { ops, .. } => ops.len(),
        }
    }
}

/// Where a reader puts what it reads, in the order of the file.
pub(super) struct Batches<'run> {
    settings: &'run Settings,
    to: SyncSender<Batch>,
    batch: Batch,
    size: usize,
    /// Whether the first cube had an id; all must do the same.
    ids: Option<bool>,
    next_id: u64,
}

impl<'run> Batches<'run> {
    fn new(settings: &'run Settings, to: SyncSender<Batch>) -> Self {
        Self {
            settings,
            to,
            batch: Batch::New(Vec::new()),
            size: BATCH_MIN,
            ids: None,
            next_id: 1,
        }
    }

    /// Edge of every cube.
    pub(super) fn edge(&self) -> Edge {
        self.settings.edge()
    }

    /// A cube at a position in user units.
    /// # Errors
    /// The position is no place of the lattice, or other cubes have ids and this one has not, or the other way about.
    pub(super) fn insert_at(
        &mut self,
        line: u64,
        id: Option<u64>,
        at: [f64; 3],
    ) -> Result<(), Failure> {
        let place = self.settings.place(at).map_err(|(axis, invalid)| {
            format!(
                "line {line}: {} = {}: {invalid}",
                ["x", "y", "z"][axis],
                at[axis]
            )
        })?;
        if *self.ids.get_or_insert(id.is_some()) != id.is_some() {
            return Err(format!(
                "line {line}: either every cube has an id, or none ({} here)",
                if id.is_some() {
                    "there is one"
                } else {
                    "there is none"
                }
            )
            .into());
        }
        match id {
            Some(id) => self.push(line, Op::Insert(CubeId(id), place)),
            None => self.insert(place),
        }
    }

    /// A cube that the file does not name.
    /// # Errors
    /// Nobody takes cubes any more.
    pub(super) fn insert(&mut self, place: Place) -> Result<(), Failure> {
        let id = CubeId(self.next_id);
        self.next_id += 1;
        match &mut self.batch {
            Batch::New(cubes) => cubes.push((id, place)),
            Batch::Named { ops, lines } => {
                // Numbered here, it is never at fault.
                ops.push(Op::Insert(id, place));
                lines.push(0);
            }
        }
        self.pass_on_when_full()
    }

    /// An operation that names a cube. From here on all do: cubes without ids and deletions in turn shall not make small batches.
    /// # Errors
    /// Nobody takes cubes any more.
    pub(super) fn push(&mut self, line: u64, op: Op) -> Result<(), Failure> {
        if let Batch::New(cubes) = &mut self.batch {
            let lines = vec![0; cubes.len()];
            let cubes = std::mem::take(cubes).into_iter();
            let ops = cubes.map(|(id, place)| Op::Insert(id, place)).collect();
            self.batch = Batch::Named { ops, lines };
        }
        let Batch::Named { ops, lines } = &mut self.batch else {
            unreachable!("it has just become one");
        };
        ops.push(op);
        lines.push(line);
        self.pass_on_when_full()
    }

    fn pass_on_when_full(&mut self) -> Result<(), Failure> {
        if self.batch.len() < self.size {
            return Ok(());
        }
        self.size = (self.size * 2).min(BATCH_MAX);
        self.pass_on()
    }

    fn pass_on(&mut self) -> Result<(), Failure> {
        let next = match self.batch {
            Batch::New(_) => Batch::New(Vec::new()),
            Batch::Named { .. } => Batch::Named {
                ops: Vec::new(),
                lines: Vec::new(),
            },
        };
        let full = std::mem::replace(&mut self.batch, next);
        Ok(self.to.send(full)?)
    }
}

/// Has `read` read cubes on a thread of its own while this one applies them to an engine; the totals of their union.
/// # Errors
/// What is wrong first in the file: what `read` says, or a cube that does not fit those before it.
pub(super) fn union_of(
    settings: &Settings,
    read: impl FnOnce(&mut Batches<'_>) -> Result<(), Failure> + Send,
) -> Result<Totals, Failure> {
    let mut engine = Engine::new(settings.edge()).with_stock(settings.stock());
    let (to, batches) = sync_channel(0);
    thread::scope(|scope| {
        let reader = scope.spawn(move || {
            let mut cubes = Batches::new(settings, to);
            let read = read(&mut cubes);
            // The last cubes, also those before a fault in the file: what is wrong in them comes first.
            let passed_on = cubes.pass_on();
            read.and(passed_on).map_err(|failure| failure.to_string())
        });
        let applied = apply_all(settings, &mut engine, batches);
        let read = reader.join().expect("the reader does not panic");
        // When the engine has refused cubes the reader only says that nobody took more.
        applied?;
        read?;
        Ok(engine.totals())
    })
}

/// Applies batches until there are no more, or one is refused: then whoever sends them finds nobody.
fn apply_all(
    settings: &Settings,
    engine: &mut Engine,
    batches: Receiver<Batch>,
) -> Result<(), Failure> {
    for batch in batches {
        let effect = match batch {
            Batch::New(inserted) => {
                let cubes = engine.len() + inserted.len() as u64;
                if cubes > CUBES_MAX {
                    return Err(Rejected::TooManyCubes {
                        cubes,
                        cubes_max: CUBES_MAX,
                    }
                    .into());
                }
                Effect {
                    deleted: Vec::new(),
                    inserted,
                }
            }
            Batch::Named { ops, lines } => judge(settings, engine, &ops, &lines)?,
        };
        engine.apply(&effect)?;
    }
    Ok(())
}

fn judge(
    settings: &Settings,
    engine: &Engine,
    ops: &[Op],
    lines: &[u64],
) -> Result<Effect, Failure> {
    let judged = engine.judge(ops, CUBES_MAX);
    let judged = judged.map_err(|rejected| match rejected {
        Rejected::IdConflict { index, id, there, .. } => format!(
            "line {}: id {} is there already, at another place ({:?}): give every cube an id of its own",
            lines[index], id.0, settings.at(there)
        ),
        Rejected::TooManyCubes { .. } => rejected.to_string(),
    })?;
    Ok(judged.effect)
}
