//! Round trips of unusual scenes through every format: the picture is kept, or a note names the loss.

use streamsplat_kernels::Level;

use super::{Options, SpzVersion};
use crate::camera::{Camera, Pose};
use crate::formats::{FORMATS, Format, Limits};
use crate::open::Opened;
use crate::render::{RenderOptions, Renderer, Size};
use crate::still::{Drawable, Still};
use crate::stream::Workers;

const SIZE: [usize; 2] = [160, 120];

fn still(count: usize, degree: usize) -> Still {
    let value = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1009) as f32 / 504.5 - 1.0;
    let rest = streamsplat_kernels::harmonics::rest(degree);
    Still {
        mean: (0..count).map(|i| std::array::from_fn(|k| value(i, k))).collect(),
        log_scale: (0..count).map(|i| std::array::from_fn(|k| -2.5 + 0.7 * value(i, 3 + k))).collect(),
        rotation: (0..count).map(|i| std::array::from_fn(|k| 3.0 * value(i, 6 + k) + 0.01)).collect(),
        logit: (0..count).map(|i| 3.0 * value(i, 10)).collect(),
        base: (0..count).map(|i| std::array::from_fn(|k| 1.5 * value(i, 11 + k))).collect(),
        degree,
        higher: (0..count * 3 * rest).map(|i| 0.3 * value(i, 14)).collect(),
        ..Still::default()
    }
}

fn workers() -> Workers {
    Workers::new(Level::detect(), 1).expect("a thread")
}

/// Draws a scene with its own mark of anti-aliasing, from a position in the original's coordinates.
fn picture(still: &Still, offset: [f64; 3]) -> Vec<f32> {
    let place = |v: [f64; 3]| std::array::from_fn(|k| v[k] + offset[k]);
    let pose = Pose::look_at(place([0.3, -0.4, -3.0]), place([0.0, 0.0, 0.2]), [0.0, -1.0, 0.0]).expect("apart");
    let camera = Camera::pinhole(pose, 45.0, SIZE[0] as f64 / SIZE[1] as f64).expect("a lens");
    let options = RenderOptions {
        size: Size::Exact { width: SIZE[0], height: SIZE[1] },
        antialias: still.about.antialiased,
        ..RenderOptions::default()
    };
    let drawable = Drawable::new(still.clone(), &workers()).expect("even arrays");
    let mut renderer = Renderer::new(&workers());
    renderer.render_still(&drawable, &camera, &options).expect("a camera").rgb.clone()
}

fn psnr(a: &[f32], b: &[f32]) -> f64 {
    let squares: f64 = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
    10.0 * (a.len() as f64 / squares).log10()
}

/// Writes a scene in a format and reads it back. Returns the notes of the export and the scene read.
fn through(format: &Format, still: &Still, options: &Options) -> (Vec<String>, Still) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join(format!("scene.{}", format.ending));
    let written = (format.still)(&Drawable::new(still.clone(), &workers()).expect("even arrays"), options);
    std::fs::write(&path, written.bytes).expect("writable");
    let Opened::Still(file) = crate::open::scene(&path, &Limits::default()).expect(format.name) else {
        panic!("still")
    };
    (written.notes, file.still)
}

/// Returns the minimum PSNR in decibels between a format's picture and the original.
fn kept(format: &Format) -> f64 {
    match format.option {
        "ply" => f64::INFINITY,
        "glb" => 90.0,
        "splat" => 38.0,
        "compressed-ply" | "spz" | "sog" => 36.0,
        other => panic!("{other}: a format without a precision"),
    }
}

