//! The online loop: key frames in, intervals of dynamic Gaussians out.
//!
//! ```text
//! frame ─ fit ─ static blocks ─┬─ embed ─ static Gaussians ─ lift ─ fit colours ─┐
//!                              │                                                 ├─ fuse ─ fit rates ─ interval
//! the frame before (kept) ─────┴─ motion: flow, or the network on the pair ──────┘
//! ```
//!
//! [`Engine::push`] does this; results of the frame before are never computed again. `canonical` describes how
//! Gaussians live from key frame to key frame, `matching` how they are matched.
//!
//! Motion and opacity inside an interval have the form of StreamSplat's deformation fields (ICLR 2026) over a time that
//! runs from 0 to 1, whatever the interval's length in seconds.

mod between;
mod canonical;
mod colours;
mod detail;
mod engine;
mod frame;
mod fuse;
mod gaussians;
mod identities;
mod interval;
mod keep;
mod keyframe;
mod lift;
mod matching;
mod motion;
mod network;
mod pair;
mod pass;
mod quality;
mod reconstructor;
mod resolution;
mod resume;
mod settings;
mod snapshot;
mod still;
mod tiles;
mod work;
mod workers;

pub use canonical::Current;
pub use engine::Engine;
pub use frame::{EngineError, Frame};
pub use gaussians::{DynamicGaussians, HANDOVER, Handover, Record, Reference};
pub use interval::{Interval, Merge};
pub use keep::{KeptState, Past};
pub use lift::{Covered, DepthMap};
pub use network::{EMBEDDED_CHECKPOINT, EMBEDDED_CONFIG};
pub use quality::{Preset, Quality};
pub use reconstructor::{Motion, Reconstructor, Session, Tiling};
pub use resolution::Resolution;
pub use resume::ResumePoint;
pub use settings::{
    Behind, Decibels, DepthRange, Fade, FlowEffort, Fusion, MaxAge, ModelSource, MotionFrom, Reuse, SamplingMode,
    Settings, StaticRegions,
};
pub use snapshot::Snapshot;
pub use work::{StageWork, Work};
pub use workers::Workers;

pub use streamsplat_model::columns::{Column, Numbers, Value};

#[cfg(test)]
mod tests;
