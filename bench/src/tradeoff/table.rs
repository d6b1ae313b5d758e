//! CSV and Markdown.

use std::fmt::Write;

use streamsplat_bench::table::{Column, Table};
use streamsplat_bench::timing::Seconds;

use super::{Results, Yardstick};

const HEAD: &str = "precision,reuse,gap,resolution,keys,seconds_per_frame,wall_min,wall_median,wall_max,processor_min,processor_median,\
processor_max,relative_l2,worst,psnr_vs_f32,psnr_vs_truth,pareto\n";

fn of(seconds: Option<Seconds>) -> String {
    seconds.map_or_else(|| ",,".to_owned(), |s| format!("{:.6},{:.6},{:.6}", s.min, s.median, s.max))
}

/// One line per configuration.
pub(super) fn csv(results: &Results) -> String {
    let mut text = HEAD.to_owned();
    for row in &results.rows {
        // Writing into a string does not fail.
        let _ = writeln!(
            text,
            "{},{},{},{},{},{:.6},{},{},{:.3e},{:.3e},{:.3},{:.4},{}",
            row.precision,
            row.reuse,
            row.gap,
            row.resolution,
            row.keys,
            row.seconds_per_frame,
            of(Some(row.wall)),
            of(row.processor),
            row.relative_l2,
            row.worst,
            row.psnr_vs_f32,
            row.psnr_vs_truth,
            row.pareto
        );
    }
    text
}

/// One line per stage and precision.
pub(super) fn stages_csv(results: &Results) -> String {
    let mut text =
        "precision,stage,against,relative_l2,worst,worst_ulp,wall_min,wall_median,wall_max,processor_min,processor_median,\
        processor_max\n"
            .to_owned();
    let against = name(results.about.against);
    for row in &results.stages {
        let (wall, processor) = (of(Some(row.wall)), of(row.processor));
        let ulp = row.worst_ulp.map_or_else(String::new, |ulp| format!("{ulp:.1}"));
        let _ = writeln!(
            text,
            "{},{},{against},{:.3e},{:.3e},{ulp},{wall},{processor}",
            row.precision, row.stage, row.relative_l2, row.worst
        );
    }
    text
}

pub(super) fn name(against: Yardstick) -> &'static str {
    match against {
        Yardstick::F64 => "f64",
        Yardstick::F32 => "f32",
    }
}

/// Milliseconds with their spread.
fn spread(seconds: Option<Seconds>) -> String {
    let show = |s: Seconds| format!("{:.1} ({:.1}–{:.1})", s.median * 1e3, s.min * 1e3, s.max * 1e3);
    seconds.map_or_else(|| "-".to_owned(), show)
}

/// The report.
pub(super) fn markdown(results: &Results) -> String {
    let about = &results.about;
    let mut text = format!(
        "# Error against run time\n\n{} at {}, {} ({} frames), {}, {}, threads: {}.\n",
        about.model, about.resolution, about.clip, about.frames, about.cpu, about.isa, about.threads
    );
    if !about.note.is_empty() {
        let _ = writeln!(text, "{}", about.note);
    }
    if !results.rows.is_empty() {
        configurations(results, &mut text);
    }
    stages(results, &mut text);
    if !results.standing.is_empty() {
        standing(results, &mut text);
    }
    text
}

fn configurations(results: &Results, text: &mut String) {
    let _ = write!(
        text,
        "\n## Configurations\n\nMilliseconds per input frame: median (least–most) of {} rounds. `L2` and `vs f32` compare all images with those of \
        f32 without reuse at the same gap (100 dB: equal), `vs truth` with the true frames at 256×256. ● is on the Pareto front of {} and `vs truth`.\n\n",
        results.about.rounds,
        results.about.clock.name()
    );
    let columns = [
        Column::Text("", 0),
        Column::Text("precision", 0),
        Column::Text("reuse", 0),
        Column::Text("gap", 0),
        Column::Number("key frames", 0),
        Column::Number("ms, processor", 0),
        Column::Number("ms, wall", 0),
        Column::Number("L2", 0),
        Column::Number("worst sample", 0),
        Column::Number("vs f32, dB", 0),
        Column::Number("vs truth, dB", 0),
    ];
    let rows = results.rows.iter().map(|row| {
        [
            if row.pareto { "●" } else { "" }.to_owned(),
            row.precision.to_owned(),
            row.reuse.clone(),
            row.gap.clone(),
            row.keys.to_string(),
            spread(row.processor),
            spread(Some(row.wall)),
            format!("{:.1e}", row.relative_l2),
            format!("{:.1e}", row.worst),
            format!("{:.1}", row.psnr_vs_f32),
            format!("{:.2}", row.psnr_vs_truth),
        ]
    });
    text.push_str(&Table(&columns).markdown(rows));
}

fn stages(results: &Results, text: &mut String) {
    let _ = write!(
        text,
        "\n## Stages\n\nOn two frames of the clip, each stage fed by those before it at its own precision, against {}. `worst`: largest difference over \
        largest value; `ulp`: largest difference in units in the last place of f32 at the value, over values of a hundredth of the largest \
        or more. Milliseconds of a call: median (least–most) of {}.\n\n",
        name(results.about.against),
        results.about.repeat
    );
    let columns = [
        Column::Text("precision", 0),
        Column::Text("stage", 0),
        Column::Number("L2", 0),
        Column::Number("worst", 0),
        Column::Number("ulp", 0),
        Column::Number("ms, processor", 0),
        Column::Number("ms, wall", 0),
    ];
    let rows = results.stages.iter().map(|row| {
        [
            row.precision.to_owned(),
            row.stage.to_owned(),
            format!("{:.1e}", row.relative_l2),
            format!("{:.1e}", row.worst),
            row.worst_ulp.map_or_else(|| "-".to_owned(), |ulp| format!("{ulp:.1}")),
            spread(row.processor),
            spread(Some(row.wall)),
        ]
    });
    text.push_str(&Table(&columns).markdown(rows));
}

fn standing(results: &Results, text: &mut String) {
    let _ = write!(
        text,
        "\n## Standing camera\n\nKey frames of which a part changed. `cost`: processor time relative to the full work, medians of {}; errors: relative L2 against {}, of \
        embedding, static tokens, deformation tokens, and positions with velocities. Milliseconds: median (least–most).\n\n",
        results.about.rounds,
        name(results.about.against)
    );
    let columns = [
        Column::Text("precision", 0),
        Column::Text("reuse", 0),
        Column::Number("changed", 0),
        Column::Number("ms, processor", 0),
        Column::Number("ms, wall", 0),
        Column::Number("cost", 0),
        Column::Number("h", 0),
        Column::Number("static", 0),
        Column::Number("d", 0),
        Column::Number("heads", 0),
    ];
    let rows = results.standing.iter().map(|row| {
        let error = |i: usize| row.errors.map_or_else(|| "-".to_owned(), |errors| format!("{:.1e}", errors[i]));
        [
            row.precision.to_owned(),
            row.reuse.clone(),
            format!("{:.1} %", 100.0 * row.changed),
            spread(row.processor),
            spread(Some(row.wall)),
            format!("{:.3}", row.cost),
            error(0),
            error(1),
            error(2),
            error(3),
        ]
    });
    text.push_str(&Table(&columns).markdown(rows));
}
