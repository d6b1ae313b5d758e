//! The rasteriser in difficult cases, against its plain form in binary64.

use streamsplat_kernels::raster::{Image, Projection, reference, render};

use super::scenes::{ORTHOGRAPHIC, PINHOLE, SIZE, Scene, about_z};
use super::{Case, Computed, Judged, Unit};

const GROUP: &str = "Splats";
/// Pixels nearer to a threshold than this (relative) may be decided differently in binary32.
const UNDECIDED: f64 = 1e-4;

pub(super) fn computed(image: Image) -> Computed {
    let planes = [&image.alpha, &image.final_t, &image.depth].map(|plane| plane.clone().unwrap_or_default());
    let values = [image.rgb, planes.concat()].concat();
    Computed::with(&values, image.blended.unwrap_or_default().into_iter().map(u64::from).chain([image.dropped]))
}

/// The absolute error; for colour and depth relative to the largest value where that is above 1.
pub(super) fn against_reference(scene: &Scene, found: &Computed) -> Judged {
    let plain = reference::render(&scene.gaussians(), &scene.projection, &scene.request());
    let pixels = SIZE[0] * SIZE[1];
    let largest = |plane: &[f64]| plane.iter().fold(1.0_f64, |m, v| m.max(v.abs()));
    let (bright, far) = (largest(&plain.rgb), largest(&plain.depth));
    let exact: Vec<f64> =
        plain.rgb.iter().chain(&plain.alpha).chain(&plain.final_t).chain(&plain.depth).copied().collect();
    let mut judged = Judged::new(Unit::Absolute);
    let mut undecided = 0;
    for (i, (&ours, &exact)) in found.values.iter().zip(&exact).enumerate() {
        judged.demand(ours.is_finite(), || format!("value {i} is {ours}"));
        let scale = if i < 3 * pixels {
            bright
        } else if i >= 5 * pixels {
            far
        } else {
            1.0
        };
        let error = (ours - exact).abs() / scale;
        if plain.margin[i % pixels] < UNDECIDED {
            undecided += 1;
            judged.demand(error <= 1.1 / 255.0, || format!("an undecided pixel is off by {error}"));
        } else {
            judged.take(error, ours, exact);
            let drawn = found.rest[i % pixels] == u64::from(plain.blended[i % pixels]);
            judged.demand(drawn, || {
                format!(
                    "pixel {}: {} splats drawn, not {}",
                    i % pixels,
                    found.rest[i % pixels],
                    plain.blended[i % pixels]
                )
            });
        }
    }
    let dropped = found.rest[pixels];
    judged
        .and(found.values.len() == exact.len(), || format!("{} values, expected {}", found.values.len(), exact.len()))
        .and(undecided <= exact.len() / 50, || format!("{undecided} values of {} undecided", exact.len()))
        .and(dropped == plain.dropped, || format!("{dropped} dropped, expected {}", plain.dropped))
}

/// A scene in both projections. Unrotated ones are also drawn with a rotation by almost zero: the separable and the
/// general form.
fn scenes(name: &str, fill: impl Fn(&mut Scene), drawn: Option<bool>) -> Vec<Case> {
    let kinds = [
        ("orthographic", ORTHOGRAPHIC, false),
        ("orthographic, general form", ORTHOGRAPHIC, true),
        ("pinhole", PINHOLE, true),
    ];
    let mut cases = Vec::new();
    for (kind, projection, rotated) in kinds {
        let mut scene = Scene::new(projection, rotated);
        fill(&mut scene);
        if scene.splats.rotation.is_some() && !rotated {
            continue;
        }
        // The identity is recognised when the form is chosen; a tiny rotation is not.
        if let (true, Some(rotation)) = (kind.ends_with("form"), &mut scene.splats.rotation) {
            rotation.iter_mut().filter(|q| **q == [1.0, 0.0, 0.0, 0.0]).for_each(|q| q[3] = 1e-20);
        }
        cases.push(case(format!("{name}, {kind}"), scene, drawn));
    }
    cases
}

fn case(name: String, scene: Scene, drawn: Option<bool>) -> Case {
    let judged = scene.clone();
    Case::new(
        GROUP,
        name,
        move |place| computed(render(place.level, &scene.gaussians(), &scene.projection, &scene.request())),
        move |found| {
            let pixels = SIZE[0] * SIZE[1];
            let some = found.rest[..pixels].iter().any(|n| *n > 0);
            against_reference(&judged, found)
                .and(drawn.is_none_or(|drawn| drawn == some), || format!("expected drawn: {drawn:?}, found {some}"))
        },
    )
}

