//! SQLite's write-ahead file, read before SQLite sees it.
//!
//! SQLite recovers by reading frames until one does not fit and silently forgets the rest. That is right for a torn end,
//! which nobody was promised, and wrong for damage in the middle, behind which there are changes that were acknowledged.
//! This module tells the two apart. It knows the file's format and nothing of what is in its pages; what it writes it has read there.
//!
//! ```text
//! header 32   magic  version  page size  checkpoint  salt 1  salt 2  checksum of the first 24 bytes
//! frame  24   page   pages after commit (0: not the last frame of a transaction)  salt 1  salt 2  checksum
//!        page size   the page; the checksum runs on from the frame before
//! ```
//! A frame with two other salts is left over from before the file was last begun anew.
//! # Source
//! <https://sqlite.org/fileformat2.html#the_write_ahead_log>

use std::fs::{File, OpenOptions};
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::path::Path;

const HEADER_SIZE: usize = 32;
const FRAME_HEADER_SIZE: usize = 24;
const VERSION: u32 = 3_007_000;
/// The lowest bit says in which byte order checksums are computed: 1 is big-endian.
const MAGIC: u32 = 0x377f_0682;
const BUFFER_SIZE: usize = 1 << 18;

/// What the file holds for SQLite.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum WriteAhead {
    /// No frames: everything is in the database file.
    Empty,
    /// Whole transactions only.
    Whole,
    /// Whole transactions, then an end that SQLite cuts off.
    Torn {
        /// Frames after the last whole transaction.
        frames: u64,
        /// From the end of the last whole transaction to the end of those frames.
        bytes: u64,
    },
    /// Damage before the end.
    Broken {
        /// What, and where.
        detail: &'static str,
        /// The first bad frame, from 0; none when it is the header.
        frame: Option<u64>,
    },
}

/// Reads the file at `path`, whose frames must hold pages of `page_size`. O(its length).
/// # Errors
/// Only when the file cannot be read; a missing file is empty.
pub(super) fn inspect(path: &Path, page_size: usize) -> io::Result<WriteAhead> {
    let file = match File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(WriteAhead::Empty),
        Err(error) => return Err(error),
    };
    inspect_bytes(&mut BufReader::with_capacity(BUFFER_SIZE, file), page_size)
}

pub(super) fn inspect_bytes(file: &mut impl Read, page_size: usize) -> io::Result<WriteAhead> {
    let mut header = [0; HEADER_SIZE];
    let mut frame = vec![0; FRAME_HEADER_SIZE + page_size];
    let header_read = fill(file, &mut header)?;
    let mut frame_read = fill(file, &mut frame)?;
    if header_read < HEADER_SIZE || frame_read == 0 {
        return Ok(WriteAhead::Empty);
    }
    let Some(header) = Header::parse(&header, page_size) else {
        return Ok(WriteAhead::Broken {
            detail: "its header cannot be read, though there are frames behind it",
            frame: None,
        });
    };
    let mut walk = Walk::new(header);
    while frame_read == frame.len() {
        if let Some(frame) = walk.step(&frame) {
            return Ok(WriteAhead::Broken {
                detail: "a frame is damaged, though there are whole later changes behind it",
                frame: Some(frame),
            });
        }
        frame_read = fill(file, &mut frame)?;
    }
    walk.end(&frame[..frame_read]);
    Ok(walk.verdict(frame.len()))
}

/// Writes what SQLite takes in of the file at `path` again, every byte where it is, and syncs it: then it is durable, whatever came of
/// earlier syncs. Answers the frames of whole transactions. A power cut meanwhile does no harm: each sector
/// holds what it held, or what was read of it.
/// # Errors
/// The file cannot be read, written or synced.
pub(super) fn rewrite(path: &Path, page_size: usize) -> io::Result<u64> {
    let mut file = OpenOptions::new().read(true).write(true).open(path)?;
    let frames = rewrite_frames(&mut file, page_size)?;
    file.sync_all()?;
    Ok(frames)
}

