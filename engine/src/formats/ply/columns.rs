//! Columns of numbers by name, for formats that add their own to those of a still scene.

use super::header::{Encoding, Header};
use crate::formats::FormatError;

/// The numbers of a column; `None` if there is no float column of this name.
pub(in crate::formats) type Column = Option<Vec<f32>>;

/// Maximum number of columns named in a message.
const NAMED: usize = 8;

/// Returns a note on the vertex columns that no reader uses, if there are any. Normals, which are zeros, do not count.
pub(crate) fn left_out(head: &[u8]) -> Option<String> {
    let (header, _) = head.starts_with(b"ply").then(|| Header::read(head).ok()).flatten()?;
    let vertices = header.vertices().ok()?;
    let has_base = vertices.property("f_dc_0").is_some();
    let is_read = |name: &str| {
        let colour = !has_base && ["red", "green", "blue"].contains(&name);
        let numbered = |start: &str, most: usize| {
            name.strip_prefix(start).and_then(|rest| rest.parse().ok()).is_some_and(|number: usize| number < most)
        };
        let plain = ["x", "y", "z", "nx", "ny", "nz", "opacity"].contains(&name) || name.starts_with("packed_");
        let counted = [("f_dc_", 3), ("scale_", 3), ("rot_", 4), ("f_rest_", usize::MAX)];
        plain || colour || counted.into_iter().any(|(start, most)| numbered(start, most))
    };
    let names = vertices.properties.iter().map(|property| property.name.as_str());
    let names: Vec<&str> = names.filter(|name| !is_read(name)).collect();
    let first = names.iter().take(NAMED).copied().collect::<Vec<_>>().join(", ");
    match names.len().saturating_sub(NAMED) {
        _ if names.is_empty() => None,
        0 => Some(format!("columns left out: {first}")),
        more => Some(format!("columns left out: {first} and {more} more")),
    }
}

/// Returns columns of a file whose vertices have been read.
pub(in crate::formats) fn columns(bytes: &[u8], names: &[&str]) -> Result<Vec<Column>, FormatError> {
    let (header, body) = Header::read(bytes)?;
    let vertices = header.vertices()?;
    let places: Vec<Option<usize>> = names
        .iter()
        .map(|name| vertices.property(name).filter(|(_, property)| property.scalar.is_float()).map(|(place, _)| place))
        .collect();
    let mut found: Vec<Column> = places.iter().map(|place| place.map(|_| Vec::with_capacity(vertices.count))).collect();
    if header.encoding == Encoding::Text {
        let text = std::str::from_utf8(body).map_err(|_| FormatError::new("body", "text", "bytes that are none"))?;
        let before = header.elements.iter().take_while(|element| element.name != vertices.name);
        let before = before.filter(|element| !element.properties.is_empty()).map(|element| element.count).sum();
        for line in text.lines().skip(before).take(vertices.count) {
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            for (column, place) in found.iter_mut().zip(&places) {
                let value: Option<f32> = place.and_then(|place| words.get(place)?.parse().ok());
                column.iter_mut().for_each(|column| column.extend(value));
            }
        }
    } else {
        let big = header.encoding == Encoding::Big;
        for record in header.bytes(&vertices.name, body)?.chunks_exact(vertices.stride().max(1)) {
            for (column, place) in found.iter_mut().zip(&places) {
                let value = place.map(|place| &vertices.properties[place]);
                let value = value.map(|property| property.scalar.read_single(&record[property.start..], big));
                column.iter_mut().for_each(|column| column.extend(value));
            }
        }
    }
    match found.iter().flatten().find(|column| column.len() != vertices.count) {
        Some(short) => Err(vertices.wrong(format!("{} records", vertices.count), short.len().to_string())),
        None => Ok(found),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_that_nothing_reads_are_named() {
        let head = |names: &[&str]| {
            let lines: String = names.iter().map(|name| format!("property float {name}\n")).collect();
            format!("ply\nformat ascii 1.0\nelement vertex 0\n{lines}end_header\n").into_bytes()
        };
        let read = ["x", "y", "z", "nx", "f_dc_0", "f_rest_44", "opacity", "scale_2", "rot_3"];
        assert_eq!(left_out(&head(&read)), None);
        assert_eq!(left_out(&head(&["x", "red", "green", "blue"])), None);
        let more = [&read[..], &["red", "segment", "scale_3"]].concat();
        assert_eq!(left_out(&head(&more)).as_deref(), Some("columns left out: red, segment, scale_3"));
        let many: Vec<String> = (0..10).map(|k| format!("feature_{k}")).collect();
        let many: Vec<&str> = many.iter().map(String::as_str).collect();
        let line = left_out(&head(&many)).expect("a line");
        assert!(line.ends_with("feature_7 and 2 more"), "{line}");
        assert_eq!((left_out(b"ply\n"), left_out(b"{}")), (None, None));
    }
}
