//! `depth --order`: which of two places is nearer, in clips without a sensor, compared with a person's answers.
//!
//! Each answer names a place and one that is farther away, in a key frame. Found depth is right if it makes the first
//! nearer by at least [`CLEARLY`], and wrong if it makes it farther by as much. Otherwise, and without depth, it is
//! open.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use streamsplat::{Engine, Frame, Settings, source};
use streamsplat_kernels::Level;

/// Ratio of inverse depths from which on one place is clearly nearer.
const CLEARLY: f32 = 1.05;
/// Pixels on each side of a place whose median is taken.
const AROUND: usize = 2;

/// A person's answers.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Answers {
    #[serde(rename = "about")]
    _about: String,
    /// The frame, counted from 0.
    frame: usize,
    /// Per clip: column and row of the nearer place and of the farther one, in fractions of the picture.
    clips: BTreeMap<String, Vec<[f32; 4]>>,
}

/// Answers of a clip that found depth agrees with.
#[derive(Default, Serialize)]
pub(super) struct Row {
    clip: String,
    right: usize,
    wrong: usize,
    open: usize,
}

impl Answers {
    pub(super) fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
        serde_json::from_str(&text).with_context(|| path.display().to_string())
    }

    /// Compares the clips of these names in `folders`. The last row is their sum.
    pub(super) fn compare(&self, settings: &Settings, folders: &[PathBuf], gap: usize) -> Result<Vec<Row>> {
        ensure!(self.frame.is_multiple_of(gap), "expected a gap that divides frame {}, found {gap}", self.frame);
        let mut rows = Vec::new();
        for (clip, pairs) in &self.clips {
            let folder = folders.iter().map(|folder| folder.join(clip)).find(|folder| folder.is_dir());
            let folder = folder.with_context(|| format!("found no folder {clip}"))?;
            let found = inverse_depth(settings, &folder, gap, self.frame)?;
            let mut row = Row { clip: clip.clone(), ..Row::default() };
            for &[x, y, u, v] in pairs {
                let ratio = found.as_ref().map_or(1.0, |found| found.at(x, y) / found.at(u, v));
                let count = match ratio {
                    ratio if ratio >= CLEARLY => &mut row.right,
                    ratio if ratio <= 1.0 / CLEARLY => &mut row.wrong,
                    _ => &mut row.open,
                };
                *count += 1;
            }
            rows.push(row);
        }
        let sum = |of: fn(&Row) -> usize| rows.iter().map(of).sum();
        let all = Row { clip: "all".into(), right: sum(|r| r.right), wrong: sum(|r| r.wrong), open: sum(|r| r.open) };
        rows.push(all);
        Ok(rows)
    }
}

impl Row {
    pub(super) fn head() -> String {
        format!("{:28} {:>6} {:>6} {:>6}", "clip", "right", "wrong", "open")
    }

    pub(super) fn line(&self) -> String {
        format!("{:28} {:>6} {:>6} {:>6}", self.clip, self.right, self.wrong, self.open)
    }
}

/// Inverse depth up to a factor, `[rows, columns]`.
struct Map {
    values: Vec<f32>,
    size: [usize; 2],
}

impl Map {
    /// The median around a place.
    fn at(&self, x: f32, y: f32) -> f32 {
        let [rows, columns] = self.size;
        let near = |part: f32, side: usize| {
            let middle = (part * side as f32) as usize;
            middle.saturating_sub(AROUND)..(middle + AROUND + 1).min(side)
        };
        let mut values: Vec<f32> = near(y, rows)
            .flat_map(|row| near(x, columns).map(move |column| row * columns + column))
            .map(|at| self.values[at])
            .collect();
        values.sort_by(f32::total_cmp);
        values[values.len() / 2]
    }
}

/// The inverse depth found at frame `at` of a clip; `None` where none was.
fn inverse_depth(settings: &Settings, folder: &Path, gap: usize, at: usize) -> Result<Option<Map>> {
    let settings = Settings { find_depth: Some(true), ..settings.clone() };
    let mut source = source::Source::open(folder, &source::Options::default())?;
    let mut engine = Engine::new(settings)?;
    let mut between = Vec::new();
    for index in 0_usize.. {
        let next = source.next_frame()?;
        let next = next.with_context(|| format!("{}: expected a frame {at}, found {index}", folder.display()))?;
        let picture = next.picture;
        let [height, width] = [picture.height, picture.width];
        let frame = Frame { width, height, rgb: picture.rgb.clone(), depth: None };
        if !index.is_multiple_of(gap) {
            between.push((frame, next.timestamp));
            continue;
        }
        let interval = engine.push_with(std::mem::take(&mut between), frame, next.timestamp)?;
        if index == at {
            let size = interval.placement.model;
            let level = Level::detect();
            let found = engine.resume_point().and_then(|point| point.found);
            return Ok(found.map(|found| {
                let map = found.map(level, &interval.placement.fit_in(level, &picture.rgb), size);
                // The map's values are linear in inverse depth, which is 0 at −0.2/9.8.
                Map { values: map.into_iter().map(|y| 9.8f32.mul_add(y, 0.2)).collect(), size }
            }));
        }
    }
    Ok(None)
}
