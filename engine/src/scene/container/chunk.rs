//! One interval: its records in order, each as its difference from a prediction.
//!
//! A record is of one of four kinds:
//!
//! - *carried*: the interval before holds a record of the same identity, key frame and birth, which is linked;
//! - *following*: an earlier record of this interval has the same identity and birth, and is linked. The position of
//!   its tracked point at the interval's end predicts this one's; everything else is predicted as for a fresh one;
//! - *kept*: the interval before holds a record of the same identity and birth, the last of which is linked. Its colour
//!   is expected to be the linked one's after its change, everything else to be the same: it stands still;
//! - *fresh*: the identity is expected to be the last fresh one's plus one, the birth the key frame.
//!
//! [`VALUES`] names what predicts each value ([`By`]); the last record of its kind predicts the key frame. A
//! merge is stored as two records: the first one of the identity that ends, and the last one of the one that goes on.

use super::MOST;
use super::columns::{Column, Values};
use super::quantise::Quantised;
use super::table::{By, LIMIT, LINKS, MERGES, OFFSET, OFFSET_UNITS, ROW, VALUES, Value, grown};
use crate::formats::FormatError;
use crate::stream::{Handover, Merge, Reference};
use std::collections::BTreeMap;

/// Kinds of records, as stored.
const FRESH: u64 = 0;
const CARRIED: u64 = 1;
const FOLLOWING: u64 = 2;
const KEPT: u64 = 3;

// Places of columns: those of LINKS, those of values, those of MERGES.
const KIND: usize = 0;
const LINK_ROW: usize = 1;
const LINK: usize = 2;
const CODE: usize = 3;
const IDENTITY: usize = 4;
const BIRTH: usize = 5;
const FRAME: usize = 6;
const FIRST: usize = LINKS.len();
const MERGE: usize = FIRST + VALUES.len();
const MERGE_INTO: usize = MERGE + 1;
const MERGE_OTHER: usize = MERGE + 2;
const COLUMNS: usize = MERGE + MERGES.len();

/// Most rows that a link jumps, and the ranges of links.
const MOST_ROWS: u64 = 1 << 16;
const LINK_RANGE: &str = "at most 65536 rows either way, and -128 to 127";

/// State of the predictions, which writer and reader derive from the records before.
#[derive(Default)]
struct Predictor {
    /// The last record of any kind.
    last: Quantised,
    /// The last one that was fresh or following.
    own: Quantised,
    /// The key frame of the last record of each kind.
    frames: [u64; 4],
    /// The expected identity of a fresh record.
    fresh: u64,
    /// The expected next link of a record of each kind.
    next: [u64; 4],
}

/// Returns true for kinds that are linked to a record of the interval before.
fn is_from_before(kind: u64) -> bool {
    kind == CARRIED || kind == KEPT
}

impl Predictor {
    /// The prediction of the quantised numbers, from the linked record.
    fn prediction(&self, kind: u64, linked: &Quantised, step: fn(&Value) -> i64) -> [i64; VALUES.len()] {
        std::array::from_fn(|k| match VALUES[k].by {
            By::Last => self.last.values[k],
            By::Zero => 0,
            By::Grown if kind == KEPT => grown(&linked.values, k, step),
            _ if is_from_before(kind) => linked.values[k],
            By::Link | By::Grown => self.own.values[k],
            By::Ahead(width) => self.own.values[k] + width / step(&VALUES[k]),
            By::Track => 0,
        })
    }

    /// Updates the state after a record of a kind.
    fn remember(&mut self, kind: u64, record: &Quantised) {
        self.last = *record;
        self.frames[kind as usize] = record.frame;
        if !is_from_before(kind) {
            self.own = *record;
        }
        if kind == FRESH {
            self.fresh = record.identity.wrapping_add(1);
        }
    }
}

/// Predicted offset of a following record, from its tracked point and its own mean: the nearest step, halves upwards.
fn following_offset(parent: &Quantised, record: &Quantised) -> [i64; 3] {
    let point = parent.point_at_end();
    std::array::from_fn(|axis| {
        let unit = OFFSET_UNITS[axis];
        (point[axis] - record.mean(axis) + unit / 2).div_euclid(unit).clamp(-LIMIT, LIMIT)
    })
}

