//! Every call of a workload fails once, and the power fails later.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use parking_lot::Mutex;
use union3d::engine::{Engine, Op};
use union3d::geometry::{CubeId, Effect, Place};
use union3d::log::{Log, Record, Replayed, SceneLog, remove_scene};
use union3d::service::{
    Cubes, Motion, Operations, SceneName, SceneState, Seq, Service, ServiceConfig, Solids,
};

use super::Random;
use super::disk::{Call, Disk, Event, Kind, Verdict};
use super::kinds::{Tried, edge};
use super::power::{assert_none, cut_all, record};
use super::workload::{Client, KEEP, config, submission};

const KINDS: [Kind; 8] = [
    Kind::Open,
    Kind::Read,
    Kind::Write,
    Kind::Truncate,
    Kind::Sync,
    Kind::Rename,
    Kind::Remove,
    Kind::MakeDirectory,
];

/// After a failed sync the power may fail at any moment: so many calls later all has been written anew.
const CALLS_WATCHED: usize = 60;

/// Calls that fail.
#[derive(Clone, Copy, Debug)]
struct FailingCalls {
    kind: Kind,
    first: usize,
    /// Which of the calls from `first` on: bit by bit, the lowest is the first.
    pattern: u8,
    errno: i32,
}

impl FailingCalls {
    fn fails(&self, index: usize) -> bool {
        let bit = index.checked_sub(self.first);
        bit.is_some_and(|bit| bit < 8 && self.pattern >> bit & 1 == 1)
    }
}

/// How many calls of a kind the workload makes on a disk that never fails.
fn count<K: Tried>(kind: Kind, seed: u64) -> usize {
    let disk = Disk::new();
    let calls = Arc::new(AtomicUsize::new(0));
    let counted = calls.clone();
    disk.set_rule(move |call| {
        if call.kind == kind {
            counted.fetch_add(1, Ordering::Relaxed);
        }
        Verdict::Pass
    });
    record(&disk, Client::<K>::new(&disk, seed), async |client| {
        client.in_spite_of_faults().await;
    });
    calls.load(Ordering::Relaxed)
}

/// Lets calls fail. The failures name the last of them.
fn fail<K: Tried>(fault: FailingCalls, seed: u64) -> Vec<String> {
    let path = Arc::new(Mutex::new(PathBuf::new()));
    let failed = path.clone();
    let mut calls = 0..;
    let failures = fail_by::<K>(seed, move |call| {
        if call.kind == fault.kind && calls.next().is_some_and(|index| fault.fails(index)) {
            call.path.clone_into(&mut failed.lock());
            return Verdict::Fail(fault.errno);
        }
        Verdict::Pass
    });
    let path = path.lock();
    let told = |what| format!("{fault:?} at {}: {what}", path.display());
    failures.into_iter().map(told).collect()
}

/// Lets calls fail as a rule says, and cuts the power: at every acknowledgement, and after any of the calls that follow a failed sync.
pub(crate) fn fail_by<K: Tried>(
    seed: u64,
    rule: impl FnMut(Call<'_>) -> Verdict + Send + 'static,
) -> Vec<String> {
    let disk = Disk::new();
    disk.set_rule(rule);
    let outcome = catch_unwind(AssertUnwindSafe(|| {
        let client = Client::<K>::new(&disk, seed);
        let (events, story) = record(&disk, client, async |client| {
            client.in_spite_of_faults().await;
        });
        let mut since_failed_sync = usize::MAX;
        cut_all(&events, &story, &mut Random::new(seed), 3, |event| {
            since_failed_sync = match event {
                Event::SyncFailed(_) => 0,
                _ => since_failed_sync.saturating_add(1),
            };
            since_failed_sync < CALLS_WATCHED || matches!(event, Event::Mark(_))
        })
    }));
    outcome.unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>();
        vec![text.map_or("panicked", |text| text).to_owned()]
    })
}

