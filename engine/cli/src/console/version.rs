//! Version, commit and instruction-set levels of this program.

use std::sync::LazyLock;

use streamsplat_kernels::Level;

/// Returns the commit that the program was built from, if known.
pub fn commit() -> Option<&'static str> {
    Some(env!("STREAMSPLAT_COMMIT")).filter(|commit| *commit != "unknown")
}

/// Returns the version text: `0.1.0 (commit), levels scalar avx2 (in use: avx2)`.
pub fn version() -> &'static str {
    static TEXT: LazyLock<String> = LazyLock::new(|| {
        let levels: Vec<&str> = Level::available().into_iter().map(|level| level.name()).collect();
        let (version, commit) = (env!("CARGO_PKG_VERSION"), env!("STREAMSPLAT_COMMIT"));
        format!(
            "{version} ({commit}), levels of this machine: {}; in use: {}",
            levels.join(" "),
            Level::detect().name()
        )
    });
    &TEXT
}
