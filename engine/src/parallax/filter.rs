//! Inverse depth over intervals: earlier cells are carried along the flow, in one scale.

use streamsplat_kernels::{Level, resize};

use super::triangulate::Cell;
use super::{CELL, Sight, bodies, fill};
use crate::world::{map_value, scene_depth};

/// Largest inverse depth kept, in units of the first median.
pub(super) const NEAREST: f32 = 20.0;
/// Fraction of its confidence that an inverse depth keeps from one key frame to the next.
const KEEPS: f32 = 0.8;
/// Maximum confidence.
const MOST: f32 = 16.0;
/// Fraction of the difference by which the nearest depth approaches the new one at a key frame.
const ADAPTS: f32 = 0.25;
/// Minimum mean confidence of a valid result.
const LEAST: f32 = 0.02;

/// Inverse depth of a key frame's cells and its confidence: the state carried from key frame to key frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Rows and columns of cells.
    pub grid: [usize; 2],
    /// Inverse depth per cell, in one scale for the whole stream.
    pub inverse: Vec<f32>,
    /// Confidence per cell; 0: no value.
    pub confidence: Vec<f32>,
    /// Score per cell, from 0 to 1: 1 where a body moves independently, less for each key frame since.
    pub body: Vec<f32>,
    /// Inverse depth that counts as nearest.
    pub nearest: f32,
}

/// Inverse depth of a key frame's cells, and the same without holes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Filled {
    pub(crate) found: Found,
    values: Vec<f32>,
}

impl Filled {
    /// [`Found::map`] of a frame of this height and width.
    pub(crate) fn map(&self, level: Level, [height, width]: [usize; 2]) -> Vec<f32> {
        let Self { found, values } = self;
        // 1/z of the nearest point of a lifted scene.
        let unit = 1.0 / scene_depth(1.0) / found.nearest.max(f32::MIN_POSITIVE);
        let value = |inverse: &f32| map_value(1.0 / (unit * inverse).max(1e-3)).clamp(0.0, 1.0);
        let values: Vec<f32> = values.iter().map(value).collect();
        let [rows, columns] = found.grid;
        let [tall, wide] = [rows * CELL, columns * CELL];
        let mut large = vec![0.0; tall * wide];
        resize::bilinear(level, &values, 1, rows, columns, tall, wide, &mut large);
        large.chunks(wide).take(height).flat_map(|row| &row[..width]).copied().collect()
    }
}

impl Found {
    /// Returns the map `[H, W]` of the frame `[3, H, W]`: holes filled, 0 farthest, 1 nearest. Since the zero of the
    /// inverse depth is known, its ratios are kept in a [lifted](crate::stream) scene: `9.8·y + 0.2 ∝ ρ`.
    pub fn map(&self, level: Level, rgb: &[f32], size: [usize; 2]) -> Vec<f32> {
        self.clone().filled(level, rgb, size).map(level, size)
    }

    /// Fills the holes with the help of the frame `[3, H, W]`.
    pub(crate) fn filled(self, level: Level, rgb: &[f32], size: [usize; 2]) -> Filled {
        Filled { values: self.values(level, rgb, size), found: self }
    }

    /// Returns the inverse depth with its holes filled.
    fn values(&self, level: Level, rgb: &[f32], [height, width]: [usize; 2]) -> Vec<f32> {
        let area = height * width;
        let colour = |cell: usize| {
            let (row, column) = (cell / self.grid[1] * CELL, cell % self.grid[1] * CELL);
            std::array::from_fn(|channel| {
                let (mut sum, mut count) = (0.0, 0.0);
                for y in row..(row + CELL).min(height) {
                    for x in column..(column + CELL).min(width) {
                        sum += rgb[channel * area + y * width + x];
                        count += 1.0;
                    }
                }
                sum / count
            })
        };
        let colours: Vec<[f32; 3]> = (0..self.inverse.len()).map(colour).collect();
        fill::fill(level, &self.inverse, &self.confidence, &colours, self.grid)
    }

    /// Returns expected and found values, if this cannot be a result of [`find`](super::find) for pictures of this
    /// size.
    pub fn contradiction(&self, size: [usize; 2]) -> Option<String> {
        let grid = size.map(|side| side.div_ceil(CELL));
        let count = grid[0].checked_mul(grid[1]);
        if self.grid != grid
            || [&self.inverse, &self.confidence, &self.body].iter().any(|plane| count != Some(plane.len()))
        {
            return Some(format!(
                "expected inverse depth of {}x{} cells, found {}x{}",
                grid[0], grid[1], self.grid[0], self.grid[1]
            ));
        }
        let sound = |values: &[f32]| values.iter().all(|v| v.is_finite() && *v >= 0.0);
        (!(sound(&self.inverse) && sound(&self.confidence) && sound(&self.body) && sound(&[self.nearest])))
            .then(|| "expected inverse depth that is finite and not negative".to_owned())
    }
}

