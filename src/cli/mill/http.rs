//! A program on its way over HTTP: batches of changes, one of them in flight while the next is made.

use std::sync::Arc;

use prost::Message;
use serde_json::Value;
use serde_json::value::RawValue;
use tokio::task::JoinHandle;
use uuid::Uuid;

use super::super::client::{Client, Failure};
use union3d::wire::proto::{Change, ChangeBatch, KeyedChange};

/// A batch is sent when it has so many changes ..
const BATCH_CHANGES: usize = 256;
/// .. or so many bytes.
const BATCH_BYTES: usize = 1 << 20;

/// What is said of an answer that is none.
pub(super) const UNREADABLE: &str =
    "cannot make sense of the server's answer (is it of the same version?)";

/// A change that is durable.
pub(super) struct Done<T> {
    /// What it is for its sender.
    pub(super) what: T,
    /// What the API answers to it.
    pub(super) answer: Value,
}

/// A scene of a server, and the changes on their way into it. `T` is what each change is for its sender.
pub(super) struct HttpStream<T> {
    client: Client,
    /// Names this run in the keys of its changes, so that those sent twice act once.
    run: Uuid,
    sent: u64,
    waiting: Vec<(T, KeyedChange)>,
    waiting_bytes: usize,
    in_flight: Option<InFlight<T>>,
}

/// A batch that has been sent.
struct InFlight<T> {
    whats: Vec<T>,
    batch: Arc<ChangeBatch>,
    answer: JoinHandle<Result<Vec<Value>, Failure>>,
}

impl<T> HttpStream<T> {
    pub(super) fn new(client: Client) -> Self {
        Self {
            client,
            run: Uuid::new_v4(),
            sent: 0,
            waiting: Vec::new(),
            waiting_bytes: 0,
            in_flight: None,
        }
    }

    /// The calls of its server.
    pub(super) fn client(&self) -> &Client {
        &self.client
    }

    /// Sends a change on its way; answers those that are done by now.
    pub(super) async fn send(&mut self, what: T, change: Change) -> Result<Vec<Done<T>>, String> {
        self.sent += 1;
        let change = KeyedChange {
            change: Some(change),
            idempotency_key: Some(format!("{}-{}", self.run.simple(), self.sent)),
        };
        self.waiting_bytes += change.encoded_len();
        self.waiting.push((what, change));
        if self.waiting.len() < BATCH_CHANGES && self.waiting_bytes < BATCH_BYTES {
            return Ok(vec![]);
        }
        self.flush().await
    }

    /// Waits for all that is on its way; then what the scene measures, too.
    pub(super) async fn finish(
        mut self,
    ) -> Result<(Vec<Done<T>>, Box<RawValue>), Box<dyn std::error::Error>> {
        let mut done = self.flush().await?;
        done.extend(self.answered().await?);
        Ok((done, self.client.mass_properties().await?))
    }

    /// Sends what waits, once the batch before it is answered: their order is that of the program.
    async fn flush(&mut self) -> Result<Vec<Done<T>>, String> {
        let done = self.answered().await?;
        if self.waiting.is_empty() {
            return Ok(done);
        }
        self.waiting_bytes = 0;
        let (whats, changes) = self.waiting.drain(..).unzip();
        let batch = Arc::new(ChangeBatch { changes });
        let (client, sent) = (self.client.clone(), batch.clone());
        self.in_flight = Some(InFlight {
            whats,
            batch,
            answer: tokio::spawn(async move { client.batch(&sent).await }),
        });
        Ok(done)
    }

    /// Waits for the batch in flight.
    async fn answered(&mut self) -> Result<Vec<Done<T>>, String> {
        let Some(InFlight {
            whats,
            batch,
            answer,
        }) = self.in_flight.take()
        else {
            return Ok(vec![]);
        };
        let answer = answer.await.map_err(|failed| failed.to_string())?;
        let answers = answer.map_err(|failure| format!("{}{failure}", line(&batch, &failure)))?;
        if answers.len() != whats.len() {
            let (answers, whats) = (answers.len(), whats.len());
            return Err(format!("the server answers {answers} of {whats} changes"));
        }
        let done = whats.into_iter().zip(answers);
        Ok(done.map(|(what, answer)| Done { what, answer }).collect())
    }
}

/// Where in the program a failure is: what it sends names the line as its move.
fn line(batch: &ChangeBatch, failure: &Failure) -> String {
    let Failure::Refused { change, .. } = failure else {
        return String::new();
    };
    let change = change.and_then(|index| batch.changes.get(usize::from(index)));
    let line = change.and_then(|keyed| keyed.change.as_ref()?.r#move);
    line.map_or_else(String::new, |line| format!("line {line}: "))
}
