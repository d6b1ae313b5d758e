//! The most visible Gaussian along a ray.

use streamsplat_kernels::math::f64::exp;

use super::{Bounds, Tree, reach};
use crate::stream::Snapshot;

/// A ray in scene space (x right, y down, z forward).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Its start.
    pub origin: [f32; 3],
    /// Its direction, of any length.
    pub direction: [f32; 3],
}

/// The Gaussian that a ray sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index in the snapshot.
    pub place: u32,
    /// Its share of the pixel, αT, at most 1.
    pub weight: f64,
}

/// Gaussians at one time, prepared for picking along many rays.
///
/// With m and σ² the centre and the variances of a Gaussian (each widened by `blur`), e = m − origin and d the
/// direction,
///
/// ```text
/// α = min(0.99, opacity·exp(−½·min_t |(e − t·d)/σ|²))     min_t |(e − t·d)/σ|² = |(e × d)·σ|² / |d·σσ|²
/// ```
///
/// with the products by components, `(d·σσ)_i = d_i·σ_j·σ_k`. Gaussians are visited front to back by e·d (ties: lower
/// index first), while T, the product of 1 − α, is at least 1e-4. Gaussians with α under 1/255 and those behind the
/// origin are skipped. The result is the Gaussian with the largest αT, the frontmost among equals. All arithmetic is in
/// binary64, sums from left to right.
///
/// For a ray along z with the blur of the pixel grid, this is the Gaussian that dominates a pixel of the canonical
/// camera (see [`streamsplat_kernels::raster`]).
pub struct Picker {
    snapshot: Snapshot,
    blur: [f64; 3],
    tree: Tree,
}

impl Picker {
    /// Prepares a snapshot's Gaussians, with their variances widened by `blur` along x, y and z.
    pub fn new(snapshot: Snapshot, blur: [f64; 3]) -> Self {
        let boxes = (0..snapshot.mean.len()).filter_map(|i| Some((i as u32, bounds(&snapshot, blur, i)?)));
        let tree = Tree::new(boxes);
        Self { snapshot, blur, tree }
    }

    /// Returns the Gaussians.
    pub fn snapshot(&self) -> &Snapshot {
        &self.snapshot
    }

    /// Returns the most visible Gaussian along the ray; the same as [`most_visible`], without testing every Gaussian.
    pub fn pick(&self, ray: &Ray) -> Option<Hit> {
        blend(&self.snapshot, self.blur, ray, self.tree.along_ray(ray.origin, ray.direction))
    }
}

/// Returns the most visible Gaussian along the ray by testing every Gaussian, which is faster for a single ray.
pub fn most_visible(snapshot: &Snapshot, blur: [f64; 3], ray: &Ray) -> Option<Hit> {
    let met =
        |i: &u32| bounds(snapshot, blur, *i as usize).is_some_and(|bounds| bounds.meets_ray(ray.origin, ray.direction));
    let finite = ray.origin.iter().chain(&ray.direction).all(|v| v.is_finite());
    if !finite || ray.direction == [0.0; 3] {
        return None;
    }
    blend(snapshot, blur, ray, (0..snapshot.mean.len() as u32).filter(met))
}

/// Returns a box around the region where a Gaussian's α can reach 1/255.
fn bounds(snapshot: &Snapshot, blur: [f64; 3], i: usize) -> Option<Bounds> {
    let radius = reach(snapshot.opacity[i])?;
    let (mean, scale) = (snapshot.mean[i].map(f64::from), snapshot.scale[i].map(f64::from));
    // A little more than the ellipsoid, against rounding.
    let half: [f64; 3] =
        std::array::from_fn(|a| radius * (scale[a] * scale[a] + blur[a]).sqrt() * (1.0 + 1e-5) + 1e-6 * mean[a].abs());
    let bounds = Bounds {
        least: std::array::from_fn(|a| (mean[a] - half[a]) as f32),
        greatest: std::array::from_fn(|a| (mean[a] + half[a]) as f32),
    };
    bounds.is_sound().then_some(bounds)
}

