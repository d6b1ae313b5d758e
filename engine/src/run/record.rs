//! `run.json`: the record of a run, by which it can be repeated and compared.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::time::Instant;

use crate::formats::read_text;
use crate::stream::{StageWork, Work, Workers};
use serde::{Deserialize, Serialize};

use crate::run::options::RunOptions;
use crate::run::{Error, digest};
use crate::source::MEMORY;

/// Longest record read, in bytes.
const MAX_RECORD: u64 = 1 << 28;

/// Value of the field `program`.
pub const PROGRAM: &str = "streamsplat";

/// Content of the file. Everything but `timing` is a function of model, input, options and seed alone. Where a graphics
/// card drew, so is everything but `timing`, `renderer` and the outputs marked `outside_contract`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Record {
    /// [`PROGRAM`].
    pub program: String,
    /// The program's version.
    pub version: String,
    /// Properties of the program, in addition to its version, that determine output bytes.
    #[serde(flatten)]
    pub build: Build,
    /// The command, with every option that affects the output.
    #[serde(flatten)]
    pub task: Invocation,
    /// The seed of everything drawn at random.
    pub seed: u64,
    /// The checkpoint.
    pub model: Option<ModelRecord>,
    /// The depth network, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<NetworkRecord>,
    /// Input of the run or rendering.
    pub input: InputRecord,
    /// Renderer of the images.
    pub renderer: RendererRecord,
    /// False when the user stopped it; the files written are valid.
    pub complete: bool,
    /// Every file written, by its path inside the folder.
    pub outputs: BTreeMap<String, OutputRecord>,
    /// Work done and work avoided.
    pub work: BTreeMap<String, WorkRecord>,
    /// Gaussians left out because one of their numbers was not finite.
    pub dropped: u64,
    /// Width and height of the images.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image_size: Option<[usize; 2]>,
    /// Key frames of a run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub key_frames: Option<u64>,
    /// Mean PSNR of the images of all frames at the size at which the model sees them, in dB, where key frames depend
    /// on it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psnr: Option<f64>,
    /// Width and height of that size.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psnr_size: Option<[usize; 2]>,
    /// Mean PSNR of the same images at the source's own size, in dB, where they are of that size.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psnr_source_size: Option<f64>,
    /// PSNR of the worst frame's image at the source's own size, or else at the size at which the model sees it, in dB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psnr_least: Option<f64>,
    /// Measurements that differ from run to run.
    pub timing: Timing,
}

/// Properties of the program, in addition to its version, that determine output bytes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Build {
    /// Version of the bit contract ([`crate::BIT_CONTRACT`]).
    pub bit_contract: u32,
    /// The commit that the program was built from; where that is not known, the digest of its file.
    #[serde(rename = "build")]
    pub program: String,
}

impl Build {
    /// The build from this commit; without one, the digest of the program's file identifies it.
    pub fn of(commit: Option<&str>) -> Build {
        static PROGRAM: LazyLock<String> = LazyLock::new(|| {
            std::env::current_exe().ok().and_then(|file| digest::file(&file).ok()).unwrap_or_default()
        });
        let program = commit.map_or_else(|| PROGRAM.clone(), str::to_owned);
        Build { bit_contract: crate::BIT_CONTRACT, program }
    }
}

/// The command and its options.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "command", content = "options", rename_all = "lowercase")]
pub enum Invocation {
    /// `run`.
    Run(Box<RunOptions>),
    /// `render`.
    Render(serde_json::Value),
}

/// The checkpoint that was used.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModelRecord {
    /// Its file, or `embedded`.
    pub path: String,
    /// BLAKE3 of the checkpoint and its configuration.
    pub blake3: String,
}

/// A network that ONNX Runtime ran. Its arithmetic is the runtime's: another version may produce other bits.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NetworkRecord {
    /// Its file.
    pub path: String,
    /// BLAKE3 of the file, and of its weights where they are in a file next to it.
    pub blake3: String,
    /// Name and version of the runtime.
    pub runtime: String,
}

impl NetworkRecord {
    /// The record of the network in `file`, run by this version of the runtime.
    pub fn of(file: &Path, runtime: &str) -> Result<NetworkRecord, Error> {
        let (path, blake3) = (absolute(file).display().to_string(), NetworkRecord::digest(file)?);
        Ok(NetworkRecord { path, blake3, runtime: format!("ONNX Runtime {runtime}") })
    }

