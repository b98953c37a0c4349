//! Scenes of solids in the service, against a plain list of all their states: what is acknowledged, and what survives.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use union3d::engine::solids::{Body, Effect, Engine, Shape, Stock, Totals, recount};
use union3d::engine::{Counts, Op};
use union3d::geometry::CubeId;
use union3d::geometry::convex::{Point, Solid};
use union3d::log::LogError;
use union3d::service::{
    AnyAudit, Applied, Chain, Counting, FailHook, FailPoint, Motion, NamedShape, Offline,
    Operations, Published, SceneName, SceneState, Seq, Service, ServiceConfig, ServiceError,
    SolidScene, Solids, Submission,
};

#[path = "oracle/bodies.rs"]
mod bodies;
#[path = "oracle/random.rs"]
mod random;
use bodies::{cuboid, named, point, random_body, shapes};
use random::Random;

type Bodies = BTreeMap<CubeId, Body>;

fn name() -> SceneName {
    SceneName::new("part").unwrap()
}

fn config(directory: &Path) -> ServiceConfig {
    ServiceConfig {
        probe_interval: Duration::from_millis(10),
        ..ServiceConfig::new(directory.join("data"))
    }
}

async fn create(service: &Service, stock: Option<Stock>) -> Arc<SolidScene> {
    let created = service.create_solids(&name(), stock, &shapes(), "{}").await;
    created.unwrap().0
}

/// The scene once it runs.
fn running(service: &Service) -> Arc<SolidScene> {
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        match service.solid_scene("part") {
            Ok(scene) if scene.state() == SceneState::Running => return scene,
            _ => assert!(Instant::now() < deadline, "the scene does not come up"),
        }
        std::thread::yield_now();
    }
}

fn submission(operations: Operations<Solids>) -> Submission<Solids> {
    Submission {
        operations,
        counting: Counting::Net,
        motion: Motion::default(),
        key: None,
    }
}

async fn change(scene: &SolidScene, ops: &[Op<Body>]) -> Applied<Solids> {
    let operations = Operations::Named(ops.to_vec());
    scene.change(submission(operations)).await.unwrap()
}

fn random_change(
    random: &mut Random,
    shapes: &[Arc<Shape>],
    bodies: &Bodies,
) -> (Vec<Op<Body>>, Bodies) {
    let mut after = bodies.clone();
    let mut ops = Vec::new();
    for _ in 0..random.within(1, 4) {
        let id = CubeId(random.below(10));
        if after.remove(&id).is_some() {
            ops.push(Op::Delete(id));
        }
        if random.below(3) > 0 {
            let body = random_body(random, shapes);
            ops.push(Op::Insert(id, body.clone()));
            after.insert(id, body);
        }
    }
    (ops, after)
}

/// None, a box and a wedge with a slanted side.
fn stocks() -> [Option<Stock>; 3] {
    let wedge = [
        [0, 1, 0],
        [6, 1, 0],
        [0, 5, 0],
        [6, 5, 0],
        [1, 1, 5],
        [1, 5, 5],
    ]
    .map(point);
    let solids = [cuboid([1; 3], [5, 5, 4]), Solid::hull(&wedge).unwrap()];
    let [block, wedge] = solids.map(|solid| Stock::new(solid).unwrap());
    [None, Some(block), Some(wedge)]
}

/// What the scene answers is what its bodies come to.
async fn assert_holds(scene: &Arc<SolidScene>, stock: &Option<Stock>, bodies: &Bodies) {
    let published = scene.published().unwrap();
    assert_eq!(
        published.totals.union,
        recount(stock.clone(), bodies.values().cloned())
    );
    let (_, mut listed) = scene.bodies().await.unwrap();
    listed.sort_unstable_by_key(|(id, _)| *id);
    assert!(
        listed.iter().map(|(id, body)| (id, body)).eq(bodies),
        "the listing differs"
    );
}

