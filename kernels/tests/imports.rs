//! Checks that the files of this crate, without tests, do not import each other in a circle.
//!
//! A file imports another if it names something that the other defines, by `use` or by a path from `crate`, `super` or
//! a child. A module that re-exports names (`pub use`) does not define them, and declaring a child is not an import.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// A module by its names from the root of the crate.
type Module = Vec<String>;

#[derive(Default)]
struct Source {
    /// Paths that the file names.
    uses: Vec<Vec<String>>,
    /// Names that it re-exports, and their origin.
    passed_on: BTreeMap<String, Vec<String>>,
}

fn read(dir: &Path, module: &[String], sources: &mut BTreeMap<Module, Source>) {
    for entry in std::fs::read_dir(dir).expect("a folder").map(|entry| entry.expect("an entry").path()) {
        let name = entry.file_stem().expect("a name").to_str().expect("UTF-8").to_owned();
        if ["tests", "testing", "monotone"].contains(&name.as_str()) {
            continue;
        }
        let inside = || [module, std::slice::from_ref(&name)].concat();
        if entry.is_dir() {
            read(&entry, &inside(), sources);
        } else {
            let module = if name == "mod" || name == "lib" { module.to_vec() } else { inside() };
            sources.insert(module, parse(&std::fs::read_to_string(&entry).expect("a file")));
        }
    }
}

/// The parts of a tree of imports.
fn expand(tree: &str, prefix: &[String], paths: &mut Vec<Vec<String>>) {
    let (mut depth, mut start) = (0, 0);
    let mut items = Vec::new();
    for (at, c) in tree.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                items.push(&tree[start..at]);
                start = at + 1;
            }
            _ => {}
        }
    }
    items.push(&tree[start..]);
    for item in items.into_iter().map(str::trim).filter(|item| !item.is_empty()) {
        let names = |path: &str| path.split("::").map(|name| name.trim().to_owned()).collect::<Vec<_>>();
        if let Some((head, rest)) = item.split_once('{') {
            let head = names(head.trim().trim_end_matches("::"));
            expand(rest.trim_end().strip_suffix('}').expect("a closed brace"), &[prefix, &head].concat(), paths);
        } else {
            let path = item.split(" as ").next().expect("a path");
            paths.push([prefix, &names(path)].concat().into_iter().filter(|name| name != "self").collect());
        }
    }
}

fn parse(text: &str) -> Source {
    let text = text.split("#[cfg(test)]\nmod tests {").next().expect("a first part");
    let code: String = text.lines().map(|line| line.split("//").next().unwrap_or("").to_owned() + "\n").collect();
    let (mut source, mut rest) = (Source::default(), String::new());
    let mut lines = code.lines();
    while let Some(line) = lines.next() {
        let (visibility, tree) = line.trim().split_once("use ").unwrap_or(("-", ""));
        if !(visibility.is_empty() || visibility.starts_with("pub") && visibility.ends_with(' ')) {
            rest.push_str(line);
            rest.push('\n');
            continue;
        }
        let mut tree = tree.to_owned();
        while !tree.ends_with(';') {
            tree.push_str(lines.next().expect("a whole import").trim());
        }
        let mut paths = Vec::new();
        expand(tree.trim_end_matches(';'), &[], &mut paths);
        for path in paths {
            match path.last() {
                Some(name) if !visibility.is_empty() => drop(source.passed_on.insert(name.clone(), path.clone())),
                _ => source.uses.push(path),
            }
        }
    }
    let word = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    for path in rest.split(|c| !word(c)).filter(|path| path.contains("::")) {
        source.uses.push(path.split("::").filter(|name| !name.is_empty()).map(str::to_owned).collect());
    }
    source
}

