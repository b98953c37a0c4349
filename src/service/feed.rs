//! Where the readers of a scene find what is durable.

use std::sync::Arc;

use arc_swap::ArcSwap;
use tokio::sync::watch;

use super::Published;
use super::kind::SceneKind;
use super::set::BodySet;
use crate::log::HistoryReader;

/// Where readers find the durable state.
pub(super) struct Feed<K: SceneKind> {
    pub(super) set: BodySet<K>,
    pub(super) newest: ArcSwap<Published<K>>,
    pub(super) updates: watch::Sender<Published<K>>,
    pub(super) history: HistoryReader<K>,
    /// What bodies stand on, as far as it is durable.
    pub(super) context: ArcSwap<K::Context>,
}

impl<K: SceneKind> Feed<K> {
    pub(super) fn new(
        engine: K::Engine,
        published: &Published<K>,
        history: HistoryReader<K>,
        context: &K::Context,
    ) -> Self {
        Self {
            set: BodySet::new(engine, published),
            newest: ArcSwap::from_pointee(*published),
            updates: watch::Sender::new(*published),
            history,
            context: ArcSwap::from_pointee(context.clone()),
        }
    }

    /// Shows a new durable state: to those who look first, then to those who wait. Nobody sees an older state in one place
    /// after this one in another.
    pub(super) fn publish(&self, published: &Published<K>) {
        self.set.advance(published, || {
            self.newest.store(Arc::new(*published));
            self.updates.send_replace(*published);
        });
    }
}
