//! Reading a whole scene: its bodies as of one seq, and the audit that recounts them. Changes go on meanwhile.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use parking_lot::Mutex;
use tokio::sync::OwnedSemaphorePermit;

use super::budget::{Client, Share};
use super::copying::{Copying, GivenUp};
use super::feed::Feed;
use super::kind::SceneKind;
use super::scene::{Scene, SceneOf, blocking};
use super::{Audit, Published, Seq, ServiceError, meters};
use crate::geometry::{CubeId, Place};

/// A reading for a client is given up when more bodies than this change ahead of it: each is kept as it was until the client has come so
/// far.
const CHANGED_MAX: usize = 1 << 20;

/// Bodies that an audit reads between two changes at most: less than a millisecond's.
const AUDITED_AT_ONCE: usize = 4096;

/// All bodies of a scene as of one seq, read some at a time while changes go on.
pub struct Reading<K: SceneKind> {
    scene: Arc<SceneOf<K>>,
    feed: Arc<Feed<K>>,
    copying: Arc<Mutex<Copying<K>>>,
    published: Published<K>,
    _room: Option<OwnedSemaphorePermit>,
}

impl<K: SceneKind> std::fmt::Debug for Reading<K> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("Reading")
            .field("scene", &self.scene)
            .field("seq", &self.published.seq)
            .finish_non_exhaustive()
    }
}

impl<K: SceneKind> Reading<K> {
    fn new(
        scene: &Arc<SceneOf<K>>,
        changed_max: usize,
        room: Option<OwnedSemaphorePermit>,
    ) -> Result<Self, ServiceError> {
        let feed = scene.feed()?;
        let begun = feed.copy(changed_max);
        let (published, copying) = begun.ok_or_else(|| scene.refusal())?;
        Ok(Self {
            scene: scene.clone(),
            feed,
            copying,
            published,
            _room: room,
        })
    }

    /// The seq that it is as of.
    pub fn seq(&self) -> Seq {
        self.published.seq
    }

    /// The next bodies, at most so many (at least one is asked for), in an order that is fixed by their ids; none at the end.
    /// # Errors
    /// [`ServiceError::ReadTooSlowly`] when too much has changed meanwhile; why the scene does not answer, when it has stopped.
    pub async fn next(
        &mut self,
        bodies_max: usize,
    ) -> Result<Vec<(CubeId, K::Body)>, ServiceError> {
        loop {
            // A scene that has stopped holds its bodies in memory no longer than it must.
            if !Arc::ptr_eq(&self.feed, &self.scene.feed()?) {
                return Err(self.scene.refusal());
            }
            let (feed, copying) = (self.feed.clone(), self.copying.clone());
            let read = blocking(move || {
                let mut copying = copying.lock();
                let view = feed.set.view()?;
                Some(copying.next(&view, bodies_max.max(1)))
            });
            match read.await?.ok_or_else(|| self.scene.refusal())? {
                Err(GivenUp) => {
                    return Err(ServiceError::ReadTooSlowly {
                        changed: CHANGED_MAX,
                    });
                }
                Ok(None) => return Ok(Vec::new()),
                Ok(Some(bodies)) if bodies.is_empty() => {}
                Ok(Some(bodies)) => return Ok(bodies),
            }
        }
    }

    /// All that is left.
    async fn rest(mut self) -> Result<Vec<(CubeId, K::Body)>, ServiceError> {
        let mut all = Vec::new();
        loop {
            let mut bodies = self.next(AUDITED_AT_ONCE).await?;
            if bodies.is_empty() {
                return Ok(all);
            }
            all.append(&mut bodies);
        }
    }
}

/// Some bodies of a scene as of one seq, in memory that the budget has for them.
#[derive(Debug)]
pub struct Selected<K: SceneKind> {
    /// The seq that they are as of.
    pub seq: Seq,
    /// They, in the order of the listing.
    pub bodies: Vec<K::Body>,
    /// The block that they are cut from, if any.
    pub stock: Option<K::Stock>,
    /// What they may take, and what is made of them: given back when it is dropped.
    pub share: Share,
}

