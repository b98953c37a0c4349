//! The service against a plain model: what is acknowledged, in which order, and what survives.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use futures_util::future::BoxFuture;
use parking_lot::{Condvar, Mutex};
use union3d::engine::{Counts, Engine, Op, Rejected, Side, recount};
use union3d::geometry::{CubeId, Edge, Effect, Place, Stock, Totals};
use union3d::log::{Keep, LogError, Replayed, SceneLog};
use union3d::service::{
    Applied, Counting, FailHook, FailPoint, Motion, Operations, Published, Readiness, Scene,
    SceneName, SceneState, Seq, Service, ServiceConfig, ServiceError, Submission,
};

#[path = "oracle/random.rs"]
mod random;
use random::Random;

const EDGE: i64 = 3;

fn edge() -> Edge {
    Edge::new(EDGE).unwrap()
}

fn place(x: i64, y: i64, z: i64) -> Place {
    Place::new([x, y, z], edge()).unwrap()
}

fn name(text: &str) -> SceneName {
    SceneName::new(text).unwrap()
}

fn config(directory: &Path) -> ServiceConfig {
    ServiceConfig {
        probe_interval: Duration::from_millis(10),
        ..ServiceConfig::new(directory.join("data"))
    }
}

fn start(directory: &Path) -> Service {
    Service::start(config(directory)).unwrap()
}

async fn create(service: &Service, text: &str) -> Arc<Scene> {
    service
        .create(&name(text), edge(), None, "{}")
        .await
        .unwrap()
        .0
}

/// Polls until `condition` gives something; a failure says what it waited for.
#[track_caller]
fn poll<T>(what: &str, mut condition: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        if let Some(value) = condition() {
            return value;
        }
        assert!(Instant::now() < deadline, "waited too long for {what}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Waits until the scene answers again.
fn running(service: &Service, text: &str) -> Arc<Scene> {
    poll("a running scene", || {
        let scene = service.scene(text).ok()?;
        (scene.state() == SceneState::Running).then_some(scene)
    })
}

fn named(ops: Vec<Op>) -> Submission {
    Submission {
        operations: Operations::Named(ops),
        counting: Counting::Net,
        motion: Motion::default(),
        key: None,
    }
}

fn insert(id: u64, x: i64) -> Submission {
    named(vec![Op::Insert(CubeId(id), place(x, 0, 0))])
}

fn numbered(places: Vec<Place>, key: Option<(&str, u8)>) -> Submission {
    Submission {
        operations: Operations::Numbered {
            delete: Vec::new(),
            insert: places,
        },
        counting: Counting::Net,
        motion: Motion::default(),
        key: key.map(|(key, body)| (key.into(), [body; 32])),
    }
}

/// The reference: a map of ids to places and a list of what was acknowledged.
#[derive(Clone, Default)]
struct Model {
    cubes: BTreeMap<u64, Place>,
    next_id: u64,
    seq: u64,
}

impl Model {
    fn new() -> Self {
        Self {
            next_id: 1,
            ..Self::default()
        }
    }

    /// Applies operations one after the other; None: refused, nothing changed.
    fn apply(&mut self, ops: &[Op]) -> Option<(Counts, Counts)> {
        let before = self.cubes.clone();
        let mut in_order = Counts::default();
        for op in ops {
            match *op {
                Op::Delete(id) => match self.cubes.remove(&id.0) {
                    Some(_) => in_order.deleted += 1,
                    None => in_order.unchanged += 1,
                },
                Op::Insert(id, place) => match self.cubes.get(&id.0) {
                    None => {
                        self.cubes.insert(id.0, place);
                        in_order.inserted += 1;
                    }
                    Some(there) if *there == place => in_order.unchanged += 1,
                    Some(_) => {
                        self.cubes = before;
                        return None;
                    }
                },
            }
        }
        let differs = |a: &BTreeMap<u64, Place>, b: &BTreeMap<u64, Place>| {
            let gone = a.iter().filter(|&(id, place)| b.get(id) != Some(place));
            gone.map(|(id, _)| *id).collect::<Vec<u64>>()
        };
        let deleted = differs(&before, &self.cubes);
        let inserted = differs(&self.cubes, &before);
        if !deleted.is_empty() || !inserted.is_empty() {
            self.seq += 1;
        }
        if let Some(greatest) = inserted.iter().max() {
            self.next_id = self.next_id.max(greatest + 1);
        }
        let net = Counts {
            inserted: inserted.len() as u64,
            deleted: deleted.len() as u64,
            unchanged: (ops.len() - inserted.len() - deleted.len()) as u64,
        };
        Some((net, in_order))
    }

    fn totals(&self) -> Totals {
        recount(edge(), None, self.cubes.values().copied())
    }
}

fn random_place(random: &mut Random) -> Place {
    let mut coordinate = || random.within(0, 6);
    place(coordinate(), coordinate(), coordinate())
}

/// A few operations on few ids in a small world: ties, moves, duplicates and conflicts are the common case.
fn random_ops(random: &mut Random) -> Vec<Op> {
    let mut ops = Vec::new();
    for _ in 0..random.below(6) {
        let id = CubeId(1 + random.below(12));
        match random.below(4) {
            0 => ops.push(Op::Delete(id)),
            1 => ops.extend([Op::Delete(id), Op::Insert(id, random_place(random))]),
            _ => ops.push(Op::Insert(id, random_place(random))),
        }
    }
    ops
}

async fn check_state(scene: &Arc<Scene>, model: &Model) {
    let published = scene.published().unwrap();
    assert_eq!(published.seq, Seq(model.seq));
    assert_eq!(published.totals, model.totals());
    let (seq, cubes) = scene.cubes().await.unwrap();
    assert_eq!(seq, published.seq);
    assert_eq!(cubes.len(), model.cubes.len());
    let cubes: BTreeMap<u64, Place> = cubes.into_iter().map(|(id, at)| (id.0, at)).collect();
    assert_eq!(cubes, model.cubes);
}

#[tokio::test]
async fn random_changes_agree_with_a_plain_map_through_restarts() {
    for seed in 0..12 {
        let mut random = Random::new(seed);
        let directory = tempfile::tempdir().unwrap();
        let mut service = start(directory.path());
        let mut scene = create(&service, "model").await;
        let mut model = Model::new();
        let mut states = vec![scene.published().unwrap()];
        let mut answered: Vec<(String, u8, Applied)> = Vec::new();
        for step in 0..150u32 {
            match random.below(20) {
                0 => {
                    if random.below(2) == 0 {
                        service.shutdown().await;
                    }
                    drop(service);
                    service = start(directory.path());
                    scene = running(&service, "model");
                    check_state(&scene, &model).await;
                }
                1..=4 => {
                    let places: Vec<Place> = (0..random.below(3))
                        .map(|_| random_place(&mut random))
                        .collect();
                    let key = format!("key {step}");
                    let first = model.next_id;
                    let ops: Vec<Op> = (first..)
                        .zip(&places)
                        .map(|(id, place)| Op::Insert(CubeId(id), *place))
                        .collect();
                    let count = places.len() as u64;
                    let applied = scene
                        .change(numbered(places, Some((&key, 7))))
                        .await
                        .unwrap();
                    let (net, _) = model.apply(&ops).unwrap();
                    let range = (count > 0).then(|| (CubeId(first), CubeId(first + count - 1)));
                    assert_eq!(applied.assigned, range);
                    assert_eq!(applied.counts, net);
                    assert!(!applied.replayed);
                    answered.push((key, 7, applied));
                }
                5 if !answered.is_empty() => {
                    let index = usize::try_from(random.below(answered.len() as u64)).unwrap();
                    let (key, body, first) = &answered[index];
                    let places = vec![place(0, 0, 0)];
                    let again = scene
                        .change(numbered(places.clone(), Some((key, *body))))
                        .await;
                    let again = again.unwrap();
                    assert!(again.replayed);
                    assert_eq!(again.published, first.published);
                    assert_eq!(again.counts, first.counts);
                    assert_eq!(again.assigned, first.assigned);
                    let other = scene.change(numbered(places, Some((key, body + 1)))).await;
                    assert!(matches!(other, Err(ServiceError::KeyReused)), "{other:?}");
                }
                _ => {
                    let ops = random_ops(&mut random);
                    let in_order = random.below(2) == 0;
                    let submission = Submission {
                        counting: if in_order {
                            Counting::InOrder
                        } else {
                            Counting::Net
                        },
                        ..named(ops.clone())
                    };
                    let answer = scene.change(submission).await;
                    match (answer, model.apply(&ops)) {
                        (Ok(applied), Some((net, ordered))) => {
                            assert_eq!(applied.counts, if in_order { ordered } else { net });
                            assert_eq!(applied.published.seq, Seq(model.seq));
                            assert_eq!(applied.published.totals, model.totals());
                        }
                        (Err(ServiceError::Rejected(Rejected::IdConflict { .. })), None) => {}
                        (answer, expected) => {
                            panic!("step {step}: {answer:?}, expected {expected:?}")
                        }
                    }
                }
            }
            let published = scene.published().unwrap();
            assert_eq!(published.seq, Seq(model.seq));
            if published.seq > states.last().unwrap().seq {
                states.push(published);
            }
            assert_eq!(published, *states.last().unwrap());
        }
        check_state(&scene, &model).await;
        for state in &states {
            assert_eq!(scene.at(state.seq).await.unwrap(), *state);
        }
        let rows = scene
            .history(Seq(1), Seq(u64::MAX), None, 1000)
            .await
            .unwrap();
        assert_eq!(rows.len(), states.len() - 1);
        for (row, state) in rows.iter().zip(&states[1..]) {
            assert_eq!(
                (row.seq, row.at_ms, &row.totals),
                (state.seq, state.at_ms, &state.totals)
            );
        }
        let audit = scene.audit().await.unwrap();
        assert_eq!(audit.seq, Seq(model.seq));
        assert_eq!(audit.kept, audit.recounted);
    }
}

#[tokio::test]
async fn a_change_is_refused_as_a_whole() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let scene = create(&service, "s").await;
    scene.change(insert(1, 0)).await.unwrap();
    let before = scene.published().unwrap();
    let ops = vec![
        Op::Insert(CubeId(2), place(9, 0, 0)),
        Op::Insert(CubeId(1), place(1, 0, 0)),
    ];
    let refused = scene.change(named(ops)).await.unwrap_err();
    let ServiceError::Rejected(Rejected::IdConflict {
        index,
        id,
        there,
        asked,
    }) = refused
    else {
        panic!("{refused}");
    };
    assert_eq!((index, id), (1, CubeId(1)));
    assert_eq!((there, asked), (place(0, 0, 0), place(1, 0, 0)));
    assert_eq!(scene.published().unwrap(), before);
    assert_eq!(scene.cube(CubeId(2)).await.unwrap(), None);
}

#[tokio::test]
async fn questions_see_the_last_durable_state() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let scene = create(&service, "s").await;
    for id in 1..=10 {
        scene
            .change(insert(id, i64::try_from(id).unwrap() * 10))
            .await
            .unwrap();
    }
    assert_eq!(scene.cube(CubeId(3)).await.unwrap(), Some(place(30, 0, 0)));
    assert_eq!(scene.cube(CubeId(11)).await.unwrap(), None);
    let (seq, side, cube) = scene.contains([31, 1, 1]).await.unwrap();
    assert_eq!((seq, side), (Seq(10), Side::Inside));
    assert_eq!(cube, Some((CubeId(3), place(30, 0, 0))));
    let mut listed = BTreeSet::new();
    let mut after = None;
    loop {
        let (cubes, next) = scene.page(after, 3).await.unwrap();
        assert!(cubes.len() <= 3);
        listed.extend(cubes.into_iter().map(|(id, _)| id.0));
        after = next;
        if after.is_none() {
            break;
        }
    }
    assert_eq!(listed, (1..=10).collect());
}

