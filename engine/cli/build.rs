//! Passes the program the commit that it is built from: `STREAMSPLAT_COMMIT` if set, else git's output, else `unknown`.

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-env-changed=STREAMSPLAT_COMMIT");
    let commit = std::env::var("STREAMSPLAT_COMMIT").ok().filter(|given| !given.is_empty());
    let commit = commit.or_else(|| {
        // The log of HEAD grows with every commit and checkout.
        if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"])
            && Path::new(&log).exists()
        {
            println!("cargo::rerun-if-changed={log}");
        }
        git(&["rev-parse", "--short=12", "HEAD"])
    });
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-env=STREAMSPLAT_COMMIT={}", commit.as_deref().unwrap_or("unknown"));
}

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    let text = String::from_utf8(output.stdout).ok()?;
    Some(text.trim().to_owned()).filter(|text| !text.is_empty())
}
