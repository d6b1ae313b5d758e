//! Details: Gaussians of a pixel's size where the fit of colours leaves error.
//!
//! The model has one Gaussian for every 2×2 pixels, whatever they show. After the first steps of the
//! [fit](super::colours), the error of a pixel is the sum over its channels of `(frame − picture)²`, with the picture
//! clamped to [0, 1]. The pixels of largest error get a Gaussian of their own: at most so many of each 1000 pixels, and
//! none whose error is at most 3·[`LEAST`]². Ties go to the earlier pixel, row by row. Each starts with the frame's
//! colour, and all colours are fitted together afterwards.
//!
//! A detail is in front of the model's Gaussians around it: of those whose centres are within [`REACH`] pixels along
//! rows and columns, and that belong to the surface of the one whose centre is closest, it takes the nearest depth and
//! [`IN_FRONT`]. No two details that overlap have the same depth: the drawing order of equals depends on what is kept.
//!
//! Details move as the model's Gaussians do, along the flow, and do not survive their interval.

use rayon::prelude::*;
use streamsplat_model::{StaticGaussian, StaticGaussians};

use super::lift::{pixel, tear};
use crate::world::to_scene;

/// Error of a channel, as a root of the mean square over channels, that needs no detail.
const LEAST: f32 = 1.5 / 255.0;
/// Standard deviation in pixels.
const SCALE: f32 = 0.3;
/// A low opacity takes little from the Gaussians behind it; the fitted colour makes up for it.
const OPACITY: f32 = 0.3;
/// Standard deviation along the axis of view over that across it.
const THICKNESS: f32 = 0.5;
/// Pixels around a detail whose Gaussians it is in front of.
const REACH: usize = 2;
/// Normalised inverse depth by which it is nearer.
const IN_FRONT: f32 = 1e-4;

/// A key frame and the picture that its Gaussians make, both `[3, H, W]`.
#[derive(Clone, Copy)]
pub(super) struct Shown<'a> {
    pub(super) frame: &'a [f32],
    pub(super) picture: &'a [f32],
    pub(super) resolution: [usize; 2],
}

/// Adds details at these pixels of a frame `[3, H, W]` to its Gaussians, the first `cells` of which are the model's
/// own; returns how many.
pub(super) fn add(
    gaussians: &mut StaticGaussians,
    cells: usize,
    pixels: &[usize],
    frame: &[f32],
    resolution: [usize; 2],
) -> usize {
    let [height, width] = resolution;
    let nearest = nearest(&gaussians.position[..cells], resolution);
    let middle = |i: usize, side: usize| (2.0 * i as f32 + 1.0) / side as f32 - 1.0;
    let before = gaussians.len();
    for &at in pixels {
        let place = [at / width, at % width];
        let Some(y) = in_front(&nearest, place, resolution) else { continue };
        gaussians.push(StaticGaussian {
            position: [middle(place[1], width), y, -middle(place[0], height)],
            scale: [SCALE * 2.0 / width as f32, SCALE * 2.0 / height as f32],
            thickness: THICKNESS,
            opacity: OPACITY,
            rgb: std::array::from_fn(|channel| frame[channel * height * width + at]),
        });
    }
    gaussians.len() - before
}

/// The pixels of details at these positions.
pub(super) fn pixels(positions: &[[f32; 3]], [height, width]: [usize; 2]) -> Vec<usize> {
    let of = |&[x, _, z]: &[f32; 3]| Some(pixel(-z, height)? * width + pixel(x, width)?);
    positions.iter().filter_map(of).collect()
}

