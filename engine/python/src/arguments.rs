//! Arguments that are more than numbers: cameras, sizes, backgrounds, names.

use std::path::PathBuf;
use std::str::FromStr;

use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict, PyList, PyTuple};
use streamsplat::camera::{self, Camera, CameraPath};
use streamsplat::import::read_text;
use streamsplat::{RenderOptions, Size};

use crate::failure::{system, wrong};

/// Longest camera file read, in bytes.
const MAX_CAMERA: u64 = 16 << 20;

/// `text` as a `T`, or a `ValueError` that names the argument.
pub fn choice<T: FromStr>(name: &str, text: &str) -> PyResult<T>
where
    T::Err: std::fmt::Display,
{
    text.parse().map_err(|e| wrong(format!("{name}: {e}")))
}

/// A camera: `None`, a dictionary in the JSON form of cameras, or the path of a file of that form.
pub fn camera(value: Option<&Bound<'_, PyAny>>) -> PyResult<CameraPath> {
    let Some(value) = value else { return Ok(CameraPath::default()) };
    if let Ok(dictionary) = value.cast::<PyDict>() {
        // NumPy's numbers and arrays become Python's.
        let plain = value.py().import("operator")?.call_method1("methodcaller", ("tolist",))?;
        let named = [("default", plain)].into_py_dict(value.py())?;
        let text: String = value.py().import("json")?.call_method("dumps", (dictionary,), Some(&named))?.extract()?;
        return camera::file::parse(&text).map_err(wrong);
    }
    let file: PathBuf = value.extract().map_err(|_| {
        let kind = value.get_type();
        wrong(format!(
            "camera: expected None, a dictionary, or the path of a JSON file, found {kind}; a 4×4 matrix M is written {{'type': 'pinhole', \
             'camera_to_world': M, 'fov_y_degrees': 45, 'aspect': width / height}}"
        ))
    })?;
    let text = read_text(&file, MAX_CAMERA).map_err(|e| system(format!("{}: {e}", file.display())))?;
    camera::file::parse(&text).map_err(|e| wrong(format!("{}: {e}", file.display())))
}

/// Times and cameras of images: `time` or `camera` or both may be lists, of equal lengths; true if one is.
pub fn places(time: &Bound<'_, PyAny>, camera_at: Option<&Bound<'_, PyAny>>) -> PyResult<(Vec<(f64, Camera)>, bool)> {
    let is_list = |value: &Bound<'_, PyAny>| value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>();
    let cameras = match camera_at.filter(|value| is_list(value)) {
        Some(list) => Some(list.try_iter()?.map(|one| camera(Some(&one?))).collect::<PyResult<Vec<_>>>()?),
        None => None,
    };
    let times = match time.extract::<f64>() {
        Ok(time) => Err(time),
        Err(_) => Ok(time
            .extract::<Vec<f64>>()
            .map_err(|_| wrong(format!("time: expected seconds or a list of them, found {time}")))?),
    };
    match (times, cameras) {
        (Err(time), None) => Ok((vec![(time, camera(camera_at)?.at(time))], false)),
        (Err(time), Some(cameras)) => Ok((cameras.iter().map(|camera| (time, camera.at(time))).collect(), true)),
        (Ok(times), None) => {
            let camera = camera(camera_at)?;
            Ok((times.into_iter().map(|time| (time, camera.at(time))).collect(), true))
        }
        (Ok(times), Some(cameras)) if times.len() == cameras.len() => {
            Ok((times.into_iter().zip(cameras).map(|(time, camera)| (time, camera.at(time))).collect(), true))
        }
        (Ok(times), Some(cameras)) => {
            let message = format!("camera: expected as many as times, {}, found {}", times.len(), cameras.len());
            Err(wrong(message))
        }
    }
}

/// Options of an image, from `size` ("model", "source" or (width, height)) and `background` (grey, or red, green, blue).
pub fn options(
    size: Option<&Bound<'_, PyAny>>,
    background: Option<&Bound<'_, PyAny>>,
    depth: bool,
    alpha: bool,
) -> PyResult<RenderOptions> {
    let mut options = RenderOptions { depth, alpha, ..RenderOptions::default() };
    if let Some(size) = size {
        options.size = match (size.extract::<String>().as_deref(), size.extract::<(usize, usize)>()) {
            (Ok("model"), _) => Size::Model,
            (Ok("source"), _) => Size::Source,
            (_, Ok((width, height))) => Size::Exact { width, height },
            _ => return Err(wrong(format!("size: expected 'model', 'source' or (width, height), found {size}"))),
        };
    }
    if let Some(background) = background {
        let colour = background.extract::<[f32; 3]>().or_else(|_| background.extract::<f32>().map(|grey| [grey; 3]));
        options.background = match colour {
            Ok(colour) if colour.iter().all(|c| (0.0..=1.0).contains(c)) => colour,
            _ => {
                return Err(wrong(format!(
                    "background: expected a number or three, each from 0 to 1, found {background}"
                )));
            }
        };
    }
    Ok(options)
}
