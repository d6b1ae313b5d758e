//! Points are followed through the scene.

use std::path::{Path, PathBuf};

use streamsplat::fit::Placement;
use streamsplat::scene::{Scene, SceneWriter};
use streamsplat::stream::{DynamicGaussians, Interval, Merge, Record, Reference, Workers};
use streamsplat::track::{Picked, Track};
use streamsplat_kernels::Level;

use crate::support::{Scratch, command, fails, json, run_ok};

const HEADER: &str = "time_s,identity,x_px,y_px,x_half_widths,inverse_depth,z_half_heights,opacity";

fn track(scene: &Path, at: &str, point: &str, more: &[&str]) -> std::process::Output {
    command()
        .arg("track")
        .arg(scene)
        .args(["--at", at, "--point", point])
        .args(more)
        .output()
        .expect("the program starts")
}

/// Parses the numbers of the table on standard output.
fn rows(output: &std::process::Output) -> Vec<Vec<f64>> {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    table(std::str::from_utf8(&output.stdout).expect("text"))
}

fn table(text: &str) -> Vec<Vec<f64>> {
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some(HEADER));
    lines.map(|line| line.split(',').map(|field| field.parse().expect("a number")).collect()).collect()
}

fn workers() -> Workers {
    Workers::new(Level::scalar(), 1).expect("one thread")
}

/// Writes a scene with frames of 80×48, intervals of one second, and one Gaussian that starts in the middle. In the
/// first second it moves a quarter to the right; then it merges into another identity, which moves half up. `last` are
/// the records of the following intervals.
fn scene(scratch: &Scratch, name: &str, last: &[&[Record]]) -> PathBuf {
    let still = Record {
        mean: [0.0, 0.5, 0.0],
        opacity: 0.9,
        scale: [0.1, 0.1],
        rgb: [1.0, 0.0, 0.0],
        identity: 7,
        reference: Reference::Start,
        ..Record::default()
    };
    let right = Record { velocity: [0.25, 0.0, 0.0], ..still };
    let up = Record { mean: [0.25, 0.5, 0.0], velocity: [0.0, 0.0, 0.5], identity: 9, ..still };
    let folder = scratch.path(name);
    let mut writer = SceneWriter::create(&folder, 2.0).expect("writable");
    let contents = [&[still][..], &[right], &[up]];
    for (index, records) in contents.iter().chain(last).enumerate() {
        let gaussians: DynamicGaussians = records.iter().copied().collect();
        let merges = if index == 1 { vec![Merge { identity: 7, into: 9 }] } else { Vec::new() };
        let interval = Interval {
            index: index as u64,
            start: index.saturating_sub(1) as f64,
            end: index as f64,
            gaussians,
            placement: Placement { source: [48, 80], model: [48, 80], offset: [0, 0], content: [48, 80] },
            merges,
            dropped: 0,
        };
        writer.push(&interval).expect("writable");
    }
    writer.finish().expect("writable");
    folder
}

#[test]
fn a_point_moves_with_its_identity_in_both_directions() {
    let scratch = Scratch::new();
    let stays = Record { mean: [0.25, 0.5, 0.5], opacity: 0.9, scale: [0.1; 2], identity: 9, ..Record::default() };
    let folder = scene(&scratch, "scene", &[&[stays]]);
    let found = rows(&track(&folder, "0.5", "44.5,23.5", &[]));
    let times: Vec<f64> = found.iter().map(|row| row[0]).collect();
    assert_eq!(times, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0]);
    let identities: Vec<f64> = found.iter().map(|row| row[1]).collect();
    // Where two intervals meet, the earlier one shows the time.
    assert_eq!(identities, [7.0, 7.0, 7.0, 9.0, 9.0, 9.0, 9.0]);
    let places = [[39.5, 23.5], [44.5, 23.5], [49.5, 23.5], [49.5, 17.5], [49.5, 11.5], [49.5, 11.5], [49.5, 11.5]];
    for (row, place) in found.iter().zip(places) {
        assert!((row[2] - place[0]).abs() < 1e-4 && (row[3] - place[1]).abs() < 1e-4, "{row:?}, expected {place:?}");
        assert_eq!(row[5], 0.5, "its depth");
        assert!((row[7] - 0.9).abs() < 1e-6, "its opacity");
    }
    // World: x right, z up.
    assert!((found[4][4] - 0.25).abs() < 1e-6 && (found[4][6] - 0.5).abs() < 1e-6, "{:?}", found[4]);

    // A time between frames is added; requested times are used unchanged.
    assert_eq!(rows(&track(&folder, "0.25", "42,23.5", &[]))[1][0], 0.25);
    let some = rows(&track(&folder, "1.5", "49.5,17.5", &["--times", "1.25,1.75"]));
    assert_eq!(some.iter().map(|row| row[0]).collect::<Vec<_>>(), [1.25, 1.75]);
    // The identity that another one merged into does not exist before.
    let (csv, report) = (scratch.path("path.csv"), scratch.path("path.json"));
    let files = ["--out", csv.to_str().expect("UTF-8"), "--json", report.to_str().expect("UTF-8")];
    let output = track(&folder, "1.5", "49.5,17.5", &files);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("identity 9, at 4 of 7 times"));
    let found = table(&std::fs::read_to_string(csv).expect("readable"));
    let report = json(&report);
    assert_eq!((&report["identity"], &report["missing"], &report["at"]), (&9.into(), &3.into(), &1.5.into()));
    let path = report["path"].as_array().expect("a list");
    assert_eq!(path.len(), found.len());
    for (point, row) in path.iter().zip(&found) {
        assert_eq!((point["time"].as_f64(), point["pixel"][0].as_f64()), (Some(row[0]), Some(row[2])));
    }
}

