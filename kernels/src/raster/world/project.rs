//! Projection of Gaussians in world space to footprints, in binary64.

use super::super::Gaussians;
use super::super::bin::Grid;
use super::super::falloff::{ALPHA_MIN, Cut};
use super::super::project::{Batch, FARTHEST, HALF_LOG2_E, Lanes, Loaded, ROOT_HALF_LOG2_E, Splat, blocks, rotation};
use super::{WorldProjection, WorldView};
use crate::math::f64::ln;
use crate::simd::{LANES, Operation, Simd};

/// Distance beyond the image's edge at which a pinhole's tangents are clamped, as a share of its width and height.
const BESIDE: f64 = 0.15;
/// Radii of footprints in standard deviations, at most.
const EXTENT: f64 = 3.33;
/// Quaternions are divided by at least this.
const SHORTEST: f64 = 1e-12;

/// [`WorldView`] in binary64, with pixel centres at whole numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Camera {
    pub view: [[f64; 4]; 3],
    pub pinhole: bool,
    pub focal: [f64; 2],
    pub centre: [f64; 2],
    /// Bounds of x/z and y/z in J.
    pub bounds: [[f64; 2]; 2],
    pub low_pass: f64,
    pub antialias: bool,
    near: f32,
    far: f32,
    least_radius: f64,
    pub largest_alpha: f32,
    pub size: [usize; 2],
}

impl Camera {
    pub(super) fn new(view: &WorldView) -> Self {
        let (focal, size) = (view.focal.map(f64::from), [view.width, view.height]);
        let bounds = std::array::from_fn(|axis| {
            let (size, centre) = (size[axis] as f64, f64::from(view.centre[axis]));
            [(-BESIDE * size - centre) / focal[axis], ((1.0 + BESIDE) * size - centre) / focal[axis]]
        });
        Self {
            view: view.world_to_view.map(|row| row.map(f64::from)),
            pinhole: view.projection == WorldProjection::Pinhole,
            focal,
            centre: view.centre.map(|c| f64::from(c) - 0.5),
            bounds,
            low_pass: view.low_pass.into(),
            antialias: view.antialias,
            near: view.near,
            far: view.far,
            least_radius: view.least_radius.into(),
            largest_alpha: view.largest_alpha,
            size,
        }
    }
}

#[inline(always)]
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(super) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// A Gaussian in a camera's view.
#[derive(Clone, Copy)]
pub(super) struct Geometry {
    /// x, y, z in view space.
    pub place: [f64; 3],
    /// q/|q|, and the divisor of q.
    pub unit: [f64; 4],
    pub norm: f64,
    /// R
    pub turn: [[f64; 3]; 3],
    /// V·R·S
    pub axes: [[f64; 3]; 3],
    /// h_x and h_y: the clamped tangents in J.
    pub held: [f64; 2],
    /// m₁ and m₂.
    pub rows: [[f64; 3]; 2],
    /// m₁ × m₂
    pub normal: [f64; 3],
    /// u, v, with pixel centres at whole numbers.
    pub centre: [f64; 2],
    /// |m₁|², m₁·m₂, |m₂|², |m₁ × m₂|².
    pub products: [f64; 4],
    /// det Σ
    pub det: f64,
}

