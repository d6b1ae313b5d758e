//! `splat`: draws the Gaussians of a safetensors file.

use safetensors::tensor::{Dtype, TensorView};
use streamsplat::formats::read_file;
use streamsplat::output::write_file;
use streamsplat::splats::{Splats, SplatsError};
use streamsplat_kernels::raster;
use streamsplat_model::checkpoint::Checkpoint;

use crate::console::failure::Failure;
use crate::options::args::SplatArgs;

/// Maximum bytes per Gaussian: 14 numbers in binary64.
const RECORD: u64 = 112;
/// Maximum bytes of the rest of the file.
const MAX_OVERHEAD: u64 = 1 << 20;

/// Reads, draws, writes.
pub fn command(args: &SplatArgs) -> Result<(), Failure> {
    let workers = args.machine.workers()?;
    let wrong = |e: &dyn std::fmt::Display| Failure::work(format!("{}: {e}", args.scene.display()));
    // Tensors are counted before they are read.
    let file = Checkpoint::open(&args.scene)?;
    let mean = file.tensors().get("mean").ok_or_else(|| wrong(&SplatsError::Missing("mean")))?;
    let count = mean.shape.first().copied().unwrap_or_default();
    drop(file);
    if count > args.limit.limits().gaussians {
        let most = args.limit.limits().gaussians;
        return Err(wrong(&format!("mean: expected at most {most} Gaussians (--limit-gaussians), found {count}")));
    }
    let most = (count as u64).saturating_mul(RECORD) + MAX_OVERHEAD;
    let bytes = read_file(&args.scene, most).map_err(|e| wrong(&e))?;
    let scene = Splats::from_safetensors(&bytes).map_err(|e| wrong(&e))?;
    drop(bytes);
    let image =
        workers.install(|| raster::render(workers.level(), &scene.gaussians(), &scene.projection, &scene.request));

    let plane = vec![scene.request.height, scene.request.width];
    let colour = [vec![3], plane.clone()].concat();
    let floats = |values: &[f32]| -> Vec<u8> { values.iter().flat_map(|v| v.to_le_bytes()).collect() };
    let blended: Vec<u8> = image.blended.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    let optional = |values: &Option<Vec<f32>>| floats(values.as_deref().unwrap_or_default());
    let tensors = [
        ("rgb", Dtype::F32, &colour, floats(&image.rgb)),
        ("depth", Dtype::F32, &plane, optional(&image.depth)),
        ("alpha", Dtype::F32, &plane, optional(&image.alpha)),
        ("final_T", Dtype::F32, &plane, optional(&image.final_t)),
        ("blended", Dtype::I32, &plane, blended),
    ];
    let mut views = Vec::new();
    for (name, dtype, shape, bytes) in &tensors {
        views.push((*name, TensorView::new(*dtype, shape.to_vec(), bytes).map_err(Failure::work)?));
    }
    let content = safetensors::serialize(views, None).map_err(Failure::work)?;
    write_file(&args.out, &content)?;
    Ok(())
}
