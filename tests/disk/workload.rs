//! What is done to a data directory while its disk is recorded: everything that writes.
//!
//! Knows at every mark what was acknowledged, and the exact totals of every seq.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use union3d::engine::{Engine, Op};
use union3d::geometry::{CUBES_MAX, CubeId, Edge, Effect, Place, Stock, Totals};
use union3d::log::{Keep, Record, Replayed, SceneLog};
use union3d::service::{
    Counting, Motion, Operations, Published, Scene, SceneName, SceneState, Seq, Service,
    ServiceConfig, ServiceError, Submission,
};

use super::Random;
use super::disk::Disk;

/// A scene that was created: which of its lives, and its newest seq.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Acknowledged {
    pub(crate) life: u32,
    pub(crate) seq: u64,
}

/// Scenes by name.
pub(crate) type World = BTreeMap<String, Acknowledged>;

/// Exact totals by name, life and seq.
pub(crate) type TotalsBySeq = BTreeMap<(String, u32, u64), Totals>;

/// What was acknowledged, and when.
#[derive(Default)]
pub(crate) struct Story {
    /// By mark: what had been acknowledged when it was set. What is on its way from one to the next may be there or not.
    pub(crate) worlds: Vec<World>,
    pub(crate) totals: TotalsBySeq,
}

/// Where the data directory is on a disk: some way down, since the way is made too.
pub(crate) fn data(root: &Path) -> PathBuf {
    root.join("srv/machines/data")
}

pub(crate) fn edge() -> Edge {
    Edge::new(3).unwrap()
}

/// Snapshots are written all the time.
pub(crate) fn config(root: &Path) -> ServiceConfig {
    ServiceConfig {
        probe_interval: Duration::from_millis(1),
        snapshot_log_bytes_min: 400,
        ..ServiceConfig::new(data(root))
    }
}

/// Waits until a scene answers. It is never refused for good.
pub(crate) fn running(service: &Service, name: &str) -> Arc<Scene> {
    loop {
        match service.scene(name).map(|scene| (scene.state(), scene)) {
            Ok((SceneState::Running, scene)) => return scene,
            Ok((SceneState::Damaged { cause }, _)) | Err(ServiceError::Damaged { cause }) => {
                panic!("{name} is refused: {cause}")
            }
            Err(error @ ServiceError::NoSuchScene(_)) => panic!("{error}"),
            _ => std::thread::yield_now(),
        }
    }
}

/// A few operations on few ids in a small world: ties, moves and duplicates are the common case, conflicts are none.
pub(crate) fn random_ops(random: &mut Random) -> Vec<Op> {
    let mut ops = Vec::new();
    for _ in 0..random.within(1, 6) {
        let id = CubeId(1 + random.below(12));
        ops.push(Op::Delete(id));
        if random.below(4) > 0 {
            let corner = [0; 3].map(|_: i64| random.within(0, 6));
            ops.push(Op::Insert(id, Place::new(corner, edge()).unwrap()));
        }
    }
    ops
}

pub(crate) fn submission(operations: Operations) -> Submission {
    Submission {
        operations,
        counting: Counting::Net,
        motion: Motion::default(),
        key: None,
    }
}

/// Somebody who changes scenes on a disk and writes down what is acknowledged.
pub(crate) struct Client<'a> {
    disk: &'a Disk,
    random: Random,
    pub(crate) story: Story,
    world: World,
    lives: u32,
}

impl<'a> Client<'a> {
    pub(crate) fn new(disk: &'a Disk, seed: u64) -> Self {
        Self {
            disk,
            random: Random::new(seed),
            story: Story {
                worlds: vec![World::new()],
                ..Story::default()
            },
            world: World::new(),
            lives: 0,
        }
    }

    /// Goes on where another client was when the power failed: on the scenes that were found.
    pub(crate) fn go_on(disk: &'a Disk, seed: u64, world: World, mut totals: TotalsBySeq) -> Self {
        disk.mark(0);
        // What was on its way and is lost never was: other changes take its numbers.
        totals.retain(|(name, life, seq), _| {
            let there = world.get(name).filter(|there| there.life == *life);
            there.is_none_or(|there| *seq <= there.seq)
        });
        Self {
            lives: world.values().map(|scene| scene.life).max().unwrap_or(0),
            story: Story {
                worlds: vec![world.clone()],
                totals,
            },
            world,
            ..Self::new(disk, seed)
        }
    }

    /// Some changes to all scenes there are.
    pub(crate) async fn changes(&mut self) {
        let service = Service::start(config(self.disk.path())).unwrap();
        for name in self.world.clone().into_keys() {
            let scene = running(&service, &name);
            self.change(&scene).await;
            self.change(&scene).await;
        }
        service.shutdown().await;
    }

