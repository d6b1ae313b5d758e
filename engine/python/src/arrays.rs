//! NumPy arrays from the engine's memory, and frames from NumPy arrays.

use numpy::ndarray::{ArrayView, ArrayView3, Dimension};
use numpy::{Element, PyArray, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::prelude::*;
use streamsplat::picture::{MAX_PIXELS, MAX_SIDE, size_is_allowed};

use crate::failure::wrong;

/// `view` as a read-only NumPy array that keeps `owner` alive.
///
/// # Safety
/// `view` shows memory of `owner` that stays where it is and is not written to for as long as `owner` lives.
pub unsafe fn borrowed<'py, T: Element, D: Dimension>(
    view: &ArrayView<'_, T, D>,
    owner: Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray<T, D>>> {
    // SAFETY: the caller's promise; and nobody can write through an array that is not writeable.
    let array = unsafe { PyArray::borrow_from_array(view, owner) };
    array.call_method1("setflags", (false,))?;
    Ok(array)
}

/// The greatest sample of a float frame that is not taken for one of 0 to 255.
const MOST_FLOAT: f32 = 2.0;

/// A frame's pixels as planes `[3, H, W]`, with its height and width.
///
/// Other objects that convert to NumPy arrays, such as PIL images and torch tensors, are converted first; these may
/// also have torch's layout `[3, H, W]`.
pub fn planes(frame: &Bound<'_, PyAny>) -> PyResult<(Vec<f32>, [usize; 2])> {
    let makes_one = frame.hasattr("__array__")? || frame.hasattr("__array_interface__")?;
    let made = if frame.is_instance_of::<PyUntypedArray>() || !makes_one {
        frame.clone()
    } else {
        let array = frame.py().import("numpy")?.call_method1("asarray", (frame,))?;
        let shape: Vec<usize> = array.getattr("shape")?.extract()?;
        match shape[..] {
            [3, _, width] if width != 3 => array.call_method1("transpose", (1, 2, 0))?,
            _ => array,
        }
    };
    let frame = &made;
    if let Ok(pixels) = frame.extract::<PyReadonlyArray3<'_, f32>>() {
        aligned("frame", frame)?;
        let (planes, size) = split(pixels.as_array(), |x| x)?;
        return match planes.iter().find(|x| **x > MOST_FLOAT && x.is_finite()) {
            Some(x) => Err(wrong(format!("frame: expected float32 in [0, 1] (or uint8 in 0 to 255), found {x}"))),
            None => Ok((planes, size)),
        };
    }
    if let Ok(pixels) = frame.extract::<PyReadonlyArray3<'_, u8>>() {
        return split(pixels.as_array(), |x| f32::from(x) / 255.0);
    }
    Err(wrong(format!(
        "frame: expected a NumPy array [height, width, 3] of uint8 or float32, found {}",
        describe(frame)
    )))
}

fn split<T: Copy>(pixels: ArrayView3<'_, T>, value: impl Fn(T) -> f32) -> PyResult<(Vec<f32>, [usize; 2])> {
    let (height, width, channels) = pixels.dim();
    if channels != 3 {
        return Err(wrong(format!("frame: expected [height, width, 3], found [{height}, {width}, {channels}]")));
    }
    // An array may show one number many times.
    if !size_is_allowed(width, height) {
        let most = format!("1 to {MAX_SIDE} pixels a side and {MAX_PIXELS} in all");
        return Err(wrong(format!("frame: expected {most}, found {width}×{height}")));
    }
    let planes = pixels.permuted_axes([2, 0, 1]);
    Ok((planes.iter().map(|&x| value(x)).collect(), [height, width]))
}

/// A depth map `[H, W]`.
pub fn depth(map: &Bound<'_, PyAny>, size: [usize; 2]) -> PyResult<Vec<f32>> {
    let Ok(values) = map.extract::<PyReadonlyArray2<'_, f32>>() else {
        return Err(wrong(format!(
            "depth: expected a NumPy array [height, width] of float32, found {}",
            describe(map)
        )));
    };
    aligned("depth", map)?;
    if values.shape() != size {
        return Err(wrong(format!("depth: expected {size:?} as the frame, found {:?}", values.shape())));
    }
    Ok(values.as_array().iter().copied().collect())
}

/// An error where an array's numbers do not lie where the processor expects numbers of their kind.
fn aligned(name: &str, array: &Bound<'_, PyAny>) -> PyResult<()> {
    if array.getattr("flags")?.getattr("aligned")?.extract()? {
        return Ok(());
    }
    Err(wrong(format!(
        "{name}: expected an aligned array, found one that is not (numpy.require(x, requirements='A') makes one)"
    )))
}

/// Description of an argument, for messages.
fn describe(value: &Bound<'_, PyAny>) -> String {
    let shape = value.getattr("shape").map(|s| s.to_string());
    let dtype = value.getattr("dtype").map(|d| d.to_string());
    match (shape, dtype) {
        (Ok(shape), Ok(dtype)) => format!("{shape} of {dtype}"),
        _ => value.get_type().to_string(),
    }
}
