//! Streamed SOG, version 1: a `lod-meta.json` index of SOG scenes in subfolders, at several levels of detail.
//!
//! | key | value |
//! |---|---|
//! | `version` | 1, or absent |
//! | `lodLevels` | number of levels; level 0 has the most Gaussians |
//! | `counts` | Gaussians of each level; may be absent |
//! | `filenames` | the scenes' `meta.json` |
//! | `tree` | nodes with `children`, or with `lods`: for a level `{file, offset, count}`, a range of a scene's Gaussians |
//! | `environment` | the `meta.json` of a scene that is part of every level; may be absent |
//!
//! The reader loads the union of one level, in the order of the files and of the ranges in them, followed by the
//! environment. Nodes without an entry for the level are skipped.
//!
//! Source: PlayCanvas, the streamed SOG format's description.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::Deserialize;
use streamsplat_kernels::harmonics::rest;

use super::{Beside, FormatError, Limits, sog};
use crate::still::Still;

/// The format's name.
pub(crate) const NAME: &str = "streamed SOG";
/// The index's name.
pub(super) const INDEX: &str = "lod-meta.json";
/// Longest index, in bytes.
const MAX_INDEX: usize = 1 << 26;
/// Longest `meta.json` of a scene, in bytes.
const MAX_META: u64 = 1 << 20;
/// Maximum depth of the tree.
const DEPTH: usize = 64;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Meta {
    version: Option<f64>,
    lod_levels: usize,
    counts: Option<Vec<usize>>,
    filenames: Vec<String>,
    tree: Node,
    environment: Option<String>,
}

#[derive(Deserialize)]
struct Node {
    #[serde(default)]
    children: Vec<Node>,
    #[serde(default)]
    lods: BTreeMap<String, Part>,
}

/// A range of a scene's Gaussians.
#[derive(Clone, Copy, Deserialize)]
struct Part {
    file: usize,
    offset: usize,
    count: usize,
}

/// Returns true if a file with this name and these first bytes has the format.
pub(super) fn is(path: &Path, head: &[u8]) -> bool {
    path.file_name().is_some_and(|name| name == INDEX) && head.trim_ascii_start().starts_with(b"{")
}

fn wrong(part: &str, expected: impl Into<String>, found: impl ToString) -> FormatError {
    FormatError::new(format!("{INDEX}{part}"), expected, found.to_string())
}

/// Files and ranges of one level, from a validated index.
#[derive(Debug, PartialEq)]
pub struct Plan {
    /// Scenes, and the ranges that are read from each, as offset and length.
    pub files: Vec<(String, Vec<[usize; 2]>)>,
    /// A scene that is read as a whole.
    pub environment: Option<String>,
    /// Number of Gaussians in the ranges.
    pub count: usize,
}

/// Reads the index and lists the files and ranges of a level. No other file is opened.
///
/// # Errors
/// Invalid text, a missing level, counts that contradict the tree, more Gaussians than the limits allow.
pub fn plan(text: &[u8], limits: &Limits, level: usize) -> Result<Plan, FormatError> {
    if text.len() > MAX_INDEX {
        return Err(wrong("", format!("at most {MAX_INDEX} bytes"), text.len()));
    }
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
    let Meta { version, lod_levels, counts, filenames, tree, environment } =
        serde_json::from_slice(text).map_err(|e| wrong("", "a streamed SOG scene's", e))?;
    if let Some(version) = version.filter(|version| *version != 1.0) {
        return Err(wrong(": version", "1", version));
    }
    if level >= lod_levels {
        let expected = format!("more than {level}, the level that is asked for (--lod)");
        return Err(wrong(": lodLevels", expected, lod_levels));
    }
    let mut parts = Vec::new();
    collect(&tree, level, &mut parts, 0)?;
    let count = parts.iter().try_fold(0_usize, |sum, part| sum.checked_add(part.count)).unwrap_or(usize::MAX);
    limits.check_count(&format!("{INDEX}: level {level}"), count)?;
    if let Some(said) = counts.and_then(|counts| counts.get(level).copied()).filter(|said| *said != count) {
        return Err(wrong(&format!(": counts of level {level}"), format!("{count} as the tree says"), said));
    }
    let mut files: BTreeMap<usize, Vec<[usize; 2]>> = BTreeMap::new();
    for Part { file, offset, count } in parts.into_iter().filter(|part| part.count > 0) {
        if file >= filenames.len() {
            return Err(wrong(": file", format!("one of {} filenames", filenames.len()), file));
        }
        files.entry(file).or_default().push([offset, count]);
    }
    // No Gaussian of a file is read twice, so that a union is no larger than its files.
    let (mut named, mut seen) = (Vec::new(), BTreeSet::new());
    for (file, mut ranges) in files {
        ranges.sort_unstable();
        let name = &filenames[file];
        let ends = |range: &[usize; 2]| range[0].saturating_add(range[1]);
        if !seen.insert(name) || !ranges.is_sorted_by(|a, b| ends(a) <= b[0]) {
            return Err(wrong(&format!(": {name}"), "each of its Gaussians once at a level", "some twice"));
        }
        named.push((name.clone(), ranges));
    }
    Ok(Plan { files: named, environment, count })
}

