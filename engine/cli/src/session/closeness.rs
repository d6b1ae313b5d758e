//! How close images come to frames, for choosing key frames.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use streamsplat::gap::Found;
use streamsplat::metrics::psnr;
use streamsplat::picture::Picture;
use streamsplat::render::Backend;
use streamsplat::stream::{Interval, Workers};

use crate::console::failure::Failure;
use crate::options::settings::Views;
use crate::output::choices::Choices;
use crate::output::record::WorkRecord;
use crate::session::drawing::Drawing;

/// Side of the pictures that are compared.
pub const SIDE: usize = 256;

/// A frame as it is compared.
#[derive(Clone, Debug)]
pub struct Truth {
    pub time: f64,
    /// Of [`SIDE`] × [`SIDE`] pixels.
    pub picture: Picture,
}

/// Draws intervals from the video's own camera, at the size at which the model sees frames, and compares them with their frames.
pub struct Closeness {
    drawing: Drawing,
    views: Views,
    /// Sum over all frames of PSNR, in dB.
    sum: f64,
    frames: usize,
    time: Duration,
}

impl Closeness {
    /// Nothing compared yet. A graphics card's images are outside of the bit contract, so that it never draws here.
    pub fn new(workers: &Workers) -> Result<Closeness, Failure> {
        let drawing = Drawing::new(workers, Backend::Cpu)?;
        Ok(Closeness { drawing, views: Views::own(), sum: 0.0, frames: 0, time: Duration::ZERO })
    }

    /// Compares the images of `interval` with its frames, the key frame last.
    pub fn of(&mut self, interval: &Interval, truths: &[Truth]) -> Result<Option<Found>, Failure> {
        let start = Instant::now();
        let mut ratios = Vec::with_capacity(truths.len());
        for Truth { time, picture } in truths {
            let image = self.drawing.draw(interval, 0, *time, &self.views)?;
            let image = Picture { width: image.width, height: image.height, rgb: image.rgb }.resized(SIDE, SIDE);
            ratios.push(psnr(&image, picture).map_err(Failure::work)?);
        }
        self.sum += ratios.iter().sum::<f64>();
        self.frames += ratios.len();
        self.time += start.elapsed();
        let Some(key) = ratios.pop() else { return Ok(None) };
        let between = (!ratios.is_empty()).then(|| ratios.iter().sum::<f64>() / ratios.len() as f64);
        Ok(Some(Found { key, between, frames: ratios.len() + 1 }))
    }

    /// Sum of PSNR over all frames compared so far, in dB, and their number.
    pub fn compared(&self) -> (f64, usize) {
        (self.sum, self.frames)
    }

    /// Mean PSNR over all frames compared so far, in dB.
    pub fn mean(&self) -> Option<f64> {
        (self.frames > 0).then(|| self.sum / self.frames as f64)
    }
}

impl Closeness {
    /// Goes on from these choices.
    pub fn resume(&mut self, choices: &Choices) {
        (self.sum, self.frames) = choices.compared();
    }

    /// Adds what was compared.
    pub fn account(&self, work: &mut BTreeMap<String, WorkRecord>, seconds: &mut BTreeMap<String, f64>) {
        let record = WorkRecord { done: self.frames as u64, avoided: 0, unit: "frames".to_owned() };
        work.insert("compare".to_owned(), record);
        seconds.insert("compare".to_owned(), self.time.as_secs_f64());
    }
}
