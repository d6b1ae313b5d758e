//! The plain version: binary64, no tiles, no vectors, every pixel against every Gaussian that may reach it.

use super::falloff::BLURRED_ALPHA_MIN;
use super::project::{POLE, rotation};
use super::{Defocus, Gaussians, Projection, Request};

/// An image in binary64, and the distance of each pixel from the nearest threshold.
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
    /// `[H, W]`: the smallest relative distance of an alpha from 1/255, or of a transmittance from 1e-4, on the pixel.
    /// Where it is below the rounding of binary32, an implementation may decide differently.
    pub margin: Vec<f64>,
    /// Gaussians with a field that is not finite.
    pub dropped: u64,
}

/// Draws the scene by the equations (StreamSplat, ICLR 2026; EWA splatting for the Jacobian).
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

/// Rows and columns of an equirectangular image that see a part of the cone around n with this tangent; some more.
fn cone(n: [f64; 3], tangent: f64, [width, height]: [usize; 2]) -> (std::ops::Range<usize>, Vec<usize>) {
    use std::f64::consts::{FRAC_PI_2, PI, TAU};
    let (latitude, reach) = (n[1].atan2(n[0].hypot(n[2])), tangent.atan() + 1e-3);
    let row = |latitude: f64| (latitude / PI + 0.5) * height as f64;
    let rows =
        (row(latitude - reach).floor().max(0.0) as usize)..(row(latitude + reach).ceil().max(0.0) as usize).min(height);
    if latitude.abs() + reach >= FRAC_PI_2 {
        return (rows, (0..width).collect());
    }
    let beside = (reach.sin() / latitude.cos()).min(1.0).asin() * width as f64 / TAU + 1.0;
    let middle = (n[0].atan2(n[2]) / TAU + 0.5) * width as f64;
    if 2.0 * beside + 2.0 >= width as f64 {
        return (rows, (0..width).collect());
    }
    let (first, last) = ((middle - beside).floor() as isize, (middle + beside).ceil() as isize);
    (rows, (first..=last).map(|column| column.rem_euclid(width as isize) as usize).collect())
}

