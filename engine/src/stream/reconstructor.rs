//! What turns frames into Gaussians and motion: a network, or anything that can stand in for one.

use streamsplat_model::{Deformation, Embedding, FrameInput, ModelError, Sampling, Side, StaticFrame};

/// Turns frames into static Gaussians, and pairs of frames into motion.
///
/// The results must be functions of the arguments alone: the stream keeps and reuses them. Work is done on the calling thread
/// and its rayon pool.
pub trait Reconstructor: Send + Sync {
    /// Height and width of the frames it takes.
    fn resolution(&self) -> [usize; 2];

    /// The frame's embedding.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn embed(&self, frame: &FrameInput<'_>) -> Result<Embedding, ModelError>;

    /// The Gaussians of the frame at its own time.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn static_gaussians(&self, embedding: &Embedding, sampling: &Sampling) -> Result<StaticFrame, ModelError>;

    /// Whether [`Reconstructor::static_gaussians`] gives other Gaussians for another [`Sampling`]. Its tokens never differ.
    fn draws_positions(&self) -> bool;

    /// Whether [`Reconstructor::condition`] gives anything; it is not called otherwise.
    fn reads_condition(&self) -> bool;

    /// What [`Reconstructor::deform`] needs to know of a frame beyond its embedding, if anything.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn condition(&self, frame: &FrameInput<'_>) -> Result<Option<Vec<f32>>, ModelError>;

    /// The motion of both frames' Gaussians over the interval from `a` to `b`.
    ///
    /// # Errors
    /// Whatever the reconstructor refuses.
    fn deform(&self, a: Side<'_>, b: Side<'_>) -> Result<[Deformation; 2], ModelError>;
}
