//! A disk for tests: a directory whose every file call is recorded in its order, and fails where a rule says so.
//!
//! ```text
//!   SQLite, std::fs ──> calls ──> rule? ──> kernel ──> record
//!                                  │
//!                                  └─> an error of the rule's choice; the kernel is not asked
//! ```
//! Names are kept as a tree of nodes, so that a record still fits when a file was renamed or replaced.

use std::collections::{BTreeMap, HashMap};
use std::ffi::{CStr, OsStr, OsString, c_int, c_long};
use std::fmt;
use std::os::unix::ffi::OsStrExt;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use parking_lot::Mutex;
use tempfile::TempDir;

/// Number of a file or directory, in the order in which they came; 0 is the disk's own directory.
pub(crate) type Node = usize;

/// What has happened to the disk.
#[derive(Clone, PartialEq, Eq)]
pub(crate) enum Event {
    /// A new name for a new file or directory.
    Make {
        directory: Node,
        name: OsString,
        node: Node,
        is_directory: bool,
    },
    /// Another name in the same directory.
    Rename {
        directory: Node,
        from: OsString,
        to: OsString,
    },
    /// A name less.
    Remove { directory: Node, name: OsString },
    /// Bytes written at a place.
    Write {
        node: Node,
        at: usize,
        bytes: Arc<[u8]>,
    },
    /// Another size.
    Truncate { node: Node, size: usize },
    /// All that came before to a file, or to the names in a directory, is on stable storage.
    Sync(Node),
    /// The sync failed. Of what came before to a file some may be there, and no later sync cares for the rest.
    SyncFailed(Node),
    /// The test's own: so far it has come.
    Mark(usize),
}

impl fmt::Debug for Event {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Make { name, node, .. } => write!(formatter, "make {name:?} (node {node})"),
            Self::Rename { from, to, .. } => write!(formatter, "rename {from:?} to {to:?}"),
            Self::Remove { name, .. } => write!(formatter, "remove {name:?}"),
            Self::Write { node, at, bytes } => {
                write!(
                    formatter,
                    "write {} bytes to node {node} at {at}",
                    bytes.len()
                )
            }
            Self::Truncate { node, size } => write!(formatter, "cut node {node} to {size} bytes"),
            Self::Sync(node) => write!(formatter, "sync node {node}"),
            Self::SyncFailed(node) => write!(formatter, "fail to sync node {node}"),
            Self::Mark(mark) => write!(formatter, "mark {mark}"),
        }
    }
}

/// What is being asked of the disk.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Kind {
    Open,
    Read,
    Write,
    Truncate,
    Sync,
    Rename,
    Remove,
    MakeDirectory,
}

/// A call before it is made.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Call<'a> {
    pub(crate) kind: Kind,
    /// From the disk's directory.
    pub(crate) path: &'a Path,
}

/// What becomes of a call.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Verdict {
    /// It is made.
    Pass,
    /// It fails with this `errno` and does nothing.
    Fail(c_int),
    /// A read gives one wrong bit; any other call is made.
    Spoil,
}

