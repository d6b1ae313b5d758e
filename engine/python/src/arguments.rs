//! Conversion of arguments: cameras, sizes, backgrounds, names.

use std::path::PathBuf;
use std::str::FromStr;

use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict, PyList, PyString, PyTuple};
use streamsplat::camera::{self, CameraPath};
use streamsplat::{RenderOptions, Size};

use crate::camera::{Camera, of_file};
use crate::failure::{mistyped, wrong};

/// Parses `text` as a `T`; or returns a `ValueError` that names the argument.
pub fn choice<T: FromStr>(name: &str, text: &str) -> PyResult<T>
where
    T::Err: std::fmt::Display,
{
    text.parse().map_err(|e| wrong(format!("{name}: {e}")))
}

/// A camera path, with the size of its image (width and height), if it has one.
struct Seen {
    path: CameraPath,
    size: Option<[usize; 2]>,
}

/// Converts a camera: `None`, a `Camera`, a dictionary in the JSON form of cameras, or the path of a file with one.
fn camera(value: Option<&Bound<'_, PyAny>>) -> PyResult<Seen> {
    let Some(value) = value.filter(|value| !value.is_none()) else {
        return Ok(Seen { path: CameraPath::default(), size: None });
    };
    if let Ok(camera) = value.cast::<Camera>() {
        let camera = camera.get();
        return Ok(Seen { path: camera.inner.into(), size: camera.size });
    }
    if let Ok(dictionary) = value.cast::<PyDict>() {
        // NumPy's numbers and arrays become Python's.
        let plain = value.py().import("operator")?.call_method1("methodcaller", ("tolist",))?;
        let named = [("default", plain)].into_py_dict(value.py())?;
        let text: String = value.py().import("json")?.call_method("dumps", (dictionary,), Some(&named))?.extract()?;
        return Ok(Seen { path: camera::file::parse(&text).map_err(wrong)?, size: None });
    }
    let file: PathBuf = value.extract().map_err(|_| {
        let kind = value.get_type();
        mistyped(format!(
            "camera: expected a Camera, None, a dictionary, or the path of a file with one, found {kind}; of a 4×4 matrix from the world to the camera \
             it is Camera(viewmat, K, width, height)"
        ))
    })?;
    let (path, size) = of_file(&file)?;
    Ok(Seen { path, size })
}

/// Time and camera of an image.
pub struct Place {
    pub time: f64,
    pub camera: streamsplat::Camera,
    /// Width and height of the camera's image, if it has them.
    pub size: Option<[usize; 2]>,
}

impl Place {
    /// Returns the options of this image: `options`, with the camera's own size if none was given.
    pub fn options(&self, options: &RenderOptions, given: bool) -> RenderOptions {
        match self.size.filter(|_| !given) {
            Some([width, height]) => RenderOptions { size: Size::Exact { width, height }, ..*options },
            None => *options,
        }
    }
}

fn is_list(value: &Bound<'_, PyAny>) -> bool {
    value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>()
}

/// Returns true for a camera, and for a list that begins with one.
pub fn is_camera(value: &Bound<'_, PyAny>) -> bool {
    let one = |value: &Bound<'_, PyAny>| {
        value.is_instance_of::<Camera>()
            || value.is_instance_of::<PyDict>()
            || value.is_instance_of::<PyString>()
            || value.hasattr("__fspath__").unwrap_or(false)
    };
    one(value) || is_list(value) && value.get_item(0).is_ok_and(|first| one(&first))
}

/// Returns the times and cameras of images. `time` or `camera` or both may be lists, of equal lengths; the flag is true
/// if one is.
pub fn places(time: &Bound<'_, PyAny>, camera_at: Option<&Bound<'_, PyAny>>) -> PyResult<(Vec<Place>, bool)> {
    let times = match time.extract::<f64>() {
        Ok(time) => Err(time),
        Err(_) => Ok(time.extract::<Vec<f64>>().map_err(|_| {
            let hint = if time.hasattr("ndim").unwrap_or(false) {
                "; a matrix is Camera(viewmat, K, width, height)"
            } else {
                ""
            };
            mistyped(format!("time: expected seconds or a list of them, found {time}{hint}"))
        })?),
    };
    at(times, camera_at)
}