#[tokio::test]
async fn the_server_numbers_on_when_a_client_has_taken_the_last_u64() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let scene = create(&service, "s").await;
    scene.change(insert(u64::MAX - 2, 0)).await.unwrap();
    let two = vec![place(0, 0, 0), place(5, 0, 0)];
    let applied = scene.change(numbered(two.clone(), None)).await.unwrap();
    assert_eq!(
        applied.assigned,
        Some((CubeId(u64::MAX - 1), CubeId(u64::MAX)))
    );
    drop((scene, service));
    let service = start(directory.path());
    let scene = running(&service, "s");
    // The greatest is taken: the server goes on where there is room.
    let applied = scene.change(numbered(two.clone(), None)).await.unwrap();
    assert_eq!(applied.assigned, Some((CubeId(1), CubeId(2))));
    scene.change(insert(4, 0)).await.unwrap();
    let applied = scene.change(numbered(two, None)).await.unwrap();
    assert_eq!(applied.assigned, Some((CubeId(5), CubeId(6))));
    // Ids of the client's own still work.
    scene.change(insert(7, 0)).await.unwrap();
}

#[tokio::test]
async fn seqs_out_of_reach_are_told_apart() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let scene = create(&service, "s").await;
    let empty = scene.published().unwrap();
    assert_eq!(scene.at(Seq(0)).await.unwrap(), empty);
    assert_eq!(empty.totals, Totals::default());
    assert!(empty.at_ms > 1_600_000_000_000);
    scene.change(insert(1, 0)).await.unwrap();
    assert_eq!(scene.at(Seq(0)).await.unwrap(), empty);
    let ahead = scene.at(Seq(2)).await;
    assert!(
        matches!(
            ahead,
            Err(ServiceError::SeqNotReached {
                seq: Seq(2),
                newest: Seq(1)
            })
        ),
        "{ahead:?}"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn concurrent_changes_are_equal_to_some_order_and_the_order_is_the_seq() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let scene = create(&service, "s").await;
    let tasks: Vec<_> = (0..24)
        .map(|task| {
            let scene = scene.clone();
            tokio::spawn(async move {
                let mut random = Random::new(task);
                let mut answers = Vec::new();
                for _ in 0..40 {
                    let ops = random_ops(&mut random);
                    let answer = scene.change(named(ops.clone())).await;
                    let seen = scene.published().unwrap();
                    if let Ok(applied) = &answer {
                        assert!(
                            seen.seq >= applied.published.seq,
                            "acknowledged, so visible"
                        );
                    }
                    answers.push((ops, answer));
                }
                answers
            })
        })
        .collect();
    let mut accepted = BTreeMap::new();
    let mut idle = Vec::new();
    for task in tasks {
        for (ops, answer) in task.await.unwrap() {
            match answer {
                Ok(applied) if applied.counts.inserted + applied.counts.deleted == 0 => {
                    idle.push((ops, applied));
                }
                Ok(applied) => {
                    let twice = accepted.insert(applied.published.seq.0, (ops, applied));
                    assert!(twice.is_none(), "one seq, one change");
                }
                Err(ServiceError::Rejected(_)) => {}
                Err(error) => panic!("{error}"),
            }
        }
    }
    let mut model = Model::new();
    let mut states = vec![model.clone()];
    for (seq, (ops, applied)) in &accepted {
        let (net, _) = model.apply(ops).expect("it was accepted in this state");
        assert_eq!(*seq, model.seq);
        assert_eq!(applied.counts, net);
        assert_eq!(applied.published.totals, model.totals());
        states.push(model.clone());
    }
    for (ops, applied) in idle {
        let mut state = states[usize::try_from(applied.published.seq.0).unwrap()].clone();
        state.apply(&ops).expect("it was accepted in this state");
        assert_eq!(state.seq, applied.published.seq.0, "it changed nothing");
        assert_eq!(applied.published.totals, state.totals());
    }
    check_state(&scene, &model).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_key_at_once_is_one_change() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let scene = create(&service, "s").await;
    let tasks: Vec<_> = (0..20)
        .map(|_| {
            let scene = scene.clone();
            let submission = numbered(vec![place(0, 0, 0)], Some(("k", 1)));
            tokio::spawn(async move { scene.change(submission).await.unwrap() })
        })
        .collect();
    let mut first = 0;
    for task in tasks {
        let applied = task.await.unwrap();
        assert_eq!(applied.assigned, Some((CubeId(1), CubeId(1))));
        assert_eq!(applied.published.seq, Seq(1));
        first += usize::from(!applied.replayed);
    }
    assert_eq!(first, 1);
}