/// Encodes an interval's chunk. `before`: the records of the interval before, empty for an independent chunk.
pub(super) fn encode(before: &[Quantised], records: &[Quantised], merges: &[Merge]) -> Vec<u8> {
    stored(&columns(before, records, merges, |_| 1))
}

/// The columns of [`encode`] that images require, in a page's steps; those of tracked points and of merges are empty.
#[cfg(feature = "viewer")]
pub(super) fn encode_for_images(before: &[Quantised], records: &[Quantised]) -> Vec<u8> {
    let mut columns = columns(before, records, &[], |value| value.coarseness);
    columns[FIRST + OFFSET..FIRST + OFFSET + 3].fill(Column::default());
    stored(&columns)
}

fn stored(columns: &[Column]) -> Vec<u8> {
    streamsplat_kernels::parallel::map_indexed(columns.len(), |i| columns[i].stored()).concat()
}

/// `step`: steps of a container's whole numbers per step of the records'.
fn columns(
    before: &[Quantised],
    records: &[Quantised],
    merges: &[Merge],
    step: fn(&Value) -> i64,
) -> [Column; COLUMNS] {
    let mut columns: [Column; COLUMNS] = std::array::from_fn(|_| Column::default());
    let carried: BTreeMap<(u64, u64), usize> =
        before.iter().enumerate().map(|(i, r)| ((r.identity, r.frame), i)).collect();
    let last: BTreeMap<u64, usize> = before.iter().enumerate().map(|(i, r)| (r.identity, i)).collect();
    let mut seen: BTreeMap<u64, usize> = BTreeMap::new();
    let mut predictor = Predictor::default();
    for (i, record) in records.iter().enumerate() {
        let from = carried.get(&(record.identity, record.frame)).filter(|j| before[**j].birth == record.birth);
        let parent = seen.get(&record.identity).filter(|j| records[**j].birth == record.birth);
        let kept = last.get(&record.identity).filter(|j| before[**j].birth == record.birth);
        let (kind, linked) = match (from, parent, kept) {
            (Some(j), _, _) => (CARRIED, Some((*j, before[*j]))),
            (None, Some(j), _) => (FOLLOWING, Some((*j, records[*j]))),
            (None, None, Some(j)) => (KEPT, Some((*j, before[*j]))),
            (None, None, None) => (FRESH, None),
        };
        columns[KIND].push(kind);
        let code = record.reference as u64 | (record.handover as u64) << 1;
        columns[CODE].push(code);
        if kind != CARRIED {
            let expected = predictor.frames[kind as usize];
            columns[FRAME].push_signed(record.frame.wrapping_sub(expected).cast_signed());
        }
        match linked {
            Some((j, _)) => {
                let next = &mut predictor.next[kind as usize];
                let jump = (j as u64).wrapping_sub(*next).cast_signed();
                let row = (jump + ROW / 2).div_euclid(ROW);
                columns[LINK_ROW].push_signed(row);
                columns[LINK].push_signed(jump - row * ROW);
                *next = j as u64 + 1;
            }
            None => {
                columns[IDENTITY].push_signed(record.identity.wrapping_sub(predictor.fresh).cast_signed());
                columns[BIRTH].push_signed(record.frame.wrapping_sub(record.birth).cast_signed());
            }
        }
        let linked = linked.map(|(_, r)| r).unwrap_or_default();
        let mut prediction = predictor.prediction(kind, &linked, step);
        if kind == FOLLOWING {
            let offset = following_offset(&linked, record);
            prediction[OFFSET..OFFSET + 3].copy_from_slice(&offset);
        }
        for (k, (value, expected)) in record.values.iter().zip(prediction).enumerate() {
            columns[FIRST + k].push_signed(value - expected);
        }
        predictor.remember(kind, record);
        seen.insert(record.identity, i);
    }
    let mut first: BTreeMap<u64, usize> = BTreeMap::new();
    if !merges.is_empty() {
        for (i, record) in records.iter().enumerate() {
            first.entry(record.identity).or_insert(i);
        }
    }
    let (mut last, mut other) = ([0, 0], 0);
    for merge in merges {
        for (k, (identity, places)) in [(merge.identity, &first), (merge.into, &seen)].into_iter().enumerate() {
            let place = places.get(&identity).copied();
            if place.is_none() {
                columns[MERGE_OTHER].push_signed(identity.wrapping_sub(other).cast_signed());
                other = identity;
            }
            let place = place.unwrap_or(records.len()) as i64;
            columns[MERGE + k].push_signed(place - last[k]);
            last[k] = place;
        }
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
        let most = if at < MERGE { count } else { merges };
        columns.push(Values::read(name, if at == MERGE_OTHER { 2 * most } else { most }, &mut rest)?);
    }
    let written = std::array::from_fn(|k| !VALUES[k].rare || columns[FIRST + k].remaining() > 0);
    if !rest.is_empty() {
        return Err(FormatError::new("chunk", "its end after the last column", format!("{} more bytes", rest.len())));
    }
    for (column, expected) in [(KIND, count), (CODE, count), (FIRST, count), (MERGE, merges)] {
        let found = columns[column].remaining();
        if found < expected || expected > MOST {
            let what = format!("{expected} numbers, of at most {MOST}");
            return Err(FormatError::new(format!("column {}", columns[column].name), what, found.to_string()));
        }
    }
    let mut records: Vec<Quantised> = Vec::with_capacity(count);
    let mut predictor = Predictor::default();
    for _ in 0..count {
        let record = next(&mut columns, &written, before, &records, &mut predictor)?;
        records.push(record);
    }
    let mut found = Vec::with_capacity(merges);
    let (mut last, mut other) = ([0_u64, 0], 0_u64);
    for _ in 0..merges {
        let mut identities = [0; 2];
        for (k, column) in [MERGE, MERGE_INTO].into_iter().enumerate() {
            last[k] = last[k].wrapping_add_signed(columns[column].next_signed()?);
            identities[k] = match records.get(last[k] as usize) {
                Some(record) => record.identity,
                None if last[k] == count as u64 => {
                    other = other.wrapping_add_signed(columns[MERGE_OTHER].next_signed()?);
                    other
                }
                None => {
                    let part = format!("column {}", columns[column].name);
                    return Err(FormatError::new(part, format!("a record, or {count} for none"), last[k].to_string()));
                }
            };
        }
        let [identity, into] = identities;
        found.push(Merge { identity, into });
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
        CARRIED | KEPT => before,
        FOLLOWING => records,
        other => return Err(wrong("column kind", "0 to 3", other)),
    };
    let mut record = Quantised {
        reference: Reference::from_code(code as u8 & 1).unwrap_or_default(),
        handover: Handover::from_code((code >> 1).min(255) as u8)
            .ok_or_else(|| wrong("column code", "0 to 5", code))?,
        ..Quantised::default()
    };
    if kind != CARRIED {
        record.frame = predictor.frames[kind as usize].wrapping_add_signed(columns[FRAME].next_signed()?);
    }
    let mut linked = Quantised::default();
    if kind == FRESH {
        record.identity = predictor.fresh.wrapping_add_signed(columns[IDENTITY].next_signed()?);
        record.birth = record.frame.wrapping_sub(columns[BIRTH].next_signed()?.cast_unsigned());
    } else {
        let next = &mut predictor.next[kind as usize];
        let (row, within) = (columns[LINK_ROW].next_signed()?, columns[LINK].next_signed()?);
        if row.unsigned_abs() > MOST_ROWS || !(-ROW / 2..ROW / 2).contains(&within) {
            return Err(FormatError::new("columns link_row, link", LINK_RANGE, format!("{row}, {within}")));
        }
        let link = next.wrapping_add_signed(row * ROW + within);
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
    let mut prediction = predictor.prediction(kind, &linked, |_| 1);
    for (k, value) in VALUES.iter().enumerate() {
        if k == OFFSET && kind == FOLLOWING {
            let offset = following_offset(&linked, &record);
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
