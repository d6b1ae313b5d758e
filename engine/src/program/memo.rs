//! A network that remembers its latest results, so that two engines fed the same frames pay for it once.

use std::any::Any;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard};

use streamsplat::stream::{Motion, Reconstructor};
use streamsplat_model::reuse::{Memory, Saving};
use streamsplat_model::{Embedding, FrameInput, ModelError, Sampling, Side, StaticGaussians};

/// Results kept: more than one engine asks for per key frame.
const KEPT: usize = 16;

type Key = [u8; 32];

/// Gives remembered results for equal input bits.
pub struct Memo {
    inner: Arc<dyn Reconstructor>,
    latest: Mutex<VecDeque<(Key, Box<dyn Any + Send>)>>,
}

impl Memo {
    /// In front of `inner`.
    pub fn new(inner: Arc<dyn Reconstructor>) -> Memo {
        Memo { inner, latest: Mutex::new(VecDeque::new()) }
    }

    fn recall<T: Clone + Send + 'static>(
        &self,
        what: &str,
        inputs: &[&[f32]],
        compute: impl FnOnce() -> Result<T, ModelError>,
    ) -> Result<T, ModelError> {
        let key = key(what, inputs);
        if let Some(value) = self.find(&key) {
            return Ok(value);
        }
        let value = compute()?;
        self.store(key, value.clone());
        Ok(value)
    }

    /// With a memory a result depends on the calls before as well: those of engines that are fed the same frames are the same.
    fn recall_keeping<T: Clone + Send + 'static>(
        &self,
        what: &str,
        inputs: &[&[f32]],
        memory: &mut Memory,
        compute: impl FnOnce(&mut Memory) -> Result<T, ModelError>,
    ) -> Result<T, ModelError> {
        let key = key(&format!("{what} at {}", memory.position()), inputs);
        if let Some(value) = self.find(&key) {
            memory.skip();
            return Ok(value);
        }
        let value = compute(memory)?;
        self.store(key, value.clone());
        Ok(value)
    }

    fn find<T: Clone + 'static>(&self, key: &Key) -> Option<T> {
        let latest = self.latest();
        latest.iter().find(|(k, _)| k == key).and_then(|(_, value)| value.downcast_ref::<T>().cloned())
    }

    fn store<T: Send + 'static>(&self, key: Key, value: T) {
        let mut latest = self.latest();
        latest.push_back((key, Box::new(value)));
        if latest.len() > KEPT {
            latest.pop_front();
        }
    }

    /// A poisoned lock means that another thread panicked; its queue is whole all the same.
    fn latest(&self) -> MutexGuard<'_, VecDeque<(Key, Box<dyn Any + Send>)>> {
        self.latest.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }
}

/// The digest of a call.
fn key(what: &str, inputs: &[&[f32]]) -> Key {
    let mut hasher = blake3::Hasher::new();
    hasher.update(what.as_bytes());
    for input in inputs {
        hasher.update(&(input.len() as u64).to_le_bytes());
        hasher.update(bytemuck::cast_slice(input));
    }
    hasher.finalize().into()
}

/// The inputs of a frame; an absent depth differs from an empty one.
fn of_frame<'a>(frame: &'a FrameInput<'_>) -> Vec<&'a [f32]> {
    [Some(frame.rgb), frame.depth].into_iter().flatten().collect()
}

impl Reconstructor for Memo {
    fn resolution(&self) -> [usize; 2] {
        self.inner.resolution()
    }

    fn embed(&self, frame: &FrameInput<'_>) -> Result<Embedding, ModelError> {
        self.recall("embed", &of_frame(frame), || self.inner.embed(frame))
    }

    fn upsample(&self, embedding: &Embedding) -> Result<Vec<f32>, ModelError> {
        self.recall("upsample", &[&embedding.h], || self.inner.upsample(embedding))
    }

    fn gaussians(&self, tokens: &[f32], sampling: &Sampling) -> Result<StaticGaussians, ModelError> {
        self.recall(&format!("gaussians {sampling:?}"), &[tokens], || self.inner.gaussians(tokens, sampling))
    }

    fn draws_positions(&self) -> bool {
        self.inner.draws_positions()
    }

    fn reads_condition(&self) -> bool {
        self.inner.reads_condition()
    }

    fn condition(&self, frame: &FrameInput<'_>) -> Result<Option<Vec<f32>>, ModelError> {
        self.recall("condition", &of_frame(frame), || self.inner.condition(frame))
    }

    fn decode(&self, a: &Side<'_>, b: &Side<'_>) -> Result<[Vec<f32>; 2], ModelError> {
        let inputs = [a, b].map(|side| [side.h, side.static_tokens, side.condition.unwrap_or_default()]);
        self.recall("decode", inputs.as_flattened(), || self.inner.decode(a, b))
    }

    fn upsample_motion(&self, d: &[f32]) -> Result<Vec<f32>, ModelError> {
        self.recall("upsample motion", &[d], || self.inner.upsample_motion(d))
    }

    fn motion(&self, static_tokens: &[f32], motion_tokens: &[f32]) -> Result<Motion, ModelError> {
        self.recall("motion", &[static_tokens, motion_tokens], || self.inner.motion(static_tokens, motion_tokens))
    }

    fn memory(&self, saving: Saving) -> Option<Memory> {
        self.inner.memory(saving)
    }

    fn embed_keeping(&self, frame: &FrameInput<'_>, memory: &mut Memory) -> Result<Embedding, ModelError> {
        self.recall_keeping("embed", &of_frame(frame), memory, |memory| self.inner.embed_keeping(frame, memory))
    }

    fn upsample_keeping(&self, embedding: &Embedding, memory: &mut Memory) -> Result<Vec<f32>, ModelError> {
        let upsample = |memory: &mut Memory| self.inner.upsample_keeping(embedding, memory);
        self.recall_keeping("upsample", &[&embedding.h], memory, upsample)
    }

    fn gaussians_keeping(
        &self,
        tokens: &[f32],
        sampling: &Sampling,
        memory: &mut Memory,
    ) -> Result<StaticGaussians, ModelError> {
        let gaussians = |memory: &mut Memory| self.inner.gaussians_keeping(tokens, sampling, memory);
        self.recall_keeping(&format!("gaussians {sampling:?}"), &[tokens], memory, gaussians)
    }

    fn decode_keeping(&self, a: &Side<'_>, b: &Side<'_>, memory: &mut Memory) -> Result<[Vec<f32>; 2], ModelError> {
        let inputs = [a, b].map(|side| [side.h, side.static_tokens, side.condition.unwrap_or_default()]);
        let decode = |memory: &mut Memory| self.inner.decode_keeping(a, b, memory);
        self.recall_keeping("decode", inputs.as_flattened(), memory, decode)
    }

    fn upsample_motion_keeping(&self, place: usize, d: &[f32], memory: &mut Memory) -> Result<Vec<f32>, ModelError> {
        let upsample = |memory: &mut Memory| self.inner.upsample_motion_keeping(place, d, memory);
        self.recall_keeping(&format!("upsample motion {place}"), &[d], memory, upsample)
    }

    fn motion_keeping(
        &self,
        place: usize,
        static_tokens: &[f32],
        motion_tokens: &[f32],
        memory: &mut Memory,
    ) -> Result<Motion, ModelError> {
        let motion = |memory: &mut Memory| self.inner.motion_keeping(place, static_tokens, motion_tokens, memory);
        self.recall_keeping(&format!("motion {place}"), &[static_tokens, motion_tokens], memory, motion)
    }
}
