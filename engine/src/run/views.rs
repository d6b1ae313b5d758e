//! Contents of images: times, cameras, size, background.

use super::Error;
use super::options::motion::Course;
use super::options::{Background, Fill, Times, ViewOptions};
use crate::camera::{Camera, CameraPath, Lens};
use crate::formats::FormatError;
use crate::formats::cameras::{self, CameraFile, CameraSet};
use crate::render::Backend;
use crate::{RenderOptions, Size};

/// Options of the images, their times and their cameras.
#[derive(Clone, Debug)]
pub struct Views {
    /// Size, background and planes.
    pub options: RenderOptions,
    /// The camera as a function of time.
    pub camera: CameraPath,
    /// Requested times, ascending.
    pub times: Option<Vec<f64>>,
    /// Backend that renders the images.
    pub backend: Backend,
    /// Width and height of the images in another program's camera file.
    pub own_sizes: Vec<[usize; 2]>,
    /// Images per second where that file belongs to a video; `None`: one per second.
    pub own_rate: Option<f64>,
    /// True if the background is transparent: the scene is drawn over black, and alpha is kept.
    pub transparent: bool,
    /// The camera's motion around the middle of a scene in time, instead of `camera`.
    pub course: Option<Course>,
    /// Filling of parts of a moved camera's images that were never filmed.
    pub fill: Fill,
    /// The part of the picture's sides that images of a moved camera show.
    pub part: f64,
    /// Distance between the eyes, where there are two.
    pub eyes: Option<f64>,
    /// The middle of a still scene; for a scene in time it follows from the first image.
    pub pivot: Option<[f64; 3]>,
    /// Times of the images that are averaged into one.
    pub shutter: Option<Shutter>,
}

impl Views {
    /// Returns true if images have the times and the view of the source's frames.
    pub(crate) fn shows_frames(&self) -> bool {
        let own_view = self.camera == CameraPath::default() && self.course.is_none() && self.eyes.is_none();
        own_view && self.times.is_none() && !self.transparent
    }

    /// The same, for images of the source's size.
    pub fn is_the_sources_own(&self) -> bool {
        self.shows_frames() && self.options.size == Size::Source
    }

    /// Refuses options that only a rendering of a still scene supports: a path through another program's cameras, and
    /// transparency where the frames come from a video.
    pub fn refuse_still(&self) -> Result<(), Error> {
        self.refuse_cameras()?;
        if self.transparent {
            return Err(Error::usage("--background transparent: expected one number or R,G,B; only render has it"));
        }
        Ok(())
    }

    /// Refuses several cameras of another program, which do not form a path through a scene in time.
    pub fn refuse_cameras(&self) -> Result<(), Error> {
        match self.own_sizes.len() {
            0 | 1 => Ok(()),
            n => Err(Error::usage(format!("--camera: expected one camera for a scene in time (--view), found {n}"))),
        }
    }
}

impl Views {
    /// A line where images of the requested size show the picture in another shape: that of the camera, for the
    /// source's own view that of its frames, of this height and width.
    pub fn squeezed(&self, source: Option<[usize; 2]>) -> Option<String> {
        let Size::Exact { width, height } = self.options.size else { return None };
        let ratio = |width: usize, height: usize| width as f64 / height.max(1) as f64;
        let shape = match (&self.own_sizes[..], self.camera.views().first()?.1) {
            ([[width, height], ..], _) => ratio(*width, *height),
            ([], Camera::Canonical) => source.map(|[height, width]| ratio(width, height))?,
            ([], Camera::Posed { lens, .. }) => match lens {
                Lens::Orthographic { half_extent } => half_extent.map(|[right, down]| right / down)?,
                Lens::Pinhole { focal: [x, y], .. } => y / x,
                Lens::Equirectangular => 2.0,
            },
        };
        // Sides are whole numbers of pixels, for videos even ones.
        let off = (width as f64 - shape * height as f64).abs();
        (off > f64::max(2.0, 0.01 * width as f64)).then(|| {
            let found = ratio(width, height);
            format!(
                "images of {width}×{height} ({found:.2}:1) show a picture of {shape:.2}:1: its pixels are not square"
            )
        })
    }

