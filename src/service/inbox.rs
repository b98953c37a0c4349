//! What waits for a scene's writer: a bounded queue of changes, and how it all ends.
//!
//! One mutex, held only to move pointers. A `Condvar` rather than an async channel, because the writer is a thread.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex};
use tokio::sync::{Notify, futures::Notified, oneshot};

use super::kind::SceneKind;
use super::{Applied, Chain, Operations, ServiceConfig, ServiceError, Submission};

/// Where the answer to a change goes.
#[derive(Debug)]
pub(super) struct Reply<K: SceneKind> {
    /// None once it was answered.
    sender: Option<oneshot::Sender<Result<Applied<K>, ServiceError>>>,
    /// What the change stands in.
    chain: Option<Chain>,
}

/// A change that waits, and who waits for it.
#[derive(Debug)]
pub(super) struct Pending<K: SceneKind> {
    /// What to do.
    pub(super) submission: Submission<K>,
    /// Where the answer goes.
    pub(super) reply: Reply<K>,
}

/// How a scene ends.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum End {
    /// The service shuts down: what waits is still done.
    Shutdown,
    /// The scene is dropped: what waits is refused.
    Dropped,
}

/// Why something was not taken in.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Shut {
    /// The scene does not run at present; its condition says why.
    Closed,
    /// It has ended.
    Ended(End),
    /// Too much waits.
    Full {
        /// Changes waiting.
        waiting: usize,
    },
}

/// The queues of one scene.
pub(super) struct Inbox<K: SceneKind> {
    state: Mutex<State<K>>,
    wake: Condvar,
    /// Told when a full queue may have room, and when it is closed.
    room: Notify,
}

struct State<K: SceneKind> {
    /// Whether the writer serves.
    open: bool,
    end: Option<End>,
    changes: VecDeque<Pending<K>>,
    /// Operations in `changes`.
    operations: usize,
}

impl<K: SceneKind> Default for Inbox<K> {
    fn default() -> Self {
        Self {
            state: Mutex::new(State {
                open: false,
                end: None,
                changes: VecDeque::new(),
                operations: 0,
            }),
            wake: Condvar::new(),
            room: Notify::new(),
        }
    }
}

impl<K: SceneKind> Submission<K> {
    /// How many operations it has.
    pub(super) fn operations(&self) -> usize {
        self.operations.count()
    }

    /// Whether it is committed alone: a definition is no record, a dry run is of the durable state, and of a revert nobody knows how many
    /// operations it takes before it is judged.
    fn is_alone(&self) -> bool {
        matches!(
            self.operations,
            Operations::Revert(_) | Operations::Define(_) | Operations::DryRun(_)
        )
    }
}

impl<K: SceneKind> Operations<K> {
    fn count(&self) -> usize {
        match self {
            Self::Named(ops) => ops.len(),
            Self::Numbered { delete, insert } => delete.len() + insert.len(),
            // How many it takes is not known before it is its turn.
            Self::Revert(_) => 0,
            Self::DryRun(operations) => operations.count(),
            Self::Define(_) => 1,
        }
    }
}

/// What waits for an answer.
pub(super) type OutcomeReceiver<K> = oneshot::Receiver<Result<Applied<K>, ServiceError>>;

impl<K: SceneKind> Pending<K> {
    /// A change on its way, and what waits for its answer.
    pub(super) fn new(
        submission: Submission<K>,
        chain: Option<Chain>,
    ) -> (Box<Self>, OutcomeReceiver<K>) {
        let (sender, answer) = oneshot::channel();
        let reply = Reply {
            sender: Some(sender),
            chain,
        };
        (Box::new(Self { submission, reply }), answer)
    }
}

impl<K: SceneKind> Reply<K> {
    /// Answers, if there is still somebody to be answered. A refusal breaks the chain.
    pub(super) fn send(mut self, answer: Result<Applied<K>, ServiceError>) {
        self.judged(&answer);
        if let Some(sender) = self.sender.take() {
            let _gone = sender.send(answer);
        }
    }

    /// Notes what the answer will be, before it may be given: what follows in the chain is judged next.
    pub(super) fn judged(&self, answer: &Result<Applied<K>, ServiceError>) {
        if let (Err(_), Some(chain)) = (answer, &self.chain) {
            chain.break_off();
        }
    }

