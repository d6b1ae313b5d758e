//! The `meta.json` of a SOG scene.

use serde::Deserialize;
use serde_json::Value;
use streamsplat_kernels::harmonics::MAX_DEGREE;

use super::MODEL;
use crate::formats::FormatError;
use crate::still::About;

/// Rows of harmonics that a two-byte label can index.
pub(crate) const MOST_ROWS: usize = 1 << 16;

/// The values of 256 bytes.
type Table = Box<[f32; 256]>;

#[derive(Debug, Deserialize)]
pub(super) struct Meta {
    pub(super) count: usize,
    pub(super) means: Means,
    pub(super) scales: Coded,
    pub(super) quats: Plain,
    pub(super) sh0: Coded,
    #[serde(rename = "shN")]
    pub(super) harmonics: Option<Harmonics>,
    /// Kind of the scene's training.
    #[serde(default)]
    pub(super) model: Option<Value>,
    /// The origin of the coordinates, if this program wrote one.
    #[serde(default)]
    pub(super) offset: Option<[f64; 3]>,
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

/// An image of bytes that index a codebook.
#[derive(Debug, Deserialize)]
pub(super) struct Coded {
    /// One for all channels, or one for each.
    #[serde(rename = "codebook", deserialize_with = "codebook")]
    tables: Vec<Table>,
    pub(super) files: [String; 1],
}

impl Coded {
    /// Returns the value of a byte of a channel.
    pub(super) fn value(&self, channel: usize, byte: u8) -> f32 {
        self.tables[channel.min(self.tables.len() - 1)][usize::from(byte)]
    }

