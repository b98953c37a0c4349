//! All scenes of a data directory: which there are, how they come and go.
//!
//! ```text
//!   DATA/lock          held as long as the service lives
//!   DATA/scenes/NAME/  a scene's log: appears whole and goes whole, by a rename
//! ```

use std::collections::HashSet;
use std::fs::{self, File, TryLockError};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use dashmap::DashMap;
use parking_lot::{Condvar, Mutex, RwLock};

use super::any::{AnyScene, OneOfAny, SceneFacts, SolidScene};
use super::budget::Budget;
use super::failpoint::FailHook;
use super::gate::Gate;
use super::gauges::Gauges;
use super::inbox::End;
use super::kind::SceneKind;
use super::lifecycle::{self, keep, revive};
use super::scene::{Scene, SceneOf, Setup, blocking};
use super::solids::{NamedShape, Solids};
use super::writer::{Halt, Writer};
use super::{Readiness, SceneName, SceneState, ServiceConfig, ServiceError, StartError};
use crate::engine::solids;
use crate::geometry::{Edge, Stock};
use crate::log::{
    Cubes, FILE_MODE, Header, Kind, Log, LogError, close_to_others, create_directories, is_of,
    is_open_to_others, remove_leftovers, remove_scene,
};

/// All scenes of a data directory.
#[derive(Clone)]
pub struct Service(Arc<Registry>);

struct Registry {
    setup: Arc<Setup>,
    scenes: DashMap<Box<str>, AnyScene>,
    /// Names that are being created or dropped.
    busy: Busy,
    /// The scenes found at start, each with the size of its files in bytes: what `readiness` weighs.
    found: Vec<(AnyScene, u64)>,
    /// Whether the service shuts down. Creating and dropping hold it for reading, so shutting down waits for them.
    closing: RwLock<bool>,
    /// The locked file; closing it lets another service in.
    lock: Mutex<Option<File>>,
}

/// Names somebody works on: one at a time for each name.
#[derive(Default)]
struct Busy {
    names: Mutex<HashSet<SceneName>>,
    changed: Condvar,
}

struct BusyName<'a> {
    busy: &'a Busy,
    name: &'a SceneName,
}

impl std::fmt::Debug for Service {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("Service")
            .field("data", &self.0.setup.config.data)
            .field("scenes", &self.0.scenes.len())
            .finish()
    }
}

impl Service {
    /// Locks the data directory and starts to replay its scenes in the background.
    /// # Errors
    /// The directory cannot be used, or another service uses it.
    pub fn start(config: ServiceConfig) -> Result<Self, StartError> {
        Self::open(config, None)
    }

    /// As [`Service::start`], on a disk that fails when the hook says so. For tests only.
    /// # Errors
    /// As [`Service::start`].
    pub fn start_with_failpoints(
        config: ServiceConfig,
        fail_hook: FailHook,
    ) -> Result<Self, StartError> {
        Self::open(config, Some(fail_hook))
    }

    fn open(config: ServiceConfig, fail_hook: Option<FailHook>) -> Result<Self, StartError> {
        create_directories(&config.data).map_err(|error| unusable(&config.data, &error))?;
        let lock = lock_data(&config.data)?;
        let scenes = config.data.join("scenes");
        let failed = |doing: &str, error: &io::Error| {
            StartError(format!("cannot {doing} {}: {error}", scenes.display()))
        };
        create_directories(&scenes).map_err(|error| failed("create", &error))?;
        remove_leftovers(&scenes).map_err(|error| failed("clean", &error))?;
        close(&config.data, &scenes);
        let setup = Arc::new(Setup {
            gate: Gate::new(config.replays_max),
            budget: Budget::new(config.memory_bytes_max),
            config,
            fail_hook,
        });
        let mut found = Vec::new();
        let entries = fs::read_dir(&scenes).and_then(Iterator::collect::<io::Result<Vec<_>>>);
        for entry in entries.map_err(|error| failed("read", &error))? {
            let path = entry.path();
            match SceneName::new(&entry.file_name().to_string_lossy()) {
                Ok(name) if path.is_dir() => {
                    tell_open(&path, close_to_others(&path));
                    let bytes = size_bytes(&path);
                    found.push((unopened(name, path, &setup), bytes));
                }
                _ => tracing::warn!("{} is no scene; left alone", path.display()),
            }
        }
        let registry = Registry {
            setup,
            scenes: found
                .iter()
                .map(|(scene, _)| (scene.name().as_str().into(), scene.clone()))
                .collect(),
            busy: Busy::default(),
            found,
            closing: RwLock::new(false),
            lock: Mutex::new(Some(lock)),
        };
        for (scene, _) in &registry.found {
            start(scene).map_err(|error| {
                StartError(format!(
                    "cannot start a thread for scene {}: {error}",
                    scene.name().as_str()
                ))
            })?;
        }
        Ok(Self(Arc::new(registry)))
    }

