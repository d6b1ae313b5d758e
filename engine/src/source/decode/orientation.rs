//! Orientation tags: how a stored picture is turned and mirrored before it is shown.

use image::metadata::Orientation;

use crate::picture::Picture;

/// Turns and mirrors the picture as the tag `orientation` requires.
pub(super) fn apply(picture: Picture, orientation: Orientation) -> Picture {
    let Picture { width: w, height: h, ref rgb } = picture;
    let swaps = matches!(
        orientation,
        Orientation::Rotate90 | Orientation::Rotate270 | Orientation::Rotate90FlipH | Orientation::Rotate270FlipH
    );
    // Maps column x and row y of the shown picture to a position in the stored one.
    let from: fn(usize, usize, usize, usize) -> usize = match orientation {
        Orientation::NoTransforms => return picture,
        Orientation::FlipHorizontal => |x, y, w, _| y * w + (w - 1 - x),
        Orientation::Rotate180 => |x, y, w, h| (h - 1 - y) * w + (w - 1 - x),
        Orientation::FlipVertical => |x, y, w, h| (h - 1 - y) * w + x,
        Orientation::Rotate90FlipH => |x, y, w, _| x * w + y,
        Orientation::Rotate90 => |x, y, w, h| (h - 1 - x) * w + y,
        Orientation::Rotate270FlipH => |x, y, w, h| (h - 1 - x) * w + (w - 1 - y),
        Orientation::Rotate270 => |x, y, w, _| x * w + (w - 1 - y),
    };
    let (width, height) = if swaps { (h, w) } else { (w, h) };
    let mut turned = Vec::with_capacity(rgb.len());
    for plane in rgb.chunks_exact(w * h) {
        for y in 0..height {
            turned.extend((0..width).map(|x| plane[from(x, y, w, h)]));
        }
    }
    Picture { width, height, rgb: turned }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{DynamicImage, RgbImage};

    #[test]
    fn every_orientation_is_that_of_the_image_crate() {
        let image = RgbImage::from_fn(5, 3, |x, y| image::Rgb([x as u8, y as u8, (x * y) as u8]));
        let picture = Picture::from_rgb8(5, 3, image.as_raw()).expect("15 pixels");
        for value in 1..=8 {
            let orientation = Orientation::from_exif(value).expect("a value of EXIF");
            let mut expected = DynamicImage::ImageRgb8(image.clone());
            expected.apply_orientation(orientation);
            let found = apply(picture.clone(), orientation);
            assert_eq!((found.width as u32, found.height as u32), (expected.width(), expected.height()), "{value}");
            assert_eq!(found.to_rgb8(), expected.as_bytes(), "{value}");
        }
    }
}
