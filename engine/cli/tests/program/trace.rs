//! `--trace`: trace events in the format of Chrome and Perfetto, with a span for every call of every stage and
//! operation.
//!
//! The rules are those of "Trace Event Format" (Chromium): an array of objects; `B` and `E` events that nest on their
//! thread, with `ts` in microseconds; `M` events that name the threads.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use streamsplat_model::inspect::inspect;

use crate::support::{Scratch, command, fails, json};

/// A `B` event and its `E` event.
struct Span {
    name: String,
    category: String,
    /// In microseconds, as `end`.
    start: f64,
    end: f64,
}

#[derive(Default)]
struct Thread {
    name: Option<String>,
    last: f64,
    open: Vec<Span>,
}

/// Returns the spans of a trace, after checking its form.
fn spans(trace: &Path) -> Vec<Span> {
    let events = json(trace);
    let mut threads = BTreeMap::<u64, Thread>::new();
    let mut spans = Vec::new();
    for event in events.as_array().expect("an array of events") {
        let text = |key: &str| event[key].as_str().filter(|text| !text.is_empty()).unwrap_or_else(|| panic!("{event}"));
        assert!(event["pid"].is_u64(), "{event}");
        let thread = threads.entry(event["tid"].as_u64().unwrap_or_else(|| panic!("{event}"))).or_default();
        if text("ph") == "M" {
            assert!(text("name") == "thread_name" && thread.name.is_none(), "{event}");
            thread.name = event["args"]["name"].as_str().map(str::to_owned);
            assert!(thread.name.as_deref().is_some_and(|name| !name.is_empty()), "{event}");
            continue;
        }
        let ts = event["ts"].as_f64().unwrap_or_else(|| panic!("{event}"));
        assert!(ts >= thread.last && thread.name.is_some(), "{event} after {} µs", thread.last);
        thread.last = ts;
        match text("ph") {
            "B" => {
                let (name, category) = (text("name").to_owned(), text("cat").to_owned());
                thread.open.push(Span { name, category, start: ts, end: f64::NAN });
            }
            "E" => {
                let span = thread.open.pop().unwrap_or_else(|| panic!("{event} ends nothing"));
                assert_eq!(span.name, text("name"), "{event}");
                spans.push(Span { end: ts, ..span });
            }
            _ => panic!("{event}"),
        }
    }
    for thread in threads.values() {
        assert!(thread.open.is_empty(), "{} never ends", thread.open[0].name);
    }
    spans
}

/// Returns the number of spans of this name, and their total in microseconds.
fn sum(spans: &[Span], name: &str) -> (u64, f64) {
    let named = spans.iter().filter(|span| span.name == name);
    named.fold((0, 0.0), |(count, time), span| (count + 1, time + span.end - span.start))
}

/// Returns the operations among the spans.
fn operations(spans: &[Span]) -> BTreeSet<String> {
    let of_kernels = spans.iter().filter(|span| span.category.starts_with("streamsplat_kernels"));
    of_kernels.map(|span| span.name.clone()).collect()
}

/// Runs `streamsplat ARGUMENTS --out OUT --trace TRACE`; returns the record and the spans.
fn traced(scratch: &Scratch, name: &str, arguments: &[&Path]) -> (serde_json::Value, Vec<Span>) {
    let (out, trace) = (scratch.path(name), scratch.path(&format!("{name}.json")));
    let output = command()
        .args(arguments)
        .arg("--out")
        .arg(&out)
        .arg("--trace")
        .arg(&trace)
        .output()
        .expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    (json(&out.join("run.json")), spans(&trace))
}

fn fixture(name: &str) -> PathBuf {
    streamsplat_fixtures::path(name)
}

