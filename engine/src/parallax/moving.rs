//! Things that move by themselves.

use super::triangulate::Cell;

/// Least share of the picture of a thing that counts.
const LEAST: f64 = 0.002;
/// Rows of cells under a thing in which the ground is looked for.
const UNDER: usize = 6;

/// Sets the inverse depth of each connected moving thing to that right under its lowest cells. Without a value there it stays a hole, to be
/// filled from its neighbours.
pub(super) fn to_the_ground(cells: &mut [Cell], [rows, columns]: [usize; 2]) {
    let mut visited = vec![false; cells.len()];
    for first in 0..cells.len() {
        if visited[first] || !cells[first].moves {
            continue;
        }
        let (mut thing, mut next) = (Vec::new(), vec![first]);
        visited[first] = true;
        while let Some(at) = next.pop() {
            thing.push(at);
            let (row, column) = (at / columns, at % columns);
            let around = [
                (row > 0).then(|| at - columns),
                (row + 1 < rows).then(|| at + columns),
                (column > 0).then(|| at - 1),
                (column + 1 < columns).then(|| at + 1),
            ];
            for to in around.into_iter().flatten() {
                if cells[to].moves && !visited[to] {
                    visited[to] = true;
                    next.push(to);
                }
            }
        }
        if thing.len() as f64 >= LEAST * cells.len() as f64 {
            thing.sort_unstable();
            ground(cells, &thing, [rows, columns]);
        }
    }
}

/// `thing`: its cells, ascending.
fn ground(cells: &mut [Cell], thing: &[usize], [rows, columns]: [usize; 2]) {
    let (Some(first), Some(last)) = (thing.first(), thing.last()) else { return };
    let (top, bottom) = (first / columns, last / columns);
    let low = bottom - (bottom - top) / 5;
    let (mut sum, mut weight) = (0.0, 0.0);
    for &at in thing.iter().filter(|at| **at / columns >= low) {
        for row in at / columns + 1..(at / columns + 1 + UNDER).min(rows) {
            let cell = cells[row * columns + at % columns];
            if cell.moves {
                break;
            }
            sum += cell.inverse * cell.confidence;
            weight += cell.confidence;
        }
    }
    if weight > 0.0 {
        for &at in thing {
            cells[at].inverse = sum / weight;
            cells[at].confidence = 0.25;
        }
    }
}
