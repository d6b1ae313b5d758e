//! Configurations to run.

use super::Reason;

/// The paper's method: one pass of the network at its own size.
const PAPER: &str = "--resolution native --motion network --refine 0";

/// One option after the other.
const STEPS: [(&str, &str); 11] = [
    ("the paper's way: one pass at the model's own size, the network's motion and colours", PAPER),
    ("+ resolution: four times the area, in tiles", "--motion network --refine 0"),
    ("+ motion: optical flow between the key frames", "--motion frames --refine 0 --fade network --depth none"),
    ("+ fading: all alike, nothing of the dynamic half is computed", "--motion frames --refine 0 --depth none"),
    ("+ colours: 4 steps", "--motion frames --refine 4 --detail 0 --depth none"),
    ("+ colours: the default's 6 steps at most, details", "--motion frames --depth none"),
    ("+ depth: found by parallax", "--motion frames"),
    ("seen, motion through the frames between, no colours", "--seen --refine 0 --depth none"),
    ("seen, + colours: 4 steps", "--seen --refine 4 --detail 0 --depth none"),
    ("seen, + colours: the default's 6 steps at most, details", "--seen --depth none"),
    ("seen, + depth: found by parallax", "--seen"),
];
/// What the default leaves out or adds, each turned off alone. The last step is the default at that gap.
const PARTS: [(&str, &str); 8] = [
    ("static regions computed for each key frame: `--still off`", "--still off"),
    ("colours fitted also where images are close: `--refine-to 100`", "--refine-to 100"),
    ("nothing taken from what was computed before: `--reuse off`", "--reuse off"),
    ("no details: `--detail 0`", "--detail 0"),
    ("nothing behind foreground objects: `--behind off`", "--behind off"),
    ("colours from every second frame: `--refine-every 2`", "--refine-every 2"),
    ("coarse flow: `--flow coarse`", "--flow coarse"),
    ("the network in f32: `--precision f32`", "--precision f32"),
];
/// From the fastest to the closest.
const QUALITIES: [(&str, &str); 3] =
    [("realtime", "gap 6"), ("balanced", "gap auto:3-8:38, the default"), ("best", "gap 2")];
/// Gaps of the grid.
const GAPS: [&str; 5] = ["2", "3", "5", "8", "auto:3-8:38"];
const CHOICES: [&str; 3] =
    ["--flow coarse --refine 3 --refine-every 3 --depth none", "--flow coarse --refine 6 --depth none", "--refine 16"];
const UNSEEN_GAPS: [usize; 2] = [5, 8];

/// Names, kinds and arguments of all rows.
pub(super) fn all() -> Vec<(String, Reason, Vec<String>)> {
    let words = |text: &str| -> Vec<String> { text.split_whitespace().map(str::to_owned).collect() };
    let mut rows = Vec::new();
    for (name, arguments) in STEPS {
        rows.push((name.to_owned(), Reason::Step, words(&format!("{arguments} --gap 5"))));
    }
    for (name, arguments) in PARTS {
        rows.push((format!("the same, {name}"), Reason::Part, words(&format!("--seen {arguments} --gap 5"))));
    }
    for (name, gap) in QUALITIES {
        let row = format!("seen, `--quality {name}`: {gap}");
        rows.push((row, Reason::Quality, words(&format!("--seen --quality {name}"))));
    }
    for (name, gap) in QUALITIES {
        rows.push((format!("`--quality {name}`: {gap}"), Reason::Quality, words(&format!("--quality {name}"))));
    }
    let grid = |rows: &mut Vec<_>, arguments: String| rows.push((arguments.clone(), Reason::Grid, words(&arguments)));
    for gap in GAPS {
        for choice in CHOICES {
            grid(&mut rows, format!("--seen --gap {gap} {choice}"));
        }
    }
    for gap in UNSEEN_GAPS {
        for choice in &CHOICES[..1] {
            grid(&mut rows, format!("--gap {gap} {choice}"));
        }
    }
    rows
}
