//! The rasteriser against a binary64 oracle written in Python from the same equations (`fixtures/oracle/raster.py`).

use safetensors::SafeTensors;
use streamsplat_kernels::Level;
use streamsplat_kernels::raster::{Image, reference, render};
use streamsplat_tests::splats::Splats;

fn doubles(file: &SafeTensors<'_>, name: &str) -> Vec<f64> {
    let data = file.tensor(name).unwrap_or_else(|e| panic!("{name}: {e}")).data();
    data.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
}

/// Largest error, and the number of values off by more than `tolerance`.
fn compare(found: impl Iterator<Item = f64>, expected: &[f64], tolerance: f64) -> (f64, usize) {
    let (mut worst, mut off, mut count) = (0.0_f64, 0, 0);
    for (found, &expected) in found.zip(expected) {
        assert!(found.is_finite());
        let error = (found - expected).abs();
        worst = worst.max(error);
        off += usize::from(error > tolerance);
        count += 1;
    }
    assert_eq!(count, expected.len());
    (worst, off)
}

fn check(name: &str, tolerance: f64) {
    let path = streamsplat_fixtures::path(&format!("oracle/{name}.safetensors"));
    let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let scene = Splats::from_safetensors(&bytes).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let (gaussians, projection, request) = (scene.gaussians(), scene.projection, scene.request);
    let pixels = request.width * request.height;

    let planes = ["out.rgb", "out.alpha", "out.final_T", "out.depth"].map(|plane| doubles(&file, plane));
    let assert_close = |what: &str, found: [Vec<f64>; 4], tolerance: f64| {
        for (plane, (found, expected)) in ["rgb", "alpha", "final_T", "depth"].iter().zip(found.iter().zip(&planes)) {
            let scale = if *plane == "depth" { expected.iter().fold(1.0_f64, |a, v| a.max(v.abs())) } else { 1.0 };
            let (worst, off) = compare(
                found.iter().map(|v| v / scale),
                &expected.iter().map(|v| v / scale).collect::<Vec<_>>(),
                tolerance,
            );
            println!("{name} {what} {plane}: worst {worst:.2e}, {off} above {tolerance:.0e}");
            assert!(off * 1000 <= pixels, "{name} {what} {plane}: {off} of {pixels} off by more than {tolerance}");
            assert!(worst <= 1.0 / 255.0, "{name} {what} {plane}: off by {worst}");
        }
    };
    let plain = reference::render(&gaussians, &projection, &request);
    // The oracle computes the determinant as ac − b², which loses digits for needles.
    assert_close("plain", [plain.rgb, plain.alpha, plain.final_t, plain.depth], 1e-7);
    let wide = |plane: Vec<f32>| -> Vec<f64> { plane.into_iter().map(f64::from).collect() };
    for level in Level::available() {
        let Image { rgb, depth, alpha, final_t, dropped, .. } = render(level, &gaussians, &projection, &request);
        assert_eq!(dropped, plain.dropped);
        let planes = [rgb, alpha.unwrap(), final_t.unwrap(), depth.unwrap()];
        assert_close(level.name(), planes.map(wide), tolerance);
    }
}

#[test]
fn a_pinhole_scene_agrees_with_the_oracle() {
    check("perspective", 2e-5);
}

#[test]
fn a_rotated_orthographic_scene_agrees_with_the_oracle() {
    check("rotated-orthographic", 2e-5);
}

#[test]
fn predicted_scenes_agree_with_the_oracle() {
    check("predicted-t000", 2e-5);
    check("predicted-t050", 2e-5);
}

#[test]
fn the_extreme_scene_agrees_with_the_oracle() {
    check("extreme", 5e-4);
}
