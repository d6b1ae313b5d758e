//! Gaussians in the world at one time, in the form that renderers use.

use std::borrow::Cow;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use numpy::ndarray::{ArrayView1, ArrayView2, ArrayView3, ArrayViewD};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArrayDyn};
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use streamsplat::camera::Rotation;
use streamsplat::formats::{FORMATS, Format, Limits, Options};
use streamsplat::output::{picture_png, write_file};
use streamsplat::picture::Picture;
use streamsplat::render::Renderer;
use streamsplat::render::turn::Angles;
use streamsplat::still::{Drawable, Framing, GAUSSIANS, Still, Values};
use streamsplat::stream::Workers;
use streamsplat::{RenderOptions, Size};
use streamsplat_kernels::{Level, harmonics};

use crate::arguments::{self, Place};
use crate::arrays::borrowed;
use crate::camera::Camera;
use crate::failure::{failed, mistyped, not_drawn, not_written, wrong};
use crate::image::{Drawn, Image};

/// Default image size.
pub const SIZE: [usize; 2] = [1280, 720];
/// Size of a picture in a notebook.
pub const SHOWN: [usize; 2] = [640, 360];
/// Number of images from which Gaussians are grouped.
const MANY: usize = 8;

/// Gaussians in the world at one time: the values of a splat file, as read-only arrays for gsplat, viser, Rerun and
/// nerfstudio.
///
/// Units are square; axes are those of docs/cameras.md, x to the right, y down and z to the front. `Splats(means,
/// scales, opacities, quats=…, colors=…)` is made from arrays or tensors: `colors` [N, 3] do not depend on the
/// direction, `sh` [N, K, 3] are coefficients of harmonics (K = 1, 4, 9 or 16).
#[pyclass(frozen, module = "streamsplat_cpu")]
pub struct Splats {
    pub scene: Arc<Drawable>,
    identities: Vec<u64>,
    quats: OnceLock<Vec<[f32; 4]>>,
    colors: OnceLock<Vec<[f32; 3]>>,
    coefficients: OnceLock<Vec<f32>>,
    /// Threads that draw it: those of its scene or interval. If made from arrays, it has its own from its first image
    /// on.
    workers: OnceLock<Workers>,
}

impl Splats {
    /// Returns the Gaussians of a still scene, numbered unless they have identities.
    pub fn new(still: Still, identities: Option<Vec<u64>>, workers: &Workers) -> PyResult<Self> {
        let identities = identities.unwrap_or_else(|| (0..still.len() as u64).collect());
        let scene = Drawable::new(still, workers).map_err(failed)?;
        Ok(Self::of(Arc::new(scene), identities, OnceLock::from(workers.clone())))
    }

    fn of(scene: Arc<Drawable>, identities: Vec<u64>, workers: OnceLock<Workers>) -> Self {
        let (quats, colors, coefficients) = (OnceLock::new(), OnceLock::new(), OnceLock::new());
        Self { scene, identities, quats, colors, coefficients, workers }
    }

    fn still(&self) -> &Still {
        self.scene.still()
    }

    pub fn workers(&self) -> PyResult<&Workers> {
        if let Some(workers) = self.workers.get() {
            return Ok(workers);
        }
        let workers = Workers::new(Level::detect(), 0).map_err(failed)?;
        Ok(self.workers.get_or_init(|| workers))
    }

    pub fn framing(&self) -> PyResult<Framing> {
        let found = format!("{} Gaussians", self.still().len());
        self.still().framing().ok_or_else(|| {
            wrong(format!(
                "camera: expected one, as there is nothing to look at, found {found}, none at a finite place"
            ))
        })
    }

