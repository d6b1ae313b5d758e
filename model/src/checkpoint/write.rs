//! Writing tensors.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use serde_json::{Map, Value, json};

use crate::ModelError;

/// Writes named f32 tensors as a safetensors file, in their order.
///
/// The file appears complete or not at all: it is written under a temporary name in the same folder and then renamed.
///
/// # Errors
/// When it cannot be written.
///
/// # Panics
/// When a shape does not have as many elements as its values.
pub fn write(path: impl AsRef<Path>, tensors: &[(String, Vec<usize>, &[f32])]) -> Result<(), ModelError> {
    let path = path.as_ref();
    let mut header = Map::new();
    let mut offset = 0;
    for (name, shape, values) in tensors {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "shape of {name}");
        let end = offset + 4 * values.len();
        header.insert(name.clone(), json!({ "dtype": "F32", "shape": shape, "data_offsets": [offset, end] }));
        offset = end;
    }
    let mut header = Value::Object(header).to_string();
    // The data starts at a multiple of 8 bytes.
    header.extend(std::iter::repeat_n(' ', header.len().next_multiple_of(8) - header.len()));

    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    let written = (|| -> io::Result<()> {
        let mut file = BufWriter::with_capacity(1 << 20, File::create(&part)?);
        file.write_all(&(header.len() as u64).to_le_bytes())?;
        file.write_all(header.as_bytes())?;
        for (_, _, values) in tensors {
            for chunk in values.chunks(1 << 16) {
                let bytes: Vec<u8> = chunk.iter().flat_map(|x| x.to_le_bytes()).collect();
                file.write_all(&bytes)?;
            }
        }
        file.into_inner().map_err(|e| e.into_error())?.sync_all()?;
        std::fs::rename(&part, path)
    })();
    written.map_err(|source| {
        // An incomplete file is removed; a missing one is not a second error.
        let _ = std::fs::remove_file(&part);
        ModelError::Write { file: path.display().to_string(), source }
    })
}
