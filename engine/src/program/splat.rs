//! `splat`: draws the Gaussians of a safetensors file.

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use streamsplat::output::write_file;
use streamsplat_kernels::raster::{self, Gaussians, Projection, Request};

use super::cli::SplatArgs;
use super::failure::Failure;

/// Largest file read, in bytes.
const MAX_FILE: u64 = 16 << 30;
/// Most pixels drawn.
const MAX_PIXELS: usize = 1 << 28;

/// Reads, draws, writes.
pub fn command(args: &SplatArgs) -> Result<(), Failure> {
    let workers = args.machine.workers()?;
    let wrong = |e: &dyn std::fmt::Display| Failure::work(format!("{}: {e}", args.scene.display()));
    let size = std::fs::metadata(&args.scene).map_err(|e| wrong(&e))?.len();
    if size > MAX_FILE {
        return Err(wrong(&format!("{size} bytes are more than this program reads")));
    }
    let bytes = std::fs::read(&args.scene).map_err(|e| wrong(&e))?;
    let file = SafeTensors::deserialize(&bytes).map_err(|e| wrong(&format!("not a readable safetensors file: {e}")))?;
    let scene = Scene::read(&file).map_err(|e| wrong(&e))?;
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

struct Scene {
    mean: Vec<[f32; 3]>,
    scale: Vec<[f32; 3]>,
    rotation: Option<Vec<[f32; 4]>>,
    opacity: Vec<f32>,
    rgb: Vec<[f32; 3]>,
    projection: Projection,
    request: Request,
}

impl Scene {
    fn read(file: &SafeTensors<'_>) -> Result<Scene, String> {
        let mean = rows::<3>(file, "mean", None)?;
        let n = Some(mean.len());
        let rotation = match file.tensor("quat") {
            Ok(_) => Some(rows::<4>(file, "quat", n)?),
            Err(_) => None,
        };
        let [height, width] = row::<2>(file, "size")?.map(|side| {
            let whole = side >= 1.0 && side <= raster::MAX_SIDE as f64 && side.fract() == 0.0;
            whole.then_some(side as usize)
        });
        let (Some(height), Some(width)) = (height, width) else {
            return Err(format!("tensor size: expected height and width from 1 to {}", raster::MAX_SIDE));
        };
        if width * height > MAX_PIXELS {
            return Err(format!("tensor size: expected at most {MAX_PIXELS} pixels, found {width}×{height}"));
        }
        let single = |values: [f64; 2]| values.map(|v| v as f32);
        let projection = if file.tensor("focal").is_ok() {
            Projection::Orthographic { focal: single(row::<2>(file, "focal")?) }
        } else if file.tensor("intrinsics").is_ok() {
            let [fx, fy, cx, cy] = row::<4>(file, "intrinsics")?;
            Projection::Pinhole { focal: single([fx, fy]), centre: single([cx, cy]) }
        } else {
            return Err(
                "expected a tensor focal [2] (orthographic) or intrinsics [4] (perspective), found neither".into()
            );
        };
        let background = row::<3>(file, "background")?.map(|v| v as f32);
        let request = Request { width, height, background, depth: true, alpha: true, statistics: true };
        Ok(Scene {
            scale: rows::<3>(file, "scale", n)?,
            rotation,
            opacity: rows::<1>(file, "opacity", n)?.into_iter().flatten().collect(),
            rgb: rows::<3>(file, "rgb", n)?,
            mean,
            projection,
            request,
        })
    }

    fn gaussians(&self) -> Gaussians<'_> {
        Gaussians {
            mean: &self.mean,
            scale: &self.scale,
            rotation: self.rotation.as_deref(),
            opacity: &self.opacity,
            rgb: &self.rgb,
        }
    }
}

/// A tensor `[N, K]` (`[N]` for K = 1) as f32.
fn rows<const K: usize>(file: &SafeTensors<'_>, name: &str, count: Option<usize>) -> Result<Vec<[f32; K]>, String> {
    let tensor = file.tensor(name).map_err(|_| format!("tensor {name} is missing"))?;
    let found = match *tensor.shape() {
        [n] if K == 1 => Some(n),
        [n, k] if k == K => Some(n),
        _ => None,
    };
    if found.is_none() || count.is_some_and(|count| found != Some(count)) {
        let n = count.map_or_else(|| "N".to_owned(), |n| n.to_string());
        return Err(format!("tensor {name}: expected shape [{n}, {K}], found {:?}", tensor.shape()));
    }
    let values: Vec<f32> = values(name, &tensor)?.into_iter().map(|v| v as f32).collect();
    Ok(values.as_chunks::<K>().0.to_vec())
}

/// A tensor of K values.
fn row<const K: usize>(file: &SafeTensors<'_>, name: &str) -> Result<[f64; K], String> {
    let tensor = file.tensor(name).map_err(|_| format!("tensor {name} is missing"))?;
    let found = values(name, &tensor)?;
    <[f64; K]>::try_from(found.as_slice())
        .map_err(|_| format!("tensor {name}: expected {K} values, found {}", found.len()))
}

fn values(name: &str, tensor: &TensorView<'_>) -> Result<Vec<f64>, String> {
    macro_rules! read {
        ($kind:ty, $convert:expr) => {{
            let convert: fn($kind) -> f64 = $convert;
            let (chunks, _) = tensor.data().as_chunks::<{ size_of::<$kind>() }>();
            chunks.iter().map(|b| convert(<$kind>::from_le_bytes(*b))).collect()
        }};
    }
    Ok(match tensor.dtype() {
        Dtype::F64 => read!(f64, |v| v),
        Dtype::F32 => read!(f32, f64::from),
        Dtype::F16 => read!(half::f16, half::f16::to_f64),
        Dtype::BF16 => read!(half::bf16, half::bf16::to_f64),
        Dtype::I64 => read!(i64, |v| v as f64),
        Dtype::U64 => read!(u64, |v| v as f64),
        Dtype::I32 => read!(i32, f64::from),
        Dtype::U32 => read!(u32, f64::from),
        Dtype::I16 => read!(i16, f64::from),
        Dtype::U16 => read!(u16, f64::from),
        Dtype::U8 => read!(u8, f64::from),
        other => return Err(format!("tensor {name}: expected numbers, found {other:?}")),
    })
}
