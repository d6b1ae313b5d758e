//! One camera's view of arrays of Gaussians: images in any colours, and gradients. `streamsplat_cpu/raster.py` builds
//! gsplat's function from it.

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use streamsplat::kernels::raster::FootprintGradient;
use streamsplat::raster::{
    self, GaussianGradients, Gaussians, Options, RasterError, harmonic_colours, harmonic_gradients,
};

use crate::failure::wrong;

/// Converts an error of an argument to a Python exception.
pub(crate) fn refused(error: RasterError) -> PyErr {
    match error {
        RasterError::Memory { .. } => pyo3::exceptions::PyMemoryError::new_err(error.to_string()),
        _ => wrong(error),
    }
}

type Table<'py> = PyReadonlyArray2<'py, f32>;

/// Returns the rows of an array of `W` columns.
fn rows<'a, const W: usize>(name: &str, array: &'a Table<'_>) -> PyResult<&'a [[f32; W]]> {
    match (array.shape(), array.as_slice()) {
        (&[_, width], Ok(values)) if width == W => Ok(values.as_chunks().0),
        (shape, _) => Err(wrong(format!("{name}: expected a contiguous array [N, {W}], found {shape:?}"))),
    }
}

/// Returns the values of an array.
pub(crate) fn flat<'a, D: numpy::ndarray::Dimension>(
    name: &str,
    array: &'a numpy::PyReadonlyArray<'_, f32, D>,
) -> PyResult<&'a [f32]> {
    array.as_slice().map_err(|_| wrong(format!("{name}: expected a contiguous array, found one with gaps")))
}

/// Returns a square matrix.
fn matrix<const W: usize>(name: &str, array: &Table<'_>) -> PyResult<[[f32; W]; W]> {
    rows::<W>(name, array)?
        .try_into()
        .map_err(|_| wrong(format!("{name}: expected {W} rows, found {}", array.shape()[0])))
}

/// Returns a new array `[N, W]`.
fn table<'py, const W: usize>(py: Python<'py>, values: Vec<[f32; W]>) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let rows = values.len();
    values.into_flattened().into_pyarray(py).reshape([rows, W])
}

/// Gaussians as seen by one camera.
#[pyclass(frozen, module = "streamsplat_cpu")]
pub struct View {
    inner: raster::View,
    size: [usize; 2],
}

/// Centres, depths, conics, opacities, radii, and the eye's position.
type ProjectedArrays<'py> = (
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray2<i32>>,
    Bound<'py, PyArray1<f32>>,
);

/// Gradients by means, quaternions, scales, opacities and the view matrix.
type GradientArrays<'py> = (
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray2<f32>>,
);

#[pymethods]
impl View {
    #[new]
    #[pyo3(signature = (means, quats, scales, opacities, viewmat, k, width, height, near_plane, far_plane, radius_clip, eps2d, antialiased, orthographic, largest_alpha=0.999))]
    #[expect(clippy::too_many_arguments, reason = "gsplat's arguments")]
    fn new(
        py: Python<'_>,
        means: Table<'_>,
        quats: Table<'_>,
        scales: Table<'_>,
        opacities: PyReadonlyArray1<'_, f32>,
        viewmat: Table<'_>,
        k: Table<'_>,
        width: usize,
        height: usize,
        near_plane: f32,
        far_plane: f32,
        radius_clip: f32,
        eps2d: f32,
        antialiased: bool,
        orthographic: bool,
        largest_alpha: f32,
    ) -> PyResult<Self> {
        let gaussians = Gaussians {
            means: rows("means", &means)?,
            quats: rows("quats", &quats)?,
            scales: rows("scales", &scales)?,
            opacities: flat("opacities", &opacities)?,
        };
        let (viewmat, k) = (matrix("viewmats", &viewmat)?, matrix("Ks", &k)?);
        let options = Options {
            near_plane,
            far_plane,
            radius_clip,
            eps2d,
            antialiased,
            orthographic,
            largest_alpha,
            ..Options::new(width, height)
        };
        let inner = py.detach(|| raster::View::new(&gaussians, &viewmat, &k, &options)).map_err(refused)?;
        Ok(Self { inner, size: [height, width] })
    }

