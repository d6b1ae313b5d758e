//! Images of one colour, one pixel wide, of every sample depth, and with values that are not colours.

use std::io::Cursor;
use std::path::Path;

use streamsplat::fit::{Fit, Placement};
use streamsplat::source::decode::decode;
use streamsplat::stream::ModelSource;
use streamsplat::{Camera, Engine, Frame, RenderOptions, Settings, openexr};
use streamsplat_model::{FrameInput, LoadOptions, Network, Sampling, Side};

use super::{Case, Computed, Judged, Place, Unit};
use crate::noise::noise;
use crate::parity;
use crate::reference::{Inputs, Sizes, Tensors, forward, relative_l2};

const GROUP: &str = "Images";
const MODEL: &str = "tiny-nodino";

/// All `count` sample values of one channel through a PNG: value over the largest.
fn samples(bits: u32) -> Case {
    let count = 1_u32 << bits;
    Case::new(
        GROUP,
        format!("every {bits}-bit sample"),
        move |_| {
            let (width, height) = (256, count / 256);
            let mut file = Cursor::new(Vec::new());
            let written = if bits == 8 {
                let raw = (0..=255).collect();
                image::GrayImage::from_raw(width, height, raw)
                    .expect("a row")
                    .write_to(&mut file, image::ImageFormat::Png)
            } else {
                let raw: Vec<u16> = (0..=u16::MAX).collect();
                let image = image::ImageBuffer::<image::Luma<u16>, _>::from_raw(width, height, raw).expect("rows");
                image.write_to(&mut file, image::ImageFormat::Png)
            };
            written.expect("memory");
            let picture = decode(file.get_ref(), Path::new("samples.png")).expect("an image");
            Computed::new(&picture.rgb[..count as usize])
        },
        move |found| {
            Judged::of(Unit::Ulp, &found.values, (0..count).map(|v| f64::from(v) / f64::from(count - 1)))
                .and(found.values.windows(2).all(|v| v[0] < v[1]), || "samples do not ascend".into())
        },
    )
}

const FLOATS: [f32; 10] = [-1e30, -1.0, -0.0, 0.0, 1e-40, 0.25, 1.0, 1.000_000_1, 7.0, 3e38];

fn floats() -> Case {
    Case::new(
        GROUP,
        "float samples inside and outside [0, 1] (EXR): clamped",
        |_| {
            let planes =
                openexr::Planes { width: FLOATS.len(), height: 1, channels: vec![("Y".into(), FLOATS.to_vec())] };
            let mut file = Vec::new();
            let colour_space = Some("sRGB");
            let layer = openexr::NamedLayer { name: "grey", planes, comment: "", colour_space };
            openexr::write_layers(&[layer], &mut file).expect("memory");
            Computed::new(&decode(&file, Path::new("floats.exr")).expect("an image").rgb[..FLOATS.len()])
        },
        |found| Judged::of(Unit::Absolute, &found.values, FLOATS.map(|v| f64::from(v.clamp(0.0, 1.0)))),
    )
}

fn engine(place: Place) -> Engine {
    let checkpoint = parity::path(&format!("{MODEL}.safetensors"));
    let model = ModelSource::File { checkpoint, dinov2: None };
    let settings = Settings { level: Some(place.level), threads: place.threads, ..Settings::with_model(model) };
    Engine::new(settings).expect("starts")
}

/// Two frames of this size through the engine, and an image between them.
fn stream(place: Place, [width, height]: [usize; 2], pixel: impl Fn(usize, usize) -> f32) -> Computed {
    let mut engine = engine(place);
    let frame = |k: usize| {
        let rgb = (0..3 * width * height).map(|i| pixel(k, i)).collect();
        Frame { width, height, rgb, depth: None }
    };
    engine.push(frame(0), 0.0).expect("taken");
    let interval = engine.push(frame(1), 1.0).expect("taken");
    let image = interval.render(0.5, &Camera::Canonical, &RenderOptions::default(), engine.workers()).expect("drawn");
    Computed::with(&[image.rgb, interval.gaussians.mean.concat()].concat(), [interval.dropped])
}

fn thin([width, height]: [usize; 2]) -> Case {
    Case::new(
        GROUP,
        format!("{width}×{height} pixels through the engine: finite, nothing dropped"),
        move |place| stream(place, [width, height], |k, i| ((i * 31 + k * 17) % 101) as f32 / 101.0),
        |found| {
            Judged { ours: 0.0, exact: 0.0, ..Judged::new(Unit::Absolute) }
                .and(found.values.iter().all(|v| v.is_finite()), || "a value that is not finite came out".into())
                .and(found.rest == [0], || format!("{} dropped", found.rest[0]))
        },
    )
}

fn clamped() -> Case {
    let pixel = |k: usize, i: usize| (((i * 31 + k * 17) % 101) as f32 - 50.0) / 25.0;
    Case::new(
        GROUP,
        "pixels from −2 to 2 through the engine: as if clamped",
        move |place| stream(place, [20, 12], pixel),
        move |found| {
            let place = Place { level: streamsplat_kernels::Level::scalar(), threads: 1, form: super::Form::Short };
            let expected = stream(place, [20, 12], |k, i| pixel(k, i).clamp(0.0, 1.0));
            Judged::of(Unit::Absolute, &found.values, expected.values)
        },
    )
}

