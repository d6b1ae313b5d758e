//! Destinations of results: a folder, a video file, or standard output.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use crate::Image;
use crate::formats;
use crate::output::{
    OutputError, Pace, Video, VideoPoint, Written, depth_exr, folder_of, layered_exr, picture_png, picture_webp,
    plane_png, prepare_subfolder, storage, transparent_exr, transparent_png, write_whole,
};
use crate::picture::Picture;
use crate::render::Backend;
use crate::scene::{ContainerWriter, IntervalEntry, SceneWriter, to_safetensors};
use crate::source::Sound;
use crate::still::Still;
use crate::stream::{Interval, ResumePoint, Snapshot, Workers};

pub use crate::run::destination::Destination;
use crate::run::earlier::{find_earlier, remove_earlier, remove_file};
pub use crate::run::emit::{Emit, UnknownOutput};
use crate::run::ledger::Ledger;
use crate::run::place::Place;
use crate::run::record::OutputRecord;
use crate::run::resume_state::Point;
use crate::run::{Error, emit, ledger, resume_state};

/// Writes results and keeps their digests.
pub struct Outputs {
    destination: Destination,
    emit: Emit,
    video: Option<Video>,
    scene: Option<SceneWriter>,
    /// The scene next to a video.
    container: Option<ContainerWriter>,
    written: BTreeMap<String, OutputRecord>,
    ledger: Option<Ledger>,
    /// Intervals of a resumed scene.
    intervals: Vec<IntervalEntry>,
    /// True if images are outside of the bit contract.
    outside: bool,
    /// True if images keep their alpha.
    alpha: bool,
    /// Sound for the video.
    sound: Option<Sound>,
    /// The video's rate factor, if not the default.
    quality: Option<u8>,
    /// Folders of kinds that were created for these results.
    made: Vec<PathBuf>,
    /// Files of an earlier run in the folder, until the first file is written.
    earlier: Option<Vec<PathBuf>>,
    /// Frames per second of the scene.
    fps: f64,
}

/// Results of a finished output.
#[derive(Default)]
pub struct Finished {
    /// The files, by their names.
    pub outputs: BTreeMap<String, OutputRecord>,
    /// Differences of a video from the input, one per line.
    pub notes: Vec<String>,
}

impl Outputs {
    /// Prepares the place, and fails early if it cannot be written. The results of an earlier run there are removed
    /// before the first file is written.
    pub fn create(place: &mut Place, emit: Emit) -> Result<Outputs, Error> {
        place.hold()?;
        let destination = place.destination().clone();
        let (mut made, mut earlier) = (Vec::new(), None);
        match &destination {
            Destination::Folder(folder) => {
                earlier = Some(find_earlier(folder)?);
                made.extend(emit.folders().into_iter().map(|name| folder.join(name)).filter(|path| !path.exists()));
                prepare_kinds(folder, emit)?;
            }
            Destination::Video(path, format) => {
                if emit != (Emit { rgb: emit.rgb, scene: emit.scene, ..Emit::default() }) {
                    return Err(Error::usage(
                        "--emit: a video holds rgb alone, and a scene lies beside it; give --out a folder for the rest",
                    ));
                }
                if emit.scene && destination.container().is_none() {
                    return Err(Error::usage(format!(
                        "--emit scene: expected a folder or an encoded video, beside which the scene lies, found --out {}",
                        path.display()
                    )));
                }
                drop(Video::create(path, *format, Pace::even(1.0))?);
                if let Some(folder) = destination.resume() {
                    resume_state::remove(&folder)?;
                }
            }
        }
        Ok(Outputs { made, earlier, ..Outputs::new(destination, emit) })
    }

    /// Releases the place, and removes the folders that were created for it and are empty.
    pub fn withdraw(self, place: &mut Place) {
        for folder in &self.made {
            let _ = std::fs::remove_dir(folder);
        }
        place.withdraw();
    }

