//! Ctrl-C, or a request to terminate: the first one lets the interval at hand finish, the second one ends the program.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::failure::Failure;

/// A request to stop, shared by all who look for it.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Takes signals as requests from now on.
    pub fn listen(&self) {
        let stop = self.clone();
        // Without a handler the program just ends, which leaves valid files too.
        let _ = ctrlc::set_handler(move || {
            if stop.0.swap(true, Ordering::SeqCst) {
                std::process::exit(130);
            }
        });
    }

    /// Requests it.
    pub fn ask(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// True once it was requested.
    pub fn asked(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// The failure of a command that was stopped.
pub fn stopped(resumable: bool) -> Failure {
    let how = if resumable { "; the same command with --resume goes on" } else { "" };
    Failure::Stopped(format!("stopped; what was written is valid{how}"))
}
