//! `golden`: records the images of a list of renders once, and later compares them with zero tolerance.

mod junit;
mod list;
mod record;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde_json::{Value, json};
use streamsplat::Image;
use streamsplat::difference::{Difference, Place, heat};
use streamsplat::formats::Limits;
use streamsplat::open::{self, Opened};
use streamsplat::output::{picture_png, prepare_folder, prepare_subfolder, storage, write_file};
use streamsplat::picture::Picture;
use streamsplat::samples::Part;
use streamsplat::source::decode::decode_file;
use streamsplat::stream::Workers;

use self::junit::Case;
use self::list::Render;
use self::record::{Golden, GoldenImage, GoldenRender, PreviewFile};
use crate::command::render::{Stretch, crop};
use crate::command::still;
use crate::console::failure::Failure;
use crate::console::{Console, count, print, say};
use crate::options::args::{GoldenAction, GoldenArgs, GoldenCheckArgs, GoldenRecordArgs};
use crate::options::times;
use streamsplat::run::digest;
use streamsplat::run::drawing::Drawing;
use streamsplat::run::earlier::{is_as_written, remove_file};
use streamsplat::run::options::motion::Course;

/// Records or checks.
pub fn command(args: &GoldenArgs, console: &Console) -> Result<(), Failure> {
    match &args.action {
        GoldenAction::Record(args) => record(args, console),
        GoldenAction::Check(args) => check(args, console),
    }
}

/// Draws one render; returns the digest of its scene.
fn draw(
    render: &Render,
    limits: &Limits,
    workers: &Workers,
    sink: &mut dyn FnMut(f64, Image) -> Result<(), Failure>,
) -> Result<String, Failure> {
    let Render { scene, options, .. } = render;
    let mut views = options.views()?;
    views.options.alpha = views.transparent;
    times::check_rate(options.fps)?;
    let mut drawing = Drawing::new(workers, views.backend)?;
    let scene = match workers.install(|| open::scene(scene, limits))? {
        Opened::Still(file) => {
            let plan = still::Plan::new(&file, options, &views)?;
            let blake3 = file.blake3.clone();
            plan.check_shutter(&file)?;
            let scene = plan.prepare(file, workers)?;
            for (time, views) in plan.images() {
                sink(time, plan.image(&mut drawing, &scene, time, &views, workers)?)?;
            }
            return Ok(blake3);
        }
        Opened::Moving(scene) => scene,
    };
    let fps = options.fps.unwrap_or(scene.index().fps);
    let due = options.due(&scene, &mut views, fps)?;
    crop(&scene, &due, &mut views, fps, workers)?;
    let mut stretch = Stretch::of(&scene);
    for (index, due) in due.into_iter().enumerate() {
        // Images of one scene time are distinguished by the time at which they are shown.
        let shown = if let Some(Course::Held(_)) = views.course { index as f64 / fps } else { due.0 };
        sink(shown, stretch.image(&mut drawing, index, due, &views, fps)?)?;
    }
    Ok(digest::scene(&scene)?)
}

fn picture(image: Image) -> Picture {
    Picture { width: image.width, height: image.height, rgb: image.rgb }
}

