//! Small well-formed inputs of every kind that a reader reads.

use std::io::Cursor;

use image::{DynamicImage, ImageFormat};
use safetensors::tensor::{Dtype, TensorView};
use streamsplat::fit::Placement;
use streamsplat::scene::{ContainerWriter, from_safetensors, to_safetensors};
use streamsplat::still::Still;
use streamsplat::stream::{Handover, Interval, Merge, Record, Reference, Workers};
use streamsplat::{formats, openexr};
use streamsplat_kernels::Level;

/// Configuration that the shapes of [`model`] do not determine.
pub(super) const CONFIG: &str =
    r#"{"resolution": [1, 1], "upsampler_window": 1, "use_dino": false, "resized_to": [1, 1]}"#;

/// A handwritten safetensors file, for number formats that our writer lacks: every tensor is zero.
fn zeros(tensors: &[(&str, &str, &[usize], usize)]) -> Vec<u8> {
    let (mut entries, mut end) = (Vec::new(), 0);
    for (name, dtype, shape, bits) in tensors {
        let start = end;
        end += (shape.iter().product::<usize>() * bits).div_ceil(8);
        entries.push(format!(r#""{name}":{{"dtype":"{dtype}","shape":{shape:?},"data_offsets":[{start},{end}]}}"#));
    }
    let header = format!("{{{}}}", entries.join(","));
    let mut file = (header.len() as u64).to_le_bytes().to_vec();
    file.extend_from_slice(header.as_bytes());
    file.resize(file.len() + end, 0);
    file
}

/// The tensors of a checkpoint that determine its sizes, for patches of one pixel.
pub(super) fn model() -> Vec<u8> {
    const ENCODER: &str = "model.gs_predictor.encoder.transformer_encoder";
    const DECODER: &str = "model.decoder.transformer_decoder";
    const UPSAMPLER: &str = "model.gs_predictor.gaussian_upsampler";
    let names = [
        format!("{ENCODER}.conv.weight"),
        format!("{ENCODER}.transformer.resblocks.0.layernorm1.weight"),
        format!("{DECODER}.condition_proj.weight"),
        format!("{DECODER}.positional_embedding"),
        format!("{UPSAMPLER}.upsampler_0.residual_fc.weight"),
        format!("{UPSAMPLER}.upsampler_1.residual_fc.weight"),
    ];
    let shapes: [&[usize]; 6] = [&[64, 4, 1, 1], &[64], &[64, 64], &[1, 2, 64], &[256, 64], &[256, 64]];
    let tensors: Vec<_> = names.iter().zip(shapes).map(|(name, shape)| (name.as_str(), "F4", shape, 4)).collect();
    zeros(&tensors)
}

pub(super) fn checkpoint() -> Vec<Vec<u8>> {
    let formats =
        zeros(&[("a", "F32", &[2, 3], 32), ("b", "F16", &[5], 16), ("c", "BF16", &[], 16), ("d", "I64", &[0], 64)]);
    let dino = zeros(&[
        ("cls_token", "F16", &[1, 1, 64], 16),
        ("patch_embed.proj.weight", "F16", &[64, 3, 1, 1], 16),
        ("pos_embed", "F16", &[1, 5, 64], 16),
        ("register_tokens", "F16", &[1, 4, 64], 16),
    ]);
    let torch = std::fs::read(streamsplat_fixtures::path("torch/tensors.pth")).expect("a fixture");
    vec![model(), formats, dino, torch]
}

pub(super) fn model_config() -> Vec<Vec<u8>> {
    let nested = r#"{"config": {"resolution": [1, 1], "upsampler_window": 4, "encoder_window": 1, "use_dino": false,
        "hidden_dim": 64, "encoder_layers": 1, "patch_size": 1, "static_position": "tanh",
        "upsampler_stages": 2}, "note": null}"#;
    vec![CONFIG.as_bytes().to_vec(), nested.as_bytes().to_vec()]
}

