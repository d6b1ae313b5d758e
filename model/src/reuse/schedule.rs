//! Decides when a part computes only changed tokens.

use super::{Cache, Saving};

/// Extent of a part's computation in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Extent {
    /// Everything, and only the input is kept.
    Plain,
    /// Everything, and everything is kept.
    Refresh,
    /// Tokens that changed.
    Changed,
}

/// Decides between the extents.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Schedule {
    /// True if there is an input to compare with.
    seen: bool,
    /// True if everything is kept.
    kept: bool,
    /// Steps since everything was computed.
    age: u32,
    /// Tokens computed one by one since then.
    replaced: usize,
}

impl Schedule {
    /// Returns true if there is an input to compare with.
    pub(super) fn has_seen(&self) -> bool {
        self.seen
    }

    /// Returns true if too much changed for anything to be kept.
    pub(super) fn moves(&self) -> bool {
        self.seen && !self.kept
    }

    /// Returns the extent of a step in which `changed` of `all` tokens changed since they were last kept. In the first
    /// step the only evidence is whether the picture `moves`; if so, savings are unlikely.
    pub(super) fn next(&mut self, saving: Saving, moves: bool, changed: usize, all: usize) -> Extent {
        let extent = if !self.seen {
            if moves { Extent::Plain } else { Extent::Refresh }
        } else if changed as f64 > Cache::MOST * all as f64 {
            Extent::Plain
        } else if !self.kept {
            Extent::Refresh
        } else if saving == Saving::Exact {
            // Exact results need no refresh.
            Extent::Changed
        } else if self.age + 1 >= Cache::REFRESH || self.replaced + changed > Cache::REPLACED * all {
            Extent::Refresh
        } else {
            Extent::Changed
        };
        self.seen = true;
        self.kept = extent != Extent::Plain;
        (self.age, self.replaced) = match extent {
            Extent::Changed => (self.age + 1, self.replaced + changed),
            _ => (0, 0),
        };
        extent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_still_stream_is_refreshed_now_and_then_and_a_moving_one_keeps_nothing() {
        let within = Saving::Within(0.1);
        let mut still = Schedule::default();
        let extents: Vec<Extent> = (0..100).map(|_| still.next(within, false, 1, 100)).collect();
        let refreshes: Vec<usize> = (0..100).filter(|i| extents[*i] == Extent::Refresh).collect();
        assert_eq!(refreshes, [0, 48, 96]);
        let mut busy = Schedule::default();
        let extents: Vec<Extent> = (0..30).map(|_| busy.next(within, false, 50, 100)).collect();
        let refreshes: Vec<usize> = (0..30).filter(|i| extents[*i] == Extent::Refresh).collect();
        assert_eq!(refreshes, [0, 13, 26]);
        let mut moving = Schedule::default();
        let shares = [100, 90, 70, 10, 10, 80, 10];
        let extents: Vec<Extent> = shares.into_iter().map(|n| moving.next(within, false, n, 100)).collect();
        use Extent::{Changed, Plain, Refresh};
        assert_eq!(extents, [Refresh, Plain, Plain, Refresh, Changed, Plain, Refresh]);
        assert!(!still.moves() && !moving.moves() && !Schedule::default().moves());
        let mut late = Schedule::default();
        let extents: Vec<Extent> = [100, 70, 10, 10].map(|n| late.next(within, true, n, 100)).to_vec();
        assert_eq!(extents, [Plain, Plain, Refresh, Changed]);
        let mut exact = Schedule::default();
        let extents: Vec<Extent> = (0..100).map(|_| exact.next(Saving::Exact, false, 50, 100)).collect();
        assert!(extents[1..].iter().all(|extent| *extent == Changed));
    }
}
