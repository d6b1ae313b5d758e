//! Gaussians behind the edges of near things, for views that look past them.
//!
//! A key frame shows nothing of the surfaces that its foreground hides. A view turned by [`SLOPE`] looks past a
//! [cell](super::beyond) where an edge to something farther is no more than
//!
//! ```text
//! SLOPE·(z_farther − z_own)        in half widths of the picture
//! ```
//!
//! away. Behind each of these cells another Gaussian is added: [`BACK`] behind the farthest surface seen within
//! [`AROUND`] pixels of it, and behind the farther surface. Its colour is the one that earlier frames [saw
//! there](super::covered), otherwise the mean of the first three pixels beyond the edge. It is hidden from the frame's
//! own camera. It moves like the surface beyond the edge.

use streamsplat_model::{StaticGaussian, StaticGaussians};

use super::beyond::{Beyond, middle};
use super::covered::Covered;
use super::edges::Surfaces;
use super::order::SLOPE;
use crate::world::y_at;

/// Opacity of a Gaussian behind.
const OPACITY: f32 = 0.95;
/// Standard deviation in pixels.
const SCALE: f32 = 1.2;
/// Pixels around a Gaussian that a turned view may show next to the one in front of it.
const AROUND: usize = 4;
/// Distance in pixels behind the surfaces seen there: more than the model's Gaussians are [moved](super::order).
const BACK: f32 = 10.0;
/// Pixels that a view looks past an edge in addition to the distance from its middle.
const MARGIN: f32 = 1.5;

/// Adds Gaussians behind the foreground, in the `covered` colours where they are known. Returns for each the place
/// whose motion it takes, and the number of known colours.
pub(super) fn add(
    gaussians: &mut StaticGaussians,
    surfaces: &Surfaces<'_>,
    beyond: &[Option<Beyond>],
    covered: &[Covered],
) -> (Vec<[f32; 3]>, usize) {
    let [height, width] = surfaces.resolution();
    let place = |[x, y]: [f32; 2], depth: f32| {
        [(2.0 * x + 1.0) / width as f32 - 1.0, depth, 1.0 - (2.0 * y + 1.0) / height as f32]
    };
    let (mut moving, mut known) = (Vec::new(), 0);
    let mut covered = covered.iter().peekable();
    for (cell, beyond) in beyond.iter().enumerate() {
        let remembered = covered.next_if(|covered| covered.cell as usize == cell);
        let Some(beyond) = beyond.as_ref().filter(|beyond| beyond.is_looked_past(width)) else { continue };
        known += usize::from(remembered.is_some());
        let rgb = remembered.map_or_else(|| surfaces.extended(beyond), |covered| covered.rgb);
        gaussians.push(StaticGaussian {
            position: place(middle(beyond.own), surfaces.behind(beyond)),
            scale: [SCALE * 2.0 / width as f32, SCALE * 2.0 / height as f32],
            opacity: OPACITY,
            rgb,
            ..StaticGaussian::default()
        });
        let away = [(beyond.away % width) as f32, (beyond.away / width) as f32];
        moving.push(place(away, y_at(beyond.farther)));
    }
    (moving, known)
}

impl Beyond {
    /// Returns true if a turned view of a picture of this width looks past the edge as far as this cell.
    fn is_looked_past(&self, width: usize) -> bool {
        self.distance as f32 <= (0.5 * width as f32 * SLOPE).mul_add(self.farther - self.z, MARGIN)
    }
}

impl Surfaces<'_> {
    /// y of a Gaussian behind all surfaces seen around it.
    fn behind(&self, beyond: &Beyond) -> f32 {
        let [height, width] = self.resolution();
        let [row, column] = beyond.own;
        let mut farthest = beyond.farther;
        for y in row.saturating_sub(AROUND)..(row + AROUND + 1).min(height) {
            let columns = column.saturating_sub(AROUND)..(column + AROUND + 1).min(width);
            farthest = self.z()[y * width..][columns].iter().fold(farthest, |a, b| a.max(*b));
        }
        y_at(farthest + BACK * 2.0 / width as f32)
    }

    /// The mean colour of the first pixels beyond the edge.
    fn extended(&self, beyond: &Beyond) -> [f32; 3] {
        let (mut sum, mut count) = ([0.0f32; 3], 0.0);
        for pixel in beyond.pixels.into_iter().flatten() {
            let rgb = self.colour(pixel);
            sum = std::array::from_fn(|c| sum[c] + rgb[c]);
            count += 1.0;
        }
        sum.map(|sum| sum / count)
    }
}