impl Shown<'_> {
    /// The pixels of largest error, ascending: at most `share` of each 1000 pixels (row and column) that have `room`.
    pub(super) fn largest_errors(&self, share: u32, room: &(dyn Fn([usize; 2]) -> bool + Sync)) -> Vec<usize> {
        let [height, width] = self.resolution;
        let plane = height * width;
        let error = |at: usize| {
            (0..3).fold(0.0f32, |sum, channel| {
                let i = channel * plane + at;
                let d = self.frame[i] - self.picture[i].clamp(0.0, 1.0);
                sum + d * d
            })
        };
        let rows: Vec<(usize, Vec<(f32, usize)>)> = (0..height)
            .into_par_iter()
            .map(|row| {
                let pixels = (0..width).filter(|column| room([row, *column])).map(|column| row * width + column);
                let (mut count, mut found) = (0, Vec::new());
                for at in pixels {
                    count += 1;
                    let error = error(at);
                    if error > 3.0 * LEAST * LEAST {
                        found.push((error, at));
                    }
                }
                (count, found)
            })
            .collect();
        let pixels: usize = rows.iter().map(|(count, _)| count).sum();
        let most = (pixels as u64 * u64::from(share) / 1000) as usize;
        let mut found: Vec<(f32, usize)> = rows.into_iter().flat_map(|(_, found)| found).collect();
        if most < found.len() {
            found.select_nth_unstable_by(most, |a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            found.truncate(most);
        }
        let mut pixels: Vec<usize> = found.into_iter().map(|(_, at)| at).collect();
        pixels.sort_unstable();
        pixels
    }
}

/// For each pixel the y of the nearest Gaussian whose centre is in it; −∞ where there is none.
fn nearest(positions: &[[f32; 3]], [height, width]: [usize; 2]) -> Vec<f32> {
    let mut nearest = vec![f32::NEG_INFINITY; height * width];
    for &[x, y, z] in positions {
        if let Some((row, column)) = pixel(-z, height).zip(pixel(x, width)) {
            let place = &mut nearest[row * width + column];
            *place = place.max(y);
        }
    }
    nearest
}