fn record(args: &GoldenRecordArgs, console: &Console) -> Result<(), Failure> {
    let renders = list::read(&args.file)?;
    let workers = args.machine.workers()?;
    let folder = record::folder(&args.file);
    let earlier = Golden::read(&args.file).ok();
    prepare_subfolder(&folder)?;
    let mut golden = Golden::new();
    for render in &renders {
        let mut images = Vec::new();
        let scene = draw(render, &args.limit.limits(), &workers, &mut |time, image| {
            let preview = format!("{}-{:06}.png", render.name, images.len());
            let (size, blake3) = ([image.width, image.height], record::digest(&image));
            let written = write_file(&folder.join(&preview), &picture_png(&record::preview(&picture(image))))?;
            let preview_file = Some(PreviewFile { bytes: written.bytes, blake3: written.blake3 });
            images.push(GoldenImage { time, size, blake3, preview, preview_file });
            Ok(())
        })
        .map_err(|e| named(&render.name, e))?;
        if !console.quiet {
            let before = earlier.as_ref().and_then(|earlier| earlier.renders.get(&render.name));
            say(format!("{}: {}, {}", render.name, count(images.len(), "image"), against(before, &scene, &images)))?;
        }
        golden.renders.insert(render.name.clone(), GoldenRender { scene, images });
    }
    write_file(&record::path(&args.file), golden.to_json()?.as_bytes())?;
    let images = |golden: &Golden| golden.renders.values().flat_map(|render| render.images.clone()).collect::<Vec<_>>();
    let names: BTreeSet<String> = images(&golden).into_iter().map(|image| image.preview).collect();
    for old in earlier.iter().flat_map(images).filter(|old| !names.contains(&old.preview)) {
        // Only files that a recording wrote are removed. A file that is already gone needs no removal.
        let path = folder.join(&old.preview);
        let ours = match &old.preview_file {
            Some(file) => is_as_written(&folder, &old.preview, file.bytes, &file.blake3)?,
            None => false,
        };
        if ours {
            remove_file(&path)?;
        } else if storage::exists(&path) {
            console.note(&[format!("{}: left, for it is not what an earlier recording wrote", path.display())]);
        }
    }
    if !console.quiet {
        let renders = count(renders.len(), "render");
        say(format!("{}: {renders}, bit contract {}", folder.display(), golden.bit_contract))?;
    }
    Ok(())
}

/// Describes how a render's images differ from an earlier recording's.
fn against(before: Option<&GoldenRender>, scene: &str, images: &[GoldenImage]) -> String {
    let Some(before) = before else { return "new".to_owned() };
    let same = |(old, new): (&GoldenImage, &GoldenImage)| {
        (old.size, &old.blake3, old.time.to_bits()) == (new.size, &new.blake3, new.time.to_bits())
    };
    let equal = before.images.iter().zip(images).filter(|pair| same(*pair)).count();
    match images.len().max(before.images.len()) - equal {
        0 if before.scene == scene => "unchanged".to_owned(),
        0 => "unchanged, of a scene that changed".to_owned(),
        changed => format!("{changed} changed"),
    }
}

fn named(name: &str, failure: Failure) -> Failure {
    match failure {
        Failure::Usage(text) => Failure::Usage(format!("{name}: {text}")),
        Failure::Work(text) => Failure::Work(format!("{name}: {text}")),
        stopped => stopped,
    }
}

/// The result of one image.
struct Check {
    render: String,
    /// `None` if nothing was drawn.
    time: Option<f64>,
    failure: Option<String>,
    found: Value,
    seconds: f64,
}

impl Check {
    fn image(&self) -> String {
        self.time.map_or_else(|| "render".to_owned(), |time| format!("{time} s"))
    }

    fn failed(render: &str, failure: String) -> Check {
        Check { render: render.to_owned(), time: None, failure: Some(failure), found: json!({}), seconds: 0.0 }
    }
}

/// Writer of images that differ, next to the expected ones.
struct Failures {
    folder: PathBuf,
    /// True if the user named the folder, which may then be a link.
    given: bool,
    record: PathBuf,
    prepared: bool,
}

impl Failures {
    /// Writes `NAME.actual.png` and, if a preview was recorded, `NAME.expected.png` and `NAME.heat.png`. Returns their
    /// difference as text and JSON.
    fn write(
        &mut self,
        name: &str,
        actual: &Picture,
        expected: Option<&GoldenImage>,
    ) -> Result<(String, Value), Failure> {
        if !self.prepared {
            match self.given {
                true => prepare_folder(&self.folder)?,
                false => prepare_subfolder(&self.folder)?,
            }
            self.prepared = true;
        }
        let path = |kind: &str| self.folder.join(format!("{name}.{kind}.png"));
        write_file(&path("actual"), &picture_png(actual))?;
        let preview = expected.map(|expected| decode_file(&self.record.join(&expected.preview)));
        let Some(Ok(preview)) = preview else { return Ok((String::new(), Value::Null)) };
        write_file(&path("expected"), &picture_png(&preview))?;
        let small = record::preview(actual);
        if (preview.width, preview.height) != (small.width, small.height) {
            return Ok((String::new(), Value::Null));
        }
        let (preview, small) = (Part::from(&preview), Part::from(&small));
        let found = Difference::between(&preview, &small);
        write_file(&path("heat"), &picture_png(&heat(&preview, &small)))?;
        let largest = found.largest * 255.0;
        let value = json!({ "largest": largest, "psnr": found.psnr, "share": found.share });
        Ok(match found.place {
            None => ("by less than the preview shows".to_owned(), value),
            Some(Place { column, row, .. }) => (
                format!(
                    "by {largest:.0}/255 at most, at {column},{row} of the preview; PSNR {:.1} dB, {:.2} % of its pixels",
                    found.psnr,
                    100.0 * found.share
                ),
                value,
            ),
        })
    }
}

