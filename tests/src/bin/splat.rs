//! `splat SCENE OUT`: draws the Gaussians of a safetensors file ([`streamsplat_tests::splats`] lists its tensors) and
//! writes the planes of the image: `rgb`, `depth`, `alpha`, `final_T`, and `blended`.

use std::error::Error;
use std::path::Path;
use std::process::ExitCode;

use safetensors::tensor::{Dtype, TensorView};
use streamsplat_kernels::{Level, raster};
use streamsplat_tests::splats::Splats;

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args_os().skip(1).collect();
    let [scene, out] = arguments.as_slice() else {
        eprintln!("usage: splat SCENE OUT");
        return ExitCode::from(2);
    };
    match draw(Path::new(scene), Path::new(out)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("splat: {}: {error}", Path::new(scene).display());
            ExitCode::FAILURE
        }
    }
}

fn draw(scene: &Path, out: &Path) -> Result<(), Box<dyn Error>> {
    let scene = Splats::from_safetensors(&std::fs::read(scene)?)?;
    let image = raster::render(Level::detect(), &scene.gaussians(), &scene.projection, &scene.request);
    let plane = vec![scene.request.height, scene.request.width];
    let colour = [vec![3], plane.clone()].concat();
    let floats = |values: &[f32]| -> Vec<u8> { values.iter().flat_map(|v| v.to_le_bytes()).collect() };
    let optional = |values: &Option<Vec<f32>>| floats(values.as_deref().unwrap_or_default());
    let tensors = [
        ("rgb", Dtype::F32, &colour, floats(&image.rgb)),
        ("depth", Dtype::F32, &plane, optional(&image.depth)),
        ("alpha", Dtype::F32, &plane, optional(&image.alpha)),
        ("final_T", Dtype::F32, &plane, optional(&image.final_t)),
        ("blended", Dtype::I32, &plane, image.blended.iter().flatten().flat_map(|v| v.to_le_bytes()).collect()),
    ];
    let mut views = Vec::new();
    for (name, dtype, shape, bytes) in &tensors {
        views.push((*name, TensorView::new(*dtype, shape.to_vec(), bytes)?));
    }
    Ok(safetensors::serialize_to_file(views, None, out)?)
}
