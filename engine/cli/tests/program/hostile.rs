//! Small files that declare much content: the error is one line with the reason, in little memory.

use std::ffi::OsStr;
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use crate::support::{Scratch, command, fails, model, run_ok};

/// Address space of the program, in KiB: enough to start, and far less than the files declare.
const ADDRESS_SPACE: u32 = 768 << 10;

/// Runs the program with a limit on its address space: memory beyond it ends the process.
fn confined<I: AsRef<OsStr>>(arguments: impl IntoIterator<Item = I>) -> Output {
    Command::new("sh")
        .arg("-c")
        .arg(format!("ulimit -v {ADDRESS_SPACE}; exec \"$0\" \"$@\""))
        .arg(command().get_program())
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .expect("a shell starts")
}

pub(crate) fn write(path: PathBuf, bytes: &[u8]) -> PathBuf {
    std::fs::write(&path, bytes).expect("writable");
    path
}

/// Creates a sparse file of this length.
fn sparse(path: PathBuf, length: u64) -> PathBuf {
    std::fs::File::create(&path).and_then(|file| file.set_len(length)).expect("writable");
    path
}

fn safetensors(header: &str, claimed: Option<u64>, data: usize) -> Vec<u8> {
    let mut bytes = claimed.unwrap_or(header.len() as u64).to_le_bytes().to_vec();
    bytes.extend_from_slice(header.as_bytes());
    bytes.resize(bytes.len() + data, 0);
    bytes
}

#[test]
fn safetensors_headers_that_lie_about_their_length_or_shapes_are_refused() {
    let scratch = Scratch::new();
    let entry =
        |shape: &str, end: u64| format!(r#"{{"a":{{"dtype":"F32","shape":{shape},"data_offsets":[0,{end}]}}}}"#);
    for (name, bytes) in [
        ("all", safetensors("{}", Some(u64::MAX), 0)),
        ("most", safetensors("{}", Some(99_999_999), 0)),
        ("sign", safetensors("{}", Some(1 << 63), 16)),
        ("overflow", safetensors(&entry("[4294967296,4294967296,4]", 0), None, 0)),
        ("large", safetensors(&entry("[1099511627776]", 4_398_046_511_104), None, 8)),
        ("many", safetensors(&entry(&format!("[{}1]", "1,".repeat(100_000)), 4), None, 4)),
        ("deep", safetensors(&"[".repeat(200_000), None, 0)),
    ] {
        let file = write(scratch.path(&format!("{name}.safetensors")), &bytes);
        let text = fails(&confined([OsStr::new("inspect"), file.as_os_str()]), 1);
        assert!(text.contains(name), "{text}");
    }
}

/// Builds the start of a PNG that declares `side` × `side` pixels of 16-bit colour and alpha, with a valid checksum.
fn png(side: u32) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    image::DynamicImage::ImageRgba16(image::ImageBuffer::new(3, 3))
        .write_to(&mut file, image::ImageFormat::Png)
        .expect("memory");
    let mut bytes = file.into_inner();
    bytes[16..20].copy_from_slice(&side.to_be_bytes());
    bytes[20..24].copy_from_slice(&side.to_be_bytes());
    let crc = bytes[12..29].iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
    });
    bytes[29..33].copy_from_slice(&(!crc).to_be_bytes());
    bytes
}

/// Builds an EXR of one pixel that declares a larger data window.
fn exr(channels: usize, side: i32) -> Vec<u8> {
    let names = (0..channels).map(|i| (format!("c{i:05}"), vec![0.5])).collect();
    let planes = streamsplat::openexr::Planes { width: 1, height: 1, channels: names };
    let mut bytes = Vec::new();
    streamsplat::openexr::write(&planes, "", &mut bytes).expect("memory");
    for window in [&b"dataWindow\0box2i\0"[..], b"displayWindow\0box2i\0"] {
        let at = bytes.windows(window.len()).position(|w| w == window).expect("a window") + window.len() + 4 + 8;
        bytes[at..at + 4].copy_from_slice(&(side - 1).to_le_bytes());
        bytes[at + 4..at + 8].copy_from_slice(&(side - 1).to_le_bytes());
    }
    bytes
}

