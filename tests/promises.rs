//! Promises of the service that hold at a limit or in an accident: each is stated by the test that fails when it is broken.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use futures_util::FutureExt;
use parking_lot::Mutex;
use union3d::engine::{Engine, Op, Rejected};
use union3d::geometry::{CUBES_MAX, CubeId, Edge, Place};
use union3d::log::{Header, Keep, Record, SceneLog};
use union3d::service::{
    Chain, Counting, FailPoint, Motion, Operations, Readiness, Scene, SceneName, SceneState, Seq,
    Service, ServiceConfig, ServiceError, Submission,
};

#[path = "oracle/stop.rs"]
mod stop;

use stop::Stop;

fn edge() -> Edge {
    Edge::new(3).unwrap()
}

fn config(data: &Path) -> ServiceConfig {
    ServiceConfig {
        probe_interval: Duration::from_millis(1),
        ..ServiceConfig::new(data)
    }
}

async fn create(service: &Service, name: &str) -> Arc<Scene> {
    let name = SceneName::new(name).unwrap();
    service.create(&name, edge(), None, "{}").await.unwrap().0
}

/// Waits until a scene answers.
fn running(service: &Service, name: &str) -> Arc<Scene> {
    loop {
        match service.scene(name) {
            Ok(scene) if scene.state() == SceneState::Running => return scene,
            _ => std::thread::yield_now(),
        }
    }
}

fn insertions(ids: std::ops::Range<u64>) -> Vec<Op> {
    let place = |id: u64| Place::new([i64::try_from(id).unwrap(), 0, 0], edge()).unwrap();
    ids.map(|id| Op::Insert(CubeId(id), place(id))).collect()
}

fn submission(ops: Vec<Op>) -> Submission {
    Submission {
        operations: Operations::Named(ops),
        counting: Counting::Net,
        motion: Motion::default(),
        key: None,
    }
}

/// A clock that was set back: the times of a scene's changes still never go back.
#[tokio::test]
async fn times_do_not_go_back_when_the_clock_does() {
    let directory = tempfile::tempdir().unwrap();
    let far_ahead_ms = 1 << 44;
    let path: PathBuf = directory.path().join("scenes/s");
    std::fs::create_dir(directory.path().join("scenes")).unwrap();
    let header = Header {
        incarnation: 1,
        edge_steps: 3,
        stock: None,
        settings: "{}".to_owned(),
    };
    let keep = Keep {
        history_changes_max: 9,
        idempotency_keys_max: 9,
        revert_changes_max: 9,
        revert_bytes_max: 9,
        snapshot_log_bytes_min: u64::MAX,
        write_ahead_pages_max: 1000,
    };
    let mut engine = Engine::new(edge());
    let effect = engine.judge(&insertions(1..2), CUBES_MAX).unwrap().effect;
    engine.apply(&effect).unwrap();
    let record = Record {
        seq: Seq(1),
        at_ms: far_ahead_ms,
        effect,
        reverts_to: None,
        motion: Motion::default(),
        volume_removed: 27,
        totals: engine.totals(),
    };
    let mut log = SceneLog::create(&path, &header, keep).unwrap();
    log.append(&[record], &[]).unwrap();
    drop(log);

    let service = Service::start(config(directory.path())).unwrap();
    let scene = running(&service, "s");
    let applied = scene.change(submission(insertions(2..3))).await.unwrap();
    assert!(applied.published.at_ms >= far_ahead_ms);
    let rows = scene.history(Seq(1), Seq(2), None, 2).await.unwrap();
    assert!(rows[0].at_ms <= rows[1].at_ms);
}

/// Few changes of many operations fill a queue as many small ones do; a single one that is larger still fits an empty queue.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_queue_is_bounded_by_its_operations() {
    let directory = tempfile::tempdir().unwrap();
    let stop = Arc::new(Stop::default());
    let service = Service::start_with_failpoints(
        ServiceConfig {
            queue_operations_max: 10,
            ..config(directory.path())
        },
        stop.hook(FailPoint::Append),
    )
    .unwrap();
    let scene = create(&service, "s").await;
    let closed = stop.close();
    // Larger than the bound, alone; the writer takes it and is held.
    let first = submission(insertions(0..50));
    let first = scene.submit(first, None).await.unwrap();
    stop.wait_for(1);
    let second = submission(insertions(100..106));
    let second = scene.submit(second, None).await.unwrap();
    // At once: behind the writer that is held it would wait for ever.
    let third = scene.change(submission(insertions(200..205)));
    let third = third.now_or_never();
    assert!(
        matches!(third, Some(Err(ServiceError::QueueFull { waiting: 1 }))),
        "{third:?}"
    );
    let fourth = submission(insertions(200..204));
    let fourth = scene.submit(fourth, None).await.unwrap();
    drop(closed);
    first.await.unwrap();
    second.await.unwrap();
    let applied = fourth.await.unwrap();
    assert_eq!(applied.published.totals.cubes, 60);
}

/// A scene never comes to more cubes than it may have, in whatever order a change deletes and inserts.
#[tokio::test]
async fn a_scene_has_at_most_so_many_cubes() {
    let directory = tempfile::tempdir().unwrap();
    let service = Service::start(ServiceConfig {
        scene_cubes_max: 3,
        ..config(directory.path())
    })
    .unwrap();
    let scene = create(&service, "s").await;
    scene.change(submission(insertions(0..2))).await.unwrap();
    let many = scene.change(submission(insertions(2..4))).await;
    assert!(
        matches!(
            many,
            Err(ServiceError::Rejected(Rejected::TooManyCubes {
                cubes: 4,
                cubes_max: 3
            }))
        ),
        "{many:?}"
    );
    assert_eq!(scene.published().unwrap().totals.cubes, 2);
    let mut ops = insertions(2..4);
    ops.push(Op::Delete(CubeId(0)));
    let applied = scene.change(submission(ops)).await.unwrap();
    assert_eq!(applied.published.totals.cubes, 3);
}

