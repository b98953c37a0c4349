//! `union3d mill --replace`: changes the program in a scene to the one in the file, by sending only what differs.
//!
//! ```text
//!   solids of the file  ── same shape, from, to ──>  kept, with the ids they have
//!         │                                                │
//!         └── others: inserted                             └── others of the scene: deleted
//! ```
//! What the solids measure together is a function of the set alone, so nothing is asked of their order: a line that is put in the middle costs its
//! own solid, and that of the line after it, which now begins elsewhere.

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};

use union3d::engine::solids::SolidId;
use union3d::geometry::convex::Point;
use union3d::wire::proto::{Change, ListSolidsRequest};

use super::super::super::credentials::Credentials;
use super::super::grpc::{self, GrpcStream};
use super::Failure;
use super::scene::{Defined, Wanted};
use super::shop::{self, Carried, Cut, Stroke, line_of};
use super::target::{CHANGE_SOLIDS_MAX, Measured, inserted};

/// A shape by its name, and where it is carried from and to: what a solid is.
type Content = (String, [i32; 6]);

/// What has become of a scene.
pub(super) struct Replaced {
    pub(super) deleted: u64,
    pub(super) inserted: u64,
    pub(super) kept: u64,
    /// What the history says that lines have removed is of another program from this line on; none when nothing differs.
    pub(super) stale_from_line: Option<u64>,
    pub(super) measured: Measured,
}

/// What is to be done to a scene.
struct Difference<'cuts> {
    deleted: Vec<SolidId>,
    inserted: Vec<(SolidId, &'cuts Cut)>,
    kept: u64,
    stale_from_line: Option<u64>,
}

/// Changes the scene to the strokes of the program.
pub(super) async fn replace(
    server: &str,
    credentials: &Credentials,
    wanted: &Wanted,
    strokes: &[Stroke],
) -> Result<Replaced, Failure> {
    let mut client = grpc::connect(server, credentials).await?;
    if wanted.find_grpc(&mut client, server).await?.is_none() {
        return Err(format!(
            "there is no scene {:?} to replace the program of: mill it without --replace first",
            wanted.name
        )
        .into());
    }
    let (seq, there) = list(&mut client, server, &wanted.name).await?;
    let cuts: Vec<&Cut> = strokes.iter().flat_map(Stroke::cuts).collect();
    let difference = Difference::between(there, &cuts)?;
    let mut defined = Defined::default();
    for (_, cut) in &difference.inserted {
        defined
            .define_grpc(&mut client, server, &wanted.name, &cut.carried.swept)
            .await?;
    }
    let mut stream = GrpcStream::open(server, client, &wanted.name).await?;
    let (mut done, mut changes) = (Vec::new(), 0);
    for change in difference.changes() {
        changes += 1;
        done.extend(stream.send((), change).await?);
    }
    let (last, answer) = stream.finish().await?;
    done.extend(last);
    let outcomes = || done.iter().map(|done| &done.outcome);
    let mut seqs = (seq + 1..).zip(outcomes());
    let replaced = Replaced {
        deleted: outcomes().map(|outcome| outcome.deleted).sum(),
        inserted: outcomes().map(|outcome| outcome.inserted).sum(),
        kept: difference.kept,
        stale_from_line: difference.stale_from_line,
        measured: Measured::of_message(server, answer.solid_mass_properties)?,
    };
    if !seqs.all(|(seq, outcome)| seq == outcome.seq)
        || replaced.measured.removed.seq != Some(seq + changes)
    {
        return Err(format!(
            "somebody else has changed scene {:?} meanwhile: run --replace again",
            wanted.name
        )
        .into());
    }
    Ok(replaced)
}

/// The solids of a scene and the change they are as of; of hulls the ids alone, which no program has put down.
async fn list(
    client: &mut grpc::Client,
    server: &str,
    scene: &str,
) -> Result<(u64, BTreeMap<SolidId, Option<Content>>), Failure> {
    let refused = grpc::refused(server);
    let request = ListSolidsRequest {
        scene: scene.to_owned(),
    };
    let pages = client.list_solids(request).await.map_err(&refused)?;
    let mut pages = pages.into_inner();
    let (mut seq, mut solids) = (0, BTreeMap::new());
    while let Some(page) = pages.message().await.map_err(&refused)? {
        seq = page.seq;
        let change = page.solids.unwrap_or_default();
        for (index, id) in change.insert_id.iter().enumerate() {
            let content = content(&change, index);
            if content.is_none() && index < change.x.len() {
                return Err(grpc::without(server)("the columns of solids").into());
            }
            solids.insert(SolidId(*id), content);
        }
    }
    Ok((seq, solids))
}

