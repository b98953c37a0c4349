//! The requests of an HTTP/1 connection, each head whole and unambiguous before it is passed on.
//!
//! ```text
//!   Head ── whole, checked ──> Counted or Chunked ── its last byte ──> Head
//!     └─ refused: nothing of it is passed on, and nothing after it
//! ```
//! Two programs that read one stream of bytes as different requests can be played against each other: what one of them takes for a
//! body is the next request to the other. What has been read in two ways somewhere is therefore refused: a line that ends without
//! a carriage return, a body with two lengths, no Host or two. The library takes them. Source: RFC 9112, 2.2, 3.2, 6.1 and 11.2.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use bytes::{Buf, BytesMut};
use memchr::memmem;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::activity::Activity;
use super::socket::Socket;

/// Size of a head.
const HEAD_BYTES_MAX: usize = 64 << 10;

/// Header lines of a head.
const HEADERS_MAX: usize = 100;

/// What is read from the socket at a time.
const READ_BYTES: usize = 8 << 10;

/// The longest line that says how long a chunk is.
const CHUNK_LINE_BYTES_MAX: usize = 4 << 10;

/// What is wrong with what a client sends.
pub(super) type Refusal = &'static str;

/// The socket of an HTTP/1 connection.
pub(super) struct Heads {
    socket: Socket,
    activity: Arc<Activity>,
    /// What was read and not passed on.
    read: BytesMut,
    /// Bytes at its beginning that may be passed on.
    checked: usize,
    place: Place,
    refused: Option<Refusal>,
}

/// Where in the requests the first byte stands that is not checked.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Place {
    /// In a head, or before one.
    Head,
    /// In a body with so many bytes to come.
    Counted(u64),
    /// Before a line that says how long the next chunk is.
    ChunkLine,
    /// In a chunk and the line end after it, with so many bytes to come.
    Chunk(u64),
    /// In the lines after the last chunk.
    Trailers,
}

impl Heads {
    pub(super) fn new(socket: Socket, activity: Arc<Activity>) -> Self {
        Self {
            socket,
            activity,
            read: BytesMut::new(),
            checked: 0,
            place: Place::Head,
            refused: None,
        }
    }

    /// The socket, and what is wrong with what the client sent last, if something is.
    pub(super) fn into_parts(self) -> (Socket, Option<Refusal>) {
        (self.socket, self.refused)
    }

    /// Checks what was read as far as that is possible.
    fn check(&mut self) -> Result<(), Refusal> {
        while self.checked < self.read.len() {
            let rest = &self.read[self.checked..];
            let Some((passed, place)) = self.place.next(rest)? else {
                break;
            };
            self.checked += passed;
            self.place = place;
        }
        Ok(())
    }
}

impl Place {
    /// How many of these bytes are checked, and where that leads; none while more of them must come.
    fn next(self, bytes: &[u8]) -> Result<Option<(usize, Self)>, Refusal> {
        let most = u64::try_from(bytes.len()).unwrap_or(u64::MAX);
        let counted = |left: u64| {
            let passed = left.min(most);
            let length = usize::try_from(passed).expect("no more than there are bytes");
            (length, left - passed)
        };
        match self {
            Self::Head => head(bytes),
            Self::Counted(left) => {
                let (passed, left) = counted(left);
                let next = if left == 0 {
                    Self::Head
                } else {
                    Self::Counted(left)
                };
                Ok(Some((passed, next)))
            }
            Self::Chunk(left) => {
                let (passed, left) = counted(left);
                let next = if left == 0 {
                    Self::ChunkLine
                } else {
                    Self::Chunk(left)
                };
                Ok(Some((passed, next)))
            }
            Self::ChunkLine => {
                let Some(line) = line(bytes, CHUNK_LINE_BYTES_MAX)? else {
                    return Ok(None);
                };
                let digits = line
                    .iter()
                    .take_while(|byte| byte.is_ascii_hexdigit())
                    .count();
                let text = str::from_utf8(&line[..digits]).expect("digits are text");
                // The line end after the chunk is passed with it; the library looks at it.
                let size = u64::from_str_radix(text, 16).ok();
                let next = match size.map(|size| size.checked_add(2)) {
                    Some(Some(2)) => Self::Trailers,
                    Some(Some(length)) => Self::Chunk(length),
                    _ => return Err("a chunk's size is not a number"),
                };
                Ok(Some((line.len() + 2, next)))
            }
            Self::Trailers => {
                let line = line(bytes, HEAD_BYTES_MAX)?;
                let next = |line: &[u8]| {
                    if line.is_empty() {
                        Self::Head
                    } else {
                        Self::Trailers
                    }
                };
                Ok(line.map(|line| (line.len() + 2, next(line))))
            }
        }
    }
}

