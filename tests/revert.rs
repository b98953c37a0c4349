//! Reverting: a scene's set of cubes made what it was, against a plain list of all its states.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures_util::future::join_all;
use union3d::engine::{Op, recount};
use union3d::geometry::{CubeId, Edge, Place};
use union3d::service::{
    Applied, Counting, Motion, Operations, Scene, SceneName, SceneState, Seq, Service,
    ServiceConfig, ServiceError, Submission,
};

#[path = "oracle/random.rs"]
mod random;
use random::Random;

type Cubes = BTreeMap<CubeId, Place>;

fn edge() -> Edge {
    Edge::new(4).unwrap()
}

fn start(directory: &Path, limit: u64) -> Service {
    let config = ServiceConfig {
        revert_changes_max: limit,
        ..ServiceConfig::new(directory.join("data"))
    };
    Service::start(config).unwrap()
}

fn scene(service: &Service) -> Arc<Scene> {
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        match service.scene("s") {
            Ok(scene) if scene.state() == SceneState::Running => return scene,
            _ => assert!(Instant::now() < deadline, "the scene does not come up"),
        }
        std::thread::yield_now();
    }
}

fn submission(operations: Operations, key: Option<(&str, u8)>) -> Submission {
    Submission {
        operations,
        counting: Counting::Net,
        motion: Motion::default(),
        key: key.map(|(key, body)| (key.into(), [body; 32])),
    }
}

async fn revert(scene: &Scene, to: u64) -> Result<Applied, ServiceError> {
    scene
        .change(submission(Operations::Revert(Seq(to)), None))
        .await
}

fn random_change(random: &mut Random, cubes: &Cubes) -> (Vec<Op>, Cubes) {
    let mut after = cubes.clone();
    let mut ops = Vec::new();
    for _ in 0..random.within(1, 6) {
        let id = CubeId(random.below(12));
        if after.remove(&id).is_some() {
            ops.push(Op::Delete(id));
        }
        if random.below(3) > 0 {
            let corner = [0; 3].map(|_: i32| random.within(0, 9));
            let place = Place::new(corner, edge()).unwrap();
            ops.push(Op::Insert(id, place));
            after.insert(id, place);
        }
    }
    (ops, after)
}

