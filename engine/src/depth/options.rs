//! Options of a depth network that its file does not contain.

use std::str::FromStr;

/// Preparation of a network's pictures. The default is that of Depth Anything and similar networks: a shorter side of
/// 518 pixels if the network leaves it open, sides in multiples of 14, ImageNet's mean and standard deviation, inverse
/// depth out.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkOptions {
    /// Size of the input, if the network leaves it open.
    pub size: NetworkSize,
    /// Sides that the network leaves open are rounded to a multiple of this.
    pub multiple: usize,
    /// Subtracted from red, green and blue, which are in [0, 1].
    pub mean: [f32; 3],
    /// Divisors of the differences.
    pub std: [f32; 3],
    /// True if the network returns depth (larger is farther) instead of inverse depth.
    pub metric: bool,
    /// Name of the output that is the map, if there are several.
    pub output: Option<String>,
}

/// Size of a network's input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NetworkSize {
    /// The shorter side; the other one keeps the frame's aspect ratio.
    Shorter(usize),
    /// Height and width, without keeping the aspect ratio.
    Exact([usize; 2]),
}

impl Default for NetworkOptions {
    fn default() -> Self {
        NetworkOptions {
            size: NetworkSize::Shorter(518),
            multiple: 14,
            mean: [0.485, 0.456, 0.406],
            std: [0.229, 0.224, 0.225],
            metric: false,
            output: None,
        }
    }
}

/// An invalid part of the text form.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{part}: expected {expected}")]
pub struct WrongOption {
    /// The part.
    pub part: String,
    /// Valid values.
    pub expected: &'static str,
}

/// Largest side that can be requested, in pixels.
const MOST: usize = 8192;

impl FromStr for NetworkOptions {
    type Err = WrongOption;

    /// `KEY=VALUE,…`, with each key at most once:
    ///
    /// | key | meaning | default |
    /// |---|---|---|
    /// | `size=N` or `size=WxH` | shorter side, or width and height, of an input whose size the network leaves open | `518` |
    /// | `multiple=N` | sides left open are rounded to a multiple of N | `14` |
    /// | `mean=R/G/B` | subtracted from colours in [0, 1]; one number applies to all three | `0.485/0.456/0.406` |
    /// | `std=R/G/B` | divisors after the subtraction | `0.229/0.224/0.225` |
    /// | `metric` | the network returns depth, not inverse depth; it is inverted | |
    /// | `output=NAME` | the output that is the map, if there are several | the only one |
    fn from_str(text: &str) -> Result<Self, WrongOption> {
        let mut options = NetworkOptions::default();
        let mut seen: Vec<&str> = Vec::new();
        for part in text.split(',').map(str::trim) {
            let wrong = |expected| WrongOption { part: part.to_owned(), expected };
            let (key, value) = part.split_once('=').map_or((part, None), |(key, value)| (key, Some(value)));
            if seen.contains(&key) {
                return Err(wrong("each key once"));
            }
            seen.push(key);
            match (key, value) {
                ("size", Some(value)) => {
                    let expected = "size=N or size=WxH, from 1 to 8192 pixels a side";
                    options.size = size(value).ok_or_else(|| wrong(expected))?;
                }
                ("multiple", Some(value)) => {
                    options.multiple = side(value).ok_or_else(|| wrong("a whole number from 1 to 8192"))?;
                }
                ("mean", Some(value)) => {
                    options.mean = colours(value, |_| true).ok_or_else(|| wrong("a number, or three as R/G/B"))?;
                }
                ("std", Some(value)) => {
                    let expected = "a number above 0, or three as R/G/B";
                    options.std = colours(value, |v| v > 0.0).ok_or_else(|| wrong(expected))?;
                }
                ("metric", None) => options.metric = true,
                ("output", Some(name)) if !name.is_empty() => options.output = Some(name.to_owned()),
                _ => return Err(wrong("size=…, multiple=…, mean=…, std=…, metric or output=…, separated by commas")),
            }
        }
        Ok(options)
    }
}

fn side(text: &str) -> Option<usize> {
    text.parse().ok().filter(|side| (1..=MOST).contains(side))
}

fn size(text: &str) -> Option<NetworkSize> {
    match text.split_once('x') {
        Some((width, height)) => Some(NetworkSize::Exact([side(height)?, side(width)?])),
        None => Some(NetworkSize::Shorter(side(text)?)),
    }
}

fn colours(text: &str, fits: impl Fn(f32) -> bool) -> Option<[f32; 3]> {
    let number = |part: &str| part.parse::<f32>().ok().filter(|v| v.is_finite() && fits(*v));
    let numbers: Option<Vec<f32>> = text.split('/').map(number).collect();
    match numbers?[..] {
        [one] => Some([one; 3]),
        [r, g, b] => Some([r, g, b]),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_is_read_and_the_rest_stays_as_it_was() {
        let options: NetworkOptions = "size=924x518, mean=0.5,std=1/2/4,metric,output=depth".parse().expect("valid");
        let expected = NetworkOptions {
            size: NetworkSize::Exact([518, 924]),
            mean: [0.5; 3],
            std: [1.0, 2.0, 4.0],
            metric: true,
            output: Some("depth".into()),
            ..NetworkOptions::default()
        };
        assert_eq!(options, expected);
        let options: NetworkOptions = "size=266,multiple=7".parse().expect("valid");
        assert_eq!((options.size, options.multiple), (NetworkSize::Shorter(266), 7));
    }

    #[test]
    fn parts_that_say_nothing_are_named() {
        for (text, expected) in [
            ("", ": expected size=…"),
            ("size=0", "size=0: expected size=N"),
            ("size=9000", "size=9000: expected size=N"),
            ("size=4x", "size=4x: expected size=N"),
            ("multiple=1.5", "multiple=1.5: expected a whole number"),
            ("mean=a", "mean=a: expected a number"),
            ("mean=1/2", "mean=1/2: expected a number"),
            ("std=0", "std=0: expected a number above 0"),
            ("std=inf", "std=inf: expected a number above 0"),
            ("metric=yes", "metric=yes: expected size"),
            ("output=", "output=: expected size"),
            ("metric,metric", "metric: expected each key once"),
            ("scale=2", "scale=2: expected size"),
        ] {
            let error = text.parse::<NetworkOptions>().expect_err(text).to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
