//! Cameras from matrices, and from files of other programs.

use std::path::PathBuf;

use numpy::ndarray::{Array2, ArrayView2};
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use streamsplat::camera::{CameraPath, Lens, Pose, Rotation};
use streamsplat::formats;
use streamsplat::formats::cameras::{CameraFile, SizedCamera};
use streamsplat::picture::{MAX_PIXELS, MAX_SIDE, size_is_allowed};

use crate::arguments;
use crate::failure::{no_cameras, present, wrong};

/// A view of a scene: a pose, a lens, and the size of its image in pixels, if it has one.
///
/// `Camera(viewmat, K, width, height)` takes gsplat's matrices. `viewmat` [4, 4] maps the world to the camera, which
/// looks along +z with +x to the right and +y down. `K` [3, 3] is in pixels, counted from the corner of the first one.
/// `cameras(path)` reads the files of other programs.
#[pyclass(frozen, module = "streamsplat_cpu")]
#[derive(Clone)]
pub struct Camera {
    pub inner: streamsplat::Camera,
    /// Width and height.
    pub size: Option<[usize; 2]>,
    name: String,
    time: Option<f64>,
}

impl From<SizedCamera> for Camera {
    fn from(sized: SizedCamera) -> Self {
        Camera { inner: sized.camera, size: Some(sized.size), name: String::new(), time: None }
    }
}

impl Camera {
    /// Returns a scene's own camera, for images of `size`.
    pub fn sized(inner: streamsplat::Camera, size: [usize; 2]) -> Self {
        SizedCamera { camera: inner, size }.into()
    }

    fn posed(&self) -> PyResult<(&Pose, &Lens)> {
        match &self.inner {
            streamsplat::Camera::Posed { pose, lens } => Ok((pose, lens)),
            streamsplat::Camera::Canonical => {
                Err(wrong("camera: expected one with a pose, found canonical, the source's own view"))
            }
        }
    }
}

/// Returns the numbers of a matrix, from anything that NumPy converts.
fn matrix<const N: usize>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[[f64; N]; N]> {
    let numpy = value.py().import("numpy")?;
    let array = numpy.call_method1("asarray", (value, "float64"))?;
    let found = || -> PyResult<PyErr> {
        let shape = array.getattr("shape")?;
        Ok(wrong(format!("{name}: expected a matrix [{N}, {N}], found the shape {shape}")))
    };
    let Ok(numbers) = array.extract::<PyReadonlyArray2<'_, f64>>() else { return Err(found()?) };
    let view: ArrayView2<'_, f64> = numbers.as_array();
    if view.dim() != (N, N) {
        return Err(found()?);
    }
    if let Some(x) = view.iter().find(|x| !x.is_finite()) {
        return Err(wrong(format!("{name}: expected finite numbers, found {x}")));
    }
    Ok(std::array::from_fn(|i| std::array::from_fn(|j| view[[i, j]])))
}

/// Returns an image's size, if it is valid.
fn checked(width: usize, height: usize) -> PyResult<[usize; 2]> {
    if size_is_allowed(width, height) {
        return Ok([width, height]);
    }
    let most = format!("1 to {MAX_SIDE} pixels a side and {MAX_PIXELS} in all");
    Err(wrong(format!("width, height: expected {most}, found {width}×{height}")))
}