    /// Draws images from these places; the default is the scene's own camera.
    pub fn draw(
        &self,
        py: Python<'_>,
        places: &[Place],
        own_view: bool,
        options: &RenderOptions,
        given: bool,
        antialias: Option<bool>,
    ) -> PyResult<Vec<Image>> {
        let antialias = antialias.unwrap_or(self.still().about.antialiased);
        let [width, height] = SIZE;
        let size = if given { options.size } else { Size::Exact { width, height } };
        let options = RenderOptions { antialias, size, ..*options };
        let workers = self.workers()?;
        let mut empty = 0;
        let images: PyResult<Vec<Image>> = py.detach(|| {
            let mut scene = Cow::Borrowed(&*self.scene);
            if places.len() >= MANY {
                scene = Cow::Owned(self.scene.as_ref().clone().grouped(workers));
            }
            let mut renderer = Renderer::new(workers);
            let mut draw = |place: &Place| {
                let options = place.options(&options, given);
                let camera = match (own_view, options.size) {
                    (true, Size::Exact { width, height }) if height > 0 => {
                        self.framing()?.camera(0.0, width as f64 / height as f64)
                    }
                    _ => place.camera,
                };
                let image = Image::from(renderer.render_still(&scene, &camera, &options).map_err(not_drawn)?.clone());
                empty += usize::from(renderer.work().entries == 0);
                Ok(image)
            };
            places.iter().map(&mut draw).collect()
        });
        if empty > 0 {
            let of = if places.len() == 1 { String::new() } else { format!(" in {empty} of {} images", places.len()) };
            let seen = "a matrix is one from the world to the camera";
            warn(
                py,
                &[format!("nothing drawn{of}: the camera sees none of {} Gaussians ({seen})", self.still().len())],
            )?;
        }
        images
    }

    /// Draws a PNG of the scene's own view.
    pub fn picture<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let [width, height] = SHOWN;
        let camera = self.framing()?.camera(0.0, width as f64 / height as f64);
        let antialias = self.still().about.antialiased;
        let options = RenderOptions { size: Size::Exact { width, height }, antialias, ..RenderOptions::default() };
        let workers = self.workers()?;
        let image = py.detach(|| self.scene.render(&camera, &options, workers)).map_err(not_drawn)?;
        let streamsplat::Image { width, height, rgb, .. } = image;
        Ok(PyBytes::new(py, &picture_png(&Picture { width, height, rgb })))
    }
}

/// Returns the format by a name's ending.
pub fn format_of(path: &std::path::Path) -> PyResult<&'static Format> {
    Format::of_name(path).ok_or_else(|| {
        let endings: Vec<String> = FORMATS.iter().map(|format| format!(".{}", format.ending)).collect();
        wrong(format!("path: expected a name ending in {}, found {}", endings.join(", "), path.display()))
    })
}

/// Warns about content that a file does not hold.
pub fn warn(py: Python<'_>, notes: &[String]) -> PyResult<()> {
    let category = py.get_type::<PyUserWarning>();
    notes.iter().try_for_each(|note| {
        let text = std::ffi::CString::new(note.as_str()).unwrap_or_default();
        PyErr::warn(py, &category, &text, 1)
    })
}

/// Returns rows of `N` numbers, from anything that NumPy converts to an array `[rows, N]` (`[rows]` if N is 1).
fn rows<const N: usize>(name: &str, value: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<[f32; N]>> {
    let Some(value) = value else { return Ok(Vec::new()) };
    let array = numbers(name, value)?;
    let view = array.as_array();
    let shape = view.shape();
    let fits = match shape {
        [_] => N == 1,
        [_, rest @ ..] => N > 1 && rest == [N],
        [] => false,
    };
    if !fits {
        let expected = if N == 1 { "[N]".to_owned() } else { format!("[N, {N}]") };
        return Err(wrong(format!("{name}: expected an array {expected}, found the shape {shape:?}")));
    }
    Ok(table(&view))
}

/// Converts to an array of 32-bit floats.
fn numbers<'py>(name: &str, value: &Bound<'py, PyAny>) -> PyResult<PyReadonlyArrayDyn<'py, f32>> {
    let numpy = value.py().import("numpy")?;
    // The error for tensors on a graphics card, or in a graph, contains advice.
    let array =
        numpy.call_method1("asarray", (value,)).map_err(|e| mistyped(format!("{name}: {}", e.value(value.py()))))?;
    let kind: char = array.getattr("dtype")?.getattr("kind")?.extract()?;
    if !"fiu".contains(kind) {
        let found = array.getattr("dtype")?;
        return Err(mistyped(format!("{name}: expected numbers, found {found}")));
    }
    // Checked before an array with strides of 0 is copied.
    let shape: Vec<usize> = array.getattr("shape")?.extract()?;
    if let Some(found) = shape.first().filter(|rows| **rows > GAUSSIANS) {
        return Err(wrong(format!("{name}: expected at most {GAUSSIANS} Gaussians, found {found}")));
    }
    // float64 becomes float32; unaligned arrays become aligned.
    let array = numpy.call_method1("require", (array, "float32", "CA"))?;
    array.extract()
}

