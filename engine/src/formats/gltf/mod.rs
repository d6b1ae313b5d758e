//! glTF 2.0 with Gaussians: `.glb` and `.gltf` files, extension `KHR_gaussian_splatting`.
//!
//! Reads every point primitive with the extension in the default scene, with the transforms of its nodes. If a file has
//! no scene, all meshes are read.
//!
//! | attribute | type | value |
//! |---|---|---|
//! | `POSITION` | VEC3 | centre |
//! | `KHR_gaussian_splatting:ROTATION` | VEC4 | quaternion, w last |
//! | `KHR_gaussian_splatting:SCALE` | VEC3 | standard deviations |
//! | `KHR_gaussian_splatting:OPACITY` | SCALAR | from 0 to 1 |
//! | `KHR_gaussian_splatting:SH_DEGREE_l_COEF_n` | VEC3 | coefficients of the harmonics, degrees 0 to 3 |
//!
//! Numbers have 8 or 16 bits, normalised or not, or are binary32. If degree 0 of the harmonics is missing, `COLOR_0`
//! replaces it, linear as in glTF. Colours of a `lin_rec709_display` primitive are converted to sRGB, Gaussian by
//! Gaussian (`colour.rs`). Unknown kernels are drawn as ellipses, as the extension requires. In a primitive with
//! `KHR_gaussian_splatting_compression_spz_2`, an SPZ file in a buffer view replaces the attributes. Its axes are those
//! of an SPZ file on its own ([`spz`]); the draft of that extension converts them to glTF's with the tools of SPZ.
//!
//! glTF's axes are x left, y up, z forward. The conversion to scene space negates x and y, a half turn about z.
//! Translations of nodes that binary32 would not keep to 1/4096 become the scene's offset. Buffers are in the file, in
//! `data:` URIs, or in files in its folder or subfolders.
//!
//! These are errors: other colour spaces, sparse accessors, nodes that shear or stretch, and negative scales (drafts of
//! the extension stored logarithms). So are other extensions that a file requires, except those of materials, textures,
//! lights and metadata, which have no effect on Gaussians.
//!
//! Source: Khronos, glTF 2.0 and `KHR_gaussian_splatting`.

mod accessor;
mod colour;
mod json;
#[cfg(test)]
mod tests;
mod write;

use std::path::Path;

use glam::{DMat4, DQuat, DVec3};
use streamsplat_kernels::harmonics::rest;
use streamsplat_kernels::math::f64::ln;

use super::{Beside, FormatError, Limits, spz};
use crate::camera::Rotation;
use crate::still::{About, Axes, LEAST, Similarity, Still};
use accessor::Buffers;
use json::{Document, Node, Primitive};
pub use write::write;

/// First bytes of a binary file.
pub(super) const MAGIC: [u8; 4] = *b"glTF";
const EXTENSION: &str = "KHR_gaussian_splatting";
const SPZ: &str = "KHR_gaussian_splatting_compression_spz_2";
/// Extensions that a file may require.
const KNOWN: [&str; 3] = [EXTENSION, SPZ, "KHR_mesh_quantization"];
/// Prefixes of extensions that have no effect on a scene of Gaussians.
const WITHOUT_EFFECT: [&str; 5] = ["KHR_materials_", "EXT_materials_", "KHR_texture_", "KHR_lights_", "KHR_xmp"];
/// Binary32 does not keep translations of this size or more to 1/4096.
const NEAR: f64 = 4096.0;
/// Maximum nesting of nodes.
const DEEPEST: usize = 64;

/// Reads the Gaussians of a whole binary file.
///
/// # Errors
/// Returns a [`FormatError`] with the name of the part and the expected and found values.
pub fn read(bytes: &[u8]) -> Result<Still, FormatError> {
    within(bytes, &Beside::none(), &Limits::default())
}

/// Returns true if a file with this name and these first bytes has the format.
pub(super) fn is(path: &Path, head: &[u8]) -> bool {
    let is_text = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("gltf"));
    head.starts_with(&MAGIC) || is_text && head.trim_ascii_start().starts_with(b"{")
}

