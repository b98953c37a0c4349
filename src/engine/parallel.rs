//! One task on several threads.

use std::sync::atomic::{AtomicUsize, Ordering};

/// Runs a task once for each state, the first on this thread, the others each on one of its own.
///
/// The threads are started for the task: some tens of microseconds, against a pool in which it would wait for the million
/// cubes of another scene.
pub(super) fn in_parallel<S: Send, T: Send>(
    states: &mut [S],
    task: impl Fn(usize, &mut S) -> T + Sync,
) -> Vec<T> {
    let Some((own, others)) = states.split_first_mut() else {
        return Vec::new();
    };
    std::thread::scope(|scope| {
        let task = &task;
        let others: Vec<_> = others
            .iter_mut()
            .zip(1..)
            .map(|(state, number)| scope.spawn(move || task(number, state)))
            .collect();
        let mut results = vec![task(0, own)];
        for other in others {
            results.push(other.join().expect("a task that fails ends the change"));
        }
        results
    })
}

/// Runs a task for each index below `count`, with whichever state is free, so many indices at a time; the results in order.
pub(super) fn map_in_parallel<S: Send, T: Send>(
    states: &mut [S],
    count: usize,
    at_once: usize,
    task: impl Fn(&mut S, usize) -> T + Sync,
) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let needed = states.len().min(count.div_ceil(at_once));
    let shares = in_parallel(&mut states[..needed], |_, state| {
        let mut results = Vec::new();
        loop {
            let first = next.fetch_add(at_once, Ordering::Relaxed);
            if first >= count {
                return results;
            }
            for index in first..count.min(first + at_once) {
                results.push((index, task(state, index)));
            }
        }
    });
    let mut results: Vec<(usize, T)> = shares.into_iter().flatten().collect();
    results.sort_unstable_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| result).collect()
}