fn array<const N: usize>(py: Python<'_>, rows: [[f64; N]; N]) -> Bound<'_, PyArray2<f32>> {
    Array2::from_shape_fn((N, N), |(i, j)| rows[i][j] as f32).into_pyarray(py)
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (viewmat, K, width, height, *, name=""))]
    #[expect(non_snake_case, reason = "K is the matrix's name everywhere")]
    fn new(
        viewmat: &Bound<'_, PyAny>,
        K: &Bound<'_, PyAny>,
        width: usize,
        height: usize,
        name: &str,
    ) -> PyResult<Self> {
        let rows = matrix::<4>("viewmat", viewmat)?;
        let [[fx, skew, cx], [other, fy, cy], last] = matrix::<3>("K", K)?;
        let size = checked(width, height)?;
        if skew != 0.0 || other != 0.0 || last != [0.0, 0.0, 1.0] {
            let [a, b, c] = last;
            return Err(wrong(format!(
                "K: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], found {skew} and {other} in place of the zeros and [{a}, {b}, {c}] below"
            )));
        }
        if !(fx > 0.0 && fy > 0.0) {
            return Err(wrong(format!("K: expected focal lengths above 0, found {fx} and {fy}")));
        }
        // Its rows are the camera's axes in the world.
        let axis = |i: usize| [rows[i][0], rows[i][1], rows[i][2]];
        let rotation = Rotation::from_columns([axis(0), axis(1), axis(2)]);
        let Some(rotation) = rotation.filter(|_| rows[3] == [0.0, 0.0, 0.0, 1.0]) else {
            let expected =
                "a rotation (orthonormal, right-handed), a translation in the last column, and 0, 0, 0, 1 below";
            return Err(wrong(format!("viewmat: expected {expected}, found another matrix")));
        };
        let position = std::array::from_fn(|k| -(0..3).map(|i| axis(i)[k] * rows[i][3]).sum::<f64>());
        let [w, h] = [width, height].map(|side| side as f64);
        let lens = Lens::Pinhole { focal: [fx / w, fy / h], centre: [cx / w, cy / h] };
        let inner = streamsplat::Camera::Posed { pose: Pose { position, rotation }, lens };
        Ok(Camera { inner, size: Some(size), name: name.to_owned(), time: None })
    }

    /// Returns a pinhole at `position` that looks at `target`, with `up` upwards in its image and a vertical field of
    /// view of `fov_y` degrees.
    #[staticmethod]
    #[pyo3(signature = (position, target, *, up=[0.0, -1.0, 0.0], fov_y=45.0, width=1280, height=720))]
    fn look_at(
        position: [f64; 3],
        target: [f64; 3],
        up: [f64; 3],
        fov_y: f64,
        width: usize,
        height: usize,
    ) -> PyResult<Self> {
        let size = checked(width, height)?;
        let pose = Pose::look_at(position, target, up).ok_or_else(|| {
            wrong(format!("target: expected a point apart from {position:?}, not straight along up, found {target:?}"))
        })?;
        let inner = streamsplat::Camera::pinhole(pose, fov_y, width as f64 / height as f64)
            .ok_or_else(|| wrong(format!("fov_y: expected degrees between 0 and 180, found {fov_y}")))?;
        Ok(Camera::sized(inner, size))
    }

    /// Returns the camera for an image of another size: the same view, with K scaled.
    fn resized(&self, width: usize, height: usize) -> PyResult<Self> {
        Ok(Camera { size: Some(checked(width, height)?), ..self.clone() })
    }

    /// The matrix from the world to the camera, float32 [4, 4].
    #[getter]
    fn viewmat<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let (pose, _) = self.posed()?;
        let turn = pose.rotation.inverse().matrix();
        let [x, y, z] = pose.position;
        let rows = std::array::from_fn(|i| {
            if i == 3 {
                return [0.0, 0.0, 0.0, 1.0];
            }
            let [a, b, c] = turn[i];
            [a, b, c, -(a * x + b * y + c * z)]
        });
        Ok(array::<4>(py, rows))
    }

    /// Focal lengths and principal point in pixels, counted from the corner of the first one, float32 [3, 3]. For
    /// orthographic cameras: pixels per unit.
    #[getter]
    #[pyo3(name = "K")]
    fn intrinsics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let (_, lens) = self.posed()?;
        let size = self.size.ok_or_else(|| {
            wrong("K: expected a camera with the size of its image, found none: camera.resized(width, height) has one")
        })?;
        let [w, h] = size.map(|side| side as f64);
        let (focal, centre) = match *lens {
            Lens::Pinhole { focal, centre } => ([focal[0] * w, focal[1] * h], [centre[0] * w, centre[1] * h]),
            Lens::Orthographic { half_extent } => {
                let [x, y] = half_extent.unwrap_or([w / h, 1.0]);
                ([0.5 * w / x, 0.5 * h / y], [0.5 * w, 0.5 * h])
            }
            Lens::Equirectangular => {
                return Err(wrong("K: expected a pinhole or parallel rays, found a camera that sees all around"));
            }
        };
        Ok(array::<3>(py, [[focal[0], 0.0, centre[0]], [0.0, focal[1], centre[1]], [0.0, 0.0, 1.0]]))
    }

    /// Its position in the world.
    #[getter]
    fn position(&self) -> PyResult<(f64, f64, f64)> {
        let [x, y, z] = self.posed()?.0.position;
        Ok((x, y, z))
    }

    /// Width and height of its image in pixels; None if its file has none.
    #[getter]
    fn size(&self) -> Option<(usize, usize)> {
        self.size.map(|[width, height]| (width, height))
    }

    /// Name of its image in the file; empty if it has none.
    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// Its time in seconds, if the file is a path or belongs to a video; else None.
    #[getter]
    fn time(&self) -> Option<f64> {
        self.time
    }

    /// "pinhole", "orthographic", "equirectangular" or "canonical".
    #[getter]
    fn kind(&self) -> &'static str {
        match &self.inner {
            streamsplat::Camera::Canonical => "canonical",
            streamsplat::Camera::Posed { lens, .. } => match lens {
                Lens::Pinhole { .. } => "pinhole",
                Lens::Orthographic { .. } => "orthographic",
                Lens::Equirectangular => "equirectangular",
            },
        }
    }

    fn __repr__(&self) -> String {
        let name = if self.name.is_empty() { String::new() } else { format!("{}, ", self.name) };
        let size = self.size.map(|[width, height]| format!(", {width}×{height}")).unwrap_or_default();
        let place = self.position().map(|(x, y, z)| format!(" at ({x:.4}, {y:.4}, {z:.4})")).unwrap_or_default();
        format!("Camera({name}{}{place}{size})", self.kind())
    }
}