/// Random changes, some of them back to an earlier state, with restarts, and snapshots all the time: totals, listing, history, past totals
/// and the audit of the files are those of the plain list.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_state_is_what_its_changes_made() {
    for (seed, stock) in (1..).zip(stocks()) {
        let mut random = Random::new(seed);
        let directory = tempfile::tempdir().unwrap();
        let config = || ServiceConfig {
            snapshot_log_bytes_min: 300,
            snapshot_step_cubes: 2,
            ..config(directory.path())
        };
        let mut service = Service::start(config()).unwrap();
        let stock = &stock;
        let mut scene = create(&service, stock.clone()).await;
        let mut states: Vec<Bodies> = vec![Bodies::new()];
        for step in 0..60 {
            let context = scene.context().unwrap();
            let shapes: Vec<_> = context.iter().map(|named| named.shape.clone()).collect();
            let newest = states.last().unwrap().clone();
            let seq = if random.below(6) == 0 {
                let to = random.below(states.len());
                let back = submission(Operations::Revert(Seq(to as u64)));
                let applied = scene.change(back).await.unwrap();
                if states[to] != newest {
                    states.push(states[to].clone());
                }
                applied.published.seq
            } else {
                let (ops, after) = random_change(&mut random, &shapes, &newest);
                let applied = change(&scene, &ops).await;
                if after != newest {
                    states.push(after);
                }
                applied.published.seq
            };
            assert_eq!(seq.0, states.len() as u64 - 1, "seed {seed}, step {step}");
            assert_holds(&scene, stock, states.last().unwrap()).await;
            if step % 20 == 19 {
                drop(scene);
                service.shutdown().await;
                let offline = Offline::open(&directory.path().join("data")).unwrap();
                let audit = offline.audit(&name(), &mut |_| ()).unwrap();
                assert!(matches!(audit.audit, AnyAudit::Solids(_)));
                assert!(audit.audit.is_equal(), "{:?}", audit.audit.shown());
                assert_eq!(audit.audit.bodies(), states.last().unwrap().len() as u64);
                drop(offline);
                service = Service::start(config()).unwrap();
                scene = running(&service);
                assert_holds(&scene, stock, states.last().unwrap()).await;
            }
        }
        for (seq, bodies) in (0..).zip(&states) {
            let totals = scene.at(Seq(seq)).await.unwrap().totals;
            assert_eq!(
                totals.union,
                recount(stock.clone(), bodies.values().cloned()),
                "seq {seq}"
            );
        }
        let last = Seq(states.len() as u64 - 1);
        let rows = scene.history(Seq(1), last, None, 1000).await.unwrap();
        let mut volume = 0;
        for row in rows {
            volume += row.volume_removed;
            assert_eq!(volume, row.totals.union.measures.volume6);
        }
        assert!(scene.audit().await.unwrap().is_equal());
        service.shutdown().await;
    }
}

/// What a change came to: its seq, counts, assigned ids, totals and volume, and whether it was a replayed answer; or the refusal.
type Answer = Result<(u64, Counts, Option<(CubeId, CubeId)>, Totals, i128, bool), String>;

/// What a scene must answer to changes that come one after the other.
struct OneByOne {
    engine: Engine,
    seq: u64,
    next_id: u64,
    keys: BTreeMap<Box<str>, ([u8; 32], Answer)>,
    /// Whether a change of the chain was refused.
    broken: bool,
}

impl OneByOne {
    fn answer(&mut self, submission: Submission<Solids>, is_chained: bool) -> Answer {
        if self.broken && is_chained {
            return Err(ServiceError::Abandoned.to_string());
        }
        let answer = self.judge(submission);
        self.broken |= answer.is_err();
        answer
    }

