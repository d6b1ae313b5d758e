//! Images larger than the model's input, compared with the enlarged model-size image.

use image::imageops::{FilterType, resize};
use image::{ImageBuffer, Rgb};
use streamsplat::metrics::psnr;
use streamsplat::picture::Picture;
use streamsplat::render::RenderError;
use streamsplat::stream::Interval;
use streamsplat::{Camera, RenderOptions, Size};

use crate::workers;

/// PSNR in dB of two images of one frame against it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Enlarging {
    /// Drawn at the frame's size.
    pub drawn: f64,
    /// Drawn at the model's size, and enlarged by bicubic interpolation (Catmull and Rom).
    pub enlarged: f64,
}

/// Both images of the interval at `time`, whose true frame is `truth`, of the source's size.
///
/// # Errors
/// As [`Interval::render`].
///
/// # Panics
/// Where `truth` is not of the source's size.
pub fn enlarging(interval: &Interval, time: f64, truth: &Picture) -> Result<Enlarging, RenderError> {
    let draw = |size| -> Result<Picture, RenderError> {
        let options = RenderOptions { size, ..RenderOptions::default() };
        let image = interval.render(time, &Camera::Canonical, &options, workers())?;
        Ok(Picture { width: image.width, height: image.height, rgb: image.rgb })
    };
    let score = |image: &Picture| psnr(image, truth).expect("the source's size");
    let small = draw(Size::Model)?;
    Ok(Enlarging { drawn: score(&draw(Size::Source)?), enlarged: score(&bicubic(&small, truth.width, truth.height)) })
}

fn bicubic(small: &Picture, width: usize, height: usize) -> Picture {
    let area = small.width * small.height;
    let image = ImageBuffer::from_fn(small.width as u32, small.height as u32, |x, y| {
        Rgb([0, 1, 2].map(|c| small.rgb[c * area + y as usize * small.width + x as usize]))
    });
    let large = resize(&image, width as u32, height as u32, FilterType::CatmullRom);
    let plane = |c: usize| large.pixels().map(move |pixel| pixel.0[c].clamp(0.0, 1.0));
    Picture { width, height, rgb: plane(0).chain(plane(1)).chain(plane(2)).collect() }
}