    /// The memory that requests share.
    pub fn budget(&self) -> &Budget {
        &self.0.setup.budget
    }

    /// Whether the replay that began at start is done.
    pub fn readiness(&self) -> Readiness {
        let waiting = self.0.found.iter().any(|(scene, _)| scene.is_starting());
        if waiting {
            let sum = |part: &dyn Fn(&dyn SceneFacts) -> u32| -> u128 {
                let weighed = self.0.found.iter();
                weighed
                    .map(|(scene, bytes)| u128::from(part(&**scene)) * u128::from(bytes + 1))
                    .sum()
            };
            let percent = 100 * sum(&|scene| scene.start_permille()) / sum(&|_| 1000).max(1);
            return Readiness::Recovering {
                percent: u8::try_from(percent).map_or(99, |percent| percent.min(99)),
            };
        }
        let troubled = self.scenes().into_iter().filter_map(|scene| {
            let cause = match scene.state() {
                SceneState::Running => return None,
                SceneState::Recovering { percent } => format!("is being replayed: {percent} %"),
                SceneState::Stopped { cause, .. }
                | SceneState::Damaged { cause }
                | SceneState::Newer { cause } => cause,
            };
            Some((scene.name().clone(), cause))
        });
        Readiness::Ready {
            troubled: troubled.collect(),
        }
    }

    /// Creates a scene, durably; true when it is new, false when it was there with the same settings.
    ///
    /// Once begun, it goes on even when the future is dropped.
    /// # Errors
    /// [`ServiceError::SceneExists`] with other settings; the scene's own trouble when it is there but does not run.
    pub async fn create(
        &self,
        name: &SceneName,
        edge: Edge,
        stock: Option<Stock>,
        settings: &str,
    ) -> Result<(Arc<Scene>, bool), ServiceError> {
        let new = NewScene::<Cubes> {
            edge_steps: edge.steps().cast_unsigned(),
            stock,
            settings: settings.to_owned(),
            definitions: Vec::new(),
        };
        self.create_of(name, new).await
    }

    /// Creates a scene of solids with these shapes, as [`Service::create`] does one of cubes. One that was there has all the shapes.
    /// # Errors
    /// As of [`Service::create`].
    pub async fn create_solids(
        &self,
        name: &SceneName,
        stock: Option<solids::Stock>,
        shapes: &[NamedShape],
        settings: &str,
    ) -> Result<(Arc<SolidScene>, bool), ServiceError> {
        let new = NewScene::<Solids> {
            edge_steps: 0,
            stock,
            settings: settings.to_owned(),
            definitions: shapes.iter().map(NamedShape::definition).collect(),
        };
        self.create_of(name, new).await
    }

    async fn create_of<K: OneOfAny>(
        &self,
        name: &SceneName,
        new: NewScene<K>,
    ) -> Result<(Arc<SceneOf<K>>, bool), ServiceError> {
        let (registry, name) = (self.0.clone(), name.clone());
        blocking(move || registry.create(&name, &new)).await?
    }

    /// Drops a scene with its data.
    ///
    /// Once begun, it goes on even when the future is dropped.
    /// # Errors
    /// [`ServiceError::NoSuchScene`], also for those who come second.
    pub async fn remove(&self, name: &SceneName) -> Result<(), ServiceError> {
        let (registry, name) = (self.0.clone(), name.clone());
        blocking(move || registry.remove(&name)).await?
    }

    /// A scene by name, of whichever kind.
    /// # Errors
    /// [`ServiceError::NoSuchScene`]; and why it does not answer, while its settings are not even known (its log has not been opened).
    pub fn any_scene(&self, name: &str) -> Result<AnyScene, ServiceError> {
        let scene = self
            .0
            .scenes
            .get(name)
            .map(|scene| scene.clone())
            .ok_or_else(|| ServiceError::NoSuchScene(name.to_owned()))?;
        if scene.is_open() {
            Ok(scene)
        } else {
            Err(scene.refusal())
        }
    }

