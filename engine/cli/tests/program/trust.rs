//! `docs/trust.md` names tests that exist.

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
