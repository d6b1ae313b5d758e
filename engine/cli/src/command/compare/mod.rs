//! `compare`: whether two images, folders of images, videos or scenes are equal, and otherwise where and by how much
//! they differ.

mod account;
mod folders;
mod pictures;
mod scenes;

use std::path::Path;

use serde_json::{Value, json};
use streamsplat::open;
use streamsplat::output::{picture_png, write_file};
use streamsplat::recognise::{self, Kind};
use streamsplat::samples::Part;
use streamsplat::scene::INDEX;

use crate::console::failure::Failure;
use crate::console::{Console, print, say};
use crate::options::args::CompareArgs;

/// Kind of content at a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Content {
    /// An image or a video.
    Pictures,
    /// A folder of images or of other files, for example a rendering.
    Folder,
    /// A scene.
    Scene,
}

impl Content {
    fn of(path: &Path) -> Result<Content, Failure> {
        let found = path.metadata().map_err(|e| Failure::usage(format!("{}: cannot be read: {e}", path.display())))?;
        if !found.is_dir() {
            let scene = path.file_name().is_some_and(|name| name == INDEX) || open::is_scene(path);
            if let Some(Kind::Other(found, advice)) = recognise::kind(path).filter(|_| !scene) {
                let expected = "an image, a video or a scene";
                return Err(Failure::work(format!("{}: expected {expected}, found {found}: {advice}", path.display())));
            }
            return Ok(if scene { Content::Scene } else { Content::Pictures });
        }
        Ok(if path.join(INDEX).exists() { Content::Scene } else { Content::Folder })
    }

    fn name(self) -> &'static str {
        match self {
            Content::Pictures => "an image or a video",
            Content::Folder => "a folder",
            Content::Scene => "a scene",
        }
    }
}

/// Limits on the difference of pictures that still pass.
#[derive(Clone, Copy, Debug, Default)]
struct Tolerance {
    /// Maximum difference of a sample, in steps of 8 bits.
    most: Option<f64>,
    /// Minimum PSNR in dB.
    psnr: Option<f64>,
}

impl Tolerance {
    /// Returns true if there is a limit.
    fn is_given(self) -> bool {
        self.most.is_some() || self.psnr.is_some()
    }

    /// Returns true if a difference is within the limits; without limits no difference passes.
    fn allows(self, largest: f64, psnr: f64) -> bool {
        // 255 times a distance is rounded.
        let within = |most: f64| largest <= most * (1.0 + 4.0 * f64::EPSILON);
        self.is_given() && self.most.is_none_or(within) && self.psnr.is_none_or(|least| psnr >= least)
    }
}

/// The result of a comparison.
struct Outcome {
    /// True if everything is equal or within the limits.
    passed: bool,
    /// Summary in one line.
    summary: String,
    /// Lines for the terminal.
    lines: Vec<String>,
    /// The mean over several pictures that differ, which is printed last.
    mean: Option<String>,
    /// The result as JSON.
    json: Value,
    /// The two pictures that differ most, if they have the same size.
    worst: Option<(Part, Part)>,
}

/// Compares, prints the differences, and fails if they exceed the limits.
pub fn command(args: &CompareArgs, console: &Console) -> Result<(), Failure> {
    let CompareArgs { a, b, .. } = args;
    let limit = |option: &str, value: Option<f64>| match value {
        Some(value) if !(value.is_finite() && value >= 0.0) => {
            Err(Failure::usage(format!("{option} {value}: expected a number from 0")))
        }
        value => Ok(value),
    };
    let tolerance = Tolerance { most: limit("--max-abs", args.max_abs)?, psnr: limit("--psnr", args.psnr)? };
    let found = match (Content::of(a)?, Content::of(b)?) {
        // A run's folder is compared with a scene by the scene in it.
        (Content::Scene, Content::Folder) if b.join("scene").join(INDEX).exists() => (Content::Scene, Content::Scene),
        (Content::Folder, Content::Scene) if a.join("scene").join(INDEX).exists() => (Content::Scene, Content::Scene),
        found => found,
    };
    let outcome = match found {
        (Content::Scene, Content::Scene) => {
            let given = [args.max_abs.is_some(), args.psnr.is_some(), args.heat.is_some()];
            if given.contains(&true) {
                return Err(Failure::usage("--max-abs, --psnr, --heat: expected images or videos, found scenes"));
            }
            scenes::compare(a, b, &args.limit.limits(), &args.machine.workers()?)?
        }
        (Content::Folder, Content::Folder) => {
            folders::compare(a, b, tolerance, &args.limit.limits(), &args.machine.workers()?)?
        }
        (Content::Pictures, Content::Pictures) => pictures::files(a, b, tolerance)?,
        (first, second) => {
            let (first, second) = (first.name(), second.name());
            return Err(Failure::usage(format!(
                "{} and {}: expected two of a kind, found {first} and {second}",
                a.display(),
                b.display()
            )));
        }
    };
    if let (Some(path), Some((a, b))) = (&args.heat, &outcome.worst) {
        write_file(path, &picture_png(&streamsplat::difference::heat(a, b)))?;
    }
    let Outcome { passed, summary, lines, mean, json, .. } = outcome;
    // Names that are not UTF-8 are shown lossily.
    let [a, b] = [a, b].map(|path| path.to_string_lossy());
    let mut found = json!({ "a": a, "b": b, "passed": passed, "summary": summary });
    if let (Value::Object(found), Value::Object(more)) = (&mut found, json) {
        found.extend(more);
    }
    let text = serde_json::to_string_pretty(&found).map_err(Failure::work)? + "\n";
    match args.json.as_deref() {
        Some(path) if path == Path::new("-") => print(text.as_bytes())?,
        other => {
            if let Some(path) = other {
                write_file(path, text.as_bytes())?;
            }
            if !console.quiet {
                lines.iter().try_for_each(say)?;
                if passed {
                    say(&summary)?;
                }
                mean.map_or(Ok(()), say)?;
            }
        }
    }
    if passed {
        return Ok(());
    }
    Err(Failure::work(format!("{a} and {b}: {summary}")))
}
