use super::{Eye, Gradients, MAX_DEGREE, adjoint, colours, reference, rest};
use crate::testing::{noise, on_every_level_and_thread_count};

fn triples(flat: &[f32]) -> Vec<[f32; 3]> {
    flat.as_chunks::<3>().0.to_vec()
}

#[test]
fn the_basis_is_orthonormal() {
    // Midpoints in the polar angle's cosine and in longitude: exact for products of degree 6.
    let (rows, columns) = (400, 64);
    let mut products = [[0.0; 16]; 16];
    for row in 0..rows {
        let z = -1.0 + (2 * row + 1) as f64 / rows as f64;
        let radius = (1.0 - z * z).sqrt();
        for column in 0..columns {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(column) / f64::from(columns)).sin_cos();
            let basis = reference::basis([radius * cos, radius * sin, z]);
            for (i, row) in products.iter_mut().enumerate() {
                row.iter_mut().zip(&basis).for_each(|(sum, b)| *sum += basis[i] * b);
            }
        }
    }
    let area = 4.0 * std::f64::consts::PI / (rows as f64 * f64::from(columns));
    for (i, row) in products.iter().enumerate() {
        for (j, sum) in row.iter().enumerate() {
            let expected = if i == j { 1.0 } else { 0.0 };
            assert!((sum * area - expected).abs() < 1e-4, "{i} {j}: {}", sum * area);
        }
    }
}

#[test]
fn colours_agree_with_their_formula_and_themselves_everywhere() {
    let n = 3 * super::TASK + 21;
    let mean = triples(&noise(3 * n, 1).iter().map(|x| 4.0 * x).collect::<Vec<_>>());
    let base = triples(&noise(3 * n, 2));
    for degree in 0..=MAX_DEGREE {
        let higher = noise(3 * n * rest(degree), 3);
        for eye in [Eye::At([0.3, -0.2, -5.0]), Eye::At(mean[5]), Eye::Along([0.6, 0.0, 0.8])] {
            let out = on_every_level_and_thread_count(3 * n, |level, out| {
                colours(level, degree, &base, &higher, &mean, eye, out.as_chunks_mut::<3>().0);
            });
            for i in 0..n {
                let own = triples(&higher[3 * rest(degree) * i..][..3 * rest(degree)]);
                let expected = reference::colour(degree, base[i], &own, mean[i], eye);
                for (channel, expected) in expected.iter().enumerate() {
                    let error = (f64::from(out[3 * i + channel]) - expected).abs();
                    assert!(error < 4e-6, "degree {degree}, {eye:?}, Gaussian {i}: {error:e} of {expected}");
                }
            }
        }
    }
}

#[test]
fn distances_do_not_matter() {
    let higher = noise(3 * rest(3), 4);
    for level in crate::testing::levels() {
        let at = |distance: f32| {
            let mut out = [[0.0; 3]];
            let mean = [[0.36 * distance, 0.48 * distance, 0.8 * distance]];
            colours(level, 3, &[[0.1; 3]], &higher, &mean, Eye::At([0.0; 3]), &mut out);
            out[0]
        };
        for distance in [1e-30, 1e-3, 1e10, 1e37] {
            for (a, b) in at(1.0).iter().zip(at(distance)) {
                assert!((a - b).abs() < 1e-5, "{distance:e}: {a} {b}");
            }
        }
    }
}

#[test]
fn a_bad_value_spoils_its_own_colour_only() {
    let n = 40;
    let (mean, base) = (triples(&noise(3 * n, 5)), triples(&noise(3 * n, 6)));
    let clean = noise(3 * n * rest(2), 7);
    let mut higher = clean.clone();
    higher[3 * rest(2) * 17] = f32::NAN;
    for level in crate::testing::levels() {
        let (mut out, mut expected) = (vec![[0.0; 3]; n], vec![[0.0; 3]; n]);
        colours(level, 2, &base, &higher, &mean, Eye::At([0.0; 3]), &mut out);
        colours(level, 2, &base, &clean, &mean, Eye::At([0.0; 3]), &mut expected);
        assert!(out[17][0].is_nan());
        (out[17], expected[17]) = ([0.0; 3], [0.0; 3]);
        assert_eq!(out, expected);
    }
}

