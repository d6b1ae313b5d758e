use super::reference::{mean, transparent_mean};
use super::*;
use crate::testing::{noise, on_every_level_and_thread_count};

const SIZE: [usize; 2] = [181, 97];
const PIXELS: usize = SIZE[0] * SIZE[1];

/// Images with values from under 0 to above 1, small ones and exact ones among them.
fn images(count: u32) -> Vec<Image> {
    let special = [0.0, -0.0, 1.0, 0.04045, 0.003, 1e-30, 1e-42, -3.0, 5.0];
    (0..count)
        .map(|seed| {
            let alpha: Vec<f32> = noise(PIXELS, seed + 50).iter().map(|x| (x * 0.7 + 0.5).clamp(0.0, 1.0)).collect();
            let rgb = noise(3 * PIXELS, seed).into_iter().enumerate().map(|(i, x)| match i % 11 {
                0 => special[(i / 11 + seed as usize) % special.len()],
                _ => x * 0.8 + 0.5,
            });
            let rgb = rgb.enumerate().map(|(i, c)| c * alpha[i % PIXELS]).collect();
            let depth = Some(noise(PIXELS, seed + 90));
            Image { width: SIZE[0], height: SIZE[1], rgb, depth, alpha: Some(alpha), ..Image::default() }
        })
        .collect()
}

fn exposed(level: Level, transparent: bool, images: &[Image]) -> Image {
    let mut exposure = Exposure::new(level, transparent);
    images.iter().for_each(|image| exposure.add(image));
    exposure.mean()
}

#[test]
fn a_mean_has_the_same_bits_everywhere_and_is_that_of_the_formulas() {
    let images = images(7);
    for transparent in [false, true] {
        let found = on_every_level_and_thread_count(5 * PIXELS, |level, out| {
            let image = exposed(level, transparent, &images);
            out[..3 * PIXELS].copy_from_slice(&image.rgb);
            out[3 * PIXELS..4 * PIXELS].copy_from_slice(image.depth.as_ref().expect("a plane"));
            out[4 * PIXELS..].copy_from_slice(image.alpha.as_ref().expect("a plane"));
        });
        for (i, found) in found.iter().enumerate() {
            let at = i % PIXELS;
            let alpha = |image: &Image| image.alpha.as_ref().expect("a plane")[at];
            let expected = match i / PIXELS {
                3 => {
                    images.iter().map(|image| f64::from(image.depth.as_ref().expect("a plane")[at])).sum::<f64>() / 7.0
                }
                4 => images.iter().map(|image| f64::from(alpha(image))).sum::<f64>() / 7.0,
                _ if transparent => {
                    transparent_mean(&images.iter().map(|image| [image.rgb[i], alpha(image)]).collect::<Vec<_>>())
                }
                _ => mean(&images.iter().map(|image| image.rgb[i]).collect::<Vec<_>>()),
            };
            let error = (f64::from(*found) - expected).abs();
            assert!(error < 4e-6 * expected.abs().max(1.0), "{found}, expected {expected}, value {i}");
        }
    }
}

#[test]
fn images_that_are_all_alike_stay_as_they_are() {
    let image = &images(1)[0];
    let all = vec![image.clone(); 16];
    for transparent in [false, true] {
        let found = exposed(Level::detect(), transparent, &all);
        for (found, expected) in found.rgb.iter().zip(&image.rgb) {
            assert!((found - expected.max(0.0)).abs() < 4e-6 * expected.abs().max(1.0), "{found}, expected {expected}");
        }
    }
}

#[test]
fn half_of_the_light_is_not_half_of_the_value() {
    let flat = |c: f32| Image { width: 1, height: 1, rgb: vec![c; 3], ..Image::default() };
    let found = exposed(Level::detect(), false, &[flat(0.0), flat(1.0)]);
    assert!((found.rgb[0] - 0.735_357).abs() < 1e-5, "{}", found.rgb[0]);
}

#[test]
fn nothing_has_no_pixels_and_the_next_mean_begins_anew() {
    let mut exposure = Exposure::new(Level::detect(), false);
    assert_eq!(exposure.mean().rgb.len(), 0);
    let images = images(2);
    exposure.add(&images[0]);
    let first = exposure.mean();
    exposure.add(&images[1]);
    assert!(exposure.mean() != first);
    exposure.add(&images[0]);
    assert!(exposure.mean() == first);
}

#[test]
#[should_panic(expected = "images of one size")]
fn images_of_another_size_are_refused() {
    let mut exposure = Exposure::new(Level::detect(), false);
    exposure.add(&Image { width: 1, height: 1, rgb: vec![0.0; 3], ..Image::default() });
    exposure.add(&Image { width: 2, height: 1, rgb: vec![0.0; 6], ..Image::default() });
}
