//! Reading and writing of OpenEXR files: planes of float samples.
//!
//! Reading converts full-resolution channels of any stored type to f32, in the display window, whatever the data window
//! is. Writing produces layers of f32 channels, ZIP-compressed line by line, always on one thread: the bytes are a
//! function of the samples.

mod file;

use std::io::{Cursor, Write};

use exr::image::write::layers::WritableLayers;
use exr::prelude::*;

use crate::picture::MAX_PIXELS;
pub(crate) use file::{Chromaticities, File, Part};

/// Maximum number of samples in all channels of a layer: four channels, colour and alpha, at the largest size.
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
    /// Returns the samples of the channel called `name`.
    pub fn channel(&self, name: &str) -> Option<&[f32]> {
        self.channels.iter().find(|(n, _)| n == name).map(|(_, samples)| samples.as_slice())
    }
}

/// Error of reading an EXR file.
#[derive(Debug, thiserror::Error)]
pub enum ExrError {
    /// Not an EXR file, or a broken one.
    #[error("not a readable EXR file: {0}")]
    Broken(String),
    /// Compressed by a codec that this program does not have.
    #[error(
        "expected EXR compression none, RLE, ZIP, PIZ, PXR24, B44 or DWA, found {0}; oiiotool IN --compression zip -o OUT converts it"
    )]
    Compression(String),
    /// A picture above the size limit.
    #[error("the picture is {0}×{1}, larger than this program decodes")]
    TooLarge(usize, usize),
    /// More samples in all channels together than the limit.
    #[error("the picture has {channels} channels of {width}×{height}, expected at most {MAX_SAMPLES} samples in all")]
    Channels {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
        /// Number of channels.
        channels: usize,
    },
}

impl From<exr::error::Error> for ExrError {
    fn from(error: exr::error::Error) -> Self {
        ExrError::Broken(error.to_string())
    }
}

/// Decodes, from memory, the first part of an EXR file that is not deep, in its display window. Samples outside of the
/// data window are 0. The size is checked before memory is allocated.
///
/// # Errors
/// Broken, deep or oversized files.
pub fn read(bytes: &[u8]) -> std::result::Result<Planes, ExrError> {
    let file = File::open(bytes)?;
    let Some(part) = file.parts().find(|part| !part.is_deep()) else {
        return Err(ExrError::Broken("its samples are deep".into()));
    };
    let mut names: Vec<String> = part.channels().filter(|(_, full)| *full).map(|(name, _)| name).collect();
    names.sort();
    if names.is_empty() {
        return Err(ExrError::Broken("no channel at full resolution".into()));
    }
    let all: Vec<&str> = names.iter().map(String::as_str).collect();
    let planes = file.read(part, &all, 0.0)?;
    let window = part.display();
    Ok(Planes { width: window.width, height: window.height, channels: names.into_iter().zip(planes).collect() })
}

/// Encodes planes as an EXR file, with `comment` in its attributes.
///
/// # Errors
/// The writer's errors, and planes whose length is not `width · height`.
pub fn write(planes: &Planes, comment: &str, out: &mut impl Write) -> std::io::Result<()> {
    let layer = encode(planes, LayerAttributes { comments: Text::new_or_none(comment), ..LayerAttributes::default() })?;
    finish(&Image::from_layer(layer), out)
}

/// A layer of a file with several.
#[derive(Clone, Debug)]
pub struct NamedLayer<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its channels.
    pub planes: Planes,
    /// Meaning of the samples.
    pub comment: &'a str,
    /// The colour space, as the value of the attribute `oiio:ColorSpace`.
    pub colour_space: Option<&'a str>,
}

