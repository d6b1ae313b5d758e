//! The threads and the instruction set of an engine.

use std::sync::Arc;

use streamsplat_kernels::Level;

use super::EngineError;

/// A pool of threads and an instruction-set level. Neither changes an output bit; clones share the pool.
#[derive(Clone, Debug)]
pub struct Workers {
    level: Level,
    pool: Arc<rayon::ThreadPool>,
}

impl Workers {
    /// A pool of `threads` threads (0: one per processor) that work at `level`.
    ///
    /// # Errors
    /// When the system refuses to start them.
    pub fn new(level: Level, threads: usize) -> Result<Self, EngineError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|i| format!("streamsplat-{i}"))
            .build()
            .map_err(|e| EngineError::Threads { threads, reason: e.to_string() })?;
        Ok(Self { level, pool: Arc::new(pool) })
    }

    /// The instruction-set level.
    pub fn level(&self) -> Level {
        self.level
    }

    /// The number of threads.
    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// Runs `work` on the pool.
    pub fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        self.pool.install(work)
    }
}
