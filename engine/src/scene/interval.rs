//! One interval as safetensors.

use safetensors::tensor::{Dtype, SafeTensors, TensorView};

use crate::fit::Placement;
use crate::stream::{DynamicGaussians, Handover, Interval, Merge, Reference, Workers};

/// The interval as a safetensors file.
///
/// # Errors
/// Arrays of different lengths.
pub fn to_safetensors(interval: &Interval) -> Result<Vec<u8>, String> {
    let g = &interval.gaussians;
    if let Some((array, found)) = g.uneven() {
        return Err(format!("{array}: expected {} records, found {found}", g.len()));
    }
    let n = g.len();
    let floats = |values: &[f32]| -> Vec<u8> { values.iter().flat_map(|v| v.to_le_bytes()).collect() };
    let words = |values: &[u64]| -> Vec<u8> { values.iter().flat_map(|v| v.to_le_bytes()).collect() };
    let merges: Vec<u64> = interval.merges.iter().flat_map(|m| [m.identity, m.into]).collect();
    let times: Vec<u8> = [interval.start, interval.end].iter().flat_map(|v| v.to_le_bytes()).collect();
    let tensors: Vec<(&str, Dtype, Vec<usize>, Vec<u8>)> = vec![
        ("mean", Dtype::F32, vec![n, 3], floats(g.mean.as_flattened())),
        ("velocity", Dtype::F32, vec![n, 3], floats(g.velocity.as_flattened())),
        ("gamma", Dtype::F32, vec![n, 2], floats(g.gamma.as_flattened())),
        ("opacity", Dtype::F32, vec![n], floats(&g.opacity)),
        ("scale", Dtype::F32, vec![n, 2], floats(g.scale.as_flattened())),
        ("rgb", Dtype::F32, vec![n, 3], floats(g.rgb.as_flattened())),
        ("identity", Dtype::U64, vec![n], words(&g.identity)),
        ("birth", Dtype::U64, vec![n], words(&g.birth)),
        ("frame", Dtype::U64, vec![n], words(&g.frame)),
        ("offset", Dtype::F32, vec![n, 3], floats(g.offset.as_flattened())),
        ("reference", Dtype::U8, vec![n], g.reference.iter().map(|&r| r as u8).collect()),
        ("handover", Dtype::U8, vec![n], g.handover.iter().map(|&h| h as u8).collect()),
        ("merges", Dtype::U64, vec![interval.merges.len(), 2], words(&merges)),
        ("time", Dtype::F64, vec![2], times),
        ("index", Dtype::U64, vec![1], words(&[interval.index])),
        ("dropped", Dtype::U64, vec![1], words(&[interval.dropped])),
    ];
    let mut views = Vec::with_capacity(tensors.len());
    for (name, dtype, shape, bytes) in &tensors {
        let view = TensorView::new(*dtype, shape.clone(), bytes).map_err(|e| format!("{name}: {e}"))?;
        views.push((*name, view));
    }
    safetensors::serialize(views, None).map_err(|e| e.to_string())
}

/// The interval of a safetensors file. Lengths, kinds and codes are checked; numbers are not: records that are not finite are
/// left out, and counted, where they are drawn.
///
/// # Errors
/// What was expected and what was found, with the tensor's name.
pub fn from_safetensors(bytes: &[u8], placement: Placement, workers: Workers) -> Result<Interval, String> {
    let file = SafeTensors::deserialize(bytes).map_err(|e| format!("not a readable safetensors file: {e}"))?;
    let tensor = |name: &str, dtype: Dtype, shape: &[Option<usize>]| -> Result<&[u8], String> {
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
    };
    let mean = tensor("mean", Dtype::F32, &[None, Some(3)])?;
    let n = Some(mean.len() / 12);
    let index = words::<1>(tensor("index", Dtype::U64, &[Some(1)])?);
    let dropped = words::<1>(tensor("dropped", Dtype::U64, &[Some(1)])?);
    let merges = words::<2>(tensor("merges", Dtype::U64, &[None, Some(2)])?);
    let time: Vec<f64> =
        tensor("time", Dtype::F64, &[Some(2)])?.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
    let (start, end) = (time[0], time[1]);
    if !(start.is_finite() && end.is_finite() && start <= end) {
        return Err(format!("tensor time: expected two ascending finite times, found {start} and {end}"));
    }
    let codes = |name: &str| tensor(name, Dtype::U8, &[n]);
    let code = |name: &str, code: u8| format!("tensor {name}: expected codes this version knows, found {code}");
    let gaussians = DynamicGaussians {
        mean: floats::<3>(mean),
        velocity: floats::<3>(tensor("velocity", Dtype::F32, &[n, Some(3)])?),
        gamma: floats::<2>(tensor("gamma", Dtype::F32, &[n, Some(2)])?),
        opacity: floats::<1>(tensor("opacity", Dtype::F32, &[n])?).into_iter().flatten().collect(),
        scale: floats::<2>(tensor("scale", Dtype::F32, &[n, Some(2)])?),
        rgb: floats::<3>(tensor("rgb", Dtype::F32, &[n, Some(3)])?),
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
    };
    Ok(Interval {
        index: index[0][0],
        start,
        end,
        gaussians,
        placement,
        merges: merges.into_iter().map(|[identity, into]| Merge { identity, into }).collect(),
        dropped: dropped[0][0],
        workers,
    })
}

fn floats<const K: usize>(bytes: &[u8]) -> Vec<[f32; K]> {
    let values: Vec<f32> = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    values.as_chunks::<K>().0.to_vec()
}

fn words<const K: usize>(bytes: &[u8]) -> Vec<[u64; K]> {
    let values: Vec<u64> = bytes.as_chunks::<8>().0.iter().map(|b| u64::from_le_bytes(*b)).collect();
    values.as_chunks::<K>().0.to_vec()
}
