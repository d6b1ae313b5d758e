//! A stream of thousands of key frames: bounded memory, no slowdown, no identity twice, no drift.
//!
//! The input is a procedural clip, forward and backward without end. It repeats itself every [`PERIOD`] key frames, so
//! that compared periods have the same pictures. The network is a small one of seeded weights. As in a run, motion and
//! colours are also taken from the frames between key frames.
//!
//! Memory is measured in two ways, over whole periods; the first tenth of the stream is compared with the rest. *Live*
//! bytes are those on the process's heap, as their maximum at any moment: they depend on the program alone. *Resident*
//! bytes are those of the process in memory after each step, as the median of a period. They include memory that the
//! system's allocator keeps for later, now and then half a mebibyte more for some steps.
//!
//! Time is the time that all threads of this process spent on a CPU. As that also depends on the machine's load, the
//! long stream is compared twice. First, its last hundred steps with its second hundred, by their lower quartiles.
//! Second, the hundred after those with the second hundred of a *young* stream, which takes the same frames in turn, so
//! that other load disturbs both equally. The second figure has no limit: glibc returns the heap of one of the two
//! threads, by chance, to the system after every step, which costs some per cent (0.90 to 1.05 were measured). Memory
//! is measured until the young stream starts.

use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use serde::Serialize;
use streamsplat::render::Renderer;
use streamsplat::stream::{Fade, Fusion, Interval, ModelSource, MotionFrom, Workers};
use streamsplat::{Camera, Engine, Frame, Image, RenderOptions, Settings};
use streamsplat_bench::table::{Column, Table};
use streamsplat_bench::{machine, timing};
use streamsplat_fixtures::clip::{Clip, ClipKind};
use streamsplat_fixtures::seeded::Sizes;
use streamsplat_kernels::Level;

use crate::live;

/// Key frames after which the pictures are the same again.
const PERIOD: u64 = 50;
/// Frames per second.
const RATE: f64 = 24.0;
/// Key frames in a median time: whole periods.
const HUNDRED: u64 = 100;
/// Key frames of the young stream; the second hundred is measured.
const YOUNG: u64 = 200;
/// The second hundred, and then the young stream's.
const FEWEST: u64 = 200 + YOUNG;
/// Most that live memory may grow after the first tenth.
const LIVE: f64 = 1.02;

/// A long stream.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Key frames: hundreds, at least 400.
    #[arg(long, default_value_t = 10_000)]
    key_frames: u64,
    /// Frames between two key frames, from which motion and colours are taken as in a run; 0: the network's own motion
    /// and colours.
    #[arg(long, default_value_t = 3)]
    between: u64,
    /// Checkpoint [default: a small one of seeded weights].
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Instruction set: scalar, avx2, avx512, avx512vnni, avx512bf16, neon or auto.
    #[arg(long, default_value = "auto", value_parser = streamsplat_bench::level)]
    isa: Level,
    /// Threads (0: one per core).
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// Limit of resident memory after the first tenth of the key frames, relative to its value until then.
    #[arg(long, default_value_t = 1.02)]
    resident: f64,
    /// Limit of the last hundred's time, relative to the second hundred's.
    #[arg(long, default_value_t = 1.05)]
    slowdown: f64,
    /// Leaks this many bytes at every key frame: this must fail.
    #[arg(long, hide = true, default_value_t = 0)]
    leak: usize,
    /// Write the results here as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// One condition that must hold.
#[derive(Serialize)]
struct Check {
    what: &'static str,
    found: f64,
    at_most: f64,
    holds: bool,
}

impl Check {
    fn cells(&self) -> [String; 4] {
        let Check { what, found, at_most, holds } = self;
        let verdict = if *holds { "holds" } else { "FAILS" };
        [what.to_string(), format!("{found:.4}"), at_most.to_string(), verdict.to_owned()]
    }

    fn new(what: &'static str, found: f64, at_most: f64) -> Check {
        Check { what, found, at_most, holds: found <= at_most }
    }
}

/// The state after some key frames.
#[derive(Serialize)]
struct StreamState {
    key_frame: u64,
    /// Most at any moment of the last period; `None` in the comparison with the young stream.
    live_bytes: Option<u64>,
    /// Median of the last period.
    resident_bytes: Option<u64>,
    /// Lower quartile of the hundred key frames before; `None` after the first period.
    cpu_seconds: Option<f64>,
    gaussians: usize,
    identities: u64,
}

#[derive(Serialize)]
struct Results {
    cpu: String,
    isa: String,
    threads: usize,
    key_frames: u64,
    between: u64,
    model: String,
    checks: Vec<Check>,
    /// Largest resident memory at any moment after the first tenth, relative to the largest until then.
    resident_peaks: f64,
    /// The hundred after / the second hundred of the young stream.
    beside_young: f64,
    rows: Vec<StreamState>,
}

