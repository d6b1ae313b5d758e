//! Reconstructors, which turn frames into Gaussians and motion: a network, or anything that can stand in for one.

use std::sync::Arc;

use streamsplat_model::reuse::{Memory, Saving};
use streamsplat_model::silent::Silent;
use streamsplat_model::{Embedding, FrameInput, ModelError, Sampling, Side, StaticGaussians};

/// Velocity (world units per interval) and (γ₀, γ₁) of each of a frame's Gaussians.
pub type Motion = (Vec<[f32; 3]>, Vec<[f32; 2]>);

/// How a reconstructor takes frames of other sizes than its own: see [`Reconstructor::at`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tiling {
    /// Sides of frames are multiples of this many pixels.
    pub patch: usize,
    /// Gaussians along a patch's side; a frame's are given row by row.
    pub cells: usize,
    /// True if frames may be smaller than its own; otherwise a larger picture is covered by frames of its own size.
    pub partial: bool,
}

/// Turns frames into static Gaussians, and pairs of frames into motion, stage by stage.
///
/// The results must be functions of the arguments alone: the stream keeps and reuses them. Work is done on the calling thread
/// and its rayon pool.
///
/// A reconstructor that can leave out work from frame to frame gives a [`Memory`] and has a second form of each stage, `*_keeping`, that reads and
/// changes it. A stream calls either form, of all stages, in the order of its frames.
pub trait Reconstructor: Send + Sync {
    /// Height and width of the frames it takes.
    fn resolution(&self) -> [usize; 2];

    /// How larger frames can be put together from frames that it takes; `None`: not at all.
    fn tiling(&self) -> Option<Tiling> {
        None
    }

    /// The same reconstructor for frames of this height and width, which [`Reconstructor::tiling`] must allow.
    fn at(&self, resolution: [usize; 2]) -> Option<Arc<dyn Reconstructor>> {
        let _ = resolution;
        None
    }

    /// The encoder: a frame's embedding.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn embed(&self, frame: &FrameInput<'_>) -> Result<Embedding, ModelError>;

    /// The static upsampler: a frame's tokens, one per Gaussian.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn upsample(&self, embedding: &Embedding) -> Result<Vec<f32>, ModelError>;

    /// The static head: a frame's Gaussians at its own time.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn gaussians(&self, tokens: &[f32], sampling: &Sampling) -> Result<StaticGaussians, ModelError>;

    /// Returns true if [`Reconstructor::gaussians`] gives other Gaussians for another [`Sampling`].
    fn draws_positions(&self) -> bool;

    /// Returns true if its Gaussians do not depend on [`FrameInput::depth`]. A depth map then does not reach it: the stream lifts the Gaussians to the map.
    fn ignores_depth(&self) -> bool {
        false
    }

    /// Returns true if [`Reconstructor::condition`] gives anything; it is not called otherwise.
    fn reads_condition(&self) -> bool;

    /// Features of a frame that [`Reconstructor::decode`] needs beyond its embedding, if any.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn condition(&self, frame: &FrameInput<'_>) -> Result<Option<Vec<f32>>, ModelError>;

    /// The dynamic decoder: both frames' deformation embeddings over the interval from `a` to `b`.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn decode(&self, a: &Side<'_>, b: &Side<'_>) -> Result<[Vec<f32>; 2], ModelError>;

    /// The deformation upsampler: one frame's deformation tokens, one per Gaussian.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn upsample_motion(&self, d: &[f32]) -> Result<Vec<f32>, ModelError>;

    /// The deformation head: the motion of one frame's Gaussians, from both kinds of tokens.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn motion(&self, static_tokens: &[f32], motion_tokens: &[f32]) -> Result<Motion, ModelError>;

    /// Residual branches that add nothing and are left out, by part.
    fn silent(&self) -> &[Silent] {
        &[]
    }

    /// An empty memory, where there is anything to keep.
    fn memory(&self, saving: Saving) -> Option<Memory> {
        let _ = saving;
        None
    }

    /// [`Reconstructor::embed`] with a memory.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn embed_keeping(&self, frame: &FrameInput<'_>, memory: &mut Memory) -> Result<Embedding, ModelError> {
        let _ = memory;
        self.embed(frame)
    }

    /// [`Reconstructor::upsample`] with a memory.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn upsample_keeping(&self, embedding: &Embedding, memory: &mut Memory) -> Result<Vec<f32>, ModelError> {
        let _ = memory;
        self.upsample(embedding)
    }

    /// [`Reconstructor::gaussians`] of the latest tokens, with a memory.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn gaussians_keeping(
        &self,
        tokens: &[f32],
        sampling: &Sampling,
        memory: &mut Memory,
    ) -> Result<StaticGaussians, ModelError> {
        let _ = memory;
        self.gaussians(tokens, sampling)
    }

    /// [`Reconstructor::decode`] with a memory.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn decode_keeping(&self, a: &Side<'_>, b: &Side<'_>, memory: &mut Memory) -> Result<[Vec<f32>; 2], ModelError> {
        let _ = memory;
        self.decode(a, b)
    }

    /// [`Reconstructor::upsample_motion`] of the pair's earlier (0) or later (1) frame, with a memory.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn upsample_motion_keeping(&self, place: usize, d: &[f32], memory: &mut Memory) -> Result<Vec<f32>, ModelError> {
        let _ = (place, memory);
        self.upsample_motion(d)
    }

    /// [`Reconstructor::motion`] of the latest motion tokens of the pair's earlier (0) or later (1) frame, with a memory.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn motion_keeping(
        &self,
        place: usize,
        static_tokens: &[f32],
        motion_tokens: &[f32],
        memory: &mut Memory,
    ) -> Result<Motion, ModelError> {
        let _ = (place, memory);
        self.motion(static_tokens, motion_tokens)
    }
}
