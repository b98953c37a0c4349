//! The three sets of cubes that are compared: the engine, and its two yardsticks.

use std::collections::HashMap;
use std::num::NonZero;
use std::time::{Duration, Instant};

use union3d::engine::{Bare, Engine};
use union3d::geometry::{CubeId, Edge, Effect, Place};

use super::figures::Latencies;

/// A cube, as changes name it.
pub(crate) type Cube = (CubeId, Place);

/// A set of cubes that one operation after the other changes.
pub(crate) trait Set {
    fn insert(&mut self, cube: Cube);
    fn delete(&mut self, cube: Cube);
    /// Deletes one cube and inserts another, in one change where the set knows changes.
    fn replace(&mut self, old: Cube, new: Cube);
    fn len(&self) -> u64;

    fn insert_all(&mut self, cubes: &[Cube]) {
        for cube in cubes {
            self.insert(*cube);
        }
    }

    fn delete_all(&mut self, cubes: &[Cube]) {
        for cube in cubes {
            self.delete(*cube);
        }
    }
}

/// The engine, and a change whose memory is used again and again.
#[derive(Debug)]
pub(crate) struct Online {
    pub(crate) engine: Engine,
    effect: Effect,
}

impl Online {
    pub(crate) fn new(edge: Edge) -> Self {
        Self::with(Engine::new(edge))
    }

    /// The same, large batches on so many threads.
    pub(crate) fn threaded(edge: Edge, threads: NonZero<usize>) -> Self {
        Self::with(Engine::new(edge).with_threads(threads))
    }

    pub(crate) fn with(engine: Engine) -> Self {
        Self {
            engine,
            effect: Effect::default(),
        }
    }

    /// Applies one change.
    pub(crate) fn change(&mut self, deleted: &[Cube], inserted: &[Cube]) {
        self.effect.deleted.clear();
        self.effect.deleted.extend_from_slice(deleted);
        self.effect.inserted.clear();
        self.effect.inserted.extend_from_slice(inserted);
        self.engine
            .apply(&self.effect)
            .expect("the benchmark deletes what is there and inserts what is not");
    }
}

impl Set for Online {
    fn insert(&mut self, cube: Cube) {
        self.change(&[], &[cube]);
    }

    fn delete(&mut self, cube: Cube) {
        self.change(&[cube], &[]);
    }

    fn replace(&mut self, old: Cube, new: Cube) {
        self.change(&[old], &[new]);
    }

    fn len(&self) -> u64 {
        self.engine.len()
    }
}

impl Set for Bare {
    fn insert(&mut self, (id, place): Cube) {
        assert!(self.insert(id, place), "it is new");
    }

    fn delete(&mut self, (id, _): Cube) {
        assert!(self.delete(id), "it is there");
    }

    fn replace(&mut self, old: Cube, new: Cube) {
        Set::delete(self, old);
        Set::insert(self, new);
    }

    fn len(&self) -> u64 {
        self.len()
    }
}

/// What everybody has at hand.
pub(crate) type Plain = HashMap<u64, [i32; 3]>;

impl Set for Plain {
    fn insert(&mut self, (id, place): Cube) {
        let before = self.insert(id.0, place.corner());
        assert!(before.is_none(), "it is new");
    }

    fn delete(&mut self, (id, _): Cube) {
        assert!(self.remove(&id.0).is_some(), "it is there");
    }

    fn replace(&mut self, old: Cube, new: Cube) {
        Set::delete(self, old);
        Set::insert(self, new);
    }

    fn len(&self) -> u64 {
        HashMap::len(self) as u64
    }
}

/// Does one thing after the other and says how long each took, and all of them.
pub(crate) fn each<T>(
    items: impl ExactSizeIterator<Item = T>,
    mut act: impl FnMut(T),
) -> (Latencies, Duration) {
    let mut latencies = Latencies::with_capacity(items.len());
    let started = Instant::now();
    // One look at the clock an operation: it ends where the next begins.
    let mut last = started;
    for item in items {
        act(item);
        let now = Instant::now();
        latencies.push(now - last);
        last = now;
    }
    (latencies, last - started)
}
