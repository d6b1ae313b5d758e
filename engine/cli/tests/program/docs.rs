//! Pages under `docs/` and the README agree with the program and the records.
//!
//! `STORE_DOCS=1 cargo test --release -p streamsplat-cli --test program docs` writes the generated parts:
//! `docs/cli.md`, and the tables of records in the README and `docs/performance.md`.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use serde_json::Value;
use streamsplat::formats::{FORMATS, READ_ONLY};
use streamsplat::run::options::StreamOptions;
use streamsplat::stream::Quality;

use crate::support::{Scratch, run};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("a workspace")
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Compares a page with its generated text, or writes it if `STORE_DOCS` is set.
fn assert_generated(page: &str, expected: &str) {
    let path = root().join(page);
    if std::env::var_os("STORE_DOCS").is_some() {
        std::fs::write(&path, expected).expect("writable");
    }
    assert!(
        std::fs::read_to_string(&path).unwrap_or_default() == expected,
        "{page} is out of date: STORE_DOCS=1 cargo test --release -p streamsplat-cli --test program docs"
    );
}

fn help(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("text");
    text.lines().map(str::trim_end).collect::<Vec<_>>().join("\n")
}

/// Returns the subcommands that `--help` lists, without `help`.
fn commands(help: &str) -> Vec<&str> {
    let listed = help.lines().skip_while(|line| !line.starts_with("Commands:")).skip(1);
    let lines = listed.take_while(|line| !line.is_empty()).filter(|line| !line.starts_with("   "));
    lines.filter_map(|line| line.split_whitespace().next()).filter(|&name| name != "help").collect()
}

#[test]
fn the_page_of_options_is_what_the_program_says() {
    let whole = help(&["--help"]);
    let mut page = format!(
        "<!-- Written by a test: STORE_DOCS=1 cargo test --release -p streamsplat-cli --test program docs -->\n\
         # Commands and options\n\n```text\n{whole}\n```\n"
    );
    let commands = commands(&whole);
    assert!(commands.contains(&"run") && commands.len() > 10, "{commands:?}");
    for command in commands {
        // `bench` passes its arguments to another program, whose page is bench/README.md.
        let text = if command == "bench" {
            "Its options are those of [`streamsplat-bench`](../bench/README.md).".to_owned()
        } else {
            format!("```text\n{}\n```", help(&[command, "--help"]))
        };
        write!(page, "\n## {command}\n\n{text}\n").expect("a string");
        if command == "golden" {
            for part in ["record", "check"] {
                write!(page, "\n### {command} {part}\n\n```text\n{}\n```\n", help(&[command, part, "--help"]))
                    .expect("a string");
            }
        }
    }
    assert_generated("docs/cli.md", &page);
}

/// Returns the default in the help of `run` for each option, up to a `;`, after which defaults of other models follow.
fn defaults(help: &str) -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    let help = help.split_whitespace().collect::<Vec<_>>().join(" ");
    for option in help.split(" --").skip(1) {
        let name = option.split(' ').next().unwrap_or_default();
        if let Some(default) = option.split("[default: ").nth(1).and_then(|rest| rest.split([';', ']']).next()) {
            found.insert(name.to_owned(), default.to_owned());
        }
    }
    found
}

/// Collects the options of a record by their names on the command line, without their groups.
fn recorded(options: &Value, found: &mut BTreeMap<String, String>) {
    for (name, value) in options.as_object().expect("an object") {
        match value {
            Value::Object(_) => recorded(value, found),
            Value::Null => {}
            Value::String(text) => _ = found.insert(name.replace('_', "-"), text.clone()),
            other => _ = found.insert(name.replace('_', "-"), other.to_string()),
        }
    }
}

