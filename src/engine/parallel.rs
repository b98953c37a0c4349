//! One task on several threads.

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