/// The module that defines what `path` names in `from`, if it is one of this crate.
fn resolve(sources: &BTreeMap<Module, Source>, from: &[String], path: &[String]) -> Option<Module> {
    let mut module = from.to_vec();
    let mut names = path.iter().peekable();
    match path.first()?.as_str() {
        "crate" => {
            module.clear();
            names.next();
        }
        "super" => {
            while names.next_if(|name| *name == "super").is_some() {
                module.pop();
            }
        }
        first => {
            let child = [from, &[first.to_owned()]].concat();
            if !sources.contains_key(&child) {
                return None;
            }
        }
    }
    while let Some(name) = names.next() {
        let child = [&module[..], std::slice::from_ref(name)].concat();
        if sources.contains_key(&child) {
            module = child;
        } else if let Some(passed) = sources.get(&module)?.passed_on.get(name) {
            let whole: Vec<_> = passed.iter().chain(names).cloned().collect();
            return resolve(sources, &module, &whole).or(Some(module));
        } else {
            break;
        }
    }
    Some(module)
}

/// Depth-first search; returns a circle that begins and ends with the same module.
fn circle<'a>(
    imports: &'a BTreeMap<Module, BTreeSet<Module>>,
    at: &'a Module,
    way: &mut Vec<&'a Module>,
    done: &mut BTreeSet<&'a Module>,
) -> Option<Vec<String>> {
    if let Some(start) = way.iter().position(|module| *module == at) {
        return Some(way[start..].iter().chain([&at]).map(|module| module.join("::")).collect());
    }
    if done.contains(at) {
        return None;
    }
    way.push(at);
    let found = imports[at].iter().find_map(|next| circle(imports, next, way, done));
    way.pop();
    done.insert(at);
    found
}

fn imports(sources: &BTreeMap<Module, Source>) -> BTreeMap<Module, BTreeSet<Module>> {
    let of = |(module, source): (&Module, &Source)| {
        let named = source.uses.iter().filter_map(|path| resolve(sources, module, path));
        (module.clone(), named.filter(|other| other != module && sources.contains_key(other)).collect())
    };
    sources.iter().map(of).collect()
}

#[test]
#[cfg_attr(miri, ignore = "reads the source")]
fn no_file_imports_one_that_imports_it() {
    let mut sources = BTreeMap::new();
    read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &[], &mut sources);
    let imports = imports(&sources);
    let count: usize = imports.values().map(BTreeSet::len).sum();
    assert!(sources.len() > 60 && count > 150, "{} files and {count} imports were found", sources.len());
    let mut done = BTreeSet::new();
    for module in imports.keys() {
        if let Some(circle) = circle(&imports, module, &mut Vec::new(), &mut done) {
            panic!("a circle of imports: {}", circle.join(" → "));
        }
    }
}

#[test]
fn a_circle_is_found_through_a_name_that_is_passed_on_and_not_in_what_is_passed_on() {
    let name = |path: &str| path.split("::").filter(|name| !name.is_empty()).map(str::to_owned).collect::<Module>();
    let tree = |leaf: &str| {
        BTreeMap::from([
            (name(""), Source::default()),
            (
                name("room"),
                parse("mod leaf;\nmod base;\npub(crate) use leaf::{Leaf, other::{self}};\npub use base::Base;\n"),
            ),
            (name("room::leaf"), parse(leaf)),
            (name("room::base"), parse("pub struct Base; // super::Leaf\n")),
            (name("hall"), parse("use crate::room::Leaf;\n")),
        ])
    };
    let find = |leaf: &str| {
        let imports = imports(&tree(leaf));
        circle(&imports, &name("hall"), &mut Vec::new(), &mut BTreeSet::new())
    };
    assert_eq!(find("use super::Base;\n"), None);
    let expected = Some(["hall", "room::leaf", "hall"].map(str::to_owned).to_vec());
    assert_eq!(find("use super::Base;\nfn f() { crate::hall::g(); }\n"), expected);
    assert_eq!(find("use crate::{\n    hall::{self},\n    Level,\n};\n"), expected);
}