/// Compares one render with its record.
fn compare(
    render: &Render,
    expected: &GoldenRender,
    limits: &Limits,
    workers: &Workers,
    failures: &mut Failures,
) -> Vec<Check> {
    let mut rows: Vec<Check> = Vec::new();
    let mut begun = Instant::now();
    let drawn = draw(render, limits, workers, &mut |time, image| {
        let at = rows.len();
        let (size, found) = ([image.width, image.height], record::digest(&image));
        let wanted = expected.images.get(at);
        let cause = match wanted {
            None => Some("more images than were recorded".to_owned()),
            Some(wanted) if wanted.size != size => {
                let ([w, h], [x, y]) = (wanted.size, size);
                Some(format!("expected {w}x{h} pixels, found {x}x{y}"))
            }
            Some(wanted) if wanted.time.to_bits() != time.to_bits() => {
                Some(format!("expected the time {} s, found {time} s", wanted.time))
            }
            Some(wanted) if wanted.blake3 != found => Some("the image differs".to_owned()),
            Some(_) => None,
        };
        let other_size = wanted.is_some_and(|wanted| wanted.size != size);
        let mut value = json!({ "size": size, "blake3": found, "expected": wanted.map(|wanted| &wanted.blake3) });
        let failure = match cause {
            None => None,
            Some(cause) => {
                let (far, preview) = failures.write(&format!("{}-{at:06}", render.name), &picture(image), wanted)?;
                value["preview"] = preview;
                Some(if other_size || far.is_empty() { cause } else { format!("{cause} {far}") })
            }
        };
        let seconds = begun.elapsed().as_secs_f64();
        begun = Instant::now();
        rows.push(Check { render: render.name.clone(), time: Some(time), failure, found: value, seconds });
        Ok(())
    });
    match drawn {
        Err(failure) => rows.push(Check::failed(&render.name, failure.message())),
        Ok(scene) => {
            let missing = expected.images.len().saturating_sub(rows.len());
            if missing > 0 {
                rows.push(Check::failed(
                    &render.name,
                    format!("{}: not drawn any more", count(missing, "recorded image")),
                ));
            }
            if scene != expected.scene {
                let differ = rows.iter().any(|row| row.failure.is_some());
                let images = if differ { "" } else { ", and no bit of an image" };
                rows.push(Check::failed(
                    &render.name,
                    format!("the scene changed{images}: {}", render.scene.display()),
                ));
            }
        }
    }
    rows
}