    fn new(destination: Destination, emit: Emit) -> Outputs {
        let (written, intervals) = (BTreeMap::new(), Vec::new());
        let (outside, alpha) = (false, false);
        let (video, scene, container, ledger, sound, quality) = (None, None, None, None, None, None);
        Outputs {
            destination,
            emit,
            video,
            scene,
            container,
            written,
            ledger,
            intervals,
            outside,
            alpha,
            sound,
            quality,
            made: Vec::new(),
            earlier: None,
            fps: 0.0,
        }
    }

    /// Sets the sound of the video.
    pub fn sound(&mut self, sound: Option<Sound>) {
        self.sound = sound;
    }

    /// Sets the rate factor of an encoded video.
    pub fn quality(&mut self, crf: Option<u8>) {
        self.quality = crf;
    }

    /// Sets whether there is no background and colour images are written with their alpha.
    pub fn keep_alpha(&mut self, keep: bool) -> Result<(), Error> {
        if keep && matches!(self.destination, Destination::Video(..)) {
            return Err(Error::usage(
                "--background transparent: a video has no alpha; give --out a folder or a .png, .webp or .exr file",
            ));
        }
        self.alpha = keep;
        Ok(())
    }

    /// Sets the backend that draws the images.
    pub fn drawn_by(&mut self, backend: Backend) {
        self.outside = !backend.is_within_contract();
    }

    /// Starts a ledger if the destination supports `--resume`.
    pub fn with_ledger(mut self) -> Outputs {
        self.ledger = self.destination.resume().map(Ledger::new);
        self
    }

    /// Resumes with the results listed in the first `length` bytes of the ledger in `folder`. In a folder of results
    /// each file must be unchanged.
    pub fn resume(destination: Destination, emit: Emit, folder: PathBuf, length: u64) -> Result<Outputs, Error> {
        let lines = ledger::read(&folder, length)?;
        let mut outputs = Outputs::new(destination, emit);
        if let Destination::Folder(folder) = &outputs.destination {
            outputs.written = ledger::verified(folder, &lines)?;
        }
        outputs.intervals = lines.into_iter().filter_map(|line| line.interval).collect();
        if length > 0 {
            outputs.ledger = Some(Ledger::resume(folder, length)?);
            return Ok(outputs);
        }
        Ok(outputs.with_ledger())
    }

    /// Reopens the outputs of a resumed run; fails unless the recomputed `last` interval equals the stored one. Removes
    /// the record of the stopped run.
    pub fn take_up(&mut self, fps: f64, last: &Interval, video: Option<&VideoPoint>) -> Result<(), Error> {
        let files = match (&self.destination, video) {
            (Destination::Folder(folder), _) => {
                prepare_kinds(folder, self.emit)?;
                if self.emit.scene {
                    check_again(&self.intervals, last)?;
                    let intervals = std::mem::take(&mut self.intervals);
                    self.scene = Some(SceneWriter::resume(&folder.join("scene"), fps, last.placement, intervals)?);
                }
                vec![folder.join("run.json"), folder.join("report.md")]
            }
            (Destination::Video(path, _), Some(point)) => {
                self.video = Some(Video::resume(path, fps, point)?);
                self.destination.record().into_iter().collect()
            }
            (Destination::Video(path, format), None) => {
                self.video = Some(Video::create(path, *format, Pace::even(fps))?);
                self.destination.record().into_iter().collect()
            }
        };
        files.iter().try_for_each(|file| remove_file(file))
    }

    /// Makes the interval just written a point to resume from; completes `point` with the state of ledger and video.
    pub fn commit(&mut self, mut point: Point, resume: Option<&ResumePoint>) -> Result<(), Error> {
        let Some(ledger) = &self.ledger else { return Ok(()) };
        point.ledger = ledger.length();
        if let Some(video) = &mut self.video {
            point.video = video.point()?;
        }
        prepare_subfolder(ledger.folder())?;
        ledger.sync()?;
        self.sync_folders()?;
        resume_state::commit(ledger.folder(), &point, resume)
    }

