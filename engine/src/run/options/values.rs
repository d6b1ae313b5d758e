//! Types of a run's own options, each with its text form.

use std::convert::Infallible;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use streamsplat_kernels::{Level, LevelError};

use crate::choice::named;
use crate::depth::{NetworkOptions, WrongOption};
use crate::source::colour::Matrix;

/// A text that is not a value of an option.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected}, found {found:?}")]
pub struct Unknown {
    /// Allowed values.
    pub expected: String,
    /// The text found.
    pub found: String,
}

fn unknown(expected: impl Into<String>, found: &str) -> Unknown {
    Unknown { expected: expected.into(), found: found.to_owned() }
}

/// Number of threads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Threads(usize);

impl Threads {
    /// Largest number of threads.
    pub const MOST: usize = 1024;

    /// Checks a number of threads, from 1 to [`Threads::MOST`].
    pub fn new(count: usize) -> Option<Threads> {
        (1..=Threads::MOST).contains(&count).then_some(Threads(count))
    }

    /// The number.
    pub fn get(self) -> usize {
        self.0
    }
}

impl FromStr for Threads {
    type Err = Unknown;

    fn from_str(text: &str) -> Result<Self, Unknown> {
        let found = text.parse().ok().and_then(Threads::new);
        found.ok_or_else(|| unknown(format!("a whole number from 1 to {}", Threads::MOST), text))
    }
}

/// An instruction set: a level's name, or `auto` for the CPU's highest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Isa {
    name: String,
    level: Level,
}

impl Isa {
    /// The level.
    pub fn level(&self) -> Level {
        self.level
    }
}

impl Default for Isa {
    fn default() -> Self {
        Isa { name: "auto".to_owned(), level: Level::detect() }
    }
}

impl From<Level> for Isa {
    fn from(level: Level) -> Self {
        Isa { name: level.name().to_owned(), level }
    }
}

impl fmt::Display for Isa {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

impl FromStr for Isa {
    type Err = LevelError;

    fn from_str(text: &str) -> Result<Self, LevelError> {
        Level::named(text).map(|level| Isa { name: text.to_owned(), level })
    }
}

/// Source of depth maps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DepthSource {
    /// There are none.
    None,
    /// Parallax, where the camera moves and the model ignores depth.
    Auto,
    /// The same, and a guess where there is no parallax.
    Guess,
    /// A folder of maps, one per frame.
    Folder(PathBuf),
    /// A network in an ONNX file.
    Network(PathBuf),
}

impl fmt::Display for DepthSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            DepthSource::None => f.write_str("none"),
            DepthSource::Auto => f.write_str("auto"),
            DepthSource::Guess => f.write_str("guess"),
            DepthSource::Folder(path) => path.display().fmt(f),
            DepthSource::Network(path) => write!(f, "onnx:{}", path.display()),
        }
    }
}

impl FromStr for DepthSource {
    type Err = Infallible;

    /// `none`, `auto`, `guess`, `onnx:FILE`, or a folder.
    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(match (text, text.strip_prefix("onnx:")) {
            ("none", _) => DepthSource::None,
            ("auto", _) => DepthSource::Auto,
            ("guess", _) => DepthSource::Guess,
            (_, Some(file)) => DepthSource::Network(file.into()),
            (folder, None) => DepthSource::Folder(folder.into()),
        })
    }
}

/// Properties of a depth network, or `metric` for a folder whose maps hold depth.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthModel {
    text: String,
    options: NetworkOptions,
}

impl DepthModel {
    /// The network's options.
    pub fn options(&self) -> &NetworkOptions {
        &self.options
    }

    /// Returns true for `metric` alone, which is also allowed with a folder of maps.
    pub fn is_metric_alone(&self) -> bool {
        self.text == "metric"
    }
}

impl fmt::Display for DepthModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl FromStr for DepthModel {
    type Err = WrongOption;

