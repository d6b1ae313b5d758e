//! How close images are to frames, for choosing key frames.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crate::gap::Found;
use crate::picture::Picture;
use crate::render::Backend;
use crate::stream::{Interval, Workers};

use crate::run::Error;
use crate::run::choices::Choices;
use crate::run::drawing::Drawing;
use crate::run::record::WorkRecord;
use crate::run::views::Views;

/// A frame in the form in which it is compared: 8-bit samples, as images are written.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Its time, in seconds.
    pub time: f64,
    /// Width and height at which the model sees it, which is at most the frame's own size unless
    /// [`Resolution`](crate::stream::Resolution) is set.
    pub size: [usize; 2],
    /// Samples at that size.
    pub samples: Vec<u8>,
    /// Samples at its own size, where that is another one and images of it are compared.
    pub own: Option<Vec<u8>>,
}

impl Truth {
    /// A frame at `time`, compared at `size` (width and height), and at its own size if `own` is set.
    pub fn new(picture: &Picture, time: f64, size: [usize; 2], own: bool) -> Truth {
        let [width, height] = size;
        if [picture.width, picture.height] == size {
            return Truth { time, size, samples: picture.to_rgb8(), own: None };
        }
        let samples = picture.resized(width, height).to_rgb8();
        Truth { time, size, samples, own: own.then(|| picture.to_rgb8()) }
    }
}

/// PSNR of the images of all frames so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Total {
    /// Sum over frames, in dB.
    sum: f64,
    frames: usize,
    /// That of the worst frame, in dB.
    least: f64,
}

impl Default for Total {
    fn default() -> Total {
        Total { sum: 0.0, frames: 0, least: f64::INFINITY }
    }
}

impl Total {
    fn add(&mut self, psnr: f64) {
        self.sum += psnr;
        self.frames += 1;
        self.least = self.least.min(psnr);
    }

    /// The mean over frames and the least of them, in dB; `None` before the first.
    pub fn figures(&self) -> Option<[f64; 2]> {
        (self.frames > 0).then(|| [self.sum / self.frames as f64, self.least])
    }

    /// The sum and the least as bits, around the number of frames.
    pub fn stored(&self) -> (u64, usize, u64) {
        (self.sum.to_bits(), self.frames, self.least.to_bits())
    }

    /// Continues from what was [stored](Self::stored).
    pub fn resume((sum, frames, least): (u64, usize, u64)) -> Total {
        Total { sum: f64::from_bits(sum), frames, least: f64::from_bits(least) }
    }
}

/// PSNR of images of the source's own size, as they are written, where that is not the size at which the model sees
/// it. Samples of 8 bits are compared.
#[derive(Debug, Default)]
pub struct Whole {
    /// Frames whose images are not drawn yet, by their numbers.
    waiting: BTreeMap<usize, Vec<u8>>,
    /// Those compared so far.
    pub total: Total,
}

impl Whole {
    /// Continues from a [`Total`], as it was stored.
    pub fn resume(total: (u64, usize, u64)) -> Whole {
        Whole { waiting: BTreeMap::new(), total: Total::resume(total) }
    }

    /// Keeps a frame until its image is drawn.
    pub fn expect(&mut self, index: usize, samples: Vec<u8>) {
        self.waiting.insert(index, samples);
    }

    /// Compares an image with its frame.
    pub fn compare(&mut self, index: usize, image: &Picture) {
        let Some(truth) = self.waiting.remove(&index) else { return };
        if let Some(psnr) = psnr_of_samples(&image.to_rgb8(), &truth) {
            self.total.add(psnr);
        }
    }
}

/// 10 log₁₀(255² n / Σ (a − b)²) of n 8-bit samples, in dB; `None` where their numbers differ. For equal images the sum
/// is taken as 1, a difference of one level in one sample.
pub fn psnr_of_samples(image: &[u8], truth: &[u8]) -> Option<f64> {
    if image.len() != truth.len() {
        return None;
    }
    let squares = |(a, b): (&u8, &u8)| u64::from(a.abs_diff(*b)).pow(2);
    let sum: u64 = image.iter().zip(truth).map(squares).sum();
    let peak = 255.0 * 255.0 * truth.len() as f64;
    Some(10.0 * log10(peak / sum.max(1) as f64))
}

/// Base-10 logarithm with the same bits on every machine.
fn log10(x: f64) -> f64 {
    streamsplat_kernels::math::f64::ln(x) / std::f64::consts::LN_10
}

