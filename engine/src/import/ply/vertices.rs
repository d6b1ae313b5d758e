//! Gaussians of a PLY file in the layout of 3D Gaussian splatting.

use streamsplat_kernels::harmonics::Y0;

use super::header::{Element, Encoding, Header, Property, Scalar, quoted};
use crate::import::{FormatError, Limits, check_count};
use crate::still::Still;

/// Properties of every file, without its colours.
const WANTED: [&str; 11] =
    ["x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
/// Colours, as the harmonics' first coefficients or as they are seen.
const COEFFICIENTS: [&str; 3] = ["f_dc_0", "f_dc_1", "f_dc_2"];
const COLOURS: [&str; 3] = ["red", "green", "blue"];

/// Places of the wanted values among the properties.
struct Layout {
    /// [`WANTED`], then the colours, then `f_rest`.
    places: Vec<usize>,
    /// Where colours stand in place of coefficients: the numbers that stand for 1.
    ones: Option<[f64; 3]>,
    /// Degree of the harmonics.
    degree: usize,
}

impl Layout {
    fn of(vertices: &Element) -> Result<Layout, FormatError> {
        let rest = vertices.properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
        let degree = [0, 9, 24, 45]
            .iter()
            .position(|n| *n == rest)
            .ok_or_else(|| FormatError::new("properties f_rest_*", "none, 9, 24 or 45 of them", rest.to_string()))?;
        let seen = vertices.property(COEFFICIENTS[0]).is_none() && vertices.property(COLOURS[0]).is_some();
        let colours = if seen { COLOURS } else { COEFFICIENTS };
        let names = WANTED.iter().chain(&colours).map(|name| (*name).to_owned());
        let names = names.chain((0..rest).map(|i| format!("f_rest_{i}")));
        let is_colour = |name: &str| COLOURS.contains(&name);
        let place = |name: String| {
            let wrong = |found: &str| {
                let colour = if is_colour(&name) { ", or a number of 8 or 16 bits without a sign" } else { "" };
                let expected = format!("it as a float of 16, 32 or 64 bits{colour}");
                FormatError::new(format!("property {name}"), expected, found)
            };
            let (place, property) = vertices.property(&name).ok_or_else(|| wrong("none"))?;
            let whole = is_colour(&name) && matches!(property.scalar, Scalar::U8 | Scalar::U16);
            if property.scalar.is_float() || whole { Ok(place) } else { Err(wrong("whole numbers")) }
        };
        let places = names.map(place).collect::<Result<Vec<usize>, _>>()?;
        let one = |k: usize| vertices.properties[places[WANTED.len() + k]].scalar.one();
        Ok(Layout { ones: seen.then(|| std::array::from_fn(one)), degree, places })
    }
}

/// Vertices as bytes, one after another.
pub(super) fn binary(header: &Header, body: &[u8], limits: &Limits) -> Result<Still, FormatError> {
    let vertices = header.vertices()?;
    let layout = Layout::of(vertices)?;
    let bytes = header.bytes(&vertices.name, body)?;
    let big = header.encoding == Encoding::Big;
    let wanted: Vec<&Property> = layout.places.iter().map(|&place| &vertices.properties[place]).collect();
    let mut filling = Filling::new(&layout, vertices.count, limits)?;
    for record in bytes.chunks_exact(vertices.stride()) {
        filling.push(wanted.iter().map(|property| property.scalar.read_single(&record[property.start..], big)));
    }
    Ok(filling.still)
}

/// Elements as lines of numbers.
pub(super) fn text(header: &Header, body: &[u8], limits: &Limits) -> Result<Still, FormatError> {
    let wrong = |part: String, expected: &str, found: &str| FormatError::new(part, expected, quoted(found));
    let vertices = header.vertices()?;
    let layout = Layout::of(vertices)?;
    // A number and what parts it from the next are two bytes at least; the last needs no line feed.
    let mut least = 0_usize;
    for element in &header.elements {
        let size = element.count.checked_mul(2 * element.properties.len());
        least = size.and_then(|size| least.checked_add(size)).unwrap_or(usize::MAX);
        if least > body.len() + 1 {
            let expected = format!("{} of {} numbers each", element.count, element.properties.len());
            return Err(element.wrong(expected, format!("{} bytes", body.len())));
        }
    }
    let body = std::str::from_utf8(body).map_err(|_| FormatError::new("body", "text", "bytes that are none"))?;
    let mut lines = body.lines();
    let mut filling = Filling::new(&layout, vertices.count, limits)?;
    for element in header.elements.iter().filter(|element| !element.properties.is_empty()) {
        let mut values = vec![0.0_f32; element.properties.len()];
        for i in 0..element.count {
            let line = lines.next();
            let line = line.ok_or_else(|| element.wrong(format!("{} lines", element.count), i.to_string()))?;
            let mut words = line.split_ascii_whitespace();
            for (value, property) in values.iter_mut().zip(&element.properties) {
                let part = || format!("property {} of {} {i}", property.name, element.name);
                let word = words.next().ok_or_else(|| wrong(part(), "a number", line))?;
                *value = word.parse().map_err(|_| wrong(part(), "a number", word))?;
            }
            if let Some(word) = words.next() {
                return Err(wrong(format!("{} {i}", element.name), "as many numbers as properties", word));
            }
            if element.name == vertices.name {
                filling.push(layout.places.iter().map(|&place| values[place]));
            }
        }
    }
    match lines.find(|line| !line.trim().is_empty()) {
        Some(line) => Err(wrong("file".into(), "nothing after the last element", line)),
        None => Ok(filling.still),
    }
}

/// A scene being filled. Room is made at once: the file has been seen to be as long.
struct Filling<'a> {
    layout: &'a Layout,
    still: Still,
}

impl<'a> Filling<'a> {
    fn new(layout: &'a Layout, count: usize, limits: &Limits) -> Result<Self, FormatError> {
        check_count("element vertex", count, limits)?;
        Ok(Self { layout, still: Still::with_room(count, layout.degree) })
    }

    /// Takes a vertex: its values in the order of [`Layout::places`].
    fn push(&mut self, mut values: impl Iterator<Item = f32>) {
        // There are as many as are taken.
        let mut next = || values.next().unwrap_or(f32::NAN);
        let still = &mut self.still;
        still.mean.push(std::array::from_fn(|_| next()));
        still.logit.push(next());
        still.log_scale.push(std::array::from_fn(|_| next()));
        still.rotation.push(std::array::from_fn(|_| next()));
        still.base.push(match self.layout.ones {
            Some(ones) => ones.map(|one| ((f64::from(next()) / one - 0.5) / Y0) as f32),
            None => std::array::from_fn(|_| next()),
        });
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
