//! The same in binary64, straight from the formula.

use super::{Eye, rest};

/// The colour of one Gaussian, with `higher` its [`rest`]`(degree)` coefficients above the first.
pub fn colour(degree: usize, base: [f32; 3], higher: &[[f32; 3]], mean: [f32; 3], eye: Eye) -> [f64; 3] {
    let direction = match eye {
        Eye::Along(d) => d.map(f64::from),
        Eye::At(eye) => {
            let v: [f64; 3] = std::array::from_fn(|i| f64::from(mean[i]) - f64::from(eye[i]));
            let length = v.iter().map(|v| v * v).sum::<f64>().sqrt();
            if length > 0.0 { v.map(|v| v / length) } else { [0.0; 3] }
        }
    };
    let basis = basis(direction);
    std::array::from_fn(|channel| {
        let higher = (0..rest(degree)).map(|k| f64::from(higher[k][channel]) * basis[k + 1]);
        (0.5 + f64::from(base[channel]) * basis[0] + higher.sum::<f64>()).max(0.0)
    })
}

/// Y₀ … Y₁₅ of a direction.
pub fn basis([x, y, z]: [f64; 3]) -> [f64; 16] {
    let pi = std::f64::consts::PI;
    let root = |numerator: f64, denominator: f64| (numerator / (denominator * pi)).sqrt();
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        root(1.0, 4.0),
        -root(3.0, 4.0) * y,
        root(3.0, 4.0) * z,
        -root(3.0, 4.0) * x,
        root(15.0, 4.0) * x * y,
        -root(15.0, 4.0) * y * z,
        root(5.0, 16.0) * (2.0 * zz - xx - yy),
        -root(15.0, 4.0) * x * z,
        root(15.0, 16.0) * (xx - yy),
        -root(35.0, 32.0) * y * (3.0 * xx - yy),
        root(105.0, 4.0) * x * y * z,
        -root(21.0, 32.0) * y * (4.0 * zz - xx - yy),
        root(7.0, 16.0) * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -root(21.0, 32.0) * x * (4.0 * zz - xx - yy),
        root(105.0, 16.0) * z * (xx - yy),
        -root(35.0, 32.0) * x * (xx - 3.0 * yy),
    ]
}
