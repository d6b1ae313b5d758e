//! Still scenes made from drawn values.

use streamsplat_kernels::harmonics;

use super::{Still, first_of, log_of, logit_of};

/// Default limit on the Gaussians of a scene.
pub const GAUSSIANS: usize = 1 << 24;
/// Highest degree of harmonics.
const DEGREE: usize = 3;

/// Values of Gaussians in the form that renderers use. `rotation` may be empty: then no Gaussian is rotated.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Values {
    /// Centres.
    pub mean: Vec<[f32; 3]>,
    /// Standard deviations along the Gaussian's own axes, not below 0.
    pub scale: Vec<[f32; 3]>,
    /// Quaternions (w, x, y, z) of any length but 0.
    pub rotation: Vec<[f32; 4]>,
    /// Opacities in [0, 1].
    pub opacity: Vec<f32>,
    /// Colours, the same from every direction; empty if `harmonics` has them.
    pub rgb: Vec<[f32; 3]>,
    /// Degree of `harmonics`, 0 to 3.
    pub degree: usize,
    /// Coefficients of the harmonics, including the first: `[N, (degree + 1)², 3]`; empty if `rgb` has the colours.
    pub harmonics: Vec<[f32; 3]>,
}

/// Why values do not form a scene.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ValuesError {
    /// An array whose length does not fit the centres.
    #[error("{array}: expected {expected} rows for {gaussians} Gaussians, found {found}")]
    Length {
        /// The array.
        array: &'static str,
        /// Rows required for this number of centres.
        expected: usize,
        /// Number of centres.
        gaussians: usize,
        /// Rows found.
        found: usize,
    },
    /// More Gaussians than a scene can have.
    #[error("mean: expected at most {GAUSSIANS} Gaussians, found {0}")]
    Many(usize),
    /// An unsupported degree of harmonics.
    #[error("harmonics: expected a degree from 0 to {DEGREE}, found {0}")]
    Degree(usize),
    /// A value that is not finite or out of range.
    #[error("{array}: expected {expected}, found {found} at Gaussian {gaussian}")]
    Value {
        /// The array.
        array: &'static str,
        /// The range.
        expected: &'static str,
        /// The Gaussian.
        gaussian: usize,
        /// The value.
        found: f32,
    },
}

impl Still {
    /// Makes a scene from these values, stored as in files: logarithms of scales, which are at least 10⁻¹², logits of
    /// opacities, which have at least that distance from 0 and 1, and coefficients of harmonics, for colours `(rgb − ½)
    /// / Y₀`.
    ///
    /// # Errors
    /// Lengths that do not match, more than 2²⁴ Gaussians, numbers that are not finite or out of range, and the
    /// quaternion 0.
    pub fn of_values(values: Values) -> Result<Still, ValuesError> {
        let gaussians = values.mean.len();
        if gaussians > GAUSSIANS {
            return Err(ValuesError::Many(gaussians));
        }
        if values.degree > DEGREE {
            return Err(ValuesError::Degree(values.degree));
        }
        let each = 1 + harmonics::rest(values.degree);
        let has = |empty: bool, rows: usize| if empty { 0 } else { rows };
        let by_harmonics = !values.harmonics.is_empty() || values.degree > 0;
        for (array, found, expected) in [
            ("scale", values.scale.len(), gaussians),
            ("rotation", values.rotation.len(), has(values.rotation.is_empty(), gaussians)),
            ("opacity", values.opacity.len(), gaussians),
            ("rgb", values.rgb.len(), has(by_harmonics, gaussians)),
            ("harmonics", values.harmonics.len(), has(!by_harmonics, gaussians * each)),
        ] {
            if found != expected {
                return Err(ValuesError::Length { array, expected, gaussians, found });
            }
        }
        let finite = |x: f32| x.is_finite();
        check("mean", "finite numbers", values.mean.as_flattened(), 3, finite)?;
        check("scale", "finite numbers from 0 on", values.scale.as_flattened(), 3, |s| s.is_finite() && s >= 0.0)?;
        check("rotation", "finite numbers", values.rotation.as_flattened(), 4, finite)?;
        check("opacity", "numbers from 0 to 1", &values.opacity, 1, |o| (0.0..=1.0).contains(&o))?;
        check("rgb", "finite numbers", values.rgb.as_flattened(), 3, finite)?;
        check("harmonics", "finite numbers", values.harmonics.as_flattened(), 3 * each, finite)?;
        if let Some(gaussian) = values.rotation.iter().position(|q| *q == [0.0; 4]) {
            let expected = "quaternions other than 0";
            return Err(ValuesError::Value { array: "rotation", expected, gaussian, found: 0.0 });
        }
        let Values { mean, scale, rotation, opacity, rgb, degree, harmonics } = values;
        let rows = harmonics.chunks_exact(each);
        let (base, higher) = if by_harmonics {
            (rows.clone().map(|row| row[0]).collect(), rows.flat_map(|row| row[1..].as_flattened()).copied().collect())
        } else {
            (rgb.iter().map(|rgb| rgb.map(first_of)).collect(), Vec::new())
        };
        Ok(Still {
            log_scale: scale.iter().map(|s| s.map(log_of)).collect(),
            logit: opacity.iter().map(|o| logit_of(*o)).collect(),
            rotation: if rotation.is_empty() { vec![[1.0, 0.0, 0.0, 0.0]; gaussians] } else { rotation },
            mean,
            base,
            degree,
            higher,
            ..Still::default()
        })
    }
}