#[test]
fn a_track_ends_where_its_identity_does_or_its_numbers_do() {
    let scratch = Scratch::new();
    let gone = Record { mean: [0.25, 0.5, 0.5], opacity: 0.9, scale: [0.1; 2], identity: 11, ..Record::default() };
    let nan = Record { identity: 9, velocity: [f32::NAN, 0.0, 0.0], ..gone };
    // Twice this velocity overflows.
    let vast = Record { identity: 9, velocity: [f32::MAX, 0.0, 0.0], ..gone };
    for (name, last) in [("gone", gone), ("nan", nan)] {
        let found = rows(&track(&scene(&scratch, name, &[&[last]]), "0.5", "44.5,23.5", &[]));
        assert_eq!(found.last().expect("some")[0], 2.0, "{name}");
        assert!(found.iter().flatten().all(|x| x.is_finite()), "{name}");
    }
    let found = rows(&track(&scene(&scratch, "vast", &[&[vast], &[vast]]), "0.5", "44.5,23.5", &[]));
    assert_eq!(found.last().expect("some")[0], 3.0);
    assert!(found.iter().flatten().all(|x| x.is_finite()));
}

#[test]
fn the_program_gives_the_librarys_track_of_a_run() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 4, 60, 30);
    let out = scratch.path("out");
    run_ok(&clip, &out, &["--quiet", "--fps", "10", "--gap", "3"]);
    let found = rows(&track(&out, "0.1", "20,15", &["--threads", "2"]));
    let scene = Scene::open(&out).expect("just written");
    let interval = scene.interval(scene.find(0.1).expect("inside")).expect("just written");
    let picked = interval.pick(0.1, [20.0, 15.0], &workers()).expect("inside").expect("something");
    let track = Track::new(&picked, 0.1);
    let (mut expected, _) = track.backward(&interval, &[0.0]).expect("it was there");
    // Frame times are multiples of a tenth, in the arithmetic of a grid.
    let later: Vec<f64> = (1..4).map(|i| (f64::from(i) / 10.0).min(interval.end)).collect();
    expected.extend(track.forward(&interval, &later).expect("it stays").0);
    assert_eq!(found.len(), expected.len());
    for (row, point) in found.iter().zip(&expected) {
        assert_eq!((row[0], row[1] as u64, [row[2], row[3]]), (point.time, point.identity, point.pixel));
        assert_eq!([row[4] as f32, row[5] as f32, row[6] as f32], point.position);
    }
    assert!((found[1][2] - 20.0).abs() < 1e-3 && (found[1][3] - 15.0).abs() < 1e-3, "{:?}", found[1]);
}

#[test]
fn many_points_picked_at_once_are_what_each_is_alone() {
    let scratch = Scratch::new();
    let out = scratch.path("out");
    run_ok(&scratch.clip("clip", 3, 60, 30), &out, &["--quiet", "--fps", "10", "--gap", "2"]);
    let scene = Scene::open(&out).expect("just written");
    let interval = scene.interval(1).expect("just written");
    let pixels: Vec<[f64; 2]> = (0..200).map(|i| [f64::from(i % 20) * 3.3 - 1.0, f64::from(i / 20) * 3.1]).collect();
    let all = interval.pick_all(0.13, &pixels, &workers()).expect("inside");
    assert!(all.iter().flatten().count() > 100);
    for (pixel, picked) in pixels.iter().zip(all) {
        assert_eq!(interval.pick(0.13, *pixel, &workers()).expect("inside"), picked, "{pixel:?}");
    }
}

