//! Still scenes and their images.

use streamsplat_kernels::Level;
use streamsplat_kernels::raster::reference;

use super::{Drawable, Still};
use crate::camera::{Camera, Lens, Pose, Rotation};
use crate::render::{RenderError, RenderOptions, Renderer, Size};
use crate::stream::Workers;

fn still(count: usize, degree: usize) -> Still {
    let value = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1009) as f32 / 504.5 - 1.0;
    let rest = streamsplat_kernels::harmonics::rest(degree);
    Still {
        mean: (0..count).map(|i| [value(i, 0), value(i, 1), 2.0 + value(i, 2)]).collect(),
        log_scale: (0..count).map(|i| std::array::from_fn(|k| -3.0 + value(i, 3 + k))).collect(),
        rotation: (0..count).map(|i| std::array::from_fn(|k| 3.0 * value(i, 6 + k))).collect(),
        logit: (0..count).map(|i| 3.0 * value(i, 10)).collect(),
        base: (0..count).map(|i| std::array::from_fn(|k| value(i, 11 + k))).collect(),
        degree,
        higher: (0..count * 3 * rest).map(|i| 0.4 * value(i, 14)).collect(),
        ..Still::default()
    }
}

fn cameras() -> [Camera; 3] {
    let pose = Pose::look_at([0.4, -0.5, -0.6], [0.0, 0.1, 2.0], [0.1, -1.0, 0.0]).expect("apart");
    let turned = Pose { position: [0.0, 0.0, -1.0], rotation: Rotation::IDENTITY };
    [
        Camera::pinhole(pose, 50.0, 1.5).expect("a lens"),
        Camera::orthographic(pose),
        Camera::Posed { pose: turned, lens: Lens::Pinhole { focal: [1.0, 1.4], centre: [0.45, 0.55] } },
    ]
}

fn options(width: usize, height: usize) -> RenderOptions {
    RenderOptions { size: Size::Exact { width, height }, depth: true, alpha: true, ..RenderOptions::default() }
}

#[test]
fn images_are_the_same_on_every_level_and_for_any_number_of_threads() {
    let scene = still(10_000, 3);
    let draw = |level: Level, threads: usize, camera: &Camera| {
        let workers = Workers::new(level, threads).expect("threads start");
        let drawable = Drawable::new(scene.clone(), &workers).expect("even arrays");
        Renderer::new(&workers).render_still(&drawable, camera, &options(96, 64)).expect("a camera").clone()
    };
    for camera in cameras() {
        let expected = draw(Level::scalar(), 1, &camera);
        assert!(expected.alpha.as_ref().expect("asked for").iter().any(|a| *a > 0.5));
        for level in Level::available() {
            for threads in [1, 3] {
                assert!(draw(level, threads, &camera) == expected, "{level} with {threads} threads");
            }
        }
    }
}

#[test]
fn an_image_is_what_its_formulas_say() {
    let scene = still(300, 3);
    let workers = Workers::new(Level::detect(), 2).expect("threads start");
    let drawable = Drawable::new(scene.clone(), &workers).expect("even arrays");
    for camera in cameras() {
        let Camera::Posed { pose, lens } = camera else { panic!("posed") };
        let image =
            Renderer::new(&workers).render_still(&drawable, &camera, &options(60, 40)).expect("a camera").clone();
        // The same in binary64 with the C library's functions, through the rasteriser's reference.
        let eye = super::draw::eye(&pose, &lens);
        let (mut mean, mut scale, mut rotation, mut opacity, mut rgb) = (vec![], vec![], vec![], vec![], vec![]);
        let rows = pose.rotation.inverse().matrix();
        for i in 0..scene.len() {
            let d: [f64; 3] = std::array::from_fn(|k| f64::from(scene.mean[i][k]) - pose.position[k]);
            mean.push(rows.map(|row| (row[0] * d[0] + row[1] * d[1] + row[2] * d[2]) as f32));
            scale.push(scene.log_scale[i].map(|s| f64::from(s).exp() as f32));
            opacity.push((1.0 / (1.0 + (-f64::from(scene.logit[i])).exp())) as f32);
            let own = Rotation::from_quaternion(scene.rotation[i].map(f64::from)).expect("not zero");
            rotation.push(product(pose.rotation.inverse().quaternion(), own.quaternion()));
            let higher = scene.higher[45 * i..45 * (i + 1)].as_chunks::<3>().0;
            let colour =
                streamsplat_kernels::harmonics::reference::colour(3, scene.base[i], higher, scene.mean[i], eye);
            rgb.push(colour.map(|c| c as f32));
        }
        let gaussians = streamsplat_kernels::raster::Gaussians {
            mean: &mean,
            scale: &scale,
            rotation: Some(&rotation),
            opacity: &opacity,
            rgb: &rgb,
        };
        let view = crate::render::View::posed(&pose, &lens, [40, 60]);
        let request = streamsplat_kernels::raster::Request::colour(60, 40, [0.5; 3]);
        let expected = reference::render(&gaussians, view.projection(), &request);
        let worst = image.rgb.iter().zip(&expected.rgb).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
        assert!(worst < 2e-4, "{camera:?}: {worst}");
    }
}

fn product([aw, ax, ay, az]: [f64; 4], [bw, bx, by, bz]: [f64; 4]) -> [f32; 4] {
    [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
    .map(|c| c as f32)
}

#[test]
fn what_a_still_scene_does_not_have_is_said() {
    let workers = Workers::new(Level::scalar(), 1).expect("one thread");
    let drawable = Drawable::new(still(3, 0), &workers).expect("even arrays");
    let mut renderer = Renderer::new(&workers);
    let [camera, ..] = cameras();
    let of = |camera: &Camera, size: Size, renderer: &mut Renderer| {
        renderer.render_still(&drawable, camera, &RenderOptions { size, ..RenderOptions::default() }).err()
    };
    let exact = Size::Exact { width: 4, height: 4 };
    assert_eq!(of(&Camera::Canonical, exact, &mut renderer), Some(RenderError::NoOwnCamera));
    assert_eq!(of(&camera, Size::Model, &mut renderer), Some(RenderError::NoOwnSize));
    assert_eq!(of(&camera, exact, &mut renderer), None);
    let mut uneven = still(3, 1);
    uneven.higher.pop();
    assert!(matches!(Drawable::new(uneven, &workers), Err(RenderError::Records { array: "higher", .. })));
}

#[test]
fn bad_numbers_are_dropped_and_counted() {
    let clean = still(200, 1);
    let mut spoiled = clean.clone();
    spoiled.logit[3] = f32::NAN;
    spoiled.log_scale[7][1] = 200.0;
    spoiled.rotation[11] = [0.0; 4];
    spoiled.higher[9 * 13 + 4] = f32::INFINITY;
    spoiled.mean[17][2] = f32::NEG_INFINITY;
    let mut hidden = clean;
    [3, 7, 11, 13, 17].iter().for_each(|i| hidden.logit[*i] = -100.0);
    let workers = Workers::new(Level::detect(), 1).expect("one thread");
    for camera in cameras() {
        let draw = |still: &Still| {
            let drawable = Drawable::new(still.clone(), &workers).expect("even arrays");
            Renderer::new(&workers).render_still(&drawable, &camera, &options(48, 32)).expect("a camera").clone()
        };
        let (found, expected) = (draw(&spoiled), draw(&hidden));
        assert_eq!((found.dropped, expected.dropped), (5, 0));
        assert!(found.rgb == expected.rgb);
    }
}