    /// Parses [`NetworkOptions`].
    fn from_str(text: &str) -> Result<Self, WrongOption> {
        Ok(DepthModel { text: text.to_owned(), options: text.parse()? })
    }
}

named! {
    /// The range by which depth maps are normalised.
    DepthScale: "depth range" {
        /// Each frame's own.
        #[default]
        Frame = "frame",
        /// That of all maps.
        Clip = "clip",
        /// That of the key frames' maps, with a fixed gap.
        Keys = "keys",
    }
}

/// The matrix of luma and chroma, by its name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NamedMatrix {
    name: &'static str,
    matrix: Matrix,
}

impl NamedMatrix {
    /// The matrix.
    pub fn matrix(self) -> Matrix {
        self.matrix
    }
}

impl fmt::Display for NamedMatrix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

impl FromStr for NamedMatrix {
    type Err = Unknown;

    fn from_str(text: &str) -> Result<Self, Unknown> {
        // ffmpeg's other name for it.
        let name = if text == "bt2020nc" { "bt2020" } else { text };
        let found = Matrix::NAMES.iter().find(|known| **known == name);
        let found = found.and_then(|name| Some(NamedMatrix { name, matrix: Matrix::named(name)? }));
        found.ok_or_else(|| unknown(Matrix::NAMES.join(", "), text))
    }
}

/// Times in seconds, ascending.
#[derive(Clone, Debug, PartialEq)]
pub enum Times {
    /// A list of times.
    List(Vec<f64>),
    /// `count` times, evenly spaced from `start` to `end`.
    Range {
        /// The first.
        start: f64,
        /// The last, where there is more than one.
        end: f64,
        /// Number of times.
        count: usize,
    },
}

impl Times {
    /// Returns all times.
    pub fn list(&self) -> Vec<f64> {
        match *self {
            Times::List(ref times) => times.clone(),
            Times::Range { start, count: 1, .. } => vec![start],
            Times::Range { start, end, count } => {
                let step = |i: usize| {
                    if i + 1 == count { end } else { start + (end - start) * (i as f64 / (count - 1) as f64) }
                };
                (0..count).map(step).collect()
            }
        }
    }
}

impl fmt::Display for Times {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Times::List(times) => {
                let texts: Vec<String> = times.iter().map(f64::to_string).collect();
                f.write_str(&texts.join(","))
            }
            Times::Range { start, end, count } => write!(f, "{start}:{end}:{count}"),
        }
    }
}

impl FromStr for Times {
    type Err = Unknown;

    /// `a,b,c` or `start:end:count`.
    fn from_str(text: &str) -> Result<Self, Unknown> {
        let wrong = |expected: &str| unknown(expected, text);
        let number = |part: &str| part.trim().parse::<f64>().ok().filter(|t| t.is_finite());
        if text.contains(':') {
            let parts: Vec<&str> = text.split(':').collect();
            let [start, end, count] = parts[..] else { return Err(wrong("START:END:COUNT")) };
            let count: Option<usize> = count.trim().parse().ok().filter(|n| (1..=1_000_000).contains(n));
            return match (number(start), number(end), count) {
                (Some(start), Some(end), Some(count)) if start <= end => Ok(Times::Range { start, end, count }),
                _ => Err(wrong("START:END:COUNT with START ≤ END in seconds and COUNT from 1 to 1000000")),
            };
        }
        let times: Option<Vec<f64>> = text.split(',').map(number).collect();
        match times {
            Some(times) if times.windows(2).all(|pair| pair[0] <= pair[1]) => Ok(Times::List(times)),
            Some(_) => Err(wrong("ascending times")),
            None => Err(wrong("seconds separated by commas, or START:END:COUNT")),
        }
    }
}

/// Background of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Background {
    /// A colour: red, green and blue in [0, 1].
    Colour([f32; 3]),
    /// None: images have alpha.
    Transparent,
}

impl Default for Background {
    /// Grey.
    fn default() -> Self {
        Background::Colour([0.5; 3])
    }
}

