//! Motion of Gaussians taken from optical flow.
//!
//! A Gaussian of a key frame starts at its centre and follows the flow from frame to frame ([`follow`], in pixels at
//! the model's size). Its velocity is that of the straight line that best fits its places, in world units: `v_x·2/W`,
//! `−v_z·2/H`. The velocity along the depth is the network's, and so is the whole velocity where a Gaussian's place is
//! not finite.
//!
//! A chain of several steps ends before the first one that leaves the picture or that the flow back does not undo,
//! because the surface is hidden there. Where that is the first step, the network's motion stays. (A single step, from
//! key frame to key frame, is taken as it is: the network's motion was no better.) Where the frames in between do not
//! show a Gaussian's place along its velocity, that of a neighbour or a small change may fit better ([`align`]).

use std::sync::Arc;

use rayon::prelude::*;
use streamsplat_kernels::Level;
use streamsplat_kernels::flow::{Lumas, Step, align, follow};

use super::reconstructor::Motion;

/// Gaussians per task.
const CHUNK: usize = 4096;

/// γ of all Gaussians with [`Fade::Fixed`](super::Fade::Fixed): half of their opacity is left at half time, 3 % at the
/// other key frame ([`opacity_factor`](streamsplat_model::motion::opacity_factor)). Found on clips that train the
/// embedded model, where its error equals that of the network's own γ.
const FIXED: [f32; 2] = [7.0, 0.5];

/// Motion where the network's is unknown: no velocity, and [`FIXED`] γ.
pub(super) fn fixed(counts: [usize; 2]) -> [Arc<Motion>; 2] {
    [0, 1].map(|side| Arc::new((vec![[0.0; 3]; counts[side]], vec![FIXED; counts[side]])))
}

/// The network's motion, extended to `count` Gaussians: the added ones do not move and fade as [`FIXED`].
pub(super) fn completed(motion: Arc<Motion>, count: usize) -> Arc<Motion> {
    if motion.0.len() == count {
        return motion;
    }
    let mut motion = Arc::unwrap_or_clone(motion);
    motion.0.resize(count, [0.0; 3]);
    motion.1.resize(count, FIXED);
    Arc::new(motion)
}

/// Velocities of Gaussians at these places along `steps`, the first of which starts at the key frame. `lumas`: of that
/// frame and those in between, in the order of the steps. `sign` is 1 for the interval's first key frame and −1 for its
/// last. γ and the velocity along the depth are those of `network`.
pub(super) fn along_flow(
    level: Level,
    positions: &[[f32; 3]],
    network: &Arc<Motion>,
    steps: &[Step<'_>],
    lumas: Lumas<'_>,
    sign: f32,
) -> Arc<Motion> {
    let Some(first) = steps.first() else { return network.clone() };
    let [height, width] = first.there.size.map(|side| side as f32);
    let place = |&[x, _, z]: &[f32; 3]| [((x + 1.0) * width - 1.0) * 0.5, ((1.0 - z) * height - 1.0) * 0.5];
    let starts: Vec<[f32; 2]> = positions.par_iter().with_min_len(CHUNK).map(place).collect();
    let mut pixels = vec![[0.0; 2]; starts.len()];
    follow(level, &starts, steps, &mut pixels);
    align(level, lumas, &starts, steps, &mut pixels);
    let mut velocity = network.0.clone();
    velocity.par_iter_mut().with_min_len(CHUNK).zip(&pixels).for_each(|(velocity, &[dx, dy])| {
        if !(dx.is_nan() || dy.is_nan()) {
            (velocity[0], velocity[2]) = (sign * dx * 2.0 / width, sign * -dy * 2.0 / height);
        }
    });
    Arc::new((velocity, network.1.clone()))
}
