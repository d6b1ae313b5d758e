//! Helpers that run the program, and small inputs for it.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use streamsplat_fixtures as fixtures;

/// A temporary folder that is removed after the test.
pub struct Scratch(tempfile::TempDir);

impl Scratch {
    pub fn new() -> Scratch {
        Scratch(tempfile::tempdir().expect("a temporary folder"))
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Creates a folder of `count` small PNG images with a moving object.
    pub fn clip(&self, name: &str, count: u32, width: u32, height: u32) -> PathBuf {
        let folder = self.path(name);
        std::fs::create_dir_all(&folder).expect("writable");
        for frame in 0..count {
            let image = image::RgbImage::from_fn(width, height, |x, y| {
                let inside = (x as i32 - 10 - 3 * frame as i32).abs() < 8 && (y as i32 - 16).abs() < 8;
                if inside {
                    image::Rgb([240, 80, 30])
                } else {
                    image::Rgb([(x * 3) as u8, (y * 5) as u8, (x ^ y) as u8])
                }
            });
            image.save(folder.join(format!("{frame}.png"))).expect("writable");
        }
        folder
    }
}

/// Returns a small checkpoint (48×80).
pub fn model() -> PathBuf {
    fixtures::path("parity/tiny-nodino.safetensors")
}

pub fn command() -> Command {
    Command::new(env!("CARGO_BIN_EXE_streamsplat"))
}

/// Runs the program.
pub fn run<I: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = I>) -> Output {
    command().args(arguments).stdin(Stdio::null()).output().expect("the program starts")
}

/// Runs `run INPUT --out OUT --model (the small one) MORE…`, which must succeed.
pub fn run_ok(input: &Path, out: &Path, more: &[&str]) {
    let output = command()
        .arg("run")
        .arg(input)
        .arg("--out")
        .arg(out)
        .arg("--model")
        .arg(model())
        .args(more)
        .output()
        .expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Returns the one line on standard error of a run that must fail with `code`, except lines of progress before it.
pub fn fails(output: &Output, code: i32) -> String {
    let text = String::from_utf8_lossy(&output.stderr);
    let progress = |line: &&str| line.starts_with(|c: char| c.is_ascii_digit()) && line.ends_with(" s each");
    let text: String = text.lines().skip_while(progress).map(|line| format!("{line}\n")).collect();
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert!(text.starts_with("streamsplat: ") && text.trim_end().lines().count() == 1, "{text}");
    assert!(!text.contains("panicked"), "{text}");
    text
}

/// Reads a JSON file.
pub fn json(path: &Path) -> serde_json::Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Reads a record without the fields that differ between runs.
pub fn record(path: &Path) -> serde_json::Value {
    let mut record = json(path);
    record.as_object_mut().expect("an object").remove("timing");
    record
}

/// Returns every file below a folder except the record and the report, by relative path, with its bytes.
pub fn files(folder: &Path) -> std::collections::BTreeMap<String, Vec<u8>> {
    let mut found = std::collections::BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(&next).expect("readable").flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).expect("below").to_string_lossy().into_owned();
                if !["run.json", "report.md"].contains(&name.as_str()) {
                    found.insert(name, std::fs::read(&path).expect("readable"));
                }
            }
        }
    }
    found
}
