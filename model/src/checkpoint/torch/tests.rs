use std::io::{Cursor, Write};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::super::Checkpoint;
use super::*;
use crate::ModelError;

/// A pickle under construction.
#[derive(Clone, Default)]
struct Writer(Vec<u8>);

impl Writer {
    fn op(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    fn text(self, text: &str) -> Self {
        self.op(b"X").op(&(text.len() as u32).to_le_bytes()).op(text.as_bytes())
    }

    fn global(self, module: &str, name: &str) -> Self {
        self.op(format!("c{module}\n{name}\n").as_bytes())
    }

    fn whole(self, value: i32) -> Self {
        self.op(b"J").op(&value.to_le_bytes())
    }

    fn wholes(self, values: &[i32]) -> Self {
        values.iter().fold(self.op(b"("), |writer, value| writer.whole(*value)).op(b"t")
    }

    /// A tensor of `class` in storage `key`.
    fn tensor(self, class: &str, key: &str, offset: i32, shape: &[i32], stride: &[i32]) -> Self {
        let storage =
            self.global("torch._utils", "_rebuild_tensor_v2").op(b"((").text("storage").global("torch", class);
        let storage = storage.text(key).text("cpu").whole(6).op(b"tQ");
        let tensor = storage.whole(offset).wholes(shape).wholes(stride).op(b"\x89");
        tensor.global("collections", "OrderedDict").op(b")RtR")
    }
}

/// The start of a dictionary of tensors, as modules have it.
fn dictionary() -> Writer {
    Writer::default().op(b"\x80\x02").global("collections", "OrderedDict").op(b")Rq\x00(")
}

/// The end of it, with the versions of modules as an attribute.
fn end(writer: Writer) -> Vec<u8> {
    writer.op(b"u}q\x05").text("_metadata").op(b"}sb.").0
}

fn archive(files: &[(&str, &[u8])], compression: CompressionMethod) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        writer.start_file(*name, SimpleFileOptions::default().compression_method(compression)).unwrap();
        writer.write_all(bytes).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// Six numbers in binary32, 0.5 to 5.5.
fn numbers() -> Vec<u8> {
    (0..6).flat_map(|i| (i as f32 + 0.5).to_le_bytes()).collect()
}

/// A file with this pickle and one storage, `0`.
fn file(pickle: &[u8]) -> Vec<u8> {
    archive(&[("x/data.pkl", pickle), ("x/byteorder", b"little"), ("x/data/0", &numbers())], CompressionMethod::Stored)
}

fn reason(bytes: Vec<u8>) -> String {
    match Checkpoint::from_storage(bytes, "it") {
        Err(ModelError::Format { reason, .. }) => reason,
        other => panic!("{other:?}"),
    }
}

fn whole() -> Vec<u8> {
    let writer = dictionary().text("a.weight").tensor("FloatStorage", "0", 0, &[2, 3], &[3, 1]);
    let writer = writer.text("a.bias").global("torch._utils", "_rebuild_parameter").op(b"(");
    let writer = writer
        .tensor("FloatStorage", "0", 4, &[1, 2], &[7, 1])
        .op(b"\x88")
        .global("collections", "OrderedDict")
        .op(b")RtR");
    end(writer.text("empty").tensor("HalfStorage", "0", 0, &[0, 3], &[3, 1]))
}

/// The archive with the records that torch.save writes before its end: the directory's size and offset in 64 bits, and
/// the offset of that record.
fn with_64_bits(mut bytes: Vec<u8>) -> Vec<u8> {
    let end = bytes.windows(4).rposition(|four| four == b"PK\x05\x06").expect("an end");
    let word = |at: usize, length: usize| {
        let mut word = [0; 8];
        word[..length].copy_from_slice(&bytes[at..at + length]);
        word
    };
    let (files, size, start) = (word(end + 10, 2), word(end + 12, 4), word(end + 16, 4));
    let mut records = b"PK\x06\x06".to_vec();
    records.extend(44_u64.to_le_bytes());
    records.extend([0x1e, 3, 45, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    [files, files, size, start].iter().for_each(|word| records.extend(word));
    records.extend(b"PK\x06\x07\0\0\0\0");
    records.extend((end as u64).to_le_bytes());
    records.extend(1_u32.to_le_bytes());
    bytes.splice(end..end, records);
    bytes
}

#[test]
fn a_folder_of_any_name_is_read() {
    let numbers = numbers();
    let pickle = end(dictionary().text("a").tensor("FloatStorage", "0", 0, &[2, 3], &[3, 1]));
    for length in 1..64 {
        let name = |file: &str| format!("{}/{file}", "x".repeat(length));
        let names = ["data.pkl", "byteorder", "data/0"].map(name);
        let files = [(&*names[0], &*pickle), (&*names[1], b"little"), (&*names[2], &*numbers)];
        let bytes = with_64_bits(archive(&files, CompressionMethod::Stored));
        let checkpoint = Checkpoint::from_storage(bytes, "it").unwrap_or_else(|e| panic!("{length}: {e}"));
        assert_eq!(checkpoint.shape("a"), Some(&[2, 3][..]), "{length}");
    }
}

#[test]
fn tensors_are_views_of_storages() {
    let checkpoint = Checkpoint::from_storage(file(&whole()), "it").unwrap();
    assert!(is_archive(&file(&whole())[..64]) && !is_archive(b"PK\x03\x04"));
    assert_eq!(checkpoint.tensors().keys().collect::<Vec<_>>(), ["a.bias", "a.weight", "empty"]);
    assert_eq!(*checkpoint.read("a.weight").unwrap(), [0.5, 1.5, 2.5, 3.5, 4.5, 5.5]);
    assert_eq!((checkpoint.shape("a.weight"), checkpoint.shape("a.bias")), (Some(&[2, 3][..]), Some(&[1, 2][..])));
    assert_eq!(*checkpoint.read("a.bias").unwrap(), [4.5, 5.5]);
    assert!(checkpoint.read("empty").unwrap().is_empty());
}

#[test]
fn what_torch_saved_is_read_in_place() {
    let bytes = std::fs::read(streamsplat_fixtures::path("torch/tensors.pth")).unwrap();
    assert!(is_archive(&bytes[..64]));
    let checkpoint = Checkpoint::from_storage(bytes, "it").unwrap();
    assert_eq!(*checkpoint.read("a").unwrap(), [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]);
    assert_eq!(*checkpoint.read("a.second_row").unwrap(), [1.5, 2.0, 2.5]);
    assert_eq!(*checkpoint.read("b").unwrap(), [0.0, 1.0, 2.0, 3.0, 4.0]);
    assert_eq!((&*checkpoint.read("c").unwrap(), checkpoint.shape("c")), (&[-3.0][..], Some(&[][..])));
    assert_eq!(
        (&*checkpoint.read("parameter").unwrap(), checkpoint.shape("parameter")),
        (&[1.0, 1.0][..], Some(&[1, 2][..]))
    );
    assert!(matches!(checkpoint.read("count"), Err(ModelError::Dtype { .. })));
}

#[test]
fn a_pickle_that_would_run_code_is_refused_by_what_it_calls() {
    // The function is named but never looked up: no code here could call it.
    let call =
        |module: &str, name: &str| Writer::default().op(b"\x80\x02").global(module, name).text("x").op(b"\x85R.").0;
    assert_eq!(
        reason(file(&call("some.module", "run"))),
        "data.pkl: it would call some.module.run, which is not done: expected tensors alone"
    );
    let build = Writer::default().op(b"\x80\x02").global("a", "Model").op(b")\x81.").0;
    let expected = "data.pkl: it would build an object of the class or function a.Model, which is not done: expected tensors alone (a state_dict)";
    assert_eq!(reason(file(&build)), expected);
    let hidden = end(dictionary().text("w").global("a", "f").op(b")R"));
    assert!(reason(file(&hidden)).contains("it would call a.f"), "inside a dictionary");
    let drawn = Writer::default().op(b"\x80\x04\x8c\x01a\x8c\x01f\x93)R.").0;
    assert!(reason(file(&drawn)).contains("it would call a.f"), "by the newer instruction");
}

#[test]
fn what_is_no_dictionary_of_tensors_is_named() {
    let number = end(dictionary().text("epoch").whole(3));
    assert_eq!(
        reason(file(&number)),
        r#"data.pkl: expected a tensor under every name, found a whole number (3) under "epoch""#
    );
    let nested = end(dictionary().text("model").op(b"}"));
    assert!(reason(file(&nested)).ends_with(r#"found a dictionary under "model"; save that part alone"#));
    let list = Writer::default().op(b"\x80\x02].").0;
    assert_eq!(reason(file(&list)), "data.pkl: expected a dictionary of tensors by name, found a list");
}

#[test]
fn places_outside_the_file_are_refused() {
    let one = |class, key, offset, shape: &[i32], stride: &[i32]| {
        file(&end(dictionary().text("w").tensor(class, key, offset, shape, stride)))
    };
    for (bytes, expected) in [
        (
            one("FloatStorage", "0", 1, &[2, 3], &[3, 1]),
            "tensor w: shape [2, 3] of F32 takes 24 bytes from 4 on, x/data/0 holds 24",
        ),
        (
            one("FloatStorage", "1", 0, &[2], &[1]),
            "tensor w: expected its elements in x/data/1, which the archive does not hold (uncompressed)",
        ),
        (
            one("FloatStorage", "0", 0, &[3, 2], &[1, 3]),
            "tensor w: expected dense rows, found a step of 3 in place of 1 along axis 1 (a transposed view?)",
        ),
        (one("FloatStorage", "0", 0, &[i32::MAX, i32::MAX, i32::MAX], &[1, 1, 1]), "tensor w: "),
        (
            one("FloatStorage", "0", -1, &[1], &[1]),
            "data.pkl: torch._utils._rebuild_tensor_v2: expected a tensor's parts, found others",
        ),
        (
            one("FloatStorage", "../0", 0, &[1], &[1]),
            "data.pkl: a reference that is no storage: expected tensors alone",
        ),
        (one("OddStorage", "0", 0, &[1], &[1]), "data.pkl: number format OddStorage is not read"),
    ] {
        let found = reason(bytes);
        assert!(found.starts_with(expected), "expected {expected}, found {found}");
    }
}

#[test]
fn archives_of_another_kind_are_named() {
    let compressed = archive(&[("x/data.pkl", &whole()), ("x/data/0", &numbers())], CompressionMethod::Stored);
    assert!(Checkpoint::from_storage(compressed, "it").is_ok(), "without a byte order");
    for (files, expected) in [
        (&[("a.txt", &b"a"[..])][..], "a zip archive without data.pkl: expected one that torch.save wrote"),
        (
            &[("x/data.pkl", b"."), ("x/constants.pkl", b"")],
            "a TorchScript archive: expected the weights alone, as torch.save writes them",
        ),
        (&[("x/data.pkl", b"."), ("x/byteorder", b"big")], "byteorder: expected little, found big"),
        (&[("x/data.pkl", b"."), ("y/data.pkl", b".")], "expected one data.pkl in the archive, found several"),
    ] {
        assert_eq!(reason(archive(files, CompressionMethod::Stored)), expected);
    }
    let mut old = LEGACY.to_vec();
    old.extend([0; 40]);
    assert!(reason(old).contains("PyTorch before 1.6"));
    assert!(reason(b"\x80\x02}.".to_vec()).starts_with("a plain pickle"));
}

#[test]
fn no_cut_and_no_changed_byte_panics() {
    let bytes = file(&whole());
    for end in 0..bytes.len() {
        assert!(Checkpoint::from_storage(bytes[..end].to_vec(), "it").is_err(), "{end} bytes");
    }
    for at in 0..bytes.len() {
        for change in [1, 0x80, 0xff] {
            let mut changed = bytes.clone();
            changed[at] ^= change;
            if let Ok(checkpoint) = Checkpoint::from_storage(changed, "it") {
                for name in checkpoint.tensors().keys() {
                    let _ = checkpoint.read(name);
                }
            }
        }
    }
}

#[test]
fn values_that_are_used_often_take_no_memory_of_their_own() {
    // A tuple of two, then tuples of two of the last one: 2⁴⁰ numbers if copied.
    let mut writer = Writer::default().op(b"\x80\x02K\x01K\x01\x86q\x00");
    for _ in 0..40 {
        writer = writer.op(b"h\x00h\x00\x86q\x00");
    }
    assert_eq!(reason(file(&writer.op(b".").0)), "data.pkl: expected a dictionary of tensors by name, found a tuple");
}
