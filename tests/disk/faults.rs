//! Every call of a workload fails once, and the power fails later.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use parking_lot::Mutex;

use super::Random;
use super::disk::{Disk, Event, Kind, Verdict};
use super::power::{assert_none, cut_all, record};

const KINDS: [Kind; 7] = [
    Kind::Open,
    Kind::Write,
    Kind::Truncate,
    Kind::Sync,
    Kind::Rename,
    Kind::Remove,
    Kind::MakeDirectory,
];

/// Calls one after the other that fail.
#[derive(Clone, Copy, Debug)]
struct Fault {
    kind: Kind,
    first: usize,
    count: usize,
    errno: i32,
}

/// How many calls of a kind the workload makes on a disk that never fails.
fn count(kind: Kind, seed: u64) -> usize {
    let disk = Disk::new();
    let calls = Arc::new(AtomicUsize::new(0));
    let counted = calls.clone();
    disk.set_rule(move |call| {
        if call.kind == kind {
            counted.fetch_add(1, Ordering::Relaxed);
        }
        Verdict::Pass
    });
    record(&disk, seed, async |client| {
        client.in_spite_of_faults().await
    });
    calls.load(Ordering::Relaxed)
}

/// Lets calls fail, then cuts the power at every acknowledgement.
fn fail(fault: Fault, seed: u64) -> Vec<String> {
    let disk = Disk::new();
    let path = Arc::new(Mutex::new(PathBuf::new()));
    let failed = path.clone();
    let mut calls = 0..;
    let fails = fault.first..fault.first + fault.count;
    disk.set_rule(move |call| {
        if call.kind == fault.kind && calls.next().is_some_and(|index| fails.contains(&index)) {
            call.path.clone_into(&mut failed.lock());
            return Verdict::Fail(fault.errno);
        }
        Verdict::Pass
    });
    let outcome = catch_unwind(AssertUnwindSafe(|| {
        let (events, story) = record(&disk, seed, async |client| {
            client.in_spite_of_faults().await;
        });
        cut_all(&events, &story, &mut Random::new(seed), 3, |event| {
            matches!(event, Event::Mark(_))
        })
    }));
    let failures = outcome.unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>();
        vec![text.map_or("panicked", |text| text).to_owned()]
    });
    let path = path.lock();
    let told = |what| format!("{fault:?} at {}: {what}", path.display());
    failures.into_iter().map(told).collect()
}

/// Faults of each kind at `positions` places spread over the workload.
fn fail_some(kinds: &[Kind], positions: usize, seed: u64) {
    println!("seed {seed}");
    let mut random = Random::new(seed);
    let mut below = |end: usize| usize::try_from(random.below(end as u64)).unwrap();
    let mut failures = Vec::new();
    for &kind in kinds {
        let calls = count(kind, seed);
        let step = calls.div_ceil(positions).max(1);
        for first in (below(step)..calls).step_by(step) {
            let fault = Fault {
                kind,
                first,
                count: 1 + below(3),
                errno: [libc::EIO, libc::ENOSPC][below(2)],
            };
            failures.extend(fail(fault, seed));
        }
    }
    assert_none(&failures);
}

#[test]
fn nothing_acknowledged_is_lost_when_calls_fail_and_then_the_power() {
    fail_some(&KINDS, 16, 1);
}

#[test]
#[ignore = "minutes: every position"]
fn nothing_acknowledged_is_lost_whichever_calls_fail() {
    fail_some(&KINDS, usize::MAX, 2);
}
