//! Tracking of a point of the scene through time.
//!
//! [`Interval::pick`] finds the Gaussian with the largest weight at a pixel; a [`Track`] then moves with its identity.
//! Inside an interval it moves with the velocity of the identity's record; from one interval to the next it changes to
//! the record with the same identity. Where the identity ended, it continues with the identity that it
//! [merged](crate::stream::Merge) into. The point keeps its position relative to the motion, not to the Gaussians'
//! lattice, so that motions smaller than a cell add up. A track is lost where the identity is gone.

use streamsplat_kernels::raster::Projection;

use crate::camera::Camera;
use crate::render::{RenderError, View};
use crate::space::{Hit, Picker, Ray, most_visible};
use crate::stream::{Interval, Record, Reference, Snapshot, Workers};

/// A Gaussian at a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Picked {
    /// Index of its record in the interval.
    pub index: usize,
    /// Its identity.
    pub identity: u64,
    /// Its weight in the pixel's colour: αT, at most 1.
    pub weight: f64,
    /// The world position under the pixel at its depth: x right, y normalised inverse depth, z up.
    pub position: [f32; 3],
}

/// A point of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackPoint {
    /// Seconds of the video.
    pub time: f64,
    /// Identity of the tracked Gaussian.
    pub identity: u64,
    /// World position.
    pub position: [f32; 3],
    /// Position in the source's image, in pixels with their centres at whole numbers.
    pub pixel: [f64; 2],
    /// Opacity of the tracked Gaussian.
    pub opacity: f32,
}

/// A point that moves with an identity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Track {
    identity: u64,
    /// World position at `time`.
    position: [f32; 3],
    time: f64,
}

impl Interval {
    /// Finds the Gaussian with the largest αT at a pixel of the source's image (centres at whole numbers) at `time`;
    /// the lowest index among equals. `None` where nothing is drawn.
    ///
    /// # Errors
    /// As [`Snapshot::of`].
    pub fn pick(&self, time: f64, pixel: [f64; 2], workers: &Workers) -> Result<Option<Picked>, RenderError> {
        let seen = Snapshot::of(self, time, workers)?;
        let hit = most_visible(&seen, self.blur(), &self.ray(pixel));
        Ok(hit.map(|hit| self.picked(&seen, time, pixel, hit)))
    }

    /// [`Interval::pick`] for many pixels at one time, in their order.
    ///
    /// # Errors
    /// As [`Snapshot::of`].
    pub fn pick_all(
        &self,
        time: f64,
        pixels: &[[f64; 2]],
        workers: &Workers,
    ) -> Result<Vec<Option<Picked>>, RenderError> {
        let picker = Picker::new(Snapshot::of(self, time, workers)?, self.blur());
        let pick = |&pixel: &[f64; 2]| {
            let hit = picker.pick(&self.ray(pixel));
            hit.map(|hit| self.picked(picker.snapshot(), time, pixel, hit))
        };
        Ok(pixels.iter().map(pick).collect())
    }

    fn picked(&self, seen: &Snapshot, time: f64, pixel: [f64; 2], hit: Hit) -> Picked {
        let [u, v] = self.project(pixel);
        let index = seen.index[hit.place as usize] as usize;
        let record = self.gaussians.get(index);
        let t = self.relative(time).unwrap_or_default();
        let position = [u as f32, record.position_at(t)[1], -v as f32];
        Picked { index, identity: record.identity, weight: hit.weight, position }
    }

    /// The ray through a pixel of the source's image.
    fn ray(&self, pixel: [f64; 2]) -> Ray {
        let [u, v] = self.project(pixel);
        Ray { origin: [u as f32, v as f32, 0.0], direction: [0.0, 0.0, 1.0] }
    }

    /// Low-pass of the pixel grid, added to the variances: 0.3 px².
    fn blur(&self) -> [f64; 3] {
        let [fx, fy] = self.focal();
        [0.3 / (fx * fx), 0.3 / (fy * fy), 0.0]
    }