/// Returns its numbers in groups of `N`.
fn table<const N: usize>(view: &ArrayViewD<'_, f32>) -> Vec<[f32; N]> {
    let mut all = view.iter().copied();
    (0..view.len() / N).map(|_| std::array::from_fn(|_| all.next().unwrap_or_default())).collect()
}

#[pymethods]
impl Splats {
    #[new]
    #[pyo3(signature = (means, scales, opacities, *, quats=None, colors=None, sh=None))]
    fn of_arrays(
        means: &Bound<'_, PyAny>,
        scales: &Bound<'_, PyAny>,
        opacities: &Bound<'_, PyAny>,
        quats: Option<&Bound<'_, PyAny>>,
        colors: Option<&Bound<'_, PyAny>>,
        sh: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        if colors.is_some() == sh.is_some() {
            let found = if sh.is_some() { "both" } else { "neither" };
            return Err(wrong(format!("colors, sh: expected one of the two, found {found}")));
        }
        let mean = rows::<3>("means", Some(means))?;
        if mean.is_empty() {
            return Err(wrong("means: expected at least one Gaussian, found none"));
        }
        let opacity = rows::<1>("opacities", Some(opacities))?.into_iter().map(|[o]| o).collect();
        let (mut degree, mut coefficients) = (0, Vec::new());
        if let Some(sh) = sh {
            let array = numbers("sh", sh)?;
            let view = array.as_array();
            let found = match *view.shape() {
                [_, each, 3] => (0..=3).find(|degree| 1 + harmonics::rest(*degree) == each),
                _ => None,
            };
            let shape = view.shape();
            degree = found.ok_or_else(|| {
                wrong(format!("sh: expected an array [N, K, 3] with K of 1, 4, 9 or 16, found the shape {shape:?}"))
            })?;
            coefficients = table(&view);
        }
        let values = Values {
            mean,
            scale: rows("scales", Some(scales))?,
            rotation: rows("quats", quats)?,
            opacity,
            rgb: rows("colors", colors)?,
            degree,
            harmonics: coefficients,
        };
        let still = Still::of_values(values).map_err(|error| wrong(renamed(error.to_string())))?;
        let workers = Workers::new(Level::detect(), 0).map_err(failed)?;
        Self::new(still, None, &workers)
    }

    /// Reads the still scene of a file in memory. `name` is the file's: `.splat` and `.ksplat` are recognised by its
    /// ending.
    #[staticmethod]
    #[pyo3(signature = (data, name=""))]
    fn of_bytes(py: Python<'_>, data: &[u8], name: &str) -> PyResult<Self> {
        let workers = Workers::new(Level::detect(), 0).map_err(failed)?;
        let still = py.detach(|| streamsplat::formats::read(data, name, &Limits::default())).map_err(failed)?;
        Self::new(still, None, &workers)
    }

    fn __len__(&self) -> usize {
        self.still().len()
    }

