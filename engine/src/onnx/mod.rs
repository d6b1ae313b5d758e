//! Networks in ONNX files, run by ONNX Runtime.
//!
//! The runtime's shared library is loaded when the first network is opened; it is not linked, and nothing is
//! downloaded. It is searched for in this order:
//!
//! 1. the file that the environment variable `ORT_DYLIB_PATH` names (if set, no other place is tried);
//! 2. the folder of the running program;
//! 3. the `onnxruntime` package of Python: that of the virtual environment in `VIRTUAL_ENV`, then of `python3`, then of
//!    `python`.
//!
//! Version [`OLDEST`] or newer is required. A process loads one library, once.
//!
//! ONNX Runtime's arithmetic is outside the bit contract: it may differ between its versions and between CPUs. On one
//! machine with one version, the results have the same bits in every run and for any number of threads. For this, every
//! network runs on one thread, node after node, with deterministic kernels: work that is split over several threads may
//! be summed in another order. Inputs and results are processed by this crate's own arithmetic.

mod elf;
mod find;
mod library;
mod model;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use ort::environment::Environment;
use ort::logging::LogLevel;

pub use elf::announced_length;
pub use model::{Layout, Model, Port};

/// The oldest supported version of ONNX Runtime, as major and minor number.
pub const OLDEST: (u32, u32) = (1, ort::MINOR_VERSION);

/// Error of loading or running a network.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OnnxError {
    /// The library was not found.
    #[error(
        "ONNX Runtime is not installed: ORT_DYLIB_PATH is not set, there is no {library} in {}, and {python}; \
         install it with: python3 -m pip install 'onnxruntime>={}.{}'",
        beside.display(), OLDEST.0, OLDEST.1
    )]
    Missing {
        /// File name of the library.
        library: &'static str,
        /// The program's folder.
        beside: PathBuf,
        /// Result of the search in Python.
        python: String,
    },
    /// The file in `ORT_DYLIB_PATH` does not exist.
    #[error("ORT_DYLIB_PATH={}: no such file, expected ONNX Runtime's shared library", .0.display())]
    Named(PathBuf),
    /// The file is not ONNX Runtime.
    #[error(
        "{}: expected ONNX Runtime's shared library, found one that cannot be used: {cause}; \
         install it with: python3 -m pip install --force-reinstall 'onnxruntime>={}.{}'",
        path.display(), OLDEST.0, OLDEST.1
    )]
    Broken {
        /// The library.
        path: PathBuf,
        /// The cause.
        cause: String,
    },
    /// The library is older than [`OLDEST`].
    #[error(
        "{}: expected ONNX Runtime {}.{} or newer, found {found}; \
         install it with: python3 -m pip install --upgrade 'onnxruntime>={}.{}'",
        path.display(), OLDEST.0, OLDEST.1, OLDEST.0, OLDEST.1
    )]
    TooOld {
        /// The library.
        path: PathBuf,
        /// Its version.
        found: String,
    },
    /// The network cannot be read.
    #[error("{}: expected an ONNX network, found one that cannot be loaded: {cause}", path.display())]
    Model {
        /// The network's file.
        path: PathBuf,
        /// Message of the system or the runtime.
        cause: String,
    },
    /// The network's inputs or outputs do not have the required form.
    #[error("{}: {what}: expected {expected}, found {found}", path.display())]
    Form {
        /// The network's file.
        path: PathBuf,
        /// The input or output.
        what: String,
        /// Supported kinds.
        expected: String,
        /// The kind found.
        found: String,
    },
    /// The network failed while running.
    #[error("{}: the network failed: {cause}", path.display())]
    Run {
        /// The network's file.
        path: PathBuf,
        /// Message of the runtime.
        cause: String,
    },
}

/// The loaded library.
#[derive(Clone)]
pub struct Runtime {
    environment: Environment,
    path: Arc<Path>,
    version: Arc<str>,
}

impl std::fmt::Debug for Runtime {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Runtime").field("path", &self.path).field("version", &self.version).finish()
    }
}

/// The loaded runtime; a failed load may be tried again.
static LOADED: Mutex<Option<Runtime>> = Mutex::new(None);

impl Runtime {
    /// Finds and loads the library; later calls return the library that the first one loaded.
    ///
    /// # Errors
    /// No library, or one that is broken or too old.
    pub fn load() -> Result<Runtime, OnnxError> {
        let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(runtime) = &*loaded {
            return Ok(runtime.clone());
        }
        let path = find::library()?;
        let version = library::version(&path)?;
        let broken = |cause: String| OnnxError::Broken { path: path.clone(), cause };
        let environment = ort::init_from(&path)
            .map_err(|e| broken(e.to_string()))?
            .with_name(env!("CARGO_PKG_NAME"))
            .with_telemetry(false)
            .with_logger(Arc::new(log))
            .build()
            .map_err(|e| broken(e.to_string()))?;
        environment.set_log_level(LogLevel::Error);
        Ok(loaded.insert(Runtime { environment, path: path.into(), version: version.into() }).clone())
    }

    /// Returns the library's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns its version, such as `1.31.1`.
    pub fn version(&self) -> &str {
        &self.version
    }
}

/// Passes the runtime's messages to the log. Errors are also returned as results.
fn log(level: LogLevel, category: &str, _id: &str, _location: &str, message: &str) {
    tracing::debug!(target: "onnxruntime", ?level, category, message);
}
