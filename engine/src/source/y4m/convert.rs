//! Y'CbCr planes to RGB planes, in plain f32 arithmetic.
//!
//! With `s = 2^(bits−8)` and `m = 2^bits − 1`:
//!
//! - limited range: `y = (Y − 16 s) / (219 s)`, `b = (Cb − 128 s) / (224 s)`, `r` likewise; full range: `y = Y / m`, `b
//!   = (Cb − 128 s) / m`.
//! - `R = y + 2(1−Kr) r`, `B = y + 2(1−Kb) b`, `G = (y − cg_b b) − cg_r r` with `cg_b = 2(1−Kb) Kb / Kg`,
//!   `cg_r = 2(1−Kr) Kr / Kg`, `Kg = 1 − Kr − Kb`; each clamped to `[0, 1]`.
//! - y4m has no tag for the matrix: [`Header::matrix`] is chosen by the picture's size ([`Matrix::of_size`]) unless the
//!   caller sets another. Without one, the planes are green, blue and red.
//! - Chroma is interpolated linearly between its sample positions (first along x, then along y), held at the borders.
//!
//! Every step is one IEEE operation in the order written, so the bits are the same on every machine.

use super::header::{Chroma, Header, Siting};
use crate::picture::Picture;
pub use crate::source::colour::Matrix;

/// Returns the position of each luma sample between chroma samples: first sample, second sample, weight of the second.
fn positions(count: usize, samples: usize, step: f32, offset: f32) -> Vec<(usize, usize, f32)> {
    let last = samples - 1;
    (0..count)
        .map(|i| {
            let at = ((i as f32 - offset) / step).clamp(0.0, last as f32);
            let first = at as usize;
            (first, (first + 1).min(last), at - first as f32)
        })
        .collect()
}

fn mix(a: f32, b: f32, weight: f32) -> f32 {
    a + (b - a) * weight
}

/// Interpolates a chroma plane to luma size.
fn upsample(plane: &[f32], (cw, ch): (usize, usize), header: &Header) -> Vec<f32> {
    let (width, height) = (header.width, header.height);
    // The distance between chroma samples, and the luma position of the first one.
    let ((step_x, first_x), (step_y, first_y)) = match header.chroma {
        Chroma::C420(Siting::Centre) => ((2.0, 0.5), (2.0, 0.5)),
        Chroma::C420(Siting::Left) => ((2.0, 0.0), (2.0, 0.5)),
        Chroma::C420(Siting::TopLeft) => ((2.0, 0.0), (2.0, 0.0)),
        Chroma::C422 => ((2.0, 0.0), (1.0, 0.0)),
        Chroma::C411 => ((4.0, 0.0), (1.0, 0.0)),
        Chroma::Mono | Chroma::C444 | Chroma::C444Alpha => return plane.to_vec(),
    };
    let columns = positions(width, cw, step_x, first_x);
    let wide: Vec<f32> = plane
        .chunks_exact(cw)
        .flat_map(|row| columns.iter().map(|&(i, j, weight)| mix(row[i], row[j], weight)))
        .collect();
    let rows = positions(height, ch, step_y, first_y);
    let mut full = Vec::with_capacity(width * height);
    for (i, j, weight) in rows {
        let (above, below) = (&wide[i * width..(i + 1) * width], &wide[j * width..(j + 1) * width]);
        full.extend(above.iter().zip(below).map(|(&a, &b)| mix(a, b, weight)));
    }
    full
}

fn samples(bytes: &[u8], header: &Header, zero: f32, span: f32) -> Vec<f32> {
    if header.sample_bytes() == 1 {
        bytes.iter().map(|&v| (f32::from(v) - zero) / span).collect()
    } else {
        bytes.chunks_exact(2).map(|v| (f32::from(u16::from_le_bytes([v[0], v[1]])) - zero) / span).collect()
    }
}

