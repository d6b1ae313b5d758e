//! Images of splats in their planes, as `model/train` draws them.

use numpy::PyUntypedArrayMethods;
use numpy::{IntoPyArray, PyArray3, PyArray4, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3, PyReadonlyArray4};
use pyo3::prelude::*;
use streamsplat::raster;

use crate::failure::wrong;
use crate::raster::{flat, refused};

/// Splats in the planes of several images.
#[pyclass(frozen, module = "streamsplat_cpu")]
pub struct Planes {
    inner: raster::Planes,
    /// M, H, W, N.
    shape: [usize; 4],
}

#[pymethods]
impl Planes {
    /// Builds the lists of `splats [M, N, 5]` (u, v, variances along x and y, opacity) in the order of `keys [M, N]`.
    #[new]
    fn new(
        py: Python<'_>,
        splats: PyReadonlyArray3<'_, f32>,
        keys: PyReadonlyArray2<'_, f32>,
        width: usize,
        height: usize,
        largest_alpha: f32,
    ) -> PyResult<Self> {
        let &[images, count, 5] = splats.shape() else {
            return Err(wrong(format!("splats: expected an array [M, N, 5], found {:?}", splats.shape())));
        };
        let (splats, keys) = (flat("splats", &splats)?.as_chunks().0.to_vec(), flat("keys", &keys)?);
        let inner =
            py.detach(|| raster::Planes::new(splats, keys, count, [width, height], largest_alpha)).map_err(refused)?;
        Ok(Self { inner, shape: [images, height, width, count] })
    }

    /// Draws images `[M, H, W, D]` and alphas `[M, H, W]` in `colors [M, N, D]` on `backgrounds [M, D]`.
    fn draw<'py>(
        &self,
        py: Python<'py>,
        colors: PyReadonlyArray3<'_, f32>,
        backgrounds: PyReadonlyArray2<'_, f32>,
    ) -> PyResult<(Bound<'py, PyArray4<f32>>, Bound<'py, PyArray3<f32>>)> {
        let [m, h, w, _] = self.shape;
        let channels = colors.shape()[2];
        let (colors, backgrounds) = (flat("colors", &colors)?, flat("backgrounds", &backgrounds)?);
        let (images, alphas) = py.detach(|| self.inner.draw(colors, channels, backgrounds)).map_err(refused)?;
        Ok((images.into_pyarray(py).reshape([m, h, w, channels])?, alphas.into_pyarray(py).reshape([m, h, w])?))
    }

    /// Computes gradients by splats `[M, N, 5]` and colours `[M, N, D]` from the drawn images and the gradient by them.
    fn gradients<'py>(
        &self,
        py: Python<'py>,
        colors: PyReadonlyArray3<'_, f32>,
        backgrounds: PyReadonlyArray2<'_, f32>,
        images: PyReadonlyArray4<'_, f32>,
        alphas: PyReadonlyArray3<'_, f32>,
        of_images: PyReadonlyArray4<'_, f32>,
    ) -> PyResult<(Bound<'py, PyArray3<f32>>, Bound<'py, PyArray3<f32>>)> {
        let [m, .., n] = self.shape;
        let channels = colors.shape()[2];
        let (colors, backgrounds) = (flat("colors", &colors)?, flat("backgrounds", &backgrounds)?);
        let drawn = [flat("images", &images)?, flat("alphas", &alphas)?];
        let of_images = flat("gradients of images", &of_images)?;
        let (of_splats, of_colors) = py
            .detach(|| {
                let of_alphas = vec![0.0; drawn[1].len()];
                self.inner.gradients(colors, channels, backgrounds, drawn, [of_images, &of_alphas])
            })
            .map_err(refused)?;
        Ok((
            of_splats.into_flattened().into_pyarray(py).reshape([m, n, 5])?,
            of_colors.into_pyarray(py).reshape([m, n, channels])?,
        ))
    }
}