/// Reads a file as [`read`] does, also `.gltf` text, with buffers read through `beside`.
pub(super) fn within(bytes: &[u8], beside: &Beside, limits: &Limits) -> Result<Still, FormatError> {
    let (text, binary) = if bytes.starts_with(&MAGIC) { chunks(bytes)? } else { (bytes, None) };
    let document: Document =
        serde_json::from_slice(text).map_err(|e| FormatError::new("JSON", "a glTF document", e.to_string()))?;
    if document.asset.version != "2.0" {
        return Err(FormatError::new("asset: version", "2.0", format!("{:?}", document.asset.version)));
    }
    let known = |name: &String| {
        KNOWN.contains(&name.as_str()) || WITHOUT_EFFECT.iter().any(|beginning| name.starts_with(beginning))
    };
    if let Some(other) = document.extensions_required.iter().find(|name| !known(name)) {
        return Err(FormatError::new("extensionsRequired", KNOWN.join(", "), format!("{other:?}")));
    }
    let buffers = Buffers::new(&document, binary, beside);
    let mut scene = Reading {
        document: &document,
        size: buffers.size(bytes.len() as u64),
        buffers,
        limits,
        axes: beside.axes,
        seen: vec![false; document.nodes.len()],
        instances: Vec::new(),
        offset: None,
        others: 0,
        morphed: false,
        still: Still { about: About { axes: Axes::LUF, ..About::default() }, ..Still::default() },
    };
    match document.scenes.get(document.scene.unwrap_or(0)) {
        Some(root) => {
            for &node in &root.nodes {
                scene.node(node, DMat4::IDENTITY, 0)?;
            }
        }
        None => scene.instances.extend((0..document.meshes.len()).map(|mesh| (mesh, DMat4::IDENTITY))),
    }
    scene.check()?;
    for (mesh, transform) in std::mem::take(&mut scene.instances) {
        scene.mesh(mesh, transform)?;
    }
    let (others, morphed) = (scene.others, scene.morphed);
    let mut still = scene.still;
    still.about.offset = scene.offset.unwrap_or_default();
    let notes = &mut still.about.notes;
    if others > 0 {
        notes.push(format!("primitives without Gaussians, such as meshes, are left out: {others}"));
    }
    let parts = [("animations", document.animations.is_empty()), ("skins", document.skins.is_empty())];
    let parts: Vec<&str> =
        parts.into_iter().chain([("morph targets", !morphed)]).filter(|part| !part.1).map(|part| part.0).collect();
    if !parts.is_empty() {
        notes.push(format!("the scene is read without its {}", parts.join(" and ")));
    }
    let unused: Vec<&str> = document.extensions_used.iter().filter(|name| !known(name)).map(String::as_str).collect();
    if !unused.is_empty() {
        notes.push(format!("extensions that are not read: {}", unused.join(", ")));
    }
    Ok(still)
}

/// Splits a `.glb` file into its text and its binary chunk.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), FormatError> {
    let word = |at: usize| bytes.get(at..at + 4).and_then(|b| b.first_chunk()).map(|b| u32::from_le_bytes(*b));
    let wrong = |part: &str, expected: String, found: String| Err(FormatError::new(part, expected, found));
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return wrong("header", "12 bytes".into(), bytes.len().to_string());
    };
    if version != 2 {
        return wrong("header: version", "2".into(), version.to_string());
    }
    if length as usize != bytes.len() {
        return wrong("header: length", format!("{} bytes", bytes.len()), length.to_string());
    }
    let mut parts = [None, None];
    let mut at = 12;
    while at < bytes.len() {
        let (Some(size), Some(kind)) = (word(at), word(at + 4)) else {
            return wrong("chunk", "8 bytes of header".into(), format!("{} bytes", bytes.len() - at));
        };
        let Some(chunk) = bytes[at + 8..].get(..size as usize) else {
            return wrong("chunk", format!("{size} bytes"), format!("{} bytes", bytes.len() - at - 8));
        };
        let place = [*b"JSON", *b"BIN\0"].iter().position(|name| u32::from_le_bytes(*name) == kind);
        if let Some(part) = place.map(|place| &mut parts[place]).filter(|part| part.is_none()) {
            *part = Some(chunk);
        }
        at += 8 + size as usize;
    }
    match parts {
        [Some(text), binary] => Ok((text, binary)),
        [None, _] => wrong("chunks", "one of JSON".into(), "none".into()),
    }
}

