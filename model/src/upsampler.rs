//! From one token per patch to one per 2×2 pixels.
//!
//! Two stages; in each a linear layer widens a token to four sub-tokens and writes them on a grid twice as fine (a pixel shuffle), and a pair of
//! window blocks mixes them: the first with the windows as they are, the second rolled by half a window.

use streamsplat_kernels::Level;

use crate::checkpoint::Weights;
use crate::layers::{Block, Linear, RmsNorm, Workspace, sized, windows};
use crate::{Config, ModelError, Precision};

#[derive(Clone)]
pub(crate) struct Upsampler {
    pub(crate) stages: [Stage; 2],
    pub(crate) layernorm2: RmsNorm,
}

#[derive(Clone)]
pub(crate) struct Stage {
    /// Its columns are sub-token after sub-token.
    pub(crate) residual_fc: Linear,
    pub(crate) blocks: [Block; 2],
}

impl Upsampler {
    pub(crate) fn load(weights: &Weights<'_>, config: &Config, precision: Precision) -> Result<Upsampler, ModelError> {
        let [first, second] = config.upsampler_widths;
        Ok(Upsampler {
            stages: [
                Stage::load(weights, 0, config.hidden_dim, first, precision)?,
                Stage::load(weights, 1, first, second, precision)?,
            ],
            layernorm2: RmsNorm::load(weights, "layernorm2", second)?,
        })
    }

    /// `[N, D]` to `[16N, d]`.
    pub(crate) fn apply(&self, level: Level, config: &Config, h: &[f32], work: &mut Workspace) -> Vec<f32> {
        let (mut tokens, mut x) = (config.tokens(), std::mem::take(&mut work.tokens));
        let [_, mut columns] = config.grid();
        let mut from = std::mem::take(&mut work.wide);
        for (i, stage) in self.stages.iter().enumerate() {
            std::mem::swap(&mut x, &mut from);
            let fine = sized(&mut x, tokens * stage.residual_fc.n());
            stage.residual_fc.shuffled(level, columns, if i == 0 { h } else { &from }, fine);
            (tokens, columns) = (4 * tokens, 2 * columns);
            for (index, block) in stage.blocks.iter().enumerate() {
                // To add zero again changes nothing.
                if index > 0 && block.is_silent() && stage.blocks[index - 1].is_silent() {
                    continue;
                }
                block.apply(level, windows(Some(config.upsampler_window), index), &mut x, work);
            }
        }
        let tokens = self.layernorm2.of(level, &x);
        (work.tokens, work.wide) = (x, from);
        tokens
    }

    pub(crate) fn bytes(&self) -> usize {
        let stage = |s: &Stage| s.residual_fc.bytes() + s.blocks.iter().map(Block::bytes).sum::<usize>();
        self.stages.iter().map(stage).sum::<usize>() + self.layernorm2.bytes()
    }
}

impl Stage {
    fn load(
        weights: &Weights<'_>,
        index: usize,
        from: usize,
        to: usize,
        precision: Precision,
    ) -> Result<Stage, ModelError> {
        let (edge, inner) = (weights.held_in(precision.of_edges()), weights.held_in(precision.of_blocks()));
        let block = |i: usize| Block::load(&inner.at(format_args!("attention_{index}.resblocks.{i}")), to);
        Ok(Stage {
            residual_fc: Linear::load_sub_tokens(&edge, &format!("upsampler_{index}.residual_fc"), to, from)?,
            blocks: [block(0)?, block(1)?],
        })
    }
}
