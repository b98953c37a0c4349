//! What a power cut leaves of a disk.
//!
//! A file is what was synced, and then changes of which the kernel may have written any part:
//!
//! ```text
//!   file        durable bytes │ write  write  truncate  write ...     in sectors of 512 bytes, in any order among sectors;
//!                             │                                       of one sector: what came first, up to some change
//!   directory   durable names │ make  rename  remove ...              in their order, up to some change
//! ```
//! A sync moves the line; it counts for the file's bytes only, and its name is the directory's. That is what POSIX promises,
//! and less than most file systems do.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use super::Random;
use super::disk::{Event, Node};

const SECTOR_BYTES: usize = 512;

/// What of the changes that were not synced has reached the disk.
#[derive(Clone, Debug)]
pub(crate) enum Reached {
    /// All: the process died, not the machine.
    All,
    /// None.
    None,
    /// Some, by chance.
    Some(Random),
}

impl Reached {
    /// Some of them, in a way that `random` picks.
    pub(crate) fn some(random: &mut Random) -> Self {
        random.next();
        Self::Some(random.clone())
    }

    /// The same for one file or directory of a disk: each is hit in its own way.
    fn of(&self, node: Node) -> Self {
        match self {
            Self::Some(random) => {
                let mut random = random.clone();
                for _ in 0..node {
                    random.next();
                }
                Self::some(&mut random)
            }
            other => other.clone(),
        }
    }
}

/// A disk at one moment: what is durable, and what is on its way.
#[derive(Clone)]
pub(crate) struct Image {
    nodes: BTreeMap<Node, Content>,
}

#[derive(Clone)]
enum Content {
    File(File),
    Directory(Directory),
}

#[derive(Clone, Default)]
struct File {
    durable: Vec<u8>,
    pending: Vec<Change>,
}

#[derive(Clone)]
enum Change {
    Write { at: usize, bytes: Arc<[u8]> },
    Truncate { size: usize },
}

#[derive(Clone, Default)]
struct Directory {
    durable: BTreeMap<OsString, Node>,
    pending: Vec<NameChange>,
}

#[derive(Clone)]
enum NameChange {
    Make(OsString, Node),
    Rename(OsString, OsString),
    Remove(OsString),
}

impl Image {
    /// An empty disk.
    pub(crate) fn new() -> Self {
        Self {
            nodes: BTreeMap::from([(0, Content::Directory(Directory::default()))]),
        }
    }

    /// What one more event makes of it. `random` says what a sync that failed has written all the same.
    pub(crate) fn apply(&mut self, event: &Event, random: &mut Random) {
        self.apply_with(event, || Reached::some(random));
    }

    /// The same; a sync that failed has written nothing.
    pub(crate) fn apply_and_lose(&mut self, event: &Event) {
        self.apply_with(event, || Reached::None);
    }

    fn apply_with(&mut self, event: &Event, reached_by_failed_sync: impl FnOnce() -> Reached) {
        match event {
            Event::Make {
                directory,
                name,
                node,
                is_directory,
            } => {
                self.directory(*directory)
                    .pending
                    .push(NameChange::Make(name.clone(), *node));
                let content = if *is_directory {
                    Content::Directory(Directory::default())
                } else {
                    Content::File(File::default())
                };
                self.nodes.insert(*node, content);
            }
            Event::Rename {
                directory,
                from,
                to,
            } => self
                .directory(*directory)
                .pending
                .push(NameChange::Rename(from.clone(), to.clone())),
            Event::Remove { directory, name } => self
                .directory(*directory)
                .pending
                .push(NameChange::Remove(name.clone())),
            Event::Write { node, at, bytes } => self.file(*node).pending.push(Change::Write {
                at: *at,
                bytes: bytes.clone(),
            }),
            Event::Truncate { node, size } => self
                .file(*node)
                .pending
                .push(Change::Truncate { size: *size }),
            Event::Sync(node) => self.keep(*node, &Reached::All),
            // The kernel has given up on the bytes; names it still knows to be unwritten.
            Event::SyncFailed(node) if matches!(self.nodes[node], Content::File(_)) => {
                self.keep(*node, &reached_by_failed_sync());
            }
            Event::SyncFailed(_) => {}
            Event::Mark(_) => {}
        }
    }