/// A scene being read.
struct Reading<'a> {
    document: &'a Document,
    buffers: Buffers<'a>,
    limits: &'a Limits,
    /// Total bytes of the file and its external buffers.
    size: u64,
    /// Nodes that were visited. Nodes form trees, so a second visit is an error.
    seen: Vec<bool>,
    /// Meshes of nodes, and their transforms.
    instances: Vec<(usize, DMat4)>,
    /// Axes of the numbers, where the user sets them.
    axes: Option<Axes>,
    /// Offset of the scene, in scene space: that of the first primitive.
    offset: Option<[f64; 3]>,
    still: Still,
    /// Number of primitives without Gaussians.
    others: usize,
    /// True if a primitive has targets of morphing.
    morphed: bool,
}

impl Reading<'_> {
    fn node(&mut self, index: usize, above: DMat4, depth: usize) -> Result<(), FormatError> {
        let document = self.document;
        let part = || format!("node {index}");
        let node = document.nodes.get(index);
        let node = node.ok_or_else(|| FormatError::new(part(), format!("{} nodes", document.nodes.len()), "none"))?;
        if depth > DEEPEST {
            return Err(FormatError::new(part(), format!("nodes nested {DEEPEST} deep at most"), "more"));
        }
        if std::mem::replace(&mut self.seen[index], true) {
            return Err(FormatError::new(part(), "one node above it", "two"));
        }
        let own = above * transform(node);
        if let Some(mesh) = node.mesh {
            self.instances.push((mesh, own));
        }
        node.children.iter().try_for_each(|&child| self.node(child, own, depth + 1))
    }

    /// Checks the Gaussians of all mesh instances against the limits for the file's size. Every instance counts
    /// separately. Primitives that cannot be read count as 0; reading them later returns the error.
    fn check(&mut self) -> Result<(), FormatError> {
        let (meshes, mut known) = (&self.document.meshes, vec![None; self.document.meshes.len()]);
        let (mut count, mut degree) = (0_usize, 0);
        for (index, _) in &self.instances {
            let Some(known) = known.get_mut(*index) else { continue };
            let (own, highest) = *known.get_or_insert_with(|| {
                let primitives = meshes[*index].primitives.iter();
                let gaussians = primitives.map(|primitive| gaussians(&mut self.buffers, primitive));
                gaussians.fold((0, 0), |(count, degree), own| (own.0.saturating_add(count), own.1.max(degree)))
            });
            (count, degree) = (own.saturating_add(count), highest.max(degree));
        }
        self.limits.check_still("meshes of all nodes", count, degree, self.size)
    }

    fn mesh(&mut self, index: usize, transform: DMat4) -> Result<(), FormatError> {
        let meshes = &self.document.meshes;
        let missing = || FormatError::new(format!("mesh {index}"), format!("{} meshes", meshes.len()), "none");
        for (i, primitive) in meshes.get(index).ok_or_else(missing)?.primitives.iter().enumerate() {
            let part = format!("mesh {index}, primitive {i}");
            self.others += usize::from(!primitive.extensions.contains_key(EXTENSION));
            if primitive.extensions.contains_key(EXTENSION) {
                let mut still = self.primitive(primitive, &part)?;
                let mut by = similarity(transform, &part)?;
                // Offset of an embedded SPZ file.
                let own = std::mem::take(&mut still.about.offset);
                let turned = by.rotation.matrix().map(|[a, b, c]| by.scale * (a * own[0] + b * own[1] + c * own[2]));
                let far: [f64; 3] = std::array::from_fn(|k| by.offset[k] + turned[k]);
                let is_far = far.iter().any(|x| x.abs() >= NEAR);
                let offset = *self.offset.get_or_insert(if is_far { far.map(f64::round) } else { [0.0; 3] });
                by.offset = std::array::from_fn(|k| far[k] - offset[k]);
                still.transform(&by);
                self.append(still)?;
            }
        }
        Ok(())
    }

    /// Reads the Gaussians of a primitive, in glTF's axes.
    fn primitive(&mut self, primitive: &Primitive, part: &str) -> Result<Still, FormatError> {
        let wrong = |name: &str, expected: &str, found: String| {
            Err(FormatError::new(format!("{part}: {name}"), expected, found))
        };
        if primitive.mode != Some(0) {
            return wrong("mode", "0 (points)", primitive.mode.map_or("none".into(), |mode| mode.to_string()));
        }
        if let Some(indices) = &primitive.indices {
            return wrong("indices", "none", indices.to_string());
        }
        self.morphed |= !primitive.targets.is_empty();
        let extension = &primitive.extensions[EXTENSION];
        let mut notes = Vec::new();
        for (name, usual) in [("kernel", "ellipse"), ("projection", "perspective")] {
            if let Some(other) = extension.get(name).filter(|other| *other != usual) {
                notes.push(format!("{part}: {name} {other} is not known: drawn as {usual}"));
            }
        }
        let linear = match extension.get("colorSpace").and_then(serde_json::Value::as_str) {
            None if extension.get("colorSpace").is_none() => false,
            Some("srgb_rec709_display") => false,
            Some("lin_rec709_display") => true,
            _ => {
                return wrong(
                    "colorSpace",
                    "srgb_rec709_display or lin_rec709_display",
                    extension["colorSpace"].to_string(),
                );
            }
        };
        let mut still = self.gaussians(primitive, part)?;
        if linear {
            colour::to_srgb(&mut still);
            notes.push(format!("{part}: linear colours brought to sRGB Gaussian by Gaussian, and blended so"));
        }
        still.about.notes.splice(0..0, notes);
        Ok(still)
    }

    /// Reads the Gaussians as [`Self::primitive`] does, in the primitive's own colour space.
    fn gaussians(&mut self, primitive: &Primitive, part: &str) -> Result<Still, FormatError> {
        let wrong = |name: &str, expected: &str, found: String| {
            Err(FormatError::new(format!("{part}: {name}"), expected, found))
        };
        let extension = &primitive.extensions[EXTENSION];
        if let Some(packed) = packed(primitive) {
            let Some(view) = packed.get("bufferView").and_then(serde_json::Value::as_u64) else {
                return wrong(SPZ, "a bufferView", packed.to_string());
            };
            let bytes = self.buffers.view(usize::try_from(view).unwrap_or(usize::MAX))?;
            let mut still = spz::within(&bytes, self.limits)?;
            if let Some(axes) = self.axes {
                still.taken_along(axes);
            }
            let (axes, axes_assumed) = (still.about.axes, still.about.axes_assumed);
            // From glTF's axes into scene space.
            still.bring_to(Axes::LUF);
            (still.about.axes, still.about.axes_assumed) = (axes, axes_assumed);
            return Ok(still);
        }
        let needed = |name: &str| {
            primitive
                .attributes
                .get(name)
                .copied()
                .ok_or_else(|| FormatError::new(format!("{part}: attribute {name}"), "an accessor", "none"))
        };
        let own = |name: &str| format!("{EXTENSION}:{name}");
        let degree = degree(primitive);

        let position = needed("POSITION")?;
        let count = self.buffers.count(position)?;
        let mut still = Still { degree, ..Still::default() };
        still.about.axes = Axes::LUF;
        let mean = self.buffers.read::<3>(position, count)?;
        let rotation = self.buffers.read::<4>(needed(&own("ROTATION"))?, count)?;
        let scale = self.buffers.read::<3>(needed(&own("SCALE"))?, count)?;
        let attribute = |name: &str| primitive.attributes.get(name).copied();
        let base = attribute(&coefficient(0, 0));
        let fallback = if base.is_none() { attribute("COLOR_0") } else { None };
        let fallback = fallback.map(|accessor| self.buffers.colours(accessor, count)).transpose()?;
        let opacity = match (attribute(&own("OPACITY")), &fallback) {
            (None, Some(colours)) => colours.iter().map(|[.., alpha]| [*alpha]).collect(),
            _ => self.buffers.read::<1>(needed(&own("OPACITY"))?, count)?,
        };
        if let Some(found) = scale.iter().flatten().find(|s| **s < 0.0) {
            return wrong("SCALE", "standard deviations of 0 or more (drafts stored logarithms)", found.to_string());
        }
        still.mean = mean.into_iter().map(|m| m.map(|x| x as f32)).collect();
        still.rotation = rotation.into_iter().map(|[x, y, z, w]| [w, x, y, z].map(|c| c as f32)).collect();
        still.log_scale =
            scale.into_iter().map(|s| s.map(|s| if s.is_nan() { f32::NAN } else { ln(s.max(LEAST)) as f32 })).collect();
        let logit = |[opacity]: [f64; 1]| {
            let opacity = opacity.clamp(LEAST, 1.0 - LEAST);
            if opacity.is_nan() { f32::NAN } else { (ln(opacity) - ln(1.0 - opacity)) as f32 }
        };
        still.logit = opacity.into_iter().map(logit).collect();
        still.base = match fallback {
            Some(colours) => {
                still
                    .about
                    .notes
                    .push(format!("{part}: colours from COLOR_0, as there are no coefficients of degree 0"));
                let is_linear = extension.get("colorSpace").is_some_and(|space| space == "lin_rec709_display");
                colours.iter().map(|[r, g, b, _]| [*r, *g, *b].map(|c| colour::coefficient(c, !is_linear))).collect()
            }
            None => {
                let base = self.buffers.read::<3>(needed(&coefficient(0, 0))?, count)?;
                base.into_iter().map(|c| c.map(|c| c as f32)).collect()
            }
        };
        still.higher = vec![0.0; count * 3 * rest(degree)];
        let mut before = 0;
        for degree in 1..=degree {
            for k in 0..2 * degree + 1 {
                let values = self.buffers.read::<3>(needed(&coefficient(degree, k))?, count)?;
                for (own, value) in still.higher.chunks_exact_mut(3 * rest(still.degree)).zip(values) {
                    own[3 * (before + k)..][..3].copy_from_slice(&value.map(|c| c as f32));
                }
            }
            before += 2 * degree + 1;
        }
        Ok(still)
    }

    /// Appends Gaussians. The lower degree is raised with coefficients of 0.
    fn append(&mut self, mut more: Still) -> Result<(), FormatError> {
        let still = &mut self.still;
        let about = &mut more.about;
        about.notes.splice(0..0, std::mem::take(&mut still.about.notes));
        if !still.is_empty() && still.about.antialiased != about.antialiased {
            about.antialiased = false;
            about
                .notes
                .push("some primitives were trained with anti-aliasing and some without: taken as without".to_owned());
        }
        still.about = std::mem::take(about);
        if still.is_empty() {
            *still = Still { about: std::mem::take(&mut still.about), ..more };
            return Ok(());
        }
        let degree = still.degree.max(more.degree);
        raise(still, degree);
        raise(&mut more, degree);
        still.mean.append(&mut more.mean);
        still.log_scale.append(&mut more.log_scale);
        still.rotation.append(&mut more.rotation);
        still.logit.append(&mut more.logit);
        still.base.append(&mut more.base);
        still.higher.append(&mut more.higher);
        Ok(())
    }
}

