//! A still scene on a page: one packet, seen from the camera of [`Framing`].

mod packet;

use std::io::Write;
use std::sync::Arc;

use flate2::Compression;
use flate2::write::DeflateEncoder;
use serde::Serialize;

use super::page::{PageError, Whole};
use super::source::{Description, IntervalTimes, Source};
use crate::camera::{Camera, Lens, Pose};
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
    /// Middle and half extents, along x and y, of the view along +z from which the scene is seen first, if not from
    /// that of its [`Framing`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view: Option<[[f64; 2]; 2]>,
}

/// A still scene with a title.
#[derive(Debug)]
pub struct StillSource {
    title: String,
    format: &'static str,
    framing: Framing,
    /// The framing's box, relative to the scene's offset as the page's centres are.
    middle: [[f64; 3]; 2],
    view: Option<[[f64; 2]; 2]>,
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
        Ok(StillSource {
            title: title.into(),
            format: file.format,
            framing,
            middle,
            view: None,
            scene,
            packet,
            workers,
        })
    }

    /// Shows the scene first from an orthographic camera that looks along +z, as those of exported files do. Returns
    /// false for other cameras, which change nothing.
    pub fn seen_from(&mut self, camera: &Camera) -> bool {
        let offset = self.scene.still().about.offset;
        self.view = match camera {
            Camera::Posed { pose, lens: Lens::Orthographic { half_extent: Some(half) } }
                if pose.rotation.is_identity() =>
            {
                Some([[pose.position[0] - offset[0], pose.position[1] - offset[1]], *half])
            }
            _ => None,
        };
        self.view.is_some()
    }

    /// The camera of the poster: that of [`Self::seen_from`], which then shows all of its view, or the framing's.
    fn camera(&self, aspect: f64) -> Camera {
        let Some([[x, y], [right, down]]) = self.view else { return self.framing.camera(0.0, aspect) };
        let offset = self.scene.still().about.offset;
        let down = down.max(right / aspect);
        // In front of everything, as the page's is.
        let [least, greatest] = self.middle;
        let unit = (0..3).map(|k| (0.5 * (greatest[k] - least[k])).powi(2)).sum::<f64>().sqrt();
        let ahead = 0.5 * (least[2] + greatest[2]) - 100.0 * unit.max(1.0);
        let pose = Pose { position: [x + offset[0], y + offset[1], ahead + offset[2]], ..Pose::default() };
        Camera::Posed { pose, lens: Lens::Orthographic { half_extent: Some([down * aspect, down]) } }
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
            still: Some(StillDescription {
                format: self.format,
                degree: self.scene.still().degree,
                least,
                greatest,
                view: self.view,
            }),
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
        let camera = self.camera(width as f64 / height as f64);
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
