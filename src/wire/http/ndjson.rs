//! A stream of operations, a line each, in constant memory.
//!
//! ```text
//!   body ── lines ── operations ── waiting (bounded) ── one chunk in flight, which waits for room in the queue ── service
//! ```
//! Only one chunk is in flight: were the next one queued behind it, a conflict in the first would not keep the second from being
//! applied, and the answer could not say that exactly the lines before the bad one are committed. While a chunk is being
//! committed the next one is read, and grows with the time that takes; so a slow disk makes larger chunks, not a slower stream.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, Bytes};
use futures_util::StreamExt;
use tokio::time::Instant;

use super::request::{broken, slow_request};
use crate::engine::{Counts, Op, Rejected, solids};
use crate::service::{
    Applied, Counting, Cubes, Kind, Motion, Operations, Published, SceneOf, ServiceError, Solids,
    Submission,
};
use crate::wire::access::{Effect, Ticket};
use crate::wire::atomic::ChangedKind;
use crate::wire::decode;
use crate::wire::open::OpenStream;
use crate::wire::problem::{Code, Problem};

/// Operations that are worth a chunk; a hull counts as its vertices do.
const CHUNK_OPERATIONS: usize = 4_096;

/// Operations that may wait while a chunk is in flight; then the client is made to wait.
const WAITING_OPERATIONS_MAX: usize = 4 * CHUNK_OPERATIONS;

/// How long operations wait for more of them while nothing is in flight.
const LINGER: Duration = Duration::from_millis(5);

/// A kind of scene, as streams know it.
pub(super) trait StreamedKind: ChangedKind {
    /// Longest line, in bytes.
    const LINE_BYTES_MAX: usize;
    /// Whether reading a line takes so short that other requests can wait.
    const READS_AT_ONCE: bool;

    /// Reads a line.
    fn line(
        text: &[u8],
        scene: &SceneOf<Self>,
        settings: &Self::Settings,
    ) -> Result<Op<Self::Body>, Problem>;
}

impl StreamedKind for Cubes {
    const LINE_BYTES_MAX: usize = 64 << 10;
    const READS_AT_ONCE: bool = true;

    fn line(
        text: &[u8],
        _: &SceneOf<Cubes>,
        settings: &Self::Settings,
    ) -> Result<Op<Self::Body>, Problem> {
        decode::line(text, settings)
    }
}

impl StreamedKind for Solids {
    /// A hull of 4,096 vertices takes about 250,000 bytes.
    const LINE_BYTES_MAX: usize = 1 << 20;
    const READS_AT_ONCE: bool = false;

    fn line(
        text: &[u8],
        scene: &SceneOf<Solids>,
        settings: &Self::Settings,
    ) -> Result<Op<Self::Body>, Problem> {
        // Shapes that were defined meanwhile are there.
        let shapes = scene.context()?;
        decode::solid_line(text, &shapes, settings.scale())
    }
}

