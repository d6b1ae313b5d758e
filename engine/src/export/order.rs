//! The Gaussians of a still scene that a format can hold, and their order.

use crate::space::along_curve;
use crate::still::Still;

/// The Gaussians that can be drawn ([`Still::defect`]).
pub(super) struct Order {
    /// Their places in the scene.
    pub(super) places: Vec<usize>,
}

impl Order {
    /// In the order of the scene.
    pub(super) fn own(still: &Still) -> Order {
        Order { places: (0..still.len()).filter(|i| still.defect(*i).is_none()).collect() }
    }

    /// Along a Z-order curve through their centres: neighbours in space are neighbours in the file.
    pub(super) fn along_curve(still: &Still) -> Order {
        Order { places: along_curve(&still.mean, Self::own(still).places) }
    }
}
