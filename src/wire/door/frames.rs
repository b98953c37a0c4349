//! What comes over a connection of HTTP/2, a little at a time, and how much of it carries nothing.
//!
//! PING and SETTINGS must be answered, `RST_STREAM` undoes a request that has just been begun, and others are read in vain: a client
//! that sends nothing else costs work and gives none. So such frames are counted, and each answer that the client gets, and
//! time, allow some more of them. A client in good order stays far below: it sends about one for each answer.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::Instant;

use super::socket::Socket;

/// Frames without use that a client may send at once, and how many more each second.
const IDLE_FRAMES_MAX: u32 = 2_000;
const IDLE_FRAMES_A_SECOND: u32 = 200;

/// How many more each piece of an answer allows, and how many bytes of it one more: the client grows windows by them, and measures
/// the way with PINGs.
const IDLE_FRAMES_AN_ANSWER: u32 = 4;
const BYTES_AN_IDLE_FRAME: usize = 4 << 10;

/// Bytes before the first frame.
const PREFACE_BYTES: usize = 24;

/// Size of what begins each frame.
const HEAD_BYTES: usize = 9;

/// What a connection may still send before others have their turn, or before it is a flood.
#[derive(Default)]
pub(super) struct Allowance {
    /// Bytes that may be read in this turn.
    bytes: AtomicUsize,
    /// Frames without use that answers have allowed since this was looked at.
    frames: AtomicU32,
    /// Whether too many came.
    is_flooded: AtomicBool,
}

impl Allowance {
    /// A turn begins.
    pub(super) fn renew(&self, bytes: usize) {
        self.bytes.store(bytes, Ordering::Relaxed);
    }

    /// A piece of an answer is sent, of so many bytes.
    pub(super) fn credit(&self, bytes: usize) {
        let more = u32::try_from(bytes / BYTES_AN_IDLE_FRAME).unwrap_or(u32::MAX);
        let more = more.saturating_add(IDLE_FRAMES_AN_ANSWER);
        let added = |frames: u32| Some(frames.saturating_add(more));
        let _ = self
            .frames
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, added);
    }

    /// Whether too many frames without use have come. Nothing is read any more then.
    pub(super) fn is_flooded(&self) -> bool {
        self.is_flooded.load(Ordering::Relaxed)
    }
}

/// The socket of a connection of HTTP/2.
pub(super) struct Frames {
    socket: Socket,
    allowance: Arc<Allowance>,
    meter: Meter,
}

impl Frames {
    pub(super) fn new(socket: Socket, allowance: Arc<Allowance>) -> Self {
        Self {
            socket,
            allowance,
            meter: Meter::new(Instant::now()),
        }
    }
}

impl AsyncRead for Frames {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let allowed = self.allowance.bytes.load(Ordering::Relaxed);
        if allowed == 0 {
            // The next turn comes after that of others.
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        let most = allowed.min(buffer.remaining());
        let mut part = ReadBuf::new(buffer.initialize_unfilled_to(most));
        ready!(Pin::new(&mut self.socket).poll_read(context, &mut part))?;
        let read = part.filled().len();
        let answered = self.allowance.frames.swap(0, Ordering::Relaxed);
        self.meter.allow(answered, Instant::now());
        if self.meter.pass(part.filled()).is_err() {
            self.allowance.is_flooded.store(true, Ordering::Relaxed);
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        self.allowance
            .bytes
            .store(allowed - read, Ordering::Relaxed);
        buffer.advance(read);
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Frames {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.socket).poll_write(context, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.socket).poll_write_vectored(context, slices)
    }

    fn is_write_vectored(&self) -> bool {
        self.socket.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_shutdown(context)
    }
}

/// More frames without use than a client in good order sends.
#[derive(PartialEq, Eq, Debug)]
struct Flood;

/// Finds the frames in what is read, and counts those without use.
///
/// The frames themselves are judged by the library; here only where each begins matters. Source: RFC 9113, 4.1.
struct Meter {
    /// Bytes to pass until the next frame begins.
    rest: usize,
    /// What has come of a frame's beginning.
    head: [u8; HEAD_BYTES],
    length: usize,
    /// Frames without use that may still come.
    left: u32,
    /// Up to when time has been counted.
    counted_at: Instant,
}

impl Meter {
    fn new(now: Instant) -> Self {
        Self {
            rest: PREFACE_BYTES,
            head: [0; HEAD_BYTES],
            length: 0,
            left: IDLE_FRAMES_MAX,
            counted_at: now,
        }
    }