    /// A scene of cubes by name.
    /// # Errors
    /// As of [`Service::any_scene`], and [`ServiceError::OtherKind`].
    pub fn scene(&self, name: &str) -> Result<Arc<Scene>, ServiceError> {
        of_kind::<Cubes>(self.any_scene(name)?)
    }

    /// A scene of solids by name.
    /// # Errors
    /// As of [`Service::any_scene`], and [`ServiceError::OtherKind`].
    pub fn solid_scene(&self, name: &str) -> Result<Arc<SolidScene>, ServiceError> {
        of_kind::<Solids>(self.any_scene(name)?)
    }

    /// All scenes, by name.
    pub fn scenes(&self) -> Vec<AnyScene> {
        let mut scenes: Vec<_> = self.0.scenes.iter().map(|scene| scene.clone()).collect();
        scenes.sort_by(|a, b| a.name().cmp(b.name()));
        scenes
    }

    /// What there is now, of all scenes together. Looks at a file of each, so it may block for a moment.
    pub fn gauges(&self) -> Gauges {
        let data = &self.0.setup.config.data;
        Gauges::new(&self.scenes(), &self.readiness(), data)
    }

    /// Refuses new changes, finishes those that wait, closes the logs.
    pub async fn shutdown(&self) {
        let registry = self.0.clone();
        // It fails only with a runtime that goes down; then the drop of the registry does the same work.
        let _late = blocking(move || registry.shut_down()).await;
    }
}

impl Registry {
    fn create<K: OneOfAny>(
        self: &Arc<Self>,
        name: &SceneName,
        new: &NewScene<K>,
    ) -> Result<(Arc<SceneOf<K>>, bool), ServiceError> {
        let _open = self.stay_open()?;
        let _busy = self.busy.enter(name);
        if let Some(scene) = self.scenes.get(name.as_str()).map(|scene| scene.clone()) {
            if !scene.is_open() {
                return Err(scene.refusal());
            }
            let scene = of_kind::<K>(scene)?;
            return if new.is(&scene)? {
                Ok((scene, false))
            } else {
                Err(ServiceError::SceneExists {
                    name: name.0.clone(),
                    settings: scene.settings().to_owned(),
                })
            };
        }
        self.setup.check_disk()?;
        // With those that are being made; one that is being dropped counts twice until it is gone.
        let scenes = self.scenes.len() + self.busy.names.lock().len();
        if scenes > self.setup.config.scenes_max {
            return Err(ServiceError::TooManyScenes {
                scenes: self.scenes.len(),
            });
        }
        let scene = Arc::new(SceneOf::<K>::new(
            name.clone(),
            self.directory(name),
            self.setup.clone(),
        ));
        let header = Header {
            incarnation: uuid::Uuid::new_v4().as_u64_pair().1,
            edge_steps: new.edge_steps,
            stock: new.stock.clone(),
            settings: new.settings.clone(),
        };
        let begun = Log::<K>::create_with(
            &scene.directory,
            &header,
            &new.definitions,
            keep(&self.setup.config),
        )
        .map_err(Halt::from)
        .and_then(|log| revive(&scene, log))
        .map_err(refusal)
        .and_then(|writer| {
            // Before the thread runs: the answer to `create` must not be followed by a refusal.
            writer.begin(&scene);
            spawn(&scene, Some(writer)).map_err(|error| storage(&error))
        });
        if let Err(error) = begun {
            // Nobody was told of the scene: it must not be there after a restart either.
            if scene.directory.exists()
                && let Err(error) = discard(&scene.directory)
            {
                tracing::error!("{} is left: {error}", scene.directory.display());
            }
            return Err(error);
        }
        tracing::info!(scene = name.as_str(), "created");
        self.scenes
            .insert(name.as_str().into(), K::any(scene.clone()));
        Ok((scene, true))
    }

