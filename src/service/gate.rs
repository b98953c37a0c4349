//! Lets a few replays at a time through.

use parking_lot::{Condvar, Mutex};

/// Places for scenes that are replayed: each replay can use all cores, and memory is not counted twice.
pub(super) struct Gate {
    free: Mutex<usize>,
    changed: Condvar,
}

/// A place behind the [`Gate`], given back when dropped.
pub(super) struct Pass<'a>(&'a Gate);

impl Gate {
    pub(super) fn new(places: usize) -> Self {
        Self {
            free: Mutex::new(places),
            changed: Condvar::new(),
        }
    }

    /// Waits for a place; none when `ended` says so first.
    pub(super) fn enter(&self, ended: impl Fn() -> bool) -> Option<Pass<'_>> {
        let mut free = self.free.lock();
        loop {
            if ended() {
                return None;
            }
            if *free > 0 {
                *free -= 1;
                return Some(Pass(self));
            }
            self.changed.wait(&mut free);
        }
    }

    /// Makes those who wait look again whether they have ended.
    pub(super) fn nudge(&self) {
        // Under the lock, so that nobody is between its look and its wait.
        let _free = self.free.lock();
        self.changed.notify_all();
    }
}

impl Drop for Pass<'_> {
    fn drop(&mut self) {
        *self.0.free.lock() += 1;
        self.0.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    /// Who comes when all places are taken looks again and again whether it has ended, and is not let in.
    #[test]
    fn nobody_comes_in_while_all_places_are_taken() {
        let gate = Gate::new(2);
        let taken = [(); 2].map(|()| gate.enter(|| false).unwrap());
        std::thread::scope(|scope| {
            let waits = scope.spawn(|| {
                let looks = Cell::new(0);
                let ended = || looks.replace(looks.get() + 1) == 3;
                gate.enter(ended).is_none()
            });
            while !waits.is_finished() {
                gate.nudge();
                std::thread::yield_now();
            }
            assert!(waits.join().unwrap());
        });
        let [first, _second] = taken;
        drop(first);
        assert!(gate.enter(|| false).is_some());
    }
}
