//! Baselines for the comparison with the scene: pictures made from the two surrounding key frames.

use streamsplat::fit::Placement;
use streamsplat::picture::Picture;
use streamsplat::stream::Workers;
use streamsplat_kernels::flow::{self, Field, Pyramid};

use crate::console::failure::Failure;

/// A key frame's planes at the model's size.
pub(super) struct Placed {
    pub(super) rgb: Vec<f32>,
    pub(super) placement: Placement,
}

/// The key frames of an interval, for blending along the flow between them.
pub(super) struct FlowBlend<'a> {
    pub(super) workers: &'a Workers,
    pub(super) frames: [&'a Placed; 2],
    pub(super) fields: [Field; 2],
}

impl Placed {
    pub(super) fn new(picture: &Picture, placement: Placement, workers: &Workers) -> Placed {
        Placed { rgb: workers.install(|| placement.fit_in(workers.level(), &picture.rgb)), placement }
    }
}

impl<'a> FlowBlend<'a> {
    pub(super) fn new(workers: &'a Workers, a: &'a Placed, b: &'a Placed) -> Result<Self, Failure> {
        let (level, size, options) = (workers.level(), a.placement.model, flow::Options::default());
        workers.install(|| {
            let pyramid = |frame: &Placed| Pyramid::new(level, &flow::luma(level, &frame.rgb), size, &options);
            let [one, other] = [pyramid(a).map_err(Failure::work)?, pyramid(b).map_err(Failure::work)?];
            let fields = [
                flow::between(level, &one, &other, None, &options),
                flow::between(level, &other, &one, None, &options),
            ];
            Ok(Self { workers, frames: [a, b], fields })
        })
    }

    /// Returns the picture at `t` in [0, 1].
    pub(super) fn at(&self, t: f32) -> Picture {
        let ([a, b], [there, back]) = (self.frames, &self.fields);
        let blend = || flow::Blend::new(self.workers.level(), [&a.rgb, &b.rgb], [there, back]).at(t);
        let [height, width] = a.placement.content;
        Picture { width, height, rgb: a.placement.crop(&self.workers.install(blend)) }
    }
}

pub(super) fn mix(a: &Picture, b: &Picture, t: f32) -> Picture {
    let rgb = a.rgb.iter().zip(&b.rgb).map(|(&a, &b)| a * (1.0 - t) + b * t).collect();
    Picture { rgb, ..*a }
}
