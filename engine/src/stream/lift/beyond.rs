//! Surfaces beyond the edges of near things.
//!
//! The picture is divided into cells of [`CELL`]×[`CELL`] pixels. From a cell's first pixel the nearest edge to
//! something farther is searched to the left, to the right, up and down, over at most a [`REACH`]-th of a row's length.

use rayon::prelude::*;

use super::edges::Surfaces;
use crate::world::scene_depth;

/// Pixels of a cell's side.
pub(super) const CELL: usize = 2;
/// Largest distance from an edge: a row's length divided by this.
const REACH: usize = 4;
/// Pixels past the edge at which motion is looked up, because flow blurs across edges.
const AWAY: usize = 9;

/// The surface beyond the edge that is nearest to a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Beyond {
    /// Row and column of the cell's first pixel.
    pub(super) own: [usize; 2],
    /// z in the scene on the side of that pixel.
    pub(super) z: f32,
    /// Pixels to the edge.
    pub(super) distance: usize,
    /// z of the farther surface.
    pub(super) farther: f32,
    /// Up to three pixels of the farther surface, from the edge on.
    pub(super) pixels: [Option<usize>; 3],
    /// A pixel of the farther surface a little away from the edge.
    pub(super) away: usize,
}

/// Rows and columns of cells.
pub(super) fn grid(resolution: [usize; 2]) -> [usize; 2] {
    resolution.map(|side| side.div_ceil(CELL))
}

/// The middle of a cell in pixels, the first pixel's middle being 0.
pub(super) fn middle([row, column]: [usize; 2]) -> [f32; 2] {
    let half = (CELL - 1) as f32 * 0.5;
    [column as f32 + half, row as f32 + half]
}

impl Surfaces<'_> {
    /// The surface beyond the edges of each cell, row by row.
    pub(super) fn beyond(&self) -> Vec<Option<Beyond>> {
        let [height, width] = self.resolution();
        let [rows, columns] = grid([height, width]);
        let z = self.z();
        let most = |line: &mut dyn Iterator<Item = f32>| line.fold(f32::NEG_INFINITY, f32::max);
        let of_rows: Vec<f32> = z.chunks(width).map(|row| most(&mut row.iter().copied())).collect();
        let mut of_columns = vec![f32::NEG_INFINITY; width];
        for row in z.chunks(width) {
            of_columns.iter_mut().zip(row).for_each(|(most, z)| *most = most.max(*z));
        }
        let cell = |cell: usize| {
            let (row, column) = (cell / columns * CELL, cell % columns * CELL);
            let farthest = of_rows[row].max(of_columns[column]);
            let own = scene_depth(self.at(row, column).inverse);
            (farthest - own > self.tear()).then(|| self.past_edge(row, column, own)).flatten()
        };
        (0..rows * columns).into_par_iter().with_min_len(256).map(cell).collect()
    }

    /// Returns the surface past the nearest edge to something farther than `own`.
    fn past_edge(&self, row: usize, column: usize, own: f32) -> Option<Beyond> {
        let [height, width] = self.resolution();
        let z = self.z();
        let start = row * width + column;
        // Index steps from pixel to pixel, and numbers of pixels.
        let ways =
            [(-1, column), (1, width - 1 - column), (-(width as isize), row), (width as isize, height - 1 - row)];
        let at = |(step, count): (isize, usize), n: usize| {
            (n <= count).then(|| start.wrapping_add_signed(step * n as isize))
        };
        let farther = |at: usize| z[at] - own > self.tear();
        let (way, distance) = (1..=(width / REACH).max(1)).find_map(|n| {
            let past = |way: &(isize, usize)| at(*way, n).is_some_and(|at| farther(at) && self.edge_around(at));
            ways.into_iter().find(past).map(|way| (way, n))
        })?;
        // One pixel beyond the edge, past its ramp.
        let first = if at(way, distance + 1).is_some() { distance + 1 } else { distance };
        let beyond = at(way, first).filter(|at| farther(*at))?;
        let same = |n: usize| at(way, n).filter(|at| (z[*at] - z[beyond]).abs() <= self.tear());
        Some(Beyond {
            own: [row, column],
            z: own,
            distance,
            farther: z[beyond],
            pixels: [first, first + 1, first + 2].map(same),
            away: same(distance + AWAY).unwrap_or(beyond),
        })
    }
}

#[cfg(test)]
mod tests {
    use streamsplat_kernels::Level;

    use super::super::DepthMap;
    use super::*;
    use crate::world::{FAR, NEAR};

    /// The surfaces of rows that are all alike, 64 pixels wide.
    fn with(inverse: impl Fn(usize) -> f32, see: impl Fn(&Surfaces<'_>)) {
        let map = DepthMap {
            inverse: (0..4 * 64).map(|at| inverse(at % 64)).collect(),
            confidence: None,
            resolution: [4, 64],
        };
        see(&Surfaces::new(Level::scalar(), &map, &vec![0.5; 3 * 4 * 64]));
    }

    #[test]
    fn near_things_have_a_surface_beyond_their_nearest_edge() {
        let near = |x: usize| (20..60).contains(&x);
        with(
            |x| f32::from(u8::from(near(x))),
            |surfaces| {
                let beyond = surfaces.beyond();
                assert_eq!(beyond.len(), 2 * 32);
                for (cell, beyond) in beyond.iter().enumerate() {
                    let x = cell % 32 * 2;
                    // 64 / REACH = 16 pixels.
                    let expected = match x {
                        20..36 => Some((x - 19, 18)),
                        44..60 => Some((60 - x, 61)),
                        _ => None,
                    };
                    let found = beyond.as_ref().map(|beyond| (beyond.distance, beyond.pixels[0].map_or(0, |p| p % 64)));
                    assert_eq!(found, expected, "column {x}");
                    if let Some(Beyond { z, farther, away, .. }) = beyond {
                        assert_eq!([*z, *farther], [scene_depth(1.0), scene_depth(0.0)]);
                        assert!(!near(away % 64), "column {x}");
                    }
                }
            },
        );
        assert!(scene_depth(1.0) < scene_depth(0.0) && NEAR > FAR);
    }

    #[test]
    fn a_slope_has_nothing_beyond_it() {
        // The slope is less than a tear from pixel to pixel, much more than one over the row.
        with(
            |x| 0.05 + 0.002 * x as f32,
            |surfaces| {
                let range = scene_depth(0.05) - scene_depth(0.05 + 0.002 * 63.0);
                assert!(range > surfaces.tear(), "{range}");
                assert!(surfaces.beyond().iter().all(Option::is_none));
            },
        );
    }
}
