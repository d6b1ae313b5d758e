//! The plain version: binary64, no tiles, no vectors, every pixel against every Gaussian that may reach it.

use super::project::rotation;
use super::{Gaussians, Projection, Request};

/// An image in binary64, and how far each pixel was from being decided otherwise.
#[derive(Clone, Debug)]
pub struct ReferenceImage {
    /// `[3, H, W]`
    pub rgb: Vec<f64>,
    /// `[H, W]`, Σ d α T
    pub depth: Vec<f64>,
    /// `[H, W]`, Σ α T
    pub alpha: Vec<f64>,
    /// `[H, W]`, the transmittance that is left
    pub final_t: Vec<f64>,
    /// `[H, W]`, Gaussians drawn
    pub blended: Vec<u32>,
    /// `[H, W]`: the smallest relative distance of an alpha from 1/255, or of a transmittance from 1e-4, that was met.
    /// Where it is below the rounding of binary32, an implementation may decide otherwise.
    pub margin: Vec<f64>,
    /// Gaussians with a field that is not finite.
    pub dropped: u64,
}

/// Draws the scene as the equations say (StreamSplat, ICLR 2026; EWA splatting for the Jacobian).
pub fn render(gaussians: &Gaussians<'_>, projection: &Projection, request: &Request) -> ReferenceImage {
    render_with(gaussians, projection, request, |_, _, _| {})
}

/// Weight `α·T` of a Gaussian on a pixel, where it is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weight {
    /// Index of the Gaussian.
    pub gaussian: usize,
    /// Row-major index of the pixel.
    pub pixel: usize,
    /// α·T
    pub weight: f64,
}

/// The scene as [`render`] draws it, and all weights, Gaussian by Gaussian from front to back.
pub fn weights(gaussians: &Gaussians<'_>, projection: &Projection, request: &Request) -> (ReferenceImage, Vec<Weight>) {
    let mut all = Vec::new();
    let image = render_with(gaussians, projection, request, |gaussian, pixel, weight| {
        all.push(Weight { gaussian, pixel, weight });
    });
    (image, all)
}

