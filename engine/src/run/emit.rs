//! Kinds of output.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use super::Error;

/// A kind of output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kind {
    /// Its name in `--emit`.
    pub name: &'static str,
    /// The folder of its files.
    pub folder: &'static str,
    /// True if an image is drawn for it; a graphics card's images are outside of the bit contract.
    pub drawn: bool,
    /// True if `run` can write it; `render` writes the drawn kinds.
    pub of_run: bool,
}

/// Defines the kinds: the structure of those selected, and the table.
macro_rules! kinds {
    ($($(#[$meta:meta])* $name:ident: $folder:literal, drawn: $drawn:literal, of_run: $of_run:literal;)+) => {
        /// Kinds of output, as `--emit` selects them.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub struct Emit { $($(#[$meta])* pub $name: bool,)+ }

        /// All kinds.
        const KINDS: &[Kind] =
            &[$(Kind { name: stringify!($name), folder: $folder, drawn: $drawn, of_run: $of_run },)+];

        impl Emit {
            /// Whether each kind is selected, in the order of the table.
            fn wanted(self) -> impl Iterator<Item = bool> {
                [$(self.$name,)+].into_iter()
            }

            /// The kinds in a list.
            fn among(list: &BTreeSet<&str>) -> Emit {
                Emit { $($name: list.contains(stringify!($name)),)+ }
            }
        }
    };
}

kinds! {
    /// Colour images or video.
    rgb: "frames", drawn: true, of_run: true;
    /// Colour images as WebP without loss.
    webp: "frames", drawn: true, of_run: false;
    /// Depth images.
    depth: "depth", drawn: true, of_run: true;
    /// Alpha images.
    alpha: "alpha", drawn: true, of_run: true;
    /// Colour, depth and alpha as layers of one file.
    exr: "exr", drawn: true, of_run: true;
    /// The scene.
    scene: "scene", drawn: false, of_run: true;
    /// The Gaussians at each time as PLY files.
    ply: "ply", drawn: false, of_run: true;
    /// Where every identity is at each key frame, as CSV.
    tracks: "tracks", drawn: false, of_run: true;
}

impl Emit {
    /// The selected kinds.
    fn kinds(self) -> impl Iterator<Item = &'static Kind> {
        KINDS.iter().zip(self.wanted()).filter(|(_, wanted)| *wanted).map(|(kind, _)| kind)
    }

    /// Refuses kinds that are not `allowed` by a command.
    ///
    /// # Errors
    /// [`Error::Usage`] with the allowed kinds.
    pub fn check(self, allowed: impl Fn(&Kind) -> bool) -> Result<(), Error> {
        let Some(kind) = self.kinds().find(|kind| !allowed(kind)) else { return Ok(()) };
        let names: Vec<&str> = KINDS.iter().filter(|kind| allowed(kind)).map(|kind| kind.name).collect();
        let (names, found) = (names.join(", "), kind.name);
        Err(Error::usage(format!("--emit {self}: expected a list of {names}, found {found:?}")))
    }

    /// Returns true if any images are drawn.
    pub fn draws(&self) -> bool {
        self.kinds().any(|kind| kind.drawn)
    }

    /// Whether depth and alpha must be drawn in addition to colour.
    pub fn planes(&self) -> [bool; 2] {
        [self.depth || self.exr, self.depth || self.alpha || self.exr]
    }

    /// The folders of the selected kinds, each once.
    pub fn folders(self) -> BTreeSet<&'static str> {
        self.kinds().map(|kind| kind.folder).collect()
    }
}

/// Returns true if the file of this name, inside a folder of results, holds a drawn image.
pub fn is_drawn(name: &str) -> bool {
    KINDS.iter().any(|kind| kind.drawn && name.split('/').next() == Some(kind.folder))
}

impl fmt::Display for Emit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.kinds().map(|kind| kind.name).collect::<Vec<_>>().join(","))
    }
}

/// A list with an unknown kind of output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownOutput(pub String);

impl std::error::Error for UnknownOutput {}

impl fmt::Display for UnknownOutput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = KINDS.iter().map(|kind| kind.name).collect();
        write!(f, "expected a list of {}, found {:?}", names.join(", "), self.0)
    }
}

impl FromStr for Emit {
    type Err = UnknownOutput;

    /// Kinds separated by commas.
    fn from_str(list: &str) -> Result<Self, UnknownOutput> {
        let names: BTreeSet<&str> = list.split(',').map(str::trim).collect();
        match names.iter().find(|name| KINDS.iter().all(|kind| kind.name != **name)) {
            Some(name) => Err(UnknownOutput((*name).to_owned())),
            None => Ok(Emit::among(&names)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_read_as_they_are_written_and_name_what_is_wrong() {
        for list in ["rgb", "rgb,scene", "webp,exr", "depth,alpha,ply,tracks"] {
            assert_eq!(list.parse::<Emit>().expect("kinds").to_string(), list);
        }
        let emit: Emit = "scene, rgb".parse().expect("kinds");
        assert_eq!((emit.to_string().as_str(), emit.draws()), ("rgb,scene", true));
        assert_eq!("rgb,gif".parse::<Emit>(), Err(UnknownOutput("gif".to_owned())));
        assert!("".parse::<Emit>().is_err());
        let webp: Emit = "webp".parse().expect("a kind");
        let refused = webp.check(|kind| kind.of_run).expect_err("not of a run").to_string();
        assert!(refused.contains("found \"webp\"") && !refused.contains("scene, webp"), "{refused}");
    }

    #[test]
    fn every_image_is_drawn_whatever_its_format() {
        for name in
            ["frames/000000.png", "frames/000000.webp", "depth/000000.exr", "alpha/000000.png", "exr/000000.exr"]
        {
            assert!(is_drawn(name), "{name}");
        }
        for name in ["scene/scene.json", "ply/000000.ply", "tracks/interval-000000.csv", "run.json"] {
            assert!(!is_drawn(name), "{name}");
        }
    }
}
