//! When a part computes only what changed.

use super::{Memory, Saving};

/// Extent of a part's computation in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pass {
    /// Everything, and nothing is kept but the input.
    Plain,
    /// Everything, and all of it is kept.
    Refresh,
    /// Tokens that changed.
    Changed,
}

/// Decides between them.
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

    /// The step in which `changed` of `all` tokens changed since they were last kept. In the first one nothing is known of them but whether
    /// the picture `moves`: then there is little hope.
    pub(super) fn next(&mut self, saving: Saving, moves: bool, changed: usize, all: usize) -> Pass {
        let pass = if !self.seen {
            if moves { Pass::Plain } else { Pass::Refresh }
        } else if changed as f64 > Memory::MOST * all as f64 {
            Pass::Plain
        } else if !self.kept {
            Pass::Refresh
        } else if saving == Saving::Exact {
            // Nothing wears off.
            Pass::Changed
        } else if self.age + 1 >= Memory::REFRESH || self.replaced + changed > Memory::REPLACED * all {
            Pass::Refresh
        } else {
            Pass::Changed
        };
        self.seen = true;
        self.kept = pass != Pass::Plain;
        (self.age, self.replaced) = match pass {
            Pass::Changed => (self.age + 1, self.replaced + changed),
            _ => (0, 0),
        };
        pass
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_still_stream_is_refreshed_now_and_then_and_a_moving_one_keeps_nothing() {
        let within = Saving::Within(0.1);
        let mut still = Schedule::default();
        let passes: Vec<Pass> = (0..100).map(|_| still.next(within, false, 1, 100)).collect();
        let refreshes: Vec<usize> = (0..100).filter(|i| passes[*i] == Pass::Refresh).collect();
        assert_eq!(refreshes, [0, 48, 96]);
        let mut busy = Schedule::default();
        let passes: Vec<Pass> = (0..30).map(|_| busy.next(within, false, 50, 100)).collect();
        let refreshes: Vec<usize> = (0..30).filter(|i| passes[*i] == Pass::Refresh).collect();
        assert_eq!(refreshes, [0, 13, 26]);
        let mut moving = Schedule::default();
        let shares = [100, 90, 70, 10, 10, 80, 10];
        let passes: Vec<Pass> = shares.into_iter().map(|n| moving.next(within, false, n, 100)).collect();
        use Pass::{Changed, Plain, Refresh};
        assert_eq!(passes, [Refresh, Plain, Plain, Refresh, Changed, Plain, Refresh]);
        assert!(!still.moves() && !moving.moves() && !Schedule::default().moves());
        let mut late = Schedule::default();
        let passes: Vec<Pass> = [100, 70, 10, 10].map(|n| late.next(within, true, n, 100)).to_vec();
        assert_eq!(passes, [Plain, Plain, Refresh, Changed]);
        let mut exact = Schedule::default();
        let passes: Vec<Pass> = (0..100).map(|_| exact.next(Saving::Exact, false, 50, 100)).collect();
        assert!(passes[1..].iter().all(|pass| *pass == Changed));
    }
}