type Rule = Box<dyn FnMut(Call<'_>) -> Verdict + Send>;

/// A directory of its own whose calls are recorded.
pub(crate) struct Disk {
    shared: Arc<Shared>,
    directory: TempDir,
}

struct Shared {
    root: PathBuf,
    state: Mutex<State>,
}

struct State {
    /// Names in every directory, as the running program sees them.
    names: HashMap<Node, BTreeMap<OsString, Node>>,
    nodes: Node,
    events: Vec<Event>,
    rule: Option<Rule>,
}

/// What a file descriptor of a disk stands for.
#[derive(Clone)]
struct Handle {
    shared: Arc<Shared>,
    /// None for a file without a name.
    node: Option<Node>,
    /// Path it was opened by.
    path: PathBuf,
}

static DISKS: Mutex<Vec<Arc<Shared>>> = Mutex::new(Vec::new());
static OPEN: Mutex<BTreeMap<c_int, Handle>> = Mutex::new(BTreeMap::new());

/// A directory in memory where there is one: thousands of syncs are then no matter.
pub(crate) fn temporary() -> TempDir {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() {
        TempDir::new_in(memory).unwrap()
    } else {
        TempDir::new().unwrap()
    }
}

impl Disk {
    pub(crate) fn new() -> Self {
        let directory = temporary();
        let shared = Arc::new(Shared {
            root: directory.path().to_owned(),
            state: Mutex::new(State {
                names: HashMap::from([(0, BTreeMap::new())]),
                nodes: 1,
                events: Vec::new(),
                rule: None,
            }),
        });
        DISKS.lock().push(shared.clone());
        Self { shared, directory }
    }

    pub(crate) fn path(&self) -> &Path {
        self.directory.path()
    }

    /// Notes in the record how far the test has come.
    pub(crate) fn mark(&self, mark: usize) {
        self.shared.state.lock().events.push(Event::Mark(mark));
    }

    /// From now on all that is there counts as durable.
    pub(crate) fn make_durable(&self) {
        let mut state = self.shared.state.lock();
        let nodes = 0..state.nodes;
        state.events.extend(nodes.map(Event::Sync));
    }

    /// All that was recorded.
    pub(crate) fn events(&self) -> Vec<Event> {
        self.shared.state.lock().events.clone()
    }

    /// From now on `rule` decides on every call. It must not use the disk itself.
    pub(crate) fn set_rule(&self, rule: impl FnMut(Call<'_>) -> Verdict + Send + 'static) {
        self.shared.state.lock().rule = Some(Box::new(rule));
    }

    /// From now on every call is made.
    pub(crate) fn heal(&self) {
        self.shared.state.lock().rule = None;
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let gone = |shared: &Arc<Shared>| Arc::ptr_eq(shared, &self.shared);
        DISKS.lock().retain(|shared| !gone(shared));
    }
}

/// A path as C gives it: from a directory's descriptor.
#[derive(Clone, Copy)]
pub(super) struct At<'a>(pub(super) c_int, pub(super) &'a CStr);

/// A path on a disk.
struct Place {
    shared: Arc<Shared>,
    path: PathBuf,
}

impl At<'_> {
    /// Where that is, if it is on a disk.
    fn place(self) -> Option<Place> {
        let mut path = PathBuf::from(OsStr::from_bytes(self.1.to_bytes()));
        if path.is_relative() && self.0 != libc::AT_FDCWD {
            let directory = std::fs::read_link(format!("/proc/self/fd/{}", self.0));
            path = directory.ok()?.join(path);
        }
        let disks = DISKS.lock();
        disks.iter().find_map(|shared| {
            let path = path.strip_prefix(&shared.root).ok()?.to_owned();
            let shared = shared.clone();
            Some(Place { shared, path })
        })
    }
}

impl State {
    fn judge(&mut self, kind: Kind, path: &Path) -> Verdict {
        match &mut self.rule {
            Some(rule) => rule(Call { kind, path }),
            None => Verdict::Pass,
        }
    }

    /// Makes the call unless it is to fail.
    fn call(
        &mut self,
        kind: Kind,
        path: &Path,
        kernel: impl FnOnce() -> c_long,
    ) -> Result<c_long, c_int> {
        match self.judge(kind, path) {
            Verdict::Fail(errno) => Err(errno),
            Verdict::Pass | Verdict::Spoil => Ok(kernel()),
        }
    }

    fn find(&self, path: &Path) -> Option<Node> {
        path.components()
            .try_fold(0, |node, component| match component {
                Component::Normal(name) => self.names.get(&node)?.get(name).copied(),
                _ => Some(node),
            })
    }

    /// The directory of a path, and its name there.
    fn entry(&self, path: &Path) -> Option<(Node, OsString)> {
        let directory = self.find(path.parent()?)?;
        Some((directory, path.file_name()?.to_owned()))
    }

    fn make(&mut self, path: &Path, is_directory: bool) -> Option<Node> {
        let (directory, name) = self.entry(path)?;
        let node = self.nodes;
        self.nodes += 1;
        self.names.get_mut(&directory)?.insert(name.clone(), node);
        if is_directory {
            self.names.insert(node, BTreeMap::new());
        }
        self.events.push(Event::Make {
            directory,
            name,
            node,
            is_directory,
        });
        Some(node)
    }
}

pub(super) fn open(
    at: At<'_>,
    flags: c_int,
    kernel: impl FnOnce() -> c_long,
) -> Result<c_long, c_int> {
    let Some(Place { shared, path }) = at.place() else {
        return Ok(kernel());
    };
    let mut state = shared.state.lock();
    let result = state.call(Kind::Open, &path, kernel)?;
    let Ok(file @ 0..) = c_int::try_from(result) else {
        return Ok(result);
    };
    let nameless = flags & libc::O_TMPFILE == libc::O_TMPFILE;
    let node = match state.find(&path) {
        _ if nameless => None,
        Some(node) => {
            if flags & libc::O_TRUNC != 0 {
                state.events.push(Event::Truncate { node, size: 0 });
            }
            Some(node)
        }
        None => state.make(&path, false),
    };
    drop(state);
    // Directories that are opened as such are only gone through, and the C library closes them by itself.
    if flags & libc::O_DIRECTORY == 0 || nameless {
        let handle = Handle { shared, node, path };
        OPEN.lock().insert(file, handle);
    }
    Ok(result)
}

