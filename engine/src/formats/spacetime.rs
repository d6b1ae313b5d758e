//! PLY files of SpacetimeGaussians: Gaussians that move, turn and fade over time.
//!
//! In addition to the columns of a still scene ([`mod@ply`]), each Gaussian has
//!
//! | column | value |
//! |---|---|
//! | `trbf_center`, `trbf_scale` | the time c of its highest opacity, and the logarithm of its duration |
//! | `motion_0` … `motion_8` | the coefficients m₁, m₂, m₃ of its path, three axes each |
//! | `omega_0` … `omega_3` | change ω of its quaternion; absent: 0 |
//!
//! At the time t, with d = t − c:
//!
//! ```text
//! centre = p + m₁·d + m₂·d² + m₃·d³        rotation = q + ω·d, to length 1        opacity = o·e^−(d / e^s)²
//! ```
//!
//! computed in binary64 and rounded once. Times are those of the training: 0 is its first frame and 1 the end of the
//! clip.
//!
//! SpacetimeGaussians writes `f_dc_0` … `f_dc_2` as displayed colours, not as harmonics. If more than a tenth of these
//! numbers are negative, which colours never are, they are read as the harmonics' first coefficients. The full model
//! computes colours from `f_dc_3` …, `f_t_*` and the ray direction with a small network, which PLY files do not
//! contain. These columns are skipped with a note.
//!
//! Source: Li, Chen, Li, Xu (CVPR 2024), equations 5 to 9, and the program published with it, which stores s as a
//! logarithm.

use streamsplat_kernels::harmonics::Y0;
use streamsplat_kernels::math::f64::{exp, ln};

use super::ply::{Column, columns};
use super::{FormatError, Limits, ply};
use crate::still::{LEAST, Still};

/// The name of the format.
pub(crate) const NAME: &str = "PLY of SpacetimeGaussians";
/// Columns of this format; a file without them is a still scene.
const WANTED: [&str; 11] = [
    "trbf_center",
    "trbf_scale",
    "motion_0",
    "motion_1",
    "motion_2",
    "motion_3",
    "motion_4",
    "motion_5",
    "motion_6",
    "motion_7",
    "motion_8",
];
const TURN: [&str; 4] = ["omega_0", "omega_1", "omega_2", "omega_3"];

/// Gaussians that move, turn and fade.
#[derive(Clone, Debug)]
pub struct Spacetime {
    /// The values of the file that do not depend on time.
    base: Still,
    centre: Vec<f32>,
    /// Logarithms.
    width: Vec<f32>,
    motion: Vec<[f32; 9]>,
    omega: Vec<[f32; 4]>,
    /// Notes on the interpretation of the file.
    notes: Vec<String>,
}

/// Returns true if the header of a PLY file, given by its first bytes, has a column that only this format has.
pub(crate) fn is(head: &[u8]) -> bool {
    let head = &head[..head.len().min(ply::MAX_HEADER)];
    head.starts_with(b"ply")
        && head.split(|byte| *byte == b'\n').any(|line| line.trim_ascii_end().ends_with(b" trbf_center"))
}

