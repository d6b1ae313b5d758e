//! The short form of the long stream, in a process of its own: its memory is what is looked at.

use std::process::{Command, Output};

fn soak(key_frames: &str) -> Output {
    // Times mean little beside other tests; the long form is for them.
    let options = ["soak", "--slowdown", "3", "--key-frames", key_frames];
    Command::new(env!("CARGO_BIN_EXE_streamsplat-bench")).args(options).output().expect("the program starts")
}

#[test]
fn a_short_soak_holds() {
    let output = soak("300");
    let said = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
    assert!(output.status.success() && said.matches("| holds |").count() == 4, "{said}");
    assert!(!soak("299").status.success());
}