    /// BLAKE3 of a network, whose weights may be in a file next to it.
    pub fn digest(file: &Path) -> Result<String, Error> {
        let mut files = vec![file.to_owned()];
        for ending in [".data", "_data"] {
            let mut beside = file.as_os_str().to_owned();
            beside.push(ending);
            files.extend(Some(PathBuf::from(beside)).filter(|path| path.is_file()));
        }
        digest::files(&files)
    }
}

/// Counts of rendering work, done and avoided.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Counts {
    /// Images.
    pub images: u64,
    /// Width and height of the last one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<[usize; 2]>,
    /// Gaussians drawn and left out; tiles drawn and reused; list entries blended and skipped; planes computed and not;
    /// images with turned splats and without; Gaussians projected and left out before projection.
    pub raster: [[u64; 2]; 6],
    /// Gaussians left out because one of their numbers was not finite.
    pub dropped: u64,
    /// Parts of turned images that were never filmed.
    pub unfilmed: Unfilmed,
}

/// Parts of turned images of a scene in time that were never filmed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Unfilmed {
    /// Pixels that are less than half covered, and the others.
    pub pixels: [u64; 2],
    /// Of the image with the largest share of these pixels: the angle to the source's own view, in degrees, and the
    /// share.
    pub worst: Option<[f64; 2]>,
    /// The smallest angle, in degrees, of an image whose share is above [`Unfilmed::LITTLE`].
    pub fails: Option<f64>,
    /// The smaller angles of other images, in whole degrees rounded down.
    pub holds: BTreeSet<u16>,
}

impl Unfilmed {
    /// A share of pixels that is hardly noticed.
    pub const LITTLE: f64 = 0.02;

    /// Adds an image: number of pixels, uncovered share, and angle in degrees.
    pub fn add(&mut self, pixels: u64, share: f64, degrees: f64) {
        // Beyond half a turn the filmed view comes nearer again.
        let degrees = (degrees % 360.0).min(360.0 - degrees % 360.0);
        let missing = (share * pixels as f64).round() as u64;
        self.pixels[0] += missing;
        self.pixels[1] += pixels - missing.min(pixels);
        if self.worst.is_none_or(|[_, worst]| share > worst) {
            self.worst = Some([degrees, share]);
        }
        if share > Self::LITTLE {
            self.fails = Some(self.fails.map_or(degrees, |least| least.min(degrees)));
            self.holds.retain(|held| f64::from(*held) < degrees);
        } else if self.fails.is_none_or(|least| degrees < least) {
            // At most 180, as folded above.
            self.holds.insert(degrees as u16);
        }
    }

    /// A note for the user, if a notable part was never filmed.
    pub fn note(&self, filled: bool) -> Option<String> {
        let [degrees, share] = self.worst.filter(|[_, share]| *share > Self::LITTLE)?;
        let shows = if filled { "the colours around it (--fill)" } else { "the background" };
        let found = format!(
            "at {degrees:.0} degrees from the filmed view {:.0} % of an image was never filmed and shows {shows}",
            100.0 * share
        );
        let most = 100.0 * Self::LITTLE;
        Some(match self.holds.last() {
            Some(holds @ 1..) => format!("{found}; up to {holds} degrees it is at most {most:.0} %"),
            _ => found,
        })
    }
}

/// Renderer of the images.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RendererRecord {
    /// `cpu` or `wgpu`.
    pub name: String,
    /// The graphics card.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub adapter: Option<String>,
    /// True if the images are bit-identical on every machine.
    pub bit_contract: bool,
}

impl std::fmt::Display for RendererRecord {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.name)?;
        self.adapter.as_ref().map_or(Ok(()), |adapter| write!(f, " on {adapter}"))
    }
}

/// Input of a run or rendering.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InputRecord {
    /// The input as an absolute path, `-`, or [`MEMORY`].
    pub path: PathBuf,
    /// BLAKE3 of the decoded frames, or of the scene's index.
    pub blake3: String,
    /// Frames or intervals read.
    pub count: usize,
    /// Width and height of a frame.
    pub size: [usize; 2],
    /// Frames per second.
    pub fps: f64,
    /// Why the input ended early or what was irregular in it; the frames before were used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damage: Option<String>,
}

/// A file that was written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputRecord {
    /// Its length.
    pub bytes: u64,
    /// BLAKE3 of the file.
    pub blake3: String,
    /// For a video: BLAKE3 of the samples that were encoded, by which a repetition is compared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples: Option<String>,
    /// True if a graphics card drew it: a repetition produces other bytes.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub outside_contract: bool,
}