/// Bilinear with half-pixel centres in binary64.
fn bilinear(from: &[f32], [h, w]: [usize; 2], [rows, columns]: [usize; 2]) -> Vec<f64> {
    let place = |i: usize, n: usize, of: usize| {
        let x = ((i as f64 + 0.5) * of as f64 / n as f64 - 0.5).clamp(0.0, of as f64 - 1.0);
        (x.floor() as usize, (x.floor() as usize + 1).min(of - 1), x.fract())
    };
    let mut out = Vec::new();
    for y in 0..rows {
        let (top, bottom, down) = place(y, rows, h);
        for x in 0..columns {
            let (left, right, across) = place(x, columns, w);
            let at = |y: usize, x: usize| f64::from(from[y * w + x]);
            let row = |y: usize| (1.0 - across) * at(y, left) + across * at(y, right);
            out.push((1.0 - down) * row(top) + down * row(bottom));
        }
    }
    out
}

fn resized(from: [usize; 2], to: [usize; 2]) -> Case {
    let image = move || -> Vec<f32> { noise(from[0] * from[1], 51).iter().map(|x| 0.5 + 0.5 * x).collect() };
    Case::new(
        GROUP,
        format!("{}×{} pixels resized to {}×{}", from[1], from[0], to[1], to[0]),
        move |place| {
            let placement = Placement::new(Fit::Stretch, from, to).expect("sides of a pixel at least");
            Computed::new(&placement.fit_in(place.level, &image()))
        },
        move |found| Judged::of(Unit::Absolute, &found.values, bilinear(&image(), from, to)),
    )
}

/// The whole network on frames of one value each, against the reference: the worst of all outputs.
fn network(name: &str, rgb: [f32; 2], depth: f32) -> Case {
    let frames = move |plane: usize| rgb.map(|value| vec![value; 3 * plane]);
    Case::new(
        GROUP,
        format!("{name} through the network"),
        move |place| {
            let options = LoadOptions { level: place.level, ..LoadOptions::default() };
            let network = Network::open(parity::path(&format!("{MODEL}.safetensors")), &options).expect("a model");
            let mut session = network.session(None);
            let [h, w] = network.config().resolution;
            let depth = vec![depth; h * w];
            let parts = frames(h * w).map(|rgb| {
                let embedding = session.embed(&FrameInput { rgb: &rgb, depth: Some(&depth) }).expect("an embedding");
                let fixed = session.static_gaussians(&embedding, &Sampling::Mean).expect("Gaussians");
                (embedding, fixed)
            });
            let [a, b] = parts.each_ref().map(|(h, s)| Side { h: &h.h, static_tokens: &s.tokens, condition: None });
            let fields = session.deform(a, b).expect("a motion");
            let mut values = parts.each_ref().map(|(embedding, _)| embedding.h.clone()).concat();
            values.extend(parts.iter().flat_map(|(_, fixed)| fixed.gaussians.opacity.iter()));
            values.extend(fields.iter().flat_map(|field| field.velocity.as_flattened()));
            Computed::new(&values)
        },
        move |found| {
            let (checkpoint, _) = parity::case(MODEL);
            let json = parity::config(MODEL);
            let size = |value: &serde_json::Value| value.as_u64().expect("a size") as usize;
            let resolution = [0, 1].map(|i| size(&json["config"]["resolution"][i]));
            let upsampler_window = size(&json["config"]["upsampler_window"]);
            let plane = resolution[0] * resolution[1];
            let wide = frames(plane).concat().into_iter().map(f64::from).collect::<Vec<_>>();
            let inputs = Inputs { frames: &wide, depths: &vec![f64::from(depth); 2 * plane], condition: None };
            let exact = forward(
                &Tensors::new(&checkpoint),
                Sizes { resolution, upsampler_window, encoder_window: None },
                &inputs,
            );
            let mut judged = Judged::new(Unit::RelativeL2);
            let mut from = 0;
            for name in ["h", "static.opacity", "dynamic.velocity"] {
                let exact = &exact[name];
                let ours = &found.values[from..from + exact.len()];
                from += exact.len();
                let worst = (0..exact.len())
                    .max_by(|i, j| (ours[*i] - exact[*i]).abs().total_cmp(&(ours[*j] - exact[*j]).abs()));
                let worst = worst.expect("some values");
                judged.take(relative_l2(ours.iter().copied(), exact.iter().copied()), ours[worst], exact[worst]);
            }
            judged.and(from == found.values.len(), || format!("{} values, expected {from}", found.values.len()))
        },
    )
}

pub(super) fn cases() -> Vec<Case> {
    let mut cases = vec![samples(8), samples(16), floats(), clamped()];
    cases.extend([[1, 1], [1, 50], [50, 1], [1, 4000]].map(thin));
    cases.extend(
        [([1, 1], [48, 80]), ([50, 1], [48, 80]), ([1, 50], [48, 80]), ([48, 80], [1, 1]), ([7, 2000], [5, 3])]
            .map(|(from, to)| resized(from, to)),
    );
    cases.extend([
        network("black frames without depth", [0.0, 0.0], 0.0),
        network("a black and a white frame", [0.0, 1.0], 0.0),
        network("white frames at depth 1", [1.0, 1.0], 1.0),
        network("frames of 1e-40, denormal", [1e-40, 1e-40], 1e-40),
    ]);
    cases
}