    /// Returns centres `[N, 2]`, depths `[N]`, conics `[N, 3]`, opacities `[N]`, radii `[N, 2]`, and the eye's position
    /// `[3]`.
    fn projected<'py>(&self, py: Python<'py>) -> PyResult<ProjectedArrays<'py>> {
        let all = self.inner.projected();
        let n = all.depth.len();
        Ok((
            PyArray1::from_slice(py, all.centre.as_flattened()).reshape([n, 2])?,
            PyArray1::from_slice(py, &all.depth),
            PyArray1::from_slice(py, all.conic.as_flattened()).reshape([n, 3])?,
            PyArray1::from_slice(py, &all.opacity),
            PyArray1::from_slice(py, all.radius.as_flattened()).reshape([n, 2])?,
            PyArray1::from_slice(py, &self.inner.eye()),
        ))
    }

    /// Draws image `[H, W, D]` and alpha `[H, W]` in colours `[N, D]`, on a background `[D]` (or an empty array).
    fn draw<'py>(
        &self,
        py: Python<'py>,
        colors: Table<'_>,
        background: PyReadonlyArray1<'_, f32>,
    ) -> PyResult<(Bound<'py, PyArray3<f32>>, Bound<'py, PyArray2<f32>>)> {
        let channels = colors.shape()[1];
        let (colors, background) = (flat("colors", &colors)?, flat("backgrounds", &background)?);
        let (image, alpha) = py.detach(|| self.inner.draw(colors, channels, background)).map_err(refused)?;
        let [height, width] = self.size;
        Ok((
            image.into_pyarray(py).reshape([height, width, channels])?,
            alpha.into_pyarray(py).reshape([height, width])?,
        ))
    }

    /// Computes gradients by footprints `[N, 6]`, colours `[N, D]` and background, from the drawn image and alpha and
    /// the gradients by them.
    #[expect(clippy::too_many_arguments, reason = "what was drawn, and two gradients")]
    fn draw_gradients<'py>(
        &self,
        py: Python<'py>,
        colors: Table<'_>,
        background: PyReadonlyArray1<'_, f32>,
        image: PyReadonlyArray3<'_, f32>,
        alpha: PyReadonlyArray2<'_, f32>,
        of_image: PyReadonlyArray3<'_, f32>,
        of_alpha: PyReadonlyArray2<'_, f32>,
    ) -> PyResult<(Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<f32>>, Bound<'py, PyArray1<f32>>)> {
        let &[count, channels] = colors.shape() else { unreachable!("an array of two dimensions") };
        let (colors, background) = (flat("colors", &colors)?, flat("backgrounds", &background)?);
        let drawn = [flat("image", &image)?, flat("alpha", &alpha)?];
        let of = [flat("gradient of the image", &of_image)?, flat("gradient of alpha", &of_alpha)?];
        let (footprints, of_colors, of_background) = py
            .detach(|| {
                let (mut of_colors, mut of_background) = (vec![0.0; colors.len()], vec![0.0; background.len()]);
                let (to, behind) = (&mut of_colors, &mut of_background);
                let footprints = self.inner.draw_gradients(colors, channels, background, drawn, of, to, behind)?;
                Ok((footprints, of_colors, of_background))
            })
            .map_err(refused)?;
        let of_background: Vec<f32> = of_background.iter().map(|&of| of as f32).collect();
        Ok((
            bytemuck::allocation::cast_vec::<FootprintGradient, [f32; 6]>(footprints)
                .into_flattened()
                .into_pyarray(py)
                .reshape([count, 6])?,
            of_colors.into_pyarray(py).reshape([count, channels])?,
            of_background.into_pyarray(py),
        ))
    }

    /// Computes gradients by means, quaternions, scales, opacities and the view matrix, from those by footprints `[N,
    /// 6]`, depths `[N]` (or an empty array) and the eye's position `[3]`.
    #[expect(clippy::too_many_arguments, reason = "Gaussians, and three gradients")]
    fn gradients<'py>(
        &self,
        py: Python<'py>,
        means: Table<'_>,
        quats: Table<'_>,
        scales: Table<'_>,
        opacities: PyReadonlyArray1<'_, f32>,
        footprints: Table<'_>,
        of_depth: PyReadonlyArray1<'_, f32>,
        of_eye: [f64; 3],
    ) -> PyResult<GradientArrays<'py>> {
        let gaussians = Gaussians {
            means: rows("means", &means)?,
            quats: rows("quats", &quats)?,
            scales: rows("scales", &scales)?,
            opacities: flat("opacities", &opacities)?,
        };
        let footprints: &[FootprintGradient] = bytemuck::cast_slice(rows::<6>("footprints", &footprints)?);
        let of_depth = Some(flat("depths", &of_depth)?).filter(|of| !of.is_empty());
        let (to, viewmat) = py
            .detach(|| {
                let mut to = GaussianGradients::zeros(gaussians.means.len());
                let viewmat = self.inner.gradients(&gaussians, footprints, of_depth, of_eye, &mut to)?;
                Ok((to, viewmat))
            })
            .map_err(refused)?;
        Ok((
            table(py, to.means)?,
            table(py, to.quats)?,
            table(py, to.scales)?,
            to.opacities.into_pyarray(py),
            table(py, viewmat.to_vec())?,
        ))
    }
}

/// Computes colours `[N, 3]` from harmonics `[N, K, 3]` up to `degree`, seen from `eye`.
#[pyfunction]
pub fn harmonics<'py>(
    py: Python<'py>,
    coefficients: PyReadonlyArray3<'_, f32>,
    degree: usize,
    means: Table<'_>,
    eye: [f32; 3],
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let count = coefficients.shape()[1];
    let (values, means) = (flat("colors", &coefficients)?, rows("means", &means)?);
    let colours = py.detach(|| harmonic_colours(values, count, degree, means, eye)).map_err(refused)?;
    table(py, colours)
}

/// Computes gradients by coefficients, means and the eye from those by the colours of [`harmonics`].
#[pyfunction]
#[expect(clippy::type_complexity, reason = "three arrays")]
pub fn harmonics_gradients<'py>(
    py: Python<'py>,
    coefficients: PyReadonlyArray3<'_, f32>,
    degree: usize,
    means: Table<'_>,
    eye: [f32; 3],
    colors: Table<'_>,
    of_colors: Table<'_>,
) -> PyResult<(Bound<'py, PyArray3<f32>>, Bound<'py, PyArray2<f32>>, [f64; 3])> {
    let &[gaussians, count, _] = coefficients.shape() else { unreachable!("an array of three dimensions") };
    let (values, means) = (flat("colors", &coefficients)?, rows("means", &means)?);
    let (colors, of) = (rows("colors", &colors)?, rows("gradient of colors", &of_colors)?);
    let found = py.detach(|| harmonic_gradients(values, count, degree, means, eye, colors, of)).map_err(refused)?;
    Ok((found.coefficients.into_pyarray(py).reshape([gaussians, count, 3])?, table(py, found.means)?, found.eye))
}
