//! A codebook of 256 values by Lloyd's algorithm in one dimension.

use serde_json::Value;

/// Values of a codebook.
const SIZE: usize = 256;
/// Maximum number of rounds of assigning and averaging.
const ROUNDS: usize = 32;

/// Ascending values; the last one is repeated if there are fewer than 256.
pub(super) struct Codebook {
    values: [f32; SIZE],
}

impl Codebook {
    /// Returns the values themselves if there are at most 256 different ones. Otherwise the rounds start from 128
    /// quantiles of the values and 128 equal steps. A value at equal distance from two centres is assigned to the
    /// smaller one. Means are computed in binary64 from sums in ascending order.
    pub(super) fn of(values: impl Iterator<Item = f32>) -> Codebook {
        let mut sorted: Vec<f32> = values.collect();
        sorted.sort_unstable_by(f32::total_cmp);
        let mut different = sorted.clone();
        different.dedup();
        if different.len() <= SIZE {
            let last = different.last().copied().unwrap_or(0.0);
            different.resize(SIZE, last);
            return Codebook { values: std::array::from_fn(|i| different[i]) };
        }
        // Prefix sums.
        let mut sums = Vec::with_capacity(sorted.len() + 1);
        sums.push(0.0_f64);
        for x in &sorted {
            sums.push(sums[sums.len() - 1] + f64::from(*x));
        }
        let (first, last) = (f64::from(sorted[0]), f64::from(sorted[sorted.len() - 1]));
        let mut centres: [f64; SIZE] = std::array::from_fn(|i| {
            let share = (i / 2) as f64 / (SIZE / 2 - 1) as f64;
            if i % 2 == 0 {
                f64::from(sorted[(share * (sorted.len() - 1) as f64) as usize])
            } else {
                first + (last - first) * share
            }
        });
        centres.sort_unstable_by(f64::total_cmp);
        for _ in 0..ROUNDS {
            let mut from = 0;
            let before = centres;
            for i in 0..SIZE {
                let to = match before.get(i + 1) {
                    Some(next) => {
                        let middle = f64::midpoint(before[i], *next);
                        sorted.partition_point(|x| f64::from(*x) <= middle)
                    }
                    None => sorted.len(),
                };
                if to > from {
                    centres[i] = (sums[to] - sums[from]) / (to - from) as f64;
                    from = to;
                }
            }
            centres.sort_unstable_by(f64::total_cmp);
            if centres == before {
                break;
            }
        }
        Codebook { values: centres.map(|c| c as f32) }
    }

    /// Returns the index of the nearest value, the first of equals.
    pub(super) fn nearest(&self, x: f32) -> u8 {
        let above = self.values.partition_point(|value| *value < x).min(SIZE - 1);
        let below = above.saturating_sub(1);
        let distance = |i: usize| (f64::from(self.values[i]) - f64::from(x)).abs();
        (if distance(below) <= distance(above) { below } else { above }) as u8
    }

    pub(super) fn json(&self) -> Value {
        self.values.as_slice().into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_values_are_kept_and_many_are_near() {
        let few = [3.0, -1.0, 3.0, 0.5];
        let codebook = Codebook::of(few.into_iter());
        assert!(few.iter().all(|x| codebook.values[usize::from(codebook.nearest(*x))] == *x));
        // A normal distribution from sums of uniform values: the error is close to the optimum's, 2.7 / n² of the
        // variance.
        let mut state = 1_u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state) / f64::from(u32::MAX)
        };
        let many: Vec<f32> = (0..40_000).map(|_| ((0..12).map(|_| next()).sum::<f64>() - 6.0) as f32).collect();
        let codebook = Codebook::of(many.iter().copied());
        assert!(codebook.values.is_sorted());
        let error = |x: &f32| (f64::from(*x) - f64::from(codebook.values[usize::from(codebook.nearest(*x))])).powi(2);
        let mean = many.iter().map(error).sum::<f64>() / many.len() as f64;
        assert!(mean < 2.0 * 2.7 / (256.0 * 256.0), "{mean}");
        let exhaustive = |x: &f32| codebook.values.iter().map(|v| (v - x).abs()).fold(f32::INFINITY, f32::min);
        assert!(
            many.iter()
                .take(2000)
                .all(|x| (codebook.values[usize::from(codebook.nearest(*x))] - x).abs() == exhaustive(x))
        );
    }
}
