//! Pages that show records say what the records say.

use std::path::Path;

use serde_json::Value;

#[test]
fn the_page_on_choosing_shows_its_record() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("a workspace");
    let page = std::fs::read_to_string(root.join("docs/choosing.md")).expect("docs/choosing.md");
    let shown = page.split("<!-- bench/changes.py writes from here -->").nth(1);
    let shown = shown.and_then(|rest| rest.split("<!-- to here -->").next()).expect("the table's place");
    let records = std::fs::read_dir(root.join("bench/record")).expect("bench/record");
    let records = records.map(|entry| entry.expect("an entry").path()).filter(|path| {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        name.starts_with("changes-") && name.ends_with(".json")
    });
    let newest = records.max().expect("a record");
    let record: Value = serde_json::from_slice(&std::fs::read(newest).expect("the record")).expect("JSON");
    let rows = record["rows"].as_array().expect("rows");
    assert!(rows.len() > 8);
    for row in rows {
        let number = |key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key} of {row}"));
        let line = format!(
            "| {} | {:.2} | {:.2} | {:.2} | {:+.2} | {:+.2} | {:.0} |",
            row["row"].as_str().expect("a name"),
            number("key"),
            number("between"),
            number("all"),
            number("moving"),
            number("still"),
            1000.0 * number("seconds_per_frame"),
        );
        assert!(shown.lines().any(|found| found == line), "not on the page: {line}");
    }
    assert_eq!(shown.lines().filter(|line| line.starts_with("| ")).count(), rows.len() + 1, "rows of the page");
}
