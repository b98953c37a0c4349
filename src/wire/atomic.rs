//! An atomic change, from what was sent to what came of it.

use std::sync::Arc;

use axum::body::Bytes;
use prost::Message;

use super::calls::digest;
use super::convert::Settings;
use super::decode::{self, Decoded};
use super::kind::ShownKind;
use super::problem::{Code, Fault, Problem};
use super::proto;
use super::solids::SolidSettings;
use crate::engine::{Rejected, solids};
use crate::geometry::{CubeId, Edge};
use crate::service::{
    Applied, Chain, Counting, Cubes, Kind, Operations, SceneOf, ServiceError, Shapes, Solids,
    Submission,
};

/// A change as it was sent.
pub(super) enum Sent {
    /// A body of JSON.
    Json(Bytes),
    /// A body that is a message.
    Protobuf(Bytes),
    /// A message.
    Message(Box<proto::Change>),
}

impl Sent {
    /// Where in it an operation is.
    pub(super) fn pointer(&self, index: usize, deletions: usize) -> String {
        let list = match self {
            Self::Json(_) => "insert",
            Self::Protobuf(_) | Self::Message(_) => "insert_id",
        };
        format!("/{list}/{}", index.saturating_sub(deletions))
    }
}

/// A kind of scene, as its changes are sent.
pub(super) trait ChangedKind: ShownKind {
    /// What is larger is decoded on a thread that may take its time.
    const DECODED_INLINE_BYTES_MAX: usize;

    /// Reads a change of at most so many operations.
    fn decode(
        sent: &Sent,
        context: &Self::Context,
        settings: &Self::Settings,
        operations_max: usize,
    ) -> Result<Decoded<Self>, Problem>;

    /// Looks for what is wrong with a change by itself, where the engine refused an id. The engine cannot tell whether the scene has the id
    /// with another body, or the change names two.
    fn recheck(
        sent: &Sent,
        settings: &Self::Settings,
        operations_max: usize,
    ) -> Result<(), Problem>;

    /// Which operation inserts an id that the scene has with another body, and that problem, said in user units; any other error is given
    /// back. `pointer` gives the place of an operation in what was sent.
    fn conflict(
        error: ServiceError,
        settings: &Self::Settings,
        pointer: impl Fn(usize) -> String,
    ) -> Result<(usize, Problem), ServiceError>;
}

/// Whether a change is to be done.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Run {
    /// It is done.
    Real,
    /// The answer says what it would do.
    Dry,
}

impl Run {
    pub(super) fn of<K: Kind>(self, operations: Operations<K>) -> Operations<K> {
        match self {
            Self::Real => operations,
            Self::Dry => Operations::DryRun(Box::new(operations)),
        }
    }
}

/// An atomic change on its way.
pub(super) struct Atomic<K: ChangedKind> {
    pub(super) scene: Arc<SceneOf<K>>,
    pub(super) settings: Arc<K::Settings>,
    sent: Sent,
    operations_max: usize,
}

impl<K: ChangedKind> Atomic<K> {
    pub(super) fn new(
        scene: Arc<SceneOf<K>>,
        settings: Arc<K::Settings>,
        sent: Sent,
        operations_max: usize,
    ) -> Arc<Self> {
        Arc::new(Self {
            scene,
            settings,
            sent,
            operations_max,
        })
    }

    /// Applies it; the answer means that it is durable.
    pub(super) async fn apply(
        self: &Arc<Self>,
        run: Run,
        key: Option<Box<str>>,
    ) -> Result<Applied<K>, Problem> {
        let (mut submission, deletions) = self.submission(key).await?;
        submission.operations = run.of(submission.operations);
        let answer = self.scene.change(submission).await;
        self.judged(answer, deletions).await
    }

    /// What is submitted to the scene, and how many of its operations are deletions.
    async fn submission(
        self: &Arc<Self>,
        key: Option<Box<str>>,
    ) -> Result<(Submission<K>, usize), Problem> {
        let (decoded, key) = self
            .off_thread(move |this| {
                let decoded = this.decode()?;
                Ok((decoded, key.map(|key| (key, this.digest()))))
            })
            .await?;
        let submission = Submission {
            operations: decoded.operations,
            counting: Counting::Net,
            motion: decoded.motion,
            key,
        };
        Ok((submission, decoded.deletions))
    }

    /// Queues it behind those that were queued before, as soon as there is room; what this gives waits until it is durable. Of a chain
    /// nothing is applied after a change that was refused.
    pub(super) async fn queued(
        self: Arc<Self>,
        key: Option<Box<str>>,
        chain: Option<Chain>,
    ) -> Result<impl Future<Output = Result<Applied<K>, Problem>> + Send + use<K>, Problem> {
        let (submission, deletions) = self.submission(key).await?;
        let answer = self.scene.submit(submission, chain).await?;
        Ok(async move { self.judged(answer.await, deletions).await })
    }

