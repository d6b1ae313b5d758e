//! Records of Gaussians as tensors of a safetensors file.

use std::borrow::Cow;

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use streamsplat_model::columns::{Numbers, Source, Value};

use crate::stream::DynamicGaussians;

/// A tensor to be written: name, kind, shape, bytes.
pub(super) type Tensor = (Cow<'static, str>, Dtype, Vec<usize>, Vec<u8>);

/// The properties of `g`, one tensor each; those that were added later only where one differs from its default.
///
/// # Errors
/// Arrays of different lengths, and numbers that are not finite in properties that were added later.
pub(super) fn write(g: &DynamicGaussians) -> Result<Vec<Tensor>, String> {
    if let Some((array, found)) = g.uneven() {
        return Err(format!("{array}: expected {} records, found {found}", g.len()));
    }
    let columns = g.columns();
    for column in columns.iter().filter(|column| column.default.is_some()) {
        finite(column.name, &column.numbers)?;
    }
    let differ = columns.iter().filter(|column| !column.is_default());
    Ok(differ.map(|column| rows(column.name, column.width, &column.numbers)).collect())
}

/// Returns an error that names the first number of tensor `name` that is not finite.
fn finite(name: &str, numbers: &Numbers<'_>) -> Result<(), String> {
    let Numbers::Floats(values) = numbers else { return Ok(()) };
    match values.iter().position(|v| !v.is_finite()) {
        Some(at) => Err(format!("tensor {name}: expected finite numbers, found {} at {at}", values[at])),
        None => Ok(()),
    }
}

/// Reads the records of a file. Lengths, types and codes are checked; of the numbers, only those of properties that
/// were added later. Where the tensor of one of these is missing, every Gaussian has its default.
///
/// # Errors
/// Expected and found values, with the tensor's name.
pub(super) fn read(file: &SafeTensors<'_>) -> Result<DynamicGaussians, String> {
    DynamicGaussians::read(&mut Properties { file, count: None })
}

/// Properties in a file, and the number of their values.
struct Properties<'a> {
    file: &'a SafeTensors<'a>,
    count: Option<usize>,
}

impl Source for Properties<'_> {
    type Error = String;

    fn values<T: Value>(&mut self, name: &'static str, default: Option<T>) -> Result<Vec<T>, String> {
        let values = match (default, self.count, self.file.tensor(name)) {
            (Some(default), Some(count), Err(_)) => vec![default; count],
            _ => from_tensor(self.file, name, self.count)?,
        };
        if default.is_some() {
            finite(name, &T::numbers(&values))?;
        }
        self.count = Some(values.len());
        Ok(values)
    }
}

/// The tensors as a file.
pub(super) fn serialize(
    tensors: &[Tensor],
    metadata: Option<std::collections::HashMap<String, String>>,
) -> Result<Vec<u8>, String> {
    let mut views = Vec::with_capacity(tensors.len());
    for (name, dtype, shape, bytes) in tensors {
        let view = TensorView::new(*dtype, shape.clone(), bytes).map_err(|e| format!("{name}: {e}"))?;
        views.push((name, view));
    }
    safetensors::serialize(views, metadata).map_err(|e| e.to_string())
}

/// The kind of tensors for numbers, and the bytes of one.
fn kind(numbers: &Numbers<'_>) -> (Dtype, usize) {
    match numbers {
        Numbers::Floats(_) => (Dtype::F32, 4),
        Numbers::Words(_) => (Dtype::U64, 8),
        Numbers::Codes(_) => (Dtype::U8, 1),
    }
}

/// A tensor of rows of numbers; of single numbers where `width` is 1.
pub(super) fn rows(name: impl Into<Cow<'static, str>>, width: usize, numbers: &Numbers<'_>) -> Tensor {
    let (bytes, (dtype, size)) = (numbers.to_bytes(), kind(numbers));
    let count = bytes.len() / (size * width);
    (name.into(), dtype, if width == 1 { vec![count] } else { vec![count, width] }, bytes)
}

/// A tensor of one row per value.
pub(super) fn to_tensor<T: Value>(name: &'static str, values: &[T]) -> Tensor {
    rows(name, T::WIDTH, &T::numbers(values))
}

/// The values of tensor `name`, one per row; `count` of them, or any number.
pub(super) fn from_tensor<T: Value>(
    file: &SafeTensors<'_>,
    name: &str,
    count: Option<usize>,
) -> Result<Vec<T>, String> {
    let shape = [count, Some(T::WIDTH)];
    shaped(file, name, if T::WIDTH == 1 { &shape[..1] } else { &shape })
}

/// The values of tensor `name`, which must be of this shape.
pub(super) fn shaped<T: Value>(file: &SafeTensors<'_>, name: &str, shape: &[Option<usize>]) -> Result<Vec<T>, String> {
    let bytes = tensor(file, name, kind(&T::numbers(&[])).0, shape)?;
    T::from_bytes(bytes).map_err(|code| format!("tensor {name}: expected codes this version knows, found {code}"))
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