/// Before the kernel gives the number to somebody else.
pub(super) fn close(file: c_int) {
    let handle = OPEN.lock().remove(&file);
    drop(handle);
}

fn handle(file: c_int) -> Option<Handle> {
    OPEN.lock().get(&file).cloned()
}

/// The kernel is told whether to spoil what it reads.
pub(super) fn read(file: c_int, kernel: impl FnOnce(bool) -> c_long) -> Result<c_long, c_int> {
    let Some(handle) = handle(file) else {
        return Ok(kernel(false));
    };
    let mut state = handle.shared.state.lock();
    match state.judge(Kind::Read, &handle.path) {
        Verdict::Fail(errno) => Err(errno),
        verdict => Ok(kernel(verdict == Verdict::Spoil)),
    }
}

pub(super) fn write(
    file: c_int,
    at: impl FnOnce() -> Option<u64>,
    bytes: &[u8],
    kernel: impl FnOnce() -> c_long,
) -> Result<c_long, c_int> {
    let Some(handle) = handle(file) else {
        return Ok(kernel());
    };
    let mut state = handle.shared.state.lock();
    let at = at();
    let result = state.call(Kind::Write, &handle.path, kernel)?;
    if let (Some(node), Some(at), Ok(written)) = (handle.node, at, usize::try_from(result)) {
        state.events.push(Event::Write {
            node,
            at: usize::try_from(at).expect("a place in memory"),
            bytes: bytes[..written].into(),
        });
    }
    Ok(result)
}

pub(super) fn truncate(
    file: c_int,
    size: usize,
    kernel: impl FnOnce() -> c_long,
) -> Result<c_long, c_int> {
    let Some(handle) = handle(file) else {
        return Ok(kernel());
    };
    let mut state = handle.shared.state.lock();
    let result = state.call(Kind::Truncate, &handle.path, kernel)?;
    if let (Some(node), 0) = (handle.node, result) {
        state.events.push(Event::Truncate { node, size });
    }
    Ok(result)
}

pub(super) fn sync(file: c_int, kernel: impl FnOnce() -> c_long) -> Result<c_long, c_int> {
    let Some(handle) = handle(file) else {
        return Ok(kernel());
    };
    let mut state = handle.shared.state.lock();
    let result = state.call(Kind::Sync, &handle.path, kernel);
    if let Some(node) = handle.node {
        state.events.push(match result {
            Ok(0) => Event::Sync(node),
            _ => Event::SyncFailed(node),
        });
    }
    result
}

pub(super) fn rename(
    from: &CStr,
    to: &CStr,
    kernel: impl FnOnce() -> c_long,
) -> Result<c_long, c_int> {
    let [from, to] = [from, to].map(|path| At(libc::AT_FDCWD, path).place());
    let (Some(from), Some(to)) = (from, to) else {
        return Ok(kernel());
    };
    let mut state = from.shared.state.lock();
    let result = state.call(Kind::Rename, &to.path, kernel)?;
    let entries = (state.entry(&from.path), state.entry(&to.path));
    if let ((Some(from), Some(to)), 0) = (entries, result) {
        assert_eq!(from.0, to.0, "renamed within one directory");
        let (directory, from, to) = (from.0, from.1, to.1);
        let names = state.names.get_mut(&directory).expect("found");
        let node = names.remove(&from).expect("the kernel has renamed it");
        names.insert(to.clone(), node);
        state.events.push(Event::Rename {
            directory,
            from,
            to,
        });
    }
    Ok(result)
}

pub(super) fn remove(at: At<'_>, kernel: impl FnOnce() -> c_long) -> Result<c_long, c_int> {
    let Some(Place { shared, path }) = at.place() else {
        return Ok(kernel());
    };
    let mut state = shared.state.lock();
    let result = state.call(Kind::Remove, &path, kernel)?;
    if let (Some((directory, name)), 0) = (state.entry(&path), result) {
        let names = state.names.get_mut(&directory).expect("found");
        names.remove(&name);
        state.events.push(Event::Remove { directory, name });
    }
    Ok(result)
}

pub(super) fn make_directory(at: At<'_>, kernel: impl FnOnce() -> c_long) -> Result<c_long, c_int> {
    let Some(Place { shared, path }) = at.place() else {
        return Ok(kernel());
    };
    let mut state = shared.state.lock();
    let result = state.call(Kind::MakeDirectory, &path, kernel)?;
    if result == 0 {
        state.make(&path, true);
    }
    Ok(result)
}