    /// Pixels per scene unit in an image of the source's size.
    fn focal(&self) -> [f64; 2] {
        match View::new(&Camera::Canonical, &self.placement, self.placement.source).projection() {
            Projection::Orthographic { focal } | Projection::Pinhole { focal, .. } => focal.map(f64::from),
            // The canonical camera is orthographic.
            Projection::Equirectangular => [1.0; 2],
        }
    }

    /// Scene-space x and y of a pixel of the source's image.
    fn project(&self, pixel: [f64; 2]) -> [f64; 2] {
        let p = &self.placement;
        std::array::from_fn(|axis| {
            let side = 1 - axis;
            let part = (pixel[axis] + 0.5) / p.source[side] as f64;
            let inside = p.offset[side] as f64 + part * p.content[side] as f64;
            2.0 * inside / p.model[side] as f64 - 1.0
        })
    }

    /// The pixel of the source's image of a scene-space x and y.
    pub(crate) fn unproject(&self, place: [f64; 2]) -> [f64; 2] {
        let p = &self.placement;
        std::array::from_fn(|axis| {
            let side = 1 - axis;
            let inside = (place[axis] + 1.0) * 0.5 * p.model[side] as f64 - p.offset[side] as f64;
            inside / p.content[side] as f64 * p.source[side] as f64 - 0.5
        })
    }

    /// The record that moves an identity: of two, the one seen forward in time. Records with a number that is not
    /// finite are skipped.
    fn record_of(&self, identity: u64) -> Option<Record> {
        let find = |reference| {
            let g = &self.gaussians;
            let mine = |&i: &usize| g.identity[i] == identity && g.reference[i] == reference;
            (0..g.len()).filter(mine).map(|i| g.get(i)).find(Record::is_sound)
        };
        find(Reference::Start).or_else(|| find(Reference::End))
    }
}

impl Track {
    /// A track of the Gaussian picked at `time`.
    pub fn new(picked: &Picked, time: f64) -> Self {
        Self { identity: picked.identity, position: picked.position, time }
    }

    /// Identity of the tracked Gaussian.
    pub fn identity(&self) -> u64 {
        self.identity
    }

    /// Moves forward through an interval that contains the track's time. Returns its points at `times` (inside the
    /// interval, not before the track's time), and the track at the interval's end, for the next one. `None` when it is
    /// lost.
    pub fn forward(&self, interval: &Interval, times: &[f64]) -> Option<(Vec<TrackPoint>, Track)> {
        let (points, end) = self.along(interval, times, interval.end)?;
        // An identity that continues has not merged.
        let merged = interval.merges.iter().find(|m| m.identity == self.identity);
        Some((points, Track { identity: merged.map_or(self.identity, |m| m.into), ..end }))
    }

    /// Moves backward through an interval that contains the track's time. Returns its points at `times` (inside the
    /// interval, not after the track's time), and the track at the interval's start, for the one before. `None` where
    /// it did not exist yet.
    pub fn backward(&self, interval: &Interval, times: &[f64]) -> Option<(Vec<TrackPoint>, Track)> {
        self.along(interval, times, interval.start)
    }

    fn along(&self, interval: &Interval, times: &[f64], to: f64) -> Option<(Vec<TrackPoint>, Track)> {
        let record = interval.record_of(self.identity)?;
        let from = interval.relative(self.time)?;
        let place = |time: f64| -> Option<[f32; 3]> {
            let since = interval.relative(time)? - from;
            let place = std::array::from_fn(|axis| self.position[axis] + record.velocity[axis] * since);
            // A finite velocity can still overflow.
            place.iter().all(|x: &f32| x.is_finite()).then_some(place)
        };
        let mut points = Vec::with_capacity(times.len());
        for &time in times {
            let position = place(time)?;
            let pixel = interval.unproject([f64::from(position[0]), -f64::from(position[2])]);
            let opacity = record.opacity_at(interval.relative(time)?);
            points.push(TrackPoint { time, identity: self.identity, position, pixel, opacity });
        }
        Some((points, Track { position: place(to)?, time: to, ..*self }))
    }
}