#[test]
fn the_defaults_in_the_help_are_those_of_a_run() {
    let scratch = Scratch::new();
    let (clip, out) = (scratch.clip("clip", 2, 32, 32), scratch.path("out"));
    let output = run([OsStr::new("run"), clip.as_os_str(), "--out".as_ref(), out.as_os_str()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let record: Value = serde_json::from_str(&read(&out.join("run.json"))).expect("JSON");
    let mut used = BTreeMap::new();
    recorded(&record["options"], &mut used);
    let printed = defaults(&help(&["run", "--help"]));
    let mut compared = 0;
    for (name, value) in &used {
        let default = printed.get(name).unwrap_or_else(|| panic!("--{name} {value}: no default in the help"));
        assert_eq!(default, value, "--{name}");
        compared += 1;
    }
    assert!(compared >= 16, "{used:?}");
    assert_eq!(used["gap"], "auto:3-8:38");
}

const BEGIN: &str = "<!-- table of ";

/// Returns the page with the table of each record that it names between `<!-- table of FILE -->` and `<!-- end -->`.
fn with_tables(page: &str) -> String {
    let mut parts = page.split(BEGIN);
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (name, rest) = part.split_once(" -->\n").expect("a record's name");
        let (_, after) = rest.split_once("<!-- end -->").expect("an end");
        let table = match name {
            "formats" => formats(),
            "qualities" => presets(),
            _ => table(name, &serde_json::from_str(&read(&root().join("bench/record").join(name))).expect("JSON")),
        };
        write!(text, "{BEGIN}{name} -->\n{table}<!-- end -->{after}").expect("a string");
    }
    text
}

fn table(name: &str, record: &Value) -> String {
    match name.split('-').next() {
        Some("peers") => peers(record),
        Some("stages") => stages(record),
        Some("raster") => raster(record),
        Some("qualities") => qualities(record),
        _ => panic!("{name}: expected a record of peers, stages, raster or qualities"),
    }
}

/// Returns a row per quality: the median over clips of frames a second, with the least and the most, and the mean over
/// clips of PSNR.
fn qualities(record: &Value) -> String {
    let mut page = "| `--quality` | frames a second | PSNR |\n|---|---:|---:|\n".to_owned();
    for quality in ["realtime", "balanced", "best"] {
        let rows: Vec<&Value> = list(&record["rows"]).iter().filter(|row| row["quality"] == quality).collect();
        let median = |mut numbers: Vec<f64>| {
            numbers.sort_by(f64::total_cmp);
            0.5 * (numbers[(numbers.len() - 1) / 2] + numbers[numbers.len() / 2])
        };
        let seconds = |row: &Value| median(list(&row["seconds"]).iter().map(number).collect());
        let rates: Vec<f64> = rows.iter().map(|row| number(&row["frames"]) / seconds(row)).collect();
        let (least, most) = rates.iter().fold((f64::MAX, 0.0_f64), |(a, b), &rate| (a.min(rate), b.max(rate)));
        let psnr = rows.iter().map(|row| number(&row["psnr"])).sum::<f64>() / rows.len() as f64;
        let rate = median(rates);
        writeln!(page, "| {quality} | {rate:.1} ({least:.1} to {most:.1}) | {psnr:.1} dB |").expect("a string");
    }
    page
}

/// The options that a quality sets, by their names on the command line, each with its value per quality.
fn preset_options() -> BTreeMap<String, Vec<String>> {
    let mut rows: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for &quality in Quality::ALL {
        let options = StreamOptions { quality: Some(quality), ..StreamOptions::default() };
        let mut set = BTreeMap::new();
        recorded(&serde_json::to_value(options.resolved()).expect("JSON"), &mut set);
        // These have one default for all models.
        for other in ["quality", "depth-range", "fusion", "sampling", "seed"] {
            set.remove(other).unwrap_or_else(|| panic!("--{other}: a default"));
        }
        set.into_iter().for_each(|(name, value)| rows.entry(name).or_default().push(value));
    }
    rows
}

/// Returns a row per option that a quality sets.
fn presets() -> String {
    let names: Vec<String> = Quality::ALL.iter().map(|quality| format!(" `{quality}` |")).collect();
    let mut page = format!("| |{}\n|{}\n", names.concat(), "---|".repeat(1 + names.len()));
    for (name, values) in preset_options() {
        writeln!(page, "| `--{name}` | {} |", values.join(" | ")).expect("a string");
    }
    page
}

#[test]
fn the_help_names_the_options_that_a_quality_sets() {
    let help = help(&["run", "--help"]).split_whitespace().collect::<Vec<_>>().join(" ");
    let named = help.split("best; sets ").nth(1).and_then(|rest| rest.split(" where they").next()).expect("a list");
    let mut named: Vec<&str> = named.split([',', ' ']).filter(|word| !["", "and"].contains(word)).collect();
    named.sort_unstable();
    assert_eq!(named, preset_options().into_keys().collect::<Vec<_>>());
}

/// Returns a row per format of still scenes.
fn formats() -> String {
    let mut page = "| still scenes | `--format` | keeps | loses |\n|---|---|---|---|\n".to_owned();
    for format in &FORMATS {
        let (name, ending, option, keeps, loses) =
            (format.name, format.ending, format.option, format.keeps, format.loses);
        writeln!(page, "| {name}, `.{ending}` | `{option}` | {keeps} | {loses} |").expect("a string");
    }
    for format in &READ_ONLY {
        writeln!(page, "| {}, `{}` | read only | {} | |", format.name, format.ending, format.reads).expect("a string");
    }
    page
}

fn list(value: &Value) -> &[Value] {
    value.as_array().expect("a list")
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

fn text(value: &Value) -> &str {
    value.as_str().expect("text")
}

/// Returns a row per stage and precision: our seconds, and theirs with the ratio of our time to theirs.
fn peers(record: &Value) -> String {
    let results = list(&record["results"]);
    let version = |package: &str| {
        let found = list(&record["peers"]).iter().find_map(|peer| text(peer).strip_prefix(package)?.strip_prefix("=="));
        found.unwrap_or_default().to_owned()
    };
    let known = [("torch", "PyTorch"), ("onnxruntime", "ONNX Runtime"), ("openvino", "OpenVINO")];
    let runners: Vec<_> =
        known.into_iter().filter(|(name, _)| results.iter().any(|row| row["runner"] == *name)).collect();
    let titles: Vec<_> = runners.iter().map(|(package, title)| format!("{title} {}", version(package))).collect();
    let mut page = format!("| | streamsplat | {} |\n|---|---:|{}\n", titles.join(" | "), "---:|".repeat(runners.len()));
    for ours in results.iter().filter(|row| row["runner"] == "streamsplat") {
        let theirs = |runner: &str| {
            let same = |row: &&Value| {
                row["runner"] == runner && row["stage"] == ours["stage"] && row["precision"] == ours["precision"]
            };
            results.iter().find(same).map_or_else(String::new, |row| {
                format!("{:.2} ({:.2})", number(&row["seconds"]["median"]), number(&row["ours_over_this"]["median"]))
            })
        };
        let cells: Vec<_> = runners.iter().map(|(runner, _)| theirs(runner)).collect();
        if cells.iter().all(String::is_empty) {
            continue;
        }
        let (stage, precision) = (text(&ours["stage"]), text(&ours["precision"]));
        let seconds = number(&ours["seconds"]["median"]);
        writeln!(page, "| {stage}, {precision} | {seconds:.2} | {} |", cells.join(" | ")).expect("a string");
    }
    page
}

fn stages(record: &Value) -> String {
    let mut page = "| | GFLOP | ms, least | median |\n|---|---:|---:|---:|\n".to_owned();
    for stage in list(&record["stages"]) {
        let name = match text(&stage["name"]) {
            "step" => "whole key frame",
            name => name,
        };
        let work = stage["gflop"].as_f64().map_or_else(String::new, |work| format!("{work:.1}"));
        let milliseconds = |which: &str| 1e3 * number(&stage["seconds"][which]);
        writeln!(page, "| {name} | {work} | {:.1} | {:.1} |", milliseconds("min"), milliseconds("median"))
            .expect("a string");
    }
    page
}

fn raster(record: &Value) -> String {
    let mut page = "| scene | Gaussians | size | ms, median | peak MiB |\n|---|---:|---|---:|---:|\n".to_owned();
    for scene in list(&record["scenes"]) {
        let (width, height) = (&scene["size"][0], &scene["size"][1]);
        let (name, count, time) = (text(&scene["name"]), &scene["gaussians"], number(&scene["milliseconds"]["median"]));
        writeln!(page, "| {name} | {count} | {width}×{height} | {time:.1} | |").expect("a string");
    }
    for row in list(&record["scaling"]) {
        let (count, time) = (&row["gaussians"], number(&row["milliseconds"]));
        let peak = number(&row["peak_rss_bytes"]) / f64::from(1 << 20);
        writeln!(page, "| growth | {count} | 512×288 | {time:.1} | {peak:.0} |").expect("a string");
    }
    page
}

#[test]
fn tables_of_measurements_are_those_of_the_records() {
    for (page, least) in [("README.md", 1), ("docs/performance.md", 5), ("docs/formats.md", 1), ("docs/choosing.md", 1)]
    {
        let text = read(&root().join(page));
        assert!(text.matches(BEGIN).count() >= least, "{page}: tables of records");
        assert_generated(page, &with_tables(&text));
    }
    // Another figure changes the page.
    let page = read(&root().join("README.md"));
    let other = page.replacen("| realtime | ", "| realtime | 9", 1);
    assert!(other != page && with_tables(&other) != other);
}

#[test]
fn the_readme_and_the_glossary_stay_short() {
    let readme = read(&root().join("README.md"));
    let words = readme.split_whitespace().count();
    assert!(words <= 450, "README.md: {words} words");
    assert_eq!(readme.lines().filter(|line| line.starts_with("|---")).count(), 1, "README.md: tables");
    let lines = read(&root().join("docs/glossary.md")).lines().count();
    assert!(lines <= 60, "docs/glossary.md: {lines} lines");
}

/// Iterates over the files that a page links to, relative to its folder.
fn links(page: &str) -> impl Iterator<Item = &str> {
    let targets = page.split("](").skip(1).filter_map(|rest| rest.split([')', '#']).next());
    targets.filter(|target| !target.is_empty() && !target.contains("://"))
}

#[test]
fn links_between_pages_lead_to_files() {
    let mut pages: Vec<PathBuf> =
        ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "bench/README.md", "engine/lite/README.md"]
            .into_iter()
            .chain(["model/train/README.md", "model/train/HISTORY.md"])
            .map(|page| root().join(page))
            .collect();
    let docs = std::fs::read_dir(root().join("docs")).expect("a folder");
    pages.extend(
        docs.map(|entry| entry.expect("an entry").path()).filter(|path| path.extension().is_some_and(|e| e == "md")),
    );
    let mut found = 0;
    for page in pages {
        let text = read(&page);
        for link in links(&text) {
            found += 1;
            assert!(page.with_file_name(link).exists(), "{}: no file {link}", page.display());
        }
    }
    assert!(found > 30, "{found} links");
}

/// Iterates over the paths of this repository that a page names between backquotes.
fn paths(page: &str) -> impl Iterator<Item = &str> {
    let codes = page.split('`').skip(1).step_by(2);
    codes.filter(|code| {
        ["kernels/", "model/", "engine/", "bench/", "tests/", "fixtures/"].iter().any(|folder| code.starts_with(folder))
            && code.chars().all(|c| c.is_ascii_alphanumeric() || "/._-".contains(c))
    })
}

#[test]
fn files_that_the_pages_on_the_code_name_exist() {
    for page in ["docs/architecture.md", "docs/glossary.md", "CONTRIBUTING.md"] {
        let text = read(&root().join(page));
        let named: Vec<_> = paths(&text).collect();
        assert!(named.len() > 5, "{page}: {named:?}");
        for path in named {
            assert!(root().join(path).exists(), "{page}: no file {path}");
        }
    }
}

/// Returns the modules of the library that production code uses: `crate::name`, also in braces. A name of the root is
/// the module that it is re-exported from.
fn used(code: &str, root: &[(String, String)]) -> Vec<String> {
    let code: String = code.lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n");
    let mut names = Vec::new();
    for rest in code.split("crate::").skip(1) {
        let mut word = |text: &str| {
            names.push(text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>());
        };
        let Some(list) = rest.strip_prefix('{') else {
            word(rest);
            continue;
        };
        let (mut depth, mut starts) = (0, true);
        for (at, c) in list.char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth == 0 => break,
                '}' => depth -= 1,
                ',' if depth == 0 => starts = true,
                c if starts && c.is_alphanumeric() => {
                    word(&list[at..]);
                    starts = false;
                }
                _ => {}
            }
        }
    }
    let of_root = |name: String| root.iter().find(|(own, _)| *own == name).map_or(name, |(_, module)| module.clone());
    names.into_iter().map(of_root).collect()
}

