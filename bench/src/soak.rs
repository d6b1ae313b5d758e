//! A stream of thousands of key frames: bounded memory, no slowdown, no identity twice, no drift.
//!
//! The input is a procedural clip of four seconds, forward and backward without end; the network a small one. Time is the time that all
//! threads of this process spent on a CPU. Because that, too, depends on what else the machine does, the long stream's last hundred steps are
//! compared with the second hundred of a *young* stream beside it, fed the same frames in turn. Memory is looked at until the young stream starts.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use serde::Serialize;
use streamsplat::render::Painter;
use streamsplat::stream::{Fusion, Interval, ModelSource};
use streamsplat::{Camera, Engine, Frame, Image, RenderOptions, Settings};
use streamsplat_fixtures::clip::{Clip, Kind};
use streamsplat_kernels::Level;

use super::{machine, process};

/// Frames of the clip, which is played to and fro.
const FRAMES: u64 = 96;
/// Frames per second.
const RATE: f64 = 24.0;
/// Key frames after which memory must be flat.
const SETTLED: u64 = 50;
/// Key frames of the young stream, the second hundred of which is measured.
const YOUNG: u64 = 200;
/// Some where memory is looked at, and the young stream's.
const FEWEST: u64 = 100 + YOUNG;
/// Most that memory may grow after [`SETTLED`].
const MEMORY: f64 = 1.02;

/// A long stream.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Key frames (at least 300).
    #[arg(long, default_value_t = 10_000)]
    key_frames: u64,
    /// Checkpoint [default: the smallest of the fixtures].
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Instruction set: scalar, avx2, avx512, neon or auto.
    #[arg(long, default_value = "auto", value_parser = super::level)]
    isa: Level,
    /// Threads (0: one per core).
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// Most that the last hundred may take of the second hundred's time.
    #[arg(long, default_value_t = 1.05)]
    slowdown: f64,
    /// Write the results here as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// One thing that must hold.
#[derive(Serialize)]
struct Check {
    what: &'static str,
    found: f64,
    at_most: f64,
    holds: bool,
}

impl Check {
    fn new(what: &'static str, found: f64, at_most: f64) -> Check {
        Check { what, found, at_most, holds: found <= at_most }
    }
}

/// The state after some key frames.
#[derive(Serialize)]
struct Row {
    key_frame: u64,
    resident_bytes: u64,
    /// Median of the hundred key frames before.
    cpu_seconds: f64,
    gaussians: usize,
    identities: u64,
}

#[derive(Serialize)]
struct Results {
    cpu: String,
    isa: String,
    threads: usize,
    key_frames: u64,
    model: String,
    checks: Vec<Check>,
    rows: Vec<Row>,
}

/// The endless clip.
struct Film {
    frames: Vec<Frame>,
}

impl Film {
    fn new([height, width]: [usize; 2]) -> Film {
        let clip = Clip::new(Kind::StaticCamera, 1, width, height);
        let frame = |i| Frame { width, height, rgb: clip.picture(i as f64 / RATE).rgb, depth: None };
        Film { frames: (0..FRAMES).map(frame).collect() }
    }

    fn frame(&self, k: u64) -> Frame {
        let phase = k % (2 * FRAMES - 2);
        self.frames[phase.min(2 * FRAMES - 2 - phase) as usize].clone()
    }
}

/// A stream that is drawn, and the CPU time of its steps.
struct Measured {
    engine: Engine,
    painter: Painter,
    seconds: Vec<f64>,
}

impl Measured {
    fn new(settings: &Settings) -> Result<Measured> {
        let engine = Engine::new(settings.clone())?;
        let painter = Painter::new(engine.workers());
        Ok(Measured { engine, painter, seconds: Vec::new() })
    }

    /// Takes key frame `k` and draws the middle of its interval.
    fn step(&mut self, film: &Film, k: u64) -> Result<Interval> {
        let frame = film.frame(k);
        let start = process::cpu_seconds()?;
        let interval = self.engine.push(frame, k as f64 / RATE)?;
        let time = 0.5 * (interval.start + interval.end);
        self.painter.draw(&interval, time, &Camera::Canonical, &RenderOptions::default())?;
        self.seconds.push(process::cpu_seconds()? - start);
        Ok(interval)
    }
}

/// Identities ascend, and what is gone stays away: it needs no memory of all that were.
#[derive(Default)]
struct Identities {
    newest: Option<u64>,
    alive: Vec<u64>,
    twice: u64,
}

