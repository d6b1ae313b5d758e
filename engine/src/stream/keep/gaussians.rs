//! The Gaussians of kept blocks.

use streamsplat_model::StaticGaussians;

use super::Change;

/// The model's Gaussians, one per square of pixels.
#[derive(Debug)]
pub(in crate::stream) struct Lattice {
    pub(super) side: usize,
    pub(super) columns: usize,
    pub(super) count: usize,
}

impl Lattice {
    /// The lattice of `count` Gaussians on a picture of `[height, width]`; `None` where its cells are not squares of
    /// whole pixels.
    pub(in crate::stream) fn of(count: usize, [height, width]: [usize; 2]) -> Option<Self> {
        let side = (height * width).checked_div(count)?.isqrt();
        let whole = side > 0 && height.is_multiple_of(side) && width.is_multiple_of(side);
        (whole && (height / side) * (width / side) == count).then(|| Self { side, columns: width / side, count })
    }
}

/// What an interval keeps of the Gaussians of the key frame at its start. In the new key frame the model's own keep
/// their indices; kept [details](super::detail) follow them in their order, before new details.
#[derive(Debug, PartialEq)]
pub(in crate::stream) struct Keeps {
    /// What happens to each of them.
    pub(in crate::stream) changes: Vec<Change>,
    /// Number of the model's own.
    cells: usize,
    /// For each of the details the number of kept ones before it, and the number of all kept ones.
    before: Vec<usize>,
}

impl Keeps {
    /// `changes`: what happens to each Gaussian, of which the first `cells` are the model's own.
    pub(in crate::stream) fn new(changes: Vec<Change>, cells: usize) -> Self {
        let mut before = vec![0];
        for change in &changes[cells..] {
            before.push(before[before.len() - 1] + usize::from(*change != Change::All));
        }
        Self { changes, cells, before }
    }

    /// The index in the new frame of the Gaussian at this index of the frame before; `None` if it is not kept.
    pub(in crate::stream) fn index(&self, before: usize) -> Option<usize> {
        let place = || before.checked_sub(self.cells).map_or(before, |detail| self.cells + self.before[detail]);
        (self.changes[before] != Change::All).then(place)
    }

    /// Returns true if the Gaussian at this index of the new frame is kept from the frame before.
    pub(in crate::stream) fn holds(&self, now: usize) -> bool {
        match now.checked_sub(self.cells) {
            None => self.changes[now] != Change::All,
            Some(detail) => detail < self.details(),
        }
    }

    /// What happens to each of the model's own.
    pub(in crate::stream) fn of_own(&self) -> &[Change] {
        &self.changes[..self.cells]
    }

    /// Number of kept details.
    pub(in crate::stream) fn details(&self) -> usize {
        self.before[self.before.len() - 1]
    }

    /// What happened to each Gaussian of the new frame that is not a new detail.
    pub(in crate::stream) fn of_new(&self) -> impl Iterator<Item = Change> {
        let details = self.changes[self.cells..].iter().filter(|change| **change != Change::All);
        self.changes[..self.cells].iter().chain(details).copied()
    }
}

/// Replaces the kept ones of the model's own Gaussians by those of `before`, and adds its kept details.
pub(in crate::stream) fn with_kept(now: &mut StaticGaussians, before: &StaticGaussians, keeps: &Keeps) {
    for (cell, place) in (0..before.len()).filter_map(|cell| Some((cell, keeps.index(cell)?))) {
        match place < now.len() {
            true => now.set(place, before.get(cell)),
            false => now.push(before.get(cell)),
        }
    }
}
