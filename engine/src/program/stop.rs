//! Ctrl-C, or a request to terminate: the first one lets the interval at hand finish, the second one ends the program.

use super::failure::Failure;
use std::sync::atomic::{AtomicBool, Ordering};

static ASKED: AtomicBool = AtomicBool::new(false);

/// Listens from now on.
pub fn listen() {
    // Without a handler the program just ends, which leaves valid files too.
    let _ = ctrlc::set_handler(|| {
        if ASKED.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
    });
}

/// How a command ends that the user stopped.
pub fn stopped(resumable: bool) -> Failure {
    let how = if resumable { "; the same command with --resume goes on" } else { "" };
    Failure::Stopped(format!("stopped; what was written is valid{how}"))
}

/// Whether the user asked to stop.
pub fn asked() -> bool {
    ASKED.load(Ordering::SeqCst)
}
