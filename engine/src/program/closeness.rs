//! How close images come to frames, for choosing key frames.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use streamsplat::gap::{ControlState, Found};
use streamsplat::metrics::psnr;
use streamsplat::picture::Picture;
use streamsplat::render::Backend;
use streamsplat::stream::{Interval, Workers};

use super::drawing::Drawing;
use super::failure::Failure;
use super::record::WorkRecord;
use super::settings::Views;

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
            let image = self.drawing.draw(interval, *time, &self.views)?;
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

    /// Mean PSNR over all frames compared so far, in dB.
    pub fn mean(&self) -> Option<f64> {
        (self.frames > 0).then(|| self.sum / self.frames as f64)
    }
}

/// What key frames were chosen so far, and what the next choices rest on.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Choices {
    /// Frames from each key frame to the next.
    pub gaps: Vec<usize>,
    /// What was known when the last of them was chosen.
    pub state: ControlState,
    /// What has been found since: PSNR of the key frame and of those in between, as bits, and the number of frames.
    recent: VecDeque<(u64, Option<u64>, usize)>,
    /// The sum of PSNR over all frames compared, as bits, and their number.
    compared: (u64, usize),
}

impl Choices {
    /// The same before its choices are made again.
    pub fn replayed(&self) -> Choices {
        Choices { gaps: Vec::new(), ..self.clone() }
    }

    /// Another key frame was chosen, `gap` frames after the one before; `None` for the first.
    pub fn add(&mut self, gap: Option<usize>, state: ControlState) {
        self.gaps.extend(gap);
        self.state = state;
    }

    /// What a choice may not know yet: the last two intervals.
    pub fn found(&mut self, found: &Found, closeness: &Closeness) {
        self.recent.push_back((found.key.to_bits(), found.between.map(f64::to_bits), found.frames));
        if self.recent.len() > 2 {
            self.recent.pop_front();
        }
        self.compared = (closeness.sum.to_bits(), closeness.frames);
    }

    /// What has been found since the last choice.
    pub fn recent(&self) -> impl Iterator<Item = Found> {
        self.recent.iter().map(|&(key, between, frames)| Found {
            key: f64::from_bits(key),
            between: between.map(f64::from_bits),
            frames,
        })
    }
}

impl Closeness {
    /// Goes on from these choices.
    pub fn resume(&mut self, choices: &Choices) {
        (self.sum, self.frames) = (f64::from_bits(choices.compared.0), choices.compared.1);
    }

    /// Adds what was compared.
    pub fn account(&self, work: &mut BTreeMap<String, WorkRecord>, seconds: &mut BTreeMap<String, f64>) {
        let record = WorkRecord { done: self.frames as u64, avoided: 0, unit: "frames".to_owned() };
        work.insert("compare".to_owned(), record);
        seconds.insert("compare".to_owned(), self.time.as_secs_f64());
    }
}