pub(super) fn interval() -> Vec<Vec<u8>> {
    let record = |i: u8| {
        let x = f32::from(i);
        Record {
            mean: [0.3 * x - 0.5, 0.2 * x, 0.1],
            velocity: [0.1, 0.0, -0.2],
            gamma: [3.0 * x, 0.5],
            opacity: 0.9,
            scale: [0.2, 0.1],
            rgb: [0.2 * x, 0.5, 1.0],
            identity: u64::from(i),
            frame: 1,
            reference: if i.is_multiple_of(2) { Reference::Start } else { Reference::End },
            handover: [Handover::None, Handover::Arrives, Handover::Leaves][usize::from(i % 3)],
            ..Record::default()
        }
    };
    let interval = Interval {
        index: 1,
        start: 0.0,
        end: 0.25,
        gaussians: (0..5).map(record).collect(),
        placement: Placement { source: [9, 16], model: [18, 32], offset: [0, 0], content: [18, 32] },
        merges: vec![Merge { identity: 3, into: 4 }],
        dropped: 0,
    };
    let mut changing = interval.clone();
    for (i, rate) in changing.gaussians.rgb_rate.iter_mut().enumerate() {
        *rate = [0.1 * i as f32, -0.25, 0.0];
    }
    changing.gaussians.thickness.fill(0.5);
    [interval, changing].iter().map(|interval| to_safetensors(interval).expect("even arrays")).collect()
}

pub(super) fn scene_index() -> Vec<Vec<u8>> {
    let text = r#"{"format": "streamsplat-scene", "version": 1, "fps": 24.0,
        "placement": {"source": [9, 16], "model": [18, 32], "offset": [0, 0], "content": [18, 32]},
        "intervals": [{"file": "interval-000000.safetensors", "start": 0.0, "end": 0.0, "gaussians": 5, "bytes": 900, "blake3": "00"},
        {"file": "interval-000001.safetensors", "start": 0.0, "end": 0.25, "gaussians": 10, "bytes": 1800, "blake3": "11"}]}"#;
    vec![text.as_bytes().to_vec()]
}

pub(super) fn camera() -> Vec<Vec<u8>> {
    [
        r#"{"type": "canonical"}"#,
        r#"{"type": "orthographic", "position": [0, 0, -1], "look_at": [0.1, 0, 1], "up": [0, -1, 0], "half_extent": [1, 2]}"#,
        r#"{"type": "pinhole", "rotation": [1, 0, 0.1, 0], "fov_y_degrees": 50, "aspect": 1.5}"#,
        r#"{"type": "pinhole", "size": [20, 10], "fx": 20, "fy": 20, "cx": 9.5, "cy": 4.5}"#,
        r#"{"views": [{"time": 0, "type": "pinhole", "focal": [1, 2], "centre": [0.5, 0.5]},
            {"time": 1.5, "type": "pinhole", "focal": [1, 1], "position": [0.2, 0, -0.5]}]}"#,
        r#"[{"id": 0, "img_name": "a", "width": 20, "height": 10, "position": [1, 2, 3],
            "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 20, "fy": 21}]"#,
        r#"{"camera_angle_x": 0.9, "frames": [{"file_path": "./a", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]}]}"#,
        r#"{"w": 20, "h": 10, "fl_x": 20, "cx": 9.5, "k1": 0, "frames": [{"file_path": "a", "fl_y": 19, "transform_matrix": [[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 2]]}]}"#,
        "# cameras\n1 SIMPLE_PINHOLE 20 10 20 10 5\n2 PINHOLE 20 10 20 21 10 5\n%%# images\n1 1 0 0 0 0 0 2 1 a.png\n\n2 0.5 0.5 0.5 0.5 1 2 3 2 b.png\n1 2 -1\n",
        "1 PINHOLE 20 10 20 21 10 5\n2 EUCM 20 10 20 21 10 5 0 0%%1 1 0 0 0 0 0 2 1 a\n\n2 1 0 0 0 0 0 2 2 b\n\n%%1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 1 0 0%%1 1 1 0 0 0 0 0 2 2 CAMERA 1 1 CAMERA 2 2",
        r#"{"render_width": 20, "render_height": 10, "fps": 24, "camera_path": [{"camera_to_world": [1,0,0,0, 0,1,0,0, 0,0,1,2, 0,0,0,1], "fov": 50}]}"#,
        r#"{"camera": {"fov": 50, "position": [0, 0, -3], "target": [0, 0, 0]}, "animTracks": [{"duration": 1, "keyframes": {"times": [0, 1], "values": {"position": [0,0,1, 1,0,1], "target": [0,0,0, 0,0,0]}}}]}"#,
        r#"{"version": 2, "cameras": [{"initial": {"fov": 50, "position": [0, 0, -3], "target": [0, 0, 0]}}], "annotations": [{"title": "a", "camera": {"initial": {"position": [0, 1, -3], "target": [0, 0, 0]}}}]}"#,
    ]
    .into_iter()
    .map(|text| text.as_bytes().to_vec())
    .chain([colmap()])
    .collect()
}

