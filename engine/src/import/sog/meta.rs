//! The `meta.json` of a SOG scene.

use serde::Deserialize;
use serde_json::Value;

use crate::import::FormatError;

/// Rows of harmonics that two bytes can tell apart.
pub(crate) const MOST_ROWS: usize = 1 << 16;

#[derive(Debug, Deserialize)]
pub(super) struct Meta {
    pub(super) count: usize,
    pub(super) means: Means,
    pub(super) scales: Coded<1>,
    pub(super) quats: Plain,
    pub(super) sh0: Coded<1>,
    #[serde(rename = "shN")]
    pub(super) harmonics: Option<Harmonics>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Means {
    pub(super) mins: [f64; 3],
    pub(super) maxs: [f64; 3],
    pub(super) files: [String; 2],
}

#[derive(Debug, Deserialize)]
pub(super) struct Plain {
    pub(super) files: [String; 1],
}

/// Images of bytes that stand for the values of a codebook.
#[derive(Debug, Deserialize)]
pub(super) struct Coded<const FILES: usize> {
    #[serde(deserialize_with = "codebook")]
    pub(super) codebook: Box<[f32; 256]>,
    #[serde(deserialize_with = "files")]
    pub(super) files: [String; FILES],
}

#[derive(Debug, Deserialize)]
pub(super) struct Harmonics {
    pub(super) count: usize,
    pub(super) bands: usize,
    #[serde(deserialize_with = "codebook")]
    pub(super) codebook: Box<[f32; 256]>,
    pub(super) files: [String; 2],
}

fn codebook<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Box<[f32; 256]>, D::Error> {
    let values = Vec::<f32>::deserialize(from)?;
    let found = values.len();
    values.try_into().map_err(|_| serde::de::Error::custom(format!("codebook: expected 256 values, found {found}")))
}

fn files<'de, D: serde::Deserializer<'de>, const N: usize>(from: D) -> Result<[String; N], D::Error> {
    let names = Vec::<String>::deserialize(from)?;
    let found = names.len();
    names.try_into().map_err(|_| serde::de::Error::custom(format!("files: expected {N}, found {found}")))
}

impl Meta {
    pub(super) fn read(text: &[u8]) -> Result<Meta, FormatError> {
        let wrong =
            |part: &str, expected: &str, found: String| FormatError::new(format!("meta.json{part}"), expected, found);
        let value: Value = serde_json::from_slice(text).map_err(|e| wrong("", "JSON", e.to_string()))?;
        match value.get("version") {
            Some(version) if *version == 2 => {}
            found => {
                let found = found.map_or("none".into(), Value::to_string);
                return Err(wrong(": version", "2", found));
            }
        }
        let meta: Meta = serde_json::from_value(value).map_err(|e| wrong("", "a SOG scene's", e.to_string()))?;
        if let Some(harmonics) = &meta.harmonics
            && !(1..=MOST_ROWS).contains(&harmonics.count)
        {
            return Err(wrong(": shN.count", "1 to 65536", harmonics.count.to_string()));
        }
        Ok(meta)
    }

    /// The names of all images.
    pub(super) fn images(&self) -> impl Iterator<Item = &str> {
        let harmonics = self.harmonics.iter().flat_map(|harmonics| &harmonics.files);
        let others = [&self.scales.files[0], &self.quats.files[0], &self.sh0.files[0]];
        self.means.files.iter().chain(others).chain(harmonics).map(String::as_str)
    }

    /// Degree of the harmonics.
    pub(super) fn degree(&self) -> Result<usize, FormatError> {
        match self.harmonics.as_ref().map_or(0, |harmonics| harmonics.bands) {
            degree @ 0..=3 => Ok(degree),
            found => Err(FormatError::new("meta.json: shN.bands", "1 to 3", found.to_string())),
        }
    }
}
