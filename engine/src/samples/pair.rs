//! Conversion of two parts to the same channels, where that loses nothing.
//!
//! Two OpenEXR parts must have the same windows and the same channels. Otherwise grey becomes RGB with three equal
//! channels, a picture without alpha becomes opaque, and colours are multiplied by alpha if the other's are. Each
//! conversion adds a note.

use super::{Channel, Part, Samples};

/// Two parts with the same channels in the same order.
#[derive(Clone, Debug)]
pub struct Pair {
    /// The first.
    pub a: Part,
    /// The second.
    pub b: Part,
    /// Conversions that made them comparable, and differences of type; one per line.
    pub notes: Vec<String>,
}

/// Converts two parts to the same channels.
///
/// # Errors
/// Reason why they cannot be compared: expected and found values in one line.
pub fn pair(mut a: Part, mut b: Part) -> Result<Pair, String> {
    let mut notes = Vec::new();
    if a.name != b.name && a.windows.is_some() && b.windows.is_some() {
        return Err(format!("expected two parts of one name, found {:?} and {:?}", a.name, b.name));
    }
    match (a.windows, b.windows) {
        (Some(first), Some(second)) if first != second => {
            let text = |[x, y, w, h]: [i64; 4]| format!("{w}×{h} at {x},{y}");
            let what = if first.display == second.display { "data" } else { "display" };
            let window = |windows: super::Windows| if what == "data" { windows.data } else { windows.display };
            let (first, second) = (text(window(first)), text(window(second)));
            return Err(format!("expected two {what} windows at one place, found {first} and {second}"));
        }
        (Some(_), Some(_)) => {}
        _ => {
            [&mut a, &mut b].into_iter().filter_map(displayed).for_each(|note| notes.push(note));
            same_colours(&mut a, &mut b, &mut notes);
        }
    }
    if (a.width, a.height) != (b.width, b.height) {
        return Err(format!(
            "expected two pictures of one size, found {}×{} and {}×{}",
            a.width, a.height, b.width, b.height
        ));
    }
    let names = |part: &Part| {
        let mut names: Vec<String> = part.channels.iter().map(|channel| channel.name.clone()).collect();
        names.sort();
        names
    };
    let (first, second) = (names(&a), names(&b));
    if first != second {
        return Err(format!("expected the same channels, found {} and {}", first.join(", "), second.join(", ")));
    }
    // Names within a part are different, or the order decides.
    if first.windows(2).all(|pair| pair[0] != pair[1]) {
        let order = |channel: &Channel| a.channels.iter().position(|other| other.name == channel.name);
        b.channels.sort_by_key(order);
    }
    for (one, other) in a.channels.iter().zip(&b.channels) {
        if (one.width, one.height) != (other.width, other.height) {
            let (name, (w, h), (x, y)) = (&one.name, (one.width, one.height), (other.width, other.height));
            return Err(format!("channel {name}: expected two of one size, found {w}×{h} and {x}×{y} samples"));
        }
        let kinds = [one.samples.kind(), other.samples.kind()];
        let note = format!("samples of {} and {} are compared by their values", kinds[0], kinds[1]);
        if kinds[0] != kinds[1] && !notes.contains(&note) {
            notes.push(note);
        }
    }
    Ok(Pair { a, b, notes })
}

/// Extends an OpenEXR part to its displayed pixels; outside of the stored window every sample is 0.
fn displayed(part: &mut Part) -> Option<String> {
    let windows = part.windows.take()?;
    let ([x, y, w, h], [left, top, width, height]) = (windows.data, windows.display);
    let subsampled = part.channels.iter().any(|c| (c.width, c.height) != (part.width, part.height));
    let allowed = usize::try_from(width).ok().zip(usize::try_from(height).ok());
    let allowed = allowed.filter(|(w, h)| crate::picture::size_is_allowed(*w, *h));
    if windows.data == windows.display || subsampled || (w as usize, h as usize) != (part.width, part.height) {
        return None;
    }
    let (width, height) = allowed?;
    for channel in &mut part.channels {
        let zero = channel.samples.len();
        let stored = |row: usize, column: usize| {
            let (row, column) = (row as i64 + top - y, column as i64 + left - x);
            let inside = (0..h).contains(&row) && (0..w).contains(&column);
            if inside { (row * w + column) as usize } else { zero }
        };
        let places: Vec<usize> = (0..width * height).map(|pixel| stored(pixel / width, pixel % width)).collect();
        channel.samples.push_zero();
        channel.samples = channel.samples.taken(places.into_iter());
        (channel.width, channel.height) = (width, height);
    }
    (part.width, part.height) = (width, height);
    Some("the EXR picture is compared within its display window, 0 where it stores nothing".to_owned())
}

