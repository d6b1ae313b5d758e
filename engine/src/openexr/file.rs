//! Reader of OpenEXR: the headers of a file's parts, then the samples of chosen channels.

use std::io::Cursor;

use exr::block::UncompressedBlock;
use exr::meta::BlockDescription;
use exr::meta::attribute::SampleType;
use exr::meta::header::Header;
use exr::prelude::{AttributeValue, Text, f16};

use super::{ExrError, MAX_SAMPLES};
use crate::picture::size_is_allowed;

/// Maximum bytes of a compressed unit: a block of rows, or a tile.
const MAX_BLOCK: usize = 1 << 30;

/// A file whose headers have been read.
pub(crate) struct File<'a> {
    bytes: &'a [u8],
    meta: exr::meta::MetaData,
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Window {
    /// Its left column.
    pub left: i64,
    /// Its upper row.
    pub top: i64,
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// CIE xy of red, green, blue and white.
pub(crate) type Chromaticities = [[f64; 2]; 4];

/// One part of a file, with its own channels of one size.
#[derive(Clone, Copy)]
pub(crate) struct Part<'a> {
    number: usize,
    header: &'a Header,
}

impl<'a> File<'a> {
    /// Reads the headers. Sizes are checked before memory is allocated.
    pub fn open(bytes: &'a [u8]) -> Result<File<'a>, ExrError> {
        if let Some(code) = foreign_compression(bytes) {
            let name = match code {
                10 => "HTJ2K256",
                11 => "HTJ2K32",
                13 => "Zstandard",
                _ => "unknown",
            };
            return Err(ExrError::Compression(format!("{name} ({code})")));
        }
        let meta = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), false)?;
        let file = File { bytes, meta };
        for part in file.parts() {
            for window in [part.data(), part.display()] {
                if !size_is_allowed(window.width, window.height) {
                    return Err(ExrError::TooLarge(window.width, window.height));
                }
            }
        }
        Ok(file)
    }

    /// Iterates over the parts in order.
    pub fn parts(&self) -> impl Iterator<Item = Part<'_>> {
        self.meta.headers.iter().enumerate().map(|(number, header)| Part { number, header })
    }

    /// Reads the samples of a part's channels, all at full resolution, in the display window. Samples outside of the
    /// data window are `outside`.
    pub fn read(&self, part: Part<'_>, channels: &[&str], outside: f32) -> Result<Vec<Vec<f32>>, ExrError> {
        let Part { number, header } = part;
        let (shown, data) = (part.display(), part.data());
        let area = shown.width * shown.height;
        if channels.len().saturating_mul(area) > MAX_SAMPLES {
            return Err(ExrError::Channels { width: shown.width, height: shown.height, channels: channels.len() });
        }
        let rows = match header.blocks {
            BlockDescription::Tiles(tiles) => tiles.tile_size.0.saturating_mul(tiles.tile_size.1),
            BlockDescription::ScanLines => header.compression.scan_lines_per_block().saturating_mul(data.width),
        };
        if rows.saturating_mul(header.channels.bytes_per_pixel) > MAX_BLOCK {
            let channels = header.channels.list.len();
            return Err(ExrError::Channels { width: data.width, height: data.height, channels });
        }
        // Plane of each channel of the file; at most a few.
        let mut planes_of: Vec<Option<usize>> = vec![None; header.channels.list.len()];
        for (plane, name) in channels.iter().enumerate() {
            let found = header.channels.list.iter().position(|channel| channel.name.to_string() == *name);
            let Some(found) = found
                .filter(|&at| header.channels.list[at].sampling.0 == 1 && header.channels.list[at].sampling.1 == 1)
            else {
                return Err(ExrError::Broken(format!("no channel {name} at full resolution")));
            };
            planes_of[found] = Some(plane);
        }
        let mut planes = vec![vec![outside; area]; channels.len()];
        let (left, top) = (data.left - shown.left, data.top - shown.top);
        // Columns of the data window that are inside the display window.
        let columns = (-left).clamp(0, data.width as i64)..(shown.width as i64 - left).clamp(0, data.width as i64);
        let is_shown = |row: i64| (0..shown.height as i64).contains(&row);
        let reader = exr::block::read(Cursor::new(self.bytes), false)?;
        let chunks = reader.filter_chunks(false, |_, _, block| {
            let first = block.pixel_position.1 as i64 + top;
            let end = first + block.pixel_size.1 as i64;
            block.layer == number && (block.level.0, block.level.1) == (0, 0) && first < shown.height as i64 && end > 0
        })?;
        for chunk in chunks {
            let block = UncompressedBlock::decompress_chunk(chunk?, &self.meta, false)?;
            for line in block.lines(&header.channels) {
                let Some(plane) = planes_of.get(line.location.channel).copied().flatten() else { continue };
                let row = line.location.position.1 as i64 + top;
                if !is_shown(row) || columns.is_empty() {
                    continue;
                }
                let first = line.location.position.0 as i64;
                let into = &mut planes[plane][row as usize * shown.width..][..shown.width];
                let mut put = |index: usize, sample: f32| {
                    let column = first + index as i64;
                    if columns.contains(&column) {
                        into[(column + left) as usize] = sample;
                    }
                };
                match header.channels.list[line.location.channel].sample_type {
                    SampleType::F16 => {
                        for (index, sample) in line.read_samples::<f16>().enumerate() {
                            put(index, sample?.to_f32());
                        }
                    }
                    SampleType::F32 => {
                        for (index, sample) in line.read_samples::<f32>().enumerate() {
                            put(index, sample?);
                        }
                    }
                    SampleType::U32 => {
                        for (index, sample) in line.read_samples::<u32>().enumerate() {
                            put(index, sample? as f32);
                        }
                    }
                }
            }
        }
        Ok(planes)
    }
}

