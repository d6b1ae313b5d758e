//! One interval: its records in order, each as its difference from a prediction.
//!
//! A record is of one of three kinds:
//!
//! - *carried*: the interval before holds a record of the same identity, key frame and birth, which is linked;
//! - *following*: an earlier record of this interval has the same identity and birth, and is linked. The position of
//!   its tracked point at the interval's end predicts this one's; everything else is predicted as for a fresh one;
//! - *fresh*: the identity is expected to be the last fresh one's plus one, the birth the key frame.
//!
//! [`VALUES`] names what predicts each value ([`By`]); the last record that is not carried predicts the key frame.

use super::MOST;
use super::columns::{Column, Values};
use super::quantise::Quantised;
use super::table::{By, LIMIT, LINKS, MEAN, MERGES, OFFSET, VALUES};
use crate::formats::FormatError;
use crate::stream::{Handover, Merge, Reference};
use std::collections::BTreeMap;

/// Kinds of records, as stored.
const FRESH: u64 = 0;
const CARRIED: u64 = 1;
const FOLLOWING: u64 = 2;

// Places of columns: those of LINKS, those of values, those of MERGES.
const KIND: usize = 0;
const LINK: usize = 1;
const CODE: usize = 2;
const IDENTITY: usize = 3;
const BIRTH: usize = 4;
const FRAME: usize = 5;
const FIRST: usize = LINKS.len();
const MERGE: usize = FIRST + VALUES.len();
const MERGE_INTO: usize = MERGE + 1;
const COLUMNS: usize = MERGE + MERGES.len();

/// State of the predictions, which writer and reader derive from the records before.
#[derive(Default)]
struct Predictor {
    /// The last record of any kind.
    last: Quantised,
    /// The last one that was not carried.
    own: Quantised,
    /// The expected identity of a fresh record.
    fresh: u64,
    /// The expected next links of a carried and of a following record.
    next: [u64; 2],
}

impl Predictor {
    /// The prediction of the quantised numbers, from the linked record.
    fn prediction(&self, kind: u64, linked: &Quantised) -> [i64; VALUES.len()] {
        std::array::from_fn(|k| match VALUES[k].by {
            By::Last => self.last.values[k],
            By::Link | By::Track if kind == CARRIED => linked.values[k],
            By::Link => self.own.values[k],
            By::Track => 0,
        })
    }

    /// Updates the state after a record of a kind.
    fn remember(&mut self, kind: u64, record: &Quantised) {
        self.last = *record;
        if kind != CARRIED {
            self.own = *record;
        }
        if kind == FRESH {
            self.fresh = record.identity.wrapping_add(1);
        }
    }
}

/// Predicted offset of a following record, from its tracked point and its own mean.
fn following_offset(parent: &Quantised, mean: &[i64]) -> [i64; 3] {
    let point = parent.point_at_end();
    std::array::from_fn(|axis| (point[axis] - mean[axis]).clamp(-LIMIT, LIMIT))
}

/// Encodes an interval's chunk. `before`: the records of the interval before, empty for an independent chunk.
pub(super) fn encode(before: &[Quantised], records: &[Quantised], merges: &[Merge]) -> Vec<u8> {
    stored(&columns(before, records, merges))
}

/// The columns of [`encode`] that images require; those of tracked points and of merges are empty.
#[cfg(feature = "viewer")]
pub(super) fn encode_for_images(before: &[Quantised], records: &[Quantised]) -> Vec<u8> {
    let mut columns = columns(before, records, &[]);
    columns[FIRST + OFFSET..FIRST + OFFSET + 3].fill(Column::default());
    stored(&columns)
}

fn stored(columns: &[Column]) -> Vec<u8> {
    streamsplat_kernels::parallel::map_indexed(columns.len(), |i| columns[i].stored()).concat()
}

fn columns(before: &[Quantised], records: &[Quantised], merges: &[Merge]) -> [Column; COLUMNS] {
    let mut columns: [Column; COLUMNS] = std::array::from_fn(|_| Column::default());
    let carried: BTreeMap<(u64, u64), usize> =
        before.iter().enumerate().map(|(i, r)| ((r.identity, r.frame), i)).collect();
    let mut seen: BTreeMap<u64, usize> = BTreeMap::new();
    let mut predictor = Predictor::default();
    for (i, record) in records.iter().enumerate() {
        let from = carried.get(&(record.identity, record.frame)).filter(|j| before[**j].birth == record.birth);
        let parent = seen.get(&record.identity).filter(|j| records[**j].birth == record.birth);
        let (kind, linked) = match (from, parent) {
            (Some(j), _) => (CARRIED, Some((*j, before[*j]))),
            (None, Some(j)) => (FOLLOWING, Some((*j, records[*j]))),
            (None, None) => (FRESH, None),
        };
        columns[KIND].push(kind);
        let code = record.reference as u64 | (record.handover as u64) << 1;
        columns[CODE].push(code);
        if kind != CARRIED {
            columns[FRAME].push_signed(record.frame.wrapping_sub(predictor.own.frame).cast_signed());
        }
        match linked {
            Some((j, _)) => {
                let next = &mut predictor.next[kind as usize - 1];
                columns[LINK].push_signed((j as u64).wrapping_sub(*next).cast_signed());
                *next = j as u64 + 1;
            }
            None => {
                columns[IDENTITY].push_signed(record.identity.wrapping_sub(predictor.fresh).cast_signed());
                columns[BIRTH].push_signed(record.frame.wrapping_sub(record.birth).cast_signed());
            }
        }
        let linked = linked.map(|(_, r)| r).unwrap_or_default();
        let mut prediction = predictor.prediction(kind, &linked);
        if kind == FOLLOWING {
            let offset = following_offset(&linked, &record.values[MEAN..MEAN + 3]);
            prediction[OFFSET..OFFSET + 3].copy_from_slice(&offset);
        }
        for (k, (value, expected)) in record.values.iter().zip(prediction).enumerate() {
            columns[FIRST + k].push_signed(value - expected);
        }
        predictor.remember(kind, record);
        seen.insert(record.identity, i);
    }
    let mut last = [0, 0];
    for merge in merges {
        columns[MERGE].push_signed(merge.identity.wrapping_sub(last[0]).cast_signed());
        columns[MERGE_INTO].push_signed(merge.into.wrapping_sub(last[1]).cast_signed());
        last = [merge.identity, merge.into];
    }
    for (column, value) in columns[FIRST..MERGE].iter_mut().zip(&VALUES) {
        if value.rare && column.is_zero() {
            *column = Column::default();
        }
    }
    columns
}

