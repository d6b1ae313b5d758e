//! One interval as safetensors.

use safetensors::tensor::{Dtype, SafeTensors};

use super::records::{self, from_tensor, tensor, to_tensor};
use crate::fit::Placement;
use crate::stream::{Interval, Merge};

/// Converts the interval to a safetensors file.
///
/// # Errors
/// Arrays of different lengths.
pub fn to_safetensors(interval: &Interval) -> Result<Vec<u8>, String> {
    let mut tensors = records::write(&interval.gaussians)?;
    let merges: Vec<[u64; 2]> = interval.merges.iter().map(|m| [m.identity, m.into]).collect();
    let times: Vec<u8> = [interval.start, interval.end].iter().flat_map(|v| v.to_le_bytes()).collect();
    tensors.extend([
        to_tensor("merges", &merges),
        ("time".into(), Dtype::F64, vec![2], times),
        to_tensor("index", &[interval.index]),
        to_tensor("dropped", &[interval.dropped]),
    ]);
    records::serialize(&tensors, None)
}

/// Reads the interval of a safetensors file. Lengths, types and codes are checked; numbers are not: records that are
/// not finite are left out and counted when they are drawn.
///
/// # Errors
/// Expected and found values, with the tensor's name.
pub fn from_safetensors(bytes: &[u8], placement: Placement) -> Result<Interval, String> {
    let file = SafeTensors::deserialize(bytes).map_err(|e| format!("not a readable safetensors file: {e}"))?;
    let gaussians = records::read(&file)?;
    let word = |name: &str| Ok::<u64, String>(from_tensor(&file, name, Some(1))?[0]);
    let merges = from_tensor::<[u64; 2]>(&file, "merges", None)?;
    let time: Vec<f64> = tensor(&file, "time", Dtype::F64, &[Some(2)])?
        .as_chunks::<8>()
        .0
        .iter()
        .map(|b| f64::from_le_bytes(*b))
        .collect();
    let (start, end) = (time[0], time[1]);
    if !(start.is_finite() && end.is_finite() && start <= end) {
        return Err(format!("tensor time: expected two ascending finite times, found {start} and {end}"));
    }
    Ok(Interval {
        index: word("index")?,
        start,
        end,
        gaussians,
        placement,
        merges: merges.into_iter().map(|[identity, into]| Merge { identity, into }).collect(),
        dropped: word("dropped")?,
    })
}
