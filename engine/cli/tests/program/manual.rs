//! Descriptions of the program: version, completions, manual pages.

use crate::support::{Scratch, run};

fn said(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("text")
}

#[test]
fn the_version_names_the_commit_and_the_levels() {
    let text = said(&["--version"]);
    assert!(text.starts_with(&format!("streamsplat {} (", env!("CARGO_PKG_VERSION"))), "{text}");
    let commit = text.split(['(', ')']).nth(1).expect("a commit");
    assert!(commit == "unknown" || commit.len() >= 12, "{text}");
    assert!(text.contains("levels of this machine: scalar") && text.trim_end().lines().count() == 1, "{text}");
}

#[test]
fn every_shell_has_completions_of_every_command() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let text = said(&["completions", shell]);
        for word in ["run", "render", "verify", "precision"] {
            assert!(text.contains(word), "{shell}: {word}");
        }
    }
    assert_eq!(run(["completions", "cmd"]).status.code(), Some(2));
}

#[test]
fn every_command_has_a_manual_page() {
    let scratch = Scratch::new();
    let folder = scratch.path("man");
    said(&["man", "--out", folder.to_str().expect("UTF-8")]);
    let whole = std::fs::read_to_string(folder.join("streamsplat.1")).expect("the first page");
    assert_eq!(whole, said(&["man"]));
    for line in
        said(&["--help"]).lines().skip_while(|l| !l.starts_with("Commands:")).skip(1).take_while(|l| !l.is_empty())
    {
        let Some(command) = line.strip_prefix("  ").and_then(|l| l.split_whitespace().next()) else { continue };
        if command == "help" || line.starts_with("   ") {
            continue;
        }
        let page = std::fs::read_to_string(folder.join(format!("streamsplat-{command}.1"))).expect(command);
        assert!(page.contains(".TH") && page.len() > 200, "{command}");
    }
}
