//! The size at which the model sees a video.

use std::fmt;
use std::str::FromStr;

use super::reconstructor::{Reconstructor, Tiling};
use crate::choice::UnknownChoice;
use crate::fit::{Fit, Placement};

/// Longest side of [`Resolution::Exact`].
const LONGEST: usize = 8192;

/// The size of the frames that the model sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Resolution {
    /// Four times the area that the model was made for, in the source's own shape, at most the source's size: nothing
    /// is computed for a border. Models that take frames of one size only see that size.
    Auto,
    /// The size that the model was made for.
    Native,
    /// This height and width, in whole patches of the model.
    Exact([usize; 2]),
}

impl fmt::Display for Resolution {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Resolution::Auto => f.write_str("auto"),
            Resolution::Native => f.write_str("native"),
            Resolution::Exact([height, width]) => write!(f, "{height}x{width}"),
        }
    }
}

impl FromStr for Resolution {
    type Err = UnknownChoice;

    /// `auto`, `native` or `HEIGHTxWIDTH`.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let side = |text: &str| text.parse().ok().filter(|side| (1..=LONGEST).contains(side));
        let sides = text.split_once('x').and_then(|(height, width)| side(height).zip(side(width)));
        match (text, sides) {
            ("auto", _) => Ok(Resolution::Auto),
            ("native", _) => Ok(Resolution::Native),
            (_, Some((height, width))) => Ok(Resolution::Exact([height, width])),
            _ => Err(UnknownChoice {
                what: "resolution",
                expected: format!("auto, native, HEIGHTxWIDTH up to {LONGEST} a side"),
                found: text.to_owned(),
            }),
        }
    }
}

impl Resolution {
    /// Places frames of `source` pixels in the model's input; `None` when a side of the source is zero or too large to
    /// address.
    pub(super) fn place(self, source: [usize; 2], fit: Fit, model: &dyn Reconstructor) -> Option<Placement> {
        let tiling = model.tiling().filter(|tiling| tiling.partial);
        match (self, tiling) {
            (Resolution::Exact(size), _) => Placement::new(fit, source, size),
            (Resolution::Auto, Some(Tiling { patch, .. })) => {
                let [height, width] = model.resolution().map(|side| side / patch);
                Placement::new(Fit::Stretch, source, grid(source, patch, 4 * height * width).map(|side| side * patch))
            }
            _ => Placement::new(fit, source, model.resolution()),
        }
    }
}

/// Returns rows and columns of about `most` patches in the shape of `source`, and at most as many pixels a side as that
/// has.
///
/// Tries the row counts near √(most·h/w), each with the nearest column count. It takes the one of smallest `e(columns·h
/// / (rows·w)) + e(rows·columns / most) / 10` with `e(x) = max(x, 1/x) − 1`; the lower among equals.
fn grid(source: [usize; 2], patch: usize, most: usize) -> [usize; 2] {
    let longest = source.map(|side| (side / patch).max(1));
    let [h, w] = source.map(|side| side.max(1) as f64);
    let most = most.min(longest[0] * longest[1]) as f64;
    let middle = (most * h / w).sqrt();
    let (low, high) = ((0.85 * middle).floor().max(1.0) as usize, (1.15 * middle).ceil() as usize);
    let mut best = (f64::INFINITY, [1, 1]);
    for rows in low..=high.max(low) {
        let rows = rows.min(longest[0]);
        let columns = ((rows as f64 * w / h).round() as usize).clamp(1, longest[1]);
        let (shape, size) = (columns as f64 * h / (rows as f64 * w), (rows * columns) as f64 / most);
        let cost = ratio(shape) - 1.0 + (ratio(size) - 1.0) / 10.0;
        if size <= 1.05 && cost < best.0 {
            best = (cost, [rows, columns]);
        }
    }
    best.1
}

/// The ratio or its inverse, whichever is above 1.
fn ratio(x: f64) -> f64 {
    x.max(1.0 / x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_has_the_sources_shape_and_never_more_pixels() {
        for (source, expected) in [
            ([288, 512], [36, 64]),
            ([720, 1280], [36, 64]),
            ([2160, 3840], [36, 64]),
            ([1920, 1080], [64, 36]),
            ([480, 640], [42, 56]),
            ([600, 600], [48, 48]),
            ([144, 256], [18, 32]),
            ([1, 512], [1, 64]),
            ([1, 1], [1, 1]),
            ([5, 7], [1, 1]),
        ] {
            assert_eq!(grid(source, 8, 2304), expected, "{source:?}");
        }
        for height in (1..3000).step_by(37) {
            for width in (1..3000).step_by(41) {
                let [rows, columns] = grid([height, width], 8, 2304);
                assert!(rows <= (height / 8).max(1) && columns <= (width / 8).max(1) && rows * columns <= 2420);
            }
        }
    }

    #[test]
    fn resolutions_are_found_by_their_names_and_others_are_refused() {
        for resolution in [Resolution::Auto, Resolution::Native, Resolution::Exact([288, 512])] {
            assert_eq!(resolution.to_string().parse(), Ok(resolution));
        }
        for wrong in ["", "512", "0x8", "8x0", "288x512x3", "-8x8", "99999x8", "Auto"] {
            assert!(wrong.parse::<Resolution>().is_err(), "{wrong}");
        }
    }
}
