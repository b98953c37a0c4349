//! A scene as its clients see it: submit, ask, read, subscribe.
//!
//! ```text
//!   change ──> inbox ──> the writer's thread ──> log ──> feed ──> published, subscribe, wait_for
//!   cube, page, contains ──> the set of cubes (between two steps of the writer)
//!   history, at ──> a connection of their own
//! ```

use std::any::Any;
use std::path::PathBuf;
use std::pin::pin;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::Duration;

use arc_swap::ArcSwap;
use parking_lot::Mutex;
use tokio::sync::{Semaphore, watch};

use super::budget::Budget;
use super::failpoint::FailHook;
use super::feed::Feed;
use super::gate::Gate;
use super::gauges::Pulse;
use super::inbox::{End, Inbox, Pending, Shut};
use super::kind::SceneKind;
use super::load::Load;
use super::set::View;
use super::solids::Solids;
use super::{
    Applied, CHANGE_OPERATIONS_MAX, Chain, HistoryRow, Published, SceneName, SceneState, Seq,
    ServiceConfig, ServiceError, Submission, meters,
};
use crate::engine::solids::Body;
use crate::engine::{Cursor, Side};
use crate::geometry::convex::Point;
use crate::geometry::{CubeId, Edge, Place};
use crate::log::{Cubes, Header, HistoryReader, LogError, write_ahead_bytes};

/// What all scenes of a service share.
pub(super) struct Setup {
    pub(super) config: ServiceConfig,
    pub(super) gate: Gate,
    pub(super) budget: Budget,
    pub(super) fail_hook: Option<FailHook>,
}

/// Clients that read all bodies of one scene at a time; others wait.
const READINGS_MAX: usize = 32;

impl Setup {
    /// Whether so little space is free where the data is that nothing more is taken in. (When it cannot be told, it is tried.)
    pub(super) fn check_disk(&self) -> Result<(), ServiceError> {
        let least = self.config.disk_free_bytes_min;
        if least == 0 {
            return Ok(());
        }
        let Ok(disk) = rustix::fs::statvfs(&self.config.data) else {
            return Ok(());
        };
        let free = disk.f_bavail.saturating_mul(disk.f_frsize);
        if free >= least {
            return Ok(());
        }
        Err(ServiceError::Storage {
            cause: format!(
                "{free} bytes are free where the data is, fewer than disk_free_bytes_min = {least}"
            ),
            full: true,
        })
    }
}

/// How a scene is, with what its readers need.
pub(super) enum Condition<K: SceneKind> {
    /// Its log is being replayed.
    Recovering,
    /// It answers.
    Running(Arc<Feed<K>>),
    /// A write failed.
    Stopped {
        /// Why.
        cause: String,
        /// Whether the disk is full.
        full: bool,
    },
    /// Its files are damaged.
    Damaged {
        /// What, where, and what to do.
        cause: String,
    },
    /// A newer version of this program made its files.
    Newer {
        /// Which.
        cause: String,
    },
    /// It was dropped, or the service has shut down.
    Ended(End),
}

/// One scene.
pub struct SceneOf<K: SceneKind> {
    name: SceneName,
    pub(super) directory: PathBuf,
    pub(super) setup: Arc<Setup>,
    /// Known once the log has been opened.
    header: OnceLock<Header<K>>,
    /// What those above made of the header's settings.
    settings: OnceLock<Arc<dyn Any + Send + Sync>>,
    condition: ArcSwap<Condition<K>>,
    /// How far replay has come.
    permille: AtomicU32,
    /// Whether the first replay is over, whatever came of it.
    started: AtomicBool,
    notices: Mutex<Vec<String>>,
    pub(super) inbox: Inbox<K>,
    /// What its writer shows of the log.
    pub(super) pulse: Pulse,
    /// For audits: one at a time, for each takes as much memory as the bodies, and more.
    pub(super) audits: Semaphore,
    /// For copies of the log.
    pub(super) copies: Semaphore,
    /// For readings of all bodies by clients.
    pub(super) readings: Arc<Semaphore>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

/// A scene of cubes.
pub type Scene = SceneOf<Cubes>;

impl<K: SceneKind> std::fmt::Debug for SceneOf<K> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("Scene")
            .field("name", &self.name)
            .field("state", &self.state())
            .finish_non_exhaustive()
    }
}

