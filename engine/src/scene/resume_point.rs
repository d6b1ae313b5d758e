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
//! | `seconds` | F64 `[2]` | the key frame's time, the length of the interval before it |

use std::collections::HashMap;

use safetensors::SafeTensors;
use safetensors::tensor::Dtype;

use super::records::{self, float_bytes, floats, tensor, word_bytes, words};
use crate::parallax::{Found, Track, Window};
use streamsplat_model::StaticGaussians;

use crate::stream::{Covered, Current, KeptState, Past, ResumePoint};

/// The key under which the note is stored.
const NOTE: &str = "note";

/// Converts a resume point (if there is one) and a note in words to a safetensors file.
///
/// # Errors
/// None for points that an engine returned.
pub fn resume_point_to_safetensors(point: Option<&ResumePoint>, note: &str) -> Result<Vec<u8>, String> {
    let mut tensors = Vec::new();
    if let Some(point) = point {
        let m = point.current.len();
        let cells = point.current.iter().flat_map(|c| c.cell.to_le_bytes()).collect();
        let of = |word: fn(&Current) -> u64| word_bytes(&point.current.iter().map(word).collect::<Vec<_>>());
        let offsets: Vec<f32> = point.current.iter().flat_map(|c| c.offset).collect();
        let seconds = [point.timestamp, point.length].iter().flat_map(|v| v.to_le_bytes()).collect();
        tensors = records::write(&point.survivors.iter().copied().collect())?;
        tensors.extend([
            ("current_cell", Dtype::U32, vec![m], cells),
            ("current_identity", Dtype::U64, vec![m], of(|c| c.identity)),
            ("current_birth", Dtype::U64, vec![m], of(|c| c.birth)),
            ("current_offset", Dtype::F32, vec![m, 3], float_bytes(&offsets)),
            ("key_frame", Dtype::U64, vec![1], word_bytes(&[point.frame])),
            ("next_identity", Dtype::U64, vec![1], word_bytes(&[point.next_identity])),
            ("seconds", Dtype::F64, vec![2], seconds),
        ]);
        if let Some(depth) = &point.depth {
            tensors.push(("depth", Dtype::F32, vec![2], float_bytes(depth)));
        }
        if !point.covered.is_empty() {
            let c = point.covered.len();
            let cells = point.covered.iter().flat_map(|c| c.cell.to_le_bytes()).collect();
            let places: Vec<f32> = point.covered.iter().flat_map(|c| c.at).collect();
            let colours: Vec<f32> = point.covered.iter().flat_map(|c| c.rgb).collect();
            tensors.extend([
                ("covered_cell", Dtype::U32, vec![c], cells),
                ("covered_at", Dtype::F32, vec![c, 2], float_bytes(&places)),
                ("covered_rgb", Dtype::F32, vec![c, 3], float_bytes(&colours)),
            ]);
        }
    }
    if let Some(KeptState { rgb, past, gaussians: g }) = point.and_then(|point| point.kept.as_deref()) {
        let n = g.position.len();
        let number = |numbers: &[u32]| numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
        tensors.extend([
            ("kept_rgb", Dtype::F32, vec![rgb.len()], float_bytes(rgb)),
            ("kept_count", Dtype::U32, vec![past.count.len()], number(&past.count)),
            ("kept_fitted", Dtype::U32, vec![past.fitted.len()], number(&past.fitted)),
            ("kept_anchor", Dtype::F32, vec![past.anchor.len()], float_bytes(&past.anchor)),
            ("kept_position", Dtype::F32, vec![n, 3], float_bytes(g.position.as_flattened())),
            ("kept_scale", Dtype::F32, vec![n, 2], float_bytes(g.scale.as_flattened())),
            ("kept_thickness", Dtype::F32, vec![n], float_bytes(&g.thickness)),
            ("kept_opacity", Dtype::F32, vec![n], float_bytes(&g.opacity)),
            ("kept_colour", Dtype::F32, vec![n, 3], float_bytes(g.rgb.as_flattened())),
        ]);
    }
    if let Some(found) = point.and_then(|point| point.found.as_ref()) {
        let shape = found.grid.to_vec();
        tensors.extend([
            ("found_inverse", Dtype::F32, shape.clone(), float_bytes(&found.inverse)),
            ("found_confidence", Dtype::F32, shape.clone(), float_bytes(&found.confidence)),
            ("found_body", Dtype::F32, shape, float_bytes(&found.body)),
            ("found_nearest", Dtype::F32, vec![1], float_bytes(&[found.nearest])),
        ]);
    }
    if let Some((tracks, cells)) = point.and_then(|p| Some((&p.window.tracks, p.window.tracks.first()?.u.len()))) {
        let shape = vec![tracks.len(), cells];
        let plane = |of: fn(&Track) -> &[f32]| tracks.iter().flat_map(|track| float_bytes(of(track))).collect();
        tensors.extend([
            ("track_u", Dtype::F32, shape.clone(), plane(|track| &track.u)),
            ("track_v", Dtype::F32, shape.clone(), plane(|track| &track.v)),
            ("track_astray", Dtype::F32, shape, plane(|track| &track.astray)),
        ]);
    }
    records::serialize(&tensors, Some(HashMap::from([(NOTE.to_owned(), note.to_owned())])))
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
    let cells = tensor(&file, "current_cell", Dtype::U32, &[None])?;
    let m = Some(cells.len() / 4);
    let list = |name: &str| Ok::<_, String>(words::<1>(tensor(&file, name, Dtype::U64, &[m])?));
    let (identities, births) = (list("current_identity")?, list("current_birth")?);
    let offsets = floats::<3>(tensor(&file, "current_offset", Dtype::F32, &[m, Some(3)])?);
    let cells = cells.as_chunks::<4>().0.iter().map(|b| u32::from_le_bytes(*b));
    let current = cells
        .zip(identities)
        .zip(births.into_iter().zip(offsets))
        .map(|((cell, [identity]), ([birth], offset))| Current { cell, identity, birth, offset })
        .collect();
    let covered = match file.tensor("covered_cell") {
        Err(_) => Vec::new(),
        Ok(_) => {
            let cells = tensor(&file, "covered_cell", Dtype::U32, &[None])?.as_chunks::<4>().0;
            let c = Some(cells.len());
            let places = floats::<2>(tensor(&file, "covered_at", Dtype::F32, &[c, Some(2)])?);
            let colours = floats::<3>(tensor(&file, "covered_rgb", Dtype::F32, &[c, Some(3)])?);
            let all = cells.iter().zip(places).zip(colours);
            all.map(|((cell, at), rgb)| Covered { cell: u32::from_le_bytes(*cell), at, rgb }).collect()
        }
    };
    let word = |name: &str| Ok::<u64, String>(words::<1>(tensor(&file, name, Dtype::U64, &[Some(1)])?)[0][0]);
    let seconds = tensor(&file, "seconds", Dtype::F64, &[Some(2)])?.as_chunks::<8>().0;
    let depth = match file.names().contains(&"depth") {
        true => floats::<2>(tensor(&file, "depth", Dtype::F32, &[Some(2)])?).into_iter().next(),
        false => None,
    };
    let found = match file.tensor("found_inverse") {
        Err(_) => None,
        Ok(view) => {
            let &[rows, columns] = view.shape() else {
                return Err(format!("found_inverse: expected rows and columns, found shape {:?}", view.shape()));
            };
            let shape = [Some(rows), Some(columns)];
            let plane = |name: &str| {
                let values = floats::<1>(tensor(&file, name, Dtype::F32, &shape)?);
                Ok::<Vec<f32>, String>(values.into_iter().flatten().collect())
            };
            let nearest = floats::<1>(tensor(&file, "found_nearest", Dtype::F32, &[Some(1)])?);
            Some(Found {
                grid: [rows, columns],
                inverse: plane("found_inverse")?,
                confidence: plane("found_confidence")?,
                body: plane("found_body")?,
                nearest: nearest[0][0],
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
        let values = floats::<1>(tensor(file, name, Dtype::F32, &[Some(tracks), Some(cells)])?);
        Ok::<Vec<Vec<f32>>, String>(values.chunks(cells.max(1)).map(|plane| plane.as_flattened().to_vec()).collect())
    };
    let all = planes("track_u")?.into_iter().zip(planes("track_v")?).zip(planes("track_astray")?);
    Ok(Window { tracks: all.map(|((u, v), astray)| Track { u, v, astray }).collect() })
}

/// State that a key frame keeps from earlier ones.
fn kept(file: &SafeTensors<'_>) -> Result<Option<KeptState>, String> {
    if file.tensor("kept_rgb").is_err() {
        return Ok(None);
    }
    let list = |name: &str, length: Option<usize>| {
        let values = floats::<1>(tensor(file, name, Dtype::F32, &[length])?);
        Ok::<Vec<f32>, String>(values.into_iter().flatten().collect())
    };
    let numbers = |name: &str| {
        let bytes = tensor(file, name, Dtype::U32, &[None])?.as_chunks::<4>().0;
        Ok::<Vec<u32>, String>(bytes.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect())
    };
    let past =
        Past { count: numbers("kept_count")?, fitted: numbers("kept_fitted")?, anchor: list("kept_anchor", None)? };
    let position = floats::<3>(tensor(file, "kept_position", Dtype::F32, &[None, Some(3)])?);
    let n = Some(position.len());
    let gaussians = StaticGaussians {
        scale: floats::<2>(tensor(file, "kept_scale", Dtype::F32, &[n, Some(2)])?),
        thickness: list("kept_thickness", n)?,
        opacity: list("kept_opacity", n)?,
        rgb: floats::<3>(tensor(file, "kept_colour", Dtype::F32, &[n, Some(3)])?),
        position,
    };
    Ok(Some(KeptState { rgb: list("kept_rgb", None)?, past, gaussians }))
}
