//! The formula in binary64.

/// `Σ (x − r)² − τ² · Σ r²` relative to the second term: above 0 where the row moved.
pub fn excess(tau: f32, x: &[f32], r: &[f32]) -> f64 {
    let distance: f64 = x.iter().zip(r).map(|(x, r)| (f64::from(*x) - f64::from(*r)).powi(2)).sum();
    let bound = f64::from(tau).powi(2) * r.iter().map(|r| f64::from(*r).powi(2)).sum::<f64>();
    (distance - bound) / bound
}