impl Geometry {
    #[inline(always)]
    pub(super) fn new(camera: &Camera, mean: [f64; 3], quaternion: [f64; 4], scale: [f64; 3]) -> Self {
        let [w, i, j, k] = quaternion;
        let norm = (w * w + i * i + j * j + k * k).sqrt().max(SHORTEST);
        let unit = quaternion.map(|c| c / norm);
        let turn = rotation(unit);
        let view = &camera.view;
        let mut place = [0.0; 3];
        let mut axes = [[0.0; 3]; 3];
        for row in 0..3 {
            let v = [view[row][0], view[row][1], view[row][2]];
            place[row] = dot(v, mean) + view[row][3];
            for column in 0..3 {
                axes[row][column] = dot(v, [turn[0][column], turn[1][column], turn[2][column]]) * scale[column];
            }
        }
        let [x, y, z] = place;
        let [fx, fy] = camera.focal;
        let (held, rows, centre);
        if camera.pinhole {
            let inverse = 1.0 / z;
            let (tx, ty, jx, jy) = (x * inverse, y * inverse, fx * inverse, fy * inverse);
            centre = [fx * tx + camera.centre[0], fy * ty + camera.centre[1]];
            let [[x_least, x_most], [y_least, y_most]] = camera.bounds;
            held = [tx.max(x_least).min(x_most), ty.max(y_least).min(y_most)];
            rows = [
                std::array::from_fn(|i| jx * (axes[0][i] - held[0] * axes[2][i])),
                std::array::from_fn(|i| jy * (axes[1][i] - held[1] * axes[2][i])),
            ];
        } else {
            centre = [fx * x + camera.centre[0], fy * y + camera.centre[1]];
            held = [0.0; 2];
            rows = [axes[0].map(|m| fx * m), axes[1].map(|m| fy * m)];
        }
        let [m1, m2]: [[f64; 3]; 2] = rows;
        let normal = cross(m1, m2);
        let (aa, bb, cc, nn) = (dot(m1, m1), dot(m1, m2), dot(m2, m2), dot(normal, normal));
        let low = camera.low_pass;
        let det = nn + low * (aa + cc) + low * low;
        Self { place, unit, norm, turn, axes, held, rows, normal, centre, products: [aa, bb, cc, nn], det }
    }

    /// The share of its opacity that anti-aliasing leaves.
    #[inline(always)]
    pub(super) fn share(&self) -> f64 {
        (self.products[3] / self.det).sqrt()
    }
}

/// Results of projecting a chunk of Gaussians.
pub(super) struct Out<'a> {
    pub splats: &'a mut [Splat],
    pub counts: &'a mut [u32],
    pub centre: &'a mut [[f32; 2]],
    pub depth: &'a mut [f32],
    pub conic: &'a mut [[f32; 3]],
    pub opacity: &'a mut [f32],
    pub radius: &'a mut [[i32; 2]],
}

/// Projects a chunk and counts entries per tile.
pub(super) struct ProjectChunk<'a> {
    pub gaussians: &'a Gaussians<'a>,
    pub camera: &'a Camera,
    pub grid: Grid,
    pub first: usize,
    pub to: Out<'a>,
}

impl Operation for ProjectChunk<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(mut self, s: S) {
        for start in (0..self.to.splats.len()).step_by(LANES) {
            self.sixteen(s, start);
        }
    }
}

