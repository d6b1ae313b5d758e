//! A palette of rows by a tree of splits.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Least and most rows. Between them half as many as there are Gaussians at least: a power of two.
const LEAST: usize = 1 << 10;
const MOST: usize = 1 << 16;

/// The rows, and for each input row the index of the row that replaces it.
pub(super) struct Palette {
    pub(super) rows: Vec<f32>,
    pub(super) labels: Vec<u16>,
}

/// Input rows that share one row of the palette.
struct Cell {
    /// Sum of squared distances from the mean.
    error: f64,
    number: usize,
    /// Range of its members in the list of all.
    from: usize,
    to: usize,
    mean: Vec<f64>,
    /// The coefficient that varies most.
    widest: usize,
}

impl Palette {
    /// Splits cells until their number is the wanted one or all rows of every cell are equal. Each step splits the cell
    /// of largest error, the first of equals, at the mean of its widest coefficient. Sums are in binary64 in the order
    /// of the members.
    pub(super) fn of(rows: &[f32], width: usize) -> Palette {
        let count = rows.len() / width;
        let wanted = ((count + 1).next_power_of_two() / 2).clamp(LEAST, MOST);
        let mut members: Vec<u32> = (0..count as u32).collect();
        let mut heap = BinaryHeap::new();
        heap.push(Cell::of(rows, width, &members, 0..count, 0));
        while heap.len() < wanted {
            let Some(cell) = heap.pop() else { break };
            if cell.error <= 0.0 {
                heap.push(cell);
                break;
            }
            let own = &mut members[cell.from..cell.to];
            let is_low = |i: &u32| f64::from(rows[*i as usize * width + cell.widest]) <= cell.mean[cell.widest];
            let (low, high): (Vec<u32>, Vec<u32>) = own.iter().partition(|i| is_low(i));
            let middle = cell.from + low.len();
            own[..low.len()].copy_from_slice(&low);
            own[low.len()..].copy_from_slice(&high);
            if middle == cell.from || middle == cell.to {
                // The rows are equal; only rounding makes the mean differ.
                heap.push(Cell { error: 0.0, ..cell });
                continue;
            }
            let number = heap.len() + 1;
            heap.push(Cell::of(rows, width, &members, cell.from..middle, cell.number));
            heap.push(Cell::of(rows, width, &members, middle..cell.to, number));
        }
        let mut cells = heap.into_vec();
        cells.sort_unstable_by_key(|cell| cell.from);
        let mut labels = vec![0; count];
        for (label, cell) in cells.iter().enumerate() {
            members[cell.from..cell.to].iter().for_each(|&i| labels[i as usize] = label as u16);
        }
        Palette { rows: cells.iter().flat_map(|cell| cell.mean.iter().map(|x| *x as f32)).collect(), labels }
    }
}

impl Cell {
    fn of(rows: &[f32], width: usize, members: &[u32], range: std::ops::Range<usize>, number: usize) -> Cell {
        let own = &members[range.clone()];
        let row = |i: &u32| &rows[*i as usize * width..][..width];
        let mut mean = vec![0.0; width];
        own.iter().for_each(|i| mean.iter_mut().zip(row(i)).for_each(|(sum, x)| *sum += f64::from(*x)));
        mean.iter_mut().for_each(|sum| *sum /= own.len().max(1) as f64);
        let mut squares = vec![0.0; width];
        for i in own {
            squares
                .iter_mut()
                .zip(row(i))
                .zip(&mean)
                .for_each(|((sum, x), mean)| *sum += (f64::from(*x) - mean).powi(2));
        }
        let widest = (1..width).fold(0, |best, k| if squares[k] > squares[best] { k } else { best });
        Cell { error: squares.iter().sum(), number, from: range.start, to: range.end, mean, widest }
    }
}

impl Ord for Cell {
    fn cmp(&self, other: &Self) -> Ordering {
        self.error.total_cmp(&other.error).then(other.number.cmp(&self.number))
    }
}

impl PartialOrd for Cell {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Cell {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Cell {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn different_rows_of_a_small_scene_are_all_kept() {
        let rows: Vec<f32> = (0..900).map(|i| (i % 450) as f32 * 0.01 - 1.0).collect();
        let palette = Palette::of(&rows, 3);
        assert_eq!((palette.rows.len(), palette.labels.len()), (450, 300));
        for (row, label) in rows.chunks(3).zip(&palette.labels) {
            assert_eq!(row, &palette.rows[3 * usize::from(*label)..][..3]);
        }
    }

    #[test]
    fn many_rows_share_those_that_are_near() {
        let value = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 10_007) as f32 / 10_007.0;
        let rows: Vec<f32> = (0..5000).flat_map(|i| [value(i, 1), value(i, 2)]).collect();
        let palette = Palette::of(&rows, 2);
        assert_eq!(palette.rows.len(), 2 * 4096);
        let error = |i: usize, k: usize| rows[2 * i + k] - palette.rows[2 * usize::from(palette.labels[i]) + k];
        let mean = (0..5000).map(|i| error(i, 0).powi(2) + error(i, 1).powi(2)).sum::<f32>() / 5000.0;
        assert!(mean < 1e-3, "{mean}");
    }
}