/// The endless clip.
struct Film {
    frames: Vec<Frame>,
    /// Frames from one key frame to the next.
    gap: u64,
}

impl Film {
    fn new([height, width]: [usize; 2], gap: u64) -> Film {
        let clip = Clip::new(ClipKind::StaticCamera, 1, width, height);
        // Forward and backward in quick steps: a second of the clip in a period.
        let time = |i| 4.0 * i as f64 / (gap as f64 * RATE);
        let frame = |i| Frame { width, height, rgb: clip.picture(time(i)).rgb, depth: None };
        Film { frames: (0..=PERIOD / 2 * gap).map(frame).collect(), gap }
    }

    /// Frame `i` of the stream; key frames are those of every whole gap.
    fn frame(&self, i: u64) -> (Frame, f64) {
        let period = PERIOD * self.gap;
        let phase = i % period;
        (self.frames[phase.min(period - phase) as usize].clone(), i as f64 / (self.gap as f64 * RATE))
    }

    /// Passes key frame `k` to an engine, with the frames since the previous one.
    fn push(&self, engine: &mut Engine, k: u64) -> Result<Interval> {
        let key = k * self.gap;
        let between = (key.saturating_sub(self.gap - 1)..key).map(|i| self.frame(i)).collect();
        let (frame, time) = self.frame(key);
        Ok(engine.push_with(between, frame, time)?)
    }
}

/// The default network: small, so that ten thousand key frames take minutes.
fn sizes() -> Sizes {
    Sizes::small([32, 48], 24)
}

/// A stream that is drawn, and the CPU time of its last steps.
struct Measured {
    engine: Engine,
    renderer: Renderer,
    /// At most a hundred: [`Measured::hundred`] empties it.
    seconds: Vec<f64>,
}

impl Measured {
    fn new(engine: Engine) -> Result<Measured> {
        let renderer = Renderer::new(engine.workers());
        Ok(Measured { engine, renderer, seconds: Vec::with_capacity(HUNDRED as usize) })
    }

    /// Takes key frame `k` and draws the middle of its interval.
    fn step(&mut self, film: &Film, k: u64) -> Result<Interval> {
        let seconds = || timing::processor_seconds().context("this system has no clock of processor time");
        let start = seconds()?;
        let interval = film.push(&mut self.engine, k)?;
        let time = 0.5 * (interval.start + interval.end);
        self.renderer.render(&interval, time, &Camera::Canonical, &RenderOptions::default())?;
        self.seconds.push(seconds()? - start);
        Ok(interval)
    }

    /// The steps since the last call.
    fn hundred(&mut self) -> Vec<f64> {
        std::mem::replace(&mut self.seconds, Vec::with_capacity(HUNDRED as usize))
    }
}

/// Bytes in periods: those of the first tenth of a stream against the most of all later ones.
struct Growth {
    /// Values of this period.
    seen: Vec<u64>,
    /// Periods of the first tenth that are still to come.
    settling: u64,
    /// Median and most, of the first tenth and of all later periods.
    first: [u64; 2],
    later: [u64; 2],
}

impl Growth {
    /// In a stream of `key_frames` key frames.
    fn of(key_frames: u64) -> Growth {
        let settling = (key_frames / 10).div_ceil(PERIOD).max(1);
        Growth { seen: Vec::new(), settling, first: [0; 2], later: [0; 2] }
    }

    fn see(&mut self, bytes: u64) {
        self.seen.push(bytes);
    }

    /// Ends a period; returns its median and its maximum.
    fn end(&mut self) -> [u64; 2] {
        self.seen.sort_unstable();
        let found =
            [self.seen.get(self.seen.len() / 2), self.seen.last()].map(|bytes| bytes.copied().unwrap_or_default());
        self.seen.clear();
        let most = if self.settling > 0 { &mut self.first } else { &mut self.later };
        *most = [0, 1].map(|i| most[i].max(found[i]));
        self.settling = self.settling.saturating_sub(1);
        found
    }

    /// The largest median and the most after the first tenth, relative to those until then.
    fn ratios(&self) -> [f64; 2] {
        [0, 1].map(|i| self.later[i] as f64 / self.first[i] as f64)
    }
}

/// Ratio of the time of steps `a` to that of the paired steps `b`, which ran first in every second pair: the geometric
/// mean of the medians over both halves.
fn slower(a: &[f64], b: &[f64]) -> f64 {
    let half = |turn| {
        let ratios: Vec<f64> = a.iter().zip(b).skip(turn).step_by(2).map(|(a, b)| a / b).collect();
        rank(&ratios, 2)
    };
    (half(0) * half(1)).sqrt()
}

