//! `run`: video → scene, frames, report.

use std::path::Path;
use std::sync::PoisonError;

use streamsplat::run::{Destination, Record, Run, report};

use crate::console::failure::Failure;
use crate::console::screen::{Page, Screen};
use crate::console::{Console, say, stop, version};
use crate::options::args::RunArgs;

/// Runs, prints the summary, and keeps the page until Ctrl-C.
pub fn command(args: &RunArgs, console: &Console) -> Result<(), Failure> {
    console.listen();
    let page = Page::default();
    let (input, page_of_run, console_of_run) = (args.input.clone(), page.clone(), console.clone());
    let screen = Screen { input, serve: args.serve, console: console_of_run, page: page_of_run, progress: None };
    let run = Run::new(&args.input, args.options.clone()).machine(args.machine.clone()).json(args.json.clone());
    let run = run
        .resume(args.resume)
        .overwrite(args.overwrite)
        .stop(console.stop.clone())
        .observe(screen)
        .program(version::commit());
    let run = match &args.out {
        Some(out) => run.out(out),
        None => run.out_named_after_input()?,
    };
    let out = run.destination().map(Path::to_owned).unwrap_or_default();
    let running = run.start()?;
    let before = running.was_complete();
    let record = running.finish()?;
    if before {
        if !console.quiet {
            say(format!("{}: complete already, nothing to resume", out.display()))?;
        }
        return whole(&record);
    }
    let destination = Destination::of(&out);
    if !console.quiet && out != Path::new("-") {
        say(report::summary(&record, &out))?;
        // The scene next to the video, or in the folder.
        let scene = destination.container().unwrap_or_else(|| out.join("scene"));
        let name = scene.file_name().unwrap_or_default().to_string_lossy();
        let written = |file: &String| file.starts_with("scene/") || **file == *name;
        if record.complete && record.outputs.keys().any(written) {
            let scene = destination.container().unwrap_or_else(|| out.clone());
            say(format!("Next: streamsplat view {}", scene.display()))?;
        }
    }
    if !record.complete {
        return Err(stop::stopped(destination.resume().is_some()));
    }
    whole(&record)?;
    let page = page.lock().unwrap_or_else(PoisonError::into_inner).take();
    page.into_iter().for_each(|page| page.linger(console));
    Ok(())
}

/// Returns an error if the input was damaged; all results from before the damage are written.
fn whole(record: &Record) -> Result<(), Failure> {
    record.input.damage.clone().map_or(Ok(()), |damage| Err(Failure::work(damage)))
}