impl<K: SceneKind> SceneOf<K> {
    /// Its name.
    pub fn name(&self) -> &SceneName {
        &self.name
    }

    /// What waits in it now. Looks at its write-ahead file, no further I/O.
    pub fn load(&self) -> Load {
        let (changes, operations) = self.inbox.waiting();
        let (unmoved_pages, checkpoint_due) = self.pulse.read();
        let subscriptions = self.feed().map_or(0, |feed| feed.updates.receiver_count());
        Load {
            queue_changes: changes as u64,
            queue_operations: operations as u64,
            write_ahead_bytes: write_ahead_bytes(&self.directory),
            unmoved_pages,
            checkpoint_due,
            subscriptions: subscriptions as u64,
        }
    }

    /// Its settings, as given to `create`. Empty while its log has not been opened ([`super::Service::scene`] refuses it then).
    pub fn settings(&self) -> &str {
        self.header.get().map_or("", |header| &header.settings)
    }

    /// What `read` makes of its settings, made once and kept with the scene: those above know what the text means, the service does not.
    /// None, and nothing kept, when it makes nothing of them. All callers ask for the same type.
    pub fn settings_as<T: Any + Send + Sync>(
        &self,
        read: impl FnOnce(&str) -> Option<T>,
    ) -> Option<Arc<T>> {
        let kept = if let Some(kept) = self.settings.get() {
            kept
        } else {
            let made = Arc::new(read(self.settings())?);
            self.settings.get_or_init(|| made)
        };
        kept.clone().downcast().ok()
    }

    /// Random name of this life of the scene. 0 while its log has not been opened.
    pub fn incarnation(&self) -> u64 {
        self.header.get().map_or(0, |header| header.incarnation)
    }

    /// What was found and mended when its log was opened, in words: a cut-off end of a write-ahead file.
    pub fn notices(&self) -> Vec<String> {
        self.notices.lock().clone()
    }

    /// How it is.
    pub fn state(&self) -> SceneState {
        match &**self.condition.load() {
            Condition::Recovering => SceneState::Recovering {
                percent: self.percent(),
            },
            Condition::Running(_) => SceneState::Running,
            Condition::Stopped { cause, full } => SceneState::Stopped {
                cause: cause.clone(),
                full: *full,
            },
            Condition::Damaged { cause } => SceneState::Damaged {
                cause: cause.clone(),
            },
            Condition::Newer { cause } => SceneState::Newer {
                cause: cause.clone(),
            },
            Condition::Ended(end) => SceneState::Stopped {
                cause: match end {
                    End::Shutdown => "the service is shutting down".to_owned(),
                    End::Dropped => "the scene was dropped".to_owned(),
                },
                full: false,
            },
        }
    }

    /// Newest durable totals. Never waits for the writer.
    pub fn published(&self) -> Result<Published<K>, ServiceError> {
        Ok(**self.feed()?.newest.load())
    }

    /// Submits a change and waits until it is durable. Dropping the future does not undo the change.
    /// # Errors
    /// Nothing has changed then, but for [`ServiceError::Stopped`]: when the disk fails in the middle of a write, the
    /// change may have been kept, whole, and shows once the scene is back; its cause says so. A retry with the same
    /// ids, or with the same key, is safe.
    pub async fn change(&self, submission: Submission<K>) -> Result<Applied<K>, ServiceError> {
        let operations = submission.operations();
        if operations > CHANGE_OPERATIONS_MAX {
            return Err(ServiceError::TooManyOperations { operations });
        }
        let (pending, answer) = Pending::new(submission, None);
        self.inbox
            .submit(pending, &self.setup.config)
            .map_err(|(shut, _)| self.refusal_of(shut))?;
        answer.await.unwrap_or_else(|_| Err(self.refusal()))
    }

