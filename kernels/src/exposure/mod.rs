//! The mean of several images in linear light, as a shutter that is open for a while sees them.
//!
//! Images hold display values, sRGB's. Of N images, pixel by pixel and channel by channel,
//!
//! ```text
//! c̄ = encode((decode(c₁) + … + decode(c_N)) / N)
//! decode(c) = c/12.92 where c ≤ 0.04045, ((c + 0.055)/1.055)^2.4 above          encode is its inverse
//! ```
//!
//! and, for images that were drawn over nothing, whose colours are multiplied by their alpha a, `c̄ = ā·encode(Σ
//! aᵢ·decode(cᵢ/aᵢ) / (N·ā))`, where ā is the mean of the alphas. Depth, alpha and transmittance are plain means.
//! Colours under 0 count as 0; above 1 the same formulas apply.
//!
//! # Order of operations
//! Binary32: images are added in the order of their arrival, from +0; the sum is divided by N once. Powers are
//! `exp(2.4·log(x))` and `exp(log(x)·(1/2.4))` of [`crate::math`]. One image alone goes through the formulas as well.

pub mod reference;
#[cfg(test)]
mod tests;

use tracing::debug_span;

use crate::Level;
use crate::math::{exp, log};
use crate::parallel::for_each_chunk;
use crate::raster::Image;
use crate::simd::{LANES, Operation, Simd, dispatch};
use crate::size::product;

/// Values of a task.
const TASK: usize = 1 << 14;
/// Alpha at which a colour is still divided by it.
const LEAST_ALPHA: f32 = 1e-8;

/// A sum of images.
#[derive(Clone, Debug)]
pub struct Exposure {
    level: Level,
    transparent: bool,
    count: u32,
    image: Image,
}

impl Exposure {
    /// An empty sum. With `transparent`, colours are multiplied by alpha.
    pub fn new(level: Level, transparent: bool) -> Self {
        Self { level, transparent, count: 0, image: Image::default() }
    }

    /// Adds an image.
    ///
    /// # Panics
    /// When it has another size or other planes than those before, or no alpha though colours are multiplied by it.
    pub fn add(&mut self, image: &Image) {
        let _span = debug_span!("exposure", width = image.width, height = image.height).entered();
        let pixels = product([image.width, image.height]);
        assert_eq!(image.rgb.len(), product([3, pixels]), "an image of {}×{}", image.width, image.height);
        if self.count == 0 {
            let zeros = |plane: &Option<Vec<f32>>| plane.as_ref().map(|plane| vec![0.0; plane.len()]);
            self.image = Image {
                width: image.width,
                height: image.height,
                rgb: vec![0.0; image.rgb.len()],
                depth: zeros(&image.depth),
                alpha: zeros(&image.alpha),
                final_t: zeros(&image.final_t),
                blended: None,
                dropped: image.dropped,
            };
        }
        let sum = &mut self.image;
        assert_eq!((sum.width, sum.height), (image.width, image.height), "images of one size");
        let alpha = self.transparent.then(|| image.alpha.as_deref().expect("alpha, by which colours are multiplied"));
        if let Some(alpha) = alpha {
            assert_eq!(alpha.len(), pixels, "an image of {}×{}", image.width, image.height);
        }
        let level = self.level;
        for (sum, rgb) in sum.rgb.chunks_mut(pixels.max(1)).zip(image.rgb.chunks(pixels.max(1))) {
            for_each_chunk(sum, TASK, |index, sum| {
                let part = index * TASK..index * TASK + sum.len();
                let alpha = alpha.map(|alpha| &alpha[part.clone()]);
                dispatch(level, Add { sum, rgb: &rgb[part], alpha });
            });
        }
        let planes =
            [(&mut sum.depth, &image.depth), (&mut sum.alpha, &image.alpha), (&mut sum.final_t, &image.final_t)];
        for (sum, plane) in planes {
            assert_eq!(sum.as_ref().map(Vec::len), plane.as_ref().map(Vec::len), "images with the same planes");
            for (sum, value) in sum.iter_mut().flatten().zip(plane.iter().flatten()) {
                *sum += value;
            }
        }
        self.count += 1;
    }

    /// Returns the mean of the added images; an image without pixels if there are none. The next added image begins a
    /// new mean.
    pub fn mean(&mut self) -> Image {
        let mut image = std::mem::take(&mut self.image);
        let count = std::mem::take(&mut self.count).max(1) as f32;
        for plane in [&mut image.depth, &mut image.alpha, &mut image.final_t] {
            plane.iter_mut().flatten().for_each(|value| *value /= count);
        }
        let pixels = product([image.width, image.height]).max(1);
        let (level, alpha) = (self.level, image.alpha.as_deref().filter(|_| self.transparent));
        for rgb in image.rgb.chunks_mut(pixels) {
            for_each_chunk(rgb, TASK, |index, rgb| {
                let alpha = alpha.map(|alpha| &alpha[index * TASK..][..rgb.len()]);
                dispatch(level, Mean { rgb, alpha, count });
            });
        }
        image
    }
}

/// Display value → linear light.
#[inline(always)]
fn decode<S: Simd>(s: S, c: S::F32) -> S::F32 {
    let c = s.max(c, s.splat(0.0));
    let power = exp(s, s.mul(s.splat(2.4), log(s, s.div(s.add(c, s.splat(0.055)), s.splat(1.055)))));
    s.select(s.le(c, s.splat(0.04045)), s.div(c, s.splat(12.92)), power)
}

/// Linear light → display value.
#[inline(always)]
fn encode<S: Simd>(s: S, c: S::F32) -> S::F32 {
    let power = exp(s, s.mul(log(s, c), s.splat(1.0 / 2.4)));
    let curve = s.sub(s.mul(s.splat(1.055), power), s.splat(0.055));
    s.select(s.le(c, s.splat(0.003_130_8)), s.mul(c, s.splat(12.92)), curve)
}

struct Add<'a> {
    sum: &'a mut [f32],
    rgb: &'a [f32],
    alpha: Option<&'a [f32]>,
}

impl Operation for Add<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        for (index, (sum, rgb)) in self.sum.chunks_mut(LANES).zip(self.rgb.chunks(LANES)).enumerate() {
            let rgb = s.load_partial(rgb, 0.0);
            let light = match self.alpha {
                None => decode(s, rgb),
                Some(alpha) => {
                    let alpha = s.load_partial(&alpha[index * LANES..], 0.0);
                    let straight = s.div(rgb, s.max(alpha, s.splat(LEAST_ALPHA)));
                    s.mul(decode(s, straight), alpha)
                }
            };
            let total = s.add(s.load_partial(sum, 0.0), light);
            s.store_partial(total, sum);
        }
    }
}

struct Mean<'a> {
    rgb: &'a mut [f32],
    alpha: Option<&'a [f32]>,
    count: f32,
}

impl Operation for Mean<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        for (index, rgb) in self.rgb.chunks_mut(LANES).enumerate() {
            let mean = s.div(s.load_partial(rgb, 0.0), s.splat(self.count));
            let shown = match self.alpha {
                None => encode(s, mean),
                Some(alpha) => {
                    let alpha = s.load_partial(&alpha[index * LANES..], 0.0);
                    let straight = s.div(mean, s.max(alpha, s.splat(LEAST_ALPHA)));
                    s.mul(encode(s, straight), alpha)
                }
            };
            s.store_partial(shown, rgb);
        }
    }
}
