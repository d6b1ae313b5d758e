//! The `streamsplat` program.
#![deny(unsafe_code)]

mod program;

fn main() -> std::process::ExitCode {
    program::main()
}