/// The sum of a Gaussian's colours times `of`, of coefficients, centre and eye in binary64.
fn loss(degree: usize, coefficients: &[f64], mean: [f64; 3], eye: [f64; 3], of: &[f32]) -> f64 {
    let v: [f64; 3] = std::array::from_fn(|axis| mean[axis] - eye[axis]);
    let length = v.iter().map(|v| v * v).sum::<f64>().sqrt();
    let basis = reference::basis(v.map(|v| v / length));
    let channel = |c: usize| 0.5 + (0..=rest(degree)).map(|k| coefficients[3 * k + c] * basis[k]).sum::<f64>();
    (0..3).map(|c| channel(c).max(0.0) * f64::from(of[c])).sum()
}

#[test]
fn the_adjoint_is_that_of_finite_differences_everywhere() {
    let n = 2 * super::TASK + 5;
    let mean = triples(&noise(3 * n, 1));
    let (base, of) = (triples(&noise(3 * n, 2)), triples(&noise(3 * n, 3)));
    let eye = [0.3, -0.2, -1.5];
    for degree in 0..=MAX_DEGREE {
        let higher = noise(3 * n * rest(degree), 4);
        let width = 3 * rest(degree);
        let out = on_every_level_and_thread_count(6 * n + n * width + 6, |level, out| {
            let mut seen = vec![[0.0; 3]; n];
            colours(level, degree, &base, &higher, &mean, Eye::At(eye), &mut seen);
            let (first, rest) = out.split_at_mut(3 * n);
            let (second, rest) = rest.split_at_mut(3 * n);
            let (third, last) = rest.split_at_mut(n * width);
            second.fill(0.25);
            let [base, mean_to] = [first, second].map(|v| v.as_chunks_mut::<3>().0);
            let to = Gradients { base, higher: third, mean: mean_to };
            let of_eye = adjoint(level, degree, &higher, &mean, Eye::At(eye), &seen, &of, to);
            for (last, of) in last.chunks_mut(2).zip(of_eye) {
                last.copy_from_slice(&[of as f32, (of - f64::from(of as f32)) as f32]);
            }
        });
        let mut eyes = [0.0; 3];
        for i in (0..n).step_by(if degree == 3 { 1 } else { 7 }) {
            let own = &higher[i * width..][..width];
            let coefficients: Vec<f64> = base[i].iter().chain(own).map(|&c| f64::from(c)).collect();
            let (place, from) = (mean[i].map(f64::from), eye.map(f64::from));
            let step = 1e-6;
            let close = |what: &str, found: f32, above: f64, below: f64| {
                let expected = (above - below) / (2.0 * step);
                assert!(
                    (f64::from(found) - expected).abs() < 1e-5,
                    "{what} of {i}, degree {degree}: {found}, {expected}"
                );
                expected
            };
            for k in 0..coefficients.len() {
                let at = |change: f64| {
                    let mut moved = coefficients.clone();
                    moved[k] += change;
                    loss(degree, &moved, place, from, &of[i])
                };
                let found = if k < 3 { out[3 * i + k] } else { out[6 * n + i * width + k - 3] };
                close("coefficient", found, at(step), at(-step));
            }
            for axis in 0..3 {
                let at = |change: f64| {
                    let mut moved = place;
                    moved[axis] += change;
                    loss(degree, &coefficients, moved, from, &of[i])
                };
                eyes[axis] -= close("centre", out[3 * n + 3 * i + axis] - 0.25, at(step), at(-step));
            }
        }
        for (axis, expected) in eyes.iter().enumerate().take(if degree == 3 { 3 } else { 0 }) {
            let found = f64::from(out[6 * n + n * width + 2 * axis]);
            assert!((found - expected).abs() < 1e-3 * expected.abs().max(1.0), "eye: {found}, expected {expected}");
        }
    }
}
