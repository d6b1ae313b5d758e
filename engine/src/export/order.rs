//! Which Gaussians of a still scene a format can hold, and in which order.

use crate::space::along_curve;
use crate::still::Still;

/// The Gaussians without a number that is not finite and with a rotation.
pub(super) struct Order {
    /// Their places in the scene.
    pub(super) places: Vec<usize>,
}

impl Order {
    /// As they stand in the scene.
    pub(super) fn own(still: &Still) -> Order {
        Order { places: (0..still.len()).filter(|i| is_sound(still, *i)).collect() }
    }

    /// Along a Z-order curve through their centres: neighbours in space are neighbours in the file.
    pub(super) fn along_curve(still: &Still) -> Order {
        Order { places: along_curve(&still.mean, Self::own(still).places) }
    }
}

fn is_sound(still: &Still, i: usize) -> bool {
    let finite = |v: &[f32]| v.iter().all(|x| x.is_finite());
    let width = 3 * still.rest();
    finite(&still.mean[i])
        && finite(&still.log_scale[i])
        && finite(&[still.logit[i]])
        && finite(&still.base[i])
        && finite(&still.higher[i * width..(i + 1) * width])
        && finite(&still.rotation[i])
        && still.rotation[i] != [0.0; 4]
}
