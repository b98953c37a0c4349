//! What is done to a data directory while its disk is recorded: everything that writes.
//!
//! Knows at every mark what was acknowledged, and the exact totals of every seq.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use union3d::engine::Op;
use union3d::geometry::{CubeId, Effect};
use union3d::log::{Keep, Kind, Log, Record, Replayed};
use union3d::service::{
    Counting, Motion, Operations, Published, SceneName, SceneOf, SceneState, Seq, Service,
    ServiceConfig, ServiceError, Submission,
};

use super::Random;
use super::disk::Disk;
use super::kinds::Tried;

/// A scene that was created: which of its lives, its newest seq, and how many definitions it has.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Acknowledged {
    pub(crate) life: u32,
    pub(crate) seq: u64,
    pub(crate) definitions: usize,
}

/// Scenes by name.
pub(crate) type World = BTreeMap<String, Acknowledged>;

/// Exact totals by name, life and seq.
pub(crate) type TotalsBySeq<K> = BTreeMap<(String, u32, u64), <K as Kind>::Totals>;

/// What was acknowledged, and when.
pub(crate) struct Story<K: Tried> {
    /// By mark: what had been acknowledged when it was set. What is on its way from one to the next may be there or not.
    pub(crate) worlds: Vec<World>,
    pub(crate) totals: TotalsBySeq<K>,
}

/// Where the data directory is on a disk: some way down, since the way is made too.
pub(crate) fn data(root: &Path) -> PathBuf {
    root.join("srv/machines/data")
}

/// What is kept where that does not matter.
pub(crate) const KEEP: Keep = Keep {
    history_changes_max: 9,
    idempotency_keys_max: 9,
    revert_changes_max: 0,
    revert_bytes_max: 0,
    snapshot_log_bytes_min: 0,
    write_ahead_pages_max: 1000,
};

/// Snapshots are written all the time, and the write-ahead file is moved into the database every few changes.
pub(crate) fn config(root: &Path) -> ServiceConfig {
    ServiceConfig {
        probe_interval: Duration::from_millis(1),
        snapshot_log_bytes_min: 400,
        write_ahead_pages_max: 8,
        ..ServiceConfig::new(data(root))
    }
}

/// The same, and little is kept: what a snapshot makes superfluous is dropped.
fn short_config(root: &Path) -> ServiceConfig {
    ServiceConfig {
        history_changes_max: 4,
        revert_changes_max: 2,
        ..config(root)
    }
}

