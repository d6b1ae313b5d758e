//! `seeds FOLDER`: writes the seeds and regressions of every fuzz target into `FOLDER/NAME/`, as a start for libFuzzer.
//! Prints the targets' names with the longest useful input.

use std::path::Path;
use std::process::ExitCode;

use streamsplat_tests::fuzz::TARGETS;

fn main() -> ExitCode {
    let Some(folder) = std::env::args_os().nth(1) else {
        eprintln!("expected a folder");
        return ExitCode::from(2);
    };
    for target in &TARGETS {
        let folder = Path::new(&folder).join(target.name);
        let seeds = (target.seeds)().into_iter().enumerate().map(|(i, bytes)| (format!("seed-{i}"), bytes));
        for (name, bytes) in seeds.chain(target.regressions()) {
            let written = std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(folder.join(&name), bytes));
            if let Err(error) = written {
                eprintln!("{}: {error}", folder.join(name).display());
                return ExitCode::FAILURE;
            }
        }
        println!("{} {}", target.name, target.longest);
    }
    ExitCode::SUCCESS
}
