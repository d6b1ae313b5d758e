//! Tables for the terminal, and the record in Markdown.

use std::fmt::Write;

use streamsplat_bench::table::{Column, Table};

use super::{Results, VariantResult};

/// The columns of [`line()`].
pub(super) const TABLE: Table<'_> = Table(&[
    Column::Text("clip", 24),
    Column::Number("reuse", 6),
    Column::Number("gap", 4),
    Column::Number("ms/key", 7),
    Column::Number("ms/frame", 8),
    Column::Number("cost", 6),
    Column::Number("vs off", 6),
    Column::Number("all", 6),
    Column::Number("key", 6),
    Column::Number("middle", 6),
    Column::Number("gain", 6),
]);
const SUMMARY: Table<'_> = Table(&[
    Column::Text("camera", 0),
    Column::Number("clips", 0),
    Column::Text("reuse", 0),
    Column::Text("gap", 0),
    Column::Number("ms per key frame", 0),
    Column::Number("ms per input frame", 0),
    Column::Number("cost", 0),
    Column::Number("PSNR, dB", 0),
    Column::Number("gain, dB", 0),
]);
const LEFT_OUT: Table<'_> = Table(&[
    Column::Text("camera", 0),
    Column::Text("reuse", 0),
    Column::Text("gap", 0),
    Column::Number("key frames per input frame", 0),
    Column::Number("frames encoded", 0),
    Column::Number("pairs decoded", 0),
    Column::Number("encoder", 0),
    Column::Number("upsampler", 0),
    Column::Number("decoder", 0),
    Column::Number("heads", 0),
]);
const CLIPS: Table<'_> = Table(&[
    Column::Text("clip", 0),
    Column::Text("camera", 0),
    Column::Number("frames", 0),
    Column::Number("key frames", 0),
    Column::Text("reuse", 0),
    Column::Text("gap", 0),
    Column::Number("ms per key frame", 0),
    Column::Number("ms per input frame", 0),
    Column::Number("cost", 0),
    Column::Number("vs off, dB", 0),
    Column::Number("PSNR, dB", 0),
    Column::Number("key frames", 0),
    Column::Number("between", 0),
    Column::Number("gain", 0),
]);

/// The network's parts whose tokens are counted.
const PARTS: [&str; 4] = ["encoder", "upsampler", "decoder", "heads"];

fn or_none(x: Option<f64>) -> String {
    x.map_or_else(|| "-".to_owned(), |x| format!("{x:.2}"))
}

/// Work of a stage or of a part: done, and total.
fn work(row: &VariantResult, name: &str) -> Option<[u64; 2]> {
    row.work.iter().find(|(stage, ..)| stage == name).map(|(_, done, avoided)| [*done, done + avoided])
}

/// The share of a part's work that some rows did; `None` where no work could be skipped.
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
    let names = [&row.clip, &row.reuse, &row.gap].map(String::clone);
    let mut text = TABLE.line(&[&names[..], &figures(row)].concat()) + "\n";
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
        ## Summary\n\nMeans over the clips; in brackets the most costly clip, and the one that loses most.\n\n",
        about.command, about.cpu, about.isa, about.note
    );
    let groups = groups(&results.rows);
    text += &SUMMARY.markdown(groups.iter().map(|group| {
        let count = group.len() as f64;
        let mean = |of: &dyn Fn(&VariantResult) -> f64| group.iter().map(|row| of(row)).sum::<f64>() / count;
        let most = group.iter().map(|row| row.cost).fold(f64::NEG_INFINITY, f64::max);
        let least = group.iter().map(|row| row.gain).fold(f64::INFINITY, f64::min);
        let first = group[0];
        [
            camera(first.still).to_owned(),
            group.len().to_string(),
            first.reuse.clone(),
            first.gap.clone(),
            format!("{:.0}", 1e3 * mean(&|row| row.key_frame.seconds())),
            format!("{:.1}", 1e3 * mean(&|row| row.frame.seconds())),
            format!("{:.3} ({most:.3})", mean(&|row| row.cost)),
            format!("{:.2}", mean(&|row| row.psnr)),
            format!("{:.3} ({least:.3})", mean(&|row| row.gain)),
        ]
    }));
    text += "\n## Work that is left out\n\nShare of the work that was done, over the clips: key frames through the network, and tokens through the \
        blocks of its parts.\n\n";
    text += &LEFT_OUT.markdown(groups.iter().map(|group| {
        let shown = |name: &str| or_none(share(group, name));
        let keys = group.iter().map(|row| row.keys).sum::<usize>() as f64;
        let frames = group.iter().map(|row| row.frames).sum::<usize>() as f64;
        let first = group[0];
        let kind = [camera(first.still).to_owned(), first.reuse.clone(), first.gap.clone()];
        let shares = [format!("{:.2}", keys / frames), shown("encoder"), shown("decoder")];
        [&kind[..], &shares, &PARTS.map(|part| shown(&format!("{part}.tokens")))].concat()
    }));
    text += "\n## Clips\n\n";
    text += &CLIPS.markdown(results.rows.iter().map(|row| {
        let kind = [row.clip.clone(), camera(row.still).to_owned(), row.frames.to_string(), row.keys.to_string()];
        [&kind[..], &[row.reuse.clone(), row.gap.clone()], &figures(row)].concat()
    }));
    text
}