fn is_pinhole(scene: &Scene) -> bool {
    matches!(scene.projection, Projection::Pinhole { .. })
}

pub(super) fn cases() -> Vec<Case> {
    const LEAST: f32 = 1.0 / 255.0;
    let round = [0.1; 3];
    let needle = |degrees: f32| {
        move |scene: &mut Scene| {
            for (i, x) in [-0.3, 0.0, 0.21].into_iter().enumerate() {
                scene.push([x, 0.1 * x, 1.0 + i as f32], [1.0, 1e-6, 1e-6], 0.9);
            }
            if degrees != 0.0 {
                scene.splats.rotation = Some(vec![about_z(degrees); 3]);
            }
        }
    };
    let one = |scale: [f32; 3], opacity: f32| move |scene: &mut Scene| scene.push([0.013, -0.021, 1.0], scale, opacity);
    // On the centre of a pixel, where α is the opacity itself.
    let exactly = |opacity: f32| move |scene: &mut Scene| scene.push([0.0, 0.0, 1.0], round, opacity);
    let at_depth = |z: f32| move |scene: &mut Scene| scene.push([0.0, 0.0, z], round, 0.9);
    let crowd = |scene: &mut Scene| {
        for i in 0..300 {
            let (a, b) = ((i * 37 % 300) as f32 / 300.0 - 0.5, (i * 61 % 300) as f32 / 300.0 - 0.5);
            scene.push([a, b, 1.0], [0.05, 0.08, 0.05], 0.05 + 0.003 * i as f32);
        }
    };
    let corners = |scene: &mut Scene| {
        // Centres on, and halfway between, pixels around the corners of blocks and tiles.
        for at in [3.5, 4.0, 15.5, 16.0, 31.5, 32.0] {
            let [x, y] = if is_pinhole(scene) {
                [(at - 30.0) / 50.0, (at - 22.0) / 50.0]
            } else {
                [(at - 30.0) / 30.0, (at - 22.0) / 22.0]
            };
            scene.push([x, y, 1.0], [0.02, 0.02, 0.02], 0.8);
        }
    };
    let all = [
        scenes("needles of 1e6 to 1 along an axis", needle(0.0), Some(true)),
        scenes("needles of 1e6 to 1 at 45°", needle(45.0), Some(true)),
        scenes("1e-8 units large", one([1e-8; 3], 0.9), Some(true)),
        scenes("1e3 units large", one([1e3; 3], 0.9), Some(true)),
        scenes("no extent at all", one([0.0; 3], 0.9), Some(true)),
        scenes("300 at one depth", crowd, Some(true)),
        scenes("opacity exactly 1/255", exactly(LEAST), Some(true)),
        scenes("opacity one ulp under 1/255", exactly(f32::from_bits(LEAST.to_bits() - 1)), Some(false)),
        scenes("opacity above 1", exactly(7.0), Some(true)),
        scenes("on the corners of tiles", corners, Some(true)),
        scenes("behind the camera", at_depth(-1.0), Some(false)),
        scenes("at depth zero", at_depth(0.0), Some(false)),
        scenes("at depth −0", at_depth(-0.0), Some(false)),
        scenes("1e12 units aside", |s: &mut Scene| s.push([1e12, -1e12, 1.0], round, 0.9), Some(false)),
        scenes("1e12 units aside, 1e12 large", |s: &mut Scene| s.push([1e12, 0.0, 1.0], [1e12; 3], 0.9), Some(true)),
    ];
    let mut cases: Vec<Case> = all.into_iter().flatten().collect();
    // An orthographic camera draws Gaussians just in front of it; for a pinhole they are too near.
    for (kind, projection, drawn) in [("orthographic", ORTHOGRAPHIC, true), ("pinhole", PINHOLE, false)] {
        for (name, z) in [("1e-30", 1e-30), ("1e-6", 1e-6), ("1e-40, denormal", 1e-40)] {
            let mut scene = Scene::new(projection, false);
            scene.push([0.0, 0.0, z], round, 0.9);
            cases.push(case(format!("at depth {name}, {kind}"), scene, Some(drawn)));
        }
    }
    cases
}
