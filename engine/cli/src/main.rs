//! The `streamsplat` program.

fn main() -> std::process::ExitCode {
    streamsplat_cli::main()
}
