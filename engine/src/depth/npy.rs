//! NumPy's NPY files: one array with a header in Python's notation.

use super::Map;
use crate::picture::size_is_allowed;

/// Reads a two-dimensional array of any element type and order; leading and trailing axes of length 1 are dropped.
///
/// # Errors
/// Expected and found values.
pub(super) fn read(bytes: &[u8]) -> Result<Map, String> {
    let short = || "the NPY file ends within its header".to_owned();
    if !bytes.starts_with(b"\x93NUMPY") {
        return Err("expected an NPY file (starting with \\x93NUMPY)".into());
    }
    let version = *bytes.get(6).ok_or_else(short)?;
    let (start, length) = match version {
        1 => (10, bytes.get(8..10).map(|b| usize::from(u16::from_le_bytes([b[0], b[1]])))),
        2 | 3 => (12, bytes.get(8..12).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize)),
        other => return Err(format!("expected NPY version 1 to 3, found {other}")),
    };
    let length = length.ok_or_else(short)?;
    let end = start + length;
    let header = bytes.get(start..end).ok_or_else(short)?;
    let header = std::str::from_utf8(header).map_err(|_| "the NPY header is not text".to_owned())?;
    let kind = quoted(header, "descr").ok_or("the NPY header gives no descr")?;
    let fortran = after(header, "fortran_order").is_some_and(|rest| rest.starts_with("True"));
    let shape = shape(header).ok_or("the NPY header gives no shape")?;
    let (height, width) = plane(&shape).ok_or_else(|| format!("expected an NPY array [H,W], found {shape:?}"))?;
    if !size_is_allowed(width, height) {
        return Err(format!("the map is {width}×{height}, expected at least 1×1 and no more than this program reads"));
    }
    let count = width * height;
    let data = &bytes[end..];
    let (little, code) = (!kind.starts_with('>'), kind.trim_start_matches(['<', '>', '|', '=']));
    let width_of = |size: usize| -> Result<(), String> {
        if data.len() == count * size {
            Ok(())
        } else {
            Err(format!("expected {} bytes of {kind} values, found {}", count * size, data.len()))
        }
    };
    macro_rules! values {
        ($kind:ty, $convert:expr) => {{
            const SIZE: usize = size_of::<$kind>();
            width_of(SIZE)?;
            let (chunks, _) = data.as_chunks::<SIZE>();
            let convert: fn($kind) -> f32 = $convert;
            let read = |b: &[u8; SIZE]| if little { <$kind>::from_le_bytes(*b) } else { <$kind>::from_be_bytes(*b) };
            chunks.iter().map(|b| convert(read(b))).collect()
        }};
    }
    let values: Vec<f32> = match code {
        "f4" => values!(f32, |v| v),
        "f8" => values!(f64, |v| v as f32),
        "f2" => values!(half::f16, half::f16::to_f32),
        "u1" => values!(u8, f32::from),
        "u2" => values!(u16, f32::from),
        "u4" => values!(u32, |v| v as f32),
        "u8" => values!(u64, |v| v as f32),
        "i1" => values!(i8, f32::from),
        "i2" => values!(i16, f32::from),
        "i4" => values!(i32, |v| v as f32),
        "i8" => values!(i64, |v| v as f32),
        _ => return Err(format!("expected NPY values f2 to f8, u1 to u8 or i1 to i8, found {kind:?}")),
    };
    // In Fortran's order the first axis is the fastest: columns follow each other.
    let values = if fortran { (0..count).map(|at| values[at % width * height + at / width]).collect() } else { values };
    Ok(Map { width, height, values })
}

/// Returns height and width of a plane. If there are more axes, leading axes of length 1 are dropped first, then
/// trailing ones, until two remain: `[1, 1, W]` has height 1 and width W.
fn plane(shape: &[usize]) -> Option<(usize, usize)> {
    match shape {
        [h, w] => Some((*h, *w)),
        [1, rest @ ..] if rest.len() >= 2 => plane(rest),
        [rest @ .., 1] if rest.len() >= 2 => plane(rest),
        _ => None,
    }
}

