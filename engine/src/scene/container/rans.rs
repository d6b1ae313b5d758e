//! The entropy coder of [`columns`](super::columns): tokens in classes, and extra bits. `docs/container.md` describes
//! the bytes.

/// Binary logarithm of the sum of the probabilities of a table.
const BITS: u32 = 12;
const SUM: u32 = 1 << BITS;
/// The least state between two tokens, which is also the state before the first one that is coded.
const LEAST: u32 = 1 << 16;
/// Tokens of 64-bit numbers.
const TOKENS: usize = 252;
/// Classes of the sum of the two tokens before.
const CLASSES: usize = 8;
/// The class of each sum; of larger ones, the last.
const CLASS: [u8; 22] = [0, 1, 2, 3, 3, 4, 4, 4, 5, 5, 5, 5, 5, 6, 6, 6, 6, 6, 6, 6, 6, 7];

/// What was expected, and what was found.
type Wrong = (&'static str, String);

/// The token of a number, and the number of its extra bits.
fn token(x: u64) -> (u8, u32) {
    if x < 8 {
        return (x as u8, 0);
    }
    let high = x.ilog2();
    (8 + 4 * (high - 3) as u8 + (x >> (high - 2)) as u8 % 4, high - 2)
}

/// The number with a token and no extra bits set, and the number of its extra bits.
fn least(token: u8) -> (u64, u32) {
    if token < 8 {
        return (u64::from(token), 0);
    }
    let bits = u32::from(token) / 4 - 1;
    (u64::from(4 + token % 4) << bits, bits)
}

fn class(last: u8, before: u8) -> usize {
    usize::from(CLASS[(usize::from(last) + usize::from(before)).min(CLASS.len() - 1)])
}

/// Code of a weight, and the weight of a code: 0, then 16 to 31 times powers of two.
fn weight(code: u8) -> u32 {
    match code.checked_sub(1) {
        None => 0,
        Some(c) => u32::from(16 + c % 16) << (c / 16),
    }
}

/// The code of the largest weight that is not above `x`, which is at least 16.
fn code(x: u32) -> u8 {
    let shift = x.ilog2() - 4;
    (1 + 16 * shift + (x >> shift) % 16) as u8
}

/// Where each token's probabilities start, of a sum of [`SUM`].
fn starts(codes: &[u8]) -> Option<Vec<u32>> {
    let sum: u64 = codes.iter().map(|c| u64::from(weight(*c))).sum();
    if sum == 0 {
        return None;
    }
    let mut below = 0;
    let mut starts = vec![0];
    starts.extend(codes.iter().map(|c| {
        below += u64::from(weight(*c));
        (below * u64::from(SUM) / sum) as u32
    }));
    Some(starts)
}

/// Codes of weights that suit how often each token occurs. Every token that occurs gets a probability.
fn codes(counts: &[u32]) -> Vec<u8> {
    let total: u64 = counts.iter().map(|c| u64::from(*c)).sum();
    let len = counts.iter().rposition(|c| *c > 0).map_or(0, |last| last + 1);
    // Weights from 16 have a sum below 16·252 + 2¹⁵, of which 16 are more than a part of 4096, also where others' are
    // rounded.
    let scaled = |c: u32| if c == 0 { 0 } else { code(((u64::from(c) << 15) / total).max(16) as u32) };
    counts[..len].iter().map(|c| scaled(*c)).collect()
}

/// The bytes of a column of numbers, of which there is at least one: with one table or with one for each class,
/// whichever are fewer.
pub(super) fn encode(numbers: &[u64]) -> Vec<u8> {
    let [one, many] = [1, CLASSES].map(|classes| encode_with(numbers, classes));
    if many.len() < one.len() { many } else { one }
}

fn encode_with(numbers: &[u64], classes: usize) -> Vec<u8> {
    let mut counts = vec![[0_u32; TOKENS]; classes];
    let mut tokens = Vec::with_capacity(numbers.len());
    let mut extra = BitWriter::default();
    let (mut last, mut before) = (0, 0);
    for x in numbers {
        let (token, bits) = token(*x);
        let class = if classes > 1 { class(last, before) } else { 0 };
        counts[class][usize::from(token)] += 1;
        tokens.push((class, token));
        extra.push(*x, bits);
        (last, before) = (token, last);
    }
    let tables: Vec<Vec<u8>> = counts.iter().map(|counts| codes(counts)).collect();
    let starts: Vec<Vec<u32>> = tables.iter().map(|codes| starts(codes).unwrap_or_default()).collect();
    // Last token first, since the reader undoes the writer's steps.
    let mut words = Vec::new();
    let mut state = LEAST;
    for (class, token) in tokens.into_iter().rev() {
        let start = starts[class][usize::from(token)];
        let part = starts[class][usize::from(token) + 1] - start;
        if u64::from(state) >= u64::from(part) << (32 - BITS) {
            words.push(state as u16);
            state >>= 16;
        }
        state = ((state / part) << BITS) + state % part + start;
    }
    words.extend([state as u16, (state >> 16) as u16]);
    let mut bytes = vec![classes as u8];
    for codes in tables {
        bytes.push(codes.len() as u8);
        bytes.extend(codes);
    }
    bytes.extend((words.len() as u32).to_le_bytes());
    bytes.extend(words.iter().rev().flat_map(|word| word.to_le_bytes()));
    bytes.extend(extra.end());
    bytes
}

/// Bits, the lowest of a byte first.
#[derive(Default)]
struct BitWriter {
    bytes: Vec<u8>,
    held: u128,
    count: u32,
}

impl BitWriter {
    /// Appends the `bits` lowest bits of `x`.
    fn push(&mut self, x: u64, bits: u32) {
        self.held |= u128::from(x & ((1 << bits) - 1)) << self.count;
        self.count += bits;
        while self.count >= 8 {
            self.bytes.push(self.held as u8);
            self.held >>= 8;
            self.count -= 8;
        }
    }

    fn end(mut self) -> Vec<u8> {
        if self.count > 0 {
            self.bytes.push(self.held as u8);
        }
        self.bytes
    }
}

/// A table: for each of the [`SUM`] remainders its token, its distance from the token's start (shifted by 8), and the
/// token's probability less one (shifted by 20).
struct Slots(Vec<u32>);

impl Slots {
    fn new(codes: &[u8]) -> Result<Slots, Wrong> {
        if codes.len() > TOKENS {
            return Err(("at most 252 weights in a table", codes.len().to_string()));
        }
        let starts = match starts(codes) {
            Some(starts) => starts,
            None if codes.is_empty() => return Ok(Slots(Vec::new())),
            None => return Err(("a table with a weight above 0", "none".into())),
        };
        let mut slots = Vec::with_capacity(SUM as usize);
        for (token, ends) in starts.windows(2).enumerate() {
            let part = ends[1] - ends[0];
            slots.extend((0..part).map(|at| token as u32 | at << 8 | (part - 1) << 20));
        }
        Ok(Slots(slots))
    }
}

/// A column's bytes being read.
pub(super) struct Decoder<'a> {
    tables: Vec<Slots>,
    words: &'a [[u8; 2]],
    extra: &'a [u8],
    narrow: bool,
}

