//! What the stream holds of the frames before.

use super::CELL;
use super::blocks::Blocks;

/// The past of each block of a key frame's picture, where that picture is the mean itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Past {
    /// Frames in the mean.
    pub count: Vec<u32>,
    /// Frames in the mean when colours were last fitted to it.
    pub fitted: Vec<u32>,
    /// The means over cells at that fit, `[3, H/4, W/4]`.
    pub anchor: Vec<f32>,
}

impl Past {
    /// The past of a key frame whose Gaussians were all computed.
    pub(super) fn none(blocks: Blocks, rgb: &[f32]) -> Self {
        let mut anchor = vec![0.0; rgb.len() / (CELL * CELL)];
        for at in 0..blocks.count() {
            blocks.cell_means(at, |i| rgb[i], |place, mean| anchor[place] = mean);
        }
        Self { count: vec![1; blocks.count()], fitted: vec![1; blocks.count()], anchor }
    }

    /// Returns why this cannot be the past of a picture of this size.
    pub(super) fn contradiction(&self, size: [usize; 2]) -> Option<String> {
        let Some(blocks) = Blocks::of(size) else {
            return Some(format!("expected no past of blocks of a picture of {}x{}", size[1], size[0]));
        };
        let lengths = [self.count.len(), self.fitted.len(), self.anchor.len()];
        let expected = [blocks.count(), blocks.count(), 3 * size[0] * size[1] / (CELL * CELL)];
        if lengths != expected {
            return Some(format!("expected a past of {expected:?} numbers, found {lengths:?}"));
        }
        let counted = self.count.iter().zip(&self.fitted).all(|(count, fitted)| (1..=*count).contains(fitted));
        (!counted).then(|| "expected blocks of one frame or more".to_owned())
    }
}
