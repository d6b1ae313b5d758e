//! The same scenes on the CPU and on the adapter.

use std::sync::{Mutex, OnceLock};

use streamsplat::camera::{Camera, Pose};
use streamsplat::render::{Backend, Renderer};

use streamsplat::stream::Workers;
use streamsplat::wgpu::WgpuRasteriser;
use streamsplat::{Engine, Frame, Image, RenderOptions, Settings, Size};
use streamsplat_fixtures::clip::{Clip, ClipKind};
use streamsplat_kernels::Level;
use streamsplat_kernels::raster::{Gaussians, Projection, Request, render};
use streamsplat_tests::splats::Splats;

/// One device for all tests.
fn device() -> &'static Mutex<WgpuRasteriser> {
    static DEVICE: OnceLock<Mutex<WgpuRasteriser>> = OnceLock::new();
    DEVICE.get_or_init(|| {
        let renderer = WgpuRasteriser::new(Level::detect()).unwrap_or_else(|e| panic!("{e}"));
        println!("adapter: {}", renderer.adapter());
        Mutex::new(renderer)
    })
}

fn draw(gaussians: &Gaussians<'_>, projection: &Projection, request: &Request) -> Image {
    let mut renderer = device().lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    renderer.render(gaussians, projection, request).unwrap_or_else(|e| panic!("{e}")).clone()
}

/// Asserts that images are within 2/255 on all but one pixel in 2,000; depth and alpha likewise.
fn assert_same(name: &str, card: &Image, cpu: &Image) {
    assert_eq!((card.width, card.height, card.dropped), (cpu.width, cpu.height, cpu.dropped), "{name}");
    let pixels = cpu.width * cpu.height;
    let planes = [
        ("rgb", Some(&card.rgb), Some(&cpu.rgb)),
        ("depth", card.depth.as_ref(), cpu.depth.as_ref()),
        ("alpha", card.alpha.as_ref(), cpu.alpha.as_ref()),
        ("final T", card.final_t.as_ref(), cpu.final_t.as_ref()),
    ];
    for (plane, found, expected) in planes {
        let (Some(found), Some(expected)) = (found, expected) else {
            assert!(found.is_none() && expected.is_none(), "{name}: {plane} is there in one image only");
            continue;
        };
        assert_eq!(found.len(), expected.len(), "{name}: {plane}");
        let scale = if plane == "depth" { expected.iter().fold(1.0_f32, |a, v| a.max(v.abs())) } else { 1.0 };
        let mut off = vec![false; pixels];
        let mut worst = 0.0_f32;
        for (at, (found, expected)) in found.iter().zip(expected).enumerate() {
            let error = (found - expected).abs() / scale;
            off[at % pixels] |= error.is_nan() || error > 2.0 / 255.0;
            worst = worst.max(error);
        }
        let off = off.into_iter().filter(|off| *off).count();
        println!("{name}: {plane}: worst {worst:.1e}, {off} of {pixels} pixels off");
        assert!(off * 2000 <= pixels, "{name}: {plane}: {off} of {pixels} pixels off by more than 2/255");
    }
}

#[test]
fn the_oracles_scenes_are_drawn_as_on_the_cpu() {
    for name in ["predicted-t000", "predicted-t050", "rotated-orthographic", "perspective", "extreme"] {
        let path = streamsplat_fixtures::path(&format!("oracle/{name}.safetensors"));
        let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let scene = Splats::from_safetensors(&bytes).unwrap_or_else(|e| panic!("{name}: {e}"));
        let cpu = render(Level::detect(), &scene.gaussians(), &scene.projection, &scene.request);
        let card = draw(&scene.gaussians(), &scene.projection, &scene.request);
        assert_same(name, &card, &cpu);
        let same = card.blended.iter().flatten().zip(cpu.blended.iter().flatten()).filter(|(a, b)| a == b).count();
        assert!(same * 100 >= 99 * cpu.width * cpu.height, "{name}: {same} pixels have as many splats");
    }
}

#[test]
fn a_predicted_scene_is_drawn_as_on_the_cpu_from_any_camera() {
    let mut engine = Engine::new(Settings::default()).expect("the embedded model");
    let clip = Clip::new(ClipKind::Moving, 3, 96, 54);
    let mut interval = None;
    for time in [0.0, 0.2] {
        let picture = clip.picture(time);
        let frame = Frame { width: picture.width, height: picture.height, rgb: picture.rgb, depth: None };
        interval = Some(engine.push(frame, time).expect("an interval"));
    }
    let interval = interval.expect("two frames");
    let workers = Workers::new(Level::detect(), 2).expect("threads");
    let mut card = Renderer::with(&workers, Backend::Wgpu).unwrap_or_else(|e| panic!("{e}"));
    assert!(card.adapter().is_some_and(|name| !name.is_empty()));
    let mut cpu = Renderer::new(&workers);
    assert_eq!(cpu.adapter(), None);
    let aside = Pose::look_at([0.3, -0.2, -0.8], [0.0, 0.0, 0.6], [0.0, -1.0, 0.0]).expect("a pose");
    let pinhole = Camera::pinhole(aside, 60.0, 16.0 / 9.0).expect("a camera");
    for (name, camera) in [("canonical", Camera::Canonical), ("pinhole", pinhole)] {
        for (time, size) in [(0.0, Size::Model), (0.13, Size::Source), (0.2, Size::Exact { width: 333, height: 77 })] {
            for all in [false, true] {
                let options =
                    RenderOptions { size, depth: all, alpha: all, statistics: all, ..RenderOptions::default() };
                let found = card.render(&interval, time, &camera, &options).unwrap_or_else(|e| panic!("{e}")).clone();
                let expected = cpu.render(&interval, time, &camera, &options).expect("an image");
                assert_same(&format!("{name} at {time} s"), &found, expected);
            }
        }
    }
    let work = card.work();
    assert!(work.entries > 0 && work.tiles_drawn == work.tiles, "{work:?}");
}

#[test]
fn nothing_in_view_is_the_background() {
    let request = Request { depth: true, alpha: true, ..Request::colour(37, 5, [0.25, 0.5, f32::NAN]) };
    let image = draw(&Gaussians::default(), &Projection::Orthographic { focal: [1.0; 2] }, &request);
    assert_eq!(image.rgb, [[0.25; 37 * 5], [0.5; 37 * 5], [0.0; 37 * 5]].concat());
    assert!(image.depth.iter().chain(&image.alpha).flatten().all(|v| *v == 0.0));
    let nothing =
        draw(&Gaussians::default(), &Projection::Orthographic { focal: [1.0; 2] }, &Request::colour(0, 9, [0.0; 3]));
    assert!(nothing.rgb.is_empty());
}

#[test]
fn what_does_not_fit_the_device_is_refused() {
    // 4 GiB of planes and more.
    let request = Request { depth: true, alpha: true, statistics: true, ..Request::colour(65_536, 16_384, [0.0; 3]) };
    let mut renderer = device().lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    let error = renderer
        .render(&Gaussians::default(), &Projection::Orthographic { focal: [1.0; 2] }, &request)
        .expect_err("30 GB in one buffer");
    assert!(matches!(error, streamsplat::wgpu::WgpuError::TooLarge { what: "the image", .. }), "{error}");
}
