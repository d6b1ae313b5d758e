//! Columns: whole numbers under an entropy coder.
//!
//! A number is split into a *token* and extra bits: numbers below 8 are their own tokens; a larger one, whose highest
//! bit is e, has the token 8 + 4·(e − 3) + its next two bits, and its e − 2 lowest bits as extra bits. Signed numbers
//! are folded first: 0, −1, 1, −2, 2 … become 0, 1, 2, 3, 4 …
//!
//! Tokens are coded by asymmetric numeral systems (rANS; Duda, arXiv 1311.2540) with a state of 32 bits, words of 16
//! bits and probabilities of 1/4096. A token's probability depends on the sum of the two tokens before it, in eight
//! classes: where numbers were small, they stay small. A column stores the weights of its tokens, for each class or for
//! all together, whichever is shorter. Everything is computed in whole numbers, so the bytes are the same everywhere.

use super::rans::{Decoder, encode};
use crate::formats::FormatError;

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
pub(super) struct Column(Vec<u64>);

impl Column {
    /// Appends a number.
    pub(super) fn push(&mut self, x: u64) {
        self.0.push(x);
    }

    /// Appends a signed number.
    pub(super) fn push_signed(&mut self, x: i64) {
        self.push(fold(x));
    }

    /// Returns true if every number is 0.
    pub(super) fn is_zero(&self) -> bool {
        self.0.iter().all(|x| *x == 0)
    }

    /// The column as it is stored: the number of its numbers, the length of its bytes, the bytes.
    pub(super) fn stored(&self) -> Vec<u8> {
        let bytes = if self.0.is_empty() { Vec::new() } else { encode(&self.0) };
        let lengths = [self.0.len(), bytes.len()].map(|len| (len as u32).to_le_bytes());
        [lengths.as_flattened(), &bytes].concat()
    }
}

/// Numbers as narrow as all of them allow.
#[derive(Debug)]
enum Numbers {
    Narrow(Vec<u32>),
    Wide(Vec<u64>),
}

/// A column being read.
#[derive(Debug)]
pub(super) struct Values {
    pub(super) name: &'static str,
    numbers: Numbers,
    at: usize,
}

impl Values {
    /// Reads the column of at most `most` numbers at the start of `rest`, and moves `rest` past it.
    pub(super) fn read(name: &'static str, most: usize, rest: &mut &[u8]) -> Result<Values, FormatError> {
        let wrong = |expected: String, found: String| FormatError::new(format!("column {name}"), expected, found);
        let short = |found: usize| wrong("two lengths and as many bytes".into(), format!("{found} bytes"));
        let (lengths, after) = rest.split_at_checked(8).ok_or_else(|| short(rest.len()))?;
        let [count, length] =
            [0, 4].map(|at| lengths[at..].first_chunk().map_or(0, |b| u32::from_le_bytes(*b) as usize));
        let (bytes, after) = after.split_at_checked(length).ok_or_else(|| short(after.len()))?;
        if count > most {
            return Err(wrong(format!("at most {most} numbers"), count.to_string()));
        }
        *rest = after;
        if count == 0 {
            return match length {
                0 => Ok(Values { name, numbers: Numbers::Narrow(Vec::new()), at: 0 }),
                more => Err(wrong("no bytes without numbers".into(), format!("{more} bytes"))),
            };
        }
        let other = |(expected, found): (&str, String)| wrong(expected.into(), found);
        let mut decoder = Decoder::new(bytes).map_err(other)?;
        let numbers = if decoder.is_narrow() {
            Numbers::Narrow(decoder.take(count, |x| x as u32).map_err(other)?)
        } else {
            Numbers::Wide(decoder.take(count, |x| x).map_err(other)?)
        };
        Ok(Values { name, numbers, at: 0 })
    }

    /// How many numbers are left.
    pub(super) fn remaining(&self) -> usize {
        let count = match &self.numbers {
            Numbers::Narrow(numbers) => numbers.len(),
            Numbers::Wide(numbers) => numbers.len(),
        };
        count - self.at
    }

    /// Reads the next number.
    pub(super) fn next(&mut self) -> Result<u64, FormatError> {
        let number = match &self.numbers {
            Numbers::Narrow(numbers) => numbers.get(self.at).map(|x| u64::from(*x)),
            Numbers::Wide(numbers) => numbers.get(self.at).copied(),
        };
        self.at += usize::from(number.is_some());
        number.ok_or_else(|| FormatError::new(format!("column {}", self.name), "another number", "its end"))
    }

    /// Reads the next signed number.
    pub(super) fn next_signed(&mut self) -> Result<i64, FormatError> {
        self.next().map(unfold)
    }

    /// Returns an error if numbers are left.
    pub(super) fn end(self) -> Result<(), FormatError> {
        match self.remaining() {
            0 => Ok(()),
            more => Err(FormatError::new(format!("column {}", self.name), "its end", format!("{more} more numbers"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back() {
        let numbers = [0, 1, 7, 8, 127, 300, u64::from(u32::MAX), 1 << 32, u64::MAX - 1, u64::MAX];
        let mut column = Column::default();
        numbers.iter().for_each(|x| column.push(*x));
        let signed = [0, -1, 1, i64::MIN, i64::MAX, -64, 63];
        signed.iter().for_each(|x| column.push_signed(*x));
        let stored = column.stored();
        let mut rest = stored.as_slice();
        let mut values = Values::read("test", 17, &mut rest).expect("just stored");
        assert!(rest.is_empty());
        numbers.iter().for_each(|x| assert_eq!(values.next(), Ok(*x)));
        signed.iter().for_each(|x| assert_eq!(values.next_signed(), Ok(*x)));
        assert_eq!(values.end(), Ok(()));
    }

    #[test]
    fn a_number_more_or_fewer_is_an_error() {
        let mut column = Column::default();
        (0..9).for_each(|x| column.push(x));
        let stored = column.stored();
        let mut values = Values::read("test", 9, &mut stored.as_slice()).expect("just stored");
        (0..8).for_each(|x| assert_eq!(values.next(), Ok(x)));
        let error = values.end().expect_err("one is left").to_string();
        assert!(error.ends_with("column test: expected its end, found 1 more numbers"), "{error}");
        let mut values = Values::read("test", 9, &mut stored.as_slice()).expect("just stored");
        (0..9).for_each(|x| assert_eq!(values.next(), Ok(x)));
        assert!(values.next().is_err());
    }

    #[test]
    fn a_column_longer_than_its_numbers_is_refused() {
        // A million zeros take a few bytes; a column of one number must not make a reader take memory for them.
        let stored = Column(vec![0; 1 << 20]).stored();
        assert!(stored.len() < 30, "{}", stored.len());
        let error = Values::read("test", 1, &mut stored.as_slice()).expect_err("a bomb").to_string();
        assert!(error.contains("at most 1 numbers"), "{error}");
        assert!(Values::read("test", 1 << 20, &mut stored.as_slice()).is_ok());
        let error = Values::read("test", 9, &mut &[0, 0, 0, 0, 1, 0, 0, 0, 9][..]).expect_err("a byte").to_string();
        assert!(error.contains("no bytes without numbers"), "{error}");
    }
}