    fn judge(&mut self, submission: Submission<Solids>) -> Answer {
        if let Some((key, body)) = &submission.key
            && let Some((other, answer)) = self.keys.get(key)
        {
            let (seq, counts, assigned, totals, volume, _) = answer.clone().unwrap();
            return match other == body {
                true => Ok((seq, counts, assigned, totals, volume, true)),
                false => Err(ServiceError::KeyReused.to_string()),
            };
        }
        let (ops, assigned): (Vec<_>, _) = match submission.operations {
            Operations::Named(ops) => (ops, None),
            Operations::Numbered { delete, insert } => {
                let last = self.next_id + insert.len() as u64 - 1;
                let assigned = (CubeId(self.next_id), CubeId(last));
                let ids = (self.next_id..).map(CubeId);
                let inserts = ids.zip(insert).map(|(id, body)| Op::Insert(id, body));
                let ops = delete.into_iter().map(Op::Delete).chain(inserts);
                (ops.collect(), Some(assigned))
            }
            _ => unreachable!("the test sends none"),
        };
        let judged = self.engine.judge(&ops);
        let judged = judged.map_err(|refusal| ServiceError::from(refusal).to_string())?;
        let before = self.engine.totals();
        self.engine.apply(&judged.effect).unwrap();
        for (id, _) in &judged.effect.inserted {
            self.next_id = self.next_id.max(id.0 + 1);
        }
        let is_move = submission.motion.is_said() && judged.net.unchanged == 0;
        self.seq += u64::from(is_move || judged.effect != Effect::default());
        let totals = self.engine.totals();
        let volume = totals.measures.volume6 - before.measures.volume6;
        let answer = Ok((self.seq, judged.net, assigned, totals, volume, false));
        if let Some((key, body)) = submission.key {
            self.keys.insert(key, (body, answer.clone()));
        }
        answer
    }
}

/// A change of any kind: most insert one body.
fn random_submission(random: &mut Random, shapes: &[Arc<Shape>]) -> Submission<Solids> {
    let kind = match random.below(60) {
        0 => 0,
        _ => 1 + random.below(14),
    };
    let bodies = match kind {
        0 => 66,
        1..4 => 1,
        _ => random.within(1, 3),
    };
    let mut bodies: Vec<_> = (0..bodies).map(|_| random_body(random, shapes)).collect();
    let ids = [8, 1_000][random.below(2)];
    let mut id = || CubeId(random.below(ids) as u64);
    let operations = match kind {
        0 => Operations::Numbered {
            delete: vec![],
            insert: bodies,
        },
        1 => Operations::Named(vec![Op::Delete(id()), Op::Insert(id(), bodies.remove(0))]),
        2 => Operations::Named(vec![]),
        3 => Operations::Named(vec![Op::Delete(id())]),
        4..6 => Operations::Numbered {
            delete: (4..kind).map(|_| id()).collect(),
            insert: bodies,
        },
        _ => Operations::Named(
            bodies
                .into_iter()
                .map(|body| Op::Insert(id(), body))
                .collect(),
        ),
    };
    let key = (random.below(5) == 0).then(|| {
        let key = ["one", "two", "three", "four"][random.below(4)];
        (key.into(), [u8::from(random.below(4) == 0); 32])
    });
    let mut motion = Motion::default();
    if random.below(3) == 0 {
        motion.number = Some(random.below(9) as u64);
    }
    Submission {
        motion,
        key,
        ..submission(operations)
    }
}

