//! A still scene on a page: one packet, seen from the camera of [`Framing`].

mod packet;

use std::io::Write;
use std::sync::Arc;

use flate2::Compression;
use flate2::write::DeflateEncoder;
use serde::Serialize;

use super::page::{PageError, Whole};
use super::source::{Description, IntervalTimes, Source};
use crate::open::StillFile;
use crate::picture::Picture;
use crate::render::{RenderError, RenderOptions, Renderer, Size};
use crate::scene::SceneError;
use crate::still::{Drawable, Framing};
use crate::stream::Workers;

/// Width and height of a poster.
const POSTER: [usize; 2] = [1280, 720];
/// Bytes of the length before the compressed data.
const LENGTH: usize = 4;

/// Description of a still scene, sent to the page.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StillDescription {
    /// The name of the file's format.
    pub format: &'static str,
    /// Degree of the scene's harmonics.
    pub degree: usize,
    /// The box that holds most of the scene ([`Framing`]).
    pub least: [f64; 3],
    /// The box's other corner.
    pub greatest: [f64; 3],
}

/// A still scene with a title.
#[derive(Debug)]
pub struct StillSource {
    title: String,
    format: &'static str,
    framing: Framing,
    /// The framing's box, relative to the scene's offset as the page's centres are.
    middle: [[f64; 3]; 2],
    scene: Drawable,
    packet: Arc<[u8]>,
    workers: Workers,
}

/// Why a still scene cannot be shown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StillError {
    /// No centre is finite.
    #[error("{0}: expected Gaussians at finite places, found none to look at")]
    Nowhere(String),
    /// The scene's arrays differ in length.
    #[error(transparent)]
    Uneven(#[from] RenderError),
}

impl StillSource {
    /// Prepares a scene for a page.
    ///
    /// # Errors
    /// A scene without a Gaussian that has a finite centre; arrays that differ in length.
    pub fn new(title: impl Into<String>, file: StillFile, workers: Workers) -> Result<StillSource, StillError> {
        let nowhere = || StillError::Nowhere(file.path.display().to_string());
        let (framing, middle) = file.still.framing().zip(file.still.middle()).ok_or_else(nowhere)?;
        let scene = Drawable::new(file.still, &workers)?;
        let packet = workers.install(|| packet::packet(&scene)).into();
        Ok(StillSource { title: title.into(), format: file.format, framing, middle, scene, packet, workers })
    }
}

impl Source for StillSource {
    fn describe(&self, from: usize) -> Description {
        let [least, greatest] = self.middle;
        let instant = IntervalTimes { start: 0.0, end: 0.0, gaussians: self.scene.still().len() };
        Description {
            title: self.title.clone(),
            fps: 0.0,
            placement: None,
            still: Some(StillDescription { format: self.format, degree: self.scene.still().degree, least, greatest }),
            live: false,
            complete: true,
            first: 0,
            from,
            intervals: [instant].into_iter().skip(from).collect(),
        }
    }

    fn packet(&self, i: usize) -> Result<Option<Arc<[u8]>>, SceneError> {
        Ok((i == 0).then(|| self.packet.clone()))
    }
}

impl Whole for StillSource {
    const ABOUT: &str = "A scene that can be turned: 3D Gaussians";

    fn poster(&self) -> Result<Picture, PageError> {
        let [width, height] = POSTER;
        let camera = self.framing.camera(0.0, width as f64 / height as f64);
        let antialias = self.scene.still().about.antialiased;
        let options = RenderOptions { size: Size::Exact { width, height }, antialias, ..RenderOptions::default() };
        let mut renderer = Renderer::new(&self.workers);
        let image = renderer.render_still(&self.scene, &camera, &options)?;
        Ok(Picture { width: image.width, height: image.height, rgb: image.rgb.clone() })
    }

    /// The packet: its compressed length (u32) and its bytes as a raw deflate stream.
    fn parts(&self, put: &mut dyn FnMut(&[u8]) -> Result<(), PageError>) -> Result<(), PageError> {
        let mut deflated = DeflateEncoder::new(vec![0; LENGTH], Compression::default());
        deflated.write_all(&self.packet)?;
        let mut deflated = deflated.finish()?;
        // The limit of a string is lower: the page reports it.
        let length = u32::try_from(deflated.len() - LENGTH).unwrap_or(u32::MAX);
        deflated[..LENGTH].copy_from_slice(&length.to_le_bytes());
        put(&deflated)
    }
}