    /// Waits until the names of all files would survive a power loss.
    fn sync_folders(&self) -> Result<(), OutputError> {
        let folders = match &self.destination {
            Destination::Folder(folder) => {
                let mut all: Vec<PathBuf> = self.emit.folders().into_iter().map(|name| folder.join(name)).collect();
                all.push(folder.clone());
                all
            }
            Destination::Video(path, _) if path == Path::new("-") => Vec::new(),
            Destination::Video(path, _) => vec![folder_of(path).to_owned()],
        };
        folders
            .into_iter()
            .try_for_each(|path| storage::sync_folder(&path).map_err(|cause| OutputError::Write { path, cause }))
    }

    /// Returns true if the run can be resumed when it is interrupted.
    pub fn can_resume(&self) -> bool {
        self.ledger.is_some()
    }

    /// Opens the outputs that depend on the frame rate: `fps` is that of the scene, `pace` that of the images.
    pub fn start(&mut self, fps: f64, pace: Pace) -> Result<(), Error> {
        self.fps = fps;
        match &self.destination {
            Destination::Folder(_) => {}
            Destination::Video(path, format) => {
                let video = Video::create(path, *format, pace)?;
                self.video = Some(video.with_quality(self.quality).with_sound(self.sound.take()));
                if let Some(path) = self.destination.container().filter(|_| self.emit.scene) {
                    self.container = Some(ContainerWriter::create(&path, fps)?);
                }
            }
        }
        Ok(())
    }

    /// Removes the results of an earlier run, if that is still to be done, and begins the scene.
    fn replace_earlier(&mut self) -> Result<(), Error> {
        if let (Destination::Folder(folder), Some(earlier)) = (&self.destination, self.earlier.take()) {
            remove_earlier(folder, &earlier)?;
            if self.emit.scene {
                self.scene = Some(SceneWriter::create(&folder.join("scene"), self.fps)?);
            }
        }
        Ok(())
    }

    fn note(&mut self, name: String, written: Written) {
        let Written { bytes, blake3 } = written;
        self.written.insert(name, OutputRecord { bytes, blake3, samples: None, outside_contract: false });
    }

    /// Writes a file inside the folder.
    fn file(&mut self, name: String, bytes: &[u8]) -> Result<(), Error> {
        self.replace_earlier()?;
        let Destination::Folder(folder) = &self.destination else { return Ok(()) };
        let written = Written::of(bytes);
        if let Some(ledger) = &mut self.ledger {
            ledger.add(&name, &written, None)?;
        }
        write_whole(&folder.join(&name), bytes)?;
        self.note(name, written);
        Ok(())
    }

    /// Writes an interval of the scene with the times of its `frames`, and the positions of its identities, if
    /// requested. `workers` encode a container.
    pub fn interval(&mut self, interval: &Interval, frames: &[f64], workers: &Workers) -> Result<(), Error> {
        self.replace_earlier()?;
        if self.emit.tracks {
            self.file(
                format!("tracks/interval-{:06}.csv", interval.index),
                formats::tracks::write(interval).as_bytes(),
            )?;
        }
        if let Some(container) = &mut self.container {
            container.push_with(interval, frames, workers)?;
        }
        let Some(scene) = &mut self.scene else { return Ok(()) };
        let ledger = &mut self.ledger;
        let entry = scene.push_after(interval, frames, |entry| {
            let written = Written { bytes: entry.bytes, blake3: entry.blake3.clone() };
            let name = format!("scene/{}", entry.file);
            ledger.as_mut().map_or(Ok(()), |ledger| ledger.add(&name, &written, Some(entry)))
        })?;
        let IntervalEntry { file, bytes, blake3, .. } = entry;
        self.note(format!("scene/{file}"), Written { bytes, blake3 });
        Ok(())
    }