/// Converts one frame's bytes (`header.frame_bytes()` of them) to a picture.
pub fn to_picture(bytes: &[u8], header: &Header) -> Picture {
    let (width, height) = (header.width, header.height);
    let plane = width * height;
    let (cw, ch) = header.chroma_size();
    let scale = (1u32 << (header.bits - 8)) as f32;
    let full = ((1u32 << header.bits) - 1) as f32;
    let (black, luma_span, chroma_span) =
        if header.full_range { (0.0, full, full) } else { (16.0 * scale, 219.0 * scale, 224.0 * scale) };
    let (luma, rest) = bytes.split_at(plane * header.sample_bytes());
    let mut y = samples(luma, header, black, luma_span);
    if header.chroma == Chroma::Mono {
        y.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
        let mut rgb = Vec::with_capacity(3 * plane);
        (0..3).for_each(|_| rgb.extend_from_slice(&y));
        return Picture { width, height, rgb };
    }
    let Some(matrix) = header.matrix else {
        let (blue, red) = rest.split_at(plane * header.sample_bytes());
        let mut rgb = samples(&red[..plane * header.sample_bytes()], header, black, luma_span);
        rgb.append(&mut y);
        rgb.extend(samples(blue, header, black, luma_span));
        rgb.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
        return Picture { width, height, rgb };
    };
    let (cb, rest) = rest.split_at(cw * ch * header.sample_bytes());
    let (cr, alpha) = rest.split_at(cw * ch * header.sample_bytes());
    let chroma = |bytes| upsample(&samples(bytes, header, 128.0 * scale, chroma_span), (cw, ch), header);
    let (b, r) = (chroma(cb), chroma(cr));
    let mut rgb = vec![0.0; 3 * plane];
    for i in 0..plane {
        let pixel = matrix.rgb(y[i], b[i], r[i]);
        for channel in 0..3 {
            rgb[channel * plane + i] = pixel[channel].clamp(0.0, 1.0);
        }
    }
    if header.chroma == Chroma::C444Alpha {
        for (i, &a) in alpha.iter().enumerate().filter(|&(_, &a)| a != 255) {
            let a = f32::from(a) / 255.0;
            for channel in 0..3 {
                let value = &mut rgb[channel * plane + i];
                *value = *value * a + 0.5 * (1.0 - a);
            }
        }
    }
    Picture { width, height, rgb }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(text: &str) -> Header {
        Header::parse(text.as_bytes()).expect("valid header")
    }

    #[test]
    fn reference_colours_of_both_matrices_and_ranges() {
        // 100 % red of BT.601 limited: Y 81.5, Cb 90.2, Cr 240 (rounded: 81, 90, 240).
        let red = to_picture(&[81, 90, 240], &header("YUV4MPEG2 W1 H1 C444"));
        for (found, expected) in red.rgb.iter().zip([1.0, 0.0, 0.0]) {
            assert!((found - expected).abs() < 0.01, "{:?}", red.rgb);
        }
        let white = to_picture(&[255, 128, 128], &header("YUV4MPEG2 W1 H1 C444 XCOLORRANGE=FULL"));
        assert_eq!(white.rgb, [1.0, 1.0, 1.0]);
        let black = to_picture(&[16, 128, 128], &header("YUV4MPEG2 W1 H1 C444"));
        assert_eq!(black.rgb, [0.0, 0.0, 0.0]);
        // The same colour in ten bits.
        let ten: Vec<u8> = [81u16 * 4, 90 * 4, 240 * 4].iter().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(to_picture(&ten, &header("YUV4MPEG2 W1 H1 C444p10")).rgb, red.rgb);
    }

    #[test]
    fn planes_without_a_matrix_are_green_blue_and_red() {
        let mut header = header("YUV4MPEG2 W2 H1 C444");
        (header.matrix, header.full_range) = (None, true);
        let picture = to_picture(&[40, 0, 30, 1, 200, 255], &header);
        let expected: Vec<f32> = [200u8, 255, 40, 0, 30, 1].iter().map(|&v| f32::from(v) / 255.0).collect();
        assert_eq!(picture.rgb, expected);
    }

    #[test]
    fn chroma_samples_lie_where_the_siting_says() {
        // One row of two chroma samples at 0 and 1 over four luma columns.
        let at = |c: &str| {
            let header = header(&format!("YUV4MPEG2 W4 H2 C{c}"));
            upsample(&[0.0, 1.0], (2, 1), &header)[..4].to_vec()
        };
        assert_eq!(at("420jpeg"), [0.0, 0.25, 0.75, 1.0]);
        assert_eq!(at("420mpeg2"), [0.0, 0.5, 1.0, 1.0]);
        assert_eq!(at("420paldv"), [0.0, 0.5, 1.0, 1.0]);
    }

    #[test]
    fn odd_sizes_and_every_colour_space_convert() {
        for c in
            ["420jpeg", "420mpeg2", "420paldv", "422", "411", "444", "444alpha", "mono", "420p12", "mono16", "444p16"]
        {
            for (w, h) in [(1, 1), (5, 3), (2, 7)] {
                let header = header(&format!("YUV4MPEG2 W{w} H{h} C{c}"));
                let bytes: Vec<u8> = (0..header.frame_bytes()).map(|i| (i * 37 % 256) as u8).collect();
                let picture = to_picture(&bytes, &header);
                assert_eq!(picture.rgb.len(), 3 * w * h, "{c}");
                assert!(picture.rgb.iter().all(|v| (0.0..=1.0).contains(v)), "{c}");
            }
        }
    }
}