    /// All that writes, once or a few times.
    pub(crate) async fn everything(&mut self) {
        let service = Service::start(config(self.disk.path())).unwrap();
        let stock = Stock::new([0, 0, 0], [9, 9, 5]).unwrap();
        let part = self.create(&service, "part", Some(stock)).await;
        for _ in 0..5 {
            self.change(&part).await;
        }
        self.keyed(&part, "one").await;
        self.moved(&part).await;
        self.at_once(&part, 4).await;
        self.revert(&part, 3).await;
        self.change(&part).await;
        service.shutdown().await;
        drop((part, service));
        self.upkeep("part");
        let service = Service::start(config(self.disk.path())).unwrap();
        let part = running(&service, "part");
        self.change(&part).await;
        let other = self.create(&service, "other", None).await;
        self.change(&other).await;
        self.keyed(&part, "two").await;
        self.remove(&service, "part").await;
        let part = self.create(&service, "part", None).await;
        self.change(&part).await;
        self.change(&other).await;
        service.shutdown().await;
    }

    /// The same for a client whose disk fails now and then: it tries again until it is answered, and finds each change there whole or
    /// not at all.
    pub(crate) async fn in_spite_of_faults(&mut self) {
        for round in 0..2 {
            let service = self.start_again();
            let mut engine = self.create_again(&service, "part").await;
            for _ in 0..3 {
                self.change_again(&service, "part", &mut engine).await;
            }
            service.shutdown().await;
            drop(service);
            let service = self.start_again();
            self.change_again(&service, "part", &mut engine).await;
            self.change_again(&service, "part", &mut engine).await;
            if round == 0 {
                self.remove_again(&service, "part").await;
            }
            service.shutdown().await;
        }
    }

    fn start_again(&self) -> Service {
        loop {
            if let Ok(service) = Service::start(config(self.disk.path())) {
                return service;
            }
        }
    }

    async fn create_again(&mut self, service: &Service, name: &str) -> Engine {
        let scene = SceneName::new(name).unwrap();
        while let Err(error) = service.create(&scene, edge(), None, "{}").await {
            assert!(is_disk(&error), "{error}");
        }
        self.lives += 1;
        let life = self.lives;
        let seq = 0;
        self.world
            .insert(name.to_owned(), Acknowledged { life, seq });
        self.acknowledge(name, &running(service, name).published().unwrap());
        self.mark();
        Engine::new(edge())
    }

    async fn remove_again(&mut self, service: &Service, name: &str) {
        let scene = SceneName::new(name).unwrap();
        loop {
            match service.remove(&scene).await {
                Ok(()) | Err(ServiceError::NoSuchScene(_)) => break,
                Err(error) => assert!(is_disk(&error), "{error}"),
            }
        }
        self.world.remove(name);
        self.mark();
    }

    async fn change_again(&mut self, service: &Service, name: &str, engine: &mut Engine) {
        let ops = random_ops(&mut self.random);
        let effect = engine.judge(&ops, CUBES_MAX).unwrap().effect;
        if effect == Effect::default() {
            return;
        }
        let before = engine.totals();
        engine.apply(&effect).unwrap();
        let seq = self.world[name].seq;
        let published = loop {
            let scene = running(service, name);
            let change = submission(Operations::Named(ops.clone()));
            match scene.change(change).await {
                Ok(applied) => break applied.published,
                Err(error) => assert!(is_disk(&error), "{error}"),
            }
            let published = loop {
                match running(service, name).published() {
                    Ok(published) => break published,
                    Err(error) => assert!(is_disk(&error), "{error}"),
                }
            };
            if published.seq.0 > seq {
                break published;
            }
            assert_eq!((published.seq.0, published.totals), (seq, before));
        };
        assert_eq!(
            (published.seq.0, published.totals),
            (seq + 1, engine.totals())
        );
        self.acknowledge(name, &published);
        self.mark();
    }

    /// What was done so far has been acknowledged.
    fn mark(&mut self) {
        self.disk.mark(self.story.worlds.len());
        self.story.worlds.push(self.world.clone());
    }

    fn acknowledge(&mut self, name: &str, published: &Published) {
        let scene = self.world.get_mut(name).unwrap();
        scene.seq = scene.seq.max(published.seq.0);
        let key = (name.to_owned(), scene.life, published.seq.0);
        let earlier = self.story.totals.insert(key, published.totals);
        assert!(earlier.is_none_or(|totals| totals == published.totals));
    }

