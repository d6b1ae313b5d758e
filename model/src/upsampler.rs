//! From one token per patch to one per 2×2 pixels.
//!
//! There are two stages. In each a linear layer widens a token to four sub-tokens and writes them on a grid twice as
//! fine (a pixel shuffle). Then a pair of window blocks mixes them: the first with the windows in place, the second
//! with the windows rolled by half a window.

use streamsplat_kernels::Level;

use crate::checkpoint::Weights;
use crate::layers::{Block, Linear, RmsNorm, Workspace, sized, windows};
use crate::reuse::{PartCache, Pass, Rows};
use crate::{Config, ModelError, Precision};

#[derive(Clone)]
pub(crate) struct Upsampler {
    stages: [Stage; 2],
    layernorm2: RmsNorm,
}

#[derive(Clone)]
struct Stage {
    /// Its columns are sub-token after sub-token.
    residual_fc: Linear,
    blocks: [Block; 2],
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

    /// `[N, D]` to `[16N, d]`; `moves`: see [`Pass::begin`].
    pub(crate) fn apply(
        &self,
        level: Level,
        config: &Config,
        h: &[f32],
        (cache, moves): (Option<&mut PartCache>, bool),
        work: &mut Workspace,
    ) -> Vec<f32> {
        let (pass, rows) = Pass::begin(level, cache, moves, h, std::mem::take(&mut work.tokens));
        self.widen(level, config, pass, rows, work)
    }

    /// [`Upsampler::apply`] without a cache to the tokens `part` alone, whose rows `h` has. Windows must not mix them
    /// with others. The result has the rows of their sub-tokens, at [`cells`].
    pub(crate) fn apply_part(
        &self,
        level: Level,
        config: &Config,
        h: &[f32],
        part: &[u32],
        work: &mut Workspace,
    ) -> Vec<f32> {
        let mut x = std::mem::take(&mut work.tokens);
        sized(&mut x, h.len()).copy_from_slice(h);
        self.widen(level, config, Pass::without_cache(level), Rows { at: Some(part.to_vec()), x }, work)
    }

    fn widen(
        &self,
        level: Level,
        config: &Config,
        mut pass: Pass<'_>,
        mut rows: Rows,
        work: &mut Workspace,
    ) -> Vec<f32> {
        let [_, mut columns] = config.grid();
        let mut from = std::mem::take(&mut work.wide);
        for (i, stage) in self.stages.iter().enumerate() {
            std::mem::swap(&mut rows.x, &mut from);
            let (n, k) = (stage.residual_fc.n(), stage.residual_fc.k());
            let fine = sized(&mut rows.x, from.len() / k * n);
            match &mut rows.at {
                None => stage.residual_fc.shuffled(level, columns, &from, fine),
                Some(at) => {
                    stage.residual_fc.apply(level, &from, fine);
                    *at = sub_tokens(at, columns);
                }
            }
            columns *= 2;
            for (index, block) in stage.blocks.iter().enumerate() {
                // Adding zero again changes nothing.
                if !pass.keeps() && index > 0 && block.is_zero_output() && stage.blocks[index - 1].is_zero_output() {
                    continue;
                }
                let windows = windows(Some(config.upsampler_window), index);
                let kept = pass.admit(2 * i + index, block.mixed(windows), &mut rows);
                block.apply(level, windows, &mut rows, kept, work);
            }
        }
        let tokens = pass.finish(rows.at, self.layernorm2.of(level, &rows.x));
        (work.tokens, work.wide) = (rows.x, from);
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

/// The places of the sixteen sub-tokens of each token `at` of a grid of this width, in the order of their rows.
pub(crate) fn cells(at: &[u32], width: usize) -> Vec<u32> {
    sub_tokens(&sub_tokens(at, width), 2 * width)
}

/// The places of the four sub-tokens of each token `at` of a grid of this width, row by row.
fn sub_tokens(at: &[u32], width: usize) -> Vec<u32> {
    let four = |&token: &u32| {
        let (y, x) = (token as usize / width, token as usize % width);
        [0, 1].map(|i| [0, 1].map(|j| ((2 * y + i) * 2 * width + 2 * x + j) as u32))
    };
    at.iter().flat_map(four).flatten().collect()
}