/// The binary files of a COLMAP model, with `%%` between them.
fn colmap() -> Vec<u8> {
    let mut bytes = 1_u64.to_le_bytes().to_vec();
    [1_u32, 1].iter().for_each(|n| bytes.extend(n.to_le_bytes()));
    [20_u64, 10].iter().for_each(|n| bytes.extend(n.to_le_bytes()));
    [20.0_f64, 21.0, 10.0, 5.0].iter().for_each(|n| bytes.extend(n.to_le_bytes()));
    bytes.extend(b"%%");
    bytes.extend(1_u64.to_le_bytes());
    bytes.extend(1_u32.to_le_bytes());
    [1.0_f64, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0].iter().for_each(|n| bytes.extend(n.to_le_bytes()));
    bytes.extend(1_u32.to_le_bytes());
    bytes.extend(b"a.png\0");
    bytes.extend(1_u64.to_le_bytes());
    bytes.extend([7; 24]);
    bytes
}

pub(super) fn y4m() -> Vec<Vec<u8>> {
    ["420jpeg", "420mpeg2 XCOLORRANGE=FULL", "422p10", "411", "444alpha", "mono16"]
        .map(|colour| {
            let mut stream = format!("YUV4MPEG2 W5 H3 F30000:1001 Ip A1:1 C{colour}\n").into_bytes();
            for frame in 0..2 {
                stream.extend_from_slice(b"FRAME\n");
                let bytes = match colour {
                    "422p10" => 2 * (15 + 2 * 9),
                    "411" => 15 + 2 * 6,
                    "444alpha" => 4 * 15,
                    "mono16" => 2 * 15,
                    _ => 15 + 2 * 6,
                };
                stream.extend((0..bytes).map(|i| (i * 11 + frame) as u8));
            }
            stream
        })
        .into()
}

/// A picture of 5×3 pixels in several kinds of samples.
fn pictures() -> Vec<DynamicImage> {
    let rgb =
        DynamicImage::ImageRgb8(image::RgbImage::from_fn(5, 3, |x, y| image::Rgb([50 * x as u8, 80 * y as u8, 7])));
    let (grey, deep) = (DynamicImage::ImageLuma8(rgb.to_luma8()), DynamicImage::ImageRgb16(rgb.to_rgb16()));
    let (clear, fine) = (DynamicImage::ImageRgba8(rgb.to_rgba8()), DynamicImage::ImageLuma16(rgb.to_luma16()));
    vec![rgb, grey, deep, clear, fine]
}

fn encoded(picture: &DynamicImage, format: ImageFormat) -> Option<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, format).ok()?;
    Some(bytes.into_inner())
}

