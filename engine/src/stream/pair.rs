//! The motion between two key frames from the dynamic half of the network, tile by tile.

use std::sync::Arc;

use streamsplat_model::Side;

use super::keyframe::{Features, KeyView};
use super::reconstructor::Motion;
use super::tiles::{Tile, Tiles};
use super::work::Stage;
use super::{EngineError, Work};

/// The motion of a pair of frames, and the inputs that it was computed from.
pub(super) struct Pair {
    tiles: Vec<TilePair>,
    /// The motion of both frames' Gaussians, in the frame's world.
    pub(super) motion: [Arc<Motion>; 2],
}

/// The same of one tile.
struct TilePair {
    frames: [Arc<Features>; 2],
    motion: [Arc<Motion>; 2],
}

impl Pair {
    /// The pair of key frames `a` and `b`, the later of which is key frame `index`. Tiles whose inputs are those of
    /// `last`, the pair before, keep its motion.
    pub(super) fn new(
        tiles: &mut Tiles,
        work: &mut Work,
        last: Option<&Pair>,
        [a, b]: [&KeyView; 2],
        index: u64,
    ) -> Result<Pair, EngineError> {
        let mut pairs = Vec::with_capacity(tiles.tiles.len());
        for (at, tile) in tiles.tiles.iter_mut().enumerate() {
            // Nothing is kept where the network moves Gaussians.
            let views = [a, b].map(|view| view.tiles[at].as_ref().expect("every tile is computed"));
            let frames = views.map(|view| view.features.clone());
            let last = last.map(|pair| &pair.tiles[at]);
            if let Some(last) = last
                && frames.iter().zip(&last.frames).all(|(now, then)| Arc::ptr_eq(now, then))
            {
                work.count(Stage::Decoder, 0, 1);
                work.count(Stage::Upsampler, 0, 2);
                work.count(Stage::Heads, 0, 2);
                pairs.push(TilePair { frames, motion: last.motion.clone() });
                continue;
            }
            let expected = views.map(|view| view.gaussians.position.len());
            let motion = deform(tile, work, &frames, expected, index)?;
            pairs.push(TilePair { frames, motion });
        }
        let motion = [0, 1].map(|side| {
            let of_tiles: Vec<_> = pairs.iter().map(|pair| pair.motion[side].clone()).collect();
            tiles.motion(&of_tiles)
        });
        Ok(Pair { tiles: pairs, motion })
    }

    /// Counts a pair whose motion is not needed.
    pub(super) fn leave_out(tiles: &Tiles, work: &mut Work) {
        let count = tiles.tiles.len() as u64;
        work.count(Stage::Decoder, 0, count);
        work.count(Stage::Upsampler, 0, 2 * count);
        work.count(Stage::Heads, 0, 2 * count);
    }
}

/// The motion of one tile between the frame before and this one.
fn deform(
    tile: &mut Tile,
    work: &mut Work,
    frames: &[Arc<Features>; 2],
    expected: [usize; 2],
    index: u64,
) -> Result<[Arc<Motion>; 2], EngineError> {
    let session = &mut tile.session;
    let sides = [&frames[0], &frames[1]].map(|f| Side {
        h: &f.embedding.h,
        static_tokens: &f.tokens,
        condition: f.condition.as_deref(),
    });
    let decoded = work.measure(Stage::Decoder, || session.decode(&sides[0], &sides[1]))?;
    let mut motion: [Motion; 2] = Default::default();
    for (side, d) in decoded.iter().enumerate() {
        let tokens = work.measure(Stage::Upsampler, || session.upsample_motion(side, d))?;
        motion[side] = work.measure(Stage::Heads, || session.motion(side, sides[side].static_tokens, &tokens))?;
        let expected = expected[side];
        for (what, found) in [("velocity", motion[side].0.len()), ("gamma", motion[side].1.len())] {
            if found != expected {
                return Err(EngineError::Records { index, what, expected, found });
            }
        }
    }
    Ok(motion.map(Arc::new))
}