    /// Queues the next change of a stream, and waits for room while the queue is full. What this gives waits until the change is
    /// durable; changes queued one after the other are judged in that order.
    /// # Errors
    /// As of [`Self::change`], but never [`ServiceError::QueueFull`]. [`ServiceError::Abandoned`] when the chain is broken.
    pub async fn submit(
        self: &Arc<Self>,
        submission: Submission<K>,
        chain: Option<Chain>,
    ) -> Result<impl Future<Output = Result<Applied<K>, ServiceError>> + Send + use<K>, ServiceError>
    {
        let operations = submission.operations();
        if operations > CHANGE_OPERATIONS_MAX {
            return Err(ServiceError::TooManyOperations { operations });
        }
        let (mut pending, answer) = Pending::new(submission, chain);
        loop {
            // Before the try: room that comes right after it is not missed.
            let mut room = pin!(self.inbox.room());
            room.as_mut().enable();
            match self.inbox.submit(pending, &self.setup.config) {
                Ok(()) => break,
                Err((Shut::Full { .. }, back)) => pending = back,
                Err((shut, _)) => return Err(self.refusal_of(shut)),
            }
            room.await;
        }
        let this = Arc::clone(self);
        Ok(async move { answer.await.unwrap_or_else(|_| Err(this.refusal())) })
    }

    /// Newest totals now and whenever they change; a slow reader skips to the newest. None once the scene is dropped or stopped.
    pub fn subscribe(&self) -> Result<watch::Receiver<Published<K>>, ServiceError> {
        Ok(self.feed()?.updates.subscribe())
    }

    /// The first published state at or after `seq`; None after `timeout`. (States between two commits are not seen.)
    pub async fn wait_for(
        &self,
        seq: Seq,
        timeout: Duration,
    ) -> Result<Option<Published<K>>, ServiceError> {
        let mut updates = self.subscribe()?;
        let reached = updates.wait_for(|published| published.seq >= seq);
        match tokio::time::timeout(timeout, reached).await {
            Ok(Ok(published)) => Ok(Some(*published)),
            Ok(Err(_)) => Err(self.refusal()),
            Err(_) => Ok(None),
        }
    }

    /// A past state.
    /// # Errors
    /// [`ServiceError::SeqNotReached`] beyond the newest, [`ServiceError::SeqNotKept`] before the oldest.
    pub async fn at(&self, seq: Seq) -> Result<Published<K>, ServiceError> {
        let newest = self.published()?;
        if seq > newest.seq {
            return Err(ServiceError::SeqNotReached {
                seq,
                newest: newest.seq,
            });
        }
        if seq == newest.seq {
            return Ok(newest);
        }
        self.read_history(move |history| match history.at(seq)? {
            Some(row) => Ok(Ok(Published {
                seq,
                at_ms: row.at_ms,
                totals: row.totals,
            })),
            None => Ok(Err(ServiceError::SeqNotKept {
                seq,
                oldest: history.range()?.0,
            })),
        })
        .await?
    }

    /// Rows of the history from `from` to `to`, at most `limit`, oldest first; with `moves` only those whose move's number is from
    /// the first to the second. Rows no longer kept are left out.
    pub async fn history(
        &self,
        from: Seq,
        to: Seq,
        moves: Option<[u64; 2]>,
        limit: usize,
    ) -> Result<Vec<HistoryRow<K>>, ServiceError> {
        // A row that is committed but not published yet must not show: its change has not been answered.
        let to = to.min(self.published()?.seq);
        if from > to {
            return Ok(Vec::new());
        }
        self.read_history(move |history| match moves {
            None => history.rows(from, to, limit),
            Some(moves) => history.rows_of_moves(from, to, moves, limit),
        })
        .await
    }

    /// The body of an id.
    pub async fn body(&self, id: CubeId) -> Result<Option<K::Body>, ServiceError> {
        self.read(move |view| view.body(id)).await
    }

    /// Up to `limit` bodies after the cursor (from the beginning without one), and the cursor of the last when more follow.
    /// A body that is there during the whole listing is listed exactly once, whatever changes meanwhile. O(limit, and
    /// bodies on their way).
    pub async fn page(
        &self,
        after: Option<Cursor>,
        limit: usize,
    ) -> Result<(Vec<(CubeId, K::Body)>, Option<Cursor>), ServiceError> {
        self.read(move |view| view.page(after, limit)).await
    }