/// Reads the Gaussians of a whole file.
///
/// # Errors
/// Those of [`ply::read`], and a column that is missing or not a float.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<Spacetime, FormatError> {
    let mut base = ply::within(bytes, limits)?;
    let mut all = columns(bytes, &[&WANTED[..], &TURN[..]].concat())?;
    let turns = all.split_off(WANTED.len());
    let others = all.split_off(2);
    let missing =
        |name: &str| FormatError::new(format!("property {name}"), "it as a float of 16, 32 or 64 bits", "none");
    let whole = |list: Vec<Column>, names: &[&str]| -> Result<Vec<Vec<f32>>, FormatError> {
        list.into_iter().zip(names).map(|(column, name)| column.ok_or_else(|| missing(name))).collect()
    };
    let [centre, width] = <[Vec<f32>; 2]>::try_from(whole(all, &WANTED)?).unwrap_or_default();
    let ways = whole(others, &WANTED[2..])?;
    let turns = if turns.iter().all(Option::is_none) { vec![vec![0.0; base.len()]; 4] } else { whole(turns, &TURN)? };
    let count = base.len();
    let motion = (0..count).map(|i| std::array::from_fn(|k| ways[k][i])).collect();
    let omega = (0..count).map(|i| std::array::from_fn(|k| turns[k][i])).collect();
    let mut notes = Vec::new();
    let negative = base.base.as_flattened().iter().filter(|c| **c < 0.0).count();
    if 10 * negative > 3 * count || base.degree > 0 {
        notes.push("f_dc is taken as harmonics, since colours are not negative".to_owned());
    } else {
        base.base.iter_mut().for_each(|c| *c = c.map(|c| ((f64::from(c) - 0.5) / Y0) as f32));
    }
    let features = columns(bytes, &["f_dc_3", "f_t_0"])?;
    if features.iter().any(Option::is_some) {
        notes.push(
            "f_dc_3 to f_dc_5 and f_t_* are left out: the network that makes colours of them is in no PLY file"
                .to_owned(),
        );
    }
    Ok(Spacetime { base, centre, width, motion, omega, notes })
}

impl Spacetime {
    /// Returns the number of Gaussians.
    pub fn len(&self) -> usize {
        self.base.len()
    }

    /// Returns true if there is none.
    pub fn is_empty(&self) -> bool {
        self.base.is_empty()
    }

    /// Returns a note on the times at which something is visible.
    pub(crate) fn about(&self) -> String {
        let [first, last] = self.span().unwrap_or_default();
        format!("Gaussians in time, most opaque from {first} to {last}: taken at 0, or at --times")
    }

    /// Returns notes on the interpretation of the file.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns the times at which the first and the last Gaussian are most opaque; `None` if no time is finite.
    pub fn span(&self) -> Option<[f32; 2]> {
        let finite = self.centre.iter().filter(|c| c.is_finite());
        finite.fold(None, |span: Option<[f32; 2]>, &c| {
            let [first, last] = span.unwrap_or([c, c]);
            Some([first.min(c), last.max(c)])
        })
    }

    /// Returns the still scene at a time.
    pub fn at(&self, time: f64) -> Still {
        let mut still = self.base.clone();
        for i in 0..self.len() {
            let d = time - f64::from(self.centre[i]);
            let m = self.motion[i].map(f64::from);
            still.mean[i] = std::array::from_fn(|axis| {
                let way = m[axis] * d + m[3 + axis] * (d * d) + m[6 + axis] * (d * d * d);
                (f64::from(self.base.mean[i][axis]) + way) as f32
            });
            still.rotation[i] =
                std::array::from_fn(|k| (f64::from(self.base.rotation[i][k]) + f64::from(self.omega[i][k]) * d) as f32);
            still.logit[i] = faded(self.base.logit[i], d, self.width[i]);
        }
        still
    }
}

