//! The static encoder: from a frame's pixels and depth to its embedding.
//!
//! ```text
//! tokens_conv = conv(R, G, B, depth)                     [N, D], 8×8 stride 8, no bias
//! h = norm₂(blocks(norm₁(tokens_conv + position code)))
//! ```

use streamsplat_kernels::Level;
use streamsplat_kernels::patches::patches;

use crate::checkpoint::Weights;
use crate::grid::rows_of;
use crate::layers::{Block, Linear, RmsNorm, Workspace, add, sinusoid, sized, windows};
use crate::reuse::{PartCache, Pass, Rows, gather};
use crate::{Config, ModelError, Precision};

#[derive(Clone)]
pub(crate) struct Encoder {
    conv: Linear,
    position: Vec<f32>,
    layernorm1: RmsNorm,
    blocks: Vec<Block>,
    layernorm2: RmsNorm,
}

impl Encoder {
    pub(crate) fn load(weights: &Weights<'_>, config: &Config, precision: Precision) -> Result<Encoder, ModelError> {
        let (d, n, p) = (config.hidden_dim, config.tokens(), config.patch_size);
        let conv = weights.read("conv.weight", &[d, 4, p, p])?;
        let pe = "positional_encoding.pe";
        let blocks = (0..config.encoder_layers)
            .map(|i| {
                let precision = if i == 0 { precision.of_edges() } else { precision.of_blocks() };
                Block::load(&weights.held_in(precision).at(format_args!("transformer.resblocks.{i}")), d)
            })
            .collect::<Result<_, _>>()?;
        Ok(Encoder {
            conv: Linear::new(weights.level(), weights.precision(), &conv, None, d, 4 * p * p),
            position: if weights.shape(pe).is_some() { weights.vector(pe, &[n, d])? } else { sinusoid(n, d) },
            layernorm1: RmsNorm::load(weights, "layernorm1", d)?,
            blocks,
            layernorm2: RmsNorm::load(weights, "layernorm2", d)?,
        })
    }

    /// Keeps the position codes of these places of the grid, in this order.
    pub(crate) fn keep_positions(&mut self, places: &[usize]) {
        self.position = rows_of(&self.position, self.conv.n(), places);
    }

    pub(crate) fn tokenize(&self, level: Level, config: &Config, rgb: &[f32], depth: &[f32]) -> Vec<f32> {
        let [height, width] = config.resolution;
        let area = height * width;
        let planes = [&rgb[..area], &rgb[area..2 * area], &rgb[2 * area..], depth];
        let mut rows = vec![0.0; 4 * area];
        patches(&planes, height, width, config.patch_size, &mut rows);
        let mut tokens = vec![0.0; config.tokens() * config.hidden_dim];
        self.conv.apply(level, &rows, &mut tokens);
        tokens
    }

    /// `h [N, D]` of the tokens of a frame.
    pub(crate) fn encode(
        &self,
        level: Level,
        config: &Config,
        tokens: &[f32],
        cache: Option<&mut PartCache>,
        work: &mut Workspace,
    ) -> Vec<f32> {
        let mut entered = tokens.to_vec();
        add(&mut entered, &self.position);
        let entered = self.layernorm1.of(level, &entered);
        let (mut pass, mut rows) = Pass::begin(level, cache, false, &entered, std::mem::take(&mut work.tokens));
        for (i, block) in self.blocks.iter().enumerate() {
            let windows = windows(config.encoder_window, i);
            let kept = pass.admit(i, block.mixed(windows), &mut rows);
            block.apply(level, windows, &mut rows, kept, work);
        }
        let h = pass.finish(rows.at, self.layernorm2.of(level, &rows.x));
        work.tokens = rows.x;
        h
    }

    /// [`Encoder::encode`] for the tokens `part` alone, `[part, D]`. All blocks but the last need every token; the last
    /// needs keys and values of every token.
    pub(crate) fn encode_part(
        &self,
        level: Level,
        config: &Config,
        tokens: &[f32],
        part: &[u32],
        work: &mut Workspace,
    ) -> Vec<f32> {
        let d = self.conv.n();
        let mut entered = tokens.to_vec();
        add(&mut entered, &self.position);
        let mut x = std::mem::take(&mut work.tokens);
        sized(&mut x, entered.len()).copy_from_slice(&self.layernorm1.of(level, &entered));
        let mut all = Rows { at: None, x };
        let mut rows = vec![0.0; part.len() * d];
        match self.blocks.split_last() {
            None => gather(part, &all.x, d, &mut rows),
            Some((last, first)) => {
                for (i, block) in first.iter().enumerate() {
                    block.apply(level, windows(config.encoder_window, i), &mut all, None, work);
                }
                let windows = windows(config.encoder_window, first.len());
                last.apply_part(level, windows, part, &all.x, &mut rows, work);
            }
        }
        work.tokens = all.x;
        self.layernorm2.of(level, &rows)
    }

    pub(crate) fn bytes(&self) -> usize {
        let norms = self.layernorm1.bytes() + self.layernorm2.bytes();
        self.conv.bytes() + 4 * self.position.len() + norms + self.blocks.iter().map(Block::bytes).sum::<usize>()
    }
}
