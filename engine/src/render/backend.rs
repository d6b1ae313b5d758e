//! Drawing backends: the CPU's rasteriser, or a graphics card.

use streamsplat_kernels::Level;
use streamsplat_kernels::raster::{self, Gaussians, Image, Projection, Request, Work};

use super::RenderError;
use crate::choice::named;
#[cfg(feature = "wgpu")]
use crate::wgpu::WgpuRasteriser;

named! {
    /// A drawing backend.
    Backend: "renderer" {
        /// The CPU's rasteriser: images are within the bit contract.
        #[default]
        Cpu = "cpu",
        /// A graphics card (cargo feature `wgpu`): images are outside of the bit contract.
        Wgpu = "wgpu",
    }
}

impl Backend {
    /// Returns true if this library was built with the backend.
    pub fn is_built_in(self) -> bool {
        match self {
            Backend::Cpu => true,
            Backend::Wgpu => cfg!(feature = "wgpu"),
        }
    }

    /// Returns true if its images are bit-identical everywhere.
    pub fn is_within_contract(self) -> bool {
        self == Backend::Cpu
    }
}

/// Name of the first requested feature that a graphics card does not support, if any.
#[cfg(feature = "wgpu")]
fn cpu_alone(projection: &Projection, request: &Request) -> Option<&'static str> {
    let alone = [
        (*projection == Projection::Equirectangular, "panorama"),
        (request.falloff != raster::Falloff::Gaussian, "footprint other than gaussian"),
        (request.defocus.is_some(), "aperture"),
    ];
    alone.into_iter().find(|(asked, _)| *asked).map(|(_, what)| what)
}

/// A drawing backend with its buffers.
pub(crate) enum Rasteriser {
    Cpu(Box<raster::Rasteriser>),
    #[cfg(feature = "wgpu")]
    Wgpu(Box<WgpuRasteriser>),
}

impl Rasteriser {
    pub(crate) fn new(backend: Backend, level: Level) -> Result<Self, RenderError> {
        match backend {
            Backend::Cpu => Ok(Rasteriser::Cpu(Box::new(raster::Rasteriser::new(level)))),
            #[cfg(feature = "wgpu")]
            Backend::Wgpu => Ok(Rasteriser::Wgpu(Box::new(WgpuRasteriser::new(level)?))),
            #[cfg(not(feature = "wgpu"))]
            Backend::Wgpu => Err(RenderError::NotBuiltIn { backend }),
        }
    }

    /// The graphics card's name.
    pub(crate) fn adapter(&self) -> Option<&str> {
        match self {
            Rasteriser::Cpu(_) => None,
            #[cfg(feature = "wgpu")]
            Rasteriser::Wgpu(rasteriser) => Some(rasteriser.adapter()),
        }
    }

    pub(crate) fn work(&self) -> Work {
        match self {
            Rasteriser::Cpu(rasteriser) => rasteriser.work(),
            #[cfg(feature = "wgpu")]
            Rasteriser::Wgpu(rasteriser) => rasteriser.work(),
        }
    }

    /// Makes the next image be drawn as a whole.
    pub(crate) fn forget(&mut self) {
        match self {
            Rasteriser::Cpu(rasteriser) => rasteriser.forget(),
            #[cfg(feature = "wgpu")]
            Rasteriser::Wgpu(_) => {}
        }
    }

    pub(crate) fn into_image(self) -> Image {
        match self {
            Rasteriser::Cpu(rasteriser) => rasteriser.into_image(),
            #[cfg(feature = "wgpu")]
            Rasteriser::Wgpu(rasteriser) => rasteriser.into_image(),
        }
    }

    pub(crate) fn render(
        &mut self,
        gaussians: &Gaussians<'_>,
        projection: &Projection,
        request: &Request,
    ) -> Result<&Image, RenderError> {
        match self {
            Rasteriser::Cpu(rasteriser) => Ok(rasteriser.render(gaussians, projection, request)),
            #[cfg(feature = "wgpu")]
            Rasteriser::Wgpu(rasteriser) => match cpu_alone(projection, request) {
                Some(what) => Err(RenderError::CpuAlone { what }),
                None => Ok(rasteriser.render(gaussians, projection, request)?),
            },
        }
    }
}