impl Identities {
    fn see(&mut self, interval: &Interval) {
        let g = &interval.gaussians;
        let mut now = g.identity.clone();
        now.sort_unstable();
        now.dedup();
        let back =
            |id: &&u64| self.newest.is_some_and(|newest| **id <= newest) && self.alive.binary_search(id).is_err();
        self.twice += now.iter().filter(back).count() as u64;
        // The Gaussians of one frame never share one.
        let mut own: Vec<u64> = g.iter().filter(|r| r.frame == interval.index).map(|r| r.identity).collect();
        let count = own.len();
        own.sort_unstable();
        own.dedup();
        self.twice += (count - own.len()) as u64;
        self.newest = self.newest.max(now.last().copied());
        self.alive = now;
    }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

/// The images of an interval at its start, middle and end.
fn images(interval: &Interval) -> Result<Vec<Image>> {
    let times = [interval.start, 0.5 * (interval.start + interval.end), interval.end];
    let draw = |time| Ok(interval.render(time, &Camera::Canonical, &RenderOptions::default())?);
    times.into_iter().map(draw).collect()
}

/// Streams, checks, reports.
pub(crate) fn run(options: &Options) -> Result<()> {
    let count = options.key_frames;
    ensure!(count >= FEWEST, "--key-frames {count}: expected at least {FEWEST}");
    let checkpoint =
        options.model.clone().unwrap_or_else(|| streamsplat_fixtures::path("parity/tiny-nodino.safetensors"));
    let source = ModelSource::File { checkpoint: checkpoint.clone(), dinov2: None };
    let settings = Settings { level: Some(options.isa), threads: options.threads, ..Settings::with_model(source) };
    let mut long = Measured::new(&settings)?;
    // One network for all streams.
    let settings = Settings { model: ModelSource::Shared(long.engine.model().clone()), ..settings };
    let pairwise = Settings { fusion: Fusion::Pairwise, ..settings.clone() };
    let mut pairs = Engine::new(pairwise.clone())?;
    let film = Film::new(long.engine.model().resolution());

    let mut identities = Identities::default();
    let mut rows = Vec::new();
    let mut resident = Vec::new();
    let mut last = None;
    let mut young = None;
    for k in 0..count {
        if k == count - YOUNG {
            young = Some(Measured::new(&settings)?);
        }
        // In turn: whoever goes second finds the caches warm.
        let mut interval = None;
        for turn in [k % 2 == 0, k % 2 == 1] {
            if turn {
                interval = Some(long.step(&film, k)?);
            } else if let Some(young) = &mut young {
                young.step(&film, k)?;
            }
        }
        last = Some(pairs.push(film.frame(k), k as f64 / RATE)?);
        let interval = interval.context("a step")?;
        identities.see(&interval);
        resident.push(process::resident_bytes()?);
        if (k + 1) % 100 == 0 || k + 1 == SETTLED {
            let from = long.seconds.len().saturating_sub(100);
            rows.push(Row {
                key_frame: k + 1,
                resident_bytes: resident[k as usize],
                cpu_seconds: median(&long.seconds[from..]),
                gaussians: interval.gaussians.len(),
                identities: identities.newest.map_or(0, |newest| newest + 1),
            });
        }
        if (k + 1) % 1000 == 0 {
            println!("{} key frames, {:.1} MiB", k + 1, resident[k as usize] as f64 / f64::from(1 << 20));
        }
    }

    let hundred = |m: &Measured| median(&m.seconds[m.seconds.len() - 100..]);
    let [second, end] = [hundred(&young.context("a young stream")?), hundred(&long)];
    let settled = resident[SETTLED as usize - 1] as f64;
    let alone = &resident[SETTLED as usize..(count - YOUNG) as usize];
    let most = alone.iter().copied().max().unwrap_or_default() as f64;
    let mut fresh = Engine::new(pairwise)?;
    let mut other = None;
    for k in count - 3..count {
        other = Some(fresh.push(film.frame(k), k as f64 / RATE)?);
    }
    let same = images(&last.context("an interval")?)? == images(&other.context("an interval")?)?;
    let checks = vec![
        Check::new("most memory after the first 50 / memory then", most / settled, MEMORY),
        Check::new(
            "CPU time, last hundred / second hundred of a young stream beside it",
            end / second,
            options.slowdown,
        ),
        Check::new("identities seen twice", identities.twice as f64, 0.0),
        Check::new("images unlike a stream started two frames earlier, pairwise", f64::from(u8::from(!same)), 0.0),
    ];
    println!("\n| | found | at most | |\n|---|---:|---:|---|");
    for Check { what, found, at_most, holds } in &checks {
        println!("| {what} | {found:.4} | {at_most} | {} |", if *holds { "holds" } else { "FAILS" });
    }
    println!(
        "\nCPU time of a step, medians of the young and the long stream: {:.3} and {:.3} ms",
        1e3 * second,
        1e3 * end
    );
    let failed = checks.iter().filter(|check| !check.holds).count();
    let results = Results {
        cpu: machine::cpu(),
        isa: long.engine.workers().level().name().to_owned(),
        threads: long.engine.workers().threads(),
        key_frames: count,
        model: checkpoint.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        checks,
        rows,
    };
    options.json.as_deref().map_or(Ok(()), |path| super::write_json(path, &results))?;
    ensure!(failed == 0, "{failed} checks fail");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_identity_that_comes_back_or_is_shared_is_seen() {
        let interval = |index: u64, identities: &[u64]| {
            let workers = streamsplat::stream::Workers::new(Level::scalar(), 1).expect("one thread");
            let mut engine = Engine::new(Settings { threads: 1, ..Settings::default() }).expect("starts");
            let mut interval =
                engine.push(Frame { width: 2, height: 1, rgb: vec![0.5; 6], depth: None }, 0.0).expect("taken");
            let record = |&identity| streamsplat::stream::Record { identity, frame: index, ..Default::default() };
            (interval.index, interval.workers) = (index, workers);
            interval.gaussians = identities.iter().map(record).collect();
            interval
        };
        let twice = |frames: &[&[u64]]| {
            let mut identities = Identities::default();
            (0..).zip(frames).for_each(|(index, frame)| identities.see(&interval(index, frame)));
            identities.twice
        };
        assert_eq!(twice(&[&[0, 1, 2], &[1, 2, 3], &[3, 4]]), 0);
        assert_eq!(twice(&[&[0, 1, 2], &[1, 3], &[2, 3]]), 1);
        assert_eq!(twice(&[&[0, 1, 1]]), 1);
    }
}