/// Returns the logit of an opacity at the distance `d` from its time.
fn faded(logit: f32, d: f64, width: f32) -> f32 {
    let x = f64::from(logit);
    if d == 0.0 || x.is_nan() {
        return logit;
    }
    let opacity = 1.0 / (1.0 + exp(-x.clamp(-200.0, 200.0)));
    let far = d / exp(f64::from(width).clamp(-200.0, 200.0));
    let opacity = (opacity * exp(-(far * far).min(700.0))).clamp(LEAST, 1.0 - LEAST);
    (ln(opacity) - ln(1.0 - opacity)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Builds a text file of Gaussians whose format-specific columns, appended to a still scene's, are these.
    fn file(own: &str, values: &[&str]) -> Vec<u8> {
        let still = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
        let header: String =
            still.split(' ').chain(own.split_whitespace()).map(|name| format!("property float {name}\n")).collect();
        let rows: String = values.iter().map(|row| format!("{row}\n")).collect();
        format!("ply\nformat ascii 1.0\nelement vertex {}\n{header}end_header\n{rows}", values.len()).into_bytes()
    }

    const OWN: &str = "trbf_center trbf_scale motion_0 motion_1 motion_2 motion_3 motion_4 motion_5 motion_6 motion_7 motion_8 omega_0 omega_1 omega_2 omega_3";
    const ROW: &str = "1 2 3 0.5 0.25 1 0 -1 -2 -3 1 0 0 0  0.5 -1  1 2 3 10 20 30 100 200 300  0 0 1 0";

    #[test]
    fn a_gaussian_is_where_its_polynomial_says_and_as_opaque_as_its_window() {
        let bytes = file(OWN, &[ROW]);
        assert!(is(&bytes) && !is(&file("", &["0 0 0 0 0 0 0 0 0 0 1 0 0 0"])));
        let scene = read(&bytes, &Limits::default()).expect("a file");
        let middle = scene.at(0.5);
        assert_eq!((middle.mean[0], middle.rotation[0], middle.logit[0]), ([1.0, 2.0, 3.0], [1.0, 0.0, 0.0, 0.0], 0.0));
        assert!((middle.base[0][1] + (0.25 / Y0) as f32).abs() < 1e-6 && middle.base[0][0] == 0.0);
        let later = scene.at(1.0);
        assert_eq!(later.mean[0], [1.0 + 0.5 + 2.5 + 12.5, 2.0 + 31.0, 3.0 + 46.5]);
        assert_eq!(later.rotation[0], [1.0, 0.0, 0.5, 0.0]);
        // e^−(d / e^s)² of a half.
        let expected = 0.5 * exp(-0.25 * exp(2.0));
        let found = 1.0 / (1.0 + exp(-f64::from(later.logit[0])));
        assert!((found - expected).abs() < 1e-7, "{found} {expected}");
        assert_eq!(scene.at(0.0).logit, later.logit);
        assert_eq!((scene.span(), scene.notes().len()), (Some([0.5, 0.5]), 0));
        // Far away the opacity is about 0, and no value is NaN.
        assert!(scene.at(1e300).logit[0] < -27.0 && scene.at(-50.0).logit[0].is_finite());
    }

    #[test]
    fn negative_numbers_are_no_colours_and_features_are_named() {
        let rows = [ROW.replace("0.5 0.25 1 0", "-1.5 0.25 1 0"), ROW.replace("0.5 0.25 1 0", "-1 -1 1 0")];
        let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
        let scene = read(&file(OWN, &rows), &Limits::default()).expect("a file");
        assert_eq!(scene.at(0.5).base[0], [-1.5, 0.25, 1.0]);
        assert!(scene.notes()[0].contains("harmonics"));
        let row = format!("{ROW} 9 9");
        let scene = read(&file(&format!("{OWN} f_dc_3 f_t_0"), &[&row]), &Limits::default()).expect("a file");
        assert!(scene.notes()[0].contains("f_t_*"), "{:?}", scene.notes());
    }

    #[test]
    fn a_column_that_is_missing_is_named() {
        for name in ["trbf_scale", "motion_8", "omega_2"] {
            let (columns, row) = (OWN.replace(&format!(" {name}"), ""), ROW.rsplit_once(' ').expect("numbers").0);
            let error = read(&file(&columns, &[row]), &Limits::default()).expect_err("missing").to_string();
            assert!(error.starts_with(&format!("property {name}: expected it as a float")), "{error}");
        }
        let still = OWN.split(" omega").next().expect("columns");
        let row = ROW.rsplit_once("  ").expect("numbers").0;
        let scene = read(&file(still, &[row]), &Limits::default()).expect("without turns");
        assert_eq!(scene.at(1.0).rotation[0], [1.0, 0.0, 0.0, 0.0]);
    }
}