/// Returns an error for the first wrong number, in rows of `width`.
fn check(
    array: &'static str,
    expected: &'static str,
    numbers: &[f32],
    width: usize,
    holds: impl Fn(f32) -> bool,
) -> Result<(), ValuesError> {
    match numbers.iter().position(|x| !holds(*x)) {
        Some(place) => Err(ValuesError::Value { array, expected, gaussian: place / width, found: numbers[place] }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::still::Drawable;
    use crate::stream::Workers;
    use streamsplat_kernels::Level;

    fn values() -> Values {
        Values {
            mean: vec![[0.0, 1.0, 2.0], [-1.0, 0.5, 3.0]],
            scale: vec![[0.1, 0.2, 0.3], [0.0, 1.0, 2.0]],
            rotation: vec![[2.0, 0.0, 0.0, 0.0], [0.0, 0.6, 0.8, 0.0]],
            opacity: vec![0.25, 1.0],
            rgb: vec![[0.1, 0.5, 0.9], [0.0, 1.0, 0.5]],
            ..Values::default()
        }
    }

    #[test]
    fn values_come_back_as_they_are_drawn() {
        let workers = Workers::new(Level::detect(), 1).expect("a thread");
        let scene = Drawable::new(Still::of_values(values()).expect("a scene"), &workers).expect("even arrays");
        let near = |a: f32, b: f32| (a - b).abs() <= 1e-6 * b.abs().max(1e-5);
        assert!(scene.scale().iter().zip(&values().scale).all(|(a, b)| (0..3).all(|k| near(a[k], b[k]))));
        assert!(scene.opacity().iter().zip(&values().opacity).all(|(a, b)| near(*a, *b)));
        assert_eq!(
            (scene.rotation(0), scene.rotation(1)[2]),
            ([1.0, 0.0, 0.0, 0.0], f64::from(0.8_f32) / scene_length())
        );
        let harmonics = (0..8).map(|i| [i as f32, 0.5, -0.25]).collect();
        let still = Still::of_values(Values { rgb: Vec::new(), degree: 1, harmonics, ..values() }).expect("harmonics");
        assert_eq!((still.base[1], &still.higher[..6]), ([4.0, 0.5, -0.25], &[1.0, 0.5, -0.25, 2.0, 0.5, -0.25][..]));
        assert_eq!(still.uneven(), None);
        assert!(Still::of_values(Values::default()).expect("none").is_empty());
    }

    /// Length of the second quaternion in binary64.
    fn scene_length() -> f64 {
        let [a, b] = [0.6_f32, 0.8].map(f64::from);
        (a * a + b * b).sqrt()
    }

    #[test]
    fn wrong_values_are_named() {
        let error = |change: &dyn Fn(&mut Values)| {
            let mut values = values();
            change(&mut values);
            Still::of_values(values).expect_err("wrong").to_string()
        };
        let nan = f32::NAN;
        assert_eq!(error(&|v| v.scale.truncate(1)), "scale: expected 2 rows for 2 Gaussians, found 1");
        assert_eq!(error(&|v| v.rgb = Vec::new()), "rgb: expected 2 rows for 2 Gaussians, found 0");
        assert_eq!(error(&|v| v.degree = 1), "rgb: expected 0 rows for 2 Gaussians, found 2");
        assert_eq!(error(&|v| v.degree = 4), "harmonics: expected a degree from 0 to 3, found 4");
        assert_eq!(error(&|v| v.mean[1][2] = nan), "mean: expected finite numbers, found NaN at Gaussian 1");
        assert_eq!(
            error(&|v| v.scale[1][0] = -1.0),
            "scale: expected finite numbers from 0 on, found -1 at Gaussian 1"
        );
        assert_eq!(error(&|v| v.opacity[0] = 1.5), "opacity: expected numbers from 0 to 1, found 1.5 at Gaussian 0");
        let none = error(&|v| v.rotation[1] = [0.0; 4]);
        assert_eq!(none, "rotation: expected quaternions other than 0, found 0 at Gaussian 1");
    }

    #[test]
    fn every_format_is_read_from_memory_and_other_bytes_are_named() {
        use crate::formats::{FORMATS, Limits, Options, read};

        let workers = Workers::new(Level::detect(), 1).expect("a thread");
        let scene = Drawable::new(Still::of_values(values()).expect("a scene"), &workers).expect("even arrays");
        for format in &FORMATS {
            let file = (format.still)(&scene, &Options::default()).bytes;
            let found = read(&file, &format!("a.{}", format.ending), &Limits::default()).expect(format.name);
            assert_eq!(found.len(), 2, "{}", format.name);
            if format.option != "splat" {
                assert_eq!(Still::read(&file).expect(format.name), found, "{}", format.name);
            }
        }
        let ply = (FORMATS[0].still)(&scene, &Options::default()).bytes;
        assert_eq!(Still::read(&ply).expect("PLY"), *scene.still());
        let error = Still::read(b"hello").expect_err("text").to_string();
        assert!(error.starts_with("scene in memory: expected a still scene (PLY, "), "{error}");
        assert!(error.ends_with("found 5 bytes that begin with [68 65 6c 6c 6f]"), "{error}");
        assert!(Still::read(&ply[..ply.len() - 1]).is_err() && Still::read(b"").is_err());
    }

    #[test]
    fn too_many_gaussians_are_refused_before_memory_is_taken() {
        let mean = vec![[0.0; 3]; GAUSSIANS + 1];
        let error = Still::of_values(Values { mean, ..Values::default() }).expect_err("too many");
        assert_eq!(error, ValuesError::Many((1 << 24) + 1));
    }
}
