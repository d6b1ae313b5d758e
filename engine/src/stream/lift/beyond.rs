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
        let edges: Vec<bool> = (0..z.len()).into_par_iter().with_min_len(4096).map(|at| self.edge_around(at)).collect();
        let steps = steps(&edges, width);
        let cell = |cell: usize| {
            let (row, column) = (cell / columns * CELL, cell % columns * CELL);
            let farthest = of_rows[row].max(of_columns[column]);
            let own = scene_depth(self.at(row, column).inverse);
            (farthest - own > self.tear()).then(|| self.past_edge(row, column, own, &steps)).flatten()
        };
        (0..rows * columns).into_par_iter().with_min_len(256).map(cell).collect()
    }

    /// Returns the surface past the nearest edge to something farther than `own`; `steps` are those of [`steps`].
    fn past_edge(&self, row: usize, column: usize, own: f32, steps: &[Vec<u32>; 4]) -> Option<Beyond> {
        let [height, width] = self.resolution();
        let z = self.z();
        let start = row * width + column;
        // Numbers of pixels each way.
        let ends = [column, width - 1 - column, row, height - 1 - row];
        let at =
            |way: usize, n: usize| (n <= ends[way]).then(|| start.wrapping_add_signed(ways(width)[way] * n as isize));
        let farther = |at: usize| z[at] - own > self.tear();
        let mut nearest = None;
        let mut most = (width / REACH).max(1);
        for (way, steps) in steps.iter().enumerate() {
            let mut n = 0;
            while let Some(here) = at(way, n).filter(|here| steps[*here] > 0) {
                n += steps[here] as usize;
                if n > most {
                    break;
                }
                if at(way, n).is_some_and(farther) {
                    // The next way must be shorter.
                    (nearest, most) = (Some((way, n)), n - 1);
                    break;
                }
            }
        }
        let (way, distance) = nearest?;
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

/// Index steps to the left, to the right, up and down.
fn ways(width: usize) -> [isize; 4] {
    [-1, 1, -(width as isize), width as isize]
}

/// The number of pixels from each one to the next with an edge around it, to the left, to the right, up and down; 0
/// where there is none.
fn steps(edges: &[bool], width: usize) -> [Vec<u32>; 4] {
    let along = |way: usize| {
        let mut steps = vec![0u32; edges.len()];
        let mut count = |at: usize| {
            let (column, height) = (at % width, edges.len() / width);
            let ends = [column, width - 1 - column, at / width, height - 1 - at / width];
            if ends[way] > 0 {
                let next = at.wrapping_add_signed(ways(width)[way]);
                steps[at] = match (edges[next], steps[next]) {
                    (true, _) => 1,
                    (false, 0) => 0,
                    (false, more) => more + 1,
                };
            }
        };
        match way {
            0 | 2 => (0..edges.len()).for_each(&mut count),
            _ => (0..edges.len()).rev().for_each(&mut count),
        }
        steps
    };
    let two = |a: usize, b: usize| rayon::join(|| along(a), || along(b));
    let ((left, right), (up, down)) = rayon::join(|| two(0, 1), || two(2, 3));
    [left, right, up, down]
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
    fn the_edge_found_is_the_nearest_by_the_definition() {
        let [height, width] = [23, 70];
        let noise = |i: usize| ((i as u32 + 1).wrapping_mul(2_654_435_761) >> 8) as f32 / 16_777_216.0;
        // Steps of several depths.
        let inverse = |at: usize| 0.25 * (4.0 * noise(at / width / 5 * 90 + at % width / 9)).floor();
        let map = DepthMap {
            inverse: (0..height * width).map(inverse).collect(),
            confidence: None,
            resolution: [height, width],
        };
        let frame = vec![0.5; 3 * height * width];
        let surfaces = Surfaces::new(Level::scalar(), &map, &frame);
        let beyond = surfaces.beyond();
        let columns = grid([height, width])[1];
        let mut found = 0;
        for (cell, beyond) in beyond.iter().enumerate() {
            let (row, column) = (cell / columns * CELL, cell % columns * CELL);
            let own = scene_depth(surfaces.at(row, column).inverse);
            let edge = |row: Option<usize>, column: Option<usize>| {
                let (row, column) = (row.filter(|y| *y < height)?, column.filter(|x| *x < width)?);
                let at = row * width + column;
                (surfaces.z()[at] - own > surfaces.tear() && surfaces.edge_around(at)).then_some(())
            };
            let nearest = (1..=width / REACH).find(|n| {
                let around = [
                    edge(Some(row), column.checked_sub(*n)),
                    edge(Some(row), Some(column + n)),
                    edge(row.checked_sub(*n), Some(column)),
                    edge(Some(row + n), Some(column)),
                ];
                around.contains(&Some(()))
            });
            let distance = beyond.as_ref().map(|beyond| beyond.distance);
            // A surface may end again right behind its edge.
            assert!(distance.is_none() || distance == nearest, "cell {cell}: {distance:?}, expected {nearest:?}");
            found += usize::from(distance.is_some());
        }
        assert!(found > beyond.len() / 4, "{found} of {}", beyond.len());
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