impl ProjectChunk<'_> {
    /// Projects up to sixteen Gaussians of the chunk, from `start` on.
    #[inline(always)]
    fn sixteen<S: Simd>(&mut self, s: S, start: usize) {
        let camera = self.camera;
        let first = self.first + start;
        let Loaded { mean, scale, turn, opacity, finite } = Loaded::of(s, self.gaussians, first);
        let [mut u, mut v, mut k, mut share] = [[0.0_f64; LANES]; 4];
        let [mut variances, mut conic] = [[[0.0_f64; 3]; LANES]; 2];
        let [mut a, mut c, mut p, mut q, mut whole, mut middle, mut sound, mut depth] = [[0.0_f32; LANES]; 8];
        let upright = self.gaussians.rotation.is_none();
        for l in 0..LANES {
            let quaternion =
                if upright { [1.0, 0.0, 0.0, 0.0] } else { std::array::from_fn(|i| f64::from(turn[i][l])) };
            let lane = |from: &[Lanes; 3]| [f64::from(from[0][l]), f64::from(from[1][l]), f64::from(from[2][l])];
            let seen = Geometry::new(camera, lane(&mean), quaternion, lane(&scale));
            let [aa, bb, cc, _] = seen.products;
            let (variance, det) = ([aa + camera.low_pass, cc + camera.low_pass], seen.det);
            let inverse = 1.0 / variance[1];
            let over = 1.0 / det;
            k[l] = bb * inverse;
            [u[l], v[l]] = seen.centre;
            share[l] = seen.share();
            variances[l] = [variance[0], bb, variance[1]];
            conic[l] = [variance[1] * over, -bb * over, variance[0] * over];
            depth[l] = seen.place[2] as f32;
            // Far centres are moved in, and their footprints scaled with them.
            let (far_x, far_y) = ((u[l].abs() * (1.0 / FARTHEST)).max(1.0), (v[l].abs() * (1.0 / FARTHEST)).max(1.0));
            let (slope, height) = ((HALF_LOG2_E * (variance[1] * over)).sqrt(), (HALF_LOG2_E * inverse).sqrt());
            p[l] = (slope * far_x) as f32;
            q[l] = (height * far_y) as f32;
            (whole[l], middle[l]) = (u[l] as f32, v[l] as f32);
            (a[l], c[l]) = (variance[0] as f32, variance[1] as f32);
            sound[l] = ((u[l] * 0.0 + v[l] * 0.0) + (slope * 0.0 + k[l] * 0.0) + (height + share[l]) * 0.0) as f32;
            k[l] *= far_y / far_x;
            u[l] /= far_x;
            v[l] /= far_y;
        }
        let opacity = if camera.antialias {
            let share: Lanes = std::array::from_fn(|l| share[l] as f32);
            s.mul(opacity, s.from_array(share))
        } else {
            opacity
        };
        let (opacity, reach, opaque) = Cut::GAUSSIAN.apply(s, opacity);
        let radius = s.mul(s.sqrt(reach), s.splat(1.0 / ROOT_HALF_LOG2_E));
        let [width, height] = camera.size;
        let (columns, seen_x) = blocks(s, s.from_array(whole), s.mul(radius, s.sqrt(s.from_array(a))), width);
        let (rows, seen_y) = blocks(s, s.from_array(middle), s.mul(radius, s.sqrt(s.from_array(c))), height);
        let z = s.from_array(depth);
        let between = s.and(s.lt(s.splat(camera.near), z), s.lt(z, s.splat(camera.far)));
        let sound = s.eq(s.from_array(sound), s.splat(0.0));
        let drawn = s.bits(s.and(s.and(finite, s.and(between, opaque)), sound));
        let touching = s.bits(s.and(seen_x, seen_y));
        let opacity = s.to_array(opacity);
        let lanes = LANES.min(self.to.splats.len() - start);
        let mut visible = 0;
        for l in 0..lanes {
            let at = start + l;
            let mut radii = [0; 2];
            if drawn >> l & 1 != 0 {
                let over = 2.0 * ln(f64::from(opacity[l]) / f64::from(ALPHA_MIN));
                let extent = over.sqrt().min(EXTENT);
                let [var_x, _, var_y] = variances[l];
                let reach = [(extent * var_x.sqrt()).ceil(), (extent * var_y.sqrt()).ceil()];
                let large = reach[0] > camera.least_radius || reach[1] > camera.least_radius;
                let centre = [f64::from(whole[l]) + 0.5, f64::from(middle[l]) + 0.5];
                let inside = |axis: usize| {
                    centre[axis] + reach[axis] > 0.0 && centre[axis] - reach[axis] < camera.size[axis] as f64
                };
                if large && inside(0) && inside(1) {
                    radii = reach.map(|r| r as i32);
                }
            }
            let shown = radii[0] > 0 && radii[1] > 0;
            if !shown {
                radii = [0; 2];
            }
            visible |= u16::from(shown) << l;
            self.to.radius[at] = radii;
            let kept = |value: f32| if shown { value } else { 0.0 };
            // Far centres as they are.
            let far = [u[l], v[l]].map(f64::abs).iter().any(|c| *c >= FARTHEST);
            let exact = if far { [f64::from(whole[l]), f64::from(middle[l])] } else { [u[l], v[l]] };
            self.to.centre[at] = exact.map(|c| kept((c + 0.5) as f32));
            self.to.depth[at] = kept(depth[l]);
            self.to.conic[at] = conic[l].map(|c| kept(c as f32));
            self.to.opacity[at] = kept(opacity[l]);
        }
        let batch = Batch {
            visible: visible & touching,
            dropped: !s.bits(finite) & Batch::present(self.gaussians, first),
            u,
            v,
            k,
            x: [[0.0; LANES]; 2],
            y: [[0.0; LANES]; 2],
            p,
            q,
            opacity,
            reach: s.to_array(reach),
            depth,
            columns,
            rows,
        };
        for l in 0..lanes {
            let splat = batch.record::<false>(l, &[0.0; 3]);
            self.grid.for_each_tile(&splat, |tile| self.to.counts[tile] += 1);
            self.to.splats[start + l] = splat;
        }
    }
}