fn exr(names: &[&str]) -> Vec<u8> {
    let plane: Vec<f32> = (0..15).map(|i| i as f32 / 14.0).collect();
    let channels = names.iter().map(|name| ((*name).to_owned(), plane.clone())).collect();
    let mut bytes = Vec::new();
    openexr::write(&openexr::Planes { width: 5, height: 3, channels }, "a note", &mut bytes).expect("memory");
    bytes
}

/// A handwritten TIFF: little-endian, one uncompressed strip of 2×2 grey samples of `bits` bits.
fn tiff(bits: u16) -> Vec<u8> {
    let data: Vec<u8> = (0..4 * bits / 8).map(|i| (i * 31) as u8).collect();
    let entries: [(u16, u16, u32); 8] = [
        (256, 3, 2),
        (257, 3, 2),
        (258, 3, u32::from(bits)),
        (259, 3, 1),
        (262, 3, 1),
        (273, 4, 8),
        (278, 3, 2),
        (279, 4, data.len() as u32),
    ];
    let mut file = b"II*\0".to_vec();
    file.extend((8 + data.len() as u32).to_le_bytes());
    file.extend(&data);
    file.extend((entries.len() as u16).to_le_bytes());
    for (tag, kind, value) in entries {
        file.extend(tag.to_le_bytes());
        file.extend(kind.to_le_bytes());
        file.extend(1_u32.to_le_bytes());
        file.extend(value.to_le_bytes());
    }
    file.extend(0_u32.to_le_bytes());
    file
}

/// A handwritten JPEG of one grey block, with the shortest possible tables.
fn jpeg() -> Vec<u8> {
    let mut file = vec![0xff, 0xd8, 0xff, 0xdb, 0, 67, 0];
    file.extend([1; 64]);
    file.extend([0xff, 0xc0, 0, 11, 8, 0, 8, 0, 8, 1, 1, 0x11, 0]);
    for class in [0x00, 0x10] {
        // One code of one bit, 0: no difference, or the end of the block.
        file.extend([0xff, 0xc4, 0, 20, class, 1]);
        file.extend([0; 16]);
    }
    file.extend([0xff, 0xda, 0, 8, 1, 1, 0, 0, 63, 0, 0x3f, 0xff, 0xd9]);
    file
}

pub(super) fn image() -> Vec<Vec<u8>> {
    use ImageFormat::{Bmp, Png, Pnm, Qoi, Tga, WebP};
    let pictures = pictures();
    let formats = [Png, Bmp, WebP, Pnm, Tga, Qoi];
    let encode =
        |picture: &DynamicImage| formats.map(|format| encoded(picture, format)).into_iter().flatten().collect();
    let mut seeds: Vec<Vec<u8>> = pictures.iter().flat_map(|picture| -> Vec<Vec<u8>> { encode(picture) }).collect();
    seeds.extend([exr(&["B", "G", "R"]), exr(&["A", "Y"]), tiff(8), tiff(16), jpeg()]);
    seeds
}

pub(super) fn depth_map() -> Vec<Vec<u8>> {
    let npy = |kind: &str, size: usize| {
        let header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': (3, 2), }}\n");
        let mut file = b"\x93NUMPY\x01\x00".to_vec();
        file.extend((header.len() as u16).to_le_bytes());
        file.extend_from_slice(header.as_bytes());
        file.extend((0..6 * size).map(|i| i as u8));
        file
    };
    let grey = pictures().into_iter().filter(|p| p.color().channel_count() == 1);
    let mut seeds: Vec<Vec<u8>> = grey.filter_map(|p| encoded(&p, ImageFormat::Png)).collect();
    seeds.extend([
        npy("<f4", 4),
        npy(">f2", 2),
        npy("<f8", 8),
        npy("|u1", 1),
        npy("<u2", 2),
        npy(">i2", 2),
        npy("<i8", 8),
        exr(&["Z"]),
        exr(&["depth.Z", "R"]),
        tiff(16),
    ]);
    seeds
}

