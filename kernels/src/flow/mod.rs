//! Dense optical flow by inverse search, and pictures between two frames.
//!
//! # Flow: [`Pyramid`], [`between`], [`both`]
//!
//! Kroeger, Timofte, Dai, Van Gool: Fast Optical Flow using Dense Inverse Search, ECCV 2016 (arXiv:1603.03590). Luma L
//! is from 0 to 255 here. At every scale, from the coarsest to [`Options::finest`]:
//!
//! ```text
//! search    patches P of 8×8 pixels, every `stride` pixels, look for the displacement f of least cost
//!             d(x) = L₂(x + f) − L₁(x)         L₂ bilinear, its border repeated; f kept so short that patch and picture overlap
//!             cost = Σ d² − (Σ d)²/64           over P
//!             f ← f − (Σ ĝĝᵀ + 64·I)⁻¹ Σ ĝ·d    ĝ: Sobel's gradient of L₁ less its mean over P
//!           until the step is under 0.01 pixels, the cost does not fall, or after `iterations` steps; farther than 8 pixels from
//!           where it started, it stays there
//! densify   f(x) = Σ w·f_P / Σ w over the patches that hold x, w = 1 / max(1, |d_P(x)|)
//! refine    `refinement` fixed-point iterations on
//!             ∫ δ·Ψ(brightness) + γ·Ψ(gradient) + α·Ψ(|∇u|² + |∇v|²),  Ψ(s²) = √(s² + 0.001²)
//!           where the data terms are linearised at the flow that came in, with derivatives of the mean of L₁ and the warped L₂, each divided
//!           by the length of its gradient (0.1 is added under the root); 0 where the flow leaves the picture
//! ```
//!
//! A search starts from the cheapest of: the coarser scale's flow at the patch's middle (0 at the coarsest), `start`'s,
//! that of the patch to the left, that of the patch above. A second pass, from the last patch to the first, starts from
//! the patch to the right, the one below or the one above where that is cheaper. The flow of the finest scale is
//! enlarged bilinearly.
//!
//! # Order of operations
//!
//! A patch is four vectors, rows 2i and 2i + 1 in vector i. Sums over a patch: lanes by fused steps in ascending order
//! of the vectors (plain sums pair vectors 0 and 1, 2 and 3), then [`Simd::sum`]. Patches are searched in stripes of
//! six rows of patches, row by row; in the first pass a stripe reads nothing of the others, in the second it reads
//! their results of the first pass. Stripes are fixed, so threads change nothing. Pixels sum over patches in ascending
//! order of rows, then columns. The refinement solves its systems by five steps of red-black over-relaxation (ω = 1.6),
//! red (row + column even) first, where no pixel depends on another of its colour.
//!
//! # Extremes
//!
//! Frames may have any size, smaller than a patch too. Equal or evenly lit frames do not move. The flow is finite and
//! at most as long as the picture on either axis. Luma that is not finite is an error, and so are weights other than
//! from 0 to 10⁶; `start` is ignored where it is not finite.

mod align;
mod blend;
mod densify;
mod field;
mod follow;
mod options;
mod pyramid;
pub mod reference;
mod refine;
mod relax;
mod sample;
mod search;
mod split;

use tracing::debug_span;

pub use align::{Lumas, align};
pub use blend::Blend;
pub use field::{Field, warp};
pub use follow::{Step, follow, trace};
pub use options::{FlowError, Options};
pub use pyramid::Pyramid;

use crate::parallel::for_each_chunk;
use crate::simd::{Operation, Simd, dispatch};
use crate::{Level, resize};

use options::PATCH;
pub use sample::sample_one;
use search::{Grid, Guess};

/// Luma `[h, w]` of `rgb` `[3, h, w]`: 0.299 R + 0.587 G + 0.114 B (BT.601).
///
/// # Panics
/// When the length is not a multiple of 3.
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

/// The flow from `first` to `second`: for every pixel of `first`, the offset of the matching position in `second`.
///
/// # Panics
/// When the pyramids have different sizes or scales, `start` another size, or `options` a weight that [`Pyramid::new`]
/// refuses.
pub fn between(level: Level, first: &Pyramid, second: &Pyramid, start: Option<&Field>, options: &Options) -> Field {
    assert_eq!(first.size, second.size, "frames of different sizes");
    assert!(
        first.finest == second.finest && first.scales.len() == second.scales.len(),
        "pyramids with different options"
    );
    if let Err(error) = options.check() {
        panic!("{error}");
    }
    if let Some(start) = start {
        start.check();
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
