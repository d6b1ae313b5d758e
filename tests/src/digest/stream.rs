//! A short stream: video in, dynamic Gaussians and images out.

use streamsplat::camera::{Camera, Pose, Rotation};
use streamsplat::stream::{Fusion, ModelSource, SamplingMode};
use streamsplat::{Engine, Frame, Interval, RenderOptions, Settings};
use streamsplat_fixtures::clip::{Clip, Kind};
use streamsplat_kernels::Level;

use super::{Digest, Thing, splats};

pub(super) fn things() -> Vec<Thing> {
    vec![
        Thing::new("stream/persistent", |level, digest| {
            stream(level, digest, "tiny-nodino", &Settings { fusion: Fusion::Persistent, ..Settings::default() });
        }),
        Thing::new("stream/pairwise", |level, digest| {
            stream(level, digest, "tiny-nodino", &Settings { fusion: Fusion::Pairwise, ..Settings::default() });
        }),
        Thing::new("stream/sampled", |level, digest| {
            let settings = Settings { sampling: SamplingMode::Sample, seed: 5, ..Settings::default() };
            stream(level, digest, "tiny-sampled", &settings);
        }),
    ]
}

/// Three key frames with depth, letterboxed into the model's input; every record and several images of each interval.
fn stream(level: Level, digest: &mut Digest, model: &str, settings: &Settings) {
    let checkpoint = streamsplat_fixtures::path(&format!("parity/{model}.safetensors"));
    let settings = Settings {
        model: ModelSource::File { checkpoint, dinov2: None },
        level: Some(level),
        threads: rayon::current_num_threads(),
        ..settings.clone()
    };
    let mut engine = Engine::new(settings).expect("an engine");
    let clip = Clip::new(Kind::Moving, 4, 61, 53);
    for time in [0.0, 0.3, 0.5] {
        let picture = clip.picture(time);
        let depth = Some(picture.inverse_depth);
        let frame = Frame { width: picture.width, height: picture.height, rgb: picture.rgb, depth };
        let interval = engine.push(frame, time).expect("an interval");
        records(digest, &interval);
        let pose = Pose {
            rotation: Rotation::from_quaternion([1.0, 0.05, -0.1, 0.02]).expect("a rotation"),
            ..Pose::default()
        };
        let pinhole = Camera::pinhole(pose, 60.0, 64.0 / 48.0).expect("a camera");
        let options = RenderOptions { depth: true, alpha: true, statistics: true, ..RenderOptions::default() };
        for (at, camera) in [(0.0, Camera::Canonical), (0.4, Camera::Canonical), (1.0, pinhole)] {
            let at = interval.start + (interval.end - interval.start) * at;
            splats::add(digest, &interval.render(at, &camera, &options).expect("an image"));
        }
    }
}

fn records(digest: &mut Digest, interval: &Interval) {
    digest.doubles(&[interval.start, interval.end]);
    for r in interval.gaussians.iter() {
        digest.integers([r.identity, r.birth]);
        digest.floats(r.mean.as_slice());
        digest.floats(r.velocity.as_slice());
        digest.floats(&[r.gamma[0], r.gamma[1], r.opacity, r.scale[0], r.scale[1]]);
        digest.floats(r.rgb.as_slice());
    }
}