/// A solid of a listing; none of a hull.
fn content(change: &Change, index: usize) -> Option<Content> {
    let columns = [
        &change.x,
        &change.y,
        &change.z,
        &change.to_x,
        &change.to_y,
        &change.to_z,
    ];
    let mut ends = [0; 6];
    for (end, column) in ends.iter_mut().zip(columns) {
        *end = *column.get(index)?;
    }
    let shape = usize::try_from(*change.shape.get(index)?).ok()?;
    Some((change.shapes.get(shape)?.clone(), ends))
}

impl<'cuts> Difference<'cuts> {
    /// What makes a scene of what is there to one of these cuts. O(solids of both).
    fn between(
        there: BTreeMap<SolidId, Option<Content>>,
        cuts: &[&'cuts Cut],
    ) -> Result<Self, String> {
        let mut unmatched: HashMap<Content, VecDeque<SolidId>> = HashMap::new();
        let mut deleted = Vec::new();
        for (id, content) in there {
            match content {
                Some(content) => unmatched.entry(content).or_default().push_back(id),
                None => deleted.push(id),
            }
        }
        let mut kept = BTreeSet::new();
        let mut new = Vec::new();
        // Lines of the program and of the one before it that differ, or whose numbers do.
        let mut stale: Option<u64> = None;
        let mut is_stale = |line: u64| stale = Some(stale.map_or(line, |least| least.min(line)));
        for cut in cuts {
            let Carried { swept, ends } = &cut.carried;
            let [[x, y, z], [to_x, to_y, to_z]] = ends.map(Point::coordinates);
            let content = (swept.name.clone(), [x, y, z, to_x, to_y, to_z]);
            let line = line_of(cut.id);
            match unmatched.get_mut(&content).and_then(VecDeque::pop_front) {
                Some(id) => {
                    if line_of(id) != line {
                        is_stale(line.min(line_of(id)));
                    }
                    kept.insert(id);
                }
                None => new.push(*cut),
            }
        }
        for id in unmatched.into_values().flatten() {
            is_stale(line_of(id));
            deleted.push(id);
        }
        deleted.sort_unstable();
        let mut numbers: HashMap<u64, u64> = HashMap::new();
        let mut inserted = Vec::with_capacity(new.len());
        for cut in new {
            let line = line_of(cut.id);
            is_stale(line);
            let number = numbers.entry(line).or_default();
            // An id of its line that nothing has which stays.
            let id = loop {
                let id = shop::id(line, *number)?;
                *number += 1;
                if !kept.contains(&id) {
                    break id;
                }
            };
            inserted.push((id, cut));
        }
        Ok(Self {
            deleted,
            inserted,
            kept: kept.len() as u64,
            stale_from_line: stale,
        })
    }

    /// One change, or several when it is large: deletions first, so that their ids are free.
    fn changes(&self) -> impl Iterator<Item = Change> {
        let Self {
            deleted, inserted, ..
        } = self;
        let is_small = deleted.len() + inserted.len() <= CHANGE_SOLIDS_MAX;
        let insertion =
            |some: &[(SolidId, &Cut)]| self::inserted(some.iter().map(|(id, cut)| (*id, *cut)));
        let ids = |some: &[SolidId]| some.iter().map(|id| id.0).collect();
        let mut changes = Vec::new();
        if is_small {
            changes.push(Change {
                delete: ids(deleted),
                ..insertion(inserted)
            });
        } else {
            changes.extend(deleted.chunks(CHANGE_SOLIDS_MAX).map(|some| Change {
                delete: ids(some),
                ..Change::default()
            }));
            changes.extend(inserted.chunks(CHANGE_SOLIDS_MAX).map(insertion));
        }
        let is_empty = |change: &Change| change.delete.is_empty() && change.insert_id.is_empty();
        changes.into_iter().filter(move |change| !is_empty(change))
    }
}