/// Returns the cameras of a file or a folder, in its order. Supported are this program's own JSON, cameras.json of 3D
/// Gaussian splatting, transforms.json of nerfstudio, instant-ngp and Blender, nerfstudio's camera_path.json,
/// SuperSplat's settings.json, and COLMAP models (docs/cameras.md). `size` ("WIDTHxHEIGHT" or (width, height)) is used
/// for files without one.
#[pyfunction]
#[pyo3(signature = (path, *, size=None))]
pub fn cameras(py: Python<'_>, path: PathBuf, size: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<Camera>> {
    let size = size.map(arguments::pixels).transpose()?;
    present(&path)?;
    let file = py.detach(|| formats::cameras::open(&path, size)).map_err(no_cameras)?;
    let set = match file {
        CameraFile::Own(own) => {
            let several = own.views().len() > 1;
            let camera = |(time, inner): &(f64, streamsplat::Camera)| Camera {
                inner: *inner,
                size,
                name: String::new(),
                time: several.then_some(*time),
            };
            return Ok(own.views().iter().map(camera).collect());
        }
        CameraFile::Set(set) => set,
    };
    let video = set.rate.is_some();
    let all = set.cameras.iter().enumerate().map(|(i, named)| {
        let sized = named.camera.clone().map_err(|e| wrong(format!("{}: {}: {e}", path.display(), named.name)))?;
        let size = size.unwrap_or(sized.size);
        let time = video.then(|| set.time(i));
        Ok(Camera { name: named.name.clone(), time, ..Camera::sized(sized.camera, size) })
    });
    all.collect()
}

/// Reads one camera of a file: a path of this program's own, or the only camera of another's.
pub fn of_file(path: &std::path::Path) -> PyResult<(CameraPath, Option<[usize; 2]>)> {
    present(path)?;
    match formats::cameras::open(path, None).map_err(no_cameras)? {
        CameraFile::Own(own) => Ok((own, None)),
        CameraFile::Set(set) if set.cameras.len() == 1 => {
            let sized = set.cameras[0].camera.clone().map_err(|e| wrong(format!("{}: {e}", path.display())))?;
            Ok((sized.camera.into(), Some(sized.size)))
        }
        CameraFile::Set(set) => {
            let (path, count) = (path.display(), set.cameras.len());
            Err(wrong(format!(
                "camera: expected one, found the {count} of {path}: render(cameras({path:?})) draws them"
            )))
        }
    }
}
