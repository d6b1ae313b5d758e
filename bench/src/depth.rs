//! `depth`: how scenes of cards look from cameras led around them, with and without their true depth.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use serde::Serialize;
use streamsplat::picture::Picture;
use streamsplat::{Settings, source};
use streamsplat_fixtures::clip::cards::Cards;
use streamsplat_tests::turned::{Score, score};

use crate::Common;
use crate::table::{Column, Table};

/// Options of `depth`.
#[derive(Args)]
pub(crate) struct Options {
    #[command(flatten)]
    common: Common,
    /// Scenes.
    #[arg(long, default_value_t = 16)]
    scenes: u64,
    /// Width and height of their pictures.
    #[arg(long, default_value = "256x144", value_parser = size)]
    size: [usize; 2],
    /// Degrees by which views are turned to both sides.
    #[arg(long, default_value_t = 10.0)]
    degrees: f64,
    /// Folders of images that textures are taken from; painted textures otherwise.
    #[arg(long, value_name = "DIR", num_args = 1..)]
    textures: Vec<PathBuf>,
    /// Write the pictures of each scene into this folder.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
}

const TABLE: Table<'_> = Table(&[
    Column::Text("depth", 8),
    Column::Number("views", 6),
    Column::Number("foreground", 0),
    Column::Number("behind", 0),
    Column::Number("key", 6),
    Column::Number("card", 6),
    Column::Number("card foreground", 0),
    Column::Number("views", 0),
]);

#[derive(Serialize)]
struct DepthScore {
    depth: &'static str,
    #[serde(flatten)]
    score: Score,
}

fn size(text: &str) -> Result<[usize; 2], String> {
    let side = |text: &str| text.parse().ok().filter(|side| (16..=4096).contains(side));
    let sides = text.split_once('x').and_then(|(width, height)| side(width).zip(side(height)));
    sides.map(|(width, height)| [width, height]).ok_or_else(|| "expected WIDTHxHEIGHT, 16 to 4096".to_owned())
}

pub(crate) fn run(options: &Options) -> Result<()> {
    let [width, height] = options.size;
    let mut textures = Vec::new();
    for folder in &options.textures {
        textures.extend(first_picture(folder, [width, height])?);
    }
    let scenes: Vec<Cards> =
        (0..options.scenes).map(|seed| Cards::textured(seed, width, height, 0.0, &textures)).collect();
    let settings = Settings { level: Some(options.common.isa), threads: options.common.threads, ..Settings::default() };
    if let Some(folder) = &options.pictures {
        std::fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
    }
    let mut rows = Vec::new();
    println!("{}", TABLE.heads());
    for (name, depth) in [("none", false), ("true", true)] {
        let mut failed = None;
        let score = score(&settings, &scenes, depth, options.degrees, |what, scene, rgb| {
            if let Some(folder) = &options.pictures {
                let path = folder.join(format!("{scene:02}-{name}-{what}.ppm"));
                failed = failed.take().or(std::fs::write(path, ppm(rgb, [width, height])).err());
            }
        });
        failed.map_or(Ok(()), Err)?;
        let Score { views, foreground, behind, key, card, count } = score;
        let decibels = [views, foreground, behind, key, card[0], card[1]].map(|x| format!("{x:.2}"));
        println!("{}", TABLE.line(&[&[name.to_owned()], &decibels[..], &[count.to_string()]].concat()));
        rows.push(DepthScore { depth: name, score });
    }
    options.common.write(&rows)
}

/// The first image of a folder, at the size of the scenes.
fn first_picture(folder: &std::path::Path, [width, height]: [usize; 2]) -> Result<Option<Vec<f32>>> {
    let mut source = source::Source::open(folder, &source::Options::default())?;
    let Some(frame) = source.next_frame()? else { return Ok(None) };
    let Picture { width: from_width, height: from_height, rgb } = frame.picture;
    let mut out = vec![0.0; 3 * width * height];
    streamsplat_kernels::resize::bilinear(
        streamsplat_kernels::Level::detect(),
        &rgb,
        3,
        from_height,
        from_width,
        height,
        width,
        &mut out,
    );
    Ok(Some(out))
}

/// An image as a binary PPM file.
fn ppm(rgb: &[f32], [width, height]: [usize; 2]) -> Vec<u8> {
    let area = width * height;
    let mut bytes = format!("P6 {width} {height} 255\n").into_bytes();
    for pixel in 0..area {
        bytes.extend((0..3).map(|c| (255.0 * rgb[c * area + pixel].clamp(0.0, 1.0) + 0.5) as u8));
    }
    bytes
}
