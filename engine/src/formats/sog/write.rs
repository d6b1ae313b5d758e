//! Writing SOG, version 2, in one zip file.

use std::io::{Cursor, Write};

use image::codecs::webp::WebPEncoder;
use image::{ExtendedColorType, ImageEncoder};
use serde_json::{Value, json};
use streamsplat_kernels::math::f64::{exp, ln};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::codebook::Codebook;
use super::palette::Palette;
use super::{LARGEST, MODEL, ROWS};
use crate::camera::Rotation;
use crate::formats::notes::Notes;
use crate::formats::{Order, Written};
use crate::still::{LEAST, Still};

/// Writes a still scene as a SOG file.
///
/// Gaussians are in Z-order, so that neighbouring pixels are similar. Centres have 16 bits per axis on a logarithmic
/// scale, scales and first coefficients one of 256 values, rotations 8 bits per component, opacities 8 bits. The
/// further coefficients of a Gaussian are one of 1,024 to 65,536 rows. Rows are found by repeatedly splitting the group
/// of Gaussians with the largest error in two, at the mean of the coefficient that varies most. Gaussians that cannot
/// be drawn ([`Still::defect`]) are left out. `"model": "antialiased"` marks scenes trained with anti-aliasing. The
/// bytes are a function of the scene alone.
///
/// # Panics
/// If the arrays differ in length ([`Still::uneven`]).
pub fn write(still: &Still) -> Written {
    let kept = Order::along_curve(still);
    let mut notes = Notes::of(still, &kept);
    notes.offset(still.about.offset, "which only streamsplat reads from a SOG file");
    let order = kept.places;
    let mut files: Vec<(&str, Vec<u8>)> = Vec::new();
    let side = |count: usize| {
        let width = ((count as f64).sqrt() / 4.0).ceil().max(1.0) as usize * 4;
        [width, count.div_ceil(width).div_ceil(4).max(1) * 4]
    };
    let size = side(order.len());
    let mut add = |name: &'static str, pixels: &mut dyn Iterator<Item = [u8; 4]>| {
        files.push((name, webp(size, pixels)));
        name
    };

    let log = |x: f32| {
        let m = ln(f64::from(x).abs() + 1.0);
        if x < 0.0 { -m } else { m }
    };
    let bounds = order.iter().fold([[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]], |[least, greatest], &i| {
        let m = still.mean[i].map(log);
        [std::array::from_fn(|k| least[k].min(m[k])), std::array::from_fn(|k| greatest[k].max(m[k]))]
    });
    // Without Gaussians there are no bounds, and infinities are not valid JSON.
    let [mins, maxs] = if order.is_empty() { [[0.0; 3]; 2] } else { bounds };
    let fixed = |i: usize| -> [[u8; 2]; 3] {
        std::array::from_fn(|k| {
            let share = if maxs[k] > mins[k] { (log(still.mean[i][k]) - mins[k]) / (maxs[k] - mins[k]) } else { 0.0 };
            ((share * 65535.0).round().clamp(0.0, 65535.0) as u16).to_le_bytes()
        })
    };
    let byte = |part: usize| move |[x, y, z]: [[u8; 2]; 3]| [x[part], y[part], z[part], 255];
    let means = [
        add("means_l.webp", &mut order.iter().map(|&i| byte(0)(fixed(i)))),
        add("means_u.webp", &mut order.iter().map(|&i| byte(1)(fixed(i)))),
    ];
    // A scale of 0 is stored as [`LEAST`], as in other formats.
    let log_scale = |i: usize| still.log_scale[i].map(|s| if s == f32::NEG_INFINITY { ln(LEAST) as f32 } else { s });
    let scales = Codebook::of(order.iter().flat_map(|&i| log_scale(i)));
    let [x, y, z] = [0, 1, 2];
    let scale = |i: usize| log_scale(i).map(|s| scales.nearest(s));
    add("scales.webp", &mut order.iter().map(|&i| [scale(i)[x], scale(i)[y], scale(i)[z], 255]));
    add("quats.webp", &mut order.iter().map(|&i| rotation(still.rotation[i])));
    let sh0 = Codebook::of(order.iter().flat_map(|&i| still.base[i]));
    add(
        "sh0.webp",
        &mut order.iter().map(|&i| {
            let [red, green, blue] = still.base[i].map(|c| sh0.nearest(c));
            let opacity = 1.0 / (1.0 + exp(-f64::from(still.logit[i]).clamp(-200.0, 200.0)));
            [red, green, blue, (255.0 * opacity).round() as u8]
        }),
    );
    let mut meta = json!({
        "version": 2,
        "asset": { "generator": concat!("streamsplat ", env!("CARGO_PKG_VERSION")) },
        "count": order.len(),
        "means": { "mins": mins, "maxs": maxs, "files": means },
        "scales": { "codebook": scales.json(), "files": ["scales.webp"] },
        "quats": { "files": ["quats.webp"] },
        "sh0": { "codebook": sh0.json(), "files": ["sh0.webp"] },
    });
    if still.about.antialiased {
        meta["model"] = MODEL.into();
    }
    if still.about.offset != [0.0; 3] {
        meta["offset"] = json!(still.about.offset);
    }
    if still.degree > 0 && !order.is_empty() {
        meta["shN"] = harmonics(still, &order, size, &mut files);
    }
    files.push(("meta.json", meta.to_string().into_bytes()));
    Written { bytes: zip(&files), notes: notes.0 }
}

