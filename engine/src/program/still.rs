//! Still scenes, such as PLY files, in `render`, `export` and `inspect`.

use std::path::PathBuf;
use std::time::Instant;

use serde_json::{Value, json};
use streamsplat::Size;
use streamsplat::import::StillFile;
use streamsplat::output::{prepare_folder, write_file};
use streamsplat::still::Drawable;
use streamsplat::stream::Workers;

use super::cli::{Console, ExportArgs, RenderOptions};
use super::drawing::Drawing;
use super::export::{Format, refuse_others};
use super::failure::Failure;
use super::outputs::{Emit, Outputs};
use super::place::Place;
use super::progress::Progress;
use super::record::{InputRecord, Record, absolute};
use super::render::{Rendered, record};
use super::settings::Views;
use super::{say, stop};

/// Frames per second of a video of a scene that has no time.
const FPS: f64 = 24.0;
/// Images for which the scene's Gaussians are grouped. That takes about as long as an image, and saves more than half of each that shows a
/// tenth of the scene (`streamsplat bench raster --only part`).
const MANY: usize = 8;

/// Everything of a rendering but its record's files: one image, or one for each of `--times`, when a camera moves.
pub fn render(
    file: StillFile,
    place: &mut Place,
    options: &RenderOptions,
    views: &Views,
    emit: Emit,
    workers: &Workers,
    console: &Console,
    start: Instant,
) -> Result<Record, Failure> {
    let kind = format!("{} is a still scene ({})", file.path.display(), file.format);
    if options.view.camera.is_none() {
        return Err(Failure::usage(format!(
            "--camera: expected a file, found none; {kind}, which has no camera of its own"
        )));
    }
    let Size::Exact { width, height } = views.options.size else {
        let size = &options.view.size;
        return Err(Failure::usage(format!(
            "--size {size}: expected WIDTHxHEIGHT; {kind}, which has no size of its own"
        )));
    };
    let times = views.times.clone().unwrap_or_else(|| vec![0.0]);
    let read = start.elapsed();
    let scene = Drawable::new(file.still, workers)?;
    let scene = if times.len() >= MANY { scene.grouped(workers) } else { scene };
    let mut drawing = Drawing::new(workers, views.backend)?;
    let mut outputs = Outputs::create(place, emit)?;
    outputs.drawn_by(views.backend);
    let fps = options.fps.unwrap_or(FPS);
    outputs.start(fps)?;
    let mut progress = Progress::new("images", Some(times.len()), console.quiet);
    let mut complete = true;
    for (index, &time) in times.iter().enumerate() {
        if stop::asked() {
            complete = false;
            break;
        }
        drawing.still(&mut outputs, index, &scene, time, views)?;
        progress.step();
    }
    progress.finish();
    let written = drawing.writing(|| outputs.finish())?;

    let input = InputRecord { path: absolute(&file.path), blake3: file.blake3, count: 1, size: [width, height], fps };
    Ok(record(options, input, &drawing, Rendered { outputs: written, complete, read, start }, workers))
}

/// Writes the one file that a still scene is.
pub fn export(
    file: StillFile,
    format: Format,
    args: &ExportArgs,
    workers: &Workers,
    console: &Console,
) -> Result<(), Failure> {
    let kind = format!("{} is a still scene ({})", file.path.display(), file.format);
    if args.times.is_some() || args.fps.is_some() {
        return Err(Failure::usage(format!("--times, --fps: expected neither; {kind}, which has no time")));
    }
    let Some(write) = format.still else {
        return Err(Failure::usage(format!("--format {}: expected ply, splat or spz; {kind}", format.name)));
    };
    let path: PathBuf = if format.is_file(&args.out) {
        args.out.clone()
    } else {
        prepare_folder(&args.out)?;
        refuse_others(&args.out, format, 1)?;
        args.out.join(format.file(0))
    };
    let bytes = write_file(&path, &write(&Drawable::new(file.still, workers)?))?.bytes;
    if !console.quiet {
        say(format!("{}: 1 file, {bytes} bytes", args.out.display()))?;
    }
    Ok(())
}

/// What a still scene holds.
pub fn inspect(file: &StillFile) -> Value {
    let still = &file.still;
    let bounds = still.bounds();
    json!({
        "kind": "still scene",
        "format": file.format,
        "bytes": file.bytes,
        "blake3": file.blake3,
        "gaussians": still.len(),
        "harmonics_degree": still.degree,
        "least": bounds.map(|[least, _]| least),
        "greatest": bounds.map(|[_, greatest]| greatest),
    })
}