/// One stage's account.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorkRecord {
    /// Work done.
    pub done: u64,
    /// Work that was not needed.
    pub avoided: u64,
    /// Unit of the counts.
    pub unit: String,
}

/// Measurements that differ from run to run.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Timing {
    /// Seconds in all.
    pub total: f64,
    /// Seconds per stage, summed over tiles of a frame, which run at the same time.
    pub seconds: BTreeMap<String, f64>,
    /// Peak resident memory in bytes.
    pub peak_resident_bytes: Option<u64>,
    /// Threads.
    pub threads: usize,
    /// Instruction set.
    pub isa: String,
}

impl Timing {
    /// Timing of work that began at `start` and ends now.
    pub fn of(start: Instant, seconds: BTreeMap<String, f64>, workers: &Workers) -> Timing {
        Timing {
            total: start.elapsed().as_secs_f64(),
            seconds,
            peak_resident_bytes: peak_resident_bytes(),
            threads: workers.threads(),
            isa: workers.level().name().to_owned(),
        }
    }
}

/// Peak resident memory of this process in bytes, where the system reports it.
fn peak_resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kilobytes * 1024)
}

/// The engine's account over a run, parts of which earlier processes may have done.
#[derive(Default)]
pub struct Account {
    /// Work done by earlier processes, by stage.
    before: BTreeMap<String, WorkRecord>,
    /// Work that this process did only to reach the resume point, by stage.
    caught_up: BTreeMap<String, WorkRecord>,
}

impl Account {
    /// Starts counting here, after the work `before`.
    pub fn restart(&mut self, before: BTreeMap<String, WorkRecord>, now: &Work) {
        self.before = before;
        self.caught_up = records(now);
    }

    /// The account of the whole run.
    pub fn of(&self, now: &Work) -> BTreeMap<String, WorkRecord> {
        let mut all = records(now);
        for (stage, work) in &mut all {
            if let Some(less) = self.caught_up.get(stage) {
                work.done -= less.done;
                work.avoided -= less.avoided;
            }
            if let Some(more) = self.before.get(stage) {
                work.done += more.done;
                work.avoided += more.avoided;
            }
        }
        all
    }
}

fn records(work: &Work) -> BTreeMap<String, WorkRecord> {
    let record = |s: &StageWork| WorkRecord { done: s.done, avoided: s.avoided, unit: s.unit.to_owned() };
    work.stages().iter().map(|stage| (stage.stage.to_owned(), record(stage))).collect()
}

impl Record {
    /// Returns the record as JSON text.
    pub fn to_json(&self) -> Result<String, Error> {
        serde_json::to_string_pretty(self).map(|text| text + "\n").map_err(|e| Error::work(format!("run.json: {e}")))
    }

    /// Reads a `run.json`.
    pub fn read(path: &Path) -> Result<Record, Error> {
        let wrong = |e: &dyn std::fmt::Display| Error::work(format!("{}: {e}", path.display()));
        let text = read_text(path, MAX_RECORD).map_err(|e| wrong(&e))?;
        Record::parse(&text).map_err(|e| wrong(&e))
    }

    /// Reads the text of a `run.json`.
    fn parse(text: &str) -> Result<Record, String> {
        let record: Record = serde_json::from_str(text).map_err(|e| format!("not the record of a run: {e}"))?;
        if record.program != PROGRAM {
            return Err(format!("expected a record of {PROGRAM}, found {:?}", record.program));
        }
        Ok(record)
    }
}

/// Refuses a path that a record, which is JSON, cannot hold.
pub fn check_name(path: &Path) -> Result<(), Error> {
    match absolute(path).to_str() {
        Some(_) => Ok(()),
        None => Err(Error::usage(format!("{}: expected a name in UTF-8, as run.json holds it", path.display()))),
    }
}

