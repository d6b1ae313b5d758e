//! Fitting frames of any size into the model's input, and images back to the frame's own shape.
//!
//! *Letterbox* (default) keeps the shape: the frame is scaled by one factor until it touches two sides of the model's
//! input and is placed in the middle. The border repeats the content's edge. (With a grey border the network would
//! reconstruct an edge there, whose Gaussians extend into the picture.) Images are cropped back to the content.
//! *Stretch* scales both axes to the model's input, without keeping the shape.
//!
//! Resizing is bilinear with half-pixel centres and no antialiasing (model input, StreamSplat (ICLR 2026)).

use std::ops::Range;

use streamsplat_kernels::{Level, resize};

use crate::choice::named;

named! {
    /// How a frame is resized to the model's input.
    Fit: "fit" {
        /// Keeps the frame's shape; repeats the content's edge into the border.
        #[default]
        Letterbox = "letterbox",
        /// Scales both axes independently.
        Stretch = "stretch",
    }
}

/// Placement of a frame inside the model's input. All sizes are `[height, width]`, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
pub struct Placement {
    /// The frame's own size.
    pub source: [usize; 2],
    /// The model's input size.
    pub model: [usize; 2],
    /// First row and column of the content inside the model's input.
    pub offset: [usize; 2],
    /// Size of the content inside the model's input.
    pub content: [usize; 2],
}

impl Placement {
    /// The placement of a frame of size `source` in an input of size `model`.
    ///
    /// Under [`Fit::Letterbox`] the content's shorter side is rounded to the nearest pixel, at least one, and an odd
    /// border has its extra pixel at the end. `None` when a side is zero or larger than 2³¹.
    pub fn new(fit: Fit, source: [usize; 2], model: [usize; 2]) -> Option<Self> {
        if source.iter().chain(&model).any(|&side| side == 0 || side > 1 << 31) {
            return None;
        }
        let [h, w] = source.map(|side| side as u128);
        let [model_h, model_w] = model.map(|side| side as u128);
        let rounded = |numerator: u128, denominator: u128| ((2 * numerator + denominator) / (2 * denominator)).max(1);
        let content = match fit {
            Fit::Stretch => model,
            Fit::Letterbox if w * model_h >= h * model_w => [rounded(h * model_w, w).min(model_h) as usize, model[1]],
            Fit::Letterbox => [model[0], rounded(w * model_h, h).min(model_w) as usize],
        };
        let offset = [(model[0] - content[0]) / 2, (model[1] - content[1]) / 2];
        Some(Self { source, model, offset, content })
    }

    /// Returns true if the content fills the model's input.
    pub fn is_full(&self) -> bool {
        self.content == self.model
    }

    /// Width over height of the model's input as the source shows it, whose pixels are square: `w·H_c·W / (h·W_c·H)`
    /// for the source `h×w`, the content `H_c×W_c` and the input `H×W`, computed in binary64.
    ///
    /// Scene space has x and y in [−1, 1] over the input. In *square units* x and z are multiplied by this and y is
    /// unchanged, so that a unit is half the input's height.
    pub fn aspect(&self) -> f64 {
        let [[h, w], [content_h, content_w], [model_h, model_w]] =
            [self.source, self.content, self.model].map(|size| size.map(|side| side.max(1) as f64));
        (w * content_h * model_w) / (h * content_w * model_h)
    }

    /// Resizes planes of the source's size to the model's: `[channels, h, w]` → `[channels, H, W]`.
    ///
    /// # Panics
    /// When `planes` does not hold a whole number of planes of the source's size.
    pub fn fit_in(&self, level: Level, planes: &[f32]) -> Vec<f32> {
        let area = self.source[0] * self.source[1];
        assert!(planes.len().is_multiple_of(area), "{} values are no whole planes of {:?}", planes.len(), self.source);
        let channels = planes.len() / area;
        let [rows, columns] = self.content;
        let mut content = vec![0.0; channels * rows * columns];
        let [height, width] = self.source;
        resize::bilinear(level, planes, channels, height, width, rows, columns, &mut content);
        if self.is_full() {
            return content;
        }
        let [height, width] = self.model;
        let mut out = Vec::with_capacity(channels * height * width);
        for plane in content.chunks_exact(rows * columns) {
            for y in 0..height {
                let row = y.saturating_sub(self.offset[0]).min(rows - 1);
                let row = &plane[row * columns..(row + 1) * columns];
                for x in 0..width {
                    out.push(row[x.saturating_sub(self.offset[1]).min(columns - 1)]);
                }
            }
        }
        out
    }

    /// Cuts the content out of planes of the model's size: `[channels, H, W]` → `[channels, content]`.
    ///
    /// # Panics
    /// When `planes` does not hold a whole number of planes of the model's size.
    pub fn crop(&self, planes: &[f32]) -> Vec<f32> {
        let [height, width] = self.model;
        assert!(planes.len().is_multiple_of(height * width), "{} values are no whole planes", planes.len());
        cut(planes, self.model, &[0, 1].map(|axis| self.offset[axis]..self.offset[axis] + self.content[axis]))
    }
}

/// The pixels of a rectangle, rows and columns, of planes of this size: `[C, H, W]` to `[C, h, w]`.
pub(crate) fn cut(planes: &[f32], [height, width]: [usize; 2], [rows, columns]: &[Range<usize>; 2]) -> Vec<f32> {
    let area = (height * width).max(1);
    let mut part = Vec::with_capacity(planes.len() / area * rows.len() * columns.len());
    for plane in planes.chunks_exact(area) {
        for row in plane.chunks_exact(width.max(1)).skip(rows.start).take(rows.len()) {
            part.extend_from_slice(&row[columns.clone()]);
        }
    }
    part
}

/// Normalises a map of inverse depth to [0, 1] by its own minimum and maximum, in place; returns the number of values
/// that were not finite and became 0 (farthest). A constant map becomes 0.
///
/// `(d − min) / (max − min)`, evaluated in f64 so that no range overflows, then rounded.
pub fn normalise_depth(depth: &mut [f32]) -> u64 {
    let finite = || depth.iter().copied().filter(|d| d.is_finite()).map(f64::from);
    let low = finite().fold(f64::INFINITY, f64::min);
    let range = finite().fold(f64::NEG_INFINITY, f64::max) - low;
    let mut dropped = 0;
    for d in depth {
        let keep = d.is_finite();
        dropped += u64::from(!keep);
        *d = if keep && range > 0.0 { ((f64::from(*d) - low) / range) as f32 } else { 0.0 };
    }
    dropped
}

#[cfg(test)]
mod tests;
