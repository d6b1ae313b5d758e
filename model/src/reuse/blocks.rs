//! Runs of blocks, and the encoder, which is one.

use streamsplat_kernels::Level;
use streamsplat_kernels::attention::Windows;

use super::rows::{Gate, Rows, places, sized};
use super::schedule::{Pass, Schedule};
use super::{Saving, Tokens};
use crate::Config;
use crate::encoder::Encoder;
use crate::layers::{Block, Workspace, windows};

/// Cache of a block: its tokens as it last computed them, and their keys and values.
#[derive(Debug)]
pub(super) struct BlockMemory {
    pub(super) gate: Gate,
    /// `[2·heads][n][64]`; empty where the block does not mix tokens.
    pub(super) keys_values: Vec<f32>,
}

impl BlockMemory {
    pub(super) fn new(n: usize, d: usize) -> BlockMemory {
        BlockMemory { gate: Gate::new(n, d), keys_values: Vec::new() }
    }

    /// Leaves in `rows` what the block has to compute, and keeps its input. On a refresh these are all. `mixed` are the windows in which
    /// the block mixes tokens, if it does.
    pub(super) fn admit(
        &mut self,
        level: Level,
        saving: Saving,
        refresh: bool,
        mixed: Option<Windows>,
        rows: &mut Rows,
    ) {
        if refresh {
            self.gate.keep_at(rows);
            if mixed.is_some() {
                sized(&mut self.keys_values, 2 * rows.x.len());
            }
            return;
        }
        self.gate.pass(level, saving.tolerance(), rows);
        if let (Saving::Exact, Some(windows)) = (saving, mixed) {
            let whole = whole_windows(windows, &rows.at, self.gate.rows());
            let reference = self.gate.reference();
            *rows = Rows::gather(whole, reference, reference.len() / self.gate.rows());
        }
    }

    pub(super) fn bytes(&self) -> usize {
        self.gate.bytes() + 4 * self.keys_values.len()
    }
}

/// All tokens, of `n`, of the windows that hold one of `at`.
fn whole_windows(windows: Windows, at: &[u32], n: usize) -> Vec<u32> {
    let window = |token: usize| match windows {
        Windows::Full => 0,
        Windows::Runs { length, roll } => (token + roll) % n / length,
    };
    let mut touched = vec![false; n];
    at.iter().for_each(|&token| touched[window(token as usize)] = true);
    (0..n as u32).filter(|token| touched[window(*token as usize)]).collect()
}

/// Takes `rows` through one block.
pub(super) fn step(
    level: Level,
    saving: Saving,
    refresh: bool,
    (block, memory, windows): (&Block, &mut BlockMemory, Windows),
    rows: &mut Rows,
    (work, tokens): (&mut Workspace, &mut Tokens),
) {
    memory.admit(level, saving, refresh, block.mixes().then_some(windows), rows);
    tokens.count(rows.at.len(), memory.gate.rows());
    block.apply_some(level, windows, &rows.at, &mut rows.x, &mut memory.keys_values, work);
}

/// Cache of the encoder.
#[derive(Debug)]
pub(crate) struct EncoderMemory {
    schedule: Schedule,
    blocks: Vec<BlockMemory>,
    /// `h [N, D]`
    output: Vec<f32>,
    pub(crate) tokens: Tokens,
}

impl EncoderMemory {
    pub(crate) fn new(config: &Config) -> EncoderMemory {
        let block = |_| BlockMemory::new(config.tokens(), config.hidden_dim);
        EncoderMemory {
            schedule: Schedule::default(),
            blocks: (0..config.encoder_layers).map(block).collect(),
            output: Vec::new(),
            tokens: Tokens::default(),
        }
    }

    /// Returns true if most of the picture changed since the frame before.
    pub(crate) fn moves(&self) -> bool {
        self.schedule.moves()
    }

    pub(crate) fn bytes(&self) -> usize {
        self.blocks.iter().map(BlockMemory::bytes).sum::<usize>() + 4 * self.output.len()
    }
}

impl Encoder {
    /// [`Encoder::encode`] with a memory.
    pub(crate) fn encode_keeping(
        &self,
        level: Level,
        config: &Config,
        tokens: &[f32],
        saving: Saving,
        memory: &mut EncoderMemory,
        work: &mut Workspace,
    ) -> Vec<f32> {
        let (n, d) = (config.tokens(), config.hidden_dim);
        let x = self.enter(level, tokens);
        let EncoderMemory { schedule, blocks, output, tokens } = memory;
        let Some(first) = blocks.first() else { return self.run(level, config, x, work) };
        let changed = match schedule.has_seen() {
            true => places(&first.gate.moved(level, saving.tolerance(), &x)),
            false => Vec::new(),
        };
        let pass = schedule.next(saving, false, changed.len(), n);
        let mut rows = match pass {
            Pass::Plain => {
                blocks[0].gate.keep(&x);
                tokens.count(blocks.len() * n, blocks.len() * n);
                return self.run(level, config, x, work);
            }
            Pass::Refresh => Rows::all(x, d),
            Pass::Changed => Rows::gather(changed, &x, d),
        };
        for (i, (block, memory)) in self.blocks.iter().zip(blocks).enumerate() {
            let windows = windows(config.encoder_window, i);
            let part = (block, memory, windows);
            step(level, saving, pass == Pass::Refresh, part, &mut rows, (work, tokens));
        }
        rows.x = self.layernorm2.of(level, &rows.x);
        sized(output, n * d);
        rows.scatter(output, d);
        output.clone()
    }
}