    fn remove(self: &Arc<Self>, name: &SceneName) -> Result<(), ServiceError> {
        let _open = self.stay_open()?;
        let _busy = self.busy.enter(name);
        let Some(scene) = self.scenes.get(name.as_str()).map(|scene| scene.clone()) else {
            return Err(ServiceError::NoSuchScene(name.0.clone()));
        };
        scene.ends().announce_end(End::Dropped);
        scene.ends().finish_end(End::Dropped);
        match discard(&self.directory(name)) {
            Ok(()) => {
                self.scenes.remove(name.as_str());
                tracing::info!(scene = name.as_str(), "dropped");
                Ok(())
            }
            Err(error) => {
                // It is still there, so it goes on: replayed from its files.
                let again = unopened(name.clone(), self.directory(name), &self.setup);
                start(&again).map_err(|error| storage(&error))?;
                self.scenes.insert(name.as_str().into(), again);
                Err(storage(&error))
            }
        }
    }

    fn shut_down(&self) {
        *self.closing.write() = true;
        let scenes: Vec<_> = self.scenes.iter().map(|scene| scene.clone()).collect();
        for scene in &scenes {
            scene.ends().announce_end(End::Shutdown);
        }
        for scene in &scenes {
            scene.ends().finish_end(End::Shutdown);
        }
        self.lock.lock().take();
    }

    /// Refuses when the service shuts down, else keeps it from doing so.
    fn stay_open(&self) -> Result<parking_lot::RwLockReadGuard<'_, bool>, ServiceError> {
        let closing = self.closing.read();
        if *closing {
            Err(ServiceError::ShuttingDown)
        } else {
            Ok(closing)
        }
    }

    fn directory(&self, name: &SceneName) -> PathBuf {
        self.setup.config.data.join("scenes").join(name.as_str())
    }
}

impl Drop for Registry {
    fn drop(&mut self) {
        self.shut_down();
    }
}

impl Busy {
    /// Waits until nobody else works on `name`.
    fn enter<'a>(&'a self, name: &'a SceneName) -> BusyName<'a> {
        let mut names = self.names.lock();
        while !names.insert(name.clone()) {
            self.changed.wait(&mut names);
        }
        BusyName { busy: self, name }
    }
}

impl Drop for BusyName<'_> {
    fn drop(&mut self) {
        self.busy.names.lock().remove(self.name);
        self.busy.changed.notify_all();
    }
}

/// What a scene is created with.
struct NewScene<K: Kind> {
    edge_steps: u32,
    stock: Option<K::Stock>,
    settings: String,
    definitions: Vec<Box<[u8]>>,
}

impl<K: OneOfAny> NewScene<K> {
    /// Whether a scene that is there is such a one.
    fn is(&self, scene: &SceneOf<K>) -> Result<bool, ServiceError> {
        let header = scene.header().expect("it is open");
        let settings = (header.edge_steps, &header.stock, &header.settings)
            == (self.edge_steps, &self.stock, &self.settings);
        // Without definitions nobody is asked, so that a scene of cubes is found while it is stopped.
        let defined = self.definitions.is_empty() || {
            let context = scene.context()?;
            let mut definitions = self.definitions.iter();
            definitions.all(|definition| K::is_defined(&context, definition))
        };
        Ok(settings && defined)
    }
}

/// A scene of this kind.
fn of_kind<K: OneOfAny>(scene: AnyScene) -> Result<Arc<SceneOf<K>>, ServiceError> {
    K::of(scene).map_err(|scene| ServiceError::OtherKind {
        name: scene.name().as_str().to_owned(),
        kind: scene.kind(),
    })
}

/// How often the files of a scene are asked of which kind it is while they cannot be read, and how long is waited in between.
const FORMAT_LOOKS: usize = 16;
const FORMAT_PAUSE: Duration = Duration::from_millis(10);

/// The scene of a directory, whose files say of which kind it is. What kind a scene is taken for it stays until the next start, so a read
/// that fails is not believed at once.
fn unopened(name: SceneName, directory: PathBuf, setup: &Arc<Setup>) -> AnyScene {
    let mut is_of_solids = is_of::<Solids>(&directory);
    for _ in 1..FORMAT_LOOKS {
        if is_of_solids.is_ok() {
            break;
        }
        std::thread::sleep(FORMAT_PAUSE);
        is_of_solids = is_of::<Solids>(&directory);
    }
    let setup = setup.clone();
    if matches!(is_of_solids, Ok(true)) {
        AnyScene::Solids(Arc::new(SceneOf::new(name, directory, setup)))
    } else {
        // Files that do not tell are damaged, as the log will say.
        AnyScene::Cubes(Arc::new(SceneOf::new(name, directory, setup)))
    }
}

