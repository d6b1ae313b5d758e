//! The Pareto front of time and quality.

/// Marks the points (time, quality) that no other dominates. A point dominates another if it takes no more time, is no
/// worse, and is better in one of the two. Equal points are on the front together.
pub(super) fn front(points: &[(f64, f64)]) -> Vec<bool> {
    let dominates = |a: &(f64, f64), b: &(f64, f64)| a.0 <= b.0 && a.1 >= b.1 && a != b;
    points.iter().map(|point| !points.iter().any(|other| dominates(other, point))).collect()
}

#[cfg(test)]
mod tests {
    use super::front;

    #[test]
    fn what_is_slower_and_worse_is_not_on_the_front() {
        let points = [(1.0, 20.0), (2.0, 25.0), (2.0, 24.0), (3.0, 24.5), (4.0, 30.0), (1.0, 20.0)];
        assert_eq!(front(&points), [true, true, false, false, true, true]);
    }
}