/// Writes the images of the further coefficients; returns their entry in `meta.json`.
fn harmonics(still: &Still, order: &[usize], size: [usize; 2], files: &mut Vec<(&str, Vec<u8>)>) -> Value {
    let width = still.rest();
    let rows: Vec<f32> = order.iter().flat_map(|&i| &still.higher[i * 3 * width..][..3 * width]).copied().collect();
    let palette = Palette::of(&rows, 3 * width);
    let codebook = Codebook::of(palette.rows.iter().copied());
    let count = palette.rows.len() / (3 * width);
    let lines = count.div_ceil(ROWS);
    // A line holds 64 rows of coefficients side by side, so pixels are in the order of the rows.
    let pixels = palette.rows.as_chunks::<3>().0.iter().map(|c| {
        let [red, green, blue] = c.map(|c| codebook.nearest(c));
        [red, green, blue, 255]
    });
    files.push(("shN_centroids.webp", webp([ROWS * width, lines], &mut { pixels })));
    let labels = palette.labels.iter().map(|label| {
        let [low, high] = label.to_le_bytes();
        [low, high, 0, 255]
    });
    files.push(("shN_labels.webp", webp(size, &mut { labels })));
    json!({
        "count": count,
        "bands": still.degree,
        "codebook": codebook.json(),
        "files": ["shN_centroids.webp", "shN_labels.webp"],
    })
}

/// Packs the three smallest of w, x, y, z in eight bits each, and the index of the largest, which is made positive.
fn rotation(q: [f32; 4]) -> [u8; 4] {
    let q = Rotation::from_quaternion(q.map(f64::from)).unwrap_or_default().quaternion();
    let largest = (1..4).fold(0, |best: usize, i| if q[i].abs() > q[best].abs() { i } else { best });
    let sign = if q[largest] < 0.0 { -1.0 } else { 1.0 };
    let mut bytes = [0, 0, 0, LARGEST + largest as u8];
    for (byte, i) in bytes.iter_mut().zip((0..4).filter(|i| *i != largest)) {
        *byte = (255.0 * (sign * q[i] * std::f64::consts::FRAC_1_SQRT_2 + 0.5)).round().clamp(0.0, 255.0) as u8;
    }
    bytes
}

/// Encodes a lossless image; missing pixels are opaque black.
fn webp([width, height]: [usize; 2], pixels: &mut dyn Iterator<Item = [u8; 4]>) -> Vec<u8> {
    let all = pixels.chain(std::iter::repeat([0, 0, 0, 255])).take(width * height);
    let bytes: Vec<u8> = all.flatten().collect();
    let mut out = Vec::new();
    WebPEncoder::new_lossless(&mut out)
        .write_image(&bytes, width as u32, height as u32, ExtendedColorType::Rgba8)
        .unwrap_or_else(|e| panic!("an image of {width}×{height}: {e}"));
    out
}

/// Stores files with a fixed date in one zip file, uncompressed: images are compressed already.
fn zip(files: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let options = SimpleFileOptions::DEFAULT.compression_method(CompressionMethod::Stored);
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        let written =
            archive.start_file(*name, options).map_err(std::io::Error::from).and_then(|()| archive.write_all(bytes));
        written.unwrap_or_else(|e| panic!("{name} in memory: {e}"));
    }
    archive.finish().unwrap_or_else(|e| panic!("a zip file in memory: {e}")).into_inner()
}
