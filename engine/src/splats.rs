//! A set of splats in a safetensors file, with its projection and image: the input of the `splat` command.
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
//! Numbers may be floats of 16 to 64 bits or integers. They are not checked for finiteness here: drawing leaves out
//! splats with other numbers and counts them.

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use streamsplat_kernels::raster::{self, Gaussians, OwnedGaussians, Projection, Request};

/// Most pixels of an image.
pub const MAX_PIXELS: usize = 1 << 26;

/// Errors of a file of splats.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SplatsError {
    /// Not a safetensors file, or a broken one.
    #[error("not a readable safetensors file: {0}")]
    Format(String),
    /// A tensor is missing.
    #[error("tensor {0} is missing")]
    Missing(&'static str),
    /// Neither projection is present.
    #[error("expected a tensor focal [2] (orthographic) or intrinsics [4] (perspective), found neither")]
    Projection,
    /// A tensor has another shape than the others require.
    #[error("tensor {tensor}: expected shape {expected}, found {found:?}")]
    Shape {
        /// The tensor.
        tensor: &'static str,
        /// The expected shape or type.
        expected: String,
        /// The one found.
        found: Vec<usize>,
    },
    /// A tensor has an unsupported number format.
    #[error("tensor {tensor}: expected numbers, found {found}")]
    Numbers {
        /// The tensor.
        tensor: &'static str,
        /// Its number format.
        found: String,
    },
    /// A side of the image is not a whole number from 1 to [`raster::MAX_SIDE`].
    #[error("tensor size: expected height and width from 1 to {}", raster::MAX_SIDE)]
    Side,
    /// The image has more than [`MAX_PIXELS`].
    #[error("tensor size: expected at most {MAX_PIXELS} pixels, found {width}×{height}")]
    Pixels {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
    },
}

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
    pub fn from_safetensors(bytes: &[u8]) -> Result<Splats, SplatsError> {
        let file = SafeTensors::deserialize(bytes).map_err(|e| SplatsError::Format(e.to_string()))?;
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
            return Err(SplatsError::Projection);
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
fn size(file: &SafeTensors<'_>) -> Result<(usize, usize), SplatsError> {
    let [height, width] = row::<2>(file, "size")?.map(|side| {
        let whole = side >= 1.0 && side <= raster::MAX_SIDE as f64 && side.fract() == 0.0;
        whole.then_some(side as usize)
    });
    let (Some(height), Some(width)) = (height, width) else { return Err(SplatsError::Side) };
    if width * height > MAX_PIXELS {
        return Err(SplatsError::Pixels { width, height });
    }
    Ok((width, height))
}

/// A tensor `[N, K]` (`[N]` for K = 1) as f32.
fn rows<const K: usize>(
    file: &SafeTensors<'_>,
    name: &'static str,
    count: Option<usize>,
) -> Result<Vec<[f32; K]>, SplatsError> {
    let tensor = file.tensor(name).map_err(|_| SplatsError::Missing(name))?;
    let found = match *tensor.shape() {
        [n] if K == 1 => Some(n),
        [n, k] if k == K => Some(n),
        _ => None,
    };
    if found.is_none() || count.is_some_and(|count| found != Some(count)) {
        let n = count.map_or_else(|| "N".to_owned(), |n| n.to_string());
        let (expected, found) = (format!("[{n}, {K}]"), tensor.shape().to_vec());
        return Err(SplatsError::Shape { tensor: name, expected, found });
    }
    let values: Vec<f32> = values(name, &tensor)?.into_iter().map(|v| v as f32).collect();
    Ok(values.as_chunks::<K>().0.to_vec())
}

/// A tensor of K values.
fn row<const K: usize>(file: &SafeTensors<'_>, name: &'static str) -> Result<[f64; K], SplatsError> {
    let tensor = file.tensor(name).map_err(|_| SplatsError::Missing(name))?;
    let wrong = || SplatsError::Shape { tensor: name, expected: format!("[{K}]"), found: tensor.shape().to_vec() };
    if tensor.shape().iter().product::<usize>() != K {
        return Err(wrong());
    }
    <[f64; K]>::try_from(values(name, &tensor)?).map_err(|_| wrong())
}

fn values(name: &'static str, tensor: &TensorView<'_>) -> Result<Vec<f64>, SplatsError> {
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
        other => return Err(SplatsError::Numbers { tensor: name, found: format!("{other:?}") }),
    })
}
