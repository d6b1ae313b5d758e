use std::io::Cursor;

use image::{DynamicImage, ImageFormat, RgbImage, RgbaImage};

use super::*;

fn encode(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).expect("memory");
    bytes.into_inner()
}

fn png(image: &DynamicImage) -> Vec<u8> {
    encode(image, ImageFormat::Png)
}

/// Builds a PNG chunk with its checksum.
fn chunk(name: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let body = [&name[..], data].concat();
    let crc = !body.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
    });
    [&(data.len() as u32).to_be_bytes()[..], &body, &crc.to_be_bytes()].concat()
}

/// Builds a PNG file with more chunks after its header.
fn with_chunks(png: &[u8], chunks: &[Vec<u8>]) -> Vec<u8> {
    [&png[..33], &chunks.concat(), &png[33..]].concat()
}

/// Builds an animated PNG of whole frames with these delays.
pub(in crate::source) fn apng(frames: &[(RgbaImage, [u16; 2])]) -> Vec<u8> {
    let numbers = |numbers: &[u32]| numbers.iter().flat_map(|n| n.to_be_bytes()).collect::<Vec<u8>>();
    let mut bytes = Vec::new();
    let mut sequence = 0;
    for (index, (frame, [numerator, denominator])) in frames.iter().enumerate() {
        let still = png(&DynamicImage::ImageRgba8(frame.clone()));
        if index == 0 {
            bytes.extend_from_slice(&still[..33]);
            bytes.extend(chunk(b"acTL", &numbers(&[frames.len() as u32, 0])));
        }
        let mut control = numbers(&[sequence, frame.width(), frame.height(), 0, 0]);
        control.extend([numerator.to_be_bytes(), denominator.to_be_bytes()].concat());
        control.extend([0, 0]);
        bytes.extend(chunk(b"fcTL", &control));
        sequence += 1;
        for (_, data) in png::chunks(&still).filter(|(name, _)| *name == b"IDAT") {
            if index == 0 {
                bytes.extend(chunk(b"IDAT", data));
            } else {
                bytes.extend(chunk(b"fdAT", &[&numbers(&[sequence]), data].concat()));
                sequence += 1;
            }
        }
    }
    bytes.extend(chunk(b"IEND", &[]));
    bytes
}

/// Builds an animated WebP of whole frames, each with its duration in milliseconds.
pub(in crate::source) fn animated_webp(frames: &[(RgbImage, u32)]) -> Vec<u8> {
    let riff = |name: &[u8; 4], data: &[u8]| {
        let mut chunk = [&name[..], &(data.len() as u32).to_le_bytes(), data].concat();
        chunk.resize(chunk.len().next_multiple_of(2), 0);
        chunk
    };
    let three = |n: u32| n.to_le_bytes()[..3].to_vec();
    let [w, h] = [frames[0].0.width() - 1, frames[0].0.height() - 1];
    let mut body = b"WEBP".to_vec();
    body.extend(riff(b"VP8X", &[vec![2, 0, 0, 0], three(w), three(h)].concat()));
    body.extend(riff(b"ANIM", &[0; 6]));
    for (frame, milliseconds) in frames {
        let still = encode(&DynamicImage::ImageRgb8(frame.clone()), ImageFormat::WebP);
        let place = [three(0), three(0), three(w), three(h), three(*milliseconds), vec![2]].concat();
        body.extend(riff(b"ANMF", &[&place[..], &still[12..]].concat()));
    }
    riff(b"RIFF", &body)
}

