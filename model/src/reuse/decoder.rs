//! The dynamic decoder.

use streamsplat_kernels::Level;

use super::blocks::BlockMemory;
use super::rows::{Gate, Rows, places, sized};
use super::schedule::{Pass, Schedule};
use super::{Saving, Tokens, scatter_heads};
use crate::Config;
use crate::decoder::Decoder;
use crate::layers::{HEAD, Workspace, add_zero, windows};

/// Cache of the decoder. Its tokens are those of both frames, the earlier one's first.
#[derive(Debug)]
pub(crate) struct DecoderMemory {
    schedule: Schedule,
    /// The features that each frame is conditioned on.
    conditions: [Gate; 2],
    blocks: Vec<PairMemory>,
    /// `d [2N, D]`
    output: Vec<f32>,
    pub(crate) tokens: Tokens,
}

/// Cache of one block.
#[derive(Debug)]
struct PairMemory {
    own: BlockMemory,
    /// Keys and values of each frame's condition, `[2·heads][M][64]`.
    cross: [Vec<f32>; 2],
}

impl DecoderMemory {
    pub(crate) fn new(config: &Config) -> DecoderMemory {
        let (n, d) = (config.tokens(), config.hidden_dim);
        let block = |_| PairMemory { own: BlockMemory::new(2 * n, d), cross: Default::default() };
        DecoderMemory {
            schedule: Schedule::default(),
            conditions: [0, 1].map(|_| Gate::new(n, config.condition_dim)),
            blocks: (0..config.decoder_layers).map(block).collect(),
            output: Vec::new(),
            tokens: Tokens::default(),
        }
    }

    pub(crate) fn bytes(&self) -> usize {
        let cross = |block: &PairMemory| block.cross.iter().map(Vec::len).sum::<usize>();
        let blocks: usize = self.blocks.iter().map(|block| block.own.bytes() + 4 * cross(block)).sum();
        self.conditions.iter().map(Gate::bytes).sum::<usize>() + blocks + 4 * self.output.len()
    }
}

impl Decoder {
    /// [`Decoder::apply`] with a memory; `moves`: see [`Schedule::next`].
    pub(crate) fn apply_keeping(
        &self,
        level: Level,
        config: &Config,
        (h, features): ([&[f32]; 2], [&[f32]; 2]),
        (saving, moves): (Saving, bool),
        memory: &mut DecoderMemory,
        work: &mut Workspace,
    ) -> [Vec<f32>; 2] {
        let (n, d) = (config.tokens(), config.hidden_dim);
        let DecoderMemory { schedule, conditions, blocks, output, tokens } = memory;
        // Each token sees all of the other frame's: where one bit differs, all do.
        let (Some(first), Saving::Within(_)) = (blocks.first_mut(), saving) else {
            tokens.count(blocks.len() * 2 * n, blocks.len() * 2 * n);
            return self.apply(level, config, h, features, work);
        };
        let x = self.enter(level, h);
        let changed = match schedule.has_seen() {
            true => {
                let marks = first.own.gate.moved(level, saving.tolerance(), &x);
                let (earlier, later) = marks.split_at(n);
                let either: Vec<bool> = earlier.iter().zip(later).map(|(a, b)| *a || *b).collect();
                places(&[either.as_slice(), &either].concat())
            }
            false => Vec::new(),
        };
        let pass = schedule.next(saving, moves, changed.len(), 2 * n);
        let mut rows = match pass {
            Pass::Plain => {
                first.own.gate.keep(&x);
                tokens.count(blocks.len() * 2 * n, blocks.len() * 2 * n);
                return self.apply(level, config, h, features, work);
            }
            Pass::Refresh => Rows::all(x, d),
            Pass::Changed => Rows::gather(changed, &x, d),
        };
        let refresh = pass == Pass::Refresh;
        // Each frame is conditioned on the other.
        let mut conditions = conditions.iter_mut().zip([features[1], features[0]]);
        let conditions = [(); 2].map(|()| match conditions.next() {
            Some((gate, features)) => self.renewed(level, config.condition_dim, saving, refresh, gate, features),
            None => (Rows::default(), 0),
        });
        for (i, (block, memory)) in self.blocks.iter().zip(blocks).enumerate() {
            let windows = windows(config.encoder_window, i);
            // The gate would drop a token whose partner in the other frame changed.
            if i == 0 && !refresh {
                memory.own.gate.replace(&rows);
            } else {
                let mixed = block.self_attn.is_some().then_some(windows);
                memory.own.admit(level, saving, refresh, mixed, &mut rows);
            }
            tokens.count(rows.at.len(), 2 * n);
            let Rows { at, x } = &mut rows;
            let own = &mut memory.own.keys_values;
            match &block.self_attn {
                Some(self_attn) => self_attn.accumulate_some(level, windows, at, x, own, work),
                None => add_zero(x),
            }
            match &block.cross_attn {
                Some(cross_attn) => {
                    let (earlier, later) = x.split_at_mut(at.partition_point(|token| (*token as usize) < n) * d);
                    let halves = [earlier, later].into_iter().zip(&mut memory.cross);
                    for ((x, kept), (renewed, m)) in halves.zip(&conditions) {
                        sized(kept, m * 2 * d);
                        let new = cross_attn.keys_values(level, &renewed.x);
                        scatter_heads(&renewed.at, &new, HEAD, kept);
                        cross_attn.accumulate_with(level, kept, x, work);
                    }
                }
                None => add_zero(x),
            }
            block.feed_forward(level, x);
        }
        rows.x = self.layernorm2.of(level, &rows.x);
        sized(output, 2 * n * d);
        rows.scatter(output, d);
        let (earlier, later) = output.split_at(n * d);
        [earlier.to_vec(), later.to_vec()]
    }

    /// The rows of a condition that changed, ready to attend to, and how many there are in all.
    fn renewed(
        &self,
        level: Level,
        channels: usize,
        saving: Saving,
        refresh: bool,
        gate: &mut Gate,
        features: &[f32],
    ) -> (Rows, usize) {
        let m = features.len() / channels;
        if refresh || gate.rows() != m {
            gate.keep(features);
            let mut rows = Rows::all(Vec::new(), channels);
            rows.at = (0..m as u32).collect();
            rows.x = self.condition_some(level, features, &rows.at, m);
            return (rows, m);
        }
        let mut rows = Rows::gather(places(&gate.moved(level, saving.tolerance(), features)), features, channels);
        gate.replace(&rows);
        rows.x = self.condition_some(level, &rows.x, &rows.at, m);
        (rows, m)
    }
}
