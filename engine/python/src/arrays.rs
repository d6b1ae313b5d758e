//! NumPy arrays that share the engine's memory, and frames from NumPy arrays.

use numpy::ndarray::{ArrayView, ArrayViewD, Axis, Dimension, Ix3};
use numpy::{Element, PyArray, PyReadonlyArray2, PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::prelude::*;
use streamsplat::picture::{MAX_PIXELS, MAX_SIDE, size_is_allowed};

use crate::failure::{mistyped, wrong};

/// Returns `view` as a read-only NumPy array that keeps `owner` alive.
///
/// # Safety
/// `view` must refer to memory of `owner` that is neither moved nor written while `owner` lives.
pub unsafe fn borrowed<'py, T: Element, D: Dimension>(
    view: &ArrayView<'_, T, D>,
    owner: Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray<T, D>>> {
    // SAFETY: the caller's promise; and an array that is not writeable cannot be written through.
    let array = unsafe { PyArray::borrow_from_array(view, owner) };
    array.call_method1("setflags", (false,))?;
    Ok(array)
}

/// Maximum sample of a float frame; a larger one is an error, because the range is probably 0 to 255.
const MOST_FLOAT: f32 = 2.0;
/// Grey behind transparent parts, as for files.
const BEHIND: f32 = 0.5;
/// Description of supported frames.
const TAKEN: &str = "an array [height, width, 3] of uint8 or of floats in [0, 1]";

/// Returns a frame's pixels as planes `[3, H, W]`, with its height and width.
///
/// Grey frames are `[H, W]` or `[H, W, 1]`. Frames with alpha, `[H, W, 4]`, are composited over mid grey, as files are.
/// Floats of other sizes become 32 bits. Other objects that convert to NumPy arrays, such as PIL images and torch
/// tensors, are converted first; these may also have torch's layout `[3, H, W]`.
pub fn planes(frame: &Bound<'_, PyAny>) -> PyResult<(Vec<f32>, [usize; 2])> {
    let is_array = frame.is_instance_of::<PyUntypedArray>();
    if !is_array && !frame.hasattr("__array__")? && !frame.hasattr("__array_interface__")? {
        let found = frame.get_type();
        return Err(mistyped(format!("frame: expected {TAKEN}, a PIL image or a tensor, found {found}")));
    }
    let numpy = frame.py().import("numpy")?;
    let mut array = frame.clone();
    if !is_array {
        // PIL's palettes and CMYK are not RGB colours.
        let mode = frame.getattr("mode").and_then(|mode| mode.extract::<String>()).ok();
        let plain = mode.as_deref().is_none_or(|mode| ["RGB", "RGBA", "L"].contains(&mode));
        array = if plain { array } else { array.call_method1("convert", ("RGB",))? };
        array = numpy.call_method1("asarray", (array,))?;
        let shape: Vec<usize> = array.getattr("shape")?.extract()?;
        if let [3, _, width] = shape[..]
            && width != 3
        {
            array = array.call_method1("transpose", (1, 2, 0))?;
        }
    }
    let (kind, size): (char, usize) = {
        let dtype = array.getattr("dtype")?;
        (dtype.getattr("kind")?.extract()?, dtype.getattr("itemsize")?.extract()?)
    };
    if (kind, size) == ('u', 1) {
        return split(array.extract::<PyReadonlyArrayDyn<'_, u8>>()?.as_array(), |x| f32::from(x) / 255.0);
    }
    if kind != 'f' {
        let found = describe(&array);
        let fix = match kind {
            'u' => format!("; (frame / {}).astype('float32') is taken", (1_u128 << (8 * size.min(8))) - 1),
            'i' => "; frame.astype('uint8') is taken where numbers are from 0 to 255".to_owned(),
            'b' => "; frame.astype('float32') is taken".to_owned(),
            _ => String::new(),
        };
        return Err(mistyped(format!("frame: expected {TAKEN}, found {found}{fix}")));
    }
    if size != 4 {
        array = array.call_method1("astype", ("float32",))?;
    }
    aligned("frame", &array)?;
    let pixels = array.extract::<PyReadonlyArrayDyn<'_, f32>>()?;
    let (planes, size) = split(pixels.as_array(), |x| x)?;
    match planes.iter().find(|x| **x > MOST_FLOAT && x.is_finite()) {
        Some(x) => Err(wrong(format!(
            "frame: expected float32 in [0, 1] (or uint8 in 0 to 255), found {x}; frame / 255 is taken, or frame.astype('uint8')"
        ))),
        None => Ok((planes, size)),
    }
}

fn split<T: Copy>(pixels: ArrayViewD<'_, T>, value: impl Fn(T) -> f32) -> PyResult<(Vec<f32>, [usize; 2])> {
    let shape = pixels.shape().to_vec();
    let pixels = if shape.len() == 2 { pixels.insert_axis(Axis(2)) } else { pixels };
    let refused = |fix: &str| Err(wrong(format!("frame: expected [height, width, 3], found {shape:?}{fix}")));
    let Ok(pixels) = pixels.into_dimensionality::<Ix3>() else {
        return refused(if shape.first() == Some(&1) { "; frame[0] has one axis less" } else { "" });
    };
    let (height, width, channels) = pixels.dim();
    if ![1, 3, 4].contains(&channels) {
        let fix = match height {
            3 => "; frame.transpose(1, 2, 0) is taken",
            _ if channels == 2 => "; grey with alpha: frame[..., 0] is taken",
            _ => "",
        };
        return refused(fix);
    }
    // An array with strides of 0 repeats its numbers and can be huge.
    if !size_is_allowed(width, height) {
        let most = format!("1 to {MAX_SIDE} pixels a side and {MAX_PIXELS} in all");
        return Err(wrong(format!("frame: expected {most}, found {width}×{height}")));
    }
    let planes = pixels.permuted_axes([2, 0, 1]);
    let mut all = Vec::with_capacity(3 * width * height);
    for channel in 0..3 {
        let colours = planes.index_axis(Axis(0), channel.min(channels - 1));
        if channels < 4 {
            all.extend(colours.iter().map(|&x| value(x)));
        } else {
            let alphas = planes.index_axis(Axis(0), 3);
            all.extend(colours.iter().zip(&alphas).map(|(&colour, &alpha)| {
                let (colour, alpha) = (value(colour), value(alpha).clamp(0.0, 1.0));
                if alpha == 1.0 { colour } else { colour * alpha + BEHIND * (1.0 - alpha) }
            }));
        }
    }
    Ok((all, [height, width]))
}

/// Converts a depth map `[H, W]`.
pub fn depth(map: &Bound<'_, PyAny>, size: [usize; 2]) -> PyResult<Vec<f32>> {
    let Ok(values) = map.extract::<PyReadonlyArray2<'_, f32>>() else {
        return Err(mistyped(format!(
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

/// Returns an error if an array's numbers are not aligned.
fn aligned(name: &str, array: &Bound<'_, PyAny>) -> PyResult<()> {
    if array.getattr("flags")?.getattr("aligned")?.extract()? {
        return Ok(());
    }
    Err(wrong(format!(
        "{name}: expected an aligned array, found one that is not (numpy.require(x, requirements='A') makes one)"
    )))
}

/// Describes an argument for messages.
fn describe(value: &Bound<'_, PyAny>) -> String {
    let shape = value.getattr("shape").map(|s| s.to_string());
    let dtype = value.getattr("dtype").map(|d| d.to_string());
    match (shape, dtype) {
        (Ok(shape), Ok(dtype)) => format!("{shape} of {dtype}"),
        _ => value.get_type().to_string(),
    }
}
