//! Footprints on the sphere of directions around the eye, for equirectangular images.
//!
//! A footprint lies in the plane that touches the sphere in the direction n of its centre. In that plane a direction d
//! is at `(e·d, s·d) / n·d`, where e points east and s south. The Gaussian is projected onto the plane as by a pinhole
//! that looks along n. So a footprint has its shape on the sphere, at the seam and at the poles as well, and needs no
//! copies.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use super::{BLOCK, Batch, HALF_LOG2_E, LOW_PASS, Lanes, Loaded, ROOT_HALF_LOG2_E, Viewport, rotation};
use crate::raster::Gaussians;
use crate::simd::{LANES, Simd};

/// Gaussians nearer to the eye are not drawn.
const NEAREST: f64 = 1e-6;
/// Least cosine of the latitude by which the low-pass narrows along the latitude. Nearer to the poles pixels are
/// narrower than the low-pass.
pub(in super::super) const POLE: f64 = 0.0625;
/// Added to the tangents that bound a footprint, relative and absolute, and to the pixels that they lead to: more than
/// all rounding.
const SLACK: [f64; 3] = [1e-4, 1e-6, 0.02];

/// East and south at a direction; at a pole as at longitude 0.
#[inline(always)]
pub(in super::super) fn frame([x, y, z]: [f64; 3]) -> [[f64; 3]; 2] {
    let level = (x * x + z * z).sqrt();
    let (sin, cos) = if level > 0.0 { (x / level, z / level) } else { (0.0, 1.0) };
    [[cos, 0.0, -sin], [-y * sin, level, -y * cos]]
}

/// The angle of (x, y) from the x axis, in (−π, π], within 10⁻⁹.
fn angle(y: f64, x: f64) -> f64 {
    let (least, most) = (x.abs().min(y.abs()), x.abs().max(y.abs()));
    if most == 0.0 {
        return 0.0;
    }
    // Halved twice: at most tan(π/16).
    let half = |t: f64| t / (1.0 + (1.0 + t * t).sqrt());
    let t = half(half(least / most));
    let z = t * t;
    let series = [1.0 / 13.0, -1.0 / 11.0, 1.0 / 9.0, -1.0 / 7.0, 0.2, -1.0 / 3.0, 1.0];
    let octant = 4.0 * t * series.iter().fold(0.0, |sum, c| sum * z + c);
    let quadrant = if y.abs() > x.abs() { FRAC_PI_2 - octant } else { octant };
    let upper = if x < 0.0 { PI - quadrant } else { quadrant };
    if y < 0.0 { -upper } else { upper }
}

/// Least and greatest latitude, and half the range of longitudes, of the rectangle that extends `east` and `south` of
/// the direction n. The longitude is `None` where it reaches all around.
fn extent([_, sin, _]: [f64; 3], cos: f64, [east, south]: [f64; 2]) -> ([f64; 2], Option<f64>) {
    // The southern half; the northern is its mirror image.
    let (down, sign) = (sin.abs(), if sin < 0.0 { -1.0 } else { 1.0 });
    let to_pole = cos - south * down;
    let (nearest, farthest) = (cos + south * down, down - south * cos);
    let away = if farthest < 0.0 {
        angle(farthest, nearest)
    } else {
        angle(farthest, (nearest * nearest + east * east).sqrt())
    };
    let (towards, wide) = if to_pole <= 1e-9 {
        (FRAC_PI_2, None)
    } else {
        (angle(down + south * cos, to_pole), Some(angle(east, to_pole)))
    };
    (if sign < 0.0 { [-towards, -away] } else { [away, towards] }, wide)
}

/// First and last whole number in an interval, of those from 0 to `last`.
fn whole(from: f64, to: f64, last: f64) -> Option<[i32; 2]> {
    let (from, to) = (from.max(0.0).ceil(), to.min(last).floor());
    (from <= to).then_some([from as i32, to as i32])
}

/// Blocks of columns around a longitude, first and last; columns beyond the right edge are counted on from there and
/// appear at the left one.
fn columns(longitude: f64, wide: Option<f64>, width: usize) -> Option<[i32; 2]> {
    let (blocks, size) = (width.div_ceil(BLOCK) as i32, width as f64);
    let all = Some([0, blocks - 1]);
    let Some(wide) = wide else { return all };
    let (per_radian, block) = (size / TAU, BLOCK as i32);
    let centre = longitude * per_radian + 0.5 * size - 0.5;
    let reach = wide * per_radian + SLACK[2];
    let (from, to) = ((centre - reach).ceil(), (centre + reach).floor());
    if to - from + 1.0 >= size {
        return all;
    }
    if from > to {
        return None;
    }
    let shift = if from < 0.0 {
        size
    } else if from >= size {
        -size
    } else {
        0.0
    };
    let (from, to) = ((from + shift) as i32, (to + shift) as i32);
    let first = from / block;
    if to < width as i32 {
        return Some([first, to / block]);
    }
    let beyond = (to - width as i32) / block;
    if beyond + 1 >= first { all } else { Some([first, blocks + beyond]) }
}