/// Sets a flag when it goes: nobody waits any more.
pub(super) struct Cancelling(pub(super) Arc<AtomicBool>);

impl Drop for Cancelling {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl<K: SceneKind> SceneOf<K> {
    /// Begins to read all bodies as of the newest seq. Memory is what changes ahead of the reading. Waits while as many readings as may
    /// be are under way.
    pub async fn read_all(self: &Arc<Self>) -> Result<Reading<K>, ServiceError> {
        let room = self.readings.clone().acquire_owned().await;
        Reading::new(self, CHANGED_MAX, Some(room.expect("it is never closed")))
    }

    /// Those bodies, as of the newest seq, of which `wanted` says how many bytes they and what is made of them may take. O(bodies), in memory
    /// those that are wanted. Waits while as many readings as may be are under way.
    /// # Errors
    /// [`ServiceError::MemoryUsed`] when there is not as much memory; those of [`Reading::next`].
    pub async fn select(
        self: &Arc<Self>,
        wanted: impl Fn(&K::Body) -> Option<u64>,
    ) -> Result<Selected<K>, ServiceError> {
        let mut reading = self.read_all().await?;
        let seq = reading.seq();
        let mut share = self.setup.budget.share(Client::Audits);
        let mut bodies = Vec::new();
        loop {
            let some = reading.next(AUDITED_AT_ONCE).await?;
            if some.is_empty() {
                break;
            }
            let mut bytes = 0;
            let sized = some
                .into_iter()
                .filter_map(|(_, body)| Some((wanted(&body)?, body)));
            bodies.extend(sized.map(|(size, body)| {
                bytes += size;
                body
            }));
            if !share.take(bytes) {
                return Err(ServiceError::MemoryUsed { wanted: bytes });
            }
        }
        let header = self.header().expect("a scene that runs has a header");
        Ok(Selected {
            seq,
            bodies,
            stock: header.stock.clone(),
            share,
        })
    }

    /// All bodies as of one seq, in the order of the listing, in memory. O(bodies).
    pub async fn bodies(self: &Arc<Self>) -> Result<(Seq, Vec<(CubeId, K::Body)>), ServiceError> {
        let reading = Reading::new(self, usize::MAX, None)?;
        Ok((reading.seq(), reading.rest().await?))
    }

    /// Recounts everything from the bodies alone, on another thread, and compares. One audit of a scene at a time: others wait. When the
    /// future is dropped the recount ends soon.
    /// # Errors
    /// [`ServiceError::MemoryUsed`] when there is not as much memory for it as it may take.
    pub async fn audit(self: &Arc<Self>) -> Result<Audit<K>, ServiceError> {
        let _turn = self.audits.acquire().await.expect("it is never closed");
        let reading = Reading::new(self, usize::MAX, None)?;
        let Published { seq, totals, .. } = reading.published;
        let mut share = self.setup.budget.share(Client::Audits);
        let wanted = K::count(&totals).saturating_mul(K::RECOUNT_BYTES);
        if !share.take(wanted) {
            return Err(ServiceError::MemoryUsed { wanted });
        }
        let bodies = reading.rest().await?;
        let bodies = bodies.into_iter().map(|(_, body)| body).collect();
        let header = self.header().expect("a scene that runs has a header");
        let header = header.clone();
        let cancelled = Arc::new(AtomicBool::new(false));
        let _cancelling = Cancelling(cancelled.clone());
        let recount = move || K::recount(&header, bodies, &|| !cancelled.load(Ordering::Relaxed));
        let recounted = blocking(recount).await?;
        let recounted = recounted.expect("it is cancelled only when nobody waits");
        if !K::agree(&recounted, &totals) {
            meters::audit_differed();
            tracing::error!(
                scene = self.name().as_str(),
                seq = seq.0,
                "audit: totals differ from a recount"
            );
        }
        Ok(Audit {
            seq,
            kept: totals,
            recounted,
        })
    }
}

impl Scene {
    /// All cubes as of one seq, in the order of the listing. O(cubes).
    pub async fn cubes(self: &Arc<Self>) -> Result<(Seq, Vec<(CubeId, Place)>), ServiceError> {
        self.bodies().await
    }
}