    /// What came of it, said in the client's words.
    async fn judged(
        self: &Arc<Self>,
        answer: Result<Applied<K>, ServiceError>,
        deletions: usize,
    ) -> Result<Applied<K>, Problem> {
        let error = match answer {
            Ok(applied) => return Ok(applied),
            Err(error) => error,
        };
        let pointer = |index| self.sent.pointer(index, deletions);
        let (_, conflict) = K::conflict(error, &self.settings, pointer)?;
        self.off_thread(|this| K::recheck(&this.sent, &this.settings, this.operations_max))
            .await?;
        Err(conflict)
    }

    fn decode(&self) -> Result<Decoded<K>, Problem> {
        let context = self.scene.context()?;
        K::decode(&self.sent, &context, &self.settings, self.operations_max)
    }

    /// What an idempotency key stands for. A message counts as the body that it would be.
    fn digest(&self) -> [u8; 32] {
        match &self.sent {
            Sent::Json(body) => digest("application/json", body),
            Sent::Protobuf(body) => digest("application/x-protobuf", body),
            Sent::Message(message) => digest("application/x-protobuf", &message.encode_to_vec()),
        }
    }

    fn size_bytes(&self) -> usize {
        match &self.sent {
            Sent::Json(body) | Sent::Protobuf(body) => body.len(),
            Sent::Message(message) => message.encoded_len(),
        }
    }

    /// Runs long work where it does not hold up other requests.
    async fn off_thread<T: Send + 'static>(
        self: &Arc<Self>,
        work: impl FnOnce(&Self) -> Result<T, Problem> + Send + 'static,
    ) -> Result<T, Problem> {
        if self.size_bytes() <= K::DECODED_INLINE_BYTES_MAX {
            return work(self);
        }
        let this = Arc::clone(self);
        match tokio::task::spawn_blocking(move || work(&this)).await {
            Ok(done) => done,
            Err(error) => std::panic::resume_unwind(error.into_panic()),
        }
    }
}

impl ChangedKind for Cubes {
    const DECODED_INLINE_BYTES_MAX: usize = 64 << 10;

    fn decode(
        sent: &Sent,
        _: &Edge,
        settings: &Settings,
        cubes_max: usize,
    ) -> Result<Decoded, Problem> {
        match sent {
            Sent::Json(body) => decode::change(body, settings, cubes_max),
            Sent::Protobuf(body) => decode::message(body, settings, cubes_max),
            Sent::Message(message) => decode::change_message(message, settings, cubes_max),
        }
    }

    fn recheck(sent: &Sent, settings: &Settings, cubes_max: usize) -> Result<(), Problem> {
        match sent {
            Sent::Json(body) => decode::change_faults(body, settings, cubes_max).map(|_| ()),
            Sent::Protobuf(body) => decode::message_duplicates(body),
            Sent::Message(message) => decode::change_message_duplicates(message),
        }
    }

    fn conflict(
        error: ServiceError,
        settings: &Settings,
        pointer: impl Fn(usize) -> String,
    ) -> Result<(usize, Problem), ServiceError> {
        let (index, id, there, asked) = match error {
            ServiceError::Rejected(Rejected::IdConflict {
                index,
                id,
                there,
                asked,
            }) => (index, id, settings.at(there), settings.at(asked)),
            error => return Err(error),
        };
        let detail = format!(
            "cube {id} is at {there:?}, so it cannot be inserted at {asked:?}",
            id = id.0
        );
        let fault = Fault {
            value: Some(serde_json::json!({"id": id.0, "at": asked})),
            ..Fault::at(pointer(index), format!("is at {there:?} already"), None)
        };
        Ok((index, conflict(id, detail, fault)))
    }
}

impl ChangedKind for Solids {
    /// Hulls take their time.
    const DECODED_INLINE_BYTES_MAX: usize = 4 << 10;

    fn decode(
        sent: &Sent,
        shapes: &Shapes,
        settings: &SolidSettings,
        solids_max: usize,
    ) -> Result<Decoded<Self>, Problem> {
        let scale = settings.scale();
        match sent {
            Sent::Json(body) => decode::solid_change(body, shapes, scale, solids_max),
            Sent::Protobuf(body) => decode::solid_message(body, shapes, solids_max),
            Sent::Message(message) => decode::solid_change_message(message, shapes, solids_max),
        }
    }

    /// Nothing: decoding has looked.
    fn recheck(_: &Sent, _: &SolidSettings, _: usize) -> Result<(), Problem> {
        Ok(())
    }

    fn conflict(
        error: ServiceError,
        _: &SolidSettings,
        pointer: impl Fn(usize) -> String,
    ) -> Result<(usize, Problem), ServiceError> {
        let (index, id) = match error {
            ServiceError::RejectedSolids(solids::Rejected::IdConflict { index, id }) => (index, id),
            error => return Err(error),
        };
        let detail = format!(
            "solid {} is there already, with another body: delete it in the same change to put another in its place",
            id.0
        );
        let fault = Fault {
            value: Some(serde_json::json!({"id": id.0})),
            ..Fault::at(pointer(index), "has another body already", None)
        };
        Ok((index, conflict(id, detail, fault)))
    }
}

fn conflict(id: CubeId, detail: String, fault: Fault) -> Problem {
    Problem::new(Code::IdConflict, detail)
        .with("id", id.0)
        .with_fault(fault)
}