pub(super) fn splat() -> Vec<Vec<u8>> {
    let file = |pinhole: bool| {
        let floats = |values: &[f32]| -> Vec<u8> { values.iter().flat_map(|v| v.to_le_bytes()).collect() };
        let focal: &[f32] = if pinhole { &[4.0, 4.0, 3.5, 2.5] } else { &[4.0, 3.0] };
        let tensors: Vec<(&str, Vec<usize>, Vec<u8>)> = vec![
            ("mean", vec![2, 3], floats(&[0.0, 0.1, 1.0, -0.2, 0.0, 2.0])),
            ("scale", vec![2, 3], floats(&[0.3, 0.2, 0.1, 0.5, 0.01, 0.2])),
            ("quat", vec![2, 4], floats(&[1.0, 0.0, 0.0, 0.0, 0.8, 0.0, 0.6, 0.0])),
            ("opacity", vec![2], floats(&[0.9, 0.5])),
            ("rgb", vec![2, 3], floats(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.5])),
            ("size", vec![2], floats(&[6.0, 8.0])),
            ("background", vec![3], floats(&[0.5; 3])),
            (if pinhole { "intrinsics" } else { "focal" }, vec![focal.len()], floats(focal)),
        ];
        let views = tensors.iter().map(|(name, shape, bytes)| {
            (*name, TensorView::new(Dtype::F32, shape.clone(), bytes).expect("a shape that fits"))
        });
        safetensors::serialize(views, None).expect("a file")
    };
    vec![file(false), file(true)]
}

/// A few Gaussians with harmonics of a degree.
fn still(degree: usize) -> Still {
    let value = |i: usize, k: usize| ((i * 37 + k * 11) % 101) as f32 / 101.0;
    let count = 3;
    let rest = (degree + 1) * (degree + 1) - 1;
    Still {
        mean: (0..count).map(|i| [value(i, 0) - 0.5, value(i, 1) - 0.5, 1.0 + value(i, 2)]).collect(),
        log_scale: (0..count).map(|i| std::array::from_fn(|k| -3.0 + value(i, 3 + k))).collect(),
        rotation: (0..count).map(|i| std::array::from_fn(|k| value(i, 6 + k) - 0.4)).collect(),
        logit: (0..count).map(|i| 4.0 * value(i, 10) - 1.0).collect(),
        base: (0..count).map(|i| std::array::from_fn(|k| value(i, 11 + k))).collect(),
        degree,
        higher: (0..count * 3 * rest).map(|i| value(i, 14) - 0.5).collect(),
        ..Still::default()
    }
}

pub(super) fn ply() -> Vec<Vec<u8>> {
    let files: Vec<Vec<u8>> = (0..=3).map(|degree| formats::ply::write(&still(degree)).bytes).collect();
    // As text, and in the other byte order.
    let end = files[0].windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
    let header = String::from_utf8_lossy(&files[0][..end]);
    let values = files[0][end..].as_chunks::<4>().0;
    let mut text = header.replace("binary_little_endian", "ascii");
    for vertex in values.chunks(17) {
        let words: Vec<String> = vertex.iter().map(|b| f32::from_le_bytes(*b).to_string()).collect();
        text += &(words.join(" ") + "\n");
    }
    let mut big = header.replace("little", "big").into_bytes();
    values.iter().for_each(|b| big.extend(b.iter().rev()));
    let packed = [0, 2].map(|degree| formats::compressed_ply::write(&still(degree)).bytes).to_vec();
    [files, vec![text.into_bytes(), big], packed].concat()
}

pub(super) fn splat_records() -> Vec<Vec<u8>> {
    vec![(0..96).map(|i| if i % 32 < 24 && i % 4 == 3 { 0x3e } else { (i * 53 % 251) as u8 }).collect(), vec![]]
}

