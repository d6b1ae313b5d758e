//! OpenEXR pictures: selection of the colour channels, and conversion of their colour space.
//!
//! The picture is the display window. Outside the data window it is black, and transparent if there is alpha. Pixels
//! that are not square are made square by enlarging one side.
//!
//! Colours are linear light of BT.709's primaries unless the file declares another space: by `colorInteropID`, by
//! `oiio:ColorSpace`, by the flag of ACES containers or by its chromaticities. They are premultiplied by alpha, as the
//! format requires. Linear colours are composited over mid grey in linear light, display-referred ones as they are
//! stored.

mod light;
mod space;

use std::path::Path;

use super::{Interleaved, Still, compose, decode_error};
use crate::openexr::{File, Part};
use crate::picture::size_is_allowed;
use crate::source::SourceError;
use space::Space;

/// Maximum number of names that a message lists.
const LISTED: usize = 12;
/// Layer names, in lower case, that mean the whole picture.
const WHOLE: [&str; 9] = ["combined", "beauty", "rgba", "rgb", "colour", "color", "composite", "main", "final"];

pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<Still, SourceError> {
    let wrong = |cause: String| decode_error(path, cause);
    let file = File::open(bytes).map_err(|e| wrong(e.to_string()))?;
    let mut notes = Vec::new();
    let colours = choose(&file, &mut notes).map_err(wrong)?;
    let space = Space::of(colours.part).map_err(wrong)?;
    notes.extend(space.note());
    let names = colours.names();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let planes = file.read(colours.part, &names, 0.0).map_err(|e| wrong(e.to_string()))?;
    let window = colours.part.display();
    let (width, height) = (window.width, window.height);
    let channels = planes.len();
    let mut samples = Vec::with_capacity(channels * width * height);
    for pixel in 0..width * height {
        samples.extend(planes.iter().map(|plane| plane[pixel]));
    }
    drop(planes);
    if let Some(at) = samples.iter().position(|v| !v.is_finite()) {
        let (pixel, value) = (at / channels, samples[at]);
        return Err(SourceError::NotFinite { path: path.to_owned(), x: pixel % width, y: pixel / width, value });
    }
    let transparent = colours.alpha && samples.chunks_exact(channels).any(|pixel| pixel[channels - 1] < 1.0);
    let image = if space.is_shown() {
        Interleaved { width, height, channels, samples, premultiplied: true }
    } else {
        let kept = channels - usize::from(colours.alpha);
        let samples = space.shown(&samples, kept, colours.alpha);
        Interleaved { width, height, channels: kept.max(1), samples, premultiplied: true }
    };
    let mut still = compose(&image, path)?;
    if transparent && !still.notes.iter().any(|note| note == super::OVER_GREY) {
        still.notes.insert(0, super::OVER_GREY.to_owned());
    }
    still.notes.extend(notes);
    square(&mut still, colours.part.pixel_aspect(), path)?;
    Ok(still)
}

/// Makes pixels square by enlarging one side.
fn square(still: &mut Still, aspect: f32, path: &Path) -> Result<(), SourceError> {
    /// Plausible pixel aspects.
    const USUAL: std::ops::RangeInclusive<f32> = 0.1..=10.0;
    if (aspect - 1.0).abs() < 0.001 {
        return Ok(());
    }
    if !USUAL.contains(&aspect) {
        return Err(decode_error(path, format!("expected a pixel aspect from 0.1 to 10, found {aspect}")));
    }
    let (width, height) = (still.picture.width, still.picture.height);
    let scaled = |side: usize, by: f64| (side as f64 * by).round() as usize;
    let aspect64 = f64::from(aspect);
    let (to_width, to_height) =
        if aspect > 1.0 { (scaled(width, aspect64), height) } else { (width, scaled(height, 1.0 / aspect64)) };
    if !size_is_allowed(to_width, to_height) {
        return Err(SourceError::TooLarge { path: path.to_owned(), width: to_width, height: to_height });
    }
    still.picture = still.picture.resized(to_width, to_height);
    still.notes.push(format!("pixels {aspect} times as wide as high were made square"));
    Ok(())
}

