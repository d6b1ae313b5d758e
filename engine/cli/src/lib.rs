//! The `streamsplat` program: commands, exit codes, messages.
//!
//! Exit codes: 0 done, 1 the work failed, 2 wrong use, 130 stopped by the user. An error is one line on standard error
//! with the file, the tensor or the option, the expected value and the one found.
#![deny(unsafe_code)]

mod command;
mod console;
mod options;

use std::ffi::OsString;
use std::io::Write;
use std::process::ExitCode;

use clap::error::{ContextKind, ErrorKind};

use command::{bench, compare, eval, export, golden, inspect, manual, render, track, verify, view};
pub use console::failure::Failure;
pub use console::version::commit;
use console::{print, trace};
use options::args::{Cli, Command};

/// Runs the program with the process's arguments.
pub fn main() -> ExitCode {
    ExitCode::from(run(std::env::args_os()))
}

/// Runs the program with these arguments, the first of which is its name, and returns its exit code.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let cli = match Cli::read(arguments) {
        Ok(cli) => cli,
        Err(e) if matches!(e.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) => {
            return finish(print(e.to_string().as_bytes()));
        }
        Err(e) => return finish(Err(Failure::Usage(one_line(&e)))),
    };
    let _trace = match trace::start(&cli.console) {
        Ok(guard) => guard,
        Err(failure) => return finish(Err(failure)),
    };
    finish(match &cli.command {
        Command::Run(args) => command::run::command(args, &cli.console),
        Command::Render(args) => render::command(args, &cli.console),
        Command::Eval(args) => eval::command(args, &cli.console),
        Command::Inspect(args) => inspect::command(args, &cli.console),
        Command::Export(args) => export::command(args, &cli.console),
        Command::Track(args) => track::command(args, &cli.console),
        Command::View(args) => view::command(args, &cli.console),
        Command::Bench { arguments } => {
            return bench::command(arguments).unwrap_or_else(|failure| finish(Err(failure)));
        }
        Command::Verify(args) => verify::command(args, &cli.console),
        Command::Compare(args) => compare::command(args, &cli.console),
        Command::Golden(args) => golden::command(args, &cli.console),
        Command::Completions { shell } => manual::completions(*shell),
        Command::Man { out } => manual::man(out.as_deref()),
    })
}

fn finish(result: Result<(), Failure>) -> u8 {
    match result {
        Ok(()) => 0,
        Err(failure) => {
            let _ = writeln!(std::io::stderr(), "streamsplat: {}", failure.message());
            failure.code()
        }
    }
}

/// Returns a hint for a command or option that other programs have.
fn hint(error: &clap::Error) -> Option<String> {
    let word = |kind| error.get(kind).map(ToString::to_string);
    if error.kind() == ErrorKind::InvalidSubcommand {
        let found = word(ContextKind::InvalidSubcommand)?;
        if std::path::Path::new(&found).exists() {
            return Some(format!(
                "for a video or images: streamsplat run {found}; for splats or a scene: streamsplat view {found}"
            ));
        }
        return (found == "convert").then(|| "files are converted by streamsplat export IN --out OUT".to_owned());
    }
    if error.kind() != ErrorKind::UnknownArgument {
        return None;
    }
    let found = word(ContextKind::InvalidArg)?;
    let hint = match found.split('=').next()? {
        "--fov" => "an angle is fov_y_degrees in a --camera file (docs/cameras.md)",
        "--width" | "--height" | "--resolution" => "the size of images is --size WIDTHxHEIGHT",
        "--gpu" | "--cuda" | "--device" => "a graphics card is --renderer wgpu, in a build with that feature",
        _ => return None,
    };
    Some(hint.to_owned())
}

/// Returns clap's error message in one line, without usage and hints.
fn one_line(error: &clap::Error) -> String {
    let text = error.to_string();
    let said = text.split("\n\n").next().unwrap_or(&text);
    let mut words: Vec<&str> = said.split_whitespace().collect();
    if words.first() == Some(&"error:") {
        words.remove(0);
    }
    if error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        let commands =
            "run, render, eval, inspect, export, track, view, bench, verify, compare, golden, completions, man";
        return format!("expected a command ({commands}); see streamsplat --help");
    }
    if let (ErrorKind::ValueValidation, Some(option), Some(cause)) =
        (error.kind(), error.get(ContextKind::InvalidArg), std::error::Error::source(error))
    {
        let option = option.to_string();
        let option = option.split(' ').next().unwrap_or_default();
        let (cause, value) = (cause.to_string(), error.get(ContextKind::InvalidValue).map(ToString::to_string));
        let found = value.filter(|value| !cause.contains(value.as_str()));
        return format!("{option}: {cause}{}", found.map(|value| format!(", found {value:?}")).unwrap_or_default());
    }
    if let Some(hint) = hint(error) {
        return format!("{}; {hint}", words.join(" "));
    }
    let tip = text.lines().find_map(|line| line.trim().strip_prefix("tip: "));
    words.extend(tip.filter(|tip| tip.contains("similar")).map(|_| ";"));
    let said = words.join(" ").replace(" ;", ";");
    match tip.filter(|tip| tip.contains("similar")) {
        Some(tip) => format!("{said} {}", tip.trim()),
        None => said,
    }
}
