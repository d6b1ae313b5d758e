//! The whole network in plain binary64, as a reference for the fast one.
//!
//! Every function is the formula of its operation. Every sum is taken in index order, and nothing is fused.

mod dino;
mod network;
mod operations;

pub use dino::dino;
pub use network::{Inputs, Sizes, forward};

use std::collections::BTreeMap;

use streamsplat_model::checkpoint::Checkpoint;

/// Named results, first axis = frame.
pub type Outputs = BTreeMap<String, Vec<f64>>;

/// The tensors of a checkpoint, widened, without their prefix.
pub struct Tensors(BTreeMap<String, (Vec<usize>, Vec<f64>)>);

impl Tensors {
    /// Reads all tensors of the checkpoint that can be read as f32.
    ///
    /// # Panics
    /// When a tensor cannot be read.
    pub fn new(checkpoint: &Checkpoint) -> Tensors {
        let tensors = checkpoint.tensors().iter().map(|(name, info)| {
            let short = name.strip_prefix("model.").unwrap_or(name);
            let short = short.strip_prefix("_orig_mod.").unwrap_or(short);
            let values = checkpoint.read(name).expect("a readable tensor").iter().map(|&x| f64::from(x)).collect();
            (short.to_owned(), (info.shape.clone(), values))
        });
        Tensors(tensors.collect())
    }

    /// The values of a tensor.
    ///
    /// # Panics
    /// When the tensor is missing.
    pub fn get(&self, name: &str) -> &[f64] {
        &self.0.get(name).unwrap_or_else(|| panic!("tensor {name}")).1
    }

    /// The shape of a tensor.
    ///
    /// # Panics
    /// When the tensor is missing.
    pub fn shape(&self, name: &str) -> &[usize] {
        &self.0.get(name).unwrap_or_else(|| panic!("tensor {name}")).0
    }

    /// Returns true if the tensor exists.
    pub fn has(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    /// Number of consecutive `stem.0.leaf`, `stem.1.leaf`, ….
    pub fn count(&self, stem: &str, leaf: &str) -> usize {
        (0..).take_while(|i| self.has(&format!("{stem}.{i}.{leaf}"))).count()
    }
}

/// |found − expected| in units in the last place of binary32 at `expected`.
pub fn ulps(found: f64, expected: f64) -> f64 {
    let exponent = ((expected.to_bits() >> 52 & 0x7ff) as i32 - 1023).clamp(-126, 127);
    (found - expected).abs() / 2.0_f64.powi(exponent - 23)
}

/// ‖found − expected‖ / ‖expected‖
///
/// # Panics
/// When the lengths differ.
pub fn relative_l2(found: impl IntoIterator<Item = f64>, expected: impl IntoIterator<Item = f64>) -> f64 {
    let (mut found, mut expected) = (found.into_iter(), expected.into_iter());
    let (mut difference, mut norm) = (0.0, 0.0);
    loop {
        match (found.next(), expected.next()) {
            (Some(f), Some(e)) => {
                difference += (f - e) * (f - e);
                norm += e * e;
            }
            (None, None) => return (difference / norm).sqrt(),
            _ => panic!("the lengths differ"),
        }
    }
}
