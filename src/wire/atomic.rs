//! An atomic change, from what was sent to what came of it.

use std::sync::Arc;

use axum::body::Bytes;
use prost::Message;

use super::calls::digest;
use super::convert::Settings;
use super::decode::{self, Decoded};
use super::problem::{Code, Fault, Problem};
use super::proto;
use super::solids::DecodedSolids;
use crate::engine::{Rejected, solids};
use crate::geometry::CubeId;
use crate::service::{
    Applied, Counting, Kind, Operations, Scene, ServiceError, SolidScene, Solids, Submission,
};

/// What is larger is decoded on a thread that may take its time.
const DECODED_INLINE_BYTES_MAX: usize = 64 << 10;

/// A change as it was sent.
pub(super) enum Sent {
    /// A body of JSON.
    Json(Bytes),
    /// A body that is a message.
    Protobuf(Bytes),
    /// A message.
    Message(proto::Change),
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
    fn of<K: Kind>(self, operations: Operations<K>) -> Operations<K> {
        match self {
            Self::Real => operations,
            Self::Dry => Operations::DryRun(Box::new(operations)),
        }
    }
}

/// Applies an atomic change of solids; the answer means that it is durable.
pub(super) async fn apply_solids(
    scene: &SolidScene,
    decoded: DecodedSolids,
    run: Run,
    key: Option<(Box<str>, [u8; 32])>,
) -> Result<Applied<Solids>, Problem> {
    let submission = Submission {
        operations: run.of(decoded.operations),
        counting: Counting::Net,
        motion: decoded.motion,
        key,
    };
    match scene.change(submission).await {
        Err(ServiceError::RejectedSolids(solids::Rejected::IdConflict { index, id })) => {
            let pointer = format!("/insert/{}", index.saturating_sub(decoded.deletions));
            Err(conflict_of_solids(id, pointer))
        }
        answer => Ok(answer?),
    }
}

/// An atomic change on its way.
pub(super) struct Atomic {
    pub(super) scene: Arc<Scene>,
    pub(super) settings: Arc<Settings>,
    sent: Sent,
    cubes_max: usize,
}

impl Atomic {
    pub(super) fn new(
        scene: Arc<Scene>,
        settings: Arc<Settings>,
        sent: Sent,
        cubes_max: usize,
    ) -> Arc<Self> {
        Arc::new(Self {
            scene,
            settings,
            sent,
            cubes_max,
        })
    }

    /// Applies it; the answer means that it is durable.
    pub(super) async fn apply(
        self: &Arc<Self>,
        run: Run,
        key: Option<Box<str>>,
    ) -> Result<Applied, Problem> {
        let (mut submission, deletions) = self.submission(key).await?;
        submission.operations = run.of(submission.operations);
        let answer = self.scene.change(submission).await;
        self.judged(answer, deletions).await
    }

    /// What is submitted to the scene, and how many of its operations are deletions.
    pub(super) async fn submission(
        self: &Arc<Self>,
        key: Option<Box<str>>,
    ) -> Result<(Submission, usize), Problem> {
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

    /// What came of it, said in the client's words.
    pub(super) async fn judged(
        self: &Arc<Self>,
        answer: Result<Applied, ServiceError>,
        deletions: usize,
    ) -> Result<Applied, Problem> {
        match answer {
            Err(ServiceError::Rejected(rejected @ Rejected::IdConflict { .. })) => {
                // Either the scene has the id elsewhere, or the change itself names two places. The engine cannot tell them apart.
                self.off_thread(Self::duplicates).await?;
                Err(conflict(rejected, &self.settings, |index| {
                    self.pointer(index, deletions)
                }))
            }
            answer => Ok(answer?),
        }
    }

    fn decode(&self) -> Result<Decoded, Problem> {
        match &self.sent {
            Sent::Json(body) => decode::change(body, &self.settings, self.cubes_max),
            Sent::Protobuf(body) => decode::message(body, &self.settings, self.cubes_max),
            Sent::Message(message) => {
                decode::change_message(message, &self.settings, self.cubes_max)
            }
        }
    }

    /// An error when the change itself puts an id at two places.
    fn duplicates(&self) -> Result<(), Problem> {
        match &self.sent {
            Sent::Json(body) => {
                decode::change_faults(body, &self.settings, self.cubes_max).map(|_| ())
            }
            Sent::Protobuf(body) => decode::message_duplicates(body),
            Sent::Message(message) => decode::change_message_duplicates(message),
        }
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

    /// Where in the body an operation is.
    fn pointer(&self, index: usize, deletions: usize) -> String {
        let list = match &self.sent {
            Sent::Json(_) => "insert",
            Sent::Protobuf(_) | Sent::Message(_) => "insert_id",
        };
        format!("/{list}/{}", index.saturating_sub(deletions))
    }

    /// Runs long work where it does not hold up other requests.
    async fn off_thread<T: Send + 'static>(
        self: &Arc<Self>,
        work: impl FnOnce(&Self) -> Result<T, Problem> + Send + 'static,
    ) -> Result<T, Problem> {
        if self.size_bytes() <= DECODED_INLINE_BYTES_MAX {
            return work(self);
        }
        let this = Arc::clone(self);
        match tokio::task::spawn_blocking(move || work(&this)).await {
            Ok(done) => done,
            Err(error) => std::panic::resume_unwind(error.into_panic()),
        }
    }
}

/// The problem of an id that is at another place, said in user units. `pointer` gives the place of an operation in the body.
pub(super) fn conflict(
    rejected: Rejected,
    settings: &Settings,
    pointer: impl Fn(usize) -> String,
) -> Problem {
    let Rejected::IdConflict {
        index,
        id,
        there,
        asked,
    } = rejected
    else {
        return ServiceError::Rejected(rejected).into();
    };
    let (there, asked) = (settings.at(there), settings.at(asked));
    let detail = format!(
        "cube {id} is at {there:?}, so it cannot be inserted at {asked:?}",
        id = id.0
    );
    let fault = Fault {
        value: Some(serde_json::json!({"id": id.0, "at": asked})),
        ..Fault::at(pointer(index), format!("is at {there:?} already"), None)
    };
    Problem::new(Code::IdConflict, detail)
        .with("id", id.0)
        .with_fault(fault)
}

/// The problem of an id that has another body, which is inserted at `pointer`.
pub(super) fn conflict_of_solids(id: CubeId, pointer: String) -> Problem {
    let detail = format!(
        "solid {} is there already, with another body: delete it in the same change to put another in its place",
        id.0
    );
    let fault = Fault {
        value: Some(serde_json::json!({"id": id.0})),
        ..Fault::at(pointer, "has another body already", None)
    };
    Problem::new(Code::IdConflict, detail)
        .with("id", id.0)
        .with_fault(fault)
}