#[test]
fn images_that_promise_more_than_they_hold_are_refused() {
    let scratch = Scratch::new();
    let tga = |side: u16| {
        let mut bytes = vec![0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        bytes.extend([side.to_le_bytes(), side.to_le_bytes()].concat());
        bytes.extend([32, 8]);
        bytes
    };
    let bmp = |side: i32| {
        let mut file = Cursor::new(Vec::new());
        image::DynamicImage::new_rgb8(2, 2).write_to(&mut file, image::ImageFormat::Bmp).expect("memory");
        let mut bytes = file.into_inner();
        bytes[18..22].copy_from_slice(&side.to_le_bytes());
        bytes[22..26].copy_from_slice(&side.to_le_bytes());
        bytes
    };
    let qoi = |side: u32| [&b"qoif"[..], &side.to_be_bytes(), &side.to_be_bytes(), &[4, 0], &[0xff; 16]].concat();
    for (name, bytes) in [
        ("side.png", png(32_768)),
        ("whole.png", png(8192)),
        ("many.exr", exr(1000, 8192)),
        ("side.exr", exr(1, 100_000)),
        ("plain.ppm", b"P6 32000 32000 65535\n\0\0".to_vec()),
        ("whole.ppm", b"P6 8192 8192 255\n\0\0".to_vec()),
        ("side.tga", tga(65535)),
        ("side.bmp", bmp(30_000)),
        ("side.qoi", qoi(1 << 20)),
    ] {
        let clip = scratch.path("clip");
        let _ = std::fs::remove_dir_all(&clip);
        std::fs::create_dir(&clip).expect("writable");
        write(clip.join(name), &bytes);
        let (out, model) = (scratch.path("out"), model());
        let arguments = [
            OsStr::new("run"),
            clip.as_os_str(),
            OsStr::new("--out"),
            out.as_os_str(),
            OsStr::new("--model"),
            model.as_os_str(),
            OsStr::new("--threads"),
            OsStr::new("1"),
        ];
        let text = fails(&confined(arguments), 1);
        assert!(text.contains(name), "{text}");
    }
}

#[test]
fn text_files_longer_than_any_of_their_kind_are_refused() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 40, 24);
    let out = scratch.path("out");
    run_ok(&clip, &out, &["--quiet"]);
    let length = 4 << 30;
    let camera = sparse(scratch.path("camera.json"), length);
    let again = scratch.path("again");
    let render = |camera: &Path| {
        let words = ["render", "--out", again.to_str().expect("UTF-8"), "--camera", camera.to_str().expect("UTF-8")];
        confined(words.map(OsStr::new).into_iter().chain([out.as_os_str()]))
    };
    assert!(fails(&render(&camera), 1).contains("camera.json: expected"));
    let model = scratch.path("m.safetensors");
    std::fs::copy(self::model(), &model).expect("writable");
    sparse(scratch.path("m.json"), length);
    assert!(fails(&confined([OsStr::new("inspect"), model.as_os_str()]), 1).contains("m.json: expected"));
    sparse(out.join("run.json"), length);
    assert!(fails(&confined([OsStr::new("verify"), out.as_os_str()]), 1).contains("run.json"));
    sparse(out.join("scene").join("scene.json"), length);
    write(scratch.path("small.json"), br#"{"type": "canonical"}"#);
    assert!(fails(&render(&scratch.path("small.json")), 1).contains("scene.json: expected at most"));
}

#[test]
fn a_spoilt_record_of_a_run_is_an_error_in_one_line() {
    let scratch = Scratch::new();
    let clip = scratch.clip("clip", 2, 40, 24);
    let out = scratch.path("out");
    run_ok(&clip, &out, &["--quiet"]);
    let good = std::fs::read(out.join("run.json")).expect("readable");
    let verify = |bytes: &[u8]| {
        let mut file = std::fs::File::create(out.join("run.json")).expect("writable");
        file.write_all(bytes).expect("writable");
        drop(file);
        confined([OsStr::new("verify"), out.as_os_str()])
    };
    let at = |what: &str| good.windows(what.len()).position(|w| w == what.as_bytes()).expect("there");
    // Truncated, or with an invalid byte in a critical position.
    for end in [0, 1, at("\"input\""), good.len() / 2, good.len() - 3] {
        fails(&verify(&good[..end]), 1);
    }
    for what in ["\"outputs\"", "\"options\"", "\"blake3\"", "\"seed\"", "\"size\""] {
        let mut bytes = good.clone();
        bytes[at(what)] = 0xff;
        fails(&verify(&bytes), 1);
        bytes[at(what)] = b'[';
        fails(&verify(&bytes), 1);
    }
    fails(&verify("{\"a\":".repeat(100_000).as_bytes()), 1);
}

