//! Where in a body each message begins, and how long it says that it is. Source: gRPC over HTTP2, "Length-Prefixed-Message".

/// Size of what stands before each message: whether it is compressed, and its length.
pub(super) const PREFIX_BYTES: usize = 5;

/// Follows the messages of a body through its pieces.
#[derive(Default)]
pub(super) struct Framing {
    /// What is still to come of the message, once its prefix is there.
    rest: usize,
    prefix: [u8; PREFIX_BYTES],
    /// How much of a prefix has come.
    prefix_length: usize,
}

/// What a piece shows of a message.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Mark {
    /// The first byte of its prefix.
    Begins,
    /// The prefix is whole: so many bytes follow.
    Announces(usize),
}

impl Framing {
    /// Whether a message has begun and not ended.
    pub(super) fn is_within(&self) -> bool {
        self.rest > 0 || self.prefix_length > 0
    }

    /// Follows the messages through a piece of the body, and tells of each what it comes to.
    pub(super) fn follow(&mut self, mut bytes: &[u8], mut tell: impl FnMut(Mark)) {
        while !bytes.is_empty() {
            let passed = self.rest.min(bytes.len());
            self.rest -= passed;
            bytes = &bytes[passed..];
            if self.rest > 0 || bytes.is_empty() {
                break;
            }
            // Here a message begins, or its prefix goes on.
            if self.prefix_length == 0 {
                tell(Mark::Begins);
            }
            let missing = (PREFIX_BYTES - self.prefix_length).min(bytes.len());
            self.prefix[self.prefix_length..][..missing].copy_from_slice(&bytes[..missing]);
            self.prefix_length += missing;
            bytes = &bytes[missing..];
            if self.prefix_length == PREFIX_BYTES {
                self.prefix_length = 0;
                let [_, length @ ..] = self.prefix;
                self.rest = usize::try_from(u32::from_be_bytes(length)).unwrap_or(usize::MAX);
                tell(Mark::Announces(self.rest));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// However a body is cut into pieces, its messages are the same.
    #[test]
    fn messages_are_found_however_the_body_is_cut() {
        let lengths = [0_usize, 3, 0, 300, 1];
        let mut body = Vec::new();
        for length in lengths {
            body.push(0);
            body.extend(u32::try_from(length).unwrap().to_be_bytes());
            body.extend(vec![7; length]);
        }
        let expected: Vec<_> = lengths
            .iter()
            .flat_map(|length| [Mark::Begins, Mark::Announces(*length)])
            .collect();
        for piece in 1..=body.len() {
            let (mut framing, mut marks) = (Framing::default(), Vec::new());
            for bytes in body.chunks(piece) {
                framing.follow(bytes, |mark| marks.push(mark));
            }
            assert!(!framing.is_within());
            assert_eq!(marks, expected, "pieces of {piece}");
        }
    }
}
