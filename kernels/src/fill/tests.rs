use super::*;
use crate::testing::noise;

/// An image whose drawn part is `drawn(x, y)`: colour times coverage, and coverage; on a background.
fn image(
    width: usize,
    height: usize,
    background: [f32; 3],
    drawn: impl Fn(usize, usize) -> Pixel,
) -> (Image, Vec<Pixel>) {
    let pixels: Vec<Pixel> = (0..width * height).map(|i| drawn(i % width, i / width)).collect();
    let rgb = (0..3).flat_map(|c| pixels.iter().map(move |p| p[c] + (1.0 - p[3]) * background[c])).collect();
    let alpha = Some(pixels.iter().map(|p| p[3]).collect());
    (Image { width, height, rgb, alpha, ..Image::default() }, pixels)
}

#[test]
fn what_is_covered_stays_and_nothing_is_the_background() {
    let background = [0.1, 0.2, 0.3];
    let (mut full, _) = image(7, 5, background, |x, y| [x as f32, y as f32, 0.5, 1.0]);
    let before = full.rgb.clone();
    assert_eq!(fill(&mut full, background), 0.0);
    assert_eq!(full.rgb, before);
    let (mut empty, _) = image(7, 5, background, |_, _| [0.0; 4]);
    assert_eq!(fill(&mut empty, background), 1.0);
    for (c, value) in background.iter().enumerate() {
        assert!(empty.rgb[c * 35..][..35].iter().all(|x| x == value));
    }
    let mut none = Image { alpha: Some(Vec::new()), ..Image::default() };
    assert_eq!(fill(&mut none, background), 0.0);
}

#[test]
fn an_edge_goes_on_with_its_own_colour() {
    // The left half is of one colour, the right of another; columns at both ends are missing, and a fringe is half
    // there.
    let sides = [[0.8, 0.1, 0.2], [0.0, 0.5, 1.0]];
    let drawn = |x: usize, _: usize| {
        let [r, g, b] = sides[usize::from(x >= 32)];
        let weight = match x {
            0..8 | 56.. => 0.0,
            8 => 0.5,
            _ => 1.0,
        };
        [r * weight, g * weight, b * weight, weight]
    };
    let (mut found, _) = image(64, 16, [0.5; 3], drawn);
    let share = fill(&mut found, [0.5; 3]);
    assert_eq!(share, 0.25);
    for c in 0..3 {
        let row = &found.rgb[c * 64 * 16 + 64 * 8..][..64];
        for (x, value) in row.iter().enumerate() {
            let expected = sides[usize::from(x >= 32)][c];
            assert!((value - expected).abs() < 0.02, "channel {c}, column {x}: {value}, expected {expected}");
        }
    }
}

#[test]
fn it_is_the_reference_within_rounding() {
    for (width, height) in [(1, 1), (1, 9), (13, 1), (17, 11), (32, 8)] {
        let background = [0.25, 0.5, 0.75];
        let holes: Vec<f32> = noise(width * height, 5).iter().map(|x| 0.5 * x + 0.5).collect();
        let (mut found, pixels) = image(width, height, background, |x, y| {
            let weight = (2.0 * holes[y * width + x] - 0.8).clamp(0.0, 1.0);
            [0.3 * weight, (x as f32 / width as f32) * weight, holes[y * width + x] * weight, weight]
        });
        fill(&mut found, background);
        let pixels: Vec<[f64; 4]> = pixels.iter().map(|p| p.map(f64::from)).collect();
        for y in 0..height {
            for x in 0..width {
                let expected = reference::filled(&pixels, width, height, background.map(f64::from), x, y);
                for (c, expected) in expected.into_iter().enumerate() {
                    let found = f64::from(found.rgb[(c * height + y) * width + x]);
                    assert!(
                        (found - expected).abs() < 2e-6,
                        "{width}×{height} at {x}, {y}: {found}, expected {expected}"
                    );
                }
            }
        }
    }
}

#[test]
fn any_number_of_threads_has_the_same_bits() {
    let drawn = |x: usize, y: usize| {
        let weight = if (x / 9 + y / 7).is_multiple_of(3) { 0.0 } else { 0.9 };
        [0.01 * x as f32 * weight, 0.02 * y as f32 * weight, 0.4 * weight, weight]
    };
    let filled = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (mut image, _) = image(101, 67, [0.5; 3], drawn);
        pool.install(|| fill(&mut image, [0.5; 3]));
        image.rgb.into_iter().map(f32::to_bits).collect::<Vec<_>>()
    };
    assert_eq!(filled(1), filled(3));
}
