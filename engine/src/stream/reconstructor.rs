//! Reconstructors, which turn frames into Gaussians and motion: a network, or anything with the same interface.

use std::sync::Arc;

use streamsplat_model::reuse::{Saving, Tokens};
use streamsplat_model::zero_output::ZeroOutput;
use streamsplat_model::{Embedding, FrameInput, ModelError, Sampling, Side, StaticGaussians};

/// Velocity (world units per interval) and (γ₀, γ₁) of each of a frame's Gaussians.
pub type Motion = (Vec<[f32; 3]>, Vec<[f32; 2]>);

/// How a reconstructor takes frames of other sizes than its own: see [`Reconstructor::at`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tiling {
    /// Sides of frames are multiples of this many pixels.
    pub patch: usize,
    /// Gaussians along a patch's side; those of a frame are in row order.
    pub cells: usize,
    /// True if frames may be smaller than its own size; otherwise a larger picture is covered by frames of its own
    /// size.
    pub partial: bool,
}

/// Turns frames into static Gaussians, and pairs of frames into motion, stage by stage.
///
/// The results must be functions of the arguments alone, or, in a session that keeps results, of the arguments of all
/// calls so far: the stream keeps and reuses them.
pub trait Reconstructor: Send + Sync {
    /// Height and width of the frames it takes.
    fn resolution(&self) -> [usize; 2];

    /// How larger frames can be composed of frames that it takes; `None` where they cannot.
    fn tiling(&self) -> Option<Tiling> {
        None
    }

    /// Returns the same reconstructor for frames of this height and width, which [`Reconstructor::tiling`] must allow.
    fn at(&self, resolution: [usize; 2]) -> Option<Arc<dyn Reconstructor>> {
        let _ = resolution;
        None
    }

    /// Returns true if its Gaussians do not depend on [`FrameInput::depth`]. A depth map is then not passed to it: the
    /// stream lifts the Gaussians to the map.
    fn ignores_depth(&self) -> bool {
        false
    }

    /// Residual branches that add nothing and are left out, by part.
    fn zero_output(&self) -> &[ZeroOutput] {
        &[]
    }

    /// Starts a session for one stream of frames. With `saving` it may leave out work from frame to frame.
    fn session(self: Arc<Self>, saving: Option<Saving>) -> Box<dyn Session>;
}

/// One stream of frames through a [`Reconstructor`], in stages that a stream calls in the order of its frames.
///
/// A stream whose frames are composed of several tiles ([`Reconstructor::tiling`]) has a session for each of them, and
/// calls these from several threads at the same time. Work is done on the calling thread and its rayon pool.
pub trait Session: Send + Sync {
    /// The encoder: a frame's embedding.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn embed(&mut self, frame: &FrameInput<'_>) -> Result<Embedding, ModelError>;

    /// The static upsampler: a frame's tokens, one per Gaussian.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn upsample(&mut self, embedding: &Embedding) -> Result<Vec<f32>, ModelError>;

    /// The static head: a frame's Gaussians at its own time, from the latest tokens.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn gaussians(&mut self, tokens: &[f32], sampling: &Sampling) -> Result<StaticGaussians, ModelError>;

    /// Returns true if it is faster to compute a part of a frame's patches than all of them. The stream then calls
    /// [`Session::embed_part`] and what follows it where it needs no others.
    fn computes_parts(&self) -> bool {
        false
    }

    /// [`Session::embed`] for the patches `part` of the frame (of [`Tiling::patch`] pixels, row by row, ascending). The
    /// result serves [`Session::upsample_part`] of the same patches alone. By default everything is computed.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn embed_part(&mut self, frame: &FrameInput<'_>, part: &[u32]) -> Result<Embedding, ModelError> {
        let _ = part;
        self.embed(frame)
    }

    /// [`Session::upsample`] after [`Session::embed_part`], for [`Session::gaussians_part`].
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn upsample_part(&mut self, embedding: &Embedding, part: &[u32]) -> Result<Vec<f32>, ModelError> {
        let _ = part;
        self.upsample(embedding)
    }

    /// [`Session::gaussians`] at the mean after [`Session::upsample_part`]: as many Gaussians as of the whole frame.
    /// Those of the patches `part` have the same bits, the others have no meaning.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn gaussians_part(&mut self, tokens: &[f32], part: &[u32]) -> Result<StaticGaussians, ModelError> {
        let _ = part;
        self.gaussians(tokens, &Sampling::Mean)
    }

    /// Returns true if [`Session::gaussians`] depends on its [`Sampling`].
    fn draws_positions(&self) -> bool;

    /// Returns true if [`Session::condition`] returns features; it is not called otherwise.
    fn reads_condition(&self) -> bool;

    /// Features of a frame that [`Session::decode`] requires in addition to its embedding, if any.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn condition(&mut self, frame: &FrameInput<'_>) -> Result<Option<Vec<f32>>, ModelError>;

    /// The dynamic decoder: both frames' deformation embeddings over the interval from `a` to `b`.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn decode(&mut self, a: &Side<'_>, b: &Side<'_>) -> Result<[Vec<f32>; 2], ModelError>;

    /// The deformation upsampler: the tokens, one per Gaussian, of the pair's earlier (`place` 0) or later (1) frame.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn upsample_motion(&mut self, place: usize, d: &[f32]) -> Result<Vec<f32>, ModelError>;

    /// The deformation head: the motion of the Gaussians of the pair's earlier (`place` 0) or later (1) frame, from its
    /// static and its latest motion tokens.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn motion(&mut self, place: usize, static_tokens: &[f32], motion_tokens: &[f32]) -> Result<Motion, ModelError>;

    /// Tokens computed and kept so far, part by part; `None` where nothing is kept.
    fn tokens(&self) -> Option<Vec<(&'static str, Tokens)>> {
        None
    }

    /// Discards kept results: the next call is computed in full.
    fn forget(&mut self) {}

    /// Frees memory for intermediate results that is kept for the next call. The stream calls it after each frame. No
    /// result depends on it.
    fn release(&self) {}
}
