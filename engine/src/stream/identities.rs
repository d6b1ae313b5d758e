//! Identities: 64-bit, never reused.

/// Hands out identities in ascending order. 2⁶⁴ of them outlast any stream.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Identities {
    next: u64,
}

impl From<u64> for Identities {
    fn from(next: u64) -> Self {
        Self { next }
    }
}

impl Identities {
    /// The identity handed out next.
    pub(crate) fn next(&self) -> u64 {
        self.next
    }

    /// Returns a new identity.
    pub(crate) fn fresh(&mut self) -> u64 {
        let identity = self.next;
        self.next += 1;
        identity
    }
}
