//! The tiles of a key frame through the static half of the network.

use std::sync::Arc;

use rayon::prelude::*;
use streamsplat_model::{Embedding, FrameInput, Sampling, StaticGaussians};

use super::keyframe::{Features, KeyView, TileView};
use super::tiles::{Part, Tile, Tiles};
use super::work::Stage;
use super::{EngineError, SamplingMode, Settings, Work};

/// A key frame on its way through the network.
#[derive(Clone, Copy)]
pub(super) struct Pass<'a> {
    pub(super) settings: &'a Settings,
    /// The key frame before, where results of it may be reused.
    pub(super) before: Option<&'a KeyView>,
    /// `[3, H, W]`
    pub(super) rgb: &'a [f32],
    /// `[H, W]`, where the network reads it.
    pub(super) depth: Option<&'a [f32]>,
    pub(super) index: u64,
}

impl Pass<'_> {
    /// The results of all tiles, which are computed at the same time; `None` for those without a `wanted` cell (`None`:
    /// all are). The error is that of the first tile that has one.
    pub(super) fn tiles(
        self,
        Tiles { resolution, tiles, ignores_depth }: &mut Tiles,
        wanted: Option<&[bool]>,
        work: &mut Work,
    ) -> Result<Vec<Option<TileView>>, EngineError> {
        let (resolution, ignores_depth) = (*resolution, *ignores_depth);
        let results: Vec<(Result<Option<TileView>, EngineError>, Work)> = tiles
            .par_iter_mut()
            .with_max_len(1)
            .enumerate()
            .map(|(at, tile)| {
                let mut work = Work::default();
                let part = self.part(tile, wanted);
                if part != Part::Nothing {
                    let place = Place { at, resolution, ignores_depth };
                    return (self.tile(tile, part, place, &mut work).map(Some), work);
                }
                for stage in [Stage::Encoder, Stage::Upsampler, Stage::Condition, Stage::Heads] {
                    work.count(stage, 0, 1);
                }
                work.count(Stage::Patches, 0, tile.computed(&Part::Nothing)[1]);
                (Ok(None), work)
            })
            .collect();
        for (_, of_tile) in &results {
            work.add(of_tile);
        }
        results.into_iter().map(|(result, _)| result).collect()
    }

    /// What of a tile is computed to have the Gaussians of the `wanted` cells (`None`: all).
    fn part(self, tile: &Tile, wanted: Option<&[bool]>) -> Part {
        let part = tile.part(wanted);
        // The decoder reads all tokens; drawn positions depend on the number of Gaussians before them.
        let whole = self.settings.deforms() || self.draws(tile) || !tile.session.computes_parts();
        if whole && part != Part::Nothing { Part::Everything } else { part }
    }

    /// Returns true if the positions of a tile are drawn.
    fn draws(self, tile: &Tile) -> bool {
        self.settings.sampling != SamplingMode::Mean && tile.session.draws_positions()
    }

    /// Reconstructs `part` of a tile.
    fn tile(
        self,
        tile: &mut Tile,
        part: Part,
        Place { at, resolution, ignores_depth }: Place,
        work: &mut Work,
    ) -> Result<TileView, EngineError> {
        let Self { settings, rgb, depth, index, .. } = self;
        let same = |before: &&KeyView| {
            tile.sees_the_same(resolution, &before.rgb, rgb)
                && match (before.depth.as_deref().filter(|_| !ignores_depth), depth) {
                    (None, None) => true,
                    (Some(a), Some(b)) => tile.sees_the_same(resolution, a, b),
                    _ => false,
                }
        };
        let before = self.before.filter(same).and_then(|view| view.tiles[at].clone());
        let before = before.filter(|before| before.part.contains(&part));
        let draws = self.draws(tile);
        let sampling = match settings.sampling {
            SamplingMode::Mean => Sampling::Mean,
            // Each tile draws from its own random stream.
            SamplingMode::Sample => Sampling::Sample { seed: settings.seed ^ (at as u64) << 40, frame: index },
        };
        if let Some(before) = before {
            work.count(Stage::Encoder, 0, 1);
            work.count(Stage::Upsampler, 0, 1);
            work.count(Stage::Condition, 0, 1);
            work.count(Stage::Patches, 0, tile.computed(&Part::Nothing)[1]);
            if !draws {
                work.count(Stage::Heads, 0, 1);
                return Ok(before);
            }
            let gaussians = gaussians(tile, work, &before.features.tokens, sampling, index)?;
            return Ok(TileView { gaussians: Arc::new(gaussians), ..before });
        }
        let (rgb, depth) = (tile.cut(resolution, rgb), depth.map(|depth| tile.cut(resolution, depth)));
        let input = FrameInput { rgb: &rgb, depth: depth.as_deref() };
        let [done, avoided] = tile.computed(&part);
        work.count(Stage::Patches, done, avoided);
        if let Part::Patches(patches) = &part {
            let session = &mut tile.session;
            let embedding = work.measure(Stage::Encoder, || session.embed_part(&input, patches))?;
            let tokens = work.measure(Stage::Upsampler, || session.upsample_part(&embedding, patches))?;
            work.count(Stage::Condition, 0, 1);
            let gaussians = work.measure(Stage::Heads, || session.gaussians_part(&tokens, patches))?;
            let gaussians = Arc::new(even(gaussians, index)?);
            return Ok(TileView { features: Features::none(), gaussians, part });
        }
        let embedding = work.measure(Stage::Encoder, || tile.session.embed(&input))?;
        let tokens = work.measure(Stage::Upsampler, || tile.session.upsample(&embedding))?;
        // Only the decoder reads it.
        let condition = match settings.deforms() && tile.session.reads_condition() {
            true => work.measure(Stage::Condition, || tile.session.condition(&input))?,
            false => {
                work.count(Stage::Condition, 0, 1);
                None
            }
        };
        let gaussians = gaussians(tile, work, &tokens, sampling, index)?;
        // The next pair reads them; where positions are drawn, so does a frame that repeats this one.
        let pairs = settings.deforms();
        let features = Arc::new(Features {
            embedding: if pairs { embedding } else { Embedding { h: Vec::new() } },
            tokens: if pairs || draws { tokens } else { Vec::new() },
            condition,
        });
        Ok(TileView { features, gaussians: Arc::new(gaussians), part })
    }
}

/// A tile's number, and what it shares with the others.
#[derive(Clone, Copy)]
struct Place {
    at: usize,
    /// Rows and columns of pixels of the frame.
    resolution: [usize; 2],
    ignores_depth: bool,
}

/// The static head on a tile's tokens.
fn gaussians(
    tile: &mut Tile,
    work: &mut Work,
    tokens: &[f32],
    sampling: Sampling,
    index: u64,
) -> Result<StaticGaussians, EngineError> {
    even(work.measure(Stage::Heads, || tile.session.gaussians(tokens, &sampling))?, index)
}

/// Checks that a reconstructor's arrays have one length.
fn even(gaussians: StaticGaussians, index: u64) -> Result<StaticGaussians, EngineError> {
    match gaussians.uneven() {
        Some((what, found)) => Err(EngineError::Records { index, what, expected: gaussians.len(), found }),
        None => Ok(gaussians),
    }
}
