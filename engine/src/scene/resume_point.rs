//! A stream's resume point as safetensors, so that a stopped stream can continue.
//!
//! The survivors are the records of an interval. In addition:
//!
//! | tensor | shape | what |
//! |---|---|---|
//! | `current_cell` | U32 `[M]` | indices of the last key frame's own Gaussians in its arrays |
//! | `current_identity`, `current_birth` | U64 `[M]` | those of the same Gaussians |
//! | `current_offset` | F32 `[M,3]` | those of the same Gaussians |
//! | `key_frame`, `next_identity` | U64 `[1]` | the key frame; the first unused identity |
//! | `depth` | F32 `[2]` | factor and offset of the key frame's depth map, where there is one |
//! | `found_inverse`, `found_confidence` | F32 `[R,C]` | depth found by parallax for the key frame's cells, if any |
//! | `found_body` | F32 `[R,C]` | 1 where a body moves by itself, less for each key frame since |
//! | `found_nearest` | F32 `[1]` | inverse depth that counts as nearest |
//! | `track_u`, `track_v`, `track_astray` | F32 `[K,C]` | where the key frame's cells were in the `K` key frames before, if depth is searched by parallax |
//! | `covered_cell` | U32 `[C]` | cells of the key frame whose foreground hides surfaces that earlier frames saw, if any |
//! | `covered_at`, `covered_rgb` | F32 `[C,2]`, `[C,3]` | the surface's place in pixels and its colour |
//! | `kept_rgb` | F32 `[P]` | the key frame's picture, where it keeps Gaussians of those before |
//! | `kept_count`, `kept_fitted` | U32 `[B]` | frames in the mean of each block; frames in it when colours were last fitted |
//! | `kept_anchor` | F32 `[A]` | means over cells of blocks at that fit |
//! | `kept_position`, `kept_scale`, `kept_thickness`, `kept_opacity`, `kept_colour` | F32 `[N,3]`, `[N,2]`, `[N]`, `[N]`, `[N,3]` | its Gaussians |
//! | `kept_details` | U64 `[1]` | number of them, at the end, that are details |
//! | `seconds` | F64 `[2]` | the key frame's time, the length of the interval before it |

use std::collections::HashMap;

use safetensors::SafeTensors;
use safetensors::tensor::Dtype;

use super::records::{self, Tensor, from_tensor, rows, shaped, tensor, to_tensor};
use crate::parallax::{Found, Track, Window};
use streamsplat_model::StaticGaussians;
use streamsplat_model::columns::{Numbers, Source, Value};

use crate::stream::{Covered, Current, KeptState, Past, ResumePoint};

/// The key under which the note is stored.
const NOTE: &str = "note";

