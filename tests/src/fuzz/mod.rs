//! Targets of hostile bytes: one function per reader. libFuzzer (`tests/fuzz`) and the tests share them; the tests
//! replay seeds, earlier findings, and mutations of both.
//!
//! A function takes any bytes. An error from the reader is a valid result. A panic, a wrong property of the result, or
//! more memory than the bytes justify is a finding.
//!
//! To add a target: a function in `targets.rs`, its seeds in `seeds.rs`, a line in [`TARGETS`], and
//! `tests/fuzz/fuzz_targets/NAME.rs` with a `[[bin]]` in `tests/fuzz/Cargo.toml`.

mod mutate;
mod seeds;
mod targets;

use std::path::PathBuf;

pub use mutate::Mutations;
pub use targets::colmap;

/// A reader of untrusted bytes.
pub struct Target {
    /// Its name, as in `tests/fuzz/fuzz_targets/NAME.rs`.
    pub name: &'static str,
    /// Reads the bytes and checks the result.
    pub run: fn(&[u8]),
    /// Well-formed inputs of every kind that it reads.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Longest useful input.
    pub longest: usize,
}

/// All of them.
pub const TARGETS: [Target; 20] = [
    Target { name: "checkpoint", run: targets::checkpoint, seeds: seeds::checkpoint, longest: 32 << 10 },
    Target { name: "model_config", run: targets::model_config, seeds: seeds::model_config, longest: 1 << 10 },
    Target { name: "interval", run: targets::interval, seeds: seeds::interval, longest: 4 << 10 },
    Target { name: "scene_index", run: targets::scene_index, seeds: seeds::scene_index, longest: 2 << 10 },
    Target { name: "camera", run: targets::camera, seeds: seeds::camera, longest: 1 << 10 },
    Target { name: "y4m", run: targets::y4m, seeds: seeds::y4m, longest: 1 << 10 },
    Target { name: "image", run: targets::image, seeds: seeds::image, longest: 4 << 10 },
    Target { name: "depth_map", run: targets::depth_map, seeds: seeds::depth_map, longest: 4 << 10 },
    Target { name: "splat", run: targets::splat, seeds: seeds::splat, longest: 4 << 10 },
    Target { name: "ply", run: targets::ply, seeds: seeds::ply, longest: 4 << 10 },
    Target { name: "spz", run: targets::spz, seeds: seeds::spz, longest: 2 << 10 },
    Target { name: "splat_records", run: targets::splat_records, seeds: seeds::splat_records, longest: 1 << 10 },
    Target { name: "gltf", run: targets::gltf, seeds: seeds::gltf, longest: 4 << 10 },
    Target { name: "sog", run: targets::sog, seeds: seeds::sog, longest: 8 << 10 },
    Target { name: "ksplat", run: targets::ksplat, seeds: seeds::ksplat, longest: 6 << 10 },
    Target { name: "streamed_sog", run: targets::streamed_sog, seeds: seeds::streamed_sog, longest: 1 << 10 },
    Target { name: "spacetime", run: targets::spacetime, seeds: seeds::spacetime, longest: 2 << 10 },
    Target { name: "library", run: targets::library, seeds: seeds::library, longest: 1 << 10 },
    Target { name: "http", run: targets::http, seeds: seeds::http, longest: 1 << 10 },
    Target { name: "container", run: targets::container, seeds: seeds::container, longest: 4 << 10 },
];

impl Target {
    /// The target of this name.
    pub fn named(name: &str) -> Option<&'static Target> {
        TARGETS.iter().find(|target| target.name == name)
    }

    /// Inputs of earlier findings: the files of `tests/fuzz/regressions/NAME`, by name.
    ///
    /// # Panics
    /// When the folder exists and cannot be read.
    pub fn regressions(&self) -> Vec<(String, Vec<u8>)> {
        let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz/regressions")).join(self.name);
        if !folder.exists() {
            return Vec::new();
        }
        let entries = std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
        let mut files: Vec<_> = entries.map(|entry| entry.expect("a listed file").path()).collect();
        files.sort();
        let read = |path: PathBuf| {
            let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            (path.file_name().unwrap_or_default().to_string_lossy().into_owned(), bytes)
        };
        files.into_iter().map(read).collect()
    }
}