/// Two Gaussians at each level of compression, in two buckets.
pub(super) fn ksplat() -> Vec<Vec<u8>> {
    let of = |level: u16, degree: u16| {
        let mut bytes = vec![0; 4096 + 1024];
        let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
        put(1, &[1]);
        let buckets = if level == 0 { 0 } else { 2 };
        let numbers =
            [(4, 1), (8, 1), (12, 2), (16, 2), (4096, 2), (4100, 2), (4104, 1), (4108, buckets), (4128, buckets / 2)];
        numbers.iter().for_each(|(at, value)| put(*at, &u32::to_le_bytes(*value)));
        put(4132, &u32::to_le_bytes(buckets / 2));
        put(20, &level.to_le_bytes());
        put(4112, &5.0_f32.to_le_bytes());
        put(4116, &12_u16.to_le_bytes());
        put(4136, &degree.to_le_bytes());
        if level > 0 {
            bytes.extend(1_u32.to_le_bytes());
            [0.5_f32, -0.5, 1.0, 0.0, 0.0, 2.0].iter().for_each(|x| bytes.extend(x.to_le_bytes()));
        }
        let harmonics = [0, 9, 24][usize::from(degree)];
        let record = [44 + 4 * harmonics, 24 + 2 * harmonics, 24 + harmonics][usize::from(level)];
        // Halves and floats of this byte are small and positive.
        bytes.extend(vec![0x2f; 2 * record]);
        bytes
    };
    vec![of(0, 0), of(0, 2), of(1, 1), of(2, 2)]
}

pub(super) fn streamed_sog() -> Vec<Vec<u8>> {
    let text = r#"{"version": 1, "lodLevels": 2, "count": 9, "counts": [6, 3], "filenames": ["0_0/meta.json", "1_0/meta.json"],
        "environment": "env/meta.json", "tree": {"bound": {}, "children": [
        {"lods": {"0": {"file": 0, "offset": 2, "count": 4}, "1": {"file": 1, "offset": 0, "count": 3}}},
        {"children": [{"lods": {"0": {"file": 0, "offset": 0, "count": 2}}}]}]}}"#;
    vec![text.as_bytes().to_vec()]
}

/// Text of two Gaussians in time, with features and without rotation over time.
pub(super) fn spacetime() -> Vec<Vec<u8>> {
    let still =
        "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 trbf_center trbf_scale";
    let motion = (0..9).map(|k| format!("motion_{k}"));
    let of = |more: &[&str]| {
        let names =
            still.split(' ').map(str::to_owned).chain(motion.clone()).chain(more.iter().map(|name| (*name).to_owned()));
        let names: Vec<String> = names.collect();
        let header: String = names.iter().map(|name| format!("property float {name}\n")).collect();
        let row =
            |i: usize| names.iter().enumerate().map(|(k, _)| format!("0.{} ", (i + 3 * k) % 10)).collect::<String>();
        format!("ply\nformat ascii 1.0\nelement vertex 2\n{header}end_header\n{}\n{}\n", row(1), row(2)).into_bytes()
    };
    vec![of(&["omega_0", "omega_1", "omega_2", "omega_3"]), of(&["f_dc_3", "f_t_0"])]
}

