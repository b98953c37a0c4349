//! How a change reaches an engine that others read meanwhile.

use std::cell::RefCell;

use super::Engine;

/// The way to an engine: a lock, or nothing at all where nobody else reads.
///
/// A change takes many short steps, and long looks between them in which it finds out what the next steps are. Behind a
/// lock others read during the looks and between the steps; see [`Engine::apply_through`] for what they find.
pub trait Access<E = Engine> {
    /// Reads, while others may read too.
    fn look<T>(&self, look: impl FnOnce(&E) -> T) -> T;

    /// Takes a step, while nobody reads: some tens of microseconds; a millisecond or two when several threads put in a large batch.
    fn step<T>(&self, step: impl FnOnce(&mut E) -> T) -> T;
}

impl Access for RefCell<&mut Engine> {
    fn look<T>(&self, look: impl FnOnce(&Engine) -> T) -> T {
        look(&self.borrow())
    }

    fn step<T>(&self, step: impl FnOnce(&mut Engine) -> T) -> T {
        step(&mut self.borrow_mut())
    }
}