/// Returns cameras as [`places`] does, for a scene that does not change.
pub fn cameras(camera_at: Option<&Bound<'_, PyAny>>) -> PyResult<(Vec<Place>, bool)> {
    at(Err(0.0), camera_at)
}

/// Returns images at one time (`Err`) or at several.
fn at(times: Result<Vec<f64>, f64>, camera_at: Option<&Bound<'_, PyAny>>) -> PyResult<(Vec<Place>, bool)> {
    let seen = match camera_at.filter(|value| is_list(value)) {
        Some(list) => Some(list.try_iter()?.map(|one| camera(Some(&one?))).collect::<PyResult<Vec<_>>>()?),
        None => None,
    };
    let place = |time: f64, seen: &Seen| Place { time, camera: seen.path.at(time), size: seen.size };
    match (times, seen) {
        (Err(time), None) => Ok((vec![place(time, &camera(camera_at)?)], false)),
        (Err(time), Some(all)) => Ok((all.iter().map(|seen| place(time, seen)).collect(), true)),
        (Ok(times), None) => {
            let seen = camera(camera_at)?;
            Ok((times.into_iter().map(|time| place(time, &seen)).collect(), true))
        }
        (Ok(times), Some(all)) if times.len() == all.len() => {
            Ok((times.into_iter().zip(&all).map(|(time, seen)| place(time, seen)).collect(), true))
        }
        (Ok(times), Some(all)) => {
            Err(wrong(format!("camera: expected as many as times, {}, found {}", times.len(), all.len())))
        }
    }
}

/// Parses a size: "model", "source", "WIDTHxHEIGHT" or (width, height).
fn sides(size: &Bound<'_, PyAny>) -> PyResult<Size> {
    if let Ok(text) = size.extract::<String>() {
        return choice("size", &text);
    }
    match size.extract::<(usize, usize)>() {
        Ok((width, height)) => Ok(Size::Exact { width, height }),
        Err(_) => {
            let expected = "'model', 'source', 'WIDTHxHEIGHT' or (width, height)";
            Err(mistyped(format!("size: expected {expected}, found {size}")))
        }
    }
}

/// Parses width and height in pixels: "WIDTHxHEIGHT" or (width, height).
pub fn pixels(size: &Bound<'_, PyAny>) -> PyResult<[usize; 2]> {
    match sides(size)? {
        Size::Exact { width, height } if width > 0 && height > 0 => Ok([width, height]),
        _ => Err(wrong(format!("size: expected 'WIDTHxHEIGHT' or (width, height) above 0, found {size}"))),
    }
}

/// Returns the options of an image, from `size` ("model", "source", "WIDTHxHEIGHT" or (width, height)) and `background`
/// (grey, or red, green, blue).
pub fn options(
    size: Option<&Bound<'_, PyAny>>,
    background: Option<&Bound<'_, PyAny>>,
    depth: bool,
    alpha: bool,
) -> PyResult<RenderOptions> {
    let mut options = RenderOptions { depth, alpha, ..RenderOptions::default() };
    if let Some(size) = size {
        options.size = sides(size)?;
    }
    if let Some(background) = background {
        let colour = background.extract::<[f32; 3]>().or_else(|_| background.extract::<f32>().map(|grey| [grey; 3]));
        options.background = match colour {
            Ok(colour) if colour.iter().all(|c| (0.0..=1.0).contains(c)) => colour,
            Ok(_) => {
                let expected = "a number or three, each from 0 to 1";
                return Err(wrong(format!("background: expected {expected}, found {background}")));
            }
            Err(_) => return Err(mistyped(format!("background: expected a number or three, found {background}"))),
        };
    }
    Ok(options)
}