#[tokio::test]
async fn a_key_stands_for_a_change_of_nothing_too_but_not_for_a_refused_one() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let scene = create(&service, "s").await;
    let keyed = |submission: Submission, key: &str| Submission {
        key: Some((key.into(), [1; 32])),
        ..submission
    };
    scene.change(keyed(named(vec![]), "nothing")).await.unwrap();
    scene.change(insert(1, 0)).await.unwrap();
    let refused = scene.change(keyed(insert(1, 5), "refused")).await;
    assert!(matches!(refused, Err(ServiceError::Rejected(_))));
    drop((scene, service));
    let service = start(directory.path());
    let scene = running(&service, "s");
    let again = scene.change(keyed(insert(9, 9), "nothing")).await.unwrap();
    assert!(again.replayed);
    assert_eq!(again.published.seq, Seq(0));
    assert_eq!(again.published.totals, Totals::default());
    scene
        .change(named(vec![Op::Delete(CubeId(1))]))
        .await
        .unwrap();
    let now = scene.change(keyed(insert(1, 5), "refused")).await.unwrap();
    assert!(!now.replayed);
    assert_eq!(now.counts.inserted, 1);
}

/// A disk that fails or waits when told.
#[derive(Default)]
struct TestDisk {
    state: Mutex<DiskState>,
    changed: Condvar,
}

#[derive(Default)]
struct DiskState {
    fails: Option<(FailPoint, bool)>,
    holds: Option<FailPoint>,
    held: usize,
}

impl TestDisk {
    fn hook(self: &Arc<Self>) -> FailHook {
        let disk = self.clone();
        Arc::new(move |step| {
            let mut state = disk.state.lock();
            state.held += 1;
            disk.changed.notify_all();
            while state.holds == Some(step) {
                disk.changed.wait(&mut state);
            }
            state.held -= 1;
            match state.fails {
                Some((fails, full)) if fails == step => Some(if full {
                    LogError::Full {
                        path: "disk".into(),
                    }
                } else {
                    LogError::Failed {
                        path: "disk".into(),
                        cause: "broken".into(),
                    }
                }),
                _ => None,
            }
        })
    }
    fn fail(&self, fails: Option<(FailPoint, bool)>) {
        self.state.lock().fails = fails;
    }
    fn hold(&self, holds: Option<FailPoint>) {
        self.state.lock().holds = holds;
        self.changed.notify_all();
    }
    fn wait_held(&self) {
        let mut state = self.state.lock();
        while state.held == 0 {
            self.changed.wait(&mut state);
        }
    }
}