/// The direction of a position, and east and south there.
fn sphere_axes(place: [f64; 3]) -> [[f64; 3]; 3] {
    let length = place.iter().map(|c| c * c).sum::<f64>().sqrt();
    // The direction is rounded to binary32 by definition.
    let n = place.map(|c| f64::from((c / length) as f32));
    let level = n[0].hypot(n[2]);
    let (sin, cos) = if level > 0.0 { (n[0] / level, n[2] / level) } else { (0.0, 1.0) };
    [n, [cos, 0.0, -sin], [-n[1] * sin, level, -n[1] * cos]]
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
    let [gain, floor] = request.falloff.gain_and_floor();
    let blurred = matches!(projection, Projection::Pinhole { .. });
    let lens = request.defocus.filter(|lens| blurred && lens.is_usable() && lens.aperture > 0.0);
    let least = if lens.is_some() { BLURRED_ALPHA_MIN.into() } else { 1.0 / 255.0 };
    let mut order: Vec<usize> = (0..gaussians.mean.len()).collect();
    let around = *projection == Projection::Equirectangular;
    let depth_of = |i: usize| match gaussians.mean[i].map(f64::from) {
        [x, y, z] if around => (x * x + y * y + z * z).sqrt() as f32,
        [_, _, z] => z as f32,
    };
    order.sort_by(|&i, &j| depth_of(i).total_cmp(&depth_of(j)));
    for i in order {
        let turn = gaussians.rotation.map_or([1.0, 0.0, 0.0, 0.0], |r| r[i]);
        let fields = [&gaussians.mean[i][..], &gaussians.scale[i], &gaussians.rgb[i], &turn, &[gaussians.opacity[i]]];
        if !fields.iter().all(|field| field.iter().all(|v| v.is_finite())) {
            image.dropped += 1;
            continue;
        }
        let [x, y, mut z] = gaussians.mean[i].map(f64::from);
        let (mut low_pass, mut sphere) = ([0.3; 2], None);
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
            Projection::Equirectangular => {
                z = (x * x + y * y + z * z).sqrt();
                if z <= 1e-6 || !(z as f32).is_finite() {
                    continue;
                }
                let [n, east, south] = sphere_axes([x, y, gaussians.mean[i][2].into()]);
                let k = height as f64 / std::f64::consts::PI;
                let pixel = south[1].max(POLE) * 2.0 * height as f64 / width as f64;
                low_pass = [0.3 * pixel * pixel, 0.3];
                sphere = Some([n, east, south]);
                (0.0, 0.0, [east.map(|e| e * k / z), south.map(|s| s * k / z)])
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
        let [low_x, low_y] = low_pass;
        let (a, c) = (aa + low_x, cc + low_y);
        let det = dot(normal, normal) + (low_x * cc + low_y * aa) + low_x * low_y;
        let mut opacity = f64::from(gaussians.opacity[i]);
        if request.antialias {
            opacity *= (dot(normal, normal) / det).sqrt();
        }
        let (a, c, det) = match (lens, projection) {
            (Some(Defocus { aperture, focus }), Projection::Pinhole { focal, .. }) => {
                let disc = 0.5 * f64::from(aperture) * (1.0 / z - 1.0 / f64::from(focus));
                let [bx, by] = focal.map(|f| (0.5 * f64::from(f) * disc).powi(2));
                let wider = dot(normal, normal) + (0.3 + bx) * cc + (0.3 + by) * aa + (0.3 + bx) * (0.3 + by);
                opacity *= (det / wider).sqrt();
                (a + bx, c + by, wider)
            }
            _ => (a, c, det),
        };
        let own = if lens.is_some() && gaussians.opacity[i] < 1.0 / 255.0 { 0.0 } else { opacity };
        opacity *= gain;
        // Gaussians near the threshold are kept, to count in `margin`.
        if ![a, c, det, u, v].iter().all(|v| v.is_finite()) || own < (1.0 - 1e-4) * least {
            continue;
        }
        // A little more than the ellipse on which alpha is 1/255, so that near misses count in `margin`.
        let radius = -2.0 * (least / opacity + floor).min(1.0).ln() + 0.01;
        let span = |centre: f64, variance: f64, size: usize| {
            let reach = (radius * variance).sqrt();
            let first = (centre - reach).floor().clamp(0.0, size as f64) as usize;
            first..((centre + reach).ceil() + 1.0).clamp(0.0, size as f64) as usize
        };
        let (rows, columns) = match sphere {
            Some([n, ..]) => {
                // The cone around all of the ellipse.
                let k = height as f64 / std::f64::consts::PI;
                let longest = 0.5 * (a + c) + (0.25 * (a - c) * (a - c) + b * b).sqrt();
                cone(n, (radius * longest).sqrt() / k, [width, height])
            }
            None => (span(v, c, height), span(u, a, width).collect()),
        };
        for py in rows {
            for &px in &columns {
                let at = py * width + px;
                if finished[at] {
                    continue;
                }
                let (dx, dy) = match sphere {
                    None => (px as f64 - u, py as f64 - v),
                    Some([n, east, south]) => {
                        let longitude = ((px as f64 + 0.5) / width as f64 - 0.5) * std::f64::consts::TAU;
                        let latitude = ((py as f64 + 0.5) / height as f64 - 0.5) * std::f64::consts::PI;
                        let level = latitude.cos();
                        let q = [level * longitude.sin(), latitude.sin(), level * longitude.cos()];
                        let ahead = dot(n, q);
                        if ahead <= 0.0 {
                            continue;
                        }
                        let k = height as f64 / std::f64::consts::PI;
                        (k * dot(east, q) / ahead, k * dot(south, q) / ahead)
                    }
                };
                let skewed = dx - b / c * dy;
                let power = -0.5 * (c / det * skewed * skewed + dy * dy / c);
                let alpha = (opacity * (power.exp() - floor)).min(0.99);
                let transmittance = image.final_t[at];
                image.margin[at] = image.margin[at].min((alpha / least - 1.0).abs());
                if alpha < least {
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