    /// The video's own view, at the model's size.
    pub fn own() -> Views {
        Views {
            options: RenderOptions::default(),
            camera: CameraPath::default(),
            times: None,
            backend: Backend::Cpu,
            own_sizes: Vec::new(),
            own_rate: None,
            transparent: false,
            course: None,
            fill: Fill::None,
            part: 1.0,
            eyes: None,
            pivot: None,
            shutter: None,
        }
    }
}

/// Times of the images that are averaged into one, as parts of the time from one image to the next: ascending, from −½
/// to ½.
#[derive(Clone, Debug, PartialEq)]
pub struct Shutter(pub Vec<f64>);

impl Shutter {
    /// The parts.
    pub fn parts(&self) -> &[f64] {
        &self.0
    }
}

/// The cameras of a file.
#[derive(Default)]
struct Cameras {
    path: CameraPath,
    /// Width and height of each camera's image, where the file is another program's.
    sizes: Vec<[usize; 2]>,
    /// Images per second, where they are a video's.
    rate: Option<f64>,
}

impl ViewOptions {
    /// Checks everything that can be checked before the work starts.
    ///
    /// # Errors
    /// [`Error::Usage`] for options that are not possible, [`Error::Camera`] for a camera's file.
    pub fn resolve(&self) -> Result<Views, Error> {
        let (background, transparent) = match self.background {
            Background::Colour(colour) => (colour, false),
            Background::Transparent => ([0.0; 3], true),
        };
        let size = self.size.unwrap_or_default();
        let Cameras { path: camera, sizes: own_sizes, rate: own_rate } = self.cameras(size)?;
        let options = RenderOptions { size, background, ..RenderOptions::default() };
        let times = self.times.as_ref().map(Times::list);
        let backend = self.backend()?;
        Ok(Views { options, camera, times, backend, own_sizes, own_rate, transparent, ..Views::own() })
    }

    /// The camera's path, with the image sizes and rate of another program's file.
    fn cameras(&self, size: Size) -> Result<Cameras, Error> {
        let Some(file) = &self.camera else { return Ok(Cameras::default()) };
        let size = match size {
            Size::Exact { width, height } => Some([width, height]),
            _ => None,
        };
        let set = match (cameras::open(file, size)?, &self.view) {
            (CameraFile::Own(path), None) => return Ok(Cameras { path, ..Cameras::default() }),
            (CameraFile::Own(_), Some(view)) => {
                let file = file.display();
                let found = format!("{file}, which is this program's own: give --times");
                return Err(Error::usage(format!(
                    "--view {view}: expected a camera file of another program, found {found}"
                )));
            }
            (CameraFile::Set(set), _) => set,
        };
        let drawable = set.cameras.iter().find(|named| named.camera.is_ok()).map(|named| named.name.clone());
        let chosen = match &self.view {
            None => set,
            Some(text) => {
                let camera =
                    set.find(text).map_err(|e| Error::usage(format!("--view: {}: {e}", file.display())))?.clone();
                CameraSet { cameras: vec![camera], aside: Vec::new(), rate: None, ..set }
            }
        };
        let refused = |e: FormatError| {
            let others = drawable.as_ref().filter(|_| self.view.is_none());
            let others = others.map_or_else(String::new, |name| {
                format!("; others can be drawn, each by its name or number: --view {name}")
            });
            Error::work(format!("{}: {e}{others}", file.display()))
        };
        let sizes = chosen.usable().map_err(refused)?.iter().map(|sized| sized.size).collect();
        Ok(Cameras { path: chosen.path().map_err(refused)?, sizes, rate: chosen.rate })
    }

    fn backend(&self) -> Result<Backend, Error> {
        let backend = self.renderer.unwrap_or_default();
        if !backend.is_built_in() {
            return Err(Error::usage(format!(
                "--renderer {backend}: expected a program built with the cargo feature {backend} (cargo build --release --features {backend}), found one without"
            )));
        }
        Ok(backend)
    }
}
