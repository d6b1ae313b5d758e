//! The list of renders, FILE.toml.

use std::collections::BTreeSet;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::Deserialize;
use streamsplat::formats::read_text;
use streamsplat::recognise;
use streamsplat::run::options::{Motion, ViewOptions};

use crate::console::failure::Failure;
use crate::options::args::RenderOptions;
use crate::options::optics::Optics;

/// Maximum size of a list, in bytes.
const MAX_LIST: u64 = 1 << 24;

/// The whole file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct List {
    #[serde(default)]
    render: Vec<Entry>,
}

/// One render, with the option names of the command line.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    name: String,
    scene: PathBuf,
    camera: Option<PathBuf>,
    view: Option<Word>,
    size: Option<String>,
    times: Option<Word>,
    fps: Option<f64>,
    background: Option<Word>,
    orbit: Option<Word>,
    sway: Option<Word>,
    turntable: Option<f64>,
    fill: Option<String>,
    antialias: Option<bool>,
    #[serde(default)]
    stereo: bool,
    eye_distance: Option<f64>,
    footprint: Option<String>,
    #[serde(default)]
    panorama: bool,
    f_stop: Option<f64>,
    focus: Option<Word>,
    sensor_height: Option<f64>,
    shutter: Option<f64>,
    shutter_samples: Option<u32>,
}

/// Text, a number, or an array of numbers.
#[derive(Deserialize)]
#[serde(untagged)]
enum Word {
    Text(String),
    Whole(i64),
    Number(f64),
    List(Vec<f64>),
}

impl Word {
    fn text(self) -> String {
        match self {
            Word::Text(text) => text,
            Word::Whole(number) => number.to_string(),
            Word::Number(number) => number.to_string(),
            Word::List(numbers) => numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(","),
        }
    }
}

/// A render.
pub struct Render {
    /// Its name, which is also used in file names.
    pub name: String,
    /// The scene.
    pub scene: PathBuf,
    /// All options that affect the image.
    pub options: RenderOptions,
}

/// Reads a list. Paths in it are relative to its folder.
pub fn read(file: &Path) -> Result<Vec<Render>, Failure> {
    let wrong = |e: &dyn std::fmt::Display| Failure::usage(format!("{}: {e}", file.display()));
    if let Some(found) = recognise::not_a_text(file, "a list of renders in TOML") {
        return Err(wrong(&found));
    }
    let text = read_text(file, MAX_LIST).map_err(|e| wrong(&e))?;
    let folder = file.parent().unwrap_or(Path::new(""));
    parse(&text, folder).map_err(|e| wrong(&e))
}

fn parse(text: &str, folder: &Path) -> Result<Vec<Render>, String> {
    let List { render } = toml::from_str(text).map_err(|e| e.to_string())?;
    if render.is_empty() {
        return Err("expected at least one [[render]], found none".to_owned());
    }
    let mut names = BTreeSet::new();
    let renders = render.into_iter().map(|entry| {
        let allowed = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        let Entry { name, .. } = &entry;
        if name.is_empty() || name.len() > 100 || name.starts_with('.') || !name.chars().all(allowed) {
            return Err(format!("name {name:?}: expected 1 to 100 letters, digits, '-', '_' and '.', not first a '.'"));
        }
        if !names.insert(name.to_lowercase()) {
            return Err(format!("name {name:?}: expected every name once, found it twice"));
        }
        let named = entry.name.clone();
        entry.render(folder).map_err(|e| format!("{named}: {e}"))
    });
    renders.collect()
}

impl Entry {
    fn render(self, folder: &Path) -> Result<Render, String> {
        let view = ViewOptions {
            times: value("times", self.times.map(Word::text))?,
            size: value("size", self.size)?,
            camera: self.camera.map(|camera| folder.join(camera)),
            view: self.view.map(Word::text),
            background: value("background", self.background.map(Word::text))?.unwrap_or_default(),
            renderer: None,
        };
        let optics = Optics {
            footprint: self.footprint,
            panorama: self.panorama,
            f_stop: self.f_stop,
            focus: self.focus.map(Word::text),
            sensor_height: self.sensor_height,
            shutter: self.shutter,
            shutter_samples: self.shutter_samples,
        };
        let Entry { turntable, stereo, eye_distance, antialias, .. } = self;
        let (orbit, sway) = (value("orbit", self.orbit.map(Word::text))?, value("sway", self.sway.map(Word::text))?);
        let fill = value("fill", self.fill)?;
        let motion = Motion { orbit, sway, turntable, fill, stereo, eye_distance };
        let antialias = antialias.into();
        let options = RenderOptions { view, fps: self.fps, motion, antialias, optics, ..RenderOptions::default() };
        Ok(Render { name: self.name, scene: folder.join(self.scene), options })
    }
}

