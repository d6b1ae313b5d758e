//! Runs as used by a program that calls the library.

use std::path::Path;
use std::sync::{Arc, Mutex};

use streamsplat_fixtures as fixtures;

use super::*;
use crate::output::picture_png;
use crate::picture::Picture;

/// Five frames, every second one a key frame, with a small model.
fn run(frames: &str) -> Run {
    let mut options = RunOptions::default();
    let model = fixtures::path("parity/tiny-nodino.safetensors").display().to_string();
    for (name, text) in [("model", model.as_str()), ("gap", "2"), ("frames", frames), ("emit", "rgb,scene")] {
        assert!(options.set(name, text).expect("a value"), "{name}");
    }
    Run::new(fixtures::path("clips/moving.y4m"), options)
}

fn png(shown: &Shown) -> Vec<u8> {
    let Image { width, height, rgb, .. } = shown.image.clone();
    picture_png(&Picture { width, height, rgb })
}

/// Records the calls it receives.
#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<String>>>);

impl Log {
    fn add(&self, line: String) {
        self.0.lock().expect("no panic").push(line);
    }
}

impl Observer for Log {
    fn started(&mut self, total: Option<usize>) {
        self.add(format!("started {total:?}"));
    }

    fn progress(&mut self, done: usize, _: Option<usize>) {
        self.add(format!("done {done}"));
    }

    fn interval(&mut self, interval: &Interval) {
        self.add(format!("interval {}", interval.index));
    }

    fn finished(&mut self) {
        self.add("finished".to_owned());
    }
}

#[test]
fn steps_have_the_images_that_are_written_and_need_no_place() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("out");
    let record = run("5").out(&out).finish().expect("a run");
    assert!(record.complete && record.outputs.contains_key("frames/000004.png"), "{:?}", record.outputs.keys());
    let mut running = run("5").start().expect("a run");
    let steps: Vec<Step> = running.by_ref().collect::<Result<_, _>>().expect("steps");
    assert_eq!(steps.iter().map(|step| step.interval.index).collect::<Vec<_>>(), [0, 1, 2]);
    let images: Vec<&Shown> = steps.iter().flat_map(|step| &step.images).collect();
    assert_eq!(images.iter().map(|shown| shown.index).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    for shown in images {
        let file = out.join(format!("frames/{:06}.png", shown.index));
        assert!(std::fs::read(file).expect("written") == png(shown), "image {}", shown.index);
    }
    let again = running.finish().expect("a record");
    assert!(again.outputs.is_empty() && again.complete);
    assert_eq!((again.input, again.key_frames), (record.input, record.key_frames));
}

#[test]
fn frames_in_memory_become_what_their_file_becomes() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (of_file, of_memory) = (folder.path().join("file"), folder.path().join("memory"));
    let expected = run("5").out(&of_file).finish().expect("a run");
    let clip = fixtures::path("clips/moving.y4m");
    let mut file = Source::open(&clip, &source::Options::default()).expect("a clip");
    let fps = file.fps();
    let frames: Vec<_> = std::iter::from_fn(|| file.next_frame().expect("a frame")).collect();
    let frames = frames.into_iter().map(|frame| Ok((frame.picture, Some(frame.timestamp))));
    let options = run("5").options;
    let source = Source::of_frames(frames, Some(fps), None).expect("frames");
    let found = Run::of_frames(source, options.clone()).out(&of_memory).finish().expect("a run");
    assert_eq!((&found.outputs, &found.input.blake3), (&expected.outputs, &expected.input.blake3));
    assert_eq!((found.input.path.as_path(), found.input.count), (Path::new(MEMORY), 5));
    // An error of the frames' producer is the run's error.
    let broken = Source::of_frames(std::iter::once(Err("no camera".to_owned())), Some(fps), None).expect("frames");
    let error = Run::of_frames(broken, options).start().and_then(Running::finish).expect_err("no frame");
    assert_eq!(error.to_string(), "<memory>: no camera");
}

#[test]
fn an_observer_follows_a_run_and_a_stop_ends_it_where_another_resumes() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (out, whole) = (folder.path().join("out"), folder.path().join("whole"));
    let log = Log::default();
    run("5").out(&whole).observe(log.clone()).finish().expect("a run");
    let lines = log.0.lock().expect("no panic").join("; ");
    let expected =
        "started Some(5); interval 0; done 1; interval 1; done 2; done 3; interval 2; done 4; done 5; finished";
    assert_eq!(lines, expected);
    let stop = Stop::default();
    let mut running = run("5").out(&out).stop(stop.clone()).start().expect("a run");
    assert!(running.next().is_some_and(|step| step.is_ok()));
    assert!(!stop.ask() && stop.asked());
    assert!(running.next().is_none());
    let stopped = running.finish().expect("a record");
    assert!(!stopped.complete);
    let record = run("5").out(&out).resume(true).finish().expect("a run");
    let expected = Record::read(&whole.join("run.json")).expect("a record");
    assert!(record.complete && record.outputs == expected.outputs);
    let again = run("5").out(&out).resume(true).start().expect("a complete run");
    assert!(again.was_complete());
}

#[test]
fn options_that_exclude_each_other_are_wrong_use_before_anything_is_written() {
    let out = Path::new("no/such/place");
    for (pair, expected) in [
        ([("orbit", "4"), ("turntable", "2")], "--turntable: expected none beside --orbit"),
        ([("like_paper", "true"), ("quality", "best")], "--quality: expected none beside --like-paper"),
        ([("view", "1"), ("seed", "1")], "--view: expected --camera as well"),
        ([("eye-distance", "0.1"), ("seed", "1")], "--eye-distance: expected --stereo as well"),
    ] {
        let mut options = RunOptions::default();
        for (name, text) in pair {
            assert!(options.set(name, text).expect("a value"), "{name}");
        }
        let error = Run::new("clip.y4m", options).out(out).finish().expect_err("refused");
        assert!(error.is_usage() && error.to_string() == expected, "{error}");
        assert!(!out.exists());
    }
    let mut options = RunOptions::default();
    assert!(!options.set("colour", "1").expect("no such option"));
    assert!(options.set("gap", "0").is_err_and(|e| e.to_string().starts_with("--gap: expected a whole number")));
}
