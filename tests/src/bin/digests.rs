//! Prints one digest per computed item: `digests [--levels A,B] [--threads 1,2,3,8] [--check FILE] [NAME…]`.
//!
//! Every item is computed on every level and with every number of threads; all digests must agree. Levels are those of
//! this machine, or those named; a named level that the machine lacks is an error. `--check FILE` compares with lines
//! printed earlier, for example on another machine. A NAME selects the items whose name contains it. The exit status is
//! 1 where anything differs.

use std::process::ExitCode;

use streamsplat_kernels::Level;
use streamsplat_tests::digest::things;

struct Options {
    levels: Vec<Level>,
    threads: Vec<usize>,
    check: Option<String>,
    names: Vec<String>,
}

fn options() -> Result<Options, String> {
    let mut options = Options { levels: Level::available(), threads: vec![1, 2, 3, 8], check: None, names: Vec::new() };
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or_else(|| format!("{argument} needs a value"));
        match argument.as_str() {
            "--levels" => {
                let named = value()?;
                options.levels =
                    named.split(',').map(Level::named).collect::<Result<_, _>>().map_err(|e| e.to_string())?;
            }
            "--threads" => {
                let counts = value()?;
                options.threads =
                    counts.split(',').map(str::parse).collect::<Result<_, _>>().map_err(|e| format!("{e}"))?;
            }
            "--check" => {
                let path = value()?;
                options.check = Some(std::fs::read_to_string(&path).map_err(|e| format!("{path}: {e}"))?);
            }
            option if option.starts_with('-') => return Err(format!("unknown option {option:?}")),
            name => options.names.push(name.to_owned()),
        }
    }
    Ok(options)
}

fn main() -> ExitCode {
    let options = match options() {
        Ok(options) => options,
        Err(message) => {
            eprintln!("digests: {message}");
            return ExitCode::from(2);
        }
    };
    eprintln!("digests: levels {:?}, threads {:?}", options.levels, options.threads);
    let (mut passed, mut failed) = (0, 0);
    for thing in things() {
        if !options.names.is_empty() && !options.names.iter().any(|n| thing.name.contains(n.as_str())) {
            continue;
        }
        let mut digest = String::new();
        let mut differs = false;
        for level in &options.levels {
            for threads in &options.threads {
                let found = thing.digest(*level, *threads);
                if digest.is_empty() {
                    digest = found;
                } else if found != digest {
                    eprintln!("{}: {level} with {threads} threads gives {found}, expected {digest}", thing.name);
                    differs = true;
                }
            }
        }
        let line = format!("{digest}  {}", thing.name);
        if options.check.as_ref().is_some_and(|lines| !lines.lines().any(|l| l == line)) {
            eprintln!("{}: found {digest}, which is not what the file says", thing.name);
            differs = true;
        }
        println!("{line}");
        if differs { failed += 1 } else { passed += 1 }
    }
    eprintln!("{passed} passed, {failed} failed");
    if failed == 0 && passed > 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
