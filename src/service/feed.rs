//! Where the readers of a scene find what is durable.

use std::sync::Arc;

use arc_swap::ArcSwap;
use parking_lot::Mutex;
use tokio::sync::watch;

use super::Published;
use super::set::CubeSet;
use crate::engine::Engine;
use crate::log::HistoryReader;

/// Where readers find the durable state.
pub(super) struct Feed {
    pub(super) set: CubeSet,
    pub(super) newest: ArcSwap<Published>,
    pub(super) updates: watch::Sender<Published>,
    pub(super) history: Mutex<HistoryReader>,
}

impl Feed {
    pub(super) fn new(engine: Engine, published: &Published, history: HistoryReader) -> Self {
        Self {
            set: CubeSet::new(engine, published),
            newest: ArcSwap::from_pointee(*published),
            updates: watch::Sender::new(*published),
            history: Mutex::new(history),
        }
    }

    /// Shows a new durable state: to those who look first, then to those who wait. Nobody sees an older state in one place
    /// after this one in another.
    pub(super) fn publish(&self, published: &Published) {
        self.set.advance(published, || {
            self.newest.store(Arc::new(*published));
            self.updates.send_replace(*published);
        });
    }
}
