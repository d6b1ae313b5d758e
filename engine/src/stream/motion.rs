//! Motion of Gaussians taken from optical flow.
//!
//! A Gaussian of a key frame starts at its centre `p₀` (pixels at the model's size) and follows the flow from frame to frame, `p_k = p_{k−1} + F_k(p_{k−1})`, bilinearly between pixels.
//! With `s_k` the k-th frame's distance in time from the key frame (1 for the other key frame) its velocity is the line of least squares through the places,
//!
//! ```text
//! v = Σ s_k·(p_k − p₀) / Σ s_k²          k ascending, in binary32
//! ```
//!
//! in world units: `v_x·2/W`, `−v_z·2/H`. The velocity along the depth stays the network's, and so does all of it where a Gaussian's place is not finite.

use std::sync::Arc;

use rayon::prelude::*;
use streamsplat_kernels::flow::Field;
use streamsplat_model::StaticGaussians;

use super::reconstructor::Motion;

/// Gaussians per task.
const CHUNK: usize = 1024;

/// From one frame to the next, seen from a key frame.
#[derive(Clone, Copy)]
pub(super) struct Step<'a> {
    /// Towards the next frame.
    pub(super) there: &'a Field,
    /// The next frame's distance in time from the key frame, in intervals: positive.
    pub(super) distance: f32,
}

/// Velocities of a key frame's Gaussians along `steps`, whose first leaves from the key frame; `sign` is 1 for the interval's first key frame and −1 for its last. γ and the velocity
/// along the depth are those of `network`.
pub(super) fn along_flow(
    gaussians: &StaticGaussians,
    network: &Arc<Motion>,
    steps: &[Step<'_>],
    sign: f32,
) -> Arc<Motion> {
    let Some(first) = steps.first() else { return network.clone() };
    let [height, width] = first.there.size.map(|side| side as f32);
    let mut velocity = network.0.clone();
    velocity.par_chunks_mut(CHUNK).zip(gaussians.position.par_chunks(CHUNK)).for_each(|(velocity, position)| {
        for (v, &[x, _, z]) in velocity.iter_mut().zip(position) {
            let start = [((x + 1.0) * width - 1.0) * 0.5, ((1.0 - z) * height - 1.0) * 0.5];
            if !start.iter().all(|c| c.is_finite()) {
                continue;
            }
            let [mut at, mut num, mut den] = [start, [0.0; 2], [0.0; 2]];
            for step in steps {
                let [u, w] = step.there.at(at[0], at[1]);
                at = [at[0] + u, at[1] + w];
                num = [0, 1].map(|axis| step.distance.mul_add(at[axis] - start[axis], num[axis]));
                den[0] = step.distance.mul_add(step.distance, den[0]);
            }
            let [dx, dy] = num.map(|n| sign * n / den[0]);
            (v[0], v[2]) = (dx * 2.0 / width, -dy * 2.0 / height);
        }
    });
    Arc::new((velocity, network.1.clone()))
}