/// Faults of each kind at `positions` places spread over the workload.
fn fail_some<K: Tried>(kinds: &[Kind], positions: usize, seed: u64) {
    let mut random = Random::new(seed);
    let mut below = |end: usize| usize::try_from(random.below(end as u64)).unwrap();
    let mut failures = Vec::new();
    for &kind in kinds {
        let calls = count::<K>(kind, seed);
        let step = calls.div_ceil(positions).max(1);
        for first in (below(step)..calls).step_by(step) {
            let fault = FailingCalls {
                kind,
                first,
                pattern: u8::try_from(below(256)).unwrap() | 1,
                errno: [libc::EIO, libc::ENOSPC][below(2)],
            };
            failures.extend(fail::<K>(fault, seed));
        }
    }
    assert_none(&failures);
}

#[test]
fn nothing_acknowledged_is_lost_when_calls_fail_and_then_the_power() {
    for seed in 1..4 {
        fail_some::<Cubes>(&KINDS, 5, seed);
        fail_some::<Cubes>(&[Kind::Sync], 10, seed);
    }
}

#[test]
fn no_solid_that_was_acknowledged_is_lost_when_calls_fail_and_then_the_power() {
    for seed in 1..4 {
        fail_some::<Solids>(&KINDS, 2, seed);
        fail_some::<Solids>(&[Kind::Sync], 6, seed);
    }
}

#[test]
#[ignore = "minutes: every position"]
fn nothing_acknowledged_is_lost_whichever_calls_fail() {
    for seed in 1..4 {
        fail_some::<Cubes>(&KINDS, usize::MAX, seed);
    }
}

#[test]
#[ignore = "minutes: every position"]
fn no_solid_that_was_acknowledged_is_lost_whichever_calls_fail() {
    for seed in 1..4 {
        fail_some::<Solids>(&KINDS, usize::MAX, seed);
    }
}

/// Every call that creating a scene makes fails once. When the creation fails, nothing keeps the scene from being created once the
/// disk works again; when it does not, the scene is there.
fn create_in_spite_of_faults<K: Tried>() {
    let disk = Disk::new();
    let calls = Arc::new(AtomicUsize::new(0));
    let fail_at = |at: usize| {
        let calls = calls.clone();
        calls.store(0, Ordering::Relaxed);
        disk.set_rule(move |_| {
            if calls.fetch_add(1, Ordering::Relaxed) == at {
                Verdict::Fail(libc::ENOSPC)
            } else {
                Verdict::Pass
            }
        });
    };
    let (header, definitions) = (K::header(), K::first_definitions());
    let create = |path: &Path| Log::<K>::create_with(path, &header, &definitions, KEEP).map(drop);
    fail_at(usize::MAX);
    create(&disk.path().join("whole")).unwrap();
    let all = calls.load(Ordering::Relaxed);
    let mut refused = 0;
    for at in 0..all {
        let path = disk.path().join(format!("scene-{at}"));
        fail_at(at);
        let created = create(&path);
        disk.heal();
        if created.is_err() {
            refused += 1;
            if path.exists() {
                // What failed came after the rename, and the service removes the scene.
                remove_scene(&path).unwrap();
            }
            create(&path).unwrap();
        }
        let (mut log, notices) = Log::<K>::open(&path, KEEP).unwrap();
        assert_eq!(notices, Vec::<String>::new(), "call {at}");
        assert_eq!(K::defined(log.context()), definitions.len(), "call {at}");
        log.replay(&mut |_| (), &mut |replayed| {
            panic!("call {at}: {replayed:?} in an empty scene")
        })
        .unwrap();
    }
    // Some calls only look, or are made again.
    assert!(refused * 2 > all, "{refused} of {all}");
}

#[test]
fn a_scene_whose_creation_fails_can_be_created_later() {
    create_in_spite_of_faults::<Cubes>();
    create_in_spite_of_faults::<Solids>();
}