    /// What its bodies stand on, as far as it is durable.
    pub fn context(&self) -> Result<Arc<K::Context>, ServiceError> {
        Ok(self.feed()?.context.load_full())
    }

    /// Reads the durable bodies: at once, or on a thread that may block while the writer takes a step.
    async fn read<T: Send + 'static>(
        &self,
        question: impl FnOnce(&View<'_, K>) -> T + Send + 'static,
    ) -> Result<T, ServiceError> {
        let feed = self.feed()?;
        if let Some(view) = feed.set.try_view() {
            return Ok(question(&view));
        }
        let answer = blocking(move || feed.set.view().map(|view| question(&view))).await?;
        answer.ok_or_else(|| self.refusal())
    }

    /// Reads the history on a thread that may block.
    async fn read_history<T: Send + 'static>(
        &self,
        read: impl FnOnce(&HistoryReader<K>) -> Result<T, LogError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let feed = self.feed()?;
        blocking(move || read(&feed.history))
            .await?
            .map_err(ServiceError::from)
    }

    pub(super) fn feed(&self) -> Result<Arc<Feed<K>>, ServiceError> {
        match &**self.condition.load() {
            Condition::Running(feed) => Ok(feed.clone()),
            condition => Err(self.refusal_in(condition)),
        }
    }

    /// Why it does not answer now.
    pub(super) fn refusal(&self) -> ServiceError {
        self.refusal_in(&self.condition.load())
    }

    fn refusal_in(&self, condition: &Condition<K>) -> ServiceError {
        match condition {
            Condition::Recovering => ServiceError::Recovering {
                percent: self.percent(),
            },
            // It stopped and is back already; the question was lost in between.
            Condition::Running(_) => ServiceError::Stopped {
                cause: "the scene was interrupted and is back; ask again".to_owned(),
                full: false,
            },
            Condition::Stopped { cause, full } => ServiceError::Stopped {
                cause: cause.clone(),
                full: *full,
            },
            Condition::Damaged { cause } => ServiceError::Damaged {
                cause: cause.clone(),
            },
            Condition::Newer { cause } => ServiceError::Newer {
                cause: cause.clone(),
            },
            Condition::Ended(end) => self.refusal_of(Shut::Ended(*end)),
        }
    }

    fn refusal_of(&self, shut: Shut) -> ServiceError {
        match shut {
            Shut::Closed => self.refusal(),
            Shut::Ended(End::Shutdown) => ServiceError::ShuttingDown,
            Shut::Ended(End::Dropped) => ServiceError::NoSuchScene(self.name.0.clone()),
            Shut::Full { waiting } => {
                meters::queue_full();
                ServiceError::QueueFull { waiting }
            }
        }
    }

    fn percent(&self) -> u8 {
        u8::try_from(self.permille() / 10).map_or(100, |percent| percent.min(100))
    }
}

/// What only scenes of cubes have.
impl Scene {
    /// Edge of its cubes. One step while its log has not been opened ([`super::Service::scene`] refuses it then).
    pub fn edge(&self) -> Edge {
        let steps = self.header.get().map_or(1, |header| header.edge_steps);
        Edge::new(i64::from(steps)).expect("an edge is checked before its header is kept")
    }

    /// Where a cube is.
    pub async fn cube(&self, id: CubeId) -> Result<Option<Place>, ServiceError> {
        self.body(id).await
    }

    /// Where a point lies, and the cube of least id that holds it (closed cubes).
    pub async fn contains(
        &self,
        point: [i32; 3],
    ) -> Result<(Seq, Side, Option<(CubeId, Place)>), ServiceError> {
        self.read(move |view| {
            let (side, cube) = view.contains(point);
            (view.seq(), side, cube)
        })
        .await
    }
}

impl SceneOf<Solids> {
    /// Where a point lies in the union of the solids, cut to the stock where there is one, and the solid of least id that holds it there
    /// (closed solids).
    pub async fn contains(
        &self,
        point: Point,
    ) -> Result<(Seq, Side, Option<(CubeId, Body)>), ServiceError> {
        self.read(move |view| {
            let (side, solid) = view.contains(point);
            (view.seq(), side, solid)
        })
        .await
    }
}

