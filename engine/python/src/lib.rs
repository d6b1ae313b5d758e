//! `streamsplat_cpu._streamsplat`: the engine for Python.
//!
//! Arrays are NumPy's. Returned arrays share the engine's own memory, read-only, without a copy. Arguments are read in
//! place, with any strides. Long work runs without the interpreter's lock. Python code around it is in
//! `streamsplat_cpu/`.

mod arguments;
mod arrays;
mod camera;
mod engine;
mod failure;
mod image;
mod interval;
mod planes;
mod program;
mod raster;
mod run;
mod scene;
mod source;
mod splats;
mod view;

use pyo3::prelude::*;

/// The extension module.
#[pymodule]
#[pyo3(name = "_streamsplat")]
mod module {
    use super::*;

    #[pymodule_export]
    use super::camera::{Camera, cameras};
    #[pymodule_export]
    use super::engine::Engine;
    #[pymodule_export]
    use super::failure::Error;
    #[pymodule_export]
    use super::image::Image;
    #[pymodule_export]
    use super::interval::{Gaussians, Interval};
    #[pymodule_export]
    use super::planes::Planes;
    #[pymodule_export]
    use super::program::main;
    #[pymodule_export]
    use super::raster::{View, harmonics, harmonics_gradients};
    #[pymodule_export]
    use super::run::run;
    #[pymodule_export]
    use super::scene::{Scene, SceneWriter};
    #[pymodule_export]
    use super::source::Frames;
    #[pymodule_export]
    use super::splats::Splats;
    #[pymodule_export]
    use super::view::Viewer;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