fn start_on(disk: &Arc<TestDisk>, config: ServiceConfig) -> Service {
    Service::start_with_failpoints(config, disk.hook()).unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_queue_is_refused_and_nothing_shows_before_it_is_durable() {
    for step in [FailPoint::Append, FailPoint::Appended] {
        let directory = tempfile::tempdir().unwrap();
        let disk = Arc::new(TestDisk::default());
        let service = start_on(
            &disk,
            ServiceConfig {
                queue_changes_max: 4,
                ..config(directory.path())
            },
        );
        let scene = create(&service, "s").await;
        let before = scene.published().unwrap();
        let updates = scene.subscribe().unwrap();
        disk.hold(Some(step));
        let submit = |id: u64| {
            let scene = scene.clone();
            tokio::spawn(async move { scene.change(insert(id, 0)).await })
        };
        let mut tasks = vec![submit(1)];
        disk.wait_held();
        // The writer is inside its commit; the next four fill the queue, in whatever order they come.
        let mut refused = 0;
        for id in 2..=9 {
            let task = submit(id);
            tasks.push(task);
        }
        let (mut done, mut waiting) = (Vec::new(), tasks);
        poll("four refusals", || {
            let (finished, rest): (Vec<_>, Vec<_>) = std::mem::take(&mut waiting)
                .into_iter()
                .partition(|task| task.is_finished());
            done.extend(finished);
            waiting = rest;
            (done.len() == 4).then_some(())
        });
        for task in done {
            let answer = task.await.unwrap();
            assert!(
                matches!(answer, Err(ServiceError::QueueFull { waiting: 4 })),
                "{answer:?}"
            );
            refused += 1;
        }
        assert_eq!(refused, 4);
        assert_eq!(scene.published().unwrap(), before);
        assert!(!updates.has_changed().unwrap());
        assert_eq!(
            scene.history(Seq(1), Seq(9), None, 9).await.unwrap(),
            vec![]
        );
        let ahead = scene.at(Seq(1)).await;
        assert!(
            matches!(ahead, Err(ServiceError::SeqNotReached { .. })),
            "{ahead:?}"
        );
        disk.hold(None);
        for task in waiting {
            task.await.unwrap().unwrap();
        }
        assert_eq!(scene.published().unwrap().totals.cubes, 5);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_failed_write_stops_the_scene_and_it_comes_back_by_itself() {
    for (step, full, kept) in [
        (FailPoint::Append, true, false),
        (FailPoint::Append, false, false),
        (FailPoint::Appended, false, true),
    ] {
        let directory = tempfile::tempdir().unwrap();
        let disk = Arc::new(TestDisk::default());
        let service = start_on(&disk, config(directory.path()));
        let scene = create(&service, "s").await;
        let other = create(&service, "other").await;
        scene.change(insert(1, 0)).await.unwrap();
        let before = scene.published().unwrap();
        let mut updates = scene.subscribe().unwrap();

        disk.fail(Some((step, full)));
        let failed = scene.change(insert(2, 10)).await;
        let Err(ServiceError::Stopped {
            full: is_full,
            cause,
        }) = failed
        else {
            panic!("{failed:?}");
        };
        assert_eq!(is_full, full);
        assert!(cause.contains("not acknowledged"), "{cause}");
        // It tries again all the time, and fails at the next append only: keep it down at the door.
        disk.fail(Some((FailPoint::Open, full)));
        poll("the stop", || {
            matches!(scene.state(), SceneState::Stopped { .. }).then_some(())
        });
        poll("subscribers to be told", || {
            updates.has_changed().is_err().then_some(())
        });
        assert!(updates.changed().await.is_err());
        poll("a failed try", || {
            let SceneState::Stopped { full: is_full, .. } = scene.state() else {
                return None;
            };
            (is_full == full).then_some(())
        });
        assert!(matches!(
            scene.published(),
            Err(ServiceError::Stopped { .. })
        ));
        assert!(matches!(
            scene.cube(CubeId(1)).await,
            Err(ServiceError::Stopped { .. })
        ));
        assert!(matches!(
            scene.at(Seq(1)).await,
            Err(ServiceError::Stopped { .. })
        ));
        assert!(matches!(
            scene.change(insert(3, 0)).await,
            Err(ServiceError::Stopped { .. })
        ));
        let Readiness::Ready { troubled } = service.readiness() else {
            panic!("a stopped scene is not a start");
        };
        assert_eq!(troubled.len(), 1);
        assert_eq!(troubled[0].0, name("s"));
        assert_eq!(other.published().unwrap().seq, Seq(0));

        disk.fail(None);
        running(&service, "s");
        let after = scene.published().unwrap();
        if kept {
            assert_eq!(after.seq, Seq(2));
            assert_eq!(scene.cube(CubeId(2)).await.unwrap(), Some(place(10, 0, 0)));
        } else {
            assert_eq!(after, before);
        }
        let retried = scene.change(insert(2, 10)).await.unwrap();
        assert_eq!(
            retried.published.seq,
            Seq(2),
            "a retry changes nothing twice"
        );
        let audit = scene.audit().await.unwrap();
        assert_eq!(audit.kept, audit.recounted);
        assert_eq!(audit.kept.cubes, 2);
        assert_eq!(service.readiness(), Readiness::Ready { troubled: vec![] });
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn replay_shows_its_progress_and_holds_up_nobody_else() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    create(&service, "old")
        .await
        .change(insert(1, 0))
        .await
        .unwrap();
    drop(service);
    let disk = Arc::new(TestDisk::default());
    disk.hold(Some(FailPoint::Open));
    let service = start_on(&disk, config(directory.path()));
    assert_eq!(service.readiness(), Readiness::Recovering { percent: 0 });
    let refused = service.scene("old");
    assert!(
        matches!(refused, Err(ServiceError::Recovering { percent: 0 })),
        "{refused:?}"
    );
    let again = service.create(&name("old"), edge(), None, "{}").await;
    assert!(
        matches!(again, Err(ServiceError::Recovering { .. })),
        "{again:?}"
    );
    assert_eq!(service.scenes().len(), 1);
    assert_eq!(
        service.scenes()[0].state(),
        SceneState::Recovering { percent: 0 }
    );
    let new = create(&service, "new").await;
    new.change(insert(1, 0)).await.unwrap();
    disk.hold(None);
    let old = running(&service, "old");
    assert_eq!(old.published().unwrap().seq, Seq(1));
    poll("readiness", || {
        (service.readiness() == Readiness::Ready { troubled: vec![] }).then_some(())
    });
    assert_eq!(old.settings(), "{}");
    assert_eq!(old.edge(), edge());
}

#[tokio::test]
async fn a_damaged_scene_is_refused_and_can_be_dropped_while_others_serve() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    for text in ["bad", "good"] {
        let scene = create(&service, text).await;
        for id in 1..=20 {
            scene.change(insert(id, 0)).await.unwrap();
        }
    }
    service.shutdown().await;
    drop(service);
    let files = std::fs::read_dir(directory.path().join("data/scenes/bad")).unwrap();
    for file in files {
        let path = file.unwrap().path();
        let mut bytes = std::fs::read(&path).unwrap();
        for byte in &mut bytes {
            *byte ^= 0x55;
        }
        std::fs::write(&path, bytes).unwrap();
    }
    let service = start(directory.path());
    let good = running(&service, "good");
    assert_eq!(good.published().unwrap().totals.cubes, 20);
    let troubled = poll("readiness", || match service.readiness() {
        Readiness::Ready { troubled } => Some(troubled),
        Readiness::Recovering { .. } => None,
    });
    assert_eq!(troubled.len(), 1);
    assert_eq!(troubled[0].0, name("bad"));
    let refused = service.scene("bad");
    assert!(
        matches!(refused, Err(ServiceError::Damaged { .. })),
        "{refused:?}"
    );
    assert!(matches!(
        service.create(&name("bad"), edge(), None, "{}").await,
        Err(ServiceError::Damaged { .. })
    ));
    service.remove(&name("bad")).await.unwrap();
    let (fresh, new) = service
        .create(&name("bad"), edge(), None, "{}")
        .await
        .unwrap();
    assert!(new);
    assert_eq!(fresh.published().unwrap().seq, Seq(0));
}

/// Changes that only insert are replayed at once; one that led to other cubes than its totals say is named all the same.
#[tokio::test]
async fn the_first_change_whose_totals_differ_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let scene = create(&service, "s").await;
    for id in 1..=5 {
        scene.change(insert(id, 0)).await.unwrap();
    }
    service.shutdown().await;
    drop((scene, service));
    let keep = Keep {
        history_changes_max: u64::MAX,
        idempotency_keys_max: u64::MAX,
        revert_changes_max: u64::MAX,
        revert_bytes_max: u64::MAX,
        snapshot_log_bytes_min: u64::MAX,
        write_ahead_pages_max: u64::MAX,
    };
    let path = directory.path().join("data/scenes/s");
    let (mut log, _) = SceneLog::open(&path, keep).unwrap();
    let mut records = Vec::new();
    log.replay(&mut |_| (), &mut |step| {
        if let Replayed::Change(record) = step {
            records.push(record.clone());
        }
        true
    })
    .unwrap();
    // Two more of which the first is not what it says.
    let mut engine = Engine::new(edge());
    for record in &records {
        engine.apply(&record.effect).unwrap();
    }
    let last = records.pop().unwrap();
    let wrong: Vec<_> = [6, 7]
        .map(|id| {
            let at = |x| vec![(CubeId(id), place(x, 0, 40))];
            let effect = |x| Effect {
                deleted: vec![],
                inserted: at(x),
            };
            engine.apply(&effect(i64::try_from(id).unwrap())).unwrap();
            union3d::log::Record {
                seq: Seq(id),
                effect: effect(if id == 6 { 30 } else { 7 }),
                totals: engine.totals(),
                ..last.clone()
            }
        })
        .into();
    log.append(&wrong, &[]).unwrap();
    drop(log);
    let service = start(directory.path());
    poll("readiness", || match service.readiness() {
        Readiness::Ready { .. } => Some(()),
        Readiness::Recovering { .. } => None,
    });
    let refused = service.scene("s").unwrap().published();
    let Err(ServiceError::Damaged { cause }) = &refused else {
        panic!("{refused:?}");
    };
    assert!(cause.contains("seq 6"), "{cause}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn of_those_who_create_or_drop_at_once_exactly_one_wins() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    for _ in 0..5 {
        let creators: Vec<_> = (0..8)
            .map(|task| {
                let service = service.clone();
                let settings = if task % 2 == 0 { "a" } else { "b" };
                tokio::spawn(async move {
                    let answer = service.create(&name("s"), edge(), None, settings).await;
                    (settings, answer)
                })
            })
            .collect();
        let mut winners = Vec::new();
        let mut answers = Vec::new();
        for task in creators {
            let (settings, answer) = task.await.unwrap();
            if let Ok((_, true)) = answer {
                winners.push(settings);
            }
            answers.push((settings, answer));
        }
        let [winner] = winners[..] else {
            panic!("{winners:?}");
        };
        for (settings, answer) in answers {
            match answer {
                Ok(_) => assert_eq!(settings, winner),
                Err(ServiceError::SceneExists { settings: kept, .. }) => {
                    assert_eq!(kept, winner);
                    assert_ne!(settings, winner);
                }
                Err(error) => panic!("{error}"),
            }
        }
        let droppers: Vec<_> = (0..8)
            .map(|_| {
                let service = service.clone();
                tokio::spawn(async move { service.remove(&name("s")).await })
            })
            .collect();
        let mut dropped = 0;
        for task in droppers {
            match task.await.unwrap() {
                Ok(()) => dropped += 1,
                Err(ServiceError::NoSuchScene(_)) => {}
                Err(error) => panic!("{error}"),
            }
        }
        assert_eq!(dropped, 1);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_name_that_comes_and_goes_never_mixes_its_lives() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let lives = Arc::new(AtomicU64::new(0));
    let tasks: Vec<_> = (0..8u64)
        .map(|task| {
            let (service, lives) = (service.clone(), lives.clone());
            tokio::spawn(async move {
                let mut random = Random::new(task);
                for _ in 0..25 {
                    match random.below(3) {
                        0 => match service.remove(&name("s")).await {
                            Ok(()) | Err(ServiceError::NoSuchScene(_)) => {}
                            Err(error) => panic!("{error}"),
                        },
                        1 => {
                            let (_, new) = service
                                .create(&name("s"), edge(), None, "{}")
                                .await
                                .unwrap();
                            lives.fetch_add(u64::from(new), Ordering::Relaxed);
                        }
                        _ => {
                            let Ok(scene) = service.scene("s") else {
                                continue;
                            };
                            match scene.change(numbered(vec![place(0, 0, 0)], None)).await {
                                Ok(applied) => {
                                    let seq = applied.published.seq.0;
                                    assert_eq!(applied.assigned, Some((CubeId(seq), CubeId(seq))));
                                }
                                Err(ServiceError::NoSuchScene(_)) => {}
                                Err(error) => panic!("{error}"),
                            }
                        }
                    }
                }
            })
        })
        .collect();
    for task in tasks {
        task.await.unwrap();
    }
    assert!(lives.load(Ordering::Relaxed) > 1);
    let left = service
        .scene("s")
        .map(|scene| (scene.incarnation(), scene.published().unwrap()));
    service.shutdown().await;
    drop(service);
    let service = start(directory.path());
    match left {
        Ok((incarnation, published)) => {
            let scene = running(&service, "s");
            assert_eq!(scene.incarnation(), incarnation);
            assert_eq!(scene.published().unwrap(), published);
        }
        Err(_) => assert!(service.scenes().is_empty()),
    }
    let directories = std::fs::read_dir(directory.path().join("data/scenes")).unwrap();
    assert_eq!(directories.count(), service.scenes().len());
}

#[tokio::test]
async fn a_dropped_scene_is_gone_for_those_who_still_hold_it() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let scene = create(&service, "s").await;
    let mut updates = scene.subscribe().unwrap();
    let incarnation = scene.incarnation();
    service.remove(&name("s")).await.unwrap();
    assert!(updates.changed().await.is_err());
    for gone in [
        scene.published().err(),
        scene.change(insert(1, 0)).await.err(),
        scene.cube(CubeId(1)).await.err(),
        scene.at(Seq(0)).await.err(),
        service.scene("s").err(),
        service.remove(&name("s")).await.err(),
    ] {
        assert!(
            matches!(gone, Some(ServiceError::NoSuchScene(_))),
            "{gone:?}"
        );
    }
    let again = create(&service, "s").await;
    assert_ne!(again.incarnation(), incarnation);
    assert_eq!(again.published().unwrap().seq, Seq(0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_shutdown_loses_nothing_that_was_acknowledged_and_does_nothing_that_was_refused() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let scene = create(&service, "s").await;
    let acknowledged = Arc::new(AtomicUsize::new(0));
    let tasks: Vec<_> = (0..16u64)
        .map(|task| {
            let (scene, acknowledged) = (scene.clone(), acknowledged.clone());
            tokio::spawn(async move {
                let mut kept = Vec::new();
                for step in 0.. {
                    let id = 1 + task * 1_000_000 + step;
                    match scene.change(insert(id, 0)).await {
                        Ok(_) => kept.push(id),
                        Err(ServiceError::ShuttingDown) => break,
                        Err(error) => panic!("{error}"),
                    }
                    acknowledged.fetch_add(1, Ordering::Relaxed);
                }
                kept
            })
        })
        .collect();
    poll("some changes", || {
        (acknowledged.load(Ordering::Relaxed) > 100).then_some(())
    });
    service.shutdown().await;
    let mut kept = BTreeSet::new();
    for task in tasks {
        kept.extend(task.await.unwrap());
    }
    assert!(matches!(scene.published(), Err(ServiceError::ShuttingDown)));
    let refused = service.create(&name("t"), edge(), None, "{}").await;
    assert!(
        matches!(refused, Err(ServiceError::ShuttingDown)),
        "{refused:?}"
    );
    drop((scene, service));
    let service = start(directory.path());
    let scene = running(&service, "s");
    let (_, cubes) = scene.cubes().await.unwrap();
    let found: BTreeSet<u64> = cubes.into_iter().map(|(id, _)| id.0).collect();
    assert_eq!(found, kept);
}

#[tokio::test]
async fn waiting_for_a_seq_ends_with_it_or_with_the_time() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let scene = create(&service, "s").await;
    let none = scene
        .wait_for(Seq(1), Duration::from_millis(5))
        .await
        .unwrap();
    assert_eq!(none, None);
    let waits = {
        let scene = scene.clone();
        tokio::spawn(async move { scene.wait_for(Seq(2), Duration::from_secs(60)).await })
    };
    scene.change(insert(1, 0)).await.unwrap();
    scene.change(insert(2, 0)).await.unwrap();
    let reached: Published = waits.await.unwrap().unwrap().unwrap();
    assert_eq!(reached, scene.published().unwrap());
    assert_eq!(reached.seq, Seq(2));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_long_log_is_cut_by_a_snapshot_while_changes_go_on() {
    const CUBES: usize = 10_000;
    const KEPT: usize = 10;
    let directory = tempfile::tempdir().unwrap();
    let few = || ServiceConfig {
        history_changes_max: KEPT as u64,
        ..config(directory.path())
    };
    let service = Service::start(few()).unwrap();
    let scene = create(&service, "s").await;
    let mut random = Random::new(7);
    let mut live: Vec<u64> = Vec::new();
    let mut states = Vec::new();
    let mut greatest = 0;
    // Some 20 bytes a cube that do not compress: past what a log may be before a snapshot is due.
    for _ in 0..60 {
        let mut ops: Vec<Op> = live.drain(..).map(|id| Op::Delete(CubeId(id))).collect();
        for _ in 0..CUBES {
            let mut coordinate = || (random.next() >> 35).cast_signed() - (1 << 28);
            let at = place(coordinate(), coordinate(), coordinate());
            let id = random.next() >> 1;
            greatest = greatest.max(id);
            live.push(id);
            ops.push(Op::Insert(CubeId(id), at));
        }
        states.push(scene.change(named(ops)).await.unwrap().published);
    }
    let last = *states.last().unwrap();
    // Nobody asks for anything any more; the old totals go all the same.
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        match scene.at(Seq(1)).await {
            Err(ServiceError::SeqNotKept {
                seq: Seq(1),
                oldest,
            }) => {
                assert!(oldest > Seq(1) && oldest <= last.seq);
                break;
            }
            Ok(state) => assert_eq!(state, states[0]),
            Err(error) => panic!("{error}"),
        }
        assert!(Instant::now() < deadline, "the history was never cut");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    service.shutdown().await;
    drop((scene, service));
    let service = Service::start(few()).unwrap();
    let scene = running(&service, "s");
    assert_eq!(scene.published().unwrap(), last);
    for state in &states[states.len() - KEPT..] {
        assert_eq!(scene.at(state.seq).await.unwrap(), *state);
    }
    let (_, cubes) = scene.cubes().await.unwrap();
    let found: BTreeSet<u64> = cubes.into_iter().map(|(id, _)| id.0).collect();
    assert_eq!(found, live.into_iter().collect());
    let next = scene
        .change(numbered(vec![place(0, 0, 0)], None))
        .await
        .unwrap();
    assert_eq!(next.assigned.unwrap().0, CubeId(greatest + 1));
    let audit = scene.audit().await.unwrap();
    assert_eq!(audit.kept, audit.recounted);
    service.shutdown().await;
    // It was replayed from a snapshot, not from the first change.
    let keep = Keep {
        history_changes_max: u64::MAX,
        idempotency_keys_max: u64::MAX,
        revert_changes_max: 0,
        revert_bytes_max: 0,
        snapshot_log_bytes_min: u64::MAX,
        write_ahead_pages_max: u64::MAX,
    };
    let (mut log, _) = SceneLog::open(&directory.path().join("data/scenes/s"), keep).unwrap();
    let mut changes = 0;
    let mut snapshot = None;
    log.replay(&mut |_| (), &mut |step| {
        match step {
            Replayed::SnapshotBegin { .. } | Replayed::Cubes(_) => {}
            Replayed::SnapshotEnd { seq, totals, .. } => snapshot = Some((seq, *totals)),
            Replayed::Change(_) => changes += 1,
        }
        true
    })
    .unwrap();
    let (seq, totals) = snapshot.expect("the log was long enough for a snapshot");
    assert_eq!(totals, states[usize::try_from(seq.0).unwrap() - 1].totals);
    assert_eq!(seq.0 + changes, last.seq.0 + 1);
}

/// Files that version 0.1.0 wrote: a snapshot, what was trimmed behind it, changes with keys and moves, a revert, a
/// stock, and a write-ahead file as a crash leaves it.
#[tokio::test]
async fn files_of_version_0_1_0_open() {
    let directory = tempfile::tempdir().unwrap();
    let scene = directory.path().join("data/scenes/s");
    std::fs::create_dir_all(&scene).unwrap();
    for (name, bytes) in [
        (
            "scene.sqlite",
            &include_bytes!("data/scene-0.1.0/scene.sqlite.zst")[..],
        ),
        (
            "scene.sqlite-wal",
            include_bytes!("data/scene-0.1.0/scene.sqlite-wal.zst"),
        ),
        (
            "acknowledged",
            include_bytes!("data/scene-0.1.0/acknowledged.zst"),
        ),
    ] {
        std::fs::write(scene.join(name), zstd::decode_all(bytes).unwrap()).unwrap();
    }
    let service = Service::start(ServiceConfig {
        history_changes_max: 12,
        idempotency_keys_max: 6,
        revert_changes_max: 8,
        ..config(directory.path())
    })
    .unwrap();
    let scene = running(&service, "s");
    assert_eq!(scene.notices(), Vec::<String>::new());
    let cubes = [
        (2, [-2, 1, 1]),
        (3, [8, 4, 0]),
        (4, [2, -3, -2]),
        (5, [2, -3, -3]),
        (8, [8, 8, 1]),
        (9, [1, 7, 5]),
        (10, [8, 3, 0]),
        (11, [6, 4, 5]),
        (12, [20, 20, 20]),
    ];
    let mut listed = scene.cubes().await.unwrap().1;
    listed.sort_unstable_by_key(|(id, _)| *id);
    assert!(
        listed
            .iter()
            .map(|(id, place)| (id.0, place.corner()))
            .eq(cubes)
    );
    let edge = Edge::new(4).unwrap();
    let stock = Stock::new([0; 3], [9; 3]).unwrap();
    assert_eq!((scene.edge(), scene.stock()), (edge, Some(stock)));
    let published = scene.published().unwrap();
    let places = listed.iter().map(|(_, place)| *place);
    assert_eq!(published.totals, recount(edge, Some(stock), places));
    assert_eq!(published.seq, Seq(26));
    let rows = scene.history(Seq(0), Seq(99), None, 99).await.unwrap();
    let volumes: Vec<(u64, i128, i128, Option<u64>)> = rows
        .iter()
        .map(|row| {
            (
                row.seq.0,
                row.totals.measures.volume,
                row.volume_removed,
                row.motion.number,
            )
        })
        .collect();
    assert_eq!(
        volumes[12..],
        [
            (21, 416, -8, Some(200)),
            (22, 480, 6, None),
            (23, 456, -24, Some(202)),
            (24, 416, 36, None),
            (25, 416, -18, None),
            (26, 480, 0, None),
        ]
    );
    assert_eq!(volumes[0], (9, 456, -22, Some(108)));
    // A key of then is answered as it was.
    let again = numbered(vec![place(0, 0, 0)], Some(("numbered", 2)));
    let again = scene.change(again).await.unwrap();
    assert!(again.replayed);
    assert_eq!(again.published, published);
    assert_eq!(again.assigned, Some((CubeId(12), CubeId(12))));
    // And what was gone back from comes back.
    let revert = Submission {
        operations: Operations::Revert(Seq(23)),
        ..named(vec![])
    };
    let reverted = scene.change(revert).await.unwrap();
    assert_eq!(reverted.published.totals, rows[14].totals);
}

/// Snapshots of many small steps, with changes of all kinds between the steps: what is replayed from them is the state they were begun
/// at, with the changes since. Replay compares all totals, and refuses a scene whose snapshot is a mixture.
#[tokio::test]
async fn a_snapshot_is_of_one_state_while_changes_go_on() {
    for seed in 0..6 {
        let mut random = Random::new(seed);
        let directory = tempfile::tempdir().unwrap();
        let often = || ServiceConfig {
            history_changes_max: 10,
            revert_changes_max: 0,
            snapshot_log_bytes_min: 4_000,
            snapshot_step_cubes: 1 + usize::try_from(seed).unwrap() * 3,
            ..config(directory.path())
        };
        let mut service = Service::start(often()).unwrap();
        let mut scene = create(&service, "s").await;
        let mut model = Model::new();
        for _ in 0..300 {
            let mut ops = Vec::new();
            for _ in 0..=random.below(4) {
                let id = CubeId(1 + random.below(120));
                ops.push(Op::Delete(id));
                if random.below(5) > 0 {
                    ops.push(Op::Insert(id, random_place(&mut random)));
                }
            }
            model.apply(&ops).unwrap();
            scene.change(named(ops)).await.unwrap();
            if random.below(25) == 0 {
                service.shutdown().await;
                drop((scene, service));
                service = Service::start(often()).unwrap();
                scene = running(&service, "s");
                check_state(&scene, &model).await;
            }
        }
        let oldest = scene.at(Seq(1)).await;
        assert!(
            matches!(oldest, Err(ServiceError::SeqNotKept { oldest, .. }) if oldest > Seq(100)),
            "no snapshot has let the history be cut: {oldest:?}"
        );
    }
}

/// A change of a stream waits for room instead of being refused, and what was queued one after the other is judged in that order.
/// Where too little space is free nothing more is taken in; all that is there can be read, and a retry is answered.
#[tokio::test]
async fn a_disk_that_is_nearly_full_takes_no_changes() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let scene = create(&service, "s").await;
    let first = numbered(vec![place(0, 0, 0)], Some(("k", 1)));
    let before = scene.change(first.clone()).await.unwrap().published;
    drop((scene, service));
    let mut config = config(directory.path());
    config.disk_free_bytes_min = u64::MAX;
    let service = Service::start(config).unwrap();
    let scene = running(&service, "s");
    let full = |error: &ServiceError| matches!(error, ServiceError::Storage { full: true, .. });
    let refused = scene.change(insert(7, 9)).await.unwrap_err();
    assert!(full(&refused), "{refused}");
    let refused = service.create(&name("t"), edge(), None, "{}").await;
    assert!(full(&refused.unwrap_err()));
    assert!(scene.change(first).await.unwrap().replayed);
    let dry = Submission {
        operations: Operations::DryRun(Box::new(insert(7, 9).operations)),
        ..insert(7, 9)
    };
    assert_eq!(scene.change(dry).await.unwrap().counts.inserted, 1);
    assert_eq!(scene.published().unwrap(), before);
    assert_eq!(scene.cubes().await.unwrap().1.len(), 1);
}

#[tokio::test]
async fn there_are_no_more_scenes_than_may_be() {
    let directory = tempfile::tempdir().unwrap();
    let mut config = config(directory.path());
    config.scenes_max = 2;
    let service = Service::start(config).unwrap();
    for text in ["a", "b", "b"] {
        service
            .create(&name(text), edge(), None, "{}")
            .await
            .unwrap();
    }
    let refused = service.create(&name("c"), edge(), None, "{}").await;
    assert!(matches!(
        refused,
        Err(ServiceError::TooManyScenes { scenes: 2 })
    ));
    service.remove(&name("a")).await.unwrap();
    create(&service, "c").await;
}

/// An audit takes its memory of what is shared, and gives it back.
#[tokio::test]
async fn an_audit_that_finds_no_memory_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let mut config = config(directory.path());
    config.memory_bytes_max = 1000;
    let service = Service::start(config).unwrap();
    let scene = create(&service, "s").await;
    for id in 0..3 {
        scene.change(insert(id, 9)).await.unwrap();
    }
    for _ in 0..3 {
        let audit = scene.audit().await.unwrap();
        assert_eq!(audit.kept, audit.recounted);
    }
    scene.change(insert(3, 9)).await.unwrap();
    let refused = scene.audit().await;
    assert!(matches!(
        refused,
        Err(ServiceError::MemoryUsed { wanted: 512 })
    ));
    assert_eq!(service.budget().held(), 0);
}

/// A listing is of one seq whatever changes while it is read, and ends with the scene.
#[tokio::test]
async fn a_listing_is_of_one_seq_while_changes_go_on() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let scene = create(&service, "s").await;
    let mut random = Random::new(5);
    let places = (0..500).map(|_| random_place(&mut random)).collect();
    scene.change(numbered(places, None)).await.unwrap();
    let expected = scene.cubes().await.unwrap();
    let mut reading = scene.read_all().await.unwrap();
    assert_eq!(reading.seq(), expected.0);
    let mut listed = Vec::new();
    loop {
        let cubes = reading.next(7).await.unwrap();
        if cubes.is_empty() {
            break;
        }
        assert!(cubes.len() <= 7);
        listed.extend(cubes);
        let ops = (0..30).map(|_| random.below(600)).collect::<BTreeSet<_>>();
        let ops = ops.into_iter().flat_map(|id| {
            let place = random_place(&mut random);
            [Op::Delete(CubeId(id)), Op::Insert(CubeId(id), place)]
        });
        scene.change(named(ops.collect())).await.unwrap();
    }
    assert_eq!(listed, expected.1);
    assert!(scene.published().unwrap().seq > expected.0);

    let mut reading = scene.read_all().await.unwrap();
    reading.next(7).await.unwrap();
    service.remove(&name("s")).await.unwrap();
    let refused = reading.next(7).await;
    assert!(matches!(refused, Err(ServiceError::NoSuchScene(_))));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stream_waits_for_room_in_a_full_queue() {
    let directory = tempfile::tempdir().unwrap();
    let disk = Arc::new(TestDisk::default());
    let service = start_on(
        &disk,
        ServiceConfig {
            queue_changes_max: 2,
            ..config(directory.path())
        },
    );
    let scene = create(&service, "s").await;
    disk.hold(Some(FailPoint::Append));
    let first = scene.submit(insert(1, 0), None).await.unwrap();
    disk.wait_held();
    let mut queued: Vec<BoxFuture<'_, Result<Applied, ServiceError>>> = vec![Box::pin(first)];
    for id in 2..=3 {
        queued.push(Box::pin(scene.submit(insert(id, 0), None).await.unwrap()));
    }
    let refused = scene.change(insert(9, 0)).await;
    assert!(
        matches!(refused, Err(ServiceError::QueueFull { waiting: 2 })),
        "{refused:?}"
    );
    let waits = {
        let scene = scene.clone();
        tokio::spawn(async move {
            let mut queued = Vec::new();
            for id in 4..=8 {
                queued.push(scene.submit(insert(id, 0), None).await.unwrap());
            }
            queued
        })
    };
    disk.hold(None);
    queued.extend(
        waits
            .await
            .unwrap()
            .into_iter()
            .map(|answer| Box::pin(answer) as _),
    );
    for (seq, answer) in (1..).zip(queued) {
        assert_eq!(answer.await.unwrap().published.seq, Seq(seq));
    }
}

#[tokio::test]
async fn a_data_directory_has_one_service() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    let refused = Service::start(config(directory.path())).unwrap_err();
    assert!(
        refused.to_string().contains("in use by another"),
        "{refused}"
    );
    service.shutdown().await;
    drop(start(directory.path()));
}

#[tokio::test]
async fn what_an_earlier_life_left_is_cleaned() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path());
    create(&service, "s").await;
    drop(service);
    let data = directory.path().join("data");
    std::fs::create_dir_all(data.join("scenes/.union3d-temporary-remove-old/deep")).unwrap();
    let service = start(directory.path());
    running(&service, "s");
    assert!(!data.join("scenes/.union3d-temporary-remove-old").exists());
    assert_eq!(service.scenes().len(), 1);
}

