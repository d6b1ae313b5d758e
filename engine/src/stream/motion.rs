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
//!
//! A chain of several steps ends before the first one that leaves the picture or that the flow back does not undo, to within [`ASTRAY`] pixels and a tenth of the step's length: what was
//! hidden there is not followed any farther. Where that is the first step, the network's motion stays. (A single step, from key frame to key frame, is taken as it is: what the network says instead was
//! no better.)

use std::sync::Arc;

use rayon::prelude::*;
use streamsplat_kernels::flow::Field;

use super::reconstructor::Motion;

/// Gaussians per task.
const CHUNK: usize = 1024;
/// Pixels by which the flow back may miss where a step came from, beside a tenth of the step.
const ASTRAY: f32 = 2.0;

/// From one frame to the next, seen from a key frame.
#[derive(Clone, Copy)]
pub(super) struct Step<'a> {
    /// Towards the next frame.
    pub(super) there: &'a Field,
    /// Back from it.
    pub(super) back: &'a Field,
    /// The next frame's distance in time from the key frame, in intervals: positive.
    pub(super) distance: f32,
}

impl Step<'_> {
    /// Where the step leads to from `at`; `None` where it strays.
    pub(super) fn from(&self, at: [f32; 2]) -> Option<[f32; 2]> {
        let [u, v] = self.there.at(at[0], at[1]);
        let to = [at[0] + u, at[1] + v];
        (!self.strays([u, v], to)).then_some(to)
    }

    /// Returns true if the step by `[u, v]`, to `at`, leaves the picture or does not come back.
    fn strays(&self, [u, v]: [f32; 2], at: [f32; 2]) -> bool {
        let [height, width] = self.there.size.map(|side| side as f32);
        let inside = (-0.5..=width - 0.5).contains(&at[0]) && (-0.5..=height - 0.5).contains(&at[1]);
        let [back_u, back_v] = self.back.at(at[0], at[1]);
        let length = |x: f32, y: f32| x.mul_add(x, y * y).sqrt();
        !inside || length(u + back_u, v + back_v) > 0.1f32.mul_add(length(u, v), ASTRAY)
    }
}

/// γ of all Gaussians where they fade alike: half of their opacity is left at half time, 3 % at the other key frame
/// ([`opacity_factor`](streamsplat_model::motion::opacity_factor)). Found on clips that train the embedded model, where the error is that of the network's own γ.
const FIXED: [f32; 2] = [7.0, 0.5];

/// The motion of Gaussians of which only the count is known: none, and γ that is [`FIXED`].
pub(super) fn fixed(counts: [usize; 2]) -> [Arc<Motion>; 2] {
    [0, 1].map(|side| Arc::new((vec![[0.0; 3]; counts[side]], vec![FIXED; counts[side]])))
}

/// The motion of all of `count` Gaussians of which the network gives that of the first: the others stand still and fade as [`fixed`] has it.
pub(super) fn completed(motion: Arc<Motion>, count: usize) -> Arc<Motion> {
    if motion.0.len() == count {
        return motion;
    }
    let mut motion = Arc::unwrap_or_clone(motion);
    motion.0.resize(count, [0.0; 3]);
    motion.1.resize(count, FIXED);
    Arc::new(motion)
}

/// Velocities of Gaussians at these places along `steps`, whose first leaves from the key frame; `sign` is 1 for the interval's first key frame and −1 for its last. γ and the velocity
/// along the depth are those of `network`.
pub(super) fn along_flow(positions: &[[f32; 3]], network: &Arc<Motion>, steps: &[Step<'_>], sign: f32) -> Arc<Motion> {
    let Some(first) = steps.first() else { return network.clone() };
    let [height, width] = first.there.size.map(|side| side as f32);
    let mut velocity = network.0.clone();
    velocity.par_chunks_mut(CHUNK).zip(positions.par_chunks(CHUNK)).for_each(|(velocity, position)| {
        for (v, &[x, _, z]) in velocity.iter_mut().zip(position) {
            let start = [((x + 1.0) * width - 1.0) * 0.5, ((1.0 - z) * height - 1.0) * 0.5];
            if !start.iter().all(|c| c.is_finite()) {
                continue;
            }
            let (mut at, mut num, mut den) = (start, [0.0; 2], 0.0);
            for step in steps {
                let [u, w] = step.there.at(at[0], at[1]);
                at = [at[0] + u, at[1] + w];
                if steps.len() > 1 && step.strays([u, w], at) {
                    break;
                }
                num = [0, 1].map(|axis| step.distance.mul_add(at[axis] - start[axis], num[axis]));
                den = step.distance.mul_add(step.distance, den);
            }
            if den == 0.0 {
                continue;
            }
            let [dx, dy] = num.map(|n| sign * n / den);
            (v[0], v[2]) = (dx * 2.0 / width, -dy * 2.0 / height);
        }
    });
    Arc::new((velocity, network.1.clone()))
}