/// Builds a grey baseline JPEG of blocks of 8×8 pixels, each of one level.
fn jpeg(width: u16, height: u16, level: impl Fn(usize, usize) -> u8) -> Vec<u8> {
    let segment =
        |marker: u8, data: &[u8]| [&[0xff, marker], &(data.len() as u16 + 2).to_be_bytes()[..], data].concat();
    let mut bytes = vec![0xff, 0xd8];
    // Every step is one level: the sum of a block of 64 is 8 times the stored value.
    bytes.extend(segment(0xdb, &[&[0][..], &[8; 64]].concat()));
    let [w, h] = [width.to_be_bytes(), height.to_be_bytes()];
    bytes.extend(segment(0xc0, &[8, h[0], h[1], w[0], w[1], 1, 1, 0x11, 0]));
    // Twelve codes of four bits for the differences of level; one code for "all other coefficients are zero".
    let lengths = |length: usize, count: u8| (1..=16).map(|n| if n == length { count } else { 0 }).collect::<Vec<u8>>();
    bytes.extend(segment(0xc4, &[&[0][..], &lengths(4, 12), &(0..12).collect::<Vec<u8>>()].concat()));
    bytes.extend(segment(0xc4, &[&[0x10][..], &lengths(1, 1), &[0]].concat()));
    bytes.extend(segment(0xda, &[1, 1, 0, 0, 63, 0]));
    let (mut bits, mut before) = (Vec::new(), 0);
    for y in 0..usize::from(height).div_ceil(8) {
        for x in 0..usize::from(width).div_ceil(8) {
            let now = i32::from(level(x, y)) - 128;
            let difference = now - before;
            before = now;
            let size = 32 - difference.unsigned_abs().leading_zeros();
            let value = if difference < 0 { difference + (1 << size) - 1 } else { difference };
            bits.extend((0..4).rev().map(|i| size >> i & 1 == 1));
            bits.extend((0..size).rev().map(|i| value >> i & 1 == 1));
            bits.push(false);
        }
    }
    bits.resize(bits.len().next_multiple_of(8), true);
    for byte in bits.chunks(8).map(|bits| bits.iter().fold(0, |byte, &bit| byte << 1 | u8::from(bit))) {
        bytes.push(byte);
        if byte == 0xff {
            bytes.push(0);
        }
    }
    bytes.extend([0xff, 0xd9]);
    bytes
}

#[test]
fn eight_and_sixteen_bit_samples_keep_their_precision() {
    let eight = DynamicImage::ImageRgb8(RgbImage::from_raw(1, 1, vec![0, 128, 255]).expect("one pixel"));
    assert_eq!(decode(&png(&eight), Path::new("a.png")).expect("valid").rgb, [0.0, 128.0 / 255.0, 1.0]);
    let sixteen = image::ImageBuffer::from_raw(1, 1, vec![1u16, 32768, 65535]).expect("one pixel");
    let picture = decode(&png(&DynamicImage::ImageRgb16(sixteen)), Path::new("a.png")).expect("valid");
    assert_eq!(picture.rgb, [1.0 / 65535.0, 32768.0 / 65535.0, 1.0]);
}

#[test]
fn alpha_is_composited_over_mid_grey() {
    let image = image::ImageBuffer::from_raw(2, 1, vec![255u8, 0, 0, 0, 255, 0, 0, 255]).expect("two pixels");
    let found = still(&png(&DynamicImage::ImageRgba8(image)), Path::new("a.png")).expect("valid");
    assert_eq!(found.picture.rgb, [0.5, 1.0, 0.5, 0.0, 0.5, 0.0]);
    assert_eq!(found.notes, [OVER_GREY]);
    let opaque = RgbaImage::from_pixel(2, 1, image::Rgba([9, 9, 9, 255]));
    assert!(still(&png(&DynamicImage::ImageRgba8(opaque)), Path::new("a.png")).expect("valid").notes.is_empty());
}

#[test]
fn truncated_images_and_foreign_bytes_are_errors() {
    let image = DynamicImage::ImageRgb8(RgbImage::from_fn(40, 30, |x, y| image::Rgb([x as u8, y as u8, 7])));
    for (format, name) in [(ImageFormat::Png, "a.png"), (ImageFormat::WebP, "a.webp")] {
        let bytes = encode(&image, format);
        for end in [1, 8, 20, bytes.len() / 2, bytes.len() - 12, bytes.len() - 2] {
            assert!(decode(&bytes[..end], Path::new(name)).is_err(), "{end} bytes of {name}");
        }
    }
    for foreign in [&b"hello, this is text"[..], &[0xff, 0xd8, 0xff, 0xe0, 0, 16], &[0x76, 0x2f, 0x31, 0x01], b"II*\0"]
    {
        assert!(decode(foreign, Path::new("a.png")).is_err());
    }
}

