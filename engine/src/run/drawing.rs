//! Images of intervals at given times.

use std::collections::BTreeMap;
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

use crate::camera::Camera;
use crate::render::{Backend, Exposure, Renderer, View, turn};
use crate::still::Drawable;
use crate::stream::{Interval, Workers};
use crate::{Image, RenderError, RenderOptions};
use serde::{Deserialize, Serialize};
use streamsplat_kernels::fill::{fill, uncovered};
use streamsplat_kernels::raster::Projection;

use crate::run::Error;
use crate::run::options::Fill;
use crate::run::options::motion::Course;
use crate::run::record::{Counts, RendererRecord, WorkRecord};
use crate::run::views::Views;

/// Number of planes: colour, depth and alpha.
const PLANES: u64 = 3;

/// First image of a camera that moves around a scene in time; the motion is relative to it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Anchor {
    /// Time of the image.
    pub time: f64,
    /// Middle of the scene at that time.
    pub pivot: [f64; 3],
}

/// Draws and writes images, and counts the work.
pub struct Drawing {
    workers: Workers,
    renderer: Renderer,
    backend: Backend,
    /// Set by the first image that needs it.
    pub anchor: Option<Anchor>,
    /// Counts of the work.
    pub counts: Counts,
    /// Time spent drawing.
    pub render: Duration,
    /// Time spent encoding and writing.
    pub write: Duration,
}

impl Drawing {
    /// A drawing without images yet.
    pub fn new(workers: &Workers, backend: Backend) -> Result<Drawing, Error> {
        Ok(Drawing {
            workers: workers.clone(),
            renderer: Renderer::with(workers, backend)?,
            backend,
            anchor: None,
            counts: Counts::default(),
            render: Duration::ZERO,
            write: Duration::ZERO,
        })
    }

    /// Threads and level.
    pub fn workers(&self) -> &Workers {
        &self.workers
    }

    /// The renderer, for the record.
    pub fn renderer(&self) -> RendererRecord {
        RendererRecord {
            name: self.backend.to_string(),
            adapter: self.renderer.adapter().map(str::to_owned),
            bit_contract: self.backend.is_within_contract(),
        }
    }

    /// Draws the interval at `time` from the camera's position at that time, as image number `index`.
    pub fn draw(&mut self, interval: &Interval, index: usize, time: f64, views: &Views) -> Result<Image, Error> {
        self.draw_at(interval, index as f64, time, views)
    }

    /// [`Self::draw`], where a fractional `index` is between two images.
    pub fn draw_at(&mut self, interval: &Interval, index: f64, time: f64, views: &Views) -> Result<Image, Error> {
        if views.course.is_none() && views.eyes.is_none() {
            return self.seen(interval, time, &views.camera.at(time), &views.options);
        }
        let placement = &interval.placement;
        let anchor = self.anchored(interval, time)?;
        let angles = views.course.as_ref().map(|course| course.at(index, time - anchor.time));
        let camera = match angles {
            None => views.camera.at(time),
            Some(angles) => match turn::turned(placement, anchor.pivot, angles) {
                whole if views.part == 1.0 => whole,
                whole => turn::cropped(&whole, placement, anchor.pivot, views.part),
            },
        };
        let mut seen = |camera: &Camera| match angles {
            Some(angles) if *camera != Camera::Canonical => self.filled(interval, time, camera, views, angles),
            _ => self.seen(interval, time, camera, &views.options),
        };
        let Some(apart) = views.eyes else { return seen(&camera) };
        let [left, right] = turn::eyes(&camera, Some(placement), anchor.pivot, apart).ok_or_else(behind)?;
        let [left, right] = [seen(&left)?, seen(&right)?];
        Ok(self.beside(left, right))
    }

    /// Draws from a camera turned by these angles; counts the pixels that were never filmed, and fills them.
    fn filled(
        &mut self,
        interval: &Interval,
        time: f64,
        camera: &Camera,
        views: &Views,
        angles: turn::Angles,
    ) -> Result<Image, Error> {
        let options = RenderOptions { alpha: true, ..views.options };
        let mut image = self.seen(interval, time, camera, &options)?;
        let start = Instant::now();
        let share = if views.fill == Fill::None || views.transparent {
            uncovered(&image)
        } else {
            self.workers.install(|| fill(&mut image, options.background))
        };
        self.render += start.elapsed();
        let pixels = (image.width * image.height) as u64;
        self.counts.unfilmed.add(pixels, share, angles.right.hypot(angles.up));
        if !views.options.alpha {
            image.alpha = None;
        }
        Ok(image)
    }