#[test]
fn points_and_times_that_are_none_are_wrong_use_and_an_empty_place_is_failed_work() {
    let scratch = Scratch::new();
    let folder = scene(&scratch, "scene", &[&[]]);
    for (at, point, expected) in [
        ("0.5", "44.5", "--point 44.5: expected X,Y in pixels"),
        ("0.5", "a,b", "--point a,b: expected X,Y in pixels"),
        ("0.5", "-3,5", "--point -3,5: expected a pixel of a frame of 80×48"),
        ("0.5", "5,47.6", "--point 5,47.6: expected a pixel"),
        ("7", "5,5", "--at: time 7 s: expected one between 0 s and 3 s"),
        ("-1", "5,5", "--at: time -1 s: expected one between"),
        ("nan", "5,5", "--at"),
        ("soon", "5,5", "--at"),
    ] {
        let text = fails(&track(&folder, at, point, &[]), 2);
        assert!(text.contains(expected), "{at} {point}: {text}");
    }
    let text = fails(&track(&folder, "0.5", "44.5,23.5", &["--times", "0,8"]), 2);
    assert!(text.contains("--times: time 8 s"), "{text}");
    // A corner far from the only Gaussian, and an interval without Gaussians.
    for (at, point) in [("0.5", "0,0"), ("2.5", "44.5,23.5")] {
        let output = track(&folder, at, point, &[]);
        let text = fails(&output, 1);
        assert!(text.contains(&format!("nothing is drawn at {point} at {at} s")), "{text}");
        assert!(output.stdout.is_empty());
    }
}

/// Returns the rows of a file of `--emit tracks`; an absent number is NaN.
fn tracks(path: &std::path::Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("identity,birth,time,x,y,world_x,world_y,world_z,opacity,into"));
    lines.map(|line| line.split(',').map(|field| field.parse().unwrap_or(f64::NAN)).collect()).collect()
}

#[test]
fn emitted_tracks_are_where_the_scenes_identities_are() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 6, 60, 30);
    let out = scratch.path("out");
    run_ok(&clip, &out, &["--quiet", "--fps", "10", "--gap", "2", "--emit", "scene,tracks"]);
    let record = json(&out.join("run.json"));
    let scene = Scene::open(&out).expect("just written");
    let mut merged = 0;
    for i in 0..4 {
        let name = format!("tracks/interval-{i:06}.csv");
        assert!(record["outputs"][&name]["blake3"].is_string(), "{name} is recorded");
        let rows = tracks(&out.join(&name));
        let interval = scene.interval(i).expect("just written");
        assert!(rows.windows(2).all(|pair| pair[0][0] < pair[1][0]), "a line per identity, ascending");
        merged += rows.iter().filter(|row| row[9].is_finite()).count();
        for merge in &interval.merges {
            let row = rows.iter().find(|row| row[0] as u64 == merge.identity).expect("what ends is said");
            assert_eq!(row[9] as u64, merge.into);
        }
        let Some(next) = (i < 3).then(|| scene.interval(i + 1).expect("just written")) else { continue };
        // The next interval starts with exactly these identities, at these positions.
        let mut compared = 0;
        for record in next.gaussians.iter().filter(|r| r.reference == Reference::Start) {
            let row = rows.iter().find(|row| row[0] as u64 == record.identity).expect("a line");
            assert!(row[9].is_nan() && row[1] as u64 == record.birth && row[2] == interval.end);
            let place: [f32; 3] = std::array::from_fn(|axis| record.mean[axis] + record.offset[axis]);
            assert_eq!([row[5] as f32, row[6] as f32, row[7] as f32], place);
            compared += 1;
        }
        assert_eq!(compared, rows.iter().filter(|row| row[9].is_nan()).count());
        // The track of an identity passes through its pixel.
        let record = next.gaussians.get(next.gaussians.len() / 3);
        let row = rows.iter().find(|row| row[0] as u64 == record.identity).expect("a line");
        let picked = Picked {
            index: 0,
            identity: record.identity,
            weight: 1.0,
            position: [row[5] as f32, row[6] as f32, row[7] as f32],
        };
        let (points, _) = Track::new(&picked, next.start).forward(&next, &[next.start]).expect("it lives");
        assert!((points[0].pixel[0] - row[3]).abs() < 1e-9 && (points[0].pixel[1] - row[4]).abs() < 1e-9);
    }
    assert!(merged > 0, "some identities end in others");
    let text = fails(
        &crate::support::run(["run", clip.to_str().expect("UTF-8"), "--out", "v.y4m", "--emit", "rgb,tracks"]),
        2,
    );
    assert!(text.contains("--emit: a video holds rgb alone"), "{text}");
}
