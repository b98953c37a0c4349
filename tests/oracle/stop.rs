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

    pub(crate) fn close(&self) {
        self.state.lock().is_closed = true;
    }

    pub(crate) fn open(&self) {
        self.state.lock().is_closed = false;
        self.changed.notify_all();
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