pub(super) fn gltf() -> Vec<Vec<u8>> {
    let file = formats::gltf::write(&still(1)).bytes;
    // Below a node with translation, rotation and scale.
    let plain = formats::gltf::write(&still(0)).bytes;
    let length = plain[12..].first_chunk().map_or(0, |b| u32::from_le_bytes(*b)) as usize;
    let node = r#"{"mesh":0,"translation":[1,2,3],"rotation":[0,0.6,0,0.8],"scale":[2,2,2]}"#;
    let mut text = String::from_utf8_lossy(&plain[20..20 + length]).replacen(r#"{"mesh":0}"#, node, 1);
    text += &" ".repeat(text.len().next_multiple_of(4) - text.len());
    let size = |n: usize| (n as u32).to_le_bytes();
    let after = &plain[20 + length..];
    let moved = [
        b"glTF",
        &2_u32.to_le_bytes()[..],
        &size(20 + text.len() + after.len()),
        &size(text.len()),
        b"JSON",
        text.as_bytes(),
        after,
    ]
    .concat();
    vec![file, moved]
}

pub(super) fn sog() -> Vec<Vec<u8>> {
    [0, 1].map(|degree| formats::sog::write(&still(degree)).bytes).to_vec()
}

pub(super) fn spz() -> Vec<Vec<u8>> {
    let mut files: Vec<Vec<u8>> =
        (0..=3).map(|degree| formats::spz::write(&still(degree), formats::SpzVersion::V3).bytes).collect();
    // Versions 2 and 3, whose attributes follow the header in one gzip stream: here in stored blocks, so that mutations
    // can change them.
    for (version, bytes) in [(2_u32, 19), (3, 20)] {
        let attributes: Vec<u8> = (0..3 * bytes).map(|i| (i * 53 % 251) as u8).collect();
        let content =
            [&b"NGSP"[..], &version.to_le_bytes(), &3_u32.to_le_bytes(), &[0, 12, 0, 0], &attributes].concat();
        files.push(gzip_stored(&content));
    }
    files
}

/// A gzip file of one stored block.
fn gzip_stored(content: &[u8]) -> Vec<u8> {
    let len = content.len() as u16;
    let crc = content.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg()))
    });
    let head = [0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 255, 1];
    let sizes = [len.to_le_bytes(), (!len).to_le_bytes()].concat();
    [&head[..], &sizes, content, &(!crc).to_le_bytes(), &u32::from(len).to_le_bytes()].concat()
}

/// Libraries of no, one and three segments.
pub(super) fn library() -> Vec<Vec<u8>> {
    let of = |segments: u16| {
        let mut bytes = vec![0; 64 + 56 * usize::from(segments)];
        bytes[..6].copy_from_slice(b"\x7fELF\x02\x01");
        bytes[32..40].copy_from_slice(&64_u64.to_le_bytes());
        bytes[54..56].copy_from_slice(&56_u16.to_le_bytes());
        bytes[56..58].copy_from_slice(&segments.to_le_bytes());
        for (i, entry) in bytes[64..].chunks_exact_mut(56).enumerate() {
            entry[8..16].copy_from_slice(&(4096 * i as u64).to_le_bytes());
            entry[32..40].copy_from_slice(&5000_u64.to_le_bytes());
        }
        bytes
    };
    [0, 1, 3].map(of).to_vec()
}

pub(super) fn container() -> Vec<Vec<u8>> {
    let placement = Placement { source: [9, 16], model: [18, 32], offset: [0, 0], content: [18, 32] };
    let workers = Workers::new(Level::scalar(), 1).expect("a thread starts");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("seed.ssz");
    let mut writer = ContainerWriter::create(&path, 24.0).expect("writable");
    for (k, bytes) in interval().iter().enumerate() {
        let mut interval = from_safetensors(bytes, placement).expect("a seed");
        (interval.start, interval.end) = (k as f64, k as f64 + 1.0);
        writer.push_with(&interval, &[k as f64 + 0.1], &workers).expect("writable");
        (interval.start, interval.end) = (k as f64 + 1.0, k as f64 + 1.0);
        writer.push(&interval, &workers).expect("writable");
    }
    writer.finish().expect("writable").expect("intervals");
    vec![std::fs::read(&path).expect("just written")]
}

pub(super) fn http() -> Vec<Vec<u8>> {
    let heads = [
        "GET / HTTP/1.1\r\nHost: localhost:8707\r\nAccept: text/html\r\n\r\n",
        "HEAD /scene.json?from=12 HTTP/1.1\r\nHost: [::1]:80\r\nConnection: keep-alive\r\n\r\n",
        "GET /interval/3 HTTP/1.0\r\nhost: 192.168.1.7\r\n\r\n",
        "POST / HTTP/1.1\r\nHost: a.example\r\nContent-Length: 18446744073709551615\r\n\r\nbody",
    ];
    heads.map(|head| head.as_bytes().to_vec()).into()
}
