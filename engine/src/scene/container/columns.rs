//! Columns: whole numbers as bytes, deflated.
//!
//! A number is split into groups of seven bits, the lowest first, each in a byte whose highest bit is 1 if another
//! follows (LEB128, at most ten bytes, no superfluous last byte of zero). Signed numbers are folded first: 0, −1, 1,
//! −2, 2 … become 0, 1, 2, 3, 4 …

use flate2::{Compress, Compression, Decompress, FlushCompress, FlushDecompress, Status};

use crate::formats::FormatError;

/// Largest expansion of a byte by deflate.
const MOST_RATIO: usize = 1032;
/// The most bytes of a number.
const LONGEST: usize = 10;

/// A signed number as an unsigned one.
pub(super) fn fold(x: i64) -> u64 {
    (x.cast_unsigned() << 1) ^ (x >> 63).cast_unsigned()
}

/// The signed number that was folded.
pub(super) fn unfold(x: u64) -> i64 {
    (x >> 1).cast_signed() ^ -(x & 1).cast_signed()
}

/// A column being written.
#[derive(Clone, Debug, Default)]
pub(super) struct Column(Vec<u8>);

impl Column {
    /// Appends a number.
    pub(super) fn push(&mut self, mut x: u64) {
        while x >= 0x80 {
            self.0.push(x as u8 | 0x80);
            x >>= 7;
        }
        self.0.push(x as u8);
    }

    /// Appends a signed number.
    pub(super) fn push_signed(&mut self, x: i64) {
        self.push(fold(x));
    }

    /// Returns true if every number is 0.
    pub(super) fn is_zero(&self) -> bool {
        self.0.iter().all(|byte| *byte == 0)
    }

    /// The column as it is stored: lengths of the plain and the deflated bytes, then the deflated bytes.
    pub(super) fn stored(&self) -> Vec<u8> {
        let mut compress = Compress::new(Compression::best(), false);
        // Stored blocks add five bytes per 65,535, so this always suffices.
        let mut deflated = Vec::with_capacity(self.0.len() + self.0.len() / 1000 + 64);
        let status = compress.compress_vec(&self.0, &mut deflated, FlushCompress::Finish);
        assert!(matches!(status, Ok(Status::StreamEnd)), "deflating into memory with room: {status:?}");
        let lengths = [self.0.len(), deflated.len()].map(|len| (len as u32).to_le_bytes());
        [lengths.as_flattened(), &deflated].concat()
    }
}

/// A column being read.
#[derive(Debug)]
pub(super) struct Values {
    pub(super) name: &'static str,
    bytes: Vec<u8>,
    at: usize,
}

impl Values {
    /// Reads the column of at most `most` numbers at the start of `rest`, and moves `rest` past it.
    pub(super) fn read(name: &'static str, most: usize, rest: &mut &[u8]) -> Result<Values, FormatError> {
        let wrong = |expected: &str, found: String| FormatError::new(format!("column {name}"), expected, found);
        let short = |found: usize| wrong("its two lengths and as many bytes", format!("{found} bytes"));
        let (lengths, after) = rest.split_at_checked(8).ok_or_else(|| short(rest.len()))?;
        let [len, deflated] =
            [0, 4].map(|at| lengths[at..].first_chunk().map_or(0, |b| u32::from_le_bytes(*b) as usize));
        let (deflated, after) = after.split_at_checked(deflated).ok_or_else(|| short(after.len()))?;
        if len > deflated.len().saturating_mul(MOST_RATIO) {
            return Err(wrong("at most 1032 bytes from one", format!("{len} from {}", deflated.len())));
        }
        if len > most.saturating_mul(LONGEST) {
            return Err(wrong(&format!("at most {LONGEST} bytes for each of {most} numbers"), len.to_string()));
        }
        let mut bytes = vec![0; len];
        let mut inflate = Decompress::new(false);
        let status = inflate.decompress(deflated, &mut bytes, FlushDecompress::Finish);
        let whole = matches!(status, Ok(Status::StreamEnd))
            && inflate.total_in() == deflated.len() as u64
            && inflate.total_out() == len as u64;
        if !whole {
            return Err(wrong("a deflated stream of the length that is said", "another".into()));
        }
        *rest = after;
        Ok(Values { name, bytes, at: 0 })
    }

    /// Number of bytes left: at least as many as values.
    pub(super) fn remaining(&self) -> usize {
        self.bytes.len() - self.at
    }

    /// Reads the next number.
    pub(super) fn next(&mut self) -> Result<u64, FormatError> {
        let wrong = |found: &str| FormatError::new(format!("column {}", self.name), "another number", found);
        let mut value = 0_u64;
        for shift in (0..64).step_by(7) {
            let byte = *self.bytes.get(self.at).ok_or_else(|| wrong("its end"))?;
            self.at += 1;
            let bits = u64::from(byte & 0x7f);
            if bits > u64::MAX >> shift || (byte == 0 && shift > 0) {
                return Err(wrong("one too long"));
            }
            value |= bits << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(wrong("one too long"))
    }

    /// Reads the next signed number.
    pub(super) fn next_signed(&mut self) -> Result<i64, FormatError> {
        self.next().map(unfold)
    }

    /// Returns an error if bytes are left.
    pub(super) fn end(self) -> Result<(), FormatError> {
        match self.remaining() {
            0 => Ok(()),
            more => Err(FormatError::new(format!("column {}", self.name), "its end", format!("{more} more bytes"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back() {
        let numbers = [0, 1, 127, 128, 300, u64::from(u32::MAX), u64::MAX - 1, u64::MAX];
        let mut column = Column::default();
        numbers.iter().for_each(|x| column.push(*x));
        let signed = [0, -1, 1, i64::MIN, i64::MAX, -64, 63];
        signed.iter().for_each(|x| column.push_signed(*x));
        let stored = column.stored();
        let mut rest = stored.as_slice();
        let mut values = Values::read("test", 100, &mut rest).expect("just stored");
        assert!(rest.is_empty());
        numbers.iter().for_each(|x| assert_eq!(values.next(), Ok(*x)));
        signed.iter().for_each(|x| assert_eq!(values.next_signed(), Ok(*x)));
        assert!(values.next().is_err());
        assert_eq!(values.end(), Ok(()));
    }

    #[test]
    fn hostile_columns_are_refused() {
        let mut column = Column::default();
        (0..100).for_each(|x| column.push(x));
        let stored = column.stored();
        for end in 0..stored.len() {
            assert!(Values::read("test", 100, &mut &stored[..end]).is_err(), "{end}");
        }
        for len in [99_u32, 101, u32::MAX] {
            let mut hostile = stored.clone();
            hostile[..4].copy_from_slice(&len.to_le_bytes());
            assert!(Values::read("test", 100, &mut hostile.as_slice()).is_err(), "{len}");
        }
        for bytes in [&[0x80][..], &[0x80, 0], &[0xff; 9], &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 2]] {
            let stored = Column(bytes.to_vec()).stored();
            assert!(Values::read("test", 100, &mut stored.as_slice()).expect("deflated").next().is_err(), "{bytes:?}");
        }
    }

    #[test]
    fn a_column_longer_than_its_numbers_is_refused() {
        // A megabyte of zeros, which deflates to a kilobyte, for one number.
        let stored = Column(vec![0; 1 << 20]).stored();
        assert!(stored.len() < 2000);
        let error = Values::read("test", 1, &mut stored.as_slice()).expect_err("a bomb").to_string();
        assert!(error.contains("at most 10 bytes for each of 1 numbers"), "{error}");
        assert!(Values::read("test", 1 << 20, &mut stored.as_slice()).is_ok());
    }
}