    /// Nothing of this file or directory is pending any more.
    fn keep(&mut self, node: Node, reached: &Reached) {
        match self.nodes.get_mut(&node).expect("it was made") {
            Content::File(file) => {
                file.durable = file.after(reached);
                file.pending.clear();
            }
            Content::Directory(directory) => {
                directory.durable = directory.after(reached);
                directory.pending.clear();
            }
        }
    }

    fn directory(&mut self, node: Node) -> &mut Directory {
        match self.nodes.get_mut(&node) {
            Some(Content::Directory(directory)) => directory,
            _ => panic!("{node} is no directory"),
        }
    }

    fn file(&mut self, node: Node) -> &mut File {
        match self.nodes.get_mut(&node) {
            Some(Content::File(file)) => file,
            _ => panic!("{node} is no file"),
        }
    }

    /// Writes what is left into an empty directory.
    pub(crate) fn write_to(&self, path: &Path, reached: &Reached) {
        self.write_node(0, path, reached);
    }

    fn write_node(&self, node: Node, path: &Path, reached: &Reached) {
        let here = reached.of(node);
        match &self.nodes[&node] {
            Content::File(file) => fs::write(path, file.after(&here)).unwrap(),
            Content::Directory(directory) => {
                if node != 0 {
                    fs::create_dir(path).unwrap();
                }
                for (name, node) in directory.after(&here) {
                    self.write_node(node, &path.join(name), reached);
                }
            }
        }
    }
}

impl File {
    fn after(&self, reached: &Reached) -> Vec<u8> {
        let mut bytes = self.durable.clone();
        match reached {
            Reached::None => {}
            Reached::All => {
                for change in &self.pending {
                    change.apply(&mut bytes);
                }
            }
            Reached::Some(random) => {
                let mut random = random.clone();
                // From hardly anything to nearly all.
                let part = random.below(9);
                let mut reaches = || random.below(8) < part;
                let mut done = BTreeSet::new();
                for change in &self.pending {
                    match change {
                        Change::Truncate { .. } => {
                            if reaches() {
                                change.apply(&mut bytes);
                            }
                        }
                        Change::Write { at, bytes: written } => {
                            for (at, piece) in sectors(*at, written) {
                                let sector = at / SECTOR_BYTES;
                                if done.contains(&sector) {
                                    continue;
                                }
                                if reaches() {
                                    put(&mut bytes, at, piece);
                                } else {
                                    done.insert(sector);
                                }
                            }
                        }
                    }
                }
            }
        }
        bytes
    }
}

impl Change {
    fn apply(&self, to: &mut Vec<u8>) {
        match self {
            Self::Write { at, bytes } => put(to, *at, bytes),
            Self::Truncate { size } => to.resize(*size, 0),
        }
    }
}

fn put(to: &mut Vec<u8>, at: usize, bytes: &[u8]) {
    let end = at + bytes.len();
    if to.len() < end {
        to.resize(end, 0);
    }
    to[at..end].copy_from_slice(bytes);
}

/// The parts of a write that lie in one sector each, with their places.
fn sectors(mut at: usize, mut bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    std::iter::from_fn(move || {
        let size = bytes.len().min(SECTOR_BYTES - at % SECTOR_BYTES);
        let (piece, rest) = bytes.split_at(size);
        let place = at;
        (at, bytes) = (at + size, rest);
        (size > 0).then_some((place, piece))
    })
}

impl Directory {
    fn after(&self, reached: &Reached) -> BTreeMap<OsString, Node> {
        let count = match reached {
            Reached::None => 0,
            Reached::All => self.pending.len(),
            Reached::Some(random) => {
                let end = self.pending.len() as u64 + 1;
                usize::try_from(random.clone().below(end)).unwrap()
            }
        };
        let mut names = self.durable.clone();
        for change in &self.pending[..count] {
            match change {
                NameChange::Make(name, node) => {
                    names.insert(name.clone(), *node);
                }
                NameChange::Rename(from, to) => {
                    let node = names.remove(from).expect("in its order");
                    names.insert(to.clone(), node);
                }
                NameChange::Remove(name) => {
                    names.remove(name);
                }
            }
        }
        names
    }
}
