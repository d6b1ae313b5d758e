//! Pixel shuffle by 2: channels of a token become the 2×2 tokens below it.
//!
//! `out[2y+i, 2x+j, c] = in[y, x, 4c + 2i + j]` for `in [h, w, 4c]`, `out [2h, 2w, c]`, row-major token grids.
//!
//! A copy: no arithmetic. Source: "StreamSplat (ICLR 2026)", Gaussian upsampler; the channel order is PyTorch's `PixelShuffle`.

use tracing::debug_span;

use crate::parallel::for_each_chunk;

/// The shuffle of a grid of `height × width` tokens with `4 · channels` channels.
///
/// # Panics
/// When a slice does not hold `height · width · 4 · channels` values.
pub fn pixel_shuffle(x: &[f32], height: usize, width: usize, channels: usize, out: &mut [f32]) {
    let len = height * width * 4 * channels;
    assert_eq!(x.len(), len, "input holds {} values, expected {height}·{width}·4·{channels}", x.len());
    assert_eq!(out.len(), len, "output holds {} values, expected {height}·{width}·4·{channels}", out.len());
    if len == 0 {
        return;
    }
    let _span = debug_span!("pixel_shuffle", height, width, channels).entered();
    for_each_chunk(out, 2 * width * channels, |row, out| {
        let (y, i) = (row / 2, row % 2);
        let tokens = x[y * width * 4 * channels..][..width * 4 * channels].chunks_exact(4 * channels);
        for (token, out) in tokens.zip(out.chunks_exact_mut(2 * channels)) {
            let (left, right) = out.split_at_mut(channels);
            for (four, (left, right)) in token.chunks_exact(4).zip(left.iter_mut().zip(right)) {
                (*left, *right) = (four[2 * i], four[2 * i + 1]);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_channel_lands_where_the_formula_says() {
        let (h, w, c) = (3, 5, 7);
        let x: Vec<f32> = (0..h * w * 4 * c).map(|i| i as f32).collect();
        let mut out = vec![-1.0; x.len()];
        pixel_shuffle(&x, h, w, c, &mut out);
        for y in 0..2 * h {
            for u in 0..2 * w {
                for k in 0..c {
                    let from = ((y / 2) * w + u / 2) * 4 * c + 4 * k + 2 * (y % 2) + u % 2;
                    assert_eq!(out[(y * 2 * w + u) * c + k], x[from]);
                }
            }
        }
    }

    #[test]
    fn an_empty_grid_gives_nothing() {
        pixel_shuffle(&[], 0, 4, 3, &mut []);
    }
}
