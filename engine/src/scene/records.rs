//! Records of Gaussians as tensors of a safetensors file.

use safetensors::tensor::{Dtype, SafeTensors, TensorView};

use crate::stream::{DynamicGaussians, Handover, Reference};

/// A tensor to be written: name, kind, shape, bytes.
pub(super) type Tensor = (&'static str, Dtype, Vec<usize>, Vec<u8>);

/// The name of the tensor that is present only where some colour changes.
const RGB_RATE: &str = "rgb_rate";
/// The name of the tensor that is present only where some Gaussian is lifted to a depth map.
const THICKNESS: &str = "thickness";

/// The arrays of `g`, one tensor each; [`RGB_RATE`] only if one of its numbers is not zero, [`THICKNESS`] only if one
/// is not 1.
///
/// # Errors
/// Arrays of different lengths, and rates of colour and thicknesses that are not finite.
pub(super) fn write(g: &DynamicGaussians) -> Result<Vec<Tensor>, String> {
    if let Some((array, found)) = g.uneven() {
        return Err(format!("{array}: expected {} records, found {found}", g.len()));
    }
    let n = g.len();
    let rates = g.rgb_rate.as_flattened();
    finite(RGB_RATE, rates)?;
    finite(THICKNESS, &g.thickness)?;
    let mut tensors = vec![
        ("mean", Dtype::F32, vec![n, 3], float_bytes(g.mean.as_flattened())),
        ("velocity", Dtype::F32, vec![n, 3], float_bytes(g.velocity.as_flattened())),
        ("gamma", Dtype::F32, vec![n, 2], float_bytes(g.gamma.as_flattened())),
        ("opacity", Dtype::F32, vec![n], float_bytes(&g.opacity)),
        ("scale", Dtype::F32, vec![n, 2], float_bytes(g.scale.as_flattened())),
        ("rgb", Dtype::F32, vec![n, 3], float_bytes(g.rgb.as_flattened())),
        ("identity", Dtype::U64, vec![n], word_bytes(&g.identity)),
        ("birth", Dtype::U64, vec![n], word_bytes(&g.birth)),
        ("frame", Dtype::U64, vec![n], word_bytes(&g.frame)),
        ("offset", Dtype::F32, vec![n, 3], float_bytes(g.offset.as_flattened())),
        ("reference", Dtype::U8, vec![n], g.reference.iter().map(|&r| r as u8).collect()),
        ("handover", Dtype::U8, vec![n], g.handover.iter().map(|&h| h as u8).collect()),
    ];
    if rates.iter().any(|rate| *rate != 0.0) {
        tensors.push((RGB_RATE, Dtype::F32, vec![n, 3], float_bytes(rates)));
    }
    if g.thickness.iter().any(|thickness| *thickness != 1.0) {
        tensors.push((THICKNESS, Dtype::F32, vec![n], float_bytes(&g.thickness)));
    }
    Ok(tensors)
}

/// Returns an error that names the first number of tensor `name` that is not finite.
fn finite(name: &str, values: &[f32]) -> Result<(), String> {
    match values.iter().position(|v| !v.is_finite()) {
        Some(at) => Err(format!("tensor {name}: expected finite numbers, found {} at {at}", values[at])),
        None => Ok(()),
    }
}

/// Reads the records of a file. Lengths, types and codes are checked; of the numbers, only those of [`RGB_RATE`] and
/// [`THICKNESS`]. Where the first is missing, colours do not change; where the second is, thickness is 1.
///
/// # Errors
/// Expected and found values, with the tensor's name.
pub(super) fn read(file: &SafeTensors<'_>) -> Result<DynamicGaussians, String> {
    let mean = tensor(file, "mean", Dtype::F32, &[None, Some(3)])?;
    let n = Some(mean.len() / 12);
    let tensor = |name: &str, dtype, shape: &[Option<usize>]| tensor(file, name, dtype, shape);
    let codes = |name: &str| tensor(name, Dtype::U8, &[n]);
    let code = |name: &str, code: u8| format!("tensor {name}: expected codes this version knows, found {code}");
    let rgb_rate = match file.tensor(RGB_RATE) {
        Ok(_) => floats::<3>(tensor(RGB_RATE, Dtype::F32, &[n, Some(3)])?),
        Err(_) => vec![[0.0; 3]; mean.len() / 12],
    };
    finite(RGB_RATE, rgb_rate.as_flattened())?;
    let thickness = match file.tensor(THICKNESS) {
        Ok(_) => floats::<1>(tensor(THICKNESS, Dtype::F32, &[n])?).into_iter().flatten().collect(),
        Err(_) => vec![1.0; mean.len() / 12],
    };
    finite(THICKNESS, &thickness)?;
    Ok(DynamicGaussians {
        mean: floats::<3>(mean),
        velocity: floats::<3>(tensor("velocity", Dtype::F32, &[n, Some(3)])?),
        gamma: floats::<2>(tensor("gamma", Dtype::F32, &[n, Some(2)])?),
        opacity: floats::<1>(tensor("opacity", Dtype::F32, &[n])?).into_iter().flatten().collect(),
        scale: floats::<2>(tensor("scale", Dtype::F32, &[n, Some(2)])?),
        rgb: floats::<3>(tensor("rgb", Dtype::F32, &[n, Some(3)])?),
        rgb_rate,
        thickness,
        identity: words::<1>(tensor("identity", Dtype::U64, &[n])?).into_iter().flatten().collect(),
        birth: words::<1>(tensor("birth", Dtype::U64, &[n])?).into_iter().flatten().collect(),
        frame: words::<1>(tensor("frame", Dtype::U64, &[n])?).into_iter().flatten().collect(),
        offset: floats::<3>(tensor("offset", Dtype::F32, &[n, Some(3)])?),
        reference: codes("reference")?
            .iter()
            .map(|&c| Reference::from_code(c).ok_or_else(|| code("reference", c)))
            .collect::<Result<_, _>>()?,
        handover: codes("handover")?
            .iter()
            .map(|&c| Handover::from_code(c).ok_or_else(|| code("handover", c)))
            .collect::<Result<_, _>>()?,
    })
}

/// The tensors as a file.
pub(super) fn serialize(
    tensors: &[Tensor],
    metadata: Option<std::collections::HashMap<String, String>>,
) -> Result<Vec<u8>, String> {
    let mut views = Vec::with_capacity(tensors.len());
    for (name, dtype, shape, bytes) in tensors {
        let view = TensorView::new(*dtype, shape.clone(), bytes).map_err(|e| format!("{name}: {e}"))?;
        views.push((*name, view));
    }
    safetensors::serialize(views, metadata).map_err(|e| e.to_string())
}

/// The bytes of tensor `name`, which must be of this type and shape (`None`: any length).
pub(super) fn tensor<'a>(
    file: &SafeTensors<'a>,
    name: &str,
    dtype: Dtype,
    shape: &[Option<usize>],
) -> Result<&'a [u8], String> {
    let view = file.tensor(name).map_err(|_| format!("tensor {name} is missing"))?;
    let fits = view.shape().len() == shape.len()
        && view.shape().iter().zip(shape).all(|(found, expected)| expected.is_none_or(|e| e == *found));
    if view.dtype() != dtype || !fits {
        let sides: Vec<_> = shape.iter().map(|s| s.map_or_else(|| "*".to_owned(), |s| s.to_string())).collect();
        let (found, dims) = (view.dtype(), view.shape());
        return Err(format!("tensor {name}: expected {dtype:?} [{}], found {found:?} {dims:?}", sides.join(", ")));
    }
    // The view borrows the file's bytes.
    Ok(view.data())
}

pub(super) fn float_bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

pub(super) fn word_bytes(values: &[u64]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

pub(super) fn floats<const K: usize>(bytes: &[u8]) -> Vec<[f32; K]> {
    let values: Vec<f32> = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    values.as_chunks::<K>().0.to_vec()
}

pub(super) fn words<const K: usize>(bytes: &[u8]) -> Vec<[u64; K]> {
    let values: Vec<u64> = bytes.as_chunks::<8>().0.iter().map(|b| u64::from_le_bytes(*b)).collect();
    values.as_chunks::<K>().0.to_vec()
}
