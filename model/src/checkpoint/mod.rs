//! Files of tensors, from safetensors or `torch.save`: mapped, checked, read tensor by tensor.
//!
//! Everything is checked before use: the header's length against the file's, every tensor's range against its shape and
//! its neighbours, every shape against the model. No memory is allocated by a size that only a header claims.

mod header;
mod storage;
mod torch;
mod weights;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

pub use header::{Dtype, TensorInfo};
pub use storage::Storage;
pub use torch::is_archive as is_torch_archive;
pub(crate) use weights::Weights;

use crate::ModelError;
use crate::error::first_non_finite;

/// A file of tensors whose header has been checked.
#[derive(Debug)]
pub struct Checkpoint {
    file: String,
    storage: Storage,
    data: usize,
    tensors: BTreeMap<String, TensorInfo>,
}

impl Checkpoint {
    /// Maps the file at `path` and checks its header.
    ///
    /// # Errors
    /// When the file cannot be read or is neither a well-formed safetensors file nor tensors by name as `torch.save`
    /// writes them.
    pub fn open(path: impl AsRef<Path>) -> Result<Checkpoint, ModelError> {
        let file = path.as_ref().display().to_string();
        let storage = Storage::map(path.as_ref()).map_err(|source| ModelError::Io { file: file.clone(), source })?;
        Self::from_storage(storage, file)
    }

    /// Checks the header of bytes in memory; `name` is used as the file's name in errors.
    ///
    /// # Errors
    /// When the bytes are neither a well-formed safetensors file nor tensors by name as `torch.save` writes them.
    pub fn from_storage(storage: impl Into<Storage>, name: impl Into<String>) -> Result<Checkpoint, ModelError> {
        let (file, storage) = (name.into(), storage.into());
        let bytes = storage.bytes();
        let parsed =
            if torch::is_torch(bytes) { torch::parse(bytes).map(|tensors| (0, tensors)) } else { header::parse(bytes) };
        match parsed {
            Ok((data, tensors)) => Ok(Checkpoint { file, storage, data, tensors }),
            Err(reason) => Err(ModelError::Format { file, reason }),
        }
    }

    /// The file's name, or that of bytes in memory.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// Size of the file in bytes.
    pub fn size(&self) -> usize {
        self.storage.bytes().len()
    }

    /// All tensors, by name.
    pub fn tensors(&self) -> &BTreeMap<String, TensorInfo> {
        &self.tensors
    }

    /// The shape of a tensor, if the file has it.
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        self.tensors.get(name).map(|t| t.shape.as_slice())
    }

    /// The values of a tensor as f32: borrowed where the file holds aligned F32, widened otherwise.
    ///
    /// # Errors
    /// When the tensor is missing, is not F32, F16 or BF16, or holds a value that is not finite.
    pub fn read(&self, name: &str) -> Result<Cow<'_, [f32]>, ModelError> {
        let info = self.tensors.get(name).ok_or_else(|| ModelError::Missing {
            file: self.file.clone(),
            tensor: name.to_owned(),
            expected: "any".to_owned(),
        })?;
        let bytes = &self.storage.bytes()[self.data..][info.range.clone()];
        let values = info.dtype.to_f32(bytes).ok_or_else(|| ModelError::Dtype {
            file: self.file.clone(),
            tensor: name.to_owned(),
            found: info.dtype.name().to_owned(),
        })?;
        match first_non_finite(&values) {
            None => Ok(values),
            Some(index) => Err(ModelError::NonFinite {
                file: self.file.clone(),
                tensor: name.to_owned(),
                index,
                value: values[index],
            }),
        }
    }

    /// Returns true if the file has the tensor and all its values are zero, of either sign.
    pub(crate) fn is_zero(&self, name: &str) -> bool {
        let Some(TensorInfo { dtype, range, .. }) = self.tensors.get(name) else { return false };
        let bytes = &self.storage.bytes()[self.data..][range.clone()];
        // Little-endian: the sign is the last byte's first bit.
        let zero = |value: &[u8]| match value {
            [low @ .., high] => high & 0x7f == 0 && low.iter().all(|byte| *byte == 0),
            [] => true,
        };
        match dtype {
            Dtype::F32 => bytes.chunks(4).all(zero),
            Dtype::F16 | Dtype::Bf16 => bytes.chunks(2).all(zero),
            Dtype::Other(_) => false,
        }
    }

    /// The bytes of a tensor of any format, if the file has it.
    pub fn bytes(&self, name: &str) -> Option<&[u8]> {
        self.tensors.get(name).map(|info| &self.storage.bytes()[self.data..][info.range.clone()])
    }

    /// Advises the system that a tensor's pages of a mapped file are not needed for now. It reads them again on access.
    pub(crate) fn release(&self, name: &str) {
        if let Some(info) = self.tensors.get(name) {
            self.storage.release(self.data + info.range.start..self.data + info.range.end);
        }
    }
}

#[cfg(test)]
mod tests;
