//! [`fill`](super::fill) in binary64, without a pyramid in memory: each level is a function of the pixel's position.

/// The colour of the pixel at column `x`, row `y` of an image of `width` × `height` pixels `[colour × coverage,
/// coverage]`.
pub fn filled(pixels: &[[f64; 4]], width: usize, height: usize, background: [f64; 3], x: usize, y: usize) -> [f64; 3] {
    let image = Pulled { pixels, width, height };
    image.filled(0, x, y, background)
}

struct Pulled<'a> {
    pixels: &'a [[f64; 4]],
    width: usize,
    height: usize,
}

impl Pulled<'_> {
    /// Width and height of a level.
    fn size(&self, level: u32) -> [usize; 2] {
        [self.width, self.height].map(|side| side.div_ceil(1 << level))
    }

    fn at(&self, level: u32, x: usize, y: usize) -> [f64; 4] {
        if level == 0 {
            return self.pixels[y * self.width + x];
        }
        let [width, height] = self.size(level - 1);
        let mut sum = [0.0; 4];
        for row in 2 * y..(2 * y + 2).min(height) {
            for column in 2 * x..(2 * x + 2).min(width) {
                let pixel = self.at(level - 1, column, row);
                sum = std::array::from_fn(|i| sum[i] + pixel[i]);
            }
        }
        if sum[3] > 1.0 { sum.map(|value| value / sum[3]) } else { sum }
    }

    fn filled(&self, level: u32, x: usize, y: usize, background: [f64; 3]) -> [f64; 3] {
        let [red, green, blue, weight] = self.at(level, x, y);
        if self.size(level) == [1, 1] {
            return if weight > 0.0 { [red, green, blue].map(|value| value / weight) } else { background };
        }
        if weight >= 1.0 {
            return [red, green, blue];
        }
        let sides = self.size(level + 1);
        let share = |place: usize, side: usize| {
            let near = place / 2;
            let far = if place.is_multiple_of(2) { near.saturating_sub(1) } else { (near + 1).min(side - 1) };
            [(near, 0.75), (far, 0.25)]
        };
        let mut up = [0.0; 3];
        for (row, down) in share(y, sides[1]) {
            for (column, across) in share(x, sides[0]) {
                let above = self.filled(level + 1, column, row, background);
                up = std::array::from_fn(|i| up[i] + down * across * above[i]);
            }
        }
        std::array::from_fn(|i| [red, green, blue][i] + (1.0 - weight) * up[i])
    }
}
