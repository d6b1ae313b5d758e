//! `docs/trust.md` and `docs/formats.md` name tests that exist.

use std::path::Path;

/// The tests that a page names, as `PATH::FUNCTION` between backquotes.
fn named(page: &str) -> Vec<(&str, &str)> {
    page.split('`').skip(1).step_by(2).filter_map(|code| code.split_once("::")).collect()
}

/// Returns true if the file holds the function.
fn exists(root: &Path, file: &str, function: &str) -> bool {
    let text = std::fs::read_to_string(root.join(file)).unwrap_or_default();
    text.contains(&format!("fn {function}("))
}

#[test]
fn every_test_that_a_promise_names_exists() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("a workspace");
    let page = std::fs::read_to_string(root.join("docs/trust.md")).expect("readable");
    let tests = named(&page);
    assert!(tests.len() > 15, "{} tests", tests.len());
    for (file, function) in tests {
        assert!(exists(root, file, function), "docs/trust.md: no test {function} in {file}");
    }
    assert!(!exists(root, "engine/cli/tests/program/trust.rs", "no_such_test"));
}

/// The text of every Rust file in a folder and below it.
fn sources(folder: &Path) -> String {
    let mut text = String::new();
    for entry in std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("readable").path()) {
        if entry.is_dir() {
            text += &sources(&entry);
        } else if entry.extension().is_some_and(|ending| ending == "rs") {
            text += &std::fs::read_to_string(&entry).expect("readable");
        }
    }
    text
}

#[test]
fn every_test_that_the_page_of_formats_names_exists() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("a workspace");
    let page = std::fs::read_to_string(root.join("docs/formats.md")).expect("readable");
    let code = page.split('`').skip(1).step_by(2);
    let is_test = |code: &&str| {
        code.matches('_').count() > 2 && code.chars().all(|c| c == '_' || c.is_ascii_lowercase() || c.is_ascii_digit())
    };
    let tests: Vec<&str> = code.filter(is_test).collect();
    assert!(tests.len() > 25, "{} tests", tests.len());
    let text = sources(&root.join("engine/src/import")) + &sources(&root.join("engine/cli/tests/program"));
    for test in tests {
        assert!(text.contains(&format!("fn {test}(")), "docs/formats.md: no test {test}");
    }
}