#[test]
fn modules_of_the_engine_use_only_those_below_them() {
    let page = read(&root().join("docs/architecture.md"));
    let (_, table) = page.split_once("| module | purpose |\n|---|---|\n").expect("the table of modules");
    let rows = table.lines().take_while(|line| line.starts_with('|')).map(|line| line.split('|').nth(1).unwrap_or(""));
    let order: Vec<&str> = rows.flat_map(|row| row.split('`').skip(1).step_by(2)).collect();
    let source = root().join("engine/src");
    let library = read(&source.join("lib.rs"));
    let mut reexported = Vec::new();
    for line in library.lines().filter_map(|line| line.strip_prefix("pub use ")?.strip_suffix(';')) {
        let Some((module, names)) = line.split_once("::") else { continue };
        let names = names.trim_matches(['{', '}']).split(',').map(|name| name.trim().to_owned());
        reexported.extend(names.map(|name| (name, module.to_owned())));
    }
    let mut arrows = 0;
    for (place, module) in order.iter().enumerate() {
        let (file, folder) = (source.join(format!("{module}.rs")), source.join(module));
        let mut files = if file.is_file() { vec![file] } else { below(&folder) };
        // Tests, in files of their own or at the end of a file, may use everything.
        files.retain(|file| !file.ends_with("tests.rs") && !file.ends_with("by_tree.rs"));
        for file in files {
            let text = read(&file);
            let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
            for name in used(code, &reexported).iter().filter(|name| name != module) {
                let Some(other) = order.iter().position(|module| module == name) else { continue };
                arrows += 1;
                assert!(other > place, "{}: {module} uses {name}, which is above it", file.display());
            }
        }
    }
    assert!(arrows > 100, "{arrows}");
    let declared = library.lines().filter_map(|line| line.strip_prefix("pub mod ")?.strip_suffix(';'));
    for module in declared {
        assert!(order.contains(&module), "{module} is not in docs/architecture.md");
    }
}

/// Returns the files of Rust in a folder and below it.
fn below(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    entries
        .flat_map(|path| if path.is_dir() { below(&path) } else { vec![path] })
        .filter(|path| path.extension().is_some_and(|ending| ending == "rs"))
        .collect()
}