/// Random changes, some of them back to a random earlier state, several at once so that they share a commit, with restarts.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn any_earlier_state_comes_back() {
    for seed in 0..12 {
        let mut random = Random::new(seed);
        let directory = tempfile::tempdir().unwrap();
        let mut service = start(directory.path(), 1_000);
        let name = SceneName::new("s").unwrap();
        service.create(&name, edge(), None, "{}").await.unwrap();
        // The cubes at every seq.
        let mut states: Vec<Cubes> = vec![Cubes::new()];
        for round in 0..25 {
            let here = scene(&service);
            let mut expected = Vec::new();
            let mut submissions = Vec::new();
            for _ in 0..random.within(1, 5) {
                let last = states.last().unwrap();
                let (operations, after) = if random.below(3) == 0 {
                    let to = random.below(states.len() as u64);
                    let then = states[to as usize].clone();
                    (Operations::Revert(Seq(to)), then)
                } else {
                    let (ops, after) = random_change(&mut random, last);
                    (Operations::Named(ops), after)
                };
                if after != *last {
                    states.push(after);
                }
                expected.push(Seq(states.len() as u64 - 1));
                submissions.push(submission(operations, None));
            }
            // Polled in their order, so queued in their order.
            let answers = join_all(submissions.into_iter().map(|change| here.change(change))).await;
            for (answer, seq) in answers.into_iter().zip(expected) {
                let published = answer.unwrap().published;
                assert_eq!(published.seq, seq, "seed {seed}, round {round}");
                let cubes = states[seq.0 as usize].values().copied();
                assert_eq!(
                    published.totals,
                    recount(edge(), None, cubes),
                    "seed {seed}, round {round}"
                );
            }
            let (_, cubes) = here.cubes().await.unwrap();
            assert_eq!(
                cubes.into_iter().collect::<Cubes>(),
                *states.last().unwrap(),
                "seed {seed}, round {round}"
            );
            drop(here);
            if random.below(8) == 0 {
                service.shutdown().await;
                drop(service);
                service = start(directory.path(), 1_000);
            }
        }
        // The history is as it was.
        let here = scene(&service);
        for (seq, cubes) in states.iter().enumerate() {
            let then = here.at(Seq(seq as u64)).await.unwrap();
            let cubes = cubes.values().copied();
            assert_eq!(
                then.totals,
                recount(edge(), None, cubes),
                "seed {seed}, seq {seq}"
            );
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_has_not_come_is_refused_and_a_key_is_answered_once() {
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path(), 1_000);
    let name = SceneName::new("s").unwrap();
    let (here, _) = service.create(&name, edge(), None, "{}").await.unwrap();
    for id in 0..3 {
        let place = Place::new([id * 10, 0, 0], edge()).unwrap();
        let ops = vec![Op::Insert(CubeId(id as u64), place)];
        here.change(submission(Operations::Named(ops), None))
            .await
            .unwrap();
    }
    let refused = revert(&here, 4).await.unwrap_err();
    assert!(matches!(
        refused,
        ServiceError::SeqNotReached {
            seq: Seq(4),
            newest: Seq(3)
        }
    ));
    // Where it is already: nothing to do.
    let same = revert(&here, 3).await.unwrap();
    assert_eq!((same.published.seq, same.counts.deleted), (Seq(3), 0));
    let keyed = || submission(Operations::Revert(Seq(1)), Some(("back", 1)));
    let back = here.change(keyed()).await.unwrap();
    assert_eq!(
        (back.published.seq, back.published.totals.cubes),
        (Seq(4), 1)
    );
    assert_eq!(
        (back.counts.inserted, back.counts.deleted, back.replayed),
        (0, 2, false)
    );
    let again = here.change(keyed()).await.unwrap();
    assert_eq!((again.published, again.replayed), (back.published, true));
    let forward = revert(&here, 3).await.unwrap();
    assert_eq!(forward.published.totals, same.published.totals);
}

/// Once a snapshot has made operations superfluous only as many are kept as the setting says; what cannot be reached is
/// refused with the oldest that can.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn how_far_back_is_a_setting() {
    const CUBES: u64 = 10_000;
    const KEPT: u64 = 7;
    let directory = tempfile::tempdir().unwrap();
    let service = start(directory.path(), KEPT);
    let name = SceneName::new("s").unwrap();
    let (here, _) = service.create(&name, edge(), None, "{}").await.unwrap();
    let mut random = Random::new(3);
    let mut live: Vec<CubeId> = Vec::new();
    let mut totals = Vec::new();
    for _ in 0..60 {
        let mut ops: Vec<Op> = live.drain(..).map(Op::Delete).collect();
        for _ in 0..CUBES {
            let corner = [0; 3].map(|_: i32| random.within(-(1 << 28), 1 << 28));
            let id = CubeId(random.next() >> 1);
            live.push(id);
            ops.push(Op::Insert(id, Place::new(corner, edge()).unwrap()));
        }
        let change = submission(Operations::Named(ops), None);
        totals.push(here.change(change).await.unwrap().published.totals);
    }
    let newest = totals.len() as u64;
    // Dropping goes on in the background, down to what is kept.
    let deadline = Instant::now() + Duration::from_secs(60);
    let oldest = loop {
        match revert(&here, 0).await {
            Err(ServiceError::NotReachable {
                seq: Seq(0),
                oldest,
            }) if oldest >= Seq(20) => {
                break oldest.0;
            }
            Err(ServiceError::NotReachable { .. }) => {}
            Ok(_) => {
                // Nothing was dropped yet: undo the revert.
                revert(&here, newest).await.unwrap();
            }
            Err(error) => panic!("{error}"),
        }
        assert!(Instant::now() < deadline, "operations were never dropped");
        tokio::time::sleep(Duration::from_millis(5)).await;
    };
    assert!(oldest + KEPT <= here.published().unwrap().seq.0);
    let refused = revert(&here, oldest - 1).await.unwrap_err();
    assert!(matches!(refused, ServiceError::NotReachable { oldest: at, .. } if at.0 >= oldest));
    service.shutdown().await;
    drop((here, service));
    let service = start(directory.path(), KEPT);
    let here = scene(&service);
    let newest = here.published().unwrap();
    let back = revert(&here, newest.seq.0 - 3).await.unwrap();
    assert_eq!(
        back.published.totals,
        here.at(Seq(newest.seq.0 - 3)).await.unwrap().totals
    );
    let forward = revert(&here, newest.seq.0).await.unwrap();
    assert_eq!(forward.published.totals, newest.totals);
}
