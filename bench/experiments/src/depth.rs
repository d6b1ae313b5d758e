//! `depth`: quality of scenes of cards from cameras turned around them, without depth, with true depth, and with depth
//! found by parallax; and depth found in clips against a sensor's, or against a person's answers.

mod order;
mod registration;
mod sensor;

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use serde::Serialize;
use streamsplat::picture::Picture;
use streamsplat::{Settings, source};
use streamsplat_bench::Common;
use streamsplat_bench::table::{Column, Table};
use streamsplat_fixtures::clip::cards::Cards;
use streamsplat_tests::turned::{Depth, Score, score};

use order::Answers;
use registration::Registration;

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
    /// Let surfaces lean: the distance changes over each.
    #[arg(long, conflicts_with = "travel")]
    leaning: bool,
    /// Sideways travel of the camera until the views are taken, in pixels of the nearest objects in a picture 256 wide.
    /// Depth is then also found by parallax.
    #[arg(long, default_value_t = 0.0)]
    travel: f64,
    /// Key frames on the way.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(2..=64))]
    key_frames: u32,
    /// Clips with a sensor's depth, folders with rgb/ and depth/ (16-bit PNG, millimetres): compare found depth with it
    /// instead.
    #[arg(long, value_name = "DIR", num_args = 1..)]
    sensor: Vec<PathBuf>,
    /// Pose of the colour camera of that sensor, for depth that is not registered
    /// (bench/experiments/sensors/seven-scenes.json).
    #[arg(long, value_name = "FILE", requires = "sensor")]
    registration: Option<PathBuf>,
    /// Answers of a person about what is nearer (bench/experiments/sensors/order.json): compare depth found in their
    /// clips with them instead.
    #[arg(long, value_name = "FILE", requires = "clips", conflicts_with = "sensor")]
    order: Option<PathBuf>,
    /// Folders that contain these clips.
    #[arg(long, value_name = "DIR", num_args = 1..)]
    clips: Vec<PathBuf>,
    /// Frames from one key frame of these clips to the next.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=64))]
    gap: u32,
    /// Folders of images for textures; painted textures otherwise.
    #[arg(long, value_name = "DIR", num_args = 1..)]
    textures: Vec<PathBuf>,
    /// Write the pictures of each scene into this folder.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
}

const TABLE: Table<'_> = Table(&[
    Column::Text("depth", 14),
    Column::Number("views", 6),
    Column::Number("foreground", 0),
    Column::Number("behind", 0),
    Column::Number("covered", 0),
    Column::Number("middle", 6),
    Column::Number("key", 6),
    Column::Number("card", 6),
    Column::Number("card foreground", 0),
    Column::Number("views", 0),
    Column::Number("found", 7),
]);

#[derive(Serialize)]
struct DepthScore {
    depth: &'static str,
    #[serde(flatten)]
    score: Score,
}

pub(crate) fn size(text: &str) -> Result<[usize; 2], String> {
    let side = |text: &str| text.parse().ok().filter(|side| (16..=4096).contains(side));
    let sides = text.split_once('x').and_then(|(width, height)| side(width).zip(side(height)));
    sides.map(|(width, height)| [width, height]).ok_or_else(|| "expected WIDTHxHEIGHT, 16 to 4096".to_owned())
}

pub(crate) fn run(options: &Options) -> Result<()> {
    let settings = Settings { level: Some(options.common.isa), threads: options.common.threads, ..Settings::default() };
    if !options.sensor.is_empty() {
        let registration = options.registration.as_deref().map(Registration::read).transpose()?;
        println!("{}", sensor::Row::head());
        let mut rows = Vec::new();
        for folder in &options.sensor {
            let row = sensor::clip(&settings, folder, registration.as_ref(), options.gap as usize)?;
            println!("{}", row.line());
            rows.push(row);
        }
        return options.common.write(&rows);
    }
    if let Some(file) = &options.order {
        let rows = Answers::read(file)?.compare(&settings, &options.clips, options.gap as usize)?;
        println!("{}", order::Row::head());
        rows.iter().for_each(|row| println!("{}", row.line()));
        return options.common.write(&rows);
    }
    let [width, height] = options.size;
    let mut textures = Vec::new();
    for folder in &options.textures {
        textures.extend(first_picture(folder, [width, height])?);
    }
    let follow = options.travel * width as f64 / 256.0;
    let scene = |seed| {
        let cards = Cards::textured(seed, width, height, follow, &textures);
        if options.leaning { cards.leaning(seed) } else { cards }
    };
    let scenes: Vec<Cards> = (0..options.scenes).map(scene).collect();
    if let Some(folder) = &options.pictures {
        std::fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
    }
    let mut rows = Vec::new();
    println!("{}", TABLE.heads());
    let last = f64::from(options.key_frames - 1);
    let times: Vec<f64> = match follow {
        0.0 => vec![0.0],
        _ => (0..options.key_frames).map(|key| f64::from(key) / last).collect(),
    };
    let all =
        [("none", Depth::None), ("true", Depth::True), ("found", Depth::Found), ("found, scaled", Depth::FoundInScale)];
    for (name, depth) in &all[..if follow == 0.0 { 2 } else { 4 }] {
        let mut failed = None;
        let score = score(&settings, &scenes, *depth, &times, options.degrees, |what, scene, rgb| {
            if let Some(folder) = &options.pictures {
                let path = folder.join(format!("{scene:02}-{}-{what}.ppm", name.replace(", ", "-")));
                failed = failed.take().or(std::fs::write(path, ppm(rgb, [width, height])).err());
            }
        });
        failed.map_or(Ok(()), Err)?;
        let Score { views, foreground, behind, covered, middle, key, card, count, scenes, found } = score;
        let decibels = [views, foreground, behind, covered, middle, key, card[0], card[1]].map(|x| format!("{x:.2}"));
        let counts = [count.to_string(), format!("{found}/{scenes}")];
        println!("{}", TABLE.line(&[&[(*name).to_owned()], &decibels[..], &counts].concat()));
        rows.push(DepthScore { depth: name, score });
    }
    options.common.write(&rows)
}

/// The first image of a folder, at the size of the scenes.
pub(crate) fn first_picture(folder: &std::path::Path, [width, height]: [usize; 2]) -> Result<Option<Vec<f32>>> {
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
pub(crate) fn ppm(rgb: &[f32], [width, height]: [usize; 2]) -> Vec<u8> {
    let area = width * height;
    let mut bytes = format!("P6 {width} {height} 255\n").into_bytes();
    for pixel in 0..area {
        bytes.extend((0..3).map(|c| (255.0 * rgb[c * area + pixel].clamp(0.0, 1.0) + 0.5) as u8));
    }
    bytes
}
