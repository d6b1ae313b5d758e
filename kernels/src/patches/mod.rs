//! Patches of an image as rows, which turn a `p × p` convolution of stride `p` into a matrix product.
//!
//! `out[(y·w + x), (c·p + i)·p + j] = plane_c[y·p + i, x·p + j]` for planes `[h·p, w·p]`: the column order of a
//! convolution weight `[n, channels, p, p]` read as `[n, channels·p·p]`.

use tracing::debug_span;

use crate::parallel::for_each_chunk;
use crate::size::product;

/// The patches of `planes`, each `[height, width]` row-major, as `out [height/p · width/p, planes·p·p]`, row-major over
/// the grid.
///
/// # Panics
/// When `p` does not divide `height` and `width`, or a slice has another size.
pub fn patches(planes: &[&[f32]], height: usize, width: usize, p: usize, out: &mut [f32]) {
    assert!(
        p > 0 && height.is_multiple_of(p) && width.is_multiple_of(p),
        "{height}x{width} is no whole number of {p}x{p} patches"
    );
    let pixels = product([height, width]);
    for plane in planes {
        assert_eq!(plane.len(), pixels, "a plane holds {} values, expected {height}·{width}", plane.len());
    }
    assert_eq!(out.len(), product([planes.len(), pixels]), "output holds {} values", out.len());
    if out.is_empty() {
        return;
    }
    let (len, across) = (planes.len() * p * p, width / p);
    let _span = debug_span!("patches", height, width, p).entered();
    for_each_chunk(out, across * len, |y, out| {
        for (x, out) in out.chunks_exact_mut(len).enumerate() {
            let rows = planes.iter().flat_map(|plane| (0..p).map(move |i| &plane[(y * p + i) * width + x * p..][..p]));
            for (to, from) in out.chunks_exact_mut(p).zip(rows) {
                to.copy_from_slice(from);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pixel_lands_where_the_formula_says() {
        let (h, w, p) = (6, 9, 3);
        let a: Vec<f32> = (0..h * w).map(|i| i as f32).collect();
        let b: Vec<f32> = (0..h * w).map(|i| 1000.0 + i as f32).collect();
        let mut out = vec![-1.0; 2 * h * w];
        patches(&[&a, &b], h, w, p, &mut out);
        for (c, plane) in [&a, &b].into_iter().enumerate() {
            for y in 0..h {
                for x in 0..w {
                    let token = (y / p) * (w / p) + x / p;
                    let column = (c * p + y % p) * p + x % p;
                    assert_eq!(out[token * 2 * p * p + column], plane[y * w + x]);
                }
            }
        }
    }

    #[test]
    #[should_panic(expected = "no whole number")]
    fn a_cut_patch_is_refused() {
        patches(&[&[0.0; 20]], 4, 5, 2, &mut [0.0; 20]);
    }
}
