//! Depth in the colour camera's view, for sensors with two cameras at different positions.

use std::path::Path;

use anyhow::{Context, Result};
use serde::Deserialize;

/// From the depth camera to the colour camera: `p ↦ R·p + t`, in millimetres, x right, y down, z ahead. Both look
/// through the middle of the picture.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Registration {
    /// Source of the numbers.
    #[expect(dead_code, reason = "for readers of the file")]
    about: String,
    /// Focal lengths, in longer sides of the picture.
    depth_focal: f64,
    colour_focal: f64,
    /// R, by rows.
    rotation: [[f64; 3]; 3],
    /// t
    translation: [f64; 3],
}

impl Registration {
    pub(super) fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
        serde_json::from_str(&text).with_context(|| path.display().to_string())
    }

    /// Inverse depth in 1/mm `[H, W]`, NaN where there is none, moved to the colour camera's pixels. Each value is
    /// written to the four pixels around its position; the nearest value counts.
    pub(super) fn apply(&self, inverse: &[f32], [height, width]: [usize; 2]) -> Vec<f32> {
        let mut out = vec![f32::NAN; inverse.len()];
        let longer = height.max(width) as f64;
        let middle = [(width as f64 - 1.0) * 0.5, (height as f64 - 1.0) * 0.5];
        for (i, value) in inverse.iter().enumerate().filter(|(_, value)| **value > 0.0) {
            let z = 1.0 / f64::from(*value);
            let ray = |at: usize, axis: usize| (at as f64 - middle[axis]) / (self.depth_focal * longer) * z;
            let p = [ray(i % width, 0), ray(i / width, 1), z];
            let to = |axis: usize| {
                self.rotation[axis].iter().zip(p).fold(self.translation[axis], |sum, (r, p)| r.mul_add(p, sum))
            };
            let moved = [to(0), to(1), to(2)];
            let at = |axis: usize| moved[axis] / moved[2] * self.colour_focal * longer + middle[axis];
            let (x, y) = (at(0).floor(), at(1).floor());
            for (x, y) in [(x, y), (x + 1.0, y), (x, y + 1.0), (x + 1.0, y + 1.0)] {
                if moved[2] > 0.0 && x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64 {
                    let pixel = &mut out[y as usize * width + x as usize];
                    // The larger of two, or the one that is a number.
                    *pixel = pixel.max((1.0 / moved[2]) as f32);
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_camera_sees_the_same_depth_and_one_to_the_left_sees_it_to_the_right() {
        let same = Registration {
            about: String::new(),
            depth_focal: 1.0,
            colour_focal: 1.0,
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0; 3],
        };
        let size = [4, 8];
        let mut inverse = vec![0.001f32; 32];
        inverse[9] = f32::NAN;
        let seen = same.apply(&inverse, size);
        // The hole is filled by its neighbours' footprints alone.
        assert_eq!(seen, vec![0.001; 32]);
        // An object at one metre is moved by 250 mm · 8 px / 1000 mm.
        let moved = Registration { translation: [250.0, 0.0, 0.0], ..same };
        let mut thing = vec![f32::NAN; 32];
        thing[9] = 0.001;
        let seen = moved.apply(&thing, size);
        assert!((seen[11] - 0.001).abs() < 1e-9 && seen[9].is_nan(), "{seen:?}");
    }

    #[test]
    fn the_file_of_seven_scenes_is_read() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("sensors/seven-scenes.json");
        assert!(Registration::read(&path).is_ok());
    }
}
