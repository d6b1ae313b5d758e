//! The plain version: binary64, no tiles, no vectors, every pixel against every Gaussian, and covariances as products
//! of matrices.

use super::{WorldProjection, WorldView};

/// Gaussians, colours and a camera's matrix in binary64.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReferenceScene {
    /// Means.
    pub mean: Vec<[f64; 3]>,
    /// Quaternions w, x, y, z of any length.
    pub rotation: Vec<[f64; 4]>,
    /// Scales.
    pub scale: Vec<[f64; 3]>,
    /// Opacities.
    pub opacity: Vec<f64>,
    /// D: channels.
    pub channels: usize,
    /// `[N, D]`
    pub colours: Vec<f64>,
    /// `[D]`
    pub background: Vec<f64>,
    /// [V | t]
    pub world_to_view: [[f64; 4]; 3],
}

/// An image in binary64, and its distance from the nearest threshold.
#[derive(Clone, Debug, Default)]
pub struct ReferenceImage {
    /// `[H, W, D]`
    pub image: Vec<f64>,
    /// `[H, W]`
    pub alpha: Vec<f64>,
    /// `[N]`: depths z.
    pub depth: Vec<f64>,
    /// The smallest relative distance of an α from 1/255 or the largest, of a transmittance from 1e-4, and of a tangent
    /// from its bound.
    pub margin: f64,
}

/// Draws a scene by all fields of `view` except the matrix.
pub fn render(scene: &ReferenceScene, view: &WorldView) -> ReferenceImage {
    let (count, channels, [width, height]) = (scene.mean.len(), scene.channels, [view.width, view.height]);
    let mut out = ReferenceImage {
        image: vec![0.0; width * height * channels],
        alpha: vec![0.0; width * height],
        depth: vec![0.0; count],
        margin: f64::INFINITY,
    };
    let [fx, fy] = view.focal.map(f64::from);
    let (low, most) = (f64::from(view.low_pass), f64::from(view.largest_alpha));
    let m = &scene.world_to_view;
    let mut drawn = Vec::new();
    for i in 0..count {
        let place: [f64; 3] =
            std::array::from_fn(|r| (0..3).map(|k| m[r][k] * scene.mean[i][k]).sum::<f64>() + m[r][3]);
        let [x, y, z] = place;
        out.depth[i] = z;
        if z <= f64::from(view.near) || z >= f64::from(view.far) {
            continue;
        }
        let norm = scene.rotation[i].iter().map(|c| c * c).sum::<f64>().sqrt();
        let [w, a, b, c] = scene.rotation[i].map(|q| q / norm);
        let turn = [
            [w * w + a * a - b * b - c * c, 2.0 * (a * b - w * c), 2.0 * (a * c + w * b)],
            [2.0 * (a * b + w * c), w * w - a * a + b * b - c * c, 2.0 * (b * c - w * a)],
            [2.0 * (a * c - w * b), 2.0 * (b * c + w * a), w * w - a * a - b * b + c * c],
        ];
        let (centre, jacobian) = match view.projection {
            WorldProjection::Orthographic => (
                [fx * x + f64::from(view.centre[0]), fy * y + f64::from(view.centre[1])],
                [[fx, 0.0, 0.0], [0.0, fy, 0.0]],
            ),
            WorldProjection::Pinhole => {
                let mut held = |tangent: f64, focal: f64, centre: f32, size: usize| {
                    let [least, most] = [-0.15, 1.15].map(|share| (share * size as f64 - f64::from(centre)) / focal);
                    out.margin = out.margin.min((tangent - least).abs()).min((tangent - most).abs());
                    tangent.max(least).min(most)
                };
                let hx = held(x / z, fx, view.centre[0], width);
                let hy = held(y / z, fy, view.centre[1], height);
                (
                    [fx * x / z + f64::from(view.centre[0]), fy * y / z + f64::from(view.centre[1])],
                    [[fx / z, 0.0, -fx * hx / z], [0.0, fy / z, -fy * hy / z]],
                )
            }
        };
        // J·V·R·S
        let mut root = [[0.0; 3]; 2];
        for row in 0..2 {
            for column in 0..3 {
                for k in 0..3 {
                    let turned: f64 = (0..3).map(|l| m[k][l] * turn[l][column]).sum();
                    root[row][column] += jacobian[row][k] * turned * scene.scale[i][column];
                }
            }
        }
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let own = [dot(root[0], root[0]), dot(root[0], root[1]), dot(root[1], root[1])];
        let (xx, xy, yy) = (own[0] + low, own[1], own[2] + low);
        let det = xx * yy - xy * xy;
        let mut opacity = scene.opacity[i];
        if view.antialias {
            opacity *= ((own[0] * own[2] - own[1] * own[1]).max(0.0) / det).sqrt();
        }
        if opacity >= 1.0 / 255.0 {
            drawn.push((i, z, centre, [yy / det, -xy / det, xx / det], opacity));
        }
    }
    drawn.sort_by(|a, b| (a.1 as f32).total_cmp(&(b.1 as f32)));
    for at in 0..width * height {
        let (px, py) = ((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
        let mut left = 1.0;
        for &(i, _, [u, v], [a, b, c], opacity) in &drawn {
            let (dx, dy) = (px - u, py - v);
            let alpha = opacity * (-0.5 * (a * dx * dx + 2.0 * b * dx * dy + c * dy * dy)).exp();
            out.margin = out.margin.min((alpha * 255.0 - 1.0).abs()).min((alpha / most - 1.0).abs());
            if alpha < 1.0 / 255.0 {
                continue;
            }
            let alpha = alpha.min(most);
            let next = left * (1.0 - alpha);
            out.margin = out.margin.min((next * 1e4 - 1.0).abs());
            if next <= 1e-4 {
                break;
            }
            for channel in 0..channels {
                out.image[at * channels + channel] += alpha * left * scene.colours[i * channels + channel];
            }
            left = next;
        }
        out.alpha[at] = 1.0 - left;
        for channel in 0..channels {
            out.image[at * channels + channel] += left * scene.background.get(channel).copied().unwrap_or(0.0);
        }
    }
    out
}