/// The first line, without its end; none while it has none.
fn line(bytes: &[u8], most: usize) -> Result<Option<&[u8]>, Refusal> {
    match memchr::memchr(b'\n', bytes) {
        Some(end) if end > 0 && bytes[end - 1] == b'\r' => Ok(Some(&bytes[..end - 1])),
        Some(_) => Err("a line ends with a line feed alone"),
        None if bytes.len() > most => Err("a line is too long"),
        None => Ok(None),
    }
}

/// The length of the head, and where the body leads.
fn head(bytes: &[u8]) -> Result<Option<(usize, Place)>, Refusal> {
    // Some clients send a line end too many after a body. Source: RFC 9112, 2.2.
    if bytes.starts_with(b"\r\n") {
        return Ok(Some((2, Place::Head)));
    }
    let whole = memmem::find(bytes, b"\r\n\r\n").map(|end| end + 4);
    let head = &bytes[..whole.unwrap_or(bytes.len())];
    let mut feeds = memchr::memchr_iter(b'\n', head);
    if feeds.any(|at| at == 0 || head[at - 1] != b'\r') {
        return Err("a line ends with a line feed alone");
    }
    if head.len() > HEAD_BYTES_MAX {
        return Err("the head of the request is larger than 65536 bytes");
    }
    let Some(length) = whole else {
        return Ok(None);
    };
    let mut headers = [httparse::EMPTY_HEADER; HEADERS_MAX];
    let mut request = httparse::Request::new(&mut headers);
    match request.parse(head) {
        Ok(httparse::Status::Complete(_)) => {}
        Ok(httparse::Status::Partial) => return Err("the head of the request ends too early"),
        Err(httparse::Error::TooManyHeaders) => {
            return Err("the request has more than 100 header lines");
        }
        Err(_) => return Err("the head of the request is not one of HTTP/1"),
    }
    let values = |name: &str| {
        let named = request
            .headers
            .iter()
            .filter(move |one| one.name.eq_ignore_ascii_case(name));
        named.map(|one| one.value).collect::<Vec<_>>()
    };
    if values("host").len() != 1 {
        return Err("the request has no Host header, or more than one");
    }
    let is_first_version = request.version == Some(0);
    let place = match (&*values("transfer-encoding"), &*values("content-length")) {
        ([], []) => Place::Head,
        ([], [length]) => match decimal(length) {
            Some(0) => Place::Head,
            Some(length) => Place::Counted(length),
            None => return Err("Content-Length is not a whole number"),
        },
        ([], _) => return Err("the request has more than one Content-Length"),
        ([_, ..], [_, ..]) => {
            return Err("the request has both Content-Length and Transfer-Encoding");
        }
        ([coding], []) if coding.eq_ignore_ascii_case(b"chunked") && !is_first_version => {
            Place::ChunkLine
        }
        (_, []) => return Err("Transfer-Encoding is not \"chunked\""),
    };
    Ok(Some((length, place)))
}

/// A whole number in digits alone.
fn decimal(text: &[u8]) -> Option<u64> {
    let digits = !text.is_empty() && text.iter().all(u8::is_ascii_digit);
    str::from_utf8(text).ok().filter(|_| digits)?.parse().ok()
}

impl AsyncRead for Heads {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        loop {
            if this.checked > 0 {
                let passed = this.checked.min(buffer.remaining());
                buffer.put_slice(&this.read[..passed]);
                this.read.advance(passed);
                this.checked -= passed;
                return Poll::Ready(Ok(()));
            }
            if this.refused.is_some() {
                // What came before it is answered first.
                ready!(this.activity.poll_idle(context));
                // To the library the connection ends before that request.
                return Poll::Ready(Ok(()));
            }
            let has_begun = this.place == Place::Head && !this.read.is_empty();
            this.activity.head(has_begun);
            let length = this.read.len();
            this.read.resize(length + READ_BYTES, 0);
            let mut part = ReadBuf::new(&mut this.read[length..]);
            let polled = Pin::new(&mut this.socket).poll_read(context, &mut part);
            let more = part.filled().len();
            this.read.truncate(length + more);
            ready!(polled)?;
            if more == 0 {
                return Poll::Ready(Ok(()));
            }
            if let Err(refusal) = this.check() {
                this.refused = Some(refusal);
            }
        }
    }
}

