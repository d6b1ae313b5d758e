//! Readers of untrusted files, on hostile bytes: seeds, findings of fuzzing, and mutations of both. Nothing panics, and
//! results have their documented properties. The long form is `tests/fuzz/run`.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::LazyLock;

use streamsplat_tests::fuzz::{Mutations, TARGETS, Target, colmap};

/// Default of `HOSTILE_TRIES`: the least number of mutations of one input.
const LEAST: usize = 400;
/// Mutations of all inputs of a target together, at least.
const LEAST_OF_TARGET: usize = 3000;

/// The number in `HOSTILE_TRIES`.
static TRIES: LazyLock<Option<usize>> =
    LazyLock::new(|| std::env::var("HOSTILE_TRIES").ok().map(|tries| tries.parse().expect("HOSTILE_TRIES: a number")));

fn try_all(target: &Target) {
    let named = |kind: &str, i: usize, bytes: Vec<u8>| (format!("{kind} {i}"), bytes);
    let seeds = (target.seeds)().into_iter().enumerate().map(|(i, bytes)| named("seed", i, bytes));
    let inputs: Vec<_> = seeds.chain(target.regressions()).collect();
    let tries = TRIES.unwrap_or_else(|| LEAST.max(LEAST_OF_TARGET.div_ceil(inputs.len())));
    let mut tried = 0;
    for (name, input) in &inputs {
        attempt(target, name, input);
        for (i, bytes) in Mutations::new(input, 7).take(tries).enumerate() {
            attempt(target, &format!("{name}, mutation {i}"), &bytes);
            tried += 1;
        }
    }
    assert!(TRIES.is_some() || tried >= LEAST_OF_TARGET, "{}: {tried} inputs", target.name);
}

fn attempt(target: &Target, name: &str, bytes: &[u8]) {
    if catch_unwind(AssertUnwindSafe(|| (target.run)(bytes))).is_err() {
        let shown = &bytes[..bytes.len().min(400)];
        panic!("{}: {name} ({} bytes) panics: {}", target.name, bytes.len(), shown.escape_ascii());
    }
}

macro_rules! targets {
    ($($test:ident: $name:literal;)*) => {
        $(#[test]
        fn $test() {
            try_all(Target::named($name).expect("a target"));
        })*

        #[test]
        fn every_target_is_tried() {
            let tried = [$($name),*];
            assert!(TARGETS.iter().map(|target| target.name).eq(tried));
        }
    };
}

targets! {
    no_bytes_break_the_reader_of_checkpoints: "checkpoint";
    no_bytes_break_the_reader_of_model_configurations: "model_config";
    no_bytes_break_the_reader_of_intervals: "interval";
    no_bytes_break_the_reader_of_scenes: "scene_index";
    no_bytes_break_the_reader_of_cameras: "camera";
    no_bytes_break_the_reader_of_y4m_streams: "y4m";
    no_bytes_break_the_readers_of_images: "image";
    no_bytes_break_the_readers_of_depth_maps: "depth_map";
    no_bytes_break_the_reader_of_splats: "splat";
    no_bytes_break_the_reader_of_ply_files: "ply";
    no_bytes_break_the_reader_of_spz_files: "spz";
    no_bytes_break_the_reader_of_splat_records: "splat_records";
    no_bytes_break_the_reader_of_gltf_files: "gltf";
    no_bytes_break_the_reader_of_sog_files: "sog";
    no_bytes_break_the_reader_of_ksplat_files: "ksplat";
    no_bytes_break_the_reader_of_streamed_sog_scenes: "streamed_sog";
    no_bytes_break_the_reader_of_gaussians_in_time: "spacetime";
    no_bytes_break_the_reader_of_library_headers: "library";
    no_bytes_break_the_reader_of_http_requests: "http";
    no_bytes_break_the_reader_of_containers: "container";
}

#[test]
fn every_target_has_its_fuzzer_and_no_other_folder_holds_regressions() {
    let folder = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz"));
    let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).expect("the fuzzers' manifest");
    for target in &TARGETS {
        assert!(folder.join(format!("fuzz_targets/{}.rs", target.name)).exists(), "{}", target.name);
        assert!(manifest.contains(&format!("name = \"{}\"", target.name)), "{}", target.name);
    }
    let stems = |inside: &str| -> Vec<String> {
        let entries = std::fs::read_dir(folder.join(inside)).into_iter().flatten().flatten();
        entries.filter_map(|e| Some(e.path().file_stem()?.to_str()?.to_owned())).collect()
    };
    for name in [stems("fuzz_targets"), stems("regressions")].concat() {
        assert!(Target::named(&name).is_some(), "{name}");
    }
}

#[test]
fn seeds_are_read_as_what_they_are() {
    use std::path::Path;
    use streamsplat::{camera, depth, formats, scene, source};
    let all = |name: &str, good: &dyn Fn(&[u8]) -> bool| {
        let target = Target::named(name).expect("a target");
        for (i, seed) in (target.seeds)().iter().enumerate() {
            assert!(good(seed) && seed.len() <= target.longest, "{name}: seed {i}, {} bytes", seed.len());
        }
    };
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).expect("text");
    all("checkpoint", &|b| streamsplat_model::checkpoint::Checkpoint::from_storage(b.to_vec(), "seed").is_ok());
    all("scene_index", &|b| scene::Index::from_json(b).is_ok());
    all("camera", &|b| match colmap(b) {
        Some(files) => {
            formats::cameras::colmap::text(&files).is_ok() || formats::cameras::colmap::binary(&files).is_ok()
        }
        None => {
            let others = formats::cameras::parse(&text(b), Some([8, 5]));
            others.map_or_else(|| camera::file::parse(&text(b)).is_ok(), |set| set.is_ok())
        }
    });
    all("image", &|b| source::decode::decode(b, Path::new("seed.tga")).is_ok());
    all("depth_map", &|b| {
        let name = if b.starts_with(b"\x93NUMPY") { "seed.npy" } else { "seed.png" };
        depth::decode_map(b, Path::new(name)).is_ok()
    });
    let limits = formats::Limits::default();
    all("ksplat", &|b| formats::ksplat::read(b).is_ok());
    all("streamed_sog", &|b| formats::lod::plan(b, &limits, 1).is_ok());
    all("spacetime", &|b| formats::spacetime::read(b, &limits).is_ok());
    all("splat", &|b| streamsplat_tests::splats::Splats::from_safetensors(b).is_ok());
    all("y4m", &|b| {
        let mut stream = source::y4m::Y4m::new(b, Path::new("seed.y4m")).expect("a header");
        (0..2).all(|_| stream.next_picture().is_ok_and(|p| p.is_some()))
            && stream.next_picture().is_ok_and(|p| p.is_none())
    });
    let model = (Target::named("checkpoint").expect("a target").seeds)().remove(0);
    let model = streamsplat_model::checkpoint::Checkpoint::from_storage(model, "seed").expect("a checkpoint");
    all("model_config", &|b| streamsplat_model::inspect::inspect_parts(&model, &text(b)).is_ok());
}
