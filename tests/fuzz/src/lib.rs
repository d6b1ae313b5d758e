//! The entry point that libFuzzer calls: `streamsplat_tests::fuzz` processes the bytes.

pub use libfuzzer_sys;
pub use streamsplat_tests::fuzz::Target;

/// Fuzzes the target of this name.
#[macro_export]
macro_rules! target {
    ($name:literal) => {
        static TARGET: std::sync::LazyLock<&$crate::Target> =
            std::sync::LazyLock::new(|| $crate::Target::named($name).expect("a target"));
        $crate::libfuzzer_sys::fuzz_target!(|bytes: &[u8]| (TARGET.run)(bytes));
    };
}