/// y in front of the Gaussians of a pixel's surface around it; `None` where there is none, and where nothing can be
/// nearer.
fn in_front(nearest: &[f32], [row, column]: [usize; 2], [height, width]: [usize; 2]) -> Option<f32> {
    // Those on the square at this distance.
    let around = |distance: usize| {
        let rows = row.saturating_sub(distance)..(row + distance + 1).min(height);
        let columns = column.saturating_sub(distance)..(column + distance + 1).min(width);
        rows.flat_map(move |y| columns.clone().map(move |x| [y, x]))
            .filter(move |[y, x]| y.abs_diff(row).max(x.abs_diff(column)) == distance)
            .map(|[y, x]| nearest[y * width + x])
    };
    let depth = |y: f32| to_scene([0.0, y, 0.0]).map(|[_, _, z]| z);
    let own = (0..=REACH).map(|distance| around(distance).fold(f32::NEG_INFINITY, f32::max)).find_map(depth)?;
    let near = (0..=REACH).flat_map(around).filter(|y| depth(*y).is_some_and(|z| (z - own).abs() <= tear(width)));
    let y = near.fold(f32::NEG_INFINITY, f32::max) + IN_FRONT;
    // Details of the same place in squares of 4×4 pixels do not overlap.
    let place = (row % 4 * 4 + column % 4) as u32;
    let y = f32::from_bits(y.to_bits() & !0x3F | place << 2);
    depth(y).map(|_| y)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [16, 20];

    /// One of the model's own in the middle of the first of every 2×2 pixels, at this y.
    fn lattice(y: impl Fn(usize, usize) -> f32) -> StaticGaussians {
        let [height, width] = SIZE;
        let at = |i: usize, side: usize| (4.0 * i as f32 + 1.0) / side as f32 - 1.0;
        let own = |i: usize| {
            let (row, column) = (i / (width / 2), i % (width / 2));
            StaticGaussian { position: [at(column, width), y(row, column), -at(row, height)], ..Default::default() }
        };
        (0..height * width / 4).map(own).collect()
    }

    /// The details of a grey frame whose picture is this.
    fn added(gaussians: &StaticGaussians, picture: &[f32], share: u32) -> Vec<StaticGaussian> {
        let mut all = gaussians.clone();
        let frame = vec![0.5; 3 * SIZE[0] * SIZE[1]];
        let found = Shown { frame: &frame, picture, resolution: SIZE }.largest_errors(share, &|[row, _]| row > 0);
        let count = add(&mut all, gaussians.len(), &found, &frame, SIZE);
        assert!(count < found.len() || pixels(&all.position[gaussians.len()..], SIZE) == found);
        (gaussians.len()..gaussians.len() + count).map(|i| all.get(i)).collect()
    }

    /// Rows and columns.
    fn places(found: &[StaticGaussian]) -> Vec<[usize; 2]> {
        let positions: Vec<[f32; 3]> = found.iter().map(|detail| detail.position).collect();
        pixels(&positions, SIZE).into_iter().map(|at| [at / SIZE[1], at % SIZE[1]]).collect()
    }

    #[test]
    fn the_pixels_of_largest_error_get_one_each_in_front_of_what_is_around() {
        let [height, width] = SIZE;
        let mut picture = vec![0.5; 3 * height * width];
        // Green is wrong in row 0, which has no room, and in five places; one of them hardly, one beyond white.
        for (row, column, value) in [(0, 3, 0.0), (3, 3, 0.4), (5, 8, 0.3), (9, 19, 9.0), (12, 0, 0.65), (13, 5, 0.504)]
        {
            picture[(height + row) * width + column] = value;
        }
        let own = lattice(|row, column| 0.5 + 0.001 * ((row + column) % 3) as f32);
        let found = added(&own, &picture, 1000);
        assert_eq!(places(&found), [[3, 3], [5, 8], [9, 19], [12, 0]]);
        for detail in &found {
            assert_eq!((detail.rgb, detail.opacity), ([0.5; 3], OPACITY));
            let [x, y, z] = detail.position;
            let around = own.position.iter().filter(|p| {
                (p[0] - x).abs() * 0.5 * (width as f32) < 2.0 && (p[2] - z).abs() * 0.5 * (height as f32) < 2.0
            });
            assert!(around.clone().count() >= 2 && around.into_iter().all(|p| p[1] < y), "{detail:?}");
            assert!(y < 0.503, "no further than needed");
        }
        // 300 pixels have room: 7 of each 1000 are two.
        assert_eq!(places(&added(&own, &picture, 7)), [[5, 8], [9, 19]]);
        assert_eq!(places(&added(&own, &picture, 10)), [[5, 8], [9, 19], [12, 0]]);
        assert!(added(&own, &picture, 3).is_empty());
        // Errors of equal size go to the earlier pixel.
        picture[(height + 7) * width + 7] = 0.3;
        assert_eq!(places(&added(&own, &picture, 7)), [[5, 8], [9, 19]]);
        picture[(height + 4) * width + 7] = 0.3;
        assert_eq!(places(&added(&own, &picture, 7)), [[4, 7], [9, 19]]);
    }

    #[test]
    fn a_detail_belongs_to_the_surface_of_the_closest_centre_and_none_overlaps_another_at_the_same_depth() {
        let [height, width] = SIZE;
        let picture = vec![0.0; 3 * height * width];
        let edge = lattice(|_, column| if column < 5 { 0.02 } else { 0.8 });
        let found = added(&edge, &picture, 1000);
        assert_eq!(found.len(), (height - 1) * width);
        for (detail, [row, column]) in found.iter().zip(places(&found)) {
            let own = if column < 10 { 0.02 } else { 0.8 };
            // Between two centres the nearer one counts.
            assert!(column == 9 || (detail.position[1] - own).abs() < 2e-4, "{row} {column}: {:?}", detail.position);
        }
        for (a, [row, column]) in found.iter().zip(places(&found)) {
            let close = |p: &[usize; 2]| p[0].abs_diff(row) < 4 && p[1].abs_diff(column) < 4 && *p != [row, column];
            let z = |d: &StaticGaussian| to_scene(d.position).expect("inside")[2];
            let others = found.iter().zip(places(&found)).filter(|(_, p)| close(p));
            assert!(others.clone().count() > 5 && others.into_iter().all(|(b, _)| z(a) != z(b)), "{row} {column}");
        }
    }

    #[test]
    fn where_nothing_can_be_in_front_there_is_no_detail() {
        let picture = vec![0.0; 3 * SIZE[0] * SIZE[1]];
        assert!(added(&StaticGaussians::default(), &picture, 1000).is_empty());
        for y in [1.0, -0.5, f32::NAN, f32::INFINITY] {
            assert!(added(&lattice(|_, _| y), &picture, 1000).is_empty(), "{y}");
        }
    }

    #[test]
    fn no_number_of_a_picture_leads_astray() {
        let [height, width] = SIZE;
        let own = lattice(|_, _| 0.5);
        let mut picture = vec![0.5; 3 * height * width];
        for (i, bad) in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY].into_iter().enumerate() {
            picture[(5 + i) * width + 4] = bad;
        }
        // An error that is not a number exceeds nothing.
        assert_eq!(places(&added(&own, &picture, 1000)), [[6, 4], [7, 4]]);
    }
}
