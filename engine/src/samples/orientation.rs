//! The orientation of EXIF and TIFF, applied to samples.

use image::metadata::Orientation;

use super::{Channel, Part};

/// Applies the orientation to a part.
pub(super) fn oriented(mut part: Part, orientation: Orientation) -> Part {
    if orientation == Orientation::NoTransforms {
        return part;
    }
    for channel in &mut part.channels {
        *channel = turned(channel, orientation);
    }
    if turns(orientation) {
        (part.width, part.height) = (part.height, part.width);
    }
    part
}

/// Returns true if rows become columns.
fn turns(orientation: Orientation) -> bool {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    matches!(orientation, Rotate90 | Rotate90FlipH | Rotate270 | Rotate270FlipH)
}

fn turned(channel: &Channel, orientation: Orientation) -> Channel {
    let (w, h) = (channel.width, channel.height);
    let (width, height) = if turns(orientation) { (h, w) } else { (w, h) };
    let from = |x: usize, y: usize| match orientation {
        Orientation::NoTransforms => (x, y),
        Orientation::Rotate90 => (y, h - 1 - x),
        Orientation::Rotate180 => (w - 1 - x, h - 1 - y),
        Orientation::Rotate270 => (w - 1 - y, x),
        Orientation::FlipHorizontal => (w - 1 - x, y),
        Orientation::FlipVertical => (x, h - 1 - y),
        Orientation::Rotate90FlipH => (y, x),
        Orientation::Rotate270FlipH => (w - 1 - y, h - 1 - x),
    };
    let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| {
        let (column, row) = from(x, y);
        row * w + column
    });
    Channel { name: channel.name.clone(), width, height, samples: channel.samples.taken(places) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::Samples;

    #[test]
    fn every_orientation_is_that_of_the_image_crate() {
        let raw: Vec<u8> = (0..6).collect();
        let part = Part::interleaved(3, 2, 1, &Samples::U8(raw.clone()));
        for exif in 1..=8 {
            let orientation = Orientation::from_exif(exif).expect("1 to 8");
            let mut expected =
                image::DynamicImage::ImageLuma8(image::GrayImage::from_raw(3, 2, raw.clone()).expect("6 pixels"));
            expected.apply_orientation(orientation);
            let found = oriented(part.clone(), orientation);
            assert_eq!((found.width, found.height), (expected.width() as usize, expected.height() as usize), "{exif}");
            assert_eq!(found.channels[0].samples, Samples::U8(expected.into_luma8().into_raw()), "{exif}");
        }
    }
}