impl AsyncWrite for Heads {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Passes a text in pieces of every size; answers how many bytes were passed on, and what was refused.
    fn pass(text: &str, piece: usize) -> (usize, Option<Refusal>) {
        let (mut place, mut kept, mut passed) = (Place::Head, Vec::new(), 0);
        for piece in text.as_bytes().chunks(piece) {
            kept.extend_from_slice(piece);
            loop {
                match place.next(&kept) {
                    Ok(Some((length, next))) if !kept.is_empty() => {
                        kept.drain(..length);
                        (place, passed) = (next, passed + length);
                    }
                    Ok(_) => break,
                    Err(refusal) => return (passed, Some(refusal)),
                }
            }
        }
        (passed, None)
    }

    #[track_caller]
    fn check(text: &str, passed: usize, refused: Option<&str>) {
        for piece in 1..=text.len() {
            let (length, refusal) = pass(text, piece);
            assert_eq!(length, passed, "{text:?} in pieces of {piece}: {refusal:?}");
            let is_as_expected = match (refusal, refused) {
                (Some(refusal), Some(expected)) => refusal.contains(expected),
                (None, None) => true,
                _ => false,
            };
            assert!(is_as_expected, "{text:?} in pieces of {piece}: {refusal:?}");
        }
    }

    #[test]
    fn requests_follow_each_other_whatever_their_bodies() {
        let get = "GET / HTTP/1.1\r\nHost: a\r\n\r\n";
        let counted = "POST / HTTP/1.1\r\nhost: a\r\nContent-Length: 5\r\n\r\nGET \n";
        let chunked = "POST / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: Chunked\r\n\r\n\
                       5;x=y\r\nGET \n\r\n00\r\nA: b\r\n\r\n";
        let empty = "PUT / HTTP/1.1\r\nHost: a\r\nContent-Length: 0\r\n\r\n";
        for text in [
            format!("{get}{get}"),
            format!("{counted}{get}"),
            format!("{chunked}{chunked}{get}"),
            format!("{empty}\r\n{chunked}{empty}"),
        ] {
            check(&text, text.len(), None);
            // What is wrong is found after each of them, and not in them.
            check(
                &format!("{text}GET / HTTP/1.1\n"),
                text.len(),
                Some("line feed alone"),
            );
        }
    }

    #[test]
    fn what_can_be_read_in_two_ways_is_refused() {
        let with = |lines: &str| format!("POST / HTTP/1.1\r\n{lines}\r\n\r\n");
        for (lines, refused) in [
            ("X: y", "Host"),
            ("Host: a\r\nHost: a", "Host"),
            (
                "Host: a\r\nContent-Length: 5\r\nContent-Length: 5",
                "more than one Content-Length",
            ),
            ("Host: a\r\nContent-Length: +5", "whole number"),
            ("Host: a\r\nContent-Length: 5, 5", "whole number"),
            (
                "Host: a\r\nContent-Length: 5\r\nTransfer-Encoding: chunked",
                "both",
            ),
            (
                "Host: a\r\nTransfer-Encoding: chunked\r\nContent-Length: 5",
                "both",
            ),
            ("Host: a\r\nTransfer-Encoding: gzip, chunked", "chunked"),
            (
                "Host: a\r\nTransfer-Encoding: chunked\r\nTransfer-Encoding: chunked",
                "chunked",
            ),
            ("Host: a\r\nTransfer-Encoding: xchunked", "chunked"),
            ("Host: a\r\nX: y\r\n folded", "not one of HTTP/1"),
            ("Host: a\r\nContent-Length : 5", "not one of HTTP/1"),
            ("Host: a\r\nX: a\rb", "not one of HTTP/1"),
        ] {
            check(&with(lines), 0, Some(refused));
        }
        check("GET / HTTP/1.1\nHost: a\n\n", 0, Some("line feed alone"));
        check(
            "GET / HTTP/1.1\r\nHost: a\nX: y\r\n\r\n",
            0,
            Some("line feed alone"),
        );
        let old = "POST / HTTP/1.0\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\n";
        check(old, 0, Some("chunked"));
        let chunked = with("Host: a\r\nTransfer-Encoding: chunked");
        for (body, refused) in [
            ("5\nGET \n\r\n0\r\n\r\n", "line feed alone"),
            ("x\r\n", "not a number"),
            ("-1\r\n", "not a number"),
            ("fffffffffffffffff\r\n", "not a number"),
        ] {
            check(&format!("{chunked}{body}"), chunked.len(), Some(refused));
        }
    }

    #[test]
    fn a_head_without_end_is_refused() {
        let endless = format!(
            "GET / HTTP/1.1\r\nHost: a\r\nX: {}",
            "y".repeat(HEAD_BYTES_MAX)
        );
        let (passed, refused) = pass(&endless, READ_BYTES);
        assert_eq!((passed, refused.is_some()), (0, true));
    }
}