/// Parses the value of a key, if it is present.
fn value<T: FromStr<Err: Display>>(key: &str, text: Option<String>) -> Result<Option<T>, String> {
    text.map(|text| text.parse().map_err(|e| format!("{key}: {e}"))).transpose()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use proptest::sample::{Index, select};

    use streamsplat::run::options::{Background, Times};

    use super::*;
    use crate::options::antialias::Antialias;

    #[test]
    fn numbers_and_text_mean_what_they_mean_on_the_command_line() {
        let text = r#"
            [[render]]
            name = "front"
            scene = "a.ply"
            camera = "cameras.json"
            view = 3
            size = "64x48"
            times = [0, 0.5]
            background = 0.25
            [[render]]
            name = "turn"
            scene = "b.ply"
            turntable = 2.0
            background = "0,0.5,1"
            antialias = true
        "#;
        let renders = parse(text, Path::new("dir")).expect("a list");
        let RenderOptions { view, .. } = &renders[0].options;
        assert_eq!((view.view.as_deref(), view.times.as_ref()), (Some("3"), Some(&Times::List(vec![0.0, 0.5]))));
        let grey = Background::Colour([0.25; 3]);
        assert_eq!((view.background, view.camera.as_deref()), (grey, Some(Path::new("dir/cameras.json"))));
        assert_eq!(
            (renders[1].options.motion.turntable, renders[1].scene.as_path()),
            (Some(2.0), Path::new("dir/b.ply"))
        );
        assert_eq!([0, 1].map(|i| renders[i].options.antialias), [Antialias::Auto, Antialias::On]);
    }

    #[test]
    fn cameras_that_move_and_pairs_of_eyes_are_said_as_there() {
        let text = "[[render]]\nname = 'a'\nscene = 'b'\nsway = 4\nstereo = true\neye_distance = 0.05";
        let motion = Motion { sway: "4".parse().ok(), stereo: true, eye_distance: Some(0.05), ..Motion::default() };
        assert_eq!(parse(text, Path::new("")).expect("a list")[0].options.motion, motion);
    }

    /// A list with every key.
    const WHOLE: &str = "[[render]]\nname = 'a'\nscene = 'b.ply'\ncamera = 'c.json'\nview = 3\nsize = '6x4'\ntimes = [0, 0.5]\n\
                         fps = 12\nbackground = 0.25\norbit = '4:2'\nsway = 3\nturntable = 2.0\nstereo = true\neye_distance = 0.1\n";
    /// Fragments inserted to corrupt a list.
    const WORDS: [&str; 16] = [
        "",
        "0",
        "-1",
        "1e999",
        "99999999999999999999",
        "nan",
        "[[",
        "]]",
        "[",
        "]",
        "{}",
        "'",
        "\"",
        "=",
        "\n",
        "\u{0}",
    ];

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4096))]

        #[test]
        fn no_text_panics(changes in proptest::collection::vec((any::<Index>(), 0_usize..16, select(&WORDS[..])), 1..4)) {
            let mut text = WHOLE.to_owned();
            for (at, length, word) in changes {
                let at = at.index(text.len());
                text.replace_range(at..(at + length).min(text.len()), word);
            }
            for render in parse(&text, Path::new("")).unwrap_or_default() {
                assert!(!render.name.is_empty() && !render.name.contains('/'), "{}", render.name);
            }
        }
    }

    #[test]
    fn lists_that_are_wrong_say_why() {
        for (text, expected) in [
            ("", "expected at least one [[render]]"),
            ("[[render]]\nname = 'a'\nscene = 'b'\ncolour = 1", "unknown field `colour`"),
            ("[[render]]\nname = '../a'\nscene = 'b'", "expected 1 to 100 letters"),
            ("[[render]]\nname = 'a'\nscene = 'b'\n[[render]]\nname = 'A'\nscene = 'b'", "found it twice"),
            ("[[render]]\nname = 'a'", "missing field `scene`"),
            ("[[render]]\nname = 'a'\nscene = 'b'\nsize = '4x'", "a: size: expected model, source or WIDTHxHEIGHT"),
        ] {
            let error = parse(text, Path::new("")).err().unwrap_or_default();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