/// Returns the scene of a PLY file with harmonics of degree 4, which are read to degree 3.
fn of_degree_4() -> Still {
    let original = still(60, 3);
    let rest = (0..72).map(|k| format!("property float f_rest_{k}\n")).collect::<String>();
    let names = "x y z opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 f_dc_0 f_dc_1 f_dc_2";
    let names: String = names.split(' ').map(|name| format!("property float {name}\n")).collect();
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n{names}{rest}end_header\n", original.len());
    for i in 0..original.len() {
        let own =
            [&original.mean[i][..], &original.logit[i..=i], &original.log_scale[i], &original.rotation[i]].concat();
        // By channel; the last nine of 24 coefficients are those of degree 4.
        let higher = |k: usize| {
            let (channel, k) = (k / 24, k % 24);
            if k < 15 { original.higher[45 * i + 3 * k + channel] } else { 0.25 }
        };
        let row = own.into_iter().chain(original.base[i]).chain((0..72).map(higher));
        text.push_str(&(row.map(|x| x.to_string()).collect::<Vec<_>>().join(" ") + "\n"));
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("degree-4.ply");
    std::fs::write(&path, text).expect("writable");
    let Opened::Still(file) = crate::open::scene(&path, &Limits::default()).expect("PLY") else { panic!("still") };
    assert_eq!(file.still.about.notes, ["harmonics of degree 4 read to degree 3"]);
    assert_eq!((file.still.degree, &file.still.higher), (3, &original.higher));
    file.still
}

/// Returns unusual scenes, by name.
fn cases() -> Vec<(&'static str, Still)> {
    let changed = |change: &dyn Fn(&mut Still)| {
        let mut scene = still(400, 1);
        change(&mut scene);
        scene
    };
    let mut cases = vec![
        ("opacity +∞", changed(&|s| s.logit.iter_mut().step_by(2).for_each(|x| *x = f32::INFINITY))),
        ("opacity −∞", changed(&|s| s.logit.iter_mut().step_by(2).for_each(|x| *x = f32::NEG_INFINITY))),
        ("scale −∞", changed(&|s| s.log_scale.iter_mut().for_each(|x| x[2] = f32::NEG_INFINITY))),
        ("floater", changed(&|s| s.mean[7] = [5.3e8, 0.0, 0.0])),
        ("offset", changed(&|s| s.about.offset = [431_250.0, 5_411_800.0, 312.0])),
        ("antialiased", changed(&|s| s.about.antialiased = true)),
        ("one", still(1, 1)),
        ("none", still(0, 1)),
    ];
    cases[5].1.log_scale.iter_mut().flatten().for_each(|s| *s -= 2.0);
    cases.extend((0..=3).map(|degree| ("degree", still(400, degree))));
    cases.push(("degree 4", of_degree_4()));
    cases
}

#[test]
fn every_format_keeps_the_picture_of_every_unusual_scene_or_says_why_not() {
    for (name, scene) in cases() {
        let expected = picture(&scene, scene.about.offset);
        for format in &FORMATS {
            for spz in [SpzVersion::V3, SpzVersion::V4] {
                let (notes, found) = through(format, &scene, &Options { spz });
                let loss = psnr(&expected, &picture(&found, scene.about.offset));
                let what = format!("{} of {name} {}: {loss:.1} dB, {notes:?}", format.name, scene.degree);
                println!("{what}");
                assert!(loss >= kept(format) || !notes.is_empty(), "{what}");
                let says = |words: &str| notes.iter().any(|note| note.contains(words));
                if format.option != "splat" {
                    // Not for .splat: it has no harmonics, marks or offsets, and the export notes each of them.
                    let told =
                        name == "antialiased" && says("anti-aliasing") || name == "floater" && says("more coarsely");
                    assert!(loss >= kept(format) || told, "{what}");
                }
                assert_eq!(found.len(), scene.len(), "{what}");
                let is_kept =
                    found.about.antialiased == scene.about.antialiased && found.about.offset == scene.about.offset;
                assert!(is_kept || says("anti-aliasing") || says("relative to"), "{what}");
                if name == "floater" && format.option == "spz" {
                    assert!(says("1 of 400 Gaussians moved"), "{what}");
                }
            }
        }
    }
}

#[test]
fn what_cannot_be_drawn_is_left_out_of_every_format_counted_and_of_the_picture() {
    let mut scene = still(50, 1);
    scene.logit[3] = f32::NAN;
    scene.log_scale[7][1] = f32::INFINITY;
    scene.rotation[11] = [0.0; 4];
    scene.higher[9 * 13 + 4] = f32::INFINITY;
    let expected = picture(&scene, [0.0; 3]);
    for format in &FORMATS {
        let (notes, found) = through(format, &scene, &Options::default());
        // PLY keeps every number; Gaussians that cannot be drawn are not drawn from it either.
        let (count, line) = if format.option == "ply" {
            (50, None)
        } else {
            (46, Some("4 of 50 Gaussians left out: 3 with numbers that are not finite, 1 without a rotation"))
        };
        assert_eq!((found.len(), notes.first().map(String::as_str)), (count, line), "{}", format.name);
        if format.option != "splat" {
            assert!(psnr(&expected, &picture(&found, [0.0; 3])) >= kept(format), "{}", format.name);
        }
    }
}

#[test]
fn folders_with_a_file_of_any_format_are_recognised() {
    let last = |ending: &'static str| ending.rsplit('.').next().unwrap_or(ending);
    for ending in FORMATS.iter().map(|format| last(format.ending)) {
        assert!(crate::recognise::SCENES.contains(&ending), "{ending}");
    }
}
