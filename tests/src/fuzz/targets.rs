//! One function per reader.

use std::io::Cursor;
use std::path::Path;
use std::sync::LazyLock;

use crate::splats::Splats;
use streamsplat::camera::{Pose, file};
use streamsplat::fit::Placement;
use streamsplat::formats::cameras::{self, CameraSet};
use streamsplat::render::Renderer;
use streamsplat::scene::{Index, from_safetensors, intervals_from_container, to_safetensors};
use streamsplat::source::{decode, y4m::Y4m};
use streamsplat::still::{Drawable, Still};
use streamsplat::stream::Workers;
use streamsplat::{Camera, Image, RenderOptions, Size, depth, formats, onnx};
use streamsplat_kernels::{Level, raster};
use streamsplat_model::checkpoint::Checkpoint;
use streamsplat_model::inspect::inspect_parts;

use super::seeds;

/// One thread on the lowest and one on the highest level.
static WORKERS: LazyLock<[Workers; 2]> =
    LazyLock::new(|| [Level::scalar(), Level::detect()].map(|level| Workers::new(level, 1).expect("a thread starts")));

/// Pixels of an image that is drawn for a test.
const FEW: usize = 1 << 12;

/// A safetensors file as a model: reads every tensor, derives the sizes and counts the cost.
pub(super) fn checkpoint(bytes: &[u8]) {
    let Ok(checkpoint) = Checkpoint::from_storage(bytes.to_vec(), "fuzz") else { return };
    for (name, info) in checkpoint.tensors() {
        if let Ok(values) = checkpoint.read(name) {
            assert_eq!(values.len(), info.elements(), "{name}");
            assert!(values.iter().all(|x| x.is_finite()), "{name}");
        }
    }
    let _ = inspect_parts(&checkpoint, seeds::CONFIG);
}

/// The JSON file of a checkpoint.
pub(super) fn model_config(bytes: &[u8]) {
    static MODEL: LazyLock<Checkpoint> =
        LazyLock::new(|| Checkpoint::from_storage(seeds::model(), "fuzz").expect("a checkpoint"));
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    if let Ok(report) = inspect_parts(&MODEL, text) {
        assert!(report.gflop() >= 0.0);
    }
}

/// An interval of a scene: read, written again, and drawn on two levels.
pub(super) fn interval(bytes: &[u8]) {
    let placement = Placement { source: [9, 16], model: [18, 32], offset: [0, 0], content: [18, 32] };
    let [low, high] = &*WORKERS;
    let Ok(interval) = from_safetensors(bytes, placement) else { return };
    let again = to_safetensors(&interval).expect("what was read can be written");
    let other = from_safetensors(&again, placement).expect("what was written can be read");
    assert_eq!(other.gaussians.len(), interval.gaussians.len());
    let options = RenderOptions {
        size: Size::Exact { width: 13, height: 9 },
        depth: true,
        alpha: true,
        statistics: true,
        ..RenderOptions::default()
    };
    // Halves of the smallest numbers are zero.
    let middle = (0.5 * interval.start + 0.5 * interval.end).clamp(interval.start, interval.end);
    for time in [interval.start, middle, interval.end] {
        let a = interval.render(time, &Camera::Canonical, &options, low).expect("inside the interval");
        let b = other.render(time, &Camera::Canonical, &options, high).expect("inside the interval");
        assert_same_finite(&a, &b);
    }
}

/// A scene's index.
pub(super) fn scene_index(bytes: &[u8]) {
    if let Ok(index) = Index::from_json(bytes) {
        assert!(index.placement.placement().is_some() && !index.intervals.is_empty());
        assert!(index.intervals.iter().all(|i| !i.file.contains('/') && i.start <= i.end));
    }
}

/// A camera or a path of cameras, and their images of a scene; or cameras of another program: JSON, or the two or four
/// files of a COLMAP model with `%%` between them.
pub(super) fn camera(bytes: &[u8]) {
    if let Some(files) = colmap(bytes) {
        [cameras::colmap::text(&files), cameras::colmap::binary(&files)].iter().flatten().for_each(assert_usable);
    }
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    for size in [None, Some([8, 5])] {
        if let Some(Ok(found)) = cameras::parse(text, size) {
            assert_usable(&found);
        }
    }
    let Ok(path) = file::parse(text) else { return };
    let placement = Placement { source: [9, 16], model: [18, 32], offset: [0, 0], content: [18, 32] };
    let interval = from_safetensors(&seeds::interval()[0], placement).expect("a seed");
    let options = RenderOptions { size: Size::Exact { width: 8, height: 5 }, ..RenderOptions::default() };
    for time in [-1e300, 0.0, 0.5, 1e9] {
        let camera = path.at(time);
        let images = WORKERS.each_ref().map(|workers| interval.render(interval.start, &camera, &options, workers));
        if let [Ok(a), Ok(b)] = &images {
            assert_same_finite(a, b);
        }
    }
}

