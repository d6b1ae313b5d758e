//! Holes of a depth map, filled from the values around them.
//!
//! Means weighted by confidence are pulled up a pyramid of halves, `v' = Σ w·v / Σ w` and `w' = min(1, Σ w)` over 2×2
//! values, and pushed down again where a value is not trusted: `v = w·v + (1 − w)·coarser`. Sums run along rows, in
//! binary32.

use super::DepthMap;

/// One in this many of a map's values, at either end, does not count for its range.
const OUTLIERS: usize = 200;
/// Part of the range added at either end for them.
const ROOM: f64 = 0.03;

/// Brings a map into [0, 1] by the range of its finite values without the nearest and the farthest 200th, plus a small
/// margin for these. Where that range is empty, by the range of all. A map of one value becomes 0. Computed in
/// binary64, then rounded.
pub(in crate::stream) fn normalise_most(depth: &mut [f32]) {
    let mut known: Vec<f64> = depth.iter().filter(|d| d.is_finite()).map(|d| f64::from(*d)).collect();
    let Some(last) = known.len().checked_sub(1) else { return };
    let mut nth = |n: usize| *known.select_nth_unstable_by(n, f64::total_cmp).1;
    let all = [nth(0), nth(last)];
    let [low, high] = [nth(last / OUTLIERS), nth(last - last / OUTLIERS)];
    let room = ROOM * (high - low);
    let [low, high] = if high > low { [(low - room).max(all[0]), (high + room).min(all[1])] } else { all };
    let range = high - low;
    for d in depth {
        let known = d.is_finite() && range > 0.0;
        *d = if known { ((f64::from(*d) - low) / range).clamp(0.0, 1.0) as f32 } else { 0.0 };
    }
}

/// Values and weights of a level.
struct Layer {
    size: [usize; 2],
    value: Vec<f32>,
    weight: Vec<f32>,
}

impl DepthMap {
    /// The map without holes; `None` where no two of its values differ.
    pub(in crate::stream) fn filled(&self) -> Option<DepthMap> {
        let weight: Vec<f32> = match &self.confidence {
            Some(confidence) => {
                let trusted =
                    |(v, c): (&f32, &f32)| if v.is_finite() && c.is_finite() { c.clamp(0.0, 1.0) } else { 0.0 };
                self.inverse.iter().zip(confidence).map(trusted).collect()
            }
            None => self.inverse.iter().map(|v| f32::from(u8::from(v.is_finite()))).collect(),
        };
        let mut known = self.inverse.iter().zip(&weight).filter(|(_, w)| **w > 0.0).map(|(v, _)| *v);
        let first = known.next()?;
        if known.all(|v| v == first) {
            return None;
        }
        if weight.iter().all(|w| *w == 1.0) {
            return Some(DepthMap { inverse: self.inverse.clone(), confidence: None, resolution: self.resolution });
        }
        let value = self.inverse.iter().zip(&weight).map(|(v, w)| if *w > 0.0 { *v } else { 0.0 }).collect();
        let mut layers = vec![Layer { size: self.resolution, value, weight }];
        while let Some(next) = layers.last().and_then(Layer::halved) {
            layers.push(next);
        }
        let mut coarse = layers.pop()?;
        while let Some(mut fine) = layers.pop() {
            fine.take(&coarse);
            coarse = fine;
        }
        Some(DepthMap { inverse: coarse.value, confidence: None, resolution: self.resolution })
    }
}

impl Layer {
    /// The level of half the size; `None` for a level of one value.
    fn halved(&self) -> Option<Layer> {
        let [rows, columns] = self.size;
        if rows * columns <= 1 {
            return None;
        }
        let size = self.size.map(|side| side.div_ceil(2));
        let (mut value, mut weight) = (Vec::with_capacity(size[0] * size[1]), Vec::with_capacity(size[0] * size[1]));
        for y in 0..size[0] {
            for x in 0..size[1] {
                let (mut sum, mut total) = (0.0f32, 0.0f32);
                for row in 2 * y..(2 * y + 2).min(rows) {
                    for column in 2 * x..(2 * x + 2).min(columns) {
                        let at = row * columns + column;
                        sum = self.weight[at].mul_add(self.value[at], sum);
                        total += self.weight[at];
                    }
                }
                value.push(if total > 0.0 { sum / total } else { 0.0 });
                weight.push(total.min(1.0));
            }
        }
        Some(Layer { size, value, weight })
    }

