//! Comparison of two folders: every file of both, paired by name.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use streamsplat::folder::natural;
use streamsplat::formats::Limits;
use streamsplat::open;
use streamsplat::output::VIDEOS;
use streamsplat::samples::{self, Kind};
use streamsplat::scene::INDEX;
use streamsplat::stream::Workers;

use crate::command::compare::account::Account;
use crate::command::compare::{Outcome, Tolerance, pictures, scenes};
use crate::console::failure::Failure;
use streamsplat::run::digest;

/// Maximum depth of nested folders.
const DEPTH: usize = 16;
/// Files of a run that depend on its time and machine, and its resume state.
const TELLING: [&str; 3] = ["run.json", "report.md", "resume"];

/// A file, or a scene, which is a folder of files that belong together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Entry {
    File,
    Scene,
}

/// The contents of a folder: paths by relative names. Names that are not UTF-8 are shown lossily.
struct Content {
    entries: BTreeMap<String, (Entry, PathBuf)>,
    hidden: usize,
    /// True if `run` or `render` wrote the folder.
    rendering: bool,
}

impl Content {
    fn of(folder: &Path) -> Result<Content, Failure> {
        let mut content = Content { entries: BTreeMap::new(), hidden: 0, rendering: folder.join("run.json").is_file() };
        content.add(folder, "", 0)?;
        Ok(content)
    }

    fn add(&mut self, folder: &Path, prefix: &str, depth: usize) -> Result<(), Failure> {
        let wrong = |e: std::io::Error| Failure::work(format!("{}: {e}", folder.display()));
        if depth > DEPTH {
            return Err(Failure::work(format!(
                "{}: expected at most {DEPTH} folders within each other",
                folder.display()
            )));
        }
        for entry in std::fs::read_dir(folder).map_err(wrong)? {
            let (name, path) = entry.map(|entry| (entry.file_name(), entry.path())).map_err(wrong)?;
            let name = name.to_string_lossy().into_owned();
            if depth == 0 && self.rendering && TELLING.contains(&name.as_str()) {
                continue;
            }
            if name.starts_with('.') {
                self.hidden += 1;
                continue;
            }
            let inside = format!("{prefix}{name}");
            let kind = match path.is_dir() {
                false => Entry::File,
                true if path.join(INDEX).exists() => Entry::Scene,
                true => {
                    self.add(&path, &format!("{inside}/"), depth + 1)?;
                    continue;
                }
            };
            if let Some((_, other)) = self.entries.insert(inside, (kind, path.clone())) {
                let (a, b) = (other.display(), path.display());
                return Err(Failure::work(format!("{a:?} and {b:?}: expected names that differ as UTF-8")));
            }
        }
        Ok(())
    }

    /// Returns true if some files are directly in this folder.
    fn is_flat(&self) -> bool {
        self.entries.iter().any(|(name, (kind, _))| *kind == Entry::File && !name.contains('/'))
    }
}

/// Compares the contents of two folders.
pub fn compare(
    a: &Path,
    b: &Path,
    tolerance: Tolerance,
    limits: &Limits,
    workers: &Workers,
) -> Result<Outcome, Failure> {
    let mut account = Account::new(tolerance);
    let (mut folders, mut contents) = ([a.to_owned(), b.to_owned()], [Content::of(a)?, Content::of(b)?]);
    // A rendering is compared with a folder of images by its frames.
    for (at, other) in [(0, 1), (1, 0)] {
        let frames = folders[at].join("frames");
        if !contents[at].is_flat() && contents[other].is_flat() && frames.is_dir() {
            account.note(format!("{}: its frames alone are compared", folders[at].display()));
            contents[at] = Content::of(&frames)?;
            folders[at] = frames;
        }
    }
    for (folder, content) in folders.iter().zip(&contents) {
        if content.entries.is_empty() {
            return Err(Failure::work(format!("{}: expected files to compare, found none", folder.display())));
        }
        if content.hidden > 0 {
            account.note(format!("{}: {} hidden files are left out", folder.display(), content.hidden));
        }
        if content.rendering {
            account.note("run.json, report.md and resume tell of time and machine, and are left out".to_owned());
        }
    }
    let mut names: Vec<&String> =
        contents.iter().flat_map(|content| content.entries.keys()).collect::<BTreeSet<_>>().into_iter().collect();
    names.sort_by(|a, b| natural::compare(a.as_bytes(), b.as_bytes()));
    for name in names {
        let missing = folders.iter().zip(&contents).find(|(_, content)| !content.entries.contains_key(name));
        if let Some((folder, _)) = missing {
            account.odd(name, &format!("missing in {}", folder.display()));
            continue;
        }
        let [(a, first), (b, second)] = [0, 1].map(|at| {
            let (kind, path) = &contents[at].entries[name];
            (path.clone(), *kind)
        });
        let (paths, kinds) = ([a, b], [first, second]);
        if let Err(failure) = entry(&paths, kinds, name, limits, workers, &mut account) {
            account.odd(name, &failure.message());
        }
    }
    Ok(account.finish("files"))
}

fn entry(
    paths: &[PathBuf; 2],
    kinds: [Entry; 2],
    name: &str,
    limits: &Limits,
    workers: &Workers,
    account: &mut Account,
) -> Result<(), Failure> {
    let [a, b] = paths;
    let both = |test: fn(&Path) -> bool| test(a) && test(b);
    match kinds {
        [Entry::Scene, Entry::Scene] => account.scenes(name, scenes::compare(a, b, limits, workers)?),
        [Entry::File, Entry::File] if both(open::is_scene) => {
            account.scenes(name, scenes::compare(a, b, limits, workers)?);
        }
        [Entry::File, Entry::File] if both(is_picture) => pictures::parts([a, b], name, account)?,
        [Entry::File, Entry::File] if digest::file(a)? == digest::file(b)? => account.equal(name),
        [Entry::File, Entry::File] => account.odd(name, "the bytes differ"),
        _ => account.odd(name, "expected two of a kind, found a file and a scene"),
    }
    Ok(())
}

/// Returns true for images, y4m, and files named like a video.
fn is_picture(path: &Path) -> bool {
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
    let named = VIDEOS.contains(&ending.as_str()) || ["avi", "mpg", "mpeg", "ts", "wmv"].contains(&ending.as_str());
    samples::kind(path).map_or(named || streamsplat::folder::is_image(path), |kind| kind != Kind::Video || named)
}