/// The two or four files of a COLMAP model that have `%%` between them.
pub fn colmap(bytes: &[u8]) -> Option<cameras::colmap::Files<'_>> {
    let (cameras, images) = cut(bytes);
    let (images, rigs) = cut(images?);
    let rigs = rigs.map(cut).map(|(rigs, frames)| [rigs, frames.unwrap_or_default()]);
    Some(cameras::colmap::Files { cameras, images, rigs })
}

/// Splits at the next `%%`.
fn cut(bytes: &[u8]) -> (&[u8], Option<&[u8]>) {
    match bytes.windows(2).position(|part| part == b"%%") {
        Some(at) => (&bytes[..at], Some(&bytes[at + 2..])),
        None => (bytes, None),
    }
}

/// Asserts that each camera of a set is usable or an error, and that its number finds it.
fn assert_usable(found: &CameraSet) {
    assert!(!found.cameras.is_empty());
    for (i, named) in found.cameras.iter().enumerate() {
        assert!(named.camera.as_ref().is_ok_and(|sized| sized.camera.is_usable()) || named.camera.is_err());
        assert_eq!(found.find(&i.to_string()).map(|camera| &camera.name), Ok(&named.name));
    }
    assert_eq!(found.path().is_ok(), found.cameras.iter().all(|named| named.camera.is_ok()));
}

/// A y4m stream, to its end.
pub(super) fn y4m(bytes: &[u8]) {
    let Ok(mut stream) = Y4m::new(Cursor::new(bytes), Path::new("fuzz.y4m")) else { return };
    while let Ok(Some(picture)) = stream.next_picture() {
        assert_eq!(picture.rgb.len(), 3 * picture.width * picture.height);
        assert!(picture.rgb.iter().all(|x| (0.0..=1.0).contains(x)));
    }
}

/// An image of any kind. TGA has no signature: bytes that no other decoder claims are tried as TGA.
pub(super) fn image(bytes: &[u8]) {
    if let Ok(picture) = decode::decode(bytes, Path::new("fuzz.tga")) {
        assert_eq!(picture.rgb.len(), 3 * picture.width * picture.height);
        assert!(picture.rgb.iter().all(|x| (0.0..=1.0).contains(x)));
    }
}

/// A depth map of any kind.
pub(super) fn depth_map(bytes: &[u8]) {
    let name = if bytes.starts_with(b"\x93NUMPY") { "fuzz.npy" } else { "fuzz.png" };
    if let Ok(map) = depth::decode_map(bytes, Path::new(name)) {
        assert_eq!(map.values.len(), map.width * map.height);
    }
}

/// A file of splats, drawn on two levels.
pub(super) fn splat(bytes: &[u8]) {
    let Ok(splats) = Splats::from_safetensors(bytes) else { return };
    let mut request = splats.request;
    if request.width * request.height > FEW {
        (request.width, request.height) = (request.width.min(64), request.height.min(64));
    }
    let [a, b] = WORKERS
        .each_ref()
        .map(|w| w.install(|| raster::render(w.level(), &splats.gaussians(), &splats.projection, &request)));
    assert_same_finite(&a, &b);
}

/// A PLY file: the result is written as a file that reads the same, and drawn.
pub(super) fn ply(bytes: &[u8]) {
    let Ok(still) = formats::ply::read(bytes) else { return };
    let file = formats::ply::write(&still).bytes;
    let again = formats::ply::read(&file).expect("what was written can be read");
    assert!(formats::ply::write(&again).bytes == file);
    let packed =
        formats::ply::read(&formats::compressed_ply::write(&still).bytes).expect("what was written can be read");
    assert!(packed.len() <= still.len() && packed.uneven().is_none());
    draw_still(still);
}

/// An SPZ file.
pub(super) fn spz(bytes: &[u8]) {
    let Ok(still) = formats::spz::read(bytes) else { return };
    let again = formats::spz::read(&formats::spz::write(&still, formats::SpzVersion::V3).bytes)
        .expect("what was written can be read");
    assert!(again.len() <= still.len() && again.uneven().is_none());
    draw_still(still);
}

/// Records of a `.splat` file.
pub(super) fn splat_records(bytes: &[u8]) {
    let Ok(still) = formats::splat::read(bytes) else { return };
    assert_eq!((still.len(), still.uneven()), (bytes.len() / 32, None));
    draw_still(still);
}

