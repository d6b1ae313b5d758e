//! Written files, with notes on the content of a scene that is lost.

use super::Order;
use crate::still::{Defect, Still};

/// Choices that a format leaves to its writer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Version of SPZ files.
    pub spz: SpzVersion,
}

/// Versions of SPZ that are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpzVersion {
    /// One gzip stream, which most viewers open.
    #[default]
    V3,
    /// A zstd frame for each attribute, with extension records.
    V4,
}

/// A file, and notes on the content of the scene that is lost.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Written {
    /// Its bytes.
    pub bytes: Vec<u8>,
    /// Notes on content that was left out, moved, or lost beyond the format's usual precision, a line each.
    pub notes: Vec<String>,
}

impl Written {
    /// Returns a file that holds everything that its format can.
    pub(super) fn of(bytes: Vec<u8>) -> Written {
        Written { bytes, notes: Vec::new() }
    }
}

/// Notes on lost content.
pub(super) struct Notes(pub(super) Vec<String>);

impl Notes {
    /// Returns notes on the Gaussians that are not in `order` and so are left out.
    pub(super) fn of(still: &Still, order: &Order) -> Notes {
        let mut notes = Notes(Vec::new());
        let left = still.len() - order.places.len();
        if left > 0 {
            let not_turned = (0..still.len()).filter(|i| still.defect(*i) == Some(Defect::NoRotation)).count();
            let why = [(left - not_turned, "with numbers that are not finite"), (not_turned, "without a rotation")];
            let why: Vec<String> =
                why.iter().filter(|(count, _)| *count > 0).map(|(count, why)| format!("{count} {why}")).collect();
            notes.0.push(format!("{left} of {} Gaussians left out: {}", still.len(), why.join(", ")));
        }
        notes
    }

    /// Adds a note that `count` of `all` were changed, if any were.
    pub(super) fn changed(&mut self, count: usize, all: usize, what: &str) {
        if count > 0 {
            self.0.push(format!("{count} of {all} Gaussians {what}"));
        }
    }

    /// Adds a note that the mark of anti-aliased training is lost, if the scene has it.
    pub(super) fn without_mark(&mut self, still: &Still, format: &str) {
        if still.about.antialiased {
            self.0.push(format!("{format} has no mark for scenes trained with anti-aliasing: draw this one with it"));
        }
    }

    /// Adds a note on the treatment of the scene's offset, if there is one.
    pub(super) fn offset(&mut self, offset: [f64; 3], what: &str) {
        if offset != [0.0; 3] {
            let [x, y, z] = offset;
            self.0.push(format!("coordinates are relative to ({x}, {y}, {z}), {what}"));
        }
    }
}
