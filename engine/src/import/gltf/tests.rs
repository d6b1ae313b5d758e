//! glTF files go in, and what is none is named.

use serde_json::{Value, json};

use super::*;
use crate::export;

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
    }
}

/// The document of a binary file, and its buffer.
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
        let found = glb(&export::still::glb(&still)).expect("just written");
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
            // A turn there and back is a whole one: the opposite quaternion, which is the same rotation.
            assert!(a.iter().zip(b).all(|(a, b)| near(-a, b / length)), "{a:?} {b:?}");
        }
    }
    assert_eq!(glb(&export::still::glb(&Still::default())), Ok(Still::default()));
}

#[test]
fn nodes_move_turn_and_scale_what_hangs_below_them() {
    let (mut document, binary) = taken_apart(&export::still::glb(&still(3, 1)));
    let plain = glb(&together(&document, &binary)).expect("plain");
    // A quarter turn about y, then to x + 1, all twice as large: two nodes with the same mesh, one of them below another.
    let half = 0.5_f64.sqrt();
    document["nodes"] = json!([
        { "children": [1], "scale": [2, 2, 2] },
        { "mesh": 0, "translation": [1, 0, 0], "rotation": [0, half, 0, half] },
        { "mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 5, 1] },
    ]);
    document["scenes"] = json!([{ "nodes": [0, 2] }]);
    let found = glb(&together(&document, &binary)).expect("nodes");
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

#[test]
fn spz_in_a_buffer_is_read_in_its_own_axes() {
    let still = still(5, 2);
    let packed = export::still::spz(&still);
    let mut document = taken_apart(&export::still::glb(&still)).0;
    document["meshes"][0]["primitives"][0]["extensions"][EXTENSION]["extensions"] = json!({ SPZ: { "bufferView": 0 } });
    document["bufferViews"] = json!([{ "buffer": 0, "byteLength": packed.len() }]);
    document["buffers"] = json!([{ "byteLength": packed.len() }]);
    let mut binary = packed.clone();
    binary.resize(packed.len().next_multiple_of(4), 0);
    let found = glb(&together(&document, &binary)).expect("SPZ");
    // SPZ alone is read as x right, y up, z back; in glTF x is left: half a turn about y between them.
    let alone = spz::spz(&packed).expect("SPZ");
    for (a, b) in found.mean.iter().zip(&alone.mean) {
        assert_eq!(*a, [-b[0], b[1], -b[2]]);
    }
}

#[test]
fn numbers_of_one_and_two_bytes_and_strides_are_read() {
    let (mut document, mut binary) = taken_apart(&export::still::glb(&still(2, 0)));
    let names = ["ROTATION", "OPACITY"].map(|name| format!("{EXTENSION}:{name}"));
    let places = names
        .map(|name| document["meshes"][0]["primitives"][0]["attributes"][name].as_u64().expect("a number") as usize);
    let start = binary.len();
    // Records of 8 bytes: four signed bytes of the rotation, two bytes of the opacity, two of nothing.
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
    let found = glb(&together(&document, &binary)).expect("whole numbers");
    assert!(found.logit[0] > 27.0 && found.logit[1] < -27.0);
    // (x, y, z, w) = (0, 1, 0, −1), then a half turn about z.
    assert_eq!(found.rotation[0], crate::still::after([0.0, 0.0, 0.0, 1.0], [-1.0, 0.0, 1.0, 0.0]));
}

#[test]
fn what_is_wrong_is_named() {
    let (document, binary) = taken_apart(&export::still::glb(&still(2, 1)));
    let splats = |name: &str| format!("/meshes/0/primitives/0/attributes/{EXTENSION}:{name}");
    let extension = |name: &str| format!("/meshes/0/primitives/0/extensions/{EXTENSION}/{name}");
    for (place, value, expected) in [
        ("/asset/version".into(), json!("1.0"), "asset: version: expected 2.0"),
        ("/extensionsRequired".into(), json!(["KHR_draco"]), "extensionsRequired: expected KHR_gaussian_splatting"),
        ("/meshes/0/primitives/0/mode".into(), json!(4), "mesh 0, primitive 0: mode: expected 0 (points), found 4"),
        (extension("kernel"), json!("box"), "mesh 0, primitive 0: kernel: expected ellipse"),
        (
            extension("colorSpace"),
            json!("lin_rec709_display"),
            "mesh 0, primitive 0: colorSpace: expected srgb_rec709_display",
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
        let error = glb(&together(&wrong, &binary)).expect_err(&place).to_string();
        assert!(error.starts_with(expected), "{place} {value}: {error}");
    }
    let file = together(&document, &binary);
    for end in 0..file.len() {
        assert!(glb(&file[..end]).is_err(), "{end}");
    }
}
