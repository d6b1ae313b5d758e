//! What images show, and how: times, cameras, size, background.

use super::Error;
use super::options::ViewOptions;
use super::options::motion::Course;
use super::options::settings::choice;
use crate::camera::{self, CameraFile, CameraPath};
use crate::import::FormatError;
use crate::render::Backend;
use crate::{RenderOptions, Size};
use streamsplat_kernels::raster;

/// Options of the images, their times and their cameras.
#[derive(Clone, Debug)]
pub struct Views {
    /// Size, background, and which planes.
    pub options: RenderOptions,
    /// The camera at any time.
    pub camera: CameraPath,
    /// Times asked for, ascending.
    pub times: Option<Vec<f64>>,
    /// Backend that renders the images.
    pub backend: Backend,
    /// Width and height of the images of a camera file of another program.
    pub own_sizes: Vec<[usize; 2]>,
    /// Images of a second where such a file is a video's; else one follows the other each second.
    pub own_rate: Option<f64>,
    /// True if the background is transparent: the scene is drawn over black, and alpha is kept.
    pub transparent: bool,
    /// Where the camera stands around the middle of a scene in time, in place of `camera`.
    pub course: Option<Course>,
    /// Distance between the eyes, where there are two.
    pub eyes: Option<f64>,
    /// The middle of a still scene; that of a scene in time follows from its first image.
    pub pivot: Option<[f64; 3]>,
    /// When the images are taken of which each is the mean.
    pub shutter: Option<Shutter>,
}

impl Views {
    /// Returns true for images of the source's frames as they were filmed: their times, their size, their view.
    pub fn is_the_sources_own(&self) -> bool {
        let own_view = self.camera == CameraPath::default() && self.course.is_none() && self.eyes.is_none();
        own_view && self.times.is_none() && self.options.size == Size::Source && !self.transparent
    }

    /// Refuses what only a rendering of a still scene has: a path through another program's cameras, and, where frames are
    /// written from a video, transparency.
    pub fn refuse_still(&self) -> Result<(), Error> {
        self.refuse_cameras()?;
        if self.transparent {
            return Err(Error::usage("--background transparent: expected one number or R,G,B; only render has it"));
        }
        Ok(())
    }

    /// Refuses several cameras of another program, which are no path through a scene in time.
    pub fn refuse_cameras(&self) -> Result<(), Error> {
        match self.own_sizes.len() {
            0 | 1 => Ok(()),
            n => Err(Error::usage(format!("--camera: expected one camera for a scene in time (--view), found {n}"))),
        }
    }
}

impl Views {
    /// The video's own, at the size at which the model sees frames.
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
            eyes: None,
            pivot: None,
            shutter: None,
        }
    }
}

/// When the images are taken that are one image's mean: parts of the time from one image to the next, ascending, from −½ to ½.
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
    /// Width and height of each one's image, where the file is another program's.
    sizes: Vec<[usize; 2]>,
    /// Images of a second, where they are a video's.
    rate: Option<f64>,
}

