//! Scale and shift that bring a frame's depth map to the scale of the frames before.
//!
//! A map is known up to a scale and a shift, which flicker from frame to frame: every frame is normalised by its own
//! nearest and farthest place, and a network's output varies. [`Link`]s are places that optical flow connects, with d
//! in the new map and D in the one before. The line `D ≈ scale·d + shift` that fits most of them is found as follows:
//!
//! ```text
//! forward   D ≈ a·d + b by least squares of weights w = 1/(1 + (e/E)²)²      e: distance from the line of the round before, E: twice their median, not under 0.02
//! back      d ≈ a'·D + b' in the same way
//! scale     √(a/a')
//! shift     the median of D − scale·d
//! ```
//!
//! in [`ROUNDS`] rounds each; sums run over links in their order, in binary64. Noise makes the slope of a regression
//! too small. In the two directions the errors have opposite effects on the scale, so that scales do not shrink over a
//! long stream. The first round starts from the medians of both sides and of the distances from them. The result is
//! pulled by [`PULL`] towards the given map, so that a drift ends.

/// Rounds of reweighting.
const ROUNDS: usize = 12;
/// Fewest links that determine a line.
const FEWEST: usize = 32;
/// Part of the way back to the given map.
const PULL: f64 = 0.01;
/// Least and largest scale.
const SCALES: [f64; 2] = [0.25, 4.0];

/// `scale·d + shift`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::stream) struct Alignment {
    pub(in crate::stream) scale: f32,
    pub(in crate::stream) shift: f32,
}

/// Depth of one place in a frame and in the one before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::stream) struct Link {
    /// Value of the frame's own map.
    pub(in crate::stream) now: f32,
    /// Value in the frame before, in the scale of the stream.
    pub(in crate::stream) then: f32,
}

impl Default for Alignment {
    fn default() -> Self {
        Self { scale: 1.0, shift: 0.0 }
    }
}

impl From<Alignment> for [f32; 2] {
    fn from(Alignment { scale, shift }: Alignment) -> Self {
        [scale, shift]
    }
}

impl From<Option<[f32; 2]>> for Alignment {
    fn from(stored: Option<[f32; 2]>) -> Self {
        stored.map_or_else(Self::default, |[scale, shift]| Self { scale, shift })
    }
}

impl Alignment {
    /// Returns the map in the scale of the stream, clamped to [0, 1].
    pub(in crate::stream) fn apply(self, mut map: super::DepthMap) -> super::DepthMap {
        if self != Self::default() {
            map.inverse.iter_mut().for_each(|d| *d = self.scale.mul_add(*d, self.shift).clamp(0.0, 1.0));
        }
        map
    }
}

/// Aligns a map by its links with the one before, whose alignment was `last`.
pub(in crate::stream) fn align(links: &[Link], last: Alignment) -> Alignment {
    // Values clamped to the ends of the range carry no information about the scale.
    let inner = |x: f32| x > 0.0 && x < 1.0;
    let links: Vec<[f64; 2]> = links
        .iter()
        .filter(|link| inner(link.now) && inner(link.then))
        .map(|link| [f64::from(link.now), f64::from(link.then)])
        .collect();
    if links.len() < FEWEST {
        return last;
    }
    let back: Vec<[f64; 2]> = links.iter().map(|[now, then]| [*then, *now]).collect();
    let Some((forward, back)) = slope(&links).zip(slope(&back)) else { return last };
    let scale = (forward / back).sqrt().clamp(SCALES[0], SCALES[1]);
    let shift = median(links.iter().map(|[now, then]| then - scale * now).collect());
    Alignment { scale: (scale + PULL * (1.0 - scale)) as f32, shift: (shift - PULL * shift) as f32 }
}