#[cfg(test)]
mod tests {
    use streamsplat_kernels::Level;

    use super::super::DepthMap;
    use super::super::beyond::grid;
    use super::*;
    use crate::world::{FAR, NEAR, scene_depth};

    const SIZE: [usize; 2] = [4, 128];

    /// Gaussians added behind rows that are all alike, near things red before green: column, y, colour, and x of the
    /// place whose motion they take.
    fn added(inverse: impl Fn(usize) -> f32, covered: &[Covered]) -> Vec<(usize, f32, [f32; 3], f32)> {
        let plane = |of: &dyn Fn(usize) -> f32| -> Vec<f32> { (0..4 * 128).map(|at| of(at % 128)).collect() };
        let map = DepthMap { inverse: plane(&inverse), confidence: None, resolution: SIZE };
        let red = |x: usize| f32::from(u8::from(inverse(x) > 0.5));
        let frame = [plane(&red), plane(&|x| 1.0 - red(x)), plane(&|_| 0.0)].concat();
        let surfaces = Surfaces::new(Level::scalar(), &map, &frame);
        let mut gaussians = StaticGaussians::default();
        let (moving, known) = add(&mut gaussians, &surfaces, &surfaces.beyond(), covered);
        assert_eq!(known, covered.len());
        assert_eq!(moving.len(), gaussians.position.len());
        let column = |x: f32| (x + 1.0) * 0.5 * 128.0;
        let each = gaussians.position.iter().zip(&gaussians.rgb).zip(&moving);
        let first = each.filter(|((position, _), _)| position[2] > 0.0);
        first.map(|(([x, y, _], rgb), moving)| ((column(*x) / 2.0) as usize * 2, *y, *rgb, column(moving[0]))).collect()
    }

    #[test]
    fn near_things_get_what_lies_beyond_their_edge_as_far_as_a_turned_view_looks() {
        let near = |x: usize| (20..80).contains(&x);
        let found = added(|x| f32::from(u8::from(near(x))), &[]);
        let looks = 64.0 * SLOPE * (scene_depth(0.0) - scene_depth(1.0)) + MARGIN;
        let expected = |x: &usize| near(*x) && ((x - 19) as f32 <= looks || (80 - x) as f32 <= looks);
        let columns: Vec<usize> = found.iter().map(|(column, ..)| *column).collect();
        assert_eq!(columns, (0..128).step_by(2).filter(expected).collect::<Vec<_>>());
        assert!(columns.len() > 6 && columns.len() < 30, "not behind all of it: {columns:?}");
        for (column, y, rgb, moving) in found {
            assert_eq!(rgb, [0.0, 1.0, 0.0], "column {column}");
            assert!(y < FAR && y > FAR - 0.1, "column {column}: {y}");
            assert!(
                !near(moving as usize) && (moving - column as f32).abs() < looks + 11.0,
                "column {column}: {moving}"
            );
        }
        assert!(added(|x| if near(x) { 0.2 } else { 0.0 }, &[]).len() < columns.len(), "less far, less of it");
    }

    #[test]
    fn what_stands_behind_stands_behind_all_that_is_seen_beside_it() {
        // Something narrow is between a near thing and the ground.
        let inverse = |x: usize| match x {
            20..40 => 1.0,
            17..20 => 0.15,
            _ => 0.0,
        };
        let found = added(inverse, &[]);
        let first = found.iter().find(|(column, ..)| *column == 20).expect("behind the near thing's edge");
        assert!(first.1 < FAR, "{first:?}");
        assert!(found.iter().all(|(_, y, ..)| *y < (NEAR - FAR).mul_add(0.15, FAR)), "{found:?}");
    }

    #[test]
    fn what_is_remembered_there_gives_its_colour() {
        let columns = grid(SIZE)[1] as u32;
        let rgb = [0.0, 0.0, 1.0];
        let covered = [10, 38].map(|cell| Covered { cell, at: [2.0 * cell as f32, 0.0], rgb });
        let found = added(|x| f32::from(u8::from((20..80).contains(&x))), &covered);
        for (column, _, colour, _) in found {
            let known = [20, 76].contains(&column);
            assert_eq!(colour, if known { rgb } else { [0.0, 1.0, 0.0] }, "column {column} of {columns} cells");
        }
    }
}
