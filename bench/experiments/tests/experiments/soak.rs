//! The short form of the long stream, in a process of its own, as its memory is measured.

use std::process::{Command, Output};

fn soak(options: &[&str]) -> Output {
    // Such a small process keeps some more pages, and times vary more during other tests; live memory is the same
    // everywhere.
    Command::new(env!("CARGO_BIN_EXE_streamsplat-experiments"))
        .args(["soak", "--resident", "1.1", "--slowdown", "1.25", "--key-frames"])
        .args(options)
        .output()
        .expect("the program starts")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn a_short_soak_holds() {
    let output = soak(&["500"]);
    assert!(output.status.success(), "{}", said(&output));
    assert_eq!(said(&output).matches("| holds |").count(), 5);
    assert!(!soak(&["300"]).status.success());
}

#[test]
fn a_stream_that_loses_memory_fails() {
    let output = soak(&["400", "--leak", "2000"]);
    assert!(!output.status.success());
    let text = said(&output);
    let live = text.lines().find(|line| line.contains("live memory")).unwrap_or_else(|| panic!("{text}"));
    assert!(live.ends_with("FAILS |"), "{text}");
}
