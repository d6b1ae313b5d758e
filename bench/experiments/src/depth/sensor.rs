//! `depth --sensor`: depth found by parallax compared with a sensor's.
//!
//! For every key frame of a clip it prints Spearman's rank correlation of the engine's inverse depth with the sensor's.
//! Pixels are those that the sensor measured, at the size of the model's input.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::Serialize;
use streamsplat::depth::{DepthMaps, Range, Values};
use streamsplat::{Engine, Frame, Settings, source};
use streamsplat_kernels::Level;

use super::registration::Registration;

/// Rank correlations of a clip.
#[derive(Serialize)]
pub(super) struct Row {
    clip: String,
    gap: usize,
    key_frames: usize,
    found: usize,
    correlations: Vec<f64>,
}

/// The clip in `folder`, which has the folders `rgb` and `depth` (millimetres, 0: not measured).
pub(super) fn clip(settings: &Settings, folder: &Path, registration: Option<&Registration>, gap: usize) -> Result<Row> {
    let settings = Settings { find_depth: Some(true), ..settings.clone() };
    let mut source = source::Source::open(&folder.join("rgb"), &source::Options::default())?;
    let maps = DepthMaps::open_as(&folder.join("depth"), source.files(), Range::Frame, Values::Depth)?;
    let mut engine = Engine::new(settings)?;
    let (mut key_frames, mut correlations) = (0, Vec::new());
    let mut index = 0;
    let mut between = Vec::new();
    while let Some(next) = source.next_frame()? {
        let picture = next.picture;
        let [height, width] = [picture.height, picture.width];
        let frame = Frame { width, height, rgb: picture.rgb.clone(), depth: None };
        if index % gap == 0 {
            let interval = engine.push_with(std::mem::take(&mut between), frame, next.timestamp)?;
            let placement = interval.placement;
            key_frames += usize::from(index > 0);
            let found = engine.resume_point().and_then(|point| point.found);
            if let Some(found) = found {
                let level = Level::detect();
                let [rows, columns] = placement.model;
                let map = found.map(level, &placement.fit_in(level, &picture.rgb), [rows, columns]);
                let sensor = maps.map(index, width, height)?;
                let sensor = registration.map_or_else(|| sensor.clone(), |r| r.apply(&sensor, [height, width]));
                // The pixel in the middle of each of the model's.
                let at = |i: usize, side: usize, of: usize| (2 * i + 1) * of / (2 * side);
                let pairs: Vec<(f32, f32)> = (0..rows * columns)
                    .map(|i| (map[i], sensor[at(i / columns, rows, height) * width + at(i % columns, columns, width)]))
                    .filter(|(_, depth)| depth.is_finite())
                    .collect();
                correlations.push(rank_correlation(&pairs).context("too few pixels that the sensor measured")?);
            }
        } else {
            between.push((frame, next.timestamp));
        }
        index += 1;
    }
    ensure!(key_frames > 0, "{}: expected more than {gap} frames, found {index}", folder.display());
    let clip = folder.file_name().unwrap_or(folder.as_os_str()).to_string_lossy().into_owned();
    Ok(Row { clip, gap, key_frames, found: correlations.len(), correlations })
}

impl Row {
    pub(super) fn line(&self) -> String {
        let mut sorted = self.correlations.clone();
        sorted.sort_by(f64::total_cmp);
        let part = |share: usize| sorted.get((sorted.len().saturating_sub(1)) * share / 4).copied().unwrap_or(f64::NAN);
        let each: Vec<String> = self.correlations.iter().map(|r| format!("{r:.2}")).collect();
        format!(
            "{:20} {:>3} {:>5}/{:<5} {:>6.2} {:>6.2} {:>6.2} {:>6.2} {:>6.2}   {}",
            self.clip,
            self.gap,
            self.found,
            self.key_frames,
            part(2),
            part(0),
            part(1),
            part(3),
            part(4),
            each.join(" ")
        )
    }

    pub(super) fn head() -> String {
        format!(
            "{:20} {:>3} {:>11} {:>6} {:>6} {:>6} {:>6} {:>6}   {}",
            "clip", "gap", "found", "median", "least", "¼", "¾", "most", "rank correlation of each key frame"
        )
    }
}

/// Spearman's rank correlation; `None` where all values of one side are equal.
fn rank_correlation(pairs: &[(f32, f32)]) -> Option<f64> {
    let [a, b] = [ranks(pairs.iter().map(|pair| pair.0).collect()), ranks(pairs.iter().map(|pair| pair.1).collect())];
    let middle = (pairs.len() as f64 - 1.0) * 0.5;
    let (mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(&b) {
        let (a, b) = (a - middle, b - middle);
        aa += a * a;
        bb += b * b;
        ab += a * b;
    }
    (aa > 0.0 && bb > 0.0).then(|| ab / (aa * bb).sqrt())
}

/// The rank of each value, the mean of them for equal ones.
fn ranks(values: Vec<f32>) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut ranks = vec![0.0; values.len()];
    let mut start = 0;
    while start < order.len() {
        let value = values[order[start]];
        let end = start + order[start..].iter().take_while(|i| values[**i] == value).count().max(1);
        for at in &order[start..end] {
            ranks[*at] = 0.5 * (start + end - 1) as f64;
        }
        start = end;
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_agree_whatever_the_scale_and_equal_values_share_theirs() {
        let rising: Vec<(f32, f32)> = (0..50).map(|i| (i as f32, (i * i * i) as f32)).collect();
        assert!((rank_correlation(&rising).expect("spread") - 1.0).abs() < 1e-12);
        let falling: Vec<(f32, f32)> = rising.iter().map(|(a, b)| (*a, -b)).collect();
        assert!((rank_correlation(&falling).expect("spread") + 1.0).abs() < 1e-12);
        assert_eq!(rank_correlation(&[(1.0, 2.0), (1.0, 3.0)]), None);
        assert_eq!(ranks(vec![5.0, 1.0, 5.0]), [1.5, 0.0, 1.5]);
    }
}
