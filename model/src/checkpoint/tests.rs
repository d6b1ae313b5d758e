use super::*;

/// A file with this header and `data` zero bytes.
fn file(header: &str, data: usize) -> Vec<u8> {
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend_from_slice(header.as_bytes());
    bytes.extend(std::iter::repeat_n(0, data));
    bytes
}

fn reason(bytes: Vec<u8>) -> String {
    match Checkpoint::from_storage(bytes, "it") {
        Err(ModelError::Format { reason, .. }) => reason,
        other => panic!("{other:?}"),
    }
}

#[test]
fn tensors_are_read_in_all_three_formats() {
    let header = r#"{"__metadata__":{"a":"b"},"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]},
        "b":{"dtype":"F16","shape":[1,2],"data_offsets":[8,12]},"c":{"dtype":"BF16","shape":[],"data_offsets":[12,14]}}"#;
    let mut bytes = file(header, 0);
    for x in [1.5f32, -2.0] {
        bytes.extend(x.to_le_bytes());
    }
    for x in [0.25f32, 65504.0] {
        bytes.extend(half::f16::from_f32(x).to_le_bytes());
    }
    bytes.extend(half::bf16::from_f32(-3.0).to_le_bytes());
    let checkpoint = Checkpoint::from_storage(bytes, "it").unwrap();
    assert_eq!(*checkpoint.read("a").unwrap(), [1.5, -2.0]);
    assert_eq!(*checkpoint.read("b").unwrap(), [0.25, 65504.0]);
    assert_eq!(*checkpoint.read("c").unwrap(), [-3.0]);
    assert_eq!(checkpoint.shape("c"), Some(&[][..]));
    assert!(matches!(checkpoint.read("d"), Err(ModelError::Missing { .. })));
}

#[test]
fn every_truncation_is_an_error() {
    let header = r#"{"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}}"#;
    let whole = file(header, 8);
    assert!(Checkpoint::from_storage(whole.clone(), "it").is_ok());
    for length in 0..whole.len() {
        reason(whole[..length].to_vec());
    }
}

#[test]
fn lying_headers_are_errors() {
    let cases = [
        (r#"{"a":{"dtype":"F32","shape":[2],"data_offsets":[0,4]}}"#, 4, "takes 8 bytes"),
        (r#"{"a":{"dtype":"F32","shape":[2],"data_offsets":[8,0]}}"#, 8, "takes 8 bytes"),
        (r#"{"a":{"dtype":"F32","shape":[18446744073709551615,2],"data_offsets":[0,8]}}"#, 8, "too large"),
        (r#"{"a":{"dtype":"F32","shape":[4611686018427387904],"data_offsets":[0,0]}}"#, 0, "too large"),
        (r#"{"a":{"dtype":"F32","shape":[-1],"data_offsets":[0,8]}}"#, 8, "header"),
        (r#"{"a":{"dtype":"F33","shape":[2],"data_offsets":[0,8]}}"#, 8, "number format"),
        (
            r#"{"a":{"dtype":"F32","shape":[1],"data_offsets":[0,4]},"a":{"dtype":"F32","shape":[1],"data_offsets":[4,8]}}"#,
            8,
            "twice",
        ),
        (
            r#"{"a":{"dtype":"F32","shape":[1],"data_offsets":[0,4]},"b":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}"#,
            4,
            "overlaps",
        ),
        (r#"{"a":{"dtype":"F32","shape":[1],"data_offsets":[4,8]}}"#, 8, "unused"),
        (r#"{"a":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}"#, 8, "holds 8"),
        (r#"[1, 2]"#, 0, "object of tensors"),
        ("", 0, "header"),
    ];
    for (header, data, expected) in cases {
        let reason = reason(file(header, data));
        assert!(reason.contains(expected), "{header}: {reason}");
    }
    let mut long = u64::MAX.to_le_bytes().to_vec();
    long.extend([0; 64]);
    assert!(reason(long).contains("at most"));
}

#[test]
fn values_that_are_not_finite_are_named() {
    let header = r#"{"a":{"dtype":"F32","shape":[3],"data_offsets":[0,12]}}"#;
    let mut bytes = file(header, 0);
    for x in [1.0f32, f32::NAN, f32::INFINITY] {
        bytes.extend(x.to_le_bytes());
    }
    let checkpoint = Checkpoint::from_storage(bytes, "it").unwrap();
    assert!(matches!(checkpoint.read("a"), Err(ModelError::NonFinite { index: 1, .. })));
}