/// Slope of the line that fits most of the points; `None` where they have no spread or it does not ascend.
fn slope(points: &[[f64; 2]]) -> Option<f64> {
    let middle = |side: usize| median(points.iter().map(|point| point[side]).collect());
    let middles = [middle(0), middle(1)];
    let spread = |side: usize| median(points.iter().map(|point| (point[side] - middles[side]).abs()).collect());
    let [a, b] = [spread(0), spread(1)];
    let first = if a > 0.0 && b > 0.0 { b / a } else { 1.0 };
    let mut line = [first, middles[1] - first * middles[0]];
    for _ in 0..ROUNDS {
        let distance = |[x, y]: [f64; 2]| (line[0] * x + line[1] - y).abs();
        let width = (2.0 * median(points.iter().map(|point| distance(*point)).collect())).max(0.02);
        let weight = |point: [f64; 2]| {
            let e = distance(point) / width;
            let base = 1.0 / (1.0 + e * e);
            base * base
        };
        let (mut total, mut sums) = (0.0, [0.0; 2]);
        for &point in points {
            let w = weight(point);
            total += w;
            sums = [0, 1].map(|side| sums[side] + w * point[side]);
        }
        let means = sums.map(|sum| sum / total);
        let (mut square, mut product) = (0.0, 0.0);
        for &point in points {
            let w = weight(point);
            let [x, y] = [0, 1].map(|side| point[side] - means[side]);
            square += w * x * x;
            product += w * x * y;
        }
        let steep = product / square;
        if !(steep.is_finite() && steep > 0.0 && square > 1e-10 * total) {
            return None;
        }
        line = [steep, means[1] - steep * means[0]];
    }
    Some(line[0])
}

/// The upper median of some values, at least one.
fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Links of `count` places, a fourth of which move on their own.
    fn links(count: u32, scale: f32, shift: f32) -> Vec<Link> {
        let place = |i: u32| (i.wrapping_mul(2_654_435_761) >> 8) as f32 / 16_777_216.0;
        (0..count)
            .map(|i| {
                let now = place(i);
                let then = if i % 4 == 0 { place(i + 9000) } else { scale.mul_add(now, shift) };
                Link { now, then }
            })
            .collect()
    }

    #[test]
    fn a_scale_and_a_shift_are_found_among_places_that_move() {
        for (scale, shift) in [(0.8, 0.1), (0.5, 0.3), (1.2, -0.1), (1.0, 0.0)] {
            let found = align(&links(2000, scale, shift), Alignment::default());
            // Except for the pull.
            let (expected, moved) = (scale + 0.01 * (1.0 - scale), 0.99 * shift);
            assert!((found.scale - expected).abs() < 0.01 && (found.shift - moved).abs() < 0.01, "{found:?}");
        }
    }

    #[test]
    fn few_links_equal_ones_and_bad_ones_leave_what_was() {
        let last = Alignment { scale: 1.3, shift: -0.2 };
        assert_eq!(align(&[], last), last);
        assert_eq!(align(&links(FEWEST as u32 - 1, 0.5, 0.2), last), last);
        let bad = vec![Link { now: f32::NAN, then: 0.5 }; 100];
        assert_eq!(align(&bad, last), last);
        let one = align(&vec![Link { now: 0.25, then: 0.5 }; 100], Alignment::default());
        assert!(one.scale.is_finite() && one.shift.is_finite());
    }

    #[test]
    fn noise_does_not_shrink_a_scale_over_a_long_stream() {
        let mut alignment = Alignment::default();
        for round in 0..60u32 {
            let noise = |i: usize, n: u32| {
                let mixed = (i as u32 + 5000 * n).wrapping_mul(2_654_435_761);
                ((mixed ^ (mixed >> 15)).wrapping_mul(2_246_822_519) >> 8) as f32 / 1.7e8 - 0.05
            };
            let mut found = links(2000, 1.0, 0.0);
            for (i, link) in found.iter_mut().enumerate() {
                let noisy = link.now + noise(i, 2 * round);
                link.then = alignment.scale.mul_add(noisy, alignment.shift).clamp(0.0, 1.0);
                link.now += noise(i, 2 * round + 1);
            }
            alignment = align(&found, alignment);
        }
        assert!((0.9..1.1).contains(&alignment.scale) && alignment.shift.abs() < 0.05, "{alignment:?}");
    }

    #[test]
    fn a_scene_of_a_few_flat_cards_is_aligned_as_well() {
        let cards = [0.2f32, 0.2, 0.2, 0.2, 0.2, 0.6, 0.75];
        let links: Vec<Link> = (0..700).map(|i| cards[i % 7]).map(|d| Link { now: 0.8 * d + 0.1, then: d }).collect();
        let found = align(&links, Alignment::default());
        let back = |d: f32| found.scale.mul_add(0.8 * d + 0.1, found.shift);
        assert!(cards.iter().all(|d| (back(*d) - d).abs() < 0.02), "{found:?}");
    }
}