/// Runs the program as [`confined`] does, and returns the maximum resident memory in KiB, too.
#[cfg(target_os = "linux")]
pub(crate) fn measured<I: AsRef<OsStr>>(arguments: impl IntoIterator<Item = I>) -> (Output, u64) {
    let mut child = Command::new("sh");
    child.arg("-c").arg(format!("ulimit -v {ADDRESS_SPACE}; exec \"$0\" \"$@\""));
    child
        .arg(command().get_program())
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    let mut child = child.spawn().expect("a shell starts");
    let (status, mut most) = (format!("/proc/{}/status", child.id()), 0);
    while child.try_wait().expect("a child").is_none() {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or("0");
        most = most.max(line.trim().trim_end_matches(" kB").parse().unwrap_or(0));
    }
    (child.wait_with_output().expect("a child"), most)
}

#[cfg(target_os = "linux")]
#[test]
fn what_would_fill_the_memory_is_refused_in_little_memory() {
    let scratch = Scratch::new();
    let out = scratch.path("out");
    run_ok(&scratch.clip("clip", 2, 40, 24), &out, &["--quiet"]);
    let rendered = scratch.path("rendered");
    let refused = |words: &[&OsStr], code: i32, expected: &str| {
        let (output, most) = measured(words);
        let text = fails(&output, code);
        assert!(text.contains(expected), "{text}");
        assert!(most < 100_000, "{most} KiB for {words:?}");
    };
    let words = |scene: &Path, more: &[&str]| -> Vec<std::ffi::OsString> {
        let mut words = vec!["render".into(), scene.into(), "--out".into(), rendered.clone().into()];
        words.extend(more.iter().map(Into::into));
        words
    };
    let check = |scene: &Path, more: &[&str], expected: &str| {
        let words = words(scene, more);
        refused(&words.iter().map(AsRef::as_ref).collect::<Vec<_>>(), 1, expected);
    };
    // 30 kB that unpack to 1.5 million Gaussians.
    let mut spz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    let count = 1_500_000_u32;
    let head =
        [b"NGSP".to_vec(), 3_u32.to_le_bytes().to_vec(), count.to_le_bytes().to_vec(), vec![0, 12, 0, 0]].concat();
    spz.write_all(&head).and_then(|()| spz.write_all(&vec![0; 20 * count as usize])).expect("memory");
    let bytes = spz.finish().expect("memory");
    assert!(bytes.len() < 32_000, "{}", bytes.len());
    let file = write(scratch.path("bomb.spz"), &bytes);
    check(&file, &[], "points: expected at most");
    // More than is read by default, and the option that raises the limit.
    let ply = |count: u64| {
        let names = [
            "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1",
            "rot_2", "rot_3",
        ];
        let properties: String = names.iter().map(|name| format!("property float {name}\n")).collect();
        let head = format!("ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{properties}end_header\n");
        let file = write(scratch.path("bomb.ply"), head.as_bytes());
        let length = head.len() as u64 + 56 * count;
        std::fs::File::options().write(true).open(&file).and_then(|f| f.set_len(length)).expect("writable");
        file
    };
    check(&ply(1000), &["--limit-gaussians", "999"], "expected at most 999 Gaussians");
    // An interval that is a hole of a tebibyte.
    let scene = out.join("scene");
    let name = "interval-000001.safetensors";
    let length = 1_u64 << 40;
    sparse(scene.join(name), length);
    let index = std::fs::read_to_string(scene.join("scene.json")).expect("readable");
    let mut index: serde_json::Value = serde_json::from_str(&index).expect("JSON");
    index["intervals"][1]["bytes"] = length.into();
    std::fs::write(scene.join("scene.json"), index.to_string()).expect("writable");
    check(&out, &[], name);
    index["intervals"][1]["gaussians"] = (1_u64 << 25).into();
    std::fs::write(scene.join("scene.json"), index.to_string()).expect("writable");
    check(&out, &[], "expected at most 16777216 Gaussians");
}

#[cfg(target_os = "linux")]
#[test]
fn images_for_which_there_is_no_memory_are_refused() {
    let scratch = Scratch::new();
    let (out, rendered) = (scratch.path("out"), scratch.path("rendered"));
    run_ok(&scratch.clip("clip", 2, 40, 24), &out, &["--quiet"]);
    for size in ["40000x40000", "60000x60000"] {
        let words = [
            "render".as_ref(),
            out.as_os_str(),
            "--size".as_ref(),
            size.as_ref(),
            "--out".as_ref(),
            rendered.as_os_str(),
        ];
        let (output, most) = measured(words);
        assert!(fails(&output, 1).contains("no memory for"), "{size}");
        assert!(most < 100_000, "{most} KiB");
    }
}