/// Returns the earlier picture's cells at the positions of this picture's cells, and the nearest inverse depth.
pub(super) fn carry(found: &Found, sight: &Sight<'_>) -> Option<(Vec<Cell>, f32)> {
    if found.grid != sight.grid {
        return None;
    }
    let [rows, columns] = found.grid;
    let half = (CELL - 1) as f32 * 0.5;
    let cells = (0..rows * columns).map(|cell| {
        let [x, y] = sight.middle(cell);
        let [u, v] = sight.evidence.there.at(x, y);
        let astray = sight.astray[sight.pixel(cell)] / sight.unit as f32;
        let place = |at: f32, cells: usize| ((at - half) / CELL as f32 + 0.5).clamp(0.0, cells as f32 - 1.0) as usize;
        if astray.is_nan() || astray >= 2.0 || !u.is_finite() || !v.is_finite() {
            return Cell::default();
        }
        let from = place(y + v, rows) * columns + place(x + u, columns);
        Cell {
            inverse: found.inverse[from],
            confidence: KEEPS * found.confidence[from] / (1.0 + astray * astray),
            body: KEEPS * found.body[from],
            ..Cell::default()
        }
    });
    Some((cells.collect(), found.nearest))
}

/// Joins the cells of this interval with the carried ones, in the scale of the carried ones if there are any. Returns
/// `None` if both together have too little confidence.
pub(super) fn join(
    level: Level,
    now: Option<Vec<Cell>>,
    carried: Option<Option<(Vec<Cell>, f32)>>,
    sight: &Sight<'_>,
) -> Option<Filled> {
    let (mut cells, nearest) = match (now, carried.flatten()) {
        (None, None) => return None,
        (Some(now), None) => (now, None),
        (None, Some((carried, nearest))) => (carried, Some(nearest)),
        (Some(mut now), Some((carried, nearest))) => {
            let ratios = now
                .iter()
                .zip(&carried)
                .map(|(now, then)| (then.inverse / now.inverse.max(1e-6), now.confidence.min(then.confidence)));
            let shared: f32 = now.iter().zip(&carried).map(|(now, then)| now.confidence.min(then.confidence)).sum();
            match weighted_median(ratios).filter(|_| shared >= LEAST * now.len() as f32) {
                None => (now, None),
                Some(scale) => {
                    for (now, then) in now.iter_mut().zip(&carried) {
                        let whole = now.confidence + then.confidence;
                        if now.body > 0.0 || then.body >= bodies::STILL_BODY {
                            // A body's depth already includes that of the previous key frame, and a body's former depth
                            // is not averaged into another object.
                            now.inverse = (now.inverse * scale).min(NEAREST);
                        } else if whole > 0.0 {
                            let sum = (now.inverse * scale).mul_add(now.confidence, then.inverse * then.confidence);
                            now.inverse = (sum / whole).min(NEAREST);
                            now.confidence = whole.min(MOST);
                        }
                    }
                    (now, Some(nearest))
                }
            }
        }
    };
    let mean = cells.iter().map(|c| c.confidence).sum::<f32>() / cells.len() as f32;
    if mean.is_nan() || mean < LEAST {
        return None;
    }
    cells.iter_mut().filter(|c| c.confidence <= 0.0).for_each(|c| *c = Cell::default());
    let mut found = Found {
        grid: sight.grid,
        inverse: cells.iter().map(|c| c.inverse).collect(),
        confidence: cells.iter().map(|c| c.confidence).collect(),
        body: cells.iter().map(|c| c.body).collect(),
        nearest: 0.0,
    };
    let values = found.values(level, sight.evidence.rgb, sight.evidence.there.size);
    let mut ranked = values.clone();
    let [far, near] = [1, 99].map(|share| {
        let place = (ranked.len() - 1) * share / 100;
        *ranked.select_nth_unstable_by(place, f32::total_cmp).1
    });
    found.nearest = nearest.map_or(near, |then| ADAPTS.mul_add(near - then, then));
    // A constant depth carries no information.
    (near > 1.05 * far).then_some(Filled { found, values })
}

/// Returns the weighted median; `None` without any weight.
pub(super) fn weighted_median(values: impl Iterator<Item = (f32, f32)>) -> Option<f32> {
    let mut values: Vec<(f32, f32)> = values.filter(|(v, w)| v.is_finite() && *w > 0.0).collect();
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|(_, w)| f64::from(*w)).sum::<f64>();
    let mut sum = 0.0;
    values
        .into_iter()
        .find(|(_, w)| {
            sum += f64::from(*w);
            sum >= half
        })
        .map(|(v, _)| v)
}
