//! Comments of a PLY header that say something of the scene.
//!
//! | comment | says | written by |
//! |---|---|---|
//! | `SplatRenderMode: mip`, `default` or `2dgs` | trained with anti-aliasing, or without | Brush, splat-transform, this program |
//! | `antialiased 1` or `0` | the same | Postshot |
//! | `streamsplat offset X Y Z` | the origin of the coordinates | this program, in compressed files |
//!
//! In any case of letters; of several the last holds.

use crate::still::About;

/// Takes what a header's comments say.
pub(super) fn read(comments: &[String], about: &mut About) {
    for comment in comments {
        let lower = comment.to_ascii_lowercase();
        let words: Vec<&str> = lower.split_ascii_whitespace().collect();
        match &words[..] {
            ["splatrendermode:", "mip"] | ["antialiased", "1"] => about.antialiased = true,
            ["splatrendermode:", "default" | "2dgs"] | ["antialiased", "0"] => about.antialiased = false,
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

/// The lines of a header that say it.
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
