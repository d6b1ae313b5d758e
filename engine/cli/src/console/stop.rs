//! Ctrl-C, or a request to terminate: the first one lets the current interval finish, the second one ends the program.

use streamsplat::run::Stop;

use super::failure::Failure;

/// Handles signals as stop requests from now on.
pub fn listen(stop: &Stop) {
    let stop = stop.clone();
    // Without a handler, a signal ends the program at once, which leaves valid files too.
    let _ = ctrlc::set_handler(move || {
        if stop.ask() {
            std::process::exit(130);
        }
    });
}

/// Returns the failure of a stopped command.
pub fn stopped(resumable: bool) -> Failure {
    let how = if resumable { "; the same command with --resume goes on" } else { "" };
    Failure::Stopped(format!("stopped; what was written is valid{how}"))
}