/// Makes `path` absolute; `-` and [`MEMORY`] stay.
pub fn absolute(path: &Path) -> PathBuf {
    if path == Path::new("-") || path == Path::new(MEMORY) {
        return path.to_owned();
    }
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use proptest::sample::{Index, select};

    use super::*;
    use crate::run::options::{StreamOptions, ViewOptions};

    /// Records in which every optional field is set.
    fn texts() -> [String; 2] {
        let output = |samples: Option<&str>, outside_contract| OutputRecord {
            bytes: 900,
            blake3: "cd".repeat(32),
            samples: samples.map(str::to_owned),
            outside_contract,
        };
        let run = RunOptions {
            stream: StreamOptions { gap: "auto".parse().ok(), ..StreamOptions::default() },
            view: ViewOptions { size: "64x48".parse().ok(), ..ViewOptions::default() },
            frames: Some(9),
            ..RunOptions::default()
        };
        let record = Record {
            program: PROGRAM.to_owned(),
            version: "0.1.0".to_owned(),
            build: Build { bit_contract: 1, program: "abc".to_owned() },
            task: Invocation::Run(Box::new(run)),
            seed: 7,
            model: Some(ModelRecord { path: "embedded".into(), blake3: "ab".repeat(32) }),
            depth: Some(NetworkRecord {
                path: "d.onnx".into(),
                blake3: "01".repeat(32),
                runtime: "ONNX Runtime".into(),
            }),
            input: InputRecord {
                path: "/in.y4m".into(),
                blake3: String::new(),
                count: 9,
                size: [64, 48],
                fps: 23.976,
                damage: Some("cut".into()),
            },
            renderer: RendererRecord { name: "wgpu".into(), adapter: Some("a card".into()), bit_contract: false },
            complete: true,
            outputs: [("frames/0.png", output(None, true)), ("v.mp4", output(Some("ef"), false))]
                .map(|(name, output)| (name.to_owned(), output))
                .into(),
            work: [("encoder".to_owned(), WorkRecord { done: 9, avoided: 1, unit: "frames".into() })].into(),
            dropped: 3,
            image_size: Some([640, 480]),
            key_frames: None,
            psnr: None,
            psnr_size: None,
            psnr_source_size: None,
            psnr_least: None,
            timing: Timing { total: 0.1, threads: 2, isa: "avx2".into(), ..Timing::default() },
        };
        let render = Record {
            task: Invocation::Render(serde_json::json!({ "view": { "size": "model" }, "fps": 12.5, "emit": null })),
            model: None,
            depth: None,
            renderer: RendererRecord { name: "cpu".into(), adapter: None, bit_contract: true },
            ..record.clone()
        };
        [record, render].map(|record| record.to_json().expect("text"))
    }

    /// Checks that a record is the same after it is written and read.
    fn survives(record: &Record) {
        let text = record.to_json().expect("text");
        assert_eq!(Record::parse(&text).expect("what was written").to_json().expect("text"), text);
    }

    #[test]
    fn the_angle_up_to_which_little_is_missing_lies_below_all_others() {
        let mut unfilmed = Unfilmed::default();
        for (degrees, share) in [(0.0, 0.0), (270.0, 0.3), (356.0, 0.01), (90.0, 0.86), (180.0, 0.0), (8.0, 0.02)] {
            unfilmed.add(1000, share, degrees);
        }
        let note = unfilmed.note(true).expect("much is missing");
        assert!(note.starts_with("at 90 degrees") && note.ends_with("up to 8 degrees it is at most 2 %"), "{note}");
        // A long run stores no more than a number per degree.
        (0..100_000).for_each(|i| unfilmed.add(1000, 0.0, f64::from(i) / 20_000.0));
        assert_eq!(unfilmed.holds.len(), 6);
    }

    #[test]
    fn records_are_read_as_they_were_written() {
        for text in texts() {
            let record = Record::parse(&text).expect("a record");
            assert_eq!(record.to_json().expect("text"), text);
            assert!(Record::parse(&text.replace(PROGRAM, "another")).is_err_and(|e| e.contains("found \"another\"")));
        }
    }

    /// Fragments inserted to corrupt a file.
    const WORDS: [&str; 24] = [
        "",
        "0",
        "-1",
        "1e999",
        "1e-999",
        "18446744073709551616",
        "0.5",
        "null",
        "true",
        "[",
        "]",
        "{",
        "}",
        "{}",
        "[]",
        "\"",
        "\\u",
        ",",
        ":",
        "\"run\"",
        "\"render\"",
        "\"options\":",
        "\"timing\":",
        "\u{0}",
    ];

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4096))]

        #[test]
        fn no_text_panics(
            which in 0_usize..2,
            changes in proptest::collection::vec((any::<Index>(), 0_usize..24, select(&WORDS[..])), 1..4),
        ) {
            let mut text = texts()[which].clone();
            for (at, length, word) in changes {
                let at = at.index(text.len());
                text.replace_range(at..(at + length).min(text.len()), word);
            }
            if let Ok(record) = Record::parse(&text) {
                survives(&record);
            }
        }
    }
}