/// A binary glTF file.
pub(super) fn gltf(bytes: &[u8]) {
    let Ok(still) = formats::gltf::read(bytes) else { return };
    let again = formats::gltf::read(&formats::gltf::write(&still).bytes).expect("what was written can be read");
    assert!(again.len() <= still.len() && again.uneven().is_none());
    draw_still(still);
}

/// A SOG file.
pub(super) fn sog(bytes: &[u8]) {
    let Ok(still) = formats::sog::read(bytes) else { return };
    let again = formats::sog::read(&formats::sog::write(&still).bytes).expect("what was written can be read");
    assert!(again.len() <= still.len() && again.uneven().is_none());
    draw_still(still);
}

/// A `.ksplat` file.
pub(super) fn ksplat(bytes: &[u8]) {
    let Ok(still) = formats::ksplat::read(bytes) else { return };
    assert!(still.uneven().is_none() && still.len() * 24 <= bytes.len());
    draw_still(still);
}

/// The index of a streamed SOG scene: no level has more Gaussians than the limits allow.
pub(super) fn streamed_sog(bytes: &[u8]) {
    let limits = formats::Limits::default();
    for level in 0..3 {
        if let Ok(plan) = formats::lod::plan(bytes, &limits, level) {
            assert!(plan.count <= limits.gaussians);
            let ranges = plan.files.iter().flat_map(|(_, ranges)| ranges);
            assert_eq!(ranges.map(|[_, count]| count).sum::<usize>(), plan.count);
        }
    }
}

/// A PLY file of Gaussians in time, at several times.
pub(super) fn spacetime(bytes: &[u8]) {
    let Ok(scene) = formats::spacetime::read(bytes, &formats::Limits::default()) else { return };
    for time in [-1e300, 0.0, 0.5] {
        let still = scene.at(time);
        assert_eq!((still.len(), still.uneven()), (scene.len(), None));
        draw_still(still);
    }
}

/// A still scene, on two levels.
fn draw_still(still: Still) {
    let camera = Camera::pinhole(Pose::default(), 60.0, 1.5).expect("a lens");
    let options = RenderOptions {
        size: Size::Exact { width: 12, height: 8 },
        depth: true,
        alpha: true,
        statistics: true,
        ..RenderOptions::default()
    };
    let [a, b] = WORKERS.each_ref().map(|workers| {
        let scene = Drawable::new(still.clone(), workers).expect("even arrays");
        Renderer::new(workers).render_still(&scene, &camera, &options).expect("a camera").clone()
    });
    assert_same_finite(&a, &b);
}

/// The header of a shared library.
pub(super) fn library(bytes: &[u8]) {
    if let Ok(Some(_)) = onnx::announced_length(&mut Cursor::new(bytes)) {
        assert!(bytes.starts_with(b"\x7fELF") && bytes.len() >= 64);
    }
}

/// A compressed scene: every interval drawn on two levels.
pub(super) fn container(bytes: &[u8]) {
    let Ok(intervals) = intervals_from_container(bytes) else { return };
    let options = RenderOptions { size: Size::Exact { width: 13, height: 9 }, ..RenderOptions::default() };
    for interval in &intervals {
        assert!(interval.gaussians.iter().all(|record| record.is_sound()));
        let [a, b] = WORKERS.each_ref().map(|workers| {
            interval.render(interval.end, &Camera::Canonical, &options, workers).expect("inside the interval")
        });
        assert_same_finite(&a, &b);
    }
}

/// Asserts that both images have the same bits and only finite values.
fn assert_same_finite(a: &Image, b: &Image) {
    let planes = |image: &Image| {
        let optional = [&image.depth, &image.alpha, &image.final_t].into_iter().flatten().flatten();
        image.rgb.iter().chain(optional).copied().collect::<Vec<f32>>()
    };
    let (a_values, b_values) = (planes(a), planes(b));
    assert!(a_values.iter().zip(&b_values).all(|(a, b)| a.to_bits() == b.to_bits()), "levels differ");
    assert_eq!((&a.blended, a.dropped), (&b.blended, b.dropped), "levels differ");
    assert!(a_values.iter().all(|x| x.is_finite()), "a value that is not finite was drawn");
}

/// The head of a request to the page's server.
pub(super) fn http(bytes: &[u8]) {
    use streamsplat::view::http::{Hosts, Request};
    let parsed = Request::parse(bytes);
    if let Ok(Some(request)) = &parsed {
        assert!(request.path.len() + request.query.len() + request.host.len() < bytes.len());
        let loopback = Hosts::of([127, 0, 0, 1].into(), &[]);
        let open = Hosts::of([0, 0, 0, 0].into(), &[]);
        assert!(open.contain(&request.host) || !loopback.contain(&request.host), "{:?}", request.host);
        // Bytes after a head do not change it.
        assert_eq!(Request::parse(&[bytes, b"more"].concat()), parsed);
    }
}
