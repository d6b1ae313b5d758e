//! Valid glTF files are read, and errors name the invalid part.

use serde_json::{Value, json};

use super::*;
use crate::formats;

fn still(count: usize, degree: usize) -> Still {
    let value = |i: usize, k: usize| ((i * 37 + k * 11) % 101) as f32 * 0.03 - 1.5;
    let triple = |i: usize, k: usize| std::array::from_fn(|axis| value(i, k + axis));
    Still {
        mean: (0..count).map(|i| triple(i, 0)).collect(),
        log_scale: (0..count).map(|i| triple(i, 3)).collect(),
        rotation: (0..count).map(|i| std::array::from_fn(|k| value(i, 6 + k) + 0.01)).collect(),
        logit: (0..count).map(|i| value(i, 10)).collect(),
        base: (0..count).map(|i| triple(i, 11)).collect(),
        degree,
        higher: (0..count * 3 * rest(degree)).map(|i| value(i, 14)).collect(),
        ..Still::default()
    }
}

/// Splits a binary file into its document and its buffer.
fn taken_apart(file: &[u8]) -> (Value, Vec<u8>) {
    let (text, binary) = chunks(file).expect("chunks");
    (serde_json::from_slice(text).expect("JSON"), binary.expect("a buffer").to_vec())
}

fn together(document: &Value, binary: &[u8]) -> Vec<u8> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let size = |n: usize| (n as u32).to_le_bytes();
    let all = 28 + text.len() + binary.len();
    [
        b"glTF",
        &2_u32.to_le_bytes(),
        &size(all),
        &size(text.len()),
        b"JSON",
        &text[..],
        &size(binary.len()),
        b"BIN\0",
        binary,
    ]
    .concat()
}

#[test]
fn a_scene_comes_back() {
    for degree in 0..=3 {
        let still = still(7, degree);
        let found = read(&formats::gltf::write(&still).bytes).expect("just written");
        assert_eq!(
            (&found.mean, &found.base, &found.higher),
            (&still.mean, &still.base, &still.higher),
            "degree {degree}"
        );
        let near = |a: f32, b: f32| (a - b).abs() < 2e-6;
        assert!(found.log_scale.iter().flatten().zip(still.log_scale.iter().flatten()).all(|(a, b)| near(*a, *b)));
        assert!(found.logit.iter().zip(&still.logit).all(|(a, b)| near(*a, *b)));
        for (a, b) in found.rotation.iter().zip(&still.rotation) {
            let length = b.iter().map(|c| c * c).sum::<f32>().sqrt();
            // Two half turns are a full one: the opposite quaternion, which is the same rotation.
            assert!(a.iter().zip(b).all(|(a, b)| near(-a, b / length)), "{a:?} {b:?}");
        }
    }
    assert!(read(&formats::gltf::write(&Still::default()).bytes).is_ok_and(|none| none.is_empty()));
}

