//! Matches between the two pictures, and the certainty of each.

use glam::DVec3;

use super::window::Track;
use super::{CELL, Sight};

/// Pixels between matches.
const STEP: usize = 8;
/// Minimum fraction of the grid that must have a match.
pub(super) const LEAST: f64 = 0.25;
/// Eigenvalue of the structure tensor, in (grey levels per pixel)², at which the weight of the texture is ½.
const HALF: f32 = 2.0;
/// Pixels on each side over which the structure tensor is averaged.
const RADIUS: usize = 4;

/// Directions in one picture (`one`) and in the other, with a third component of 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct Match {
    pub(super) one: DVec3,
    pub(super) other: DVec3,
    pub(super) weight: f64,
}

/// Returns the matches of every [`STEP`]-th pixel where backward and forward flow agree; `None` if there are too few.
pub(super) fn of(sight: &Sight<'_>, track: &Track) -> Option<Vec<Match>> {
    let [rows, columns] = sight.grid;
    let step = STEP / CELL;
    let (mut matches, mut all) = (Vec::new(), 0_usize);
    for row in (step / 2..rows).step_by(step) {
        for column in (step / 2..columns).step_by(step) {
            all += 1;
            let cell = row * columns + column;
            let (u, v) = (track.u[cell], track.v[cell]);
            let limit = 0.05f32.mul_add((u * u + v * v).sqrt(), sight.unit as f32);
            if track.astray[cell] < limit {
                let [x, y] = sight.middle(cell);
                let at = sight.pixel(cell);
                matches.push(Match {
                    one: sight.direction([x, y], sight.focal),
                    other: sight.direction([x + u, y + v], sight.focal),
                    weight: f64::from(sight.texture[at]) + 1e-3,
                });
            }
        }
    }
    (matches.len() >= 32 && matches.len() as f64 >= LEAST * all as f64).then_some(matches)
}

/// Returns the median length of the flow, in units of the focal length.
pub(super) fn median_length(matches: &[Match]) -> f64 {
    let mut lengths: Vec<f64> = matches.iter().map(|m| (m.other - m.one).length()).collect();
    lengths.sort_by(f64::total_cmp);
    lengths[lengths.len() / 2]
}

/// Returns `λ / (λ + 2)` of each pixel, where λ is the smaller eigenvalue of the structure tensor around it.
pub(super) fn texture(rgb: &[f32], [height, width]: [usize; 2]) -> Vec<f32> {
    let area = height * width;
    let (red, rest) = rgb.split_at(area);
    let (green, blue) = rest.split_at(area);
    let luma: Vec<f32> =
        (0..area).map(|i| 255.0 * 0.299f32.mul_add(red[i], 0.587f32.mul_add(green[i], 0.114 * blue[i]))).collect();
    let mut products = [vec![0.0; area], vec![0.0; area], vec![0.0; area]];
    for row in 0..height {
        let (above, below) = (row.saturating_sub(1), (row + 1).min(height - 1));
        for column in 0..width {
            let (left, right) = (column.saturating_sub(1), (column + 1).min(width - 1));
            let x = 0.5 * (luma[row * width + right] - luma[row * width + left]);
            let y = 0.5 * (luma[below * width + column] - luma[above * width + column]);
            let at = row * width + column;
            (products[0][at], products[1][at], products[2][at]) = (x * x, y * y, x * y);
        }
    }
    let [xx, yy, xy] = products.map(|plane| mean(&plane, [height, width]));
    let of = |i: usize| {
        let (half, difference) = (0.5 * (xx[i] + yy[i]), 0.5 * (xx[i] - yy[i]));
        let lesser = (half - (difference * difference + xy[i] * xy[i]).sqrt()).max(0.0);
        let trust = lesser / (lesser + HALF);
        if trust.is_finite() { trust } else { 0.0 }
    };
    (0..area).map(of).collect()
}

/// Returns means over squares; the border is left out.
fn mean(plane: &[f32], [height, width]: [usize; 2]) -> Vec<f32> {
    let span = |i: usize, side: usize| i.saturating_sub(RADIUS)..(i + RADIUS + 1).min(side);
    let mut across = vec![0.0; plane.len()];
    for (out, row) in across.chunks_mut(width).zip(plane.chunks(width)) {
        for (column, out) in out.iter_mut().enumerate() {
            let span = span(column, width);
            *out = row[span.clone()].iter().sum::<f32>() / span.len() as f32;
        }
    }
    let mut out = vec![0.0; plane.len()];
    for (row, line) in out.chunks_mut(width).enumerate() {
        let span = span(row, height);
        let share = 1.0 / span.len() as f32;
        for from in span {
            line.iter_mut().zip(&across[from * width..]).for_each(|(out, x)| *out += x * share);
        }
    }
    out
}