fn check(args: &GoldenCheckArgs, console: &Console) -> Result<(), Failure> {
    let renders = list::read(&args.file)?;
    let golden = Golden::read(&args.file)?;
    let (workers, limits) = (args.machine.workers()?, args.limit.limits());
    let folder = args.out.clone().unwrap_or_else(|| args.file.with_extension("failed"));
    let (given, record) = (args.out.is_some(), record::folder(&args.file));
    let mut failures = Failures { folder: folder.clone(), given, record, prepared: false };
    let mut rows = Vec::new();
    for render in &renders {
        match golden.renders.get(&render.name) {
            Some(expected) => rows.extend(compare(render, expected, &limits, &workers, &mut failures)),
            None => rows.push(Check::failed(&render.name, "not recorded yet".to_owned())),
        }
    }
    for name in golden.renders.keys().filter(|name| renders.iter().all(|render| render.name != **name)) {
        rows.push(Check::failed(name, "recorded, but not in the list any more".to_owned()));
    }
    let failed = rows.iter().filter(|row| row.failure.is_some()).count();
    let contract = (golden.bit_contract != streamsplat::BIT_CONTRACT).then(|| {
        format!(
            "the record was made under version {} of the bit contract by {PROGRAM} {}, this program keeps version {}: images may differ by right, and are to be recorded again",
            golden.bit_contract,
            golden.version,
            streamsplat::BIT_CONTRACT,
            PROGRAM = golden.program,
        )
    });
    if let Some(path) = &args.junit {
        let case = |row: &Check| {
            let failure = row.failure.as_ref().map(|failure| match &contract {
                Some(contract) => format!("{failure}; {contract}"),
                None => failure.clone(),
            });
            Case { render: row.render.clone(), image: row.image(), failure, seconds: row.seconds }
        };
        let suite = args.file.file_stem().unwrap_or_default().to_string_lossy();
        let xml = junit::xml(&suite, &rows.iter().map(case).collect::<Vec<_>>()).map_err(Failure::work)?;
        write_file(path, &xml)?;
    }
    show(args, console, &golden, &rows, contract.as_deref().filter(|_| failed > 0))?;
    if failed == 0 {
        return Ok(());
    }
    let beside = if failures.prepared { format!("; see {}", folder.display()) } else { String::new() };
    let contract = contract.map_or_else(String::new, |contract| format!("; {contract}"));
    Err(Failure::work(format!("{}: {}{beside}{contract}", args.file.display(), failed_of(&rows))))
}

/// Counts what failed: images, and the checks of a list, a scene or a number of images.
fn failed_of(rows: &[Check]) -> String {
    let (images, others): (Vec<&Check>, Vec<&Check>) = rows.iter().partition(|row| row.time.is_some());
    let failed = |rows: &[&Check]| rows.iter().filter(|row| row.failure.is_some()).count();
    let mut parts = Vec::new();
    if failed(&images) > 0 {
        parts.push(format!("{} of {} differ", failed(&images), count(images.len(), "image")));
    }
    if failed(&others) > 0 {
        parts
            .push(format!("{} failed", count(failed(&others), if parts.is_empty() { "check" } else { "other check" })));
    }
    parts.join(", ")
}

/// Prints the table, or JSON.
fn show(
    args: &GoldenCheckArgs,
    console: &Console,
    golden: &Golden,
    rows: &[Check],
    contract: Option<&str>,
) -> Result<(), Failure> {
    let passed = rows.iter().all(|row| row.failure.is_none());
    let checks: Vec<Value> = rows
        .iter()
        .map(|row| {
            let mut value = json!({ "render": row.render, "time": row.time, "passed": row.failure.is_none(), "failure": row.failure });
            if let (Value::Object(value), Value::Object(found)) = (&mut value, &row.found) {
                value.extend(found.clone());
            }
            value
        })
        .collect();
    let found = json!({
        "list": args.file,
        "passed": passed,
        "bit_contract": streamsplat::BIT_CONTRACT,
        "recorded_bit_contract": golden.bit_contract,
        "checks": checks,
    });
    let text = serde_json::to_string_pretty(&found).map_err(Failure::work)? + "\n";
    if let Some(path) = &args.json {
        if path == Path::new("-") {
            return print(text.as_bytes());
        }
        write_file(path, text.as_bytes())?;
    }
    if console.quiet {
        return Ok(());
    }
    contract.map_or(Ok(()), say)?;
    let width = rows.iter().map(|row| row.render.len()).max().unwrap_or_default().max(6);
    let column = rows.iter().map(|row| row.image().len()).max().unwrap_or_default().max(5);
    say(format!("{:width$}  {:column$}  result", "render", "image"))?;
    for row in rows {
        let result = row.failure.as_deref().unwrap_or("equal");
        say(format!("{:width$}  {:column$}  {result}", row.render, row.image()))?;
    }
    if passed {
        say(format!("{}: equal ({})", args.file.display(), count(rows.len(), "image")))?;
    }
    Ok(())
}
