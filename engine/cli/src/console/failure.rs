//! Failures of commands.

use std::fmt::Display;

/// A failed command: a message of one line and an exit code.
#[derive(Debug)]
pub enum Failure {
    /// Wrong use: exit code 2.
    Usage(String),
    /// The work failed: exit code 1.
    Work(String),
    /// The user stopped it: exit code 130, as in shells.
    Stopped(String),
}

impl Failure {
    /// Returns the failure of wrong use.
    pub fn usage(message: impl Display) -> Failure {
        Failure::Usage(message.to_string())
    }

    /// Returns the failure of the work.
    pub fn work(message: impl Display) -> Failure {
        Failure::Work(message.to_string())
    }

    /// Returns the message, one line.
    pub fn message(&self) -> String {
        let (Failure::Usage(text) | Failure::Work(text) | Failure::Stopped(text)) = self;
        super::visible(&text.split_whitespace().collect::<Vec<_>>().join(" "))
    }

    /// Returns the exit code: 1, 2 or 130.
    pub fn code(&self) -> u8 {
        match self {
            Failure::Usage(_) => 2,
            Failure::Work(_) => 1,
            Failure::Stopped(_) => 130,
        }
    }
}

impl From<streamsplat::run::Error> for Failure {
    fn from(e: streamsplat::run::Error) -> Failure {
        if e.is_usage() { Failure::usage(e) } else { Failure::work(e) }
    }
}

/// Errors of the library are failed work, unless mapped explicitly.
macro_rules! work {
    ($($kind:ty),+) => { $(impl From<$kind> for Failure {
        fn from(e: $kind) -> Failure { Failure::work(e) }
    })+ };
}

work!(
    streamsplat::EngineError,
    streamsplat::RenderError,
    streamsplat::formats::cameras::CameraFileError,
    streamsplat::depth::DepthError,
    streamsplat::lpips::LpipsError,
    streamsplat::onnx::OnnxError,
    streamsplat::output::OutputError,
    streamsplat::scene::SceneError,
    streamsplat::source::SourceError,
    streamsplat::metrics::MetricError,
    streamsplat::view::PageError,
    streamsplat::view::ServeError,
    streamsplat::view::StillError,
    streamsplat_model::ModelError
);
