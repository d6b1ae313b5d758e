//! Errors of model files and of a model's inputs.

use std::io;

use rayon::prelude::*;

/// An error that names the file, tensor or option, and expected and found values.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// A file could not be read.
    #[error("{file}: {source}")]
    Io {
        /// The file.
        file: String,
        /// Cause.
        source: io::Error,
    },
    /// The bytes do not have the expected format.
    #[error("{file}: {reason}")]
    Format {
        /// The file.
        file: String,
        /// The cause: expected and found.
        reason: String,
    },
    /// A tensor the model needs is not in the file.
    #[error("{file}: tensor {tensor} is missing (expected shape {expected})")]
    Missing {
        /// The file.
        file: String,
        /// The tensor's full key.
        tensor: String,
        /// The shape it should have.
        expected: String,
    },
    /// A tensor has another shape than the rest of the model needs.
    #[error("{file}: tensor {tensor}: expected shape {expected}, found {found:?}")]
    Shape {
        /// The file.
        file: String,
        /// The tensor's full key.
        tensor: String,
        /// The shape it should have.
        expected: String,
        /// The shape it has.
        found: Vec<usize>,
    },
    /// A tensor has a number format that is not read.
    #[error("{file}: tensor {tensor}: expected F32, F16 or BF16, found {found}")]
    Dtype {
        /// The file.
        file: String,
        /// The tensor's full key.
        tensor: String,
        /// Its number format.
        found: String,
    },
    /// A tensor of the file holds NaN or an infinity.
    #[error("{file}: tensor {tensor}: expected finite values, found {value} at flat index {index}")]
    NonFinite {
        /// The file.
        file: String,
        /// The tensor's full key.
        tensor: String,
        /// The first bad element.
        index: usize,
        /// Its value.
        value: f32,
    },
    /// The configuration contradicts itself or the tensors.
    #[error("{file}: {key}: expected {expected}, found {found}")]
    Config {
        /// The configuration file, or the checkpoint where the value comes from its shapes or from a default.
        file: String,
        /// The key.
        key: String,
        /// Values it can have.
        expected: String,
        /// The value found.
        found: String,
    },
    /// An input has the wrong size, or is missing.
    #[error("{input}: expected {expected}, found {found}")]
    Input {
        /// The input's name.
        input: String,
        /// The size or kind it should have.
        expected: String,
        /// The size or kind found.
        found: String,
    },
    /// An input holds NaN or an infinity.
    #[error("{input}: expected finite values, found {value} at flat index {index}")]
    InputNonFinite {
        /// The input's name.
        input: String,
        /// The first bad element.
        index: usize,
        /// Its value.
        value: f32,
    },
}

/// An error unless `values` has `expected` elements, all finite.
pub(crate) fn check_input(name: &str, values: &[f32], expected: usize, shape: &str) -> Result<(), ModelError> {
    if values.len() != expected {
        return Err(ModelError::Input {
            input: name.to_owned(),
            expected: format!("{expected} values ({shape})"),
            found: format!("{}", values.len()),
        });
    }
    match first_non_finite(values) {
        None => Ok(()),
        Some(index) => Err(ModelError::InputNonFinite { input: name.to_owned(), index, value: values[index] }),
    }
}

/// The first element that is NaN or infinite.
pub(crate) fn first_non_finite(values: &[f32]) -> Option<usize> {
    // Whole parts first, without a branch inside: these alone have all bits of the exponent.
    const EXPONENT: u32 = 0x7f80_0000;
    const PART: usize = 1 << 14;
    let holds_one = |part: &[f32]| part.iter().fold(false, |found, x| found | (x.to_bits() & EXPONENT == EXPONENT));
    let part = values.par_chunks(PART).position_first(holds_one)?;
    values.iter().skip(part * PART).position(|x| !x.is_finite()).map(|i| part * PART + i)
}

#[cfg(test)]
mod tests {
    use super::first_non_finite;

    #[test]
    fn the_first_value_that_is_not_finite_is_found_wherever_it_lies() {
        for len in [0, 1, 5, (1 << 14) - 1, 1 << 14, 100_000] {
            let mut values = vec![f32::MAX; len];
            assert_eq!(first_non_finite(&values), None);
            for (i, bad) in [(len.saturating_sub(1), f32::NAN), (len / 2, f32::NEG_INFINITY), (len / 3, f32::INFINITY)]
            {
                if let Some(value) = values.get_mut(i) {
                    *value = bad;
                    assert_eq!(first_non_finite(&values), Some(i), "{len} values");
                }
            }
        }
    }
}