/// Changes that wait for the disk together are answered as if they had come one by one: those that only insert, and those that name bodies
/// and keys of others that wait, alone and in a chain.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn changes_that_wait_together_are_answered_one_by_one() {
    for (seed, stock) in (1..7).zip(stocks().into_iter().cycle()) {
        let mut random = Random::new(seed);
        let directory = tempfile::tempdir().unwrap();
        // While it is taken, no change becomes durable.
        let held = Arc::new(tokio::sync::Mutex::new(()));
        let hook: FailHook = {
            let held = held.clone();
            Arc::new(move |point| {
                if point == FailPoint::Append {
                    drop(held.blocking_lock());
                }
                None
            })
        };
        let service = Service::start_with_failpoints(config(directory.path()), hook).unwrap();
        let scene = create(&service, stock.clone()).await;
        let context = scene.context().unwrap();
        let shapes: Vec<_> = context.iter().map(|named| named.shape.clone()).collect();
        let chain = (seed % 2 == 0).then(Chain::default);
        let mut expected = OneByOne {
            engine: Engine::new().with_stock(stock.clone()),
            seq: 0,
            next_id: 1,
            keys: BTreeMap::new(),
            broken: false,
        };
        for round in 0..3 {
            let mut answers = Vec::new();
            let hold = held.lock().await;
            for _ in 0..random.within(1, 40) {
                let change = random_submission(&mut random, &shapes);
                let answer = scene.submit(change.clone(), chain.clone()).await.unwrap();
                answers.push((change, answer));
            }
            drop(hold);
            for (number, (change, answer)) in answers.into_iter().enumerate() {
                let context = format!("seed {seed}, round {round}, change {number}: {change:?}");
                let answer: Answer =
                    answer
                        .await
                        .map_err(|refusal| refusal.to_string())
                        .map(|applied| {
                            let Published { seq, totals, .. } = applied.published;
                            let Applied {
                                counts,
                                assigned,
                                volume_removed,
                                replayed,
                                ..
                            } = applied;
                            (
                                seq.0,
                                counts,
                                assigned,
                                totals.union,
                                volume_removed,
                                replayed,
                            )
                        });
                assert_eq!(
                    answer,
                    expected.answer(change, chain.is_some()),
                    "{context}"
                );
            }
        }
        let bodies = expected.engine.solids();
        let bodies = bodies
            .map(|(id, body)| (CubeId(id.0), body.clone()))
            .collect();
        assert_holds(&scene, &stock, &bodies).await;
        drop(scene);
        service.shutdown().await;
        let service = Service::start(config(directory.path())).unwrap();
        assert_holds(&running(&service), &stock, &bodies).await;
        service.shutdown().await;
    }
}

/// A shape that was acknowledged is there after a restart, in its place; one that is there already changes nothing; another one of the
/// same name is refused.
#[tokio::test]
async fn shapes_are_part_of_the_log() {
    let directory = tempfile::tempdir().unwrap();
    let service = Service::start(config(directory.path())).unwrap();
    let scene = create(&service, None).await;
    let later = named("later", vec![cuboid([0; 3], [9, 1, 1])]);
    let define = |shape: &NamedShape| submission(Operations::Define(shape.definition()));
    for _ in 0..2 {
        let applied = scene.change(define(&later)).await.unwrap();
        assert_eq!(applied.published.seq, Seq(0), "a shape takes no seq");
    }
    let other = named("later", vec![cuboid([0; 3], [9, 1, 2])]);
    let refused = scene.change(define(&other)).await.unwrap_err();
    assert!(
        matches!(refused, ServiceError::NotDefined { .. }),
        "{refused}"
    );
    let shape = scene.context().unwrap().get("later").unwrap().shape.clone();
    let body = Body::swept(&shape, point([0; 3]), point([0, 5, 0])).unwrap();
    change(&scene, &[Op::Insert(CubeId(1), body.clone())]).await;
    service.shutdown().await;
    drop(scene);

    let service = Service::start(config(directory.path())).unwrap();
    let scene = running(&service);
    let context = scene.context().unwrap();
    let names: Vec<_> = context.iter().map(|named| named.name.as_str()).collect();
    assert_eq!(names, ["box", "tip", "two", "later"]);
    assert_eq!(context.get("later").unwrap().document, later.document);
    // A body from before the restart is the same body: a retry that comes late changes nothing.
    let again = change(&scene, &[Op::Insert(CubeId(1), body.clone())]).await;
    assert_eq!((again.counts.unchanged, again.published.seq), (1, Seq(1)));
    change(&scene, &[Op::Insert(CubeId(2), body)]).await;
    let back = scene.body(CubeId(2)).await.unwrap().unwrap();
    let (shape, ..) = back.sweep().unwrap();
    assert_eq!(context.of(shape).unwrap().name, "later");
    // Creating it again finds it, with the shapes it has; not with one that it has not.
    let (_, new) = service
        .create_solids(&name(), None, &[later], "{}")
        .await
        .unwrap();
    assert!(!new);
    let refused = service.create_solids(&name(), None, &[other], "{}").await;
    assert!(matches!(refused, Err(ServiceError::SceneExists { .. })));
    let refused = service.scene("part").unwrap_err();
    assert!(
        matches!(refused, ServiceError::OtherKind { .. }),
        "{refused}"
    );
    service.shutdown().await;
}