impl<'a> Decoder<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Result<Decoder<'a>, Wrong> {
        let short = || ("tables, a count, words and extra bits", format!("{} bytes", bytes.len()));
        let (classes, mut rest) = bytes.split_first().ok_or_else(short)?;
        if ![1, CLASSES].contains(&usize::from(*classes)) {
            return Err(("1 or 8 tables", classes.to_string()));
        }
        let mut tables = Vec::with_capacity(CLASSES);
        let mut most = 0;
        for _ in 0..*classes {
            let (len, after) = rest.split_first().ok_or_else(short)?;
            let (codes, after) = after.split_at_checked(usize::from(*len)).ok_or_else(short)?;
            tables.push(Slots::new(codes)?);
            most = most.max(codes.len());
            rest = after;
        }
        let (count, rest) = rest.split_first_chunk().ok_or_else(short)?;
        let count = u32::from_le_bytes(*count) as usize;
        let (words, extra) = rest.split_at_checked(count.saturating_mul(2)).ok_or_else(short)?;
        let narrow = most.checked_sub(1).is_none_or(|token| least(token as u8).0 <= u64::from(u32::MAX));
        Ok(Decoder { tables, words: words.as_chunks().0, extra, narrow })
    }

    /// Returns true if every number fits into 32 bits.
    pub(super) fn is_narrow(&self) -> bool {
        self.narrow
    }

    /// Reads `count` numbers, which must be all.
    pub(super) fn take<T>(&mut self, count: usize, number: impl Fn(u64) -> T) -> Result<Vec<T>, Wrong> {
        let mut words = self.words.iter().map(|word| u32::from(u16::from_le_bytes(*word)));
        let mut next = || words.next().ok_or_else(|| ("another word", "the last one".to_owned()));
        let mut state = next()? << 16 | next()?;
        let mut extra = BitReader { bytes: self.extra, at: 0 };
        let mut numbers = Vec::with_capacity(count);
        let (mut last, mut before) = (0, 0);
        for _ in 0..count {
            let class = if self.tables.len() > 1 { class(last, before) } else { 0 };
            let found = self.tables[class].0.get((state % SUM) as usize);
            let slot = *found.ok_or_else(|| ("a table for each class that occurs", format!("none for {class}")))?;
            // Below 2³², since the state is, and since a part is at most the sum.
            state = ((slot >> 20) + 1) * (state >> BITS) + (slot >> 8) % SUM;
            if state < LEAST {
                state = state << 16 | next()?;
            }
            let token = slot as u8;
            let x = match least(token) {
                (x, 0) => x,
                (x, bits) => {
                    x | extra
                        .take(bits)
                        .ok_or_else(|| ("as many extra bits as its tokens require", "fewer".to_owned()))?
                }
            };
            numbers.push(number(x));
            (last, before) = (token, last);
        }
        if state != LEAST || words.next().is_some() || !extra.is_spent() {
            return Err(("words and bits that end with its numbers", "others".into()));
        }
        Ok(numbers)
    }
}

