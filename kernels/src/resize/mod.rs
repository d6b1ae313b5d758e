//! Images and grids in other sizes.
//!
//! # Bilinear: [`bilinear`]
//!
//! ```text
//! per axis, output i of m, input n:  x = max(0, (n/m)·(i + ½) − ½)     in binary32: quotient, product, difference
//!                                    j = ⌊x⌋, j' = min(j + 1, n − 1), λ = x − j
//! row   = a[j] + λ·(a[j'] − a[j])                along the width, one fused step
//! value = row[k] + κ·(row[k'] − row[k])          along the height, the same
//! ```
//!
//! Half-pixel centres, edges clamped, two taps per axis also when the image shrinks: PyTorch's
//! `interpolate(mode="bilinear", align_corners=False)`, including its coordinates in binary32. A coordinate of 500 is
//! off by up to 3e-5 pixels; exact ones would not reproduce the inputs that models were trained on. Constant images
//! stay constant to the bit, and an axis that keeps its length is copied.
//!
//! # Antialiased: [`antialiased`], [`bilinear_antialiased`], [`bicubic_antialiased`]
//!
//! ```text
//! per axis, output i of m, input n:  s = max(n/m, 1), c = (n/m)·(i + ½)
//!                                    taps j from ⌊c − r·s + ½⌋ to ⌊c + r·s + ½⌋, inside 0 … n, the end excluded
//!                                    w[j] = f((j + ½ − c)/s), divided by their sum
//! value = Σ w[j]·a[j]                j ascending: a product, then fused steps
//! ```
//!
//! f is the triangle 1 − |x| (r = 1) or Keys's cubic with coefficient −½ (r = 2). Weights are formed in binary64 and
//! rounded once. The width goes first, then the height. PyTorch's `interpolate(antialias=True)` and Pillow's `resize`
//! do the same; DINOv2 resizes its grid of position codes this way.
//!
//! Bits are equal on every level and for any number of threads. Infinite and NaN values affect only the outputs that
//! have them among their taps.

mod antialiased;
mod bilinear;
pub mod reference;

pub use antialiased::{Filter, Grid, antialiased, bicubic_antialiased, bilinear_antialiased};
pub use bilinear::bilinear;

#[cfg(test)]
mod tests;