/// Decodes the `count` records and `merges` merges of a chunk.
pub(super) fn decode(
    before: &[Quantised],
    bytes: &[u8],
    count: usize,
    merges: usize,
) -> Result<(Vec<Quantised>, Vec<Merge>), FormatError> {
    let mut rest = bytes;
    let mut columns = Vec::with_capacity(COLUMNS);
    for (at, name) in LINKS.into_iter().chain(VALUES.iter().map(|value| value.name)).chain(MERGES).enumerate() {
        columns.push(Values::read(name, if at < MERGE { count } else { merges }, &mut rest)?);
    }
    let written = std::array::from_fn(|k| !VALUES[k].rare || columns[FIRST + k].remaining() > 0);
    if !rest.is_empty() {
        return Err(FormatError::new("chunk", "its end after the last column", format!("{} more bytes", rest.len())));
    }
    // Every record has at least a byte in each of these, so no more is reserved than the chunk holds.
    for (column, expected) in [(KIND, count), (CODE, count), (FIRST, count), (MERGE, merges)] {
        let found = columns[column].remaining();
        if found < expected || expected > MOST {
            let what = format!("{expected} values, of at most {MOST}");
            return Err(FormatError::new(format!("column {}", columns[column].name), what, format!("{found} bytes")));
        }
    }
    let mut records: Vec<Quantised> = Vec::with_capacity(count);
    let mut predictor = Predictor::default();
    for _ in 0..count {
        let record = next(&mut columns, &written, before, &records, &mut predictor)?;
        records.push(record);
    }
    let mut found = Vec::with_capacity(merges);
    let mut last = [0_u64, 0];
    for _ in 0..merges {
        last[0] = last[0].wrapping_add_signed(columns[MERGE].next_signed()?);
        last[1] = last[1].wrapping_add_signed(columns[MERGE_INTO].next_signed()?);
        found.push(Merge { identity: last[0], into: last[1] });
    }
    columns.into_iter().try_for_each(Values::end)?;
    Ok((records, found))
}

/// Reads the next record; `written`: which of its quantised numbers have a column.
fn next(
    columns: &mut [Values],
    written: &[bool; VALUES.len()],
    before: &[Quantised],
    records: &[Quantised],
    predictor: &mut Predictor,
) -> Result<Quantised, FormatError> {
    let wrong = |part: &str, expected: &str, found: u64| FormatError::new(part, expected, found.to_string());
    let kind = columns[KIND].next()?;
    let code = columns[CODE].next()?;
    let among = match kind {
        FRESH => &[],
        CARRIED => before,
        FOLLOWING => records,
        other => return Err(wrong("column kind", "0, 1 or 2", other)),
    };
    let mut record = Quantised {
        reference: Reference::from_code(code as u8 & 1).unwrap_or_default(),
        handover: Handover::from_code((code >> 1).min(255) as u8)
            .ok_or_else(|| wrong("column code", "0 to 5", code))?,
        ..Quantised::default()
    };
    if kind != CARRIED {
        record.frame = predictor.own.frame.wrapping_add_signed(columns[FRAME].next_signed()?);
    }
    let mut linked = Quantised::default();
    if kind == FRESH {
        record.identity = predictor.fresh.wrapping_add_signed(columns[IDENTITY].next_signed()?);
        record.birth = record.frame.wrapping_sub(columns[BIRTH].next_signed()?.cast_unsigned());
    } else {
        let next = &mut predictor.next[kind as usize - 1];
        let link = next.wrapping_add_signed(columns[LINK].next_signed()?);
        linked = *usize::try_from(link)
            .ok()
            .and_then(|link| among.get(link))
            .ok_or_else(|| wrong("column link", "a record before", link))?;
        *next = link.wrapping_add(1);
        (record.identity, record.birth) = (linked.identity, linked.birth);
        if kind == CARRIED {
            record.frame = linked.frame;
        }
    }
    let mut prediction = predictor.prediction(kind, &linked);
    for (k, value) in VALUES.iter().enumerate() {
        if k == OFFSET && kind == FOLLOWING {
            let offset = following_offset(&linked, &record.values[MEAN..MEAN + 3]);
            prediction[OFFSET..OFFSET + 3].copy_from_slice(&offset);
        }
        let difference = if written[k] { columns[FIRST + k].next_signed()? } else { 0 };
        let found = prediction[k].wrapping_add(difference);
        // Checked before it is added to others: sums of a few stay far from overflow.
        let [least, most] = value.range;
        if !(least..=most).contains(&found) {
            let expected = format!("whole numbers from {least} to {most}");
            return Err(FormatError::new(format!("column {}", value.name), expected, found.to_string()));
        }
        record.values[k] = found;
    }
    predictor.remember(kind, &record);
    Ok(record)
}