    /// Time of the first image and the scene's middle then; sets them from `time` if there was none yet.
    pub fn anchored(&mut self, interval: &Interval, time: f64) -> Result<Anchor, Error> {
        Ok(match self.anchor {
            Some(anchor) => anchor,
            None => *self.anchor.insert(Anchor { time, pivot: turn::pivot(interval, time, &self.workers)? }),
        })
    }

    fn seen(
        &mut self,
        interval: &Interval,
        time: f64,
        camera: &Camera,
        options: &RenderOptions,
    ) -> Result<Image, Error> {
        let view = View::new(camera, &interval.placement, [1; 2]);
        let turned = view.rotation().is_some() || !matches!(view.projection(), Projection::Orthographic { .. });
        self.drawn(turned, |renderer| renderer.render(interval, time, camera, options))
    }

    /// Draws a still scene from the camera's position at `time`.
    pub fn still(&mut self, scene: &Drawable, time: f64, views: &Views) -> Result<Image, Error> {
        // Its Gaussians have their own rotations.
        let mut seen =
            |camera: &Camera| self.drawn(true, |renderer| renderer.render_still(scene, camera, &views.options));
        match (views.camera.at(time), views.eyes.zip(views.pivot)) {
            (camera @ Camera::Canonical, _) | (camera, None) => seen(&camera),
            (camera, Some((apart, pivot))) => {
                let [left, right] = turn::eyes(&camera, None, pivot, apart).ok_or_else(behind)?;
                let [left, right] = [seen(&left)?, seen(&right)?];
                Ok(self.beside(left, right))
            }
        }
    }

    /// The mean of the images that `draw` returns at each part of the shutter; without a shutter its image at 0.
    pub fn exposed(
        &mut self,
        views: &Views,
        mut draw: impl FnMut(&mut Drawing, f64) -> Result<Image, Error>,
    ) -> Result<Image, Error> {
        let Some(shutter) = &views.shutter else { return draw(self, 0.0) };
        let mut exposure = Exposure::new(self.workers.level(), views.transparent);
        for &part in shutter.parts() {
            let image = draw(self, part)?;
            let start = Instant::now();
            self.workers.install(|| exposure.add(&image));
            self.render += start.elapsed();
        }
        let start = Instant::now();
        let image = self.workers.install(|| exposure.mean());
        self.counts.images -= shutter.parts().len().saturating_sub(1) as u64;
        self.render += start.elapsed();
        Ok(image)
    }

    /// Draws and counts; `turned`: true if the view needs turned splats.
    fn drawn(
        &mut self,
        turned: bool,
        paint: impl FnOnce(&mut Renderer) -> Result<&Image, RenderError>,
    ) -> Result<Image, Error> {
        let _span = tracing::info_span!("render").entered();
        let start = Instant::now();
        let image = paint(&mut self.renderer)?.clone();
        self.render += start.elapsed();
        self.counts.images += 1;
        self.counts.size = Some([image.width, image.height]);
        self.counts.dropped += image.dropped;
        let (work, left_out) = (self.renderer.work(), self.renderer.left_out());
        let planes = 1 + u64::from(image.depth.is_some()) + u64::from(image.alpha.is_some());
        let counts = [
            (work.gaussians.saturating_sub(work.culled), work.culled),
            (work.tiles_drawn, work.tiles.saturating_sub(work.tiles_drawn)),
            (work.entries.saturating_sub(work.entries_unseen), work.entries_unseen),
            (planes, PLANES - planes),
            (u64::from(turned), u64::from(!turned)),
            (work.gaussians.saturating_sub(left_out), left_out),
        ];
        for (sum, (done, avoided)) in self.counts.raster.iter_mut().zip(counts) {
            sum[0] += done;
            sum[1] += avoided;
        }
        Ok(image)
    }

    /// Returns true if a Gaussian has touched an image.
    pub fn has_drawn(&self) -> bool {
        self.counts.raster[2] != [0; 2]
    }

    /// Joins the images of two eyes side by side.
    fn beside(&mut self, left: Image, right: Image) -> Image {
        let image = beside(left, right);
        self.counts.images -= 1;
        self.counts.size = Some([image.width, image.height]);
        image
    }

    /// Runs `work` in the time and the span of writing.
    pub fn writing<R>(&mut self, work: impl FnOnce() -> Result<R, Error>) -> Result<R, Error> {
        let _span = tracing::info_span!("write").entered();
        let start = Instant::now();
        let result = work();
        self.write += start.elapsed();
        result
    }