    /// Centres, float32 [N, 3], relative to `offset`.
    #[getter]
    fn means<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        // SAFETY: the scene belongs to the object, which is frozen: it is neither moved nor written while it lives.
        unsafe { borrowed(&ArrayView2::from(this.get().still().mean.as_slice()), this.clone().into_any()) }
    }

    /// Rotations as unit quaternions (w, x, y, z), float32 [N, 4]. NaN if the file's quaternion is 0; these Gaussians
    /// are not drawn.
    #[getter]
    fn quats<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let own = this.get();
        let all = || (0..own.still().len()).map(|i| own.scene.rotation(i).map(|c| c as f32)).collect();
        let quats = own.quats.get_or_init(all);
        // SAFETY: as in `means`; the cell is written once.
        unsafe { borrowed(&ArrayView2::from(quats.as_slice()), this.clone().into_any()) }
    }

    /// Standard deviations along the Gaussians' own axes, float32 [N, 3].
    #[getter]
    fn scales<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        // SAFETY: as in `means`.
        unsafe { borrowed(&ArrayView2::from(this.get().scene.scale()), this.clone().into_any()) }
    }

    /// Covariances R·diag(s²)·Rᵀ, float32 [N, 3, 3], as required by viser. Computed in binary64, sums from left to
    /// right, rounded once. A copy.
    #[getter]
    fn covariances<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let all = py.detach(|| {
            let mut all = Vec::with_capacity(9 * self.still().len());
            for (i, scale) in self.scene.scale().iter().enumerate() {
                let turn = Rotation::from_quaternion(self.scene.rotation(i)).map(|rotation| rotation.matrix());
                let rows = turn.unwrap_or([[f64::NAN; 3]; 3]);
                let [a, b, c] = scale.map(|s| f64::from(s) * f64::from(s));
                let sum = |x: [f64; 3], y: [f64; 3]| (x[0] * a * y[0] + x[1] * b * y[1] + x[2] * c * y[2]) as f32;
                all.extend(rows.iter().flat_map(|x| rows.map(|y| sum(*x, y))));
            }
            all
        });
        all.into_pyarray(py).reshape([self.still().len(), 3, 3])
    }

    /// Opacities, float32 [N].
    #[getter]
    fn opacities<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray1<f32>>> {
        // SAFETY: as in `means`.
        unsafe { borrowed(&ArrayView1::from(this.get().scene.opacity()), this.clone().into_any()) }
    }

    /// Display-space colours, float32 [N, 3]: ½ + Y₀·`sh[:, 0]`, which is the mean over all directions; not clamped.
    #[getter]
    fn colors<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let own = this.get();
        let colour = |c: f32| (0.5 + harmonics::Y0 * f64::from(c)) as f32;
        let all = || own.still().base.iter().map(|base| base.map(colour)).collect();
        let colors = own.colors.get_or_init(all);
        // SAFETY: as in `quats`.
        unsafe { borrowed(&ArrayView2::from(colors.as_slice()), this.clone().into_any()) }
    }

    /// Coefficients of the harmonics, float32 [N, K, 3] with K = (`sh_degree` + 1)², the first among them.
    #[getter]
    fn sh<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let own = this.get();
        let (still, width) = (own.still(), 3 * own.still().rest());
        let row = |i: usize| still.base[i].iter().chain(&still.higher[i * width..(i + 1) * width]);
        let all = own.coefficients.get_or_init(|| (0..still.len()).flat_map(row).copied().collect());
        let view = ArrayView3::from_shape((still.len(), 1 + still.rest(), 3), all).map_err(failed)?;
        // SAFETY: as in `quats`.
        unsafe { borrowed(&view, this.clone().into_any()) }
    }

    /// Degree of the harmonics, 0 to 3.
    #[getter]
    fn sh_degree(&self) -> usize {
        self.still().degree
    }

    /// Numbers of the Gaussians, uint64 [N]: in a video's scene the identity, which lasts from interval to interval,
    /// else the index.
    #[getter]
    fn identities<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray1<u64>>> {
        // SAFETY: as in `means`.
        unsafe { borrowed(&ArrayView1::from(&this.get().identities), this.clone().into_any()) }
    }

    /// True for Gaussians that can be drawn, bool [N]: finite numbers, and a valid rotation. A copy.
    #[getter]
    fn drawable<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        PyArray1::from_iter(py, (0..self.still().len()).map(|i| self.still().defect(i).is_none()))
    }

    /// Origin of `means`: not 0 for maps, whose coordinates binary32 would round.
    #[getter]
    fn offset(&self) -> (f64, f64, f64) {
        let [x, y, z] = self.still().about.offset;
        (x, y, z)
    }

    /// True if the scene was trained with anti-aliasing, by its file's mark.
    #[getter]
    fn antialiased(&self) -> bool {
        self.still().about.antialiased
    }

    /// Draws an image, or a list of images if `camera` is a list.
    ///
    /// `camera` is a Camera, a dictionary in the JSON form of cameras, or the path of a file with one; the default
    /// frames the scene. `size` is "WIDTHxHEIGHT" or (width, height), by default the camera's, else 1280×720.
    /// `antialias` is by default the file's setting.
    #[pyo3(signature = (camera=None, *, size=None, background=None, depth=false, alpha=false, antialias=None))]
    fn render(
        &self,
        py: Python<'_>,
        camera: Option<&Bound<'_, PyAny>>,
        size: Option<&Bound<'_, PyAny>>,
        background: Option<&Bound<'_, PyAny>>,
        depth: bool,
        alpha: bool,
        antialias: Option<bool>,
    ) -> PyResult<Drawn> {
        let (places, many) = arguments::cameras(camera)?;
        let options = arguments::options(size, background, depth, alpha)?;
        let images = self.draw(py, &places, camera.is_none(), &options, size.is_some(), antialias)?;
        Drawn::of(images, many)
    }

    /// Returns the camera that sees most of the scene, `degrees` around it. 0 is from its widest side, which is the
    /// front or the right; 90 is from the right of that.
    #[pyo3(signature = (degrees=0.0, *, size=None))]
    fn camera(&self, degrees: f64, size: Option<&Bound<'_, PyAny>>) -> PyResult<Camera> {
        let [width, height] = size.map_or(Ok(SIZE), arguments::pixels)?;
        if !degrees.is_finite() {
            return Err(wrong(format!("degrees: expected a finite number, found {degrees}")));
        }
        let camera = self.framing()?.camera(degrees, width as f64 / height as f64);
        Ok(Camera::sized(camera, [width, height]))
    }

    /// Returns `count` cameras once around the scene, at equal distance: those of the command line's `--turntable`.
    #[pyo3(signature = (count, *, size=None))]
    fn orbit(&self, count: u32, size: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<Camera>> {
        let [width, height] = size.map_or(Ok(SIZE), arguments::pixels)?;
        let angles: Vec<Angles> =
            (0..count).map(|i| Angles { right: 360.0 * f64::from(i) / f64::from(count), up: 0.0 }).collect();
        let around = self.framing()?.around(&angles, width as f64 / height as f64);
        Ok(around.into_iter().map(|camera| Camera::sized(camera, [width, height])).collect())
    }

    /// Writes the scene in the format by the name's ending: `.ply`, `.compressed.ply`, `.spz`, `.sog`, `.glb` or
    /// `.splat`. Losses are reported as warnings.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let format = format_of(&path)?;
        let written = py.detach(|| {
            let written = (format.still)(&self.scene, &Options::default());
            write_file(&path, &written.bytes).map_err(not_written)?;
            PyResult::Ok(written)
        })?;
        warn(py, &written.notes)
    }

    /// Returns a PNG of the scene in its default view, for notebooks.
    fn _repr_png_<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.picture(py)
    }

    /// Returns arrays for pickling.
    fn __reduce__<'py>(this: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>, Vec<u64>))> {
        let own = this.get();
        let file = this.py().detach(|| streamsplat::formats::ply::write(own.still()).bytes);
        let make = this.get_type().getattr("_of_parts")?;
        Ok((make, (PyBytes::new(this.py(), &file), own.identities.clone())))
    }

    /// Returns the splats of these parts.
    #[staticmethod]
    fn _of_parts(py: Python<'_>, file: &[u8], identities: Vec<u64>) -> PyResult<Self> {
        let workers = Workers::new(Level::detect(), 0).map_err(failed)?;
        let still = py.detach(|| Still::read(file)).map_err(failed)?;
        if still.len() != identities.len() {
            return Err(wrong(format!("identities: expected {}, found {}", still.len(), identities.len())));
        }
        Self::new(still, Some(identities), &workers)
    }

    fn __repr__(&self) -> String {
        let still = self.still();
        let bounds = still.framing().map(|Framing { least, greatest, .. }| {
            let corner = |c: [f64; 3]| c.map(|x| format!("{x:.2}")).join(", ");
            format!(", most of it from ({}) to ({})", corner(least), corner(greatest))
        });
        let s = if still.len() == 1 { "" } else { "s" };
        format!("Splats({} Gaussian{s}, sh_degree={}{})", still.len(), still.degree, bounds.unwrap_or_default())
    }
}

/// Replaces the library's names of arrays by Python's arguments.
fn renamed(error: String) -> String {
    let names = [
        ("mean:", "means:"),
        ("scale:", "scales:"),
        ("rotation:", "quats:"),
        ("opacity:", "opacities:"),
        ("rgb:", "colors:"),
        ("harmonics:", "sh:"),
    ];
    match names.iter().find(|(from, _)| error.starts_with(from)) {
        Some((from, to)) => error.replacen(from, to, 1),
        None => error,
    }
}
