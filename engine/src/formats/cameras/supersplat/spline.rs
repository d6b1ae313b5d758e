//! The curve on which SuperSplat's viewer moves its camera.
//!
//! A cubic Hermite spline through the points `p_i` at `t_i`, with tangents
//!
//! ```text
//! m_i = s · (p_{i+1} − p_{i−1}) / (t_{i+1} − t_{i−1})        s: smoothness; one-sided at either end
//! ```
//!
//! The animation is a loop: copies of its last two points precede the first point, and copies of its first two follow
//! the last, shifted in time by the animation's length.

/// Components of a point: position, target, field of view.
type Point = [f64; 7];

pub(super) struct Spline {
    times: Vec<f64>,
    points: Vec<Point>,
    /// Per unit of time.
    tangents: Vec<Point>,
}

impl Spline {
    /// Returns the curve through points at increasing times, closed after `length`.
    pub(super) fn looping(length: f64, times: &[f64], points: &[Point], smoothness: f64) -> Self {
        let (mut times, mut points) = (times.to_vec(), points.to_vec());
        let n = times.len();
        if n >= 2 {
            let before = [times[n - 2] - length, times[n - 1] - length];
            let after = [times[0] + length, times[1] + length];
            times = [&before[..], &times, &after].concat();
            points = [&points[n - 2..], &points, &points[..2]].concat();
        }
        let tangents = (0..times.len()).map(|i| {
            let (a, b) = (i.saturating_sub(1), (i + 1).min(times.len() - 1));
            let span = times[b] - times[a];
            std::array::from_fn(|k| if a == b { 0.0 } else { smoothness * (points[b][k] - points[a][k]) / span })
        });
        let tangents = tangents.collect();
        Self { times, points, tangents }
    }

    pub(super) fn at(&self, time: f64) -> Point {
        let last = self.times.len() - 1;
        if time <= self.times[0] {
            return self.points[0];
        }
        if time >= self.times[last] {
            return self.points[last];
        }
        let i = (0..last).find(|i| time < self.times[i + 1]).unwrap_or(last - 1);
        let span = self.times[i + 1] - self.times[i];
        let t = (time - self.times[i]) / span;
        let s = 1.0 - t;
        std::array::from_fn(|k| {
            self.points[i][k] * ((1.0 + 2.0 * t) * s * s)
                + self.tangents[i][k] * span * (t * s * s)
                + self.points[i + 1][k] * (t * t * (3.0 - 2.0 * t))
                + self.tangents[i + 1][k] * span * (t * t * (t - 1.0))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_smoothness_a_segment_eases_from_point_to_point() {
        let spline = Spline::looping(20.0, &[0.0, 10.0], &[[0.0; 7], [8.0; 7]], 0.0);
        assert_eq!([0.0, 2.5, 5.0, 10.0].map(|t| spline.at(t)[0]), [0.0, 1.25, 4.0, 8.0]);
        assert_eq!(spline.at(15.0)[0], 4.0);
    }

    #[test]
    fn points_on_a_line_at_even_times_stay_on_it() {
        let points: Vec<Point> = (0..4).map(|i| [f64::from(i); 7]).collect();
        let spline = Spline::looping(30.0, &[0.0, 10.0, 20.0, 30.0], &points, 1.0);
        assert!((spline.at(13.0)[0] - 1.3).abs() < 1e-12);
    }
}
