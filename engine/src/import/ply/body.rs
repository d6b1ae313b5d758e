//! The vertices of a PLY file.

use super::header::{Header, Kind, quoted};
use crate::import::{FormatError, Limits, check_count};
use crate::still::Still;

/// Vertices as bytes, one after another.
pub(super) fn binary(
    header: &Header,
    body: &[u8],
    limits: &Limits,
    float: fn([u8; 4]) -> f32,
    double: fn([u8; 8]) -> f64,
) -> Result<Still, FormatError> {
    let starts: Vec<usize> = header
        .properties
        .iter()
        .scan(0, |at, property| {
            let start = *at;
            *at += property.kind.bytes();
            Some(start)
        })
        .collect();
    let stride: usize = header.properties.iter().map(|p| p.kind.bytes()).sum();
    if header.count.checked_mul(stride) != Some(body.len()) {
        let expected = format!("{} of {stride} bytes each", header.count);
        return Err(FormatError::new("vertices", expected, format!("{} bytes", body.len())));
    }
    let wanted: Vec<(usize, Kind)> = header.places.iter().map(|&p| (starts[p], header.properties[p].kind)).collect();
    let mut filling = Filling::new(header, limits)?;
    for record in body.chunks_exact(stride) {
        filling.push(wanted.iter().map(|&(at, kind)| match kind {
            Kind::Double => record[at..].first_chunk().map_or(f32::NAN, |b| double(*b) as f32),
            _ => record[at..].first_chunk().map_or(f32::NAN, |b| float(*b)),
        }));
    }
    Ok(filling.still)
}

/// Vertices as lines of numbers.
pub(super) fn text(header: &Header, body: &[u8], limits: &Limits) -> Result<Still, FormatError> {
    let wrong = |part: String, expected: &str, found: &str| FormatError::new(part, expected, quoted(found));
    // A number and what parts it from the next are two bytes at least; the last needs no line feed.
    let least = header.count.checked_mul(2 * header.properties.len());
    if least.is_none_or(|least| least > body.len() + 1) {
        let expected = format!("{} of {} numbers each", header.count, header.properties.len());
        return Err(FormatError::new("vertices", expected, format!("{} bytes", body.len())));
    }
    let body = std::str::from_utf8(body).map_err(|_| FormatError::new("vertices", "text", "bytes that are none"))?;
    let mut lines = body.lines();
    let mut filling = Filling::new(header, limits)?;
    let mut values = vec![0.0_f32; header.properties.len()];
    for i in 0..header.count {
        let line = lines
            .next()
            .ok_or_else(|| FormatError::new("vertices", format!("{} lines", header.count), format!("{i}")))?;
        let mut words = line.split_ascii_whitespace();
        for (value, property) in values.iter_mut().zip(&header.properties) {
            let part = || format!("property {} of vertex {i}", property.name);
            let word = words.next().ok_or_else(|| wrong(part(), "a number", line))?;
            *value = word.parse().map_err(|_| wrong(part(), "a number", word))?;
        }
        if let Some(word) = words.next() {
            return Err(wrong(format!("vertex {i}"), "as many numbers as properties", word));
        }
        filling.push(header.places.iter().map(|&place| values[place]));
    }
    match lines.find(|line| !line.trim().is_empty()) {
        Some(line) => Err(wrong("vertices".into(), "nothing after the last", line)),
        None => Ok(filling.still),
    }
}

/// A scene being filled. Room is made at once: the file has been seen to be as long.
struct Filling {
    still: Still,
}

impl Filling {
    fn new(header: &Header, limits: &Limits) -> Result<Self, FormatError> {
        let n = header.count;
        check_count("element vertex", n, limits)?;
        let mut still = Still { degree: header.degree, ..Still::default() };
        let higher = n * 3 * still.rest();
        still.mean.reserve_exact(n);
        still.log_scale.reserve_exact(n);
        still.rotation.reserve_exact(n);
        still.logit.reserve_exact(n);
        still.base.reserve_exact(n);
        still.higher.reserve_exact(higher);
        Ok(Self { still })
    }

    /// Takes a vertex: its values in the order of [`Header::places`].
    fn push(&mut self, mut values: impl Iterator<Item = f32>) {
        // There are as many as are taken.
        let mut next = || values.next().unwrap_or(f32::NAN);
        let still = &mut self.still;
        still.mean.push(std::array::from_fn(|_| next()));
        still.base.push(std::array::from_fn(|_| next()));
        still.logit.push(next());
        still.log_scale.push(std::array::from_fn(|_| next()));
        still.rotation.push(std::array::from_fn(|_| next()));
        let rest = still.rest();
        let from = still.higher.len();
        still.higher.resize(from + 3 * rest, 0.0);
        for channel in 0..3 {
            for k in 0..rest {
                still.higher[from + 3 * k + channel] = next();
            }
        }
    }
}