#[test]
fn every_call_of_a_stage_has_its_span_and_takes_the_time_that_the_record_tells() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 40, 24);
    let model = fixture("parity/tiny-dino.safetensors");
    let arguments = [
        Path::new("run"),
        &clip,
        Path::new("--model"),
        &model,
        Path::new("--dinov2"),
        &fixture("parity/dino-tiny.safetensors"),
    ];
    let (record, spans) = traced(&scratch, "out", &arguments);

    let mut stages: Vec<&str> = vec!["fit", "dinov2", "fusion", "render"];
    stages.extend(inspect(&model).expect("a model").stages.iter().map(|stage| stage.stage));
    assert_eq!(stages.len(), 8);
    for stage in &stages {
        let (count, microseconds) = sum(&spans, stage);
        assert!(count > 0 && record["work"][stage]["done"].as_u64() == Some(count), "{stage}: {count} spans");
        let seconds = record["timing"]["seconds"][stage].as_f64().unwrap_or_else(|| panic!("{stage}: no time"));
        // The stopwatch runs inside the spans of some stages and outside those of others. A clock ticks in nanoseconds.
        let (spans, ticks) = (1e-6 * microseconds, 2e-9 * count as f64);
        let holds = match *stage {
            "fit" | "fusion" | "render" => spans >= seconds - ticks && spans < seconds + 1.0,
            _ => spans <= seconds + ticks && spans > 0.0,
        };
        assert!(holds, "{stage}: {spans} s in spans, {seconds} s in the record");
    }
    for part in ["load", "tokenize", "decode", "write"] {
        assert!(sum(&spans, part).0 > 0, "{part}");
    }
    let inside = |span: &Span| {
        let around = |stage: &&Span| stage.start <= span.start && span.end <= stage.end;
        spans
            .iter()
            .filter(|other| stages.contains(&other.name.as_str()) || other.name == "tokenize")
            .any(|s| around(&s))
    };
    let of_kernels = spans.iter().filter(|span| span.category.starts_with("streamsplat_kernels"));
    // DINOv2's position code is resized on loading.
    let load = spans.iter().filter(|span| span.name == "load").map(|span| span.end).fold(0.0, f64::max);
    for span in of_kernels.filter(|span| span.start > load) {
        assert!(inside(span), "{} at {} µs is in no stage", span.name, span.start);
    }
}

#[test]
fn every_operation_of_the_kernels_has_spans() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 3, 40, 24);
    // A model whose tokens attend only to some others, so that changes are detected.
    let model = fixture("parity/tiny-window.safetensors");
    let (_, spans) = traced(
        &scratch,
        "out",
        &[Path::new("run"), &clip, Path::new("--model"), &model, Path::new("--motion=frames"), Path::new("--refine=1")],
    );
    let mut found = operations(&spans);
    // A still scene, whose colours are harmonics.
    let (scene, camera) = crate::still::prepared(&scratch);
    let (_, spans) =
        traced(&scratch, "still", &["render".as_ref(), &scene, "--camera".as_ref(), &camera, "--size=90x60".as_ref()]);
    found.extend(operations(&spans));
    // A shutter, which averages images.
    let out = scratch.path("out");
    // From the side, where unfilmed parts are filled.
    let words = ["--times=0.05", "--shutter=180", "--orbit=20:0.1"].map(Path::new);
    let (_, spans) = traced(&scratch, "shutter", &[&[Path::new("render"), &out], &words[..]].concat());
    found.extend(operations(&spans));

    // One folder per operation, with exceptions. Three folders contain parts of operations; the rasteriser has three
    // passes, its map of colours three more, and their fit one.
    let folders =
        std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../kernels/src")).expect("the sources");
    let folders = folders.map(|entry| entry.expect("a listed file").path()).filter(|path| path.is_dir());
    let mut expected: BTreeSet<String> =
        folders.map(|path| path.file_name().expect("a name").to_string_lossy().into_owned()).collect();
    for parts in ["math", "philox", "simd", "raster"] {
        assert!(expected.remove(parts), "{parts}");
    }
    expected.extend(
        ["project", "bin", "blend", "record", "index", "colour_map", "colour_map_forward", "colour_fit"]
            .map(str::to_owned),
    );
    assert_eq!(found, expected);
}

#[test]
fn the_trace_of_work_that_fails_is_whole() {
    let scratch = Scratch::new();
    let trace = scratch.path("trace.json");
    let run = |trace: &Path| {
        let mut command = command();
        command.arg("run").arg(scratch.path("none")).arg("--out").arg(scratch.path("out")).arg("--trace").arg(trace);
        fails(&command.output().expect("the program starts"), 1)
    };
    run(&trace);
    spans(&trace);
    let message = run(&scratch.path("no/such/folder/trace.json"));
    assert!(message.contains("no/such/folder/trace.json: cannot write: "), "{message}");
}
