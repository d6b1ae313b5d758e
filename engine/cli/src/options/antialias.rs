//! `--antialias`.

use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use streamsplat::still::Still;

/// Whether footprints smaller than a pixel are dimmed instead of enlarged. Recorded as `true` or `false`; the default
/// is not recorded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Antialias {
    /// On if the scene's file has a mark of such training.
    #[default]
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

impl Antialias {
    pub fn is_auto(&self) -> bool {
        *self == Antialias::Auto
    }

    /// Returns the setting for a still scene.
    pub fn of_still(self, still: &Still) -> bool {
        match self {
            Antialias::Auto => still.about.antialiased,
            Antialias::On => true,
            Antialias::Off => false,
        }
    }
}

impl FromStr for Antialias {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "auto" => Ok(Antialias::Auto),
            "on" => Ok(Antialias::On),
            "off" => Ok(Antialias::Off),
            _ => Err("expected auto, on or off".to_owned()),
        }
    }
}

impl From<Option<bool>> for Antialias {
    fn from(said: Option<bool>) -> Self {
        match said {
            None => Antialias::Auto,
            Some(true) => Antialias::On,
            Some(false) => Antialias::Off,
        }
    }
}

impl Serialize for Antialias {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_bool(*self == Antialias::On)
    }
}

impl<'de> Deserialize<'de> for Antialias {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        bool::deserialize(from).map(|on| Some(on).into())
    }
}
