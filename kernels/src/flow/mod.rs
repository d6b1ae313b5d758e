//! Dense optical flow by inverse search.

mod blend;
mod densify;
mod field;
mod pyramid;
pub mod reference;
mod refine;
mod relax;
mod sample;
mod search;
mod split;

use std::fmt;

use tracing::debug_span;

pub use blend::blend;
pub use field::{Field, warp};
pub use pyramid::Pyramid;

use crate::parallel::for_each_chunk;
use crate::simd::{Operation, Simd, dispatch};
use crate::{Level, resize};

use sample::sample_one;
use search::{Grid, Guess};

/// Rows and columns of a patch.
pub(crate) const PATCH: usize = 8;

/// Parameters of the flow.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// The finest scale of the search: its pixels are 2ᵏ wide. The flow is enlarged from there.
    pub finest: usize,
    /// Pixels from one patch to the next, 1 to 8.
    pub stride: usize,
    /// Steps of a patch's descent, at most.
    pub iterations: usize,
    /// Fixed-point iterations of the variational refinement at every scale.
    pub refinement: usize,
    /// Weight α of smoothness in the refinement.
    pub smoothness: f32,
    /// Weight δ of constant brightness.
    pub brightness: f32,
    /// Weight γ of constant gradients.
    pub gradient: f32,
}

impl Default for Options {
    fn default() -> Self {
        Self { finest: 1, stride: 3, iterations: 12, refinement: 5, smoothness: 20.0, brightness: 5.0, gradient: 10.0 }
    }
}

impl Options {
    /// The coarsest scale: the longer side has about four patches there, the shorter one at least one.
    fn coarsest(&self, [h, w]: [usize; 2]) -> usize {
        let (long, short) = (h.max(w), h.min(w));
        let mut scale = 0;
        // log₂(long / (4 · 8)) rounded, and log₂(short / 8) cut off.
        while (long as f64) >= 32.0 * std::f64::consts::SQRT_2 * f64::from(1_u32 << scale)
            && short >> (scale + 1) >= PATCH
        {
            scale += 1;
        }
        scale
    }
}

/// A frame that has no flow.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FlowError {
    /// A value of the frame is NaN or infinite; the first of them.
    NotFinite {
        /// Its row.
        row: usize,
        /// Its column.
        column: usize,
    },
    /// There are no pixels, or too many.
    Size {
        /// Rows and columns of the frame.
        size: [usize; 2],
    },
}

impl FlowError {
    /// The longest side of a frame.
    const LONGEST: usize = 1 << 16;
    /// Pixels of the largest frame.
    const MOST: usize = 1 << 28;
}

impl fmt::Display for FlowError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            FlowError::NotFinite { row, column } => {
                write!(f, "the luma at row {row}, column {column} is not finite: optical flow needs finite values")
            }
            FlowError::Size { size: [h, w] } => {
                let (longest, most) = (Self::LONGEST, Self::MOST);
                write!(
                    f,
                    "a frame of {h}×{w} pixels has no optical flow: expected sides from 1 to {longest}, at most {most} pixels"
                )
            }
        }
    }
}

impl std::error::Error for FlowError {}

/// Luma `[h, w]` of `rgb` `[3, h, w]`: 0.299 R + 0.587 G + 0.114 B (BT.601).
///
/// # Panics
/// When the length is no multiple of 3.
pub fn luma(level: Level, rgb: &[f32]) -> Vec<f32> {
    assert!(rgb.len().is_multiple_of(3), "{} values in three planes", rgb.len());
    let area = rgb.len() / 3;
    let mut out = vec![0.0; area];
    const TASK: usize = 1 << 14;
    for_each_chunk(&mut out, TASK, |index, out| {
        dispatch(level, Luma { rgb, first: index * TASK, out });
    });
    out
}

struct Luma<'a> {
    rgb: &'a [f32],
    first: usize,
    out: &'a mut [f32],
}