impl ViewOptions {
    /// Checks everything that can be checked before work is spent.
    pub fn resolve(&self) -> Result<Views, Error> {
        let transparent = self.background == "transparent";
        let background = if transparent { [0.0; 3] } else { self.background()? };
        let size = self.size()?;
        let Cameras { path: camera, sizes: own_sizes, rate: own_rate } = self.cameras(size)?;
        let options = RenderOptions { size, background, ..RenderOptions::default() };
        let times = self.times.as_deref().map(times).transpose()?;
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
        let set = match (camera::set::open(file, size)?, &self.view) {
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
                camera::CameraSet { cameras: vec![camera], aside: Vec::new(), rate: None, ..set }
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
        let Some(name) = &self.renderer else { return Ok(Backend::Cpu) };
        let backend: Backend = choice("--renderer", name)?;
        if !backend.is_built_in() {
            return Err(Error::usage(format!(
                "--renderer {name}: expected a program built with the cargo feature {name} (cargo build --release --features {name}), found one without"
            )));
        }
        Ok(backend)
    }

    fn size(&self) -> Result<Size, Error> {
        let text = self.size.as_deref().unwrap_or("model");
        match text {
            "model" => return Ok(Size::Model),
            "source" => return Ok(Size::Source),
            _ => {}
        }
        let side = |text: &str| text.parse().ok().filter(|side| (1..=raster::MAX_SIDE).contains(side));
        let sides = text.split_once('x').and_then(|(w, h)| side(w).zip(side(h)));
        sides.map(|(width, height)| Size::Exact { width, height }).ok_or_else(|| {
            let most = raster::MAX_SIDE;
            Error::usage(format!("--size {text}: expected model, source or WIDTHxHEIGHT up to {most} a side"))
        })
    }

    fn background(&self) -> Result<[f32; 3], Error> {
        let parts: Option<Vec<f32>> = self.background.split(',').map(|part| part.trim().parse().ok()).collect();
        let inside = |v: &[f32]| v.iter().all(|c| (0.0..=1.0).contains(c));
        match parts.as_deref() {
            Some([grey]) if inside(&[*grey]) => Ok([*grey; 3]),
            Some([r, g, b]) if inside(&[*r, *g, *b]) => Ok([*r, *g, *b]),
            _ => Err(Error::usage(format!(
                "--background {}: expected one number or R,G,B, each from 0 to 1",
                self.background
            ))),
        }
    }
}

/// `a,b,c` or `start:end:count`, ascending seconds.
pub fn times(text: &str) -> Result<Vec<f64>, Error> {
    let wrong = |what: &str| Error::usage(format!("--times {text}: expected {what}"));
    let number = |part: &str| part.trim().parse::<f64>().ok().filter(|t| t.is_finite());
    if text.contains(':') {
        let parts: Vec<&str> = text.split(':').collect();
        let [start, end, count] = parts[..] else { return Err(wrong("START:END:COUNT")) };
        let count: Option<usize> = count.trim().parse().ok().filter(|n| (1..=1_000_000).contains(n));
        return match (number(start), number(end), count) {
            (Some(start), Some(end), Some(1)) if start <= end => Ok(vec![start]),
            (Some(start), Some(end), Some(n)) if start <= end => {
                let step =
                    |i: usize| if i + 1 == n { end } else { start + (end - start) * (i as f64 / (n - 1) as f64) };
                Ok((0..n).map(step).collect())
            }
            _ => Err(wrong("START:END:COUNT with START ≤ END in seconds and COUNT from 1 to 1000000")),
        };
    }
    let times: Option<Vec<f64>> = text.split(',').map(number).collect();
    match times {
        Some(times) if times.windows(2).all(|pair| pair[0] <= pair[1]) => Ok(times),
        Some(_) => Err(wrong("ascending times")),
        None => Err(wrong("seconds separated by commas, or START:END:COUNT")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_lists_or_ranges() {
        assert_eq!(times("0,0.5,2").ok(), Some(vec![0.0, 0.5, 2.0]));
        assert_eq!(times("0:1:3").ok(), Some(vec![0.0, 0.5, 1.0]));
        assert_eq!(times("0:0.3:1").ok(), Some(vec![0.0]));
        for wrong in ["", "1,0", "nan", "0:1", "1:0:4", "0:1:0", "0;1"] {
            assert!(matches!(times(wrong), Err(Error::Usage(_))), "{wrong}");
        }
    }

    #[test]
    fn sizes_and_backgrounds_outside_their_range_are_wrong_use() {
        let view = |size: &str, background: &str| ViewOptions {
            size: Some(size.into()),
            background: background.into(),
            ..ViewOptions::default()
        };
        let views = view("640x360", "0,0.5,1").resolve().expect("valid");
        assert_eq!(views.options.size, Size::Exact { width: 640, height: 360 });
        assert_eq!(views.options.background, [0.0, 0.5, 1.0]);
        for (size, background) in
            [("0x4", "0"), ("big", "0"), ("4x", "0"), ("4x99999999", "0"), ("model", "2"), ("model", "0,1")]
        {
            assert!(matches!(view(size, background).resolve(), Err(Error::Usage(_))), "{size} {background}");
        }
    }
}
