//! The upsamplers.

use streamsplat_kernels::Level;

use super::blocks::{BlockMemory, step};
use super::rows::{Gate, Rows, places, sized};
use super::schedule::{Pass, Schedule};
use super::{Saving, Tokens};
use crate::Config;
use crate::layers::{Workspace, windows};
use crate::upsampler::Upsampler;

/// Cache of an upsampler.
#[derive(Debug)]
pub(crate) struct UpsamplerMemory {
    schedule: Schedule,
    entry: Gate,
    stages: [[BlockMemory; 2]; 2],
    /// `[16N, d]`
    output: Vec<f32>,
    /// Calls so far.
    pub(super) calls: u64,
    /// Tokens that the last call computed; `None`: all.
    pub(super) latest: Option<Vec<u32>>,
    pub(crate) tokens: Tokens,
}

impl UpsamplerMemory {
    pub(crate) fn new(config: &Config) -> UpsamplerMemory {
        let (n, [first, second]) = (config.tokens(), config.upsampler_widths);
        UpsamplerMemory {
            schedule: Schedule::default(),
            entry: Gate::new(n, config.hidden_dim),
            stages: [(4 * n, first), (16 * n, second)].map(|(n, d)| [0, 1].map(|_| BlockMemory::new(n, d))),
            output: Vec::new(),
            calls: 0,
            latest: None,
            tokens: Tokens::default(),
        }
    }

    pub(crate) fn bytes(&self) -> usize {
        let blocks: usize = self.stages.iter().flatten().map(BlockMemory::bytes).sum();
        self.entry.bytes() + blocks + 4 * self.output.len()
    }
}

impl Upsampler {
    /// [`Upsampler::apply`] with a memory; `moves`: see [`Schedule::next`].
    pub(crate) fn apply_keeping(
        &self,
        level: Level,
        config: &Config,
        h: &[f32],
        (saving, moves): (Saving, bool),
        memory: &mut UpsamplerMemory,
        work: &mut Workspace,
    ) -> Vec<f32> {
        let UpsamplerMemory { schedule, entry, stages, output, calls, latest, tokens } = memory;
        (*calls, *latest) = (*calls + 1, None);
        let (n, d) = (config.tokens(), config.hidden_dim);
        let changed = match schedule.has_seen() {
            true => places(&entry.moved(level, saving.tolerance(), h)),
            false => Vec::new(),
        };
        let pass = schedule.next(saving, moves, changed.len(), n);
        let mut rows = match pass {
            Pass::Plain => {
                entry.keep(h);
                tokens.count(2 * (4 + 16) * n, 2 * (4 + 16) * n);
                return self.apply(level, config, h, work);
            }
            Pass::Refresh => {
                entry.keep(h);
                Rows::all(h.to_vec(), d)
            }
            Pass::Changed => {
                let rows = Rows::gather(changed, h, d);
                entry.replace(&rows);
                rows
            }
        };
        let [_, mut width] = config.grid();
        for (stage, memories) in self.stages.iter().zip(stages) {
            let mut x = vec![0.0; rows.at.len() * stage.residual_fc.n()];
            stage.residual_fc.apply(level, &rows.x, &mut x);
            rows = Rows { at: sub_tokens(&rows.at, width), x };
            width *= 2;
            for (index, (block, memory)) in stage.blocks.iter().zip(memories).enumerate() {
                let part = (block, memory, windows(Some(config.upsampler_window), index));
                step(level, saving, pass == Pass::Refresh, part, &mut rows, (work, tokens));
            }
        }
        let d = config.gaussian_dim();
        rows.x = self.layernorm2.of(level, &rows.x);
        sized(output, config.gaussians() * d);
        rows.scatter(output, d);
        *latest = (pass == Pass::Changed).then_some(rows.at);
        output.clone()
    }
}

/// The places of the four sub-tokens of each token `at` of a grid of this width, row by row.
fn sub_tokens(at: &[u32], width: usize) -> Vec<u32> {
    let four = |&token: &u32| {
        let (y, x) = (token as usize / width, token as usize % width);
        [0, 1].map(|i| [0, 1].map(|j| ((2 * y + i) * 2 * width + 2 * x + j) as u32))
    };
    at.iter().flat_map(four).flatten().collect()
}
