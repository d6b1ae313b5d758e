//! Tensors of one model inside a checkpoint: keys with a prefix, shapes checked.

use std::borrow::Cow;

use streamsplat_kernels::Level;
use streamsplat_kernels::gemm::Precision;

use super::Checkpoint;
use crate::{DinoLayout, ModelError};

/// A view of a checkpoint's keys that start with a prefix.
#[derive(Clone, Debug)]
pub(crate) struct Weights<'a> {
    checkpoint: &'a Checkpoint,
    prefix: String,
    layout: DinoLayout,
    level: Level,
    precision: Precision,
    compute_zero_output: bool,
}

impl<'a> Weights<'a> {
    pub(crate) fn new(checkpoint: &'a Checkpoint, prefix: impl Into<String>) -> Self {
        let (level, precision) = (Level::scalar(), Precision::F32);
        Self {
            checkpoint,
            prefix: prefix.into(),
            layout: DinoLayout::Official,
            level,
            precision,
            compute_zero_output: false,
        }
    }

    /// The same keys, for layers that are packed on `level`.
    pub(crate) fn on(self, level: Level) -> Weights<'a> {
        Weights { level, ..self }
    }

    /// The same keys in a file of DINOv2 of this layout.
    pub(crate) fn laid_out(self, layout: DinoLayout) -> Weights<'a> {
        Weights { layout, ..self }
    }

    /// The names of the file.
    pub(crate) fn layout(&self) -> DinoLayout {
        self.layout
    }

    /// The same keys, for layers that are built even where they add nothing.
    pub(crate) fn with_zero_output(self) -> Weights<'a> {
        Weights { compute_zero_output: true, ..self }
    }

    /// Returns true if the residual branch whose last layer is `name`, with or without a bias, is left out because it
    /// adds zeros.
    pub(crate) fn leaves_out(&self, name: &str) -> bool {
        !self.compute_zero_output && self.is_zero_output(name)
    }

    /// Returns true if the layer `name` returns zeros for any input.
    pub(crate) fn is_zero_output(&self, name: &str) -> bool {
        let zero = |tensor: &str| self.checkpoint.is_zero(&self.key(&format!("{name}.{tensor}")));
        zero("weight") && (self.shape(&format!("{name}.bias")).is_none() || zero("bias"))
    }

    /// Checks a tensor that nothing needs as [`Weights::read`] would.
    pub(crate) fn check(&self, name: &str, shape: &[usize]) -> Result<(), ModelError> {
        self.read(name, shape)?;
        self.release(name);
        Ok(())
    }

    /// The keys below `name` and a dot.
    pub(crate) fn at(&self, name: impl std::fmt::Display) -> Weights<'a> {
        Weights { prefix: format!("{}{name}.", self.prefix), ..self.clone() }
    }

    /// The same keys, for layers that multiply in `precision`.
    pub(crate) fn held_in(&self, precision: Precision) -> Weights<'a> {
        Weights { precision, ..self.clone() }
    }

    /// The level that packs layers; the result is the same on any.
    pub(crate) fn level(&self) -> Level {
        self.level
    }

    /// The format in which layers hold the operands of their products: f32 by default.
    pub(crate) fn precision(&self) -> Precision {
        self.precision
    }

    /// The file's name of a tensor.
    pub(crate) fn key(&self, name: &str) -> String {
        self.layout.key(&format!("{}{name}", self.prefix)).into_owned()
    }

    pub(crate) fn file(&self) -> &'a str {
        self.checkpoint.file()
    }

    pub(crate) fn shape(&self, name: &str) -> Option<&'a [usize]> {
        self.checkpoint.shape(&self.key(name))
    }

    /// Number of consecutive `name.0.…`, `name.1.…` that hold a tensor `probe`.
    pub(crate) fn count(&self, name: &str, probe: &str) -> usize {
        (0..).take_while(|i| self.shape(&format!("{name}.{i}.{probe}")).is_some()).count()
    }

    /// Returns the shape of a tensor with `RANK` axes; axes that are `Some` must have that size.
    pub(crate) fn shape_like<const RANK: usize>(
        &self,
        name: &str,
        like: [Option<usize>; RANK],
    ) -> Result<[usize; RANK], ModelError> {
        let expected = || {
            let sides: Vec<String> = like.iter().map(|s| s.map_or("_".to_owned(), |s| s.to_string())).collect();
            format!("[{}]", sides.join(", "))
        };
        let found = self.shape(name).ok_or_else(|| self.missing(name, expected()))?;
        match <[usize; RANK]>::try_from(found) {
            Ok(shape) if shape.iter().zip(&like).all(|(s, l)| l.is_none_or(|l| l == *s) && *s > 0) => Ok(shape),
            _ => Err(self.misshapen(name, expected())),
        }
    }

    /// The values of a tensor of this shape; leading axes of one element may be missing or in excess.
    pub(crate) fn read(&self, name: &str, shape: &[usize]) -> Result<Cow<'a, [f32]>, ModelError> {
        fn core(shape: &[usize]) -> &[usize] {
            &shape[shape.iter().position(|&s| s != 1).unwrap_or(shape.len())..]
        }
        let expected = || format!("{shape:?}");
        let found = self.shape(name).ok_or_else(|| self.missing(name, expected()))?;
        if core(found) != core(shape) {
            return Err(self.misshapen(name, expected()));
        }
        self.checkpoint.read(&self.key(name))
    }

    /// [`Weights::read`] into an owned vector.
    pub(crate) fn vector(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>, ModelError> {
        let values = self.read(name, shape)?.into_owned();
        self.release(name);
        Ok(values)
    }

    /// Releases the tensor's memory after its last read.
    pub(crate) fn release(&self, name: &str) {
        self.checkpoint.release(&self.key(name));
    }

    fn missing(&self, name: &str, expected: String) -> ModelError {
        ModelError::Missing { file: self.file().to_owned(), tensor: self.key(name), expected }
    }

    fn misshapen(&self, name: &str, expected: String) -> ModelError {
        let found = self.shape(name).unwrap_or_default().to_vec();
        ModelError::Shape { file: self.file().to_owned(), tensor: self.key(name), expected, found }
    }
}