    /// Returns the value of an alpha, if it has a table of its own.
    pub(super) fn alpha(&self, byte: u8) -> Option<f32> {
        self.tables.get(3).map(|table| table[usize::from(byte)])
    }
}

#[derive(Debug, Deserialize)]
pub(super) struct Harmonics {
    /// Number of rows; 0 in version 1, which derives it from the size of the image.
    pub(super) count: usize,
    /// Degree; 0 in version 1.
    pub(super) bands: usize,
    #[serde(rename = "codebook", deserialize_with = "codebook")]
    tables: Vec<Table>,
    pub(super) files: [String; 2],
}

impl Harmonics {
    /// Returns the coefficient of a byte.
    pub(super) fn value(&self, byte: u8) -> f32 {
        self.tables[0][usize::from(byte)]
    }
}

fn codebook<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Vec<Table>, D::Error> {
    let values = Vec::<f32>::deserialize(from)?;
    let found = values.len();
    let wrong = || serde::de::Error::custom(format!("codebook: expected 256 values, found {found}"));
    Ok(vec![values.try_into().map_err(|_| wrong())?])
}

/// Version 1, which has no version number: bytes are spaced evenly between the least and the greatest value of their
/// channel.
#[derive(Debug, Deserialize)]
struct First {
    means: FirstMeans,
    scales: Even<[f64; 3], 1>,
    quats: Plain,
    sh0: Even<[f64; 4], 1>,
    #[serde(rename = "shN")]
    harmonics: Option<Even<f64, 2>>,
}

#[derive(Debug, Deserialize)]
struct FirstMeans {
    shape: Vec<usize>,
    mins: [f64; 3],
    maxs: [f64; 3],
    files: [String; 2],
}

#[derive(Debug, Deserialize)]
#[serde(bound(deserialize = "T: Deserialize<'de>"))]
struct Even<T, const FILES: usize> {
    mins: T,
    maxs: T,
    #[serde(deserialize_with = "files")]
    files: [String; FILES],
}

fn files<'de, D: serde::Deserializer<'de>, const N: usize>(from: D) -> Result<[String; N], D::Error> {
    let names = Vec::<String>::deserialize(from)?;
    let found = names.len();
    names.try_into().map_err(|_| serde::de::Error::custom(format!("files: expected {N}, found {found}")))
}

fn even(least: f64, greatest: f64) -> Table {
    Box::new(std::array::from_fn(|byte| (least + (greatest - least) * (byte as f64 / 255.0)) as f32))
}

impl From<First> for Meta {
    fn from(first: First) -> Meta {
        let tables = |least: &[f64], greatest: &[f64]| least.iter().zip(greatest).map(|(a, b)| even(*a, *b)).collect();
        let First { means, scales, quats, sh0, harmonics } = first;
        Meta {
            count: means.shape.first().copied().unwrap_or_default(),
            means: Means { mins: means.mins, maxs: means.maxs, files: means.files },
            scales: Coded { tables: tables(&scales.mins, &scales.maxs), files: scales.files },
            quats,
            sh0: Coded { tables: tables(&sh0.mins, &sh0.maxs), files: sh0.files },
            harmonics: harmonics.map(|own| Harmonics {
                count: 0,
                bands: 0,
                tables: vec![even(own.mins, own.maxs)],
                files: own.files,
            }),
            model: None,
            offset: None,
        }
    }
}

impl Meta {
    pub(super) fn read(text: &[u8]) -> Result<Meta, FormatError> {
        let wrong =
            |part: &str, expected: &str, found: String| FormatError::new(format!("meta.json{part}"), expected, found);
        let value: Value = serde_json::from_slice(text).map_err(|e| wrong("", "JSON", e.to_string()))?;
        match value.get("version") {
            Some(version) if *version == 2 => {}
            None if value.pointer("/means/shape").is_some() => {
                let first: First =
                    serde_json::from_value(value).map_err(|e| wrong("", "a SOG scene's", e.to_string()))?;
                return Ok(first.into());
            }
            found => {
                let found = found.map_or("none".into(), Value::to_string);
                return Err(wrong(": version", "2, or none beside means.shape", found));
            }
        }
        let meta: Meta = serde_json::from_value(value).map_err(|e| wrong("", "a SOG scene's", e.to_string()))?;
        if let Some(harmonics) = &meta.harmonics {
            if !(1..=MOST_ROWS).contains(&harmonics.count) {
                return Err(wrong(": shN.count", "1 to 65536", harmonics.count.to_string()));
            }
            if !(1..=MAX_DEGREE).contains(&harmonics.bands) {
                return Err(wrong(": shN.bands", "1 to 3", harmonics.bands.to_string()));
            }
        }
        if meta.offset.is_some_and(|offset| offset.iter().any(|x| !x.is_finite())) {
            return Err(wrong(": offset", "finite numbers", format!("{:?}", meta.offset.unwrap_or_default())));
        }
        Ok(meta)
    }

    /// Iterates over the names of all images.
    pub(super) fn images(&self) -> impl Iterator<Item = &str> {
        let harmonics = self.harmonics.iter().flat_map(|harmonics| &harmonics.files);
        let others = [&self.scales.files[0], &self.quats.files[0], &self.sh0.files[0]];
        self.means.files.iter().chain(others).chain(harmonics).map(String::as_str)
    }

    /// Returns the degree of the harmonics, or [`MAX_DEGREE`] in version 1, where it follows from the size of an image.
    pub(super) fn most_degree(&self) -> usize {
        self.harmonics.as_ref().map_or(0, |own| if own.bands == 0 { MAX_DEGREE } else { own.bands })
    }

    /// Returns the metadata of the scene.
    pub(super) fn about(&self) -> About {
        let model = self.model.as_ref().map(|model| model.as_str().unwrap_or("?"));
        let notes = match model {
            None | Some("default" | "2dgs" | MODEL) => Vec::new(),
            Some(other) => vec![format!("meta.json: model {other:?} is not known: taken as \"default\"")],
        };
        About { antialiased: model == Some(MODEL), offset: self.offset.unwrap_or_default(), notes, ..About::default() }
    }
}
