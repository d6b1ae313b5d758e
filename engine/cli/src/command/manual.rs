//! `completions` and `man`: shell completions and manual pages.

use std::path::Path;

use clap_complete::Shell;
use streamsplat::output::{prepare_folder, write_file};

use crate::console::failure::Failure;
use crate::console::print;
use crate::options::args::Cli;

/// Prints the completions of a shell.
pub fn completions(shell: Shell) -> Result<(), Failure> {
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut Cli::with_defaults(), "streamsplat", &mut text);
    print(&text)
}

/// Prints the program's manual page, or writes one page per command into a folder.
pub fn man(out: Option<&Path>) -> Result<(), Failure> {
    let mut command = Cli::with_defaults();
    command.build();
    let Some(folder) = out else { return print(&page(&command)?) };
    prepare_folder(folder)?;
    write_file(&folder.join("streamsplat.1"), &page(&command)?)?;
    for part in command.get_subcommands().filter(|part| part.get_name() != "help") {
        let name = format!("streamsplat-{}", part.get_name());
        write_file(&folder.join(format!("{name}.1")), &page(part)?)?;
    }
    Ok(())
}

fn page(command: &clap::Command) -> Result<Vec<u8>, Failure> {
    let mut text = Vec::new();
    clap_mangen::Man::new(command.clone()).render(&mut text).map_err(Failure::work)?;
    Ok(text)
}