/// Whether a change was applied whose answer is lost with its writer, nobody knows: nothing behind it in its chain is applied.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_lost_answer_breaks_its_chain() {
    let directory = tempfile::tempdir().unwrap();
    let dies = Arc::new(AtomicBool::new(false));
    let reopened = Arc::new(AtomicBool::new(false));
    let (at_append, at_open) = (dies.clone(), reopened.clone());
    let hook = move |point| {
        if point == FailPoint::Open {
            at_open.store(true, Ordering::Release);
        }
        let dies = point == FailPoint::Append && at_append.swap(false, Ordering::AcqRel);
        assert!(!dies, "the writer dies, as the test wants it");
        None
    };
    let service = Service::start_with_failpoints(config(directory.path()), Arc::new(hook)).unwrap();
    let scene = create(&service, "s").await;
    let chain = Chain::default();
    dies.store(true, Ordering::Release);
    let first = submission(insertions(1..2));
    let first = scene.submit(first, Some(chain.clone())).await.unwrap();
    assert!(first.await.is_err());
    while !reopened.load(Ordering::Acquire) {
        std::thread::yield_now();
    }
    let scene = running(&service, "s");
    let second = submission(insertions(2..3));
    let second = scene.submit(second, Some(chain)).await.unwrap().await;
    assert!(matches!(second, Err(ServiceError::Abandoned)), "{second:?}");
    assert_eq!(scene.published().unwrap().totals.cubes, 0);
    let other = scene.change(submission(insertions(3..4))).await.unwrap();
    assert_eq!(other.published.totals.cubes, 1);
}

/// However many scenes start at once, only so many are replayed at a time; the others wait for their turn, and can be dropped
/// meanwhile.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn replays_at_a_time_are_bounded() {
    const REPLAYS_MAX: usize = 2;
    let directory = tempfile::tempdir().unwrap();
    let names: Vec<String> = (0..6).map(|index| format!("s{index}")).collect();
    let service = Service::start(config(directory.path())).unwrap();
    for name in &names {
        create(&service, name).await;
    }
    service.shutdown().await;
    drop(service);
    // The threads of the scenes that are being replayed: each has its scene's name. One too many is not held, but noted.
    let replayed: Arc<Mutex<Vec<String>>> = Arc::default();
    let stop = Arc::new(Stop::default());
    let closed = stop.close();
    let (noted, at_stop) = (replayed.clone(), stop.clone());
    let service = Service::start_with_failpoints(
        ServiceConfig {
            replays_max: REPLAYS_MAX,
            ..config(directory.path())
        },
        Arc::new(move |point| {
            if point == FailPoint::Open {
                let mut replayed = noted.lock();
                replayed.extend(std::thread::current().name().map(str::to_owned));
                let fits = replayed.len() <= REPLAYS_MAX;
                drop(replayed);
                if fits {
                    at_stop.pass();
                }
            }
            None
        }),
    )
    .unwrap();
    stop.wait_for(REPLAYS_MAX);
    let held = replayed.lock().clone();
    let (first, waiting): (Vec<_>, Vec<_>) = names
        .into_iter()
        .partition(|name| held.contains(&format!("scene {name}")));
    for name in waiting {
        service
            .remove(&SceneName::new(&name).unwrap())
            .await
            .unwrap();
    }
    assert_eq!(*replayed.lock(), held, "nobody else has come in");
    drop(closed);
    for name in first {
        running(&service, &name);
    }
}

/// The progress of a start counts each scene by the bytes that are to be read of it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn progress_at_start_weighs_scenes_by_their_bytes() {
    let directory = tempfile::tempdir().unwrap();
    let service = Service::start(config(directory.path())).unwrap();
    for (name, cubes) in [("small", 1), ("large", 50_000)] {
        let scene = create(&service, name).await;
        // Far apart, in no order: they take bytes, but hardly time.
        let place = |id: u64| {
            let corner =
                [3, 5, 7].map(|factor| i64::try_from(id.pow(3) * factor * 7919 % 1_000_003 * 1000));
            Place::new(corner.map(Result::unwrap), edge()).unwrap()
        };
        let ops = (0..cubes).map(|id| Op::Insert(CubeId(id), place(id)));
        scene.change(submission(ops.collect())).await.unwrap();
    }
    service.shutdown().await;
    drop(service);
    for (held, read, percents) in [("large", "small", 1..40), ("small", "large", 60..99)] {
        let stop = Arc::new(Stop::default());
        let at_stop = stop.clone();
        let thread = format!("scene {held}");
        let hook = move |point| {
            if point == FailPoint::Open && std::thread::current().name() == Some(&thread) {
                at_stop.pass();
            }
            None
        };
        let closed = stop.close();
        let service =
            Service::start_with_failpoints(config(directory.path()), Arc::new(hook)).unwrap();
        running(&service, read);
        let readiness = service.readiness();
        drop(closed);
        assert!(
            matches!(readiness, Readiness::Recovering { percent } if percents.contains(&percent)),
            "while {held} is held: {readiness:?}"
        );
        running(&service, held);
        service.shutdown().await;
    }
}
