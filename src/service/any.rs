//! A scene of whichever kind: what the registry does with it, and what can be asked of it without knowing its kind.

use std::ops::Deref;
use std::sync::Arc;

use super::inbox::End;
use super::kind::SceneKind;
use super::load::Load;
use super::scene::{Scene, SceneOf};
use super::solids::Solids;
use super::{SceneName, SceneState, Seq, ServiceError};
use crate::log::Cubes;

/// A scene of solids.
pub type SolidScene = SceneOf<Solids>;

/// A scene of cubes or of solids.
#[derive(Clone, Debug)]
pub enum AnyScene {
    /// Of cubes.
    Cubes(Arc<Scene>),
    /// Of solids.
    Solids(Arc<SolidScene>),
}

/// What every scene is asked, whatever its kind.
pub trait SceneFacts: Send + Sync {
    /// Its name.
    fn name(&self) -> &SceneName;
    /// How it is.
    fn state(&self) -> SceneState;
    /// Newest durable change and the number of bodies; none while it does not answer.
    fn newest(&self) -> Option<(Seq, u64)>;
    /// Random name of this life of the scene. 0 while its log has not been opened.
    fn incarnation(&self) -> u64;
    /// Whether its log has been opened.
    fn is_open(&self) -> bool;
    /// Why it does not answer now.
    fn refusal(&self) -> ServiceError;
    /// Whether its first replay is under way.
    fn is_starting(&self) -> bool;
    /// How far that has come, in parts per thousand.
    fn start_permille(&self) -> u32;
    /// What waits in it now. Looks at its write-ahead file, no further I/O.
    fn load(&self) -> Load;
}

/// A kind that a scene of any kind may be of.
pub(super) trait OneOfAny: SceneKind {
    /// The scene as one of any kind.
    fn any(scene: Arc<SceneOf<Self>>) -> AnyScene;

    /// A scene of any kind as one of this.
    /// # Errors
    /// The scene, when it is of another kind.
    fn of(scene: AnyScene) -> Result<Arc<SceneOf<Self>>, AnyScene>;
}

impl OneOfAny for Cubes {
    fn any(scene: Arc<Scene>) -> AnyScene {
        AnyScene::Cubes(scene)
    }

    fn of(scene: AnyScene) -> Result<Arc<Scene>, AnyScene> {
        match scene {
            AnyScene::Cubes(scene) => Ok(scene),
            AnyScene::Solids(_) => Err(scene),
        }
    }
}

impl OneOfAny for Solids {
    fn any(scene: Arc<SolidScene>) -> AnyScene {
        AnyScene::Solids(scene)
    }

    fn of(scene: AnyScene) -> Result<Arc<SolidScene>, AnyScene> {
        match scene {
            AnyScene::Solids(scene) => Ok(scene),
            AnyScene::Cubes(_) => Err(scene),
        }
    }
}

/// What the registry does with every scene.
pub(super) trait Ends {
    /// Announces the end.
    fn announce_end(&self, end: End);
    /// Waits for it.
    fn finish_end(&self, end: End);
}

impl<K: SceneKind> SceneFacts for SceneOf<K> {
    fn name(&self) -> &SceneName {
        self.name()
    }

    fn state(&self) -> SceneState {
        self.state()
    }

    fn newest(&self) -> Option<(Seq, u64)> {
        let published = self.published().ok()?;
        Some((published.seq, K::count(&published.totals)))
    }

    fn incarnation(&self) -> u64 {
        self.incarnation()
    }

    fn is_open(&self) -> bool {
        self.has_header()
    }

    fn refusal(&self) -> ServiceError {
        self.refusal()
    }

    fn is_starting(&self) -> bool {
        self.is_starting()
    }

    fn start_permille(&self) -> u32 {
        self.start_permille()
    }

    fn load(&self) -> Load {
        self.load()
    }
}

impl<K: SceneKind> Ends for SceneOf<K> {
    fn announce_end(&self, end: End) {
        self.announce_end(end);
    }

    fn finish_end(&self, end: End) {
        self.finish_end(end);
    }
}

impl AnyScene {
    /// Its kind, in words.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Cubes(_) => "cubes",
            Self::Solids(_) => "solids",
        }
    }

    pub(super) fn ends(&self) -> &dyn Ends {
        match self {
            Self::Cubes(scene) => &**scene,
            Self::Solids(scene) => &**scene,
        }
    }
}

impl Deref for AnyScene {
    type Target = dyn SceneFacts;

    fn deref(&self) -> &Self::Target {
        match self {
            Self::Cubes(scene) => &**scene,
            Self::Solids(scene) => &**scene,
        }
    }
}
