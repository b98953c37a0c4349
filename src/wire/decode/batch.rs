//! Batches: several changes in one body, each with its key.

use axum::body::Bytes;
use prost::Message;
use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::value::RawValue;

use super::json;
use crate::wire::calls;
use crate::wire::problem::{Code, Fault, Problem};
use crate::wire::proto;

/// A change as it was sent, and the key that makes sending it again safe.
pub(in crate::wire) type Keyed<C> = (C, Option<Box<str>>);

/// A body of changes, which are read later or not at all.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Batch<C> {
    changes: Vec<KeyedChange<C>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KeyedChange<C> {
    change: C,
    #[serde(default)]
    idempotency_key: Option<String>,
}

/// Reads a batch from JSON: `{"changes":[{"change":{..},"idempotency_key":".."}]}`. The changes in it are not looked at.
/// # Errors
/// [`Code::BadJson`], [`Code::TooLarge`] above `changes_max`, or [`Code::Invalid`] with every fault outside of the changes.
pub(in crate::wire) fn batch(
    body: &Bytes,
    changes_max: usize,
) -> Result<Vec<Keyed<Bytes>>, Problem> {
    if let Ok(batch) = serde_json::from_slice::<Batch<&RawValue>>(body) {
        return keyed(
            batch,
            |raw| body.slice_ref(raw.get().as_bytes()),
            changes_max,
        );
    }
    let text = json::text(body)?;
    let (shape, faults) = json::examine(
        json::parse(&text)?,
        changes_max.saturating_add(1),
        |_: &Batch<IgnoredAny>, _| (),
    );
    json::complete(shape, faults)?;
    // What stood in its way were numbers that are none: they are faults of the changes.
    let batch = serde_json::from_str::<Batch<&RawValue>>(&text);
    let batch = batch.map_err(|error| Problem::new(Code::BadJson, error.to_string()))?;
    keyed(
        batch,
        |raw| Bytes::copy_from_slice(raw.get().as_bytes()),
        changes_max,
    )
}

fn keyed(
    Batch { changes }: Batch<&RawValue>,
    bytes: impl Fn(&RawValue) -> Bytes,
    changes_max: usize,
) -> Result<Vec<Keyed<Bytes>>, Problem> {
    let changes = changes.into_iter();
    collected(
        changes.map(|keyed| (bytes(keyed.change), keyed.idempotency_key)),
        changes_max,
    )
}

/// Reads a batch from a message `union3d.v1.ChangeBatch`. The changes in it are not looked at.
/// # Errors
/// [`Code::BadProtobuf`], [`Code::TooLarge`] above `changes_max`, or [`Code::Invalid`] of a key.
pub(in crate::wire) fn batch_message(
    body: &Bytes,
    changes_max: usize,
) -> Result<Vec<Keyed<proto::Change>>, Problem> {
    let batch = proto::ChangeBatch::decode(body.as_ref())
        .map_err(|error| Problem::new(Code::BadProtobuf, error.to_string()))?;
    let changes = batch.changes.into_iter();
    collected(
        changes.map(|keyed| (keyed.change.unwrap_or_default(), keyed.idempotency_key)),
        changes_max,
    )
}

fn collected<C>(
    changes: impl ExactSizeIterator<Item = (C, Option<String>)>,
    changes_max: usize,
) -> Result<Vec<Keyed<C>>, Problem> {
    if changes.len() > changes_max {
        let detail = format!(
            "the batch has {} changes; the most is {changes_max}",
            changes.len()
        );
        return Err(Problem::new(Code::TooLarge, detail));
    }
    let changes = changes.enumerate().map(|(index, (change, key))| {
        let key = key.map(|key| calls::key(key.as_bytes())).transpose();
        let key = key.map_err(|fault| Fault {
            pointer: Some(format!("/changes/{index}/idempotency_key")),
            ..fault
        })?;
        Ok((change, key))
    });
    changes.collect()
}
