//! Gaussians behind the edges of near things, for views that look past them.
//!
//! A key frame shows nothing of what its foreground hides. So behind every Gaussian that lies within [`REACH`] of a
//! row's length of an edge to something farther stands another one: [`BACK`] behind the farthest of what is seen within
//! [`AROUND`] pixels of it and of the farther surface, in the mean colour of the first three pixels beyond the edge, in
//! the direction (left, right, up, down) in which the edge is nearest. From the frame's own camera it is hidden. It moves
//! as what is seen beyond the edge does.

use rayon::prelude::*;
use streamsplat_model::StaticGaussians;

use super::edges::Surfaces;
use super::{pixel, y_at};

/// Largest distance from an edge, as a part of a row: a row has so many of it.
const REACH: usize = 32;
/// Opacity of a Gaussian behind.
const OPACITY: f32 = 0.95;
/// Standard deviation in pixels.
const SCALE: f32 = 1.2;
/// Pixels around a Gaussian that may be seen beside the one before it.
const AROUND: usize = 4;
/// Distance behind what is seen there, in pixels: more than the model's Gaussians are [moved](super::order).
const BACK: f32 = 10.0;

/// Place and colour of a Gaussian behind another.
struct Behind {
    position: [f32; 3],
    rgb: [f32; 3],
    /// Middle of the first pixel beyond the edge, in the world.
    seen: [f32; 3],
}

/// Adds Gaussians behind the first `count` where these stand before something; gives for each the place whose motion is its own.
pub(super) fn add(gaussians: &mut StaticGaussians, count: usize, surfaces: &Surfaces<'_>) -> Vec<[f32; 3]> {
    let [height, width] = surfaces.resolution();
    let found: Vec<Option<Behind>> =
        gaussians.position[..count].par_iter().with_min_len(256).map(|position| surfaces.behind(*position)).collect();
    let mut seen = Vec::new();
    for behind in found.into_iter().flatten() {
        gaussians.position.push(behind.position);
        gaussians.scale.push([SCALE * 2.0 / width as f32, SCALE * 2.0 / height as f32]);
        gaussians.opacity.push(OPACITY);
        gaussians.rgb.push(behind.rgb);
        seen.push(behind.seen);
    }
    seen
}

impl Surfaces<'_> {
    /// Returns the Gaussian to add behind the one at this position, or `None` where no edge is near.
    fn behind(&self, [x, y, z]: [f32; 3]) -> Option<Behind> {
        let [height, width] = self.resolution();
        let (column, row) = (pixel(x, width)?, pixel(-z, height)?);
        let own = 1.0 / 9.8f32.mul_add(y, 0.2);
        let at = |(dx, dy): (i64, i64), n: usize| {
            let (x, y) = (column as i64 + dx * n as i64, row as i64 + dy * n as i64);
            let inside = (0..width as i64).contains(&x) && (0..height as i64).contains(&y);
            inside.then(|| y as usize * width + x as usize)
        };
        let ways = [(-1, 0), (1, 0), (0, -1), (0, 1)];
        let (way, first) = (1..=(width / REACH).max(1)).find_map(|n| {
            // One pixel beyond the edge, past its ramp.
            let far = |way| at(way, n).filter(|at| self.z()[*at] - own > self.tear()).map(|_| way);
            ways.into_iter().find_map(far).map(|way| (way, n + 1))
        })?;
        let beyond = at(way, first).or_else(|| at(way, first - 1))?;
        let depth = self.z()[beyond];
        if depth - own <= self.tear() {
            return None;
        }
        let (mut sum, mut count) = ([0.0f32; 3], 0.0);
        for pixel in (first..first + 3).filter_map(|n| at(way, n)) {
            if (self.z()[pixel] - depth).abs() <= self.tear() {
                let rgb = self.colour(pixel);
                sum = std::array::from_fn(|c| sum[c] + rgb[c]);
                count += 1.0;
            }
        }
        let rgb = if count > 0.0 { sum.map(|s| s / count) } else { self.colour(beyond) };
        let middle = |i: usize, side: usize| (2.0 * i as f32 + 1.0) / side as f32 - 1.0;
        let mut farthest = depth;
        for y in row.saturating_sub(AROUND)..(row + AROUND + 1).min(height) {
            let columns = column.saturating_sub(AROUND)..(column + AROUND + 1).min(width);
            farthest = self.z()[y * width..][columns].iter().fold(farthest, |a, b| a.max(*b));
        }
        let y = y_at(farthest + BACK * 2.0 / width as f32);
        Some(Behind {
            position: [x, y, z],
            rgb,
            seen: [middle(beyond % width, width), y_at(depth), -middle(beyond / width, height)],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DepthMap, FAR, NEAR};
    use super::*;

    #[test]
    fn near_things_get_what_lies_beyond_their_edge_as_far_as_reach_and_no_further() {
        const SIZE: [usize; 2] = [4, 64];
        let near = |x: usize| (20..40).contains(&x) || (42..46).contains(&x);
        let plane = |of: &dyn Fn(usize) -> f32| -> Vec<f32> { (0..4 * 64).map(|at| of(at % 64)).collect() };
        let inverse = plane(&|x| f32::from(u8::from(near(x))));
        let map = DepthMap { inverse: inverse.clone(), confidence: None, resolution: SIZE };
        // Near things are red, the ground is green.
        let frame = [inverse, plane(&|x| f32::from(u8::from(!near(x)))), plane(&|_| 0.0)].concat();
        let surfaces = Surfaces::new(&map, &frame);
        let middle = |x: usize| (2.0 * x as f32 + 1.0) / 64.0 - 1.0;
        let at = |x: usize| surfaces.behind([middle(x), NEAR, 0.1]);
        // 64 / REACH = 2 pixels.
        for x in (22..38).chain((0..64).filter(|x| !near(*x))) {
            let y = if near(x) { NEAR } else { FAR };
            assert!(surfaces.behind([middle(x), y, 0.1]).is_none(), "column {x}");
        }
        for (x, seen) in [(20, 18), (21, 18), (38, 41), (39, 41), (42, 40), (45, 47)] {
            let behind = at(x).unwrap_or_else(|| panic!("column {x}"));
            assert_eq!(behind.rgb, [0.0, 1.0, 0.0], "column {x}");
            let [there, y, z] = behind.position;
            assert_eq!([there, z], [middle(x), 0.1]);
            assert!(y < FAR && y > FAR - 0.1, "column {x}: {y}");
            assert_eq!(behind.seen[0], middle(seen), "column {x}");
        }
    }

    #[test]
    fn what_stands_behind_stands_behind_all_that_is_seen_beside_it() {
        // Something narrow stands between a near thing and the ground.
        const SIZE: [usize; 2] = [4, 64];
        let inverse = |at: usize| match at % 64 {
            20..40 => 1.0,
            17..20 => 0.15,
            _ => 0.0,
        };
        let map = DepthMap { inverse: (0..4 * 64).map(inverse).collect(), confidence: None, resolution: SIZE };
        let frame = vec![0.5; 3 * 4 * 64];
        let surfaces = Surfaces::new(&map, &frame);
        let behind = surfaces.behind([41.0 / 64.0 - 1.0, NEAR, 0.1]).expect("an edge is near");
        assert!(behind.position[1] < FAR, "{}", behind.position[1]);
    }
}
