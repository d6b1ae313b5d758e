//! The example program of the README writes the same results as the command line. It changes the working folder, so it
//! is alone in its process.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

#[path = "../../examples/run.rs"]
mod example;

/// Returns the files in a folder except its records, which contain times.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).expect("a folder").flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if entry.path().is_dir() {
            let below = files(&entry.path()).into_iter().map(|(file, bytes)| (format!("{name}/{file}"), bytes));
            found.extend(below);
        } else if !["run.json", "report.md"].contains(&name.as_str()) {
            found.insert(name, std::fs::read(entry.path()).expect("readable"));
        }
    }
    found
}

#[test]
fn a_program_of_a_few_lines_writes_what_the_command_line_writes() {
    let scratch = tempfile::tempdir().expect("a temporary folder");
    std::fs::copy(streamsplat_fixtures::path("clips/moving.y4m"), scratch.path().join("clip.y4m")).expect("a clip");
    std::env::set_current_dir(&scratch).expect("a working folder");
    let program = Command::new(env!("CARGO_BIN_EXE_streamsplat")).args(["run", "clip.y4m", "--quiet"]).status();
    assert!(program.expect("the program starts").success());
    example::main().expect("a run");
    let (expected, found) = (files(Path::new("clip-scene")), files(Path::new("out")));
    assert!(expected.len() > 24, "{} files", expected.len());
    assert!(expected == found, "expected {:?}, found {:?}", expected.keys(), found.keys());
}

#[test]
fn the_example_is_the_readmes() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("a workspace");
    let [readme, example] =
        ["README.md", "engine/examples/run.rs"].map(|file| std::fs::read_to_string(root.join(file)).expect(file));
    assert!(example.lines().count() <= 15, "{example}");
    let block = readme.split("```rust\n").nth(1).and_then(|rest| rest.split("```").next()).expect("a block of Rust");
    let line = block.lines().find(|line| line.contains("Run::new")).expect("the run");
    assert!(example.contains(line.trim()), "expected {line} in the example");
}
