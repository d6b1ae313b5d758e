//! The golden images, as a Rust test.

use std::path::Path;
use std::process::Command;

#[test]
fn renders_are_their_golden_images() {
    let program = std::env::var_os("STREAMSPLAT").unwrap_or_else(|| "streamsplat".into());
    let list = Path::new(env!("CARGO_MANIFEST_DIR")).join("../renders.toml");
    let failed = Path::new(env!("CARGO_TARGET_TMPDIR")).join("golden-failed");
    let output = Command::new(program)
        .args(["golden", "check"])
        .arg(&list)
        .arg("--out")
        .arg(&failed)
        .output()
        .expect("streamsplat is installed, or STREAMSPLAT names it");
    assert!(
        output.status.success(),
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
}
