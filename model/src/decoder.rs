//! The dynamic decoder: from two frames' embeddings to the embeddings of their deformations.
//!
//! ```text
//! c_f = norm(condition_proj(features of the other frame) + position code)
//! x = norm₁([h_a ; h_b] + learned positions + learned type of the frame)
//! per block:  x += self_attention(norm_s(x))            over the tokens of both frames
//!             x_f += cross_attention(norm_c(x_f), c_f)  for each frame
//!             x += feed_forward(norm_m(x))
//! d = norm₂(x)
//! ```

use std::borrow::Cow;

use streamsplat_kernels::Level;

use crate::checkpoint::Weights;
use crate::cost::USUAL_CONDITION;
use crate::grid::rows_of;
use crate::layers::{
    Bias, CrossAttention, FeedForward, HEAD, Linear, RmsNorm, SelfAttention, Workspace, add, add_zero, sinusoid, sized,
    windows,
};
use crate::reuse::{PartCache, Pass, Rows, gather, keep_heads};
use crate::{Config, ModelError, Precision};

#[derive(Clone)]
pub(crate) struct Decoder {
    /// Learned positions plus the type of each half, `[2N, D]`.
    position: Vec<f32>,
    condition_proj: Linear,
    condition_position: Table,
    condition_ln: RmsNorm,
    layernorm1: RmsNorm,
    blocks: Vec<PairBlock>,
    layernorm2: RmsNorm,
}

/// Position code of the condition.
#[derive(Clone)]
enum Table {
    /// From the checkpoint: of fixed length.
    Stored(Vec<f32>),
    /// Computed: recomputed where a longer one is needed.
    Computed(Vec<f32>),
}

/// A block; a zero-output branch is `None`.
#[derive(Clone)]
struct PairBlock {
    self_attn: Option<SelfAttention>,
    cross_attn: Option<CrossAttention>,
    mlp: Option<FeedForward>,
}

impl Decoder {
    pub(crate) fn load(weights: &Weights<'_>, config: &Config, precision: Precision) -> Result<Decoder, ModelError> {
        let (d, n) = (config.hidden_dim, config.tokens());
        let mut position = weights.vector("positional_embedding", &[1, 2 * n, d])?;
        let types = weights.read("cls_embedding", &[1, 2, d])?;
        for (half, kind) in position.chunks_exact_mut(n * d).zip(types.chunks_exact(d)) {
            half.chunks_exact_mut(d).for_each(|row| row.iter_mut().zip(kind).for_each(|(x, t)| *x += t));
        }
        let pe = "positional_encoding.pe";
        let condition_position = match weights.shape(pe) {
            Some(_) => {
                let [rows, _] = weights.shape_like(pe, [None, Some(d)])?;
                Table::Stored(weights.vector(pe, &[rows, d])?)
            }
            None => Table::Computed(sinusoid(if config.use_dino { USUAL_CONDITION } else { n }, d)),
        };
        let inner = weights.held_in(precision.of_blocks());
        let blocks = (0..config.decoder_layers)
            .map(|i| PairBlock::load(&inner.at(format_args!("transformer.resblocks.{i}")), d))
            .collect::<Result<_, _>>()?;
        let decoder = Decoder {
            position,
            condition_proj: Linear::load(weights, "condition_proj", d, config.condition_dim, Bias::No)?,
            condition_position,
            condition_ln: RmsNorm::load(weights, "condition_ln", d)?,
            layernorm1: RmsNorm::load(weights, "layernorm1", d)?,
            blocks,
            layernorm2: RmsNorm::load(weights, "layernorm2", d)?,
        };
        if !config.use_dino && decoder.longest_condition(d).is_some_and(|rows| rows < n) {
            return Err(ModelError::Shape {
                file: weights.file().to_owned(),
                tensor: weights.key(pe),
                expected: format!("[at least {n}, {d}]"),
                found: weights.shape(pe).unwrap_or_default().to_vec(),
            });
        }
        Ok(decoder)
    }

    /// Keeps the positions of these places in the grid of `config`, in this order.
    pub(crate) fn keep_positions(&mut self, places: &[usize], config: &Config) {
        let (d, n) = (config.hidden_dim, config.tokens());
        let pair: Vec<usize> = places.iter().copied().chain(places.iter().map(|place| n + place)).collect();
        self.position = rows_of(&self.position, d, &pair);
        // A condition that is not the other frame's embedding has a grid of its own.
        if !config.use_dino {
            self.condition_position = Table::Stored(rows_of(&self.condition_positions(n), d, places));
        }
    }

    /// The most tokens a condition may have, if there is a bound.
    pub(crate) fn longest_condition(&self, d: usize) -> Option<usize> {
        match &self.condition_position {
            Table::Stored(table) => Some(table.len() / d),
            Table::Computed(_) => None,
        }
    }

