//! Facts about a still scene that are not numbers of its Gaussians.

use super::Axes;

/// Metadata of a scene from its file, and notes on how it was read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct About {
    /// True if the scene was trained with anti-aliasing: splats smaller than a pixel are drawn fainter, not wider.
    pub antialiased: bool,
    /// Origin of the scene's coordinates: a Gaussian's position is its centre plus this. Nonzero where coordinates are
    /// so large that binary32 would round them, such as those of maps.
    pub offset: [f64; 3],
    /// Axes by which the file's numbers were interpreted.
    pub axes: Axes,
    /// True if the axes were assumed because the file declares none and its format allows several.
    pub axes_assumed: bool,
    /// Limits of a camera that orbits the scene.
    pub orbit: Option<Orbit>,
    /// Notes on skipped content and assumptions.
    pub notes: Vec<String>,
}

impl About {
    /// Notes for the user on how the file was read, one per line.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = self.notes.clone();
        if self.axes_assumed {
            let axes = self.axes;
            lines.push(format!(
                "the file does not say its axes: taken as {axes}, as its format's description has it; --axes rdf where another program \
                 stored PLY's numbers as they are"
            ));
        }
        lines
    }
}

/// Limits of a camera that orbits a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// Least and greatest angle above the horizon, in radians.
    pub elevation: [f32; 2],
    /// Least distance from the middle.
    pub radius: f32,
}

impl Orbit {
    /// Returns true if the limits are set: a range of elevations below the zenith, and a distance. Programs write zeros
    /// where they are not.
    pub(super) fn is_set(&self) -> bool {
        let [least, most] = self.elevation;
        let steepest = 0.49 * std::f32::consts::PI;
        -steepest <= least && least < most && most <= steepest && (0.0..1e9).contains(&self.radius)
    }
}