/// Applies a stream to its end. Answers the state after the last chunk, and what all of them did.
/// # Errors
/// What stopped it, with `line`, `committed_lines` and `seq`: all lines before are committed, none after.
pub(super) async fn apply<K: StreamedKind>(
    scene: &Arc<SceneOf<K>>,
    settings: &Arc<K::Settings>,
    body: Body,
    idle_max: Duration,
    ticket: &Ticket,
) -> Result<Applied<K>, Problem> {
    let _open = OpenStream::http();
    let mut body = body.into_data_stream();
    let mut lines = Lines::new(scene, settings);
    let mut waiting = Chunk::<K>::default();
    let mut in_flight: Option<Pin<Box<dyn Future<Output = Committed<K>> + Send + '_>>> = None;
    let mut sums = Sums::<K>::default();
    // Why nothing more is read: the end, or what is wrong.
    let mut end: Option<Result<(), Problem>> = None;
    let mut quiet_since = Instant::now();
    loop {
        let lingered = waiting.since.is_some_and(|since| since.elapsed() >= LINGER);
        let ready = waiting.weight >= CHUNK_OPERATIONS || lingered || end.is_some();
        if in_flight.is_none() && ready && !waiting.operations.is_empty() {
            let chunk = std::mem::take(&mut waiting);
            in_flight = Some(Box::pin(commit(scene, settings, chunk)));
        }
        if in_flight.is_none() && waiting.operations.is_empty() && end.is_some() {
            break;
        }
        let reading = end.is_none() && waiting.weight < WAITING_OPERATIONS_MAX;
        let deadline = waiting
            .since
            .map_or(quiet_since + idle_max, |since| since + LINGER);
        tokio::select! {
            committed = async { in_flight.as_mut().expect("checked").await }, if in_flight.is_some() => {
                in_flight = None;
                sums.add(&committed);
                if let Some(published) = sums.published {
                    ticket.did(Effect::of(&sums.applied_as_of(published)));
                }
                if let Some((line, problem)) = committed.failed {
                    return Err(sums.stopped(scene, line, problem));
                }
            }
            piece = body.next(), if reading => match piece {
                Some(Ok(piece)) => {
                    let read;
                    (lines, waiting, read) = read_piece(lines, waiting, piece).await;
                    end = read.err().map(Err);
                }
                Some(Err(error)) => end = Some(Err(broken(&error))),
                None => end = Some(lines.finish(&mut waiting)),
            },
            // Time counts against the client only while the server waits for nothing else.
            () = tokio::time::sleep_until(deadline), if reading && in_flight.is_none() => {
                if waiting.operations.is_empty() {
                    end = Some(Err(slow_request(idle_max)));
                }
                // Otherwise the operations have lingered, and the beginning of the loop sends them on.
            }
        }
        quiet_since = Instant::now();
    }
    if let Some(Err(problem)) = end {
        return Err(sums.stopped(scene, lines.number + 1, problem));
    }
    let published = sums.published.map_or_else(|| scene.published(), Ok)?;
    Ok(sums.applied_as_of(published))
}

/// Reads a piece of the body where it does not hold up other requests.
async fn read_piece<K: StreamedKind>(
    mut lines: Lines<K>,
    mut waiting: Chunk<K>,
    piece: Bytes,
) -> (Lines<K>, Chunk<K>, Result<(), Problem>) {
    let read = move || {
        let read = lines.read(&piece, &mut waiting);
        (lines, waiting, read)
    };
    if K::READS_AT_ONCE {
        return read();
    }
    match tokio::task::spawn_blocking(read).await {
        Ok(read) => read,
        Err(error) => std::panic::resume_unwind(error.into_panic()),
    }
}

/// Operations with the numbers of their lines.
struct Chunk<K: Kind> {
    operations: Vec<Op<K::Body>>,
    /// What they count as, together.
    weight: usize,
    lines: Vec<u64>,
    /// When the first came.
    since: Option<Instant>,
}

impl<K: Kind> Default for Chunk<K> {
    fn default() -> Self {
        Self {
            operations: Vec::new(),
            weight: 0,
            lines: Vec::new(),
            since: None,
        }
    }
}

/// What has come of a chunk.
struct Committed<K: Kind> {
    counts: Counts,
    volume_removed: i128,
    published: Option<Published<K>>,
    /// The line that could not be applied: those before it are, the rest is not.
    failed: Option<(u64, Problem)>,
}

/// Commits a chunk, or all of it before the operation that is refused. Waits while the queue is full.
async fn commit<K: StreamedKind>(
    scene: &Arc<SceneOf<K>>,
    settings: &K::Settings,
    chunk: Chunk<K>,
) -> Committed<K> {
    let Chunk {
        operations, lines, ..
    } = chunk;
    let mut sums = Sums::default();
    let (mut from, mut to) = (0, operations.len());
    // What is wrong with the operation at `to`, once that is known.
    let mut refused = None;
    while from < to {
        let submission = Submission {
            operations: Operations::Named(operations[from..to].to_vec()),
            counting: Counting::InOrder,
            motion: Motion::default(),
            key: None,
        };
        let answer = match scene.submit(submission, None).await {
            Ok(queued) => queued.await,
            Err(refused) => Err(refused),
        };
        match answer {
            Ok(applied) => {
                sums.applied(&applied);
                from = to;
                if refused.is_none() {
                    to = operations.len();
                }
            }
            // It is not said which body was one too many: halve until one operation is left.
            Err(
                ServiceError::Rejected(Rejected::TooManyCubes { .. })
                | ServiceError::RejectedSolids(solids::Rejected::TooManySolids { .. }),
            ) if to - from > 1 => {
                to = from + (to - from) / 2;
                refused = None;
            }
            Err(error) => {
                let (index, problem) = K::conflict(error, settings, |_| "/insert".to_owned())
                    .unwrap_or_else(|error| (0, error.into()));
                to = from + index;
                refused = Some(problem);
            }
        }
    }
    Committed {
        counts: sums.counts,
        volume_removed: sums.volume_removed,
        published: sums.published,
        failed: refused.map(|problem| (lines[to], problem)),
    }
}

