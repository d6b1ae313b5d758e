//! Small symmetric systems.

/// Solves `A·x = b` by Cholesky's method, with a small value added on the diagonal; `None` if `A` is not positive
/// definite or a number is not finite.
pub(super) fn solve<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N]) -> Option<[f64; N]> {
    let trace: f64 = (0..N).map(|i| a[i][i]).sum();
    for (i, row) in a.iter_mut().enumerate() {
        row[i] += 1e-12 * trace;
    }
    for i in 0..N {
        for j in 0..=i {
            let sum = (0..j).fold(a[i][j], |sum, k| sum - a[i][k] * a[j][k]);
            if i == j {
                if !(sum > 0.0 && sum.is_finite()) {
                    return None;
                }
                a[i][i] = sum.sqrt();
            } else {
                a[i][j] = sum / a[j][j];
            }
        }
    }
    for i in 0..N {
        b[i] = (0..i).fold(b[i], |sum, k| sum - a[i][k] * b[k]) / a[i][i];
    }
    for i in (0..N).rev() {
        b[i] = (i + 1..N).fold(b[i], |sum, k| sum - a[k][i] * b[k]) / a[i][i];
    }
    b.iter().all(|x| x.is_finite()).then_some(b)
}

/// Sums of weighted least squares, `Σ w·j·jᵀ` and `Σ w·j·r`.
#[derive(Clone, Copy)]
pub(super) struct Normal<const N: usize> {
    a: [[f64; N]; N],
    b: [f64; N],
}

impl<const N: usize> Normal<N> {
    pub(super) fn new() -> Self {
        Self { a: [[0.0; N]; N], b: [0.0; N] }
    }

    /// Adds the equation `j·x = r` with weight `w`.
    pub(super) fn add(&mut self, w: f64, j: &[f64; N], r: f64) {
        for i in 0..N {
            for k in 0..=i {
                self.a[i][k] += w * j[i] * j[k];
            }
            self.b[i] += w * j[i] * r;
        }
    }

    pub(super) fn solve(self) -> Option<[f64; N]> {
        solve(self.a, self.b)
    }
}