    /// Allows more frames: those that answers have earned, and those of the time until now.
    fn allow(&mut self, answered: u32, now: Instant) {
        let seconds = now.saturating_duration_since(self.counted_at).as_secs();
        if seconds > 0 {
            self.counted_at = now;
        }
        let timely = u32::try_from(seconds).unwrap_or(u32::MAX);
        let more = timely
            .saturating_mul(IDLE_FRAMES_A_SECOND)
            .saturating_add(answered);
        self.left = self.left.saturating_add(more).min(IDLE_FRAMES_MAX);
    }

    fn pass(&mut self, mut bytes: &[u8]) -> Result<(), Flood> {
        while !bytes.is_empty() {
            let passed = self.rest.min(bytes.len());
            self.rest -= passed;
            bytes = &bytes[passed..];
            let missing = (HEAD_BYTES - self.length).min(bytes.len());
            self.head[self.length..self.length + missing].copy_from_slice(&bytes[..missing]);
            self.length += missing;
            bytes = &bytes[missing..];
            if self.length == HEAD_BYTES {
                self.length = 0;
                self.frame()?;
            }
        }
        Ok(())
    }

    /// A frame has begun.
    fn frame(&mut self) -> Result<(), Flood> {
        const DATA: u8 = 0;
        const HEADERS: u8 = 1;
        const END_STREAM: u8 = 1;
        let [high, middle, low, kind, flags, ..] = self.head;
        let length = u32::from_be_bytes([0, high, middle, low]);
        self.rest = usize::try_from(length).expect("of 24 bits");
        let is_of_use = match kind {
            DATA => length > 0 || flags & END_STREAM != 0,
            HEADERS => true,
            _ => false,
        };
        if !is_of_use {
            self.left = self.left.checked_sub(1).ok_or(Flood)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// A frame's beginning, and so many bytes in it.
    fn frame(kind: u8, flags: u8, length: u8) -> Vec<u8> {
        let mut bytes = vec![0, 0, length, kind, flags, 0, 0, 0, 1];
        // What is in a frame looks like frames without use.
        bytes.extend((0..length).map(|at| [0, 0, 0, 6, 0, 0, 0, 0, 0][usize::from(at % 9)]));
        bytes
    }

    #[test]
    fn frames_without_use_are_counted_however_they_are_cut() {
        let data = [frame(0, 0, 90), frame(1, 4, 45), frame(0, 1, 0)].concat();
        let of_no_use = [
            frame(6, 0, 8),
            frame(0, 0, 0),
            frame(4, 0, 18),
            frame(200, 0, 9),
        ];
        let mut text = vec![0; PREFACE_BYTES];
        for frame in of_no_use {
            text.extend_from_slice(&data);
            text.extend_from_slice(&frame);
        }
        for piece in 1..text.len() {
            let mut meter = Meter::new(Instant::now());
            for piece in text.chunks(piece) {
                meter.pass(piece).unwrap();
            }
            assert_eq!(meter.left, IDLE_FRAMES_MAX - 4, "in pieces of {piece}");
        }
    }

    #[test]
    fn time_and_answers_allow_more_of_them_up_to_a_bound() {
        let now = Instant::now();
        let mut meter = Meter::new(now);
        meter.pass(&[0; PREFACE_BYTES]).unwrap();
        let ping = frame(6, 0, 8);
        for _ in 0..IDLE_FRAMES_MAX {
            meter.pass(&ping).unwrap();
        }
        assert_eq!(meter.pass(&ping), Err(Flood));
        meter.allow(0, now + Duration::from_millis(999));
        assert_eq!(meter.left, 0);
        meter.allow(3, now + Duration::from_millis(1_001));
        assert_eq!(meter.left, IDLE_FRAMES_A_SECOND + 3);
        meter.allow(0, now + Duration::from_secs(1_000));
        assert_eq!(meter.left, IDLE_FRAMES_MAX);
    }
}