    async fn create(&mut self, service: &Service, name: &str, stock: Option<Stock>) -> Arc<Scene> {
        let scene = SceneName::new(name).unwrap();
        let (scene, is_new) = service.create(&scene, edge(), stock, "{}").await.unwrap();
        assert!(is_new);
        self.lives += 1;
        let life = self.lives;
        self.world
            .insert(name.to_owned(), Acknowledged { life, seq: 0 });
        self.acknowledge(name, &scene.published().unwrap());
        self.mark();
        scene
    }

    async fn remove(&mut self, service: &Service, name: &str) {
        service
            .remove(&SceneName::new(name).unwrap())
            .await
            .unwrap();
        self.world.remove(name);
        self.mark();
    }

    async fn submit(&mut self, scene: &Scene, submission: Submission) {
        let applied = scene.change(submission).await.unwrap();
        self.acknowledge(scene.name().as_str(), &applied.published);
        self.mark();
    }

    fn random_change(&mut self) -> Submission {
        submission(Operations::Named(random_ops(&mut self.random)))
    }

    async fn change(&mut self, scene: &Scene) {
        let submission = self.random_change();
        self.submit(scene, submission).await;
    }

    async fn keyed(&mut self, scene: &Scene, key: &str) {
        let submission = Submission {
            key: Some((key.into(), [7; 32])),
            ..self.random_change()
        };
        self.submit(scene, submission).await;
    }

    /// A move that cuts nothing.
    async fn moved(&mut self, scene: &Scene) {
        let motion = Motion {
            number: Some(17),
            duration_ns: Some(1),
        };
        let submission = Submission {
            motion,
            ..submission(Operations::Named(Vec::new()))
        };
        self.submit(scene, submission).await;
    }

    async fn revert(&mut self, scene: &Scene, seq: u64) {
        let submission = submission(Operations::Revert(Seq(seq)));
        self.submit(scene, submission).await;
    }

    /// Changes that may share commits.
    async fn at_once(&mut self, scene: &Scene, count: usize) {
        let changes = (0..count).map(|_| scene.change(self.random_change()));
        let changes: Vec<_> = changes.collect();
        for applied in futures_util::future::join_all(changes).await {
            self.acknowledge(scene.name().as_str(), &applied.unwrap().published);
        }
        self.mark();
    }

    /// A snapshot in several parts with changes between them, and then everything dropped that it makes superfluous.
    fn upkeep(&mut self, name: &str) {
        let keep = Keep {
            history_changes_max: 4,
            idempotency_keys_max: 0,
            revert_changes_max: 2,
            revert_bytes_max: 1 << 20,
            snapshot_log_bytes_min: 0,
        };
        let directory = data(self.disk.path()).join("scenes").join(name);
        let (mut log, notices) = SceneLog::open(&directory, keep).unwrap();
        assert_eq!(notices, Vec::<String>::new());
        let mut engine = Engine::new(edge()).with_stock(log.header().stock);
        log.replay(&mut |_| (), &mut |replayed| {
            match replayed {
                Replayed::Change(record) => engine.apply(&record.effect).unwrap(),
                Replayed::Cubes(cubes) => {
                    let inserted = cubes.to_vec();
                    let deleted = Vec::new();
                    engine.apply(&Effect { deleted, inserted }).unwrap();
                }
                Replayed::SnapshotBegin { .. } | Replayed::SnapshotEnd { .. } => {}
            }
            true
        })
        .unwrap();
        for _ in 0..2 {
            log.snapshot_begin(1, &engine.totals(), 13).unwrap();
            let cubes: Vec<_> = engine.cubes().collect();
            for part in cubes.chunks(cubes.len().div_ceil(2).max(1)) {
                log.snapshot_add(part).unwrap();
                self.append(name, &mut log, &mut engine);
            }
            log.snapshot_finish().unwrap();
            self.append(name, &mut log, &mut engine);
            while log.trim().unwrap() {}
        }
    }

    fn append(&mut self, name: &str, log: &mut SceneLog, engine: &mut Engine) {
        let ops = random_ops(&mut self.random);
        let effect: Effect = engine.judge(&ops, CUBES_MAX).unwrap().effect;
        engine.apply(&effect).unwrap();
        let published = Published {
            seq: Seq(log.seq().0 + 1),
            at_ms: 1,
            totals: engine.totals(),
        };
        let record = Record {
            seq: published.seq,
            at_ms: published.at_ms,
            effect,
            reverts_to: None,
            motion: Motion::default(),
            volume_removed: 0,
            totals: published.totals,
        };
        log.append(&[record], &[]).unwrap();
        self.acknowledge(name, &published);
        self.mark();
    }
}

/// What a disk is to blame for, and nothing else.
fn is_disk(error: &ServiceError) -> bool {
    matches!(
        error,
        ServiceError::Stopped { .. }
            | ServiceError::Storage { .. }
            | ServiceError::Recovering { .. }
    )
}