    /// Replaces untrusted values by those of the level of half its size, bilinearly.
    fn take(&mut self, coarse: &Layer) {
        let [rows, columns] = self.size;
        let [coarse_rows, coarse_columns] = coarse.size;
        // The centre of a value is a quarter of a coarse value before or behind the coarse one's centre.
        let near = |i: usize, side: usize| {
            let own = (i / 2).min(side - 1);
            let other = if i.is_multiple_of(2) { own.saturating_sub(1) } else { (own + 1).min(side - 1) };
            [own, other]
        };
        for y in 0..rows {
            let [y0, y1] = near(y, coarse_rows);
            for x in 0..columns {
                let at = y * columns + x;
                let w = self.weight[at];
                if w == 1.0 {
                    continue;
                }
                let [x0, x1] = near(x, coarse_columns);
                let along = |y: usize| {
                    let row = &coarse.value[y * coarse_columns..];
                    0.75f32.mul_add(row[x0], 0.25 * row[x1])
                };
                let below = 0.75f32.mul_add(along(y0), 0.25 * along(y1));
                self.value[at] = w.mul_add(self.value[at] - below, below);
                self.weight[at] = 1.0;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(inverse: Vec<f32>, confidence: Option<Vec<f32>>) -> DepthMap {
        let resolution = [inverse.len() / 6, 6];
        DepthMap { inverse, confidence, resolution }
    }

    #[test]
    fn holes_are_filled_from_around_them_and_what_is_known_stays() {
        let inverse: Vec<f32> = (0..30).map(|i| if i % 7 == 3 { f32::NAN } else { (i / 6) as f32 / 5.0 }).collect();
        let filled = map(inverse.clone(), None).filled().expect("a map");
        for (at, (given, filled)) in inverse.iter().zip(&filled.inverse).enumerate() {
            match given.is_finite() {
                true => assert_eq!(given, filled),
                false => assert!((filled - (at / 6) as f32 / 5.0).abs() < 0.25, "{at}: {filled}"),
            }
        }
        let confidence = inverse.iter().map(|v| if v.is_finite() { 1.0 } else { 0.0 }).collect();
        let wild = inverse.iter().map(|v| if v.is_finite() { *v } else { 7.0 }).collect();
        assert_eq!(map(wild, Some(confidence)).filled(), Some(filled));
    }

    #[test]
    fn maps_without_two_values_tell_nothing() {
        for value in [0.5, f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(map(vec![value; 30], None).filled(), None);
        }
        let mut one = vec![f32::NAN; 30];
        one[4] = 0.5;
        assert_eq!(map(one, None).filled(), None);
        assert_eq!(map((0..30).map(|i| i as f32).collect(), Some(vec![0.0; 30])).filled(), None);
    }

    #[test]
    fn a_range_leaves_out_what_is_far_from_everything() {
        let mut depth: Vec<f32> = (0..1000).map(|i| i as f32 / 1000.0).collect();
        depth[10] = 1e9;
        depth[20] = f32::NAN;
        depth[30] = f32::NEG_INFINITY;
        normalise_most(&mut depth);
        assert_eq!(depth[10], 1.0);
        assert!(depth[900] > 0.8 && depth[900] < 0.95 && depth.iter().all(|d| (0.0..=1.0).contains(d)));
        let mut same = vec![3.0; 9];
        normalise_most(&mut same);
        assert_eq!(same, [0.0; 9]);
        normalise_most(&mut []);
    }
}
