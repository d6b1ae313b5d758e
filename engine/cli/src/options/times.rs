//! Requested times of a scene.

use streamsplat::scene::{Scene, SceneError};

use crate::console::failure::Failure;

/// Returns the times of images, each with the interval that shows it: `asked`, else `fps` a second, else the source's
/// frames. A time outside the scene is a usage error, found before any work.
pub fn of_scene(scene: &Scene, asked: Option<&[f64]>, fps: Option<f64>) -> Result<Vec<(f64, usize)>, Failure> {
    let times = match (asked, fps, scene.index().frames()) {
        (Some(times), ..) => times.to_vec(),
        (None, None, Some(frames)) => frames,
        (None, fps, _) => grid(scene.span(), fps.unwrap_or(scene.index().fps))?,
    };
    times.into_iter().map(|time| Ok((time, find(scene, "--times", time)?))).collect()
}

/// Returns the interval that shows the `time` of `option`.
pub fn find(scene: &Scene, option: &str, time: f64) -> Result<usize, Failure> {
    scene.find(time).map_err(|e| match e {
        SceneError::Time { .. } => Failure::usage(format!("{option}: {e}")),
        other => other.into(),
    })
}

/// Returns an error for an invalid frame rate.
pub fn check_rate(fps: Option<f64>) -> Result<(), Failure> {
    if fps.is_some_and(|fps| !(fps.is_finite() && fps > 0.0)) {
        return Err(Failure::usage("--fps: expected a number above 0"));
    }
    Ok(())
}

/// Returns times from the scene's start, `fps` to the second, up to its end. The end is included if it is within a
/// millionth of a step.
pub fn grid((start, end): (f64, f64), fps: f64) -> Result<Vec<f64>, Failure> {
    let steps = (end - start) * fps;
    if !(steps.is_finite() && steps < 1e7) {
        return Err(Failure::usage(format!("--fps {fps}: {steps} times are too many; give --times")));
    }
    let count = (steps + 1e-6) as usize;
    Ok((0..=count).map(|i| (start + i as f64 / fps).min(end)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_meets_both_ends() {
        assert_eq!(grid((0.0, 0.5), 4.0).expect("few"), [0.0, 0.25, 0.5]);
        assert_eq!(grid((1.0, 1.0), 24.0).expect("few"), [1.0]);
        assert_eq!(grid((0.0, 29.0 / 24.0), 24.0).expect("few").len(), 30);
        assert!(grid((0.0, 1e12), 24.0).is_err());
    }
}