impl Batch {
    /// Projects Gaussians `first ..` (as many as there are, at most sixteen) onto the sphere.
    ///
    /// Binary64 in the order written here; the direction of the centre is rounded to binary32 first. The determinant is
    /// that of [`Batch::general`], with a low-pass of `0.3·(cos φ·2H/W)²` along the latitude, in pixels of the
    /// meridian.
    #[inline(always)]
    pub(in super::super) fn spherical<S: Simd>(s: S, gaussians: &Gaussians<'_>, first: usize, view: &Viewport) -> Self {
        let Loaded { mean, scale, turn, opacity, finite } = Loaded::of(s, gaussians, first);
        let per_radian = view.height as f64 / PI;
        let narrow = 2.0 * view.height as f64 / view.width as f64;
        let [mut k, mut own, mut widened] = [[0.0_f64; LANES]; 3];
        let [mut wide, mut high] = [[0.0_f64; LANES]; 2];
        let mut towards = [[0.0_f32; LANES]; 3];
        let [mut p, mut q, mut depth, mut sound] = [[0.0_f32; LANES]; 4];
        for l in 0..LANES {
            let [x, y, z] = [f64::from(mean[0][l]), f64::from(mean[1][l]), f64::from(mean[2][l])];
            let distance = (x * x + y * y + z * z).sqrt();
            let inverse = 1.0 / distance;
            let n = [x * inverse, y * inverse, z * inverse].map(|c| c as f32);
            let [east, south] = frame(n.map(f64::from));
            let r = rotation([turn[0][l].into(), turn[1][l].into(), turn[2][l].into(), turn[3][l].into()]);
            let [sx, sy, sz] = [f64::from(scale[0][l]), f64::from(scale[1][l]), f64::from(scale[2][l])];
            let size = per_radian * inverse;
            let along = |axis: [f64; 3], i: usize, s: f64| {
                size * ((axis[0] * r[0][i] + axis[1] * r[1][i] + axis[2] * r[2][i]) * s)
            };
            let m1 = [along(east, 0, sx), along(east, 1, sy), along(east, 2, sz)];
            let m2 = [along(south, 0, sx), along(south, 1, sy), along(south, 2, sz)];
            let n1 = [m1[1] * m2[2] - m1[2] * m2[1], m1[2] * m2[0] - m1[0] * m2[2], m1[0] * m2[1] - m1[1] * m2[0]];
            let aa = m1[0] * m1[0] + m1[1] * m1[1] + m1[2] * m1[2];
            let bb = m1[0] * m2[0] + m1[1] * m2[1] + m1[2] * m2[2];
            let cc = m2[0] * m2[0] + m2[1] * m2[1] + m2[2] * m2[2];
            let nn = n1[0] * n1[0] + n1[1] * n1[1] + n1[2] * n1[2];
            // South's second component is the cosine of the latitude.
            let pixel = south[1].max(POLE) * narrow;
            let low = LOW_PASS * (pixel * pixel);
            let det = (nn + (low * cc + LOW_PASS * aa)) + low * LOW_PASS;
            (own[l], widened[l]) = (nn, det);
            let variance = [aa + low, cc + LOW_PASS];
            let upright = 1.0 / variance[1];
            k[l] = bb * upright;
            let slope = per_radian * (HALF_LOG2_E * (variance[1] / det)).sqrt();
            let height = per_radian * (HALF_LOG2_E * upright).sqrt();
            (p[l], q[l]) = (slope as f32, height as f32);
            (wide[l], high[l]) = (variance[0].sqrt() / per_radian, variance[1].sqrt() / per_radian);
            for axis in 0..3 {
                towards[axis][l] = n[axis];
            }
            depth[l] = if distance > NEAREST { distance as f32 } else { 0.0 };
            sound[l] = ((slope * 0.0 + k[l] * 0.0) + height * 0.0) as f32 + depth[l] * 0.0;
        }
        let opacity = if view.antialias {
            let share: Lanes = std::array::from_fn(|l| (own[l] / widened[l]).sqrt() as f32);
            s.mul(opacity, s.from_array(share))
        } else {
            opacity
        };
        let (opacity, reach, opaque) = view.cut.apply(s, opacity);
        let radius = s.to_array(s.mul(s.sqrt(reach), s.splat(1.0 / ROOT_HALF_LOG2_E)));
        let ahead = s.lt(s.splat(0.0), s.from_array(depth));
        let sound = s.eq(s.from_array(sound), s.splat(0.0));
        let mut visible = s.bits(s.and(s.and(finite, s.and(ahead, opaque)), sound));
        let [mut columns_of, mut rows_of] = [[[1_i32; LANES], [0; LANES]]; 2];
        let candidates = visible;
        for l in (0..LANES).filter(|l| candidates >> l & 1 != 0) {
            let n = [towards[0][l], towards[1][l], towards[2][l]].map(f64::from);
            let reach = [wide[l], high[l]].map(|s| s * f64::from(radius[l]) * (1.0 + SLACK[0]) + SLACK[1]);
            let cos = (n[0] * n[0] + n[2] * n[2]).sqrt();
            let ([top, bottom], beside) = extent(n, cos, reach);
            let row = |latitude: f64| latitude * per_radian + 0.5 * view.height as f64 - 0.5;
            let rows = whole(row(top) - SLACK[2], row(bottom) + SLACK[2], view.height as f64 - 1.0);
            match rows.zip(columns(angle(n[0], n[2]), beside, view.width)) {
                Some((rows, columns)) => {
                    for end in 0..2 {
                        rows_of[end][l] = rows[end] / BLOCK as i32;
                        columns_of[end][l] = columns[end];
                    }
                }
                None => visible &= !(1 << l),
            }
        }
        Self {
            visible,
            dropped: !s.bits(finite) & Self::present(gaussians, first),
            u: [0.0; LANES],
            v: [0.0; LANES],
            k,
            x: [towards[0], towards[1]],
            y: [towards[2], [0.0; LANES]],
            p,
            q,
            opacity: s.to_array(opacity),
            reach: s.to_array(reach),
            depth,
            columns: columns_of,
            rows: rows_of,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_those_of_the_standard_library() {
        for i in 0..4000 {
            let t = f64::from(i) * 0.0016 - 3.2;
            for radius in [1e-30, 1.0, 3e7] {
                let (y, x) = (radius * t.sin(), radius * t.cos());
                assert!((angle(y, x) - y.atan2(x)).abs() < 1e-9, "{t}");
            }
        }
        assert_eq!(angle(0.0, 0.0), 0.0);
    }

    #[test]
    fn a_rectangle_lies_within_its_extent() {
        for i in 0..200 {
            let latitude = FRAC_PI_2 * (f64::from(i) / 100.0 - 1.0);
            for [east, south] in [[0.01, 0.02], [0.5, 0.01], [0.01, 0.5], [3.0, 1.0], [1e-4, 40.0], [40.0, 1e-4]] {
                let n = [0.0, latitude.sin(), latitude.cos()];
                let [e, s] = frame(n);
                let ([top, bottom], wide) = extent(n, latitude.cos(), [east, south]);
                for (a, b) in (-8..=8).flat_map(|a| (-8..=8).map(move |b| (a, b))) {
                    let (x, y) = (east * f64::from(a) / 8.0, south * f64::from(b) / 8.0);
                    let d: [f64; 3] = std::array::from_fn(|i| n[i] + x * e[i] + y * s[i]);
                    let level = (d[0] * d[0] + d[2] * d[2]).sqrt();
                    let found = d[1].atan2(level);
                    assert!(
                        (top - 1e-6..=bottom + 1e-6).contains(&found),
                        "{latitude} {x} {y}: {found} in {top} {bottom}"
                    );
                    let longitude = d[0].atan2(d[2]).abs();
                    assert!(level < 1e-9 || wide.is_none_or(|wide| longitude <= wide + 1e-6), "{latitude} {x} {y}");
                }
            }
        }
    }

    #[test]
    fn columns_go_on_beyond_the_seam() {
        // 64 columns, 16 blocks; the middle of the image is longitude 0.
        assert_eq!(columns(0.0, Some(0.1), 64), Some([7, 8]));
        assert_eq!(columns(3.1, Some(0.3), 64), Some([15, 16]));
        assert_eq!(columns(-3.1, Some(0.3), 64), Some([15, 16]));
        assert_eq!(columns(1.0, None, 64), Some([0, 15]));
        assert_eq!(columns(1.0, Some(3.2), 64), Some([0, 15]));
        assert_eq!(columns(0.0, Some(0.001), 64), None);
    }
}
