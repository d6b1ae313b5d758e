//! Selection of the Gaussians that a format can hold, and their order.

use crate::space::along_curve;
use crate::still::Still;

/// The Gaussians that can be drawn ([`Still::defect`]).
pub(super) struct Order {
    /// Their indices in the scene.
    pub(super) places: Vec<usize>,
}

impl Order {
    /// Returns the order of the scene.
    pub(super) fn own(still: &Still) -> Order {
        Order { places: (0..still.len()).filter(|i| still.defect(*i).is_none()).collect() }
    }

    /// Returns the order along a Z-order curve through the centres: neighbours in space are neighbours in the file.
    pub(super) fn along_curve(still: &Still) -> Order {
        Order { places: along_curve(&still.mean, Self::own(still).places) }
    }
}
