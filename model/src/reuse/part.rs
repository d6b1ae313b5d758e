//! A part of the network that is a run of blocks: encoder, upsampler, decoder.

use streamsplat_kernels::Level;
use streamsplat_kernels::attention::Windows;
use streamsplat_kernels::memory::Aligned;

use super::rows::{Gate, Rows, places, scatter};
use super::schedule::{Extent, Schedule};
use super::{Saving, Tokens};
use crate::Config;

/// Cache of a part.
#[derive(Debug)]
pub(crate) struct PartCache {
    saving: Saving,
    schedule: Schedule,
    /// The part's input, where it is not that of the first block.
    input: Option<Gate>,
    /// The features on which each frame of a pair is conditioned. Where there are any, tokens are those of both frames,
    /// the earlier one's first.
    conditions: Vec<Gate>,
    /// Empty where there is nothing to keep.
    blocks: Vec<BlockCache>,
    output: Vec<f32>,
    /// Tokens of all blocks.
    all: usize,
    /// Calls so far.
    pub(super) calls: u64,
    /// Tokens that the last call computed; `None`: all.
    pub(super) latest: Option<Vec<u32>>,
    pub(super) tokens: Tokens,
}

/// Cache of a block: its tokens as last computed, and the tokens they were mixed from.
#[derive(Debug)]
pub(crate) struct BlockCache {
    gate: Gate,
    /// Keys and values of the tokens, `[2·heads][n][64]`; empty where the block does not mix them.
    pub(crate) own: Vec<f32>,
    /// Keys and values of each frame's condition, `[2·heads][M][64]`.
    pub(crate) cross: [Vec<f32>; 2],
}

impl PartCache {
    fn new(saving: Saving, input: Option<Gate>, conditions: Vec<Gate>, blocks: &[[usize; 2]]) -> PartCache {
        let all = blocks.iter().map(|[n, _]| n).sum();
        let block = |&[n, d]: &[usize; 2]| BlockCache::new(n, d);
        let blocks = match saving {
            // Each token attends to all of the other frame's: where one bit differs, all results do.
            Saving::Exact if !conditions.is_empty() => Vec::new(),
            _ => blocks.iter().map(block).collect(),
        };
        let schedule = Schedule::default();
        let (output, tokens) = (Vec::new(), Tokens::default());
        PartCache { saving, schedule, input, conditions, blocks, output, all, calls: 0, latest: None, tokens }
    }

    pub(super) fn encoder(saving: Saving, config: &Config) -> PartCache {
        let blocks = vec![[config.tokens(), config.hidden_dim]; config.encoder_layers];
        PartCache::new(saving, None, Vec::new(), &blocks)
    }

    pub(super) fn upsampler(saving: Saving, config: &Config) -> PartCache {
        let (n, [first, second]) = (config.tokens(), config.upsampler_widths);
        let blocks = [[4 * n, first], [4 * n, first], [16 * n, second], [16 * n, second]];
        PartCache::new(saving, Some(Gate::new(n, config.hidden_dim)), Vec::new(), &blocks)
    }

    /// DINOv2 of this depth on `n` tokens of width `d`: each attends to all others, so nothing is kept exactly.
    pub(crate) fn features(saving: Saving, n: usize, d: usize, depth: usize) -> Option<PartCache> {
        (saving != Saving::Exact).then(|| PartCache::new(saving.of_motion(), None, Vec::new(), &vec![[n, d]; depth]))
    }

    /// Returns an empty cache with the same counters.
    pub(crate) fn emptied(&self) -> PartCache {
        let block = |block: &BlockCache| BlockCache::new(block.gate.rows(), block.gate.width());
        PartCache {
            schedule: Schedule::default(),
            input: None,
            conditions: Vec::new(),
            blocks: self.blocks.iter().map(block).collect(),
            output: Vec::new(),
            calls: 0,
            latest: None,
            ..*self
        }
    }

    /// Tokens computed and kept so far.
    pub(crate) fn tokens(&self) -> Tokens {
        self.tokens
    }

    pub(super) fn decoder(saving: Saving, config: &Config) -> PartCache {
        let n = config.tokens();
        let conditions = [0, 1].map(|_| Gate::new(n, config.condition_dim));
        let blocks = vec![[2 * n, config.hidden_dim]; config.decoder_layers];
        PartCache::new(saving, None, conditions.into(), &blocks)
    }

    /// Returns true if most of the input changed since the call before.
    pub(crate) fn moves(&self) -> bool {
        self.schedule.moves()
    }

    pub(crate) fn bytes(&self) -> usize {
        let gates: usize = self.input.iter().chain(&self.conditions).map(Gate::bytes).sum();
        gates + self.blocks.iter().map(BlockCache::bytes).sum::<usize>() + 4 * self.output.len()
    }
}

impl BlockCache {
    fn new(n: usize, d: usize) -> BlockCache {
        BlockCache { gate: Gate::new(n, d), own: Vec::new(), cross: Default::default() }
    }

    fn bytes(&self) -> usize {
        let [a, b] = &self.cross;
        self.gate.bytes() + 4 * (self.own.len() + a.len() + b.len())
    }
}