impl Operation for Luma<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let area = self.rgb.len() / 3;
        let n = self.out.len();
        let [r, g, b] = [0, 1, 2].map(|k| &self.rgb[k * area + self.first..][..n]);
        for i in 0..n {
            self.out[i] = (0.299 * r[i] + 0.587 * g[i]) + 0.114 * b[i];
        }
    }
}

/// The flow from `first` to `second`: for every pixel of `first`, how far away `second` shows what it shows.
///
/// # Panics
/// When the pyramids have different sizes or scales, or `start` another size.
pub fn between(level: Level, first: &Pyramid, second: &Pyramid, start: Option<&Field>, options: &Options) -> Field {
    assert_eq!(first.size, second.size, "frames of different sizes");
    assert!(
        first.finest == second.finest && first.scales.len() == second.scales.len(),
        "pyramids with different options"
    );
    if let Some(start) = start {
        assert_eq!(start.size, first.size, "a start of another size");
    }
    let [h, w] = first.size;
    let _span = debug_span!("flow", step = "between", h, w).entered();
    let stride = options.stride.clamp(1, PATCH);
    let mut flow: Option<([usize; 2], [Vec<f32>; 2])> = None;
    for (index, (from, to)) in first.scales.iter().zip(&second.scales).enumerate().rev() {
        let size = [from.luma.h, from.luma.w];
        let width = (1_u32 << (first.finest + index)) as f32;
        let grid = Grid::new(size, stride);
        let coarse = |x: f32, y: f32| -> Option<[f32; 2]> {
            let Some((size, [u, v])) = &flow else { return Some([0.0; 2]) };
            let (x, y) = ((x - 0.5) * 0.5, (y - 0.5) * 0.5);
            Some([2.0 * sample_one(u, *size, x, y), 2.0 * sample_one(v, *size, x, y)])
        };
        let given = |x: f32, y: f32| -> Option<[f32; 2]> {
            let [u, v] = start?.at((x + 0.5) * width - 0.5, (y + 0.5) * width - 0.5);
            (u.is_finite() && v.is_finite()).then_some([u / width, v / width])
        };
        let guesses: &[&dyn Guess] = if start.is_some() { &[&coarse, &given] } else { &[&coarse] };
        let found = search::search(level, from, &to.luma, &grid, guesses, options);
        let mut next = densify::densify(level, &from.luma, &to.luma, &grid, &found);
        if options.refinement > 0 {
            refine::refine(level, &from.luma, &to.luma, &mut next, options);
        }
        flow = Some((size, next));
    }
    let Some((size, [u, v])) = flow else { unreachable!("a pyramid has a scale") };
    enlarge(level, first.size, size, first.finest, [u, v])
}

/// The flow from `first` to `second` and back; see [`between`].
pub fn both(
    level: Level,
    first: &Pyramid,
    second: &Pyramid,
    start: [Option<&Field>; 2],
    options: &Options,
) -> [Field; 2] {
    let (forward, backward) = rayon::join(
        || between(level, first, second, start[0], options),
        || between(level, second, first, start[1], options),
    );
    [forward, backward]
}

/// The flow at full size, no longer than the picture.
fn enlarge(level: Level, size: [usize; 2], from: [usize; 2], scale: usize, flow: [Vec<f32>; 2]) -> Field {
    let [h, w] = size;
    let width = (1_u32 << scale) as f32;
    let [fh, fw] = from;
    let large = [fh << scale, fw << scale];
    let [u, v] = [(flow[0].as_slice(), w), (flow[1].as_slice(), h)].map(|(plane, limit)| {
        let mut out = vec![0.0; large[0] * large[1]];
        resize::bilinear(level, plane, 1, fh, fw, large[0], large[1], &mut out);
        let limit = limit as f32;
        let mut kept = Vec::with_capacity(h * w);
        for row in out.chunks(large[1]).take(h) {
            kept.extend(row[..w].iter().map(|x| (x * width).clamp(-limit, limit)));
        }
        kept
    });
    Field { size, u, v }
}

#[cfg(test)]
mod tests;