/// What a snapshot holds is read back before the changes it stands for may be dropped: a chunk that reads otherwise than it was
/// written is not taken, and the log is as it was.
#[test]
fn a_snapshot_that_does_not_read_as_it_was_written_is_not_taken() {
    let disk = Disk::new();
    let path = disk.path().join("scene");
    let mut log = SceneLog::create(&path, &Cubes::header(), KEEP).unwrap();
    let mut random = Random::new(5);
    let mut inserted = Vec::new();
    for id in 0..3000 {
        let corner = [0; 3].map(|_: i64| random.within(-1_000_000, 1_000_000));
        inserted.push((CubeId(id), Place::new(corner, edge()).unwrap()));
    }
    let effect = Effect {
        deleted: Vec::new(),
        inserted: inserted.clone(),
    };
    let mut engine = Engine::new(edge());
    engine.apply(&effect).unwrap();
    let totals = engine.totals();
    let record = Record {
        seq: Seq(1),
        at_ms: 1,
        effect,
        reverts_to: None,
        motion: Motion::default(),
        volume_removed: 0,
        totals,
    };
    log.append(&[record], &[]).unwrap();
    log.snapshot_begin(1, &totals, 3001).unwrap();
    disk.set_rule(|call| match call.kind {
        Kind::Read => Verdict::Spoil,
        _ => Verdict::Pass,
    });
    let written = log
        .snapshot_add(&inserted)
        .and_then(|()| log.snapshot_finish());
    assert!(written.is_err());
    disk.heal();
    drop(log);
    let (mut log, _) = SceneLog::open(&path, KEEP).unwrap();
    let mut changes = 0;
    log.replay(&mut |_| (), &mut |replayed| {
        assert!(matches!(replayed, Replayed::Change(_)), "{replayed:?}");
        changes += 1;
        true
    })
    .unwrap();
    assert_eq!(changes, 1);
}

/// Changes may still fit where a snapshot does not: the scene goes on.
#[test]
fn a_disk_too_full_for_a_snapshot_does_not_stop_the_scene() {
    let disk = Disk::new();
    let runtime = tokio::runtime::Builder::new_current_thread().build();
    runtime.unwrap().block_on(async {
        // A scene that is stopped would stay so.
        let probe_interval = Duration::from_secs(3600);
        let service = Service::start(ServiceConfig {
            probe_interval,
            ..config(disk.path())
        });
        let service = service.unwrap();
        let name = SceneName::new("s").unwrap();
        let (scene, _) = service.create(&name, edge(), None, "{}").await.unwrap();
        let place = |id: u64| Place::new([i64::try_from(id).unwrap(), 0, 0], edge()).unwrap();
        let insertion = |id: u64| Op::Insert(CubeId(id), place(id));
        let change = |ops: Vec<Op>| scene.change(submission(Operations::Named(ops)));
        change((0..100).map(insertion).collect()).await.unwrap();
        // The next change is committed with one sync of the write-ahead file, and makes the log longer than the one cube that is left
        // is worth. What is written into that file behind it is the snapshot.
        let refused = Arc::new(AtomicUsize::new(0));
        let refusals = refused.clone();
        let mut commits = 0;
        disk.set_rule(move |call| {
            let is_write_ahead = call.path.extension() == Some("sqlite-wal".as_ref());
            commits += usize::from(call.kind == Kind::Sync && is_write_ahead);
            if call.kind == Kind::Write && is_write_ahead && commits >= 1 {
                refusals.fetch_add(1, Ordering::Relaxed);
                return Verdict::Fail(libc::ENOSPC);
            }
            Verdict::Pass
        });
        change((1..100).map(|id| Op::Delete(CubeId(id))).collect())
            .await
            .unwrap();
        while refused.load(Ordering::Relaxed) == 0 {
            std::thread::yield_now();
        }
        disk.heal();
        let applied = change(vec![insertion(100)]).await.unwrap();
        assert_eq!(applied.published.totals.cubes, 2);
        assert_eq!(scene.state(), SceneState::Running);
        service.shutdown().await;
    });
}