/// Draws intervals from the video's own camera, at the size at which the model sees it, and compares them with their
/// frames. Samples of 8 bits are compared.
pub struct Closeness {
    drawing: Drawing,
    views: Views,
    /// Width and height of the images, once one is compared.
    size: Option<[usize; 2]>,
    /// Times and PSNR of images that were drawn for output with the same settings as here.
    drawn: Vec<(f64, f64)>,
    /// True if all images are such; false if all are drawn here.
    shared: bool,
    total: Total,
    time: Duration,
}

/// PSNR of an image and a frame.
fn compared(image: &Picture, truth: &Truth) -> Result<f64, Error> {
    let sizes = || {
        let ([width, height], found) = (truth.size, [image.width, image.height]);
        Error::work(format!("compared images: expected {width}x{height}, found {}x{}", found[0], found[1]))
    };
    psnr_of_samples(&image.to_rgb8(), &truth.samples).ok_or_else(sizes)
}

impl Closeness {
    /// No comparisons yet. Images are always drawn on the CPU here, because a graphics card's are outside of the bit
    /// contract.
    pub fn new(workers: &Workers) -> Result<Closeness, Error> {
        let drawing = Drawing::new(workers, Backend::Cpu)?;
        let (views, drawn) = (Views::own(), Vec::new());
        Ok(Closeness {
            drawing,
            views,
            size: None,
            drawn,
            shared: false,
            total: Total::default(),
            time: Duration::ZERO,
        })
    }

    /// Compares an image of `views` with its frame among `truths`, if [`Closeness::of`] would draw the same image.
    pub fn take(
        &mut self,
        interval: &Interval,
        (time, image): (f64, &Picture),
        views: &Views,
        truths: &[Truth],
    ) -> Result<(), Error> {
        let [height, width] = interval.placement.content;
        let same = views.shows_frames()
            && views.shutter.is_none()
            && views.backend == Backend::Cpu
            && views.options.background == self.views.options.background
            && [image.width, image.height] == [width, height];
        let truth = truths.iter().find(|truth| same && truth.time.to_bits() == time.to_bits());
        if let Some(truth) = truth {
            let start = Instant::now();
            self.drawn.push((time, compared(image, truth)?));
            self.time += start.elapsed();
        }
        Ok(())
    }

    /// Compares the images of `interval` with its frames, the last of which is the key frame.
    pub fn of(&mut self, interval: &Interval, truths: &[Truth]) -> Result<Option<Found>, Error> {
        let start = Instant::now();
        self.shared = !self.drawn.is_empty();
        let mut ratios = Vec::with_capacity(truths.len());
        for truth in truths {
            let drawn = self.drawn.iter().find(|(of, _)| of.to_bits() == truth.time.to_bits());
            ratios.push(match drawn {
                Some(&(_, ratio)) => ratio,
                None => {
                    let image = self.drawing.draw(interval, 0, truth.time, &self.views)?;
                    compared(&Picture { width: image.width, height: image.height, rgb: image.rgb }, truth)?
                }
            });
        }
        self.drawn.clear();
        self.size = truths.last().map(|truth| truth.size).or(self.size);
        ratios.iter().for_each(|psnr| self.total.add(*psnr));
        self.time += start.elapsed();
        let Some(key) = ratios.pop() else { return Ok(None) };
        let between = (!ratios.is_empty()).then(|| ratios.iter().sum::<f64>() / ratios.len() as f64);
        Ok(Some(Found { key, between }))
    }

    /// The frames compared so far.
    pub fn total(&self) -> Total {
        self.total
    }

    /// Width and height of the images compared so far; `None` before the first.
    pub fn size(&self) -> Option<[usize; 2]> {
        self.size
    }

    /// Continues from these choices.
    pub fn resume(&mut self, choices: &Choices) {
        self.total = choices.compared();
    }

    /// Adds the comparisons to the account.
    pub fn account(&self, work: &mut BTreeMap<String, WorkRecord>, seconds: &mut BTreeMap<String, f64>) {
        let frames = self.total.frames as u64;
        let record = WorkRecord { done: frames, avoided: 0, unit: "frames".to_owned() };
        work.insert("compare".to_owned(), record);
        let [done, avoided] = if self.shared { [0, frames] } else { [frames, 0] };
        work.insert("compare.images".to_owned(), WorkRecord { done, avoided, unit: "images".to_owned() });
        seconds.insert("compare".to_owned(), self.time.as_secs_f64());
    }
}
