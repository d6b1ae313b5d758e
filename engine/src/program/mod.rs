//! The `streamsplat` program: commands, exit codes, messages.
//!
//! Exit codes: 0 done, 1 the work failed, 2 wrong use, 130 stopped by the user. An error is one line on standard error that names the file, the tensor
//! or the option, what was expected and what was found.

mod ahead;
mod bench;
mod cli;
mod closeness;
mod compare;
mod destination;
mod digest;
mod drawing;
mod earlier;
mod eval;
mod export;
mod failure;
mod forward;
mod golden;
mod inspect;
mod keydepth;
mod keyframes;
mod machine;
mod manual;
mod outputs;
mod place;
#[cfg(test)]
mod power;
mod progress;
mod record;
mod render;
mod report;
mod resume;
mod run;
mod serving;
mod settings;
mod splat;
mod still;
mod stop;
mod times;
mod trace;
mod track;
mod verify;
mod version;
mod view;

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use clap::error::ErrorKind;

use cli::{Cli, Command};
use failure::Failure;

/// Runs the program with the process's arguments.
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
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
        Command::Run(args) => run::command(args, &cli.console),
        Command::Render(args) => render::command(args, &cli.console),
        Command::Eval(args) => eval::command(args, &cli.console),
        Command::Forward(args) => forward::command(args),
        Command::Splat(args) => splat::command(args),
        Command::Inspect(args) => inspect::command(args),
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

fn finish(result: Result<(), Failure>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            let _ = writeln!(std::io::stderr(), "streamsplat: {}", failure.message());
            failure.code()
        }
    }
}

/// What clap says, without usage and hints, in one line.
fn one_line(error: &clap::Error) -> String {
    let text = error.to_string();
    let said = text.split("\n\n").next().unwrap_or(&text);
    let mut words: Vec<&str> = said.split_whitespace().collect();
    if words.first() == Some(&"error:") {
        words.remove(0);
    }
    if error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        let commands = "run, render, eval, forward, splat, inspect, export, track, view, bench, verify, compare, golden, completions, man";
        return format!("expected a command ({commands}); see streamsplat --help");
    }
    let tip = text.lines().find_map(|line| line.trim().strip_prefix("tip: "));
    words.extend(tip.filter(|tip| tip.contains("similar")).map(|_| ";"));
    let said = words.join(" ").replace(" ;", ";");
    match tip.filter(|tip| tip.contains("similar")) {
        Some(tip) => format!("{said} {}", tip.trim()),
        None => said,
    }
}

/// Prints a line on standard output.
fn say(line: impl std::fmt::Display) -> Result<(), Failure> {
    print(format!("{line}\n").as_bytes())
}

/// Writes to standard output; a reader that has gone away is no failure of the work.
fn print(text: &[u8]) -> Result<(), Failure> {
    let mut out = std::io::stdout();
    match out.write_all(text).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Failure::work(format!("standard output: cannot write: {e}")))
        }
        _ => Ok(()),
    }
}