    /// Writes image number `index`, shown at `time` in a video.
    pub fn image(&mut self, index: usize, time: f64, image: Image) -> Result<(), Error> {
        if self.emit.exr {
            let bytes = if self.alpha { transparent_exr(&image) } else { layered_exr(&image) };
            self.file(format!("exr/{index:06}.exr"), &bytes.map_err(Error::work)?)?;
        }
        let Image { width, height, rgb, depth, alpha, .. } = image;
        let picture = Picture { width, height, rgb };
        if let Some(video) = &mut self.video {
            return Ok(video.push(&picture, time)?);
        }
        let emit = self.emit;
        if emit.rgb {
            let bytes = match alpha.as_deref().filter(|_| self.alpha) {
                Some(alpha) => transparent_png(&picture, alpha),
                None => picture_png(&picture),
            };
            self.file(format!("frames/{index:06}.png"), &bytes)?;
        }
        if emit.webp {
            let bytes = picture_webp(&picture, alpha.as_deref().filter(|_| self.alpha)).map_err(Error::work)?;
            self.file(format!("frames/{index:06}.webp"), &bytes)?;
        }
        if emit.depth
            && let Some(depth) = &depth
        {
            let bytes = depth_exr(width, height, depth, alpha.as_deref()).map_err(Error::work)?;
            self.file(format!("depth/{index:06}.exr"), &bytes)?;
        }
        if emit.alpha
            && let Some(alpha) = &alpha
        {
            self.file(format!("alpha/{index:06}.png"), &plane_png(width, height, alpha))?;
        }
        Ok(())
    }

    /// Writes the Gaussians of one time as number `index`.
    pub fn snapshot(&mut self, index: usize, snapshot: &Snapshot) -> Result<(), Error> {
        self.file(format!("ply/{index:06}.ply"), &formats::ply::write(&Still::of(snapshot)).bytes)
    }

    /// Ends after a failure: completes the index of the intervals that were written. A y4m file keeps its temporary
    /// name where it can be resumed; any other video is discarded.
    pub fn abandon(mut self, place: &mut Place) {
        if let Some(scene) = self.scene.take() {
            // Only the first failure is reported.
            let _ = scene.finish();
        }
        if let Some(video) = self.video.take_if(|_| self.ledger.is_some()) {
            video.leave();
        }
        self.withdraw(place);
    }

    /// Completes scene and video.
    pub fn finish(mut self) -> Result<Finished, Error> {
        self.replace_earlier()?;
        let mut notes = Vec::new();
        if let Some(scene) = self.scene.take()
            && let Some((name, written)) = scene.finish()?
        {
            self.note(format!("scene/{name}"), written);
        }
        if let Some(container) = self.container.take()
            && let Some((path, written)) = self.destination.container().zip(container.finish()?)
        {
            self.note(path.file_name().unwrap_or_default().to_string_lossy().into_owned(), written);
        }
        if let Some(video) = self.video.take() {
            let finished = video.finish()?;
            notes = finished.notes;
            let name = match &self.destination {
                Destination::Video(path, _) => {
                    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
                }
                Destination::Folder(_) => String::new(),
            };
            let Written { bytes, blake3 } =
                finished.file.unwrap_or(Written { bytes: 0, blake3: finished.samples.clone() });
            self.written
                .insert(name, OutputRecord { bytes, blake3, samples: Some(finished.samples), outside_contract: false });
        }
        self.sync_folders()?;
        for (name, record) in self.written.iter_mut().filter(|_| self.outside) {
            record.outside_contract = record.samples.is_some() || emit::is_drawn(name);
        }
        Ok(Finished { outputs: self.written, notes })
    }
}

/// Returns true if `name` stays inside the folder that it is joined to.
pub fn is_inside(name: &str) -> bool {
    !name.is_empty() && Path::new(name).components().all(|c| matches!(c, Component::Normal(_)))
}

fn prepare_kinds(folder: &Path, emit: Emit) -> Result<(), OutputError> {
    emit.folders().into_iter().try_for_each(|name| prepare_subfolder(&folder.join(name)))
}

/// Returns an error unless `last` equals the last of `intervals`, bit for bit.
fn check_again(intervals: &[IntervalEntry], last: &Interval) -> Result<(), Error> {
    let bytes = to_safetensors(last).map_err(Error::work)?;
    let found = Written::of(&bytes).blake3;
    match intervals.last() {
        Some(entry) if entry.blake3 == found => Ok(()),
        entry => {
            let expected = entry.map_or("none", |entry| entry.blake3.as_str());
            Err(Error::work(format!(
                "--resume: interval {} computed again: expected the digest {expected}, found {found}; run again without --resume",
                last.index
            )))
        }
    }
}
