//! The heads: rows whose tokens did not change keep their results, bit for bit.

use streamsplat_kernels::Level;
use streamsplat_kernels::change::Tolerance;

use super::rows::{Gate, Rows};
use super::{Tokens, UpsamplerMemory};
use crate::deformation_head::DeformationHead;
use crate::static_head::StaticHead;
use crate::{Config, Sampling, StaticGaussians};

/// Cache of the static head.
#[derive(Debug)]
pub(crate) struct StaticHeadMemory {
    /// Calls of the upsampler when it last gave something.
    calls: u64,
    gaussians: StaticGaussians,
    pub(crate) tokens: Tokens,
}

impl StaticHeadMemory {
    pub(crate) fn new(_: &Config) -> StaticHeadMemory {
        StaticHeadMemory { calls: 0, gaussians: StaticGaussians::default(), tokens: Tokens::default() }
    }

    pub(crate) fn bytes(&self) -> usize {
        // Position, scale, opacity and colour.
        self.gaussians.opacity.len() * 4 * (3 + 2 + 1 + 3)
    }
}

impl StaticHead {
    /// [`StaticHead::apply`] with the mean positions of `tokens`, the result of the last call of `upsampler`.
    pub(crate) fn apply_keeping(
        &self,
        level: Level,
        config: &Config,
        tokens: &[f32],
        upsampler: &UpsamplerMemory,
        memory: &mut StaticHeadMemory,
    ) -> StaticGaussians {
        let (n, d) = (config.gaussians(), config.gaussian_dim());
        let follows = memory.calls > 0 && memory.calls + 1 == upsampler.calls;
        memory.calls = upsampler.calls;
        match &upsampler.latest {
            Some(changed) if follows => {
                let rows = Rows::gather(changed.clone(), tokens, d);
                let some = self.apply_some(level, config, &rows.x, &rows.at);
                let kept = &mut memory.gaussians;
                for (i, row) in rows.at.iter().map(|row| *row as usize).enumerate() {
                    kept.position[row] = some.position[i];
                    kept.scale[row] = some.scale[i];
                    kept.opacity[row] = some.opacity[i];
                    kept.rgb[row] = some.rgb[i];
                }
                memory.tokens.count(rows.at.len(), n);
            }
            _ => {
                memory.gaussians = self.apply(level, config, tokens, Sampling::Mean);
                memory.tokens.count(n, n);
            }
        }
        memory.gaussians.clone()
    }
}

/// Cache of the deformation head for one frame of the pair.
#[derive(Debug)]
pub(crate) struct DeformationHeadMemory {
    calls: u64,
    /// The static tokens; empty where nothing is kept.
    still: Gate,
    kept: bool,
    velocity: Vec<[f32; 3]>,
    gamma: Vec<[f32; 2]>,
    pub(crate) tokens: Tokens,
}

impl DeformationHeadMemory {
    pub(crate) fn new(config: &Config) -> DeformationHeadMemory {
        DeformationHeadMemory {
            calls: 0,
            still: Gate::new(config.gaussians(), config.gaussian_dim()),
            kept: false,
            velocity: Vec::new(),
            gamma: Vec::new(),
            tokens: Tokens::default(),
        }
    }

    pub(crate) fn bytes(&self) -> usize {
        self.still.bytes() + 4 * (3 * self.velocity.len() + 2 * self.gamma.len())
    }
}

impl DeformationHead {
    /// [`DeformationHead::apply`] of `tokens`, the result of the last call of `upsampler`.
    pub(crate) fn apply_keeping(
        &self,
        level: Level,
        static_tokens: &[f32],
        tokens: &[f32],
        upsampler: &UpsamplerMemory,
        memory: &mut DeformationHeadMemory,
    ) -> (Vec<[f32; 3]>, Vec<[f32; 2]>) {
        let n = memory.still.rows();
        let d = tokens.len() / n;
        let follows = memory.kept && memory.calls + 1 == upsampler.calls;
        memory.calls = upsampler.calls;
        match &upsampler.latest {
            Some(changed) if follows => {
                let mut marks = memory.still.moved(level, Tolerance::Bits, static_tokens);
                changed.iter().for_each(|row| marks[*row as usize] = true);
                let still = Rows::gather(super::rows::places(&marks), static_tokens, d);
                memory.still.replace(&still);
                let moving = Rows::gather(still.at, tokens, d);
                let (velocity, gamma) = self.apply(level, &still.x, &moving.x);
                for (i, row) in moving.at.iter().map(|row| *row as usize).enumerate() {
                    memory.velocity[row] = velocity[i];
                    memory.gamma[row] = gamma[i];
                }
                memory.tokens.count(moving.at.len(), n);
            }
            latest => {
                // Static tokens are kept once the upsampler has begun to leave something out.
                memory.kept = latest.is_some();
                if memory.kept {
                    memory.still.keep(static_tokens);
                }
                (memory.velocity, memory.gamma) = self.apply(level, static_tokens, tokens);
                memory.tokens.count(n, n);
            }
        }
        (memory.velocity.clone(), memory.gamma.clone())
    }
}
