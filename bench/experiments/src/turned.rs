//! `turned`: scenes with one moving body, rendered from the side and compared with the true views.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use serde::Serialize;
use streamsplat::Settings;
use streamsplat_bench::Common;
use streamsplat_bench::table::{Column, Table};
use streamsplat_fixtures::clip::cards::{Body, Cards, Moves};
use streamsplat_tests::turned::{BodyScore, Depth, edges_from_lines, score_bodies};

use crate::depth::{first_picture, ppm};

/// Options of `turned`.
#[derive(Args)]
pub(crate) struct Options {
    #[command(flatten)]
    common: Common,
    /// Scenes of each kind.
    #[arg(long, default_value_t = 4)]
    scenes: u64,
    /// Width and height of their pictures.
    #[arg(long, default_value = "256x144", value_parser = crate::depth::size)]
    size: [usize; 2],
    /// Degrees by which views are turned to both sides.
    #[arg(long, default_value_t = 10.0)]
    degrees: f64,
    /// Key frames on the way.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(2..=64))]
    key_frames: u32,
    /// Folders of images for textures; painted textures otherwise.
    #[arg(long, value_name = "DIR", num_args = 1..)]
    textures: Vec<PathBuf>,
    /// Measure instead how straight the edges of a picture without depth stay when it is turned.
    #[arg(long, conflicts_with = "textures")]
    straight: bool,
    /// Write the pictures of each scene into this folder.
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
}

/// Shift between two key frames, in pixels of a picture 256 wide: of the nearest objects when the camera moves
/// sideways, of everything when it turns.
const SIDEWAYS: f64 = 8.0;
const TURNING: f64 = 6.0;
/// Widths that a slow and a fast body move by themselves between two key frames.
const SPEEDS: [(&str, f64); 2] = [("slow", 0.1), ("fast", 0.5)];

const TABLE: Table<'_> = Table(&[
    Column::Text("camera", 9),
    Column::Text("body", 7),
    Column::Text("speed", 6),
    Column::Text("depth", 14),
    Column::Number("around", 0),
    Column::Number("invented", 0),
    Column::Number("key", 6),
    Column::Number("card", 6),
    Column::Number("card invented", 0),
    Column::Number("found", 7),
]);

#[derive(Serialize)]
struct Row {
    camera: &'static str,
    body: String,
    speed: &'static str,
    depth: &'static str,
    #[serde(flatten)]
    score: BodyScore,
}

#[derive(Serialize)]
struct Straight {
    degrees: f64,
    rms: f64,
    most: f64,
}

pub(crate) fn run(options: &Options) -> Result<()> {
    let settings = Settings { level: Some(options.common.isa), threads: options.common.threads, ..Settings::default() };
    let [width, height] = options.size;
    if options.straight {
        let [rms, most] = edges_from_lines(&settings, options.degrees, [height, width]);
        println!("edges of a card at ±{}°: {rms:.2} pixels from lines, 95 % within {most:.2}", options.degrees);
        return options.common.write(&[Straight { degrees: options.degrees, rms, most }]);
    }
    let mut textures = Vec::new();
    for folder in &options.textures {
        textures.extend(first_picture(folder, options.size)?);
    }
    if let Some(folder) = &options.pictures {
        std::fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
    }
    let steps = f64::from(options.key_frames - 1);
    let times: Vec<f64> = (0..options.key_frames).map(|key| f64::from(key) / steps).collect();
    let scale = width as f64 / 256.0 * steps;
    let cameras = [("sideways", [SIDEWAYS, 0.0]), ("turning", [0.0, TURNING]), ("standing", [0.0, 0.0])];
    let mut rows = Vec::new();
    println!("{}", TABLE.heads());
    for (camera, [sideways, turning]) in cameras {
        for body in [Body::Ball, Body::Person, Body::Car] {
            for (speed, own) in SPEEDS {
                let moves = Moves { sideways: sideways * scale, turning: turning * scale, body: own * steps };
                let scenes: Vec<Cards> = (0..options.scenes)
                    .map(|seed| Cards::with_body(seed, [height, width], body, moves, &textures))
                    .collect();
                let depths = [
                    ("none", Depth::None),
                    ("true", Depth::True),
                    ("found", Depth::FoundInScale),
                    ("guessed", Depth::GuessedInScale),
                ];
                for (name, depth) in depths {
                    let mut failed = None;
                    let score = score_bodies(&settings, &scenes, depth, &times, options.degrees, |what, scene, rgb| {
                        if let Some(folder) = &options.pictures {
                            let path = folder.join(format!("{camera}-{body:?}-{speed}-{scene}-{name}-{what}.ppm"));
                            failed = failed.take().or(std::fs::write(path, ppm(rgb, options.size)).err());
                        }
                    });
                    failed.map_or(Ok(()), Err)?;
                    let decibels = |x: f64| format!("{x:.2}");
                    let percent = |x: f64| format!("{:.1} %", 100.0 * x);
                    let row = Row { camera, body: format!("{body:?}").to_lowercase(), speed, depth: name, score };
                    println!(
                        "{}",
                        TABLE.line(&[
                            camera.to_owned(),
                            row.body.clone(),
                            speed.to_owned(),
                            name.to_owned(),
                            decibels(score.around),
                            percent(score.invented),
                            decibels(score.key),
                            decibels(score.card[0]),
                            percent(score.card[1]),
                            format!("{}/{}", score.found, score.scenes),
                        ])
                    );
                    rows.push(row);
                }
            }
        }
    }
    options.common.write(&rows)
}