#[test]
fn a_header_that_promises_a_huge_image_is_refused() {
    let small = png(&DynamicImage::ImageRgb8(RgbImage::new(3, 3)));
    let mut header = small[16..29].to_vec();
    header[..8].copy_from_slice(&[0, 0, 0x7f, 0xff, 0, 0, 0x7f, 0xff]);
    let bytes = [&small[..8], &chunk(b"IHDR", &header), &small[33..]].concat();
    let error = decode(&bytes, Path::new("a.png")).expect_err("32767×32767");
    assert!(matches!(error, SourceError::TooLarge { width: 32767, height: 32767, .. }), "{error}");
}

#[test]
fn a_jpeg_that_is_cut_or_damaged_is_refused() {
    let level = |x: usize, y: usize| (16 + 13 * x + 7 * y) as u8;
    let whole = jpeg(128, 96, level);
    let picture = decode(&whole, Path::new("a.jpg")).expect("valid").to_rgb8();
    for (x, y) in [(0, 0), (127, 0), (64, 50), (127, 95)] {
        let found = picture[3 * (128 * y + x)];
        assert!(found.abs_diff(level(x / 8, y / 8)) <= 1, "{found} at {x}, {y}");
    }
    let error = |bytes: &[u8]| decode(bytes, Path::new("a.jpg")).expect_err("refused").to_string();
    let start = whole.windows(2).position(|w| w == [0xff, 0xda]).expect("a scan") + 10;
    for end in [start + 1, (start + whole.len()) / 2, whole.len() - 2] {
        assert!(error(&whole[..end]).contains("cut off: expected an end-of-image marker"), "{end} bytes");
    }
    for end in [4, 30, start - 30] {
        assert!(!error(&whole[..end]).contains('\n'), "{end} bytes");
    }
    let mut damaged = whole.clone();
    damaged[start + 20..start + 60].fill(0xc3);
    assert!(error(&damaged).contains("a.jpg: broken"), "{}", error(&damaged));
    // Valid codes for a part of the picture, then the end-of-image marker.
    for part in [1, 20, (whole.len() - start) / 2] {
        let short = [&whole[..start + part], &[0xff, 0xd9]].concat();
        let found = error(&short);
        assert!(found.contains("the JPEG image is damaged at unit") && found.contains("of 192: "), "{found}");
    }
    // Data after the picture are ignored: previews, second pictures, maker notes.
    assert!(decode(&[&whole[..], b"more"].concat(), Path::new("a.jpg")).is_ok());
}

#[test]
fn png_and_webp_are_turned_as_their_exif_says() {
    let image = DynamicImage::ImageRgb8(RgbImage::from_fn(4, 2, |x, y| image::Rgb([60 * x as u8, 200 * y as u8, 7])));
    let exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    let mut turned = image.clone();
    turned.apply_orientation(image::metadata::Orientation::Rotate90);
    let file = with_chunks(&png(&image), &[chunk(b"eXIf", exif)]);
    let found = decode(&file, Path::new("a.png")).expect("valid");
    assert_eq!((found.width, found.height, found.to_rgb8()), (2, 4, turned.as_bytes().to_vec()));
    let still = encode(&image, ImageFormat::WebP);
    let mut body = b"WEBPVP8X\x0a\0\0\0\x08\0\0\0\x03\0\0\x01\0\0".to_vec();
    body.extend_from_slice(&still[12..]);
    body.extend([&b"EXIF"[..], &(exif.len() as u32).to_le_bytes(), exif].concat());
    let file = [&b"RIFF"[..], &(body.len() as u32).to_le_bytes(), &body].concat();
    let found = decode(&file, Path::new("a.webp")).expect("valid");
    assert_eq!((found.width, found.height, found.to_rgb8()), (2, 4, turned.as_bytes().to_vec()));
}