/// Converts grey to RGB, adds opaque alpha, and multiplies colours by alpha, where the other part has these.
fn same_colours(a: &mut Part, b: &mut Part, notes: &mut Vec<String>) {
    let colours = |part: &Part| -> Vec<String> {
        part.channels.iter().map(|channel| channel.name.clone()).filter(|name| name != "A").collect()
    };
    let (first, second) = (colours(a), colours(b));
    let is_rgb = |names: &[String]| {
        let mut names: Vec<&str> = names.iter().map(String::as_str).collect();
        names.sort_unstable();
        names == ["B", "G", "R"]
    };
    for (grey, other, part) in [(&first, &second, &mut *a), (&second, &first, &mut *b)] {
        if *grey == ["Y"] && is_rgb(other) {
            let Some(at) = part.channels.iter().position(|channel| channel.name == "Y") else { continue };
            let grey = part.channels.remove(at);
            let named = |name: &str| Channel { name: name.to_owned(), ..grey.clone() };
            part.channels.splice(at..at, ["R", "G", "B"].map(named));
            notes.push("one of them is grey: it is compared as three equal channels".to_owned());
        }
    }
    let [with, without] = [a.channel("A").is_some(), b.channel("A").is_some()];
    if with != without {
        let opaque = if with { &mut *b } else { &mut *a };
        if let Some(channel) = opaque.channels.first() {
            let alpha = Channel { name: "A".to_owned(), samples: channel.samples.full(), ..channel.clone() };
            opaque.channels.push(alpha);
            notes.push("one of them has no alpha: it is compared as opaque".to_owned());
        }
    }
    if a.premultiplied != b.premultiplied {
        let straight = if a.premultiplied { &mut *b } else { &mut *a };
        if multiply(straight) {
            notes.push("colours of one of them are multiplied by alpha: so are the other's here".to_owned());
        }
    }
}

/// Multiplies colours by alpha; returns false where nothing is transparent.
fn multiply(part: &mut Part) -> bool {
    let Some(alpha) = part.channel("A").map(|channel| channel.samples.values()) else { return false };
    if alpha.iter().all(|alpha| *alpha == 1.0) {
        return false;
    }
    for channel in
        part.channels.iter_mut().filter(|channel| channel.name != "A" && channel.samples.len() == alpha.len())
    {
        let values = channel.samples.values();
        channel.samples = Samples::F64(values.iter().zip(&alpha).map(|(value, alpha)| value * alpha).collect());
    }
    part.premultiplied = true;
    true
}

impl Samples {
    /// Adds a zero.
    fn push_zero(&mut self) {
        match self {
            Samples::U8(v) => v.push(0),
            Samples::U16(v) => v.push(0),
            Samples::U32(v) | Samples::Whole(v) => v.push(0),
            Samples::Signed(_, v) => v.push(0),
            Samples::F16(v) => v.push(half::f16::ZERO),
            Samples::F32(v) => v.push(0.0),
            Samples::F64(v) => v.push(0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::Windows;

    fn grey(values: &[u8]) -> Part {
        Part::interleaved(values.len(), 1, 1, &Samples::U8(values.to_vec()))
    }

    #[test]
    fn grey_and_opaque_pictures_are_brought_together_and_said() {
        let rgba = Part::interleaved(2, 1, 4, &Samples::U8(vec![7, 7, 7, 255, 9, 9, 9, 255]));
        let found = pair(grey(&[7, 9]), rgba).expect("two pictures");
        assert_eq!(found.notes.len(), 2, "{:?}", found.notes);
        assert_eq!(found.a.channels, found.b.channels);
    }

    #[test]
    fn colours_are_multiplied_where_the_others_are() {
        let straight = Part::interleaved(1, 1, 4, &Samples::U8(vec![200, 100, 0, 51]));
        let mut other = Part::interleaved(1, 1, 4, &Samples::U8(vec![40, 20, 0, 51]));
        other.premultiplied = true;
        let found = pair(straight, other).expect("two pictures");
        let values =
            |part: &Part| part.channels.iter().map(|c| (c.samples.values()[0] * 255.0).round()).collect::<Vec<_>>();
        assert_eq!(values(&found.a), values(&found.b));
    }

    #[test]
    fn windows_and_channels_that_differ_are_no_pair() {
        let part = |x: i64, name: &str| Part {
            windows: Some(Windows { data: [x, 0, 2, 1], display: [0, 0, 8, 1] }),
            channels: vec![Channel {
                name: name.to_owned(),
                width: 2,
                height: 1,
                samples: Samples::F32(vec![1.0, 2.0]),
            }],
            ..grey(&[0, 0])
        };
        assert!(pair(part(1, "Z"), part(1, "Z")).is_ok());
        let error = pair(part(1, "Z"), part(3, "Z")).expect_err("another window");
        assert_eq!(error, "expected two data windows at one place, found 2×1 at 1,0 and 2×1 at 3,0");
        assert_eq!(
            pair(part(1, "Z"), part(1, "Y")).expect_err("channels"),
            "expected the same channels, found Z and Y"
        );
        // Compared with another format, only the displayed pixels count.
        let found = pair(part(1, "Y"), grey(&[0, 255, 0, 0, 0, 0, 0, 0])).expect("two pictures");
        assert_eq!(found.a.channels[0].samples.values(), [0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
