//! The upsamplers.

use streamsplat_kernels::Level;

use super::blocks::{BlockMemory, step};
use super::rows::{Gate, Rows, places, sized};
use super::schedule::{Pass, Schedule};
use super::{Saving, Tokens};
use crate::Config;
use crate::layers::{Workspace, windows};
use crate::upsampler::Upsampler;

/// What an upsampler keeps.
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
            let channels = stage.residual_fc.n() / 4;
            let mut wide = vec![0.0; rows.at.len() * 4 * channels];
            stage.residual_fc.apply(level, &rows.x, &mut wide);
            rows = spread(&rows.at, &wide, width, channels);
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

/// The pixel shuffle of some tokens `at` of a grid of this width: each gives four, row by row.
fn spread(at: &[u32], wide: &[f32], width: usize, channels: usize) -> Rows {
    let mut rows = Rows { at: Vec::with_capacity(4 * at.len()), x: vec![0.0; wide.len()] };
    let tokens = wide.chunks_exact(4 * channels).zip(rows.x.chunks_exact_mut(4 * channels));
    for (&token, (wide, out)) in at.iter().zip(tokens) {
        let (y, x) = (token as usize / width, token as usize % width);
        for (part, out) in out.chunks_exact_mut(channels).enumerate() {
            let (i, j) = (part / 2, part % 2);
            rows.at.push(((2 * y + i) * 2 * width + 2 * x + j) as u32);
            out.iter_mut().zip(wide.chunks_exact(4)).for_each(|(out, four)| *out = four[part]);
        }
    }
    rows
}