#[test]
fn colours_that_are_not_srgb_are_said() {
    let image = png(&DynamicImage::ImageRgb8(RgbImage::new(3, 3)));
    let notes = |chunks: &[Vec<u8>]| still(&with_chunks(&image, chunks), Path::new("a.png")).expect("valid").notes;
    let gamma = |value: u32| chunk(b"gAMA", &value.to_be_bytes());
    let numbers = |numbers: [u32; 8]| numbers.iter().flat_map(|n| n.to_be_bytes()).collect::<Vec<u8>>();
    let wide = chunk(b"cHRM", &numbers([31_270, 32_900, 68_000, 32_000, 26_500, 69_000, 15_000, 6_000]));
    assert!(notes(&[gamma(45_455)]).is_empty() && notes(&[chunk(b"cICP", &[1, 13, 0, 1])]).is_empty());
    assert!(notes(&[chunk(b"sRGB", &[0]), gamma(45_455)]).is_empty());
    assert!(notes(&[gamma(100_000)])[0].contains("gAMA (1.00000) is not applied"));
    assert!(notes(&[wide])[0].contains("cHRM"));
    assert!(notes(&[chunk(b"cICP", &[9, 16, 0, 1])])[0].contains("primaries 9, transfer 16"));
    let mut profiled = Vec::new();
    let mut encoder = image::codecs::png::PngEncoder::new(&mut profiled);
    let profile = icc::tests::profile(icc::tests::P3, 2.2, "Display P3");
    image::ImageEncoder::set_icc_profile(&mut encoder, profile).expect("PNG has profiles");
    image::ImageEncoder::write_image(encoder, &[0; 3], 1, 1, image::ExtendedColorType::Rgb8).expect("memory");
    let notes = still(&profiled, Path::new("a.png")).expect("valid").notes;
    assert_eq!(notes, ["the colour profile \"Display P3\" is not applied: colours are taken as sRGB"]);
}

#[test]
fn a_file_of_several_frames_is_no_picture() {
    let frame = |level: u8| RgbaImage::from_pixel(3, 2, image::Rgba([level, 0, 0, 255]));
    let error = |bytes: &[u8], name: &str| decode(bytes, Path::new(name)).expect_err("several").to_string();
    let animated = apng(&[(frame(1), [1, 10]), (frame(2), [1, 10])]);
    assert!(error(&animated, "a.png").contains("expected one picture, found an animated PNG of 2 frames"));
    let colour = |level: u8| RgbImage::from_pixel(3, 2, image::Rgb([level, 0, 0]));
    let animated = animated_webp(&[(colour(1), 40), (colour(2), 40), (colour(3), 40)]);
    assert!(error(&animated, "a.webp").contains("found an animated WebP of 3 frames"));
    let mut pages = Cursor::new(Vec::new());
    let mut encoder = ::tiff::encoder::TiffEncoder::new(&mut pages).expect("memory");
    for level in [1, 2] {
        encoder.write_image::<::tiff::encoder::colortype::Gray8>(1, 1, &[level]).expect("memory");
    }
    assert!(error(pages.get_ref(), "a.tif").contains("found a TIFF of 2 pages"));
}

#[test]
fn pixels_that_are_not_square_are_told() {
    let picture = DynamicImage::ImageRgb8(RgbImage::new(2, 2));
    let (plain, mut jpeg) = (png(&picture), jpeg(8, 8, |_, _| 9));
    let notes = |bytes: &[u8]| still(bytes, Path::new("a")).expect("an image").notes;
    assert_eq!((notes(&plain), notes(&jpeg)), (Vec::new(), Vec::new()));
    let resolution = [&2000_u32.to_be_bytes()[..], &1000_u32.to_be_bytes(), &[1]].concat();
    let wide = with_chunks(&plain, &[chunk(b"pHYs", &resolution)]);
    assert_eq!(notes(&wide), ["pixels of 1000:2000, by the resolution in the file, are taken as square"]);
    jpeg.splice(2..2, *b"\xff\xe0\0\x10JFIF\0\x01\x01\x01\0\x90\0\x48\0\0");
    assert_eq!(notes(&jpeg), ["pixels of 72:144, by the resolution in the file, are taken as square"]);
}
