//! OpenEXR files: planes of float samples in and out.
//!
//! Reading takes the first layer's channels at full resolution as f32, whatever they are stored as. Writing makes one layer
//! of f32 channels, ZIP compressed in single lines, always by one thread: the bytes are a function of the samples.

use std::io::{Cursor, Write};

use exr::prelude::*;

use crate::picture::{MAX_PIXELS, size_is_allowed};

/// Most samples of all channels of a layer: those of four at the largest size, colour and alpha.
const MAX_SAMPLES: usize = 4 * MAX_PIXELS;

/// Named planes of one size.
#[derive(Clone, Debug, PartialEq)]
pub struct Planes {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Channel name and its `height · width` samples, sorted by name.
    pub channels: Vec<(String, Vec<f32>)>,
}

impl Planes {
    /// The samples of the channel called `name`.
    pub fn channel(&self, name: &str) -> Option<&[f32]> {
        self.channels.iter().find(|(n, _)| n == name).map(|(_, samples)| samples.as_slice())
    }
}

/// Why an EXR file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ExrError {
    /// Not an EXR file, or a broken one.
    #[error("not a readable EXR file: {0}")]
    Broken(String),
    /// Larger than this program decodes.
    #[error("the picture is {0}×{1}, larger than this program decodes")]
    TooLarge(usize, usize),
    /// More samples in all channels together than this program decodes.
    #[error("the picture has {channels} channels of {width}×{height}, expected at most {MAX_SAMPLES} samples in all")]
    Channels {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
        /// Channels.
        channels: usize,
    },
}

/// Decodes an EXR file from memory. The size is checked before memory is taken.
///
/// # Errors
/// Broken, deep or oversized files.
pub fn read(bytes: &[u8]) -> std::result::Result<Planes, ExrError> {
    let broken = |e: exr::error::Error| ExrError::Broken(e.to_string());
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(broken)?;
    for header in &meta.headers {
        let Vec2(width, height) = header.layer_size;
        if !size_is_allowed(width, height) {
            return Err(ExrError::TooLarge(width, height));
        }
        let channels = header.channels.list.len();
        if channels.saturating_mul(width * height) > MAX_SAMPLES {
            return Err(ExrError::Channels { width, height, channels });
        }
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(broken)?;
    let Vec2(width, height) = image.layer_data.size;
    let mut channels = Vec::new();
    for channel in image.layer_data.channel_data.list {
        let samples: Vec<f32> = channel.sample_data.values_as_f32().collect();
        if samples.len() == width * height {
            channels.push((channel.name.to_string(), samples));
        }
    }
    channels.sort_by(|a, b| a.0.cmp(&b.0));
    if channels.is_empty() {
        return Err(ExrError::Broken("no channel at full resolution".into()));
    }
    Ok(Planes { width, height, channels })
}

/// Encodes planes as an EXR file, `comment` in its attributes.
///
/// # Errors
/// The writer's, and planes whose length is not `width · height`.
pub fn write(planes: &Planes, comment: &str, out: &mut impl Write) -> std::io::Result<()> {
    let size = planes.width * planes.height;
    let mut list = SmallVec::new();
    for (name, samples) in &planes.channels {
        if samples.len() != size {
            return Err(std::io::Error::other(format!(
                "channel {name}: expected {size} samples, found {}",
                samples.len()
            )));
        }
        list.push(AnyChannel::new(name.as_str(), FlatSamples::F32(samples.clone())));
    }
    let attributes = LayerAttributes {
        comments: Text::new_or_none(comment),
        software_name: Text::new_or_none("streamsplat"),
        ..LayerAttributes::default()
    };
    let encoding =
        Encoding { compression: Compression::ZIP1, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let layer = Layer::new((planes.width, planes.height), attributes, encoding, AnyChannels::sort(list));
    // The encoder needs to seek; a file may be a pipe.
    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer)
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(|e| std::io::Error::other(e.to_string()))?;
    out.write_all(bytes.get_ref())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_come_back_bit_for_bit() {
        let planes = Planes {
            width: 5,
            height: 3,
            channels: vec![
                ("A".into(), (0..15).map(|i| i as f32 / 7.0).collect()),
                ("Z".into(), (0..15).map(|i| 1e-3 * i as f32 - 2.0).collect()),
            ],
        };
        let mut bytes = Vec::new();
        write(&planes, "test", &mut bytes).expect("memory");
        assert_eq!(read(&bytes).expect("just written"), planes);
        let mut again = Vec::new();
        write(&planes, "test", &mut again).expect("memory");
        assert_eq!(bytes, again);
    }

    #[test]
    fn truncated_and_foreign_bytes_are_errors() {
        let planes = Planes { width: 4, height: 4, channels: vec![("Y".into(), vec![0.5; 16])] };
        let mut bytes = Vec::new();
        write(&planes, "", &mut bytes).expect("memory");
        for end in [0, 3, 40, bytes.len() - 5] {
            assert!(read(&bytes[..end]).is_err(), "{end} bytes");
        }
        assert!(read(b"not an exr file at all").is_err());
    }
}