/// Returns the number of Gaussians of a primitive, and the degree of their harmonics.
fn gaussians(buffers: &mut Buffers<'_>, primitive: &Primitive) -> (usize, usize) {
    if !primitive.extensions.contains_key(EXTENSION) {
        return (0, 0);
    }
    let Some(packed) = packed(primitive) else {
        let position = primitive.attributes.get("POSITION");
        return (position.and_then(|position| buffers.count(*position).ok()).unwrap_or(0), degree(primitive));
    };
    let view = packed.get("bufferView").and_then(serde_json::Value::as_u64);
    let bytes = view.and_then(|view| buffers.view(usize::try_from(view).ok()?).ok());
    bytes.and_then(|bytes| spz::gaussians(&bytes)).unwrap_or((0, 0))
}

/// Returns the name of the attribute for a coefficient of the harmonics.
fn coefficient(degree: usize, k: usize) -> String {
    format!("{EXTENSION}:SH_DEGREE_{degree}_COEF_{k}")
}

/// Returns the degree of a primitive's harmonics.
fn degree(primitive: &Primitive) -> usize {
    (1..=3).rev().find(|degree| primitive.attributes.contains_key(&coefficient(*degree, 0))).unwrap_or(0)
}

/// Returns the compressed scene that replaces a primitive's attributes.
fn packed(primitive: &Primitive) -> Option<&serde_json::Value> {
    primitive.extensions.get(EXTENSION)?.get("extensions")?.get(SPZ)
}

