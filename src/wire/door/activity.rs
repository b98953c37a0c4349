//! What a connection is doing, as its socket and its requests tell it, and when that has lasted too long.
//!
//! ```text
//!   idle ── first byte of a head ──> head ── the request ──> answering ── its end ──> idle
//!     idle_timeout                     head_timeout            beside it, while nothing can be written: unread_timeout
//! ```

use std::sync::Arc;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::Notify;
use tokio::time::Instant;

use super::Settings;

/// What one connection is doing.
pub(super) struct Activity {
    state: Mutex<State>,
    /// Told when a deadline may have come nearer.
    nearer: Notify,
}

struct State {
    /// Requests that are not answered to their end.
    requests: usize,
    /// Since when there is none.
    idle_since: Instant,
    /// Since when a head is on its way.
    head_since: Option<Instant>,
    /// Since when nothing could be written.
    blocked_since: Option<Instant>,
    /// When something was read last.
    read_at: Instant,
    /// Who waits until there is no request.
    waiting: Option<Waker>,
}

/// What has lasted too long.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
pub(super) enum Overdue {
    /// The head of a request does not come to its end.
    #[error("the head of a request did not arrive in time")]
    Head,
    /// There is no request.
    #[error("there was no request for a long time")]
    Idle,
    /// The client does not read.
    #[error("the client did not read what was answered")]
    Unread,
    /// The client does not answer a PING.
    #[error("the client is not there any more")]
    Silent,
}

/// A request that is not answered to its end.
pub(super) struct Underway(Arc<Activity>);

impl Drop for Underway {
    fn drop(&mut self) {
        let mut state = self.0.state.lock();
        state.requests -= 1;
        if state.requests == 0 {
            state.idle_since = Instant::now();
            self.0.nearer.notify_one();
            if let Some(waiting) = state.waiting.take() {
                waiting.wake();
            }
        }
    }
}

impl Activity {
    pub(super) fn new() -> Self {
        let now = Instant::now();
        Self {
            state: Mutex::new(State {
                requests: 0,
                idle_since: now,
                head_since: None,
                blocked_since: None,
                read_at: now,
                waiting: None,
            }),
            nearer: Notify::new(),
        }
    }

    /// A request begins; it is under way until what this gives is dropped.
    pub(super) fn begin(self: &Arc<Self>) -> Underway {
        let mut state = self.state.lock();
        state.requests += 1;
        state.head_since = None;
        Underway(self.clone())
    }

    /// Ready when no request is under way.
    pub(super) fn poll_idle(&self, context: &mut Context<'_>) -> Poll<()> {
        let mut state = self.state.lock();
        if state.requests == 0 {
            return Poll::Ready(());
        }
        state.waiting = Some(context.waker().clone());
        Poll::Pending
    }

    /// Something was read.
    pub(super) fn read(&self) {
        self.state.lock().read_at = Instant::now();
    }

    /// When something was read last.
    pub(super) fn read_at(&self) -> Instant {
        self.state.lock().read_at
    }

    /// Whether a head has begun and not ended.
    pub(super) fn head(&self, has_begun: bool) {
        let mut state = self.state.lock();
        if has_begun != state.head_since.is_some() {
            state.head_since = has_begun.then(Instant::now);
            self.nearer.notify_one();
        }
    }

    /// Whether what was to be written is waiting for the client to read.
    pub(super) fn blocked(&self, is_blocked: bool) {
        let mut state = self.state.lock();
        if is_blocked != state.blocked_since.is_some() {
            state.blocked_since = is_blocked.then(Instant::now);
            self.nearer.notify_one();
        }
    }

    /// Waits until something has lasted too long.
    pub(super) async fn overdue(&self, settings: &Settings) -> Overdue {
        loop {
            let next = self.state.lock().next(settings);
            // Nothing that is there or comes without a word is due earlier than this.
            let (deadline, overdue) = next.unwrap_or_else(|| {
                let now = Instant::now();
                (now + settings.idle_timeout, None)
            });
            if let Some(overdue) = overdue.filter(|_| deadline <= Instant::now()) {
                return overdue;
            }
            tokio::select! {
                () = tokio::time::sleep_until(deadline) => {}
                () = self.nearer.notified() => {}
            }
        }
    }
}

impl State {
    /// What is due first, and when.
    fn next(&self, settings: &Settings) -> Option<(Instant, Option<Overdue>)> {
        let due = |since: Instant, time: Duration, overdue| (since + time, Some(overdue));
        let idle = (self.requests == 0 && self.head_since.is_none())
            .then(|| due(self.idle_since, settings.idle_timeout, Overdue::Idle));
        let head = self.head_since;
        let head = head.map(|since| due(since, settings.head_timeout, Overdue::Head));
        let unread = self.blocked_since;
        let unread = unread.map(|since| due(since, settings.unread_timeout, Overdue::Unread));
        let all = [idle, head, unread].into_iter().flatten();
        all.min_by_key(|(deadline, _)| *deadline)
    }
}