#[test]
fn nodes_move_turn_and_scale_what_hangs_below_them() {
    let (mut document, binary) = taken_apart(&formats::gltf::write(&still(3, 1)).bytes);
    let plain = read(&together(&document, &binary)).expect("plain");
    // A quarter turn about y, then to x + 1, all twice as large: two nodes with the same mesh, one a child of the
    // other.
    let half = 0.5_f64.sqrt();
    document["nodes"] = json!([
        { "children": [1], "scale": [2, 2, 2] },
        { "mesh": 0, "translation": [1, 0, 0], "rotation": [0, half, 0, half] },
        { "mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 5, 1] },
    ]);
    document["scenes"] = json!([{ "nodes": [0, 2] }]);
    let found = read(&together(&document, &binary)).expect("nodes");
    assert_eq!(found.len(), 6);
    for i in 0..3 {
        // glTF (x, y, z) turns into (z, y, −x); scene space has −x and −y.
        let [x, y, z] = plain.mean[i];
        let expected = [-2.0 * (z + 1.0), 2.0 * y, 2.0 * x];
        assert!((0..3).all(|k| (found.mean[i][k] - expected[k]).abs() < 1e-5), "{:?} {expected:?}", found.mean[i]);
        assert!((found.log_scale[i][0] - plain.log_scale[i][0] - 2.0_f32.ln()).abs() < 1e-6);
        assert_eq!(found.mean[3 + i], [x, y, z + 5.0]);
        assert_eq!(found.higher[9 * (3 + i)..][..9], plain.higher[9 * i..][..9]);
    }
}

/// Builds a document whose primitive is an SPZ file.
fn with_spz(packed: &[u8]) -> Vec<u8> {
    let mut document = taken_apart(&formats::gltf::write(&still(5, 2)).bytes).0;
    document["meshes"][0]["primitives"][0]["extensions"][EXTENSION]["extensions"] = json!({ SPZ: { "bufferView": 0 } });
    document["bufferViews"] = json!([{ "buffer": 0, "byteLength": packed.len() }]);
    document["buffers"] = json!([{ "byteLength": packed.len() }]);
    let mut binary = packed.to_vec();
    binary.resize(packed.len().next_multiple_of(4), 0);
    together(&document, &binary)
}

#[test]
fn spz_in_a_buffer_is_read_along_the_axes_that_it_has_alone() {
    let packed = formats::spz::write(&still(5, 2), formats::SpzVersion::V3).bytes;
    // Axes are RDF with the comment of the gzip stream, and RUB without it.
    let mut silent = packed.clone();
    let at = silent.windows(8).position(|w| w == b"axes RDF").expect("the comment");
    silent[at..at + 8].copy_from_slice(b"no words");
    for file in [packed, silent] {
        let (found, alone) = (read(&with_spz(&file)).expect("SPZ"), spz::read(&file).expect("SPZ"));
        assert_eq!((&found.mean, &found.higher), (&alone.mean, &alone.higher));
        assert_eq!((found.about.axes, found.about.axes_assumed), (alone.about.axes, alone.about.axes_assumed));
        // The user's axes override both.
        let mut beside = Beside::none();
        beside.axes = Some(Axes::LUF);
        let told = within(&with_spz(&file), &beside, &Limits::default()).expect("SPZ");
        let mut expected = alone.clone();
        expected.taken_along(Axes::LUF);
        assert_eq!((told.mean, told.about.axes, told.about.axes_assumed), (expected.mean, Axes::LUF, false));
    }
}

#[test]
fn the_colour_of_points_is_linear_and_stands_in_for_coefficients() {
    let mut one = still(2, 0);
    one.base = vec![[0.1, 0.1, -9.0], [1.0, 0.0, 9.0]];
    let (mut document, binary) = taken_apart(&formats::gltf::write(&one).bytes);
    let attributes = &document["meshes"][0]["primitives"][0]["attributes"];
    let accessor = attributes["COLOR_0"].as_u64().expect("an accessor") as usize;
    let view =
        &document["bufferViews"][document["accessors"][accessor]["bufferView"].as_u64().expect("a view") as usize];
    let start = view["byteOffset"].as_u64().expect("a place") as usize;
    // 0.5 + 0.0282 is 135 in sRGB, and 61 in linear light.
    assert_eq!(binary[start..start + 3], [61, 61, 0]);
    let whole = read(&together(&document, &binary)).expect("whole");
    let attributes = document["meshes"][0]["primitives"][0]["attributes"].as_object_mut().expect("attributes");
    attributes.remove("KHR_gaussian_splatting:SH_DEGREE_0_COEF_0");
    attributes.remove("KHR_gaussian_splatting:OPACITY");
    let found = read(&together(&document, &binary)).expect("the points' colours");
    let seen = |c: f32| (0.5 + f64::from(c) * streamsplat_kernels::harmonics::Y0).clamp(0.0, 1.0);
    let near = |a: f32, b: f32| (seen(a) - seen(b)).abs() < 0.004;
    assert!(
        found.base.iter().flatten().zip(whole.base.iter().flatten()).all(|(a, b)| near(*a, *b)),
        "{:?}",
        found.base
    );
    assert!(found.logit.iter().zip(&whole.logit).all(|(a, b)| (a - b).abs() < 0.03));
    assert_eq!(
        found.about.notes,
        ["mesh 0, primitive 0: colours from COLOR_0, as there are no coefficients of degree 0"]
    );
}

#[test]
fn linear_colours_other_kernels_and_materials_are_read() {
    let original = still(6, 1);
    let (mut document, binary) = taken_apart(&formats::gltf::write(&original).bytes);
    document["extensionsRequired"] = json!(["KHR_materials_unlit", EXTENSION]);
    let extension = format!("/meshes/0/primitives/0/extensions/{EXTENSION}");
    document.pointer_mut(&extension).expect("the extension")["kernel"] = json!("customShape");
    let found = read(&together(&document, &binary)).expect("another kernel");
    assert_eq!(found.mean, original.mean);
    assert_eq!(found.about.notes, ["mesh 0, primitive 0: kernel \"customShape\" is not known: drawn as ellipse"]);
    document.pointer_mut(&extension).expect("the extension")["colorSpace"] = json!("lin_rec709_display");
    let linear = read(&together(&document, &binary)).expect("linear colours");
    let seen = |c: f32| 0.5 + f64::from(c) * streamsplat_kernels::harmonics::Y0;
    for (a, b) in linear.base.iter().flatten().zip(original.base.iter().flatten()) {
        assert!((colour::linear_of_srgb(seen(*a)) - seen(*b).max(0.0)).abs() < 1e-6);
    }
    assert_eq!(linear.about.notes.len(), 2);
}

#[test]
fn parts_that_are_not_read_are_told() {
    let (mut document, binary) = taken_apart(&formats::gltf::write(&still(2, 0)).bytes);
    document["meshes"][0]["primitives"][0]["extensions"][EXTENSION]["projection"] = json!("orthographic");
    document["meshes"][0]["primitives"][0]["targets"] = json!([{ "POSITION": 0 }]);
    let primitives = document["meshes"][0]["primitives"].as_array_mut().expect("a list");
    primitives.push(json!({ "attributes": { "POSITION": 0 }, "mode": 0 }));
    document["animations"] = json!([{}]);
    document["skins"] = json!([{}]);
    document["extensionsUsed"] = json!([EXTENSION, "KHR_node_visibility", "KHR_materials_unlit"]);
    let found = read(&together(&document, &binary)).expect("two Gaussians");
    assert_eq!(
        found.about.notes,
        [
            "mesh 0, primitive 0: projection \"orthographic\" is not known: drawn as perspective",
            "primitives without Gaussians, such as meshes, are left out: 1",
            "the scene is read without its animations and skins and morph targets",
            "extensions that are not read: KHR_node_visibility"
        ]
    );
}

#[test]
fn a_node_far_away_is_the_scenes_offset_and_comes_back() {
    let mut far = still(4, 1);
    far.about.offset = [431_250.0, 5_411_800.0, 312.0];
    let file = formats::gltf::write(&far).bytes;
    let (document, _) = taken_apart(&file);
    assert_eq!(document["nodes"][0]["translation"], json!([-431_250.0, -5_411_800.0, 312.0]));
    let found = read(&file).expect("just written");
    assert_eq!((&found.mean, found.about.offset), (&far.mean, far.about.offset));
    // Another primitive is relative to the same offset.
    let (mut document, binary) = taken_apart(&file);
    document["nodes"] = json!([
        { "mesh": 0, "translation": [-431_250.0, -5_411_800.0, 312.0] },
        { "mesh": 0, "translation": [-431_249.5, -5_411_800.0, 312.0] },
    ]);
    document["scenes"][0]["nodes"] = json!([0, 1]);
    let found = read(&together(&document, &binary)).expect("two");
    assert_eq!(found.mean[4], [far.mean[0][0] - 0.5, far.mean[0][1], far.mean[0][2]]);
}

#[test]
fn buffers_lie_in_folders_below_under_names_with_percent_signs() {
    let (mut document, binary) = taken_apart(&formats::gltf::write(&still(3, 0)).bytes);
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::create_dir(folder.path().join("parts")).expect("writable");
    for (uri, name) in [("my%20data.bin", "my data.bin"), ("./a.bin", "a.bin"), ("parts/%C3%BC.bin", "parts/ü.bin")] {
        std::fs::write(folder.path().join(name), &binary).expect("writable");
        document["buffers"][0]["uri"] = json!(uri);
        let path = folder.path().join("scene.gltf");
        std::fs::write(&path, document.to_string()).expect("writable");
        assert!(crate::open::scene(&path, &Limits::default()).is_ok(), "{uri}");
    }
    document["buffers"][0]["uri"] = json!("parts/%2e%2e/../../a.bin");
    let path = folder.path().join("scene.gltf");
    std::fs::write(&path, document.to_string()).expect("writable");
    let error = crate::open::scene(&path, &Limits::default()).expect_err("outside").to_string();
    assert!(error.contains("the name of another place"), "{error}");
}

#[test]
fn numbers_of_one_and_two_bytes_and_strides_are_read() {
    let (mut document, mut binary) = taken_apart(&formats::gltf::write(&still(2, 0)).bytes);
    let names = ["ROTATION", "OPACITY"].map(|name| format!("{EXTENSION}:{name}"));
    let places = names
        .map(|name| document["meshes"][0]["primitives"][0]["attributes"][name].as_u64().expect("a number") as usize);
    let start = binary.len();
    // Records of 8 bytes: four signed bytes of the rotation, two bytes of the opacity, two of padding.
    binary.extend([0_u8, 127, 0, 129, 0xff, 0xff, 9, 9, 127, 0, 0, 0, 0, 0, 9, 9]);
    document["buffers"][0]["byteLength"] = binary.len().into();
    let view = document["bufferViews"].as_array().expect("views").len();
    document["bufferViews"][view - 1]["target"] = 34962.into();
    document["bufferViews"]
        .as_array_mut()
        .expect("views")
        .push(json!({ "buffer": 0, "byteOffset": start, "byteLength": 16, "byteStride": 8 }));
    document["accessors"][places[0]] =
        json!({ "bufferView": view, "componentType": 5120, "normalized": true, "count": 2, "type": "VEC4" });
    document["accessors"][places[1]] = json!({ "bufferView": view, "byteOffset": 4, "componentType": 5123, "normalized": true, "count": 2, "type": "SCALAR" });
    let found = read(&together(&document, &binary)).expect("whole numbers");
    assert!(found.logit[0] > 27.0 && found.logit[1] < -27.0);
    // (x, y, z, w) = (0, 1, 0, −1), then a half turn about z.
    assert_eq!(found.rotation[0], crate::still::after([0.0, 0.0, 0.0, 1.0], [-1.0, 0.0, 1.0, 0.0]));
}

#[test]
fn what_is_wrong_is_named() {
    let (document, binary) = taken_apart(&formats::gltf::write(&still(2, 1)).bytes);
    let splats = |name: &str| format!("/meshes/0/primitives/0/attributes/{EXTENSION}:{name}");
    let extension = |name: &str| format!("/meshes/0/primitives/0/extensions/{EXTENSION}/{name}");
    for (place, value, expected) in [
        ("/asset/version".into(), json!("1.0"), "asset: version: expected 2.0"),
        ("/extensionsRequired".into(), json!(["KHR_draco"]), "extensionsRequired: expected KHR_gaussian_splatting"),
        ("/meshes/0/primitives/0/mode".into(), json!(4), "mesh 0, primitive 0: mode: expected 0 (points), found 4"),
        (
            extension("colorSpace"),
            json!("acescg"),
            "mesh 0, primitive 0: colorSpace: expected srgb_rec709_display or lin_rec709_display, found",
        ),
        (splats("SCALE"), json!(99), "accessor 99: expected one of"),
        (splats("SCALE"), json!(0), "mesh 0, primitive 0: SCALE: expected standard deviations of 0 or more"),
        (splats("OPACITY"), json!(0), "accessor 0: expected 2 of SCALAR, found 2 of VEC3"),
        ("/accessors/0/count".into(), json!(3), "accessor 0: expected 3 elements"),
        ("/accessors/0/count".into(), json!(1_u64 << 60), "meshes of all nodes: expected at most 16777216 Gaussians"),
        ("/accessors/0/componentType".into(), json!(5125), "accessor 0: expected componentType"),
        ("/accessors/0/sparse".into(), json!({}), "accessor 0: expected a bufferView"),
        ("/accessors/0/byteOffset".into(), json!(u64::MAX), "accessor 0: expected 2 elements"),
        ("/bufferViews/0/byteLength".into(), json!(u64::MAX), "bufferView 0: expected"),
        (
            "/bufferViews/0/extensions".into(),
            json!({ "EXT_meshopt_compression": {} }),
            "bufferView 0: expected no extensions",
        ),
        ("/buffers/0/byteLength".into(), json!(1 << 20), "buffer 0: expected 1048576 bytes"),
        ("/buffers/0/uri".into(), json!("../a.bin"), "file \"../a.bin\": expected a file beside this one"),
        ("/buffers/0/uri".into(), json!("data:;base64,*"), "buffer 0: expected base64"),
        ("/nodes/0".into(), json!({ "mesh": 0, "children": [0] }), "node 0: expected one node above it, found two"),
        ("/meshes/0/primitives/0/indices".into(), json!(0), "mesh 0, primitive 0: indices: expected none, found 0"),
        ("/nodes/0".into(), json!({ "mesh": 7 }), "mesh 7: expected"),
        (
            "/nodes/0".into(),
            json!({ "mesh": 0, "scale": [1, 2, 1] }),
            "mesh 0, primitive 0: expected nodes that move, turn and scale alike",
        ),
        (
            "/nodes/0".into(),
            json!({ "mesh": 0, "scale": [-1, 1, 1] }),
            "mesh 0, primitive 0: expected nodes that move, turn and scale alike",
        ),
        (
            "/nodes/0".into(),
            json!({ "mesh": 0, "scale": [0, 0, 0] }),
            "mesh 0, primitive 0: expected nodes that move, turn and scale alike",
        ),
    ] {
        let mut wrong = document.clone();
        match wrong.pointer_mut(&place) {
            Some(found) => *found = value.clone(),
            None => {
                let (parent, name) = place.rsplit_once('/').expect("a place");
                wrong.pointer_mut(parent).expect("its parent")[name] = value.clone();
            }
        }
        let error = read(&together(&wrong, &binary)).expect_err(&place).to_string();
        assert!(error.starts_with(expected), "{place} {value}: {error}");
    }
    let file = together(&document, &binary);
    for end in 0..file.len() {
        assert!(read(&file[..end]).is_err(), "{end}");
    }
}
