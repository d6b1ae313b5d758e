//! Why a run failed.

use crate::depth::DepthError;
use crate::formats::cameras::CameraFileError;
use crate::output::OutputError;
use crate::scene::SceneError;
use crate::source::SourceError;
use crate::{EngineError, RenderError};

/// Why a run failed. Messages are one line and contain the file or the option (as on the command line, `--gap`), the
/// expected and the found value.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Wrong use: an option or a place that is not possible for the run.
    #[error("{0}")]
    Usage(String),
    /// Failed work of any other kind.
    #[error("{0}")]
    Work(String),
    /// The engine refused a model, its settings or a frame.
    #[error("{dashes}{0}", dashes = if matches!(.0, EngineError::Resolution { .. }) { "--" } else { "" })]
    Engine(#[from] EngineError),
    /// An image could not be drawn.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// The camera's file could not be read.
    #[error(transparent)]
    Camera(#[from] CameraFileError),
    /// A depth map could not be read or computed.
    #[error(transparent)]
    Depth(#[from] DepthError),
    /// A file could not be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// A scene could not be written or read.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The input could not be read.
    #[error(transparent)]
    Source(#[from] SourceError),
}

impl Error {
    /// Wrong use.
    pub fn usage(message: impl std::fmt::Display) -> Error {
        Error::Usage(message.to_string())
    }

    /// Failed work.
    pub fn work(message: impl std::fmt::Display) -> Error {
        Error::Work(message.to_string())
    }

    /// Returns true for wrong use.
    pub fn is_usage(&self) -> bool {
        matches!(self, Error::Usage(_) | Error::Engine(EngineError::Resolution { .. }))
    }
}