/// Waits until a scene answers. It is never refused for good.
pub(crate) fn running<K: Tried>(service: &Service, name: &str) -> Arc<SceneOf<K>> {
    loop {
        match K::scene(service, name).map(|scene| (scene.state(), scene)) {
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
fn random_ops<K: Tried>(random: &mut Random, definitions: usize) -> Vec<Op<K::Body>> {
    let mut ops = Vec::new();
    for _ in 0..random.within(1, 6) {
        let id = CubeId(1 + random.below(12));
        ops.push(Op::Delete(id));
        if random.below(4) > 0 {
            ops.push(Op::Insert(id, K::body(random, definitions)));
        }
    }
    ops
}

pub(crate) fn submission<K: Tried>(operations: Operations<K>) -> Submission<K> {
    Submission {
        operations,
        counting: Counting::Net,
        motion: Motion::default(),
        key: None,
    }
}

/// Somebody who changes scenes on a disk and writes down what is acknowledged.
pub(crate) struct Client<'a, K: Tried> {
    disk: &'a Disk,
    random: Random,
    pub(crate) story: Story<K>,
    world: World,
    lives: u32,
}

impl<'a, K: Tried> Client<'a, K> {
    pub(crate) fn new(disk: &'a Disk, seed: u64) -> Self {
        Self {
            disk,
            random: Random::new(seed),
            story: Story {
                worlds: vec![World::new()],
                totals: TotalsBySeq::<K>::new(),
            },
            world: World::new(),
            lives: 0,
        }
    }

    /// Goes on where another client was when the power failed: on the scenes that were found.
    pub(crate) fn go_on(
        disk: &'a Disk,
        seed: u64,
        world: World,
        mut totals: TotalsBySeq<K>,
    ) -> Self {
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
            self.define(&scene).await;
            self.change(&scene).await;
        }
        service.shutdown().await;
    }

    /// All that writes, once or a few times.
    pub(crate) async fn everything(&mut self) {
        let service = Service::start(config(self.disk.path())).unwrap();
        let part = self.create(&service, "part", Some(K::stock())).await;
        for _ in 0..5 {
            self.change(&part).await;
        }
        self.keyed(&part, "one").await;
        self.define(&part).await;
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
            let last = self.change_again(&service, "part", &mut engine).await;
            self.revert_again(&service, "part", &mut engine, last).await;
            self.define_again(&service, "part").await;
            self.group_again(&service, "part", &mut engine).await;
            self.change_again(&service, "part", &mut engine).await;
            if round == 0 {
                self.remove_again(&service, "part", &mut engine).await;
            }
            service.shutdown().await;
        }
    }

    fn start_again(&self) -> Service {
        loop {
            if let Ok(service) = Service::start(short_config(self.disk.path())) {
                return service;
            }
        }
    }

    async fn create_again(&mut self, service: &Service, name: &str) -> K::Engine {
        let scene = SceneName::new(name).unwrap();
        while let Err(error) = K::create(service, &scene, None).await {
            assert!(is_disk(&error), "{error}");
        }
        self.created(&running(service, name));
        K::engine(&K::header()).unwrap()
    }

    /// When it fails, the scene comes back, and then it is there and is changed.
    async fn remove_again(&mut self, service: &Service, name: &str, engine: &mut K::Engine) {
        let scene = SceneName::new(name).unwrap();
        loop {
            let mut removed = self.world.clone();
            removed.remove(name);
            // On its way, until the next mark says what has come of it.
            self.story.worlds.push(removed.clone());
            match service.remove(&scene).await {
                Ok(()) => {
                    self.world = removed;
                    return self.mark();
                }
                Err(error) => assert!(is_disk(&error), "{error}"),
            }
            published_again::<K>(service, name);
            self.mark();
            self.change_again(service, name, engine).await;
        }
    }

    /// Defines what comes next, if anything does.
    async fn define_again(&mut self, service: &Service, name: &str) {
        let Some(definition) = K::definition(self.world[name].definitions) else {
            return;
        };
        let define = || submission(Operations::Define(definition.clone()));
        while let Err(error) = running::<K>(service, name).change(define()).await {
            assert!(is_disk(&error), "{error}");
        }
        self.defined(name);
    }

    /// Some change, and what it did.
    async fn change_again(
        &mut self,
        service: &Service,
        name: &str,
        engine: &mut K::Engine,
    ) -> Effect<K::Body> {
        let ops = self.random_ops(name);
        let effect = self.effect(engine, &ops);
        self.do_again(service, name, engine, &Operations::Named(ops), &effect)
            .await;
        effect
    }

    /// Goes back behind the last change.
    async fn revert_again(
        &mut self,
        service: &Service,
        name: &str,
        engine: &mut K::Engine,
        last: Effect<K::Body>,
    ) {
        let undone = Effect {
            deleted: last.inserted,
            inserted: last.deleted,
        };
        let before = self.world[name].seq.saturating_sub(1);
        self.do_again(
            service,
            name,
            engine,
            &Operations::Revert(Seq(before)),
            &undone,
        )
        .await;
    }

    /// Does what has this effect, unless that is nothing.
    async fn do_again(
        &mut self,
        service: &Service,
        name: &str,
        engine: &mut K::Engine,
        operations: &Operations<K>,
        effect: &Effect<K::Body>,
    ) {
        if *effect == Effect::default() {
            return;
        }
        let before = K::totals(engine);
        assert!(K::apply(engine, effect));
        let seq = self.world[name].seq;
        let published = loop {
            let change = submission(operations.clone());
            match running::<K>(service, name).change(change).await {
                Ok(applied) => break applied.published,
                Err(error) => assert!(is_disk(&error), "{error}"),
            }
            let published = published_again::<K>(service, name);
            if published.seq.0 > seq {
                break published;
            }
            assert_stands(&published, seq, &before);
        };
        assert_stands(&published, seq + 1, &K::totals(engine));
        self.acknowledge(name, &published);
        self.mark();
    }

    /// Changes that may share commits: each inserts a body of a new id. What was answered as failed and is there is not inserted twice.
    async fn group_again(&mut self, service: &Service, name: &str, engine: &mut K::Engine) {
        const CHANGES: u64 = 3;
        let Acknowledged {
            seq, definitions, ..
        } = self.world[name];
        let mut inserted = Vec::new();
        for index in 0..CHANGES {
            let body = K::body(&mut self.random, definitions);
            inserted.push((CubeId(100 + CHANGES * seq + index), body));
        }
        let mut waiting = inserted.clone();
        while !waiting.is_empty() {
            let scene = running::<K>(service, name);
            let changes = waiting.iter().cloned().map(|(id, body)| {
                scene.change(submission(Operations::Named(vec![Op::Insert(id, body)])))
            });
            let mut answers = futures_util::future::join_all(changes).await.into_iter();
            waiting.retain(|_| match answers.next().unwrap() {
                Ok(_) => false,
                Err(error) => {
                    assert!(is_disk(&error), "{error}");
                    true
                }
            });
        }
        let deleted = Vec::new();
        assert!(K::apply(engine, &Effect { deleted, inserted }));
        let published = published_again::<K>(service, name);
        assert_stands(&published, seq + CHANGES, &K::totals(engine));
        let rows = loop {
            let scene = running::<K>(service, name);
            match scene
                .history(Seq(seq + 1), published.seq, None, usize::MAX)
                .await
            {
                Ok(rows) => break rows,
                // A read that fails is damage to SQLite, and here nobody looks a second time.
                Err(ServiceError::Damaged { .. }) => {}
                Err(error) => assert!(is_disk(&error), "{error}"),
            }
        };
        assert_eq!(rows.len() as u64, CHANGES);
        for row in rows {
            let published = Published {
                seq: row.seq,
                at_ms: row.at_ms,
                totals: row.totals,
            };
            self.acknowledge(name, &published);
        }
        self.mark();
    }

    /// What was done so far has been acknowledged.
    fn mark(&mut self) {
        self.disk.mark(self.story.worlds.len());
        self.story.worlds.push(self.world.clone());
    }

    fn acknowledge(&mut self, name: &str, published: &Published<K>) {
        let scene = self.world.get_mut(name).unwrap();
        scene.seq = scene.seq.max(published.seq.0);
        let key = (name.to_owned(), scene.life, published.seq.0);
        let earlier = self.story.totals.insert(key, published.totals);
        assert!(earlier.is_none_or(|totals| totals == published.totals));
    }

    async fn create(
        &mut self,
        service: &Service,
        name: &str,
        stock: Option<K::Stock>,
    ) -> Arc<SceneOf<K>> {
        let scene = SceneName::new(name).unwrap();
        let (scene, is_new) = K::create(service, &scene, stock).await.unwrap();
        assert!(is_new);
        self.created(&scene);
        scene
    }

    fn created(&mut self, scene: &SceneOf<K>) {
        let name = scene.name().as_str();
        self.lives += 1;
        let acknowledged = Acknowledged {
            life: self.lives,
            seq: 0,
            definitions: K::DEFINED_FIRST,
        };
        self.world.insert(name.to_owned(), acknowledged);
        self.acknowledge(name, &scene.published().unwrap());
        self.mark();
    }

    async fn remove(&mut self, service: &Service, name: &str) {
        service
            .remove(&SceneName::new(name).unwrap())
            .await
            .unwrap();
        self.world.remove(name);
        self.mark();
    }

    async fn submit(&mut self, scene: &SceneOf<K>, submission: Submission<K>) {
        let applied = scene.change(submission).await.unwrap();
        self.acknowledge(scene.name().as_str(), &applied.published);
        self.mark();
    }

    fn random_ops(&mut self, name: &str) -> Vec<Op<K::Body>> {
        random_ops::<K>(&mut self.random, self.world[name].definitions)
    }

    fn effect(&self, engine: &K::Engine, ops: &[Op<K::Body>]) -> Effect<K::Body> {
        let judged = K::judge(engine, ops, &config(self.disk.path()));
        judged.unwrap().effect
    }

    fn random_change(&mut self, scene: &SceneOf<K>) -> Submission<K> {
        submission(Operations::Named(self.random_ops(scene.name().as_str())))
    }

    async fn change(&mut self, scene: &SceneOf<K>) {
        let submission = self.random_change(scene);
        self.submit(scene, submission).await;
    }

    /// Defines what comes next, if anything does.
    async fn define(&mut self, scene: &SceneOf<K>) {
        let name = scene.name().as_str();
        let Some(definition) = K::definition(self.world[name].definitions) else {
            return;
        };
        let submission = submission(Operations::Define(definition));
        scene.change(submission).await.unwrap();
        self.defined(name);
    }

    fn defined(&mut self, name: &str) {
        self.world.get_mut(name).unwrap().definitions += 1;
        self.mark();
    }

    async fn keyed(&mut self, scene: &SceneOf<K>, key: &str) {
        let submission = Submission {
            key: Some((key.into(), [7; 32])),
            ..self.random_change(scene)
        };
        self.submit(scene, submission).await;
    }

    /// A move that cuts nothing.
    async fn moved(&mut self, scene: &SceneOf<K>) {
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

    async fn revert(&mut self, scene: &SceneOf<K>, seq: u64) {
        let submission = submission(Operations::Revert(Seq(seq)));
        self.submit(scene, submission).await;
    }

    /// Changes that may share commits.
    async fn at_once(&mut self, scene: &SceneOf<K>, count: usize) {
        let changes = (0..count).map(|_| scene.change(self.random_change(scene)));
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
            write_ahead_pages_max: 1000,
        };
        let directory = data(self.disk.path()).join("scenes").join(name);
        let (mut log, notices) = Log::<K>::open(&directory, keep).unwrap();
        assert_eq!(notices, Vec::<String>::new());
        let mut engine = K::engine(log.header()).unwrap();
        log.replay(&mut |_| (), &mut |replayed| match replayed {
            Replayed::Change(record) => K::apply(&mut engine, &record.effect),
            Replayed::Cubes(bodies) => {
                let inserted = bodies.to_vec();
                let deleted = Vec::new();
                K::apply(&mut engine, &Effect { deleted, inserted })
            }
            Replayed::SnapshotBegin { .. } | Replayed::SnapshotEnd { .. } => true,
        })
        .unwrap();
        for _ in 0..2 {
            log.snapshot_begin(1, &K::totals(&engine), 13).unwrap();
            let bodies: Vec<_> = K::bodies_after(&engine, None).collect();
            for part in bodies.chunks(bodies.len().div_ceil(2).max(1)) {
                log.snapshot_add(part).unwrap();
                self.append(name, &mut log, &mut engine);
                log.checkpoint().unwrap();
            }
            if let Some(definition) = K::definition(self.world[name].definitions) {
                log.define(&definition).unwrap();
                self.defined(name);
            }
            log.snapshot_finish().unwrap();
            self.append(name, &mut log, &mut engine);
            while log.trim().unwrap() {}
        }
    }

    fn append(&mut self, name: &str, log: &mut Log<K>, engine: &mut K::Engine) {
        let ops = self.random_ops(name);
        let effect = self.effect(engine, &ops);
        assert!(K::apply(engine, &effect));
        let published = Published {
            seq: Seq(log.seq().0 + 1),
            at_ms: 1,
            totals: K::totals(engine),
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

/// Waits until a scene says where it is.
fn published_again<K: Tried>(service: &Service, name: &str) -> Published<K> {
    loop {
        match running::<K>(service, name).published() {
            Ok(published) => return published,
            Err(error) => assert!(is_disk(&error), "{error}"),
        }
    }
}

/// A scene is at this seq and has these totals.
#[track_caller]
fn assert_stands<K: Tried>(published: &Published<K>, seq: u64, totals: &K::Totals) {
    assert_eq!(published.seq.0, seq);
    let found = &published.totals;
    assert!(K::agree(found, totals), "{found:?} {totals:?}");
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