/// A write that fails stops the scene, which comes back as it was acknowledged, or with the whole change; and a body that was made
/// before is taken after.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_failed_write_loses_nothing_that_was_acknowledged() {
    for fail_at in [FailPoint::Append, FailPoint::Appended] {
        let directory = tempfile::tempdir().unwrap();
        let armed = Arc::new(std::sync::atomic::AtomicBool::new(false));
        let hook: FailHook = {
            let armed = armed.clone();
            Arc::new(move |point| {
                let fails =
                    point == fail_at && armed.swap(false, std::sync::atomic::Ordering::SeqCst);
                fails.then(|| LogError::Failed {
                    path: "as asked".into(),
                    cause: "as asked".to_owned(),
                })
            })
        };
        let service = Service::start_with_failpoints(config(directory.path()), hook).unwrap();
        let scene = create(&service, None).await;
        let context = scene.context().unwrap();
        let body = |x| {
            let shape = &context.get("two").unwrap().shape;
            Body::swept(shape, point([x, 0, 0]), point([x, 5, 1])).unwrap()
        };
        change(&scene, &[Op::Insert(CubeId(1), body(0))]).await;
        armed.store(true, std::sync::atomic::Ordering::SeqCst);
        let second = [Op::Insert(CubeId(2), body(3))];
        let operations = Operations::Named(second.to_vec());
        let refused = scene.change(submission(operations)).await.unwrap_err();
        assert!(matches!(refused, ServiceError::Stopped { .. }), "{refused}");
        let scene = running(&service);
        let retried = change(&scene, &second).await;
        assert_eq!(retried.published.seq, Seq(2));
        let expected = Bodies::from([(CubeId(1), body(0)), (CubeId(2), body(3))]);
        assert_holds(&scene, &None, &expected).await;
        service.shutdown().await;
    }
}

/// Whichever byte of the files is flipped: the scene is refused, or what it answers is right.
#[tokio::test]
async fn damage_is_refused_and_never_gives_a_wrong_total() {
    for stock in stocks() {
        damaged(stock).await;
    }
}

async fn damaged(stock: Option<Stock>) {
    let directory = tempfile::tempdir().unwrap();
    let service = Service::start(config(directory.path())).unwrap();
    let scene = create(&service, stock).await;
    let mut random = Random::new(1);
    let context = scene.context().unwrap();
    let shapes: Vec<_> = context.iter().map(|named| named.shape.clone()).collect();
    let mut bodies = Bodies::new();
    for _ in 0..12 {
        let (ops, after) = random_change(&mut random, &shapes, &bodies);
        change(&scene, &ops).await;
        bodies = after;
    }
    let expected = scene.published().unwrap();
    drop(scene);
    service.shutdown().await;
    let data = directory.path().join("data");
    let file = data.join("scenes/part/scene.sqlite");
    let good = fs::read(&file).unwrap();
    let mut refused = 0;
    for _ in 0..150 {
        let at = random.below(good.len());
        let mut bad = good.clone();
        bad[at] ^= 1 << random.below(8);
        fs::write(&file, &bad).unwrap();
        let offline = Offline::open(&data).unwrap();
        match offline.audit(&name(), &mut |_| ()) {
            Err(_) => refused += 1,
            Ok(audit) => {
                let AnyAudit::Solids(audit) = audit.audit else {
                    panic!("byte {at}: another kind");
                };
                assert!(audit.is_equal(), "byte {at}");
                assert_eq!(audit.kept, expected.totals, "byte {at}");
                assert_eq!(audit.seq, expected.seq, "byte {at}");
            }
        }
    }
    assert!(refused > 10, "only {refused} were refused");
}

