//! A set of splats in a safetensors file, with its projection and image: the oracle's scenes, and the input of the
//! binary `splat`, with which other rasterisers are compared.
//!
//! | tensor | shape | what |
//! |---|---|---|
//! | `mean`, `scale`, `rgb` | `[N,3]` | as in [`Gaussians`] |
//! | `quat` | `[N,4]` | rotations w, x, y, z; absent: none is rotated |
//! | `opacity` | `[N]` or `[N,1]` | |
//! | `size` | `[2]` | height and width of the image |
//! | `background` | `[3]` | |
//! | `focal` | `[2]` | an orthographic view; pixels per unit |
//! | `intrinsics` | `[4]` | if there is no `focal`: a pinhole's f_x, f_y, c_x, c_y in pixels |
//!
//! Numbers may be floats of 32 or 64 bits or integers. They are not checked for finiteness here: drawing leaves out
//! splats with other numbers and counts them.

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use streamsplat_kernels::raster::{self, Gaussians, OwnedGaussians, Projection, Request};

/// Most pixels of an image.
pub const MAX_PIXELS: usize = 1 << 26;

/// Splats, with their projection and image.
#[derive(Clone, Debug, PartialEq)]
pub struct Splats {
    splats: OwnedGaussians,
    /// Projection of the splats.
    pub projection: Projection,
    /// The requested image, with all planes.
    pub request: Request,
}

impl Splats {
    /// Reads the bytes of a safetensors file.
    ///
    /// # Errors
    /// Files of another kind, or with tensors that do not match.
    pub fn from_safetensors(bytes: &[u8]) -> Result<Splats, String> {
        let file = SafeTensors::deserialize(bytes).map_err(|e| format!("not a readable safetensors file: {e}"))?;
        let file = &file;
        let mean = rows::<3>(file, "mean", None)?;
        let n = Some(mean.len());
        let rotation = match file.tensor("quat") {
            Ok(_) => Some(rows::<4>(file, "quat", n)?),
            Err(_) => None,
        };
        let single = |values: [f64; 2]| values.map(|v| v as f32);
        let (width, height) = size(file)?;
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
        let splats = OwnedGaussians {
            scale: rows::<3>(file, "scale", n)?,
            rotation,
            opacity: rows::<1>(file, "opacity", n)?.into_iter().flatten().collect(),
            rgb: rows::<3>(file, "rgb", n)?,
            mean,
        };
        Ok(Splats {
            splats,
            projection,
            request: Request {
                depth: true,
                alpha: true,
                statistics: true,
                ..Request::colour(width, height, background)
            },
        })
    }

    /// The splats.
    pub fn gaussians(&self) -> Gaussians<'_> {
        self.splats.gaussians()
    }
}

/// Width and height of the image.
fn size(file: &SafeTensors<'_>) -> Result<(usize, usize), String> {
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
    Ok((width, height))
}

/// A tensor `[N, K]` (`[N]` for K = 1) as f32.
fn rows<const K: usize>(file: &SafeTensors<'_>, name: &str, count: Option<usize>) -> Result<Vec<[f32; K]>, String> {
    let tensor = file.tensor(name).map_err(|_| missing(name))?;
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
    let tensor = file.tensor(name).map_err(|_| missing(name))?;
    let wrong = || format!("tensor {name}: expected shape [{K}], found {:?}", tensor.shape());
    if tensor.shape().iter().product::<usize>() != K {
        return Err(wrong());
    }
    <[f64; K]>::try_from(values(name, &tensor)?).map_err(|_| wrong())
}

fn missing(name: &str) -> String {
    format!("tensor {name} is missing")
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
