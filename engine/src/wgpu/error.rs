//! Errors of drawing with a graphics card.

/// Error of drawing with a graphics card.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum WgpuError {
    /// There is no adapter.
    #[error(
        "expected a graphics card with a Vulkan driver, found none ({reason}); Mesa's software driver will do (Debian package mesa-vulkan-drivers)"
    )]
    NoAdapter {
        /// Message of the search.
        reason: String,
    },
    /// The adapter has no device.
    #[error("{adapter}: expected a device, found none: {reason}")]
    NoDevice {
        /// The adapter's name.
        adapter: String,
        /// Its message.
        reason: String,
    },
    /// The scene or the image does not fit one buffer of the adapter.
    #[error("{adapter}: {what}: expected at most {most} bytes, found {found}")]
    TooLarge {
        /// The adapter's name.
        adapter: String,
        /// The part that is too large.
        what: &'static str,
        /// Maximum bytes of a buffer.
        most: u64,
        /// Bytes needed.
        found: u64,
    },
    /// The device failed while drawing.
    #[error("{adapter}: the device failed: {reason}")]
    Failed {
        /// The adapter's name.
        adapter: String,
        /// Its message.
        reason: String,
    },
}