impl<K: SceneKind> SceneOf<K> {
    /// The material that its bodies are cut from, if any. None while its log has not been opened.
    pub fn stock(&self) -> Option<K::Stock> {
        self.header.get().and_then(|header| header.stock.clone())
    }
}

/// What the registry and the writer do with a scene.
impl<K: SceneKind> SceneOf<K> {
    pub(super) fn new(name: SceneName, directory: PathBuf, setup: Arc<Setup>) -> Self {
        Self {
            name,
            directory,
            setup,
            header: OnceLock::new(),
            settings: OnceLock::new(),
            condition: ArcSwap::from_pointee(Condition::Recovering),
            permille: AtomicU32::new(0),
            started: AtomicBool::new(false),
            notices: Mutex::default(),
            inbox: Inbox::default(),
            pulse: Pulse::default(),
            audits: Semaphore::new(1),
            copies: Semaphore::new(1),
            readings: Arc::new(Semaphore::new(READINGS_MAX)),
            thread: Mutex::default(),
        }
    }

    /// Keeps the header; false when another one was kept before.
    pub(super) fn keep_header(&self, header: &Header<K>) -> bool {
        self.header.get_or_init(|| header.clone()) == header
    }

    /// Its header, once its log has been opened.
    pub(super) fn header(&self) -> Option<&Header<K>> {
        self.header.get()
    }

    pub(super) fn has_header(&self) -> bool {
        self.header.get().is_some()
    }

    pub(super) fn keep_notices(&self, notices: Vec<String>) {
        *self.notices.lock() = notices;
    }

    pub(super) fn keep_thread(&self, thread: JoinHandle<()>) {
        *self.thread.lock() = Some(thread);
    }

    pub(super) fn set_condition(&self, condition: Condition<K>) {
        self.condition.store(Arc::new(condition));
    }

    pub(super) fn set_started(&self) {
        self.started.store(true, Ordering::Release);
    }

    pub(super) fn is_starting(&self) -> bool {
        !self.started.load(Ordering::Acquire)
    }

    /// How far the first replay has come, in parts per thousand.
    pub(super) fn start_permille(&self) -> u32 {
        if self.is_starting() {
            self.permille()
        } else {
            1000
        }
    }

    /// How far replay has come, in parts per thousand.
    fn permille(&self) -> u32 {
        self.permille.load(Ordering::Relaxed).min(1000)
    }

    pub(super) fn set_permille(&self, permille: u32) {
        self.permille.store(permille, Ordering::Relaxed);
    }

    /// Announces the end: the writer finishes what it must and leaves.
    pub(super) fn announce_end(&self, end: End) {
        self.inbox.end(end);
        self.setup.gate.nudge();
    }

    /// Waits for the writer's thread, refuses what is still waiting, and closes the feed.
    pub(super) fn finish_end(&self, end: End) {
        let thread = self.thread.lock().take();
        if let Some(thread) = thread
            && thread.join().is_err()
        {
            tracing::error!(scene = self.name.as_str(), "the writer's thread panicked");
        }
        self.set_condition(Condition::Ended(end));
        self.refuse_waiting(&self.refusal());
    }

    /// Closes the inbox and answers what waits in it.
    pub(super) fn refuse_waiting(&self, refusal: &ServiceError) {
        for pending in self.inbox.close() {
            pending.reply.send(Err(refusal.clone()));
        }
    }
}

impl From<LogError> for ServiceError {
    fn from(error: LogError) -> Self {
        let cause = error.to_string();
        match error {
            LogError::Full { .. } => Self::Storage { cause, full: true },
            LogError::Failed { .. } => Self::Storage { cause, full: false },
            LogError::Damaged { .. } | LogError::Foreign { .. } => Self::Damaged { cause },
            LogError::Newer { .. } => Self::Newer { cause },
        }
    }
}

/// Runs `work` on a thread that may block; its panic is its caller's.
pub(super) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, ServiceError> {
    match tokio::task::spawn_blocking(work).await {
        Ok(value) => Ok(value),
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            // Blocking work is cancelled only by a runtime that goes down.
            Err(_) => Err(ServiceError::ShuttingDown),
        },
    }
}
