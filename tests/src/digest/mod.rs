//! One digest per computed item, for the bit contract: the same on every level, thread count, run and machine.
//!
//! Each [`Thing`] is small, so that all of them run in a minute on a real CPU and in some minutes on an emulated one.
//! Together they cover every kernel except `exposure` and `fill` (some only through the network or a stream), the
//! network in each kind of configuration, and a short stream in both fusion modes.

mod kernels;
mod network;
mod splats;
mod stream;

pub use splats::scene;

use rayon::ThreadPoolBuilder;
use streamsplat_kernels::Level;

/// A computed item, with the function that computes it on a level, on the current rayon pool.
pub struct Thing {
    /// Its name.
    pub name: String,
    compute: Box<dyn Fn(Level, &mut Digest) + Send + Sync>,
}

impl Thing {
    fn new(name: impl Into<String>, compute: impl Fn(Level, &mut Digest) + Send + Sync + 'static) -> Self {
        Self { name: name.into(), compute: Box::new(compute) }
    }

    /// Its digest on a level and a number of threads, in hexadecimal.
    ///
    /// # Panics
    /// When the threads cannot be started, or the item cannot be computed.
    pub fn digest(&self, level: Level, threads: usize) -> String {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
        let mut digest = Digest(blake3::Hasher::new());
        pool.install(|| (self.compute)(level, &mut digest));
        digest.0.finalize().to_hex()[..32].to_owned()
    }
}

/// All items, in a fixed order.
pub fn things() -> Vec<Thing> {
    [kernels::things(), splats::things(), network::things(), stream::things()].into_iter().flatten().collect()
}

/// Hash of values.
pub struct Digest(blake3::Hasher);

impl Digest {
    /// Adds values by their bits; every NaN counts as the same, since its bits are not defined.
    pub fn floats(&mut self, values: &[f32]) {
        for value in values {
            let bits = if value.is_nan() { 0x7fc0_0000 } else { value.to_bits() };
            self.0.update(&bits.to_le_bytes());
        }
    }

    /// Adds values by their bits.
    pub fn doubles(&mut self, values: &[f64]) {
        for value in values {
            let bits = if value.is_nan() { f64::NAN.to_bits() } else { value.to_bits() };
            self.0.update(&bits.to_le_bytes());
        }
    }

    /// Adds integers.
    pub fn integers(&mut self, values: impl IntoIterator<Item = u64>) {
        for value in values {
            self.0.update(&value.to_le_bytes());
        }
    }
}