/// Raises the degree of a scene's harmonics.
fn raise(still: &mut Still, degree: usize) {
    let (from, to) = (3 * rest(still.degree), 3 * rest(degree));
    if to > from {
        let mut higher = vec![0.0; still.len() * to];
        for (i, own) in higher.chunks_exact_mut(to).enumerate() {
            own[..from].copy_from_slice(&still.higher[i * from..][..from]);
        }
        (still.higher, still.degree) = (higher, degree);
    }
}

/// Returns a half turn about an axis, 1 to 3.
fn half_turn(axis: usize) -> Similarity {
    let quaternion = std::array::from_fn(|i| f64::from(u8::from(i == axis)));
    Similarity { scale: 1.0, rotation: Rotation::from_quaternion(quaternion).unwrap_or_default(), offset: [0.0; 3] }
}

/// Returns a node's own matrix.
fn transform(node: &Node) -> DMat4 {
    match node.matrix {
        Some(matrix) => DMat4::from_cols_array(&matrix),
        None => DMat4::from_scale_rotation_translation(
            DVec3::from_array(node.scale.unwrap_or([1.0; 3])),
            DQuat::from_array(node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0])),
            DVec3::from_array(node.translation.unwrap_or([0.0; 3])),
        ),
    }
}

/// Converts a matrix to a similarity in scene space.
fn similarity(matrix: DMat4, part: &str) -> Result<Similarity, FormatError> {
    let columns: [[f64; 3]; 3] = std::array::from_fn(|i| matrix.col(i).truncate().to_array());
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let squares = [0, 1, 2].map(|i| dot(columns[i], columns[i]));
    let scale = squares[0].sqrt();
    let unit = columns.map(|column| column.map(|x| x / scale));
    let even = squares.iter().all(|s| (s / squares[0] - 1.0).abs() < 1e-4);
    let right = [(0, 1), (0, 2), (1, 2)].iter().all(|&(i, j)| dot(unit[i], unit[j]).abs() < 1e-4);
    let upright = matrix.determinant() > 0.0;
    let rotation = if even && right && upright { Rotation::from_columns(unit) } else { None };
    let Some(rotation) = rotation else {
        let expected = "nodes that move, turn and scale alike along all axes";
        return Err(FormatError::new(part.to_owned(), expected, format!("the matrix {:?}", matrix.to_cols_array())));
    };
    let half = half_turn(3).rotation;
    let [x, y, z] = matrix.w_axis.truncate().to_array();
    let rotation = crate::still::after(half.quaternion(), rotation.quaternion());
    let rotation = Rotation::from_quaternion(rotation.map(f64::from)).unwrap_or_default();
    Ok(Similarity { scale, rotation, offset: [-x, -y, z] })
}
