//! Metadata of a scene in the comments of a PLY header.
//!
//! | comment | meaning | written by |
//! |---|---|---|
//! | `SplatRenderMode: mip`, `default` or `2dgs` | trained with anti-aliasing, or without | Brush, splat-transform, this program |
//! | `antialiased 1` or `0` | the same | Postshot |
//! | `Vertical Axis: y` or `z` | that axis points up: a note names the `--axes` that show the scene upright; the numbers still match its cameras | nerfstudio |
//! | `streamsplat offset X Y Z` | the origin of the coordinates | this program, in compressed files |
//!
//! Letter case is ignored. If a comment is repeated, the last one counts.

use crate::still::About;

/// Parses a header's comments into `about`.
pub(in crate::formats) fn read(comments: &[String], about: &mut About) {
    for comment in comments {
        let lower = comment.to_ascii_lowercase();
        let words: Vec<&str> = lower.split_ascii_whitespace().collect();
        match &words[..] {
            ["splatrendermode:", "mip"] | ["antialiased", "1"] => about.antialiased = true,
            ["splatrendermode:", "default" | "2dgs"] | ["antialiased", "0"] => about.antialiased = false,
            ["vertical", "axis:", axis @ ("y" | "z")] => {
                let axes = if *axis == "y" { "rub" } else { "rfu" };
                about.notes.push(format!("the file's {axis} axis points up: --axes {axes} shows the scene upright"));
            }
            ["streamsplat", "offset", numbers @ ..] => {
                let numbers: Vec<f64> = numbers.iter().filter_map(|word| word.parse().ok()).collect();
                if let [x, y, z] = numbers[..]
                    && numbers.iter().all(|x| x.is_finite())
                {
                    about.offset = [x, y, z];
                }
            }
            _ => {}
        }
    }
}

/// Returns header lines for `about`, the inverse of [`read`].
pub(crate) fn written(about: &About) -> Vec<String> {
    let mut lines = Vec::new();
    if about.antialiased {
        lines.push("comment SplatRenderMode: mip\n".to_owned());
    }
    if about.offset != [0.0; 3] {
        let [x, y, z] = about.offset;
        lines.push(format!("comment streamsplat offset {x} {y} {z}\n"));
    }
    lines
}
