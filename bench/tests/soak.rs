//! The short form of the long stream, in a process of its own: its memory is what is looked at.

use std::process::{Command, Output};

fn soak(key_frames: &str) -> Output {
    // Times mean little beside other tests; the long form is for them.
    let options = ["soak", "--slowdown", "3", "--key-frames", key_frames];
    Command::new(env!("CARGO_BIN_EXE_streamsplat-bench")).args(options).output().expect("the program starts")
}

#[test]
fn a_short_soak_holds() {
    // A process this small has not settled after fifty key frames, nor is it alone: its limits are wide.
    let said = String::from_utf8_lossy(&soak("300").stdout).into_owned();
    let rows: Vec<f64> = said.lines().filter_map(|line| line.split(" | ").nth(1)?.trim().parse().ok()).collect();
    assert_eq!(rows.len(), 4, "{said}");
    assert!(rows[0] < 1.2 && rows[1] < 3.0, "{said}");
    assert_eq!(rows[2..], [0.0, 0.0], "{said}");
    assert!(!soak("299").status.success());
}
