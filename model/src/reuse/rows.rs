//! Some rows of a matrix, gathered; and the rows that are kept to compare them with.

use streamsplat_kernels::Level;
use streamsplat_kernels::change::{Tolerance, moved};

/// Rows of a matrix `[n, d]`: where they lie, and their values.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rows {
    /// Their places.
    pub(crate) at: Vec<u32>,
    /// `[at.len(), d]`
    pub(crate) x: Vec<f32>,
}

impl Rows {
    /// All rows of `x [n, d]`.
    pub(crate) fn all(x: Vec<f32>, d: usize) -> Rows {
        Rows { at: (0..(x.len() / d) as u32).collect(), x }
    }

    /// The rows `at` of `x [n, d]`.
    pub(crate) fn gather(at: Vec<u32>, x: &[f32], d: usize) -> Rows {
        let mut rows = Vec::with_capacity(at.len() * d);
        at.iter().for_each(|&row| rows.extend_from_slice(&x[row as usize * d..][..d]));
        Rows { at, x: rows }
    }

    /// Writes them to their places in `to [n, d]`.
    pub(crate) fn scatter(&self, to: &mut [f32], d: usize) {
        scatter(&self.at, &self.x, to, d);
    }

    /// Keeps those that are `wanted`.
    fn retain(&mut self, wanted: &[bool], d: usize) {
        let mut kept = 0;
        for (row, _) in wanted.iter().enumerate().filter(|(_, wanted)| **wanted) {
            self.at[kept] = self.at[row];
            self.x.copy_within(row * d..(row + 1) * d, kept * d);
            kept += 1;
        }
        self.at.truncate(kept);
        self.x.truncate(kept * d);
    }
}

/// Writes the rows of `x` to the places `at` of `to [n, d]`.
fn scatter(at: &[u32], x: &[f32], to: &mut [f32], d: usize) {
    for (row, x) in at.iter().zip(x.chunks_exact(d)) {
        to[*row as usize * d..][..d].copy_from_slice(x);
    }
}

/// Writes the rows of every head of `x [heads][at][width]` to the places `at` of `to [heads][n][width]`.
pub(crate) fn scatter_heads(at: &[u32], x: &[f32], width: usize, to: &mut [f32]) {
    if at.is_empty() {
        return;
    }
    let heads = x.len() / (at.len() * width);
    let n = to.len() / heads;
    for (x, to) in x.chunks_exact(at.len() * width).zip(to.chunks_exact_mut(n)) {
        scatter(at, x, to, width);
    }
}

/// Makes `kept` hold `len` values. Those that are new are zeros of the system, which cost nothing until they are written.
pub(super) fn sized(kept: &mut Vec<f32>, len: usize) {
    if kept.len() != len {
        *kept = vec![0.0; len];
    }
}

/// The places that are `true`.
pub(super) fn places(marks: &[bool]) -> Vec<u32> {
    (0..marks.len() as u32).filter(|i| marks[*i as usize]).collect()
}

/// Rows as they were when they were last computed.
#[derive(Debug)]
pub(super) struct Gate {
    d: usize,
    rows: usize,
    reference: Vec<f32>,
}

impl Gate {
    /// Of `rows` rows of width `d`; takes no memory before the first [`Gate::keep`].
    pub(super) fn new(rows: usize, d: usize) -> Gate {
        Gate { d, rows, reference: Vec::new() }
    }

    /// Keeps all of `x`.
    pub(super) fn keep(&mut self, x: &[f32]) {
        self.reference.clear();
        self.reference.extend_from_slice(x);
        self.rows = x.len() / self.d;
    }

    /// Keeps `rows`, which are all, in any order.
    pub(super) fn keep_at(&mut self, rows: &Rows) {
        self.rows = rows.at.len();
        sized(&mut self.reference, rows.x.len());
        self.replace(rows);
    }

    /// Which rows of `x` moved; all, when nothing of this size was kept.
    pub(super) fn moved(&self, level: Level, tolerance: Tolerance, x: &[f32]) -> Vec<bool> {
        let mut marks = vec![true; x.len() / self.d];
        if x.len() == self.reference.len() {
            moved(level, tolerance, self.d, x, &self.reference, None, &mut marks);
        }
        marks
    }

    /// Keeps the values of `rows`.
    pub(super) fn replace(&mut self, rows: &Rows) {
        rows.scatter(&mut self.reference, self.d);
    }

    /// Drops the rows that did not move, and keeps the values of the others.
    pub(super) fn pass(&mut self, level: Level, tolerance: Tolerance, rows: &mut Rows) {
        let mut marks = vec![false; rows.at.len()];
        moved(level, tolerance, self.d, &rows.x, &self.reference, Some(&rows.at), &mut marks);
        rows.retain(&marks, self.d);
        self.replace(rows);
    }

    /// All rows as they were kept.
    pub(super) fn reference(&self) -> &[f32] {
        &self.reference
    }

    /// Rows it was made for, or keeps.
    pub(super) fn rows(&self) -> usize {
        self.rows
    }

    pub(super) fn bytes(&self) -> usize {
        4 * self.reference.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_every_head_reach_their_places() {
        let (n, width) = (3, 2);
        let mut to = vec![0.0; 2 * n * width];
        // Two rows of two heads; the last row first.
        scatter_heads(&[2, 0], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0], width, &mut to);
        assert_eq!(to, [3.0, 4.0, 0.0, 0.0, 1.0, 2.0, 7.0, 8.0, 0.0, 0.0, 5.0, 6.0]);
        scatter_heads(&[], &[], width, &mut to);
        assert_eq!(to[..2], [3.0, 4.0]);
    }
}
