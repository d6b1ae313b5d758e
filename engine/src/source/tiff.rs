//! TIFF: grey and RGB, with and without alpha, 8-bit, 16-bit and float; the first page.
//!
//! Read without JPEG compression inside TIFF, whose decoder would bring vector instructions back into the JPEG path.

use std::io::Cursor;
use std::path::Path;

use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};

use super::SourceError;
use super::decode::{Interleaved, check_size, compose, decode_error};
use crate::picture::{MAX_PIXELS, Picture};

pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<Picture, SourceError> {
    let explain = |e: tiff::TiffError| decode_error(path, format!("broken or unsupported TIFF image: {e}"));
    let mut limits = Limits::default();
    limits.decoding_buffer_size = 16 * MAX_PIXELS;
    limits.intermediate_buffer_size = 16 * MAX_PIXELS;
    let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(explain)?.with_limits(limits);
    let (width, height) = decoder.dimensions().map_err(explain)?;
    let (width, height) = (width as usize, height as usize);
    check_size(path, width, height)?;
    let colour = decoder.colortype().map_err(explain)?;
    let channels = match colour {
        ColorType::Gray(8 | 16 | 32 | 64) => 1,
        ColorType::GrayA(8 | 16 | 32 | 64) => 2,
        ColorType::RGB(8 | 16 | 32 | 64) => 3,
        ColorType::RGBA(8 | 16 | 32 | 64) => 4,
        other => {
            return Err(decode_error(
                path,
                format!("expected a grey or RGB TIFF of 8, 16, 32 or 64 bits, found {other:?}"),
            ));
        }
    };
    let samples: Vec<f32> = match decoder.read_image().map_err(explain)? {
        DecodingResult::U8(v) => v.iter().map(|&v| f32::from(v) / 255.0).collect(),
        DecodingResult::U16(v) => v.iter().map(|&v| f32::from(v) / 65535.0).collect(),
        DecodingResult::U32(v) => v.iter().map(|&v| (f64::from(v) / f64::from(u32::MAX)) as f32).collect(),
        DecodingResult::F16(v) => v.iter().map(|v| v.to_f32()).collect(),
        DecodingResult::F32(v) => v,
        DecodingResult::F64(v) => v.iter().map(|&v| v as f32).collect(),
        _ => return Err(decode_error(path, "expected unsigned or float TIFF samples")),
    };
    compose(&Interleaved { width, height, channels, samples, premultiplied: false }, path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiff::encoder::{TiffEncoder, colortype};

    #[test]
    fn grey_sixteen_bit_and_rgb_float_are_read() {
        let mut bytes = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut bytes).expect("memory");
        encoder.write_image::<colortype::Gray16>(2, 1, &[0, 65535]).expect("memory");
        assert_eq!(decode(bytes.get_ref(), Path::new("a.tif")).expect("valid").rgb, [0.0, 1.0, 0.0, 1.0, 0.0, 1.0]);

        let mut bytes = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut bytes).expect("memory");
        encoder.write_image::<colortype::RGB32Float>(1, 1, &[0.25, 0.5, 3.0]).expect("memory");
        assert_eq!(decode(bytes.get_ref(), Path::new("a.tif")).expect("valid").rgb, [0.25, 0.5, 1.0]);
        let half = bytes.get_ref().len() / 2;
        assert!(decode(&bytes.get_ref()[..half], Path::new("a.tif")).is_err());
    }
}