/// Converts a resume point (if there is one) and a note in words to a safetensors file.
///
/// # Errors
/// None for points that an engine returned.
pub fn resume_point_to_safetensors(point: Option<&ResumePoint>, note: &str) -> Result<Vec<u8>, String> {
    let mut tensors = Vec::new();
    // Numbers of which Gaussians have none.
    let counts = |name: &'static str, counts: &[u32]| {
        (name.into(), Dtype::U32, vec![counts.len()], counts.iter().flat_map(|n| n.to_le_bytes()).collect())
    };
    if let Some(point) = point {
        let current = &point.current;
        let seconds = [point.timestamp, point.length].iter().flat_map(|v| v.to_le_bytes()).collect();
        tensors = records::write(&point.survivors.iter().copied().collect())?;
        tensors.extend([
            counts("current_cell", &list(current, |c| c.cell)),
            to_tensor("current_identity", &list(current, |c| c.identity)),
            to_tensor("current_birth", &list(current, |c| c.birth)),
            to_tensor("current_offset", &list(current, |c| c.offset)),
            to_tensor("key_frame", &[point.frame]),
            to_tensor("next_identity", &[point.next_identity]),
            ("seconds".into(), Dtype::F64, vec![2], seconds),
        ]);
        if let Some(depth) = &point.depth {
            tensors.push(to_tensor("depth", depth));
        }
        if !point.covered.is_empty() {
            tensors.extend([
                counts("covered_cell", &list(&point.covered, |c| c.cell)),
                to_tensor("covered_at", &list(&point.covered, |c| c.at)),
                to_tensor("covered_rgb", &list(&point.covered, |c| c.rgb)),
            ]);
        }
    }
    if let Some(KeptState { rgb, past, gaussians: g, details }) = point.and_then(|point| point.kept.as_deref()) {
        tensors.extend([
            to_tensor("kept_rgb", rgb),
            counts("kept_count", &past.count),
            counts("kept_fitted", &past.fitted),
            to_tensor("kept_anchor", &past.anchor),
            to_tensor("kept_details", &[*details as u64]),
        ]);
        tensors.extend(g.columns().iter().map(|column| rows(kept_name(column.name), column.width, &column.numbers)));
    }
    if let Some(found) = point.and_then(|point| point.found.as_ref()) {
        tensors.extend([
            plane("found_inverse", found.grid, &found.inverse),
            plane("found_confidence", found.grid, &found.confidence),
            plane("found_body", found.grid, &found.body),
            to_tensor("found_nearest", &[found.nearest]),
        ]);
    }
    if let Some((tracks, cells)) = point.and_then(|p| Some((&p.window.tracks, p.window.tracks.first()?.u.len()))) {
        let all = |of: fn(&Track) -> &[f32]| tracks.iter().flat_map(of).copied().collect::<Vec<_>>();
        tensors.extend([
            plane("track_u", [tracks.len(), cells], &all(|track| &track.u)),
            plane("track_v", [tracks.len(), cells], &all(|track| &track.v)),
            plane("track_astray", [tracks.len(), cells], &all(|track| &track.astray)),
        ]);
    }
    records::serialize(&tensors, Some(HashMap::from([(NOTE.to_owned(), note.to_owned())])))
}

/// A tensor of rows and columns.
fn plane(name: &'static str, shape: [usize; 2], values: &[f32]) -> Tensor {
    (name.into(), Dtype::F32, shape.to_vec(), Numbers::Floats(values).to_bytes())
}

/// One value of each of `all`.
fn list<T, V>(all: &[T], of: fn(&T) -> V) -> Vec<V> {
    all.iter().map(of).collect()
}

/// The tensor of a property of the kept Gaussians.
fn kept_name(property: &str) -> String {
    format!("kept_{}", if property == "rgb" { "colour" } else { property })
}

