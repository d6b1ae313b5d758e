//! Tables for the terminal, and the record in Markdown.

use std::fmt::Write;

use super::{Results, VariantResult};

/// The columns of [`line()`].
pub(super) const HEAD: &str =
    "clip                      reuse  gap   ms/key ms/frame   cost  vs off     all     key  middle    gain";

/// The network's parts whose tokens are counted.
const PARTS: [&str; 4] = ["encoder", "upsampler", "decoder", "heads"];

fn or_none(x: Option<f64>) -> String {
    x.map_or_else(|| "-".to_owned(), |x| format!("{x:.2}"))
}

/// Work of a stage or of a part, done and in all.
fn work(row: &VariantResult, name: &str) -> Option<[u64; 2]> {
    row.work.iter().find(|(stage, ..)| stage == name).map(|(_, done, avoided)| [*done, done + avoided])
}

/// The share of a part's work that some rows did; `None` where nothing could have been left out.
fn share(rows: &[&VariantResult], name: &str) -> Option<f64> {
    let counts: Option<Vec<[u64; 2]>> = rows.iter().map(|row| work(row, name)).collect();
    let [done, all] = counts?.iter().fold([0; 2], |sum, w| [sum[0] + w[0], sum[1] + w[1]]);
    (all > 0).then(|| done as f64 / all as f64)
}

/// A row's measurements, in the order of both tables.
fn figures(row: &VariantResult) -> [String; 8] {
    [
        format!("{:.1}", 1e3 * row.key_frame.seconds()),
        format!("{:.1}", 1e3 * row.frame.seconds()),
        format!("{:.3}", row.cost),
        or_none(row.psnr_vs_off),
        format!("{:.2}", row.psnr),
        format!("{:.2}", row.psnr_key),
        or_none(row.psnr_middle),
        format!("{:.3}", row.gain),
    ]
}

/// One row for the terminal.
pub(super) fn line(row: &VariantResult) -> String {
    let mut text = format!("{:<24} {:>6} {:>4}", row.clip, row.reuse, row.gap);
    for (figure, width) in figures(row).iter().zip([8, 8, 6, 7, 7, 7, 7, 7]) {
        let _ = write!(text, " {figure:>width$}");
    }
    text.push('\n');
    let parts = PARTS.iter().filter_map(|part| Some((part, share(&[row], &format!("{part}.tokens"))?)));
    let parts: Vec<String> = parts.map(|(part, share)| format!("{part} {share:.2}")).collect();
    if !parts.is_empty() {
        let _ = writeln!(text, "{:<24} tokens computed: {}", "", parts.join("  "));
    }
    text
}

/// Rows of one kind of camera, reuse and gap, in the order they came.
fn groups(rows: &[VariantResult]) -> Vec<Vec<&VariantResult>> {
    let mut groups: Vec<Vec<&VariantResult>> = Vec::new();
    let key = |row: &VariantResult| (row.still, row.reuse.clone(), row.gap.clone());
    for row in rows {
        match groups.iter_mut().find(|group| key(group[0]) == key(row)) {
            Some(group) => group.push(row),
            None => groups.push(vec![row]),
        }
    }
    groups.sort_by_key(|group| group[0].still.map(|still| !still));
    groups
}

fn camera(still: Option<bool>) -> &'static str {
    match still {
        Some(true) => "still",
        Some(false) => "moves",
        None => "",
    }
}

/// The record.
pub(super) fn markdown(results: &Results) -> String {
    let about = &results.about;
    let mut text = format!(
        "# Leaving out work\n\n`{}` on {}, {}.\n{}\n\n\
        Milliseconds are of the processor, over all threads. `cost`: time of the key frames relative to the same without reuse, the first, \
        which is computed in full, included. PSNR is against the true frames at 256×256, over all input frames; `gain` is that above the PSNR \
        without reuse at the same gap; `vs off` compares the images with those without reuse. At 24 frames per second two \
        cores have 83.3 ms per input frame.\n\n\
        ## Summary\n\nMeans over the clips; in brackets the most costly clip, and the one that loses most.\n\n\
        | camera | clips | reuse | gap | ms per key frame | ms per input frame | cost | PSNR, dB | gain, dB |\n\
        |---|---:|---|---|---:|---:|---:|---:|---:|\n",
        about.command, about.cpu, about.isa, about.note
    );
    let groups = groups(&results.rows);
    for group in &groups {
        let count = group.len() as f64;
        let mean = |of: &dyn Fn(&VariantResult) -> f64| group.iter().map(|row| of(row)).sum::<f64>() / count;
        let most = group.iter().map(|row| row.cost).fold(f64::NEG_INFINITY, f64::max);
        let least = group.iter().map(|row| row.gain).fold(f64::INFINITY, f64::min);
        let first = group[0];
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {:.0} | {:.1} | {:.3} ({most:.3}) | {:.2} | {:.3} ({least:.3}) |",
            camera(first.still),
            group.len(),
            first.reuse,
            first.gap,
            1e3 * mean(&|row| row.key_frame.seconds()),
            1e3 * mean(&|row| row.frame.seconds()),
            mean(&|row| row.cost),
            mean(&|row| row.psnr),
            mean(&|row| row.gain),
        );
    }
    text += "\n## Work that is left out\n\nShare of the work that was done, over the clips: key frames through the network, and tokens through the \
        blocks of its parts.\n\n\
        | camera | reuse | gap | key frames per input frame | frames encoded | pairs decoded | encoder | upsampler | decoder | heads |\n\
        |---|---|---|---:|---:|---:|---:|---:|---:|---:|\n";
    for group in &groups {
        let shown = |name: &str| or_none(share(group, name));
        let keys = group.iter().map(|row| row.keys).sum::<usize>() as f64;
        let frames = group.iter().map(|row| row.frames).sum::<usize>() as f64;
        let parts = PARTS.map(|part| shown(&format!("{part}.tokens"))).join(" | ");
        let (first, encoded, decoded) = (group[0], shown("encoder"), shown("decoder"));
        let _ = writeln!(
            text,
            "| {} | {} | {} | {:.2} | {encoded} | {decoded} | {parts} |",
            camera(first.still),
            first.reuse,
            first.gap,
            keys / frames
        );
    }
    text += "\n## Clips\n\n\
        | clip | camera | frames | key frames | reuse | gap | ms per key frame | ms per input frame | cost | vs off, dB | PSNR, dB | key frames | between | gain |\n\
        |---|---|---:|---:|---|---|---:|---:|---:|---:|---:|---:|---:|---:|\n";
    for row in &results.rows {
        let (camera, figures) = (camera(row.still), figures(row).join(" | "));
        let _ = writeln!(
            text,
            "| {} | {camera} | {} | {} | {} | {} | {figures} |",
            row.clip, row.frames, row.keys, row.reuse, row.gap
        );
    }
    text
}
