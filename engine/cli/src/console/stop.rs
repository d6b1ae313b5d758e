//! Ctrl-C, or a request to terminate: the first one lets the interval at hand finish, the second one ends the program.

use streamsplat::run::Stop;

use super::failure::Failure;

/// Takes signals as requests from now on.
pub fn listen(stop: &Stop) {
    let stop = stop.clone();
    // Without a handler the program just ends, which leaves valid files too.
    let _ = ctrlc::set_handler(move || {
        if stop.ask() {
            std::process::exit(130);
        }
    });
}

/// The failure of a command that was stopped.
pub fn stopped(resumable: bool) -> Failure {
    let how = if resumable { "; the same command with --resume goes on" } else { "" };
    Failure::Stopped(format!("stopped; what was written is valid{how}"))
}