    /// Draws the items that are due and writes them, in order. With two threads or more, an image is drawn while the
    /// one before is written.
    pub fn pass<I, T: Send>(
        &mut self,
        due: impl ExactSizeIterator<Item = I> + Send,
        mut draw: impl FnMut(&mut Drawing, I) -> Result<Option<T>, Error> + Send,
        mut write: impl FnMut(T) -> Result<(), Error>,
    ) -> Result<(), Error> {
        if self.workers.threads() < 2 || due.len() < 2 {
            for item in due {
                let Some(drawn) = draw(self, item)? else { break };
                self.writing(|| write(drawn))?;
            }
            return Ok(());
        }
        let mut seconds = Duration::ZERO;
        let result = std::thread::scope(|scope| {
            let (sender, receiver) = sync_channel(0);
            let drawing = &mut *self;
            let drawn = scope.spawn(move || {
                for item in due {
                    let Some(drawn) = draw(drawing, item)? else { break };
                    if sender.send(drawn).is_err() {
                        break;
                    }
                }
                Ok(())
            });
            for drawn in &receiver {
                let _span = tracing::info_span!("write").entered();
                let start = Instant::now();
                let written = write(drawn);
                seconds += start.elapsed();
                written?;
            }
            drawn.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        });
        self.write += seconds;
        result
    }

    /// Adds the work done and avoided, and the times.
    pub fn account(&self, work: &mut BTreeMap<String, WorkRecord>, seconds: &mut BTreeMap<String, f64>) {
        let [gaussians, tiles, entries, planes, turned, projected] = self.counts.raster;
        for (stage, [done, avoided], unit) in [
            ("render", [self.counts.images, 0], "images"),
            ("render.window", projected, "Gaussians"),
            ("render.project", gaussians, "Gaussians"),
            ("render.tiles", tiles, "tiles"),
            ("render.blend", entries, "splats in tiles"),
            ("render.planes", planes, "planes"),
            ("render.turned", turned, "images"),
        ] {
            work.insert(stage.to_owned(), WorkRecord { done, avoided, unit: unit.to_owned() });
        }
        if self.counts.unfilmed.worst.is_some() {
            let [done, avoided] = self.counts.unfilmed.pixels;
            work.insert("render.unfilmed".to_owned(), WorkRecord { done, avoided, unit: "pixels".to_owned() });
        }
        seconds.insert("render".to_owned(), self.render.as_secs_f64());
        seconds.insert("write".to_owned(), self.write.as_secs_f64());
    }
}

impl Course {
    /// The camera's angles at image number `index`, `time` seconds after the first.
    fn at(&self, index: f64, time: f64) -> turn::Angles {
        match self {
            Course::Held(angles) => between(angles, index),
            Course::Running(turn) => turn.at(time),
        }
    }
}

/// The angles at a fractional index, interpolated; outside, those of the first or the last.
fn between(angles: &[turn::Angles], index: f64) -> turn::Angles {
    let place = index.clamp(0.0, angles.len().saturating_sub(1) as f64);
    let (whole, part) = (place.floor(), place - place.floor());
    let at = |i: usize| angles.get(i).or(angles.last()).copied().unwrap_or_default();
    let (before, after) = (at(whole as usize), at(whole as usize + 1));
    if part == 0.0 {
        return before;
    }
    let mix = |a: f64, b: f64| a * (1.0 - part) + b * part;
    turn::Angles { right: mix(before.right, after.right), up: mix(before.up, after.up) }
}

fn behind() -> Error {
    Error::usage(
        "--stereo: expected cameras that look towards the scene's middle, found one that has it behind itself or sees all around",
    )
}

/// Joins the images of the left and of the right eye side by side, twice as wide.
fn beside(left: Image, right: Image) -> Image {
    let (width, height) = (left.width, left.height);
    let rows = |left: &[f32], right: &[f32]| -> Vec<f32> {
        left.chunks_exact(width).zip(right.chunks_exact(width)).flat_map(|(a, b)| a.iter().chain(b)).copied().collect()
    };
    let plane = |a: &Option<Vec<f32>>, b: &Option<Vec<f32>>| a.as_ref().zip(b.as_ref()).map(|(a, b)| rows(a, b));
    Image {
        width: 2 * width,
        height,
        rgb: rows(&left.rgb, &right.rgb),
        depth: plane(&left.depth, &right.depth),
        alpha: plane(&left.alpha, &right.alpha),
        final_t: plane(&left.final_t, &right.final_t),
        blended: None,
        dropped: left.dropped + right.dropped,
    }
}