/// Starts the thread of a scene whose log has not been opened.
fn start(scene: &AnyScene) -> io::Result<()> {
    match scene {
        AnyScene::Cubes(scene) => spawn(scene, None),
        AnyScene::Solids(scene) => spawn(scene, None),
    }
}

/// Starts the thread that owns the scene.
fn spawn<K: SceneKind>(scene: &Arc<SceneOf<K>>, writer: Option<Writer<K>>) -> io::Result<()> {
    let owned = scene.clone();
    let thread = std::thread::Builder::new()
        .name(format!("scene {}", scene.name().as_str()))
        .spawn(move || lifecycle::run(&owned, writer))?;
    scene.keep_thread(thread);
    Ok(())
}

/// How long a start waits for another service to let go of the data directory, and how often it looks.
const LOCK_PATIENCE: Duration = Duration::from_secs(2);
const LOCK_PAUSE: Duration = Duration::from_millis(20);

/// Keeps others from what an earlier version, or somebody else, left open to them. The data directory itself is its owner's to close: it may
/// hold more than what is ours.
fn close(data: &Path, scenes: &Path) {
    tell_open(scenes, close_to_others(scenes));
    if is_open_to_others(data).unwrap_or(false) {
        tracing::info!("others may enter {}, but not what is in it", data.display());
    }
}

/// Says what stays open.
fn tell_open(path: &Path, closed: io::Result<()>) {
    if let Err(error) = closed {
        tracing::warn!(
            "cannot keep others from {}: {error}; its scenes can be read by who may enter it",
            path.display()
        );
    }
}

/// Opens and locks `DATA/lock`: as long as the file is open, no other service uses the directory.
pub(super) fn lock_data(data: &Path) -> Result<File, StartError> {
    let lock = File::options()
        .create(true)
        .append(true)
        .mode(FILE_MODE)
        .open(data.join("lock"))
        .map_err(|error| unusable(data, &error))?;
    // A server that was killed a moment ago may not have let go yet: whoever restarts it at once is not refused.
    let deadline = Instant::now() + LOCK_PATIENCE;
    let locked = loop {
        match lock.try_lock() {
            Err(TryLockError::WouldBlock) if Instant::now() < deadline => {
                std::thread::sleep(LOCK_PAUSE);
            }
            locked => break locked,
        }
    };
    match locked {
        Ok(()) => Ok(lock),
        Err(TryLockError::WouldBlock) => Err(StartError(format!(
            "the data directory {} is in use by another union3d; stop that one, or name another directory with --data",
            data.display()
        ))),
        Err(TryLockError::Error(error)) => Err(unusable(data, &error)),
    }
}

fn unusable(data: &Path, error: &io::Error) -> StartError {
    StartError(format!(
        "cannot use the data directory {}: {error}; name another with --data",
        data.display()
    ))
}

/// Bytes of the files directly in a directory, as far as they can be seen.
fn size_bytes(directory: &Path) -> u64 {
    let Ok(entries) = fs::read_dir(directory) else {
        return 0;
    };
    let sizes = entries.filter_map(|entry| entry.ok()?.metadata().ok());
    sizes.map(|file| file.len()).sum()
}

/// Takes a scene's files away: durably when it returns.
fn discard(directory: &Path) -> io::Result<()> {
    if let Some(error) = remove_scene(directory)? {
        tracing::warn!(
            "some of {} is left until the next start: {error}",
            directory.display()
        );
    }
    Ok(())
}

fn storage(error: &io::Error) -> ServiceError {
    ServiceError::Storage {
        cause: error.to_string(),
        full: error.kind() == io::ErrorKind::StorageFull,
    }
}

/// Why a scene could not be created.
fn refusal(halt: Halt) -> ServiceError {
    match halt {
        // Nothing was in it yet that could be damaged: the disk has failed.
        Halt::Log(error @ (LogError::Damaged { .. } | LogError::Foreign { .. })) => {
            ServiceError::Storage {
                cause: error.to_string(),
                full: false,
            }
        }
        Halt::Log(error) => error.into(),
        Halt::Ended => ServiceError::ShuttingDown,
    }
}