fn after<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let at = header.find(&format!("'{key}'")).or_else(|| header.find(&format!("\"{key}\"")))?;
    let rest = &header[at + key.len() + 2..];
    Some(rest.trim_start().strip_prefix(':')?.trim_start())
}

fn quoted<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let rest = after(header, key)?;
    let quote = rest.chars().next().filter(|c| matches!(c, '\'' | '"'))?;
    rest[1..].split_once(quote).map(|(value, _)| value)
}

fn shape(header: &str) -> Option<Vec<usize>> {
    let rest = after(header, "shape")?.strip_prefix('(')?;
    let (inside, _) = rest.split_once(')')?;
    inside.split(',').map(str::trim).filter(|n| !n.is_empty()).map(|n| n.parse().ok()).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    pub(in crate::depth) fn encode(kind: &str, shape: &str, values: &[f32]) -> Vec<u8> {
        let header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend_from_slice(&(header.len() as u16).to_le_bytes());
        bytes.extend_from_slice(header.as_bytes());
        bytes.extend(values.iter().flat_map(|v| if kind.starts_with('>') { v.to_be_bytes() } else { v.to_le_bytes() }));
        bytes
    }

    #[test]
    fn both_byte_orders_and_axes_of_one_are_read() {
        for (kind, shape) in [
            ("<f4", "(2, 3)"),
            (">f4", "(1, 2, 3)"),
            ("<f4", "(2, 3, 1)"),
            ("<f4", "(1, 1, 2, 3)"),
            ("<f4", "(1, 2, 3, 1)"),
        ] {
            let map = read(&encode(kind, shape, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.5])).expect("valid");
            assert_eq!((map.width, map.height, map.values[5]), (3, 2, 6.5));
        }
    }

    #[test]
    fn wrong_shapes_kinds_and_lengths_are_errors() {
        let values = [0.0; 6];
        for (kind, shape) in
            [("<f4", "(6,)"), ("<f4", "(3, 3)"), ("<c8", "(2, 3)"), ("<f4", "(0, 3)"), ("<f4", "(99999999, 99999999)")]
        {
            assert!(read(&encode(kind, shape, &values)).is_err(), "{kind} {shape}");
        }
        assert!(read(&encode("<f4", "(2, 3, 2)", &[0.0; 12])).is_err());
    }

    /// Builds a file with these bytes.
    fn file(kind: &str, fortran: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = encode(kind, "(2, 3)", &[]);
        bytes = String::from_utf8_lossy(&bytes[10..]).replace("False", fortran).into_bytes();
        [&b"\x93NUMPY\x01\x00"[..], &(bytes.len() as u16).to_le_bytes(), &bytes, data].concat()
    }

    #[test]
    fn every_kind_of_number_and_either_order_is_read() {
        let expected = [0.0, 1.0, 2.0, 3.0, 4.0, 100.0];
        macro_rules! holds {
            ($($kind:ty: $name:literal),*) => {$(
                let little: Vec<u8> = expected.iter().flat_map(|&v| (v as $kind).to_le_bytes()).collect();
                let big: Vec<u8> = expected.iter().flat_map(|&v| (v as $kind).to_be_bytes()).collect();
                for (order, data) in [("<", little), (">", big)] {
                    let map = read(&file(&format!("{order}{}", $name), "False", &data)).expect($name);
                    assert_eq!(map.values, expected, "{order}{}", $name);
                }
            )*};
        }
        holds!(f64: "f8", u8: "u1", u16: "u2", u32: "u4", u64: "u8", i8: "i1", i16: "i2", i32: "i4", i64: "i8");
        let negative = read(&file("<i2", "False", &[0xff, 0xff, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0])).expect("whole numbers");
        assert_eq!(negative.values[..2], [-1.0, 1.0]);
        // Columns first.
        let map = read(&file("|u1", "True ", &[0, 3, 1, 4, 2, 100])).expect("Fortran's order");
        assert_eq!((map.width, map.height, map.values), (3, 2, expected.to_vec()));
    }

    proptest! {
        #[test]
        fn no_bytes_panic(tail in proptest::collection::vec(any::<u8>(), 0..80)) {
            let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
            bytes.extend(tail);
            let _ = read(&bytes);
        }
    }
}