#[test]
fn names_are_checked() {
    for good in ["a", "0", "a.b_c-d", &"x".repeat(63)] {
        assert_eq!(SceneName::new(good).unwrap().as_str(), good);
    }
    for bad in [
        "",
        "A",
        ".a",
        "-a",
        "_a",
        "a/b",
        "a b",
        "ä",
        "a\0",
        "..",
        &"x".repeat(64),
    ] {
        assert!(SceneName::new(bad).is_err(), "{bad:?}");
    }
}

/// What a move removed, that another cut nothing, and all parts of the stock: the same after a restart, from the log alone.
#[tokio::test]
async fn a_stock_and_its_moves_come_back_after_a_restart() {
    let directory = tempfile::tempdir().unwrap();
    let stock = Stock::new([0, 0, 0], [9, 9, 9]).unwrap();
    let moved = |number: u64, cubes: &[(u64, Place)]| {
        let insert = |&(id, place): &(u64, Place)| Op::Insert(CubeId(id), place);
        Submission {
            motion: Motion {
                number: Some(number),
                duration_ns: Some(500_000_000),
            },
            ..named(cubes.iter().map(insert).collect())
        }
    };
    // In the stock, across its border, beside it, and no cube at all: the last two remove nothing.
    let moves = [
        vec![(1, place(3, 3, 3))],
        vec![(2, place(-1, 0, 0)), (3, place(2, 0, 0))],
        vec![(4, place(9, 0, 0))],
        vec![],
    ];
    let removed: [i128; 4] = [27, 18 + 27, 0, 0];
    let service = start(directory.path());
    let (scene, _) = service
        .create(&name("s"), edge(), Some(stock), "{}")
        .await
        .unwrap();
    let mut cubes = BTreeMap::new();
    for ((cubes_of_move, removed), number) in moves.iter().zip(removed).zip(10..) {
        let applied = scene.change(moved(number, cubes_of_move)).await.unwrap();
        cubes.extend(cubes_of_move.iter().copied());
        assert_eq!(
            (applied.published.seq, applied.volume_removed),
            (Seq(number - 9), removed),
            "an air cut counts too"
        );
    }
    // Sent again: what is done already is not done, nor timed, a second time.
    let again = scene.change(moved(10, &moves[0])).await.unwrap();
    assert_eq!((again.published.seq, again.volume_removed), (Seq(4), 0));
    let before = scene.published().unwrap();
    assert_eq!(
        before.totals,
        recount(edge(), Some(stock), cubes.values().copied())
    );
    let rows = |scene: Arc<Scene>| async move {
        let rows = scene.history(Seq(1), Seq(9), Some([10, 14]), 100).await;
        rows.unwrap()
    };
    let history = rows(scene.clone()).await;
    let each: Vec<i128> = history.iter().map(|row| row.volume_removed).collect();
    assert_eq!(each, removed);
    service.shutdown().await;
    drop((scene, service));

    let service = start(directory.path());
    let scene = running(&service, "s");
    assert_eq!(scene.stock(), Some(stock));
    assert_eq!(scene.published().unwrap(), before);
    assert_eq!(rows(scene.clone()).await, history);
    let audit = scene.audit().await.unwrap();
    assert_eq!(audit.kept, audit.recounted);
    // Back to the first move, and on again: all parts of the stock with it.
    for seq in [Seq(1), Seq(4)] {
        let then = scene.at(seq).await.unwrap().totals;
        let revert = Submission {
            operations: Operations::Revert(seq),
            ..named(vec![])
        };
        let applied = scene.change(revert).await.unwrap();
        assert_eq!(applied.published.totals, then);
        let removed = if seq == Seq(1) { -45 } else { 45 };
        assert_eq!(applied.volume_removed, removed);
    }
    let parts = before.totals.stock.unwrap();
    assert_eq!(parts.removed.volume + parts.remaining.volume, 729);
}