impl<'a> Part<'a> {
    /// Returns its name, or its index if it has none.
    pub fn name(&self) -> String {
        self.header.own_attributes.layer_name.as_ref().map_or_else(|| format!("part {}", self.number), Text::to_string)
    }

    /// Returns true if its samples are deep: any number of samples per pixel.
    pub fn is_deep(&self) -> bool {
        self.header.deep
    }

    /// Iterates over its channels; the flag is true at full resolution.
    pub fn channels(&self) -> impl Iterator<Item = (String, bool)> + use<'a> {
        let list = &self.header.channels.list;
        list.iter().map(|channel| (channel.name.to_string(), (channel.sampling.0, channel.sampling.1) == (1, 1)))
    }

    /// Returns the display window, which is the picture.
    pub fn display(&self) -> Window {
        let bounds = self.header.shared_attributes.display_window;
        window([bounds.position.0, bounds.position.1], [bounds.size.0, bounds.size.1])
    }

    /// Returns the data window, which has samples.
    pub fn data(&self) -> Window {
        let (at, size) = (self.header.own_attributes.layer_position, self.header.layer_size);
        window([at.0, at.1], [size.0, size.1])
    }

    /// Returns the ratio of a pixel's width to its height.
    pub fn pixel_aspect(&self) -> f32 {
        self.header.shared_attributes.pixel_aspect
    }

    /// Returns a text attribute.
    pub fn text(&self, name: &str) -> Option<String> {
        match self.attribute(name)? {
            AttributeValue::Text(text) => Some(text.to_string()),
            _ => None,
        }
    }

    /// Returns an integer attribute.
    pub fn integer(&self, name: &str) -> Option<i32> {
        match self.attribute(name)? {
            AttributeValue::I32(number) => Some(*number),
            _ => None,
        }
    }

    /// Returns primaries and white.
    pub fn chromaticities(&self) -> Option<Chromaticities> {
        let found = self.header.shared_attributes.chromaticities?;
        Some([found.red, found.green, found.blue, found.white].map(|xy| [f64::from(xy.0), f64::from(xy.1)]))
    }

    fn attribute(&self, name: &str) -> Option<&'a AttributeValue> {
        let name = Text::new_or_none(name)?;
        let (own, shared) = (&self.header.own_attributes.other, &self.header.shared_attributes.other);
        own.get(&name).or_else(|| shared.get(&name))
    }
}

fn window([left, top]: [i32; 2], [width, height]: [usize; 2]) -> Window {
    Window { left: i64::from(left), top: i64::from(top), width, height }
}

/// Returns the code of the first header's compression if it is not supported here.
fn foreign_compression(bytes: &[u8]) -> Option<u8> {
    /// Code of DWAB, the last known one.
    const KNOWN: u8 = 9;
    let mut rest = bytes.get(8..)?;
    loop {
        let name = text(&mut rest)?;
        if name.is_empty() {
            return None;
        }
        let _kind = text(&mut rest)?;
        let (length, after) = rest.split_first_chunk::<4>()?;
        let (value, after) = after.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        if name == b"compression" {
            return value.first().copied().filter(|&code| code > KNOWN);
        }
        rest = after;
    }
}

/// Reads bytes up to the next zero, which is consumed as well.
fn text<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    let length = rest.iter().position(|&byte| byte == 0)?;
    let (text, after) = rest.split_at(length);
    *rest = &after[1..];
    Some(text)
}
