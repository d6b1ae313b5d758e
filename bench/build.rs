//! Passes build information to the program: the compiler, and settings of the release profile that are not the
//! workspace's own.

use std::process::Command;

/// Settings that change the generated code, and their defaults.
const SETTINGS: [(&str, &str); 6] = [
    ("CARGO_ENCODED_RUSTFLAGS", ""),
    ("CARGO_INCREMENTAL", "0"),
    ("CARGO_PROFILE_RELEASE_CODEGEN_UNITS", ""),
    ("CARGO_PROFILE_RELEASE_LTO", ""),
    ("CARGO_PROFILE_RELEASE_OPT_LEVEL", ""),
    ("PROFILE", "release"),
];

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let compiler = std::env::var("RUSTC").unwrap_or_else(|_| "rustc".to_owned());
    let output = Command::new(compiler).arg("--version").output();
    let mut built = output.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned()).unwrap_or_default();
    for (name, usual) in SETTINGS {
        println!("cargo::rerun-if-env-changed={name}");
        match std::env::var(name) {
            Ok(value) if value != usual => built += &format!(", {name}={}", value.replace('\u{1f}', " ")),
            _ => {}
        }
    }
    println!("cargo::rustc-env=BUILT_BY={built}");
}
