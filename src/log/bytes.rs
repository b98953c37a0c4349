//! Numbers as bytes, and bytes taken from the front of a slice.

/// Bytes that are not what they should be.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{0}")]
pub struct Malformed(pub &'static str);

pub(super) fn put_i128(to: &mut Vec<u8>, number: i128) {
    put_signed(to, &number.to_le_bytes());
}

/// Two's complement without the high bytes that only repeat the sign.
pub(crate) fn put_signed(to: &mut Vec<u8>, bytes: &[u8]) {
    let negative = bytes.last().is_some_and(|&highest| highest >= 0x80);
    let filler = if negative { 0xFF } else { 0 };
    let mut length = bytes.len();
    while length > 0
        && bytes[length - 1] == filler
        && (length == 1 && !negative || length > 1 && (bytes[length - 2] >= 0x80) == negative)
    {
        length -= 1;
    }
    to.push(u8::try_from(length).expect("at most 32 bytes"));
    to.extend_from_slice(&bytes[..length]);
}

/// Appends an unsigned number, seven bits a byte, lowest first.
pub(crate) fn put_varint(to: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        to.push(number.to_le_bytes()[0] | 0x80);
        number >>= 7;
    }
    to.push(number.to_le_bytes()[0]);
}

pub(crate) fn count(count: usize) -> u64 {
    u64::try_from(count).expect("a count fits 64 bits")
}

/// Takes bytes from the front of a slice.
pub struct Reader<'a>(pub(crate) &'a [u8]);

impl<'a> Reader<'a> {
    pub(crate) fn bytes(&mut self, count: usize) -> Result<&'a [u8], Malformed> {
        let (taken, rest) = self
            .0
            .split_at_checked(count)
            .ok_or(Malformed("it ends too early"))?;
        self.0 = rest;
        Ok(taken)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        Ok(*self
            .bytes(N)?
            .first_chunk()
            .expect("exactly N bytes were taken"))
    }

    pub(crate) fn byte(&mut self) -> Result<u8, Malformed> {
        self.array().map(|[byte]| byte)
    }

    pub(crate) fn varint(&mut self) -> Result<u64, Malformed> {
        let mut number = 0;
        for shift in (0..u64::BITS).step_by(7) {
            let byte = self.byte()?;
            let bits = u64::from(byte & 0x7F);
            if bits << shift >> shift != bits {
                break;
            }
            number |= bits << shift;
            if byte < 0x80 {
                return Ok(number);
            }
        }
        Err(Malformed("a number of more than 64 bits"))
    }

    pub(crate) fn signed<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        let length = usize::from(self.byte()?);
        if length > N {
            return Err(Malformed("a number that is too wide"));
        }
        let bytes = self.bytes(length)?;
        let negative = bytes.last().is_some_and(|&highest| highest >= 0x80);
        let mut number = [if negative { 0xFF } else { 0 }; N];
        number[..length].copy_from_slice(bytes);
        Ok(number)
    }

    pub(crate) fn i128(&mut self) -> Result<i128, Malformed> {
        self.signed().map(i128::from_le_bytes)
    }

    pub(crate) fn i64(&mut self) -> Result<i64, Malformed> {
        self.signed().map(i64::from_le_bytes)
    }

    pub(crate) fn finish(self) -> Result<(), Malformed> {
        if self.0.is_empty() {
            Ok(())
        } else {
            Err(Malformed("bytes behind its end"))
        }
    }
}
