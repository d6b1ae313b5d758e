//! Writing glTF 2.0, binary, with `KHR_gaussian_splatting`.

use serde_json::{Value, json};
use streamsplat_kernels::math::f64::exp;

use super::colour::linear_of_srgb;
use super::{EXTENSION, half_turn};
use crate::formats::notes::Notes;
use crate::formats::{Order, Written};
use crate::still::{Still, grown};

/// Writes a still scene as a binary glTF file: one point primitive with all attributes in binary32. It includes
/// `COLOR_0`, linear as in glTF, for programs that draw points.
///
/// Axes are glTF's: x left, y up, z forward. The scene's offset is its node's translation. Gaussians are in the scene's
/// order; those that cannot be drawn ([`Still::defect`]) are left out. [`read`](super::read) reads the file.
///
/// # Panics
/// If the arrays differ in length ([`Still::uneven`]), or if the file would be longer than 4 GiB, which its header
/// cannot store.
pub fn write(still: &Still) -> Written {
    let kept = Order::own(still);
    let mut notes = Notes::of(still, &kept);
    notes.without_mark(still, "glTF");
    let order = kept.places;
    let mut turned = still.clone();
    turned.transform(&half_turn(3));
    let opacity = |i: usize| 1.0 / (1.0 + exp(-f64::from(still.logit[i]).clamp(-200.0, 200.0)));
    let mut parts = Parts { order: &order, bytes: Vec::new(), views: Vec::new(), accessors: Vec::new() };
    let mut attributes = serde_json::Map::new();
    let mut add = |name: &str, accessor: usize| {
        attributes.insert(name.to_owned(), accessor.into());
    };
    add("POSITION", parts.floats("VEC3", true, |i| turned.mean[i]));
    let colour = |i: usize| {
        let seen = |c: f32| 0.5 + f64::from(c) * streamsplat_kernels::harmonics::Y0;
        let [red, green, blue] = still.base[i].map(|c| linear_of_srgb(seen(c).clamp(0.0, 1.0)));
        [red, green, blue, opacity(i)].map(|c| (255.0 * c).round().clamp(0.0, 255.0) as u8)
    };
    add("COLOR_0", parts.colours(colour));
    let own = |name: &str| format!("{EXTENSION}:{name}");
    let unit = |i: usize| {
        let q = turned.rotation[i].map(f64::from);
        let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
        let [w, x, y, z] = q.map(|c| (c / length) as f32);
        [x, y, z, w]
    };
    add(&own("ROTATION"), parts.floats("VEC4", false, unit));
    add(&own("SCALE"), parts.floats("VEC3", false, |i| still.log_scale[i].map(grown)));
    add(&own("OPACITY"), parts.floats("SCALAR", false, |i| [opacity(i) as f32]));
    add(&own("SH_DEGREE_0_COEF_0"), parts.floats("VEC3", false, |i| still.base[i]));
    let mut place = 0;
    for degree in 1..=still.degree {
        for k in 0..2 * degree + 1 {
            let width = 3 * still.rest();
            let coefficient = |i: usize| std::array::from_fn::<f32, 3, _>(|c| turned.higher[i * width + 3 * place + c]);
            add(&own(&format!("SH_DEGREE_{degree}_COEF_{k}")), parts.floats("VEC3", false, coefficient));
            place += 1;
        }
    }
    Written { bytes: parts.file(attributes, turned.about.offset), notes: notes.0 }
}

/// The binary chunk and its description.
struct Parts<'a> {
    order: &'a [usize],
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Parts<'_> {
    fn floats<const N: usize>(&mut self, shape: &str, bounded: bool, value: impl Fn(usize) -> [f32; N]) -> usize {
        let start = self.bytes.len();
        let (mut least, mut greatest) = ([f32::INFINITY; N], [f32::NEG_INFINITY; N]);
        for &i in self.order {
            let value = value(i);
            for (k, x) in value.into_iter().enumerate() {
                (least[k], greatest[k]) = (least[k].min(x), greatest[k].max(x));
                self.bytes.extend_from_slice(&x.to_le_bytes());
            }
        }
        let mut accessor = json!({ "componentType": 5126, "count": self.order.len(), "type": shape });
        if bounded && !self.order.is_empty() {
            accessor["min"] = json!(least.as_slice());
            accessor["max"] = json!(greatest.as_slice());
        }
        self.describe(start, accessor)
    }

    fn colours(&mut self, value: impl Fn(usize) -> [u8; 4]) -> usize {
        let start = self.bytes.len();
        self.bytes.extend(self.order.iter().flat_map(|&i| value(i)));
        let accessor = json!({ "componentType": 5121, "normalized": true, "count": self.order.len(), "type": "VEC4" });
        self.describe(start, accessor)
    }

    /// Adds an accessor for the bytes from `start` on; returns its index.
    fn describe(&mut self, start: usize, mut accessor: Value) -> usize {
        let length = self.bytes.len() - start;
        // A view without bytes is not allowed. An accessor without a view consists of zeros, here of no elements.
        if length > 0 {
            accessor["bufferView"] = self.views.len().into();
            self.views.push(json!({ "buffer": 0, "byteOffset": start, "byteLength": length, "target": 34962 }));
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn file(self, attributes: serde_json::Map<String, Value>, offset: [f64; 3]) -> Vec<u8> {
        let extension = json!({
            "kernel": "ellipse", "colorSpace": "srgb_rec709_display", "projection": "perspective", "sortingMethod": "cameraDistance",
        });
        let primitive = json!({ "attributes": attributes, "mode": 0, "extensions": { EXTENSION: extension } });
        let mut document = json!({
            "asset": { "version": "2.0", "generator": concat!("streamsplat ", env!("CARGO_PKG_VERSION")) },
            "extensionsUsed": [EXTENSION], "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
        });
        if offset != [0.0; 3] {
            document["nodes"][0]["translation"] = json!(offset);
        }
        if self.order.is_empty() {
            // A mesh has at least one primitive, and a primitive at least one point.
            document["nodes"] = json!([{}]);
        } else {
            document["meshes"] = json!([{ "primitives": [primitive] }]);
            document["accessors"] = self.accessors.into();
            document["bufferViews"] = self.views.into();
            document["buffers"] = json!([{ "byteLength": self.bytes.len() }]);
        }
        let mut text = document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut binary = self.bytes;
        binary.resize(binary.len().next_multiple_of(4), 0);
        let mut body = Vec::with_capacity(text.len() + binary.len() + 28);
        for (kind, chunk) in [(*b"JSON", text), (*b"BIN\0", binary)] {
            if !chunk.is_empty() {
                body.extend_from_slice(&length(chunk.len()));
                body.extend_from_slice(&kind);
                body.extend_from_slice(&chunk);
            }
        }
        [b"glTF".as_slice(), &2_u32.to_le_bytes(), &length(body.len() + 12), &body].concat()
    }
}

fn length(bytes: usize) -> [u8; 4] {
    u32::try_from(bytes).unwrap_or_else(|_| panic!("{bytes} bytes in one glTF file")).to_le_bytes()
}