/// Encodes layers of one size as one EXR file, each as a part, in order. Readers that support only one layer read the
/// first.
///
/// # Errors
/// The writer's errors, planes whose length is not `width · height`, and layers of different sizes.
pub fn write_layers(layers: &[NamedLayer<'_>], out: &mut impl Write) -> std::io::Result<()> {
    let size = |layer: &NamedLayer<'_>| (layer.planes.width, layer.planes.height);
    let (width, height) =
        layers.first().map(size).ok_or_else(|| std::io::Error::other("expected a layer, found none"))?;
    let mut encoded = Vec::with_capacity(layers.len());
    for layer in layers {
        if size(layer) != (width, height) {
            let (w, h) = size(layer);
            return Err(std::io::Error::other(format!(
                "layer {}: expected {width}×{height}, found {w}×{h}",
                layer.name
            )));
        }
        let space =
            layer.colour_space.map(|space| (Text::from("oiio:ColorSpace"), AttributeValue::Text(Text::from(space))));
        let attributes = LayerAttributes {
            comments: Text::new_or_none(layer.comment),
            // At most one attribute: the order of several would not be fixed.
            other: space.into_iter().collect(),
            ..LayerAttributes::named(layer.name)
        };
        encoded.push(encode(&layer.planes, attributes)?);
    }
    let window = IntegerBounds::from_dimensions((width, height));
    finish(&Image::from_layers(ImageAttributes::new(window), encoded), out)
}

/// Builds a layer of f32 channels, sorted by name.
fn encode(planes: &Planes, attributes: LayerAttributes) -> std::io::Result<Layer<AnyChannels<FlatSamples>>> {
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
    let attributes = LayerAttributes { software_name: Text::new_or_none("streamsplat"), ..attributes };
    let encoding =
        Encoding { compression: Compression::ZIP1, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    Ok(Layer::new((planes.width, planes.height), attributes, encoding, AnyChannels::sort(list)))
}

fn finish<'i, L>(image: &'i Image<L>, out: &mut impl Write) -> std::io::Result<()>
where
    L: WritableLayers<'i> + 'i,
{
    // The encoder needs to seek, and the output may be a pipe.
    let mut bytes = Cursor::new(Vec::new());
    image.write().non_parallel().to_buffered(&mut bytes).map_err(|e| std::io::Error::other(e.to_string()))?;
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
    fn layers_come_back_by_name_bit_for_bit() {
        let plane = |scale: f32| (0..12).map(|i| i as f32 * scale).collect::<Vec<f32>>();
        let planes = |channels: &[(&str, f32)]| Planes {
            width: 4,
            height: 3,
            channels: channels.iter().map(|(name, scale)| (name.to_string(), plane(*scale))).collect(),
        };
        let layer = |name, channels: &[(&str, f32)], colour_space| NamedLayer {
            name,
            planes: planes(channels),
            comment: "test",
            colour_space,
        };
        let layers =
            [layer("colour", &[("B", 0.1), ("G", 0.2), ("R", 0.3)], Some("sRGB")), layer("depth", &[("Z", 1.7)], None)];
        let mut bytes = Vec::new();
        write_layers(&layers, &mut bytes).expect("memory");
        let image = exr::prelude::read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .all_layers()
            .all_attributes()
            .non_parallel()
            .from_buffered(Cursor::new(&bytes))
            .expect("just written");
        assert_eq!(image.layer_data.len(), layers.len());
        for (found, expected) in image.layer_data.iter().zip(&layers) {
            assert_eq!(found.attributes.layer_name, Some(Text::from(expected.name)));
            let space = found.attributes.other.get(&Text::from("oiio:ColorSpace"));
            let expected_space = expected.colour_space.map(|space| AttributeValue::Text(Text::from(space)));
            assert_eq!(space, expected_space.as_ref());
            let channels: Vec<(String, Vec<f32>)> = found
                .channel_data
                .list
                .iter()
                .map(|channel| (channel.name.to_string(), channel.sample_data.values_as_f32().collect()))
                .collect();
            assert_eq!(channels, expected.planes.channels, "{}", expected.name);
        }
        // A reader of one layer finds the colours.
        assert_eq!(read(&bytes).expect("just written"), layers[0].planes);
        let mut again = Vec::new();
        write_layers(&layers, &mut again).expect("memory");
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
