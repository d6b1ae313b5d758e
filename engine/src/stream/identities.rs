//! Identities: 64-bit, never reused.

/// Hands out identities in ascending order. 2⁶⁴ of them outlast any stream.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Identities {
    next: u64,
}

impl Identities {
    /// An identity nobody had before.
    pub(crate) fn fresh(&mut self) -> u64 {
        let identity = self.next;
        self.next += 1;
        identity
    }
}