/// What has been committed of the stream so far.
struct Sums<K: Kind> {
    counts: Counts,
    volume_removed: i128,
    published: Option<Published<K>>,
}

impl<K: Kind> Default for Sums<K> {
    fn default() -> Self {
        Self {
            counts: Counts::default(),
            volume_removed: 0,
            published: None,
        }
    }
}

impl<K: StreamedKind> Sums<K> {
    fn applied(&mut self, applied: &Applied<K>) {
        self.add(&Committed {
            counts: applied.counts,
            volume_removed: applied.volume_removed,
            published: Some(applied.published),
            failed: None,
        });
    }

    fn add(&mut self, committed: &Committed<K>) {
        self.counts.inserted += committed.counts.inserted;
        self.counts.deleted += committed.counts.deleted;
        self.counts.unchanged += committed.counts.unchanged;
        self.volume_removed += committed.volume_removed;
        self.published = committed.published.or(self.published);
    }

    /// What was committed, as the one change that it is answered as.
    fn applied_as_of(&self, published: Published<K>) -> Applied<K> {
        Applied {
            published,
            counts: self.counts,
            assigned: None,
            volume_removed: self.volume_removed,
            replayed: false,
        }
    }

    /// The problem that stopped the stream at `line`, with how far it came.
    fn stopped(&self, scene: &SceneOf<K>, line: u64, problem: Problem) -> Problem {
        let newest = || scene.published().ok();
        let seq = self.published.or_else(newest);
        problem
            .within(&format!("line {line}"))
            .with("line", line)
            .with("committed_lines", line - 1)
            .with("seq", seq.map(|published| published.seq.0))
    }
}

/// Cuts a body into lines.
struct Lines<K: StreamedKind> {
    scene: Arc<SceneOf<K>>,
    settings: Arc<K::Settings>,
    /// A line that has begun.
    begun: Vec<u8>,
    /// Lines that have ended.
    number: u64,
}

impl<K: StreamedKind> Lines<K> {
    fn new(scene: &Arc<SceneOf<K>>, settings: &Arc<K::Settings>) -> Self {
        Self {
            scene: Arc::clone(scene),
            settings: Arc::clone(settings),
            begun: Vec::new(),
            number: 0,
        }
    }

    /// Reads the lines that end in `piece`, and keeps what is left of it. At an error `number` counts the lines before the bad one.
    fn read(&mut self, piece: &Bytes, to: &mut Chunk<K>) -> Result<(), Problem> {
        let mut rest = &piece[..];
        while let Some(end) = rest.iter().position(|byte| *byte == b'\n') {
            let (line, after) = (&rest[..end], &rest[end + 1..]);
            if self.begun.is_empty() {
                self.line(line, to)?;
            } else {
                let mut begun = std::mem::take(&mut self.begun);
                begun.extend_from_slice(line);
                self.line(&begun, to)?;
            }
            rest = after;
        }
        self.begun.extend_from_slice(rest);
        if self.begun.len() > K::LINE_BYTES_MAX {
            return Err(long_line::<K>());
        }
        Ok(())
    }

    /// Reads the last line, which need not end.
    fn finish(&mut self, to: &mut Chunk<K>) -> Result<(), Problem> {
        let begun = std::mem::take(&mut self.begun);
        self.line(&begun, to)
    }

    fn line(&mut self, text: &[u8], to: &mut Chunk<K>) -> Result<(), Problem> {
        if text.len() > K::LINE_BYTES_MAX {
            return Err(long_line::<K>());
        }
        if !text.trim_ascii().is_empty() {
            let operation = K::line(text, &self.scene, &self.settings)?;
            to.weight += match &operation {
                Op::Delete(_) => 1,
                Op::Insert(_, body) => K::weight(body),
            };
            to.operations.push(operation);
            to.lines.push(self.number + 1);
            to.since.get_or_insert_with(Instant::now);
        }
        self.number += 1;
        Ok(())
    }
}

fn long_line<K: StreamedKind>() -> Problem {
    let detail = format!("the line is longer than {} bytes", K::LINE_BYTES_MAX);
    Problem::new(Code::TooLarge, detail)
}
