//! A place where a test holds the writers of scenes until it has seen what it wants.
#![allow(dead_code, reason = "not everybody needs every way to wait")]

use std::sync::Arc;

use parking_lot::{Condvar, Mutex};
use union3d::service::{FailHook, FailPoint};

/// Closed, it holds whoever comes; open, it lets them pass. At first it is open.
#[derive(Default)]
pub(crate) struct Stop {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    is_closed: bool,
    /// How many are held.
    held: usize,
}

/// Keeps a place closed.
#[must_use = "it is open again when this is dropped"]
pub(crate) struct Closed(Arc<Stop>);

impl Drop for Closed {
    fn drop(&mut self) {
        self.0.state.lock().is_closed = false;
        self.0.changed.notify_all();
    }
}

impl Stop {
    /// A hook for a service, whose writers come here at this point.
    pub(crate) fn hook(self: &Arc<Self>, at: FailPoint) -> FailHook {
        let stop = self.clone();
        Arc::new(move |point| {
            if point == at {
                stop.pass();
            }
            None
        })
    }

    /// Goes on when it is open.
    pub(crate) fn pass(&self) {
        let mut state = self.state.lock();
        state.held += 1;
        self.changed.notify_all();
        self.changed.wait_while(&mut state, |state| state.is_closed);
        state.held -= 1;
    }

    /// Closes it until what is answered is dropped, also by a test that fails: it would wait for ever for the writers that are held.
    pub(crate) fn close(self: &Arc<Self>) -> Closed {
        self.state.lock().is_closed = true;
        Closed(self.clone())
    }

    /// How many are held now.
    pub(crate) fn held(&self) -> usize {
        self.state.lock().held
    }

    /// Waits until so many are held.
    pub(crate) fn wait_for(&self, count: usize) {
        let mut state = self.state.lock();
        self.changed
            .wait_while(&mut state, |state| state.held < count);
    }
}