/// Returns the candidate with the largest αT.
fn blend(snapshot: &Snapshot, blur: [f64; 3], ray: &Ray, candidates: impl IntoIterator<Item = u32>) -> Option<Hit> {
    let (o, d) = (ray.origin.map(f64::from), ray.direction.map(f64::from));
    let mut hits: Vec<(f64, u32, f64)> = Vec::new();
    for place in candidates {
        let i = place as usize;
        let e: [f64; 3] = std::array::from_fn(|a| f64::from(snapshot.mean[i][a]) - o[a]);
        let sigma: [f64; 3] = std::array::from_fn(|a| {
            let scale = f64::from(snapshot.scale[i][a]);
            (scale * scale + blur[a]).sqrt()
        });
        let [mut across, mut along] = [0.0; 2];
        for a in 0..3 {
            let (b, c) = ((a + 1) % 3, (a + 2) % 3);
            across += ((e[b] * d[c] - e[c] * d[b]) * sigma[a]).powi(2);
            along += (d[a] * sigma[b] * sigma[c]).powi(2);
        }
        let alpha = (f64::from(snapshot.opacity[i]) * exp(-0.5 * (across / along))).min(0.99);
        let depth = e[0] * d[0] + e[1] * d[1] + e[2] * d[2];
        // Written so that NaN is no hit.
        if depth > 0.0 && alpha >= 1.0 / 255.0 {
            hits.push((depth, place, alpha));
        }
    }
    hits.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let (mut transmittance, mut best) = (1.0, None::<Hit>);
    for (_, place, alpha) in hits {
        if transmittance * (1.0 - alpha) < 1e-4 {
            break;
        }
        let weight = alpha * transmittance;
        transmittance -= weight;
        if best.is_none_or(|best| weight > best.weight) {
            best = Some(Hit { place, weight });
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn snapshot(gaussians: &[([f32; 3], [f32; 3], f32)]) -> Snapshot {
        Snapshot {
            index: (0..gaussians.len() as u32).collect(),
            mean: gaussians.iter().map(|g| g.0).collect(),
            scale: gaussians.iter().map(|g| g.1).collect(),
            opacity: gaussians.iter().map(|g| g.2).collect(),
            rgb: vec![[0.0; 3]; gaussians.len()],
            dropped: 0,
        }
    }

    /// Ordinary Gaussians, and sometimes one that is flat, huge, transparent, or invalid.
    fn gaussian() -> impl Strategy<Value = ([f32; 3], [f32; 3], f32)> {
        let mean = [-1.2_f32..1.2, -1.2_f32..1.2, -0.5_f32..5.0];
        let odd = prop_oneof![Just(0.0_f32), Just(f32::NAN), Just(1e3), Just(1e-8), Just(f32::INFINITY)];
        let scale = prop_oneof![9 => (-6.0_f32..-1.0).prop_map(f32::exp), 1 => odd];
        let opacity = prop_oneof![8 => 0.0_f32..1.0, 1 => Just(1.0 / 255.0), 1 => Just(f32::NAN)];
        (mean, [scale.clone(), scale.clone(), scale], opacity)
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn the_tree_picks_what_looking_at_every_gaussian_picks(
            gaussians in prop::collection::vec(gaussian(), 0..300),
            rays in prop::collection::vec(([-1.0_f32..1.0, -1.0_f32..1.0, -1.0_f32..1.0], [-1.0_f32..1.0, -1.0_f32..1.0, -0.2_f32..1.0]), 20),
            blur in [0.0_f64..1e-3, 0.0_f64..1e-3, 0.0_f64..1e-3],
        ) {
            let snapshot = snapshot(&gaussians);
            let picker = Picker::new(snapshot.clone(), blur);
            for (origin, direction) in rays {
                for direction in [direction, [0.0, 0.0, 1.0]] {
                    let ray = Ray { origin, direction };
                    prop_assert_eq!(picker.pick(&ray), most_visible(&snapshot, blur, &ray));
                }
            }
        }
    }

    #[test]
    fn the_front_one_hides_the_one_behind_and_nothing_behind_the_origin_is_seen() {
        let snapshot = snapshot(&[
            ([0.0, 0.0, 2.0], [0.1; 3], 0.9),
            ([0.0, 0.0, 1.0], [0.1; 3], 0.9),
            ([0.0, 0.0, -1.0], [0.5; 3], 1.0),
        ]);
        let picker = Picker::new(snapshot, [0.0; 3]);
        let ray = |origin, direction| picker.pick(&Ray { origin, direction }).map(|hit| hit.place);
        assert_eq!(ray([0.0; 3], [0.0, 0.0, 1.0]), Some(1));
        assert_eq!(ray([0.0, 0.0, 3.0], [0.0, 0.0, -2.0]), Some(0));
        assert_eq!(ray([0.0, 0.0, 3.0], [0.0, 0.0, 2.0]), None);
        assert_eq!(ray([5.0, 0.0, 2.0], [-1.0, 0.0, 0.0]), Some(0));
        assert_eq!(ray([0.0; 3], [0.0; 3]), None);
        assert_eq!(ray([f32::NAN, 0.0, 0.0], [0.0, 0.0, 1.0]), None);
    }
}