/// One call of a part, block by block: selects the tokens that are computed and keeps results.
pub(crate) struct Pass<'a> {
    level: Level,
    /// `None` where nothing is kept.
    cache: Option<&'a mut PartCache>,
}

impl<'a> Pass<'a> {
    /// Begins a call on `x [n, d]`, the input of the blocks (of an upsampler: of its first layer). Returns the rows
    /// that must be computed. `moves`: see [`Schedule::next`].
    pub(crate) fn begin(
        level: Level,
        cache: Option<&'a mut PartCache>,
        moves: bool,
        x: &[f32],
        memory: Aligned<f32>,
    ) -> (Pass<'a>, Rows) {
        let whole = |cache, memory| (Pass { level, cache }, Rows::gather(None, x, 1, memory));
        let Some(cache) = cache else { return whole(None, memory) };
        (cache.calls, cache.latest) = (cache.calls + 1, None);
        let Some(gate) = cache.input.as_mut().or(cache.blocks.first_mut().map(|block| &mut block.gate)) else {
            cache.tokens.count(cache.all, cache.all);
            return whole(None, memory);
        };
        let mut changed = Vec::new();
        if cache.schedule.has_seen() {
            let mut marks = gate.moved(level, cache.saving.tolerance(), x);
            if !cache.conditions.is_empty() {
                let (earlier, later) = marks.split_at_mut(x.len() / gate.width() / 2);
                for (a, b) in earlier.iter_mut().zip(later) {
                    (*a, *b) = (*a || *b, *a || *b);
                }
            }
            changed = places(&marks);
        }
        match cache.schedule.next(cache.saving, moves, changed.len(), gate.rows()) {
            Extent::Plain => {
                gate.keep(x);
                cache.tokens.count(cache.all, cache.all);
                whole(None, memory)
            }
            Extent::Refresh => {
                gate.keep(x);
                whole(Some(cache), memory)
            }
            Extent::Changed => {
                gate.replace(&changed, x);
                let rows = Rows::gather(Some(changed), x, gate.width(), memory);
                (Pass { level, cache: Some(cache) }, rows)
            }
        }
    }

    /// A call that keeps nothing.
    pub(crate) fn without_cache(level: Level) -> Pass<'a> {
        Pass { level, cache: None }
    }

    /// Returns true if this call keeps its results.
    pub(crate) fn keeps(&self) -> bool {
        self.cache.is_some()
    }

    /// Returns the tokens of the condition `features [m, channels]` of frame `side` that must be computed; `None`: all.
    pub(crate) fn condition(&mut self, side: usize, features: &[f32], rows: &Rows) -> Option<Vec<u32>> {
        let cache = self.cache.as_deref_mut()?;
        let gate = &mut cache.conditions[side];
        if rows.at.is_none() || features.len() != gate.rows() * gate.width() {
            gate.keep(features);
            return None;
        }
        let at = places(&gate.moved(self.level, cache.saving.tolerance(), features));
        gate.replace(&at, features);
        Some(at)
    }

    /// Reduces `rows` to those that block `index` must compute, keeps its input, and returns its cache. `mixed` are the
    /// windows in which the block mixes tokens, if it does.
    pub(crate) fn admit(&mut self, index: usize, mixed: Option<Windows>, rows: &mut Rows) -> Option<&mut BlockCache> {
        let cache = self.cache.as_deref_mut()?;
        let block = &mut cache.blocks[index];
        // `begin` has already passed the first block's input through its gate, which would now drop a token whose
        // partner in the other frame changed.
        if index > 0 || cache.input.is_some() {
            block.gate.pass(self.level, cache.saving.tolerance(), rows);
        }
        let (n, d) = (block.gate.rows(), block.gate.width());
        if let (Saving::Exact, Some(windows), Some(at)) = (cache.saving, mixed, &rows.at) {
            let (whole, memory) = (whole_windows(windows, at, n), std::mem::take(&mut rows.x));
            *rows = Rows::gather(Some(whole), block.gate.reference(), d, memory);
        }
        cache.tokens.count(rows.x.len() / d, n);
        Some(block)
    }

    /// Ends the call; returns the whole output. `x`: its rows `at`.
    pub(crate) fn finish(self, at: Option<Vec<u32>>, x: Vec<f32>) -> Vec<f32> {
        let Some(cache) = self.cache else { return x };
        match at.as_deref() {
            None => cache.output.clone_from(&x),
            Some([]) => {}
            Some(rows) => scatter(rows, &x, &mut cache.output, x.len() / rows.len()),
        }
        cache.latest = at;
        cache.output.clone()
    }
}

/// Returns all tokens, of `n`, of the windows that contain one of `at`.
fn whole_windows(windows: Windows, at: &[u32], n: usize) -> Vec<u32> {
    let window = |token: usize| match windows {
        Windows::Full => 0,
        Windows::Runs { length, roll } => (token + roll) % n / length,
    };
    let mut touched = vec![false; n];
    at.iter().for_each(|&token| touched[window(token as usize)] = true);
    (0..n as u32).filter(|token| touched[window(*token as usize)]).collect()
}
