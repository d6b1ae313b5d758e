//! `render`: a scene → images at chosen times and cameras.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use streamsplat::scene::Scene;
use streamsplat::stream::Interval;

use super::cli::{Console, Machine, RenderArgs, RenderOptions};
use super::drawing::Drawing;
use super::failure::Failure;
use super::outputs::{Destination, Emit, Outputs};
use super::progress::Progress;
use super::record::{InputRecord, PROGRAM, Record, Task, Timing, absolute};
use super::{digest, machine, report, say, stop};

/// Renders, then writes the record and the report.
pub fn command(args: &RenderArgs, console: &Console) -> Result<(), Failure> {
    stop::listen();
    let destination = Destination::of(&args.out);
    let record = render(&args.scene, destination.clone(), &args.options, &args.machine, console)?;
    report::finish(&record, &destination, args.json.as_deref())?;
    if !console.quiet && args.out != Path::new("-") {
        say(report::summary(&record, &args.out));
    }
    Ok(())
}

/// Everything of a rendering but its record's files.
pub fn render(
    path: &Path,
    destination: Destination,
    options: &RenderOptions,
    machine: &Machine,
    console: &Console,
) -> Result<Record, Failure> {
    let start = Instant::now();
    let mut views = options.view.resolve()?;
    let emit = match &options.emit {
        Some(list) => Emit::parse(list, &["rgb", "depth", "alpha"])?,
        None => Emit { rgb: true, ..Emit::default() },
    };
    views.options.depth = emit.depth;
    views.options.alpha = emit.alpha || emit.depth;
    if options.fps.is_some_and(|fps| !(fps.is_finite() && fps > 0.0)) {
        return Err(Failure::usage("--fps: expected a number above 0"));
    }
    let workers = machine.workers()?;
    let scene = Scene::open(path)?;
    let fps = options.fps.unwrap_or(scene.index().fps);
    let times = match &views.times {
        Some(times) => times.clone(),
        None => grid(scene.span(), fps)?,
    };
    // Times outside the scene are said before anything is drawn.
    let places: Vec<usize> = times.iter().map(|&t| scene.find(t)).collect::<Result<_, _>>().map_err(|e| match e {
        streamsplat::scene::SceneError::Time { .. } => Failure::usage(format!("--times: {e}")),
        other => other.into(),
    })?;
    let mut outputs = Outputs::create(destination, emit)?;
    outputs.start(fps)?;

    let mut drawing = Drawing::new(&workers);
    let mut progress = Progress::new("images", Some(times.len()), console.quiet);
    let mut current: Option<(usize, Interval)> = None;
    let mut read = Duration::ZERO;
    let mut intervals = 0;
    let mut complete = true;
    for (index, (&time, &place)) in times.iter().zip(&places).enumerate() {
        if stop::asked() {
            complete = false;
            break;
        }
        let interval = match current.take().filter(|(at, _)| *at == place) {
            Some((_, interval)) => interval,
            None => {
                let begun = Instant::now();
                let interval = scene.interval(place, &workers)?;
                read += begun.elapsed();
                intervals += 1;
                interval
            }
        };
        drawing.image(&mut outputs, index, &interval, time, &views)?;
        current = Some((place, interval));
        progress.step();
    }
    progress.finish();
    let written = drawing.writing(|| outputs.finish())?;

    let mut options = options.clone();
    options.view.camera = options.view.camera.as_deref().map(absolute);
    let [height, width] = scene.placement().source;
    let mut work = BTreeMap::new();
    let mut seconds = BTreeMap::from([("read".to_owned(), read.as_secs_f64())]);
    drawing.account(&mut work, &mut seconds);
    Ok(Record {
        program: PROGRAM.to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        task: Task::Render(Box::new(options)),
        seed: 0,
        model: None,
        input: InputRecord {
            path: absolute(path),
            blake3: digest::scene(&scene)?,
            count: intervals,
            size: [width, height],
            fps: scene.index().fps,
        },
        complete,
        outputs: written,
        work,
        dropped: drawing.dropped,
        timing: Timing {
            total: start.elapsed().as_secs_f64(),
            seconds,
            peak_resident_bytes: machine::peak_resident_bytes(),
            threads: workers.threads(),
            isa: workers.level().name().to_owned(),
        },
    })
}

/// Times from the scene's start, `fps` to the second, up to its end. The end is met when it is within a millionth of a step.
fn grid((start, end): (f64, f64), fps: f64) -> Result<Vec<f64>, Failure> {
    let steps = (end - start) * fps;
    if !(steps.is_finite() && steps < 1e7) {
        return Err(Failure::usage(format!("--fps {fps}: {steps} images are too many; give --times")));
    }
    let count = (steps + 1e-6) as usize;
    Ok((0..=count).map(|i| (start + i as f64 / fps).min(end)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_meets_both_ends() {
        assert_eq!(grid((0.0, 0.5), 4.0).expect("few"), [0.0, 0.25, 0.5]);
        assert_eq!(grid((1.0, 1.0), 24.0).expect("few"), [1.0]);
        assert_eq!(grid((0.0, 29.0 / 24.0), 24.0).expect("few").len(), 30);
        assert!(grid((0.0, 1e12), 24.0).is_err());
    }
}