/// Each frame is compared with its checksum before: what was read wrongly must not be written.
fn rewrite_frames(file: &mut (impl Read + Write + Seek), page_size: usize) -> io::Result<u64> {
    let mut header = [0; HEADER_SIZE];
    if fill(file, &mut header)? < HEADER_SIZE {
        return Ok(0);
    }
    let Some(parsed) = Header::parse(&header, page_size) else {
        return Ok(0);
    };
    file.seek(SeekFrom::Start(0))?;
    file.write_all(&header)?;
    let mut walk = Walk::new(parsed);
    let mut frame = vec![0; FRAME_HEADER_SIZE + page_size];
    loop {
        let place = file.stream_position()?;
        if fill(file, &mut frame)? < frame.len() {
            break;
        }
        walk.step(&frame);
        if walk.broken {
            break;
        }
        file.seek(SeekFrom::Start(place))?;
        file.write_all(&frame)?;
    }
    Ok(walk.committed)
}

/// Fills `buffer` as far as the file goes.
fn fill(file: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut read = 0;
    while read < buffer.len() {
        match file.read(&mut buffer[read..]) {
            Ok(0) => break,
            Ok(count) => read += count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(read)
}

struct Header {
    big_endian: bool,
    salts: [u32; 2],
    checksum: Checksum,
}

impl Header {
    fn parse(bytes: &[u8; HEADER_SIZE], page_size: usize) -> Option<Self> {
        let [magic, version, size, _checkpoint, salt1, salt2, sum1, sum2] = words(bytes);
        let big_endian = magic & 1 == 1;
        let checksum = Checksum::default().over(&bytes[..24], big_endian);
        (magic & !1 == MAGIC
            && version == VERSION
            && usize::try_from(size) == Ok(page_size)
            && checksum == Checksum(sum1, sum2))
        .then_some(Self {
            big_endian,
            salts: [salt1, salt2],
            checksum,
        })
    }
}

/// Follows SQLite's own recovery, and looks on where that gives up.
struct Walk {
    header: Header,
    /// Index of the frame that comes next.
    index: u64,
    /// Frames SQLite takes for good: up to here the chain of checksums holds.
    good: u64,
    /// Of those, the ones up to the last end of a transaction.
    committed: u64,
    /// Whether the chain is broken; `good` is then the first bad frame.
    broken: bool,
    /// Checksum a next frame must continue: computed while the chain holds, then the one the last frame has written in it.
    chain: Option<Checksum>,
    /// Whether the last frame, at or behind the first bad one, ended a transaction.
    ended: bool,
    /// End of the last frame, whole or not, that carries a salt of this generation.
    ours_until: u64,
    partial_size: usize,
}

impl Walk {
    fn new(header: Header) -> Self {
        Self {
            chain: Some(header.checksum),
            header,
            index: 0,
            good: 0,
            committed: 0,
            broken: false,
            ended: false,
            ours_until: 0,
            partial_size: 0,
        }
    }

    /// Looks at the next frame. Answers the first bad frame once it is sure that it is not the end that is damaged: when
    /// a frame continues the end of a transaction at or behind the bad frame. SQLite begins to write a transaction only when the
    /// one before it is on stable storage, so a torn end never looks like this; nor do leftovers of transactions that
    /// failed and were overwritten by shorter ones, whose frames do not continue each other.
    fn step(&mut self, frame: &[u8]) -> Option<u64> {
        let (head, page) = frame.split_at(FRAME_HEADER_SIZE);
        let [number, pages, salt1, salt2, sum1, sum2] = words(head);
        let ours = [salt1, salt2] == self.header.salts;
        let written = Checksum(sum1, sum2);
        let fits = self.chain.is_some_and(|chain| {
            ours && number != 0
                && chain
                    .over(&head[..8], self.header.big_endian)
                    .over(page, self.header.big_endian)
                    == written
        });
        self.index += 1;
        if ours || salt1 == self.header.salts[0] || salt2 == self.header.salts[1] {
            self.ours_until = self.index;
        }
        if fits && !self.broken {
            self.good = self.index;
            if pages != 0 {
                self.committed = self.index;
            }
        } else {
            self.broken = true;
            if fits && self.ended {
                return Some(self.good);
            }
            self.ended = ours && pages != 0;
        }
        // A frame that was written in one piece is continued by its successor even when the chain broke before it.
        self.chain = ours.then_some(written);
        None
    }

    /// Looks at what is behind the last whole frame.
    fn end(&mut self, partial: &[u8]) {
        let stale = match partial.get(8..16) {
            Some(bytes) => {
                let [salt1, salt2] = words(bytes);
                salt1 != self.header.salts[0] && salt2 != self.header.salts[1]
            }
            // Too short to tell. Behind stale frames it is one of them.
            None => partial.is_empty() || self.ours_until < self.index,
        };
        if !stale {
            self.ours_until = self.index + 1;
            self.partial_size = partial.len();
        }
    }

    fn verdict(&self, frame_size: usize) -> WriteAhead {
        let frames = self.good.max(self.ours_until) - self.committed;
        if frames == 0 {
            return if self.committed == 0 {
                WriteAhead::Empty
            } else {
                WriteAhead::Whole
            };
        }
        let size = |size: usize| u64::try_from(size).expect("a size fits 64 bits");
        let bytes = if self.partial_size == 0 {
            frames * size(frame_size)
        } else {
            (frames - 1) * size(frame_size) + size(self.partial_size)
        };
        WriteAhead::Torn { frames, bytes }
    }
}

/// Two running sums over pairs of words.
#[derive(Clone, Copy, PartialEq, Eq, Default, Debug)]
struct Checksum(u32, u32);

impl Checksum {
    /// `bytes` are a multiple of eight.
    fn over(self, bytes: &[u8], big_endian: bool) -> Self {
        let Self(mut sum1, mut sum2) = self;
        let word = |bytes| {
            if big_endian {
                u32::from_be_bytes(bytes)
            } else {
                u32::from_le_bytes(bytes)
            }
        };
        for &[a, b, c, d, e, f, g, h] in bytes.as_chunks().0 {
            sum1 = sum1.wrapping_add(word([a, b, c, d])).wrapping_add(sum2);
            sum2 = sum2.wrapping_add(word([e, f, g, h])).wrapping_add(sum1);
        }
        Self(sum1, sum2)
    }
}

/// The first N big-endian words of `bytes`.
fn words<const N: usize>(bytes: &[u8]) -> [u32; N] {
    let mut words = [0; N];
    for (word, &bytes) in words.iter_mut().zip(bytes.as_chunks().0) {
        *word = u32::from_be_bytes(bytes);
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE_SIZE: usize = 512;
    const FRAME_SIZE: usize = FRAME_HEADER_SIZE + PAGE_SIZE;
    /// Two frames that are one transaction, and one that is another.
    const BIG_ENDIAN: &[u8] = include_bytes!("../../tests/fuzz/corpus/wal/big-endian");
    /// One transaction of two frames, and behind it what an earlier, longer generation has left.
    const SECOND_GENERATION: &[u8] =
        include_bytes!("../../tests/fuzz/corpus/wal/second-generation");

    fn inspect_flipped(file: &[u8], byte: usize) -> WriteAhead {
        let mut file = file.to_vec();
        file[byte] ^= 1;
        inspect_bytes(&mut &*file, PAGE_SIZE).unwrap()
    }

    /// What a processor of the other byte order has written is read all the same, and its damage is found.
    #[test]
    fn the_order_of_bytes_is_the_one_that_the_header_says() {
        let found = inspect_bytes(&mut &*BIG_ENDIAN, PAGE_SIZE).unwrap();
        assert_eq!(found, WriteAhead::Whole);
        let in_frame = |frame: usize| HEADER_SIZE + frame * FRAME_SIZE + FRAME_HEADER_SIZE;
        let torn = WriteAhead::Torn {
            frames: 1,
            bytes: 536,
        };
        assert_eq!(inspect_flipped(BIG_ENDIAN, in_frame(2)), torn);
        let WriteAhead::Broken { frame, .. } = inspect_flipped(BIG_ENDIAN, in_frame(0)) else {
            panic!("damage before the end");
        };
        assert_eq!(frame, Some(0));
        let WriteAhead::Broken { frame, .. } = inspect_flipped(BIG_ENDIAN, 3) else {
            panic!("damage in the header");
        };
        assert_eq!(frame, None);
    }

    /// Whole frames of an earlier generation, and one of them that is cut off, are no torn end.
    #[test]
    fn what_an_earlier_generation_left_does_not_count() {
        for size in [
            SECOND_GENERATION.len(),
            SECOND_GENERATION.len() - FRAME_SIZE - 100,
        ] {
            let found = inspect_bytes(&mut &SECOND_GENERATION[..size], PAGE_SIZE).unwrap();
            assert_eq!(found, WriteAhead::Whole, "{size} bytes");
        }
    }
}