    /// Whether a change before it in its chain was refused.
    pub(super) fn is_abandoned(&self) -> bool {
        self.chain.as_ref().is_some_and(Chain::is_broken)
    }
}

impl<K: SceneKind> Drop for Reply<K> {
    fn drop(&mut self) {
        // Lost in a panic: nobody knows whether it was applied, so what follows must not be.
        if let (Some(_), Some(chain)) = (&self.sender, &self.chain) {
            chain.break_off();
        }
    }
}

impl<K: SceneKind> Inbox<K> {
    /// Queues a change, or gives it back.
    pub(super) fn submit(
        &self,
        pending: Box<Pending<K>>,
        config: &ServiceConfig,
    ) -> Result<(), (Shut, Box<Pending<K>>)> {
        let mut state = self.state.lock();
        if let Err(shut) = state.check() {
            return Err((shut, pending));
        }
        let operations = state.operations + pending.submission.operations();
        let waiting = state.changes.len();
        if waiting >= config.queue_changes_max
            || (waiting > 0 && operations > config.queue_operations_max)
        {
            return Err((Shut::Full { waiting }, pending));
        }
        state.operations = operations;
        state.changes.push_back(*pending);
        drop(state);
        self.wake.notify_all();
        Ok(())
    }

    /// Changes that wait, and operations in them.
    pub(super) fn waiting(&self) -> (usize, usize) {
        let state = self.state.lock();
        (state.changes.len(), state.operations)
    }

    /// Ready when a queue that is full now may have room, or is closed.
    pub(super) fn room(&self) -> Notified<'_> {
        self.room.notified()
    }

    /// Lets changes in, unless the scene has ended.
    pub(super) fn open(&self) {
        self.state.lock().open = true;
    }

    /// Lets nothing in any more and hands out those that waited.
    pub(super) fn close(&self) -> VecDeque<Pending<K>> {
        let mut state = self.state.lock();
        state.open = false;
        state.operations = 0;
        let changes = std::mem::take(&mut state.changes);
        drop(state);
        self.room.notify_waiters();
        changes
    }

    /// Announces the end. A drop overrides a shutdown.
    pub(super) fn end(&self, end: End) {
        let mut state = self.state.lock();
        if state.end != Some(End::Dropped) {
            state.end = Some(end);
        }
        drop(state);
        self.wake.notify_all();
        self.room.notify_waiters();
    }

    /// The end that was announced, if any.
    pub(super) fn ended(&self) -> Option<End> {
        self.state.lock().end
    }

    /// The changes that share the next commit. Waits until there are any or, when `idle_work` is there, does not wait.
    /// None: there will be no more, the inbox is closed.
    pub(super) fn next_group(
        &self,
        group_operations_max: usize,
        idle_work: bool,
    ) -> Option<Vec<Pending<K>>> {
        let mut state = self.state.lock();
        loop {
            let waits = !state.changes.is_empty();
            match state.end {
                Some(End::Dropped) => return None,
                Some(End::Shutdown) if !waits => {
                    // Under the same lock as the look at the queues: nothing can slip in and never be answered.
                    state.open = false;
                    return None;
                }
                _ if waits || idle_work => break,
                _ => self.wake.wait(&mut state),
            }
        }
        let mut group = Vec::new();
        let mut operations = 0;
        while let Some(next) = state.changes.front() {
            let more = next.submission.operations();
            let alone = next.submission.is_alone();
            if !group.is_empty() && (alone || operations + more > group_operations_max) {
                break;
            }
            operations += more;
            state.operations -= more;
            group.extend(state.changes.pop_front());
            if alone {
                break;
            }
        }
        drop(state);
        self.room.notify_waiters();
        Some(group)
    }

    /// Waits for the end, at most `timeout`.
    pub(super) fn wait_end(&self, timeout: Duration) -> Option<End> {
        let deadline = Instant::now() + timeout;
        let mut state = self.state.lock();
        while state.end.is_none() && !self.wake.wait_until(&mut state, deadline).timed_out() {}
        state.end
    }
}

impl<K: SceneKind> State<K> {
    fn check(&self) -> Result<(), Shut> {
        match (self.end, self.open) {
            (Some(end), _) => Err(Shut::Ended(end)),
            (None, true) => Ok(()),
            (None, false) => Err(Shut::Closed),
        }
    }
}
