//! Reports of a run: `run.json`, `report.md` and a summary line.

use std::fmt::Write;
use std::path::Path;

use crate::output::write_file;

use crate::run::Error;
use crate::run::destination::Destination;
use crate::run::record::{Invocation, Record};

/// Writes the record (and, in a folder, the report). The record comes last: if it exists, all files do.
pub fn finish(record: &Record, destination: Option<&Destination>, json: Option<&Path>) -> Result<(), Error> {
    let text = record.to_json()?;
    if let Some(path) = json {
        write_file(path, text.as_bytes())?;
    }
    if let Some(Destination::Folder(folder)) = destination {
        write_file(&folder.join("report.md"), markdown(record).as_bytes())?;
    }
    if let Some(path) = destination.and_then(Destination::record) {
        write_file(&path, text.as_bytes())?;
    }
    Ok(())
}

fn images(record: &Record) -> u64 {
    record.work.get("render").map_or(0, |work| work.done)
}

/// One line for the terminal.
pub fn summary(record: &Record, out: &Path) -> String {
    let stopped = if record.complete { "" } else { ", stopped by the user" };
    let peak = record.timing.peak_resident_bytes.map(|b| format!(", {} MiB at most", b >> 20)).unwrap_or_default();
    let count = |n: u64, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
    let files = count(record.outputs.len() as u64, "file");
    let (images, total) = (images(record), record.timing.total);
    let bytes = record.outputs.values().map(|output| output.bytes).sum::<u64>() as f64 / 1e6;
    let size = record.image_size.map(|[width, height]| format!(" of {width}×{height}")).unwrap_or_default();
    let rate = match record.task {
        Invocation::Run(_) if images > 0 => format!(", {} a second", (record.input.fps * 1000.0).round() / 1000.0),
        _ => String::new(),
    };
    let keys = record.key_frames.map(|keys| format!(", {}", count(keys, "key frame"))).unwrap_or_default();
    // The worst frame is that of the first size.
    let mut least = record.psnr_least.map(|least| format!(" (worst frame {least:.1} dB)"));
    let sizes = closeness(record)
        .map(|(psnr, [width, height])| format!("{psnr:.1} dB{} at {width}×{height}", least.take().unwrap_or_default()));
    let sizes = sizes.collect::<Vec<_>>().join(" and ");
    let psnr = if sizes.is_empty() { sizes } else { format!(", {sizes} over all frames") };
    // A rendering's input is counted in intervals.
    let (each, what) = match record.task {
        Invocation::Run(_) => (total / record.input.count.max(1) as f64, "frame"),
        Invocation::Render(_) => (total / images.max(1) as f64, "image"),
    };
    let (each, images) = (1000.0 * each, count(images, "image"));
    format!(
        "{}: {images}{size}{rate}{keys}{psnr}, {files}, {bytes:.1} MB, {total:.2} s, {each:.0} ms per {what}{peak}{stopped}",
        out.display()
    )
}

/// Mean PSNR of all frames, in dB, and the width and height of the images: first at the source's own size.
fn closeness(record: &Record) -> impl Iterator<Item = (f64, [usize; 2])> {
    let whole = record.psnr_source_size.map(|psnr| (psnr, record.input.size));
    let seen = record.psnr.zip(record.psnr_size).filter(|(_, size)| whole.is_none_or(|(_, whole)| whole != *size));
    whole.into_iter().chain(seen)
}

/// Text of a folder's `report.md`, a function of its record.
pub fn markdown(record: &Record) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write_markdown(record, &mut text);
    text
}

fn write_markdown(record: &Record, out: &mut String) -> std::fmt::Result {
    let command = match &record.task {
        Invocation::Run(_) => "run",
        Invocation::Render(_) => "render",
    };
    let input = &record.input;
    writeln!(out, "# streamsplat {command}\n")?;
    if !record.complete {
        writeln!(out, "Stopped by the user; what was written is valid.\n")?;
    }
    writeln!(out, "| | |\n|---|---|")?;
    writeln!(out, "| program | {} {} |", record.program, record.version)?;
    if let Some(model) = &record.model {
        writeln!(out, "| model | {}, BLAKE3 `{}` |", model.path, model.blake3)?;
    }
    if let Some(depth) = &record.depth {
        writeln!(out, "| depth | {}, BLAKE3 `{}`, {} |", depth.path, depth.blake3, depth.runtime)?;
    }
    writeln!(out, "| input | {}, BLAKE3 `{}` |", input.path.display(), input.blake3)?;
    writeln!(
        out,
        "| | {} read, {}×{}, {:.3} frames per second |",
        input.count, input.size[0], input.size[1], input.fps
    )?;
    if let Some(damage) = &input.damage {
        writeln!(out, "| damage | {damage} |")?;
    }
    if record.renderer.bit_contract {
        writeln!(out, "| renderer | {} |", record.renderer)?;
    } else {
        writeln!(out, "| renderer | {}: its images are outside of the bit contract |", record.renderer)?;
    }
    writeln!(out, "| output | {} images, {} files |", images(record), record.outputs.len())?;
    let mut least = record.psnr_least.map(|least| format!(", {least:.2} dB in the worst frame"));
    for (psnr, [width, height]) in closeness(record) {
        // The worst frame is that of the first size.
        let least = least.take().unwrap_or_default();
        writeln!(out, "| closeness | {psnr:.2} dB, mean PSNR of all frames at {width}×{height}{least} |")?;
    }
    if record.dropped > 0 {
        writeln!(out, "| left out | {} Gaussians with numbers that are not finite |", record.dropped)?;
    }
    let timing = &record.timing;
    writeln!(out, "| machine | {} threads, {} |", timing.threads, timing.isa)?;
    if let Some(peak) = timing.peak_resident_bytes {
        writeln!(out, "| memory | {:.0} MiB at most |", peak as f64 / f64::from(1 << 20))?;
    }
    writeln!(out, "| time | {:.2} s |\n", timing.total)?;

    writeln!(out, "## Work\n\n| stage | done | avoided | unit | seconds | per unit |\n|---|---:|---:|---|---:|---:|")?;
    for (stage, work) in &record.work {
        let seconds = timing.seconds.get(stage);
        let shown = seconds.map(|s| format!("{s:.3}")).unwrap_or_default();
        let each =
            seconds.filter(|_| work.done > 0).map(|s| format!("{:.4}", s / work.done as f64)).unwrap_or_default();
        writeln!(out, "| {stage} | {} | {} | {} | {shown} | {each} |", work.done, work.avoided, work.unit)?;
    }
    for (stage, seconds) in timing.seconds.iter().filter(|(stage, _)| !record.work.contains_key(*stage)) {
        writeln!(out, "| {stage} | | | | {seconds:.3} | |")?;
    }
    writeln!(out, "\nThe digests of all files are in `run.json`; `streamsplat verify` repeats this and compares.")
}