    /// Projects the tokens `at` (`None`: all) of a condition of `m` tokens, whose rows are `features [_, C]`, for
    /// attention.
    fn condition(&self, level: Level, features: &[f32], at: Option<&[u32]>, m: usize) -> Vec<f32> {
        let d = self.condition_proj.n();
        let mut projected = vec![0.0; features.len() / self.condition_proj.k() * d];
        self.condition_proj.apply(level, features, &mut projected);
        let positions = self.condition_positions(m);
        match at {
            None => add(&mut projected, &positions[..m * d]),
            Some(at) => {
                for (row, x) in at.iter().zip(projected.chunks_exact_mut(d)) {
                    x.iter_mut().zip(&positions[*row as usize * d..]).for_each(|(x, p)| *x += p);
                }
            }
        }
        self.condition_ln.of(level, &projected)
    }

    /// Position codes of at least `m` tokens of a condition.
    fn condition_positions(&self, m: usize) -> Cow<'_, [f32]> {
        let d = self.condition_proj.n();
        match &self.condition_position {
            Table::Stored(table) | Table::Computed(table) if m * d <= table.len() => Cow::Borrowed(table),
            _ => Cow::Owned(sinusoid(m, d)),
        }
    }

    /// `[d_a, d_b]`, each `[N, D]`, from the embeddings and features of frames a and b; `moves`: see [`Pass::begin`].
    pub(crate) fn apply(
        &self,
        level: Level,
        config: &Config,
        (h, features): ([&[f32]; 2], [&[f32]; 2]),
        (cache, moves): (Option<&mut PartCache>, bool),
        work: &mut Workspace,
    ) -> [Vec<f32>; 2] {
        let (n, d) = (config.tokens(), config.hidden_dim);
        let mut entered = h.concat();
        add(&mut entered, &self.position);
        let entered = self.layernorm1.of(level, &entered);
        let (mut pass, mut rows) = Pass::begin(level, cache, moves, &entered, std::mem::take(&mut work.tokens));
        // Each frame is conditioned on the other.
        let conditions = [0, 1].map(|side| {
            let (features, c) = (features[1 - side], config.condition_dim);
            let at = pass.condition(side, features, &rows);
            let m = features.len() / c;
            let condition = match &at {
                None => self.condition(level, features, None, m),
                Some(at) => {
                    let mut some = vec![0.0; at.len() * c];
                    gather(at, features, c, &mut some);
                    self.condition(level, &some, Some(at), m)
                }
            };
            (at, condition)
        });
        for (i, block) in self.blocks.iter().enumerate() {
            let windows = windows(config.encoder_window, i);
            let mut kept = pass.admit(i, block.self_attn.as_ref().map(|_| windows), &mut rows);
            let Rows { at, x } = &mut rows;
            let own = kept.as_deref_mut().map(|kept| &mut kept.own);
            match &block.self_attn {
                Some(self_attn) => self_attn.accumulate(level, windows, at.as_deref(), x, own, work),
                None => add_zero(x),
            }
            match &block.cross_attn {
                Some(cross_attn) => {
                    let earlier = at.as_ref().map_or(n, |at| at.partition_point(|token| (*token as usize) < n));
                    let (earlier, later) = x.split_at_mut(earlier * d);
                    let mut memory = std::mem::take(&mut work.keys_values);
                    for (side, x) in [earlier, later].into_iter().enumerate() {
                        let (at, condition) = &conditions[side];
                        let new = sized(&mut memory, 2 * condition.len());
                        cross_attn.keys_values(level, condition, new);
                        let keys_values = match kept.as_deref_mut() {
                            None => new,
                            Some(kept) => {
                                keep_heads(at.as_deref(), new, HEAD, &mut kept.cross[side]);
                                &mut kept.cross[side]
                            }
                        };
                        cross_attn.accumulate(level, keys_values, x, work);
                    }
                    work.keys_values = memory;
                }
                None => add_zero(x),
            }
            block.feed_forward(level, x);
        }
        let mut first = pass.finish(rows.at, self.layernorm2.of(level, &rows.x));
        work.tokens = rows.x;
        let second = first.split_off(n * d);
        [first, second]
    }

    pub(crate) fn bytes(&self) -> usize {
        let (Table::Stored(table) | Table::Computed(table)) = &self.condition_position;
        let norms = self.condition_ln.bytes() + self.layernorm1.bytes() + self.layernorm2.bytes();
        let tables = 4 * (self.position.len() + table.len());
        self.condition_proj.bytes() + norms + tables + self.blocks.iter().map(PairBlock::bytes).sum::<usize>()
    }
}

impl PairBlock {
    fn load(weights: &Weights<'_>, d: usize) -> Result<PairBlock, ModelError> {
        Ok(PairBlock {
            self_attn: SelfAttention::load(weights, "self_attn_ln", "self_attn", d)?,
            cross_attn: CrossAttention::load(weights, "cross_attn_ln", "cross_attn", d)?,
            mlp: FeedForward::load(weights, "mlp_ln", "mlp", d)?,
        })
    }

    /// The last branch.
    pub(crate) fn feed_forward(&self, level: Level, x: &mut [f32]) {
        match &self.mlp {
            Some(mlp) => mlp.accumulate(level, false, x),
            None => add_zero(x),
        }
    }

    fn bytes(&self) -> usize {
        self.self_attn.as_ref().map_or(0, SelfAttention::bytes)
            + self.cross_attn.as_ref().map_or(0, CrossAttention::bytes)
            + self.mlp.as_ref().map_or(0, FeedForward::bytes)
    }
}
