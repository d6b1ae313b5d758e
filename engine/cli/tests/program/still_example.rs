//! The example program of still scenes draws the same as the command line.

use std::process::Command;

use streamsplat::formats;
use streamsplat::still::{Still, Values};

#[path = "../../../examples/still.rs"]
#[expect(dead_code, reason = "its main reads the command line")]
mod example;

#[test]
fn a_program_of_a_few_lines_draws_what_the_command_line_draws() {
    let scratch = tempfile::tempdir().expect("a temporary folder");
    let place = |i: u16, k: u16| f32::from(i * (7 + 4 * k) % 31) / 31.0;
    let count = 200;
    let values = Values {
        mean: (0..count).map(|i| [0, 1, 2].map(|k| 2.0 * place(i, k) - 1.0)).collect(),
        scale: (0..count).map(|i| [0, 1, 2].map(|k| 0.02 + 0.1 * place(i, k + 3))).collect(),
        opacity: (0..count).map(|i| place(i, 6)).collect(),
        rgb: (0..count).map(|i| [0, 1, 2].map(|k| place(i, k + 7))).collect(),
        ..Values::default()
    };
    let path = |name: &str| scratch.path().join(name).to_str().expect("text").to_owned();
    let file = path("garden.ply");
    std::fs::write(&file, formats::ply::write(&Still::of_values(values).expect("a scene")).bytes).expect("writable");
    let command = ["render", &file, "--size", "640x360", "--out", &path("expected.png"), "--quiet"];
    let program = Command::new(env!("CARGO_BIN_EXE_streamsplat")).args(command).status();
    assert!(program.expect("the program starts").success());
    example::draw(&file, &path("found.png")).expect("an image");
    let read = |name: &str| std::fs::read(path(name)).expect(name);
    assert!(read("found.png") == read("expected.png") && read("found.png").len() > 1000);
    let error = example::draw(&path("none.ply"), &path("none.png")).expect_err("no file").to_string();
    assert!(error.contains("none.ply"), "{error}");
}

#[test]
fn the_example_is_the_first_page_of_the_module() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("a workspace");
    let [page, example] = ["engine/src/still/mod.rs", "engine/examples/still.rs"]
        .map(|file| std::fs::read_to_string(root.join(file)).expect(file));
    let block = page.split("```no_run\n").nth(1).and_then(|rest| rest.split("```").next()).expect("a block");
    let lines: Vec<&str> = block.lines().filter_map(|line| line.strip_prefix("//! ")).collect();
    let drawn =
        lines.iter().filter(|line| line.contains("scene") || line.contains("camera") || line.contains("options"));
    for line in drawn.filter(|line| !line.contains("Still::open") && !line.starts_with("use")) {
        assert!(example.contains(line.trim()), "expected {line} in the example");
    }
    assert!(lines.iter().filter(|line| line.starts_with("let") || line.starts_with("output")).count() <= 8);
}