struct BitReader<'a> {
    bytes: &'a [u8],
    /// Bits taken so far.
    at: usize,
}

impl BitReader<'_> {
    fn take(&mut self, bits: u32) -> Option<u64> {
        let (byte, shift) = (self.at / 8, self.at % 8);
        self.at += bits as usize;
        let held = match self.bytes[byte.min(self.bytes.len())..].first_chunk::<16>() {
            Some(chunk) => u128::from_le_bytes(*chunk),
            None if self.at > 8 * self.bytes.len() => return None,
            None => self.bytes[byte..].iter().rev().fold(0, |held, byte| held << 8 | u128::from(*byte)),
        };
        Some((held >> shift) as u64 & ((1 << bits) - 1))
    }

    /// Returns true if what is left are the zeros that fill the last byte.
    fn is_spent(&self) -> bool {
        let left = 8 * self.bytes.len() - self.at;
        left < 8 && self.bytes.last().is_none_or(|last| left == 0 || last >> (8 - left) == 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise of some bits, by Stafford's mixing function.
    fn noise(i: u64, bits: u64) -> u64 {
        let x = (i ^ i >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        (x ^ x >> 31) >> (64 - bits)
    }

    fn decoded(bytes: &[u8], count: usize) -> Result<Vec<u64>, Wrong> {
        Decoder::new(bytes)?.take(count, |x| x)
    }

    #[test]
    fn each_number_has_its_token_and_bits() {
        let edges = (0..64).flat_map(|bit| [1_u64 << bit, (1 << bit) - 1, (1 << bit) + (1 << bit) / 4]);
        for x in edges.chain([u64::MAX]) {
            let (token, bits) = token(x);
            let (first, also) = least(token);
            assert_eq!((bits, x >> bits << bits), (also, first), "{x}");
            assert!(usize::from(token) < TOKENS && x - first < 1 << bits);
        }
        assert_eq!(token(u64::MAX), (251, 61));
    }

    #[test]
    fn every_weight_has_a_code_and_no_token_is_lost() {
        (1..=255).for_each(|c| assert_eq!(code(weight(c)), c));
        // The rarest tokens next to the most frequent one.
        for others in [1, 100, 251] {
            let mut counts = vec![1_u32; others];
            counts.push(u32::MAX);
            let starts = starts(&codes(&counts)).expect("weights");
            assert!(starts.windows(2).all(|pair| pair[0] < pair[1]), "{others}: {starts:?}");
            assert_eq!(starts.last(), Some(&SUM));
        }
    }

    #[test]
    fn numbers_come_back_with_one_table_and_with_eight() {
        let columns: [Vec<u64>; 6] = [
            vec![0],
            vec![u64::MAX; 3],
            // Sizes that follow from the ones before: classes are worth their tables.
            (0..5000).map(|i| noise(i, 1 + i % 63)).collect(),
            // Runs of small numbers, then of large ones.
            (0..20_000).map(|i| if i / 500 % 2 == 0 { noise(i, 1) } else { 20 + noise(i, 3) }).collect(),
            (0..20_000).map(|i| noise(i, 4)).collect(),
            vec![7; 100_000],
        ];
        for (numbers, classes) in columns.iter().zip([1, 1, 8, 8, 1, 1]) {
            let bytes = encode(numbers);
            assert_eq!(bytes[0], classes);
            assert_eq!(decoded(&bytes, numbers.len()).as_ref(), Ok(numbers));
            for classes in [1, CLASSES] {
                assert_eq!(decoded(&encode_with(numbers, classes), numbers.len()).as_ref(), Ok(numbers));
            }
        }
        assert!(encode(&columns[5]).len() < 24);
    }

    #[test]
    fn uniform_numbers_take_their_entropy() {
        let numbers: Vec<u64> = (0..100_000).map(|i| noise(i, 3)).collect();
        let bytes = encode(&numbers).len();
        assert!((37_500..37_600).contains(&bytes), "{bytes}");
    }

    #[test]
    fn hostile_bytes_are_refused() {
        let numbers: Vec<u64> = (0..300).map(|i| i * i % 97 * (1 + i % 5)).collect();
        for classes in [1, CLASSES] {
            let bytes = encode_with(&numbers, classes);
            for end in 0..bytes.len() {
                assert!(decoded(&bytes[..end], 300).is_err(), "{end}");
            }
            for count in [0, 299, 301, 1 << 20] {
                assert!(decoded(&bytes, count).is_err(), "{count}");
            }
            assert!(decoded(&[&bytes[..], &[0]].concat(), 300).is_err());
        }
        for (bytes, expected) in [
            (&[2, 0, 0][..], "1 or 8 tables"),
            (&[1, 253], "tables, a count"),
            (&[1, 2, 0, 0, 2, 0, 0, 0, 1, 0, 0, 0], "a weight above 0"),
            (&[1, 0, 2, 0, 0, 0, 1, 0, 0, 0], "each class that occurs"),
            (&[1, 1, 1, 1, 0, 0, 0, 1, 0], "another word"),
            (&[1, 1, 1, 2, 0, 0, 0, 1, 0, 1, 0], "that end with its numbers"),
            (&[1, 9, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 0, 0, 0, 1, 0, 0, 0], "as many extra bits"),
        ] {
            assert_eq!(decoded(bytes, 1).map_err(|(what, _)| what.contains(expected)), Err(true), "{expected}");
        }
        let long = [&[1, 253][..], &[1; 253], &[2, 0, 0, 0, 1, 0, 0, 0]].concat();
        assert_eq!(decoded(&long, 1), Err(("at most 252 weights in a table", "253".into())));
    }
}