impl fmt::Display for Background {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Background::Transparent => f.write_str("transparent"),
            Background::Colour([red, green, blue]) if red == green && green == blue => write!(f, "{red}"),
            Background::Colour([red, green, blue]) => write!(f, "{red},{green},{blue}"),
        }
    }
}

impl FromStr for Background {
    type Err = Unknown;

    /// A grey level, `red,green,blue`, or `transparent`.
    fn from_str(text: &str) -> Result<Self, Unknown> {
        if text == "transparent" {
            return Ok(Background::Transparent);
        }
        let parts: Option<Vec<f32>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
        let inside = |v: &[f32]| v.iter().all(|c| (0.0..=1.0).contains(c));
        match parts.as_deref() {
            Some([grey]) if inside(&[*grey]) => Ok(Background::Colour([*grey; 3])),
            Some([r, g, b]) if inside(&[*r, *g, *b]) => Ok(Background::Colour([*r, *g, *b])),
            _ => Err(unknown("one number or R,G,B, each from 0 to 1", text)),
        }
    }
}

/// A camera's motion by an angle, with its own duration if one is given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Swing {
    /// The angle.
    pub degrees: f64,
    /// Seconds that the motion takes.
    pub seconds: Option<f64>,
}

impl fmt::Display for Swing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.degrees)?;
        self.seconds.map_or(Ok(()), |seconds| write!(f, ":{seconds}"))
    }
}

impl FromStr for Swing {
    type Err = Unknown;

    /// `DEGREES` or `DEGREES:SECONDS`.
    fn from_str(text: &str) -> Result<Self, Unknown> {
        let (degrees, seconds) = text.split_once(':').map_or((text, None), |(d, s)| (d, Some(s)));
        let number = |text: &str| text.trim().parse::<f64>().ok().filter(|x| x.is_finite());
        match (number(degrees), seconds.map(number)) {
            (Some(degrees), None) => Ok(Swing { degrees, seconds: None }),
            (Some(degrees), Some(Some(seconds))) => Ok(Swing { degrees, seconds: Some(seconds) }),
            _ => Err(unknown("DEGREES or DEGREES:SECONDS", text)),
        }
    }
}

named! {
    /// Filling of parts of turned images of a scene in time that were never filmed.
    Fill: "filling" {
        /// The surrounding colours, extended.
        #[default]
        Extend = "extend",
        /// The surrounding colours, in images magnified until the picture's edges are outside.
        Crop = "crop",
        /// The background.
        None = "none",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_lists_or_ranges() {
        let times = |text: &str| text.parse::<Times>().map(|times| times.list());
        assert_eq!(times("0,0.5,2").ok(), Some(vec![0.0, 0.5, 2.0]));
        assert_eq!(times("0:1:3").ok(), Some(vec![0.0, 0.5, 1.0]));
        assert_eq!(times("0:0.3:1").ok(), Some(vec![0.0]));
        for wrong in ["", "1,0", "nan", "0:1", "1:0:4", "0:1:0", "0;1"] {
            assert!(times(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn values_are_read_as_they_are_written() {
        fn again<T: FromStr<Err: fmt::Debug> + fmt::Display>(texts: &[&str]) {
            for text in texts {
                assert_eq!(text.parse::<T>().expect("a value").to_string(), *text);
            }
        }
        again::<Times>(&["0,0.5,2", "0:0.3:7"]);
        again::<Background>(&["0.5", "0.25", "0.1,0.2,0.3", "transparent"]);
        again::<Swing>(&["4", "-20:2.5"]);
        again::<DepthSource>(&["none", "auto", "guess", "maps", "onnx:a.onnx"]);
        again::<DepthModel>(&["metric", "size=518,multiple=14"]);
        again::<NamedMatrix>(Matrix::NAMES);
        again::<Isa>(&["auto", "scalar"]);
        for wrong in ["2", "0,1", "red", ""] {
            assert!(wrong.parse::<Background>().is_err(), "{wrong}");
        }
    }
}
