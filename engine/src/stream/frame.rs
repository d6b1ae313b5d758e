//! Frames pushed into the stream, and their errors.

use streamsplat_model::ModelError;

/// A key frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[3, height, width]`, display-space RGB in [0, 1] (values outside are clamped).
    pub rgb: Vec<f32>,
    /// `[height, width]` inverse depth (larger is nearer, any scale), if known. Values that are not finite count as
    /// infinitely far.
    pub depth: Option<Vec<f32>>,
}

/// A time stamp in messages.
fn seconds(time: Option<f64>) -> String {
    time.map_or_else(|| "any".to_owned(), |time| time.to_string())
}

/// The usual name of the vision transformer of this width, in brackets; empty where there is none.
fn vision_transformer(channels: usize) -> &'static str {
    match channels {
        384 => " (ViT-S)",
        768 => " (ViT-B)",
        1024 => " (ViT-L)",
        1536 => " (ViT-g)",
        _ => "",
    }
}

/// Why an engine could not be made, or refused a frame. The stream continues as if the frame had not been pushed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EngineError {
    /// The model could not be loaded or run.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The model is conditioned on DINOv2 features and no DINOv2 weights were given.
    #[error(
        "this model is conditioned on DINOv2 features: expected a file of DINOv2 with it (dinov2_vitb14_reg4_pretrain.pth for the published one), found none"
    )]
    Condition,
    /// The DINOv2 weights are of another width than the model is conditioned on.
    #[error("DINOv2: expected {expected} channels{}, on which the model is conditioned, found {found}{}", vision_transformer(*.expected), vision_transformer(*.found))]
    ConditionChannels {
        /// Channels of the model's condition.
        expected: usize,
        /// Channels of the DINOv2 given.
        found: usize,
    },
    /// The DINOv2 weights have no register tokens, with which models are trained.
    #[error("DINOv2: expected weights with register tokens (reg4 in the file's name), found none")]
    ConditionRegisters,
    /// The thread pool could not be started.
    #[error("cannot start {threads} threads: {reason}")]
    Threads {
        /// Threads requested; 0 is one per processor.
        threads: usize,
        /// Why.
        reason: String,
    },
    /// A frame has no pixels, or more than can be addressed.
    #[error("frame {index}: expected at least 1×1 pixels, found {width}×{height}")]
    Empty {
        /// The key frame's index.
        index: u64,
        /// Its width.
        width: usize,
        /// Its height.
        height: usize,
    },
    /// Optical flow refused a frame.
    #[error("frame {index}: optical flow: {reason}")]
    Flow {
        /// The key frame's index, or that of the one that follows the frame.
        index: u64,
        /// Expected and found values.
        reason: String,
    },
    /// A frame in between has no time between the key frames around it, in ascending order.
    #[error(
        "frame {index}: expected ascending times of the frames before it, after {} s and before {before} s, found {found} s",
        seconds(*.after)
    )]
    Between {
        /// The key frame's index.
        index: u64,
        /// The time before.
        after: Option<f64>,
        /// The key frame's time.
        before: f64,
        /// The time found.
        found: f64,
    },
    /// The model takes no frames of the requested resolution.
    #[error("resolution {}x{}: expected {expected} (HEIGHTxWIDTH)", found[0], found[1])]
    Resolution {
        /// Sizes that the model takes.
        expected: String,
        /// Height and width requested.
        found: [usize; 2],
    },
    /// A buffer has another length than the frame's size requires.
    #[error("frame {index}: {what}: expected {expected} values, found {found}")]
    Length {
        /// The key frame's index.
        index: u64,
        /// `rgb` or `depth`.
        what: &'static str,
        /// Values that the size requires.
        expected: usize,
        /// Values there are.
        found: usize,
    },
    /// A frame has another size than the first one.
    #[error("frame {index}: expected {}×{} pixels as in the first frame, found {}×{}", expected[1], expected[0], found[1], found[0])]
    Size {
        /// The key frame's index.
        index: u64,
        /// Height and width of the first frame.
        expected: [usize; 2],
        /// Height and width of this one.
        found: [usize; 2],
    },
    /// A pixel is NaN or infinite.
    #[error("frame {index}: expected finite pixels, found {value} at flat index {position} of rgb")]
    NonFinite {
        /// The key frame's index.
        index: u64,
        /// Index of the first bad value.
        position: usize,
        /// The value.
        value: f32,
    },
    /// A time stamp is not a number, or not after the one before.
    #[error("frame {index}: expected a time after {} s, found {found} s", seconds(*.after))]
    Time {
        /// The key frame's index.
        index: u64,
        /// The time stamp of the key frame before, if any.
        after: Option<f64>,
        /// This one.
        found: f64,
    },
    /// A resume point that does not fit this frame.
    #[error("resume point of frame {index}: {reason}")]
    ResumePoint {
        /// The key frame's index.
        index: u64,
        /// Expected and found values.
        reason: String,
    },
    /// The reconstructor returned arrays of other lengths than one record per Gaussian.
    #[error("frame {index}: {what}: expected {expected} records, found {found}")]
    Records {
        /// The key frame's index.
        index: u64,
        /// The array.
        what: &'static str,
        /// Gaussians of the frame.
        expected: usize,
        /// Records there are.
        found: usize,
    },
}