/// The channels of a part that are colours.
struct Colours<'a> {
    part: Part<'a>,
    /// Layer prefix of the channels' names, with its trailing dot.
    prefix: String,
    /// True for luminance alone.
    grey: bool,
    alpha: bool,
}

impl Colours<'_> {
    fn names(&self) -> Vec<String> {
        let colours: &[&str] = if self.grey { &["Y"] } else { &["R", "G", "B"] };
        let alpha: &[&str] = if self.alpha { &["A"] } else { &[] };
        colours.iter().chain(alpha).map(|name| format!("{}{name}", self.prefix)).collect()
    }

    /// Returns the layer's name for messages.
    fn label(&self) -> String {
        let prefix = self.prefix.trim_end_matches('.');
        if prefix.is_empty() { self.part.name() } else { prefix.to_owned() }
    }

    /// Returns true if the layer's name means the whole picture.
    fn is_whole(&self) -> bool {
        let label = self.label().to_ascii_lowercase();
        WHOLE.contains(&label.rsplit('.').next().unwrap_or_default())
    }
}

/// Chooses the colour channels. With several candidates, channels without a layer come first, then those of the layer
/// whose name is in `WHOLE`. Other layers are listed in a note.
fn choose<'a>(file: &'a File<'_>, notes: &mut Vec<String>) -> Result<Colours<'a>, String> {
    let mut found: Vec<Colours<'a>> = Vec::new();
    let mut names = Vec::new();
    for part in file.parts().filter(|part| !part.is_deep()) {
        let full: Vec<String> = part.channels().filter(|(_, full)| *full).map(|(name, _)| name).collect();
        let all: Vec<String> = part.channels().map(|(name, _)| name).collect();
        names.extend(all.iter().cloned());
        let has = |prefix: &str, name: &str| full.iter().any(|full| *full == format!("{prefix}{name}"));
        let prefixes = full.iter().map(|name| name.rfind('.').map_or("", |point| &name[..=point]));
        let mut seen: Vec<&str> = Vec::new();
        for prefix in prefixes {
            if seen.contains(&prefix) {
                continue;
            }
            seen.push(prefix);
            let colour = ["R", "G", "B"].iter().all(|name| has(prefix, name));
            let chroma = all.iter().any(|name| *name == format!("{prefix}RY") || *name == format!("{prefix}BY"));
            if colour || (has(prefix, "Y") && !chroma) {
                found.push(Colours { part, prefix: prefix.to_owned(), grey: !colour, alpha: has(prefix, "A") });
            }
        }
    }
    let listed = |names: &[String]| {
        let more = names.len().saturating_sub(LISTED);
        let text = names.iter().take(LISTED).cloned().collect::<Vec<_>>().join(", ");
        if more > 0 { format!("{text} and {more} more") } else { text }
    };
    if found.is_empty() {
        let names = if names.is_empty() { "deep samples".to_owned() } else { listed(&names) };
        return Err(format!("expected EXR channels R, G, B or Y, found {names}"));
    }
    // Colours take precedence over luminance, a layer without a name over others.
    let rank = |colours: &Colours<'_>| match (colours.grey, colours.prefix.is_empty(), colours.is_whole()) {
        (false, true, true) => 0,
        (false, true, false) => 1,
        (false, false, true) => 2,
        (false, false, false) => 3,
        (true, ..) => 4,
    };
    let labels: Vec<String> = found.iter().map(Colours::label).collect();
    let best = found.iter().map(rank).min().unwrap_or_default();
    let of_rank = found.iter().filter(|colours| rank(colours) == best).count();
    if of_rank > 1 && best >= 2 {
        return Err(format!(
            "expected one layer of colours, or one called rgba, beauty or Combined, found {}",
            listed(&labels)
        ));
    }
    let chosen = found.iter().position(|colours| rank(colours) == best).unwrap_or_default();
    if labels.len() > 1 {
        let others: Vec<String> =
            labels.iter().enumerate().filter(|(at, _)| *at != chosen).map(|(_, label)| label.clone()).collect();
        notes.push(format!("of the EXR layers {} is taken, {} left out", labels[chosen], listed(&others)));
    }
    Ok(found.swap_remove(chosen))
}

#[cfg(test)]
mod tests;