/// [`render`], calling `visit(gaussian, pixel, weight)` where a Gaussian is drawn.
fn render_with(
    gaussians: &Gaussians<'_>,
    projection: &Projection,
    request: &Request,
    mut visit: impl FnMut(usize, usize, f64),
) -> ReferenceImage {
    let (width, height) = (request.width, request.height);
    let pixels = width * height;
    let mut image = ReferenceImage {
        rgb: vec![0.0; 3 * pixels],
        depth: vec![0.0; pixels],
        alpha: vec![0.0; pixels],
        final_t: vec![1.0; pixels],
        blended: vec![0; pixels],
        margin: vec![f64::INFINITY; pixels],
        dropped: 0,
    };
    let mut finished = vec![false; pixels];
    let mut order: Vec<usize> = (0..gaussians.mean.len()).collect();
    order.sort_by(|&i, &j| gaussians.mean[i][2].total_cmp(&gaussians.mean[j][2]));
    for i in order {
        let turn = gaussians.rotation.map_or([1.0, 0.0, 0.0, 0.0], |r| r[i]);
        let fields = [&gaussians.mean[i][..], &gaussians.scale[i], &gaussians.rgb[i], &turn, &[gaussians.opacity[i]]];
        if !fields.iter().all(|field| field.iter().all(|v| v.is_finite())) {
            image.dropped += 1;
            continue;
        }
        let [x, y, z] = gaussians.mean[i].map(f64::from);
        let (u, v, jacobian) = match *projection {
            Projection::Orthographic { focal } => {
                let [fx, fy] = focal.map(f64::from);
                if z <= 0.0 {
                    continue;
                }
                let u = fx * x + (width as f64 - 1.0) / 2.0;
                let v = fy * y + (height as f64 - 1.0) / 2.0;
                (u, v, [[fx, 0.0, 0.0], [0.0, fy, 0.0]])
            }
            Projection::Pinhole { focal, centre } => {
                let ([fx, fy], [cx, cy]) = (focal.map(f64::from), centre.map(f64::from));
                if z <= 1e-6 {
                    continue;
                }
                let [tx, ty] = if request.bounded {
                    let [w, h] = [width as f64, height as f64];
                    let held = |t: f64, f: f64, c: f64, size: f64| {
                        t.max((-0.5 - 0.15 * size - c) / f).min((1.15 * size - 0.5 - c) / f)
                    };
                    [held(x / z, fx, cx, w), held(y / z, fy, cy, h)]
                } else {
                    [x / z, y / z]
                };
                let jacobian = [[fx / z, 0.0, -fx / z * tx], [0.0, fy / z, -fy / z * ty]];
                (fx * x / z + cx, fy * y / z + cy, jacobian)
            }
        };
        let r = rotation(turn.map(f64::from));
        let mut m = [[0.0; 3]; 2];
        for (row, j) in m.iter_mut().zip(&jacobian) {
            for k in 0..3 {
                row[k] = (0..3).map(|l| j[l] * r[l][k] * f64::from(gaussians.scale[i][k])).sum();
            }
        }
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let normal = [
            m[0][1] * m[1][2] - m[0][2] * m[1][1],
            m[0][2] * m[1][0] - m[0][0] * m[1][2],
            m[0][0] * m[1][1] - m[0][1] * m[1][0],
        ];
        let (aa, b, cc) = (dot(m[0], m[0]), dot(m[0], m[1]), dot(m[1], m[1]));
        let (a, c) = (aa + 0.3, cc + 0.3);
        let det = dot(normal, normal) + 0.3 * (aa + cc) + 0.09;
        let mut opacity = f64::from(gaussians.opacity[i]);
        if request.antialias {
            opacity *= (dot(normal, normal) / det).sqrt();
        }
        // Near the threshold pixels count in `margin`.
        if ![a, c, det, u, v].iter().all(|v| v.is_finite()) || opacity < (1.0 - 1e-4) / 255.0 {
            continue;
        }
        // A little more than the ellipse on which alpha is 1/255, so that near misses count in `margin`.
        let radius = 2.0 * (opacity * 255.0).ln() + 0.01;
        let span = |centre: f64, variance: f64, size: usize| {
            let reach = (radius * variance).sqrt();
            let first = (centre - reach).floor().clamp(0.0, size as f64) as usize;
            first..((centre + reach).ceil() + 1.0).clamp(0.0, size as f64) as usize
        };
        for py in span(v, c, height) {
            for px in span(u, a, width) {
                let at = py * width + px;
                if finished[at] {
                    continue;
                }
                let (dx, dy) = (px as f64 - u, py as f64 - v);
                let skewed = dx - b / c * dy;
                let power = -0.5 * (c / det * skewed * skewed + dy * dy / c);
                let alpha = (opacity * power.exp()).min(0.99);
                let transmittance = image.final_t[at];
                image.margin[at] = image.margin[at].min((alpha * 255.0 - 1.0).abs());
                if alpha < 1.0 / 255.0 {
                    continue;
                }
                let left = transmittance * (1.0 - alpha);
                image.margin[at] = image.margin[at].min((left * 1e4 - 1.0).abs());
                if left < 1e-4 {
                    finished[at] = true;
                    continue;
                }
                let weight = alpha * transmittance;
                visit(i, at, weight);
                for channel in 0..3 {
                    image.rgb[channel * pixels + at] += weight * f64::from(gaussians.rgb[i][channel]);
                }
                image.depth[at] += weight * z;
                image.alpha[at] += weight;
                image.final_t[at] = left;
                image.blended[at] += 1;
            }
        }
    }
    for channel in 0..3 {
        for at in 0..pixels {
            image.rgb[channel * pixels + at] += image.final_t[at] * f64::from(request.background[channel]);
        }
    }
    image
}
