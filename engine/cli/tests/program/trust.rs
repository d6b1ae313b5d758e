//! `docs/trust.md` names only existing tests and mutations, and every mutation has its promise; `docs/formats.md` names
//! only existing tests.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("a workspace")
}

fn read(name: &str) -> String {
    std::fs::read_to_string(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// Iterates over the parts of a text between backquotes.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

/// Returns the tests that a page names, as `PATH::FUNCTION` between backquotes.
fn named(page: &str) -> Vec<(&str, &str)> {
    quoted(page).filter_map(|code| code.split_once("::")).collect()
}

/// Returns true if the file has the function, or a macro's line `FUNCTION: "…"` that generates it.
fn exists(file: &str, function: &str) -> bool {
    let text = std::fs::read_to_string(root().join(file)).unwrap_or_default();
    text.contains(&format!("fn {function}(")) || text.contains(&format!("\n    {function}: \""))
}

/// Returns the mutations of the list, by name, with their tests.
fn mutations() -> BTreeMap<String, Vec<String>> {
    let list: toml::Table = toml::from_str(&read("tests/mutations/list.toml")).expect("a list");
    let text = |value: &toml::Value| value.as_str().expect("text").to_owned();
    let entries = list["mutation"].as_array().expect("mutations").iter();
    entries
        .map(|entry| (text(&entry["name"]), entry["tests"].as_array().expect("tests").iter().map(text).collect()))
        .collect()
}

#[test]
fn every_test_that_a_promise_names_exists() {
    let page = read("docs/trust.md");
    let tests = named(&page);
    assert!(tests.len() > 15, "{} tests", tests.len());
    for (file, function) in tests {
        assert!(exists(file, function), "docs/trust.md: no test {function} in {file}");
    }
    assert!(!exists("engine/cli/tests/program/trust.rs", "no_such_test"));
}

#[test]
fn every_promise_has_a_mutation_and_every_mutation_a_promise() {
    let page = read("docs/trust.md");
    let mutations = mutations();
    let mut seen = BTreeSet::new();
    let mut promises = 0;
    for row in page.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| promised |")) {
        let cells: Vec<&str> = row.split('|').collect();
        let [_, promise, tests, broken, ..] = cells[..] else { panic!("docs/trust.md: expected four columns: {row}") };
        promises += 1;
        assert!(quoted(broken).next().is_some(), "docs/trust.md: no mutation for{promise}");
        for name in quoted(broken) {
            let own = mutations.get(name).unwrap_or_else(|| panic!("docs/trust.md: no mutation {name} in the list"));
            // One of its tests is a test of the row; scripts may be named without their arguments.
            let is_of_the_row =
                own.iter().any(|test| tests.contains(&format!("`{}", test.split(' ').next().unwrap_or_default())));
            assert!(is_of_the_row, "docs/trust.md: no test of {name} is in its row");
            seen.insert(name);
        }
    }
    assert!(promises > 80, "{promises} promises");
    for (name, tests) in &mutations {
        assert!(seen.contains(name.as_str()), "docs/trust.md: the mutation {name} is not named");
        for test in tests {
            let found = match test.split_once("::") {
                Some((file, function)) => exists(file, function),
                None => root().join(test.split(' ').next().unwrap_or_default()).is_file(),
            };
            assert!(found, "tests/mutations/list.toml: {name}: no test {test}");
        }
    }
}

/// Splits a function of `docs/api/kernels.txt` into its path without the crate and the text between its parentheses.
fn function(line: &str) -> Option<(&str, &str)> {
    let (_, rest) = line.split_once("fn streamsplat_kernels::")?;
    let (path, arguments) = rest.split_once('(')?;
    Some((path.split('<').next()?, arguments.rsplit_once(" -> ").map_or(arguments, |(arguments, _)| arguments)))
}

/// Iterates over words of Rust in a text.
fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !c.is_alphanumeric() && c != '_')
}

#[test]
fn every_kernel_that_takes_sizes_is_given_impossible_ones() {
    let api = read("docs/api/kernels.txt");
    let calls = read("kernels/tests/sizes.rs");
    // Structures that contain sizes.
    let structures: BTreeSet<&str> = api
        .lines()
        .filter_map(|line| line.strip_prefix("field ").or_else(|| line.strip_prefix("variant ")))
        .filter(|item| item.contains("usize") && !item.contains("::reference::"))
        .filter_map(|item| item.split([' ', '(']).next()?.trim_end_matches(':').rsplit("::").nth(1))
        .collect();
    assert!(structures.contains("Field") && structures.contains("Grid") && structures.len() > 7, "{structures:?}");
    let takes = |arguments: &str| words(arguments).any(|word| word == "usize" || structures.contains(word));
    // These read no memory by their sizes. `uncovered` counts values of one plane, `rest` is a formula, and
    // `Request::colour` and `with_budget` store their argument. Loops are tested at any length; `Disjoint::part` is
    // unsafe, and its range is checked.
    let others = [
        "fill::uncovered",
        "harmonics::rest",
        "raster::Request::colour",
        "raster::ColourMap::with_budget",
        "parallel::for_each_chunk",
        "parallel::map_indexed",
        "parallel::Disjoint::part",
    ];
    let mut found = 0;
    for (path, _) in api.lines().filter_map(function).filter(|(_, arguments)| takes(arguments)) {
        if path.contains("reference::") || path.starts_with("simd::") || others.contains(&path) {
            continue;
        }
        found += 1;
        assert!(calls.contains(&format!("\"{path}\": ")), "kernels/tests/sizes.rs: {path} is not called");
    }
    assert!(found > 35, "{found} functions");
}

/// Returns the text of every Rust file below a folder.
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
    let page = read("docs/formats.md");
    let code = quoted(&page);
    let is_test = |code: &&str| {
        code.matches('_').count() > 2 && code.chars().all(|c| c == '_' || c.is_ascii_lowercase() || c.is_ascii_digit())
    };
    let tests: Vec<&str> = code.filter(is_test).collect();
    assert!(tests.len() > 25, "{} tests", tests.len());
    let text = sources(&root().join("engine/src/formats")) + &sources(&root().join("engine/cli/tests/program"));
    for test in tests {
        assert!(text.contains(&format!("fn {test}(")), "docs/formats.md: no test {test}");
    }
}