/// Identities ascend, and an ended one never returns: the check needs no memory of all identities.
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
        // The Gaussians of one frame never share an identity.
        let mut own: Vec<u64> = g.iter().filter(|r| r.frame == interval.index).map(|r| r.identity).collect();
        let count = own.len();
        own.sort_unstable();
        own.dedup();
        self.twice += (count - own.len()) as u64;
        self.newest = self.newest.max(now.last().copied());
        self.alive = now;
    }
}

/// The value a `part`-th of the way from the least to the most: 2 is the median, 4 the lower quartile.
fn rank(values: &[f64], part: usize) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / part).copied().unwrap_or(f64::NAN)
}

/// The images of an interval at its start, middle and end.
fn images(interval: &Interval, workers: &Workers) -> Result<Vec<Image>> {
    let times = [interval.start, 0.5 * (interval.start + interval.end), interval.end];
    let draw = |time| Ok(interval.render(time, &Camera::Canonical, &RenderOptions::default(), workers)?);
    times.into_iter().map(draw).collect()
}

/// Streams, checks, reports.
pub(crate) fn run(options: &Options) -> Result<()> {
    let count = options.key_frames;
    ensure!(
        count >= FEWEST && count.is_multiple_of(HUNDRED),
        "--key-frames {count}: expected at least {FEWEST}, and hundreds"
    );
    let seeded = tempfile::tempdir().context("a folder for the network")?;
    let (checkpoint, name) = match &options.model {
        Some(file) => (file.clone(), file.file_name().unwrap_or_default().to_string_lossy().into_owned()),
        None => {
            let file = seeded.path().join("soak.safetensors");
            sizes().write(31, "model.", &mut BufWriter::new(File::create(&file)?))?;
            std::fs::write(file.with_extension("json"), sizes().json().to_string())?;
            (file, "seeded weights".to_owned())
        }
    };
    let source = ModelSource::File { checkpoint, dinov2: None };
    let seen = (options.between > 0).then_some((MotionFrom::Between, Fade::Fixed, Settings::REFINE));
    let settings = Settings {
        level: Some(options.isa),
        threads: options.threads,
        motion: seen.map(|(motion, ..)| motion),
        fade: seen.map(|(_, fade, _)| fade),
        refine: seen.map(|(.., refine)| refine),
        ..Settings::with_model(source)
    };
    let mut long = Measured::new(Engine::new(settings.clone())?)?;
    drop(seeded);
    // One network for all streams.
    let model = long.engine.model().clone();
    let pairwise = Settings { fusion: Fusion::Pairwise, ..settings.clone() };
    let mut pairs = Engine::with_model(pairwise.clone(), model.clone())?;
    let film = Film::new(long.engine.model().resolution(), options.between + 1);

    let mut identities = Identities::default();
    let mut rows: Vec<StreamState> = Vec::with_capacity(2 + (count / HUNDRED) as usize);
    let [mut live, mut resident] = [Growth::of(count), Growth::of(count)];
    let mut last = None;
    let mut young = None;
    let mut beside = None;
    for k in 0..count {
        if k == count - YOUNG {
            young = Some(Measured::new(Engine::with_model(settings.clone(), model.clone())?)?);
        }
        live::restart();
        // In turn, as the second one finds the caches warm.
        let mut interval = None;
        for turn in [k % 2 == 0, k % 2 == 1] {
            if turn {
                interval = Some(long.step(&film, k)?);
            } else if let Some(young) = &mut young {
                young.step(&film, k)?;
            }
        }
        last = Some(film.push(&mut pairs, k)?);
        let interval = interval.context("a step")?;
        identities.see(&interval);
        std::mem::forget(std::hint::black_box(vec![1u8; options.leak]));
        if young.is_none() {
            live.see(live::most());
            resident.see(live::resident_bytes()?);
        }
        let key_frame = k + 1;
        if !key_frame.is_multiple_of(PERIOD) {
            continue;
        }
        let [live_bytes, resident_bytes] = match young.is_some() {
            // Memory is not that of the long stream alone.
            true => [None, None],
            false => [Some(live.end()[1]), Some(resident.end()[0])],
        };
        let mut cpu_seconds = None;
        if key_frame.is_multiple_of(HUNDRED) {
            let steps = long.hundred();
            cpu_seconds = Some(rank(&steps, 4));
            beside = young.as_mut().map(|young| (steps, young.hundred()));
        } else if key_frame > PERIOD {
            continue;
        }
        let identities = identities.newest.map_or(0, |newest| newest + 1);
        rows.push(StreamState {
            key_frame,
            live_bytes,
            resident_bytes,
            cpu_seconds,
            gaussians: interval.gaussians.len(),
            identities,
        });
        if key_frame.is_multiple_of(1000) {
            let [live, resident] = [live_bytes, resident_bytes].map(|bytes| match bytes {
                Some(bytes) => format!("{:.2} MiB", bytes as f64 / f64::from(1 << 20)),
                None => "-".to_owned(),
            });
            println!("{key_frame} key frames: {live} live, {resident} resident");
        }
    }

    let (long_steps, young_steps) = beside.context("a young stream")?;
    let at = |key_frame: u64| rows.iter().find(|row| row.key_frame == key_frame).and_then(|row| row.cpu_seconds);
    let beside_young = slower(&long_steps, &young_steps);
    let alone = at(count - YOUNG).context("a time")? / at(2 * HUNDRED).context("a time")?;
    let mut fresh = Engine::with_model(pairwise, model.clone())?;
    let mut other = None;
    for k in count - 3..count {
        other = Some(film.push(&mut fresh, k)?);
    }
    let workers = long.engine.workers();
    let same = images(&last.context("an interval")?, workers)? == images(&other.context("an interval")?, workers)?;
    let [_, live_peaks] = live.ratios();
    let [resident, resident_peaks] = resident.ratios();
    let checks = vec![
        Check::new("most live memory after the first tenth / until then", live_peaks, LIVE),
        Check::new("resident memory after the first tenth / until then", resident, options.resident),
        Check::new("CPU time, last hundred / second hundred", alone, options.slowdown),
        Check::new("identities seen twice", identities.twice as f64, 0.0),
        Check::new("images unlike a stream started two frames earlier, pairwise", f64::from(u8::from(!same)), 0.0),
    ];
    let columns = [Column::Text("", 0), Column::Number("found", 0), Column::Number("at most", 0), Column::Text("", 0)];
    print!("\n{}", Table(&columns).markdown(checks.iter().map(Check::cells)));
    println!("\nMost resident memory at any one moment after the first tenth / until then: {resident_peaks:.4}");
    println!("The hundred after / the second hundred of a young stream beside it: {beside_young:.4}");
    let failed = checks.iter().filter(|check| !check.holds).count();
    let results = Results {
        cpu: machine::cpu(),
        isa: long.engine.workers().level().name().to_owned(),
        threads: long.engine.workers().threads(),
        key_frames: count,
        between: options.between,
        model: name,
        checks,
        resident_peaks,
        beside_young,
        rows,
    };
    options.json.as_deref().map_or(Ok(()), |path| streamsplat_bench::write_json(path, &results))?;
    ensure!(failed == 0, "{failed} checks fail");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_is_that_of_whole_periods_after_the_first_tenth() {
        let growth = |key_frames, periods: &[[u64; 3]]| {
            let mut growth = Growth::of(key_frames);
            for period in periods {
                period.iter().for_each(|bytes| growth.see(*bytes));
                let mut sorted = *period;
                sorted.sort_unstable();
                assert_eq!(growth.end(), [sorted[1], sorted[2]]);
            }
            growth.ratios()
        };
        assert_eq!(growth(500, &[[50, 100, 80], [100, 80, 50], [60, 70, 90]]), [1.0, 1.0]);
        assert_eq!(growth(500, &[[50, 100, 80], [110, 80, 50], [60, 88, 90]]), [1.1, 1.1]);
        assert_eq!(growth(500, &[[50, 100, 80], [110, 80, 50], [60, 70, 90]]), [1.0, 1.1]);
        assert_eq!(growth(600, &[[50, 100, 80], [110, 80, 50], [60, 88, 90]]), [1.1, 90.0 / 110.0]);
    }

    #[test]
    fn who_goes_first_does_not_count() {
        // The second is a tenth quicker, and the long stream a twentieth slower.
        let (long, young): (Vec<f64>, Vec<f64>) =
            (0..100).map(|k| if k % 2 == 0 { (1.05, 0.9) } else { (1.05 * 0.9, 1.0) }).unzip();
        assert!((slower(&long, &young) - 1.05).abs() < 1e-12);
    }

    #[test]
    fn an_identity_that_comes_back_or_is_shared_is_seen() {
        let interval = |index: u64, identities: &[u64]| {
            let mut engine = Engine::new(Settings { threads: 1, ..Settings::default() }).expect("starts");
            let mut interval =
                engine.push(Frame { width: 2, height: 1, rgb: vec![0.5; 6], depth: None }, 0.0).expect("taken");
            let record = |&identity| streamsplat::stream::Record { identity, frame: index, ..Default::default() };
            interval.index = index;
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