fn collect(node: &Node, level: usize, parts: &mut Vec<Part>, depth: usize) -> Result<(), FormatError> {
    if depth > DEPTH {
        return Err(wrong(": tree", format!("at most {DEPTH} nodes one in another"), "more"));
    }
    parts.extend(node.lods.get(&level.to_string()));
    node.children.iter().try_for_each(|child| collect(child, level, parts, depth + 1))
}

/// Reads the union of a level.
pub(super) fn level(text: &[u8], beside: &Beside, limits: &Limits, level: usize) -> Result<Still, FormatError> {
    let plan = plan(text, limits, level)?;
    let mut still = Still::default();
    // Scenes are read one by one, so that memory holds only the union and one scene.
    for (name, ranges) in &plan.files {
        let scene = scene(name, beside, limits)?;
        for &[offset, count] in ranges {
            if offset.checked_add(count).is_none_or(|end| end > scene.len()) {
                let found = format!("{count} from {offset}");
                return Err(wrong(&format!(": {name}"), format!("a range of its {} Gaussians", scene.len()), found));
            }
            append(&mut still, &scene, offset, count);
        }
    }
    if let Some(name) = &plan.environment {
        let scene = scene(name, beside, limits)?;
        limits.check_count(&format!("{INDEX}: level {level} and environment"), still.len() + scene.len())?;
        append(&mut still, &scene, 0, scene.len());
    }
    Ok(still)
}

/// Reads a SOG scene in a subfolder of the index's folder.
fn scene(name: &str, beside: &Beside, limits: &Limits) -> Result<Still, FormatError> {
    let (bytes, own) = beside.inner(name, MAX_META)?;
    sog::within(&bytes, &own, limits).map_err(|e| FormatError::new(format!("{name}: {}", e.part), e.expected, e.found))
}

/// Appends a range of a scene's Gaussians. The lower degree of the two is raised with coefficients of 0.
fn append(still: &mut Still, scene: &Still, offset: usize, count: usize) {
    if still.degree < scene.degree {
        let (own, all) = (3 * still.rest(), 3 * scene.rest());
        let mut wider = vec![0.0; still.len() * all];
        for i in 0..still.len() {
            wider[i * all..][..own].copy_from_slice(&still.higher[i * own..][..own]);
        }
        (still.degree, still.higher) = (scene.degree, wider);
    }
    let range = offset..offset + count;
    still.mean.extend_from_slice(&scene.mean[range.clone()]);
    still.log_scale.extend_from_slice(&scene.log_scale[range.clone()]);
    still.rotation.extend_from_slice(&scene.rotation[range.clone()]);
    still.logit.extend_from_slice(&scene.logit[range.clone()]);
    still.base.extend_from_slice(&scene.base[range]);
    let (own, all) = (3 * scene.rest(), 3 * rest(still.degree));
    for i in offset..offset + count {
        still.higher.extend_from_slice(&scene.higher[i * own..][..own]);
        still.higher.extend(std::iter::repeat_n(0.0, all - own));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INDEX_OF_TWO: &str = r#"{"version": 1, "lodLevels": 2, "count": 9, "counts": [6, 3], "filenames": ["0_0/meta.json", "1_0/meta.json"],
        "tree": {"children": [{"lods": {"0": {"file": 0, "offset": 2, "count": 4}, "1": {"file": 1, "offset": 0, "count": 3}}},
            {"children": [{"lods": {"0": {"file": 0, "offset": 0, "count": 2}}}]}]}}"#;

    fn read(text: &str, level: usize) -> Result<Plan, FormatError> {
        plan(text.as_bytes(), &Limits { gaussians: 100, ..Limits::default() }, level)
    }

    #[test]
    fn a_level_is_the_union_of_its_ranges() {
        let first = read(INDEX_OF_TWO, 0).expect("a level");
        assert_eq!(first.files, [("0_0/meta.json".to_owned(), vec![[0, 2], [2, 4]])]);
        let second = read(INDEX_OF_TWO, 1).expect("a level");
        assert_eq!((second.files.len(), second.count), (1, 3));
    }

    #[test]
    fn an_index_that_says_something_impossible_is_refused() {
        for (from, to, level, expected) in [
            ("", "", 2, "lod-meta.json: lodLevels: expected more than 2, the level that is asked for (--lod), found 2"),
            (r#""version": 1"#, r#""version": 2"#, 0, "lod-meta.json: version: expected 1, found 2"),
            ("[6, 3]", "[7, 3]", 0, "lod-meta.json: counts of level 0: expected 6 as the tree says, found 7"),
            (r#""file": 1"#, r#""file": 2"#, 1, "lod-meta.json: file: expected one of 2 filenames, found 2"),
            (r#""count": 4"#, r#""count": 400"#, 0, "lod-meta.json: level 0: expected at most 100 Gaussians"),
            (
                r#""count": 4"#,
                r#""count": -4"#,
                0,
                "lod-meta.json: expected a streamed SOG scene's, found invalid value",
            ),
            (r#""tree""#, r#""trees""#, 0, "lod-meta.json: expected a streamed SOG scene's, found missing field"),
        ] {
            let error = read(&INDEX_OF_TWO.replace(from, to), level).expect_err("impossible").to_string();
            assert!(error.starts_with(expected), "{error}");
        }
        let deep = format!("{}{}", r#"{"children": ["#.repeat(120), "]}".repeat(120));
        let text = format!(r#"{{"lodLevels": 1, "filenames": [], "tree": {deep}}}"#);
        assert!(read(&text, 0).is_err());
    }
}