/// Reads the resume point and the note from such a file.
///
/// # Errors
/// Expected and found values.
pub fn resume_point_from_safetensors(bytes: &[u8]) -> Result<(Option<ResumePoint>, String), String> {
    let unreadable = |e| format!("not a readable safetensors file: {e}");
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(unreadable)?;
    let note = header.metadata().as_ref().and_then(|m| m.get(NOTE)).cloned();
    let note = note.ok_or_else(|| format!("expected metadata {NOTE:?}, found none"))?;
    let file = SafeTensors::deserialize(bytes).map_err(unreadable)?;
    if file.is_empty() {
        return Ok((None, note));
    }
    let survivors = records::read(&file)?.iter().collect();
    let cells = counts(&file, "current_cell")?;
    let m = Some(cells.len());
    let (identities, births) = (from_tensor(&file, "current_identity", m)?, from_tensor(&file, "current_birth", m)?);
    let offsets = from_tensor(&file, "current_offset", m)?;
    let current = (cells.into_iter().zip(identities).zip(births.into_iter().zip(offsets)))
        .map(|((cell, identity), (birth, offset))| Current { cell, identity, birth, offset })
        .collect();
    let covered = match file.tensor("covered_cell") {
        Err(_) => Vec::new(),
        Ok(_) => {
            let cells = counts(&file, "covered_cell")?;
            let c = Some(cells.len());
            let places = from_tensor(&file, "covered_at", c)?;
            let colours = from_tensor(&file, "covered_rgb", c)?;
            let all = cells.into_iter().zip(places).zip(colours);
            all.map(|((cell, at), rgb)| Covered { cell, at, rgb }).collect()
        }
    };
    let word = |name: &str| Ok::<u64, String>(from_tensor(&file, name, Some(1))?[0]);
    let seconds = tensor(&file, "seconds", Dtype::F64, &[Some(2)])?.as_chunks::<8>().0;
    let depth = match file.names().contains(&"depth") {
        true => shaped(&file, "depth", &[Some(2)])?.first().copied(),
        false => None,
    };
    let found = match file.tensor("found_inverse") {
        Err(_) => None,
        Ok(view) => {
            let &[rows, columns] = view.shape() else {
                return Err(format!("found_inverse: expected rows and columns, found shape {:?}", view.shape()));
            };
            let plane = |name: &str| shaped(&file, name, &[Some(rows), Some(columns)]);
            Some(Found {
                grid: [rows, columns],
                inverse: plane("found_inverse")?,
                confidence: plane("found_confidence")?,
                body: plane("found_body")?,
                nearest: from_tensor(&file, "found_nearest", Some(1))?[0],
            })
        }
    };
    let point = ResumePoint {
        frame: word("key_frame")?,
        timestamp: f64::from_le_bytes(seconds[0]),
        length: f64::from_le_bytes(seconds[1]),
        survivors,
        current,
        next_identity: word("next_identity")?,
        depth,
        found,
        window: window(&file)?,
        covered,
        kept: kept(&file)?.map(Box::new),
    };
    Ok((Some(point), note))
}

/// Reads the tracks to earlier key frames.
fn window(file: &SafeTensors<'_>) -> Result<Window, String> {
    let Ok(view) = file.tensor("track_u") else { return Ok(Window::default()) };
    let &[tracks, cells] = view.shape() else {
        return Err(format!("track_u: expected tracks and cells, found shape {:?}", view.shape()));
    };
    let planes = |name: &str| {
        let values: Vec<f32> = shaped(file, name, &[Some(tracks), Some(cells)])?;
        Ok::<Vec<Vec<f32>>, String>(values.chunks(cells.max(1)).map(<[f32]>::to_vec).collect())
    };
    let all = planes("track_u")?.into_iter().zip(planes("track_v")?).zip(planes("track_astray")?);
    Ok(Window { tracks: all.map(|((u, v), astray)| Track { u, v, astray }).collect() })
}

/// State that a key frame keeps from earlier ones.
fn kept(file: &SafeTensors<'_>) -> Result<Option<KeptState>, String> {
    if file.tensor("kept_rgb").is_err() {
        return Ok(None);
    }
    let past = Past {
        count: counts(file, "kept_count")?,
        fitted: counts(file, "kept_fitted")?,
        anchor: from_tensor(file, "kept_anchor", None)?,
    };
    let gaussians = StaticGaussians::read(&mut Kept { file, count: None })?;
    let details: Vec<u64> = from_tensor(file, "kept_details", Some(1))?;
    let details = usize::try_from(details[0]).unwrap_or(usize::MAX);
    Ok(Some(KeptState { rgb: from_tensor(file, "kept_rgb", None)?, past, gaussians, details }))
}

/// The properties of kept Gaussians, all of which a file has, and the number of their values.
struct Kept<'a> {
    file: &'a SafeTensors<'a>,
    count: Option<usize>,
}

impl Source for Kept<'_> {
    type Error = String;

    fn values<T: Value>(&mut self, name: &'static str, _: Option<T>) -> Result<Vec<T>, String> {
        let values = from_tensor(self.file, &kept_name(name), self.count)?;
        self.count = Some(values.len());
        Ok(values)
    }
}

/// The counts of tensor `name`.
fn counts(file: &SafeTensors<'_>, name: &str) -> Result<Vec<u32>, String> {
    let bytes = tensor(file, name, Dtype::U32, &[None])?.as_chunks().0;
    Ok(bytes.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect())
}
