//! The table of a page.

use anyhow::{Context, Result};
use streamsplat_bench::table::{Column, Table};

use super::{Configuration, Reason, Record};

/// Markers before and after the table.
const BEGIN: &str = "<!-- streamsplat bench tradeoff CLIPS writes from here -->";
const END: &str = "<!-- to here -->";

/// Steps and qualities, in Markdown.
pub(super) fn table(record: &Record) -> String {
    let Record { clips, threads, cpu, isa, baselines, note, .. } = record;
    let note = if note.is_empty() { String::new() } else { format!(" {note}") };
    let against = record.against_the_dial();
    let dial = if against.is_empty() {
        format!("On each of the {clips} clips a higher quality is closer to the frames.")
    } else {
        format!("A higher quality is closer to the frames but for {}.", against.join(", "))
    };
    let mut text = format!(
        "{clips} clips, gap 5 except for the qualities, {threads} threads of {cpu} ({isa}).{note} Others, between key frames: cross-fade \
         {:.2} dB, flow's blend {:.2} dB. {dial}\n\n",
        baselines.crossfade, baselines.flow
    );
    let columns = [
        Column::Text("", 0),
        Column::Number("key frames, dB", 0),
        Column::Number("between, dB", 0),
        Column::Number("all, dB", 0),
        Column::Number("moving clips over the cross-fade", 0),
        Column::Number("still ones (cross-fade of 26 dB or more)", 0),
        Column::Number("ms per input frame", 0),
    ];
    let shown = |row: &&Configuration| {
        matches!(row.kind, Reason::Step | Reason::Part) || row.kind == Reason::Quality && row.seen
    };
    text += &Table(&columns).markdown(record.rows.iter().filter(shown).map(cells));
    text
}

fn cells(row: &Configuration) -> [String; 7] {
    let signed = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |value| format!("{value:+.2}"));
    let Configuration { row: name, key, between, all, moving, still, seconds_per_frame, .. } = row;
    let [key, between, all] = [key, between, all].map(|decibels| format!("{decibels:.2}"));
    [name.clone(), key, between, all, signed(*moving), signed(*still), format!("{:.0}", 1e3 * seconds_per_frame)]
}

/// The page with the table in its place.
pub(super) fn with_table(page: &str, table: &str) -> Result<String> {
    let (before, rest) = page.split_once(BEGIN).with_context(|| format!("the page: expected {BEGIN}"))?;
    let (_, after) = rest.split_once(END).with_context(|| format!("the page: expected {END}"))?;
    Ok(format!("{before}{BEGIN}\n{table}{END}{after}"))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn the_page_on_choosing_shows_the_newest_record() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("a workspace");
        let page = std::fs::read_to_string(root.join("docs/choosing.md")).expect("a page");
        let records = std::fs::read_dir(root.join("bench/record")).expect("a folder");
        let records = records.map(|entry| entry.expect("an entry").path()).filter(|path| {
            let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
            name.starts_with("tradeoff-clips-") && name.ends_with(".json")
        });
        let newest = std::fs::read_to_string(records.max().expect("a record")).expect("readable");
        let record: Record = serde_json::from_str(&newest).expect("a record");
        assert!(record.rows.len() > 20);
        assert_eq!(with_table(&page, &table(&record)).expect("a place for the table"), page);
        let plot = std::fs::read_to_string(root.join("docs/tradeoff.svg")).expect("a plot");
        assert_eq!(super::super::plot::svg(&record).expect("a plot"), plot);
        // Another figure changes the page.
        let other = table(&record).replacen("2", "3", 1);
        assert_ne!(with_table(&page, &other).expect("a place for the table"), page);
    }
}