/// The files of a scene say which version of their layout they need, so that a program that does not know it refuses them as newer than
/// itself: a stock that is no box needs a newer one, all else the oldest that there is.
#[tokio::test]
async fn a_stock_that_is_no_box_needs_a_newer_program() {
    let corners = |far: i64| {
        let corner = |number: i64| point([0, 1, 2].map(|axis| far * (number >> axis & 1)));
        let corners: Vec<Point> = (0..8).map(corner).collect();
        Stock::new(Solid::hull(&corners).unwrap()).unwrap()
    };
    let [_, block, wedge] = stocks();
    for (stock, format) in [(None, 4), (block, 4), (Some(corners(3)), 4), (wedge, 5)] {
        let directory = tempfile::tempdir().unwrap();
        let service = Service::start(config(directory.path())).unwrap();
        let scene = create(&service, stock.clone()).await;
        let body = Body::solid(cuboid([0; 3], [3; 3]));
        change(&scene, &[Op::Insert(CubeId(1), body)]).await;
        let expected = scene.published().unwrap();
        drop(scene);
        service.shutdown().await;
        let data = directory.path().join("data");
        let file = data.join("scenes/part/scene.sqlite");
        let mut bytes = fs::read(&file).unwrap();
        // SQLite's user version.
        assert_eq!(bytes[60..64], i32::to_be_bytes(format), "{stock:?}");

        let service = Service::start(config(directory.path())).unwrap();
        let scene = running(&service);
        assert_eq!(scene.published().unwrap().totals, expected.totals);
        // It is there with this stock, and with no other.
        let again = service.create_solids(&name(), stock, &[], "{}").await;
        assert!(!again.unwrap().1);
        let other = service
            .create_solids(&name(), Some(corners(7)), &[], "{}")
            .await;
        assert!(matches!(other, Err(ServiceError::SceneExists { .. })));
        drop(scene);
        service.shutdown().await;

        bytes = [&bytes[..60], &i32::to_be_bytes(6), &bytes[64..]].concat();
        fs::write(&file, bytes).unwrap();
        let offline = Offline::open(&data).unwrap();
        let refused = offline.audit(&name(), &mut |_| ()).unwrap_err();
        assert!(
            matches!(refused, LogError::Newer { format: 6, .. }),
            "{refused}"
        );
        assert!(refused.to_string().contains("of format 6"), "{refused}");
    }
}

/// Each byte of the stock in a scene's files is under a checksum.
#[tokio::test]
async fn a_damaged_stock_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let service = Service::start(config(directory.path())).unwrap();
    let [_, _, wedge] = stocks();
    drop(create(&service, wedge).await);
    service.shutdown().await;
    let data = directory.path().join("data");
    let file = data.join("scenes/part/scene.sqlite");
    let good = fs::read(&file).unwrap();
    // The six vertices of the wedge, all of whose coordinates are between 0 and 6.
    let is_vertex = |at: &[u8]| {
        let mut coordinates = at.chunks(4);
        coordinates.all(|bytes| bytes[0] <= 6 && bytes[1..] == [0; 3])
    };
    let is_stock = |at: &[u8]| at[0] == 6 && at[1..].chunks(12).all(is_vertex);
    let found = good
        .windows(1 + 6 * 12)
        .position(|at| is_stock(at) && at.contains(&5));
    let found = found.expect("the stock is in the file");
    let mut random = Random::new(1);
    for at in found..found + 1 + 6 * 12 {
        let mut bad = good.clone();
        bad[at] ^= 1 << random.below(8);
        fs::write(&file, &bad).unwrap();
        let offline = Offline::open(&data).unwrap();
        let refused = offline.audit(&name(), &mut |_| ()).unwrap_err();
        assert!(
            matches!(refused, LogError::Damaged { .. }),
            "byte {at}: {refused}"
        );
    }
}
